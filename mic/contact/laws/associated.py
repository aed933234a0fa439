"""The associated law ``K ∋ f ⊥ u ∈ K*``: the optimality conditions of the second-order cone programme (13).

A contact that slips opens by ``u_n = μ‖u_t‖`` while it carries load.
"""

import math

from mic.contact.laws.law import Law
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["ASSOCIATED", "equation"]


def equation(parameters, y, w, phi, A, B, state, derivative):
    """``Φ = y - P_K(y - w)``, and its derivative ``dΦ = A dy + B dw``.

    With ``a = y_n - w_n``, ``v = y_t - w_t`` and, if ``y - w`` lies outside both the cone and its polar,
    ``P_K(y - w) = p (1, μ v/‖v‖)``, ``p = (a + μ‖v‖)/(1 + μ²)``.  Arguments as in
    :func:`mic.contact.laws.coulomb.equation`.
    """
    for k in range(len(state)):
        i = 3 * k
        mu = parameters[k, 0]
        a = y[i] - w[i]
        v1, v2 = y[i + 1] - w[i + 1], y[i + 2] - w[i + 2]
        t = math.sqrt(v1 * v1 + v2 * v2)
        if mu * t <= -a:
            state[k] = OPEN
        elif t <= mu * a:
            state[k] = STICK
        else:
            state[k] = SLIP
            e1, e2 = v1 / t, v2 / t
            p = (a + mu * t) / (1.0 + mu * mu)
            phi[i] = y[i] - p
            phi[i + 1] = y[i + 1] - mu * p * e1
            phi[i + 2] = y[i + 2] - mu * p * e2
            if derivative:
                # B: derivative of P_K by y - w; A = I - B.
                r = mu * p / t
                g = 1.0 / (1.0 + mu * mu)
                h = mu * g
                c = mu * h - r
                B[k, 0, 0], B[k, 0, 1], B[k, 0, 2] = g, h * e1, h * e2
                B[k, 1, 0], B[k, 1, 1], B[k, 1, 2] = mu * g * e1, r + c * e1 * e1, c * e1 * e2
                B[k, 2, 0], B[k, 2, 1], B[k, 2, 2] = mu * g * e2, c * e1 * e2, r + c * e2 * e2
                for row in range(3):
                    for column in range(3):
                        A[k, row, column] = -B[k, row, column]
                    A[k, row, row] += 1.0


ASSOCIATED = Law(
    name="associated",
    title="The cone programme (13) of the paper, under which slipping contacts open.",
    colour="#d55e00",
    mark="s",
    shift=0.0,
    equation=equation,
    paper_backend="ecos",
)
