"""Normals at the corners of triangles: given, or estimated on sheets with known normals."""

import numpy as np
import pytest
from support import pressings
from support.panels import grid, panel

from mic.geometry.normals import COARSE, GUARD, Rule, corner_normals
from mic.geometry.repair import repair
from mic.geometry.structured import extrude
from mic.geometry.surface import Surface


def angles(a, b):
    """Degrees between unit vectors along the last axis."""
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def own(surface):
    return np.repeat(surface.normals[:, None], 3, axis=1)


def profile_sheet(profile, size=100.0, length=60.0, cell=6.0):
    """A profile (m, 2) swept along x by cells of about `cell`; its pieces are divided where longer than `size`."""
    points, triangles, _ = extrude(profile, 0.0, length, min(size, cell))
    return Surface(points, triangles)


def bend(rows, angle=90.0, radius=6.0, flat=24.0):
    """Profile of two flats and an arc of so many rows between them, and the (m, 2) exact normals at its corners."""
    at = np.radians(angle) * np.arange(rows + 1) / rows
    arc = np.column_stack([flat + radius * np.sin(at), radius * (1 - np.cos(at))])
    end = np.array([np.cos(at[-1]), np.sin(at[-1])])
    steps = np.arange(1, 5)[:, None] * flat / 4
    profile = np.concatenate([[[0, 0]], steps[:-1] * [1, 0], arc, arc[-1] + steps * end])
    normal = np.column_stack([-np.sin(at), np.cos(at)])
    first, last = np.tile(normal[0], (4, 1)), np.tile(normal[-1], (4, 1))
    return profile, np.concatenate([first, normal, last])


def swept(profile, normals, jitter=0.0, cells=10, length=60.0, seed=0):
    """The profile's own corners swept along x, the diagonals in alternation, inner points moved along x; with the exact
    normals (k, 3, 3)."""
    m, random = len(profile), np.random.default_rng(seed)
    move = jitter * random.uniform(-1, 1, (cells + 1, m))
    move[[0, -1]] = 0.0
    sheet = grid(
        cells,
        m - 1,
        lambda X, Y: np.column_stack([length * X, profile[np.rint(Y * (m - 1)).astype(int)]]),
        pattern="cross",
    )
    points = sheet.points + np.column_stack([length / cells * move.ravel(), np.zeros((len(sheet.points), 2))])
    triangles = sheet.triangles
    exact = np.column_stack([np.zeros(m), normals])[triangles % m]
    return Surface(points, triangles), exact


@pytest.mark.parametrize("shape", ["paraboloid", "cylinder", "ball"])
def test_normals_of_a_smooth_sheet_are_exact_up_to_the_border(shape):
    height = {
        "paraboloid": lambda x, y: x * x / 90 - y * y / 70 + x * y / 100,
        "cylinder": lambda x, y: np.sqrt(80.0**2 - (0.6 * x + 0.8 * y) ** 2),
        "ball": lambda x, y: np.sqrt(60.0**2 - x * x - y * y),
    }[shape]
    place = lambda x, y: np.column_stack([x, y, height(x, y)])
    surface = grid(12, 10, lambda X, Y: place(60 * X - 30, 50 * Y - 25), jitter=0.25, pattern="cross")
    x, y, h = *surface.points[:, :2].T, 1e-5
    exact = np.column_stack(
        [
            -(height(x + h, y) - height(x - h, y)) / 2 / h,
            -(height(x, y + h) - height(x, y - h)) / 2 / h,
            np.ones(len(x)),
        ]
    )
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    found = surface.curvature
    assert (found.rule == Rule.ESTIMATED).all()
    error, flat = angles(found.normal, exact[surface.triangles]), angles(own(surface), exact[surface.triangles])
    assert flat.mean() > 1.5 and error.mean() < 0.05 * flat.mean() and error.max() < 0.25 * flat.mean()


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("rows", [5, 12])
def test_only_the_bend_between_two_flats_is_curved(rows, jitter):
    surface, exact = swept(*bend(rows), jitter=jitter)
    found = surface.curvature
    error = angles(found.normal, exact)
    flats = angles(own(surface), exact).max(axis=1) < 1e-6
    assert error[flats].max() < 1e-6  # the flatter fan has its normals, at the line where the bend begins too
    assert error.max() < 0.25 * 90 / rows and error[~flats].mean() < 0.1 * 90 / rows
    beside = (found.rule == Rule.ESTIMATED).any(axis=1)
    assert beside.any() and not (beside & flats).any()
    assert not len(found.coarse)


