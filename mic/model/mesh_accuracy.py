"""Estimates the discretisation error of a part's influence coefficients, and the cost of a finer mesh.

The same functionals are read on the given mesh and on one of half the element size. With element size h and elements
whose energy error is of second order,

    H(h) − H₀ ≈ (H(h) − H(h′)) · r²/(r² − 1),        r = h/h′ = √(k′/k) for k and k′ triangles,

a factor 4/3 for r = 2. The estimates are Frobenius norms relative to those of H(h′),

- of H between the rows that push across the sheet: contact normals, weld normals, clamps, corrective forces;
- of each key characteristic's influence: its reading per newton on each of these rows.

A geometry script need not refine everything: a size that it sets itself, at a hole or under a pad, is the same on both
meshes, and so is its error. If the triangles under a compared functional stay as large, the mesh is instead divided on
the curved surface given by its normals (:mod:`mic.geometry.refinement`).

H belongs to a free part; it is compared on the six locators that the part is set down on, and on all its locators. A
few contact pairs of each zone represent all of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix, vstack

from mic.compliance import provider
from mic.compliance.blocks import Blocks
from mic.compliance.elimination import eliminate
from mic.compliance.part import Part
from mic.compliance.support import completing_rows, motion_size
from mic.errors import SceneError
from mic.geometry.load import finer_surface
from mic.geometry.refinement import halved
from mic.geometry.surface import Patch, Surface
from mic.model.assembly_types import Assembly
from mic.model.characteristics import Characteristics
from mic.model.rigid_motion import rigid_readings
from mic.model.shape import datum_rows
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint

__all__ = [
    "Accuracy",
    "Estimate",
    "Mesh",
    "estimate_accuracy",
    "extrapolation",
    "with_finer_meshes",
    "with_halved_elements",
]

FORMAT = Format("estimate of accuracy", 2, ABSENT)
PAIRS = 24  # contact pairs that represent a zone
FINER = 0.5  # largest ratio of triangle areas that counts as refined; half the size gives a quarter
ORDER = 2  # of the elements' energy error in the element size
COMPLIANCE = "H"  # name of a part's first estimate


@dataclass(frozen=True)
class Mesh:
    """Size and cost of a mesh that was solved on.

    Attributes
    ----------
    nodes, triangles : int
    seconds : float
        From the surface to the influence coefficients of the compared functionals.
    memory : float
        Size of the factors, MB; 0 if the provider does not report it.
    """

    nodes: int
    triangles: int
    seconds: float
    memory: float


@dataclass(frozen=True)
class Estimate:
    """Estimated relative error of one quantity.

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
    """Estimated discretisation error of a part.

    Attributes
    ----------
    part : str
    mesh, finer : Mesh
        The given mesh, and the one of half the element size.
    estimates : tuple of Estimate
        The one of H first.
    """

    part: str
    mesh: Mesh
    finer: Mesh
    estimates: tuple[Estimate, ...]

    @property
    def worst(self) -> float:
        """The largest estimate."""
        return max(max(one.set_down, one.located) for one in self.estimates)

    def _exponent(self, quantity: str) -> float:
        """Exponent with which a quantity grows with the number of nodes, as measured on the two meshes."""
        growth = getattr(self.finer, quantity) / getattr(self.mesh, quantity)
        return float(np.log(growth) / np.log(self.finer.nodes / self.mesh.nodes))

    def mesh_for(self, error: float) -> Mesh:
        """The mesh whose worst error would be `error`: size by the order, time and memory extrapolated."""
        share = (self.worst / error) ** (2 / ORDER)  # ratio of triangle numbers
        memory = self._exponent("memory") if self.mesh.memory else 1.0
        return Mesh(
            round(self.mesh.nodes * share),
            round(self.mesh.triangles * share),
            self.mesh.seconds * share ** max(1.0, self._exponent("seconds")),
            self.mesh.memory * share**memory,
        )


