"""The program in a notebook: names, short texts with a picture, tables in and out, friction, progress."""

import sys
import time
import types
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from support.springs import at_face, clamped, dragged, stage_list, two_plates

import mic
from mic.errors import ArgumentError
from mic.process.evaluation import Evaluation
from mic.statistics.draw import draw
from mic.system.progress_bar import ProgressBar

HOSTILE = "A <script>alert(1)</script> & 'more'\nthan one line"


@pytest.fixture(scope="module")
def model():
    return dragged()


@pytest.fixture(scope="module")
def three():
    """Three parts with welds, a batch of key characteristics and a description that is no plain text."""
    return clamped(
        "abc",
        0.0,
        friction=0.2,
        stages=stage_list("locate", "clamp", "weld", "measure"),
        description=HOSTILE + " word" * 40,
        welds=[{"name": "W1", "parts": ["a", "b"], "point": [5, 5, 0]}],
        measurements=[at_face(part, name=f"M{part}{i}", lower=-1, upper=1) for part in "abc" for i in range(4)],
        deviations=[{"name": "P", "kind": "locator", "target": "al0", "sigma": 0.1}],
    )


# ------------------------------------------------------------------------------------------------- names and texts


@pytest.mark.slow
def test_completion_offers_the_public_names_and_nothing_else():
    offered = {name for name in dir(mic) if not name.startswith("__")}
    assert offered == set(mic.__all__) and {"load_scene", "reduce", "examples", "report", "ContactState"} <= offered
    assert not offered & {"Any", "Path", "os", "blas", "importlib", "annotations", "TYPE_CHECKING", "choose_kernels"}
    for name in offered:
        found = getattr(mic, name)
        assert callable(found) or isinstance(found, types.ModuleType), name


@pytest.mark.parametrize("which", ["model", "three"])
def test_models_and_scenes_are_five_lines(which, request):
    found = request.getfixturevalue(which)
    for one, kind in ((found, "ReducedModel"), (found.scene, "Scene")):
        lines = repr(one).splitlines()
        assert len(lines) == 5 and max(map(len, lines)) <= 120 and lines[0].startswith(f"{kind} 'springs'")
        assert str(one) == repr(one)
        assert f"{len(found.scene.parts)} parts: {', '.join(part.name for part in found.scene.parts)}" in lines[1]
        assert f"{len(found.scene.locators)} locators" in lines[1]
    long = [letter * 50 for letter in "abcd"]
    assert {len(line) for line in repr(clamped(long, 0.0)).splitlines()} >= {120}
    assert "1 contact pair in 1 zone: z;" in repr(dragged()) and "P (mm), D (mm)" in repr(dragged())
    assert "12 key characteristics: Ma0, Ma1, Ma2, Ma3, Mb0, Mb1, …;" in repr(request.getfixturevalue("three"))


def test_an_item_of_a_scene_shows_what_is_not_default(model):
    text = repr(model.scene.locators[0])
    assert "name='bl0'" in text and "part='b'" in text and "node" not in text and "stiffness" not in text


def pictured(found):
    """The SVG of what a notebook shows, which is well formed as a whole."""
    html = found._repr_html_()
    assert "<script" not in html
    whole = ElementTree.fromstring(html.replace("<br>", "<br/>").replace("&ensp;", " "))
    return whole.find(".//svg")


@pytest.mark.parametrize("which", ["model", "three"])
def test_the_picture_shows_each_item_once_under_its_name(which, request):
    found = request.getfixturevalue(which)
    scene, svg = found.scene, pictured(found)
    titles = [title.text for title in svg.iter("title")]
    arrows = {item.name: titles.count(item.name) for item in (*scene.locators, *scene.clamps)}
    assert set(arrows.values()) == {1} and len(svg.findall(".//line")) == len(arrows)
    assert len(svg.findall(".//circle")) == len(scene.welds) + len(scene.measurements)
    assert [path.get("d").count("M") for path in svg.iter("path")] == [1] * len(scene.zones)
    width, height = map(float, svg.get("viewBox").split()[2:])
    for circle in svg.iter("circle"):
        assert 0 < float(circle.get("cx")) < width and 0 < float(circle.get("cy")) < height
    assert not list(pictured(scene).iter("path")), "a scene knows no contact pairs"


def turned(items, turn):
    """Items at points that are stretched in their plane and turned in space."""
    place = lambda one: {"point": tuple(turn @ ([20, 3, 1] * np.array(one.point))), "direction": turn @ one.direction}
    return [one.model_copy(update=place(one)) for one in items]


