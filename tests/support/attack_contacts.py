"""Random contact problems of any scale, each answer judged by :mod:`support.contact_judge`.

A case is drawn from one number, so that a line of failure repeats it: ``check(draw(number))``.  An answer holds if it
was refused with a sentence, was reported as not solved, or is judged right.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mic.contact import ContactSolver, Friction
from mic.contact.laws import LAWS
from mic.contact.laws.pressure_dependent import power, rescaled, table
from mic.contact.path import Followed, Increments
from support.contact_judge import OWN, WHOLE, Problem, judge, judge_increments, judge_path_end

__all__ = ["Case", "Outcome", "attack", "draw", "outcome"]

#: Seconds after which a problem of up to 9 contacts, or a larger one, counts as hung.
HANGS = 30.0, 120.0
SMALL, LARGE = 9, (100, 500)
WORK = 200, 10  # of the solver in an attack, for small and large problems
FRICTIONS = [0.0, 1e-12, 1e-6, 0.1, 0.3, 0.3, 1.0, 5.0, 100.0, 1000.0]
SHAPES = ["full", "full", "sheet", "singular", "singular", "duplicates", "dependent", "blocks", "rigid"]


@dataclass(frozen=True)
class Case:
    """One problem as the program receives it.

    Attributes
    ----------
    number : int
        What it was drawn from.
    problem : Problem
    friction : float, (m,) array or Friction
    b : (3m,), (n, 3m) or (n, k + 1, 3m) array
        The last for a path.
    path : Followed, Increments or None
    guess : array like ``b`` or None
    about : str
        What is unusual about it.
    """

    number: int
    problem: Problem
    friction: object
    b: np.ndarray
    path: object
    guess: np.ndarray | None
    about: str


@dataclass(frozen=True)
class Outcome:
    """Outcome of a case.

    Attributes
    ----------
    failures : list of str
    samples, solved, named : int
        Samples, those reported as converged, and those among them with contacts named as unresolved.
    refused : str
        The sentence with which the problem was refused; empty if it was not.
    seconds : float
    about : str
        Law, size and peculiarities.
    """

    failures: list[str]
    samples: int
    solved: int
    named: int
    refused: str
    seconds: float
    about: str


def spread(rng, size, decades=4.0):
    """Factors of up to ``10^±decades``; all one in a third of the calls."""
    return 10.0 ** rng.uniform(-decades, decades, size) if rng.random() < 0.67 else np.ones(size)


def compliance(rng, m: int, shape: str) -> np.ndarray:
    """(3m, 3m) compliance of order one, of a certain shape."""
    if shape == "sheet":
        at = rng.random((m, 2))
        near = np.exp(-3.0 * np.linalg.norm(at[:, None] - at, axis=-1))
        return np.kron(near, [[1.0, 0.2, 0.1], [0.2, 1.0, 0.0], [0.1, 0.0, 1.0]]) + 0.02 * np.eye(3 * m)
    if shape == "blocks":
        part, S = rng.integers(0, max(2, m // 3), m), compliance(rng, m, "full")
        return S * np.kron(np.equal.outer(part, part), np.ones((3, 3)))
    if shape in ("duplicates", "dependent"):
        few = max(1, int(m * rng.uniform(0.3, 1.0)))
        pick = rng.integers(0, few, m)
        rows = (3 * pick[:, None] + np.arange(3)).ravel()
        S = compliance(rng, few, "full")[np.ix_(rows, rows)]
        if shape == "dependent":
            root = rng.standard_normal((3 * m, 3 * m)) / np.sqrt(3 * m)
            S = S + 10.0 ** rng.uniform(-14, -4) * root @ root.T
        return S
    rank = 3 * m + 4 if shape in ("full", "rigid") else max(1, int(3 * m * rng.random()))
    root = rng.standard_normal((3 * m, rank)) / np.sqrt(rank)
    if shape == "rigid":
        root[np.repeat(rng.random(m) < 0.4, 3)] = 0.0
    return root @ root.T


def friction_of(rng, m: int, law: str, mu, force: float, soft):
    """Friction of a law, for the program and for the judge."""
    if law == "micro-slip":
        c = soft * spread(rng, m) * (rng.random(m) < 0.8)
        return Friction(mu, None, c), dict(compliance=c)
    if law != "pressure-dependent":
        return (float(mu[0]), {}) if (mu == mu[0]).all() else (mu, {})
    area, own, pieces = force * spread(rng, m), [], []
    for k in range(m):
        if rng.random() < 0.5:
            p, level = np.cumsum(10.0 ** rng.uniform(-3, 1, rng.integers(1, 5))), [10.0 ** rng.uniform(-3, 1)]
            for before, after in zip(p, p[1:]):  # the bound must not fall
                level.append(level[-1] * rng.uniform(before, 2 * after) / (2 * after - before))
                level[-1] = max(level[-1], level[-2] * after / (2 * after - before) * (1 + 1e-12))
            own.append(("table", np.column_stack([p, level]), area[k]))
            pieces.append(table(own[-1][1]))
        else:
            low = 10.0 ** rng.uniform(-3, 0)
            data = 10.0 ** rng.uniform(-2, 1), 10.0 ** rng.uniform(-2, 2), rng.uniform(-1, 1), low, 10.0 * low
            own.append(("power", data, area[k]))
            pieces.append(power(*data))
    most = max(map(len, pieces))
    padded = np.full((m, most, 5), np.inf)
    padded[:, :, 1:] = 0.0
    for k, piece in enumerate(pieces):
        padded[k, : len(piece)] = piece
    return Friction(mu, rescaled(padded, 1.0 / area)), dict(friction=own)


def draw(number: int, large: bool = False) -> Case:
    """The case of a number."""
    rng = np.random.default_rng([number, large])
    m = int(rng.integers(*LARGE)) if large else int(rng.integers(1, SMALL + 1))
    law, shape = str(rng.choice(list(LAWS))), str(rng.choice(SHAPES))
    S = compliance(rng, m, shape)
    # Graded compliances: of contacts, and of tangents against normals.
    root = np.sqrt(spread(rng, m))
    units = np.column_stack([root, *2 * (root * np.sqrt(spread(rng, m if rng.random() < 0.5 else 1)),)]).ravel()
    S *= units[:, None] * units
    S = 0.5 * (S + S.T)
    about = [shape]
    if rng.random() < 0.08:
        values, vectors = np.linalg.eigh(S)
        values[0] = -values[-1] * 10.0 ** rng.uniform(-12, 0)
        S = (vectors * values) @ vectors.T
        S = 0.5 * (S + S.T)
        about.append("indefinite")
    if rng.random() < 0.08:
        S = S + 10.0 ** rng.uniform(-13, -1) * np.abs(S).max() * rng.standard_normal(S.shape)
        about.append("asymmetric")
    mu = rng.choice(FRICTIONS, m) if rng.random() < 0.5 else np.full(m, rng.choice(FRICTIONS))
    n, steps = (int(rng.integers(2, 6)), 1) if rng.random() < 0.3 else (1, 1)
    path: Followed | Increments | None = None
    if rng.random() < 0.25:
        steps, path = int(rng.integers(1, 4)), Increments(int(rng.choice([1, 1, 3])), recorded=True)
        if rng.random() < 0.4 and not large:  # hundreds of closed contacts take minutes
            path = Followed()
    own = np.abs(S.diagonal()) + np.abs(S.diagonal()).mean() * 1e-3
    force = spread(rng, (n, steps + 1, m)).repeat(3, axis=-1)
    b = own * force * rng.standard_normal((n, steps + 1, 3 * m))
    if rng.random() < 0.6:  # some force opens all contacts
        opening = np.abs(b) * np.tile([1.0, 0.0, 0.0], m) * (rng.random((n, steps + 1, 3 * m)) < 0.8)
        b = opening - (force * rng.standard_normal(b.shape)) @ S
        about.append("feasible")
    b *= np.where(rng.random(b.shape) < 0.1 * (rng.random() < 0.4), 0.0, 1.0)
    b[..., ::3] *= np.where(rng.random((n, steps + 1, m)) < 0.3 * (rng.random() < 0.3), 0.0, 1.0)
    if rng.random() < 0.3:
        decades = 12 if rng.random() < 0.8 else 250
        b, S = b * 10.0 ** rng.uniform(-decades, decades), S * 10.0 ** rng.uniform(-decades, decades) / 1.0
        about.append(f"size 1e{decades}")
    largest = max(np.abs(S).max(), np.finfo(float).tiny)
    with np.errstate(over="ignore", under="ignore"):
        typical = float(np.clip(np.abs(b).max() / largest, 1e-250, 1e250))
        friction, known = friction_of(rng, m, law, mu, typical, np.abs(S.diagonal()).mean())
    problem = Problem(S, law, np.asarray(mu, dtype=float), **known)
    guess = None
    if path is None:
        b = b[:, -1]
        if rng.random() < 0.1:
            guess = typical * rng.standard_normal(b.shape)
        if n == 1 and rng.random() < 0.5:
            b, guess = b[0], None if guess is None else guess[0]
    return Case(number, problem, friction, b, path, guess, f"{law}, {m} contacts, {', '.join(about)}")


def outcome(case: Case, **settings) -> Outcome:
    """Solve and judge a case."""
    problem, start, wrong = case.problem, time.perf_counter(), []
    n = 1 if case.b.ndim == 1 else len(case.b)
    found, refused = None, ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # S is symmetrised
        try:
            solver = ContactSolver(problem.S, case.friction, problem.law, **settings)
            if case.path is None:
                found = solver.solve(case.b, case.guess)
            else:
                found = solver.follow(case.b, path=case.path)
        except ValueError as error:
            refused = str(error)
            if not any(word in refused for word in ("S must", "NaN or infinite")):
                wrong.append(f"refused by {error!r}")
        except Exception as error:
            wrong.append(f"raised {error!r}")
    seconds = time.perf_counter() - start
    if seconds > HANGS[len(problem.mu) > SMALL]:
        wrong.append(f"took {seconds:.0f} s")
    solved = named = 0
    if found is not None:
        solved, named, more = _judged(case, found)
        wrong += more
    about = f"draw({case.number}, {len(problem.mu) > SMALL}), {case.about}"
    return Outcome([f"{about}: {line}" for line in wrong], n, solved, named, refused, seconds, case.about)


def _judged(case, found):
    """Converged samples, those with contacts named as unresolved, and what is wrong with them."""
    good = np.atleast_1d(np.asarray(found.converged, dtype=bool))
    force, shown = np.atleast_2d(found.force), np.atleast_2d(found.displacement)
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(force).all(axis=1) & np.isfinite(shown).all(axis=1)
    wrong = [f"sample {i} converged with numbers that are not finite" for i in np.flatnonzero(good & ~finite)]
    if case.path is None:
        finite &= np.isfinite(np.atleast_1d(found.residual))
    pick = np.flatnonzero(good & finite)
    if not len(pick):
        return int(good.sum()), 0, wrong
    unresolved = _unresolved(found, len(good), len(case.problem.mu))[pick]
    if case.path is None:
        verdict = judge(case.problem, np.atleast_2d(case.b)[pick], force[pick], shown[pick])
        own, whole = verdict.own, verdict.whole
        for i in np.flatnonzero(verdict.moved > 64 * len(case.problem.mu)):
            wrong.append(f"sample {pick[i]} reports displacements off by {verdict.moved[i]:.0f} ε")
    else:
        own, whole = np.zeros(unresolved.shape), np.zeros(len(pick))
        for i, sample in enumerate(pick):
            own[i], whole[i], off = _judged_path(case, found, sample)
            if off > 1e-9:
                wrong.append(f"sample {sample} ends {off:.1e} beside where its forces bring it")
    for i, sample in enumerate(pick):
        bad = np.flatnonzero((own[i] > OWN) & ~unresolved[i])
        if whole[i] > WHOLE:
            wrong.append(f"sample {sample} converged, wrong by {whole[i]:.1e} of the largest, {_method(found, sample)}")
        elif len(bad):
            worst = bad[own[i, bad].argmax()]
            wrong.append(
                f"sample {sample} converged, contact {worst} off by {own[i, worst]:.1e}, {_method(found, sample)}"
            )
    return int(good.sum()), int(unresolved.any(axis=1).sum()), wrong


def _method(found, sample):
    return f"{np.atleast_1d(np.asarray(found.rung, dtype=object))[sample]}"


def _unresolved(found, n, m):
    named = getattr(found, "unresolved", None)
    return np.zeros((n, m), dtype=bool) if named is None else np.atleast_2d(named)


def _judged_path(case, found, sample):
    """Own breaches (m,), breach of all, and error of the end of one sample's path."""
    problem, m, b = case.problem, len(case.problem.mu), case.b[sample]
    if problem.law == "frictionless":  # the end alone matters
        verdict = judge(problem, b[-1:], found.force[[sample]], found.displacement[[sample]])
        return verdict.own[0], verdict.whole[0], 0.0
    end = found.displacement[sample], found.anchor[sample]
    record = None if found.record is None else found.record[sample]
    if record is not None and record.order == 1 and len(b) == 2:
        verdict, off = judge_increments(problem, b[0], b[1], b[0].reshape(m, 3)[:, 1:], record.ends, record.force, end)
        return verdict.own[-1], verdict.whole.max(), off  # contacts are certified on their own scale at the end
    if problem.law == "associated":  # an increment: its slip is not in the end alone
        return np.zeros(m), 0.0, 0.0
    verdict, off = judge_path_end(problem, b, found.force[sample], *end)
    return verdict.own[0], verdict.whole[0], off


def attack(rng: np.random.Generator, folder: Path, problems: int = 200) -> list[str]:
    """Errors of the results for many small problems, and now and then a large one, with less work than by default."""
    failures = []
    for _ in range(problems):
        failures += outcome(draw(int(rng.integers(2**48))), work=WORK[0]).failures
    if rng.random() < 0.3:
        failures += outcome(draw(int(rng.integers(2**48)), large=True), work=WORK[1]).failures
    return failures
