"""The full contact solve against the reduced one, its convergence, its failures and its ranks."""

import ctypes
import gc
from pathlib import Path

import numpy as np
import pytest
from support.processes import ROOT, on_processes
from support.shared import solved

import mic
from fem_reference.full import equilibrium
from fem_reference.full.equilibrium import NoConvergence
from fem_reference.full.model import ROUTES, ContactFailure, FullModel
from mic.model.assembly import assemble
from mic.model.deviated_geometry import deviated_parts, gap_change
from mic.model.sources import SOURCES
from mic.process.actions import STAGE_MOVES
from mic.statistics.draw import draw
from verification.comparison import apart, difference
from verification.scenes import with_stated_pairs

pytestmark = pytest.mark.fem


def sized(scene, size):
    return scene.model_copy(update={"parts": [part.model_copy(update={"size": size}) for part in scene.parts]})


def going(scene, path, increments=None):
    """The scene with another path in all its stages."""
    change = {"path": path, "increments": increments}
    return scene.model_copy(update={"stages": [stage.model_copy(update=change) for stage in scene.stages]})


@pytest.fixture(scope="module")
def scene(lap_scene):
    """One increment in each step: both routes solve the same problems, and agree whatever the path does to them."""
    return going(sized(lap_scene, "coarse"), "increments", 1)


@pytest.fixture(scope="module")
def lap(scene, cache):
    return assemble(scene, cache)


@pytest.fixture(scope="module")
def lap_model(scene, cache):
    return mic.reduce(scene, cache)


@pytest.fixture(scope="module")
def sample(scene):
    return draw(scene, 5, 0, 1)[0]


@pytest.fixture(scope="module")
def clamped_scene(scene):
    """The lap joint without welds and releases: two solves."""
    stages = [stage for stage in scene.stages if stage.kind not in ("weld", "release")]
    return scene.model_copy(update={"welds": [], "stages": stages})


@pytest.fixture(scope="module")
def clamped(clamped_scene, cache):
    return assemble(clamped_scene, cache)


@pytest.fixture(scope="module")
def clamped_model(clamped_scene, cache):
    return mic.reduce(clamped_scene, cache)


@pytest.fixture(scope="module")
def bracket(cache):
    """Parts, zones and clamps of which no two are alike: what one takes for another's shows."""
    few_pairs = with_stated_pairs(mic.load_scene(ROOT / "meshes" / "bracket"))
    return assemble(going(sized(few_pairs, "coarse"), "increments", 1), cache)


@pytest.fixture(scope="module")
def bracket_model(bracket, cache):
    return mic.reduce(bracket.scene, cache)


def off(full, reduced):
    """Largest relative difference of forces, displacements and measurements over all stages."""
    assert set(full.resolutions) == set(reduced.resolutions)
    return difference(reduced, 0, full).largest


@pytest.mark.parametrize("name, law", [("bracket", "coulomb"), ("lap", "frictionless")])
@pytest.mark.slow
def test_augmented_agrees_with_the_reduced_model_in_all_stages(name, law, request):
    model, assembly = request.getfixturevalue(f"{name}_model"), request.getfixturevalue(name)
    sample = draw(model.scene, 5, 0, 1)[0]
    route = {"bracket": "condensed", "lap": "whole"}[name]  # for the bracket the whole takes a minute
    full, reduced = FullModel(assembly, route=route).evaluate(sample, law), model.evaluate(sample, law)
    assert off(full, reduced) < 1e-8
    for stage, resolution in full.resolutions.items():
        np.testing.assert_array_equal(resolution.state, reduced.resolutions[stage].state[0])


#: One deviation of every kind, at its mean, and a process with every kind of stage.
DEVIATIONS = {
    "force": {"part": "upper", "point": [110, 10, 1], "direction": [0, 0, 1], "mean": 0.5},
    "locator": {"target": "upper-A1", "mean": 0.2},
    "clamp": {"target": "C1-upper", "mean": 10.0},
    "shape": {"part": "lower", "points": [[x, y, 0] for x in (20, 60, 95) for y in (3, 12, 22)], "mean": 1.0}
    | {"values": [0.1, 0.0, -0.1, 0.1, 0.05, 0.0, 0.3, 0.1, -0.1], "loose": True, "noise": 0.02},
    "gravity": {"direction": [0.3, 0, -1], "mean": 1.0},
    "temperature": {"part": "lower", "mean": 30.0},
    "friction": {"target": "lap", "mean": -0.2},
    "thickness": {"part": "upper", "mean": 0.08, "skin": 1},
}
STAGES = [
    {"kind": "locate"},
    {"kind": "clamp", "increments": 1},
    {"kind": "weld", "increments": 1},
    {"kind": "release", "increments": 1, "keep": [f"lower-{name}" for name in ("A1", "A2", "A3", "B1", "B2", "C1")]},
    {"kind": "measure"},
]


