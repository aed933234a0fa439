"""``mic explore``: a page on this machine on which an assembly is moved and looked at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console

from mic.commands.invocation import law_of, on_one_process, reduced, studied
from mic.errors import RunError, SceneError
from mic.results.outcome import read_outcome
from mic.results.run_folder import RunFolder
from mic.studies.exploration import explore as explored
from mic.system.console import plain
from mic.system.disk_cache import cache_folder
from mic.system.matrix_product import one_thread

__all__ = ["explore"]

SAMPLES = 2000  # of a run that are picked from
MISSING = "mic explore takes the library trame; install it: pip install 'mic-contact[explore]'"


@on_one_process
def explore(source, port, browser, keep, shim, force, law):
    """``mic explore``, with the values of its options (:mod:`mic.options`)."""
    try:
        from mic.explorer.page import Page, Samples  # only here: trame is optional
        from mic.explorer.server import free, serve
        from mic.explorer.shapes import Shapes, beside
    except ModuleNotFoundError as missing:
        if not (missing.name or "").startswith(("trame", "wslink", "aiohttp")):
            raise
        raise RunError(MISSING) from None
    port, console = free(port), Console()  # told before anything long
    run = (source / "run.json").is_file()
    if run:
        model = studied(console, source)[0]
        parts = RunFolder(source).parts(model.scene)
    else:
        model, parts = reduced(console, source)
    asked = law_of(model, law)
    try:
        exploration = explored(model, asked, shim, force)
    except ValueError as problem:
        raise SceneError(f"explore: {problem}") from None
    lying = beside(source)
    if not parts and lying.is_file():
        shapes = Shapes.load(lying, model)
    else:
        say = lambda line: console.print(f"{plain(line)} …", highlight=False)
        shapes = Shapes.of(model, parts, cache_folder(), say)
    if keep is not None:
        model.save(keep)
        shapes.save(beside(keep), model)
        console.print(f"kept: {plain(keep)} and {plain(beside(keep))}", highlight=False, soft_wrap=True)
    page = Page(
        exploration, shapes, _folder(source, run), _text(source), _samples(source, asked, Samples) if run else None
    )

    def ready(address):
        console.print(
            f"Open {address}\nOnly this machine is answered; end with Ctrl-C.", highlight=False, soft_wrap=True
        )

    one_thread(serve)(page, port, browser, ready)  # for all of its threads, which would else undo each other's
    console.print("Ended.")


def _scene_file(source: Path) -> Path | None:
    """The scene's file, where there is one."""
    found = source / "scene.toml" if source.is_dir() else source
    return found if found.is_file() and found.suffix == ".toml" else None


def _folder(source: Path, run: bool) -> Path:
    """Where a state is saved: beside the scene, whose meshes are named relative to it."""
    return Path.cwd() if run else source if source.is_dir() else source.parent


def _text(source: Path) -> str | None:
    found = _scene_file(source)
    return None if found is None else found.read_text(encoding="utf-8")


def _samples(source: Path, law: str, kind):
    """Valid samples of a run under a law, the first of them; none where it has none."""
    outcome = read_outcome(source)
    if law not in outcome.laws:
        return None
    own, scene = outcome.sample_numbers(law)[:SAMPLES], outcome.model.scene
    if not len(own) or not scene.measurements or not scene.deviations:
        return None
    x = np.column_stack([outcome.deviation(law, item.name, own) for item in scene.deviations])
    return kind(own, x, np.column_stack([outcome.measured(law, item.name, own) for item in scene.measurements]))
