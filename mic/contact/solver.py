"""Contact solver: checks the input, prepares S once, solves many right-hand sides and certifies each sample."""

from __future__ import annotations

import warnings
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from mic.contact import ladder
from mic.contact.backends import BACKENDS
from mic.contact.certificate import contact_stiffness, in_units, measure, residual, series_compliance
from mic.contact.contact_residual import RESOLVED, as_contacts, contact_residuals, directional_stiffness
from mic.contact.friction import Friction, finite
from mic.contact.large_increment import forces_without_friction
from mic.contact.laws import Law, find
from mic.contact.path import Followed, Path, PathSolution, follow, with_samples
from mic.contact.refinement import refined
from mic.contact.solution import ContactSolution, Status
from mic.contact.units import RANGE, out_of_range, unit
from mic.system.arguments import number
from mic.system.matrix_product import one_thread

__all__ = ["ContactSolver", "solve"]

#: Relative asymmetry ``max|S - Sᵀ| / max|S|`` above which S is symmetrised with a warning, and refused.
ASYMMETRY_WARNED, ASYMMETRY_REFUSED = 1e-10, 1e-2
#: A negative eigenvalue below this fraction of the largest entry is an error of sign, not of rounding: entries printed
#: with seven digits have errors of half of 1e-6.
INDEFINITE = 5e-7
#: Smaller doubles have a reduced precision.
SMALLEST = np.finfo(float).tiny / np.finfo(float).eps
#: The search for a solution ends at this fraction of the tolerance, so that rounding cannot change the outcome.
SAFETY = 0.5
#: Forces below this are remainders of iterations: displacements and compliances within RANGE need larger ones.
NEGLIGIBLE = 1e-20 * RANGE[0] / RANGE[1]
#: Overlap of a contact that no force moves, relative to the largest displacement, that counts as rounding.
ROUNDING = 16.0 * np.finfo(float).eps
OUTCOMES = np.array([Status.CONVERGED, Status.NOT_CONVERGED, Status.INFEASIBLE], dtype=object)