def test_the_picture_of_a_flat_assembly_is_the_same_in_any_orientation(model):
    random, sizes = np.random.default_rng(3).normal(size=(4, 3, 3)), []
    for turn in (np.eye(3), np.eye(3)[:, [2, 0, 1]], *(np.linalg.qr(own)[0] for own in random)):
        moved = {name: turned(getattr(model.scene, name), turn) for name in ("locators", "clamps", "measurements")}
        lines = pictured(model.scene.model_copy(update=moved)).findall(".//line")
        ends = np.array([[float(line.get("x2")), float(line.get("y2"))] for line in lines])
        sizes.append(np.ptp(ends, axis=0))
    np.testing.assert_allclose(sizes, [sizes[0]] * len(sizes), atol=0.2)  # pixels, of which a tenth is written
    assert sizes[0].min() > 50


def test_results_are_short_texts_and_tables(model):
    found = model.evaluate(model.sample(3))
    assert len(repr(found).splitlines()) == 4 and "3 samples under coulomb, none failed" in repr(found)
    assert "<table" in found._repr_html_() and "<pre>" in found._repr_html_()
    counts = np.bincount(found.resolutions["clamp"].state.ravel(), minlength=3)
    assert f"{counts[0]} open, {counts[1]} stick, {counts[2]} slip" in repr(found.resolutions["clamp"])


def test_an_error_in_a_notebook_shows_the_lines_of_the_user_and_the_sentence(model):
    with pytest.raises(mic.MicError) as error:
        model.evaluate({"p": 1.0})
    shown = "\n".join(error.value._render_traceback_())  # IPython calls it
    assert 'model.evaluate({"p": 1.0})' in shown and shown.endswith("did you mean 'P'?")
    assert "reduction.py" not in shown and shown.count("File") == 1


# --------------------------------------------------------------------------------------------------- tables in and out


def test_samples_are_those_of_a_run_with_names_and_units(model):
    sampled = model.sample(5)
    assert list(sampled.columns) == model.parameters and sampled.attrs["units"] == {"P": "mm", "D": "mm"}
    np.testing.assert_array_equal(sampled, draw(model.scene, model.scene.monte_carlo.seed, 0, 5))
    np.testing.assert_array_equal(model.sample(5, seed=7), draw(model.scene, 7, 0, 5))
    stated = dragged(monte_carlo={"values": [[0.8, 2.0], [0.9, 2.1]], "samples": 2})
    np.testing.assert_array_equal(stated.sample(2), [[0.8, 2.0], [0.9, 2.1]])
    with pytest.raises(ArgumentError, match="samples is 3; the scene states 2"):
        stated.sample(3)
    for bad in (0, -1, "x", 1.5, None):
        with pytest.raises(ArgumentError, match="samples is"):
            model.sample(bad)


def test_a_table_is_evaluated_by_its_names_in_any_order(model):
    sampled = model.sample(4).set_index(pd.Index(list("wxyz"), name="piece"))
    expected = model.evaluate(sampled.to_numpy())
    for table in (sampled, sampled[["D", "P"]], sampled[["D", "P"]].astype(object)):
        found = model.evaluate(table)
        assert found.measurements.tobytes() == expected.measurements.tobytes()
        assert isinstance(found.measurements, np.ndarray)
        assert list(found.to_frame().index) == list("wxyz") and found.to_frame().index.name == "piece"
        assert set(found.to_frame("contacts")["sample"]) == set("wxyz")
    assert list(expected.to_frame().index) == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.rename(columns={"P": "p"}), "'p' is not a deviation.*rename it 'P', which is missing"),
        (lambda t: t.rename(columns={"P": "p", "D": "E"}), "'p' is not a deviation.*did you mean 'P'"),
        (lambda t: t.rename(columns={"P": 7}), "7 is not a deviation"),
        (lambda t: t[["P"]], "no column 'D'; add it, or give a dict"),
        (lambda t: t[[]], "no column 'P', 'D'"),
        (lambda t: t.assign(M=0.0), "'M' is not a deviation of this scene; remove it"),
        (lambda t: t[["P", "D", "P"]], "several columns 'P'"),
        (lambda t: t.assign(P=["1", "2", "3"]), "column 'P': one value is '1'; give numbers"),
        (lambda t: t.assign(P=[1.0, None, 3.0]), "sample 1, 'P' is nan"),
        (lambda t: t.astype("Float64").assign(P=pd.array([1, pd.NA, 3], "Float64")), "sample 1, 'P' is nan"),
        (lambda t: t.assign(P=True), "column 'P': one value is True"),
    ],
)
def test_a_table_that_does_not_fit_is_one_sentence(model, change, words):
    with pytest.raises(ArgumentError, match=f"^deviations: .*{words}") as error:
        model.evaluate(change(model.sample(3)))
    assert "\n" not in str(error.value)


