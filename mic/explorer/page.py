"""The page: controls, 3D view of the assembly, key characteristics with tolerances, certificate, histogram of samples.

``page.html`` is its Vue template; its variables are the state that this module sets, its triggers methods of `Page`.
Each change is evaluated at once. If an evaluation takes longer than :data:`SLOW`, a preliminary result is shown first
and marked as such; the final one follows unless another change came meanwhile. Evaluations run in threads, so that the
server stays responsive.
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
from matplotlib.colors import to_rgb
from trame.app import get_server
from trame.ui.vuetify3 import VAppLayout
from trame.widgets import client, html
from trame_vtk.widgets import vtk

from mic.contact.states import ContactState
from mic.errors import MicError
from mic.explorer.guard import LARGEST
from mic.explorer.positions import AssemblyPositions
from mic.explorer.shapes import Shapes
from mic.report.style import INSIDE, OUTSIDE, STATE_DOTS, STATE_WORDS, number, part_colour
from mic.studies.exploration import GROUPS, Exploration, ExploredAssembly
from mic.system.files import write_text

__all__ = ["Page", "Samples"]

SLOW = 0.05  # s: slower evaluations are preceded by a preliminary one
VISIBLE_CONTROLS = 8  # controls of a group that are visible at first
SLIDER_STEPS = 200  # steps of a slider
BARS = 25  # bars of the histogram
MAX_SAMPLES = 100  # samples that are drawn for a model without a run
SAMPLING_TIME = 0.03  # s of sampling between two checks for changes
THICKNESS_NOTE = "The view shows the bending of sheets with nominal thickness; all numbers use the actual thickness."
LARGEST_MAGNIFICATION = 1e9
MAX_FILES = 1000  # files of one kind that the page writes into a folder
TITLES = {"sources": "Sources", "locators": "Locators (shims)", "clamps": "Clamps", "friction": "Friction"}


@dataclass(frozen=True)
class Samples:
    """Evaluated samples.

    Attributes
    ----------
    number : (n,) int array
    deviations : (n, p) array
    measured : (n, k) array
        Key characteristics, mm; NaN for failed samples.
    """

    number: np.ndarray
    deviations: np.ndarray
    measured: np.ndarray

    def __len__(self) -> int:
        return len(self.number)

    def extended(self, deviations: np.ndarray, measured: np.ndarray) -> Samples:
        """These samples and further ones, numbered consecutively."""
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
        Folder for saved scenes and samples.
    scene : str or None
        Content of the scene file, to which changes are appended; None for a model without one.
    samples : Samples or None
        Samples of a run; for None, samples are drawn.
    """

    def __init__(
        self,
        exploration: Exploration,
        shapes: Shapes,
        folder: Path,
        scene: str | None = None,
        samples: Samples | None = None,
    ):
        self.exploration, self.positions = exploration, AssemblyPositions(exploration, shapes)
        self._folder, self._scene = Path(folder), scene
        items, count = exploration.scene_model.scene.measurements, len(exploration.scene_model.parameters)
        self._complete = samples is not None or not items or not count
        self._samples = samples or Samples(np.zeros(0, int), np.zeros((0, count)), np.zeros((0, len(items))))
        self._preliminary_pool, self._final_pool = ThreadPoolExecutor(1), ThreadPoolExecutor(1)
        self._changed = asyncio.Event()
        exploration.answer()  # makes one-time preparations, which do not count
        self._answer = exploration.answer()
        if self._answer.seconds > SLOW:
            exploration.answer(coarse=True)
        self._bins: list[np.ndarray] = []
        self._clicks, self._picked = 0, self._answer.values
        self.server = get_server(f"mic-{id(self)}", client_type="vue3", ws_max_msg_size=LARGEST)
        self._state = self.server.state
        self._initialise_state()
        self._build(shapes)

    # ---------------------------------------------------------------------------------------------- state of the page

    def _initialise_state(self) -> None:
        state, scene, controls = self._state, self.exploration.scene_model.scene, self.exploration.controls
        self.set({})
        # Names from a scene file are untrusted: they are sent as text, not as part of the template.
        state.title, state.law, state.trame__title = scene.name, self.exploration.law, f"{scene.name} – mic explore"
        groups = {group: [one for one in controls if one.group == group] for group in GROUPS}
        state.controls = [
            {
                "group": one.group,
                "name": one.name if one.group == "sources" else one.name.partition(".")[2],
                "stated": f"{one.name}, value of the scene: {number(one.now, 6)} {one.unit}",
                "unit": one.unit,
                "step": (one.high - one.low) / SLIDER_STEPS or 1.0,
                "hidden": one in groups[one.group][VISIBLE_CONTROLS:],
            }
            for one in controls
        ]
        state.groups = [
            {"name": group, "title": TITLES[group], "more": max(0, len(own) - VISIBLE_CONTROLS)}
            for group, own in groups.items()
            if own
        ]
        state.stage, state.stages = self._answer.stage, self.exploration.stages
        state.magnification = self.positions.default_magnification(self._answer)
        varies = any(one.kind == "thickness" for one in scene.deviations)
        state.note = self.positions.shapes.note or THICKNESS_NOTE * varies
        state.saved = state.picked = state.refused = ""
        state.characteristics = [one.name for one in scene.measurements]
        state.characteristic = next(iter(state.characteristics), "")
        state.all, state.answered, state.ends, state.counted = {group: False for group in GROUPS}, 0, [], ""
        self._show(self._answer)
        self._update_histogram()
        state.change("entries", "stage")(self._on_change)
        state.change("magnification")(lambda **_: self._send_positions())
        state.change("characteristic")(lambda **_: self._update_histogram())

    def _show(self, answer: ExploredAssembly) -> None:
        """Show the numbers and positions of an evaluated assembly."""
        self._answer, shares = answer, answer.shares
        if not answer.preliminary:
            self._seconds = answer.seconds
        with self._state as state:
            state.rows = [_row(one) for one in answer.table.to_dict("records")]
            state.certificate, state.failed, state.preliminary = answer.said, answer.failed, answer.preliminary
            state.contacts = [
                {"word": STATE_WORDS[label], "count": shares[label], "colour": colour}
                for label, colour in STATE_DOTS.items()
            ]
            state.contact_stage = answer.contact_stage
            state.answered += 1
            self._send_positions()

    def _send_positions(self) -> None:
        state, answer = self._state, self._answer
        positions = self.positions.of(answer, state.magnification)
        for p, points in enumerate(positions.parts):
            state[f"points_{p}"] = _packed(points, "float32")
        state.contact_points = _packed(positions.contacts, "float32")
        for kind in ContactState:
            own = np.flatnonzero(answer.states == kind) if len(answer.states) else np.zeros(0, dtype=int)
            state[f"contacts_{kind.label}"] = _vertices(own)
        state.measured_points = _packed(positions.measured, "float32")
        within = answer.table["within"].to_numpy(dtype=bool)[self.positions.measured]
        state.measured_in, state.measured_out = _vertices(np.flatnonzero(within)), _vertices(np.flatnonzero(~within))

    def _update_histogram(self) -> None:
        """Histogram of the selected characteristic."""
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
        item = self.exploration.scene_model.scene.measurements[names.index(state.characteristic)]
        middle = 0.5 * (edges[1:] + edges[:-1])
        state.bars = [
            {
                "height": 100 * len(own) / most,
                "tooltip": f"{len(own)} of {len(known)} samples about {number(x)} mm",
                "colour": INSIDE if item.lower <= x <= item.upper else OUTSIDE,
            }
            for own, x in zip(self._bins, middle)
        ]
        state.ends = [f"{number(edges[0])} mm", f"{number(edges[-1])} mm"]
        state.counted = f"{len(known)} samples" + ("" if self._complete else ", drawing more")

    # ---------------------------------------------------------------------------------------------------- evaluation

    def _on_change(self, **_) -> None:
        if self._state.picked and self.values() != self._picked:
            self._state.picked = ""
        self._changed.set()

    def values(self) -> dict[str, float]:
        """Values of the controls on the page."""
        return {one.name: float(value) for one, value in zip(self.exploration.controls, self._state.entries)}

    # ------------------------------------------------------------------------------------------- what clients may send

    def permitted_value(self, key: str, value: Any) -> Any:
        """The value that a variable of the page gets for a client's value; None if the client may not set it.

        A number outside its range is answered with a sentence on the page.
        """
        match key, value:
            case "entries", list() if len(value) == len(self.exploration.controls) and all(map(_is_number, value)):
                return self._permitted_entries(value)
            case "magnification", _ if _is_number(value):
                reason = f"The magnification {value:g} is outside 0 … {LARGEST_MAGNIFICATION:g}."
                return self._answered(key, value, None if 0 <= value <= LARGEST_MAGNIFICATION else reason)
            case ("stage", str()) | ("characteristic", str()) if value in self._state[f"{key}s"]:
                return value
            case "all", dict() if value.keys() == set(GROUPS) and all(isinstance(one, bool) for one in value.values()):
                return value
        return None

    def permits_action(self, name: str, arguments: list[Any]) -> bool:
        """Whether a client may call an action with these arguments."""
        if name == "pick":
            return len(arguments) == 1 and type(arguments[0]) is int and 0 <= arguments[0] < BARS
        return name in self._actions and not arguments

    def _permitted_entries(self, entries: list[float]) -> list[float] | None:
        state, permitted, reason = self._state, [], None
        for control, shown, value, low, high in zip(
            self.exploration.controls, state.controls, entries, state.lows, state.highs
        ):
            permitted.append(min(max(value, low), high))
            if not abs(permitted[-1] - value) < shown["step"]:  # a slider may round its ends by less than a step
                limits = f"{low:g} … {high:g} {control.unit}".rstrip()
                reason = f"{control.name}: {value:g} is outside {limits}."
        return self._answered("entries", permitted, reason)

    def _answered(self, key: str, value: Any, reason: str | None) -> Any:
        """The value, or None after a sentence why not; the page then shows the former value again."""
        with self._state as state:
            state.refused = reason or ""
            if reason:
                self.server.clear_state_client_cache(key)
                state.dirty(key)
        return None if reason else value

    async def answer_changes(self) -> None:
        """Evaluate the latest change, again and again, and draw samples in between; runs until cancelled."""
        final: asyncio.Future | None = None
        sampling: asyncio.Future | None = None
        change = asyncio.ensure_future(self._changed.wait())
        while True:
            if not self._complete and final is None and sampling is None:
                sampling = self._submit(self._final_pool, self._sampling_task())
            await asyncio.wait(
                {task for task in (change, final, sampling) if task}, return_when=asyncio.FIRST_COMPLETED
            )
            if sampling is not None and sampling.done():
                self._add_samples(sampling.result())
                sampling = None
            if change.done():
                self._changed.clear()
                change = asyncio.ensure_future(self._changed.wait())
                if final is not None:
                    final.cancel()  # if it has not begun; it is out of date
                evaluate = partial(self.exploration.answer, self.values(), self._state.stage)
                final = None
                if self._seconds > SLOW:  # in parallel, the preliminary one would take a fifth longer
                    self._show(await self._submit(self._preliminary_pool, partial(evaluate, coarse=True)))
                    if not self._changed.is_set():
                        final = self._submit(self._final_pool, evaluate)
                else:
                    self._show(await self._submit(self._final_pool, evaluate))
            elif final is not None and final.done():
                self._show(final.result())
                final = None

    def _submit(self, pool: ThreadPoolExecutor, task: Callable[[], Any]) -> asyncio.Future:
        return asyncio.get_running_loop().run_in_executor(pool, task)

    def _sampling_task(self) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
        """A task that draws so few samples that no change has to wait."""
        have = len(self._samples)
        count = min(MAX_SAMPLES - have, max(1, int(SAMPLING_TIME / max(self._seconds, 1e-4))))
        return partial(self.exploration.draw_samples, count, have)

    def _add_samples(self, new: tuple[np.ndarray, np.ndarray]) -> None:
        self._samples = self._samples.extended(*new)
        self._complete = len(self._samples) >= MAX_SAMPLES
        with self._state:
            self._update_histogram()

    def close(self) -> None:
        """Stop all computations."""
        for pool in (self._preliminary_pool, self._final_pool):
            pool.shutdown(wait=False, cancel_futures=True)

    # ------------------------------------------------------------------------------------------------------- actions

    def set(self, values: Mapping[str, float]) -> None:
        """Set controls, and all others to the values of the scene; widen a slider for a value beyond its range."""
        controls = self.exploration.controls
        entries = [values.get(one.name, one.now) for one in controls]
        self._state.lows = [min(one.low, value) for one, value in zip(controls, entries)]
        self._state.highs = [max(one.high, value) for one, value in zip(controls, entries)]
        self._state.entries = entries

    def pick(self, bar: int) -> None:
        """Show the next sample of a bar of the histogram."""
        own = self._bins[bar] if 0 <= bar < len(self._bins) else np.zeros(0, dtype=int)
        if not len(own):
            return
        i = int(own[self._clicks % len(own)])
        self._clicks += 1
        self.set(self.exploration.sample(self._samples.deviations[i]))
        self._picked = self.values()
        k = self._state.characteristics.index(self._state.characteristic)
        value = number(float(self._samples.measured[i, k]), 4)
        self._state.picked = f"Sample {self._samples.number[i]}: {self._state.characteristic} {value} mm"

    def reset(self) -> None:
        """Set all controls to the values of the scene."""
        self._state.picked = ""
        self.set({})

    def save_scene(self) -> None:
        """Save the scene with the current locators, clamps and friction."""
        tables = self.exploration.scene_tables(self.values())
        if not tables:
            self._state.saved = "Nothing saved: locators, clamps and friction have the values of the scene."
            return
        start = f"{self._scene.rstrip(chr(10))}\n\n# Set in mic explore\n" if self._scene is not None else ""
        said = "" if self._scene is not None else ": append these tables to the scene file"
        self._write("scene", ".toml", start + tables, said)

    def save_sample(self) -> None:
        """Save the assembly as a row of samples."""
        self._write("sample", ".csv", self.exploration.sample_table(self.values()), "")

    def _write(self, stem: str, suffix: str, text: str, said: str) -> None:
        free = (self._folder / f"explored-{stem}-{i}{suffix}" for i in range(1, MAX_FILES + 1))
        path = next((one for one in free if not one.exists()), None)
        if path is None:
            self._state.saved = f"Not saved: {self._folder} holds {MAX_FILES} saved files; move some away."
            return
        try:
            write_text(path, text)
            self._state.saved = f"Saved: {path}{said}"
        except (MicError, OSError) as problem:
            self._state.saved = f"Not saved: {problem}"

    # -------------------------------------------------------------------------------------------------------- layout

    def _build(self, shapes: Shapes) -> None:
        actions = self.pick, self.reset, self.save_scene, self.save_sample, self.reset_view
        self._actions = {action.__name__ for action in actions}
        for action in actions:
            self.server.controller.trigger(action.__name__)(action)
        template, style = (
            Path(__file__).with_name(f"page.{end}").read_text(encoding="utf-8") for end in ("html", "css")
        )
        with VAppLayout(self.server) as self.layout:
            client.Style(style)
            client.ClientTriggers(mounted=self.reset_view)
            html.Div(template.replace("<!-- view -->", self._build_view(shapes)), classes="page")

    def reset_view(self) -> None:
        """Show the whole assembly from its default viewpoint."""
        every = self.positions.of(self._answer, 0.0).all
        if not len(every):
            return
        middle, size = 0.5 * (every.max(axis=0) + every.min(axis=0)), float(np.ptp(every, axis=0).max())
        eye = self.positions.viewpoint * max(3 * size, 1.0)
        place = {"position": (middle + eye).tolist(), "focalPoint": middle.tolist(), "viewUp": [0, 0, 1]}
        self._view.set_camera(place)
        self._view.reset_camera()

    def _build_view(self, shapes: Shapes) -> str:
        """HTML of the 3D view."""
        buttons = [(1, "Rotate", {}), (2, "Pan", {}), (3, "Zoom", {"scrollEnabled": True})]
        buttons += [(1, "Pan", {"shift": True}), (1, "Zoom", {"alt": True})]
        self._state.interactor = [{"button": i, "action": action} | keys for i, action, keys in buttons]
        settings = {"background": ("[1, 1, 1]",), "interactor_settings": ("interactor",)}
        with vtk.VtkView(**settings, connect_parent=False) as self._view:
            for p, part in enumerate(shapes.parts):
                faces = np.column_stack([np.full(len(part.triangles), 3), part.triangles])
                self._state[f"polys_{p}"] = _packed(faces, "uint32")
                opacity = 0.6 if len(part.acting) else 0.3
                drawn = f"{{color: {list(to_rgb(part_colour(p)))}, opacity: {opacity}, interpolation: 0}}"
                with vtk.VtkGeometryRepresentation(property=(drawn,)):
                    vtk.VtkPolyData(f"part_{p}", points=(f"points_{p}",), polys=(f"polys_{p}",))
            for label, colour in STATE_DOTS.items():
                self._add_points("contact_points", f"contacts_{label}", colour, 9 if label != "open" else 5)
            self._add_points("measured_points", "measured_in", INSIDE, 13)
            self._add_points("measured_points", "measured_out", OUTSIDE, 13)
        return self._view.html

    def _add_points(self, points: str, cells: str, colour: str, size: int) -> None:
        drawn = f"{{color: {list(to_rgb(colour))}, pointSize: {size}, lighting: false, representation: 0}}"
        with vtk.VtkGeometryRepresentation(property=(drawn,)):
            vtk.VtkPolyData(cells, points=(points,), verts=(cells,))


def _row(one: Mapping[Any, Any]) -> dict[str, Any]:
    """A key characteristic as the page shows it."""
    share = 100 * (one["value"] - one["lower"]) / (one["upper"] - one["lower"])
    return {
        "name": one["measurement"],
        "value": number(one["value"], 4),
        "exact": f"{float(one['value'])!r} mm",
        "within": bool(one["within"]),
        "limits": f"{number(one['lower'])} … {number(one['upper'])} mm",
        # The scale reaches a quarter of the tolerance beyond each limit.
        "share": float(np.clip((np.nan_to_num(share, nan=50.0) + 25) / 1.5, 0, 100)),
    }


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _packed(array: np.ndarray, dtype: str) -> dict[str, Any]:
    """An array in the format of trame and vtk.js."""
    data = np.ascontiguousarray(array, dtype=dtype).ravel()
    return {"bvals": base64.b64encode(data.tobytes()).decode(), "dtype": dtype, "shape": [len(data)]}


def _vertices(own: np.ndarray) -> dict[str, Any]:
    """A cell for each point; an empty cell if there are no points, because the browser rejects empty arrays."""
    if not len(own):
        return _packed(np.zeros(1), "uint32")
    return _packed(np.column_stack([np.ones(len(own)), own]), "uint32")
