"""Memory and time of statistics, fields and report as functions of the number of samples.

    python benchmarks/growth.py                      # 10⁴ and 10⁵ samples of the lap joint, a few minutes
    python benchmarks/growth.py 10000 1000000        # a million takes half an hour and 4 GB of disk

One evaluation of the lap joint is repeated to the number of samples and written by the program's own writer; reading
does not depend on the repetition. A process for each folder then computes the statistics and the report: peak resident
memory and wall time by phase. The last line is the time per sample of a run, evaluation and files.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from measurement import peak_memory
from rich.console import Console
from rich.table import Table

import mic
from mic.compliance.cache import influence_coefficients
from mic.execution.monte_carlo import blocks
from mic.model.assembly import assemble
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.report.page import write_report
from mic.results.run_folder import Block, RunFolder, versions
from mic.results.run_identity import identity, inputs
from mic.runs import conclude, sample_into, write_evaluation
from mic.statistics.draw import draw

LAW = "coulomb"
DISTINCT = 5000  # samples that are evaluated and then repeated
MEASURED = 20_000  # samples of the run that is timed
ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("samples", nargs="*", type=int, default=[10_000, 100_000])
    parser.add_argument("--scene", type=Path, default=ROOT / "meshes" / "lap_joint")
    parser.add_argument("--folder", type=Path, help="folder for the results folders, which are not removed")
    parser.add_argument("--read", type=Path, help=argparse.SUPPRESS)  # this program in a process of its own
    arguments = parser.parse_args()
    if arguments.read:
        print(json.dumps(read(arguments.read)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        place = arguments.folder or Path(temporary)
        scene = mic.load_scene(arguments.scene)
        assembly = assemble(scene, place / "cache")
        influence, _ = influence_coefficients(assembly, place / "cache")
        model = ReducedModel.build(assembly, influence)
        evaluation = model.process(LAW, threads=os.cpu_count() or 1).evaluate(draw(scene, 1, 0, DISTINCT))
        shown = Table("samples", "files", "MB", "peak MB", "s", "µs per sample and pair", "of it: read, fields, report")
        for count in arguments.samples:
            folder = place / str(count)
            write(folder, assembly, model, evaluation, count)
            command = [sys.executable, __file__, "--read", str(folder)]
            found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            files = [path for path in folder.rglob("*") if path.is_file()]
            seconds = sum(found["seconds"])
            shown.add_row(
                f"{count}",
                f"{len(files)}",
                f"{sum(path.stat().st_size for path in files) / 1e6:.0f}",
                f"{found['peak']:.0f}",
                f"{seconds:.1f}",
                f"{1e6 * seconds / count / max(len(model.contacts), 1):.1f}",
                ", ".join(f"{s:.1f}" for s in found["seconds"]),
            )
        Console().print(shown)
        start = time.perf_counter()
        sample_into(place / "run", model, [LAW], MEASURED, 1)
        seconds = time.perf_counter() - start
        print(f"A run of {MEASURED} samples takes {1e3 * seconds / MEASURED:.2f} ms a sample, its files included.")


def write(folder: Path, assembly, model: ReducedModel, evaluation: Evaluation, samples: int) -> None:
    """Results folder of a run, without statistics."""
    store, whose = RunFolder(folder), identity(model, 1)
    record = {"scene": model.scene.name, "samples": samples, "seed": 1, "laws": [LAW]}
    store.write_record(record | {"identity": whose, "inputs": inputs(model, 1), "versions": versions()})
    store.store_inputs(assembly)
    model.save(folder / "model.npz")
    for law, first, count in blocks([LAW], samples, len(model.contacts)):
        block = rows(evaluation, (first + np.arange(count)) % len(evaluation.deviations))
        write_evaluation(store, Block(law, first, count), whose, model, block)


def rows(evaluation: Evaluation, number: np.ndarray) -> Evaluation:
    """Copies of the samples of an evaluation with the given numbers."""

    def chosen(item):
        arrays = [field.name for field in fields(item) if isinstance(getattr(item, field.name), np.ndarray)]
        return replace(item, **{name: getattr(item, name)[number] for name in arrays})

    resolutions = {
        stage: replace(chosen(resolution), trace=chosen(resolution.trace))
        for stage, resolution in evaluation.resolutions.items()
    }
    equilibrium = lambda: (evaluation.functional_force[number], evaluation.motion[number])
    return replace(chosen(evaluation), resolutions=resolutions, equilibrium=equilibrium)


def read(folder: Path) -> dict:
    """Statistics, fields and report: peak memory in MB, and seconds of each."""
    start = time.perf_counter()
    outcome = conclude(folder)
    middle = time.perf_counter()
    write_report(folder, outcome)
    wall = outcome.record["wall_time"]
    seconds = [middle - start - wall["fields"], wall["fields"], time.perf_counter() - middle]
    return {"peak": peak_memory(), "seconds": seconds}


if __name__ == "__main__":
    main()
