"""Limitations of the program, from its README."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

__all__ = ["limitations"]

README = Path(__file__).resolve().parent.parent / "README.md"
HEADING = "## Limitations"


def limitations() -> list[str]:
    """Points of the README's section on limitations; empty if neither a checkout nor the package has it."""
    text = README.read_text(encoding="utf-8") if README.is_file() else _packaged()
    _, found, rest = text.partition(f"\n{HEADING}\n")
    section = rest.partition("\n## ")[0]
    points = re.split(r"^- ", section, flags=re.MULTILINE)[1:] if found else []
    return [_plain(" ".join(point.split())) for point in points]


def _plain(text: str) -> str:
    """Text without Markdown for code and links."""
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).replace("`", "")


def _packaged() -> str:
    try:
        found = metadata("mic-contact")
    except PackageNotFoundError:
        return ""
    return str(found.get("Description") or found.get_payload() or "")
