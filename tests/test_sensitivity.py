"""Exact derivatives through contact and memory: against central differences, and against contacts solved by hand."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.sparse import vstack
from support.feet import push, table
from support.springs import STIFFNESS, at_face, stage_list, two_plates
from support.stages import on_the_way
from typer.testing import CliRunner

import mic
from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.laws import find
from mic.contact.path_record import PathRecord
from mic.contact.tangent import Contact, Dual, differentiate_path
from mic.errors import SceneError
from mic.options import app
from mic.process.model import ReducedModel
from mic.process.process import Process
from mic.process.sensitivity import known_inputs, sensitivities
from mic.results.schema import SENSITIVITIES
from mic.scene.deviation import ClampDeviation, FrictionDeviation, LocatorDeviation
from mic.statistics.draw import draw
from mic.studies.sensitivity import effects, steps

EXACT = 1e-7  # of the largest derivative of a key characteristic
STEP = 1e-5  # standard deviations
#: mm, of rows that are eliminated again: smaller steps show rounding, larger ones change the state of a contact.
MOVED = (1e-4, 3e-5, 1e-5, 3e-6)
TIGHT = 1e-12  # of the contact certificate: differences of less would be rounding
SIGMA = {"locator": 0.05, "clamp": 5.0}


def with_positions(model) -> ReducedModel:
    """Every locator and every clamp deviates, too."""
    scene, new = model.scene, []
    for kind, deviation in (("locator", LocatorDeviation), ("clamp", ClampDeviation)):
        new += [
            deviation(name=f"moved.{one.name}", kind=kind, target=one.name, sigma=SIGMA[kind])
            for one in getattr(scene, f"{kind}s")
        ]
    return model.varied(scene.model_copy(update={"deviations": [*scene.deviations, *new]}))


def sigmas(model) -> np.ndarray:
    return np.array([one.sigma for one in model.scene.deviations])


def central(model, values, samples, step=STEP) -> np.ndarray:
    """(n, k, p) central differences of ``values``, a function of deviations (n, p), per standard deviation."""
    σ, p = sigmas(model), samples.shape[1]
    moved = [(samples[:, None] + sign * step * np.diag(σ)).reshape(-1, p) for sign in (1, -1)]
    up, down = (values(x).reshape(len(samples), p, -1) for x in moved)
    return (up - down).transpose(0, 2, 1) / (2 * step)


def off(slope, difference) -> float:
    """The largest error, as a share of the largest derivative of its key characteristic."""
    return (np.abs(slope - difference).max(axis=(0, 2)) / np.abs(difference).max(axis=(0, 2))).max()


def agreeing(process, samples):
    """The derivatives, which must be those of the evaluation by differences."""
    found = sensitivities(process, samples)
    difference = central(process.model, lambda x: process.evaluate(x).measurements, samples)
    assert off(found.jacobian * sigmas(process.model), difference) < EXACT
    return found


@pytest.mark.parametrize(("law", "way"), [("frictionless", "one-step"), ("coulomb", 4), ("associated", 4)])
def test_derivatives_are_those_of_the_evaluation(lap_model, law, way):
    model = with_positions(on_the_way(lap_model, way))
    process, samples = model.process(law, TIGHT), draw(model.scene, 1, 0, 4)
    found, evaluation = agreeing(process, samples), process.evaluate(samples)
    np.testing.assert_allclose(found.measurements, evaluation.measurements, rtol=0, atol=1e-10)
    for stage, contacts in found.contacts.items():
        np.testing.assert_array_equal(contacts.state, evaluation.resolutions[stage].state)


@pytest.mark.parametrize("law", ["micro-slip", "pressure-dependent"])
def test_a_law_that_reads_more_owns_its_tangent(lap_model, law):
    contacts = lap_model.contacts
    if law == "micro-slip":
        changed = {"compliance": np.full(len(contacts), 1e-5)}
    else:
        power = np.array([[0.0, 0.4, -0.02, 0.0, 0.0], [2.0, 0.36, 0.0, 0.0, 0.0]])
        changed = {"pressure": np.tile(power, (len(contacts), 1, 1))}
    model = replace(on_the_way(lap_model, 3), contacts=replace(contacts, **changed))
    agreeing(model.process(law, TIGHT), draw(model.scene, 1, 0, 3))


def frozen(process, steps):
    """Returns a function: key characteristics along paths of these steps, for several samples beside each."""

    def values(samples):
        beside = {key: np.repeat(record, len(samples) // len(record)) for key, record in steps.items()}
        return sensitivities(process, samples, process.model.parameters[:1], beside).measurements

    return values


@pytest.mark.slow
def test_derivatives_along_a_followed_path_are_those_of_its_steps(lap_model):
    model = with_positions(lap_model)
    process, samples = model.process("coulomb", TIGHT), draw(model.scene, 1, 0, 4)
    found = sensitivities(process, samples)
    assert found.exact.all()
    assert {record.order for records in found.steps.values() for record in records} == {2}
    slope = found.jacobian * sigmas(model)
    assert off(slope, central(model, frozen(process, found.steps), samples)) < EXACT
    # Free steps differ by the error of the paths in the key characteristics, over the step of the difference.
    exact, errors = Process(model, "coulomb", TIGHT, path_tolerance=1e-5), []

    def values(x):
        measured = process.evaluate(x).measurements
        errors.append(np.abs(measured - exact.evaluate(x).measurements).max())
        return measured

    free = central(model, values, samples, 0.02)
    assert max(errors) < 1e-3  # mm
    np.testing.assert_allclose(found.measurements, values(samples), rtol=0, atol=max(errors))
    np.testing.assert_allclose(slope, free, rtol=0, atol=max(errors) / 0.02)


@pytest.mark.parametrize("way", [4, "followed"])
def test_friction_of_a_zone_is_an_input(lap_model, way):
    model = on_the_way(lap_model, way)
    process, samples = model.process("coulomb", TIGHT), draw(model.scene, 1, 0, 3)
    zone = f"zones.{model.scene.zones[0].name}.friction"
    found = sensitivities(process, samples, [zone])
    μ, step, values = model.contacts.friction, 1e-4, []
    for sign in (1, -1):
        other = replace(model, contacts=replace(model.contacts, friction=μ + sign * step))
        values.append(sensitivities(other.process("coulomb", TIGHT), samples, [zone], found.steps).measurements)
    difference = (values[0] - values[1]) / (2 * step)
    assert np.abs(difference).max() > 1e-5
    np.testing.assert_allclose(found.jacobian[:, :, 0], difference, rtol=0, atol=EXACT * np.abs(difference).max())


def test_a_locator_and_a_clamp_are_inputs_without_being_deviations(lap_model):
    model, moved = lap_model, with_positions(lap_model)
    samples = draw(model.scene, 1, 0, 2)
    wide = np.column_stack([samples, np.zeros((2, len(moved.parameters) - samples.shape[1]))])
    names = [f"locators.{one.name}" for one in model.scene.locators] + [f"clamps.{x.name}" for x in model.scene.clamps]
    own = [f"moved.{name.partition('.')[2]}" for name in names]
    np.testing.assert_allclose(
        model.sensitivities(samples, "coulomb", names).jacobian,
        moved.sensitivities(wide, "coulomb", own).jacobian,
        rtol=0,
        atol=1e-12,
    )


def with_places(model, share=0.02) -> tuple[ReducedModel, dict]:
    """The model with made-up position rows, as if a weld moved towards a pair, and locators and clamps read pairs as
    they move; and these rows by input."""
    scene, contact, weld = model.scene, model.rows["contact"], model.rows["weld"]
    moving = {f"locators.{scene.locators[2].name}.x": {("locator", 2): share * contact[7]}}
    moving |= {f"clamps.{scene.clamps[0].name}.y": {("clamp", 0): share * contact[30]}}
    moving |= {f"welds.{scene.welds[0].name}.x": {("weld", i): share * (contact[15 + i] - weld[i]) for i in range(3)}}
    names = [name for name, rows in moving.items() for _ in rows]
    moved = [slope for rows in moving.values() for slope in rows.values()]
    return replace(
        model,
        rows=model.rows | {"position": vstack(moved, format="csr")},
        labels=model.labels | {"position": names},
        position_gap=np.full(len(moved), 0.1),
    ), moving


def displaced(model, rows, step) -> ReducedModel:
    """The model whose rows have moved, and with them the first weld's gap."""
    changed = dict(model.rows)
    for (kind, row), slope in rows.items():
        whole = changed[kind].tolil()
        whole[row] = changed[kind][row] + step * slope
        changed[kind] = whole.tocsr()
    gap = model.weld_gap.copy()
    gap[0] += 0.1 * step * any(kind == "weld" for kind, _ in rows)
    return replace(model, rows=changed, weld_gap=gap)


