"""Explore an assembly interactively: evaluate it for changed parts, fixture and friction.

Controls are the inputs that a reduced model takes without being rebuilt: the deviations, the shims and forces of the
fixture (:mod:`mic.studies.adjustment`) and the coefficients of friction. The model is extended once by a deviation for
each of the latter two; each change of a control is then one evaluation with its own certificate. If that takes long, a
preliminary evaluation with a coarser path tolerance comes first.
"""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

from mic.contact import laws
from mic.contact.laws import LAWS
from mic.contact.states import ContactState
from mic.errors import ArgumentError, SceneError
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.process.process import TOLERANCE, Process
from mic.scene.deviation import FrictionDeviation, deviation_unit
from mic.scene.distribution import quantile
from mic.scene.zone import Zone
from mic.statistics.draw import draw
from mic.studies.adjustment import FACTOR, SHIM, Adjustment, adjustments, deviation_tables, new_names, with_adjustments
from mic.studies.samples import half_tolerances, valid
from mic.system.arguments import checked, number

__all__ = ["COARSE", "GROUPS", "ExploredAssembly", "Control", "Exploration", "explore"]

#: Factor on the path tolerance of a preliminary evaluation. On the wheelhouse its error is a hundredth to a thirtieth
#: of a standard deviation, and it takes less than half the time.
COARSE = 30.0
REACH = 3.0  # range of a source in standard deviations, by quantiles of its distribution
ROUGHER = 0.3  # least upward range of a coefficient of friction; otherwise it ranges to twice its value
GROUPS = ("sources", "locators", "clamps", "friction")  #: groups of controls


@dataclass(frozen=True)
class Control:
    """One adjustable input.

    Attributes
    ----------
    name : str
        Name of a deviation, or key in the scene: ``locators.NAME``, ``clamps.NAME.force``, ``zones.NAME.friction``.
    group : str
        One of :data:`GROUPS`.
    unit : str
        Empty for a coefficient, and for sources whose unit depends on their kind.
    now : float
        Value in the scene: mean of a source, 0 for a shim, stroke or force of a clamp, coefficient of friction.
    low, high : float
        Range.
    matters : float
        Largest change of any key characteristic over the range, relative to half its tolerance, by the derivatives
        about the mean assembly.
    """

    name: str
    group: str
    unit: str
    now: float
    low: float
    high: float
    matters: float = 0.0


@dataclass(frozen=True)
class ExploredAssembly:
    """One evaluated assembly.

    Attributes
    ----------
    values : dict of str to float
        Value of every control, by its name.
    stage : str
        Stage at whose end forces and motions are given.
    contact_stage : str
        Stage of the contact states: `stage`, or the last before it that resolves contact; empty if there is none.
    evaluation : Evaluation
        Evaluation of this one assembly; ``functional_force`` and ``motion`` at the end of `stage`.
    preliminary : bool
        Whether the coarser path tolerance was used.
    points : (m, 3) array
        The contact pairs, nominal, mm.
    table : DataFrame
        By key characteristic: ``measurement``, ``value``, ``lower``, ``upper`` (mm from nominal), ``within``.
    seconds : float
        Time of the evaluation, s.
    """

    values: Mapping[str, float]
    stage: str
    contact_stage: str
    evaluation: Evaluation
    preliminary: bool
    points: np.ndarray
    table: pd.DataFrame
    seconds: float

    @property
    def failed(self) -> bool:
        """Whether a contact problem was not solved to its tolerance."""
        return bool(self.evaluation.failed[0])

    @property
    def residual(self) -> float:
        """The certificate: largest natural-map residual of all stages; 0 if no stage resolves contact."""
        return max((float(resolution.residual[0]) for resolution in self.evaluation.resolutions.values()), default=0.0)

    @property
    def said(self) -> str:
        """The certificate in a sentence."""
        resolutions = self.evaluation.resolutions
        if not resolutions:
            return "No stage resolves contact."
        worst = max(
            resolutions.values(),
            key=lambda resolution: (not resolution.converged[0], float(np.nan_to_num(resolution.residual[0], nan=1))),
        )
        if self.failed:
            status = worst.status[0]
            return f"Not solved in stage {worst.stage}: {getattr(status, 'advice', status)}"
        return f"Solved in all stages: residual {self.residual:.1e}, tolerance {TOLERANCE:.0e}."

    @property
    def states(self) -> np.ndarray:
        """(m,) :class:`mic.contact.states.ContactState` of each pair at the end of :attr:`contact_stage`, if any."""
        resolutions = self.evaluation.resolutions
        return resolutions[self.contact_stage].state[0] if self.contact_stage else np.zeros(0, dtype=np.int8)

    @property
    def shares(self) -> dict[str, int]:
        """Number of pairs in each state, by its label."""
        return {state.label: int((self.states == state).sum()) for state in ContactState}


