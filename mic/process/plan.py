"""The plan of a process: its stages, their steps, and the rows that each step holds, loads, releases and makes.

It follows from the scene alone, and nothing is solved. The reduced model and the full finite-element reference
therefore share the meaning of the stages, but not how they are solved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mic.model.rows import Joints, Row
from mic.process.actions import (
    Fixture,
    Join,
    Move,
    MoveAssembly,
    Placement,
    PlaceParts,
    Read,
    ResolveOverlap,
    stage_moves,
    together,
)
from mic.process.free_motions import check_resting, with_resting_parts
from mic.scene.stages import placing_stages

__all__ = ["Limit", "StagePlan", "Step", "plan_assembly", "plan_stages", "row_compliance"]


@dataclass(frozen=True)
class Limit:
    """A row that is pushed towards its position by a limited force.

    It is a load F along the row, against a stop at the position that carries the force not needed to get there: with f
    the stop's force and u the remaining distance,

        0 <= u  ⟂  f >= 0,        the force on the row is F - f.

    Either the position is reached, by F − f, or the force is at its limit.

    Attributes
    ----------
    row : (str, int)
        A clamp's row, or the first row of a weld: its gun.
    sign : {1, -1}
        1 if it pushes along the row; -1 if against it, like a gun, which closes the gap that the row reads.
    force : float
        F, N.
    """

    row: Row
    sign: int
    force: float

    @property
    def load(self) -> float:
        """Force along the row without the stop, N."""
        return self.sign * self.force


@dataclass(frozen=True)
class Step:
    """Actions that happen together within a stage, with contact active throughout.

    Attributes
    ----------
    move : tuple of Action
    bilateral : tuple of (str, int)
        Rows held: kind (``"locator"``, ``"clamp"`` with a stroke, ``"weld"``) and row number.
    loads : tuple of int
        Clamp rows that push with a force; the parts' weights follow the clamps.
    released : tuple of (str, int)
        Rows held before that this step releases.
    dropped_loads : tuple of int
        Clamp rows whose force ends here.
    limits : tuple of Limit
        Rows that are pushed towards their position by a limited force.
    dropped_limits : tuple of Limit
        Those that open here.
    made : tuple of int
        Weld rows that freeze their reading here.
    closing : tuple of int
        Welds that close their gap here.
    welds : tuple of int
        Welds that hold, including those made here.
    away : tuple of int
        Zones with an absent body: a part of a later station, a fixture of another one.
    sets_down : bool
        Whether the parts are placed one by one, without contact.
    settles : bool
        Whether overlaps close during the step, from touching to their value at its end; in a step of its own nothing
        else moves.
    resolves : bool
        Whether contact is solved.
    resting : tuple of int
        Numbers of the parts that rest by contact alone: these rows leave them a motion.
    parked : tuple of int
        Resting parts that are not placed yet: they stay in their nominal position.
    """

    move: Move
    bilateral: tuple[Row, ...]
    loads: tuple[int, ...] = ()
    released: tuple[Row, ...] = ()
    dropped_loads: tuple[int, ...] = ()
    limits: tuple[Limit, ...] = ()
    dropped_limits: tuple[Limit, ...] = ()
    made: tuple[int, ...] = ()
    closing: tuple[int, ...] = ()
    welds: tuple[int, ...] = ()
    away: tuple[int, ...] = ()
    sets_down: bool = False
    settles: bool = False
    resolves: bool = False
    resting: tuple[int, ...] = ()
    parked: tuple[int, ...] = ()

    @property
    def stops(self) -> tuple[Limit, ...]:
        """Limits with a stop: all, unless the plan was made without limits."""
        return tuple(limit for limit in self.limits if limit.row not in self.bilateral)

    def closed(self, joints: Joints) -> list[int]:
        """Weld rows that close their gap here.

        A weld closes it along its whole normal, for electrodes press the sheets flush; a gun without a limit closes the
        mean only.
        """
        return [row for i in self.closing for row in joints.normal(i) if ("weld", row) in self.bilateral]

    @property
    def nuggets(self) -> tuple[int, ...]:
        """Welds whose nuggets have no contact: those made, and those that a gun without a limit closes."""
        return self.welds + (self.closing if len(self.stops) < len(self.limits) else ())

    @property
    def load_rows(self) -> tuple[Row, ...]:
        """Rows that carry a load in the step: clamp forces, limited ones, and released rows, whose reactions fade."""
        limited = tuple(limit.row for limit in self.stops + self.dropped_limits)
        return tuple(("clamp", i) for i in self.loads + self.dropped_loads) + limited + self.released


@dataclass(frozen=True)
class StagePlan:
    """One stage.

    Attributes
    ----------
    name, kind : str
    steps : tuple of Step
        At least one.
    path : {"followed", "increments", "one-step"}
        How the steps are followed if the law has friction; ``"one-step"`` has at most one step.
    increments : int
        Of each step, if the path has increments.
    reads : bool
        Whether the measurements are read at its end.
    """

    name: str
    kind: str
    steps: tuple[Step, ...]
    path: str
    increments: int
    reads: bool

    @property
    def resolves(self) -> bool:
        """Whether contact is solved."""
        return any(step.resolves for step in self.steps)

    def solves(self, law) -> int:
        """Least number of contact problems for each sample; a followed path takes as many as it needs.

        Parameters
        ----------
        law : mic.contact.laws.Law
            Without friction the solution does not depend on the path, and only the steps before and after welds count.
        """
        if law.frictional:
            return self.increments * sum(step.resolves for step in self.steps)
        return sum(self.steps[i].resolves for i in self.memory_steps)

    @property
    def memory_steps(self) -> tuple[int, ...]:
        """The steps that matter even without friction: the last, and those before and at which welds are made."""
        after = (*self.steps[1:], None)
        return tuple(
            i for i, (step, next_) in enumerate(zip(self.steps, after)) if next_ is None or step.made or next_.made
        )

    @property
    def bilateral(self) -> tuple[Row, ...]:
        """Rows held at its end."""
        return self.steps[-1].bilateral

    def limit_names(self, scene, weld_size) -> list[str]:
        """Names of the clamps, and of the welds whose guns, :attr:`checked_limits` lists."""
        first = Joints(tuple(weld_size)).first.tolist()
        return [
            scene.clamps[limit.row[1]].name if limit.row[0] == "clamp" else scene.welds[first.index(limit.row[1])].name
            for _, limit in self.checked_limits
        ]

    @property
    def checked_limits(self) -> tuple[tuple[int, Limit], ...]:
        """Limited forces that must reach their position, with the number of the step in which they are checked.

        Clamps are checked at the end of the stage, guns when their weld is made.
        """
        last = len(self.steps) - 1
        return tuple(
            (i, limit)
            for i, step in enumerate(self.steps)
            for limit in step.limits
            if i == last or limit.row[0] == "weld"
        )


def plan_stages(scene, weld_size, limited: bool = True) -> list[StagePlan]:
    """The stages of a scene.

    Parts are placed first, without contact. Overlaps are resolved at the start of the first stage that closes anything:
    before the first closing step, or (`settle` of the locate stage) together with it, or in an earlier clamp stage in
    which nothing closes, which is how a scene without clamps solves contact. ``path = "one-step"`` does everything in a
    stage at once, overlaps included. The same holds in every later station, for the parts and fixtures that are new
    there.

    Parameters
    ----------
    scene : mic.scene.Scene
    weld_size : sequence of int
        Rows of each weld.
    limited : bool
        Whether force limits apply; if not, clamps and guns hold the position that they push towards.

    Raises
    ------
    SceneError
        If a step leaves a part free to move, and no zone joins it to a body that is held (`mic.process.free_motions`).
    """
    rows = _Rows(scene, Joints(tuple(weld_size)), limited)
    plans: list[StagePlan] = []
    placed_in, first_stage = placing_stages(scene), scene.stages[0].name
    waiting = (i for i, item in enumerate(scene.locators) if item.stage == placed_in[item.part] != first_stage)
    fixture = Fixture(waiting=tuple(waiting))
    away = tuple(range(len(scene.zones)))
    pending, first = False, True
    fixtures: set[str] = set()
    for stage, moves in stage_moves(scene):
        path = stage.path or ("increments" if stage.increments else "followed")
        if path == "one-step":
            moves = together(moves)
        steps: list[Step] = []
        for move in moves or [()]:
            after = fixture.after(move)
            if any(isinstance(action, MoveAssembly) for action in move):
                fixtures = set()  # while it moves, the assembly touches no fixture
                away = _inactive_zones(scene, _parts_of(scene, fixture))
            step = replace(_step(move, rows, fixture, after), away=away, parked=_parked(scene, after))
            if pending and (step.resolves or stage.kind == "clamp" and not any(moves)):
                pending = False
                if step.resolves and first and path != "one-step":
                    resting = _step((), rows, fixture, fixture)
                    steps.append(_settling(replace(resting, away=away, parked=_parked(scene, fixture))))
                else:
                    step = _settling(step)
            steps.append(step)
            if any(isinstance(action, Placement) for action in move):
                first, before = stage.settle, away
                fixtures |= _station_fixtures(scene, stage)
                away = _inactive_zones(scene, _parts_of(scene, after) | fixtures)
                pending = pending or not plans or not set(before) <= set(away)
            fixture = after
        reads = any(isinstance(action, Read) for move in moves for action in move)
        plan = StagePlan(stage.name, stage.kind, tuple(steps), path, stage.increments or 1, reads)
        plans.append(with_resting_parts(scene, rows.joints, plan))
    return plans


def _settling(step: Step) -> Step:
    """The step, in which overlaps close."""
    return replace(step, move=(ResolveOverlap(), *step.move), settles=True, resolves=True)


def plan_assembly(assembly) -> list[StagePlan]:
    """The stages of an assembly with its meshes, after checking that contact can hold the resting parts.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly or mic.model.reduction.Reduction

    Raises
    ------
    SceneError
        If a step leaves a part free, or no contacts can hold a resting part under a law that the report names.
    """
    plans = plan_stages(assembly.scene, assembly.weld_size)
    check_resting(assembly, plans, assembly.scene.report.laws)
    return plans


def row_compliance(scene, bilateral: Sequence[Row]) -> np.ndarray | None:
    """(b,) compliance of the bilateral rows' supports, mm/N; None if all are rigid."""
    soft = [
        1 / stiffness if kind == "locator" and (stiffness := scene.locators[i].stiffness) is not None else 0.0
        for kind, i in bilateral
    ]
    return np.array(soft) if any(soft) else None