@pytest.mark.slow
@pytest.mark.parametrize(("way", "change"), [("followed", {}), (3, {"close": True})])
def test_a_place_in_the_sheet_is_an_input(lap_model, way, change):
    """The readings of the row elsewhere count, its force there, and the gap of the weld."""
    model = on_the_way(lap_model, way)
    welds = [one.model_copy(update=change) for one in model.scene.welds]
    model, moving = with_places(replace(model, scene=model.scene.model_copy(update={"welds": welds})))
    process, samples = model.process("coulomb", TIGHT), draw(model.scene, 1, 0, 1)
    found = sensitivities(process, samples, list(moving))
    for i, (name, rows) in enumerate(moving.items()):

        def moved(h, name=name, rows=rows):
            process = displaced(model, rows, h).process("coulomb", TIGHT)
            return sensitivities(process, samples, [name], found.steps).measurements

        slopes = [(moved(h) - moved(-h)) / (2 * h) for h in MOVED]
        apart = [np.abs(one - other).max() for one, other in pairwise(slopes)]
        k = int(np.argmin(apart))
        difference = slopes[k]  # the one that a smaller step changes least
        largest = np.abs(difference).max()
        # Its own error: rounding may move two differences alike, so the next larger step counts too.
        erring = max(apart[max(k - 1, 0) : k + 1])
        assert largest > 1e-6 and erring < 1e-5 * largest, name
        within = 10 * EXACT * largest + erring
        np.testing.assert_allclose(found.jacobian[:, :, i], difference, rtol=0, atol=within)


