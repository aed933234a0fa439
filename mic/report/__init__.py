"""The self-contained pages and their pictures. Drawing never solves and never changes results.

``write_report(folder)`` writes the page of a results folder. ``pictures(result)`` returns the pictures of the result of
:func:`mic.explain`, :func:`mic.sensitivity` or another function, as :class:`mic.report.picture.Picture`, which
notebooks display; :mod:`mic.report.study_pictures` lists them.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOMES = {
    "comparison_pictures": "mic.report.comparison_page",
    "explanation_pictures": "mic.report.explanation_page",
    "pictures": "mic.report.study_pictures",
    "write_report": "mic.report.page",
}


def __getattr__(name: str) -> Any:
    """Functions, imported when they are first asked for: drawing libraries are slow to import."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'mic.report' has no attribute {name!r}")
