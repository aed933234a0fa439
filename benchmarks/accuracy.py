"""Error estimates of `mic check --accuracy` against true errors: the tables of docs/shells.md.

    PYTHONPATH=.:tests python benchmarks/accuracy.py        # three minutes

Truth is the same element on a finer mesh of the same sheet, with H and the measured point as the estimate has them.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from support.curved import CROWN, curved_assembly, held_compliance, mesh_of

from mic import cache_folder
from mic.compliance.cache import influence_coefficients
from mic.model.mesh_accuracy import estimate_accuracy
from mic.process.model import ReducedModel

#: Height over x and y, mm
SHEETS = {
    "saddle": "(x - 60) ** 2 / 300 - (y - 40) ** 2 / 220 + 6",
    "cylinder askew to its cells": "np.sqrt(160.0**2 - (0.8 * (x - 60) + 0.6 * (y - 40)) ** 2) - 148",
    "bulge": "12 * np.exp(-((x - 70) ** 2 + (y - 40) ** 2) / 900) + x / 30",
    "cap of a ball": "np.sqrt(220.0**2 - (x - 60) ** 2 - (y - 40) ** 2) - 205",
    "piece of a torus": "np.sqrt((90 + np.sqrt(60.0**2 - (y - 40) ** 2)) ** 2 - (x - 60) ** 2) - 130",
    "cone": "np.sqrt((40 + x / 3) ** 2 - ((y - 40) * 0.9) ** 2) - 30 + x / 8",
}


def relative(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


def compliance(assembly):
    return held_compliance(ReducedModel.build(assembly, influence_coefficients(assembly, cache_folder())[0]))


def beside(assembly, limit):
    """True errors of H and of the measured point (2, 2), on six locators and on all, and their estimates."""
    found = compliance(assembly)
    true = [[relative(H[rows], L[rows]) for H, L in zip(found, limit)] for rows in (slice(0, 2), slice(2, 3))]
    (accuracy,) = estimate_accuracy(assembly, cache_folder())
    return np.array(true), np.array([[one.set_down, one.located] for one in accuracy.estimates]), accuracy.mesh.nodes


def sheet(place, **how):
    """Write the sheet's scene and mesh into a new folder within `place`."""
    return curved_assembly(Path(tempfile.mkdtemp(dir=place)), cache_folder(), **how)


def row(*cells):
    print(f"| {' | '.join(cells)} |", flush=True)


def pair(values, form="{:.1f}"):
    return " / ".join(form.format(value) for value in values)


def effectivity(place):
    """The crowned sheet on three sizes, by its script and from a file."""
    heads = ("true error of H, six locators / all", "estimate over it") * 2
    row("part and mesh", *heads[:2], "of the measured point", heads[1])
    row(*["---"] * 5)
    limit = compliance(sheet(place, size=1.25))
    for size in (20.0, 10.0, 5.0):
        for source, how in (("script", {"size": size}), ("a file", {"mesh": mesh_of(size)})):
            true, told, _ = beside(sheet(place, **how), limit)
            shown = [f"{pair(100 * part)} %" if source == "script" else "" for part in true]
            shares = [pair(part, "{:.2f}") for part in told / true]
            row(f"crowned sheet, {size:g} mm, {source}", shown[0], shares[0], shown[1], shares[1])


def reached(place):
    """Sheets that state an accuracy."""
    print()
    last = "estimate over it, least and largest"
    row("sheet, accuracy = 0.01", "size", "nodes", "true error of H", "of the measured point", last)
    row(*["---"] * 6)
    for name, height in {"crowned": CROWN, **SHEETS}.items():
        assembly = sheet(place, accuracy=0.01, height=height)
        size = float(assembly.sizes["sheet"])
        limit = compliance(sheet(place, size=size / 4, height=height))
        true, told, nodes = beside(assembly, limit)
        share = told / true
        errors = [f"{pair(100 * part, '{:.2f}')} %" for part in true]
        row(name, f"{size:g} mm", str(nodes), *errors, f"{share.min():.2f}, {share.max():.2f}")


def main():
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    with tempfile.TemporaryDirectory() as place:
        effectivity(place)
        reached(place)


if __name__ == "__main__":
    main()
