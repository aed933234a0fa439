"""Time of `mic run`, phase by phase, with warm or cold caches.

    python benchmarks/run.py                                 # the wheelhouse, as it is shipped
    python benchmarks/run.py --one-step                      # one step per stage instead of the followed path
    python benchmarks/run.py --cold                          # nothing cached, nothing compiled
    python benchmarks/run.py meshes/lap_joint --samples 100

Processor seconds of the main process with all its threads, the smaller of two runs, and the wall time of the whole run.
Worker processes, which evaluate half of the blocks and draw half of the pictures on the second core, count only in the
wall time. Warm: meshes, contact pairs, influence coefficients and compiled code come from a first run; the results
folder is new. The last table measures separate processes in the environment of the run: the import, the help, and the
first evaluation of a loaded model.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
IMPORTS, REPORT, IN_ALL, WALL = "start and imports", "report", "processor time in all", "wall time"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", type=Path, default=ROOT / "meshes" / "wheelhouse")
    parser.add_argument("--samples", type=int, help="default: those of the scene")
    parser.add_argument("--one-step", action="store_true", help="one step per stage, the path not followed")
    parser.add_argument("--cold", action="store_true", help="with nothing cached and nothing compiled")
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)  # the run itself, in a separate process
    arguments = parser.parse_args()
    if arguments.into:
        print(json.dumps(spent(arguments)))
        return
    with tempfile.TemporaryDirectory() as place:
        environment = dict(os.environ)
        if arguments.cold:
            environment |= {"MIC_CACHE": f"{place}/cache", "NUMBA_CACHE_DIR": f"{place}/compiled"}
        runs = []
        for number in range(1 if arguments.cold else 3):
            start = time.perf_counter()
            command = [sys.executable, *sys.argv, "--into", f"{place}/{number}"]
            done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True, text=True)
            runs.append(json.loads(done.stdout.splitlines()[-1]) | {WALL: time.perf_counter() - start})
        warm = runs if arguments.cold else runs[1:]  # the first fills the caches
    shown = Table("phase", "s", title=f"{arguments.scene.name}, {'cold' if arguments.cold else 'warm'}")
    best = {phase: min(run[phase] for run in warm) for phase in warm[0]}
    wall = best.pop(WALL)
    # the first phase that uses a module includes the time of importing it
    for phase, seconds in [*best.items(), (IN_ALL, sum(best.values())), (WALL, wall)]:
        shown.add_row(phase, f"{seconds:.2f}")
    console = Console(width=100)
    console.print(shown)
    console.print(starts(environment, arguments.scene))


def starts(environment: dict[str, str], scene: Path) -> Table:
    """Processor seconds of start-up before anything is computed, the smaller of two runs."""
    reads = "import mic, sys; mic.reduce(mic.load_scene(sys.argv[1]))"
    loaded, evaluated = ([sys.executable, "-c", code, str(scene)] for code in (reads, f"{reads}.evaluate({{}})"))
    shown = Table("start", "s")
    for name, command in (
        ("nothing", [sys.executable, "-c", "pass"]),
        ("import mic", [sys.executable, "-c", "import mic"]),
        ("mic --help", [sys.executable, "-m", "mic.cli", "--help"]),
        ("a model from the cache", loaded),
        ("it and a first evaluation", evaluated),
    ):
        runs = []
        for _ in range(2):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            runs.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        shown.add_row(name, f"{min(runs):.2f}")
    return shown


def spent(arguments: argparse.Namespace) -> dict[str, float]:
    """Seconds of processor time of each phase of one run."""
    from mic import cache_folder, load_scene, runs
    from mic.commands.invocation import with_options
    from mic.commands.output import CommandConsole
    from mic.commands.run import ReportProgress
    from mic.report.page import write_report
    from verification.scenes import with_path

    found = {IMPORTS: time.process_time()}
    scene = with_options(load_scene(arguments.scene), None, arguments.samples)
    if arguments.one_step:
        everything = scene.monte_carlo.model_copy(update={"accuracy": None})
        scene = with_path(scene.model_copy(update={"monte_carlo": everything}), "one-step")
    runs.time = SimpleNamespace(perf_counter=time.process_time)  # the clock of a run's phases
    quiet = ReportProgress(CommandConsole(quiet=True))
    outcome = runs.run(scene, arguments.into, cache_folder(), quiet)
    found |= outcome.record["wall_time"]
    start = time.process_time()
    write_report(outcome.folder, outcome, quiet.pictures)
    quiet.stop()
    return found | {REPORT: time.process_time() - start}


if __name__ == "__main__":
    main()
