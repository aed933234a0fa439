"""A picture: a drawn figure with a title and a caption with its main numbers.

Figures are drawn by matplotlib without pyplot, so that nothing global is touched.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from markupsafe import Markup, escape  # which jinja2 brings
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import Bbox
from PIL import Image  # which matplotlib brings

from mic.report.style import LAWS, LIMIT_COLOUR

__all__ = [
    "MOST_PANELS",
    "Picture",
    "draw_intervals",
    "draw_limits",
    "law_legend",
    "measured_once",
    "named_panels",
    "panels",
    "png",
    "svg",
    "wide",
]

_DECIMALS = re.compile(rb'\b(?:x|y|x1|x2|y1|y2|points)="[^"]*"')  # coordinates, of which
_LONG = re.compile(rb"(\.\d\d)\d+")  # a hundredth of a point is invisible
_LONGER = re.compile(rb"(\.\d)\d+")
_OUTLINE = re.compile(rb'\bd="[^"]*"')
_NAMED = re.compile(rb'<g id="[\w.]+_\d+">')  # unused names of groups
_USE = rb'<use xlink:href="[^"]*" x="[^"]*" y="[^"]*" style="'
_MARKS = re.compile(_USE + rb'([^"]*)"/>(?:' + _USE + rb'\1"/>)+')
_IDLE = re.compile(rb' transform="rotate\(-?0 [^"]*"|<metadata>.*?</metadata>', re.S)
_FONT = re.compile(rb";? ?font-family: [^;\"]*")  # of each text: the picture has one
#: Of characters in a data URI between double quotes.
_ESCAPES = str.maketrans({"'": "%26apos;", '"': "'", "%": "%25", "#": "%23", "&": "%26", "\n": "%0A"})
MOST_PANELS = 24  # more panels or labels are unreadable


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
        """The picture as a data URI for a self-contained page."""
        if self.kind == "png":
            return f"data:image/png;base64,{base64.b64encode(self.data).decode()}"
        text = self.data.decode().translate(_ESCAPES)
        return Markup("data:image/svg+xml;charset=utf-8," + text)  # contains neither quote nor ampersand

    def _repr_html_(self) -> str:
        """HTML for notebooks."""
        caption = f"<figcaption>{escape(self.caption)}</figcaption>"
        return f'<figure><img alt="{escape(self.title)}" src="{self.uri}" style="max-width:100%">{caption}</figure>'


def svg(fig: Figure, title: str, caption: str) -> Picture:
    """The figure as SVG, for few elements."""
    buffer = io.BytesIO()
    _lay_out(fig, 72)
    FigureCanvasSVG(fig).print_svg(buffer, metadata={"Date": None})  # savefig would draw everything twice
    data = _OUTLINE.sub(_outline, _DECIMALS.sub(_short, _IDLE.sub(b"", buffer.getvalue())))
    data = _FONT.sub(b"", re.sub(rb">\s+<", b"><", data))
    data = _MARKS.sub(_alike, _NAMED.sub(b"<g>", data))
    data = data.replace(b"<svg ", b"<svg font-family=\"'DejaVu Sans', Arial, sans-serif\" ", 1)
    return Picture(title, caption, data, "svg")


def png(fig: Figure, title: str, caption: str, dpi: int) -> Picture:
    """The figure as PNG, for many triangles."""
    buffer, indexed = io.BytesIO(), io.BytesIO()
    _lay_out(fig, dpi)
    FigureCanvasAgg(fig).print_png(buffer)
    few = Image.open(buffer).convert("RGB").quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(indexed, "PNG")
    return Picture(title, caption, indexed.getvalue(), "png")


def _lay_out(fig: Figure, dpi: int) -> None:
    """Place axes, labels and legends, once: saving would otherwise draw everything again."""
    for ax in fig.axes:
        for axis in (ax.xaxis, ax.yaxis):
            if not axis.get_label_text():
                axis.set_label_coords(0.5, 0.5)  # avoids repeated layout of all ticks
    with measured_once(fig.axes):
        fig.get_layout_engine().execute(fig)  # type: ignore[union-attr]  # every figure has one
    fig.set_layout_engine("none")
    fig.set_dpi(dpi)


def wide(height: float, rows: int = 1, columns: int = 1, width: float = 10.5, **kwargs: Any) -> tuple[Figure, Any]:
    """A figure as wide as the page and `height` inches high, with what :meth:`Figure.subplots` returns."""
    fig = Figure(figsize=(width, height), layout="constrained")
    return fig, fig.subplots(rows, columns, **kwargs)


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


def named_panels(
    names: Sequence[str], columns: int, height: float, xlabel: str, ylabel: str = "", **kwargs: Any
) -> tuple[Figure, list[Axes]]:
    """A figure of one titled panel per name, `height` inches each, with labels only at its left and lower edge.

    Further arguments go to :meth:`matplotlib.figure.Figure.subplots`.
    """
    columns = min(columns, len(names))
    fig, axes = panels(len(names), columns, (10.5 / max(columns, 2), height), **kwargs)
    for i, (ax, name) in enumerate(zip(axes, names)):
        ax.set_title(name)
        if i >= len(names) - columns:
            ax.set_xlabel(xlabel)
        if ylabel and i % columns == 0:
            ax.set_ylabel(ylabel)
    return fig, axes


def draw_intervals(ax: Axes, place: Any, value: Any, low: Any, high: Any, **style: Any) -> None:
    """Dots at `value` with a horizontal line from `low` to `high`; no line where an end is NaN."""
    ends = np.nan_to_num(np.array([value - low, high - value]))
    default: dict[str, Any] = {"fmt": "o", "ms": 4, "elinewidth": 1.4}
    ax.errorbar(value, place, xerr=ends, **default | style)


def draw_limits(ax: Axes, limits: Sequence[float], scale: float = 1.0) -> None:
    """Vertical lines at the finite limits of a key characteristic, multiplied by `scale`."""
    for limit in limits:
        if np.isfinite(limit):
            ax.axvline(scale * limit, color=LIMIT_COLOUR, lw=1.3)


def law_legend(fig: Figure, laws: Sequence[str]) -> None:
    """Colour and mark of each law, above the axes."""
    handles = [Line2D([], [], color=LAWS[law].colour, marker=LAWS[law].mark, ms=5, lw=1.5, label=law) for law in laws]
    fig.legend(handles=handles, loc="outside upper left", ncols=3)


def _short(found: re.Match[bytes]) -> bytes:
    """A coordinate attribute without superfluous digits."""
    return _LONGER.sub(rb"\1", found.group())


def _alike(found: re.Match[bytes]) -> bytes:
    """Marks of one style as one group with that style."""
    style = b' style="' + found.group(1) + b'"'
    return b"<g" + style + b">" + found.group().replace(style, b"") + b"</g>"


def _outline(found: re.Match[bytes]) -> bytes:
    """An outline without line breaks and superfluous digits."""
    return re.sub(rb"\s*([MLCQz])\s*", rb"\1", _LONG.sub(rb"\1", found.group())).replace(b' "', b'"')


@contextmanager
def measured_once(axes: Sequence[Axes]) -> Iterator[None]:
    """Context in which the extent of labels is measured again only when ticks have changed.

    A layout asks twice, which takes most of the drawing time. Axes with a fixed aspect are measured each time.
    """
    own = [ax for ax in axes if ax.name == "rectilinear" and ax.get_aspect() == "auto"]
    for ax in own:
        ax.get_tightbbox = partial(_room, ax, {})  # type: ignore[method-assign]
    try:
        yield
    finally:
        for ax in own:
            del ax.get_tightbbox


def _room(ax: Axes, known: dict[str, Any], renderer: Any, *args: Any, **kwargs: Any) -> Bbox | None:
    """:meth:`matplotlib.axes.Axes.get_tightbbox` with a cache."""
    ticks = [*ax.get_xticks(), np.nan, *ax.get_yticks()]
    if "margins" in known and np.array_equal(ticks, known["ticks"], equal_nan=True):
        return Bbox.from_extents(*np.add(ax.bbox.extents, known["margins"]))
    whole = type(ax).get_tightbbox(ax, renderer, *args, **kwargs)
    if whole is not None:
        known |= {"ticks": ticks, "margins": np.subtract(whole.extents, ax.bbox.extents)}
    return whole
