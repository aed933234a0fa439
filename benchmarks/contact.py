"""Contact solvers compared: time per sample, ratio to the native solver, residual of the law that each one solves.

    python benchmarks/contact.py                     # all cases, about ten minutes
    python benchmarks/contact.py --quick             # few samples, no growth beyond 300 contacts
    python benchmarks/contact.py --scene meshes/wheelhouse   # the contact problems of a scene's Monte Carlo, by stage

All solvers run in this process: first on one thread, by processor time; then the native solver on all cores, by wall
time. The goals come last, with the values of commit bf8188e. Residuals are the scale-free certificate of
:mod:`mic.contact.certificate` for Coulomb's law, or for the associated law if the solver supports only that.
Preparation that depends on S alone is not timed for any solver. Solvers that are not installed are skipped and named;
the versions of the others are printed below the table. To use another build of Siconos, put its folder on PYTHONPATH.
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import time
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import mic
from mic.contact import ContactSolver, certify
from mic.contact.friction import Friction
from mic.contact.laws import LAWS, pressure_dependent
from mic.process import process
from mic.statistics.draw import draw
from verification.contact_problems import ContactProblem, compliant, manufactured, slip_dominated

#: A solver that is slower than this on one case stops after the samples done so far.
SECONDS_PER_CASE = 10.0
STUCK, LARGE = "90 % stuck", "stick, 1000 contacts"
PAPER = "CVXPY + ECOS, (13) as printed"
COLUMNS = [
    "case",
    "contacts",
    "solver",
    "law",
    "samples",
    "ms_median",
    "ms_max",
    "ratio",
    "residual_median",
    "residual_max",
    "failed",
]


@dataclass
class Competitor:
    """A name, a law, and a function from problem to a function from one ``b`` to a force."""

    name: str
    law: str
    prepare: object


def cvxpy_backend(backend):
    def prepare(problem):
        solver = ContactSolver(problem.S, problem.mu, "associated", backend)
        solver.solve(problem.b[0])  # CVXPY canonicalises at the first call
        return lambda b: solver.solve(b).force

    return prepare


def paper_programme(problem):
    """(13) as printed, redundant non-penetration rows and all, in CVXPY with ECOS; only b is a parameter."""
    import cvxpy

    m = len(problem.mu)
    f, load = cvxpy.Variable(3 * m), cvxpy.Parameter(3 * m)
    root = np.linalg.cholesky(problem.S + 1e-14 * np.trace(problem.S) * np.eye(3 * m)).T
    contacts = cvxpy.reshape(f, (m, 3), order="C")
    programme = cvxpy.Problem(
        cvxpy.Minimize(0.5 * cvxpy.sum_squares(root @ f) + load @ f),
        [
            cvxpy.norm(contacts[:, 1:], axis=1) <= cvxpy.multiply(problem.mu, contacts[:, 0]),
            load[::3] + problem.S[::3] @ f >= 0,
        ],
    )

    def solve(b):
        load.value = b
        programme.solve(solver="ECOS")
        return f.value if f.value is not None else np.zeros(3 * m)

    solve(problem.b[0])
    return solve


def _cone_rows(problem):
    """Rows of ``-G f ∈ K`` contact by contact: (μ f_n, f_t)."""
    from scipy.sparse import diags

    m = len(problem.mu)
    return diags(-np.column_stack([problem.mu, np.ones(m), np.ones(m)]).ravel()).tocsc()


def clarabel_direct(problem):
    import clarabel
    from scipy.sparse import csc_matrix, triu

    P, G, m = csc_matrix(triu(problem.S)), _cone_rows(problem), len(problem.mu)
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    cones = [clarabel.SecondOrderConeT(3)] * m
    return lambda b: np.array(clarabel.DefaultSolver(P, b, G, np.zeros(3 * m), cones, settings).solve().x)


def ecos_direct(problem):
    """``min t + bᵀ f`` with ``‖(√2 Rᵀ f, 1 - t)‖ <= 1 + t``, ``R Rᵀ = S``."""
    import ecos
    from scipy.sparse import bmat, csc_matrix, vstack

    m = len(problem.mu)
    root = np.linalg.cholesky(problem.S + 1e-14 * np.trace(problem.S) * np.eye(3 * m)).T
    cone = bmat([[_cone_rows(problem), csc_matrix((3 * m, 1))]])
    energy = bmat([[None, csc_matrix([[-1.0]])], [csc_matrix(-np.sqrt(2.0) * root), None], [None, csc_matrix([[1.0]])]])
    G = vstack([cone, energy]).tocsc()
    h = np.concatenate([np.zeros(3 * m), [1.0], np.zeros(3 * m), [1.0]])
    dims = {"l": 0, "q": [3] * m + [3 * m + 2]}
    return lambda b: ecos.solve(np.append(b, 1.0), G, h, dims, verbose=False)["x"][:-1]


def scs_direct(problem):
    import scs
    from scipy.sparse import csc_matrix, triu

    m = len(problem.mu)
    data = dict(P=csc_matrix(triu(problem.S)), A=_cone_rows(problem), b=np.zeros(3 * m), c=problem.b[0])
    solver = scs.SCS(data, dict(q=[3] * m), verbose=False, eps_abs=1e-9, eps_rel=1e-9, max_iters=50_000)

    def solve(b):
        solver.update(c=b)
        return solver.solve(warm_start=True)["x"]

    return solve


def siconos(name):
    def prepare(problem):
        import siconos.numerics as numerics

        numerics.numerics_set_verbose(0)
        identifier = getattr(numerics, f"SICONOS_FRICTION_3D_{name}")
        limit = {"NSGS": 100_000, "ADMM": 20_000}.get(name, 1000)
        m = len(problem.mu)
        size = np.trace(problem.S) / (3 * m)
        W = np.asfortranarray(problem.S / size)

        def solve(b):
            contact = numerics.FrictionContactProblem(3, m, W, b.copy(), problem.mu.copy())
            options = numerics.SolverOptions(identifier)
            options.dparam[numerics.SICONOS_DPARAM_TOL] = 1e-10
            options.iparam[numerics.SICONOS_IPARAM_MAX_ITER] = limit
            force, displacement = np.zeros(3 * m), np.zeros(3 * m)
            numerics.fc3d_driver(contact, force, displacement, options)
            return force / size

        solve(problem.b[0])
        return solve

    return prepare


def native(law):
    def prepare(problem):
        solver = ContactSolver(problem.S, problem.mu, law)
        solver.solve(problem.b[:1])  # compile
        return lambda b: solver.solve(b).force

    return prepare


COMPETITORS = [
    Competitor("native, one by one", "coulomb", native("coulomb")),
    *(Competitor(f"Siconos {name}", "coulomb", siconos(name)) for name in ("NSGS", "NSN_AC", "PROX", "ADMM")),
    Competitor("native, one by one", "associated", native("associated")),
    Competitor(PAPER, "associated", paper_programme),
    Competitor("CVXPY + ECOS", "associated", cvxpy_backend("ecos")),
    Competitor("ECOS", "associated", ecos_direct),
    Competitor("Clarabel", "associated", clarabel_direct),
    Competitor("SCS", "associated", scs_direct),
]


def cases(quick):
    """Named problems with 102 contacts, the paper's number."""
    rng = np.random.default_rng(2024)
    n = 20 if quick else 100
    yield "slip-dominated", slip_dominated(102, n, rng)
    yield "stick-rich", manufactured(compliant(102, rng), np.full(102, 0.27), n, rng)


