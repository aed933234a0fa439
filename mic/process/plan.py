"""The plan of a process: its stages, their steps, and which rows each step holds, loads, lets go and makes.

It follows from the scene alone, and nothing is solved, so that the reduced model and the full finite-element reference
share what the stages mean, and nothing of how they are solved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mic.process.actions import (
    Close,
    Fixture,
    Joints,
    Move,
    MoveAssembly,
    Placement,
    PlaceParts,
    Read,
    ResolveOverlap,
    Row,
    stage_moves,
    together,
)
from mic.process.free_motions import check_resting, rested
from mic.scene.stages import set_down_in

__all__ = ["Limit", "StagePlan", "Step", "plan_assembly", "plan_stages", "yielding"]


@dataclass(frozen=True)
class Limit:
    """A row that is pushed towards its position, by a limited force.

    It is a load F along the row, against a stop at the position that carries what is not needed to get there: with f
    the stop's force and u the way that is left,

        0 <= u  ⟂  f >= 0,        the force on the row is F - f.

    The position is reached, by F − f, or the force is at its limit.

    Attributes
    ----------
    row : (str, int)
        A clamp's, or the first of a weld: its gun.
    sign : {1, -1}
        Whether it pushes along the row, or against it, as a gun does: it closes the gap that the row reads.
    force : float
        F, N.
    """

    row: Row
    sign: int
    force: float

    @property
    def load(self) -> float:
        """Force along the row when nothing stops it, N."""
        return self.sign * self.force


@dataclass(frozen=True)
class Step:
    """What moves together within a stage, contact active throughout.

    Attributes
    ----------
    move : tuple of Action
    bilateral : tuple of (str, int)
        Rows held: kind (``"locator"``, ``"clamp"`` with a stroke, ``"weld"``) and row number.
    loads : tuple of int
        Clamp rows that push with a force; the parts' weights lie behind the clamps'.
    released : tuple of (str, int)
        Rows held before that this step lets go.
    dropped_loads : tuple of int
        Clamp rows whose force ends here.
    limits : tuple of Limit
        Rows that are pushed towards their position by a limited force.
    dropped_limits : tuple of Limit
        Those that open here.
    made : tuple of int
        Weld rows that freeze here what they find.
    closing : tuple of int
        Welds that close their gap here.
    welds : tuple of int
        Welds that hold, those made here among them.
    away : tuple of int
        Zones one of whose bodies is not there: a part of a later station, a fixture of another.
    sets_down : bool
        Whether the parts are set down one by one, touching nothing yet.
    settles : bool
        Whether overlaps close meanwhile, from touching to what they are at its end; of its own, nothing else moves.
    resolves : bool
        Whether contact is resolved.
    resting : tuple of int
        Parts, by their numbers, that these rows leave a motion: they rest by contact alone.
    parked : tuple of int
        Those of them that are not there yet: they stay where they are drawn.
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
        """Limits that may be reached: all, unless the plan was made without them."""
        return tuple(limit for limit in self.limits if limit.row not in self.bilateral)

    def closed(self, joints: Joints) -> list[int]:
        """Weld rows that close their gap here: of a weld that is made all along its normal, for electrodes press the
        sheets flush; of one that a gun without a limit presses its mean alone."""
        return [row for i in self.closing for row in joints.normal(i) if ("weld", row) in self.bilateral]

    @property
    def nuggets(self) -> tuple[int, ...]:
        """Welds in whose nuggets no contact is left: those made, and those that a gun without a limit closes."""
        return self.welds + (self.closing if len(self.stops) < len(self.limits) else ())

    @property
    def load_rows(self) -> tuple[Row, ...]:
        """Rows that carry a load during the step: clamp forces, limited ones, and rows let go, whose reactions fade."""
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
        How the steps are followed, where the law has friction; ``"one-step"`` has no more than one step.
    increments : int
        Of each step, where the path has increments.
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
        """Whether contact is resolved."""
        return any(step.resolves for step in self.steps)

    def solves(self, law) -> int:
        """Least number of contact problems that a sample takes; a path that is followed takes as many as it needs.

        Parameters
        ----------
        law : mic.contact.laws.Law
            Without friction nothing remembers the way, and only the steps count that leave a weld behind.
        """
        if law.frictional:
            return self.increments * sum(step.resolves for step in self.steps)
        return sum(self.steps[i].resolves for i in self.remembered)

    @property
    def remembered(self) -> tuple[int, ...]:
        """The steps that leave something behind even without friction: the last, and those before and of welds made."""
        after = (*self.steps[1:], None)
        return tuple(
            i for i, (step, next_) in enumerate(zip(self.steps, after)) if next_ is None or step.made or next_.made
        )

    @property
    def bilateral(self) -> tuple[Row, ...]:
        """Rows held at its end."""
        return self.steps[-1].bilateral

    def judged_names(self, scene, weld_size) -> list[str]:
        """Names of the clamps, and of the welds whose guns, :attr:`judged` lists."""
        first = Joints(tuple(weld_size)).first.tolist()
        return [
            scene.clamps[limit.row[1]].name if limit.row[0] == "clamp" else scene.welds[first.index(limit.row[1])].name
            for _, limit in self.judged
        ]

    @property
    def judged(self) -> tuple[tuple[int, Limit], ...]:
        """Where a limited force must have sufficed: clamps at the stage's end, guns when their weld is made; by the
        number of the step."""
        last = len(self.steps) - 1
        return tuple(
            (i, limit)
            for i, step in enumerate(self.steps)
            for limit in step.limits
            if i == last or limit.row[0] == "weld"
        )


