"""Coulomb's law ``K ∋ f ⊥ u + μ‖u_t‖ n ∈ K*``: a contact that slips stays closed, and friction opposes its slip."""

import math

from mic.contact.laws.law import Law
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["COULOMB", "equation"]


def equation(parameters, y, w, phi, A, B, state, derivative):
    """The contacts' equation ``Φ(y, w) = 0`` (Alart and Curnier 1991), and its derivative ``dΦ = A dy + B dw``.

    With ``a = y_n - w_n`` and ``v = y_t - w_t``: ``Φ_n = y_n - max(a, 0)`` and ``Φ_t = y_t - P_ball(μ max(a, 0))(v)``.

    Parameters
    ----------
    parameters : (m, p) array
        The law's parameters in scaled variables, contact by contact; ``μ`` first.
    y, w : (3m,) array
        Scaled forces and displacements (n, t1, t2).
    phi : (3m,) array
        Receives ``Φ`` of the slipping contacts.  For the others it is the same under every law: ``Φ = y`` if open,
        ``Φ = w`` if stuck.
    A, B : (m, 3, 3) array
        Receive the derivative of the slipping contacts if `derivative` is set; otherwise empty.
    state : (m,) int array
        Receives OPEN, STICK or SLIP.
    derivative : bool
    """
    for k in range(len(state)):
        i = 3 * k
        mu = parameters[k, 0]
        a = y[i] - w[i]
        v1, v2 = y[i + 1] - w[i + 1], y[i + 2] - w[i + 2]
        t = math.sqrt(v1 * v1 + v2 * v2)
        if a <= 0.0:
            state[k] = OPEN
        elif t <= mu * a:
            state[k] = STICK
        else:
            state[k] = SLIP
            e1, e2 = v1 / t, v2 / t
            phi[i] = w[i]  # y_n - a
            phi[i + 1] = y[i + 1] - mu * a * e1
            phi[i + 2] = y[i + 2] - mu * a * e2
            if derivative:
                # B: derivative of (a, P_ball(μ a)(v)) by y - w; A = I - B.
                r = mu * a / t
                B[k, 0, 0], B[k, 0, 1], B[k, 0, 2] = 1.0, 0.0, 0.0
                B[k, 1, 0], B[k, 1, 1], B[k, 1, 2] = mu * e1, r - r * e1 * e1, -r * e1 * e2
                B[k, 2, 0], B[k, 2, 1], B[k, 2, 2] = mu * e2, -r * e1 * e2, r - r * e2 * e2
                for row in range(3):
                    for column in range(3):
                        A[k, row, column] = -B[k, row, column]
                    A[k, row, row] += 1.0


COULOMB = Law(
    name="coulomb",
    title="Coulomb's law: slipping contacts stay closed, and friction opposes their slip.",
    colour="#0072b2",
    mark="o",
    shift=1.0,
    equation=equation,
    gauss_seidel=True,
    followed=True,
)
