"""Joint adjustments of single assemblies: programs against brute force, steps, numbers, costs, uncertainty."""

from itertools import product

import numpy as np
import pytest
from support.springs import PULL, at_face, clamped, dragged

from mic.errors import ArgumentError
from mic.studies.adjustable import Adjustable
from mic.studies.adjustment import adjustments, with_adjustments
from mic.studies.adjustment_goals import NearTarget, WithinLimits
from mic.studies.joint_adjustment import JointAdjustment
from mic.studies.prediction import Predictor

STILL = np.zeros(2)


def pressed(**keys):
    """Two readings, M of b and N of t; four locators and the clamp act on them."""
    limits = (("b", "M", 0.0, 0.05), ("t", "N", PULL - 0.03, PULL + 0.03))
    return dragged(
        measurements=[at_face(part, (1, 0, 0), name=n, lower=a, upper=b) for part, n, a, b in limits], **keys
    )


@pytest.fixture(scope="module")
def model():
    return pressed()


def values(model, settings, x, changes):
    extended, _ = with_adjustments(model, settings)
    return extended.process("coulomb").evaluate(np.concatenate([x, changes])[None]).measurements[0]


def test_the_program_within_limits_takes_the_least_relative_change():
    """Two characteristics, one 0.3 too large, one right: the first adjustment reaches it with 0.3 of its range, the
    second with 0.6, and both move the other characteristic by less than its limit."""
    goal = WithinLimits(np.array([-np.inf, -1.0]), np.array([1.0, 1.0]), np.ones(2), np.ones(2), np.zeros(2))
    slopes = np.array([[[-1.0, -0.5], [0.1, 0.0]]])
    step = goal.step(np.array([[1.3, 0.0]]), slopes, np.zeros(2), -np.ones(2), np.ones(2))
    assert step == pytest.approx([0.3, 0.0], abs=1e-5)
    narrow = goal.step(np.array([[1.3, 0.0]]), slopes, np.zeros(2), np.array([-0.2, -1]), np.array([0.2, 1]))
    assert narrow == pytest.approx([0.2, 0.2], abs=1e-5)


