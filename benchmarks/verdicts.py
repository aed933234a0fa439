"""Random contact problems of every kind: whether each gets a status, and whether an independent check agrees.

    python benchmarks/verdicts.py                          # 3000 problems
    python benchmarks/verdicts.py --problems 100000 --seed 7

Problems have one to six contacts and an S of any rank from a third up: regular, zero, with a negative eigenvalue of a
millionth, with contacts that cannot move, with compliances over 24 decades, with duplicate contacts, with normal rows
only, and in any unit. Loads have any size; half of them are such that some force balances them. Coefficients of
friction range from 0 to 1000, one for all contacts or one each. *refused* is an error that says why S is not a
compliance; *wrong* is a force with status converged that violates a condition of its law by more than a millionth;
*uncaught* is any other error.

The check uses extended precision and no error measure of the program. The compliance of a contact is ``c_k = ‖S_kk‖``,
or the mean of the others if that vanishes. Lengths are divided by ``√c_k`` and forces multiplied by it, so that both
are square roots of energies; they are compared with the larger of the energy of the forces and that of each overlap.
"""

from __future__ import annotations

import argparse
import collections
import time

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import mic.contact.ladder
from mic.contact import ContactSolver, Status
from mic.contact.laws import LAWS

KINDS = (
    "any rank",
    "zero",
    "negative eigenvalue",
    "a contact without compliance",
    "24 decades",
    "contacts twice",
    "normal rows alone",
    "any unit",
)
COEFFICIENTS = (0.0, 1e-12, 1e-3, 0.27, 1.0, 5.0, 1e3)
SIZES = (0, 0, 0, 0, -9, 9, -200, 200, -300, 300)  # decades of a load
LOADS = 3  # of a problem
WRONG = 1e-6
EPS = np.finfo(float).eps
OUTCOMES = (*(status.value for status in Status), "refused", "wrong", "uncaught")


def problem(rng: np.random.Generator):
    """Kind, S (3m, 3m), b (LOADS, 3m) and μ."""
    m, kind = int(rng.integers(1, 7)), int(rng.integers(len(KINDS)))
    root = rng.standard_normal((3 * m, max(1, int(rng.uniform(1 / 3, 1) * 3 * m))))
    S = root @ root.T
    if KINDS[kind] == "zero":
        S = np.zeros_like(S)
    elif KINDS[kind] == "negative eigenvalue":
        S = S - 1e-6 * np.linalg.norm(S, 2) * np.eye(3 * m)
    elif KINDS[kind] == "a contact without compliance":
        S[:3], S[:, :3] = 0.0, 0.0
    elif KINDS[kind] == "24 decades":
        decades = 10.0 ** rng.uniform(-6, 6, 3 * m)
        S = S * decades[:, None] * decades
    elif KINDS[kind] == "contacts twice":
        rows = (3 * rng.integers(0, m, m)[:, None] + np.arange(3)).ravel()
        S = S[np.ix_(rows, rows)]
    elif KINDS[kind] == "normal rows alone":
        S = np.kron(np.diag(rng.random(m)), np.diag([1.0, 0.0, 0.0]))
    elif KINDS[kind] == "any unit":
        S = S * 10.0 ** rng.uniform(-200, 200)
    b = rng.standard_normal((LOADS, 3 * m))
    b[rng.random(b.shape) < 0.2] = 0.0
    balanced = rng.random() < 0.5
    if balanced:
        b = np.abs(b) * np.tile([1.0, 0.0, 0.0], m) - rng.standard_normal(b.shape) @ (S / (np.abs(S).max() or 1.0))
    b = b * 10.0 ** rng.choice(SIZES, size=(LOADS, 1))
    mu = rng.choice(COEFFICIENTS, m) if rng.random() < 0.5 else float(rng.choice(COEFFICIENTS))
    return kind, S, b, mu


