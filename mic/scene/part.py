"""The table of a part."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from mic.scene.keys import FiniteFloat, Flag, Name, Positive, Table

__all__ = [
    "CAD",
    "Part",
    "USUAL",
]

#: Suffixes of CAD files, which are meshed when they are read.
CAD = (".step", ".stp", ".iges", ".igs", ".brep")
#: What a sheet is where neither the scene nor a mesh file tells it: drawn in its middle, of steel; MPa.
USUAL = {"offset": 0.0, "young": 210e3, "poisson": 0.3}


class Part(Table):
    """One sheet-metal part."""

    name: Name = Field(description="names the part in every other table")
    mesh: str | None = Field(
        None,
        description="mesh file of the sheet, triangles or quadrilaterals: gmsh, Abaqus, Nastran, LS-DYNA, STL, VTK, …; "
        "or a CAD file of its mid-surface, STEP, IGES",
    )
    set: str | Annotated[list[str], Field(min_length=1)] | None = Field(
        None,
        description="with `mesh`: the element sets, properties or physical groups of the file that are this part; "
        "left out, all of it",
    )
    unit: Literal["mm", "cm", "m", "um", "in", "ft"] = Field(
        "mm", description="with `mesh`: of length in the file; its stresses are in the unit that goes with it"
    )
    geometry: str | None = Field(
        None,
        description="or a Python file with `build(part, size) -> (points (n, 3), triangles (k, 3))`, or with normals "
        "(k, 3, 3) at the corners of the triangles as a third; it is executed",
    )
    size: str | Positive | None = Field(
        None, description="with `geometry`: element size in mm, or a name from its `SIZES`; with a CAD file in mm"
    )
    accuracy: Annotated[FiniteFloat, Field(gt=0, le=0.5)] | None = Field(
        None,
        description="or the share by which influence coefficients may be off, such as 0.01: the size is then found by "
        "solving the part on finer and finer meshes",
    )
    thickness: Positive | None = Field(
        None, description="of the sheet, mm; may be left out where the mesh file tells it"
    )
    offset: Annotated[FiniteFloat, Field(ge=-5, le=5)] | None = Field(
        None,
        description="from the surface as drawn to the middle of the sheet, as a share of the thickness, positive along "
        "the normals of the mesh: ±0.5 where it is drawn on a skin; left out, what the mesh file tells, else 0",
    )
    young: Positive | None = Field(
        None, description="Young's modulus, MPa; left out, what the mesh file tells, else 210 000"
    )
    poisson: Annotated[FiniteFloat, Field(gt=-1, lt=0.5)] | None = Field(
        None, description="Poisson's ratio, −1 < ν < ½; left out, what the mesh file tells, else 0.3"
    )
    density: Positive | None = Field(None, description="kg/m³, such as 7850; needed where gravity acts")
    expansion: Positive | None = Field(
        None, description="coefficient of thermal expansion, 1/K, such as 1.2e-5; needed where temperature deviates"
    )
    rests: Flag = Field(
        False,
        description="whether it rests on other parts or fixtures: what its locators leave free, contact and friction "
        "in its zones must hold; it is put down where it is drawn, or as near to that as nothing overlaps",
    )

    stiffness: str | None = Field(
        None,
        description="with `mesh`: file of the part's reduced stiffness on named nodes, in place of finite elements: a "
        "Matrix Market file or Nastran `OUTPUT4` with a node table beside it (`a.mtx` or `a.op4`, `a.csv` with node, "
        "x, y, z), Nastran `DMIG`, output of Abaqus `*MATRIX GENERATE`; free of supports",
    )
    compliance: str | None = Field(
        None, description="or of its reduced compliance, on any statically determinate support; the same formats"
    )

    @model_validator(mode="after")
    def _one_source(self):
        if self.stiffness is not None and self.compliance is not None:
            raise ValueError("give stiffness or compliance, not both")
        for key in ("stiffness", "compliance"):
            if self.mesh is None and getattr(self, key) is not None:
                raise ValueError(f"{key} needs mesh: the surface of the part, for pairs and pictures; add it")
        if (self.mesh is None) == (self.geometry is None):
            raise ValueError('give either mesh = "file" or geometry = "file.py", not both and not neither')
        for key in ("set", "unit"):
            if self.mesh is None and getattr(self, key) not in (None, "mm"):
                raise ValueError(f"{key} applies to mesh files only: remove it, or give mesh instead of geometry")
        if self.geometry is not None:
            if self.thickness is None:
                raise ValueError("a geometry source needs thickness, mm: add it")
            for key, usual in USUAL.items():  # nobody else will be asked for them
                object.__setattr__(self, key, usual if getattr(self, key) is None else getattr(self, key))
        for key in ("size", "accuracy"):
            if self.geometry is None and getattr(self, key) is not None and not (key == "size" and self._cad):
                raise ValueError(f"{key} applies to geometry sources only: remove it, or give geometry instead of mesh")
        if self._cad and not isinstance(self.size, float):
            raise ValueError("a CAD file is meshed here and needs size, mm: add it")
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
        """Thickness, mm, Young's modulus, MPa, and Poisson's ratio, once what the mesh file tells is filled in."""
        if self.thickness is None or self.young is None or self.poisson is None:
            raise ValueError(f"part {self.name}: its mesh file has not been asked for thickness and material")
        return self.thickness, self.young, self.poisson
