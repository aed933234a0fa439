"""Stiffness of the mean shape, and to first order of each sample's, against finite elements on meshes that carry it."""

from __future__ import annotations

import gc
from dataclasses import replace
from functools import cache as memoised
from types import SimpleNamespace

import numpy as np
import pytest
from support.deviated import WARM, hat, lap, read
from typer.testing import CliRunner

import mic
from fem_reference.full.model import FullModel
from mic.errors import ImpossibleSample, SceneError
from mic.model.assembly import assemble
from mic.model.reduction import Reduction
from mic.options import app
from mic.process.model import ReducedModel
from mic.process.process import Process
from mic.process.stiffness import coefficients, select_shapes
from mic.process.stiffness_choice import choose_stiffness, stiffness_sentences
from verification.comparison import difference, reduced_and_assembly, reduced_model
from verification.stiffness import DeviatedStiffness

pytestmark = pytest.mark.fem
STEP = 0.2  # N, of the force that bends the upper sheet


def with_scene(assembly, **keys):
    """The assembly with other keys of its scene that leave its meshes and rows as they are."""
    return replace(assembly, scene=assembly.scene.model_copy(update=keys))


@pytest.fixture(scope="module")
def built(cache):
    """The models of three stiffnesses of the lap joint, and the assembly of the last."""
    assembly = assemble(read(lap("nominal")), cache)
    assemblies = {name: with_scene(assembly, stiffness=name) for name in ("nominal", "mean", "first-order")}
    return {name: reduced_model(one, cache) for name, one in assemblies.items()}, assemblies["first-order"]


@pytest.fixture(scope="module")
def on_own_mesh(built):
    """The full solution on the mesh of a sample whose force is so many steps from its mean."""
    full, mean = FullModel(built[1], deviated=True, route="condensed"), built[0]["mean"].deviations({})[0]
    return memoised(lambda steps: full.evaluate(mean + [steps * STEP, 0.0]))


def test_frames_turn_with_both_sheets_whatever_their_order(built, cache):
    """The upper sheet turns and the lower does not; frames that turned with the first part moved slips by 0.011 mm."""
    scene = read(lap("first-order"))
    other = reduced_model(assemble(scene.model_copy(update={"parts": scene.parts[::-1]}), cache), cache)
    model = built[0]["first-order"]
    sample = model.deviations({}) + [STEP, 0.0]
    one, two = (each.process().evaluate(sample).resolutions["clamp"] for each in (model, other))
    assert two.displacement == pytest.approx(one.displacement, abs=1e-12)
    assert two.force == pytest.approx(one.force, abs=1e-9)


def processes_alive():
    """Number of prepared processes in memory."""
    gc.collect()
    return sum(isinstance(one, Process) for one in gc.get_objects())


def test_samples_with_a_stiffness_of_their_own_keep_one_process_alive(built):
    """Each holds compliances, so that the processes of a batch would fill the memory."""
    model = built[0]["first-order"]
    samples = model.deviations({})[0] + STEP * np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    process = model.process()
    before = processes_alive()
    found = process.evaluate(samples)
    assert processes_alive() <= before + 1
    alone = process.evaluate(samples[:1])
    assert (found.functional_force[0] == alone.functional_force[0]).all() and (found.motion[0] == alone.motion[0]).all()


def planted(model, gap=1.0, H=1.0, G=1.0):
    """With these multiples of its derivatives."""
    own = model.slopes
    changed = {"H": tuple(H * each for each in own.H), "G": tuple(G * each for each in own.G)}
    return replace(model, slopes=replace(own, **changed, gap=gap * own.gap, weld_gap=gap * own.weld_gap))


def test_the_mean_sample_is_that_of_full_elements_on_its_own_mesh(built, on_own_mesh):
    nominal, mean, first = built[0].values()
    assert difference(mean.evaluate({}), 0, on_own_mesh(0)).largest < 1e-7
    assert difference(nominal.evaluate({}), 0, on_own_mesh(0)).largest > 1e-3
    a, b = mean.evaluate({}), first.evaluate({})
    np.testing.assert_array_equal(a.measurements, b.measurements)
    for stage, one in a.resolutions.items():
        np.testing.assert_array_equal(one.force, b.resolutions[stage].force)


