"""Projection and patches against brute force and closed forms."""

import numpy as np
import pytest
from support import panels

from mic.geometry.blocks import Blocks
from mic.geometry.structured import extrude
from mic.geometry.surface import Surface


def plane(n=10, z=0.0):
    return panels.plane(z, 10.0, n)


@pytest.mark.slow
def test_projection_finds_the_closest_of_all_triangles():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(40, 3))
    surface = Surface(points, rng.permuted(np.tile(np.arange(40), (60, 1)), axis=1)[:, :3])
    x = rng.normal(size=(30, 3)) * 1.5
    found = surface.project(x)
    grid = np.array([[i, j, 60 - i - j] for i in range(61) for j in range(61 - i)]) / 60
    sampled = np.einsum("gi,kij->kgj", grid, surface.corners).reshape(-1, 3)
    brute = np.linalg.norm(x[:, None] - sampled, axis=2).min(1)
    assert (found.distance <= brute + 1e-12).all()
    assert (found.distance >= brute - 0.08).all()  # the sampling's own coarseness
    np.testing.assert_allclose(surface.at(found.triangle, found.barycentric), found.point, atol=1e-12)


def test_the_projection_skips_triangles_that_face_elsewhere():
    wall = Surface(
        [[0, 0, 0], [0, 10, 0], [0, 0, 10], [0, 10, 10], [5, 0, 5], [5, 10, 5], [15, 0, 5], [15, 10, 5]],
        [[0, 1, 2], [1, 3, 2], [4, 6, 5], [5, 6, 7]],
    )
    x = [[1.0, 2.0, 4.0]]
    assert wall.project(x).distance[0] == pytest.approx(1.0)
    filtered = wall.project(x, [[0, 0, 1.0]])
    assert filtered.triangle[0] in (2, 3) and filtered.distance[0] == pytest.approx(np.hypot(4, 1))
    assert wall.project(x, [[0, 1.0, 0]], max_angle=0.1).triangle[0] == -1


def test_points_of_needles_are_their_own_closest_points():
    rng = np.random.default_rng(0)
    for width in 10.0 ** rng.uniform(-6, -2, size=50):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        needle = np.array([[0, 0, 0], [1, 0, 0], [rng.uniform(), width, 0]]) @ turn
        x = rng.dirichlet(np.ones(3)) @ needle
        np.testing.assert_allclose(Surface(needle, [[0, 1, 2]]).project([x]).point[0], x, rtol=0, atol=1e-13)


def test_ties_between_closest_triangles_are_decided_by_shape():
    roof = [[0, 0, 0], [0, 10, 0], [10, 0, 3], [10, 10, 3], [20, 0, 2], [20, 10, 2]]  # ridge at x = 10
    triangles = np.array([[0, 2, 1], [2, 3, 1], [2, 4, 3], [4, 5, 3]])
    x, normal = [[10.0, 4.0, 5.0]], [[0.1, 0.0, 1.0]]
    for order in ([0, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1]):
        surface = Surface(roof, triangles[order])
        found = surface.project(x, normal)
        np.testing.assert_allclose(found.point, [[10, 4, 3]], atol=1e-12)
        assert order[found.triangle[0]] == 2  # the side that leans as the given normal does
        assert not found.at_border[0]
        assert surface.project([[-1.0, 4.0, 0.0]]).at_border[0] and surface.project([[10.0, -1.0, 4.0]]).at_border[0]


def test_a_patch_on_a_fold_covers_both_sides():
    angle = Surface(
        [[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [10, 0, 10], [10, 10, 10]],
        [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]],
    )
    for turned in (angle, Surface(angle.points, angle.triangles[::-1])):
        patch = turned.patch([10.0, 5.0, 0.0], 2.0)
        on_floor = turned.at(patch.triangle, patch.barycentric)[:, 2] < 1e-9
        assert patch.weight[on_floor].sum() == pytest.approx(0.5, abs=0.02)


