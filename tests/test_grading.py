"""Element sizes that are finer around some places."""

import numpy as np
import pytest
from support.curved import curved_assembly, curved_scene

import mic
from mic.geometry.grading import GROWTH, GradedSize
from mic.geometry.load import finer_surface, load_part
from mic.scene.part import Part

GRADED = """
import numpy as np

def build(part, size):
    x = [0.0]
    while x[-1] < 100:
        x.append(x[-1] + (size.at(np.array([[x[-1], 0, 0]]))[0] if hasattr(size, "at") else size))
    x, n = np.array(x), len(x)
    points = np.column_stack([np.repeat(x, 2), np.tile([0, 5], n), np.zeros(2 * n)])
    a = 2 * np.arange(n - 1)
    return points, np.concatenate([np.column_stack([a, a + 2, a + 1]), np.column_stack([a + 1, a + 2, a + 3])])
"""


def test_sizes_grow_with_distance_up_to_the_largest():
    size = GradedSize(10, [[0, 0, 0], [50, 0, 0]], [2, 4])
    x = np.array([[0, 0, 0], [10, 0, 0], [50, 3, 4], [1000, 0, 0.0]])
    assert size == 10
    assert size.at(x) == pytest.approx([2, 2 + 10 * GROWTH, 4 + 5 * GROWTH, 10])
    assert size.times(0.5) == 5
    assert size.times(0.5).at(x)[:3] == pytest.approx([1, 1 + 10 * GROWTH, 2 + 5 * GROWTH])


def test_a_graded_size_never_exceeds_the_overall_size():
    assert GradedSize(3, [[0, 0, 0]], [8]).at(np.zeros((1, 3))) == pytest.approx([3])
    assert GradedSize(3, [], []).at(np.ones((2, 3))) == pytest.approx([3, 3])


@pytest.mark.slow
def test_a_script_can_use_the_graded_size_and_its_mesh_is_cached_by_it(tmp_path):
    (tmp_path / "strip.py").write_text(GRADED)
    part = Part(name="strip", geometry="strip.py", accuracy=0.1, thickness=1.0)
    graded = GradedSize(10, [[50, 0, 0]], [1])
    lengths = {}
    for name, size in (("even", 10.0), ("graded", graded), ("elsewhere", GradedSize(10, [[0, 0, 0]], [1]))):
        surface = load_part(part, tmp_path, tmp_path / "cache", size).surface
        lengths[name] = np.diff(np.unique(surface.points[:, 0]))
    assert lengths["even"] == pytest.approx(10)
    assert lengths["graded"].min() < 2 and lengths["graded"][0] == pytest.approx(10)
    assert lengths["elsewhere"][0] == pytest.approx(1)
    finer = finer_surface(part, tmp_path, tmp_path / "cache", graded)
    assert np.diff(np.unique(finer.points[:, 0])).min() < 0.7 * lengths["graded"].min()


@pytest.mark.fem
def test_elements_are_no_larger_than_the_discs_of_the_scene(tmp_path, cache):
    assembly = curved_assembly(tmp_path, cache, accuracy=0.2)
    size, scene = assembly.sizes["sheet"], assembly.scene
    points = [item.point for item in (*scene.locators, *scene.clamps, *scene.deviations, *scene.measurements)]
    assert size.at(np.array(points)) == pytest.approx(np.minimum([6] * 7 + [8] * 3, size))


def test_a_scene_with_an_accuracy_survives_writing_and_reading(tmp_path):
    scene = curved_scene(tmp_path, accuracy=0.02)
    again = mic.scene.Scene(**scene.model_dump(), folder=scene.folder)
    assert again == scene
