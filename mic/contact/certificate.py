r"""Residual of a contact law: one scale-free number, and the violations of its conditions.

With ``u = S f + b`` and ``û`` the displacement that the law makes complementary to the force (:mod:`mic.contact.laws`),
``f`` is a solution exactly when it is a fixed point of the projection,

.. math::

    F_k(f) = f_k - P_K\bigl(f_k - \rho_k \hat u_k\bigr) = 0, \qquad \rho_k = 1 / \|S_{kk}\|_2 .

``ρ_k`` converts a displacement into the force that causes it at that contact, so every term is a force.  The residual
is

.. math::

    r = \frac{\|D^{-1} F(f)\|}{\max\bigl((f^T S f)^{1/2}, \|D^{-1} F(0)\|\bigr)}, \qquad D_k = \rho_k^{1/2} .

``D⁻¹`` makes contacts of different compliance commensurate: ``‖D⁻¹ f‖²`` is twice the energy that ``f`` would store in
the contacts' own compliances, as ``fᵀ S f`` is twice the energy that it does store.  ``F(0)`` holds the force
of each overlapping contact alone under ``b``; open contacts have none, so that a wide gap cannot hide an error
elsewhere.  Hence

- ``r`` does not change with the units of force or length;
- the zero force has ``r = 1`` if any contact overlaps, and ``r = 0``, defined as 0/0, if all are open;
- forces that grow without bound and cause no displacement, as iterations produce for infeasible problems, do not make
  ``r`` small, as they would if ``‖D⁻¹ f‖`` were the scale; nor does rounding: ``‖D⁻¹ F(f)‖`` is at least
  ``ε ‖D⁻¹ f‖``, with ε the relative precision of a double.

Where the coefficient depends on the normal force, ``K_k`` is the cone with the coefficient at ``f_k``: a force
satisfies such a law exactly if it satisfies Coulomb's with these coefficients.  If a spring is in series with the
slider, ``u`` is the slider's displacement ``S' f + b``, ``S' = S + C`` (:mod:`mic.contact.laws.micro_slip`), and ``S'``
replaces ``S`` in ``ρ`` and in the energy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mic.contact.contact_residual import as_contacts, contact_residuals, directional_stiffness
from mic.contact.friction import Friction
from mic.contact.laws import Law, find
from mic.contact.units import out_of_range, unit
from mic.system.matrix_product import product

__all__ = ["Certificate", "certify", "contact_stiffness", "in_units", "residual", "series_compliance"]

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Certificate:
    """Residual and violations of a force; scalars for one sample, (n,) arrays for a batch, beside `contact_residual`.

    The residual is that of the requested law.  The other four measure Coulomb's conditions (9) and (10) with the
    friction bound of the law, so that they show how a solution of ``associated`` violates them.

    Attributes
    ----------
    residual : float or (n,) array
        Scale-free natural-map residual [1].
    penetration : float or (n,) array
        Largest overlap ``max(0, -u_n)`` [length].
    cone_violation : float or (n,) array
        Largest excess ``‖f_t‖ - μ f_n``, never negative [force].
    complementarity : float or (n,) array
        Largest ``|f_n u_n|``: force across a gap [force × length].
    slip_error : float or (n,) array
        Largest ``|μ f_n ‖u_t‖ + f_t·u_t|``, the work by which friction fails to oppose slip [force × length].
    contact_residual : (m,) or (n, m) array
        Error of each contact, relative to its own force or, if it is open, to its own gap [1]; see
        :mod:`mic.contact.contact_residual`. None if the contacts are not certified one by one.
    """

    residual: np.ndarray
    penetration: np.ndarray
    cone_violation: np.ndarray
    complementarity: np.ndarray
    slip_error: np.ndarray
    contact_residual: np.ndarray | None


def contact_stiffness(S: np.ndarray, law: Law, dimension: int = 3) -> np.ndarray:
    """``ρ_k = 1/‖S_kk‖₂`` per contact, with ``S_kk`` the normal entry alone for the frictionless law.

    A contact whose block is zero has no compliance and takes the mean of the others.

    Returns
    -------
    (m,) array
        Stiffness [force / length]; one everywhere if ``S`` has no diagonal block at all.
    """
    m = len(S) // dimension
    blocks = S.reshape(m, dimension, m, dimension)[np.arange(m), :, np.arange(m), :]
    if not law.frictional:
        blocks = blocks[:, :1, :1]
    compliance = np.linalg.norm(blocks, 2, axis=(1, 2)) if m else np.zeros(0)
    vanishing = compliance <= np.finfo(float).eps * compliance.max(initial=0.0)
    if vanishing.all():
        return np.ones(m)
    compliance[vanishing] = compliance[~vanishing].mean()
    return 1.0 / compliance


def certify(S, b, mu, force, law: str | Law = "coulomb", dimension: int = 3) -> Certificate:
    """Certificate of a force for the contact problem ``(S, b, mu)``.

    Parameters
    ----------
    S : (3m, 3m) array
        Compliance, symmetric positive semidefinite, contact by contact in the order n, t1, t2 [length / force].
    b : (3m,) or (n, 3m) array
        Relative displacements without contact forces, gap included [length].
    mu : float, (m,) array or Friction
        Coefficients of friction, or :class:`mic.contact.friction.Friction`; ignored by the frictionless law.
    force : array shaped like ``b``
        Contact forces [force].
    law : str or Law
        A name in :data:`mic.contact.laws.LAWS`, or the law itself.
    dimension : {3, 1}
        1 if ``S`` and ``b`` hold only the normal rows, (m, m) and (n, m).

    Returns
    -------
    Certificate
        Scalars if ``b`` is one sample, (n,) arrays otherwise.  A force that is not finite has an infinite residual.
    """
    law = find(law)
    S, b, force = (np.asarray(a, dtype=float) for a in (S, b, force))
    m = len(S) // dimension
    friction = Friction.of(mu if law.frictional else 0.0, m)
    series = series_compliance(law, friction, dimension)
    S = S + np.diag(series)
    rows, forces, parameters = np.atleast_2d(b), np.atleast_2d(force), law.parameters(friction)
    length, compliance = np.ones(len(rows)), 1.0
    if (out_of_range(rows) | out_of_range(S.ravel())).any() and not law.reads:
        length, compliance = unit(rows), float(unit(S.ravel()))
    S, rows, forces = S / compliance, rows / length[:, None], forces * (compliance / length)[:, None]
    stiffness = contact_stiffness(S, law, dimension)
    rho = directional_stiffness(S, law, dimension)
    certificate, _ = measure(S, rows, parameters, forces, law, stiffness, dimension, series, rho)
    certificate = replace(certificate, **in_units(certificate, length, length / compliance))
    if b.ndim == 2:
        return certificate
    one = {name: values[0] for name, values in vars(certificate).items()}
    return Certificate(**{name: value.item() if value.ndim == 0 else value for name, value in one.items()})


def in_units(scaled: Any, length: np.ndarray, force: np.ndarray) -> dict[str, np.ndarray]:
    """Violations (n,) measured in units of these lengths and forces (n,), converted to the units of the caller."""
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):  # length times force may overflow
        work = length * force
        units = {"penetration": length, "cone_violation": force, "complementarity": work, "slip_error": work}
        return {name: getattr(scaled, name) * factor for name, factor in units.items()}


def series_compliance(law: Law, friction: Friction, dimension: int = 3) -> np.ndarray:
    """(d m,) diagonal of ``C = diag(0, c, c)``, contact by contact: compliance in series with the sliders."""
    series = np.zeros((len(friction), dimension))
    series[:, 1:] = law.compliance(friction)[:, None]
    return series.ravel()


def measure(S, b, parameters, force, law, stiffness, dimension, series, rho):
    """Certificate of a batch, for checked arguments and ``S`` that includes the ``series`` compliance.

    Each contact is certified with its ``rho``, :func:`mic.contact.contact_residual.directional_stiffness`, unless it is
    None. Returns the certificate and the displacement of the contacts (n, d m), without ``series``.
    """
    displacement = product(force, S) + b
    found = residual(S, b, parameters, force, law, stiffness, dimension, displacement)
    each = None if rho is None else contact_residuals(S, b, parameters, force, law, dimension, rho, displacement)
    n, m = len(b), len(S) // dimension
    f, u = (as_contacts(a, n, m, dimension) for a in (force, displacement))
    if not law.frictional:
        u = u * [1.0, 0.0, 0.0]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        slip = np.hypot(u[..., 1], u[..., 2])
        traction = np.hypot(f[..., 1], f[..., 2])
        bound = law.coefficient(parameters, f[..., 0]) * f[..., 0]
        work = bound * slip + f[..., 1] * u[..., 1] + f[..., 2] * u[..., 2]
        certificate = Certificate(
            residual=found,
            penetration=np.max(np.maximum(0.0, -u[..., 0]), axis=1, initial=0.0),
            cone_violation=np.max(traction - bound, axis=1, initial=0.0),
            complementarity=np.max(np.abs(f[..., 0] * u[..., 0]), axis=1, initial=0.0),
            slip_error=np.max(np.abs(work), axis=1, initial=0.0),
            contact_residual=each,
        )
    return certificate, displacement - force * series if series.any() else displacement


def residual(S, b, parameters, force, law, stiffness, dimension, displacement=None) -> np.ndarray:
    """(n,) residuals alone, see :func:`measure`; ``displacement`` (n, d m) is ``S f + b``, if known."""
    displacement = product(force, S) + b if displacement is None else displacement
    n, m = len(b), len(S) // dimension
    f, u, u0 = (as_contacts(a, n, m, dimension) for a in (force, displacement, b))
    # The force and zero force together, which is faster.
    both, moved = np.concatenate([f, np.zeros_like(f)]), np.concatenate([u, u0])
    μ = law.coefficient(parameters, both[..., 0])
    if not law.frictional:
        moved *= [1.0, 0.0, 0.0]

    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        value = both - law.projection(both - stiffness[:, None] * law.complementary(moved, μ), μ)
        # Free contacts satisfy every law exactly: avoid rounding.
        free = (both == 0.0).all(-1) & (law.opening(moved, μ) >= 0.0)
        own = np.concatenate([np.where(free[..., None], 0.0, value), f])
        norm = np.sqrt(np.einsum("nki,nki,k->n", own, own, 1.0 / stiffness))
        error, least, size = norm[:n], norm[n : 2 * n], norm[2 * n :]
        # If forces are so large that ρ û is lost to rounding, F would be zero for any displacements.
        error = np.maximum(error, EPS * size)
        # Redundant contacts may carry large forces without energy: exclude their rounding errors.
        energy = np.einsum("ni,ni->n", force, displacement - b) - 4.0 * S.shape[0] * EPS * size**2
        scale = np.maximum(np.sqrt(np.maximum(energy, 0.0)), least)
        found = np.divide(error, scale, out=np.zeros(n), where=error != 0.0)
        found[~np.isfinite(found)] = np.inf
    return found
