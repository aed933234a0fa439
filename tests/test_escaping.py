"""No text of a scene becomes markup: pages have the same elements whatever their texts are."""

from dataclasses import replace

import numpy as np
import pytest
from support.pages import HOSTILE, elements, make_texts_hostile
from support.springs import dragged

import verification.report
from mic.geometry.surface import Surface
from mic.report.check_page import check_page
from mic.report.comparison_page import write_comparison
from mic.report.explanation_page import write_explanation
from mic.report.template import backticks_to_code
from mic.studies.comparison import compare
from mic.studies.explanation import explain
from mic.system.files import write_text


@pytest.fixture(scope="module")
def model():
    return dragged()


def surface(name):
    points = np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]])
    return Surface(points, np.array([[0, 1, 2], [0, 2, 3]]))


def write_spring_check(path, model, text=""):
    scene = model.scene.model_copy(update={"name": text or "springs", "description": text or "plain"})
    write_text(path, check_page(scene, {name: surface(name) for name in "bt"}, errors=[text or "wrong"]))
    return path


def write_spring_comparison(path, model, text=""):
    found = compare(model, model, samples=5)
    found = replace(found, a=replace(found.a, name=f"a{text}"), b=replace(found.b, name=f"b{text}"))
    return write_comparison(path, replace(found, changes=[f"friction{text}"]))


def write_spring_explanation(path, model, text=""):
    found = explain(model, {"M": 0.03}, 0.001)
    return write_explanation(path, replace(found, scene=found.scene.model_copy(update={"name": f"springs{text}"})))


@pytest.mark.slow
@pytest.mark.parametrize("write", [write_spring_check, write_spring_comparison, write_spring_explanation])
def test_hostile_texts_change_no_element_of_a_page(write, model, tmp_path, monkeypatch):
    plain = elements(write(tmp_path / "plain.html", model))
    assert elements(write(tmp_path / "given.html", model, HOSTILE)) == plain
    make_texts_hostile(monkeypatch)
    assert elements(write(tmp_path / "every.html", model)) == plain
    assert HOSTILE.count("<") * 3 < (tmp_path / "every.html").read_text(encoding="utf-8").count("&lt;")


def test_texts_between_backticks_are_escaped_as_well():
    assert str(backticks_to_code("`<i>` & <b>")) == "<code>&lt;i&gt;</code> &amp; &lt;b&gt;"


def test_the_pages_of_the_verification_escape_texts():
    for text in ("{{ x }}", '<p title="{{ x }}">', "{{ x | keys }}"):
        assert "<script>" not in verification.report.environment().from_string(text).render(x=HOSTILE)


def test_an_unescaped_text_is_found(tmp_path):
    """The test itself: a page that marks a text as safe has other elements."""
    (tmp_path / "a.html").write_text("<p>" * 21 + HOSTILE)
    with pytest.raises(AssertionError):
        elements(tmp_path / "a.html")
