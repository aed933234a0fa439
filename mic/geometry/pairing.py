"""Contact pairs: where two nominal surfaces face each other, and over which patches.

A fine sampling of the first surface is taken. A sampling point belongs to the zone when it lies in the zone's region
and its closest point on the other surface faces it: normals within an angle, the joining line along the normal, the gap
between the *facing* surfaces (both half-thicknesses taken off) within a limit. The points are then gathered into cells
of about equal size; a pair's patch is its cell, read on one surface and, point for point, at the projections on the
other, so that a pair's two forces act on one line and leave no couple behind.

A sheet within a hem, or within a slot, faces the other body on both its sides. It is looked at either way, and what
faces one way and what faces the other, near to each other, are gathered apart: no pair stands for both.

A zone that states neither how many pairs nor which gets *candidates*, so far apart as an element allows and what bends
between two pairs demands,

    max(one element, min(4 t, 1.5 r)),        t the thinner sheet, r the smallest clamp's radius;

in a zone with bends of radius R no farther than max(0.85 elements, 1.3 √(R t)): what a force does to a bent sheet
dies away over some √(R t), and a facet of the bend that no candidate reads is one through which sheets pass. The zone's
`spacing_factor` scales all these distances, that under clamps as well.

They stand where thin sheets press, and nowhere else so much: along the *edges* and folds of both bodies and the rims of
round rests, each reading a length of the edge; at the *corners* of their borders, where folds end on these, and where
edges of one body *cross* those of the other, for there their overlap has a corner, each reading the corner itself; at
every place where something presses the sheets together; and over the rest, each reading a cell. Under a clamp's pad
they are 2/3 r apart, however coarse the elements: on a single one the sheets could tilt like on a hinge. Contact begins
where the gap is least: a candidate reads what of its length or cell lies nearest. A cell lies within a nugget or
outside, so that no pair fights the weld that it lies at half; and within a pad or outside, be it a clamp's or that of a
rest beneath it: what each presses uniformly the cells between them carry uniformly, and a nominal assembly does not
move. Pads of two sizes press unlike within the smaller and in the ring about it, through a third sheet, too.

A pair's normal is that of the curved sheet which the triangles stand for, between the normals at their corners. Across
a bend of a few facets those of the facets jump by more than the angle of friction, and with them what a pair carries,
by which facet it happens to read. An edge or fold presses along the normal of the sheet that it presses on.

Points *between* the pairs, as far from them as there are, tell how far the sheets pass through each other unseen.

Which sampling points belong to a zone, and to which pair, must not hang on rounding: a point on the border of a region
is inside, and where cells could start or end at several places alike, the distances from the scene's locators decide.
So a scene that is turned, mirrored, renumbered or written in other units has the same pairs, in the same order.

`node_pairs` takes the meshes' own sampling instead: every vertex of either surface in the zone against its closest
point on the other, as node-to-surface contact does, both ways.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mic.geometry.surface import EQUAL, Patch, Surface

__all__ = ["ContactPair", "Pressed", "Side", "candidate_spacing", "find_between", "find_pairs", "node_pairs", "pair_at"]

ACROSS = 4.0  # thicknesses between two candidates: across so much a sheet hardly bends
UNDER = 1.5  # radii of the smallest clamp between two candidates
PAD = 2 / 3  # radii of a clamp between two candidates under it: one in the middle, six about it
BENDS = 1.3  # √(R t) between two candidates on bends
FACET = 0.85  # of an element: so near to each other, each facet of a bend is read
TIGHT = 0.05  # of a zone's area: bends that take less do not decide
RESOLVED = 0.4  # of an element: nearer to each other, neighbouring cells read the same few freedoms
FOLD = 10.0  # degrees: a sheet whose triangles turn by more ends a plane there
CORNER = 30.0  # degrees: a border that turns by more has a corner there
NEAR = 0.005  # of the thinner sheet: what is farther apart than the nearest place of a cell, by so much, is not read
FINE = 6  # sampling points across a cell
OPPOSITE = -0.5  # cosine of two normals beyond which they belong to different faces
SIDEWAYS = 0.05  # of the thinner sheet: how far beside the normal a closest point may lie where surfaces touch


@dataclass(frozen=True)
class Side:
    """One of the two bodies that may touch: its surface and its thickness, mm; None for a rigid fixture.

    Of a round pad, whose triangles cannot follow the circle, only what lies within `disc` counts: (centre, radius), mm.
    """

    surface: Surface
    thickness: float | None = None
    disc: tuple[tuple[float, float, float], float] | None = None

    @property
    def rigid(self) -> bool:
        """Whether the body is a fixture."""
        return self.thickness is None

    @property
    def half_thickness(self) -> float:
        """From the given surface to the faying one, mm; a fixture is given by its faying surface."""
        return 0.0 if self.thickness is None else self.thickness / 2


@dataclass(frozen=True)
class ContactPair:
    """One candidate contact.

    Attributes
    ----------
    point : (3,) array
        Centre of the patch on the first body's mid-surface, mm.
    frame : (3, 3) array
        Columns ``n, t1, t2``; n points from the first body to the second.
    gap : float
        Nominal gap between the facing surfaces, positive when apart, mm.
    overlap : float
        Deepest overlap of the facing surfaces within the patch, as they are drawn, mm.
    overlapping : float
        Share of the patch in which they overlap.
    area : float
        Area that the pair stands for, mm².
    patches : tuple of two Patch
        Where the pair reads the first and the second body.
    sides : tuple of two int
        Which surface of each body faces the other (+1: along its triangle normals).
    nugget : int
        Number of the weld within whose nugget the pair lies; -1 for none.
    apart : float
        Of a candidate, how far from its neighbours it was to stand, mm; NaN for any other pair.
    """

    point: np.ndarray
    frame: np.ndarray
    gap: float
    overlap: float
    overlapping: float
    area: float
    patches: tuple[Patch, Patch]
    sides: tuple[int, int]
    nugget: int = -1
    apart: float = np.nan


@dataclass(frozen=True)
class Pressed:
    """Where something presses two sheets together: a clamp, a weld, a locator.

    Attributes
    ----------
    point : (3,) array
        mm.
    radius : float
        Of a clamp's pad, mm: candidates are so near to each other that a few lie under it. Of a weld's nugget, mm. Of
        both, candidates lie within or outside, none across the rim; so of a rest that backs clamps. 0 of any other
        locator.
    weld : int
        Number of the weld; -1 for anything else.
    normal : (3,) array, optional
        Of a weld, from the zone's first body to its second where they are joined. On the other face of a sheet within a
        hem, which looks the opposite way, nothing is joined; without it the weld joins either face.
    backs : float
        Of a rest, the largest radius of the clamps' pads that it backs, mm; 0 of anything else.
    """

    point: np.ndarray
    radius: float = 0.0
    weld: int = -1
    normal: np.ndarray | None = None
    backs: float = 0.0


def find_pairs(zone, first: Side, second: Side, landmarks=(), pressed: Sequence[Pressed] = ()) -> list[ContactPair]:
    """Find the contact pairs of a zone: those that it states, or candidates.

    Parameters
    ----------
    zone : mic.scene.zone.Zone
    first, second : Side
        The bodies in the order of ``zone.parts``.
    landmarks : (l, 3) array, optional
        Points of the scene, mm: what the shapes leave open, their distances decide, the first's first. Three that do
        not stand in line suffice.
    pressed : sequence of Pressed
        Of candidates, one stands at each of these places that lies in the zone.

    Raises
    ------
    ValueError
        If the zone is empty or has no room for its pairs, a given point faces nothing, or candidates are asked for that
        are finer than the elements.

    Notes
    -----
    Given points that coincide, or lie closer than the area is sampled, are pairs that share their area.
    """
    swap = first.rigid  # sample the deformable body; a rigid fixture's mesh may be as coarse as it likes
    sampled, other = (second, first) if swap else (first, second)
    tie = max(first.surface.tie, second.surface.tie)
    anchors = [sampled.surface.centroid, other.surface.centroid, *landmarks]
    if zone.candidates:
        spacing = candidate_spacing(zone, first, second, pressed)
        pads = sorted((one for one in pressed if one.weld < 0 and one.radius), key=lambda one: one.radius)
        under = zone.spacing_factor * PAD
        finer = [(one, min(spacing, under * max(one.radius, one.backs))) for one in pads]
        return _candidates(zone, sampled, other, spacing, anchors, pressed, finer, swap)
    area = _facing(zone, sampled, other, _first_spacing(sampled.surface)).area.sum()
    count = len(zone.points or ()) or zone.pairs
    cloud = _facing(zone, sampled, other, np.sqrt(area / count) / FINE)
    cloud = cloud.take(_ranking(cloud.point, anchors, tie))  # from here on, the first of equals is chosen
    if count > len(cloud.area):
        raise ValueError(
            f"{count} pairs do not fit into the {area:.3g} mm² where the parts face each other; ask for fewer pairs"
        )
    face = _faces(cloud, sampled.surface, np.sqrt(area / count))
    if zone.points:
        number, centres = _given(zone, cloud, face, np.sqrt(area / count), tie)
    else:
        number, centres = _shared(cloud, face, count, tie)
    pairs: list = [None] * count
    for one in np.unique(face):
        own = np.flatnonzero(face == one)
        of = np.flatnonzero(number == one)
        if not len(of):
            continue
        cell = _nearest(centres[of], cloud.point[own], tie)
        held = _held(centres[of], cell)
        sharers = np.bincount(held, minlength=len(of))
        for i, k in zip(of, held):
            member = cloud.take(own[cell == k])
            reading = _reading(zone, sampled, other, member, centres[i], tie)
            pairs[i] = _pair(reading, member.area.sum() / sharers[k], sampled, other, swap)
    _set_tangents(pairs)
    return pairs


def _given(zone, cloud, face, farthest, tie):
    """Points that a zone states: the face of each, that of the sampling point nearest to it, and the points.

    Where a sheet faces the other body on both its sides, the side that the point lies on.
    """
    centres = np.array(zone.points)
    many = min(2, len(cloud.area))
    away, near = (table.reshape(len(centres), many) for table in cKDTree(cloud.point).query(centres, many))
    lost = np.flatnonzero(away[:, 0] > farthest + tie)
    if len(lost):
        raise ValueError(
            f"points[{lost[0]}] lies where the parts face nothing; move it, or widen max_gap or the region"
        )
    ahead = np.einsum("ikj,ikj->ik", centres[:, None] - cloud.point[near], cloud.normal[near])
    ahead[away > away[:, :1] + tie] = -np.inf
    return face[near[np.arange(len(near)), ahead.argmax(1)]], centres


def _held(centres, cell):
    """(k,) the centre whose cell each centre holds: its own or, where no point is nearest to it, as where two coincide,
    that of the nearest one that has a cell. Those that hold one cell share its area."""
    own, there = np.arange(len(centres)), np.unique(cell)
    without = np.setdiff1d(own, there)
    if len(without):
        own[without] = there[cKDTree(centres[there]).query(centres[without])[1]]
    return own


def _shared(cloud, face, count, tie):
    """So many centres, shared out over the faces by their areas: the face of each, and the centres."""
    area = np.bincount(face, cloud.area)
    if count < len(area):
        raise ValueError(
            f"the parts face each other on {len(area)} sides of a sheet, and {count} pairs do not reach for all; "
            "ask for more pairs"
        )
    share = np.maximum(1, np.floor(count * area / area.sum() + EQUAL)).astype(int)
    while share.sum() != count:
        step = int(np.sign(count - share.sum()))
        wanting = step * (count * area / area.sum() - share) - np.where(share + step < 1, np.inf, 0.0)
        share[_first(wanting, EQUAL)] += step
    none, found = np.zeros((0, 3)), []
    for one, of in enumerate(share):
        own = face == one
        found.append(_centres(cloud.point[own], cloud.area[own], of, tie, none))
    return np.repeat(np.arange(len(area)), share), np.vstack(found)


def _candidates(zone, sampled, other, spacing, anchors, pressed, pads, swap) -> list[ContactPair]:
    """Candidates: along the edges of both sheets, where something presses them together, and over all the rest.

    `pads` are the clamps and the rests beneath them, and how far apart candidates stand under each, the smallest first.
    """
    tie = max(sampled.surface.tie, other.surface.tie)
    cloud = _facing(zone, sampled, other, spacing / FINE, pads)
    cloud = cloud.take(_ranking(cloud.point, anchors, tie))
    face = _faces(cloud, sampled.surface, spacing)
    lines = []
    for found in (_edges(zone, sampled, other, spacing, anchors), _corners(zone, sampled, other, spacing, anchors)):
        found = found.take(np.flatnonzero(_fused(pressed, found, tie) < 0))
        found = found.take(_ranking(found.point, anchors, tie))
        lines.append((found, _face_of(found.point, found.normal, cloud, face, spacing)))
    pairs = []
    for one in np.unique(face):
        edge, corner = (found.take(np.flatnonzero(of == one)) for found, of in lines)
        own = cloud.take(np.flatnonzero(face == one))
        pairs += _of_face(zone, sampled, other, spacing, own, edge, corner, pressed, pads, swap)
    _set_tangents(pairs)
    return pairs


def _of_face(zone, sampled, other, spacing, cloud, edge, corner, pressed, pads, swap) -> list[ContactPair]:
    """The candidates of one face; their tangents are not set."""
    tie = max(sampled.surface.tie, other.surface.tie)
    fused = _fused(pressed, cloud, tie)
    corner = corner.take(_thinned(corner.point, corner.area, spacing / 2 + tie))
    corner = replace(corner, area=np.ones(len(corner.area)))
    length, ends = edge.area.sum(), corner.point
    if len(edge.area):
        count = max(1, len(ends), int(length / spacing + 0.5 + EQUAL))
        ends = _centres(edge.point, edge.area, count, tie, ends)
    along = _nearest(ends, edge.point, tie) if len(ends) else np.zeros(0, dtype=np.int64)
    under = _under(pressed, cloud, spacing, tie)
    group = _grouped(pads, cloud, fused, tie)
    pairs = []
    for number in np.unique(group):
        member = np.flatnonzero(group == number)
        nugget, free = fused[member[0]], number < 0
        pad = number - fused.max(initial=-1) - 1
        apart = pads[pad][1] if pad >= 0 else spacing
        whole = cloud.take(member)
        own = under[cKDTree(whole.point).query(under)[0] <= tie]
        taken = whole.area.sum()
        if free and len(ends):
            own = own[cKDTree(ends).query(own)[0] > spacing / 4 + tie]
            taken -= spacing * length / 2
            own = np.vstack([ends, own])
        rest = taken / apart**2 - (len(own) - (len(ends) if free else 0))
        count = min(max(1, len(own) + max(0, int(rest + 0.5 + EQUAL))), len(whole.area))
        centres = _centres(whole.point, whole.area, count, tie, own)
        cell = _nearest(centres, whole.point, tie)
        for k, centre in enumerate(centres):
            member = whole.take(np.flatnonzero(cell == k))
            if not len(member.area):
                continue
            if free and k < len(corner.area) and zone.patch == "tributary":
                reading = corner.take([k])
            elif free and k < len(ends) and zone.patch == "tributary":
                reading = edge.take(np.flatnonzero(along == k))
            else:
                reading = _reading(zone, sampled, other, member, centre, tie)
            cut = _pair(member, member.area.sum(), sampled, other, swap)
            pair = _pair(_nearest_part(reading, sampled, other), cut.area, sampled, other, swap)
            pairs.append(
                replace(pair, overlap=cut.overlap, overlapping=cut.overlapping, nugget=int(nugget), apart=apart)
            )
    return pairs


def _thinned(point, rank, apart) -> np.ndarray:
    """Indices of points no two of which lie within a distance of each other: those of higher rank first."""
    kept: list[int] = []
    for i in np.argsort(-rank, kind="stable"):
        if not kept or np.linalg.norm(point[kept] - point[i], axis=1).min() > apart:
            kept.append(int(i))
    return np.array(kept, dtype=np.int64)


def _faces(cloud, surface, spacing) -> np.ndarray:
    """(n,) which of several faces each point belongs to, 0 for the first: those near to each other that look opposite
    ways are on different faces, and what hangs together is on one.

    Sides of triangles hang together that share a vertex. Of what closes about itself, the sides of the axis along which
    its normals mostly stand.
    """
    ahead = np.einsum("ij,ij->i", cloud.normal, surface.normals[cloud.triangle]) > 0
    side, of = np.unique(2 * cloud.triangle + ahead, return_inverse=True)
    of, first = of.ravel(), np.full(len(side), len(cloud.area))
    np.minimum.at(first, of, np.arange(len(of)))
    normal = surface.normals[side // 2] * np.where(side % 2, 1.0, -1.0)[:, None]
    reach = 2 * (spacing + surface.reach[side // 2].max())
    place = surface.corners[side // 2].mean(1) / reach
    many = min(8, len(side))
    away, against = (
        table.reshape(len(side), many)
        for table in cKDTree(np.hstack([place, normal])).query(
            np.hstack([place, -normal]), many, distance_upper_bound=1.0
        )
    )
    own, turn = np.nonzero(np.isfinite(away))
    if not len(own):
        return np.zeros(len(of), dtype=np.int64)
    against = against[own, turn]
    piece = _pieces(side, surface)
    for one in np.unique(piece[own][piece[own] == piece[against]]):
        about = np.flatnonzero(piece == one)
        n = normal[about]
        axis = np.linalg.eigh((n * surface.areas[side[about] // 2, None]).T @ n)[1][:, -1]
        along = (n @ axis) * np.sign(n[first[about].argmin()] @ axis)
        piece[about[along < -EQUAL]] = piece.max() + 1
    face = np.full(piece.max() + 1, -1)
    for one in piece[np.argsort(first)]:
        if face[one] < 0:
            taken = face[np.concatenate([piece[against[piece[own] == one]], piece[own[piece[against] == one]]])]
            face[one] = np.setdiff1d(np.arange(len(taken) + 1), taken)[0]
    return face[piece][of]


def _pieces(side, surface) -> np.ndarray:
    """(s,) number of the piece that each side of a triangle belongs to: those that share a vertex hang together."""
    vertex = 2 * surface.triangles[side // 2] + (side % 2)[:, None]
    used, local = np.unique(vertex, return_inverse=True)
    row = np.repeat(np.arange(len(side)), 3)
    touch = coo_matrix((np.ones(len(row)), (row, local.ravel())), shape=(len(side), len(used))).tocsr()
    return connected_components(touch @ touch.T, directed=False)[1]


def _face_of(point, normal, cloud, face, spacing) -> np.ndarray:
    """(k,) the face of further points: that of the nearest point of the cloud which looks their way."""
    if not face.any() or not len(point):
        return np.zeros(len(point), dtype=np.int64)
    tree = cKDTree(np.hstack([cloud.point / (2 * spacing), cloud.normal]))
    return face[tree.query(np.hstack([point / (2 * spacing), normal]))[1]]


def _alike(point, normal, among, looking):
    """(n,) distance of each point to the nearest of others that do not look the opposite way, mm."""
    many = min(8, len(among))
    away, nearest = (table.reshape(len(point), many) for table in cKDTree(among).query(point, many))
    opposite = np.einsum("ij,ikj->ik", normal, looking[nearest]) < OPPOSITE
    return np.where(opposite, np.inf, away).min(1)


def _reading(zone, sampled, other, own, centre, tie):
    """Where a pair reads the bodies: its cell, or the disc that the zone states."""
    if zone.patch == "tributary":
        return own
    nearest = _first(-np.linalg.norm(own.point - centre, axis=1), tie)
    seed = centre if zone.points else own.point[nearest]
    disc = sampled.surface.patch(seed, float(zone.patch), own.normal.mean(0))
    angle = np.radians(zone.max_angle_deg)
    reading = _project(sampled, other, zone.max_gap, angle, disc.triangle, disc.barycentric, disc.weight)
    reading = reading.take(np.flatnonzero(reading.normal @ own.normal.mean(0) > 0))
    return reading if len(reading.area) else own.take([nearest])


def _fused(pressed, cloud, tie) -> np.ndarray:
    """(n,) number of the weld in whose nugget, seen along the normal, each point lies; -1 for none."""
    found = np.full(len(cloud.area), -1)
    for one in pressed:
        if one.weld >= 0:
            found[_within(one, cloud, tie)] = one.weld
    return found


def _within(one, cloud, tie) -> np.ndarray:
    """(n,) bool: which points lie, seen along the normal, within the disc of what presses."""
    step = cloud.point - one.point
    along = np.einsum("ij,ij->i", step, cloud.normal)
    sideways = np.linalg.norm(step - along[:, None] * cloud.normal, axis=1)
    inside = (sideways <= one.radius + tie) & (np.abs(along) <= cloud.distance + one.radius)
    return inside if one.normal is None else inside & (cloud.normal @ one.normal > 0)


def _grouped(pads, cloud, fused, tie) -> np.ndarray:
    """(n,) the disc that each point lies in, of those across whose rims no candidate reads; -1 for none.

    Nuggets come first, then the smaller pads; of a pad that others leave less than half a cell no rim is kept.
    """
    group, welds = fused.copy(), fused.max(initial=-1) + 1
    for i, (one, apart) in enumerate(pads):
        left = _within(one, cloud, tie) & (group < 0)
        if cloud.area[left].sum() >= apart**2 / 2:
            group[left] = welds + i
    return group


def _edges(zone, sampled, other, spacing, anchors):
    """Points of both bodies' edges that face the other body, as points of the sampled one; `area` is length, mm.

    Edges that lie upon each other are one. On a fold a point is there once for each of the two triangles.
    """

    def along(body):
        if body.disc is not None:
            return _rim(body, spacing / FINE, anchors)
        return body.surface.sample_edges(*body.surface.edges(np.radians(FOLD)), spacing / FINE)

    def shared(cloud, tie):
        one, two = cKDTree(cloud.point).query_pairs(tie, output_type="ndarray").T
        same = np.einsum("ij,ij->i", cloud.normal[one], cloud.normal[two]) > OPPOSITE
        met = np.concatenate([one[same], two[same]])
        return replace(cloud, area=cloud.area / (1 + np.bincount(met, minlength=len(cloud.area))))

    return _of_both(zone, sampled, other, along, shared, spacing / 4)


def _rim(body, spacing, anchors):
    """Points of a round pad's rim, none farther apart: triangle, barycentric, length.

    They lie alike on both sides of the first anchor that is not above the pad's middle.
    """
    (centre, radius), normal = body.disc, body.surface.normals[0]
    steps = np.array(anchors) - centre
    steps -= np.outer(steps @ normal, normal)
    aside = np.linalg.norm(steps, axis=1)
    if not (aside > body.surface.tie).any():
        steps, aside = np.cross(normal, np.eye(3)), np.ones(3)
    t = steps[np.argmax(aside > body.surface.tie)]
    t = t / np.linalg.norm(t)
    count = int(np.ceil(2 * np.pi * radius / spacing - EQUAL))
    angle = 2 * np.pi * (np.arange(count) + 0.5)[:, None] / count
    point = centre + radius * (np.cos(angle) * t + np.sin(angle) * np.cross(normal, t))
    foot = body.surface.project(point)
    return foot.triangle, foot.barycentric, np.full(count, 2 * np.pi * radius / count)


def _corners(zone, sampled, other, spacing, anchors):
    """Corners of both bodies' borders that face the other body, and where edges of both cross, as `_edges` has their
    edges; `area` is their rank.

    Where an edge presses, it presses at its end first; and a length that is read about a corner has its middle off it.
    """
    own = _of_both(zone, sampled, other, _corners_of, lambda cloud, tie: cloud, spacing / 4)
    return _joined([own, _crossings(zone, sampled, other, spacing, anchors)])


def _crossings(zone, sampled, other, spacing, anchors):
    """Where edges of the two bodies cross, as `_corners` has corners: there ends what faces the other body."""
    surface = sampled.surface
    triangle, opposite = surface.edges(np.radians(FOLD))
    start, end = surface.corners[triangle, (opposite + 1) % 3], surface.corners[triangle, (opposite + 2) % 3]
    if other.disc is None:
        others, across = other.surface.edges(np.radians(FOLD))
        first, last = other.surface.corners[others, (across + 1) % 3], other.surface.corners[others, (across + 2) % 3]
        border = other.surface.border[others, across]
    else:
        rim = _rim(other, spacing / FINE, anchors)
        first = other.surface.at(*rim[:2])
        last, border = np.roll(first, -1, axis=0), np.ones(len(first), dtype=bool)
    reach = zone.max_gap + sampled.half_thickness + other.half_thickness + _tie(sampled, other)
    half = np.linalg.norm(last - first, axis=1) / 2
    longest = np.linalg.norm(end - start, axis=1).max(initial=0.0) / 2
    near = cKDTree((start + end) / 2).query_ball_point((first + last) / 2, half + longest + reach) if len(start) else []
    k = np.repeat(np.arange(len(near)), [len(one) for one in near])
    i = np.concatenate([np.zeros(0, dtype=np.int64), *near]).astype(np.int64)
    u, v, w = end[i] - start[i], last[k] - first[k], start[i] - first[k]
    uu, uv, vv, uw, vw = (np.einsum("ij,ij->i", *two) for two in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    turns = uu * vv - uv**2 > np.sin(np.radians(CORNER)) ** 2 * uu * vv
    i, k, u, v, w, uu, uv, vv, uw, vw = (one[turns] for one in (i, k, u, v, w, uu, uv, vv, uw, vw))
    along, ahead = np.array([uv * vw - vv * uw, uu * vw - uv * uw]) / (uu * vv - uv**2)
    inside = [
        np.abs(at - 0.5) <= 0.5 + _tie(sampled, other) / np.sqrt(length) for at, length in ((along, uu), (ahead, vv))
    ]
    apart = np.linalg.norm(w + along[:, None] * u - ahead[:, None] * v, axis=1)
    use = np.flatnonzero(inside[0] & inside[1] & (apart <= reach))
    at, own = np.clip(along[use], 0.0, 1.0), i[use]
    barycentric = np.zeros((len(use), 3))
    barycentric[np.arange(len(use)), (opposite[own] + 1) % 3] = 1 - at
    barycentric[np.arange(len(use)), (opposite[own] + 2) % 3] = at
    rank = 1.0 + (surface.border[triangle[own], opposite[own]] & border[k[use]])
    angle = np.radians(zone.max_angle_deg)
    cloud = _project(sampled, other, zone.max_gap, angle, triangle[own], barycentric, rank)
    cloud = replace(cloud, normal=-_turned(cloud, other).normal)
    return cloud.take(_in_region(zone, cloud.point, surface.tie))


def _corners_of(body):
    """Corners of a surface's border in each of their triangles: triangle, barycentric, and rank: 2 where the border
    turns, 1 where a fold ends on it."""
    surface = body.surface
    triangle, opposite = surface.edges(np.radians(FOLD))
    ends = surface.triangles[triangle[:, None], (opposite[:, None] + [1, 2]) % 3]
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    away = surface.points[ends[:, 1]] - surface.points[ends[:, 0]]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    total = np.zeros_like(surface.points)  # of unit vectors along its edges: of two that turn by φ it is 2 sin(φ/2)
    np.add.at(total, ends[:, 0], away)
    np.add.at(total, ends[:, 1], -away)
    count = np.bincount(ends.ravel(), minlength=len(surface.points))
    turns = (count == 2) & (np.linalg.norm(total, axis=1) > 2 * np.sin(np.radians(CORNER) / 2) + EQUAL)
    rank = np.where(surface.border_vertices, 2.0 * turns + (count > 2), 0.0)[surface.triangles.ravel()]
    use = np.flatnonzero(rank)
    return use // 3, np.eye(3)[use % 3], rank[use]


def _of_both(zone, sampled, other, found_on, weighed, near):
    """Points found on both bodies' surfaces that face the other body, as points of the sampled one.

    Of the second body's, those nearer than `near` to the first's are left out.
    """
    angle = np.radians(zone.max_angle_deg)
    found = []
    for body, opposite in ((sampled, other), (other, sampled)):
        cloud = _project(body, opposite, zone.max_gap, angle, *found_on(body))
        if len(cloud.area):
            cloud = weighed(cloud, body.surface.tie)
        seen = _turned(cloud, opposite)
        if body is sampled:
            cloud = replace(cloud, normal=-seen.normal)  # an edge presses along the normal of what it presses on
        else:
            cloud = seen
            if len(found[0].area):
                away = _alike(cloud.point, cloud.normal, found[0].point, found[0].normal)
                cloud = cloud.take(away > near + sampled.surface.tie)
        found.append(cloud.take(_in_region(zone, cloud.point, sampled.surface.tie)))
    return _joined(found)


def _joined(clouds):
    return _Cloud(*(np.concatenate([getattr(one, name) for one in clouds]) for name in _Cloud.__dataclass_fields__))


def _turned(cloud, body):
    """The same points seen from the other body, onto whose surface they were projected."""
    point = body.surface.at(cloud.other_triangle, cloud.other_barycentric)
    along = np.einsum("ij,ij->i", cloud.point - point, body.surface.normals[cloud.other_triangle])
    sign = np.where(along < -body.surface.tie, -1.0, 1.0)
    normal = body.surface.smooth_normals(cloud.other_triangle, cloud.other_barycentric)
    return _Cloud(
        cloud.other_triangle,
        cloud.other_barycentric,
        point,
        normal * sign[:, None],
        cloud.area,
        along * sign,
        cloud.triangle,
        cloud.barycentric,
    )


def candidate_spacing(zone, first: Side, second: Side, pressed: Sequence[Pressed] = ()) -> float:
    """Distance between the candidates of a zone, mm: what it states, or what elements, sheets and clamps demand, times
    its factor.

    Parameters
    ----------
    zone, first, second, pressed
        As `find_pairs` takes them.

    Raises
    ------
    ValueError
        If the zone is empty, or states a distance that is finer than the elements.
    """
    sampled, other = (second, first) if first.rigid else (first, second)
    cloud = _facing(zone, sampled, other, _first_spacing(sampled.surface))
    surfaces = [(sampled, cloud.triangle)] + [(other, cloud.other_triangle)] * (not other.rigid)
    element = max(float(np.median(body.surface.edge_lengths[np.unique(own)])) for body, own in surfaces)
    spacing = zone.spacing
    if spacing is None:
        thinner = _thinner(sampled, other)
        radii = [place.radius for place in pressed if place.radius and place.weld < 0 and not place.backs]
        flat = max(element, min(ACROSS * thinner, UNDER * min(radii, default=np.inf)))
        radius = min(_bend_radius(body.surface, own, cloud.area) for body, own in surfaces)
        spacing = min(flat, max(FACET * element, BENDS * np.sqrt(radius * thinner)))
    found = zone.spacing_factor * spacing
    if found < RESOLVED * element:
        times = f" times spacing_factor = {zone.spacing_factor:g}" if zone.spacing_factor != 1 else ""
        raise ValueError(
            f"spacing = {spacing:g} mm{times} between candidates is finer than the elements there "
            f"({element:.2g} mm), which tell such neighbours not apart: refine the mesh, or ask for "
            f"{RESOLVED * element:.2g} mm or more"
        )
    return found


def _bend_radius(surface, triangle, area) -> float:
    """Radius, mm, that so much of the points' area is bent by at least as its `TIGHT` share; infinite if less is bent.

    Along an edge L between corners whose normals differ by Δn a sheet is bent by |Δn|/L.
    """
    normal, corner = surface.corner_normals[triangle], surface.corners[triangle]
    turned = np.linalg.norm(normal - normal[:, [1, 2, 0]], axis=2)
    bent = (turned / np.linalg.norm(corner - corner[:, [1, 2, 0]], axis=2)).max(1)
    order = np.argsort(-bent)
    tightest = bent[order][np.searchsorted(np.cumsum(area[order]), TIGHT * area.sum())]
    return 1 / tightest if tightest > EQUAL else np.inf


def find_between(
    zone, first: Side, second: Side, pairs: Sequence[ContactPair], landmarks=(), pressed: Sequence[Pressed] = ()
) -> list[ContactPair]:
    """As many points of the zone as it has pairs, as far from these and from each other as possible.

    They are pairs whose patches are points, and none of them carries force: they tell what the pairs miss.
    """
    swap = first.rigid
    sampled, other = (second, first) if swap else (first, second)
    tie = max(first.surface.tie, second.surface.tie)
    area = sum(pair.area for pair in pairs)
    cloud = _facing(zone, sampled, other, np.sqrt(area / len(pairs)) / FINE)
    anchors = [sampled.surface.centroid, other.surface.centroid, *landmarks]
    cloud = cloud.take(_ranking(cloud.point, anchors, tie))
    side = 1 if swap else 0
    centres = [
        patch.weight @ sampled.surface.at(patch.triangle, patch.barycentric)
        for patch in (pair.patches[side] for pair in pairs)
    ]
    face = _faces(cloud, sampled.surface, np.sqrt(area / len(pairs)))
    ways = np.array([-pair.frame[:, 0] if swap else pair.frame[:, 0] for pair in pairs])
    of_pair = _face_of(np.array(centres), ways, cloud, face, np.sqrt(area / len(pairs)))
    chosen = []
    for one in np.unique(face):
        own = np.flatnonzero(face == one)
        nearest = cKDTree(np.array(centres)[of_pair == one]).query(cloud.point[own])[0]
        chosen.extend(own[_farthest(cloud.point[own], nearest, min((of_pair == one).sum(), len(own)), tie)])
    fused = _fused(pressed, cloud, tie)
    between = [
        replace(_pair(cloud.take([i]), cloud.area[i], sampled, other, swap), nugget=int(fused[i])) for i in chosen
    ]
    _set_tangents(between)
    return between


def node_pairs(zone, first: Side, second: Side, pressed: Sequence[Pressed] = ()) -> list[ContactPair]:
    """A pair at every vertex of either surface that lies in the zone and faces the other; its patches are points.

    Those of one surface alone would miss where the other ends. A rigid fixture has no vertices of its own. The zone's
    own number, spacing or choice of points plays no part. A vertex stands for a third of the area around it, half of it
    where both bodies have vertices, and looks along the normal of its sheet; on a fold, of each sheet that ends there
    and faces the other body. Vertices that lie upon each other are one.

    Raises
    ------
    ValueError
        If the zone is empty.
    """
    swap = first.rigid
    sampled, other = (second, first) if swap else (first, second)
    tie = max(first.surface.tie, second.surface.tie)
    cloud = _vertices(zone, sampled, other)
    if not other.rigid:
        back = _turned(_vertices(zone, other, sampled), sampled)
        if len(cloud.area):
            same = _upon(back, cloud, tie)
            np.add.at(cloud.area, same[same >= 0], back.area[same >= 0])
            back = back.take(np.flatnonzero(same < 0))
        cloud = _joined([cloud, back])
        cloud = replace(cloud, area=cloud.area / 2)
    cloud = cloud.take(np.flatnonzero(_in_region(zone, cloud.point, sampled.surface.tie)))
    if not len(cloud.area):
        raise ValueError(
            "no vertex of the meshes faces the other surface there; refine the mesh, move the region, or widen max_gap"
        )
    fused = _fused(pressed, cloud, tie)
    pairs = [
        replace(_pair(cloud.take([i]), cloud.area[i], sampled, other, swap), nugget=int(fused[i]))
        for i in range(len(cloud.area))
    ]
    _set_tangents(pairs)
    return pairs


def _upon(cloud, other, tie):
    """(n,) the point of another cloud that each lies upon and looks the same way as; -1 for none."""
    many = min(2, len(other.area))
    away, nearest = (table.reshape(len(cloud.area), many) for table in cKDTree(other.point).query(cloud.point, many))
    alike = np.einsum("ij,ikj->ik", cloud.normal, other.normal[nearest]) > OPPOSITE
    upon = (away <= tie) & alike
    return np.where(upon.any(1), nearest[np.arange(len(nearest)), upon.argmax(1)], -1)


def _vertices(zone, body, opposite):
    """Vertices of one body that face the other; the area of each is a third of the triangles about it.

    A vertex on a fold is looked at from each sheet that ends there, with the area of that sheet: along their mean it
    would press askew, by more than the angle of friction at half of a bend. Of those that find the same closest point
    the one stays that faces it.
    """
    surface = body.surface
    vertex, normal = surface.triangles.ravel(), surface.corner_normals.reshape(-1, 3)
    alike = np.column_stack([vertex, normal.round(6)])  # those of one sheet are projected once
    _, use, of = np.unique(alike, axis=0, return_index=True, return_inverse=True)
    area = np.bincount(of.ravel(), np.repeat(surface.areas / 3, 3))
    triangle, corner = np.divmod(use, 3)
    angle = np.radians(zone.max_angle_deg)
    cloud = _project(body, opposite, zone.max_gap, angle, triangle, np.eye(3)[corner], area, normal[use])
    return _best_facing(cloud, surface.triangles[cloud.triangle, cloud.barycentric.argmax(1)], body, opposite)


def _best_facing(cloud, vertex, body, opposite):
    """Of points that are one vertex and have one closest point, the one along whose normal that lies; the area of those
    that look its way is its own."""
    foot, area = opposite.surface.at(cloud.other_triangle, cloud.other_barycentric), cloud.area.copy()
    order = np.lexsort((-cloud.distance, vertex))
    kept: list[int] = []
    for i in order:
        for k in reversed(kept):
            if vertex[k] != vertex[i]:
                kept.append(i)
                break
            turn = cloud.normal[k] @ cloud.normal[i]
            if turn > OPPOSITE and np.linalg.norm(foot[k] - foot[i]) <= _tie(body, opposite):
                area[k] += area[i] * (turn > np.cos(np.radians(FOLD)))
                break
        else:
            kept.append(i)
    return replace(cloud, area=area).take(np.sort(np.array(kept, dtype=np.int64)))


def pair_at(point, radius: float, first: Side, second: Side) -> ContactPair:
    """The pair at one given point, over a disc of the first surface: where a weld joins two sheets.

    Parameters
    ----------
    point : (3,) array
        mm; projected onto the first surface.
    radius : float
        mm.
    first, second : Side

    Raises
    ------
    ValueError
        If no part of the disc faces the second surface.
    """
    disc = first.surface.patch(point, radius)
    reach = float(second.surface.project(point).distance[0] + first.surface.project(point).distance[0]) + radius
    reading = _project(first, second, reach, np.pi / 3, disc.triangle, disc.barycentric, disc.weight, both=False)
    if not len(reading.area):
        raise ValueError("the two parts do not face each other there")
    pair = _pair(reading, np.pi * radius**2, first, second, swap=False)
    _set_tangents([pair])
    return pair


def _set_tangents(pairs):
    """t1 along the global axis that stays farthest from all normals, so that it varies smoothly over a zone."""
    axis = np.eye(3)[_first(-np.abs([pair.frame[:, 0] for pair in pairs]).max(0), EQUAL)]
    for pair in pairs:
        n = pair.frame[:, 0]
        t1 = axis - (axis @ n) * n
        t1 /= np.linalg.norm(t1)
        pair.frame[:, 1:] = np.column_stack([t1, np.cross(n, t1)])


@dataclass(frozen=True)
class _Cloud:
    """Sampling points of one surface that face the other."""

    triangle: np.ndarray
    barycentric: np.ndarray
    point: np.ndarray
    normal: np.ndarray  # of the sampled surface, turned towards the other
    area: np.ndarray
    distance: np.ndarray  # along the normal, between mid-surfaces
    other_triangle: np.ndarray
    other_barycentric: np.ndarray

    def take(self, index):
        return _Cloud(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def _first_spacing(surface):
    return float(np.median(surface.edge_lengths))


def _facing(zone, sampled, other, spacing, pads=()):
    """Sampling points so far apart; in the triangles near pads so many times finer as candidates are there."""
    surface = sampled.surface
    middle = surface.corners.mean(1)
    step = np.full(len(middle), spacing)
    for one, apart in pads:
        near = np.linalg.norm(middle - one.point, axis=1) <= surface.reach + 2 * one.radius + surface.tie
        step[near] = np.minimum(step[near], apart / FINE)
    step[~_in_region(zone, middle, surface.reach + 2 * surface.tie)] = 0.0
    parts = [surface.sample(np.flatnonzero(step == one), one) for one in np.unique(step[step > 0])[::-1]]
    triangle, barycentric, area = (np.concatenate(columns) for columns in zip(*parts))
    inside = _in_region(zone, surface.at(triangle, barycentric), surface.tie)
    cloud = _project(
        sampled,
        other,
        zone.max_gap,
        np.radians(zone.max_angle_deg),
        triangle[inside],
        barycentric[inside],
        area[inside],
    )
    if not len(cloud.area):
        raise ValueError(
            f"no contact pair: within the region the two surfaces nowhere face each other with a gap below "
            f"max_gap = {zone.max_gap} mm and an angle below max_angle_deg = {zone.max_angle_deg}; "
            "move the region, or widen these limits"
        )
    return cloud


def _under(pressed, cloud, spacing, tie) -> np.ndarray:
    """(k, 3) places of the zone where something presses the sheets together, half a spacing or more apart."""
    places: list[np.ndarray] = []
    for one in pressed:
        step = cloud.point - one.point
        sideways = np.linalg.norm(step - np.einsum("ij,ij->i", step, cloud.normal)[:, None] * cloud.normal, axis=1)
        sideways[np.linalg.norm(step, axis=1) > 2 * cloud.distance + spacing + tie] = np.inf
        at = _first(-sideways, tie)
        if sideways[at] > spacing / 4 + tie:
            continue
        if all(np.linalg.norm(cloud.point[at] - place) > spacing / 2 + tie for place in places):
            places.append(cloud.point[at])
    return np.array(places).reshape(-1, 3)


def _in_region(zone, x, margin):
    """Whether points lie in the zone's region, widened by `margin`, one number or one a point."""
    if zone.box is not None:
        low, high = np.array(zone.box)
        margin = np.reshape(margin, (-1, 1))
        return ((x >= low - margin) & (x <= high + margin)).all(1)
    if zone.path is not None:
        path = np.array(zone.path)
        if len(path) == 1:
            return np.linalg.norm(x - path[0], axis=1) <= zone.within + margin
        start, edge = path[:-1], np.diff(path, axis=0)
        s = np.einsum("nij,ij->ni", x[:, None] - start, edge) / np.einsum("ij,ij->i", edge, edge)
        foot = start + np.clip(s, 0, 1)[..., None] * edge
        return np.linalg.norm(x[:, None] - foot, axis=2).min(1) <= zone.within + margin
    return np.ones(len(x), dtype=bool)


