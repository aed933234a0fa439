"""Solve one assembly of a scene by full finite elements: ``mpirun -n 2 python -m mpi4py -m fem_reference SCENE --sample
3``."""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from mpi4py import MPI

import mic
from fem_reference.full.model import LAWS, ROUTES, ContactFailure, FullModel
from mic.model.assembly import assemble
from mic.statistics.draw import draw


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m fem_reference", description="Full frictional contact solve of one assembly."
    )
    parser.add_argument("scene", help="scene file, or a folder that holds scene.toml")
    parser.add_argument(
        "--sample", type=int, help="number of the Monte Carlo sample (default: all deviations at their means)"
    )
    parser.add_argument("--law", choices=LAWS, default="coulomb")
    parser.add_argument("--every-node", action="store_true", help="contact at every mesh node of the zones")
    parser.add_argument("--deviated", action="store_true", help="solve on the meshes that carry the deviation")
    parser.add_argument(
        "--route",
        choices=ROUTES,
        default="whole",
        help="Newton's method on all unknowns, or on contact forces alone, by a compliance (default: whole)",
    )
    options = parser.parse_args()
    comm, started = MPI.COMM_WORLD, time.perf_counter()
    try:
        scene = mic.load_scene(options.scene)
        if options.sample is None:
            deviations = np.array([deviation.mean for deviation in scene.deviations])
        elif options.sample < 0:
            parser.error("--sample: samples are counted from 0")
        else:
            deviations = draw(scene, scene.monte_carlo.seed, options.sample, 1)[0]
        assembly = assemble(scene, mic.cache_folder(), every_node=options.every_node)
        model = FullModel(assembly, deviated=options.deviated, route=options.route)
        full = model.evaluate(deviations, options.law)
    except (mic.SceneError, ContactFailure) as problem:  # the same on every process
        if comm.rank == 0:
            print(problem, file=sys.stderr)
        return 1
    if comm.rank == 0:
        _print(scene, assembly, full)
        print(
            f"\nroute: {full.route}; {len(full.history)} Newton solves, "
            f"{sum(len(solve.iterations) for solve in full.history)} iterations, "
            f"{time.perf_counter() - started:.1f} s on {comm.size} process{'es' if comm.size > 1 else ''}"
        )
    return 0


def _print(scene, assembly, full):
    print(
        f"{'stage':12}{'zone':16}{'open':>6}{'stick':>6}{'slip':>6}"
        f"{'normal force, N':>18}{'largest, N':>12}{'RMS slip, mm':>14}"
    )
    for stage, resolution in full.resolutions.items():
        for number, zone in enumerate(scene.zones):
            own = assembly.contacts.zone == number
            force, slip = resolution.force[own], np.linalg.norm(resolution.displacement[own, 1:], axis=1)
            states = "".join(f"{count:6d}" for count in np.bincount(resolution.state[own], minlength=3))
            print(
                f"{stage:12.12}{zone.name:16.16}{states}"
                f"{force[:, 0].sum():18.4f}{force[:, 0].max():12.4f}{np.sqrt((slip**2).mean()):14.5f}"
            )
    for measurement, value in zip(scene.measurements, full.measurements):
        print(f"{measurement.name:28}{value:12.5f} mm")


if __name__ == "__main__":
    sys.exit(main())
