"""The study of statistics: its populations are what they state, and its limits refuse intervals that are too narrow."""

import numpy as np
import pytest

from mic.statistics import estimates
from verification.statistics.populations import NAMED, Sources, random_answers
from verification.statistics.study import named_cell, summary, worst

COUNT = 200_000


def agrees(x, one):
    """Mean within five standard errors of that of a population, σ within 2 %."""
    return abs(x.mean() - one.mean) < 5 * one.sigma / len(x) ** 0.5 and abs(x.std() / one.sigma - 1) < 0.02


@pytest.mark.parametrize("one", [*NAMED, *random_answers(3, 1)], ids=lambda one: one.name)
def test_the_statistics_of_a_population_are_those_of_its_samples(one):
    x = one.draw(np.random.default_rng(1), (COUNT,))
    assert agrees(x, one)
    if one.below is not None:
        limit = one.mean + 1.5 * one.sigma
        assert one.below(limit) == pytest.approx((x < limit).mean(), abs=5 * 0.5 / COUNT**0.5)


def test_the_sources_are_correlated_and_truncated():
    sources = Sources()
    x = sources.inputs(1, COUNT // 20)
    assert np.corrcoef(x[:, 0], x[:, 1])[0, 1] == pytest.approx(0.8, abs=0.015)
    assert (x[:, 2].min(), x[:, 2].max()) == pytest.approx(sources.ENDS, abs=0.01)
    assert all(agrees(y, one) for y, one in zip(sources.outputs(x).T, sources.populations))


def test_the_limit_refuses_intervals_that_trust_the_tails_of_the_samples(monkeypatch):
    lognormal = [one.name for one in NAMED].index("lognormal")
    finding = lambda: worst("coverage", summary(named_cell(2000, (lognormal, 60))))
    assert finding().measured > -0.02
    monkeypatch.setattr(estimates, "ADDED", 0)
    assert finding().measured < -0.05
