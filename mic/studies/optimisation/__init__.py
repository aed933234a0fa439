"""What to change so that an assembly becomes better: forces, shims, orders, places, and which parts go together."""

from mic.studies.optimisation.design import Change, Design
from mic.studies.optimisation.matching import Matched
from mic.studies.optimisation.objective import ConstraintCheck
from mic.studies.optimisation.optimum import BUDGET, FRESH, SAMPLES, Optimum, optimise

__all__ = ["BUDGET", "FRESH", "SAMPLES", "Change", "Design", "ConstraintCheck", "Matched", "Optimum", "optimise"]
