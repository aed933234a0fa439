"""The stiffness of the mean shape, against full finite elements on meshes that carry each sample's shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.deviated import hat, lap, read

from fem_reference.full.model import FullModel
from mic.compliance.cache import influence_coefficients
from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.process.stiffness import shape_fields
from verification.comparison import difference, reduced_and_assembly


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Where the cache is, and the models of both stiffnesses with the assembly that they came from."""
    cache = tmp_path_factory.mktemp("cache")
    return cache, {name: reduced_and_assembly(read(lap(name)), cache) for name in ("nominal", "mean")}


@pytest.mark.fem
def test_the_mean_sample_is_that_of_full_elements_on_its_own_mesh(built):
    models = built[1]
    model, assembly = models["mean"]
    mean = model.deviations({})[0]
    full = FullModel(assembly, deviated=True).evaluate(mean)
    assert difference(model.evaluate(mean), 0, full).largest < 1e-7
    assert difference(models["nominal"][0].evaluate(mean), 0, full).largest > 1e-3


@pytest.mark.fem
def test_gaps_go_with_the_mean_shape(built):
    """On the hat, whose bends turn; between flat sheets normals turn with the gap and leave it as it was."""
    model, assembly = reduced_and_assembly(read(hat("mean"), "hat_on_plate"), built[0])
    mean, change = model.deviations({})[0], model.contacts.gap - assembly.contacts.gap
    full = FullModel(assembly, deviated=True).evaluate(mean)
    assert difference(model.evaluate(mean), 0, full).largest < 1e-7
    wrong = replace(model, contacts=replace(model.contacts, gap=assembly.contacts.gap - change))
    assert difference(wrong.evaluate(mean), 0, full).largest > 0.01


@pytest.mark.fem
def test_samples_about_the_mean_are_nearer_than_with_the_nominal_stiffness(built):
    models = built[1]
    model, assembly = models["mean"]
    for factor in (0.75, 1.25):
        sample = factor * model.deviations({})[0]
        full = FullModel(assembly, deviated=True).evaluate(sample)
        off = {name: difference(one.evaluate(sample), 0, full).measurement for name, (one, _) in models.items()}
        assert off["mean"] < 0.6 * off["nominal"], off


@pytest.mark.fem
def test_the_shape_is_that_of_full_elements_at_every_vertex(built):
    model, assembly = built[1]["nominal"]
    mean = model.deviations({})[0]
    mine, theirs = shape_fields(assembly, model, mean), FullModel(assembly).shape_fields(mean)
    for name, field in theirs.items():
        np.testing.assert_allclose(mine[name], field, atol=1e-8 * np.abs(field).max())
        assert np.abs(field).max() > 1e-3


@pytest.mark.fem
def test_a_model_of_the_mean_shape_is_saved_and_read_as_it_is(built, tmp_path):
    model, _ = built[1]["mean"]
    model.save(tmp_path / "model.npz")
    again = ReducedModel.load(tmp_path / "model.npz")
    np.testing.assert_array_equal(again.evaluate({}).measurements, model.evaluate({}).measurements)


@pytest.mark.fem
def test_parts_without_a_mean_shape_have_the_nominal_stiffness(built):
    cache, models = built
    found, _ = reduced_and_assembly(read(lap("mean", 0.0, deviations=[lap("mean", 0.0)["deviations"][0]])), cache)
    for H, nominal in zip(found.compliance.H, models["nominal"][0].compliance.H):
        np.testing.assert_array_equal(H, nominal)


@pytest.mark.fem
def test_nominal_coefficients_are_refused_for_the_stiffness_of_the_mean_shape(built):
    cache, models = built
    assembly = models["mean"][1]
    with pytest.raises(SceneError, match="stiffness"):
        ReducedModel.build(assembly, influence_coefficients(assembly, cache)[0])


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"report": {"laws": ["coulomb"], "fields": True}}, "report.fields"),
        (
            {"deviations": [{"name": "T", "kind": "thickness", "part": "upper", "sigma": 0.02}]},
            r"deviations\[0\] \(T\)",
        ),
        ({"stiffness": "own"}, "stiffness"),
    ],
)
def test_scenes_without_the_stiffness_of_the_mean_shape_are_refused(keys, said):
    with pytest.raises(SceneError, match=said):
        read(lap("mean") | keys)
