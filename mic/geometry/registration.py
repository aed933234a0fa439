"""Registration of scanned points to a nominal sheet, together with the shape of the scanned piece.

A point p of the scan lies at ``R p + t`` in the coordinates of the drawing. The sheet may have the shapes

    x(a) = x + φ_0(x) + Σ_k a_k φ_k(x),        a ~ N(m, τ² P⁻¹),

and p's residual is its distance from the nearest point of that sheet along the normal; where the nearest point is on
the border, the distance beside the border is another residual. R, t and a minimise

    Σ_i ρ(r_i / c) + (s²/τ²) (a − m)ᵀ P (a − m),        ρ(z) = z² / (1 + z²),

by Gauss–Newton steps, with new nearest points in each. ρ (Geman, McClure) bounds the effect of an outlier; its scale c
follows from the median of the residuals. If τ is not given, it is the one of largest marginal likelihood: with
``N V = P V Λ`` for the normal matrix N of the shapes after elimination of the rigid motion, and z the right-hand side
in terms of V, ``z_k ~ N(0, s² λ_k + τ² λ_k²)``.

The residuals that remain vary from cell to cell of the surface by more than noise explains if no a describes the shape.
With m cells of n points, the variance u² beyond noise has the effect of a noise of variance ``u² n/m``, which counts in
the covariance of a. If τ is given, u is that of the shape which fits best with a vague distribution of a: a difference
of the scan from the mean shape is not unexplained. A distribution that this fit contradicts, by more than three
standard deviations of their difference, is widened.

References
----------
Y. Chen, G. Medioni: Object modelling by registration of multiple range images. *Image and Vision Computing* 10 (1992),
145–155: distances along normals.
S. Geman, D. McClure: Statistical methods for tomographic image reconstruction. *Bull. Int. Stat. Inst.* 52 (1987),
5–21.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from mic.errors import FormatError
from mic.geometry.measured_points import spread
from mic.geometry.surface import Surface
from mic.geometry.triangles import rotation

__all__ = ["Pose", "Registration", "Shapes", "coverage", "distance", "place", "register"]

USED = 30_000  # points that are used: shapes have some hundred unknowns
COARSE = 400  # points of a trial placement
FEWEST = 20  # points
ALONE = 6.0  # median distances of neighbours beyond which a point is an outlier
NEIGHBOURS = 6
PLACED, TRIALS, STEPS = 12, 15, 16  # largest number of iterations: given placement, other placements, shape
CUT = 3.0  # residuals, in standard deviations, at which the weight of a point is a quarter
ROUGH = 0.003  # of the diameter: mean distance of a placement that is good enough to begin with
UNLIKE = 20.0  # degrees by which two placements differ
ALIKE = 1.3  # ratio of two placements' distances below which neither is preferred, and of principal moments
CONVERGED = 2e-3  # mm
CELLS = 100  # of the surface, approximately
FULL = 0.2  # of the median number of points in a cell, at which it counts as covered
SIGMA = 1.4826  # ratio of a normal distribution's standard deviation to its median absolute deviation
WIDER = 5.0  # times the scale of the residuals, at most, while the shape is sought
SOFT = 1e-9  # relative to the largest: below it an eigenvalue of N is zero
DAMPING = 3e-4  # of rigid motions, relative to the sum of all weights
SCALES = np.geomspace(1e-10, 1e2, 121)  # trials of s²/τ², relative to the largest of N
RENEWED = 0.02  # mm: change of shape after which points are projected anew
MOVE = 1.0  # mm, of points and sheet, within which the triangles near the points stay the same
USUAL = 3.0  # standard deviations from its mean beyond which an amplitude contradicts its distribution
VAGUE = 1e-3  # share of the precision that holds until the scan and the distributions are compared
LEAST = 5e-4  # mm, of noise
LEAST_ROUGH = 0.5  # mm
FAR = 20.0  # median residuals beyond which a point is left out
BESIDE, ROUGH_BESIDE = 2.0, 0.02  # first scale beside the border, mm, and relative to the diameter
COARSE_CONVERGED = 1e-4  # of the diameter


@dataclass(frozen=True)
class Shapes:
    """Shapes that a part may have.

    Attributes
    ----------
    surface : Surface
        Nominal.
    fields : (v, 3, k) array
        Displacement of the vertices per unit of each amplitude, mm.
    offset : (v, 3) array
        Displacement that is always there, mm.
    mean : (k,) array
        Of the amplitudes.
    precision : (k, k) array
        P, of the amplitudes; up to a factor if not `known`.
    known : bool
        Whether the precision is complete, τ = 1.
    """

    surface: Surface
    fields: np.ndarray
    offset: np.ndarray
    mean: np.ndarray
    precision: np.ndarray
    known: bool

    def __post_init__(self):
        self.surface.project(self.surface.points[:1])  # prepares what all scans need
        self.cell.min()

    @cached_property
    def cell(self) -> np.ndarray:
        """(t,) cell of each triangle of the surface."""
        surface = self.surface
        centres = surface.points[spread(surface, np.sqrt(float(surface.areas.sum()) / CELLS))]
        return cKDTree(centres).query(surface.corners.mean(axis=1))[1]

    def prior(self, amplitudes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """(k, k) precision, less for amplitudes that a scan contradicts, which has them with a covariance (k, k)."""
        if not self.known:
            return self.precision
        expected = 1 / self.precision.diagonal() + covariance.diagonal()
        share = 1 / np.maximum(1.0, np.abs(amplitudes - self.mean) / np.sqrt(USUAL**2 * expected))
        return share[:, None] * self.precision * share


@dataclass(frozen=True)
class Pose:
    """A rigid motion ``R p + t`` from the coordinates of a scan to those of the drawing.

    Attributes
    ----------
    turn : (3, 3) array
        R.
    shift : (3,) array
        t, mm.
    """

    turn: np.ndarray
    shift: np.ndarray

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) moved points (n, 3)."""
        return points @ self.turn.T + self.shift

    def then(self, turn: np.ndarray, shift: np.ndarray) -> Pose:
        """This motion followed by another."""
        return Pose(turn @ self.turn, turn @ self.shift + shift)

    def moved(self, q: np.ndarray, centre: np.ndarray, size: float = 1.0) -> Pose:
        """This motion, then a translation q[:3], mm, and a rotation q[3:] about a centre, radians times a size."""
        axis = q[3:] / size
        turn = rotation(axis, float(np.linalg.norm(axis)))
        return self.then(turn, q[:3] + centre - turn @ centre)

    @property
    def degrees(self) -> float:
        """Rotation angle."""
        return _angle(self.turn)


