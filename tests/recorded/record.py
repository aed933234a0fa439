"""Results of the shipped scenes, for ``test_recorded`` and for recording them.

``PYTHONPATH=tests python -m recorded.record`` records anew, into this folder; with ``--add`` only what is not recorded
yet, a new law or scene. README.md says when that is allowed.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from threadpoolctl import threadpool_info

import mic
from mic.contact import laws
from mic.process.model import ReducedModel
from mic.scene.checks import LAW_KEYS
from mic.scene.zone import PressurePower
from mic.statistics.draw import draw
from verification.scenes import with_stated_pairs

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(__file__).resolve().parent
SCENES = ("lap_joint", "hat_on_plate", "bracket", "wheelhouse")
LAWS = tuple(laws.LAWS)
INCREMENTS = (1, 3)
#: What a law reads beyond a coefficient: a function of pressure, and a tangential stiffness per area.
FRICTION = {
    "friction_power": PressurePower(mu0=0.27, p0=0.05, n=0.3, mu_min=0.1, mu_max=0.6),
    "tangential_stiffness": 1e4,
}
SAMPLES = 5
PAIRS = ("gap", "area", "point", "frame")
WHOLE = ("measurements", "failed", "motion", "functional_force")  # of an evaluation
STAGE = ("force", "displacement", "state", "reaction")  # of each stage that resolves contact


def reduced(name: str, cache: Path) -> ReducedModel:
    """A shipped scene under all laws, with slip and few pairs, its zones given what the laws read."""
    scene = with_stated_pairs(mic.load_scene(ROOT / "meshes" / name))
    zones = [zone.model_copy(update=FRICTION) for zone in scene.zones]
    report = scene.report.model_copy(update={"laws": list(LAWS), "slip": True})
    return mic.reduce(scene.model_copy(update={"report": report, "zones": zones}), cache)


def drawn(name: str) -> np.ndarray:
    """(SAMPLES, p) deviations that the scene's own seed draws."""
    scene = mic.load_scene(ROOT / "meshes" / name)
    return draw(scene, scene.monte_carlo.seed, 0, SAMPLES)


def outcome(model: ReducedModel, increments: int, deviations: np.ndarray) -> dict[str, np.ndarray]:
    """The recorded arrays of a scene with so many increments in every stage, by ``law/increments/stage/quantity``."""
    stages = [stage.model_copy(update={"increments": increments}) for stage in model.scene.stages]
    model = replace(model, scene=model.scene.model_copy(update={"stages": stages}))
    arrays = {f"pairs/{quantity}": getattr(model.contacts, quantity) for quantity in PAIRS}
    for law in LAWS:
        evaluation = model.evaluate(deviations, law)
        key = f"{law}/{increments}"
        arrays |= {f"{key}/{quantity}": getattr(evaluation, quantity) for quantity in WHOLE}
        for stage, resolution in evaluation.resolutions.items():
            arrays |= {f"{key}/{stage}/{quantity}": getattr(resolution, quantity) for quantity in STAGE}
    return arrays


def platform() -> str:
    """The versions that decide the last digits: finite elements, numpy and BLAS."""
    elements = "none"
    if find_spec("dolfinx"):
        from fem_reference.shell.versions import installed

        elements = installed()
    blas = [library for library in threadpool_info() if library["user_api"] == "blas"]
    libraries = sorted({f"{one['internal_api']} {one['version']} {one.get('architecture')}" for one in blas})
    return f"dolfinx {elements}; numpy {np.__version__}; " + ", ".join(libraries)


def main(add: bool) -> None:
    for law in laws.LAWS.values():
        if law.reads and not FRICTION.keys() & set(LAW_KEYS[law.reads]):
            raise SystemExit(f"FRICTION states none of {LAW_KEYS[law.reads]}, which the law {law.name} needs")
    for name in SCENES:
        file = FOLDER / f"{name}.npz"
        arrays = {"platform": np.array(platform()), "deviations": drawn(name)}
        with TemporaryDirectory() as cache:
            model = reduced(name, Path(cache))
        for increments in INCREMENTS:
            arrays |= outcome(model, increments, arrays["deviations"])
        if add and file.is_file():
            with np.load(file) as recorded:
                arrays |= dict(recorded)
        np.savez_compressed(file, **arrays)
        print(f"recorded {len(arrays)} arrays of {name}", file=sys.stderr)


if __name__ == "__main__":
    main("--add" in sys.argv[1:])