def test_the_error_is_of_second_order(built, on_own_mesh):
    """A shape twice as far off the mean has four times the error; wrong derivatives, or none, leave twice."""
    models, _ = built
    model, mean = models["first-order"], models["mean"].deviations({})[0]

    def error(one, steps):
        return np.abs(one.evaluate(mean + [steps * STEP, 0.0]).measurements[0] - on_own_mesh(steps).measurements).max()

    assert 1.8 < np.log2(error(model, 2) / error(model, 1)) < 2.3
    for wrong in (models["mean"], planted(model, H=-1), planted(model, H=0), planted(model, G=0)):
        assert 0.8 < np.log2(error(wrong, 2) / error(wrong, 1)) < 1.3
    assert error(model, 2) < 0.05 * error(models["mean"], 2) and error(models["mean"], 2) < 0.6 * error(
        models["nominal"], 2
    )


@pytest.mark.slow
def test_gaps_go_with_each_sample(cache):
    """On the hat, whose bends turn; between flat sheets normals turn with the gap and leave it as it was."""
    model, assembly = reduced_and_assembly(read(hat("first-order"), "hat_on_plate"), cache)
    full, mean = FullModel(assembly, deviated=True, route="condensed"), model.deviations({})[0]
    of_mean, change = replace(model, slopes=None), model.contacts.gap - assembly.contacts.gap
    on_mean = full.evaluate(mean)
    assert difference(of_mean.evaluate(mean), 0, on_mean).largest < 1e-7
    wrong = replace(of_mean, contacts=replace(model.contacts, gap=assembly.contacts.gap - change))
    assert difference(wrong.evaluate(mean), 0, on_mean).largest > 0.01
    spread = np.array([item.sigma for item in model.scene.deviations])
    sample = mean + spread * np.where(np.arange(len(spread)) % 2, -1.0, 1.0)
    on_own = full.evaluate(sample)
    right = difference(model.evaluate(sample), 0, on_own).largest
    for wrong in (planted(model, gap=0), planted(model, gap=-1), of_mean):
        assert difference(wrong.evaluate(sample), 0, on_own).largest > 5 * right


def test_batches_and_saved_models_agree_and_extreme_samples_are_refused(built, tmp_path):
    model = built[0]["first-order"]
    samples = model.deviations({}) + np.array([[0.0, 0.0], [1.0, 0.5], [1.0, -0.5], [-7.6, 0.0], [2.0, 0.0]])
    found = model.process().attempt(samples)
    assert found.failed.tolist() == [False, False, False, True, False]
    assert "F is -12.6, outside the range -12.5 to 2.5" in found.resolutions["clamp"].status[3]
    model.save(tmp_path / "model.npz")
    again = ReducedModel.load(tmp_path / "model.npz")
    for i in (0, 1, 2, 4):
        for one in (model, again):
            np.testing.assert_array_equal(one.evaluate(samples[i]).measurements[0], found.measurements[i])
    with pytest.raises(ImpossibleSample, match="give it a larger sigma"):
        model.with_deviations(samples[3])


def test_the_stiffness_of_a_sample_does_not_depend_on_the_sample_before(built):
    model = built[0]["first-order"]
    there, back = np.array([-6.0, 41.0]), model.deviations({})[0]
    again = model.with_deviations(there).with_deviations(back)
    for H, G, own, rigid in zip(again.compliance.H, again.compliance.G, model.compliance.H, model.compliance.G):
        np.testing.assert_allclose(H, own, atol=1e-12 * np.abs(own).max())
        np.testing.assert_allclose(G, rigid, atol=1e-12 * np.abs(rigid).max())
    np.testing.assert_allclose(again.contacts.gap, model.contacts.gap, atol=1e-15)


def test_friction_may_vary_beside_it(built):
    model = built[0]["first-order"]
    rough = mic.scene.deviation.FrictionDeviation(name="R", kind="friction", target="lap", sigma=0.02)
    varied = model.varied(model.scene.model_copy(update={"deviations": [*model.scene.deviations, rough]}))
    found = varied.evaluate({"R": 0.05, "F": -6.0}).resolutions["clamp"].force
    contacts = model.contacts
    rougher = replace(model, contacts=replace(contacts, friction=contacts.friction + 0.05))
    expected = rougher.evaluate({"F": -6.0}).resolutions["clamp"].force
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())
    assert np.abs(found - varied.evaluate({"F": -6.0}).resolutions["clamp"].force).max() > 1e-4 * np.abs(expected).max()


