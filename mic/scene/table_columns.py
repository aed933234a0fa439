"""Headers of tables: which column holds which key, and in which unit; ``columns.toml`` lists how people name them."""

from __future__ import annotations

import difflib
import re
import tomllib
import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from mic.errors import SceneError

__all__ = ["Columns", "Header", "data", "squash", "unit_of"]

BRACKETED = re.compile(r"[\[({<]\s*([^\[\](){}<>]+?)\s*[\])}>]")
ENDING = re.compile(r"^(.*[^\s_,/.])(?:[\s_,/.]+(?:in[\s_]+)?)([^\s_,.]+)$")
ALIKE = 0.8  # similarity from which a header is taken for a misspelt one
SHORTEST = 5  # letters of a header that may be misspelt


@cache
def data() -> dict[str, Any]:
    """The content of ``columns.toml``, with the headers of names composed."""
    content = tomllib.loads(Path(__file__).with_name("columns.toml").read_text(encoding="utf-8"))
    named = content["named"]
    content["columns"]["name"] += [
        f"{thing} {label}".strip() for label in (*named["labels"], "") for thing in named["things"]
    ]
    return content


def squash(text: str) -> str:
    """A header without case, blanks and punctuation; a sign of a tolerance stands at the end: ``tol-``."""
    text = unicodedata.normalize("NFKC", text).casefold().replace("−", "-")
    text = re.sub(r"[(\[]\s*([+-])\s*[)\]]", r"\1", re.sub(r"\+\s*/?\s*-", "±", text)).strip()
    sign = re.search(r"^\s*([+±-])|([+±-])\s*$", text)
    letters = "".join(letter for letter in text if letter.isalnum() or letter == "#")
    return letters + (sign[1] or sign[2] if sign and (letters or sign[0].strip() == "±") else "")


def unit_of(text: str, quantity: str | None = None) -> tuple[str, float] | None:
    """Quantity and factor of a unit, such as ``("length", 25.4)`` of inches; None if there is none of this name."""
    text = unicodedata.normalize("NFKC", text).casefold().strip().rstrip(".").replace("μ", "µ")
    for name, units in data()["units"].items():
        factor = {unicodedata.normalize("NFKC", key).replace("μ", "µ"): value for key, value in units.items()}.get(text)
        if factor is not None and quantity in (None, name):
            return name, factor
    return None


@dataclass(frozen=True)
class Header:
    """The columns of a table.

    Attributes
    ----------
    headers : tuple of str
        As the file gives them.
    key_of : dict of str to int
        The column of each key.
    factor : dict of str to float
        By key: of the unit in the header, or 1 where it gives none.
    unitless : frozenset of str
        Keys whose quantity has units, and whose header gives none.
    others : dict of str to list of int
        By key: further columns that may be meant, so that the table is ambiguous unless their cells are equal.
    """

    headers: tuple[str, ...]
    key_of: dict[str, int] = field(default_factory=dict)
    factor: dict[str, float] = field(default_factory=dict)
    unitless: frozenset[str] = frozenset()
    others: dict[str, list[int]] = field(default_factory=dict)

    @property
    def unused(self) -> list[str]:
        """Headers of columns that hold no key."""
        used = set(self.key_of.values())
        return [header for i, header in enumerate(self.headers) if header and i not in used]

    def said(self, ignored: Sequence[str] = ()) -> str:
        """The key of each column, and the ignored columns; empty if the headers are the keys and all are used."""
        own = {key: self.headers[i] for key, i in self.key_of.items()}
        usual = [key for key, header in own.items() if header == key]
        unusual = [f"{key} from {header!r}" for key, header in own.items() if header != key]
        for factor in dict.fromkeys(self.factor.values()):
            scaled = ", ".join(key for key, own_factor in self.factor.items() if own_factor == factor)
            unusual += [f"{scaled} × {factor:g}"] * (factor != 1)
        ignored = [*map(repr, self.unused), *ignored]
        if not unusual and not ignored:
            return ""
        read = [*unusual, *([f"{', '.join(usual)} as named"] if usual else [])] or ["none"]
        return "columns read: " + ", ".join(read) + ("; ignored: " + ", ".join(ignored) if ignored else "")


