"""Estimated mesh error of a part against the error relative to a much finer mesh."""

import numpy as np
import pandas as pd
import pytest
from support.curved import curved_assembly, curved_scene, held_compliance, mesh_of
from typer.testing import CliRunner

import mic
from mic.compliance import provider
from mic.compliance.cache import influence_coefficients
from mic.errors import SceneError
from mic.model.assembly import assemble
from mic.model.mesh_accuracy import estimate_accuracy
from mic.options import app
from mic.process.model import ReducedModel
from mic.results.mesh_error import accuracy_table, read_accuracy
from mic.results.schema import ACCURACY

pytestmark = pytest.mark.fem

LINES = """across = np.union1d(np.linspace(0, 20, round(20 / size) + 1), np.linspace(20, 120, 11))
    along = np.union1d(np.linspace(0, 10, round(10 / size) + 1), np.linspace(10, 80, 8))
    m, n = len(across) - 1, len(along) - 1"""


def compliance(assembly, cache):
    return held_compliance(ReducedModel.build(assembly, influence_coefficients(assembly, cache)[0]))


@pytest.fixture(scope="module")
def limit(tmp_path_factory, cache):
    """Compliance on a mesh of 1.25 mm, H and the measurement's row, on six locators and on all."""
    return compliance(curved_assembly(tmp_path_factory.mktemp("fine"), cache, size=1.25), cache)


def errors(found, limit):
    """True errors of H and of the key characteristic's influence, on six locators and on all."""
    relative = lambda a, b: np.linalg.norm(a - b) / np.linalg.norm(b)
    return np.array([[relative(H[rows], L[rows]) for H, L in zip(found, limit)] for rows in (slice(0, 2), slice(2, 3))])


def estimates(accuracy):
    return np.array([[one.set_down, one.located] for one in accuracy.estimates])


@pytest.mark.parametrize("source, size", [("script", 10.0), ("file", 5.0)])
def test_the_estimate_is_the_error_within_a_third(size, source, tmp_path, cache, limit):
    """A script is run again at half the size; a mesh from a file is divided with the curvature estimated from it."""
    how = {"size": size} if source == "script" else {"mesh": mesh_of(size)}
    assembly = curved_assembly(tmp_path, cache, **how)
    true = errors(compliance(assembly, cache), limit)
    (found,) = estimate_accuracy(assembly, cache)
    effectivity = estimates(found) / true
    print(size, source, true.tolist(), effectivity.tolist())
    assert [one.quantity for one in found.estimates] == ["H", "K"]
    assert found.finer.triangles == 4 * found.mesh.triangles
    assert (0.7 < effectivity).all() and (effectivity < 1.4).all()


def test_the_estimate_includes_places_whose_size_the_script_fixes(tmp_path, cache, limit):
    """Lines at 10 mm under the clamp, the force and most locators, whatever the size; they are divided."""
    scene, size = curved_scene(tmp_path, size=10.0), 10.0
    text = (tmp_path / "panel.py").read_text()
    fixed = text.replace("m, n = round(120 / size), round(80 / size)", LINES).replace(
        "np.linspace(0, 120, m + 1), np.linspace(0, 80, n + 1)", "across, along"
    )
    assert "across, along" in fixed and "union1d" in fixed
    (tmp_path / "panel.py").write_text(fixed)
    assembly = assemble(scene, cache)
    true = errors(compliance(assembly, cache), limit)
    (found,) = estimate_accuracy(assembly, cache)
    effectivity = estimates(found) / true
    print(size, true.tolist(), effectivity.tolist())
    assert found.finer.triangles == 4 * found.mesh.triangles
    assert (0.7 < effectivity).all() and (effectivity < 1.4).all()


def test_a_finer_mesh_costs_more_and_is_measured(tmp_path, cache):
    (found,) = estimate_accuracy(curved_assembly(tmp_path, cache, size=5.0), cache)
    assert found.finer.nodes > 3.5 * found.mesh.nodes
    assert np.sqrt(found.finer.triangles / found.mesh.triangles) == pytest.approx(2, rel=0.01)
    assert found.finer.seconds > found.mesh.seconds > 0 and found.finer.memory > 3 * found.mesh.memory > 0
    reached = found.mesh_for(found.worst / 4)
    assert reached.nodes == pytest.approx(4 * found.mesh.nodes) and reached.seconds >= 3.99 * found.mesh.seconds
    assert reached.memory == pytest.approx(found.finer.memory, rel=0.1)


def test_an_estimate_is_cached_and_recomputed_when_the_part_changes(tmp_path, cache, monkeypatch):
    assembly = curved_assembly(tmp_path, cache, size=10.0)
    first = estimate_accuracy(assembly, cache)
    told = []
    assert estimate_accuracy(assembly, cache, told.append) == first and not told

    def refuse(part):
        raise AssertionError("computed again")

    monkeypatch.setattr(provider, "find", refuse)
    assert estimate_accuracy(assembly, cache) == first
    with pytest.raises(AssertionError, match="computed again"):
        estimate_accuracy(curved_assembly(tmp_path, cache, size=8.0), cache)


def test_a_script_that_ignores_the_size_is_refused(tmp_path, cache):
    scene = curved_scene(tmp_path, size=10.0)
    (tmp_path / "panel.py").write_text((tmp_path / "panel.py").read_text().replace("/ size", "/ 10"))
    with pytest.raises(SceneError, match="'sheet': geometry: .*half the size"):
        estimate_accuracy(assemble(scene, cache), cache)


