"""The reduction of an assembly: all data that a Monte Carlo simulation needs, without the finite elements.

It can be saved, carried to a machine without a finite-element package, loaded and evaluated there
(:class:`mic.process.model.ReducedModel`).
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.sparse import csr_matrix

from mic.compliance.blocks import Blocks
from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.thickness import Thicknesses
from mic.errors import ArgumentError
from mic.model.assembly_types import Assembly, Contacts, GapPoints
from mic.model.characteristics import Characteristics
from mic.model.rows import WithWelds
from mic.model.shape import shape_readings
from mic.model.shape_derivatives import ShapeDerivatives
from mic.model.sources import thickness_changes, with_deviations
from mic.scene import Scene
from mic.scene.deviation import DeviationKeys
from mic.system import files
from mic.system.arguments import LARGEST, checked, did_you_mean, real_array
from mic.system.matrix_product import one_thread
from mic.system.memoise import pack, unpack

__all__ = ["Reduction"]

FORMAT = files.Format("reduced model", 8, "build the model again")
FAR = 1000.0  # standard deviations beyond which a value is named in a warning
FAR_WITHOUT_SIGMA = 1e4  # the same distance from the mean, mm or N, for a deviation without standard deviation
#: Classes in the file of a model.
CLASSES = (Blocks, Contacts, GapPoints, Thicknesses, ShapeDerivatives)
#: Attributes that a reduction takes over from its assembly.
FROM_ASSEMBLY = tuple("scene rows labels contacts between weld_size weld_gap inputs position_gap centres".split())


@dataclass(frozen=True)
class Reduction(WithWelds):
    """Compliance, rows and deviations of an assembly.

    Attributes
    ----------
    scene : Scene
    compliance : Blocks
        H and G of the free parts at their retained functionals (equation (2)), F in total.
    rows, labels, contacts, between, weld_size, weld_gap
        As in :class:`mic.model.assembly_types.Assembly`.
    shape : (F, p) array
        Readings of the stress-free shape per unit of each of the scene's p deviations (zero columns for deviations
        that do not change shapes).
    shape_forces : (F, p) array
        Forces that cause these shapes, reactions included, N and N mm.
    inputs : dict of str to str
        Hashes of all input files, as in :class:`mic.model.assembly_types.Assembly`.
    thicknesses : dict of str to Thicknesses
        Compliance of the parts whose thickness varies, by name.
    position_gap, centres
        As in :class:`mic.model.assembly_types.Assembly`.
    slopes : ShapeDerivatives, optional
        Derivatives of compliance and gaps along the sources, if the stiffness follows each sample's shape.
    """

    scene: Scene
    compliance: Blocks
    rows: dict[str, csr_matrix]
    labels: dict[str, list[str]]
    contacts: Contacts
    between: GapPoints
    weld_size: tuple[int, ...]
    weld_gap: np.ndarray
    shape: np.ndarray
    shape_forces: np.ndarray
    inputs: dict[str, str | None]
    thicknesses: Mapping[str, Thicknesses] = field(default_factory=dict)
    position_gap: np.ndarray = field(default_factory=lambda: np.zeros(0))
    centres: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    slopes: ShapeDerivatives | None = None

    @classmethod
    @one_thread
    def build(cls, assembly: Assembly, influence: dict[str, InfluenceCoefficients]) -> Self:
        """Combine the influence coefficients of the parts, given by name, with an assembly.

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
        coefficients = [influence[part.name] for part in assembly.parts]
        compliance = Blocks(tuple(one.H for one in coefficients), tuple(one.G for one in coefficients))
        shape, forces = shape_readings(assembly, compliance)
        return cls(
            compliance=compliance,
            shape=shape,
            shape_forces=forces,
            thicknesses={one.part: one.thicknesses for one in coefficients if one.thicknesses is not None},
            **{name: getattr(assembly, name) for name in FROM_ASSEMBLY},
        )

    @property
    def parameters(self) -> list[str]:
        """Names of the scene's deviations, the columns of every array of deviations."""
        return [deviation.name for deviation in self.scene.deviations]

    @cached_property
    def characteristics(self) -> Characteristics:
        """The key characteristics as functions of their readings."""
        return Characteristics.of(self.scene)

    def deviations(self, values: Any) -> np.ndarray:
        """(n, p) array of deviations; values far from their means are named in a warning.

        Parameters
        ----------
        values : DataFrame, mapping of str to float or (n,) array, (p,) array, or (n, p) array
            A DataFrame with a column for each deviation, in any order. Or deviations by name, a number for all samples
            or one for each; missing ones take their means. Or all deviations in the order of :attr:`parameters`.
            Without any sample, n = 0, results are empty.

        Raises
        ------
        ArgumentError
            For unknown or missing names, wrong shapes, and values that are no finite numbers.
        """
        p = len(self.parameters)
        if hasattr(values, "columns"):
            array = self._columns(values)
        else:
            array = self._named(dict(values.items())) if hasattr(values, "items") else real_array("deviations", values)
        if array.shape == (0,) and p:
            array = np.zeros((0, p))
        array = np.atleast_2d(array)
        if array.ndim != 2 or array.shape[1] != p:
            raise ArgumentError(
                f"deviations: expected {p} values per sample ({', '.join(self.parameters)}), got shape {array.shape}; "
                "give values by name, or all in this order"
            )
        bad = np.argwhere(~(np.abs(array) <= LARGEST))
        if len(bad):
            raise ArgumentError(
                f"deviations: sample {bad[0][0]}, {self.parameters[bad[0][1]]!r} is {array[tuple(bad[0])]}; "
                f"give a finite number, at most {LARGEST:g}"
            )
        self._warn_of_far(array)
        return array

    def _columns(self, frame: Any) -> np.ndarray:
        """(n, p) array from a DataFrame, whose columns must be the deviations."""
        given, known = list(frame.columns), self.parameters
        repeated = [name for name in given if given.count(name) > 1]
        missing = [name for name in known if name not in given]
        other = [name for name in given if name not in known]
        if repeated:
            raise ArgumentError(f"deviations: the table has several columns {repeated[0]!r}; remove all but one")
        if other:
            remedy = "remove it" if not missing else did_you_mean(other[0], missing)
            remedy = f"rename it {missing[0]!r}, which is missing" if len(missing) == 1 else remedy
            raise ArgumentError(f"deviations: the column {other[0]!r} is not a deviation of this scene; {remedy}")
        if missing:
            raise ArgumentError(
                f"deviations: the table has no column {', '.join(map(repr, missing))}; add it, or give a dict, whose "
                "missing deviations take their means"
            )
        array = np.empty((len(frame), len(known)))
        for j, name in enumerate(known):
            array[:, j] = real_array(f"deviations: column {name!r}", frame[name])
        return array

    def _named(self, values: Mapping[str, Any]) -> np.ndarray:
        """(n, p) array from numbers or columns by name."""
        for name in values:
            if name not in self.parameters:
                remedy = did_you_mean(name, self.parameters)
                raise ArgumentError(f"deviations: {name!r} is not a deviation of this scene; {remedy}")
        columns = {name: real_array(f"deviations: {name!r}", value) for name, value in values.items()}
        lengths = {name: len(column) for name, column in columns.items() if column.ndim == 1}
        deep = [name for name, column in columns.items() if column.ndim > 1]
        if deep or len(set(lengths.values())) > 1:
            name = deep[0] if deep else min(lengths, key=lambda name: lengths[name])
            raise ArgumentError(
                f"deviations: {name!r} has shape {columns[name].shape}; give a number, or a number for each sample in "
                "arrays of one length"
            )
        means = [deviation.mean for deviation in self.scene.deviations]
        array = np.empty((max(lengths.values()) if lengths else 1, len(means)))
        for j, (name, mean) in enumerate(zip(self.parameters, means)):
            array[:, j] = columns.get(name, mean)
        return array

    def _warn_of_far(self, array: np.ndarray) -> None:
        """Name the value that is farthest from its mean, if its unit is in doubt."""
        if not array.size:
            return
        mean, sigma = np.array([(item.mean, item.sigma) for item in self.scene.deviations]).T
        distance = np.abs(array - mean) / np.where(sigma > 0, sigma, FAR_WITHOUT_SIGMA / FAR)
        if not (distance > FAR).any():
            return
        sample, j = np.unravel_index(distance.argmax(), distance.shape)
        warnings.warn(
            f"deviations: sample {sample}, {self.parameters[j]!r} is {array[sample, j]:g}, and its distribution has "
            f"mean {mean[j]:g} and standard deviation {sigma[j]:g}; check its unit",
            stacklevel=3,
        )

    def with_deviations(self, deviations: np.ndarray) -> Self:
        """The model with the contacts, weights and compliance of a sample's deviations (p,); its shapes stay the same.

        Raises
        ------
        ImpossibleSample
        """
        model = with_deviations(self, deviations)
        if self.slopes is not None:  # then no thickness varies
            value = self.slopes.values(deviations, self.parameters)
            change = value - self.slopes.about
            if not change.any():
                return model
            return replace(
                model,
                compliance=self.slopes.compliance(model.compliance, change),
                contacts=replace(model.contacts, gap=model.contacts.gap + change @ self.slopes.gap),
                weld_gap=model.weld_gap + change @ self.slopes.weld_gap,
                slopes=replace(self.slopes, about=value),
            )
        more = thickness_changes(self.scene, deviations)
        if not more:
            return model
        blocks = list(zip(self.compliance.H, self.compliance.G))
        for p, part in enumerate(self.scene.parts):
            if part.name in more:
                blocks[p] = self.thicknesses[part.name].at(part.sheet[0] + more[part.name])
        return replace(model, compliance=Blocks(tuple(H for H, _ in blocks), tuple(G for _, G in blocks)))

    @checked
    def save(self, path) -> None:
        """Write to one ``.npz`` file."""
        large = {"shape": self.shape, "shape_forces": self.shape_forces}  # stored as arrays of their own
        large |= {f"H_{p}": H for p, H in enumerate(self.compliance.H)}
        large |= {f"G_{p}": G for p, G in enumerate(self.compliance.G)}
        content = {item.name: getattr(self, item.name) for item in fields(self)}
        packed, arrays = pack(content, {"scene": self.scene, **large})
        entries = [item.entry(j) for j, item in enumerate(self.scene.deviations)]
        header = {"scene": json.loads(self.scene.model_dump_json()), "entries": entries, "content": packed}
        files.save_arrays(Path(path), FORMAT, header, large | arrays)

    @classmethod
    @checked
    def load(cls, path) -> Self:
        """Read a file of :meth:`save`.

        Raises
        ------
        FileNotFoundError
        FormatError
            If the file was written by an incompatible version, is something else, or is damaged.
        """
        with files.reading(Path(path), FORMAT):
            header, arrays = files.load_arrays(Path(path), FORMAT)
            scene = Scene(**header["scene"])
            items = DeviationKeys.with_entries(scene.deviations, header.get("entries", ()))
            known = {"scene": scene.model_copy(update={"deviations": items}), **arrays}
            return cls(**unpack(header["content"], arrays, CLASSES, known))
