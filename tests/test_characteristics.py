"""Key characteristics beyond a point, evaluated on known motions and shapes."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import mic
from mic.errors import SceneError
from mic.model.assembly import assemble
from mic.model.characteristics import Characteristics
from mic.scene.load import read_table

LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint" / "scene.toml"
LIMITS = {"lower": -1.0, "upper": 1.0}
POINT = {"part": "lower", "point": [80, 12.5, 0]}
#: A line of points across the upper strip, and points all over the lower one.
LINE = {"part": "upper", "points": [[150, y, 1] for y in (4, 9, 16, 21)], "upper": 0.5}


def scene(*measurements):
    table = tomllib.loads(LAP.read_text())
    for part in table["parts"]:
        part["size"] = "coarse"
    table["zones"][0]["pairs"] = 2
    table["measurements"] = [{"name": f"M{i}"} | each for i, each in enumerate(measurements)]
    return read_table(table, LAP)


@pytest.fixture(scope="module")
def assembled(cache):
    """The lap joint on coarse meshes with these measurements, called M0, M1, …."""
    return lambda *measurements: assemble(scene(*measurements), cache)


def between(kind, part="upper", point=(90, 12.5, 1), **keys):
    return POINT | {"kind": kind, "to": {"part": part, "point": list(point)}} | LIMITS | keys


def read(assembly, *fields):
    """(k,) characteristics where each part moves by a field u(x) (q, 3) → (q, 3)."""
    return Characteristics.of(assembly.scene).values(points_read(assembly, *fields)[None])[0]


def points_read(assembly, *fields):
    """(r,) what their points read."""
    readings = []
    for part, field in zip(assembly.parts, fields):
        f = part.functionals
        moved = [patch.weight @ field(part.surface.at(patch.triangle, patch.barycentric)) for patch in f.patches]
        readings.append((np.array(moved)[f.patch] * f.direction).sum(axis=1))
    return assembly.rows["measurement"] @ np.concatenate(readings)


def rigid(shift, turn):
    return lambda x: np.asarray(shift) + np.cross(np.broadcast_to(np.asarray(turn, dtype=float), x.shape), x)


STILL = rigid([0, 0, 0], [0, 0, 0])


def test_flush_gap_and_distance_measure_the_second_point_relative_to_the_first(assembled):
    line = np.array([10, 0, 1]) / np.sqrt(101)
    assembly = assembled(between("flush"), between("gap"), between("distance"))
    normals = [np.array(item.direction) for item in assembly.scene.measurements]
    np.testing.assert_allclose(normals, [[0, 0, 1], [1, 0, 0], line], atol=1e-9)
    shift = np.array([0.3, -0.2, 0.5])
    np.testing.assert_allclose(read(assembly, STILL, rigid(shift, [0, 0, 0])), [0.5, 0.3, shift @ line], atol=1e-12)
    np.testing.assert_allclose(read(assembly, rigid(shift, [0, 0, 0]), STILL), [-0.5, -0.3, -shift @ line], atol=1e-12)


@pytest.mark.slow
def test_a_rigid_motion_does_not_change_a_distance(assembled):
    assembly = assembled(between("distance"))
    assert (
        abs(read(assembly, *[rigid([1, 2, 3], [1e-3, -2e-3, 3e-3])] * 2)[0]) < 1e-5
    )  # a disc's middle is found to 2 µm


def test_a_gap_is_measured_along_its_given_direction(assembled):
    assembly = assembled(between("gap", direction=[0, 1, 0], point=[80, 12.5, 1]))
    assert read(assembly, STILL, rigid([0.3, -0.2, 0.5], [0, 0, 0]))[0] == pytest.approx(-0.2)


def test_parallelism_measures_tilt_and_no_shift(assembled):
    assembly = assembled(LINE | {"kind": "parallelism", "radius": 0.0})
    assert read(assembly, STILL, rigid([1, 2, 3], [0, 0, 0]))[0] == pytest.approx(0.0, abs=1e-12)
    assert read(assembly, STILL, rigid([0, 0, 0], [1e-2, 0, 0]))[0] == pytest.approx(0.17, abs=1e-3)
    assert read(assembly, STILL, rigid([0, 0, 0], [-1e-2, 0, 0]))[0] == pytest.approx(0.17, abs=1e-3)


def test_a_profile_is_twice_the_largest_deviation_on_either_side(assembled):
    assembly = assembled(LINE | {"kind": "profile"})
    for side in (1.0, -1.0):
        found = read(assembly, STILL, lambda x, side=side: side * np.column_stack([0 * x[:, :2], 0.1 + 0.01 * x[:, 1]]))
        assert found[0] == pytest.approx(2 * (0.1 + 0.21), rel=1e-3)


def test_a_profile_is_positive_along_the_mesh_normals(assembled):
    assembly = assembled(LINE | {"kind": "profile"})
    n = assembly.parts[1].surface.normals.mean(axis=0)
    assert abs(n[2]) == pytest.approx(1.0)
    np.testing.assert_allclose(points_read(assembly, STILL, rigid(0.3 * n, [0, 0, 0])), 0.3, atol=1e-12)


def test_a_profile_over_a_box_has_points_all_over_it_and_none_outside(assembled):
    box = [[100, -1, 0], [161, 26, 2]]
    item = {"part": "upper", "kind": "profile", "spacing": 8.0, "box": box, "upper": 1.0}
    placed = assembled(item).scene.measurements[0]
    x = np.array(placed.points)
    assert len(x) > 10 and x[:, 0].min() >= 100 and placed.spacing is None
    grid = np.stack(np.meshgrid(np.arange(100, 161, 5.0), np.arange(0, 26, 5.0)), -1).reshape(-1, 2)
    assert (
        np.linalg.norm(grid[:, None] - x[None, :, :2], axis=2).min(axis=1).max() < 8.0 + 4.0
    )  # half an element's diagonal


def three(**keys):
    places = ([15, 5], [15, 20], [60, 12.5])
    return [{"part": "lower", "point": [*place, 0], "direction": [0, 0, 1]} | LIMITS | keys for place in places]


@pytest.mark.slow
def test_a_best_fit_removes_rigid_motion(assembled):
    fit = {"best_fit": ["M0", "M1", "M2"]}
    far = {"part": "upper", "point": [150, 20, 1]} | LIMITS
    along = far | {"direction": [1, 0, 0]}
    assembly = assembled(*three(), far | fit, along | fit, far, along, LINE | {"kind": "profile"} | fit)
    motion = rigid([0.1, 0.2, 0.3], [1e-3, 2e-3, 0])
    found = read(assembly, motion, motion)
    np.testing.assert_allclose(found[[3, 7]], 0.0, atol=1e-12)
    assert abs(found[5]) > 0.01
    shift = rigid([0.1, 0, 0], [0, 0, 0])  # which three points along the normal do not tell
    assert read(assembly, shift, shift)[4] == pytest.approx(0.1)


def test_a_best_fit_applies_to_measurements_between_two_points(assembled):
    fit = {"best_fit": ["M0", "M1", "M2"]}
    assembly = assembled(*three(), between("flush") | fit, between("flush"))
    tilt = rigid([0.1, 0.2, 0.3], [0, 2e-3, 0])
    found = read(assembly, tilt, tilt)
    assert found[3] == pytest.approx(0.0, abs=1e-12) and abs(found[4]) > 0.01


@pytest.mark.slow
def test_a_best_fit_on_one_point_removes_its_shift_only(assembled):
    away = {"part": "upper", "point": [150, 20, 1], "direction": [0, 0, 1]} | LIMITS
    assembly = assembled(three()[0], away | {"best_fit": ["M0"]}, away)
    moved = rigid([0.1, 0.2, 0.3], [1e-3, 2e-3, 0])
    fitted, plain, point = (read(assembly, moved, moved)[k] for k in (1, 2, 0))
    assert fitted == pytest.approx(plain - point, abs=1e-12) and abs(point) > 0.1


@pytest.mark.slow
def test_a_best_fit_on_more_points_is_by_least_squares(assembled):
    names = [f"M{i}" for i in range(6)]
    places = [[x, y, 0] for x in (12, 40, 70) for y in (5, 18)]
    points = [{"part": "lower", "point": place, "direction": [0, 0, 1], "radius": 0.0} | LIMITS for place in places]
    assembly = assembled(*[each | {"best_fit": names} for each in points])
    bent = lambda x: np.column_stack([0 * x[:, :2], 1e-3 * (x[:, 0] - 30) ** 2 + 0.02 * x[:, 1]])
    x = np.array(places, dtype=float)
    z = bent(x)[:, 2]
    plane = np.column_stack([np.ones(6), x[:, :2]])
    expected = z - plane @ np.linalg.lstsq(plane, z, rcond=None)[0]
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(read(assembly, bent, STILL), expected, atol=1e-12)


def test_flatness_is_parallelism_fitted_on_itself(assembled):
    assembly = assembled(LINE | {"kind": "parallelism", "best_fit": ["M0"], "radius": 0.0})
    assert read(assembly, STILL, rigid([0, 0, 1], [1e-2, 0, 0]))[0] == pytest.approx(0.0, abs=1e-12)
    bent = lambda x: np.column_stack([0 * x[:, :2], 1e-2 * (x[:, 1] - 12.5) ** 2])
    assert read(assembly, STILL, bent)[0] > 0.3


@pytest.mark.slow
def test_the_tangent_is_the_derivative_of_the_values(assembled):
    assembly = assembled(*three(), LINE | {"kind": "parallelism"}, LINE | {"kind": "profile"})
    made = Characteristics.of(assembly.scene)
    readings = np.random.default_rng(3).standard_normal((5, made.start[-1]))
    step = 1e-7 * np.random.default_rng(4).standard_normal(readings.shape)
    change = np.einsum("nkr,nr->nk", made.tangent(readings), step)
    np.testing.assert_allclose(made.values(readings + step) - made.values(readings), change, rtol=0, atol=1e-14)
    assert (np.abs(change) > 1e-9).all()


@pytest.mark.slow
def test_a_placed_scene_survives_writing_and_reading(assembled):
    fitted = LINE | {"kind": "profile", "best_fit": ["M3"]}
    hole = between("distance")
    placed = assembled(between("flush"), between("gap"), hole, LINE | {"kind": "parallelism"}, fitted).scene
    again = mic.scene.Scene.model_validate_json(placed.model_dump_json())
    assert again.model_copy(update={"folder": placed.folder}) == placed


@pytest.mark.parametrize(
    "item, message",
    [
        (between("gap") | {"to": None}, "between two points: give the other as to"),
        (POINT | LIMITS | {"to": {"part": "upper", "point": [90, 12.5, 1]}}, "point has no second point, remove it"),
        (between("flush", part="uper"), "there is no part called 'uper'"),
        (between("gap", point=[80, 12.5, 1]), "defines no direction; give a gap with a direction"),
        (between("distance", point=[80, 12.5, 0], part="lower"), "defines no direction"),
        (between("distance", direction=[0, 0, 1]), "a distance is read along the line between its points"),
        (between("flush", point=[90, 12.5, 40]), "M0): [90.0, 12.5, 40.0] is 39 mm away from part 'upper'"),
        (between("flush") | {"to": {"part": "upper"}}, "give point = [x, y, z], or node or set or hole"),
        (POINT | LIMITS | {"points": [[1, 2, 0], [3, 4, 0]]}, "points goes with kind parallelism or profile"),
        (LINE | {"kind": "profile", "spacing": 3.0}, "takes either points"),
        (LINE | {"kind": "profile", "point": [150, 4, 1]}, "read at many points: give points or spacing"),
        (LINE | {"kind": "profile", "direction": [0, 0, 1]}, "read along the normals at its points"),
        (LINE | {"kind": "parallelism", "lower": -1.0}, "never negative and its lower limit is 0"),
        (LINE | {"kind": "parallelism", "upper": 0.0}, "lower must be smaller than upper"),
        (LINE | {"kind": "profile", "points": [[150, 4, 1], [150, 4, 30]]}, "points[1] (M0): [150.0, 4.0, 30.0] is"),
        (LINE | {"kind": "profile", "points": [[150, 4, 1]]}, "at least 2"),
        (LINE | {"kind": "profile", "box": [[0, 0, 0], [1, 1, 1]]}, "box goes with spacing"),
        ({"part": "upper", "kind": "profile", "spacing": 9.0, "box": [[0, 0, 0], [1, 1, 1]], "upper": 1}, "0 points"),
        (LINE | {"kind": "roundness"} | LIMITS, "kind"),
        (POINT | LIMITS | {"best_fit": ["M9"]}, "there is no measurement called 'M9'"),
        (POINT | LIMITS | {"best_fit": ["M0"]}, "removes everything that this measurement reads"),
    ],
)
def test_invalid_measurements_are_refused_in_one_sentence(assembled, item, message):
    with pytest.raises(SceneError) as caught:
        assembled(item)
    assert message in str(caught.value) and len(str(caught.value).splitlines()) == 1