@pytest.mark.slow
def test_candidates_and_limited_forces_use_the_stiffness_of_the_sample(cache):
    """As in a model that has the sample's compliance and gaps from the beginning."""
    table = lap("first-order")
    table["zones"][0] |= {"pairs": None, "spacing": 8.0}
    table["clamps"] = [clamp | {"force": 2.0} for clamp in table["clamps"]]
    table["welds"] = [weld | {"gun": 0.5} for weld in table["welds"]]
    model, _ = reduced_and_assembly(read(table), cache)
    sample = np.array([-6.5, 40.0])
    alone = replace(model.with_deviations(sample), slopes=None).evaluate(sample)
    found = model.process().attempt(np.array([model.deviations({})[0], sample]))
    assert model.contacts.watched.all() and not found.failed.any()
    needed = alone.resolutions["weld"].needed[0]
    assert np.isfinite(needed).all()
    for mine, own in (
        (found.measurements[1], alone.measurements[0]),
        (found.resolutions["weld"].needed[1], needed),
        (found.resolutions["weld"].force[1], alone.resolutions["weld"].force[0]),
    ):
        np.testing.assert_allclose(mine, own, rtol=1e-6, atol=1e-7 * np.abs(own).max())
    assert np.abs(found.resolutions["weld"].needed[0] / needed - 1).max() > 0.01


def test_derivatives_agree_with_finite_differences(built):
    model = built[0]["first-order"]
    at, step = np.array([-6.0, 40.5]), 1e-3
    found = model.sensitivities(at)
    for i in range(2):
        high, low = (model.evaluate(at + way * step * np.eye(2)[i]) for way in (1, -1))
        between = (high.measurements - low.measurements)[0] / (2 * step)
        np.testing.assert_allclose(found.jacobian[0, :, i], between, rtol=1e-5, atol=1e-9)
        force = (high.resolutions["clamp"].force - low.resolutions["clamp"].force) / (2 * step)
        np.testing.assert_allclose(found.contacts["clamp"].force_slope[..., i], force, atol=1e-4 * np.abs(force).max())
    frozen = replace(model.with_deviations(at), slopes=None).sensitivities(at).jacobian[0, :, 0]
    assert np.abs(frozen / found.jacobian[0, :, 0] - 1).max() > 0.01
    np.testing.assert_array_equal(found.sides[0, :, 0], np.repeat(found.jacobian[0, :, :1], 2, axis=1))


