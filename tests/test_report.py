"""The report: whole, self-contained, and written for any scene."""

import base64
import html
import importlib
import json
import pkgutil
import re
import shutil
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest
from support.pages import elements, make_texts_hostile, unpacked
from support.runs import all_fail, edit, fail
from support.studies import left_by_studies

import mic.report
from mic.contact import ContactSolver
from mic.geometry.surface import Surface
from mic.report.background_pictures import NAMES, BackgroundPictures
from mic.report.context import read_context
from mic.report.law_pictures import law_cost
from mic.report.mesh_decimation import thinned
from mic.report.page import write_report
from mic.report.picture_registry import PICTURES, draw, draw_all
from mic.report.study_pictures import pictures
from mic.report.style import LAWS, LIMIT_COLOUR, RC, change, number, percent
from mic.results.fields import write_fields
from mic.results.outcome import read_outcome
from mic.results.run_folder import PUBLISHED, RunFolder
from mic.results.schema import (
    CONTRIBUTORS,
    FRICTION,
    LINEARITY,
    PATH,
    PATH_ERRORS,
    RESOLUTIONS,
    STUDIES,
    checksum_path,
)
from mic.runs import run
from mic.scene import Scene
from mic.studies.contributors import Contributors, contributors

WHEELHOUSE = Path(__file__).resolve().parents[1] / "meshes" / "wheelhouse"
SAMPLES = 40


class _Page:
    """Collects the elements of a page and what it would load."""

    def __init__(self, path):
        self.source = path.read_text(encoding="utf-8")
        self.scripts = dict(re.findall(r'<script type="text/plain" id="(.*?)">(.*?)</script>', self.source, re.S))
        still = re.sub(r"<script.*?</script>", "", self.source, flags=re.S)
        self.ids = set(re.findall(r'\bid="([^"]*)"', still))
        self.loads = re.findall(r'\b(?:src|href|srcset|data|action|poster)="([^"]+)"', still)
        for style in re.findall(r'<style>.*?</style>|\bstyle="[^"]*"', still, re.S):
            self.loads += re.findall(r"url\([^)]*\)|@import[^;]+", style)
        text = re.sub(r"<style>.*?</style>|<[^>]*>", " ", still, flags=re.S)
        self.words = " ".join(html.unescape(text).split())


def _results(scene, cache, folder, samples):
    """Run a scene into a folder; returns its model."""
    monte_carlo = scene.monte_carlo.model_copy(update={"samples": samples, "seed": 2})
    model = run(scene.model_copy(update={"monte_carlo": monte_carlo}), folder, cache).model
    write_fields(folder)
    return model


def _store_studies(folder, model):
    found = contributors(model, samples=16)
    tables = {CONTRIBUTORS: found.table, LINEARITY: found.linearity} | left_by_studies(model.scene)[0]
    for table, frame in tables.items():
        table.write(folder, frame)


def _files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _changed(scene, **changes):
    """The scene with tables replaced, validated again."""
    return Scene(**scene.model_dump() | changes | {"folder": scene.folder})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("run")


def refuse(*_, **__):
    raise AssertionError("drawing solves")


