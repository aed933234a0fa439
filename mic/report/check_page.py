"""The page of a check: the assembly with all placed items, a gap map, and warnings."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs

from mic.errors import Problems
from mic.geometry.load import fixture_surface
from mic.geometry.surface import Surface
from mic.model.assembly import Contacts
from mic.model.one_sigma import SourceShape
from mic.plausibility import SceneWarning, validity
from mic.process.description import opening, sentences
from mic.process.plan import StagePlan
from mic.report.source_pictures import draw_shapes
from mic.report.style import MARK_COLOURS, number
from mic.report.template import render
from mic.report.viewer_data import drawable, packed, view
from mic.scene import Scene
from mic.scene.deviation import ClampDeviation, LocatorDeviation
from mic.system.files import write_text

__all__ = ["write_check"]

RED = "#d00000"
DRAWN = 0.01  # mm: smaller overlaps come from drawing and meshing, and are shown as touching
ALIKE = 0.01  # of the assembly: closer warnings share a ring
LEAST = 0.05  # mm: least range of the gap map


def write_check(
    path: str | PathLike[str],
    scene: Scene,
    surfaces: Mapping[str, Surface],
    warnings: Sequence[SceneWarning] = (),
    contacts: Contacts | None = None,
    plans: Sequence[StagePlan] = (),
    errors: Sequence[str] = (),
    shapes: Sequence[SourceShape] = (),
) -> Path:
    """Write the page of a check; nothing is solved.

    Parameters
    ----------
    path : path-like
        The page, one file that needs no other.
    scene : Scene
    surfaces : dict of str to Surface
        Of the parts that could be had, by name.
    warnings : sequence of SceneWarning
    contacts : Contacts, optional
        Without them, the pairs are not drawn.
    plans : sequence of StagePlan
    errors : sequence of str
        Why the scene is not valid.
    shapes : sequence of SourceShape
        What 1 σ of each source does, as far as it is known.

    Returns
    -------
    Path
    """
    bodies = dict(surfaces)
    for fixture in scene.fixtures:
        with Problems():  # an unreadable one has been reported
            if fixture.part is None:  # placed by its part's mesh otherwise
                bodies[fixture.name] = fixture_surface(fixture, scene.folder)
    path = Path(path)
    page = render(
        "check.html",
        scene=scene,
        errors=errors,
        warnings=warnings,
        zones=_zones(scene, contacts) if contacts is not None else [],
        plans=[
            (plan, opening(plan, contacts is not None and len(contacts) > 0), sentences(scene, plan)) for plan in plans
        ],
        verdict=validity(warnings, errors),
        shapes=draw_shapes(surfaces, shapes) if shapes else None,
        largest={shape.name: f"{number(shape.largest[2])} mm" for shape in shapes},
        viewer=packed(json.dumps(_view(bodies, scene, warnings, contacts))) if bodies else None,
        plotly=packed(get_plotlyjs()) if bodies else None,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, page)
    return path


def _view(bodies, scene: Scene, warnings, contacts: Contacts | None) -> dict[str, Any]:
    """The view of the assembly with labelled items, gap map and numbered warnings."""
    data = view(bodies, scene)
    varied = _varied(scene)
    labels = {
        item.name: f"{kind} {item.name}{words}{varied.get((kind, item.name), '')}"
        for kind, items in (("locator", scene.locators), ("clamp", scene.clamps))
        for item in items
        for words in [_acts(item)]
    }
    for group in data["arrows"]:
        for arrow in group["items"]:
            arrow["label"] = labels[arrow["name"]]
    forces = [item for item in scene.deviations if item.kind == "force" and drawable(item)]
    if forces:
        data["arrows"].append(
            {
                "name": "corrective forces",
                "colour": MARK_COLOURS["force"],
                "items": [
                    {
                        "name": item.name,
                        "head": item.point,
                        "direction": item.direction,
                        "label": f"force {item.name} on {item.part}: {item.mean:g} ± {item.sigma:g} N",
                    }
                    for item in forces
                ],
            }
        )
    for group in data["points"]:
        group["labels"] = [f"{group['name'].removesuffix('s')} {label}" for label in group["labels"]]
    if contacts is not None and len(contacts):
        value = np.where(contacts.overlap > DRAWN, -contacts.overlap, contacts.gap)
        low, high = float(min(value.min(), 0.0)), float(max(value.max(), LEAST))
        data["map"] = {
            "scale": "RdBu_r" if low < 0 else "viridis",
            "low": -max(-low, high) if low < 0 else 0.0,
            "high": max(-low, high),
            "title": "gap (mm)" + ", overlap below 0" * (low < 0),
        }
        own = {zone.name: np.flatnonzero(contacts.zone == i) for i, zone in enumerate(scene.zones)}
        maps = [_map(name, pairs, contacts, value) for name, pairs in own.items() if len(pairs)]
        maps[0]["first"] = True
        data["points"] = maps + data["points"]
    if any(warned.point is not None for warned in warnings):
        data["points"].append(_numbered(warnings, ALIKE * float(np.linalg.norm(np.ptp(data["range"], axis=1)))))
    return data


def _numbered(warnings: Sequence[SceneWarning], near: float) -> dict[str, Any]:
    """Rings with the numbers of warnings that have a place; close ones share a ring."""
    rings: list[tuple[Any, list[int]]] = []
    for i, warned in enumerate(warnings, 1):
        if warned.point is not None:
            at = next((own for point, own in rings if np.linalg.norm(np.subtract(point, warned.point)) <= near), None)
            if at is None:
                rings.append((warned.point, [i]))
            else:
                at.append(i)
    return {
        "name": "warnings",
        "colour": RED,
        "symbol": "circle-open",
        "size": 14,
        "points": [point for point, _ in rings],
        "numbers": [f"<b>{', '.join(map(str, own))}</b>" for _, own in rings],
        "labels": ["<br>".join(f"{i}. {warnings[i - 1].item}" for i in own) for _, own in rings],
    }


def _map(zone: str, own, contacts: Contacts, value) -> dict[str, Any]:
    """A zone's pairs, coloured by their gap."""
    return {
        "name": f"{zone}: gap",
        "colour": "#808080",
        "size": 3.5,
        "first": False,
        "points": contacts.point[own].round(3).tolist(),
        "values": value[own].round(4).tolist(),
        "labels": [
            f"{zone}, pair {k}: " + (f"gap {value[k]:.3g} mm" if value[k] >= 0 else f"overlap {-value[k]:.3g} mm")
            for k in own
        ],
    }


