"""The studies of algebra, law, mesh, nominal stiffness and trade: their calculations, and planted errors."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text
from scipy.sparse import csr_matrix, diags
from support.wrong_models import compliance_scaled, contacts_changed, gaps_off, without_friction

from fem_reference.full.equilibrium import Iteration
from fem_reference.full.model import FullModel
from mic.model.assembly import assemble
from mic.scene import SETTINGS
from mic.statistics.draw import draw
from verification.algebra.study import STUDY as ALGEBRA
from verification.algebra.study import compare, newton_orders, newton_runs
from verification.comparison import reduced_and_assembly, relative, routes, zone_slip
from verification.curved_sheets import study as curved_sheets
from verification.law import study as law
from verification.mesh import study as mesh
from verification.mesh.study import converge
from verification.nominal_stiffness import study as nominal
from verification.path import study as path
from verification.ranks import study as ranks
from verification.scenes import shipped, with_path
from verification.study import Context, Team
from verification.trade import picture as trade_picture
from verification.trade import study as trade
from verification.trade import versions as trade_versions

pytestmark = pytest.mark.fem

AUGMENTED = next(a.limit for a in ALGEBRA.acceptance if a.name == "augmented")


@pytest.fixture(scope="module")
def solved_once():
    """Full solves of this module's assemblies are computed once: planted errors change only the reduced model."""
    evaluate, found = FullModel.evaluate, {}

    def evaluated(self, sample, law="coulomb"):
        scene, friction = self.assembly.scene, self.assembly.contacts.friction
        key = (scene.model_dump_json(), friction.tobytes(), self.route, self.penalty, sample.tobytes(), law)
        if key not in found:
            found[key] = evaluate(self, sample, law)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FullModel, "evaluate", evaluated)
        yield


@pytest.fixture(scope="module")
def lap(cache):
    return reduced_and_assembly(shipped("lap_joint", "coarse", ("coulomb", "frictionless", "associated")), cache)


def tangent_reversed(model):
    """t1 of the first contact points the wrong way on one of the two parts."""
    rows = model.rows["contact"].copy()
    rows.data[rows.indptr[1]] *= -1
    return replace(model, rows=model.rows | {"contact": rows})


def weld_forgotten(model):
    """The second weld reads nothing, and so holds nothing."""
    kept = diags(np.repeat([1.0, 0.0], model.weld_size))
    return replace(model, rows=model.rows | {"weld": csr_matrix(kept @ model.rows["weld"])})


PLANTED = {
    "frame's sign": tangent_reversed,
    "friction ignored": without_friction,
    "weld forgotten": weld_forgotten,
    "thickness doubled": lambda model: replace(compliance_scaled(model, 1 / 8), shape=model.shape / 8),
    "gap off by 0.1 µm": lambda model: gaps_off(model, 1e-4),
}


def largest(rows):
    return max(max(row[key] for key in ("force", "displacement", "measurement")) for row in rows if row["ε/k"] is None)


@pytest.mark.slow
def test_algebra_agrees_and_its_penalty_error_is_of_first_order(lap, solved_once):
    rows = compare(*lap, "coulomb", 0, (1e3, 1e5))
    errors = [row["force"] for row in rows[:2]]
    assert np.log10(errors[0] / errors[1]) / 2 == pytest.approx(1, abs=0.02), errors
    assert largest(rows) < AUGMENTED and all(row["changed states"] == 0 for row in rows)
    assert rows[-1]["residual of the full solve"] < 1e-9 and rows[-1]["condensed route"] < 1e-8
    assert {row["route"] for row in rows} == {"whole"}


@pytest.mark.parametrize("error", PLANTED)
def test_algebra_catches(lap, error, solved_once):
    model, assembly = lap
    found = largest(compare(PLANTED[error](model), assembly, "coulomb", 0, ()))
    assert found > 1e4 * AUGMENTED, found


def test_orders_of_newtons_method_by_hand():
    """Second order gives 2, first order 1; a cut step or a change of state starts a new run."""
    steps = [Iteration(r, α, 1, 1, 1, changed) for r, α, changed in HISTORY]
    runs = newton_runs(steps)
    assert [list(run) for run in runs] == [[1e-2, 1e-4, 1e-8], [1e-3, 1e-4, 1e-5]]
    assert [newton_orders(run) for run in runs] == [pytest.approx([2.0]), pytest.approx([1.0])]


