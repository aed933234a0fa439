"""All files of a case, as they are shipped: values, page, picture, plain data, contact problem."""

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

SOURCES = ("scene.toml", "geometry.py", "about.md")  # what the others are made from


def publish(case: Case, folder: Path, cache: Path, python: str, anew: bool = True) -> None:
    """Write a case's files into a folder.

    Parameters
    ----------
    case : Case
    folder : Path
        Made where it is missing; the case's own is one.
    cache : Path
    python : str
        A Python that has numpy and h5py; where it has not, the contact problem is left out.
    anew : bool
        Whether values are computed, or taken as they are shipped.

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