@pytest.mark.slow
def test_both_models_agree_on_every_kind_of_deviation_and_stage(scene, cache):
    assert set(DEVIATIONS) == set(SOURCES) and {stage["kind"] for stage in STAGES} == set(STAGE_MOVES)
    deviations = [{"name": kind, "kind": kind, "sigma": 0.0} | keys for kind, keys in DEVIATIONS.items()]
    table = scene.model_dump()
    table["parts"] = [part | {"density": 7850.0, "expansion": 1.2e-5} for part in table["parts"]]
    point = {"name": "M3", "part": "lower", "point": [90, 12.5, 0], "direction": [1, 0, 0], "lower": -1, "upper": 1}
    table["measurements"].append(point)
    table["report"]["fields"] = False  # they hold no expansion
    varied = mic.Scene(**table | {"deviations": deviations, "stages": STAGES, "folder": scene.folder})
    model = mic.reduce(varied, cache)
    means = model.deviations({})[0]
    whole = model.evaluate(means)
    for kind, one in zip(DEVIATIONS, np.diag(means)):
        moved = model.evaluate(means - one).measurements - whole.measurements
        least = 1e-6 if kind == "friction" else 1e-4  # little slips on its way
        assert np.abs(moved).max() > least, f"a deviation of kind {kind} does nothing"
    full = FullModel(assemble(varied, cache), route="condensed").evaluate(means)
    assert off(full, model.evaluate(means)) < 1e-8


@pytest.mark.parametrize("path, increments", [("one-step", None), ("increments", 3)])
@pytest.mark.slow
def test_agreement_holds_on_every_path(clamped_scene, cache, path, increments):
    """All at once, or slip measured from increment to increment: another answer, and the same to both."""
    scene = going(clamped_scene, path, increments)
    sample = draw(scene, 5, 3, 1)[0]
    full, reduced = FullModel(assemble(scene, cache)).evaluate(sample), mic.reduce(scene, cache).evaluate(sample)
    assert off(full, reduced) < 1e-8
    for resolution in full.resolutions.values():
        np.testing.assert_allclose(resolution.trace.share.sum(axis=1), 1.0, rtol=1e-12)
    shares = {solve.share for solve in full.history}
    assert sorted(shares) == pytest.approx([0.25, 0.75, 1.0] if increments else [1.0], abs=1e-15)


@pytest.mark.slow
def test_the_comparison_detects_planted_errors(clamped, clamped_model, sample, monkeypatch):
    """`off` detects omitted friction, shape deviations of the wrong sign and omitted gaps."""
    reduced = clamped_model.evaluate(sample, "coulomb")
    full = FullModel(clamped)
    assert off(full.evaluate(sample, "frictionless"), reduced) > 1e-3
    turned = FullModel(clamped)
    turned.unit_shapes = -full.unit_shapes
    assert off(turned.evaluate(sample, "coulomb"), reduced) > 1e-3
    displacement = equilibrium.ContactLaw.displacement

    def without_gap(self, δ):
        return displacement(self, δ) - self.gap[:, None] * np.array([1, 0, 0])

    monkeypatch.setattr(equilibrium.ContactLaw, "displacement", without_gap)
    assert off(full.evaluate(sample, "coulomb"), reduced) > 1e-3


@pytest.mark.slow
def test_newton_converges_quadratically(scene, cache):
    """Near the solution, with contacts that slip in turning directions, each residual is of the order of the last one
    squared."""
    ratios = []
    lap = assemble(going(scene, "one-step"), cache)
    for sample in draw(scene, 5, 0, 3):
        for solve in FullModel(lap, augmented=False).evaluate(sample).history:
            steady = [i for i in solve.iterations if i.changed == 0 and i.step == 1.0]
            assert steady[-1].slip > 0
            residual = np.array([i.residual for i in steady])
            inner = (residual[:-1] < 1e-2) & (residual[1:] > 1e-10)  # below, rounding takes over
            ratios += list(np.log(residual[1:][inner]) / np.log(residual[:-1][inner]))
    assert len(ratios) >= 3, "too few iterations in the quadratic range to judge"
    assert min(ratios) > 1.7, f"observed orders {ratios}"


