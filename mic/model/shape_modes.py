"""Measured shapes and random fields of a scene, written out as deviations of kind ``shape``.

Of n measured pieces with the deviations ``d_i`` (c,) at common points, the mean and the principal modes
(``D = [d_i − mean]/√(n−1) = U Σ Wᵀ``) are

    d = mean + Σ_k a_k φ_k,        φ_k = σ_k u_k,        a_k of mean 0 and standard deviation 1,

and piece i has ``a_k = √(n−1) w_ik``. As few modes are kept as hold a share of the variance.

Where the noise of a measured point is known, pieces are first freed of what is no more than noise. Of the pieces as
they are, mean and all, in units of the noise, noise alone has no singular value beyond ``√c + √n``; what lies below is
left out. The mean is the largest of all shapes, and what the modes have of it is told apart from noise by that. What
remains is ``Z Wᵀ``, each column of Z with the noise of one measured piece, so that the mean has ``|Wᵀ1/n|`` times that,
and mode k ``|B w_k|`` times, with ``B = [W − mean]ᵀ/√(n−1)``.

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
from mic.geometry.measured_points import FACING, Deviations, deviations, read_cloud, sheet_normals, spread
from mic.geometry.surface import Surface
from mic.model.random_field import correlation, modes_of
from mic.scene import Scene
from mic.scene.checks import entry
from mic.scene.deviation import FieldDeviation, MeasuredDeviation, ShapeDeviation
from mic.system.files import fingerprint

__all__ = ["MODES", "Written", "write_modes"]

#: Kinds of deviations that are written out.
MODES = ("measured", "field")

MOST = 400  # points at which a shape is taken: each is one more load case of the part
USUAL = 200  # of them, where the scene leaves it open
SPREAD = 0.5  # of them on a square of their spacing, about
PER_LENGTH = 3.0  # points within a correlation length
PER_EDGE = 4.0  # lengths of edges within a correlation length, at least
ABOUT = 0.75  # spacings from a point within which measured ones are fitted
FEW = 6  # measured points to which a plane is fitted
TOLD = 3  # files at fault that are told one by one
AMONG = 24.0  # measured points about one, where they are sparse: at an edge half of them, of some pieces fewer
COVERED = 0.5  # of the points of a part must have measured ones about them
NORMAL = 0.01  # probability below which scores are said not to be normal
LONGEST = 50  # letters of a name to which the number of a mode is added


@dataclass(frozen=True)
class Written:
    """A scene with its measured shapes and fields written out.

    Attributes
    ----------
    scene : Scene
    inputs : dict of str to str
        Hashes of the files that were read, by name.
    sentences : tuple of str
        What was found.
    """

    scene: Scene
    inputs: dict[str, str | None]
    sentences: tuple[str, ...]


def write_modes(scene: Scene, surfaces: Mapping[str, Surface], decks: Mapping[str, Deck | None]) -> Written:
    """Write out the measured shapes and the random fields of a scene; one that has none is returned as it is.

    Parameters
    ----------
    scene : Scene
        Its mesh files filled in, so that thicknesses are known.
    surfaces, decks : mapping
        Of the parts, by name.

    Raises
    ------
    SceneError
        A line for each deviation at fault, with the remedy.
    """
    written: list[Any] = []
    sentences: list[str] = []
    inputs: dict[str, str | None] = {}
    problems = Problems()
    for i, item in enumerate(scene.deviations):
        made: list[Any] = [item]
        if isinstance(item, MeasuredDeviation | FieldDeviation):
            at = entry("deviations", i, item)
            with problems:
                if len(item.name) > LONGEST:
                    raise SceneError(f"{at}: name: it is too long to number its modes; shorten it to {LONGEST} letters")
                surface = surfaces[item.part]
                if isinstance(item, FieldDeviation):
                    made, said = _field(at, item, surface)
                else:
                    thickness = next(part.thickness for part in scene.parts if part.name == item.part)
                    made, said, read = _measured(at, item, scene.folder, surface, decks[item.part], thickness)
                    inputs |= read
                sentences.append(said)
        written += made
    problems.tell()
    if not sentences:
        return Written(scene, {}, ())
    return Written(scene.model_copy(update={"deviations": written}), inputs, tuple(sentences))


def _field(at: str, item: FieldDeviation, surface: Surface) -> tuple[list[ShapeDeviation], str]:
    """The modes of a random field."""
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
    else:
        if SPREAD * surface.areas.sum() / spacing**2 > MOST:
            least = PER_LENGTH * np.sqrt(SPREAD * surface.areas.sum() / MOST)
            raise SceneError(
                f"{at}: length: {item.length:g} mm takes more than {MOST} points on part {item.part!r}; "
                f"give {least:.2g} mm or more"
            )
        vertices = spread(surface, spacing)
        points, loose = surface.points[vertices], True
    R = correlation(surface, vertices, item.length, item.direction, item.stretch)
    amplitude = item.sigma * (np.ones(len(points)) if item.values is None else np.array(item.values))
    Φ = amplitude[:, None] * modes_of(R, item.share)
    at_points = _rounded(points)
    common: dict[str, Any] = {"kind": "shape", "part": item.part, "points": at_points, "loose": loose}
    common |= {"distribution": item.distribution, "parameters": item.parameters, "sigma": 1.0, "batch": item.name}
    made = [ShapeDeviation(name=f"{item.name}.{k + 1}", values=_rounded(φ), **common) for k, φ in enumerate(Φ.T)]
    return made, f"{at}: {len(made)} modes at {len(points)} points keep {100 * item.share:g} % of the variance at each"


def _measured(
    at: str, item: MeasuredDeviation, folder: Path, surface: Surface, deck: Deck | None, thickness: float | None
) -> tuple[list[ShapeDeviation], str, dict[str, str | None]]:
    """The mean shape of measured pieces, and the modes about it."""
    files = _files(at, item.files, folder)
    problems, pieces = Problems(), []
    inputs: dict[str, str | None] = {}
    for file in files:
        with problems:
            try:
                cloud = read_cloud(file, item.unit, surface, deck)
                skin = 0.5 * item.skin * (thickness or 0.0)
                pieces.append(deviations(file, cloud, surface, skin, item.align, item.within, item.unit))
            except FormatError as problem:
                raise SceneError(f"{at}: files: {problem}") from problem
            inputs[f"{item.name}: {file.name}"] = fingerprint(file.read_bytes())
    _tell_first(at, problems)
    _refuse_alike(at, files, pieces)
    points, values, share_of_noise = _common(at, item, surface, pieces)
    n = len(pieces)
    noise = item.noise * share_of_noise
    Z, W, rest = _beyond_noise(values, noise) if n > 1 and item.noise and not item.pieces else (values, None, 0.0)
    mean = values.mean(axis=1) if W is None else Z @ W.mean(axis=0)
    of_mean = 1 / np.sqrt(n) if W is None else float(np.linalg.norm(W.mean(axis=0)))
    common: dict[str, Any] = {"kind": "shape", "part": item.part, "points": _rounded(points), "loose": True}
    middle = {"mean": item.mean, "sigma": 0.0, "noise": _noise(noise * of_mean), "values": _rounded(mean)}
    said = f"{at}: {n} pieces at {len(points)} points, off by {np.abs(values).max():.3g} mm at most{_fitted(pieces)}"
    if n == 1:
        return [ShapeDeviation(name=item.name, **common, **middle)], said.replace("1 pieces", "1 piece"), inputs
    common["batch"] = item.name
    centred = values - mean[:, None] if W is None else Z @ (W - W.mean(axis=0)).T
    U, Σ, Wt = np.linalg.svd(centred / np.sqrt(n - 1), full_matrices=False)
    variance = np.cumsum(Σ**2)
    if variance[-1] == 0.0:
        raise SceneError(f"{at}: files: the {n} pieces are all alike; give one, or pieces that differ")
    share = (1.0 if item.pieces else item.share) * (1 - 1e-12)
    kept = min(int(np.searchsorted(variance, share * variance[-1])) + 1, n - 1)
    scores = np.sqrt(n - 1) * Wt[:kept].T
    stems = [file.stem for file in files]
    names = stems if len(set(stems)) == n else [file.name for file in files]
    of_mode = np.full(kept, 1 / np.sqrt(n - 1))
    if W is not None:
        of_mode = np.linalg.norm((W - W.mean(axis=0)).T @ Wt[:kept].T, axis=0) / np.sqrt(n - 1)
    made = [ShapeDeviation(name=f"{item.name}.mean", **common, **middle)] if item.mean else []
    for k in range(kept if item.sigma else 0):
        drawn = {"distribution": item.distribution, "parameters": item.parameters}
        how = {"scores": _rounded(scores[:, k]), "pieces": names} if item.pieces else drawn
        name, own = f"{item.name}.{k + 1}", _rounded(Σ[k] * U[:, k])
        uncertain = {"sigma": item.sigma, "noise": _noise(noise * of_mode[k])}
        made.append(ShapeDeviation(name=name, values=own, **common, **uncertain, **how))
    said += f"; {kept} modes keep {100 * variance[kept - 1] / variance[-1]:.3g} % of the variance"
    if W is not None:
        said += f", what is left scatters by {rest:.2g} mm at a point and is taken for noise"
    return made, said + ("" if item.pieces else _not_normal(item, scores)), inputs


def _beyond_noise(values: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """What of pieces (c, n) noise cannot be, ``Z Wᵀ`` with Z (c, r) and W (n, r), and how far they scatter about it.

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
    """The files that a name or a pattern stands for, in the order of their names."""
    path = Path(pattern)
    base, relative = folder, pattern
    if path.is_absolute():
        base, relative = Path(path.anchor), str(path.relative_to(path.anchor))
    if (base / relative).is_dir():
        relative = str(Path(relative) / "*")
    try:
        found = sorted(file for file in base.glob(relative) if file.is_file() and not file.name.startswith("."))
    except (ValueError, NotImplementedError) as problem:
        raise SceneError(f"{at}: files: {pattern!r} is no pattern of files ({problem}); correct it") from None
    if not found:
        raise SceneError(f"{at}: files: there is no file {pattern!r} in {folder}; correct the name or the pattern")
    return found


