"""Nothing nonsensical passes as valid, and nothing sensible is warned of.

Each case is an edit of a shipped scene. It ends in an error, or in a warning that names the item and comes from the
rule that is stated: without that rule the case fails.
"""

import copy
import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.random_scenes import Case
from typer.testing import CliRunner

import mic
from mic.geometry.structured import extrude
from mic.model.assembly import assemble
from mic.options import app
from mic.plausibility import FILE, MESHES, PARTS, find_warnings, find_warnings_unplaced, loadable_parts, raise_warnings
from mic.scene import Scene, SceneError
from mic.scene.load import read_table
from verification.scenes import FEW, with_stated_pairs

MESHES_FOLDER = Path(__file__).resolve().parents[1] / "meshes"
ERROR = "error"
RULES = (*FILE, *PARTS, *MESHES)


def table(name):
    """A shipped scene as a table, on coarse meshes and with few pairs."""
    found = tomllib.loads((MESHES_FOLDER / name / "scene.toml").read_text())
    for part in found["parts"]:
        part["size"] = "coarse"
    for zone in found["zones"]:
        zone["pairs"] = 6
    return found


TABLES = {name: table(name) for name in ("lap_joint", "hat_on_plate")}


def item(scene, where):
    """The row that `table.name` stands for, or a section."""
    key, _, name = where.partition(".")
    rows = scene.setdefault(key, {} if key in ("monte_carlo", "report", "path") else [])
    return next(row for row in rows if row.get("name", row.get("kind")) == name) if name else rows


def put(where, **keys):
    """Keys of one item; None takes a key out."""

    def edit(scene):
        row = item(scene, where)
        for key, value in keys.items():
            row[key] = value
            if value is None:
                del row[key]

    return edit


def like(where, **keys):
    """A further item, as one that is there but for some keys."""

    def edit(scene):
        item(scene, where.partition(".")[0]).append({**item(scene, where), **keys})

    return edit


def add(key, **keys):
    return lambda scene: scene.setdefault(key, []).append(keys)


def drop(*wheres):
    def edit(scene):
        for where in wheres:
            key, _, name = where.partition(".")
            scene[key] = [row for row in scene[key] if name and row.get("name", row.get("kind")) != name]

    return edit


def all_of(*edits):
    def edit(scene):
        for one in edits:
            one(scene)

    return edit


def every(key, **keys):
    def edit(scene):
        for row in scene[key]:
            row.update(keys)

    return edit


def located_again(stage):
    """The lower part's six locators again, where they are, for a stage of another station."""

    def edit(scene):
        own = [row for row in scene["locators"] if row["part"] == "lower"]
        scene["locators"] += [{**row, "name": f"{row['name']}-{stage}", "stage": stage} for row in own]

    return edit


def late(name):
    """A locator that engages in a second clamp stage."""

    def edit(scene):
        scene["stages"].insert(2, {"kind": "clamp", "name": "second"})
        item(scene, f"locators.{name}")["stage"] = "second"

    return edit


def edited(name, edit) -> Scene:
    scene = copy.deepcopy(TABLES[name])
    edit(scene)
    return read_table(scene, MESHES_FOLDER / name / "scene.toml")


# Numbers outside what is usual: where, key, values; each is a case.
NUMBERS = [
    ("parts.lower", "thickness", [0.001, 0.1, 12.0, 40.0, 0.0, -1.0, True, "1", float("nan")]),
    ("parts.upper", "young", [210, 210e9, 0.21, 2.1e6, 0, -210e3, "210000", False]),
    ("parts.upper", "poisson", [0.4999999, 0.0, -0.9, 0.5, 3.0, True]),
    ("parts.upper", "size", [0.05, 500.0, -3.0, 0, True]),
    ("welds.W1", "gun", [1.0, 5e6, 0.0, True]),
    ("parts.lower", "offset", [2.0, -1.5, 50.0, True]),
    ("zones.lap", "gap", [12.0, 1000.0, -1.0, True]),
    ("locators.lower-A1", "radius", [500.0, 60.0, 0.05, -4.0, float("inf"), True]),
    ("locators.lower-A1", "stiffness", [1e300, 1e-9, 0.0, True]),
    ("clamps.C1-upper", "radius", [400.0, 0.01, -1.0]),
    ("clamps.C1-upper", "force", [1e9, 2e4, 1e-6, 0.0, -60.0, float("nan"), True, "60"]),
    ("welds.W1", "radius", [40.0, 0.1, -2.5]),
    ("zones.lap", "friction", [27.0, 1.5, -0.2, "0.27", True, float("inf")]),
    ("zones.lap", "tangential_stiffness", [1e-6, 1e12, 0.0]),
    ("zones.lap", "max_gap", [1000.0, 50.0, 0.001, 0.0, -2.0, True]),
    ("zones.lap", "max_angle_deg", [0.5, 89.0, 90.0, -30.0]),
    ("zones.lap", "pairs", [1, 100000, 0, -5, 3.5, True]),
    ("zones.lap", "patch", [0.01, 400.0, -1.0, "disc"]),
    ("zones.lap", "nominal_overlap", [50.0, 1.5, -1.0, "always"]),
    ("deviations.F1", "radius", [600.0, 0.02, -8.0]),
    ("deviations.F1", "mean", [1e6, -5000.0, float("inf"), "5", True]),
    ("deviations.F1", "sigma", [1e7, 4000.0, -1.0, True]),
    ("deviations.D1", "sigma", [1000.0, 10.0, -0.02, "0.02"]),
    ("deviations.D1", "mean", [1000.0, -25.0]),
    ("measurements.M1", "radius", [100.0, 0.01, -1.0]),
    ("measurements.M1", "upper", [1000.0, -0.999, -2.0, True]),
    ("measurements.M1", "lower", [0.5, -400.0]),
    ("stages.clamp", "increments", [100000, 0, -1, 2.5, True]),
    ("monte_carlo", "samples", [2, 0, -10, 10**7, 1.5, True]),
    ("monte_carlo", "seed", [-1, 0.5, True]),
]
#: The rule where it is not that of the table and the key.
OTHER_RULES = {
    ("nominal_overlap", "lap"): "overlap-let-through",
    ("mean", "F1"): "moves-much",
    ("sigma", "F1"): "moves-much",
    ("mean", "D1"): "moves-much",
    ("sigma", "D1"): "moves-much",
    ("lower", "M1"): ("limits-aside", "tolerance-odd"),
    ("upper", "M1"): ("limits-aside", "tolerance-odd"),
}
NONSENSE = {}
for place, key, values in NUMBERS:
    name = place.partition(".")[2]
    rule = OTHER_RULES.get((key, name), f"{place.partition('.')[0]}.{key}")
    for value in values:
        NONSENSE[f"{place}.{key} = {value!r}"] = ("lap_joint", put(place, **{key: value}), name or place, rule)

