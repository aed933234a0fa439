"""The shipped scenes give the recorded numbers; recorded/README.md states which, and when they may change."""

import functools

import numpy as np
import pytest
from recorded.record import FOLDER, INCREMENTS, SCENES, drawn, outcome, platform, reduced

TOLERANCE = 1e-10  # of the largest value of the array, where finite elements and BLAS are those of the recording
ELSEWHERE = 1e-7  # the wheelhouse's compliance is conditioned such that others move its forces by 2e-8
AT_HOME = ("motion",)  # counts from where the finite elements hold a free part; others may hold it elsewhere
MARKS = {"wheelhouse": [pytest.mark.slow, pytest.mark.fem]} | dict.fromkeys(
    ("hat_on_plate", "bracket"), [pytest.mark.slow]
)
EXACT = ("state", "failed")
ROUNDING = {"gap": 1e-13}  # rounding error of a difference of coordinates of hundreds of mm


def moved(key, found, recorded, tolerance=TOLERANCE):
    """How an array differs from the recorded one, in words; None where it does not."""
    words = key.split("/")
    if len(words) > 2:
        place = f"{words[0]}, increments {words[1]}, " + (f"stage {words[2]}, " if len(words) > 3 else "")
    else:
        place = "".join(f"{word}, " for word in words[:-1])
    quantity = place + words[-1]
    if found.shape != recorded.shape:
        return f"{quantity}: shape {found.shape}, recorded {recorded.shape}"
    if words[-1] in EXACT:
        different = np.count_nonzero(found != recorded)
        return f"{quantity}: {different} of {found.size} differ" if different else None
    scale = np.abs(recorded).max(initial=0.0)
    difference = np.abs(found - recorded)
    if (difference <= max(tolerance * scale, ROUNDING.get(words[-1], 0.0))).all():  # false for a nan as well
        return None
    return f"{quantity}: moved by {difference.max() / (scale or 1.0):.1e} of its largest value, {scale:.3g}"


@pytest.mark.parametrize("name", SCENES)
def test_the_same_seed_draws_the_same_deviations(name):
    with np.load(FOLDER / f"{name}.npz") as recorded:
        assert moved("deviations", drawn(name), recorded["deviations"]) is None


@pytest.fixture(scope="module")
def model(cache):
    """Each scene built from nothing, once for all numbers of increments."""
    return functools.cache(lambda name: reduced(name, cache))


@pytest.mark.parametrize("increments", INCREMENTS)
@pytest.mark.parametrize("name", [pytest.param(name, marks=MARKS.get(name, [])) for name in SCENES])
def test_the_same_scene_gives_the_same_numbers(name, increments, model):
    with np.load(FOLDER / f"{name}.npz") as file:
        held = [key for key in file.files if key.startswith("pairs/") or f"/{increments}/" in key]
        recorded = {key: file[key] for key in held}
        deviations, home = file["deviations"], str(file["platform"])
    at_home = platform() == home
    tolerance = TOLERANCE if at_home else ELSEWHERE
    found = outcome(model(name), increments, deviations)
    assert sorted(found) == sorted(recorded)
    compared = [key for key in found if at_home or key.split("/")[-1] not in AT_HOME]
    differences = [words for key in compared if (words := moved(key, found[key], recorded[key], tolerance))]
    heading = f"{name}: (recorded with {home}; here {platform()}; held to {tolerance})"
    assert not differences, "\n".join([heading, *differences])


def test_a_difference_is_reported_with_its_size():
    recorded = np.array([1.0, -4.0])
    assert moved("coulomb/3/clamp/force", recorded * (1 + 1e-12), recorded) is None
    words = moved("coulomb/3/clamp/force", recorded * (1 + 1e-6), recorded)
    assert words == "coulomb, increments 3, stage clamp, force: moved by 1.0e-06 of its largest value, 4"
    assert "1 of 2 differ" in moved("coulomb/1/failed", np.array([True, False]), np.array([False, False]))
    assert "nan" in moved("pairs/gap", np.array([np.nan, 1.0]), recorded)
    assert "shape" in moved("pairs/gap", recorded[:1], recorded)
    assert moved("pairs/gap", np.array([1e-18, 0.0]), np.array([0.0, -2e-18])) is None  # sheets that touch
    assert moved("pairs/gap", np.array([1e-12, 0.0]), np.array([0.0, -2e-18])) is not None
    assert moved("coulomb/1/clamp/slip", np.array([1e-18, 0.0]), np.array([0.0, -2e-18])) is not None
