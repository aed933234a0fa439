"""T joints: a sheet that stands on another one by its edge, and welds along it."""

import tomllib

import numpy as np
import pytest
from support.decks import extruded, grid, write_deck

import mic
from mic.geometry.pairing import Side, pair_at
from mic.geometry.surface import Surface
from mic.model.assembly import assemble
from mic.model.rigid_motion import rigid_readings
from mic.plausibility import find_warnings
from mic.scene import load_scene
from mic.scene.load import read_table
from mic.wizard import write_scene


def turn(seed):
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return rotation * np.sign(np.linalg.det(rotation))


def surface(sheet, rotation=None):
    points, cells = sheet
    triangles = np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])
    return Surface(points if rotation is None else points @ rotation.T, triangles)


def tee(height, below=False):
    """A sheet of 100 × 60 and a wall of 40 along its middle, its edge at a height."""
    sign = -1.0 if below else 1.0
    return grid(100, 60, 7), extruded([(50, sign * height), (50, sign * (height + 40))], 5, 55, 8)


@pytest.mark.parametrize("below", [False, True])
@pytest.mark.parametrize("height, gap", [(1.0, 0.0), (0.0, 0.0), (1.6, 0.6)])
def test_the_pair_reads_both_sheets_at_the_edge(height, gap, below):
    """Normal from the first to the second, gap to the face; both readings are of the points of the edge."""
    rotation = turn(1)
    sheet, wall = (surface(one, rotation) for one in tee(height, below))
    bodies = Side(sheet, 2.0), Side(wall, 2.0)
    up = rotation @ [0, 0, -1.0 if below else 1.0]
    for pair, n in ((pair_at(rotation @ [50, 30, 0], 2.5, *bodies), up),
                    (pair_at(rotation @ [50, 30, 0], 2.5, *bodies[::-1]), -up)):  # fmt: skip
        assert pair.frame[:, 0] == pytest.approx(n) and pair.gap == pytest.approx(gap, abs=1e-9)
    for point, offset, side in zip(pair.patches, pair.offsets, (wall, sheet)):
        at = side.at(point.triangle, point.barycentric) + (offset * 1.0 * side.normals[point.triangle])
        local = at @ rotation
        assert local[:, 0] == pytest.approx(50) and local[:, 2] == pytest.approx(-height if below else height)
        assert np.abs(local[:, 1] - 30).max() <= 5.1 and point.weight @ local[:, 1] == pytest.approx(30, abs=1.0)
        assert point.weight.sum() == pytest.approx(1)


def test_there_is_no_pair_where_the_edge_stands_beside_the_sheet():
    sheet, wall = (surface(one) for one in tee(1.0))
    beside = Surface(wall.points + [60, 0, 0], wall.triangles)
    with pytest.raises(ValueError, match="do not face each other"):
        pair_at([100, 30, 0], 2.5, Side(sheet, 2.0), Side(beside, 2.0))


@pytest.fixture(scope="module")
def proposed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tee")
    rotation, files = turn(2), []
    for name, (points, cells) in zip(("sheet", "wall"), tee(1.0)):
        files.append(write_deck(folder / f"{name}.inp", {"S": (points @ rotation.T, cells)}, sections={}, first=101))
    made, proposal = write_scene(files, folder / "scene", {None: 2.0})
    return made, proposal, rotation


def test_welds_along_the_edge_are_proposed_and_the_missing_contact_is_stated(proposed):
    folder, proposal, rotation = proposed
    assert [sentence for sentence in proposal.sentences if "stands on sheet by its edge, over 50 mm" in sentence]
    assert "the contact of an edge is not modelled" in (folder / "scene.toml").read_text().replace("\n# ", " ")
    welds = np.array(tomllib.loads((folder / "scene.toml").read_text())["welds"][0]["points"]) @ rotation
    assert len(welds) == 2 and welds[:, 0] == pytest.approx(50, abs=0.02) and np.ptp(welds[:, 1]) > 30
    assert welds[:, 1].min() >= 9.9 and welds[:, 1].max() <= 50.1  # 5 mm off the ends
    assert len(proposal.base) == 1  # one group


