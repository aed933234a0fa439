"""Properties of the process that hold for any contact solution, and the memory of friction."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from support.stages import on_the_way, with_stages
from threadpoolctl import threadpool_info, threadpool_limits

import mic
from mic.contact import ContactSolver
from mic.contact.path import Followed, Increments
from mic.process.process import Process
from mic.process.stage import LEAST_MOTION
from mic.statistics.draw import draw
from mic.system.matrix_product import one_thread

ROOT = Path(__file__).resolve().parents[1]


def with_kinds(model, *kinds):
    """The model with its stages of these kinds alone."""
    return with_stages(model, [stage for stage in model.scene.stages if stage.kind in kinds])


def readings(model, evaluation):
    """All retained functionals in the last stage, the shape deviation included."""
    compliance = model.compliance
    return compliance.displace(evaluation.functional_force) + compliance.carry(evaluation.motion)


@pytest.mark.parametrize(
    "name, law", [("lap_model", "frictionless"), pytest.param("hat_model", "coulomb", marks=pytest.mark.slow)]
)
def test_forces_balance_and_reproduce_the_measurements(name, law, request):
    model = request.getfixturevalue(name)
    evaluation = model.process(law).evaluate(draw(model.scene, 3, 0, 6))
    force = evaluation.functional_force
    largest = np.concatenate([np.abs(G).max(axis=0) for G in model.compliance.G])
    scale = np.abs(force).sum(axis=1)[:, None] * largest
    assert (np.abs(model.compliance.rigid(csr_matrix(force))) <= 1e-9 * scale).all()
    measured = readings(model, evaluation) @ model.rows["measurement"].T
    np.testing.assert_allclose(measured, evaluation.measurements, atol=1e-9 * np.abs(evaluation.measurements).max())
    assert np.abs(evaluation.measurements).max() > 1e-3


def test_nested_single_threaded_functions_stay_single_threaded():
    def threads():  # a solver may bring a library that is built for one thread
        libraries = [library for library in threadpool_info() if library["user_api"] == "blas"]
        return {library["num_threads"] for library in libraries if library["threading_layer"] != "disabled"}

    @one_thread
    def inner():
        return threads()

    @one_thread
    def outer():
        return inner() | threads()

    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        assert before == {2}, "BLAS has one thread here, and this test cannot fail"
        assert (outer(), threads()) == ({1}, before)


def test_a_weld_keeps_its_initial_gap(lap_model):
    deviations = draw(lap_model.scene, 3, 0, 4)
    unwelded = with_kinds(lap_model, "locate", "clamp", "measure")
    held = with_kinds(lap_model, "locate", "clamp", "weld", "measure")
    found, at_weld, after = (model.evaluate(deviations) for model in (unwelded, held, lap_model))
    assert list(at_weld.resolutions) == ["clamp"]
    # Welds that do not close a gap move nothing while the clamps still hold ...
    scale = np.abs(found.measurements).max()
    assert scale > 1e-3 and np.abs(after.measurements - found.measurements).max() > 1e-3
    np.testing.assert_allclose(at_weld.measurements, found.measurements, atol=1e-9 * scale)
    # ... and keep what they found once the clamps have gone.
    start, end = (
        readings(model, evaluation) @ model.rows["weld"].T
        for model, evaluation in ((held, at_weld), (lap_model, after))
    )
    assert np.abs(start).max() > 1e-3
    np.testing.assert_allclose(end, start, atol=1e-9 * np.abs(start).max())


def test_a_closing_weld_closes_gap_and_tilt(hat_model):
    """Mean and moments of the gap over the nugget vanish; the sheets keep their tangential displacement."""
    evaluation = hat_model.process("coulomb").evaluate(draw(hat_model.scene, 3, 0, 4))
    gap = hat_model.weld_gap + readings(hat_model, evaluation) @ hat_model.rows["weld"].T
    closing = np.array([weld.close for weld in hat_model.scene.welds])
    assert set(hat_model.weld_size) == {9} and closing.any() and not closing.all()
    mean, tilt, sideways = (gap.reshape(len(gap), -1, 9)[..., rows] for rows in ([0], [3, 6], [1, 2]))
    for normal in (mean, tilt):
        assert np.abs(normal[:, closing]).max() < 1e-10
        assert np.abs(normal[:, ~closing]).max() > 1e-5
    assert np.abs(sideways[:, closing]).max() > 1e-4


def test_a_sample_that_misses_its_tolerance_in_one_step_fails(lap_model, monkeypatch):
    """The first step of the clamp stage, in which overlaps settle; all others meet theirs."""
    follow, calls = ContactSolver.follow, []

    def miss_one(*arguments, **keys):
        solution = follow(*arguments, **keys)
        calls.append(solution)
        missed = (np.arange(len(solution.converged)) == 1) & (len(calls) == 1)
        return replace(solution, converged=solution.converged & ~missed)

    monkeypatch.setattr(ContactSolver, "follow", miss_one)
    evaluation = Process(lap_model, "coulomb").evaluate(draw(lap_model.scene, 3, 0, 3))
    assert len(calls) == 4 and all(solution.converged.all() for solution in calls)
    assert evaluation.failed.tolist() == [False, True, False] and evaluation.resolutions["release"].converged.all()
    assert evaluation.resolutions["clamp"].converged.tolist() == [True, False, True]


@pytest.mark.slow
@pytest.mark.parametrize("law", ["coulomb", "associated", "frictionless"])
def test_a_sample_has_the_same_bits_in_any_batch_order_and_number_of_threads(hat_model, law):
    deviations = draw(hat_model.scene, 5, 0, 7)
    whole = everything(hat_model.process(law).evaluate(deviations))
    for own, threads in ((np.arange(1), 1), (np.arange(2, 5), 1), (np.arange(7)[::-1], 2)):
        found = everything(hat_model.process(law, threads=threads).evaluate(deviations[own]))
        assert [name for name in whole if not np.array_equal(found[name], whole[name][own], equal_nan=True)] == []


@pytest.mark.slow
def test_the_number_of_blas_threads_does_not_change_results(cache):
    """The lap joint as it is shipped, with its candidates: products large enough that threads would share them."""
    scene = mic.load_scene(ROOT / "meshes" / "lap_joint")
    deviations = draw(scene, 5, 0, 3)

    def outcome(threads):
        with threadpool_limits(limits=threads, user_api="blas"):
            return everything(mic.reduce(scene, cache).evaluate(deviations))

    one, two = outcome(1), outcome(2)
    assert [name for name in one if not np.array_equal(one[name], two[name], equal_nan=True)] == []


def everything(evaluation):
    """All numbers of an evaluation by name, the sample as the first axis."""
    found = {
        "measurements": evaluation.measurements,
        "forces": evaluation.functional_force,
        "motion": evaluation.motion,
    }
    for stage, resolution in evaluation.resolutions.items():
        for each in (resolution, resolution.trace):
            arrays = {name: a for name, a in vars(each).items() if isinstance(a, np.ndarray) and a.dtype != object}
            found |= {f"{stage} {name}": a for name, a in arrays.items()}
    return found


@pytest.mark.slow
def test_results_without_contact_are_affine(lap_scene, cache):
    model = mic.reduce(lap_scene.model_copy(update={"zones": []}), cache)
    assert len(model.contacts) == 0
    values = np.array([[0.0, 0, 0], [1, 2, 0.3], [2, 4, 0.6]])
    zero, one, two = model.evaluate(values).measurements
    np.testing.assert_allclose(two - zero, 2 * (one - zero), atol=1e-10)
    assert np.abs(one - zero).max() > 1e-3


@pytest.mark.slow
def test_normal_rows_suffice_without_friction(lap_scene, lap_model, cache):
    scene = lap_scene.model_copy(
        update={"report": lap_scene.report.model_copy(update={"laws": ["frictionless"], "slip": False})}
    )
    lean = mic.reduce(scene, cache)
    assert lean.contacts.dimension == 1 and lean.rows["contact"].shape[0] * 3 == lap_model.rows["contact"].shape[0]
    deviations = draw(scene, 3, 0, 5)
    few, all_rows = (model.evaluate(deviations, "frictionless") for model in (lean, lap_model))
    np.testing.assert_allclose(few.measurements, all_rows.measurements, atol=1e-8)
    normal, expected = (one.resolutions["clamp"].force[:, :, 0] for one in (few, all_rows))
    np.testing.assert_allclose(normal, expected, atol=1e-6 * np.abs(normal).max())


@pytest.mark.slow
def test_a_scene_without_friction_runs_under_the_default_law(lap_scene, cache):
    zones = [zone.model_copy(update={"friction": 0.0}) for zone in lap_scene.zones]
    model = mic.reduce(lap_scene.model_copy(update={"zones": zones}), cache)
    assert model.contacts.dimension == 1
    smooth, default = (model.evaluate({}, law) for law in ("frictionless", "coulomb"))
    assert not default.failed.any()
    np.testing.assert_array_equal(default.measurements, smooth.measurements)


@pytest.mark.slow
def test_increments_change_the_result_and_converge(hat_model):
    deviations = draw(hat_model.scene, 3, 0, 2)
    one, many, more = (on_the_way(hat_model, count).evaluate(deviations).measurements for count in (1, 6, 12))
    assert np.abs(more - one).max() > 1e-4  # mm: were increments ignored, nothing would move
    assert np.abs(more - many).max() < 0.5 * np.abs(more - one).max()


def test_the_path_tolerance_is_that_of_the_scene(lap_model):
    def paths(law, **changes):
        model = replace(lap_model, scene=lap_model.scene.model_copy(update=changes))
        return [stage.path for stage in model.process(law).stages if stage.plan.resolves]

    closely = mic.scene.process.FollowedPath(tolerance=2e-5)
    thinnest = min(part.thickness for part in lap_model.scene.parts)
    for changes, tolerance in (({}, Followed.tolerance), ({"path": closely}, 2e-5)):
        followed = paths("coulomb", **changes)
        assert followed == [Followed(tolerance, LEAST_MOTION * thinnest)] * 2
    assert paths("associated", path=closely) == [Increments(1)] * 2  # whose small steps do not tend to it


def test_a_tighter_path_tolerance_reduces_the_error(lap_model):
    deviations = draw(lap_model.scene, 3, 0, 4)

    def positions(tolerance):
        resolutions = Process(lap_model, "coulomb", path_tolerance=tolerance).evaluate(deviations).resolutions.values()
        return np.concatenate([resolution.displacement[:, :, 1:].ravel() for resolution in resolutions])

    usual, tight, exact = (positions(Followed.tolerance * share) for share in (1, 1 / 16, 0.01))
    assert np.linalg.norm(tight - exact) < np.linalg.norm(usual - exact) / 3  # of second order, a sixth is left


@pytest.mark.slow
def test_a_part_without_support_is_refused_before_computation(lap_scene, cache, monkeypatch):
    stages = [
        stage.model_copy(update={"keep": ["lower-A1", "lower-A2"]}) if stage.kind == "release" else stage
        for stage in lap_scene.stages
    ]

    def compute(*_):
        raise AssertionError("influence coefficients were requested")

    monkeypatch.setattr("mic.compliance.cache.influence_coefficients", compute)
    with pytest.raises(mic.SceneError, match=r"stages \(release\): 4 rigid-body motions are free"):
        mic.reduce(lap_scene.model_copy(update={"stages": stages}), cache)


@pytest.mark.slow
def test_a_redundant_locator_is_named_and_has_no_effect(lap_scene, lap_model, cache):
    # One increment each: the locator adds a step, and a followed path has errors of its own in each step.
    twin = lap_scene.locators[0].model_copy(update={"name": "twin", "stage": "clamp"})
    scene = lap_scene.model_copy(update={"locators": [*lap_scene.locators, twin]})
    process, alone = Process(mic.reduce(scene, cache), "coulomb"), Process(lap_model, "coulomb")
    for stage in (*process.stages, *alone.stages):
        stage.path = Increments(1)
    assert [sentence for sentence in process.redundant if "stage clamp" in sentence] == [
        "stage clamp: locator row twin repeats other rows of the stage; its value has no effect"
    ]
    deviations = draw(lap_scene, 3, 0, 2)
    found, expected = (one.evaluate(deviations).measurements for one in (process, alone))
    np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["frictionless", "associated"])
def test_the_solvers_of_the_paper_give_the_same_results(lap_model, law):
    pytest.importorskip("cvxpy")
    deviations = draw(lap_model.scene, 3, 0, 3)
    native = lap_model.process(law).evaluate(deviations)
    paper = lap_model.process(law, backend="paper").evaluate(deviations)
    assert not paper.failed.any()
    for stage, resolution in paper.resolutions.items():
        scale = np.abs(native.resolutions[stage].displacement).max()
        np.testing.assert_allclose(resolution.displacement, native.resolutions[stage].displacement, atol=1e-4 * scale)
    assert (paper.resolutions["clamp"].residual != native.resolutions["clamp"].residual).any()
