"""Optimisation: optima by hand, exhaustion and brute force, their gain on fresh samples, refused requests."""

import json
import re
import tomllib
from dataclasses import replace
from functools import partial
from itertools import permutations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.springs import STIFFNESS, at_face, clamped
from typer.testing import CliRunner

import mic
from mic.errors import SceneError
from mic.options import app
from mic.results.schema import OPTIMA, OPTIMUM_CHANGES, OPTIMUM_MATCHES
from mic.scene import Scene
from mic.scene.load import read_table
from mic.scene.revision import revised
from mic.statistics.draw import draw
from mic.statistics.paired_differences import jackknife, mean_change
from mic.studies.comparison import scene_differences
from mic.studies.optimisation import moved_items as sites_module
from mic.studies.optimisation import optimise
from mic.studies.optimisation.design import Change, Design, Space
from mic.studies.optimisation.evaluations import BudgetExceeded
from mic.studies.optimisation.matching import Kind, assign_parts
from mic.studies.optimisation.moved_items import RelocatedModels
from mic.studies.optimisation.objective import Objective
from mic.studies.optimisation.scene_changes import scene_text_with_changes
from mic.studies.optimisation.search import all_designs, local_search
from mic.system.foreign_files import ALSO_READ
from verification.scenes import with_stated_pairs

ROOT = Path(__file__).resolve().parents[1]
FORCE = {"clamps": ["C"], "between": [10, 100]}
SIGMA = 0.05  # of M, half of B's


def pushed(asked, **changes):
    """M = F/50 + B/2, between 0.5 and 1.5, F 20 N, B of mean 0.1 and σ 0.1; N reads a's face alone, (A + A')/2."""
    scene = {
        "clamps": [at_face("b", name="C", force=20.0)],
        "measurements": [at_face("b", name="M", lower=0.5, upper=1.5), at_face("a", name="N", lower=-1, upper=1)],
        "deviations": [
            {"name": "B", "kind": "locator", "target": "bl1", "mean": 0.1, "sigma": 2 * SIGMA},
            {"name": "A", "kind": "locator", "target": "al1", "mean": 0.0, "sigma": 0.1},
        ],
    }
    return clamped("ba", 9.0, optimise=asked, **scene | changes)


def rubbing(asked, order=None):
    """t is pulled to and fro along x while b is pressed on it and let be: friction remembers what came first."""
    pushes = [("C1", "b", (0, 0, 1), 10.0), ("X1", "t", (1, 0, 0), 20.0)]
    pushes += [("C2", "b", (0, 0, 1), 10.0), ("X2", "t", (-1, 0, 0), 12.0)]
    return clamped(
        "bt",
        0.0,
        0.3,
        optimise=asked,
        clamps=[at_face(part, direction, name=name, force=force) for name, part, direction, force in pushes],
        measurements=[
            at_face(part, (1, 0, 0), name=name, lower=-1, upper=1) for name, part in (("M", "b"), ("N", "t"))
        ],
        deviations=[{"name": f"D{name}", "kind": "clamp", "target": name, "sigma": 2.0} for name, *_ in pushes],
        stages=[{"kind": "locate"}, {"kind": "clamp"} | ({"order": order} if order else {}), {"kind": "measure"}],
    )


def found_for(asked, **settings):
    """The optimum without friction, on a hundred fresh samples."""
    return optimise(pushed(asked), "frictionless", **{"fresh": 100} | settings)


def changes(found):
    return {one.targets: one.after for one in found.changes}


# ------------------------------------------------------------------------------------------------------- settings


def mean_of_b(model, count=60):
    return draw(model.scene, model.scene.monte_carlo.seed, 0, count)[:, 0].mean()


def test_the_least_cpk_is_largest_where_the_force_centres_what_varies():
    model = pushed({"objective": "cpk", "forces": [FORCE], "of": ["M"]})
    found = optimise(model, "frictionless")
    wanted = STIFFNESS * (1.0 - mean_of_b(model) / 2)
    assert changes(found) == {("C",): pytest.approx(wanted, abs=0.5)}
    assert found.gained and found.gain.low > 3 and found.after == pytest.approx(0.5 / (3 * SIGMA), rel=0.15)
    other = found.table.set_index("quantity").loc["N"]
    assert other["mean_change"] == pytest.approx(0, abs=1e-12) and other["cpk_a"] == pytest.approx(other["cpk_b"])


def test_the_share_outside_falls_to_nothing_where_half_a_tolerance_is_ten_sigma():
    found = found_for({"objective": "yield", "forces": [FORCE], "of": ["M"]})
    assert found.before < 0.3 and found.after == 1.0 and found.gained


CAPABLE = {"objective": "cost", "constraints": [{"quantity": "cpk", "of": ["M"], "at_least": 1.0}]}
SHIM = {"of": ["bl1"], "between": [-0.5, 0.5], "cost": 10.0}


