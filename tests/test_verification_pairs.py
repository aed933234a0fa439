"""The study that holds shipped pairs against every node: its arithmetic, and that its limits catch wrong pairs."""

from dataclasses import replace

import numpy as np
import pytest
from support.wrong_models import gaps_off, without_friction

from verification.pairs import study
from verification.pairs.study import Outcome, compared

pytestmark = pytest.mark.fem
SAMPLES = 4


def test_errors_by_hand():
    rng = np.random.default_rng(3)
    values = rng.standard_normal((50, 2)) * [1.0, 1e-6]
    every = Outcome(9, 20, values, np.full((50, 2), 100.0), np.full((50, 1), 4.0))
    own = replace(every, measurements=values + [0.01, 1e-3], force=every.force + [0, 3.0], work=1.1 * every.work)
    found = compared("x", own, every)
    six = 6 * values[:, 0].std(ddof=1)
    assert found["mean"] == pytest.approx(max(0.01 / (0.05 * six), 1e-3 / 2e-3)) and found["6σ"] < 1e-9
    assert found["force"] == pytest.approx(0.03) and found["work"] == pytest.approx(0.1)
    values = values.copy()
    values[7] = np.nan  # failed in one of them: left out of both
    assert compared("x", replace(own, measurements=values), every)["samples"] == 49


@pytest.fixture(scope="module")
def lap(cache):
    scene = study.scene_of("lap_joint")
    return scene, cache, study.outcome(scene, cache, SAMPLES, every_node=True)


def broken(found):
    return {name for name, limit in study.LIMITS.items() if found[name] > limit}


PLANTED = {
    "nothing": (lambda model: model, set()),
    "friction ignored": (without_friction, {"work"}),
    "gaps off by 0.1 mm": (lambda model: gaps_off(model, 0.1), {"mean", "work"}),
}


@pytest.mark.slow
@pytest.mark.parametrize("error", PLANTED)
def test_limits_catch(lap, error):
    scene, cache, every = lap
    alter, caught = PLANTED[error]
    found = broken(compared("lap joint", study.outcome(scene, cache, SAMPLES, False, alter), every))
    assert caught <= found and (caught or not found), found
