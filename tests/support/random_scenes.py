"""Random scenes of two parts, also with moved vertices, or with the parts of their zones in the other order.

The scenes are full of ties: round coordinates, regions whose borders lie on element edges, symmetric parts, more
locators than a part needs.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mic.geometry.structured import extrude
from mic.scene import Scene
from support.decks import write_deck


@dataclass(frozen=True)
class Case:
    """A scene as a table, its parts' meshes by name, and deviations (n, p) to evaluate it at."""

    table: dict
    meshes: dict[str, tuple[np.ndarray, np.ndarray]]
    deviations: np.ndarray

    @property
    def has_box(self) -> bool:
        """Whether a zone is bounded by a box, which only right angles turn into a box."""
        return any(zone.get("box") is not None for zone in self.table["zones"])

    def scene(self, folder: Path) -> Scene:
        """The scene with its meshes written into `folder`; every coordinate is read back as it is."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, (points, triangles) in self.meshes.items():
            write_deck(folder / f"{name}.inp", {"SHEET": (points, triangles)})
        return Scene(**self.table, folder=folder)


def random_case(seed: int, patch=None, points: bool = False, watched: bool = False) -> Case:
    """A plate under another plate, an L or a hat, held, clamped, welded, released and measured.

    `patch`, if given, is that of the zone; with `points` its pairs are given points, and there is no other region;
    `watched`, they are candidates.
    """
    rng = np.random.default_rng(seed)
    pick = lambda *options: options[rng.integers(len(options))]
    kind = pick("plate", "angle", "hat")
    thickness = [float(pick(0.8, 1.0, 1.2)), float(pick(0.8, 1.0, 1.5))]
    gap = float(pick(0.0, 0.0, 0.1, 0.3))
    z = sum(thickness) / 2 + gap
    length, width = float(pick(40, 60)), float(pick(20, 30, 40))
    lower = extrude([(0, 0), (width, 0)], 0.0, length, float(pick(5, 4, 6.5)))[:2]
    start = float(pick(0, 10, 20))
    if kind == "plate":
        low, wide = float(pick(0, 5)), float(pick(20, 25))
        profile = [(low, z), (low + wide, z)]
        top = [(low + wide / 2, z)]
    elif kind == "angle":
        low = float(pick(0, 5))
        profile = [(low, z), (low + 15, z), (low + 15, z + 15)]
        top = [(low + 15, z + 15), (low + 10, z)]
    else:
        low = float(pick(0, 2.5)) if width < 40 else 2.5
        foot = (width - 2 * low - 10) / 2
        profile = [(low, z), (low + foot, z), (low + foot, z + 10), (width - low - foot, z + 10)]
        profile += [(width - low - foot, z), (width - low, z)]
        top = [(width / 2, z + 10)]
    upper = extrude(profile, start, length, float(pick(5, 4, 6.5)))[:2]
    begin, end = max(start, 0.0), min(start + length, length)
    left, right = max(0.0, profile[0][0]), min(width, profile[-1][0] if kind != "angle" else profile[1][0])
    middle = (begin + end) / 2

    def locators(part, x, y, h, extra):
        places = [(x[0], y[0], h, "z"), (x[0], y[1], h, "z"), (x[1], (y[0] + y[1]) / 2, h, "z")]
        places += [(x[1], y[0], h, "z"), (x[1], y[1], h, "z")][:extra]
        places += [(x[0], y[0], h, "y"), (x[1], y[0], h, "y"), (x[0], (y[0] + y[1]) / 2, h, "x")]
        axis = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
        radius = float(pick(0, 2, 4))
        return [
            {"name": f"{part}{i}", "part": part, "point": place[:3], "direction": axis[place[3]], "radius": radius}
            for i, place in enumerate(places)
        ]

    seat = profile[0][0]
    held = locators("lower", (5.0, length - 5), (2.5, width - 2.5), 0.0, int(pick(0, 0, 1, 2)))
    span = 10.0 if kind != "hat" else max(5.0, profile[1][0] - profile[0][0])
    held += locators("upper", (start + 5, start + length - 5), (seat + 1.0, seat + span - 1), z, int(pick(0, 0, 1, 2)))
    inward = 5.0 if kind != "hat" else min(4.0, 0.8 * foot)  # upon the feet, however narrow
    here = (left + inward, right - inward)
    clamps = []
    for i, y in enumerate(here if rng.random() < 0.5 else here[:1]):
        for part, h, sense in (("lower", 0.0, 1.0), ("upper", z, -1.0)):
            clamps.append(
                {
                    "name": f"C{i}{part}",
                    "part": part,
                    "point": (middle, y, h),
                    "direction": (0, 0, sense),
                    "force": 40.0,
                    "radius": float(pick(2, 3)),
                }
            )
    welds = [
        {
            "name": f"W{i}",
            "parts": ("lower", "upper"),
            "point": (middle + float(pick(-5, 5)), y, z / 2),
            "radius": 2.5,
            "close": bool(pick(False, False, True)),
        }
        for i, y in enumerate(here)
    ]
    zone = {"name": "Z", "parts": pick(("lower", "upper"), ("upper", "lower")), "friction": 0.25, "max_gap": 1.0}
    zone["patch"] = pick("tributary", "tributary", 0.0, 3.0)
    zone |= {} if patch is None else {"patch": patch}
    share = 1.0 if points else 0.8 if watched else rng.random()
    if share < 0.7:
        zone["pairs"] = int(pick(1, 2, 3, 4, 6, 9, 12))
    elif share < 0.85:
        zone["spacing"] = float(pick(5, 7.5, 10))
    else:
        spots = np.stack(np.meshgrid([begin + 5, middle, end - 5], here), -1).reshape(-1, 2)
        spots = spots[rng.permutation(len(spots))[: int(pick(2, 4, 6))]]
        zone["points"] = [(float(x), float(y), 0.0) for x, y in np.unique(spots, axis=0)]
    region = 1.0 if points else rng.random()
    if region < 0.3:
        zone["path"] = [(begin, here[0], 0.0), (end, here[0], 0.0)]
        zone["within"] = float(pick(5, 7.5, 10))
        if zone.pop("points", None):
            zone["pairs"] = 4
    elif region < 0.6:
        zone["box"] = ((begin + pick(0.0, 5.0), left, -5.0), (end - pick(0.0, 5.0), right - pick(0.0, 2.5), z + 2))
    measurements = [
        {"part": "upper", "point": (start + length, top[0][0], top[0][1])},
        {"part": "upper", "point": (start, top[-1][0], top[-1][1])},
        {"part": "lower", "point": (length, width / 2, 0.0)},
    ]
    limits = {"direction": (0, 0, 1), "lower": -1.0, "upper": 1.0}
    measurements = [{"name": f"M{i}", **m, **limits, "radius": pick(0.0, 2.5)} for i, m in enumerate(measurements)]
    deviations = [
        {"name": "F1", "kind": "force", "part": "upper", "point": (middle, here[0], z), "direction": (0, 0, 1)},
        {"name": "F2", "kind": "force", "part": "lower", "point": (middle, width / 2, 0.0), "direction": (0, 0, 1)},
    ]
    deviations = [{**d, "sigma": 1.0, "radius": float(pick(3, 5))} for d in deviations]
    deviations.append({"name": "D1", "kind": "locator", "target": "upper0", "sigma": 0.1})
    stages = [{"kind": k} for k in ("locate", "clamp", "weld", "release", "measure")]
    stages[3]["keep"] = [item["name"] for item in held if item["part"] == "lower"]
    table = {
        "name": f"random{seed}",
        "parts": [{"name": n, "mesh": f"{n}.inp", "thickness": t} for n, t in zip(("lower", "upper"), thickness)],
        "locators": held,
        "clamps": clamps,
        "welds": welds,
        "zones": [zone],
        "stages": stages,
        "deviations": deviations,
        "measurements": measurements,
    }
    for part in table["parts"]:
        part["young"] = 210e3
    values = np.array([[2.0, 3.0, 0.1], [-4.0, 1.0, -0.05], [5.0, -5.0, 0.0]])
    return Case(table, {"lower": lower, "upper": upper}, values)


def moved_by(case: Case, size: float, seed: int) -> Case:
    """Every vertex moved by up to `size` mm, each its own way."""
    rng = np.random.default_rng(seed)
    return replace(case, meshes={n: (p + rng.uniform(-size, size, p.shape), t) for n, (p, t) in case.meshes.items()})


def swapped(case: Case) -> Case:
    """The zones' parts named in the other order."""
    table = deepcopy(case.table)
    for zone in table["zones"]:
        zone["parts"] = zone["parts"][::-1]
    return replace(case, table=table)


def rotation(seed: int, right_angles: bool = False) -> np.ndarray:
    """A random rotation; with `right_angles` one that maps axes to axes."""
    rng = np.random.default_rng(seed)
    if right_angles:
        matrix = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    else:
        matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return matrix * np.linalg.det(matrix)
