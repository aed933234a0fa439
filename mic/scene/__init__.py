"""What a user states about an assembly: the scene file, its settings and its checks."""

from mic.errors import SceneError
from mic.scene.load import load_scene
from mic.scene.schema import Clamp, Deviation, Locator, Measurement, Part, Scene, Stage, Weld, Zone
from mic.scene.settings import SETTINGS

__all__ = [
    "SETTINGS",
    "Clamp",
    "Deviation",
    "Locator",
    "Measurement",
    "Part",
    "Scene",
    "SceneError",
    "Stage",
    "Weld",
    "Zone",
    "load_scene",
]
