r"""Coulomb's slider in series with a tangential spring: a contact yields before it slips (a Jenkins element).

A contact of area ``A`` and tangential stiffness ``k_t`` per area has the compliance ``c = 1/(k_t A)``.  Its relative
displacement ``u_t`` is the sum of the slider's, ``w_t``, and of the spring's.  The force acts on the second body and
holds it back, so that the spring is displaced by ``-c f_t``: a stuck contact (``w_t = 0``) displaced by ``u_t`` carries
``f_t = -u_t/c``.  Hence

.. math::

    w_t = u_t + c f_t, \qquad w = S f + b + C f = S' f + b, \qquad S' = S + C, \quad C_k = \mathrm{diag}(0, c, c),

and Coulomb's law holds between ``f`` and ``w``: the same cone, the same certificate and the same solvers, on ``S'``.
The state of a contact is the position of its slider, from which ``b_t`` is measured; the spring of a contact that opens
relaxes.

``C`` is positive semidefinite, so results on existence and uniqueness for Coulomb's law on ``S`` hold for ``S'``, which
is better conditioned tangentially.  ``c → 0`` gives Coulomb's law.
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
    title="Coulomb's law in series with a tangential contact stiffness: contacts yield before they slip.",
    colour="#cc79a7",
    mark="v",
    shift=1.0,
    equation=equation,
    gauss_seidel=True,
    reads="compliance",
    followed=True,
    compliance=_compliance,
)
