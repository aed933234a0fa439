"""Plan and drive, which production and reference share, against answers by hand.

Comparing the two solves with each other cannot show an error here.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from support.springs import STIFFNESS, at_face, contacts_at, stage_list, two_plates
from support.springs import six as springs_six
from support.stages import with_stages

import mic
from mic.contact.laws import LAWS
from mic.model.assembly import GapPoints
from mic.model.rows import Joints
from mic.process.actions import tongs
from mic.process.description import opening, sentences
from mic.process.drive import drive
from mic.process.plan import plan_stages


def six(part, stage="set"):
    """Six locators of a part: a0 to a5 for part a."""
    return [item | {"name": f"{part}{i}"} for i, item in enumerate(springs_six(part, stage))]


def clamp(name, **keys):
    return {"name": name, "part": "b", "point": [5, 5, 0], "direction": [0, 0, 1], "stage": "close"} | keys


SCENE = {
    "name": "two-plates",
    "parts": [
        {"name": "a", "mesh": "a.stl", "thickness": 1.0},
        {"name": "b", "mesh": "b.stl", "thickness": 2.0, "young": 70e3},
    ],
    "locators": [*six("a"), *six("b"), {**six("b")[0], "name": "further", "stage": "close"}],
    "clamps": [clamp("hold", stroke=-0.25), clamp("press", force=40.0), clamp("press2", force=7.0, stage="close2")],
    "welds": [
        {"name": "W1", "parts": ["a", "b"], "point": [5, 5, 0], "stage": "join"},
        {"name": "W2", "parts": ["a", "b"], "point": [7, 5, 0], "stage": "join", "close": True, "moment": False},
    ],
    "stages": [
        {"kind": "locate", "name": "set"},
        {"kind": "clamp", "name": "close"},
        {"kind": "clamp", "name": "close2", "increments": 3},
        {"kind": "weld", "name": "join"},
        {"kind": "release", "name": "open", "keep": [f"a{i}" for i in range(6)]},
        {"kind": "measure", "name": "read"},
    ],
    "deviations": [
        {"name": "D1", "kind": "locator", "target": "b2", "sigma": 0.1},
        {"name": "D2", "kind": "clamp", "target": "hold", "sigma": 0.1},
        {"name": "D3", "kind": "clamp", "target": "press", "sigma": 1.0, "mean": 2.0},
    ],
}
WELD_SIZE = (6, 3)


@pytest.fixture(scope="module")
def plans():
    return {plan.name: plan for plan in plan_stages(mic.Scene(**SCENE), WELD_SIZE)}


def test_overlap_settles_once_then_locators_and_clamps_close_in_order(plans):
    set_down = tuple(("locator", i) for i in range(12))
    located = (*set_down, ("locator", 12))
    assert [(step.settles, step.bilateral, step.loads) for step in plans["close"].steps] == [
        (True, set_down, ()),
        (False, located, ()),
        (False, (*located, ("clamp", 0)), ()),
        (False, (*located, ("clamp", 0)), (1,)),
    ]
    assert not any(step.released or step.dropped_loads or step.closing for step in plans["close"].steps)
    assert [name for name, plan in plans.items() if any(step.settles for step in plan.steps)] == ["close"]
    assert plans["close2"].steps[-1].loads == (1, 2) and plans["close2"].increments == 3
    assert plans["close"].path == "followed" and plans["close2"].path == "increments"


def test_a_weld_freezes_all_its_rows_once(plans):
    (join,) = plans["join"].steps
    assert join.made == tuple(range(9)) and join.closing == (1,)
    assert not any(step.made for step in plans["open"].steps)
    assert {("weld", i) for i in range(9)} <= set(plans["open"].bilateral)


def test_a_release_opens_all_but_named_rows_in_reverse_order(plans):
    left = {("locator", i) for i in range(6)} | {("weld", i) for i in range(9)}
    assert set(plans["open"].bilateral) == left
    assert [(step.released, step.dropped_loads) for step in plans["open"].steps] == [
        ((), (2,)),
        ((), (1,)),
        ((("clamp", 0),), ()),
        ((("locator", 12),), ()),
        (tuple(("locator", i) for i in range(6, 12)), ()),
    ]


def variant(**stages):
    """The plan of the scene with other keys in some of its stages."""
    changed = [stage | stages.get(stage["name"], {}) for stage in SCENE["stages"]]
    return {plan.name: plan for plan in plan_stages(mic.Scene(**SCENE | {"stages": changed}), WELD_SIZE)}


def test_groups_of_an_order_close_one_after_the_other():
    plan = variant(close={"order": [["press"], ["further", "hold"]]})["close"]
    added = [set(after.bilateral) - set(before.bilateral) for before, after in zip(plan.steps, plan.steps[1:])]
    assert added == [set(), {("locator", 12), ("clamp", 0)}] and [step.loads for step in plan.steps] == [(), (1,), (1,)]


def test_welds_are_made_together_in_sequence_or_in_the_groups_of_an_order():
    first, second = tuple(range(6)), tuple(range(6, 9))
    assert [step.made for step in variant(join={"sequence": True})["join"].steps] == [first, second]
    assert [step.made for step in variant(join={"order": [["W2"], ["W1"]]})["join"].steps] == [second, first]


def test_a_release_opens_its_groups_and_keeps_the_clamps_that_it_names():
    own = [f"a{i}" for i in range(6)]
    rest = [f"b{i}" for i in range(6)]
    groups = variant(open={"keep": [*own, "press"], "order": [[*rest, "further"], ["press2", "hold"]]})["open"]
    assert [step.loads for step in groups.steps] == [(1, 2), (1,)]
    assert [step.released for step in groups.steps] == [tuple(("locator", i) for i in range(6, 13)), (("clamp", 0),)]
    reverse = variant(open={"keep": [*own, "press", "hold"]})["open"]
    assert [step.dropped_loads for step in reverse.steps] == [(2,), (), ()]
    assert reverse.steps[-1].loads == (1,) and ("clamp", 0) in reverse.bilateral


def test_a_one_step_stage_includes_overlap():
    (close,) = variant(close={"path": "one-step"})["close"].steps
    assert close.settles and close.loads == (1,) and {("locator", 12), ("clamp", 0)} <= set(close.bilateral)
    (opened,) = variant(open={"path": "one-step"})["open"].steps
    assert len(opened.released) == 8 and opened.dropped_loads == (1, 2)


def test_parts_can_settle_during_the_first_closing():
    steps = variant(set={"settle": False})["close"].steps
    assert [step.settles for step in steps] == [True, False, False]
    assert ("locator", 12) in steps[0].bilateral


def test_opposing_clamps_close_together():
    def groups(**changes):
        lower = clamp("lower", part="a", force=40.0)
        upper = clamp("upper", force=40.0, direction=[0, 0, -1]) | changes
        return tongs(mic.Scene(**SCENE | {"clamps": [lower, upper], "deviations": []}), [0, 1])

    assert groups() == [(0, 1)]
    assert groups(part="a") == groups(direction=[0, 0, 1]) == groups(point=[20, 5, 0]) == [(0,), (1,)]


#: In three groups; after the second only `hold` and `further`, two supports along z, hold the two welded parts.
IN_GROUPS = [[f"{part}{i}" for part in "ab" for i in range(6)], ["press2", "press"], ["hold", "further"]]


@pytest.mark.parametrize(
    "opened, free",
    [
        ({"keep": ["a0", "a1", "a2"]}, "3 rigid-body motions are free once a3, a4.* opened"),
        ({"keep": [], "order": IN_GROUPS}, "4 rigid-body motions are free once a0, a1, a2, a3 … opened"),
    ],
)
def test_a_release_that_frees_a_part_is_refused_and_names_what_opened(opened, free):
    with pytest.raises(mic.SceneError, match=rf"stages \(open\): {free}"):
        variant(open=opened)


def test_welds_without_moment_hold_no_rotation():
    """The three rows of one weld hold the released b: it may turn about the weld's point, in three ways."""
    (weld,) = [weld for weld in SCENE["welds"] if weld["name"] == "W2"]
    stages = [SCENE["stages"][i] for i in (0, 1, 2, 3, 4)]
    scene = mic.Scene(**SCENE | {"welds": [weld], "stages": stages})
    with pytest.raises(mic.SceneError, match=r"stages \(open\): 3 rigid-body motions are free .*part 'b'"):
        plan_stages(scene, (3,))
    two = [weld, {**weld, "name": "W3", "point": [0, 9, 0]}]
    with pytest.raises(mic.SceneError, match=r"stages \(open\): 1 rigid-body motions are free .*part 'b'"):
        plan_stages(mic.Scene(**SCENE | {"welds": two, "stages": stages}), (3, 3))
    assert plan_stages(mic.Scene(**SCENE | {"welds": [{**weld, "moment": True}], "stages": stages}), (6,))


