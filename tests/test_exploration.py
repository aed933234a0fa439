"""Exploration: moves by hand on springs, as evaluations of the model, and saved assemblies."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from support.springs import LIFT, MU, PULL, dragged

import mic
from mic.errors import SceneError
from mic.scene import Scene
from mic.scene.measured_report import read_measured_report
from mic.studies.exploration import GROUPS


@pytest.fixture(scope="module")
def model():
    return dragged()


@pytest.fixture(scope="module")
def exploration(model):
    return mic.explore(model)


def value(answer, name):
    return answer.table.set_index("measurement").loc[name, "value"]


def test_each_move_gives_the_closed_form(exploration):
    """b's face is lifted by h = (P + s)/2, s the shim below its third locator, and dragged by μ h/4; t goes by D and
    its clamp's stroke."""
    moved = {"P": 0.9, "locators.bl2": 0.1, "zones.z.friction": 0.2, "clamps.T.stroke": -0.25}
    answer = exploration.answer(moved)
    assert value(answer, "M") == pytest.approx(0.2 * 0.5 / 4, rel=1e-9)
    assert value(answer, "N") == pytest.approx(PULL - 0.25, rel=1e-12)
    assert value(exploration.answer({"zones.z.friction": MU}), "M") == pytest.approx(MU * LIFT / 4, rel=1e-9)
    assert not answer.failed and not answer.preliminary and 0 <= answer.residual < 1e-10
    assert answer.shares == {"open": 0, "stick": 0, "slip": 1} and "Solved in all stages" in answer.said


def test_sources_give_evaluations_of_the_model_held_against_their_limits(model, exploration):
    answer, whole = exploration.answer({"P": 0.95, "D": 2.1}), model.evaluate({"P": 0.95, "D": 2.1})
    assert answer.table["value"].tolist() == whole.measurements[0].tolist()
    np.testing.assert_array_equal(answer.evaluation.functional_force, whole.functional_force)
    assert answer.table["within"].tolist() == [True, True]
    for stroke in (1.2, -1.2):
        assert exploration.answer({"clamps.T.stroke": stroke}).table["within"].tolist() == [True, False]


def test_the_largest_contributor_is_first_in_its_group(exploration):
    """D's three sigma move N by 0.15 of half its tolerance; P's move M by 3 σ μ/8."""
    by_name = {one.name: one for one in exploration.controls}
    matters = [by_name[name].matters for name in ("D", "P", "zones.z.friction")]
    assert matters == pytest.approx([0.15, 0.3 * MU / 8, 0.3 * LIFT / 4])
    order = [(GROUPS.index(one.group), -one.matters) for one in exploration.controls]
    assert order == sorted(order) and {group for group, _ in order} == set(range(len(GROUPS)))
    assert (by_name["D"].low, by_name["D"].high, by_name["D"].unit) == (pytest.approx(1.85), pytest.approx(2.15), "mm")


def test_a_stage_is_looked_at_at_its_end(model, exploration):
    """Both faces stand at half of what b is lifted by; b is dragged by M, and t by all of its way."""
    answer = exploration.answer({"P": 0.9}, "clamp")
    along = 0.5 * (PULL + MU * 0.45 / 4)
    np.testing.assert_allclose(exploration.contacts(answer), [[along, 0.0, 0.45 / 2]], atol=1e-9)
    assert (answer.stage, answer.contact_stage) == ("clamp", "clamp")
    located = exploration.answer({"P": 0.9}, "locate")
    assert located.contact_stage == "" and not len(located.states)
    assert exploration.readings(located)[0] == pytest.approx(0.45, rel=1e-9)  # b's face where its locators lift it
    assert exploration.answer({"P": 0.9}).contact_stage == "clamp"


def test_the_readings_are_those_of_the_measurements(lap_model):
    """At the end of the last stage, shapes of the parts included; and another stage is another place. A preliminary
    answer is near the final one, and called so."""
    exploration = mic.explore(lap_model)
    first, final = exploration.answer(coarse=True), exploration.answer()
    read = lap_model.rows["measurement"] @ exploration.readings(final)
    np.testing.assert_allclose(read, final.evaluation.readings[0], atol=1e-9)
    clamped = lap_model.rows["measurement"] @ exploration.readings(exploration.answer(stage="clamp"))
    assert np.abs(clamped - read).max() > 1e-3
    assert first.preliminary and not final.preliminary
    _, y = exploration.draw_samples(6)
    off = np.abs(first.table["value"] - final.table["value"]).to_numpy()
    assert 0 < off.max() and (off < 0.1 * y.std(axis=0)).all()
    assert first.residual < 1e-10  # solved as exactly, along another path


