"""The variation that `mic init` proposes: in millimetres, and bounded at every node of the free part."""

import tomllib

import numpy as np
import pytest
from support.decks import arc, extruded, grid, write_deck

import mic
from mic.model.assembly import assemble
from mic.model.one_sigma import displacements, one_sigma
from mic.model.stiffness_estimate import HeldSheet
from mic.scene.load import read_table
from mic.wizard import write_scene
from mic.wizard.bodies import read_bodies
from mic.wizard.fixture import propose_fixture
from mic.wizard.variation import LOCATOR, MOVED, form_tolerance, propose_variation


def random_sheet(rng):
    """A strip, arc, angle, channel, hat, saddle or plate with cut-outs, of any size and proportion, askew."""
    a = rng.uniform(60, 900)
    b = a * rng.uniform(0.08, 1.0)
    size = min(a / rng.integers(8, 15), b / 3)
    size = max(size, a / 40)
    kind = rng.integers(7)
    if kind < 5:
        turn = rng.uniform(20, 320)
        profiles = (
            [(0, 0), (a, 0)],
            arc(a / np.radians(turn), 0, turn, size),
            [(0, 0), (a / 2, 0), (a / 2, a / 2)],
            [(0, a / 4), (0, 0), (a / 2, 0), (a / 2, a / 4)],
            [(0, 0), (a / 4, 0), (0.3 * a, a / 5), (0.7 * a, a / 5), (0.75 * a, 0), (a, 0)],
        )
        points, cells = extruded(profiles[kind], 0, b, size)
    else:
        points, cells = grid(a, b, size)
        if kind == 5:
            twist = rng.uniform(-0.5, 0.5, 2) / a
            points[:, 2] = ((points[:, :2] - [a / 2, b / 2]) ** 2) @ twist
        else:
            middle = points[cells].mean(axis=1)
            away = np.hypot(middle[:, 0] - 0.6 * a, middle[:, 1] - 0.4 * b) > 0.22 * b
            used, cells = np.unique(cells[away], return_inverse=True)
            points, cells = points[used], np.reshape(cells, (-1, 4))
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return points @ (turned * np.sign(np.linalg.det(turned))).T + rng.uniform(-500, 500, 3), cells


def random_part(rng, folder):
    """A body, its six locators, often crowded by a lap, and what `mic init` lets vary."""
    points, cells = random_sheet(rng)
    file = write_deck(folder / "s.inp", {"S": (points, cells)}, sections={}, first=101)
    (body,) = read_bodies([file], {None: rng.uniform(0.4, 4.0)})
    corner = points[rng.integers(len(points))]
    lap = points[np.linalg.norm(points - corner, axis=1) < rng.uniform(0, 0.4) * body.surface.diameter]
    six = propose_fixture(body, lap)[:6]
    return body, six, propose_variation(body, six)


def scene_of(body, six, deviations, folder):
    locators = []
    for i, support in enumerate(six):
        place = {"hole": support.point.tolist()} if support.hole else {"point": support.point.tolist(), "radius": 4}
        locators.append({"name": f"L{i}", "part": "S", "direction": support.direction.tolist(), **place})
    table = {
        "name": "s",
        "parts": [{"name": "S", "mesh": "s.inp", "thickness": body.thickness, "young": 210e3, "poisson": 0.3}],
        "locators": locators,
        "stages": [{"kind": "locate"}, {"kind": "measure"}],
        "measurements": [{"name": "M", "part": "S", "point": six[0].point.tolist(), "lower": -1, "upper": 1}],
        "deviations": deviations,
        "monte_carlo": {"samples": 10, "seed": 1},
    }
    return read_table(table, folder / "scene.toml")


@pytest.mark.parametrize("size, tolerance", [(10, 0.1), (30.5, 0.4), (162, 0.8), (1000, 1.2), (2999, 1.6), (5000, 1.6)])
def test_the_tolerance_of_form_grows_with_the_size(size, tolerance):
    assert form_tolerance(size) == tolerance


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_a_proposed_locator_moves_no_node_of_its_part_far(seed, tmp_path):
    """Found by solving for the rigid motion of the part itself, locator by locator."""
    body, six, variation = random_part(np.random.default_rng(seed), tmp_path)
    rows = np.array([[*one.direction, *np.cross(one.point, one.direction)] for one in six])
    points = body.surface.points
    for k, sigma in enumerate(variation.locators):
        motion = np.linalg.solve(rows, sigma * np.eye(6)[k])
        moved = np.linalg.norm(motion[:3] + np.cross(motion[3:], points), axis=1).max()
        assert 0 < sigma <= LOCATOR and moved <= MOVED * (1 + 1e-6)
        assert sigma == LOCATOR or moved > 0.8 * MOVED  # reduced no further than is needed


