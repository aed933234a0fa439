"""Parts that rest on others by contact alone: statics by hand, and parts that are not held."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from support.feet import ALONG_X, AT, FEET, PAIR, UP, WIDE, gauge, plates, push, standing, table, zone
from support.springs import six, stage_list

import mic
from mic.contact.states import OPEN, SLIP, STICK
from mic.model.rest_rows import separating_motion
from mic.process.description import sentences
from mic.process.plan import plan_assembly, plan_stages
from mic.process.resting_parts import Rest
from mic.statistics.draw import draw

PRESS = push(100)
SHARE = np.array([1 - 0.3 - 1 / 3, 0.3, 1 / 3])  # of the feet, in a force at AT
CARRIED = 100 * SHARE


def clamped(found, stage="clamp"):
    """Normal forces of the first sample, which must not fail."""
    assert not found.failed[0]
    return found.resolutions[stage].force[0, :, 0]


def force_source(*targets):
    return [{"name": "F", "kind": "clamp", "target": list(targets), "sigma": 1.0}]


def refused(model, words):
    with pytest.raises(mic.SceneError, match=words):
        plan_assembly(model)


@pytest.mark.parametrize("path", [{}, {"increments": 3}, {"path": "one-step"}])
def test_feet_share_an_off_centre_clamp_by_the_lever_rule(path):
    found = table([PRESS], kinds=("locate", {"kind": "clamp"} | path, "measure")).evaluate({})
    np.testing.assert_allclose(clamped(found), CARRIED, rtol=1e-8)
    np.testing.assert_allclose(found.measurements[0], -PAIR * CARRIED, rtol=1e-8)
    # The locators of a carry its load: their three supports hold 100 N in all.
    np.testing.assert_allclose(found.resolutions["clamp"].reaction[0][:3].sum(), 100.0, rtol=1e-9)
    # The rigid motions of the outcome, from which fields are drawn: b sinks by the first foot.
    np.testing.assert_allclose(found.motion[0, 8], -PAIR * CARRIED[0], rtol=1e-8)
    if "increments" in path:  # for settling and for closing
        assert found.resolutions["clamp"].trace.steps[0] == 2 * 3


@pytest.mark.parametrize("law", ["coulomb", "frictionless", "associated"])
def test_pins_hold_a_part_in_plane_and_contact_along_its_normal(law):
    pins = [item | {"part": "b", "name": f"p{i}"} for i, item in enumerate(six("b", far=WIDE)[3:])]
    found = table([PRESS], locators=six("a", far=WIDE) + pins).evaluate({}, law)
    np.testing.assert_allclose(clamped(found), CARRIED, rtol=1e-8)


def test_a_sample_fails_beyond_the_friction_limit():
    """Feet that carry N hold μ N together; each yields by half of `PAIR` along its tangents."""
    clamps = [PRESS, push(0, AT, ALONG_X, "D")]
    model = table(clamps, deviations=force_source("D"), measurements=[gauge("b", (0, 0, 0), ALONG_X)])
    plan_assembly(model)
    forces = np.array([[12.0], [-15.0], [25.0], [19.0]])
    found = model.evaluate(forces)
    np.testing.assert_array_equal(found.failed, [False, False, True, False])
    resolution = found.resolutions["clamp"]
    assert resolution.status[2] == "not held: part b is pushed off along x"
    # t1 of the frame of a foot is x. Below the limit of every foot they share by stiffness, alike.
    np.testing.assert_allclose(resolution.force[:2, :, 1], [[-4.0] * 3, [5.0] * 3], rtol=1e-7)
    np.testing.assert_allclose(found.measurements[:2, 0], [4 * PAIR / 2, -5 * PAIR / 2], rtol=1e-7)
    # 19 N of 20 N: the foot that carries 30 N slips at 6 N, and all three together hold it.
    carried = resolution.force[3]
    np.testing.assert_allclose(carried.sum(axis=0), [100.0, -19.0, 0.0], atol=1e-7)
    assert (np.hypot(*carried[:, 1:].T) <= 0.2 * carried[:, 0] + 1e-7).all()
    # A sample does not depend on the others, nor on one that fails beside it.
    alone = model.evaluate(forces[3:])
    np.testing.assert_array_equal(alone.measurements[0], found.measurements[3])


ROOT = np.sqrt(0.5)
#: Of a groove with sides of 45°, a ridge and its four places on each side.
SIDES = [("Z", (side * x, y, abs(x)), (-side * ROOT, 0, ROOT)) for side in (-1, 1) for x in (10, 20) for y in (0, 80)]


def groove(friction=0.0, gap=0.0):
    """b's ridge in a's groove, under 100 N, and a stop along it."""
    return standing(
        SIDES,
        gap=gap,
        parts=plates("ab", "b"),
        locators=[*six("a", far=WIDE), {"name": "stop", "part": "b", "point": [0, 0, 0], "direction": [0, 1, 0]}],
        clamps=[push(100, (0, 40, 0))],
        zones=[zone("a", "b", friction=friction)],
        measurements=[gauge("b", (0, 40, 0)), gauge("b", (0, 40, 0), ALONG_X, "X")],
        stages=stage_list("locate", "clamp", "measure"),
    )


def test_the_sides_of_a_groove_carry_the_wedge_forces():
    """100 N down on the ridge, N on each side with 2 N cos 45° = 100; no friction."""
    model = groove()
    plan_assembly(model)
    found = model.evaluate({}, "frictionless")
    force = clamped(found).reshape(2, 4)
    np.testing.assert_allclose(force.sum(axis=1), 100 * ROOT, rtol=1e-8)
    np.testing.assert_allclose(force, 25 * ROOT, rtol=1e-8)
    # Every side yields by 25 ROOT PAIR along its normal, so that b sinks by 1/ROOT of that.
    np.testing.assert_allclose(found.measurements[0], [-25 * PAIR, 0.0], atol=1e-10)


def test_placing_a_part_causes_no_friction():
    """A side that stands out by 0.1 mm shifts the ridge by 0.1 mm cos 45° each way, and no more."""
    out = np.where(np.arange(len(SIDES)) < 4, -0.1, 0.0)  # the sides of one half
    middle, aside = (groove(0.2, gap).evaluate({}) for gap in (0.0, out))
    assert not middle.failed.any() and not aside.failed.any()
    np.testing.assert_allclose(aside.resolutions["clamp"].force, middle.resolutions["clamp"].force, atol=1e-5)
    np.testing.assert_allclose(aside.measurements - middle.measurements, [[0.1 * ROOT, 0.1 * ROOT]], atol=1e-6)


def test_each_part_of_a_stack_carries_those_above():
    at = (20, 20, 0)
    model = standing(
        [(f"Z{pair}", foot, UP) for pair in ("ab", "bc") for foot in FEET],
        parts=plates("abc", "b", "c"),
        locators=six("a", far=WIDE),
        clamps=[push(90, at, part="c"), push(30, at, name="D")],
        zones=[zone(*pair, name=f"Z{pair}") for pair in ("ab", "bc")],
        measurements=[gauge("c", at), gauge("b", at, name="N")],
        stages=stage_list("locate", "clamp", "measure"),
    )
    plan_assembly(model)
    found = model.evaluate({})
    share = np.array([1 - 0.2 - 1 / 3, 0.2, 1 / 3])
    np.testing.assert_allclose(clamped(found), [*(120 * share), *(90 * share)], rtol=1e-7)
    sunk = -PAIR * 120 * share @ share
    np.testing.assert_allclose(found.measurements[0], [sunk - PAIR * 90 * share @ share, sunk], rtol=1e-7)


def test_an_overlapping_part_is_placed_on_top_and_then_pressed():
    """a's feet stand 0.3, 0.1 and 0.2 mm high: b lies on them, tilted, and sinks from there."""
    high = np.array([0.3, 0.1, 0.2])
    found = table([PRESS], gap=-high).evaluate({})
    np.testing.assert_allclose(clamped(found), CARRIED, rtol=1e-7)
    np.testing.assert_allclose(found.measurements[0], high - PAIR * CARRIED, atol=1e-8)


