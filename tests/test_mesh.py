"""Mesh repair: one defect at a time on a 3 × 2 grid of squares, whose repaired form is known."""

import numpy as np
import pytest

from mic.geometry.repair import repair
from mic.geometry.surface import Surface


def grid(nx=3, ny=2):
    """Points (12, 3), quadrilaterals (6, 4) of unit squares, all with normal +z."""
    points = np.array([[i, j, 0.0] for i in range(nx + 1) for j in range(ny + 1)])
    corner = np.array([i * (ny + 1) + j for i in range(nx) for j in range(ny)])
    return points, np.column_stack([corner, corner + ny + 1, corner + ny + 2, corner + 1])


def triangles_of(quadrilaterals):
    return np.concatenate([quadrilaterals[:, [0, 1, 2]], quadrilaterals[:, [0, 2, 3]]])


def consistent(triangles):
    """Whether no directed edge occurs twice."""
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return len(np.unique(directed, axis=0)) == len(directed)


def test_a_sound_mesh_is_not_changed():
    points, quadrilaterals = grid()
    triangles = triangles_of(quadrilaterals)
    new_points, new_triangles, report = repair(points, triangles)
    assert np.array_equal(new_points, points) and np.array_equal(new_triangles, triangles)
    assert report.pieces == 1 and str(report) == "nothing to repair"
    assert np.array_equal(report.point_map, np.arange(12))


def test_rectangles_split_alike_however_they_are_turned():
    points, quadrilaterals = grid()
    _, triangles, _ = repair(points, np.zeros((0, 3), int), quadrilaterals)
    for seed in range(20):
        turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
        np.testing.assert_array_equal(repair(points @ turn, np.zeros((0, 3), int), quadrilaterals)[1], triangles)


def valences(points, triangles):
    """How many triangles meet at each point."""
    return np.bincount(triangles.ravel(), minlength=len(points))


@pytest.mark.parametrize("skew", [0.0, 0.1])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_diagonals_of_about_the_same_length_meet_at_every_other_point(skew, order):
    points, quadrilaterals = grid(8, 6)
    points = points + skew * points[:, [1, 2, 2]]
    shuffled = np.random.default_rng(order).permutation(quadrilaterals)
    shuffled = np.array([np.roll(one, i) for i, one in enumerate(shuffled)])  # any first corner
    _, triangles, _ = repair(points, np.zeros((0, 3), int), shuffled)
    inside = (points[:, 0] > 0.9) & (points[:, 0] < 7.5) & (points[:, 1] > 0) & (points[:, 1] < 6)
    assert set(valences(points, triangles)[inside]) == {4, 8}


def test_the_diagonals_that_meet_are_the_shorter_ones_of_the_two_choices():
    points, quadrilaterals = grid(6, 6)
    points[:, 0] += 0.15 * np.sin(np.pi * points[:, 0]) + 0.1 * (points.sum(axis=1) % 2 == 0) * points[:, 1] / 6
    length = {}
    for first in (0, 1):  # number the points from another corner: another colour comes first
        order = np.arange(len(points)) if first == 0 else np.roll(np.arange(len(points)), 2)
        number = np.argsort(order)
        new, triangles, _ = repair(points[order], np.zeros((0, 3), int), number[quadrilaterals])
        length[first] = Surface(new, triangles).edge_lengths.sum()
    assert length[0] == pytest.approx(length[1], rel=1e-12)


def test_a_diagonal_that_is_longer_by_far_is_never_taken():
    points, quadrilaterals = grid(6, 6)
    points = points + 0.4 * points[:, [1, 2, 2]]
    _, triangles, _ = repair(points, np.zeros((0, 3), int), quadrilaterals)
    assert Surface(points, triangles).edge_lengths.max() < 1.2  # √(0.6² + 1), not √(1.4² + 1)


def test_a_triangle_among_quadrilaterals_disturbs_the_pattern_only_along_a_seam():
    points, quadrilaterals = grid(20, 20)
    middle = int(np.argmin(np.linalg.norm(points[quadrilaterals].mean(axis=1) - [10.5, 10.5, 0], axis=1)))
    a, b, c, d = quadrilaterals[middle]
    points = np.vstack([points, points[[a, b, c, d]].mean(axis=0)])
    centre = len(points) - 1
    rest = np.delete(quadrilaterals, middle, axis=0)
    _, triangles, report = repair(points, [[a, b, centre], [a, centre, d]], np.vstack([rest, [b, c, d, centre]]))
    assert report.quadrilaterals_split == 400 and Surface(points, triangles).areas.sum() == pytest.approx(400)
    odd = ~np.isin(valences(points, triangles), (4, 8))
    inside = (points[:, :2] > 0).all(axis=1) & (points[:, :2] < 20).all(axis=1)
    assert (odd & inside).sum() < 60  # of 362


def test_quadrilaterals_split_along_the_shorter_diagonal():
    points = np.array([[0, 0, 0], [3, 0, 0], [4, 1, 0], [1, 1, 0.0]])  # diagonals √17 and √5
    _, triangles, report = repair(points, np.zeros((0, 3), int), [[0, 1, 2, 3]])
    assert str(report) == "1 quadrilaterals split"
    assert all({1, 3} <= set(triangle) for triangle in triangles.tolist())
    assert Surface(points, triangles).normals[:, 2] == pytest.approx(1)


