"""Shapes known at points: splines, best-fitted point clouds, modes and random fields."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, make_smoothing_spline
from scipy.special import k1

import mic
from mic.errors import FormatError, Problems, SceneError
from mic.geometry.deck import UNITS
from mic.geometry.measured_points import Cloud, deviations, read_clouds, spread
from mic.geometry.structured import extrude
from mic.geometry.surface import Surface
from mic.model.random_field import correlation, modes_of
from mic.model.shape import controlling_forces
from mic.model.shape_modes import expand_modes
from mic.model.sources import KnownShape, sources
from mic.statistics.draw import draw

X = np.array([0.0, 7.0, 11.0, 30.0, 42.0, 55.0, 71.0, 80.0, 100.0])  # mm along a beam
RIGIDITY = 3.0e4  # N mm²


def beam(x, y):
    """Compliance of a free beam between points, but for rigid motions: |x − y|³/12EI, the kernel of cubic splines."""
    return np.abs(x[:, None] - y[None]) ** 3 / (12 * RIGIDITY)


def held(x):
    """The same, held at both ends of X, which is where the last two points are; and what points read of motions."""
    rigid = np.column_stack([np.ones(len(x)), x])
    ends = np.array([X[0] - 5, X[-1] + 5])
    Q = rigid @ np.linalg.inv(np.column_stack([np.ones(2), ends]))
    kernel = beam(x, x) - Q @ beam(ends, x) - beam(x, ends) @ Q.T + Q @ beam(ends, ends) @ Q.T
    G = np.zeros((len(x), 6))
    G[:, 2], G[:, 4] = rigid[:, 0], -rigid[:, 1]
    return kernel, G


def known(values, noise=0.0, loose=True):
    values = np.asarray(values, dtype=float)
    return KnownShape(None, values, np.full(len(values), noise), loose)


def curve(f, at):
    """Deflection of the beam at other points under forces f at X, but for a rigid motion."""
    return beam(at, X) @ f


def but_rigid(at, y):
    return y - np.polyval(np.polyfit(at, y, 1), at)


def test_a_loose_beam_through_points_is_the_natural_cubic_spline():
    values = np.array([0.1, 0.3, -0.2, 0.5, 0.4, 0.0, -0.6, 0.2, 0.9])
    C, G = held(X)
    f = controlling_forces(C, G, [known(values)], "S")[:, 0]
    at = np.linspace(0, 100, 41)
    spline = CubicSpline(X, values, bc_type="natural")(at)
    np.testing.assert_allclose(but_rigid(at, curve(f, at)), but_rigid(at, spline), atol=1e-10)
    assert np.abs(G.T @ f).max() < 1e-9 * np.abs(f).max() * 100


def smoothed(values, λ):
    return make_smoothing_spline(X, values, lam=λ * RIGIDITY)


def test_noisy_points_give_the_smoothing_spline_of_least_expected_error():
    rng = np.random.default_rng(3)
    σ = 0.02
    values = 0.3 * np.sin(X / 15) + σ * rng.standard_normal(len(X))
    C, G = held(X)
    f = controlling_forces(C, G, [known(values, noise=σ)], "S")[:, 0]
    motion = np.column_stack([np.ones(len(X)), X])
    miss = values - curve(f, X)
    miss = miss - motion @ np.linalg.lstsq(motion, miss, rcond=None)[0]  # any position of the beam
    λ = float(miss @ f / (f @ f))
    np.testing.assert_allclose(miss, λ * f, atol=1e-10)
    at = np.linspace(0, 100, 41)
    np.testing.assert_allclose(but_rigid(at, curve(f, at)), but_rigid(at, smoothed(values, λ)(at)), atol=1e-8)

    def risk(λ):
        A = np.column_stack([smoothed(unit, λ)(X) for unit in np.eye(len(X))])
        return ((values - A @ values) ** 2).sum() + 2 * σ**2 * np.trace(A)

    assert risk(λ) <= min(risk(1.2 * λ), risk(λ / 1.2), risk(10 * λ), risk(λ / 10))


def test_each_point_is_weighted_by_its_noise():
    C, G = held(X)
    values = 0.3 * np.sin(X / 15)
    values[4] += 0.5
    doubted = np.where(np.arange(len(X)) == 4, 0.5, 0.005)
    one = KnownShape(None, values, doubted, True)
    f = controlling_forces(C, G, [one], "S")[:, 0]
    at = np.delete(X, 4)
    found, true = curve(f, X), 0.3 * np.sin(X / 15)
    shift = np.polyfit(at, np.delete(true - found, 4), 1)
    assert np.abs(found + np.polyval(shift, X) - true).max() < 0.1


def test_a_part_in_its_fixture_has_the_given_values():
    C, G = held(X)
    f = controlling_forces(C, G, [known(0.2 * np.ones(len(X)), loose=False)], "S")[:, 0]
    np.testing.assert_allclose(C @ f, 0.2, rtol=1e-9)
    assert np.abs(controlling_forces(C, G, [known(0.2 * np.ones(len(X)))], "S")).max() < 1e-9 * np.abs(f).max()


def test_coincident_points_are_refused_by_number():
    x = np.append(X, X[3])
    C, G = held(x)
    with pytest.raises(SceneError, match=r"S: points\[(3|9)\] coincides with another point, where"):
        controlling_forces(C, G, [known(np.zeros(len(x)))], "S")


# ---- clouds


@pytest.fixture(scope="module")
def angle():
    """A sheet bent along a line, 120 mm long."""
    return Surface(*extrude([(0, 0), (60, 0), (85, 40)], 0.0, 120.0, 6.0)[:2])


def bumps(points):
    """A deviation along the normals, mm."""
    return 0.4 * np.sin(points[:, 1] / 20) * np.cos(points[:, 0] / 30) + 0.1


def scanned(surface, rng, count=4000, noise=0.0, skin=0.0):
    """Points of a sheet that is off by `bumps`, where, and the deviations."""
    triangle = rng.choice(len(surface.triangles), count, p=surface.areas / surface.areas.sum())
    weight = rng.dirichlet(np.ones(3), count)
    at, n = surface.at(triangle, weight), surface.normals[triangle]
    off = bumps(at)
    return at + (off + skin + noise * rng.standard_normal(count))[:, None] * n, at, off


def test_a_cloud_in_place_gives_the_deviations(angle):
    cloud, at, off = scanned(angle, np.random.default_rng(0))
    found = deviations("a.csv", Cloud(cloud, None), angle, 0.0, False, 5.0)
    inside = np.abs(at[:, 1] - 60) > 3  # a foot near the bend may lie on the other side of it
    inside &= np.linalg.norm(found.points - at, axis=1) < 1e-6
    assert inside.mean() > 0.8
    np.testing.assert_allclose(found.value[inside], off[inside], atol=1e-9)
    assert found.fit.shift == found.fit.turn == 0.0


def test_a_displaced_cloud_is_aligned_by_best_fit(angle):
    rng = np.random.default_rng(1)
    cloud, at, _ = scanned(angle, rng)
    turn = np.deg2rad(1.5)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    there = deviations("a.csv", Cloud(cloud, None), angle, 0.0, True, 5.0)
    moved = deviations("a.csv", Cloud(cloud @ rotation.T + [0.8, -0.5, 1.1], None), angle, 0.0, True, 5.0)
    np.testing.assert_allclose(moved.value, there.value, atol=1e-6)
    assert moved.fit.turn > 0.5 and moved.fit.shift > 0.5


def test_points_on_a_skin_are_corrected_by_half_the_thickness(angle):
    cloud, at, off = scanned(angle, np.random.default_rng(2), skin=0.75)
    found = deviations("a.csv", Cloud(cloud, None), angle, 0.75, False, 5.0)
    assert np.median(np.abs(found.value - off)) < 1e-9


@pytest.mark.parametrize("skin", [0.0, 0.75])
@pytest.mark.parametrize("sign", [1, -1])
def test_points_beside_a_fold_are_trusted_only_on_a_certain_face(angle, skin, sign):
    """One face lies above, the other below."""
    _, at, _ = scanned(angle, np.random.default_rng(3))
    n = angle.normals[angle.project(at).triangle]
    off = sign * np.where(np.abs(n[:, 2]) > 0.9, 0.3, -0.2)
    found = deviations("a.csv", Cloud(at + (off + skin)[:, None] * n, None), angle, skin, False, 5.0)
    wrong = np.abs(found.value - off) > 0.01
    assert wrong.sum() > 3 and not wrong[found.sure].any()
    assert 0.9 < found.sure.mean() < 1.0
    flat = Surface(*extrude([(0, 0), (60, 0)], 0.0, 120.0, 6.0)[:2])
    assert deviations("a.csv", Cloud(scanned(flat, np.random.default_rng(3))[0], None), flat, 0, False, 5.0).sure.all()


def test_a_cloud_of_another_part_is_refused(angle):
    far = np.random.default_rng(0).uniform(200, 300, (500, 3))
    with pytest.raises(FormatError, match=r"door.csv: 500 of 500 points lie more than 5 mm from the part.*correct the"):
        deviations("door.csv", Cloud(far, None), angle, 0.0, False, 5.0)


@pytest.mark.parametrize("read, unit", [("mm", "m"), ("mm", "um"), ("mm", "in"), ("m", "mm"), ("um", "m")])
def test_a_cloud_in_another_unit_is_refused_with_the_likely_unit(angle, read, unit):
    """The points are in `unit` and were read as if in `read`."""
    cloud = scanned(angle, np.random.default_rng(4))[0] * UNITS[read][0] / UNITS[unit][0]
    with pytest.raises(FormatError, match=rf'they span \S+ mm and the part \S+ mm; give unit = "{unit}"'):
        deviations("a.csv", Cloud(cloud, None), angle, 0.0, True, 5.0, read)


def test_spread_points_cover_the_surface(angle):
    chosen = angle.points[spread(angle, 20.0)]
    apart = np.linalg.norm(angle.points[:, None] - chosen[None], axis=2)
    assert apart.min(axis=1).max() <= 20.0
    between = np.linalg.norm(chosen[:, None] - chosen[None], axis=2) + 1e9 * np.eye(len(chosen))
    assert between.min() > 10.0


# ---- random fields


def test_the_correlation_is_that_of_matern():
    side, L = 400.0, 60.0
    plate = Surface(*extrude([(0, 0), (side, 0)], 0.0, side, 12.0)[:2])
    middle = np.array([side / 2, side / 2, 0])
    centre = int(np.argmin(np.linalg.norm(plate.points - middle, axis=1)))
    away = np.linalg.norm(plate.points - plate.points[centre], axis=1)
    some = np.array([int(np.argmin(np.abs(away - r))) for r in (12, 24, 36, 48, 60, 90)])
    ρ = correlation(plate, np.append(centre, some), L)[0]
    r = np.sqrt(8) / L * away[some]
    np.testing.assert_allclose(ρ[1:], r * k1(r), atol=0.01)
    assert ρ[0] == pytest.approx(1.0, abs=1e-12) and (np.sqrt(8) * k1(np.sqrt(8))) == pytest.approx(0.14, abs=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("stretch", [2.5, 0.5])
def test_a_directional_field_has_the_matern_correlation_of_the_stretched_distance(stretch):
    """The direction need not lie in the sheet: what of it does counts."""
    side, L = 480.0, 60.0 / min(1.0, stretch)
    plate = Surface(*extrude([(0, 0), (side, 0)], 0.0, side, 6.0)[:2])
    middle, along = plate.points.mean(axis=0), np.array([0.6, 0.8, 0.0])
    along = along if np.ptp(plate.points[:, 1]) > 0 else along[[0, 2, 1]]
    normal = plate.normals[0]
    nearest = lambda point: int(np.argmin(np.linalg.norm(plate.points - point, axis=1)))
    centre, across = nearest(middle), np.cross(normal, along)
    some = [nearest(middle + r * way) for way in (along, across, along + across) for r in (15, 30, 60)]
    ρ = correlation(plate, np.array([centre, *some]), L, along + 2 * normal, stretch)[0]
    off = plate.points[some] - plate.points[centre]
    r = np.sqrt(8) / L * np.hypot(off @ along / stretch, off @ across)
    np.testing.assert_allclose(ρ[1:], r * k1(r), atol=0.01)
    assert abs(ρ[3] - ρ[6]) > 0.1


def test_modes_preserve_variance_and_correlation(angle):
    R = correlation(angle, spread(angle, 15.0), 120.0)
    Φ = modes_of(R, 0.95)
    np.testing.assert_allclose((Φ**2).sum(axis=1), 1.0)
    assert Φ.shape[1] < len(R) and np.abs(Φ @ Φ.T - R).max() < 2 * 0.05
    np.testing.assert_allclose(modes_of(R, 1 - 1e-14) @ modes_of(R, 1 - 1e-14).T, R, atol=1e-9)


# ---- written out


def write(folder, points, values=None, name="piece.csv", header=None):
    table = points if values is None else np.column_stack([points, values])
    header = header or ("x,y,z" if values is None else "x,y,z,deviation")
    np.savetxt(folder / name, table, delimiter=",", header=header, comments="")


def scene_of(folder, **keys):
    """A scene of one part, with one deviation; enough for its shapes to be written out."""
    base = {"name": "S", "part": "a"}
    kinds = mic.scene.deviation
    kind = {"measured": kinds.MeasuredDeviation, "field": kinds.FieldDeviation}[keys["kind"]]
    items = [kind(**base | keys)]
    part = SimpleNamespace(name="a", thickness=1.5)
    scene = SimpleNamespace(folder=folder, deviations=items, parts=[part], correlations=[])
    scene.monte_carlo = mic.scene.schema.MonteCarlo()
    scene.model_copy = lambda update: SimpleNamespace(**{**scene.__dict__, **update})
    return scene


def expanded(surface, scene):
    """The shapes of a scene on the surface of its part, written out."""
    problems = Problems()
    expanded = expand_modes(scene, {"a": surface}, {"a": None}, problems)
    problems.raise_all()
    return expanded


@pytest.fixture
def pieces(angle, tmp_path):
    """Twelve pieces with two modes, measured at the same thirty points; where, and the values."""
    rng = np.random.default_rng(5)
    at = angle.points[spread(angle, 20.0)]
    modes = np.column_stack([np.sin(at[:, 1] / 25), np.cos(at[:, 0] / 20)])
    values = 0.3 + modes @ (np.array([[0.4], [0.1]]) * rng.standard_normal((2, 12)))
    for i in range(12):
        write(tmp_path, at, values[:, i], f"p{i:02}.csv")
    return tmp_path, at, values


def test_measured_pieces_become_a_mean_and_modes(angle, pieces):
    folder, at, values = pieces
    written = expanded(angle, scene_of(folder, kind="measured", files="p*.csv"))
    mean, *modes = written.scene.deviations
    assert [mean.name, *(item.name for item in modes)] == ["S.mean", "S.1", "S.2"]
    np.testing.assert_allclose(mean.known, values.mean(axis=1), atol=1e-10)
    Φ = np.array([item.known for item in modes]).T
    np.testing.assert_allclose(Φ @ Φ.T, np.cov(values), atol=1e-9)
    assert "12 pieces at" in written.messages[0] and len(written.inputs) == 12


def test_samples_can_be_the_measured_pieces(angle, pieces):
    folder, _, values = pieces
    scene_of_pieces = scene_of(folder, kind="measured", files="p*.csv", pieces=True)
    scene = expanded(angle, scene_of_pieces).scene
    samples = draw(scene, 7, 0, 60)
    shapes = samples @ np.array([item.known for item in scene.deviations])
    nearest = np.abs(shapes[:, None] - values.T[None]).max(axis=2)
    assert nearest.min(axis=1).max() < 1e-9
    assert len(np.unique(nearest.argmin(axis=1))) == 12
    np.testing.assert_array_equal(draw(scene, 7, 40, 20), samples[40:])


def test_few_points_of_one_piece_are_used_directly(angle, pieces):
    folder, at, values = pieces
    written = expanded(angle, scene_of(folder, kind="measured", files="p03.csv", mean=2.0))
    (only,) = written.scene.deviations
    assert (only.name, only.mean, only.sigma) == ("S", 2.0, 0.0)
    np.testing.assert_allclose(only.known, values[:, 3], atol=1e-10)


def test_a_scan_is_averaged_at_spread_points_on_each_side_of_a_bend(angle, tmp_path):
    rng = np.random.default_rng(4)
    cloud, _, _ = scanned(angle, rng, 20000, noise=0.05)
    write(tmp_path, cloud)
    item = {"kind": "measured", "files": "piece.csv", "spacing": 12.0, "noise": 0.05, "align": False}
    (only,) = expanded(angle, scene_of(tmp_path, **item)).scene.deviations
    at, noise = np.array(only.points), np.array(only.noise)
    assert only.radius == 0.0 and 0.05 / 20 < np.median(noise) < 0.05 / 4
    border = angle.border_vertices[np.argmin(np.linalg.norm(at[:, None] - angle.points, axis=2), axis=1)]
    assert np.median(noise[border]) > 1.5 * np.median(noise[~border])  # where points lie on one side alone
    assert (np.abs(at[:, 1] - 60) < 1e-6).any()
    assert np.sqrt(np.mean((only.known - bumps(at)) ** 2)) < 0.05 * 0.4  # a twentieth of the bumps


def test_the_density_of_measured_points_limits_the_spacing(angle, tmp_path):
    """Seven hundred points on the part, on which five thousand would be needed for the usual distance."""
    cloud, _, _ = scanned(angle, np.random.default_rng(6), 700)
    write(tmp_path, cloud)
    keys = {"kind": "measured", "files": "piece.csv"}
    written = expanded(angle, scene_of(tmp_path, **keys))
    (found,) = written.scene.deviations
    assert 30 < len(found.points) < 150 and "; fitted by up to 0." in written.messages[0]
    with pytest.raises(SceneError, match="measured points of every piece within 4.5 mm; give a larger spacing"):
        expanded(angle, scene_of(tmp_path, **keys, spacing=6.0))


@pytest.mark.slow
def test_many_wrong_files_give_one_short_error(angle, tmp_path):
    for i in range(9):
        write(tmp_path, np.random.default_rng(i).uniform(200, 300, (50, 3)), name=f"p{i}.csv")
    with pytest.raises(SceneError) as refused:
        expanded(angle, scene_of(tmp_path, kind="measured", files="p*.csv"))
    lines = str(refused.value).splitlines()
    assert len(lines) == 4 and lines[-1].endswith("files: 6 more files have errors; correct these first")


def test_noise_gives_no_mode(angle, tmp_path):
    """Three modes and their mean, at 135 points of fifteen pieces: found as many, as uncertain as they say."""
    rng = np.random.default_rng(9)
    at = angle.points[spread(angle, 8.0)]
    modes = np.column_stack([np.sin(at[:, 1] / 25), np.cos(at[:, 0] / 20), np.cos(at[:, 1] / 15)])
    scores, noise = rng.standard_normal((15, 3)) * [0.3, 0.15, 0.08], 0.02
    planted = 0.5 + modes @ scores.T
    for i in range(15):
        write(tmp_path, at, planted[:, i] + noise * rng.standard_normal(len(at)), f"p{i:02}.csv")
    keys = {"kind": "measured", "files": "p*.csv", "noise": noise, "share": 0.999}
    written = expanded(angle, scene_of(tmp_path, **keys))
    mean, *found = written.scene.deviations
    assert len(at) > 100 and len(found) == 3
    σ = np.sqrt(sum(np.array(one.known) ** 2 for one in found))
    assert np.sqrt(np.mean((σ - planted.std(axis=1, ddof=1)) ** 2)) < 1.2 * noise / np.sqrt(14)
    assert np.sqrt(np.mean((np.array(mean.known) - planted.mean(axis=1)) ** 2)) < 1.2 * np.mean(mean.noise)
    assert np.mean(mean.noise) <= noise / np.sqrt(15) * (1 + 1e-9)
    assert max(np.max(one.noise) for one in found) <= noise / np.sqrt(14) * (1 + 1e-9)
    assert "the residual scatters by 0.02 mm at a point and is treated as noise" in written.messages[0]
    raw = expanded(angle, scene_of(tmp_path, **keys | {"pieces": True})).scene.deviations
    assert len(raw) == 1 + 14  # as they were measured


def test_samples_of_a_field_have_its_variance_and_correlation(angle):
    scene = expanded(angle, scene_of(None, kind="field", sigma=0.2, length=45.0)).scene
    shapes = draw(scene, 1, 0, 4000) @ np.array([item.known for item in scene.deviations])
    np.testing.assert_allclose(shapes.std(axis=0), 0.2, rtol=0.06)
    R = correlation(angle, spread(angle, 15.0), 45.0)
    assert np.abs(np.corrcoef(shapes.T) - R).max() < 2 * 0.05 + 4 / np.sqrt(4000)  # modes left out, and sampling


def test_messages_name_the_entry_of_the_scene_file(angle, lap_model, tmp_path):
    """Before and after the expansion of a field, and in a model that was saved."""
    scene = scene_of(None, kind="field", sigma=0.2, length=45.0)
    friction = mic.scene.deviation.FrictionDeviation(name="m1", kind="friction", target="z", sigma=0.01)
    scene.deviations = [friction, *scene.deviations, friction.model_copy(update={"name": "m2"})]
    found = expanded(angle, scene).scene
    first, *modes, last = [one.label for one in sources(found)]
    assert first == "deviations[0] (m1)" and last == "deviations[2] (m2)"
    assert modes == [f"deviations[1] (S.{k + 1})" for k in range(len(modes))] and len(modes) > 1
    modes = mic.scene.deviation.DeviationKeys.with_entries(lap_model.scene.deviations, (0, 2, 2))
    model = replace(lap_model, scene=lap_model.scene.model_copy(update={"deviations": modes}))
    model.save(tmp_path / "model.npz")
    again = mic.ReducedModel.load(tmp_path / "model.npz").scene
    assert [one.key for one in sources(again)] == ["deviations[0]", "deviations[2]", "deviations[2]"]


def test_a_field_through_control_points_has_their_sigma_and_correlation(angle):
    at = angle.points[spread(angle, 40.0)]
    values = np.linspace(0.5, 2.0, len(at)).tolist()
    keys = {"kind": "field", "sigma": 0.1, "length": 80.0, "points": at.tolist(), "values": values, "share": 0.999}
    written = expanded(angle, scene_of(None, **keys)).scene
    assert not any(item.loose for item in written.deviations)
    np.testing.assert_allclose(np.array(written.deviations[0].points), at, atol=1e-9)
    Φ = np.array([item.known for item in written.deviations]).T
    σ = 0.1 * np.array(values)
    expected = σ[:, None] * correlation(angle, spread(angle, 40.0), 80.0) * σ
    assert np.abs(Φ @ Φ.T - expected).max() < 2 * 0.001 * σ.max() ** 2
    np.testing.assert_allclose((Φ**2).sum(axis=1), σ**2)


@pytest.mark.parametrize(
    "text",
    [
        "serial,x,y,z,deviation\nA,1,2,3,0.1\nA,4,5,6,0.2\nB,1,2,3,0.3\nB,4,5,6,0.4\n",
        "Point;Nominal X;Nominal Y;Nominal Z;A;B\nP1;1,0;2,0;3,0;0,1;0,3\nP2;4,0;5,0;6,0;0,2;0,4\n",
        "id,X [inch],y,z,i,j,k,A,B\nP1,1/25.4,2,3,0,0,1,0.1,0.3\nP2,4/25.4,5,6,0,0,1,0.2,0.4\n",
    ],
)
def test_one_file_may_hold_several_pieces(text, angle, tmp_path):
    """With their serial numbers in rows, or a column for each."""
    for x in (1, 4):
        text = text.replace(f"{x}/25.4", repr(x / 25.4))
    text = text.replace("X [inch],y,z", "X [inch],y [mm],z [mm]")
    (tmp_path / "report.csv").write_text(text)
    pieces = read_clouds(tmp_path / "report.csv", "mm", angle, None)
    assert {piece: cloud.deviation.tolist() for piece, cloud in pieces.items()} == {"A": [0.1, 0.2], "B": [0.3, 0.4]}
    for cloud in pieces.values():
        np.testing.assert_allclose(cloud.points, [[1, 2, 3], [4, 5, 6]], atol=1e-12)


def test_actual_positions_are_preferred_to_nominal_ones(angle, tmp_path):
    (tmp_path / "report.csv").write_text("x,y,z,X actual,Y actual,Z actual,deviation\n1,2,3,1.1,2.1,3.1,0.17\n")
    (cloud,) = read_clouds(tmp_path / "report.csv", "mm", angle, None).values()
    assert cloud.points.tolist() == [[1.1, 2.1, 3.1]] and cloud.deviation is None


BAD_FILES = {
    "no column": ("x,y,deviation\n1,2,3\n", r"row 1: column z is missing; give x, y, z"),
    "text": ("x,y,z\n1,2,three\n", r"row 2: z is 'three'; give a number"),
    "empty": ("", r"row 1: the header is missing"),
    "header only": ("x,y,z\n", r"no rows below the header"),
    "nan": ("x,y,z,deviation\n1,2,3,nan\n", r"row 2: deviation is 'nan'"),
    "twice": ("x,y,z,z\n1,2,3,4\n", r"row 1: column 'z' is given twice"),
    "ragged": ("x,y,z\n1,2,3\n1,2\n", r"row 3 has 2 cells separated by commas, and the header 3"),
    "nodes of none": ("node,deviation\n7,0.1\n", r"the mesh of the part has no node numbers; give x, y, z"),
    "another unit": ("x,y,z\n" + "\n".join(f"{x / 25.4},{x / 50},0" for x in range(900, 4000, 10)), "points lie more"),
    "few points": ("x,y,z,deviation\n0,0,0,0\n10,0,0,0\n", r"2 measured points do not determine a shape"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_malformed_file_of_points_is_refused_with_the_remedy(case, angle, tmp_path):
    text, message = BAD_FILES[case]
    (tmp_path / "piece.csv").write_text(text)
    scene = scene_of(tmp_path, kind="measured", files="piece.csv", align=False)
    with pytest.raises(SceneError, match=message) as refused:
        expanded(angle, scene)
    assert str(refused.value).startswith("deviations[0] (S)") and "\n" not in str(refused.value)


def test_nodes_are_found_by_their_numbers(angle, tmp_path):
    deck = SimpleNamespace(nodes=np.array([7, 9, 30]), node_points=np.array([0, 4, -1]))
    (tmp_path / "n.csv").write_text("node;deviation\n9;0.25\n7;-0.5\n")
    (cloud,) = read_clouds(tmp_path / "n.csv", "mm", angle, deck).values()
    np.testing.assert_array_equal(cloud.points, angle.points[[4, 0]])
    np.testing.assert_array_equal(cloud.deviation, [0.25, -0.5])
    (tmp_path / "n.csv").write_text("node,S1,S2\n9,0.25,0.5\n7,-0.5,\n")
    pieces = read_clouds(tmp_path / "n.csv", "mm", angle, deck)
    assert {piece: cloud.deviation.tolist() for piece, cloud in pieces.items()} == {"S1": [0.25, -0.5], "S2": [0.5]}
    (tmp_path / "n.csv").write_text("node,deviation\n30,0.25\n")
    with pytest.raises(FormatError, match=r"row 2: the part has no node 30 on its surface; remove"):
        read_clouds(tmp_path / "n.csv", "mm", angle, deck)


FIELD = {"kind": "field", "sigma": 1.0, "length": 90.0}
BAD_ITEMS = {
    "nothing there": ({"kind": "measured", "files": "none-*.csv"}, r"files: there is no file 'none-\*.csv'"),
    "no reader": ({"kind": "measured", "files": "p00.pdf"}, r"measured points cannot be read from .pdf"),
    "too fine": ({"kind": "measured", "files": "p00.csv", "spacing": 1.0}, "spacing: 1 mm needs more than 400"),
    "few": ({"kind": "measured", "files": "p00.csv", "spacing": 15.0}, r"only \d+ % of part 'a' has 6 measured"),
    "twice": ({"kind": "measured", "files": "q*.csv"}, r"q1.csv and q0.csv have the same content; remove one"),
    "a short field": (FIELD | {"length": 10.0}, r"length: 10 mm is less than 4 elements"),
    "twice in one place": (FIELD | {"points": [[0, 10, 10], [0, 10, 10.01]]}, r"points\[1\] lies within an element of"),
    "too many points": (
        FIELD | {"points": [[0, 0.1 * k, 0] for k in range(500)]},
        "points: 500 are more than 400; give",
    ),
    "shortened too much": (FIELD | {"direction": [0, 1, 0], "stretch": 0.1}, "length: 9 mm is less than 4 elements"),
    "a long name": (FIELD | {"name": "n" * 55}, "name: it is too long to number"),
}


@pytest.mark.parametrize("case", BAD_ITEMS)
def test_invalid_shapes_are_refused_with_the_remedy(case, angle, pieces):
    keys, message = BAD_ITEMS[case]
    folder, at, values = pieces
    (folder / "p00.pdf").write_text("x")
    for name in ("q0.csv", "q1.csv"):
        write(folder, at, values[:, 0], name)
    with pytest.raises(SceneError, match=message):
        expanded(angle, scene_of(folder, **keys))


MEASURED = {"kind": "measured", "files": "a.csv"}
SHAPE = {"kind": "shape", "points": [[0, 0, 0]]}
BAD_KEYS = [
    (SHAPE | {"values": [1, 2], "sigma": 1}, "there are 1 points and 2 values"),
    (SHAPE | {"loose": True, "sigma": 1}, "loose takes more than six points"),
    ({"kind": "shape", "points": [[0, 0, 0]]}, "sigma"),
    (MEASURED | {"share": 0}, "share"),
    (MEASURED | {"unit": "miles"}, "unit"),
    (MEASURED | {"distribution": "gama"}, "did you mean 'gamma'"),
    (MEASURED | {"truncated": [-1, 1]}, "truncated: not possible for several modes"),
    ({"kind": "field", "sigma": 0, "length": 9}, "sigma"),
    (FIELD | {"mean": 1}, "mean"),
    (FIELD | {"direction": [1, 0, 0]}, "direction and stretch belong together"),
    (FIELD | {"direction": [0, 0, 0], "stretch": 2}, "must not be zero"),
    (FIELD | {"direction": "x", "stretch": 2}, "direction"),
    (FIELD | {"values": [1]}, "values need points"),
    (FIELD | {"points": [[0, 0, 0]], "values": [1, 2]}, "1 points and 2 values"),
    (FIELD | {"points": [[0, 0, 0]], "values": [0]}, "values"),
]


@pytest.mark.parametrize("item, message", BAD_KEYS)
def test_wrong_keys_are_refused_by_name(item, message):
    table = mic.load_scene("meshes/lap_joint").model_dump()
    table["deviations"] = [{"name": "S", "part": "upper"} | item]
    with pytest.raises(ValueError, match=message):
        mic.Scene(**table)