def test_the_cheaper_way_to_meet_a_constraint_is_used_as_far_as_needed():
    """Cpk 1 takes a mean of 0.65: 10 N more at 1 each, or 0.4 mm at 10 each."""
    found = found_for(CAPABLE | {"forces": [FORCE | {"cost": 1.0}], "shims": [SHIM]}, fresh=400)
    assert list(changes(found)) == [("bl1",)] and changes(found)["bl1",] == pytest.approx(0.4, abs=0.08)
    assert not found.missed and found.after == pytest.approx(10 * changes(found)["bl1",])
    assert found.gained and found.relief.low > 0 > found.gain.high, "it costs, and keeps what was missed"


@pytest.mark.slow
def test_a_constraint_violated_on_fresh_samples_is_tightened():
    """The first seed whose twenty samples need less than 0.33 mm; the population needs 0.4 mm."""
    model = pushed(CAPABLE | {"shims": [SHIM]})
    parts = (0.4 + draw(model.scene, seed, 0, 20)[:, 0] / 2 for seed in range(100))
    enough = [2 * (0.5 + 3 * own.std(ddof=1) - own.mean()) for own in parts]
    seed = next(seed for seed, own in enumerate(enough) if own < 0.33)
    found = optimise(model, "frictionless", samples=20, fresh=1000, seed=seed)
    assert changes(found)["bl1",] > enough[seed] + 0.03
    assert all(one.share < 0.03 for one in found.missed), "as far as a thousand samples tell"


def test_a_cost_is_spent_while_it_saves_more_in_rejects():
    found = found_for({"objective": "cost", "reject": 100, "forces": [FORCE | {"cost": 1}]})
    # Φ of the share outside falls by 100 φ(z)/(50 σ) per N: it pays until that is 1, and a little smoothing off.
    assert 25 < changes(found)["C",] < 31 and found.after < 12 < found.before


def test_a_force_limit_is_met_and_an_infeasible_constraint_is_reported():
    found = found_for({"forces": [FORCE], "constraints": [{"quantity": "force", "at_most": 40}]})
    assert changes(found) == {("C",): 40.0} and not found.missed
    found = found_for({"forces": [FORCE], "constraints": [{"quantity": "mean", "of": ["M"], "at_most": -1}]})
    (missed,) = found.missed
    assert changes(found) == {("C",): 10.0} and missed.name == "mean of M at most -1"
    assert missed.short == pytest.approx(1 + 10 / STIFFNESS + 0.05, abs=0.02)


def test_a_gain_on_the_samples_of_the_search_alone_is_no_gain():
    """The stated force centres all but the mean of the search samples, so their gain is lost on other samples."""
    clamp = at_face("b", name="C", force=47.5)
    found = optimise(pushed({"forces": [FORCE], "of": ["M"]}, clamps=[clamp]), "frictionless", samples=20, fresh=60)
    assert found.changes and found.trail["objective"].is_monotonic_increasing and len(found.trail) == 2
    assert found.gain.low < 0 and not found.gained


@pytest.mark.parametrize(
    ("asked", "wanted"),
    [
        ({"objective": "cpk"}, -0.75 / (3 * 0.25)),  # N, mean 0.25 within ±1, σ 0.25; M, mean 1 within 0.5 to 1.5
        ({"objective": "cpk", "of": ["M"]}, -0.5 / (3 * 0.5)),
        ({"objective": "largest-six-sigma"}, 6 * 0.5),
        ({"objective": "largest-six-sigma", "weights": {"N": 4}}, 4 * 6 * 0.25),
        ({"objective": "six-sigma", "weights": {"N": 4}}, 6 * (0.5 + 4 * 0.25)),
        ({"objective": "yield"}, 2 / 6),  # M is outside in one of five, and one sample cannot be built
        ({"objective": "cost", "reject": 30}, 30 * 2 / 6 + 2 * 5.0),
    ],
)
def test_each_objective_has_its_defined_value(asked, wanted):
    force = FORCE | ({"cost": 2.0} if asked["objective"] == "cost" else {})
    objective = Objective(Space(pushed(asked | {"forces": [force]})))
    z = np.array([1.4, -1.4, 0.2, -0.2, 0.0])
    z /= z.std(ddof=1)
    y = np.column_stack([1 + 0.5 * z, 0.25 + 0.25 * np.roll(z, 1)])
    if asked["objective"] in ("yield", "cost"):
        y = np.column_stack([[1.6, 1.0, 0.9, 0.6, 1.4], np.zeros(5)])
    y, unfit = np.vstack([y, [9.0, 9.0]]), np.array([False] * 5 + [True])
    if asked["objective"] == "cpk" and "of" not in asked:
        wanted = max(wanted, -0.5 / (3 * 0.5))
    assert objective.value(y, unfit, np.array([-5.0])) == pytest.approx(wanted)


