"""A scene file with some of its keys changed: all else stays as it was written, comments too."""

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
        Of the item in it.
    keys : mapping of str to object
        Numbers, texts, or lists of them; None takes a key out.

    Raises
    ------
    SceneError
        Where the item does not stand in a ``[[table]]`` of its own.
    """
    lines = text.splitlines()
    own = -1
    last = None  # line behind the item's last statement
    taken: set[int] = set()
    written: dict[int, str] = {}
    left = dict(keys)
    inside = False
    for first, end, header, key in _statements(lines):
        if header is not None:
            own += header == f"[[{table}]]"
            inside = header == f"[[{table}]]" and own == index
            last = end if inside else last
        elif inside:
            last = end
            if key in keys:
                taken |= set(range(first, end))
                value = left.pop(key)
                if value is not None:
                    written[first] = f"{key} = {_told(value)}"
    if last is None:
        raise SceneError(f"{table}[{index}]: stands in no [[{table}]] of its own in the file; change it there by hand")
    more = [f"{key} = {_told(value)}" for key, value in left.items() if value is not None]
    found = []
    for i, line in enumerate(lines):
        if i == last:
            found += more
        if i in written:
            found.append(written[i])
        elif i not in taken:
            found.append(line)
    found += more if last >= len(lines) else []
    return "\n".join(found) + "\n"


def _statements(lines: list[str]) -> Iterator[tuple[int, int, str | None, str]]:
    """First line and the line behind of each statement, its header without blanks or None, and its key."""
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
        while not _whole("\n".join(lines[i:end])) and end < len(lines):
            end += 1
        yield i, end, None, line.partition("=")[0].strip().strip("\"'")
        i = end


def _whole(text: str) -> bool:
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False
    return True


def _told(value: Any) -> str:
    """A value as TOML has it; lists of lists a line each."""
    if isinstance(value, list) and value and isinstance(value[0], list):
        return "[\n" + "".join(f"    {json.dumps(one)},\n" for one in value) + "]"
    return json.dumps(value)