def test_a_single_row_between_two_flats_has_their_normals():
    """A bend of one row by 30°: its normals are those of the flats, 15° to either side of the triangles' own."""
    surface, exact = swept(*bend(1, angle=30.0))
    assert angles(surface.corner_normals, exact).max() < 1e-6


@pytest.mark.parametrize("angle", [12.0, 30.0, 89.0])
def test_a_fold_between_flats_stays_a_fold(angle):
    corner = 24 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    surface = profile_sheet([(0, 0), (24, 0), (24 + corner[0], corner[1])])
    assert angles(surface.corner_normals, own(surface)).max() < 1e-6
    assert (surface.curvature.rule == Rule.TRIANGLE).all()


def test_a_fold_between_curved_sheets_stays_a_fold_and_both_are_curved():
    """A dome that ends in an upright curved flange."""

    def place(X, Y):
        web, up = np.minimum(X / 0.6, 1), np.maximum(X - 0.6, 0) * 60
        dome = 8 * np.sin(np.pi * web) * np.sin(np.pi * Y)
        return np.column_stack([60 * web + 4 * np.sin(np.pi * Y), 50 * Y, dome + up])

    surface = grid(20, 12, place, pattern="cross")
    found = surface.curvature
    on_fold = np.isclose(surface.corners[..., 0], 60 + 4 * np.sin(np.pi * surface.corners[..., 1] / 50), atol=1e-6)
    on_fold &= np.isclose(surface.corners[..., 2], 0, atol=1e-6)
    upright = np.abs(surface.normals[:, 2]) < 0.5
    assert np.abs(found.normal[on_fold & upright[:, None]][:, 2]).max() < 0.02
    assert found.normal[on_fold & ~upright[:, None]][:, 2].min() > 0.8
    assert (found.rule[on_fold] == Rule.ESTIMATED).mean() > 0.8


