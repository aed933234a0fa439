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
from mic.scene.keys import Table
from mic.scene.reference import reference
from mic.scene.samples import DESIGNS
from mic.scene.settings import AUTO, TARGET, with_values

LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint"

BROKEN = tomllib.loads((LAP.parents[1] / "tests" / "data" / "broken_scenes.toml").read_text(encoding="utf-8"))


def edited(tmp_path, pattern, replacement):
    """Path of the lap joint's scene, edited once, beside its geometry."""
    text = (LAP / "scene.toml").read_text()
    changed = re.sub(pattern, replacement, text, count=1)
    assert changed != text, "the edit did not apply"
    (tmp_path / "scene.toml").write_text(changed)
    (tmp_path / "geometry.py").write_text((LAP / "geometry.py").read_text())
    return tmp_path / "scene.toml"


def errors(tmp_path, *replacements, count=-1):
    """Lines of the error of the lap joint's scene after replacements of its text, without the path of the file.

    `count` limits the places of each replacement.
    """
    text = (LAP / "scene.toml").read_text()
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new, count)
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(mic.SceneError) as caught:
        mic.load_scene(tmp_path)
    return [line.removeprefix(f"{tmp_path}/scene.toml: ") for line in str(caught.value).splitlines()]


def test_a_name_where_a_group_belongs_is_not_read_letter_by_letter(tmp_path):
    found = errors(tmp_path, ('kind = "clamp"', 'kind = "clamp"\norder = ["C1-upper", "C1-lower"]'))
    assert "give a list in brackets; got 'C1-upper'" in found[0] and "called 'C'" not in str(found)


@pytest.mark.parametrize("given", ["-0.1", '"sometimes"'])
def test_alternatives_of_a_key_are_listed_in_one_line(given, tmp_path):
    (line,) = errors(tmp_path, ("friction = 0.27", f"friction = 0.27\nnominal_overlap = {given}"))
    assert re.search("Input should be 'close' or 'keep', or .*; got .*, correct it", line)
    assert line.count("nominal_overlap") == 1


def refused(case, tmp_path, load):
    path = edited(tmp_path, case["replace"], case["by"])
    with pytest.raises(mic.SceneError) as caught:
        load(mic.load_scene(path))
    for words in case["says"]:
        assert words in str(caught.value)
    return str(path), str(caught.value)


@pytest.mark.parametrize("case", BROKEN["scene"], ids=lambda case: case["case"])
def test_bad_scene(tmp_path, case):
    path, message = refused(case, tmp_path, lambda scene: scene)
    assert path in message


@pytest.mark.parametrize("case", BROKEN["on_mesh"], ids=lambda case: case["case"])
def test_bad_scene_found_on_the_mesh(tmp_path, cache, case):
    def on_coarse_meshes(scene):
        sizes = {"medium": "coarse"}
        parts = [part.model_copy(update={"size": sizes.get(part.size, part.size)}) for part in scene.parts]
        assemble(scene.model_copy(update={"parts": parts}), cache)

    refused(case, tmp_path, on_coarse_meshes)


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
    """Also those of items with errors of their own: they still have names, and what they name."""
    lines = errors(tmp_path, *((old, new) for old, (new, _) in WRONG_IN_MANY_WAYS.items()), count=1)
    words = [
        *(words for _, words in WRONG_IN_MANY_WAYS.values()),
        "welds[1].parts (W1): a part cannot be joined to itself",
    ]
    assert [sum(line.startswith(start) for line in lines) for start in words] == [1] * len(lines)


def test_every_problem_of_the_stages_is_reported(tmp_path):
    broken = ('kind = "clamp"', 'kind = "clamp"\norder = [["C1-uper"]]')
    lines = errors(tmp_path, broken, ('keep = ["lower-A1",', 'keep = ["lower-A1", "W1", "lowr-A2",'))
    assert [line.partition(": ")[0] for line in lines] == ["stages[1].order (clamp)", "stages[3].keep (release)"]
    (line,) = errors(tmp_path, broken, ("force = 60", 'force = 60\nstage = "clmp"'))
    assert line.startswith("clamps[0].stage (C1-upper): ") and line.endswith(" (and in 1 more)")


