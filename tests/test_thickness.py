"""Sheets of varying thickness: interpolation, faces, closed forms and refused input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.deviated import lap_joint, read

import mic
from mic.compliance.cache import influence_coefficients, is_cached
from mic.compliance.functional import Functionals
from mic.compliance.part import Part
from mic.compliance.thickness import ERROR, Thicknesses, chebyshev
from mic.model.assembly import assemble
from mic.model.one_sigma import one_sigma
from mic.model.shape import thickening
from mic.model.sources import sources, thickness_ranges, with_deviations
from mic.process.model import ReducedModel
from mic.studies import thickness
from mic.studies.sensitivity import effects
from mic.studies.thickness import interpolation_errors

T = {"name": "T", "kind": "thickness", "part": "upper", "sigma": 0.02}
FORCE = {"name": "F", "kind": "force", "part": "upper", "point": [65, 20, 1], "mean": -5.0, "sigma": 1.5}


def sheet(t, λ, ℓ0, ℓ1):
    """H of equation (1) of :mod:`mic.compliance.thickness`."""
    ℓ = ℓ0 + t * ℓ1
    return (ℓ * (t**2 / (t**2 + λ))) @ ℓ.T / t**3


@pytest.mark.parametrize("half", [0.02, 0.5])
def test_the_interpolation_meets_its_tolerance(half):
    """For sheets dominated by bending, by stretching and by both; the tolerance is one of energy."""
    rng = np.random.default_rng(3)
    λ = np.concatenate([[0.0], 10.0 ** rng.uniform(-3, 3, 40), [1e9]])
    ℓ0, ℓ1 = rng.standard_normal((2, 12, len(λ)))
    low, high = 0.8 * (1 - half), 0.8 * (1 + half)
    nodes = np.array(chebyshev(low, high))
    assert len(nodes) % 2 == 1 and nodes[len(nodes) // 2] == 0.5 * (low + high) and (np.diff(nodes) > 0).all()
    assert low < nodes[0] and nodes[-1] < high
    G = np.array([np.outer(1.0 + t * np.arange(12), np.ones(6)) for t in nodes])
    known = Thicknesses(nodes, low, high, np.array([sheet(t, λ, ℓ0, ℓ1) for t in nodes]), G)
    for t in np.linspace(low, high, 7):
        exact = sheet(t, λ, ℓ0, ℓ1)
        H, rigid = known.at(t)
        root = np.linalg.cholesky(np.linalg.inv(exact))
        energy = np.linalg.eigvalsh(root.T @ H @ root)
        assert np.abs(energy - 1).max() < 100 * ERROR
        np.testing.assert_allclose(rigid, np.outer(1.0 + t * np.arange(12), np.ones(6)), rtol=1e-9)


def test_a_thickness_out_of_range_is_refused():
    known = Thicknesses(np.array([1.0]), 0.9, 1.1, np.ones((1, 1, 1)), np.ones((1, 1, 6)))
    known.at(1.1)
    for t in (0.85, 1.12):
        with pytest.raises(mic.errors.ImpossibleSample, match="lies beyond 0.9 to 1.1 mm"):
            known.at(t)


def test_functionals_on_a_face_move_with_it():
    side = np.array([0.0, 1.0, -1.0, 1.4, -1.4])
    rows = Functionals((), np.zeros(5, int), np.zeros((5, 3)), np.zeros(5, bool), side, ("",) * 5)
    part = Part("p", None, 2.0, 1.0, 0.3, "e", rows, thickness_range=(1.0, 3.0)).at(2.5)
    np.testing.assert_allclose(part.functionals.side * part.thickness / 2, [0, 1.25, -1.25, 1.65, -1.65])
    assert part.thickness_range is None and part.functionals.side[1] == 1.0


@pytest.fixture(scope="module")
def assembled(cache):
    """With candidates, and a lower sheet of 0.8 mm."""
    table = lap_joint([T])
    table["zones"][0].pop("pairs")
    table["parts"][0]["thickness"] = 0.8
    return assemble(read(table), cache)


@pytest.mark.parametrize(
    "part, skin, change",
    [("upper", 0, -0.5), ("lower", 0, -0.5), ("upper", 1, -1), ("upper", -1, 0), ("lower", 1, 0), ("lower", -1, -1)],
)
def test_gaps_change_with_the_faces(assembled, part, skin, change):
    """The lap joint's normals are upwards; the lower face of the upper sheet lies on the upper face of the lower."""
    p = [one.name for one in assembled.parts].index(part)
    assert (assembled.parts[p].surface.normals[:, 2] > 0.99).all()
    faces = np.zeros(assembled.offsets[-1])
    faces[assembled.offsets[p] : assembled.offsets[p + 1]] = thickening(assembled, p, skin)
    rows, d = assembled.rows, assembled.contacts.dimension
    first = [0, assembled.weld_size[0]]
    gaps = np.concatenate([rows["contact"][::d] @ faces, rows["between"] @ faces, (rows["weld"] @ faces)[first]])
    assert len(gaps) > 10 and (gaps == change).all()
    for kind in ("locator", "clamp", "force", "measurement"):
        assert not (rows[kind] @ faces).any()


