"""The page of a check: the assembly with all placed items, a gap map, and warnings."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mic.errors import Problems
from mic.geometry.load import load_fixture
from mic.geometry.surface import Surface
from mic.model.assembly import Contacts
from mic.model.one_sigma import SourceShape
from mic.plausibility import SceneWarning, validity
from mic.process.description import opening, sentences
from mic.process.plan import StagePlan
from mic.report.source_pictures import draw_shapes
from mic.report.space_pictures import draw_assembly
from mic.report.style import MARK_COLOURS, number
from mic.report.template import render
from mic.report.viewer_data import arrow_group, packed, plotly_script, point_group, view
from mic.scene import Scene
from mic.scene.deviation import ClampDeviation, LocatorDeviation, targets

__all__ = ["check_page"]

RED = "#d00000"
DRAWN = 0.01  # mm: smaller overlaps come from drawing and meshing, and are shown as touching
ALIKE = 0.01  # of the assembly: closer warnings share a ring
LEAST = 0.05  # mm: least range of the gap map


def check_page(
    scene: Scene,
    surfaces: Mapping[str, Surface],
    warnings: Sequence[SceneWarning] = (),
    contacts: Contacts | None = None,
    plans: Sequence[StagePlan] = (),
    errors: Sequence[str] = (),
    shapes: Sequence[SourceShape] = (),
) -> str:
    """The page of a check, one file that needs no other; nothing is solved.

    Parameters
    ----------
    scene : Scene
    surfaces : dict of str to Surface
        Surfaces of the readable parts, by name.
    warnings : sequence of SceneWarning
    contacts : Contacts, optional
        Default: no pairs are drawn.
    plans : sequence of StagePlan
    errors : sequence of str
        Reasons why the scene is not valid.
    shapes : sequence of SourceShape
        Displacement by 1 σ of each source, as far as it is known.
    """
    bodies = dict(surfaces)
    for fixture in scene.fixtures:
        with Problems():  # an unreadable one has been reported
            if fixture.part is None:  # placed by its part's mesh otherwise
                bodies[fixture.name] = load_fixture(fixture, scene.folder)[0]
    touching = contacts is not None and len(contacts) > 0
    return render(
        "check.html",
        scene=scene,
        errors=errors,
        warnings=warnings,
        contacts=contacts,
        plans=[(plan, opening(plan, touching), sentences(scene, plan)) for plan in plans],
        verdict=validity(warnings, errors),
        shapes=draw_shapes(surfaces, shapes) if shapes else None,
        largest={shape.name: f"{number(shape.largest[2])} mm" for shape in shapes},
        still=draw_assembly(bodies, scene, contacts if touching else None) if bodies else None,
        viewer=packed(json.dumps(_view(bodies, scene, warnings, contacts if touching else None))) if bodies else None,
        plotly=plotly_script() if bodies else None,
    )


def _view(bodies, scene: Scene, warnings, contacts: Contacts | None) -> dict[str, Any]:
    """The view of the assembly with labelled items, gap map and numbered warnings."""
    varied = _varied(scene)
    data = view(bodies, scene, lambda kind, item: f"{kind} {item.name}{_acts(item)}{varied.get((kind, item.name), '')}")
    forces = [item for item in scene.deviations if item.kind == "force"]
    force = lambda kind, item: f"force {item.name} on {item.part}: {item.mean:g} ± {item.sigma:g} N"
    data["arrows"] += arrow_group("corrective force", MARK_COLOURS["force"], forces, force)
    for group in data["points"]:
        group["labels"] = [f"{group['name'].removesuffix('s')} {label}" for label in group["labels"]]
    if contacts is not None:
        value = np.where(contacts.overlap > DRAWN, -contacts.overlap, contacts.gap)
        low, high = float(min(value.min(), 0.0)), float(max(value.max(), LEAST))
        data["map"] = {
            "scale": "RdBu_r" if low < 0 else "viridis",
            "low": -max(-low, high) if low < 0 else 0.0,
            "high": max(-low, high),
            "title": "gap (mm)" + ", overlap below 0" * (low < 0),
        }
        maps = _maps(scene, contacts, value)
        maps[0]["first"] = True
        data["points"] = maps + data["points"]
    data["points"] += _numbered(warnings, ALIKE * float(np.linalg.norm(np.ptp(data["range"], axis=1))))
    return data


def _numbered(warnings: Sequence[SceneWarning], near: float) -> list[dict[str, Any]]:
    """Rings with the numbers of warnings that have a place; close ones share a ring."""
    rings: list[tuple[Any, list[int]]] = []
    for i, warned in enumerate(warnings, 1):
        if warned.point is not None:
            at = [own for point, own in rings if np.linalg.norm(np.subtract(point, warned.point)) <= near]
            if at:
                at[0].append(i)
            else:
                rings.append((warned.point, [i]))
    numbers = [f"<b>{', '.join(map(str, own))}</b>" for _, own in rings]
    labels = ["<br>".join(f"{i}. {warnings[i - 1].item}" for i in own) for _, own in rings]
    points = [point for point, _ in rings]
    return point_group("warnings", RED, 14, points, labels, symbol="circle-open", numbers=numbers)


def _maps(scene: Scene, contacts: Contacts, value: np.ndarray) -> list[dict[str, Any]]:
    """The pairs of each zone, coloured by their gap."""
    groups: list[dict[str, Any]] = []
    for i, zone in enumerate(scene.zones):
        own = np.flatnonzero(contacts.zone == i)
        words = [f"gap {value[k]:.3g} mm" if value[k] >= 0 else f"overlap {-value[k]:.3g} mm" for k in own]
        labels = [f"{zone.name}, pair {k}: {text}" for k, text in zip(own, words)]
        shades = {"values": value[own].round(4).tolist(), "first": False}
        points = contacts.point[own].round(3).tolist()
        groups += point_group(f"{zone.name}: gap", "#808080", 3.5, points, labels, **shades)
    return groups


def _acts(item) -> str:
    """Part, amount and stage of a locator or clamp."""
    force, stroke = getattr(item, "force", None), getattr(item, "stroke", None)
    amount = f", {force:g} N" if force is not None else f", to {stroke:g} mm" if stroke is not None else ""
    return f" on {item.part}{amount}, stage {item.stage}"


def _varied(scene: Scene) -> dict[tuple[str, str], str]:
    """Deviations of locators and clamps, by kind and name."""
    return {
        (item.kind, name): f", {item.name}: {item.mean:g} ± {item.sigma:g}"
        for item in scene.deviations
        if isinstance(item, LocatorDeviation | ClampDeviation)
        for name in targets(item)
    }
