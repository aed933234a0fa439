"""The report of a run: one HTML page that holds all it shows, opens offline and loads nothing."""

from __future__ import annotations

import base64
import json
import pkgutil
import tomllib
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader
from matplotlib import colormaps
from matplotlib.colors import to_hex

from mic.contact.solution import Status
from mic.report import pictures
from mic.report.pictures import LAW_COLOURS, PART_COLOURS, number, percent, zone_colour
from mic.results.fields import read_fields
from mic.results.folder import PUBLISHED
from mic.results.outcome import read_outcome
from mic.results.statistics import LEVEL, covered_share

__all__ = ["write_report"]

LISTED_FAILURES = 50
LISTED_CONTACTS = 1000
ARROW = 0.07  # length of a locator's arrow, as a share of the largest part


def write_report(folder) -> Path:
    """Write ``report.html`` and ``assembly.png`` into a run folder, finished or interrupted.

    Fields are shown as :func:`mic.results.fields.write_fields` left them.

    Parameters
    ----------
    folder : path-like

    Returns
    -------
    Path
        The page.
    """
    outcome = read_outcome(folder)
    published = _published(outcome.folder)
    surfaces = {part.name: part.surface for part in outcome.parts}
    fields, no_fields = read_fields(outcome.folder)
    stage = outcome.stages[0] if outcome.stages else None
    drawn = {"assembly": pictures.assembly_picture(outcome, surfaces)}
    if stage and outcome.laws:
        drawn |= {
            "density": pictures.slip_density_picture(outcome, stage),
            "force": pictures.slip_force_picture(outcome, stage, published),
            "sample_f": pictures.sample_picture(outcome, stage, "f"),
            "sample_u": pictures.sample_picture(outcome, stage, "u"),
            "states": pictures.state_picture(outcome),
            "cost": pictures.law_cost_picture(outcome, stage),
            "friction": pictures.friction_picture(outcome, stage),
        }
    if outcome.laws:
        drawn["measurements"] = pictures.measurement_picture(outcome)
        drawn["overview"] = pictures.overview_picture(outcome, surfaces, fields, outcome.laws[0])
        drawn["fields"] = pictures.field_picture(surfaces, fields, outcome.laws[0])
    if drawn["assembly"]:
        (outcome.folder / "assembly.png").write_bytes(drawn["assembly"].data)
    zones = _zones(outcome, stage, published)
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["number"] = number
    environment.filters["percent"] = lambda value: percent(value, 1)
    page = outcome.folder / "report.html"
    temporary = page.with_suffix(".partial")
    temporary.write_text(
        environment.get_template("report.html").render(
            outcome=outcome,
            record=outcome.record,
            scene=outcome.model.scene,
            stage=stage,
            level=f"{100 * LEVEL:.0f} %",
            pictures=drawn,
            colours=LAW_COLOURS,
            facts=_facts(outcome),
            failures=_failures(outcome),
            zones=zones,
            trend=_trend(zones, stage),
            published=published,
            measurements=_records(outcome.measurement_statistics),
            covered=covered_share(outcome.record["samples"]),
            no_fields=no_fields,
            contacts=_records(outcome.contact_statistics),
            listed_contacts=LISTED_CONTACTS,
            viewer=_viewer(outcome, surfaces, fields) if surfaces else None,
            plotly=pkgutil.get_data("plotly", "package_data/plotly.min.js").decode() if surfaces else None,
        ),
        encoding="utf-8",
    )
    temporary.replace(page)
    return page


def _published(folder):
    """Published figures to set beside the results, or None."""
    path = folder / PUBLISHED
    return tomllib.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def _facts(outcome):
    """Heading facts as (name, value) pairs."""
    record, model = outcome.record, outcome.model
    contacts, zones = len(model.contacts), len(outcome.zones)
    return [
        ("Samples", f"{record['samples']}, seed {record['seed']}"),
        ("Contact laws", ", ".join(record["laws"])),
        ("Stages", " → ".join(item.name for item in model.scene.stages)),
        (
            "Contact pairs",
            f"{contacts} in {zones} zone{'s' if zones > 1 else ''}, {model.contacts.dimension * contacts} unknowns"
            if contacts
            else "none",
        ),
        (
            "Contact resolutions per sample",
            f"{len(outcome.stages)} ({', '.join(outcome.stages)})" if outcome.stages else "none",
        ),
        (
            "Retained functionals",
            ", ".join(f"{part.name} {count}" for part, count in zip(model.scene.parts, np.diff(model.compliance.offsets))),
        ),
    ]