def test_a_part_with_a_stated_accuracy_gets_a_mesh_that_reaches_it(tmp_path, cache, limit):
    assembly = curved_assembly(tmp_path, cache, accuracy=0.03)
    true = errors(compliance(assembly, cache), limit)
    assert true.max() < 0.03 and true.max() > 0.006  # reached, and not by far too fine a mesh
    assert set(assembly.sizes) == {"sheet"} and 1 < assembly.sizes["sheet"] < 10
    (found,) = estimate_accuracy(assembly, cache)
    assert found.worst <= 0.03 and found.mesh.nodes == len(assembly.parts[0].surface.points)


def test_the_element_size_found_for_an_accuracy_is_cached(tmp_path, cache, monkeypatch):
    first = curved_assembly(tmp_path, cache, accuracy=0.03)
    monkeypatch.setattr("mic.model.element_sizes.estimate_accuracy", lambda *arguments: pytest.fail("estimated again"))
    again = curved_assembly(tmp_path, cache, accuracy=0.03)
    assert again.sizes == first.sizes and again.parts[0].fingerprint() == first.parts[0].fingerprint()
    with pytest.raises(pytest.fail.Exception):
        (tmp_path / "panel.py").write_text((tmp_path / "panel.py").read_text().replace("10 * np.sin", "11 * np.sin"))
        assemble(mic.load_scene(tmp_path), cache)


def test_an_unreachable_accuracy_is_refused_before_its_mesh_is_solved(tmp_path, cache):
    with pytest.raises(SceneError, match="part 'sheet': accuracy: 1e-06 is not reached: .* state a"):
        curved_assembly(tmp_path, cache, accuracy=1e-6)


FREED = '[[stages]]\nkind = "release"\nkeep = []\n\n[[stages]]\nkind = "measure"'


def test_an_impossible_process_is_refused_before_the_accuracy_is_estimated(tmp_path, cache, monkeypatch):
    monkeypatch.setattr("mic.model.element_sizes.estimate_accuracy", lambda *arguments: pytest.fail("solved"))
    curved_scene(tmp_path, accuracy=0.01)
    text = (tmp_path / "scene.toml").read_text()
    (tmp_path / "scene.toml").write_text(text.replace('[[stages]]\nkind = "measure"', FREED))
    scene = mic.load_scene(tmp_path)
    for ask in (lambda: mic.run(scene, tmp_path / "results", cache), lambda: mic.reduce(scene, cache)):
        with pytest.raises(SceneError, match=r"stages \(release\): 6 rigid-body motions are free"):
            ask()
    done = CliRunner().invoke(app, ["check", str(tmp_path), "--page", str(tmp_path / "check.html")])
    assert isinstance(done.exception, SceneError) and "rigid-body motions are free" in str(done.exception)


def test_one_message_reports_errors_of_all_parts(tmp_path, cache):
    text = '[[parts]]\nname = "other"\nmesh = "other.inp"\nthickness = 1\nrests = true\n\n'
    text += '[[zones]]\nname = "Z"\nparts = ["sheet", "other"]\n'
    scene = curved_scene(tmp_path, accuracy=0.01, keys=text)
    (tmp_path / "panel.py").write_text("build = 3\n")
    with pytest.raises(SceneError, match=r"(?s)part 'sheet': geometry: .*part 'other': mesh: there is no file"):
        assemble(scene, cache)


@pytest.mark.parametrize(
    "keys, words",
    [
        ("size = 5\naccuracy = 0.01", "give either size or accuracy"),
        ("accuracy = 0", "greater than 0"),
        ("accuracy = 0.7", "less than or equal to 0.5"),
        ("", "needs size: .* or accuracy"),
    ],
)
def test_a_part_needs_either_a_size_or_an_accuracy(tmp_path, keys, words):
    curved_scene(tmp_path, size=10.0)
    text = (tmp_path / "scene.toml").read_text()
    (tmp_path / "scene.toml").write_text(text.replace("size = 10.0", keys))
    with pytest.raises(SceneError, match=words):
        mic.load_scene(tmp_path)


def test_a_setting_does_not_change_a_stated_accuracy(tmp_path):
    scene = curved_scene(tmp_path, accuracy=0.02, keys="")
    text = (tmp_path / "scene.toml").read_text()
    (tmp_path / "scene.toml").write_text('setting = "standard"\n' + text)
    assert mic.load_scene(tmp_path).parts == scene.parts


def test_a_run_with_report_accuracy_stores_and_reports_the_estimate(tmp_path, cache):
    from mic.report.page import write_report

    scene = curved_scene(tmp_path, size=10.0, keys="[monte_carlo]\nsamples = 3\n[report]\naccuracy = true\n")
    outcome = mic.run(scene, tmp_path / "results", cache)
    expected = accuracy_table(estimate_accuracy(curved_assembly(tmp_path, cache, size=10.0), cache))
    pd.testing.assert_frame_equal(read_accuracy(tmp_path / "results"), expected, rtol=1e-8)
    page = write_report(tmp_path / "results", outcome).read_text()
    table = page[page.index('id="accuracy"') : page.index("Estimated from the same functionals")]
    for value in (*expected["set_down"], *expected["located"]):
        assert f"{100 * value:.1f} %" in table


def test_a_run_without_report_accuracy_neither_computes_nor_shows_the_estimate(tmp_path, cache, monkeypatch):
    from mic.report.page import write_report

    monkeypatch.setattr("mic.runs.estimate_accuracy", lambda *arguments: pytest.fail("estimated"))
    outcome = mic.run(
        curved_scene(tmp_path, size=10.0, keys="[monte_carlo]\nsamples = 3\n"), tmp_path / "results", cache
    )
    assert read_accuracy(tmp_path / "results") is None and not (tmp_path / "results" / ACCURACY.place).exists()
    assert 'id="accuracy"' not in write_report(tmp_path / "results", outcome).read_text()