def test_a_shape_deviation_is_measured_from_the_resting_position():
    """b's first foot is longer by d and the rest follows: it stands d higher there, whatever the force."""
    deviation = {"name": "D", "kind": "force", "part": "b", "point": [0, 0, 0], "direction": [0, 0, 1], "sigma": 1.0}
    longer = lambda part, at: np.array([0, 0, -1.0 * (part == "b" and not at.any())])
    model = table([PRESS], shape=longer, deviations=[deviation])
    nominal, moved = model.evaluate({}), model.evaluate({"D": 0.2})
    np.testing.assert_allclose(moved.resolutions["clamp"].force, nominal.resolutions["clamp"].force, atol=1e-6)
    # The shape moves the point at the foot by −d, and b stands d higher there: it reads as before.
    np.testing.assert_allclose(moved.measurements, nominal.measurements, atol=1e-8)


def test_welds_hold_a_resting_part_when_the_clamp_opens():
    """Three welds at the feet keep what they find; with the clamp gone, springs press on against them."""
    welds = [{"name": f"W{i}", "parts": ["a", "b"], "point": list(foot)} for i, foot in enumerate(FEET)]
    kinds = ("locate", "clamp", "weld", "release", "measure")
    model = table([PRESS], kinds=kinds, welds=welds)
    plans = plan_assembly(model)
    assert [plan.steps[-1].resting for plan in plans] == [(1,), (1,), (), (), ()]
    found = model.evaluate({})
    np.testing.assert_allclose(found.measurements[0], -PAIR * CARRIED, rtol=1e-7)
    np.testing.assert_allclose(clamped(found, "release"), CARRIED, rtol=1e-7)


