"""The stress-free shape that each source gives its part, as readings of the retained functionals.

The part is held on a statically determinate choice of the locators that it is set down on, or of these and contacts on
which it rests, while the source's force f⁰ acts; the deformed shape is then the part's stress-free shape. A deviation
is measured from there, so it vanishes there:

    y⁰ = H_s f⁰,        with H_s supported on these datum rows.                                        (1)

Where the shape is known at points, ``v`` mm each, and the force is not, the sheet takes the shape of least bending
energy through them: with the compliance C = R H_s Rᵀ and the rigid readings G_R = R G of the rows R that read it there,

    f⁰ = Rᵀ f,        (C + λ W) f + G_R q = v,        G_Rᵀ f = 0,                                       (2)

with any position q of the part if it was measured loose, without q and the last line if it was set down. It is a
smoothing spline of the sheet's own stiffness, so that nothing is carried across a fold that the sheet does not carry.
λ = 0 passes through the values. Where they are uncertain by σ_i, ``W = diag σ_i²``, what is found is ``A_λ v``, and
λ is the one of least expected error, by its unbiased estimate ``Σ_i (v − A_λ v)_i²/σ_i² + 2 tr A_λ`` (Craven, Wahba),
for each shape its own.

A part that has grown by the strain ε in all directions, as a warmer one has, is free of stress, too: ``y⁰`` reads the
displacement ``ε x``, less the rigid motion that the datum rows would read of it, and f⁰ = 0.

A sheet that is thicker by τ has its faces, of which contacts, welds and the points between contacts read, τ/2 farther
out, or τ and nothing where one of them stays: y⁰ reads that, and nothing at all else, and f⁰ = 0.

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
from mic.compliance.support import completing, independent, motion_size, statically_determinate
from mic.errors import FreeMotion, SceneError
from mic.model.sources import Control, sources
from mic.scene.stages import set_down_in

__all__ = ["controlling_forces", "datum_rows", "known_shapes", "shape_readings"]

SOFT, TRIALS = 1e-4, 400  # where λ is looked for, beyond the least and the largest compliance; steps of a few per cent
UNBENT = 1e-10  # of the largest compliance: a force that bends the part less than that shapes nothing


def datum_rows(assembly, p: int, G: np.ndarray) -> csr_matrix:
    """(6, F_p) rows that part p's shape is measured from: locators, six that hold it, of those it is set down on.

    Of a part that these leave free, rows of its contacts complete them: it is measured from where it rests.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    p : int
    G : (F_p, 6) array
        What the part's functionals read of its rigid motions.

    Raises
    ------
    FreeMotion
        If locators and contacts read less than six motions.
    """
    scene, name, size = assembly.scene, assembly.parts[p].name, motion_size((G,))
    functionals = slice(assembly.offsets[p], assembly.offsets[p + 1])
    first = set_down_in(scene)[name]
    own = [i for i, item in enumerate(scene.locators) if item.part == name and item.stage == first]
    locators = assembly.rows["locator"][own][:, functionals]
    try:
        return locators[statically_determinate(locators @ G, size)]
    except FreeMotion:
        contacts = assembly.rows["contact"][:, functionals]
        locators = locators[independent(locators @ G, size)]
        return vstack([locators, contacts[completing(locators @ G, contacts @ G, size)]], format="csr")


def known_shapes(assembly) -> Iterator[tuple[list[int], list[Control]]]:
    """The deviations whose shape is known at points, those that share their rows together: their numbers, and what is
    known of each."""
    shared: dict[tuple, tuple[list[int], list[Control]]] = {}
    for j, source in enumerate(sources(assembly.scene)):
        control = source.control(assembly.labels, assembly.rows)
        if control is not None:
            columns, controls = shared.setdefault((*control.rows.indices, control.loose), ([], []))
            columns.append(j)
            controls.append(control)
    yield from shared.values()


def controlling_forces(C: np.ndarray, G: np.ndarray, controls: Sequence[Control], name: str) -> np.ndarray:
    """Forces (c, q) on the rows that give a part the q shapes that are known there: f of equation (2).

    Parameters
    ----------
    C : (c, c) array
        Compliance of the rows while the datum rows hold, mm/N.
    G : (c, 6) array
        What they read of the part's rigid motions.
    controls : sequence of Control
        With the same rows.
    name : str
        What they belong to, for messages.

    Raises
    ------
    SceneError
        If two points are one, or a point stands where the part is held.
    """
    V = np.array([control.value for control in controls]).T
    loose = controls[0].loose
    variance = sum(control.noise**2 for control in controls)
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
            + ", where the shape cannot be another; move it, or remove it"
        )
    amplitude = modes.T @ N.T @ V
    λ = np.zeros(len(controls))
    if noisy:
        σ2 = np.array([np.mean(control.noise**2) for control in controls])
        trial = np.geomspace(SOFT * stiff[0], stiff[-1] / SOFT, TRIALS)
        missed = (trial / (stiff[:, None] + trial)) ** 2
        followed = stiff[:, None] / (stiff[:, None] + trial)
        risk = (amplitude**2).T @ missed + 2 * np.outer(σ2, followed.sum(axis=0))
        λ = trial[np.argmin(risk, axis=1)]
    return N @ modes @ (amplitude / (stiff[:, None] + λ)) / weight[:, None]


def shape_readings(assembly, compliance: Blocks) -> tuple[np.ndarray, np.ndarray]:
    """Readings y⁰ (F, p), and the forces f⁰ with their reactions (F, p), of a unit of each of the scene's p deviations.

    Columns of sources that give no shape are zero.

    Raises
    ------
    SceneError
        As :func:`controlling_forces`.
    """
    F, made = compliance.size, sources(assembly.scene)
    shape, forces = np.zeros((F, len(made))), np.zeros((F, len(made)))

    def take(load: csr_matrix, p: int):
        """What part p reads of loads (l, F), held on its datum rows, (F_p, l), and the reactions with them (F_p, l)."""
        own, part = compliance.functionals[p], compliance.part(p)
        datum = datum_rows(assembly, p, compliance.G[p])
        none = csr_matrix((0, part.size))
        response = eliminate(part, datum, none, load[:, own], identity(part.size, format="csr"))
        return response.L_out, load[:, own].T.toarray() + datum.T @ response.reaction_L

    for j, source in enumerate(made):
        load = source.load(assembly.labels, assembly.rows)
        for p in () if load is None else _parts(load, compliance):
            own = compliance.functionals[p]
            reading, force = take(load, p)
            shape[own, j], forces[own, j] = reading[:, 0], force[:, 0]
        for name, skin in source.thickening().items():
            p = [part.name for part in assembly.parts].index(name)
            shape[compliance.functionals[p], j] = thickening(assembly, p, skin)
        for name, strain in source.expansion().items():
            p = [part.name for part in assembly.parts].index(name)
            own, G = compliance.functionals[p], compliance.G[p]
            grown, datum = strain * dilation(assembly.parts[p]), datum_rows(assembly, p, G)
            shape[own, j] += grown - G @ np.linalg.solve(datum @ G, datum @ grown)
    for columns, controls in known_shapes(assembly):
        (p,), R = _parts(controls[0].rows, compliance), controls[0].rows
        own = compliance.functionals[p]
        reading, force = take(R, p)
        name = f"deviations[{columns[0]}] ({assembly.scene.deviations[columns[0]].name})"
        f = controlling_forces(R[:, own] @ reading, R[:, own] @ compliance.G[p], controls, name)
        shape[np.arange(F)[own, None], columns] = reading @ f
        forces[np.arange(F)[own, None], columns] = force @ f
    return shape, forces


def dilation(part) -> np.ndarray:
    """(F_p,) what a part's functionals read of the displacement ``u = x``, mm; the thickness stays as it is.

    Parameters
    ----------
    part : mic.compliance.part.Part
    """
    f, surface = part.functionals, part.surface
    at = np.array([one.weight @ surface.at(one.triangle, one.barycentric) for one in f.patches]).reshape(-1, 3)
    return np.where(f.rotation, 0.0, np.einsum("id,id->i", f.direction, at[f.patch]))


def thickening(assembly, p: int, skin: int) -> np.ndarray:
    """(F_p,) how far the faces that part p's functionals read move along them where it is 1 mm thicker, mm.

    A joint's normal points from its first body to its second: its row reads the face of the first with −1, and towards
    the second.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    p : int
    skin : int
        Which face stays: 1 that on the side of the mesh's normals, -1 the other, 0 neither but the middle.
    """
    part, own = assembly.parts[p], slice(assembly.offsets[p], assembly.offsets[p + 1])
    first = np.cumsum([0, *assembly.weld_size])[: len(assembly.weld_size)]
    joints = (
        assembly.rows["contact"][:: assembly.contacts.dimension],
        assembly.rows["between"],
        assembly.rows["weld"][first],
    )
    moved = np.zeros(len(part.functionals))
    for rows in joints:
        entries = rows[:, own].tocoo()
        for i, share in zip(entries.col, entries.data):
            patch = part.functionals.patches[part.functionals.patch[i]]
            normal = np.abs(patch.weight) @ part.surface.normals[patch.triangle]
            side = -share * np.sign(normal @ part.functionals.direction[i])  # of the face, among the mesh's normals
            moved[i] = -share * 0.5 * (1.0 - skin * side)
    return moved


def _parts(load: csr_matrix, compliance: Blocks) -> np.ndarray:
    """The parts that a load acts on."""
    return np.unique(np.searchsorted(compliance.offsets, load.indices, side="right") - 1)
