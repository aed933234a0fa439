"""The report: whole, self-contained, and written for any scene."""

import base64
import gzip
import importlib
import json
import pkgutil
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np
import pytest
from support.pages import unpacked
from support.runs import all_fail, edit, fail
from support.studies import left_by_studies

import mic.report
from mic.contact import ContactSolver
from mic.execution import worker_process
from mic.geometry.surface import Surface
from mic.report.background_pictures import NAMES, BackgroundPictures
from mic.report.context import read_context
from mic.report.law_pictures import law_cost
from mic.report.mesh_decimation import thinned
from mic.report.page import write_report
from mic.report.picture_registry import PICTURES, Entry, draw, draw_all
from mic.report.study_pictures import pictures
from mic.report.style import LAWS, LIMIT_COLOUR, RC, change, number, percent
from mic.report.viewer_data import packed
from mic.results.fields import write_fields
from mic.results.outcome import read_outcome
from mic.results.run_folder import PUBLISHED
from mic.results.schema import CONTRIBUTORS, LINEARITY, PATH, PATH_ERRORS, RESOLUTIONS
from mic.runs import conclude, run
from mic.scene import Scene
from mic.studies.contributors import Contributors, contributors

WHEELHOUSE = Path(__file__).resolve().parents[1] / "meshes" / "wheelhouse"


class _Page(HTMLParser):
    """What a page holds and what it would load."""

    def __init__(self, path):
        super().__init__()
        self.ids, self.loads, self.text, self.scripts, self.headings, self._open = set(), [], [], {}, [], []
        self.source = path.read_text(encoding="utf-8")
        self.feed(self.source)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if tag not in ("meta", "img", "br", "link"):
            self._open.append((tag, attributes))
        if "id" in attributes:
            self.ids.add(attributes["id"])
        self.loads += [
            attributes[key] for key in ("src", "href", "srcset", "data", "action", "poster") if attributes.get(key)
        ]
        self.loads += re.findall(r"url\(([^)]*)\)", attributes.get("style", ""))

    def handle_endtag(self, tag):
        while self._open and self._open.pop()[0] != tag:
            pass

    def handle_data(self, data):
        tag, attributes = self._open[-1] if self._open else ("", {})
        if tag == "script":
            self.scripts[attributes.get("id", len(self.scripts))] = data
        elif tag == "style":
            self.loads += re.findall(r"url\(([^)]*)\)|@import\s+([^;]+)", data)
        else:
            self.text.append(data)

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


def _sampled(scene, samples):
    """The scene with so many samples."""
    monte_carlo = scene.monte_carlo.model_copy(update={"samples": samples, "seed": 2})
    return scene.model_copy(update={"monte_carlo": monte_carlo})


def _results(scene, cache, folder, samples):
    """Everything that a run of a scene leaves behind, and its page."""
    model = run(_sampled(scene, samples), folder, cache).model
    write_fields(folder)
    if scene.measurements and scene.deviations:
        found = contributors(model, samples=16)
        CONTRIBUTORS.write(folder, found.table)
        LINEARITY.write(folder, found.linearity)
        for table, frame in left_by_studies(model.scene)[0].items():
            table.write(folder, frame)
    return _Page(write_report(folder))


def _changed(scene, **changes):
    """The scene with tables replaced, validated again."""
    return Scene(**scene.model_dump() | changes | {"folder": scene.folder})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("run")


@pytest.fixture(scope="module")
def drawn(lap_scene, cache, folder):
    """The page of a run under all laws, and all pictures that were drawn for it, by name."""
    ends = [item.point for item in lap_scene.measurements]
    tip = {"name": "tip", "kind": "profile", "part": "upper", "points": ends, "upper": 2.0}
    scene = _changed(
        lap_scene,
        description="Two <b>strips</b> & a weld",
        measurements=[*lap_scene.model_dump()["measurements"], tip],
        report={"laws": ["coulomb", "associated", "frictionless"], "fields": True},
    )
    pictures = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mic.report.page.draw_all", lambda *given: pictures.update(draw_all(*given)) or pictures)
        return _results(scene, cache, folder, samples=40), pictures