def test_derivatives_of_all_figures_are_those_of_samples_that_move_along_their_slopes():
    stream, model = np.random.default_rng(3), pushed({"objective": "yield", "forces": [FORCE]})
    y, slopes = 0.9 + 0.2 * stream.standard_normal((40, 2)), stream.standard_normal((40, 2, 1))
    objective = Objective(Space(model))
    told = objective.figures(y, slopes)
    ends = [objective.figures(y + sign * 1e-5 * slopes[..., 0], slopes) for sign in (1, -1)]
    for name in ("mean", "six_sigma", "above", "below"):
        difference = (getattr(ends[0], name) - getattr(ends[1], name)) / 2e-5
        np.testing.assert_allclose(told.slopes[name][:, 0], difference, rtol=1e-6)
    # the smoothing goes with σ, which is held: 4e-2 of a slope that is not small
    wide = (ends[0].outside - ends[1].outside) / 2e-5
    assert told.slopes["outside"][0] == pytest.approx(wide, rel=0.3) and abs(wide) > 0.05


# --------------------------------------------------------------------------------------------------------- orders


ORDERED = {"objective": "largest-six-sigma", "orders": [{"stage": "clamp"}]}


@pytest.mark.slow
def test_the_best_of_all_orders_is_found():
    found = optimise(rubbing(ORDERED), "coulomb", samples=20, fresh=100, seed=1)
    spread = {}
    for order in permutations(["C1", "X1", "C2", "X2"]):
        model = rubbing(None, [[name] for name in order])
        spread[order] = 6 * model.evaluate(draw(model.scene, 1, 0, 20), "coulomb").measurements.std(0, ddof=1).max()
    best = min(spread, key=spread.get)
    assert spread[best] < 0.95 * sorted(spread.values())[2], "the order matters here"
    (change,) = found.changes
    chosen = tuple(group[0] for group in change.after)
    assert spread[chosen] == pytest.approx(spread[best], rel=1e-9) and found.found == pytest.approx(spread[best])
    assert found.gained and found.scene.stages[1].order == change.after


def test_items_of_one_group_change_their_order_together():
    table = LAP | {"optimise": {"orders": [{"stage": name} for name in ("clamp", "weld", "release")]}}
    table["clamps"] = [*LAP["clamps"], LAP["clamps"][0] | {"name": "C2", "point": [60, 12.5, 1]}]
    rest = [f"upper-{name}" for name in ("A1", "A2", "A3", "B1", "B2", "C1")]
    table["stages"] = [
        {**stage, "order": [["C2"], ["C1-upper", "C1-lower"], rest]} if stage["kind"] == "release" else stage
        for stage in LAP["stages"]
    ]
    space = Space(SimpleNamespace(scene=read_table(table, Path("scene.toml"))))
    assert space.groups == [
        (("C1-upper", "C1-lower"), ("C2",)),
        (("W1",), ("W2",)),
        (("C2",), ("C1-upper", "C1-lower"), tuple(rest)),
    ]
    # one order of the clamps is the stated one, and one of the release; welds are made together
    assert len(all_designs(space)) == 2 * 3 * 6 and all_designs(space)[0] == space.stated
    assert all_designs(space, limit=20) is None
    assert scene_differences(space.scene, space.with_design(all_designs(space)[-1]))


class Jobs:
    """Weighted completion times: the least, by Smith's rule, goes by the time that each takes over its weight."""

    def __init__(self, count, budget, seed=5):
        stream = np.random.default_rng(seed)
        self.time, self.weight = stream.uniform(1, 10, count), stream.uniform(1, 10, count)
        self.budget, self.spent, self._known = budget, 0, {}
        self.groups, self.points = [tuple((str(i),) for i in range(count))], []
        self.space, self.stated = self, Design((), (None,), ())

    def total(self, order):
        return float(self.weight[order] @ np.cumsum(self.time[order]))

    def merit(self, design, count=None):
        if design not in self._known:
            if self.spent >= self.budget:
                raise BudgetExceeded
            self.spent += 1
            order = design.orders[0] or self.groups[0]
            self._known[design] = self.total([int(name) for (name,) in order])
        return self._known[design]

    def is_better(self, design, other):
        return self.merit(design) < self.merit(other)


def test_orders_of_thirty_come_near_the_best_that_is_known_and_random_ones_of_equal_cost_do_not():
    jobs = Jobs(30, 3000)
    best = local_search(jobs.stated, jobs, np.random.default_rng(1), lambda design: None)
    known, stream = jobs.total(np.argsort(jobs.time / jobs.weight)), np.random.default_rng(2)
    random = min(jobs.total(stream.permutation(30)) for _ in range(jobs.spent))
    assert jobs.spent <= 3000
    assert jobs.merit(best) < 1.002 * known and random > 1.1 * known