def test_sheets_that_meet_in_a_junction_keep_their_own_normals():
    """A curved sheet, and a web that stands on one of its lines."""
    curved = grid(12, 8, lambda X, Y: np.column_stack([60 * X - 30, 40 * Y, -((60 * X - 30) ** 2) / 100]))
    line = np.flatnonzero(np.abs(curved.points[:, 0]) < 1e-9)
    web = curved.points[line] + [0, 0, 10]
    a, b = line[:-1], line[1:]
    c, d = len(curved.points) + np.arange(1, len(line)), len(curved.points) + np.arange(len(line) - 1)
    triangles = np.concatenate([curved.triangles, np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    together = Surface(np.concatenate([curved.points, web]), triangles)
    k, x = len(curved.triangles), curved.corners[..., 0]
    assert angles(together.corner_normals[k:], own(together)[k:]).max() < 1e-6
    exact = np.stack([x / 50, 0 * x, np.ones_like(x)], axis=2)
    exact /= np.linalg.norm(exact, axis=2, keepdims=True)
    assert angles(together.corner_normals[:k], exact).max() < 1.5 < 2.5 < angles(own(curved), exact).max()


@pytest.mark.parametrize("angle", [60.0, 100.0, 130.0])
def test_a_bend_of_one_row_is_reported_as_coarse_or_left_flat(angle):
    surface, exact = swept(*bend(1, angle=angle))
    refused = angles(own(surface), exact) > GUARD
    assert refused.any() == (angle > 2 * GUARD)
    found = Surface(surface.points, surface.triangles, exact).curvature
    assert ((found.rule == Rule.GUARDED) == refused).all()
    assert angles(found.normal, np.where(refused[..., None], own(surface), exact)).max() < 1e-6
    if not refused.any():
        found = surface.curvature
        assert angles(found.normal, exact).max() < 1e-6
        assert bool(len(found.coarse)) == (angle > 2 * COARSE)


TURN = np.radians(35.0)
PROFILES = {
    "joggle": [(40.0, 0.0), (8 * TURN, TURN), (8 * TURN, -TURN), (40.0, 0.0)],
    "flanged shell": [(18.0, 0.0), (6 * TURN, 2 * TURN), (30.0, 0.35), (10 * TURN, -TURN), (30.0, 0.0)],
}


@pytest.mark.parametrize("radius, jitter", [(None, 0.25), (250.0, 0.0)], ids=["straight", "arched"])
@pytest.mark.parametrize("shape", PROFILES)
def test_bends_of_two_rows_have_accurate_normals(shape, radius, jitter):
    surface, exact = pressings.swept(PROFILES[shape], 10.0, 2, radius=radius, jitter=jitter)
    error, flat = angles(surface.corner_normals, exact), angles(own(surface), exact)
    assert error.max() < 0.2 * flat.max() and error.mean() < 0.1 * flat.mean()


@pytest.mark.parametrize("depth, limit", [(20.0, 1.0), (40.0, 0.5)], ids=["walls of two rows", "walls of four"])
@pytest.mark.parametrize("rows", [2, 4])
def test_a_box_with_radii_has_accurate_normals_in_its_corners(rows, depth, limit):
    surface, exact = pressings.box(10.0, rows, depth=depth)
    assert angles(own(surface), exact).max() > 10
    assert angles(surface.corner_normals, exact).max() < limit


def test_a_row_that_may_be_flat_is_reported():
    """Bends of two rows, and a flat of one row between them."""
    at = np.radians([0, 20, 40])
    arc = np.column_stack([6 * np.sin(at), 6 * (1 - np.cos(at))])
    along = np.array([np.cos(at[-1]), np.sin(at[-1])])
    first = arc[-1] + 14 * along
    second = first + arc @ np.array([[along[0], along[1]], [-along[1], along[0]]])
    profile = np.concatenate([[[-24, 0], [-12, 0]], arc, second])
    surface, _ = swept(profile, np.zeros_like(profile))
    assert len(surface.curvature.single)
    smooth, _ = swept(*bend(8))
    assert not len(smooth.curvature.single)


def test_oppositely_oriented_neighbours_count_as_a_fold():
    surface = panel(6)
    turned = surface.triangles.copy()
    lone = [10, 40]
    turned[lone] = turned[lone, ::-1]
    found = corner_normals(surface.points, turned).normal
    assert ((found * Surface(surface.points, turned).normals[:, None]).sum(axis=2) > 0.9).all()
    assert angles(found[lone], own(Surface(surface.points, turned))[lone]).max() < 1e-6


def test_a_dirty_mesh_has_the_normals_of_the_clean_one():
    surface = panel(8)
    torn = surface.points[surface.triangles.ravel()]
    triangles = np.arange(len(torn)).reshape(-1, 3)
    triangles[::5] = triangles[::5, ::-1]
    dirty = np.concatenate([triangles, triangles[:3]])
    points, triangles, report = repair(torn, dirty)
    again = Surface(points, triangles)
    expected = surface.corner_normals.reshape(-1, 3)[dirty.ravel()[report.corner_map]]
    assert np.abs((again.corner_normals * expected).sum(axis=2)).min() > 1 - 1e-12


def test_normals_follow_a_turned_mirrored_scaled_and_renumbered_surface():
    surface, _ = swept(*bend(6), jitter=0.2)
    random = np.random.default_rng(3)
    q = np.linalg.qr(random.normal(size=(3, 3)))[0]
    number, order = random.permutation(len(surface.points)), random.permutation(len(surface.triangles))
    points = np.empty_like(surface.points)
    points[number] = 0.03 * surface.points @ q.T
    again = Surface(points, number[surface.triangles][order])
    expected = surface.corner_normals[order] @ q.T * np.sign(np.linalg.det(q))
    assert angles(again.corner_normals, expected).max() < 1e-5
    assert (again.curvature.rule == surface.curvature.rule[order]).all()


def test_given_normals_are_used_and_missing_ones_estimated():
    surface = panel(6)
    estimated, given = surface.corner_normals, np.full((len(surface.triangles), 3, 3), np.nan)
    given[4], given[5, 0], given[6, 1] = -2 * own(surface)[4], [0, 0, 0], surface.points[1] - surface.points[0]
    found = Surface(surface.points, surface.triangles, given).curvature
    assert (found.rule[4] == Rule.GIVEN).all() and angles(found.normal[4], own(surface)[4]).max() < 1e-6
    assert found.rule[6, 1] == Rule.GUARDED and angles(found.normal[6, 1], surface.normals[6]).max() < 1e-6
    others = np.ones(found.rule.shape, dtype=bool)
    others[4], others[6, 1] = False, False
    assert angles(found.normal[others], estimated[others]).max() < 1e-9


def test_normals_of_a_wrong_shape_are_refused():
    with pytest.raises(ValueError, match="one at each corner of each triangle"):
        Surface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], [[0, 0, 1.0]])
