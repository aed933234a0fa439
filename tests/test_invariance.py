"""A scene that is turned, mirrored, renumbered or written in other units is the same scene."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.random_scenes import in_units, moved_by, random_case, renumbered, rotation, swapped, turned

from mic.contact.working_set import PATH_PENETRATION, PENETRATION
from mic.model.assembly import assemble
from mic.process.stage import LEAST_MOTION

#: How each transformed scene is made from the case and a number, with the matrix and the unit that it is seen in.
SAME = {
    "turned, in inches": lambda case, seed: _turned(case, rotation(seed, right_angles=case.has_box), 25.4),
    "mirrored, in metres": lambda case, seed: _turned(case, -rotation(seed, right_angles=case.has_box), 1000.0),
    "renumbered": lambda case, seed: (renumbered(case, seed), np.eye(3), 1.0),
}
SEEDS = st.integers(0, 10**6)


def _turned(case, matrix, unit):
    return in_units(turned(case, matrix), unit), matrix, unit


def readings(case, folder):
    """Contacts, and where each patch lies and how wide it is, (patches, 4)."""
    assembly = assemble(case.scene(folder / "scene"), folder / "cache")
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
def given_readings(tmp_path_factory):
    """What a case reads before it is changed: all changes see the same cases."""
    return cache(lambda seed, watched: readings(random_case(seed, watched=watched), tmp_path_factory.mktemp("given")))


@pytest.fixture(scope="module")
def given_measurements(tmp_path_factory):
    """What a case measures before it is changed, under a law."""
    folder = cache(lambda seed, watched: tmp_path_factory.mktemp("given"))  # coefficients serve both laws
    return cache(lambda seed, watched, law: random_case(seed, watched=watched).measurements(folder(seed, watched), law))


@pytest.mark.slow
@pytest.mark.parametrize("watched", [False, True], ids=["any", "watched"])
@pytest.mark.parametrize("change", SAME)
@settings(max_examples=2, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_the_same_scene_has_the_same_pairs_in_the_same_order(change, watched, seed, given_readings, tmp_path_factory):
    other, matrix, unit = SAME[change](random_case(seed, watched=watched), seed)
    contacts, patches = given_readings(seed, watched)
    found, found_patches = readings(other, tmp_path_factory.mktemp("changed"))
    assert len(found) == len(contacts)
    close = dict(rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.point * unit, contacts.point @ matrix.T, **close)
    np.testing.assert_allclose(found.frame[:, :, 0], contacts.frame[:, :, 0] @ matrix.T, **close)
    np.testing.assert_allclose(found.gap * unit, contacts.gap, **close)
    np.testing.assert_allclose(found.area * unit**2, contacts.area, rtol=1e-9)
    np.testing.assert_allclose(found_patches[:, :3] * unit, patches[:, :3] @ matrix.T, **close)
    np.testing.assert_allclose(found_patches[:, 3] * unit, patches[:, 3], **close)


@pytest.mark.slow
@pytest.mark.fem
@pytest.mark.parametrize("watched", [False, True], ids=["any", "watched"])
@pytest.mark.parametrize("change", SAME)
@settings(max_examples=1, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_the_same_scene_has_the_same_measurements(change, watched, seed, given_measurements, tmp_path_factory):
    other, _, unit = SAME[change](random_case(seed, watched=watched), seed)
    there = tmp_path_factory.mktemp("changed")
    for law in ("coulomb", "frictionless"):
        given_one = given_measurements(seed, watched, law)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                "mic.process.stage.LEAST_MOTION", LEAST_MOTION / unit
            )  # lengths too, though no scene states them
            patch.setattr("mic.contact.working_set.PENETRATION", PENETRATION / unit)
            patch.setattr("mic.contact.working_set.PATH_PENETRATION", PATH_PENETRATION / unit)
            changed = other.measurements(there, law) * unit
        np.testing.assert_allclose(changed, given_one, rtol=0, atol=1e-8 * np.abs(given_one).max())


@pytest.mark.slow
@pytest.mark.parametrize("watched", [False, True], ids=["any", "watched"])
@settings(max_examples=2, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_pairs_on_borders_follow_a_small_change(watched, seed, given_readings, tmp_path_factory):
    case = random_case(seed, watched=watched)
    contacts, patches = given_readings(seed, watched)
    found, found_patches = readings(moved_by(case, 1e-9, seed), tmp_path_factory.mktemp("changed"))
    np.testing.assert_allclose(found.point, contacts.point, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.gap, contacts.gap, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found_patches, patches, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.fem
@settings(max_examples=2, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_measurements_follow_a_small_change(seed, given_measurements, tmp_path_factory):
    case = random_case(seed)
    given_one = given_measurements(seed, False, "coulomb")
    changed = moved_by(case, 1e-9, seed).measurements(tmp_path_factory.mktemp("changed"), "coulomb")
    np.testing.assert_allclose(changed, given_one, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.fem
@settings(max_examples=2, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_measurements_do_not_depend_on_which_part_is_named_first(seed, tmp_path_factory):
    case = random_case(seed, patch=0.0, points=True)
    given_one = case.measurements(tmp_path_factory.mktemp("given"), "coulomb")
    changed = swapped(case).measurements(tmp_path_factory.mktemp("changed"), "coulomb")
    np.testing.assert_allclose(changed, given_one, rtol=0, atol=1e-8 * np.abs(given_one).max())


@pytest.mark.slow
@settings(max_examples=2, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_given_points_are_the_pairs_whichever_part_is_named_first(seed, tmp_path_factory):
    case = random_case(seed, patch=0.0, points=True)
    contacts, _ = readings(case, tmp_path_factory.mktemp("given"))
    found, _ = readings(swapped(case), tmp_path_factory.mktemp("changed"))
    wanted = np.array(case.table["zones"][0]["points"])
    for one in (contacts, found):
        np.testing.assert_allclose(one.point[:, :2], wanted[:, :2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.gap, contacts.gap, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.frame[:, :, 0], -contacts.frame[:, :, 0], rtol=0, atol=1e-12)