UP, DOWN = [0, 0, 1], [0, 0, -1]
STACKED = {"name": "lower-A9", "part": "lower", "point": [5, 5, 0], "direction": UP}
UNDER = {"name": "plate-A8", "part": "plate", "point": [110, -38, 0], "direction": UP, "stage": "clamp"}
KEPT = [row["name"] for row in TABLES["hat_on_plate"]["locators"] if "stage" not in row]
LOW = {"name": "D8", "kind": "locator", "target": "plate-A8", "mean": -0.2, "sigma": 0.01}
NONSENSE |= {
    # Clamps
    "tongs that pull the parts apart": (
        "lap_joint",
        all_of(put("clamps.C1-upper", direction=UP), put("clamps.C1-lower", direction=DOWN)),
        "C1-upper",
        ("tongs-askew", "clamp-pulls"),
    ),
    "one jaw that pulls": (
        "lap_joint",
        put("clamps.C1-upper", direction=UP),
        "C1-upper",
        ("tongs-askew", "clamp-pulls"),
    ),
    "a jaw that pulls, alone": ("hat_on_plate", put("clamps.C1", direction=UP), "C1", "clamp-pulls"),
    "a stroke that lifts": ("hat_on_plate", put("clamps.C3", direction=UP), "C3", "clamp-pulls"),
    "tongs of which one jaw is gone": ("lap_joint", drop("clamps.C1-lower"), "C1-upper", "presses-one-side"),
    "a clamp whose rest is gone": ("hat_on_plate", drop("locators.plate-A6"), "plate 33 mm from", "unbacked"),
    "a clamp whose rest comes later": ("hat_on_plate", late("plate-A7"), "C2", "unbacked"),
    "a clamp whose rest is aslant": (
        "hat_on_plate",
        put("locators.plate-A6", direction=[0, 0.8, 0.6]),
        "C1",
        "unbacked",
    ),
    "a clamp beside the jaw of another": (
        "hat_on_plate",
        all_of(drop("locators.plate-A6"), like("clamps.C1", name="C5", part="plate", point=[62, -38, 0], direction=UP)),
        "C1",
        "unbacked",
    ),
    "a stroke over a rest": ("hat_on_plate", add("locators", **UNDER), "C3", "squeezed"),
    "a stroke over a rest that is a little low": (
        "hat_on_plate",
        all_of(add("locators", **UNDER), add("deviations", **{**LOW, "mean": -0.04})),
        "C3",
        "squeezed",
    ),
    "a stroke beyond what a low rest leaves": (
        "hat_on_plate",
        all_of(add("locators", **UNDER), add("deviations", **LOW), put("clamps.C3", stroke=0.2)),
        "C3",
        "squeezed",
    ),
    "a stroke over the edge of a rest": (
        "hat_on_plate",
        add("locators", **{**UNDER, "point": [118, -38, 0], "radius": 5}),
        "C3",
        "squeezed",
    ),
    "a stroke against another": (
        "hat_on_plate",
        like("clamps.C3", name="C5", part="plate", point=[110, -38, 0], direction=UP),
        "C3",
        "squeezed",
    ),
    "tongs by strokes that go through each other": (
        "lap_joint",
        all_of(put("clamps.C1-upper", force=None, stroke=0.1), put("clamps.C1-lower", force=None, stroke=0.1)),
        "C1-upper",
        "squeezed",
    ),
    "tongs of two forces": ("lap_joint", put("clamps.C1-upper", force=600), "C1-upper", "tongs-askew"),
    "tongs that push one way": ("lap_joint", put("clamps.C1-lower", direction=DOWN), "C1-upper", "tongs-askew"),
    "a tangential clamp": ("lap_joint", put("clamps.C1-upper", direction=[1, 0, 0]), "C1-upper", "clamp-inclined"),
    "tangential strokes": ("hat_on_plate", put("clamps.C3", direction=[0, 1, 0.1]), "C3", "clamp-inclined"),
    "a stroke of a metre": ("hat_on_plate", put("clamps.C3", stroke=1000), "C3", "clamps.stroke"),
    "a stroke back by a metre": ("hat_on_plate", put("clamps.C3", stroke=-1000), "C3", "clamps.stroke"),
    "a stroke of 20 mm": ("hat_on_plate", put("clamps.C4", stroke=20), "C4", "clamps.stroke"),
    "two clamps in one place": ("lap_joint", like("clamps.C1-upper", name="C2"), "C1-upper", "clamped-twice"),
    "two strokes in one place": ("hat_on_plate", like("clamps.C3", name="C5", stroke=0.5), "C3", "held-twice"),
    "a pad larger than the part": ("lap_joint", put("clamps.C1-lower", radius=28), "C1-lower", "pad-large"),
    "a force that turns round": ("hat_on_plate", put("deviations.D2", sigma=60), "D2", "clamp-may-pull"),
    "a force that is taken away": ("hat_on_plate", put("deviations.D2", mean=-90), "D2", "clamp-may-pull"),
    "a clamp far off": ("lap_joint", put("clamps.C1-upper", point=[72, 12.5, 4]), "C1-upper", "off-the-sheet"),
    "a limit of a millinewton": ("hat_on_plate", put("clamps.C3", limit=1e-3), "C3", "clamps.limit"),
    "a limit of a meganewton": ("hat_on_plate", put("clamps.C3", limit=1e6), "C3", "clamps.limit"),
    "a limit of a force": ("lap_joint", put("clamps.C1-upper", limit=100), "C1-upper", ERROR),
    # Locators
    "locators within a micron of a line": (
        "lap_joint",
        put("locators.lower-A3", point=[5.001, 12.5, 0]),
        "lower-A3",
        "locators-in-line",
    ),
    "locators nearly on a line": (
        "hat_on_plate",
        put("locators.plate-A3", point=[14, 0, 0]),
        "plate-A3",
        "locators-in-line",
    ),
    "two pins side by side": ("lap_joint", put("locators.upper-B2", point=[153, 5, 1]), "upper-B2", "locators-in-line"),
    "locators on one line": ("lap_joint", put("locators.lower-A3", point=[5, 12.5, 0]), "lower", ERROR),
    "locators of one direction": ("lap_joint", put("locators.lower-C1", direction=[0, 1, 0]), "lower", ERROR),
    "the same locator again": ("lap_joint", add("locators", **STACKED), "lower-A1", "held-twice"),
    "locators back to back": ("lap_joint", add("locators", **{**STACKED, "direction": DOWN}), "lower-A1", "held-twice"),
    "locators that contradict": (
        "lap_joint",
        all_of(
            add("locators", **STACKED),
            add("deviations", name="D9", kind="locator", target="lower-A9", mean=0.5, sigma=0.1),
        ),
        "mm away",
        "held-twice",
    ),
    "a stroke against a locator": (
        "lap_joint",
        add("clamps", name="C9", part="lower", point=[5, 5, 0], direction=UP, stroke=0.4),
        "mm away",
        "held-twice",
    ),
    "a locator beside its sheet": (
        "lap_joint",
        put("locators.lower-A1", point=[5, -4, 0]),
        "lower-A1",
        "off-the-sheet",
    ),
    "no locators": ("lap_joint", every("locators", part="lower"), "upper", ERROR),
    "a locator without a direction": ("lap_joint", put("locators.lower-A1", direction=[0, 0, 0]), "lower-A1", ERROR),
    "a locator of two directions": ("lap_joint", put("locators.lower-A1", direction=[0, 1]), "lower-A1", ERROR),
    "a point of texts": ("lap_joint", put("locators.lower-A1", point=["5", "5", "0"]), "lower-A1", ERROR),
    "a point of booleans": ("lap_joint", put("locators.lower-A1", point=[True, 5, 0]), "lower-A1", ERROR),
    # Welds
    "welds upon each other": ("lap_joint", like("welds.W1", name="W9"), "W9", "welds-upon-each-other"),
    "welds that overlap": (
        "lap_joint",
        like("welds.W1", name="W9", point=[88, 9, 0.5]),
        "W9",
        "welds-upon-each-other",
    ),
    "a weld over the edge": ("lap_joint", put("welds.W1", point=[88, 0.5, 0.5]), "W1", "nugget-over-edge"),
    "a weld beside the parts": ("lap_joint", put("welds.W1", point=[88, -3.5, 0.5]), "W1", "off-the-sheet"),
    "a weld of a part with itself": ("lap_joint", put("welds.W1", parts=["lower", "lower"]), "W1", ERROR),
    "a weld with a fixture": ("hat_on_plate", put("welds.W1", parts=["plate", "stop"]), "W1", ERROR),
    "a nugget as large as the sheet": ("lap_joint", put("welds.W1", radius=20), "W1", ("welds.radius", "pad-large")),
    "welds and no zone": (
        "lap_joint",
        all_of(drop("zones.lap"), put("report", laws=["frictionless"])),
        "W1",
        "welded-without-zone",
    ),
    "a weld stage without welds": ("lap_joint", drop("welds.W1", "welds.W2"), "weld", "welds-nothing"),
    "close as a text": ("lap_joint", put("welds.W1", close="yes"), "W1", ERROR),
    "close as a number": ("lap_joint", put("welds.W1", close=1), "W1", ERROR),
    # Zones
    "a zone twice": ("lap_joint", like("zones.lap", name="again"), "again", "zones-alike"),
    "a zone turned round": (
        "lap_joint",
        like("zones.lap", name="again", parts=["upper", "lower"]),
        "in the opposite direction",
        "zones-alike",
    ),
    "a zone within a zone": (
        "lap_joint",
        like("zones.lap", name="again", box=[[65, 5, -1], [90, 20, 2]]),
        "again",
        "zones-alike",
    ),
    "a zone of next to nothing": ("lap_joint", put("zones.lap", box=[[70, 10, -1], [73, 13, 2]]), "lap", "zone-small"),
    "a box inside out": ("lap_joint", put("zones.lap", box=[[90, 5, -1], [65, 20, 2]]), "lap", ERROR),
    "a path that runs back": (
        "lap_joint",
        put("zones.lap", path=[[60, 12, 0], [100, 12, 0], [70, 12, 0]], within=12.5),
        "lap",
        "path-doubles-back",
    ),
    "a path that stands still": (
        "lap_joint",
        put("zones.lap", path=[[60, 12, 0], [60, 12, 0], [100, 12, 0]], within=12.5),
        "lap",
        ERROR,
    ),
    "a tube of half a metre": (
        "lap_joint",
        put("zones.lap", path=[[60, 12, 0], [100, 12, 0]], within=500),
        "lap",
        "zones.within",
    ),
    "a tube like a needle": (
        "lap_joint",
        put("zones.lap", path=[[60, 12, 0], [100, 12, 0]], within=0.2),
        "lap",
        "zones.within",
    ),
    "spacing of a metre": ("lap_joint", put("zones.lap", pairs=None, spacing=1000), "lap", "zones.spacing"),
    "a spacing factor in percent": ("lap_joint", put("zones.lap", spacing_factor=70), "lap", "zones.spacing_factor"),
    "friction that nobody gave": ("lap_joint", put("zones.lap", friction=None), "lap", "friction-forgotten"),
    "friction of 40 in a stage": (
        "lap_joint",
        put("zones.lap", friction={"clamp": 40.0, "default": 0.2}),
        "lap",
        "zones.friction",
    ),
    "friction of true in a stage": (
        "lap_joint",
        put("zones.lap", friction={"clamp": True, "default": 0.2}),
        "lap",
        ERROR,
    ),
    "friction table beyond yield": (
        "lap_joint",
        put("zones.lap", friction_table=[[0, 0.2], [5e6, 0.2]]),
        "lap",
        "pressure-odd",
    ),
    "friction table of 20": ("lap_joint", put("zones.lap", friction_table=[[0, 20.0]]), "lap", "pressure-odd"),
    "friction power of 20": (
        "lap_joint",
        put("zones.lap", friction_power={"mu0": 20.0, "p0": 1.0, "n": 0.1, "mu_min": 0.1, "mu_max": 30.0}),
        "lap",
        "pressure-odd",
    ),
    "a zone of one part": ("lap_joint", put("zones.lap", parts=["upper", "upper"]), "lap", ERROR),
    "pairs of nothing": ("lap_joint", put("zones.lap", points=[], pairs=None), "lap", ERROR),
    # Fixtures
    "a pad that looks away": ("hat_on_plate", put("fixtures.stop", normal=DOWN), "stop", "fixture-turned"),
    "a pad above the sheet": (
        "hat_on_plate",
        all_of(put("fixtures.stop", point=[120, 0, 0.6])),
        "stop",
        "fixture-turned",
    ),
    "a pad within a sheet that it does not touch": (
        "hat_on_plate",
        all_of(
            add("fixtures", name="side", point=[80, -35, 0.5], normal=UP, radius=5),
            add("zones", name="side", parts=["side", "hat"]),
        ),
        "side",
        "fixture-inside",
    ),
    "a pad of a metre": ("hat_on_plate", put("fixtures.stop", radius=1000), "stop", "fixtures.radius"),
    "a pad like a needle": ("hat_on_plate", put("fixtures.stop", radius=0.05), "stop", "fixtures.radius"),
    "a pad that nothing meets": ("hat_on_plate", drop("zones.stop"), "stop", "stands-alone"),
    "a pad without a normal": ("hat_on_plate", put("fixtures.stop", normal=None), "stop", ERROR),
    # Deviations
    "all sigma zero": ("lap_joint", every("deviations", sigma=0), "deviations", "nothing-varies"),
    "no deviation": ("lap_joint", drop("deviations"), "deviations", "nothing-varies"),
    "a corrective force that does nothing": (
        "lap_joint",
        put("deviations.F1", mean=0, sigma=0),
        "F1",
        "deviates-by-nothing",
    ),
    "a corrective force onto a locator": (
        "lap_joint",
        put("deviations.F1", point=[155, 5, 1]),
        "F1",
        "force-on-a-locator",
    ),
    "a corrective force off its part": (
        "lap_joint",
        put("deviations.F1", point=[65, 20, 4.5]),
        "F1",
        "off-the-sheet",
    ),
    "a pad of the force as large as the part": ("lap_joint", put("deviations.F1", radius=30), "F1", "pad-large"),
    "one deviation twice": ("lap_joint", like("deviations.D1", name="D2"), "D2", "deviates-twice"),
    "one force twice": ("lap_joint", like("deviations.F1", name="F9"), "F9", "deviates-twice"),
    "a deviation of another kind": ("lap_joint", put("deviations.D1", kind="weld"), "D1", ERROR),
    "a deviation of what there is not": ("lap_joint", put("deviations.D1", target="nothing"), "D1", ERROR),
    # Measurements
    "limits as coordinates": ("lap_joint", put("measurements.M1", lower=4, upper=6), "M1", "limits-aside"),
    "measured where it is held": (
        "lap_joint",
        put("measurements.M1", part="lower", point=[5, 5, 0]),
        "M1",
        "measured-at-a-locator",
    ),
    "measured beside the part": ("lap_joint", put("measurements.M1", point=[160, 12.5, 4]), "M1", "off-the-sheet"),
    "measured twice": ("lap_joint", like("measurements.M1", name="M9"), "M9", "measured-twice"),
    "nothing measured": ("lap_joint", drop("measurements"), "measurements", "nothing-read"),
    # Process
    "welded before a clamp closes": (
        "lap_joint",
        lambda scene: scene["stages"].insert(1, scene["stages"].pop(2)),
        "weld",
        "welded-open",
    ),
    "welded when all is open": (
        "lap_joint",
        lambda scene: scene["stages"].insert(2, {"kind": "release", "name": "early"}),
        "weld",
        "welded-open",
    ),
    "a point as a text": ("lap_joint", put("measurements.M1", point="10, 5, 0"), "in brackets", ERROR),
    "settle as a text": ("lap_joint", put("stages.locate", settle="no"), "locate", ERROR),
    "settle as a number": ("lap_joint", put("stages.locate", settle=0), "locate", ERROR),
    "order as a text": ("lap_joint", put("stages.clamp", order="C1-upper"), "order", ERROR),
    "stages backwards": ("lap_joint", lambda scene: scene["stages"].reverse(), "stages", ERROR),
    "accuracy of a millionth": (
        "lap_joint",
        put("parts.lower", size=None, accuracy=1e-6),
        "lower",
        "parts.accuracy",
    ),
    "slip as a text": ("lap_joint", put("report", slip="yes"), "slip", ERROR),
    "fields as a number": ("lap_joint", put("report", fields=1), "fields", ERROR),
    "a law of nobody": ("lap_joint", put("report", laws=["glue"]), "glue", ERROR),
    "a part that meets nothing": (
        "hat_on_plate",
        all_of(
            lambda scene: scene["parts"].append({**scene["parts"][0], "name": "third"}),
            lambda scene: scene["locators"].extend(
                {**row, "name": f"third{row['name']}", "part": "third"}
                for row in scene["locators"][:8]
                if row.get("stage") is None
            ),
        ),
        "third",
        "stands-alone",
    ),
}


