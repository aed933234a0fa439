"""A picture: a drawn figure with a title, and a caption that says in numbers what it shows.

Figures are drawn by matplotlib without pyplot, so that nothing global is touched.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image  # which matplotlib brings

from mic.report.style import LAWS

__all__ = ["MOST_PANELS", "Picture", "law_legend", "panels", "png", "svg"]

_DECIMALS = re.compile(rb'\b(?:d|x|y|x1|x2|y1|y2|points)="[^"]*"')  # of places on paper, of which
_LONG = re.compile(rb"(\.\d\d)\d+")  # a hundredth of a point is seen by nobody
_IDLE = re.compile(rb' transform="rotate\(-?0 [^"]*"|<metadata>.*?</metadata>', re.S)
_FONT = re.compile(rb";? ?font-family: [^;\"]*")  # of each text: it is the picture's own
MOST_PANELS = 24  # more panels or labels than this nobody reads


@dataclass(frozen=True)
class Picture:
    """A drawn picture.

    Attributes
    ----------
    title, caption : str
    data : bytes
        Content of the file.
    kind : {"svg", "png"}
        Kind, and suffix, of the file.
    """

    title: str
    caption: str
    data: bytes
    kind: Literal["svg", "png"]

    @property
    def uri(self) -> str:
        """The picture as a data URI, so that a page can hold it."""
        mime = {"svg": "image/svg+xml", "png": "image/png"}[self.kind]
        return f"data:{mime};base64,{base64.b64encode(self.data).decode()}"


def svg(fig: Figure, title: str, caption: str) -> Picture:
    """The figure as lines and text, for pictures of few elements."""
    return _save(fig, title, caption, "svg", 72, {"Date": None})


def png(fig: Figure, title: str, caption: str, dpi: int) -> Picture:
    """The figure as pixels, for pictures of many triangles."""
    return _save(fig, title, caption, "png", dpi, None)


def panels(count: int, columns: int, size: tuple[float, float], **kwargs: Any) -> tuple[Figure, list[Axes]]:
    """A figure with `count` axes of the given size in inches, row by row.

    Further arguments go to :meth:`matplotlib.figure.Figure.subplots`.
    """
    rows = -(-count // columns)
    fig = Figure(figsize=(max(columns * size[0], 5.0), rows * size[1] + 0.35), layout="constrained")
    axes = fig.subplots(rows, columns, squeeze=False, **kwargs).ravel()
    for ax in axes[count:]:
        ax.set_axis_off()
    return fig, list(axes[:count])


def law_legend(fig: Figure, laws: Sequence[str]) -> None:
    """Colour and mark of each law, above the axes."""
    handles = [Line2D([], [], color=LAWS[law].colour, marker=LAWS[law].mark, ms=5, lw=1.5, label=law) for law in laws]
    fig.legend(handles=handles, loc="outside upper left", ncols=3)


def _terse(found: re.Match[bytes]) -> bytes:
    """An attribute of places on paper, without the blanks and digits that nobody needs."""
    return re.sub(rb"\s*([MLCQz])\s*", rb"\1", _LONG.sub(rb"\1", found.group()))


def _save(fig, title, caption, kind, dpi, metadata):
    buffer = io.BytesIO()
    fig.savefig(buffer, format=kind, dpi=dpi, metadata=metadata)
    data = buffer.getvalue()
    if kind == "svg":
        data = _DECIMALS.sub(_terse, _IDLE.sub(b"", data))
        data = _FONT.sub(b"", re.sub(rb">\s+<", b"><", data))
        data = data.replace(b"<svg ", b"<svg font-family=\"'DejaVu Sans', Arial, sans-serif\" ", 1)
    else:
        indexed = io.BytesIO()
        few = Image.open(buffer).convert("RGB").quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        few.save(indexed, "PNG")
        data = indexed.getvalue()
    return Picture(title, caption, data, kind)
