"""Three studies that cost next to nothing; as a program, ``cheap_studies.py FOLDER`` runs them on its MPI processes."""

import os
import sys
import time
from pathlib import Path

import numpy as np

from verification.run import run, team, write_summary
from verification.study import Acceptance, Finding, Study


def cell(i):
    return float(np.random.default_rng(i).standard_normal(1000).mean())


def long_first(i):
    time.sleep(0.5 * (i == 0))
    return os.getpid()


def means(context):
    values = context.team.map(cell, range(7))
    if context.team.size > 1:
        first, *others = context.team.map(long_first, range(7))
        assert first not in others, "the process that was busy with the first item got another"
    return [Finding("mean", max(map(abs, values))), Finding("sum", abs(sum(values)), "a note")]


def squares(context):
    return [Finding("square", max(context.team.map(lambda x: x * x, (0.5, 1.0, 2.0))))]


def broken(context):
    def item(i):
        if i == 3 and Path(sys.argv[-1], "break").exists():
            raise ArithmeticError("planted failure of item 3")
        return i

    return [Finding("total", sum(context.team.map(item, range(5))))]


def studies():
    common = dict(claim="c", reference="r", seconds=(1, 1))
    limits = Acceptance("mean", "Small.", 0.1), Acceptance("sum", "Small.", 0.01)
    ten, four = Acceptance("total", "Ten.", 10.0), Acceptance("square", "Four.", 4.0)
    long = common | {"seconds": (4, 4)}
    return [
        Study(1, "Means", acceptance=limits, run=means, name="means", **long),
        Study(2, "Squares", acceptance=(four,), run=squares, name="squares", **common),
        Study(3, "Broken", acceptance=(ten,), run=broken, name="broken", **common),
    ]


if __name__ == "__main__":
    workers, sizes, folder = team(), [5.0, 4.0, 2.0, 9.0, 1.0, 2.0, 3.0], Path(sys.argv[1])
    for i in workers.taken(sizes, 8.0):
        begun = time.time()
        time.sleep(0.3)
        Path(folder.parent, f"{i}.txt").write_text(f"{workers.rank} {begun} {time.time()} {sizes[i]}")
    run(studies(), folder, False, workers)
    if workers.rank == 0:
        write_summary(folder)
