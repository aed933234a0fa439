"""Normals of a curved sheet at the corners of its triangles, estimated where none are given.

The mesh of a sheet with bends does not show where a bend begins: the curvature jumps there, and a mean or a fit over
the adjacent triangles would bend the flat beside it. But bends begin along edges, and the normal is continuous across
them. Along an edge of one smooth piece, L = x_j − x_i, the sheet bends equally towards both ends, L · n_i = −L · n_j:
exactly if the edge is the chord of an arc, to leading order on every quadratic surface. The normals are therefore the
least-squares solution of

    Σ_edges (L · (n_i + n_j)/|L|)² + `_PULL`² Σ |n_i − n_i⁰|² → min,

which is exact for flats, cylinders and spheres that meet tangentially along edges, in one row of triangles or many. The
first sum is insensitive to normals that alternate from row to row; the second decides there. The minimisation is
repeated `_ROUNDS` times from the last result. At first n⁰ is the mean of the adjacent triangles weighted by their
angles. At borders, where this mean leans inwards, it is extrapolated along arcs from interior points. Flats of three or
more rows are recognised first and have one normal up to their ends.

There is one normal for the triangles around a point that are connected by smooth edges. With d the dihedral angle of an
edge, and b the largest dihedral angle of the sheet on its sides, an edge is

======  =============================================================================================================
smooth  if d is small, or at most three times b
fold    otherwise: both sides are flat, or d is larger than in any bend; also edges whose two triangles have
        inconsistent orientation, and edges of more than two triangles
======  =============================================================================================================

On each side b is the largest dihedral angle of the edges at the opposite corner of the triangle and of those of its
neighbours that do not continue the edge; folds are excluded. If the sheet ends in that corner along the edge, at a
border or a junction, b is unknown there and the other side alone decides.

A given or estimated normal farther than `GUARD` from the triangle's own is replaced by the triangle's own, because a
wrong normal does more harm than none.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy.sparse import csr_matrix, identity, vstack
from scipy.sparse.linalg import lsmr

from mic.geometry.triangles import area_vectors, components, paired_sides, sides, unit

__all__ = ["COARSE", "GUARD", "CornerNormals", "Rule", "corner_normals"]

GUARD = 60.0  # degrees: largest angle between a normal and the triangle's own
COARSE = 40.0  # degrees between triangles above which a bend is hard to distinguish from a fold

_SMALL = 2.0  # degrees: smaller dihedral angles are always smooth
_FOLD = 60.0  # degrees: larger dihedral angles are always folds
_UNKNOWN_FOLD = 20.0  # degrees: the same if b is unknown on both sides
_ALIKE = 3.0  # largest ratio of the dihedral angles of one bend
_WIDE = 2.0  # ratio of heights above which a bend may end at the edge
_ALONG = np.cos(np.radians(45)) * (1 - 1e-6)  # cosine: a border at a smaller angle continues an edge
_ON = np.cos(np.radians(25)) * (1 - 1e-6)  # cosine: edges at a smaller angle form one line
_EQUAL = 1e-6  # relative difference below which ratios are equal
_PULL, _ROUNDS = 0.1, 8  # fewer rounds distort jittered meshes; a single round with 0.02 tilts normals of curved bends
_STEPS, _STILL = 8, 1e-9  # most Gauss-Newton steps per round; radians, step at convergence
_ROUGH = 1e-10  # relative tolerance of the linear solver


class Rule(IntEnum):
    """Origin of a normal."""

    GIVEN = 0  #: by the geometry script or the deck
    ESTIMATED = 1  #: from the adjacent edges
    TRIANGLE = 2  #: the triangle's own, on a flat
    GUARDED = 3  #: the triangle's own; the given or estimated one is farther than `GUARD`


@dataclass(frozen=True)
class CornerNormals:
    """Normals at the corners of k triangles.

    Attributes
    ----------
    normal : (k, 3, 3) array
        Unit normals on the side of the triangle's own, by corner.
    rule : (k, 3) int array
        `Rule` of each.
    coarse : (m, 3) array
        Midpoints of smooth edges, mm, at which the sheet turns by more than `COARSE`.
    single : (m, 3) array
        Midpoints of edges, mm, at which a bend meets a single much wider row of triangles, which may be flat or bent.
    """

    normal: np.ndarray
    rule: np.ndarray
    coarse: np.ndarray
    single: np.ndarray


def corner_normals(points: np.ndarray, triangles: np.ndarray, given: np.ndarray | None = None) -> CornerNormals:
    """Given normals, and estimates for the others.

    Parameters
    ----------
    points : (n, 3) array
        mm.
    triangles : (k, 3) int array
        Consistently oriented, as by `mic.geometry.repair`.
    given : (k, 3, 3) array, optional
        Either sense, any length; NaN or zero where unknown.
    """
    corners = points[triangles]
    own = unit(area_vectors(corners))[:, None]
    normal = np.broadcast_to(own, corners.shape).copy()
    rule = np.full(triangles.shape, Rule.TRIANGLE, dtype=np.int8)
    decided = np.zeros(triangles.shape, dtype=bool)
    if given is not None:
        length = np.linalg.norm(given, axis=2, keepdims=True)
        direction = np.divide(given, length, out=np.zeros_like(corners), where=length > 0)
        cosine = (direction * own).sum(axis=2)
        use = np.abs(cosine) > np.cos(np.radians(GUARD))
        normal[use] = (np.sign(cosine)[..., None] * direction)[use]
        decided = (length > 0)[..., 0]
        rule[decided] = np.where(use, Rule.GIVEN, Rule.GUARDED)[decided]
        if decided.all():
            return CornerNormals(normal, rule, np.zeros((0, 3)), np.zeros((0, 3)))
    edges = _Edges(points, triangles, own[:, 0])
    estimate = _estimate(points, triangles, own[:, 0], edges)
    near = (estimate * own).sum(axis=2) >= np.cos(np.radians(GUARD)) - _EQUAL
    flat = ((estimate - own) ** 2).sum(axis=2) < _EQUAL**2
    taken = np.where(near, np.where(flat, Rule.TRIANGLE, Rule.ESTIMATED), Rule.GUARDED)
    normal[~decided & near], rule[~decided] = estimate[~decided & near], taken[~decided]
    middle = 0.5 * (corners[:, [1, 2, 0]] + corners[:, [2, 0, 1]])
    bent = edges.smooth & edges.first
    wide = edges.alike & (edges.dihedral > COARSE / 4) & (edges.widths > _WIDE * (1 + _EQUAL))
    return CornerNormals(normal, rule, middle[bent & (edges.dihedral > COARSE)], middle[bent & wide])


class _Edges:
    """Edges of triangles; entry [f, c] is the edge of triangle f opposite to its corner c.

    Attributes
    ----------
    across : (3 k,) int array
        Entry 3 f + c of the same edge in the triangle on the other side; -1 if none.
    neighbour : (k, 3) int array
        Triangle on the other side; -1 at borders, junctions and inconsistent orientation.
    dihedral : (k, 3) array
        Degrees.
    smooth, alike, first : (k, 3) bool array
        Whether the edge is no fold; whether the sheet bends on both sides within the ratio `_ALIKE`; and whether this
        entry represents both triangles.
    widths : (k, 3) array
        Ratio of the two triangles' heights over the edge, at least 1.
    """

    def __init__(self, points, triangles, own):
        k, me = len(triangles), np.arange(len(triangles))
        start, end = triangles[:, [1, 2, 0]], triangles[:, [2, 0, 1]]
        pair = paired_sides(*sides(triangles)[1:])
        forward = (start < end).ravel()
        pair = pair[forward[pair[:, 0]] != forward[pair[:, 1]]]
        across = np.full(3 * k, -1)
        across[pair[:, 0]], across[pair[:, 1]] = pair[:, 1], pair[:, 0]
        has = across >= 0
        triangle = np.where(has, across // 3, 0)
        cosine = (own[np.repeat(me, 3)] * own[triangle]).sum(axis=1)
        sine = np.linalg.norm(np.cross(own[np.repeat(me, 3)], own[triangle]), axis=1)
        dihedral = np.where(has, np.degrees(np.arctan2(sine, cosine)), 0.0)
        corners = points[triangles]
        height = np.linalg.norm(area_vectors(corners), axis=1)[:, None]
        height = (height / np.linalg.norm(points[start] - points[end], axis=2)).ravel()
        widths = np.where(has, np.maximum(height / height[across], height[across] / height), 1.0)
        self.across = across
        self.neighbour = np.where(has, triangle, -1).reshape(k, 3)
        self.dihedral, self.widths = dihedral.reshape(k, 3), widths.reshape(k, 3)
        self.first = (has & (np.arange(3 * k) < across)).reshape(k, 3)

        # b: the largest dihedral angle on the edge's side, without edges that continue the edge
        bent, inside = np.zeros(len(points)), has.reshape(k, 3)
        bend = np.where(self.dihedral < _FOLD, self.dihedral, 0.0)
        for end_of_edge in (start, end):
            np.maximum.at(bent, end_of_edge.ravel(), bend.ravel())
        direction = unit(points[end] - points[start])
        beyond = bent[triangles]
        for c in range(3):
            for other in ((c + 1) % 3, (c + 2) % 3):
                g, there = self.neighbour[:, other], has.reshape(k, 3)[:, other]
                for e in range(3):
                    off = np.abs((direction[g, e] * direction[:, c]).sum(axis=1)) <= _ON
                    beyond[:, c] = np.maximum(beyond[:, c], np.where(there & off, bend[g, e], 0.0))
        beyond = beyond.ravel()
        rim = np.column_stack([np.flatnonzero(~has)] * 2).ravel()
        at = np.column_stack([start[~inside], end[~inside]]).ravel()
        touch = csr_matrix((np.ones(len(at)), (at, np.arange(len(at)))), shape=(len(points), len(at)))[
            triangles.ravel()
        ]
        corner, which = touch.nonzero()
        along = np.abs((direction.reshape(-1, 3)[rim[which]] * direction.reshape(-1, 3)[corner]).sum(axis=1)) > _ALONG
        beyond[corner[along]] = np.inf
        # A corner with at most one edge of two triangles (each counts twice) provides little information; it is used
        # only if the other side provides no more.
        rich = np.bincount(np.concatenate([start[inside], end[inside]]), minlength=len(points)) > 2
        rich = rich[triangles].ravel()
        beyond[has & ~rich & rich[across]] = np.inf
        here, there = beyond, np.where(has, beyond[across], 0.0)
        low, high = np.minimum(here, there), np.maximum(here, there)
        bend_angle = np.where(np.isinf(high), low, high)
        small = dihedral < _SMALL * (1 + _EQUAL)
        able = dihedral < np.where(np.isinf(low), _UNKNOWN_FOLD, _FOLD) * (1 - _EQUAL)
        smooth = has & (small | (able & (dihedral * (1 - _EQUAL) <= _ALIKE * bend_angle)))
        self.smooth = smooth.reshape(k, 3)
        self.alike = (smooth & (dihedral * (1 - _EQUAL) <= _ALIKE * low)).reshape(k, 3)


def _estimate(points, triangles, own, edges):
    """(k, 3, 3) estimated normals."""
    k = len(triangles)
    same = _pairs(triangles, edges)
    count, joined = components(*same.T, 3 * k)
    fan = joined.reshape(k, 3)

    # the fans at both ends of each edge; a smooth edge appears once
    ends = np.concatenate([fan[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    chord = np.concatenate([points[triangles[:, b]] - points[triangles[:, a]] for a, b in ((0, 1), (1, 2), (2, 0))])
    ends, first = np.unique(np.sort(ends, axis=1), axis=0, return_index=True)
    chord = unit(chord[first])

    corner = np.repeat(np.arange(k), 3)
    corners = points[triangles]
    a, b = (unit(np.roll(corners, -step, axis=1) - corners) for step in (1, 2))
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=2), (a * b).sum(axis=2)).ravel()
    start = _mean(joined, angle[:, None] * own[corner], count)
    whole = np.bincount(joined[same[:, 0]], minlength=count) == np.bincount(joined, minlength=count)
    # A triangle belongs to a flat if all triangles at its three points are coplanar; two coplanar rows may be an
    # inflection between two bends. The flat's normal extends to all corners in it, unless two flats share a point.
    plane = whole & ~_differ(joined, own[corner], start)
    known = np.zeros(count, dtype=bool)
    known[fan[plane[fan].all(axis=1)]] = True
    while True:
        lies = known[fan] & (np.abs(start[fan] - own[:, None]).max(axis=2) < _EQUAL)
        rim = np.flatnonzero(lies.any(axis=1)[corner] & ~known[joined])
        led = _mean(joined[rim], own[corner[rim]], count)
        new = np.setdiff1d(joined[rim], np.flatnonzero(_differ(joined[rim], own[corner[rim]], led)))
        if not len(new):
            break
        known[new], start[new] = True, led[new]
    # The mean of the adjacent triangles is a good start in the interior; at borders arcs extrapolate from the interior.
    at, to = (np.concatenate([ends[:, i], ends[:, 1 - i]]) for i in (0, 1))
    arc = np.flatnonzero((whole | known)[at] & ~(whole | known)[to])
    along = np.concatenate([chord, chord])[arc]
    led = _mean(to[arc], start[at[arc]] - 2 * (start[at[arc]] * along).sum(axis=1, keepdims=True) * along, count)
    start[to[arc]] = led[to[arc]]

    free = np.flatnonzero(~known)
    unknown = np.cumsum(~known) - 1
    edge, end = np.nonzero(~known[ends])
    who = unknown[ends[edge, end]]
    normal = start
    for _ in range(_ROUNDS if len(free) else 0):
        start, held = normal[free], _PULL * identity(2 * len(free))
        normal = normal.copy()
        for _ in range(_STEPS):
            n = normal[free]
            e = unit(np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=1)]))
            axes = np.stack([e, np.cross(n, e)], axis=1)
            slope = np.einsum("qac,qc->qa", axes[who], chord[edge])
            place = np.repeat(edge, 2), (2 * who[:, None] + [0, 1]).ravel()
            bend = csr_matrix((slope.ravel(), place), shape=(len(ends), 2 * len(free)))
            turn = (chord * normal[ends].sum(axis=1)).sum(axis=1)
            back = _PULL * np.einsum("qac,qc->qa", axes, start - n).ravel()
            step = lsmr(vstack([bend, held]), np.concatenate([-turn, back]), atol=_ROUGH, btol=_ROUGH)[0]
            normal[free] = unit(n + np.einsum("qa,qac->qc", step.reshape(-1, 2), axes))
            if np.abs(step).max() < _STILL:
                break
    return normal[fan]


def _pairs(triangles, edges):
    """(p, 2) corners, 3 f + c, that are the same point on both sides of smooth edges."""
    f, c = np.nonzero(edges.smooth & edges.first)
    g, e = np.divmod(edges.across[3 * f + c], 3)
    # the neighbour traverses the edge in the opposite direction
    one = np.column_stack([3 * f + (c + 1) % 3, 3 * g + (e + 2) % 3])
    other = np.column_stack([3 * f + (c + 2) % 3, 3 * g + (e + 1) % 3])
    return np.concatenate([one, other])


def _mean(group, vector, count):
    """(count, 3) unit vectors along the sums of the vectors (q, 3) of each group; NaN for an empty group."""
    total = np.column_stack([np.bincount(group, vector[:, c], count) for c in range(3)])
    with np.errstate(invalid="ignore"):
        return unit(total)


def _differ(group, vector, mean):
    """(count,) bool: whether the vectors (q, 3) of a group differ from their mean."""
    far = np.abs(vector - mean[group]).max(axis=1) > _EQUAL
    return np.bincount(group, far, len(mean)) > 0
