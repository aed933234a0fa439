"""What of a fixture may be adjusted without another mesh: shims of locators, positions and forces of clamps.

Each is a key of the scene, and moves as a deviation of standard deviation 0 does: a model that is extended by one such
deviation for each adjustment is evaluated with any values of them, and nothing is prepared anew.
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

SHIM = 0.5  #: mm: the most by which a locator or a clamp is moved
FACTOR = 2.0  #: the most by which a clamp's force is multiplied, or divided
STEPS = 50.0  # the least change, a share of the largest; rounded to a power of ten
TOGETHER = 5.0  # mm: clamps this near that push against each other are one pair of tongs
AGAINST = -0.9  # cosine between their directions


@dataclass(frozen=True)
class Adjustment:
    """One thing that a workshop may set.

    Attributes
    ----------
    name : str
        Where it stands in the scene: ``locators.NAME``, ``clamps.NAME.stroke``, ``clamps.NAME.force``; of a pair of
        tongs ``clamps.A+B.force``.
    kind : {"locator", "clamp"}
    targets : tuple of str
        What moves, all alike.
    now : float
        Position, mm, or force, N, that the scene states.
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
        """The largest change that is allowed."""
        return max(-self.low, self.high)

    @property
    def step(self) -> float:
        """The least change."""
        return 10.0 ** math.floor(math.log10(self.size / STEPS))

    def settable(self, change: float) -> float:
        """A change that can be set, not less than the one asked for, and within the bounds."""
        count = math.ceil(abs(change) / self.step - 1e-9) if abs(change) > 1e-3 * self.size else 0
        return float(np.clip(math.copysign(count, change) * self.step, self.low, self.high))

    def settings(self, start: float, end: float) -> np.ndarray:
        """(n,) changes that can be set from one to another, the smallest first; both to one side, end the larger."""
        count = np.arange(max(math.ceil(abs(start) / self.step - 1e-9), 1), math.ceil(abs(end) / self.step - 1e-9) + 1)
        return np.clip(np.copysign(count, end) * self.step, self.low, self.high)


def adjustments(
    model: ReducedModel, shim: float = SHIM, factor: float = FACTOR, names: Sequence[str] = ()
) -> list[Adjustment]:
    """What may be adjusted of a model's fixture.

    Locators that hold the assembly while it is measured are what it is measured from: to move them moves the reading,
    and not the part, so that they are left out unless they are named.

    Parameters
    ----------
    model : ReducedModel
    shim : float
        The most by which a locator or a clamp with a stroke is moved, mm.
    factor : float
        The most by which a clamp's force is multiplied, or divided.
    names : sequence of str
        Names of locators and clamps, and these alone; default: all.

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
    """Clamps, those together that press two parts on each other with one force in one stage."""
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
    """A deviation of standard deviation 0 for each adjustment, of names that the scene does not have."""
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
    """The model with one deviation more for each adjustment, and the names of these; they follow the scene's own."""
    more = as_deviations(model.scene, some, [0.0] * len(some))
    scene = model.scene.model_copy(update={"deviations": [*model.scene.deviations, *more]})
    return model.varied(scene), [one.name for one in more]


def written(scene, changes: Mapping[Adjustment, float]) -> str:
    """The tables that a scene file takes at its end to be adjusted so, as TOML."""
    lines: list[str] = []
    for own in as_deviations(scene, list(changes), list(changes.values())):
        target = f'"{own.target}"' if isinstance(own.target, str) else str(own.target).replace("'", '"')
        lines += ["[[deviations]]", f'name = "{own.name}"', f'kind = "{own.kind}"', f"target = {target}"]
        lines += [f"mean = {own.mean:g}", "sigma = 0", ""]
    return "\n".join(lines)
