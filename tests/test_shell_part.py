"""`ShellPart`: functionals, rigid motions, loads, pinned solves, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from support.panels import NU, PLACES, E, T, functionals, grid, panel

from fem_reference.shell import part as part_module
from fem_reference.shell.factorisation import FactorisationError
from fem_reference.shell.local_freedoms import NARROW, local_freedoms
from fem_reference.shell.part import ELEMENTS, ShellPart
from mic.compliance.functional import Functionals
from mic.geometry.surface import Surface

pytestmark = pytest.mark.fem


@pytest.mark.parametrize("element", ELEMENTS)
def test_functionals_read_rigid_motions_exactly(element):
    """Under u = a + ω × (x − c), θ = ω a row on a sheet's outer side reads d·(a + ω × (x_q ± t/2 n_q − c)),
    averaged."""
    surface = panel()
    part = ShellPart(surface, T, E, NU, element)
    rows = functionals(surface, PLACES, 6.0)
    G = part.functional_matrix(rows) @ part.rigid_modes
    random = np.random.default_rng(0)
    a, ω = random.normal(size=3), random.normal(size=3)
    for i in range(len(rows)):
        patch = rows.patches[rows.patch[i]]
        x = surface.at(patch.triangle, patch.barycentric) + rows.side[i] * T / 2 * surface.normals[patch.triangle]
        motion = ω if rows.rotation[i] else patch.weight @ (a + np.cross(ω, x - part.centroid))
        assert G[i] @ np.concatenate([a, ω]) == pytest.approx(motion @ rows.direction[i], rel=1e-12)


@pytest.mark.parametrize("element", ELEMENTS)
def test_linear_fields_are_read_exactly_anywhere(element):
    """At single points off the middle of triangles, and at vertices."""
    surface = grid(4, 4, lambda X, Y: np.column_stack([20 * X, 20 * Y, 0 * X]), jitter=0.2)
    part = ShellPart(surface, T, E, NU, element)
    linear = lambda x: np.column_stack(
        [1 + x[:, 0], 2 * x[:, 1], x[:, 0] - x[:, 1], 0.1 * x[:, 0], 0.3 * x[:, 1], 0.2 * x[:, 0]]
    )
    freedoms = linear(part.dof_position)[np.arange(part.ndof), part.dof_component]
    at_vertices = (part.vertex_values @ freedoms).reshape(-1, 6)
    assert at_vertices == pytest.approx(linear(surface.points), abs=1e-12)
    point = surface.at([7], [[0.7, 0.1, 0.2]])[0]
    rows = functionals(surface, [point], 0.0)
    reading = part.functional_matrix(rows) @ freedoms
    exact = linear(point[None])[0]
    assert reading[3:6] == pytest.approx(exact[:3], abs=1e-12) and reading[9:] == pytest.approx(exact[3:], abs=1e-12)


@pytest.mark.parametrize("element", ELEMENTS)
def test_fields_come_back_in_the_surface_s_order(element):
    surface = panel()
    part = ShellPart(surface, T, E, NU, element)
    field = part.rigid_field()
    arm = surface.points - part.centroid
    for axis in range(3):
        assert field[:, :3, axis] == pytest.approx(np.tile(np.eye(3)[axis], (len(arm), 1)), abs=1e-12)
        assert field[:, :3, 3 + axis] == pytest.approx(np.cross(np.eye(3)[axis], arm), abs=1e-10)
        assert field[:, 3:, 3 + axis] == pytest.approx(np.tile(np.eye(3)[axis], (len(arm), 1)), abs=1e-12)
    rows = functionals(surface, [surface.points[30], surface.points[50]], 0.0)
    H, _ = part.influence(rows)
    forces = np.eye(len(rows))[:, [1, 14]]
    recovered = part.field(rows, forces)
    assert recovered.shape == (len(surface.points), 6, 2)
    assert recovered[30, :3] == pytest.approx((H @ forces)[3:6], abs=1e-9 * abs(H).max())
    assert recovered[50, :3] == pytest.approx((H @ forces)[15:18], abs=1e-9 * abs(H).max())


@pytest.mark.parametrize("element", ELEMENTS)
def test_weight_and_its_moment(element):
    """The load of gravity balances m g at the centre of mass, whichever element spreads it."""
    surface = panel()
    part = ShellPart(surface, T, E, NU, element)
    g, density = np.array([0.0, 1000.0, -9806.65]), 7.85e-9
    load = part.gravity(g, density)
    weight = density * T * surface.areas.sum() * g
    resultant = part.rigid_modes.T @ load
    assert resultant[:3] == pytest.approx(weight, abs=1e-12 * abs(weight).max())
    assert resultant[3:] == pytest.approx(0, abs=1e-9)  # about the centroid


@pytest.mark.parametrize(("element", "tolerance"), [("dkt-opt-curved", 0.01), ("p2-cr", 1e-12)])
def test_the_load_of_gravity_does_the_work_of_the_weight(element, tolerance):
    """On u3 = x² the weight's work is ρ t g ∫ x² dA: exact for quadratic displacements, of second order for linear
    ones."""
    part = ShellPart(grid(16, 4, lambda X, Y: np.column_stack([20 * X, 10 * Y, 0 * X])), T, E, NU, element)
    quadratic = np.where(part.dof_component == 2, part.dof_position[:, 0] ** 2, 0.0)
    work = part.gravity([0, 0, 1000.0], 1e-9) @ quadratic
    assert work == pytest.approx(1e-9 * T * 1000.0 * 10 * 20**3 / 3, rel=tolerance)


def test_pins_are_statically_determinate_and_apart():
    part = ShellPart(panel(), T, E, NU)
    assert len(np.unique(part.pins)) == 6 and (part.dof_component[part.pins] < 3).all()
    size = np.linalg.norm(part.surface.points - part.centroid, axis=1).max()
    modes = part.rigid_modes[part.pins] / np.array([1, 1, 1, size, size, size])
    assert np.linalg.cond(modes) < 20


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"thickness": 0.0}, "thickness must be positive"),
        ({"thickness": np.nan}, "thickness must be positive"),
        ({"young": 0.0}, "Young's modulus must be positive"),
        ({"poisson": 0.5}, "Poisson's ratio must lie between"),
        ({"poisson": np.nan}, "Poisson's ratio must lie between"),
        ({"element": "s4r"}, f"choose one of {', '.join(ELEMENTS)}"),
    ],
)
def test_bad_input_is_refused(changes, message):
    arguments = {"thickness": T, "young": E, "poisson": NU} | changes
    with pytest.raises(ValueError, match=message):
        ShellPart(panel(2), **arguments)


def test_bad_surfaces_are_refused():
    sound = panel(2)
    with pytest.raises(ValueError, match="belongs to no triangle"):
        ShellPart(Surface(np.vstack([sound.points, [[0, 0, 99.0]]]), sound.triangles), T, E, NU)
    two = np.vstack([sound.points, sound.points + [0, 0, 50.0]])
    with pytest.raises(ValueError, match="2 pieces"):
        ShellPart(Surface(two, np.vstack([sound.triangles, sound.triangles + len(sound.points)])), T, E, NU)


ASKEW = grid(8, 8, lambda X, Y: np.column_stack([60 * X, 50 * Y, 9 * X + 7 * Y]), jitter=0.2)


def test_a_sheet_too_thin_for_double_precision_is_refused():
    """Bending is softer than stretching by t²/L²: here no digit of it is left, and the pinned part is a mechanism."""
    part = ShellPart(ASKEW, 1e-7, E, NU, "p2-cr")
    with pytest.raises(FactorisationError, match="mechanism"):
        part.solve(np.zeros((part.ndof, 1)))


def test_a_flat_sheet_bends_as_easily_as_it_is_thin():
    """Askew to all axes, with forces in balance across it: its compliance falls with t³ from 1 to 1e-4 mm."""
    places = [ASKEW.corners[k].mean(axis=0) for k in (5, 40, 77, 100, 120)]
    rows = functionals(ASKEW, places, 6.0)
    rows = replace(rows, direction=np.tile(ASKEW.normals[0], (len(rows), 1)))
    middle, found = 12 * np.arange(5) + 3, []
    for thickness in (1.0, 1e-4):
        H, G = (each[middle] for each in ShellPart(ASKEW, thickness, E, NU).influence(rows))
        force = np.array([1.0, -2.0, 3.0, 0.5, -1.0])
        force -= G @ np.linalg.lstsq(G, force, rcond=None)[0]
        found.append(force @ H[:, middle] @ force * thickness**3)
    assert found[1] == pytest.approx(found[0], rel=1e-9)


def test_the_material_is_no_part_of_the_compiled_form():
    """E, ν and t are constants of the form: another sheet needs no compilation, and scales as it must."""
    surface = panel(3)
    K = ShellPart(surface, T, E, NU).stiffness_csr()
    assert abs(ShellPart(surface, T, 2 * E, NU).stiffness_csr() - 2 * K).max() < 1e-12 * abs(K).max()
    weak = ShellPart(surface, T, E, 0.1).stiffness_csr()
    assert abs(weak - K).max() > 1e-3 * abs(K).max()


def test_an_empty_set_of_functionals():
    part = ShellPart(panel(3), T, E, NU)
    nothing = Functionals((), np.zeros(0, int), np.zeros((0, 3)), np.zeros(0, bool), np.zeros(0, int), ())
    H, G = part.influence(nothing)
    assert H.shape == (0, 0) and G.shape == (0, 6)


# --- needles


def bent(columns):
    """A cylindrical panel of 60 × 50 mm with the edges of its elements at these shares of its length."""
    at = np.array(columns)
    n = len(at) - 1

    def shape(X, Y):
        x = at[np.rint(n * X).astype(int)]
        return np.column_stack([60 * x, 50 * Y, 8 * x**2])

    return grid(n, 8, shape)


COLUMNS = [0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0]


def narrowed(*narrow):
    """The panel with columns of elements so narrow, as shares of the others, beside its fourth edge."""
    return bent(COLUMNS[:4] + [0.375 + 0.125 * share for share in narrow] + COLUMNS[4:])


def bending(surface, thickness):
    """Work of three forces that bend a panel, in balance, and the displacement (n_points, 3) that they make beside a
    rigid motion that the vertices of :func:`bent` do not show."""
    part = ShellPart(surface, thickness, E, NU)
    rows = functionals(surface, [[10.0, 10.0, 0.2], [22.6, 25.0, 1.1], [40.0, 30.0, 3.6]], 6.0)
    H, G = part.influence(rows)
    force = np.zeros((len(rows), 1))
    force[[2, 14, 26], 0] = 1.0, -2.0, 1.0
    force -= G @ np.linalg.lstsq(G, force, rcond=None)[0]
    again = ShellPart(surface, thickness, E, NU)  # fields of coefficients that were kept
    moved = again.field(rows, force)[:, :3, 0]
    rigid, seen = again.rigid_field()[:, :3], np.isin(surface.points[:, 0], bent(COLUMNS).points[:, 0])
    motion = np.linalg.lstsq(rigid[seen].reshape(-1, 6), moved[seen].ravel(), rcond=None)[0]
    return (force.T @ H @ force).item(), moved - rigid @ motion


@pytest.mark.parametrize("narrow", [(1e-5,), tuple(8e-4 * np.arange(1, 5))], ids=["one", "a row of four"])
def test_a_part_with_needles_is_that_without_them(narrow):
    """They drown the bending of the others; the sheet is as soft, and bends as far, as if there were none."""
    work, moved = bending(narrowed(*narrow), 0.05)
    expected, shape = bending(bent(COLUMNS), 0.05)
    assert work == pytest.approx(expected, rel=0.01)
    needles = np.s_[4 * 9 : (4 + len(narrow)) * 9]
    assert abs(np.delete(moved, np.arange(len(moved))[needles], axis=0) - shape).max() < 0.01 * abs(shape).max()


def works(part, rows):
    """(3, 3) works of three sets of forces in balance, which do not depend on the pins."""
    H, G = part.influence(rows)
    force = np.random.default_rng(2).normal(size=(len(H), 3))
    force -= G @ np.linalg.lstsq(G, force, rcond=None)[0]
    return force.T @ H @ force


def test_local_freedoms_do_not_change_the_stiffness(monkeypatch):
    """They are those of the vertices in other words."""
    surface = narrowed(0.5 * NARROW)
    rows = functionals(surface, [[10.0, 10.0, 0.2], [22.6, 25.0, 1.1], [40.0, 30.0, 3.6]], 6.0)
    assert local_freedoms(surface, T).relative.sum() == 9
    found = works(ShellPart(surface, T, E, NU), rows)
    monkeypatch.setattr(part_module, "local_freedoms", lambda surface, thickness: None)
    expected = works(ShellPart(surface, T, E, NU), rows)
    assert 0 < abs(found - expected).max() < 1e-9 * abs(expected).max()


@pytest.mark.parametrize(("narrow", "thickness", "bound"), [(1e-3, 0.2, 1e-9), (0.5, 0.001, 1e-9), (1e-6, 0.2, 1e-6)])
def test_a_thin_part_or_one_with_needles_is_the_same_wherever_it_stands(narrow, thickness, bound):
    """The width of the narrowest is known to 1e-8 of itself from its coordinates."""
    surface, turn = narrowed(narrow), np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    rows = functionals(surface, [[10.0, 10.0, 0.2], [22.6, 25.0, 1.1], [40.0, 30.0, 3.6]], 6.0)
    turned = Surface(surface.points @ turn.T, surface.triangles)
    work = works(ShellPart(surface, thickness, E, NU), rows)
    other = works(ShellPart(turned, thickness, E, NU), replace(rows, direction=rows.direction @ turn.T))
    np.testing.assert_allclose(other, work, rtol=0, atol=bound * abs(work).max())


def test_needles_whose_freedoms_do_not_all_stand_at_corners_are_refused():
    part = ShellPart(narrowed(1e-5), 1e-3, E, NU, "p2-cr")
    with pytest.raises(FactorisationError, match="narrow"):
        part.solve(np.zeros((part.ndof, 1)))