@pytest.fixture(scope="module")
def assemblies(cache):
    """The shipped scenes on coarse meshes, by name."""
    return {name: assemble(edited(name, lambda scene: None), cache) for name in TABLES}


#: Rules for which the pairs of the edited scene must be found; for the others the shipped pairs do.
PAIRED = ("zones-alike", "zone-small")


def judged(name, scene, rules, assemblies, cache):
    """The warnings of an edited scene, on the meshes and pairs of the shipped one where they do."""
    found = find_warnings(scene)
    if any(warned.rule in rules for warned in found):
        return found
    if set(rules) & set(PAIRED):
        return find_warnings(scene, assemble(scene, cache))
    return find_warnings(scene, replace(assemblies[name], scene=scene))


@pytest.mark.parametrize("case", NONSENSE)
def test_each_implausible_input_is_refused_or_warned_of(case, assemblies, cache):
    name, edit, words, rule = NONSENSE[case]
    rules = (rule,) if isinstance(rule, str) else rule
    try:
        scene = edited(name, edit)
    except SceneError as error:
        assert words in str(error)
        return
    assert rules != (ERROR,), "no error was raised"
    found = judged(name, scene, rules, assemblies, cache)
    assert [warned for warned in found if warned.rule in rules and words in str(warned)], [str(one) for one in found]


