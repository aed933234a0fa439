"""Pictures of the shape caused by one standard deviation of each source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from mic.geometry.surface import Surface
from mic.model.one_sigma import SourceShape
from mic.report.picture import Picture, panels, png
from mic.report.space_pictures import draw_surfaces
from mic.report.style import number

__all__ = ["MOST", "draw_shapes"]

MOST = 12  # shapes of a picture
COLUMNS = 3


def draw_shapes(surfaces: Mapping[str, Surface], shapes: Sequence[SourceShape]) -> Picture:
    """Each shape on its parts, coloured by the displacement along the normals, each with its own scale."""
    shown = shapes[:MOST]
    fig, axes = panels(len(shown), min(COLUMNS, len(shown)), (3.6, 2.9))
    for ax, shape in zip(axes, shown):
        own = {name: surfaces[name] for name in shape.fields}
        off = [np.einsum("vi,vi->v", shape.fields[name], surface.vertex_normals) for name, surface in own.items()]
        top = max(float(np.abs(values).max()) for values in off) or 1.0
        scale = Normalize(-top, top)
        draw_surfaces(ax, list(own.values()), [colormaps["RdBu_r"](scale(values))[:, :3] for values in off])
        ax.set_title(f"{shape.name} ({', '.join(own)}): {number(shape.largest[2])} mm", fontsize=9)
        fig.colorbar(ScalarMappable(scale, "RdBu_r"), ax=ax, shrink=0.7, label="mm")
    text = "Displacement along the normals due to 1 σ of each source, with the part on its datum locators; the title "
    text += "gives the largest displacement."
    if any(shape.face for shape in shown):
        text += " For a thickness: the motion of a face, half of the change, or all of it if the other face stays."
    if len(shapes) > MOST:
        text += f" Shown are the first {MOST} of {len(shapes)}."
    return png(fig, "Shapes of the sources", text, 100)