@pytest.mark.fem
@pytest.mark.slow
def test_a_requested_position_moves_like_the_point_of_the_scene(lap_scene, cache):
    """Without zones, whose pairs would go with pads and locators: a weld and a locator, put elsewhere on the meshes."""
    bare = lap_scene.model_copy(update={"zones": []})
    names = [f"welds.{bare.welds[1].name}.x", f"locators.{bare.locators[0].name}.x"]
    moved_items = [name.removesuffix(".x") for name in names]
    report = bare.report.model_copy(update={"positions": moved_items})
    model = mic.reduce(bare.model_copy(update={"report": report}), cache)
    in_plane = {f"{one}.{axis}" for one in moved_items for axis in "xy"}  # the sheets lie in z = 0
    assert set(model.labels["position"]) == in_plane
    found = model.sensitivities({}, "coulomb", names).jacobian[0]
    values = []
    for way in (0.2, -0.2):  # both are moved at once
        items = {"welds": list(bare.welds), "locators": list(bare.locators)}
        for kind, i in (("welds", 1), ("locators", 0)):
            x, y, z = items[kind][i].point
            items[kind][i] = items[kind][i].model_copy(update={"point": (x + way, y, z)})
        values.append(mic.reduce(bare.model_copy(update=items), cache).evaluate({}, "coulomb").measurements)
    np.testing.assert_allclose(found.sum(axis=1), (values[0] - values[1])[0] / 0.4, rtol=0.01)


