"""The error budget: estimates on assemblies whose true errors are known, the sum, and a scene of one's own."""

import json
from dataclasses import replace
from functools import cache as once

import numpy as np
import pandas as pd
import pytest
from support.runs import changed
from support.springs import at_face, six, spring_model
from support.wrong_models import compliance_scaled, gaps_off

import mic
from fem_reference.full.model import FullModel
from mic.report.template import backticks_to_code
from mic.scene.deviation import FieldDeviation
from mic.statistics.draw import draw
from verification import budget, budget_page, own_scene
from verification.budget import (
    REFINED,
    SHARES,
    Item,
    bounded,
    largest_difference,
    nearer,
    paired,
    total,
    two_levels,
    values,
)
from verification.budget_page import budget_rows, budget_sentences, by_quantity, items_of
from verification.comparison import difference, reduced_and_assembly
from verification.error_budget import study
from verification.own_scene import verify_scene
from verification.scenes import shipped, with_path
from verification.stiffness import DeviatedStiffness
from verification.study import Team

pytestmark = pytest.mark.fem

# --- coverage, where the truth is known
# ------------------------------------------------------------------------------------------------------

GROUPS, SAMPLES = 100, budget.SAMPLES
FORCES = {"seldom open": (14.0, 2.0), "open as often as not": (10.0, 2.0)}  # N, mean and σ; the gap closes at 10 N
HELD = 0.95 - 3 * np.sqrt(0.95 * 0.05 / GROUPS)  # fewer of so many 95 % intervals are three deviations off
OFF = 0.06  # compliance of production over the true one, less 1


def model(mean=10.0, sigma=2.0):
    """Two faces that a clamp of varying force closes: a gap, then both springs together."""
    return spring_model(
        [0.2],
        parts=[{"name": name, "mesh": f"{name}.stl", "thickness": 1.0} for name in "bt"],
        locators=[*six("b"), *six("t")],
        clamps=[at_face("t", (0, 0, -1), name="F", force=mean)],
        zones=[{"name": "z", "parts": ["b", "t"], "friction": 0.3, "pairs": 1}],
        measurements=[at_face("t", (0, 0, 1), name="M", lower=-0.5, upper=0.5)],
        deviations=[{"name": "D", "kind": "clamp", "target": "F", "mean": 0.0, "sigma": sigma}],
        stages=[{"kind": "locate"}, {"kind": "clamp"}, {"kind": "measure"}],
    )


@once
def answers(force, *errors):
    """M of all samples, of faces whose compliances are these shares too large."""
    true = model(*FORCES[force])
    off = compliance_scaled(true, 1 + sum(errors))
    process = off.process("coulomb")
    return values(off, process.evaluate(draw(true.scene, 1, 0, GROUPS * SAMPLES)))[["measurement:M"]]


def true_errors(production, truth):
    return {"mean": float((production - truth).mean().iloc[0]),
            "six_sigma": 6 * float((production.std() - truth.std()).iloc[0])}  # fmt: skip


def share_held(found, true):
    """The shares of the groups' intervals that cover the true errors of mean and 6σ."""
    return [np.mean((found[name] - true[name]).abs() <= found[f"{name}_half"]) for name in ("mean", "six_sigma")]


def groups(*frames):
    for first in range(0, GROUPS * SAMPLES, SAMPLES):
        yield tuple(frame.iloc[first : first + SAMPLES] for frame in frames)


def zeroed(table):
    return 0 * table


def turned(table):
    return table.assign(mean=-table["mean"], six_sigma=-table["six_sigma"])


# Share of an error that better samples leave: half a mesh at orders 1.4 to 3, a share of the distance at 1 to 2.
LEFT = [("mesh", 2.0**-1.4), ("mesh", 2.0**-3), (min(SHARES), min(SHARES) ** 2), (max(SHARES), max(SHARES)),
        ("path", 0.25), ("increments", 1 / 4)]  # fmt: skip


@pytest.mark.parametrize("force", FORCES)
@pytest.mark.parametrize("source, left", LEFT)
def test_intervals_of_an_estimate_cover_the_true_error_as_often_as_stated(source, left, force):
    production, better, truth = answers(force, OFF), answers(force, OFF * left), answers(force)
    printed = 6 * production.std()
    refined = REFINED[source] if isinstance(source, str) else nearer(source)
    found = pd.concat([paired(y, x, refined, printed) for y, x in groups(production, better)])
    true = true_errors(production, truth)
    assert min(share_held(found, true)) >= HELD
    for wrong in (zeroed, turned):
        mean, six_sigma = share_held(wrong(found), true)
        assert mean < 0.05 and (six_sigma < 0.5 or force != "seldom open")  # else 6σ hardly errs
    assert ((found["mean"] / true["mean"] - 1).abs() < 0.5).all()  # the intervals are not merely wide


