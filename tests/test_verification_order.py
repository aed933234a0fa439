"""The study of the order: its limits hold on few samples, and catch planted errors."""

from dataclasses import replace

import pytest

from mic.statistics.draw import draw
from mic.studies.order import Order, variants
from verification.comparison import reduced_and_assembly
from verification.order import study
from verification.scenes import shipped

pytestmark = [pytest.mark.fem, pytest.mark.slow]

LIMITS = {acceptance.name: acceptance for acceptance in study.STUDY.acceptance}


@pytest.fixture(scope="module")
def wheelhouse(cache):
    scene = shipped("wheelhouse", "coarse", ("coulomb", "frictionless"))
    needed = (*study.PRESSED, study.LOCATED, study.MEANWHILE)
    others = [order for order in variants(scene, study.ORDERS) if order.name in needed]
    return reduced_and_assembly(scene, cache)[0], others, draw(scene, 303, 0, 8)


EVALUATED = {}  # by scene and law: planted orders take the scenes of others


def evaluated(model, order, deviations, law):
    key = id(order.scene), law
    if key not in EVALUATED:
        EVALUATED[key] = study.evaluate(model, order, deviations, law)
    return EVALUATED[key]


def within(model, others, deviations, law="coulomb"):
    """The numbers within their limits, of those that need few increments."""
    smooth = evaluated(model, others[0], deviations, "frictionless")
    rubbing = [evaluated(model, order, deviations, law) for order in others]
    table = study.table_of(model, others, rubbing, smooth)
    by_name = {order.name: each for order, each in zip(others, rubbing)}
    numbers = study.judge(table, study.departure(by_name[study.MEANWHILE], by_name[study.LOCATED], model)[1])
    return {
        name for name, value in numbers.items() if (value <= LIMITS[name].limit) == (LIMITS[name].bound == "at most")
    }


def test_the_limits_hold(wheelhouse):
    assert within(*wheelhouse) == {"located", "pressed", "set-down", "matters"}


def test_friction_ignored_is_caught(wheelhouse):
    assert within(*wheelhouse, law="frictionless") & {"pressed", "matters"} == set()


@pytest.mark.parametrize(
    "of, broken",
    [
        (lambda name: study.LOCATED, {"pressed", "matters"}),
        (lambda name: study.PRESSED[1] if name == study.MEANWHILE else name, {"set-down"}),
    ],
    ids=["clamps last", "set down otherwise"],
)
def test_an_order_that_is_not_followed_is_caught(wheelhouse, of, broken):
    """Each order is evaluated in the scene of the order that `of` names."""
    model, others, deviations = wheelhouse
    scenes = {order.name: order.scene for order in others}
    planted = [Order(order.name, scenes[of(order.name)]) for order in others]
    assert within(model, planted, deviations) & broken == set()


def test_many_increments_show_the_error_of_one(wheelhouse):
    model, others, deviations = wheelhouse
    located = next(order for order in others if order.name == study.LOCATED)
    more, many, one = (study.evaluate(model, study.increments(located, count), deviations[:3]) for count in (32, 16, 1))
    left = study.departure(one, more, model)
    assert left[0] > LIMITS["path-slip"].limit and left[1] > LIMITS["path-measured"].limit
    assert study.departure(many, more, model)[1] < left[1] / 5


def test_a_path_that_drifts_is_caught(wheelhouse):
    """Slips of a zone 1 % and 2 µm too long."""
    model, others, deviations = wheelhouse
    found = study.evaluate(model, study.increments(others[0], 1), deviations[:3])
    clamp = found.resolutions["clamp"]
    drifted = replace(clamp, trace=replace(clamp.trace, slip=1.02 * clamp.trace.slip + 4e-3))
    resolutions = {**found.resolutions, "clamp": drifted}
    assert study.departure(replace(found, resolutions=resolutions), found, model)[0] > 1
