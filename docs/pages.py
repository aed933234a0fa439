"""The pages of the documentation that the code writes: API, scene keys, results, verification.

Nothing here is a list kept by hand: a module, key, table or study that is added has its page with the next build.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import types
import typing
from enum import Enum
from importlib.util import find_spec
from pathlib import Path

import pydantic
from pydantic_core import PydanticUndefined

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "mic": "production: what a Monte Carlo needs",
    "fem_reference": "the truth: shells, influence coefficients, full frictional contact",
    "verification": "the judge",
}


def write(folder: Path) -> None:
    """Write all generated pages; a page that has not changed keeps its time, one that nobody writes any more goes."""
    pages = {**api(), **scene(), **results(), **verification()}
    for path in folder.glob("**/*.md"):
        if "gallery" not in path.parts and path.relative_to(folder).as_posix() not in pages:
            path.unlink()
    for name, text in pages.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def public(package: str) -> list[str]:
    """Modules of a package that name what is public, packages first."""
    root = importlib.import_module(package)
    names = [package] + [item.name for item in pkgutil.walk_packages(root.__path__, package + ".")]
    return [name for name in names if not name.endswith("__main__") and getattr(_module(name), "__all__", None)]


def api() -> dict[str, str]:
    """One page per module with a public name."""
    pages, lines = {}, ["# API", "", "Every public name, module by module. mm, N, MPa.", ""]
    for package, job in PACKAGES.items():
        if package == "fem_reference" and find_spec("dolfinx") is None:
            continue  # its modules cannot be imported, nor described, without the finite elements
        lines += [f"## `{package}`: {job}", "", "```{toctree}", ":maxdepth: 1", ""]
        for name in public(package):
            lines.append(f"api/{name}")
            pages[f"api/{name}.md"] = _module_page(name)
        lines += ["```", ""]
    return pages | {"api.md": "\n".join(lines)}


def scene() -> dict[str, str]:
    """Every key of a scene file, from the schema that validates it."""
    schema = importlib.import_module("mic.scene.schema")
    tables = _tables(schema.Scene)
    lines = [
        "# Keys of a scene",
        "",
        "As the schema has them. Unknown keys are errors. [The scene reference](../scene.md) explains each.",
        "",
    ]
    for title, model in tables.items():
        lines += [f"## {title}", "", inspect.cleandoc(model.__doc__ or ""), "", "| key | value | default | meaning |"]
        lines += ["| --- | --- | --- | --- |"]
        for name, field in model.model_fields.items():
            if field.exclude or _models(field.annotation):
                continue
            default = "" if field.default is PydanticUndefined else _value(field.default)
            required = "required" if field.is_required() else default
            lines.append(f"| `{name}` | {_type(field)} | {required} | {field.description or ''} |")
        lines.append("")
    return {"scene_keys.md": "\n".join(lines)}


def results() -> dict[str, str]:
    """Every table and column of a results folder, from the declaration that writes and checks them."""
    if find_spec("mic.results.schema") is None:
        return {"../results.md": "# Results\n\nREADME.md tells what a results folder holds.\n"}
    text = importlib.import_module("mic.results.schema").reference()
    return {"../results.md": text if text.startswith("# ") else f"# Results\n\n{text}\n"}  # one title, whoever gives it


def verification() -> dict[str, str]:
    """The page of each verification study."""
    pages = {}
    for path in sorted((ROOT / "verification").glob("*/README.md")):
        pages[f"verification/{path.parent.name}.md"] = path.read_text(encoding="utf-8")
    lines = ["# Verification", "", "Each study states a claim, a reference and the numbers that it must keep.", ""]
    lines += ["```{toctree}", ":maxdepth: 1", "", *sorted(name.removesuffix(".md") for name in pages), "```", ""]
    return pages | {"verification.md": "\n".join(lines)}


def _module(name):
    return importlib.import_module(name)


def _module_page(name) -> str:
    """What a module defines, in full; what it hands on from another module, as a link there."""
    module = _module(name)
    own, elsewhere, aliases = [], [], []
    for item in module.__all__:
        thing = getattr(module, item)
        home = getattr(thing, "__module__", name)
        if (
            isinstance(thing, (types.GenericAlias, types.UnionType)) or type(thing).__module__ == "typing"
        ):  # autodoc takes them for classes
            aliases.append(f"- `{item}` = `{thing}`")
        elif isinstance(thing, types.ModuleType):
            elsewhere.append(f"- {{py:mod}}`{thing.__name__}`")
        elif home == name or not (inspect.isclass(thing) or inspect.isroutine(thing)):
            own.append(item)
        else:
            elsewhere.append(f"- {{py:obj}}`{item} <{home}.{thing.__qualname__}>`")
    members = f"   :members: {', '.join(own)}" if own else "   :no-members:"
    lines = [f"# `{name}`", "", "```{eval-rst}", f".. automodule:: {name}", members, "```", ""]
    for title, items in (("Names for types", aliases), ("Also to be had here", elsewhere)):
        if items:
            lines += [f"## {title}", "", *items, ""]
    return "\n".join(lines)


def _models(annotation) -> list[type[pydantic.BaseModel]]:
    """The tables that a field's type holds."""
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return [annotation]
    return [model for part in typing.get_args(annotation) for model in _models(part)]


def _tables(top) -> dict[str, type[pydantic.BaseModel]]:
    """The scene and its tables, under the headings that a scene file gives them."""
    tables = {"Top level": top}
    for name, field in top.model_fields.items():
        several = typing.get_origin(field.annotation) is list
        for model in _models(field.annotation):
            tables[f"`[[{name}]]`" if several else f"`[{name}]`"] = model
    return tables


def _type(field) -> str:
    """A field's type and bounds in words."""
    words = _words(field.annotation)
    for bound in field.metadata:
        for sign, attribute in ((">", "gt"), ("≥", "ge"), ("<", "lt"), ("≤", "le")):
            if getattr(bound, attribute, None) is not None:
                words += f", {sign} {getattr(bound, attribute)}"
    return words


def _words(annotation) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _words(arguments[0])
    if origin is typing.Literal:
        return " or ".join(_value(value) for value in arguments)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_words(item) for item in arguments if item is not type(None))
    if origin is list:
        return f"list of {_words(arguments[0])}"
    if origin is tuple:
        return f"[{', '.join(_words(item) for item in arguments)}]"
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return " or ".join(_value(item) for item in annotation)
    return {float: "number", int: "whole number", str: "text", bool: "true or false", Path: "file"}.get(
        annotation, getattr(annotation, "__name__", str(annotation))
    )


def _value(value) -> str:
    if value is None or value == []:
        return ""
    value = value.value if isinstance(value, Enum) else value
    if isinstance(value, bool):
        return "`true`" if value else "`false`"
    if isinstance(value, list):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value}`"
