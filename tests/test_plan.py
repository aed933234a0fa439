"""What production and reference share is what the scene means: plan and drive, held against hand-made answers.

Comparing the two solves with each other cannot show an error here.
"""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

import mic
from mic.compliance.blocks import Blocks
from mic.model.assembly import Contacts
from mic.model.rows import KINDS
from mic.process.drive import drive
from mic.process.model import ReducedModel
from mic.process.plan import plan_stages

FAR = [[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 0], [10, 0, 0], [0, 0, 0]]
ALONG = [[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0]]


def six(part, stage="set"):
    return [
        {"name": f"{part}{i}", "part": part, "point": point, "direction": direction, "stage": stage}
        for i, (point, direction) in enumerate(zip(FAR, ALONG))
    ]


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


def test_locators_hold_from_the_stage_that_they_name(plans):
    assert plans["set"].bilateral == tuple(("locator", i) for i in range(12))
    assert set(plans["close"].bilateral) - set(plans["set"].bilateral) == {("locator", 12), ("clamp", 0)}


def test_clamps_with_a_force_push_and_clamps_with_a_stroke_hold(plans):
    assert plans["close"].loads == (1,) and ("clamp", 0) in plans["close"].bilateral
    assert plans["close2"].loads == (1, 2) and plans["close2"].increments == 3


def test_a_weld_freezes_all_its_rows_once_and_a_closing_one_is_named(plans):
    assert plans["join"].made == tuple(range(9)) and plans["join"].closing == (1,)
    assert plans["open"].made == () and {("weld", i) for i in range(9)} <= set(plans["open"].bilateral)


def test_release_opens_every_clamp_and_every_locator_but_those_kept(plans):
    kept = {("locator", i) for i in range(6)} | {("weld", i) for i in range(9)}
    assert set(plans["open"].bilateral) == kept
    assert plans["open"].loads == () and plans["open"].dropped_loads == (1, 2)
    assert set(plans["open"].released) == {("locator", i) for i in range(6, 13)} | {("clamp", 0)}


def test_contact_is_resolved_where_something_changes_and_not_while_parts_are_set_down(plans):
    resolves = {name: plan.resolves for name, plan in plans.items()}
    assert resolves == {"set": False, "close": True, "close2": True, "join": True, "open": True, "read": False}
    assert [name for name, plan in plans.items() if plan.reads] == ["read"]


class Meaning:
    """What `drive` asks of an assembly, without any mesh: one contact, two welds, one measurement."""

    scene = mic.Scene(**SCENE)
    labels = {"locator": [item.name for item in scene.locators], "clamp": [item.name for item in scene.clamps]}
    contacts = Contacts(
        np.zeros(1, int), np.array([0.3]), np.array([0.05]), np.ones(1), np.zeros((1, 3)), np.eye(3)[None], 3
    )
    weld_size, weld_gap = WELD_SIZE, np.array([0.1, 0.2])


def test_deviations_move_strokes_targets_forces_and_gaps_with_the_right_sign():
    shape = {"locator": np.zeros((1, 13)), "clamp": np.zeros((1, 3)), "measurement": np.array([[0.7]])}
    shape["contact"] = np.array([[-0.02, 5.0, 5.0]])  # the tangential deviation must not enter
    shape["weld"] = np.zeros((1, 9))
    shape["weld"][0, 6] = 0.03  # the first row of the second weld
    shape["locator"][0, 8] = 0.4  # the part stands 0.4 mm too high at b2 ...
    asked = drive(Meaning, np.array([[0.1, -0.05, 2.0]]), shape)
    assert asked.target["locator"][0, 8] == pytest.approx(0.1 - 0.4)  # ... and must come down for its locator
    assert asked.target["clamp"][0, 0] == pytest.approx(-0.25 - 0.05)
    np.testing.assert_allclose(asked.push[0, 1:], [42.0, 7.0])
    np.testing.assert_allclose(asked.gap, [[0.03]])
    np.testing.assert_allclose(asked.weld_gap, [[0.1, 0.23]])
    np.testing.assert_allclose(asked.measured, [[0.7]])