@pytest.mark.slow
def test_two_processes_give_the_solution_of_one(tmp_path):
    lap, result = ROOT / "meshes" / "lap_joint", tmp_path / "result.npz"
    done = on_processes(2, "-m", "support.shared", lap, tmp_path / "ours", result)
    assert done.returncode == 0, done.stdout + done.stderr
    with np.load(result) as data:
        found = [data[name] for name in data.files]
    serial = solved(lap, tmp_path / "theirs")
    assert len(found) == len(serial)
    for ours, theirs in zip(found, serial):
        assert np.abs(ours - theirs).max() <= 1e-8 * np.abs(theirs).max()
        assert np.abs(theirs).max() > 0


@pytest.mark.parametrize("count, penalty, shares", [(1, 1e2, [1.0]), (6, 1e3, list(np.arange(1, 9) / 8))])
@pytest.mark.slow
def test_neither_a_softer_penalty_nor_a_cut_increment_changes_the_answer(
    clamped, sample, monkeypatch, count, penalty, shares
):
    """Newton's method is refused at the first penalty, or at every penalty and then in the longest steps."""
    whole = FullModel(clamped, route="condensed").evaluate(sample)
    newton = equilibrium.Equilibrium.newton
    refused = []

    def refuse(self, start, p, v, law):
        if len(refused) < count:
            refused.append(law)
            raise NoConvergence("refused by the test")
        return newton(self, start, p, v, law)

    monkeypatch.setattr(equilibrium.Equilibrium, "newton", refuse)
    cut = FullModel(clamped).evaluate(sample)
    first = [solve for solve in cut.history if (solve.step, solve.augmentation) == (1, 0)]
    assert [solve.share for solve in first] == shares
    assert [solve.penalty for solve in first] == pytest.approx([penalty] * len(shares))
    assert apart(cut, whole) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("route", ROUTES)
def test_a_load_that_does_not_converge_by_one_route_is_solved_by_the_other_and_says_so(
    clamped, sample, monkeypatch, route
):
    other = ROUTES[1 - ROUTES.index(route)]
    chosen = FullModel(clamped, route=route).evaluate(sample)
    assert chosen.route == route and {solve.route for solve in chosen.history} == {route}
    finite = [np.isfinite(solve.penalty) for solve in chosen.history]
    assert all(finite) if route == "whole" else not any(finite)  # Coulomb's law by penalty, or exactly

    def refuse(*given):
        raise NoConvergence("refused by the test")

    monkeypatch.setattr(equilibrium.Equilibrium, {"whole": "newton", "condensed": "condensed"}[route], refuse)
    instead = FullModel(clamped, route=route).evaluate(sample)
    count = len(instead.history)
    assert instead.route == f"{route}, {count} of {count} solves {other}"
    assert {solve.route for solve in instead.history} == {other}
    assert apart(instead, chosen) < 1e-8


@pytest.mark.slow
def test_the_whole_route_forms_no_compliance(clamped, sample, monkeypatch):
    monkeypatch.setattr(equilibrium, "Condensation", None)
    monkeypatch.setattr(equilibrium, "HeldParts", None)
    assert FullModel(clamped).evaluate(sample).route == "whole"
    with pytest.raises(TypeError):
        FullModel(clamped, route="condensed").evaluate(sample)
    with pytest.raises(ValueError, match="route 'both': choose one of whole, condensed"):
        FullModel(clamped, route="both")


def test_a_failure_names_stage_increment_contact_and_remedy(clamped, sample, monkeypatch):
    monkeypatch.setattr(equilibrium, "MAX_ITERATIONS", 1)
    monkeypatch.setattr(equilibrium, "CONDENSED", 0)  # no other route
    with pytest.raises(
        ContactFailure,
        match=r"stage 'clamp', step 1 of 2, at 0 of its load, worst at contact 'lap \d+': "
        r"no convergence.*use increments in this stage, or lower the penalty",
    ):
        FullModel(clamped).evaluate(sample)