def _project(sampled, other, max_gap, max_angle, triangle, barycentric, area, normal=None, both=True):
    """Sampling points with their closest points on the other surface, those that face nothing left out.

    What faces the other surface on `both` sides is there twice.
    """
    surface, opposite = sampled.surface, other.surface
    point = surface.at(triangle, barycentric)
    smooth = surface.smooth_normals(triangle, barycentric) if normal is None else normal
    normal = surface.normals[triangle] if normal is None else normal
    reach = max_gap + sampled.half_thickness + other.half_thickness
    farthest = np.hypot(reach, np.tan(max_angle) * reach + SIDEWAYS * _thinner(sampled, other)) + 3 * _tie(
        sampled, other
    )

    def facing(rows, side=None):
        foot = opposite.project(point[rows], normal[rows], max_angle, farthest, side)
        good, along = _meets(sampled, other, reach, max_angle, point[rows], normal[rows], foot)
        sign = np.where(along < -_tie(sampled, other), -1.0, 1.0)[good]
        rows, along = rows[good], along[good]
        return _Cloud(
            triangle[rows],
            barycentric[rows],
            point[rows],
            smooth[rows] * sign[:, None],
            area[rows],
            along * sign,
            foot.triangle[good],
            foot.barycentric[good],
        ), (rows, sign)

    cloud, (rows, sign) = facing(np.arange(len(point)))
    if both:
        maybe = opposite.behind(surface, cloud.triangle, sign, farthest, max_angle)
        if maybe.any():
            cloud = _joined([cloud, facing(rows[maybe], -sign[maybe])[0]])
    return cloud


