"""Laws, states and rungs are data: a law is added by one file and one registration."""

import importlib
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import mic
from mic.contact import ContactSolver, Law, Status, certify, ladder, solve
from mic.contact.backends import BACKENDS
from mic.contact.friction import Friction
from mic.contact.laws import ASSOCIATED, COULOMB, FRICTIONLESS, LAWS, find
from mic.contact.laws.pressure_dependent import table
from mic.contact.native.law_equation import starting_scale
from mic.contact.native.newton import Coupling, NewtonSettings, newton
from mic.contact.native.solver import NativeSolver
from mic.contact.states import STATES, ContactState, classify
from mic.results.run_identity import differences, inputs
from verification.contact_problems import box_stack, compliant, manufactured, slip_dominated

MIC = Path(mic.__file__).parent
FRICTIONAL = pytest.mark.parametrize("law", [law for law in LAWS.values() if law.frictional], ids=lambda law: law.name)


def test_an_added_law_needs_only_its_registration(monkeypatch):
    smooth = replace(COULOMB, name="smooth", parameters=lambda friction: 0.5 * friction.coefficient[:, None])
    monkeypatch.setitem(LAWS, smooth.name, smooth)
    solution = solve(np.eye(3), [-1.0, 1.0, 0.0], 0.5, "smooth")
    np.testing.assert_allclose(solution.force, [1.0, -0.25, 0.0], atol=1e-10)
    assert certify(np.eye(3), [-1.0, 1.0, 0.0], 0.5, solution.force, "smooth").residual <= 1e-10
    assert certify(np.eye(3), [-1.0, 1.0, 0.0], 0.5, solution.force, COULOMB).residual > 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("law", [ASSOCIATED, LAWS["pressure-dependent"]], ids=lambda law: law.name)
def test_the_fallback_solves_its_law_and_counts_its_factorisations(law):
    """It starts from zero and reaches the residual of the requested law, not of Coulomb's."""
    problem = slip_dominated(6, 1, np.random.default_rng(8), condition=1e2)
    pieces = table([(0.1, 0.5), (0.2, 0.4), (0.4, 0.3), (1.0, 0.25)])
    friction = Friction(np.full(6, 0.27), np.broadcast_to(pieces, (6, *pieces.shape)).copy())
    backend = BACKENDS["native"](problem.S, friction, law, 1e-10, 1, 3, 1e6)
    best, factorised = {}, 0
    for force, iterations, factorisations, rung in backend.attempts(problem.b[0], np.zeros(18)):
        residual = certify(problem.S, problem.b[0], friction, force, law).residual
        best[rung] = min(residual, best.get(rung, np.inf))
        assert 0 <= factorisations <= iterations
        factorised += factorisations
        if residual <= 1e-10:
            break
    assert factorised > 0
    assert list(best) == [ladder.PROXIMAL.name]
    assert max(best.values()) <= 1e-10, best


@pytest.mark.parametrize("stick, slide, inverse", [(0.2, 0.6, False), (0.6, 0.3, True)])
@FRICTIONAL
def test_newton_converges_quadratically_for_sliding_contacts(law, stick, slide, inverse):
    """From 1e-4 beside the solution: 1e-8, then rounding; for forces, and for displacements with the inverse."""
    rng = np.random.default_rng(7)
    problem = manufactured(compliant(20, rng, condition=1e2), np.full(20, 0.27), 1, rng, stick, slide, law)
    native = NativeSolver(problem.S, problem.mu, law, 1e-10, 1, 3)
    scaled, q = native.problem, problem.b[0] * native.scaling
    y = ContactSolver(problem.S, problem.mu, law, tol=1e-12).solve(problem.b[0]).force / native.scaling
    y *= 1 + 1e-4 * rng.normal(size=60)
    w, W = scaled.W @ y + q, scaled.W
    given = np.linalg.inv(W) if inverse else np.empty((0, 0))
    settings = NewtonSettings(0.0, starting_scale(q), 1e-12, 20.0, 10, 0)
    error, steps = newton(scaled.equation, Coupling(W, given, scaled.parameters), q, y, w, settings)
    assert error <= 1e-12 and steps <= 3


def test_a_law_with_friction_needs_an_equation():
    with pytest.raises(ValueError, match="law sticky has friction and needs an equation"):
        Law(name="sticky", title="", colour="", mark="")


def test_an_unknown_law_is_refused_with_a_list_of_laws():
    with pytest.raises(ValueError, match=f"law must be one of {', '.join(LAWS)}; got 'Tresca'"):
        find("Tresca")
    assert find("coulomb") is find(COULOMB) is COULOMB


