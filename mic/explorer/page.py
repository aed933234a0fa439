"""The page: sliders, the assembly in space, key characteristics with their tolerances, the certificate, samples.

A move is answered as soon as it comes. Where an answer takes longer than :data:`SLOW`, a preliminary one comes first
and is called so, and the final one follows unless something was moved meanwhile. Answers are computed beside the
server, so that it stays awake.
"""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from trame.app import get_server
from trame.ui.vuetify3 import VAppLayout
from trame.widgets import client, html
from trame.widgets import vuetify3 as v3
from trame_vtk.widgets import vtk

from mic.contact.states import ContactState
from mic.errors import MicError
from mic.explorer.picture import Picture
from mic.explorer.shapes import Shapes
from mic.report.style import INSIDE, OUTSIDE, STATE_DOTS, STATE_WORDS, number, part_colour
from mic.studies.exploration import GROUPS, Exploration, ExploredAssembly
from mic.system.files import write_text

__all__ = ["Page", "Samples"]

SLOW = 0.05  # s: what takes longer is preceded by a preliminary answer
FIRST = 8  # controls of a group that are seen at once
STEPS = 200  # of a slider
BARS = 25
DRAWN = 100  # samples of a model without a run
AT_ONCE = 0.03  # s of sampling at a time
THICK = "A sheet of another thickness is drawn as one of its nominal thickness bends; all numbers are its own."
TITLES = {"sources": "Sources", "locators": "Locators (shims)", "clamps": "Clamps", "friction": "Friction"}


@dataclass(frozen=True)
class Samples:
    """Assemblies to look at.

    Attributes
    ----------
    number : (n,) int array
    deviations : (n, p) array
    measured : (n, k) array
        Key characteristics, mm; NaN where one failed.
    """

    number: np.ndarray
    deviations: np.ndarray
    measured: np.ndarray

    def __len__(self) -> int:
        return len(self.number)

    def more(self, deviations: np.ndarray, measured: np.ndarray) -> Samples:
        """With those that follow."""
        number = np.arange(len(self), len(self) + len(deviations))
        pairs = (self.number, number), (self.deviations, deviations), (self.measured, measured)
        return Samples(*(np.concatenate(pair) for pair in pairs))


