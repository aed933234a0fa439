"""Expands measured shapes and random fields of a scene into deviations of kind ``shape``.

n measured pieces with deviations ``d_i`` (c,) at common points have the mean and the principal modes
(``D = [d_i − mean]/√(n−1) = U Σ Wᵀ``)

    d = mean + Σ_k a_k φ_k,        φ_k = σ_k u_k,        a_k of mean 0 and standard deviation 1,

and piece i has ``a_k = √(n−1) w_ik``. As few modes are kept as hold a given share of the variance.

If the noise of a measured point is known, it is first removed from the pieces. In units of the noise, the pieces
including their mean have no singular value beyond ``√c + √n`` from noise alone; components with smaller ones are left
out. (The mean is the largest of all shapes, and its contribution to the modes is separated from noise this way.) The
rest is ``Z Wᵀ``, each column of Z with the noise of one measured piece, so that the mean has ``|Wᵀ1/n|`` times that
noise, and mode k ``|B w_k|`` times, with ``B = [W − mean]ᵀ/√(n−1)``.

References
----------
K. R. Davidson, S. J. Szarek: Local operator theory, random matrices and Banach spaces. *Handbook of the Geometry of
Banach Spaces* 1 (2001), 317–366: theorem II.13, singular values of noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import null_space
from scipy.spatial import cKDTree

from mic.errors import FormatError, Problems, SceneError
from mic.geometry.deck import Deck
from mic.geometry.measured_points import FACING, Deviations, deviations, read_clouds, sheet_normals, spread
from mic.geometry.surface import Surface
from mic.model.random_field import correlation, modes_of
from mic.model.rows import on_part
from mic.scene import Scene
from mic.scene.checks import entry
from mic.scene.deviation import DeviationKeys, FieldDeviation, MeasuredDeviation, ShapeDeviation
from mic.system.files import fingerprint

__all__ = ["EXPANDED", "ExpandedScene", "expand_modes"]

#: Kinds of deviations that are expanded.
EXPANDED = ("measured", "field")

MOST = 400  # points of a shape: each is one more load case of the part
USUAL = 200  # default number of points
SPREAD = 0.5  # points per square of their spacing, approximately
PER_LENGTH = 3.0  # points within a correlation length
PER_EDGE = 4.0  # edge lengths within a correlation length, at least
ABOUT = 0.75  # radius about a point within which measured points are fitted, in spacings
FEWEST = 7  # least number of points of a loose shape: a rigid motion fits fewer
FEW = 6  # least number of measured points for a plane
REPORTED = 3  # faulty files that are reported individually
AMONG = 24.0  # intended number of sparse measured points about a point: half of them at an edge, some pieces fewer
COVERED = 0.5  # least share of a part's points with measured points about them
NORMAL = 0.01  # probability below which scores are reported as not normal
LONGEST = 50  # letters of a name to which the number of a mode is appended


@dataclass(frozen=True)
class ExpandedScene:
    """A scene with its measured shapes and fields expanded into modes.

    Attributes
    ----------
    scene : Scene
    inputs : dict of str to str
        Hashes of the files that were read, by name.
    messages : tuple of str
        One summary for each expanded deviation.
    """

    scene: Scene
    inputs: dict[str, str | None]
    messages: tuple[str, ...]


def expand_modes(
    scene: Scene, surfaces: Mapping[str, Surface], decks: Mapping[str, Deck | None], problems: Problems
) -> ExpandedScene:
    """Expand the measured shapes and random fields of a scene; a scene without any is returned as it is.

    After a problem, the expanded scene lacks the deviations with errors.

    Parameters
    ----------
    scene : Scene
        With values from the mesh files filled in, so that thicknesses are known.
    surfaces, decks : mapping
        Of the parts, by name.
    problems : Problems
        Collects each :class:`SceneError`.
    """
    expanded: list[Any] = []
    entries: list[int] = []
    messages: list[str] = []
    inputs: dict[str, str | None] = {}
    for i, item in enumerate(scene.deviations):
        if not isinstance(item, MeasuredDeviation | FieldDeviation):
            expanded.append(item)
            entries.append(i)
            continue
        at = entry("deviations", i, item)
        with problems:
            if len(item.name) > LONGEST:
                raise SceneError(f"{at}: name: it is too long to number its modes; shorten it to {LONGEST} letters")
            if isinstance(item, FieldDeviation):
                modes, message = _field(at, item, surfaces[item.part])
            else:
                thickness = next(part.thickness for part in scene.parts if part.name == item.part)
                pieces = _pieces(at, item, scene.folder, surfaces[item.part], decks[item.part], thickness)
                inputs |= {f"{item.name}: {file.name}": fingerprint(file.read_bytes()) for file, _ in pieces}
                modes, message = _measured(at, item, surfaces[item.part], pieces)
            expanded += modes
            entries += [i] * len(modes)
            messages.append(message)
    if len(expanded) == len(scene.deviations) and not messages:
        return ExpandedScene(scene, {}, ())
    expanded = DeviationKeys.with_entries(expanded, entries)
    return ExpandedScene(scene.model_copy(update={"deviations": expanded}), inputs, tuple(messages))


def _field(at: str, item: FieldDeviation, surface: Surface) -> tuple[list[ShapeDeviation], str]:
    """The modes of a random field, and a summary."""
    shortest = item.length * min(1.0, item.stretch)
    spacing, edge = shortest / PER_LENGTH, float(np.median(surface.edge_lengths))
    if shortest < PER_EDGE * edge:
        raise SceneError(
            f"{at}: length: {shortest:g} mm is less than {PER_EDGE:g} elements of part {item.part!r} "
            f"({edge:.3g} mm); give a longer one, or a finer mesh"
        )
    if item.points is not None:
        points, loose = np.array(item.points), False
        if len(points) > MOST:
            raise SceneError(f"{at}: points: {len(points)} are more than {MOST}; give fewer")
        vertices = cKDTree(surface.points).query(surface.project(points).point)[1]
        twice = np.setdiff1d(np.arange(len(points)), np.unique(vertices, return_index=True)[1])
        if len(twice):
            raise SceneError(f"{at}: points[{twice[0]}] lies within an element of another; move it, or remove it")
        on_part(f"{at}.points", item.part, surface, points)
    else:
        _check_number(f"{at}: length", item.part, surface, item.length, item.length / spacing)
        vertices = spread(surface, spacing)
        points, loose = surface.points[vertices], True
        if len(points) < FEWEST:
            raise SceneError(
                f"{at}: length: {item.length:g} mm leaves {len(points)} points on part {item.part!r}, which a rigid "
                "motion fits; give a shorter one, or points"
            )
    R = correlation(surface, vertices, item.length, item.direction, item.stretch)
    amplitude = item.sigma * (np.ones(len(points)) if item.values is None else np.array(item.values))
    Φ = amplitude[:, None] * modes_of(R, item.share)
    common: dict[str, Any] = {"kind": "shape", "part": item.part, "points": _rounded(points), "loose": loose}
    common |= {"distribution": item.distribution, "parameters": item.parameters, "sigma": 1.0, "batch": item.name}
    modes = [ShapeDeviation(name=f"{item.name}.{k + 1}", values=_rounded(φ), **common) for k, φ in enumerate(Φ.T)]
    summary = f"{len(modes)} modes at {len(points)} points keep {100 * item.share:g} % of the variance at each"
    return modes, f"{at}: {summary}"


def _pieces(
    at: str, item: MeasuredDeviation, folder: Path, surface: Surface, deck: Deck | None, thickness: float | None
) -> dict[tuple[Path, str], Deviations]:
    """The measured pieces by file and serial number."""
    problems = Problems()
    pieces: dict[tuple[Path, str], Deviations] = {}
    same: dict[bytes, str] = {}
    skin = 0.5 * item.skin * (thickness or 0.0)
    for file in _files(at, item.files, folder):
        with problems:
            try:
                for serial, cloud in read_clouds(file, item.unit, surface, deck, folder).items():
                    found = deviations(file, cloud, surface, skin, item.align, item.within, item.unit)
                    pieces[file, serial] = found
            except FormatError as problem:
                raise SceneError(f"{at}: files: {problem}") from problem
    more = len(problems.lines) - REPORTED
    if more > 0:  # a folder in another unit is one mistake
        problems.lines[REPORTED:] = [f"{at}: files: {more} more files have errors; correct these first"]
    problems.raise_all()
    for (file, serial), piece in pieces.items():
        name = f"{file.name} {serial}".rstrip()
        first = same.setdefault(piece.points.tobytes() + piece.value.tobytes(), name)
        if first is not name:
            raise SceneError(f"{at}: files: {name} and {first} have the same content; remove one of them")
    return pieces


def _measured(
    at: str, item: MeasuredDeviation, surface: Surface, by_piece: Mapping[tuple[Path, str], Deviations]
) -> tuple[list[ShapeDeviation], str]:
    """The mean shape of measured pieces and the modes about it, and a summary."""
    pieces, n = list(by_piece.values()), len(by_piece)
    points, values, share_of_noise = _common_points(at, item, surface, pieces)
    noise = item.noise * share_of_noise
    Z, W, scatter = _without_noise(values, noise) if n > 1 and item.noise and not item.pieces else (values, None, 0.0)
    mean = values.mean(axis=1) if W is None else Z @ W.mean(axis=0)
    noise_of_mean = 1 / np.sqrt(n) if W is None else float(np.linalg.norm(W.mean(axis=0)))
    common: dict[str, Any] = {"kind": "shape", "part": item.part, "points": _rounded(points), "loose": True}
    mean_keys = {"mean": item.mean, "sigma": 0.0, "noise": _noise(noise * noise_of_mean), "values": _rounded(mean)}
    message = f"{at}: {n} piece{'s' * (n > 1)} at {len(points)} points, off by {np.abs(values).max():.3g} mm at most"
    message += _fit_summary(pieces)
    if n == 1:
        return [ShapeDeviation(name=item.name, **common, **mean_keys)], message
    common["batch"] = item.name
    centred = values - mean[:, None] if W is None else Z @ (W - W.mean(axis=0)).T
    U, Σ, Wt = np.linalg.svd(centred / np.sqrt(n - 1), full_matrices=False)
    variance = np.cumsum(Σ**2)
    if variance[-1] == 0.0:
        raise SceneError(f"{at}: files: the {n} pieces are all alike; give one, or pieces that differ")
    share = (1.0 if item.pieces else item.share) * (1 - 1e-12)
    count = min(int(np.searchsorted(variance, share * variance[-1])) + 1, n - 1)
    scores = np.sqrt(n - 1) * Wt[:count].T
    amount = np.ones(count) if W is None else np.linalg.norm((W - W.mean(axis=0)).T @ Wt[:count].T, axis=0)
    noise_of_mode = amount / np.sqrt(n - 1)
    names = [serial or file.stem for file, serial in by_piece]
    if len(set(names)) < n:
        names = [f"{file.name} {serial}".rstrip() for file, serial in by_piece]
    modes = [ShapeDeviation(name=f"{item.name}.mean", **common, **mean_keys)] if item.mean else []
    for k in range(count if item.sigma else 0):
        keys: dict[str, Any] = {"sigma": item.sigma, "noise": _noise(noise * noise_of_mode[k])}
        keys["values"] = _rounded(Σ[k] * U[:, k])
        if item.pieces:
            keys |= {"scores": _rounded(scores[:, k]), "pieces": names}
        else:
            keys |= {"distribution": item.distribution, "parameters": item.parameters}
        modes.append(ShapeDeviation(name=f"{item.name}.{k + 1}", **common, **keys))
    message += f"; {count} modes keep {100 * variance[count - 1] / variance[-1]:.3g} % of the variance"
    if W is not None:
        message += f", the residual scatters by {scatter:.2g} mm at a point and is treated as noise"
    return modes, message + ("" if item.pieces else _not_normal(item, scores))


def _without_noise(values: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Components of pieces (c, n) beyond noise, ``Z Wᵀ`` with Z (c, r) and W (n, r), and the scatter about them.

    Parameters
    ----------
    values : (c, n) array
    noise : (c,) array
        Standard uncertainty of each piece's value at each point.
    """
    c, n = values.shape
    U, S, Wt = np.linalg.svd(values / noise[:, None], full_matrices=False)
    r = max(1, int((S > np.sqrt(c) + np.sqrt(n)).sum()))
    Z, W = noise[:, None] * (U[:, :r] * S[:r]), Wt[:r].T
    free = max(1, (c - r) * (n - r))
    return Z, W, float(np.sqrt(((values - Z @ W.T) ** 2).sum() / free))


