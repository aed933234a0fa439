"""Contact pairs on surfaces whose pairs are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.panels import plane

import mic
from mic.geometry.load import load_part
from mic.geometry.pairing import PressedPoint, Side, candidate_spacing, find_between, find_pairs, node_pairs
from mic.geometry.structured import extrude
from mic.geometry.surface import Surface
from mic.scene import Zone


def zone(**keys):
    return Zone(name="Z", parts=("a", "b"), **({"pairs": 9} | keys))


def flats(first, second):
    """Two flat sheets of 20 mm, of so many elements along an edge; they touch at z = 0.5."""
    return Side(plane(0, n=first), 1.0), Side(plane(1, n=second), 1.0)


def read(pair, bodies, which=0):
    """(q, 3) points of the patch of a pair on the first or the second body."""
    patch = pair.patches[which]
    return bodies[which].surface.at(patch.triangle, patch.barycentric)


def normals(pairs):
    """(p,) z components of the normals of pairs."""
    return np.array([pair.frame[2, 0] for pair in pairs])


def total(pairs):
    """Sum of the areas of pairs, mm²."""
    return sum(pair.area for pair in pairs)


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
    assert total(pairs) == pytest.approx(400)
    areas = [pair.area for pair in pairs]
    assert max(areas) < 1.6 * min(areas)


@pytest.mark.parametrize("thickness", [(None, 0.8), (1.0, None)])
@pytest.mark.parametrize("find", [find_pairs, node_pairs])
def test_the_normal_points_to_the_second_body_also_with_a_fixture(find, thickness):
    first, second = Side(plane(0), thickness[0]), Side(plane(1.5, n=7), thickness[1])
    apart = 1.5 - first.half_thickness - second.half_thickness
    for pair in find(zone(), first, second):
        np.testing.assert_allclose(pair.frame[:, 0], [0, 0, 1], atol=1e-12)
        assert pair.gap == pytest.approx(apart) and pair.sides == (1, -1)


def corner(n=8, size=20.0, start=5.0, z=1.0):
    """A plate whose far quarter is bent up on both sides: three walls that meet in one vertex."""
    flat = plane(z, size=size, n=n, x0=start).points
    i = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    floor = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    wall_x = np.column_stack([np.full(len(flat), start), flat[:, 1], z + flat[:, 0] - start])
    wall_y = np.column_stack([flat[:, 0], np.zeros(len(flat)), z + flat[:, 1]])
    return Surface(np.vstack([flat, wall_x, wall_y]), np.vstack([floor, floor + len(flat), floor + 2 * len(flat)]))


BENT = {
    "L": Surface(*extrude([(5, 1), (25, 1), (25, 21)], 0.0, 20.0, 2.3)),
    "hem": Surface(*extrude([(5, 1), (25, 1), (25, 2.2), (5, 2.2)], 0.0, 20.0, 3.3)),
    "T": Surface(*extrude([(12, 21), (12, 1), (25, 1)], 0.0, 20.0, 3.3)),
    "V": Surface(*extrude([(-5, 4), (10, 1), (25, 4)], 0.0, 20.0, 4.3)),
    "corner": corner(),
}


def beside(pairs, bodies, angle, thickness, at_nodes=False):
    """Sideways distances, mm, of pairs whose points lie too far off the normal of the first body."""
    found = []
    for pair in pairs:
        first, second = read(pair, bodies), read(pair, bodies, 1)
        surface, patch = bodies[0].surface, pair.patches[0]
        normal = surface.normals[patch.triangle]
        if at_nodes:
            normal = surface.smooth_normals(patch.triangle, patch.barycentric)
        along = np.einsum("ij,ij->i", second - first, normal)
        sideways = np.linalg.norm(second - first - along[:, None] * normal, axis=1)
        if (sideways > np.tan(np.radians(angle)) * np.abs(along) + 0.05 * thickness + 1e-5).any():
            found.append(sideways.max())
    return found


@pytest.mark.parametrize("shape, angle", [("V", 15.0), *((shape, 30.0) for shape in BENT if shape != "V")])
@pytest.mark.parametrize("find, bent_first", [(find_pairs, False), (find_pairs, True), (node_pairs, True)])
def test_facing_points_lie_along_the_normal(find, shape, bent_first, angle):
    flat, bent = Side(plane(0, size=30.0, n=13), 1.0), Side(BENT[shape], 0.8)
    bodies = (bent, flat) if bent_first else (flat, bent)
    pairs = find(zone(pairs=12, max_gap=5.0, max_angle_deg=angle), *bodies)
    assert not beside(pairs, bodies, angle, 0.8, at_nodes=find is node_pairs)


@pytest.mark.slow
def test_crossing_channels_of_a_body_side_have_no_pairs_beside_each_other(tmp_path):
    """The lip of one channel stands up to 7 mm beside the web of the other and must not face it."""
    scene = mic.load_scene(Path(__file__).resolve().parents[1] / "meshes" / "body_side" / "body_side.toml")
    joint = next(one for one in scene.zones if one.name == "waist-a")
    parts = [next(part for part in scene.parts if part.name == name) for name in joint.parts]
    bodies = [Side(load_part(part, scene.folder, tmp_path).surface, part.thickness) for part in parts]
    thinner = min(part.thickness for part in parts)
    for find in (find_pairs, node_pairs):
        pairs = find(joint, *bodies)
        assert len(pairs) > 30 and not beside(pairs, bodies, joint.max_angle_deg, thinner)


@pytest.mark.slow
def test_candidates_lie_on_the_edges_folds_and_corners_of_both_sheets():
    """A sheet of 20 mm on another that reaches beyond it; and an L, whose foot ends at its fold."""
    below = Side(plane(0, size=30.0, n=13), 1.0)
    above = (Side(plane(1, x0=5.0), 1.0), [(0, 5.0), (0, 25.0), (1, 0.0), (1, 20.0)])
    foot = (Side(BENT["L"], 1.0), [(1, 5.0), (1, 25.0), (0, 0.0), (0, 20.0)])
    for sheet, ends in (above, foot):
        corners = [(x, y) if ends[0][0] == 0 else (y, x) for x in (5, 25) for y in (0, 20)]
        for which, bodies in enumerate(((sheet, below), (below, sheet))):
            found = find_pairs(zone(pairs=None, spacing=5.0), *bodies)
            points = [read(pair, bodies, which) for pair in found]
            for axis, end in ends:
                assert sum(np.abs(x[:, axis] - end).max() < 1e-9 for x in points) >= 2
            for corner in corners:
                assert sum(np.abs(x[:, :2] - corner).max() < 1e-9 for x in points) == 1


def test_a_candidate_lies_where_edges_cross_but_not_along_common_edges():
    """Two strips that cross: neither has a corner there. Moved upon each other, they have no more than their own."""
    first = Side(Surface(*extrude([(-5.0, 0.0), (5.0, 0.0)], -15.0, 30.0, 2.3)[:2]), 1.0)
    turned = first.surface.points @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + [0, 0, 1]
    second = Side(Surface(turned, first.surface.triangles), 1.0)
    upon = Side(Surface(first.surface.points + [0, 0, 1], first.surface.triangles), 1.0)

    def corners(*bodies):
        pairs = find_pairs(zone(pairs=None, spacing=6.0), *bodies)
        points = [read(pair, bodies, which)[:, :2] for pair in pairs for which in (0, 1)]
        return sorted({tuple(x[0].round(9) + 0.0) for x in points if np.ptp(x, axis=0).max() < 1e-9})

    for bodies in ((first, second), (second, first)):
        assert corners(*bodies) == [(-5, -5), (-5, 5), (5, -5), (5, 5)]
    assert corners(first, upon) == [(-15, -5), (-15, 5), (15, -5), (15, 5)]


def pad(centre, radius, corners, turn=0.0):
    """A flat round fixture below a sheet, of triangles around its circle."""
    i = np.arange(corners)
    angle = 2 * np.pi * i / corners + turn
    rim = radius / np.cos(np.pi / corners) * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    fan = np.column_stack([0 * i, 1 + i, 1 + (i + 1) % corners])
    return Side(Surface(np.vstack([np.zeros(3), rim]) + centre, fan), disc=(centre, radius))


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_candidates_lie_on_the_rim_of_a_round_rest(turn):
    """Two of them lie where it crosses the edge of the sheet, 6 mm from its centre."""
    centre = (13.0, 6.0, -0.5)
    bodies = pad(centre, 8.0, 36, turn), Side(plane(0, size=30.0, n=13), 1.0)
    points = [read(pair, bodies, 1) for pair in find_pairs(zone(pairs=None, spacing=4.0), *bodies)]
    away = [np.linalg.norm((x - centre)[:, :2], axis=1) for x in points]
    on = [x for x, r in zip(points, away) if np.abs(r - 8.0).max() < 0.02]
    length = 2 * 8.0 * (np.pi - np.arccos(6.0 / 8.0))
    assert length / 4.0 - 1 < len(on) < length / 4.0 + 2
    assert all((r <= 8.0 + 1e-6).all() for r in away)
    ends = [x[0] for x in on if len(x) == 1]
    assert sorted(x[0] for x in ends) == pytest.approx([13 - np.sqrt(28), 13 + np.sqrt(28)], abs=0.02)
    assert [x[1] for x in ends] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_close_corners_are_merged_and_border_corners_win():
    """A tab 1.5 mm wide; a fold 1.5 mm before the border's end gives way to it."""
    below = Side(plane(-1, size=30.0, n=13), 1.0)
    tab = Surface(*extrude([(10.0, 0.0), (20.0, 0.0), (21.5, 0.4)], 3.0, 1.5, 1.0)[:2])
    bodies = Side(tab, 1.0), below
    at = [read(pair, bodies) for pair in find_pairs(zone(pairs=None, spacing=5.0, max_gap=3.0), *bodies)]
    points = np.array([x[0] for x in at if len(x) == 1])
    assert len(points) == 2 and sorted(points[:, 1]) == pytest.approx([10.0, 21.5])


