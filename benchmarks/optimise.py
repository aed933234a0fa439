"""Gain of an optimisation compared with random designs at the same number of evaluations.

python benchmarks/optimise.py                             # the wheelhouse as it is shipped
python benchmarks/optimise.py SCENE --samples 40 --fresh 2000 --budget 3000 --folder FOLDER

Both search on the same samples with the same budget, and the best design of each is evaluated on fresh samples. The
folder stores all evaluations, so that an interrupted call resumes.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import mic
from mic import examples
from mic.studies.optimisation.design import Design, Space
from mic.studies.optimisation.evaluations import BudgetExceeded, DesignEvaluator
from mic.studies.optimisation.optimum import evaluate_design, optimise


def random_design(space: Space, stream: np.random.Generator) -> Design:
    """A design at random: settings uniform within their bounds, orders and places with equal chances."""
    settings = space.settable(stream.uniform(space.low, space.high))
    orders = tuple(tuple(groups[i] for i in stream.permutation(len(groups))) for groups in space.groups)
    return Design(settings, orders, tuple(int(stream.integers(len(points))) for points in space.points))


def by_chance(trials: DesignEvaluator, stream: np.random.Generator):
    """The best of as many random designs as the budget allows, and their number."""
    best, count = trials.space.stated, 0
    try:
        trials.merit(best)
        while True:
            design = random_design(trials.space, stream)
            best = design if trials.merit(design) < trials.merit(best) else best
            count += 1
    except BudgetExceeded:
        return best, count


def main():
    asked = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    asked.add_argument("scene", nargs="?", default=examples.folder("wheelhouse"))
    for name, value in (("samples", 40), ("fresh", 2000), ("budget", 3000), ("seed", 1)):
        asked.add_argument(f"--{name}", type=int, default=value)
    asked.add_argument("--folder", type=Path, default=Path("results/optimise"))
    given = asked.parse_args()
    model = mic.reduce(mic.load_scene(given.scene))
    law, ledger = model.scene.report.laws[0], given.folder / "evaluated.jsonl"
    before = time.process_time()

    def tell(changes, value):
        print(f"{time.process_time() - before:8.1f} CPU s  {value:.4g}  {'; '.join(map(str, changes))}", flush=True)

    found = optimise(model, law, given.samples, given.fresh, given.budget, given.seed, ledger=ledger, better=tell)
    show("optimised", found, time.process_time() - before)
    before = time.process_time()
    trials = DesignEvaluator(model, Space(model), law, found.samples, given.seed, found.evaluations, ledger=ledger)
    best, count = by_chance(trials, np.random.default_rng(given.seed))
    show(
        f"best of {count} at random",
        evaluate_design(trials, best, found.samples, given.fresh),
        time.process_time() - before,
    )


def show(name, found, took):
    print(
        f"{name}: {found.evaluations} evaluations, {took:.0f} CPU s with those on fresh samples (none of what was kept)"
    )
    print(f"  {found.objective} on {found.samples} samples of the search {found.found:.4g}")
    print(f"  on {found.fresh} fresh samples {found.before:.4g} -> {found.after:.4g}", end=", ")
    print(f"gain {found.gain.value:.4g} ({found.gain.low:.4g} ... {found.gain.high:.4g})")
    for change in found.changes:
        print(f"  {change}")
    print(found.table[["quantity", "six_sigma_a", "six_sigma_b", "cpk_a", "cpk_b"]].iloc[1:].to_string(), flush=True)


if __name__ == "__main__":
    main()
