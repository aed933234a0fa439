"""Sheets from CAD (``.step``, ``.iges``, ``.brep``), meshed by the program gmsh, which is called and not imported."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from mic.errors import FormatError
from mic.geometry.readers import gmsh
from mic.geometry.readers.raw import RawMesh

__all__ = ["SUFFIXES", "read"]

SUFFIXES = (".step", ".stp", ".iges", ".igs", ".brep")
LIMIT = 300.0  # s that gmsh may take


def read(path: Path, size: float) -> RawMesh:
    """The surfaces of a CAD file in mm, meshed with elements of a size, mm.

    Raises
    ------
    FormatError
        If gmsh is missing, fails or takes too long, or the file holds a solid, whose skin is no mid-surface.
    """
    program = shutil.which("gmsh") or shutil.which("gmsh", path=str(Path(sys.executable).parent))
    if program is None:
        raise FormatError("CAD files are meshed by gmsh, which is missing; install it: pip install 'mic-contact[mesh]'")
    with TemporaryDirectory() as folder:
        mesh = Path(folder) / "mesh.msh"
        with open(program, "rb") as file:  # pip installs a script, whose first line may name another Python
            run = [sys.executable, program] if b"python" in file.readline() else [program]
        command = [
            *run,
            str(path.resolve()),
            "-2",
            "-format",
            "msh41",
            "-o",
            str(mesh),
            "-clmax",
            repr(size),
            "-nt",
            "1",
        ]
        command += ["-setstring", "Geometry.OCCTargetUnit", "MM", "-setnumber", "Mesh.MeshSizeFromCurvature", "12"]
        command += ["-setnumber", "Mesh.MeshSizeMin", repr(size / 20), "-v", "2"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, cwd=folder)
        except subprocess.TimeoutExpired:
            raise FormatError(f"gmsh did not mesh it in {LIMIT:g} s; mesh it, or ask for a larger size") from None
        told = next((line for line in (done.stderr + done.stdout).splitlines() if "Error" in line), "")
        if done.returncode or not mesh.is_file() or told:
            words = " ".join(told.split()) or f"it ended with {done.returncode}"
            raise FormatError(f"gmsh cannot mesh this CAD file ({words}); export it again, or a mesh of it")
        if gmsh.volumes(mesh):
            raise FormatError(
                "it holds a solid, and the skin of a solid is no mid-surface; export the mid-surface as a sheet"
            )
        return gmsh.read(mesh)
