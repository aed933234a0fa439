"""Friction of a zone by stage and by pressure, and yielding contacts, on the lap joint."""

import numpy as np
import pytest

import mic
from mic.contact.laws import find
from mic.model.assembly import assemble
from mic.process.model import ReducedModel
from mic.statistics.draw import draw

TABLE = [(0.0, 0.4), (0.05, 0.3), (0.2, 0.25)]  # of the pressures that the lap joint's clamps make
POWER = {"mu0": 0.3, "p0": 0.05, "n": 0.3, "mu_min": 0.1, "mu_max": 0.6}
YIELDING = 2e3  # N/mm³


def with_zone(scene, **keys):
    """The scene with keys of its zone, each stage in three increments."""
    table = scene.model_dump(exclude={"setting"}, exclude_none=True) | {"folder": scene.folder}
    table["zones"] = [zone | {"pairs": 12} | keys for zone in table["zones"]]
    for stage in table["stages"]:
        if stage["kind"] in ("clamp", "weld", "release"):
            stage |= {"path": "increments", "increments": 3}
    if "friction_table" in keys or "friction_power" in keys:
        table["report"]["laws"] = ["coulomb", "pressure-dependent"]
    if "tangential_stiffness" in keys:
        table["report"]["laws"] = ["coulomb", "micro-slip"]
    return mic.Scene(**table)


@pytest.fixture(scope="module")
def evaluated(lap_scene, cache):
    """``evaluate(law, keys of the zone)`` → model and evaluation of four samples."""
    known = {}

    def evaluate(law="coulomb", **keys):
        key = law, repr(keys)
        if key not in known:
            model = mic.reduce(with_zone(lap_scene, **keys), cache)
            known[key] = model, model.evaluate(draw(model.scene, 3, 0, 4), law)
        return known[key]

    return evaluate


def same(one, other, tolerance=0.0):
    for stage, a in one.resolutions.items():
        b = other.resolutions[stage]
        for quantity in ("force", "displacement", "state"):
            x, y = getattr(a, quantity), getattr(b, quantity)
            np.testing.assert_allclose(x, y, rtol=0, atol=tolerance * max(np.abs(y).max(), 1e-300))
    np.testing.assert_allclose(one.measurements, other.measurements, rtol=0, atol=tolerance)


def ratio(resolution):
    """Largest ``‖f_t‖/f_n`` of each sample's loaded contacts; forces are exact to 1e-10 of the largest."""
    f = resolution.force
    loaded = f[..., 0] > 1e-3 * f[..., 0].max()
    return np.where(loaded, np.hypot(f[..., 1], f[..., 2]) / np.where(loaded, f[..., 0], 1.0), 0.0).max(axis=1)


@pytest.mark.slow
def test_each_stage_has_its_own_friction(evaluated):
    model, by_stage = evaluated(friction={"clamp": 0.05, "default": 0.3})
    clamp, release = by_stage.resolutions["clamp"], by_stage.resolutions["release"]
    np.testing.assert_allclose(ratio(clamp), 0.05, rtol=1e-6)
    assert ratio(release).max() == pytest.approx(0.3, rel=1e-6)
    assert model.contacts.friction_in("clamp").coefficient.max() == 0.05
    assert model.contacts.friction_in("weld").coefficient.min() == 0.3
    # The stage before does not notice, the one after does.
    _, before = evaluated(friction=0.05)
    np.testing.assert_allclose(clamp.force, before.resolutions["clamp"].force, atol=1e-9)
    assert np.abs(release.force - before.resolutions["release"].force).max() > 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("keys", [{"friction_table": TABLE}, {"friction_power": POWER}], ids=["table", "power"])
def test_slipping_pairs_have_the_friction_of_their_pressure(evaluated, keys):
    model, found = evaluated("pressure-dependent", **keys)
    assert not found.failed.any()
    slipping, held = 0, []
    for resolution in found.resolutions.values():
        f = resolution.force
        p = f[..., 0] / model.contacts.area
        mu = np.interp(p, *np.array(TABLE).T)
        if "friction_power" in keys:
            mu = np.clip(0.3 * (np.maximum(p, 1e-300) / 0.05) ** -0.3, 0.1, 0.6)
        traction = np.hypot(f[..., 1], f[..., 2])
        slips = resolution.state == 2
        slipping += slips.sum()
        held += [*mu[slips]]
        scale = f[..., 0].max()
        np.testing.assert_allclose(traction[slips], (mu * f[..., 0])[slips], atol=1e-8 * scale)
        assert (traction <= mu * f[..., 0] + 1e-8 * scale).all()
    assert slipping > 20 and np.ptp(held) > 0.05  # the pressures differ, and so does what holds


