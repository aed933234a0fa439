"""A scene that is turned, mirrored, renumbered or written in other units is the same scene."""

import numpy as np
import pytest
from support.random_scenes import in_units, moved_by, random_case, renumbered, rotation, swapped, turned

from mic.contact.working_set import PATH_PENETRATION, PENETRATION
from mic.model.assembly import assemble
from mic.process.model import ReducedModel
from mic.process.stage import LEAST_MOTION
from mic.process.stiffness import coefficients

pytestmark = pytest.mark.slow

#: Seeds of a plate with pairs along a path, an angle with candidates and a hat with pairs in a box.
PATH, CANDIDATES, BOX = (11, False), (6, True), (2, False)
#: Changes of a case, by a number, with the matrix and the unit in which the changed scene is seen.
TURNED, MIRRORED = "turned, renumbered, in inches", "mirrored, in metres"
CHANGES = {
    TURNED: lambda case, seed: _turned(renumbered(case, seed), rotation(seed, right_angles=case.has_box), 25.4),
    MIRRORED: lambda case, seed: _turned(case, -rotation(seed, right_angles=case.has_box), 1000.0),
}
CHANGED = [(TURNED, *CANDIDATES), (MIRRORED, *PATH), (TURNED, *BOX)]


def _turned(case, matrix, unit):
    return in_units(turned(case, matrix), unit), matrix, unit


def contacts_and_patches(assembly):
    """Contacts, and the centre and width of each patch that parts are read at, (patches, 4)."""
    rows = []
    for part in assembly.parts:
        for patch in part.functionals.patches:
            if abs(patch.weight.sum()) < 0.5:
                continue  # a nugget's first moments are those along axes that do not turn with the scene
            x = part.surface.at(patch.triangle, patch.barycentric)
            centre = patch.weight @ x
            rows.append([*centre, np.sqrt(patch.weight @ ((x - centre) ** 2).sum(axis=1))])
    return assembly.contacts, np.array(rows)


@pytest.fixture(scope="module")
def assembled(tmp_path_factory):
    """``assembled(case, name, seed)``: the assembly of a case, once for each name and seed, and its cache folder."""
    known = {}

    def assemble_once(case, *key):
        if key not in known:
            folder = tmp_path_factory.mktemp("case")
            known[key] = assemble(case.scene(folder / "scene"), folder / "cache"), folder / "cache"
        return known[key]

    return assemble_once


def measurements(case, assembly, folder, *laws):
    """(laws, n, k) measurements at the case's deviations."""
    model = ReducedModel.build(assembly, coefficients(assembly, folder)[0])
    return np.array([model.evaluate(case.deviations, law).measurements for law in laws])


@pytest.mark.parametrize("change, seed, watched", CHANGED)
def test_a_changed_scene_has_the_same_pairs_in_the_same_order(change, seed, watched, assembled):
    case = random_case(seed, watched=watched)
    other, matrix, unit = CHANGES[change](case, seed)
    contacts, patches = contacts_and_patches(assembled(case, "given", seed)[0])
    found, found_patches = contacts_and_patches(assembled(other, change, seed)[0])
    assert len(found) == len(contacts)
    close = dict(rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.point * unit, contacts.point @ matrix.T, **close)
    np.testing.assert_allclose(found.frame[:, :, 0], contacts.frame[:, :, 0] @ matrix.T, **close)
    np.testing.assert_allclose(found.gap * unit, contacts.gap, **close)
    np.testing.assert_allclose(found.area * unit**2, contacts.area, rtol=1e-9)
    np.testing.assert_allclose(found_patches[:, :3] * unit, patches[:, :3] @ matrix.T, **close)
    np.testing.assert_allclose(found_patches[:, 3] * unit, patches[:, 3], **close)


@pytest.mark.fem
@pytest.mark.parametrize("change, seed, watched", CHANGED)
def test_a_changed_scene_has_the_same_measurements(change, seed, watched, assembled, monkeypatch):
    case = random_case(seed, watched=watched)
    other, _, unit = CHANGES[change](case, seed)
    laws = ("coulomb", "frictionless")
    expected = measurements(case, *assembled(case, "given", seed), *laws)
    # Lengths of the program too, though no scene states them.
    monkeypatch.setattr("mic.process.stage.LEAST_MOTION", LEAST_MOTION / unit)
    monkeypatch.setattr("mic.contact.working_set.PENETRATION", PENETRATION / unit)
    monkeypatch.setattr("mic.contact.working_set.PATH_PENETRATION", PATH_PENETRATION / unit)
    found = measurements(other, *assembled(other, change, seed), *laws) * unit
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("seed, watched", [PATH, CANDIDATES])
def test_pairs_follow_a_small_change(seed, watched, assembled):
    case = random_case(seed, watched=watched)
    contacts, patches = contacts_and_patches(assembled(case, "given", seed)[0])
    found, found_patches = contacts_and_patches(assembled(moved_by(case, 1e-9, seed), "moved", seed)[0])
    np.testing.assert_allclose(found.point, contacts.point, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.gap, contacts.gap, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found_patches, patches, rtol=0, atol=1e-6)


@pytest.mark.fem
def test_given_points_are_the_pairs_whichever_part_is_named_first(assembled):
    case = random_case(1, patch=0.0, points=True)
    both = [(one, *assembled(one, name)) for one, name in ((case, "points"), (swapped(case), "swapped"))]
    contacts, found = (assembly.contacts for _, assembly, _ in both)
    wanted = np.array(case.table["zones"][0]["points"])
    for pairs in (contacts, found):
        np.testing.assert_allclose(pairs.point[:, :2], wanted[:, :2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.gap, contacts.gap, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.frame[:, :, 0], -contacts.frame[:, :, 0], rtol=0, atol=1e-12)
    measured, again = (measurements(*one, "coulomb") for one in both)
    np.testing.assert_allclose(again, measured, rtol=0, atol=1e-8 * np.abs(measured).max())
