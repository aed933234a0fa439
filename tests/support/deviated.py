"""Small scenes whose parts are out of shape in the mean."""

from pathlib import Path

import mic
from mic.scene.load import read_table

MESHES = Path(__file__).resolve().parents[2] / "meshes"
WARM = {"name": "W", "kind": "temperature", "part": "lower", "mean": 40.0, "sigma": 1.0}


def lap(stiffness, mean=-5.0, **keys):
    """The table of a small lap joint whose upper sheet is out of shape in the mean, and the lower one warm."""
    table = mic.load_scene(MESHES / "lap_joint").model_dump(mode="json", exclude={"folder"})
    table["parts"] = [part | {"expansion": 1.2e-5, "size": "coarse"} for part in table["parts"]]
    table["zones"][0]["pairs"] = 6
    table["stages"][1:4] = [one | {"path": "increments", "increments": 1} for one in table["stages"][1:4]]
    force = {"name": "F", "kind": "force", "part": "upper", "point": [65, 20, 1], "mean": mean, "sigma": 0.25 * mean}
    force["sigma"] = abs(force["sigma"]) or 1.0
    table |= {"report": {"laws": ["coulomb"]}, "deviations": [force, WARM], "stiffness": stiffness}
    return table | keys


def hat(stiffness):
    """Likewise of a hat on a plate, whose bends turn, as the shipped scene has its shapes."""
    table = mic.load_scene(MESHES / "hat_on_plate").model_dump(mode="json", exclude={"folder"})
    table["parts"] = [part | {"size": 12.0} for part in table["parts"]]
    table["zones"] = [zone | {"pairs": 6} for zone in table["zones"]]
    for stage in table["stages"]:
        if stage["kind"] in ("clamp", "weld", "release"):
            stage |= {"path": "increments", "increments": 1}
    return table | {"report": {"laws": ["coulomb"]}, "stiffness": stiffness}


def read(table, folder="lap_joint"):
    """The scene of such a table."""
    return read_table(table, MESHES / folder / "scene.toml")
