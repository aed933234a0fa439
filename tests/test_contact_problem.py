"""The full contact solve on dolfinx meshes, without a scene: against closed forms, and what it refuses."""

import runpy

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
import ufl
from mpi4py import MPI
from dolfinx import fem
from dolfinx import mesh as dmesh
from dolfinx.io import XDMFFile
from support.processes import ROOT

from fem_reference.contact_problem import Contact, ContactProblem, Force, Sheet, Support, Traction, Writer
from fem_reference.shell.compat import compile_form, shell_mesh
from mic.contact.states import OPEN, SLIP, STICK
from mic.geometry.structured import extrude

pytestmark = pytest.mark.fem

E, L, B, T = 210e3, 100.0, 10.0, 2.0  # MPa, mm


def strip(height=0.0, size=10.0, name="strip", corner=0.0):
    points, triangles, _ = extrude([(0.0, height), (B, height)], corner, L, size)
    return Sheet(shell_mesh(MPI.COMM_SELF, points, triangles), T, E, 0.0, name=name)


def root(x):
    return np.isclose(x[0], 0)


def tip(x):
    return np.isclose(x[0], L)


def inside(x):
    return (x[0] > 1) & (x[0] < L - 1)


def everywhere(x):
    return x[0] > -1


@pytest.mark.slow
def test_the_gallery_page_solves_a_leaf_spring_and_meets_its_closed_form(monkeypatch, capsys):
    """Goodman and Klumpp (1956): slip load and work of a cycle; below the slip load the leaves are one beam."""
    monkeypatch.setattr(plt, "show", lambda: None)
    with matplotlib.rc_context({"backend": "agg"}):
        page = runpy.run_path(str(ROOT / "docs" / "gallery" / "full_contact.py"))
        plt.close("all")
    assert page["found"] == pytest.approx(page["exact"], rel=0.01)
    assert {solution.route for solution in page["solutions"]} == {"whole"}
    loads, mean = np.array(page["loads"]), np.array(page["mean"])
    sticks, slips = np.diff(mean)[[0, 5]] / np.diff(loads)[[0, 5]]
    assert slips == pytest.approx(4 * sticks, rel=0.01)
    states = [set(solution.contacts[0].state) for solution in page["solutions"]]
    assert states[3] == {STICK} and states[8] == {SLIP}
    for name in ("upper", "lower"):
        assert (page["folder"] / f"{name}.h5").is_file()
        with XDMFFile(MPI.COMM_SELF, str(page["folder"] / f"{name}.xdmf"), "r") as file:
            assert np.ptp(file.read_mesh(name="mesh").geometry.x[:, 0]) == L
        text = (page["folder"] / f"{name}.xdmf").read_text()
        assert text.count('<Time Value="') == 3 * len(loads)
        assert {word for word in ("displacement", "rotation", "contact_traction") if word in text} == {
            "displacement",
            "rotation",
            "contact_traction",
        }


def plane():
    """A strip on dolfinx's own mesh of the plane, whose triangles are oriented either way."""
    mesh = dmesh.create_rectangle(MPI.COMM_SELF, [[0.0, 0.0], [L, B]], [10, 1], dmesh.CellType.triangle)
    return Sheet(mesh, T, E, 0.0, name="plane")


def test_functions_are_those_of_the_mesh():
    """A cantilever under its own traction: ``w = q b x² (6 L² − 4 L x + x²)/(24 E I)`` at every vertex of dolfinx."""
    sheet, q = plane(), 1e-3
    problem = ContactProblem([Support(sheet, root, rotation=(0, 0, 0))], [Traction(sheet, everywhere, (0, 0, q))])
    solution = problem.solve()
    w = solution.displacement(sheet)
    of_x = fem.Function(w.function_space)
    of_x.interpolate(lambda x: np.stack([x[0], x[1], x[2] if len(x) > 2 else 0 * x[0]]))
    x, value = of_x.x.array.reshape(-1, 3)[:, 0], w.x.array.reshape(-1, 3)[:, 2]
    exact = q * B * x**2 * (6 * L**2 - 4 * L * x + x**2) / (24 * E * B * T**3 / 12)
    np.testing.assert_allclose(value, exact, atol=0.01 * exact.max())
    turned = solution.rotation(sheet).x.array.reshape(-1, 3)[:, 1]
    assert turned[np.isclose(x, L)] == pytest.approx(-q * B * L**3 / (6 * E * B * T**3 / 12), rel=0.01)
    np.testing.assert_allclose(solution.reaction(problem.supports[0])[:3], [0, 0, -q * B * L], atol=1e-6)


