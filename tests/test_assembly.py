"""Properties of parts and rows of joints, which production and reference share, against answers by hand."""

from pathlib import Path

import numpy as np
import pytest

import mic
from mic.model.assembly import assemble

ROOT = Path(__file__).resolve().parents[1]
SHEETS = ((0.8, 70e3, 0.33), (1.3, 206e3, 0.28))


@pytest.fixture(scope="module")
def unlike(cache):
    """The lap joint of two unlike sheets."""
    scene = mic.load_scene(ROOT / "meshes" / "lap_joint")
    keys = [dict(zip(("thickness", "young", "poisson"), sheet), size="coarse") for sheet in SHEETS]
    parts = [part.model_copy(update=own) for part, own in zip(scene.parts, keys)]
    return assemble(scene.model_copy(update={"parts": parts}), cache)


@pytest.mark.slow
def test_each_part_has_its_own_thickness_and_material(unlike):
    assert tuple((part.thickness, part.young, part.poisson) for part in unlike.parts) == SHEETS


@pytest.mark.slow
def test_candidates_yield_through_half_of_either_sheet(unlike):
    """c = (t₁/2E₁ + t₂/2E₂)/A, of each candidate's own area."""
    through = sum(t / (2 * young) for t, young, _ in SHEETS)
    np.testing.assert_allclose(unlike.contacts.layer, through / unlike.contacts.area, rtol=1e-12)
    assert len(set(unlike.contacts.area.round(6))) > 1


@pytest.mark.parametrize("part", [0, 1])
@pytest.mark.parametrize("axis", [0, 1])
def test_rotating_a_body_about_a_contact_causes_no_slip(part, axis, lap_model):
    """The lap joint's sheets touch at z = 0.5; about a point there a face turns, and does not slip."""
    at = lap_model.contacts.point * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.5]
    centre, turn = lap_model.centres[part], np.eye(3)[axis]
    for k, point in enumerate(at):
        motion = np.zeros(12)
        motion[6 * part : 6 * part + 6] = [*np.cross(turn, centre - point), *turn]
        read = lap_model.compliance.rigid(lap_model.rows["contact"][3 * k : 3 * k + 3])
        np.testing.assert_allclose(read @ motion, 0.0, atol=1e-9)
        motion[6 * part : 6 * part + 3] += [0.0, 0.0, 1.0]
        assert (read @ motion)[0] == pytest.approx(2 * part - 1)
