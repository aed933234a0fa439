r"""Residual of each contact on its own scale.

The certificate's residual relates the errors of all contacts to the energy of all.  A contact whose force is 10⁻¹⁰ of
the largest may violate its law entirely and still pass.  The residual of one contact relates its own error, as a force,
to its own force; or, if it is open, to its own gap, for a contact without force the larger of those with and without
the forces of the others.
With ``ρ_n = 1/S_nn``, ``ρ_t = 2/(S_11 + S_22)`` and the law's opening ``g = u_n - (1 - s) μ‖u_t‖``, the error is

.. math::

    \Phi_n = f_n - \max(a, 0), \quad \Phi_t = f_t - P_{\mu \max(a, 0)}(f_t - \rho_t u_t), \quad a = f_n - \rho_n g,

with ``P_r`` the projection on the disc of radius r.  A large μ does not hide penetration in it, as in the projection on
the cone.

``S f`` is rounded to ``ε |S||f|``, which may exceed the displacement that a small force causes.  Where it could decide,
the rows of these contacts are evaluated in extended precision (``numpy.longdouble``).
"""

from __future__ import annotations

import numpy as np

from mic.contact.laws import Law

__all__ = ["RESOLVED", "as_contacts", "contact_residuals", "displacement_of", "directional_stiffness"]

#: Largest residual of a contact that counts as resolved on its own scale: an order above the default tolerance of the
#: certificate, three below the threshold between stick and slip (:data:`mic.contact.states.ON_CONE`).
RESOLVED = 1e-9
EPS = float(np.finfo(float).eps)
#: Contacts whose rows are evaluated in extended precision at a time.
ROWS_AT_ONCE = 200


def contact_residuals(S, b, parameters, force, law: Law, dimension: int, rho, displacement) -> np.ndarray:
    """(n, m) residuals of the contacts; arguments as :func:`mic.contact.certificate.measure` has them.

    Exact to a few digits above :data:`RESOLVED`; those below are bounds by double precision.
    """
    n, m = len(b), len(S) // dimension
    f, u, b3 = (as_contacts(a, n, m, dimension) for a in (force, displacement, b))
    with np.errstate(all="ignore"):
        found = _relative(f, u, b3[..., 0], law.coefficient(parameters, f[..., 0]), rho, law)
        # Cauchy and Schwarz: |S_kj| ≤ (S_kk S_jj)^½ bounds the terms of a row.
        terms = (np.abs(f) / np.sqrt(rho)).sum(axis=(1, 2))[:, None]
        row = terms * np.sqrt(rho[:, 0]) + rho[:, 0] * np.abs(b3[..., 0])
        loaded = f.any(axis=-1)
        size = np.where(loaded, np.abs(f).max(axis=-1), rho[:, 0] * np.maximum(np.abs(u[..., 0]), np.abs(b3[..., 0])))
        doubtful = (found > RESOLVED) | (EPS * row > RESOLVED * size)
    finite = np.isfinite(u).all(axis=(1, 2))
    found[~finite] = np.inf
    for sample in np.flatnonzero(doubtful.any(axis=1) & finite):
        for own in np.array_split(np.flatnonzero(doubtful[sample]), -(-doubtful[sample].sum() // ROWS_AT_ONCE)):
            found[sample, own] = _exact(S, b[sample], parameters, force[sample], law, dimension, rho, own)
    return found


def as_contacts(a: np.ndarray, n: int, m: int, dimension: int) -> np.ndarray:
    """(n, d m) → (n, m, 3), tangential components zero where there are none."""
    if dimension == 3:
        return a.reshape(n, m, 3)
    full = np.zeros((n, m, 3), dtype=a.dtype)
    full[..., 0] = a
    return full


def directional_stiffness(S: np.ndarray, law: Law, dimension: int) -> np.ndarray:
    """(m, 3) force per displacement of each contact alone; the mean of the others where it has no compliance."""
    own = S.diagonal().reshape(-1, dimension)
    compliance = np.empty((len(own), 3))
    compliance[:, 0] = own[:, 0]
    compliance[:, 1:] = own[:, 1:].mean(axis=1, keepdims=True) if dimension == 3 and law.frictional else own[:, :1]
    for column in compliance.T:
        none = column <= EPS * column.max(initial=0.0)
        column[none] = column[~none].mean() if not none.all() else 1.0
    return 1.0 / compliance


def displacement_of(S: np.ndarray, b: np.ndarray, force: np.ndarray, own: np.ndarray, dimension: int) -> np.ndarray:
    """(k, d) displacements ``S f + b`` of the contacts `own` (k,) in extended precision, for one sample."""
    rows = (dimension * own[:, None] + np.arange(dimension)).ravel()
    acting = np.flatnonzero(force)
    moved = S[np.ix_(rows, acting)].astype(np.longdouble) @ force[acting].astype(np.longdouble)
    return (moved + b[rows]).reshape(len(own), dimension)


def _exact(S, b, parameters, force, law, dimension, rho, own):
    """(k,) residuals of the contacts `own` of one sample, by extended precision."""
    u = displacement_of(S, b, force, own, dimension)
    f, b = (values.reshape(-1, dimension)[own] for values in (force, b))
    f, u, b = (as_contacts(values.reshape(1, -1), 1, len(own), dimension) for values in (f, u, b))
    with np.errstate(all="ignore"):
        mu = law.coefficient(parameters[own], f[..., 0])
        return _relative(f.astype(np.longdouble), u, b[..., 0], mu, rho[own], law)[0]


def _relative(f, u, gap, mu, rho, law):
    """(n, m) errors on the contacts' own scales, as loaded contacts or as open ones, whichever is smaller."""
    if not law.frictional:
        u = u * np.array([1.0, 0.0, 0.0])
    carried = np.sqrt((f * f).sum(axis=-1))
    per_gap = _gap_stiffness(mu, rho, law)
    open_error = carried + per_gap * np.maximum(-law.opening(u, mu), 0.0)
    own_gap = per_gap * np.maximum(np.abs(u[..., 0]), np.where(carried > 0.0, 0.0, np.abs(gap)))
    found = np.minimum(_ratio(_error(f, u, mu, rho, law), carried), _ratio(open_error, own_gap))
    return found.astype(float)


def _ratio(error, size):
    return np.where(error == 0.0, 0.0, error / size)


def _error(f, u, mu, rho, law):
    """(n, m) error of loaded contacts, as a force."""
    pressed = np.maximum(f[..., 0] - rho[:, 0] * law.opening(u, mu), 0.0)
    normal = f[..., 0] - pressed
    if not law.frictional:
        return np.sqrt(normal * normal + (f[..., 1:] ** 2).sum(axis=-1))
    trial = f[..., 1:] - rho[:, 1:] * u[..., 1:]
    size, bound = np.sqrt((trial * trial).sum(axis=-1)), mu * pressed
    held = trial * np.where(size > bound, bound / np.where(size > 0.0, size, 1.0), 1.0)[..., None]
    return np.sqrt(normal * normal + ((f[..., 1:] - held) ** 2).sum(axis=-1))


def _gap_stiffness(mu, rho, law):
    """(n, m) force that closes a unit of the law's opening ``u_n - (1 - s) μ‖u_t‖``, normally or tangentially."""
    slope = (1.0 - law.shift) * mu
    return np.minimum(rho[:, 0], rho[:, 1] / np.where(slope > 0.0, slope, np.finfo(float).tiny))
