"""``mic explore``: an interactive page of an assembly, served on this machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mic.commands.invocation import choose_law, first_rank_only, load_model, reduce_source
from mic.commands.output import CommandConsole
from mic.errors import RunError, SceneError
from mic.results.outcome import read_outcome
from mic.results.run_folder import RunFolder
from mic.studies.exploration import explore as start_exploration
from mic.system.disk_cache import cache_folder
from mic.system.matrix_product import one_thread
from mic.system.port import check_port

__all__ = ["explore"]

MAX_SAMPLES = 2000  # samples of a run in the histograms
MISSING = "mic explore needs the library trame; install it: pip install 'mic-contact[explore]'"


@first_rank_only
def explore(source, port, browser, keep, shim, force, law):
    """``mic explore``, with the values of its options (:mod:`mic.options`)."""
    try:
        from mic.explorer.page import Page, Samples  # trame is an optional dependency
        from mic.explorer.server import serve
        from mic.explorer.shapes import Shapes, shapes_path
    except ModuleNotFoundError as missing:
        if not (missing.name or "").startswith(("trame", "wslink", "aiohttp", "msgpack")):
            raise
        raise RunError(MISSING) from None
    port, console = check_port(port), CommandConsole()
    run = (source / "run.json").is_file()
    if run:
        model = load_model(console, source)[0]
        parts = RunFolder(source).parts()
    else:
        model, parts = reduce_source(console, source)
    law = choose_law(model, law)
    try:
        exploration = start_exploration(model, law, shim, force)
    except ValueError as problem:
        raise SceneError(f"explore: {problem}") from None
    saved = shapes_path(source)
    if not parts and saved.is_file():
        shapes = Shapes.load(saved, model)
    else:
        shapes = Shapes.of(model, parts, cache_folder(), console.say_step)
    if keep is not None:
        model.save(keep)
        shapes.save(shapes_path(keep), model)
        console.say(f"saved: {keep} and {shapes_path(keep)}")
    samples = _samples(source, law, Samples) if run else None
    page = Page(exploration, shapes, _save_folder(source, run), _scene_text(source), samples)

    def print_address(address):
        console.say(f"Open {address}\nOnly this machine can open the page. Press Ctrl-C to stop.")

    one_thread(serve)(page, port, browser, print_address)  # one setting for all threads of the server
    console.print("Stopped.")


def _save_folder(source: Path, run: bool) -> Path:
    """The folder in which the page saves: that of the scene, because mesh paths are relative to it."""
    return Path.cwd() if run else source if source.is_dir() else source.parent


def _scene_text(source: Path) -> str | None:
    """Content of the scene file; None if there is none."""
    file = source / "scene.toml" if source.is_dir() else source
    return file.read_text(encoding="utf-8") if file.is_file() and file.suffix == ".toml" else None


def _samples(source: Path, law: str, kind):
    """The first valid samples of a run under a law, as a `kind`; None if there are none."""
    outcome = read_outcome(source)
    if law not in outcome.laws:
        return None
    own, scene = outcome.sample_numbers(law)[:MAX_SAMPLES], outcome.model.scene
    if not len(own) or not scene.measurements or not scene.deviations:
        return None
    x = outcome.deviations(law, own)
    return kind(own, x, np.column_stack([outcome.measured(law, item.name, own) for item in scene.measurements]))
