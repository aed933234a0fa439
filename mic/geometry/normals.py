"""Normals of a curved sheet at the corners of its triangles, estimated where nobody gives them.

The mesh of a sheet with bends does not show the line where a bend begins: curvature jumps there, and a mean or a fit of
the triangles around bends the flat beside it. But bends begin along edges, and across them the normal goes on. Along an
edge of one smooth piece, L = x_j − x_i, the sheet bends alike towards both ends, L · n_i = −L · n_j: exactly where the
edge is an arc, to leading order on every quadratic surface. The normals are therefore the least squares

    Σ_edges (L · (n_i + n_j)/|L|)² + `_PULL`² Σ |n_i − n_i⁰|² → min,

which finds flats, cylinders and balls that meet tangentially along edges, in one row of triangles or many. The first
sum is blind to normals that tip to and fro from row to row; there the second decides. `_ROUNDS` times it begins where
the last round ended. At first n⁰ is the mean of the triangles around by their angles; at borders, where that leans
inwards, it is what arcs from the points inside lead to. Flats of three rows or more are seen at once, and have one
normal to their ends.

One normal is sought for the triangles around a point that hang together by edges that are no folds. By d, the dihedral
angle of an edge, and b, the largest dihedral angle of what the sheet does on its sides, an edge is

======  =============================================================================================================
smooth  d is small, or no more than three times b
fold    the rest: both sides are flat, or d is beyond any bend; so are edges whose two triangles disagree which side
        is up, and edges where more than two sheets meet
======  =============================================================================================================

On each side that is the largest dihedral angle of the edges that meet in the opposite corner of the triangle there, and
of those of that triangle's neighbours that do not go on along the edge; folds are left out. Where the sheet ends in
that corner along the edge, by a border or a junction of more than two sheets, nobody knows what it would be, and the
other side alone decides.

Where the outcome, or what is given, lies farther than `GUARD` from the triangle's own normal, the triangle's own is
taken: a wrong normal does more harm than none.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, identity, vstack
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import lsmr

__all__ = ["COARSE", "GUARD", "CornerNormals", "Rule", "corner_normals"]

GUARD = 60.0  # degrees between a normal and the triangle's own; beyond, it belongs to another sheet
COARSE = 40.0  # degrees from triangle to triangle beyond which a bend is too coarse to be told from a fold

_SMALL = 2.0  # degrees: any sheet of this dihedral is smooth
_FOLD = 60.0  # degrees: any sheet of that one is folded
_UNTOLD = 20.0  # degrees: likewise where both triangles end at a border, and neither side tells
_ALIKE = 3.0  # dihedral angles within this ratio are of one curve
_WIDE = 2.0  # triangles whose heights over their edge differ by more belong to a bend and to what it ends in
_ALONG = np.cos(np.radians(45)) * (1 - 1e-6)  # a border at a smaller angle runs along an edge
_ON = np.cos(np.radians(25)) * (1 - 1e-6)  # edges at a smaller angle are pieces of one line
_EQUAL = 1e-6  # ratios that differ by less are equal: rounding decides nothing
_PULL, _ROUNDS = 0.1, 8  # after few rounds jittered sheets keep a stretch; pulled by 0.02 at once, arched bends tip
_STEPS, _STILL = 8, 1e-9  # of Gauss and Newton in each round at most; radians, a step that ends it
_ROUGH = 1e-10  # relative error of a step: rounding is not to show in what follows


class Rule(IntEnum):
    """What decided a normal."""

    GIVEN = 0  #: the geometry or the deck
    ESTIMATED = 1  #: the edges around
    TRIANGLE = 2  #: the triangle's own: the sheet is flat there
    GUARDED = 3  #: the triangle's own: what was given or estimated lies too far from it


@dataclass(frozen=True)
class CornerNormals:
    """Normals at the corners of k triangles.

    Attributes
    ----------
    normal : (k, 3, 3) array
        Unit normals on the side of the triangle's own, corner by corner.
    rule : (k, 3) int array
        The `Rule` that decided each.
    coarse : (m, 3) array
        Middles of the edges, mm, that count as curved though the sheet turns by more than `COARSE` there.
    single : (m, 3) array
        Middles of the edges, mm, where a bend meets a much wider row of triangles: whether that row is flat, or goes on
        as the bend does, one row cannot tell.
    """

    normal: np.ndarray
    rule: np.ndarray
    coarse: np.ndarray
    single: np.ndarray


def corner_normals(points: np.ndarray, triangles: np.ndarray, given: np.ndarray | None = None) -> CornerNormals:
    """The normals that are given, and estimates for the others.

    Parameters
    ----------
    points : (n, 3) array
        mm.
    triangles : (k, 3) int array
        Consistently oriented, as `mic.geometry.repair` leaves them.
    given : (k, 3, 3) array, optional
        On either side and of any length; NaN or zero where nothing is told.
    """
    corners = points[triangles]
    own = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))[:, None]
    normal = np.broadcast_to(own, corners.shape).copy()
    rule = np.full(triangles.shape, Rule.TRIANGLE, dtype=np.int8)
    decided = np.zeros(triangles.shape, dtype=bool)
    if given is not None:
        length = np.linalg.norm(given, axis=2, keepdims=True)
        told = np.divide(given, length, out=np.zeros_like(corners), where=length > 0)
        cosine = (told * own).sum(axis=2)
        use = np.abs(cosine) > np.cos(np.radians(GUARD))
        normal[use] = (np.sign(cosine)[..., None] * told)[use]
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
    """Edges of triangles; entry [f, c] is that of triangle f opposite to its corner c.

    Attributes
    ----------
    neighbour : (k, 3) int array
        Triangle on the other side; -1 at borders and junctions, and where the two disagree which side is up.
    dihedral : (k, 3) array
        Degrees.
    beyond : (k, 3) array
        What the sheet does on the triangle's side of the edge, degrees; infinite where nobody knows.
    smooth, alike, first : (k, 3) bool array
        Whether the edge is no fold; whether the sheet bends on either side of it, and within `_ALIKE` of it; and
        whether this triangle's entry stands for both.
    widths : (k, 3) array
        Ratio of the two triangles' heights over the edge, at least 1.
    """

    def __init__(self, points, triangles, own):
        k, me = len(triangles), np.arange(len(triangles))
        start, end = triangles[:, [1, 2, 0]], triangles[:, [2, 0, 1]]
        pair = np.stack([np.minimum(start, end), np.maximum(start, end)], axis=2).reshape(-1, 2)
        edge, count = np.unique(pair, axis=0, return_inverse=True, return_counts=True)[1:]
        edge = edge.ravel()
        sides = np.flatnonzero(count[edge] == 2)
        sides = sides[np.argsort(edge[sides], kind="stable")].reshape(-1, 2)
        forward = (start < end).ravel()
        sides = sides[forward[sides[:, 0]] != forward[sides[:, 1]]]
        across = np.full(3 * k, -1)
        across[sides[:, 0]], across[sides[:, 1]] = sides[:, 1], sides[:, 0]
        has = across >= 0
        triangle = np.where(has, across // 3, 0)
        cosine = (own[np.repeat(me, 3)] * own[triangle]).sum(axis=1)
        sine = np.linalg.norm(np.cross(own[np.repeat(me, 3)], own[triangle]), axis=1)
        dihedral = np.where(has, np.degrees(np.arctan2(sine, cosine)), 0.0)
        corners = points[triangles]
        height = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)[:, None]
        height = (height / np.linalg.norm(points[start] - points[end], axis=2)).ravel()
        widths = np.where(has, np.maximum(height / height[across], height[across] / height), 1.0)
        self.across = across  # number 3 f + c of the same edge in the triangle on the other side
        self.neighbour = np.where(has, triangle, -1).reshape(k, 3)
        self.dihedral, self.widths = dihedral.reshape(k, 3), widths.reshape(k, 3)
        self.first = (has & (np.arange(3 * k) < across)).reshape(k, 3)

        # What the sheet does on the edge's side. The line that the edge may be a piece of says nothing of that.
        bent, inside = np.zeros(len(points)), has.reshape(k, 3)
        bend = np.where(self.dihedral < _FOLD, self.dihedral, 0.0)
        for end_of_edge in (start, end):
            np.maximum.at(bent, end_of_edge.ravel(), bend.ravel())
        direction = _unit(points[end] - points[start])
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
        # A corner in which one edge at most has two sides (each counts twice) tells little, and is heard only where the
        # other side tells no more.
        rich = np.bincount(np.concatenate([start[inside], end[inside]]), minlength=len(points)) > 2
        rich = rich[triangles].ravel()
        beyond[has & ~rich & rich[across]] = np.inf
        here, there = beyond, np.where(has, beyond[across], 0.0)
        low, high = np.minimum(here, there), np.maximum(here, there)
        told = np.where(np.isinf(high), low, high)
        small = dihedral < _SMALL * (1 + _EQUAL)
        able = dihedral < np.where(np.isinf(low), _UNTOLD, _FOLD) * (1 - _EQUAL)
        smooth = has & (small | (able & (dihedral * (1 - _EQUAL) <= _ALIKE * told)))
        self.smooth = smooth.reshape(k, 3)
        self.alike = (smooth & (dihedral * (1 - _EQUAL) <= _ALIKE * low)).reshape(k, 3)


def _estimate(points, triangles, own, edges):
    """(k, 3, 3) estimated normals."""
    k = len(triangles)
    same = _pairs(triangles, edges)
    graph = coo_matrix((np.ones(len(same)), (same[:, 0], same[:, 1])), shape=(3 * k, 3 * k))
    count, joined = connected_components(graph, directed=False)
    fan = joined.reshape(k, 3)

    # both ends of each edge, once for the triangles on either side of a smooth edge, by the fans there
    ends = np.concatenate([fan[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    chord = np.concatenate([points[triangles[:, b]] - points[triangles[:, a]] for a, b in ((0, 1), (1, 2), (2, 0))])
    ends, first = np.unique(np.sort(ends, axis=1), axis=0, return_index=True)
    chord = _unit(chord[first])

    corner = np.repeat(np.arange(k), 3)
    sides = points[triangles]
    a, b = (_unit(np.roll(sides, -step, axis=1) - sides) for step in (1, 2))
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=2), (a * b).sum(axis=2)).ravel()
    start = _mean(joined, angle[:, None] * own[corner], count)
    whole = np.bincount(joined[same[:, 0]], minlength=count) == np.bincount(joined, minlength=count)
    # A flat is seen where three points of a triangle have all their triangles in one plane; two rows in one plane may
    # be the inflection between two bends. Its normal goes on to all corners in it, unless two flats end in one point.
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
    # All around a point the mean of triangles is a good start. At borders it is not; arcs lead there from inside.
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
            e = _unit(np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=1)]))
            axes = np.stack([e, np.cross(n, e)], axis=1)
            slope = np.einsum("qac,qc->qa", axes[who], chord[edge])
            place = np.repeat(edge, 2), (2 * who[:, None] + [0, 1]).ravel()
            bend = csr_matrix((slope.ravel(), place), shape=(len(ends), 2 * len(free)))
            turn = (chord * normal[ends].sum(axis=1)).sum(axis=1)
            back = _PULL * np.einsum("qac,qc->qa", axes, start - n).ravel()
            step = lsmr(vstack([bend, held]), np.concatenate([-turn, back]), atol=_ROUGH, btol=_ROUGH)[0]
            normal[free] = _unit(n + np.einsum("qa,qac->qc", step.reshape(-1, 2), axes))
            if np.abs(step).max() < _STILL:
                break
    return normal[fan]


def _pairs(triangles, edges):
    """(p, 2) corners, 3 f + c, that are the same point on either side of smooth edges."""
    f, c = np.nonzero(edges.smooth & edges.first)
    g, e = np.divmod(edges.across[3 * f + c], 3)
    # the neighbour runs along the edge the other way
    one = np.column_stack([3 * f + (c + 1) % 3, 3 * g + (e + 2) % 3])
    other = np.column_stack([3 * f + (c + 2) % 3, 3 * g + (e + 1) % 3])
    return np.concatenate([one, other])


def _mean(group, vector, count):
    """(count, 3) unit vectors along the sums of those (q, 3) that belong to each group; NaN where none does."""
    total = np.column_stack([np.bincount(group, vector[:, c], count) for c in range(3)])
    with np.errstate(invalid="ignore"):
        return _unit(total)


def _differ(group, vector, mean):
    """(count,) bool: whether the vectors (q, 3) of a group differ from their mean."""
    far = np.abs(vector - mean[group]).max(axis=1) > _EQUAL
    return np.bincount(group, far, len(mean)) > 0


def _unit(vector):
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)
