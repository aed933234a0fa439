"""Three-dimensional pictures: assembly with fixture, variation, displacement fields, normals, overlap."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Sized
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import TriMesh
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.tri import Triangulation

from mic.geometry.normals import Rule
from mic.geometry.surface import Surface
from mic.model.assembly import Contacts
from mic.report.context import Context
from mic.report.mesh_decimation import MOST, thinned
from mic.report.picture import MOST_PANELS, Picture, panels, png, wide
from mic.report.style import MARK_COLOURS, RULE_COLOURS, RULE_WORDS, number, part_colour, zone_colour
from mic.results.outcome import Outcome
from mic.scene import Scene

__all__ = [
    "ARROW",
    "assembly_picture",
    "draw_assembly",
    "draw_fields",
    "draw_normals",
    "draw_overlap",
    "draw_surfaces",
    "field_picture",
    "overview_picture",
    "viewpoint",
]

ARROW = 0.07  # length of the arrow of a locator or clamp, as a share of the largest part
INK = "#1b1f24"
#: Marks of edges in the picture of the normals, by attribute of :class:`mic.geometry.normals.CornerNormals`.
DOUBTFUL = (("coarse", "x", "bends too coarse"), ("single", "+", "rows that may be flat"))


def viewpoint(surfaces: Collection[Surface]) -> np.ndarray:
    """(3,) unit vector towards the octant from which the largest projected area is visible."""
    normal = np.concatenate([surface.normals * surface.areas[:, None] for surface in surfaces])
    corners = [
        np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
        for a in np.radians([-60, -30, 30, 60, 120, 150, 210, 240])
        for e in np.radians([20, 40])
    ]
    return max(corners, key=lambda d: float(np.abs(normal @ d).sum()))


class _View:
    """Orthographic view of the parts from their :func:`viewpoint`, each decimated to `most` vertices."""

    def __init__(self, surfaces: Collection[Surface], most: int = MOST):
        self.surfaces, self.most = tuple(surfaces), most
        self.eye = viewpoint(self.surfaces)
        right = np.cross([0, 0, 1.0], self.eye)
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.eye, self.right)

    def flat(self, points: np.ndarray) -> np.ndarray:
        """(n, 2) projections of (n, 3) points."""
        return np.column_stack([points @ self.right, points @ self.up])

    def draw(self, ax: Axes, colours: Sequence[np.ndarray], shading: float) -> None:
        """Triangles of all surfaces, far ones first.

        Parameters
        ----------
        colours : sequence of (3,) or (v, 3) arrays
            Red, green and blue from 0 to 1: one per surface, or one per vertex of it.
        shading : float
            Share of their brightness that depends on the slope.
        """
        light = self.eye + 0.35 * self.up - 0.45 * self.right
        light /= np.linalg.norm(light)
        kept, corners = zip(*(thinned(surface, self.most) for surface in self.surfaces))
        start = np.cumsum([0, *map(len, kept)])
        points = np.concatenate([surface.points[own] for surface, own in zip(self.surfaces, kept)])
        triangles = np.concatenate([own + first for own, first in zip(corners, start)])
        bright = [1 - shading + shading * np.abs(s.vertex_normals[own] @ light) for s, own in zip(self.surfaces, kept)]
        shown = [colour[own] if colour.ndim == 2 else colour for colour, own in zip(colours, kept)]
        rgb = np.concatenate([colour * share[:, None] for colour, share in zip(shown, bright)])
        order = np.argsort((points @ self.eye)[triangles].mean(axis=1))
        x, y = self.flat(points).T
        mesh = TriMesh(Triangulation(x, y, triangles[order]))
        rgba: Any = np.column_stack([rgb.clip(0, 1), np.ones(len(rgb))])  # an array, unknown to the type stubs
        mesh.set_facecolor(rgba)
        ax.add_collection(mesh, autolim=False)  # autolim would visit every triangle
        ax.update_datalim(np.column_stack([x, y]))
        ax.autoscale_view()
        ax.set_aspect("equal")
        ax.set_axis_off()


def draw_surfaces(ax: Axes, surfaces: Sequence[Surface], colours: Sequence[np.ndarray]) -> None:
    """Surfaces from their best viewpoint; one colour (3,) each, or one at every vertex (v, 3)."""
    _View(surfaces).draw(ax, colours, 0.2)


def draw_fields(
    surfaces: Mapping[str, Surface], rows: Sequence[tuple[str, str, Mapping[str, np.ndarray]]], signed: bool = False
) -> tuple[Figure, list[tuple[float, str]]]:
    """Rows of parts, coloured by their fields.

    Parameters
    ----------
    surfaces : dict of str to Surface
    rows : sequence of (str, str, dict of str to (v,) array)
        Quantity, colour map, and values in mm at the vertices of each part.
    signed : bool
        Whether 0 is the middle of the scale and not its lower end.

    Returns
    -------
    figure : Figure
    largest : list of (float, str)
        The value of largest magnitude in each row, and where it is.
    """
    fig, axes = wide(7.2, len(rows), len(rows[0][2]), squeeze=False)
    largest = []
    for row, (quantity, cmap, values) in zip(axes, rows):
        size = {part: np.nan_to_num(np.abs(value)) for part, value in values.items()}
        part = max(size, key=lambda name: size[name].max())
        vertex = int(np.argmax(size[part]))
        x, y, z = surfaces[part].points[vertex]
        largest.append((float(values[part][vertex]), f"{part} at ({x:.0f}, {y:.0f}, {z:.0f})"))
        top = float(size[part][vertex]) or 1.0
        scale = Normalize(-top if signed else 0.0, top)
        for ax, (name, value) in zip(row, values.items()):
            draw_surfaces(ax, [surfaces[name]], [colormaps[cmap](scale(np.nan_to_num(value)))[:, :3]])
            ax.set_title(name)
        fig.colorbar(ScalarMappable(scale, cmap), ax=list(row), label=f"{quantity} (mm)", shrink=0.8)
    return fig, largest


def assembly_picture(outcome: Outcome, context: Context) -> Picture | None:
    """The parts with locators, clamps, welds, contact pairs and measurement points."""
    return draw_assembly(context.surfaces, outcome.model.scene, outcome.model.contacts) if context.surfaces else None


def draw_assembly(surfaces: Mapping[str, Surface], scene: Scene, contacts: Contacts | None) -> Picture:
    """Surfaces with the items of a scene, as far as they are placed, and its contact pairs, if any."""
    view = _View(surfaces.values())
    fig, ax = wide(6.6)
    view.draw(ax, [np.array(to_rgb(part_colour(i))) for i in range(len(surfaces))], 0.5)
    handles = [
        Line2D([], [], marker="s", ls="", ms=9, color=part_colour(i), label=name) for i, name in enumerate(surfaces)
    ]
    for z, zone in enumerate(scene.zones):
        own = view.flat(np.zeros((0, 3)) if contacts is None else contacts.point[contacts.zone == z])
        if len(own):
            ax.plot(*own.T, "o", ms=4, mew=0.3, mec="white", color=zone_colour(z))
            label = f"{zone.name}: {len(own)} pairs"
            handles.append(Line2D([], [], marker="o", ls="", ms=6, color=zone_colour(z), label=label))
    length = ARROW * max(surface.diameter for surface in surfaces.values())
    placed = {
        kind: [item for item in items if item.point is not None and not isinstance(item.direction, str)]
        for kind, items in (("locator", scene.locators), ("clamp", scene.clamps))
    }
    for kind, items in placed.items():
        for item in items:
            _arrow(ax, view, item, length, MARK_COLOURS[kind])
        if items:
            label = f"{kind} ({len(items)})"
            handles.append(Line2D([], [], marker=">", ls="-", ms=5, color=MARK_COLOURS[kind], label=label))
    measured = [point for measurement in scene.measurements for _, point in measurement.places]
    for kind, points, mark, ms, mew in (
        ("weld", [weld.point for weld in scene.welds if weld.point is not None], "o", 9, 1.2),
        ("measurement", measured, "D", 5, 1.0),
    ):
        if points:
            x, y = view.flat(np.array(points)).T
            label = f"{kind} ({len(points)})"
            handles += ax.plot(x, y, mark, ms=ms, color=MARK_COLOURS[kind], mec=INK, mew=mew, label=label)
    for measurement in [item for item in scene.measurements if item.places][:MOST_PANELS]:
        place = view.flat(np.array([measurement.places[0][1]]))[0]
        ax.annotate(measurement.name, place, xytext=(5, 4), textcoords="offset points", fontsize=8)
    fig.legend(handles=handles, loc="outside right upper", fontsize=9)
    kinds: dict[str, Sized] = {"part": surfaces, "locator": scene.locators, "clamp": scene.clamps, "weld": scene.welds}
    kinds |= {"contact pair": () if contacts is None else contacts, "measurement point": measured}
    counts = [f"{len(own)} {kind}{'s' * (len(own) != 1)}" for kind, own in kinds.items() if len(own)]
    others = f" with {', '.join(counts[1:])}" if len(counts) > 1 else ""
    text = f"{counts[0]}{others}. Arrows point the way a locator or clamp acts."
    return png(fig, "The assembly", text, 110)


def draw_normals(surfaces: Mapping[str, Surface]) -> Picture:
    """Origin of the normal at each corner of the triangles (`mic.geometry.normals.Rule`), by colour."""
    fig, axes = wide(6.0, 1, len(surfaces), 6.5 * len(surfaces), squeeze=False)
    colours = np.array([to_rgb(RULE_COLOURS[rule]) for rule in Rule])
    for ax, (name, surface) in zip(axes[0], surfaces.items()):
        apart = Surface(surface.corners.reshape(-1, 3), np.arange(3 * len(surface.triangles)).reshape(-1, 3))
        view = _View([apart], len(apart.points))
        view.draw(ax, [colours[surface.curvature.rule.ravel()]], 0.35)
        for name_, mark, _ in DOUBTFUL:
            ax.plot(*view.flat(getattr(surface.curvature, name_)).T, mark, ms=5, color=INK)
        ax.set_title(name)
    counts = np.sum([np.bincount(s.curvature.rule.ravel(), minlength=len(Rule)) for s in surfaces.values()], axis=0)
    entries = [("s", 9, RULE_COLOURS[rule], f"{RULE_WORDS[rule]}: {counts[rule]}", counts[rule]) for rule in Rule]
    for name, mark, words in DOUBTFUL:
        count = sum(len(getattr(surface.curvature, name)) for surface in surfaces.values())
        entries.append((mark, 6, INK, f"{count} {words}", count))
    handles = [
        Line2D([], [], marker=mark, ls="", ms=size, color=colour, label=label)
        for mark, size, colour, label, count in entries
        if count
    ]
    fig.legend(handles=handles, loc="outside lower center", ncols=min(2 * len(surfaces), 4))
    text = f"Origin of the normals at {counts.sum()} triangle corners."
    return png(fig, "Normals of the sheets", text, 110)


def draw_overlap(surfaces: Mapping[str, Surface], contacts: Contacts) -> Picture:
    """Nominal overlap of the facing surfaces at each pair."""
    fig, ax = wide(6.0, width=9.5)
    view = _View(surfaces.values())
    view.draw(ax, [np.array(to_rgb("#dfe3e8"))] * len(surfaces), 0.35)
    deep, clear = contacts.overlap > 0, contacts.overlap == 0
    ax.plot(*view.flat(contacts.point[clear]).T, ".", ms=3, color=INK, label=f"{clear.sum()} pairs without overlap")
    if deep.any():
        order = np.flatnonzero(deep)[np.argsort(contacts.overlap[deep])]
        scale = Normalize(0.0, contacts.overlap.max())
        x, y = view.flat(contacts.point[order]).T
        label = f"{deep.sum()} pairs with overlap"
        ax.scatter(x, y, s=30, c=contacts.overlap[order], norm=scale, cmap="plasma_r", ec=INK, lw=0.4, label=label)
        fig.colorbar(ScalarMappable(scale, "plasma_r"), ax=ax, label="deepest nominal overlap (mm)", shrink=0.7)
    fig.legend(loc="outside lower center", ncols=2)
    text = f"Nominal overlap: at most {number(contacts.overlap.max(initial=0.0))} mm."
    return png(fig, "Nominal overlap", text, 110)


def overview_picture(outcome: Outcome, context: Context) -> Picture | None:
    """The assembly coloured by the 6σ of its displacement under the first law, with contact pairs and welds."""
    surfaces = context.surfaces
    fields = context.fields_of(outcome.laws[0]) if outcome.laws else {}
    if set(fields) != set(surfaces) or not surfaces:
        return None
    spread = [np.nan_to_num(fields[part].six_sigma_magnitude) for part in surfaces]
    top = max(values.max() for values in spread)
    scale = Normalize(0.0, top or 1.0)
    fig, ax = wide(5.6, width=9.5)
    view = _View(surfaces.values())
    view.draw(ax, [colormaps["YlOrRd"](scale(values))[:, :3] for values in spread], 0.35)
    handles = []
    welds = np.array([weld.point for weld in outcome.model.scene.welds]).reshape(-1, 3)
    for points, kind, ms, mew, colour in (
        (outcome.model.contacts.point, "contact pairs", 3, 0.5, "white"),
        (welds, "welds", 9, 1.2, "#4cc9f0"),
    ):
        if len(points):
            label = f"{len(points)} {kind}"
            handles += ax.plot(*view.flat(points).T, "o", ms=ms, color=colour, mec=INK, mew=mew, label=label)
    fig.colorbar(ScalarMappable(scale, "YlOrRd"), ax=ax, label="6σ of the displacement (mm)", shrink=0.7)
    fig.legend(handles=handles, loc="outside lower left", ncols=2)
    caption = f"6σ displacement of the assembly under {outcome.laws[0]}: at most {number(top)} mm."
    return png(fig, "Variation of the assembly", caption, 100)


def field_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Mean and 6σ displacement magnitude of every part under the first law."""
    surfaces = context.surfaces
    fields = context.fields_of(outcome.laws[0]) if outcome.laws else {}
    if not fields or not surfaces:
        return None
    means = {part: np.linalg.norm(field.mean, axis=1) for part, field in fields.items()}
    spreads = {part: field.six_sigma_magnitude for part, field in fields.items()}
    rows = [("mean displacement", "viridis", means), ("6σ displacement", "YlOrRd", spreads)]
    fig, largest = draw_fields(surfaces, rows)
    texts = [
        f"the largest {word} is {number(value)} mm, on {place}" for word, (value, place) in zip(("mean", "6σ"), largest)
    ]
    rank, discarded, error = (
        max(getattr(field, name) for field in fields.values()) for name in ("rank", "discarded", "error")
    )
    law = outcome.laws[0]
    caption = (
        f"Deviation from nominal after the last stage under {law}, including the parts' shape deviations: "
        f"{'; '.join(texts)}. 6σ uses at most {rank + 1} solves per part; the truncation omits "
        f"{number(discarded, 2)} of the elastic energy and {number(error, 2)} mm at the retained points."
    )
    return png(fig, f"Mean and 6σ displacement fields, {law}", caption, 100)


