"""Stages that make a process: what closes in which of them, in which order, and what opens only after it has closed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

__all__ = ["check_stages", "known"]

#: What stages close, by the scene's table, and the kinds of stages that may.
CLOSING = {"locators": ("locate", "clamp"), "clamps": ("clamp",), "welds": ("weld",)}


def check_stages(scene) -> None:
    """Every locator, clamp and weld has its stage, and every stage orders just what it closes or opens.

    Raises
    ------
    ValueError
        Naming the key and the remedy.
    """
    _check_kinds(scene)
    for key, kinds in CLOSING.items():
        fitting = [stage.name for stage in scene.stages if stage.kind in kinds]
        for i, item in enumerate(getattr(scene, key)):
            if item.stage not in fitting:
                raise ValueError(
                    f"{key}[{i}].stage: no stage of kind {' or '.join(kinds)} is called {item.stage!r}; "
                    f"add one to [[stages]], or name one of: {', '.join(fitting) or 'none yet'}"
                )
    held: list[str] = []  # names of the locators and clamps that are closed, those of all stages so far
    for i, stage in enumerate(scene.stages):
        if stage.kind == "release":
            kept = _check_keep(scene, f"stages[{i}].keep", stage, held)
            own = [name for name in held if name not in kept]
            held = [name for name in held if name in kept]
        else:
            own = [item.name for key in CLOSING for item in getattr(scene, key) if item.stage == stage.name]
            held += own if stage.kind != "weld" else []
        if stage.order is not None:
            _check_order(scene, f"stages[{i}].order", stage, own)
        if stage.path == "one-step":
            _check_guns(scene, f"stages[{i}].path", stage)


def _check_guns(scene, key, stage) -> None:
    guns = [weld.name for weld in scene.welds if weld.stage == stage.name and weld.gun is not None]
    if guns:
        raise ValueError(
            f"{key}: the gun of weld {guns[0]!r} presses before its weld is made, and one-step does all at once; give "
            "the stage increments, or remove path"
        )


def _check_kinds(scene) -> None:
    sequence = [stage.kind for stage in scene.stages]
    if sequence[0] != "locate" or sequence.count("locate") != 1:
        raise ValueError("stages: the first stage, and only the first, must be of kind 'locate'")
    if "measure" in sequence[:-1]:
        raise ValueError("stages: 'measure' may only come last, once")
    if scene.measurements and "measure" not in sequence:
        raise ValueError("measurements: nothing measures them; add a last stage of kind 'measure' or remove them")


def _check_keep(scene, key, stage, held: Sequence[str]) -> set[str]:
    """What a release leaves closed."""
    if stage.keep is None:
        return {locator.name for locator in scene.locators}
    for name in stage.keep:
        _single(scene, key, name)
        known(key, name, {item.name for item in (*scene.locators, *scene.clamps)}, "locator or clamp")
        if name not in held:
            raise ValueError(f"{key}: {name!r} {_whereabouts(scene, stage, name)}, so it cannot stay closed; remove it")
    return set(stage.keep)


def _check_order(scene, key, stage, own: Sequence[str]) -> None:
    """Every name of `own` stands in one group of the order, and no other name does."""
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