def _parts_of(scene, fixture: Fixture) -> set[str]:
    """Names of the parts that are placed."""
    waiting = {scene.locators[i].part for i in fixture.waiting}
    return {part.name for part in scene.parts} - waiting


def _parked(scene, fixture: Fixture) -> tuple[int, ...]:
    """Numbers of the parts that are not placed yet."""
    placed = _parts_of(scene, fixture)
    return tuple(i for i, part in enumerate(scene.parts) if part.name not in placed)


def _station_fixtures(scene, stage) -> set[str]:
    """Names of the fixtures in the station of a stage."""
    first = scene.stages[0].name
    return {fixture.name for fixture in scene.fixtures if (fixture.stage or first) == stage.name}


def _inactive_zones(scene, bodies: set[str]) -> tuple[int, ...]:
    """Zones of which a body is not among these."""
    return tuple(i for i, zone in enumerate(scene.zones) if not set(zone.parts) <= bodies)


@dataclass(frozen=True)
class _Rows:
    """The rows that a fixture holds, and those that it pushes by a limited force."""

    scene: Any
    joints: Joints
    limited: bool

    def limits(self, fixture: Fixture) -> tuple[Limit, ...]:
        clamps, welds, first = self.scene.clamps, self.scene.welds, self.joints.first
        return tuple(Limit(("clamp", i), 1, clamps[i].limit) for i in fixture.limited) + tuple(
            Limit(("weld", int(first[i])), -1, welds[i].gun) for i in fixture.guns
        )

    def held(self, fixture: Fixture) -> tuple[Row, ...]:
        rows = [("locator", i) for i in fixture.waiting + fixture.locators] + [("clamp", i) for i in fixture.strokes]
        rows += [row for weld in fixture.welds for row in self.joints.rows(weld)]
        return tuple(rows) + (() if self.limited else tuple(limit.row for limit in self.limits(fixture)))