def _arrow(ax, view, item, length, colour):
    """An arrow that ends where a locator or clamp acts, in its direction; a cross along the line of sight."""
    point = np.array([item.point])
    head, tail = view.flat(np.concatenate([point, point - length * np.array(item.direction)]))
    if np.linalg.norm(head - tail) > length / 7:
        shape = {"arrowstyle": "-|>", "color": colour, "lw": 1.3, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 9}
        ax.annotate("", head, tail, arrowprops=shape)
    else:
        ax.plot(*head, "x", color=colour, ms=5)


def deviation_map_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Mean and 6σ at each point of parallelisms and profiles, under the first law."""
    items = [item for item in outcome.model.scene.measurements if item.points is not None][: MOST_PANELS // 2]
    if not items or not outcome.laws or not context.surfaces:
        return None
    law, table = outcome.laws[0], outcome.profile_statistics
    table = table[table["law"] == law]
    fig, axes = panels(2 * len(items), 2, (5.2, 3.4))
    worst = []
    for i, item in enumerate(items):
        own = table[table["measurement"] == item.name]
        view = _View([context.surfaces[item.part]])
        x, y = view.flat(own[["x", "y", "z"]].to_numpy()).T
        most = float(own["mean"].abs().max()) or 1.0
        shown = ("mean", "RdBu_r", (-most, most)), ("six_sigma", "YlOrRd", (0.0, float(own["six_sigma"].max()) or 1.0))
        for ax, (column, colours, ends) in zip(axes[2 * i : 2 * i + 2], shown):
            view.draw(ax, [np.array(to_rgb(part_colour(0)))], 0.25)
            dots = ax.scatter(x, y, c=own[column], cmap=colours, vmin=ends[0], vmax=ends[1], s=26, lw=0.4, ec=INK)
            fig.colorbar(dots, ax=ax, shrink=0.75, label="mean (mm)" if column == "mean" else "6σ (mm)")
            ax.set_title(f"{item.name} ({item.kind}, at most {item.upper:g} mm)")
        at = own.iloc[int(own["six_sigma"].fillna(0.0).argmax())]
        place = ", ".join(f"{at[axis]:.0f}" for axis in "xyz")
        spread = f"6σ = {number(at['six_sigma'])} mm about {number(at['mean'])} mm"
        worst.append(f"largest variation of {item.name} at ({place}): {spread}")
    return png(fig, "Maps of deviation", f"Under {law}, at the measured points; {'; '.join(worst)}.", 110)
