"""Verification of a user's scene: Monte Carlo, full finite-element solves of some samples, and errors of mean and 6σ.

The folder contains ``production/`` (the Monte Carlo run, as `mic run` writes it), ``reduced/`` (the same with one
increment per step, if the scene follows a path), ``full/`` and ``budget/`` (one file per full solve and per source of
error, from which an interrupted run resumes), ``symmetry/`` (one per way in which samples are solved again),
``summary.json``, ``samples.csv``, ``estimates.csv``, ``budget.csv``, ``uncertainty.csv`` and ``report.html``.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from fem_reference.full.model import ContactFailure, FullModel
from mic.contact.laws import LAWS
from mic.errors import SceneError
from mic.results.outcome import read_outcome
from mic.results.run_folder import versions
from mic.results.summary import json_ready
from mic.runs import sample_into
from mic.scene import Scene
from mic.scene.process import MOVING
from mic.statistics import estimates
from mic.statistics.draw import draw
from mic.system.files import replacing, write_text
from verification.budget import EVERY, SAMPLES, SAMPLING, Case, Item, bounded, estimate, largest_difference, values
from verification.budget_page import (
    budget_figure,
    budget_rows,
    budget_sentences,
    by_quantity,
    printed,
    quantity_rows,
)
from verification.comparison import reduced_and_assembly, relative, zone_slip
from verification.plots import panels, svg
from verification.report import environment, table_cells
from verification.stiffness import DeviatedStiffness
from verification.study import Team
from verification.symmetry.uncertainty import Solved, lines, numerical_uncertainty, sentences
from verification.two_level import two_level

__all__ = ["Choice", "choose", "verify_scene"]

SHOWN, LINEAR = 5.0, 0.1  # range of the error-bar figure, and its linear part
TICKS = (-5, -1, -0.1, 0, 0.1, 1, 5)
ROUNDED = ("value", "uncertainty", "by symmetry")  # columns of the printed uncertainties
NOTHING = "scene {!r} has nothing to verify: neither measurements nor contact zones with friction; add [[measurements]]"
LEADING = 0.1  # the headline leaves out quantities whose 6σ is below this fraction of the largest of their kind


@dataclass(frozen=True)
class Choice:
    """A sample selected for a full solve.

    Attributes
    ----------
    sample : int
    kind : {"typical", "extreme", "random"}
    """

    sample: int
    kind: str


def choose(results: np.ndarray, numbers: np.ndarray, count: int, seed: int) -> list[Choice]:
    """Select samples by their reduced results: one typical, then alternately extreme and random ones.

    Parameters
    ----------
    results : (n, k) array
        Finite results of the samples.
    numbers : (n,) int array
        The samples' numbers.
    count : int
        Number of samples to select; at most n.
    seed : int

    Returns
    -------
    list of Choice
        The first is the sample nearest to the median. Each extreme one is the farthest from all selected before it,
        with quantities scaled by their standard deviations. The random ones do not depend on `results`.
    """
    spread = results.std(axis=0)
    z = (results - np.median(results, axis=0))[:, spread > 0] / spread[spread > 0]
    picked, kinds = [int(np.argmin((z**2).sum(axis=1)))], ["typical"]
    order = list(
        np.random.Generator(np.random.Philox(key=np.array([seed, 2**40], dtype=np.uint64))).permutation(len(results))
    )
    while len(picked) < min(count, len(results)):
        if len(picked) % 2:
            distance = np.min([((z - z[i]) ** 2).sum(axis=1) for i in picked], axis=0)
            distance[picked] = -1
            picked.append(int(np.argmax(distance)))
            kinds.append("extreme")
        else:
            picked.append(int(next(i for i in order if i not in picked)))
            kinds.append("random")
    return [Choice(int(numbers[i]), kind) for i, kind in zip(picked, kinds)]


def _record(scene: Scene, chosen, full, seconds, ranks: int) -> dict:
    """Entries of ``summary.json`` on samples, full solves and times."""
    samples, laws = scene.monte_carlo.samples, scene.report.laws
    times = [result["seconds"] for result in full if "failure" not in result]
    return {
        "scene": scene.name,
        "samples": samples,
        "seed": scene.monte_carlo.seed,
        "law": laws[0],
        "chosen": [
            {"sample": c.sample, "kind": c.kind, "seconds": r.get("seconds"), "failure": r.get("failure")}
            for c, r in zip(chosen, full)
        ],
        "seconds": {
            "reduced_model": seconds[0],
            "reduced_sample": seconds[1] * ranks / (samples * len(laws)),
            "full_sample": float(np.mean(times)) if times else None,
        },
        "versions": versions(),
        "ranks": ranks,
    }


def _write_results(folder: Path, summary: dict, per_sample: pd.DataFrame, table: pd.DataFrame, budget, items) -> dict:
    """Write the tables, ``summary.json`` and the report; returns the summary."""
    per_sample.to_csv(folder / "samples.csv", index=False)
    table.to_csv(folder / "estimates.csv", index=False)
    if budget is not None:
        budget.to_csv(folder / "budget.csv", index_label="quantity")
    write_text(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    page = _page(summary, per_sample, table, summary["truth"]["law"], budget, items)
    write_text(folder / "report.html", page)
    return summary


def _sample_reduced(scene: Scene, original: Scene, folder: Path, cache: Path, report):
    """Monte Carlo of the reduced model with one increment per step and, if the scene follows a path, as stated.

    Returns
    -------
    model, assembly
    production : Path
        Results folder of the scene as stated.
    seconds : (2,) tuple of float
        Wall time of the model preparation, and of the samples with one increment per step.
    """
    _refuse_nothing(original)
    seed, law, start = scene.monte_carlo.seed, scene.report.laws[0], time.perf_counter()
    report(f"{scene.name}: reduced model …")
    model, assembly = reduced_and_assembly(scene, cache)
    prepared, samples = time.perf_counter(), model.scene.monte_carlo.samples  # of its table, if it has one
    report(f"{samples} samples, laws {', '.join(scene.report.laws)} …")
    sample_into(folder / "reduced", model, scene.report.laws, samples, seed)
    evaluated = time.perf_counter()
    production = folder / "reduced"
    if scene != original:
        report(f"{samples} samples with the followed path, law {law} …")
        production = folder / "production"
        sample_into(production, _on_path_of(original, model), [law], samples, seed)
    return model, assembly, production, (prepared - start, evaluated - prepared)


def _refuse_nothing(scene: Scene) -> None:
    """Raise SceneError if there is nothing to compare, before anything is solved."""
    if not scene.measurements and not (scene.zones and scene.reads_slip):
        raise SceneError(NOTHING.format(scene.name))
    if scene.monte_carlo.samples < 2:
        raise SceneError(f"scene {scene.name!r} has one sample: a verification takes two; raise monte_carlo.samples")


def _chosen(cheap, truth: str, scene: Scene, count: int) -> list[Choice]:
    """Samples to solve in full; raises SceneError if there is none, or no quantity to compare."""
    base = cheap.get(truth, next(iter(cheap.values())))
    if base.shape[1] == 0:
        raise SceneError(NOTHING.format(scene.name))
    if len(base) < 2:
        raise SceneError(
            f"scene {scene.name!r} has {len(base)} valid samples, not two; `mic run` tells why others fail"
        )
    return choose(base.to_numpy(), base.index.to_numpy(), count, scene.monte_carlo.seed)


def verify_scene(
    scene: Scene,
    folder: Path,
    cache: Path,
    count: int,
    deviated: bool,
    team: Team,
    say=print,
    sources: Collection[str] = EVERY,
    again: int = 0,
) -> dict:
    """Verify the Monte Carlo of a scene by full solves of some samples; returns the content of ``summary.json``.

    Followed stages use one increment per step: every run reports its path error, and followed full solves are slow.

    Parameters
    ----------
    scene : mic.scene.schema.Scene
    folder : Path
    cache : Path
        Cache folder of meshes and influence coefficients.
    count : int
        Number of full solves.
    deviated : bool
        Use meshes with each sample's shape deviation (stiffness, normals, gaps).
    team : Team
    say : callable
        Receives lines of text on the first rank.
    sources : collection of str
        Sources of error from :data:`verification.budget.EVERY`; empty for no error budget.
    again : int
        Number of the chosen samples whose numerical uncertainty :mod:`verification.symmetry.uncertainty` finds.

    Raises
    ------
    SceneError
        If fewer than two samples of the Monte Carlo are valid, or there is no quantity to compare.
    """
    report = say if team.rank == 0 else lambda line: None
    law, truth = scene.report.laws[0], _truth(scene)
    original = _with_truth(scene, truth)
    scene = _on_increments(original)
    with threadpool_limits(limits=1, user_api="blas"):
        model, assembly, production, seconds = _sample_reduced(scene, original, folder, cache, report)
        samples, seed = model.scene.monte_carlo.samples, scene.monte_carlo.seed
        outcome = read_outcome(folder / "reduced")
        cheap = {law: _quantities(outcome, law) for law in outcome.laws}
        chosen = _chosen(cheap, truth, scene, count)
        key = hashlib.sha256(json.dumps([_model_key(model), deviated, truth, seed]).encode()).hexdigest()[:16]
        full = _full_solves(assembly, deviated, truth, chosen, folder / "full", key, team, say)
        items, uncertainty, numbers = [], None, [choice.sample for choice in chosen[:again]]
        if sources:
            report("error budget: " + ", ".join(sources) + " …")
            stated = outcome if production.name == "reduced" else read_outcome(production)
            figures = printed(stated, law)
            case = _case(original, assembly, model, law, cache, figures)
            items.append(_reduction(case, model, truth, deviated, list(zip(chosen, full)), team))
            model = dataclasses.replace(model)  # without its cached preparations, to free memory
            mark = f"{_model_key(case.model)} {seed} {samples} {versions()['mic-contact']}"
            items += estimate(case, folder / "budget", mark, team, sources, say)
        if numbers:
            report("numerical uncertainty: the same samples scaled, rotated, mirrored, renumbered, permuted …")
            deviations = np.concatenate([draw(model.scene, seed, number, 1) for number in numbers])
            once = Solved(original, scene, assembly, model, deviations, truth, cache)
            uncertainty = numerical_uncertainty(once, folder / "symmetry", team, say)
    if team.rank > 0:
        return {}
    budget = None
    if sources:
        items = [_algebra(stated, law), *items, _sampling(figures)]
        budget = by_quantity(figures, items)
    summary = _record(model.scene, chosen, full, seconds, team.size) | {
        "truth": {"law": truth, "deviated_meshes": deviated},
        "budget": None if budget is None else _budget_record(scene.name, budget, items),
        "numerical_uncertainty": uncertainty and _uncertainty_record(folder, *uncertainty, numbers, report),
    }
    solved = [(choice, result) for choice, result in zip(chosen, full) if "failure" not in result]
    tables = _tables(outcome, cheap, model, solved)
    summary |= {name: table.to_dict("records") for name, table in zip(("per_sample", "statistics"), tables)}
    return _write_results(folder, json_ready(summary), *tables, budget, items)


def _case(original, assembly, model, law, cache, figures) -> Case:
    """The case of the error budget: the scene with its own load paths."""
    followed = (_on_path_of(original, item) for item in (assembly, model))
    given = model.scene.monte_carlo.values
    return Case(*followed, law, cache, figures["six_sigma"], SAMPLES if given is None else min(SAMPLES, len(given)))


def _tables(outcome, cheap, model, solved) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Comparisons of the solved samples, and the statistics of each law."""
    rows = [row for choice, result in solved for row in _sample_rows(outcome, model, choice, result)]
    statistics = [row for law in outcome.laws for row in _statistics_rows(law, cheap[law], model, solved)]
    return pd.DataFrame(rows), pd.DataFrame(statistics)