def test_frictionless_stages_solve_only_the_last_step_and_those_with_welds(plans):
    """close: one of four. join: W1 and W2 in sequence, where W2 alone closes a gap and W1 freezes what is there."""
    solved = {
        law: {name: plan.solves(LAWS[law]) for name, plan in plans.items()} for law in ("coulomb", "frictionless")
    }
    assert solved["coulomb"] == {"set": 0, "close": 4, "close2": 3, "join": 1, "open": 5, "read": 0}
    assert solved["frictionless"] == {"set": 0, "close": 1, "close2": 1, "join": 1, "open": 1, "read": 0}
    gone = variant(join={"order": [["W2"], ["W1"]]})["join"]
    assert gone.solves(LAWS["frictionless"]) == 1 and gone.memory_steps == (0, 1)


def test_the_process_is_described_in_words():
    plans = variant(join={"sequence": True})
    scene = mic.Scene(**SCENE)
    assert sentences(scene, plans["close"]) == [
        "overlaps between parts are resolved",
        "locator further closes",
        "clamp hold closes to -0.25 mm",
        "clamp press closes (40 N)",
    ]
    assert sentences(scene, plans["join"]) == [
        "weld W1 joins the sheets as they stand",
        "weld W2 closes its gap and joins the sheets",
    ]
    assert sentences(scene, plans["open"])[:2] == ["clamp press2 opens", "clamp press opens"]
    assert sentences(scene, plans["set"]) == [
        "a is placed on a0, a1, a2, a3, a4 and a5; b is placed on b0, b1, b2, b3, b4 and b5"
    ]
    together = variant(set={"settle": False}, close={"order": [["press", "further", "hold"]]})["close"]
    assert sentences(scene, together) == [
        "locator further closes, clamp hold closes to -0.25 mm, clamp press closes (40 N); "
        "meanwhile overlaps between parts are resolved"
    ]
    message = {name: opening(plan, contacts=True) for name, plan in plans.items()}
    assert message == {
        "set": "parts are placed without contact",
        "close": "contact active, load path followed",
        "close2": "contact active, 3 increments for each step",
        "join": "contact active, load path followed",
        "open": "contact active, load path followed",
        "read": "nothing moves",
    }


