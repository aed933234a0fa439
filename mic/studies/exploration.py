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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

from mic.contact.laws import LAWS
from mic.contact.states import ContactState
from mic.errors import SceneError
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.process.process import TOLERANCE, Process
from mic.scene.deviation import FrictionDeviation
from mic.scene.distribution import quantile
from mic.scene.zone import Zone
from mic.statistics.draw import draw
from mic.studies.adjustment import FACTOR, SHIM, Adjustment, adjustments, extended

__all__ = ["COARSE", "GROUPS", "ExploredAssembly", "Control", "Exploration", "explore"]

#: Factor on the path tolerance of a preliminary evaluation: on the wheelhouse an error of a hundredth to a thirtieth of
#: a standard deviation in less than half the time.
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
        A deviation's name, or where it stands in the scene: ``locators.NAME``, ``clamps.NAME.force``,
        ``zones.NAME.friction``.
    group : str
        One of :data:`GROUPS`.
    unit : str
        Empty for a coefficient, and for sources whose unit depends on their kind.
    now : float
        Its value as the scene states it: a source's mean, a shim of 0, a clamp's stroke or force, a coefficient.
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
        return max((float(one.residual[0]) for one in self.evaluation.resolutions.values()), default=0.0)

    @property
    def said(self) -> str:
        """The certificate in a sentence."""
        found = self.evaluation.resolutions
        if not found:
            return "No stage resolves contact."
        worst = max(
            found.values(), key=lambda one: (not one.converged[0], float(np.nan_to_num(one.residual[0], nan=1)))
        )
        if self.failed:
            status = worst.status[0]
            return f"Not solved in stage {worst.stage}: {getattr(status, 'advice', status)}"
        return f"Solved in all stages: residual {self.residual:.1e}, asked for {TOLERANCE:.0e}."

    @property
    def states(self) -> np.ndarray:
        """(m,) :class:`mic.contact.states.ContactState` of each pair at the end of :attr:`contact_stage`, if any."""
        found = self.evaluation.resolutions
        return found[self.contact_stage].state[0] if self.contact_stage else np.zeros(0, dtype=np.int8)

    @property
    def shares(self) -> dict[str, int]:
        """Number of pairs in each state, by its label."""
        return {state.label: int((self.states == state).sum()) for state in ContactState}


