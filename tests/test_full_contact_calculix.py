"""Frictional contact against CalculiX: strips pressed over half their length, friction that gives way little by
little."""

import numpy as np
import pytest
from support.shells import needs_ccx
from support.strips import E, bend_leaves

from fem_reference.peers.calculix_contact import leaves

pytestmark = [pytest.mark.fem, needs_ccx]

LENGTH, WIDTH, DEPTH, PRESSURE, FRICTION = 100.0, 5.0, 2.0, 1.0, 0.3
SLIP_LOAD = 4 / 3 * FRICTION * PRESSURE * WIDTH * DEPTH


def test_partial_slip_of_half_pressed_leaves():
    loads = np.array([0.5, 2.0]) * SLIP_LOAD
    peer = leaves(LENGTH, WIDTH, DEPTH, E, FRICTION, PRESSURE, LENGTH / 2, loads, (10, 2))
    deflection = bend_leaves(LENGTH, WIDTH, DEPTH, PRESSURE, LENGTH / 2)
    ours, state, anchor = [], None, None
    for load in (0.0, *loads):
        δ, state, anchor, _ = deflection(load, FRICTION, state, anchor)
        ours.append(δ)
    np.testing.assert_allclose(ours[1:], peer, rtol=0.015)
    frictionless = 2 * LENGTH**3 * loads / (E * WIDTH * DEPTH**3)
    assert (np.abs(frictionless / peer - 1) > 0.05).all()