# --------------------------------------------------------------------------------------------------------- places


def placed(asked, **changes):
    lap = with_stated_pairs(mic.load_scene(mic.examples.folder("lap_joint")))
    parts = [part.model_copy(update={"size": "coarse"}) for part in lap.parts]
    report = lap.report.model_copy(update={"fields": False})
    table = lap.model_copy(update={"parts": parts, "report": report} | changes).model_dump()
    return Scene(**table | {"optimise": {"places": asked}, "folder": lap.folder})


def lap_welds(**change):
    return [one.model_copy(update=change) for one in mic.load_scene(mic.examples.folder("lap_joint")).welds]


W1 = {"item": "welds.W1", "points": [[80, 6, 0.5], [92, 4, 0.5]]}
A3 = {"item": "locators.upper-A3", "points": [[120, 12.5, 1]]}


@pytest.mark.fem
@pytest.mark.slow
def test_items_moved_by_the_search_equal_those_of_a_scene_at_that_place(cache, monkeypatch):
    """A fused nugget divides the elements of a part, which is therefore solved once for each place."""
    computed, find = [], sites_module.influence_coefficients

    def counted(assembly, *arguments):
        computed.extend(part.name for part in assembly.parts)
        return find(assembly, *arguments)

    monkeypatch.setattr(sites_module, "influence_coefficients", counted)
    scene = placed([W1, A3], welds=lap_welds(fused=True))
    space, x = Space(SimpleNamespace(scene=scene)), draw(scene, 1, 0, 3)
    sites, read = RelocatedModels(space, cache), []
    for places in ((2, 0), (1, 1)):
        moved = space.with_places_of(Design((), (), places))
        read.append(sites.model(moved).evaluate(x, "coulomb").measurements)
    np.testing.assert_allclose(read[1], mic.reduce(moved, cache).evaluate(x, "coulomb").measurements, atol=1e-9)
    assert np.abs(read[1] - read[0]).max() > 1e-3
    assert sorted(computed) == ["lower"] * 2 + ["upper"] * 2


@pytest.mark.fem
@pytest.mark.slow
def test_the_best_of_all_places_is_found(cache):
    """A weld has three; each is evaluated here."""
    points = {"item": "welds.W1", "points": [[70, 6, 0.5], [97, 6, 0.5]]}
    scene = placed([points], welds=lap_welds(fused=False))
    asked = scene.optimise.model_copy(update={"objective": "largest-six-sigma"})
    model = mic.reduce(scene.model_copy(update={"optimise": asked}), cache)
    found = optimise(model, "coulomb", samples=20, fresh=20, seed=1, cache=cache)
    space, carlo = Space(model), model.scene.monte_carlo.model_copy(update={"design": "independent"})
    x, spread = draw(model.scene.model_copy(update={"monte_carlo": carlo}), 1, 0, 20), []
    sites = RelocatedModels(space, cache)
    for place in range(3):
        own = sites.model(space.with_places_of(Design((), (), (place,))))
        spread.append(6 * own.evaluate(x, "coulomb").measurements.std(0, ddof=1).max())
    best = int(np.argmin(spread))
    assert best and spread[best] < 0.99 * spread[0], "it matters where they stand"
    assert changes(found) == {("welds.W1",): points["points"][best - 1]}
    assert found.found == pytest.approx(spread[best], rel=1e-6)


def test_places_take_the_meshes_of_the_scene(cache):
    scene = placed([W1]).model_copy(update={"folder": Path("nowhere")})
    with pytest.raises(SceneError, match="other places require the meshes of the parts, which cannot be read"):
        RelocatedModels(Space(SimpleNamespace(scene=scene)), cache)


# ------------------------------------------------------------------------------------------------------- matching


@pytest.fixture(autouse=True)
def tables_of_measured_parts(tmp_path, monkeypatch):
    """A scene that is not read from a file has no folder: its tables are named by the user."""
    monkeypatch.setenv(ALSO_READ, str(tmp_path))


def kinds(*sizes):
    return [
        Kind(f"k{t}", [t], np.arange(size, dtype=float)[:, None], [*range(2, 2 + size)]) for t, size in enumerate(sizes)
    ]


@pytest.mark.parametrize("sizes", [(3, 5), (5, 3)])
def test_an_assignment_is_the_one_that_brute_force_finds(sizes):
    table = np.random.default_rng(7).uniform(size=sizes)
    found = assign_parts(kinds(*sizes), lambda pairs: table[pairs[:, 0], pairs[:, 1]])
    few, many = (0, 1) if sizes[0] <= sizes[1] else (1, 0)
    square = table if few == 0 else table.T
    best = min(square[range(len(square)), list(p)].mean() for p in permutations(range(sizes[many]), sizes[few]))
    assert found.after == pytest.approx(best) and found.before == pytest.approx(np.diag(table).mean())
    rows = found.rows - 2
    assert table[rows[:, 0], rows[:, 1]].mean() == pytest.approx(best)
    assert [len(own) for own in found.left] == [size - min(sizes) for size in sizes]


