"""Misplaced items: each error names its item, and nothing that refers to the item fails as well.

Two plates lie on each other, from deck files; a group of cases misplaces several items, and the scene holds everything
that may refer to items of their kinds. Nothing is solved.
"""

import copy

import numpy as np
import pytest
from support.decks import write_deck

import mic
from mic.errors import SceneError
from mic.geometry.structured import extrude
from mic.model.assembly import assemble
from mic.scene.load import read_table

OFF = [20.0, 20.0, 60.0]  # a point off both plates
BESIDE = [70.0, 20.0, 1.0]  # one on the upper plate alone, which ends at x = 80, the lower one at x = 40


def locators(part, x, z, stage="locate"):
    """A 3-2-1 scheme of a part."""
    places = [(x + 2, 2, "z"), (x + 2, 38, "z"), (x + 30, 20, "z"), (x + 2, 2, "y"), (x + 30, 2, "y"), (x + 2, 20, "x")]
    axes = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}
    return [
        {"name": f"{part}{i}", "part": part, "point": [px, py, z], "direction": axes[axis], "stage": stage, "radius": 2}
        for i, (px, py, axis) in enumerate(places)
    ]


def at(name, part, point, **keys):
    return {"name": name, "part": part, "point": point} | keys


LIMITS = {"lower": -1, "upper": 1}
SCENE = {
    "name": "plates",
    "parts": [{"name": part, "mesh": f"{part}.inp", "thickness": 1.0} for part in ("low", "up")],
    "fixtures": [at("pad", "low", [10, 10, 0], normal="-normal", radius=4)],
    "locators": [*locators("low", 0, 0), *locators("up", 42, 1), at("late", "low", [20, 30, 0], stage="clamp")],
    "clamps": [
        at("push", "up", [24, 20, 1], direction=[0, 0, -1], force=40),
        at("stroke", "up", [30, 10, 1], direction=[0, 0, -1], stroke=0.1),
        {"name": "tong", "parts": ["low", "up"], "point": [30, 30, 0], "force": 50},
    ],
    "welds": [{"name": f"W{i}", "parts": ["low", "up"], "point": [32, y, 0.5]} for i, y in ((1, 8), (2, 20))],
    "zones": [
        {"name": "lap", "parts": ["low", "up"], "friction": 0.2, "pairs": 4},
        {"name": "rest", "parts": ["low", "pad"], "friction": 0.2, "pairs": 3},
    ],
    "stages": [
        {"kind": "locate"},
        {"kind": "clamp", "order": [["late"], ["push", "stroke"], ["tong"]]},
        {"kind": "weld", "order": [["W2"], ["W1"]]},
        {"kind": "release", "keep": [*(f"low{i}" for i in range(6)), "late"]},
        {"kind": "measure"},
    ],
    "deviations": [
        at("F", "up", [60, 20, 1], kind="force", sigma=1.0),
        {"name": "S", "kind": "shape", "part": "low", "points": [[20, 5, 0], [20, 35, 0]], "sigma": 0.1},
        {
            "name": "field",
            "kind": "field",
            "part": "up",
            "sigma": 0.1,
            "length": 60,
            "points": [[50, 5, 1], [70, 30, 1]],
        },
        {"name": "D-locator", "kind": "locator", "target": "up5", "sigma": 0.02},
        {"name": "D-pin", "kind": "locator", "target": ["low3", "low5"], "direction": [1, 1, 0], "sigma": 0.02},
        {"name": "D-late", "kind": "locator", "target": "late", "sigma": 0.02},
        {"name": "D-clamp", "kind": "clamp", "target": "push", "sigma": 2},
        {"name": "D-stroke", "kind": "clamp", "target": "stroke", "sigma": 0.01},
        {"name": "D-tong", "kind": "clamp", "target": "tong", "sigma": 2},
        {"name": "D-zone", "kind": "friction", "target": ["lap", "rest"], "sigma": 0.01},
    ],
    "correlations": [
        {"deviations": ["F", "D-locator", "D-tong"], "matrix": np.eye(3).tolist()},
        {"deviations": ["D-clamp", "D-pin"], "matrix": np.eye(2).tolist()},
    ],
    "measurements": [
        at("M", "up", [60, 20, 1], direction=[0, 0, 1], **LIMITS),
        at("N", "up", [70, 30, 1], direction=[0, 0, 1], best_fit=["M", "step", "flat"], **LIMITS),
        at("step", "low", [36, 20, 0], kind="flush", to={"part": "up", "point": [60, 20, 1]}, **LIMITS),
        {"name": "flat", "part": "up", "kind": "profile", "points": [[50, 5, 1], [50, 35, 1], [75, 20, 1]], "upper": 1}
        | {"best_fit": ["flat", "M"]},
    ],
    "report": {"laws": ["coulomb"], "positions": ["welds.W1", "locators.up5", "clamps.tong"]},
    "optimise": {
        "objective": "largest-six-sigma",
        "of": ["M", "N"],
        "forces": [{"clamps": ["push"], "between": [10, 90]}, {"clamps": ["tong"], "between": [10, 90]}],
        "shims": [{"of": ["up5"], "between": [-1, 1]}, {"of": ["stroke"], "between": [-1, 1]}],
        "orders": [{"stage": "weld"}],
        "places": [{"item": "welds.W1", "points": [[33, 8, 0.5]]}, {"item": "locators.late", "points": [[22, 30, 0]]}],
        "constraints": [{"quantity": "six-sigma", "of": ["M"], "at_most": 9}],
    },
}

