"""Implausible input gives an error or a warning; plausible input gives none.

Each case is an edit of a shipped scene. It ends in an error, or in a warning of the stated rule that names the item.
"""

import copy
import json
import shutil
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
from mic.plausibility import find_warnings, find_warnings_unplaced, loadable_parts, raise_warnings
from mic.plausibility.rules import FILE, MESHES, PARTS
from mic.scene import Scene, SceneError
from mic.scene.load import read_table
from verification.scenes import FEW, shipped

MESHES_FOLDER = Path(__file__).resolve().parents[1] / "meshes"
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


def put(scene, where, keys):
    item(scene, where).update(keys)


def without(scene, where, keys):
    for key in keys["keys"]:
        del item(scene, where)[key]


def like(scene, where, keys):
    """A further item: a copy of an existing one with some other keys."""
    item(scene, where.partition(".")[0]).append({**item(scene, where), **keys})


def add(scene, table, keys):
    scene.setdefault(table, []).append(keys)


def drop(scene, where):
    table, _, name = where.partition(".")
    scene[table] = [row for row in scene[table] if name and row.get("name", row.get("kind")) != name]


def every(scene, table, keys):
    for row in scene[table]:
        row.update(keys)


def stage(scene, place, keys):
    """A further stage."""
    scene["stages"].insert(place, keys)


def welded_first(scene):
    """The weld stage before the clamp stage."""
    scene["stages"].insert(1, scene["stages"].pop(2))


def stages_backwards(scene):
    scene["stages"].reverse()


def located_again(scene, stage):
    """The lower part's six locators again, where they are, for a stage of another station."""
    own = [row for row in scene["locators"] if row["part"] == "lower"]
    scene["locators"] += [{**row, "name": f"{row['name']}-{stage}", "stage": stage} for row in own]


def late(scene, name):
    """A locator that engages in a second clamp stage."""
    scene["stages"].insert(2, {"kind": "clamp", "name": "second"})
    item(scene, f"locators.{name}")["stage"] = "second"


def third(scene):
    """A third part with locators, which meets nothing."""
    scene["parts"].append({**scene["parts"][0], "name": "third"})
    own = [row for row in scene["locators"][:8] if row.get("stage") is None]
    scene["locators"] += [{**row, "name": f"third{row['name']}", "part": "third"} for row in own]


def edited(name, edits) -> Scene:
    scene = copy.deepcopy(TABLES[name])
    for function, *arguments in edits:
        globals()[function](scene, *copy.deepcopy(arguments))
    return read_table(scene, MESHES_FOLDER / name / "scene.toml")


CASES = tomllib.loads((Path(__file__).parent / "data" / "plausibility.toml").read_text(encoding="utf-8"))
NONSENSE = [(name, case) for name, own in CASES["implausible"].items() for case in own]
for row in CASES["numbers"]:
    place, key = row["item"], row["key"]
    table_, _, name = place.partition(".")
    said = {"words": name or place, "rules": row.get("rules", [f"{table_}.{key}"])}
    for value in row["values"]:
        case = {"case": f"{place}.{key} = {value!r}", "edits": [["put", place, {key: value}]]}
        NONSENSE.append(("lap_joint", case | said))
SENSIBLE = [(name, case) for name, own in CASES["plausible"].items() for case in own]
named = lambda given: given["case"] if isinstance(given, dict) else given


@pytest.fixture(scope="module")
def assemblies(cache):
    """The shipped scenes on coarse meshes, by name."""
    return {name: assemble(edited(name, []), cache) for name in TABLES}


#: Rules for which the pairs of the edited scene must be found; for the others the shipped pairs do.
PAIRED = ("zones-alike", "zone-small")


def marked(case):
    slow = not {*PAIRED}.isdisjoint(case[1]["rules"])
    return pytest.param(*case, marks=pytest.mark.slow if slow else ())


def judged(name, scene, rules, assemblies, cache):
    """The warnings of an edited scene, on the meshes and pairs of the shipped one where they do."""
    found = find_warnings(scene)
    if any(warned.rule in rules for warned in found):
        return found
    if set(rules) & set(PAIRED):
        return find_warnings(scene, assemble(scene, cache))
    return find_warnings(scene, replace(assemblies[name], scene=scene))


@pytest.mark.parametrize("name, case", [marked(one) for one in NONSENSE], ids=named)
def test_each_implausible_input_is_refused_or_warned_of(name, case, assemblies, cache):
    rules, words = case["rules"], case["words"]
    try:
        scene = edited(name, case["edits"])
    except SceneError as error:
        assert words in str(error)
        return
    assert rules != ["error"], "no error was raised"
    found = judged(name, scene, rules, assemblies, cache)
    assert [warned for warned in found if warned.rule in rules and words in str(warned)], [str(one) for one in found]


@pytest.mark.parametrize("name, case", SENSIBLE, ids=named)
def test_no_plausible_input_is_warned_of(name, case, assemblies):
    scene = edited(name, case["edits"])
    found = find_warnings(scene, replace(assemblies[name], scene=scene))
    assert not found, [str(warned) for warned in found]


