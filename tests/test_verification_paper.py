"""The study of the paper's case: its comparison with Table 1, and the scene that comes nearest to it."""

import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mic.examples import folder
from verification.comparison import reduced_and_assembly
from verification.paper.choices import CHOICES, distance, measure, nearest, sampled, zone_values
from verification.paper.study import STUDY

LIMIT = {acceptance.name: acceptance.limit for acceptance in STUDY.acceptance}


@pytest.fixture(scope="module")
def published():
    zones = tomllib.loads((folder("wheelhouse") / "paper.toml").read_text(encoding="utf-8"))["zones"]
    laws, kinds = ("frictionless", "associated"), ("mean", "six_sigma")
    return np.array([[[zones[zone][law][kind] for zone in ("CZ1", "CZ2", "CZ3")] for kind in kinds] for law in laws])


def test_the_distance_is_relative_and_counts_too_much_like_too_little(published):
    assert distance(published, published) == (0.0, 0.0)
    found = published.copy()
    found[1, 0, 1] *= 2.0
    assert distance(found, published) == pytest.approx((np.log(2) / np.sqrt(12), np.log(2)))
    assert distance(published, found) == distance(found, published)


def test_a_zone_counts_its_own_pairs_only():
    model = SimpleNamespace(contacts=SimpleNamespace(zone=np.array([0, 0, 1])), scene=SimpleNamespace(zones="ab"))
    moved = np.array([[[3.0, 4.0], [0.0, 0.0], [1.0, 0.0]]])
    assert zone_values(model, moved).tolist() == [[np.sqrt(12.5), 1.0]]
    assert zone_values(model, moved, np.array([True, False, True])).tolist() == [[5.0, 1.0]]


def test_the_six_coefficients_of_variation_of_the_paper_are_alike(published):
    """They agree as if one factor were common to all corrective forces, as it is in the scene."""
    variation = published[:, 1] / 6 / published[:, 0]
    assert variation.min() > 0.045 and variation.max() < 0.054
    scene = nearest("coarse")
    assert {round(item.sigma / abs(item.mean), 3) for item in scene.deviations} == {0.051}


@pytest.mark.slow
@pytest.mark.fem
def test_the_nearest_set_is_near_and_friction_ignored_is_not(cache, published):
    base = nearest("coarse")
    model, deviations = reduced_and_assembly(base, cache)[0], sampled(base, base, 50)[::2]
    found = measure(model, CHOICES[0], deviations, published)
    assert found["largest"] < LIMIT["nearest"]
    assert found["pairs that carry"] / found["of"] > LIMIT["carries"]
    assert found["deepest penetration, mm"] < LIMIT["penetration"]
    without = measure(model, replace(CHOICES[0], law="frictionless"), deviations, published)
    assert without["largest"] > LIMIT["nearest"] and without["CZ2 mean"] == pytest.approx(1.0)
