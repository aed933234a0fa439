"""Adjustments of a fixture that need no new mesh: shims of locators, positions and forces of clamps.

Each adjustment acts as a deviation of standard deviation 0: a model that is extended by one such deviation for each
adjustment is evaluated with any values of them, without being rebuilt.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mic.errors import ArgumentError
from mic.process.model import ReducedModel
from mic.process.plan import plan_stages
from mic.scene.deviation import ClampDeviation, LocatorDeviation, targets

__all__ = [
    "FACTOR",
    "SHIM",
    "Adjustment",
    "adjustments",
    "as_deviations",
    "deviation_tables",
    "with_adjustments",
    "with_changes",
    "new_names",
    "adjustment_tables",
]

SHIM = 0.5  #: largest shift of a locator or a clamp, mm
FACTOR = 2.0  #: largest factor, or divisor, of a clamp's force
STEPS = 50.0  # ratio of the largest to the smallest change, which is rounded to a power of ten
TONGS_DISTANCE = 5.0  # mm: opposing clamps within this distance form a pair of tongs
TONGS_COSINE = -0.9  # largest cosine between their directions


@dataclass(frozen=True)
class Adjustment:
    """One setting of the fixture.

    Attributes
    ----------
    name : str
        Key in the scene: ``locators.NAME``, ``clamps.NAME.stroke``, ``clamps.NAME.force``; for a pair of
        tongs ``clamps.A+B.force``.
    kind : {"locator", "clamp"}
    targets : tuple of str
        Locators or clamps that move together.
    now : float
        Stated position, mm, or force, N.
    low, high : float
        Bounds of its change, in the same unit.
    increment : float, optional
        The smallest change; default: the power of ten below a fiftieth of the largest.
    """

    name: str
    kind: str
    targets: tuple[str, ...]
    now: float
    low: float
    high: float
    increment: float | None = None

    @property
    def unit(self) -> str:
        """``mm`` or ``N``."""
        return "N" if self.name.endswith(".force") else "mm"

    @property
    def size(self) -> float:
        """The largest allowed change."""
        return max(-self.low, self.high)

    @property
    def step(self) -> float:
        """The smallest change."""
        return self.increment or 10.0 ** math.floor(math.log10(self.size / STEPS))

    def settable(self, change: float) -> float:
        """The change rounded up to whole steps, within the bounds."""
        count = math.ceil(abs(change) / self.step - 1e-9) if abs(change) > 1e-3 * self.size else 0
        return float(np.clip(math.copysign(count, change) * self.step, self.low, self.high))


def adjustments(
    model: ReducedModel, shim: float = SHIM, factor: float = FACTOR, names: Sequence[str] = ()
) -> list[Adjustment]:
    """Allowed adjustments of a model's fixture.

    Locators that hold the assembly during measurement are its datum: moving them changes the reading and not the part,
    so they are left out unless they are named.

    Parameters
    ----------
    model : ReducedModel
    shim : float
        Largest shift of a locator or of a clamp with a stroke, mm.
    factor : float
        Largest factor, or divisor, of a clamp's force.
    names : sequence of str
        Names of the locators and clamps to adjust; default: all.

    Raises
    ------
    ArgumentError
        If a name belongs to neither a locator nor a clamp, or the bounds allow no change.
    """
    if not (0 < shim < math.inf and 1 < factor < math.inf):
        raise ArgumentError(f"shim must be above 0, factor above 1, and both finite; got {shim:g} and {factor:g}")
    scene = model.scene
    known = [item.name for item in (*scene.locators, *scene.clamps)]
    for name in names:
        if name not in known:
            raise ArgumentError(f"{name!r} is neither a locator nor a clamp of this scene; it has: {', '.join(known)}")
    held = {
        model.labels["locator"][row]
        for plan in plan_stages(scene, model.weld_size)
        if plan.reads
        for kind, row in plan.bilateral
        if kind == "locator"
    }
    result = [
        Adjustment(f"locators.{item.name}", "locator", (item.name,), 0.0, -shim, shim)
        for item in scene.locators
        if (item.name in names if names else item.name not in held)
    ]
    for clamps in _tongs(scene.clamps):
        if names and not any(item.name in names for item in clamps):
            continue
        first, targets = clamps[0], tuple(item.name for item in clamps)
        key = "clamps." + "+".join(targets)
        if first.force is None:
            result.append(Adjustment(f"{key}.stroke", "clamp", targets, first.stroke, -shim, shim))
        elif first.force:
            ends = sorted(first.force * ratio - first.force for ratio in (1 / factor, factor))
            result.append(Adjustment(f"{key}.force", "clamp", targets, first.force, ends[0], ends[1]))
    return result


def _tongs(clamps) -> list[list]:
    """Groups of clamps: two that press two parts on each other with one force in one stage form a pair of tongs."""
    groups: list[list] = []
    for clamp in clamps:
        partner = next((group for group in groups if len(group) == 1 and _press(group[0], clamp)), None)
        if partner is None:
            groups.append([clamp])
        else:
            partner.append(clamp)
    return groups


def _press(a, b) -> bool:
    """Whether two clamps press two parts on each other with one force in one stage."""
    if a.part == b.part or a.stage != b.stage or a.force is None or a.force != b.force:
        return False
    lengths = math.hypot(*a.direction), math.hypot(*b.direction)
    opposed = float(np.dot(a.direction, b.direction)) <= TONGS_COSINE * lengths[0] * lengths[1]
    return opposed and math.dist(a.point, b.point) <= TONGS_DISTANCE


def new_names(scene, prefixes: Sequence[str]) -> list[str]:
    """Names ``PREFIX-NUMBER`` for further deviations of a scene, different from all others."""
    names = [item.name for item in scene.deviations]
    for prefix in prefixes:
        names.append(next(name for i in range(1, len(names) + 2) if (name := f"{prefix}-{i}") not in names))
    return names[len(scene.deviations) :]


def as_deviations(scene, chosen: Sequence[Adjustment], changes: Sequence[float]) -> list:
    """A deviation of standard deviation 0 for each adjustment, with names that are new in the scene."""
    result = []
    names = new_names(scene, ["shim" if item.kind == "locator" else "set" for item in chosen])
    for adjustment, name, change in zip(chosen, names, changes):
        kind = LocatorDeviation if adjustment.kind == "locator" else ClampDeviation
        target = adjustment.targets[0] if len(adjustment.targets) == 1 else list(adjustment.targets)
        result.append(kind(kind=adjustment.kind, name=name, target=target, mean=float(change), sigma=0.0))
    return result


def with_adjustments(model: ReducedModel, available: Sequence[Adjustment]) -> tuple[ReducedModel, list[str]]:
    """The model with an additional deviation for each adjustment, and the names of these deviations."""
    additional = as_deviations(model.scene, available, [0.0] * len(available))
    scene = model.scene.model_copy(update={"deviations": [*model.scene.deviations, *additional]})
    return model.varied(scene), [item.name for item in additional]


def with_changes(deviations: np.ndarray, changes: Sequence[float] | np.ndarray) -> np.ndarray:
    """(n, p + a) samples (n, p) of a model with the same changes (a,) of the adjustments in each."""
    return np.column_stack([deviations, np.tile(np.asarray(changes, dtype=float), (len(deviations), 1))])


def adjustment_tables(scene, changes: Mapping[Adjustment, float]) -> str:
    """TOML tables that apply the adjustments when appended to the scene file."""
    return deviation_tables(as_deviations(scene, list(changes), list(changes.values())), "{:g}".format)


def deviation_tables(deviations: Iterable[Any], number: Callable[[float], str]) -> str:
    """TOML tables of deviations of standard deviation 0; `number` formats their means."""
    lines: list[str] = []
    for item in deviations:
        names = [f'"{name}"' for name in targets(item)]
        target = names[0] if len(names) == 1 else f"[{', '.join(names)}]"
        lines += ["[[deviations]]", f'name = "{item.name}"', f'kind = "{item.kind}"', f"target = {target}"]
        lines += [f"mean = {number(item.mean)}", "sigma = 0", ""]
    return "\n".join(lines)