HISTORY = (
    *((1e-1, 1.0, 3), (1e-2, 1.0, 1), (1e-4, 1.0, 0), (1e-8, 1.0, 0), (1e-16, 1.0, 0)),
    *((1e-2, 1.0, 2), (1e-3, 0.5, 0), (1e-4, 1.0, 0), (1e-5, 1.0, 0)),
)


def test_costs_of_a_distributed_solve_by_hand():
    one = {"costs": [[8.0, 90.0, 200.0, 500.0]], "size": [6000, 10], "route": "whole", "force clamp": [1.0, -4.0]}
    two = one | {"costs": [[5.0, 60.0, 120.0, 350.0], [4.0, 40.0, 90.0, 400.0]], "force clamp": [1.0, -4.4]}
    for kind in ("displacement clamp", "reaction clamp", "measurements"):
        one[kind], two[kind] = [2.0], [2.0]
    rows = ranks.compare({1: one, 2: two}).set_index("processes")
    assert rows.loc[2, ["speed-up", "largest share of the operations"]].tolist() == pytest.approx([1.6, 0.6])
    assert rows.loc[2, ["largest memory, MB", "largest factors, MB"]].tolist() == [400.0, 120.0]
    assert rows["difference"].tolist() == pytest.approx([0.0, 0.1])


def test_routes_in_words():
    assert routes(["whole", "whole"]) == "2 full solves by the whole route."
    other = "whole, 1 of 9 solves condensed"
    assert routes(["whole", other]) == f"2 full solves by the whole route; 1 otherwise: {other}."


def test_relative_difference():
    found = [relative([1.0, 2.0], [1.0, 2.5]), relative([0.0], [0.0]), relative([1.0], [0.0]), relative([-1.0], [1.0])]
    assert found == pytest.approx([0.2, 0, np.inf, 2])  # a wrong sign is not a small error


def test_zone_slip_by_hand():
    contacts = SimpleNamespace(zone=np.array([0, 0, 1]), watched=np.zeros(3, bool), area=np.array([1.0, 3.0, 7.0]))
    motion = [[9, 3, 4], [9, 0, 0], [9, 0, 2]]
    assert zone_slip(motion, contacts, 2) == pytest.approx([np.sqrt(12.5), 2])
    contacts.watched[:] = True  # candidates count by the area that they stand for
    assert zone_slip(motion, contacts, 2) == pytest.approx([2.5, 2])


@pytest.fixture(scope="module")
def at_once(lap):
    """The lap joint whose stages do all at once, as the study of laws has it."""
    return tuple(replace(one, scene=with_path(one.scene, "one-step")) for one in lap)


@pytest.mark.slow
def test_the_study_of_laws_distinguishes_the_associated_law_from_coulomb(at_once):
    model, _ = law.with_friction(at_once, 0.4)
    deviations = draw(model.scene, model.scene.monte_carlo.seed, 0, 3)
    associated, itself = law.compare(model, deviations, "associated"), law.compare(model, deviations, "coulomb")
    assert associated["gap at loaded contacts, mm"] > 1e-3
    assert associated["force"] > 0.1 and associated["identity"] < 1e-6
    # If (13) were Coulomb's law, `opening` would fail.
    assert itself["gap at loaded contacts, mm"] < 1e-9 and itself["force"] == 0
    without = law.compare(model, deviations, "frictionless")
    assert without["force when clamped"] == pytest.approx(0.4, rel=0.01)  # the friction force itself is missing
    assert without["force"] > 0.99 * 0.4  # released, normal forces beside the nuggets change by more: 2.3 of 4.2 N


def test_law_is_judged_by_finite_elements_with_the_same_friction(at_once, solved_once):
    assert law.against_full(at_once, 0.1)[0] < 1e-8
    model, assembly = at_once
    assert law.against_full((compliance_scaled(model, 1.01), assembly), 0.1)[0] > 1e-4


