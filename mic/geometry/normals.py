"""Normals of a curved sheet at the corners of its triangles, estimated where nobody gives them.

A triangle mesh of a sheet with bends says little about its normals: across the line where a bend begins curvature
jumps, and the mean of the triangles around a point of that line bends the flat beside it. Each edge between two
triangles is therefore judged by its dihedral angle d and by what the sheet does on either side of it: b, the largest
dihedral angle of the edges that meet in the opposite corner of the triangle there, and of those of that triangle's
neighbours that do not go on along the edge; folds are left out. Where the sheet ends in that corner along the edge, by
a border or a junction of more than two sheets, nobody knows what b would be, and it hinders nothing:

=======  ============================================================================================================
smooth   d is small, or no more than three times the smaller b: the sheet curves on both sides alike
jump     d is no more than three times the larger b, if both are known: one side is flatter by far, and a bend begins
fold     the rest: both sides are flat, or d is beyond any bend; so are edges whose two triangles disagree which side
         is up, and edges where more than two sheets meet
=======  ============================================================================================================

The triangles around a point that hang together by smooth edges are a *fan*. A quadratic fitted to the points around
gives the fan's normal. Fans that meet in a jump have one normal, that of the flattest; those that meet in a fold keep
their own. Where the outcome lies farther than `GUARD` from the triangle's own normal, the triangle's own is taken: a
wrong normal does more harm than none.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

__all__ = ["COARSE", "GUARD", "CornerNormals", "Rule", "corner_normals"]

GUARD = 30.0  # degrees between an estimated normal and the triangle's own: a triangle between two edges of `_FOLD`
GIVEN_GUARD = 60.0  # degrees; a given normal beyond belongs to another sheet
COARSE = 40.0  # degrees from triangle to triangle beyond which a bend is too coarse to be told from a fold

_SMALL = 2.0  # degrees: any sheet of this dihedral is smooth
_FOLD = 60.0  # degrees: any sheet of that one is folded
_UNTOLD = 20.0  # degrees: likewise where both triangles end at a border, and neither side tells
_ALIKE = 3.0  # dihedral angles within this ratio are of one curve
_WIDE = 2.0  # triangles whose heights over their edge differ by more belong to a bend and to what it ends in
_ALONG = np.cos(np.radians(45)) * (1 - 1e-6)  # a border at a smaller angle runs along an edge
_ON = np.cos(np.radians(25)) * (1 - 1e-6)  # edges at a smaller angle are pieces of one line
_EQUAL = 1e-6  # ratios that differ by less are equal: rounding decides nothing
_DETERMINED = (
    0.01  # least singular value of a quadratic fit, as a share of the largest; the mean of triangles errs far more
)


class Rule(IntEnum):
    """What decided a normal."""

    GIVEN = 0  #: the geometry or the deck
    FITTED = 1  #: a quadratic through the points around
    FLATTER = 2  #: the flatter sheet beside the line where a bend begins
    TRIANGLE = 3  #: the triangle's own: the sheet is flat there
    GUARDED = 4  #: the triangle's own: what was given or estimated lies too far from it


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
        use = np.abs(cosine) > np.cos(np.radians(GIVEN_GUARD))
        normal[use] = (np.sign(cosine)[..., None] * told)[use]
        decided = (length > 0)[..., 0]
        rule[decided] = np.where(use, Rule.GIVEN, Rule.GUARDED)[decided]
        if decided.all():
            return CornerNormals(normal, rule, np.zeros((0, 3)), np.zeros((0, 3)))
    edges = _Edges(points, triangles, own[:, 0])
    estimate, taken = _estimate(points, triangles, own[:, 0], edges)
    near = (estimate * own).sum(axis=2) >= np.cos(np.radians(GUARD)) - _EQUAL
    flat = ((estimate - own) ** 2).sum(axis=2) < _EQUAL**2
    taken = np.where(near, np.where(flat, Rule.TRIANGLE, taken), Rule.GUARDED)
    normal[~decided & near], rule[~decided] = estimate[~decided & near], taken[~decided]
    middle = 0.5 * (corners[:, [1, 2, 0]] + corners[:, [2, 0, 1]])
    bent = (edges.smooth | edges.jump) & edges.first
    return CornerNormals(
        normal,
        rule,
        middle[bent & (edges.dihedral > COARSE)],
        middle[edges.smooth & edges.first & (edges.dihedral > COARSE / 4) & (edges.widths > _WIDE * (1 + _EQUAL))],
    )


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
    smooth, jump, first : (k, 3) bool array
        What the edge is; and whether this triangle's entry stands for both.
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
        self.beyond = beyond.reshape(k, 3)
        here, there = beyond, np.where(has, beyond[across], 0.0)
        low, high = np.minimum(here, there), np.maximum(here, there)
        alike = dihedral * (1 - _EQUAL) <= _ALIKE * np.stack([low, high])
        small = dihedral < _SMALL * (1 + _EQUAL)
        able = dihedral < np.where(np.isinf(low), _UNTOLD, _FOLD) * (1 - _EQUAL)
        smooth = has & (small | (able & alike[0]))
        self.smooth = smooth.reshape(k, 3)
        self.jump = (has & ~smooth & able & alike[1] & np.isfinite(high)).reshape(k, 3)


def _estimate(points, triangles, own, edges):
    """(k, 3, 3) estimated normals, and the (k, 3) rule of each."""
    k = len(triangles)
    smooth = _pairs(triangles, edges, edges.smooth)
    joined = np.concatenate([smooth, _pairs(triangles, edges, edges.jump)])
    (n_fans, fan), (n_unions, union) = (_components(pairs, 3 * k) for pairs in (smooth, joined))
    normal = _fitted(points, triangles, own, fan, n_fans)

    # How bent a fan is: what the sheet does on its side of the jumps that end in its point, in the mean.
    f, c = np.nonzero(edges.jump)
    at = np.concatenate([fan[3 * f + (c + 1) % 3], fan[3 * f + (c + 2) % 3]])
    jumps = np.bincount(at, minlength=n_fans)
    bent = np.bincount(at, np.tile(edges.beyond[f, c], 2), n_fans) / np.maximum(jumps, 1)
    of_fan = np.empty(n_fans, dtype=np.int64)
    of_fan[fan] = union
    order = np.lexsort((bent, of_fan))
    first = order[np.r_[True, of_fan[order][1:] != of_fan[order][:-1]]]  # the flattest of each union
    fans = np.bincount(of_fan, minlength=n_unions)
    equal = np.bincount(of_fan, bent <= (1 + _EQUAL) * bent[first][of_fan], n_unions)
    decided = (fans > 1) & (equal == 1)  # of several that are equally flat none has a say over the others
    leader = np.where(decided[of_fan], first[of_fan], np.arange(n_fans))
    rule = np.where(leader == np.arange(n_fans), Rule.FITTED, Rule.FLATTER)
    return normal[leader[fan]].reshape(k, 3, 3), rule[fan].reshape(k, 3)


def _pairs(triangles, edges, mask):
    """(p, 2) corners, 3 f + c, that are the same point on either side of the edges."""
    f, c = np.nonzero(mask & edges.first)
    g, e = np.divmod(edges.across[3 * f + c], 3)
    # the neighbour runs along the edge the other way
    one = np.column_stack([3 * f + (c + 1) % 3, 3 * g + (e + 2) % 3])
    other = np.column_stack([3 * f + (c + 2) % 3, 3 * g + (e + 1) % 3])
    return np.concatenate([one, other])


def _components(pairs, count):
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)


def _fitted(points, triangles, own, fan, n_fans):
    """(n_fans, 3) normals: of the quadratic that fits the points around, in one ring where that determines it, else in
    two, else the mean of the triangles by their angles."""
    k, corners = len(triangles), points[triangles]
    vertex = np.empty(n_fans, dtype=np.int64)
    vertex[fan] = triangles.ravel()
    a, b = (_unit(np.roll(corners, -step, axis=1) - corners) for step in (1, 2))
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=2), (a * b).sum(axis=2))
    mean = _unit(csr_matrix((angle.ravel(), (fan, np.repeat(np.arange(k), 3))), shape=(n_fans, k)) @ own)
    touch = csr_matrix((np.ones(3 * k), (fan, np.repeat(np.arange(k), 3))), shape=(n_fans, k))
    ring = touch @ touch.T
    fitted = mean.copy()
    for near, least in ((ring @ ring, 5), (ring, 6)):  # the smaller ring overrides
        near = near.tocoo()
        i, q = near.row.astype(np.int64), vertex[near.col]
        i, q = np.divmod(np.unique((i * len(points) + q)[q != vertex[i]]), len(points))
        e = _unit(np.cross(mean, np.eye(3)[np.argmin(np.abs(mean), axis=1)]))
        f, offset = np.cross(mean, e), points[q] - points[vertex[i]]
        count = np.bincount(i, minlength=n_fans)
        scale = np.sqrt(np.bincount(i, (offset**2).sum(axis=1), n_fans) / np.maximum(count, 1))
        scale[count == 0] = 1.0
        u, v, w = ((offset * axis[i]).sum(axis=1) / scale[i] for axis in (e, f, mean))
        # The factors of the three quadratic terms make the columns turn with e and f, so that the choice of e is free.
        A = np.column_stack([u, v, u * u / 2, u * v / np.sqrt(2), v * v / 2])
        weight = 1 / (u * u + v * v + 1e-6) ** 2
        gather = csr_matrix((np.ones(len(i)), (i, np.arange(len(i)))), shape=(n_fans, len(i)))
        M = (gather @ (A[:, :, None] * (A * weight[:, None])[:, None]).reshape(-1, 25)).reshape(-1, 5, 5)
        B = gather @ (A * (w * weight)[:, None])
        spectrum = np.linalg.eigvalsh(M)
        sound = (spectrum[:, 0] > _DETERMINED**2 * spectrum[:, -1]) & (count >= least)
        slope = np.linalg.solve(M[sound], B[sound][..., None])[..., 0]
        fitted[sound] = _unit(mean[sound] - slope[:, :1] * e[sound] - slope[:, 1:2] * f[sound])
    return fitted


def _unit(vector):
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)
