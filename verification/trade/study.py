"""Accuracy and cost of the named settings and of single parameters, against versions finer in every parameter."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from mpi4py import MPI

from fem_reference.full.model import FullModel
from mic import examples
from mic.contact.path import Followed
from mic.scene import SETTINGS, Scene, load_scene
from mic.scene.process import FollowedPath
from mic.scene.settings import FOLLOWING
from mic.statistics import estimates
from mic.statistics.draw import draw
from mic.statistics.paired_differences import six_sigma_change
from verification.budget import values
from verification.comparison import reduced_and_assembly, relative
from verification.plots import panels
from verification.sampling_cost import FEW, SamplingCost, leading, measure_sampling
from verification.scenes import shipped, with_path
from verification.study import Acceptance, Finding, Study
from verification.target import as_set

TARGETS = (0.01, 0.02, 0.05, 0.10)  # of 6σ
COUNTS = (50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000)
SEED = 17
STILL = 4  # increments a step, if the path is not adaptive
KINDS = {"measurement": "key characteristics", "slip": "slips"}
FINE = Followed.tolerance / 4
HALF, EACH = f"sampling error of {FEW} followed samples with surrogates", "per sample with surrogates, ms"
COARSER = 16  # ratio of path tolerances for the error of the truth: a sixteenth reduces the error to about a sixth


@dataclass(frozen=True)
class Knobs:
    """Changed parameters of a scene; None means unchanged.

    Attributes
    ----------
    size : str or float or None
        Element size, a name or mm.
    factor : float or None
        Factor on the distance between candidates.
    pairs : int or None
        Number of stated pairs in each zone, instead of candidates.
    increments : int or None
        For each step of the process, instead of an adaptive path.
    tolerance : float or None
        Tolerance of the adaptive path.
    """

    size: str | float | None = None
    factor: float | None = None
    pairs: int | None = None
    increments: int | None = None
    tolerance: float | None = None

    def turn(self, scene: Scene) -> Scene:
        """The scene with these parameters changed."""
        change = {}
        if self.size is not None:
            change["parts"] = [part.model_copy(update={"size": self.size}) for part in scene.parts]
        if self.factor is not None or self.pairs is not None:
            factor = 1.0 if self.factor is None else self.factor
            zone = {"spacing": None, "spacing_factor": factor, "pairs": self.pairs, "points": None}
            change["zones"] = [one.model_copy(update=zone) for one in scene.zones]
        if self.increments is not None:
            steps = {"path": None, "increments": self.increments}
            change["stages"] = [one.model_copy(update=steps) if one.kind in FOLLOWING else one for one in scene.stages]
        if self.tolerance is not None:
            change["path"] = FollowedPath(tolerance=self.tolerance)
        return scene.model_copy(update=change)


@dataclass(frozen=True)
class Truth:
    """A version finer in every parameter than any setting, and the versions that show its own error.

    Attributes
    ----------
    knobs : Knobs
    coarser : dict
        By parameter: a version that is coarser in this parameter alone, and the factor that converts its difference
        from the truth to the error of the truth.
    samples : int
        Half of them for parameters that are changed one at a time, which have no limit.
    """

    knobs: Knobs
    coarser: dict[str, tuple[Knobs, float]]
    samples: int


def truth(size: float, factor: float, samples: int) -> Truth:
    """Factors for mesh and candidates. Meshes are of second order, candidates between first and second."""
    knobs = Knobs(size=size, factor=factor, tolerance=FINE)
    coarser = {
        "element size": (replace(knobs, size=2 * size), 1 / 3),
        "pairs": (replace(knobs, factor=2**0.5 * factor), 1.7),  # 1 / (2^(p/2) - 1), p from 1 to 2: 2.4 to 1
        "path": (replace(knobs, tolerance=COARSER * FINE), 1 / 5),
    }
    return Truth(knobs, coarser, samples)


TRUTHS = {"lap_joint": truth(0.625, 0.5, 100), "bracket": truth(1.0, 0.5, 120)}
QUICK = {"lap_joint": truth(0.625, 0.5, 24)}
#: Values of single parameters, changed one at a time from the setting standard.
TURNED = {
    "element size": (Knobs(size="coarse"), Knobs(size="medium")),
    "pairs": (Knobs(pairs=34), Knobs(pairs=102), Knobs(factor=1.0), Knobs(factor=1.4)),
    "path": (
        Knobs(increments=1),
        Knobs(increments=4),
        Knobs(tolerance=40 * Followed.tolerance),
        Knobs(tolerance=10 * Followed.tolerance),
        Knobs(tolerance=Followed.tolerance),
    ),
}
FULL = {"penalties": (1e2, 1e4), "full": "medium", "samples": 60}
FULL_QUICK = {"penalties": (1e3,), "full": "coarse", "samples": 20}


def opened(name: str) -> Scene:
    """A shipped scene under Coulomb's law."""
    scene = load_scene(examples.folder(name))
    return scene.model_copy(update={"report": scene.report.model_copy(update={"laws": ["coulomb"], "fields": False})})