def test_seven_candidates_lie_under_a_pad_on_any_mesh():
    """One in the middle, six about it: two sheets that one candidate alone presses together tilt on it."""
    bodies = flats(3, 3)
    centre = np.array([9.0, 10.5, 0.5])
    pairs = find_pairs(zone(pairs=None, spacing=8.0), *bodies, pressed=[PressedPoint(centre, 3.5)])
    under = [pair for pair in pairs if np.linalg.norm((pair.point - centre)[:2]) < 3.5]
    away = np.array([np.linalg.norm((pair.point - centre)[:2]) for pair in under])
    assert len(under) == 7 and sum(away < 0.5) == 1 and sum(away > 1.75) == 6
    assert total(under) == pytest.approx(np.pi * 3.5**2, rel=0.05)
    assert total(pairs) == pytest.approx(400)
    assert {round(pair.spacing, 6) for pair in pairs} == {8.0, round(3.5 * 2 / 3, 6)}


def test_a_candidate_lies_where_the_gap_of_its_cell_is_smallest():
    """Over a plate that is tilted, contact begins at the lower end of each cell."""
    bodies = Side(plane(0, n=16), 1.0), Side(plane(1, n=16, tilt=0.02), 1.0)
    for pair in find_pairs(zone(pairs=None, spacing=5.0), *bodies):
        x = read(pair, bodies)[:, 0]
        assert (
            np.ptp(x[pair.patches[0].weight > 0]) <= 0.005 / np.tan(0.02) + 1e-6
            and pair.gap <= np.tan(0.02) * x.min() + 0.005
        )


