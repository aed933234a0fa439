"""Bad input: one clear error that names the file, the key and the remedy."""

import json
import re
import tomllib
from pathlib import Path
from typing import Annotated, get_args

import pytest
from pydantic import TypeAdapter, ValidationError
from support.random_scenes import random_case

import mic
from mic.model.assembly import assemble
from mic.model.shape_modes import EXPANDED
from mic.model.sources import SOURCES
from mic.process.actions import STAGE_MOVES
from mic.scene import SETTINGS, schema
from mic.scene.reference import reference
from mic.scene.samples import DESIGNS

LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint"

# What is wrong, the edit that makes it so, and what the message must name.
BROKEN = {
    "negative thickness": (r"thickness = 1\b", "thickness = -1", ["parts[0].thickness", "greater than 0", "-1"]),
    "unknown key": (r"young = 210000", "yung = 210000", ["parts[0].yung", "unknown key; did you mean 'young'?"]),
    "unknown key of a deviation": (
        r'(name = "F1"\n(?:.*\n)*?)sigma',
        r"\1sigm",
        ["deviations[0].sigm (F1)", "unknown key; did you mean 'sigma'?"],
    ),
    "unknown key without a similar one": (
        r"young = 210000",
        "young = 210000\ncolour = 3",
        ["parts[0].colour (lower)", "unknown key; remove it or correct its spelling"],
    ),
    "unknown key of a settings table": (
        r"\[monte_carlo\]",
        "[monte_carlo]\nsample = 9",
        ["monte_carlo.sample", "unknown key; did you mean 'samples'?"],
    ),
    "negative friction": (r"friction = 0.27", "friction = -0.1", ["zones[0].friction", "greater than or equal to 0"]),
    "friction of a stage that there is not": (
        r"friction = 0.27",
        "friction = { clmp = 0.1, default = 0.2 }",
        ["zones[0].friction", "no stage called 'clmp'", "did you mean 'clamp'"],
    ),
    "friction by stage, negative": (
        r"friction = 0.27",
        "friction = { clamp = -0.1, default = 0.2 }",
        ["zones[0].friction.clamp", "greater than or equal to 0"],
    ),
    "friction by stage, not all": (
        r"friction = 0.27",
        "friction = { clamp = 0.1 }",
        ["zones[0]", "friction by stage needs default"],
    ),
    "friction that falls too fast": (
        r"friction = 0.27",
        "friction_table = [[0, 0.5], [1, 0.1]]",
        ["zones[0]", "friction_table", "must not fall with pressure", "between 0 and 1 MPa"],
    ),
    "a steep power": (
        r"friction = 0.27",
        "friction_power = { mu0 = 0.3, p0 = 1, n = 2, mu_min = 0.1, mu_max = 0.5 }",
        ["zones[0]", "friction_power", "n is at most 1"],
    ),
    "two functions of pressure": (
        r"friction = 0.27",
        "friction_table = [[0, 0.5]]\nfriction_power = { mu0 = 0.3, p0 = 1, n = 0.2, mu_min = 0.1, mu_max = 0.5 }",
        ["zones[0]", "friction_table or friction_power, not both"],
    ),
    "a pressure without an area": (
        r"friction = 0.27",
        "friction_table = [[0, 0.5]]\npatch = 0",
        ["zones[0]", "friction_table is per area and patch = 0 has none"],
    ),
    "a stiffness without an area": (
        r"friction = 0.27",
        "tangential_stiffness = 100\npatch = 0",
        ["zones[0]", "tangential_stiffness is per area and patch = 0 has none"],
    ),
    "pressure that nothing depends on": (
        r'"associated"',
        '"pressure-dependent"',
        ["report.laws", "no zone has friction_table or friction_power", 'use "coulomb"'],
    ),
    "contacts that yield by nothing": (
        r'"associated"',
        '"micro-slip"',
        ["report.laws", "no zone has tangential_stiffness"],
    ),
    "NaN deviation": (r"mean = -5", "mean = nan", ["deviations[0].mean", "finite"]),
    "infinite sigma": (r"sigma = 1.5", "sigma = inf", ["deviations[0].sigma", "finite"]),
    "zero direction": (
        r"direction = \[0, 0, -1\]",
        "direction = [0, 0, 0]",
        ["clamps[0].direction", "must not be zero"],
    ),
    "unknown part": (r'part = "upper"', 'part = "uper"', ["locators[6].part", "'uper'", "did you mean 'upper'"]),
    "locator missing": (
        r'(name = "lower-C1"[^=]*=[^=]*= [^\n]*\n)direction = \[1, 0, 0\]',
        r"\1direction = [0, 1, 0]",
        ["parts[0] (lower)", "hold 5 of its 6", "add locators"],
    ),
    "both force and stroke": (r"force = 60", "force = 60\nstroke = 0.1", ["clamps[0]", "either force", "or stroke"]),
    "unknown stage": (r"force = 60", 'force = 60\nstage = "clmp"', ["clamps[0].stage", "'clmp'", "clamp"]),
    "two zones of one name": (
        r"\[\[stages\]\]",
        '[[zones]]\nname = "lap"\nparts = ["lower", "upper"]\npairs = 3\n\n[[stages]]',
        ["zones", "'lap'", "more than once"],
    ),
    "limits swapped": (r"lower = -1\b", "lower = 2", ["measurements[0]", "lower must be smaller"]),
    "two kinds of pairs": (r"friction = 0.27", "pairs = 24\nspacing = 4", ["zones[0]", "one of pairs"]),
    "not TOML": (r"\[\[parts\]\]", "[[parts]", ["not valid TOML"]),
    "syntax of a name": (r'name = "F1"', 'name = "F 1"', ["deviations[0].name"]),
    "poisson": (r"poisson = 0.3", "poisson = 0.5", ["parts[0].poisson", "less than 0.5"]),
}
CLAMP = r'(?<=\n)kind = "clamp"'
RELEASE = r'(?<=\n)kind = "release"'
EARLY = '[[stages]]\nkind = "release"\nname = "early"\n'
BROKEN |= {
    "order of what does not exist": (
        CLAMP,
        'kind = "clamp"\norder = [["C1-upper"], ["C1-lowr"]]',
        ["stages[1].order", "'C1-lowr'", "did you mean 'C1-lower'"],
    ),
    "order that leaves out": (
        CLAMP,
        'kind = "clamp"\norder = [["C1-upper"]]',
        ["stages[1].order", "closes 'C1-lower' too", "add"],
    ),
    "order that names twice": (
        CLAMP,
        'kind = "clamp"\norder = [["C1-upper"], ["C1-lower", "C1-upper"]]',
        ["stages[1].order", "'C1-upper' is given more than once", "keep it in one group"],
    ),
    "order of another stage's": (
        CLAMP,
        'kind = "clamp"\norder = [["C1-upper"], ["C1-lower"], ["W1"]]',
        ["stages[1].order", "'W1' belongs to stage 'weld'", "remove it", "'C1-upper', 'C1-lower'"],
    ),
    "order with an empty group": (
        CLAMP,
        'kind = "clamp"\norder = [["C1-upper", "C1-lower"], []]',
        ["stages[1].order", "a group is empty", "remove it"],
    ),
    "empty order": (CLAMP, 'kind = "clamp"\norder = []', ["stages[1].order", "at least 1"]),
    "order of setting down": (
        r'(?<=\n)kind = "locate"',
        'kind = "locate"\norder = [["lower-A1"]]',
        ["stages[0]", "order applies to clamp, weld, release stages only", "remove it"],
    ),
    "order and sequence": (
        r'(?<=\n)kind = "weld"',
        'kind = "weld"\nsequence = true\norder = [["W1", "W2"]]',
        ["stages[2]", "order and sequence", "remove one"],
    ),
    "sequence of clamps": (CLAMP, 'kind = "clamp"\nsequence = true', ["stages[1]", "sequence applies to weld stages"]),
    "settling of clamps": (CLAMP, 'kind = "clamp"\nsettle = false', ["stages[1]", "settle applies to locate stages"]),
    "path without contact": (
        r'(?<=\n)kind = "measure"',
        'kind = "measure"\npath = "followed"',
        ["stages[4]", "stages[4].path (measure): nothing moves in this stage: remove it"],
    ),
    "increments of a followed path": (
        CLAMP,
        'kind = "clamp"\npath = "followed"\nincrements = 4',
        ["stages[1]", "increments do not go with path = 'followed'", "remove one"],
    ),
    "how many increments": (CLAMP, 'kind = "clamp"\npath = "increments"', ["stages[1]", "needs increments", "add it"]),
    "all at once, one after the other": (
        CLAMP,
        'kind = "clamp"\npath = "one-step"\norder = [["C1-upper"], ["C1-lower"]]',
        ["stages[1]", "order exclude each other", "remove one"],
    ),
    "no increments": (CLAMP, 'kind = "clamp"\nincrements = 0', ["stages[1].increments", "greater than or equal to 1"]),
    "a tolerance that cannot be kept": (
        r"\[monte_carlo\]",
        "[path]\ntolerance = 1e-9\n\n[monte_carlo]",
        ["path.tolerance", "greater than or equal to 0.00001"],
    ),
    "a clamp that opens before it closes": (
        r'\[\[stages\]\]\nkind = "clamp"',
        EARLY + 'order = [["C1-upper"]]\n\n[[stages]]\nkind = "clamp"',
        ["stages[1].order", "'C1-upper' closes only in stage 'clamp', after this one", "remove it"],
    ),
    "a clamp that is kept before it closes": (
        r'\[\[stages\]\]\nkind = "clamp"',
        EARLY + 'keep = ["C1-upper"]\n\n[[stages]]\nkind = "clamp"',
        ["stages[1].keep", "'C1-upper' closes only in stage 'clamp', after this one", "cannot stay closed"],
    ),
    "a clamp that opens twice": (
        RELEASE,
        'kind = "release"\nname = "early"\n\n[[stages]]\nkind = "release"\norder = [["C1-upper"]]',
        ["stages[4].order", "'C1-upper' is open already", "remove it"],
    ),
    "a weld that opens": (
        RELEASE,
        'kind = "release"\norder = [["C1-upper", "C1-lower"], ["W1"]]',
        ["stages[3].order", "'W1' is a weld, and welds stay"],
    ),
    "a kept locator that opens": (
        RELEASE,
        'kind = "release"\norder = [["C1-upper", "C1-lower"], ["lower-A1"]]',
        ["stages[3].order", "'lower-A1' stays closed"],
    ),
    "a release that forgets": (
        RELEASE,
        'kind = "release"\norder = [["C1-upper", "C1-lower"]]',
        ["stages[3].order", "opens 'upper-A1', 'upper-A2'"],
    ),
    "one name for a clamp and a locator": (
        r'(name = "C1-lower"|name = "lower-A1")((?:.|\n)*?)(?<=\n)kind = "clamp"',
        r'name = "C1-upper"\2kind = "clamp"\norder = [["C1-upper"], ["C1-lower"]]',
        ["stages[1].order", "'C1-upper' is a name in locators and in clamps", "give each item its own name"],
    ),
}
# Found only once the meshes are there, and still before any solve.
BROKEN_ON_MESH = {
    "missing mesh": (
        r'geometry = "geometry.py"\nsize = "medium"',
        'mesh = "nowhere.msh"',
        ["'lower'", "mesh", "nowhere.msh", "correct the name"],
    ),
    "unknown size": (r'size = "medium"', 'size = "huge"', ["'lower'", "'huge'", "coarse, medium, fine"]),
    "weld off the part": (
        r"point = \[88, 6, 0.5\]",
        "point = [30, 6, 0.5]",
        ["welds[0].point", "away from part 'upper'", "correct the coordinates"],
    ),
    "clamp off the part": (
        r"point = \[72, 12.5, 1\]",
        "point = [72, 12.5, 40]",
        ["clamps[0].point", "39 mm away from part 'upper'"],
    ),
    "empty zone": (
        r"friction = 0.27",
        "friction = 0.27\nbox = [[0, 0, -1], [20, 25, 2]]",
        ["zones[0] (lap)", "no contact pair", "max_gap"],
    ),
    "too small a gap": (
        r"thickness = 1\b((?:.|\n)*?)friction = 0.27",  # 0.25 mm between a sheet half as thick and its neighbour
        r"thickness = 0.5\1friction = 0.27\nmax_gap = 0.2",
        ["zones[0] (lap)", "no contact pair", "max_gap = 0.2"],
    ),
}


