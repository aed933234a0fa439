"""The table of a part."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from mic.scene.keys import FileName, FiniteFloat, Flag, LengthUnit, Name, Positive, Table

__all__ = ["CAD", "Part", "USUAL"]

#: Suffixes of CAD files.
CAD = (".step", ".stp", ".iges", ".igs", ".brep")
#: Defaults where neither the scene nor a mesh file has a value: drawn at the mid-surface, steel; MPa.
USUAL = {"offset": 0.0, "young": 210e3, "poisson": 0.3}


class Part(Table):
    """A sheet-metal part."""

    name: Name
    """name of the part in all other tables"""

    mesh: FileName | None = None
    """mesh file of the sheet, triangles or quadrilaterals (gmsh, Abaqus, Nastran, LS-DYNA, STL, VTK, …), or CAD
    file of its mid-surface (STEP, IGES)"""

    set: str | Annotated[list[str], Field(min_length=1)] | None = None
    """with `mesh`: element sets, properties or physical groups that form the part; default: the whole file"""

    unit: LengthUnit = "mm"
    """with `mesh`: its unit of length; stresses are in the corresponding unit"""

    geometry: FileName | None = None
    """or a Python file with `build(part, size) -> (points (n, 3), triangles (k, 3))`, optionally also corner
    normals (k, 3, 3); it is executed"""

    size: str | Positive | None = None
    """element size, mm, with `geometry` or a CAD file; or a name from `SIZES` of the geometry"""

    accuracy: Annotated[FiniteFloat, Field(gt=0, le=0.5)] | None = None
    """or the tolerated relative error of influence coefficients, such as 0.01; the mesh is refined until it is
    reached"""

    thickness: Positive | None = None
    """mm; optional if the mesh file has it"""

    offset: Annotated[FiniteFloat, Field(ge=-5, le=5)] | None = None
    """from the drawn surface to the mid-surface along the mesh's normals, as a share of the thickness: ±0.5 if
    drawn on a skin; default: that of the mesh file, else 0"""

    young: Positive | None = None
    """Young's modulus, MPa; default: that of the mesh file, else 210 000"""

    poisson: Annotated[FiniteFloat, Field(gt=-1, lt=0.5)] | None = None
    """Poisson's ratio; default: that of the mesh file, else 0.3"""

    density: Positive | None = None
    """kg/m³, such as 7850; required with gravity"""

    expansion: Positive | None = None
    """coefficient of thermal expansion, 1/K, such as 1.2e-5; required with deviations of temperature"""

    rests: Flag = False
    """whether contact and friction hold what its locators leave free; it is placed as drawn, or as near as possible
    without overlap"""

    stiffness: FileName | None = None
    """with `mesh`: the part's reduced stiffness on named nodes, without supports, in place of finite elements:
    Matrix Market or Nastran `OUTPUT4` with a node table (`a.mtx` or `a.op4`, `a.csv` with node, x, y, z), Nastran
    `DMIG`, Abaqus `*MATRIX GENERATE`"""

    compliance: FileName | None = None
    """or its reduced compliance on any statically determinate support, same formats"""

    @model_validator(mode="after")
    def _one_source(self):
        if self.stiffness is not None and self.compliance is not None:
            raise ValueError("give stiffness or compliance, not both")
        for key in ("stiffness", "compliance"):
            if self.mesh is None and getattr(self, key) is not None:
                raise ValueError(f"{key} needs mesh: the surface of the part, for pairs and pictures; add it")
        if (self.mesh is None) == (self.geometry is None):
            raise ValueError('give either mesh = "file" or geometry = "file.py"')
        for key in ("set", "unit"):
            if self.mesh is None and getattr(self, key) not in (None, "mm"):
                raise ValueError(f"{key} applies to mesh files only: remove it, or give mesh instead of geometry")
        if self.geometry is not None:
            if self.thickness is None:
                raise ValueError("a geometry source needs thickness, mm: add it")
            for key, usual in USUAL.items():  # no mesh file can have them
                object.__setattr__(self, key, usual if getattr(self, key) is None else getattr(self, key))
        for key in ("size", "accuracy"):
            if self.geometry is None and getattr(self, key) is not None and not (key == "size" and self._cad):
                raise ValueError(f"{key} applies to geometry sources only: remove it, or give geometry instead of mesh")
        if self._cad and not isinstance(self.size, float):
            raise ValueError("a CAD file needs an element size, mm: add size")
        if self.geometry is not None and self.size is None and self.accuracy is None:
            raise ValueError(
                "a geometry source needs size: an element size in mm, or one of the geometry's named sizes; or accuracy"
            )
        if self.size is not None and self.accuracy is not None:
            raise ValueError("give either size or accuracy, not both: accuracy finds the size")
        return self

    @property
    def _cad(self) -> bool:
        return self.mesh is not None and self.mesh.lower().endswith(CAD)

    @property
    def sheet(self) -> tuple[float, float, float]:
        """Thickness, mm, Young's modulus, MPa, and Poisson's ratio, after the mesh file is read."""
        if self.thickness is None or self.young is None or self.poisson is None:
            raise ValueError(f"part {self.name}: thickness and material of its mesh file are not read yet")
        return self.thickness, self.young, self.poisson
