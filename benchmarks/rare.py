"""Probability of rare misses by plain sampling, subset simulation and the first-order method: agreement and cost.

python benchmarks/rare.py                                 # the lap joint, M1 within ±1.4 mm, 100 000 plain samples
python benchmarks/rare.py --samples 2000 --limit 1.0
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import mic
from mic.statistics.draw import draw
from mic.statistics.estimates import share
from mic.studies.rare import rare

HERE = Path(__file__).resolve().parents[1]
BLOCK = 500


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--scene", type=Path, default=HERE / "meshes" / "lap_joint" / "scene.toml")
    options.add_argument("--measurement", default="M1")
    options.add_argument("--limit", type=float, default=1.4, help="mm, on either side")
    options.add_argument("--samples", type=int, default=100_000, help="plain ones")
    options.add_argument("--levels", type=int, default=1000, help="samples of a level of the subset simulation")
    options.add_argument("--law", default="coulomb")
    asked = options.parse_args()

    scene = mic.load_scene(asked.scene)
    item = next(one for one in scene.measurements if one.name == asked.measurement)
    item = item.model_copy(update={"lower": -asked.limit, "upper": asked.limit})
    model = mic.reduce(scene.model_copy(update={"measurements": [item]}))

    start = time.process_time()
    found = rare(model, asked.law, samples=asked.levels, seed=1)
    row = found.table.iloc[0]
    print(f"subset simulation: {1e6 * row['outside']:.0f} ({1e6 * row['outside_low']:.0f} to "
          f"{1e6 * row['outside_high']:.0f}) of a million, {row['evaluations']} evaluations")  # fmt: skip
    print(f"to first order: {1e6 * row['first_order']:.0f}; agrees: {row['agrees']}; both {_since(start)}")
    print(found.points.to_string(index=False), flush=True)

    start, process, beyond, valid = time.process_time(), model.process(asked.law), 0, 0
    for first in range(0, asked.samples, BLOCK):
        done = process.attempt(draw(model.scene, 2, first, min(BLOCK, asked.samples - first)))
        y = done.measurements[~done.failed, 0]
        beyond, valid = beyond + int((np.abs(y) > asked.limit).sum()), valid + len(y)
    plain = share(beyond, valid)
    print(f"plain: {1e6 * float(plain.value):.0f} ({1e6 * float(plain.low):.0f} to {1e6 * float(plain.high):.0f}) of a "
          f"million, {beyond} of {valid}, {asked.samples - valid} failed, {_since(start)}")  # fmt: skip


def _since(start: float) -> str:
    return f"{time.process_time() - start:.0f} s of processor time"


if __name__ == "__main__":
    main()
