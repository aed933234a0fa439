"""Response time of the page of `mic explore`, from the slider's event to the new number in the browser.

    python benchmarks/explore.py                        # lap joint, hat on plate and wheelhouse: some minutes
    python benchmarks/explore.py wheelhouse --moves 10

Each scene is served by `mic explore`, with the shapes of the parts, to a headless Chromium (Debian's chromium and
chromium-driver, and the extras `explore` and `test`). Keys move one slider of each kind of control; the browser records
the time of the key, of each new number and of its painting. Slow answers are preceded by a preliminary one. Printed are
the median and the 95 % quantile in ms. Use an idle machine: page, server and software rendering share its cores.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import mic
from mic import examples
from mic.explorer.shapes import Shapes, shapes_path
from mic.model.assembly import assemble

SCENES = ("lap_joint", "hat_on_plate", "wheelhouse")
KINDS = ("sources", "locators", "friction")
SHOWN = 8  # sliders moved for each kind of control
ENOUGH = 60.0  # s, time limit of an answer
PAUSE = 0.3  # s between two moves
ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --enable-unsafe-swiftshader --window-size=1280,800"
)
#: In the page: `moved` is when the slider was; `seen` holds when a number was new, whether it was preliminary, and when
#: it was painted.
WATCH = """
window.seen = []; window.moved = null;
document.addEventListener('keydown', () => { window.moved = performance.now(); window.seen = []; }, true);
const answered = document.getElementById('answered'), certificate = document.getElementById('certificate');
new MutationObserver(() => {
  const one = [performance.now(), certificate.className.includes('early'), null];
  window.seen.push(one);
  requestAnimationFrame(() => setTimeout(() => { one[2] = performance.now(); }));
}).observe(answered, { characterData: true, childList: true, subtree: true });
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(SCENES), help="names of shipped scenes")
    parser.add_argument("--moves", type=int, default=30, help="of each kind")
    arguments = parser.parse_args()
    table = Table("scene", "moved", "", "median", "95 %", "painted", "95 %", title="From a slider to its number, ms")
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.scenes:
            exploration = saved(name, Path(folder))
            program, address = served(Path(folder) / f"{name}.npz")
            try:
                for kind, moves in watched(exploration, address, arguments.moves).items():
                    rows(table, name, kind, moves)
            finally:
                program.send_signal(signal.SIGINT)
                program.wait(ENOUGH)
    Console().print(table)


def saved(name: str, folder: Path) -> mic.studies.exploration.Exploration:
    """Save the model and shapes of a shipped scene; return the controls of its page."""
    scene = mic.load_scene(examples.folder(name))
    model = mic.reduce(scene)
    path = folder / f"{name}.npz"
    model.save(path)
    Shapes.of(model, assemble(scene, mic.cache_folder()).parts, mic.cache_folder()).save(shapes_path(path), model)
    return mic.explore(model, "coulomb")


def served(path: Path) -> tuple[subprocess.Popen, str]:
    """Start the server of the page; return its process and address."""
    start = [
        sys.executable,
        "-c",
        "from mic.cli import main; main()",
        "explore",
        str(path),
        "--law",
        "coulomb",
        "--no-browser",
    ]
    environment = os.environ | {"COLUMNS": "300"}
    program = subprocess.Popen(start, stdout=subprocess.PIPE, text=True, cwd=path.parent, env=environment)
    assert program.stdout is not None
    for line in program.stdout:
        if "http://" in line:
            return program, line.split()[-1]
    raise SystemExit("mic explore did not start")


def watched(exploration, address: str, count: int) -> dict[str, list[tuple[float, float, float, float]]]:
    """Times of each move by kind of control: first number, its painting, last number and its painting, ms."""
    from selenium import webdriver
    from selenium.webdriver.common.keys import Keys

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for argument in ARGUMENTS.split():
        options.add_argument(argument)
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    found: dict[str, list[tuple[float, float, float, float]]] = {}
    stream = np.random.default_rng(0)
    try:
        browser.get(address)
        until(lambda: browser.find_elements("id", "answered"))
        until(lambda: "more" not in browser.find_element("id", "counted").get_attribute("textContent"))
        browser.execute_script(WATCH)
        for kind in KINDS:
            own = [i for i, one in enumerate(exploration.controls) if one.group == kind][:SHOWN]
            for move in range(count if own else 0):
                i = own[move % len(own)]
                thumb = browser.find_element("css selector", f"#control-{i} [role=slider]")
                at = float(browser.find_element("id", f"value-{i}").get_property("value"))
                one = exploration.controls[i]
                up = stream.random() < (one.high - at) / (one.high - one.low)  # away from the ends
                thumb.send_keys(Keys.PAGE_UP if up else Keys.PAGE_DOWN)
                until(lambda: browser.execute_script("return seen.some(one => !one[1] && one[2])"))
                moved, seen = browser.execute_script("return [moved, seen]")
                last = next(one for one in seen if not one[1])
                found.setdefault(kind, []).append(
                    (seen[0][0] - moved, seen[0][2] - moved, last[0] - moved, last[2] - moved)
                )
                time.sleep(PAUSE)
    finally:
        browser.quit()
    return found


def until(true) -> None:
    end = time.monotonic() + ENOUGH
    while not true():
        if time.monotonic() > end:
            raise SystemExit("no answer came")
        time.sleep(0.02)


def rows(table: Table, name: str, kind: str, moves) -> None:
    """Rows of first and last numbers, or one row if they are the same."""
    times = np.array(moves)
    told = [("first", times[:, :2]), ("final", times[:, 2:])]
    for word, own in told if (times[:, 0] < times[:, 2]).any() else told[1:]:
        figures = (f(column) for column in own.T for f in (np.median, lambda x: np.quantile(x, 0.95)))
        table.add_row(name, kind, word, *(f"{value:.0f}" for value in figures))


if __name__ == "__main__":
    main()