def hem():
    """A hem over y = 0..20 about a sheet that ends before its bend; the upper leaf reaches back to y = 8."""
    arc = [(20 + np.sin(a), 1 - np.cos(a)) for a in np.linspace(0, np.pi, 5)]
    about = Side(Surface(*extrude([(0, 0), *arc, (8, 2)], 0.0, 14.0, 2.3)), 1.0)
    return about, Side(Surface(*extrude([(-4, 1), (19, 1)], 1.0, 12.0, 2.1)), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "find, keys, within_first",
    [
        (find_pairs, dict(pairs=None, spacing=6.0, patch=2.0), True),
        (find_pairs, dict(pairs=12), False),
        (node_pairs, {}, True),
    ],
)
def test_each_side_of_a_sheet_within_a_hem_has_its_own_pairs(find, keys, within_first):
    bodies = hem()[::-1] if within_first else hem()
    pairs = find(zone(**keys), *bodies)
    up = normals(pairs) * (-1 if within_first else 1)
    np.testing.assert_allclose(np.abs(up), 1.0, atol=1e-9)  # towards the sheet, along it nowhere
    for pair in pairs:
        for which, patch in enumerate(pair.patches):
            assert np.ptp(read(pair, bodies, which)[patch.weight > 0, 2]) < 1e-9 and abs(pair.gap) < 1e-9
    area = np.array([pair.area for pair in pairs])
    assert area[up > 0].sum() == pytest.approx(12 * 19, rel=0.03)  # over the lower leaf, and beneath the upper one
    assert area[up < 0].sum() == pytest.approx(12 * 11, rel=0.03)
    if find is find_pairs:
        between = normals(find_between(zone(**keys), *bodies, pairs)) * (-1 if within_first else 1)
        assert (between > 0).sum() == (up > 0).sum()


