"""The twelve cases of shell contact: their pages and data are those of the scenes, their values are found again, and
wrong answers are not."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from typer.testing import CliRunner

from mic.contact import ContactSolver
from verification.__main__ import app
from verification.shell_contact import fclib, study
from verification.shell_contact.case import LEVELS, Case, cases
from verification.shell_contact.converged import Converged, read
from verification.shell_contact.page import row
from verification.shell_contact.publication import publish

pytestmark = pytest.mark.fem

CASES = cases()
needs_h5py = pytest.mark.skipif(
    not fclib.available(fclib.interpreter()), reason="no Python beside this one has h5py: script/bootstrap test"
)


def largest(case, cache, alter=lambda model: model):
    """The largest change of a value on the coarse mesh, over what is allowed."""
    return max(row["change"] for row in study.compared(case, cache, LEVELS[:1], alter))


def test_there_are_twelve():
    assert len(CASES) == 12


@pytest.mark.parametrize("name", CASES)
def test_the_page_lists_the_values(name):
    folder = CASES[name].folder
    told = (folder / "README.md").read_text()
    assert {"case.json", "mesh.inp", "problem.hdf5"} <= {path.name for path in folder.iterdir()}
    assert all(f"| {' | '.join(row(one))} |" in told for one in read(CASES[name]))
    assert (folder / "picture.png").read_bytes()[:4] == b"\x89PNG"
    assert f"({folder.relative_to(folder.parents[1])}/README.md)" in (folder.parents[1] / "README.md").read_text()


@pytest.fixture(scope="module")
def published(cache, tmp_path_factory):
    """A case's folder, published with the shipped values."""
    folder = tmp_path_factory.mktemp("published")
    publish(CASES["lap_shear"], folder, cache, fclib.interpreter(), anew=False)
    return folder


def test_a_case_is_published_whole(published):
    shipped = CASES["lap_shear"].folder
    written = {path.name for path in published.iterdir()} | {"problem.hdf5"}
    assert written == {path.name for path in shipped.iterdir() if path.is_file()}
    for name in ("README.md", "case.json", "mesh.inp", "values.csv"):
        assert (published / name).read_text() == (shipped / name).read_text()


def sheets(text):
    """Points by number, and triangles and thickness by sheet, of an input deck: read without this program."""
    points, triangles, thickness, into, name = {}, {}, {}, None, ""
    for line in text.splitlines():
        if line.startswith("*"):
            into, name = line.split(",")[0], line.split("SET=")[-1].split(",")[0]
        elif into == "*NODE":
            number, *xyz = line.split(",")
            points[int(number)] = [float(x) for x in xyz]
        elif into == "*ELEMENT":
            triangles.setdefault(name, []).append([int(n) for n in line.split(",")[1:]])
        elif into == "*SHELL SECTION":
            thickness[name] = float(line)
    return points, triangles, thickness


AREAS = {  # mm², by hand
    "leaves": {"LOWER": 2000, "UPPER": 2000},
    "lap_shear": {"LOWER": 2250, "UPPER": 2250},
    "hat": {"PLATE": 10800, "HAT": 120 * (17 + 17 + 44 + 2 * np.hypot(6, 25))},
    "channels": {"OUTER": 120 * 70, "INNER": 120 * (27.7 + 2 * 18.85)},
    "ring": {"RING": 2 * np.pi * 30 * 20},
    "wheelhouse": {"INNER": np.pi / 3 * (3600 + 2 * 80 * 30), "OUTER": np.pi / 3 * (3600 + 2 * 100 * 30)},
}


@pytest.mark.parametrize("name", AREAS)
def test_the_plain_data_describe_the_sheets_of_the_page(name):
    folder = CASES[name].folder
    given = json.loads((folder / "case.json").read_text())
    points, triangles, thickness = sheets((folder / "mesh.inp").read_text())
    assert thickness == {one["name"].upper(): one["thickness"] for one in given["sheets"]}
    for sheet, area in AREAS[name].items():
        corner = np.array([[points[n] for n in one] for one in triangles[sheet]])
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(area, rel=2e-3)
    for one in (*given["supports"], *given["clamps"], *given["probes"]):
        own = np.unique(triangles[one["part"].upper()])
        away = min(np.linalg.norm(np.subtract(points[n], one["point"])) for n in own)
        assert away < 5 and one["name"] in (folder / "README.md").read_text()