def test_locators_can_open_if_friction_holds_the_part():
    """b is set down on six locators and pressed by 100 N; with the six gone it stays, and 12 N along x move it on."""
    clamps = [PRESS, push(12, AT, ALONG_X, "D", stage="second")]
    release = {"kind": "release", "keep": [f"al{i}" for i in range(6)] + ["C"]}
    model = table(
        clamps,
        locators=[*six("a", far=WIDE), *six("b", far=WIDE)],
        kinds=("locate", "clamp", release, "clamp second", "measure"),
        measurements=[gauge("b", (0, 0, 0), ALONG_X), gauge("b", (0, 0, 0), name="Z")],
    )
    plans = plan_assembly(model)
    assert [plan.steps[-1].resting for plan in plans] == [(), (), (1,), (1,), (1,)]
    found = model.evaluate({})
    np.testing.assert_allclose(clamped(found), 0.0, atol=1e-9)  # the locators carry it
    np.testing.assert_allclose(clamped(found, "release"), CARRIED, rtol=1e-7)
    np.testing.assert_allclose(found.measurements[0], [4 * PAIR / 2, -PAIR * CARRIED[0]], rtol=1e-6)


def test_a_clamp_of_limited_force_can_press_a_resting_part():
    """The feet carry shares s of its force F, so that its point sinks by F Σ s² `PAIR`; the target is 0.1 mm."""
    needed = 0.1 / (PAIR * SHARE @ SHARE)
    stop = {"name": "C", "part": "b", "point": [30, 20, 0], "direction": [0, 0, -1], "stroke": 0.1}
    for limit, pressed in ((60.0, 60.0), (2 * needed, needed)):
        model = table([stop | {"limit": limit}])
        plan_assembly(model)
        found = model.evaluate({})
        clamp = found.resolutions["clamp"]
        assert found.built[0] == (limit > needed)
        np.testing.assert_allclose(clamp.pushed[0], [pressed], rtol=1e-7)
        np.testing.assert_allclose(clamped(found), pressed * SHARE, rtol=1e-7)
        if not found.built[0]:
            np.testing.assert_allclose(clamp.needed[0], [needed], rtol=1e-7)


@pytest.mark.slow
def test_a_flexible_sheet_can_rest_on_another_and_be_welded(lap_scene, cache):
    """The lap joint, its upper strip without locators: 60 N press it on, welds hold it once they are made."""
    model = mic.reduce(
        lap_scene.model_copy(
            update={
                "parts": [part.model_copy(update={"rests": part.name == "upper"}) for part in lap_scene.parts],
                "locators": [one for one in lap_scene.locators if one.part == "lower"],
                "deviations": [one for one in lap_scene.deviations if one.kind == "force"],
                "report": lap_scene.report.model_copy(update={"laws": ["coulomb"], "fields": False}),
            }
        ),
        cache,
    )
    samples = draw(model.scene, 5, 0, 4)
    found = model.evaluate(samples)
    assert not found.failed.any()
    for stage in ("clamp", "release"):
        assert found.resolutions[stage].residual.max() <= 1e-10
        assert set(found.resolutions[stage].rung) == {"followed"}
    force = found.resolutions["clamp"].force
    np.testing.assert_allclose(force.sum(axis=1), [[60.0, 0.0, 0.0]] * 4, atol=1e-7)
    # The forces on both parts, those of the fixture included, have no resultant.
    assert np.abs(model.compliance.rigid(csr_matrix(found.functional_force))).max() < 1e-6
    one = model.evaluate(samples[2])
    np.testing.assert_array_equal(one.measurements[0], found.measurements[2])


