"""What a model answers between the assemblies that it was asked for, in no time.

A cubic spline in several dimensions [1]_ goes through, or close by, what was evaluated:

    h(z) = a + B z + Σ_i w_i ‖D (z − z_i)‖³,        Σ_i w_i = 0,  Σ_i w_i z_i = 0,

so that whatever is linear is met exactly. Contacts that change their state bend h a little almost everywhere; weights
are damped as far as the distances between neighbours make sense of. D stretches the directions that matter.

How far it misses each of the points that it goes by, were it made of the others alone, takes one inverse [2]_: with M
the matrix of its equations, the one at z_i is missed by w_i / (M⁻¹)_ii. As the mean of a random field the spline also
has a standard deviation, in units of its own: √(δ − bᵀ M⁻¹ b) between the z_i, b the right side there and δ the
damping, and (M⁻¹)_ii^−½ at one that is left out.

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
from scipy.interpolate import RBFInterpolator
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

__all__ = ["Emulator"]

DAMPED = 0.1  # of the cube of the distance to the nearest neighbour
LEAST = 0.1  # of the largest: so much every direction matters
STEP = 1e-4  # to either side, for slopes


class Emulator:
    """A spline through what was evaluated.

    Parameters
    ----------
    z : (n, p) array
        Standard normal numbers; n > p.
    h : (n, k) array
        What was found there.

    Attributes
    ----------
    stretch : (p,) array
        By which each number is multiplied before distances are taken.
    damping : float
        What the spline through the stretched numbers is smoothed with.
    """

    def __init__(self, z: np.ndarray, h: np.ndarray):
        size = np.where(h.std(axis=0) > 0, h.std(axis=0), 1.0)
        slope = np.linalg.lstsq(np.column_stack([np.ones(len(z)), z]), h / size, rcond=None)[0][1:]
        steep = np.sqrt((slope**2).mean(axis=1))
        self.stretch = np.sqrt(np.maximum(steep / max(steep.max(), 1e-300), LEAST))
        nearest = KDTree(z * self.stretch).query(z * self.stretch, 2)[0][:, 1]
        self._known, self._answers = z * self.stretch, h
        self.damping = DAMPED * float(np.median(nearest)) ** 3
        self._spline = RBFInterpolator(self._known, h, smoothing=self.damping, kernel="cubic", degree=1)

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """(m, k) at numbers (m, p)."""
        return np.asarray(self._spline(z * self.stretch))

    def left_out(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, k) what was found at each z_i, less what the others alone would tell, and (n,) how far off these are, in
        the units of :meth:`apart`."""
        n = len(self._known)
        own = np.diag(self._inverse)[:n, None]
        return self._inverse[:n, :n] @ self._answers / own, 1 / np.sqrt(own[:, 0])

    def apart(self, z: np.ndarray) -> np.ndarray:
        """(m,) standard deviations of the spline at numbers (m, p), but for a factor: how far off what is known is."""
        right = self._right(z * self.stretch)
        square = self.damping - np.einsum("ij,ij->i", right @ self._inverse, right)
        return np.sqrt(np.maximum(square, self.damping))

    @cached_property
    def _inverse(self) -> np.ndarray:
        n, p = self._known.shape
        equations = np.zeros((n + p + 1, n + p + 1))
        equations[:n] = self._right(self._known)
        equations[n:, :n] = equations[:n, n:].T
        equations[:n, :n] += self.damping * np.eye(n)
        return np.linalg.inv(equations)

    def _right(self, z: np.ndarray) -> np.ndarray:
        return np.column_stack([cdist(z, self._known) ** 3, np.ones(len(z)), z])

    def slopes(self, z: np.ndarray) -> np.ndarray:
        """(m, k, p) derivatives there."""
        m, p = z.shape
        moved = z[:, None, :] + STEP * np.concatenate([np.eye(p), -np.eye(p)])
        h = self(moved.reshape(-1, p)).reshape(m, 2, p, -1)
        return np.swapaxes(h[:, 0] - h[:, 1], 1, 2) / (2 * STEP)