@pytest.mark.slow
def test_a_pad_on_a_hem_has_a_candidate_on_either_side_of_the_sheet():
    bodies = hem()
    pads = [PressedPoint(np.array([8.0, 16.0, 1.0]), 3.0), PressedPoint(np.array([7.0, 11.0, 0.0]), 1.5, weld=5)]
    pairs = find_pairs(zone(pairs=None, spacing=5.0), *bodies, pressed=pads)
    for place in pads:
        there = [pair for pair in pairs if np.linalg.norm(pair.point[:2] - place.point[:2]) < 0.5]
        assert sorted(np.sign(normals(there))) == [-1, 1]
    assert {np.sign(pair.frame[2, 0]) for pair in pairs if pair.nugget == 5} == {-1, 1}
    for up in (1, -1):  # a weld joins two sheets: on one side of the sheet within
        joined = replace(pads[1], normal=np.array([0.0, 0.0, up]))
        pairs = find_pairs(zone(pairs=None, spacing=5.0), *bodies, pressed=[joined])
        assert {np.sign(pair.frame[2, 0]) for pair in pairs if pair.nugget == 5} == {up}


def test_given_points_belong_to_the_nearer_side_of_the_sheet():
    for bodies, sign in ((hem(), 1), (hem()[::-1], -1)):
        pairs = find_pairs(zone(pairs=None, points=[(8, 10, 0.2), (8, 15, 1.8), (5, 12, 1.9)]), *bodies)
        np.testing.assert_allclose(sign * normals(pairs), [1, -1, -1], atol=1e-9)


def test_fewer_pairs_than_sides_are_refused():
    with pytest.raises(ValueError, match="1 pairs are too few for 2 facing sides of a sheet"):
        find_pairs(zone(pairs=1), *hem())


def test_a_sheet_within_a_rigid_slot_is_held_on_both_sides():
    slot = Side(Surface(*extrude([(0, 0), (20, 0), (20, 2.4), (0, 2.4)], 0.0, 30.0, 5.0)))
    sheet = Side(Surface(*extrude([(-5, 1.2), (18, 1.2)], 2, 12, 2)), 2.0)
    pairs = find_pairs(zone(pairs=None, spacing=4.0), slot, sheet)
    for way in (-1, 1):
        own = [pair for pair in pairs if pair.frame[2, 0] * way > 0.999]
        assert total(own) == pytest.approx(12 * 18, rel=0.03)
        assert all(pair.gap == pytest.approx(0.2) for pair in own)


def inside(pairs, bodies, centre, radius):
    """The pairs in a circle, which no patch crosses."""
    found = []
    for pair in pairs:
        within = np.linalg.norm((read(pair, bodies) - centre)[:, :2], axis=1) <= radius + 1e-5
        assert within.all() or not within.any()
        if within.all():
            found.append(pair)
    return found


def test_no_candidate_patch_crosses_the_rim_of_a_nugget():
    bodies = flats(16, 15)
    weld = PressedPoint(np.array([9.0, 10.5, 0.5]), 2.5, weld=3)
    pairs = find_pairs(zone(pairs=None, spacing=4.0), *bodies, pressed=[weld])
    own = inside(pairs, bodies, weld.point, 2.5)
    assert own == [pair for pair in pairs if pair.nugget == 3]
    assert total(own) == pytest.approx(np.pi * 2.5**2, rel=0.05)
    assert total(pairs) == pytest.approx(400)


@pytest.mark.slow
def test_no_candidate_patch_crosses_the_rim_of_a_pad():
    """Two concentric pads, and one that only touches the zone and has no rim there."""
    bodies = flats(16, 15)
    centre = np.array([9.0, 10.5, 0.5])
    pads = [PressedPoint(centre, 5.0), PressedPoint(centre, 3.5), PressedPoint(np.array([-4.9, 10.0, 0.5]), 5.0)]
    pairs = find_pairs(zone(pairs=None, spacing=5.0), *bodies, pressed=pads)
    for radius in (5.0, 3.5):
        assert total(inside(pairs, bodies, centre, radius)) == pytest.approx(np.pi * radius**2, rel=0.05)
    assert total(pairs) == pytest.approx(400)
    alone = find_pairs(zone(pairs=None, spacing=5.0), *bodies, pressed=pads[:2])
    assert len(alone) == len(pairs)


