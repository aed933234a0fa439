"""Adjustments of a fixture that need no new mesh: shims of locators, positions and forces of clamps.

Each adjustment acts as a deviation of standard deviation 0: a model that is extended by one such deviation for each
adjustment is evaluated with any values of them, without being rebuilt.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mic.process.model import ReducedModel
from mic.process.plan import plan_stages
from mic.scene.deviation import ClampDeviation, LocatorDeviation

__all__ = ["FACTOR", "SHIM", "Adjustment", "adjustments", "as_deviations", "extended", "written"]

SHIM = 0.5  #: largest shift of a locator or a clamp, mm
FACTOR = 2.0  #: largest factor, or divisor, of a clamp's force
STEPS = 50.0  # ratio of the largest to the smallest change, which is rounded to a power of ten
TOGETHER = 5.0  # mm: opposing clamps within this distance are one pair of tongs
AGAINST = -0.9  # largest cosine between their directions


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
    """

    name: str
    kind: str
    targets: tuple[str, ...]
    now: float
    low: float
    high: float

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
        return 10.0 ** math.floor(math.log10(self.size / STEPS))

    def settable(self, change: float) -> float:
        """The change rounded up to whole steps, within the bounds."""
        count = math.ceil(abs(change) / self.step - 1e-9) if abs(change) > 1e-3 * self.size else 0
        return float(np.clip(math.copysign(count, change) * self.step, self.low, self.high))

    def settings(self, start: float, end: float) -> np.ndarray:
        """(n,) changes that can be set from one to another, the smallest first; both to one side, end the larger."""
        count = np.arange(max(math.ceil(abs(start) / self.step - 1e-9), 1), math.ceil(abs(end) / self.step - 1e-9) + 1)
        return np.clip(np.copysign(count, end) * self.step, self.low, self.high)


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
    ValueError
        For names that are neither a locator's nor a clamp's, and bounds that allow nothing.
    """
    if not (math.isfinite(shim + factor) or math.isnan(shim + factor)):
        raise ValueError(f"shim and factor must be finite, not {shim:g} and {factor:g}")
    if not (shim > 0 and factor > 1):
        raise ValueError(f"shim must be positive and factor larger than 1, not {shim:g} and {factor:g}")
    scene = model.scene
    known = [one.name for one in (*scene.locators, *scene.clamps)]
    for name in names:
        if name not in known:
            raise ValueError(f"{name!r} is neither a locator nor a clamp of this scene; it has: {', '.join(known)}")
    held = {
        model.labels["locator"][row]
        for plan in plan_stages(scene, model.weld_size)
        if plan.reads
        for kind, row in plan.bilateral
        if kind == "locator"
    }
    found = [
        Adjustment(f"locators.{one.name}", "locator", (one.name,), 0.0, -shim, shim)
        for one in scene.locators
        if (one.name in names if names else one.name not in held)
    ]
    for own in _tongs(scene.clamps):
        if names and not any(one.name in names for one in own):
            continue
        first, targets = own[0], tuple(one.name for one in own)
        called = "clamps." + "+".join(targets)
        if first.force is None:
            found.append(Adjustment(f"{called}.stroke", "clamp", targets, first.stroke, -shim, shim))
        elif first.force:
            ends = sorted(first.force * by - first.force for by in (1 / factor, factor))
            found.append(Adjustment(f"{called}.force", "clamp", targets, first.force, ends[0], ends[1]))
    return found


def _tongs(clamps) -> list[list]:
    """Groups of clamps: two that press two parts on each other with one force in one stage form a pair of tongs."""
    found: list[list] = []
    for clamp in clamps:
        other = next((own for own in found if len(own) == 1 and _press(own[0], clamp)), None)
        if other is None:
            found.append([clamp])
        else:
            other.append(clamp)
    return found


def _press(a, b) -> bool:
    if a.part == b.part or a.stage != b.stage or a.force is None or a.force != b.force:
        return False
    near = math.dist(a.point, b.point) <= TOGETHER
    return near and float(np.dot(a.direction, b.direction)) <= AGAINST * math.hypot(*a.direction) * math.hypot(
        *b.direction
    )


def as_deviations(scene, some: Sequence[Adjustment], changes: Sequence[float]) -> list:
    """A deviation of standard deviation 0 for each adjustment, with names that are new in the scene."""
    taken, found = {one.name for one in scene.deviations}, []
    for own, change in zip(some, changes):
        prefix = "shim" if own.kind == "locator" else "set"
        name = next(f"{prefix}-{i}" for i in range(1, len(taken) + 2) if f"{prefix}-{i}" not in taken)
        taken.add(name)
        kind = LocatorDeviation if own.kind == "locator" else ClampDeviation
        target = own.targets[0] if len(own.targets) == 1 else list(own.targets)
        found.append(kind(kind=own.kind, name=name, target=target, mean=float(change), sigma=0.0))
    return found


def extended(model: ReducedModel, some: Sequence[Adjustment]) -> tuple[ReducedModel, list[str]]:
    """The model with an additional deviation for each adjustment, and the names of these deviations."""
    more = as_deviations(model.scene, some, [0.0] * len(some))
    scene = model.scene.model_copy(update={"deviations": [*model.scene.deviations, *more]})
    return model.varied(scene), [one.name for one in more]


def written(scene, changes: Mapping[Adjustment, float]) -> str:
    """TOML tables that apply the adjustments when appended to the scene file."""
    lines: list[str] = []
    for own in as_deviations(scene, list(changes), list(changes.values())):
        target = f'"{own.target}"' if isinstance(own.target, str) else str(own.target).replace("'", '"')
        lines += ["[[deviations]]", f'name = "{own.name}"', f'kind = "{own.kind}"', f"target = {target}"]
        lines += [f"mean = {own.mean:g}", "sigma = 0", ""]
    return "\n".join(lines)
