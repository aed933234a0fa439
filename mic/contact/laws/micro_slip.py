r"""Coulomb's slider behind a tangential spring: a contact yields before it slips (a Jenkins element at each contact).

A contact of area ``A`` and tangential stiffness ``k_t`` per area has the compliance ``c = 1/(k_t A)``.  Its relative
displacement ``u_t`` is the sum of the slider's, ``w_t``, and of the spring's.  The force acts on the second body and
holds it back, so that the spring has moved by ``-c f_t``: a stuck contact (``w_t = 0``) moved by ``u_t`` answers with
``f_t = -u_t/c``.  Hence

.. math::

    w_t = u_t + c f_t, \qquad w = S f + b + C f = S' f + b, \qquad S' = S + C, \quad C_k = \mathrm{diag}(0, c, c),

and Coulomb's law holds between ``f`` and ``w``: the same cone, the same certificate and the same solvers, on ``S'``.
What a contact remembers is where its slider stands: ``b_t`` counts from there, and a contact that opens lets its spring
relax.

``C`` is positive semidefinite, so nothing that is known of existence and uniqueness for Coulomb's law on ``S`` is lost
on ``S'``; tangentially ``S'`` is the better conditioned of the two.  ``c → 0`` is Coulomb's law.
"""

from __future__ import annotations

import numpy as np

from mic.contact.laws.coulomb import equation
from mic.contact.laws.law import Law

__all__ = ["MICRO_SLIP"]


def _compliance(friction):
    return np.zeros(len(friction)) if friction.compliance is None else friction.compliance


MICRO_SLIP = Law(
    name="micro-slip",
    title="Coulomb's law behind a tangential contact stiffness: contacts yield before they slip.",
    colour="#cc79a7",
    mark="v",
    shift=1.0,
    equation=equation,
    gauss_seidel=True,
    reads="compliance",
    followed=True,
    compliance=_compliance,
)
