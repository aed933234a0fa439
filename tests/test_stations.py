"""An assembly that changes its fixture, for inspection or in a second station, by hand."""

import numpy as np
import pytest
from support.springs import FAR, STIFFNESS, at_face, six, spring_model, stage_list, two_plates

import mic
from mic.process.description import opening, sentences
from mic.process.plan import plan_stages

GAP = 0.3  # mm, between a's face and b's
WELD = {"name": "W", "parts": ["a", "b"], "point": [5, 5, 0], "close": True}


def named(locators, name):
    return [item | {"name": f"{name}{i}"} for i, item in enumerate(locators)]


ON_B = named(six("b", "measure"), "m")  #: an inspection on b's six


def joined(inspection=(), keep="a", measured="ab", **change):
    """a and b, whose weld closes the gap between their faces; released, they are read on the inspection's locators."""
    keys = {
        "locators": [*six("a"), *six("b"), *inspection],
        "welds": [WELD],
        "measurements": [at_face(part, name=part, lower=-1, upper=1) for part in measured],
        "stages": stage_list("locate", "weld", release_to(keep), "measure"),
    }
    return two_plates(GAP, **keys | change)


def release_to(part):
    """A release after which the six locators of a part alone hold the assembly."""
    return {"kind": "release", "keep": [f"{part}l{i}" for i in range(6)]}


def test_a_released_part_moves_by_the_gap():
    """The faces meet half way; released, both springs relax, and the part that nothing holds comes over by g."""
    np.testing.assert_allclose(joined().evaluate({}).measurements[0], [0.0, -GAP], atol=1e-12)
    np.testing.assert_allclose(joined(keep="b").evaluate({}).measurements[0], [GAP, 0.0], atol=1e-12)


@pytest.mark.parametrize("law", ["coulomb", "frictionless"])
@pytest.mark.parametrize("keep", ["a", "b"])
def test_another_inspection_fixture_adds_a_rigid_motion(keep, law):
    """On b's six, b is at nominal and a stands g above. On two supports of a and one of b, the assembly tilts.

    At y = 0 the supports hold a at nominal; b, g below a, must come up to nominal at y = 10: by g y/10, g/2 at the
    faces. Where it was released before makes no difference.
    """
    np.testing.assert_allclose(joined(ON_B, keep).evaluate({}, law).measurements[0], [GAP, 0.0], atol=1e-12)
    tilted = [item | {"part": "b" if item["point"] == [0, 10, 0] else "a"} for item in ON_B]
    found = joined(tilted, keep).evaluate({}, law)
    np.testing.assert_allclose(found.measurements[0], [GAP / 2, -GAP / 2], atol=1e-12)
    assert not found.failed.any()
    if "measure" in found.resolutions:  # set down without strain
        np.testing.assert_allclose(found.resolutions["measure"].reaction[0][:6], 0.0, atol=1e-9)


def test_an_inspection_locator_can_deviate():
    moved = {"name": "D", "kind": "locator", "target": "m2", "sigma": 0.1}
    model = joined(ON_B, deviations=[moved])
    tilt = model.evaluate({"D": 0.1}).measurements[0] - model.evaluate({"D": 0.0}).measurements[0]
    np.testing.assert_allclose(tilt, [0.05, 0.05], atol=1e-12)  # 0.1 mm at y = 10, half of it at y = 5


def test_more_than_six_inspection_locators_strain_the_assembly():
    """a's three supports and b's three: the faces' springs take the gap again, half each."""
    on_both = [*six("a"), *(item for item in six("b") if item["direction"] == [0, 0, 1])]
    on_both = [item | {"stage": "measure"} for item in named(on_both, "m")]
    np.testing.assert_allclose(joined(on_both).evaluate({}).measurements[0], [GAP / 2, -GAP / 2], atol=1e-12)