def _tell_first(at: str, problems: Problems) -> None:
    """The first files at fault, and how many there are: a folder of another unit is one mistake."""
    more = len(problems.lines) - TOLD
    if more > 0:
        problems.lines[TOLD:] = [f"{at}: files: {more} more files are at fault; correct these first"]
    problems.tell()


def _refuse_alike(at: str, files: list[Path], pieces: list[Deviations]) -> None:
    """Two files with the same points and values are one piece that stands there twice."""
    seen: dict[bytes, Path] = {}
    for file, piece in zip(files, pieces):
        content = piece.points.tobytes() + piece.value.tobytes()
        if content in seen:
            raise SceneError(f"{at}: files: {file.name} holds what {seen[content].name} holds; remove one of them")
        seen[content] = file


def _common(at, item: MeasuredDeviation, surface: Surface, pieces: list[Deviations]):
    """Points (c, 3) common to all pieces, values (c, n), and the share (c,) of a measured point's noise in them."""
    first = pieces[0]
    same = all(
        len(piece.points) == len(first.points) and np.abs(piece.points - first.points).max(initial=0.0) <= surface.tie
        for piece in pieces
    )
    if item.spacing is None and same and len(first.points) <= MOST:
        if len(first.points) <= 6:
            raise SceneError(
                f"{at}: files: {len(first.points)} measured points do not tell a shape: fewer than seven are met by "
                "moving the part as it is; measure more"
            )
        sure = np.logical_and.reduce([piece.sure for piece in pieces])
        sure |= sure.sum() <= 6
        return first.points[sure], np.array([piece.value for piece in pieces]).T[sure], np.ones(int(sure.sum()))
    area = float(surface.areas.sum())
    spacing = item.spacing or np.sqrt(SPREAD * area / USUAL)
    if SPREAD * area / spacing**2 > MOST:
        raise SceneError(
            f"{at}: spacing: {spacing:g} mm takes more than {MOST} points on part {item.part!r}; give "
            f"{np.sqrt(SPREAD * area / MOST):.2g} mm or more"
        )
    centres, values, shares = _taken(surface, pieces, spacing)
    known = ~np.isnan(values).any(axis=1)
    if item.spacing is None and known.mean() < COVERED:  # the points are sparse
        fewest = min(len(piece.points) for piece in pieces)
        spacing = max(spacing, np.sqrt(AMONG * area / (np.pi * ABOUT**2 * fewest)))
        centres, values, shares = _taken(surface, pieces, spacing)
        known = ~np.isnan(values).any(axis=1)
    if known.mean() < COVERED or known.sum() <= 6:
        raise SceneError(
            f"{at}: files: only {100 * known.mean():.0f} % of part {item.part!r} has {FEW} measured points of every "
            f"piece within {ABOUT * spacing:.3g} mm; give a larger spacing, or pieces that are measured all over"
        )
    return centres[known], values[known], np.sqrt(np.mean(shares[known] ** 2, axis=1))


