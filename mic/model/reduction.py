"""The reduction of an assembly: all that a Monte Carlo needs, and nothing of the finite elements.

It can be saved, carried to a machine without any finite elements, loaded and evaluated there
(:class:`mic.process.model.ReducedModel`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.sparse import csr_matrix

from mic.compliance.blocks import Blocks
from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.thickness import Thicknesses
from mic.model.assembly import Assembly, Between, Contacts
from mic.model.characteristics import Characteristics
from mic.model.shape import shape_readings
from mic.model.shape_derivatives import Slopes
from mic.model.sources import changed, thicker
from mic.scene import Scene
from mic.system import files
from mic.system.matrix_product import one_thread

__all__ = ["Reduction"]

FORMAT = files.Format("reduced model", 7, "build the model again")


@dataclass(frozen=True)
class Reduction:
    """Compliance, rows and deviations of an assembly.

    Attributes
    ----------
    scene : Scene
    compliance : Blocks
        H and G of the free parts at their retained functionals (equation (2)), F in all.
    rows, labels, contacts, between, weld_size, weld_gap
        As in :class:`mic.model.assembly.Assembly`.
    shape : (F, p) array
        Readings of the deviation of the parts' shapes per unit of each of the scene's p deviations (zero columns for
        those that give no shape).
    shape_forces : (F, p) array
        Forces that make these shapes, reactions included, N and N mm.
    inputs : dict of str to str
        As in :class:`mic.model.assembly.Assembly`: with the scene, all that the model was made from.
    thicknesses : dict of str to Thicknesses
        Compliance of the parts whose thickness varies, by name.
    position_gap, centres
        As in :class:`mic.model.assembly.Assembly`.
    slopes : Slopes, optional
        How compliance and gaps go with the sources, where the stiffness follows each sample's shape.
    """

    scene: Scene
    compliance: Blocks
    rows: dict[str, csr_matrix]
    labels: dict[str, list[str]]
    contacts: Contacts
    between: Between
    weld_size: tuple[int, ...]
    weld_gap: np.ndarray
    shape: np.ndarray
    shape_forces: np.ndarray
    inputs: dict[str, str | None]
    thicknesses: Mapping[str, Thicknesses] = field(default_factory=dict)
    position_gap: np.ndarray = field(default_factory=lambda: np.zeros(0))
    centres: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    slopes: Slopes | None = None

    @classmethod
    @one_thread
    def build(cls, assembly: Assembly, influence: dict[str, InfluenceCoefficients]) -> Self:
        """Put the parts' influence coefficients together.

        Parameters
        ----------
        assembly : Assembly
        influence : dict
            By part name.

        Raises
        ------
        ValueError
            If the coefficients belong to another assembly.
        """
        for part in assembly.parts:
            if len(influence[part.name].H) != len(part.functionals):
                raise ValueError(
                    f"part {part.name!r}: the influence coefficients have {len(influence[part.name].H)} rows, "
                    f"the assembly {len(part.functionals)} functionals: they belong to another scene"
                )
        own = [influence[part.name] for part in assembly.parts]
        compliance = Blocks(tuple(one.H for one in own), tuple(one.G for one in own))
        shape, forces = shape_readings(assembly, compliance)
        return cls(
            assembly.scene,
            compliance,
            assembly.rows,
            assembly.labels,
            assembly.contacts,
            assembly.between,
            assembly.weld_size,
            assembly.weld_gap,
            shape,
            forces,
            assembly.inputs,
            {one.part: one.thicknesses for one in own if one.thicknesses is not None},
            assembly.position_gap,
            assembly.centres,
        )

    @property
    def parameters(self) -> list[str]:
        """Names of the scene's deviations, the columns of every array of deviations."""
        return [deviation.name for deviation in self.scene.deviations]

    @cached_property
    def characteristics(self) -> Characteristics:
        """What the scene's measurements make of their readings."""
        return Characteristics.of(self.scene)

    def deviations(self, values: Any) -> np.ndarray:
        """(n, p) array of deviations from a dict by name (the rest at their means), one vector or an array.

        Raises
        ------
        ValueError
            For unknown names, wrong shapes, or values that are not finite.
        """
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
                f"deviations: expected {len(mean)} values per sample ({', '.join(self.parameters)}), "
                f"got shape {array.shape}"
            )
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            raise ValueError(
                f"deviations: sample {bad[0][0]}, {self.parameters[bad[0][1]]!r} is {array[tuple(bad[0])]}; "
                "give a finite number"
            )
        return array

    def changed(self, deviations: np.ndarray) -> Self:
        """With the contacts, the weights and the compliance that a sample's deviations (p,) make; what shapes give
        stays.

        Raises
        ------
        ImpossibleSample
        """
        made = changed(self, deviations)
        if self.slopes is not None:
            return self.slopes.followed(made, deviations)  # no thickness varies beside them
        more = thicker(self.scene, deviations)
        if not more:
            return made
        blocks = list(zip(self.compliance.H, self.compliance.G))
        for p, part in enumerate(self.scene.parts):
            if part.name in more:
                blocks[p] = self.thicknesses[part.name].at(part.sheet[0] + more[part.name])
        return replace(made, compliance=Blocks(tuple(H for H, _ in blocks), tuple(G for _, G in blocks)))

    def save(self, path) -> None:
        """Write to one ``.npz`` file."""
        arrays = {"weld_gap": self.weld_gap, "shape": self.shape, "shape_forces": self.shape_forces}
        arrays |= {"position_gap": self.position_gap, "centres": self.centres}
        arrays |= {f"H_{p}": H for p, H in enumerate(self.compliance.H)}
        arrays |= {f"G_{p}": G for p, G in enumerate(self.compliance.G)}
        arrays |= {
            f"rows_{kind}_{name}": getattr(matrix, name)
            for kind, matrix in self.rows.items()
            for name in ("data", "indices", "indptr")
        }
        arrays |= {f"contacts_{name}": getattr(self.contacts, name) for name in Contacts.__dataclass_fields__}
        arrays |= {f"between_{name}": getattr(self.between, name) for name in Between.__dataclass_fields__}
        for name, one in self.thicknesses.items():
            p = [part.name for part in self.scene.parts].index(name)
            arrays |= {f"thicknesses_{p}_{key}": np.asarray(value) for key, value in vars(one).items()}
        if self.slopes is not None:
            arrays |= {f"slopes_{name}": array for name, array in self.slopes.arrays().items()}
        header = {
            "scene": json.loads(self.scene.model_dump_json()),
            "labels": self.labels,
            "weld_size": self.weld_size,
            "inputs": self.inputs,
        }
        files.save_arrays(Path(path), FORMAT, header, arrays)

    @classmethod
    def load(cls, path) -> Self:
        """Read what :meth:`save` wrote.

        Raises
        ------
        FileNotFoundError
        FormatError
            If the file was written by an incompatible version, is something else, or is damaged.
        """
        header, data = files.load_arrays(Path(path), FORMAT)
        parts = range(len(header["scene"]["parts"]))
        compliance = Blocks(tuple(data[f"H_{p}"] for p in parts), tuple(data[f"G_{p}"] for p in parts))
        slopes = {name.removeprefix("slopes_"): data[name] for name in data if name.startswith("slopes_")}
        rows = {
            kind: csr_matrix(
                tuple(data[f"rows_{kind}_{name}"] for name in ("data", "indices", "indptr")),
                shape=(len(labels), compliance.size),
            )
            for kind, labels in header["labels"].items()
        }
        own: dict[str, Any] = {name: data[f"contacts_{name}"] for name in Contacts.__dataclass_fields__}
        return cls(
            Scene(**header["scene"]),
            compliance,
            rows,
            header["labels"],
            Contacts(**own | {"dimension": int(own["dimension"])}),
            Between(**{name: data[f"between_{name}"] for name in Between.__dataclass_fields__}),
            tuple(header["weld_size"]),
            data["weld_gap"],
            data["shape"],
            data["shape_forces"],
            header["inputs"],
            {
                part["name"]: _thicknesses(data, p)
                for p, part in enumerate(header["scene"]["parts"])
                if f"thicknesses_{p}_t" in data
            },
            data["position_gap"],
            data["centres"],
            Slopes.of(slopes, len(parts)) if slopes else None,
        )


def _thicknesses(data: Mapping[str, np.ndarray], p: int) -> Thicknesses:
    t, low, high, H, G = (data[f"thicknesses_{p}_{key}"] for key in ("t", "low", "high", "H", "G"))
    return Thicknesses(t, float(low), float(high), H, G)