def test_the_inspection_is_described_and_has_its_own_locators():
    model = joined(ON_B)
    plan = plan_stages(model.scene, model.weld_size)[-1]
    assert sentences(model.scene, plan) == [
        "all locators and clamps open, and the assembly is placed on m0, m1, m2, m3, m4 and m5; "
        "2 key characteristics are measured"
    ]
    assert opening(plan, contacts=True) == "contact active, load path followed"
    assert {row for row in plan.bilateral if row[0] == "locator"} == {("locator", 12 + i) for i in range(6)}


# ------------------------------------------------------------------------------- a third part in a second station

STEP = 0.2  # mm, between a's face and c's as drawn


THREE = [{"name": name, "mesh": f"{name}.stl", "thickness": 1.0} for name in "abc"]
ADDED = [*six("a"), *six("b"), *six("c", "second")]  #: c comes to a and b where they are


def zone(name, parts, **keys):
    return {"name": name, "parts": list(parts), "pairs": 1} | keys


def plans_of(model):
    return {plan.name: plan for plan in plan_stages(model.scene, model.weld_size)}


def stations(step=STEP, stages=None, clamps=(), fixtures=(), zones=(), gaps=(), friction=0.0, **change):
    """a and b are joined in the first station; c comes in the second, where they stand on b's six."""
    zones = [zone("Z", "ab", friction=friction), zone("Y", "ac", friction=friction), *zones]
    keys = {
        "parts": THREE,
        "locators": [*six("a"), *six("b"), *named(six("b", "second"), "s"), *six("c", "second")],
        "clamps": list(clamps),
        "welds": [WELD],
        "zones": zones,
        "fixtures": list(fixtures),
        "measurements": [at_face(part, name=part, lower=-1, upper=1) for part in "abc"],
        "stages": stages or stage_list("locate", "weld", release_to("a"), "locate second", "clamp", "measure"),
    }
    return spring_model([GAP, step, *gaps], [GAP], **keys | change)


def push(force, part="c"):
    return at_face(part, (0, 0, -1), name="P", force=force)


@pytest.mark.parametrize("law", ["coulomb", "frictionless"])
@pytest.mark.parametrize("step", [0.5, 0.2])
def test_the_result_of_the_first_station_enters_the_second(step, law):
    """Joined, a stands g above its place: the step to c is less by g, or c overlaps with it and settles.

    The weld carries a; its force b's spring carries alone, and c's spring its own: f = k (g − step)/2. A push P on
    c's face brings k w = P before it touches, then both springs yield: f = (P − k (step − g))/2.
    """
    left = step - GAP
    for force in (0.0, 15.0):
        found = stations(step, clamps=[push(force)]).evaluate({}, law)
        closed = found.resolutions["clamp"]
        f = max(0.0, (force - STIFFNESS * left) / 2)
        assert closed.force[0, 1, 0] == pytest.approx(f, rel=1e-9, abs=1e-9)
        assert closed.displacement[0, 1, 0] == pytest.approx(max(0.0, left - force / STIFFNESS), abs=1e-9)
        b, c = -f / STIFFNESS, (f - force) / STIFFNESS
        np.testing.assert_allclose(found.measurements[0], [GAP + b, b, c], atol=1e-9)
        assert not found.failed.any()


def test_a_part_of_a_later_station_touches_nothing_before():
    """Without a station of its own c would lie within a in the first one, and hold it."""
    found = stations(-0.4, clamps=[push(0.0)]).evaluate({}, "coulomb")
    assert found.resolutions["weld"].force[0, 1, 0] == 0.0
    assert found.resolutions["release"].force[0, 1, 0] == 0.0
    assert found.resolutions["second"].force[0, 1, 0] == 0.0  # set down, it touches nothing until something closes
    assert found.resolutions["clamp"].force[0, 1, 0] == pytest.approx(STIFFNESS * 0.7 / 2, rel=1e-9)