def edited(tmp_path, pattern, replacement):
    text = (LAP / "scene.toml").read_text()
    changed = re.sub(pattern, replacement, text, count=1)
    assert changed != text, "the edit did not apply"
    (tmp_path / "scene.toml").write_text(changed)
    (tmp_path / "geometry.py").write_text((LAP / "geometry.py").read_text())
    return tmp_path / "scene.toml"


def test_a_name_where_a_group_belongs_is_not_read_letter_by_letter(tmp_path):
    scene = edited(tmp_path, *(CLAMP, 'kind = "clamp"\norder = ["C1-upper", "C1-lower"]'))
    with pytest.raises(mic.SceneError, match="give a list in brackets; got 'C1-upper'") as error:
        mic.load_scene(scene)
    assert "called 'C'" not in str(error.value)


@pytest.mark.parametrize("given", ["-0.1", "true", '"sometimes"', "[1]"])
def test_alternatives_of_a_key_are_listed_in_one_line(given, tmp_path):
    with pytest.raises(mic.SceneError, match="Input should be 'close' or 'keep', or .*; got .*, correct it") as caught:
        mic.load_scene(edited(tmp_path, r"friction = 0.27", f"friction = 0.27\nnominal_overlap = {given}"))
    assert str(caught.value).count("nominal_overlap") == 1


