"""Write the tables of statistics and ``summary.json`` of a run folder."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from mic.results.friction_sweep import study_friction
from mic.results.outcome import Outcome
from mic.results.path_error import study_path
from mic.results.schema import (
    CONTACT_STATISTICS,
    FRICTION,
    LIMIT_STATISTICS,
    MEASUREMENT_STATISTICS,
    PATH,
    PATH_ERRORS,
    PROFILE_STATISTICS,
    ZONE_STATISTICS,
    Table,
)
from mic.system.files import Format, Group, save_json, together

__all__ = ["write_path_study", "write_summary", "write_tables"]

SUMMARY = Format("summary of a run", 2, "call `mic report` on the run folder")


def write_path_study(outcome: Outcome) -> None:
    """Solve and write the path study (:mod:`mic.results.path_error`), whose effects the other tables include."""
    study = study_path(outcome)
    _write(outcome.folder, PATH, study.pairs if study else None)
    _write(outcome.folder, PATH_ERRORS, study.errors if study else None)


def write_tables(outcome: Outcome) -> None:
    """Write ``tables/*.csv`` into the run folder, and solve and write the friction study.

    The tables include path effects if :func:`write_path_study` ran before.
    """
    tables = {
        ZONE_STATISTICS: outcome.zone_statistics,
        CONTACT_STATISTICS: outcome.contact_statistics,
        MEASUREMENT_STATISTICS: outcome.measurement_statistics,
        PROFILE_STATISTICS: outcome.profile_statistics,
        LIMIT_STATISTICS: outcome.limit_statistics,
        FRICTION: study_friction(outcome),
    }
    with together() as group:
        for table, frame in tables.items():
            _write(outcome.folder, table, frame, group)


def _write(folder: Path, table: Table, frame: pd.DataFrame | None, group: Group | None = None) -> None:
    """Write a table, with full precision if it is read again; delete its file if it has no rows."""
    if frame is None or not len(frame):
        table.remove(folder)
        return
    table.write(folder, frame, exact=table in (FRICTION, PATH, PATH_ERRORS), group=group)


def write_summary(outcome: Outcome) -> Path:
    """Write ``summary.json`` into the run folder; returns its path."""
    path = outcome.folder / "summary.json"
    save_json(path, SUMMARY, outcome.summary())
    return path