def plan_stages(scene, weld_size, limited: bool = True) -> list[StagePlan]:
    """The stages of a scene.

    Parts are set down first and touch nothing; what overlaps then settles at the start of the first stage that closes
    anything, before it does or (`settle` of the locate stage) while it does, or in a clamp stage before it in which
    nothing closes, which is how a scene without clamps resolves contact.  ``path = "one-step"`` does everything
    that a stage does at once, what overlaps included. So it is in every later station, for what is new there.

    Parameters
    ----------
    scene : mic.scene.Scene
    weld_size : sequence of int
        Rows of each weld.
    limited : bool
        Whether limits of forces are kept; without, clamps and guns hold the position that they push towards.

    Raises
    ------
    SceneError
        If a step leaves a part free to move, and no zone joins it to what stays (`mic.process.free_motions`).
    """
    rows = _Rows(scene, Joints(tuple(weld_size)), limited)
    plans: list[StagePlan] = []
    there = set_down_in(scene)
    waiting = (i for i, one in enumerate(scene.locators) if one.stage == there[one.part] != scene.stages[0].name)
    fixture = Fixture(waiting=tuple(waiting))
    away = tuple(range(len(scene.zones)))
    due, first, standing = False, True, set[str]()
    for stage, moves in stage_moves(scene):
        path = stage.path or ("increments" if stage.increments else "followed")
        if path == "one-step":
            moves = together(moves)
        steps: list[Step] = []
        for move in moves or [()]:
            after = fixture
            for action in move:
                after = action.apply(after)
            if any(isinstance(action, MoveAssembly) for action in move):  # on its way the assembly touches no fixture
                standing = set()
                away = _away(scene, _parts_of(scene, fixture))
            step = replace(_step(move, rows, fixture, after), away=away, parked=_parked(scene, after))
            if due and stage.kind == "clamp" and not any(moves):
                due, step = False, replace(step, move=(ResolveOverlap(),), settles=True, resolves=True)
            elif due and step.resolves:
                if first and path != "one-step":
                    steps.append(
                        Step(
                            (ResolveOverlap(),),
                            rows.held(fixture),
                            fixture.forces,
                            limits=rows.limits(fixture),
                            welds=fixture.welds,
                            away=away,
                            parked=_parked(scene, fixture),
                            settles=True,
                            resolves=True,
                        )
                    )
                else:
                    step = replace(step, move=(ResolveOverlap(), *move), settles=True)
                due = False
            steps.append(step)
            if any(isinstance(action, Placement) for action in move):
                first, before = stage.settle, away
                standing |= _standing(scene, stage)
                away = _away(scene, _parts_of(scene, after) | standing)
                due = due or not plans or not set(before) <= set(away)
            fixture = after
        reads = any(isinstance(action, Read) for move in moves for action in move)
        plan = StagePlan(stage.name, stage.kind, tuple(steps), path, stage.increments or 1, reads)
        plans.append(rested(scene, rows.joints, plan))
    return plans


def plan_assembly(assembly) -> list[StagePlan]:
    """The stages of a scene that is put on its meshes, once contact is seen to hold what rests by it.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly or mic.model.reduction.Reduction

    Raises
    ------
    SceneError
        If a step leaves a part free, or no contacts can hold what it leaves them, under a law that the report names.
    """
    plans = plan_stages(assembly.scene, assembly.weld_size)
    check_resting(assembly, plans, assembly.scene.report.laws)
    return plans


def yielding(scene, bilateral: Sequence[Row]) -> np.ndarray | None:
    """(b,) by how much bilateral rows yield under their force, mm/N; None where none does."""
    soft = [
        1 / stiffness if kind == "locator" and (stiffness := scene.locators[i].stiffness) is not None else 0.0
        for kind, i in bilateral
    ]
    return np.array(soft) if any(soft) else None


def _parts_of(scene, fixture: Fixture) -> set[str]:
    """Names of the parts that are there."""
    waiting = {scene.locators[i].part for i in fixture.waiting}
    return {part.name for part in scene.parts} - waiting


def _parked(scene, fixture: Fixture) -> tuple[int, ...]:
    """Numbers of the parts that are not there yet."""
    there = _parts_of(scene, fixture)
    return tuple(i for i, part in enumerate(scene.parts) if part.name not in there)


def _standing(scene, stage) -> set[str]:
    """Names of the fixtures that stand in the station of a stage."""
    first = scene.stages[0].name
    return {fixture.name for fixture in scene.fixtures if (fixture.stage or first) == stage.name}


def _away(scene, bodies: set[str]) -> tuple[int, ...]:
    """Zones that these bodies leave without a partner."""
    return tuple(i for i, zone in enumerate(scene.zones) if not set(zone.parts) <= bodies)


@dataclass(frozen=True)
class _Rows:
    """Which rows a fixture holds, and which it pushes by a limited force."""

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
    added = [row for row in now if row not in held and row not in welded]  # a weld that is made moves nothing
    released = tuple(row for row in held if row not in now)
    dropped = tuple(limit for limit in limits if limit not in limits_now and rows.limited)
    closing = tuple(i for action in move if isinstance(action, Close) for i in action.gap)
    if not rows.limited:  # a gun without a limit closes the gap
        closing += tuple(i for i in after.guns if i not in before.guns)
    sets_down = any(isinstance(action, PlaceParts) for action in move)
    opened = any(limit.row not in now for limit in dropped)  # a weld takes its gun's force over, and nothing moves
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
