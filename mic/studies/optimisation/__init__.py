"""Optimisation of an assembly: forces, shims, process orders, places of items, and matching of measured parts."""

from mic.studies.optimisation.design import Change, Design
from mic.studies.optimisation.matching import Matched
from mic.studies.optimisation.objective import ConstraintCheck
from mic.studies.optimisation.optimum import BUDGET, FRESH, SAMPLES, Optimum, optimise

__all__ = ["BUDGET", "FRESH", "SAMPLES", "Change", "Design", "ConstraintCheck", "Matched", "Optimum", "optimise"]
