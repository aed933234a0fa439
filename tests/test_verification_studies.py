"""The studies of algebra, law, mesh, nominal stiffness and trade: their calculations, and planted errors."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.sparse import csr_matrix, diags

from mic.model.assembly import assemble
from mic.scene import SETTINGS
from mic.statistics.draw import draw
from verification.algebra.study import STUDY as ALGEBRA
from verification.algebra.study import compare
from verification.comparison import reduced_and_assembly, relative, zone_slip
from verification.curved_sheets import study as curved_sheets
from verification.law import study as law
from verification.mesh import study as mesh
from verification.mesh.study import converge
from verification.nominal_stiffness import study as nominal
from verification.path import study as path
from verification.scenes import shipped, with_path
from verification.study import Context, Team
from verification.trade import study as trade

pytestmark = pytest.mark.fem

AUGMENTED = next(a.limit for a in ALGEBRA.acceptance if a.name == "augmented")


@pytest.fixture(scope="module")
def lap(cache):
    return reduced_and_assembly(shipped("lap_joint", "coarse", ("coulomb", "frictionless", "associated")), cache)


def scaled(model, factor):
    """All compliances multiplied by a factor."""
    return replace(model, compliance=replace(model.compliance, H=tuple(factor * H for H in model.compliance.H)))


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
    "friction ignored": lambda model: replace(
        model, contacts=replace(model.contacts, friction=0 * model.contacts.friction)
    ),
    "weld forgotten": weld_forgotten,
    "thickness doubled": lambda model: replace(scaled(model, 1 / 8), shape=model.shape / 8),
    "gap off by 0.1 µm": lambda model: replace(model, contacts=replace(model.contacts, gap=model.contacts.gap + 1e-4)),
}


def largest(rows):
    return max(max(row[key] for key in ("force", "displacement", "measurement")) for row in rows if row["ε/k"] is None)


@pytest.mark.slow
def test_algebra_agrees_and_its_penalty_error_is_of_first_order(lap):
    rows = compare(*lap, "coulomb", 0, (1e3, 1e5))
    errors = [row["force"] for row in rows[:2]]
    assert np.log10(errors[0] / errors[1]) / 2 == pytest.approx(1, abs=0.02), errors
    assert largest(rows) < AUGMENTED and all(row["changed states"] == 0 for row in rows)
    assert rows[-1]["residual of the full solve"] < 1e-9


@pytest.mark.parametrize("error", PLANTED)
def test_algebra_catches(lap, error):
    model, assembly = lap
    found = largest(compare(PLANTED[error](model), assembly, "coulomb", 0, ()))
    assert found > 1e4 * AUGMENTED, found


def test_relative_difference():
    assert (
        relative([1.0, 2.0], [1.0, 2.5]) == pytest.approx(0.2)
        and relative([0.0], [0.0]) == 0
        and relative([1.0], [0.0]) == np.inf
    )
    assert relative([-1.0], [1.0]) == 2  # a wrong sign is not a small error


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
    assert (
        associated["gap at loaded contacts, mm"] > 1e-3 and associated["force"] > 0.1 and associated["identity"] < 1e-6
    )
    assert (
        itself["gap at loaded contacts, mm"] < 1e-9 and itself["force"] == 0
    )  # were (13) Coulomb's law, `opening` would fail
    without = law.compare(model, deviations, "frictionless")
    assert without["force when clamped"] == pytest.approx(0.4, rel=0.01)  # the friction force itself is missing
    assert without["force"] > 0.99 * 0.4  # released, normal forces beside the nuggets change by more: 2.3 of 4.2 N


def test_law_is_judged_by_finite_elements_with_the_same_friction(at_once):
    assert law.against_full(at_once, 0.1) < 1e-8
    model, assembly = at_once
    assert law.against_full((scaled(model, 1.01), assembly), 0.1) > 1e-4


@pytest.mark.parametrize(
    "name, keys, field",
    [
        ("pressure-dependent", law.FUNCTIONS["table"], "pressure"),
        ("pressure-dependent", law.FUNCTIONS["falling power"], "pressure"),
        ("micro-slip", {"tangential_stiffness": 1e3}, "compliance"),
        ("coulomb", {"friction": law.BY_STAGE["falling"]}, "friction"),
    ],
    ids=["table", "power", "stiffness", "falling by stage"],
)
@pytest.mark.slow
def test_the_study_of_laws_detects_a_wrong_function_stiffness_or_stage(name, keys, field, cache):
    """The full solve disagrees with a reduced model whose friction is a tenth too large."""
    model, assembly = law.variant(keys, cache)
    right = law.solved_both_ways((model, assembly), name)
    assert max(right["force"], right["displacement"], right["measurement"]) < 1e-8 and right["slipping"]
    wrong = getattr(model.contacts, field).copy()
    if field == "pressure":
        wrong[..., 1:4] *= 1.1  # α, β and γ of every piece, and so μ
    elif field == "friction":
        wrong[-1] *= 1.1  # of all stages but the clamping
    else:
        wrong *= 1.1
    planted = replace(model, contacts=replace(model.contacts, **{field: wrong}))
    found = law.solved_both_ways((planted, assembly), name)
    assert max(found["force"], found["displacement"], found["measurement"]) > 1e-4


@pytest.mark.parametrize("order, sizes", [(1.0, (4, 2, 1)), (2.0, (4, 2, 1)), (2.0, (5, 3, 2)), (1.5, (9.5, 6.0, 4.1))])
def test_order_and_limit_of_a_manufactured_sequence(order, sizes):
    h = np.array(sizes, dtype=float)
    found = converge(h, 7.0 + 0.3 * h**order)
    assert found.order == pytest.approx(order, rel=1e-6) and found.extrapolated == pytest.approx(7.0, rel=1e-9)
    assert found.index >= 0.3 * h[2] ** order and found.kind == "monotone"  # the band holds the limit


def test_mesh_sequences_without_an_order():
    oscillating = converge((4, 2, 1), (1.0, 1.3, 1.2))
    assert (
        oscillating.kind == "oscillating"
        and oscillating.index == pytest.approx(0.3)
        and oscillating.extrapolated == 1.2
    )
    assert converge((4, 2, 1), (1.1, 1.0, 1.0)).index == pytest.approx(0, abs=1e-12)
    assert converge((4, 2, 1), (1.0, 2.0, 4.0)).index > 4  # it diverges, and the band says so


def test_contact_pairs_read_the_same_on_all_meshes(cache):
    """Cells that are divided anew on each mesh stand elsewhere, and are larger or smaller by some hundredths."""
    first, *held = [shipped("lap_joint", size) for size in (2.5, 2.5, 1.25)]
    pairs = assemble(first, cache).contacts
    discs = [assemble(mesh.same_discs(scene, pairs), cache) for scene in held]
    coarse, fine = (made.contacts for made in discs)
    assert np.abs(coarse.point - fine.point).max() < 2e-3 and coarse.bearing == pytest.approx(fine.bearing, rel=1e-12)
    assert coarse.bearing.sum() == pytest.approx(pairs.area.sum(), rel=1e-9)


def test_meshes_whose_elements_are_divided_at_nuggets_are_no_series(cache):
    pairs = assemble(shipped("lap_joint", 2.5), cache).contacts
    with pytest.raises(RuntimeError, match="divided at nuggets"):
        mesh.on_mesh(SimpleNamespace(cache=cache), "lap_joint", 2.5, 2, pairs)


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
    """The study's quick version keeps its limits, but for two of the panel; with the triangles' own normals none is."""
    context = Context(quick=True, cache=tmp_path, team=Team())
    monkeypatch.setattr(curved_sheets, "CASES", curved_sheets.JUDGED)
    monkeypatch.setattr(curved_sheets, "KINDS", dict(list(curved_sheets.KINDS.items())[1:]))
    missed = {judged.acceptance.name for judged in curved_sheets.STUDY.evaluate(context) if not judged.passed}
    assert missed == {"panel 5 mm", "panel 2.5 mm"}
    flat = ("dkt-opt", "mesh")
    monkeypatch.setattr(curved_sheets, "KINDS", {"own normals": flat})
    broken = {judged.acceptance.name for judged in curved_sheets.STUDY.evaluate(context) if not judged.passed}
    assert broken == {name for name, *_ in curved_sheets.JUDGED}


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
    exact = (
        part.young
        * part.thickness
        / (1 - part.poisson**2)
        / 2
        * width
        * 0.25
        * (2 * c) ** 4
        * 2
        * (length / 2) ** 5
        / 5
    )
    assert bound(c * x**2) == pytest.approx(exact, rel=0.01)
    assert bound(0.1 * x) < 1e-12 * exact


def test_the_stiffness_of_the_mean_shape_and_its_derivatives(cache, monkeypatch):
    """With shapes that scatter by a quarter of their mean, it halves the nominal error, and derivatives remove most."""
    built = reduced_and_assembly(with_path(shipped("lap_joint", "coarse"), "increments", 1), cache)

    def left():
        means = pd.DataFrame([{"assembly": "lap_joint"} | row for row in nominal.systematic(built, 1.0, 3, cache)])
        return [nominal.ratios(means, name).max(axis=None) for name in ("mean", "first order")]

    right = nominal.followed

    def planted(assembly, stiffness, mean, sigma, cache):
        """Use the nominal shape instead of the mean one, and derivatives of the wrong sign."""
        if stiffness == "mean":
            return right(assembly, stiffness, 0 * mean, sigma, cache)
        model = right(assembly, stiffness, mean, sigma, cache)
        own = model.slopes
        back = replace(
            own, H=tuple(-H for H in own.H), G=tuple(-G for G in own.G), gap=-own.gap, weld_gap=-own.weld_gap
        )
        return replace(model, slopes=back)

    mean, first = left()
    assert mean < 0.75 and first < 0.1
    monkeypatch.setattr(nominal, "followed", planted)
    mean, first = left()
    assert mean == pytest.approx(1.0, abs=1e-6) and first > 0.5


def test_settings_reach_the_trade():
    versions = trade.versions_of("lap_joint", trade.QUICK["lap_joint"])
    for setting, given in SETTINGS.items():
        scene = versions["setting", setting]
        assert {part.size for part in scene.parts} == {given["size"]} and scene.path.tolerance == given["tolerance"]
        assert all(zone.candidates and zone.spacing_factor == given["spacing_factor"] for zone in scene.zones)
    assert versions["path", "increments 1"].stages[1].increments == 1
    assert versions["pairs", "pairs 34"].zones[0].pairs == 34
    exact = versions["truth", "all finer"]
    assert exact.parts[0].size == 0.625 and exact.path.tolerance == trade.FINE
    assert exact.zones[0].spacing_factor < SETTINGS["reference"]["spacing_factor"]


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
    lines = pd.DataFrame([{"scene": "lap_joint", "knob": "truth", "value": "but path"} | found])
    left = trade.own_error(lines, trade.QUICK).iloc[0]
    assert left["left of key characteristics"] == pytest.approx(0.04 / 5)


def test_sampling_error_is_that_of_normal_samples():
    assert trade.sampling_error(500) == pytest.approx(1.96 / np.sqrt(2 * 499), rel=0.01)


def versions(*lines):
    return pd.DataFrame(
        [
            {"knob": "k", "value": str(i), "error of 6σ": e, "preparation, s": p, "per sample, ms": ms}
            for i, (e, p, ms) in enumerate(lines)
        ]
    )


def test_cheapest_version_keeps_the_target():
    lines = versions((0.2, 1, 1), (0.03, 10, 1), (0.005, 100, 1))
    seconds, line, count = trade.cheapest(lines, 0.10)
    assert (
        line["value"] == "1"
        and line["error of 6σ"] + trade.sampling_error(count) <= 0.10
        and seconds == pytest.approx(10 + 1e-3 * count)
    )
    assert trade.cheapest(lines, 0.02)[1]["value"] == "2" and trade.cheapest(lines, 0.004) is None
    told = trade.advice(lines, pd.DataFrame([{"per sample, s": 50.0}]))
    assert "not reached" in trade.in_words(told) and told["times cheaper"].max() > 50


def test_pareto_front():
    lines = versions((0.2, 1, 0), (0.3, 2, 0), (0.1, 3, 0), (0.1, 4, 0), (0.01, 9, 0))
    assert trade.front(lines, 100) == [0, 2, 4]


@pytest.mark.parametrize("elsewhere, kept", [(0.0, True), (1e-4, False)])
def test_increments_that_near_another_end_than_the_judge_are_caught(elsewhere, kept):
    """Their error falls with their number, down to the error of the other end."""
    counts = (64, 128, 256, 512)
    nearing = pd.DataFrame(
        [
            {"scene": scene, "path": f"{count} increments", "off the judge, median, mm": np.hypot(way / count, end)}
            for scene, way, end in (("one", 0.01, 0.0), ("there", 1e-9, 1e-7), ("another", 0.01, elsewhere))
            for count in counts
        ]
    )
    limit = next(acceptance.limit for acceptance in path.STUDY.acceptance if acceptance.name == "nearing")
    assert (path.fall(nearing, counts) >= limit) == kept