@pytest.mark.slow
def test_the_proposed_scene_has_no_warning_and_its_welds_read_no_rigid_motion(proposed, cache):
    """Turning the welded assembly as a whole strains no weld."""
    folder = proposed[0]
    assembly = assemble(load_scene(folder), cache)
    assert find_warnings(assembly.scene, assembly) == ()
    centre = assembly.parts[0].surface.centroid
    motions = []
    for part in assembly.parts:
        shift = np.eye(6)
        shift[:3, 3:] = np.cross(np.eye(3), part.surface.centroid - centre).T
        motions.append(rigid_readings(part) @ shift)
    read = assembly.rows["weld"] @ np.concatenate(motions)
    assert read.shape == (12, 6) and np.abs(read).max() < 1e-8
    alone = assembly.rows["weld"] @ np.concatenate([motions[0], 0 * motions[1]])
    assert np.linalg.matrix_rank(alone, 1e-6) == 6  # each weld ties translations and rotations


@pytest.mark.fem
@pytest.mark.slow
def test_a_wall_on_a_rigid_base_bends_as_a_cantilever(tmp_path, cache):
    """A wall of 40 × 50 × 1 on a base of 8 mm: its tip moves by F L³/(3 E I) when a clamp pushes it."""
    write_deck(tmp_path / "base.inp", {"S": grid(100, 60, 7)}, first=1)
    write_deck(tmp_path / "wall.inp", {"S": extruded([(50, 4.0), (50, 44.0)], 5, 55, 3)}, first=1)

    def item(name, part, point, axis, **keys):
        return {"name": name, "part": part, "point": point, "direction": np.eye(3)["xyz".index(axis)].tolist()} | keys

    supports = {
        "base": [(10, 10, "z"), (90, 10, "z"), (50, 50, "z"), (10, 30, "y"), (90, 30, "y"), (50, 30, "x")],
        "wall": [(10, 20, "x"), (50, 20, "x"), (30, 40, "x"), (10, 30, "z"), (50, 30, "z"), (30, 30, "y")],
    }
    material = {"young": 210e3, "poisson": 0.0}
    force = 4.0
    table = {
        "name": "tee",
        "parts": [
            {"name": name, "mesh": f"{name}.inp", "thickness": t} | material for name, t in (("base", 8), ("wall", 1))
        ],
        "locators": [
            item(f"{part}{i}", part, [a, b, 0] if part == "base" else [50, a, b], axis, radius=0)
            for part, rows in supports.items()
            for i, (a, b, axis) in enumerate(rows)
        ],
        "clamps": [
            item(f"C{y}", "wall", [50, y, 44], "x", force=force / 5, radius=3, stage="load")
            for y in (10, 20, 30, 40, 50)
        ],
        "welds": [{"name": "W", "parts": ["base", "wall"], "points": [[50, y, 4] for y in range(8, 56, 4)]}],
        "stages": [
            {"kind": "locate"},
            {"kind": "weld"},
            {"kind": "release", "keep": [f"base{i}" for i in range(6)]},
            {"kind": "clamp", "name": "load"},
            {"kind": "measure"},
        ],
        "measurements": [item("tip", "wall", [50, 30, 44], "x", radius=0, lower=-1, upper=1)],
        "deviations": [{"name": "D", "kind": "locator", "target": "base5", "sigma": 0.1}],
        "monte_carlo": {"samples": 1, "seed": 1},
    }
    model = mic.reduce(read_table(table, tmp_path / "scene.toml"), cache)
    tip = float(model.evaluate({}).measurements[0, 0])
    length, inertia = 40.0, 50 * 1.0**3 / 12
    assert tip == pytest.approx(force * length**3 / (3 * 210e3 * inertia), rel=0.06)