def _meets(sampled, other, reach, max_angle, point, normal, foot):
    """Whether each point faces its closest point, (n,) bool, and how far that lies along the normal, (n,) mm."""
    step = np.where(foot.triangle[:, None] >= 0, foot.point - point, np.nan)
    along = np.einsum("ij,ij->i", step, normal)
    # A closest point beside the normal faces nothing: past a bend or a corner of what the angle lets pass.
    sideways = np.linalg.norm(step - along[:, None] * normal, axis=1)
    # Nor does a closest point on the border of the other surface, off the foot of the perpendicular.
    across = np.linalg.norm(np.cross(step, other.surface.normals[foot.triangle]), axis=1)
    tie = _tie(sampled, other)
    with np.errstate(invalid="ignore"):
        good = (
            (foot.triangle >= 0)
            & (np.abs(along) <= reach + tie)
            & (sideways <= np.tan(max_angle) * np.abs(along) + SIDEWAYS * _thinner(sampled, other) + tie)
            & ~(foot.at_border & (across > 1e-3 * foot.distance + tie))
        )
    if other.disc is not None:
        centre, radius = other.disc
        good &= np.linalg.norm(foot.point - np.array(centre), axis=1) <= radius + tie
    return good, along


def _ranking(point, anchors, tie):
    """(n,) order of points by their distances from the first anchor, equal ones by those from the second, and so on."""
    keys = []
    for anchor in anchors:
        distance = np.linalg.norm(point - anchor, axis=1)
        order = np.argsort(distance)
        rank = np.empty(len(point), dtype=np.int64)
        rank[order] = np.concatenate([[0], np.cumsum(np.diff(distance[order]) > tie)])
        keys.append(rank)
        order = np.lexsort(keys[::-1])
        if (np.diff(np.array(keys)[:, order]) != 0).any(axis=0).all():  # no two are equal
            break
    return order


