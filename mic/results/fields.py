"""Mean and 6σ of the parts' displacement from nominal at every vertex, including their shape deviations.

Sample i deforms a part by ``u_i(x) = Φ(x) f_i + R(x) q_i``, with ``f_i`` the forces on the part's functionals, ``q_i``
its rigid motion, ``R`` the rigid modes and each column of ``Φ`` one finite-element solve. To avoid one solve per
functional, the centred forces are factorised in the norm of the elastic energy (``H = C Cᵀ``),

    (F - 1 f̄ᵀ) C = U Σ Vᵀ ≈ U_r Σ_r V_rᵀ,

so all samples need one field for ``f̄`` and r fields for the columns of ``(F - 1 f̄ᵀ)ᵀ U_r``. Rigid motions need no
solve and are not truncated. With the r fields ``c(x)``

    σ²(x) = g M gᵀ / (n - 1),    g = [c(x), R(x)],    M = [U_r, Q]ᵀ [U_r, Q],    Q the centred motions.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mic.compliance.fields import displacement_field
from mic.errors import FormatError, MissingProvider
from mic.geometry.readers.vtu import write_vtu
from mic.results.low_rank_forces import CentredForces, ForceAccumulator
from mic.results.outcome import Outcome, read_outcome
from mic.results.run_folder import RunFolder
from mic.results.schema import CONDENSED, FIELDS, FORCES
from mic.system.files import Format, load_arrays, reading, save_arrays, set_aside, together
from mic.system.memoise import pack, unpack

__all__ = [
    "DISCARDED_ENERGY",
    "Factor",
    "PartField",
    "compute_fields",
    "low_rank",
    "read_fields",
    "write_fields",
]

_log = logging.getLogger(__name__)

STORE = "fields.npz"
_FORMAT = Format("set of displacement fields", 3, "call `mic report` on the run folder")
DISCARDED_ENERGY = 1e-8  # share of the centred forces' elastic energy that the low-rank factor may discard


@dataclass(frozen=True)
class Factor:
    """Low-rank factor of the forces and motions of one part in all samples.

    Attributes
    ----------
    mean_force : (F,) array
        N or N mm.
    mean_motion : (6,) array
        mm, rad.
    force : (F, r) array
        Force of each retained column.
    gram : (r + 6, r + 6) array
        ``M / (n - 1)`` above.
    discarded : float
        Discarded share of the energy.
    samples : int
    """

    mean_force: np.ndarray
    mean_motion: np.ndarray
    force: np.ndarray
    gram: np.ndarray
    discarded: float
    samples: int

    @property
    def rank(self) -> int:
        """Number of solves for the spread; the mean needs one more."""
        return self.force.shape[1]


@dataclass(frozen=True)
class PartField:
    """Displacement statistics at the vertices of one part under one law.

    Attributes
    ----------
    law, part : str
    mean : (v, 3) array
        mm.
    six_sigma : (v, 3) array
        Along x, y, z, mm.
    six_sigma_normal : (v,) array
        Along the vertex normal, mm.
    rank, samples : int
    discarded : float
        See :class:`Factor`.
    error : float
        Largest truncation error of 6σ at the part's retained displacement functionals, where the reduced model gives
        the exact value, mm.
    """

    law: str
    part: str
    mean: np.ndarray
    six_sigma: np.ndarray
    six_sigma_normal: np.ndarray
    rank: int
    samples: int
    discarded: float
    error: float

    @property
    def six_sigma_magnitude(self) -> np.ndarray:
        """(v,) root of the summed squares of the three components, mm."""
        return np.linalg.norm(self.six_sigma, axis=1)


def low_rank(samples: CentredForces, H, discarded: float = DISCARDED_ENERGY) -> Factor:
    """Factorise the forces of one part in the norm of their elastic energy.

    Parameters
    ----------
    samples : CentredForces
        Self-balanced forces on the part's functionals, and its motions.
    H : (F, F) array
        Compliance of the part.
    discarded : float
        Share of the energy that may be discarded; 0 retains everything above rounding.
    """
    n, force = samples.samples, samples.force
    # Unloaded functionals are ignored; scaling by each diagonal compliance makes N and N mm commensurate.
    loaded = np.flatnonzero(np.abs(force).max(axis=0, initial=0.0) > 1e-13 * samples.size)
    scale = np.sqrt(np.maximum(H.diagonal()[loaded], np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(H[np.ix_(loaded, loaded)] / np.outer(scale, scale))
    root = np.sqrt(np.maximum(values, 1e-14 * values.max(initial=0.0)))
    U, singular, Vt = np.linalg.svd((force[:, loaded] * scale) @ vectors * root, full_matrices=False)
    energy = singular**2
    tail = np.append(np.cumsum(energy[::-1])[::-1], 0.0)  # energy discarded at rank 0, 1, …
    total = max(tail[0], np.finfo(float).tiny)
    rank = int(np.argmax(tail <= max(discarded, 1e-28) * total)) if tail[0] > 0 else 0
    columns = np.zeros((force.shape[1], rank))
    # From the samples rather than from V_r: this keeps them self-balanced and avoids division by small roots.
    columns[loaded] = force[:, loaded].T @ U[:, :rank]
    both = np.hstack([U[:, :rank], samples.motion])
    gram = both.T @ both / max(n - 1, 1)
    return Factor(samples.mean[:-6], samples.mean[-6:], columns, gram, float(tail[rank] / total), n)


def compute_fields(outcome: Outcome, cache: Path | None = None) -> list[PartField]:
    """Mean and 6σ fields of every part under every law, from the stored forces and parts.

    Parameters
    ----------
    outcome : Outcome
    cache : Path, optional
        As for :func:`write_fields`.

    Raises
    ------
    MissingProvider
        If no finite-element provider is installed.
    """
    model, fields = outcome.model, []
    samples = {law: parts for law in outcome.laws if (parts := _centred_forces(outcome, law)) is not None}
    for p, part in enumerate(outcome.parts if samples else ()):
        H, G = model.compliance.H[p], model.compliance.G[p]
        factors = {law: low_rank(parts[p], H) for law, parts in samples.items()}
        loads = [np.column_stack([factor.mean_force, factor.force]) for factor in factors.values()]
        solved, rigid = displacement_field(part, np.hstack(loads), cache)  # (v, 3, columns), (v, 3, 6)
        ends = np.cumsum([load.shape[1] for load in loads])
        for (law, factor), own in zip(factors.items(), np.split(solved, ends[:-1], axis=2)):
            mean = own[:, :, 0] + rigid @ factor.mean_motion
            basis = np.concatenate([own[:, :, 1:], rigid], axis=2)
            normal = np.einsum("vi,vir->vr", part.surface.vertex_normals, basis)
            fields.append(
                PartField(
                    law,
                    part.name,
                    mean,
                    _six_sigma(basis, factor),
                    _six_sigma(normal, factor),
                    factor.rank,
                    factor.samples,
                    factor.discarded,
                    _truncation_error(samples[law][p], H, G, factor, ~part.functionals.rotation),
                )
            )
    return fields


def write_fields(folder, outcome: Outcome | None = None, cache: Path | None = None) -> list[PartField]:
    """Compute and write the fields of a run folder, if its scene requests them.

    ``fields/fields.npz`` holds them for the program. For ParaView, ``fields/<law>-<part>.vtu`` holds the columns of
    :data:`mic.results.schema.FIELDS` at the vertices, and ``fields/<part>.vtu`` the nominal surface. Without
    finite elements, ``fields.npz`` holds the reason and no field. Fields of the same run and samples are reused.

    Parameters
    ----------
    folder : path-like
        Folder of :func:`mic.runs.run`.
    outcome : Outcome, optional
        Outcome of the folder, if already read.
    cache : Path, optional
        Cache folder, for fields of unit forces (:mod:`mic.compliance.fields`); default: no cache.
    """
    outcome = outcome or read_outcome(folder)
    folder = outcome.folder / "fields"
    basis = [
        outcome.record["identity"],
        {law: len(outcome.sample_numbers(law)) for law in outcome.laws},
        DISCARDED_ENERGY,
    ]
    header: dict[str, Any] = {"basis": None, "files": []}
    try:
        header, _ = load_arrays(folder / STORE, _FORMAT)
    except FileNotFoundError:
        pass
    except FormatError as problem:
        set_aside(folder / STORE)
        _log.warning("%s. It is set aside and written again.", problem)
    if header["basis"] == basis:
        return read_fields(outcome.folder)[0]
    fields, skipped = [], None
    if not outcome.model.scene.report.fields:
        skipped = "No fields: the scene does not request them (fields = true under [report])."
    elif not outcome.parts:
        skipped = "No fields: parts.npz is missing in the run folder; run the scene again."
    else:
        try:
            fields = compute_fields(outcome, cache)
        except MissingProvider as error:
            skipped = (
                f"No fields: finite elements are not installed ({error}); install them and run `mic report` again."
            )
    surfaces = {part.name: part.surface for part in outcome.parts}
    files = {f"{name}.vtu": (surface, {"normal": surface.vertex_normals}) for name, surface in surfaces.items()}
    files |= {
        f"{field.law}-{field.part}.vtu": (
            surfaces[field.part],
            {column.name: getattr(field, column.name) for column in FIELDS.columns},
        )
        for field in fields
    }
    for old in set(header["files"]) - set(files):
        (folder / old).unlink(missing_ok=True)
    with together() as group:
        for name, (surface, data) in files.items():
            write_vtu(folder / name, surface.points, surface.triangles, data, group)
    content, arrays = pack(fields, {})
    header = {
        "identity": outcome.record["identity"],
        "basis": basis if fields else None,  # without fields, the next call tries again
        "skipped": skipped,
        "files": list(files),
        "fields": content,
    }
    save_arrays(folder / STORE, _FORMAT, header, arrays)
    return fields


def read_fields(folder) -> tuple[list[PartField], str | None]:
    """The fields of a run folder, and the reason if there are none.

    Raises
    ------
    FormatError
        If the file cannot be read, or belongs to another run.
    """
    path = Path(folder) / "fields" / STORE
    try:
        with reading(path, _FORMAT):
            header, arrays = load_arrays(path, _FORMAT)
            if header["identity"] != RunFolder(Path(folder)).record()["identity"]:
                raise FormatError(f"{path}: belongs to another run; {_FORMAT.remedy}")
            return unpack(header["fields"], arrays, (PartField,), {}), header["skipped"]
    except FileNotFoundError:
        return [], "No fields were computed for this run."


def _centred_forces(outcome, law) -> list[CentredForces] | None:
    """Forces and motions of the valid samples, by part; None if they are not stored."""
    folder, compliance, numbers = RunFolder(outcome.folder), outcome.model.compliance, outcome.sample_numbers(law)
    identity = outcome.record["identity"]
    parts = [ForceAccumulator() for _ in compliance.functionals]
    for block in outcome.blocks[law]:
        condensed = folder.read_arrays(CONDENSED, block, identity)
        if condensed is not None:
            for part, compressed in zip(parts, condensed):
                part.join(compressed)
            continue
        arrays = folder.read_arrays(FORCES, block, identity)
        if arrays is None:
            return None
        first, last = np.searchsorted(numbers, [block.first, block.first + block.count])
        valid = numbers[first:last] - block.first
        for part, rows, motions in zip(parts, compliance.functionals, compliance.motions):
            part.add(arrays["force"][valid, rows], arrays["motion"][valid, motions])
    if not len(numbers):
        return None
    return [part.centred() for part in parts]


def _six_sigma(basis, factor):
    if factor.samples < 2:
        return np.full(basis.shape[:-1], np.nan)
    variance = np.einsum("...r,rs,...s->...", basis, factor.gram, basis, optimize=True)
    return 6 * np.sqrt(np.maximum(variance, 0.0))


def _truncation_error(samples, H, G, factor, displacements):
    """Largest error of 6σ at the displacement functionals."""
    if factor.samples < 2:
        return float("nan")
    centred = (samples.force @ H + samples.motion @ G.T)[:, displacements]
    exact = 6 * np.sqrt((centred**2).sum(axis=0) / (factor.samples - 1))
    basis = np.hstack([H @ factor.force, G])[displacements]
    return float(np.abs(exact - _six_sigma(basis, factor)).max(initial=0.0))
