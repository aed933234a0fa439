"""Frictional contact between compliant bodies, reduced to their contacts.

>>> from mic.contact import solve
>>> solution = solve(S, b, mu)          # S (3m, 3m), b (3m,) or (n, 3m), mu scalar or (m,)

``docs/contact.md`` has the mathematics; :class:`ContactSolver` prepares one ``S`` for many batches.  ``laws`` has the
contact laws, ``states`` the states of a contact, ``ladder`` the solution methods in their order, ``backends`` their
implementations.
"""

from mic.contact.certificate import Certificate, certify
from mic.contact.friction import Friction
from mic.contact.laws import Law
from mic.contact.solution import ContactSolution, Status
from mic.contact.solver import ContactSolver, solve

__all__ = ["Certificate", "ContactSolution", "ContactSolver", "Friction", "Law", "Status", "certify", "solve"]