def test_the_compliance_through_the_sheets_follows_their_thickness(assembled):
    """It is ``(t_a + t_b)/2 / (E A)`` for candidates; nothing else of the contacts changes."""
    before, after = assembled.contacts, with_deviations(assembled, np.array([0.06])).contacts
    assert before.watched.all() and len(before) > 20
    np.testing.assert_allclose(before.layer, 1.8 / 2 / (210e3 * before.area))
    np.testing.assert_allclose(after.layer, 1.86 / 2 / (210e3 * before.area))
    assert replace(after, layer=before.layer).gap is before.gap and (after.friction == before.friction).all()
    assert with_deviations(assembled, np.array([0.0])) is assembled


@pytest.mark.fem
def test_a_lap_sags_with_its_weight_as_a_plate_does(cache):
    """Between supports its sag is of q/D, with q of t and D of t³; its derivative is −2 sag/t."""
    change = {"welds": [], "clamps": [], "zones": [], "stages": [{"kind": "locate"}, {"kind": "measure"}]}
    model = mic.reduce(read(lap_joint([{"name": "g", "kind": "gravity"}, T | {"sigma": 0.03}], **change)), cache)
    sag = model.evaluate({}).measurements[0]
    assert np.abs(sag).min() > 1e-5
    for more in (-0.15, 0.01, 0.15):
        found = model.evaluate({"T": more}).measurements[0]
        np.testing.assert_allclose(found, sag / (1 + more) ** 2, rtol=1e-6)
    slope = model.sensitivities({"T": 0.1}).jacobian[0, :, 1]
    np.testing.assert_allclose(slope, -2 * sag / 1.1**3, rtol=1e-6)


@pytest.fixture(scope="module")
def varied(cache):
    scene = read(lap_joint([FORCE, T]))
    return assemble(scene, cache), mic.reduce(scene, cache)


@pytest.mark.fem
def test_a_scene_drawn_with_the_thinner_sheet_gives_the_same_result(cache):
    """Measured in its clamps, for welds stand elsewhere where a gap is drawn."""
    change = {"welds": [], "stages": [{"kind": "locate"}, {"kind": "clamp", "increments": 1}, {"kind": "measure"}]}
    table = lap_joint([], **change)
    table["parts"][1]["thickness"] = 0.9
    thin = mic.reduce(read(table), cache).evaluate({})
    model = mic.reduce(read(lap_joint([T], **change)), cache)
    drawn, found = model.evaluate({}), model.evaluate({"T": -0.1})
    assert np.abs(thin.measurements - drawn.measurements).max() > 0.005
    np.testing.assert_allclose(found.measurements, thin.measurements, atol=1e-7)
    force = thin.resolutions["clamp"].force
    np.testing.assert_allclose(found.resolutions["clamp"].force, force, atol=1e-5 * np.abs(force).max())


@pytest.mark.fem
def test_batches_and_saved_models_agree_and_one_impossible_sample_fails(varied, tmp_path):
    _, model = varied
    samples = np.array([[-5.0, 0.0], [-4.0, 0.03], [-4.0, 0.5], [-6.0, -0.05]])
    found = model.process().attempt(samples)
    assert found.failed.tolist() == [False, False, True, False]
    assert "lies beyond 0.88 to 1.12 mm" in found.resolutions["clamp"].status[2]
    model.save(tmp_path / "model.npz")
    again = ReducedModel.load(tmp_path / "model.npz")
    for i in (0, 1, 3):
        np.testing.assert_array_equal(again.evaluate(samples[i]).measurements[0], found.measurements[i])
    assert np.abs(found.measurements[1] - model.evaluate([-4.0, 0.0]).measurements).max() > 1e-3


@pytest.mark.fem
def test_derivatives_equal_finite_differences(varied):
    """Other derivatives are unchanged by a thickness, which has no reach."""
    _, model = varied
    at, step = np.array([-5.0, 0.02]), 1e-3
    found = model.sensitivities(at)
    for i in range(2):
        move = step * np.eye(2)[i]
        between = (model.evaluate(at + move).measurements - model.evaluate(at - move).measurements)[0] / (2 * step)
        np.testing.assert_allclose(found.jacobian[0, :, i], between, rtol=2e-4, atol=1e-6)
        assert np.abs(between).max() > 0.01
    assert np.isnan(found.reach_along[0, 1]) and np.isfinite(found.reach_along[0, 0]) and np.isfinite(found.reach[0])
    more, less = (model.evaluate(at + [0, move]).resolutions["clamp"].force for move in (step, -step))
    force = (more - less) / (2 * step)
    np.testing.assert_allclose(found.contacts["clamp"].force_slope[..., 1], force, atol=1e-3 * np.abs(force).max())