@pytest.fixture(scope="module")
def page(drawn):
    return drawn[0]


@pytest.fixture(scope="module")
def every_picture(drawn):
    return drawn[1]


@pytest.fixture
def given_pictures(monkeypatch):
    """The pictures, by name, that pages show in this test, which is about their words: drawing takes seconds."""
    pictures = {}
    monkeypatch.setattr("mic.report.page.draw_all", lambda *_: pictures)
    return pictures


@pytest.mark.slow
def test_the_page_loads_nothing(page):
    assert page.loads
    for target in page.loads:
        assert target.startswith(("#", "data:image/")), target[:80]
    assert "default-src 'none'" in page.source  # and the browser is told so
    assert len(page.source) < 3e6


@pytest.mark.slow
@pytest.mark.fem
def test_every_figure_is_there(page):
    assert page.ids >= {
        "assembly",
        "assembly-view",
        "table-1",
        "path-table",
        "slip-table",
        "measurement-table",
        "field-view",
        *(entry.name for entry in PICTURES if entry.section != "still"),
    }
    pictures = [target for target in page.loads if target.startswith("data:")]
    assert len(pictures) == len(PICTURES)
    for picture in pictures:
        kind, how, data = re.fullmatch(r"data:image/(svg\+xml|png);(base64|charset=utf-8),(.*)", picture).groups()
        assert (kind == "png") == (how == "base64")
        raw = base64.b64decode(data, validate=True) if how == "base64" else unquote(data).encode()
        assert raw.startswith(b"\x89PNG") if kind == "png" else ElementTree.fromstring(raw).tag.endswith("svg")
        assert len(raw) > 3000


@pytest.mark.slow
@pytest.mark.fem
def test_the_viewer_has_the_surfaces_and_fields(page, folder):
    data = unpacked(page.scripts["viewer-data"])
    assert [part["name"] for part in data["parts"]] == ["lower", "upper"] and data["laws"] == [
        "coulomb",
        "associated",
        "frictionless",
    ]
    whole = lambda numbers: np.frombuffer(base64.b64decode(numbers["data"]), dtype="<u2")
    told = {(field.part, field.law): field for field in read_context(read_outcome(folder)).fields}
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


def test_a_packed_text_is_gzip_in_base64():
    text = "<&µ>" * 9
    assert gzip.decompress(base64.b64decode(packed(text), validate=True)).decode() == text


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
    np.testing.assert_array_equal(own.points[:, :2].min(axis=0), [0, 0])
    np.testing.assert_array_equal(own.points[:, :2].max(axis=0), [150, 100])
    assert (own.normals[:, 2] > 0.9).all()
    same, triangles_of_all = thinned(sheet, len(sheet.points))
    assert len(same) == len(sheet.points) and triangles_of_all is sheet.triangles


@pytest.mark.slow
def test_text_of_the_scene_is_escaped(page):
    assert "<b>strips</b>" not in page.source and "Two <b>strips</b> & a weld" in page.words


@pytest.mark.slow
def test_figures_in_the_text_are_those_of_the_summary(page, folder):
    summary = json.loads((folder / "summary.json").read_text())
    zone = summary["laws"]["coulomb"]["zones"]["lap"]
    for value in (
        zone["mean_rms_tangential"],
        zone["six_sigma_rms_tangential"],
        zone["mean_rms_slip"],
        zone["six_sigma_rms_slip"],
        zone["mean_friction_work"],
        summary["laws"]["associated"]["measurements"]["M1"]["mean"],
    ):
        assert number(value) in page.words
    cost = law_cost(read_outcome(folder), "clamp")
    assert cost.sentence in page.words and cost.gaps.max() > 0


@pytest.mark.slow
def test_pictures_of_samples_stand_in_their_sections(page):
    assert {entry.name for entry in PICTURES if entry.section not in ("fields", "still")} <= page.ids


