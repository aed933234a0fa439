"""Error and cost of the curved and the flat triangle on curved sheets: docs/curved_triangle.md.

python benchmarks/curved.py        # some two minutes

Further results: quadrilateral cells divided without regard to curvature and as decks are divided, on eight other
meshes; locking of the flat triangle as a function of the rise of a side over the thickness (docs/shells.md); and
processor time of assembling the stiffness, the least of five.
"""

from __future__ import annotations

import time
from types import SimpleNamespace

from fem_reference.shell.part import ShellPart
from verification.curved_sheets import sheets
from verification.curved_sheets.study import measure, table

SEEDS = range(101, 109)


def main():
    alone = SimpleNamespace(map=lambda task, items: [task(item) for item in items])
    found = table(measure(SimpleNamespace(quick=False, team=alone)))
    print(f"| {' | '.join(name.removesuffix(', %') for name in found.columns)} |")
    print("| --- " * len(found.columns) + "|")
    for _, row in found.iterrows():
        print(f"| {row.iloc[0]} | {' | '.join(f'{value:.2f} %' for value in row.iloc[1:])} |".replace("-", "−"))
    scatter()
    locking()
    print(f"\nassembly over the flat triangle's: {cost('dkt-opt-curved') / cost('dkt-opt'):.3f}")


def scatter():
    """Least and largest error over meshes that are not in the study."""
    print("\n| over eight meshes | exact normals | estimated normals |\n| --- | --- | --- |")
    cases = {"hemisphere": lambda kind, seed: sheets.hemisphere("dkt-opt-curved", kind, seed) - 1}
    for h in (10.0, 5.0):
        for split in ("in turn", "other", "deck"):
            cases[f"panel, {h:g} mm, divided: {split}"] = lambda kind, seed, h=h, split=split: sheets.panel_error(
                "dkt-opt-curved", kind, seed, h, split=split
            )
    for name, error in cases.items():
        found = [sorted(100 * error(kind, seed) for seed in SEEDS) for kind in ("exact", "mesh")]
        print(f"| {name} | {' | '.join(f'{one[0]:.2f} … {one[-1]:.2f} %' for one in found)} |".replace("-", "−"))


def locking():
    rises = (0.12, 0.3, 1.0, 3.0, 12.0)
    print(f"\n| rise / t | {' | '.join(f'{rise:g}' for rise in rises)} |\n" + "| --- " * (len(rises) + 1) + "|")
    for element in ("dkt-opt", "p2-cr", "dkt-opt-curved"):
        errors = [100 * sheets.cylinder(element, "mesh", 0, rise) - 100 for rise in rises]
        cells = " | ".join(f"{error:.1f} %" for error in errors).replace("-", "−")
        print(f"| `{element}` | {cells} |")


def cost(element):
    """Seconds of the processor."""
    surface, least = sheets.panel(2.0, 0.2, 1, "exact"), float("inf")
    ShellPart(surface, 1.2, 210e3, 0.3, element).stiffness_csr()  # compiles
    for _ in range(5):
        part = ShellPart(surface, 1.2, 210e3, 0.3, element)
        start = time.process_time()
        part.stiffness_csr()
        least = min(least, time.process_time() - start)
    return least


if __name__ == "__main__":
    main()