class Exploration:
    """A model with controls; created by :func:`explore`.

    Attributes
    ----------
    model : ReducedModel
        Extended by a deviation for each control that is not a deviation of the scene.
    law : str
    controls : list of Control
        By group, in each with the largest effect first.
    stages : list of str
        Names of the stages.
    """

    def __init__(self, model: ReducedModel, law: str, shim: float = SHIM, factor: float = FACTOR):
        self.own, self.law = model, law
        fixture = [one.name for one in (*model.scene.locators, *model.scene.clamps)]
        some = adjustments(model, shim, factor, fixture) if fixture else []
        grown, names = extended(model, some)
        rough = _frictions(grown.scene, model, law)
        scene = grown.scene.model_copy(update={"deviations": [*grown.scene.deviations, *(one for _, one in rough)]})
        self.model = grown.varied(scene)
        #: By control, its column among the deviations of :attr:`model`, and what the scene states.
        self._columns: dict[str, tuple[int, float]] = {}
        controls = self._sources() + self._adjusted(some, names) + self._rough(rough)
        reach = np.array([max(one.high - one.now, one.now - one.low) for one in controls])
        self.controls = self._ordered(controls, reach)
        self.stages = [str(stage.name) for stage in scene.stages]

    def _sources(self) -> list[Control]:
        found = []
        for j, item in enumerate(self.own.scene.deviations):
            if not item.sigma > 0:
                continue
            low, high = (float(quantile(item, np.array([ndtr(z)]))[0]) for z in (-REACH, REACH))
            self._columns[item.name] = j, 0.0
            found.append(Control(item.name, "sources", _unit(item, self.own.scene), item.mean, low, high))
        return found

    def _adjusted(self, some: Sequence[Adjustment], names: Sequence[str]) -> list[Control]:
        found = []
        for own, name in zip(some, names):
            self._columns[own.name] = self.model.parameters.index(name), own.now
            group = "locators" if own.kind == "locator" else "clamps"
            found.append(Control(own.name, group, own.unit, own.now, own.now + own.low, own.now + own.high))
        return found

    def _rough(self, rough: Sequence[tuple[Zone, FrictionDeviation]]) -> list[Control]:
        found = []
        for zone, item in rough:
            now, name = float(zone.coefficient("default")), f"zones.{zone.name}.friction"
            self._columns[name] = self.model.parameters.index(item.name), now
            found.append(Control(name, "friction", "", now, 0.0, max(2 * now, now + ROUGHER)))
        return found

    def _ordered(self, controls: list[Control], reach: np.ndarray) -> list[Control]:
        if not controls:
            raise SceneError(
                f"scene {self.own.scene.name!r}: nothing varies, and no fixture holds it: nothing can be moved"
            )
        scene = self.own.scene
        if scene.measurements:
            names = [self.model.parameters[self._columns[one.name][0]] for one in controls]
            J = np.nan_to_num(self.model.sensitivities({}, self.law, names).jacobian[0])  # (k, c)
            half = np.array([0.5 * (item.upper - item.lower) for item in scene.measurements])
            matters = np.abs(J * reach / half[:, None]).max(axis=0)
            controls = [replace(one, matters=float(share)) for one, share in zip(controls, matters)]
        return sorted(controls, key=lambda one: (GROUPS.index(one.group), -one.matters))

    # -------------------------------------------------------------------------------------------------- answers

    def deviations(self, values: Mapping[str, float]) -> np.ndarray:
        """(p,) deviations of :attr:`model` for values of controls by name; the others as the scene states them.

        Raises
        ------
        ValueError
            For unknown names and values that are not finite.
        """
        x = np.array([item.mean for item in self.model.scene.deviations])
        for name, value in values.items():
            if name not in self._columns:
                raise ValueError(f"{name!r} cannot be moved; known: {', '.join(self._columns)}")
            if not np.isfinite(value):
                raise ValueError(f"{name}: {value} is no finite number")
            column, now = self._columns[name]
            x[column] = value - now
        return x

    def answer(
        self, values: Mapping[str, float] | None = None, stage: str | None = None, coarse: bool = False
    ) -> ExploredAssembly:
        """The assembly with values of controls by name.

        Parameters
        ----------
        values : mapping of str to float
            The others as the scene states them.
        stage : str, optional
            At whose end it is looked at; default: the last.
        coarse : bool
            Whether its paths are followed more coarsely, for a preliminary answer.

        Raises
        ------
        ValueError
            For unknown names of controls or of stages, and values that are not finite.
        """
        before = time.perf_counter()
        at = stage or self.stages[-1]
        if at not in self.stages:
            raise ValueError(f"there is no stage {at!r}; known: {', '.join(self.stages)}")
        x = self.deviations(values or {})
        found = (self._coarse if coarse else self._process).attempt(x[None], at)
        items = self.own.scene.measurements
        y = found.measurements[0] if found.measurements.shape[1] else np.full(len(items), np.nan)
        limits = np.array([[item.lower, item.upper] for item in items]).reshape(-1, 2)
        table = pd.DataFrame(
            {
                "measurement": [item.name for item in items],
                "value": y,
                "lower": limits[:, 0],
                "upper": limits[:, 1],
                "within": (y >= limits[:, 0]) & (y <= limits[:, 1]),
            }
        )
        whole = {one.name: one.now for one in self.controls} | dict(values or {})
        past = self.stages[: self.stages.index(at) + 1]
        touched = [name for name in past if name in found.resolutions]
        took = time.perf_counter() - before
        points = self.model.contacts.point
        return ExploredAssembly(whole, at, touched[-1] if touched else "", found, coarse, points, table, took)

    @cached_property
    def _process(self) -> Process:
        return self.model.process(self.law)

    @cached_property
    def _coarse(self) -> Process:
        return Process(self.model, self.law, path_tolerance=COARSE * self.model.scene.path.tolerance)

    def readings(self, answer: ExploredAssembly) -> np.ndarray:
        """(F,) what the retained functionals read at the end of the answer's stage, shapes included, mm and rad."""
        blocks, found = self.model.compliance, answer.evaluation
        return (blocks.displace(found.functional_force) + blocks.carry(found.motion))[0]

    def contacts(self, answer: ExploredAssembly) -> np.ndarray:
        """(m, 3) displacements of the contact pairs, in the middle between their two sides, mm; along the normal alone
        where no tangents are modelled."""
        contacts, y, scene = self.model.contacts, self.readings(answer), self.model.scene
        rows, d, m = self.model.rows["contact"], contacts.dimension, len(contacts)
        moved, sides = np.zeros((m, 3)), np.zeros(m)
        for part, own in zip(scene.parts, self.model.compliance.functionals):
            # δ is what the second body moves less what the first does; within one part the two are not told apart.
            sign = np.array([_side(zone.parts, part.name) for zone in scene.zones], dtype=float)[contacts.zone]
            read = (rows[:, own] @ y[own]).reshape(m, d)
            moved += sign[:, None] * np.einsum("kij,kj->ki", contacts.frame[:, :, :d], read)
            sides += np.abs(sign)
        return moved / np.maximum(sides, 1)[:, None]

    # ----------------------------------------------------------------------------------------- samples and saving

    def sample(self, deviations: np.ndarray) -> dict[str, float]:
        """Values of the controls of a sample (p,) of the scene's own deviations; the fixture as the scene states it."""
        names = self.own.parameters
        return {name: float(deviations[names.index(name)]) for name in names if name in self._columns}

    def drawn(self, count: int, first: int = 0, seed: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Samples (n, p) of the scene's own deviations, and their key characteristics (n, k), mm; NaN where one failed.

        Parameters
        ----------
        count, first : int
        seed : int, optional
            Default: the scene's.
        """
        scene = self.own.scene
        x = draw(scene, scene.monte_carlo.seed if seed is None else seed, first, count)
        found = self.own.process(self.law).attempt(x)
        return x, np.where(found.failed[:, None], np.nan, found.measurements)

    def scene_tables(self, values: Mapping[str, float]) -> str:
        """The tables that the scene's file takes at its end to have the fixture and the friction set so, as TOML; the
        sources keep their distributions."""
        lines: list[str] = []
        for item in self._set(values):
            target = [item.target] if isinstance(item.target, str) else item.target
            text = ", ".join(f'"{name}"' for name in target)
            lines += ["[[deviations]]", f'name = "{item.name}"', f'kind = "{item.kind}"']
            lines += [f"target = {text if len(target) == 1 else f'[{text}]'}", f"mean = {item.mean!r}", "sigma = 0", ""]
        return "\n".join(lines)

    def sample_table(self, values: Mapping[str, float]) -> str:
        """The assembly as CSV: a header and one row, a column for each deviation of the scene, and one for each that
        :meth:`scene_tables` adds to it."""
        x = self.deviations(values)
        own = {name: float(x[j]) for j, name in enumerate(self.own.parameters)}
        own |= {item.name: item.mean for item in self._set(values)}
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([own, [repr(value) for value in own.values()]])
        return text.getvalue()

    def _set(self, values: Mapping[str, float]) -> list[Any]:
        """The deviations of the model beside the scene's own that are not 0, with their values as means."""
        x, own = self.deviations(values), len(self.own.parameters)
        return [
            item.model_copy(update={"mean": float(change)})
            for item, change in zip(self.model.scene.deviations[own:], x[own:])
            if change
        ]


def explore(model: ReducedModel, law: str | None = None, shim: float = SHIM, factor: float = FACTOR) -> Exploration:
    """Make a model ready to be moved.

    >>> exploration = mic.explore(model)                                            # doctest: +SKIP
    >>> exploration.answer({"F1": 20.0, "locators.A1": 0.2}).table                  # doctest: +SKIP

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    shim, factor : float
        By how much locators and strokes are moved at most, mm, and forces multiplied or divided.

    Raises
    ------
    SceneError
        If nothing can be moved.
    ValueError
        For bounds that allow nothing.
    """
    return Exploration(model, law or model.scene.report.laws[0], shim, factor)


def _frictions(scene, model: ReducedModel, law: str) -> list[tuple[Zone, FrictionDeviation]]:
    """By zone of constant friction, a deviation of standard deviation 0 that adds to it; none under a law without."""
    if not LAWS[law].frictional or not model.contacts.frictional or model.contacts.dimension == 1:
        return []
    taken, found = {one.name for one in scene.deviations}, []
    for zone in scene.zones:
        if not zone.frictional or zone.pressure_pieces() is not None:
            continue
        name = next(f"friction-{i}" for i in range(1, len(taken) + 2) if f"friction-{i}" not in taken)
        taken.add(name)
        found.append((zone, FrictionDeviation(kind="friction", name=name, target=zone.name, sigma=0.0)))
    return found


def _side(parts: Sequence[str], name: str) -> int:
    """-1 for the first body of a zone, 1 for the second, 0 for one that is neither, or both."""
    return [-1, 1][list(parts).index(name)] if list(parts).count(name) == 1 else 0


def _unit(item, scene) -> str:
    """The unit of a deviation's value."""
    if item.kind == "clamp":
        first = item.target if isinstance(item.target, str) else item.target[0]
        return "N" if next(one for one in scene.clamps if one.name == first).force is not None else "mm"
    return {"force": "N", "locator": "mm", "thickness": "mm", "temperature": "K"}.get(item.kind, "")
