"""Interpolates the compliance of a sheet over its thickness.

The stiffness of a sheet of thickness t is ``t K_m + t³ K_b``, membrane and bending, and a functional of a face is
``L_0 + t L_1``. With ``a_j(t) = t²/(t² + λ_j)`` of the sheet's modes,

    t³ H(t) = Σ_j ℓ_j(t) ℓ_j(t)ᵀ a_j(t),        ℓ_j linear in t, λ_j ≥ 0,                                   (1)

is constant or of second degree if bending or stretching dominates. Its poles lie on the imaginary axis, no nearer than
t itself: the polynomial through k Chebyshev points of ``c ± w`` has an error of about ``(w/2c)^k``. The rigid readings
G are linear in t.

References
----------
L. N. Trefethen: Approximation Theory and Approximation Practice. SIAM (2013): chapters 5 (barycentric formula) and 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.errors import ImpossibleSample

__all__ = ["Thicknesses", "chebyshev"]

ERROR = 1e-5  # allowed relative interpolation error of H, by the estimate above
FEWEST, MOST = 3, 9  # thicknesses
BEYOND = 1.001  # factor on the largest thickness up to which the compliance is extrapolated


def chebyshev(low: float, high: float) -> tuple[float, ...]:
    """Chebyshev points between two thicknesses, mm, ascending: as many as :data:`ERROR` requires, an odd number.

    With an odd number the middle is one of them.
    """
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    count = int(np.clip(np.ceil(np.log(ERROR) / np.log(half / (2 * middle))), FEWEST, MOST))
    count += 1 - count % 2
    k = np.arange(count)
    points = middle - half * np.cos(np.pi * (2 * k + 1) / (2 * count))
    points[count // 2] = middle
    return tuple(points.tolist())


@dataclass(frozen=True)
class Thicknesses:
    """Compliance and rigid readings of a part at k thicknesses.

    Attributes
    ----------
    t : (k,) array
        Ascending, mm.
    low, high : float
        Range of thicknesses, mm.
    H : (k, n, n) array
        Compliance at each, as in :class:`mic.compliance.coefficients.InfluenceCoefficients`.
    G : (k, n, 6) array
    """

    t: np.ndarray
    low: float
    high: float
    H: np.ndarray
    G: np.ndarray

    def at(self, thickness: float) -> tuple[np.ndarray, np.ndarray]:
        """H (n, n) and G (n, 6) at a thickness, mm, equation (1).

        Raises
        ------
        ImpossibleSample
            If the thickness is out of range.
        """
        slack = (BEYOND - 1) * self.high
        if not self.low - slack <= thickness <= self.high + slack:
            raise ImpossibleSample(
                f"a thickness of {thickness:.6g} mm lies beyond {self.low:.6g} to {self.high:.6g} mm, the range of the "
                "computed compliance; give the deviation a larger sigma, or truncated"
            )
        share = self._shares(thickness)
        scaled = share * (self.t / thickness) ** 3
        return np.tensordot(scaled, self.H, 1), np.tensordot(share, self.G, 1)

    def _shares(self, thickness: float) -> np.ndarray:
        """(k,) Lagrange's polynomials at a thickness."""
        others = ~np.eye(len(self.t), dtype=bool)
        return np.array(
            [np.prod((thickness - self.t[row]) / (node - self.t[row])) for row, node in zip(others, self.t)]
        )