@pytest.mark.fem
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_proposed_shape_moves_no_node_of_its_part_by_more_than_stated(seed, tmp_path, cache):
    """With the sheet's own stiffness between the points of the field, and on its locators; and it does move some."""
    body, six, variation = random_part(np.random.default_rng(1000 + seed), tmp_path)
    assert variation.moved == pytest.approx(form_tolerance(body.surface.diameter) / 6)
    field = {"name": "f", "kind": "field", "part": "S", "sigma": variation.sigma, "length": variation.length}
    scene = scene_of(body, six, [field], tmp_path)
    assembly = assemble(scene, cache)
    shapes = one_sigma(assembly, mic.reduce(scene, cache))
    moved = np.sqrt(sum((shape.fields["S"] ** 2).sum(axis=1) for shape in shapes)).max()
    assert 0.25 * variation.moved < moved <= variation.moved
    (estimate,), (found,) = displacements(assembly), displacements(assembly, shapes)
    assert (estimate.rule, found.rule) == ("estimate", "exact")
    assert found.length == pytest.approx(moved) and 0.5 < estimate.length / found.length < 1.6


def test_a_mesh_of_few_elements_gets_locators_alone(tmp_path):
    file = write_deck(tmp_path / "s.inp", {"S": grid(90, 60, 45)}, sections={}, first=101)
    folder, proposal = write_scene([file], tmp_path / "scene", {None: 1.0})
    assert any("only its locators vary" in sentence for sentence in proposal.sentences)
    written = tomllib.loads((folder / "scene.toml").read_text())["deviations"]
    assert {one["kind"] for one in written} == {"locator"} and len(written) == 6


def test_nothing_that_is_proposed_is_a_force(tmp_path):
    file = write_deck(tmp_path / "s.inp", {"S": grid(150, 60, 10)}, sections={}, first=101)
    folder, proposal = write_scene([file], tmp_path / "scene", {None: 1.5})
    text = (folder / "scene.toml").read_text()
    written = tomllib.loads(text)["deviations"]
    assert [one["kind"] for one in written] == ["field"] + 6 * ["locator"]
    assert written[0]["sigma"] == proposal.variation["s"].sigma < 0.8 / 6
    assert "1 σ moves no node of the free part by more than 0.13 mm" in text


def test_what_a_source_does_to_the_free_part_is_known_before_any_coefficient(tmp_path, cache):
    """On three supports, two and one, by hand; the largest first, then what needs the stiffness."""
    write_deck(tmp_path / "s.inp", {"S": grid(100, 50, 10)}, sections={}, first=101)
    rows = [(10, 10, "z"), (90, 10, "z"), (50, 40, "z"), (10, 10, "y"), (90, 10, "y"), (10, 10, "x")]
    locators = [
        {"name": f"L{i}", "part": "S", "point": [x, y, 0], "direction": np.eye(3)["xyz".index(axis)].tolist()}
        for i, (x, y, axis) in enumerate(rows)
    ]
    table = {
        "name": "s",
        "parts": [{"name": "S", "mesh": "s.inp", "thickness": 1.0, "young": 210e3, "poisson": 0.3,
                   "expansion": 1.2e-5, "density": 7850.0}],
        "locators": [one | {"radius": 0} for one in locators]
        + [{"name": "A", "part": "S", "point": [90, 40, 0], "direction": [0, 0, 1], "radius": 0, "stage": "clamp"}],
        "stages": [{"kind": "locate"}, {"kind": "clamp"}, {"kind": "release"}, {"kind": "measure"}],
        "measurements": [{"name": "M", "part": "S", "point": [0, 50, 0], "lower": -1, "upper": 1}],
        "deviations": [
            {"name": "weight", "kind": "gravity", "sigma": 0.1},
            {"name": "later", "kind": "locator", "target": "A", "sigma": 0.15},
            {"name": "warm", "kind": "temperature", "part": "S", "sigma": 50.0},
            {"name": "third", "kind": "locator", "target": "L2", "sigma": 0.2},
            {"name": "long", "kind": "locator", "target": "L4", "sigma": 0.08},
        ],
        "monte_carlo": {"samples": 10, "seed": 1},
    }  # fmt: skip
    table["stages"][2]["keep"] = [f"L{i}" for i in range(6)]
    assembly = assemble(read_table(table, tmp_path / "scene.toml"), cache)
    found = displacements(assembly, one_sigma(assembly))
    known = {one.name: (one.length, one.rule) for one in found}
    assert known["third"] == (pytest.approx(0.2 * 40 / 30), "exact")  # at y = 50, turned about the other two
    # turned about the first pin by 0.08/80: 90 and 40 mm away from it in the plane
    assert known["long"] == (pytest.approx(0.001 * np.hypot(90, 40)), "exact")
    assert known["warm"] == (pytest.approx(50 * 1.2e-5 * np.hypot(90, 40)), "exact")
    assert known["later"] == (0.15, "target") and known["weight"][1] == "stiffness"
    assert [one.name for one in found] == ["third", "later", "long", "warm", "weight"]
    assert found[0].part == "S" and found[0].point[1] == pytest.approx(50)