def _algebra(outcome, law) -> Item:
    """Bound on the error from the solver's residual: residual times the largest value of each quantity."""
    residual, largest = outcome.worst_residual(law), _quantities(outcome, law).abs().max()
    how = f"bound: largest certificate residual, {residual:.1g}, times the largest value; reported by every run"
    return Item("algebra", how, 0.0, bounded(residual * largest, residual * largest))


def _sampling(figures) -> Item:
    """Statistical uncertainty of the Monte Carlo."""
    how = f"half the 95 % confidence interval of {int(figures['samples'].max())} samples; reported by every run"
    return Item(SAMPLING, how, 0.0, bounded(figures["mean_half"], figures["six_sigma_half"]))


def _reduction(case, model, truth, deviated, solved, team) -> Item:
    """Error of the reduction on the same meshes: reduced against full solves of the selected samples."""
    solved = [(choice, result) for choice, result in solved if "failure" not in result]
    meshes = "meshes with each sample's shape" if deviated else "nominal meshes"
    counted = f"{len(solved)} sample{'s' * (len(solved) != 1)}"
    how = f"bound: {counted} by full finite elements on {meshes}, one increment per step"
    seconds = float(sum(result.get("cpu", result["seconds"]) for _, result in solved))
    if not solved:
        return Item("reduction", "not estimated: no full solve succeeded", seconds, None)

    def reduced_values(pair) -> pd.Series:
        sample = draw(model.scene, model.scene.monte_carlo.seed, pair[0].sample, 1)
        same = DeviatedStiffness(case.assembly, model).at(sample[0]) if deviated else model
        return values(same, same.process(truth).attempt(sample)).iloc[0]

    try:
        reduced = team.map(reduced_values, solved)
    except SceneError as problem:
        return Item("reduction", f"not estimated: {problem}", seconds, None)
    full = pd.DataFrame([_full_quantities(model, result) for _, result in solved])
    return Item("reduction", how, seconds, largest_difference(pd.DataFrame(reduced).reset_index(drop=True), full))