def test_a_part_that_nothing_holds_is_refused(scene, cache):
    kept = [stage.model_copy(update={"keep": []}) if stage.kind == "release" else stage for stage in scene.stages]
    assembly = assemble(scene.model_copy(update={"stages": kept}), cache)
    with pytest.raises(mic.SceneError, match="release.* rigid-body motions are free"):
        FullModel(assembly)


@pytest.mark.slow
def test_redundant_locators(clamped_scene, clamped, sample, cache):
    """A second locator at the same place changes nothing while it agrees with the first, and is refused when it does
    not."""
    twin = clamped_scene.locators[0].model_copy(update={"name": "twin"})
    twice = clamped_scene.model_copy(update={"locators": [*clamped_scene.locators, twin]})
    doubled, single = (FullModel(assembly).evaluate(sample) for assembly in (assemble(twice, cache), clamped))
    np.testing.assert_allclose(doubled.measurements, single.measurements, rtol=1e-8)
    moved = twice.deviations[-1].model_copy(update={"kind": "locator", "target": "twin"})
    contradicting = twice.model_copy(update={"deviations": [*twice.deviations[:-1], moved]})
    with pytest.raises(ContactFailure, match="stage 'locate': .* redundant and contradicts"):
        FullModel(assemble(contradicting, cache)).evaluate(sample)


@pytest.mark.slow
def test_deviated_meshes_tend_to_the_nominal_one(clamped, sample):
    """Stiffness, normals and gaps of the deviated geometry differ from the nominal ones in proportion to the
    deviation."""
    change = []
    for scale in (0.01, 1.0):
        nominal, deviated = (
            FullModel(clamped, deviated=deviated, route="condensed").evaluate(scale * sample).measurements
            for deviated in (False, True)
        )
        change.append(np.abs(deviated - nominal).max() / np.abs(nominal).max())
    assert 0 < change[0] < 1e-3 and 2 * change[0] < change[1] < 0.05


def test_deviated_frames_turn_with_the_surface(lap):
    """A part tilted as a whole: normals turn by the tilt, gaps open by the distance, and the stiffness is that of the
    tilted part."""
    angle = 0.02
    fields = {part.name: np.zeros((len(part.surface.points), 6)) for part in lap.parts}
    for part in lap.parts:  # about the y axis, exactly
        x, _, z = part.surface.points.T
        fields[part.name][:, 0] = np.cos(angle) * x + np.sin(angle) * z - x
        fields[part.name][:, 2] = np.cos(angle) * z - np.sin(angle) * x - z
        fields[part.name][:, 4] = np.tan(angle)  # to first order in which normals turn
    parts = deviated_parts(lap, fields)
    labels = lap.parts[0].functionals.label
    normals = [i for i, label in enumerate(labels) if label.startswith("contact") and label.endswith(" n")]
    turned = np.array([np.sin(angle), 0, np.cos(angle)])
    np.testing.assert_allclose(parts[0].functionals.direction[normals], np.tile(turned, (len(normals), 1)), atol=1e-12)
    for part in parts:
        np.testing.assert_allclose(part.surface.corner_normals - turned, 0.0, atol=1e-7)
    read = np.ones(lap.rows["contact"].shape[0])  # no row of a contact reads a rotation
    assert np.abs(gap_change(lap, "contact", parts, read)[::3]).max() < 1e-9
    fields["upper"][:, :3] += 0.1 * turned
    np.testing.assert_allclose(gap_change(lap, "contact", deviated_parts(lap, fields), read)[::3], 0.1, rtol=1e-9)


@pytest.mark.parametrize("order", [1, -1])
def test_a_pair_with_a_fixture_opens_as_its_part_moves_away(bracket, cache, order):
    """The base tilted about a point of the rest's face, far from the origin: with R n the turned normal and the fixture
    standing at x_f, level with c, the gap grows by R n · (c − x_f), or less it where n points at the fixture."""
    zones = [
        zone.model_copy(update={"parts": zone.parts[::order]}) if "rest" in zone.parts else zone
        for zone in bracket.scene.zones
    ]
    rested = assemble(bracket.scene.model_copy(update={"zones": zones}), cache)
    angle, c = 0.02, np.array(rested.scene.fixtures[0].point)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    fields = {part.name: np.zeros((len(part.surface.points), 6)) for part in rested.parts}
    base = next(part for part in rested.parts if part.name == "base")
    fields["base"][:, :3] = (base.surface.points - c) @ (turn - np.eye(3)).T
    fields["base"][:, 4] = np.tan(angle)
    read = np.ones(rested.rows["contact"].shape[0])
    found = gap_change(rested, "contact", deviated_parts(rested, fields), read)[::3]
    own = np.array(["rest" in zone.parts for zone in zones])[rested.contacts.zone]
    normal, foot = rested.contacts.frame[own, :, 0], rested.contacts.point[own].copy()
    foot[:, 2] = c[2]
    assert own.sum() > 3
    expected = order * np.einsum("ki,ki->k", normal @ turn.T, c - foot)
    np.testing.assert_allclose(found[own], expected, atol=1e-9)
    assert np.ptp(expected) > 0.1


