"""What the wheelhouse's meshes leave in 6σ: the same samples, pairs at the same points, on meshes of other sizes.

    python benchmarks/mesh.py                        # medium and fine against 2.83 mm, plain increments, half an hour
    python benchmarks/mesh.py --samples 200 --path followed

The last size is the limit. Samples that fail on one of the meshes are left out on all, and counted.
"""

from __future__ import annotations

import argparse

import numpy as np

from mic import cache_folder
from mic.sampling.draw import draw
from verification.comparison import reduced_and_assembly
from verification.mesh.study import same_points
from verification.path.study import slips
from verification.scenes import going, shipped


def measured(model, samples):
    """Key characteristics, tangential displacement and slip under load of each zone after clamping, and who failed."""
    scene = model.scene
    found = model.evaluate(draw(scene, scene.monte_carlo.seed, 0, samples), "coulomb")
    by_zone = slips(model, found)
    tables = {"key characteristics": found.measurements}
    for name, kind in (("tangential displacement", "displacement"), ("slip under load", "slip")):
        tables[name] = np.stack([by_zone["clamp", zone.name, kind] for zone in scene.zones], axis=1)
    return tables, found.failed


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", type=float, default=[8.0, 5.0, 2.83], help="mm, the limit last")
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--path", default="increments", choices=["increments", "followed"])
    parser.add_argument("--increments", type=int, default=256, help="of each step")
    given = parser.parse_args()
    found, failed, points = [], np.zeros(given.samples, bool), None
    for size in given.sizes:
        scene = shipped("wheelhouse", size)
        if given.path == "increments":
            scene = going(scene, "increments", given.increments)
        model, assembly = reduced_and_assembly(scene if points is None else same_points(scene, points), cache_folder())
        points = assembly.contacts if points is None else points
        nodes = ", ".join(f"{part.name} {len(part.surface.points)} nodes" for part in assembly.parts)
        tables, lost = measured(model, given.samples)
        failed |= lost
        found.append(tables)
        print(f"{size:g} mm: {nodes}; {lost.sum()} samples failed", flush=True)
    print(f"{(~failed).sum()} samples; off in 6σ, each of its own and the largest of its kind, %:")
    for kind, limit in found[-1].items():
        spread = [6 * tables[kind][~failed].std(axis=0, ddof=1) for tables in (*found[:-1], {kind: limit})]
        for size, sigma in zip(given.sizes, spread[:-1]):
            own = ", ".join(f"{value:+.1f}" for value in 100 * (sigma / spread[-1] - 1))
            largest = 100 * np.abs(sigma - spread[-1]).max() / spread[-1].max()
            print(f"{kind}, {size:g} mm: {own}; of the largest {largest:.1f}")


if __name__ == "__main__":
    main()