def test_rounding_on_the_rim_of_a_patch_has_no_effect():
    surface, found = plane(10), []
    for seed in range(10):
        turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
        turned = Surface(surface.points @ turn, surface.triangles)
        # Edges are divided by 15, so that corners and midpoints lie on the circle: 25² + 25² = 35² + 5² = 1250.
        patch = turned.patch(np.array([5.0, 5.0, 0.0]) @ turn, np.sqrt(1250) / 45)
        x = turned.at(patch.triangle, patch.barycentric) @ turn.T
        found.append(np.r_[patch.weight @ x, patch.weight @ x**2, patch.weight @ x**4])
    np.testing.assert_allclose(found, np.broadcast_to(found[0], (10, 9)), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("n", [3, 20])
def test_a_patch_averages_over_a_disc_on_any_mesh(n):
    radius, random = 2.0, np.random.default_rng(0)
    for _ in range(10):
        flat = plane(n)
        inner = ((flat.points[:, :2] > 0) & (flat.points[:, :2] < 10)).all(1)
        move = random.uniform(-0.25, 0.25, (len(inner), 2)) * inner[:, None] * 10 / n
        surface = Surface(flat.points + np.column_stack([move, 0 * inner]), flat.triangles)
        centre = np.r_[random.uniform(4, 6, 2), 0.3]
        patch = surface.patch(centre, radius)
        x = surface.at(patch.triangle, patch.barycentric) - [*centre[:2], 0]
        assert patch.weight.sum() == pytest.approx(1, abs=1e-14)
        np.testing.assert_allclose(patch.weight @ x, 0, atol=1e-3 * radius)
        assert patch.weight @ (x**2).sum(1) == pytest.approx(radius**2 / 2, rel=0.005)  # mean r² over a disc
    assert len(surface.patch(centre, 0.0).weight) == 1


def test_small_triangles_of_a_disc_are_sampled_at_several_points():
    surface, centre = plane(60), [5.03, 4.96, 0.0]  # an edge of 0.24 mm, an eighth of the radius being 0.25
    patch = surface.patch(centre, 2.0)
    x = surface.at(patch.triangle, patch.barycentric) - centre
    assert np.median(np.unique(patch.triangle, return_counts=True)[1]) == 3
    assert patch.weight @ (x**2).sum(1) == pytest.approx(2.0, rel=5e-4)  # mean r²; of a point each 2.1e-3 less


def test_a_patch_stays_on_its_own_sheet():
    near, far = plane(10), plane(10, z=0.5)
    both = Surface(np.vstack([near.points, far.points]), np.vstack([near.triangles, far.triangles + len(near.points)]))
    patch = both.patch([5.0, 5.0, 0.1], 2.0)
    assert np.abs(both.at(patch.triangle, patch.barycentric)[:, 2]).max() == 0


def test_a_patch_with_a_normal_stays_on_one_side_of_a_fold():
    wall = plane(10)
    wall = Surface(wall.points[:, [2, 1, 0]], wall.triangles)  # upright at the plane's edge x = 0, from z = 0 upwards
    floor = plane(10)
    both = Surface(np.vstack([floor.points, wall.points]), np.vstack([floor.triangles, wall.triangles + 121]))
    vertex = np.unique(np.round(both.points, 9), axis=0, return_inverse=True)[1].ravel()
    folded = Surface(np.unique(np.round(both.points, 9), axis=0), vertex[both.triangles])
    for normal, flat in (([0, 0, 1.0], 2), ([1.0, 0, 0], 0)):
        patch = folded.patch([0.5, 5.0, 0.5], 2.0, normal)
        at = folded.at(patch.triangle, patch.barycentric)
        assert np.abs(at[:, flat]).max() == 0 and np.ptp(at[:, 2 - flat]) > 2


@pytest.mark.parametrize(
    "points, triangles, word",
    [
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "no area"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], "not finite"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], "outside"),
        ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "shape"),
    ],
)
def test_unusable_surfaces_are_refused(points, triangles, word):
    with pytest.raises(ValueError, match=word):
        Surface(points, triangles)


def test_limiting_the_reach_keeps_projections_within_it():
    """Points beside a wall ask for what faces up: dozens of triangles of the wall are nearer than any that does."""
    points, triangles, _ = extrude([(0, 0), (40, 0), (40, 60)], 0.0, 60.0, 2.0)
    surface = Surface(points, triangles)
    x = np.array([[30.0, 39.0, z] for z in np.arange(1.0, 40.0, 2.0)])
    up = np.tile([0.0, 0.0, 1.0], (len(x), 1))
    everywhere, near = surface.project(x, up), surface.project(x, up, reach=20.0)
    within = everywhere.distance <= 20
    assert 5 < within.sum() < len(x)
    assert (near.triangle[within] == everywhere.triangle[within]).all()
    assert near.distance[within] == pytest.approx(everywhere.distance[within])


@pytest.mark.parametrize("bend", [0.0, 0.1])
def test_a_box_behind_a_plane_is_found_wherever_a_triangle_is(bend):
    """Half an element above a sheet all planes have it behind them; below it, those of a flat sheet have nothing."""
    flat = plane(24)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    bent = np.column_stack([flat.points[:, :2], bend * flat.points[:, 0] ** 2])
    surface = Surface(bent @ turn.T, flat.triangles)
    middle, normals, reach = surface.corners.mean(1), surface.normals, np.full(len(surface.triangles), 2.0)
    blocks, lift = Blocks(surface.corners, surface.areas), 0.5 * np.sqrt(surface.areas.mean())
    for side in (1.0, -1.0):
        planes = middle + side * lift * normals
        ahead = np.einsum("pkcj,pj->pkc", surface.corners - planes[:, None, None], normals)
        near = np.linalg.norm(middle - planes[:, None], axis=2) <= reach[:, None]
        exact = (near & (ahead.min(2) < 0)).any(1)
        found = blocks.behind(planes, normals, reach)
        assert not (exact & ~found).any()
        assert exact.all() if side > 0 else bend or not found.any()
