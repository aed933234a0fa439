"""A scene that is turned, mirrored, renumbered or written in other units is the same scene."""

import numpy as np
import pytest
from support.random_scenes import moved_by, random_case, rotation, swapped

from mic.errors import Problems
from mic.model.assembly import assemble_placed, load_placed
from mic.process.model import ReducedModel
from mic.process.stiffness import coefficients
from verification.symmetry.transformation import Transformation

pytestmark = pytest.mark.slow

#: Seeds of a plate with pairs along a path, an angle with candidates and a hat with pairs in a box.
PATH, CANDIDATES, BOX = (11, False), (6, True), (2, False)
#: Transformations of a case.
TURNED, MIRRORED = "turned, renumbered, in inches", "mirrored, in metres"
CHANGED = [(TURNED, *CANDIDATES), (MIRRORED, *PATH), (TURNED, *BOX)]


def change_of(name, case, seed):
    matrix = rotation(seed, right_angles=case.has_box)
    if name == MIRRORED:
        return Transformation(name, -matrix, length=1e-3)
    return Transformation(name, matrix, length=1 / 25.4, renumbered=True)


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
    assemblies = {}

    def assemble_once(case, *key, change=None):
        if key not in assemblies:
            folder = tmp_path_factory.mktemp("case")
            placed = load_placed(case.scene(folder / "scene"), folder / "cache", {}, Problems())
            placed = placed if change is None else change.apply(placed)
            assemblies[key] = assemble_placed(placed, folder / "cache"), folder / "cache"
        return assemblies[key]

    return assemble_once


@pytest.mark.parametrize("name, seed, watched", CHANGED)
def test_a_changed_scene_has_the_same_pairs_in_the_same_order(name, seed, watched, assembled):
    case = random_case(seed, watched=watched)
    change = change_of(name, case, seed)
    contacts, patches = contacts_and_patches(assembled(case, "given", seed)[0])
    found, found_patches = contacts_and_patches(assembled(case, name, seed, change=change)[0])
    assert len(found) == len(contacts)
    close = dict(rtol=0, atol=1e-9 * change.length)
    np.testing.assert_allclose(found.point, change.points(contacts.point), **close)
    np.testing.assert_allclose(found.frame[:, :, 0], contacts.frame[:, :, 0] @ change.matrix.T, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.gap, contacts.gap * change.length, **close)
    np.testing.assert_allclose(found.area, contacts.area * change.length**2, rtol=1e-9)
    np.testing.assert_allclose(found_patches[:, :3], change.points(patches[:, :3]), **close)
    np.testing.assert_allclose(found_patches[:, 3], patches[:, 3] * change.length, **close)


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
    measured, again = (
        ReducedModel.build(assembly, coefficients(assembly, folder)[0]).evaluate(one.deviations).measurements
        for one, assembly, folder in both
    )
    np.testing.assert_allclose(again, measured, rtol=0, atol=1e-8 * np.abs(measured).max())
