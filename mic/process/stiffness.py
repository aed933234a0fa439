"""Stiffness of the mean shape, or of each sample's shape to first order, instead of the nominal stiffness.

The meshes of the parts carry the mean shape m, which the means of the deviations give them; normals, frames and gaps of
contacts and welds follow:

    H = L(m) K(m)⁻¹ L(m)ᵀ,      g = g⁰ + (g(m) − g⁰ − N y⁰(m)),

for all samples. The readings of the deviations themselves, y⁰ = Σ a_i y⁰_i, are relative to nominal as before: the
bracket is the part of the mesh's gaps at m that they do not contain. Directions that the fixture prescribes, and of
measurements, stay fixed in space.

To first order each sample has its own compliance and gaps: those at m, and their derivatives with respect to the
sources that turn the sheets most (:mod:`mic.model.shape_derivatives`), by differences between the shapes at m ± s_i
e_i. The pins of each H are chosen by conditioning, and differ from mesh to mesh; differences of H would then be wrong
by as much as the derivative. They are therefore taken of ``U = P H P`` with ``P = 1 − G (GᵀG)⁻¹ Gᵀ``, which differs
from H only by rigid motions under balanced forces. On the pins of H(m), ``H(m) = U(m) + G(m) A + Aᵀ G(m)ᵀ``,

    ∂_i H = ∂_i U + ∂_i G A + Aᵀ ∂_i Gᵀ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mic.compliance import provider
from mic.compliance.blocks import Blocks
from mic.compliance.cache import influence_coefficients
from mic.compliance.coefficients import InfluenceCoefficients, InfluenceDerivative
from mic.compliance.part import Part
from mic.model.assembly import Assembly
from mic.model.deviated_geometry import deviated_parts, gap_change
from mic.model.reduction import Reduction
from mic.model.shape import dilation
from mic.model.shape_derivatives import ShapeDerivatives
from mic.model.sources import sources
from mic.process.stiffness_choice import choose_stiffness
from mic.scene import Scene

__all__ = [
    "Shapes",
    "with_shape",
    "coefficients",
    "with_derivatives",
    "used_stiffness",
    "list_sources",
    "derivative_sets",
    "shape_fields",
    "select_shapes",
]

Model = TypeVar("Model", bound=Reduction)
Shared = TypeVar("Shared")

OMITTED = 0.1  # root mean square of the rotations of the sheets: share that sources without derivatives may have
MAX_NAMES = 6  # longer lists of sources are shortened
REACH = 6.0  # standard deviations about the mean within which derivatives are used


@dataclass(frozen=True)
class Shapes:
    """Shapes whose stiffness is needed, as displacements and rotations of each part's vertices (v, 6), mm and rad.

    Attributes
    ----------
    mean : dict of str to array
        The shape given by the means of the deviations, by part.
    along : dict of str to dict of str to array
        Change by one standard deviation, by the deviation's name and by part, for the sources with derivatives.
    omitted : int
        Number of further sources that vary the shapes.
    share : float
        Their share of the rotations of the sheets.
    """

    mean: dict[str, np.ndarray]
    along: dict[str, dict[str, np.ndarray]]
    omitted: int = 0
    share: float = 0.0

    def shape_at(self, name: str, sign: float) -> dict[str, np.ndarray]:
        """The shape one standard deviation of a source away from the mean."""
        return {part: field + sign * self.along[name][part] for part, field in self.mean.items()}

    def parts(self, assembly: Assembly) -> tuple[list[Part], dict[str, dict[str, tuple[Part, Part]]]]:
        """All parts with the mean shape; and those that differ one standard deviation above and below it.

        The latter are given by the deviation's name and by part; they differ in their mesh or in the normals of their
        contacts.
        """
        middle = deviated_parts(assembly, self.mean)
        whole = [part.fingerprint() for part in middle]
        ends = {}
        for name in self.along:
            both = zip(whole, *(deviated_parts(assembly, self.shape_at(name, sign)) for sign in (1.0, -1.0)))
            ends[name] = {
                plus.name: tuple(
                    replace(one, name=f"{one.name} at {name} {sign} 1 σ") for one, sign in ((plus, "+"), (minus, "−"))
                )
                for own, plus, minus in both
                if {plus.fingerprint(), minus.fingerprint()} != {own}
            }
        return middle, ends

    def additional_parts(self, assembly: Assembly) -> list[Part]:
        """All parts whose coefficients are needed in addition to the nominal ones."""
        (middle, ends), known = self.parts(assembly), {part.fingerprint() for part in assembly.parts}
        every = [*middle, *(end for pairs in ends.values() for pair in pairs.values() for end in pair)]
        return [part for part in every if part.fingerprint() not in known]

    def __str__(self) -> str:
        """List the sources in words."""
        text = list_sources(list(self.along))
        if self.omitted:
            text += f" ({self.omitted} more, with {self.share:.1%} of the rotations of the sheets, are left out)"
        return text


def coefficients(
    assembly: Assembly, cache: Path, progress=None, comm: Any = None
) -> tuple[dict[str, InfluenceCoefficients], dict[str, bool]]:
    """Influence coefficients of all parts for the scene's ``stiffness``, from the cache if they fit.

    Arguments, results and errors are those of :func:`mic.compliance.cache.influence_coefficients`. If the stiffness of
    the mean shape is needed, each has that too (:attr:`InfluenceCoefficients.deviated`); if the stiffness follows the
    samples to first order, also their derivatives (:attr:`InfluenceCoefficients.slopes`).
    """
    found, cached = influence_coefficients(assembly, cache, progress, comm)
    if assembly.scene.stiffness == "auto":
        choice = _shared(comm, lambda: choose_stiffness(assembly, Reduction.build(assembly, found)))
        if progress:
            progress(str(choice))
        scene = assembly.scene.model_copy(update={"stiffness": choice.stiffness})
        assembly = replace(assembly, scene=scene)
    if assembly.scene.stiffness == "nominal":
        return found, cached
    shapes = _shared(comm, lambda: select_shapes(assembly, Reduction.build(assembly, found)))
    parts, ends = shapes.parts(assembly)
    if progress and assembly.scene.stiffness == "first-order":
        progress(f"stiffness to first order in {shapes}")
    shifted = [end for pairs in ends.values() for pair in pairs.values() for end in pair]
    shaped, shaped_cached = influence_coefficients(replace(assembly, parts=(*parts, *shifted)), cache, progress, comm)
    both = {
        name: replace(nominal, deviated=(shapes.mean[name], shaped[name]))
        for name, nominal in found.items()
        if name in shaped
    }
    if (comm is None or comm.rank == 0) and assembly.scene.stiffness == "first-order":
        sigma = {item.name: item.sigma for item in assembly.scene.deviations}
        for part, one in both.items():
            slopes = {}
            for name, pairs in ends.items():
                if part in pairs:
                    plus, minus = (shaped[end.name] for end in pairs[part])
                    slopes[name] = _slope(shaped[part], plus, minus, sigma[name], shapes.along[name][part])
            both[part] = replace(one, slopes=slopes)
    for pairs in ends.values():
        for part, pair in pairs.items():
            shaped_cached[part] = shaped_cached[part] and all(shaped_cached[end.name] for end in pair)
    return both, {name: cached[name] and shaped_cached[name] for name in cached}


def _shared(comm: Any, compute: Callable[[], Shared]) -> Shared:
    """A value that the first process computes, on all processes of a communicator."""
    return compute() if comm is None else comm.bcast(compute() if comm.rank == 0 else None)


def used_stiffness(scene: Scene, influence: Mapping[str, InfluenceCoefficients]) -> str:
    """The scene's ``stiffness``; of ``"auto"`` the one that the coefficients of :func:`coefficients` are for."""
    if scene.stiffness != "auto":
        return scene.stiffness
    if any(one.deviated is None for one in influence.values()):
        return "nominal"
    return "mean" if any(one.slopes is None for one in influence.values()) else "first-order"


