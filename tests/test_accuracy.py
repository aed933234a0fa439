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
from mic.report.style import signed_micrometres
from mic.results.error_sources import error_budget
from mic.results.mesh_error import accuracy_table
from mic.results.schema import ACCURACY, MESH_CHANGES

pytestmark = pytest.mark.fem

#: Lines at 10 mm under the clamp, the force and most locators, whatever the size.
LINES = """across = np.union1d(np.linspace(0, 20, round(20 / size) + 1), np.linspace(20, 120, 11))
    along = np.union1d(np.linspace(0, 10, round(10 / size) + 1), np.linspace(10, 80, 8))
    m, n = len(across) - 1, len(along) - 1
    x, y = (a.ravel() for a in np.meshgrid(across, along, indexing="ij"))
    i, j ="""


def compliance(assembly, cache):
    return held_compliance(ReducedModel.build(assembly, influence_coefficients(assembly, cache)[0]))


@pytest.fixture(scope="module")
def limit(tmp_path_factory, cache):
    """Compliance on a mesh of 2 mm, H and the measurement's row, on six locators and on all."""
    return compliance(curved_assembly(tmp_path_factory.mktemp("fine"), cache, size=2.0), cache)


@pytest.fixture(scope="module")
def coarse(tmp_path_factory, cache):
    """The sheet in elements of 10 mm."""
    return curved_assembly(tmp_path_factory.mktemp("coarse"), cache, size=10.0)


def edit(path, old, new):
    """Replace text that a file holds."""
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def errors(found, limit):
    """True errors of H and of the key characteristic's influence, on six locators and on all."""
    relative = lambda a, b: np.linalg.norm(a - b) / np.linalg.norm(b)
    return np.array([[relative(H[rows], L[rows]) for H, L in zip(found, limit)] for rows in (slice(0, 2), slice(2, 3))])


@pytest.mark.parametrize("source", ["script", "file", "lines"])
def test_the_estimate_is_the_error_within_a_third(source, tmp_path, cache, limit):
    """A script is run again at half the size; a mesh from a file is divided with the curvature estimated from it, and
    so is one of a script that fixes sizes itself."""
    scene = curved_scene(tmp_path, **({"mesh": mesh_of(10.0)} if source == "file" else {"size": 10.0}))
    if source == "lines":
        script = (tmp_path / "panel.py").read_text()
        drawn = script[script.index("m, n =") : script.index("i, j =") + len("i, j =")]
        edit(tmp_path / "panel.py", drawn, LINES)
    assembly = assemble(scene, cache)
    (found,) = estimate_accuracy(assembly, cache)
    estimates = np.array([[one.set_down, one.located] for one in found.estimates])
    effectivity = estimates / errors(compliance(assembly, cache), limit)
    assert [one.quantity for one in found.estimates] == ["H", "K"]
    assert found.finer.triangles == 4 * found.mesh.triangles
    assert (0.7 < effectivity).all() and (effectivity < 1.4).all(), effectivity


def test_a_finer_mesh_costs_more_and_is_measured(coarse, cache):
    (found,) = estimate_accuracy(coarse, cache)
    assert found.finer.nodes > 3.5 * found.mesh.nodes
    assert found.finer.seconds > found.mesh.seconds > 0 and found.finer.memory > found.mesh.memory > 0
    reached = found.mesh_for(found.worst / 4)
    assert reached.nodes == pytest.approx(4 * found.mesh.nodes) and reached.seconds >= 3.99 * found.mesh.seconds
    assert reached.memory == pytest.approx(found.finer.memory, rel=0.2)


def test_an_estimate_is_cached_and_recomputed_when_the_part_changes(coarse, tmp_path, cache, monkeypatch):
    first = estimate_accuracy(coarse, cache)

    def refuse(part):
        raise AssertionError("computed again")

    monkeypatch.setattr(provider, "find", refuse)
    assert estimate_accuracy(coarse, cache) == first
    with pytest.raises(AssertionError, match="computed again"):
        estimate_accuracy(curved_assembly(tmp_path, cache, size=20.0), cache)


def test_a_script_that_ignores_the_size_is_refused(tmp_path, cache):
    scene = curved_scene(tmp_path, size=10.0)
    edit(tmp_path / "panel.py", "/ size", "/ 10")
    with pytest.raises(SceneError, match="'sheet': geometry: .*half the size"):
        estimate_accuracy(assemble(scene, cache), cache)


