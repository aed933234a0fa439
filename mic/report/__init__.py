"""The offline page of a run and its pictures. Drawing never solves, and changes nothing that a run left.

Whoever works in Python finds here what the pages show: ``write_report(folder)`` draws the page of a results folder,
``pictures(found)`` the pictures of what :func:`mic.explain`, :func:`mic.sensitivity` or another function found, as
:class:`mic.report.picture.Picture`, which notebooks show by themselves. Which those are, :mod:`mic.report.study_pictures`
lists.
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