def _uncertainty_record(folder, table, refused, numbers, report) -> dict:
    """Write ``uncertainty.csv``, print its rows, and return the entry of ``summary.json``."""
    table.to_csv(folder / "uncertainty.csv")
    said, rows = sentences(table, refused, len(numbers)), lines(table)
    for sentence in said:
        report(sentence)
    shown = {name: [f"{x:.6g}" if name == "value" else f"{x:.1e}" for x in rows[name]] for name in ROUNDED}
    report(rows.assign(**shown).drop(columns="relative").to_string(index=False))
    return {"sentences": said, "samples": numbers, "rows": rows.to_dict("records")}


def _budget_record(name, budget, items) -> dict:
    sources = [
        {
            "source": item.source,
            "how": item.how,
            "seconds": item.seconds,
            "counts": item.counts,
            "errors": [] if item.table is None else item.table.rename_axis("quantity").reset_index().to_dict("records"),
        }
        for item in items
    ]
    return {
        "sentences": budget_sentences(name, budget, items),
        "quantities": budget.rename_axis("quantity").reset_index().to_dict("records"),
        "sources": sources,
    }


def _on_increments(scene):
    """The scene with one increment per step in stages that would follow a path."""
    steps = {"path": "increments", "increments": 1}
    stages = [
        stage.model_copy(update=steps)
        if stage.kind in MOVING and stage.path in (None, "followed") and stage.increments is None
        else stage
        for stage in scene.stages
    ]
    return scene.model_copy(update={"stages": stages})