@pytest.mark.parametrize("force", FORCES)
def test_intervals_of_the_nominal_stiffness_cover_the_true_error_as_often_as_stated(force):
    """Ten of thirty samples have stiffnesses of their own."""
    rng, production = np.random.default_rng(2), answers(force)
    dear = production + (answers(force, OFF) - production) * (1 + 0.3 * rng.standard_normal(production.shape))
    true = true_errors(production, dear)
    found = pd.concat([two_levels(y, x.iloc[:10]) for y, x in groups(production, dear)])
    assert min(share_held(found, true)) >= HELD
    for wrong in (zeroed, turned):
        assert share_held(wrong(found), true)[0] < 0.05


def test_the_sum_covers_the_error_of_all_sources_together():
    """Mesh and pairs at once; a sum with one item zeroed or turned round does not."""
    all_, fine, dense = ((OFF, OFF), (OFF / 4, OFF), (OFF, OFF / 3))
    production, finer, denser, truth = (answers("open as often as not", *off) for off in (all_, fine, dense, ()))
    printed, true = 6 * production.std(), true_errors(production, truth)
    estimates = [
        (paired(y, fine, REFINED["mesh"], printed), paired(y, dense, nearer(0.5), printed))
        for y, fine, dense in groups(production, finer, denser)
    ]
    as_it_is = lambda table: table
    for change in (as_it_is, zeroed, turned):
        sums = [total([Item("mesh", "", 0, change(mesh)), Item("pairs", "", 0, pairs)]) for mesh, pairs in estimates]
        held = share_held(pd.concat(sums), true)
        assert min(held) >= HELD if change is as_it_is else held[0] < 0.05


# --- the sum and what is made of it, by hand
# ------------------------------------------------------------------------------------------------------


def table(mean, mean_half, six_sigma, six_sigma_half, name="measurement:M"):
    columns = ("mean", "mean_half", "six_sigma", "six_sigma_half")
    return pd.DataFrame([[mean, mean_half, six_sigma, six_sigma_half]], columns=columns, index=[name], dtype=float)


def figures():
    columns = ("mean", "mean_half", "six_sigma", "six_sigma_half", "lower", "upper", "samples")
    return pd.DataFrame([[0.1, 0.01, 0.6, 0.05, -0.5, 0.5, 100]], columns=columns, index=["measurement:M"])


def items():
    return [
        Item("path", "so", 1.0, table(0.03, 0.003, -0.02, 0.004)),
        Item("mesh", "so", 1.0, table(-0.01, 0.004, -0.04, 0.003)),
        Item("order", "so", 1.0, table(0.0, 9.0, 0.0, 9.0), counts=False),
        Item("pairs", "not estimated: why", 0.0, None),
    ]


def test_the_sum_adds_errors_with_signs_and_uncertainties_in_squares():
    found = total(items()).loc["measurement:M"].to_dict()
    assert found == pytest.approx({"mean": 0.02, "mean_half": 0.005, "six_sigma": -0.06, "six_sigma_half": 0.005})


def test_the_corrected_cpk_is_the_printed_one_less_its_error():
    row = by_quantity(figures(), items()).loc["measurement:M"]
    assert row["cpk"] == pytest.approx(0.4 / 0.3) and row["cpk error"] == pytest.approx(0.4 / 0.3 - 0.42 / 0.33)
    assert row["cpk error ±"] == pytest.approx(np.hypot(0.005 / 0.3, 0.4 / 0.3 * 0.005 / 0.6))
    assert row["dominating"] == "mesh" and row["figure"] == "six_sigma" and row["worst"] == pytest.approx(0.065)


def test_sentences_name_the_largest_error_its_source_and_unknown_sources():
    found = budget_sentences("S", by_quantity(figures(), items()), items())
    assert found["figures"] == (
        "S: largest error of a mean +20 ± 5 µm (M, +2 ± 0.5 % of its tolerance); of a 6σ −60 ± 5 µm "
        "(M, −6 ± 0.5 % of its tolerance)."
    )
    assert "mesh" in found["dominating"] and found["unknown"].endswith("sum: pairs.")
    rows = budget_rows(items(), by_quantity(figures(), items())).set_index("source")
    assert rows.at["path", "mean of M, µm"] == "+30 ± 3" and rows.at["pairs", "mean of M, µm"] == "–"
    assert rows.at["mesh", "largest, % of tolerance"] == pytest.approx(4.3) and "order (not in the sum)" in rows.index


