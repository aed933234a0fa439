"""Compliance of the small scenes, shipped with the tests: the program runs on it where there are no finite elements.

``tests/data/SCENE.npz`` holds the influence coefficients of each part of a scene, and where each functional reads.
A scene that keeps the parts and asks for no other functionals (other laws, stages, increments, friction) is served by
selection of rows. The program finds this provider as it finds any: by the entry point in ``tests/shipped.dist-info``.

``PYTHONPATH=tests python -m support.shipped`` computes the files anew; that takes finite elements. It is needed when
parts, meshes or functionals of the scenes change, and at no other time.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import mic
from mic.compliance.cache import influence_coefficients
from mic.compliance.coefficients import InfluenceCoefficients
from mic.errors import MissingProvider
from mic.model.assembly import assemble
from mic.system.files import Format, load_arrays, save_arrays
from verification.scenes import with_stated_pairs

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "tests" / "data"
#: By file, the scene, and whether with few pairs: the many of the hat's candidates would take 50 MB.
SCENES = {
    "lap_joint": ("lap_joint", True),
    "lap_joint_watched": ("lap_joint", False),
    "hat_on_plate": ("hat_on_plate", True),
    "bracket": ("bracket", True),
}
SHIPPED = Format("shipped compliance", 3, "make it again: PYTHONPATH=tests python -m support.shipped")
SAME = 1e-7  # mm, and components of unit vectors: readings that are closer than this are one


def places(part) -> np.ndarray:
    """(F, 12) array: where each functional of a part reads: point, size, moment, direction, rotation or not, side."""
    rows = []
    for patch in part.functionals.patches:
        at, share = part.surface.at(patch.triangle, patch.barycentric), np.abs(patch.weight)
        share = share / share.sum()
        centre = share @ at
        moment = patch.weight @ (at - centre)  # of a nugget's first moments; else zero
        rows.append([*centre, np.sqrt(share @ ((at - centre) ** 2).sum(axis=1)), *moment])
    f = part.functionals
    return np.column_stack([np.array(rows)[f.patch], f.direction, f.rotation, f.side])


def half(H):
    """(F (F + 1)/2,) the upper half of a symmetric matrix, row by row."""
    return H[np.triu_indices(len(H))]


def whole(half):
    """(F, F) the symmetric matrix of which this is the upper half."""
    size = (int(np.sqrt(1 + 8 * len(half))) - 1) // 2
    H, upper = np.zeros((size, size)), np.triu_indices(size)
    H[upper] = half
    H.T[upper] = half
    return H


def body(part) -> dict:
    """The inputs of a part's compliance besides its functionals."""
    return {
        "points": np.round(np.abs(part.surface.points).sum(axis=0), 6).tolist(),
        "sizes": [len(part.surface.points), len(part.surface.triangles)],
        "sheet": [part.thickness, part.young, part.poisson, part.element],
    }


class Shipped:
    """The shipped compliance as a provider (``mic.compliance.provider``)."""

    def __init__(self):
        files = (DATA / f"{file}.npz" for file in SCENES)  # none of them while they are made
        self.files = [load_arrays(file, SHIPPED) for file in files if file.is_file()]
        for _, arrays in self.files:
            arrays |= {name: whole(half) for name, half in arrays.items() if name.endswith(":H")}

    @property
    def elements(self) -> set[str]:
        """Elements of the shipped parts."""
        return {body["sheet"][-1] for header, _ in self.files for body in header.values() if "sheet" in body}

    def accepts(self, part) -> bool:
        """Whether the part is a shipped one, and its functionals are among those that were shipped."""
        return self._rows(part) is not None

    def coefficients(self, parts, comm=None) -> dict[str, InfluenceCoefficients]:
        """Coefficients by part name; `comm` is not used, since nothing is computed."""
        found = {}
        for part in parts:
            arrays, rows = self._rows(part)
            H, G = arrays[f"{part.name}:H"], arrays[f"{part.name}:G"]
            found[part.name] = InfluenceCoefficients(
                part.name, H[np.ix_(rows, rows)], G[rows], {"element": part.element}
            )
        return found

    def field(self, part, forces):
        """Raises MissingProvider: only readings of functionals are shipped."""
        raise MissingProvider(f"part {part.name!r}: no displacement field is shipped; install the finite elements")

    def _rows(self, part):
        for header, arrays in self.files:
            if header.get(part.name) == body(part):
                distance, rows = cKDTree(arrays[f"{part.name}:places"]).query(places(part))
                if (distance < SAME).all():
                    return arrays, rows
        return None


def main(cache: Path) -> None:
    """Compute the files anew."""
    for file in SCENES:
        (DATA / f"{file}.npz").unlink(missing_ok=True)
    for file, (name, with_few) in SCENES.items():
        scene = mic.load_scene(ROOT / "meshes" / name)
        assembly = assemble(with_stated_pairs(scene) if with_few else scene, cache)
        coefficients = influence_coefficients(assembly, cache)[0]
        header, arrays = {}, {}
        for part in assembly.parts:
            one = coefficients[part.name]
            header[part.name] = body(part)
            arrays |= {f"{part.name}:H": half(one.H), f"{part.name}:G": one.G, f"{part.name}:places": places(part)}
        save_arrays(DATA / f"{file}.npz", SHIPPED, header, arrays)


if __name__ == "__main__":
    main(mic.cache_folder())
