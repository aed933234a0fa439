"""The plan of a process: its stages, their steps, and which rows each step holds, loads, lets go and makes.

It follows from the scene alone, and nothing is solved, so that the reduced model and the full finite-element reference
share what the stages mean, and nothing of how they are solved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mic.process.actions import Close, Fixture, Joints, Move, Read, Row, SetDown, Settle, moves_of, together
from mic.process.freedom import check_held

__all__ = ["StagePlan", "Step", "plan_stages"]


@dataclass(frozen=True)
class Step:
    """What moves together within a stage, contact active throughout.

    Attributes
    ----------
    move : tuple of Action
    bilateral : tuple of (str, int)
        Rows held: kind (``"locator"``, ``"clamp"`` with a stroke, ``"weld"``) and row number.
    loads : tuple of int
        Clamp rows that push with a force.
    released : tuple of (str, int)
        Rows held before that this step lets go.
    dropped_loads : tuple of int
        Clamp rows whose force ends here.
    made : tuple of int
        Weld rows that freeze here what they find.
    closing : tuple of int
        Welds that close their gap here.
    welds : tuple of int
        Welds that hold, those made here among them.
    sets_down : bool
        Whether the parts are set down one by one, touching nothing yet.
    settles : bool
        Whether overlaps close meanwhile, from touching to what they are at its end; of its own, nothing else moves.
    resolves : bool
        Whether contact is resolved.
    """

    move: Move
    bilateral: tuple[Row, ...]
    loads: tuple[int, ...] = ()
    released: tuple[Row, ...] = ()
    dropped_loads: tuple[int, ...] = ()
    made: tuple[int, ...] = ()
    closing: tuple[int, ...] = ()
    welds: tuple[int, ...] = ()
    sets_down: bool = False
    settles: bool = False
    resolves: bool = False

    @property
    def load_rows(self) -> tuple[Row, ...]:
        """Rows that carry a load during the step: clamp forces, then rows let go, whose reactions fade."""
        return tuple(("clamp", i) for i in self.loads + self.dropped_loads) + self.released


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


def plan_stages(scene, weld_size) -> list[StagePlan]:
    """The stages of a scene.

    Parts are set down first and touch nothing; what overlaps then settles at the start of the first stage that closes
    anything, before it does or (`settle` of the locate stage) while it does.  ``path = "one-step"`` does everything
    that a stage does at once, what overlaps included.

    Parameters
    ----------
    scene : mic.scene.Scene
    weld_size : sequence of int
        Rows of each weld.

    Raises
    ------
    SceneError
        If a step leaves a part free to move (`mic.process.freedom`).
    """
    joints, fixture, plans = Joints(tuple(weld_size)), Fixture(), []
    unsettled = False
    first = all(stage.settle for stage in scene.stages)
    for stage, moves in moves_of(scene):
        path = stage.path or ("increments" if stage.increments else "followed")
        if path == "one-step":
            moves = together(moves)
        steps: list[Step] = []
        for move in moves or [()]:
            after = fixture
            for action in move:
                after = action.apply(after)
            step = _step(move, joints, fixture, after)
            if unsettled and step.resolves:
                unsettled = False
                if first and path != "one-step":
                    held = _bilateral(fixture, joints)
                    steps.append(
                        Step((Settle(),), held, fixture.forces, welds=fixture.welds, settles=True, resolves=True)
                    )
                else:
                    step = replace(step, move=(Settle(), *move), settles=True)
            unsettled |= step.sets_down
            steps.append(step)
            fixture = after
        reads = any(isinstance(action, Read) for move in moves for action in move)
        plans.append(StagePlan(stage.name, stage.kind, tuple(steps), path, stage.increments or 1, reads))
        check_held(scene, joints, plans[-1])
    return plans


def _step(move, joints: Joints, before: Fixture, after: Fixture) -> Step:
    held, now = _bilateral(before, joints), _bilateral(after, joints)
    added = [row for row in now if row not in held and row[0] != "weld"]  # a weld that is made moves nothing
    released = tuple(row for row in held if row not in now)
    closing = tuple(i for action in move if isinstance(action, Close) for i in action.gap)
    sets_down = any(isinstance(action, SetDown) for action in move)
    changed = bool(added or released or closing or set(after.forces) != set(before.forces))
    return Step(
        move=move,
        bilateral=now,
        loads=after.forces,
        released=released,
        dropped_loads=tuple(i for i in before.forces if i not in after.forces),
        made=tuple(row for kind, row in now if kind == "weld" and ("weld", row) not in held),
        closing=closing,
        welds=after.welds,
        sets_down=sets_down,
        resolves=changed and not sets_down,
    )


def _bilateral(fixture: Fixture, joints: Joints) -> tuple[Row, ...]:
    rows = [("locator", i) for i in fixture.locators] + [("clamp", i) for i in fixture.strokes]
    return tuple(rows + [row for weld in fixture.welds for row in joints.rows(weld)])
