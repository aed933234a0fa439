"""Read a scene file, with one line per error: file, key, what is wrong, remedy."""

from __future__ import annotations

import difflib
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

from pydantic import TypeAdapter, ValidationError

from mic.errors import SceneError
from mic.scene.checks import find_errors
from mic.scene.keys import Table
from mic.scene.schema import TABLES, Scene
from mic.scene.tables import expand_tables
from mic.system.arguments import checked
from mic.system.foreign_files import reading

__all__ = ["load_scene", "read_table", "read_toml"]


DEPTH = 20  # levels of tables and lists in a TOML file
TOO_DEEP = "tables or lists are nested too deeply; a scene needs no more than a few levels"
INTERNAL = {name for name, field in Scene.model_fields.items() if field.exclude}  # keys that are no keys of a file
LISTED = 100  # errors of a scene that are listed


@checked
def load_scene(path) -> Scene:
    """Read and validate a scene file.

    Parameters
    ----------
    path : path-like
        A TOML file, or a folder that holds ``scene.toml``.

    Raises
    ------
    SceneError
        With one line per problem: file, key, what is wrong, what to do.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "scene.toml"
    return read_table(read_toml(path, "scene"), path)


def read_toml(path: Path, kind: str) -> dict[str, Any]:
    """Content of a TOML file of a kind.

    Raises
    ------
    SceneError
        If it cannot be read.
    """
    with reading(path, kind, error=SceneError):
        text = b""
        try:
            text = path.read_bytes()
            table = tomllib.loads(text.decode())
        except ValueError as error:  # of TOML, of UTF-8, or of a number with thousands of digits
            raise SceneError(f"not valid TOML: {error}; {_expected(str(error), text)}") from None
        except RecursionError:
            raise SceneError(TOO_DEEP) from None
        level: list[Any] = [table]
        for _ in range(DEPTH):
            inner = [one for one in level if isinstance(one, (dict, list))]
            level = [one for outer in inner for one in (outer.values() if isinstance(outer, dict) else outer)]
        if level:
            raise SceneError(TOO_DEEP)
        return table


#: What TOML expects where it reports one of these.
EXPECTED = {
    "Invalid value": 'expected a number (1.5), "text" in quotes, true, false, or a list [1, 2]',
    "Expected '=' after a key": "expected key = value; a heading is [table] or [[table]]",
    "Expected newline or end": 'expected one key = value per line; decimals have a point, texts "quotes"',
    "Unclosed array": "expected a closing ] and commas between the values of the list",
    "Unclosed inline table": "expected key = value pairs with commas between them, and a closing }",
    "Expected ']": "expected a closing ] after the name of the table, ]] after [[",
    "Illegal character '": "expected a closing quote on the same line",
    "Unterminated string": "expected a closing quote on the same line",
    "Unescaped '": "expected \\\\ for each backslash in a text, or the text in single quotes",
    "Invalid hex value": "expected \\\\ for each backslash in a text, or the text in single quotes",
    "Cannot overwrite": "expected each key once in a table; a further item starts with its own [[table]]",
    "Cannot declare": "expected each [table] once; several items have [[table]]",
    "Cannot mutate": "expected either {…} or [table] for it, not both",
    "Invalid statement": "expected key = value, [table], [[table]] or # comment",
    "'utf-8' codec": "save the file as UTF-8",
}


def _expected(error: str, text: bytes) -> str:
    """The line of a TOML file to which `error` refers, and the syntax expected there."""
    remedy = next((words for start, words in EXPECTED.items() if error.startswith(start)), "correct the syntax there")
    line = re.search(r"at line (\d+)", error)
    written = text.decode(errors="replace").splitlines()[int(line[1]) - 1].strip()[:80] if line else ""
    return f"{remedy}, found: {written}" if written else remedy


def read_table(table: dict[str, Any], path: Path) -> Scene:
    """The scene of a table, as if read from the file `path`.

    Raises
    ------
    SceneError
        As :func:`load_scene`.
    """
    for key in INTERNAL & table.keys():
        raise SceneError(f"{path}: {key}: unknown key; remove it")
    try:
        return Scene(**table, folder=path.parent.resolve())
    except ValidationError as error:
        found = _merge_alternatives(error.errors())
    try:
        table = expand_tables(table | {"folder": path.parent.resolve()}, TABLES)
        between = _between_tables(table)
    except SceneError:  # it is among the errors already
        table, between = {}, []
    lines = [line for item in found[:LISTED] for line in _explain(table, item)]
    lines = _folded([*lines, *(line for line in between if line not in lines)])
    if len(found) + len(between) > LISTED:
        lines[LISTED:] = [f"{len(found) + len(between) - LISTED} more errors; correct these first"]
    raise SceneError("\n".join(f"{path}: {line}" for line in lines))


#: An error of an item of a table: the table, the key, the name of the item, what is wrong.
OF_ITEM = re.compile(r"(\w+)\[\d+\]([\w.]*)(?: \([^()]*\))?(: .*)")


def _folded(lines: list[str]) -> list[str]:
    """Lines of errors, with equal ones of the items of a table as one, and their count."""
    counts: dict[tuple[str, ...], list[str]] = {}
    for line in lines:
        item = OF_ITEM.fullmatch(line)
        counts.setdefault(item.groups() if item else (line,), []).append(line)
    return [first + f" (and in {len(more)} more)" * bool(more) for first, *more in counts.values()]


def _between_tables(table: dict[str, Any]) -> list[str]:
    """Errors between the tables of a scene that has errors within tables, too, as far as they can be checked."""
    items: dict[str, Any] = {"folder": table.get("folder", Path("."))}
    for key, field in Scene.model_fields.items():
        kinds, given = get_args(field.annotation), table.get(key)
        if isinstance(given, list) and kinds and "mic.scene." in str(kinds[0]):
            items[key] = [_unchecked_item(kinds[0], item) for item in given if isinstance(item, dict)]
    if not items.keys() >= {"parts", "stages"}:
        return []
    return find_errors(Scene.model_construct(**items), complete=False)


def _unchecked_item(kind: Any, item: dict[str, Any]) -> Any:
    """An item; an invalid one with its keys as given, and defaults for the others."""
    try:
        return TypeAdapter(kind).validate_python(item)
    except ValidationError:
        fields = getattr(kind, "model_fields", {}).items()
        defaults = {name: field.default for name, field in fields if not field.is_required()}
        return SimpleNamespace(**{**defaults, "name": item.get("kind"), **item})


def _merge_alternatives(items) -> list[dict[str, Any]]:
    """The errors of a validation, with those of the alternatives of one key merged."""
    prefix = "Input should be "
    found: dict[tuple, dict[str, Any]] = {}
    for item in items:
        key = (*_keys(item["loc"]), None if item["msg"].startswith(prefix) else item["msg"])
        if key in found:
            item = found[key] | {"msg": f"{found[key]['msg']}, or {item['msg'].removeprefix(prefix)}", "type": "one of"}
        found[key] = item
    return list(found.values())


def _explain(table: dict[str, Any], item) -> list[str]:
    """The lines for one error of the validation."""
    keys = _keys(item["loc"])
    key = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in keys).lstrip(".")
    key += _name(table, keys)
    message = item["msg"].removeprefix("Value error, ")
    given = item.get("input")
    remedy = {
        "extra_forbidden": f"unknown key; {_spelling_hint(item['loc'])}",
        "missing": "required key is missing; add it",
        "greater_than": f"{message}; got {given!r}, correct the value",
        "greater_than_equal": f"{message}; got {given!r}, correct the value",
        "tuple_type": f"give a list in brackets, such as [1, 2, 3]; got {given!r}",
        "list_type": f"give a list in brackets; got {given!r}",
        "finite_number": f"{message}; got {given!r}, give a finite number",
        "union_tag_not_found": "required key kind is missing; add it",
        "union_tag_invalid": f"kind must be one of {item.get('ctx', {}).get('expected_tags')}; correct it",
        "value_error": message,
    }
    text = remedy.get(item["type"], f"{message}; got {given!r}, correct it")
    return [f"{key}: {line}" if key else line for line in text.splitlines()]


def _spelling_hint(location) -> str:
    """The remedy for an unknown key: the most similar key of the table that it is in."""
    *steps, key = location or [""]
    tables: set[type[Table]] = {Scene}
    for step in steps:
        inner = [_table_types(kind.model_fields[step].annotation) for kind in tables if step in kind.model_fields]
        tagged = {kind for kind in tables if "kind" in kind.model_fields and step in _kinds(kind)}
        tables = set().union(*inner) or tagged or tables
    keys = sorted({name for kind in tables for name in kind.model_fields} - INTERNAL)
    near = difflib.get_close_matches(str(key), keys, 1)
    return f"did you mean {near[0]!r}?" if near else "remove it or correct its spelling"


def _table_types(annotation: Any) -> set[type[Table]]:
    """The tables of the scene among the alternatives and members of a type."""
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return {annotation}
    return set().union(*map(_table_types, get_args(annotation)))


def _kinds(kind: type[Table]) -> tuple[str, ...]:
    return get_args(kind.model_fields["kind"].annotation)


def _name(table: dict[str, Any], keys: list[str | int]) -> str:
    """The name of the item with an error, in brackets; empty if it has none."""
    if len(keys) < 2 or not isinstance(keys[1], int) or keys[2:] == ["name"]:
        return ""
    try:
        item = table[str(keys[0])][keys[1]]
        name = item.get("name", item.get("kind") if keys[0] == "stages" else None)
    except (AttributeError, KeyError, IndexError, TypeError):
        return ""
    return f" ({name})" if isinstance(name, str) else ""


#: Prefixes of the tags by which pydantic, and this schema, distinguish the alternatives of one key.
ALTERNATIVES = ("literal[", "constrained", "float", "str", "function", "friction-", "point-")


def _keys(location) -> list[str | int]:
    """The keys of a validation error's location, without the tags of alternatives."""
    keys = [step for step in location if not (isinstance(step, str) and step.startswith(ALTERNATIVES))]
    if keys[:1] == ["deviations"] and len(keys) > 2:
        del keys[2]  # the kind, by which the table is chosen
    return keys
