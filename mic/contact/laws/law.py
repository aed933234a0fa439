r"""Contact laws: the cone of admissible forces, and the displacement that is complementary to the force.

Contact ``k`` carries the force ``f = (f_n, f_t1, f_t2)`` and the relative displacement ``u = (u_n, u_t1, u_t2)``;
``f_n >= 0`` is compression, ``u_n >= 0`` separation.  With the friction cone ``K`` and its dual ``K*``,

.. math::

    K   = \{f : \|f_t\| \le \mu f_n\},        \qquad
    K^* = \{v : v_n \ge \mu \|v_t\|\},

a law reads

.. math::

    K \ni f \perp \hat u \in K^*, \qquad \hat u = u + s \, \mu \|u_t\| \, n,

with its own share ``s`` of De Saxcé's shift.  A contact that slips under load opens by ``(1 - s) μ‖u_t‖``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mic.contact.friction import Friction
from mic.errors import ArgumentError

__all__ = ["LAWS", "Law", "find"]

#: All laws by name, in the order of reports; filled by :mod:`mic.contact.laws`.
LAWS: dict[str, Law] = {}


def _one_coefficient(friction: Friction) -> np.ndarray:
    return friction.coefficient[:, None]


def _scaled_coefficient(parameters, d_n, d_t):
    return parameters * (d_n / d_t)[:, None]


def _constant(parameters, normal):
    return np.broadcast_to(parameters[:, 0], normal.shape)


def _rigid(friction):
    return np.zeros(len(friction))


@dataclass(frozen=True, eq=False)
class Law:
    """A contact law.

    Attributes
    ----------
    name : str
        The name in scenes and calls.
    title : str
        Explanation in one line.
    colour, mark : str
        Colour ``#rrggbb`` and Matplotlib marker in pictures.
    frictional : bool
        Whether tangential forces exist.  If not, the law is ``0 <= f_n ⊥ u_n >= 0``, ``f_t = 0``.
    shift : float
        Share ``s`` of ``μ‖u_t‖`` that the law adds to ``u_n``: 1 keeps slipping contacts closed, 0 makes the problem
        convex.
    equation : function or None
        The equation ``Φ(y, w) = 0`` of a contact in scaled force ``y`` and displacement ``w``, for Newton's method; see
        :func:`mic.contact.laws.coulomb.equation`.  Numba compiles it, so it may call only ``math``, ``numpy`` and
        compiled functions.  None only for a law without friction.
    gauss_seidel : bool
        Whether the single-contact solution of the Gauss-Seidel sweeps satisfies this law for a fixed coefficient.
    followed : bool
        Whether incremental solutions of the law converge with the step size, so that its path can be followed.
    paper_backend : str
        The backend that the paper used for it; native if none.
    reads : {"", "pressure", "compliance"}
        The field of :class:`mic.contact.friction.Friction` that the law needs beyond the coefficient; a contact without
        it obeys Coulomb's law.
    parameters : function
        ``parameters(friction)``: the (m, p) array for the equation, the coefficient in column 0.
    scaled : function
        ``scaled(parameters, d_n, d_t)``: the same for the scaled force ``y_n = f_n/d_n``, ``y_t = f_t/d_t``; both (m,).
    coefficient : function
        ``coefficient(parameters, normal)``: μ (..., m) under the normal forces (..., m), scaled as the parameters are.
    slope : function
        ``slope(parameters, normal)``: ``g'(f_n)`` of the bound ``g(f_n) = μ f_n``, scaled likewise.
    compliance : function
        ``compliance(friction)``: (m,) tangential compliance ``c`` in series with the slider [length / force].  The law
        ties the force to the slider's displacement ``w_t = u_t + c f_t``, see :mod:`mic.contact.laws.micro_slip`.

    Raises
    ------
    ValueError
        If a law with friction has no equation.
    """

    name: str
    title: str
    colour: str
    mark: str
    frictional: bool = True
    shift: float = 0.0
    equation: Callable | None = None
    gauss_seidel: bool = False
    followed: bool = False
    paper_backend: str = "native"
    reads: str = ""
    parameters: Callable[[Friction], np.ndarray] = _one_coefficient
    scaled: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] = _scaled_coefficient
    coefficient: Callable[[np.ndarray, np.ndarray], np.ndarray] = _constant
    slope: Callable[[np.ndarray, np.ndarray], np.ndarray] = _constant
    compliance: Callable[[Friction], np.ndarray] = _rigid

    def __post_init__(self):
        if self.frictional and self.equation is None:
            raise ValueError(f"law {self.name} has friction and needs an equation")

    def __eq__(self, other):
        return isinstance(other, Law) and self.name == other.name

    def __hash__(self):
        return hash(self.name)

    @property
    def coefficient_varies(self) -> bool:
        """Whether the coefficient changes with the normal force."""
        return self.coefficient is not _constant

    def projection(self, x: np.ndarray, mu: np.ndarray) -> np.ndarray:
        """Euclidean projection ``P_K`` on the friction cones.

        Parameters
        ----------
        x : (..., m, 3) array
            One vector (n, t1, t2) per contact.
        mu : (..., m) array
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

    def complementary(self, u: np.ndarray, mu: np.ndarray) -> np.ndarray:
        """The displacement ``û = u + s μ‖u_t‖ n`` that is complementary to the force.

        Parameters
        ----------
        u : (..., m, 3) array
            Relative displacements.
        mu : (..., m) array
            Coefficients of friction.

        Returns
        -------
        (..., m, 3) array
            ``u`` itself if the law has no shift.
        """
        if not self.shift:
            return u
        shifted = u.copy()
        shifted[..., 0] += self.shift * mu * np.hypot(u[..., 1], u[..., 2])
        return shifted

    def bound(self, normal: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Largest tangential force ``g(f_n) = μ f_n`` under the normal forces (..., m), with :attr:`parameters`."""
        return self.coefficient(parameters, normal) * normal

    def bound_slope(self, normal: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """``g'(f_n)`` under the normal forces (..., m), with :attr:`parameters`."""
        return self.slope(parameters, normal)

    def opening(self, u: np.ndarray, mu: np.ndarray) -> np.ndarray:
        """``û_n - μ‖u_t‖ = u_n - (1 - s) μ‖u_t‖``, non-negative exactly if the law admits zero force.

        Parameters
        ----------
        u : (..., m, 3) array
            Relative displacements.
        mu : (..., m) array
            Coefficients of friction.

        Returns
        -------
        (..., m) array
        """
        if self.shift == 1.0:
            return u[..., 0]
        return u[..., 0] - (1.0 - self.shift) * mu * np.hypot(u[..., 1], u[..., 2])


def find(law: str | Law) -> Law:
    """The law with this name; a :class:`Law` is returned unchanged.

    Raises
    ------
    ValueError
        With the names of all laws, if the name is unknown.
    """
    if isinstance(law, Law):
        return law
    try:
        return LAWS[law]
    except (KeyError, TypeError):
        raise ArgumentError(f"law must be one of {', '.join(LAWS)}; got {law!r}") from None