@pytest.mark.slow
def test_a_rest_beneath_a_pad_bounds_patches_but_not_the_spacing():
    """A small rest has as many candidates as its share of the pad; the clamp determines the spacing of all others."""
    bodies = flats(16, 15)
    centre = np.array([9.0, 10.5, 0.5])
    clamp, rest = PressedPoint(centre, 5.0), PressedPoint(centre, 3.5, backed_radius=5.0)
    pairs = find_pairs(zone(pairs=None), *bodies, pressed=[clamp, rest])
    assert inside(pairs, bodies, centre, 3.5)
    assert total(inside(pairs, bodies, centre, 5.0)) == pytest.approx(np.pi * 25, rel=0.05)
    assert min(pair.spacing for pair in pairs) == pytest.approx(10 / 3)
    tiny = replace(rest, radius=1.0)
    spacing = [candidate_spacing(zone(pairs=None), *bodies, pressed=[clamp, one]) for one in (rest, tiny)]
    assert spacing == [candidate_spacing(zone(pairs=None), *bodies, pressed=[clamp])] * 2
    one = find_pairs(zone(pairs=None), *bodies, pressed=[clamp, tiny])
    assert len(one) == len(find_pairs(zone(pairs=None), *bodies, pressed=[clamp]))


@pytest.mark.slow
def test_a_spacing_factor_applies_under_pads_and_elsewhere():
    """Half the distance, four times as many in either place."""
    bodies = flats(16, 15)
    clamp = PressedPoint(np.array([9.0, 10.5, 0.5]), 5.0)
    apart, under = [], []
    for factor in (1.0, 0.5):
        own_zone = zone(pairs=None, spacing_factor=factor)
        pairs = find_pairs(own_zone, *bodies, pressed=[clamp])
        own = [np.linalg.norm((pair.point - clamp.point)[:2]) < 4.9 for pair in pairs]
        apart.append(candidate_spacing(own_zone, *bodies, pressed=[clamp]))
        under.append((sum(own), min(pair.spacing for pair in pairs)))
    assert apart[1] == pytest.approx(apart[0] / 2)
    assert under[0] == (7, pytest.approx(10 / 3)) and under[1] == (28, pytest.approx(5 / 3))


def test_an_invalid_spacing_factor_is_refused():
    bodies = flats(16, 15)
    with pytest.raises(ValueError, match=r"spacing = \S+ mm times spacing_factor = 0\.05 .*finer than the elements"):
        candidate_spacing(zone(pairs=None, spacing_factor=0.05), *bodies)
    with pytest.raises(ValueError, match="spacing_factor applies to candidates"):
        zone(pairs=9, spacing_factor=0.5)


def bend(turn, size, z=0.0):
    """A sheet in the plane z, 10 mm long, that goes on in an arc of 8 mm by facets of `turn`, 20 mm wide."""
    profile = [(0.0, z), (10.0, z)]
    for angle in np.arange(turn / 2, np.pi / 2, turn):
        x, y = profile[-1]
        profile.append((x + 16 * np.sin(turn / 2) * np.cos(angle), y + 16 * np.sin(turn / 2) * np.sin(angle)))
    return Surface(*extrude(profile, 0.0, 20.0, size)[:2])


@pytest.mark.slow
def test_normals_along_a_bend_follow_the_arc_and_not_the_facets():
    """A bend of four facets of 22.5°, one row each, upon itself.

    Where it begins, its estimate shares the turn between flat and arc.
    """
    turn = np.pi / 8
    below = bend(turn, 3.5)
    above = Surface(below.points + below.vertex_normals, below.triangles)
    for bodies in ((Side(below, 1.0), Side(above, 1.0)), (Side(above, 1.0), Side(below, 1.0))):
        seen = []
        for pair in find_pairs(zone(pairs=None, spacing=3.0), *bodies):
            y, z = pair.point[1:]
            direction = pair.frame[1:, 0] * np.sign(pair.frame[2, 0] - pair.frame[1, 0])
            exact, found = np.arctan2(y - 10.0, 8.0 - z), np.arctan2(-direction[0], direction[1])
            if turn < exact < 3 * turn:  # the two facets in the middle
                seen.append(np.degrees(abs(found - exact)))
        assert len(seen) > 10 and max(seen) < 2.0


def test_node_pairs_use_every_node_of_both_sheets():
    bodies = Side(plane(0, n=8), 1.0), Side(plane(1, n=7, x0=3.0), 1.0)
    pairs = node_pairs(zone(), *bodies)
    points = np.vstack([body.surface.points[:, :2] for body in bodies])
    points = points[(points[:, 0] >= 3) & (points[:, 0] <= 20)]
    found = np.array([pair.point[:2] for pair in pairs])
    np.testing.assert_allclose(np.unique(found.round(6), axis=0), np.unique(points.round(6), axis=0), atol=2e-6)
    assert len(found) == len(np.unique(points.round(6), axis=0))


