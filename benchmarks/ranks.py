"""Scaling over several processes: processor time, serial part, memory and efficiency.

    python benchmarks/ranks.py                              # 20 000 samples of the lap joint on two processes
    python benchmarks/ranks.py --samples 4000 --ranks 4 --scene meshes/hat_on_plate

Whole runs under ``mpirun``, including statistics and fields, with one thread a process. Times are processor seconds,
which depend little on other work of the machine. A short run of 50 samples a process gives the time t_0 of work that is
done once. The time beyond it grows with the samples: t_s for evaluating and writing a sample, t_r for reading it in the
statistics. One process would take ``t_0 + n (t_s + t_r)``; the efficiency is this time over p times that of the busiest
of p processes. An idle process with the same imports gives the memory of Python and its libraries. ``scaling.py``
predicts more samples and processes.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from measurement import peak_memory
from rich.console import Console
from rich.table import Table

import mic
from mic.execution.monte_carlo import BLOCK
from mic.execution.ranks import communicator, exit_together
from verification.ranks.study import SETTINGS, launcher

ROOT = Path(__file__).resolve().parents[1]
LAW = "coulomb"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, default=ROOT / "meshes" / "lap_joint")
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="folder for the results, which are not removed")
    parser.add_argument("--work", choices=WORK, help=argparse.SUPPRESS)  # task of a child process
    arguments = parser.parse_args()
    if arguments.work:
        WORK[arguments.work](arguments)
        return
    with tempfile.TemporaryDirectory() as temporary:
        place = arguments.folder or Path(temporary)
        place.mkdir(parents=True, exist_ok=True)
        (idle,) = processes(arguments, 1, "idle", BLOCK, place / "idle")
        short, long = BLOCK * arguments.ranks, arguments.samples
        few = processes(arguments, arguments.ranks, "run", short, place / "few")
        few = processes(arguments, arguments.ranks, "run", short, place / "short")  # also fills the caches
        many = processes(arguments, arguments.ranks, "run", long, place / "many")
        read = [processes(arguments, 1, "read", BLOCK, place / name)[0]["cpu"] for name in ("short", "many")]
        files = {path: path.stat().st_size for path in (place / "many").rglob("*") if path.is_file()}
    t_r = (read[1] - read[0]) / (long - short)
    spent = [b["cpu"] - a["cpu"] for a, b in zip(few, many)]
    t_s = (sum(spent) - t_r * (long - short)) / (long - short)
    t_0 = few[0]["cpu"] - BLOCK * t_s
    alone = t_0 + long * (t_s + t_r)
    busiest = max(one["cpu"] for one in many)
    shown = Table("process", "s, short run", "s, long run", "peak MB", "above an idle one", title=f"{long} samples")
    for rank, (a, b) in enumerate(zip(few, many)):
        above = b["peak"] - idle["peak"]
        shown.add_row(f"{rank}", f"{a['cpu']:.1f}", f"{b['cpu']:.1f}", f"{b['peak']:.0f}", f"{above:.0f}")
    console = Console()
    console.print(shown)
    console.print(
        f"t_0 = {t_0:.1f} s, t_s = {1e3 * t_s:.2f} ms, t_r = {1e3 * t_r:.3f} ms; one process alone {alone:.0f} s, "
        f"of which {(t_0 + long * t_r) / alone:.1%} are done by one; efficiency {alone / (len(many) * busiest):.1%}; "
        f"{len(files)} files, {sum(files.values()) / 1e6:.0f} MB",
        soft_wrap=True,
    )


def processes(arguments, count: int, work: str, samples: int, folder: Path) -> list[dict[str, float]]:
    """Run this program on p processes; returns the report of each, in rank order."""
    launch = [launcher(), "-n", str(count)] if count > 1 else []
    asked = ["--scene", arguments.scene, "--samples", samples, "--folder", folder, "--work", work]
    command = [*launch, sys.executable, __file__, *map(str, asked)]
    subprocess.run(command, check=True, env=os.environ | SETTINGS, stdout=subprocess.DEVNULL)
    return [json.loads((folder.parent / f"{folder.name}-{rank}.json").read_text()) for rank in range(count)]


def run(arguments) -> None:
    """One process of a whole run."""
    from mic.runs import run as run_scene

    world = communicator()
    scene = mic.load_scene(arguments.scene)
    report = scene.report.model_copy(update={"laws": [LAW]})
    number = scene.monte_carlo.model_copy(update={"samples": arguments.samples, "accuracy": None})
    scene = scene.model_copy(update={"report": report, "monte_carlo": number})
    run_scene(scene, arguments.folder, mic.cache_folder())
    tell(arguments.folder, world.rank if world else 0)
    exit_together(world, 0)


def idle(arguments) -> None:
    """Import all modules of a run and do nothing."""
    import mpi4py.MPI  # noqa: F401

    import mic.runs  # noqa: F401
    from mic.compliance import provider
    from mic.contact.laws import LAWS
    from mic.contact.native.follower import follow
    from mic.contact.native.law_equation import compiled

    provider.installed()
    follow.load()
    compiled(LAWS[LAW].equation)
    tell(arguments.folder, 0)


def read(arguments) -> None:
    """Recompute statistics and fields of a folder in one process."""
    from mic.runs import conclude

    conclude(arguments.folder)
    tell(arguments.folder, 0)


def tell(folder: Path, rank: int) -> None:
    """Report processor seconds and peak memory, MB, of this process."""
    found = {"cpu": time.process_time(), "peak": peak_memory()}
    (folder.parent / f"{folder.name}-{rank}.json").write_text(json.dumps(found))


WORK = {"run": run, "idle": idle, "read": read}

if __name__ == "__main__":
    main()