@pytest.mark.slow
def test_each_part_that_a_source_deforms_is_computed_once_and_a_check_counts_them(tmp_path, monkeypatch):
    """The force deforms the upper sheet, and turns the frames of both; the warm one only grows: it is left out."""
    monkeypatch.setenv("MIC_CACHE", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assembly = assemble(read(lap("first-order")), tmp_path)
    said: list[str] = []
    monkeypatch.setattr("mic.commands.check.load_scene", lambda *_: assembly.scene)
    monkeypatch.setattr("mic.report.check_page.check_page", lambda *_: "")

    def printed():
        output = CliRunner().invoke(app, ["check", "scene"], env={"COLUMNS": "200"}).output
        return next(line for line in output.splitlines() if "to first order" in line)

    each = "; each sample needs its own model, which takes many times as long"
    assert (
        printed()
        == f"• stiffness to first order in up to F, W: at most 10 further sets of influence coefficients{each}"
    )
    coefficients(with_scene(assembly, stiffness="nominal"), tmp_path, said.append)
    omitted = "F (1 more, with 0.0% of the rotations of the sheets, are left out)"
    further = f"• stiffness to first order in {omitted}: 6 further sets of influence coefficients"
    assert printed() == f"{further}, 6 to be computed{each}"
    found, cached = coefficients(assembly, tmp_path, said.append)
    assert cached == {"lower": False, "upper": False} and f"stiffness to first order in {omitted}" in said
    bent = [f"{part} at F {sign} 1 σ" for part in ("lower", "upper") for sign in "+−"]
    names = ["lower", "upper", "lower", "upper", *bent]  # nominal, warm and bent
    assert [line.split(":")[0] for line in said if line.startswith("influence")] == [
        f"influence coefficients of {name}" for name in names
    ]
    assert set(found["upper"].slopes) == {"F"} == set(found["lower"].slopes)
    again: list[str] = []
    assert coefficients(assembly, tmp_path, again.append)[1] == {"lower": True, "upper": True}
    assert not any(line.startswith("influence") for line in again)


def several(sigmas, **keys):
    """The lap joint with a force at each of several places, of these standard deviations."""
    places = ([65, 20, 1], [80, 10, 1], [95, 5, 1], [110, 20, 1])
    forces = [
        {"name": f"F{i}", "kind": "force", "part": "upper", "point": place, "mean": -1.0, "sigma": sigma}
        for i, (place, sigma) in enumerate(zip(places, sigmas))
    ]
    return lap("first-order", deviations=[*forces, WARM], **keys)


@pytest.fixture(scope="module")
def with_forces(cache):
    """Returns the assembly with forces of given standard deviations, and the shapes that its stiffness needs."""
    assembly = assemble(read(several([1.0] * 4)), cache)
    of_nominal = with_scene(assembly, stiffness="nominal")
    nominal = Reduction.build(of_nominal, coefficients(of_nominal, cache)[0])

    def choose(sigmas, **keys):
        own = replace(assembly, scene=read(several(sigmas, **keys)))
        return own, select_shapes(own, nominal)

    return choose


def test_small_sources_are_omitted_up_to_a_tenth_in_total(with_forces):
    chosen = lambda sigmas, **keys: with_forces(sigmas, **keys)[1]
    every = chosen([1.0] * 4)
    assert list(every.along) == ["F0", "F1", "F2", "F3"] and every.omitted == 1 and every.share < 1e-3
    turned = {
        name: np.sqrt(np.mean(np.sum(fields["upper"][:, 3:] ** 2, axis=1))) for name, fields in every.along.items()
    }
    small = 0.07 * turned["F0"] / np.array([turned["F1"], turned["F2"]])
    own = np.array(list(turned.values())) * [1.0, *small, 1.0]
    fewer = chosen([1.0, *small, 1.0])
    assert list(fewer.along) == ["F0", "F3"] and fewer.omitted == 3
    assert fewer.share == pytest.approx(np.linalg.norm(own[1:3]) / np.linalg.norm(own), rel=1e-3)
    assert 0.05 < fewer.share < 0.1
    assert "F1" in chosen([1.0, *(3.0 * small), 1.0]).along
    together = {"deviations": ["F1", "F2"], "matrix": [[1.0, 0.99], [0.99, 1.0]]}
    assert list(chosen([1.0, *small, 1.0], correlations=[together]).along) == ["F0", "F1", "F2", "F3"]
    assert list(chosen([1.0, 0.0, 0.0, 0.0]).along) == ["F0"]


@pytest.mark.slow
def test_the_error_of_omitted_sources_is_about_the_stated_share(with_forces, cache):
    """Relative to the error of the mean shape's stiffness, it is at most twice the share of the omitted rotations."""
    sigmas = [1.0, 0.08, 0.08, 0.08]
    assembly, shapes = with_forces(sigmas)
    model, share = reduced_model(assembly, cache), shapes.share
    assert model.slopes.source.tolist() == [0] and share > 0.04
    mean, stiffness, off = replace(model, slopes=None), DeviatedStiffness(assembly, model), {"mean": [], "first": []}
    signs = np.array([[1, 1, 1, 1, 0], [1, -1, -1, -1, 0]])
    for sample in model.deviations({}) + signs * [*sigmas, 0.0]:
        own = stiffness.at(sample).evaluate(sample).measurements
        for name, one in (("mean", mean), ("first", model)):
            off[name].append(one.evaluate(sample).measurements - own)
    left = np.sqrt(np.mean(np.square(off["first"])) / np.mean(np.square(off["mean"])))
    assert 0.25 * share < left < 2 * share


def test_several_processes_agree_on_the_shapes(built, cache):
    """The first process selects the shapes and returns coefficients; another one receives the shapes from it."""
    sent: list = []

    def send(value):
        sent.append(value)
        return value

    own, first = coefficients(built[1], cache, comm=SimpleNamespace(rank=0, bcast=send))
    again = iter(sent)
    others, second = coefficients(built[1], cache, comm=SimpleNamespace(rank=1, bcast=lambda _: next(again)))
    assert len(sent) == 3 and first == second == {"lower": True, "upper": True} and others == {}
    one, other = ReducedModel.build(built[1], own).slopes, built[0]["first-order"].slopes
    np.testing.assert_array_equal(one.H[1], other.H[1])
    np.testing.assert_array_equal(one.gap, other.gap)


def test_parts_without_a_mean_shape_have_the_nominal_stiffness(built, cache):
    only_force = [lap("mean", 0.0)["deviations"][0]]
    found, _ = reduced_and_assembly(read(lap("mean", 0.0, deviations=only_force)), cache)
    for H, nominal in zip(found.compliance.H, built[0]["nominal"].compliance.H):
        np.testing.assert_array_equal(H, nominal)


@pytest.mark.parametrize(
    ("mean", "scatter", "suitable"),
    [(0.23, 0.0, "nominal"), (0.27, 0.0, "first-order"), (0.0, 0.28, "first-order")],
)
def test_auto_chooses_by_the_deviation_over_the_thickness(mean, scatter, suitable, built, cache):
    """In thicknesses, the reading of the upper sheet that moves most; the lower sheet grows and is not bent."""
    nominal, assembly = built[0]["nominal"], built[1]
    upper = assembly.parts[1]
    moved = nominal.shape[nominal.compliance.functionals[1], 0][~upper.functionals.rotation]
    unit = upper.thickness / np.abs(moved).max()  # N
    force, warm = assembly.scene.deviations
    forces = [force.model_copy(update={"mean": mean * unit, "sigma": scatter * unit})]
    forces.append(warm.model_copy(update={"mean": 1e4, "sigma": 1e3}))
    at = lambda **keys: with_scene(assembly, deviations=forces, **keys)
    found = choose_stiffness(at(stiffness="auto"), nominal)
    assert found.stiffness == found.suitable == suitable and found.part == "upper"
    assert found.deviation == pytest.approx(np.hypot(mean, scatter), rel=0.03)
    advice = stiffness_sentences(at(stiffness="nominal"), nominal)
    assert bool(advice) == (suitable != "nominal") and all('stiffness = "auto"' in one for one in advice)
    fields = at(stiffness="auto", report=assembly.scene.report.model_copy(update={"fields": True}))
    assert choose_stiffness(fields, nominal).stiffness == "nominal"
    assert ("report.fields" in stiffness_sentences(fields, nominal)[0]) == bool(advice)


@pytest.mark.slow
def test_auto_builds_the_model_of_the_chosen_stiffness(built, cache):
    auto, said = with_scene(built[1], stiffness="auto"), []
    found, _ = coefficients(auto, cache, said.append)
    assert any("each sample's shape, to first order" in line and "upper deviates by 0." in line for line in said)
    model = ReducedModel.build(auto, found)
    np.testing.assert_array_equal(model.compliance.H[1], built[0]["first-order"].compliance.H[1])
    assert model.slopes is not None


THICK = [{"name": "T", "kind": "thickness", "part": "upper", "sigma": 0.02}]


@pytest.mark.parametrize(
    ("stiffness", "keys", "said"),
    [
        ("first-order", {"report": {"laws": ["coulomb"], "fields": True}}, "report.fields.*fields need stiffness"),
        ("first-order", {"deviations": THICK}, r"deviations\[0\] \(T\): it needs stiffness"),
        ("first-order", {"optimise": {"orders": [{"stage": "clamp"}]}}, "optimise: it needs stiffness"),
        ("mean", {"report": {"laws": ["coulomb"], "fields": True}}, "report.fields"),
        ("mean", {"deviations": THICK}, r"deviations\[0\] \(T\)"),
        ("own", {}, "stiffness"),
    ],
)
def test_scenes_that_need_the_nominal_stiffness_are_refused(stiffness, keys, said):
    with pytest.raises(SceneError, match=said):
        read(lap("mean") | {"stiffness": stiffness} | keys)


@pytest.mark.parametrize(
    ("stiffness", "stored"), [("mean", "nominal"), ("first-order", "nominal"), ("first-order", "mean")]
)
def test_coefficients_of_another_stiffness_are_refused(cache, built, stiffness, stored):
    found, _ = coefficients(with_scene(built[1], stiffness=stored), cache)
    with pytest.raises(SceneError, match="stiffness"):
        ReducedModel.build(with_scene(built[1], stiffness=stiffness), found)