def _files(at: str, pattern: str, folder: Path) -> list[Path]:
    """The files of a name or a pattern, sorted by name."""
    wanted = f"{pattern}/*" if (folder / pattern).is_dir() else pattern
    start = Path(Path(wanted).anchor or folder)
    matches = start.glob(str(Path(wanted).relative_to(Path(wanted).anchor)))  # follows no links to folders
    files = sorted(file for file in matches if file.is_file() and not file.name.startswith("."))
    if not files:
        raise SceneError(f"{at}: files: there is no file {pattern!r} in {folder}; correct the name or the pattern")
    return files


def _common_points(at, item: MeasuredDeviation, surface: Surface, pieces: list[Deviations]):
    """Points (c, 3) common to all pieces, values (c, n), and the share (c,) of a measured point's noise in them."""
    first = pieces[0]
    same = all(
        len(piece.points) == len(first.points) and np.abs(piece.points - first.points).max(initial=0.0) <= surface.tie
        for piece in pieces
    )
    if item.spacing is None and same and len(first.points) <= MOST:
        if len(first.points) < FEWEST:
            raise SceneError(
                f"{at}: files: {len(first.points)} measured points do not determine a shape: a rigid motion of the "
                "part fits fewer than seven; measure more"
            )
        sure = np.logical_and.reduce([piece.sure for piece in pieces])
        sure |= sure.sum() < FEWEST
        return first.points[sure], np.array([piece.value for piece in pieces]).T[sure], np.ones(int(sure.sum()))
    area = float(surface.areas.sum())
    spacing = item.spacing or np.sqrt(SPREAD * area / USUAL)
    _check_number(f"{at}: spacing", item.part, surface, spacing, 1.0)
    centres, values, shares, known = _fitted_at_spacing(surface, pieces, spacing)
    if item.spacing is None and known.mean() < COVERED:  # the measured points are sparse
        fewest = min(len(piece.points) for piece in pieces)
        spacing = max(spacing, np.sqrt(AMONG * area / (np.pi * ABOUT**2 * fewest)))
        centres, values, shares, known = _fitted_at_spacing(surface, pieces, spacing)
    if known.mean() < COVERED or known.sum() < FEWEST:
        raise SceneError(
            f"{at}: files: only {100 * known.mean():.0f} % of part {item.part!r} has {FEW} measured points of every "
            f"piece within {ABOUT * spacing:.3g} mm; give a larger spacing, or pieces that are measured all over"
        )
    return centres[known], values[known], np.sqrt(np.mean(shares[known] ** 2, axis=1))


