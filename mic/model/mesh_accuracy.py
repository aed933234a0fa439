"""How far a part's mesh leaves its influence coefficients from their limit, and what a finer mesh would cost.

The same functionals are read on the mesh as it is and on one of half the size. With h the element size, elements whose
energy is of second order leave

    H(h) − H₀ ≈ (H(h) − H(h′)) · r²/(r² − 1),        r = h/h′ = √(k′/k) for k and k′ triangles,

a factor 4/3 where r = 2. Estimated are Frobenius norms over those of H(h′),

- of H between the rows that push across the sheet: contact normals, welds' normals, clamps, corrective forces;
- of each key characteristic's influence: what it reads per newton on each of these rows.

A geometry script need not make everything finer: a size that it sets by itself, at a hole or under a pad, is the same
on both meshes, and with it its error. Where the triangles under a functional that is compared stay as large as they
were, the mesh is divided on the curved surface that its normals tell of instead (:mod:`mic.geometry.refinement`).

H belongs to a free part; it is compared on the six locators that the part is set down on, and on all that it has. A few
contact pairs of each zone stand for all.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_matrix, vstack

from mic.compliance import provider
from mic.compliance.blocks import Blocks
from mic.compliance.elimination import eliminate
from mic.compliance.functional import Functionals
from mic.compliance.part import Part
from mic.compliance.support import completing, motion_size
from mic.errors import SceneError
from mic.geometry.load import finer_surface
from mic.geometry.refinement import halved
from mic.geometry.surface import Patch, Surface
from mic.model.shape import datum_rows
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint

if TYPE_CHECKING:
    from mic.model.assembly import Assembly
from mic.model.characteristics import Characteristics

__all__ = ["Accuracy", "Estimate", "Mesh", "estimate_accuracy", "on_halved_meshes"]

KEPT = Format("estimate of accuracy", 1, ABSENT)
PAIRS = 24  # of each zone, that stand for all
FINER = 0.5  # of a triangle's area: at half the size it is a quarter
ORDER = 2  # of the elements' energy in the element size
COMPLIANCE = "H"  # what the first estimate of a part is called


@dataclass(frozen=True)
class Mesh:
    """A mesh that was solved on.

    Attributes
    ----------
    nodes, triangles : int
    seconds : float
        From the surface to the coefficients at the functionals that were compared.
    memory : float
        MB that the factors took; 0 where the provider does not tell.
    """

    nodes: int
    triangles: int
    seconds: float
    memory: float


@dataclass(frozen=True)
class Estimate:
    """Estimated error of one quantity, over its size.

    Attributes
    ----------
    quantity : str
        ``"H"``, or the name of a key characteristic.
    set_down : float
        With the part on the six locators that it is set down on.
    located : float
        With the part on all its locators.
    """

    quantity: str
    set_down: float
    located: float


@dataclass(frozen=True)
class Accuracy:
    """What the mesh of a part leaves.

    Attributes
    ----------
    part : str
    mesh, finer : Mesh
        As it is, and at half the size.
    estimates : tuple of Estimate
        Of H first.
    """

    part: str
    mesh: Mesh
    finer: Mesh
    estimates: tuple[Estimate, ...]

    @property
    def worst(self) -> float:
        """The largest of all estimates."""
        return max(max(one.set_down, one.located) for one in self.estimates)

    @property
    def ratio(self) -> float:
        """r: element size over that of the finer mesh."""
        return float(np.sqrt(self.finer.triangles / self.mesh.triangles))

    @property
    def growth(self) -> float:
        """Exponent with which the time grows with the number of nodes, as measured; at least 1."""
        return max(
            1.0, float(np.log(self.finer.seconds / self.mesh.seconds) / np.log(self.finer.nodes / self.mesh.nodes))
        )

    def reach(self, error: float) -> Mesh:
        """The mesh that would leave no more than `error` at worst: sizes by the order, time and memory as they grew."""
        share = (self.worst / error) ** (2 / ORDER)  # triangles per triangle
        memory = 1.0
        if self.mesh.memory:
            memory = float(np.log(self.finer.memory / self.mesh.memory) / np.log(self.finer.nodes / self.mesh.nodes))
        return Mesh(
            round(self.mesh.nodes * share),
            round(self.mesh.triangles * share),
            self.mesh.seconds * share**self.growth,
            self.mesh.memory * share**memory,
        )


def estimate_accuracy(
    assembly: Assembly,
    cache: Path,
    progress: Callable[[str], None] | None = None,
    parts: Collection[str] | None = None,
) -> tuple[Accuracy, ...]:
    """Estimate what the mesh of each part of an assembly leaves.

    Parameters
    ----------
    assembly : Assembly
    cache : Path
        Folder of generated meshes, and of estimates that were made before.
    progress : callable, optional
        Called with one line of text before each part that is computed.
    parts : collection of str, optional
        Names of those that are asked for; default: all.

    Raises
    ------
    SceneError
        If a part cannot be meshed at half the size.
    MissingProvider
    """
    kept, found = Cache(cache, "influence", KEPT), []
    for p, part in enumerate(assembly.parts):
        if (parts is not None and part.name not in parts) or part.superelement is not None:
            continue  # a superelement has no mesh that could be finer
        question = _Question.of(assembly, p)
        finer = finer_surface(assembly.scene.parts[p], assembly.scene.folder, cache, assembly.sizes.get(part.name))
        if not len(finer.triangles) > len(assembly.surfaces[part.name].triangles):
            raise SceneError(
                f"part {part.name!r}: geometry: the script makes no more triangles at half the size; let build(part, "
                "size) take notice of the size"
            )
        if not _finer_everywhere(question.part, finer):
            finer = Surface(*halved(part.surface.points, part.surface.triangles, part.surface.corner_normals))
        name = fingerprint(
            [part.fingerprint(), _digest(finer), question.labels]
            + [[matrix.indices.tolist(), matrix.data.tolist()] for matrix in question.rows]
        )
        old = kept.find(name)
        if old is None:
            if progress:
                progress(
                    f"accuracy of {part.name}: {len(question.part.functionals)} functionals, "
                    f"{len(part.surface.points)} and {len(finer.points)} nodes"
                )
            found.append(_estimate(question, finer))
            kept.keep(name, {"accuracy": json.dumps(asdict(found[-1]))}, {"none": np.zeros(0)})
        else:
            found.append(_read(json.loads(old[0]["accuracy"])))
    return tuple(found)


def on_halved_meshes(assembly: Assembly) -> Assembly:
    """The assembly on meshes of half the size: each triangle divided into four on the curved surface, and the same
    rows, their patches and pairs at the same points.

    Superelements stay what they are.
    """
    parts = []
    for part in assembly.parts:
        if part.superelement is None:
            surface = Surface(*halved(part.surface.points, part.surface.triangles, part.surface.corner_normals))
            patches = tuple(_carried(part.surface, surface, list(part.functionals.patches)))
            part = replace(part, surface=surface, functionals=replace(part.functionals, patches=patches))
        parts.append(part)
    return replace(assembly, parts=tuple(parts))


def _read(table: dict[str, Any]) -> Accuracy:
    estimates = tuple(Estimate(**one) for one in table["estimates"])
    return Accuracy(table["part"], Mesh(**table["mesh"]), Mesh(**table["finer"]), estimates)


def _digest(surface: Surface) -> str:
    arrays = [surface.points, surface.triangles, surface.corner_normals]
    return fingerprint([array.tobytes().hex() for array in arrays])


@dataclass(frozen=True)
class _Question:
    """A part with the functionals that are compared alone, and the rows over them.

    Attributes
    ----------
    part : Part
    pushing : (a, n) csr_matrix
        Rows that push across the sheet.
    reading : (m, n) csr_matrix
        The part's key characteristics.
    datum, locators : csr_matrix
        The locators that the part is set down on, six that hold it, and all that it has.
    labels : list of str
        Names of the key characteristics.
    """

    part: Part
    pushing: csr_matrix
    reading: csr_matrix
    datum: csr_matrix
    locators: csr_matrix
    labels: list[str]

    @property
    def rows(self) -> tuple[csr_matrix, ...]:
        return self.pushing, self.reading, self.datum, self.locators

    @classmethod
    def of(cls, assembly: Assembly, p: int) -> _Question:
        own = slice(assembly.offsets[p], assembly.offsets[p + 1])
        part, contacts = assembly.parts[p], assembly.contacts
        rows = {kind: matrix[:, own].tocsr() for kind, matrix in assembly.rows.items()}
        touches = {kind: np.flatnonzero(np.diff(matrix.indptr)) for kind, matrix in rows.items()}
        normals = touches["contact"][touches["contact"] % contacts.dimension == 0]
        zone = contacts.zone[normals // contacts.dimension]
        normals = np.concatenate([np.zeros(0, int), *(_few(normals[zone == z]) for z in np.unique(zone))])
        welds = np.intersect1d(touches["weld"], np.concatenate([[0], np.cumsum(assembly.weld_size)[:-1]]))
        pushing = vstack(
            [
                rows["contact"][normals],
                rows["weld"][welds.astype(int)],
                rows["clamp"][touches["clamp"]],
                rows["force"][touches["force"]],
            ],
            format="csr",
        )
        if not pushing.shape[0]:  # a part that nothing touches is judged by where it is measured
            pushing = rows["measurement"][touches["measurement"]]
        if not pushing.shape[0]:
            pushing = rows["locator"][touches["locator"]]
        G, locators = _rigid(part), rows["locator"][touches["locator"]]
        datum = datum_rows(assembly, p, G)
        rests = completing(locators @ G, datum @ G, motion_size((G,)))  # what its locators leave free
        tables = {
            "pushing": pushing,
            "reading": rows["measurement"][touches["measurement"]],
            "datum": datum,
            "locators": vstack([locators, datum[rests]], format="csr") if len(rests) else locators,
        }
        used = np.unique(np.concatenate([table.indices for table in tables.values()]))
        count = np.diff(Characteristics.of(assembly.scene).start)
        labels = np.repeat([item.name for item in assembly.scene.measurements], count)[touches["measurement"]].tolist()
        own_rows = {name: table[:, used].tocsr() for name, table in tables.items()}
        return cls(part=_restricted(part, used), labels=labels, **own_rows)


def _few(rows):
    """At most `PAIRS` of the rows, evenly."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(PAIRS, len(rows))).round().astype(int))]