def on_pads(**change):
    """b alone, on three pads; no locator holds anything."""
    keys = {
        "parts": plates("b", "b"),
        "locators": [],
        "fixtures": [{"name": "P", "point": [0, 0, 0], "normal": [0, 0, 1], "radius": 5}],
        "zones": [zone("P", "b", pairs=3)],
    }
    return table([PRESS, push(12, AT, ALONG_X, "D")], **keys | change)


def test_pads_and_friction_can_replace_all_locators():
    """Only b yields at a foot, by half of `PAIR`; 12 N along x are shared alike below the limit of every foot."""
    model = on_pads()
    plans = plan_assembly(model)
    found = model.evaluate({})
    force = found.resolutions["clamp"].force[0]
    np.testing.assert_allclose(force.sum(axis=0), [100, -12, 0], atol=1e-7)
    np.testing.assert_allclose(clamped(found), CARRIED, rtol=1e-7)
    np.testing.assert_allclose(force[:, 1], -4.0, rtol=1e-6)
    np.testing.assert_allclose(found.measurements[0], -PAIR / 2 * CARRIED, rtol=1e-7)
    assert sentences(model.scene, plans[0]) == ["b is placed without locators; b is held by contact alone"]


def test_free_directions_without_locators_and_friction_are_named():
    zones = [zone("P", "b", friction=0.0, pairs=3)]
    refused(on_pads(zones=zones), r"part 'b' rests by contact alone, and nothing holds it along x, along y, about z")
    with pytest.raises(ValueError, match=r"parts\[0\] \(b\): its 0 locators .* hold 0 of its 6 .* rests = true"):
        on_pads(parts=plates("b"))


def test_a_part_welded_to_a_resting_part_presses_through_the_weld():
    """a, on it b, and c welded to b above, on which the clamp pushes: a carries what the levers say."""
    welds = [{"name": f"W{i}", "parts": ["c", "b"], "point": list(foot)} for i, foot in enumerate(FEET)]
    release = {"kind": "release", "keep": [f"al{i}" for i in range(6)] + ["C"]}
    model = table(
        [push(100, part="c"), push(10, name="K", stage="first")],
        parts=plates("abc", "b"),
        locators=[*six("a", far=WIDE), *six("c", far=WIDE)],
        welds=welds,
        measurements=[gauge("c", AT)],
        kinds=("locate", "clamp first", "weld", "clamp", release, "measure"),
    )
    plans = plan_assembly(model)
    assert [plan.steps[-1].resting for plan in plans] == [(1,), (1,), (), (), (1, 2), (1, 2)]
    np.testing.assert_allclose(clamped(model.evaluate({}), "release"), CARRIED, rtol=1e-6)


def test_a_part_of_a_later_station_is_absent_before():
    """b comes to the second station, where it rests; what presses a before does not press b."""
    pins = [one | {"part": "b", "name": f"p{i}", "stage": "second"} for i, one in enumerate(six("b", far=WIDE)[3:])]
    model = table(
        [push(30, part="a", name="K", stage="first"), PRESS],
        locators=[*six("a", far=WIDE), *pins],
        kinds=("locate", "clamp first", "locate second", "clamp", "measure"),
    )
    plans = plan_assembly(model)
    assert [plan.steps[-1].parked for plan in plans] == [(1,), (1,), (), (), ()]
    found = model.evaluate({})
    np.testing.assert_allclose(found.resolutions["first"].force, 0.0, atol=1e-9)
    np.testing.assert_allclose(clamped(found), CARRIED, rtol=1e-7)


def test_a_varying_force_can_hold_a_resting_part():
    model = table([push(0)], deviations=force_source("C"))
    plan_assembly(model)
    assert not model.evaluate(np.array([[100.0]])).failed.any()


# --------------------------------------------------------------------------------------------------- what is not held