@pytest.mark.parametrize("case", BROKEN)
def test_bad_scene(tmp_path, case):
    pattern, replacement, words = BROKEN[case]
    path = edited(tmp_path, pattern, replacement)
    with pytest.raises(mic.SceneError) as caught:
        mic.load_scene(path)
    message = str(caught.value)
    assert str(path) in message
    for word in words:
        assert word in message


@pytest.mark.slow
@pytest.mark.parametrize("case", BROKEN_ON_MESH)
def test_bad_scene_found_on_the_mesh(tmp_path, cache, case):
    pattern, replacement, words = BROKEN_ON_MESH[case]
    scene = mic.load_scene(edited(tmp_path, pattern, replacement))
    with pytest.raises(mic.SceneError) as caught:
        assemble(scene, cache)
    for word in words:
        assert word in str(caught.value)


def test_all_problems_are_listed_at_once(tmp_path):
    path = edited(tmp_path, r"thickness = 1\nyoung = 210000", "thickness = -1\nyung = 1")
    with pytest.raises(mic.SceneError) as caught:
        mic.load_scene(path)
    assert len(str(caught.value).splitlines()) == 2


WRONG_IN_MANY_WAYS = {
    "thickness = 1\n": ('thickness = "1"\n', "parts[0].thickness (lower): "),
    'part = "upper"': ('part = "uper"', "locators[6].part (upper-A1): there is no part called 'uper'"),
    "force = 60": ("force = true", "clamps[0].force (C1-upper): "),
    'name = "W2"\nparts = ["lower", "upper"]': ('name = "W1"\nparts = ["lower", "lower"]', "welds: the name 'W1'"),
    'kind = "clamp"': ('kind = "clamp"\norder = [["C1-lowr"]]', "stages[1].order (clamp): there is no"),
    'name = "F1"\n': ('name = "F1"\nforce = 3\n', "deviations[0].force (F1): unknown key"),
    'target = "upper-C1"': ('target = "upper-C2"', "deviations[2].target (D1): there is no locator"),
    "samples = 200": ("samples = 200.5", "monte_carlo.samples: "),
}