@pytest.fixture(scope="module")
def drawn(lap_scene, cache, folder):
    """The page of a run under all laws; its pictures by name; the files that it adds, and those that it changes.

    Drawing that solves fails.
    """
    ends = [item.point for item in lap_scene.measurements]
    tip = {"name": "tip", "kind": "profile", "part": "upper", "points": ends, "upper": 2.0}
    scene = _changed(
        lap_scene,
        description="Two <b>strips</b> & a weld",
        measurements=[*lap_scene.model_dump()["measurements"], tip],
        report={"laws": ["coulomb", "associated", "frictionless"], "fields": True},
    )
    model, pictures = _results(scene, cache, folder, SAMPLES), {}
    _store_studies(folder, model)
    before = _files(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mic.report.page.draw_all", lambda *given: pictures.update(draw_all(*given)) or pictures)
        patch.setattr(ContactSolver, "solve", refuse)
        for name in ("process", "evaluate"):
            patch.setattr(type(model), name, refuse)
        page = _Page(write_report(folder))
    after = _files(folder)
    return page, pictures, after.keys() - before.keys(), [path for path in before if before[path] != after[path]]


@pytest.fixture(scope="module")
def page(drawn):
    return drawn[0]


@pytest.fixture(scope="module")
def every_picture(drawn):
    return drawn[1]


@pytest.fixture(scope="module")
def outcome(page, folder):
    return read_outcome(folder)


@pytest.fixture(scope="module")
def context(outcome):
    return read_context(outcome)


@pytest.fixture
def copied(page, folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "copy")


@pytest.fixture
def given_pictures(monkeypatch):
    """The pictures, by name, that pages show in this test, which is about their words: drawing takes seconds."""
    pictures = {}
    monkeypatch.setattr("mic.report.page.draw_all", lambda *_: pictures)
    return pictures


@pytest.mark.slow
def test_the_page_loads_nothing_and_escapes_the_text_of_the_scene(page):
    assert page.loads and all(target.startswith(("#", "data:image/")) for target in page.loads)
    assert "default-src 'none'" in page.source and len(page.source) < 3e6  # the browser is told so
    assert "<b>strips</b>" not in page.source and "Two <b>strips</b> & a weld" in page.words
    assert {entry.name for entry in PICTURES if entry.section not in ("fields", "still")} <= page.ids


@pytest.mark.slow
def test_hostile_texts_change_no_element_of_the_page(copied, given_pictures, monkeypatch):
    plain = elements(write_report(copied))
    make_texts_hostile(monkeypatch)
    assert elements(write_report(copied)) == plain


@pytest.mark.slow
@pytest.mark.fem
def test_every_picture_stands_once_in_the_page_of_a_full_run(page, outcome, every_picture, monkeypatch):
    assert list(every_picture) == [entry.name for entry in PICTURES]
    tables = {"assembly-view", "table-1", "path-table", "slip-table", "measurement-table", "field-view"}
    assert page.ids >= {"assembly", *tables, *(entry.name for entry in PICTURES if entry.section != "still")}
    for name, picture in every_picture.items():
        assert page.loads.count(picture.uri) == 1, name
        kind, how, data = re.fullmatch(r"data:image/(svg\+xml|png);(base64|charset=utf-8),(.*)", picture.uri).groups()
        assert (kind == "png") == (how == "base64")
        raw = base64.b64decode(data, validate=True) if how == "base64" else unquote(data).encode()
        assert raw.startswith(b"\x89PNG") if kind == "png" else ElementTree.fromstring(raw).tag.endswith("svg")
        assert len(raw) > 3000
    monkeypatch.setattr("mic.report.study_pictures.draw_all", lambda *_: every_picture)
    assert pictures(outcome) == [*every_picture.values()]


@pytest.mark.slow
@pytest.mark.fem
def test_the_viewer_has_the_surfaces_and_fields(page, context):
    data = unpacked(page.scripts["viewer-data"])
    assert [part["name"] for part in data["parts"]] == ["lower", "upper"]
    assert data["laws"] == ["coulomb", "associated", "frictionless"]
    whole = lambda numbers: np.frombuffer(base64.b64decode(numbers["data"]), dtype="<u2")
    told = {(field.part, field.law): field for field in context.fields}
    for part in data["parts"]:
        vertices = len(whole(part["points"])) // 3
        for law, field in part["fields"].items():
            assert {name: len(whole(own)) for name, own in field.items()} == dict.fromkeys(
                ("mean", "mean_normal", "six_sigma", "six_sigma_normal"), vertices
            )
            own = field["six_sigma"]
            wanted = told[part["name"], law].six_sigma_magnitude  # so small a part is not thinned
            np.testing.assert_allclose(own["low"] + own["step"] * whole(own), wanted, atol=own["step"])
    assert {group["name"] for group in data["arrows"]} >= {"locators"}


def test_a_thinned_surface_keeps_its_outline_and_its_area():
    """A sheet of 150 × 100 mm in squares of 1 mm, thinned to a tenth of its vertices."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(151.0), np.arange(101.0), indexing="ij"))
    corner = (np.arange(150)[:, None] * 101 + np.arange(100)).ravel()
    triangles = np.concatenate([corner[:, None] + [0, 101, 102], corner[:, None] + [0, 102, 1]])
    sheet = Surface(np.column_stack([x, y, 0.1 * np.sin(x)]), triangles)
    kept, thin = thinned(sheet, 1500)
    assert 1000 < len(kept) <= 1500 and (np.diff(kept) > 0).all() and set(thin.ravel()) == set(range(len(kept)))
    own = Surface(sheet.points[kept], thin)
    assert own.areas.sum() == pytest.approx(sheet.areas.sum(), rel=0.02)
    np.testing.assert_array_equal([own.points.min(axis=0)[:2], own.points.max(axis=0)[:2]], [[0, 0], [150, 100]])
    assert (own.normals[:, 2] > 0.9).all()
    same, triangles_of_all = thinned(sheet, len(sheet.points))
    assert len(same) == len(sheet.points) and triangles_of_all is sheet.triangles


@pytest.mark.slow
def test_figures_in_the_text_are_those_of_the_summary(page, folder, outcome):
    laws = json.loads((folder / "summary.json").read_text())["laws"]
    zone = laws["coulomb"]["zones"]["lap"]
    names = ("mean_rms_tangential", "six_sigma_rms_tangential", "mean_rms_slip", "six_sigma_rms_slip")
    for value in (*(zone[name] for name in names), zone["mean_friction_work"]):
        assert number(value) in page.words
    assert number(laws["associated"]["measurements"]["M1"]["mean"]) in page.words
    cost = law_cost(outcome, "clamp")
    assert cost.sentence in page.words and cost.gaps.max() > 0


@pytest.mark.slow
def test_pictures_of_returned_studies_are_those_of_the_page(page, outcome):
    found = left_by_studies(outcome.model.scene)[1]
    driven = Contributors(outcome.study(CONTRIBUTORS), outcome.study(LINEARITY))
    shown = [picture for one in (driven, *found) for picture in pictures(one, outcome.model.scene)]
    assert len(shown) == 9 and shown[-1].title == "Search for the optimum"  # which no run keeps
    for picture in shown[:-1]:
        assert page.loads.count(picture.uri) == 1, picture.title
    assert "On 400 fresh samples the least Cpk 1.250 → 1.500: gain 0.250 (0.125 to 0.375)" in page.words
    assert "On the 60 samples of the search: 1.625, after 1234 evaluations." in page.words
    assert "force C1 60 75" in page.words and {"optimum-table", "orders", "misses", "optimum"} <= page.ids


@pytest.mark.slow
def test_the_page_shows_path_errors_and_rescued_samples(copied, outcome, given_pictures):
    """Nothing is known of the placeholder's errors; so they are written into a copy."""

    def marked(frame):
        clamped = frame["stage"] == "clamp"
        error = np.where(clamped, 0.0042 * (1 + frame["sample"] % 4), 0.0)
        return frame.assign(rescued=clamped & frame["sample"].isin([2, 5, 7]), path_error=error)

    edit(copied, RESOLUTIONS, "coulomb", marked)
    pairs, errors = outcome.path_study.pairs.copy(), outcome.path_study.errors.copy()
    moved = (pairs["law"] == "coulomb") & (pairs["quantity"] == "measurement") & (pairs["name"] == "M1")
    pairs.loc[moved, "tighter"] = pairs.loc[moved, "value"] + 0.0123
    PATH.write(copied, pairs, exact=True)
    errors.loc[errors["law"] == "coulomb", ["estimate", "measured"]] = [0.006, 0.002]
    PATH_ERRORS.write(copied, errors, exact=True)
    changed = read_outcome(copied)
    picture = given_pictures["path-error"] = draw("path-error", changed, read_context(changed))
    words = _Page(write_report(copied)).words
    share = changed.summary()["laws"]["coulomb"]["measurements"]["M1"]["mean_path_share"]
    assert f"path +12 µm (+{percent(share, 1)})" in words
    assert "rescued" in words and changed.rescued["coulomb"] == [2, 5, 7]
    assert "largest 17 µm in clamp" in picture.caption and "change on a tighter path in 24" in picture.caption
    assert "(median of estimate over change: 3.0" in picture.caption
    assert picture.caption in words


@pytest.mark.slow
def test_captions_state_work_and_contact_states_along_the_path(page, outcome, every_picture):
    table = outcome.zone_statistics.set_index(["law", "stage"])
    work, states = every_picture["friction-work"].caption, every_picture["path-states"].caption
    assert f"{number(table.loc[('coulomb', 'clamp'), 'mean_friction_work'])} N mm in clamp" in work
    open_ = np.mean([table.loc[("coulomb", stage), "open"] for stage in outcome.stages])
    assert f"coulomb: {percent(open_)} open" in states
    assert "frictionless" not in work + states  # where nothing holds, nothing slips under load
    assert work in page.words and states in page.words


def test_every_picture_that_can_be_drawn_is_in_the_report():
    """A function that is called a picture and that no entry calls would never be seen, nor one of a section that the
    template does not show."""
    shown = {getattr(entry.function, "func", entry.function) for entry in PICTURES}
    found = set()
    for module in pkgutil.iter_modules(mic.report.__path__, "mic.report."):
        if module.name.endswith("_pictures"):
            content = vars(importlib.import_module(module.name))
            found |= {thing for name, thing in content.items() if name.endswith("_picture")}
    assert found and found == shown
    template = Path(mic.report.__file__).with_name("report.html").read_text(encoding="utf-8")
    assert {entry.section for entry in PICTURES} == {*re.findall(r'gallery\("(\w+)"\)', template), "still"}


@pytest.mark.slow
def test_a_picture_is_the_same_whatever_the_users_style(outcome, context, every_picture):
    with matplotlib.rc_context({"font.size": 30, "axes.facecolor": "black", "lines.linewidth": 9}):
        other = draw("measurements", outcome, context)
    assert every_picture["measurements"] == other


@pytest.mark.slow
def test_of_many_samples_the_first_are_drawn_and_the_captions_say_so(outcome, context, every_picture, monkeypatch):
    law, zone = context.laws[0], outcome.zones[0]
    first = outcome.sample_numbers(law)[:7]
    np.testing.assert_array_equal(
        outcome.tangential(law, context.stage, zone, first), outcome.tangential(law, context.stage, zone)[:7]
    )
    captions = {
        "tangential-density": "over the first 7 samples",
        "law-cost": "Over the first 7 samples valid",
        "measurements": "Histograms of the first 7 samples.",
    }
    for module in ("contact", "law", "measurement"):
        monkeypatch.setattr(f"mic.report.{module}_pictures.SHOWN", 7)
    for name, words in captions.items():
        few, whole = draw(name, outcome, context), every_picture[name]
        assert words in few.caption and "first" not in whole.caption and whole.data != few.data
    assert len(law_cost(outcome, context.stage).coulomb) == 7


@pytest.mark.slow
def test_laws_under_scaled_friction_are_drawn_from_the_stored_study(copied, context):
    path, study = copied / "tables" / "friction.csv", read_outcome(copied).friction_study
    study.loc[study["law"] == "associated", "gap_at_load"] = 0.0123
    FRICTION.write(copied, study, exact=True)
    changed = draw("friction", read_outcome(copied), context)
    path.unlink()
    assert "averages 12.3 µm at μ" in changed.caption and "12 samples" in changed.caption
    assert draw("friction", read_outcome(copied), context) is None


@pytest.mark.slow
def test_writing_a_report_solves_nothing_and_changes_no_other_file(drawn, folder):
    _, _, added, changed = drawn
    assert {path.name for path in added} == {"report.html", "assembly.png"} and not changed
    assert (folder / "assembly.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_pictures_of_a_run_whose_first_law_failed_throughout(copied):
    all_fail(copied, "coulomb", SAMPLES)
    _remove_studies(copied)
    summary = read_outcome(copied).summary()["laws"]["coulomb"]
    assert summary["zones"]["lap"]["mean_rms_tangential"] is None and summary["worst_residual"] is None
    assert f"coulomb: not converged ({SAMPLES})" in _Page(write_report(copied)).words


def _remove_studies(folder):
    """Remove the tables of studies, whose pictures do not depend on the samples."""
    for table in STUDIES:
        table.remove(folder)


@pytest.mark.slow
def test_pictures_begun_before_tables_and_fields_are_written_are_those_of_the_page(
    folder, every_picture, tmp_path, monkeypatch
):
    monkeypatch.setattr("mic.report.background_pictures.forked_workers", lambda: 3)  # whatever this machine has
    early = shutil.copytree(folder, tmp_path / "early", ignore=shutil.ignore_patterns("fields", "tables"))
    (early / "tables").mkdir()
    for table in (PATH, PATH_ERRORS):  # are written before
        for path in (folder / table.place, checksum_path(folder / table.place)):
            shutil.copy(path, early / "tables" / path.name)
    ahead = BackgroundPictures(read_outcome(early))
    try:
        found = ahead.pictures()
    finally:
        ahead.end()
    assert {name for name, picture in found.items() if picture} == set(NAMES) & set(every_picture)
    assert all(picture == every_picture[name] for name, picture in found.items() if picture)


@pytest.mark.slow
def test_a_law_has_one_colour_in_pictures_and_tables(page, outcome, every_picture):
    for law in outcome.laws:
        assert f'style="--mark:{LAWS[law].colour}"><b>{law}</b>' in page.source
    colours = set(re.findall(r"#[0-9a-f]{6}", every_picture["measurements"].data.decode()))
    neutral = {"#000000", "#ffffff", RC["axes.edgecolor"], RC["grid.color"], LIMIT_COLOUR}
    assert colours - neutral == {LAWS[law].colour for law in outcome.laws}
    assert len({look.colour for look in LAWS.values()}) == len({look.mark for look in LAWS.values()}) == len(LAWS)


@pytest.mark.slow
def test_published_figures_wall_time_and_failed_samples_stand_in_the_page(copied, page, given_pictures):
    """The paper's figures come from a file beside the scene; nothing about them is in the program."""
    published = (WHEELHOUSE / PUBLISHED).read_text(encoding="utf-8").replace("zones.CZ1", "zones.lap")
    (copied / PUBLISHED).write_text(published, encoding="utf-8")
    fail(copied, "frictionless", {7: ("clamp", "not converged"), 11: ("release", "overflow in a product")})
    record = RunFolder(copied).record()
    RunFolder(copied).write_record(record | {"samples": 100, "wall_time": {"Monte Carlo": 12.34}})
    outcome = read_outcome(copied)
    given_pictures["slip-force"] = draw("slip-force", outcome, read_context(outcome))  # shows a published range
    words = _Page(write_report(copied)).words
    assert "0.9582" in words and "0.2529" not in words  # CZ3 is no zone of this scene
    assert "another, proprietary geometry" in words and "0.9582" not in page.words
    assert "measured range" not in page.words and "by −57 % in the paper" in words
    assert "7 (clamp, residual" in words and "exclude this sample from statistics" in words
    assert "frictionless: overflow in a product" in words and "11 (release, residual" in words
    assert "60 of 100 samples are missing" in words
    assert "Monte Carlo 12.3" in words and f"numpy {record['versions']['numpy']}" in words


NORMALS_ONLY = {"measurements": [], "report": {"laws": ["frictionless"], "slip": False}}
TWO_LAWS = {"report": {"laws": ["coulomb", "frictionless"]}}


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes, samples, absent, present",
    [
        (
            {"zones": []} | TWO_LAWS,
            3,
            {"table-1", "tangential-density", "states", "law-cost", "path-table"},
            {"assembly", "measurements"},
        ),
        (
            NORMALS_ONLY,
            3,
            {"table-1", "slip-force", "law-cost", "slip-table", "path-states", "friction-work", "path-table"}
            | {"field-view", "displacement-fields", "measurements", "measurement-table"},
            {"one-sample-f", "states", "fields"},
        ),
        (TWO_LAWS, 1, set(), {"table-1", "one-sample-u", "measurement-table", "tangential-density", "measurements"}),
    ],
    ids=["no zones", "normals only, no measurements", "one sample, in which nothing varies and nothing is released"],
)
def test_reports_of_bare_scenes(changes, samples, absent, present, lap_scene, cache, tmp_path):
    if samples == 1:
        stages = [stage.model_dump() for stage in lap_scene.stages if stage.kind != "release"]
        changes = changes | {"stages": stages, "deviations": []}
    _results(_changed(lap_scene, **changes), cache, tmp_path, samples)
    page = _Page(write_report(tmp_path))
    assert not page.ids & absent and page.ids >= present
    assert "nan" not in page.words.lower().split()
    assert "does not request them" in page.words
    assert ("1 (clamp)" in page.words) == (samples == 1)


@pytest.mark.slow
def test_report_of_a_run_with_no_finished_sample(copied):
    for path in copied.glob("samples/*/*"):
        path.unlink()
    _remove_studies(copied)
    assert f"{SAMPLES} of {SAMPLES} samples are missing" in _Page(write_report(copied)).words


@pytest.mark.parametrize(
    "shown, text",
    [
        *((number(0.012345), "0.0123"), (number(-4.2), "−4.20"), (number(123456), "1.23e+05"), (number(0), "0")),
        *((number(float("nan")), "–"), (number(None), "–"), (number(float("inf")), "∞"), (number(0.99996), "1.00")),
        *((change(0.0123, 0.031), "+12 µm (+3.1 %)"), (change(-0.0042, -0.5), "−4.2 µm (−50.0 %)")),
        *((change(0.0009, 0.0009), "≤ 1 µm (+0.1 %)"), (change(0.0009, float("nan")), "≤ 1 µm")),
        *((change(-1e-9, -1e-9), "≤ 1 µm (0.0 %)"), (change(0.005, None), "+5.0 µm")),
        *((change(float("nan"), 0.1), "–"), (change(None, None), "–")),
        *((percent(0.125, 1), "12.5 %"), (percent(-0.05), "−5 %"), (percent(float("nan")), "–")),
        *((percent(-0.0004), "0 %"), (percent(-0.0004, 2), "−0.04 %")),
    ],
)
def test_numbers_changes_and_shares_for_people(shown, text):
    assert shown == text