def _acts(item) -> str:
    """Part, amount and stage of an item."""
    force, stroke = getattr(item, "force", None), getattr(item, "stroke", None)
    amount = f", {force:g} N" if force is not None else f", to {stroke:g} mm" if stroke is not None else ""
    return f" on {item.part}{amount}, stage {item.stage}"


def _varied(scene: Scene) -> dict[tuple[str, str], str]:
    """Deviations of locators and clamps, by kind and name."""
    return {
        (item.kind, name): f", {item.name}: {item.mean:g} ± {item.sigma:g}"
        for item in scene.deviations
        if isinstance(item, LocatorDeviation | ClampDeviation)
        for name in ([item.target] if isinstance(item.target, str) else item.target)
    }


def _zones(scene: Scene, contacts: Contacts) -> Iterator[dict[str, Any]]:
    """Number, area, gap and overlap of the pairs of each zone."""
    for i, zone in enumerate(scene.zones):
        own = contacts.zone == i
        if own.any():
            yield {
                "name": zone.name,
                "parts": " – ".join(zone.parts),
                "pairs": int(own.sum()),
                "area": number(float(contacts.area[own].sum())),
                "gap": f"{contacts.gap[own].min():.3f} … {contacts.gap[own].max():.3f}",
                "overlap": number(float(contacts.overlap[own].max())),
            }