class Meaning:
    """The attributes of an assembly that `drive` uses, without a mesh: one contact, two welds, one measurement."""

    scene = mic.Scene(**SCENE)
    labels = {"locator": [item.name for item in scene.locators], "clamp": [item.name for item in scene.clamps]}
    contacts = contacts_at(np.zeros((1, 3)), np.eye(3)[None], [0], [0.3], [0.05])
    joints = Joints(WELD_SIZE)
    weld_gap = np.array([0.1, *[0.0] * 5, 0.2, 0.0, 0.0])
    between = GapPoints(np.zeros(1, int), np.array([0.02]), np.full(1, -1), np.zeros((1, 3)))


def test_deviations_change_strokes_targets_forces_and_gaps_with_the_right_sign():
    shape = {"locator": np.zeros((1, 13)), "clamp": np.zeros((1, 3)), "measurement": np.array([[0.7]])}
    shape["contact"] = np.array([[-0.02, 5.0, 5.0]])  # the tangential deviation must not enter
    shape["weld"] = np.zeros((1, 9))
    shape["between"] = np.array([[0.01]])
    shape["weld"][0, 6] = 0.03  # the first row of the second weld
    shape["weld"][0, 4] = 0.01  # how the first one's gap tilts; the tangential ones must not enter
    shape["weld"][0, [1, 3, 7]] = 5.0
    shape["locator"][0, 8] = 0.4  # the part stands 0.4 mm too high at b2 ...
    driven = drive(Meaning, np.array([[0.1, -0.05, 2.0]]), shape)
    assert driven.target["locator"][0, 8] == pytest.approx(0.1 - 0.4)  # ... and must come down for its locator
    assert driven.target["clamp"][0, 0] == pytest.approx(-0.25 - 0.05)
    np.testing.assert_allclose(driven.push[0, 1:], [42.0, 7.0])
    np.testing.assert_allclose(driven.gap, [[0.03]])
    np.testing.assert_allclose(driven.weld_gap, [[0.1, 0, 0, 0, 0.01, 0, 0.23, 0, 0]])
    np.testing.assert_allclose(driven.between, [[0.03]])
    np.testing.assert_allclose(driven.measured, [[0.7]])


