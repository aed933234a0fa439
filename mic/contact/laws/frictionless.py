"""No friction: ``0 <= f_n ⊥ u_n >= 0`` and ``f_t = 0``, the optimality conditions of the quadratic programme (12)."""

from mic.contact.laws.law import Law

__all__ = ["FRICTIONLESS"]

FRICTIONLESS = Law(
    name="frictionless",
    title="Normal forces only, the quadratic programme (12) of the paper.",
    colour="#5f6b76",
    mark="^",
    frictional=False,
    paper_backend="osqp",
)
