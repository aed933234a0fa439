"""Fixtures shared by the tests: scenes that are cheap enough to run everywhere, with finite elements or without."""

import gc
import importlib.util
import os
import re
from collections import Counter
from pathlib import Path

import pytest
from support.runs import skip_pictures

import mic
from mic.runs import sample_into
from verification.scenes import with_stated_pairs

gc.set_threshold(20_000, *gc.get_threshold()[1:])  # with all test modules in memory, garbage took a tenth of the time

ROOT = Path(__file__).resolve().parents[1]
FINITE_ELEMENTS = importlib.util.find_spec("dolfinx") is not None


def pytest_configure():
    """Processes that a test starts find the shipped compliance as the tests themselves do."""
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")])


def pytest_ignore_collect(collection_path):
    """Without finite elements, a module marked ``fem`` as a whole is not even imported: its imports would fail."""
    if FINITE_ELEMENTS or collection_path.suffix != ".py":
        return None
    return bool(re.search(r"^pytestmark = .*\bfem\b", collection_path.read_text(encoding="utf-8"), re.M)) or None


def pytest_collection_modifyitems(items):
    """Files with many slow tests first, so that two processes end together; skip ``fem`` without finite elements."""
    slow: Counter[Path] = Counter()
    for item in items:
        mark = item.get_closest_marker("slow")
        slow[item.path] += mark.args[0] if mark and mark.args else bool(mark or item.get_closest_marker("fem"))
    items.sort(key=lambda item: -slow[item.path])
    for item in items:
        if not FINITE_ELEMENTS and item.get_closest_marker("fem"):
            item.add_marker(pytest.mark.skip(reason="needs finite elements (dolfinx) or gmsh"))


def pytest_collection_finish():
    """Garbage collection skips modules and tests, which live to the end."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    """A cache folder of these tests, so that none depends on what earlier runs left behind; where they are shared out
    over processes, one for all."""
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "cache"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def lap_scene():
    return with_stated_pairs(mic.load_scene(ROOT / "meshes" / "lap_joint"))


# Without finite elements, tests/support/shipped.py provides the compliance.


@pytest.fixture(scope="session")
def lap_model(lap_scene, cache):
    return mic.reduce(lap_scene, cache)


@pytest.fixture(scope="session")
def hat_model(cache):
    return mic.reduce(with_stated_pairs(mic.load_scene(ROOT / "meshes" / "hat_on_plate")), cache)


@pytest.fixture(scope="session")
def sixty(lap_model, tmp_path_factory):
    """Results folder of 60 samples of the lap joint under Coulomb friction, in two blocks; tests change copies."""
    folder = tmp_path_factory.mktemp("sixty")
    sample_into(folder, lap_model, ["coulomb"], 60, 4)
    return folder


@pytest.fixture
def no_pictures(monkeypatch):
    """Reports have no pictures in this test: drawing them takes longer than the run that they show."""
    skip_pictures(monkeypatch.setattr)
