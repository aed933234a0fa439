"""Scans are placed on a nominal sheet, and their shapes are found: against shapes and motions that made the scans."""

import numpy as np
import pytest
from support.scans import scanned

from mic.errors import FormatError
from mic.geometry.measured_points import read_clouds
from mic.geometry.registration import Shapes, place, register
from mic.geometry.structured import extrude
from mic.geometry.surface import Surface


def angle(size=4.0):
    """An unequal angle, 60 by 35 mm, and 90 mm long."""
    points, triangles = extrude([(0, 0), (60, 0), (60, 35)], 0.0, 90.0, size)[:2]
    return Surface(points, triangles)


def bent(surface, known=True):
    """Shapes of the angle: bent and twisted, with standard deviations of 0.5 mm."""
    x, n = surface.points, surface.vertex_normals
    u = (x - surface.centroid) / surface.diameter
    fields = np.stack([4 * u[:, :1] ** 2 * n, 4 * u[:, :1] * u[:, 1:2] * n], axis=2)
    return Shapes(surface, fields, np.zeros_like(x), np.zeros(2), np.eye(2) / 0.25, known)


@pytest.fixture(scope="module")
def shapes():
    return bent(angle())


def free(surface, shape):
    """(v,) deviations along the normals without their rigid part."""
    n = surface.vertex_normals
    rigid = np.hstack([n, np.cross(surface.points - surface.centroid, n)])
    off = (shape * n).sum(axis=1)
    return off - rigid @ np.linalg.lstsq(rigid, off, rcond=None)[0]


@pytest.mark.slow
def test_placement_and_shape_are_found_in_spite_of_noise_outliers_and_holes(shapes):
    surface, a = shapes.surface, np.array([0.6, -0.4])
    points, (R, t) = scanned(surface, shapes.fields @ a, 3000, 1)
    found = register(points, shapes)
    assert np.abs(free(surface, shapes.fields @ (found.amplitudes - a))).max() < 0.02
    assert np.abs(found.amplitudes - a).max() < 4 * np.sqrt(found.covariance.diagonal().max())
    assert found.noise == pytest.approx(0.05, rel=0.1) and found.unexplained < 0.02
    assert found.outliers == pytest.approx(0.05, abs=0.015) and 0.7 < found.covered <= 1.0
    assert np.abs(found.pose(points) - (points @ R.T + t)).max() < 0.5
    assert found.pose.degrees == pytest.approx(3.0, abs=0.5)


@pytest.mark.slow
def test_uncertainty_is_that_of_many_scans(shapes):
    """Errors of 8 scans over their standard deviations have a mean square of 1."""
    rng, squares = np.random.default_rng(3), []
    for seed in range(8):
        a = 0.5 * rng.standard_normal(2)
        found = register(scanned(shapes.surface, shapes.fields @ a, 600, seed)[0], shapes)
        squares.append((found.amplitudes - a) ** 2 / found.covariance.diagonal())
    assert 0.25 < np.mean(squares) < 2.2  # χ² of 16 degrees of freedom over 16, in 99 %


@pytest.mark.slow
def test_a_deviation_that_no_shape_describes_is_stated_and_widens_the_uncertainty(shapes):
    surface = shapes.surface
    waves = 0.2 * np.sin(2 * np.pi * surface.points[:, 1:2] / 45) * surface.vertex_normals
    found = register(scanned(surface, waves, 3000, 2)[0], shapes)
    plain = register(scanned(surface, 0 * waves, 3000, 2)[0], shapes)
    truth = free(surface, waves).std()
    assert found.unexplained == pytest.approx(truth, rel=0.35) and plain.unexplained < 0.1 * truth
    assert found.covariance.diagonal().min() > 4 * plain.covariance.diagonal().max()


@pytest.fixture(scope="module")
def strip():
    """A flat strip, 100 by 25 mm, that is held on one half; its distribution expects it to be bent by 0.65 ± 0.2 mm."""
    points, triangles = extrude([(0, 0), (25, 0)], 0.0, 100.0, 3.0)[:2]
    surface = Surface(points, triangles)
    field = np.maximum(0, points[:, :1] / 50 - 1) ** 2 * surface.vertex_normals
    mean, precision = np.array([0.65]), np.array([[1 / 0.2**2]])
    return Shapes(surface, field[:, :, None], np.zeros_like(points), mean, precision, True)