@pytest.mark.parametrize("beyond", [None, 3.0])
@pytest.mark.parametrize("bent_first", [False, True])
@pytest.mark.parametrize("angle", [45.0, 90.0])
def test_a_node_on_a_fold_has_the_normal_of_the_flange(angle, bent_first, beyond):
    """A flange on a flat sheet, or on another whose wall leaves the other way, from a fold that lies beyond its own."""
    dy, dz = 20 * np.cos(np.radians(angle)), 20 * np.sin(np.radians(angle))
    bent = Surface(*extrude([(25, 1), (5, 1), (5 - dy, 1 + dz)], 0.0, 20.0, 2.3))
    sheet = plane(0, size=30.0, n=13)
    if beyond is not None:
        end = 5 + beyond
        sheet = Surface(*extrude([(25, 0), (end, 0), (end - dy, -dz)], 0.0, 20.0, 2.1))
    bodies = (Side(bent, 1.0), Side(sheet, 1.0))[:: 1 if bent_first else -1]
    pairs = node_pairs(zone(max_gap=0.5), *bodies)
    for pair in pairs:
        np.testing.assert_allclose(np.abs(pair.frame[2, 0]), 1.0, atol=1e-9)
        assert pair.gap == pytest.approx(0.0, abs=1e-9)
    ending = int(bent_first != (beyond is None))
    surface, line = bodies[ending].surface, [5.0 + (beyond or 0.0), 1.0 if beyond is None else 0.0]
    fold = np.flatnonzero(np.abs(surface.points[:, 1:] - line).max(1) < 1e-9)
    flange = np.ptp(surface.corners[:, :, 2], axis=1) < 1e-9
    third = np.repeat(surface.areas[flange] / 3, 3)
    thirds = np.bincount(surface.triangles[flange].ravel(), third, len(surface.points))
    points = np.array([read(pair, bodies, ending)[0] for pair in pairs])
    own = np.array([pair.patches[ending].barycentric.max() > 1 - 1e-9 for pair in pairs])  # other nodes read within
    for k in fold:  # half of its area of the flange, since both sheets have nodes, and none of the wall's
        at = own & (np.linalg.norm(points - surface.points[k], axis=1) < 1e-9)
        assert any(pairs[i].area == pytest.approx(thirds[k] / 2) for i in np.flatnonzero(at))


def test_a_node_in_a_corner_faces_both_walls():
    inner = Side(Surface(*extrude([(25, 1), (1, 1), (1, 25)], 0.0, 20.0, 2.3)), 1.0)
    outer = Side(Surface(*extrude([(26, 0), (0, 0), (0, 26)], 0.0, 20.0, 2.1)), 1.0)
    fold = [pair for pair in node_pairs(zone(max_gap=2.0), inner, outer) if np.allclose(pair.point[1:], 1)]
    ways = np.array([np.abs(pair.frame[1:, 0]).round(9) for pair in fold])
    there = np.isclose(inner.surface.points[:, 1:], 1).all(1).sum()
    assert len(ways) == 2 * there and (ways == [1, 0]).all(1).sum() == there == (ways == [0, 1]).all(1).sum()


@pytest.mark.parametrize("within_first", [False, True])
def test_coincident_nodes_are_merged_on_each_side_of_a_sheet_in_a_slot(within_first):
    """Three equal meshes above each other, the outer two of one body: a node of the middle one faces both."""
    leaves = [plane(z) for z in (0, 2)]
    slot = Surface(
        np.vstack([leaf.points for leaf in leaves]),
        np.vstack([leaves[0].triangles, leaves[1].triangles + len(leaves[0].points)]),
    )
    sheet = plane(1)
    bodies = (Side(sheet, 1.0), Side(slot, 1.0))[:: 1 if within_first else -1]
    pairs = node_pairs(zone(), *bodies)
    of_node = np.bincount(sheet.triangles.ravel(), np.repeat(sheet.areas / 3, 3))
    for up in (1, -1):
        own = [pair for pair in pairs if pair.frame[2, 0] * up > 0]
        away = np.linalg.norm(sheet.points[:, None, :2] - np.array([pair.point[:2] for pair in own]), axis=2)
        assert len(own) == len(of_node) and (away.min(1) < 1e-9).all()
        np.testing.assert_allclose([own[k].area for k in away.argmin(1)], of_node)