@pytest.mark.parametrize(
    "way, normal, parts", [((0.6, 0.8, 0), UP, ["a", "b"]), ((-0.6, -0.8, 0), (0, 0, -1), ["b", "a"])]
)
def test_the_direction_in_which_a_part_is_pushed_off_is_reported(way, normal, parts):
    """The resting part is the first or the second body of its zone."""
    clamps = [PRESS, push(0, AT, way, "D")]
    model = table(clamps, normal=normal, zones=[zone(*parts)], deviations=force_source("D"))
    (status,) = model.evaluate(np.array([[30.0]])).resolutions["clamp"].status
    message = re.fullmatch(r"not held: part b is pushed off along \[(.*)\]", status)
    assert np.array(message[1].split(","), dtype=float) @ way > 0.9


def test_a_couple_beyond_friction_turns_the_part():
    """Three feet at the corners of an equilateral triangle, of 33 N each, pressed in the middle; a couple about it."""
    middle = np.array([50, 50 / 3**0.5, 0])
    turning = [push(0, middle + (0, side * 60, 0), (side, 0, 0), name) for side, name in ((1, "D"), (-1, "E"))]
    model = table(
        [push(100, middle), *turning],
        feet=[(0, 0, 0), (100, 0, 0), (50, 50 * 3**0.5, 0)],
        deviations=force_source("D", "E"),
    )
    found = model.evaluate(np.array([[30.0], [5.0]]))
    np.testing.assert_array_equal(found.failed, [True, False])
    assert found.resolutions["clamp"].status[0] == "not held: part b is pushed off and turns"


#: A contact along z, and a stop that holds x, in rows: what they read of b's translations along z, x and y.
ALONG_Z, STOPS_X = np.eye(3), np.eye(3)[[1]]


def loose(force, state, bound, stopped=0.0, free=3):
    """The message about b, free along z, or along x and y too, under one contact and one stop."""
    soft = np.append(np.full(free, True), False)
    directions = np.vstack([np.eye(3)[[2, 0, 1]][:free], np.eye(3)[:1]])
    rest = Rest(np.arange(1, free + 2), soft, directions, (*"bbb"[:free], "c"))
    read = np.vstack([ALONG_Z, STOPS_X])[:, :free]
    response = SimpleNamespace(diagonal=np.ones(4), T=np.column_stack([np.full(4, 9.0), read, np.full(4, 9.0)]))
    arrays = np.array([[force]]), np.array([[state]]), np.array([[bound]]), np.array([[stopped]])
    return rest.loose(response, *arrays).get(0)


def test_contacts_and_stops_hold_only_the_directions_that_they_resist():
    """Sticking: all; slipping: across the slip; without friction: the normal; open: none; a stop: under force."""
    assert loose((10.0, 0.5, 0.5), STICK, 2.0) is None
    message = loose((10.0, 1.2, 1.6), SLIP, 2.0)  # friction along (0.6, 0.8): so it may go on slipping
    assert message in (
        "not held: part b lies loose along [0.6, 0.8, 0]",
        "not held: part b lies loose along [-0.6, -0.8, 0]",
    )
    assert loose((10.0, 0.0, 2.0), SLIP, 2.0) == "not held: part b lies loose along y"
    assert "lies loose" in loose((10.0, 0.0, 0.0), STICK, 0.0)
    assert loose((10.0, 0.0, 0.0), STICK, 0.0, free=1) is None
    assert loose((0.0, 0.0, 0.0), OPEN, 2.0, free=1) == "not held: part b lies loose along z"
    assert loose((10.0, 2.0, 0.0), SLIP, 2.0) == "not held: part b lies loose along x"
    assert loose((10.0, 2.0, 0.0), SLIP, 2.0, stopped=3.0) is None


def test_a_sample_without_friction_is_refused():
    rubs = {"kind": "friction", "name": "mu", "target": "Z", "sigma": 0.05}
    model = table([PRESS], friction=0.2, deviations=[rubs])
    assert not model.evaluate({"mu": -0.1}).failed[0]
    with pytest.raises(mic.errors.ImpossibleSample, match=r"\(clamp\): part 'b' .* holds it along x, along y, about z"):
        model.evaluate({"mu": -0.2})


def test_sliding_directions_without_friction_are_named_before_computation():
    refused(table([PRESS], friction=0.0), r"\(clamp\): part 'b' .* holds it along x, along y, about z")
    laws = {"laws": ["coulomb", "frictionless"]}
    words = r"without friction \(law frictionless\).* take \"frictionless\" out of report.laws"
    refused(table([PRESS], report=laws), words)
    with pytest.raises(mic.SceneError, match=words):
        table([PRESS]).evaluate({}, "frictionless")