@pytest.mark.slow
@pytest.mark.fem
def test_every_picture_stands_once_in_the_page_of_a_full_run(page, folder, every_picture, monkeypatch):
    assert list(every_picture) == [entry.name for entry in PICTURES]
    for name, picture in every_picture.items():
        assert page.loads.count(picture.uri) == 1, name
    monkeypatch.setattr("mic.report.study_pictures.draw_all", lambda *_: every_picture)
    assert pictures(read_outcome(folder)) == [*every_picture.values()]


@pytest.mark.slow
def test_pictures_of_returned_studies_are_those_of_the_page(page, folder):
    outcome = read_outcome(folder)
    found = left_by_studies(outcome.model.scene)[1]
    driven = Contributors(outcome.study(CONTRIBUTORS), outcome.study(LINEARITY))
    shown = [picture for one in (driven, *found) for picture in pictures(one, outcome.model.scene)]
    assert len(shown) == 9 and shown[-1].title == "Search for the optimum"  # which no run keeps
    for picture in shown[:-1]:
        assert page.loads.count(picture.uri) == 1, picture.title


@pytest.mark.slow
def test_the_page_shows_the_optimum(page):
    assert "On 400 fresh samples the least Cpk 1.250 → 1.500: gain 0.250 (0.125 to 0.375)" in page.words
    assert "On the 60 samples of the search: 1.625, after 1234 evaluations." in page.words
    assert "force C1 60 75" in page.words and {"optimum-table", "orders", "misses", "optimum"} <= page.ids


@pytest.mark.slow
def test_the_page_shows_path_errors_and_rescued_samples(folder, page, given_pictures, tmp_path):
    """Nothing is known of the placeholder's errors; so they are written into a copy."""
    copy = shutil.copytree(folder, tmp_path / "copy")
    whole = read_outcome(copy)

    def marked(frame):
        clamped = frame["stage"] == "clamp"
        error = np.where(clamped, 0.0042 * (1 + frame["sample"] % 4), 0.0)
        return frame.assign(rescued=clamped & frame["sample"].isin([2, 5, 7]), path_error=error)

    edit(copy, RESOLUTIONS, "coulomb", marked)
    pairs = whole.path_study.pairs
    moved = (pairs["law"] == "coulomb") & (pairs["quantity"] == "measurement") & (pairs["name"] == "M1")
    pairs.loc[moved, "tighter"] = pairs.loc[moved, "value"] + 0.0123
    pairs.to_csv(copy / PATH.place, index=False)
    errors = whole.path_study.errors
    errors.loc[errors["law"] == "coulomb", ["estimate", "measured"]] = [0.006, 0.002]
    errors.to_csv(copy / PATH_ERRORS.place, index=False)
    outcome = read_outcome(copy)
    picture = given_pictures["path-error"] = draw("path-error", outcome, read_context(outcome))
    words = _Page(write_report(copy)).words
    share = outcome.summary()["laws"]["coulomb"]["measurements"]["M1"]["mean_path_share"]
    assert f"path +12 µm (+{percent(share, 1)})" in words
    assert "rescued" in words and outcome.rescued["coulomb"] == [2, 5, 7]
    assert "largest 17 µm in clamp" in picture.caption and "change on a tighter path in 24" in picture.caption
    assert "(median of estimate over change: 3.0" in picture.caption
    assert picture.caption in words


@pytest.mark.slow
def test_captions_state_work_and_contact_states_along_the_path(folder, page):
    outcome = read_outcome(folder)
    context, table = read_context(outcome), outcome.zone_statistics.set_index(["law", "stage"])
    work = draw("friction-work", outcome, context).caption
    assert f"{number(table.loc[('coulomb', 'clamp'), 'mean_friction_work'])} N mm in clamp" in work
    states = draw("path-states", outcome, context).caption
    open_ = np.mean([table.loc[("coulomb", stage), "open"] for stage in outcome.stages])
    assert f"coulomb: {percent(open_)} open" in states
    assert "frictionless" not in work + states  # where nothing holds, nothing slips under load
    assert work in page.words and states in page.words


