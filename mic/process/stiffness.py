"""The stiffness of the mean shape, or of each sample's to first order, in place of that of the nominal one.

Parts stand on meshes that carry the shape m which the means of the deviations give them; normals, frames and gaps of
contacts and welds go with them:

    H = L(m) K(m)⁻¹ L(m)ᵀ,      g = g⁰ + (g(m) − g⁰ − N y⁰(m)),

for all samples alike. What the deviations themselves read, y⁰ = Σ a_i y⁰_i, is counted from nominal as before: the
bracket is what that leaves out of the gaps of the mesh at m. What the fixture prescribes, and what is measured, keeps
its direction in space.

To first order each sample has a compliance and gaps of its own: those at m, and their derivatives with the sources that
turn the sheets most (:mod:`mic.model.shape_derivatives`), by differences between the shapes at m ± s_i e_i. The pins of each H are
chosen by conditioning, and others on the next mesh, by which differences would be off by as much as the derivative:
of ``U = P H P`` with ``P = 1 − G (GᵀG)⁻¹ Gᵀ``, which differs from H by rigid motions alone under forces that balance,
they are taken. On the pins of H(m), ``H(m) = U(m) + G(m) A + Aᵀ G(m)ᵀ``,

    ∂_i H = ∂_i U + ∂_i G A + Aᵀ ∂_i Gᵀ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from mic.process.actions import Joints

__all__ = ["Shapes", "carrying", "coefficients", "following", "listed", "most", "shape_fields", "wanted"]

Model = TypeVar("Model", bound=Reduction)

LEFT = 0.1  # of how the samples' shapes turn the sheets, root mean square: what sources without derivatives may make
LISTED = 6  # sources that are told by name
REACH = 6.0  # standard deviations about the mean for which derivatives are believed


@dataclass(frozen=True)
class Shapes:
    """Shapes whose stiffness is wanted, by displacements and rotations of each part's vertices (v, 6), mm and rad.

    Attributes
    ----------
    mean : dict of str to array
        That which the means of the deviations give, by part.
    along : dict of str to dict of str to array
        What one standard deviation adds, by the deviation's name and by part, of the sources along which derivatives
        are wanted.
    left : int
        How many sources vary the shapes besides.
    share : float
        What these make of how the samples' shapes turn the sheets.
    """

    mean: dict[str, np.ndarray]
    along: dict[str, dict[str, np.ndarray]]
    left: int = 0
    share: float = 0.0

    def beside(self, name: str, sign: float) -> dict[str, np.ndarray]:
        """A standard deviation of a source beside the mean."""
        return {part: field + sign * self.along[name][part] for part, field in self.mean.items()}

    def parts(self, assembly: Assembly) -> tuple[list[Part], dict[str, dict[str, tuple[Part, Part]]]]:
        """All parts as they carry the mean shape; and by the deviation's name and by part those that are others a
        standard deviation above and below it, by their mesh or by the normals of their contacts."""
        middle = deviated_parts(assembly, self.mean)
        whole = [part.fingerprint() for part in middle]
        ends = {}
        for name in self.along:
            both = zip(whole, *(deviated_parts(assembly, self.beside(name, sign)) for sign in (1.0, -1.0)))
            ends[name] = {
                plus.name: tuple(
                    replace(one, name=f"{one.name} at {name} {sign} 1 σ") for one, sign in ((plus, "+"), (minus, "−"))
                )
                for own, plus, minus in both
                if {plus.fingerprint(), minus.fingerprint()} != {own}
            }
        return middle, ends

    def further(self, assembly: Assembly) -> list[Part]:
        """All parts whose coefficients are wanted beside the nominal ones."""
        (middle, ends), known = self.parts(assembly), {part.fingerprint() for part in assembly.parts}
        every = [*middle, *(end for pairs in ends.values() for pair in pairs.values() for end in pair)]
        return [part for part in every if part.fingerprint() not in known]

    def __str__(self) -> str:
        """The sources in words."""
        told = listed(list(self.along))
        if self.left:
            told += f" ({self.left} more, which make {self.share:.1%} of how samples turn the sheets, are left out)"
        return told


def coefficients(
    assembly: Assembly, cache: Path, progress=None, comm: Any = None
) -> tuple[dict[str, InfluenceCoefficients], dict[str, bool]]:
    """Influence coefficients of all parts as the scene's ``stiffness`` asks for them, from the cache where they fit.

    Arguments, results and errors are those of :func:`mic.compliance.cache.influence_coefficients`. Where the stiffness
    of the mean shape is asked for, each has that besides (:attr:`InfluenceCoefficients.deviated`), and where it is to
    follow samples to first order, their derivatives (:attr:`InfluenceCoefficients.slopes`).
    """
    found, cached = influence_coefficients(assembly, cache, progress, comm)
    if assembly.scene.stiffness == "nominal":
        return found, cached
    first = comm is None or comm.rank == 0
    shapes = wanted(assembly, Reduction.build(assembly, found)) if first else None
    shapes = shapes if comm is None else comm.bcast(shapes)
    assert shapes is not None  # told by the first
    parts, ends = shapes.parts(assembly)
    if progress and assembly.scene.stiffness == "first-order":
        progress(f"stiffness to first order in {shapes}")
    beside = [end for pairs in ends.values() for pair in pairs.values() for end in pair]
    own, known = influence_coefficients(replace(assembly, parts=(*parts, *beside)), cache, progress, comm)
    both = {name: replace(one, deviated=(shapes.mean[name], own[name])) for name, one in found.items() if name in own}
    if first and assembly.scene.stiffness == "first-order":
        sigma = {item.name: item.sigma for item in assembly.scene.deviations}
        for part, one in both.items():
            slopes = {}
            for name, pairs in ends.items():
                if part in pairs:
                    plus, minus = (own[end.name] for end in pairs[part])
                    slopes[name] = _slope(own[part], plus, minus, sigma[name], shapes.along[name][part])
            both[part] = replace(one, slopes=slopes)
    for pairs in ends.values():
        for part, pair in pairs.items():
            known[part] = known[part] and all(known[end.name] for end in pair)
    return both, {name: cached[name] and known[name] for name in cached}


def most(assembly: Assembly) -> tuple[list[str], int]:
    """The sources that vary shapes, and how many sets of coefficients beside the nominal ones it takes at most to
    follow them to first order; known before any coefficients are.

    Parameters
    ----------
    assembly : Assembly
    """
    scene, names = assembly.scene, [part.name for part in assembly.parts]
    joined = [{*zone.parts} & {*names} for zone in scene.zones] + [{*weld.parts} for weld in scene.welds]
    sets, found = len(names), []
    for item, source in zip(scene.deviations, sources(scene)):
        control = source.known_shape(assembly.labels, assembly.rows)
        rows = source.load(assembly.labels, assembly.rows) if control is None else control.rows
        own = set(source.expansion())
        if rows is not None:
            own |= {names[p] for p in np.searchsorted(assembly.offsets, rows.indices, side="right") - 1}
        if own and item.sigma > 0:
            found.append(item.name)
            sets += 2 * len(own.union(*(both for both in joined if both & own)))
    return found, sets


def listed(names: Sequence[str]) -> str:
    """Sources in words, the first of many by name."""
    told = ", ".join(names[:LISTED])
    return f"{len(names)} sources: {told} …" if len(names) > LISTED else told or "no source"


def wanted(assembly: Assembly, nominal: Reduction) -> Shapes:
    """The shapes at which the scene's ``stiffness`` wants coefficients, beside the nominal one.

    Of the sources that vary shapes those are left out that turn the sheets least, as long as they turn them by no more
    than :data:`LEFT` of what all do, by the root mean square of rotations over the vertices, all parts alike. What
    stretches a sheet, as warmth does, hardly changes its stiffness. Correlated ones, of which squares do not add up,
    stay.

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
    left = np.zeros(len(shaping), dtype=bool)
    left[order] = np.cumsum(turned[order]) <= LEFT**2 * turned.sum()
    together = {name for table in scene.correlations for name in table.deviations}
    names = [scene.deviations[j].name for j in shaping]
    left &= [name not in together for name in names]
    along = {
        name: {part: field[:, :, k] for part, field in fields.items()} for k, name in enumerate(names) if not left[k]
    }
    share = np.sqrt(turned[left].sum() / turned.sum()) if left.any() and turned.any() else 0.0
    return Shapes(mean, along, int(left.sum()), float(share))


