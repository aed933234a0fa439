"""Errors of mean, σ, 6σ and Cpk from a finite number of samples, and coverage of the reported intervals."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mic.statistics import capability, estimates
from mic.statistics.draw import draw
from verification.plots import panels
from verification.scenes import shipped, with_path
from verification.study import Acceptance, Finding, Study

LIMITS = (-1.0, 3.0)  # tolerance limits of the normal population, whose mean is 0 and σ is 1: Cp and Cpk differ
COUNTS = (20, 50, 100, 200, 500, 1000, 2000)
ESTIMATES = ("mean", "sigma", "six_sigma", "cpk")


def estimate(name, x, limits):
    """One of mic's estimates, by name."""
    if name == "cpk":
        return capability.centred_capability(x, *limits)
    return getattr(estimates, name)(x)


def truth(mean, sigma, limits):
    """Statistics of the population."""
    return {
        "mean": mean,
        "sigma": sigma,
        "six_sigma": 6 * sigma,
        "cpk": min(limits[1] - mean, mean - limits[0]) / (3 * sigma),
    }


def repeat(draw_samples, known, limits, count, repetitions, block=500):
    """Relative error of each estimate in each repetition, and coverage of the intervals."""
    errors, covered = {name: [] for name in ESTIMATES}, dict.fromkeys(ESTIMATES, 0)
    for first in range(0, repetitions, block):
        x = draw_samples(count, min(block, repetitions - first))
        for name in ESTIMATES:
            found = estimate(name, x, limits)
            errors[name].append(found.value - known[name])
            covered[name] += int(((found.low <= known[name]) & (known[name] <= found.high)).sum())
    return {name: np.concatenate(e) for name, e in errors.items()}, {
        name: c / repetitions for name, c in covered.items()
    }


def normal_population(context, repetitions):
    """Repetition on normal samples, for every count."""
    known = truth(0.0, 1.0, LIMITS)

    def cell(count):
        rng = np.random.Generator(np.random.Philox(key=np.array([7, count], dtype=np.uint64)))
        return repeat(lambda n, r: rng.standard_normal((n, r)), known, LIMITS, count, repetitions)

    return known, context.team.map(cell, COUNTS)


def scene_population(context, samples, repetitions, count):
    """Repetition on the coarse wheelhouse: its own samples are the population, so that the truth is known exactly.

    Each step has a single increment: a followed path costs five times as much, and its values are nearer to normal,
    which is an easier test of the intervals.
    """
    scene = with_path(shipped("wheelhouse", "coarse"), "increments", 1)
    model = context.model(scene)
    blocks = context.team.map(lambda first: model.evaluate(draw(scene, 11, first, 250)), range(0, samples, 250))
    series = {}
    for j, item in enumerate(scene.measurements):
        series[item.name] = (np.concatenate([e.measurements[:, j] for e in blocks]), (item.lower, item.upper))
    for z, zone in enumerate(scene.zones):
        own = model.contacts.zone == z
        slip = np.concatenate(
            [np.sqrt((e.resolutions["clamp"].displacement[:, own, 1:] ** 2).sum(-1).mean(1)) for e in blocks]
        )
        series[f"slip {zone.name}"] = (slip, (0.0, slip.mean() + 4 * slip.std()))
    ok = ~np.concatenate([e.failed for e in blocks])

    def cell(item):
        number, (name, (x, limits)) = item
        x = x[ok]
        rng = np.random.Generator(np.random.Philox(key=np.array([8, number], dtype=np.uint64)))
        known = truth(x.mean(), x.std(), limits)
        _, covered = repeat(lambda n, r: x[rng.integers(len(x), size=(n, r))], known, limits, count, repetitions)
        z = (x - x.mean()) / x.std()
        return {"quantity": name, "skewness": (z**3).mean(), "excess kurtosis": (z**4).mean() - 3} | covered

    return pd.DataFrame(context.team.map(cell, enumerate(series.items())))


