"""Samples that depend on nothing but seed and number, and reach the sink once each."""

import os

import numpy as np
import pytest
from scipy import stats

from mic.sampling.distributions import DISTRIBUTIONS
from mic.sampling.draw import draw
from mic.sampling.montecarlo import BLOCK, ROOM, SIZES, blocks, monte_carlo

LAWS = ["coulomb", "frictionless"]


def collected(model, laws, samples, seed, **options):
    """What a Monte Carlo hands over, in order, and what it says was done already."""
    found = []
    reused = monte_carlo(model, laws, samples, seed, lambda *block: found.append(block), **options)
    return found, reused


def test_samples_depend_on_seed_and_number_only(lap_scene):
    whole = draw(lap_scene, 4, 0, 30)
    np.testing.assert_array_equal(draw(lap_scene, 4, 17, 5), whole[17:22])
    assert (draw(lap_scene, 5, 0, 30) != whole).all()
    assert len(np.unique(whole)) == whole.size


#: Each of mean 0 and standard deviation 1.
REFERENCES = {"normal": stats.norm(), "uniform": stats.uniform(-np.sqrt(3), 2 * np.sqrt(3))}


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_deviations_follow_the_stated_distribution(lap_scene, distribution):
    deviations = [d.model_copy(update={"distribution": distribution}) for d in lap_scene.deviations]
    scene = lap_scene.model_copy(update={"deviations": deviations})
    values = draw(scene, 8, 0, 4000)
    for j, deviation in enumerate(deviations):
        standard = (values[:, j] - deviation.mean) / deviation.sigma
        reference = REFERENCES[distribution]
        assert (reference.mean(), reference.std()) == pytest.approx((0.0, 1.0))
        assert stats.kstest(standard, reference.cdf).pvalue > 1e-3
    correlation = np.corrcoef(values.T) - np.eye(len(deviations))
    assert np.abs(correlation).max() < 4 / np.sqrt(4000)


def test_every_sample_reaches_the_sink_once(lap_model):
    found, reused = collected(lap_model, LAWS, BLOCK + 10, 4)
    assert [(law, first, len(e.deviations)) for law, first, e in found] == [
        (law, first, count) for law in LAWS for first, count in ((0, BLOCK), (BLOCK, 10))
    ]
    for _, first, evaluation in found:
        expected = draw(lap_model.scene, 4, first, len(evaluation.deviations))
        np.testing.assert_array_equal(evaluation.deviations, expected)
    assert reused == {"coulomb": 0, "frictionless": 0}


def test_blocks_that_are_done_are_left_out_and_counted(lap_model):
    heard = []
    found, reused = collected(
        lap_model,
        LAWS,
        BLOCK + 10,
        4,
        done=lambda law, first, count: law == "coulomb" and first == 0,
        advance=lambda law, count: heard.append((law, count)),
    )
    assert ("coulomb", 0) not in [block[:2] for block in found] and len(found) == 3
    assert reused == {"coulomb": BLOCK, "frictionless": 0}
    assert heard == [(law, count) for law in LAWS for count in (BLOCK, 10)]


def test_a_sample_that_breaks_is_counted_and_the_rest_survives(lap_model, monkeypatch):
    process = lap_model.process("coulomb", threads=len(os.sched_getaffinity(0)))
    target = draw(lap_model.scene, 4, 7, 1)
    evaluate = process.evaluate

    def breaks(deviations):
        if (deviations == target).all(axis=1).any():
            raise np.linalg.LinAlgError("planted")
        return evaluate(deviations)

    monkeypatch.setattr(process, "evaluate", breaks)
    ((_, _, found),), _ = collected(lap_model, ["coulomb"], 20, 4)
    assert np.flatnonzero(found.failed).tolist() == [7]
    assert found.resolutions["clamp"].status[7] == "planted" and np.isnan(found.measurements[7]).all()
    assert np.isfinite(np.delete(found.measurements, 7, axis=0)).all()


@pytest.mark.parametrize("pairs", [0, 24, 500, 100_000])
def test_blocks_begin_where_they_do_however_many_samples_there_are(pairs):
    whole = [first for _, first, _ in blocks(["coulomb"], 1_000_000, pairs)]
    for samples in (1, BLOCK, 1030, 1050, 9_999, 123_456):
        found = blocks(["coulomb", "frictionless"], samples, pairs)
        for law in ("coulomb", "frictionless"):
            firsts, counts = zip(*[(first, count) for name, first, count in found if name == law])
            assert list(firsts) == whole[: len(firsts)]
            assert list(np.cumsum(counts)) == [*firsts[1:], samples]  # without gaps, up to the last sample


def test_blocks_grow_with_their_place_as_far_as_memory_allows():
    small, large = blocks(["coulomb"], 1_000_000, 24), blocks(["coulomb"], 1_000_000, 500)
    assert all(count == BLOCK for _, first, count in small if first < 1000)
    assert all(count <= max(BLOCK, first / 20) for _, first, count in small)
    assert len(small) < 400 and max(count for *_, count in small) == SIZES[-1]
    assert max(count for *_, count in large) * 500 <= ROOM