class Page:
    """The page of one exploration.

    Parameters
    ----------
    exploration : Exploration
    shapes : Shapes
    folder : Path
        Where states are saved.
    scene : str or None
        Text of the scene's file, to which changes are added; None where the model came without.
    samples : Samples or None
        Of a run; None draws some.
    """

    def __init__(
        self,
        exploration: Exploration,
        shapes: Shapes,
        folder: Path,
        scene: str | None = None,
        samples: Samples | None = None,
    ):
        self.exploration, self.picture = exploration, Picture(exploration, shapes)
        self._folder, self._scene = Path(folder), scene
        items, count = exploration.own.scene.measurements, len(exploration.own.parameters)
        self._complete = samples is not None or not items or not count
        self._samples = samples or Samples(np.zeros(0, int), np.zeros((0, count)), np.zeros((0, len(items))))
        self._first, self._final = ThreadPoolExecutor(1), ThreadPoolExecutor(1)
        self._moved = asyncio.Event()
        self._shown = exploration.answer()
        self._took = exploration.answer().seconds  # of the second: what is prepared once is prepared
        if self._took > SLOW:
            exploration.answer(coarse=True)
        self._bins: list[np.ndarray] = []
        self._turn, self._picked = 0, self._shown.values
        self.server = get_server(f"mic-{id(self)}", client_type="vue3")
        self._state = self.server.state
        self._prepare()
        self._lay_out(shapes)

    # ------------------------------------------------------------------------------------------------- what is shown

    def _prepare(self) -> None:
        state, exploration = self._state, self.exploration
        for i, one in enumerate(exploration.controls):
            state[f"v_{i}"], state[f"low_{i}"], state[f"high_{i}"] = one.now, one.low, one.high
        # Names are a scene's, which may come from anybody: they are told as text, and are no part of the template.
        state.title = exploration.own.scene.name
        state.labels = [
            {
                "name": one.name if one.group == "sources" else one.name.partition(".")[2],
                "stated": f"{one.name}, stated: {number(one.now, 6)} {one.unit}",
            }
            for one in exploration.controls
        ]
        state.stage, state.stages = self._shown.stage, exploration.stages
        state.magnification = self.picture.usual(self._shown)
        thin = any(one.kind == "thickness" for one in exploration.own.scene.deviations)
        state.said, state.saved, state.picked = self.picture.shapes.said or THICK * thin, "", ""
        state.characteristic = next(iter(one.name for one in exploration.own.scene.measurements), "")
        state.characteristics = [one.name for one in exploration.own.scene.measurements]
        state.all = {group: False for group in GROUPS}
        state.answered = 0
        self._show(self._shown)
        self._draw_bars()
        self._state.change(*(f"v_{i}" for i in range(len(exploration.controls))), "stage")(self._on_move)
        self._state.change("magnification")(self._on_magnification)
        self._state.change("characteristic")(lambda **_: self._draw_bars())

    def _show(self, answer: ExploredAssembly) -> None:
        """Numbers and picture of an answer."""
        state = self._state
        self._shown = answer
        state.rows = [_row(one) for one in answer.table.to_dict("records")]
        state.certificate, state.failed, state.preliminary = answer.said, answer.failed, answer.preliminary
        shares = answer.shares
        state.contacts = [
            {"word": STATE_WORDS[label], "count": shares[label], "colour": STATE_DOTS[label]} for label in STATE_DOTS
        ]
        state.contact_stage = answer.contact_stage
        state.answered += 1
        self._place()

    def _place(self) -> None:
        state, answer = self._state, self._shown
        placed = self.picture.placed(answer, _positive(state.magnification))
        for p, points in enumerate(placed.parts):
            state[f"points_{p}"] = _packed(points, "float32")
        state.contact_points = _packed(placed.contacts, "float32")
        for kind in ContactState:
            own = np.flatnonzero(answer.states == kind) if len(answer.states) else np.zeros(0, dtype=int)
            state[f"contacts_{kind.label}"] = _vertices(own)
        state.measured_points = _packed(placed.measured, "float32")
        within = answer.table["within"].to_numpy(dtype=bool)[self.picture.measured]
        state.measured_in, state.measured_out = _vertices(np.flatnonzero(within)), _vertices(np.flatnonzero(~within))

    def _draw_bars(self) -> None:
        """The histogram of the characteristic that is chosen."""
        state, names = self._state, self._state.characteristics
        y = self._samples.measured[:, names.index(state.characteristic)] if len(names) else np.zeros(0)
        known = np.flatnonzero(np.isfinite(y))
        if not len(known):
            self._bins, state.bars = [], []
            return
        edges = np.histogram_bin_edges(y[known], BARS)
        place = np.clip(np.searchsorted(edges, y[known], side="right") - 1, 0, BARS - 1)
        self._bins = [known[place == j] for j in range(BARS)]
        most = max(len(one) for one in self._bins)
        item = self.exploration.own.scene.measurements[names.index(state.characteristic)]
        middle = 0.5 * (edges[1:] + edges[:-1])
        state.bars = [
            {
                "height": 100 * len(own) / most,
                "said": f"{len(own)} of {len(known)} samples about {number(x)} mm",
                "colour": INSIDE if item.lower <= x <= item.upper else OUTSIDE,
            }
            for own, x in zip(self._bins, middle)
        ]
        state.ends = [f"{number(edges[0])} mm", f"{number(edges[-1])} mm"]
        state.counted = f"{len(known)} samples" + ("" if self._complete else ", more being drawn")

    # ----------------------------------------------------------------------------------------------- what is answered

    def _on_move(self, **_) -> None:
        if self._state.picked and self.values() != self._picked:
            self._state.picked = ""
        self._moved.set()

    def _on_magnification(self, **_) -> None:
        self._place()

    def values(self) -> dict[str, float]:
        """Values of the controls as the page has them; what is no number is as it was."""
        found = {}
        for i, one in enumerate(self.exploration.controls):
            value = self._state[f"v_{i}"]
            known = isinstance(value, int | float) and np.isfinite(value)
            found[one.name] = float(value) if known else self._shown.values[one.name]
        return found

    async def answer_moves(self) -> None:
        """Answer moves, one after the other, the newest first; draw samples meanwhile. Runs until it is cancelled."""
        final: asyncio.Future | None = None
        drawing: asyncio.Future | None = None
        moved = asyncio.ensure_future(self._moved.wait())
        while True:
            if not self._complete and final is None and drawing is None:
                drawing = self._asked(self._final, self._drawn_some())
            await asyncio.wait({one for one in (moved, final, drawing) if one}, return_when=asyncio.FIRST_COMPLETED)
            if drawing is not None and drawing.done():
                self._take(drawing.result())
                drawing = None
            if moved.done():
                self._moved.clear()
                moved = asyncio.ensure_future(self._moved.wait())
                if final is not None:
                    final.cancel()  # if it has not begun; what was asked for is out of date
                ask = partial(self.exploration.answer, self.values(), self._state.stage)
                final = None
                if self._took > SLOW:  # one after the other: beside the final one the preliminary takes a fifth longer
                    self._tell(await self._asked(self._first, partial(ask, coarse=True)))
                    if not self._moved.is_set():
                        final = self._asked(self._final, ask)
                else:
                    self._tell(await self._asked(self._final, ask))
            elif final is not None and final.done():
                self._tell(final.result())
                final = None

    def _asked(self, pool: ThreadPoolExecutor, what: Callable[[], Any]) -> asyncio.Future:
        return asyncio.get_running_loop().run_in_executor(pool, what)

    def _drawn_some(self) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
        """Few enough samples that no move waits for them."""
        have = len(self._samples)
        count = min(DRAWN - have, max(1, int(AT_ONCE / max(self._took, 1e-4))))
        return partial(self.exploration.drawn, count, have)

    def _take(self, more: tuple[np.ndarray, np.ndarray]) -> None:
        self._samples = self._samples.more(*more)
        self._complete = len(self._samples) >= DRAWN
        with self._state:
            self._draw_bars()

    def _tell(self, answer: ExploredAssembly) -> None:
        if not answer.preliminary:
            self._took = answer.seconds
        with self._state:
            self._show(answer)

    def close(self) -> None:
        """Compute nothing more."""
        for pool in (self._first, self._final):
            pool.shutdown(wait=False, cancel_futures=True)

    # ------------------------------------------------------------------------------------------------ what is clicked

    def set(self, values: Mapping[str, float]) -> None:
        """Move controls; the others go where the scene has them. A slider is made longer for what lies beyond it."""
        for i, one in enumerate(self.exploration.controls):
            value = values.get(one.name, one.now)
            self._state[f"low_{i}"], self._state[f"high_{i}"] = min(one.low, value), max(one.high, value)
            self._state[f"v_{i}"] = value

    def pick(self, bar: int) -> None:
        """Look at a sample of a bar of the histogram, each time another."""
        own = self._bins[bar] if bar < len(self._bins) else np.zeros(0, dtype=int)
        if not len(own):
            return
        i = int(own[self._turn % len(own)])
        self._turn += 1
        self.set(self.exploration.sample(self._samples.deviations[i]))
        self._picked = self.values()
        k = self._state.characteristics.index(self._state.characteristic)
        value = number(float(self._samples.measured[i, k]), 4)
        self._state.picked = f"Sample {self._samples.number[i]}: {self._state.characteristic} {value} mm"

    def reset(self) -> None:
        """Everything as the scene states it."""
        self._state.picked = ""
        self.set({})

    def save_scene(self) -> None:
        """Write the scene with the fixture and the friction as they are set."""
        tables = self.exploration.scene_tables(self.values())
        if not tables:
            self._state.saved = (
                "Neither fixture nor friction was moved: the scene is as it was, and nothing is written."
            )
            return
        start = f"{self._scene.rstrip(chr(10))}\n\n# As it was set by hand\n" if self._scene is not None else ""
        said = "" if self._scene is not None else ": the tables that a scene's file takes at its end"
        self._write("scene", ".toml", start + tables, said)

    def save_sample(self) -> None:
        """Write the assembly as a row of samples."""
        self._write("sample", ".csv", self.exploration.sample_table(self.values()), "")

    def _write(self, stem: str, suffix: str, text: str, said: str) -> None:
        path = next(one for i in range(1, 10**6) if not (one := self._folder / f"explored-{stem}-{i}{suffix}").exists())
        try:
            write_text(path, text)
            self._state.saved = f"Saved: {path}{said}"
        except (MicError, OSError) as problem:
            self._state.saved = f"Not saved: {problem}"

    # -------------------------------------------------------------------------------------------------- how it is laid

    def _lay_out(self, shapes: Shapes) -> None:
        scene = self.exploration.own.scene
        self._state.trame__title = f"{scene.name} – mic explore"
        with VAppLayout(self.server) as layout:
            client.Style((Path(__file__).with_name("page.css")).read_text(encoding="utf-8"))
            with html.Div(classes="page"):
                with html.Div(classes="side"):
                    html.H1("{{ title }}")
                    html.P(self.exploration.law, classes="dim")
                    self._lay_controls()
                with html.Div(classes="space"):
                    self._lay_bar()
                    self._lay_space(shapes)
                    html.P("{{ said }}", v_show="said", classes="note", id="said")
                with html.Div(classes="side"):
                    self._lay_characteristics()
                    self._lay_samples()
                    self._lay_saving()
        self.layout = layout

    def _lay_controls(self) -> None:
        for group in GROUPS:
            own = [(i, one) for i, one in enumerate(self.exploration.controls) if one.group == group]
            if not own:
                continue
            html.H2(TITLES[group])
            for place, (i, one) in enumerate(own):
                hidden = {"v_show": f"all.{group}"} if place >= FIRST else {}
                with html.Div(classes="control", id=f"control-{i}", title=(f"labels[{i}].stated",), **hidden):
                    html.Label(f"{{{{ labels[{i}].name }}}}")
                    html.Input(
                        type="number",
                        step="any",
                        value=(f"v_{i}",),
                        change=f"v_{i} = Number($event.target.value)",
                        id=f"value-{i}",
                    )
                    html.Span(one.unit, classes="unit")
                    v3.VSlider(
                        v_model=(f"v_{i}",),
                        min=(f"low_{i}",),
                        max=(f"high_{i}",),
                        step=(one.high - one.low) / STEPS or 1.0,
                        hide_details=True,
                        density="compact",
                        thumb_size=12,
                        track_size=3,
                        color="#3b5b7d",
                    )
            if len(own) > FIRST:
                more = f"all = {{ ...all, {group}: !all.{group} }}"
                html.Button(f"{{{{ all.{group} ? 'fewer' : '{len(own) - FIRST} more' }}}}", click=more)

    def _lay_bar(self) -> None:
        with html.Div(classes="bar"):
            html.Span("after")
            with html.Select(v_model=("stage",), id="stage"):
                html.Option("{{ one }}", v_for="one in stages", key="one", value=("one",))
            html.Span("displacements ×")
            change = "magnification = Number($event.target.value)"
            html.Input(type="number", min=0, value=("magnification",), change=change, id="magnification")
            html.Span(
                "● {{ one.word }} {{ one.count }}",
                v_for="one in contacts",
                key="one.word",
                style=("{ color: one.colour }",),
                classes="state",
            )
            html.Span("({{ contact_stage }})", v_show="contact_stage && contact_stage != stage", classes="dim")
            html.Button("reset view", click=self._reset_view)
            html.Button("all as stated", click=self.reset, id="reset")

    def _reset_view(self) -> None:
        """From where most is seen, all of it."""
        placed = self.picture.placed(self._shown, 0.0)
        every = np.concatenate([*placed.parts, placed.contacts, placed.measured])
        if not len(every):
            return
        middle, size = 0.5 * (every.max(axis=0) + every.min(axis=0)), float(np.ptp(every, axis=0).max())
        eye = self.picture.viewpoint * max(3 * size, 1.0)
        place = {"position": (middle + eye).tolist(), "focalPoint": middle.tolist(), "viewUp": [0, 0, 1]}
        self._view.set_camera(place)
        self._view.reset_camera()

    def _lay_space(self, shapes: Shapes) -> None:
        with (
            html.Div(classes="view"),
            vtk.VtkView(background=("[1, 1, 1]",), interactor_settings=("interactor",)) as view,
        ):
            for p, part in enumerate(shapes.parts):
                faces = np.column_stack([np.full(len(part.triangles), 3), part.triangles])
                self._state[f"polys_{p}"] = _packed(faces, "uint32")
                bare = part.basis is None
                drawn = {"color": _rgb(part_colour(p)), "opacity": 0.3 if bare else 0.6, "interpolation": 0}
                with vtk.VtkGeometryRepresentation(property=(str(drawn),)):
                    vtk.VtkPolyData(f"part_{p}", points=(f"points_{p}",), polys=(f"polys_{p}",))
            for label, colour in STATE_DOTS.items():
                self._dots("contact_points", f"contacts_{label}", colour, 9 if label != "open" else 5)
            self._dots("measured_points", "measured_in", INSIDE, 13)
            self._dots("measured_points", "measured_out", OUTSIDE, 13)
        self._view = view
        client.ClientTriggers(mounted=self._reset_view)
        self._state.interactor = [
            {"button": 1, "action": "Rotate"},
            {"button": 2, "action": "Pan"},
            {"button": 3, "action": "Zoom", "scrollEnabled": True},
            {"button": 1, "action": "Pan", "shift": True},
            {"button": 1, "action": "Zoom", "alt": True},
        ]

    def _dots(self, points: str, cells: str, colour: str, size: int) -> None:
        drawn = {"color": _rgb(colour), "pointSize": size, "lighting": False, "representation": 0}
        with vtk.VtkGeometryRepresentation(property=(str(drawn).replace("False", "false"),)):
            vtk.VtkPolyData(cells, points=(points,), verts=(cells,))

    def _lay_characteristics(self) -> None:
        html.H2("Key characteristics")
        with html.Div(v_for="row in rows", key="row.name", classes="row"):
            html.Span("{{ row.name }}", classes="name")
            html.Span(
                "{{ row.value }} mm {{ row.word }}",
                classes=("row.within ? 'in' : 'out'",),
                id=("'value-of-' + row.name",),
                title=("row.exact",),
            )
            with html.Div(classes="scale", title=("row.limits",)):
                html.Div(classes="tick", style=("{ left: row.share + '%', background: row.colour }",))
        html.P("No key characteristic is measured.", v_show="!rows.length", classes="dim")
        with html.Div(classes=("['certificate', failed ? 'out' : preliminary ? 'early' : 'in']",), id="certificate"):
            html.Span("Preliminary: paths followed coarsely, the final answer follows. ", v_show="preliminary")
            html.Span("{{ certificate }}")
        html.Span("{{ answered }}", id="answered", style="display: none")

    def _lay_samples(self) -> None:
        with html.Div(v_show="characteristics.length"):
            html.H2("Samples")
            with html.Select(v_model=("characteristic",), id="characteristic"):
                html.Option("{{ one }}", v_for="one in characteristics", key="one", value=("one",))
            html.Span(" {{ counted }}", classes="dim", id="counted")
            with html.Div(classes="bars"):
                html.Div(
                    v_for="(one, j) in bars",
                    key="j",
                    classes="column",
                    title=("one.said",),
                    id=("'bar-' + j",),
                    click=(self.pick, "[j]"),
                    style=("{ '--height': one.height + '%', '--colour': one.colour }",),
                )
            with html.Div(classes="ends"):
                html.Span("{{ one }}", v_for="one in ends", key="one")
            html.P("{{ picked || 'Click a bar to look at a sample of it.' }}", id="picked", classes="dim")
        self._state.setdefault("ends", [])
        self._state.setdefault("counted", "")

    def _lay_saving(self) -> None:
        html.H2("Save")
        html.Button("fixture and friction as a scene", click=self.save_scene, id="save-scene")
        html.Button("assembly as a sample", click=self.save_sample, id="save-sample")
        html.P("{{ saved }}", id="saved", classes="dim")


