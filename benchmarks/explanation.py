"""Coverage of the regions of ``mic explain``, measured on assemblies with known sources.

    python benchmarks/explanation.py SCENE [--cases 100] [--gauge 0.002] [--size coarse] [--friction 0.05]

The sources of each assembly are drawn from the scene's distributions, its key characteristics are evaluated in full,
and gauge errors are added. The result is the share of assemblies whose sources lie in the joint 95 % region and, source
by source, in the 95 % interval; evaluations and processor seconds per assembly; and how often contacts of the assembly
have another state than in the mean assembly. With 100 cases, a coverage of 0.95 has a standard error of 0.022.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import mic
from mic.process.model import ReducedModel
from mic.statistics.normal_space import from_normal
from mic.studies.explanation import posterior, with_friction


def main() -> None:
    """Print a line for each assembly and a summary."""
    asked = _asked()
    model = _model(asked)
    names = [item.name for item in model.scene.measurements]
    own = [k for k, name in enumerate(names) if name not in asked.without]
    law, p = "coulomb", len(model.scene.deviations)
    z = np.random.default_rng(asked.seed).standard_normal((asked.cases, p))
    s = np.full(len(own), asked.gauge)
    nominal = model.process(law).evaluate(from_normal(model.scene, np.zeros((1, p))))
    held, single, changed, count, took = [], [], [], [], []
    for i, true in enumerate(z):
        made = model.process(law).evaluate(from_normal(model.scene, true[None]))
        noise = np.random.default_rng([asked.seed, i]).standard_normal(len(own))
        before = time.process_time()
        found = posterior(model, own, made.measurements[0, own] + asked.gauge * noise, s, law, seed=i)
        took.append(time.process_time() - before)
        held.append(found.holds(true))
        below = (found.z <= true).T @ found.weight
        single.append((below >= 0.025) & (below <= 0.975))
        count.append(found.evaluations)
        states = [
            (a.state != b.state).mean()
            for a, b in zip(made.resolutions.values(), nominal.resolutions.values(), strict=True)
        ]
        changed.append(max(states))
        print(
            f"{i + 1:4d} joint {np.mean(held):.3f}, {count[-1]} evaluations, {took[-1]:.1f} CPU s, "
            f"error {1e3 * found.error[own].max():.2f} µm, {found.count:.0f} samples count",
            flush=True,
        )
    error = np.sqrt(0.95 * 0.05 / len(held))
    print(f"joint {np.mean(held):.3f} ± {error:.3f} of {len(held)}")
    told = zip((item.name for item in model.scene.deviations), np.mean(single, axis=0), strict=True)
    print("each:", ", ".join(f"{name} {share:.3f}" for name, share in told))
    print(f"contacts in another state than in the mean assembly: {np.mean(changed):.1%} (most {np.max(changed):.1%})")
    print(
        f"evaluations {np.mean(count):.0f} (most {np.max(count)}), CPU s {np.mean(took):.1f} (most {np.max(took):.1f})"
    )


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Coverage of mic explain.")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--gauge", type=float, default=0.002, help="mm")
    parser.add_argument("--size", help="of all meshes")
    parser.add_argument("--without", action="append", default=[], help="characteristic that is not measured")
    parser.add_argument("--friction", type=float, help="standard deviation of unknown coefficients of friction")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def _model(asked: argparse.Namespace) -> ReducedModel:
    scene = mic.load_scene(asked.scene)
    if asked.size:
        parts = [part.model_copy(update={"size": asked.size}) for part in scene.parts]
        scene = scene.model_copy(update={"parts": parts})
    model = mic.reduce(scene)
    return with_friction(model, asked.friction) if asked.friction else model


if __name__ == "__main__":
    main()