def stuck_cases():
    """Further measurements for the goals."""
    rng = np.random.default_rng(2025)
    yield STUCK, manufactured(compliant(102, rng), np.full(102, 0.27), 20, rng, stick=0.9, slide=0.0)
    yield LARGE, manufactured(_grown(1000, rng), np.full(1000, 0.27), 3, rng)


def _grown(m, rng):
    """A compliance whose contacts have the same stiffness and coupling for any number of contacts."""
    points = rng.random((m, 2))
    distance = np.linalg.norm(points[:, None] - points, axis=-1)
    modes = rng.standard_normal((3 * m, 20)) / np.sqrt(60 * m)
    return np.kron(np.exp(-3.0 * distance) / np.sqrt(m) + 0.5 * np.eye(m), np.eye(3)) + modes @ modes.T


def scene_cases(path):
    """Contact problems of the Monte Carlo of a scene under Coulomb's law in one step, one case for each stage with
    contact.

    The process runs with solvers that record their problems; the solution of one stage enters the loads of the next.
    """
    scene = mic.load_scene(path)
    whole = [stage.model_copy(update={"path": "one-step", "increments": None}) for stage in scene.stages]
    model = mic.reduce(scene.model_copy(update={"stages": whole}))
    settings = model.scene.monte_carlo
    recorded = []

    class Recording(ContactSolver):
        def solve(self, b, guess=None):
            recorded.append((f"{scene.name}, solve {len(recorded) + 1}", ContactProblem(self.S, b, self.mu)))
            return super().solve(b, guess)

    process.ContactSolver = Recording
    model.process("coulomb").evaluate(draw(scene, settings.seed, 0, settings.samples))
    process.ContactSolver = ContactSolver
    return recorded


