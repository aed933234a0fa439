"""A large assembly from end to end: time of each phase of a run of the body side, and the share of forming S.

    python benchmarks/large.py                        # twelve parts, two thousand candidates; a few minutes
    python benchmarks/large.py --spacing 15 --samples 10         # three thousand
    python benchmarks/large.py --increments 1         # one increment per step instead of the followed path
    python benchmarks/large.py --increments 1 --growth 80 40 20        # spacings, and exponents of growth

One process, one thread. Time is processor time; memory is the peak of the process so far. Influence coefficients are
computed anew unless `--cache` names a folder with cached ones. *columns* is the number of columns of S and of the
measurement rows that were formed, over all eliminations, of the total; *dense* is their memory if all were formed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from measurement import alone, exponents, peak_memory

import mic
from mic.compliance.cache import influence_coefficients
from mic.model.assembly import assemble
from mic.process.model import ReducedModel
from mic.statistics.draw import draw
from verification.scenes import with_path

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "meshes" / "body_side" / "body_side.toml"
COMPILES = ROOT / "meshes" / "lap_joint"  # evaluated once before, so that compilation is no part of what is measured


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--spacing", type=float, help="between candidates, mm; default: the scene's")
    parser.add_argument("--increments", type=int, help="of a step; default: the path is followed")
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--growth", nargs="+", type=float, metavar="SPACING", help="measure each in its own process")
    arguments = parser.parse_args()
    if arguments.growth:
        found = []
        for spacing in arguments.growth:
            arguments.spacing = spacing
            costs, memory = alone(separately, arguments)
            found.append(costs | {"memory": memory})
        candidates = [costs.pop("candidates") for costs in found]
        print("exponents:", exponents(candidates, {name: [costs[name] for costs in found] for name in found[0]}))
        return
    separately(arguments)


def separately(arguments) -> dict[str, float]:
    """Measure one case with a cache of its own, if none is named."""
    with tempfile.TemporaryDirectory() as temporary:
        return measure(arguments, arguments.cache or Path(temporary))


def measure(arguments, cache: Path) -> dict[str, float]:
    """Print the phases of one case; its candidates and the seconds of set-up, prediction and a sample."""
    scene = mic.load_scene(SCENE)
    if arguments.spacing:
        zones = [zone.model_copy(update={"spacing": arguments.spacing}) for zone in scene.zones]
        scene = scene.model_copy(update={"zones": zones})
    if arguments.increments:
        scene = with_path(scene, "increments", arguments.increments)
    phases = Phases()
    phases.start()
    assembly = assemble(scene, cache)
    phases.end("meshes and pairs")
    influence, _ = influence_coefficients(assembly, cache)
    phases.end("influence coefficients")
    model = ReducedModel.build(assembly, influence)
    phases.end("reduced model")
    model.eliminations  # noqa: B018
    phases.end("elimination of all steps")
    phases.pause(lambda: mic.reduce(mic.load_scene(COMPILES), cache).evaluate({}))
    model.forecast  # noqa: B018
    phases.end("prediction of candidates in contact")
    found = model.process("coulomb").evaluate(draw(scene, scene.monte_carlo.seed, 0, arguments.samples))
    phases.end(f"{arguments.samples} samples", arguments.samples)
    own = {id(one.response): one.response for steps in model.eliminations.values() for one in steps}
    every = {id(columns): columns for one in own.values() for columns in (one.S, one.S_out)}.values()
    formed, all_ = (sum(count(columns) for columns in every) for count in (lambda c: c.found, lambda c: c.shape[1]))
    dense = sum(8e-6 * columns.shape[0] * columns.shape[1] for columns in every)
    kept = sum(8e-6 * columns.shape[0] * columns.found for columns in every)
    touch = max((one.force[:, :, 0] > 0).sum(axis=1).mean() for one in found.resolutions.values())
    parts, pairs = len(scene.parts), len(model.contacts)
    print(f"{parts} parts, {model.compliance.size} functionals, {pairs} candidates, of which {touch:.0f} touch;")
    print(f"{len(scene.welds)} welds, {len(scene.clamps)} clamps, {len(own)} eliminations;")
    print(f"columns: {formed} of {all_}, {kept:.0f} MB; dense {dense:.0f} MB;")
    print(
        f"H of all parts as one matrix would take {8e-6 * model.compliance.size**2:.0f} MB, by parts it takes", end=""
    )
    print(f" {sum(8e-6 * H.size for H in model.compliance.H):.0f} MB;")
    residual = max(np.nanmax(one.residual) for one in found.resolutions.values())
    print(
        f"{int(found.failed.sum())} of {arguments.samples} samples failed; largest residual {residual:.1e}", flush=True
    )
    *set_up, predicted, sampled = phases.seconds
    each = sampled / arguments.samples
    return {"candidates": pairs, "pairing": set_up[0], "set-up": sum(set_up), "prediction": predicted, "sample": each}


class Phases:
    """Processor time and peak memory of one phase after the other."""

    def __init__(self):
        print(f"{'phase':<28} {'s':>8} {'ms a sample':>12} {'peak MB so far':>15}")
        self.seconds: list[float] = []
        self.start()

    def start(self) -> None:
        """Start the next phase."""
        self.begin = time.process_time()

    def end(self, name: str, samples: int = 0) -> None:
        """End a phase and start the next."""
        seconds = time.process_time() - self.begin
        each = f"{1e3 * seconds / samples:.0f}" if samples else ""
        self.seconds.append(seconds)
        print(f"{name:<28} {seconds:8.2f} {each:>12} {peak_memory():15.0f}", flush=True)
        self.start()

    def pause(self, work) -> None:
        """Exclude a block of code from the measurement."""
        work()
        self.start()


if __name__ == "__main__":
    main()
