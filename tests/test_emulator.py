"""The spline emulator: exact for linear functions, better with more points elsewhere."""

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from mic.statistics.emulator import Emulator


@pytest.fixture
def z():
    return np.random.default_rng(0).standard_normal((60, 3))


def test_linear_functions_and_their_slopes_are_exact(z):
    B, a = np.array([[1.0, -2.0], [0.0, 3.0], [0.5, 0.0]]), np.array([4.0, -1.0])
    spline, there = Emulator(z[:6], z[:6] @ B + a), 2 * z[10:]
    np.testing.assert_allclose(spline(there), there @ B + a, atol=1e-10)
    np.testing.assert_allclose(spline.slopes(there), np.tile(B.T, (len(there), 1, 1)), atol=1e-6)


def test_the_emulator_does_not_depend_on_scale(z):
    """Assemblies close to each other are not smoothed, and units do not matter."""
    h = np.sin(z[:, :1]) + z[:, 1:2] * z[:, 2:]
    there = np.random.default_rng(1).standard_normal((20, 3))
    large = Emulator(z, h)(there)
    np.testing.assert_allclose(Emulator(1e-3 * z, h)(1e-3 * there), large, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(Emulator(z, 1e-4 * h)(there), 1e-4 * large, rtol=1e-8, atol=1e-12)


def test_leave_one_out_errors_equal_those_of_a_refit(z):
    """The distance to the others has the same units as elsewhere."""
    h = np.column_stack([np.maximum(z[:, 0], 0.2), z[:, 1] ** 2])
    whole, own = Emulator(z, h), np.arange(len(z)) != 7
    missed, apart = whole.leave_one_out()
    alone = RBFInterpolator((z * whole.scale)[own], h[own], smoothing=whole.damping, kernel="cubic", degree=1)
    np.testing.assert_allclose(missed[7], h[7] - alone((z * whole.scale)[[7]])[0], rtol=1e-8)
    near = whole.relative_sigma(np.stack([z[7], z[7] + 0.5, z[7] + 3.0]))
    assert near[0] < near[1] < near[2] and near[0] < apart[7]
