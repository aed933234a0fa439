"""Contact pairs on surfaces whose pairs are known."""

import numpy as np
import pytest

from mic.geometry.pairing import Side, find_pairs
from mic.geometry.surface import Surface
from mic.scene import Zone


def plane(z, size=20.0, n=8, flip=False, tilt=0.0, x0=0.0):
    x, y = np.meshgrid(np.linspace(0, size, n + 1), np.linspace(0, size, n + 1), indexing="ij")
    i = np.arange(x.size).reshape(x.shape)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    triangles = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    points = np.column_stack([x.ravel() + x0, y.ravel(), z + np.tan(tilt) * x.ravel()])
    return Surface(points, triangles[:, ::-1] if flip else triangles)


def zone(**keys):
    return Zone(name="Z", parts=("a", "b"), **({"pairs": 9} | keys))


@pytest.mark.parametrize("flip_a", [False, True])
@pytest.mark.parametrize("flip_b", [False, True])
def test_gap_normal_and_sides_do_not_depend_on_orientation(flip_a, flip_b):
    pairs = find_pairs(zone(), Side(plane(0, flip=flip_a), 1.0), Side(plane(1.5, n=7, flip=flip_b), 0.8))
    assert len(pairs) == 9
    for pair in pairs:
        np.testing.assert_allclose(pair.frame[:, 0], [0, 0, 1], atol=1e-12)  # from the first body to the second
        np.testing.assert_allclose(pair.frame.T @ pair.frame, np.eye(3), atol=1e-12)
        assert np.linalg.det(pair.frame) == pytest.approx(1)
        assert pair.gap == pytest.approx(1.5 - 0.9)
        assert pair.sides == (-1 if flip_a else 1, 1 if flip_b else -1)
    assert sum(pair.area for pair in pairs) == pytest.approx(400)
    areas = [pair.area for pair in pairs]
    assert max(areas) < 1.6 * min(areas)


def test_first_body_above_turns_the_normal():
    pairs = find_pairs(zone(), Side(plane(1.5), 1.0), Side(plane(0), 1.0))
    assert all(pair.frame[2, 0] == pytest.approx(-1) for pair in pairs)
    assert all(pair.gap == pytest.approx(0.5) for pair in pairs)


def test_both_patches_of_a_pair_cover_the_same_points():
    first, second = plane(0), plane(1.0, n=5, x0=6.0)  # overhang on both sides
    pairs = find_pairs(zone(pairs=6), Side(first, 1.0), Side(second, 1.0))
    for pair in pairs:
        centre = [
            surface.at(patch.triangle, patch.barycentric).T @ patch.weight
            for surface, patch in zip((first, second), pair.patches)
        ]
        np.testing.assert_allclose(centre[1] - centre[0], [0, 0, 1.0], atol=1e-9)
    assert sum(pair.area for pair in pairs) == pytest.approx(14 * 20, rel=0.06)


def test_filters_of_distance_angle_and_region():
    low, high = Side(plane(0), 1.0), Side(plane(1.2, tilt=np.radians(20)), 1.0)
    near = find_pairs(zone(max_gap=2.0), low, high)
    assert max(pair.point[0] for pair in near) < 2.8 / np.tan(np.radians(20)) + 1
    with pytest.raises(ValueError, match="no contact pair"):
        find_pairs(zone(max_angle_deg=10), low, high)
    boxed = find_pairs(zone(box=((0, 0, -1), (5, 20, 1))), low, high)
    assert max(pair.point[0] for pair in boxed) < 5
    tube = find_pairs(zone(path=[(2, 0, 0), (2, 20, 0)], within=2.0), low, high)
    assert max(abs(pair.point[0] - 2) for pair in tube) < 2


def test_rigid_pad_and_sheet():
    pad = Surface([[0, 0, -0.6], [20, 0, -0.6], [20, 20, -0.6], [0, 20, -0.6]], [[0, 1, 2], [0, 2, 3]])
    for order in (1, -1):
        bodies = [Side(pad, 0.0), Side(plane(0), 1.0)][::order]
        for pair in find_pairs(zone(), *bodies):
            assert pair.gap == pytest.approx(0.1)
            assert pair.frame[2, 0] == pytest.approx(order)


def test_a_patch_radius_bounds_what_a_pair_reads_and_leaves_its_area_alone():
    first, second = plane(0), plane(1.0, n=7)
    pairs = find_pairs(
        zone(pairs=None, points=[(5, 5, 0), (15, 12, 0)], patch=3.0), Side(first, 1.0), Side(second, 1.0)
    )
    assert sum(pair.area for pair in pairs) == pytest.approx(400)
    for pair in pairs:
        for surface, patch in zip((first, second), pair.patches):
            r = np.linalg.norm(surface.at(patch.triangle, patch.barycentric)[:, :2] - pair.point[:2], axis=1)
            assert r.max() < 3.2 and patch.weight @ r**2 == pytest.approx(4.5, rel=0.1)  # a disc's mean r²


def test_spacing_points_and_nodal_patches():
    bodies = Side(plane(0), 1.0), Side(plane(1), 1.0)
    assert len(find_pairs(zone(pairs=None, spacing=5.0), *bodies)) == 16
    wanted = [(5, 5, 0), (15, 5, 0), (10, 15, 0)]
    pairs = find_pairs(zone(pairs=None, points=wanted), *bodies)
    nodal = find_pairs(zone(pairs=None, points=wanted, patch=0.0), *bodies)
    assert [len(pair.patches[0].weight) for pair in nodal] == [1, 1, 1]
    assert len(pairs) == 3 and sum(pair.area for pair in pairs) == pytest.approx(400)
    with pytest.raises(ValueError, match=r"points\[1\]"):
        find_pairs(zone(pairs=None, points=[(5, 5, 0), (55, 5, 0)]), *bodies)