def test_welds_remain_and_reactions_vanish_in_the_second_station():
    """Only joints pass to the second station, with or without a release before it."""
    three = stage_list("locate", "weld", "locate second", "clamp")
    direct = stations(stages=[*three, {"kind": "measure"}], clamps=[push(15.0)]).evaluate({})
    released = stations(clamps=[push(15.0)]).evaluate({})
    np.testing.assert_allclose(direct.measurements, released.measurements, atol=1e-12)
    reaction = direct.resolutions["second"].reaction[0]
    np.testing.assert_allclose(reaction, 0.0, atol=1e-9)


def test_adding_a_part_to_a_station_does_not_move_the_others():
    """Only c has locators in the second stage: a and b stay clamped, and c finds a's face where they hold it."""
    hold = at_face("b", (0, 0, -1), name="H", force=30.0, stage="hold")
    stages = stage_list("locate", "clamp hold", "locate second", "clamp", "measure")
    model = stations(-0.1, stages, [hold, push(0.0)], locators=ADDED, welds=[])
    found = model.evaluate({})
    pressed = (30.0 - STIFFNESS * GAP) / 2  # b's face on a's
    assert found.resolutions["hold"].force[0, 0, 0] == pytest.approx(pressed, rel=1e-9)
    assert found.resolutions["hold"].force[0, 1, 0] == 0.0
    # c's face, 0.1 mm within a's as drawn, meets it 0.15 mm lower: the way is free until H lets go.
    assert found.resolutions["clamp"].force[0, 1, 0] == 0.0
    plans = plans_of(model)
    assert sentences(model.scene, plans["second"]) == ["c is placed on cs0, cs1, cs2, cs3, cs4 and cs5"]
    assert plans["second"].steps[0].released == () and plans["second"].steps[0].loads == (0,)
    assert "second" not in found.resolutions


def test_overlap_in_a_later_station_settles_against_existing_contacts():
    """c comes 0.35 mm within a's face as drawn, 0.2 mm as b presses it down, and settles while it is dragged.

    With f on a from b and N from c: f + 2 N = 0.35 k (c meets a), 2 f + N = P − g k (b stays on a). It touches from the
    start, N and the drag D grow together, and c slips all the way under load. b, which sticks to a by what the first
    drag left there, goes with a, by μ N/4k: the slip is D/2k − 3/2 μ N/2k. If memory were lost, b would slip.
    """
    hold = at_face("b", (0, 0, -1), name="H", force=30.0, stage="hold")
    stick = at_face("b", (1, 0, 0), name="T", force=1.0, stage="hold")
    drag = at_face("c", (1, 0, 0), name="D", force=5.0)
    stages = stage_list(
        "locate", "clamp hold", {"kind": "locate", "name": "second", "settle": False}, "clamp", "measure"
    )
    rough = [zone("Z", "ab", friction=0.5), zone("Y", "ac", friction=0.2)]
    f, N = np.linalg.solve([[1, 2], [2, 1]], [0.35 * STIFFNESS, 30.0 - STIFFNESS * GAP])
    slip = (5.0 - 1.5 * 0.2 * N) / (2 * STIFFNESS)
    clamps = [hold, stick, drag]
    model = spring_model([GAP, -0.35], parts=THREE, locators=ADDED, clamps=clamps, zones=rough, stages=stages)
    closed = model.evaluate({}).resolutions["clamp"]
    np.testing.assert_allclose(closed.force[0, :, 0], [f, N], rtol=1e-9)
    np.testing.assert_allclose(closed.force[0, 1, 1], -0.2 * N, rtol=1e-9)
    np.testing.assert_allclose(closed.force[0, 0, 1], -0.5 + 0.2 * N / 2, rtol=1e-9)
    np.testing.assert_allclose(closed.trace.slip[0], [[0.0, 0.0], [slip, 0.0]], rtol=1e-3, atol=1e-9)


