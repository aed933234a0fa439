"""Small scenes whose parts deviate, as tables."""

from pathlib import Path

import mic
from mic.scene.load import read_table
from support.stages import MOVES

MESHES = Path(__file__).resolve().parents[2] / "meshes"
WARM = {"name": "W", "kind": "temperature", "part": "lower", "mean": 40.0, "sigma": 1.0}
STEEL = {"density": 7850.0, "expansion": 1.2e-5}  # kg/m³, 1/K


def _coarse(folder, size, deviations, **keys):
    """The table of a shipped scene with elements of a size, six pairs in each zone and one increment for each step."""
    table = mic.load_scene(MESHES / folder).model_dump(mode="json", exclude={"folder"})
    table["parts"] = [part | STEEL | {"size": size} for part in table["parts"]]
    table["zones"] = [zone | {"pairs": 6} for zone in table["zones"]]
    for stage in table["stages"]:
        if stage["kind"] in MOVES:
            stage |= {"path": "increments", "increments": 1}
    return table | {"report": {"laws": ["coulomb"]}, "deviations": deviations} | keys


def lap_joint(deviations, **keys):
    """The table of a small lap joint with other deviations."""
    return _coarse("lap_joint", "coarse", deviations, **keys)


def lap(stiffness, mean=-5.0, **keys):
    """The table of a small lap joint whose upper sheet is out of shape in the mean, and the lower one warm."""
    force = {"name": "F", "kind": "force", "part": "upper", "point": [65, 20, 1], "mean": mean}
    force["sigma"] = 0.25 * abs(mean) or 1.0
    return lap_joint([force, WARM], stiffness=stiffness) | keys


def hat(stiffness):
    """Likewise of a hat on a plate, whose bends turn under a force."""
    force = {"name": "F1", "kind": "force", "part": "hat", "point": [150, -40, 1], "direction": [0, 0, 1]}
    return _coarse("hat_on_plate", 20.0, [force | {"mean": 4.0, "sigma": 1.5}], stiffness=stiffness)


def read(table, folder="lap_joint"):
    """The scene of such a table."""
    return read_table(table, MESHES / folder / "scene.toml")
