"""Data of the report beside the outcome: parts, fields, published figures, selected stage and laws."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from mic.geometry.surface import Surface
from mic.report.style import LAWS
from mic.results.fields import PartField, read_fields
from mic.results.outcome import Outcome
from mic.results.run_folder import PUBLISHED
from mic.results.schema import Table
from mic.system.files import JSON_LIMIT, Format, reading
from mic.system.regular_files import read_regular

__all__ = ["SHOWN", "Context", "read_context", "study_tables"]

SHOWN = 10_000  # samples of the distributions, the first ones; more do not change a picture


@dataclass(frozen=True)
class Context:
    """Data of a run folder for its report, beside the outcome.

    Attributes
    ----------
    stage : str or None
        Stage of the single-stage pictures: the first that resolves contact.
    laws : tuple of str
        Laws with at least one valid sample, in the order of the request.
    frictional, frictionless : str or None
        The first law with friction and the first without; pictures compare them.
    surfaces : dict of str to Surface
        By part; empty if the run stored no parts.
    fields : tuple of PartField
    no_fields : str or None
        Reason for missing fields.
    published : dict
        Published figures of the scene, if any.
    """

    stage: str | None
    laws: tuple[str, ...]
    frictional: str | None
    frictionless: str | None
    surfaces: Mapping[str, Surface]
    fields: tuple[PartField, ...]
    no_fields: str | None
    published: Mapping[str, Any]

    def fields_of(self, law: str) -> dict[str, PartField]:
        """The fields under one law, by part."""
        return {field.part: field for field in self.fields if field.law == law}


def study_tables(outcome: Outcome, *tables: Table) -> list[pd.DataFrame] | None:
    """Tables of a study; None unless all are in the folder."""
    found = [outcome.study(table) for table in tables]
    return None if any(table is None for table in found) else found  # type: ignore[return-value]


def read_context(outcome: Outcome) -> Context:
    """Read these data from the outcome's folder."""
    fields, no_fields = read_fields(outcome.folder)
    path, published = outcome.folder / PUBLISHED, dict[str, Any]()
    if path.is_file():
        with reading(path, Format("table of published values", 1, "correct it or remove it")):
            published = tomllib.loads(read_regular(path, JSON_LIMIT).decode())
    return Context(
        stage=outcome.stages[0] if outcome.stages else None,
        laws=tuple(law for law in outcome.laws if len(outcome.sample_numbers(law))),
        frictional=next((law for law in outcome.laws if LAWS[law].frictional), None),
        frictionless=next((law for law in outcome.laws if not LAWS[law].frictional), None),
        surfaces={part.name: part.surface for part in outcome.parts},
        fields=tuple(fields),
        no_fields=no_fields,
        published=published,
    )