def measure(name, problem, competitor, reference, console):
    """Time one competitor on one case; one row of the result."""
    try:
        solve = competitor.prepare(problem)
    except ImportError as missing:
        console.print(f"[yellow]{competitor.name} skipped: {missing}")
        return None
    times, forces = [], []
    for b in problem.b:
        start = time.process_time()
        forces.append(solve(b))
        times.append(time.process_time() - start)
        if sum(times) > SECONDS_PER_CASE:
            break
    forces = np.array(forces, dtype=float)
    residual = certify(problem.S, problem.b[: len(forces)], problem.mu, forces, competitor.law).residual
    return _row(name, problem, competitor.name, competitor.law, times, residual, reference)


def friction(problem):
    """The problem with every kind of friction: μ that falls with pressure around the mean one, and contacts half as
    compliant as the bodies."""
    m, own = len(problem.mu), problem.S.diagonal().reshape(-1, 3)
    pressure = np.abs(problem.b[:, ::3]).mean() / own[:, 0].mean()
    pieces = pressure_dependent.power(
        problem.mu.mean(), pressure, 0.3, 0.5 * problem.mu.mean(), 2.0 * problem.mu.mean()
    )
    return Friction(problem.mu, np.tile(pieces, (m, 1, 1)), np.full(m, 0.5 * own[:, 1:].mean()))


def measure_batch(name, problem, threads, reference, law="coulomb"):
    """The native solver on the whole batch at once, as the Monte Carlo calls it."""
    solver = ContactSolver(problem.S, friction(problem), law, threads=threads)
    solver.solve(problem.b[:1])
    clock = time.process_time if threads == 1 else time.perf_counter
    start = clock()
    solution = solver.solve(problem.b)
    times = [(clock() - start) / len(problem.b)]
    label = f"native, batch, {threads} thread{'s' * (threads > 1)}"
    return _row(name, problem, label, law, times, solution.residual, reference)


def _row(name, problem, solver, law, times, residual, reference):
    median = 1e3 * np.median(times)
    return dict(
        case=name,
        contacts=len(problem.mu),
        solver=solver,
        law=law,
        samples=len(residual),
        ms_median=median,
        ms_max=1e3 * np.max(times),
        ratio=median / (reference or median),
        residual_median=np.median(residual),
        residual_max=np.max(residual),
        failed=int(np.sum(residual > 1e-8)),
    )