def _first(value, tie):
    """Index of the greatest value; the first of those that equal it."""
    return int(np.argmax(value >= np.max(value) - tie))


def _farthest(point, nearest, count, tie):
    """(count,) points one after the other, each the farthest from those before it and from what stands already.

    `nearest` (n,) is how far each point is from what stands already, mm. A point's distance can become less only within
    a ball about the chosen one, of the largest of these as radius: the more are chosen, the smaller it is.
    """
    tree, nearest, chosen = cKDTree(point), nearest.copy(), np.empty(max(count, 0), dtype=np.int64)
    for k in range(len(chosen)):
        chosen[k] = one = _first(nearest, tie)
        near = tree.query_ball_point(point[one], nearest[one] + 3 * tie)
        nearest[near] = np.minimum(nearest[near], np.linalg.norm(point[near] - point[one], axis=1))
    return chosen


def _nearest(centres, point, tie):
    """(n,) the centre nearest to each point; the first of those that are as near."""
    return _two_nearest(centres, point, tie)[0]


def _two_nearest(centres, point, tie):
    """As :func:`_nearest`, and how far the next one is at least (n,), mm."""
    tree, few = cKDTree(centres), min(len(centres), 2)
    distance, index = (table.reshape(len(point), few) for table in tree.query(point, few))
    nearest, beyond = index[:, 0], distance[:, 1] if few > 1 else np.full(len(point), np.inf)
    tied = np.flatnonzero(beyond <= distance[:, 0] + tie)
    if len(tied):
        count = min(len(centres), 8)
        distance, index = (table.reshape(len(tied), count) for table in tree.query(point[tied], count))
        nearest[tied] = np.where(distance <= distance[:, :1] + tie, index, len(centres)).min(1)
    return nearest, beyond


