"""Display of a scene and its reduced model in notebooks: a few lines of text, and HTML with a picture.

The picture is SVG written by hand: it needs no meshes, which a saved model does not carry, and no drawing library.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from html import escape
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from mic.scene.deviation import deviation_unit

__all__ = ["html", "lines"]

NAMES, LETTERS = 6, 120  # in a line
WIDTH, HEIGHT, MARGIN = 640.0, 400.0, 40.0  # of the picture
TILT = np.radians(55)  # of the assembly's plane to the line of sight
DOTS = 2000  # contact pairs in the picture, evenly chosen
ROWS = 20  # of a table
COLOURS = ("#5b8db8", "#c79a3a", "#6a9a58", "#9a6b9e", "#b8705f", "#4f9996")  # parts, zones


def named(items: Collection[Any], singular: str, words: Iterable[str] | None = None) -> str:
    """Their number and first names, as ``3 parts: a, b, c``; `words` stand for the names."""
    shown = [item.name for item in items] if words is None else list(words)
    more = ", …" if len(shown) > NAMES else ""
    number = f"{len(items)} {singular}{'s' * (len(items) != 1)}"
    return number + (f": {', '.join(shown[:NAMES])}{more}" if shown else "")


def lines(scene: Any, kind: str, contacts: str) -> list[str]:
    """The five lines of a scene or model.

    Parameters
    ----------
    scene : mic.scene.Scene
    kind : str
        Name of the class.
    contacts : str
        What is known of the contacts.
    """
    about = " ".join(scene.description.split())
    units = [(item.name, deviation_unit(item, scene)) for item in scene.deviations]
    fixture = [(scene.locators, "locator"), (scene.clamps, "clamp"), (scene.welds, "weld")]
    stages = [stage.name for stage in scene.stages]
    found = [
        f"{kind} {scene.name!r}{': ' * bool(about)}{about}",
        f"  {named(scene.parts, 'part')}; " + ", ".join(named(items, word, ()) for items, word in fixture),
        f"  {contacts}; stages: {', '.join(stages[:NAMES])}{', …' * (len(stages) > NAMES)}",
        f"  {named(units, 'deviation', (f'{name} ({unit})' if unit else name for name, unit in units))}",
        f"  {named(scene.measurements, 'key characteristic')}; contact laws: {', '.join(scene.report.laws)}",
    ]
    return [line if len(line) <= LETTERS else line[: LETTERS - 1] + "…" for line in found]


def html(scene: Any, text: list[str], pairs: Mapping[str, np.ndarray] | None = None) -> str:
    """A heading, the picture, and tables of deviations and key characteristics.

    Parameters
    ----------
    scene : mic.scene.Scene
    text : list of str
        Of :func:`lines`.
    pairs : mapping of str to (m, 3) array, optional
        Points of the contact pairs by zone, mm.
    """
    import pandas as pd  # not needed to evaluate a model

    deviations = [(d.name, d.kind, d.mean, d.sigma, deviation_unit(d, scene)) for d in scene.deviations]
    measured = [(m.name, m.part, *m.bounds) for m in scene.measurements]
    tables = [
        pd.DataFrame(rows, columns=columns).to_html(index=False, border=0, max_rows=ROWS, float_format="{:g}".format)
        for rows, columns in (
            (deviations, ["deviation", "kind", "mean", "sigma", "unit"]),
            (measured, ["key characteristic", "part", "lower (mm)", "upper (mm)"]),
        )
        if rows
    ]
    head = f"<b>{escape(text[0])}</b><br>" + "<br>".join(escape(line.strip()) for line in text[1:])
    style = "display:flex;flex-wrap:wrap;gap:1.5em;align-items:flex-start"
    return f'<div>{head}<div style="{style}">{_figure(scene, pairs or {})}<div>{"<br>".join(tables)}</div></div></div>'


def _figure(scene: Any, pairs: Mapping[str, np.ndarray]) -> str:
    """The picture with its legend; empty if no place is known yet."""
    placed = [item for item in (*scene.locators, *scene.clamps) if item.point is not None]
    welds = [weld for weld in scene.welds if weld.point is not None]
    measured = [(item.name, *place) for item in scene.measurements for place in item.places]
    on_part: dict[str, list[Any]] = {part.name: [] for part in scene.parts}
    owned = [(owner, item.point) for item in placed for owner in getattr(item, "owners", None) or [item.part]]
    owned += [(name, weld.point) for weld in welds for name in weld.parts]
    owned += [(part, point) for _, part, point in measured]
    owned += [(name, p) for zone in scene.zones for name in zone.parts for p in pairs.get(zone.name, ())]
    for owner, point in owned:
        on_part.setdefault(owner, []).append(point)
    if len(owned) < 3:
        return ""
    view = _View(np.array([point for _, point in owned], dtype=float))
    marks, legend = [], []

    def mark(kind: str, letter: str, colour: str, shapes: list[str]) -> None:
        if shapes:
            marks.extend(shapes)
            sign = f'<span style="color:{colour}">{letter}</span>'
            legend.append(f'<span style="white-space:nowrap">{sign} {escape(kind)}</span>')

    for i, (name, points) in enumerate(on_part.items()):
        mark(name, "■", COLOURS[i % len(COLOURS)], _hull(name, view.flat(points), COLOURS[i % len(COLOURS)]))
    for i, (name, places) in enumerate(pairs.items()):
        colour = COLOURS[::-1][i % len(COLOURS)]
        shown = view.flat(places[:: -(-len(places) // DOTS) or 1])
        path = "".join(f"M{x:.0f} {y:.0f}h0" for x, y in shown)
        dots = f'<path d="{path}" stroke="{colour}" stroke-width="5" stroke-linecap="round">{_title(name)}</path>'
        mark(f"{name}: {len(places)} contact pairs", "●", colour, [dots] * bool(len(places)))
    for kind, items, colour in (("locators", scene.locators, "#3d4957"), ("clamps", scene.clamps, "#c1121f")):
        shapes = [view.arrow(item.point, item.direction, colour, item.name) for item in items if item in placed]
        mark(kind, "▲", colour, shapes)
    ring = 'r="6" fill="none" stroke="#b07d00" stroke-width="2.5"'
    mark("welds", "○", "#b07d00", [view.circle(weld.point, ring, weld.name) for weld in welds])
    dot = 'r="4" fill="#ffffff" stroke="#1f4e9c" stroke-width="2"'
    mark("measurements", "○", "#1f4e9c", [view.circle(point, dot, name) for name, _, point in measured])
    for name, _, point in {name: (name, part, point) for name, part, point in measured[::-1]}.values():
        x, y = view.flat([point])[0] - [0, 7]
        side = 'text-anchor="end" dx="-6"' if x > 0.8 * WIDTH else 'dx="6"'
        marks.append(f'<text x="{x:.0f}" y="{y:.0f}" {side} font-size="12" fill="currentColor">{escape(name)}</text>')
    label = f"{escape(scene.name)}: parts, fixture, welds, contact pairs and measurements"
    size = f'viewBox="0 0 {WIDTH:.0f} {view.height:.0f}" width="{WIDTH:.0f}" style="max-width:100%"'
    svg = f'<svg {size} role="img" aria-label="{label}">{"".join(marks)}</svg>'
    caption = "&ensp; ".join(legend) + "<br>Each part is drawn as the hull of these points, not by its outline."
    return f'<figure style="margin:0;max-width:{WIDTH:.0f}px">{svg}<figcaption>{caption}</figcaption></figure>'


class _View:
    """Oblique parallel projection of points (n, 3), whose plane of largest extent is tilted."""

    def __init__(self, points: np.ndarray):
        axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
        along, across, normal = (axis * np.sign(axis[np.abs(axis).argmax()]) for axis in axes)
        across = across * np.sign(np.linalg.det([along, across, normal]))
        self.axes = np.column_stack([along, -np.sin(TILT) * across - np.cos(TILT) * normal])
        low, high = (points @ self.axes).min(axis=0), (points @ self.axes).max(axis=0)
        size = np.maximum(high - low, 1e-9)
        self.scale = min((WIDTH - 2 * MARGIN) / size[0], (HEIGHT - 2 * MARGIN) / size[1])
        self.height = size[1] * self.scale + 2 * MARGIN
        self.shift = np.array([(WIDTH - size[0] * self.scale) / 2, MARGIN]) - low * self.scale

    def flat(self, points: Any) -> np.ndarray:
        """(n, 2) places in the picture of points (n, 3)."""
        return np.reshape(points, (-1, 3)) @ self.axes * self.scale + self.shift

    def circle(self, point: Any, style: str, name: str) -> str:
        """A circle with its name as tooltip."""
        x, y = self.flat(point)[0]
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" {style}>{_title(name)}</circle>'

    def arrow(self, point: Any, direction: Any, colour: str, name: str) -> str:
        """An arrow whose head is at the point; only its head if the direction is relative or along the view."""
        head = self.flat(point)[0]
        way = np.array([0.0, -1.0]) if isinstance(direction, str) else np.asarray(direction) @ self.axes
        length = float(np.linalg.norm(way))
        way = way / length if length > 1e-6 else np.array([0.0, -1.0])
        side, tail = np.array([-way[1], way[0]]), head - 24 * min(length, 1.0) * way
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in (head, head - 9 * way + 4 * side, head - 9 * way - 4 * side))
        return (
            f'<g stroke="{colour}" fill="{colour}">{_title(name)}<polygon points="{corners}"/><line x1="{tail[0]:.1f}" '
            f'y1="{tail[1]:.1f}" x2="{head[0]:.1f}" y2="{head[1]:.1f}" stroke-width="2"/></g>'
        )


def _hull(name: str, points: np.ndarray, colour: str) -> list[str]:
    """The convex hull of points in the picture; nothing if they are on a line."""
    try:
        corners = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return []
    text = " ".join(f"{x:.0f},{y:.0f}" for x, y in corners)
    style = f'fill="{colour}" stroke="{colour}" stroke-width="14" stroke-linejoin="round" opacity="0.28"'
    return [f'<polygon points="{text}" {style}>{_title(name)}</polygon>']


def _title(name: str) -> str:
    """Tooltip of a mark."""
    return f"<title>{escape(name)}</title>"
