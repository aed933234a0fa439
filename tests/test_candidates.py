"""Contact candidates: their places, undetected penetration between them, and nominal assemblies that do not move."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.stages import on_the_way
from typer.testing import CliRunner

import mic
from mic.compliance.support import statically_determinate
from mic.errors import SceneError
from mic.geometry.pairing import Side
from mic.geometry.structured import extrude
from mic.geometry.surface import Surface
from mic.model.assembly import assemble
from mic.model.zone_pairs import pressed_places
from mic.options import app
from mic.process.model import ReducedModel
from mic.statistics.draw import draw
from mic.studies.pair_convergence import DENSER, denser_scene

MESHES = Path(__file__).resolve().parents[1] / "meshes"


@pytest.fixture(scope="module")
def scene():
    return mic.load_scene(MESHES / "lap_joint")


@pytest.fixture(scope="module")
def model(scene, cache):
    return mic.reduce(scene, cache)


def with_zone(scene, **keys):
    return scene.model_copy(update={"zones": [zone.model_copy(update=keys) for zone in scene.zones]})


def sideways(points, point):
    return np.linalg.norm((points - np.array(point))[:, :2], axis=1)


def test_candidates_stand_four_thicknesses_apart_along_the_edges_and_within_and_one_at_each_clamp_and_weld(
    scene, model
):
    """1000 mm² of sheets of 1 mm, 130 mm about: 32 or 33 at the edges, 4 mm apart, and one for each 16 mm² within.

    Half of the area of those at the edges lies beyond these.
    """
    edge, count = 130 / 4, (1000 - 130 * 4 / 2) / 16
    assert model.contacts.watched.all() and abs(len(model.contacts) - edge - count) < 3
    for item in (*scene.clamps, *scene.welds):
        assert sideways(model.contacts.point, item.point).min() < 0.5
    x, y = model.contacts.point[:, 0], model.contacts.point[:, 1]
    beyond = np.min([x - 60, 100 - x, y, 25 - y], axis=0)
    at_edge = beyond < 0.5
    assert abs(at_edge.sum() - edge) < 1.5 and beyond.min() > -1e-9
    assert (beyond[at_edge] < 1e-9).sum() >= at_edge.sum() - 4  # but for those about a corner
    assert beyond[~at_edge].min() > 2.0
    nearest = [np.sort(sideways(model.contacts.point, point))[1] for point in model.contacts.point]
    assert min(nearest) > 1.9 and max(nearest) < 6.0
    assert model.contacts.area.sum() == pytest.approx(1000)


def test_a_zone_with_stated_pairs_monitors_contact_between_them(scene, cache):
    assembly = assemble(with_zone(scene, pairs=24), cache)
    assert len(assembly.contacts) == 24 and not assembly.contacts.watched.any()
    assert len(assembly.between) == 24
    apart = [sideways(assembly.contacts.point, point).min() for point in assembly.between.point]
    assert min(apart) > 2.0  # as far from the pairs as there is room


def test_candidates_finer_than_the_elements_are_refused(scene, cache):
    with pytest.raises(SceneError, match=r"zones\[0\] \(lap\).*spacing = 0\.5 mm.*finer than the elements"):
        assemble(with_zone(scene, spacing=0.5), cache)


@pytest.mark.slow
def test_undetected_penetration_has_a_place_and_is_larger_with_few_pairs(model, lap_model):
    few, many = (one.evaluate(one.deviations({})).resolutions["clamp"] for one in (lap_model, model))
    assert few.unseen[0] > 2 * many.unseen[0] > 0
    place = lap_model.between.point[few.unseen_at[0]]
    assert sideways(lap_model.contacts.point, place).min() > 2.0
    clamp = lap_model.scene.clamps[0]
    assert sideways(place[None], clamp.point)[0] < 3 * clamp.radius  # where the clamp bends the sheets


def test_the_nominal_lap_joint_does_not_move(model):
    """Cells that the pads' rims cut carry what the pads press, uniformly, at any spacing: it is the patch test."""
    evaluation = model.evaluate(np.zeros(len(model.parameters)))
    assert np.abs(evaluation.measurements).max() < 2e-3
    clamps = sum(clamp.force for clamp in model.scene.clamps)
    assert evaluation.resolutions["release"].force[0, :, 0].sum() < 0.05 * clamps


ALIKE = """
from mic.geometry.structured import extrude

def build(part, size):
    z = {"lower": 0.0, "upper": 1.0, "third": 2.0}[part]
    return extrude([(0, z), (36, z)], 0.0, 42.0, size)
"""
HELD = [(4, 4, "z"), (38, 4, "z"), (21, 32, "z"), (4, 4, "y"), (38, 4, "y"), (4, 4, "x")]
AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}


