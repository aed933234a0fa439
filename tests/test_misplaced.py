"""Items that are misplaced, crossed with all that can refer to them: the errors name the item, and nothing else fails.

Two plates lie on each other, from deck files; each case misplaces one item, and the scene holds everything that may
refer to items of its kind. Nothing is solved.
"""

import copy
import itertools

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

#: What is misplaced: the item, how, and what its error must say besides its name.
PLACES = {
    "off": ({"point": OFF}, "mm away from part"),
    "no node": ({"point": None, "node": 10**6}, "no node 1000000"),
    "no set": ({"point": None, "set": "nothing"}, "no set of nodes 'nothing'"),
    "no hole": ({"point": None, "hole": [20, 20, 0]}, "hole"),
}
AT_POINTS = ("locators.up5", "locators.low3", "locators.late", "clamps.push", "clamps.stroke", "deviations.F")
CASES = {
    f"{item}: {how}": (item, *PLACES[how])
    for item, how in itertools.product((*AT_POINTS, "measurements.M", "fixtures.pad"), PLACES)
}
CASES |= {
    f"{item}: {how}": (item, *PLACES[how])
    for item, how in itertools.product(("welds.W1", "clamps.tong"), ("off", "no node", "no set"))
}
CASES |= {
    f"{item}: on the wrong part": (item, {"part": "low"}, "mm away from part 'low'")
    for item in ("deviations.F", "measurements.M", "measurements.N", "measurements.flat")
}
CASES |= {
    "locators.late: on the wrong part": ("locators.late", {"part": "up", "point": [4, 30, 0]}, "away from part 'up'"),
    "locators.up5: across": ("locators.up5", {"direction": "in-plane z"}, "z stands across the sheet"),
    "welds.W2: beside": ("welds.W2", {"point": BESIDE}, "away from part 'low'"),
    "clamps.tong: beside": ("clamps.tong", {"point": BESIDE}, "away from part 'low'"),
    "clamps.tong: reversed": ("clamps.tong", {"direction": [0, 0, -1]}, "does not push"),
    "zones.lap: elsewhere": ("zones.lap", {"box": [[60, 0, -1], [70, 9, 2]]}, "no contact pair"),
    "zones.rest: too far": (
        "zones.rest",
        {"max_gap": 0.1, "gap": None, "box": [[30, 30, -1], [35, 35, 1]]},
        "no contact pair",
    ),
    "deviations.S: off": ("deviations.S", {"points": [[20, 5, 0], OFF]}, "points[1]"),
    "deviations.S: on the wrong part": ("deviations.S", {"part": "up", "points": [[2, 5, 0], [60, 9, 1]]}, "points[0]"),
    "deviations.field: off": ("deviations.field", {"points": [OFF, [50, 5, 1]]}, "points[0]"),
    "deviations.D-locator: across": ("deviations.D-locator", {"direction": [0, 0, 1]}, "moves nothing"),
    "measurements.step: to off": ("measurements.step", {"to": {"part": "up", "point": OFF}}, ".to"),
    "measurements.step: to without node": ("measurements.step", {"to": {"part": "up", "node": 10**6}}, "no node"),
    "measurements.flat: off": ("measurements.flat", {"points": [OFF, [50, 5, 1]]}, "points[0]"),
    "no measured points": (
        "deviations.S",
        {"kind": "measured", "files": "none-*.csv", "points": None, "sigma": 1.0},
        "no file 'none-*.csv'",
    ),
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


def errors(folder, *edits):
    """The lines of the error that a scene with these edits ends in."""
    with pytest.raises(SceneError) as caught:
        assemble(read_table(edited(*edits), folder / "scene.toml"), folder / "cache")
    return str(caught.value).splitlines()


@pytest.mark.slow
def test_the_scene_without_errors_is_assembled(folder):
    assembly = assemble(read_table(edited(), folder / "scene.toml"), folder / "cache")
    assert assembly.labels["locator"] == [item["name"] for item in SCENE["locators"]]
    assert isinstance(mic.check(read_table(edited(), folder / "scene.toml"), folder / "cache"), tuple)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_misplaced_item_is_named_whatever_refers_to_it(case, folder):
    place, keys, words = CASES[case]
    (line,) = errors(folder, (place, keys))
    assert place.split(".")[1] in line and words in line and place.split(".")[0] in line


#: Cases that are told of together, in groups of different items.
TOGETHER = (
    ("locators.up5: no node", "clamps.push: off", "welds.W1: off", "deviations.S: off", "measurements.M: no set"),
    ("locators.late: off", "clamps.tong: beside", "fixtures.pad: off", "deviations.field: off", "zones.lap: elsewhere"),
    ("no measured points", "measurements.step: to off", "welds.W2: beside", "clamps.stroke: no set"),
    ("fixtures.pad: no node", "measurements.flat: off", "deviations.F: no hole", "locators.low3: off"),
)


@pytest.mark.parametrize("group", TOGETHER)
def test_all_misplaced_items_are_told_of_together(group, folder):
    cases = [CASES[case] for case in group]
    lines = errors(folder, *((place, keys) for place, keys, _ in cases))
    assert len(lines) == len(cases)
    for place, _, words in cases:
        assert any(place.split(".")[1] in line and words in line for line in lines), (place, lines)
