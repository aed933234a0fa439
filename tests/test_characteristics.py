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
#: A line of points across the upper strip.
LINE = {"part": "upper", "points": [[150, y, 1] for y in (4, 9, 16, 21)], "upper": 0.5}
FAR = {"part": "upper", "point": [150, 20, 1]} | LIMITS
ALONG = FAR | {"direction": [1, 0, 0]}
BOX = {"part": "upper", "kind": "profile", "spacing": 8.0, "box": [[100, -1, 0], [161, 26, 2]], "upper": 1.0}
UP = {"part": "lower", "direction": [0, 0, 1]} | LIMITS
FIT = {"best_fit": ["Z0", "Z1", "Z2"]}
GRID = [[x, y, 0] for x in (12, 40, 70) for y in (5, 18)]


def between(kind, part="upper", point=(90, 12.5, 1), **keys):
    return POINT | {"kind": kind, "to": {"part": part, "point": list(point)}} | LIMITS | keys


MEASURED = {
    "flush": between("flush"),
    "gap": between("gap"),
    "distance": between("distance"),
    "sideways": between("gap", direction=[0, 1, 0], point=[80, 12.5, 1]),
    "parallelism": LINE | {"kind": "parallelism", "radius": 0.0},
    "flatness": LINE | {"kind": "parallelism", "best_fit": ["flatness"], "radius": 0.0},
    "profile": LINE | {"kind": "profile"},
    "box": BOX,
    "far": FAR,
    "along": ALONG,
    "far_fitted": FAR | FIT,
    "along_fitted": ALONG | FIT,
    "profile_fitted": LINE | {"kind": "profile"} | FIT,
    "flush_fitted": between("flush") | FIT,
    "far_on_one": FAR | {"best_fit": ["Z0"]},
}
MEASURED |= {f"Z{i}": UP | {"point": [*place, 0]} for i, place in enumerate(([15, 5], [15, 20], [60, 12.5]))}
SIX = {f"G{i}": UP | {"point": place, "radius": 0.0} for i, place in enumerate(GRID)}
MEASURED |= {name: item | {"best_fit": list(SIX)} for name, item in SIX.items()}


def scene(measurements):
    table = tomllib.loads(LAP.read_text())
    for part in table["parts"]:
        part["size"] = "coarse"
    table["zones"][0]["pairs"] = 2
    table["measurements"] = [{"name": name} | each for name, each in measurements.items()]
    return read_table(table, LAP)


@pytest.fixture(scope="module")
def lap(cache):
    """The lap joint on coarse meshes with all measurements."""
    return assemble(scene(MEASURED), cache)


def points_read(lap, *fields):
    """(r,) what the points of all measurements read where each part moves by a field u(x) (q, 3) → (q, 3)."""
    readings = []
    for part, field in zip(lap.parts, fields):
        f = part.functionals
        moved = [patch.weight @ field(part.surface.at(patch.triangle, patch.barycentric)) for patch in f.patches]
        readings.append((np.array(moved)[f.patch] * f.direction).sum(axis=1))
    return lap.rows["measurement"] @ np.concatenate(readings)


def read(lap, *fields):
    """Characteristics by name."""
    return dict(zip(MEASURED, Characteristics.of(lap.scene).values(points_read(lap, *fields)[None])[0]))


def rigid(shift, turn=(0.0, 0.0, 0.0)):
    return lambda x: np.asarray(shift) + np.cross(np.broadcast_to(np.asarray(turn, dtype=float), x.shape), x)


STILL = rigid([0, 0, 0])


def test_flush_gap_and_distance_measure_the_second_point_relative_to_the_first(lap):
    line = np.array([10, 0, 1]) / np.sqrt(101)
    directions = [item.direction for item in lap.scene.measurements[:4]]
    np.testing.assert_allclose(directions, [[0, 0, 1], [1, 0, 0], line, [0, 1, 0]], atol=1e-9)
    shift = np.array([0.3, -0.2, 0.5])
    for fields, sign in (((STILL, rigid(shift)), 1.0), ((rigid(shift), STILL), -1.0)):
        found = read(lap, *fields)
        expected = {"flush": 0.5, "gap": 0.3, "distance": shift @ line, "sideways": -0.2}
        for name, value in expected.items():
            assert found[name] == pytest.approx(sign * value, abs=1e-12)


