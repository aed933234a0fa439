"""Checks of the stages: which items each closes or opens, and in which order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from mic.system.arguments import did_you_mean

__all__ = ["check_stages", "moves_assembly", "placing_stages", "unknown"]

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


def check_stages(scene) -> Iterator[str]:
    """Every locator, clamp and weld has its stage, and the order of a stage names what it closes or opens.

    Yields
    ------
    str
        One line per error, with the key and the remedy.
    """
    errors = [*_check_kinds(scene), *_check_closing(scene)]
    yield from errors
    if errors:  # the next checks need existing stages
        return
    yield from _check_present(scene)
    closed: list[str] = []  # names of the closed locators and clamps
    for i, stage in enumerate(scene.stages):
        closed, lines = _check_stage(scene, i, stage, closed)
        yield from lines


def _check_kinds(scene) -> Iterator[str]:
    sequence = [stage.kind for stage in scene.stages]
    if sequence[0] != "locate":
        yield "stages: the first stage must be of kind 'locate'; put one first"
    if "measure" in sequence[:-1]:
        yield "stages: 'measure' must be the last stage, once; move or remove it"
    if scene.measurements and "measure" not in sequence:
        yield "measurements: no stage reads them; add a last stage of kind 'measure' or remove them"


def _check_closing(scene) -> Iterator[str]:
    """Every item names a stage of a kind that closes it."""
    for key, kinds in CLOSING.items():
        fitting = [stage.name for stage in scene.stages if stage.kind in kinds]
        for i, item in enumerate(getattr(scene, key)):
            if item.stage not in fitting:
                yield (
                    f"{key}[{i}].stage ({item.name}): no stage of kind {' or '.join(kinds)} is called {item.stage!r}; "
                    f"add one to [[stages]], or name one of: {', '.join(fitting) or 'none yet'}"
                )


def _check_present(scene) -> Iterator[str]:
    """Later locate stages place a part, and no stage acts on a part before it is placed."""
    place = {stage.name: i for i, stage in enumerate(scene.stages)}
    placed_in = placing_stages(scene)
    for i, stage in enumerate(scene.stages[1:], 1):
        if stage.kind == "locate" and all(locator.stage != stage.name for locator in scene.locators):
            yield (
                f"stages[{i}] ({stage.name}): no locator names it, so it places nothing; give locators "
                f"stage = {stage.name!r}, or remove it"
            )
    for key in CLOSING:
        for i, item in enumerate(getattr(scene, key)):
            for name in item.parts if key == "welds" else (item.part,):
                if name in placed_in and place[item.stage] < place[placed_in[name]]:
                    yield (
                        f"{key}[{i}].stage: part {name!r} is placed in {placed_in[name]!r}, after {item.stage!r}; "
                        "name a later stage, or place the part before"
                    )
    stations = [stage.name for stage in scene.stages if stage.kind == "locate"]
    for i, fixture in enumerate(scene.fixtures):
        if fixture.stage is not None and fixture.stage not in stations:
            yield (
                f"fixtures[{i}].stage: no stage of kind locate is called {fixture.stage!r}; name one of: "
                f"{', '.join(stations)}"
            )


def _check_stage(scene, i: int, stage, closed: list[str]) -> tuple[list[str], list[str]]:
    """Names of the closed locators and clamps after a stage, and the errors of the stage."""
    errors: list[str] = []
    at = lambda key: f"stages[{i}].{key} ({stage.name})"
    if stage.kind == "release":
        errors += _check_keep(scene, at("keep"), stage, closed)
        kept = {locator.name for locator in scene.locators} if stage.keep is None else set(stage.keep)
        moved = [name for name in closed if name not in kept]
        closed = [name for name in closed if name in kept]
    else:
        moved = [item.name for key in CLOSING for item in getattr(scene, key) if item.stage == stage.name]
        if moves_assembly(scene, stage):
            closed = []
        closed = closed + (moved if stage.kind != "weld" else [])
    if stage.order is not None:
        errors += _check_order(scene, at("order"), stage, moved)
    if stage.kind in ("locate", "measure") and (stage.path or stage.increments) and not moves_assembly(scene, stage):
        errors.append(f"{at('path' if stage.path else 'increments')}: nothing moves in this stage: remove it")
    guns = [weld.name for weld in scene.welds if weld.stage == stage.name and weld.gun is not None]
    if stage.path == "one-step" and guns:
        errors.append(
            f"{at('path')}: the gun of weld {guns[0]!r} presses before its weld is made, which one-step does not "
            "allow; give the stage increments, or remove path"
        )
    return closed, errors


def _check_keep(scene, at: str, stage, closed: Sequence[str]) -> list[str]:
    """Items that a release keeps are closed before it: the first error."""
    known = [item.name for item in (*scene.locators, *scene.clamps)]
    for name in stage.keep or ():
        if found := _check_single(scene, at, name) or unknown(at, name, known, "locator or clamp"):
            return found
        if name not in closed:
            return [f"{at}: {name!r} {_whereabouts(scene, stage, name)}, so it cannot stay closed; remove it"]
    return []


def _check_order(scene, at: str, stage, moved: Sequence[str]) -> list[str]:
    """The groups of the order have each name of `moved` once, and no other: the first error."""
    if any(isinstance(group, str) for group in stage.order):  # an error of the schema already
        return []
    if not all(stage.order):
        return [f"{at}: a group is empty; give it names, or remove it"]
    verb = "opens" if stage.kind == "release" else "closes"
    known = [item.name for table in CLOSING for item in getattr(scene, table)]
    names = [name for group in stage.order for name in group]
    for i, name in enumerate(names):
        if name in names[:i]:
            return [f"{at}: {name!r} is given more than once; keep it in one group"]
        if found := _check_single(scene, at, name) or unknown(at, name, known, "locator, clamp or weld"):
            return found
        if name not in moved:
            where = _whereabouts(scene, stage, name)
            return [f"{at}: {name!r} {where}; remove it, this stage {verb} {_listed(moved) or 'nothing'}"]
    left_out = [name for name in moved if name not in names]
    if left_out:
        return [f"{at}: the stage {verb} {_listed(left_out)} too; add each to a group, or as a group of its own"]
    return []


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


def _check_single(scene, at: str, name: str) -> list[str]:
    tables = [key for key in CLOSING for item in getattr(scene, key) if item.name == name]
    if len(tables) < 2:
        return []
    return [f"{at}: {name!r} is a name in {' and in '.join(tables)}; give each item its own name"]


def _listed(names: Sequence[str], most: int = 8) -> str:
    text = ", ".join(repr(name) for name in names[:most])
    return text + f" and {len(names) - most} more" * (len(names) > most)


def unknown(at: str, name: str, names: Iterable[str], what: str) -> list[str]:
    """The error of a name that is not among `names`, with the most similar one; empty if it is among them."""
    names = sorted(set(names))
    if name in names:
        return []
    return [f"{at}: there is no {what} called {name!r}; {did_you_mean(name, names)}"]
