"""One sheet of three elements in every mesh format that is read, and decks with sections, from tests/data."""

from pathlib import Path

import numpy as np

__all__ = ["ABAQUS", "AREA", "FILES", "NASTRAN_FREE", "OBJ", "OFF", "PLY", "POINTS", "VTK", "deck_text"]

DATA = Path(__file__).resolve().parents[1] / "data"
#: A quadrilateral from x = 0 to 1 and a triangle beside it, in the plane z = 3x/4; areas 1.25 and 0.625.
POINTS = np.array([[0, 0, 0], [1, 0, 0.75], [1, 1, 0.75], [0, 1, 0], [2, 0, 1.5]])
AREA = 1.875  #: of the sheet
#: Text of the sheet by file name.
FILES = {path.name: path.read_text(encoding="utf-8") for path in sorted((DATA / "meshes").iterdir())}
FILES |= {"part.key": FILES["part.k"], "part.dyn": FILES["part.k"], "small.dat": FILES["small.bdf"]}
ABAQUS, NASTRAN_FREE, OBJ = FILES["part.inp"], FILES["free.fem"], FILES["sheet.obj"]
OFF, PLY, VTK = FILES["sheet.off"], FILES["sheet.ply"], FILES["sheet.vtk"]


def deck_text(name: str) -> str:
    """Text of the deck called `name`: the same sheet as two parts, with sections, materials and sets."""
    return (DATA / "decks" / name).read_text(encoding="utf-8")
