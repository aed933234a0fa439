"""Strips in contact, built of shells and sparse rows alone; no code of the reduced model takes part.

Strips have ν = 0, so that plates bend as beams do.
"""

from dataclasses import replace

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix, hstack, vstack

from fem_reference.full.contact_law import ContactLaw
from fem_reference.full.equilibrium import Equilibrium, Parts, State
from fem_reference.full.friction import ContactFriction
from fem_reference.shell.part import ShellPart
from mic.compliance.functional import Functionals
from mic.geometry.structured import extrude
from mic.geometry.surface import Patch, Surface

E = 210e3  # MPa


def strip(length, width, thickness, size, z=0.0, start=0.0):
    return ShellPart(Surface(*extrude([(0, z), (width, z)], start, length, size)), thickness, E, 0.0)


def vertex_rows(shell, vertices, direction, side=0, rotation=False):
    """(v, ndof) readings of vertices, on the surface `side` t/2 off the mid-surface."""
    first = np.array([np.argmax((shell.surface.triangles == v).any(axis=1)) for v in vertices])
    corner = np.argmax(shell.surface.triangles[first] == np.asarray(vertices)[:, None], axis=1)
    patches = tuple(Patch(np.array([t]), np.eye(3)[[c]], np.ones(1)) for t, c in zip(first, corner))
    n = len(patches)
    return shell.functional_matrix(
        Functionals(
            patches,
            np.arange(n),
            np.tile(np.asarray(direction, float), (n, 1)),
            np.full(n, rotation),
            np.full(n, float(side)),
            ("",) * n,
        )
    )


def clamped(shell, vertices):
    return vstack(
        [vertex_rows(shell, vertices, axis, rotation=rotation) for rotation in (False, True) for axis in np.eye(3)]
    )


def interleave(*rows):
    """Rows of each contact one after the other: n, t1, t2."""
    stacked = vstack(rows, format="csr")
    m = rows[0].shape[0]
    return stacked[np.arange(len(rows) * m).reshape(len(rows), m).T.ravel()]


def contact_law(friction, gap, stiffness, dimension, penalty=1e8):
    m = len(gap)
    zero = np.zeros((m, dimension))
    rough, stiff = ContactFriction.constant(np.full(m, friction)), np.full(m, stiffness)
    return ContactLaw(rough, np.asarray(gap, float), zero, zero, penalty * stiff, stiff)


def rest(system):
    return State(np.zeros(system.N), np.zeros(system.b), np.zeros((system.m, system.d)))


def bend_leaves(L, b, h, p, pressed_from=0.0):
    """Layered cantilever: two leaves of depth h, pressed together by p from a distance to the root on.

    Returns ``deflection(P, friction, state, anchor)`` under the tip load P, upwards, half on each leaf.
    """
    shells = [strip(L, b, h, 2.5, z) for z in (0.0, h)]
    x = shells[0].surface.points[:, 0]
    root, tip, free = np.flatnonzero(x == 0), np.flatnonzero(x == L), np.flatnonzero(x > 0)
    parts = Parts(shells, MPI.COMM_SELF)
    held = clamped(shells[0], root)
    B = vstack([hstack([held, csr_matrix(held.shape)]), hstack([csr_matrix(held.shape), held])], format="csr")
    axes = ((0, 0, 1), (1, 0, 0), (0, 1, 0))
    C = interleave(
        *(
            hstack([-vertex_rows(shells[0], free, axis, side=1), vertex_rows(shells[1], free, axis, side=-1)])
            for axis in axes
        )
    )
    system = Equilibrium(parts, B, C, 3)
    area = np.zeros(len(x))
    pressed = shells[0].surface.corners[:, :, 0].mean(axis=1) > pressed_from
    np.add.at(area, shells[0].surface.triangles[pressed], shells[0].surface.areas[pressed, None] / 3)
    press = np.concatenate(
        [vertex_rows(shell, np.arange(len(x)), (0, 0, sign)).T @ (p * area) for shell, sign in zip(shells, (1, -1))]
    )
    pull = np.concatenate([vertex_rows(shell, tip, (0, 0, 1)).mean(axis=0).A1 / 2 for shell in shells])

    def deflection(P, friction, state=None, anchor=None):
        law = contact_law(friction, np.full(len(free), -1e-9), E * h, 3)
        if anchor is not None:
            law = replace(law, anchor=anchor)
        state, _ = system.newton(state or rest(system), press + P * pull, np.zeros(system.b), law)
        δ = (C @ state.u).reshape(-1, 3)
        return float(pull @ state.u), state, δ, law.state(δ)

    return deflection