# ------------------------------------------------------------------------------- two springs and a gap, by hand

STIFFNESS, GAP, PRESS = 50.0, 0.3, 20.0  # N/mm, mm, N


def springs():
    """Two bodies whose faces yield along z on a spring each, one contact between them.

    Functionals of each body: its six supports, and its face along n, t1 and t2. What the finite elements would give is
    written down by hand.
    """
    count = 6 + 3
    H = np.zeros((count, count))
    H[6, 6] = 1 / STIFFNESS  # the face yields along z
    H[7, 7] = H[8, 8] = 0.5 / STIFFNESS
    motions = np.array([[*d, *np.cross(p, d)] for p, d in zip(FAR, ALONG)], float)
    G = np.vstack([motions, np.hstack([[[0, 0, 1], [1, 0, 0], [0, 1, 0]], np.zeros((3, 3))])])
    compliance = Blocks((H, H.copy()), (G, G.copy()))
    width = 2 * count

    def row(*entries):
        line = np.zeros(width)
        for column, value in entries:
            line[column] = value
        return line

    locators = [row((i, 1.0)) for i in range(6)] + [row((count + i, 1.0)) for i in range(6)]
    press = [row((count + 6, 1.0))]
    contact = [row((6 + j, -1.0), (count + 6 + j, 1.0)) for j in range(3)]
    rows = {kind: csr_matrix((0, width)) for kind in KINDS}
    rows |= {"locator": csr_matrix(locators), "clamp": csr_matrix(press), "contact": csr_matrix(contact)}
    rows["measurement"] = csr_matrix([row((count + 6, 1.0))])
    scene = mic.Scene(
        name="springs",
        parts=SCENE["parts"],
        locators=[*six("a"), *six("b")],
        clamps=[clamp("press", force=-PRESS)],
        zones=[{"name": "Z", "parts": ["a", "b"], "friction": 0.2, "pairs": 1}],
        measurements=[{"name": "M", "part": "b", "point": [5, 5, 0], "direction": [0, 0, 1], "lower": -1, "upper": 1}],
        stages=[
            {"kind": "locate", "name": "set"},
            {"kind": "clamp", "name": "close"},
            {"kind": "release", "name": "open"},
            {"kind": "measure", "name": "read"},
        ],
    )
    labels = {kind: [f"{kind}{i}" for i in range(rows[kind].shape[0])] for kind in KINDS}
    contacts = Contacts(
        np.zeros(1, int),
        np.array([0.2]),
        np.array([GAP]),
        np.ones(1),
        np.zeros((1, 3)),
        np.eye(3)[None],
        3,
    )
    none = np.zeros((width, 0))
    return ReducedModel(scene, compliance, rows, labels, contacts, (), np.zeros(0), none, none, {})


def test_a_clamp_closes_a_gap_against_two_springs_and_release_opens_it():
    """The clamp pushes b's face down by P: it meets a after the gap g, and both springs share what is left.

    u_b = (P − f)/k, u_a = f/k, closed when u_b − u_a = g: f = (P − k g)/2.
    """
    evaluation = springs().evaluate({})
    pressed = evaluation.resolutions["close"]
    assert pressed.force[0, 0, 0] == pytest.approx((PRESS - STIFFNESS * GAP) / 2, rel=1e-12)
    assert pressed.displacement[0, 0, 0] == pytest.approx(0.0, abs=1e-12)
    opened = evaluation.resolutions["open"]
    assert opened.force[0, 0, 0] == 0.0
    assert opened.displacement[0, 0, 0] == pytest.approx(GAP, rel=1e-12)  # the clamp's force has gone
    assert evaluation.measurements[0, 0] == pytest.approx(0.0, abs=1e-12)