def estimate_accuracy(
    assembly: Assembly,
    cache: Path,
    progress: Callable[[str], None] | None = None,
    parts: Collection[str] | None = None,
) -> tuple[Accuracy, ...]:
    """Estimate the discretisation error of each part of an assembly.

    Parameters
    ----------
    assembly : Assembly
    cache : Path
        Cache folder of meshes and estimates.
    progress : callable, optional
        Called with one line of text before each part that is computed.
    parts : collection of str, optional
        Names of the parts to estimate; default: all.

    Raises
    ------
    SceneError
        If a part cannot be meshed at half the size.
    MissingProvider
    """
    disk_cache, estimates = Cache(cache, "influence", FORMAT), []
    for p, part in enumerate(assembly.parts):
        if (parts is not None and part.name not in parts) or part.superelement is not None:
            continue  # a superelement has no mesh
        compared, rows, labels = _compared_rows(assembly, p)
        other = _finer_part(assembly, p, compared, cache)
        entries = [[table.indices.tolist(), table.data.tolist()] for table in rows.values()]
        identity = fingerprint([part.fingerprint(), other.fingerprint(), labels, entries])
        cached = disk_cache.load(identity)
        if cached is not None:
            table = cached[0]["accuracy"]
            quantities = tuple(Estimate(**one) for one in table["estimates"])
            estimates.append(Accuracy(part.name, Mesh(**table["mesh"]), Mesh(**table["finer"]), quantities))
            continue
        if progress:
            progress(
                f"accuracy of {part.name}: {len(compared.functionals)} functionals, "
                f"{len(part.surface.points)} and {len(other.surface.points)} nodes"
            )
        estimates.append(_estimate(compared, other, rows, labels))
        disk_cache.store(identity, {"accuracy": asdict(estimates[-1])}, {"none": np.zeros(0)})
    return tuple(estimates)


def with_halved_elements(assembly: Assembly) -> Assembly:
    """The assembly on meshes of half the element size, with the same rows at the same points.

    Each triangle is divided into four on the curved surface. Superelements stay unchanged.
    """
    halves = [part if part.superelement else _on_surface(part, _halved(part.surface)) for part in assembly.parts]
    return replace(assembly, parts=tuple(halves))


def with_finer_meshes(assembly: Assembly, cache: Path) -> Assembly:
    """The assembly on the finer meshes of :func:`estimate_accuracy`, with the same rows at the same points.

    Arguments and errors are those of that function; superelements stay unchanged.
    """
    parts = [
        part if part.superelement is not None else _finer_part(assembly, p, part, cache)
        for p, part in enumerate(assembly.parts)
    ]
    return replace(assembly, parts=tuple(parts))


def _finer_part(assembly: Assembly, p: int, part: Part, cache: Path) -> Part:
    """Part p, with all or some of its functionals, on a mesh of half the element size."""
    finer = finer_surface(assembly.scene.parts[p], assembly.scene.folder, cache, assembly.sizes.get(part.name))
    if not len(finer.triangles) > len(assembly.surfaces[part.name].triangles):
        raise SceneError(
            f"part {part.name!r}: geometry: the script makes no more triangles at half the size; let build(part, size) "
            "use its argument size"
        )
    other = _on_surface(part, finer)
    return other if _finer_everywhere(part, other) else _on_surface(part, _halved(part.surface))


def extrapolation(triangles: int, finer: int) -> float:
    """Factor r²/(r² − 1) from the change on a finer mesh to the error, for the numbers of triangles of the meshes."""
    return 1 / (1 - (triangles / finer) ** (ORDER / 2))


def _halved(surface: Surface) -> Surface:
    return Surface(*halved(surface.points, surface.triangles, surface.corner_normals))


