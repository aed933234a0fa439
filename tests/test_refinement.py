"""Refined meshes: new vertices lie on the curved surface that the normals describe."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from support.panels import grid

from mic.geometry.refinement import divided, halved
from mic.geometry.surface import Surface

R = 50.0


def sheet(n, shape, normal):
    """n × n cells of (u, v) in the unit square mapped into space, and the exact normals at the corners."""
    surface = grid(n, n, shape)
    return surface.points, surface.triangles, normal(*np.indices((n + 1, n + 1)).reshape(2, -1) / n)[surface.triangles]


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


def jittered(n=6, seed=0):
    """A flat sheet of 100 mm, its inner points moved, and everything that decides by order shuffled."""
    rng = np.random.default_rng(seed)
    points, triangles, _ = sheet(n, lambda u, v: 100 * np.column_stack([u, v, 0 * u]), direction)
    inner = ((points[:, :2] > 1) & (points[:, :2] < 99)).all(axis=1)
    points[inner, :2] += rng.uniform(-3, 3, (inner.sum(), 2))
    return points, triangles, np.broadcast_to([0, 0, 1.0], (len(triangles), 3, 3))


def sizes(points, triangles):
    corner = points[triangles]
    return np.sqrt(np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1))


PLACES, REACHES, WANTED = np.array([[30, 40, 0.0], [85, 95, 0.0]]), np.array([3.0, 2.0]), np.array([1.5, 0.7])


def test_triangles_near_a_place_are_divided_down_to_its_size_and_no_vertex_hangs():
    points, triangles, normals = jittered()
    found = divided(points, triangles, normals, PLACES, REACHES, WANTED)
    new = Surface(found.points, found.triangles, found.normals)
    assert new.areas.sum() == pytest.approx(1e4)
    assert (new.normals[:, 2] > 0.999).all()
    for place, reach, wanted in zip(PLACES, REACHES, WANTED):
        patch = new.patch(place, reach)
        assert sizes(found.points, found.triangles)[patch.triangle].max() <= wanted
    # the border is that of the square, every other edge has two triangles, and what is far stays as it was
    assert new.edge_lengths[new.border].sum() == pytest.approx(400)
    assert (found.points[: len(points)] == points).all()
    far = np.linalg.norm(points[triangles].mean(axis=1)[:, None] - PLACES, axis=2).min(axis=1) > 50
    kept = {tuple(sorted(one)) for one in found.triangles.tolist()}
    assert all(tuple(sorted(one)) in kept for one in triangles[far].tolist()) and far.any()
    assert len(found.triangles) - len(triangles) < 2 * 400


def test_no_triangle_becomes_needle_shaped():
    points, triangles, normals = jittered()
    found = divided(points, triangles, normals, PLACES, REACHES, WANTED / 4)
    shape = lambda surface: (surface.areas / surface.edge_lengths.max(axis=1) ** 2).min()
    assert shape(Surface(found.points, found.triangles)) > 0.4 * shape(Surface(points, triangles))


def test_triangles_that_are_fine_enough_are_not_divided():
    points, triangles, normals = jittered()
    found = divided(points, triangles, normals, PLACES, REACHES, np.array([40.0, 40.0]))
    assert (found.triangles == triangles).all() and len(found.points) == len(points)


def test_points_of_the_mesh_are_carried_to_the_pieces_that_hold_them():
    points, triangles, normals = jittered()
    found = divided(points, triangles, normals, PLACES, REACHES, WANTED)
    old, new = Surface(points, triangles), Surface(found.points, found.triangles)
    rng = np.random.default_rng(1)
    triangle = rng.integers(0, len(triangles), 500)
    barycentric = rng.dirichlet([1, 1, 1], 500)
    barycentric[:9] = np.tile(np.eye(3), (3, 1))
    piece, inside = found.locate(triangle, barycentric)
    assert inside.min() > -1e-12 and inside.sum(axis=1) == pytest.approx(1)
    assert new.at(piece, inside) == pytest.approx(old.at(triangle, barycentric), abs=1e-10)
    assert (found.of[piece] == triangle).all()


def test_the_same_mesh_turned_mirrored_and_renumbered_is_divided_alike():
    points, triangles, normals = sheet(8, lambda u, v: 100 * np.column_stack([u, v, 0 * u]), direction)
    places = np.array([[50, 50, 0.0], [12.5, 25, 0.0]])  # where distances and sizes tie
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    number, order = rng.permutation(len(points)), rng.permutation(len(triangles))
    moved = np.empty_like(points)
    moved[number] = points @ turn.T * 7.0
    again = np.roll(number[triangles[order]], 1, axis=1)
    given = divided(points, triangles, normals, places, np.full(2, 6.25), np.full(2, 3.125))
    found = divided(moved, again, normals[order], places @ turn.T * 7.0, np.full(2, 43.75), np.full(2, 21.875))
    middle = lambda division: division.points[division.triangles].mean(axis=1)
    a, b = middle(given) @ turn.T * 7.0, middle(found)
    assert len(a) == len(b)
    assert cKDTree(a).query(b)[0].max() < 1e-9


def test_normals_between_the_corners_are_those_between_their_ends():
    points, triangles, normals = sheet(4, ball, direction)
    place = points[12][None]
    found = divided(points, triangles, normals, place, np.array([1.0]), np.array([4.0]))
    piece = Surface(points, triangles, normals)
    exact = piece.smooth_normals(np.repeat(found.of, 3), found.corners.reshape(-1, 3)).reshape(-1, 3, 3)
    assert found.normals == pytest.approx(exact, abs=1e-12)
    assert found.points[found.triangles] == pytest.approx(
        np.einsum("kij,kjl->kil", found.corners, points[triangles][found.of]), abs=1e-12
    )


def test_a_divided_sliver_has_no_flat_triangle():
    """Half of a long side beside the whole other one would lie on a line."""
    x, y = np.meshgrid([0.0, 5.0, 10.0, 15.0], [0.0, 5.0, 5.0001, 10.0], indexing="ij")
    a = (4 * np.arange(3)[:, None] + np.arange(3)).ravel()
    triangles = np.concatenate([np.column_stack([a, a + 4, a + 5]), np.column_stack([a, a + 5, a + 1])])
    points = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    normals = np.tile([0.0, 0.0, 1.0], (len(triangles), 3, 1))
    found = divided(points, triangles, normals, np.array([[7.0, 2.0, 0.0]]), np.array([2.0]), np.array([2.5]))
    surface = Surface(found.points, found.triangles)
    shortest, longest = surface.edge_lengths.min(axis=1), surface.edge_lengths.max(axis=1)
    flat = 2 * surface.areas / longest < 0.02 * shortest
    assert len(found.triangles) > len(triangles) and not flat.any()