def growth(quick, console):
    """Time per sample against the number of contacts at a fixed share of active contacts; fits the exponent."""
    rows = []
    for m in (10, 30, 102, 300) if quick else (10, 30, 102, 300, 1000, 2000):
        rng = np.random.default_rng(m)
        problem = manufactured(_grown(m, rng), np.full(m, 0.27), max(2, min(50, 3000 // m)), rng, stick=0.2, slide=0.3)
        rows.append(measure_batch("growth", problem, 1, None))
        console.print(f"growth: {m} contacts, {rows[-1]['ms_median']:.3g} ms per sample")
    large = [row for row in rows if row["contacts"] >= 100]
    slope = np.polyfit(np.log([r["contacts"] for r in large]), np.log([r["ms_median"] for r in large]), 1)[0]
    console.print(f"growth: time per sample ∝ m^{slope:.2f} from 102 contacts on (goal: no worse than m^2.3)")
    return rows, slope


def bars(rows, slope):
    """Goals: measured quantity, present and earlier value, and target."""
    ours = {row["case"]: row["ms_median"] for row in rows if row["solver"] == "native, batch, 1 thread"}
    ratio = {row["case"]: row["ratio"] for row in rows if row["solver"] == PAPER}
    table = Table("bar", "now", "bf8188e", "goal", title="Bars")
    for case, before, goal in (("slip-dominated", 2900, 600), ("stick-rich", 290, 250)):
        if case in ratio:
            table.add_row(f"{case}, times faster than {PAPER}", f"{ratio[case]:.0f}", str(before), f">= {goal}")
    table.add_row(f"{STUCK}, ms", f"{ours[STUCK]:.2f}", "1.05", "<= 2.5")
    table.add_row(f"{LARGE}, ms", f"{ours[LARGE]:.0f}", "156", "<= 200")
    table.add_row("exponent of growth", f"{slope:.2f}", "2.7", "<= 2.3")
    return table


def releases() -> str:
    """Versions that the other solvers report, and Debian's for its packages (Debian's Siconos 4.4.0 reports 4.5.0)."""
    told = []
    for name in ("siconos", "cvxpy", "ecos", "clarabel", "scs"):
        try:
            found = distribution(name)
        except PackageNotFoundError:
            told.append(f"{name} not installed")
            continue
        told.append(f"{name} {found.version}")
        if Path(str(found.locate_file(""))) == Path("/usr/lib/python3/dist-packages"):
            asked = ["dpkg-query", "-W", "-f", "${Version}", f"python3-{name}"]
            told[-1] += f" (Debian's {subprocess.run(asked, capture_output=True, text=True).stdout})"
    return ", ".join(told)


def show(rows, console):
    table = Table(title="Contact solvers, milliseconds per sample", caption=releases())
    for column in COLUMNS:
        table.add_column(column.replace("_", " "), justify="left" if column in ("case", "solver", "law") else "right")
    for row in rows:
        table.add_row(*(f"{row[c]:.3g}" if isinstance(row[c], float) else str(row[c]) for c in COLUMNS))
    console.print(table)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--scene", type=Path, help="folder of a scene whose contact problems replace the built-in cases"
    )
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--csv", type=Path, default=Path("results/contact_benchmark.csv"))
    options = parser.parse_args()
    console = Console(width=180)
    problems = scene_cases(options.scene) if options.scene else cases(options.quick)
    rows = []
    with threadpool_limits(1):
        for name, problem in problems:
            # Ratios are to the native solver on the batch, as the Monte Carlo calls it; no other solver takes batches.
            rows.append(measure_batch(name, problem, 1, None))
            reference = rows[-1]["ms_median"]
            rows += [measure_batch(name, problem, 1, reference, law.name) for law in LAWS.values() if law.reads]
            for competitor in COMPETITORS:
                row = measure(name, problem, competitor, reference, console)
                if row:
                    rows.append(row)
                    console.print(
                        f"{name}: {row['solver']} ({row['law']}) {row['ms_median']:.3g} ms, "
                        f"{row['ratio']:.3g} ×, residual {row['residual_max']:.1e}"
                    )
            if os.cpu_count() > 1:
                rows.append(measure_batch(name, problem, os.cpu_count(), reference))
        if not options.scene:
            rows += [measure_batch(name, problem, 1, None) for name, problem in stuck_cases()]
            grown, slope = growth(options.quick, console)
            rows += grown
    show(rows, console)
    if not options.scene:
        console.print(bars(rows, slope))
    options.csv.parent.mkdir(parents=True, exist_ok=True)
    with options.csv.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    console.print(f"written to {options.csv}")


if __name__ == "__main__":
    main()