def test_there_are_150_implausible_cases_and_one_for_each_rule():
    assert len(NONSENSE) >= 150
    named = {one for *_, rule in NONSENSE.values() for one in ([rule] if isinstance(rule, str) else rule)}
    untried = {rule.name for rule in RULES} - named
    assert untried == {
        "extent",
        "no-sheet",
        "coarse",
        "weld-over-gap",
        "weld-off-zone",
        "overlap-closed",
        "overlap-kept",
        "parts-cross",
        "bend-coarse",
        "samples-twice",
        "samples-narrow",
    }
    assert len({rule.name for rule in RULES}) == len(RULES)


SENSIBLE = {
    "as shipped": ("lap_joint", lambda scene: None),
    "the hat as shipped": ("hat_on_plate", lambda scene: None),
    "thin sheets": ("lap_joint", every("parts", thickness=0.4)),
    "thick sheets": ("lap_joint", put("parts.lower", thickness=5.0)),
    "aluminium": ("lap_joint", every("parts", young=70e3, poisson=0.33)),
    "magnesium": ("lap_joint", every("parts", young=45e3, poisson=0.35)),
    "titanium": ("lap_joint", put("parts.upper", young=110e3, poisson=0.34)),
    "whole numbers": ("lap_joint", put("parts.upper", young=210000, thickness=1)),
    "nodal locators": ("lap_joint", every("locators", radius=0)),
    "pins": ("lap_joint", every("locators", radius=1.5)),
    "wide pads": ("lap_joint", put("clamps.C1-upper", radius=8)),
    "gentle tongs": ("lap_joint", every("clamps", force=15)),
    "strong tongs": ("lap_joint", every("clamps", force=3000)),
    "tongs that differ a little": ("lap_joint", put("clamps.C1-upper", force=66)),
    "tongs by strokes": (
        "lap_joint",
        all_of(put("clamps.C1-upper", force=None, stroke=-0.05), put("clamps.C1-lower", force=None, stroke=-0.05)),
    ),
    "tongs askew by some degrees": ("lap_joint", put("clamps.C1-upper", direction=[0.1, 0.05, -1])),
    "a clamp against a locator": (
        "lap_joint",
        add("clamps", name="C9", part="lower", point=[5, 5, 0], direction=DOWN, force=200),
    ),
    "a light clamp beside its rest": (
        "hat_on_plate",
        all_of(drop("locators.plate-A6"), put("clamps.C1", force=20)),
    ),
    "a jaw opposite in place of a rest": (
        "hat_on_plate",
        all_of(drop("locators.plate-A6"), like("clamps.C1", name="C5", part="plate", point=[50, -38, 0], direction=UP)),
    ),
    "a stroke of half a millimetre": ("hat_on_plate", put("clamps.C3", stroke=0.5)),
    "a stroke that lifts off a little": ("hat_on_plate", put("clamps.C3", stroke=-0.5)),
    "a clamp of limited force": ("hat_on_plate", put("clamps.C3", limit=400.0)),
    "guns": ("lap_joint", every("welds", gun=2500.0)),
    "a stroke of limited force over a rest": (
        "hat_on_plate",
        all_of(add("locators", **UNDER), put("clamps.C3", limit=400.0)),
    ),
    "a stroke over a spring": ("hat_on_plate", add("locators", **UNDER, stiffness=500.0)),
    "a stroke over a rest that is low": (
        "hat_on_plate",
        all_of(add("locators", **UNDER), add("deviations", **LOW)),
    ),
    "a stroke beside a rest": ("hat_on_plate", add("locators", **{**UNDER, "point": [122, -38, 0]})),
    "a stroke over a rest that has been taken away": (
        "hat_on_plate",
        all_of(
            lambda scene: scene["stages"].insert(1, {"kind": "clamp", "name": "first"}),
            lambda scene: scene["stages"].insert(2, {"kind": "release", "name": "opened", "keep": KEPT}),
            add("locators", **{**UNDER, "stage": "first"}),
        ),
    ),
    "a clamp that varies by a tenth": ("hat_on_plate", put("deviations.D2", sigma=10)),
    "small nuggets": ("lap_joint", every("welds", radius=1.5)),
    "three welds": ("lap_joint", like("welds.W1", name="W3", point=[75, 12.5, 0.5])),
    "a weld told on the skin of a third sheet": ("lap_joint", put("welds.W1", point=[88, 6, 2.4])),
    "welds that close": ("lap_joint", every("welds", close=True)),
    "welds without moment": ("lap_joint", every("welds", moment=False)),
    "no friction, as stated": ("lap_joint", put("zones.lap", friction=0)),
    "no friction, no law of it": (
        "lap_joint",
        all_of(put("zones.lap", friction=None), put("report", laws=["frictionless"])),
    ),
    "dry friction": ("lap_joint", put("zones.lap", friction=0.7)),
    "friction by stage": ("lap_joint", put("zones.lap", friction={"clamp": 0.12, "default": 0.3})),
    "friction by pressure": ("lap_joint", put("zones.lap", friction_table=[[0, 0.3], [10, 0.2], [100, 0.15]])),
    "contacts that yield": ("lap_joint", put("zones.lap", tangential_stiffness=500.0)),
    "a wide search": ("lap_joint", put("zones.lap", max_gap=5.0, max_angle_deg=20.0)),
    "a limit of overlap": ("lap_joint", put("zones.lap", nominal_overlap=0.3)),
    "many increments": ("lap_joint", put("stages.clamp", increments=32)),
    "all at once": ("lap_joint", put("stages.clamp", path="one-step")),
    "a stage without settling": ("lap_joint", put("stages.locate", settle=False)),
    "measured in the fixture": ("lap_joint", drop("stages.release")),
    "inspected on another fixture": ("lap_joint", located_again("measure")),
    "respot in another station": (
        "lap_joint",
        all_of(
            lambda scene: scene["stages"].insert(3, {"kind": "locate", "name": "geo"}),
            lambda scene: scene["stages"].insert(4, {"kind": "weld", "name": "respot"}),
            like("welds.W1", name="W3", point=[75, 12.5, 0.5], stage="respot"),
            put("stages.release", keep=None),
            located_again("geo"),
        ),
    ),
    "tacked by guns before the clamps close": (
        "lap_joint",
        all_of(lambda scene: scene["stages"].insert(1, scene["stages"].pop(2)), every("welds", gun=1500.0)),
    ),
    "welded one by one": ("lap_joint", put("stages.weld", sequence=True)),
    "a locator that varies": ("lap_joint", put("deviations.D1", mean=0.3, sigma=0.2)),
    "a uniform deviation": ("lap_joint", put("deviations.F1", distribution="uniform")),
    "a constant among what varies": ("lap_joint", put("deviations.F1", sigma=0)),
    "one nominal assembly": ("lap_joint", all_of(drop("deviations"), put("monte_carlo", samples=1))),
    "a large Monte Carlo": ("lap_joint", put("monte_carlo", samples=20000)),
    "a tight tolerance": ("lap_joint", put("measurements.M1", lower=-0.1, upper=0.1)),
    "a tolerance of one side": ("lap_joint", put("measurements.M1", lower=0, upper=1.5)),
    "slips alone": ("lap_joint", drop("measurements", "stages.measure")),
    "a third flange layer's locator": (
        "lap_joint",
        add("locators", name="lower-A4", part="lower", point=[40, 20, 0], direction=UP, stage="clamp"),
    ),
    "a pad in the hollow of a hat": (
        "hat_on_plate",
        all_of(
            add("fixtures", name="side", point=[80, 0, 30.5], normal=UP, radius=5),
            add("zones", name="side", parts=["side", "hat"]),
        ),
    ),
    "a small pad": ("hat_on_plate", put("fixtures.stop", radius=5)),
    "points on the sheet's outer face": ("lap_joint", put("clamps.C1-upper", point=[72, 12.5, 1.5])),
}