def on_a_rest(folder, radius, sheets=2):
    """Sheets alike that are held at like places; a clamp's pad of 5 mm presses all onto a rest of `radius`, mm."""
    (folder / "alike.py").write_text(ALIKE)
    names = ["lower", "upper", "third"][:sheets]
    rest = dict(name="rest", part="lower", point=(19, 17, 0), direction=(0, 0, 1), radius=radius, stage="clamp")
    clamp = dict(name="C", part=names[-1], point=(19, 17, sheets - 1), direction=(0, 0, -1), force=100)
    sheet = dict(geometry="alike.py", size=3.0, thickness=1, young=YOUNG, poisson=0.3)
    return mic.Scene(
        name="rest",
        folder=folder,
        parts=[dict(name=name, **sheet) for name in names],
        locators=[
            dict(name=f"{name}-{i}", part=name, point=(x, y, z), direction=AXES[axis])
            for z, name in enumerate(names)
            for i, (x, y, axis) in enumerate(HELD)
        ]
        + [rest],
        clamps=[clamp],
        zones=[dict(name=two, parts=(one, two)) for one, two in pairwise(names)],
        stages=[dict(kind=kind) for kind in ("locate", "clamp", "measure")],
        measurements=[dict(name="M", part="upper", point=(34, 30, 1), direction=(0, 0, 1), lower=-1, upper=1)],
        report=dict(laws=["frictionless"]),
    )


@pytest.mark.fem
@pytest.mark.parametrize("radius, sheets", [(7.0, 2), (2.5, 3)])
@pytest.mark.slow
def test_sheets_alike_between_pads_of_two_sizes_stay_together(radius, sheets, tmp_path, cache):
    """Half of each pad's pressure passes from sheet to sheet right there, so that both bend alike.

    Each of three sheets is bent by a third of the difference between the pads; for either zone one pad lies behind a
    third sheet.
    """
    model = mic.reduce(on_a_rest(tmp_path, radius, sheets), cache)
    clamped = model.evaluate({}).resolutions["clamp"]
    assert clamped.force[0, :, 0].sum() > 95 * (sheets - 1)
    assert clamped.displacement[0, :, 0].max() < 6e-5  # mm; with cells across the rest's rim 10 to 13 e-5


def test_a_locator_has_a_rim_only_where_it_backs_a_clamp(tmp_path):
    """Not where it holds along the sheets, holds a node, or stands beside the clamp's pad."""
    scene = on_a_rest(tmp_path, 4.0)
    sheets = {part.name: Side(Surface(*extrude([(0, 0), (36, 0)], 0.0, 42.0, 9.0)[:2]), 1.0) for part in scene.parts}

    def rims(**keys):
        """Own radius, and that of the clamp, of each locator that backs a clamp."""
        locators = [one.model_copy(update=keys) if one.name == "rest" else one for one in scene.locators]
        places = pressed_places(scene.model_copy(update={"locators": locators}), scene.zones[0], sheets)
        return [(place.radius, place.backed_radius) for place in places if place.backed_radius]

    assert rims() == [(4.0, 5.0)]
    for change in ({"direction": (1.0, 0.0, 0.0)}, {"radius": 0.0}, {"point": (19.0, 26.5, 0.0)}):
        assert rims(**change) == []


def test_watched_is_dense(model):
    """All candidates at once, none left out, one increment a step."""
    own = replace(model.contacts, nugget=np.full(len(model.contacts), -1))
    watched = replace(on_the_way(model, 1), contacts=own)
    dense = replace(watched, contacts=replace(watched.contacts, watched=np.zeros(len(model.contacts), bool)))
    samples = draw(model.scene, 4, 0, 6)
    one, other = watched.evaluate(samples), dense.evaluate(samples)
    assert not one.failed.any() and not other.failed.any()
    np.testing.assert_allclose(one.measurements, other.measurements, atol=1e-5)


def test_a_single_sample_has_the_results_of_its_batch(model):
    samples = draw(model.scene, 5, 0, 5)
    together = model.evaluate(samples).measurements
    for sample, wanted in zip(samples, together):
        np.testing.assert_allclose(model.evaluate(sample).measurements[0], wanted, atol=1e-6)


