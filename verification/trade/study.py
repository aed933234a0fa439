"""Accuracy and cost of the named settings, of `auto`, and of everything that buys accuracy, against finer versions."""

from __future__ import annotations

import time

import numpy as np
import pandas as pd
from mpi4py import MPI
from scipy.stats import chi2

from fem_reference.full.model import FullModel
from mic.scene import SETTINGS, Scene
from mic.scene.settings import TARGET
from mic.setting_choice import choose
from mic.statistics.draw import draw
from mic.statistics.paired_differences import six_sigma_change
from mic.studies.emulator_training import train_emulator
from verification.budget import values
from verification.comparison import reduced_and_assembly, relative
from verification.sampling_cost import FEW, SamplingCost, leading, measure_sampling
from verification.scenes import shipped, with_path
from verification.study import Acceptance, Finding, Study
from verification.target import as_set
from verification.trade.picture import picture
from verification.trade.versions import (
    ALL_FINER,
    QUICK,
    QUICK_TURNED,
    TRUTHS,
    TURNED,
    Knobs,
    Truth,
    left_open,
    named,
    opened,
    versions_of,
)
from verification.validation import COVERAGE, Uncertainty

TARGETS = (0.01, 0.02, 0.05, 0.10)  # of 6σ
COUNTS = (50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000)
SEED = 17
STILL = 4  # increments a step, if the path is not adaptive
KINDS = {"measurement": "key characteristics", "slip": "slips"}
HALF, EACH = f"sampling error of {FEW} followed samples with surrogates", "per sample with surrogates, ms"
RESOLUTION = 2e-3  # mm: that of coordinate measuring machines; a smaller error decides nothing
TOGETHER = 200  # samples evaluated at once
NOISE = 0.1  # scatter of processor time
ESTIMATED = [("setting", "standard")]  # also by surrogates and an emulator
FULL = {"penalties": (1e2, 1e4), "full": "medium"}
FULL_QUICK = {"penalties": (1e3,), "full": "coarse"}