def test_a_slider_turns_with_its_drag_and_keeps_its_slope_at_rest():
    """Pressed by 1 and dragged by (3, 4): f_t = -μ f_n (0.6, 0.8); across the drag it turns by μ f_n/‖b_t‖.

    It slides to u_t = (2.7, 3.6); a step that moves nothing begins there, with no slip to take a direction from.
    """
    b, slope = np.array([[-1.0, 3.0, 4.0]]), np.array([[[-1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]]])
    contact = Contact(find("coulomb"), Columns.of(np.eye(3)), Friction.of(0.5, 1), np.zeros((1, 3)), 3)
    load, guess = Dual(b, slope), [PathRecord(1, np.ones(1), np.array([[1.0, -0.3, -0.4]]))]
    first = differentiate_path(contact, load, load, Dual(np.zeros((1, 2)), np.zeros((1, 2, 3))), guess)
    again = differentiate_path(contact, load, load, first.anchor, guess)
    expected = np.column_stack([[1, -0.3, -0.4], [0, 0, 0], [0, 0.8 * 0.1, -0.6 * 0.1]])
    for end in (first, again):
        np.testing.assert_allclose(end.force.value[0], [1, -0.3, -0.4], atol=1e-12)
        np.testing.assert_allclose(end.force.slope[0], expected, atol=1e-9)


def test_reach_is_the_distance_to_the_next_change_of_state(lap_model):
    """Just before it the states are those of the sample, just behind it they are not."""
    model = on_the_way(lap_model, "one-step")
    process, samples = model.process("frictionless", TIGHT), draw(model.scene, 1, 0, 6)
    found, σ = sensitivities(process, samples), sigmas(model)
    held = []
    for sample, states in ((i, [c.state[i] for c in found.contacts.values()]) for i in range(len(samples))):
        j = int(np.argmin(found.reach_along[sample]))
        assert found.reach[sample] <= found.reach_along[sample, j] * (1 + 1e-9)
        for share in (0.99, 1.01):
            same = []
            for sign in (1, -1):
                moved = samples[sample] + sign * share * found.reach_along[sample, j] * σ * (np.arange(len(σ)) == j)
                there = process.evaluate(moved[None]).resolutions
                same.append(all((r.state[0] == s).all() for r, s in zip(there.values(), states)))
            held.append(all(same) if share < 1 else not all(same))
    assert all(held)


@pytest.mark.parametrize("name", ["welds.W9", "zones.lap", "", "welds.", "W1", "locators.W1"])
def test_places_that_do_not_exist_are_refused(lap_scene, name):
    keys = lap_scene.model_dump(exclude_none=True)
    keys["report"]["positions"] = [name]
    with pytest.raises(ValidationError, match=rf"report.positions\[0\]: there is no '{re.escape(name)}'; known: "):
        lap_scene.model_validate(keys)


def test_inputs_that_are_not_known_are_refused(lap_model):
    for name, why in (
        ("welds.W1.x", r'give the scene positions = \["welds.W1"\] in \[report\]'),
        ("welds.W1.gun", "it has no gun"),
        ("clamps.C1-upper.limit", "it has no limit"),
        ("zones.lap", "is not an input of this model; known inputs: "),
    ):
        with pytest.raises(ValueError, match=why):
            lap_model.sensitivities({}, inputs=[name])
    with pytest.raises(ValueError, match=r"inputs: 'locators\.nowhere' is not an input of this model; known inputs: "):
        lap_model.sensitivities({}, inputs=["locators.nowhere"])
    with pytest.raises(ValueError, match="name at least one"):
        lap_model.sensitivities({}, inputs=[])
    assert all(σ > 0 for name, σ in known_inputs(lap_model).items() if name in lap_model.parameters)


