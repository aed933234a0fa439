"""The report of a run: one self-contained HTML page."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

from mic.contact.solution import advice_on
from mic.process.description import alignments
from mic.report import driver_sentences
from mic.report.background_pictures import BackgroundPictures
from mic.report.context import Context, read_context, study_tables
from mic.report.estimator_sentences import claimed_confidence, estimator_sentences
from mic.report.picture_registry import PICTURES, draw_all
from mic.report.style import LAWS, zone_colour
from mic.report.template import render
from mic.report.verdict import verdict
from mic.report.viewer_data import plotly_script, viewer_data
from mic.results import schema
from mic.results.outcome import Outcome, read_outcome
from mic.statistics.estimates import covered_share
from mic.studies.contributors import joint_ranking
from mic.studies.friction import friction_needed
from mic.system.files import replacing, write_text

__all__ = ["write_report"]

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
        Pictures of that outcome that worker processes draw.

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
    sections: dict[str, list[str]] = {entry.section: [] for entry in PICTURES}
    for entry in PICTURES:
        sections[entry.section] += [entry.name] * (entry.name in pictures)
    viewer = viewer_data(outcome, context)
    zones = _zones(outcome, context)
    page = render(
        "report.html",
        outcome=outcome,
        context=context,
        verdict=verdict(outcome),
        alignments=list(alignments(outcome.model.scene)),
        drivers=_drivers(outcome),
        misses=_misses(outcome),
        remedies=_remedies(outcome),
        optimum=_optimum(outcome),
        pictures=pictures,
        sections=sections,
        paths=_paths(outcome),
        validity=_validity(outcome),
        zones=zones,
        trend=_trend(zones, context.stage),
        estimators=estimator_sentences(outcome),
        claimed=claimed_confidence(outcome),
        covered=covered_share(outcome.record["samples"]),
        accuracy=outcome.study(schema.ACCURACY),
        mesh_changes=outcome.study(schema.MESH_CHANGES),
        viewer=viewer,
        plotly=plotly_script() if viewer else None,
    )
    path = outcome.folder / "report.html"
    write_text(path, page)
    if "assembly" in pictures:
        with replacing(outcome.folder / "assembly.png") as temporary:
            temporary.write_bytes(pictures["assembly"].data)
    return path


def _drivers(outcome: Outcome) -> dict[str, Any]:
    """Contributors, estimates by derivatives and effects of friction, as far as they were computed."""
    found: dict[str, list] = dict.fromkeys(("rows", "words", "joint", "spreads", "friction", "friction_words"), [])
    if computed := study_tables(outcome, schema.CONTRIBUTORS, schema.LINEARITY):
        table, linearity = computed
        found["words"] = driver_sentences.linear_words(table, linearity)
        found["joint"] = _records(joint_ranking(table, linearity, outcome.model.scene))[:LISTED_CONTRIBUTORS]
        ranked = table[table["total"].notna() | table["bound"].isna()]
        ranked = ranked.sort_values("total", ascending=False, kind="stable")
        for row in _records(linearity):
            own = ranked[(ranked["law"] == row["law"]) & (ranked["measurement"] == row["measurement"])]
            found["rows"] = [*found["rows"], row | {"contributors": _records(own)[:LISTED_CONTRIBUTORS]}]
    if computed := study_tables(outcome, schema.SPREADS):
        found["spreads"] = _records(computed[0][computed[0]["kind"] != "plain"])
    if computed := study_tables(outcome, schema.FRICTION_EFFECTS):
        found["friction"] = _records(computed[0])
        found["friction_words"] = driver_sentences.friction_words(computed[0], friction_needed(computed[0]))
    return found


def _remedies(outcome: Outcome) -> dict[str, Any]:
    """Remedies and their effects on fresh samples, as far as they were computed."""
    computed = study_tables(outcome, schema.REMEDIES, schema.REMEDY_EFFECTS)
    if not computed:
        return {"rows": [], "words": []}
    table, effects = computed
    rows = []
    for name, own in effects.groupby("remedy", sort=False):
        moves = [
            f"{driver_sentences.adjusted(one)}, to {one['value']:.4g}"
            for one in _records(table[table["remedy"] == name])
        ]
        rows.append({"moves": moves, "effects": _records(own[own["fresh"] == own["fresh"].max()])})
    return {"rows": rows, "words": driver_sentences.remedy_words(table, effects, outcome.model.scene)}


def _misses(outcome: Outcome) -> list[str]:
    """The most likely misses in sentences, as far as they were computed."""
    computed = study_tables(outcome, schema.RARE, schema.DESIGN_POINTS)
    return driver_sentences.design_words(*computed) if computed else []


def _optimum(outcome: Outcome) -> dict[str, Any]:
    """The optimum on fresh samples, as far as it was computed."""
    found: dict[str, Any] = {"words": [], "changes": [], "matches": {}, "kinds": []}
    if computed := study_tables(outcome, schema.OPTIMA, schema.OPTIMUM_CHANGES):
        found["words"], found["changes"] = driver_sentences.optimum_words(computed[0]), _records(computed[1])
    matched = outcome.study(schema.OPTIMUM_MATCHES)
    if matched is not None and len(matched):
        found["kinds"] = list(matched["kind"].unique())
        for row in _records(matched):
            found["matches"].setdefault(row["assembly"], {})[row["kind"]] = row["row"]
        found["words"] = [*found["words"], f"{len(found['matches'])} assemblies of measured parts were matched."]
    return found


def _validity(outcome: Outcome) -> list[dict[str, Any]]:
    """For each law: residual, counts, and the failed samples with advice."""
    rows = []
    for law in outcome.record["laws"]:
        run = law in outcome.laws
        failures = outcome.failures(law).groupby("status", sort=False) if run else ()
        short = [row for row in _records(outcome.limit_statistics) if row["law"] == law and row["short"]]
        rows.append(
            {
                "law": law,
                "valid": len(outcome.sample_numbers(law)) if run else 0,
                "residual": outcome.worst_residual(law) if run else float("nan"),
                "short": short,
                "reasons": [(status, advice_on(str(status)), _records(found)) for status, found in failures],
            }
        )
    return rows


def _paths(outcome: Outcome) -> list[dict[str, Any]]:
    """For each law with friction: steps and estimated error of the path, and the number of repeated samples."""
    study, summary = outcome.path_study, outcome.summary()["laws"]
    return [
        {"law": law, "repeated": study.repeated(law) if study else 0} | summary[law]["path"]
        for law in outcome.laws
        if LAWS[law].frictional and outcome.has_slip and len(outcome.sample_numbers(law))
    ]


def _zones(outcome: Outcome, context: Context) -> list[dict[str, Any]]:
    """Rows of the paper's Table 1: figures of each law by zone, and the published ones."""
    table = outcome.zone_headlines
    if context.stage is None or not len(table):
        return []
    published = context.published.get("zones", {})
    return [
        {
            "zone": zone,
            "stage": stage,
            "colour": zone_colour(i),
            "friction": outcome.model.scene.zones[i].coefficient(stage),
            "pairs": int((outcome.model.contacts.zone == i).sum()),
            "laws": {row["law"]: row for row in _records(table[(table["zone"] == zone) & (table["stage"] == stage)])},
            "published": published.get(zone, {}) if stage == context.stage else {},
        }
        for i, zone in enumerate(outcome.zones)
        for stage in outcome.stages
    ]


def _trend(zones, stage):
    """How friction changes mean and 6σ of the tangential displacement, here and as published.

    None unless both are known.
    """
    shown = [row for row in zones if row["stage"] == stage and {"frictionless", "associated"} <= set(row["published"])]
    law = next((law for law in ("coulomb", "associated") if shown and law in shown[0]["laws"]), None)
    if law is None or "frictionless" not in shown[0]["laws"]:
        return None

    def changes(kind, law, name):
        pairs = [(row[kind][law][name], row[kind]["frictionless"][name]) for row in shown]
        texts = [f"{100 * (after / before - 1):+.0f}" if before > 0 else "–" for after, before in pairs]
        return ", ".join(texts).replace("-", "−")

    texts = []
    for figure, word in (("mean", "mean"), ("six_sigma", "6σ")):
        here, there = changes("laws", law, f"{figure}_rms_tangential"), changes("published", "associated", figure)
        texts.append(f"the {word} by {here} % here ({law}) and by {there} % in the paper")
    return f"Friction changes, in {', '.join(row['zone'] for row in shown)}: {'; '.join(texts)}."


def _records(table):
    return table.to_dict("records")
