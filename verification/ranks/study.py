"""One full solve distributed over MPI processes: the same solution, less memory and less work for each."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from verification.comparison import relative
from verification.plots import panels
from verification.study import FOLDER, Acceptance, Finding, Study

#: Scene, mesh, and numbers of processes.
SOLVES = (("lap_joint", "coarse", (1, 2, 4)), ("wheelhouse", "medium", (1, 2)))
QUICK_SOLVES = (("hat_on_plate", "coarse", (1, 2)),)
LAUNCHED = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "MPI_")  # variables of the mpirun that started this process
#: More processes than cores, bound to none: MPICH does so by itself, Open MPI 4 if OMPI_ asks for it, 5 if PRTE_ does.
SETTINGS = {
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "PRTE_MCA_hwloc_default_binding_policy": "none",
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_mpi_yield_when_idle": "1",  # processes that wait leave their core to others
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}
KINDS = ("force", "displacement", "reaction", "measurements")
AGREE = 1e-8  # limit of the small solve
COLUMNS = ("wall time, s", "operations", "factors, MB", "memory, MB")


def launcher() -> str | None:
    """Path of ``mpirun`` of this Python's environment, else of the system; None if there is none."""
    return shutil.which("mpirun", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))


def missing() -> str:
    """Name the missing requirement of the study."""
    return "" if launcher() else "mpirun is not installed"


