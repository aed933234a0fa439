"""The scene reference, generated from the schema: ``python -m mic.scene.reference`` prints the page docs/scene.md."""

from __future__ import annotations

import json
import types
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mic.scene.keys import Vector
from mic.scene.schema import Scene
from mic.scene.settings import SETTINGS

__all__ = ["reference"]

OPENING = """# Scene reference

A scene is one TOML file, or a folder that holds `scene.toml`. mm, N, MPa. Unknown keys are errors. File names are
relative to the scene. `mic check SCENE` validates it and shows what will be modelled. Directions may have any length
but zero. `mic init MESH…` writes a first scene for meshes of your own.

**Many in one table.** A table of `[[locators]]`, `[[clamps]]`, `[[welds]]` or `[[measurements]]` with
`file = "NAME.csv"` stands for one item a row of that file. Its other keys hold for every row:

```toml
[[welds]]
file = "welds.csv"
parts = ["inner", "outer"]
radius = 3
```

Columns are keys, and what a row says comes before what the table says; `x`, `y` and `z` together are `point`; members
of a list stand in one cell with blanks between them (`inner outer`, `0 0 1`); an empty cell leaves the key out. Commas,
semicolons or tabs separate the cells. Without a column `name`, rows are called after the table's `name`, or the file,
and numbered. A table of `[[welds]]` with `points = [[x, y, z], …]` stands for a weld at each, called `NAME-1`,
`NAME-2`, ….
"""
SETTING = """`setting` fills in what the scene leaves open, and only that: the element size of parts with a `geometry`
(its named size), how closely the `path` of friction is followed, the `spacing_factor` of zones that give neither
`pairs`, `spacing` nor `points`, `samples`.

| `setting` | `size` | `tolerance` of the path | `spacing_factor` | `samples` |
| --- | --- | --- | --- | --- |
{rows}

What each is worth in accuracy, and what it costs, is measured by `python -m verification run trade`; of your own scene,
`python -m verification scene SCENE --to 2%` chooses among them, or says what it would take.
"""
WORDS: dict[Any, str] = {float: "number", int: "whole number", str: "text", bool: "true or false"}


def reference() -> str:
    """Every table and key with its default and its meaning, in Markdown."""
    plain, tables = [], []
    for key, field in Scene.model_fields.items():
        kinds = [kind for kind in _classes(field.annotation) if issubclass(kind, BaseModel)]
        if not kinds:
            plain += [] if field.exclude else [(key, field)]
            continue
        several = "list" in str(field.annotation)
        tables.append(_table(f"[[{key}]]" if several else f"[{key}]", kinds))
    rows = "\n".join(
        f'| `"{name}"` | `"{one["size"]}"` | {one["tolerance"]:g} | {one["spacing_factor"]:g} | {one["samples"]} |'
        for name, one in SETTINGS.items()
    )
    top = "## Top level\n\n" + _keys(plain)
    return "\n".join([OPENING, top, SETTING.format(rows=rows), *tables]).rstrip() + "\n"


def _table(title: str, kinds: list[type[BaseModel]]) -> str:
    sections, below = [f"## `{title}`\n"], []
    for kind in kinds:
        own = [(name, field) for name, field in kind.model_fields.items() if not _tables(field)]
        sections += [_prose(kind) + "\n", _keys(own)]
        below += [
            _table(f"[[{title.strip('[]')}.{name}]]", _tables(field))
            for name, field in kind.model_fields.items()
            if _tables(field)
        ]
    return "\n".join([*sections, *below])


def _tables(field: FieldInfo) -> list[type[BaseModel]]:
    """The kinds of tables that a key is a list of; none for any other key."""
    inner = get_args(field.annotation) if get_origin(field.annotation) is list else ()
    return [kind for kind in inner if isinstance(kind, type) and issubclass(kind, BaseModel)]


def _prose(kind: type[BaseModel]) -> str:
    lines = [line.strip() for line in (kind.__doc__ or "").strip().splitlines()]
    return "\n".join(lines).replace("``", "`")


def _keys(fields: list[tuple[str, FieldInfo]]) -> str:
    rows = [f"| `{name}` | {_value(field)} | {_default(field)} | {field.description} |" for name, field in fields]
    return "\n".join(["| key | value | default | meaning |", "| --- | --- | --- | --- |", *rows, ""])


def _default(field: FieldInfo) -> str:
    if field.is_required() or field.default is None or field.default == "":
        return "required" if field.is_required() else ""
    return f"`{json.dumps(field.default)}`"


def _value(field: FieldInfo) -> str:
    """What a key takes, in words."""
    return _words(field.annotation, field.metadata)


def _words(annotation: Any, bounds: Iterable[Any] = ()) -> str:
    origin, inner = get_origin(annotation), get_args(annotation)
    if annotation == Vector:
        return "[x, y, z]"
    if origin is Annotated:
        return _words(inner[0], inner[1:])
    if origin is Literal:
        return " or ".join(f"`{json.dumps(word)}`" for word in inner)
    if origin in (Union, types.UnionType):
        return " or ".join(_words(item, bounds) for item in inner if item is not type(None))
    if origin is dict:
        return f"table of {_words(inner[1])}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"table {{ {', '.join(annotation.model_fields)} }}"
    if origin is list:
        return f"list of {_words(inner[0])}"
    if origin is tuple:
        return f"[{', '.join(_words(item) for item in inner)}]"
    words = WORDS.get(annotation, getattr(annotation, "__name__", str(annotation)))
    limits = [limit for bound in bounds for limit in _limits(bound)] if annotation in (float, int) else []
    return ", ".join([f"{words} {limits[0]}", *limits[1:]]) if limits else words


def _limits(bound: Any) -> list[str]:
    """Bounds of a number: pydantic keeps them one by one, or several in one field."""
    signs = (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤"))
    several = getattr(bound, "metadata", None)
    if several is not None:
        return [limit for item in several for limit in _limits(item)]
    given = [(sign, getattr(bound, name, None)) for name, sign in signs]
    return [f"{sign} {value:g}".replace("-", "−") for sign, value in given if value is not None]


def _classes(annotation) -> list[type]:
    """The classes that an annotation is made of."""
    inner = [found for argument in get_args(annotation) for found in _classes(argument)]
    return inner or ([annotation] if isinstance(annotation, type) else [])


if __name__ == "__main__":
    print(reference(), end="")