def versions_of(name: str, truth: Truth) -> dict[tuple[str, str], Scene]:
    """All versions of a scene by parameter and value: the truth, versions coarser than it, settings, single changes."""
    scene = opened(name)
    standard = as_set(scene, "standard")
    found = {("truth", "all finer"): truth.knobs.turn(standard)}
    found |= {("truth", f"but {knob}"): knobs.turn(standard) for knob, (knobs, _) in truth.coarser.items()}
    found |= {("setting", setting): as_set(scene, setting) for setting in SETTINGS}
    for knob, turned in TURNED.items():
        for knobs in turned:
            (text,) = [f"{key} {value:g}" if key != "size" else value for key, value in given(knobs).items()]
            found[knob, text] = knobs.turn(standard)
    return found


def given(knobs: Knobs) -> dict:
    """The changed parameters."""
    return {key: value for key, value in vars(knobs).items() if value is not None}


def measure(scene: Scene, deviations: np.ndarray, cache, surrogates: bool) -> dict:
    """Slips of the zones and key characteristics of a version on given samples, and its cost, CPU s.

    Parameters
    ----------
    surrogates : bool
        Whether to measure the accuracy of few samples with surrogates, too.
    """
    start = time.process_time()
    model, assembly = reduced_and_assembly(scene, cache)
    prepared = time.process_time()
    process = model.process("coulomb")
    process.attempt(deviations[:2])  # compile before the time is measured
    compiled = time.process_time()
    evaluation = process.attempt(deviations)
    evaluated = time.process_time()
    few = measure_sampling(model, "coulomb", SEED) if surrogates else SamplingCost()
    return {
        "values": values(model, evaluation),
        "pairs": len(assembly.contacts),
        "nodes": sum(len(part.surface.points) for part in assembly.parts),
        "preparation, s": prepared - start,
        "per sample, ms": 1e3 * (evaluated - compiled) / len(deviations),
        HALF: few.half,
        EACH: 1e3 * few.each,
        "failed": int(evaluation.failed.sum()),
    }


def errors(own: pd.DataFrame, exact: pd.DataFrame) -> dict:
    """Largest relative error of a 6σ by kind, with half its 95 % interval; largest difference of single samples.

    Only quantities whose 6σ is among the largest of their kind count. The difference of single samples is a root mean
    square about the mean, relative to σ. Since |σ(y) − σ(x)| ≤ σ(y − x), it bounds the error of 6σ; some twenty samples
    suffice. `own` may hold only the first samples.
    """
    kept = own.notna().all(axis=1) & exact.loc[own.index].notna().all(axis=1)
    own, exact = own[kept], exact.loc[own.index][kept]
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
            f"single samples, {words}": apart[leads].max(),
        }
    found["error of 6σ"] = max(found[f"error of 6σ, {words}"] for words in KINDS.values())
    return found


def row(scene, knob, value, found, exact) -> dict:
    """One line of the table."""
    kept = ("nodes", "pairs", "preparation, s", "per sample, ms", HALF, EACH, "failed")
    line = {"scene": scene, "knob": knob, "value": value} | errors(found["values"], exact["values"])
    return line | {key: found[key] for key in kept}


