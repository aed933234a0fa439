"""A case's page: what another code's author needs to solve it, and what comes out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mic.model.assembly import assemble
from mic.process.description import sentences
from verification.shell_contact.case import LEVELS, Case
from verification.shell_contact.converged import Converged

__all__ = ["page", "row"]

RULES = "Conventions, law, stages, and how the uncertainty was found: [all cases](../../README.md)."
LEGEND = "Supports black, clamps red, welds violet, probes green, rigid bodies as circles."
FILES = (
    "`case.json` and `mesh.inp` hold all of this as plain data, `values.csv` the values on all three meshes, "
    "`problem.hdf5` the contact problem of the last stage that ends in contact, on the coarse mesh (FCLIB)."
)


def page(case: Case, values: Sequence[Converged], cache: Path) -> str:
    """Markdown: geometry in words, tables of all that is given, the process step by step, values ± uncertainty."""
    scene = assemble(case.scene("coarse"), cache).scene
    title, _, words = case.text.partition("\n")
    tables = [
        (
            "Sheets",
            ("name", "thickness, mm", "E, MPa", "ν"),
            [(p.name, p.thickness, p.young, p.poisson) for p in scene.parts],
        ),
        (
            "Rigid bodies",
            ("name", "through, mm", "outward normal"),
            [(f.name, f.point, f.normal) for f in scene.fixtures],
        ),
        (
            "Supports",
            ("name", "sheet", "centre, mm", "direction", "radius, mm", "stiffness, N/mm"),
            [(s.name, s.part, s.point, s.direction, s.radius, s.stiffness or "rigid") for s in scene.locators],
        ),
        (
            "Clamps",
            ("name", "sheet", "centre, mm", "direction", "radius, mm", "pushes"),
            [(c.name, c.part, c.point, c.direction, c.radius, _push(c)) for c in scene.clamps],
        ),
        (
            "Welds",
            ("name", "joins", "centre, mm", "radius, mm", "gap"),
            [(w.name, w.parts, w.point, w.radius, "closed first" if w.close else "as found") for w in scene.welds],
        ),
        ("Contact", ("zone", "between", "μ", "within the box, mm"), [_zone(z) for z in scene.zones]),
        (
            "Probes",
            ("name", "sheet", "centre, mm", "direction", "radius, mm"),
            [(m.name, m.part, m.point, m.direction, m.radius) for m in scene.measurements],
        ),
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
    columns = ("quantity", "value", *LEVELS, "order", "path")
    known = [row(one) for one in values if one.known]
    lines = [f"Elements and candidates for contact: {sizes}.", "", *_table(columns, known)]
    others = [row(one) for one in values if not one.known]
    if others:
        lines += ["", "Not to be compared with, for these meshes leave more than a quarter of them open:", ""]
        lines += _table(columns, others)
    return lines


def row(one: Converged) -> tuple[str, ...]:
    """A quantity as the page tells it: name, value ± uncertainty, the three meshes, order, path."""
    digits = max(0, 1 - int(np.floor(np.log10(max(one.uncertainty, 1e-9)))))
    value = f"{one.value:.{digits}f} ± {one.uncertainty:.{digits}f}"
    order = "" if np.isnan(one.order) else f"{one.order:.1f}"
    levels = (f"{level:.{digits + 1}f}" for level in one.levels)
    return f"{one.name}, {one.unit}", f"**{value}**" if one.known else value, *levels, order, f"{one.path:.1g}"


def _push(clamp) -> str:
    if clamp.force is not None:
        return f"{clamp.force:g} N"
    return f"to {clamp.stroke:g} mm" + (f", with at most {clamp.limit:g} N" if clamp.limit else "")


def _zone(zone) -> tuple:
    friction = zone.friction
    told = ", ".join(f"{stage} {mu:g}" for stage, mu in friction.items()) if isinstance(friction, dict) else friction
    box = "everywhere" if zone.box is None else " to ".join(_cell(corner) for corner in zone.box)
    return zone.name, zone.parts, told, box


def _table(columns: Sequence[str], rows: Sequence[Sequence]) -> list[str]:
    made = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
    return made + ["| " + " | ".join(_cell(one) for one in row) + " |" for row in rows]


def _cell(value) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, tuple | list | np.ndarray):
        return ", ".join(_cell(one) for one in value)
    return f"{round(float(value), 6) + 0.0:.6g}"