def test_the_program_near_a_target_obeys_bounds_and_fixed_changes():
    goal = NearTarget(np.zeros(2), np.ones(2), np.zeros(2), np.ones(2))
    slopes, y = np.array([[[1.0, 0.0], [0.0, 1.0]]]), np.array([[0.5, -0.2]])
    step = goal.step(y, slopes, np.zeros(2), np.array([-0.3, -1.0]), np.array([0.3, 1.0]))
    assert step == pytest.approx([-0.3, 0.2], abs=1e-4)
    fixed = goal.step(y, slopes, np.zeros(2), np.array([0.1, -1.0]), np.array([0.1, 1.0]))
    assert fixed == pytest.approx([0.1, 0.2], abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("objective", ["rms", "cpk"])
def test_an_assembly_comes_as_near_to_the_target_as_any_of_a_grid(model, objective):
    """Brute force over all settings of two adjustments, in the steps in which they can be set."""
    request = Adjustable(["bl2", "tl0"], 0.2, objective=objective, step=0.05)
    planner = JointAdjustment(model, "coulomb", request)
    settings, x = planner.allowed.settings, np.array([1.05, PULL + 0.1])
    found = planner.propose(x, STILL)
    grid = np.round(np.arange(-4, 5) * 0.05, 9)
    every = np.array(list(product(grid, repeat=2)))
    y = with_adjustments(model, settings)[0].process("coulomb").evaluate(np.column_stack([np.tile(x, (81, 1)), every]))
    merits = planner.goal.merit(y.measurements[:, None], every)
    assert found.merit <= merits.min() + planner.goal.worth and found.merit < found.merit_before
    assert found.after == pytest.approx(values(model, settings, x, [found.changes.get(item, 0.0) for item in settings]))
    assert found.residual < 1e-8


@pytest.mark.slow
def test_steps_and_the_largest_number_of_adjustments_are_obeyed(model):
    """The locator lowers M, the clamp moves N; both are far off."""
    x, numbers = np.array([1.05, PULL + 0.1]), []
    for most in (1, 2):
        request = Adjustable(["bl2", "T"], 0.25, objective="rms", step=0.1, most=most)
        found = JointAdjustment(model, "coulomb", request).propose(x, STILL)
        numbers.append(len(found.changes))
        assert all(abs(change) in (0.1, 0.2) for change in found.changes.values())
    assert numbers == [1, 2]


@pytest.mark.slow
def test_no_assembly_becomes_worse_and_idle_adjustments_are_not_proposed():
    """Contact opens and closes within the range of the adjustment."""
    model = clamped(
        "bt",
        0.2,
        measurements=[at_face("t", name="M", lower=0.0, upper=0.06)],
        deviations=[{"name": "P", "kind": "locator", "target": "bl1", "mean": 0.4, "sigma": 0.15}],
    )
    planner = JointAdjustment(model, "coulomb", Adjustable(["bl1", "bl2"], 0.5, objective="rms"))
    settings = planner.allowed.settings
    for p in np.linspace(0.05, 0.8, 6):
        found = planner.propose(np.array([p]), np.zeros(1))
        changes = np.array([found.changes.get(item, 0.0) for item in settings])
        before, after = values(model, settings, [p], 0 * changes), values(model, settings, [p], changes)
        assert abs(after[0] - 0.03) <= abs(before[0] - 0.03)
        assert found.changes or not changes.any()


SHIM = {"of": ["bl2"], "between": [-0.2, 0.2], "step": 0.02}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reject", "words"),
    [
        (1.0, ["within all limits", "; cost 0."]),
        (0.01, ["no adjustment is worth its cost: 0.", "a reject costs 0.01"]),
    ],
)
def test_a_change_that_costs_more_than_a_reject_is_not_proposed(reject, words):
    """M is right with P up to 4/3 mm: 0.06 mm are needed, at 10 per mm."""
    optimise = {"objective": "cost", "reject": reject, "shims": [SHIM | {"cost": 10.0}]}
    found = Predictor(pressed(optimise=optimise), adjust=["scene"], exact=True)
    said = found.predict({"P": 1.39, "D": PULL})["said"].iloc[-1]
    assert bool(found.proposal.changes) == (reject == 1.0) and all(word in said for word in words)
    for item, change in found.proposal.changes.items():
        assert item.increment == 0.02 and change < 0 and found.proposal.excess <= 0


@pytest.mark.slow
def test_an_uncertain_measurement_is_trusted_as_far_as_the_prior_says(model):
    """With an unknown P the proposal is that for its mean; the less certain it is, the nearer to that."""
    planner = JointAdjustment(model, "coulomb", Adjustable(["bl2"], 0.4, objective="rms"))
    changes = []
    for noise in (0.0, 0.1, np.inf):
        found = planner.propose(np.array([1.2, PULL]), STILL, np.array([noise, 0.0]))
        changes.append(sum(found.changes.values()))
    mean = sum(planner.propose(np.array([0.8, PULL]), STILL).changes.values())
    assert abs(changes[2] - mean) < abs(changes[1] - mean) + 1e-9 < abs(changes[0] - mean) + 2e-9


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (Adjustable(["bl2"], objective="best"), "objective is 'best'; choose one of yield, rms, cpk, cost"),
        (Adjustable(["bl2"], step=0.0), "step must be above 0"),
        (Adjustable(["bl2"], step=1.0), "locators.bl2 may move by 0.5 mm; reduce the step"),
        (Adjustable(["all", "bl2"]), "remove the other names"),
        (Adjustable(["scene"]), "no table [optimise]"),
        (Adjustable(["bl2"], objective="cost"), "needs costs"),
    ],
)
def test_a_request_that_cannot_be_met_is_one_sentence(model, request_, said):
    with pytest.raises(ArgumentError) as refused:
        request_.of(model)
    assert said in str(refused.value)


