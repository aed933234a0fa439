"""The page of a check: one file, all that the scene places on the parts, gaps as a map, warnings beside it."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.pages import unpacked
from typer.testing import CliRunner

from mic.model.assembly import assemble
from mic.options import app
from mic.process.plan import plan_assembly
from mic.studies.check_results import CheckResults
from mic.system.foreign_files import ALSO_READ

LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def checked(tmp_path, cache, *edits, page=None, strict=False, error=None):
    """The page of a check of the lap joint, edited, on coarse meshes and with few pairs; what it draws; the output."""
    text = (LAP / "scene.toml").read_text().replace("friction = 0.27", "friction = 0.27\npairs = 6")
    for old, new in (('size = "medium"', 'size = "coarse"'), *edits):
        assert old in text
        text = text.replace(old, new)
    folder = tmp_path / "scene"
    folder.mkdir(parents=True)
    (folder / "scene.toml").write_text(text)
    shutil.copy(LAP / "geometry.py", folder)
    arguments = ["check", str(folder), *(["--page", str(page)] if page else []), *(["--strict"] if strict else [])]
    done = CliRunner().invoke(app, arguments, env={"MIC_CACHE": str(cache), "COLUMNS": "200"})
    page = page or tmp_path / "results" / "lap-joint" / "check.html"
    html = page.read_text() if page.is_file() else ""
    assert (error is None and done.exit_code == 0) or error in str(done.exception)
    data = re.search(r'<script type="text/plain" id="viewer-data">(.*?)</script>', html, re.S)
    return html, unpacked(data.group(1)) if data else None, done.output


@pytest.mark.slow
def test_all_that_the_scene_places_is_drawn_with_its_name(tmp_path, cache):
    """Both sheets are 0.9 mm thick, and their mid-surfaces 1 mm apart."""
    html, data, output = checked(tmp_path, cache, ("thickness = 1\nyoung", "thickness = 0.9\nyoung"))
    assert output.startswith("Reading ")  # before anything slow is imported
    assert "page: results/lap-joint/check.html" in output and "The scene is valid. </b>" not in html
    assert not (tmp_path / "scene" / "check.html").exists()
    assert [part["name"] for part in data["parts"]] == ["lower", "upper"]
    arrows = {group["name"]: [item["label"] for item in group["items"]] for group in data["arrows"]}
    assert len(arrows["locators"]) == 12 and arrows["clamps"][0] == "clamp C1-upper on upper, 60 N, stage clamp"
    assert "locator upper-C1 on upper, stage locate, D1: 0.05 ± 0.02" in arrows["locators"]
    assert arrows["corrective forces"] == ["force F1 on upper: -5 ± 1.5 N", "force F2 on lower: 2 ± 1 N"]
    points = {group["name"]: group for group in data["points"]}
    assert points["welds"]["labels"] == ["weld W1", "weld W2"] and len(points["measurements"]["points"]) == 2
    assert len(points["lap: gap"]["points"]) == 6 and points["lap: gap"]["labels"][0] == "lap, pair 0: gap 0.1 mm"
    gaps = points["lap: gap"]["values"], (data["map"]["low"], data["map"]["high"], data["map"]["scale"])
    assert gaps == (pytest.approx([0.1] * 6), (0.0, pytest.approx(0.1), "viridis"))
    assert "warnings" not in points and "<b>The scene is valid.</b>" in html
    assert "clamps C1-upper and C1-lower close" in html
    assert not re.search(r"(src|href)=[\"'](?!#)(?!data:)", html.split("<script>")[0]), "it needs another file"


@pytest.mark.slow
def test_overlap_lies_below_zero_in_the_map_of_gaps(tmp_path, cache):
    _, data, _ = checked(tmp_path, cache, ("thickness = 1\nyoung", "thickness = 1.2\nyoung"))
    (group,) = [group for group in data["points"] if "values" in group]
    assert group["values"] == pytest.approx([-0.2] * 6) and group["first"] and "overlap 0.2 mm" in group["labels"][0]
    assert data["map"]["low"] == pytest.approx(-0.2) and data["map"]["high"] == pytest.approx(0.2)
    assert data["map"]["scale"] == "RdBu_r" and data["map"]["title"].startswith("gap (mm)")


@pytest.mark.slow
def test_warnings_stand_beside_the_view_and_end_a_strict_check(tmp_path, cache):
    edits = (("force = 60", "force = 60000"), ("young = 210000", "young = 210"))
    html, data, output = checked(tmp_path / "a", cache, *edits, page=tmp_path / "here.html")
    verdict = "Implausible: 6 warnings, 2 of values that no assembly has."
    assert verdict in html and output.rstrip().endswith(verdict)
    assert output.index("implausible: part lower: young = 210 MPa") < output.index("Parts")
    assert "warning: part lower: young = 210 MPa" in output
    items = re.findall(r"<li>([^:<]*): (?:young|force|its 1 σ)", html)
    assert items == ["part lower", "part upper", "clamp C1-upper", "clamp C1-lower", "deviation F1", "deviation F2"]
    (group,) = [group for group in data["points"] if group["name"] == "warnings"]
    assert [re.sub("<.*?>", "", text) for text in group["numbers"]] == ["3, 4", "5", "6"]  # near ones: a ring
    assert group["labels"] == ["3. clamp C1-upper<br>4. clamp C1-lower", "5. deviation F1", "6. deviation F2"]
    assert group["points"] == [[72.0, 12.5, 1.0], [60.0, 25.0, 1.0], [100.0, 0.0, 0.0]]
    error = "part lower: young = 210 MPa; usual is "
    *_, output = checked(tmp_path / "b", cache, *edits, page=tmp_path / "strict.html", strict=True, error=error)
    assert verdict not in output


@pytest.mark.slow
def test_a_scene_that_is_not_valid_is_drawn_as_far_as_it_can_be_after_its_warnings(tmp_path, cache):
    """A warning may say why it is not valid."""
    moved, young = ("point = [88, 6, 0.5]", "point = [88, 60, 0.5]"), ("young = 210000", "young = 210")
    html, data, output = checked(tmp_path, cache, moved, young, error="welds[0].point (W1)")
    assert re.search(r"Not valid: 1 error, [2-9] warnings", html) and "welds[0].point (W1)" in html
    assert "the nearest point on it is (88, 25, 0)" in html
    assert len(data["parts"]) == 2 and not [group for group in data["points"] if "values" in group]
    assert "page: results/lap-joint/check.html" in output
    assert "warning: part lower: young = 210 MPa; usual is " in output


PAD = """
[[fixtures]]
name = "pad"
part = "lower"
point = [60, 12.5, 0]
normal = [0, 0, 1]
radius = 5

