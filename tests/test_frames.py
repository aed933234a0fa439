"""Measurement frames and seams, each against a calculation by hand."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.decks import grid, write_deck

from mic.commands.explain import read_measured
from mic.errors import SceneError
from mic.model.assembly import assemble
from mic.model.characteristics import Characteristics, aligned
from mic.process.description import alignments
from mic.scene import Scene
from mic.scene.load import read_table

LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint" / "scene.toml"
LIMITS = {"lower": -1.0, "upper": 1.0}
#: Six points and directions of a 3-2-1 alignment, on nodes of the parts.
DATUMS = [
    ("lower", [0, 0, 0], [0, 0, 1]),
    ("lower", [0, 25, 0], [0, 0, 1]),
    ("upper", [160, 25, 1], [0, 0, 1]),
    ("lower", [0, 0, 0], [0, 1, 0]),
    ("upper", [160, 0, 1], [0, 1, 0]),
    ("lower", [0, 0, 0], [1, 0, 0]),
]
NODE = {"radius": 0.0}  # reads one node, whose place is known exactly
CORNERS = [("lower", [0, 0, 0]), ("lower", [0, 25, 0]), ("upper", [160, 0, 1]), ("upper", [160, 25, 1])]
WEIGHTS = [1.0, 2.0, 0.5, 3.0]
AXES = np.eye(3).tolist()


def point(name, part, x, d):
    return {"name": name, "part": part, "point": x, "direction": d} | NODE


DATUM = {"name": "datum", "kind": "3-2-1", "points": [point(f"D{i}", *each) for i, each in enumerate(DATUMS)]}
CLOUD = {
    "name": "cloud",
    "points": [point(f"C{i}{'xyz'[j]}", *each, d) for i, each in enumerate(CORNERS) for j, d in enumerate(AXES)],
    "weights": np.repeat(WEIGHTS, 3).tolist(),
}
FAR = {"part": "upper", "point": [160, 0, 1], "direction": [0, 0, 1]} | NODE | LIMITS
SIDE = {"part": "upper", "point": [160, 25, 1], "direction": [1, 0, 0]} | NODE | LIMITS
MEASURED = {
    "far": FAR | {"frame": "none"},
    "far in datum": FAR,
    "side in datum": SIDE,
    "profile": {"part": "upper", "kind": "profile", "points": [[160, y, 1] for y in (0, 25)], "upper": 1.0} | NODE,
    "far in cloud": FAR | {"frame": "cloud"},
    "side in cloud": SIDE | {"frame": "cloud"},
    "far on names": FAR | {"frame": "names"},
    "at": point("", *DATUMS[1]) | LIMITS | {"frame": "none"},
}
NAMES = {"name": "names", "points": ["at", "lower-A1"]}


def scene(measured, frames, **changes):
    table = tomllib.loads(LAP.read_text()) | changes
    for part in table["parts"]:
        part["size"] = "coarse"
    table["zones"][0]["pairs"] = 2
    table["measurements"] = [each | {"name": name.replace(" ", "-")} for name, each in measured.items()]
    return read_table(table | {"frames": frames}, LAP)


@pytest.fixture(scope="module")
def lap(cache):
    return assemble(scene(MEASURED, [DATUM | {"all": True}, CLOUD, NAMES]), cache)


def read(lap, field):
    """Characteristics by name where all parts move by a field u(x) (q, 3) → (q, 3)."""
    readings = []
    for part in lap.parts:
        f = part.functionals
        moved = [patch.weight @ field(part.surface.at(patch.triangle, patch.barycentric)) for patch in f.patches]
        readings.append((np.array(moved)[f.patch] * f.direction).sum(axis=1))
    values = Characteristics.of(lap.scene).values((lap.rows["measurement"] @ np.concatenate(readings))[None])[0]
    return dict(zip(MEASURED, values))


def rigid(shift, turn):
    return lambda x: np.asarray(shift) + np.cross(np.asarray(turn), x)


def bent(x):
    """A field that no rigid motion is."""
    return 1e-3 * np.column_stack([np.sin(x[:, 0] / 50), np.cos(x[:, 1] / 9), np.sin(x[:, 0] / 70 + x[:, 1])])


def test_rigid_motion_is_removed_exactly(lap):
    found = read(lap, rigid([0.3, -0.2, 0.1], [1e-3, -2e-3, 3e-3]))
    assert abs(found["far"]) > 0.1
    for name in ("far in datum", "side in datum", "profile", "far in cloud", "side in cloud"):
        assert found[name] == pytest.approx(0.0, abs=1e-12), name


def test_three_two_one_is_the_solution_of_six_equations(lap):
    found = read(lap, bent)
    x, d = (np.array([each[k] for each in DATUMS], dtype=float) for k in (1, 2))
    equations = np.hstack([d, np.cross(x, d)])  # u = a + ω × x along d: a · d + ω · (x × d)
    motion = np.linalg.solve(equations, (bent(x) * d).sum(axis=1))
    for name, item in (("far in datum", FAR), ("side in datum", SIDE)):
        x, d = np.array([item["point"]], dtype=float), item["direction"]
        expected = (bent(x)[0] - motion[:3] - np.cross(motion[3:], x[0])) @ d
        assert abs(expected) > 1e-5 and found[name] == pytest.approx(expected, abs=1e-12)
    ends = [
        bent(x)[0, 2] - motion[2] - np.cross(motion[3:], x[0])[2] for x in np.array([[[160, 0, 1]], [[160, 25, 1]]])
    ]
    assert found["profile"] == pytest.approx(2 * np.abs(ends).max(), rel=1e-9)


def test_a_weighted_best_fit_is_that_of_scipy_for_a_small_rotation_and_noise(lap):
    turn, shift, noise = np.array([2e-5, -3e-5, 4e-5]), np.array([1e-3, 2e-3, -1e-3]), 1e-4
    x = np.array([each for _, each in CORNERS], dtype=float)
    drawn = noise * np.random.default_rng(5).standard_normal(x.shape)
    field = lambda p: rigid(shift, turn)(p) + drawn[np.abs(p[:, None] - x).sum(axis=2).argmin(axis=1)]
    found, w = read(lap, field), np.array(WEIGHTS)
    moved = x + field(x)
    centres = [w @ points / w.sum() for points in (x, moved)]
    turned = Rotation.align_vectors(moved - centres[1], x - centres[0], weights=w)[0]
    left = moved - centres[1] - turned.apply(x - centres[0])  # second order in the rotation: 1e-9 · 160 mm
    assert found["far in cloud"] == pytest.approx(left[2, 2], abs=1e-6)
    assert found["side in cloud"] == pytest.approx(left[3, 0], abs=1e-6)
    plain = Rotation.align_vectors(moved - moved.mean(axis=0), x - x.mean(axis=0))[0]
    unweighted = moved - moved.mean(axis=0) - plain.apply(x - x.mean(axis=0))
    assert abs(unweighted[2, 2] - left[2, 2]) > 1e-5  # the weights count


def test_points_may_be_measurements_and_locators(lap):
    """Two points along the normal see a shift along it, and no turn about the line through them."""
    shifted = read(lap, rigid([0.1, 0.2, 0.3], [0, 0, 0]))
    assert shifted["far on names"] == pytest.approx(0.0, abs=1e-12) and shifted["far"] == pytest.approx(0.3)
    assert read(lap, bent)["far on names"] != pytest.approx(read(lap, bent)["far"], abs=1e-5)


def test_measured_values_are_aligned_as_the_model_is(lap, tmp_path):
    """Values in the coordinates of a machine, in which the assembly stands anywhere."""
    field = lambda x: bent(x) + rigid([5.0, -3.0, 2.0], [1e-2, 2e-2, -1e-2])(x)
    raw = {f"D{i}": field(np.array([x], dtype=float))[0] @ d for i, (_, x, d) in enumerate(DATUMS)}
    raw |= {"far-in-datum": field(np.array([FAR["point"]], dtype=float))[0, 2]}
    expected = read(lap, bent)["far in datum"]
    assert aligned(lap.scene, raw)["far-in-datum"] == pytest.approx(expected, abs=1e-9)
    path = tmp_path / "machine.csv"
    path.write_text("Feature,Dev\n" + "".join(f"{name},{value!r}\n" for name, value in raw.items()))
    values, _, said = read_measured(path, 0.01, lap.scene, align=True)
    assert values == {"far-in-datum": pytest.approx(expected, abs=1e-9)} and "are aligned likewise" in said[-1]
    del raw["D3"]
    with pytest.raises(SceneError, match="far-in-datum: it cannot be aligned, since 'D3' has no single measured value"):
        aligned(lap.scene, raw)


def test_the_description_states_the_frames(lap):
    first, second, third = alignments(lap.scene)
    names = "far-in-datum, side-in-datum and profile"
    assert first == f"Before {names}, the assembly is aligned (frame datum, 3-2-1 of D0, D1, D2, D3, D4 and D5)."
    assert second.endswith("(frame cloud, best fit of C0x, C0y, C0z, C1x, … C3z (12), weights 1, 1, 1, 2, … 3 (12)).")
    assert third == "Before far-on-names, the assembly is aligned (frame names, best fit of at and lower-A1)."


@pytest.mark.parametrize(
    ("item", "frames", "said"),
    [
        ({"frame": "datun"}, [DATUM], "no frame called 'datun'; did you mean 'datum'"),
        ({"frame": "datum", "best_fit": ["far"]}, [DATUM], "frame and best_fit exclude each other"),
        ({}, [DATUM | {"points": DATUM["points"][:5]}], "give six points"),
        ({}, [DATUM | {"weights": [1.0] * 6}], "a 3-2-1 alignment is exact: remove weights"),
        ({}, [CLOUD | {"weights": [1.0]}], "there are 12 points and 1 weights"),
        ({}, [CLOUD | {"points": ["nowhere"], "weights": [1.0]}], "no measurement or locator called 'nowhere'"),
        ({}, [DATUM | {"all": True}, CLOUD | {"all": True}], "another frame is for all measurements"),
        ({}, [DATUM | {"name": "none"}], "this name means no frame"),
        ({}, [{"name": "own", "points": [point("far", *DATUMS[0])]}], "is called 'far', too"),
        ({}, [{"name": "own", "points": [point("P", "lover", *DATUMS[0][1:])]}], "no part called 'lover'"),
    ],
)
def test_a_wrong_frame_is_refused(item, frames, said):
    with pytest.raises(SceneError, match=said):
        scene({"far": FAR | item}, frames)


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (
            [point(f"D{i}", "lower", [x, y, 0], [0, 0, 1]) for i, (x, y) in enumerate(np.ndindex(3, 2))],
            r"determine 3 of 6 rigid-body motions \(free: along x, along y, about z\)",
        ),
        (DATUM["points"][:5] + [point("D5", "lower", [500, 0, 0], [1, 0, 0])], "D5|500"),
    ],
)
def test_datums_that_leave_a_motion_free_are_refused(cache, points, said):
    with pytest.raises(SceneError, match=said):
        assemble(scene({"far": FAR | {"frame": "datum"}}, [DATUM | {"points": points}]), cache)


# ------------------------------------------------------------------------------------------------------------ seams


@pytest.fixture(scope="module")
def plates(tmp_path_factory, cache):
    """Two plates in a plane, 4 mm apart, the second 0.5 mm higher; gap and flush by a list of points at the first."""
    folder = tmp_path_factory.mktemp("seam")
    points, cells = grid(40, 60, 5)
    write_deck(folder / "fender.inp", {"FENDER": (points, cells)}, first=1)
    write_deck(folder / "door.inp", {"DOOR": (points + [44, 0, 0.5], cells)}, first=10001)
    held = [([5, 5], 2), ([35, 5], 2), ([20, 50], 2), ([5, 5], 1), ([35, 5], 1), ([5, 5], 0)]
    locators = [
        {"name": f"{part}-{i}", "part": part, "point": [x + at, y, z], "direction": np.eye(3)[axis].tolist()}
        for part, at, z in (("fender", 0, 0.0), ("door", 44, 0.5))
        for i, ((x, y), axis) in enumerate(held)
    ]
    seam = [[40, 10, 0], [41, 30, 0], [40, 50, 0]]
    items = [
        {"name": kind, "kind": kind, "part": "fender", "points": seam, "to": {"part": "door"}} | NODE | LIMITS
        for kind in ("gap", "flush")
    ]
    table = {
        "name": "seam",
        "parts": [{"name": n, "mesh": f"{n}.inp", "thickness": 1.0} for n in ("fender", "door")],
        "locators": locators,
        "stages": [{"kind": kind} for kind in ("locate", "measure")],
        "measurements": items,
    }
    return assemble(Scene(**table, folder=folder), cache)


def test_gap_and_flush_along_a_seam_are_those_of_the_nearest_points(plates):
    measured = plates.scene.measurements
    assert [item.name for item in measured] == ["gap-1", "gap-2", "gap-3", "flush-1", "flush-2", "flush-3"]
    for item, y in zip(measured, (10, 30, 50) * 2):
        assert item.to.point == pytest.approx([44, y, 0.5])
        normal = [1, 0, 0] if item.kind == "gap" else [0, 0, 1]
        np.testing.assert_allclose(np.abs(item.direction), normal, atol=1e-9)
    readings = []
    for part, move in zip(plates.parts, (rigid([0, 0, 0], [0, 0, 0]), rigid([0.3, 0.0, -0.2], [0, 0, 1e-3]))):
        f = part.functionals
        moved = [patch.weight @ move(part.surface.at(patch.triangle, patch.barycentric)) for patch in f.patches]
        readings.append((np.array(moved)[f.patch] * f.direction).sum(axis=1))
    found = plates.rows["measurement"] @ np.concatenate(readings)
    upward = measured[3].direction[2]
    expected = [0.3 - 1e-3 * y for y in (10, 30, 50)] + [-0.2 * upward] * 3  # the door turns about z
    np.testing.assert_allclose(found, expected, atol=1e-9)