def derivative_sets(assembly: Assembly) -> tuple[list[str], int]:
    """The sources that vary shapes, and an upper bound of additional sets of coefficients for first-order stiffness.

    Both are known before any coefficients are.

    Parameters
    ----------
    assembly : Assembly
    """
    scene, names = assembly.scene, [part.name for part in assembly.parts]
    joined = [{*zone.parts} & {*names} for zone in scene.zones] + [{*weld.parts} for weld in scene.welds]
    sets, shaping = len(names), []
    for item, source in zip(scene.deviations, sources(scene)):
        control = source.known_shape(assembly.labels, assembly.rows)
        rows = source.load(assembly.labels, assembly.rows) if control is None else control.rows
        changed = set(source.expansion())
        if rows is not None:
            changed |= {names[p] for p in np.searchsorted(assembly.offsets, rows.indices, side="right") - 1}
        if changed and item.sigma > 0:
            shaping.append(item.name)
            sets += 2 * len(changed.union(*(both for both in joined if both & changed)))
    return shaping, sets


def list_sources(names: Sequence[str]) -> str:
    """Sources in words; a long list is shortened."""
    text = ", ".join(names[:MAX_NAMES])
    return f"{len(names)} sources: {text} …" if len(names) > MAX_NAMES else text or "no source"


