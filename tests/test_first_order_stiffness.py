"""Stiffness to first order of each sample's shape, against full finite elements on meshes that carry it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.deviated import WARM, hat, lap, read
from support.processes import on_processes
from typer.testing import CliRunner

import mic
from fem_reference.full.model import FullModel
from mic.errors import ImpossibleSample, SceneError
from mic.model.assembly import assemble
from mic.model.reduction import Reduction
from mic.options import app
from mic.process.model import ReducedModel
from mic.process.stiffness import coefficients, derivative_sets, select_shapes
from mic.statistics.draw import draw
from verification.comparison import difference, reduced_and_assembly
from verification.stiffness import DeviatedStiffness

pytestmark = pytest.mark.fem


@pytest.fixture(scope="module")
def built(cache):
    """The models of three stiffnesses of the lap joint, and the assembly of the last."""
    models = {}
    for name in ("nominal", "mean", "first-order"):
        models[name], assembly = reduced_and_assembly(read(lap(name)), cache)
    return models, assembly


@pytest.fixture(scope="module")
def on_hat(cache):
    return reduced_and_assembly(read(hat("first-order"), "hat_on_plate"), cache)


def planted(model, gap=1.0, H=1.0, G=1.0):
    """With these multiples of its derivatives."""
    own = model.slopes
    turned = replace(
        own,
        H=tuple(H * each for each in own.H),
        G=tuple(G * each for each in own.G),
        gap=gap * own.gap,
        weld_gap=gap * own.weld_gap,
    )
    return replace(model, slopes=turned)


def test_the_error_is_of_second_order(built):
    """A shape twice as far off the mean has four times the error; wrong derivatives, or none, leave twice."""
    models, assembly = built
    model, full = models["first-order"], FullModel(assembly, deviated=True)
    mean = model.deviations({})[0]

    truth = {off: full.evaluate(mean + [off, 0.0]).measurements for off in (-0.4, -0.2, 0.2, 0.4)}

    def order(one):
        error = {off: np.abs(one.evaluate(mean + [off, 0.0]).measurements[0] - found) for off, found in truth.items()}
        return np.log2(max(error[0.4].max(), error[-0.4].max()) / max(error[0.2].max(), error[-0.2].max()))

    assert 1.8 < order(model) < 2.3
    for wrong in (models["mean"], planted(model, H=-1), planted(model, H=0), planted(model, G=0), planted(model, G=-1)):
        assert 0.8 < order(wrong) < 1.3


def test_samples_agree_with_models_on_their_own_meshes(built):
    models, assembly = built
    mean, stiffness = models["mean"].deviations({})[0], DeviatedStiffness(assembly, models["first-order"])
    for factor in (0.75, 1.25):
        sample = factor * mean
        own = stiffness.at(sample).evaluate(sample).measurements
        off = {name: np.abs(one.evaluate(sample).measurements - own).max() for name, one in models.items()}
        assert off["first-order"] < 0.03 * off["mean"] and off["mean"] < off["nominal"], off


def test_gaps_go_with_each_sample(on_hat):
    """On the hat, whose bends turn; between flat sheets normals turn with the gap and leave it as it was."""
    model, assembly = on_hat
    spread = np.array([item.sigma for item in model.scene.deviations])
    sample = model.deviations({})[0] + spread * np.where(np.arange(len(spread)) % 2, -1.0, 1.0)
    full = FullModel(assembly, deviated=True).evaluate(sample)
    right = difference(model.evaluate(sample), 0, full).largest
    for wrong in (planted(model, gap=0), planted(model, gap=-1), replace(model, slopes=None)):
        assert difference(wrong.evaluate(sample), 0, full).largest > 5 * right


def test_the_mean_sample_is_that_of_the_mean_shape(built):
    mean, first = (built[0][name] for name in ("mean", "first-order"))
    a, b = mean.evaluate({}), first.evaluate({})
    np.testing.assert_array_equal(a.measurements, b.measurements)
    for stage, one in a.resolutions.items():
        np.testing.assert_array_equal(one.force, b.resolutions[stage].force)
    assert np.abs(first.evaluate({"F": -6.0}).measurements - mean.evaluate({"F": -6.0}).measurements).max() > 1e-3


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


def test_friction_may_vary_beside_it(cache, built):
    rough = {"name": "R", "kind": "friction", "target": "lap", "sigma": 0.02}
    table = lap("first-order")
    model, _ = reduced_and_assembly(read(table | {"deviations": [rough, *table["deviations"]]}), cache)
    found = model.evaluate({"R": 0.05, "F": -6.0}).resolutions["clamp"].force
    contacts = built[0]["first-order"].contacts
    rougher = replace(built[0]["first-order"], contacts=replace(contacts, friction=contacts.friction + 0.05))
    expected = rougher.evaluate({"F": -6.0}).resolutions["clamp"].force
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())
    assert np.abs(found - model.evaluate({"F": -6.0}).resolutions["clamp"].force).max() > 1e-4 * np.abs(expected).max()


def test_candidates_and_limited_forces_use_the_stiffness_of_the_sample(cache):
    """As in a model that has the sample's compliance and gaps from the beginning."""
    table = lap("first-order")
    table["zones"][0].pop("pairs")
    table["clamps"] = [clamp | {"force": 2.0} for clamp in table["clamps"]]
    table["welds"] = [weld | {"gun": 0.5} for weld in table["welds"]]
    table["deviations"].append(table["deviations"][0] | {"name": "E", "part": "lower", "point": [95, 5, 0]})
    model, _ = reduced_and_assembly(read(table), cache)
    sample = np.array([-6.5, 40.0, -3.5])
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
    models, _ = built
    at, step = np.array([-6.0, 40.5]), 1e-3
    found = models["first-order"].sensitivities(at)
    for i in range(2):
        move = step * np.eye(2)[i]
        high, low = (models["first-order"].evaluate(at + way * move) for way in (1, -1))
        between = (high.measurements - low.measurements)[0] / (2 * step)
        np.testing.assert_allclose(found.jacobian[0, :, i], between, rtol=1e-5, atol=1e-9)
        force = (high.resolutions["clamp"].force - low.resolutions["clamp"].force) / (2 * step)
        np.testing.assert_allclose(found.contacts["clamp"].force_slope[..., i], force, atol=1e-4 * np.abs(force).max())
    without = models["first-order"].with_deviations(at)
    frozen = replace(without, slopes=None).sensitivities(at).jacobian[0, :, 0]
    assert np.abs(frozen / found.jacobian[0, :, 0] - 1).max() > 0.01
    np.testing.assert_array_equal(found.sides[0, :, 0], np.repeat(found.jacobian[0, :, :1], 2, axis=1))