def test_every_picture_that_can_be_drawn_is_in_the_report():
    """A function that is called a picture and that no entry calls would never be seen."""
    shown = {getattr(entry.function, "func", entry.function) for entry in PICTURES}
    found = set()
    for module in pkgutil.iter_modules(mic.report.__path__, "mic.report."):
        if module.name.endswith("_pictures"):
            content = vars(importlib.import_module(module.name))
            found |= {thing for name, thing in content.items() if name.endswith("_picture")}
    assert found and found == shown


def test_a_picture_of_no_section_is_refused():
    with pytest.raises(ValueError, match="section must be one of drivers, steps, friction, misses, "):
        Entry("lost", "nowhere", lambda outcome, context: None)


@pytest.mark.slow
def test_a_picture_is_the_same_whatever_the_users_style(page, folder):
    import matplotlib

    outcome = read_outcome(folder)
    context = read_context(outcome)
    plain = draw("measurements", outcome, context)
    with matplotlib.rc_context({"font.size": 30, "axes.facecolor": "black", "lines.linewidth": 9}):
        other = draw("measurements", outcome, context)
    assert plain == other


@pytest.mark.slow
def test_of_many_samples_the_first_are_drawn_and_the_captions_say_so(folder, monkeypatch):
    outcome = read_outcome(folder)
    context = read_context(outcome)
    law, zone = context.laws[0], outcome.zones[0]
    first = outcome.sample_numbers(law)[:7]
    np.testing.assert_array_equal(
        outcome.tangential(law, context.stage, zone, first), outcome.tangential(law, context.stage, zone)[:7]
    )
    whole = {name: draw(name, outcome, context) for name in ("tangential-density", "law-cost", "measurements")}
    for module in ("contact", "law", "measurement"):
        monkeypatch.setattr(f"mic.report.{module}_pictures.SHOWN", 7)
    few = {name: draw(name, outcome, context) for name in whole}
    assert "over the first 7 samples" in few["tangential-density"].caption
    assert "Over the first 7 samples valid" in few["law-cost"].caption
    assert "Histograms of the first 7 samples." in few["measurements"].caption
    for name, picture in whole.items():
        assert "first" not in picture.caption and picture.data != few[name].data
    assert len(law_cost(outcome, context.stage).coulomb) == 7


@pytest.mark.slow
def test_laws_under_scaled_friction_are_drawn_from_the_stored_study(page, folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "copy")
    outcome = read_outcome(copy)
    context, path = read_context(outcome), copy / "tables" / "friction.csv"
    study = outcome.friction_study
    study.loc[study["law"] == "associated", "gap_at_load"] = 0.0123
    study.to_csv(path, index=False)
    changed = draw("friction", read_outcome(copy), context)
    path.unlink()
    without = draw("friction", read_outcome(copy), context)
    assert "averages 12.3 µm at μ" in changed.caption and "12 samples" in changed.caption
    assert without is None


