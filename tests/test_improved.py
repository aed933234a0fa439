"""Estimates of a run with surrogates and samples in one step: what is drawn, stored, aligned and left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.runs import changed

from mic.results.improved import FURTHER, improve, population
from mic.results.outcome import read_outcome
from mic.results.output_samples import OutputSamples
from mic.results.run_folder import RunFolder
from mic.runs import sample_into
from mic.scene.schema import Accuracy
from mic.statistics.draw import draw

KEY = ("measurement", "G")


def outputs(scene, numbers, y) -> OutputSamples:
    """Samples of a scene with one output y(x), without those that are NaN."""
    x = draw(scene, 1, 0, int(max(numbers)) + 1)[numbers]
    values = y(x)[:, None]
    known = np.isfinite(values[:, 0])
    return OutputSamples((KEY,), np.asarray(numbers)[known], x[known], values[known])


def kinked(x):
    return x[:, 0] + np.maximum(x[:, 0] + x[:, -1], 0.0)


def test_samples_in_one_step_meet_their_followed_ones(lap_scene):
    """y - o is constant, so that the estimate is that of all samples of o, but for the surrogate's noise; a sample that
    failed in one step is left out of both."""
    followed = outputs(lap_scene, np.arange(60), lambda x: kinked(x) + 5.0)
    one_step = outputs(lap_scene, np.arange(360), kinked)
    found = improve(lap_scene, followed, 60, one_step)
    assert found.index(KEY) == 0 and found.estimates.samples == 60 and found.estimates.cheap_samples == 360
    many = kinked(outputs(lap_scene, np.arange(20_000), kinked).x)
    mean, sigma, scatter = found.estimates.mean(), found.estimates.sigma(), 3 * many.std() / np.sqrt(len(many))
    assert mean.low[0] - scatter < many.mean() + 5.0 < mean.high[0] + scatter
    assert sigma.low[0] - scatter < many.std() < sigma.high[0] + scatter
    assert mean.high[0] - mean.low[0] < 0.1 * many.std() and found.estimates.explained[0] == pytest.approx(1.0)
    missing = np.isin(one_step.numbers, [3, 200], invert=True)
    fewer = OutputSamples((KEY,), one_step.numbers[missing], one_step.x[missing], one_step.y[missing])
    again = improve(lap_scene, followed, 60, fewer).estimates
    assert again.samples == 59 and again.mean().value == pytest.approx(mean.value, abs=0.01 * many.std())


def test_the_model_in_one_step_closes_everything_at_once(lap_model):
    assert {plan.path for plan in lap_model.one_step.plans if plan.kind != "transfer"} == {"one-step"}
    assert all(len(plan.steps) == 1 for plan in lap_model.one_step.plans)
    assert any(len(plan.steps) > 1 for plan in lap_model.plans)
    assert lap_model.one_step.one_step is None  # it is its own


def test_without_known_distributions_or_few_samples_there_is_no_estimate(lap_scene):
    samples = outputs(lap_scene, np.arange(200), kinked)
    assert improve(lap_scene, samples, 200) is not None
    assert improve(lap_scene, outputs(lap_scene, np.arange(199), kinked), 199) is None
    designed = changed(lap_scene, monte_carlo={"design": "antithetic", "samples": 200})
    given = changed(lap_scene, monte_carlo={"values": samples.x.tolist()})
    assert improve(designed, samples, 200) is None and improve(given, samples, 200) is None


def test_more_samples_get_a_larger_population(lap_scene, monkeypatch):
    """Its error would be a floor otherwise."""
    monkeypatch.setattr("mic.statistics.draw.population", lambda scene, seed, folds, points: points)
    sizes = [population(lap_scene, count) for count in (50, 200, 201, 2000, 10**6)]
    assert sizes == [4096, 4096, 8192, 32768, 32768]


def test_many_samples_know_better_than_the_surrogate_of_the_first(lap_scene):
    rng = np.random.default_rng(1)
    samples = outputs(lap_scene, np.arange(200), lambda x: x[:, 0] / x[:, 0].std() + rng.standard_normal(len(x)))
    assert improve(lap_scene, samples, 200).index(KEY) == 0
    assert improve(lap_scene, samples, 10**6).index(KEY) is None


@pytest.mark.slow
def test_a_run_of_a_required_accuracy_draws_stores_and_reuses_samples_in_one_step(lap_model, tmp_path):
    model = replace(lap_model, scene=changed(lap_model.scene, monte_carlo={"accuracy": Accuracy(six_sigma=0.9)}))
    sample_into(tmp_path, model, ["coulomb"], 500, 4)
    store, identity = RunFolder(tmp_path), RunFolder(tmp_path).record()["identity"]
    stored = OutputSamples.union(store.one_step("coulomb", identity).values())
    assert stored.numbers.tolist() == list(range((1 + FURTHER) * 50))
    direct = model.one_step.process("coulomb").attempt(stored.x[:5])
    measured = [stored.keys.index(("measurement", item.name)) for item in model.scene.measurements]
    np.testing.assert_allclose(stored.y[:5, measured], direct.measurements, rtol=1e-12)
    table = read_outcome(tmp_path).measurement_statistics.set_index("law")
    assert set(table["one_step_samples"]) == {450}
    width = table["improved_six_sigma_high"] - table["improved_six_sigma_low"]
    assert (width < 0.2 * (table["six_sigma_high"] - table["six_sigma_low"])).all()

    without = replace(model, scene=changed(model.scene, monte_carlo={"accuracy": None}))
    assert read_outcome(tmp_path, without).improved("coulomb") is None  # whatever an earlier run has left

    (missing,) = tmp_path.glob("one_step/law=coulomb/000100-*")
    damaged = next(tmp_path.glob("one_step/law=coulomb/000200-*"))
    missing.unlink()
    damaged.write_bytes(damaged.read_bytes()[:-7])
    assert len(OutputSamples.union(store.one_step("coulomb", identity).values()).numbers) == 350
    sample_into(tmp_path, model, ["coulomb"], 500, 4)
    np.testing.assert_array_equal(OutputSamples.union(store.one_step("coulomb", identity).values()).y, stored.y)
