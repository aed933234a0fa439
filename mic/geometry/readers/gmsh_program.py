"""The program gmsh, called and never imported: what it can read or mesh comes back as a file of its own format."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from mic.errors import FormatError

__all__ = ["LIMIT", "written"]

LIMIT = 300.0  # s that gmsh may take


@contextmanager
def written(path: Path, kind: str, options: Sequence[str]) -> Iterator[Path]:
    """The ``.msh`` file, of version 4.1, that gmsh writes of another file; it is gone afterwards.

    Parameters
    ----------
    path : Path
    kind : str
        What such files are called, for errors.
    options : sequence of str
        Of the command.

    Raises
    ------
    FormatError
        If gmsh is missing, fails or takes too long.
    """
    program = shutil.which("gmsh") or shutil.which("gmsh", path=str(Path(sys.executable).parent))
    if program is None:
        raise FormatError(
            f"{kind} files are read by gmsh, which is missing; install it: pip install 'mic-contact[mesh]'"
        )
    with TemporaryDirectory() as folder:
        mesh = Path(folder) / "mesh.msh"
        with open(program, "rb") as file:  # pip installs a script, whose first line may name another Python
            run = [sys.executable, program] if b"python" in file.readline() else [program]
        command = [*run, str(path.resolve()), *options, "-format", "msh41", "-o", str(mesh), "-nt", "1", "-v", "2"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, cwd=folder)
        except subprocess.TimeoutExpired:
            raise FormatError(f"gmsh took more than {LIMIT:g} s; mesh it, or ask for a larger size") from None
        told = next((line for line in (done.stderr + done.stdout).splitlines() if "Error" in line), "")
        if done.returncode or not mesh.is_file() or told:
            words = " ".join(told.split()) or f"it ended with {done.returncode}"
            raise FormatError(f"gmsh cannot read this {kind} file ({words}); export it again, or another mesh of it")
        yield mesh