def test_coincident_points_are_merged():
    points, quadrilaterals = grid()
    triangles = triangles_of(quadrilaterals)
    torn = points[triangles.ravel()] + 1e-9  # every triangle has points of its own
    new_points, new_triangles, report = repair(torn, np.arange(36).reshape(12, 3))
    assert len(new_points) == 12 and report.points_merged == 24 and report.pieces == 1
    assert np.allclose(new_points[report.point_map], torn, atol=1e-8)
    assert Surface(new_points, new_triangles).areas.sum() == pytest.approx(6)


def test_triangles_without_area_and_repeated_ones_are_dropped():
    points, quadrilaterals = grid()
    triangles = triangles_of(quadrilaterals)
    dirty = np.concatenate([triangles, [[0, 0, 1], [0, 1, 2]], triangles[:1, [1, 2, 0]]])
    _, new, report = repair(points, dirty)
    assert (report.triangles_without_area, report.triangles_repeated) == (2, 1)
    assert np.array_equal(new, triangles)


def test_points_that_nothing_uses_are_dropped():
    points, quadrilaterals = grid()
    new_points, new, report = repair(np.concatenate([[[9, 9, 9]], points]), triangles_of(quadrilaterals) + 1)
    assert report.points_dropped == 1 and np.array_equal(new_points, points)
    assert report.point_map[0] == -1 and np.array_equal(report.point_map[1:], np.arange(12))


def test_orientation_is_made_consistent_and_the_majority_keeps_its_side():
    points, quadrilaterals = grid()
    triangles = triangles_of(quadrilaterals)
    dirty = triangles.copy()
    dirty[[1, 4, 7]] = dirty[[1, 4, 7]][:, ::-1]
    assert not consistent(dirty)
    _, new, report = repair(points, dirty)
    assert report.triangles_turned == 3 and consistent(new)
    assert Surface(points, new).normals[:, 2] == pytest.approx(1)


def test_a_point_on_an_edge_splits_the_triangle_across():
    """Two triangles on the left of x = 1, three on the right, hanging points at y = 0.25 and 0.5."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [1, 0.25, 0], [1, 0.5, 0.0]])
    triangles = [[0, 1, 2], [0, 2, 3], [1, 4, 6], [6, 4, 7], [7, 4, 5], [7, 5, 2]]
    new_points, new, report = repair(points, triangles)
    assert report.triangles_split == 1 and report.pieces == 1 and len(new) == 8
    surface = Surface(new_points, new)
    assert surface.areas.sum() == pytest.approx(2) and surface.normals[:, 2] == pytest.approx(1)


def test_a_flat_cap_between_two_triangles_heals():
    """The triangle (0, 1, 2) has no area, point 2 lies on the edge 0-1: dropped, and the neighbour is split there."""
    points = np.array([[0, 0, 0], [2, 0, 0], [1, 0, 0], [1, -1, 0], [0, 1, 0], [2, 1, 0.0]])
    triangles = [[0, 1, 2], [0, 3, 1], [0, 2, 4], [2, 5, 4], [2, 1, 5]]
    new_points, new, report = repair(points, triangles)
    assert (report.triangles_without_area, report.triangles_split, report.pieces) == (1, 1, 1)
    assert Surface(new_points, new).areas.sum() == pytest.approx(3)


def test_a_junction_of_three_sheets_is_kept_and_reported():
    points, quadrilaterals = grid()
    web = np.array([[1, j, 1.0] for j in range(3)])
    on_plate = [3, 4, 5]
    web_quadrilaterals = [[on_plate[j], on_plate[j + 1], 12 + j + 1, 12 + j] for j in range(2)]
    new_points, new, report = repair(np.concatenate([points, web]), triangles_of(quadrilaterals), web_quadrilaterals)
    assert report.junction_edges == 2 and report.pieces == 1 and report.triangles_turned == 0
    assert Surface(new_points, new).areas.sum() == pytest.approx(8)


def test_pieces_are_counted():
    points, quadrilaterals = grid()
    _, _, report = repair(points, triangles_of(quadrilaterals[[0, 5]]))
    assert report.pieces == 2 and "2 separate pieces" in str(report)


def test_a_one_sided_strip_is_refused():
    n = 12
    angle = 2 * np.pi * np.arange(n) / n
    across = np.column_stack([np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)])
    middle = 3 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    points = np.concatenate([middle - across, middle + across])
    ring = [[i, i + 1, n + i + 1, n + i] for i in range(n - 1)] + [[n - 1, n, 0, 2 * n - 1]]
    with pytest.raises(ValueError, match="one side only"):
        repair(points, np.zeros((0, 3), int), ring)


@pytest.mark.parametrize(
    ("points", "triangles", "message"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], "point 2 .* not finite"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], "outside 0..2"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "has an area"),
    ],
)
def test_invalid_meshes_are_refused(points, triangles, message):
    with pytest.raises(ValueError, match=message):
        repair(points, triangles)