def test_tongs_that_press_a_stack_pair_by_pair_are_not_askew():
    """Three sheets: the jaws on the lowest two push the same way, and so do those on the upper two."""
    names = [row["name"] for row in TABLES["lap_joint"]["locators"] if row["part"] == "upper"]
    stacked = [["like", f"locators.{name}", {"name": f"top-{name}", "part": "top"}] for name in names]
    stacked += [
        ["like", "parts.upper", {"name": "top"}],
        ["like", "clamps.C1-upper", {"name": "C8-top", "part": "top"}],
    ]
    lower = ["like", "clamps.C1-lower", {"name": "C8-upper", "part": "upper"}]
    about = lambda edits: [one for one in find_warnings(edited("lap_joint", edits)) if one.rule == "tongs-askew"]
    assert about(stacked) and not about([*stacked, lower])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bracket", pytest.param("wheelhouse", marks=pytest.mark.fem)])
def test_shipped_scenes_have_no_warning(name, cache):
    scene = shipped(name, "coarse")
    assert find_warnings(scene, assemble(scene, cache)) == ()
    for other in ("watched.toml", "table1.toml"):
        assert find_warnings(mic.load_scene(MESHES_FOLDER / "wheelhouse" / other)) == ()  # else it is the wheelhouse


SHEET = {"thickness": 1.0, "young": 210e3, "poisson": 0.3}


def six_locators(part: str, places) -> list[dict]:
    """Locators of a part at points, each along an axis."""
    directions = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
    return [
        {"name": f"{part}{i}", "part": part, "point": point, "direction": directions[axis], "radius": 0.0}
        for i, (point, axis) in enumerate(places)
    ]


