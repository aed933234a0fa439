"""A case as plain data for any code: the coarse mesh as an Abaqus and CalculiX deck, everything else as JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from mic.model.assembly import assemble
from mic.process.actions import Action, Close, Join, Open, PlaceParts
from mic.process.description import sentences
from verification.shell_contact.case import Case

__all__ = ["data", "mesh"]


def mesh(case: Case, cache: Path) -> str:
    """Input deck with the middle surfaces; element set, material and section for each part."""
    assembly = assemble(case.scene("coarse"), cache)
    lines, first, element = ["** mm, N, MPa; middle surfaces", "*NODE"], 1, 1
    elements, sections = [], []
    for part in assembly.scene.parts:
        surface, name = assembly.surfaces[part.name], part.name.upper()
        lines += [f"{first + i}, " + ", ".join(f"{x:.9g}" for x in xyz) for i, xyz in enumerate(_clean(surface.points))]
        elements.append(f"*ELEMENT, TYPE=S3, ELSET={name}")
        for triangle in (surface.triangles + first).tolist():
            elements.append(", ".join(map(str, [element, *triangle])))
            element += 1
        first += len(surface.points)
        sections += [f"*MATERIAL, NAME={name}", "*ELASTIC", f"{part.young:g}, {part.poisson:g}"]
        sections += [f"*SHELL SECTION, ELSET={name}, MATERIAL={name}", f"{part.thickness:g}"]
    return "\n".join([*lines, *elements, *sections]) + "\n"


def data(case: Case, cache: Path) -> str:
    """Everything else, as JSON: sheets, rigid bodies, supports, clamps, welds, contact, stages and probes."""
    scene = assemble(case.scene("coarse"), cache).scene
    place = ("name", "part", "point", "direction", "radius")
    content = {
        "name": scene.name,
        "description": scene.description,
        "units": "mm, N, MPa",
        "mesh": "mesh.inp",
        "sheets": [_taken(one, ("name", "thickness", "young", "poisson")) for one in scene.parts],
        "rigid": [_taken(one, ("name", "point", "normal", "radius")) for one in scene.fixtures],
        "supports": [_taken(one, (*place, "stiffness")) for one in scene.locators],
        "clamps": [_taken(one, (*place, "force", "stroke", "limit")) for one in scene.clamps],
        "welds": [_taken(one, ("name", "parts", "point", "radius", "close")) for one in scene.welds],
        "contact": [_taken(one, ("name", "parts", "friction", "box")) for one in scene.zones],
        "stages": [
            {
                "name": plan.name,
                "steps": [step for step in (_step(scene, one.move) for one in plan.steps) if step],
                "in_words": sentences(scene, plan),
            }
            for plan in case.plans(cache)
        ],
        "probes": [_taken(one, place) for one in scene.measurements],
    }
    text = json.dumps(content, indent=1)
    # each list of numbers or names on one line
    return re.sub(r"\[\s+([^\[\]{}]*?)\s+\]", lambda found: "[" + re.sub(r"\n\s+", " ", found[1]) + "]", text) + "\n"


def _taken(item, keys: Iterable[str]) -> dict:
    """The given keys that an item states."""
    values = {key: getattr(item, key) for key in keys}
    return {key: _plain(value) for key, value in values.items() if value is not None}


def _plain(value):
    if isinstance(value, np.ndarray | tuple | list):
        return [_plain(one) for one in value]
    return float(_clean(value)) if isinstance(value, float | np.floating) else value


def _step(scene, move: Iterable[Action]) -> dict:
    """Names of the items that close and open in a step."""
    closes, opens, welds = [], [], []
    for one in move:
        if isinstance(one, PlaceParts):
            closes += [scene.locators[i].name for i in one.locators]
        elif isinstance(one, Close):
            closes += [scene.locators[i].name for i in one.locators] + [scene.clamps[i].name for i in one.clamps]
        elif isinstance(one, Open):
            opens += [scene.clamps[i].name for i in one.clamps] + [scene.locators[i].name for i in one.locators]
        elif isinstance(one, Join):
            welds += [scene.welds[i].name for i in one.welds]
    return {key: names for key, names in (("closes", closes), ("opens", opens), ("welds", welds)) if names}


def _clean(value):
    """Rounded to a picometre, without negative zeros."""
    return np.round(value, 9) + 0.0
