"""CAD files and MED meshes, converted by the program gmsh, which runs as a process and is not imported."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from mic.errors import FormatError
from mic.geometry.readers import gmsh
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["CAD_SUFFIXES", "LIMIT", "read_cad", "read_med"]

CAD_SUFFIXES = (".step", ".stp", ".iges", ".igs", ".brep")
LIMIT = 300.0  # s that gmsh may take


def read_cad(path: Path, size: float) -> RawMesh:
    """The surfaces of a CAD file in mm, meshed with elements of a size, mm.

    Raises
    ------
    FormatError
        If gmsh is missing, fails or exceeds the time limit, or the file holds a solid, whose skin is no mid-surface.
    """
    options = ["-2", "-clmax", repr(size), "-setstring", "Geometry.OCCTargetUnit", "MM"]
    options += ["-setnumber", "Mesh.MeshSizeFromCurvature", "12", "-setnumber", "Mesh.MeshSizeMin", repr(size / 20)]
    with _converted(path, "CAD", options) as mesh:
        if gmsh.volumes(mesh):
            raise FormatError("it holds a solid, whose skin is no mid-surface; export the mid-surface as a sheet")
        return gmsh.read(mesh)


def read_med(path: Path) -> RawMesh:
    """MED files of Salome and code_aster; groups of elements become physical groups.

    Raises
    ------
    FormatError
        If gmsh is missing, fails or exceeds the time limit.
    """
    with _converted(path, "MED", ["-save", "-setnumber", "Mesh.SaveAll", "1"]) as mesh:
        return gmsh.read(mesh)


@contextmanager
def _converted(path: Path, kind: str, options: Sequence[str]) -> Iterator[Path]:
    """Temporary ``.msh`` file, version 4.1, that gmsh writes for a file of some kind with some command-line options."""
    program = shutil.which("gmsh") or shutil.which("gmsh", path=str(Path(sys.executable).parent))
    if program is None:
        raise FormatError(f"gmsh, which reads {kind} files, is missing; install it: pip install 'mic-contact[mesh]'")
    with TemporaryDirectory() as folder:
        mesh = Path(folder) / "mesh.msh"
        with open(program, "rb") as file:  # pip installs a script, whose first line may name another Python
            run = [sys.executable, program] if b"python" in file.readline() else [program]
        command = [*run, str(path.resolve()), *options, "-format", "msh41", "-o", str(mesh), "-nt", "1", "-v", "2"]
        try:
            process = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, cwd=folder)
        except subprocess.TimeoutExpired:
            raise FormatError(f"gmsh took more than {LIMIT:g} s; give a larger size, or a mesh") from None
        error = next((line for line in (process.stderr + process.stdout).splitlines() if "Error" in line), "")
        if process.returncode or not mesh.is_file() or error:
            reason = " ".join(error.split()) or f"exit status {process.returncode}"
            raise FormatError(f"gmsh cannot read this {kind} file ({reason}); export it again, or in another format")
        yield mesh
