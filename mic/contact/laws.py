r"""The three contact laws, and the cone that they share.

Contact ``k`` carries the force ``f = (f_n, f_t1, f_t2)`` and the relative displacement ``u = (u_n, u_t1, u_t2)``;
``f_n >= 0`` is compression, ``u_n >= 0`` separation.  With the friction cone ``K`` and its dual ``K*``,

.. math::

    K   = \{f : \|f_t\| \le \mu f_n\},        \qquad
    K^* = \{v : v_n \ge \mu \|v_t\|\},

and ``u = S f + b``, the laws read

=============  ==========================================================================================
frictionless   ``0 <= f_n  ⊥  u_n >= 0`` and ``f_t = 0``
associated     ``K ∋ f  ⊥  u ∈ K*``, the optimality conditions of a second-order cone programme
coulomb        ``K ∋ f  ⊥  u + μ‖u_t‖ n ∈ K*``, Coulomb's law as De Saxcé and Feng (1998) write it
=============  ==========================================================================================

A sliding contact of the associated law opens by ``u_n = μ‖u_t‖`` while it carries load; Coulomb's law keeps it closed.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

__all__ = ["Law", "complementary_displacement", "project_on_cone"]


class Law(str, Enum):
    """Which relation ties the forces to the displacements."""

    FRICTIONLESS = "frictionless"
    ASSOCIATED = "associated"
    COULOMB = "coulomb"


def project_on_cone(x: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Euclidean projection ``P_K`` on the friction cones.

    Parameters
    ----------
    x : (..., m, 3) array
        One vector (n, t1, t2) per contact.
    mu : (m,) array
        Coefficients of friction; ``0`` makes the cone the half-line ``f_n >= 0``.

    Returns
    -------
    (..., m, 3) array
        The nearest points with ``‖f_t‖ <= μ f_n``.
    """
    normal = x[..., 0]
    tangential = np.hypot(x[..., 1], x[..., 2])
    inside = (tangential <= mu * normal) & (normal >= 0.0)
    polar = mu * tangential <= -normal
    # On the cone's surface: f = p (1, μ x_t/‖x_t‖) with p = (x_n + μ‖x_t‖)/(1 + μ²).
    pressure = (normal + mu * tangential) / (1.0 + mu * mu)
    pressure = np.where(inside, normal, np.where(polar, 0.0, pressure))
    shrink = np.where(inside, 1.0, mu * pressure / np.where(tangential > 0.0, tangential, 1.0))
    projected = x * shrink[..., None]
    projected[..., 0] = pressure
    return projected


def complementary_displacement(u: np.ndarray, mu: np.ndarray, law: Law) -> np.ndarray:
    """The displacement that the law makes complementary to the force.

    Parameters
    ----------
    u : (..., m, 3) array
        Relative displacements.
    mu : (m,) array
        Coefficients of friction.
    law : Law
        ``COULOMB`` adds De Saxcé's shift ``μ‖u_t‖`` to the normal component; the others return ``u`` itself.

    Returns
    -------
    (..., m, 3) array
    """
    if law is not Law.COULOMB:
        return u
    shifted = u.copy()
    shifted[..., 0] += mu * np.hypot(u[..., 1], u[..., 2])
    return shifted


from types import SimpleNamespace  # noqa: E402

LAWS = {n: SimpleNamespace(name=n, title=n) for n in ("coulomb", "associated", "frictionless")}