class ContactSolver:
    """Solver of contact problems with one compliance and many right-hand sides.

    Solves ``u = S f + b`` together with the contact law that ties ``f`` to ``u`` contact by contact
    (:mod:`mic.contact.laws`).

    Parameters
    ----------
    S : (3m, 3m) array, or (m, m) for ``dimension`` 1
        Compliance: relative displacements per contact force, symmetric positive semidefinite, contact by contact in the
        order n, t1, t2 [length / force].
    mu : float, (m,) array or Friction
        Coefficients of friction, ``>= 0``, or :class:`mic.contact.friction.Friction` for laws that need more data.
    law : str or Law
        A name in :data:`mic.contact.laws.LAWS`, or the law itself.  ``coulomb`` is Coulomb's law proper; ``associated``
        the cone programme (13); ``frictionless`` the programme (12), which takes forces from the normal block alone and
        still returns all displacements.
    backend : str
        A name in :data:`mic.contact.backends.BACKENDS`.  ``native`` solves every law; the others, where installed,
        reproduce and cross-check the convex ones.
    tol : float
        Largest certificate residual of a converged sample.
    threads : int
        Threads over the samples of a batch (native backend).
    dimension : {3, 1}
        1 if ``S`` and ``b`` hold only the normal rows, for scenes without friction; needs a law without friction.
    semidefinite : bool
        Whether S is known to be symmetric and positive semidefinite; otherwise a Cholesky factorisation checks it.
    certify_each : bool
        Whether each contact is also certified on its own scale, see :mod:`mic.contact.contact_residual`. Without it, a
        sample of few contacts takes up to a third less time.
    work : float
        Largest work of the fallback methods for one sample, see :data:`mic.contact.ladder.WORK`.

    Attributes
    ----------
    compliance : (m,) array
        Tangential compliance ``c`` in series with each slider, zero except under ``micro-slip``: the position of a
        slider is ``u_t + c f_t``.

    Raises
    ------
    ValueError
        Naming the argument that has the wrong shape, is not finite, is negative or unknown.
    ImportError
        If the backend is not installed.
    """

    @one_thread
    def __init__(
        self,
        S: np.ndarray,
        mu: float | np.ndarray | Friction,
        law: str | Law = "coulomb",
        backend: str = "native",
        tol: float = 1e-10,
        threads: int = 1,
        dimension: int = 3,
        semidefinite: bool = False,
        certify_each: bool = True,
        work: float = ladder.WORK,
    ):
        self.law = find(law)
        if backend not in BACKENDS:
            raise ValueError(f"backend must be one of {', '.join(BACKENDS)}; got {backend!r}")
        if dimension not in (1, 3):
            raise ValueError(f"dimension must be 3 or 1; got {dimension!r}")
        if dimension == 1 and self.law.frictional:
            raise ValueError(
                f"dimension 1 has no tangential rows, so law must be without friction; got {self.law.name!r}"
            )
        if not (np.isscalar(tol) and np.isfinite(tol) and tol > 0.0):
            raise ValueError(f"tol must be a positive number; got {tol!r}")
        if not (isinstance(threads, (int, np.integer)) and threads >= 1):
            raise ValueError(f"threads must be a positive integer; got {threads!r}")
        number("work", work, least=0.0)
        self.dimension, self.tol, self.certify_each = dimension, float(tol), bool(certify_each)
        self.S = _checked_compliance(S, dimension, semidefinite)
        self.contacts = len(self.S) // dimension
        friction = self._set_friction(mu)
        # The law relates the force to the sliders' displacement S' f + b, S' = S + C.
        self._sliding = self.S + np.diag(self._series) if self._series.any() else self.S
        self._stiffness = contact_stiffness(self._sliding, self.law, dimension)
        self._rho = directional_stiffness(self._sliding, self.law, dimension) if certify_each else None
        # S is semidefinite: its largest entry lies on the diagonal.
        self._rigid, self._scaled = not self.S.any(), bool(out_of_range(self.S.diagonal()))
        self._settings: dict[str, Any] = {"backend": backend, "threads": int(threads), "dimension": dimension}
        self._settings |= {"certify_each": certify_each, "work": work}
        self.backend = BACKENDS[backend](self._sliding, friction, self.law, self.tol, int(threads), dimension, work)

    def _set_friction(self, mu: float | np.ndarray | Friction) -> Friction:
        """Store the checked friction and the parameters of the law."""
        friction = Friction.of(mu if self.law.frictional else 0.0, self.contacts)
        self.mu, self.compliance = friction.coefficient, self.law.compliance(friction)
        self._parameters = self.law.parameters(friction)
        self._series = series_compliance(self.law, friction, self.dimension)
        return friction

    @one_thread
    def with_friction(self, mu: float | np.ndarray | Friction) -> ContactSolver:
        """The solver of the same contacts with another friction; everything that depends on S alone is reused."""
        some = copy(self)
        friction = some._set_friction(mu)
        if (some._series == self._series).all():
            some.backend = self.backend.with_friction(friction)
            return some
        return ContactSolver(self.S, mu, self.law, tol=self.tol, semidefinite=True, **self._settings)

    @one_thread
    def subset(self, own: np.ndarray) -> ContactSolver:
        """The solver of a subset `own` (m,) of the contacts; prepared data are reused."""
        from mic.contact.native.matrices import block  # Numba is slow to import

        index, rows = np.flatnonzero(own), np.repeat(own, self.dimension)
        some = copy(self)
        some.contacts, some.S = len(index), block(self.S, index, self.dimension)
        some._sliding = some.S if self._sliding is self.S else block(self._sliding, index, self.dimension)
        diagonal = some.S.diagonal()
        some._rigid, some._scaled = not diagonal.any(), bool(out_of_range(diagonal))
        some.mu, some.compliance, some._parameters = self.mu[own], self.compliance[own], self._parameters[own]
        some._series, some._stiffness = self._series[rows], self._stiffness[own]
        some._rho = None if self._rho is None else self._rho[own]
        some.backend = self.backend.subset(own)
        return some

    def bound(self, normal: np.ndarray) -> np.ndarray:
        """Largest tangential forces ``g(f_n)`` of the law for normal forces (..., m)."""
        return self.law.bound(normal, self._parameters)

    @one_thread
    def solve(self, b: np.ndarray, guess: np.ndarray | None = None, refine: bool = True) -> ContactSolution:
        """Solve for one right-hand side or a batch of them.

        Samples are independent of each other.

        Parameters
        ----------
        b : (3m,) or (n, 3m) array
            Relative displacements without contact forces, gaps included [length].
        guess : array shaped like ``b``, optional
            Forces to start from.
        refine : bool
            Whether converged samples with unresolved contacts are refined (:mod:`mic.contact.refinement`), if each
            contact is certified.

        Returns
        -------
        ContactSolution
        """
        b = _checked_rows("b", b, len(self.S))
        rows = np.atleast_2d(b)
        if guess is not None:
            guess = _checked_rows("guess", guess, len(self.S))
            if guess.shape != b.shape:
                raise ValueError(f"guess must have the shape of b, {b.shape}; got {guess.shape}")
            guess = np.atleast_2d(guess)
        scaled = self.outside_range(rows)
        if not scaled.any():
            solution = self._solve(rows, guess, refine)
        elif scaled.all():
            solution = self._solve_scaled(rows, guess, refine)
        else:
            solution = self._solve(np.where(scaled[:, None], 0.0, rows), guess, refine)
            own = self._solve_scaled(rows[scaled], None if guess is None else guess[scaled], refine)
            solution = with_samples(solution, scaled, own)
        return solution if b.ndim == 2 else _only(solution)

    def outside_range(self, rows: np.ndarray) -> np.ndarray:
        """(n,) samples whose displacements (n, k), or whose S, lie outside :data:`mic.contact.units.RANGE`."""
        return out_of_range(rows) | self._scaled

    def _solve(self, rows, guess, refine, retry=True) -> ContactSolution:
        """Solve problems whose numbers are within range."""
        if self._rigid:  # forces cause no displacement
            force, counts = np.zeros_like(rows), np.zeros((2, len(rows)), dtype=np.int64)
            rung = np.full(len(rows), "rigid", dtype=object)
        else:
            force, *both, rung = self.backend.solve(rows, guess)
            force[np.abs(force) < NEGLIGIBLE] = 0.0
            counts = np.array(both)
        rigid = self._overlaps_rigidly(rows)
        solution = self.certify(rows, force, counts[0], counts[1], rung, rigid)
        unsolved = np.flatnonzero(~solution.converged)
        if unsolved.size:
            infeasible = rigid.copy()
            for sample in unsolved:
                infeasible[sample] |= self._rigid or self.backend.infeasible(rows[sample])
                if infeasible[sample]:
                    force[sample] = 0.0
                else:
                    self._apply_fallbacks(sample, rows, force, counts, rung)
            solution = self.certify(rows, force, counts[0], counts[1], rung, infeasible)
            lost = ~solution.converged & ~infeasible
            if guess is not None and retry and lost.any():  # try again from forces without friction
                again = self._solve(rows[lost], self._without_friction(rows[lost]), False, retry=False)
                counts = counts[:, lost] + [again.iterations, again.factorisations]
                again = replace(again, iterations=counts[0], factorisations=counts[1])
                solution = with_samples(solution, lost, again)
        return self._refine(rows, solution) if refine and self.certify_each else solution

    def _without_friction(self, rows) -> np.ndarray:
        """(n, d m) forces without friction."""
        force, normal = np.zeros_like(rows), slice(None, None, self.dimension)
        S = self.S[normal, normal]
        for b, found in zip(rows[:, normal], force[:, normal]):
            found[:] = forces_without_friction(S, b, found)
        return force

    def _overlaps_rigidly(self, rows) -> np.ndarray:
        """(n,) samples with a contact that overlaps, though no force moves it."""
        own = self._sliding.diagonal().reshape(self.contacts, self.dimension)
        normal_alone = self.law.shift == 1.0 or not self.law.frictional
        still = np.flatnonzero(~(own[:, :1] if normal_alone else own).any(axis=1))
        still = still[[not self._sliding[self.dimension * k].any() for k in still]]
        if not still.size:
            return np.zeros(len(rows), dtype=bool)
        b = as_contacts(rows, len(rows), self.contacts, self.dimension)
        mu = self.law.coefficient(self._parameters, np.zeros(b.shape[:2]))
        overlap = -self.law.opening(b, mu)[:, still].min(axis=1)
        return overlap > ROUNDING * np.abs(rows).max(axis=1)

    def _refine(self, rows, solution) -> ContactSolution:
        """Refine converged samples with unresolved contacts, as far as their residual stays below the tolerance."""
        poor = np.flatnonzero(solution.converged & solution.unresolved.any(axis=1))
        if not poor.size:
            return solution
        known = self._parameters, self.law, self.dimension
        force = np.array([refined(self._sliding, rows[k], solution.force[k], *known) for k in poor])
        counts = solution.iterations[poor], solution.factorisations[poor]
        better = self.certify(rows[poor], force, *counts, solution.rung[poor])
        assert better.contact_residual is not None
        worst = solution.contact_residual[poor].max(axis=1)
        taken = better.converged & (better.contact_residual.max(axis=1) < worst)
        return with_samples(solution, poor[taken], replace(better, **{k: v[taken] for k, v in vars(better).items()}))

    def _solve_scaled(self, rows, guess, refine) -> ContactSolution:
        """Solve problems out of range in scaled units, unless the law depends on units."""
        if self.law.reads:
            n, zero = len(rows), np.zeros_like(rows)
            none = np.zeros(n, dtype=np.int64)
            found = self.certify(rows, zero, none, none.copy(), np.full(n, "none", dtype=object))
            return _refused(found, np.ones(n, dtype=bool))
        compliance, length = unit(self.S.ravel()), unit(rows)
        own = ContactSolver(self.S / compliance, self.mu, self.law, tol=self.tol, semidefinite=True, **self._settings)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            force = length / compliance
            scaled = None if guess is None else np.nan_to_num(guess / force[:, None], posinf=0.0, neginf=0.0)
            found = own._solve(rows / length[:, None], scaled, refine)
            moved = found.force.any(axis=1)
            found = replace(
                found,
                force=found.force * force[:, None],
                displacement=found.displacement * length[:, None],
                **in_units(found, length, force),
            )
            # Reject forces that doubles cannot represent to full precision.
            largest = np.abs(found.force).max(axis=1, initial=0.0)
            lost = ~np.isfinite(largest) | (found.force.any(axis=1) != moved) | ((largest < SMALLEST) & (largest > 0.0))
            return _refused(found, lost)

    @one_thread
    def certify(
        self,
        b: np.ndarray,
        force: np.ndarray,
        iterations: np.ndarray,
        factorisations: np.ndarray,
        rung: np.ndarray,
        infeasible: np.ndarray | None = None,
    ) -> ContactSolution:
        """Certify the forces of a batch.

        Parameters
        ----------
        b, force : (n, d m) array
        iterations, factorisations : (n,) int array
            Cost of finding them.
        rung : (n,) object array
            Methods that found them.
        infeasible : (n,) bool array, optional
            Samples that are proven to have no solution.
        """
        certificate, displacement = self._measure(b, force)
        converged = certificate.residual <= self.tol
        if infeasible is not None:
            converged &= ~infeasible
        unsolved = 1 if infeasible is None else np.where(infeasible, 2, 1)
        return ContactSolution(
            force=force,
            displacement=displacement,
            converged=converged,
            status=OUTCOMES[np.where(converged, 0, unsolved)],
            iterations=iterations,
            factorisations=factorisations,
            rung=rung,
            **vars(certificate),
        )

    @one_thread
    def check_convergence(
        self, b: np.ndarray, force: np.ndarray, response: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residual, convergence and status (n,) of forces and right-hand sides (n, d m); ``response`` (n, d m) is
        ``S f``."""
        displacement = response + force * self._series + b
        known = self._parameters, force, self.law, self._stiffness, self.dimension, displacement
        found = residual(self._sliding, b, *known)
        converged = found <= self.tol
        return found, converged, OUTCOMES[np.where(converged, 0, 1)]

    def unresolved(self, b: np.ndarray, force: np.ndarray, response: np.ndarray) -> np.ndarray | None:
        """(n, m) contacts that violate their law on their own scale, :attr:`ContactSolution.unresolved`; arguments
        as :meth:`check_convergence` has them."""
        if self._rho is None:
            return None
        displacement = response + force * self._series + b
        known = self._parameters, force, self.law, self.dimension, self._rho, displacement
        return ~(contact_residuals(self._sliding, b, *known) <= RESOLVED)

    @one_thread
    def follow(
        self,
        b: np.ndarray,
        force: np.ndarray | None = None,
        anchor: np.ndarray | None = None,
        path: Path | None = None,
    ) -> PathSolution:
        """Solve along a load path; see :mod:`mic.contact.path`.

        Parameters
        ----------
        b : (n, k + 1, 3m) array
            Displacements without contact forces, gaps included, at k + 1 loads, linear in between.
        force : (n, 3m) array, optional
            Contact forces at the first load; default: zero. If they are not in equilibrium with it, because parts
            overlap, they are corrected before the load changes.
        anchor : (n, m, 2) array, optional
            Tangential displacements from which slip is measured; default: those of ``b`` at the first load.
        path : Path, optional
            Integration method; default :class:`mic.contact.path.Followed`. A law whose `followed` is False is solved
            with
            :class:`mic.contact.path.Increments`; without friction only the last load matters.

        Returns
        -------
        PathSolution
        """
        b = finite("b", b)
        if b.ndim != 3 or b.shape[1] < 2 or b.shape[2] != len(self.S):
            raise ValueError(f"b must have shape (n, k + 1, {len(self.S)}) with k >= 1; got {b.shape}")
        return follow(self, b, force, anchor, path or Followed())

    def _measure(self, rows, force):
        known = self._parameters, force, self.law, self._stiffness, self.dimension, self._series
        return measure(self._sliding, rows, *known, self._rho)

    def _residual(self, rows, force):
        return residual(self._sliding, rows, self._parameters, force, self.law, self._stiffness, self.dimension)

    def _apply_fallbacks(self, sample, b, force, counts, rung):
        """Apply the fallback methods to one sample, improving its force, counts and rung in place."""
        best = self._residual(b[[sample]], force[[sample]])[0]
        for candidate, *more, name in self.backend.attempts(b[sample], force[sample].copy()):
            counts[:, sample] += more
            left = self._residual(b[[sample]], candidate[None])[0]
            if left < best:
                best = left
                force[sample], rung[sample] = candidate, name
            if best <= SAFETY * self.tol:
                break


def solve(S, b, mu, law="coulomb", backend="native", tol=1e-10, guess=None, threads=1, dimension=3) -> ContactSolution:
    """Solve one contact problem, or a batch that shares ``S``; see :class:`ContactSolver` for the arguments.

    Examples
    --------
    One contact, pressed together by 1 mm and dragged by 1 mm, slides: the friction force is ``μ f_n``.

    >>> sol = solve(np.eye(3), [-1.0, 1.0, 0.0], mu=0.27)
    >>> sol.force.round(6).tolist()
    [1.0, -0.27, 0.0]
    """
    return ContactSolver(S, mu, law, backend, tol, threads, dimension).solve(b, guess)


def _only(solution: ContactSolution) -> ContactSolution:
    """The only sample of a batch, as scalars and vectors."""

    def first(values):
        value = None if values is None else values[0]
        return value.item() if isinstance(value, np.generic) else value

    return ContactSolution(**{name: first(values) for name, values in vars(solution).items()})


def _refused(solution: ContactSolution, lost) -> ContactSolution:
    """The solution with the lost samples (n,) set to no force and status out of range."""
    status = solution.status.copy()
    status[lost] = Status.OUT_OF_RANGE
    return replace(
        solution,
        force=np.where(lost[:, None], 0.0, solution.force),
        residual=np.where(lost, np.inf, solution.residual),
        converged=solution.converged & ~lost,
        status=status,
    )


def _checked_compliance(S, dimension, semidefinite):
    S = finite("S", S)
    if S.ndim != 2 or S.shape[0] != S.shape[1] or len(S) % dimension:
        rows = "m" if dimension == 1 else "3m"
        raise ValueError(f"S must be square with {rows} rows and columns; got shape {S.shape}")
    if (S.diagonal() < 0.0).any():
        raise ValueError("S must be positive semidefinite; it has a negative diagonal entry")
    if semidefinite:
        return np.ascontiguousarray(S)
    # With thousands of contacts S dominates the memory: allocate as few arrays of its size as possible.
    largest = max(S.max(initial=0.0), -S.min(initial=0.0))
    asymmetry = (S - S.T).max(initial=0.0)  # the difference is antisymmetric, so its maximum suffices
    if asymmetry > ASYMMETRY_REFUSED * largest:
        raise ValueError(
            f"S must be symmetric; it differs from its transpose by {asymmetry / largest:.1e} of its largest entry, "
            f"above the limit of {ASYMMETRY_REFUSED:g}"
        )
    if asymmetry > ASYMMETRY_WARNED * largest:
        warnings.warn(
            f"S differs from its transpose by {asymmetry / largest:.1e} of its largest entry; symmetrised", stacklevel=3
        )
    half = 0.5 * S
    S = np.ascontiguousarray(half + half.T)
    if largest > 0.0 and not _semidefinite(np.divide(S, largest, out=half)):
        raise ValueError(
            f"S must be positive semidefinite; it has an eigenvalue below -{INDEFINITE:g} of its largest entry, so "
            "that some forces would do negative work; check the signs of its rows"
        )
    return S


def _semidefinite(S) -> bool:
    """Whether no eigenvalue lies below -:data:`INDEFINITE`; S is overwritten."""
    from scipy.linalg import cholesky  # slow to import

    S[np.diag_indices(len(S))] += INDEFINITE
    try:
        cholesky(S.T, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError:
        return False
    return True


def _checked_rows(name, value, size):
    value = finite(name, value)
    if value.ndim not in (1, 2) or value.shape[-1] != size:
        raise ValueError(f"{name} must have shape ({size},) or (n, {size}) to match S; got {value.shape}")
    return value
