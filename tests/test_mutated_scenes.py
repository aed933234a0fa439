"""Mutated scenes end in an error of the program, or in results; nonsense among these is warned of.

``script/fuzz scenes`` runs the same attack for longer.
"""

import copy

import numpy as np
import pytest
from support import attack_scenes
from support.attack_scenes import attack, mutated, outcome, scene_table

import mic
from mic.model.one_sigma import Displacement
from mic.plausibility import (
    Results,
    find_warnings,
    find_warnings_of_results,
    find_warnings_of_sources,
    validity,
)
from mic.scene.load import read_table

LAP = attack_scenes.MESHES / "lap_joint" / "scene.toml"


def edited(table, key, **keys):
    scene = scene_table("lap_joint")
    scene[table][key] |= keys
    return scene


@pytest.mark.slow
@pytest.mark.fem
def test_mutated_scenes_end_in_an_error_or_in_results_that_make_sense(tmp_path):
    """One of these five is read, and solved."""
    assert attack(np.random.default_rng(6), tmp_path, 5) == []


def test_mutated_scenes_are_read_or_refused():
    rng, refused = np.random.default_rng(5), 0
    for _ in range(20):
        name, table, _, edits = mutated(rng)
        try:
            read_table(copy.deepcopy(table), attack_scenes.MESHES / name / "scene.toml")
        except mic.MicError as error:
            assert str(error), edits
            refused += 1
    assert 5 < refused < 20


def test_an_attack_reports_an_unexpected_exception(tmp_path, monkeypatch):
    def fail(*_):
        raise KeyError("raw")

    monkeypatch.setattr(attack_scenes, "read_table", fail)
    end, said = outcome("lap_joint", scene_table("lap_joint"), [], tmp_path)
    assert end == "failed" and "KeyError: 'raw'" in said


IMPOSSIBLE = {
    "thickness": ("parts", {"thickness": 5e-4}, "part lower: thickness = 0.0005 mm"),
    "modulus in GPa": ("parts", {"young": 210}, "part lower: young = 210 MPa"),
    "density in g/cm³": ("parts", {"density": 7.85}, "part lower: density = 7.85 kg/m³"),
    "expansion in µm/(m K)": ("parts", {"expansion": 12.0}, "part lower: expansion = 12 1/K"),
    "force in mN": ("clamps", {"force": 60e3 * 10}, "clamp C1-upper: force = 600000 N"),
    "friction in %": ("zones", {"friction": 5.0}, "zone lap: friction = 5"),
    "sigma": ("deviations", {"sigma": 1e6}, "deviation F1: sigma = 1e+06 N"),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_impossible_values_come_first_and_the_scene_is_not_called_valid(case):
    table, keys, words = IMPOSSIBLE[case]
    warnings = find_warnings(read_table(edited(table, 0, **keys), LAP))
    assert warnings[0].impossible and str(warnings[0]).startswith(words)
    assert validity(warnings).startswith("Implausible")
    assert not any(warning.impossible for warning in find_warnings(read_table(scene_table("lap_joint"), LAP)))


@pytest.mark.parametrize("value", [1e300, -1e300, 1e16])
def test_numbers_beyond_all_quantities_are_refused(value):
    with pytest.raises(mic.SceneError, match=r"point\[1\] \(lower-A1\): .* larger than any quantity"):
        read_table(edited("locators", 0, point=[5, value, 0]), LAP)
    with pytest.raises(mic.SceneError, match="smaller than any quantity"):
        read_table(edited("parts", 0, thickness=5e-324), LAP)
    with pytest.raises(mic.SceneError, match="no coefficient of friction"):
        read_table(edited("zones", 0, friction=1000.0), LAP)


def test_results_out_of_proportion_are_warned_of():
    scene, extent = read_table(scene_table("lap_joint"), LAP), {"lower": 100.0, "upper": 100.0}
    far = Results(scene, extent, np.array([0.1, 0.2]), np.array([23.0, 1.0]), {"clamp": 1e7})
    assert [str(warning).split(";")[0] for warning in find_warnings_of_results(far)] == [
        "measurement M1: its 6σ is 23 mm, and part upper measures 100 mm and is 1 mm thick",
        "stage clamp: a support or a contact pair carries 1e+07 N",
    ]
    usual = Results(scene, extent, np.array([0.1, 0.2]), np.array([2.0, 1.0]), {"clamp": 500.0})
    assert find_warnings_of_results(usual) == ()
    bent = Results(scene, {"lower": 1000.0, "upper": 1000.0}, np.array([0.1, 5.1]), np.array([4.9, 1.0]))
    (warning,) = find_warnings_of_results(bent)  # more than five thicknesses
    assert str(warning).startswith("measurement M2: its mean is 5.1 mm") and "5 thicknesses" in str(warning)


def test_sources_that_move_a_part_far_are_warned_of():
    """One standard deviation beyond a tenth of a usual 6σ; what is not known is not warned of."""
    moved = [Displacement(name, (), length, "upper") for name, length in (("far", 0.51), ("near", 0.49), ("?", np.nan))]
    (warning,) = find_warnings_of_sources(moved)
    assert str(warning).startswith("deviation far: its 1 σ moves part upper by 0.51 mm; usual is at most 0.5 mm")