def measure(scene: Scene, deviations: np.ndarray, cache, estimators: bool) -> dict:
    """Slips of the zones and key characteristics of a version on given samples, and its cost, CPU s.

    Parameters
    ----------
    estimators : bool
        Whether to measure the accuracy of few samples with surrogates and of the emulator, too.
    """
    start, law = time.process_time(), scene.report.laws[0]
    model, assembly = reduced_and_assembly(scene, cache)
    prepared = time.process_time()
    process = model.process(law)
    process.attempt(deviations[:2])  # compile before the time is measured
    compiled = time.process_time()
    # a few hundred at a time, since the contacts of all samples may fill the memory
    parts = [process.attempt(some) for some in np.array_split(deviations, -(-len(deviations) // TOGETHER))]
    evaluated = time.process_time()
    few = measure_sampling(model, law, SEED) if estimators else SamplingCost()
    return {
        "values": pd.concat([values(model, part) for part in parts], ignore_index=True),
        "emulator": emulated(model, law, deviations) if estimators else None,
        "pairs": len(assembly.contacts),
        "nodes": sum(len(part.surface.points) for part in assembly.parts),
        "preparation, s": prepared - start,
        "per sample, ms": 1e3 * (evaluated - compiled) / len(deviations),
        HALF: few.half,
        EACH: 1e3 * few.each,
        "failed": sum(int(part.failed.sum()) for part in parts),
    }


def emulated(model, law, deviations) -> tuple[pd.DataFrame, float] | None:
    """Key characteristics of an emulator, mm, and the CPU seconds of its training; None if it cannot be trained."""
    start = time.process_time()
    emulator = train_emulator(model, law)
    if emulator is None:
        return None
    names = [f"measurement:{item.name}" for item in model.scene.measurements]
    return pd.DataFrame(emulator(deviations)[0], columns=names), time.process_time() - start


def over(own: pd.DataFrame, exact: pd.DataFrame, limit: float) -> pd.Series:
    """Change of each leading 6σ over the larger of a share of it and the resolution of measuring machines."""
    kept = own.notna().all(axis=1) & exact.loc[own.index].notna().all(axis=1)
    six_sigma = 6 * exact.loc[own.index][kept].std(ddof=1)
    change = (6 * own[kept].std(ddof=1) - six_sigma).abs()
    return (change / np.maximum(limit * six_sigma, RESOLUTION))[leading(six_sigma)]


def errors(own: pd.DataFrame, exact: pd.DataFrame) -> dict:
    """Largest relative error of a 6σ by kind, with half its 95 % interval; largest difference of single samples.

    Only quantities whose 6σ is among the largest of their kind count. The difference of single samples is a root mean
    square about the mean, relative to σ. Since |σ(y) − σ(x)| ≤ σ(y − x), it bounds the error of 6σ; some twenty samples
    suffice. `own` may hold only the first samples.
    """
    kept = own.notna().all(axis=1) & exact.loc[own.index].notna().all(axis=1)
    own, exact = own[kept], exact.loc[own.index][kept][own.columns]
    six_sigma = 6 * exact.std(ddof=1)
    names, found = leading(six_sigma), {}
    apart = (own - exact).std(ddof=1) / exact.std(ddof=1)
    for kind, words in KINDS.items():
        leads = names[names.str.startswith(f"{kind}:")]
        worst = {"error": 0.0, "half": 0.0, "of": ""}
        for name in leads:
            change = six_sigma_change(exact[name], own[name])
            error = abs(change.value) / six_sigma[name]
            if not error <= worst["error"]:
                worst = {"error": error, "half": (change.high - change.value) / six_sigma[name], "of": name}
        found |= {
            f"error of 6σ, {words}": worst["error"],
            f"±, {words}": worst["half"],
            f"worst of {words}": worst["of"],
            f"single samples, {words}": apart[leads].max() if len(leads) else 0.0,
        }
    worst = max(KINDS.values(), key=lambda words: found[f"error of 6σ, {words}"])
    return found | {"error of 6σ": found[f"error of 6σ, {worst}"], "±": found[f"±, {worst}"]}


def row(scene, knob, value, found, exact) -> dict:
    """One line of the table."""
    kept = ("nodes", "pairs", "preparation, s", "per sample, ms", HALF, EACH, "failed")
    line = {"scene": scene, "knob": knob, "value": value} | errors(found["values"], exact["values"])
    return line | {key: found[key] for key in kept}


def sampling_error(samples) -> float:
    """Relative half width of the 95 % interval of σ from normal samples."""
    low, high = np.sqrt((samples - 1) / chi2.ppf((0.975, 0.025), samples - 1))
    return float(high - low) / 2


def cost(line, samples) -> float:
    """CPU time of a run without caches, s."""
    return line["preparation, s"] + 1e-3 * line["per sample, ms"] * samples


def cheapest(lines, target, surrogates=True):
    """The cheapest version and number of samples whose error plus sampling error meets the target; None without one.

    Parameters
    ----------
    lines : DataFrame
    target : float
    surrogates : bool
        Whether to consider few followed samples with surrogates, too.

    Returns
    -------
    tuple or None
        CPU seconds, line of the version, followed samples, sampling error, estimator.
    """
    fitting = [
        (cost(line, count), line, count, sampling_error(count), "samples alone")
        for _, line in lines.iterrows()
        for count in COUNTS
        if line["error of 6σ"] + sampling_error(count) <= target
    ]
    for _, line in lines.iterrows() if surrogates else ():
        few = SamplingCost(line[HALF], 1e-3 * line[EACH])
        count, rest = few.samples(target - line["error of 6σ"]), target - line["error of 6σ"]
        if count == count:
            seconds = line["preparation, s"] + count * few.each
            fitting.append((seconds, line, int(count), min(few.half, rest), "followed samples with surrogates"))
    return min(fitting, key=lambda item: item[0]) if fitting else None


def alone(line, samples) -> tuple[float, float]:
    """CPU seconds of a version, and its error with the sampling error of samples alone."""
    return cost(line, samples), line["error of 6σ"] + sampling_error(samples)


def with_surrogates(line) -> tuple[float, float]:
    """CPU seconds of a version, and its error with the sampling error of few followed samples and surrogates."""
    return line["preparation, s"] + 1e-3 * FEW * line[EACH], line["error of 6σ"] + line[HALF]


def turn_knobs(truths, context) -> tuple[pd.DataFrame, dict]:
    """All versions of all scenes against their truths: the table, and the measured versions by scene, knob, value."""
    counts = {name: max(truth.counts().values()) for name, truth in truths.items()}
    deviations = {name: draw(opened(name), SEED, 0, count) for name, count in counts.items()}
    turned = QUICK_TURNED if context.quick else TURNED
    scenes = {
        (name, *key): scene for name, truth in truths.items() for key, scene in versions_of(name, truth, turned).items()
    }

    def of(key) -> dict:
        name, knob, value = key
        count = truths[name].samples // (2 if knob in TURNED else 1)
        if knob == "truth":
            count = truths[name].counts()[named(truths[name])[value]]
        estimators = key[1:] in ESTIMATED and not context.quick
        return measure(scenes[key], deviations[name][:count], context.cache, estimators)

    found = dict(zip(scenes, context.team.map(of, scenes)))
    for name, truth in truths.items():
        found[name, "truth", ALL_FINER]["values"] = averaged(found, name, truth)
    rows = []
    for (name, knob, value), one in found.items():
        if knob == "truth":
            continue
        exact = found[name, "truth", ALL_FINER]
        rows.append(row(name, knob, value, one, exact))
        if one["emulator"] is not None:
            frame, seconds = one["emulator"]
            spent = {"preparation, s": one["preparation, s"] + seconds, "per sample, ms": 0.0}
            rows.append(row(name, "estimator", f"emulator, {value}", one | spent | {"values": frame}, exact))
    return with_costs(pd.DataFrame(rows)), found


def with_costs(lines: pd.DataFrame) -> pd.DataFrame:
    """The versions with the CPU seconds of a whole answer of the samples of the setting standard."""
    samples = SETTINGS["standard"]["samples"]
    return lines.assign(**{"whole answer, CPU s": [cost(line, samples) for _, line in lines.iterrows()]})


def mean_of(found: dict, name: str, versions: tuple[Knobs, ...]) -> pd.DataFrame:
    """Mean of what some versions of a truth give for each sample."""
    return sum(found[name, "truth", knobs.words]["values"] for knobs in versions) / len(versions)


def averaged(found: dict, name: str, truth: Truth) -> pd.DataFrame:
    """The reference result of each sample, averaged over places of the candidates.

    One followed version stands for the truth; what other places change is measured in one increment a step.
    """
    own, cheap = found[name, "truth", ALL_FINER]["values"], truth.own["element size"].fine
    return own + (mean_of(found, name, truth.own["pairs"].fine) - mean_of(found, name, cheap)).loc[own.index]


def own_error(found: dict, truths, limit: float) -> pd.DataFrame:
    """Error of each truth by scene, source and quantity, over the larger of a share of its 6σ and the resolution."""
    rows = []
    for name, truth in truths.items():
        for title, source in truth.own.items():
            fine, coarse = (
                mean_of(found, name, versions)[: source.samples] for versions in (source.fine, source.coarse)
            )
            for quantity, value in over(coarse, fine, limit).items():
                left = source.factor * value
                rows.append(
                    {"scene": name, "source": title, "quantity": quantity, "samples": source.samples, "left": left}
                )
    return pd.DataFrame(rows)


def dominated(lines: pd.DataFrame) -> list[str]:
    """Settings that another version beats in cost, beyond its scatter, and in error, beyond both intervals.

    Parameters
    ----------
    lines : DataFrame
        Columns ``knob``, ``value``, ``seconds``, ``error``, ``half`` of the worst of the scenes.
    """
    names = []
    for _, own in lines[lines["knob"] == "setting"].iterrows():
        cheaper = lines["seconds"] < (1 - NOISE) * own["seconds"]
        better = lines["error"] + lines["half"] < own["error"] - own["half"]
        if (cheaper & better).any():
            names.append(f"{own['value']} by {lines[cheaper & better].iloc[0]['value']}")
    return names


def drawn(lines: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Data of the picture, by panel: each scene, and the worst error and total cost of all."""
    columns = {"error of 6σ": "error", "±": "half", "whole answer, CPU s": "seconds"}
    shown = lines.rename(columns=columns)[["scene", "knob", "value", *columns.values()]]
    by_panel = {name.replace("_", " "): own.reset_index(drop=True) for name, own in shown.groupby("scene", sort=False)}
    if len(by_panel) == 1:
        return by_panel
    groups = shown.groupby(["knob", "value"], sort=False)
    worst = shown.loc[groups["error"].idxmax(), ["knob", "value", "error", "half"]]
    total = groups["seconds"].agg(["sum", "size"]).reset_index()
    both = worst.merge(total[total["size"] == len(by_panel)], on=["knob", "value"])
    return by_panel | {"largest error of all scenes, total cost": both.rename(columns={"sum": "seconds"})}


def chosen_automatically(found: dict, truths, context) -> pd.DataFrame:
    """Choice of the setting auto on each scene, with the error that it measured and that against the truth."""

    def of(name) -> dict:
        start = time.process_time()
        choice = choose(left_open(opened(name)), context.cache)
        spent = time.process_time() - start
        deviations = draw(opened(name), SEED, 0, truths[name].samples)
        one = measure(choice.scene, deviations, context.cache, estimators=False)
        exact = found[name, "truth", ALL_FINER]["values"]
        accepted = [trial for trial in choice.trials if trial.accepted]
        return row(name, "auto", "auto", one, {"values": exact}) | {
            "chosen": "; ".join(choice.chosen),
            "error that it measured": float(np.hypot.reduce([trial.error for trial in accepted])),
            "error over the target": over(one["values"], exact, TARGET).max(),
            "choice, CPU s": spent,
        }

    return with_costs(pd.DataFrame(context.team.map(of, truths)))


def still_tolerances(context, samples) -> dict[float, tuple[np.ndarray, float]]:
    """σ of the key characteristics of the wheelhouse by solver tolerance, and CPU time per sample, ms.

    Fixed increments, because an adaptive path would change its steps and so add its own error.
    """
    scene = with_path(shipped("wheelhouse", "coarse"), "increments", STILL)
    model = context.model(scene)
    deviations = draw(scene, SEED, 0, samples)

    def at(tol):
        process = model.process("coulomb", tol=tol)
        process.evaluate(deviations[:2])
        start = time.process_time()
        found = process.evaluate(deviations)
        return found.measurements[~found.failed].std(axis=0), 1e3 * (time.process_time() - start) / samples

    tolerances = (1e-3, 1e-6, 1e-12)
    return dict(zip(tolerances, context.team.map(at, tolerances)))


def full_solves(plan, context) -> pd.DataFrame:
    """One sample of the lap joint by full finite elements: error of the penalty, and cost of a full solve."""
    # one increment a step, so that both methods solve the same problems
    scene = Knobs(size=plan["full"], increments=1).turn(as_set(opened("lap_joint"), "standard"))
    model, assembly = reduced_and_assembly(scene, context.cache)
    deviations = draw(model.scene, SEED, 0, 1)
    exact = model.evaluate(deviations, "coulomb").measurements[0]

    def solve(penalty):
        start = time.process_time()
        options = {"augmented": True} if penalty is None else {"augmented": False, "penalty": penalty}
        found = FullModel(assembly, comm=MPI.COMM_SELF, **options).evaluate(deviations[0])
        return {
            "penalty ε/k": "augmented" if penalty is None else f"{penalty:.0e}",
            "elements": plan["full"],
            "error of measurements": relative(found.measurements, exact),
            "per sample, s": time.process_time() - start,
        }

    return pd.DataFrame(context.team.map(solve, (*plan["penalties"], None)))


def advice(lines, full) -> pd.DataFrame:
    """Setting, number of samples and estimator for a given accuracy of 6σ.

    Full solves are compared with the reduced model on as many samples, without surrogates.
    """
    rows = []
    for target in TARGETS:
        found = cheapest(lines, target)
        if found is None:
            rows.append(
                {
                    "6σ to": f"{target:.0%}",
                    "run": (
                        f"not reached: the smallest measured error is {lines['error of 6σ'].min():.1%} "
                        "before any sampling error"
                    ),
                    "samples": float("nan"),
                    "cost, s": float("nan"),
                    "full solves would take, s": float("nan"),
                    "times cheaper": float("nan"),
                }
            )
            continue
        seconds, line, count, sampled, estimator = found
        alone = cheapest(lines, target, surrogates=False)
        dear = alone[2] * full.iloc[-1]["per sample, s"] if alone else float("nan")
        rows.append(
            {
                "6σ to": f"{target:.0%}",
                "run": f"{line['knob']} {line['value']}",
                "samples": count,
                "estimator": estimator,
                "error of 6σ": line["error of 6σ"],
                "sampling error": sampled,
                "cost, s": seconds,
                "full solves would take, s": dear,
                "times cheaper": dear / alone[0] if alone else float("nan"),
            }
        )
    return pd.DataFrame(rows)


def in_words(table) -> str:
    """The table of advice as sentences."""
    sentences = []
    for _, line in table.iterrows():
        text = f"6σ to {line['6σ to']}: "
        if not line["samples"] > 0:
            sentences.append(f"{text}{line['run']}.")
            continue
        text += f"run {line['run']} with {line['samples']:.0f} {line['estimator']}, {line['cost, s']:.0f} s"
        if line["times cheaper"] > 0:
            text += (
                f"; full solves of samples alone would take {line['full solves would take, s'] / 3600:.1f} h, "
                f"{line['times cheaper']:.0f} times as much as the reduced model"
            )
        sentences.append(f"{text}.")
    return " ".join(sentences)


def run(context):
    truths, plan = (QUICK, FULL_QUICK) if context.quick else (TRUTHS, FULL)
    lines, found = turn_knobs(truths, context)
    full = full_solves(plan, context)
    automatic = chosen_automatically(found, truths, context)
    left = own_error(found, truths, LIMITS["reference"])
    of_truth = left.groupby(["scene", "quantity"])["left"].agg(lambda of_sources: float(np.hypot.reduce(of_sources)))
    settings = lines[lines["knob"] == "setting"]
    drawn_lines = pd.concat([lines, automatic, full_lines(full)], ignore_index=True)
    shown = drawn(drawn_lines)
    beaten = dominated(list(shown.values())[-1])
    lap = lines[(lines["scene"] == "lap_joint") & lines["knob"].isin(("setting", "mesh", "path"))]
    told = advice(lap, full)
    findings = [
        Finding(
            "front",
            len(beaten),
            f"{'; '.join(beaten) or 'None'}. The cost is that of {SETTINGS['standard']['samples']} samples, of an "
            "emulator that of its training. The sampling error of 6σ is not drawn: see the table of reference.",
            picture(shown),
            table_of(drawn_lines),
        )
    ]
    for name, limit in LIMITS.items():
        findings.append(setting_finding(name, limit, settings, found, truths, float(of_truth.max())))
    return [
        *findings,
        Finding(
            "auto",
            float(automatic["error over the target"].max()),
            " ".join(f"{line['scene']}: {line['chosen']}." for _, line in automatic.iterrows()),
            table=automatic[
                ["scene", "error that it measured", "error of 6σ", "±", "choice, CPU s", "whole answer, CPU s"]
            ],
        ),
        Finding(
            "truth",
            float(of_truth.max()),
            "By scene, source and quantity, from versions that are one step coarser, over the larger of 1 % of 6σ and "
            "2 µm. The sources of a quantity add in quadrature.",
            table=left,
        ),
        Finding("saving", told["times cheaper"].max(), "The lap joint. " + in_words(told), table=told),
        *([] if context.quick else [tolerance_finding(context)]),
        Finding(
            "penalty",
            float(full.iloc[-1]["error of measurements"]),
            "The penalty is a parameter of the full solve only.",
            table=full,
        ),
    ]


def setting_finding(name, limit, settings, found, truths, of_truth) -> Finding:
    """Error of a setting on all scenes, over its limit."""
    measured = {
        scene: over(found[scene, "setting", name]["values"], found[scene, "truth", ALL_FINER]["values"], limit).max()
        for scene in truths
    }
    own = settings[settings["value"] == name]
    note = "; ".join(
        f"{line['scene'].replace('_', ' ')}, {truths[line['scene']].samples} samples: key characteristics "
        f"{line['error of 6σ, key characteristics']:.2%} ± {line['±, key characteristics']:.2%}, slips "
        f"{line['error of 6σ, slips']:.2%} ± {line['±, slips']:.2%}"
        for _, line in own.iterrows()
    )
    table = None
    if name == "reference":
        table = pd.DataFrame([{"samples": n, "sampling error of 6σ": sampling_error(n)} for n in COUNTS])
    # the errors are relative to the limit of each, that of the truth to the limit of the setting reference
    unsure = Uncertainty(
        num=float((own["±"] / limit).max()) / COVERAGE, reference=of_truth * LIMITS["reference"] / limit / COVERAGE
    )
    return Finding(name, max(measured.values()), f"{note}.", table=table, uncertainty=unsure)


def full_lines(full: pd.DataFrame) -> pd.DataFrame:
    """Full solves of the lap joint as lines of the table; the error is that of one sample's measurements."""
    samples = SETTINGS["standard"]["samples"]
    return pd.DataFrame(
        {
            "scene": "lap_joint",
            "knob": "full solves",
            "value": [f"penalty {text}" if text != "augmented" else text for text in full["penalty ε/k"]],
            "error of 6σ": full["error of measurements"],
            "±": 0.0,
            "whole answer, CPU s": samples * full["per sample, s"],
        }
    )


def table_of(lines: pd.DataFrame) -> pd.DataFrame:
    """The versions, with the columns that fit on a page."""
    short = {
        "scene": "scene",
        "knob": "knob",
        "value": "value",
        "error of 6σ, key characteristics": "error, KC",
        "±, key characteristics": "± KC",
        "error of 6σ, slips": "error, slips",
        "±, slips": "± slips",
        "pairs": "pairs",
        "per sample, ms": "ms each",
        "whole answer, CPU s": "answer, CPU s",
    }
    return lines[list(short)].rename(columns=short)


def tolerance_finding(context) -> Finding:
    """Effect of the solver's tolerance on the wheelhouse."""
    tolerances = still_tolerances(context, 60)
    costs = ", ".join(f"{tol:.0e}: {ms:.2f} ms per sample" for tol, (_, ms) in tolerances.items())
    return Finding(
        "tolerance",
        float(np.abs(tolerances[1e-6][0] / tolerances[1e-12][0] - 1).max()),
        f"The wheelhouse, {STILL} increments per step. A looser tolerance saves little time; no setting changes it: "
        f"{costs}.",
    )


LIMITS = {"draft": 0.05, "standard": 0.02, "reference": 0.01}
#: Why each limit is enough.
REASONS = {
    "draft": "The sampling error of 500 samples is 6.2 % of 6σ.",
    "standard": "A third of the uncertainty of its own 500 samples, 6.2 %.",
    "reference": "A third of the uncertainty of its own 2000 samples, 3.1 %.",
}

STUDY = Study(
    order=110,
    title="Accuracy against cost",
    claim=(
        "Three named settings lie on the Pareto front of cost and error, `auto` chooses a setting for a scene, and the "
        "study states the cost of 6σ to 1, 2, 5 or 10 %."
    ),
    reference=(
        "Lap joint and bracket, finer in every parameter than any setting (elements, candidate distance, path), on "
        "the same samples; the error of this reference comes from versions that are one step coarser in each parameter."
    ),
    acceptance=(
        Acceptance(
            "front",
            "Settings that another version beats in cost by a tenth and in error beyond both 95 % intervals, on the "
            "worst of the scenes.",
            0,
            reason="Such a setting is no good buy; a tenth is the scatter of processor time.",
        ),
        *(
            Acceptance(
                name,
                f"Setting {name}: largest error of a 6σ of key characteristics and zone slips, without sampling error, "
                f"over the larger of {limit:.0%} and 2 µm.",
                1.0,
                reason=(
                    f"{REASONS[name]} 2 µm is the resolution of coordinate measuring machines; a smaller error decides "
                    "nothing."
                ),
            )
            for name, limit in LIMITS.items()
        ),
        Acceptance(
            "auto",
            "Setting auto: the same error, over the larger of its target and 2 µm.",
            1.0,
            reason="The choice promises its target.",
        ),
        Acceptance(
            "truth",
            "Error of the reference version, over the limit of the setting reference.",
            0.2,
            reason="A reference errs by at most a fifth of the limit.",
        ),
        Acceptance(
            "saving",
            "Cost of full solves over that of the reduced model: the largest ratio.",
            50,
            bound="at least",
            reason="With fifty times less than a full solve, 500 samples take minutes instead of hours.",
        ),
        Acceptance(
            "tolerance",
            "Effect of contact tolerances between 1e-6 and 1e-12 on 6σ, relative.",
            1e-4,
            reason="A hundredth of the error of the best setting.",
            full_only=True,
        ),
        Acceptance(
            "penalty",
            (
                "Augmented full solve against the reduced model on the same mesh: relative difference of the "
                "measurements."
            ),
            1e-7,
            reason="Ten times the rounding of the two routes, 1e-8.",
        ),
    ),
    seconds=(1800, 45),
    memory=5.6,
    run=run,
)