def _on_path_of(scene, item):
    """An assembly or a model with the paths of a scene; it keeps its modes in place of measured shapes and fields."""
    own = item.scene.model_copy(update={"stages": scene.stages, "path": scene.path})
    return dataclasses.replace(item, scene=own)


def _truth(scene) -> str:
    """Law of the full solves: Coulomb's, or that of the scene if its zones have data for it."""
    if not any(zone.frictional for zone in scene.zones):
        return "frictionless"
    return scene.report.laws[0] if LAWS[scene.report.laws[0]].reads else "coulomb"


def _with_truth(scene, truth):
    """The scene with the law of the full solves among its laws if it is frictional, all its samples, and no fields."""
    laws = list(scene.report.laws)
    if truth != "frictionless" and truth not in laws:
        laws.append(truth)
    report = scene.report.model_copy(update={"laws": laws, "fields": False})
    everything = scene.monte_carlo.model_copy(update={"accuracy": None})  # extremes are chosen among many samples
    return scene.model_copy(update={"report": report, "monte_carlo": everything})


def _model_key(model):
    digest = hashlib.sha256(model.scene.model_dump_json(exclude={"monte_carlo", "report", "description"}).encode())
    for array in (*model.compliance.H, *model.compliance.G, model.shape, model.contacts.gap, model.contacts.frame):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _full_solves(assembly, deviated, law, chosen, folder, key, team, say) -> list[dict]:
    """Full solves of the chosen samples; the full model is freed on return."""
    if team.rank == 0:
        selected = ", ".join(f"{choice.sample} ({choice.kind})" for choice in chosen)
        say(f"full finite elements, {'deviated' if deviated else 'nominal'} meshes: samples {selected}")
    try:
        full, scene = FullModel(assembly, deviated=deviated, comm=MPI.COMM_SELF), assembly.scene
    except SceneError as problem:
        if team.rank == 0:
            say(f"  none is solved: {problem}")
        return [{"failure": str(problem)}] * len(chosen)
    seed = scene.monte_carlo.seed
    return team.map(lambda choice: _full(full, scene, seed, law, choice.sample, folder, key, say), chosen)