def plates(length=100.0, width=40.0, size=10.0, height=1.0, tilt=0.0, **keys) -> Case:
    """Two plates in elements of a size, `height` mm apart; the upper one leans by `tilt` mm over 40 mm."""
    heights = {"lower": lambda y: 0.0, "upper": lambda y: height + tilt * (y / 40.0 - 0.5)}
    places = [(0.1, 0.1, "z"), (0.1, 0.9, "z"), (0.9, 0.5, "z"), (0.1, 0.1, "y"), (0.9, 0.1, "y"), (0.1, 0.5, "x")]
    meshes, locators = {}, []
    for part, z in heights.items():
        meshes[part] = extrude([(0, z(0)), (width, z(width))], 0.0, length, size)[:2]
        locators += six_locators(part, [((x * length, y * width, z(y * width)), axis) for x, y, axis in places])
    scene = {
        "name": "plates",
        "parts": [{"name": name, "mesh": f"{name}.inp", **SHEET} for name in meshes],
        "locators": locators,
        "zones": [{"name": "between", "parts": ["lower", "upper"], "friction": 0.2, "pairs": 6}],
        "stages": [{"kind": "locate"}, {"kind": "clamp"}, {"kind": "weld"}, {"kind": "release"}],
        "deviations": [{"name": "D", "kind": "locator", "target": "upper0", "sigma": 0.1}],
        "clamps": [
            {"name": f"C-{part}", "part": part, "point": (50.0, 20.0, h), "direction": (0, 0, way), "force": 100.0}
            for part, h, way in (("lower", 0.0, 1.0), ("upper", heights["upper"](20.0), -1.0))
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
        meshes[part] = extrude(profile, 0.0, 100.0, 12.5)[:2]
        places = [(10, -0.9, "z"), (10, 0.9, "z"), (90, 0, "z"), (10, 0, "y"), (90, 0, "y"), (10, 0.5, "x")]
        locators += six_locators(part, [(at(x, turn), axis) for x, turn, axis in places])
    clamps = [clamp | {"point": (50.0, 0.0, height)} for clamp, height in zip(case.table["clamps"], (40.0, 41.0))]
    stages = [{"kind": "locate"}, {"kind": "clamp"}, {"kind": "release"}]
    table = case.table | {"locators": locators, "clamps": clamps, "stages": stages, "welds": []}
    return Case(table, meshes, case.deviations)


def stacked(force=100.0, touching=True, **rest) -> Case:
    """Three plates, the lowest with locators of its own, below one clamp; with the given further items."""
    case = plates()
    table, meshes = copy.deepcopy(case.table), {**case.meshes, "bottom": extrude([(0, -1), (40, -1)], 0, 100, 10)[:2]}
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

#: Other geometry: the scene, the rules that warn of it (none: there is no warning), and the item that they name.
SHAPED = {
    "as long as a street": (plates(9e3, 4e3, 400.0), "extent", "part lower"),
    "as small as a coin": (plates(15.0, 10.0, 2.5), "extent no-sheet", "part lower"),
    "of two elements": (plates(size=40.0), "coarse", "part lower"),
    "apart": (plates(height=2.8, max_gap=4.0), "weld-over-gap", "weld W"),
    "on the wrong side": (plates(height=-1.0), "clamp-pulls", "clamp C-upper"),
    "through each other": (plates(height=0.5, tilt=12.0, nominal_overlap="keep"), "parts-cross", "part upper"),
    "closed by a third of a sheet": (plates(height=0.65), "overlap-closed", "zone between"),
    "deep in each other": (plates(height=0.4, nominal_overlap="keep"), "overlap-kept", "zone between"),
    "welded far from their zone": (
        plates(400.0, size=8.0, box=[[200, 0, -1], [400, 40, 3]]),
        "weld-off-zone",
        "weld W",
    ),
    "upon each other, backed nowhere": (stacked(), "unbacked", "clamp C-upper"),
    "upon each other and a locator": (stacked(locators=[LOCATOR]), "", ""),
    "a locator under what they do not touch": (
        stacked(touching=False, locators=[LOCATOR]),
        "unbacked",
        "clamp C-upper",
    ),
    "upon each other and a pad": (stacked(fixtures=[PAD], zones=[UPON]), "", ""),
    "held over a locator below": (held(locators=[LOCATOR]), "squeezed", "clamp C-upper"),
    "held over a pad below": (held(fixtures=[PAD], zones=[UPON]), "squeezed", "clamp C-upper"),
    "held against each other": (held(case=plates()), "squeezed", "clamp C-lower"),
    "held against each other, a gap between": (held(case=plates(height=1.2)), "", ""),
    "held over a locator, with room": (held(stroke=-0.1, locators=[LOCATOR]), "", ""),
    "upon each other, pressed lightly": (stacked(force=15.0), "", ""),
    "bent in many facets": (bent(16), "", ""),
    "bent in few facets": (bent(12), "bend-coarse", "zone between"),
}


def test_each_rule_has_a_case():
    tried = {rule for _, case in NONSENSE for rule in case["rules"]}
    tried |= {rule for _, rules, _ in SHAPED.values() for rule in rules.split()}
    tried |= {"samples-twice", "samples-narrow"}  # tests/test_samples.py
    names = [rule.name for rule in RULES]
    assert len(set(names)) == len(names) and set(names) <= tried


@pytest.mark.slow
@pytest.mark.parametrize("case", SHAPED)
def test_implausible_meshes_are_warned_of(case, tmp_path):
    plates, rules, item = SHAPED[case]
    scene = plates.scene(tmp_path)
    try:
        found = find_warnings(scene, assemble(scene, tmp_path / "cache"))
    except SceneError:
        found = find_warnings_unplaced(scene, loadable_parts(scene, tmp_path / "cache"))
    if rules:
        assert set(rules.split()) <= {one.rule for one in found if one.item == item}, found
    else:
        assert found == ()


def test_sheets_that_are_drawn_far_into_each_other_are_refused(tmp_path):
    """The upper one 50 mm below the lower one: they face each other nowhere."""
    with pytest.raises(SceneError, match=r"zones\[0\] \(between\): no contact pair"):
        assemble(plates(height=-50.0).scene(tmp_path), tmp_path / "cache")


def test_a_warning_states_number_range_reason_and_remedy():
    scene = edited("lap_joint", [["put", "parts.upper", {"young": 210}]])
    (warned,) = find_warnings(scene)
    assert str(warned) == (
        "part upper: young = 210 MPa; usual is 40000 to 250000 MPa (magnesium has 45e3, aluminium 70e3, steel 210e3): "
        "give it in MPa, not in GPa or Pa"
    )
    assert all(rule.usual and rule.reason and rule.remedy for rule in RULES)
    with pytest.raises(SceneError, match=r"part upper: young = 210 MPa"):
        raise_warnings([warned])
    raise_warnings([])


@pytest.mark.slow
def test_the_report_repeats_the_warnings_and_a_strict_run_is_refused(tmp_path, cache, no_pictures, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (MESHES_FOLDER / "lap_joint" / "scene.toml").read_text().replace("fields = true", "")
    text = text.replace("friction = 0.27", f"friction = 2\npairs = {FEW['lap']}", 1)
    Path("scene.toml").write_text(text.replace('laws = ["coulomb", "associated", "frictionless"]', ""))
    shutil.copy(MESHES_FOLDER / "lap_joint" / "geometry.py", tmp_path)
    said = "zone lap: friction = 2; usual is 0 to 1"
    Path("out").mkdir()
    Path("out/check.html").write_text("the page of a check, which a run leaves alone")
    arguments = ["run", str(tmp_path), "--samples", "10", "--law", "frictionless", "--out", "out"]
    environment = {"MIC_CACHE": str(cache), "COLUMNS": "200"}
    done = CliRunner().invoke(app, arguments, env=environment)
    assert done.exit_code == 0, done.output
    assert f"warning: {said}" in done.output
    assert said in json.loads(Path("out/run.json").read_text())["warnings"][0]
    page = Path("out/report.html").read_text()
    assert "1 warning" in page and f"<li>{said}" in page and Path("out/check.html").is_file()
    monkeypatch.setattr("mic.runs.coefficients", lambda *_: pytest.fail("long work has begun"))
    done = CliRunner().invoke(app, [*arguments[:-1], "strict", "--strict"], env=environment)
    assert isinstance(done.exception, SceneError) and said in str(done.exception)
    assert not Path("strict/run.json").exists()
