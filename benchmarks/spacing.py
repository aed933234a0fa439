"""Effect of the spacing of contact candidates: the same samples with ever denser candidates.

    python benchmarks/spacing.py                                        # the shipped scenes that have candidates
    python benchmarks/spacing.py --scene my_deck --samples 200 --shares 1 0.7 0.5
    python benchmarks/spacing.py --scene meshes/hat_on_plate --shares 1 --every-node

One process, one thread, Coulomb's law, the path settings of the scene. Each row has candidates at a share of the
default spacing, or at every node of both sheets; the last row of a scene is the reference. *nominal* is the largest key
characteristic without deviations. The next columns are the largest difference from the reference of nominal key
characteristics, of their means and 6σ; of the mean normal force of a stage, farther than three radii from all welds;
and of the mean work of friction in a zone. The last two are relative to the largest. *unseen* is the deepest
penetration between the candidates. Processor seconds are those of the samples without the compliance.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import mic
from mic.compliance.cache import influence_coefficients
from mic.errors import SceneError
from mic.model.assembly import assemble
from mic.model.nuggets import nuggets
from mic.process.model import ReducedModel
from mic.statistics.draw import draw

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = [ROOT / "meshes" / name for name in ("lap_joint", "hat_on_plate", "wheelhouse/watched.toml")]
BEYOND = 3.0  # radii of a nugget: within it, sums of normal forces do not converge
COLUMNS = ("scene", "spacing", "pairs", "CPU, s", "nominal, µm", "Δ nominal, µm", "Δ mean, µm", "Δ 6σ, µm", "Δ 6σ, %")
COLUMNS += ("Δ Σfₙ, %", "Δ work, %", "unseen, µm")


@dataclass(frozen=True)
class Row:
    """One scene at one spacing; mm, N, processor seconds.

    k key characteristics, s stages that resolve contact, z zones.
    """

    name: str
    pairs: int
    seconds: float
    nominal: np.ndarray  # (k,)
    mean: np.ndarray  # (k,)
    six_sigma: np.ndarray  # (k,)
    force: np.ndarray  # (s,)
    work: np.ndarray  # (z,)
    unseen: float

    def beside(self, scene: str, last: Row) -> list[str]:
        """Cells of the table."""
        um = [np.abs(getattr(self, key) - getattr(last, key)).max() for key in ("nominal", "mean", "six_sigma")]
        share = np.abs(self.six_sigma / last.six_sigma - 1).max()
        percent = [100 * share, *(worst(getattr(self, key), getattr(last, key)) for key in ("force", "work"))]
        numbers = [self.seconds, 1e3 * np.abs(self.nominal).max(), *(1e3 * value for value in um), *percent]
        return [scene, self.name, str(self.pairs), *(f"{value:.2f}" for value in [*numbers, 1e3 * self.unseen])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="+", type=Path, default=SHIPPED)
    parser.add_argument("--shares", nargs="+", type=float, default=[1.0, 0.8, 0.7, 0.6, 0.5])
    parser.add_argument("--every-node", action="store_true", help="every node of both sheets as the last row")
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--seed", type=int, default=777, help="not that of the scenes")
    arguments = parser.parse_args()
    table = Table(*COLUMNS)
    for path in arguments.scene:
        rows = measure(mic.load_scene(path), arguments)
        for row in rows:
            table.add_row(*row.beside(path.stem, rows[-1]))
    Console(width=160).print(table)


def measure(scene, arguments) -> list[Row]:
    """Rows of one scene. A spacing that its elements cannot resolve is skipped and printed."""
    cache = mic.cache_folder()
    scene = scene.model_copy(update={"report": scene.report.model_copy(update={"fields": False, "laws": ["coulomb"]})})
    rows = []
    for share in arguments.shares:
        zones = [zone.model_copy(update={"spacing_factor": share * zone.spacing_factor}) for zone in scene.zones]
        try:
            assembly = assemble(scene.model_copy(update={"zones": zones}), cache)
        except SceneError as problem:
            print(problem)
            continue
        rows.append(evaluate(f"{share:g}", assembly, arguments))
    if arguments.every_node:
        rows.append(evaluate("every node", assemble(scene, cache, every_node=True), arguments))
    return rows


def evaluate(name: str, assembly, arguments) -> Row:
    """One row."""
    model = ReducedModel.build(assembly, influence_coefficients(assembly, mic.cache_folder())[0])
    samples = draw(model.scene, arguments.seed, 0, arguments.samples)
    nominal = model.evaluate(np.zeros_like(samples[:1]))  # compiles and predicts the working set
    start = time.process_time()
    found = model.evaluate(samples)
    seconds = time.process_time() - start
    contacts, kept = model.contacts, ~found.failed
    beyond = nuggets(model.scene, contacts.zone, contacts.point, contacts.frame[:, :, 0], BEYOND) < 0
    stages = found.resolutions.values()
    work = sum((one.trace.work[kept].mean(axis=0) for one in stages), np.zeros(len(contacts)))
    values = found.measurements[kept]
    return Row(
        name,
        len(contacts),
        seconds,
        nominal.measurements[0],
        values.mean(axis=0),
        6 * values.std(axis=0, ddof=1),
        np.array([one.force[kept][:, beyond, 0].sum(axis=1).mean() for one in stages]),
        np.bincount(contacts.zone, work, len(model.scene.zones)),
        max((float(one.unseen.max()) for one in found.resolutions.values()), default=0.0),
    )


def worst(value: np.ndarray, last: np.ndarray) -> float:
    """Largest difference, % of the largest."""
    return float(100 * np.abs(value - last).max(initial=0.0) / max(np.abs(last).max(initial=0.0), 1e-12))


if __name__ == "__main__":
    main()