def test_a_failed_move_is_reported_and_the_next_is_evaluated(exploration):
    impossible = exploration.answer({"zones.z.friction": -0.1})
    assert impossible.failed and "Not solved" in impossible.said and not impossible.table["within"].any()
    assert not exploration.answer().failed


@pytest.mark.parametrize(
    ("moved", "stage", "said"),
    [
        ({"Q": 1.0}, None, "there is no control 'Q'; known: D, P"),
        ({"P": float("nan")}, None, "P is nan; give a finite number"),
        ({}, "paint", "there is no stage 'paint'; known: locate, clamp, measure"),
    ],
)
def test_unknown_names_are_refused(exploration, moved, stage, said):
    with pytest.raises(ValueError) as refused:
        exploration.answer(moved, stage)
    assert said in str(refused.value).replace("known: P, D", "known: D, P")


def test_bounds_that_allow_nothing_are_refused(model):
    with pytest.raises(ValueError, match="shim is 0.*; give a finite number above 0"):
        mic.explore(model, shim=0.0)


def test_a_scene_without_measurements_can_be_moved_too():
    exploration = mic.explore(dragged(measurements=[]))
    assert not len(exploration.answer({"P": 0.9}).table) and exploration.controls[0].matters == 0.0


def test_a_sample_of_the_scene_is_that_of_its_deviations(model, exploration):
    x, y = exploration.draw_samples(5)
    again, _ = exploration.draw_samples(2, first=3)
    np.testing.assert_array_equal(x[3:], again)
    answer = exploration.answer(exploration.sample(x[2]))
    np.testing.assert_allclose(answer.table["value"], y[2], rtol=1e-12)


def test_a_saved_assembly_gives_the_same_numbers(model, exploration, tmp_path):
    """The scene with its new tables, and the row of samples that goes with it, by the readers of both."""
    moved = {"P": 0.8765432109876543, "locators.bl2": 1 / 7, "zones.z.friction": 0.2, "clamps.T.stroke": -0.25}
    added = tomllib.loads(exploration.scene_tables(moved))["deviations"]
    assert [(one["kind"], one["target"]) for one in added] == [("locator", "bl2"), ("clamp", "T"), ("friction", "z")]
    scene = model.scene.model_dump(mode="json")
    saved = model.varied(Scene(**scene | {"deviations": [*scene["deviations"], *added], "folder": tmp_path}))
    (tmp_path / "sample.csv").write_text(exploration.sample_table(moved))
    (values,) = read_measured_report(tmp_path / "sample.csv", saved.parameters, "deviation").values.values()
    assert list(values) == saved.parameters  # a table of samples needs all of them
    told = exploration.answer(moved).table["value"]
    np.testing.assert_array_equal(saved.evaluate(values).measurements[0], told)
    alone = saved.evaluate({"P": moved["P"]})  # the rest stands in the scene
    np.testing.assert_array_equal(alone.measurements[0], told)
    assert exploration.scene_tables({"P": 0.9}) == ""
    assert exploration.sample_table({"P": 0.9}) == f"P,D\n0.9,{PULL!r}\n"


def test_the_how_to_page_runs(lap_model, tmp_path, monkeypatch, capsys):
    page = (Path(__file__).resolve().parents[1] / "docs" / "howto.md").read_text(encoding="utf-8")
    section = page.split("## Explore an assembly interactively\n")[1].split("\n## ")[0]
    (program,) = re.findall(r"```python\n(.*?)```", section, re.S)
    monkeypatch.chdir(tmp_path)
    lap_model.save("joint.npz")
    exec(program, {})
    said = capsys.readouterr().out
    assert "'zones.lap.friction'" in said and "M1" in said and "True" in said


def test_sliders_reach_as_far_as_the_distribution(model):
    deviations = [
        {"name": "P", "kind": "locator", "target": "bl1", "mean": 0.8, "sigma": 0.1, "truncated": [0.7, 1.0]},
        {"name": "fixed", "kind": "clamp", "target": "T", "mean": PULL, "sigma": 0.0},
    ]
    exploration = mic.explore(dragged(deviations=deviations))
    (own,) = [one for one in exploration.controls if one.group == "sources"]
    assert own.name == "P" and 0.7 <= own.low < 0.71 and 0.98 < own.high <= 1.0
    assert exploration.answer().evaluation.deviations[0][1] == PULL


def test_a_law_without_friction_has_no_coefficients_to_move(model):
    assert "friction" not in {one.group for one in mic.explore(model, "frictionless").controls}


def test_a_scene_without_movable_inputs_is_refused():
    free = dragged(deviations=[], clamps=[], friction=0.0)
    assert {one.group for one in mic.explore(free).controls} == {"locators"}
    bare = free.varied(free.scene.model_copy(update={"locators": []}))
    with pytest.raises((SceneError, ValueError)):
        mic.explore(bare)