def test_problems_within_tables_and_between_them_are_listed_at_once_by_name(tmp_path):
    """Those of items that are wrong in themselves too: they still have names, and what they name."""
    text = (LAP / "scene.toml").read_text()
    for old, (new, _) in WRONG_IN_MANY_WAYS.items():
        assert old in text
        text = text.replace(old, new, 1)
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(mic.SceneError) as caught:
        mic.load_scene(tmp_path)
    lines = str(caught.value).splitlines()
    for _, words in WRONG_IN_MANY_WAYS.values():
        assert sum(f"{tmp_path}/scene.toml: {words}" in line for line in lines) == 1, words
    joined = "welds[1].parts (W1): a part cannot be joined to itself"
    assert sum(joined in line for line in lines) == 1
    assert len(lines) == len(WRONG_IN_MANY_WAYS) + 1


def test_every_problem_of_the_stages_is_reported(tmp_path):
    text = (LAP / "scene.toml").read_text().replace('kind = "clamp"', 'kind = "clamp"\norder = [["C1-uper"]]')
    text = text.replace('keep = ["lower-A1",', 'keep = ["lower-A1", "W1", "lowr-A2",')
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(mic.SceneError) as caught:
        mic.load_scene(tmp_path)
    keys = [line.partition("scene.toml: ")[2].partition(": ")[0] for line in str(caught.value).splitlines()]
    assert keys == ["stages[1].order (clamp)", "stages[3].keep (release)"]
    (tmp_path / "scene.toml").write_text(text.replace("force = 60", 'force = 60\nstage = "clmp"'))
    with pytest.raises(mic.SceneError) as caught:
        mic.load_scene(tmp_path)
    lines = str(caught.value).splitlines()
    assert [line.partition("scene.toml: ")[2].partition(":")[0] for line in lines] == [
        "clamps[0].stage (C1-upper)",
        "clamps[1].stage (C1-lower)",
    ]


