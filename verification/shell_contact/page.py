"""The page of a case: geometry, contact, process and values. `case.json` has all positions and loads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mic.model.assembly import assemble
from mic.process.description import sentences
from verification.shell_contact.case import LEVELS, Case
from verification.shell_contact.converged import Converged

__all__ = ["page", "row"]

RULES = "Conventions, contact law, stages and uncertainty: [all cases](../../README.md)."
LEGEND = "Supports black, clamps red, welds violet, probes green, rigid bodies as circles."
FILES = (
    "`case.json` holds all positions, directions, radii and loads, `mesh.inp` the coarse mesh, `values.csv` the values "
    "on three meshes, `problem.hdf5` the last contact problem (FCLIB)."
)


def page(case: Case, values: Sequence[Converged], cache: Path) -> str:
    """Markdown: geometry in words, sheets, contact zones, the process step by step, values ± uncertainty."""
    scene = assemble(case.scene("coarse"), cache).scene
    title, _, words = case.text.partition("\n")
    tables = [
        (
            "Sheets",
            ("name", "thickness, mm", "E, MPa", "ν"),
            [(p.name, p.thickness, p.young, p.poisson) for p in scene.parts],
        ),
        ("Contact", ("zone", "between", "μ", "within the box, mm"), [_zone(z) for z in scene.zones]),
    ]
    lines = [title, "", words.strip(), "", f"![{case.name}](picture.png)", "", LEGEND, "", RULES, "", FILES, ""]
    for heading, columns, rows in tables:
        if rows:
            lines += [f"## {heading}", "", *_table(columns, rows), ""]
    lines += ["## Process", ""]
    for number, plan in enumerate(case.plans(cache), start=1):
        lines += [
            f"{number}. **{plan.name}.** " + ". ".join(s[0].upper() + s[1:] for s in sentences(scene, plan)) + "."
        ]
    lines += ["", "## Values", "", *_values(case, values)]
    return "\n".join(lines) + "\n"


def _values(case: Case, values: Sequence[Converged]) -> list[str]:
    sizes = ", ".join(f"{case.sizes[level]:.3g} mm ({level})" for level in LEVELS)
    columns = ("quantity", "value")
    known = [row(one) for one in values if one.known]
    lines = [f"Elements and contact candidates: {sizes}.", "", *_table(columns, known)]
    others = [row(one) for one in values if not one.known]
    if others:
        lines += ["", "Not for comparison, since the uncertainty exceeds a quarter of the value:", ""]
        lines += _table(columns, others)
    return lines


def row(one: Converged) -> tuple[str, str]:
    """Name with unit, and value ± uncertainty, of a quantity; bold if it is for comparison."""
    digits = max(0, 1 - int(np.floor(np.log10(max(one.uncertainty, 1e-9)))))
    value = f"{one.value:.{digits}f} ± {one.uncertainty:.{digits}f}"
    return f"{one.name}, {one.unit}", f"**{value}**" if one.known else value


def _zone(zone) -> tuple:
    friction = zone.friction
    coefficient = (
        ", ".join(f"{stage} {mu:g}" for stage, mu in friction.items()) if isinstance(friction, dict) else friction
    )
    box = "everywhere" if zone.box is None else " to ".join(_cell(corner) for corner in zone.box)
    return zone.name, zone.parts, coefficient, box


def _table(columns: Sequence[str], rows: Sequence[Sequence]) -> list[str]:
    made = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
    return made + ["| " + " | ".join(_cell(one) for one in row) + " |" for row in rows]


def _cell(value) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, tuple | list | np.ndarray):
        return ", ".join(_cell(one) for one in value)
    return f"{round(float(value), 6) + 0.0:.6g}"