@pytest.mark.parametrize("case", SENSIBLE)
def test_no_plausible_input_is_warned_of(case, assemblies):
    name, edit = SENSIBLE[case]
    scene = edited(name, edit)
    found = find_warnings(scene, replace(assemblies[name], scene=scene))
    assert not found, [str(warned) for warned in found]


def test_tongs_that_press_a_stack_pair_by_pair_are_not_askew():
    """Of three sheets, the jaws on the lowest two push alike, and so do those on the upper two."""
    upon = [
        like(f"clamps.C1-{of}", name=f"C8-{part}", part=part) for of, part in (("lower", "upper"), ("upper", "top"))
    ]
    located = [
        like(f"locators.{row['name']}", name=f"top-{row['name']}", part="top")
        for row in TABLES["lap_joint"]["locators"]
        if row["part"] == "upper"
    ]
    scene = edited("lap_joint", all_of(like("parts.upper", name="top"), *located, *upon))
    about = lambda found: [str(warned) for warned in found if warned.rule == "tongs-askew"]
    assert not about(find_warnings(scene))
    alone = edited("lap_joint", all_of(like("parts.upper", name="top"), *located, upon[1]))
    assert about(find_warnings(alone))


def test_there_are_thirty_plausible_cases():
    assert len(SENSIBLE) >= 30


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["lap_joint", "hat_on_plate", "bracket", pytest.param("wheelhouse", marks=pytest.mark.fem)]
)
def test_shipped_scenes_have_no_warning(name, cache):
    scene = with_stated_pairs(mic.load_scene(MESHES_FOLDER / name))
    assert find_warnings(scene, assemble(scene, cache)) == ()
    watched = mic.load_scene(MESHES_FOLDER / "wheelhouse" / "watched.toml")
    assert find_warnings(watched) == ()  # else it is the wheelhouse