def _row(one: Mapping[Any, Any]) -> dict[str, Any]:
    """A key characteristic as the page tells it."""
    share = 100 * (one["value"] - one["lower"]) / (one["upper"] - one["lower"])
    return {
        "name": one["measurement"],
        "value": number(one["value"], 4),
        "exact": f"{float(one['value'])!r} mm",
        "within": bool(one["within"]),
        "word": "in" if one["within"] else "out",
        "limits": f"{number(one['lower'])} … {number(one['upper'])} mm",
        # The scale reaches a quarter of the tolerance beyond each limit.
        "share": float(np.clip((np.nan_to_num(share, nan=50.0) + 25) / 1.5, 0, 100)),
        "colour": INSIDE if one["within"] else OUTSIDE,
    }


def _positive(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and np.isfinite(value) and value >= 0 else 1.0


def _packed(array: np.ndarray, dtype: str) -> dict[str, Any]:
    """An array as vtk.js takes it from trame."""
    data = np.ascontiguousarray(array, dtype=dtype).ravel()
    return {"bvals": base64.b64encode(data.tobytes()).decode(), "dtype": dtype, "shape": [len(data)]}


def _vertices(own: np.ndarray) -> dict[str, Any]:
    """Cells of one point each; one without any where there are none, for the browser takes no empty array."""
    if not len(own):
        return _packed(np.zeros(1), "uint32")
    return _packed(np.column_stack([np.ones(len(own)), own]), "uint32")


def _rgb(colour: str) -> list[float]:
    return [round(int(colour[i : i + 2], 16) / 255, 4) for i in (1, 3, 5)]