def test_contacts_within_a_nugget_carry_no_force_after_welding(model):
    inside = model.contacts.nugget >= 0
    assert inside.sum() >= len(model.scene.welds)
    for k in np.flatnonzero(inside):
        weld = model.scene.welds[model.contacts.nugget[k]]
        assert sideways(model.contacts.point[[k]], weld.point)[0] <= weld.radius
    samples = draw(model.scene, 5, 0, 4)
    found = model.evaluate(samples).resolutions
    assert found["clamp"].force[:, inside, 0].any()  # before the weld they press
    assert not found["release"].force[:, inside].any()
    assert not model.contacts.excluded([]).any()
    for weld in range(len(model.scene.welds)):
        np.testing.assert_array_equal(model.contacts.excluded([weld]), model.contacts.nugget == weld)


def test_a_model_is_read_back_with_its_candidates(model, tmp_path):
    model.save(tmp_path / "model.npz")
    again = ReducedModel.load(tmp_path / "model.npz")
    np.testing.assert_array_equal(again.contacts.watched, model.contacts.watched)
    np.testing.assert_array_equal(again.between.point, model.between.point)
    samples = model.deviations({})
    np.testing.assert_allclose(again.evaluate(samples).measurements, model.evaluate(samples).measurements, atol=1e-12)


# ---------------------------------------------------------------------------------------------------- welds


def test_a_weld_does_not_read_rigid_motion_of_the_assembly(scene, model, cache):
    assert model.weld_size == (9, 9)
    centroids = [part.surface.centroid for part in assemble(scene, cache).parts]
    for axis in np.eye(3):
        for motion in (
            np.concatenate([[*axis, 0, 0, 0] for _ in centroids]),
            np.concatenate([[*np.cross(axis, centre), *axis] for centre in centroids]),
        ):
            reading = model.compliance.rigid(model.rows["weld"]) @ motion
            np.testing.assert_allclose(reading, 0, atol=1e-12)


def test_the_wheelhouse_with_candidates_is_the_papers_but_for_its_pairs():
    paper, watched = (mic.load_scene(MESHES / "wheelhouse" / file) for file in ("scene.toml", "watched.toml"))
    assert [zone.pairs for zone in paper.zones] == [34] * 3 and all(zone.candidates for zone in watched.zones)
    names = {"name": True, "description": True, "optimise": True, "zones": {"__all__": {"pairs"}}}
    assert paper.model_dump(exclude=names) == watched.model_dump(exclude=names)


def test_the_scene_nearest_to_the_paper_is_the_wheelhouse_but_for_its_choices():
    names = {"name": True, "description": True, "optimise": True, "monte_carlo": {"accuracy"}, "report": True}
    names |= {"zones": {"__all__": {"pairs", "points"}}, "clamps": {"__all__": {"radius"}}, "correlations": True}
    names |= {"deviations": {"__all__": {"mean", "sigma"}}, "stages": {1: {"order"}}}
    shipped, nearest = (mic.load_scene(MESHES / "wheelhouse" / file) for file in ("scene.toml", "table1.toml"))
    assert shipped.model_dump(exclude=names) == nearest.model_dump(exclude=names)
    mean, sigma = (np.array([getattr(item, key) for item in nearest.deviations]) for key in ("mean", "sigma"))
    np.testing.assert_allclose(mean, 0.975 * np.array([item.mean for item in shipped.deviations]), rtol=5e-4)
    np.testing.assert_allclose(sigma, 0.051 * np.abs(mean), rtol=5e-4)
    np.testing.assert_array_equal(nearest.correlations[0].matrix, np.outer(np.sign(mean), np.sign(mean)))