SHEET = {"thickness": 1.0, "young": 210e3, "poisson": 0.3}


def six_locators(part: str, places) -> list[dict]:
    """Locators of a part at points, each along an axis."""
    directions = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
    return [
        {"name": f"{part}{i}", "part": part, "point": point, "direction": directions[axis], "radius": 0.0}
        for i, (point, axis) in enumerate(places)
    ]


def plates(lower=(100.0, 40.0, 5.0), upper=(100.0, 40.0, 5.0), height=1.0, tilt=0.0, **keys) -> Case:
    """Two plates of length, width and element size, `height` mm apart; the upper one leans by `tilt` mm over 40 mm."""
    z = lambda x, y: height + tilt * (y / 40.0 - 0.5)
    meshes = {
        "lower": extrude([(0, 0), (lower[1], 0)], 0.0, lower[0], lower[2])[:2],
        "upper": extrude([(0, z(0, 0)), (upper[1], z(0, upper[1]))], 0.0, upper[0], upper[2])[:2],
    }
    locators = []
    for part, (length, width, _) in (("lower", lower), ("upper", upper)):
        at = lambda x, y, part=part, length=length, width=width: (
            x * length,
            y * width,
            0.0 if part == "lower" else z(x * length, y * width),
        )
        places = [(0.1, 0.1, "z"), (0.1, 0.9, "z"), (0.9, 0.5, "z"), (0.1, 0.1, "y"), (0.9, 0.1, "y"), (0.1, 0.5, "x")]
        locators += six_locators(part, [(at(x, y), axis) for x, y, axis in places])
    scene = {
        "name": "plates",
        "parts": [{"name": name, "mesh": f"{name}.inp", **SHEET} for name in meshes],
        "locators": locators,
        "zones": [{"name": "between", "parts": ["lower", "upper"], "friction": 0.2, "pairs": 6}],
        "stages": [{"kind": "locate"}, {"kind": "clamp"}, {"kind": "weld"}, {"kind": "release"}],
        "deviations": [{"name": "D", "kind": "locator", "target": "upper0", "sigma": 0.1}],
        "clamps": [
            {"name": f"C-{part}", "part": part, "point": (50.0, 20.0, h), "direction": (0, 0, way), "force": 100.0}
            for part, h, way in (("lower", 0.0, 1.0), ("upper", z(50.0, 20.0), -1.0))
        ],
        "welds": [{"name": "W", "parts": ["lower", "upper"], "point": [30.0, 20.0, height / 2]}],
    }
    scene["zones"][0] |= keys
    return Case(scene, meshes, np.zeros((0, 1)))