def test_three_kinds_are_assigned_until_nothing_improves():
    """Three kinds of values ±x have a matching whose sums are all 0; it is found from the order of the files."""
    values = [np.array([1.0, -1.0, 2.0, -2.0]), np.array([2.0, 1.0, -1.0, -2.0]), np.zeros(4)]
    cost = lambda own: sum(value[own[:, t]] for t, value in enumerate(values)) ** 2
    found = assign_parts(kinds(4, 4, 4), cost)
    assert found.before > 0 and found.after == pytest.approx(0.0, abs=1e-12) and found.rounds >= 3
    assert cost(found.rows - 2).mean() == pytest.approx(0.0, abs=1e-12)
    for t in range(3):
        assert sorted(found.rows[:, t]) == [2, 3, 4, 5]


def matched(tmp_path, asked=(), sigma=0.1, **changes):
    """M = F/50 + (B + C + D)/2, centred at 20 N: B and C are measured on parts of two kinds, D is not."""
    more = [
        {"name": name, "kind": "locator", "target": target, "mean": 0.0, "sigma": own}
        for name, target, own in (("B", "bl1", 0.1), ("C", "bl2", 0.1), ("D", "bl1", sigma))
    ]
    limits = at_face("b", name="M", lower=0.3, upper=0.5)
    kinds = [{"name": name, "file": str(tmp_path / f"{name}.csv")} for name in ("front", "rear")]
    return pushed({"matching": kinds, **dict(asked)}, deviations=more, measurements=[limits], **changes)


@pytest.mark.parametrize("sigma", [0.0, 0.02])
def test_measured_parts_are_matched_long_with_short(tmp_path, sigma):
    b, c = np.array([0.1, -0.2, 0.3, 0.0, -0.1]), np.array([0.2, 0.1, -0.1, 0.0, -0.3])
    for name, own, values in (("front", "B", b), ("rear", "C", c)):
        (tmp_path / f"{name}.csv").write_text(f"{own}\n" + "\n".join(map(str, values)) + "\n")
    again, ledger = [], tmp_path / "evaluated.jsonl"
    found = optimise(matched(tmp_path, sigma=sigma), "frictionless", fresh=100, ledger=ledger)
    optimise(matched(tmp_path, sigma=sigma), "frictionless", fresh=100, ledger=ledger, progress=again.append)
    assert not again, "nothing that was evaluated is evaluated again"
    rows = found.matched.rows - 2
    together = b[rows[:, 0]] + c[rows[:, 1]]
    best = min(np.sum((b + c[list(p)]) ** 2) for p in permutations(range(5)))
    assert np.sum(together**2) == pytest.approx(best, abs=1e-12)
    loss = lambda x: np.mean(((0.4 + x / 2) - 0.4) ** 2) / 0.01
    assert found.matched.before > found.matched.after and found.changes == []
    gain = loss(b + c) - loss(together)
    if sigma:
        assert found.matched_gain.low < gain < found.matched_gain.high < 3 * gain
    else:
        assert found.matched_gain.value == pytest.approx(gain) and np.isnan(found.matched_gain.low)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("B\n0.1\n0.2\n", "'B' is measured on front as well"),
        ("C\n0.1\n9.0\n", "9 is more than 6 standard deviations (0.1) off the mean, 0; give the parts of this scene"),
        ("C\n0.1\n", "the file has fewer than two parts"),
    ],
)
def test_measured_parts_of_another_scene_are_refused(tmp_path, text, said):
    (tmp_path / "front.csv").write_text("B\n0.1\n0.2\n")
    (tmp_path / "rear.csv").write_text(text)
    with pytest.raises(SceneError, match=r"optimise\.matching\[1\]\.file \(rear\)") as told:
        optimise(matched(tmp_path), "frictionless")
    assert said in str(told.value)


# ------------------------------------------------------------------------------------- search, budget and refusals


def test_the_jackknife_of_a_mean_is_students_interval():
    y = np.random.default_rng(1).standard_normal((40, 2))
    own = jackknife(y, lambda y: float((y[:, 1] - y[:, 0]).mean()), added=0)
    known = mean_change(y[:, 0], y[:, 1])
    assert [own.value, own.low, own.high] == pytest.approx([known.value, known.low, known.high])