def test_sentences_name_the_remedy_of_the_dominating_source():
    assert set(budget_page.REMEDIES) == {*budget.EVERY, budget.SAMPLING} - {budget.NODES}
    both = [
        Item(budget.STIFFNESS, "so", 1.0, table(0.0, 0.0, 0.02, 0.01)),
        Item(budget.SAMPLING, "so", 0.0, table(0.0, 0.0, 0.0, 0.2)),
    ]
    told = budget_sentences("S", by_quantity(figures(), both), both)["dominating"]
    assert told.index("draw more samples") < told.index('`stiffness = "auto"`')
    told = budget_sentences("S", by_quantity(figures(), both[:1]), both[:1])["dominating"]
    assert 'set `stiffness = "auto"`' in told and told.endswith("more samples do not reduce it.")


def test_bounds_have_no_sign():
    found = bounded(pd.Series({"M": -0.2}), pd.Series({"M": 0.3}))
    assert found.loc["M"].tolist() == [0.0, 0.2, 0.0, 0.3]
    most = largest_difference(pd.DataFrame({"M": [1.0, 2.0]}), pd.DataFrame({"M": [1.1, 1.8]}))
    assert most.loc["M"].tolist() == pytest.approx([0, 0.2, 0, 1.2])


def test_errors_of_the_method_exclude_sampling_and_an_open_order():
    large = [Item(name, "so", 0.0, table(0.0, 0.5, 0.0, 0.5)) for name in (budget.SAMPLING, budget.ORDER)]
    both = [*items(), *large]
    found = study.method_errors(by_quantity(figures(), both), both)
    assert found["mean"] == pytest.approx(0.025) and found["six-sigma"] == pytest.approx(0.065)


def test_a_cpk_counts_if_it_is_below_two_or_could_be_and_a_slip_over_the_narrowest_tolerance():
    """An error of 6σ that exceeds it leaves Cpk unknown, which is not accurate."""
    slip = table(0.0, 0.0, 0.002, 0.003, "slip:clamp:z")
    for six_sigma, error, counts in ((0.6, 0.06, True), (0.1, 0.04, False), (0.1, 0.4, True)):
        shown = figures().assign(six_sigma=six_sigma)
        shown.loc["slip:clamp:z"] = [0.001, 0.0, 0.004, 0.0, np.nan, np.nan, 100]
        off = [Item("mesh", "so", 1.0, pd.concat([table(0.0, 0.0, error, 0.0), slip]))]
        by_name = by_quantity(shown, off)
        found, whole = study.method_errors(by_name, off), by_name.loc["measurement:M"]
        assert found["cpk"] == pytest.approx(abs(whole["cpk error"]) if counts else 0.0, nan_ok=True)
        assert np.isnan(found["cpk"]) == (error > six_sigma)
        assert found["slip"] == pytest.approx(0.005 / 1.0)


# --- a scene, with finite elements
# ------------------------------------------------------------------------------------------------------


def lap(pairs=24):
    scene = changed(shipped("lap_joint", "coarse"), monte_carlo={"samples": 40})
    return scene.model_copy(update={"zones": [scene.zones[0].model_copy(update={"pairs": pairs})]})


@pytest.mark.slow
def test_a_reduced_model_of_the_deviated_shape_finds_what_full_finite_elements_find_there(cache):
    """Welds close their gaps, so that these count."""
    scene = with_path(lap(), "one-step")
    scene = scene.model_copy(update={"welds": [weld.model_copy(update={"close": True}) for weld in scene.welds]})
    model, assembly = reduced_and_assembly(scene, cache)
    sample = draw(scene, 1, 0, 1)[0]
    full = FullModel(assembly, deviated=True, route="condensed").evaluate(sample)
    own = DeviatedStiffness(assembly, model).at(sample)
    assert difference(own.evaluate(sample, "coulomb"), 0, full).largest < 1e-7
    assert difference(model.evaluate(sample, "coulomb"), 0, full).largest > 1e-2


@pytest.mark.fem
def test_pairs_and_meshes_are_refined_on_the_path_that_production_follows(cache, tmp_path, monkeypatch):
    """Though the full solves take one increment a step. A field is sampled by its modes there, too."""

    def refuse(*_, **options):
        raise mic.SceneError("not needed here")

    seen = []
    monkeypatch.setattr(own_scene, "estimate", lambda case, *rest: seen.append(case) or [])
    monkeypatch.setattr(own_scene, "FullModel", refuse)
    field = FieldDeviation(name="S", kind="field", part="upper", sigma=0.02, length=40.0)
    scene = lap().model_copy(update={"deviations": [field, *lap().deviations]})
    verify_scene(scene, tmp_path, cache, 1, False, Team(), lambda line: None)
    (case,) = seen
    assert len(case.deviations.T) == len(case.model.scene.deviations) > len(scene.deviations)
    for one in (case.assembly, case.model):
        assert [(stage.path, stage.increments) for stage in one.scene.stages] == [(None, None)] * 5


