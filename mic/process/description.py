"""The process in words: what happens in each step of a stage, one sentence each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from mic.process.actions import (
    Action,
    Arrive,
    Close,
    Hold,
    Open,
    Press,
    Push,
    Read,
    Retract,
    SetDown,
    Settle,
    Transfer,
    Withdraw,
)
from mic.process.plan import StagePlan, Step
from mic.scene.stages import set_down_in

__all__ = ["opening", "sentences"]

MOST = 6  # names in a row; of more, the first and the last are given


def opening(plan: StagePlan, contacts: bool) -> str:
    """How contact is treated in a stage, in a few words.

    Parameters
    ----------
    plan : StagePlan
    contacts : bool
        Whether the assembly has any.
    """
    if not contacts:
        return "no contact"
    if not plan.resolves:
        return "nothing moves" if plan.kind != "locate" else "parts touch nothing yet"
    if plan.path == "followed":
        return "contact active, path followed"
    if plan.path == "one-step":
        return "contact active, all at once in one step"
    return f"contact active, {plan.increments} increment{'s' * (plan.increments > 1)} for each step"


def sentences(scene, plan: StagePlan) -> list[str]:
    """What each step of a stage does."""
    found = [_sentence(scene, step) for step in plan.steps]
    return [line for line in found if line] or [_NOTHING[plan.kind]]


_NOTHING = {
    "locate": "no part is set down",
    "clamp": "nothing closes",
    "weld": "nothing is welded",
    "release": "nothing opens",
    "measure": "nothing is measured",
}


def _sentence(scene, step: Step) -> str:
    clauses = [clause for action in step.move for clause in _clauses(scene, action)]
    rests = [scene.parts[p].name for p in step.resting if p not in step.parked]
    if rests and any(isinstance(action, SetDown | Arrive | Transfer | Open | Withdraw) for action in step.move):
        clauses.append(f"contact alone holds {_listed(rests)}")
    if step.settles and len(clauses) > 1:
        return f"{', '.join(clauses[1:])}; meanwhile {clauses[0]}"
    return ("; " if any(isinstance(action, SetDown | Arrive | Transfer) for action in step.move) else ", ").join(
        clauses
    )


def _clauses(scene, action: Action) -> Iterable[str]:
    if isinstance(action, SetDown | Arrive | Transfer):
        there, locators = set_down_in(scene), [scene.locators[i] for i in action.locators]
        others = [one.name for one in locators if there[one.part] != one.stage]
        if others:
            yield f"all that holds the assembly opens, it is set down on {_listed(others)}"
        for part in scene.parts:
            own = [one.name for one in locators if one.part == part.name and there[one.part] == one.stage]
            if own:
                yield f"{part.name} is set down on {_listed(own)}"
        if action.weights:
            yield "gravity acts"
        if isinstance(action, SetDown):
            for part in scene.parts:
                if all(one.part != part.name for one in scene.locators):
                    yield f"{part.name} is laid down"
    elif isinstance(action, Settle):
        yield "parts that overlap come to rest on each other"
    elif isinstance(action, Hold):
        if action.locators:
            yield _do("locator", _names(scene.locators, action.locators), "close", "closes")
        for stroke, own in _alike(action.strokes, lambda i: scene.clamps[i].stroke):
            yield _do("clamp", _names(scene.clamps, own), "close", "closes") + f" to {stroke:g} mm"
    elif isinstance(action, Push):
        for force, own in _alike(action.forces, lambda i: scene.clamps[i].force):
            each = " each" * (len(own) > 1)
            yield _do("clamp", _names(scene.clamps, own), "close", "closes") + f" ({force:g} N{each})"
    elif isinstance(action, Press):
        for (stroke, limit), own in _alike(action.limited, lambda i: (scene.clamps[i].stroke, scene.clamps[i].limit)):
            yield _do("clamp", _names(scene.clamps, own), "close", "closes") + _towards(stroke, limit, len(own))
        for force, own in _alike(action.guns, lambda i: scene.welds[i].gun):
            each = " each" * (len(own) > 1)
            yield _do("gun", _names(scene.welds, own), "press", "presses") + f" ({force:g} N{each})"
    elif isinstance(action, Retract):
        if action.guns:
            yield _do("gun", _names(scene.welds, action.guns), "open", "opens")
    elif isinstance(action, Close):
        found = [i for i in action.welds if i not in action.gap]
        if found:
            yield _do("weld", _names(scene.welds, found), "keep what they find", "keeps what it finds")
        if action.gap:
            yield _do("weld", _names(scene.welds, action.gap), "close their gaps", "closes its gap")
    elif isinstance(action, Withdraw):
        own = sorted(action.clamps)
        yield _do("clamp", _names(scene.clamps, own), "open", "opens")
    elif isinstance(action, Open):
        yield _do("locator", _names(scene.locators, action.locators), "open", "opens")
    elif isinstance(action, Read):
        count = len(scene.measurements)
        yield "1 key characteristic is read" if count == 1 else f"{count} key characteristics are read"


def _towards(stroke: float, limit: float, count: int) -> str:
    return f" to {stroke:g} mm, with at most {limit:g} N{' each' * (count > 1)}"


def _alike(numbers: Sequence[int], value) -> Iterable[tuple[Any, list[int]]]:
    """Numbers of items of one value together, in their order."""
    for one in dict.fromkeys(value(i) for i in numbers):
        yield one, [i for i in numbers if value(i) == one]


def _names(items, numbers: Sequence[int]) -> list[str]:
    return [items[i].name for i in numbers]


def _do(noun: str, names: Sequence[str], plural: str, singular: str) -> str:
    return f"{noun}s {_listed(names)} {plural}" if len(names) > 1 else f"{noun} {names[0]} {singular}"


def _listed(names: Sequence[str]) -> str:
    if len(names) > MOST:
        return f"{', '.join(names[: MOST - 2])}, … {names[-1]} ({len(names)})"
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else names[0]
