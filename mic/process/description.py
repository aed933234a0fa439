"""The process in words: one sentence for each step of a stage."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from mic.process.actions import Action, Close, Join, Open, Placement, PlaceParts, Read, ResolveOverlap
from mic.process.plan import StagePlan, Step
from mic.scene.stages import placing_stages

__all__ = ["alignments", "opening", "sentences"]

MAX_NAMES = 6  # longer lists are shortened to their first names and the last


def opening(plan: StagePlan, contacts: bool) -> str:
    """Describe the treatment of contact in a stage.

    Parameters
    ----------
    plan : StagePlan
    contacts : bool
        Whether the assembly has any contact pairs.
    """
    if not contacts:
        return "no contact"
    if not plan.resolves:
        return "parts are placed without contact" if plan.kind == "locate" else "nothing moves"
    if plan.path == "followed":
        return "contact active, load path followed"
    if plan.path == "one-step":
        return "contact active, everything at once in one step"
    return f"contact active, {plan.increments} increment{'s' * (plan.increments > 1)} for each step"


def sentences(scene, plan: StagePlan) -> list[str]:
    """One sentence for each step of a stage."""
    lines = [_step_sentence(scene, step) for step in plan.steps]
    return [line for line in lines if line] or [_EMPTY[plan.kind]]


_EMPTY = {
    "locate": "no part is placed",
    "clamp": "nothing closes",
    "weld": "nothing is welded",
    "release": "nothing opens",
    "measure": "nothing is measured",
}


def _step_sentence(scene, step: Step) -> str:
    clauses = [clause for action in step.move for clause in _clauses(scene, action)]
    rests = [scene.parts[p].name for p in step.resting if p not in step.parked]
    if rests and any(isinstance(action, Placement | Open) and not action.guns for action in step.move):
        clauses.append(f"{_enumeration(rests)} {'is' if len(rests) == 1 else 'are'} held by contact alone")
    if step.settles and len(clauses) > 1:
        return f"{', '.join(clauses[1:])}; meanwhile {clauses[0]}"
    return ("; " if any(isinstance(action, Placement) for action in step.move) else ", ").join(clauses)


def _clauses(scene, action: Action) -> Iterable[str]:
    if isinstance(action, Placement):
        placed_in, locators = placing_stages(scene), [scene.locators[i] for i in action.locators]
        others = [one.name for one in locators if placed_in[one.part] != one.stage]
        if others:
            yield f"all locators and clamps open, and the assembly is placed on {_enumeration(others)}"
        for part in scene.parts:
            names = [one.name for one in locators if one.part == part.name and placed_in[one.part] == one.stage]
            if names:
                yield f"{part.name} is placed on {_enumeration(names)}"
        if action.forces:
            yield "gravity acts"
        if isinstance(action, PlaceParts):
            for part in scene.parts:
                if all(one.part != part.name for one in scene.locators):
                    yield f"{part.name} is placed without locators"
    elif isinstance(action, ResolveOverlap):
        yield "overlaps between parts are resolved"
    elif isinstance(action, Close):
        yield from _closing(scene, action)
    elif isinstance(action, Open):
        yield from _clause("gun", _names(scene.welds, action.guns), "open", "opens")
        yield from _clause("clamp", _names(scene.clamps, sorted(action.clamps)), "open", "opens")
        yield from _clause("locator", _names(scene.locators, action.locators), "open", "opens")
    elif isinstance(action, Join):
        as_found = _names(scene.welds, [i for i in action.welds if i not in action.gap])
        yield from _clause("weld", as_found, "join the sheets as they stand", "joins the sheets as they stand")
        plural, singular = "close their gaps and join the sheets", "closes its gap and joins the sheets"
        yield from _clause("weld", _names(scene.welds, action.gap), plural, singular)
    elif isinstance(action, Read):
        count = len(scene.measurements)
        yield "1 key characteristic is measured" if count == 1 else f"{count} key characteristics are measured"
        yield from (f"{sentence[0].lower()}{sentence[1:-1]}" for sentence in alignments(scene))


def alignments(scene) -> Iterable[str]:
    """A sentence for each frame and best fit: before which measurements it aligns the assembly, and to which points."""
    aligned: dict[tuple, list[str]] = {}
    for item in scene.measurements:
        frame = scene.frame_of(item)
        if frame is not None:
            points = [point if isinstance(point, str) else point.name for point in scene.points_of(frame)]
            key = (frame.kind.replace("-fit", " fit"), f"frame {frame.name}, ", *points)
            aligned.setdefault((key, tuple(frame.weights or ())), []).append(item.name)
        elif item.best_fit is not None:
            aligned.setdefault((("best fit", "", *item.best_fit), ()), []).append(item.name)
    for ((kind, name, *points), weights), names in aligned.items():
        weighted = f", weights {_enumeration([f'{weight:g}' for weight in weights])}" if weights else ""
        of = _enumeration(names) if len(names) < len(scene.measurements) else "all of them"
        yield f"Before {of}, the assembly is aligned ({name}{kind} of {_enumeration(points)}{weighted})."


def _closing(scene, action: Close) -> Iterable[str]:
    clamps, welds = scene.clamps, scene.welds
    yield from _clause("locator", _names(scene.locators, action.locators), "close", "closes")
    for stroke, numbers in _groups(action.strokes, lambda i: clamps[i].stroke):
        yield from _clause("clamp", _names(clamps, numbers), "close", "closes", f" to {stroke:g} mm")
    for force, numbers in _groups(action.forces, lambda i: clamps[i].force):
        yield from _clause("clamp", _names(clamps, numbers), "close", "closes", f" ({_newtons(force, numbers)})")
    for (stroke, limit), numbers in _groups(action.limited, lambda i: (clamps[i].stroke, clamps[i].limit)):
        towards = f" to {stroke:g} mm, with at most {_newtons(limit, numbers)}"
        yield from _clause("clamp", _names(clamps, numbers), "close", "closes", towards)
    for force, numbers in _groups(action.guns, lambda i: welds[i].gun):
        yield from _clause("gun", _names(welds, numbers), "press", "presses", f" ({_newtons(force, numbers)})")


def _newtons(force: float, numbers: Sequence[int]) -> str:
    return f"{force:g} N{' each' * (len(numbers) > 1)}"


def _groups(numbers: Sequence[int], value) -> Iterable[tuple[Any, list[int]]]:
    """Items grouped by value, in their order."""
    for one in dict.fromkeys(value(i) for i in numbers):
        yield one, [i for i in numbers if value(i) == one]


def _names(items, numbers: Sequence[int]) -> list[str]:
    return [items[i].name for i in numbers]


def _clause(noun: str, names: Sequence[str], plural: str, singular: str, how: str = "") -> Iterable[str]:
    """Describe the action on the items with these names; empty if there are none."""
    if names:
        yield (f"{noun}s {_enumeration(names)} {plural}" if len(names) > 1 else f"{noun} {names[0]} {singular}") + how


def _enumeration(names: Sequence[str]) -> str:
    if len(names) > MAX_NAMES:
        return f"{', '.join(names[: MAX_NAMES - 2])}, … {names[-1]} ({len(names)})"
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else names[0]
