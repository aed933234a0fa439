"""Clamps and guns of limited force against two springs and a gap by hand."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from support.springs import STIFFNESS, at_face, six, stage_list, two_plates

import mic
from mic.process.description import sentences
from mic.process.plan import plan_stages
from mic.results.outcome import read_outcome
from mic.runs import sample_into

GAP = 0.3  # mm
NEEDED = 2 * STIFFNESS * GAP  # N that press b's face down by 2 g: over the gap, and then both springs by g


def plates(gap=GAP, **change):
    return two_plates(gap, **change)


def closing(stroke, limit, **keys):
    """A clamp that presses b's face down to `stroke` below nominal."""
    return at_face("b", (0, 0, -1), name="C", stroke=stroke, limit=limit, **keys)


def closing_along(stroke, limit):
    """A clamp that drags b's face along x."""
    return at_face("b", (1, 0, 0), name="C", stroke=stroke, limit=limit)


@pytest.mark.parametrize(
    "law, keys",
    [("coulomb", {}), ("coulomb", {"increments": 3}), ("frictionless", {"path": "one-step"}), ("associated", {})],
)
def test_a_clamp_closes_to_its_position_or_to_its_force_limit(law, keys):
    """b's face, pressed down by w with a's beneath it at the gap g: the force is k w up to g, then k w + k (w − g).

    Under the limit F it comes to w = F/k before it touches, to (F + k g)/2k after.
    """
    stages = stage_list("locate", {"kind": "clamp"} | keys, "release", "measure")
    takes = STIFFNESS * (2 * 0.5 - GAP)  # for w = 0.5 mm
    cases = {  # limit: (way, force, way left)
        2 * takes: (0.5, takes, 0.0),
        1.001 * takes: (0.5, takes, 0.0),
        0.8 * takes: ((0.8 * takes + STIFFNESS * GAP) / (2 * STIFFNESS), 0.8 * takes, None),
        10.0: (10 / STIFFNESS, 10.0, None),
    }
    for limit, (way, force, left) in cases.items():
        model = plates(clamps=[closing(0.5, limit)], stages=stages)
        found = model.evaluate({}, law)
        closed = found.resolutions["clamp"]
        assert found.failed.sum() == 0 and closed.residual[0] <= 1e-10
        assert closed.pushed[0, 0] == pytest.approx(force, rel=1e-9)
        assert closed.left[0, 0] == (left if left is not None else pytest.approx(0.5 - way, rel=1e-9))
        assert found.built[0] == (left is not None)
        assert (
            np.isnan(closed.needed[0, 0]) if found.built[0] else closed.needed[0, 0] == pytest.approx(takes, rel=1e-9)
        )
        pressed = max(0.0, STIFFNESS * (way - GAP))
        assert closed.force[0, 0, 0] == pytest.approx(pressed, rel=1e-9, abs=1e-9)
        assert closed.displacement[0, 0, 0] == pytest.approx(max(0.0, GAP - way), rel=1e-9, abs=1e-9)
        opened = found.resolutions["release"]
        assert opened.force[0, 0, 0] == 0.0
        assert opened.displacement[0, 0, 0] == pytest.approx(GAP, rel=1e-9)
        assert found.measurements[0, 0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("press, stroke", [(0.0, 0.5), (60.0, 0.4)])
def test_an_unreached_limit_has_no_effect(press, stroke):
    """The clamp comes down on the gap, or brings back a face that is pressed beyond; the drag makes the way count.

    While the clamp opens, its force fades from what it was, and the drag slips on.
    """
    drag = at_face("b", (1, 0, 0), name="D", force=3.0)
    push = at_face("b", (0, 0, -1), name="P", force=press)
    stages = stage_list(
        "locate",
        {"kind": "clamp", "order": [["P"], ["C"], ["D"]] if press == 0 else [["P"], ["C", "D"]]},
        {"kind": "release", "order": [["C"], ["D"], ["P"]]},
        "measure",
    )
    limits = (200.0, None)
    limited, plain = (
        plates(clamps=[closing(stroke, limit), drag, push], stages=stages).evaluate({}) for limit in limits
    )
    for stage in ("clamp", "release"):
        ours, theirs = limited.resolutions[stage], plain.resolutions[stage]
        np.testing.assert_allclose(ours.force, theirs.force, rtol=0, atol=1e-6)
        np.testing.assert_allclose(ours.displacement, theirs.displacement, rtol=0, atol=1e-7)
    # A limited clamp reaches its position at another point of the step, so on its way down the path differs.
    ways = [found.resolutions[stage].trace.work for found in (limited, plain) for stage in ("clamp", "release")]
    np.testing.assert_allclose(ways[1], ways[3], rtol=1e-3)
    if press:
        np.testing.assert_allclose(ways[0], ways[2], rtol=1e-3)
    assert max(work.max() for work in ways[:2]) > 1e-3  # there is something to compare


def test_an_overpowered_clamp_yields_and_returns():
    """Another force pushes b's face up against it: the clamp holds as far as its limit goes, whenever that comes."""
    lift = at_face("b", (0, 0, 1), name="L", force=8.0, stage="lift")
    stages = stage_list(
        "locate",
        "clamp",
        "clamp lift",
        {"kind": "release", "name": "let go", "keep": ["C", *(item["name"] for item in six("a") + six("b"))]},
        "release",
        "measure",
    )
    stages[3]["name"] = "back"
    found = plates(clamps=[closing(0.2, 14.0), lift], stages=stages).evaluate({})
    takes = STIFFNESS * 0.2
    clamp, lifted, back = (found.resolutions[name] for name in ("clamp", "lift", "back"))
    np.testing.assert_allclose(clamp.pushed[0], [takes], rtol=1e-9)
    np.testing.assert_allclose(lifted.pushed[0], [14.0], rtol=1e-9)
    np.testing.assert_allclose(lifted.left[0], [0.2 - (14 - 8) / STIFFNESS], rtol=1e-9)
    np.testing.assert_allclose(lifted.needed[0], [takes + 8], rtol=1e-9)
    np.testing.assert_allclose(back.pushed[0], [takes], rtol=1e-9)
    assert back.left[0, 0] == 0.0 and not found.built[0]


def test_a_part_beyond_the_clamp_position_is_pulled_back():
    """As with a clamp without a limit: the limit applies to pushing and not to the stop."""
    push = at_face("b", (0, 0, -1), name="P", force=10.0)
    model = plates(clamps=[push, closing(0.1, 4.0)])
    found = model.evaluate({})
    closed = found.resolutions["clamp"]
    assert found.built[0] and closed.left[0, 0] == 0.0
    assert closed.pushed[0, 0] == pytest.approx(STIFFNESS * 0.1 - 10.0, rel=1e-9)
    assert closed.displacement[0, 0, 0] == pytest.approx(GAP - 0.1, rel=1e-9)


def test_every_sample_is_judged_and_none_is_dropped():
    """The clamp's position varies: those that it cannot reach are not built, and measured all the same."""
    one = {"name": "setting", "kind": "clamp", "target": "C", "sigma": 0.1}
    model = plates(clamps=[closing(0.2, 12.0)], deviations=[one])
    settings = np.linspace(-0.1, 0.2, 13)[:, None]
    found = model.evaluate(settings)
    needed = STIFFNESS * (0.2 + settings[:, 0]) + STIFFNESS * np.maximum(0, settings[:, 0] - 0.1)
    closed = found.resolutions["clamp"]
    np.testing.assert_allclose(closed.needed[:, 0], np.where(needed > 12.0, needed, np.nan), rtol=1e-9)
    np.testing.assert_array_equal(found.built, needed <= 12.0)
    assert 0 < found.built.sum() < len(settings)
    np.testing.assert_allclose(closed.pushed[:, 0], np.minimum(needed, 12.0), rtol=1e-9)
    assert not found.failed.any() and np.isfinite(found.measurements).all()
    alone = model.evaluate(settings[-1])
    np.testing.assert_array_equal(alone.resolutions["clamp"].needed[0], closed.needed[-1])


def test_results_count_unbuilt_samples_and_give_the_force_needed(tmp_path):
    one = {"name": "setting", "kind": "clamp", "target": "C", "sigma": 0.05}
    model = plates(clamps=[closing(0.2, 12.0)], deviations=[one])
    sample_into(tmp_path, model, ["coulomb"], 40, 1)
    outcome = read_outcome(tmp_path)
    found = model.evaluate(outcome.deviation("coulomb", "setting")[:, None])
    short = np.flatnonzero(~found.built)
    assert 0 < len(short) < 40
    assert outcome.unbuilt == {"coulomb": short.tolist()} and outcome.failed == {"coulomb": []}
    law = outcome.summary()["laws"]["coulomb"]
    assert law["not_built"] == len(short) and law["samples"] == 40  # none is dropped
    (row,) = law["limits"]
    closed = found.resolutions["clamp"]
    assert (row["stage"], row["name"], row["limit"], row["short"]) == ("clamp", "C", 12.0, len(short))
    assert row["share_short"] == pytest.approx(len(short) / 40)
    assert row["mean_pushed"] == pytest.approx(closed.pushed.mean(), rel=1e-9)
    assert row["max_left"] == pytest.approx(closed.left.max(), rel=1e-9)
    assert row["max_needed"] == pytest.approx(np.nanmax(closed.needed), rel=1e-9)
    np.testing.assert_allclose(outcome.measured("coulomb", "M"), found.measurements[:, 0], atol=1e-12)


WELDED = stage_list("locate", "weld", "release", "measure")


def weld(**keys):
    return {"name": "W", "parts": ["a", "b"], "point": [5, 5, 0], "moment": False} | keys


@pytest.mark.parametrize("law", ["coulomb", "frictionless"])
@pytest.mark.parametrize("gun, left", [(1.5 * NEEDED / 4, 0.0), (0.5 * NEEDED / 4, 0.5 * GAP)])
def test_a_gun_presses_both_faces_until_they_touch_and_opens_after_the_weld(gun, left, law):
    """It pulls both faces together by F/k each: they meet if F > k g/2. The weld keeps what is left; springs balance.

    The gun alone moves nothing but the faces, so that what it leaves is carried by the weld when it opens.
    """
    found = plates(welds=[weld(gun=gun)], stages=WELDED).evaluate({}, law)
    made = found.resolutions["weld"]
    assert made.pushed[0, 0] == gun
    assert made.left[0, 0] == pytest.approx(left, abs=1e-9)
    assert found.built[0] == (left == 0)
    if left:
        assert made.needed[0, 0] == pytest.approx(STIFFNESS * GAP / 2, rel=1e-9)
    assert made.displacement[0, 0, 0] == pytest.approx(left, abs=1e-9)
    down = -(GAP - left) / 2  # of b's face, for good
    assert found.measurements[0, 0] == pytest.approx(down, rel=1e-9)


def test_excess_gun_force_has_no_effect():
    """The force of a gun is no variable of optimisation: the faces stop where they touch."""
    deviations = [{"name": "D", "kind": "locator", "target": "bl1", "mean": 0.0, "sigma": 0.05}]
    found = [
        plates(welds=[weld(gun=gun)], stages=WELDED, deviations=deviations).evaluate([[0.0], [0.1]], "coulomb")
        for gun in (1.5 * NEEDED / 4, 15 * NEEDED / 4)
    ]
    assert all(one.built.all() for one in found) and np.ptp(found[0].measurements) > 1e-3
    np.testing.assert_allclose(found[0].measurements, found[1].measurements, rtol=0, atol=1e-12)


def test_guns_press_only_during_their_weld():
    """The second gun finds the gap closed; without a weld, the first leaves nothing behind."""
    two = [weld(gun=100.0), weld(name="V", gun=3.0)]
    found = plates(welds=two, stages=[WELDED[0], {"kind": "weld", "sequence": True}, *WELDED[2:]]).evaluate({})
    made = found.resolutions["weld"]
    np.testing.assert_array_equal(made.reached[0], [True, True])
    assert found.built[0]
    assert found.measurements[0, 0] == pytest.approx(-GAP / 2, rel=1e-9)


def test_invalid_limits_and_guns_are_refused():
    for clamp, words in (
        (at_face("b", name="C", force=3.0, limit=4.0), "limit needs a stroke"),
        (at_face("b", name="C", stroke=0.1, limit=0.0), "limit"),
        (at_face("b", name="C", stroke=0.1, limit=-3.0), "limit"),
    ):
        with pytest.raises(ValueError, match=words):
            plates(clamps=[clamp])
    with pytest.raises(ValueError, match="remove one of them"):
        plates(welds=[weld(gun=100.0, close=True)], stages=WELDED)
    at_once = [WELDED[0], {"kind": "weld", "path": "one-step"}, *WELDED[2:]]
    with pytest.raises(ValueError, match=r"stages\[1\]\.path \(weld\): the gun of weld 'W' presses before its weld"):
        plates(welds=[weld(gun=100.0)], stages=at_once)
    assert isinstance(plates().scene, mic.Scene)


def test_limits_and_guns_are_described_in_words():
    model = plates(
        clamps=[closing(0.5, 300.0)],
        welds=[weld(gun=100.0), weld(name="V", gun=100.0), weld(name="U", gun=50.0)],
        stages=[WELDED[0], {"kind": "clamp"}, *WELDED[1:]],
    )
    plans = {plan.name: plan for plan in plan_stages(model.scene, model.weld_size)}
    assert sentences(model.scene, plans["clamp"])[-1] == "clamp C closes to 0.5 mm, with at most 300 N"
    assert sentences(model.scene, plans["weld"]) == [
        "guns W and V press (100 N each), gun U presses (50 N)",
        "welds W, V and U join the sheets as they stand, guns W, V and U open",
    ]
    assert sentences(model.scene, plans["release"])[0] == "clamp C opens"
    assert plans["weld"].limit_names(model.scene, model.weld_size) == ["W", "V", "U", "C"]


@pytest.mark.parametrize("limit", [10.0, 100.0])
@pytest.mark.parametrize("stiffness", [None, 40.0])
def test_forces_and_motions_balance_and_reproduce_the_measurements(limit, stiffness):
    """Forces f on the functionals and rigid motions q at the end: Gᵀ f = 0, and H f + G q is what the rows read."""
    soft = [item | ({} if stiffness is None else {"stiffness": stiffness}) for item in six("b")]
    model = plates(
        clamps=[closing(0.5, limit)],
        stages=stage_list("locate", "clamp", "measure"),
        locators=[*six("a"), *soft],
    )
    found = model.evaluate({})
    force, motion = found.functional_force, found.motion
    assert np.abs(force).max() > 5.0
    np.testing.assert_allclose(model.compliance.rigid(csr_matrix(force)), 0.0, atol=1e-9)
    reading = model.compliance.displace(force) + model.compliance.carry(motion)
    np.testing.assert_allclose(reading @ model.rows["measurement"].T, found.measurements, atol=1e-9)
    assert found.measurements[0, 0] < -0.1


def test_the_force_needed_depends_on_the_friction_of_the_sample():
    """The clamp drags the face over the other, pressed on by a second one: what it takes grows with friction, once."""
    keys = {
        "clamps": [at_face("b", (0, 0, -1), name="P", force=60.0), closing_along(0.5, 5.0)],
        "stages": stage_list("locate", {"kind": "clamp", "order": [["P"], ["C"]]}, "measure"),
    }
    rough = [{"name": "mu", "kind": "friction", "target": "Z", "sigma": 0.1}]
    varied = plates(gap=0.0, friction=0.2, deviations=rough, **keys)
    needed = [
        plates(gap=0.0, friction=0.2 + more, **keys).evaluate({}).resolutions["clamp"].needed[0] for more in (0.0, 0.1)
    ]
    assert abs(needed[0] - needed[1]).max() > 1.0
    for more, expected in zip((0.0, 0.1), needed):
        found = varied.evaluate({"mu": more}).resolutions["clamp"].needed[0]
        np.testing.assert_allclose(found, expected, rtol=1e-9)
