"""Scenes that vary everything at once: points of a Sobol' sequence, built in memory.

Two sheets overlap, each on its locators; one to three pairs of clamps press them together, they are welded or not,
released and measured. Quantities are spread evenly in their logarithm, choices with equal frequency.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from mic.geometry.load import LoadedPart
from mic.geometry.structured import extrude
from mic.geometry.surface import Surface
from mic.model.assembly import PlacedScene
from mic.model.rows import SHARE
from mic.scene import Scene
from verification.extremes.design import Choice, Decades

__all__ = ["AXES", "points", "scene"]

WIDTH, LENGTH, OVERLAP, SIZE = 20.0, 80.0, 35.0, 5.0  # mm, of a sheet and its elements
MANY = 60  # pairs; paths with more are not followed

#: Parameters of the design. A sliver is a column of elements narrower than the others by the given factor.
AXES: dict[str, Callable[[float], object]] = {
    "thickness": Decades(0.05, 20.0),
    "thickness : thickness": Decades(0.2, 5.0),
    "E": Decades(1.0, 1e6),
    "E : E": Decades(1e-3, 1e3),
    "Poisson": Choice((0.3, 0.0, -0.5, 0.49)),
    "friction": Decades(1e-3, 1e3, share=0.15),
    "gap": Decades(1e-9, 1e2),
    "pairs": lambda at: 0 if at < 0.2 else round(400 ** (((at - 0.2) / 0.8) ** 3)),  # mostly few; 0: candidates
    "sliver": Decades(1e-6, 0.3, share=0.6, else_=1.0),
    "clamps": Choice((1, 2, 3)),
    "law": Choice(("coulomb", "associated", "coulomb", "frictionless", "pressure-dependent", "micro-slip")),
    "path": Choice(("increments", "followed", "one-step")),
    "load": Decades(0.05, 100.0),
    "weld": Choice(("none", "fused", "close", "averaged")),
    "profile": Choice(("flat", "angle")),
}


def points(count: int) -> list[dict]:
    """The first points of the design."""
    design = qmc.Sobol(len(AXES), seed=20251127).random(1 << max(count - 1, 1).bit_length())[:count]
    found = [{name: read(at) for (name, read), at in zip(AXES.items(), row)} for row in design]
    # hundreds of pairs that share a few elements take minutes to follow
    return [point | {"path": "one-step"} if point["pairs"] > MANY else point for point in found]


def scene(point: dict) -> tuple[PlacedScene, np.ndarray]:
    """The scene of a point, and deviations (1, p) to solve."""
    thickness = (point["thickness"], point["thickness"] * point["thickness : thickness"])
    young = (point["E"], point["E"] * point["E : E"])
    z = sum(thickness) / 2 + point["gap"]
    profile = [(0.0, z), (WIDTH, z)] + [(WIDTH, z + 10.0)] * (point["profile"] == "angle")
    sheets = {
        "lower": extrude([(0.0, 0.0), (WIDTH, 0.0)], 0.0, LENGTH, SIZE),
        "upper": extrude(profile, LENGTH - OVERLAP, 2 * LENGTH - OVERLAP, SIZE),
    }
    bending = min(E * t**3 for E, t in zip(young, thickness)) * WIDTH / 12
    force = point["load"] * 3 * bending / 50**3 * (point["gap"] + 0.3)
    parts = [
        {"name": name, "mesh": f"{name}.vtu", "thickness": t, "young": E, "poisson": point["Poisson"], "offset": 0.0}
        | {"density": 1e3, "expansion": 1e-5}
        for name, t, E in zip(sheets, thickness, young)
    ]
    table = {"name": "point", "parts": parts, **_fixture(point, z, force, min(young)), **_read(point, z, force)}
    found = Scene(**table, folder=Path("."))
    zone = found.zones[0]
    if zone.friction_table is None:  # friction beyond that of any material, too
        zone = zone.model_copy(update={"friction": point["friction"]})
    found = found.model_copy(update={"zones": [zone]})
    loaded = []
    for part in found.parts:
        x, triangles, _ = sheets[part.name]
        surface = Surface(_with_sliver(x, point["sliver"]), triangles)
        loaded.append(LoadedPart(part, surface, surface, {}))
    # force, locator, shape, temperature, gravity
    return PlacedScene(found, tuple(loaded), {}, {}, ()), np.array([[0.13 * force, 0.02, -0.2, -5.0, 1.0]])


def _with_sliver(x: np.ndarray, narrow: float) -> np.ndarray:
    """The mesh with one column of elements narrower by a factor."""
    columns = np.unique(x[:, 1].round(9))
    middle = len(columns) // 2
    moved = x.copy()
    moved[np.abs(x[:, 1] - columns[middle]) < 1e-6, 1] = columns[middle - 1] + narrow * SIZE
    return x if narrow == 1 else moved


def _fixture(point: dict, z: float, force: float, young: float) -> dict:
    """Locators, clamps, weld, zone and stages."""
    places = {
        "lower": [(5, 3, "z"), (5, 17, "z"), (40, 10, "z"), (5, 5, "y"), (40, 5, "y"), (5, 10, "x"), (20, 17, "z")],
        "upper": [(120, 3, "z"), (120, 17, "z"), (90, 10, "z"), (120, 5, "y"), (85, 5, "y"), (120, 10, "x")],
    }
    axis = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    locators = [
        {"name": f"{part}{i}", "part": part, "point": (float(x), float(y), z * (part == "upper")), "direction": axis[d]}
        for part, listed in places.items()
        for i, (x, y, d) in enumerate(listed)
    ]
    locators[6]["stage"] = "clamp0"  # a support that forces the part to its nominal place
    clamps, stages = [], [{"kind": "locate"}]
    steps = {"path": "increments", "increments": 2} if point["path"] == "increments" else {"path": point["path"]}
    for k, (x, y) in enumerate([(60.0, 10.0), (66.0, 5.0), (70.0, 15.0)][: point["clamps"]]):
        name = f"clamp{k}"
        stages.append({"kind": "clamp", "name": name} | steps)
        for part, height, direction in (("lower", 0.0, (0, 0, 1)), ("upper", z, (0.3 * (k == 0), 0, -1))):
            clamps.append(
                {"name": f"{name}{part}", "part": part, "point": (x, y, height), "direction": direction, "radius": 4.0}
                | {"force": force, "stage": name}
            )
    welds: list[dict] = []
    weld = point["weld"]
    if z > 2 * SHARE * LENGTH:
        weld = "none"  # its point would be off its parts
    if weld != "none":
        place = {"name": "W", "parts": ("lower", "upper"), "point": (72.0, 10.0, z / 2), "radius": 2.5}
        welds = [place | {"close": weld == "close", "fused": weld != "averaged"}]
        stages.append({"kind": "weld"})
    kept = [item["name"] for item in locators if weld == "none" or item["part"] == "lower"]
    stages += [{"kind": "release", "keep": kept} | (steps if point["pairs"] > MANY else {}), {"kind": "measure"}]
    pairs = point["pairs"]
    zone = {"name": "lap", "parts": ("lower", "upper"), "max_gap": 1.01 * point["gap"] + 2.0}
    zone |= {"pairs": pairs} if pairs else {}
    if point["law"] == "pressure-dependent":
        mu = min(point["friction"], 10.0)
        zone["friction_table"] = [(0.0, mu), (1e-6 * young, mu), (1e-4 * young, 0.75 * mu)]
    if point["law"] == "micro-slip":
        zone["tangential_stiffness"] = young / SIZE
    return {"locators": locators, "clamps": clamps, "welds": welds, "stages": stages, "zones": [zone]}


def _read(point: dict, z: float, force: float) -> dict:
    """Deviations, key characteristics and the law."""
    deviations = [
        {"name": "F", "kind": "force", "part": "upper", "point": (60.0, 15.0, z), "direction": (0, 0, 1)}
        | {"sigma": 0.1 * force, "radius": 6.0},
        {"name": "L", "kind": "locator", "target": "upper5", "sigma": 0.05},
        {"name": "S", "kind": "shape", "part": "lower", "points": [(70.0, 5.0, 0.0), (65.0, 15.0, 0.0)], "sigma": 0.1},
        {"name": "T", "kind": "temperature", "part": "upper", "sigma": 5.0},
        {"name": "G", "kind": "gravity", "sigma": 0.0},
    ]
    limits = {"lower": -1.0, "upper": 1.0}
    measurements = [
        {"name": "M1", "part": "upper", "point": (100.0, 3.0, z), "direction": (0, 0, 1)} | limits,
        {"name": "M2", "part": "upper", "point": (60.0, 10.0, z), "direction": (1, 0, 0)} | limits,
        {"name": "M3", "part": "lower", "point": (75.0, 15.0, 0.0), "direction": (0, 0, 1)} | limits,
    ]
    report = {"laws": [point["law"]], "slip": True}
    return {"deviations": deviations, "measurements": measurements, "report": report}
