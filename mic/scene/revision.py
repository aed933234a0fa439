"""Change keys in the text of a scene file, and preserve all other text and comments."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

from mic.errors import SceneError

__all__ = ["revised"]


def revised(text: str, table: str, index: int, keys: Mapping[str, Any]) -> str:
    """The text of a scene file with keys of one item changed.

    Parameters
    ----------
    text : str
        TOML.
    table : str
        As in ``[[table]]``.
    index : int
        Index of the item in it.
    keys : mapping of str to object
        Numbers, texts, or lists of them; None removes a key.

    Raises
    ------
    SceneError
        If the item has no ``[[table]]`` of its number, such as a row of a CSV file.
    """
    lines = text.splitlines()
    number = -1
    last = None  # line behind the item's last statement
    removed: set[int] = set()
    replaced: dict[int, str] = {}
    remaining = dict(keys)
    inside = False
    for first, end, header, key in _statements(lines):
        if header is not None:
            number += header == f"[[{table}]]"
            inside = header == f"[[{table}]]" and number == index
            last = end if inside else last
        elif inside:
            last = end
            if key in keys:
                removed |= set(range(first, end))
                value = remaining.pop(key)
                if value is not None:
                    replaced[first] = f"{key} = {_toml(value)}"
    if last is None:
        raise SceneError(f"{table}[{index}]: it has no [[{table}]] of its number in the scene file; change it by hand")
    added = [f"{key} = {_toml(value)}" for key, value in remaining.items() if value is not None]
    result = []
    for i, line in enumerate(lines):
        if i == last:
            result += added
        if i in replaced:
            result.append(replaced[i])
        elif i not in removed:
            result.append(line)
    result += added if last >= len(lines) else []
    return "\n".join(result) + "\n"


def _statements(lines: list[str]) -> Iterator[tuple[int, int, str | None, str]]:
    """First line and end line (exclusive) of each statement, its header without spaces or None, and its key."""
    i = 0
    while i < len(lines):
        line = lines[i].strip()
        if not line or line.startswith("#"):
            i += 1
            continue
        if line.startswith("["):
            yield i, i + 1, re.sub(r"\s", "", line.partition("#")[0]), ""
            i += 1
            continue
        end = i + 1
        while not _is_complete("\n".join(lines[i:end])) and end < len(lines):
            end += 1
        yield i, end, None, line.partition("=")[0].strip().strip("\"'")
        i = end


def _is_complete(text: str) -> bool:
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False
    return True


def _toml(value: Any) -> str:
    """A value in TOML, with lists of lists on several lines."""
    if isinstance(value, list) and value and isinstance(value[0], list):
        return "[\n" + "".join(f"    {json.dumps(row)},\n" for row in value) + "]"
    return json.dumps(value)