@pytest.mark.fem
@pytest.mark.slow
def test_check_reports_the_change_of_characteristics_with_denser_pairs(cache, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")  # a narrow terminal cuts nothing
    monkeypatch.setenv("MIC_CACHE", str(cache))
    monkeypatch.setattr("mic.report.check_page.check_page", lambda *_: "")
    page = ["--page", str(tmp_path / "check.html")]
    done = CliRunner().invoke(app, ["check", str(MESHES / "lap_joint"), "--law", "frictionless", "--converge", *page])
    assert done.exit_code == 0, done.output
    pairs = re.search(r"(\d+) and (\d+) pairs; largest penetration .* 0 of 30 samples failed", done.output)
    assert pairs and 1.8 < int(pairs[2]) / int(pairs[1]) < 2.3
    row = next(line for line in done.output.splitlines() if "M1" in line and "%" in line)
    off, half = (float(each) for each in row.split("│")[-2].strip(" %").split(" ± "))
    assert abs(off) < 3 and 0 < half < 1  # of the difference: either 6σ has one of a quarter
    assert "not a bound" in done.output and "…" not in done.output[done.output.index("Key characteristics and") :]


@pytest.mark.slow
def test_denser_pairs_stand_at_a_share_of_the_distance(scene, cache):
    few, many = (assemble(with_zone(scene, **keys), cache) for keys in ({"pairs": 24}, {"spacing_factor": 0.9}))
    assert denser_scene(few).zones[0].pairs == 49
    assert many.spacing == pytest.approx([0.9 * 4.0])
    assert denser_scene(many).zones[0].spacing_factor == pytest.approx(DENSER * 0.9)


# -------------------------------------------------------------------------------------------- known answers

LENGTH, WIDTH, THICKNESS, YOUNG = 200.0, 20.0, 2.0, 210e3  # mm, MPa


def strip_above_table(folder, gap, clamps):
    """A strip along x without lateral contraction, its ends on locators, pressed down `gap` above a rigid table."""
    (folder / "geometry.py").write_text(
        "from mic.geometry.structured import extrude\n"
        f"def build(part, size):\n    return extrude([(0, 0), ({WIDTH}, 0)], 0.0, {LENGTH}, size)\n"
    )
    corners = [(-5, -5), (LENGTH + 5, -5), (LENGTH + 5, WIDTH + 5), (-5, WIDTH + 5)]
    a, b, c, d = (f"vertex {x} {y} {-THICKNESS / 2 - gap}\n" for x, y in corners)
    facets = "".join(f"facet normal 0 0 1\nouter loop\n{one}endloop\nendfacet\n" for one in (a + b + c, a + c + d))
    (folder / "table.stl").write_text(f"solid table\n{facets}endsolid table\n")
    held = [("z", 0, 2), ("z", 0, WIDTH - 2), ("z", LENGTH, WIDTH / 2), ("y", 0, 2), ("y", LENGTH, 2), ("x", 0, 2)]
    return mic.Scene(
        name="strip",
        folder=folder,
        parts=[dict(name="strip", geometry="geometry.py", size=5.0, thickness=THICKNESS, young=YOUNG, poisson=0.0)],
        fixtures=[dict(name="table", mesh="table.stl")],
        locators=[
            dict(name=f"A{i}", part="strip", point=(x, y, 0), direction=AXES[axis], radius=0)
            for i, (axis, x, y) in enumerate(held)
        ],
        clamps=[
            dict(name=f"C{i}", part="strip", point=(*at, 0), direction=(0, 0, -1), force=force, radius=0)
            for i, (at, force) in enumerate(clamps)
        ],
        zones=[dict(name="table", parts=("table", "strip"))],
        stages=[dict(kind="locate"), dict(kind="clamp")],
        report=dict(laws=["frictionless"]),
    )


@pytest.mark.fem
def test_a_strip_under_a_uniform_load_lifts_off_a_table_at_its_ends(tmp_path, cache):
    """Held at the height g over a table at its ends and pressed down by q, it lies flat but for the ends' a,

    a⁴ = 24 E I g/q,        R/(q L) = 1 − a/L        with both ends: each takes q a/2.
    """
    gap, load = 0.02, 0.05  # mm, N/mm
    places = [(x, y) for x in np.arange(2.5, LENGTH, 5.0) for y in (WIDTH / 4, 3 * WIDTH / 4)]
    scene = strip_above_table(tmp_path, gap, [(place, load * 5.0 / 2) for place in places])
    found = mic.reduce(scene, cache).evaluate({}).resolutions["clamp"]
    free = (24 * YOUNG * WIDTH * THICKNESS**3 / 12 * gap / load) ** 0.25
    assert free < LENGTH / 2
    assert found.force[0, :, 0].sum() / (load * LENGTH) == pytest.approx(1 - free / LENGTH, rel=5e-3)


def test_rows_with_rounding_errors_of_rigid_motions_do_not_hold_a_part():
    """Moments of a nugget that read strain alone read nothing of a motion, exactly or but for rounding."""
    held = np.vstack([np.eye(6), np.full((3, 6), 1e-17)])
    np.testing.assert_array_equal(statically_determinate(held[::-1], np.ones(6)), np.arange(3, 9))


def test_moments_of_a_nugget_hold_a_part_only_without_other_supports():
    """Strain moments of a patch that is not quite round include a small part of a rotation."""
    means = np.hstack([np.eye(3), [[0, 0, 0], [0, 0, -10], [0, 10, 0]]])  # of a nugget 10 mm from the middle
    other = np.hstack([np.eye(3), [[0, 0, 0], [0, 0, 10], [0, -10, 0]]])
    moments = np.zeros((2, 6))
    moments[0, 5], moments[1, 3] = 1e-5, 0.5
    rows = np.vstack([moments, means, other])
    chosen = statically_determinate(rows, np.array([1, 1, 1, 10, 10, 10.0]))
    assert 0 not in chosen and 1 in chosen
