"""Rigid bodies that touch at given points, each of which yields on springs of its own: statics by hand.

At a contact a part yields by 1/k along its normal and by half of that along its tangents, and nowhere else; everything
else (locators, clamps, welds, measurements) reads the rigid body.
"""

import numpy as np

import mic
from mic.compliance.blocks import Blocks
from mic.model.rows import KINDS
from mic.process.model import ReducedModel
from support.springs import NOWHERE, contacts_at, rows_and_labels, six, stage_list

STIFFNESS = 2000.0  # N/mm, of a part at a contact along its normal
FEET = [(0, 0, 0), (100, 0, 0), (0, 60, 0)]
PAIR = 2 / STIFFNESS  # mm/N, of both bodies' springs at one foot, along the normal
WIDE = [[0, 0, 0], [100, 0, 0], [0, 100, 0], [0, 0, 0], [100, 0, 0], [0, 0, 0]]
UP, ALONG_X = (0, 0, 1), (1, 0, 0)
AT = (30, 20, 0)  # where b is pressed


def frame_of(normal):
    """(3, 3) n, t1, t2 in columns."""
    n = np.array(normal, dtype=float) / np.linalg.norm(normal)
    first = np.eye(3)[np.argmin(np.abs(n))]
    t1 = first - (first @ n) * n
    t1 /= np.linalg.norm(t1)
    return np.column_stack([n, t1, np.cross(n, t1)])


def standing(pairs, stiffness=STIFFNESS, gap=0.0, shape=None, **scene):
    """Reduced model of a scene whose zones touch at `pairs`: (name of zone, point, normal from first to second body).

    `gap` is one for all or one for each; `shape(part, point) -> (3,)` displaces the points of each part per unit of the
    scene's first deviation.
    """
    scene = mic.Scene(name="feet", **scene)
    names = [part.name for part in scene.parts]
    own = {name: [] for name in names}  # (point, direction, what it yields by)
    entries = {kind: [] for kind in KINDS}

    def reading(part, point, direction, yields=0.0):
        own[part].append((np.array(point, dtype=float), np.array(direction, dtype=float), yields))
        return part, len(own[part]) - 1

    for kind in ("locator", "clamp", "measurement"):
        for item in getattr(scene, f"{kind}s"):
            entries[kind].append([(*reading(item.part, item.point, item.direction), 1.0)])
    for weld in scene.welds:
        for axis in np.eye(3)[[2, 0, 1]]:
            pair = zip(weld.parts, (-1.0, 1.0))
            entries["weld"].append([(*reading(name, weld.point, axis), sign) for name, sign in pair])
    zones = {zone.name: i for i, zone in enumerate(scene.zones)}
    frames = np.array([frame_of(normal) for _, _, normal in pairs]).reshape(-1, 3, 3)
    for (zone, point, _), frame in zip(pairs, frames):
        for axis, soft in zip(frame.T, (1.0, 0.5, 0.5)):
            bodies = zip(scene.zones[zones[zone]].parts, (-1.0, 1.0))
            entries["contact"].append(
                [(*reading(name, point, axis, soft / stiffness), sign) for name, sign in bodies if name in names]
            )
    H = tuple(np.diag([soft for *_, soft in own[name]]) for name in names)
    G = tuple(np.array([[*d, *np.cross(p, d)] for p, d, _ in own[name]]) for name in names)
    compliance = Blocks(H, G)
    rows, labels = rows_and_labels(scene, compliance, entries)
    shapes = np.zeros((compliance.size, len(scene.deviations)))
    if shape is not None:
        shapes[:, 0] = [shape(name, p) @ d for name in names for p, d, _ in own[name]]
    contacts = contacts_at(
        [point for _, point, _ in pairs],
        frames,
        [zones[zone] for zone, _, _ in pairs],
        [scene.zones[zones[zone]].coefficient("default") for zone, _, _ in pairs],
        np.broadcast_to(np.asarray(gap, dtype=float), len(pairs)),
    )
    weld_gap, size = np.zeros(3 * len(scene.welds)), (3,) * len(scene.welds)
    return ReducedModel(
        scene, compliance, rows, labels, contacts, NOWHERE, size, weld_gap, shapes, np.zeros_like(shapes), {}
    )


def push(force, at=AT, direction=(0, 0, -1), name="C", part="b", **keys):
    return {"name": name, "part": part, "point": list(at), "direction": list(direction), "force": force} | keys


def plates(names, *rests):
    """The parts of a scene, of which some rest."""
    return [{"name": name, "mesh": "a.stl", "thickness": 1.0, "rests": name in rests} for name in names]


def zone(*parts, name="Z", friction=0.2, **keys):
    return {"name": name, "parts": list(parts), "friction": friction, "pairs": 1} | keys


def gauge(part, at, direction=UP, name="M"):
    return {"name": name, "part": part, "point": list(at), "direction": list(direction), "lower": -1, "upper": 1}


def table(
    clamps, friction=0.2, feet=FEET, gap=0.0, kinds=("locate", "clamp", "measure"), shape=None, normal=UP, **change
):
    """b stands on a by its feet, under clamps; a is held by six locators."""
    keys = {
        "parts": plates("ab", "b"),
        "locators": six("a", far=WIDE),
        "clamps": list(clamps),
        "zones": [zone("a", "b", friction=friction)],
        "measurements": [gauge("b", foot, name=f"M{i}") for i, foot in enumerate(feet)],
        "stages": stage_list(*kinds),
    }
    return standing([("Z", foot, normal) for foot in feet], gap=gap, shape=shape, **keys | change)