def sampling_error(samples) -> float:
    """Relative half width of the 95 % interval of σ from normal samples."""
    values = np.ones(samples)
    values[::2] = -1
    interval = estimates.sigma(values)
    return (interval.high - interval.low) / (2 * interval.value)


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


def front(lines, samples) -> list:
    """Index of the Pareto-optimal versions in cost and error, in order of cost."""
    kept, best = [], np.inf
    for index in sorted(lines.index, key=lambda i: cost(lines.loc[i], samples)):
        if lines.loc[index, "error of 6σ"] < best:
            best = lines.loc[index, "error of 6σ"]
            kept.append(index)
    return kept


def turn_knobs(truths, context) -> pd.DataFrame:
    """All versions of all scenes against their truths."""
    deviations = {name: draw(opened(name), SEED, 0, truth.samples) for name, truth in truths.items()}
    scenes = {(name, *key): scene for name, truth in truths.items() for key, scene in versions_of(name, truth).items()}

    def of(key) -> dict:
        name, knob, _ = key
        count = truths[name].samples // (2 if knob in TURNED else 1)
        return measure(scenes[key], deviations[name][:count], context.cache, surrogates=knob == "setting")

    found = dict(zip(scenes, context.team.map(of, scenes)))
    return pd.DataFrame(
        [row(*key, one, found[key[0], "truth", "all finer"]) for key, one in found.items() if key[2] != "all finer"]
    )


def own_error(lines: pd.DataFrame, truths) -> pd.DataFrame:
    """Relative error of 6σ of the truths by scene and parameter, from versions that are one step coarser."""
    rows = []
    for _, line in lines[lines["knob"] == "truth"].iterrows():
        knob = line["value"].removeprefix("but ")
        factor = truths[line["scene"]].coarser[knob][1]
        shown = {f"left of {words}": factor * line[f"error of 6σ, {words}"] for words in KINDS.values()}
        unsure = {f"±, {words}": factor * line[f"±, {words}"] for words in KINDS.values()}
        rows.append({"scene": line["scene"], "knob": knob} | shown | unsure)
    return pd.DataFrame(rows)


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


def picture(lines, samples):
    """Figure of error against cost of all versions, a panel for each scene."""
    scenes = list(dict.fromkeys(lines["scene"]))
    figure, axes = panels(len(scenes), 5.2, 4.8)
    for axis, scene in zip(axes, scenes):
        shown = lines[(lines["scene"] == scene) & (lines["knob"] != "truth")]
        for knob, own in shown.groupby("knob", sort=False):
            x = [cost(line, samples) for _, line in own.iterrows()]
            big = knob == "setting"
            axis.loglog(x, own["error of 6σ"], "*" if big else "o", ms=14 if big else 6, label=knob, zorder=2 + big)
            for place, (_, line) in zip(x, own.iterrows()):
                at = (place, line["error of 6σ"])
                axis.annotate(line["value"], at, textcoords="offset points", xytext=(6, 4), fontsize=7.5)
        kept = front(shown, samples)
        x = [cost(shown.loc[i], samples) for i in kept]
        axis.loglog(x, shown.loc[kept, "error of 6σ"], "k-", lw=1, zorder=1, label="Pareto front")
        settings = shown[shown["knob"] == "setting"]
        for mark, words, of in (
            ("^", f"settings, with the sampling error of {samples} samples alone", lambda line: alone(line, samples)),
            ("v", f"settings, with that of {FEW} followed samples and surrogates", with_surrogates),
        ):
            places = np.array([of(line) for _, line in settings.iterrows()]).reshape(-1, 2)
            axis.loglog(*places.T, mark, ms=7, mfc="white", color="0.2", label=words, zorder=3)
        for name, limit in LIMITS.items():
            axis.axhline(limit, color="0.6", ls=":", lw=1)
            axis.annotate(
                name, (0.01, limit), xycoords=("axes fraction", "data"), va="bottom", fontsize=7.5, color="0.4"
            )
        axis.margins(x=0.25)
        axis.set(
            title=scene.replace("_", " "), xlabel=f"CPU time without caches, with {samples} samples or as stated, s"
        )
    axes[0].set_ylabel("error of 6σ, largest over key characteristics and slips")
    axes[-1].legend(loc="center left", bbox_to_anchor=(1.05, 0.5))
    return figure