@pytest.mark.slow
def test_a_table_of_one_point_is_coulombs_law(evaluated):
    _, constant = evaluated("pressure-dependent", friction_table=[(1.0, 0.27)], friction=0.0)
    _, coulomb = evaluated("coulomb", friction=0.27)
    same(constant, coulomb, 1e-9)


@pytest.mark.slow
def test_yielding_contacts_move_in_proportion_to_their_forces(evaluated):
    """A loaded pair moves relative to its slider by ``-c Δf_t``, ``c = 1/(k_t A)``; stiff pairs obey Coulomb's law."""
    model, found = evaluated("micro-slip", tangential_stiffness=YIELDING, friction=0.27)
    np.testing.assert_array_equal(model.contacts.bearing, model.contacts.area)  # of a patch as large as its pair's
    _, coulomb = evaluated("coulomb", friction=0.27)
    c = 1.0 / (YIELDING * model.contacts.area)
    before, followed = np.zeros_like(found.resolutions["clamp"].force), 0
    for resolution in found.resolutions.values():
        loaded = (resolution.trace.share[..., 0] < 1e-9) & (before[..., 0] > 0.0)
        yielded = resolution.displacement[..., 1:] + c[:, None] * (resolution.force - before)[..., 1:]
        followed += loaded.sum()
        np.testing.assert_allclose(yielded[loaded], resolution.trace.slip[loaded], atol=1e-10)
        before = resolution.force
    assert followed > 5
    assert np.abs(found.measurements - coulomb.measurements).max() > 1e-5
    _, stiff = evaluated("micro-slip", tangential_stiffness=1e12, friction=0.27)
    same(stiff, coulomb, 1e-5)


@pytest.mark.slow
def test_zones_with_different_friction_functions_can_be_combined(lap_scene, cache):
    """Under one law: a zone with a long table, one with a short, one with friction by stage alone."""
    scene = with_zone(lap_scene, pairs=6)
    zone = scene.zones[0]
    regions = [((x0, 0.0, -5.0), (x1, 25.0, 5.0)) for x0, x1 in ((0.0, 70.0), (70.0, 80.0), (80.0, 160.0))]
    keys = ({"friction_table": TABLE}, {"friction_table": [(1.0, 0.7)]}, {"friction": {"clamp": 0.1, "default": 0.3}})
    zones = [
        zone.model_copy(update={"name": f"lap{i}", "box": box} | own) for i, (box, own) in enumerate(zip(regions, keys))
    ]
    contacts = assemble(scene.model_copy(update={"zones": zones}), cache).contacts
    law = find("pressure-dependent")
    for stage, alone in (("clamp", 0.1), ("release", 0.3)):
        force = np.linspace(0.1, 30.0, len(contacts))
        found = law.coefficient(law.parameters(contacts.friction_in(stage)), force)
        table = np.interp(force / contacts.area, *np.array(TABLE).T)
        np.testing.assert_allclose(found, np.choose(contacts.zone, [table, 0.7, alone]), rtol=1e-12)
    assert set(contacts.zone) == {0, 1, 2}


@pytest.mark.slow
def test_pressure_is_the_force_over_the_patch_area(lap_scene, cache):
    disc = assemble(with_zone(lap_scene, patch=3.0, tangential_stiffness=YIELDING), cache).contacts
    np.testing.assert_allclose(disc.bearing, np.pi * 9.0)
    np.testing.assert_allclose(disc.compliance, 1.0 / (YIELDING * np.pi * 9.0))


@pytest.mark.slow
def test_a_saved_model_keeps_its_friction(evaluated, tmp_path):
    model, found = evaluated("pressure-dependent", friction_table=TABLE, friction={"clamp": 0.1, "default": 0.3})
    model.save(tmp_path / "model.npz")
    loaded = ReducedModel.load(tmp_path / "model.npz")
    same(loaded.evaluate(found.deviations, "pressure-dependent"), found)
    assert loaded.contacts.friction_in("clamp").coefficient[0] == 0.1