def test_every_problem_between_tables_is_reported(tmp_path):
    text = (LAP / "scene.toml").read_text()
    broken = text.replace('part = "upper"', 'part = "uper"').replace('target = "upper-C1"', 'target = "upper-C2"')
    (tmp_path / "scene.toml").write_text(broken)
    with pytest.raises(mic.SceneError) as caught:
        mic.load_scene(tmp_path)
    lines = str(caught.value).splitlines()
    assert sum("no part called 'uper'" in line for line in lines) == text.count('part = "upper"') == 10
    assert sum("no locator called 'upper-C2'" in line for line in lines) == 1
    assert sum("(upper): its 0 locators" in line for line in lines) == 1


def test_a_setting_fills_in_only_keys_that_the_scene_omits(tmp_path):
    text = 'setting = "draft"\n' + (LAP / "scene.toml").read_text().replace('size = "medium"\n', "", 1)
    (tmp_path / "scene.toml").write_text(text)
    scene = mic.load_scene(tmp_path)
    draft = SETTINGS["draft"]
    assert [part.size for part in scene.parts] == [draft["size"], "medium"]  # the second part gives its own
    assert scene.path.tolerance == draft["tolerance"] and scene.monte_carlo.samples == 200
    assert scene.zones[0].candidates and scene.zones[0].spacing_factor == draft["spacing_factor"]
    stated = tomllib.loads('setting = "reference"\n' + text.partition("\n")[2])
    stated["zones"][0]["spacing"] = 5.0
    assert mic.Scene(**stated).zones[0].spacing_factor == 1.0 > SETTINGS["reference"]["spacing_factor"]
    assert {stage.increments for stage in scene.stages} == {None}
    assert mic.Scene(**scene.model_dump(mode="json")) == scene.model_copy(update={"folder": Path(".")})
    (tmp_path / "scene.toml").write_text(text.replace('"draft"', '"hasty"'))
    with pytest.raises(mic.SceneError, match="setting: .*'draft', 'standard' or 'reference'.*'hasty'"):
        mic.load_scene(tmp_path)


def test_a_setting_does_not_change_the_stated_path_of_a_stage(tmp_path):
    text = (LAP / "scene.toml").read_text().replace('kind = "clamp"', 'kind = "clamp"\nincrements = 3')
    draft, reference = (mic.Scene(**tomllib.loads(f'setting = "{name}"\n{text}')) for name in ("draft", "reference"))
    assert [stage.increments for stage in draft.stages] == [None, 3, None, None, None]
    assert reference.path.tolerance == SETTINGS["reference"]["tolerance"] < draft.path.tolerance
    own = mic.Scene(**tomllib.loads(f'setting = "reference"\n{text}\n[path]\ntolerance = 0.02'))
    assert own.path.tolerance == 0.02


def test_missing_scene():
    with pytest.raises(mic.SceneError, match="no such file"):
        mic.load_scene("nowhere/scene.toml")


@pytest.mark.parametrize("name", ["wheelhouse", "lap_joint", "hat_on_plate", "bracket"])
def test_shipped_scenes_are_valid(name):
    assert mic.load_scene(LAP.parent / name).parts