def test_the_tilt_of_an_averaged_weld_on_deviated_meshes_is_that_of_the_shape(scene, cache):
    welds = [weld.model_copy(update={"fused": False}) for weld in scene.welds]
    lap = assemble(scene.model_copy(update={"welds": welds}), cache)
    read = 1.0 + np.arange(lap.rows["weld"].shape[0])
    found = gap_change(lap, "weld", lap.parts, read).reshape(-1, 6)
    np.testing.assert_array_equal(found[:, 3:], read.reshape(-1, 6)[:, 3:])
    assert not found[:, :3].any()


def laid(scene, pinned):
    """The lap joint whose upper strip rests on the lower one: pinned in plane, or on friction alone."""
    locators = [one for one in scene.locators if one.part == "lower" or (pinned and one.direction[2] == 0)]
    return scene.model_copy(
        update={
            "parts": [part.model_copy(update={"rests": part.name == "upper"}) for part in scene.parts],
            "locators": locators,
            "deviations": [one for one in scene.deviations if pinned or one.kind != "locator"],
            "report": scene.report.model_copy(update={"laws": ["coulomb", "frictionless"][: 1 + pinned]}),
        }
    )


@pytest.mark.parametrize("increments, law, pinned", [(2, "coulomb", False), (1, "frictionless", True)])
@pytest.mark.slow
def test_both_models_agree_on_a_resting_part(scene, cache, increments, law, pinned):
    """Springs about another place, of another stiffness, and Newton's method for the whole: the same equilibrium."""
    resting = laid(going(scene, "increments", increments), pinned)
    resting = resting.model_copy(update={"welds": [one.model_copy(update={"fused": False}) for one in resting.welds]})
    model = mic.reduce(resting, cache)
    sample = draw(resting, 5, 0, 1)[0]
    full, reduced = FullModel(assemble(resting, cache)).evaluate(sample, law), model.evaluate(sample, law)
    assert not reduced.failed.any() and off(full, reduced) < 1e-6
    np.testing.assert_allclose(reduced.resolutions["clamp"].force[0, :, 0].sum(), 60.0, rtol=1e-8)


@pytest.mark.slow
def test_the_full_solve_reports_a_part_that_is_pushed_off(scene, cache):
    """Friction holds 0.27 times the 60 N that press; twice that pull along x."""
    resting = laid(scene, pinned=False)
    pull = resting.clamps[0].model_copy(update={"name": "pull", "direction": (1.0, 0.0, 0.0), "force": 0.0})
    more = mic.Scene(
        **resting.model_dump()
        | {
            "clamps": [clamp.model_dump() for clamp in (*resting.clamps, pull)],
            "stages": [{"kind": "locate"}, {"kind": "clamp", "increments": 1}, {"kind": "measure"}],
            "welds": [],
            "deviations": [{"name": "D", "kind": "clamp", "target": "pull", "sigma": 1.0}],
            "folder": resting.folder,
        }
    )
    assembly = assemble(more, cache)
    with pytest.raises(ContactFailure, match="'clamp', step 3 .* moved more than 10 mm .* N without finding support"):
        FullModel(assembly).evaluate(np.array([32.0]))
    np.testing.assert_array_equal(mic.reduce(more, cache).evaluate(np.array([[10.0], [32.0]])).failed, [False, True])


@pytest.mark.slow
def test_factors_are_freed_with_their_model(clamped, sample):
    """A study that makes a model per sample would run out of memory: here 17 MB each, in earnest hundreds."""
    memory = []
    for _ in range(3):
        FullModel(clamped).evaluate(sample)
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        memory.append(int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6)
    assert memory[-1] - memory[0] < 20, f"MB after each model: {memory}"
