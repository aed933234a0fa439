"""Picture of a case: sheets, supports, clamps, welds and measurement points."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from mic.model.assembly import assemble
from verification.shell_contact.case import Case

__all__ = ["picture"]

COLOURS = ("#9ecae1", "#fdd0a2", "#c7e9c0")  # of the parts, in order

SHADES = 160  # reduces a picture to a third of its size


def picture(case: Case, cache: Path) -> bytes:
    """PNG: supports black, clamps red, welds violet, probes green, each along its direction; rigid bodies grey."""
    assembly = assemble(case.scene("coarse"), cache)
    scene = assembly.scene
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    axis = figure.add_subplot(projection="3d", computed_zorder=False)
    points = np.concatenate([surface.points for surface in assembly.surfaces.values()])
    size = np.ptp(points, axis=0).max()
    for colour, part in zip(COLOURS, scene.parts):
        surface = assembly.surfaces[part.name]
        axis.plot_trisurf(
            *surface.points.T, triangles=surface.triangles, color=colour, edgecolor="0.55", lw=0.15, alpha=0.6
        )
    for pad in scene.fixtures:
        points = np.concatenate([points, _circle(axis, pad)])
    for items, colour, sign in ((scene.locators, "k", -1), (scene.clamps, "r", -1), (scene.measurements, "g", 1)):
        for one in items:
            arrow = 0.1 * size * np.array(one.direction)
            start = np.array(one.point) + min(sign, 0) * arrow
            axis.quiver(*start, *arrow, color=colour, lw=1.4, arrow_length_ratio=0.35, zorder=5)
    for weld in scene.welds:
        axis.plot(*np.array(weld.point)[:, None], "o", color="tab:purple", ms=5, zorder=6)
    middle, half = (points.max(axis=0) + points.min(axis=0)) / 2, np.ptp(points, axis=0) / 2 + 0.12 * size
    for set_limits, centre, reach in zip((axis.set_xlim, axis.set_ylim, axis.set_zlim), middle, half):
        set_limits(centre - reach, centre + reach)
    axis.set_box_aspect(half, zoom=0.88)
    axis.set(xlabel="x, mm", ylabel="y, mm", zlabel="z, mm")
    axis.view_init(28, -62)
    axis.locator_params(nbins=5)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100, metadata={"Software": None})
    small = io.BytesIO()
    Image.open(buffer).convert("RGB").quantize(SHADES, Image.Quantize.FASTOCTREE).save(
        small, format="png", optimize=True
    )
    return small.getvalue()


def _circle(axis, pad) -> np.ndarray:
    """Draw a rigid pad; returns its rim."""
    normal = np.array(pad.normal) / np.linalg.norm(pad.normal)
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    angle = np.linspace(0, 2 * np.pi, 61)[:, None]
    rim = np.array(pad.point) + pad.radius * (np.cos(angle) * first + np.sin(angle) * np.cross(normal, first))
    axis.plot(*rim.T, color="0.4", lw=1.2)
    return rim