def test_missing_names_of_a_dict_take_their_means(model):
    found = model.evaluate({"P": [0.7, 0.9]})
    np.testing.assert_array_equal(found.deviations, [[0.7, 2.0], [0.9, 2.0]])
    with pytest.raises(ArgumentError, match="'p' is not a deviation of this scene; did you mean 'P'"):
        model.evaluate({"p": 1.0})


def test_results_are_tables_with_names_and_units(model):
    sampled = model.sample(6)
    found = model.evaluate(sampled)
    table = found.to_frame()
    assert list(table.columns) == ["P", "D", "M", "N", "failed", "built"]
    assert table.attrs["units"] == {"P": "mm", "D": "mm", "M": "mm", "N": "mm"}
    np.testing.assert_array_equal(table[["M", "N"]], found.measurements)
    pd.testing.assert_frame_equal(found.to_frame("deviations"), sampled)
    pd.testing.assert_frame_equal(found.to_frame("measurements"), table[["M", "N"]], check_names=False)
    assert model.evaluate(found.to_frame("deviations")).measurements.tobytes() == found.measurements.tobytes()
    with pytest.raises(ArgumentError, match="table is 'measurement'; did you mean 'measurements'"):
        found.to_frame("measurement")


def test_states_have_names_and_an_enumeration(model):
    found = model.evaluate({"P": [0.8, -0.2]})  # lifted and pressed; lowered and open
    states, contacts = found.resolutions["clamp"], found.to_frame("contacts")
    assert states.state_names.shape == states.state.shape and states.state.dtype == np.int8
    assert [mic.ContactState(code).label for code in states.state.ravel()] == states.state_names.ravel().tolist()
    clamp = contacts[contacts["stage"] == "clamp"]
    assert clamp["state"].tolist() == states.state_names.ravel().tolist()
    np.testing.assert_array_equal(clamp[["f_n", "f_t1", "f_t2"]], states.force.reshape(-1, 3))
    assert set(clamp["zone"]) == {"z"} and {*clamp["state"]} == {"slip", "open"}
    assert [*mic.ContactState] == [0, 1, 2] and [one.name for one in mic.ContactState] == ["OPEN", "STICK", "SLIP"]


def test_a_failed_sample_has_no_key_characteristics_in_the_table():
    rough = dragged(
        deviations=[{"name": "mu", "kind": "friction", "target": "z", "sigma": 0.1}], monte_carlo={"samples": 2}
    )
    found = rough.process().attempt(rough.deviations({"mu": [0.0, -0.5]}))  # a negative coefficient
    table = found.to_frame()
    assert table["failed"].tolist() == [False, True] and table["M"].isna().tolist() == [False, True]


def test_a_name_that_two_columns_would_have_is_told_apart():
    same = {"deviations": [{"name": "M", "kind": "locator", "target": "bl1", "mean": 0.8, "sigma": 0.1},
                           {"name": "failed", "kind": "clamp", "target": "T", "mean": 2.0, "sigma": 0.1}]}  # fmt: skip
    found = dragged(**same).evaluate({"M": 0.7})
    table = found.to_frame()
    assert list(table.columns) == ["deviation M", "deviation failed", "M", "N", "failed", "built"]
    assert table["deviation M"].tolist() == [0.7] and table["M"].tolist() == found.measurements[:, 0].tolist()
    assert table.attrs["units"]["deviation M"] == "mm"
    assert list(found.to_frame("deviations").columns) == ["M", "failed"]


def test_a_scene_without_deviations_or_measurements_has_tables_too():
    bare = clamped("ab", 0.0)
    found = bare.evaluate(bare.sample(3))
    assert found.to_frame().shape == (3, 2) and found.to_frame("measurements").shape == (3, 0)
    assert len(repr(bare).splitlines()) == 5 and pictured(bare) is not None


# ------------------------------------------------------------------------------------------------------------ friction


@pytest.mark.slow
@pytest.mark.parametrize("law", ["coulomb", "associated", "frictionless"])
def test_another_friction_gives_the_bits_of_a_scene_with_that_friction(model, law):
    x = model.sample(4)
    for mu in (0.0, 0.1, 0.55):
        expected = dragged(friction=mu).evaluate(x, law)
        for found in (model.evaluate(x, law, friction=mu), model.with_friction({"z": mu}).evaluate(x, law)):
            assert found.measurements.tobytes() == expected.measurements.tobytes()
            assert found.resolutions["clamp"].force.tobytes() == expected.resolutions["clamp"].force.tobytes()
    assert model.with_friction(0.1).scene.zones[0].friction == 0.1 and model.scene.zones[0].friction == 0.3
    assert model.with_friction(0.1).scene == dragged(friction=0.1).scene