def _rigid(part: Part) -> np.ndarray:
    """(n, 6) what the functionals of a part read of its rigid motions, about the surface's centroid.

    u = a + ω × (x − c), θ = ω; a functional off the mid-surface by s reads u + θ × s n.
    """
    f, surface = part.functionals, part.surface
    G = np.zeros((len(f), 6))
    for i in range(len(f)):
        patch, d = f.patches[f.patch[i]], f.direction[i]
        if f.rotation[i]:
            G[i, 3:] = d
            continue
        offset = f.side[i] * part.thickness / 2 * surface.normals[patch.triangle]
        arm = patch.weight @ (surface.at(patch.triangle, patch.barycentric) + offset) - surface.centroid
        G[i, :3], G[i, 3:] = d, np.cross(arm, d)
    return G


def _restricted(part: Part, functionals: np.ndarray, surface: Surface | None = None) -> Part:
    """The part with some of its functionals alone, on another mesh of the same surface where one is given."""
    f = part.functionals
    patches, number = np.unique(f.patch[functionals], return_inverse=True)
    own = [f.patches[i] for i in patches]
    if surface is not None:
        own = _carried(part.surface, surface, own)
    kept = Functionals(
        tuple(own),
        number.ravel(),
        f.direction[functionals],
        f.rotation[functionals],
        f.side[functionals],
        tuple(f.label[i] for i in functionals),
    )
    return Part(
        part.name, part.surface if surface is None else surface, part.thickness, part.young, part.poisson,
        part.element, kept,
    )  # fmt: skip