def test_the_sentence_names_each_change(model):
    planner = Predictor(model, adjust=Adjustable(["bl2", "tl1"], 0.4, objective="rms"), exact=True)
    said = planner.predict({"P": 1.3, "D": PULL + 0.02})["said"].iloc[-1]
    assert "locators." in said and "times the distance from the target" in said
    assert len(adjustments(model, names=["bl2", "tl1"])) == 2


@pytest.mark.slow
def test_more_adjustments_never_leave_more_beyond_the_limits():
    """No changes reach the limits of this assembly; contact opens and closes within the ranges."""
    model = clamped(
        "bt",
        0.2,
        measurements=[at_face(part, name=name, lower=-0.01, upper=0.01) for part, name in (("t", "M"), ("b", "N"))],
        deviations=[{"name": "P", "kind": "locator", "target": "bl1", "mean": 0.4, "sigma": 0.15}],
    )
    pair, every = (
        JointAdjustment(model, "coulomb", Adjustable(names, 0.2, step=0.05))
        for names in (["bl1", "bl2"], ["bl1", "bl2", "tl1"])
    )
    x, none = np.array([0.7]), np.zeros(2)
    two, three = pair.propose(x, none).excess, every.propose(x, none).excess
    grid = np.array(list(product(np.round(np.arange(-4, 5) * 0.05, 9), repeat=2)))
    extended = with_adjustments(model, pair.allowed.settings)[0].process("coulomb")
    y = extended.evaluate(np.column_stack([np.full(81, 0.7), grid])).measurements
    assert two <= (np.abs(y) - 0.01).max(axis=1).min() + 1e-3 and 0 < three <= two + 1e-3


@pytest.mark.slow
@pytest.mark.fem
def test_least_excess_is_found_where_friction_leads_the_linear_program_astray(lap_model):
    """Limits that nothing reaches. All items leave no more than one of them alone, nor than the least distance from
    the target; a program from the assembly as it is ends at once."""
    limits = {"M1": 0.3, "M2": 0.2}
    tightened = lambda one: one.model_copy(update={"lower": -limits[one.name], "upper": limits[one.name]})
    measurements = [tightened(one) for one in lap_model.scene.measurements]
    model = lap_model.varied(lap_model.scene.model_copy(update={"measurements": measurements}))
    planner = lambda *names, **goal: JointAdjustment(model, "coulomb", Adjustable(names, 1.0, step=0.2, **goal))
    every, x = planner("all"), np.array([[-5, 3.2, 0.05], [-9, 0, 0.08]])
    assert every.propose(x[0], STILL).excess <= planner("upper-A3").propose(x[0], STILL).excess + 1e-3
    assert every.propose(x[1], STILL).excess <= planner("all", objective="rms").propose(x[1], STILL).excess + 1e-3


@pytest.mark.parametrize(
    ("asked", "bounds", "said"),
    [
        ({"shim": 0.1}, (-0.1, 0.1, 0.02), ""),
        ({"shim": 0.5}, (-0.2, 0.2, 0.02), ""),
        ({"step": 0.04}, (-0.2, 0.2, 0.04), ""),
        ({"step": 0.03}, (), "in steps of 0.02 mm"),
        ({"shim": 0.01}, (), "beyond the largest change"),
    ],
)
def test_options_narrow_what_the_scene_allows_or_are_refused(asked, bounds, said):
    request = Adjustable(["scene"], **asked)
    model = pressed(optimise={"objective": "yield", "shims": [SHIM]})
    if said:
        with pytest.raises(ArgumentError) as refused:
            request.of(model)
        assert said in str(refused.value)
    else:
        (item,) = request.of(model).settings
        assert (item.low, item.high, item.step) == bounds


def test_a_verdict_that_is_open_for_a_missing_measurement_names_it(model):
    planner = Predictor(model, adjust=["bl2"], exact=True)
    found = planner.predict({"P": 1.0})
    assert found["verdict"].iloc[-1] == "open" and found["said"].iloc[-1].startswith("measure D, which causes 100 %")
    assert planner.predict({"P": 1.0, "D": PULL})["said"].iloc[-1] == ""