VARIANTS = {
    "power": ("pressure-dependent", law.FUNCTIONS["falling power"], "pressure"),
    "stiffness": ("micro-slip", {"tangential_stiffness": 1e3}, "compliance"),
    "falling by stage": ("coulomb", {"friction": law.BY_STAGE["falling"]}, "friction"),
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.slow
def test_the_study_of_laws_detects_a_wrong_function_stiffness_or_stage(variant, cache, solved_once, monkeypatch):
    """The full solve disagrees with a reduced model whose friction is a tenth too large."""
    monkeypatch.setattr(law, "INCREMENTS", 1)
    name, keys, field = VARIANTS[variant]
    model, assembly = law.variant(keys, cache)
    right = law.solved_both_ways((model, assembly), name)
    assert max(right["force"], right["displacement"], right["measurement"]) < 1e-8 and right["slipping"]
    wrong = getattr(model.contacts, field).copy()
    # α, β and γ of every piece, and so μ; all stages but the clamping; or the compliance as a whole
    place = {"pressure": (..., slice(1, 4)), "friction": -1, "compliance": ...}[field]
    wrong[place] *= 1.1
    found = law.solved_both_ways((contacts_changed(model, **{field: wrong}), assembly), name)
    assert max(found["force"], found["displacement"], found["measurement"]) > 1e-4


@pytest.mark.parametrize("order, sizes", [(1.0, (4, 2, 1)), (2.0, (5, 3, 2)), (1.5, (9.5, 6.0, 4.1))])
def test_order_and_limit_of_a_manufactured_sequence(order, sizes):
    h = np.array(sizes, dtype=float)
    found = converge(h, 7.0 + 0.3 * h**order)
    assert found.order == pytest.approx(order, rel=1e-6) and found.extrapolated == pytest.approx(7.0, rel=1e-9)
    assert found.index >= 0.3 * h[2] ** order and found.kind == "monotone"  # the band holds the limit


def test_mesh_sequences_without_an_order():
    found = converge((4, 2, 1), (1.0, 1.3, 1.2))
    assert found.kind == "oscillating" and found.index == pytest.approx(0.3) and found.extrapolated == 1.2
    assert converge((4, 2, 1), (1.1, 1.0, 1.0)).index == pytest.approx(0, abs=1e-12)
    assert converge((4, 2, 1), (1.0, 2.0, 4.0)).index > 4  # it diverges, which the band shows


def test_meshes_that_are_divided_at_nuggets_are_not_extrapolated(lap, monkeypatch):
    monkeypatch.setattr(mesh, "reduced_and_assembly", lambda scene, cache: lap)
    with pytest.raises(RuntimeError, match="lap_joint: elements of 8.0 mm are divided at nuggets; begin with smaller"):
        mesh.on_mesh(SimpleNamespace(cache=None), "lap_joint", 8.0, 3, lap[1].contacts)


@pytest.mark.slow
def test_contact_pairs_read_the_same_on_all_meshes(cache):
    """Cells that are divided anew on each mesh have other positions and sizes, by some hundredths."""
    first, *held = [shipped("lap_joint", size) for size in (5.0, 5.0, 2.5)]
    pairs = assemble(first, cache).contacts
    coarse, fine = (assemble(mesh.same_discs(scene, pairs), cache).contacts for scene in held)
    assert np.abs(coarse.point - fine.point).max() < 2e-3 and coarse.bearing == pytest.approx(fine.bearing, rel=1e-12)
    assert coarse.bearing.sum() == pytest.approx(pairs.area.sum(), rel=1e-9)


def test_a_mesh_is_off_by_its_difference_from_the_finest_over_6_sigma():
    """Means too, which may be nothing."""
    keys = [(f"{statistic} {kind}", "A") for kind in ("measurement", "displacement") for statistic in ("mean", "6σ")]
    coarse, medium, fine, last = (dict(zip(keys, column)) for column in np.transpose([
        (9.0, 0.2, 0.1, 0.0), (9.0, 2.2, 1.9, 2.0), (9.0, 5.0, 4.0, 3.0), (9.0, 0.5, 0.3, 0.4)
    ]))  # fmt: skip
    table = mesh.against_the_last([coarse, medium, fine, last])
    assert table["medium off"].tolist() == pytest.approx([0.1, 0.1, 5.0, 0.25])
    assert table["fine off"].tolist() == pytest.approx([0.05, 0.05, 2.5, 0.25])


def test_the_study_of_curved_sheets_rejects_flat_triangles(monkeypatch, tmp_path):
    """A curved and a twisted sheet are within their limits, but not with the triangles' own normals."""
    cases = [case for case in curved_sheets.JUDGED if case[0] in ("cylinder 5 t", "beam across")]
    monkeypatch.setattr(curved_sheets, "CASES", cases)
    monkeypatch.setattr(curved_sheets, "JUDGED", cases)
    found = []
    for kinds in (curved_sheets.KINDS, {"own normals": curved_sheets.KINDS["flat"]}):
        monkeypatch.setattr(curved_sheets, "KINDS", kinds)
        findings = curved_sheets.run(Context(quick=True, cache=tmp_path, team=Team()))
        limits = {name: limit for name, *_, limit in cases}
        found.append([one.measured <= limits[one.name] for one in findings])
    assert found == [[True, True], [False, False]]


def test_stretching_of_a_cylinder_by_hand():
    """A strip bent to w = c x²: the added membrane energy is ∫ E t/(1 − ν²)/2 (½ w'²)² dA; turned as a whole, nothing
    is added."""
    from mic.geometry.structured import extrude
    from mic.geometry.surface import Surface

    length, width, c = 100.0, 20.0, 1e-3
    points, triangles, _ = extrude([(0.0, 0.0), (width, 0.0)], 0.0, length, 1.0)
    part = SimpleNamespace(name="strip", surface=Surface(points, triangles), young=2e5, poisson=0.3, thickness=1.0)
    x = points[:, 0]

    def bound(w):
        fields = {"strip": np.column_stack([np.zeros((len(x), 2)), w, np.zeros((len(x), 3))])}
        full = SimpleNamespace(resolutions={"clamp": None}, field=lambda stage: fields, strain_energy=lambda stage: 1.0)
        return nominal.stretching(SimpleNamespace(parts=[part]), full)

    # without its rigid motion the slope is 2 c (x − length/2)
    stiffness = part.young * part.thickness / (1 - part.poisson**2)
    exact = stiffness / 8 * width * (2 * c) ** 4 * 2 * (length / 2) ** 5 / 5
    assert bound(c * x**2) == pytest.approx(exact, rel=0.01)
    assert bound(0.1 * x) < 1e-12 * exact


@pytest.mark.slow
def test_the_stiffness_of_the_mean_shape_and_its_derivatives(cache, monkeypatch):
    """With shapes that scatter by a quarter of their mean, it halves the nominal error, and derivatives remove most."""
    built = reduced_and_assembly(with_path(shipped("lap_joint", "coarse"), "increments", 1), cache)
    at, solved = nominal.DeviatedStiffness.at, {}

    def remembered(self, sample):
        key = sample.tobytes()
        if key not in solved:
            solved[key] = at(self, sample)
        return solved[key]

    monkeypatch.setattr(nominal.DeviatedStiffness, "at", remembered)

    def left():
        means = pd.DataFrame(
            [{"assembly": "lap_joint"} | row for row in nominal.systematic(built, 1.0, 0.25, 2, cache)]
        )
        return [nominal.ratios(means, name).max(axis=None) for name in ("mean", "first-order")]

    followed, models = nominal.followed, {}

    def right(assembly, stiffness, mean, sigma, cache):
        key = stiffness, mean.tobytes(), sigma.tobytes()
        if key not in models:
            models[key] = followed(assembly, stiffness, mean, sigma, cache)
        return models[key]

    def planted(assembly, stiffness, mean, sigma, cache):
        """Use the nominal shape instead of the mean one, and derivatives of the wrong sign."""
        if stiffness == "mean":
            return right(assembly, stiffness, 0 * mean, sigma, cache)
        model = right(assembly, stiffness, mean, sigma, cache)
        own = model.slopes
        H, G = (tuple(-block for block in blocks) for blocks in (own.H, own.G))
        return replace(model, slopes=replace(own, H=H, G=G, gap=-own.gap, weld_gap=-own.weld_gap))

    monkeypatch.setattr(nominal, "followed", right)
    mean, first = left()
    assert mean < 0.75 and first < 0.1
    monkeypatch.setattr(nominal, "followed", planted)
    mean, first = left()
    assert mean == pytest.approx(1.0, abs=1e-6) and first > 0.5


def test_settings_reach_the_trade():
    versions = trade_versions.versions_of("lap_joint", trade_versions.QUICK["lap_joint"])
    for setting, given in SETTINGS.items():
        scene = versions["setting", setting]
        assert {part.size for part in scene.parts} == {given["size"]} and scene.path.tolerance == given["tolerance"]
        assert all(zone.candidates and zone.spacing_factor == given["spacing_factor"] for zone in scene.zones)
    assert versions["path", "increments 1"].stages[1].increments == 1
    assert versions["pairs", "pairs 34"].zones[0].pairs == 34
    exact = versions["truth", trade_versions.ALL_FINER]
    assert exact.parts[0].size == 0.884 and exact.path.tolerance == trade_versions.FINE
    assert exact.zones[0].spacing_factor < SETTINGS["reference"]["spacing_factor"]
    assert versions["law", "associated"].report.laws == ["associated"]
    pairs = trade_versions.QUICK["lap_joint"].own["pairs"]
    fine, coarse = (
        [versions["truth", knobs.words].zones[0].spacing_factor for knobs in some]
        for some in (pairs.fine, pairs.coarse)
    )
    assert fine == [exact.zones[0].spacing_factor] and min(coarse) > max(fine)


def test_the_trade_finds_the_worst_figure_of_each_kind_and_the_error_of_the_reference():
    """Slips that hardly vary are left out, samples that failed too; a version that is off by a share is off by it."""
    exact = pd.DataFrame(np.random.default_rng(1).normal(size=(40, 4)), columns=["a", "b", "c", "d"])
    exact.columns = ["measurement:M1", "measurement:M2", "slip:clamp:near", "slip:clamp:idle"]
    exact["slip:clamp:idle"] *= 0.01
    own = exact * [1.01, 0.96, 1.02, 7.0]
    own.iloc[3] = np.nan
    found = trade.errors(own, exact)
    assert found["error of 6σ, key characteristics"] == pytest.approx(0.04)
    assert found["worst of key characteristics"] == "measurement:M2"
    assert found["error of 6σ, slips"] == pytest.approx(0.02)
    assert found["error of 6σ"] == pytest.approx(0.04)
    first = trade.errors(own[:20], exact)  # of the first samples against the same
    assert first["error of 6σ"] == pytest.approx(0.04) and first["±, slips"] > 0
    over = trade.over(own[["measurement:M1", "measurement:M2"]] * 1e-3, exact * 1e-3, 0.01)
    spread = 6e-3 * exact.drop(3).std(ddof=1)  # mm; 1 % of it is less than the 2 µm that decide
    assert over["measurement:M2"] == pytest.approx(0.04 * spread["measurement:M2"] / 2e-3)


def test_the_error_of_the_reference_is_that_of_its_coarser_versions():
    fine = pd.DataFrame({"slip:clamp:lap": np.random.default_rng(2).normal(size=30)})
    truth = trade_versions.truth(0.625, 0.5, 16, 30)
    shares = {"element size": 1.03, "pairs": 1.02, "path": 0.95}
    found = {}
    for name, source in truth.own.items():
        for own, coarse in zip(source.fine, source.coarse):
            place = 0.5 + (own.factor or 0.5)  # where candidates lie changes what the mean keeps
            found["lap_joint", "truth", own.words] = {"values": place * fine}
            found["lap_joint", "truth", coarse.words] = {"values": place * shares[name] * fine}
    left = trade.own_error(found, {"lap_joint": truth}, 0.01).set_index("source")["left"]
    assert left.to_dict() == pytest.approx({"element size": 1.0, "pairs": 3.4, "path": 1.0})
    found["lap_joint", "truth", trade_versions.ALL_FINER] = {"values": 2 * fine[:16]}
    averaged = trade.averaged(found, "lap_joint", truth)["slip:clamp:lap"]
    mean = np.mean([0.5 * place for place in trade_versions.PLACES])
    assert mean < 0.5 and averaged.to_numpy() == pytest.approx((1.5 + mean) * fine["slip:clamp:lap"][:16].to_numpy())


def test_sampling_error_is_that_of_normal_samples():
    assert trade.sampling_error(500) == pytest.approx(1.96 / np.sqrt(2 * 499), rel=0.01)


def versions(*lines):
    columns = ["error of 6σ", "preparation, s", "per sample, ms"]
    table = pd.DataFrame(lines, columns=columns)
    return table.assign(**{trade.HALF: np.nan, trade.EACH: np.nan}, knob="k", value=[str(i) for i in range(len(lines))])


def test_cheapest_version_keeps_the_target():
    lines = versions((0.2, 1, 1), (0.03, 10, 1), (0.005, 100, 1))
    seconds, line, count, _, estimator = trade.cheapest(lines, 0.10)
    assert estimator == "samples alone"
    assert line["value"] == "1" and seconds == pytest.approx(10 + 1e-3 * count)
    assert line["error of 6σ"] + trade.sampling_error(count) <= 0.10
    assert trade.cheapest(lines, 0.02)[1]["value"] == "2" and trade.cheapest(lines, 0.004) is None
    advice = trade.advice(lines, pd.DataFrame([{"per sample, s": 50.0}]))
    assert "not reached" in trade.in_words(advice) and advice["times cheaper"].max() > 50
    few = lines.assign(**{trade.HALF: [0.01, 0.02, 0.03], trade.EACH: 2.0})  # 500 samples alone: 6.2 %
    seconds, line, count, sampled, estimator = trade.cheapest(few, 0.10)
    assert (line["value"], count, estimator) == ("1", 50, "followed samples with surrogates")
    assert seconds == pytest.approx(10.1) and sampled == 0.02 == pytest.approx(trade.with_surrogates(line)[1] - 0.03)
    assert "50 followed samples with surrogates" in trade.in_words(
        trade.advice(few, pd.DataFrame([{"per sample, s": 9.0}]))
    )


def test_pareto_front_and_settings_that_are_not_on_it():
    assert trade_picture.front(np.array([1, 2, 3, 4, 9]), np.array([0.2, 0.3, 0.1, 0.1, 0.01])) == [0, 2, 4]
    lines = pd.DataFrame(
        [
            ("setting", "draft", 10, 0.05, 0.01),
            ("setting", "standard", 20, 0.02, 0.01),
            ("pairs", "few", 5, 0.01, 0.02),
        ],
        columns=["knob", "value", "seconds", "error", "half"],
    )
    assert trade.dominated(lines) == ["draft by few"]
    assert not trade.dominated(lines.assign(seconds=lines["seconds"].replace(5, 9.5)))  # within the scatter of time


def test_labels_of_the_trade_do_not_overlap():
    """Even of twenty points at one place; as drawn, texts are measured anew."""
    values = [f"size {k}, factor {k / 7:.3g}" for k in range(20)]
    table = pd.DataFrame({"knob": "pairs", "value": values, "seconds": 10.0, "error": 0.02, "half": 0.001})
    figure = trade_picture.picture({"one": table})
    figure.canvas.draw()
    texts = [text for text in figure.axes[0].texts if text.get_text() in values]
    boxes = [Text.get_window_extent(text, figure.canvas.get_renderer()) for text in texts]  # without its line
    assert len(boxes) == 20
    assert not any(boxes[i].overlaps(boxes[j]) for i in range(20) for j in range(i))


@pytest.mark.parametrize("elsewhere, kept", [(0.0, True), (1e-4, False)])
def test_increments_that_approach_another_end_than_the_reference_are_caught(elsewhere, kept):
    """Their error falls with their number, down to the error of the other end."""
    counts = (64, 128, 256, 512)
    cases = (("one", 0.01, 0.0), ("there", 1e-9, 1e-7), ("another", 0.01, elsewhere))
    rows = [(scene, f"{n} increments", np.hypot(way / n, end)) for scene, way, end in cases for n in counts]
    nearing = pd.DataFrame(rows, columns=["scene", "path", "off the judge, median, mm"])
    limit = next(acceptance.limit for acceptance in path.STUDY.acceptance if acceptance.name == "nearing")
    assert (path.fall(nearing, counts) >= limit) == kept
