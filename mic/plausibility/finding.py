"""Return type of the rules."""

from __future__ import annotations

from typing import Any

__all__ = ["Finding", "Point", "about", "label"]

Point = tuple[float, float, float]
#: The item, what is unusual about it, its location, mm, and whether no assembly has it (default: false).
Finding = tuple[str, str, Point | None] | tuple[str, str, Point | None, bool]


def label(table: str, item: Any) -> str:
    """An item of a scene's table, such as ``clamp C1``."""
    return f"{table.removesuffix('s')} {item.name}"


def about(table: str, item: Any, text: str) -> tuple[str, str, Point | None]:
    """A finding about an item, at its point if it has one; a measurement's first point."""
    places = getattr(item, "places", None)
    return label(table, item), text, places[0][1] if places else getattr(item, "point", None)
