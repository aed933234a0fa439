"""The study of statistics from few samples: its populations, its stopped runs, and coverages that its limits refuse."""

import numpy as np
import pytest

from mic.statistics.estimates import Estimate
from verification.few_samples import springs
from verification.few_samples.populations import POPULATIONS, draw
from verification.few_samples.stops import SCENES, further, load, stop
from verification.few_samples.study import finding, judged, summary

#: Outputs of two non-linear variables need a double integral.
EACH = [
    pytest.param(one, id=one.name, marks=[pytest.mark.slow] * (one.h is not POPULATIONS[1].h)) for one in POPULATIONS
]


@pytest.mark.parametrize("population", EACH)
def test_the_statistics_of_a_population_are_those_of_its_samples(population):
    stream, n = np.random.default_rng(6), 40_000
    axes = np.linalg.qr(stream.standard_normal((6, 3)))[0]
    y, truth = population.values(draw(stream, n), axes), population.truth()
    z = (y - truth.mean) / truth.sigma
    assert abs(z.mean()) < 4 / np.sqrt(n)
    assert abs((z**2).mean() - 1) < 4 * np.sqrt(((z**4).mean() - 1) / n)
    for value, share in ((truth.limit, 1 - truth.outside), (truth.low, 0.00135), (truth.high, 0.99865)):
        assert abs((y <= value).mean() - share) < 4 * np.sqrt(share * (1 - share) / n)


def hits(share, repetitions=800):
    """Rows of an interval of half-width 1 whose value is off by 2 in this share of the repetitions."""
    rows = []
    for i in range(repetitions):
        value = np.array([2.0 if i < round(share * repetitions) else 0.0])
        one = Estimate(value, value - 1, value + 1, 1, 0)
        rows += judged(["y"], {"6σ": np.zeros(1)}, np.ones(1), {"6σ": one}, samples=50)
    return rows


@pytest.mark.parametrize(("missed", "passed"), [(0.05, True), (0.07, True), (0.11, False), (0.3, False)])
def test_a_coverage_that_is_surely_below_the_limit_fails(missed, passed):
    found = finding("one-step", summary(hits(missed), ("output", "quantity", "samples")))
    assert (found.measured >= 0.93) == passed
    assert found.table["coverage"].tolist() == pytest.approx([1 - missed])


def test_an_interval_that_is_not_known_holds_nothing_once_there_is_a_value():
    one = Estimate(np.array([0.0, np.nan]), np.full(2, np.nan), np.full(2, np.nan), 1, 0)
    rows = judged(["a", "b"], {"6σ": np.ones(2)}, np.ones(2), {"6σ": one})
    assert [(row["output"], row["holds"]) for row in rows] == [("a", False)]


def test_a_run_stops_for_each_output_at_its_own_accuracy():
    def estimate(count):
        half = np.array([0.5, 1.0, 9.0]) / np.sqrt(count)
        return Estimate(np.ones(3), 1 - half, 1 + half, count, 0)

    found = stop(estimate, 0.051, (50, 100, 400, 900))
    np.testing.assert_array_equal(found.samples, [100, 400, np.nan])
    np.testing.assert_allclose(found.needed, [100, 400, 900 * (0.3 / 0.051) ** 2])
    np.testing.assert_allclose(found.high - 1, [0.05, 0.05, 0.3])


def test_further_samples_in_one_step_are_none_of_the_run():
    own = np.arange(20, 25)
    found = further(np.random.default_rng(0), own, 200)
    assert len(set(found.tolist())) == 45 and found[:5].tolist() == own.tolist()


@pytest.mark.slow
def test_stored_samples_belong_to_the_deviations_of_their_scene():
    samples = load(SCENES[-1])
    functions = np.column_stack([np.ones(len(samples.x)), samples.x])
    regression = functions @ np.linalg.lstsq(functions, samples.followed, rcond=None)[0]
    share = (samples.followed - regression).std(axis=0) / samples.followed.std(axis=0)
    assert (share < 0.5).all(), share  # with the deviations of other samples: 1


@pytest.mark.slow
def test_contacts_on_springs_follow_their_closed_form():
    x = springs.MEANS + springs.SIGMAS * np.random.default_rng(3).standard_normal((200, 5))
    followed, one_step = springs.contacts(x)
    np.testing.assert_allclose(followed, springs.closed_form(x), atol=1e-12)
    assert np.abs(one_step[:, 0] - followed[:, 0]).max() > 0.3 and np.ptp(one_step[:, 0]) > 0.1