def run(context):
    repetitions = 2000 if context.quick else 20000
    known, cells = normal_population(context, repetitions)
    errors = pd.DataFrame(
        [
            {"samples": count}
            | {
                name: np.sqrt((e[name] ** 2).mean()) / abs(known[name])
                if known[name]
                else np.sqrt((e[name] ** 2).mean())
                for name in ESTIMATES
            }
            for count, (e, _) in zip(COUNTS, cells)
        ]
    )
    coverage = pd.DataFrame([{"samples": count} | c for count, (_, c) in zip(COUNTS, cells)])
    rates = {name: np.polyfit(np.log(errors["samples"]), np.log(errors[name]), 1)[0] for name in ESTIMATES}

    rate_figure, (axis,) = panels(1)
    for name in ESTIMATES:
        axis.loglog(errors["samples"], errors[name], "o-", label=f"{name}, rate {rates[name]:.3f}")
    axis.loglog(errors["samples"], errors["samples"] ** -0.5, "k:", label="$n^{-1/2}$")
    axis.set(xlabel="samples", ylabel="RMS error (mean: in σ; others: relative)")
    axis.legend()
    worst_rate = max(abs(rate + 0.5) for rate in rates.values())

    coverage_figure, (axis,) = panels(1)
    for name in ESTIMATES:
        axis.semilogx(coverage["samples"], coverage[name], "o-", label=name)
    noise = 3 * np.sqrt(estimates.LEVEL * (1 - estimates.LEVEL) / repetitions)
    axis.axhspan(
        estimates.LEVEL - noise,
        estimates.LEVEL + noise,
        color="0.9",
        label=f"3 standard errors of {repetitions} repetitions",
    )
    axis.axhline(estimates.LEVEL, color="k", lw=0.8)
    axis.set(xlabel="samples", ylabel="share of intervals that hold the truth")
    axis.legend()
    off = max(abs(coverage[name] - estimates.LEVEL).max() for name in ESTIMATES)

    at_500 = np.abs(cells[COUNTS.index(500)][0]["sigma"])
    half = float(np.quantile(at_500, estimates.LEVEL))
    expected = 1.96 / np.sqrt(2 * 499)

    samples, draws = (1500, 2000) if context.quick else (8000, 10000)
    table = scene_population(context, samples, draws, 500)
    lowest = float(table[list(ESTIMATES)].min().min())
    return [
        Finding(
            "rate",
            worst_rate,
            "Rates by least squares over all counts: " + ", ".join(f"{n} {r:.4f}" for n, r in rates.items()) + ".",
            rate_figure,
            errors,
        ),
        Finding(
            "coverage",
            off,
            f"{repetitions} repetitions for each number of samples, normal population.",
            coverage_figure,
            coverage,
        ),
        Finding(
            "sigma-500",
            abs(half / expected - 1),
            f"With 500 samples σ is known to ±{half:.2%} (95 % of the repetitions); the theory of normal "
            f"samples says ±{expected:.2%}. A solver error below that changes no decision about σ.",
        ),
        Finding(
            "scene-coverage",
            lowest,
            f"{samples} samples of the coarse wheelhouse under Coulomb's law, each step in one increment, are "
            f"the population; {draws} times, 500 of them are drawn. Zone slips are skewed and have heavy tails (excess "
            "kurtosis above 0); the intervals take that from the samples.",
            table=table,
        ),
    ]


STUDY = Study(
    order=70,
    title="Statistics",
    claim="Mean, σ, 6σ and Cpk have intervals with the stated coverage, and their error falls at the theoretical rate.",
    reference=(
        "Populations with known values: the normal distribution, and a large set of wheelhouse samples taken as the "
        "population."
    ),
    acceptance=(
        Acceptance(
            "rate",
            "Rate of the error of each estimate in the number of samples: largest deviation from -1/2.",
            0.02,
            quick=0.05,
            reason=(
                "Theory: 1/2, with a bias of 1/(4 n) that changes the slope by 0.006; three times that (quick: a "
                "tenth of the repetitions)."
            ),
        ),
        Acceptance(
            "coverage",
            "Coverage of 95 % intervals on normal samples: largest deviation, over all counts and estimates.",
            0.012,
            quick=0.02,
            reason=(
                "Five standard errors for 20 000 repetitions are 0.008; approximate intervals of 20 samples are "
                "granted half of that again (quick: 2000 repetitions)."
            ),
        ),
        Acceptance(
            "sigma-500",
            "Uncertainty of σ from 500 samples against normal theory: relative difference.",
            0.02,
            quick=0.06,
            reason="Four standard errors for 20 000 repetitions, 0.5 % each (quick: 2000, 1.6 % each).",
        ),
        Acceptance(
            "scene-coverage",
            "Coverage of 95 % intervals on the wheelhouse's slips and key characteristics: lowest share.",
            0.92,
            bound="at least",
            reason="An interval that misses more than once in twelve is no longer a 95 % interval.",
        ),
    ),
    seconds=(110, 10),
    run=run,
)
