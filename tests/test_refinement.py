"""A mesh divided on the curved surface that its normals tell of."""

import numpy as np
import pytest

from mic.geometry.refinement import halved
from mic.geometry.surface import Surface

R = 50.0


def sheet(n, shape, normal, pattern=1):
    """n × n cells of (u, v) in the unit square carried into space, and the exact normals at the corners."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij"))
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a = i * (n + 1) + j
    triangles = np.concatenate(
        [np.column_stack([a, a + n + 1, a + n + 2]), np.column_stack([a, a + n + 2, a + 1])][::pattern]
    )
    return shape(u, v), triangles, normal(u, v)[triangles]


def ball(u, v):
    return R * direction(u, v)


def direction(u, v):
    a, b = 0.9 * u, 0.7 * v - 0.2
    return np.column_stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)])


def off_the_ball(points):
    return abs(np.linalg.norm(points, axis=1) - R).max()


def test_midpoints_lie_on_the_sphere_to_fourth_order():
    errors = [off_the_ball(halved(*sheet(n, ball, direction))[0]) for n in (4, 8)]
    points, triangles, _ = sheet(4, ball, direction)
    chords = off_the_ball(points[triangles[:, :2]].mean(axis=1))
    assert errors[0] < 0.02 * chords
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.2)


def test_normals_at_the_midpoints_are_the_spheres():
    points, triangles, normals = halved(*sheet(4, ball, direction))
    exact = points[triangles] / np.linalg.norm(points[triangles], axis=2, keepdims=True)
    assert abs(normals - exact).max() < 1e-3
    assert np.linalg.norm(normals, axis=2) == pytest.approx(1)


def test_the_mean_of_the_ends_is_turned_where_the_edge_bends_both_ways():
    # an S: z = (x³ − x)/20 slopes by 1/10 at x = ±1, and by −1/20 half-way
    points = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    end, middle = (np.array([-slope, 0, 1]) / np.hypot(slope, 1) for slope in (0.1, -0.05))
    new, triangles, normals = halved(points, np.array([[0, 1, 2]]), np.array([[end, end, middle]]))
    assert new[triangles[0, 1]] == pytest.approx([0, 0, 0], abs=1e-12)
    assert normals[0, 1] == pytest.approx(middle, abs=2e-3)


def test_each_triangle_becomes_four_of_its_own_orientation():
    points, triangles, normals = sheet(5, ball, direction)
    new, children, _ = halved(points, triangles, normals)
    assert np.array_equal(new[: len(points)], points) and len(children) == 4 * len(triangles)
    coarse, fine = Surface(points, triangles), Surface(new, children)
    assert ((fine.normals.reshape(-1, 4, 3) * coarse.normals[:, None]).sum(axis=2) > 0.99).all()
    assert fine.areas.sum() > coarse.areas.sum()
    assert fine.border.sum() == 2 * coarse.border.sum()  # neighbours share their new points


def test_a_flat_sheet_is_divided_at_the_middles_of_its_edges():
    flat = lambda u, v: np.column_stack([7 * u, 5 * v, 2 * u - v])
    up = lambda u, v: np.tile(np.array([-2 / 7, 1 / 5, 1]) / np.linalg.norm([-2 / 7, 1 / 5, 1]), (len(u), 1))
    points, triangles, normals = sheet(3, flat, up)
    new, children, turned = halved(points, triangles, normals)
    assert new[children[::4, 1]] == pytest.approx(points[triangles[:, :2]].mean(axis=1))
    assert turned == pytest.approx(np.tile(normals[:1, :1], (len(children), 3, 1)))


def rim(n):
    """A flat ring inside radius R, and a cylinder that rises from its rim: a curved fold."""
    angle = np.linspace(0, 1.2, n + 1)
    circle = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    points = np.vstack([0.8 * R * circle, R * circle, R * circle + [0, 0, 10.0]])
    i = np.arange(n)
    inner, edge, top = i, n + 1 + i, 2 * n + 2 + i
    ring = np.concatenate([np.column_stack([inner, edge, edge + 1]), np.column_stack([inner, edge + 1, inner + 1])])
    wall = np.concatenate([np.column_stack([edge, edge + 1, top + 1]), np.column_stack([edge, top + 1, top])])
    normals = np.concatenate(
        [np.tile([0, 0, 1.0], (2 * n, 3, 1)), circle[wall % (n + 1)]],
    )
    return points, np.concatenate([ring, wall]), normals, edge


def test_a_fold_stays_one_curve_and_its_sheets_keep_their_normals_apart():
    errors = []
    for n in (4, 8):
        points, triangles, normals, edge = rim(n)
        new, children, turned = halved(points, triangles, normals)
        assert len(new) == len(points) + 4 * n + 3 * n + 2  # no point twice: radial, diagonal, along, upright
        on_rim = [np.linalg.norm(new - (points[a] + points[a + 1]) / 2, axis=1).argmin() for a in edge]
        errors.append(abs(np.linalg.norm(new[on_rim, :2], axis=1) - R).max())
        ring, wall = turned[: 8 * n], turned[8 * n :]
        assert ring == pytest.approx(np.tile([0, 0, 1.0], (8 * n, 3, 1))) and abs(wall[..., 2]).max() < 1e-9
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.2)


def test_the_neighbours_of_a_junction_share_its_midpoints():
    points = np.array([[0, 0, 0], [0, 10, 0], [8, 5, 0], [-8, 5, 1], [0, 5, 8.0]])
    triangles = np.array([[0, 1, 2], [1, 0, 3], [1, 0, 4]])
    normals = np.repeat(Surface(points, triangles).normals[:, None], 3, axis=1)
    new, children, _ = halved(points, triangles, normals)
    assert len(new) == 5 + 7
    assert new[children[0, 1]] == pytest.approx([0, 5, 0], abs=1e-9)
    assert children[0, 1] in children[4] and children[0, 1] in children[8]