def test_parallelism_measures_tilt_and_no_shift(lap):
    assert read(lap, STILL, rigid([1, 2, 3]))["parallelism"] == pytest.approx(0.0, abs=1e-12)
    for turn in (1e-2, -1e-2):
        found = read(lap, STILL, rigid([0, 0, 1], [turn, 0, 0]))
        assert found["parallelism"] == pytest.approx(0.17, abs=1e-3)
        assert found["flatness"] == pytest.approx(0.0, abs=1e-12)  # fitted on itself
    bent = lambda x: np.column_stack([0 * x[:, :2], 1e-2 * (x[:, 1] - 12.5) ** 2])
    assert read(lap, STILL, bent)["flatness"] > 0.3


def test_a_profile_is_twice_the_largest_deviation_on_either_side_and_positive_along_the_mesh_normals(lap):
    for side in (1.0, -1.0):
        found = read(lap, STILL, lambda x, side=side: side * np.column_stack([0 * x[:, :2], 0.1 + 0.01 * x[:, 1]]))
        assert found["profile"] == pytest.approx(2 * (0.1 + 0.21), rel=1e-3)
    n = lap.parts[1].surface.normals.mean(axis=0)
    own = Characteristics.of(lap.scene).readings(list(MEASURED).index("profile"))
    np.testing.assert_allclose(points_read(lap, STILL, rigid(0.3 * n))[own], 0.3, atol=1e-12)


def test_a_profile_over_a_box_has_points_all_over_it_and_none_outside(lap):
    placed = lap.scene.measurements[list(MEASURED).index("box")]
    x = np.array(placed.points)
    assert len(x) > 10 and x[:, 0].min() >= 100 and placed.spacing is None
    grid = np.stack(np.meshgrid(np.arange(100, 161, 5.0), np.arange(0, 26, 5.0)), -1).reshape(-1, 2)
    farthest = np.linalg.norm(grid[:, None] - x[None, :, :2], axis=2).min(axis=1).max()
    assert farthest < 8.0 + 4.0  # half an element's diagonal


def test_a_best_fit_removes_rigid_motion(lap):
    motion = rigid([0.1, 0.2, 0.3], [1e-3, 2e-3, 0])
    found = read(lap, motion, motion)
    assert abs(found["distance"]) < 1e-5  # a disc's middle is found to 2 µm
    for name in ("far", "profile", "flush"):
        assert found[f"{name}_fitted"] == pytest.approx(0.0, abs=1e-12) and abs(found[name]) > 0.01
    shift = rigid([0.1, 0, 0])  # which three points along the normal do not tell
    assert read(lap, shift, shift)["along_fitted"] == pytest.approx(0.1)


def test_a_best_fit_on_one_point_removes_its_shift_only(lap):
    moved = rigid([0.1, 0.2, 0.3], [1e-3, 2e-3, 0])
    found = read(lap, moved, moved)
    assert found["far_on_one"] == pytest.approx(found["far"] - found["Z0"], abs=1e-12) and abs(found["Z0"]) > 0.1


def test_a_best_fit_on_more_points_is_by_least_squares(lap):
    bent = lambda x: np.column_stack([0 * x[:, :2], 1e-3 * (x[:, 0] - 30) ** 2 + 0.02 * x[:, 1]])
    x = np.array(GRID, dtype=float)
    z = bent(x)[:, 2]
    plane = np.column_stack([np.ones(6), x[:, :2]])
    expected = z - plane @ np.linalg.lstsq(plane, z, rcond=None)[0]
    assert np.abs(expected).max() > 0.1
    found = read(lap, bent, STILL)
    np.testing.assert_allclose([found[name] for name in SIX], expected, atol=1e-12)