def resting(force=100.0, gap=(0.02, -0.03, 0.01), **path) -> ReducedModel:
    """b stands on a by three feet, bent by its first deviation, and is pressed down and pushed sideways."""
    return table(
        [push(force), push(0.15 * force, (40, 10, 0), (1, 0.5, 0), "D")],
        gap=gap,
        kinds=("locate", {"kind": "clamp"} | path, "measure"),
        shape=lambda part, p: (part == "b") * np.array([0, 0, 0.01 * p[0] + 0.3]),
        deviations=[
            {"name": "bent", "kind": "force", "part": "b", "point": [0, 0, 0], "direction": [0, 0, 1], "sigma": 0.05},
            {"name": "C", "kind": "clamp", "target": "C", "sigma": 5.0},
            {"name": "D", "kind": "clamp", "target": "D", "sigma": 1.0},
        ],
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "path"), [("coulomb", {}), ("associated", {"increments": 3}), ("coulomb", {"path": "one-step"})]
)
def test_the_position_of_a_resting_part_is_differentiated(law, path):
    """It is placed without overlap, pressed, and slides a little; its position follows the inputs."""
    model = resting(**path)
    process, samples = model.process(law, TIGHT), np.array([[0.1, 0.3, 0.02]])
    found = sensitivities(process, samples)
    evaluation = process.evaluate(samples)
    assert found.exact.all() and not found.failed.any() and not evaluation.failed.any()
    np.testing.assert_allclose(found.measurements, evaluation.measurements, rtol=0, atol=1e-9)
    slope = found.jacobian * sigmas(model)
    assert off(slope, central(model, frozen(process, found.steps), samples, 1e-3)) < EXACT
    assert off(slope, central(model, lambda x: process.evaluate(x).measurements, samples, 1e-3)) < 1e-5


def test_a_loose_part_has_no_derivative():
    found = resting(force=0.0, gap=0.0).sensitivities({}, "coulomb")
    assert found.failed.all() and np.isnan(found.jacobian).all()


def test_positions_of_supports_of_a_resting_part_are_refused():
    model = resting()
    rows = model.rows | {"position": model.rows["locator"][:1]}
    labels = model.labels | {"position": ["locators.al0.x"]}
    model = replace(model, rows=rows, labels=labels, position_gap=np.zeros(1))
    with pytest.raises(
        SceneError, match=r"stages \(locate\): part 'b' rests by contact alone, and derivatives by positions"
    ):
        model.sensitivities({}, "coulomb", ["locators.al0.x"])


def test_friction_that_deviates_has_the_slope_of_its_zone(lap_model):
    scene, name = lap_model.scene, lap_model.scene.zones[0].name
    rough = FrictionDeviation(name="rough", kind="friction", target=name, sigma=0.02)
    model = lap_model.varied(scene.model_copy(update={"deviations": [*scene.deviations, rough]}))
    samples = np.column_stack([draw(scene, 1, 0, 3), [0.0, 0.01, -0.02]])
    found = model.sensitivities(samples, "coulomb", ["rough", f"zones.{name}.friction"])
    np.testing.assert_allclose(found.jacobian[:, :, 0], found.jacobian[:, :, 1], rtol=1e-12)
    assert np.abs(found.jacobian).max() > 1e-5 and found.sigma.tolist() == [0.02, 0.0]
    np.testing.assert_allclose(found.measurements, model.evaluate(samples, "coulomb").measurements, rtol=0, atol=1e-4)


def test_a_table_shows_the_effect_of_a_step_of_each_input(lap_model):
    """A step is taken, and the key characteristics move by what the table says, to second order."""
    model = on_the_way(lap_model, "one-step")
    found = effects(model, "coulomb", 5, seed=1)
    SENSITIVITIES.check(found.table, "memory", "mend it")
    assert list(found.table["input"].unique()) == list(steps(model)) and found.failed == 0
    assert set(found.table["samples"]) == {6}
    assert (found.table["effect_low"] <= found.table["effect"]).all()
    base = model.evaluate({}, "coulomb").measurements[0]
    for deviation in model.scene.deviations:
        step = {deviation.name: deviation.mean + 1e-3 * deviation.sigma}
        moved = 1e3 * (model.evaluate(step, "coulomb").measurements[0] - base)
        printed = found.table.loc[found.table["input"] == deviation.name, "effect"].to_numpy()
        np.testing.assert_allclose(printed, moved, rtol=0, atol=1e-4 * np.abs(found.table["effect"]).max())
    assert 0 < found.reach <= found.table.loc[found.table["input"].isin(model.parameters), "reach"].min()
    assert found.where.split(": ")[0] in [stage.name for stage in model.scene.stages]


