"""Script inside of an FMI unit of ``mic export``; the FMI library runs it in the importing tool's process.

The unit's resources are this script, the model (``model.npz``) and ``unit.json``: contact law, and bounds of the
adjustments. Key characteristics are evaluated when an output is read or a step is done after an input has changed.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pythonfmu3 import (  # copied into the unit
    Float64,
    Fmi3Causality,
    Fmi3Slave,
    Fmi3Status,
    Fmi3StepResult,
    Fmi3Variability,
    Unit,
)

from mic import __version__
from mic.deployment.fmi_unit import unit_adjustments
from mic.process.model import ReducedModel
from mic.scene.deviation import deviation_unit
from mic.studies.adjustment import with_adjustments
from mic.studies.prediction import FARTHEST

BASE_UNITS: dict[str, dict[str, float]] = {
    "mm": {"factor": 1e-3, "m": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "K": {"K": 1},
}


class Assembly(Fmi3Slave):
    """A unit's instance.

    Parameters
    ----------
    **settings
        From the FMI library: ``resources``, the folder of the unit's resources, among others.
    """

    def __init__(self, **settings: Any):
        super().__init__(**settings)
        folder = Path(self.resources)
        given = json.loads((folder / "unit.json").read_text(encoding="utf-8"))
        model = ReducedModel.load(folder / "model.npz")
        scene = model.scene
        available = unit_adjustments(model, given["shim"], given["factor"])
        varied, _ = with_adjustments(model, available)
        self._process = varied.process(given["law"])
        self.modelName, self.description, self.version = given["identifier"], scene.name, __version__
        self.time = 0.0
        # Names, units and bounds of the inputs, in the order of the process's deviations.
        self._inputs: list[tuple[str, str, float, float]] = []
        for source in scene.deviations:
            bounds = source.mean - FARTHEST * source.sigma, source.mean + FARTHEST * source.sigma
            self._inputs.append((source.name, deviation_unit(source, scene), *bounds))
        self._inputs += [(item.name, item.unit, item.low, item.high) for item in available]
        self._x = np.array([item.mean for item in varied.scene.deviations])
        self._y: np.ndarray | None = None
        self._register([item.name for item in scene.measurements])

    def _register(self, outputs: list[str]) -> None:
        names = [name for name, *_ in self._inputs]
        units = dict.fromkeys(["mm", *(unit for _, unit, *_ in self._inputs if unit)])
        self.register_units([Unit(unit, **BASE_UNITS.get(unit, {})) for unit in units])
        clock = "time" if "time" not in [*names, *outputs] else "independent time"
        independent, continuous = Fmi3Causality.independent, Fmi3Variability.continuous
        self.register_variable(
            Float64(clock, causality=independent, variability=continuous, getter=lambda: self.time), nested=False
        )
        for j, (name, unit, *_) in enumerate(self._inputs):
            get, put = partial(self._value, j), partial(self._set_value, j)
            self._add(name, Fmi3Causality.input, unit, getter=get, setter=put)
        for k, name in enumerate(outputs):
            own = name if name not in names else f"measurements.{name}"
            self._add(own, Fmi3Causality.output, "mm", getter=partial(self._characteristic, k))

    def _add(self, name: str, causality: Fmi3Causality, unit: str, **access: Any) -> None:
        discrete = Fmi3Variability.discrete
        variable = Float64(name, causality=causality, variability=discrete, unit=unit or None, **access)
        self.register_variable(variable, nested=False)

    def _value(self, j: int) -> float:
        return float(self._x[j])

    def _set_value(self, j: int, value: float) -> None:
        self._x[j], self._y = value, None

    def _characteristic(self, k: int) -> float:
        return float(self._characteristics[k])

    @property
    def _characteristics(self) -> np.ndarray:
        """(k,) key characteristics, mm; NaN beyond the bounds, and if a contact problem could not be solved."""
        if self._y is None:
            evaluation = None if self._beyond else self._process.attempt(self._x[None])
            if evaluation is None or evaluation.failed[0]:
                self._y = np.full(len(self._process.model.scene.measurements), np.nan)
            else:
                self._y = evaluation.measurements[0]
        return self._y

    @property
    def _beyond(self) -> list[str]:
        """One text for each input that is beyond its bounds, or no number."""
        return [
            f"{name} is {value:g}, its bounds are {low:g} and {high:g}"
            for value, (name, _, low, high) in zip(self._x, self._inputs)
            if not low <= value <= high
        ]

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """Evaluate the key characteristics of the present inputs; discard the step if there are none."""
        self.time = current_time + step_size
        if np.isfinite(self._characteristics).all():
            return Fmi3StepResult()
        reason = "; ".join(self._beyond) or "a contact problem could not be solved"
        self.log(reason, Fmi3Status.discard)
        return Fmi3StepResult(Fmi3Status.discard)

    def to_xml(self, model_options: dict[str, str] = {}) -> Any:  # noqa: B006 - as the library has it
        """The model description, with the bounds of the inputs, which the library does not write."""
        root = super().to_xml(model_options)
        root.set("variableNamingConvention", "flat")
        root.set("generationTool", f"mic {__version__}")
        bounds = {name: (low, high) for name, _, low, high in self._inputs}
        values = dict(zip(bounds, self._x))
        for variable in root.find("ModelVariables"):
            name = variable.get("name")
            if variable.get("causality") == "input":
                low, high = bounds[name]
                for key, value in (("min", low), ("max", high), ("start", values[name])):
                    variable.set(key, repr(float(value)))
        return root
