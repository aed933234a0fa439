"""The scene reference, generated from the schema: ``python -m mic.scene.reference`` prints the page docs/scene.md."""

from __future__ import annotations

import json
from typing import get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mic.scene.schema import Scene
from mic.scene.settings import SETTINGS

__all__ = ["reference"]

OPENING = """# Scene reference

A scene is one TOML file, or a folder that holds `scene.toml`. mm, N, MPa. Unknown keys are errors. File names are
relative to the scene. `mic check SCENE` validates it and shows what will be modelled. Directions may have any length
but zero.
"""
SETTING = """`setting` fills in what the scene leaves open, and only that: the element size of parts with a `geometry`
(its named size), `pairs` of zones that give neither `pairs`, `spacing` nor `points`, `increments` of the stages,
`samples`.

| `setting` | `size` | `pairs` per zone | `increments` | `samples` |
| --- | --- | --- | --- | --- |
{rows}

What each is worth in accuracy, and what it costs, is measured by `python -m verification run trade`.
"""


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
        f'| `"{name}"` | `"{gives["size"]}"` | {gives["pairs"]} | {gives["increments"]} | {gives["samples"]} |'
        for name, gives in SETTINGS.items()
    )
    top = "## Top level\n\n" + _keys(plain)
    return "\n".join([OPENING, top, SETTING.format(rows=rows), *tables]).rstrip() + "\n"


def _table(title: str, kinds: list[type[BaseModel]]) -> str:
    sections = [f"## `{title}`\n"]
    for kind in kinds:
        own = list(kind.model_fields.items())
        sections += [_prose(kind) + "\n", _keys(own)]
    return "\n".join(sections)


def _prose(kind: type[BaseModel]) -> str:
    lines = [line.strip() for line in (kind.__doc__ or "").strip().splitlines()]
    return "\n".join(lines).replace("``", "`")


def _keys(fields: list[tuple[str, FieldInfo]]) -> str:
    rows = [f"| `{name}` | {_default(field)} | {field.description} |" for name, field in fields]
    return "\n".join(["| key | default | meaning |", "| --- | --- | --- |", *rows, ""])


def _default(field: FieldInfo) -> str:
    if field.is_required() or field.default is None or field.default == "":
        return "required" if field.is_required() else ""
    return f"`{json.dumps(field.default)}`"


def _classes(annotation) -> list[type]:
    """The classes that an annotation is made of."""
    inner = [found for argument in get_args(annotation) for found in _classes(argument)]
    return inner or ([annotation] if isinstance(annotation, type) else [])


if __name__ == "__main__":
    print(reference(), end="")