def test_the_command_prints_the_table_and_the_reach(lap_model, tmp_path):
    lap_model.save(tmp_path / "model.npz")
    done = CliRunner().invoke(
        app, ["sensitivity", str(tmp_path / "model.npz"), "--samples", "2"], env={"COLUMNS": "200"}
    )
    assert done.exit_code == 0, done.output
    wanted = effects(lap_model, "coulomb", 2, lap_model.scene.monte_carlo.seed)
    assert "Effect of a step of each input" in done.output and wanted.where in done.output
    assert set(wanted.table["measurement"]) == {"M1", "M2"}
    for _, own in wanted.table.groupby("measurement"):
        effect = own.set_index("input")["effect"].abs().sort_values(ascending=False)
        effect = effect[effect > 1e-6]
        assert all(name in done.output for name in effect.index[:6])
        assert len(effect) > 6 and f"{len(effect) - 6} others" in done.output


def test_the_command_prints_both_sides_of_a_change(tmp_path):
    model = pressed(0.3 * STIFFNESS)
    model.save(tmp_path / "model.npz")
    done = CliRunner().invoke(
        app, ["sensitivity", str(tmp_path / "model.npz"), "--samples", "1"], env={"COLUMNS": "200"}
    )
    assert done.exit_code == 0, done.output
    # A tenth of 15 N: 1.5/50 mm below and half of that above.
    assert "-30 below, -15 above" in done.output.replace("−", "-")
    assert "about to change its state (clamp: contact 0 of zone Z" in done.output
    table = effects(model, "coulomb", 1).table.set_index("input").loc["clamps.C"]
    assert [table["effect_below"], table["effect_above"]] == pytest.approx([-0.03, -0.015])


def test_a_scene_that_measures_nothing_has_no_sensitivities(lap_model):
    bare = replace(lap_model, scene=lap_model.scene.model_copy(update={"measurements": []}))
    with pytest.raises(ValueError, match="has no measurements"):
        effects(bare, "coulomb", 1)


def pressed(force, **clamp) -> ReducedModel:
    """b's face, pressed down by a clamp: by w = F/k until it has closed its gap, then by half as much a newton."""
    clamps = [at_face("b", (0, 0, -1), name="C", **({"force": force} | clamp))]
    return two_plates(0.3, clamps=clamps, stages=stage_list("locate", "clamp", "measure"))


@pytest.mark.parametrize("law", ["coulomb", "frictionless", "associated"])
def test_a_change_of_state_has_one_sided_derivatives(law):
    """The clamp's force just closes the gap: the face yields by 1/k a newton below it and by 1/2k above."""
    soft, stiff = -1 / STIFFNESS, -0.5 / STIFFNESS
    for force, sides in ((0.3 * STIFFNESS, [soft, stiff]), (0.29 * STIFFNESS, [soft] * 2), (20.0, [stiff] * 2)):
        found = pressed(force).sensitivities({}, law, {"clamps.C": 1.0})
        np.testing.assert_allclose(found.sides[0, 0, 0], sides, rtol=1e-9)
        assert (found.reach[0] < 1e-6) == (sides[0] != sides[1])
        assert found.where[0] in ("clamp: contact 0 of zone Z closes", "clamp: contact 0 of zone Z opens")


def test_forces_of_limited_clamps_are_inputs():
    """A clamp that does not reach its position pushes with its limit; on one that does, the limit has no effect."""
    soft, stiff = -1 / STIFFNESS, -0.5 / STIFFNESS
    needed = STIFFNESS * (2 * 0.5 - 0.3)
    cases = [(10.0, [soft] * 2), (25.0, [stiff] * 2), (2 * needed, [0.0] * 2), (needed, [stiff, 0.0])]
    for limit, sides in cases:
        model = pressed(None, stroke=0.5, limit=limit)
        assert "clamps.C.limit" in known_inputs(model)
        found = model.sensitivities({}, "coulomb", {"clamps.C.limit": 1.0, "clamps.C": 0.1})
        np.testing.assert_allclose(found.sides[0, 0, 0], sides, rtol=1e-9, atol=1e-12)
        assert limit == needed or found.jacobian[0, 0, 1] == pytest.approx(-1.0 if limit > needed else 0.0, abs=1e-9)
