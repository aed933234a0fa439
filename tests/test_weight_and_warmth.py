"""Gravity, temperature, displaced pins and holes against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.decks import write_deck
from support.deviated import lap_joint, read

import mic
from mic.compliance.blocks import Blocks
from mic.geometry.structured import extrude
from mic.model.assembly import assemble
from mic.model.rigid_motion import rigid_readings
from mic.model.shape import shape_readings
from mic.model.sources import sources
from mic.process.drive import drive
from mic.process.plan import plan_stages
from mic.scene.deviation import FrictionDeviation
from mic.scene.load import read_table

ρ, α, g = 7850.0, 1.2e-5, 9.80665


L, b, t, E = 200.0, 20.0, 0.8, 210e3


def strip(folder, deviations, hung=False):
    """A strip on supports at its ends, measured in its middle, and how long it is; or hung to be measured."""
    points, triangles = extrude([(0, 0), (b, 0)], 0.0, L, 5.0)[:2]
    write_deck(folder / "strip.inp", {"strip": (points, triangles)})
    unit = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}
    places = [(0, 0, "z"), (0, b, "z"), (L, b / 2, "z"), (0, 0, "y"), (L, 0, "y"), (0, b / 2, "x")]
    held = [{"point": [x, y, 0], "direction": unit[way], "part": "strip", "radius": 0} for x, y, way in places]
    locators = [{"name": f"L{i}", **one} for i, one in enumerate(held)]
    if hung:
        locators += [{"name": f"H{i}", "stage": "measure", **one} for i, one in enumerate(held)]
    material = {"thickness": t, "young": E, "poisson": 0.0, "density": ρ, "expansion": α}
    reads = {"part": "strip", "radius": 0, "lower": -1, "upper": 1}
    return read_table(
        {
            "name": "strip",
            "parts": [{"name": "strip", "mesh": "strip.inp", **material}],
            "locators": locators,
            "stages": [{"kind": "locate"}, {"kind": "measure"}],
            "deviations": deviations,
            "measurements": [
                {"name": "sag", "point": [L / 2, b / 2, 0], "direction": unit["z"], **reads},
                {"name": "length", "point": [L, b / 2, 0], "direction": unit["x"], **reads},
            ],
            "report": {"laws": ["frictionless"]},
        },
        folder / "scene.toml",
    )


GRAVITY = {"name": "g", "kind": "gravity"}


@pytest.mark.fem
def test_a_strip_sags_under_its_weight_as_a_beam_does(tmp_path):
    """``5 q L⁴/(384 E I)`` between two supports, upwards where gravity is turned round."""
    q, I = 1e-9 * ρ * g * t * b, b * t**3 / 12
    beam = 5 * q * L**4 / (384 * E * I)
    for way, sign in ((-1, -1), (1, 1)):
        model = mic.reduce(strip(tmp_path, [GRAVITY | {"direction": [0, 0, way]}]), tmp_path / "cache")
        sag, length = model.evaluate({}).measurements[0]
        assert sag == pytest.approx(sign * beam, rel=5e-3) and abs(length) < 1e-9
    assert model.evaluate({"g": 0.5}).measurements[0, 0] == pytest.approx(0.5 * beam, rel=5e-3)
    reaction = model.evaluate({}).functional_force[0] @ model.compliance.G[:][0]
    assert np.abs(reaction).max() < 1e-9 * q * L * L  # the locators carry the weight


@pytest.mark.fem
def test_gravity_acts_only_in_its_stage(tmp_path):
    def sag(item, **keys):
        return mic.reduce(strip(tmp_path, [item], **keys), tmp_path / "cache").evaluate({}).measurements[0, 0]

    alone = sag(GRAVITY)
    assert alone < -0.05 and sag(GRAVITY, hung=True) == pytest.approx(0.0, abs=1e-9)
    assert sag(GRAVITY | {"stage": "measure"}, hung=True) == pytest.approx(alone, abs=1e-9)


@pytest.mark.fem
def test_a_warm_strip_is_longer_by_its_expansion_and_free_of_stress(tmp_path):
    item = {"name": "T", "kind": "temperature", "sigma": 1.0}
    model = mic.reduce(strip(tmp_path, [item]), tmp_path / "cache")
    found = model.evaluate({"T": 50.0})
    assert found.measurements[0] == pytest.approx([0.0, α * 50 * L], abs=1e-9)
    assert np.abs(found.functional_force).max() < 1e-9


IN_PLANE = {"name": "M3", "part": "upper", "point": [130, 12.5, 1], "direction": [1, 0, 0], "lower": -1, "upper": 1}


def test_only_the_named_part_expands_from_the_pin_that_holds_it(cache):
    """In x, the pins hold the lower strip at 5 mm and the upper one at 155 mm; it is read at 60 and at 130 mm."""
    parts = ({"part": "lower"}, {"part": "upper"}, {})
    table = lap_joint([{"name": f"T{i}", "kind": "temperature", "sigma": 1.0} | part for i, part in enumerate(parts)])
    table["measurements"] = [IN_PLANE | {"name": "M4", "part": "lower", "point": [60, 12.5, 0]}, IN_PLANE]
    assembly = assemble(read(table), cache)
    G = tuple(rigid_readings(part) for part in assembly.parts)
    shape, forces = shape_readings(assembly, Blocks(tuple(np.zeros((len(each), len(each))) for each in G), G))
    lower, upper = α * (60 - 5), α * (130 - 155)
    grown = [[lower, 0.0, lower], [0.0, upper, upper]]
    np.testing.assert_allclose(assembly.rows["measurement"] @ shape, grown, rtol=1e-4, atol=1e-12)
    assert np.abs(assembly.rows["locator"] @ shape).max() < 1e-12 and not forces.any()


def test_weights_are_loads_from_placement_to_the_next_station():
    again = [{**one, "name": f"N-{one['name']}", "stage": "measure"} for one in lap_joint([])["locators"][:6]]
    upside_down = {"name": "h", "kind": "gravity", "direction": [0, 0, 1], "stage": "measure"}
    table = lap_joint([GRAVITY, upside_down])
    table["locators"] += again
    plans = {plan.name: plan for plan in plan_stages(read(table), (6, 6))}
    assert {step.loads for step in plans["locate"].steps} == {(2, 3)}  # behind the two clamps
    assert plans["clamp"].steps[-1].loads == (2, 3, 0, 1)
    assert plans["release"].steps[-1].loads == (2, 3)
    assert plans["measure"].steps[0].loads == (4, 5) and plans["measure"].steps[0].dropped_loads == (2, 3)


PIN = {"kind": "locator", "sigma": 0.0, "target": ["upper-C1", "upper-B1"]}


@pytest.mark.slow
def test_a_displaced_pin_moves_its_locators_and_a_displaced_hole_does_the_opposite(lap_scene, cache):
    along = [0.6, 0.8, 0]
    items = [
        {"name": "x", "kind": "locator", "target": "upper-C1", "sigma": 0.0},
        {"name": "y", "kind": "locator", "target": "upper-B1", "sigma": 0.0},
        PIN | {"name": "pin", "direction": [3, 4, 0]},
        PIN | {"name": "hole", "direction": along, "where": "part"},
    ]
    table = lap_scene.model_dump()
    model = mic.reduce(mic.Scene(**table | {"deviations": items, "folder": lap_scene.folder}), cache)

    def targets(values):
        shape = {kind: np.zeros((1, own.shape[0])) for kind, own in model.rows.items()}
        return drive(model, model.deviations(values), shape).target["locator"][0]

    apart = targets({"x": 0.06, "y": 0.08})
    assert np.count_nonzero(apart) == 2 and apart[model.labels["locator"].index("upper-B1")] == 0.08
    np.testing.assert_allclose(targets({"pin": 0.1}), apart, atol=1e-15)
    np.testing.assert_allclose(targets({"hole": -0.1}), apart, atol=1e-15)


MU = {"name": "mu", "kind": "friction", "target": "lap", "sigma": 0.05}
WARM = {"name": "T", "kind": "temperature", "sigma": 1.0}
ADDS = "zone 'lap' has no constant friction to add to; give it friction"
#: A deviation, the words of its error, and a change of the table that causes it.
BAD = {
    "a pin without a direction": (PIN | {"name": "p"}, "several locators of one pin need its direction"),
    "an unknown locator": (
        PIN | {"name": "p", "target": ["upper-C1", "A9"], "direction": [1, 0, 0]},
        "no locator called 'A9'",
    ),
    "a pin of no direction": (PIN | {"name": "p", "direction": [0, 0, 0]}, "direction.* must not be zero"),
    "a pin along its axis": (
        PIN | {"name": "p", "direction": [0, 0, 1]},
        "perpendicular to that of upper-C1 and upper-B1",
    ),
    "without direction": (GRAVITY | {"direction": [0, 0, 0]}, "must not be zero"),
    "an unknown stage": (GRAVITY | {"stage": "night"}, "no part is placed in 'night'; name one of locate"),
    "a stage that places nothing": (GRAVITY | {"stage": "weld"}, "no part is placed in 'weld'"),
    "an unknown part": (WARM | {"part": "roof"}, "no part called 'roof'"),
    "without density": (GRAVITY, r"\(g\): part 'upper' needs density", lambda table: table["parts"][1].pop("density")),
    "without expansion": (WARM, r"\(T\): part 'upper' needs expan", lambda table: table["parts"][1].pop("expansion")),
    "warm with fields": (
        WARM,
        "T.: fields do not include expansion; leave fields out of .report.",
        lambda table: table["report"].update(fields=True),
    ),
    "an unknown zone": (MU | {"target": "roof"}, "no zone called 'roof'"),
    "a zone without friction": (MU, ADDS, lambda table: table["zones"][0].update(friction=0)),
    "friction by pressure": (
        MU,
        ADDS,
        lambda table: table["zones"][0].update(friction_table=[[0.0, 0.2], [1.0, 0.2]]),
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_invalid_deviations_are_refused_with_the_remedy(case, cache):
    item, message, *changes = BAD[case]
    table = lap_joint([item])
    for change in changes:
        change(table)
    with pytest.raises(mic.SceneError, match=message):
        assemble(read(table), cache)


def test_sources_without_temperature_do_not_expand(lap_scene):
    for source in sources(lap_scene):
        assert source.expansion() == {}


def test_varying_friction_equals_scenes_with_that_friction(lap_model):
    """Samples of equal, of different and of negative friction, which fails."""
    forces, rough = lap_model.scene.deviations, FrictionDeviation(**MU)
    varied = lap_model.varied(lap_model.scene.model_copy(update={"deviations": [*forces, rough]}))
    samples = np.zeros((6, len(forces) + 1))
    samples[:, : len(forces)] = [[-8.0, 4.0, 0.1]] * 6
    samples[:, -1] = [0.0, -0.2, -0.2, 0.1, -0.3, 0.0]
    found = varied.process("coulomb").attempt(samples)
    np.testing.assert_array_equal(found.deviations, samples)
    assert found.failed.tolist() == [False] * 4 + [True, False]
    assert "friction would be -0.03" in found.resolutions["clamp"].status[4]
    contacts = lap_model.contacts
    for i in (1, 3):
        fixed = replace(lap_model, contacts=replace(contacts, friction=contacts.friction + samples[i, -1]))
        alone = fixed.evaluate(samples[i, :-1], "coulomb").resolutions["clamp"]
        np.testing.assert_allclose(found.resolutions["clamp"].force[i], alone.force[0], atol=1e-9)
    force = found.resolutions["clamp"].force
    assert np.abs(force[0] - force[1]).max() > 1e-3
    np.testing.assert_array_equal(force[[0, 1]], force[[5, 2]])
    smooth = varied.process("frictionless").evaluate(samples)
    assert not smooth.failed.any()


@pytest.mark.slow
def test_a_part_held_by_contact_alone_presses_with_its_weight(cache):
    """The upper strip without locators: lap and pad carry the clamp and its weight; without the pad it tips over."""
    table = lap_joint([GRAVITY | {"direction": [0, 0, -1], "mean": 20.0}])
    table["parts"] = [part | {"rests": part["name"] == "upper"} for part in table["parts"]]
    table["locators"] = [one for one in table["locators"] if one["part"] == "lower"]
    with pytest.raises(mic.SceneError, match="contact alone holds 'upper', and no forces of it balance"):
        mic.reduce(read(table), cache)
    table["fixtures"] = [{"name": "P", "point": [150, 12.5, 0.5], "normal": [0, 0, 1], "radius": 5}]
    table["zones"].append({"name": "pad", "parts": ["P", "upper"], "friction": 0.2, "pairs": 6})
    found = mic.reduce(read(table), cache).evaluate({})
    weight = 20.0 * 9806.65e-12 * ρ * 100.0 * 25.0
    assert not found.failed.any() and weight > 3
    carried = found.resolutions["clamp"].force[0].sum(axis=0)
    np.testing.assert_allclose(carried, [60.0 + weight, 0.0, 0.0], atol=1e-6)
