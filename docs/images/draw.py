"""Draw the README's pictures from a run of the wheelhouse.

Run ``python docs/images/draw.py [FOLDER]`` from the root of the project after ``script/run``. FOLDER is the folder of
the run, ``results/wheelhouse`` by default. The pictures are written beside this file.
"""

import sys
from pathlib import Path

from mic.report.context import read_context
from mic.report.picture_registry import draw
from mic.results.outcome import read_outcome

FILES = {"overview": "wheelhouse", "tangential-density": "tangential_density"}  # picture of the report -> file


def main(folder: Path) -> int:
    """Write both pictures; returns the exit code."""
    outcome = read_outcome(folder)
    context = read_context(outcome)
    drawn = {name: draw(name, outcome, context) for name in FILES}
    missing = [name for name, picture in drawn.items() if picture is None]
    if missing:
        print(
            f"{folder}: has no data for {', '.join(missing)}; run the scene with report.fields = true", file=sys.stderr
        )
        return 1
    for name, picture in drawn.items():
        path = Path(__file__).parent / f"{FILES[name]}.{picture.kind}"
        path.write_bytes(picture.data)
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/wheelhouse")))