def test_every_law_that_has_a_file_is_registered():
    found = set()
    for file in (MIC / "contact" / "laws").glob("*.py"):
        name = "mic.contact.laws" if file.stem == "__init__" else f"mic.contact.laws.{file.stem}"
        found |= {thing.name for thing in vars(importlib.import_module(name)).values() if isinstance(thing, Law)}
    assert found == set(LAWS)


@FRICTIONAL
def test_a_sliding_contact_opens_as_its_law_says(law):
    """S = I, b = (-1, 1, 0): ``f = p (1, -μ, 0)``, ``u = (p - 1, 1 - μ p, 0)`` and ``u_n = (1 - s) μ u_t``."""
    mu = 0.27
    left = 1.0 - law.shift
    p = (1.0 + left * mu) / (1.0 + left * mu**2)
    solution = solve(np.eye(3), [-1.0, 1.0, 0.0], mu, law)
    assert solution.status is Status.CONVERGED
    np.testing.assert_allclose(solution.force, [p, -mu * p, 0.0], atol=1e-10)
    np.testing.assert_allclose(solution.displacement, [p - 1.0, 1.0 - mu * p, 0.0], atol=1e-10)


def complete_friction(m, rng):
    """Friction of m contacts with values in every field."""
    values = {
        "coefficient": rng.uniform(0.1, 1.0, m),
        "pressure": np.broadcast_to(table([(0.5, 0.6), (1.5, 0.4), (3.0, 0.5)]), (m, 4, 5)),
        "compliance": rng.uniform(0.1, 1.0, m),
    }
    assert set(values) == {field.name for field in fields(Friction)}
    return Friction(**values)


def test_friction_of_a_subset_keeps_every_field():
    friction = complete_friction(5, np.random.default_rng(2))
    padded = friction.padded(2)
    for copied, own in ((Friction.of(friction, 5), slice(None)), (padded.take(np.arange(4)), slice(4))):
        for field in fields(Friction):
            np.testing.assert_array_equal(getattr(copied, field.name), getattr(friction, field.name)[own])
    for law in (law for law in LAWS.values() if law.frictional):
        assert not law.coefficient(law.parameters(padded), np.linspace(0.1, 9.0, 7))[5:].any()


@pytest.mark.parametrize("law", [law for law in LAWS.values() if law.reads], ids=lambda law: law.name)
def test_a_law_uses_the_field_that_it_reads(law):
    rng = np.random.default_rng(4)
    problem, friction = slip_dominated(6, 1, rng), complete_friction(6, rng)
    given = Friction(friction.coefficient, **{law.reads: getattr(friction, law.reads)})
    force, coulombs = (solve(problem.S, problem.b, one, law).force for one in (given, friction.coefficient))
    assert np.abs(force - coulombs).max() > 1e-2 * np.abs(problem.b).max()


@FRICTIONAL
def test_the_derivative_of_an_equation_is_that_of_its_values(law):
    rng = np.random.default_rng(1)
    m, step = 200, 1e-6
    friction = complete_friction(m, rng)
    d_n, d_t = rng.uniform(0.5, 2.0, (2, m))
    parameters = law.scaled(law.parameters(friction), d_n, d_t)
    y, w = rng.standard_normal(3 * m), rng.standard_normal(3 * m)
    dy, dw = rng.standard_normal((2, 3 * m))
    A, B, state, nothing = np.zeros((m, 3, 3)), np.zeros((m, 3, 3)), np.zeros(m, np.int64), np.empty((0, 3, 3))
    law.equation(parameters, y, w, np.zeros(3 * m), A, B, state, True)
    ends = []
    for sign in (-0.5, 0.5):
        end, changed = np.zeros(3 * m), np.zeros(m, np.int64)
        law.equation(parameters, y + sign * step * dy, w + sign * step * dw, end, nothing, nothing, changed, False)
        ends.append(end)
        state[changed != state] = -1
    slips = state == ContactState.SLIP
    assert slips.sum() > 30
    expected = ((ends[1] - ends[0]) / step).reshape(m, 3)[slips]
    found = np.einsum("kij,kj->ki", A, dy.reshape(m, 3)) + np.einsum("kij,kj->ki", B, dw.reshape(m, 3))
    np.testing.assert_allclose(found[slips], expected, atol=1e-6)