def test_a_fixture_acts_only_in_its_station():
    """A pad 0.1 mm below b's face, z = 0 in the first station: pressed by P there, gone in the second."""
    pads = [{"name": name, "point": [5, 5, -1], "normal": [0, 0, 1], "radius": 1.0} for name in ("one", "two")]
    pads[1]["stage"] = "second"
    zones = [zone(pad["name"], [pad["name"], "b"]) for pad in pads]
    down = [at_face("b", (0, 0, -1), name=name, force=15.0, stage=name) for name in ("first", "again")]
    stages = stage_list("locate", "clamp first", "weld", release_to("a"), "locate second", "clamp again", "measure")
    found = stations(5.0, stages, down, pads, zones, [0.1, 0.2]).evaluate({})
    first, again = found.resolutions["first"].force[0, :, 0], found.resolutions["again"].force[0, :, 0]
    np.testing.assert_allclose(first, [0, 0, 15.0 - 0.1 * STIFFNESS, 0], atol=1e-9)
    np.testing.assert_allclose(again, [0, 0, 0, 15.0 - 0.2 * STIFFNESS], atol=1e-9)


def test_slip_persists_between_stations():
    """A contact that slipped under a clamp in the first station keeps its position in the next."""
    drag = at_face("b", (1, 0, 0), name="D", force=3.0, stage="slide")
    press = at_face("b", (0, 0, -1), name="P", force=60.0, stage="slide")
    stages = stage_list(
        "locate",
        {"kind": "clamp", "name": "slide", "order": [["P"], ["D"]]},
        "weld",
        release_to("a"),
        "locate second",
        "measure",
    )
    found = stations(5.0, stages, [press, drag], friction=0.02, welds=[WELD | {"close": False}]).evaluate({})
    slid, moved = found.resolutions["slide"], found.resolutions["second"]
    assert slid.trace.slip[0, 0, 0] > 1e-3
    np.testing.assert_allclose(moved.trace.slip[0, 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(moved.displacement[0, 0, 1:], 0.0, atol=1e-9)


def test_stations_are_described_in_words():
    model = stations(clamps=[push(1.0)])
    plans = plans_of(model)
    assert sentences(model.scene, plans["locate"]) == [
        "a is placed on al0, al1, al2, al3, al4 and al5; b is placed on bl0, bl1, bl2, bl3, bl4 and bl5"
    ]
    assert sentences(model.scene, plans["second"]) == [
        "all locators and clamps open, and the assembly is placed on s0, s1, s2, s3, s4 and s5; "
        "c is placed on cs0, cs1, cs2, cs3, cs4 and cs5"
    ]
    assert [step.away for step in plans["second"].steps] == [(1,)]
    assert [(step.settles, step.away) for step in plans["clamp"].steps] == [(True, ()), (False, ())]


@pytest.mark.parametrize(
    "change, words",
    [
        ({"locators": [*six("a"), *six("b"), *six("c")]}, r"stages\[3\] \(second\): no locator names it"),
        ({"clamps": [push(1.0) | {"stage": "early"}]}, r"clamps\[0\].stage: part 'c' is placed in 'second', after"),
        ({"welds": [WELD | {"parts": ["a", "c"]}]}, r"welds\[0\].stage: part 'c' is placed in 'second', after"),
        ({"locators": [*six("a"), *six("b"), *six("c", "second")[:5]]}, r"parts\[2\] \(c\): its 5 locators .* hold 5"),
        (
            {"fixtures": [{"name": "f", "point": FAR[0], "normal": [0, 0, 1], "radius": 1.0, "stage": "weld"}]},
            r"fixtures\[0\].stage: no stage of kind locate is called 'weld'",
        ),
    ],
)
def test_using_a_part_before_it_is_placed_is_refused(change, words):
    stages = stage_list("locate", "clamp early", "weld", "locate second", "measure")
    with pytest.raises(ValueError, match=words):
        stations(stages=stages, **change)


@pytest.mark.parametrize("number, key", [(0, {"increments": 3}), (-1, {"path": "followed"})])
def test_a_path_in_a_stage_without_motion_is_refused(number, key):
    stages = stage_list("locate", "weld", "release", "measure")
    stages[number] |= key
    with pytest.raises(ValueError, match=rf"stages\[{number % 4}\].{next(iter(key))}.*: nothing moves in this stage"):
        joined(stages=stages)


# ------------------------------------------------------------------------------------- soft locators, by hand


def resting(stiffness, press, gap=0.1, release=False):
    """b on soft supports along z above a; P presses b's face. The supports at (10, 0) and (0, 10) carry half each."""
    soft = [item | ({"stiffness": stiffness} if item["direction"] == [0, 0, 1] else {}) for item in six("b")]
    return two_plates(
        gap,
        friction=0.0,
        locators=[*six("a"), *soft],
        clamps=[at_face("b", (0, 0, -1), name="P", force=press)],
        welds=[WELD | {"close": False}],
        measurements=[at_face(part, name=part, lower=-1, upper=1) for part in "ab"],
        stages=stage_list("locate", "clamp", "weld", *[release_to("a")] * release, "measure"),
    )


@pytest.mark.parametrize("law", ["coulomb", "frictionless"])
@pytest.mark.parametrize("stiffness", [1000.0, 1e-3])
def test_a_soft_locator_shares_its_load_with_contact(stiffness, law):
    """b's face comes down by P c, c = 1/k + 1/2s, until it touches; then N = (P c − g)/(c + 1/k), all of P as s → 0."""
    c = 1 / STIFFNESS + 1 / (2 * stiffness)
    for press in (0.02 * GAP / c, 20.0):
        found = resting(stiffness, press).evaluate({}, law)
        N = max(0.0, (press * c - 0.1) / (c + 1 / STIFFNESS))
        closed = found.resolutions["clamp"]
        assert closed.force[0, 0, 0] == pytest.approx(N, rel=1e-7, abs=1e-9)
        np.testing.assert_allclose(found.measurements[0], [-N / STIFFNESS, -(press - N) * c], rtol=1e-6, atol=1e-9)
        supports = closed.reaction[0, [7, 8]]
        np.testing.assert_allclose(supports, (press - N) / 2, rtol=1e-6, atol=1e-9)
    if stiffness < 1:
        assert N == pytest.approx(press, rel=1e-4)  # it rests on a, and on nothing else


def test_overlap_lifts_a_part_on_soft_locators():
    """Set down 0.1 mm within a, on supports of 10⁻³ N/mm, b comes to rest on a's face without a force to speak of."""
    found = resting(1e-3, 0.0, gap=-0.1).evaluate({})
    assert found.resolutions["clamp"].force[0, 0, 0] == pytest.approx(0.1 * 2e-3, rel=1e-3)
    np.testing.assert_allclose(found.measurements[0], [0.0, 0.1], atol=1e-4)


def test_soft_locators_can_open_once_welded():
    """Joined where it rested, b keeps its place on a; what pressed it springs back."""
    found = resting(1.0, 20.0, release=True).evaluate({})
    c = 1 / STIFFNESS + 0.5
    N = (20.0 * c - 0.1) / (c + 1 / STIFFNESS)
    np.testing.assert_allclose(found.resolutions["clamp"].force[0, 0, 0], N, rtol=1e-9)
    np.testing.assert_allclose(found.measurements[0], [0.0, -0.1], atol=1e-9)
    assert not found.failed.any()


def test_a_part_with_free_motions_is_refused_with_the_remedy():
    few = [item for item in six("b") if item["direction"] != [0, 0, 1]]
    with pytest.raises(
        ValueError, match=r"parts\[1\] \(b\): .* hold 3 of its 6 .*free: along z, about x, about y.*rests = true"
    ):
        joined(stages=stage_list("locate", "measure"), locators=[*six("a"), *few], welds=[])


def test_unjoined_parts_cannot_change_fixture_together():
    model = stations(welds=[], stages=stage_list("locate", "locate second", "measure"))
    with pytest.raises(mic.SceneError, match=r"stages \(second\): 6 rigid-body motions are free once .* part 'a'"):
        plan_stages(model.scene, model.weld_size)