def _step(move, rows: _Rows, before: Fixture, after: Fixture) -> Step:
    held, now = rows.held(before), rows.held(after)
    limits, limits_now = rows.limits(before), rows.limits(after)
    welded = {row for weld in after.welds for row in rows.joints.rows(weld)}
    added = [row for row in now if row not in held and row not in welded]  # a new weld moves nothing
    released = tuple(row for row in held if row not in now)
    dropped = tuple(limit for limit in limits if limit not in limits_now and rows.limited)
    closing = tuple(i for action in move if isinstance(action, Join) for i in action.gap)
    if not rows.limited:  # a gun without a limit closes the gap
        closing += tuple(i for i in after.guns if i not in before.guns)
    sets_down = any(isinstance(action, PlaceParts) for action in move)
    opened = any(limit.row not in now for limit in dropped)  # a weld takes over its gun's force, and nothing moves
    pressed = any(limit not in limits for limit in limits_now)
    changed = bool(added or released or closing or opened or pressed or set(after.forces) != set(before.forces))
    return Step(
        move=move,
        bilateral=now,
        loads=after.forces,
        released=released,
        dropped_loads=tuple(i for i in before.forces if i not in after.forces),
        limits=limits_now,
        dropped_limits=dropped,
        made=tuple(i for kind, i in now if (kind, i) in welded and (kind, i) not in held),
        closing=closing,
        welds=after.welds,
        sets_down=sets_down,
        resolves=changed and not sets_down,
    )