@dataclass(frozen=True)
class Registration:
    """Placement and shape of a scanned piece.

    Attributes
    ----------
    pose : Pose
    amplitudes : (k,) array
    covariance : (k, k) array
        Of the amplitudes, given the scan.
    noise : float
        Standard deviation of a point along the normal, mm.
    unexplained : float
        Root mean square of the deviation that no amplitudes describe, mm.
    outliers : float
        Share of the points that are outliers.
    distance : float
        Mean distance of the nearer four fifths of the points from the sheet with its shape, mm.
    covered : float
        Share of the surface that has points.
    points, used : int
        Number of points of the scan, and of those that were used.
    moved : float
        Displacement of the middle of the points, mm.
    """

    pose: Pose
    amplitudes: np.ndarray
    covariance: np.ndarray
    noise: float
    unexplained: float
    outliers: float
    distance: float
    covered: float
    points: int
    used: int
    moved: float


@dataclass(frozen=True)
class _Residuals:
    """Residuals of points: along normals, and beside the border."""

    value: np.ndarray  # (n,) mm
    direction: np.ndarray  # (n, 3)
    owner: np.ndarray  # (n,) number of the point
    triangle: np.ndarray
    barycentric: np.ndarray
    normal: np.ndarray  # (n,) bool: along the normal

    @classmethod
    def of(cls, surface: Surface, points: np.ndarray, among: tuple | None = None) -> _Residuals:
        foot = surface.project(points, among=among)
        step, normal = points - foot.point, surface.normals[foot.triangle]
        along = (step * normal).sum(axis=1)
        beside = step - along[:, None] * normal
        size = np.linalg.norm(beside, axis=1)
        out = np.flatnonzero(foot.at_border & (size > surface.tie))
        owner = np.concatenate([np.arange(len(points)), out])
        return cls(
            np.concatenate([along, size[out]]),
            np.concatenate([normal, beside[out] / size[out, None]]),
            owner,
            foot.triangle[owner],
            foot.barycentric[owner],
            np.arange(len(owner)) < len(points),
        )

    def only(self, kept: np.ndarray) -> _Residuals:
        """The residuals of some of the points (n,) bool, which are numbered anew."""
        rows = kept[self.owner]
        owner = (np.cumsum(kept) - 1)[self.owner[rows]]
        fields = (self.value, self.direction, self.triangle, self.barycentric, self.normal)
        value, direction, triangle, barycentric, normal = (field[rows] for field in fields)
        return _Residuals(value, direction, owner, triangle, barycentric, normal)

    def weights(self, beside: float | None = None) -> np.ndarray:
        """(n,) weights, with scales by the medians; or with a standard deviation beside the border, mm.

        That also bounds the scale along normals from below, up to WIDER times the median's: else the points of a bent
        part where it happens to fit would make outliers of the others.
        """
        along, off = self.value[self.normal], self.value[~self.normal]
        scale = SIGMA * float(np.median(np.abs(along)))
        weight = _weights(along, scale if beside is None else min(max(scale, beside), WIDER * scale))
        own = weight[self.owner[~self.normal]]  # an outlier is one in all directions
        if beside is None:
            beside = SIGMA * float(np.median(off[own >= 1 / 4])) if (own >= 1 / 4).any() else LEAST
        return np.concatenate([weight, own * _weights(off, beside)])

    def variance(self, weight: np.ndarray) -> float:
        """Variance, mm², of residuals of full weight that have as much information as these with their weights.

        ``E[ψ²] E[w] / E[ψ']²`` with ``ψ = w r`` (Huber, sandwich estimator of location), from those along normals that
        are no outliers.
        """
        inner = self.normal & (weight >= 1 / 4)
        w, r = weight[inner], self.value[inner]
        slope = (w * (4 * np.sqrt(w) - 3)).mean()
        return max(float(((w * r) ** 2).mean() * w.mean() / slope**2), LEAST**2)

    def moved(self, points: np.ndarray, centre: np.ndarray, size: float) -> np.ndarray:
        """(n, 6) change of the residuals by translations, and rotations about a centre times a size."""
        return np.hstack([self.direction, np.cross((points - centre)[self.owner], self.direction) / size])

    def along(self, triangles: np.ndarray, many: int) -> csr_matrix:
        """(n, 3 v) motion of the sheet along the residuals for displacements of its v vertices."""
        weights = self.barycentric[:, :, None] * self.direction[:, None]  # (n, corner, xyz)
        columns = 3 * triangles[self.triangle][:, :, None] + np.arange(3)
        return csr_matrix((weights.ravel(), columns.ravel(), 9 * np.arange(len(weights) + 1)), (len(weights), 3 * many))