def test_the_scene_reference_is_generated_from_the_schema():
    """docs/scene.md is generated: python -m mic.scene.reference > docs/scene.md."""
    assert (LAP.parents[1] / "docs" / "scene.md").read_text(encoding="utf-8") == reference()



def test_the_words_of_the_schema_are_those_of_the_registries():
    """A kind that the schema names and no room implements would fail long after `mic check`."""
    words = lambda table, key: set(get_args(table.model_fields[key].annotation))
    kinds = [words(table, "kind") for table in get_args(get_args(schema.Deviation)[0])]
    assert set().union(*kinds) == {*SOURCES, *EXPANDED}
    assert words(schema.Stage, "kind") == set(STAGE_MOVES)
    assert words(schema.MonteCarlo, "design") == set(DESIGNS)
    settings = {word for option in words(schema.Scene, "setting") for word in get_args(option)}
    assert settings == set(SETTINGS)


NUMBERS = {"young": "210000", "samples": "200", "seed": "1", "force": "60", "sigma": "1.5", "friction": "0.27"}


@pytest.mark.parametrize("given", ["true", "text", "[1]", "{ a = 1 }", '["1"]'])
@pytest.mark.parametrize("key", [*NUMBERS, "thickness", "radius", "lower"])
def test_neither_booleans_nor_texts_stand_for_numbers(key, given, tmp_path):
    number = NUMBERS.get(key, "1")
    given = f'"{number}"' if given == "text" else given
    places = {
        "radius": (r'name = "lower-A1"', rf'name = "lower-A1"\nradius = {given}'),
        "friction": (r"friction = 0.27", f"friction = {given}"),
    }
    pattern, replacement = places.get(key, (rf"(?m)^{key} = .*$", f"{key} = {given}"))
    with pytest.raises(mic.SceneError, match=key):
        mic.load_scene(edited(tmp_path, pattern, replacement))


@pytest.mark.parametrize("table", [value for value in vars(schema).values() if hasattr(value, "model_fields")])
def test_no_numeric_key_accepts_another_type(table):
    """Python counts true as 1 and reads the text of a number: neither is meant in a scene."""
    for name, field in table.model_fields.items():
        takes = TypeAdapter(Annotated[field.annotation, name, *field.metadata])
        kinds = set(leaves(field.annotation))
        if not kinds & {int, float, bool}:
            continue
        for given in [True, False] + ["1"] * (str not in kinds):
            if type(given) not in kinds:
                with pytest.raises(ValidationError):
                    takes.validate_python(given)
                    raise AssertionError(f"{table.__name__}.{name} takes {given!r}")


def leaves(annotation):
    inner = [leaf for one in get_args(annotation) if one is not Ellipsis for leaf in leaves(one)]
    return inner or [annotation]


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("seed", range(100))
def test_a_generated_scene_survives_being_written_and_read_again(seed, setting):
    """With what a setting fills in, once: the model's file holds no `null` that it would fill in a second time."""
    table = random_case(seed).table
    scene = mic.Scene(**table | {"setting": setting})
    assert mic.Scene(**scene.model_dump(mode="json")) == scene
    assert mic.Scene(**json.loads(scene.model_dump_json())) == scene
    without = mic.Scene(**table)
    assert mic.Scene(**without.model_dump(mode="json") | {"setting": setting}) == without.model_copy(
        update={"setting": setting}
    )


@pytest.mark.parametrize("setting", [None, *SETTINGS])
@pytest.mark.parametrize("name", ["wheelhouse", "wheelhouse/watched.toml", "lap_joint", "hat_on_plate", "bracket"])
def test_a_scene_survives_being_written_and_read_again(name, setting):
    """Parts with `mesh` and parts with `geometry` alike: the model's file holds the scene with all its defaults."""
    scene = mic.load_scene(LAP.parent / name)
    parts = [
        scene.parts[0],
        scene.parts[1].model_copy(update={"geometry": None, "size": None, "mesh": "x.stl"}),
        *scene.parts[2:],
    ]
    for changed in (scene, scene.model_copy(update={"parts": parts})):
        changed = changed.model_copy(update={"setting": setting})
        again = mic.Scene(**changed.model_dump(mode="json"))
        assert again == changed.model_copy(update={"folder": Path(".")})