@pytest.mark.slow
def test_a_part_with_a_stated_accuracy_gets_a_mesh_that_reaches_it_and_its_size_is_cached(
    tmp_path, cache, limit, monkeypatch
):
    assembly = curved_assembly(tmp_path, cache, accuracy=0.1)
    true = errors(compliance(assembly, cache), limit)
    assert 0.02 < true.max() < 0.1  # reached, and not by far too fine a mesh
    assert set(assembly.sizes) == {"sheet"} and 1 < assembly.sizes["sheet"] < 10
    (found,) = estimate_accuracy(assembly, cache)
    assert found.worst <= 0.1 and found.mesh.nodes == len(assembly.parts[0].surface.points)
    monkeypatch.setattr("mic.model.element_sizes.estimate_accuracy", lambda *arguments: pytest.fail("estimated again"))
    again = curved_assembly(tmp_path, cache, accuracy=0.1)
    assert again.sizes == assembly.sizes and again.parts[0].fingerprint() == assembly.parts[0].fingerprint()
    edit(tmp_path / "panel.py", "10 * np.sin", "11 * np.sin")
    with pytest.raises(pytest.fail.Exception):
        assemble(mic.load_scene(tmp_path), cache)


def test_an_unreachable_accuracy_is_refused_before_its_mesh_is_solved(tmp_path, cache):
    with pytest.raises(SceneError, match="part 'sheet': accuracy: 1e-06 is not reached: .* state a"):
        curved_assembly(tmp_path, cache, accuracy=1e-6)


FREED = '[[stages]]\nkind = "release"\nkeep = []\n\n[[stages]]\nkind = "measure"'


def test_an_impossible_process_is_refused_before_the_accuracy_is_estimated(tmp_path, cache, monkeypatch, no_pictures):
    monkeypatch.setattr("mic.model.element_sizes.estimate_accuracy", lambda *arguments: pytest.fail("solved"))
    curved_scene(tmp_path, accuracy=0.01)
    edit(tmp_path / "scene.toml", '[[stages]]\nkind = "measure"', FREED)
    with pytest.raises(SceneError, match=r"stages \(release\): 6 rigid-body motions are free"):
        mic.reduce(mic.load_scene(tmp_path), cache)
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
    edit(tmp_path / "scene.toml", "size = 10.0", keys)
    with pytest.raises(SceneError, match=words):
        mic.load_scene(tmp_path)


def test_a_setting_does_not_change_a_stated_accuracy(tmp_path):
    scene = curved_scene(tmp_path, accuracy=0.02)
    edit(tmp_path / "scene.toml", '\nname = "curved"', '\nname = "curved"\nsetting = "standard"')
    assert mic.load_scene(tmp_path).parts == scene.parts


@pytest.mark.parametrize("wanted", [True, False])
def test_a_run_estimates_its_accuracy_on_request(wanted, coarse, tmp_path, cache, monkeypatch, no_pictures):
    from mic.report.page import write_report

    expected = accuracy_table(estimate_accuracy(coarse, cache))
    if not wanted:
        monkeypatch.setattr("mic.runs.estimate_accuracy", lambda *arguments: pytest.fail("estimated"))
    keys = f"[monte_carlo]\nsamples = 3\n[report]\naccuracy = {str(wanted).lower()}\n"
    outcome = mic.run(curved_scene(tmp_path, size=10.0, keys=keys), tmp_path / "results", cache)
    page = write_report(tmp_path / "results", outcome).read_text()
    found = outcome.study(ACCURACY)
    assert ('id="accuracy"' in page) == (tmp_path / "results" / ACCURACY.place).exists() == wanted
    if wanted:
        pd.testing.assert_frame_equal(found, expected, rtol=1e-8)
        table = page[page.index('id="accuracy"') : page.index("Estimated from the same functionals")]
        for value in (*expected["set_down"], *expected["located"]):
            assert f"{100 * value:.1f} %" in table
        row = MESH_CHANGES.read(tmp_path / "results", "").iloc[0]
        assert signed_micrometres(row["mean_change"]) in page[page.index('id="mesh-changes"') :]
    else:
        assert found is None and 'id="mesh-changes"' not in page


@pytest.mark.slow
def test_the_expected_change_is_that_on_a_much_finer_mesh(tmp_path, cache):
    """The clamp shifts the mean. The dent varies it: 6σ depends on the mesh by less than 1 % of itself."""
    keys = "[monte_carlo]\nsamples = {}\n[report]\naccuracy = {}\n"
    outcomes = []
    for size, samples, wanted in ((10.0, 40, "true"), (2.0, 40, "false")):
        folder = tmp_path / str(size)
        folder.mkdir()
        scene = curved_scene(folder, size=size, keys=keys.format(samples, wanted))
        outcomes.append(mic.run(scene, folder / "results", cache))
    row = MESH_CHANGES.read(tmp_path / "10.0" / "results", "").iloc[0]
    coarse, fine = (outcome.measurement_statistics.iloc[0] for outcome in outcomes)
    true = fine["mean"] - coarse["mean"]
    assert abs(true) > 0.1 * coarse["six_sigma"] and 0.7 < row["mean_change"] / true < 1.4
    assert abs(row["six_sigma_change"]) < 0.01 * coarse["six_sigma"]
    assert row["mean_change_low"] <= row["mean_change"] <= row["mean_change_high"]
    (mesh,) = (one for one in error_budget(outcomes[0], "coulomb") if one.name == "meshes")
    assert mesh.mean == pytest.approx(abs(row["mean_change"])) and row["finer_nodes"] > 3 * row["nodes"]
