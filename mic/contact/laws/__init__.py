"""Contact laws, one file each, and the registry that names them.

==================  =====================================================================================
coulomb             ``K ∋ f  ⊥  u + μ‖u_t‖ n ∈ K*``, Coulomb's law as De Saxcé and Feng (1998) write it
associated          ``K ∋ f  ⊥  u ∈ K*``, the optimality conditions of a second-order cone programme
frictionless        ``0 <= f_n  ⊥  u_n >= 0`` and ``f_t = 0``
pressure-dependent  Coulomb's law with ``μ = μ(f_n/A)``
micro-slip          Coulomb's law between ``f`` and ``u + (0, c f_t)``: a spring in series with the slider
==================  =====================================================================================

:mod:`mic.contact.laws.law` has the notation.  A new law needs a module here and an entry in :data:`LAWS`.
"""

from mic.contact.laws.associated import ASSOCIATED
from mic.contact.laws.coulomb import COULOMB
from mic.contact.laws.frictionless import FRICTIONLESS
from mic.contact.laws.law import LAWS, Law, find
from mic.contact.laws.micro_slip import MICRO_SLIP
from mic.contact.laws.pressure_dependent import PRESSURE_DEPENDENT

__all__ = ["ASSOCIATED", "COULOMB", "FRICTIONLESS", "LAWS", "MICRO_SLIP", "PRESSURE_DEPENDENT", "Law", "find"]

LAWS.update({law.name: law for law in (COULOMB, ASSOCIATED, FRICTIONLESS, PRESSURE_DEPENDENT, MICRO_SLIP)})