def test_friction_of_one_zone_leaves_the_others():
    two = clamped("abc", 0.0, friction={"default": 0.2, "clamp": 0.4})
    found = two.with_friction({"z2": 0.1})
    np.testing.assert_array_equal(found.contacts.friction, [[0.2, 0.1]])
    assert found.scene.zones[0] == two.scene.zones[0] and found.scene.zones[1].friction == 0.1


@pytest.mark.parametrize(
    ("friction", "words"),
    [(-0.1, "at least 0"), ("x", "give a number"), (11.0, "at most 10"), (np.nan, "finite"), ([0.1], "a list"),
     ({"Z": 0.1}, "no contact zone called 'Z'; did you mean 'z'"), (True, "give a number")],
)  # fmt: skip
def test_an_invalid_friction_is_one_sentence(model, friction, words):
    with pytest.raises(ArgumentError, match=f"^friction: .*{words}") as error:
        model.evaluate({}, friction=friction)
    assert "\n" not in str(error.value)


def test_a_coefficient_replaces_friction_by_pressure(model):
    zone = {"name": "z", "parts": ["b", "t"], "friction_table": [[0.0, 0.5], [50.0, 0.4]], "pairs": 1}
    table = dragged(zones=[zone])
    pieces = table.scene.zones[0].pressure_pieces()[None]
    table = replace(table, contacts=replace(table.contacts, pressure=pieces))
    x = table.sample(3)
    expected = model.evaluate(x, "pressure-dependent", friction=0.1).measurements
    assert np.abs(table.evaluate(x, "pressure-dependent").measurements - expected).max() > 1e-3
    found = table.with_friction(0.1)
    assert found.evaluate(x, "pressure-dependent").measurements.tobytes() == expected.tobytes()
    assert found.scene.zones[0].friction_table is None and found.scene.zones[0].pressure_pieces() is None


def test_a_model_without_tangential_rows_takes_no_friction():
    smooth = two_plates(0.1, friction=0.0)
    normal = replace(smooth, contacts=replace(smooth.contacts, dimension=1))
    with pytest.raises(ArgumentError, match="has no friction, and no tangential contact rows; give a zone friction"):
        normal.with_friction(0.2)


# ------------------------------------------------------------------------------------------------------------ progress


def test_a_bar_is_shown_on_request_and_changes_no_bit(model, capsys):
    x = model.sample(45)
    expected = model.evaluate(x)
    assert capsys.readouterr().err == ""
    assert model.evaluate(x, progress=False).measurements.tobytes() == expected.measurements.tobytes()
    assert capsys.readouterr().err == ""
    found = model.evaluate(x, progress=True)
    assert "45/45 evaluations" in capsys.readouterr().err
    assert found.measurements.tobytes() == expected.measurements.tobytes()
    assert found.resolutions["clamp"].force.tobytes() == expected.resolutions["clamp"].force.tobytes()
    assert isinstance(found, Evaluation) and len(model.evaluate([], progress=True).failed) == 0


def test_the_bar_of_an_interactive_session_waits_a_second_and_can_be_turned_off(monkeypatch, capsys):
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    for interactive, progress, seconds, shown in (
        (True, None, 0.9, False),
        (True, None, 1.1, True),
        (True, False, 9.0, False),
        (False, None, 9.0, False),
        (False, True, 0.1, True),
    ):
        monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)
        if not interactive:
            monkeypatch.delattr(sys, "ps1")
        now = 0.0
        with ProgressBar(progress, 4) as bar:
            now = seconds
            bar.advance(1)
        text = capsys.readouterr().err
        assert ("1/4 evaluations" in text) == shown and (not shown) == (text == ""), (interactive, progress, seconds)


@pytest.mark.slow
def test_studies_show_a_bar_on_request_and_still_report_to_a_function(model, capsys):
    shown = {"contributors": {"samples": 4}, "friction": {"samples": 3}}
    for name, options in shown.items():
        getattr(mic, name)(model, **options, progress=False)
        assert capsys.readouterr().err == "", name
        counts = []
        getattr(mic, name)(model, **options, progress=counts.append)
        assert capsys.readouterr().err == "" and sum(counts) > 0, name
        getattr(mic, name)(model, **options, progress=True)
        assert f"{sum(counts)} evaluations" in capsys.readouterr().err, name
    with pytest.raises(ArgumentError, match="progress is 3; give True or False"):
        mic.contributors(model, progress=3)