def shape_fields(assembly: Assembly, model: Reduction, deviations: np.ndarray) -> dict[str, np.ndarray]:
    """Displacements and rotations (v, 6) that deviations (p,) of shape give the vertices of each part, mm and rad.

    Parameters
    ----------
    assembly : Assembly
    model : Reduction
        Of its nominal meshes.
    deviations : (p,) array
    """
    return {name: field[:, :, 0] for name, field in _fields(assembly, model, deviations[:, None]).items()}


def _fields(assembly: Assembly, model: Reduction, deviations: np.ndarray) -> dict[str, np.ndarray]:
    """(v, 6, k) of k sets of deviations (p, k)."""
    forces, read, found = model.shape_forces @ deviations, model.shape @ deviations, {}
    for p, part in enumerate(assembly.parts):
        own, surface = model.compliance.functionals[p], part.surface
        H, G = model.compliance.H[p], model.compliance.G[p]
        strain = np.zeros(deviations.shape[1]) + sum(
            a * source.expansion().get(part.name, 0.0) for a, source in zip(deviations, sources(assembly.scene))
        )
        shaped = np.flatnonzero(read[own].any(axis=0))
        found[part.name] = np.zeros((len(surface.points), 6, deviations.shape[1]))
        if not shaped.size:
            continue
        f, y, strain = forces[own][:, shaped], read[own][:, shaped], strain[shaped]
        solved, rigid = provider.find(part).field(part, f)
        motion = np.linalg.lstsq(G, y - H @ f - np.outer(dilation(part), strain), rcond=None)[0]
        field = solved + rigid @ motion
        field[:, :3] += surface.points[:, :, None] * strain
        found[part.name][:, :, shaped] = field
    return found