def _compared_rows(assembly: Assembly, p: int) -> tuple[Part, dict[str, csr_matrix], list[str]]:
    """Part p with the compared functionals only, rows over them, and the names of its key characteristics.

    The rows are those that push across the sheet, ``"pushing"``, those of the key characteristics, ``"reading"``, six
    of the locators that the part is set down on, ``"datum"``, and all its locators, ``"locators"``.
    """
    functionals = slice(assembly.offsets[p], assembly.offsets[p + 1])
    part, contacts = assembly.parts[p], assembly.contacts
    rows = {kind: matrix[:, functionals].tocsr() for kind, matrix in assembly.rows.items()}
    acting = {kind: np.flatnonzero(np.diff(matrix.indptr)) for kind, matrix in rows.items()}
    normals = acting["contact"][acting["contact"] % contacts.dimension == 0]
    zone = contacts.zone[normals // contacts.dimension]
    normals = np.concatenate([np.zeros(0, int), *(_evenly_chosen(normals[zone == z]) for z in np.unique(zone))])
    welds = np.intersect1d(acting["weld"], assembly.joints.first)
    across = {"contact": normals, "weld": welds, "clamp": acting["clamp"], "force": acting["force"]}
    pushing = vstack([rows[kind][numbers] for kind, numbers in across.items()], format="csr")
    for kind in ("measurement", "locator"):
        if not pushing.shape[0]:  # nothing pushes this part
            pushing = rows[kind][acting[kind]]
    G, locators = rigid_readings(part), rows["locator"][acting["locator"]]
    datum = datum_rows(assembly, p, G)
    free = completing_rows(locators @ G, datum @ G, motion_size((G,)))  # motions that the locators leave free
    tables = {
        "pushing": pushing,
        "reading": rows["measurement"][acting["measurement"]],
        "datum": datum,
        "locators": vstack([locators, datum[free]], format="csr") if len(free) else locators,
    }
    used = np.unique(np.concatenate([table.indices for table in tables.values()]))
    count = np.diff(Characteristics.of(assembly.scene).start)
    labels = np.repeat([item.name for item in assembly.scene.measurements], count)[acting["measurement"]].tolist()
    return _restricted(part, used), {name: table[:, used].tocsr() for name, table in tables.items()}, labels


def _evenly_chosen(rows):
    """At most `PAIRS` of the rows, evenly spaced."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(PAIRS, len(rows))).round().astype(int))]


def _restricted(part: Part, functionals: np.ndarray) -> Part:
    """The part with some of its functionals only, at its nominal thickness."""
    f = part.functionals
    patches, number = np.unique(f.patch[functionals], return_inverse=True)
    selected = replace(
        f,
        patches=tuple(f.patches[i] for i in patches),
        patch=number.ravel(),
        direction=f.direction[functionals],
        rotation=f.rotation[functionals],
        side=f.side[functionals],
        label=tuple(f.label[i] for i in functionals),
    )
    return replace(part, functionals=selected, thickness_range=None)


def _on_surface(part: Part, surface: Surface) -> Part:
    """The part on another mesh of its surface: every point of a patch at the closest one, with its weight."""
    patches = part.functionals.patches
    triangle = np.concatenate([patch.triangle for patch in patches])
    barycentric = np.concatenate([patch.barycentric for patch in patches])
    foot = surface.project(part.surface.at(triangle, barycentric), part.surface.normals[triangle])
    ends = np.cumsum([len(patch.weight) for patch in patches])[:-1]
    pieces = zip(np.split(foot.triangle, ends), np.split(foot.barycentric, ends), patches)
    moved = tuple(Patch(triangle, barycentric, patch.weight) for triangle, barycentric, patch in pieces)
    return replace(part, surface=surface, functionals=replace(part.functionals, patches=moved))


def _finer_everywhere(part: Part, finer: Part) -> bool:
    """Whether the triangles under each of the part's patches are smaller on the other mesh of its surface."""
    coarse, fine = (
        [patch.weight @ body.surface.areas[patch.triangle] for patch in body.functionals.patches]
        for body in (part, finer)
    )
    return all(b < FINER * a for a, b in zip(coarse, fine))


def _estimate(part: Part, finer: Part, rows: dict[str, csr_matrix], labels: list[str]) -> Accuracy:
    """The errors of a part, from itself and from it on a finer mesh."""
    _solve(part)  # the first call compiles
    (coarse, mesh), (fine, finer_mesh) = _solve(part), _solve(finer)
    factor = extrapolation(mesh.triangles, finer_mesh.triangles)
    errors: dict[str, list[float]] = {}
    for held in (rows["datum"], rows["locators"]):
        before, after = (_responses(rows, blocks, held) for blocks in (coarse, fine))
        worst: dict[str, float] = {}  # of each characteristic, over its points
        for label, a, b in zip([COMPLIANCE, *labels], before, after):
            size = float(np.linalg.norm(b))
            worst[label] = max(worst.get(label, 0.0), factor * float(np.linalg.norm(a - b)) / size if size else 0.0)
        for label, error in worst.items():
            errors.setdefault(label, []).append(error)
    return Accuracy(part.name, mesh, finer_mesh, tuple(Estimate(label, *pair) for label, pair in errors.items()))


def _solve(part: Part) -> tuple[Blocks, Mesh]:
    start = time.perf_counter()
    influence = provider.find(part).coefficients([part])[part.name]
    seconds = time.perf_counter() - start
    memory = float(influence.provenance.get("memory", 0.0))
    mesh = Mesh(len(part.surface.points), len(part.surface.triangles), seconds, memory)
    return Blocks((influence.H,), (influence.G,)), mesh


def _responses(rows: dict[str, csr_matrix], blocks: Blocks, held: csr_matrix) -> list[np.ndarray]:
    """H between the pushing rows, then the reading of each key characteristic per force on them."""
    pushing = rows["pushing"]
    outputs = vstack([pushing, rows["reading"]], format="csr")
    response = eliminate(blocks, held, csr_matrix((0, blocks.size)), pushing, outputs)
    a = pushing.shape[0]
    return [response.L_out[:a], *response.L_out[a:]]