def _full(full, scene, seed, law, sample, folder, key, say) -> dict:
    """Full solve of one sample, read from the folder if it is stored there."""
    path = folder / f"{sample:06d}-{key}.npz"
    if path.is_file():
        with np.load(path) as data:
            return dict(data)
    start, worked = time.perf_counter(), time.process_time()
    try:
        evaluation = full.evaluate(draw(scene, seed, sample, 1)[0], law)
    except ContactFailure as problem:
        say(f"  sample {sample} failed: {problem}")
        return {"failure": str(problem)}
    result = {"measurements": evaluation.measurements, "seconds": np.array(time.perf_counter() - start)}
    result["cpu"] = np.array(time.process_time() - worked)
    for stage, resolution in evaluation.resolutions.items():
        result |= {
            f"force:{stage}": resolution.force,
            f"displacement:{stage}": resolution.displacement,
            f"state:{stage}": resolution.state,
        }
    with replacing(path) as temporary:
        np.savez(temporary, **result)
    say(f"  sample {sample}: {result['seconds']:.0f} s")
    return result


def _quantities(outcome, law) -> pd.DataFrame:
    """Slips and measurements of the valid samples, indexed by sample."""
    columns = {
        f"slip:{stage}:{zone}": outcome.tangential(law, stage, zone)
        for stage in outcome.stages
        for zone in outcome.zones
        if outcome.has_slip
    }
    columns |= {
        f"measurement:{item.name}": outcome.measured(law, item.name) for item in outcome.model.scene.measurements
    }
    return pd.DataFrame(columns, index=outcome.sample_numbers(law))


def _full_quantities(model, result) -> dict[str, float]:
    """Slips and measurements of one full solve."""
    scene, quantities = model.scene, {}
    for name, moved in result.items():
        if name.startswith("displacement:") and model.contacts.dimension == 3:
            slip = zone_slip(moved, model.contacts, len(scene.zones))
            quantities |= {
                f"slip:{name.removeprefix('displacement:')}:{zone.name}": float(s) for zone, s in zip(scene.zones, slip)
            }
    return quantities | {
        f"measurement:{item.name}": float(value) for item, value in zip(scene.measurements, result["measurements"])
    }


def _sample_rows(outcome, model, choice, result) -> list[dict]:
    """Differences between reduced and full results of one sample under each law."""
    stages = [name.removeprefix("force:") for name in result if name.startswith("force:")]
    axes = ("n", "t1", "t2")[: model.contacts.dimension]
    truth, rows = _full_quantities(model, result), []
    for law in outcome.laws:
        place = np.flatnonzero(outcome.sample_numbers(law) == choice.sample)
        if not len(place):
            continue
        force, states = [], 0
        for stage in stages:
            reduced = np.stack([outcome.contact(law, stage, f"f_{axis}")[place[0]] for axis in axes], axis=-1)
            force.append(relative(reduced, result[f"force:{stage}"]))
            states += int((outcome.contact(law, stage, "state")[place[0]] != result[f"state:{stage}"]).sum())
        row = _quantities(outcome, law).iloc[place[0]]
        slips, measured = ([name for name in truth if name.startswith(kind)] for kind in ("slip:", "measurement:"))
        rows.append(
            {
                "law": law,
                "sample": choice.sample,
                "kind": choice.kind,
                "force, relative": max(force, default=0.0),
                "zone slip, relative": relative([row[name] for name in slips], [truth[name] for name in slips]),
                "zone slip, mm": max((abs(row[name] - truth[name]) for name in slips), default=0.0),
                "measurement, mm": max((abs(row[name] - truth[name]) for name in measured), default=0.0),
                "changed states": states,
            }
        )
    return rows


def _statistics_rows(law, cheap, model, solved) -> list[dict]:
    """Mean and 6σ of every quantity from the Monte Carlo and from the two-level estimate."""
    full = {choice.sample: _full_quantities(model, result) for choice, result in solved if choice.sample in cheap.index}
    place = [cheap.index.get_loc(sample) for sample in full]
    rows = []
    for name in cheap.columns:
        y = cheap[name].to_numpy()
        row = {"law": law, "quantity": name}
        row |= _estimate("mean", estimates.mean(y)) | _estimate("6σ", estimates.six_sigma(y))
        if full:
            corrected = two_level(y, place, [values[name] for values in full.values()])
            row |= _estimate("corrected mean", corrected.mean) | _estimate("corrected 6σ", corrected.six_sigma)
            row |= {
                "slope": corrected.slope,
                "residual, mm": corrected.residual,
                "worth, full solves": corrected.worth,
                "error of the mean, σ": (row["mean"] - corrected.mean.value) / corrected.sigma.value
                if corrected.sigma.value > 0
                else 0.0,
                "error of 6σ": row["6σ"] / corrected.six_sigma.value - 1 if corrected.sigma.value > 0 else 0.0,
            }
        rows.append(row)
    return rows


