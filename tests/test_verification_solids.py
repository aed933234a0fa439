"""The whole process in another code: production is near solids even on their coarsest mesh; wrong answers are not."""

from dataclasses import replace

import numpy as np
import pytest

from fem_reference.peers import calculix
from verification import run as runs
from verification.solids import study
from verification.study import Team

needs_ccx = pytest.mark.skipif(not calculix.available(), reason="ccx is not installed: apt-get install calculix-ccx")
pytestmark = pytest.mark.fem

LIMITS = {item.name: item.limit for item in study.STUDY.acceptance}


@pytest.fixture(scope="module")
def case():
    scene, samples = study.case()
    parts = [part.model_copy(update={"size": "medium"}) for part in scene.parts]
    return scene.model_copy(update={"parts": parts}), samples[:2]


@pytest.fixture(scope="module")
def solid(case):
    return study.solids_of(*case, study.MESHES[0])


@needs_ccx
def test_forces_and_slips_are_those_of_solids(case, solid, cache):
    found = study.errors(study.ours(*case, cache), solid)
    assert found["force"] < LIMITS["force"] and found["slip"] < LIMITS["slip"], found
    assert found["key-characteristic"] < 5  # of which the coarse solids leave nearly all


PLANTED = {
    "friction ten times too large": lambda model: replace(
        model, contacts=replace(model.contacts, friction=10 * model.contacts.friction)
    ),
    "gaps off by 20 µm": lambda model: replace(model, contacts=replace(model.contacts, gap=model.contacts.gap + 0.02)),
    "shapes reversed": lambda model: replace(model, shape=-model.shape),
}


@needs_ccx
@pytest.mark.parametrize("error", PLANTED)
def test_a_wrong_answer_is_not(error, case, solid, cache):
    found = study.errors(study.ours(*case, cache, PLANTED[error]), solid)
    assert found["force"] > LIMITS["force"] or found["slip"] > LIMITS["slip"], found


@needs_ccx
def test_increments_of_the_solids_leave_nothing_that_is_judged(case, solid):
    again = study.solids_of(*case, study.MESHES[0], increments=16)
    assert max(study.errors(solid, again)[name] / LIMITS[name] for name in ("force", "slip")) < 0.05
    assert np.abs(solid.measurements - again.measurements).max() < 1e-4


def test_a_study_whose_needs_are_missing_is_left_out_and_says_so(tmp_path):
    lines = []
    one = replace(study.STUDY, name="solids", missing=lambda: "ccx is not installed")
    runs.run([one], tmp_path, True, Team(), lines.append)
    assert lines == ["solids: left out, ccx is not installed"] and runs.write_summary(tmp_path) == []