@pytest.mark.slow
def test_a_killed_search_continues_without_repeating_evaluations(tmp_path):
    ledger, counts = tmp_path / "evaluated.jsonl", []
    asked = ORDERED | {"forces": [{"clamps": ["C1"], "between": [5, 30]}]}
    model = rubbing(asked)

    def stop(count):
        counts.append(count)
        if sum(counts) >= 200:
            raise KeyboardInterrupt

    search = partial(optimise, model, "coulomb", samples=20, fresh=40, budget=300)
    with pytest.raises(KeyboardInterrupt):
        search(ledger=ledger, progress=stop)
    ledger.write_text(ledger.read_text() + '{"stamp": "cut o')
    whole, rest, again = [], [], []
    straight, resumed = search(progress=whole.append), search(ledger=ledger, progress=rest.append)
    assert resumed.changes == straight.changes and resumed.gain == straight.gain
    assert sum(whole) - sum(rest) == 180  # the block that was cut is done again
    search(ledger=ledger, progress=again.append)
    assert not again


def test_the_budget_is_respected():
    count = []
    found = optimise(rubbing(ORDERED), "coulomb", samples=20, fresh=20, budget=150, progress=count.append)
    assert found.evaluations <= 150 and sum(count) <= 150 + 2 * 20
    with pytest.raises(SceneError, match="20 samples of the stated scene exceed the budget of 10"):
        optimise(rubbing(ORDERED), "coulomb", samples=20, budget=10)


def test_a_table_of_samples_is_halved():
    carlo = {"values": [[x, 0.0] for x in np.linspace(-0.1, 0.3, 21)]}
    found = optimise(pushed({"forces": [FORCE], "of": ["M"]}, monte_carlo=carlo), "frictionless")
    assert (found.samples, found.fresh) == (10, 11)
    with pytest.raises(SceneError, match="3 samples, too few"):
        optimise(pushed({"forces": [FORCE]}, monte_carlo={"values": [[0.0, 0.0]] * 3}))


def test_a_stage_that_does_all_at_once_has_no_order():
    stages = [{"kind": "locate"}, {"kind": "clamp", "path": "one-step"}, {"kind": "measure"}]
    with pytest.raises(SceneError, match=r"orders\[0\].stage: 'clamp' has no order"):
        optimise(pushed({"orders": [{"stage": "clamp"}]}, stages=stages))


def test_a_scene_without_optimisation_or_variation_is_refused():
    with pytest.raises(SceneError, match=r"add a table \[optimise\]"):
        optimise(pushed(None))
    with pytest.raises(SceneError, match="nothing varies"):
        optimise(pushed({"forces": [FORCE]}, deviations=[]))


LAP = tomllib.loads((mic.examples.folder("lap_joint") / "scene.toml").read_text())
JAW = {"clamps": ["C1-upper", "C1-lower"], "between": [30, 120]}


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({}, "nothing may be changed: add forces"),
        ({"objective": "best", "forces": [JAW]}, "got 'best'"),
        ({"forces": [JAW | {"clamps": ["nobody"]}]}, "there is no clamp called 'nobody'"),
        ({"forces": [JAW | {"between": [300, 200]}]}, "300 is not below 200"),
        ({"forces": [JAW | {"between": [1, 2]}]}, "states 60 N, which is outside 1 to 2"),
        ({"forces": [JAW, JAW]}, "'C1-upper' is given twice"),
        ({"shims": [{"of": ["lower-A1"], "between": [0.1, 0.2]}]}, "must include 0, no change"),
        ({"shims": [{"of": ["C1-upper"], "between": [-1, 1]}]}, "pushes with a force and has no position"),
        ({"orders": [{"stage": "locate"}]}, "no stage that closes or opens anything called 'locate'"),
        ({"orders": [{"stage": "clamp", "groups": [["C1-upper"], ["W1"]]}]}, "no item of stage 'clamp' called 'W1'"),
        ({"orders": [{"stage": "weld", "groups": [["W1"], ["W1"]]}]}, "'W1' is given twice"),
        ({"places": [{"item": "welds.W9", "points": [[0, 0, 0]]}]}, "did you mean 'welds.W2'?"),
        ({"matching": [{"name": "a", "file": "a.csv"}]}, "at least two kinds of parts"),
        ({"objective": "cost", "forces": [JAW]}, "cost is lowest without any change"),
        ({"objective": "yield", "weights": {"M1": 2}, "forces": [JAW]}, "weights apply to 6σ"),
        ({"of": ["M77"], "forces": [JAW]}, "there is no measurement called 'M77'"),
        ({"forces": [JAW], "constraints": [{"quantity": "force", "at_least": 500}]}, "260 N are missing"),
        ({"forces": [JAW], "constraints": [{"quantity": "force", "at_most": 20}]}, "they are 40 N above"),
        ({"forces": [JAW], "constraints": [{"quantity": "cpk", "at_most": 1}]}, "give at_least, and remove at_most"),
        ({"forces": [JAW], "constraints": [{"quantity": "mean"}]}, "give at_least or at_most"),
    ],
)
def test_invalid_requests_are_refused_by_key(tmp_path, asked, said):
    with pytest.raises(SceneError) as told:
        read_table(LAP | {"optimise": asked}, tmp_path / "scene.toml")
    (line,) = str(told.value).splitlines()
    assert line.startswith(f"{tmp_path / 'scene.toml'}: optimise") and said in line