def test_the_tangent_is_the_derivative_of_the_values(lap):
    made = Characteristics.of(lap.scene)
    readings = np.random.default_rng(3).standard_normal((5, made.start[-1]))
    step = 1e-7 * np.random.default_rng(4).standard_normal(readings.shape)
    change = np.einsum("nkr,nr->nk", made.tangent(readings), step)
    np.testing.assert_allclose(made.values(readings + step) - made.values(readings), change, rtol=0, atol=1e-14)
    assert (np.abs(change) > 1e-10).all()


def test_a_placed_scene_survives_writing_and_reading(lap):
    again = mic.scene.Scene.model_validate_json(lap.scene.model_dump_json())
    assert again.model_copy(update={"folder": lap.scene.folder}) == lap.scene


@pytest.mark.parametrize(
    "item, message",
    [
        (between("gap") | {"to": None}, "between two points: give the other as to"),
        (POINT | LIMITS | {"to": {"part": "upper", "point": [90, 12.5, 1]}}, "point has no second point, remove it"),
        (between("flush", part="uper"), "there is no part called 'uper'"),
        (between("distance", direction=[0, 0, 1]), "a distance is read along the line between its points"),
        (
            between("flush") | {"to": {"part": "upper", "point": [0, 0, 1], "node": 1}},
            "point and node both give its place",
        ),
        (POINT | LIMITS | {"points": [[1, 2, 0], [3, 4, 0]]}, "points goes with kind parallelism or profile"),
        (LINE | {"kind": "profile", "spacing": 3.0}, "takes either points"),
        (LINE | {"kind": "profile", "point": [150, 4, 1]}, "read at many points: give points or spacing"),
        (LINE | {"kind": "profile", "direction": [0, 0, 1]}, "read along the normals at its points"),
        (LINE | {"kind": "parallelism", "lower": -1.0}, "never negative and its lower limit is 0"),
        (LINE | {"kind": "parallelism", "upper": 0.0}, "lower must be smaller than upper"),
        (LINE | {"kind": "profile", "points": [[150, 4, 1]]}, "at least 2"),
        (LINE | {"kind": "profile", "box": [[0, 0, 0], [1, 1, 1]]}, "box goes with spacing"),
        (LINE | {"kind": "roundness"} | LIMITS, "kind"),
        (POINT | LIMITS | {"best_fit": ["M9"]}, "there is no measurement called 'M9'"),
    ],
)
def test_invalid_measurements_are_refused_in_one_sentence(item, message):
    with pytest.raises(SceneError) as caught:
        scene({"M0": item})
    assert message in str(caught.value) and len(str(caught.value).splitlines()) == 1


#: What cannot be placed on the meshes, and what cannot be read there: a sentence each.
UNPLACED = [
    (between("gap", point=[80, 12.5, 1]), "defines no direction; give a gap with a direction"),
    (between("distance", point=[80, 12.5, 0], part="lower"), "defines no direction"),
    (BOX | {"box": [[0, 0, 0], [1, 1, 1]]}, "0 points"),
]
UNREAD = [
    (between("flush", point=[90, 12.5, 40]), "M0): (90, 12.5, 40) is 39 mm away from part 'upper'"),
    (LINE | {"kind": "profile", "points": [[150, 4, 1], [150, 4, 30]]}, "points[1] (M1): (150, 4, 30) is"),
    (POINT | LIMITS | {"best_fit": ["M2"]}, "removes everything that this measurement reads"),
]


@pytest.mark.parametrize("wrong", [UNPLACED, UNREAD])
def test_errors_of_all_measurements_are_reported_together(wrong, cache):
    with pytest.raises(SceneError) as caught:
        assemble(scene({f"M{i}": item for i, (item, _) in enumerate(wrong)}), cache)
    for line, (_, message) in zip(str(caught.value).splitlines(), wrong, strict=True):
        assert message in line