@pytest.mark.slow
def test_writing_a_report_solves_nothing_and_changes_no_other_file(page, folder, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("drawing solves")

    copy = shutil.copytree(folder, tmp_path / "copy")
    for name in ("summary.json", "report.html", "assembly.png"):
        (copy / name).unlink()
    monkeypatch.setattr(ContactSolver, "solve", refuse)
    for name in ("process", "evaluate"):
        monkeypatch.setattr(type(read_outcome(copy).model), name, refuse)
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    source = _Page(write_report(copy)).source
    after = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    assert {path.name for path in after.keys() - before.keys()} == {"report.html", "assembly.png"}
    assert all(after[path] == content for path, content in before.items())
    assert (copy / "assembly.png").read_bytes().startswith(b"\x89PNG")
    assert source == page.source  # and the same folder gives the same page


@pytest.mark.slow
def test_pictures_begun_before_tables_and_fields_are_written_are_those_of_the_page(
    folder, every_picture, tmp_path, monkeypatch
):
    monkeypatch.setattr(worker_process, "has_spare_core", lambda: True)  # whatever this machine has
    early = tmp_path / "early"
    shutil.copytree(folder, early)
    for name in ("fields", "tables"):
        shutil.rmtree(early / name)
    (early / "tables").mkdir()
    for table in (PATH, PATH_ERRORS):  # are written before
        shutil.copy(folder / table.place, early / table.place)
    outcome = read_outcome(early)
    ahead = BackgroundPictures(outcome)
    try:
        found = ahead.pictures()
    finally:
        ahead.end()
    assert {name for name, picture in found.items() if picture} == set(NAMES) & set(every_picture)
    assert all(picture == every_picture[name] for name, picture in found.items() if picture)


@pytest.mark.slow
def test_a_law_has_one_colour_in_pictures_and_tables(page, folder):
    outcome = read_outcome(folder)
    for law in outcome.laws:
        assert f'style="color:{LAWS[law].colour}"><b>{law}</b>' in page.source
    colours = set(re.findall(r"#[0-9a-f]{6}", draw("measurements", outcome, read_context(outcome)).data.decode()))
    neutral = {"#000000", "#ffffff", RC["axes.edgecolor"], RC["grid.color"], LIMIT_COLOUR}
    assert colours - neutral == {LAWS[law].colour for law in outcome.laws}
    assert len({look.colour for look in LAWS.values()}) == len({look.mark for look in LAWS.values()}) == len(LAWS)


@pytest.mark.slow
def test_published_figures_stand_beside_those_of_their_zones(folder, page, given_pictures, tmp_path):
    """The paper's figures come from a file beside the scene; nothing about them is in the program."""
    copy = shutil.copytree(folder, tmp_path / "copy")
    (copy / PUBLISHED).write_text(
        (WHEELHOUSE / PUBLISHED).read_text(encoding="utf-8").replace("zones.CZ1", "zones.lap"), encoding="utf-8"
    )
    outcome = read_outcome(copy)
    given_pictures["slip-force"] = draw("slip-force", outcome, read_context(outcome))  # shows a published range
    found = _Page(write_report(copy))
    assert "0.9582" in found.words and "0.2529" not in found.words  # CZ3 is no zone of this scene
    assert "another, proprietary geometry" in found.words and "0.9582" not in page.words
    assert "measured range" not in page.words and "by −57 % in the paper" in found.words


@pytest.mark.slow
def test_failed_and_missing_samples_are_named_with_advice(folder, page, given_pictures, tmp_path):
    spoilt = tmp_path / "spoilt"
    shutil.copytree(folder, spoilt)
    fail(spoilt, "associated", {7: ("clamp", "not converged"), 11: ("release", "overflow in a product")})
    record = json.loads((spoilt / "run.json").read_text())
    (spoilt / "run.json").write_text(json.dumps(record | {"samples": 100}))
    words = _Page(write_report(spoilt)).words
    assert "7 (clamp, residual" in words and "exclude this sample from statistics" in words
    assert "associated: overflow in a product" in words and "11 (release, residual" in words
    assert "60 of 100 samples are missing" in words


@pytest.mark.slow
def test_the_page_shows_wall_time_and_versions(folder, page, given_pictures, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "copy")
    record = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps(record | {"wall_time": {"Monte Carlo": 12.34}}))
    words = _Page(write_report(copy)).words
    assert "Monte Carlo 12.3" in words and f"numpy {record['versions']['numpy']}" in words


