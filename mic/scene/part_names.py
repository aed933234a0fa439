"""Names of parts as tables give them: by name, mesh file, element set or property number, in any case."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

__all__ = ["PartNames", "other_names"]

PROPERTY = re.compile(r"(?:PID|PSHELL|PART|P)?[\s_-]*0*(\d+)(?:\.0)?", re.IGNORECASE)


class PartNames:
    """The parts of a scene, found by any of their names.

    Parameters
    ----------
    others : mapping of str to iterable of str
        Further names of each part: those of its mesh file and element sets.
    """

    def __init__(self, others: Mapping[str, Iterable[str]]):
        self.names = list(others)
        self._others = {name: list(dict.fromkeys(further)) for name, further in others.items()}
        self._owners: dict[str, set[str]] = {}
        for name, further in self._others.items():
            for other in further:
                for spelling in _spellings(other):
                    self._owners.setdefault(spelling, set()).add(name)
        self._own: dict[str, set[str]] = {}
        for name in self.names:
            self._own.setdefault(_plain(name), set()).add(name)

    def find(self, text: str) -> str | None:
        """The part of a name, None if there is none or if several may be meant; names precede files and sets."""
        if text in self._others:
            return text
        for owners, spellings in ((self._own, [_plain(text)]), (self._owners, _spellings(text))):
            found = set().union(*(owners.get(spelling, set()) for spelling in spellings))
            if found:
                return found.pop() if len(found) == 1 else None
        return None

    def split(self, text: str) -> list[str]:
        """The names in a cell that lists several, each as the part that it means, or as given."""
        for separator in (r"[,;/|&]", r"\s+", r"\+|\s-\s"):
            words = [word.strip() for word in re.split(separator, text) if word.strip()]
            if len(words) > 1 and all(map(self.find, words)):
                break
        else:
            words = re.split(r"\s*[,;/|&]\s*|\s+", text.strip()) if self.find(text) is None else [text]
        return [self.find(word) or word for word in words]

    def unknown(self, text: str) -> str:
        """The error of a name that is none, with the nearest one."""
        owners = set().union(*(self._owners.get(spelling, set()) for spelling in _spellings(text)))
        if len(owners) > 1:
            return f"{text!r} may be {' or '.join(map(repr, sorted(owners)))}; name one of them"
        known = {spelling: name for spelling, own in (self._owners | self._own).items() for name in own}
        near = difflib.get_close_matches(_plain(text), known, 1)
        if not near:
            return f"there is no part called {text!r}; known: {', '.join(sorted(self.names)) or 'none'}"
        name = known[near[0]]
        files = [other for other in self._others[name] if Path(other).suffix]
        return f"there is no part called {text!r}; did you mean {name!r}{f' (from {files[0]})' if files else ''}?"


def other_names(part: Mapping[str, Any]) -> list[str]:
    """Names of a part of a scene file besides its own: its mesh file and sets."""
    mesh, sets = part.get("mesh"), part.get("set")
    names = [Path(mesh).name, Path(mesh).stem] if isinstance(mesh, str) else []
    return names + ([sets] if isinstance(sets, str) else [one for one in sets or () if isinstance(one, str)])


def _plain(text: str) -> str:
    """A name without case, blanks and the marks that stand for them."""
    return re.sub(r"[\s_-]+", "", text).casefold()


def _spellings(text: str) -> list[str]:
    """A name, and the number of a property: ``PID 7``, ``pid_7`` and ``7`` are one."""
    number = PROPERTY.fullmatch(text.strip())
    return [_plain(text), *([f"pid{number[1]}"] if number else [])]
