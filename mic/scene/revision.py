"""Change keys in the text of a scene file, and preserve all other text and comments."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from itertools import takewhile
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
    statements = list(_statements(lines))
    headers = [i for i, statement in enumerate(statements) if statement[2] == f"[[{table}]]"]
    if index >= len(headers):
        raise SceneError(f"{table}[{index}]: it has no [[{table}]] of its number in the scene file; change it by hand")
    head, *rest = statements[headers[index] :]
    own = [head, *takewhile(lambda statement: statement[2] is None, rest)]
    present = [key for _, _, _, key in own]
    behind = own[-1][1]
    lines[behind:behind] = [
        _line(key, value) for key, value in keys.items() if key not in present and value is not None
    ]
    for first, end, _, key in reversed(own):
        if key in keys:
            lines[first:end] = [] if keys[key] is None else [_line(key, keys[key])]
    return "\n".join(lines) + "\n"


def _line(key: str, value: Any) -> str:
    """The statement of a key, with lists of lists on several lines."""
    if isinstance(value, list) and value and isinstance(value[0], list):
        return f"{key} = [\n" + "".join(f"    {json.dumps(row)},\n" for row in value) + "]"
    return f"{key} = {json.dumps(value)}"


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
