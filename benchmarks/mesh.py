"""Mesh error of 6σ on the wheelhouse: the same samples and contact pairs on meshes of several sizes.

    python benchmarks/mesh.py                        # coarse, medium and fine against 2.83 mm; half an hour, 3 GB
    python benchmarks/mesh.py --path increments --samples 100

The last size is the reference; the first mesh provides the positions of the pairs. Two perturbations of the medium mesh
give the scale of the errors: gaps changed by up to 0.35 µm, half the error of the facets, and H changed by 0.1 % to D H
D with a random diagonal D. Samples that fail on any mesh are left out of all, and counted. The table shows the largest
difference of a 6σ from the reference (or, for perturbations, from the unperturbed mesh), relative to that 6σ and to the
largest of its kind.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from mic import cache_folder
from mic.compliance.cache import influence_coefficients
from mic.model.assembly import assemble
from mic.process.model import ReducedModel
from mic.statistics.draw import draw
from verification.mesh.study import same_points
from verification.path.study import slips
from verification.scenes import shipped, with_path


def measured(model, samples):
    """Key characteristics, tangential displacement and slip under load of each zone after clamping; failed samples."""
    scene = model.scene
    found = model.evaluate(draw(scene, scene.monte_carlo.seed, 0, samples), "coulomb")
    by_zone = slips(model, found)
    tables = {"key characteristics": found.measurements}
    for name, kind in (("tangential displacement", "displacement"), ("slip under load", "slip")):
        tables[name] = np.stack([by_zone["clamp", zone.name, kind] for zone in scene.zones], axis=1)
    return tables, found.failed


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", type=float, default=[17.5, 8.0, 5.0, 2.83], help="mm, the limit last")
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--path", default="followed", choices=["increments", "followed"])
    parser.add_argument("--increments", type=int, default=256, help="of each step")
    given = parser.parse_args()
    found, failed, points = {}, np.zeros(given.samples, bool), None
    medium = given.sizes[-3] if len(given.sizes) > 2 else None

    def keep(name, model):
        found[name], lost = measured(model, given.samples)
        failed[lost] = True
        print(f"{name}: {lost.sum()} samples failed", flush=True)

    for size in given.sizes:
        scene = shipped("wheelhouse", size)
        if given.path == "increments":
            scene = with_path(scene, "increments", given.increments)
        assembly = assemble(scene if points is None else same_points(scene, points), cache_folder())
        coefficients = influence_coefficients(assembly, cache_folder())[0]
        points = assembly.contacts if points is None else points
        print(", ".join(f"{part.name} {len(part.surface.points)} nodes" for part in assembly.parts))
        keep(f"{size:g} mm", ReducedModel.build(assembly, coefficients))
        if size == medium:
            for name, change in DISTURBED.items():
                keep(f"{size:g} mm, {name}", ReducedModel.build(*change(assembly, coefficients)))
    print(f"\n{(~failed).sum()} samples")
    limits = {name: f"{given.sizes[-1]:g} mm" if name.endswith(" mm") else f"{medium:g} mm" for name in found}
    names = [name for name in found if name != limits[name]]
    print(f"| largest difference of a 6σ, own / largest | {' | '.join(names)} |")
    print("| --- " * (len(names) + 1) + "|")
    for kind in next(iter(found.values())):
        spread = {name: 6 * tables[kind][~failed].std(axis=0, ddof=1) for name, tables in found.items()}
        cells = [off(spread[name], spread[limits[name]]) for name in names]
        largest = spread[f"{given.sizes[-1]:g} mm"].max()
        print(f"| {kind}, {largest:.2f} mm | {' | '.join(cells)} |", flush=True)


def off(sigma, limit):
    """Differences relative to the value itself and to the largest."""
    return f"{100 * np.abs(sigma / limit - 1).max():.1f} / {100 * np.abs(sigma - limit).max() / limit.max():.1f} %"


def gaps_moved(assembly, coefficients):
    moves = np.random.default_rng(0).uniform(-1, 1, assembly.contacts.gap.shape)
    return replace(
        assembly, contacts=replace(assembly.contacts, gap=assembly.contacts.gap + 0.35e-3 * moves)
    ), coefficients


def scaled(assembly, coefficients):
    random, found = np.random.default_rng(0), {}
    for name, one in coefficients.items():
        D = 1 + 0.001 * random.standard_normal(len(one.H))
        found[name] = replace(one, H=D[:, None] * one.H * D)
    return assembly, found


DISTURBED = {"gaps ± 0.35 µm": gaps_moved, "H ± 0.1 %": scaled}


if __name__ == "__main__":
    main()