def select_shapes(assembly: Assembly, nominal: Reduction) -> Shapes:
    """The shapes at which the scene's ``stiffness`` needs coefficients, in addition to the nominal one.

    The sources that turn the sheets least are left out, as long as their share of all rotations is at most
    :data:`OMITTED`, by the root mean square over the vertices with equal weight for all parts. Stretching a sheet, as
    temperature does, hardly changes its stiffness. Correlated sources, whose squares do not add up, are never left out.

    Parameters
    ----------
    assembly : Assembly
    nominal : Reduction
        Of its nominal meshes.
    """
    scene = assembly.scene
    mean = shape_fields(assembly, nominal, np.array([deviation.mean for deviation in scene.deviations]))
    if scene.stiffness != "first-order":
        return Shapes(mean, {})
    sigma = np.array([deviation.sigma for deviation in scene.deviations])
    shaping = np.flatnonzero(nominal.shape.any(axis=0) & (sigma > 0))
    fields = _fields(assembly, nominal, np.diag(sigma)[:, shaping])
    turned = sum(np.mean(np.sum(field[:, 3:] ** 2, axis=1), axis=0) for field in fields.values())
    order = np.argsort(turned, kind="stable")
    omitted = np.zeros(len(shaping), dtype=bool)
    omitted[order] = np.cumsum(turned[order]) <= OMITTED**2 * turned.sum()
    together = {name for table in scene.correlations for name in table.deviations}
    names = [scene.deviations[j].name for j in shaping]
    omitted &= [name not in together for name in names]
    along = {
        name: {part: field[:, :, k] for part, field in fields.items()} for k, name in enumerate(names) if not omitted[k]
    }
    share = np.sqrt(turned[omitted].sum() / turned.sum()) if omitted.any() and turned.any() else 0.0
    return Shapes(mean, along, int(omitted.sum()), float(share))


def shape_fields(assembly: Assembly, model: Reduction, deviations: np.ndarray) -> dict[str, np.ndarray]:
    """Displacements and rotations (v, 6) of the vertices of each part for deviations (p,) of shape, mm and rad.

    Parameters
    ----------
    assembly : Assembly
    model : Reduction
        Of its nominal meshes.
    deviations : (p,) array
    """
    return {name: field[:, :, 0] for name, field in _fields(assembly, model, deviations[:, None]).items()}


def _fields(assembly: Assembly, model: Reduction, deviations: np.ndarray) -> dict[str, np.ndarray]:
    """(v, 6, k) displacements and rotations for k sets of deviations (p, k)."""
    forces, read, fields = model.shape_forces @ deviations, model.shape @ deviations, {}
    for p, part in enumerate(assembly.parts):
        own, surface = model.compliance.functionals[p], part.surface
        H, G = model.compliance.H[p], model.compliance.G[p]
        strain = np.zeros(deviations.shape[1]) + sum(
            a * source.expansion().get(part.name, 0.0) for a, source in zip(deviations, sources(assembly.scene))
        )
        shaped = np.flatnonzero(read[own].any(axis=0))
        fields[part.name] = np.zeros((len(surface.points), 6, deviations.shape[1]))
        if not shaped.size:
            continue
        f, y, strain = forces[own][:, shaped], read[own][:, shaped], strain[shaped]
        solved, rigid = provider.find(part).field(part, f)
        motion = np.linalg.lstsq(G, y - H @ f - np.outer(dilation(part), strain), rcond=None)[0]
        field = solved + rigid @ motion
        field[:, :3] += surface.points[:, :, None] * strain
        fields[part.name][:, :, shaped] = field
    return fields


def with_shape(
    model: Model,
    assembly: Assembly,
    fields: Mapping[str, np.ndarray],
    own: Mapping[str, InfluenceCoefficients],
    deviations: np.ndarray,
) -> Model:
    """The model with the stiffness and the gaps of parts that have a given shape.

    Parameters
    ----------
    model : Reduction
        Of the nominal meshes, or with the stiffness of another shape.
    assembly : Assembly
        With nominal gaps.
    fields : mapping of str to (v, 6) array
        The shape at the vertices of each part, mm and rad.
    own : mapping of str to InfluenceCoefficients
        Of the parts that :func:`mic.model.deviated_geometry.deviated_parts` makes of it.
    deviations : (p,) array
        Those that give the shape.
    """
    gap, weld_gap = _gap_changes(model, assembly, fields, deviations)
    H, G = (tuple(getattr(own[part.name], key) for part in assembly.parts) for key in ("H", "G"))
    return replace(
        model,
        compliance=Blocks(H, G),
        contacts=replace(model.contacts, gap=assembly.contacts.gap + gap),
        weld_gap=assembly.weld_gap + weld_gap,
        slopes=None,
    )