class Exploration:
    """A model with controls; created by :func:`explore`.

    Attributes
    ----------
    scene_model : ReducedModel
        Model of the scene.
    model : ReducedModel
        The same, extended by a deviation for each control that is not a deviation of the scene.
    law : str
    controls : list of Control
        By group, within a group by decreasing effect.
    stages : list of str
        Names of the stages.
    """

    def __init__(self, model: ReducedModel, law: str, shim: float = SHIM, factor: float = FACTOR):
        self.scene_model, self.law = model, law
        fixture = [item.name for item in (*model.scene.locators, *model.scene.clamps)]
        available = adjustments(model, shim, factor, fixture) if fixture else []
        fixture_model, names = with_adjustments(model, available)
        zones_with_friction = _frictions(fixture_model.scene, model, law)
        frictions = [item for _, item in zones_with_friction]
        scene = fixture_model.scene.model_copy(update={"deviations": [*fixture_model.scene.deviations, *frictions]})
        self.model = fixture_model.varied(scene)
        self.stages = [str(stage.name) for stage in scene.stages]
        # Each control with its deviation of `model`; the value of a source is that of its deviation.
        found = [(control, control.name) for control in _source_controls(model.scene)]
        found += [(_fixture_control(item), name) for item, name in zip(available, names)]
        found += [(_friction_control(zone), item.name) for zone, item in zones_with_friction]
        # By control: its column in the deviations of `model`, and its value in the scene.
        self._columns = {
            control.name: (self.model.parameters.index(name), 0.0 if control.group == "sources" else control.now)
            for control, name in found
        }
        self.controls = self._ordered([control for control, _ in found])

    def _ordered(self, controls: list[Control]) -> list[Control]:
        scene = self.scene_model.scene
        if not controls:
            raise SceneError(f"scene {scene.name!r} has neither deviations nor a fixture: there is nothing to explore")
        if scene.measurements:
            names = [self.model.parameters[column] for column, _ in self._columns.values()]
            J = np.nan_to_num(self.model.sensitivities({}, self.law, names).jacobian[0])  # (k, c)
            reach = np.array([max(control.high - control.now, control.now - control.low) for control in controls])
            effect = np.abs(J * reach / half_tolerances(scene)[:, None]).max(axis=0)
            controls = [replace(control, matters=float(value)) for control, value in zip(controls, effect)]
        return sorted(controls, key=lambda control: (GROUPS.index(control.group), -control.matters))

    # ------------------------------------------------------------------------------------------------ evaluation

    def deviations(self, values: Mapping[str, float]) -> np.ndarray:
        """(p,) deviations of :attr:`model` for values of controls by name; the others have those of the scene.

        Raises
        ------
        ArgumentError
            For unknown names and values that are not finite.
        """
        x = np.array([item.mean for item in self.model.scene.deviations])
        for name, value in values.items():
            if name not in self._columns:
                raise ArgumentError(f"there is no control {name!r}; known: {', '.join(self._columns)}")
            column, now = self._columns[name]
            x[column] = number(name, value) - now
        return x

    def answer(
        self, values: Mapping[str, float] | None = None, stage: str | None = None, coarse: bool = False
    ) -> ExploredAssembly:
        """The assembly with values of controls by name.

        Parameters
        ----------
        values : mapping of str to float
            Missing controls have the values of the scene.
        stage : str, optional
            Stage at whose end forces and motions are given; default: the last.
        coarse : bool
            Whether to use the coarser path tolerance of a preliminary evaluation.

        Raises
        ------
        ArgumentError
            For unknown names of controls or of stages, and values that are not finite.
        """
        start = time.perf_counter()
        values, stage = dict(values or {}), stage or self.stages[-1]
        if stage not in self.stages:
            raise ArgumentError(f"there is no stage {stage!r}; known: {', '.join(self.stages)}")
        x = self.deviations(values)
        evaluation = (self._coarse if coarse else self._process).attempt(x[None], stage)
        items = self.scene_model.scene.measurements
        y = evaluation.measurements[0] if evaluation.measurements.shape[1] else np.full(len(items), np.nan)
        rows = [
            (item.name, value, item.lower, item.upper, item.lower <= value <= item.upper)
            for item, value in zip(items, y)
        ]
        resolved = [name for name in self.stages[: self.stages.index(stage) + 1] if name in evaluation.resolutions]
        return ExploredAssembly(
            {control.name: control.now for control in self.controls} | values,
            stage,
            resolved[-1] if resolved else "",
            evaluation,
            coarse,
            self.model.contacts.point,
            pd.DataFrame(rows, columns=["measurement", "value", "lower", "upper", "within"]),
            time.perf_counter() - start,
        )

    @cached_property
    def _process(self) -> Process:
        return self.model.process(self.law)

    @cached_property
    def _coarse(self) -> Process:
        return Process(self.model, self.law, path_tolerance=COARSE * self.model.scene.path.tolerance)

    def readings(self, answer: ExploredAssembly) -> np.ndarray:
        """(F,) values of the retained functionals at the end of the assembly's stage, including shapes, mm and rad."""
        blocks, evaluation = self.model.compliance, answer.evaluation
        return (blocks.displace(evaluation.functional_force) + blocks.carry(evaluation.motion))[0]

    def contacts(self, answer: ExploredAssembly) -> np.ndarray:
        """(m, 3) mean displacement of the two sides of each contact pair, mm; only along the normal if the model has no
        tangential directions."""
        contacts, y, scene = self.model.contacts, self.readings(answer), self.model.scene
        rows, d, m = self.model.rows["contact"], contacts.dimension, len(contacts)
        total, count = np.zeros((m, 3)), np.zeros(m)
        for part, columns in zip(scene.parts, self.model.compliance.functionals):
            # δ is the displacement of the second body minus that of the first; within one part both are the same.
            sign = np.array([_side(zone.parts, part.name) for zone in scene.zones], dtype=float)[contacts.zone]
            displacement = (rows[:, columns] @ y[columns]).reshape(m, d)
            total += sign[:, None] * np.einsum("kij,kj->ki", contacts.frame[:, :, :d], displacement)
            count += np.abs(sign)
        return total / np.maximum(count, 1)[:, None]

    # ----------------------------------------------------------------------------------------- samples and saving

    def sample(self, deviations: np.ndarray) -> dict[str, float]:
        """Values of the source controls of a sample (p,) of the scene's deviations."""
        names = self.scene_model.parameters
        return {name: float(deviations[names.index(name)]) for name in names if name in self._columns}

    def draw_samples(self, count: int, first: int = 0, seed: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Samples (n, p) of the scene's deviations, and their key characteristics (n, k), mm; NaN for failed ones.

        Parameters
        ----------
        count, first : int
        seed : int, optional
            Default: the scene's.
        """
        scene = self.scene_model.scene
        x = draw(scene, scene.monte_carlo.seed if seed is None else seed, first, count)
        return x, valid(self.scene_model.process(self.law).attempt(x))

    def scene_tables(self, values: Mapping[str, float]) -> str:
        """TOML tables that set the fixture and the friction when appended to the scene file; the sources keep their
        distributions."""
        return deviation_tables(self._set(values), repr)

    def sample_table(self, values: Mapping[str, float]) -> str:
        """The assembly as CSV: a header and one row, with a column for each deviation of the scene and for each that
        :meth:`scene_tables` adds."""
        x = self.deviations(values)
        row = {name: float(x[j]) for j, name in enumerate(self.scene_model.parameters)}
        row |= {item.name: item.mean for item in self._set(values)}
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([row, [repr(value) for value in row.values()]])
        return text.getvalue()

    def _set(self, values: Mapping[str, float]) -> list[Any]:
        """The nonzero deviations of the fixture and the friction, with their values as means."""
        x, count = self.deviations(values), len(self.scene_model.parameters)
        return [
            item.model_copy(update={"mean": float(change)})
            for item, change in zip(self.model.scene.deviations[count:], x[count:])
            if change
        ]


@checked
def explore(model: ReducedModel, law: str | None = None, shim: float = SHIM, factor: float = FACTOR) -> Exploration:
    """Prepare a model for interactive exploration.

    >>> exploration = mic.explore(model)                                            # doctest: +SKIP
    >>> exploration.answer({"F1": 20.0, "locators.A1": 0.2}).table                  # doctest: +SKIP

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    shim, factor : float
        Largest shift of locators and strokes, mm, and largest factor or divisor of forces.

    Raises
    ------
    SceneError
        If there is nothing to explore.
    ArgumentError
        If the bounds allow no change.
    """
    return Exploration(model, model.scene.report.laws[0] if law is None else laws.find(law).name, shim, factor)


def _source_controls(scene) -> Iterator[Control]:
    for item in scene.deviations:
        if item.sigma > 0:
            low, high = quantile(item, ndtr([-REACH, REACH])).tolist()
            yield Control(item.name, "sources", deviation_unit(item, scene), item.mean, low, high)


def _fixture_control(item: Adjustment) -> Control:
    return Control(item.name, f"{item.kind}s", item.unit, item.now, item.now + item.low, item.now + item.high)


def _friction_control(zone: Zone) -> Control:
    now = float(zone.coefficient("default"))
    return Control(f"zones.{zone.name}.friction", "friction", "", now, 0.0, max(2 * now, now + ROUGHER))


def _frictions(scene, model: ReducedModel, law: str) -> list[tuple[Zone, FrictionDeviation]]:
    """A deviation of standard deviation 0 for each zone of constant friction; none under a frictionless law."""
    if not LAWS[law].frictional or not model.contacts.frictional or model.contacts.dimension == 1:
        return []
    zones = [zone for zone in scene.zones if zone.frictional and zone.pressure_pieces() is None]
    names = new_names(scene, ["friction"] * len(zones))
    return [
        (zone, FrictionDeviation(kind="friction", name=name, target=zone.name, sigma=0.0))
        for zone, name in zip(zones, names)
    ]


def _side(parts: Sequence[str], name: str) -> int:
    """-1 for the first body of a zone, 1 for the second, 0 for one that is neither, or both."""
    return [-1, 1][list(parts).index(name)] if list(parts).count(name) == 1 else 0