def _check_number(key: str, part: str, surface: Surface, value: float, per_spacing: float) -> None:
    """Refuse a spacing of points, stated as a multiple, that needs too many of them."""
    least = per_spacing * np.sqrt(SPREAD * surface.areas.sum() / MOST)
    if value < least:
        raise SceneError(
            f"{key}: {value:g} mm needs more than {MOST} points on part {part!r}; give {least:.2g} mm or more"
        )


def _fitted_at_spacing(surface: Surface, pieces: list[Deviations], spacing: float):
    """Points (c, 3) of the surface at a spacing, values and noise shares (c, n) of the pieces there, and a mask (c,).

    The mask says where all pieces have values.
    """
    centres, normals = sheet_normals(surface, surface.points[spread(surface, spacing)])
    fits = [_fitted_at(piece, centres, normals, ABOUT * spacing) for piece in pieces]
    values, shares = (np.array(arrays).T for arrays in zip(*fits))
    return centres, values, shares, ~np.isnan(values).any(axis=1)


def _fitted_at(piece: Deviations, centres: np.ndarray, normals: np.ndarray, radius: float):
    """A piece's deviations (c,) at points of the surface, and their share (c,) of a measured point's noise.

    They come from planes fitted to the measured points about them that face the same way and are certain to lie on
    their face; NaN where these are too few.
    """
    value, share = np.full(len(centres), np.nan), np.full(len(centres), np.nan)
    tree = cKDTree(piece.points)
    for k, near in enumerate(tree.query_ball_point(centres, radius)):
        neighbours = np.sort(np.array(near, dtype=np.int64))
        neighbours = neighbours[piece.sure[neighbours] & (piece.normal[neighbours] @ normals[k] > FACING)]
        if len(neighbours) >= FEW:
            step = (piece.points[neighbours] - centres[k]) / radius
            plane = np.column_stack([np.ones(len(neighbours)), step @ null_space(normals[k][None])])
            weights = np.linalg.pinv(plane, rcond=1e-6)[0]
            value[k], share[k] = weights @ piece.value[neighbours], np.linalg.norm(weights)
    return value, share