FRICTIONLESS = {"laws": ["frictionless"], "slip": False}
TWO_LAWS = {"laws": ["coulomb", "frictionless"]}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, changes, samples, absent, present",
    [
        (
            "no zones",
            {"zones": []},
            5,
            {"table-1", "tangential-density", "states", "law-cost", "path-table"},
            {"assembly", "measurements"},
        ),
        (
            "normals only",
            {"report": FRICTIONLESS},
            5,
            {
                *("table-1", "slip-force", "law-cost", "slip-table", "path-states", "friction-work", "path-table"),
                *("field-view", "displacement-fields"),
            },
            {"one-sample-f", "states", "fields"},
        ),
        ("one sample", {}, 1, set(), {"table-1", "one-sample-u", "measurement-table"}),
        ("no measurements", {"measurements": []}, 5, {"measurements", "measurement-table"}, {"table-1"}),
    ],
)
def test_reports_of_bare_scenes(name, changes, samples, absent, present, lap_scene, cache, tmp_path):
    page = _results(_changed(lap_scene, **{"report": TWO_LAWS} | changes), cache, tmp_path, samples)
    assert not page.ids & absent
    assert page.ids >= present
    assert "nan" not in page.words.lower().split()
    if name == "normals only":
        assert "does not request them" in page.words


@pytest.mark.slow
def test_report_of_a_process_without_release_in_which_nothing_varies(lap_scene, cache, tmp_path):
    stages = [stage.model_dump() for stage in lap_scene.stages if stage.kind != "release"]
    page = _results(_changed(lap_scene, stages=stages, deviations=[], report=TWO_LAWS), cache, tmp_path, 4)
    assert "1 (clamp)" in page.words and page.ids >= {"table-1", "tangential-density", "measurements"}
    assert "nan" not in page.words.lower().split()


@pytest.mark.slow
def test_report_of_a_law_that_failed_throughout(folder, page, tmp_path):
    spoilt = tmp_path / "spoilt"
    shutil.copytree(folder, spoilt)
    all_fail(spoilt, "coulomb", 40)
    conclude(spoilt)
    words = _Page(write_report(spoilt)).words
    summary = json.loads((spoilt / "summary.json").read_text())
    assert "coulomb: not converged (40)" in words
    assert (
        summary["laws"]["coulomb"]["zones"]["lap"]["mean_rms_tangential"] is None
        and summary["laws"]["coulomb"]["worst_residual"] is None
    )


@pytest.mark.slow
def test_report_of_a_run_with_no_finished_sample(lap_scene, cache, tmp_path):
    run(_sampled(lap_scene, 3), tmp_path, cache)
    for path in tmp_path.glob("samples/*/*"):
        path.unlink()
    page = _Page(write_report(tmp_path))
    assert "3 of 3 samples are missing" in page.words


@pytest.mark.parametrize(
    "value, text",
    [
        (0.012345, "0.0123"),
        (-4.2, "−4.20"),
        (123456, "1.23e+05"),
        (0, "0"),
        (float("nan"), "–"),
        (None, "–"),
        (float("inf"), "∞"),
        (0.99996, "1.00"),
        (28.0, "28.0"),
    ],
)
def test_numbers_for_people(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    "value, share, text",
    [
        (0.0123, 0.031, "+12 µm (+3.1 %)"),
        (-0.0042, -0.5, "−4.2 µm (−50.0 %)"),
        (0.0009, 0.0009, "≤ 1 µm (+0.1 %)"),
        (0.0009, float("nan"), "≤ 1 µm"),
        (-1e-9, -1e-9, "≤ 1 µm (0.0 %)"),
        (0.0, 0.0, "≤ 1 µm (0.0 %)"),
        (0.005, None, "+5.0 µm"),
        (float("nan"), 0.1, "–"),
        (None, None, "–"),
    ],
)
def test_formatted_changes_have_a_unit_beside_the_share(value, share, text):
    assert change(value, share) == text


@pytest.mark.parametrize(
    "value, digits, text",
    [
        (0.125, 1, "12.5 %"),
        (-0.05, 0, "−5 %"),
        (-0.0004, 0, "0 %"),
        (-0.0004, 2, "−0.04 %"),
        (1.0, 0, "100 %"),
        (float("nan"), 0, "–"),
    ],
)
def test_shares_for_people(value, digits, text):
    assert percent(value, digits) == text
