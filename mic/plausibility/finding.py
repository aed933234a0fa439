"""What the functions of the rules return."""

from __future__ import annotations

from typing import Any

__all__ = ["Finding", "Point", "label"]

Point = tuple[float, float, float]
Finding = tuple[str, str, Point | None]  #: the item, what is unusual about it, and its location, mm


def label(table: str, item: Any) -> str:
    """An item of a scene's table, such as ``clamp C1``."""
    return f"{table.removesuffix('s')} {item.name}"
