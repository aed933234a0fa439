"""The plan of a process: which rows each stage holds, loads, lets go and makes. Nothing is solved.

It follows from the scene alone, so that the reduced model and the full finite-element reference share what the stages
mean, and nothing of how they are solved.
"""

from __future__ import annotations

from dataclasses import dataclass

from mic.process.actions import SUGAR, Action, Close, Fixture, Joints, Read, Row, SetDown

__all__ = ["StagePlan", "plan_stages"]


@dataclass(frozen=True)
class StagePlan:
    """What one stage holds, loads and resolves.

    Attributes
    ----------
    name, kind : str
    actions : tuple of Action
    bilateral : tuple of (str, int)
        Rows held: kind (``"locator"``, ``"clamp"`` with a stroke, ``"weld"``) and row number.
    loads : tuple of int
        Clamp rows that push with a force.
    released : tuple of (str, int)
        Rows of the stage before that this one lets go.
    dropped_loads : tuple of int
        Clamp rows whose force ends here.
    made : tuple of int
        Weld rows that freeze here what they find.
    closing : tuple of int
        Welds that close their gap here.
    sets_down : bool
        Whether the parts are set down one by one, contact left for the next stage that changes anything.
    resolves : bool
        Whether contact is resolved.
    reads : bool
        Whether the measurements are read at its end.
    increments : int
    """

    name: str
    kind: str
    actions: tuple[Action, ...]
    bilateral: tuple[Row, ...]
    loads: tuple[int, ...]
    released: tuple[Row, ...]
    dropped_loads: tuple[int, ...]
    made: tuple[int, ...]
    closing: tuple[int, ...]
    sets_down: bool
    resolves: bool
    reads: bool
    increments: int


def plan_stages(scene, weld_size) -> list[StagePlan]:
    """Which rows each stage of a scene holds.

    Parameters
    ----------
    scene : mic.scene.Scene
    weld_size : sequence of int
        Rows of each weld.
    """
    joints, fixture, plans = Joints(tuple(weld_size)), Fixture(), []
    for stage in scene.stages:
        before, actions = fixture, tuple(SUGAR[stage.kind](scene, stage))
        for action in actions:
            fixture = action.apply(fixture)
        plans.append(_plan(stage, actions, joints, before, fixture))
    return plans


def _plan(stage, actions, joints: Joints, before: Fixture, after: Fixture) -> StagePlan:
    held, now = _bilateral(before, joints), _bilateral(after, joints)
    added = [row for row in now if row not in held and row[0] != "weld"]  # a weld that is made moves nothing
    released = tuple(row for row in held if row not in now)
    closing = tuple(i for action in actions if isinstance(action, Close) for i in action.gap)
    sets_down = any(isinstance(action, SetDown) for action in actions)
    changed = bool(added or released or closing or set(after.forces) != set(before.forces))
    return StagePlan(
        name=stage.name,
        kind=stage.kind,
        actions=actions,
        bilateral=now,
        loads=after.forces,
        released=released,
        dropped_loads=tuple(i for i in before.forces if i not in after.forces),
        made=tuple(row for kind, row in now if kind == "weld" and ("weld", row) not in held),
        closing=closing,
        sets_down=sets_down,
        resolves=changed and not sets_down,
        reads=any(isinstance(action, Read) for action in actions),
        increments=stage.increments,
    )


def _bilateral(fixture: Fixture, joints: Joints) -> tuple[Row, ...]:
    rows = [("locator", i) for i in fixture.locators] + [("clamp", i) for i in fixture.strokes]
    return tuple(rows + [row for weld in fixture.welds for row in joints.rows(weld)])