def test_equal_problems_of_the_items_of_a_table_are_one_line(tmp_path):
    lines = errors(tmp_path, ('part = "upper"', 'part = "uper"'), ('target = "upper-C1"', 'target = "upper-C2"'))
    same = [line for line in lines if "no part called 'uper'" in line]
    more = [int(found[1]) for line in same if (found := re.search(r"\(and in (\d+) more\)$", line))]
    assert len(same) + sum(more) == (LAP / "scene.toml").read_text().count('part = "upper"') and len(same) == 4
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
    assert scene.left_open == []
    stated = tomllib.loads('setting = "reference"\n' + text.partition("\n")[2])
    stated["zones"][0]["spacing"] = 5.0
    assert mic.Scene(**stated).zones[0].spacing_factor == 1.0 > SETTINGS["reference"]["spacing_factor"]
    chosen = mic.Scene(**stated | {"setting": AUTO})
    assert chosen.left_open == ["parts.lower", "path"] and chosen.monte_carlo.accuracy.required == {"six_sigma": TARGET}
    changed = with_values(chosen, {"size": "coarse", "spacing_factor": 0.5, "increments": 2})
    assert [part.size for part in changed.parts] == ["coarse", "medium"] and changed.zones[0].spacing_factor == 1.0
    assert [stage.increments for stage in changed.stages] == [None, 2, 2, 2, None]
    assert {stage.increments for stage in scene.stages} == {None}
    assert mic.Scene(**scene.model_dump(mode="json")) == scene.model_copy(update={"folder": Path(".")})
    (tmp_path / "scene.toml").write_text(text.replace('"draft"', '"hasty"'))
    with pytest.raises(mic.SceneError, match="setting: .*'draft', 'standard', 'reference' or 'auto'.*'hasty'"):
        mic.load_scene(tmp_path)


def test_a_setting_does_not_change_the_stated_path_of_a_stage(tmp_path):
    text = (LAP / "scene.toml").read_text().replace('kind = "clamp"', 'kind = "clamp"\nincrements = 3')
    draft, reference = (mic.Scene(**tomllib.loads(f'setting = "{name}"\n{text}')) for name in ("draft", "reference"))
    assert [stage.increments for stage in draft.stages] == [None, 3, None, None, None]
    assert reference.path.tolerance == SETTINGS["reference"]["tolerance"] < draft.path.tolerance
    own = mic.Scene(**tomllib.loads(f'setting = "reference"\n{text}\n[path]\ntolerance = 0.02'))
    assert own.path.tolerance == 0.02


def test_missing_scene():
    with pytest.raises(mic.SceneError, match="this scene does not exist; correct the name"):
        mic.load_scene("nowhere/scene.toml")


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
    assert settings == {*SETTINGS, AUTO}


def tables(kind=Table):
    """All tables of the schema."""
    return [table for own in kind.__subclasses__() for table in (own, *tables(own))]


@pytest.mark.parametrize("table", tables())
def test_no_numeric_key_accepts_another_type(table):
    """Python counts true as 1 and reads the text of a number: neither is meant in a scene."""
    for name, field in table.model_fields.items():
        takes = TypeAdapter(Annotated[field.annotation, name, *field.metadata])
        kinds = set(leaves(field.annotation))
        if not kinds & {int, float, bool}:
            continue
        for given in [True, False, [["1"]], {"a": "1"}] + ["1"] * (str not in kinds):
            if type(given) not in kinds:
                with pytest.raises(ValidationError):
                    takes.validate_python(given)
                    raise AssertionError(f"{table.__name__}.{name} takes {given!r}")


def leaves(annotation):
    inner = [leaf for one in get_args(annotation) if one is not Ellipsis for leaf in leaves(one)]
    return inner or [annotation]


@pytest.mark.parametrize("seed", range(6))
def test_a_generated_scene_survives_being_written_and_read_again(seed):
    """With what a setting fills in, once: the model's file holds no `null` that it would fill in a second time."""
    table, setting = random_case(seed).table, [*SETTINGS][seed % 3]
    scene = mic.Scene(**table | {"setting": setting})
    assert mic.Scene(**scene.model_dump(mode="json")) == scene == mic.Scene(**json.loads(scene.model_dump_json()))
    without = mic.Scene(**table)
    again = mic.Scene(**without.model_dump(mode="json") | {"setting": setting})
    assert again == without.model_copy(update={"setting": setting})


@pytest.mark.parametrize("setting", [None, *SETTINGS])
@pytest.mark.parametrize(
    "name", ["wheelhouse", "wheelhouse/watched.toml", "wheelhouse/table1.toml", "lap_joint", "hat_on_plate", "bracket"]
)
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