class _Cells:
    """Which centre each point is nearest to, as centres move: asked anew only where another may have come nearest."""

    def __init__(self, centres, point, tie):
        self._point, self._tie, self._centres = point, tie, centres
        self.of, self._beyond = _two_nearest(centres, point, tie)

    def move(self, centres) -> None:
        self._beyond -= np.linalg.norm(centres - self._centres, axis=1).max()
        away = np.linalg.norm(self._point - centres[self.of], axis=1)
        asked = np.flatnonzero(away + 2 * self._tie >= self._beyond)
        self.of[asked], self._beyond[asked] = _two_nearest(centres, self._point[asked], self._tie)
        self._centres = centres


def _centres(point, weight, count, tie, fixed):
    """Centres of `count` cells of about equal size, the `fixed` (k, 3) among them: farthest-point start, then Lloyd's
    iteration."""
    if len(fixed):
        centres = [*fixed]
    else:
        middle = np.average(point, axis=0, weights=weight)
        centres = [point[_first(np.linalg.norm(point - middle, axis=1), tie)]]
    nearest = cKDTree(np.array(centres)).query(point)[0]
    centres = np.array([*centres, *point[_farthest(point, nearest, count - len(centres), tie)]])
    cells = _Cells(centres, point, tie)
    for _ in range(50):
        cell = cells.of
        total = np.bincount(cell, weight, count)
        empty = total == 0  # one that stands upon others
        total[empty] = 1.0
        moved = np.column_stack([np.bincount(cell, weight * point[:, i], count) for i in range(3)]) / total[:, None]
        moved[empty] = centres[empty]
        moved[: len(fixed)] = fixed
        if np.linalg.norm(moved - centres, axis=1).max() < tie:
            break
        centres = moved
        cells.move(centres)
    return centres