def test_only_parts_that_a_source_deforms_or_rotates_are_computed_and_each_once(tmp_path):
    lines: list[str] = []
    assembly = assemble(read(lap("first-order")), tmp_path)
    found, cached = coefficients(assembly, tmp_path, lines.append)
    assert cached == {"lower": False, "upper": False}
    assert [line.split(":")[0] for line in lines if line.startswith("influence")] == [
        *("influence coefficients of lower", "influence coefficients of upper"),
        *("influence coefficients of lower", "influence coefficients of upper"),  # warm, and bent
        *("influence coefficients of upper at F + 1 σ", "influence coefficients of upper at F − 1 σ"),
    ]
    assert "stiffness to first order in F (1 more, with 0.0% of the rotations of the sheets, are left out)" in lines
    assert set(found["upper"].slopes) == {"F"} and not found["lower"].slopes
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


def chosen(table, cache):
    assembly = assemble(read(table), cache)
    return select_shapes(assembly, Reduction.build(assembly, coefficients(assembly_of(assembly), cache)[0]))


def assembly_of(assembly):
    """The same, with the nominal stiffness."""
    return replace(assembly, scene=assembly.scene.model_copy(update={"stiffness": "nominal"}))


def test_small_sources_are_omitted_up_to_a_tenth_in_total(cache):
    every = chosen(several([1.0] * 4), cache)
    assert list(every.along) == ["F0", "F1", "F2", "F3"] and every.omitted == 1 and every.share < 1e-3
    turned = {
        name: np.sqrt(np.mean(np.sum(fields["upper"][:, 3:] ** 2, axis=1))) for name, fields in every.along.items()
    }

    def share(sigmas):
        own = np.array([turned[f"F{i}"] * sigma for i, sigma in enumerate(sigmas)])
        return np.linalg.norm(own[1:3]) / np.linalg.norm(own)

    small = 0.07 * turned["F0"] / np.array([turned["F1"], turned["F2"]])
    fewer = chosen(several([1.0, *small, 1.0]), cache)
    assert list(fewer.along) == ["F0", "F3"] and fewer.omitted == 3
    assert fewer.share == pytest.approx(share([1.0, *small, 1.0]), rel=1e-3) and 0.05 < fewer.share < 0.1
    larger = 3.0 * small
    assert "F1" in chosen(several([1.0, *larger, 1.0]), cache).along
    together = {"deviations": ["F1", "F2"], "matrix": [[1.0, 0.99], [0.99, 1.0]]}
    assert list(chosen(several([1.0, *small, 1.0], correlations=[together]), cache).along) == ["F0", "F1", "F2", "F3"]
    assert list(chosen(several([1.0, 0.0, 0.0, 0.0]), cache).along) == ["F0"]


