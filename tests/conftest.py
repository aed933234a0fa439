"""Fixtures shared by the tests: scenes that are cheap enough to run everywhere."""

from pathlib import Path

import pytest

import mic

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    """A cache folder of its own, so that no test depends on what earlier runs left behind."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="session")
def lap_scene():
    return mic.load_scene(ROOT / "meshes" / "lap_joint")


@pytest.fixture(scope="session")
def lap_model(lap_scene, cache):
    return mic.reduce(lap_scene, cache)


@pytest.fixture(scope="session")
def hat_model(cache):
    return mic.reduce(mic.load_scene(ROOT / "meshes" / "hat_on_plate"), cache)