def bent(facets: int) -> Case:
    """Two sheets about one axis, 1 mm apart, through 120° in so many facets."""
    angle = np.radians(np.linspace(-60, 60, facets + 1))
    case = plates()
    meshes, locators = {}, []
    for part, radius in (("lower", 40.0), ("upper", 41.0)):
        at = lambda x, turn, radius=radius: (x, *(radius * np.array([np.sin(turn), np.cos(turn)])))
        profile = np.column_stack([radius * np.sin(angle), radius * np.cos(angle)])
        meshes[part] = extrude(profile, 0.0, 100.0, 7.5)[:2]
        places = [(10, -0.9, "z"), (10, 0.9, "z"), (90, 0, "z"), (10, 0, "y"), (90, 0, "y"), (10, 0.5, "x")]
        locators += six_locators(part, [(at(x, turn), axis) for x, turn, axis in places])
    clamps = [clamp | {"point": (50.0, 0.0, height)} for clamp, height in zip(case.table["clamps"], (40.0, 41.0))]
    stages = [{"kind": "locate"}, {"kind": "clamp"}, {"kind": "release"}]
    table = case.table | {"locators": locators, "clamps": clamps, "stages": stages, "welds": []}
    return Case(table, meshes, case.deviations)


def stacked(force=100.0, touching=True, **rest) -> Case:
    """Three plates of which the lowest has locators of its own, one clamp upon them, and what is given under it."""
    case = plates()
    table, meshes = copy.deepcopy(case.table), {**case.meshes, "bottom": extrude([(0, -1), (40, -1)], 0, 100, 5)[:2]}
    table["parts"].append(table["parts"][0] | {"name": "bottom", "mesh": "bottom.inp"})
    table["locators"] += [
        {**row, "name": f"bottom{i}", "part": "bottom", "point": (*row["point"][:2], -1.0)}
        for i, row in enumerate(table["locators"][:6])
    ]
    table["clamps"] = [row | {"force": force} for row in table["clamps"] if row["part"] == "upper"]
    if touching:
        table["zones"].append(table["zones"][0] | {"name": "below", "parts": ["bottom", "lower"]})
    for key, rows in rest.items():
        table[key] = table.get(key, []) + rows
    return Case(table, meshes, case.deviations)


def held(stroke=0.0, case=None, **rest) -> Case:
    """As `stacked`, or another case, whose clamps hold a position."""
    case = stacked(**rest) if case is None else case
    for row in case.table["clamps"]:
        del row["force"]
        row["stroke"] = stroke
    return case


#: Under the lowest of the three: a locator, or a pad upon which it lies.
LOCATOR = {"name": "rest", "part": "bottom", "point": (50.0, 20.0, -1.0), "direction": (0, 0, 1), "stage": "clamp"}
PAD = {"name": "pad", "point": (50.0, 20.0, -1.5), "normal": (0, 0, 1), "radius": 6.0}
UPON = {"name": "upon", "parts": ["pad", "bottom"], "friction": 0.2, "pairs": 4}

#: What only another geometry shows: the plates, and what is said of them.
SHAPED = {
    "as they should be": (plates(), None, ""),
    "in metres": (plates((0.1, 0.04, 0.005), (0.1, 0.04, 0.005)), "extent", "part lower"),
    "as long as a street": (plates((9e3, 4e3, 400.0)), "extent", "part lower"),
    "thicker than a sheet": (plates((15.0, 10.0, 1.0), (15.0, 10.0, 1.0)), "no-sheet", "part lower"),
    "of two elements": (plates((100.0, 40.0, 40.0)), "coarse", "part lower"),
    "apart": (plates(height=2.8, max_gap=4.0), "weld-over-gap", "weld W"),
    "on the wrong side": (plates(height=-1.0), "clamp-pulls", "clamp C-upper"),
    "through each other": (plates(height=0.5, tilt=12.0, nominal_overlap="keep"), "parts-cross", "part upper"),
    "closed by a third of a sheet": (plates(height=0.65), "overlap-closed", "zone between"),
    "deep in each other": (plates(height=0.4, nominal_overlap="keep"), "overlap-kept", "zone between"),
    "welded far from their zone": (
        plates((400.0, 40.0, 8.0), (400.0, 40.0, 8.0), box=[[200, 0, -1], [400, 40, 3]]),
        "weld-off-zone",
        "weld W",
    ),
    "upon each other, backed nowhere": (stacked(), "unbacked", "clamp C-upper"),
    "upon each other and a locator": (stacked(locators=[LOCATOR]), None, ""),
    "a locator under what they do not touch": (
        stacked(touching=False, locators=[LOCATOR]),
        "unbacked",
        "clamp C-upper",
    ),
    "upon each other and a pad": (stacked(fixtures=[PAD], zones=[UPON]), None, ""),
    "held over a locator below": (held(locators=[LOCATOR]), "squeezed", "clamp C-upper"),
    "held over a pad below": (held(fixtures=[PAD], zones=[UPON]), "squeezed", "clamp C-upper"),
    "held against each other": (held(case=plates()), "squeezed", "clamp C-lower"),
    "held against each other, a gap between": (held(case=plates(height=1.2)), None, ""),
    "held over a locator, with room": (held(stroke=-0.1, locators=[LOCATOR]), None, ""),
    "upon each other, pressed lightly": (stacked(force=15.0), None, ""),
    "bent in many facets": (bent(32), None, ""),
    "bent in few facets": (bent(12), "bend-coarse", "zone between"),
}