[[zones]]
name = "on-the-pad"
parts = ["pad", "lower"]

[[fixtures]]
name = "block"
mesh = "block.stl"

[[locators]]
name = "lower-A1"
"""


@pytest.mark.slow
def test_fixtures_are_drawn_unless_their_mesh_is_missing(tmp_path, cache, monkeypatch):
    """A block from a file; a pad that is set against a part, and hence only where that is meshed; neither, if not."""
    monkeypatch.setenv(ALSO_READ, str(tmp_path))
    edit = ('[[locators]]\nname = "lower-A1"\n', PAD)
    block = "solid b\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 -5\n   vertex 9 0 -5\n   vertex 0 9 -5\n"
    (tmp_path / "block.stl").write_text(block + "  endloop\n endfacet\nendsolid b\n")
    there = ('mesh = "block.stl"', f'mesh = "{tmp_path / "block.stl"}"')
    _, data, output = checked(tmp_path / "a", cache, edit, there, page=tmp_path / "a.html")
    assert [part["name"] for part in data["parts"]] == ["lower", "upper", "pad", "block"]
    assert "touches lower at (60, 12.5, -0.5), facing along (0, 0, 1)" in output
    html, data, _ = checked(tmp_path / "b", cache, edit, page=tmp_path / "b.html", error="there is no file")
    assert [part["name"] for part in data["parts"]] == ["lower", "upper"] and "there is no file" in html


def test_a_page_without_any_part_has_a_message(tmp_path, cache):
    nowhere = ('geometry = "geometry.py"', 'geometry = "none.py"')
    html, data, _ = checked(tmp_path, cache, nowhere, error="there is no file")
    assert data is None and "No part could be read" in " ".join(html.split()) and html.count("there is no file") == 2


def test_a_page_that_cannot_be_written_is_no_error_of_the_scene(tmp_path, cache):
    (tmp_path / "results").write_text("a file, where the folder would be")
    html, _, output = checked(tmp_path, cache)
    assert html == "" and "The scene is valid." in output
    assert "no page: " in output and "name another file with --page" in output


@pytest.mark.slow
def test_a_second_check_solves_nothing_and_a_changed_scene_is_solved(lap_model, cache, monkeypatch):
    def results(scene):
        return CheckResults(assemble(scene, cache, check=plan_assembly), cache)

    scene, reseeded = lap_model.scene, lap_model.scene.monte_carlo.model_copy(update={"seed": 5})
    first = results(scene)
    samples, page = first.rough_samples(), first.page(["one"], lambda: "ä page")
    assert first.solvable and samples.solved == samples.count and samples.mean.shape == (2,)

    def refuse(*_):
        raise NotImplementedError

    monkeypatch.setattr("mic.studies.check_results.few_samples", refuse)
    again = results(scene)
    np.testing.assert_equal(vars(again.rough_samples()), vars(samples))
    assert again.page(["one"], refuse) == page == "ä page"
    changed = results(scene.model_copy(update={"monte_carlo": reseeded}))
    for other in (lambda: again.page(["two"], refuse), changed.rough_samples):
        with pytest.raises(NotImplementedError):
            other()