# ------------------------------------------------------------------------------- two springs and a gap, by hand

GAP, PRESS = 0.3, 20.0  # mm, N


def springs(drag=0.0, gap=GAP, settle=True, **close):
    """Two bodies whose faces yield along z on a spring each, one contact between them.

    One clamp presses b's face down, and one drags it along x. `close` gives further keys of the stage that closes them.
    """
    clamps = [at_face("b", name="press", force=-PRESS), at_face("b", (1, 0, 0), name="drag", force=drag)]
    locate = {"kind": "locate", "settle": settle}
    return two_plates(gap, clamps=clamps, stages=stage_list(locate, {"kind": "clamp"} | close, "release", "measure"))


def test_a_clamp_closes_a_gap_against_two_springs_and_release_opens_it():
    """The clamp pushes b's face down by P: it meets a after the gap g, and both springs share what is left.

    u_b = (P − f)/k, u_a = f/k, closed when u_b − u_a = g: f = (P − k g)/2.
    """
    evaluation = springs().evaluate({})
    pressed = evaluation.resolutions["clamp"]
    assert pressed.force[0, 0, 0] == pytest.approx((PRESS - STIFFNESS * GAP) / 2, rel=1e-12)
    assert pressed.displacement[0, 0, 0] == pytest.approx(0.0, abs=1e-12)
    opened = evaluation.resolutions["release"]
    assert opened.force[0, 0, 0] == 0.0
    assert opened.displacement[0, 0, 0] == pytest.approx(GAP, rel=1e-12)  # the clamp's force has gone
    assert evaluation.measurements[0, 0] == pytest.approx(0.0, abs=1e-12)


# Along x both faces yield by c = 1/(2k) per N. Held by a friction force f_t, b's face moves by (D + f_t) c under the
# drag D and a's by -f_t c, so that u_t = (D + 2 f_t) c. The face is pressed by N = (P - k g)/2 = 2.5 N, μ N = 0.5 N.
YIELD, HOLD = 0.5 / STIFFNESS, 0.2 * (PRESS - STIFFNESS * GAP) / 2
DRAGGED = {
    "pressed, then dragged: it sticks": (0.8, [["press"], ["drag"]], -0.8 / 2, 0.0),
    "pressed, then dragged: it slips": (3.0, [["press"], ["drag"]], -HOLD, (3.0 - 2 * HOLD) * YIELD),
    "dragged, then pressed: nothing is left to hold": (3.0, [["drag"], ["press"]], 0.0, 3.0 * YIELD),
    "dragged, then pressed, and a little": (0.8, [["drag"], ["press"]], 0.0, 0.8 * YIELD),
}


@pytest.mark.parametrize("case", DRAGGED)
def test_friction_of_a_drag_depends_on_the_order_of_press_and_drag(case):
    drag, order, force, slip = DRAGGED[case]
    closed = springs(drag, order=order).evaluate({}).resolutions["clamp"]
    np.testing.assert_allclose(closed.force[0, 0], [2.5, force, 0.0], atol=1e-9)
    np.testing.assert_allclose(closed.displacement[0, 0], [0.0, slip, 0.0], atol=1e-10)
    under_load = slip if order[0] == ["press"] else 0.0
    np.testing.assert_allclose(closed.trace.slip[0, 0], [under_load, 0.0], atol=1e-10)