class _Nearby:
    """Residuals of the same points from step to step: triangles near them are found anew after larger moves only."""

    _last: tuple[np.ndarray, np.ndarray] | None = None
    _among: tuple[np.ndarray, np.ndarray] | None = None

    def __call__(self, surface: Surface, points: np.ndarray) -> _Residuals:
        now = (points, surface.points)
        if self._last is None or sum(np.linalg.norm(a - b, axis=1).max() for a, b in zip(now, self._last)) > MOVE:
            self._last, self._among = now, surface.candidates(points, MOVE)
        return _Residuals.of(surface, points, self._among)


def _weights(values: np.ndarray, scale: float) -> np.ndarray:
    """(n,) weights of residuals with a standard deviation, mm."""
    return (1 + (values / (CUT * max(scale, LEAST))) ** 2) ** -2


def register(
    points: np.ndarray,
    shapes: Shapes,
    skin: float = 0.0,
    load: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Registration:
    """Place a scan on a nominal sheet, and estimate its shape.

    Parameters
    ----------
    points : (n, 3) array
        mm, in any position.
    shapes : Shapes
    skin : float
        Nominal distance of the points from the surface along its normals, mm.
    load : callable, optional
        Displacement (v, 3), mm, that loads on the piece cause while it is scanned, for given amplitudes.

    Raises
    ------
    FormatError
        If there are too few points, or several placements are equally good.
    """
    if len(points) < FEWEST:
        raise FormatError(f"{len(points)} points are too few to place a part; scan at least {FEWEST}")
    surface, sample = shapes.surface, points
    if len(points) > USED:
        sample = points[np.sort(np.random.default_rng(0).choice(len(points), USED, replace=False))]
    kept = sample[_grouped(sample)]
    skinned = surface.points + skin * surface.vertex_normals
    sheet = surface if skin == 0.0 else _sheet(surface, skinned)
    pose, there = place(kept, sheet), np.zeros_like(skinned)
    a, covariance, moved = shapes.mean, np.zeros((len(shapes.mean),) * 2), np.inf
    fields = shapes.fields.reshape(skinned.size, -1)
    beside = first = min(BESIDE, ROUGH_BESIDE * surface.diameter)  # decreases: outliers would hold a part off its place
    nearby, beyond, noise, variance = _Nearby(), None, RENEWED, np.inf
    prior = shapes.precision * (VAGUE if shapes.known else 1.0)
    for step in range(STEPS + 1):
        displaced = shapes.offset + shapes.fields @ a + (0.0 if load is None else load(a))
        if np.abs(displaced - there).max() > min(RENEWED, noise):
            sheet, there = _sheet(surface, skinned + displaced), displaced
        found = _Residuals.of(sheet, pose(kept)) if step <= 1 else nearby(sheet, pose(kept))
        if step <= 1:  # far points take most of the time of a projection
            size = np.abs(found.value[found.normal])
            near = size <= max(FAR * np.median(size), beside)
            kept, found = kept[near], found.only(near)
        along = found.along(surface.triangles, len(skinned))
        found = replace(found, value=found.value - along @ (displaced - there).ravel())
        weight = found.weights(beside)
        noise, unexplained, cells, covered = _by_cell(found, weight, shapes.cell)
        converged = moved < min(CONVERGED, max(0.1 * noise, LEAST)) and beside <= 2 * noise
        if step == STEPS or (converged and beyond is not None):
            break
        damping, beside = max(DAMPING * (beside / first) ** 2, SOFT), max(beside / 2, noise)
        if converged or step == STEPS - 2:  # before, the difference from the mean shape would count as unexplained
            beyond = unexplained**2 * weight.sum() / max(cells, 1) if shapes.known else 0.0
            prior = shapes.prior(a, covariance * (1 + beyond / variance))
        variance = found.variance(weight) + (beyond or 0.0)
        Q, A = found.moved(pose(kept), surface.centroid, surface.diameter), along @ fields
        y = found.value + A @ (a - shapes.mean)
        q, change, covariance = _solved(Q, A, y, weight, variance, damping, prior, shapes.known, first)
        moved = float(np.abs(Q @ q - A @ (shapes.mean + change - a)).max())
        pose = pose.moved(q, surface.centroid, surface.diameter)
        a = shapes.mean + change
    middle = np.median(kept, axis=0)[None]
    size = np.sqrt(np.bincount(found.owner, found.value**2))
    outlier = weight[found.normal] < 1 / 4
    return Registration(
        pose,
        a,
        covariance * (1.0 if shapes.known else 1 + unexplained**2 * weight.sum() / (max(cells, 1) * variance)),
        noise,
        unexplained,
        1 - float((~outlier).sum()) / len(sample),
        _nearer(size),
        covered,
        len(points),
        len(sample),
        float(np.linalg.norm(pose(middle) - middle)),
    )


def _sheet(surface: Surface, points: np.ndarray) -> Surface:
    """A surface with other vertices (v, 3)."""
    found = Surface(points, surface.triangles)
    vars(found).update(border=surface.border, border_vertices=surface.border_vertices)
    return found


def place(points: np.ndarray, surface: Surface) -> Pose:
    """The motion that places points (n, 3) on a surface: near their given placement if that is good, else the best.

    Raises
    ------
    FormatError
        If several placements are equally good.
    """
    rng = np.random.default_rng(1)
    few = points if len(points) <= COARSE else points[rng.choice(len(points), COARSE, replace=False)]
    given, off = _best_fit(few, surface, Pose(np.eye(3), np.zeros(3)), PLACED)
    if off < max(ROUGH * surface.diameter, LEAST_ROUGH) and given.degrees < UNLIKE:
        return given
    trials = [(given, off), *(_best_fit(few, surface, start, TRIALS) for start in _turned(points, surface))]
    best, least = min(trials, key=lambda trial: trial[1])
    trials += [_best_fit(few, surface, start, TRIALS) for start in _turned(best(points), surface, best)]
    best, least = min(trials, key=lambda trial: trial[1])
    alike = [pose for pose, other in trials if other < ALIKE * least]
    if any(_angle(pose.turn @ best.turn.T) > UNLIKE for pose in alike):
        raise FormatError(
            "the part fits in several positions equally well; place the scan near the drawing's position, "
            f"within about {UNLIKE:g}°, or scan more of the part"
        )
    return best


def distance(points: np.ndarray, surface: Surface) -> float:
    """Mean distance, mm, of the nearer four fifths of points (n, 3) from a surface."""
    return _nearer(surface.project(points).distance)


def _nearer(distances: np.ndarray) -> float:
    """Mean of the smaller four fifths of distances (n,)."""
    return float(np.sort(distances)[: max(1, 4 * len(distances) // 5)].mean())


def coverage(points: np.ndarray, shapes: Shapes) -> float:
    """Share of a part's cells with placed points (n, 3)."""
    found = shapes.surface.project(points)
    count = np.bincount(shapes.cell[found.triangle[found.distance <= np.median(found.distance) * CUT]])
    return float((count >= max(1.0, FULL * float(np.median(count)))).sum() / (shapes.cell.max() + 1))


def _best_fit(points: np.ndarray, surface: Surface, pose: Pose, steps: int) -> tuple[Pose, float]:
    """The best fit of points from a start, and their mean distance."""
    for _ in range(steps):
        found = _Residuals.of(surface, pose(points))
        weight = found.weights()
        Q = found.moved(pose(points), surface.centroid, surface.diameter)
        q = _softened(Q, weight, DAMPING) @ (Q.T @ (-weight * found.value))
        pose = pose.moved(q, surface.centroid, surface.diameter)
        if np.abs(q).max() < COARSE_CONVERGED * surface.diameter:
            break
    return pose, distance(pose(points), surface)


def _turned(points: np.ndarray, surface: Surface, after: Pose | None = None) -> list[Pose]:
    """Placements with the principal axes of the points (n, 3) on those of the surface, in every sense and order that
    the moments allow; or, after a placement, with those of the surface on themselves."""
    at = surface.corners.mean(axis=1)
    moments, axes = np.linalg.eigh(np.cov(at.T, aweights=surface.areas))
    if after is None:
        near = np.linalg.norm(points - np.median(points, axis=0), axis=1)
        inner = points[near <= 3 * np.median(near)]
        centre, own, after = inner.mean(axis=0), np.linalg.eigh(np.cov(inner.T))[1], Pose(np.eye(3), np.zeros(3))
    else:
        centre, own = surface.centroid, axes
    found = []
    for order in permutations(range(3)):
        swapped = [i for i in range(3) if order[i] != i]
        if swapped and moments[swapped].max() > ALIKE**2 * max(moments[swapped].min(), 1e-12):
            continue
        for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
            turn = axes[:, list(order)] * np.array(signs) @ own.T
            if np.linalg.det(turn) < 0:
                turn = axes[:, list(order)] * -np.array(signs) @ own.T
            found.append(after.then(turn, surface.centroid - turn @ centre))
    return found


def _angle(turn: np.ndarray) -> float:
    """Angle of a rotation (3, 3), degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0))))


def _grouped(points: np.ndarray) -> np.ndarray:
    """(n,) bool: whether the neighbours of each point are about as near as those of the others."""
    away = cKDTree(points).query(points, NEIGHBOURS + 1)[0][:, -1]
    return away <= ALONE * np.median(away)


def _softened(Q: np.ndarray, weight: np.ndarray, damping: float) -> np.ndarray:
    """Inverse (6, 6) of the stiffness of rigid motions against weighted residuals with derivatives Q (n, 6).

    A part inside its border has no residuals beside it: a damping keeps it from motions that nothing resists.
    """
    return np.linalg.inv((Q * weight[:, None]).T @ Q + damping * weight.sum() * np.eye(6))


def _solved(
    Q, A, y, weight, variance: float, damping: float, precision: np.ndarray, known: bool, longest: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rigid motion (6,), amplitudes (k,) beyond their means and their covariance, of residuals ``y + Q q − A c``.

    If hardly anything resists a motion, it is damped to the longest, mm: it shall not leave the border behind.
    """
    free, Qw = _softened(Q, weight, damping), Q.T * weight
    if not A.shape[1]:
        return -free @ (Qw @ y), np.zeros(0), np.zeros((0, 0))
    coupling, Aw = Qw @ A, A.T * weight
    N = Aw @ A - coupling.T @ free @ coupling
    right = Aw @ y - coupling.T @ (free @ (Qw @ y))
    λ, V = eigh(0.5 * (N + N.T), precision)
    λ, z = np.maximum(λ, 0.0), V.T @ right
    κ = variance
    if not known:
        trials = λ.max() * SCALES
        spread_of_z = variance * λ + variance * λ**2 / trials[:, None]
        seen = λ > SOFT * λ.max()
        minus = (np.log(spread_of_z[:, seen]) + z[seen] ** 2 / spread_of_z[:, seen]).sum(axis=1)
        κ = trials[np.argmin(minus)]
    c = V @ (z / (λ + κ))
    q = free @ (coupling @ c - Qw @ y)
    if np.abs(q).max() > longest and damping < DAMPING:
        return _solved(Q, A, y, weight, variance, 10 * damping, precision, known, longest)
    return q, c, variance * (V / (λ + κ)) @ V.T


def _by_cell(found: _Residuals, weight: np.ndarray, cell: np.ndarray) -> tuple[float, float, int, float]:
    """Noise and unexplained deviation, mm; number of covered cells of the triangles' (t,), and their share."""
    inner = found.normal & (weight >= 1 / 4)
    own, value = cell[found.triangle[inner]], found.value[inner]
    many = int(cell.max()) + 1
    count = np.bincount(own, minlength=many)
    covered = count >= max(1.0, FULL * float(np.median(count)))
    full = covered & (count >= 3)
    mean = np.bincount(own, value, many) / np.maximum(count, 1)
    within = ((value - mean[own]) ** 2).sum() / max(len(value) - (count > 0).sum(), 1)
    noise = max(float(np.sqrt(within)), LEAST)
    beyond = (mean[full] ** 2 - within / count[full]).mean() if full.any() else 0.0
    return noise, float(np.sqrt(max(beyond, 0.0))), int(full.sum()), float(covered.mean())