@pytest.mark.parametrize("case", SHAPED)
def test_implausible_meshes_are_warned_of(case, tmp_path):
    plates, rule, item = SHAPED[case]
    scene = plates.scene(tmp_path)
    try:
        found = find_warnings(scene, assemble(scene, tmp_path / "cache"))
    except SceneError:
        found = find_warnings_unplaced(scene, loadable_parts(scene, tmp_path / "cache"))
    assert [one for one in found if one.rule == rule and one.item == item] or (rule is None and not found), found


def test_sheets_that_are_drawn_far_into_each_other_are_refused(tmp_path):
    """The upper one 50 mm below the lower one: they face each other nowhere."""
    with pytest.raises(SceneError, match=r"zones\[0\] \(between\): no contact pair"):
        assemble(plates(height=-50.0).scene(tmp_path), tmp_path / "cache")


def test_a_warning_states_number_range_reason_and_remedy():
    scene = edited("lap_joint", put("parts.upper", young=210))
    (warned,) = find_warnings(scene)
    assert str(warned) == (
        "part upper: young = 210 MPa; usual is 40000 to 250000 MPa (magnesium has 45e3, aluminium 70e3, steel 210e3): "
        "give it in MPa, not in GPa or Pa"
    )
    assert all(rule.usual and rule.reason and rule.remedy for rule in RULES)
    with pytest.raises(SceneError, match=r"part upper: young = 210 MPa"):
        raise_warnings([warned])
    raise_warnings([])


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A check writes its page where a run writes its results: below the working folder."""
    monkeypatch.chdir(tmp_path)


def nonsense(tmp_path):
    """The lap joint of a soft metal, with a friction that there is not, in a folder of its own."""
    text = (MESHES_FOLDER / "lap_joint" / "scene.toml").read_text()
    text = text.replace("young = 210000", "young = 210", 1).replace("friction = 0.27", "friction = 27\npairs = 6", 1)
    (tmp_path / "scene.toml").write_text(text.replace('size = "medium"', 'size = "coarse"'))
    (tmp_path / "geometry.py").write_text((MESHES_FOLDER / "lap_joint" / "geometry.py").read_text())
    return str(tmp_path)


@pytest.mark.slow
def test_check_prints_and_counts_warnings_and_strict_makes_them_errors(cache, tmp_path):
    environment = {"MIC_CACHE": str(cache), "COLUMNS": "200"}
    done = CliRunner().invoke(app, ["check", nonsense(tmp_path)], env=environment)
    assert done.exit_code == 0 and done.output.rstrip().endswith("The scene is valid, 2 warnings.")
    assert "warning: part lower: young = 210 MPa" in done.output and "warning: zone lap: friction = 27" in done.output
    strict = CliRunner().invoke(app, ["check", nonsense(tmp_path), "--strict"], env=environment)
    assert isinstance(strict.exception, SceneError) and len(str(strict.exception).splitlines()) == 2
    assert "The scene is valid" not in strict.output


def test_a_check_that_ends_in_an_error_prints_warnings_first(cache, tmp_path):
    """It may be why: a sheet of 40 mm reaches through its neighbour."""
    scene = nonsense(tmp_path)
    path = tmp_path / "scene.toml"
    path.write_text(path.read_text().replace("thickness = 1\n", "thickness = 40\n", 1))
    done = CliRunner().invoke(app, ["check", scene], env={"MIC_CACHE": str(cache), "COLUMNS": "200"})
    assert isinstance(done.exception, SceneError) and " coincide (" in str(done.exception)
    assert "warning: part lower: thickness = 40 mm; usual is 0.3 to 6 mm" in done.output


def test_a_strict_run_is_refused_before_long_work(tmp_path, monkeypatch, cache):
    def compute(*_):
        raise AssertionError("influence coefficients were asked for")

    monkeypatch.setattr("mic.runs.coefficients", compute)
    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["run", nonsense(tmp_path), "--strict", "--out", str(out)])
    assert isinstance(done.exception, SceneError) and "zone lap: friction = 27" in str(done.exception)
    assert not (out / "run.json").exists()


@pytest.mark.slow
def test_the_report_repeats_the_warnings(tmp_path, cache, no_pictures):
    text = (MESHES_FOLDER / "lap_joint" / "scene.toml").read_text().replace("fields = true", "")
    text = text.replace("friction = 0.27", f"friction = 2\npairs = {FEW['lap']}", 1)
    (tmp_path / "scene.toml").write_text(text.replace('laws = ["coulomb", "associated", "frictionless"]', ""))
    (tmp_path / "geometry.py").write_text((MESHES_FOLDER / "lap_joint" / "geometry.py").read_text())
    said = "zone lap: friction = 2; usual is 0 to 1"
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "check.html").write_text("the page of a check, which a run leaves alone")
    arguments = ["run", str(tmp_path), "--samples", "12", "--law", "frictionless", "--out", "out"]
    done = CliRunner().invoke(app, arguments, env={"MIC_CACHE": str(cache), "COLUMNS": "200"})
    assert done.exit_code == 0, done.output
    assert f"warning: {said}" in done.output
    assert said in json.loads((tmp_path / "out" / "run.json").read_text())["warnings"][0]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "1 warning" in page and f"<li>{said}" in page
    assert (tmp_path / "out" / "check.html").is_file()
