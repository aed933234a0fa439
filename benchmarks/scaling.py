"""Speed-up on many workers, by simulation from measured times of blocks and of the work that one process does.

    python benchmarks/scaling.py                             # lap joint, 10⁴ and 10⁶ samples of each law
    python benchmarks/scaling.py --scene meshes/wheelhouse --samples 1000000 --workers 2 128

Measured in processor seconds, which depend little on other work of the machine: a whole run of few samples; evaluation,
files and statistics of blocks of two sizes under each law; what the first process does with the result of a block; and
what the displacement fields read of it. The simulation gives the pieces of all blocks, as a run divides them, to the
next idle worker, and their results to the first process, which takes one after the other.
"""

from __future__ import annotations

import argparse
import heapq
import pickle
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

import mic
from mic.compliance.cache import influence_coefficients
from mic.execution.monte_carlo import BLOCK, JOIN, SIZES, Block, blocks, pieces
from mic.model.assembly import assemble
from mic.process.model import ReducedModel
from mic.report.page import write_report
from mic.results.low_rank_forces import ForceAccumulator
from mic.results.outcome import BlockCache
from mic.results.run_folder import Block as StoredBlock
from mic.results.run_folder import RunFolder
from mic.results.schema import CONDENSED
from mic.runs import run, write_evaluation
from mic.statistics.draw import draw

ROOT = Path(__file__).resolve().parents[1]
FAR = 100_000  # number of a sample whose contact pairs are not stored


@dataclass(frozen=True)
class Costs:
    """Measured times, s.

    Attributes
    ----------
    once : float
        Start, model, and end of a run.
    block, sample : dict of str to float
        Work on a block of n samples by law: ``block + n sample``.
    taken, read : float
        What the first process does with a block during the run, and after it.
    """

    once: float
    block: dict[str, float]
    sample: dict[str, float]
    taken: float
    read: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, default=ROOT / "meshes" / "lap_joint")
    parser.add_argument("--samples", type=int, nargs="*", default=[10**4, 10**6])
    parser.add_argument("--workers", type=int, nargs="*", default=[2, 16, 128, 1024])
    arguments = parser.parse_args()
    console = Console()
    with tempfile.TemporaryDirectory() as temporary:
        laws, pairs, costs = measure(arguments.scene, Path(temporary))
    work = ", ".join(
        f"{law} {1e3 * costs.block[law]:.0f} ms + {1e3 * costs.sample[law]:.2f} ms a sample" for law in laws
    )
    console.print(
        f"once {costs.once:.1f} s; blocks: {work}; first process: {1e3 * costs.taken:.1f} ms for each block during the "
        f"run, {1e3 * costs.read:.1f} ms after it",
        soft_wrap=True,
    )
    shown = Table("samples", "blocks", "1 worker", *(f"{workers}" for workers in arguments.workers))
    for samples in arguments.samples:
        every = blocks(laws, samples, pairs)
        alone = duration(every, 1, costs)
        took = [duration(every, workers, costs) for workers in arguments.workers]
        cells = [f"{t:.0f} s, {alone / t:.1f} ×, {alone / t / p:.0%}" for p, t in zip(arguments.workers, took)]
        shown.add_row(f"{samples}", f"{len(every)}", f"{alone:.0f} s", *cells)
    console.print(shown)


def duration(every: list[Block], workers: int, costs: Costs) -> float:
    """Wall time of a run, s."""
    idle, first = [0.0] * workers, 0.0
    arrived = []
    for piece in pieces(every, workers, max(costs.sample.values())):
        took = costs.sample[piece.law] * piece.count
        end = heapq.heappop(idle) + took + (costs.block[piece.law] if piece.whole else JOIN)
        heapq.heappush(idle, end)
        last = piece.first + piece.count == piece.block[1] + piece.block[2]
        arrived.append((end, costs.taken if piece.whole else JOIN + last * costs.block[piece.law]))
    if workers == 1:
        first = idle[0] + sum(took for _, took in arrived)
    for end, took in sorted(arrived) if workers > 1 else ():
        first = max(first, end) + took
    return costs.once + first + costs.read * len(every)


def measure(path: Path, place: Path) -> tuple[list[str], int, Costs]:
    """Laws, number of contact pairs, and costs of a scene."""
    imports = time.process_time()
    scene = mic.load_scene(path)
    assembly = assemble(scene, mic.cache_folder())
    influence, _ = influence_coefficients(assembly, mic.cache_folder())  # fills the cache
    laws, few = scene.report.laws, scene.monte_carlo.model_copy(update={"samples": BLOCK})
    start = time.process_time()
    short = scene.model_copy(update={"monte_carlo": few})
    outcome = run(short, place / "run", mic.cache_folder(), progress=False, engine="local:1")
    write_report(place / "run", outcome)
    whole = imports + time.process_time() - start
    model = ReducedModel.build(assembly, influence)
    store, cache, size = RunFolder(place / "run"), BlockCache(), {}
    results = []
    for law in laws:
        model.process(law).attempt(draw(scene, 1, 0, 2))
        spent = []
        for count in (BLOCK, SIZES[-1]):
            start = time.process_time()
            evaluation = model.process(law).attempt(draw(scene, 1, FAR, count))
            block = StoredBlock(law, FAR, count)
            results.append(pickle.dumps(write_evaluation(store, block, "measured", model, evaluation)[1], 5))
            spent.append(time.process_time() - start)
        sample = (spent[1] - spent[0]) / (SIZES[-1] - BLOCK)
        size[law] = (spent[0] - BLOCK * sample, sample)
    start = time.process_time()
    for number, result in enumerate(results * 10):
        cache.store(StoredBlock(laws[0], number * BLOCK, BLOCK), pickle.loads(result))
    taken = (time.process_time() - start) / (10 * len(results))
    accumulators, start = [ForceAccumulator() for _ in model.compliance.functionals], time.process_time()
    for _ in range(20 if scene.report.fields else 0):
        compressed = store.read_arrays(CONDENSED, StoredBlock(laws[0], FAR, SIZES[-1]), "measured")
        for part, rows in zip(accumulators, compressed):
            part.join(rows)
    read = (time.process_time() - start) / 20
    once = whole - sum(block + BLOCK * sample for block, sample in size.values())
    block, sample = ({law: max(size[law][i], 0.0) for law in laws} for i in range(2))
    return laws, len(model.contacts), Costs(once, block, sample, taken, read)


if __name__ == "__main__":
    main()
