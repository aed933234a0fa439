"""The scene: schema, loading, checks and named settings."""

from mic.errors import SceneError
from mic.scene.deviation import Deviation
from mic.scene.fixture import Clamp, Locator
from mic.scene.load import load_scene
from mic.scene.measurement import Measurement
from mic.scene.part import Part
from mic.scene.process import Stage
from mic.scene.schema import Scene
from mic.scene.settings import SETTINGS
from mic.scene.weld import Weld
from mic.scene.zone import Zone

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