def _taken(surface: Surface, pieces: list[Deviations], spacing: float):
    """Points (c, 3) of the surface, so far from each other, and what pieces have there: values and shares (c, n) as
    :func:`_at` finds them."""
    centres, normals = sheet_normals(surface, surface.points[spread(surface, spacing)])
    found = [_at(piece, centres, normals, ABOUT * spacing) for piece in pieces]
    values, shares = (np.array(each).T for each in zip(*found))
    return centres, values, shares


def _at(piece: Deviations, centres: np.ndarray, normals: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A piece's deviations (c,) at points of the surface, and their share (c,) of a measured point's noise.

    They are read from planes that are fitted to the measured points about them that face the same way, surely on their
    face; NaN where these are too few.
    """
    value, share = np.full(len(centres), np.nan), np.full(len(centres), np.nan)
    tree = cKDTree(piece.points)
    for k, near in enumerate(tree.query_ball_point(centres, radius)):
        own = np.sort(np.array(near, dtype=np.int64))
        own = own[piece.sure[own] & (piece.normal[own] @ normals[k] > FACING)]
        if len(own) >= FEW:
            away = (piece.points[own] - centres[k]) / radius
            plane = np.column_stack([np.ones(len(own)), away @ null_space(normals[k][None])])
            weights = np.linalg.pinv(plane, rcond=1e-6)[0]
            value[k], share[k] = weights @ piece.value[own], np.linalg.norm(weights)
    return value, share


def _fitted(pieces: list[Deviations]) -> str:
    """What the best fits did, in words."""
    said = ""
    shift, turn = max(piece.fit.shift for piece in pieces), max(piece.fit.turn for piece in pieces)
    if shift > 0.0 or turn > 0.0:
        said += f"; fitted by up to {shift:.2g} mm and {turn:.2g}°"
    left_out = sum(piece.fit.left_out for piece in pieces)
    return said + (f"; {left_out} points lie too far off the part and were left out" if left_out else "")


def _not_normal(item: MeasuredDeviation, scores: np.ndarray) -> str:
    """A sentence where the first modes' scores do not look normal (Shapiro and Wilk), or are too few to tell."""
    if item.distribution != "normal" or len(scores) < 8:
        return ""
    from scipy.stats import shapiro  # which takes a quarter of a second to load

    p = [float(shapiro(column).pvalue) for column in scores.T]
    worst = int(np.argmin(p))
    if p[worst] * len(p) >= NORMAL:  # Bonferroni
        return ""
    return (
        f"; the scores of mode {worst + 1} are not normal (p = {p[worst]:.1g}): pieces = true takes the "
        "pieces as they are"
    )


def _noise(values: np.ndarray) -> float | list:
    """As a scene has it: none, or that of each point."""
    return _rounded(values) if values.any() else 0.0


def _rounded(values: np.ndarray) -> list:
    """As lists, to be written into a scene: to 12 digits of the largest, of which coordinates hold fewer."""
    largest = float(np.abs(values).max(initial=0.0)) or 1.0
    digits = 12 - int(np.floor(np.log10(largest)))
    return np.round(values, digits).tolist()