def _tie(*bodies) -> float:
    return max(body.surface.tie for body in bodies)


def _thinner(*bodies) -> float:
    return min(body.thickness for body in bodies if not body.rigid)


def _nearest_part(cloud, sampled, other):
    """A cell, its points weighed by how near the surfaces are there; where they overlap they touch."""
    apart = np.maximum(cloud.distance - sampled.half_thickness - other.half_thickness, 0.0)
    share = np.maximum(1 - (apart - apart.min()) / (NEAR * _thinner(sampled, other)), 0.0)
    return replace(cloud, area=share * cloud.area)


def _pair(cloud, area, sampled, other, swap):
    weight = cloud.area / cloud.area.sum()
    n = weight @ cloud.normal
    if not np.linalg.norm(n) > 0.1:
        where = ", ".join(f"{x:.1f}" for x in weight @ cloud.point)
        raise ValueError(f"the surfaces pass through each other at ({where}); correct the meshes")
    n /= np.linalg.norm(n)
    apart = cloud.distance - sampled.half_thickness - other.half_thickness
    overlaps = apart < -max(sampled.surface.tie, other.surface.tie)
    sides = [
        int(np.sign(weight @ np.einsum("ij,j->i", body.surface.normals[triangle], n) * sign))
        for body, triangle, sign in ((sampled, cloud.triangle, 1), (other, cloud.other_triangle, -1))
    ]
    patches = [
        Patch(cloud.triangle, cloud.barycentric, weight),
        Patch(cloud.other_triangle, cloud.other_barycentric, weight),
    ]
    if swap:
        n, sides, patches = -n, sides[::-1], patches[::-1]
    return ContactPair(
        weight @ cloud.point,
        np.column_stack([n, np.zeros((3, 2))]),
        float(weight @ apart),
        float((-apart[overlaps]).max(initial=0.0)),
        float(weight[overlaps].sum()),
        float(area),
        tuple(patches),
        tuple(sides),
    )