def carrying(
    model: Model,
    assembly: Assembly,
    fields: Mapping[str, np.ndarray],
    own: Mapping[str, InfluenceCoefficients],
    deviations: np.ndarray,
) -> Model:
    """The model with the stiffness and the gaps of parts that carry a shape.

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
    gap, weld_gap = _beyond(model, assembly, fields, deviations)
    found = [own[part.name] for part in assembly.parts]
    return replace(
        model,
        compliance=Blocks(tuple(one.H for one in found), tuple(one.G for one in found)),
        contacts=replace(model.contacts, gap=assembly.contacts.gap + gap),
        weld_gap=assembly.weld_gap + weld_gap,
        slopes=None,
    )


def following(
    model: Model,
    assembly: Assembly,
    fields: Mapping[str, np.ndarray],
    slopes: Mapping[str, Mapping[str, InfluenceDerivative]],
    deviations: np.ndarray,
) -> Model:
    """The model with compliance and gaps that go with the sources, about the shape that it carries.

    Parameters
    ----------
    model : Reduction
        As :func:`carrying` makes it.
    assembly : Assembly
        With nominal gaps.
    fields : mapping of str to (v, 6) array
        The shape that it carries, by part.
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
            for told, values in zip((gap, weld_gap), _beyond(model, assembly, at, deviations + moved)):
                told[i] += sign * values / (2 * step[i])
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


def _beyond(
    model: Reduction, assembly: Assembly, fields: Mapping[str, np.ndarray], deviations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """By how much gaps (m,) of the contacts and (r,) of the welds' rows change with a shape, mm and rad, beyond what
    its readings say: g(a) − g⁰ − N y⁰(a)."""
    parts = deviated_parts(assembly, fields)
    gap, weld_gap = (
        gap_change(assembly, kind, parts, read) - read
        for kind in ("contact", "weld")
        for read in [model.rows[kind] @ (model.shape @ deviations)]
    )
    normal = Joints(tuple(model.weld_size)).normals
    weld_gap[np.setdiff1d(np.arange(len(weld_gap)), normal)] = 0.0
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
    U = (_unpinned(plus)[0] - _unpinned(minus)[0]) / (2 * step)
    pinned = G @ _unpinned(middle)[1]
    return InfluenceDerivative(step, field, U + pinned + pinned.T, G)


def _unpinned(one: InfluenceCoefficients) -> tuple[np.ndarray, np.ndarray]:
    """U (n, n) and A (6, n), with H = U + G A + Aᵀ Gᵀ and Gᵀ U = 0."""
    size = np.linalg.norm(one.G, axis=0)
    Q, R = np.linalg.qr(one.G / size)
    half = Q.T @ one.H
    H = one.H - Q @ half
    A = half - 0.5 * (half @ Q) @ Q.T
    return H - (H @ Q) @ Q.T, np.linalg.solve(R, A) / size[:, None]