def test_states_are_read_from_forces():
    force = np.array([[[1.0, 0.3, 0.0], [1.0, 0.1, 0.0], [0.0, 0.0, 0.0], [1e-12, 1.0, 0.0]]])
    states = classify(force, 0.3 * force[..., 0])
    assert states.dtype == np.int8 and [STATES[state] for state in states[0]] == ["slip", "stick", "open", "open"]
    assert [ContactState(state).label for state in states[0]] == ["slip", "stick", "open", "open"]
    # Nothing holds a contact without friction.
    np.testing.assert_array_equal(classify(force * [1.0, 0.0, 0.0], 0.0), [[2, 2, 0, 0]])
    np.testing.assert_array_equal(classify(force[..., :1], 0.3), [[2, 2, 0, 0]])
    np.testing.assert_array_equal(classify(np.zeros((2, 3, 3)), 0.0), 0)
    assert classify(np.zeros((2, 0, 3)), np.zeros((2, 0))).shape == (2, 0)


def test_a_solution_names_the_rung_that_found_it():
    rng = np.random.default_rng(13)
    slips = slip_dominated(12, 4, rng, condition=1e3)
    assert set(solve(slips.S, slips.b, slips.mu).rung) == {"sweeps"}
    assert set(solve(slips.S, slips.b, slips.mu, ASSOCIATED).rung) == {"splitting"}
    guess = solve(slips.S, slips.b, slips.mu, ASSOCIATED).force
    assert set(solve(slips.S, slips.b, slips.mu, ASSOCIATED, guess=guess).rung) == {"guess"}
    assert set(solve(slips.S, slips.b, slips.mu, FRICTIONLESS).rung) == {"active set"}
    assert solve(slips.S, slips.b[0], slips.mu).rung == "sweeps"
    tower = box_stack(15, (0.3, 0.3, 1.0)).problem(0.3, np.random.default_rng(2), 0.05)
    assert set(solve(tower.S, tower.b, tower.mu).rung) <= {"splitting", "proximal points"}


@pytest.mark.parametrize("law", LAWS.values(), ids=lambda law: law.name)
def test_the_rungs_of_a_law_are_those_that_are_tried(law):
    S = compliant(4, np.random.default_rng(2))
    backend = NativeSolver(S, np.full(4, 0.3), law, 1e-10, 1, 3, 1e6)
    climbed = dict.fromkeys(rung for *_, rung in backend.attempts(-np.ones(12), np.zeros(12)))
    batch = [rung.name for rung in ladder.BATCH if rung.applies(law)]
    assert ladder.rungs(law) == batch + list(climbed)
    assert all(rung.reason.endswith(".") for rung in (*ladder.BATCH, ladder.PROXIMAL))


def test_the_contact_page_lists_every_rung_and_every_law():
    page = (Path(__file__).parents[1] / "docs" / "contact.md").read_text(encoding="utf-8")
    for rung in (*ladder.BATCH, ladder.PROXIMAL):
        assert f"| `{rung.name}` |" in page, rung.name
    for law in LAWS:
        assert f"| `{law}`" in page, law


@pytest.mark.slow
def test_contact_is_imported_without_a_compiler():
    code = "import sys, mic.contact; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_no_other_module_lists_laws_or_states():
    """No module holds every law or every state as strings."""
    for file in MIC.rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        assert not all(f'"{name}"' in text for name in LAWS) and not all(f'"{name}"' in text for name in STATES), file


@pytest.mark.parametrize("law, passes", [("coulomb", 10), ("frictionless", 5)])
def test_batch_rungs_count_sweeps_and_factorisations(law, passes):
    rng = np.random.default_rng(8)
    problem = manufactured(compliant(8, rng, condition=1e2), np.full(8, 0.27), 20, rng, 0.3, 0.4)
    found = ContactSolver(problem.S, problem.mu, law).solve(problem.b)
    first = found.rung == ("sweeps" if law == "coulomb" else "active set")
    assert first.sum() >= 10 and (found.factorisations[first] > 0).all()
    assert (found.iterations[first] - found.factorisations[first] == passes).all()


def test_the_work_of_a_scene_reaches_the_solver(lap_model, monkeypatch):
    works, native = set(), BACKENDS["native"]
    monkeypatch.setitem(BACKENDS, "native", lambda *known: works.add(known[-1]) or native(*known))
    scene = lap_model.scene
    settings = scene.monte_carlo.model_copy(update={"solver_work": 7})
    changed = lap_model.varied(scene.model_copy(update={"monte_carlo": settings}))
    assert not changed.evaluate({}).failed.any() and works == {7}
    (line,) = differences(inputs(lap_model, 1), inputs(changed, 1))
    assert "work of the contact solver" in line and "2000" in line and "7" in line
