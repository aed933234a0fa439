"""Sheets of solids by CalculiX, and the lap joint beside them: their nuggets are one piece."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.shells import needs_ccx

import mic
from fem_reference.full.model import FullModel
from fem_reference.peers.calculix_process import process
from fem_reference.peers.calculix_sheets import Sheet, extruded, graded
from mic.contact import ContactSolver
from mic.model.assembly import assemble
from verification.solids.geometry import lap_joint

pytestmark = [pytest.mark.fem, needs_ccx]

SCENE = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint"


def clamped(sheet, held, load):
    """(d,) displacements under forces (d,), the nodes `held` (m,) of all layers clamped."""
    fixed = [
        sheet.rows(layer, np.eye(len(sheet.points))[held], axis)
        for layer in range(sheet.layers + 1)
        for axis in np.eye(3)
    ]
    columns = np.unique(np.concatenate([each.indices for each in fixed]))
    free = np.setdiff1d(np.arange(len(load)), columns)
    u = np.zeros(len(load))
    u[free] = np.linalg.solve(sheet.K[free][:, free].toarray(), load[free])
    return u


def test_a_strip_of_solids_bends_as_a_beam():
    """A cantilever under a mean load at its end: P L³/3EI, and what shear adds."""
    sheet = Sheet(*extruded([(y, 0.0) for y in (0, 2.5, 5)], np.linspace(0, 40, 17)), 2.0, 210e3, 0.0)
    ends = np.flatnonzero(sheet.points[:, 0] == 40)
    tip = sheet.rows(sheet.middle, np.bincount(ends, [0.25, 0.5, 0.25], len(sheet.points)), (0, 0, 1)).toarray()[0]
    deflection = tip @ clamped(sheet, np.flatnonzero(sheet.points[:, 0] == 0), 10.0 * tip)
    inertia, area = 5 * 2**3 / 12, 5 * 2
    exact = 10.0 * 40**3 / (3 * 210e3 * inertia) + 10.0 * 40 / (5 / 6 * 105e3 * area)
    assert deflection == pytest.approx(exact, rel=5e-3)


def test_a_folded_strip_of_solids_bends_as_a_frame():
    """An angle of two legs, clamped at its foot, a load along the foot's leg at its head: P h³/3EI of the upright leg,
    and P h² b/EI of the fold that turns with the lying one. Its mitre carries the moment round the corner, and is no
    stiffer than if half a thickness of both legs were rigid."""
    b = h = 40.0
    lines = np.array([0.0, 0.6, *np.linspace(5, 40, 8)])
    profile = [*((y, 0.0) for y in b - lines[::-1]), *((b, z) for z in lines[1:])]
    sheet = Sheet(*extruded(profile, np.array([0.0, 4.0])), 1.0, 210e3, 0.0)
    head = sheet.points[:, 2] == h
    row = sheet.rows(sheet.middle, head / head.sum(), (0, 1, 0)).toarray()[0]
    found = row @ clamped(sheet, np.flatnonzero(np.isclose(sheet.points[:, 1], 0)), row)
    least, most = ((h - rigid) ** 3 / 3 + h**2 * (b - rigid) for rigid in (0.5, 0.0))
    assert least < found * 210e3 * 4 / 12 < most


def test_faces_of_a_fold_keep_the_thickness_and_discs_their_area():
    sheet = Sheet(*extruded([(-20, 0), (-10, 0), (0, 0), (0, 10), (0, 20)], np.linspace(0, 30, 7)), 1.0, 210e3, 0.3)
    upper, lower = sheet.at(sheet.layers), sheet.at(0)
    for axis, flat in ((2, sheet.points[:, 2] == 0), (1, sheet.points[:, 1] == 0)):
        assert np.abs(np.abs(upper[flat] - lower[flat])[:, axis] - 1.0).max() < 1e-12
    assert sheet.cells(sheet.middle).sum() == pytest.approx(30 * 40)
    # Within the fold, half a millimetre less on each leg.
    assert sheet.cells(sheet.layers).sum() == pytest.approx(30 * 39)
    row = sheet.mean(sheet.layers, (15, -10, 0), 4.0, (0, 0, -1))
    assert row.sum() == pytest.approx(-1.0)
    with pytest.raises(ValueError, match="no part of the sheet"):
        sheet.mean(sheet.layers, (15, -40, 0), 4.0, (0, 0, -1))


def test_only_places_in_front_of_a_face_are_projected_onto_it():
    sheet = Sheet(*extruded([(y, 0.0) for y in (0, 3, 5)], np.array([0.0, 4.0, 10.0])), 1.0, 210e3, 0.3)
    places = np.array([[4.0, 3.0, 0.7], [7.0, 4.0, 0.5], [10.1, 2.0, 0.5]])
    hit, weights, normals, height = sheet.project(sheet.layers, places)
    assert hit.tolist() == [0, 1] and (normals == (0, 0, 1)).all()
    assert height == pytest.approx([0.2, 0.0], abs=1e-12)
    assert weights @ sheet.at(sheet.layers) == pytest.approx(places[:2] - [[0, 0, 0.2], [0, 0, 0]])


def test_grid_lines_are_fine_in_the_stated_intervals():
    lines = graded([0.0, 20.0], [(10.0, 4.0)], 1.0, 5.0)
    steps = np.diff(lines)
    assert lines[0] == 0 and lines[-1] == 20 and {6.0, 14.0} <= set(lines)
    assert steps[(lines[1:] > 6) & (lines[1:] <= 14)].max() <= 1.0 < steps.max() <= 5.0


@pytest.mark.slow
def test_the_stiffness_of_the_deviated_shape_moves_characteristics_as_it_does_those_of_solids(cache):
    """A strip of 1 mm that is 0.8 mm out of shape: closing it over two nuggets stretches it, which the nominal
    stiffness does not know."""
    scene = mic.load_scene(SCENE)
    parts = [part.model_copy(update={"size": "coarse"}) for part in scene.parts]
    report = scene.report.model_copy(update={"laws": ["frictionless"]})
    lap = assemble(scene.model_copy(update={"parts": parts, "report": report}), cache)
    sample = np.array([[one.mean for one in scene.deviations]])
    without = partial(ContactSolver, law="frictionless", semidefinite=True)
    shells, solids = [], []
    for deviated in (False, True):
        shells.append(
            FullModel(lap, deviated=deviated, route="condensed").evaluate(sample[0], "frictionless").measurements
        )
        found = process(scene, lap_joint(scene, 1.25, 10.0), sample, without, 1, deviated=deviated)
        solids.append(found.measurements[0])
    ours, theirs = np.diff(shells, axis=0), np.diff(solids, axis=0)
    assert (np.abs(ours - theirs) < 0.5 * np.abs(theirs)).all() and np.abs(theirs).min() > 5e-3