@dataclass(frozen=True)
class Columns:
    """Possible columns of a table.

    Attributes
    ----------
    aliases : dict of str to sequence of str
        By key: its headers, in the order of preference; the key itself precedes them.
    texts : frozenset of str
        Keys of columns without numbers, which tell nothing about the decimal mark.
    quantities : dict of str to str
        By key: its quantity, where ``columns.toml`` states none.
    """

    aliases: Mapping[str, Sequence[str]]
    texts: frozenset[str] = frozenset()
    quantities: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_file(cls, keys: Iterable[str]) -> Columns:
        """Keys with the headers of ``columns.toml``."""
        known = data()["columns"]
        return cls({key: known.get(key, ()) for key in keys}, frozenset(data()["texts"]["keys"]))

    @cached_property
    def _key_of(self) -> dict[str, tuple[str, int]]:
        """Key and preference by squashed header."""
        found: dict[str, tuple[str, int]] = {}
        for rank in (0, 1):
            for key, aliases in self.aliases.items():
                for i, alias in enumerate(aliases if rank else (key,)):
                    found.setdefault(squash(alias), (key, i + rank))
        alike = Counter(map(squash, self.aliases))
        return {plain: own for plain, own in found.items() if alike[plain] < 2}

    def key(self, header: str) -> tuple[str, int, float | None] | None:
        """Key of a header, its preference, and the factor of its unit, None if it gives none; None for others."""
        if header in self.aliases:
            return header, -1, None
        plain, unit = header, None
        for bracket in BRACKETED.finditer(header):
            if unit_of(bracket[1]):
                plain, unit = header[: bracket.start()] + header[bracket.end() :], bracket[1]
        found = self._key_of.get(squash(plain))
        if found is None and unit is None and (ending := ENDING.match(header.strip())) and unit_of(ending[2]):
            found, unit = self._key_of.get(squash(ending[1])), ending[2]
        if found is None:
            return None
        quantity = self.quantities.get(found[0]) or quantity_of(found[0])
        if unit is None:
            return *found, None
        factor = unit_of(unit, quantity)
        return (*found, factor[1]) if quantity is not None and factor is not None else None

    def count(self, headers: Sequence[str]) -> int:
        """Number of different keys among headers."""
        return len({found[0] for header in headers if header and (found := self.key(header))})

    def match(self, headers: Sequence[str], given: Mapping[str, str] | None = None) -> Header:
        """The columns of the keys.

        Parameters
        ----------
        headers : sequence of str
        given : mapping of str to str, optional
            Header by key, where the user says so.

        Raises
        ------
        SceneError
            If a given header does not exist.
        """
        candidates: dict[str, list[tuple[int, int]]] = {}
        factor: dict[int, float | None] = {}
        said = {}
        for key, wanted in (given or {}).items():
            alike = [i for i, header in enumerate(headers) if header == wanted]
            alike = alike or [i for i, header in enumerate(headers) if squash(header) == squash(wanted)]
            if key not in self.aliases or len(alike) != 1:
                what, known = (wanted, headers) if key in self.aliases else (key, [*self.aliases])
                count = "is more than once among" if len(alike) > 1 and key in self.aliases else "is none of"
                raise SceneError(f"columns: {what!r} {count} {', '.join(filter(None, known))}; correct it")
            said[key] = alike[0]
        for i, header in enumerate(headers):
            found = self.key(header) if header else None
            mine = next((key for key, own in said.items() if own == i), None)
            if mine is not None:
                unit = next((unit_of(one[1], quantity_of(mine)) for one in BRACKETED.finditer(header)), None)
                candidates.setdefault(mine, []).append((-2, i))
                factor[i] = unit[1] if unit else None
            elif found is not None and found[0] not in said:
                candidates.setdefault(found[0], []).append((found[1], i))
                factor[i] = found[2]
        key_of = {key: min(candidates[key])[1] for key in self.aliases if key in candidates}
        return Header(
            tuple(headers),
            key_of,
            {key: factor[i] or 1.0 for key, i in key_of.items()},
            frozenset(key for key, i in key_of.items() if quantity_of(key) and factor[i] is None),
            {key: [i for _, i in sorted(found)[1:]] for key, found in candidates.items() if len(found) > 1},
        )

    def refuse_misspelt(self, header: Header) -> None:
        """Raise SceneError if an unused header is nearly that of a key that no column holds."""
        for text in header.unused:
            plain = squash(text)
            if len(plain) < SHORTEST:
                continue
            near = difflib.get_close_matches(plain, self._key_of, 1, ALIKE)
            key = self._key_of[near[0]][0] if near else None
            if key is not None and key not in header.key_of:
                raise SceneError(
                    f"there is no column {text!r}; did you mean {key!r}? Rename it, or say what it is by a line in the "
                    f'scene, columns = {{ {key} = "{text}" }}'
                )


@cache
def quantity_of(key: str) -> str | None:
    """The quantity of a key, whose units a header may give; None if it has none."""
    return next((name for name, keys in data()["quantities"].items() if key in keys), None)
