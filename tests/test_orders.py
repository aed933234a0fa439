"""Effect of the process order: compared orders, changes on the same samples, and doubts about a scene."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import mic
from mic.options import app
from mic.studies.order import STATED, compare, doubts, orders, variants

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = 6
RESTS = [f"plate-A{i}" for i in range(4, 8)]  # locators of the clamp stage


@pytest.fixture(scope="module")
def found(hat_model):
    """All orders of the hat on its plate, and the changes by three of them."""
    others = orders(hat_model.scene, permutations=1)
    compared = [order for order in others if order.name in (STATED, "clamps first", "opened all together")]
    return others, compare(hat_model, compared, "coulomb", SAMPLES, seed=3)


def closing(order):
    return next(stage.order for stage in order.scene.stages if stage.kind == "clamp")


@pytest.mark.slow
def test_orders_are_scenes_that_a_user_could_write_and_no_two_are_one(found):
    others, _ = found
    for order in others:
        assert mic.Scene(**order.scene.model_dump(mode="json")).stages == order.scene.stages
    by_name = {order.name: order for order in others}
    assert others[0].name == STATED and closing(others[0]) is None
    assert closing(by_name["reverse"]) == [["C4"], ["C3"], ["C2"], ["C1"], RESTS]
    assert closing(by_name["clamps first"]) == [["C1"], ["C2"], ["C3"], ["C4"], RESTS]
    assert closing(by_name["all together"]) == [[*RESTS, "C1", "C2", "C3", "C4"]]
    assert sorted(sum(closing(by_name["random 1"]), [])) == sorted(sum(closing(by_name["reverse"]), []))
    assert "locators first" not in by_name and "welds together" not in by_name  # as stated
    assert {"welds one by one", "welds in reverse", "opened all together"} <= set(by_name)


def test_a_lap_joint_of_one_pair_of_tongs_has_no_order_of_closing(lap_scene):
    names = [order.name for order in orders(lap_scene)]
    assert names == [
        STATED,
        "opened in the order of closing",
        "opened all together",
        "parts settle while the first item closes",
    ]


CHANGED = """
[[orders]]
name = "C2 first"
stages.clamp.order = [["C2"], ["C1", "C3"], ["C4", "plate-A4", "plate-A5", "plate-A6", "plate-A7"]]

