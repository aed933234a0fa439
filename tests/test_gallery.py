"""The gallery's pages on the commands run, and end in what they promise; every question has one."""

import re
import runpy
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest

import mic
from mic.contact import native
from mic.report.picture import Picture
from mic.report.study_pictures import STUDIES
from mic.scene import load_scene
from verification.scenes import with_stated_pairs

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "gallery"
#: By page: names of the pictures of the report that it leaves, and words that it prints.
PAGES = {
    "compare": (("changes", "distributions"), ("zones.lap.friction: 0.27 → 0.135",)),
    "contributors": (("shares", "changes"), ("opened all together",)),
    "explain": (("sources", "reached"), ("F2  4.74",)),
    "explore": (("clamped", "compensated"), ('target = "lower-A3"', "Solved in all stages")),
    "friction": (("changes",), ("Friction has little effect: without it, each mean and each 6σ",)),
    "optimise": (("changes", "search"), ("least Cpk",)),
    "predict": (("intervals",), ("rejected", "within all limits", "still")),
    "rare": (("probabilities", "likeliest"), ("first_order", "levels")),
    "remedy": (("effect",), ("locators.upper-", "True")),
    "sensitivity": (("steps",), ("locators.lower-A3", "from the next change")),
}
#: Questions that stand on another's page.
BESIDE = {"order": "contributors", "run": "wheelhouse"}


def test_every_function_that_has_pictures_has_a_page_that_shows_them():
    for study in STUDIES:
        page = (FOLDER / f"{BESIDE.get(study.command, study.command)}.py").read_text(encoding="utf-8")
        assert f"mic.{study.command}(" in page or f"runs.{study.command}(" in page, study.command
        assert "from mic.report" in page, study.command
    assert {study.command for study in STUDIES} == {*PAGES, *BESIDE}


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_each_gallery_page_runs_and_shows_its_pictures(page, cache, monkeypatch, capsys):
    monkeypatch.setenv("MIC_CACHE", str(cache))
    monkeypatch.setattr(plt, "show", lambda: None)
    monkeypatch.setattr(mic, "load_scene", lambda path: with_stated_pairs(load_scene(path)))  # few
    with matplotlib.rc_context({"backend": "agg"}):
        plt.close("all")
        try:
            left = runpy.run_path(str(FOLDER / f"{page}.py"))
            assert not plt.get_fignums(), "a page shows what the report draws"
        finally:
            plt.close("all")
    pictures, words = PAGES[page]
    for name in pictures:
        assert isinstance(left[name], Picture) and left[name].uri.startswith("data:image/svg+xml")
    said = capsys.readouterr().out
    for word in words:
        assert word in said, said


def test_the_page_on_load_paths_names_modules_of_the_core_and_shows_a_small_error(monkeypatch):
    page = FOLDER / "followed_path.py"
    for module in re.findall(r"`(\w+\.py)`", page.read_text(encoding="utf-8")):
        assert (Path(native.__file__).parent / module).is_file(), module
    with matplotlib.rc_context({"backend": "agg"}):
        left = runpy.run_path(str(page))
        plt.close("all")
    assert left["error"].max() < 1e-3 * left["forces"].max() and set(left["states"].ravel()) == {0, 1, 2}