@pytest.mark.parametrize(
    "clamps",
    [
        pytest.param([push(100, (80, 50, 0))], id="beside its feet, it tips"),
        pytest.param([push(100, AT, UP)], id="pulled off"),
        pytest.param([PRESS, push(29, AT, ALONG_X, "D")], id="pushed beyond friction"),
    ],
)
def test_a_push_that_contact_cannot_balance_is_refused(clamps):
    refused(table(clamps), r"stages \(clamp\): contact alone holds 'b', and no forces of it balance the clamps")


def test_an_unpressed_part_is_loose():
    words = r"\(clamp\): part 'b' .* nothing presses it there: it lies loose"
    refused(table([push(100, part="a")]), words)


def test_a_sample_whose_clamps_do_not_reach_the_part_fails():
    """Three strokes hold b at its feet; above a gap nothing has it in plane, pressed friction has."""
    strokes = [
        {"name": f"C{i}", "part": "b", "point": list(foot), "direction": [0, 0, -1], "stroke": 0.0}
        for i, foot in enumerate(FEET)
    ]
    deviation = {"name": "D", "kind": "clamp", "target": [f"C{i}" for i in range(3)], "sigma": 0.1}
    model = table(strokes, gap=0.1, deviations=[deviation])
    plan_assembly(model)
    found = model.evaluate(np.array([[0.2], [0.05]]))
    np.testing.assert_array_equal(found.failed, [False, True])
    np.testing.assert_allclose(found.resolutions["clamp"].force[0, :, 0], 0.1 / PAIR, rtol=1e-7)
    assert found.resolutions["clamp"].status[1].startswith("not held: part b lies loose")


def test_only_parts_with_rests_can_rest():
    locators = [*six("a", far=WIDE), *six("b", far=WIDE)]
    with pytest.raises(ValueError, match=r"parts\[1\] \(b\): its 0 locators .* rests = true"):
        table([PRESS], parts=plates("ab"))
    with pytest.raises(ValueError, match=r"parts\[2\].rests \(c\): it is in no zone"):
        table([], parts=plates("abc", "c"), locators=locators)
    release = {"kind": "release", "keep": [f"al{i}" for i in range(6)] + ["C"]}
    held = table([PRESS], parts=plates("ab"), locators=locators, kinds=("locate", "clamp", release), measurements=[])
    with pytest.raises(mic.SceneError, match=r"stages \(release\): 6 rigid-body motions are free .* rests = true"):
        plan_stages(held.scene, held.weld_size)


def test_parts_resting_on_each_other_alone_are_refused():
    model = table([PRESS], parts=plates("ab", "a", "b"), locators=[])
    refused(model, r"\(locate\): 6 rigid-body .* no zones lead from it")


def test_the_process_description_names_resting_parts():
    model = table([PRESS])
    message = [sentences(model.scene, plan) for plan in plan_stages(model.scene, model.weld_size)]
    assert message == [
        ["a is placed on al0, al1, al2, al3, al4 and al5; b is placed without locators; b is held by contact alone"],
        ["overlaps between parts are resolved", "clamp C closes (100 N)"],
        ["3 key characteristics are measured"],
    ]


# -------------------------------------------------------------------------------------------- where a part is put down


def test_placement_is_the_smallest_motion_without_overlap():
    """By hand: one foot, the level of two, and a groove's two sides."""
    np.testing.assert_allclose(separating_motion(np.array([-0.3, 0.1]), np.eye(2)), [0.3, 0.0], atol=2e-9)
    sides = np.array([[1.0, 1.0], [-1.0, 1.0]])
    np.testing.assert_allclose(separating_motion(np.array([-0.2, -0.2]), sides), [0.0, 0.2], atol=2e-9)
    np.testing.assert_allclose(separating_motion(np.array([-0.2, 0.2]), sides), [0.1, 0.1], atol=2e-9)
    np.testing.assert_array_equal(separating_motion(np.array([0.0, 0.4]), sides), [0.0, 0.0])
    aside = np.array([[1.0, 0.0], [0.0, 0.0]])  # a gap that nothing changes does not count
    np.testing.assert_allclose(separating_motion(np.array([-0.3, -0.1]), aside), [0.3, 0.0], atol=2e-9)
    walls = np.array([[1.0], [-1.0]])  # too narrow for it: it stays as it is drawn
    np.testing.assert_array_equal(separating_motion(np.array([-0.2, -0.1]), walls), [0.0])
