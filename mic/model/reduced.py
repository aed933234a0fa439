"""The reduced model of an assembly: all that a Monte Carlo needs, and nothing of the finite elements.

A reduced model can be saved, carried to a machine without any FE package, loaded and evaluated there.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_matrix

from mic.compliance.elimination import eliminate, statically_determinate
from mic.compliance.influence import InfluenceCoefficients
from mic.model.assembly import Assembly, Contacts
from mic.scene import Scene

__all__ = ["ReducedModel"]

FORMAT = 1


@dataclass(frozen=True)
class ReducedModel:
    """Compliance, rows and deviations of an assembly.

    Attributes
    ----------
    scene : Scene
    H : (F, F) array
        Compliance of the free parts at the stacked retained functionals (equation (2)), block-diagonal.
    G : (F, 6P) array
        Rigid-body readings, block-diagonal.
    offsets : (P + 1,) int array
        First functional of each part, and F at the end.
    rows, labels, contacts, weld_size, weld_gap
        As in :class:`mic.model.assembly.Assembly`.
    shape : (F, p) array
        Readings of the deviation of the parts' shapes per unit of each of the scene's p deviations (zero columns for
        locator and clamp deviations).
    """

    scene: Scene
    H: np.ndarray
    G: np.ndarray
    offsets: np.ndarray
    rows: dict[str, csr_matrix]
    labels: dict[str, list[str]]
    contacts: Contacts
    weld_size: tuple[int, ...]
    weld_gap: np.ndarray
    shape: np.ndarray
    shape_forces: np.ndarray

    @classmethod
    def build(cls, assembly: Assembly, influence: dict[str, InfluenceCoefficients]) -> ReducedModel:
        """Put the parts' influence coefficients together.

        Parameters
        ----------
        assembly : Assembly
        influence : dict
            By part name.
        """
        for part in assembly.parts:
            if len(influence[part.name].H) != len(part.functionals):
                raise ValueError(
                    f"part {part.name!r}: the influence coefficients have {len(influence[part.name].H)} rows, "
                    f"the assembly {len(part.functionals)} functionals: they belong to another scene"
                )
        H = block_diag(*(influence[part.name].H for part in assembly.parts))
        G = block_diag(*(influence[part.name].G for part in assembly.parts))
        shape, forces = _shape_deviations(assembly, H, G)
        return cls(
            assembly.scene,
            H,
            G,
            assembly.offsets,
            assembly.rows,
            assembly.labels,
            assembly.contacts,
            assembly.weld_size,
            assembly.weld_gap,
            shape,
            forces,
        )

    @property
    def parameters(self) -> list[str]:
        """Names of the scene's deviations, the columns of every array of deviations."""
        return [deviation.name for deviation in self.scene.deviations]

    @cached_property
    def eliminations(self) -> list:
        """Every stage with its bilateral rows eliminated (:func:`mic.process.process.eliminate_stages`), once for all contact laws."""
        from mic.process.process import eliminate_stages

        return eliminate_stages(self)

    @cached_property
    def _processes(self) -> dict:
        return {}

    def process(self, law: str | None = None, tol: float = 1e-10, backend: str = "native", threads: int = 1):
        """The prepared process under a contact law (default: the first that the scene's report names).

        The other arguments are those of :class:`mic.process.process.Process`.
        """
        from mic.process.process import Process

        law = law or self.scene.report.laws[0]
        key = (law, tol, backend, threads)
        if key not in self._processes:
            self._processes[key] = Process(self, law, tol, backend, threads)
        return self._processes[key]

    def evaluate(self, deviations, law: str | None = None):
        """Take one assembly, or a batch, through all stages.

        Parameters
        ----------
        deviations : dict of str to float, (p,) array or (n, p) array
            Values of the scene's deviations by name (the rest at their means), or in the order of :attr:`parameters`.
        law : str, optional
            Contact law; default: the first of the scene's report.

        Returns
        -------
        mic.process.process.Evaluation

        Raises
        ------
        ValueError
            For unknown names, wrong shapes, or values that are not finite.
        """
        return self.process(law).evaluate(self.deviations(deviations))

    def deviations(self, values) -> np.ndarray:
        """(n, p) array of deviations from a dict, one vector or an array; see :meth:`evaluate`."""
        mean = np.array([deviation.mean for deviation in self.scene.deviations])
        if isinstance(values, dict):
            unknown = sorted(set(values) - set(self.parameters))
            if unknown:
                raise ValueError(
                    f"deviations: {unknown[0]!r} is not a deviation of this scene; known: {', '.join(self.parameters)}"
                )
            row = mean.copy()
            for name, value in values.items():
                row[self.parameters.index(name)] = value
            values = row
        array = np.atleast_2d(np.asarray(values, dtype=float))
        if array.ndim != 2 or array.shape[1] != len(mean):
            raise ValueError(
                f"deviations: expected {len(mean)} values per sample ({', '.join(self.parameters)}), got shape {array.shape}"
            )
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            raise ValueError(
                f"deviations: sample {bad[0][0]}, {self.parameters[bad[0][1]]!r} is {array[tuple(bad[0])]}; give a finite number"
            )
        return array

    def save(self, path) -> None:
        """Write to one ``.npz`` file."""
        arrays = {
            f"rows_{kind}_{name}": getattr(matrix, name)
            for kind, matrix in self.rows.items()
            for name in ("data", "indices", "indptr")
        }
        contacts = {f"contacts_{name}": getattr(self.contacts, name) for name in self.contacts.__dataclass_fields__}
        header = {
            "format": FORMAT,
            "scene": json.loads(self.scene.model_dump_json()),
            "labels": self.labels,
            "weld_size": self.weld_size,
        }
        np.savez_compressed(
            path,
            header=json.dumps(header),
            H=self.H,
            G=self.G,
            offsets=self.offsets,
            weld_gap=self.weld_gap,
            shape=self.shape,
            shape_forces=self.shape_forces,
            **arrays,
            **contacts,
        )

    @classmethod
    def load(cls, path) -> ReducedModel:
        """Read what :meth:`save` wrote.

        Raises
        ------
        ValueError
            If the file was written by an incompatible version.
        """
        with np.load(Path(path)) as data:
            header = json.loads(str(data["header"]))
            if header["format"] != FORMAT:
                raise ValueError(
                    f"{path}: written in format {header['format']}, this version reads {FORMAT}; build the model again"
                )
            F = len(data["H"])
            rows = {
                kind: csr_matrix(
                    (data[f"rows_{kind}_data"], data[f"rows_{kind}_indices"], data[f"rows_{kind}_indptr"]),
                    shape=(len(labels), F),
                )
                for kind, labels in header["labels"].items()
            }
            contacts = Contacts(
                **{name: data[f"contacts_{name}"] for name in Contacts.__dataclass_fields__ if name != "dimension"},
                dimension=int(data["contacts_dimension"]),
            )
            return cls(
                Scene(**header["scene"]),
                data["H"],
                data["G"],
                data["offsets"],
                rows,
                header["labels"],
                contacts,
                tuple(header["weld_size"]),
                data["weld_gap"],
                data["shape"],
                data["shape_forces"],
            )