@pytest.mark.fem
def test_the_error_of_the_interpolation_is_reported(varied, cache, monkeypatch):
    """It grows with fewer thicknesses where the sheet bends and stretches."""
    assembly, model = varied
    (one,) = interpolation_errors(assembly, model, cache)
    assert (one.name, one.part) == ("T", "upper") and one.thickness == pytest.approx((0.94, 1.06))
    assert np.abs(one.error).max() < 1e-7 and np.abs(one.change).max() > 0.005
    known = model.thicknesses["upper"]
    two = Thicknesses(known.t[::4], known.low, known.high, known.H[::4], known.G[::4])
    (bad,) = interpolation_errors(assembly, replace(model, thicknesses={"upper": two}), cache)
    assert np.abs(bad.error).max() > 1e-5
    assert thickness.DISTANCE == 3.0


@pytest.mark.fem
def test_coefficients_are_cached_at_every_thickness_or_not_at_all(varied, cache):
    assembly, _ = varied
    (lower, upper), lines = assembly.parts, []
    assert is_cached(upper, cache) and lower.thickness_range is None
    assert upper.thickness_range == pytest.approx((0.88, 1.12))
    wider = replace(assembly, parts=(lower, replace(upper, thickness_range=(0.8, 1.2))))
    assert not is_cached(wider.parts[1], cache)
    found, cached = influence_coefficients(wider, cache, lines.append)
    assert cached == {"lower": True, "upper": False} and all("upper at" in line for line in lines)
    assert len(lines) == len(found["upper"].thicknesses.t) - 1 and found["lower"].thicknesses is None


@pytest.mark.fem
def test_studies_accept_a_varying_thickness(varied):
    assembly, model = varied
    found = effects(model, samples=1).table.set_index(["measurement", "input"])
    assert found.loc[("M1", "T"), "step"] == 0.02 and abs(found.loc[("M1", "T"), "effect"]) > 1e-4
    shape = {one.name: one for one in one_sigma(assembly, model)}["T"]
    assert list(shape.fields) == ["upper"] and shape.largest[2] == pytest.approx(0.01)


BAD = {
    "of no part": ({"part": "roof"}, "no part called 'roof'"),
    "of parts": ({"part": ["upper", "lower"]}, "part"),
    "without spread": ({"sigma": None}, r"sigma \(T\): required key is missing"),
    "in micrometres": ({"sigma": 20.0}, r"lead from -119 to 121 mm, and part 'upper' is 1 mm thick.*all in mm"),
    "a sheet that is not there": ({"mean": -0.9}, "lead from -0.02 to 0.22 mm"),
    "a face of no name": ({"skin": "top"}, "skin"),
    "another key": ({"target": "upper"}, r"target \(T\): unknown key"),
    "no such distribution": ({"distribution": "gauss"}, "no continuous distribution 'gauss'"),
    "nothing within": ({"truncated": [0.5, 0.6]}, "less than 1e-06 of the distribution lies between"),
}


def retained(table):
    """Reads a scene, and does with its deviations what comes before anything is meshed."""
    for source in sources(read(table)):
        source.retain(None)


@pytest.mark.parametrize("case", BAD)
def test_invalid_thickness_deviations_are_refused_with_the_remedy(case):
    change, message = BAD[case]
    item = {key: value for key, value in (T | change).items() if value is not None}
    with pytest.raises(mic.SceneError, match=message):
        retained(lap_joint([item]))


def test_two_thickness_deviations_of_one_sheet_and_fields_are_refused():
    with pytest.raises(mic.SceneError, match=r"\(U\): the thickness of 'upper' is varied by 'T' already; merge"):
        retained(lap_joint([T, T | {"name": "U"}]))
    with pytest.raises(mic.SceneError, match=r"T\): fields are computed at the nominal thickness .* leave fields out"):
        retained(lap_joint([T], report={"fields": True}))


@pytest.mark.parametrize("key", ["stiffness", "compliance"])
def test_a_varying_thickness_is_refused_for_a_given_matrix(key):
    table = lap_joint([T])
    table["parts"][1] = {"name": "upper", "mesh": "upper.inp", "thickness": 1.0, key: "upper.mtx"}
    table["parts"][1] |= {"young": 210e3, "poisson": 0.3}
    with pytest.raises(mic.SceneError, match=rf"\(T\): part: 'upper' has its {key} from a file, which holds for one"):
        retained(table)


def test_the_range_of_thickness_follows_from_truncation_and_tables():
    of = lambda table: thickness_ranges(read(table))["upper"]
    assert of(lap_joint([T | {"sigma": 0.2, "truncated": [-0.1, 0.1]}])) == pytest.approx((0.9, 1.1))
    assert of(lap_joint([T], monte_carlo={"values": [[0.3], [-0.02]]})) == pytest.approx((0.88, 1.3))
    assert of(lap_joint([T | {"sigma": 0.0, "mean": 0.2}])) == pytest.approx((1.19, 1.21))
    with pytest.raises(mic.SceneError, match=r"the samples of the table lead from 1.98 to 2.02 mm, and part 'upper'"):
        retained(lap_joint([T], monte_carlo={"values": [[1.02], [0.98]]}))  # the thickness itself