def test_an_objective_takes_measurements_with_a_tolerance(tmp_path):
    less = {key: value for key, value in LAP.items() if key != "measurements"}
    with pytest.raises(SceneError, match=r"cpk needs measurements with a tolerance, and there are none"):
        read_table(less | {"optimise": {"forces": [JAW]}}, tmp_path / "scene.toml")


SECTION = (ROOT / "docs" / "howto.md").read_text().split("## Optimise fixture, sequence and shims\n")[1]
SECTION = SECTION.split("\n## ")[0]


def test_tables_of_the_page_are_valid(tmp_path):
    tables = [tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", SECTION, re.S)]
    assert [set(read_table(LAP | table, tmp_path / "scene.toml").optimise.model_fields_set) for table in tables] == [
        {"objective", "forces", "orders", "places", "constraints"},
        {"matching"},
    ]


@pytest.mark.slow
def test_python_code_of_the_page_runs(lap_model, monkeypatch, capsys):
    changed = lambda scene: lap_model.scene.model_copy(update={"optimise": scene.optimise})
    monkeypatch.setattr(mic, "reduce", lambda scene: replace(lap_model, scene=changed(scene)))
    (code,) = re.findall(r"```python\n(.*?)```", SECTION, re.S)
    exec(code, {})
    assert "positions.upper-A3: 0 →" in capsys.readouterr().out


TEXT = """# a scene
[[stages]]
kind = "locate"

[[stages]]
kind = "clamp"
order = [   # the stated one
    ["a"],
    ["b", "[c]"],
]

# of the weld
[[stages]]
kind = "weld"
sequence = true

[report]
laws = ["coulomb"]
"""


def test_revised_keys_change_and_the_rest_of_the_file_stays():
    found = revised(TEXT, "stages", 1, {"order": [["b"], ["a"]], "sequence": None})
    assert tomllib.loads(found)["stages"][1] == {"kind": "clamp", "order": [["b"], ["a"]]}
    assert "# a scene" in found and "# of the weld" in found and "the stated one" not in found
    last = revised(found, "stages", 2, {"order": [["w"]], "sequence": None})
    table = tomllib.loads(TEXT)
    table["stages"][1]["order"] = [["b"], ["a"]]
    table["stages"][2] = {"kind": "weld", "order": [["w"]]}
    assert tomllib.loads(last) == table
    with pytest.raises(SceneError, match="change it by hand"):
        revised(TEXT, "clamps", 0, {"force": 3})


def test_a_scene_is_written_with_its_changes(tmp_path):
    text = (mic.examples.folder("lap_joint") / "scene.toml").read_text()
    before = read_table(tomllib.loads(text), tmp_path / "scene.toml")
    wanted = [
        Change("force", ("C1-upper", "C1-lower"), 60.0, 90.0),
        Change("shim", ("lower-A1",), 0.0, 0.2),
        Change("order", ("weld",), None, [["W2"], ["W1"]]),
        Change("place", ("welds.W1",), [88, 6, 0.5], [86.0, 7.0, 0.5]),
    ]
    after = read_table(tomllib.loads(scene_text_with_changes(text, before, wanted)), tmp_path / "scene.toml")
    assert sorted(scene_differences(before, after)) == [
        "clamps.C1-lower.force: 60 → 90",
        "clamps.C1-upper.force: 60 → 90",
        "deviations.shim-1: added",
        "stages.weld.order: None → [['W2'], ['W1']]",
        "welds.W1.point: [88.0, 6.0, 0.5] → [86.0, 7.0, 0.5]",
    ]
    assert (after.deviations[-1].target, after.deviations[-1].mean, after.deviations[-1].sigma) == ("lower-A1", 0.2, 0)


def test_changes_of_the_jaws_of_a_tong_are_written_to_the_tong():
    text = '[[stages]]\nkind = "clamp"\n\n[[clamps]]\nname = "T"\nparts = ["a", "b"]\nforce = 20\n'
    scene = SimpleNamespace(clamps=[SimpleNamespace(name=f"T-{part}", stroke=None) for part in "ab"])
    order = Change("order", ("clamp",), None, [["T-a", "T-b"], ["L"]])
    wanted = [Change("force", ("T-a", "T-b"), 20.0, 30.0), order]
    table = tomllib.loads(scene_text_with_changes(text, scene, wanted))
    assert table["clamps"] == [{"name": "T", "parts": ["a", "b"], "force": 30.0}]
    assert table["stages"] == [{"kind": "clamp", "order": [["T"], ["L"]]}]
    text = '[[clamps]]\nname = "S"\nstroke = 1.0\n\n[[clamps]]\nname = "U"\nstroke = -2.0 # mm\n'
    scene = SimpleNamespace(clamps=[SimpleNamespace(name=name, stroke=x) for name, x in (("S", 1.0), ("U", -2.0))])
    table = tomllib.loads(scene_text_with_changes(text, scene, [Change("shim", ("S", "U"), 0.0, 0.5)]))
    assert [one["stroke"] for one in table["clamps"]] == [1.5, -1.5]
    with pytest.raises(SceneError, match="'C' is stated in a table file"):
        scene_text_with_changes('[[clamps]]\nfile = "c.csv"\n', scene, [Change("force", ("C",), 20.0, 30.0)])


# -------------------------------------------------------------------------------------------------------- command


def called(tmp_path, model, *options):
    path = tmp_path / "model.npz"
    model.save(path)
    return CliRunner().invoke(app, ["optimise", str(path), "--out", str(tmp_path / "out"), *options])


def test_the_command_prints_violated_constraints(tmp_path):
    limits = [{"quantity": "mean", "of": ["M"], "at_most": -1}]
    model = pushed({"forces": [FORCE], "constraints": limits})
    found = called(tmp_path, model, "--law", "frictionless", "--fresh", "60")
    assert "Violated: mean of M at most -1; it is 0.2" in found.output and "1.2" in found.output


def test_the_command_prints_matched_parts(tmp_path):
    (tmp_path / "front.csv").write_text("B\n0.1\n-0.2\n0.3\n")
    (tmp_path / "rear.csv").write_text("C\n0.2\n0.1\n-0.3\n0.0\n")
    found = called(tmp_path, matched(tmp_path), "--law", "frictionless")
    assert found.exit_code == 0, found.output
    assert "Matched parts" in found.output and "Unused parts rear: rows" in found.output
    assert len(OPTIMUM_MATCHES.read(tmp_path / "out", "mend it")) == 6


def test_an_interrupted_search_prints_its_best_design_so_far(tmp_path, monkeypatch):
    def interrupted(*arguments, better, **options):
        better([Change("force", ("C",), 20.0, 30.0)], 1.5)
        raise KeyboardInterrupt

    monkeypatch.setattr("mic.commands.optimise.search_optimum", interrupted)
    found = called(tmp_path, pushed({"forces": [FORCE]}))
    assert found.exit_code and "so far 1.5 on the samples of the" in found.output
    assert "clamps.C: 20 → 30 N" in found.output and "Run the command again to continue" in found.output


def test_a_changed_copy_is_written_beside_a_scene_file_only(tmp_path):
    found = called(tmp_path, pushed({"forces": [FORCE]}), "--save", str(tmp_path / "better.toml"))
    assert found.exit_code and "--save writes a changed copy of a scene file" in str(found.exception)
    scene = tmp_path / "here" / "scene.toml"
    scene.parent.mkdir()
    scene.write_text("")
    options = ["optimise", str(scene), "--save", str(tmp_path / "better.toml")]
    assert "save to the same folder" in str(CliRunner().invoke(app, options).exception)


@pytest.mark.parametrize("gained", [True, False])
def test_the_command_prints_changes_and_side_effects_and_writes_a_copy_after_a_gain(tmp_path, monkeypatch, gained):
    scene, better, out = tmp_path / "scene.toml", tmp_path / "better.toml", tmp_path / "out"
    scene.write_text('[[clamps]]\nname = "C"\nforce = 20\n')
    model = pushed({"objective": "cpk" if gained else "largest-six-sigma", "forces": [FORCE], "of": ["M"]})
    monkeypatch.setattr("mic.commands.invocation.load_model", lambda console, source: (model, None))
    options = ["optimise", str(scene), "--save", str(better), "--out", str(out), "--law", "frictionless"]
    done = CliRunner().invoke(app, [*options, "--fresh", "60"])
    assert done.exit_code == 0, done.output
    assert better.is_file() == gained
    if not gained:
        assert "No better design found" in done.output and "is not written" in done.output
        return
    assert 46 < tomllib.loads(better.read_text())["clamps"][0]["force"] < 49
    assert "clamps.C: 20 → 47" in done.output and "On 60 fresh samples the least Cpk" in done.output
    assert "No significant gain" not in done.output and " N " in done.output
    assert [len(table.read(out, "mend it")) for table in (OPTIMA, OPTIMUM_CHANGES)] == [1, 1]
    assert json.loads((out / "evaluated.jsonl").read_text().splitlines()[0])["key"].startswith("[]")