def test_a_face_pressed_and_dragged_together_sticks_where_it_touches():
    """It touches at s = k g/P = 3/4 of both loads; from there D/4 is shared by both springs: f_t = -D/8, D/8 < μ N.

    One step at once, as the paper has it, holds it from where it was set down: f_t = -D/2.
    """
    drag, touch = 0.8, STIFFNESS * GAP / PRESS
    followed = springs(drag, order=[["press", "drag"]]).evaluate({}).resolutions["clamp"]
    np.testing.assert_allclose(followed.force[0, 0], [2.5, -(1 - touch) * drag / 2, 0.0], rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(followed.displacement[0, 0], [0.0, touch * drag * YIELD, 0.0], rtol=1e-3, atol=1e-9)
    at_once = springs(drag, path="one-step").evaluate({}).resolutions["clamp"]
    np.testing.assert_allclose(at_once.force[0, 0], [2.5, -drag / 2, 0.0], atol=1e-9)


@pytest.mark.parametrize("settle, work", [(True, 0.015), (False, 0.0075)])
def test_overlap_presses_before_the_drag_or_during_it(settle, work):
    """Faces that overlap by 0.3 mm press on each other by N = 0.3 k/2 = 7.5 N, and a drag of 4 N overcomes μ N = 1.5 N.

    They end slipped by u = (4 - 2 μ N) c = 0.01 mm, against μ N all the way, or against a force that grows with the
    slip.
    """
    model = springs(4.0, gap=-0.3, settle=settle, order=[["drag"], ["press"]], increments=100)
    closed = model.evaluate({}).resolutions["clamp"]
    assert closed.trace.slip[0, 0, 0] == pytest.approx(0.01, rel=1e-9)
    assert closed.trace.work[0, 0] == pytest.approx(work, rel=0.02)


@pytest.mark.parametrize("path", ["followed", "increments", "one-step"])
@pytest.mark.parametrize("settle", [True, False])
def test_a_clamp_stage_without_clamps_solves_contact(settle, path):
    """Faces that overlap by 0.3 mm come to rest on each other, by 0.3 k/2; nothing else happens there."""
    model = springs(gap=-0.3, settle=settle, path=path, **{"increments": 4} if path == "increments" else {})
    none = {kind: csr_matrix((0, rows.shape[1])) for kind, rows in model.rows.items() if kind == "clamp"}
    bare = replace(model, scene=model.scene.model_copy(update={"clamps": []}), rows=model.rows | none)
    plans = plan_stages(bare.scene, ())
    assert [plan.resolves for plan in plans] == [False, True, False, False]
    assert sentences(bare.scene, plans[1]) == ["overlaps between parts are resolved"]
    rested = bare.evaluate({}).resolutions["clamp"]
    np.testing.assert_allclose(rested.force[0, 0], [0.3 * STIFFNESS / 2, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(rested.displacement[0, 0], 0.0, atol=1e-10)


def test_a_release_opens_in_reverse_order():
    """The face has slipped by u = (D - 2 μ N) c. Without the drag it slips back while the press still holds it, and the
    rest of the way as the press fades: by -u. If the press opens first, the drag takes it on to D c, by 2 μ N c.
    """
    drag = 3.0
    model = springs(drag, order=[["press"], ["drag"]])
    back = model.evaluate({}).resolutions["release"].trace
    np.testing.assert_allclose(back.slip[0, 0], [-(drag - 2 * HOLD) * YIELD, 0.0], atol=1e-9)
    stages = list(model.scene.stages)
    stages[2] = stages[2].model_copy(update={"order": [["press"], ["drag"]]})
    on = with_stages(model, stages).evaluate({}).resolutions["release"].trace
    np.testing.assert_allclose(on.slip[0, 0], [2 * HOLD * YIELD, 0.0], atol=1e-9)
