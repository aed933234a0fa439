"""What a user states about an assembly: the scene file, its settings and its checks."""

from mic.scene.schema import SETTINGS, Clamp, Deviation, Locator, Measurement, Scene, SceneError, Weld, Zone, load_scene

__all__ = [
    "SETTINGS",
    "Clamp",
    "Deviation",
    "Locator",
    "Measurement",
    "Scene",
    "SceneError",
    "Weld",
    "Zone",
    "load_scene",
]