def test_a_round_pad_ends_at_its_circle_on_any_mesh():
    plate = Side(plane(0, n=16), 1.0)
    found = []
    for turn in np.radians([0, 17]):
        found.append(find_pairs(zone(pairs=5), pad((9.0, 10.5, -0.6), 6.0, 12, turn), plate))
        assert sum(pair.area for pair in found[-1]) == pytest.approx(np.pi * 36, rel=0.01)
    np.testing.assert_allclose(*([pair.point for pair in pairs] for pairs in found), atol=1e-9)


def test_the_border_of_a_region_belongs_to_it():
    bodies = Side(plane(0, n=4), 1.0), Side(plane(1, n=4), 1.0)
    low, high = 1 / 3, 20 - 1 / 3  # through sampling points: edges of 5 mm are divided by five
    for nudge in (-1e-9, 0.0, 1e-9):
        box = ((low + nudge, low - nudge, -1), (high - nudge, high + nudge, 2))
        pairs = find_pairs(zone(pairs=4, box=box), *bodies)
        np.testing.assert_allclose([pair.area for pair in pairs], 100, rtol=0.1)
        if nudge == -1e-9:
            wanted = np.array([pair.point for pair in pairs])
        np.testing.assert_allclose([pair.point for pair in pairs], wanted, atol=1e-9)


def test_landmarks_choose_between_equal_pairs():
    """The square and its mesh are the same after half a turn: so are the pairs, where the landmarks turn as well."""
    bodies = flats(8, 8)
    middle, half_turn = np.array([10, 10, 0]), np.diag([-1, -1, 1])
    landmarks = np.array([[0, 0, 0], [20, 0, 0], [20, 20, 0]])
    first = np.array([pair.point for pair in find_pairs(zone(pairs=3), *bodies, landmarks)])
    turned = find_pairs(zone(pairs=3), *bodies, (landmarks - middle) @ half_turn + middle)
    turned = np.array([pair.point for pair in turned])
    np.testing.assert_allclose((turned - middle) @ half_turn + middle, first, atol=1e-9)
    assert np.abs(turned - first).max() > 1


@pytest.mark.parametrize("apart", [0.0, 1e-9, 1e-3])
def test_coincident_points_share_their_area(apart):
    bodies = Side(plane(0), 1.0), Side(plane(1.5, n=7), 0.8)
    once = find_pairs(zone(pairs=None, points=[(4, 10, 0), (16, 10, 0)]), *bodies)
    often = find_pairs(zone(pairs=None, points=[(4, 10, 0), (16, 10, 0), (4 + apart, 10, 0), (4, 10, 0)]), *bodies)
    assert often[1].area == pytest.approx(once[1].area)
    assert total(often) == pytest.approx(400)
    shared = [often[i].area for i in (0, 2, 3)]
    assert min(shared) > 0 and sum(shared) == pytest.approx(once[0].area)
    for i in (0, 2, 3):
        assert often[i].gap == pytest.approx(once[0].gap)
        np.testing.assert_allclose(often[i].frame, once[0].frame, atol=1e-12)


def test_both_patches_of_a_pair_cover_the_same_points():
    bodies = Side(plane(0), 1.0), Side(plane(1.0, n=5, x0=6.0), 1.0)  # overhang on both sides
    pairs = find_pairs(zone(pairs=6), *bodies)
    for pair in pairs:
        centre = [patch.weight @ read(pair, bodies, which) for which, patch in enumerate(pair.patches)]
        np.testing.assert_allclose(centre[1] - centre[0], [0, 0, 1.0], atol=1e-9)
    assert total(pairs) == pytest.approx(14 * 20, rel=0.06)


def test_distance_angle_and_region_limit_the_pairs():
    low, high = Side(plane(0), 1.0), Side(plane(1.2, tilt=np.radians(20)), 1.0)
    near = find_pairs(zone(max_gap=2.0), low, high)
    assert max(pair.point[0] for pair in near) < 2.8 / np.tan(np.radians(20)) + 1
    with pytest.raises(ValueError, match="no contact pair"):
        find_pairs(zone(max_angle_deg=10), low, high)
    boxed = find_pairs(zone(box=((0, 0, -1), (5, 20, 1))), low, high)
    assert max(pair.point[0] for pair in boxed) < 5
    tube = find_pairs(zone(path=[(2, 0, 0), (2, 20, 0)], within=2.0), low, high)
    assert max(abs(pair.point[0] - 2) for pair in tube) < 2


