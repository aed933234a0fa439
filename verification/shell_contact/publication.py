"""All published files of a case: values, page, picture, plain data, contact problem."""

from __future__ import annotations

import shutil
from pathlib import Path

from verification.shell_contact import fclib
from verification.shell_contact.case import Case
from verification.shell_contact.converged import converged, read, write
from verification.shell_contact.deck import data, mesh
from verification.shell_contact.page import page
from verification.shell_contact.picture import picture
from verification.shell_contact.problem import contact_problem

__all__ = ["SOURCES", "publish"]

SOURCES = ("scene.toml", "geometry.py", "about.md")  # sources of the other files


def publish(case: Case, folder: Path, cache: Path, python: str, anew: bool = True) -> None:
    """Write the files of a case into a folder.

    Parameters
    ----------
    case : Case
    folder : Path
        Created if missing; may be the folder of the case.
    cache : Path
    python : str
        Interpreter with numpy and h5py; without h5py no contact problem is written.
    anew : bool
        Whether values are computed, or taken from the published ones.

    Raises
    ------
    ValueError
        If a case cannot be solved.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if folder.resolve() != case.folder.resolve():
        for name in SOURCES:
            shutil.copyfile(case.folder / name, folder / name)
    values = converged(case, cache) if anew else read(case)
    write(folder / "values.csv", values)
    (folder / "README.md").write_text(page(case, values, cache), encoding="utf-8")
    (folder / "picture.png").write_bytes(picture(case, cache))
    (folder / "mesh.inp").write_text(mesh(case, cache))
    (folder / "case.json").write_text(data(case, cache), encoding="utf-8")
    if fclib.available(python):
        fclib.write(folder / "problem.hdf5", contact_problem(case, cache), python)