def with_derivatives(
    model: Model,
    assembly: Assembly,
    fields: Mapping[str, np.ndarray],
    slopes: Mapping[str, Mapping[str, InfluenceDerivative]],
    deviations: np.ndarray,
) -> Model:
    """The model with compliance and gaps that follow the sources to first order, about its shape.

    Parameters
    ----------
    model : Reduction
        As :func:`with_shape` returns it.
    assembly : Assembly
        With nominal gaps.
    fields : mapping of str to (v, 6) array
        Its shape, by part.
    slopes : mapping of str to mapping of str to InfluenceDerivative
        By part, and by the deviation's name.
    deviations : (p,) array
        Those that give the shape.
    """
    known = {name: one.step for own in slopes.values() for name, one in own.items()}
    source = np.array([j for j, name in enumerate(model.parameters) if name in known], dtype=int)
    names = [model.parameters[j] for j in source]
    step = np.array([known[name] for name in names])
    gap, weld_gap = np.zeros((len(source), len(model.contacts))), np.zeros((len(source), len(model.weld_gap)))
    for i, (j, name) in enumerate(zip(source, names)):
        for sign in (1.0, -1.0):
            at = {
                part: field + sign * slopes[part][name].field if name in slopes[part] else field
                for part, field in fields.items()
            }
            moved = np.where(np.arange(len(deviations)) == j, sign * step[i], 0.0)
            for slope, values in zip((gap, weld_gap), _gap_changes(model, assembly, at, deviations + moved)):
                slope[i] += sign * values / (2 * step[i])
    changing = [np.array([i for i, name in enumerate(names) if name in slopes[part]], dtype=int) for part in fields]
    H, G = (
        tuple(
            np.array([getattr(slopes[part][names[i]], key) for i in own]).reshape(-1, *block.shape)
            for part, own, block in zip(fields, changing, blocks)
        )
        for key, blocks in (("H", model.compliance.H), ("G", model.compliance.G))
    )
    about = deviations[source]
    low, high = about - REACH * step, about + REACH * step
    return replace(model, slopes=ShapeDerivatives(source, about, low, high, tuple(changing), H, G, gap, weld_gap))


def _gap_changes(
    model: Reduction, assembly: Assembly, fields: Mapping[str, np.ndarray], deviations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of the gaps (m,) of contacts and (r,) of welds' rows with a shape, mm and rad: g(a) − g⁰ − N y⁰(a).

    These are the changes that the readings of the shape do not contain.
    """
    parts = deviated_parts(assembly, fields)
    gap, weld_gap = (
        gap_change(assembly, kind, parts, read) - read
        for kind in ("contact", "weld")
        for read in [model.rows[kind] @ (model.shape @ deviations)]
    )
    weld_gap[np.setdiff1d(np.arange(len(weld_gap)), model.joints.normals)] = 0.0
    return gap[:: assembly.contacts.dimension], weld_gap


def _slope(
    middle: InfluenceCoefficients,
    plus: InfluenceCoefficients,
    minus: InfluenceCoefficients,
    step: float,
    field: np.ndarray,
) -> InfluenceDerivative:
    """Derivatives by central differences over a step, on the pins of the middle."""
    G = (plus.G - minus.G) / (2 * step)
    U = (_without_pins(plus)[0] - _without_pins(minus)[0]) / (2 * step)
    pinned = G @ _without_pins(middle)[1]
    return InfluenceDerivative(step, field, U + pinned + pinned.T, G)


def _without_pins(one: InfluenceCoefficients) -> tuple[np.ndarray, np.ndarray]:
    """U (n, n) and A (6, n), with H = U + G A + Aᵀ Gᵀ and Gᵀ U = 0."""
    size = np.linalg.norm(one.G, axis=0)
    Q, R = np.linalg.qr(one.G / size)
    half = Q.T @ one.H
    H = one.H - Q @ half
    A = half - 0.5 * (half @ Q) @ Q.T
    return H - (H @ Q) @ Q.T, np.linalg.solve(R, A) / size[:, None]