def test_a_patch_radius_bounds_patches_but_not_areas():
    bodies = flats(8, 7)
    pairs = find_pairs(zone(pairs=None, points=[(5, 5, 0), (15, 12, 0)], patch=3.0), *bodies)
    assert total(pairs) == pytest.approx(400)
    for pair in pairs:
        for which, patch in enumerate(pair.patches):
            r = np.linalg.norm((read(pair, bodies, which) - pair.point)[:, :2], axis=1)
            assert r.max() < 3.2 and patch.weight @ r**2 == pytest.approx(4.5, rel=0.1)  # a disc's mean r²


def test_every_point_belongs_to_the_nearest_pair():
    """Cells of a centroidal Voronoi tessellation, to half a step of the sampling."""
    bodies = flats(8, 8)
    pairs = find_pairs(zone(pairs=17), *bodies)
    middle = np.array([pair.point for pair in pairs])
    for pair in pairs:
        x = read(pair, bodies)
        away = np.linalg.norm(x[:, None] - middle, axis=2).min(axis=1)
        assert (np.linalg.norm(x - pair.point, axis=1) <= away + 0.4).all()


def test_spacing_given_points_and_nodal_patches_give_the_expected_pairs():
    bodies = flats(8, 8)
    candidates = find_pairs(zone(pairs=None, spacing=5.0), *bodies)
    assert len(candidates) == 80 / 5 + (400 - 80 * 5 / 2) / 25  # along the edges, and within
    assert total(candidates) == pytest.approx(400)
    wanted = [(5, 5, 0), (15, 5, 0), (10, 15, 0)]
    pairs = find_pairs(zone(pairs=None, points=wanted), *bodies)
    nodal = find_pairs(zone(pairs=None, points=wanted, patch=0.0), *bodies)
    assert [len(pair.patches[0].weight) for pair in nodal] == [1, 1, 1]
    assert len(pairs) == 3 and total(pairs) == pytest.approx(400)
    with pytest.raises(ValueError, match=r"points\[1\]"):
        find_pairs(zone(pairs=None, points=[(5, 5, 0), (55, 5, 0)]), *bodies)


def cylinder(radius, degrees, elements, size, flat=0.0):
    """A cylinder about the x axis, of so many elements across, with its normals; before it the sheet is flat."""
    angle = np.radians(np.linspace(0, degrees, elements + 1))
    profile = radius * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    if flat:
        profile = np.vstack([[-flat, 0.0], profile])
    points, triangles, normals = extrude(profile, 0.0, 12.0, size)
    corner = points[triangles]
    about = np.where(corner[..., 1:2] > 0, [0.0, 0.0, radius] - corner * [0, 1, 1], [0.0, 0.0, 1.0])
    return Surface(points, triangles, about * np.sign((about * normals).sum(2, keepdims=True)))


def test_the_spacing_on_bends_follows_curvature_and_mesh():
    """√(R t) of the inner sheet, of 7 mm in 2 mm; on two facets of 5.4 mm across nothing nearer than these is read."""

    def spacing(radius, *shape, **flat):
        inner, outer = cylinder(radius, *shape, **flat), cylinder(radius + 2.0, *shape, **flat)
        outer = Surface(outer.points - [0, 0, 2.0], outer.triangles, outer.given_normals)
        return candidate_spacing(zone(pairs=None), Side(inner, 2.0), Side(outer, 2.0)), outer

    assert spacing(7.0, 90, 12, 2.0)[0] == pytest.approx(1.3 * np.sqrt(7 * 2.0), rel=0.01)
    coarse, outer = spacing(7.0, 90, 2, 6.0)
    assert coarse == pytest.approx(0.85 * np.median(outer.edge_lengths))
    assert spacing(400.0, 10, 12, 4.0)[0] == pytest.approx(8.0)  # bent gently: four thicknesses, as if flat
    assert spacing(7.0, 90, 12, 2.0, flat=40.0)[0] < 5.0
    assert spacing(7.0, 90, 12, 2.0, flat=300.0)[0] == pytest.approx(8.0)  # a bend of 4 % of the zone


def test_bend_detection_does_not_depend_on_order_or_orientation():
    inner, outer = cylinder(7.0, 90, 12, 1.0), cylinder(9.0, 90, 12, 1.0)
    outer = Surface(outer.points - [0, 0, 2.0], outer.triangles[:, ::-1], -outer.given_normals[:, ::-1])
    one, other = (Side(body, 2.0) for body in (inner, outer))
    assert candidate_spacing(zone(pairs=None), one, other) == candidate_spacing(zone(pairs=None), other, one)