def _estimate(name, estimate):
    return {name: estimate.value, f"{name} low": estimate.low, f"{name} high": estimate.high}


def _figure(table, truth):
    """Corrected mean and 6σ of every quantity relative to the reduced ones, with confidence intervals."""
    laws = list(dict.fromkeys(table["law"]))
    names = list(dict.fromkeys(table["quantity"]))
    figure, (left, right) = panels(2, 6.0, 1.4 + 0.26 * len(names))
    for k, law in enumerate(laws):
        rows = table[table["law"] == law].set_index("quantity").loc[names]
        y = np.arange(len(names)) + 0.22 * (k - (len(laws) - 1) / 2)
        sigma = rows["6σ"].to_numpy() / 6
        for axis, corrected, centre, scale in (
            (left, "corrected mean", rows["mean"], sigma),
            (right, "corrected 6σ", rows["6σ"], rows["6σ"]),
        ):
            with np.errstate(divide="ignore", invalid="ignore"):
                value, low, high = ((rows[f"{corrected}{end}"] - centre) / scale for end in ("", " low", " high"))
            axis.errorbar(
                value,
                y,
                xerr=[(value - low).clip(lower=0), (high - value).clip(lower=0)],
                fmt="o",
                ms=3.5,
                lw=1.2,
                label=law,
            )
    for axis, label in ((left, "corrected mean − reduced mean, in σ"), (right, "corrected 6σ / reduced 6σ − 1")):
        axis.axvline(0, color="k", lw=0.8)
        axis.set(yticks=range(len(names)), yticklabels=names, xlabel=label)
        axis.set_xscale("symlog", linthresh=LINEAR)
        axis.set(xlim=(-SHOWN, SHOWN), xticks=TICKS, xticklabels=[f"{tick:g}" for tick in TICKS])
        axis.minorticks_off()
        axis.invert_yaxis()
    right.set_yticklabels([])
    figure.legend(
        *left.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=len(laws),
        frameon=False,
        title=f"reduced law; full: {truth}",
    )
    return figure


def _page(summary, per_sample, table, truth, budget, items) -> str:
    image = None
    if len(table) and "corrected mean" in table and table["corrected mean low"].notna().any():
        image = base64.b64encode(svg(_figure(table, truth))).decode()
    drawn = {}
    if budget is not None:
        drawn["bars"] = base64.b64encode(svg(budget_figure([(summary["scene"], budget, items)]))).decode()
        drawn["sources"] = table_cells(budget_rows(items, budget))
        drawn["quantities"] = table_cells(quantity_rows(budget))
    if summary["numerical_uncertainty"]:
        drawn["uncertainty"] = table_cells(pd.DataFrame(summary["numerical_uncertainty"]["rows"]))
    return (
        environment()
        .get_template("own_scene.html")
        .render(
            summary=summary,
            image=image,
            **drawn,
            level=estimates.LEVEL,
            worst=worst(table),
            leading=LEADING,
            per_sample=table_cells(per_sample),
            statistics=table_cells(table),
        )
    )


def worst(table) -> list[dict]:
    """Largest error of mean and 6σ over the leading quantities by the two-level estimate, for each law.

    Fewer than three full solves give no interval, and no law.
    """
    errors = []
    kind = table["quantity"].str.split(":").str[0]
    leading = (
        table[table["6σ"] >= LEADING * table.groupby(["law", kind])["6σ"].transform("max")] if len(table) else table
    )
    for law, rows in leading.groupby("law", sort=False):
        if "error of 6σ" in rows and (rows := rows[rows["corrected 6σ low"].notna()]).size:
            six, mean = (rows.loc[rows[column].abs().idxmax()] for column in ("error of 6σ", "error of the mean, σ"))
            errors.append(
                {
                    "law": law,
                    "six_sigma": six["error of 6σ"],
                    "six_sigma_of": six["quantity"],
                    "low": six["6σ"] / six["corrected 6σ high"] - 1,
                    "high": six["6σ"] / six["corrected 6σ low"] - 1,
                    "mean": mean["error of the mean, σ"],
                    "mean_of": mean["quantity"],
                }
            )
    return errors