@pytest.mark.fem
@pytest.mark.slow
def test_a_mesh_is_refined_with_the_stiffness_that_the_scene_asks_for(cache):
    """On finer meshes means differ by the error of elements, and not by the effect of the stiffness."""
    production = {}
    for stiffness in ("nominal", "first-order"):
        scene = with_path(lap(8), "one-step")
        scene = scene.model_copy(update={"stiffness": stiffness, "deviations": scene.deviations[:1]})
        model, assembly = reduced_and_assembly(scene, cache)
        case = budget.Case(assembly, model, "coulomb", cache, samples=3)
        production[stiffness] = case.production
    moved = (production["first-order"] - production["nominal"]).mean().abs()["measurement:M1"]
    left = abs(budget.SOURCES["mesh and element"](case)[1].at["measurement:M1", "mean"])
    assert 0 < left < moved / 2


@pytest.mark.slow
def test_a_scene_gets_its_error_budget_and_a_second_call_reuses_full_solves(cache, tmp_path, monkeypatch):
    monkeypatch.setattr(budget, "DEVIATED", 2)
    monkeypatch.setattr(budget, "SHARES", SHARES[-1:])
    found = verify_scene(lap(8), tmp_path, cache, 1, True, Team(), lambda line: None)
    known = {item.source: item for item in items_of(found["budget"]["sources"])}
    assert list(known) == ["algebra", "reduction", *budget.EVERY, "sampling"]
    assert all(item.table is not None for item in known.values())
    quantities = {row["quantity"]: row for row in found["budget"]["quantities"]}
    assert set(quantities) == {"measurement:M1", "measurement:M2", "slip:clamp:lap", "slip:release:lap"}
    assert known["reduction"].table.loc["measurement:M1", "mean_half"] < 1e-6
    assert abs(known["nominal stiffness"].table.loc["measurement:M1", "mean"]) > 1e-4
    page = (tmp_path / "report.html").read_text()
    assert all(str(backticks_to_code(sentence)) in page for sentence in found["budget"]["sentences"].values())
    written = json.loads((tmp_path / "summary.json").read_text())
    assert written["budget"]["sources"][0]["source"] == "algebra"
    monkeypatch.setattr(FullModel, "evaluate", None)  # calling it would break
    again = verify_scene(lap(8), tmp_path, cache, 1, True, Team(), lambda line: None, sources=())
    assert again["per_sample"] == found["per_sample"]


def estimated(case, folder, source):
    """The error budget's entry of one source."""
    (found,) = budget.estimate(case, folder, "key", Team(), [source], lambda line: None)
    return found


def test_a_source_that_cannot_be_estimated_is_named_with_its_reason(monkeypatch, tmp_path):
    def refused(case):
        raise mic.SceneError("there is no room for denser pairs")

    case = budget.Case(None, model(), "coulomb", tmp_path, samples=4)
    monkeypatch.setitem(budget.SOURCES, "pairs", refused)
    found = estimated(case, tmp_path, "pairs")
    assert found.table is None and "no room" in found.how and not list(tmp_path.iterdir())


def test_a_stated_order_of_the_process_is_no_error_source_and_an_estimate_is_reused(tmp_path, monkeypatch):
    springs = model()
    case = budget.Case(None, springs, "coulomb", tmp_path, samples=4)
    open_ = estimated(case, tmp_path / "open", "order of the process")
    stages = [stage.model_copy(update={"order": [["F"]]} if stage.kind == "clamp" else {})
              for stage in springs.scene.stages]  # fmt: skip
    stated = replace(case, model=replace(springs, scene=springs.scene.model_copy(update={"stages": stages})))
    closed = estimated(stated, tmp_path / "stated", "order of the process")
    assert open_.counts and not closed.counts and "states its order" in closed.how
    monkeypatch.setitem(budget.SOURCES, "order of the process", None)  # calling it would break
    assert estimated(case, tmp_path / "open", "order of the process").how == open_.how


@pytest.mark.slow
def test_contact_at_every_node_shows_the_error_of_displaced_pairs(cache, monkeypatch, tmp_path):
    """24 pairs of the coarse lap joint err by a hundredth of a millimetre; with all gaps off by 0.1 mm by far more."""
    own, assembly = reduced_and_assembly(lap(), cache)
    errors = []
    for one in (own, gaps_off(own, 0.1)):
        how, table = budget.SOURCES[budget.NODES](budget.Case(assembly, one, "coulomb", cache, samples=4))
        assert list(table.index) == ["measurement:M1", "measurement:M2"] and "96 nodes" in how
        errors.append(table["mean"].abs().max())
    assert errors[0] < 0.03 and errors[1] > 3 * errors[0]
    monkeypatch.setattr(budget, "MOST", 50)  # nodes
    found = estimated(budget.Case(assembly, own, "coulomb", cache, samples=4), tmp_path, budget.NODES)
    assert found.table is None and not found.counts and "96 nodes" in found.how