AT_A_POINT = ("locators.low3", "clamps.push", "clamps.stroke", "deviations.F", "measurements.M", "fixtures.pad")
MOVABLE = ("locators.up5", "locators.late")  # by the report and by the optimisation
JOINTS = ("welds.W1", "clamps.tong")


def misplaced(items, message, **keys):
    """Cases of items with the same keys and message."""
    return [(item, keys, message) for item in items]


#: Cases that one scene holds: item, keys that misplace it, and what its message says besides its name.
CASES = {
    "off": [
        *misplaced((*AT_A_POINT, *MOVABLE, *JOINTS), "mm away from part", point=OFF),
        ("deviations.S", {"points": [[20, 5, 0], OFF]}, "points[1]"),
        ("deviations.field", {"points": [OFF, [50, 5, 1]]}, "points[0]"),
        ("measurements.step", {"to": {"part": "up", "point": OFF}}, ".to"),
        ("measurements.flat", {"points": [OFF, [50, 5, 1]]}, "points[0]"),
        ("zones.lap", {"box": [[60, 0, -1], [70, 9, 2]]}, "no contact pair"),
    ],
    "no node": [
        *misplaced((*AT_A_POINT, *MOVABLE, *JOINTS), "no node 1000000", point=None, node=10**6),
        ("measurements.step", {"to": {"part": "up", "node": 10**6}}, "no node"),
    ],
    "no set": misplaced((*AT_A_POINT, *MOVABLE, *JOINTS), "no set of nodes 'nothing'", point=None, set="nothing"),
    "no hole": misplaced(AT_A_POINT, "hole", point=None, hole=[20, 20, 0]),
    "no hole, and what moves it": misplaced(MOVABLE, "in a hole and cannot", point=None, hole=[20, 20, 0]),
    "on the wrong part": [
        *misplaced(
            ("deviations.F", "measurements.M", "measurements.N", "measurements.flat"),
            "mm away from part 'low'",
            part="low",
        ),
        ("locators.late", {"part": "up", "point": [4, 30, 0]}, "away from part 'up'"),
        ("deviations.S", {"part": "up", "points": [[2, 5, 0], [60, 9, 1]]}, "points[0]"),
        *misplaced(("welds.W2", "clamps.tong"), "away from part 'low'", point=BESIDE),
    ],
    "wrong direction": [
        ("locators.up5", {"direction": "in-plane z"}, "z stands across the sheet"),
        ("clamps.tong", {"direction": [0, 0, -1]}, "does not push"),
        ("deviations.S", {"kind": "measured", "files": "none-*.csv", "points": None, "sigma": 1.0}, "no file 'none-"),
    ],
    "moves nothing": [("deviations.D-locator", {"direction": [0, 0, 1]}, "moves nothing")],
    "pad without contact": [
        ("zones.rest", {"max_gap": 0.1, "gap": None, "box": [[30, 30, -1], [35, 35, 1]]}, "no contact pair")
    ],
}


def edited(*edits):
    """The scene with some items changed, each given as TABLE.NAME and its keys; None removes a key."""
    table = copy.deepcopy(SCENE)
    for place, keys in edits:
        kind, name = place.split(".")
        item = next(item for item in table[kind] if item["name"] == name)
        item |= keys
        for key in [key for key, value in item.items() if value is None]:
            del item[key]
    return table


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("plates")
    for name, x, z, length in (("low", 0.0, 0.0, 40.0), ("up", 0.0, 1.0, 80.0)):
        start = 0.0 if name == "low" else 20.0
        points, triangles = extrude([(0, z), (40, z)], start, length, 10.0)[:2]
        write_deck(place / f"{name}.inp", {"SHEET": (points + [x, 0, 0], triangles)})
    return place


@pytest.mark.slow
def test_the_scene_without_errors_is_assembled(folder):
    assembly = assemble(read_table(edited(), folder / "scene.toml"), folder / "cache")
    assert assembly.labels["locator"] == [item["name"] for item in SCENE["locators"]]
    assert isinstance(mic.check(read_table(edited(), folder / "scene.toml"), folder / "cache"), tuple)


@pytest.mark.slow
@pytest.mark.parametrize("group", CASES)
def test_each_misplaced_item_is_named_and_nothing_else_fails(group, folder):
    cases = CASES[group]
    with pytest.raises(SceneError) as caught:
        scene = read_table(edited(*((item, keys) for item, keys, _ in cases)), folder / "scene.toml")
        assemble(scene, folder / "cache")
    lines = str(caught.value).splitlines()
    assert len(lines) == len(cases)
    for item, _, message in cases:
        name = item.split(".")[1]
        assert any(message in line and (f"({name})" in line or repr(item) in line) for line in lines), (item, lines)
