"""The scene reference, generated from the schema: ``python -m mic.scene.reference`` prints the page docs/scene.md."""

from __future__ import annotations

import json
import types
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mic.scene.deviation import DeviationKeys
from mic.scene.keys import OnPart, OnSheet, Vector
from mic.scene.measurement import OtherPoint
from mic.scene.schema import Scene
from mic.scene.settings import SETTINGS

__all__ = ["reference"]

OPENING = """# Scene reference

A scene is one TOML file, or a folder that contains `scene.toml`. Units are mm, N, MPa. Unknown keys are errors. File
names are relative to the scene. `mic check SCENE` validates it and shows what will be modelled. `mic init MESH…` writes
a first scene for your meshes.

**Directions.** A vector `[x, y, z]` of any length but zero; or `"normal"`, the normal of the sheet; or `"in-plane x"`
(y, z), the axis projected into the sheet. A minus reverses it: `"-normal"`.

**Places.** Items on a part have one of these keys:

{places}
**Many items in one table.** A table of `[[locators]]`, `[[clamps]]`, `[[welds]]` or `[[measurements]]` with
`file = "NAME.csv"` stands for one item per row of that file. Its other keys apply to every row:

```toml
[[welds]]
file = "welds.csv"
parts = ["inner", "outer"]
radius = 3
```

Columns are keys and override those of the table; `x`, `y` and `z` form `point`; members of a list are separated by
spaces (`inner outer`, `0 0 1`); an empty cell omits the key. Cells are separated by commas, semicolons or tabs. Without
a column `name`, rows are numbered after the table's `name`, or the file. A table of `[[welds]]` with
`points = [[x, y, z], …]` stands for a weld at each point, called `NAME-1`, `NAME-2`, ….
"""
SETTING = """`setting` gives defaults where the scene states nothing: the named element size of parts with a `geometry`,
the `tolerance` of the friction path, the `spacing_factor` of zones without `pairs`, `spacing` and `points`, and
`samples`.

| `setting` | `size` | `tolerance` of the path | `spacing_factor` | `samples` |
|---|---|---|---|---|
{rows}

`python -m verification run trade` measures their accuracy and cost; `python -m verification scene SCENE --to 2%`
chooses among them for your scene.
"""
DEVIATIONS = """Keys of every kind; a kind may state its own default or unit:

"""
TYPE_NAMES: dict[Any, str] = {float: "number", int: "whole number", str: "text", bool: "true or false"}


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
        f'| `"{name}"` | `"{setting["size"]}"` | {setting["tolerance"]:g} | {setting["spacing_factor"]:g} | '
        f"{setting['samples']} |"
        for name, setting in SETTINGS.items()
    )
    places = _keys([(name, field) for name, field in OnPart.model_fields.items() if name != "name"])
    top = "## Top level\n\n" + _keys(plain)
    return "\n".join([OPENING.format(places=places), top, SETTING.format(rows=rows), *tables]).rstrip() + "\n"


def _table(title: str, kinds: list[type[BaseModel]]) -> str:
    sections, below = [f"## `{title}`\n"], []
    if issubclass(kinds[0], DeviationKeys):
        sections.append(DEVIATIONS + _keys(DeviationKeys.model_fields.items()))
    for kind in kinds:
        sections += [_prose(kind) + "\n", _keys(_own_fields(kind), _place(kind))]
        below += [
            _table(f"[[{title.strip('[]')}.{name}]]", _tables(field))
            for name, field in kind.model_fields.items()
            if _tables(field)
        ]
    return "\n".join([*sections, *below])


def _own_fields(kind: type[BaseModel]) -> list[tuple[str, FieldInfo]]:
    """Keys of a table that neither a table of their own nor a common section of the page describes."""
    common: set[str] = set()
    if issubclass(kind, OnSheet | OtherPoint):
        common |= OnPart.model_fields.keys() - {"name"}
    if issubclass(kind, DeviationKeys):
        common |= {"kind", *(name for name, field in DeviationKeys.model_fields.items() if _same(kind, name, field))}
    return [(name, field) for name, field in kind.model_fields.items() if name not in common and not _tables(field)]


def _same(kind: type[BaseModel], name: str, field: FieldInfo) -> bool:
    return kind.model_fields[name].description == field.description


def _place(kind: type[BaseModel]) -> str:
    """The row for the place of an item on a part."""
    if not issubclass(kind, OnSheet | OtherPoint):
        return ""
    keys = [f"`{name}`" for name in OnPart.model_fields if name != "name" and name in kind.model_fields]
    return f"| {' or '.join(keys)} |  |  | see Places |"


def _tables(field: FieldInfo) -> list[type[BaseModel]]:
    """The schemas of a key that is a list of tables; empty for other keys."""
    inner = get_args(field.annotation) if get_origin(field.annotation) is list else ()
    return [kind for kind in inner if isinstance(kind, type) and issubclass(kind, BaseModel)]


def _prose(kind: type[BaseModel]) -> str:
    lines = [line.strip() for line in (kind.__doc__ or "").strip().splitlines()]
    return "\n".join(lines).replace("``", "`")


def _keys(fields: Iterable[tuple[str, FieldInfo]], *more: str) -> str:
    """A table of keys, with further rows after the first."""
    rows = [
        f"| `{name}` | {_type_name(field.annotation, field.metadata)} | {_default(field)} | {field.description} |"
        for name, field in fields
    ]
    rows[1:1] = [row for row in more if row]
    return "\n".join(["| key | value | default | meaning |", "|---|---|---|---|", *rows, ""])


def _default(field: FieldInfo) -> str:
    if field.is_required() or field.default is None or field.default == "":
        return "required" if field.is_required() else ""
    return f"`{json.dumps(field.default)}`"


def _type_name(annotation: Any, bounds: Iterable[Any] = ()) -> str:
    """The values that a key takes, in words."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if annotation == Vector:
        return "[x, y, z]"
    if origin is Annotated:
        return _type_name(inner[0], inner[1:])
    if origin is Literal:
        return ", ".join(f"`{json.dumps(word)}`" for word in inner)
    if origin in (Union, types.UnionType):
        return " or ".join(_type_name(item, bounds) for item in inner if item is not type(None))
    if origin is dict:
        return f"table of {_type_name(inner[1])}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"table {{ {', '.join(annotation.model_fields)} }}"
    if origin is list:
        return f"list of {_type_name(inner[0])}"
    if origin is tuple:
        return f"[{', '.join(_type_name(item) for item in inner)}]"
    name = TYPE_NAMES.get(annotation, getattr(annotation, "__name__", str(annotation)))
    limits = [limit for bound in bounds for limit in _limits(bound)] if annotation in (float, int) else []
    return ", ".join([f"{name} {limits[0]}", *limits[1:]]) if limits else name


def _limits(bound: Any) -> list[str]:
    """Bounds of a number, from one constraint of pydantic or from a group of them."""
    signs = (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤"))
    several = getattr(bound, "metadata", None)
    if several is not None:
        return [limit for item in several for limit in _limits(item)]
    given = [(sign, getattr(bound, name, None)) for name, sign in signs]
    return [f"{sign} {value:g}".replace("-", "−") for sign, value in given if value is not None]


def _classes(annotation) -> list[type]:
    """The classes in an annotation."""
    inner = [found for argument in get_args(annotation) for found in _classes(argument)]
    return inner or ([annotation] if isinstance(annotation, type) else [])


if __name__ == "__main__":
    print(reference(), end="")