def _carried(surface: Surface, other: Surface, patches: list[Patch]) -> list[Patch]:
    """The patches of a surface on another mesh of it: every point at its closest, with its weight."""
    triangle = np.concatenate([patch.triangle for patch in patches])
    barycentric = np.concatenate([patch.barycentric for patch in patches])
    foot = other.project(surface.at(triangle, barycentric), surface.normals[triangle])
    ends = np.cumsum([len(patch.weight) for patch in patches])[:-1]
    pieces = zip(np.split(foot.triangle, ends), np.split(foot.barycentric, ends), patches)
    return [Patch(triangle, barycentric, patch.weight) for triangle, barycentric, patch in pieces]


def _finer_everywhere(part: Part, finer: Surface) -> bool:
    """Whether the triangles under each of the part's functionals are smaller on the other mesh of its surface."""
    patches = [part.functionals.patches[i] for i in np.unique(part.functionals.patch)]
    return all(
        other.weight @ finer.areas[other.triangle] < FINER * (patch.weight @ part.surface.areas[patch.triangle])
        for patch, other in zip(patches, _carried(part.surface, finer, patches))
    )


def _estimate(question: _Question, surface: Surface) -> Accuracy:
    part = question.part
    finer = _restricted(part, np.arange(len(part.functionals)), surface)
    _solved(part)  # the first call compiles
    (coarse, mesh), (fine, finer_mesh) = _solved(part), _solved(finer)
    factor = 1 / (1 - (mesh.triangles / finer_mesh.triangles) ** (ORDER / 2))  # r²/(r² − 1)
    errors: dict[str, list[float]] = {}
    for held in (question.datum, question.locators):
        before, after = (_supported(question, blocks, held) for blocks in (coarse, fine))
        most: dict[str, float] = {}  # of a characteristic, over the points that it reads
        for label, a, b in zip([COMPLIANCE, *question.labels], before, after):
            size = float(np.linalg.norm(b))
            most[label] = max(most.get(label, 0.0), factor * float(np.linalg.norm(a - b)) / size if size else 0.0)
        for label, error in most.items():
            errors.setdefault(label, []).append(error)
    return Accuracy(part.name, mesh, finer_mesh, tuple(Estimate(label, *pair) for label, pair in errors.items()))


def _solved(part: Part) -> tuple[Blocks, Mesh]:
    start = time.perf_counter()
    found = provider.find(part).coefficients([part])[part.name]
    seconds = time.perf_counter() - start
    memory = float(found.provenance.get("memory", 0.0))
    return Blocks((found.H,), (found.G,)), Mesh(len(part.surface.points), len(part.surface.triangles), seconds, memory)


def _supported(question: _Question, blocks: Blocks, held: csr_matrix) -> list[np.ndarray]:
    """H between the pushing rows, then what each key characteristic reads of them."""
    response = eliminate(
        blocks,
        held,
        csr_matrix((0, blocks.size)),
        question.pushing,
        vstack([question.pushing, question.reading], format="csr"),
    )
    a = question.pushing.shape[0]
    return [response.L_out[:a], *response.L_out[a:]]
