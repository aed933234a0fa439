"""Stages that make a process: what closes in which of them, in which order, and what opens only after it has closed."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Sequence
from typing import Any

__all__ = ["check_stages", "known", "moves_assembly", "set_down_in", "told"]

#: What stages close, by the scene's table, and the kinds of stages that may.
CLOSING = {"locators": ("locate", "clamp", "measure"), "clamps": ("clamp",), "welds": ("weld",)}


def set_down_in(scene) -> dict[str, str]:
    """The stage in which each part is set down: the first locate stage that one of its locators names; the first of all
    where none does."""
    stations = [str(stage.name) for stage in scene.stages if stage.kind == "locate"]
    found = {}
    for part in scene.parts:
        named = {locator.stage for locator in scene.locators if locator.part == part.name}
        found[part.name] = next((name for name in stations if name in named), str(scene.stages[0].name))
    return found


def moves_assembly(scene, stage) -> bool:
    """Whether a stage sets down what stands already, on locators of its own: all that holds it opens."""
    if stage is scene.stages[0]:
        return False
    there = set_down_in(scene)
    own = [locator for locator in scene.locators if locator.stage == stage.name]
    return stage.kind in ("locate", "measure") and any(
        there.get(locator.part, stage.name) != stage.name for locator in own
    )


def told(check: Callable[..., Any], *arguments: Any) -> list[str]:
    """The lines of what a check finds wrong."""
    try:
        check(*arguments)
    except ValueError as error:
        return str(error).splitlines()
    return []


def check_stages(scene) -> None:
    """Every locator, clamp and weld has its stage, and every stage orders just what it closes or opens.

    Raises
    ------
    ValueError
        One line a problem, naming the key and the remedy.
    """
    found = told(_check_kinds, scene)
    for key, kinds in CLOSING.items():
        fitting = [stage.name for stage in scene.stages if stage.kind in kinds]
        for i, item in enumerate(getattr(scene, key)):
            if item.stage not in fitting:
                found.append(
                    f"{key}[{i}].stage ({item.name}): no stage of kind {' or '.join(kinds)} is called {item.stage!r}; "
                    f"add one to [[stages]], or name one of: {', '.join(fitting) or 'none yet'}"
                )
    if not found:  # what follows reads them in their order
        found = told(_check_present, scene)
        held: list[str] = []  # names of the locators and clamps that are closed, those of all stages so far
        for i, stage in enumerate(scene.stages):
            held, lines = _check_stage(scene, i, stage, held)
            found += lines
    if found:
        raise ValueError("\n".join(found))


def _check_stage(scene, i: int, stage, held: list[str]) -> tuple[list[str], list[str]]:
    """What is held after a stage, and what is wrong with it."""
    found: list[str] = []
    if stage.kind == "release":
        found += told(_check_keep, scene, f"stages[{i}].keep ({stage.name})", stage, held)
        kept = {locator.name for locator in scene.locators} if stage.keep is None else set(stage.keep)
        own = [name for name in held if name not in kept]
        held = [name for name in held if name in kept]
    else:
        own = [item.name for key in CLOSING for item in getattr(scene, key) if item.stage == stage.name]
        if moves_assembly(scene, stage):
            held = []
        held = held + (own if stage.kind != "weld" else [])
    if stage.order is not None:
        found += told(_check_order, scene, f"stages[{i}].order ({stage.name})", stage, own)
    if stage.kind in ("locate", "measure") and (stage.path or stage.increments) and not moves_assembly(scene, stage):
        key = "path" if stage.path else "increments"
        found.append(f"stages[{i}].{key} ({stage.name}): nothing moves in this stage: remove it")
    if stage.path == "one-step":
        found += told(_check_guns, scene, f"stages[{i}].path ({stage.name})", stage)
    return held, found


def _check_guns(scene, key, stage) -> None:
    guns = [weld.name for weld in scene.welds if weld.stage == stage.name and weld.gun is not None]
    if guns:
        raise ValueError(
            f"{key}: the gun of weld {guns[0]!r} presses before its weld is made, and one-step does all at once; give "
            "the stage increments, or remove path"
        )


def _check_kinds(scene) -> None:
    sequence = [stage.kind for stage in scene.stages]
    if sequence[0] != "locate":
        raise ValueError("stages: the first stage must be of kind 'locate': it sets the parts down")
    if "measure" in sequence[:-1]:
        raise ValueError("stages: 'measure' may only come last, once")
    if scene.measurements and "measure" not in sequence:
        raise ValueError("measurements: nothing measures them; add a last stage of kind 'measure' or remove them")


def _check_present(scene) -> None:
    """Later locate stages set something down, and nothing is done to a part before it is there."""
    place = {stage.name: i for i, stage in enumerate(scene.stages)}
    there = set_down_in(scene)
    for i, stage in enumerate(scene.stages[1:], 1):
        if stage.kind == "locate" and all(locator.stage != stage.name for locator in scene.locators):
            raise ValueError(
                f"stages[{i}] ({stage.name}): no locator names it, so nothing is set down in it; give locators "
                f"stage = {stage.name!r}, or remove it"
            )
    for key in ("locators", "clamps", "welds"):
        for i, item in enumerate(getattr(scene, key)):
            for name in item.parts if key == "welds" else (item.part,):
                if name in there and place[item.stage] < place[there[name]]:
                    raise ValueError(
                        f"{key}[{i}].stage: part {name!r} is set down in stage {there[name]!r}, after {item.stage!r}; "
                        "name a later stage, or set the part down before"
                    )
    for i, fixture in enumerate(scene.fixtures):
        stations = [stage.name for stage in scene.stages if stage.kind == "locate"]
        if fixture.stage is not None and fixture.stage not in stations:
            raise ValueError(
                f"fixtures[{i}].stage: no stage of kind locate is called {fixture.stage!r}; name one of: "
                f"{', '.join(stations)}"
            )


def _check_keep(scene, key, stage, held: Sequence[str]) -> None:
    """What a release leaves closed is closed."""
    for name in stage.keep or ():
        _single(scene, key, name)
        known(key, name, {item.name for item in (*scene.locators, *scene.clamps)}, "locator or clamp")
        if name not in held:
            raise ValueError(f"{key}: {name!r} {_whereabouts(scene, stage, name)}, so it cannot stay closed; remove it")


def _check_order(scene, key, stage, own: Sequence[str]) -> None:
    """Every name of `own` stands in one group of the order, and no other name does."""
    if any(isinstance(group, str) for group in stage.order):  # told where groups are read: its letters are no names
        return
    verb = "opens" if stage.kind == "release" else "closes"
    seen: set[str] = set()
    for group in stage.order:
        if not group:
            raise ValueError(f"{key}: a group is empty; give it names, or remove it")
        for name in group:
            if name in seen:
                raise ValueError(f"{key}: {name!r} stands more than once; name it once, in the group that it {verb} in")
            seen.add(name)
            _single(scene, key, name)
            if name not in own:
                everything = {item.name for table in CLOSING for item in getattr(scene, table)}
                known(key, name, everything, "locator, clamp or weld")
                raise ValueError(
                    f"{key}: {name!r} {_whereabouts(scene, stage, name)}; "
                    f"remove it, this stage {verb} {_listed(own) or 'nothing'}"
                )
    left_out = [name for name in own if name not in seen]
    if left_out:
        raise ValueError(
            f"{key}: the stage {verb} {_listed(left_out)} too; add each to the group that it {verb} with, or to one of "
            "its own"
        )


def _whereabouts(scene, stage, name: str) -> str:
    """Why a stage neither closes nor opens what has this name."""
    place = [each.name for each in scene.stages]
    table, item = next((key, item) for key in CLOSING for item in getattr(scene, key) if item.name == name)
    if stage.kind != "release":
        return f"belongs to stage {item.stage!r}"
    if table == "welds":
        return "is a weld, and welds stay"
    if place.index(item.stage) > place.index(stage.name):
        return f"closes only in stage {item.stage!r}, after this one"
    if stage.keep is None and table == "locators" or name in (stage.keep or ()):
        return "is kept"
    return "has opened before"


def _single(scene, key, name: str) -> None:
    tables = [key for key in CLOSING for item in getattr(scene, key) if item.name == name]
    if len(tables) > 1:
        raise ValueError(f"{key}: {name!r} stands in {' and in '.join(tables)}; give each its own name")


def _listed(names: Sequence[str], most: int = 8) -> str:
    shown = ", ".join(repr(name) for name in names[:most])
    return shown + f" and {len(names) - most} more" * (len(names) > most)


def known(key: str, name: str, names: Iterable[str], what: str) -> None:
    """Raise ValueError where `names` has no such name, with the one that was perhaps meant."""
    names = sorted(set(names))
    if name not in names:
        near = difflib.get_close_matches(name, names, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(names) or 'none'}"
        raise ValueError(f"{key}: there is no {what} called {name!r}; {hint}")