[[orders]]
name = "as the paper has it"
stages.locate.settle = false
stages.clamp = { order = [], path = "one-step" }
"""


def test_a_file_of_variants_changes_the_keys_of_the_stages_that_it_names(hat_model, tmp_path):
    (tmp_path / "orders.toml").write_text(CHANGED)
    base = next(order for order in orders(hat_model.scene, 0) if order.name == "reverse").scene
    stated, first, paper = variants(base, tmp_path / "orders.toml")
    assert stated.scene == base and stated.name == STATED
    assert closing(first) == [["C2"], ["C1", "C3"], ["C4", *RESTS]]
    assert first.scene.model_copy(update={"stages": base.stages}) == base
    assert closing(paper) is None
    assert [stage.path for stage in paper.scene.stages] == [None, "one-step", None, None, None]
    assert not paper.scene.stages[0].settle and base.stages[0].settle


BROKEN = {
    "no file": (None, ["does not exist", "correct the name"]),
    "no TOML": ("[[orders", ["not valid TOML", "expected a closing ]"]),
    "no orders": ('name = "x"', ["must contain at least one [[orders]]"]),
    "no stages": ('[[orders]]\nname = "x"', ["orders[0]", "give name and stages"]),
    "no such stage": ('[[orders]]\nname = "x"\nstages.clmp.order = [["C1"]]', ["orders[0].stages", "'clmp'", "clamp"]),
    "no such key": ('[[orders]]\nname = "x"\nstages.clamp.ordre = [["C1"]]', ["orders[0]", "stages.1.ordre"]),
    "left out": ('[[orders]]\nname = "x"\nstages.clamp.order = [["C1"]]', ["orders[0]", "closes 'plate-A4'", "add"]),
    "one name for two": (
        '[[orders]]\nname = "x"\nstages.weld.sequence = true\n' * 2,
        ["several orders are named 'x'", "its own"],
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_file_of_variants_that_cannot_be_is_one_sentence(case, hat_model, tmp_path):
    text, words = BROKEN[case]
    path = tmp_path / "orders.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(mic.SceneError) as caught:
        variants(hat_model.scene, path)
    assert all(word in str(caught.value) for word in (str(path), *words))


def test_the_wheelhouse_has_variants_of_the_order_that_it_states():
    scene = mic.load_scene(ROOT / "meshes" / "wheelhouse")
    found = variants(scene, ROOT / "verification" / "order" / "orders.toml")
    (clamps,) = [stage.order for stage in scene.stages if stage.kind == "clamp"]
    assert len(clamps) == 4 and all("-A" in name for name in clamps[-1]) and len(found) == 8


@pytest.mark.slow
def test_changes_are_caused_by_the_order_alone(found, hat_model):
    """The same samples: nothing differs from itself, and an order by hand gives what its row says."""
    others, table = found
    stated = table[table["order"] == STATED]
    assert (stated[["mean_change", "six_sigma_change"]] == 0).all(axis=None) and (table["samples"] == SAMPLES).all()
    first = next(order for order in others if order.name == "clamps first")
    x = mic.statistics.draw.draw(first.scene, 3, 0, SAMPLES)
    a, b = (replace(hat_model, scene=own.scene).evaluate(x, "coulomb").measurements for own in (first, others[0]))
    own = table[(table["order"] == first.name) & table["tolerance"].notna()]
    wanted = {
        "mean_change": (a - b).mean(0),
        "six_sigma_change": 6 * (a.std(0, ddof=1) - b.std(0, ddof=1)),
    }
    for name, values in wanted.items():
        np.testing.assert_allclose(own[name], values, rtol=1e-9, atol=1e-12)
    error = (a - b).std(0, ddof=1) / SAMPLES**0.5  # the interval is corrected for skewness, to second order
    np.testing.assert_allclose(own["mean_error"], error, rtol=0.1)
    assert own["mean_change"].abs().max() > 0.005  # mm
    # Orders are sorted by their share of a tolerance.
    change = table[["mean_change", "six_sigma_change"]].abs().max(axis=1) / table["tolerance"]
    largest = change.groupby(table["order"], sort=False).max()
    assert largest.index[0] == STATED and (np.diff(largest.to_numpy()[1:]) <= 0).all()


@pytest.mark.slow
def test_a_stage_in_which_friction_hardly_matters_is_named_and_no_other(lap_model, hat_model):
    """The strips of the lap joint settle first; one pair of tongs then presses them, and they hardly slide."""
    assert [doubt.split(":")[0] for doubt in doubts(lap_model)] == ["stage clamp", "stage release"]
    assert not any(doubt.startswith("stage clamp") for doubt in doubts(hat_model))
    friction = lap_model.contacts.friction[-1]
    contacts = replace(lap_model.contacts, stages=("clamp",), friction=np.stack([0.0 * friction, friction]))
    assert [doubt.split(":")[0] for doubt in doubts(replace(lap_model, contacts=contacts))] == ["stage release"]
    smooth = [zone.model_copy(update={"friction": 0.0}) for zone in hat_model.scene.zones]
    scene = hat_model.scene.model_copy(update={"zones": smooth})
    contacts = replace(hat_model.contacts, friction=np.zeros_like(hat_model.contacts.friction))
    assert doubts(replace(hat_model, scene=scene, contacts=contacts)) == []  # nothing that friction could do


def test_dependence_on_how_parts_are_set_down_is_reported(lap_model):
    """Some µm: little of the tolerance of 2 mm, and much of one of 20 µm."""
    said = {}
    for width in (2.0, 0.02):
        limits = {"lower": -width / 2, "upper": width / 2}
        measurements = [item.model_copy(update=limits) for item in lap_model.scene.measurements]
        scene = lap_model.scene.model_copy(update={"measurements": measurements})
        said[width] = [doubt for doubt in doubts(replace(lap_model, scene=scene)) if "set down" in doubt]
    assert said[2.0] == [] and len(said[0.02]) == 1
    assert said[0.02][0].endswith(
        "of its tolerance, if overlapping parts settle on each other while the first locator or clamp closes"
    )


@pytest.mark.slow
def test_the_order_command_writes_the_printed_table(lap_model, tmp_path):
    lap_model.save(tmp_path / "model.npz")
    arguments = ["order", str(tmp_path / "model.npz"), "--samples", "3", "--permutations", "0"]
    done = CliRunner().invoke(app, [*arguments, "--table", str(tmp_path / "orders.csv")], env={"COLUMNS": "160"})
    assert done.exit_code == 0, done.output
    written = pd.read_csv(tmp_path / "orders.csv")
    others = orders(lap_model.scene, permutations=0)
    expected = compare(lap_model, others, "coulomb", 3, lap_model.scene.monte_carlo.seed)
    pd.testing.assert_frame_equal(written, expected, check_exact=False, rtol=1e-9, atol=1e-12)
    own = expected[(expected["order"] == others[1].name) & (expected["tolerance"] > 0)]["mean_change"]
    assert f"{1000 * own.loc[own.abs().idxmax()]:+.1f}".replace("-", "−") in done.output
    assert all(order.name in done.output for order in others[1:])