def test_tags_mark_what_a_marker_marks():
    sheet, found = plane(), []
    mesh = sheet.mesh
    mesh.topology.create_connectivity(1, 2)
    edges = dmesh.locate_entities(mesh, 1, root)
    cells = dmesh.locate_entities(mesh, 2, lambda x: x[0] > 49)
    ends = dmesh.meshtags(mesh, 1, np.sort(edges), np.full(len(edges), 7, dtype=np.int32))
    areas = dmesh.meshtags(mesh, 2, np.sort(cells), np.full(len(cells), 3, dtype=np.int32))
    for held, loaded in ((root, lambda x: x[0] > 49), ((ends, 7), (areas, 3))):
        support = Support(sheet, held, rotation=(0, 0, 0))
        solution = ContactProblem([support], [Traction(sheet, loaded, (0, 0, 1e-3))]).solve()
        found.append(solution.displacement(sheet).x.array.copy())
    np.testing.assert_array_equal(*found)
    with pytest.raises(ValueError, match="sheet 'plane': the tag 8 holds for no vertex"):
        Support(sheet, (ends, 8)).sheet.marked((ends, 8))


@pytest.mark.slow
@pytest.mark.parametrize("order, sign", [(1, 1), (1, -1), (-1, 1)])
def test_a_strip_lands_on_another_and_is_dragged(order, sign):
    """The upper strip, held all over, is moved down by more than the gap and dragged along: friction is μ times what
    presses, whatever the order and orientation of the sheets."""
    lower, upper = strip(name="lower"), strip(sign * (T + 0.1), name="upper")
    hold, move = Support(lower, root, rotation=(0, 0, 0)), Support(upper, everywhere, rotation=(0, 0, 0))
    rest = Support(lower, tip, displacement=(None, 0, 0))
    first, second = (lower, upper)[::order]
    problem = ContactProblem([hold, rest, move], contacts=[Contact(first, second, 0.25, where=inside)])
    move.displacement = (0, 0, -sign * 0.05)
    apart = problem.solve().contacts[0]
    assert set(apart.state) == {OPEN} and apart.gap == pytest.approx(np.full(len(apart.gap), 0.05))
    move.displacement = (0, 0, -sign * 0.101)
    problem.solve()
    move.displacement = (0.05, 0, -sign * 0.101)
    dragged = problem.solve(increments=2)
    force, on_upper = dragged.contacts[0].force, dragged.reaction(move)
    assert force[:, 0].min() >= 0 and force[:, 0].max() > 0
    assert sign * on_upper[2] == pytest.approx(-force[:, 0].sum(), rel=1e-6)
    assert on_upper[0] == pytest.approx(0.25 * force[:, 0].sum(), rel=1e-3)
    traction = dragged.contact_traction(upper)
    total = fem.assemble_scalar(compile_form(traction[2] * ufl.dx))
    assert sign * total == pytest.approx(force[:, 0].sum(), rel=1e-6)
    assert dragged.dissipated == pytest.approx(0.25 * force[:, 0].sum() * 0.05, rel=0.1)
    move.displacement = (0.03, 0, -sign * 0.101)
    back = problem.solve()
    assert back.reaction(move)[0] == pytest.approx(-0.25 * back.contacts[0].force[:, 0].sum(), rel=1e-3)


def test_what_cannot_be_solved_is_refused(tmp_path):
    one, two = strip(), strip(50.0)
    hold = Support(one, root, rotation=(0, 0, 0))
    with pytest.raises(ValueError, match="sheet 'strip': 1 rigid-body motions are free; add supports"):
        ContactProblem([Support(one, root, rotation=(0, None, 0), displacement=(0, 0, 0))])
    with pytest.raises(ValueError, match="the marker holds for no vertex"):
        ContactProblem([hold, Support(one, lambda x: x[0] > 1e3)])
    with pytest.raises(ValueError, match="no triangle has all its vertices where the traction acts"):
        ContactProblem([hold], [Traction(one, tip, (0, 0, 1.0))])
    with pytest.raises(ValueError, match="no vertex faces the second sheet within 2 mm; raise reach"):
        ContactProblem([hold, Support(two, everywhere)], contacts=[Contact(one, two, 0.2)])
    with pytest.raises(ValueError, match="friction must not be negative, but is -0.1"):
        ContactProblem([hold, Support(two, everywhere)], contacts=[Contact(one, two, -0.1, reach=60.0)])
    with pytest.raises(ValueError, match="give each its own name"):
        Writer(ContactProblem([hold, Support(two, everywhere)], [Force(two, tip, (0, 0, 1))]), tmp_path)
    squares = dmesh.create_rectangle(MPI.COMM_SELF, [[0.0, 0.0], [1, 1]], [1, 1], dmesh.CellType.quadrilateral)
    with pytest.raises(ValueError, match="dimension 2 with 4 points; mesh the mid-surface with linear triangles"):
        Sheet(squares, T, E, 0.0)
    problem = ContactProblem([hold])
    hold.rotation = (None, 0, 0)
    with pytest.raises(ValueError, match="may change its values, but not which components are free"):
        problem.solve()