def test_an_uncertainty_covers_what_is_left_of_a_series_and_grows_with_the_path():
    sizes = (3.0, 2.0, 4 / 3)
    for order in (0.6, 1.0, 2.0):
        one = Converged("a", "N", sizes, tuple(10 + 0.3 * h**order for h in sizes), 0.0)
        assert abs(one.value - 10) < one.uncertainty < 20 * abs(one.value - 10)
        assert replace(one, path=1.0).uncertainty == pytest.approx(one.uncertainty + 1)
    by_chance = Converged("a", "N", sizes, (10.0, 12.0, 12.0001), 0.0)
    assert by_chance.uncertainty >= 1.0 and by_chance.known and not replace(by_chance, path=3.0).known


def test_shipped_values_are_reproduced(cache):
    assert largest(CASES["lap_bending"], cache) <= 1


@dataclass(frozen=True)
class Wrong(Case):
    """A case whose scene is not what it says."""

    change: object = None

    def scene(self, level, tolerance=2.5e-5):
        return self.change(super().scene(level, tolerance))


def of_all(scene, table, **change):
    """The scene with other values in all items of a table."""
    return scene.model_copy(update={table: [one.model_copy(update=change) for one in getattr(scene, table)]})


def reversed_load(scene):
    *others, bend = scene.clamps
    return scene.model_copy(update={"clamps": [*others, bend.model_copy(update={"force": -bend.force})]})


PLANTED = {
    "friction that does not know its stage": ("lap_welded", lambda scene: of_all(scene, "zones", friction=0.25)),
    "the first part's thickness everywhere": ("lap_bending", lambda scene: of_all(scene, "parts", thickness=1.0)),
    "a load reversed": ("lap_bending", reversed_load),
}


@pytest.mark.parametrize("error", PLANTED)
def test_the_study_catches(error, cache):
    name, change = PLANTED[error]
    assert largest(Wrong(CASES[name].folder, change), cache) > 10


def test_the_study_catches_a_value_that_was_changed_and_one_that_is_gone():
    shipped = read(CASES["leaves"])
    found = [study.Quantity(one.name, one.unit, one.levels[0]) for one in shipped]
    rows = study.held("leaves", shipped, found, "coarse")
    assert max(row["change"] for row in rows) == 0
    found[0] = replace(found[0], value=1.001 * found[0].value)
    assert max(row["change"] for row in study.held("leaves", shipped, found, "coarse")) > 1
    with pytest.raises(KeyError):
        study.held("leaves", shipped, found[1:], "coarse")


@needs_h5py
@pytest.mark.parametrize("name", CASES)
def test_the_shipped_contact_problem_has_the_shipped_solution(name):
    problem = fclib.read(CASES[name].folder / "problem.hdf5", fclib.interpreter())
    found = ContactSolver(problem["W"], problem["mu"]).solve(problem["q"])
    top = np.abs(problem["r"]).max()
    assert found.converged and np.abs(found.force.ravel() - problem["r"]).max() < 1e-6 * top
    r, u = problem["r"].reshape(-1, 3), problem["u"].reshape(-1, 3)
    assert np.allclose(problem["W"] @ problem["r"] + problem["q"], problem["u"], atol=1e-12)
    assert (np.linalg.norm(r[:, 1:], axis=1) <= problem["mu"] * r[:, 0] + 1e-7 * top).all()  # Coulomb's law, by hand
    assert u[:, 0].min() > -1e-8 and np.abs(r[:, 0] * u[:, 0]).max() < 1e-7 * top
    assert (r[:, 0] > 0).any() and (r[:, 0] == 0).any()


@needs_h5py
def test_a_contact_problem_is_written_as_the_library_lays_it_out(published, tmp_path):
    again, shipped = (
        fclib.read(folder / "problem.hdf5", fclib.interpreter()) for folder in (published, CASES["lap_shear"].folder)
    )
    assert set(again) == set(shipped) and np.array_equal(again["mu"], shipped["mu"])
    assert np.allclose(shipped["W"], again["W"], rtol=1e-7) and np.allclose(shipped["q"], again["q"], rtol=1e-6)
    with pytest.raises(RuntimeError, match=r"problem\.npz"):
        fclib.read(tmp_path / "nothing.hdf5", fclib.interpreter())


def test_the_command_lists_the_cases_and_refuses_others():
    told = CliRunner().invoke(app, ["suite"])
    assert told.exit_code == 0 and all(f"{name}: " in told.output for name in CASES)
    assert "no case 'boat'" in CliRunner().invoke(app, ["suite", "boat"]).output
