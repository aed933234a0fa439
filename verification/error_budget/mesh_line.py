"""The mesh line of a run's error budget against meshes halved several times."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from mic.model.mesh_accuracy import with_halved_elements
from mic.results.schema import MESH_CHANGES
from mic.runs import run
from mic.scene import Scene
from verification.comparison import reduced_and_assembly, reduced_model
from verification.scenes import shipped, with_path
from verification.strips import build

__all__ = ["effectivities", "scenes", "three_strips"]

SAMPLES = 40
SMALLEST = 1e-3  # of the printed 6σ: a smaller change moves no digit of a Cpk
GAP = 0.008  # mm, between neighbours of three strips
LAW = "coulomb"


def three_strips(folder: Path, size: float = 5.0) -> Scene:
    """Three strips, 8 µm apart, pinched in their middle; the gap between two of them is a key characteristic."""
    height = {"base": 0.0, "middle": 1 + GAP, "cover": 2 * (1 + GAP)}
    start, length = {"base": 0.0, "middle": 20.0, "cover": 10.0}, {"base": 120.0, "middle": 110.0, "cover": 100.0}
    coarser = {"base": 1.0, "middle": 1.1, "cover": 0.95}  # the meshes do not match
    material = {"width": 25.0, "thickness": 1.0, "young": 210e3, "poisson": 0.3}
    sheets = {
        name: {"x": start[name], "z": z, "length": length[name], "size": size * coarser[name]} | material
        for name, z in height.items()
    }
    up, along, across = [0, 0, 1], [1, 0, 0], [0, 1, 0]
    locators = [
        {"name": f"{name}-{i}", "part": name, "point": [x, y, height[name]], "direction": direction}
        for name in sheets
        for near, far in [(start[name] + 5, start[name] + length[name] - 5)]
        for i, (x, y, direction) in enumerate(
            [(near, 5, up), (near, 20, up), (far, 12.5, up), (near, 5, across), (far, 5, across), (near, 12.5, along)]
        )
    ]
    at = lambda part, x, y, direction=up: {"part": part, "point": [x, y, height[part]], "direction": direction}
    press = {"force": 40.0, "radius": 4.0}
    forces = (("cover", 40, 20, 2.0), ("middle", 80, 5, -1.0))
    deviations = [
        {"name": part, "kind": "force", "mean": mean, "sigma": 1.0} | at(part, x, y) for part, x, y, mean in forces
    ]
    limits = {"lower": -0.1, "upper": 0.1}
    return build(
        folder,
        sheets,
        name="three-strips",
        locators=locators,
        clamps=[
            {"name": "down"} | at("cover", 60, 12.5, [0, 0, -1]) | press,
            {"name": "up"} | at("base", 60, 12.5) | press,
        ],
        zones=[
            {"name": "-".join(pair), "parts": list(pair), "friction": 0.2}
            for pair in (("base", "middle"), ("middle", "cover"))
        ],
        deviations=[*deviations, {"name": "D", "kind": "locator", "target": "cover-2", "sigma": 0.02}],
        measurements=[
            {"name": "gap", "kind": "gap", "to": {"part": "cover"}} | at("middle", 100, 12.5) | limits,
            {"name": "middle"} | at("base", 60, 3) | limits,
        ],
        stages=[{"kind": "locate"}, {"kind": "clamp"}, {"kind": "measure"}],
    )


def scenes(folder: Path) -> list[Scene]:
    """The scenes whose mesh line is judged, with one increment per step; meshes of the strips go into the folder."""
    chosen = [shipped("lap_joint", "coarse"), shipped("hat_on_plate", 12.0), three_strips(folder)]
    return [
        with_path(scene, "increments", 1).model_copy(
            update={
                "monte_carlo": scene.monte_carlo.model_copy(update={"samples": SAMPLES}),
                "report": scene.report.model_copy(update={"laws": [LAW], "accuracy": True}),
            }
        )
        for scene in chosen
    ]


def effectivities(scene: Scene, cache: Path, halvings: int) -> pd.DataFrame:
    """Largest expected changes that a run prints, over the largest true ones on meshes halved so many times.

    Returns
    -------
    DataFrame
        For means and for 6σ: ``scene, figure``, ``printed, mm`` and ``true, mm`` (largest sizes over the key
        characteristics), ``effectivity``, and ``counts``: whether the true change is at least :data:`SMALLEST` of the
        6σ of its characteristic.
    """
    with TemporaryDirectory() as folder:
        outcome = run(scene, Path(folder), cache)
        changes = MESH_CHANGES.read(Path(folder), "")
    model, finer = reduced_and_assembly(scene, cache)
    deviations = outcome.deviations(LAW, np.arange(SAMPLES))
    for _ in range(halvings):
        finer = with_halved_elements(finer)
    coarse, fine = (one.process(LAW).evaluate(deviations).measurements for one in (model, reduced_model(finer, cache)))
    six_sigma, rows = 6 * coarse.std(axis=0, ddof=1), []
    for name, true in (("mean", (fine - coarse).mean(axis=0)), ("six_sigma", 6 * fine.std(axis=0, ddof=1) - six_sigma)):
        most, printed = int(np.abs(true).argmax()), float(changes[f"{name}_change"].abs().max())
        row = {"scene": scene.name, "figure": name, "printed, mm": printed, "true, mm": float(abs(true[most]))}
        counts = bool(abs(true[most]) >= SMALLEST * six_sigma[most])
        rows.append(row | {"effectivity": printed / abs(true[most]), "counts": counts})
    return pd.DataFrame(rows)
