"""An independent judge of contact solutions, in 80-bit numbers (``numpy.longdouble``, 1.1e-19 relative).

It reads the data of a problem and a force, and shares no code with :mod:`mic.contact`.  Each law is the set of pairs
(force, displacement) that one contact may have, a union of branches: open, stuck, slipping.  A contact's *breach* is
the distance from its pair to the nearest branch as a force, displacements counted by the contact's own stiffness
(normal and tangential apart).  It is related to the contact's own scale: the force that it carries, or, where the
nearest branch is the open one, the force that would close its gap (or push out its overlap, if it carries none).

Tolerances, stated before any solution was judged:

- :data:`OWN` = 1e-8 for each contact on its own scale, where the program claims 1e-9; one order covers the weights of
  the conditions.
- :data:`WHOLE` = 1e-9 for all contacts together, in energy, where the certificate claims 1e-10; one order likewise.
- Rounding: forces are doubles, so ``S f`` is uncertain by ``ε (|S||f| + |b|)`` in each row.  :data:`ROUNDING` = 32 of
  these are forgiven, because a solution in exact arithmetic could not be stated better and a double solver adds a few.
  This is a backward error: an ill-conditioned S forgives nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

__all__ = ["OWN", "ROUNDING", "WHOLE", "Problem", "Verdict", "judge", "judge_increments", "judge_path_end"]

OWN, WHOLE, ROUNDING = 1e-8, 1e-9, 32.0
EPS = float(np.finfo(float).eps)
LONG = np.longdouble
TINY = LONG(10.0) ** -4000


@dataclass(frozen=True)
class Problem:
    """Data of contacts under one law.

    Attributes
    ----------
    S : (3m, 3m) array
    law : str
    mu : (m,) array
    friction : list of m tuples, or None
        Of ``pressure-dependent``: ``("table", points, area)`` or ``("power", (μ0, p0, n, μ_min, μ_max), area)``.
    compliance : (m,) array or None
        Of ``micro-slip``: compliance of the tangential springs.
    """

    S: np.ndarray
    law: str
    mu: np.ndarray
    friction: list | None = None
    compliance: np.ndarray | None = None
    wide: np.ndarray = field(init=False)

    def __post_init__(self):
        S = np.asarray(self.S, dtype=LONG)
        S = (S + S.T) / 2  # a slightly asymmetric S is documented to be symmetrised
        if self.law == "micro-slip":
            spring = np.zeros((len(self.mu), 3), dtype=LONG)
            spring[:, 1:] = self.compliance[:, None]
            S = S + np.diag(spring.ravel())
        object.__setattr__(self, "wide", S)

    def coefficient(self, normal: np.ndarray) -> np.ndarray:
        """(n, m) μ under normal forces (n, m)."""
        if self.law == "frictionless":
            return np.zeros_like(normal)
        if self.law != "pressure-dependent":
            return np.broadcast_to(np.asarray(self.mu, dtype=LONG), normal.shape)
        return np.stack([_of_pressure(*own, normal[:, k]) for k, own in enumerate(self.friction)], axis=1)


def _of_pressure(kind, data, area, normal):
    p = np.maximum(normal, 0) / LONG(area)
    if kind == "table":
        x, y = np.asarray(data, dtype=LONG).T
        i = np.clip(np.searchsorted(x, p, side="right") - 1, 0, max(len(x) - 2, 0))
        if len(x) == 1:
            return np.full(p.shape, y[0])
        inside = y[i] + (y[i + 1] - y[i]) * (p - x[i]) / (x[i + 1] - x[i])
        return np.where(p <= x[0], y[0], np.where(p >= x[-1], y[-1], inside))
    mu0, p0, n, low, high = (LONG(value) for value in data)
    return np.clip(mu0 * (np.maximum(p, TINY) / p0) ** -n, low, high)


@dataclass(frozen=True)
class Verdict:
    """Measures of n samples.

    Attributes
    ----------
    own : (n, m) float array
        Breach of each contact, without what rounding explains, relative to its own scale.
    whole : (n,) float array
        Breaches of all contacts in energy, likewise, relative to the energy of the forces or of the overlaps.
    moved : (n,) float array
        Error of the reported displacements in units of the rounding of their rows.
    """

    own: np.ndarray
    whole: np.ndarray
    moved: np.ndarray


def judge(
    problem: Problem,
    b: np.ndarray,
    force: np.ndarray,
    displacement: np.ndarray | None = None,
    terms: np.ndarray | float = 0.0,
) -> Verdict:
    """Judge forces (n, 3m) for loads (n, 3m).

    ``displacement`` is ``S f + b`` as it was reported, without the springs of ``micro-slip``; ``terms`` (n, 3m) is the
    size of the doubles whose difference ``b`` is.
    """
    m = len(problem.mu)
    S, b, f = problem.wide, np.asarray(b, dtype=LONG), np.asarray(force, dtype=LONG)
    w = f @ S + b
    row = np.abs(f) @ np.abs(S) + np.abs(b) + np.abs(terms)
    moved = np.zeros(len(b))
    if displacement is not None:
        plain = w if problem.law != "micro-slip" else f @ _symmetric(problem.S) + b
        off = np.abs(np.asarray(displacement, dtype=LONG) - plain)
        moved = np.minimum((off / (EPS * row + TINY)).max(axis=1, initial=0), 1e300).astype(float)
    f, w, row, b = (a.reshape(len(a), m, 3) for a in (f, w, row, b))
    stiff = _stiffness(S, m)
    breach, scale = _breach(problem, f, w, b, row, stiff)
    slack = ROUNDING * EPS * ((row * stiff).sum(axis=-1) + np.linalg.norm(f, axis=-1))
    own = np.maximum(breach - slack[..., None], 0) / np.maximum(scale, TINY)
    best = own.argmin(axis=-1)[..., None]
    own = np.take_along_axis(own, best, -1)[..., 0]
    # All together, in energy, as the certificate does: with one stiffness of a contact, in its softest direction.
    least = np.maximum((breach - slack[..., None]).min(axis=-1), 0)
    weight = stiff.min(axis=1) / stiff.max(axis=1) ** 2
    energy = (f * (w - b)).sum(axis=(1, 2))
    overlap = np.minimum(b[..., 0], 0) * stiff.min(axis=1)
    whole = np.sqrt((least**2 * weight).sum(axis=1))
    size = np.sqrt(np.maximum(energy, (overlap**2 / stiff.min(axis=1)).sum(axis=1)))
    whole = np.where(whole > 0, whole / np.maximum(size, TINY), 0)
    with np.errstate(over="ignore"):
        return Verdict(own.astype(float), whole.astype(float), moved)


def _symmetric(S):
    S = np.asarray(S, dtype=LONG)
    return (S + S.T) / 2


def _stiffness(S, m):
    """(m, 3) force per displacement of each contact by itself; of the mean of others where it has no compliance."""
    own = np.maximum(S.diagonal().reshape(m, 3).copy(), 0)
    own[:, 1:] = own[:, 1:].mean(axis=1, keepdims=True)
    largest = own.max(initial=0)
    for column in own.T:
        none = column <= EPS * largest
        column[none] = column[~none].mean() if (~none).any() else (largest or 1)
    return 1 / own


def _breach(problem, f, w, b, row, stiff):
    """(n, m, 3) distances to the branches open, stuck, slipping, and the scale of each."""
    rho_n, rho_t = stiff[:, 0], stiff[:, 1]
    f_n, w_n = f[..., 0], w[..., 0]
    traction, slip = np.linalg.norm(f[..., 1:], axis=-1), np.linalg.norm(w[..., 1:], axis=-1)
    carried = np.linalg.norm(f, axis=-1)
    mu = problem.coefficient(f_n)
    pull = np.maximum(-f_n, 0)
    # Zero for a contact that carries force, not negative for one that does not.
    gap, per_gap, reach = w_n, np.broadcast_to(rho_n, w_n.shape), np.abs(w_n)
    if problem.law == "associated":  # it slips only while it opens: w_n = μ‖w_t‖
        gap, reach = w_n - mu * slip, np.maximum(np.abs(w_n), mu * slip)
        per_gap = np.minimum(rho_n, rho_t / np.maximum(mu, TINY))
    opened = carried + per_gap * np.maximum(-gap, 0)
    own_gap = per_gap * np.maximum(reach, np.where(carried > 0, 0, np.abs(b[..., 0])))
    outside = np.maximum(traction - mu * np.maximum(f_n, 0), 0)
    stuck = pull + outside + rho_n * np.abs(w_n) + rho_t * slip
    if problem.law == "frictionless":
        stuck = np.full_like(stuck, LONG(np.inf))
    # Slipping: the traction opposes the motion, at its bound.  The nearer of both ways to see the error in direction.
    way = w[..., 1:] / np.maximum(slip, TINY)[..., None]
    as_force = np.linalg.norm(f[..., 1:] + (mu * np.maximum(f_n, 0))[..., None] * way, axis=-1)
    along = -f[..., 1:] / np.maximum(traction, TINY)[..., None]
    ahead = np.maximum((along * w[..., 1:]).sum(axis=-1), 0)
    beside = np.linalg.norm(w[..., 1:] - ahead[..., None] * along, axis=-1)
    as_motion = np.abs(traction - mu * f_n) + rho_t * beside
    as_motion = np.where(traction > 0, as_motion, LONG(np.inf))
    slips = pull + per_gap * np.abs(gap) + np.minimum(as_force, as_motion)
    held = np.maximum(carried, TINY)
    return np.stack([opened, stuck, slips], axis=-1), np.stack([own_gap, held, held], axis=-1)


def judge_increments(problem: Problem, b0, b1, anchor, ends, forces, result) -> tuple[Verdict, float]:
    """Judge one leg of backward Euler steps that end at fractions `ends` (k,) with `forces` (k, 3m), one sample.

    Each step obeys the law with displacements measured from the anchor, which then moves to the contact (to its slider
    under ``micro-slip``).  ``result`` is the (3m,) displacement and the (m, 2) anchor that were reported at the end.

    Returns
    -------
    Verdict
        Of the steps.
    float
        Error of the reported end, relative to the largest displacement in it.
    """
    m = len(problem.mu)
    b0, b1, forces = (np.asarray(a, dtype=LONG) for a in (b0, b1, forces))
    anchor, loads, terms = np.asarray(anchor, dtype=LONG).copy(), [], []
    for end, force in zip(np.asarray(ends, dtype=LONG), forces):
        load = (b0 + end * (b1 - b0)).reshape(m, 3).copy()
        load[:, 1:] -= anchor
        size = (np.abs(b0) + np.abs(b1)).reshape(m, 3)
        size[:, 1:] += np.abs(anchor)
        terms.append(size.ravel())
        loads.append(load.ravel())
        anchor += (force @ problem.wide + load.ravel()).reshape(m, 3)[:, 1:]
    displacement = forces[-1] @ _symmetric(problem.S) + b1
    size = max(np.abs(displacement).max(initial=0), np.abs(b0).max(initial=0), np.abs(b1).max(initial=0), TINY)
    off = max(np.abs(displacement - result[0]).max(initial=0), np.abs(anchor - result[1]).max(initial=0))
    return judge(problem, np.array(loads), forces, terms=np.array(terms)), float(off / size)


def judge_path_end(problem: Problem, b, force, displacement, anchor) -> tuple[Verdict, float]:
    """Judge what any path along loads `b` (k + 1, 3m) ends with: contacts do not penetrate, forces obey their bound.

    The end of a path of second order does not determine the direction of slip, so contacts count as slipping in the
    direction of their force.  Returns the verdict, and the error of the reported displacements and anchors.
    """
    m, b1, largest = len(problem.mu), np.asarray(b[-1], dtype=LONG), np.abs(b).max(axis=0)
    f = np.asarray(force, dtype=LONG).reshape(1, m, 3)
    w = (f.reshape(1, -1) @ problem.wide + np.asarray(b1, dtype=LONG)).reshape(1, m, 3)
    slider = w[0, :, 1:].copy()
    displacement_here = f.reshape(1, -1) @ _symmetric(problem.S) + np.asarray(b1, dtype=LONG)
    size = max(np.abs(displacement_here).max(initial=0), largest.max(initial=0), TINY)
    off = max(np.abs(displacement_here[0] - displacement).max(initial=0), np.abs(slider - anchor).max(initial=0))
    # A load whose tangential part lets every contact within its bound rest where it is: w_t = 0.
    rest = np.asarray(b1, dtype=LONG).reshape(1, m, 3).copy()
    rest[..., 1:] -= slider
    terms = np.asarray(largest, dtype=LONG)[None]
    return judge(problem, rest.reshape(1, -1), f.reshape(1, -1), terms=terms), float(off / size)