def test_the_error_of_omitted_sources_is_about_the_stated_share(cache):
    """Relative to the error of the mean shape's stiffness, it is at most twice the share of the omitted rotations."""
    table = several([1.0, 0.08, 0.08, 0.08])
    model, assembly = reduced_and_assembly(read(table), cache)
    share = chosen(table, cache).share
    assert model.slopes.source.tolist() == [0] and share > 0.04
    mean, stiffness, off = replace(model, slopes=None), DeviatedStiffness(assembly, model), {"mean": [], "first": []}
    for sample in draw(model.scene, 1, 0, 10):
        own = stiffness.at(sample).evaluate(sample).measurements
        for name, one in (("mean", mean), ("first", model)):
            off[name].append(one.evaluate(sample).measurements - own)
    left = np.sqrt(np.mean(np.square(off["first"])) / np.mean(np.square(off["mean"])))
    assert 0.25 * share < left < 2 * share


def test_a_check_reports_the_sets_of_coefficients_before_and_after(tmp_path):
    scene = tmp_path / "scene"
    scene.mkdir()
    table = lap("first-order")
    names, sets = derivative_sets(assemble(read(table), tmp_path))
    assert names == ["F", "W"] and sets == 2 + 2 * 2 + 2 * 2
    text = (read(table).folder / "scene.toml").read_text().replace("fields = true", "")
    (scene / "scene.toml").write_text('stiffness = "first-order"\n' + text.replace("medium", "coarse"))
    (scene / "geometry.py").write_text((read(table).folder / "geometry.py").read_text())

    def told():
        environment = {"MIC_CACHE": str(tmp_path), "COLUMNS": "200"}
        output = CliRunner().invoke(app, ["check", str(scene)], env=environment).output
        return next(line for line in output.splitlines() if "to first order" in line)

    each = "; each sample needs its own model, which takes many times as long"
    assert (
        told() == f"• stiffness to first order in up to F1, F2: at most 10 further sets of influence coefficients{each}"
    )
    own = assemble(mic.load_scene(scene), tmp_path)
    coefficients(assembly_of(own), tmp_path)
    known = "• stiffness to first order in F1, F2: 8 further sets of influence coefficients, {} to be computed" + each
    assert told() == known.format(8)
    coefficients(own, tmp_path)
    assert told() == known.format(0)


@pytest.mark.slow
def test_several_processes_compute_the_coefficients_of_one(tmp_path, built):
    done = on_processes(2, "-m", "support.deviated", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    found, own = ReducedModel.load(tmp_path / "model.npz"), built[0]["first-order"]
    assert found.slopes is not None
    for name in ("H", "G"):
        for one, other in zip(getattr(found.slopes, name), getattr(own.slopes, name)):
            np.testing.assert_allclose(one, other, atol=1e-8 * np.abs(other).max(initial=1e-300))
    np.testing.assert_allclose(found.slopes.gap, own.slopes.gap, atol=1e-12)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"report": {"laws": ["coulomb"], "fields": True}}, "report.fields.*fields need stiffness"),
        (
            {"deviations": [{"name": "T", "kind": "thickness", "part": "upper", "sigma": 0.02}]},
            r"deviations\[0\] \(T\): it needs stiffness",
        ),
        ({"optimise": {"orders": [{"stage": "clamp"}]}}, "optimise: it needs stiffness"),
    ],
)
def test_scenes_without_first_order_stiffness_are_refused(keys, said):
    with pytest.raises(SceneError, match=said):
        read(lap("first-order") | keys)


def test_coefficients_without_derivatives_are_refused(cache, built):
    assembly = built[1]
    of_mean = replace(assembly, scene=assembly.scene.model_copy(update={"stiffness": "mean"}))
    for other in (of_mean, assembly_of(assembly)):
        with pytest.raises(SceneError, match="stiffness"):
            ReducedModel.build(assembly, coefficients(other, cache)[0])
