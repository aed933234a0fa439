"""Checks of the stages: which items each closes or opens, and in which order."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Sequence
from typing import Any

__all__ = ["check_stages", "check_known", "error_lines", "moves_assembly", "raise_errors", "placing_stages"]

#: Kinds of stages that close the items of each table.
CLOSING = {"locators": ("locate", "clamp", "measure"), "clamps": ("clamp",), "welds": ("weld",)}


def placing_stages(scene) -> dict[str, str]:
    """The stage that places each part: the first locate stage of its locators, or the first stage if it has none."""
    stations = [str(stage.name) for stage in scene.stages if stage.kind == "locate"]
    placed_in = {}
    for part in scene.parts:
        named = {locator.stage for locator in scene.locators if locator.part == part.name}
        placed_in[part.name] = next((name for name in stations if name in named), str(scene.stages[0].name))
    return placed_in


def moves_assembly(scene, stage) -> bool:
    """Whether a stage moves placed parts to locators of its own, and opens all earlier locators and clamps."""
    if stage is scene.stages[0]:
        return False
    placed_in = placing_stages(scene)
    return stage.kind in ("locate", "measure") and any(
        locator.stage == stage.name and placed_in.get(locator.part, stage.name) != stage.name
        for locator in scene.locators
    )


def error_lines(check: Callable[..., Any], *arguments: Any) -> list[str]:
    """The lines of the error of a check; empty if it passes."""
    try:
        check(*arguments)
    except ValueError as error:
        return str(error).splitlines()
    return []


def raise_errors(lines: Iterable[str]) -> None:
    """Raise ValueError with all lines, if there are any."""
    message = "\n".join(lines)
    if message:
        raise ValueError(message)


def check_stages(scene) -> None:
    """Every locator, clamp and weld has its stage, and the order of a stage names what it closes or opens.

    Raises
    ------
    ValueError
        One line per error, with the key and the remedy.
    """
    errors = error_lines(_check_kinds, scene)
    for key, kinds in CLOSING.items():
        fitting = [stage.name for stage in scene.stages if stage.kind in kinds]
        for i, item in enumerate(getattr(scene, key)):
            if item.stage not in fitting:
                errors.append(
                    f"{key}[{i}].stage ({item.name}): no stage of kind {' or '.join(kinds)} is called {item.stage!r}; "
                    f"add one to [[stages]], or name one of: {', '.join(fitting) or 'none yet'}"
                )
    if not errors:  # the next checks need existing stages
        errors = error_lines(_check_present, scene)
        closed: list[str] = []  # names of the closed locators and clamps
        for i, stage in enumerate(scene.stages):
            closed, lines = _check_stage(scene, i, stage, closed)
            errors += lines
    raise_errors(errors)


def _check_stage(scene, i: int, stage, closed: list[str]) -> tuple[list[str], list[str]]:
    """Names of the closed locators and clamps after a stage, and the errors of the stage."""
    errors: list[str] = []
    if stage.kind == "release":
        errors += error_lines(_check_keep, scene, f"stages[{i}].keep ({stage.name})", stage, closed)
        kept = {locator.name for locator in scene.locators} if stage.keep is None else set(stage.keep)
        moved = [name for name in closed if name not in kept]
        closed = [name for name in closed if name in kept]
    else:
        moved = [item.name for key in CLOSING for item in getattr(scene, key) if item.stage == stage.name]
        if moves_assembly(scene, stage):
            closed = []
        closed = closed + (moved if stage.kind != "weld" else [])
    if stage.order is not None:
        errors += error_lines(_check_order, scene, f"stages[{i}].order ({stage.name})", stage, moved)
    if stage.kind in ("locate", "measure") and (stage.path or stage.increments) and not moves_assembly(scene, stage):
        key = "path" if stage.path else "increments"
        errors.append(f"stages[{i}].{key} ({stage.name}): nothing moves in this stage: remove it")
    if stage.path == "one-step":
        errors += error_lines(_check_guns, scene, f"stages[{i}].path ({stage.name})", stage)
    return closed, errors


def _check_guns(scene, key, stage) -> None:
    guns = [weld.name for weld in scene.welds if weld.stage == stage.name and weld.gun is not None]
    if guns:
        raise ValueError(
            f"{key}: the gun of weld {guns[0]!r} presses before its weld is made, which one-step does not allow; give "
            "the stage increments, or remove path"
        )


def _check_kinds(scene) -> None:
    sequence = [stage.kind for stage in scene.stages]
    if sequence[0] != "locate":
        raise ValueError("stages: the first stage must be of kind 'locate'; put one first")
    if "measure" in sequence[:-1]:
        raise ValueError("stages: 'measure' must be the last stage, once; move or remove it")
    if scene.measurements and "measure" not in sequence:
        raise ValueError("measurements: no stage reads them; add a last stage of kind 'measure' or remove them")


def _check_present(scene) -> None:
    """Later locate stages place a part, and no stage acts on a part before it is placed."""
    place = {stage.name: i for i, stage in enumerate(scene.stages)}
    placed_in = placing_stages(scene)
    for i, stage in enumerate(scene.stages[1:], 1):
        if stage.kind == "locate" and all(locator.stage != stage.name for locator in scene.locators):
            raise ValueError(
                f"stages[{i}] ({stage.name}): no locator names it, so it places nothing; give locators "
                f"stage = {stage.name!r}, or remove it"
            )
    for key in ("locators", "clamps", "welds"):
        for i, item in enumerate(getattr(scene, key)):
            for name in item.parts if key == "welds" else (item.part,):
                if name in placed_in and place[item.stage] < place[placed_in[name]]:
                    raise ValueError(
                        f"{key}[{i}].stage: part {name!r} is placed in {placed_in[name]!r}, after {item.stage!r}; "
                        "name a later stage, or place the part before"
                    )
    for i, fixture in enumerate(scene.fixtures):
        stations = [stage.name for stage in scene.stages if stage.kind == "locate"]
        if fixture.stage is not None and fixture.stage not in stations:
            raise ValueError(
                f"fixtures[{i}].stage: no stage of kind locate is called {fixture.stage!r}; name one of: "
                f"{', '.join(stations)}"
            )


def _check_keep(scene, key, stage, closed: Sequence[str]) -> None:
    """Items that a release keeps are closed before it."""
    for name in stage.keep or ():
        _single(scene, key, name)
        check_known(key, name, {item.name for item in (*scene.locators, *scene.clamps)}, "locator or clamp")
        if name not in closed:
            raise ValueError(f"{key}: {name!r} {_whereabouts(scene, stage, name)}, so it cannot stay closed; remove it")


def _check_order(scene, key, stage, moved: Sequence[str]) -> None:
    """The groups of the order have each name of `moved` once, and no other."""
    if any(isinstance(group, str) for group in stage.order):  # an error of the schema already
        return
    verb = "opens" if stage.kind == "release" else "closes"
    seen: set[str] = set()
    for group in stage.order:
        if not group:
            raise ValueError(f"{key}: a group is empty; give it names, or remove it")
        for name in group:
            if name in seen:
                raise ValueError(f"{key}: {name!r} is given more than once; keep it in one group")
            seen.add(name)
            _single(scene, key, name)
            if name not in moved:
                everything = {item.name for table in CLOSING for item in getattr(scene, table)}
                check_known(key, name, everything, "locator, clamp or weld")
                raise ValueError(
                    f"{key}: {name!r} {_whereabouts(scene, stage, name)}; "
                    f"remove it, this stage {verb} {_listed(moved) or 'nothing'}"
                )
    left_out = [name for name in moved if name not in seen]
    if left_out:
        raise ValueError(
            f"{key}: the stage {verb} {_listed(left_out)} too; add each to a group, or as a group of its own"
        )


def _whereabouts(scene, stage, name: str) -> str:
    """Reason why a stage neither closes nor opens the item of this name."""
    names = [stage.name for stage in scene.stages]
    table, item = next((key, item) for key in CLOSING for item in getattr(scene, key) if item.name == name)
    if stage.kind != "release":
        return f"belongs to stage {item.stage!r}"
    if table == "welds":
        return "is a weld, and welds stay"
    if names.index(item.stage) > names.index(stage.name):
        return f"closes only in stage {item.stage!r}, after this one"
    if stage.keep is None and table == "locators" or name in (stage.keep or ()):
        return "stays closed (keep)"
    return "is open already"


def _single(scene, key, name: str) -> None:
    tables = [key for key in CLOSING for item in getattr(scene, key) if item.name == name]
    if len(tables) > 1:
        raise ValueError(f"{key}: {name!r} is a name in {' and in '.join(tables)}; give each item its own name")


def _listed(names: Sequence[str], most: int = 8) -> str:
    text = ", ".join(repr(name) for name in names[:most])
    return text + f" and {len(names) - most} more" * (len(names) > most)


def check_known(key: str, name: str, names: Iterable[str], what: str) -> None:
    """Raise ValueError if `names` lacks a name, with the most similar one."""
    names = sorted(set(names))
    if name not in names:
        near = difflib.get_close_matches(name, names, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(names) or 'none'}"
        raise ValueError(f"{key}: there is no {what} called {name!r}; {hint}")