def run(context):
    truths, plan = (QUICK, FULL_QUICK) if context.quick else (TRUTHS, FULL)
    lines = turn_knobs(truths, context)
    full = full_solves(plan, context)
    tolerances = still_tolerances(context, plan["samples"])
    samples = SETTINGS["standard"]["samples"]
    left = own_error(lines, truths)
    most = left.groupby("scene")[[f"left of {words}" for words in KINDS.values()]].sum().to_numpy().max()
    settings = lines[lines["knob"] == "setting"]
    judged = settings.groupby("value")["error of 6σ"].max()
    shown = settings.drop(columns=["knob"]).assign(
        samples=[SETTINGS[name]["samples"] for name in settings["value"]],
        **{"CPU s": [cost(line, SETTINGS[line["value"]]["samples"]) for _, line in settings.iterrows()]},
    )
    lap = lines[(lines["scene"] == "lap_joint") & lines["knob"].isin(("setting", "element size", "path"))]
    told = advice(lap, full)
    counted = pd.DataFrame(
        [{"samples": n, "sampling error of 6σ": sampling_error(n)} for n in COUNTS],
    )
    spread = float(np.abs(tolerances[1e-6][0] / tolerances[1e-12][0] - 1).max())
    return [
        Finding(
            "draft",
            judged["draft"],
            "On "
            + ", ".join(f"{name.replace('_', ' ')} ({truth.samples} samples)" for name, truth in truths.items())
            + ", the same samples for all versions of a scene, so that sampling errors cancel.",
            picture(lines, samples),
            lines[lines["knob"] != "truth"],
        ),
        Finding("standard", judged["standard"], "The settings, with their cost without caches.", table=shown),
        Finding(
            "reference",
            judged["reference"],
            "These errors do not include the sampling error of 6σ (95 % half-width).",
            table=counted,
        ),
        Finding(
            "truth",
            most / LIMITS["reference"],
            "By scene and parameter, from versions that are one step coarser; the limit applies to their sum.",
            table=left,
        ),
        Finding("saving", told["times cheaper"].max(), "The lap joint. " + in_words(told), table=told),
        Finding(
            "tolerance",
            spread,
            f"The wheelhouse, {STILL} increments per step. A looser tolerance saves little time; the settings do not "
            "change it: "
            + ", ".join(f"{tol:.0e}: {ms:.2f} ms per sample" for tol, (_, ms) in tolerances.items())
            + ".",
        ),
        Finding(
            "penalty",
            float(full.iloc[-1]["error of measurements"]),
            "The penalty is a parameter of the full solve only.",
            table=full,
        ),
    ]


LIMITS = {"draft": 0.05, "standard": 0.02, "reference": 0.01}

STUDY = Study(
    order=110,
    title="The trade",
    claim=(
        "Accuracy can be bought parameter by parameter. Three named settings buy it well, and the study states the "
        "cost of 6σ to 1, 2, 5 or 10 %."
    ),
    reference=(
        "Lap joint and bracket, finer in every parameter than any setting (elements, candidate distance, path), on "
        "the same samples; the error of this reference comes from versions that are one step coarser in each parameter."
    ),
    acceptance=(
        Acceptance(
            "draft",
            "Setting draft: largest error of a 6σ of key characteristics and zone slips, without sampling error.",
            LIMITS["draft"],
            reason="The sampling error of 500 samples is 6.2 % of 6σ.",
        ),
        Acceptance(
            "standard",
            "Setting standard: the same.",
            LIMITS["standard"],
            reason="A third of the uncertainty of its own 500 samples, 6.2 %.",
        ),
        Acceptance(
            "reference",
            "Setting reference: the same.",
            LIMITS["reference"],
            reason="A third of the uncertainty of its own 2000 samples, 3.1 %.",
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
    seconds=(900, 60),
    memory=4.5,
    run=run,
)
