"""The stress-free shape that each source gives its part, as readings of the retained functionals.

The part is held on a statically determinate choice of the locators that it is set down on, or of these and the contacts
that it rests on, while the source's force f⁰ acts; the deformed shape is then the part's stress-free shape. A deviation
is measured relative to these datum rows, so it is zero there:

    y⁰ = H_s f⁰,        with H_s supported on the datum rows.                                          (1)

If the shape is known at points, ``v`` mm each, instead of the force, the sheet takes the shape of least bending energy
through them: with the compliance C = R H_s Rᵀ and the rigid readings G_R = R G of the rows R that read it there,

    f⁰ = Rᵀ f,        (C + λ W) f + G_R q = v,        G_Rᵀ f = 0,                                       (2)

with any position q for a part that was measured loose, without q and the last line for one that was set down. It is a
smoothing spline with the sheet's own stiffness: it carries nothing across a fold that the sheet does not carry. λ = 0
passes through the values. For values with uncertainties σ_i, ``W = diag σ_i²``, the shape at the points is ``A_λ v``,
and λ minimises the unbiased estimate of the expected error, ``Σ_i (v − A_λ v)_i²/σ_i² + 2 tr A_λ`` (Craven, Wahba), for
each shape separately.

A part expanded by the isotropic strain ε, such as a warmer one, is also free of stress: ``y⁰`` reads the displacement
``ε x``, less the rigid motion that the datum rows would read of it, and f⁰ = 0.

A sheet that is thicker by τ has its faces, which contacts, welds and the points between contacts read, τ/2 farther
out, or one of them τ farther out if the other stays: y⁰ reads only this motion, and f⁰ = 0.

References
----------
G. Wahba: Spline models for observational data. SIAM (1990): smoothing splines, chapters 1 and 4.
P. Craven, G. Wahba: Smoothing noisy data with spline functions. *Numer. Math.* 31 (1979), 377–403: section 3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import null_space
from scipy.sparse import csr_matrix, identity, vstack

from mic.compliance.blocks import Blocks
from mic.compliance.elimination import eliminate
from mic.compliance.support import completing_rows, independent_rows, motion_size, statically_determinate
from mic.errors import FreeMotion, SceneError
from mic.geometry.pairing.standing_edges import STEEP
from mic.model.sources import KnownShape, sources
from mic.scene.stages import placing_stages
from mic.system.matrix_product import product_of

__all__ = ["controlling_forces", "datum_rows", "known_shapes", "shape_readings"]

SOFT, TRIALS = 1e-4, 400  # λ is sought from SOFT · least to largest compliance / SOFT, in steps of a few per cent
UNBENT = 1e-10  # relative to the largest compliance: a force that bends the part less shapes nothing


def datum_rows(assembly, p: int, G: np.ndarray) -> csr_matrix:
    """(6, F_p) datum rows of part p: six of the locators that it is set down on, chosen to hold it.

    If these leave motions free, rows of the part's contacts complete them.

    Parameters
    ----------
    assembly : mic.model.assembly_types.Assembly
    p : int
    G : (F_p, 6) array
        Readings of the part's functionals under its rigid motions.

    Raises
    ------
    FreeMotion
        If locators and contacts read less than six motions.
    """
    scene, name, size = assembly.scene, assembly.parts[p].name, motion_size((G,))
    functionals = slice(assembly.offsets[p], assembly.offsets[p + 1])
    first = placing_stages(scene)[name]
    numbers = [i for i, item in enumerate(scene.locators) if item.part == name and item.stage == first]
    locators = assembly.rows["locator"][numbers][:, functionals]
    try:
        return locators[statically_determinate(locators @ G, size)]
    except FreeMotion:
        contacts = assembly.rows["contact"][:, functionals]
        locators = locators[independent_rows(locators @ G, size)]
        return vstack([locators, contacts[completing_rows(locators @ G, contacts @ G, size)]], format="csr")


def known_shapes(assembly) -> Iterator[tuple[list[int], list[KnownShape]]]:
    """Deviations with known shapes, grouped by common rows: their numbers, and the known shapes."""
    groups: dict[tuple, tuple[list[int], list[KnownShape]]] = {}
    for j, source in enumerate(sources(assembly.scene)):
        known = source.known_shape(assembly.labels, assembly.rows)
        if known is not None:
            numbers, shapes = groups.setdefault((*known.rows.indices, known.loose), ([], []))
            numbers.append(j)
            shapes.append(known)
    yield from groups.values()


def controlling_forces(C: np.ndarray, G: np.ndarray, shapes: Sequence[KnownShape], name: str) -> np.ndarray:
    """Forces (c, q) on the rows that give a part q known shapes: f of equation (2).

    Parameters
    ----------
    C : (c, c) array
        Compliance of the rows while the datum rows hold, mm/N.
    G : (c, 6) array
        Readings of the rows under the part's rigid motions.
    shapes : sequence of KnownShape
        With the same rows.
    name : str
        Scene key, for messages.

    Raises
    ------
    SceneError
        If two points coincide, or a point coincides with a locator that holds the part.
    """
    V = np.array([known.value for known in shapes]).T
    loose = shapes[0].loose
    variance = sum(known.noise**2 for known in shapes)
    noisy = bool(np.any(variance))
    weight = np.sqrt(variance / np.mean(variance)) if noisy else np.ones(len(C))  # W^½
    C, G, V = C / np.outer(weight, weight), G / weight[:, None], V / weight[:, None]  # for W^½ f
    N = null_space(G.T, rcond=1e-9) if loose else np.eye(len(C))
    stiff, modes = np.linalg.eigh(0.5 * N.T @ (C + C.T) @ N)
    if stiff[0] <= UNBENT * stiff[-1]:
        place = int(np.argmax(np.abs(N @ modes[:, 0])))
        raise SceneError(
            f"{name}: points[{place}] coincides with another point"
            + (", or with a locator" * (not loose))
            + ", where the shape is already given; move it, or remove it"
        )
    amplitude = modes.T @ N.T @ V
    λ = np.zeros(len(shapes))
    if noisy:
        σ2 = np.array([np.mean(known.noise**2) for known in shapes])
        trial = np.geomspace(SOFT * stiff[0], stiff[-1] / SOFT, TRIALS)
        residual = (trial / (stiff[:, None] + trial)) ** 2
        trace = stiff[:, None] / (stiff[:, None] + trial)
        risk = (amplitude**2).T @ residual + 2 * np.outer(σ2, trace.sum(axis=0))
        λ = trial[np.argmin(risk, axis=1)]
    return N @ modes @ (amplitude / (stiff[:, None] + λ)) / weight[:, None]


def shape_readings(assembly, compliance: Blocks) -> tuple[np.ndarray, np.ndarray]:
    """Readings y⁰ (F, p), and forces f⁰ with their reactions (F, p), per unit of each of the scene's p deviations.

    Columns of sources that do not change shapes are zero.

    Raises
    ------
    SceneError
        As :func:`controlling_forces`.
    """
    F, of_scene = compliance.size, sources(assembly.scene)
    shape, forces = np.zeros((F, len(of_scene))), np.zeros((F, len(of_scene)))
    number = {part.name: p for p, part in enumerate(assembly.parts)}

    def response(load: csr_matrix, p: int):
        """Readings (F_p, l) of part p under loads (l, F), held on its datum rows, and the loads with reactions."""
        functionals, part = compliance.functionals[p], compliance.part(p)
        datum = datum_rows(assembly, p, compliance.G[p])
        none = csr_matrix((0, part.size))
        every = identity(part.size, format="csr")
        held = eliminate(part, datum, none, load[:, functionals], every, multiply=product_of(len(assembly.contacts)))
        return held.L_out, load[:, functionals].T.toarray() + datum.T @ held.reaction_L

    for j, source in enumerate(of_scene):
        load = source.load(assembly.labels, assembly.rows)
        for p in () if load is None else _loaded_parts(load, compliance):
            functionals = compliance.functionals[p]
            reading, force = response(load, p)
            shape[functionals, j], forces[functionals, j] = reading[:, 0], force[:, 0]
        for name, skin in source.thickening().items():
            shape[compliance.functionals[number[name]], j] = thickening(assembly, number[name], skin)
        for name, strain in source.expansion().items():
            p = number[name]
            functionals, G = compliance.functionals[p], compliance.G[p]
            expanded, datum = strain * dilation(assembly.parts[p]), datum_rows(assembly, p, G)
            shape[functionals, j] += expanded - G @ np.linalg.solve(datum @ G, datum @ expanded)
    for columns, shapes in known_shapes(assembly):
        R = shapes[0].rows
        (p,) = _loaded_parts(R, compliance)
        functionals = compliance.functionals[p]
        reading, force = response(R, p)
        label = of_scene[columns[0]].label
        f = controlling_forces(R[:, functionals] @ reading, R[:, functionals] @ compliance.G[p], shapes, label)
        shape[np.arange(F)[functionals, None], columns] = reading @ f
        forces[np.arange(F)[functionals, None], columns] = force @ f
    return shape, forces


def dilation(part) -> np.ndarray:
    """(F_p,) readings of a part's functionals under the displacement ``u = x``, mm, with constant thickness.

    Parameters
    ----------
    part : mic.compliance.part.Part
    """
    f, surface = part.functionals, part.surface
    at = np.array([one.weight @ surface.at(one.triangle, one.barycentric) for one in f.patches]).reshape(-1, 3)
    return np.where(f.rotation, 0.0, np.einsum("id,id->i", f.direction, at[f.patch]))


def thickening(assembly, p: int, skin: int) -> np.ndarray:
    """(F_p,) motion of the faces that part p's functionals read, along their directions, per mm of thickness, mm.

    A joint's normal points from its first body to its second: its row reads the face of the first with −1, and towards
    the second.

    Parameters
    ----------
    assembly : mic.model.assembly_types.Assembly
    p : int
    skin : int
        The face that stays: 1 on the side of the mesh's normals, -1 on the other, 0 the mid-surface.
    """
    part, functionals = assembly.parts[p], slice(assembly.offsets[p], assembly.offsets[p + 1])
    rows = assembly.rows
    joints = (rows["contact"][:: assembly.contacts.dimension], rows["between"], rows["weld"][assembly.joints.first])
    moved = np.zeros(len(part.functionals))
    for joint in joints:
        entries = joint[:, functionals].tocoo()
        for i, share in zip(entries.col, entries.data):
            patch = part.functionals.patches[part.functionals.patch[i]]
            normal = np.abs(patch.weight) @ part.surface.normals[patch.triangle]
            facing = normal @ part.functionals.direction[i]
            if part.functionals.side[i] == 0.0 and abs(facing) < STEEP * np.linalg.norm(normal):
                continue  # read at the edge on which the sheet stands
            side = -share * np.sign(facing)  # of the face, relative to the normals
            moved[i] = -share * 0.5 * (1.0 - skin * side)
    return moved


def _loaded_parts(load: csr_matrix, compliance: Blocks) -> np.ndarray:
    """Numbers of the parts that a load acts on."""
    return np.unique(np.searchsorted(compliance.offsets, load.indices, side="right") - 1)
