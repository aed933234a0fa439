"""The study of published benchmarks: its bodies against closed forms, and that its limits catch wrong answers."""

from dataclasses import replace

import numpy as np
import pytest

from verification.plane import Body, rectangle
from verification.published import cases, study
from verification.published.study import Measured

pytestmark = pytest.mark.fem


LIMITS = {item.name: item.limit for item in study.STUDY.acceptance}


def shoe():
    found, exact = cases.shoe(divisions=2), cases.rigid_shoe()
    return {"shoe": (found[:, 2:] / 9, exact[:, 2:] / 9), "shoe-force": (found[:, :2] / 3600, exact[:, :2] / 3600)}


def plate():
    return {"plate": (cases.plate(16) / list(cases.PLATE.values()), 1.0)}


def roller():
    one = cases.Roller(1.0)
    return {"hertz": (one.solve(0.0)[1] / one.hertz[0], 1.0), "roller": (one.solve(0.1)[0] / study.ROLLER[2, 0.1], 1.0)}


def punch():
    free, held = (cases.Punch(4.0).solve(mu) for mu in (0.0, 0.1))
    friction = (held - free) / (study.PUNCH[2, 0.1] - study.PUNCH[2, 0.0])
    return {"punch": (held / study.PUNCH[2, 0.1], 1.0), "punch-friction": (friction, 1.0)}


def cattaneo():
    sheared, a, c = cases.cattaneo(8)
    own, moment = sheared.half_width, 4 * (sheared.tangential * sheared.x**2).sum() / 0.3
    stuck = np.abs((sheared.normal.sum() * own**2 - moment) * own**2 / sheared.normal.sum()) ** 0.25
    return {"cattaneo": (np.array([own / a, stuck / c]), 1.0)}


def exceeded(*measure):
    """The limits of the study that are exceeded on its coarsest meshes."""
    pairs = {name: pair for one in measure for name, pair in one().items()}
    return {name for name, (found, right) in pairs.items() if np.abs(found - right).max() > LIMITS[name]}


def test_published_values_are_found():
    assert not exceeded(shoe, plate, roller, punch, cattaneo)


def test_the_effect_of_friction_below_the_punch_does_not_depend_on_the_mesh():
    """To a fifth of its limit; on elements that do not resolve the contact's end it scatters by three fifths of it."""
    coarse, fine = (np.diff([cases.Punch(h).solve(mu) for mu in (0.0, 0.1)]) for h in (6.0, 4.0))
    assert coarse == pytest.approx(fine, rel=LIMITS["punch-friction"] / 5)


PLANTED = {
    "friction halved": (
        lambda pairs, mu: (pairs, mu / 2),
        (shoe, plate, cattaneo),
        {"shoe", "shoe-force", "plate", "cattaneo"},
    ),
    "compliance a tenth too large": (
        lambda pairs, mu: (replace(pairs, S=1.1 * pairs.S), mu),
        (roller,),
        {"hertz"},
    ),
    "tangent reversed in the coupling": (
        lambda pairs, mu: (replace(pairs, S=pairs.S * coupling(len(pairs.S))), mu),
        (plate,),
        {"plate"},
    ),
}


def coupling(n):
    """-1 where normal meets tangent, 1 elsewhere."""
    sign = np.tile([1.0, -1.0], n // 2)
    return np.outer(sign, sign)


@pytest.mark.parametrize("error", PLANTED)
def test_limits_catch(error, monkeypatch):
    change, measure, caught = PLANTED[error]
    right = cases.followed
    monkeypatch.setattr(cases, "followed", lambda pairs, mu, *rest, **more: right(*change(pairs, mu), *rest, **more))
    assert caught <= exceeded(*measure)


def test_normals_of_the_punch_are_those_of_the_deformed_face(monkeypatch):
    monkeypatch.setattr(cases, "TURNS", 1)  # as drawn
    assert exceeded(punch) == {"punch-friction"}


def test_errors_are_relative_and_include_the_mesh_error():
    item = Measured("x", "u", 2.0, (2.4, 2.2, 2.1))
    assert item.error == pytest.approx(0.05) and item.own >= 0.05
    assert replace(item, scale=10.0).error == pytest.approx(0.01)


def test_a_block_is_pressed_as_by_hand():
    """``u = p (1 - ν²)/E h`` down and ``p ν (1 + ν)/E x`` aside, in plane strain."""
    body = Body(*rectangle(np.linspace(0, 3, 3), np.linspace(0, 2, 2)), 100.0, 0.25)
    base, top, corner = body.side(1, 0.0), body.side(1, 2.0), body.side(0, 0.0)
    found = body.reduced(body.rows(top[-1:]), held=[*(2 * base + 1), *(2 * corner)], loads=[body.pressed(top, (0, -8))])
    assert found.U[:, 0] == pytest.approx([8 * 0.25 * 1.25 / 100 * 3, -8 * (1 - 0.25**2) / 100 * 2], rel=1e-12)
    assert body.pressed(top, (0, -8)).sum() == pytest.approx(-24)


def test_a_ring_under_pressure_is_lames():
    """Inner pressure p on a long ring: ``u(a) = p a (1 + ν)/E ((1 - 2ν) a² + b²)/(b² - a²)``, nothing along it."""
    a, b, E, nu = 1.0, 2.0, 100.0, 0.3
    body = Body(*rectangle(np.linspace(a, b, 9), [0.0, 0.25]), E, nu, revolved=True)
    inner = body.side(0, a)
    every = np.arange(len(body.nodes))  # of a long ring none moves along it
    found = body.reduced(body.rows(inner[:1]), held=2 * every + 1, loads=[body.pressed(inner, (7.0, 0.0))])
    exact = 7.0 * a * (1 + nu) / E * ((1 - 2 * nu) * a**2 + b**2) / (b**2 - a**2)
    assert found.U[0, 0] == pytest.approx(exact, rel=1e-4)
    assert body.pressed(inner, (7.0, 0.0)).sum() == pytest.approx(7.0 * 2 * np.pi * a * 0.25)
