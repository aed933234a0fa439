"""Surrogate of a model: smoothing spline through evaluated samples (``scipy.interpolate.RBFInterpolator``).

The cubic polyharmonic spline [1]_ approximates the evaluations:

    h(z) = a + B z + Σ_i w_i ‖D (z − z_i)‖³,        Σ_i w_i = 0,  Σ_i w_i z_i = 0,

which reproduces linear functions exactly. Changes of contact state make h slightly non-smooth almost everywhere, so the
spline is smoothed according to the distance between neighbours. D scales directions by their influence.

Leave-one-out errors take one inverse [2]_ (not in scipy): with M the matrix of the equations, the error at z_i is
w_i / (M⁻¹)_ii. Interpreted as the mean of a Gaussian random field, the spline has the relative standard deviation
√(δ − bᵀ M⁻¹ b) between the z_i, with right-hand side b and damping δ, and (M⁻¹)_ii^−½ at an omitted sample.

References
----------
.. [1] J. Duchon: Splines minimizing rotation-invariant semi-norms in Sobolev spaces, in: Constructive Theory of
       Functions of Several Variables, Springer (1977) 85-100.
.. [2] S. Rippa: An algorithm for selecting a good value for the parameter c in radial basis function interpolation,
       Adv. Comput. Math. 11 (1999) 193-210.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

__all__ = ["Emulator"]

DAMPED = 0.1  # of the cube of the distance to the nearest neighbour
LEAST = 0.1  # of the largest influence: lower bound for every direction
STEP = 1e-4  # of central differences


class Emulator:
    """A smoothing spline through evaluated samples.

    Parameters
    ----------
    z : (n, p) array
        Standard normal numbers; n > p.
    h : (n, k) array
        Outputs there.

    Attributes
    ----------
    scale : (p,) array
        Scale of each number in distances.
    damping : float
        Smoothing parameter of the spline.
    """

    def __init__(self, z: np.ndarray, h: np.ndarray):
        size = np.where(h.std(axis=0) > 0, h.std(axis=0), 1.0)
        slope = np.linalg.lstsq(np.column_stack([np.ones(len(z)), z]), h / size, rcond=None)[0][1:]
        influence = np.sqrt((slope**2).mean(axis=1))
        self.scale = np.sqrt(np.maximum(influence / max(influence.max(), 1e-300), LEAST))
        nearest = KDTree(z * self.scale).query(z * self.scale, 2)[0][:, 1]
        self._points, self._values = z * self.scale, h
        self.damping = DAMPED * float(np.median(nearest)) ** 3
        from scipy.interpolate import RBFInterpolator  # slow to import, and most commands fit no spline

        self._spline = RBFInterpolator(self._points, h, smoothing=self.damping, kernel="cubic", degree=1)

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """(m, k) outputs at numbers (m, p)."""
        return np.asarray(self._spline(z * self.scale))

    def leave_one_out(self) -> tuple[np.ndarray, np.ndarray]:
        """Leave-one-out errors (n, k), and their relative standard deviations (n,) as in :meth:`relative_sigma`."""
        n = len(self._points)
        diagonal = np.diag(self._inverse)[:n, None]
        return self._inverse[:n, :n] @ self._values / diagonal, 1 / np.sqrt(diagonal[:, 0])

    def relative_sigma(self, z: np.ndarray) -> np.ndarray:
        """(m,) relative standard deviations of the spline at numbers (m, p)."""
        right = self._right_side(z * self.scale)
        square = self.damping - np.einsum("ij,ij->i", right @ self._inverse, right)
        return np.sqrt(np.maximum(square, self.damping))

    @cached_property
    def _inverse(self) -> np.ndarray:
        n, p = self._points.shape
        equations = np.zeros((n + p + 1, n + p + 1))
        equations[:n] = self._right_side(self._points)
        equations[n:, :n] = equations[:n, n:].T
        equations[:n, :n] += self.damping * np.eye(n)
        return np.linalg.inv(equations)

    def _right_side(self, z: np.ndarray) -> np.ndarray:
        return np.column_stack([cdist(z, self._points) ** 3, np.ones(len(z)), z])

    def slopes(self, z: np.ndarray) -> np.ndarray:
        """(m, k, p) derivatives at numbers (m, p), by central differences."""
        m, p = z.shape
        moved = z[:, None, :] + STEP * np.concatenate([np.eye(p), -np.eye(p)])
        h = self(moved.reshape(-1, p)).reshape(m, 2, p, -1)
        return np.swapaxes(h[:, 0] - h[:, 1], 1, 2) / (2 * STEP)