def _fit_summary(pieces: list[Deviations]) -> str:
    """Shift and rotation of the best fits, and points left out, as text."""
    shift, turn = max(piece.fit.shift for piece in pieces), max(piece.fit.turn for piece in pieces)
    fitted = f"; fitted by up to {shift:.2g} mm and {turn:.2g}°" if shift > 0.0 or turn > 0.0 else ""
    left_out = sum(piece.fit.left_out for piece in pieces)
    return fitted + (f"; {left_out} points lie too far off the part and were left out" if left_out else "")


def _not_normal(item: MeasuredDeviation, scores: np.ndarray) -> str:
    """A sentence if the scores of a mode are not normal (Shapiro and Wilk), or none if they are too few to decide."""
    if item.distribution != "normal" or len(scores) < 8:
        return ""
    from scipy.stats import shapiro  # loads in a quarter of a second

    p = [float(shapiro(column).pvalue) for column in scores.T]
    worst = int(np.argmin(p))
    if p[worst] * len(p) >= NORMAL:  # Bonferroni
        return ""
    return (
        f"; the scores of mode {worst + 1} are not normal (p = {p[worst]:.1g}): pieces = true uses the measured pieces "
        "themselves"
    )


def _noise(values: np.ndarray) -> float | list:
    """Noise as a scene value: 0 for none, or one value for each point."""
    return _rounded(values) if values.any() else 0.0


def _rounded(values: np.ndarray) -> list:
    """Values as lists for a scene, rounded to 12 digits of the largest; coordinates have fewer."""
    largest = float(np.abs(values).max(initial=0.0)) or 1.0
    digits = 12 - int(np.floor(np.log10(largest)))
    return np.round(values, digits).tolist()