def datum_locators(assembly, part: str, G: np.ndarray) -> np.ndarray:
    """(6,) rows of the locators that a part's shape is measured from: six that hold it, of those it is set down on.

    Parameters
    ----------
    assembly : Assembly
    part : str
    G : (F, 6) array
        Rigid-body readings of the part.
    """
    scene = assembly.scene
    own = np.array(
        [i for i, item in enumerate(scene.locators) if item.part == part and item.stage == scene.stages[0].name]
    )
    return own[statically_determinate(assembly.rows["locator"][own], G)]


def _shape_deviations(assembly, H, G):
    """Readings (F, p), and functional forces (F, p), of the shape that each unit corrective force gives its part.

    The part is held on a statically determinate choice of the locators that it is set down on while the force acts; the
    deformed shape is then the part's stress-free shape. A deviation is measured from the locators, so it vanishes there.
    """
    scene, F = assembly.scene, len(H)
    shape, forces = np.zeros((F, len(scene.deviations))), np.zeros((F, len(scene.deviations)))
    force_row = {deviation.name: i for i, deviation in enumerate(d for d in scene.deviations if d.kind == "force")}
    identity = csr_matrix(np.eye(F)) if force_row else None
    for p, part in enumerate(assembly.parts):
        own = [j for j, d in enumerate(scene.deviations) if d.kind == "force" and d.part == part.name]
        if not own:
            continue
        block = slice(assembly.offsets[p], assembly.offsets[p + 1])
        modes = G[:, 6 * p : 6 * p + 6]
        support = assembly.rows["locator"][datum_locators(assembly, part.name, modes)]
        load = assembly.rows["force"][[force_row[scene.deviations[j].name] for j in own]]
        stage = eliminate(
            H[block, block],
            modes[block],
            support[:, block],
            csr_matrix((0, block.stop - block.start)),
            load[:, block],
            identity[block, block],
        )
        shape[block, own] = stage.L_out
        forces[:, own] = load.T.toarray() + support.T @ stage.reaction_L
    return shape, forces
