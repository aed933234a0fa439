"""The scene reference, generated from the schema: ``python -m mic.scene.reference`` prints the page docs/scene.md.

Its text is in ``reference.md``; the meaning of each key is the docstring below it in the schema.
"""

from __future__ import annotations

import ast
import inspect
import json
import types
from collections.abc import Iterable
from functools import cache
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mic.scene.deviation import DeviationKeys
from mic.scene.keys import OnPart, OnSheet, Table, Vector
from mic.scene.measurement import OtherPoint
from mic.scene.schema import Scene
from mic.scene.settings import SETTINGS
from mic.scene.table_file import TableSettings

__all__ = ["reference"]

PLACES = [name for name in OnPart.model_fields if name != "name"]  # keys that give the place of an item
TYPE_NAMES: dict[Any, str] = {float: "number", int: "whole number", str: "text", bool: "true or false"}


def reference() -> str:
    """Every table and key with its default and its meaning, in Markdown."""
    plain, tables = [], []
    for key, field in Scene.model_fields.items():
        kinds = [kind for kind in _classes(field.annotation) if issubclass(kind, BaseModel)]
        if kinds:
            tables.append(_table(f"[[{key}]]" if "list" in str(field.annotation) else f"[{key}]", kinds))
        elif not field.exclude:
            plain.append(key)
    settings = "\n".join(
        f'| `"{name}"` | `"{setting["size"]}"` | {setting["tolerance"]:g} | {setting["spacing_factor"]:g} | '
        f"{setting['samples']} |"
        for name, setting in SETTINGS.items()
    )
    page = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    places, top = _keys(OnPart, PLACES), _keys(Scene, plain)
    read = _keys(TableSettings, TableSettings.model_fields)
    return page.format(places=places, settings=read, top=top, rows=settings, tables="\n".join(tables)).rstrip() + "\n"


def _table(title: str, kinds: list[type[BaseModel]]) -> str:
    sections, below = [f"## `{title}`\n"], []
    if issubclass(kinds[0], DeviationKeys):
        keys = _keys(DeviationKeys, DeviationKeys.model_fields)
        sections.append("Keys of every kind; a kind may state its own default or unit:\n\n" + keys)
    for kind in kinds:
        sections += [inspect.cleandoc(kind.__doc__ or "").replace("``", "`") + "\n", _own_keys(kind)]
        for name, field in kind.model_fields.items():
            if inner := _tables(field):
                below.append(_table(f"[[{title.strip('[]')}.{name}]]", inner))
    return "\n".join([*sections, *below])


def _own_keys(kind: type[BaseModel]) -> str:
    """Keys of a table that neither a table of their own nor a common section of the page describes."""
    placed = issubclass(kind, OnSheet | OtherPoint)
    common = {name for name, field in kind.model_fields.items() if _tables(field)} | {*(PLACES if placed else ())}
    if issubclass(kind, DeviationKeys):
        own, meaning = meanings(kind), meanings(DeviationKeys)
        common |= {"kind", *(name for name in meaning if own[name] == meaning[name])}
    text = _keys(kind, [name for name in kind.model_fields if name not in common])
    if not placed:
        return text
    place = " or ".join(f"`{name}`" for name in PLACES if name in kind.model_fields)
    lines = text.split("\n")
    return "\n".join([*lines[:3], f"| {place} |  |  | see Places |", *lines[3:]])


@cache
def meanings(kind: type[BaseModel]) -> dict[str, str]:
    """The meaning of the keys of a table: the docstrings below them, or descriptions that the program composes."""
    found = {}
    for base in reversed([base for base in kind.__mro__ if issubclass(base, Table) and base is not Table]):
        (definition,) = ast.parse(dedent(inspect.getsource(base))).body
        for key, text in pairwise(ast.iter_child_nodes(definition)):
            match key, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                    found[name] = " ".join(words.split())
    composed = {name: field.description for name, field in kind.model_fields.items() if field.description}
    return found | composed


def _tables(field: FieldInfo) -> list[type[BaseModel]]:
    """The schemas of a key that is a list of tables; empty for other keys."""
    inner = get_args(field.annotation) if get_origin(field.annotation) is list else ()
    return [kind for kind in inner if isinstance(kind, type) and issubclass(kind, BaseModel)]


def _keys(kind: type[BaseModel], names: Iterable[str]) -> str:
    """A table of keys."""
    rows = ["| key | value | default | meaning |", "|---|---|---|---|"]
    for name in names:
        field = kind.model_fields[name]
        value = _type_name(field.annotation, field.metadata)
        rows.append(f"| `{name}` | {value} | {_default(field)} | {meanings(kind)[name]} |")
    return "\n".join([*rows, ""])


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
