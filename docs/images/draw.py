"""Draw the README's pictures from the results of the wheelhouse: python docs/images/draw.py [results/wheelhouse]"""

import sys
from pathlib import Path

from mic.report import pictures
from mic.results.fields import read_fields
from mic.results.outcome import read_outcome


def main(folder):
    outcome = read_outcome(folder)
    surfaces = {part.name: part.surface for part in outcome.parts}
    for name, picture in (
        ("wheelhouse", pictures.overview_picture(outcome, surfaces, read_fields(folder)[0], "coulomb")),
        ("slip_density", pictures.slip_density_picture(outcome, outcome.stages[0])),
    ):
        (Path(__file__).parent / f"{name}.{picture.kind}").write_bytes(picture.data)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/wheelhouse"))
