"""The report of a run: one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs

from mic.contact.solution import Status
from mic.report.background_pictures import BackgroundPictures
from mic.report.context import read_context
from mic.report.driver_sentences import (
    design_words,
    friction_words,
    linear_words,
    optimum_words,
    remedy_words,
    signed,
    unit_of,
)
from mic.report.picture_registry import PICTURES, SECTIONS, draw_all
from mic.report.style import LAWS, STATE_COLOURS, STATE_WORDS, zone_colour
from mic.report.template import render
from mic.report.verdict import verdict
from mic.report.viewer_data import packed, viewer_data
from mic.results.mesh_error import read_accuracy
from mic.results.outcome import Outcome, read_outcome
from mic.results.schema import (
    CONTRIBUTORS,
    DESIGN_POINTS,
    FRICTION_EFFECTS,
    LINEARITY,
    OPTIMA,
    OPTIMUM_CHANGES,
    OPTIMUM_MATCHES,
    RARE,
    REMEDIES,
    REMEDY_EFFECTS,
    SPREADS,
)
from mic.statistics.estimates import LEVEL, covered_share
from mic.studies.contributors import joint_ranking
from mic.studies.friction import friction_needed
from mic.system.files import replacing, write_text

__all__ = ["write_report"]

LISTED_FAILURES = 50
LISTED_CONTACTS = 1000
LISTED_CONTRIBUTORS = 6


def write_report(
    folder: str | PathLike[str], outcome: Outcome | None = None, background: BackgroundPictures | None = None
) -> Path:
    """Write ``report.html`` and ``assembly.png`` into a run folder, finished or interrupted.

    The page shows the statistics, fields and studies in the folder. Nothing is solved, and no other file is changed.

    Parameters
    ----------
    folder : path-like
    outcome : Outcome, optional
        The outcome of that folder, if it has been read already.
    background : BackgroundPictures, optional
        Pictures of that outcome that a worker process draws.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    FileNotFoundError
        If it is not a run folder.
    """
    outcome = outcome or read_outcome(folder)
    context = read_context(outcome)
    pictures = draw_all(outcome, context, background)
    sections = {
        section: [entry.name for entry in PICTURES if entry.section == section and entry.name in pictures]
        for section in SECTIONS
    }
    viewer = viewer_data(outcome, context)
    zones = _zones(outcome, context.stage, context.published)
    page = render(
        "report.html",
        outcome=outcome,
        record=outcome.record,
        scene=outcome.model.scene,
        stage=context.stage,
        level=f"{100 * LEVEL:.0f} %",
        verdict=verdict(outcome),
        drivers=_drivers(outcome) | {"shown": any(sections[one] for one in ("drivers", "steps", "friction"))},
        misses=_misses(outcome),
        remedies=_remedies(outcome),
        optimum=_optimum(outcome),
        pictures=pictures,
        sections=sections,
        colour=lambda law: LAWS[law].colour,
        states=list(STATE_COLOURS),
        state_words=STATE_WORDS,
        paths=_paths(outcome),
        facts=_facts(outcome),
        validity=_validity(outcome),
        zones=zones,
        trend=_trend(zones, context.stage),
        published=context.published,
        measurements=_records(outcome.measurement_statistics),
        covered=covered_share(outcome.record["samples"]),
        accuracy=_accuracy(outcome),
        no_fields=context.no_fields,
        contacts=_records(outcome.contact_statistics),
        listed_contacts=LISTED_CONTACTS,
        viewer=viewer,
        plotly=packed(get_plotlyjs()) if viewer else None,
    )
    path = outcome.folder / "report.html"
    write_text(path, page)
    if "assembly" in pictures:
        with replacing(outcome.folder / "assembly.png") as temporary:
            temporary.write_bytes(pictures["assembly"].data)
    return path


def _drivers(outcome: Outcome) -> dict[str, Any]:
    """Contributors, estimates by derivatives and effects of friction, as far as they were computed."""
    table, linearity, effects = (outcome.study(t) for t in (CONTRIBUTORS, LINEARITY, FRICTION_EFFECTS))
    found: dict[str, Any] = {"rows": [], "words": [], "joint": [], "spreads": [], "friction": [], "friction_words": []}
    if table is not None and linearity is not None:
        for row in _records(linearity):
            shares = table[(table["law"] == row["law"]) & (table["measurement"] == row["measurement"])]
            shares = shares[shares["total"].notna() | shares["bound"].isna()]
            ordered = _records(shares.sort_values("total", ascending=False, kind="stable"))
            found["rows"].append(row | {"contributors": ordered[:LISTED_CONTRIBUTORS]})
        found["words"] = linear_words(table, linearity)
        found["joint"] = _records(joint_ranking(table, linearity, outcome.model.scene))[:LISTED_CONTRIBUTORS]
    spreads = outcome.study(SPREADS)
    if spreads is not None:
        found["spreads"] = _records(spreads[spreads["kind"] != "plain"])
    if effects is not None:
        found["friction"] = _records(effects)
        found["friction_words"] = friction_words(effects, friction_needed(effects))
    return found


def _remedies(outcome: Outcome) -> dict[str, Any]:
    """Remedies and their effects on fresh samples, as far as they were computed."""
    table, effects = outcome.study(REMEDIES), outcome.study(REMEDY_EFFECTS)
    found: dict[str, Any] = {"rows": [], "words": []}
    if table is None or effects is None:
        return found
    found["words"] = remedy_words(table, effects, outcome.model.scene)
    for name, rows in effects.groupby("remedy", sort=False):
        moves = _records(table[table["remedy"] == name])
        adjustments = [
            f"{one['adjustment']} {signed(one['change'])} {unit_of(one['adjustment'])}, to {one['value']:.4g}"
            for one in moves
        ]
        found["rows"].append({"moves": adjustments, "effects": _records(rows[rows["fresh"] == rows["fresh"].max()])})
    return found


def _misses(outcome: Outcome) -> list[str]:
    """The most likely misses in sentences, as far as they were computed."""
    table, points = outcome.study(RARE), outcome.study(DESIGN_POINTS)
    return [] if table is None or points is None else design_words(table, points)


def _optimum(outcome: Outcome) -> dict[str, Any]:
    """The optimum on fresh samples, as far as it was computed."""
    whole, changes, matched = (outcome.study(t) for t in (OPTIMA, OPTIMUM_CHANGES, OPTIMUM_MATCHES))
    found: dict[str, Any] = {"words": [], "changes": [], "matches": {}, "kinds": []}
    if whole is not None and changes is not None:
        found["words"], found["changes"] = optimum_words(whole), _records(changes)
    if matched is not None and len(matched):
        found["kinds"] = list(matched["kind"].unique())
        for row in _records(matched):
            found["matches"].setdefault(row["assembly"], {})[row["kind"]] = row["row"]
        found["words"] = [*found["words"], f"{len(found['matches'])} assemblies of measured parts were matched."]
    return found


def _facts(outcome: Outcome) -> list[tuple[str, str]]:
    """Heading facts as (name, value) pairs."""
    record, model = outcome.record, outcome.model
    contacts, zones = len(model.contacts), len(outcome.zones)
    pairs = f"{contacts} in {zones} zone{'s' if zones > 1 else ''}, {model.contacts.dimension * contacts} unknowns"
    resolutions = f"{len(outcome.stages)} ({', '.join(outcome.stages)})"
    functionals = [f"{part.name} {count}" for part, count in zip(model.scene.parts, np.diff(model.compliance.offsets))]
    return [
        ("Samples", f"{record['samples']}, seed {record['seed']}"),
        ("Contact laws", ", ".join(record["laws"])),
        ("Stages", " → ".join(str(item.name) for item in model.scene.stages)),
        ("Contact pairs", pairs if contacts else "none"),
        ("Contact resolutions per sample", resolutions if outcome.stages else "none"),
        ("Retained functionals", ", ".join(functionals)),
    ]


def _validity(outcome: Outcome) -> list[dict[str, Any]]:
    """For each law: residual, counts, and the failed samples with advice."""
    rows = []
    for law in outcome.record["laws"]:
        run = law in outcome.laws
        reasons: dict[str, list] = {}
        for row in _records(outcome.failures(law)) if run else ():
            reasons.setdefault(row["status"], []).append((int(row["sample"]), row["stage"], row["residual"]))
        rows.append(
            {
                "law": law,
                "valid": len(outcome.sample_numbers(law)) if run else 0,
                "missing": outcome.missing[law],
                "failed": len(outcome.failed[law]),
                "residual": outcome.worst_residual(law) if run else float("nan"),
                "rescued": len(outcome.rescued[law]),
                "not_built": len(outcome.unbuilt[law]),
                "short": [row for row in _records(outcome.limit_statistics) if row["law"] == law and row["short"]],
                "reasons": [
                    {
                        "status": status,
                        "advice": _advice(status),
                        "samples": found[:LISTED_FAILURES],
                        "count": len(found),
                        "unlisted": max(0, len(found) - LISTED_FAILURES),
                    }
                    for status, found in reasons.items()
                ],
            }
        )
    return rows


def _accuracy(outcome: Outcome) -> list[dict[str, Any]]:
    """Estimated mesh error of each part, and the cost of half the element size; empty where it was not estimated."""
    found = read_accuracy(outcome.folder)
    if found is None:
        return []
    parts = found.groupby("part", sort=False)
    return [{**_records(rows)[0], "part": part, "quantities": _records(rows)} for part, rows in parts]


def _advice(status):
    try:
        return Status(status).advice
    except ValueError:
        return "The computation failed at this sample; look for implausibly large deviations."


def _paths(outcome: Outcome) -> list[dict[str, Any]]:
    """For each law with friction: steps and estimated error of the path, and the number of repeated samples."""
    study, summary = outcome.path_study, outcome.summary()["laws"]
    return [
        {"law": law, "repeated": study.repeated(law) if study else 0} | summary[law]["path"]
        for law in outcome.laws
        if LAWS[law].frictional and outcome.has_slip and len(outcome.sample_numbers(law))
    ]


def _zones(outcome: Outcome, stage: str | None, published: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of the paper's Table 1: figures of each law by zone, and the published ones."""
    table = outcome.zone_statistics
    rows: list[dict[str, Any]] = []
    if stage is None or not len(table):
        return rows
    published_zones = published.get("zones", {})
    for i, zone in enumerate(outcome.zones):
        for name in outcome.stages:
            found = table[(table["zone"] == zone) & (table["stage"] == name)]
            rows.append(
                {
                    "zone": zone,
                    "stage": name,
                    "colour": zone_colour(i),
                    "friction": outcome.model.scene.zones[i].coefficient(name),
                    "pairs": int((outcome.model.contacts.zone == i).sum()),
                    "laws": {row["law"]: row for row in _records(found)},
                    "published": published_zones.get(zone, {}) if name == stage else {},
                }
            )
    return rows


def _trend(zones, stage):
    """How friction changes mean and 6σ of the tangential displacement, here and as published.

    None unless both are known.
    """
    shown = [row for row in zones if row["stage"] == stage and {"frictionless", "associated"} <= set(row["published"])]
    law = next((law for law in ("coulomb", "associated") if shown and law in shown[0]["laws"]), None)
    if law is None or "frictionless" not in shown[0]["laws"]:
        return None

    def change(after, before):
        return f"{100 * (after / before - 1):+.0f}".replace("-", "−") if before > 0 else "–"

    texts = []
    for ours, theirs, label in (
        ("mean_rms_tangential", "mean", "mean"),
        ("six_sigma_rms_tangential", "six_sigma", "6σ"),
    ):
        here = ", ".join(change(row["laws"][law][ours], row["laws"]["frictionless"][ours]) for row in shown)
        there = ", ".join(
            change(row["published"]["associated"][theirs], row["published"]["frictionless"][theirs]) for row in shown
        )
        texts.append(f"the {label} by {here} % here ({law}) and by {there} % in the paper")
    return f"Friction changes, in {', '.join(row['zone'] for row in shown)}: {'; '.join(texts)}."


def _records(table):
    return table.to_dict("records")
