"""The whole process in another code: production is near solids even on a coarse mesh; wrong answers are not."""

from dataclasses import replace

import numpy as np
import pytest
from support.shells import needs_ccx
from support.wrong_models import contacts_changed, gaps_off

from fem_reference.peers.calculix_process import process
from mic.examples import folder
from mic.scene import load_scene
from verification import run as runs
from verification.solids import study
from verification.study import Team

pytestmark = pytest.mark.fem

LIMITS = {item.name: item.limit for item in study.STUDY.acceptance}


@pytest.fixture(scope="module")
def case():
    scene, samples = study.LAP.scene()
    parts = [part.model_copy(update={"size": "medium"}) for part in scene.parts]
    return scene.model_copy(update={"parts": parts}), samples[:1]


@pytest.fixture(scope="module")
def solid(case):
    return study.LAP.solids(*case, study.LAP.meshes[1])


@needs_ccx
@pytest.mark.slow
def test_forces_and_slips_are_those_of_solids(case, solid, cache):
    found = study.LAP.errors(case[0], study.ours(*case, cache), solid)
    assert found["force"] < LIMITS["force"] and found["slip"] < LIMITS["slip"], found
    assert found["key-characteristic"] < 2  # of which the coarse solids leave nearly all


PLANTED = {
    "friction ten times too large": lambda model: contacts_changed(model, friction=10 * model.contacts.friction),
    "gaps off by 20 µm": lambda model: gaps_off(model, 0.02),
    "shapes reversed": lambda model: replace(model, shape=-model.shape),
}


@needs_ccx
@pytest.mark.parametrize("error", PLANTED)
def test_a_wrong_answer_is_not(error, case, solid, cache):
    found = study.LAP.errors(case[0], study.ours(*case, cache, PLANTED[error]), solid)
    assert found["force"] > LIMITS["force"] or found["slip"] > LIMITS["slip"], found


@needs_ccx
def test_the_error_of_increments_of_the_solids_is_negligible(case):
    coarse, fine = (study.LAP.solids(*case, (3.0, 8.0), increments) for increments in (8, 16))
    assert max(study.LAP.errors(case[0], coarse, fine)[name] / LIMITS[name] for name in ("force", "slip")) < 0.05
    assert np.abs(coarse.measurements - fine.measurements).max() < 1e-4


@pytest.mark.parametrize("one", [study.LAP, study.HAT], ids=lambda one: one.name)
def test_nuggets_have_their_area_on_every_mesh(one):
    """Cells that are fused make up a circle's area to a tenth: half of it moves key characteristics by micrometres."""
    scene, _ = one.scene()
    for mesh in one.meshes:
        lower, upper = one.sheets(scene, *mesh)
        for weld in scene.welds:
            for sheet, layer in ((lower, lower.layers), (upper, 0)):
                area = sheet.cells(layer)[sheet.within(layer, weld.point, weld.radius)].sum()
                assert area == pytest.approx(np.pi * weld.radius**2, rel=0.1)


def test_zones_that_carry_little_are_not_judged():
    scene = load_scene(folder("hat_on_plate"))  # its clamps push with 200 N
    force = np.array([[[100.0, 21.0, 19.0], [100.0, 100.0, 100.0]]])
    slip = np.array([[[0.1, 0.1, 0.1], [0.02, 0.009, 0.1]]])
    one = study.Outcome(["clamp", "weld"], np.zeros((1, 1)), force, slip, 0)
    assert study.HAT.limited(scene, one, "force").tolist() == [[[True, True, False], [True, True, True]]]
    assert study.HAT.limited(scene, one, "slip").tolist() == [[[True, True, False], [True, False, True]]]
    other = replace(one, force=1.04 * force, slip=slip + 0.004, measurements=np.array([[0.001]]))
    found = study.HAT.errors(scene, other, one)
    assert found == pytest.approx({"force": 0.04, "slip": 0.2, "key-characteristic": 0.5})


def test_processes_unknown_to_the_solids_are_refused():
    scene = load_scene(folder("bracket"))
    with pytest.raises(ValueError, match=r"does not support .*clamp"):
        process(scene, [], np.zeros((1, len(scene.deviations))), None)


def test_a_study_without_its_tools_is_skipped_with_a_message(tmp_path):
    lines = []
    one = replace(study.STUDY, name="solids", missing=lambda: "ccx is not installed")
    runs.run([one], tmp_path, True, Team(), lines.append)
    assert lines == ["solids: skipped, ccx is not installed"] and runs.write_summary(tmp_path) == []
