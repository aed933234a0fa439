"""CAD files and MED meshes, converted by the program gmsh in a separate process with nothing but the file."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mic.errors import FormatError
from mic.geometry.readers import gmsh
from mic.geometry.readers.raw_mesh import RawMesh
from mic.system.foreign_files import temporary_folder
from mic.system.helper_program import run_program

__all__ = ["CAD_SUFFIXES", "LIMIT", "read_cad", "read_med"]

STEP = (".step", ".stp")
CAD_SUFFIXES = (*STEP, ".iges", ".igs", ".brep")
LIMIT = 120.0  # s that gmsh may take
MEMORY = 16e9  # bytes of address space that gmsh may use
INHERITED = ("LANG", "LD_LIBRARY_PATH", "PATH", "PYTHONPATH", "SYSTEMROOT")  # environment variables that gmsh gets


def read_cad(path: Path, size: float) -> RawMesh:
    """The surfaces of a CAD file in mm, meshed with elements of a size, mm.

    Raises
    ------
    FormatError
        If gmsh is missing, fails or exceeds the time limit, or the file holds a solid, whose skin is no mid-surface.
    """
    options = ["-2", "-clmax", repr(size)]
    if path.suffix.lower() in STEP:  # gmsh reads IGES in mm and knows no unit of BREP; it fails if asked for one
        options += ["-setstring", "Geometry.OCCTargetUnit", "MM"]
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
    """Temporary ``.msh`` file, version 4.1, that gmsh writes for a file of some kind with some command-line options.

    gmsh executes commands of a file ``NAME.opt`` beside its input, of its settings in the home folder, and of any input
    whose suffix it does not know. It therefore gets a copy of the input under a name of ours, in an empty folder that
    is also its home.
    """
    program = shutil.which("gmsh") or shutil.which("gmsh", path=str(Path(sys.executable).parent))
    if program is None:
        raise FormatError(f"gmsh, which reads {kind} files, is missing; install it: pip install 'mic-contact[mesh]'")
    with temporary_folder() as folder:
        source, mesh, printed = folder / f"source{path.suffix.lower()}", folder / "mesh.msh", folder / "printed.txt"
        shutil.copyfile(path, source)
        with open(program, "rb") as file:  # pip installs a script, whose first line may name another Python
            run = [sys.executable, program] if b"python" in file.readline() else [program]
        command = [*run, str(source), *options, "-format", "msh41", "-o", str(mesh), "-nt", "1", "-v", "2"]
        environment = {key: value for key, value in os.environ.items() if key in INHERITED}
        environment |= dict.fromkeys(("HOME", "GMSH_HOME", "TMPDIR"), str(folder))
        with open(printed, "wb") as output:
            status = run_program(command, LIMIT, environment, folder, output, MEMORY)
        if status is None:
            raise FormatError(f"gmsh took more than {LIMIT:g} s; give a larger size, or a mesh")
        lines = printed.read_text(encoding="utf-8", errors="replace").splitlines()
        error = next((line for line in lines if "Error" in line), "")
        if status or not mesh.is_file() or error:
            reason = " ".join(error.split()) or f"exit status {status}"
            raise FormatError(f"gmsh cannot read this {kind} file ({reason}); export it again, or in another format")
        yield mesh