@pytest.mark.slow
@pytest.mark.parametrize("bend", [0.0, -0.6])
@pytest.mark.parametrize("noise", [0.0, 0.002, 0.05])
def test_a_precise_scan_outweighs_the_distribution_wherever_it_lies(strip, noise, bend):
    for many, shift, outliers in ((1000, 0.0, 0.0), (300, 5.0, 0.05)):
        true = strip.fields[:, :, 0] * bend
        points = scanned(strip.surface, true, many, 7, noise, outliers, 0.0, max(shift, 1e-9), 0.6 * shift)[0]
        found = register(points, strip)
        error = abs(found.amplitudes[0] - bend)
        assert error < 4 * np.sqrt(found.covariance[0, 0]) + 0.001 and found.covered > 0.8
        # 300 points that see 0.09 mm RMS of the field give 0.64 times the noise, and less than twice that if it slides.
        assert np.sqrt(found.covariance[0, 0]) < 0.001 + 1.28 * noise
        assert found.unexplained < 0.002 + 0.3 * noise and found.outliers < outliers + 0.05


def test_the_distribution_holds_where_the_scan_says_little(strip):
    """With noise of 0.4 mm, 40 points determine the bend less than its distribution does."""
    points = scanned(strip.surface, 0 * strip.surface.points, 40, 8, 0.4, 0.0, 0.0, 1e-9, 0.0)[0]
    found = register(points, strip)
    assert 0.1 < np.sqrt(found.covariance[0, 0]) < 0.21 and abs(found.amplitudes[0] - 0.65) < 0.5


@pytest.mark.slow
def test_any_position_is_found_and_the_given_one_is_preferred():
    surface = angle(6.0)
    points, _ = scanned(surface, 0 * surface.points, 600, 4, shift=800.0, turn=150.0, outliers=0.0, noise=0.02)
    moved = place(points, surface)(points)
    assert np.median(surface.project(moved).distance) < 0.1


@pytest.mark.slow
def test_a_part_that_fits_in_several_positions_is_refused_away_from_its_own():
    """A square plate looks the same after every quarter turn, and upside down."""
    points, triangles = extrude([(0, 0), (60, 0)], 0.0, 60.0, 6.0)[:2]
    plate = Surface(points, triangles)
    near, _ = scanned(plate, 0 * points, 400, 5, outliers=0.0)
    assert np.abs(plate.project(place(near, plate)(near)).distance).mean() < 0.3
    far = near @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]).T
    with pytest.raises(FormatError, match="several positions.*place the scan near"):
        place(far, plate)


def test_too_few_points_are_refused(shapes):
    with pytest.raises(FormatError, match="12 points are too few"):
        register(shapes.surface.points[:12], shapes)


@pytest.mark.slow
@pytest.mark.parametrize(("separator", "decimal"), [(";", ","), (" ", ".")])
def test_a_long_table_is_read_to_the_last_bit_and_its_faults_are_named(separator, decimal, tmp_path):
    points = np.random.default_rng(6).normal(0, 100, (20_000, 3))
    lines = [separator.join(("X [in]", "Y [in]", "Z [in]") if separator != " " else ("x", "y", "z"))]
    lines += [separator.join(f"{x:.15g}".replace(".", decimal) for x in row) for row in points.tolist()]
    path = tmp_path / "long.csv"
    path.write_text("\n".join(lines))
    assert path.stat().st_size > 1_000_000
    (cloud,) = read_clouds(path, "mm", None, None).values()
    expected = np.array([[float(f"{x:.15g}") for x in row] for row in points.tolist()])
    assert np.array_equal(cloud.points, expected * (1.0 if separator == " " else 25.4))
    path.write_text("\n".join([*lines, separator.join(("1", "far", "3"))]))
    with pytest.raises(FormatError, match="row 20002.*'far'"):
        read_clouds(path, "mm", None, None)


def test_candidates_hold_the_closest_point_after_every_move_within_theirs():
    surface, rng = angle(6.0), np.random.default_rng(7)
    x = surface.points[rng.integers(len(surface.points), size=200)] + rng.normal(0, 2, (200, 3))
    owner, triangle = surface.candidates(x, 3.0)
    step = rng.normal(size=x.shape)
    moved = x + 3.0 * step / np.linalg.norm(step, axis=1, keepdims=True)
    whole, some = surface.project(moved), surface.project(moved, among=(owner, triangle))
    assert len(owner) < 0.7 * len(x) * len(surface.triangles)
    assert np.array_equal(whole.triangle, some.triangle) and np.array_equal(whole.point, some.point)
