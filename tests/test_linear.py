"""Linear maps of a process against its stages one by one."""

import numpy as np
import pytest
from support.springs import at_face, stage_list, two_plates

from mic.process.evaluation import Evaluation
from mic.process.linear_maps import Linear
from mic.process.process import Process
from mic.statistics.draw import draw


@pytest.fixture(autouse=True)
def room(monkeypatch):
    """Room for the maps of followed paths, of many steps."""
    monkeypatch.setattr("mic.process.linear_maps.MAX_NUMBERS", 10_000_000)


def plates(gun=None, deviations=()):
    """Two plates on springs, 0.3 mm apart, clamped and welded."""
    weld = {"name": "W", "parts": ["a", "b"], "point": [5, 5, 0], "moment": False} | ({"gun": gun} if gun else {})
    return two_plates(
        0.3,
        clamps=[at_face("b", (0, 0, -1), name="C", stroke=-0.3)],
        welds=[weld],
        deviations=list(deviations),
        stages=stage_list("locate", "clamp", "weld", "release", "measure"),
    )


def one_by_one(process, deviations):
    """Resolutions by stage, and what the measurements read, from the stages themselves."""
    driven, state, resolutions, readings = process.drive(deviations), process.start(len(deviations)), {}, None
    for stage in process.stages:
        state, resolution = stage.advance(state, driven)
        if resolution is not None:
            resolutions[stage.plan.name] = resolution
        if stage.plan.reads:
            readings = state.reading["measurement"] + driven.measured
    return resolutions, readings


def close(found, expected, share=1e-9):
    scale = np.abs(expected).max()
    assert scale > 0
    np.testing.assert_allclose(found, expected, rtol=0, atol=share * scale)


@pytest.mark.parametrize(
    "name, law", [("lap_model", "coulomb"), ("lap_model", "associated"), ("hat_model", "frictionless")]
)
def test_linear_maps_equal_the_stages(name, law, request):
    process = Process(request.getfixturevalue(name), law)
    deviations = draw(process.model.scene, 5, 0, 4)
    maps = Linear.of(process, deviations.shape[1])
    assert maps is not None and len(maps.steps) > 1
    resolutions, expected = one_by_one(process, deviations)
    solutions, readings, failed = maps.follow(process.stages, deviations)
    close(readings, expected)
    assert not failed.any() and len(solutions) == len(maps.steps)
    found = process.evaluate(deviations)
    assert list(found.resolutions) == list(resolutions)
    np.testing.assert_array_equal(found.readings, readings)
    for stage, one in found.resolutions.items():
        close(one.force, resolutions[stage].force)
        close(one.reaction, resolutions[stage].reaction)
        close(one.displacement, resolutions[stage].displacement, 1e-8)
        np.testing.assert_array_equal(one.state, resolutions[stage].state)


def test_stages_are_evaluated_once_and_only_on_request(lap_model, monkeypatch):
    process, deviations = Process(lap_model, "coulomb"), draw(lap_model.scene, 5, 0, 3)
    process.evaluate(deviations)  # the maps are made
    calls = []
    for stage in process.stages:
        monkeypatch.setattr(stage, "advance", lambda *a, own=stage.advance: calls.append(1) or own(*a))
    found, given = process.evaluate(deviations), deviations.copy()
    deviations[:] = 0.0
    assert not calls and np.abs(found.measurements).max() > 0
    assert "release" in found.resolutions and "measure" not in found.resolutions and not calls
    force = found.resolutions["release"].force
    assert len(calls) == len(process.stages)
    np.testing.assert_array_equal(force, process.evaluate(given).resolutions["release"].force)
    count = len(calls)
    assert found.motion.any() and found.functional_force.any() and len(calls) == count
    joined = Evaluation.join([process.evaluate(row[None]) for row in given])
    np.testing.assert_array_equal(joined.functional_force, found.functional_force)
    np.testing.assert_array_equal(joined.motion, found.motion)
    with pytest.raises(KeyError):
        found.resolutions["measure"]


def test_linear_maps_that_are_too_large_are_not_built(lap_model, monkeypatch):
    process, count = Process(lap_model, "coulomb"), len(lap_model.scene.deviations)
    assert Linear.of(process, count) is not None
    monkeypatch.setattr("mic.process.linear_maps.MAX_NUMBERS", 10_000)
    assert Linear.of(process, count) is None


@pytest.mark.parametrize("gun", [None, 1.0])
def test_limited_forces_are_not_linear(gun):
    process = plates(gun=gun).process("coulomb")
    assert (Linear.of(process, 0) is None) == bool(gun)