def breach(S, b, mu, force, law: str) -> float:
    """Largest breach of a condition of the law by a force (3m,), relative to the size of the problem."""
    m = len(b) // 3
    compliance = 2.0 ** np.floor(np.log2(np.abs(S).max())) if S.any() else 1.0
    length = 2.0 ** np.floor(np.log2(np.abs(b).max())) if b.any() else 1.0
    S, b = np.asarray(S / compliance, dtype=np.longdouble), np.asarray(b / length, dtype=np.longdouble)
    f = np.asarray(force, dtype=np.longdouble) / np.longdouble(length) * np.longdouble(compliance)
    u = S @ f + b
    if not np.isfinite(u).all():
        return np.inf
    own = S.reshape(m, 3, m, 3)[np.arange(m), :, np.arange(m), :].astype(float)
    c = np.linalg.norm(own if LAWS[law].frictional else own[:, :1, :1], 2, axis=(1, 2))
    none = c <= EPS * c.max()
    c = np.sqrt(np.ones(m) if none.all() else np.where(none, c[~none].mean(), c))
    rounding = 16 * EPS * (np.abs(S) @ np.abs(f) + np.abs(b)).reshape(m, 3).sum(axis=1)
    energy, overlap = max(float(f @ (S @ f)), 0.0), np.maximum(0.0, -b[::3].astype(float)) / c
    size = max(np.sqrt(energy), float(np.sqrt((overlap**2).sum())), 1e-12 * float(np.abs(b).max()) / c.max())
    mu = np.broadcast_to(np.asarray(mu, dtype=np.longdouble), (m,)) if LAWS[law].frictional else np.zeros(m)
    f_n, u_n = f[::3], u[::3]
    f_t, u_t = np.hypot(f[1::3], f[2::3]), np.hypot(u[1::3], u[2::3])
    gap, weight = u_n - (mu * u_t if law == "associated" else 0.0), np.maximum(1.0, mu)
    beyond = np.maximum(0.0, np.abs(gap) - rounding) / c / weight
    breaches = [
        np.maximum(0.0, -u_n - rounding) / c,
        np.maximum(0.0, -f_n) * c,
        np.maximum(0.0, f_t - mu * f_n) * c / weight,
        np.minimum(np.abs(f_n) * c, beyond),  # a force with an open gap
    ]
    if LAWS[law].frictional:  # sliding contacts have the full friction force, opposed to the slip
        slips = ((u_t - rounding) / c > WRONG * size) & (f_n * c > WRONG * size) & (mu > 0)
        along = (f[1::3] * u[1::3] + f[2::3] * u[2::3]) / np.where(u_t > 0, u_t, 1.0)
        breaches.append(np.where(slips, np.abs(along + mu * f_n) * c / weight, 0.0))
    worst = float(max(each.max() for each in breaches))
    return worst / size if size > 0 else np.inf if worst > 0 else 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--budget", type=float, default=2.0, help="of a problem, as mic.contact.ladder.BUDGET has it")
    arguments = parser.parse_args()
    mic.contact.ladder.BUDGET = arguments.budget
    console, rng, start = Console(width=120), np.random.default_rng(arguments.seed), time.process_time()
    laws = [name for name, law in LAWS.items() if not law.reads]
    found: collections.Counter = collections.Counter()
    for number in track(range(-(-arguments.problems // LOADS)), "problems", console=console):
        kind, S, b, mu = problem(rng)
        law = laws[number % len(laws)]
        try:
            solution = ContactSolver(S, mu, law).solve(b)
        except ValueError:
            found[kind, "refused"] += LOADS
            continue
        except Exception as error:  # count errors that must not happen, and print where they occurred
            found[kind, "uncaught"] += LOADS
            console.print(f"uncaught: problem {number}, {KINDS[kind]}, {law}: {error!r}", soft_wrap=True)
            continue
        for i, status in enumerate(solution.status):
            found[kind, status.value] += 1
            if status is Status.CONVERGED:
                by = breach(S, b[i], mu, solution.force[i], law)
                if not by <= WRONG:
                    found[kind, "wrong"] += 1
                    console.print(f"wrong: problem {number}, load {i}, {KINDS[kind]}, {law}: {by:.2g}", soft_wrap=True)
    table = Table()
    for name in ("kind", *OUTCOMES):
        table.add_column(name, no_wrap=True)
    for kind, name in enumerate(KINDS):
        table.add_row(name, *(str(found[kind, outcome]) for outcome in OUTCOMES))
    table.add_section()
    total = {outcome: sum(found[kind, outcome] for kind in range(len(KINDS))) for outcome in OUTCOMES}
    table.add_row("all", *map(str, total.values()))
    console.print(table)
    console.print(f"{time.process_time() - start:.0f} s of processor time")


if __name__ == "__main__":
    main()