def solve(name: str, size: str, count: int, cache: Path) -> dict[str, np.ndarray]:
    """Results and costs of a full solve on `count` processes, which mpirun starts, also from a process of mpirun.

    Raises
    ------
    RuntimeError
        With its output, if it fails.
    """
    cache = cache.resolve()  # the processes start in it
    result = cache / f"ranks-{name}-{size}-{count}.npz"
    command = [launcher(), "-n", str(count), sys.executable, "-m", "mpi4py", "-m", "verification.ranks.solve"]
    environment = {key: value for key, value in os.environ.items() if not key.startswith(LAUNCHED)} | SETTINGS
    environment["PYTHONPATH"] = os.pathsep.join([str(FOLDER.parent), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [*command, name, size, str(cache), str(result)], env=environment, capture_output=True, text=True, cwd=cache
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    with np.load(result) as data:
        return dict(data)


def compare(solved: dict[int, dict[str, np.ndarray]]) -> pd.DataFrame:
    """Costs of a solve by number of processes, and the largest relative difference from one process."""
    rows, alone = [], solved[1]
    for count, found in solved.items():
        costs = pd.DataFrame(found["costs"], columns=COLUMNS)
        rows.append(
            {
                "freedoms": int(found["size"][0]),
                "contacts": int(found["size"][1]),
                "processes": count,
                "route": str(found["route"]),
                "wall time, s": costs["wall time, s"].max(),
                "speed-up": np.nan,
                "largest share of the operations": costs["operations"].max() / costs["operations"].sum(),
                "largest factors, MB": costs["factors, MB"].max(),
                "largest memory, MB": costs["memory, MB"].max(),
            }
            | {
                f"difference, {kind}": max(
                    relative(found[key], value) for key, value in alone.items() if key.startswith(kind)
                )
                for kind in KINDS
            }
        )
    table = pd.DataFrame(rows)
    off = table.filter(like="difference").max(axis=1)
    return table.assign(**{"speed-up": table["wall time, s"].iloc[0] / table["wall time, s"], "difference": off})


def _differences(small, limit):
    """Figure: differences of the small solve from one process, by number of processes."""
    figure, (axis,) = panels(1, 4.5)
    several = small[small["processes"] > 1]
    for kind in KINDS:
        axis.semilogy(several["processes"].astype(str), several[f"difference, {kind}"], "o", label=kind)
    axis.axhline(limit, color="k", ls=":", label="limit")
    axis.set(xlabel="processes", ylabel="relative difference from one process")
    axis.legend()
    return figure


def _costs(table):
    """Figure: wall time and memory of the large solve by number of processes."""
    figure, axes = panels(2, 3.6)
    of_large = table[table["freedoms"] == table["freedoms"].max()]
    place = [str(count) for count in of_large["processes"]]
    for axis, column in zip(axes, ("wall time, s", "largest memory, MB")):
        bars = axis.bar(place, of_large[column], width=0.5, color="tab:blue")
        axis.bar_label(bars, fmt="%.0f")
        axis.set(xlabel="processes", ylabel=column)
    axes[1].bar(place, of_large["largest factors, MB"], width=0.5, color="tab:orange", label="of which factors")
    axes[1].legend()
    return figure


def run(context):
    found = None
    if context.team.rank == 0:
        tables = []
        for name, size, counts in QUICK_SOLVES if context.quick else SOLVES:
            solved = {count: solve(name, size, count, context.cache) for count in counts}
            tables.append(compare(solved).assign(assembly=name))
        found = pd.concat(tables, ignore_index=True)
    context.team.wait()
    table = context.team.from_first(found)
    large = table[table["freedoms"] == table["freedoms"].max()].set_index("processes")
    small = table[table["freedoms"] == table["freedoms"].min()]
    one, two = large.loc[1], large.loc[2]
    return [
        Finding(
            "agreement",
            small["difference"].max(),
            f"{one_of(small)} on {', '.join(map(str, small['processes']))} processes; route: {small['route'].iloc[0]}.",
            _differences(small, AGREE),
            table,
        ),
        Finding("large-agreement", two["difference"], f"{one_of(large)}, two processes against one."),
        Finding(
            "memory",
            two["largest memory, MB"] / one["largest memory, MB"],
            f"Largest process: {two['largest memory, MB']:.0f} MB of two, {one['largest memory, MB']:.0f} MB of one; "
            f"its factors {two['largest factors, MB']:.0f} MB and {one['largest factors, MB']:.0f} MB. Wall time "
            f"{one['wall time, s']:.1f} s on one process, {two['wall time, s']:.1f} s on two: speed-up "
            f"{two['speed-up']:.2f}. It is not judged, because other studies may use the cores at the same time.",
            _costs(table),
        ),
        Finding(
            "work",
            two["largest share of the operations"],
            "Operations of the last factorisation of every step, as MUMPS counts them; one half is ideal.",
        ),
    ]


def one_of(rows: pd.DataFrame) -> str:
    """The solve of these rows in words."""
    row = rows.iloc[0]
    return f"{row['assembly'].replace('_', ' ').capitalize()}, {row['freedoms']} freedoms, {row['contacts']} contacts"


STUDY = Study(
    order=12,
    title="Processes",
    claim=(
        "A full solve that PETSc distributes over processes has the solution of one process, and each process has less "
        "memory and less work."
    ),
    reference="The same full solve on one process; mpirun starts 1, 2 and 4 processes.",
    acceptance=(
        Acceptance(
            "agreement",
            "Lap joint on 2 and 4 processes (quick: hat on 2) against one: largest relative difference of all results.",
            AGREE,
            reason="Rounding: 1e-16 times the condition of a shell's stiffness, about 1e8.",
        ),
        Acceptance(
            "large-agreement",
            "Large solve on two processes against one: largest relative difference of all results.",
            2e-7,
            reason=(
                "Rounding: 2.2e-16 times the condition of a plate's stiffness, which grows as the square of its number "
                "of nodes, here 29,500."
            ),
        ),
        Acceptance(
            "memory",
            "Memory of the largest of two processes over that of one process, large solve.",
            0.8,
            quick=1.0,
            reason=(
                "Two processes must fit a mesh that is a quarter larger. A small mesh (quick) needs less than Python "
                "and its libraries, which each process loads."
            ),
        ),
        Acceptance(
            "work",
            "Share of the busiest of two processes in the operations of the elimination, large solve.",
            0.75,
            reason="Two processes must save at least a quarter of the elimination's time; one half is ideal.",
        ),
    ),
    seconds=(135, 25),
    memory=4.0,
    missing=missing,
    run=run,
)