@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_the_estimated_stiffness_bends_a_strip_as_a_beam(poisson, tmp_path):
    """A cantilever of 100 × 10 × 1, held at its end, of long triangles that all lie alike: within a tenth."""
    write_deck(tmp_path / "s.inp", {"S": grid(105, 10, 5)}, sections={}, first=1)
    (body,) = read_bodies([tmp_path / "s.inp"], {None: 1.0})
    x = body.surface.points
    held = np.flatnonzero(x[:, 0] < 5.1)
    supports = np.repeat(x[held], 3, axis=0), np.tile(np.eye(3), (len(held), 1))
    tip = np.flatnonzero(x[:, 0] > 104.9)
    sheet = HeldSheet(body.surface, 1.0, 210e3, poisson, *supports)
    rows = sheet.rows(x[tip], np.tile([0.0, 0.0, 1.0], (len(tip), 1)))
    expected = 100.0**3 / (3 * 210e3 * 10 / 12)
    assert (rows @ sheet.response(rows)).mean() == pytest.approx(expected, rel=0.15)


def test_the_estimated_stiffness_lets_a_sheet_move_freely_and_stretch_as_it_should(tmp_path):
    """No force under rigid motions of a folded sheet; a strip lengthens by F L/(E A)."""
    write_deck(tmp_path / "s.inp", {"S": extruded([(0, 0), (40, 0), (40, 30)], 0, 60, 10)}, sections={}, first=1)
    (body,) = read_bodies([tmp_path / "s.inp"], {None: 1.5})
    x = body.surface.points
    at = [int(np.argmin(np.linalg.norm(x - place, axis=1))) for place in ([0, 0, 0], [0, 60, 0], [40, 30, 30])]
    chosen = [0, 1, 2, 3, 5, 8]
    supports = x[np.repeat(at, 3)[chosen]], np.tile(np.eye(3), (3, 1))[chosen]
    sheet = HeldSheet(body.surface, 1.5, 210e3, 0.3, *supports)
    # a force at a support moves nothing but the support
    assert np.abs(sheet.response(sheet.rows(x[at[:1]], np.eye(3)[:1]))).max() < 1e-5
    write_deck(tmp_path / "s.inp", {"S": grid(100, 10, 5)}, sections={}, first=1)
    (body,) = read_bodies([tmp_path / "s.inp"], {None: 1.0})
    x = body.surface.points
    start, end = (x[np.abs(x[:, 0] - place) < 0.1] for place in (0, 100))
    sheet = HeldSheet(body.surface, 1.0, 210e3, 0.0, np.repeat(start, 3, axis=0), np.tile(np.eye(3), (len(start), 1)))
    rows = sheet.rows(end, np.tile([1.0, 0, 0], (len(end), 1)))
    share = np.array([0.25, 0.5, 0.25])
    assert share @ (rows @ sheet.response(rows)) @ share == pytest.approx(100 / (210e3 * 10), rel=0.01)