def _failures(outcome):
    """Per law: residual, counts, and the failed samples with advice."""
    rows = []
    for law in outcome.record["laws"]:
        failures = outcome.failures(law) if law in outcome.laws else None
        reasons = {}
        for _, row in failures.iterrows() if failures is not None else ():
            reasons.setdefault(row["status"], []).append((int(row["sample"]), row["stage"], row["residual"]))
        rows.append(
            {
                "law": law,
                "valid": len(outcome.valid(law)) if law in outcome.laws else 0,
                "missing": outcome.missing[law],
                "failed": len(outcome.failed[law]),
                "residual": outcome.worst_residual(law) if law in outcome.laws else float("nan"),
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


def _advice(status):
    try:
        return Status(status).advice
    except ValueError:
        return "The computation broke off at this sample; look for deviations far outside what parts can have."


def _zones(outcome, stage, published):
    """Rows of the paper's Table 1: per zone the figures of each law, and the published ones."""
    table = outcome.zone_statistics
    rows = []
    if stage is None or not len(table):
        return rows
    theirs = (published or {}).get("zones", {})
    for i, zone in enumerate(outcome.zones):
        for name in outcome.stages:
            found = table[(table["zone"] == zone) & (table["stage"] == name)]
            rows.append(
                {
                    "zone": zone,
                    "stage": name,
                    "colour": zone_colour(i),
                    "friction": outcome.model.scene.zones[i].friction,
                    "pairs": int((outcome.model.contacts.zone == i).sum()),
                    "laws": {row["law"]: row for row in _records(found)},
                    "published": theirs.get(zone, {}) if name == stage else {},
                }
            )
    return rows


def _trend(zones, stage):
    """How mean and 6σ of the slip change with friction, here and as published; None unless both are known."""
    shown = [row for row in zones if row["stage"] == stage and {"frictionless", "associated"} <= set(row["published"])]
    law = next((law for law in ("coulomb", "associated") if shown and law in shown[0]["laws"]), None)
    if law is None or "frictionless" not in shown[0]["laws"]:
        return None

    def change(after, before):
        return f"{100 * (after / before - 1):+.0f}".replace("-", "−") if before > 0 else "–"

    texts = []
    for ours, theirs, label in (("mean_rms_slip", "mean", "mean"), ("six_sigma_rms_slip", "six_sigma", "6σ")):
        here = ", ".join(change(row["laws"][law][ours], row["laws"]["frictionless"][ours]) for row in shown)
        there = ", ".join(
            change(row["published"]["associated"][theirs], row["published"]["frictionless"][theirs]) for row in shown
        )
        texts.append(f"the {label} by {here} % here ({law}) and by {there} % in the paper")
    return f"Friction changes, in {', '.join(row['zone'] for row in shown)}: {'; '.join(texts)}."


def _records(table):
    return table.to_dict("records")


def _viewer(outcome, surfaces, fields):
    """Data of the interactive view, as JSON that a script element may hold."""
    scene, contacts = outcome.model.scene, outcome.model.contacts
    size = max(surface.diameter for surface in surfaces.values())
    parts = [
        {
            "name": name,
            "colour": PART_COLOURS[i % len(PART_COLOURS)],
            "points": _packed(surface.points, "<f4"),
            "triangles": _packed(surface.triangles, "<i4"),
            "fields": {
                field.law: {
                    "mean": _packed(np.linalg.norm(field.mean, axis=1), "<f4"),
                    "mean_normal": _packed(np.einsum("vi,vi->v", field.mean, surface.vertex_normals), "<f4"),
                    "six_sigma": _packed(field.six_sigma_magnitude, "<f4"),
                    "six_sigma_normal": _packed(field.six_sigma_normal, "<f4"),
                }
                for field in fields
                if field.part == name
            },
        }
        for i, (name, surface) in enumerate(surfaces.items())
    ]
    arrows = [
        {
            "name": label,
            "colour": colour,
            "items": [{"name": item.name, "head": item.point, "direction": item.direction} for item in items],
        }
        for items, colour, label in ((scene.locators, "#1b1f24", "locators"), (scene.clamps, "#c1121f", "clamps"))
        if items
    ]
    points = [
        {
            "name": zone.name,
            "colour": zone_colour(z),
            "size": 2.5,
            "points": contacts.point[contacts.zone == z].round(3).tolist(),
            "labels": [f"{zone.name}, contact {k}" for k in np.flatnonzero(contacts.zone == z)],
        }
        for z, zone in enumerate(scene.zones)
    ]
    points += [
        {
            "name": label,
            "colour": colour,
            "size": 5,
            "points": [item.point for item in items],
            "labels": [item.name for item in items],
        }
        for items, colour, label in ((scene.welds, "#f4d35e", "welds"), (scene.measurements, "#ffffff", "measurements"))
        if items
    ]
    laws = [law for law in outcome.laws if any(field.law == law for field in fields)]
    everything = np.concatenate([surface.points for surface in surfaces.values()])
    low, high = everything.min(axis=0) - ARROW * size, everything.max(axis=0) + ARROW * size
    scales = {
        name: [[i / 15, to_hex(colormaps[name](i / 15))] for i in range(16)] for name in ("viridis", "YlOrRd", "RdBu_r")
    }
    data = {
        "scales": scales,
        "eye": dict(zip("xyz", 1.9 * pictures.viewpoint(surfaces.values()))),
        "arrow": ARROW * size,
        "range": np.column_stack([low, high]).tolist(),
        "parts": parts,
        "arrows": arrows,
        "points": [group for group in points if group["points"]],
        "laws": laws,
    }
    return json.dumps(data).replace("<", "\\u003c")


def _packed(array, dtype):
    """An array as base64 of its little-endian bytes."""
    return base64.b64encode(np.ascontiguousarray(array, dtype=dtype).tobytes()).decode()
