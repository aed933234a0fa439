"""Adjustments of individual assemblies: items, bounds, steps, costs and objective."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mic.errors import ArgumentError
from mic.process.model import ReducedModel
from mic.studies.adjustment import FACTOR, SHIM, Adjustment, adjustments
from mic.studies.optimisation.design import Design, Space
from mic.studies.optimisation.search import all_designs

__all__ = ["ALL", "OBJECTIVES", "SCENE", "Adjustable", "AllowedAdjustments"]

ALL = "all"  #: every locator and clamp, but the datum of the measurements
SCENE = "scene"  #: what the table ``optimise`` of the scene allows
#: Objectives of an adjustment, with the objectives of ``mic optimise`` that stand for them.
OBJECTIVES = {
    "yield": ("yield",),
    "rms": ("six-sigma", "largest-six-sigma"),
    "cpk": ("cpk",),
    "cost": ("cost",),
}
MAX_ORDERS = 120  # orders of a scene that are compared


@dataclass(frozen=True)
class AllowedAdjustments:
    """The adjustments that a model allows.

    Attributes
    ----------
    settings : list of Adjustment
    objective : {"yield", "rms", "cpk", "cost"}
    cost : (a,) array
        Cost per unit of each change, relative to that of an assembly outside its limits with the objective ``cost``,
        else to the allowed range.
    weight : (k,) array
        Weight of each key characteristic; 0: not part of the objective.
    most : int
        Largest number of adjustments of an assembly.
    orders : list of ReducedModel
        The model with each of the orders that the scene allows, the stated one first.
    changed_orders : list of str
        Description of each order; empty for the stated one.
    reject : float
        Cost of an assembly outside its limits, in the unit of the scene, with the objective ``cost``.
    """

    settings: list[Adjustment]
    objective: str
    cost: np.ndarray
    weight: np.ndarray
    most: int
    orders: list[ReducedModel]
    changed_orders: list[str]
    reject: float = 1.0


@dataclass(frozen=True)
class Adjustable:
    """Request to adjust individual assemblies.

    Attributes
    ----------
    names : sequence of str
        Locators and clamps; or ``all``: all but the datum of the measurements; or ``scene``: forces, shims and orders
        of the scene's table ``optimise``, with their bounds, steps and costs.
    shim : float, optional
        Largest shift, mm. Default: 0.5; with ``scene`` the scene's, where the tighter bound holds.
    factor : float, optional
        Largest factor, or divisor, of a force. Default: 2; with ``scene`` the scene's, where the tighter bound holds.
    objective : {"yield", "rms", "cpk", "cost"}, optional
        ``yield``: the smallest changes that bring all characteristics within their limits; ``rms``: the weighted RMS
        distance from the target; ``cpk``: likewise, relative to the distance of the target from the limits; ``cost``:
        the cost of changes and rejects that the scene states. Default: ``yield``; with ``scene`` the scene's.
    step : float, optional
        Step of positions, mm; with ``scene`` a multiple of the scene's. Default: the scene's, or the power of ten below
        a fiftieth of the largest change.
    most : int, optional
        Largest number of adjustments of an assembly. Default: the scene's with ``scene``, else all.
    """

    names: Sequence[str]
    shim: float | None = None
    factor: float | None = None
    objective: str | None = None
    step: float | None = None
    most: int | None = None

    def of(self, model: ReducedModel) -> AllowedAdjustments:
        """The adjustments of a model that are requested.

        Raises
        ------
        ArgumentError
            If a name or objective is unknown, the bounds allow no change, or there is nothing to adjust.
        """
        if self.objective not in (None, *OBJECTIVES):
            raise ArgumentError(f"objective is {self.objective!r}; choose one of {', '.join(OBJECTIVES)}")
        for name, value in (("step", self.step), ("most", self.most)):
            if value is not None and not 0 < value < math.inf:
                raise ArgumentError(f"{name} must be above 0 and finite, but is {value:g}")
        if SCENE in self.names and len(self.names) > 1 or ALL in self.names and len(self.names) > 1:
            raise ArgumentError(f"adjust: {ALL!r} and {SCENE!r} stand for themselves; remove the other names")
        allowed = self._of_scene(model) if SCENE in self.names else self._of_names(model)
        if not allowed.settings and len(allowed.orders) < 2:
            raise ArgumentError(
                f"scene {model.scene.name!r} has nothing to adjust besides the datum of its measurements"
            )
        if self.step is not None:
            other = next((item for item in allowed.settings if self._contradicts(item)), None)
            if other is not None:
                raise ArgumentError(
                    f"step is {self.step:g} mm, but the scene sets {other.name} in steps of {other.increment:g} mm; "
                    "give a multiple of that"
                )
            settings = [replace(item, increment=self.step) if item.unit == "mm" else item for item in allowed.settings]
            short = next((item for item in settings if item.unit == "mm" and item.size < self.step), None)
            if short is not None:
                raise ArgumentError(
                    f"step is {self.step:g} mm, and {short.name} may move by {short.size:g} mm; reduce the step"
                )
            allowed = replace(allowed, settings=settings)
        most = allowed.most if self.most is None else int(self.most)
        return replace(allowed, most=most, objective=self.objective or allowed.objective)

    def _contradicts(self, item: Adjustment) -> bool:
        """Whether the step is no multiple of the one that the scene states."""
        if self.step is None or item.unit != "mm" or item.increment is None:
            return False
        count = self.step / item.increment
        return count < 1 - 1e-9 or abs(count - round(count)) > 1e-6

    def _bounded(self, item: Adjustment) -> Adjustment:
        """An adjustment of the scene within the requested bounds too."""
        if item.unit == "mm":
            low, high = (-math.inf, math.inf) if self.shim is None else (-self.shim, self.shim)
        elif self.factor is None or not item.now:
            low, high = -math.inf, math.inf
        else:
            low, high = sorted(item.now * ratio - item.now for ratio in (1 / self.factor, self.factor))
        low, high = max(item.low, low), min(item.high, high)
        if not low < high:
            raise ArgumentError(f"{item.name} may not be adjusted within both the scene's bounds and the given ones")
        increment = item.increment or replace(item, low=low, high=high).step
        if max(-low, high) < increment:
            raise ArgumentError(
                f"{item.name} is set in steps of {increment:g} {item.unit}, beyond the largest change, "
                f"{max(-low, high):g} {item.unit}; increase it"
            )
        return replace(item, low=low, high=high)

    def _of_names(self, model: ReducedModel) -> AllowedAdjustments:
        shim, factor = (SHIM if self.shim is None else self.shim), (FACTOR if self.factor is None else self.factor)
        settings = adjustments(model, shim, factor, () if ALL in self.names else list(self.names))
        if self.objective == "cost":
            raise ArgumentError(f"the objective cost needs costs, which the scene states; adjust {SCENE!r}")
        cost = np.array([1.0 / item.size for item in settings])
        weight = np.ones(len(model.scene.measurements))
        return AllowedAdjustments(settings, "yield", cost, weight, len(settings), [model], [""])

    def _of_scene(self, model: ReducedModel) -> AllowedAdjustments:
        request = model.scene.optimise
        if request is None or not (request.forces or request.shims or request.orders):
            raise ArgumentError(
                f"scene {model.scene.name!r} has no table [optimise] with forces, shims or orders; add it, or name "
                "locators and clamps"
            )
        for name, value, least in (("shim", self.shim, 0), ("factor", self.factor, 1)):
            if value is not None and not least < value < math.inf:
                raise ArgumentError(f"{name} must be above {least} and finite, but is {value:g}")
        space = Space(model)
        settings = [self._bounded(item) for item in space.settings]
        objective = next(name for name, others in OBJECTIVES.items() if request.objective in others)
        cost = np.array([1.0 / item.size for item in settings])
        if (self.objective or objective) == "cost":
            if not request.reject:
                raise ArgumentError("the objective cost needs optimise.reject, the cost of an assembly outside; add it")
            cost = space.costs / request.reject
        names = [item.name for item in model.scene.measurements]
        weight = np.array([request.weights.get(name, 1.0) * (not request.of or name in request.of) for name in names])
        designs = [space.stated, *(design for design in _orders(space) if any(design.orders))]
        orders = [space.with_orders_of(model, design) for design in designs]
        changed = ["; ".join(map(str, space.changes(design))) for design in designs]
        most = request.most or len(settings)
        return AllowedAdjustments(settings, objective, cost, weight, most, orders, changed, request.reject or 1.0)


def _orders(space: Space) -> list[Design]:
    """The designs that differ from the stated one in their orders alone."""
    if not space.stages:
        return []
    designs = [design for design in all_designs(space) or [] if not any(design.places)]
    if not 0 < len(designs) <= MAX_ORDERS:
        raise ArgumentError(
            f"optimise.orders allow more than {MAX_ORDERS} orders; give fewer groups that close together"
        )
    return designs
