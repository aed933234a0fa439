"""A user's own scene verified: its Monte Carlo, a few of its samples by full finite elements, and what follows for mean
and 6σ.

The folder holds ``production/`` (the Monte Carlo, as `mic run` leaves it), ``reduced/`` (the same on one increment a
step, where the scene's path is followed), ``full/`` and ``budget/`` (one file per full solve and per source of error; a
second call takes up where the first was stopped), ``summary.json``, ``samples.csv``, ``estimates.csv``,
``budget.csv`` and ``report.html``.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import math
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from fem_reference.full.model import ContactFailure, FullModel
from mic.errors import SceneError
from mic.results.outcome import read_outcome
from mic.results.run_folder import versions
from mic.runs import sample_into
from mic.scene import Scene
from mic.scene.settings import FOLLOWING
from mic.statistics import estimates
from mic.statistics.draw import draw
from verification.budget import EVERY, SAMPLING, Case, Item, bounded, estimate, largest_difference, values
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
from verification.two_level import two_level

__all__ = ["Choice", "choose", "verify_scene"]

SHOWN, LINEAR = 5.0, 0.1  # range of the error-bar figure, and its linear part
TICKS = (-5, -1, -0.1, 0, 0.1, 1, 5)
LEADING = (
    0.1  # quantities that vary by less than this share of the most variable one of their kind do not make the headline
)


@dataclass(frozen=True)
class Choice:
    """A sample chosen for a full solve.

    Attributes
    ----------
    sample : int
    kind : {"typical", "extreme", "random"}
    """

    sample: int
    kind: str


def choose(results: np.ndarray, numbers: np.ndarray, count: int, seed: int) -> list[Choice]:
    """Pick samples by their cheap results: one typical, then extreme and random ones by turns.

    Parameters
    ----------
    results : (n, k) array
        Finite results of the samples.
    numbers : (n,) int array
        The samples' numbers.
    count : int
        At most n are picked.
    seed : int

    Returns
    -------
    list of Choice
        The first is the sample nearest to the median; each extreme one is the farthest from all picked before it, every
        quantity measured in its own standard deviation; the random ones do not depend on `results`.
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
    """Samples, full solves and times of a verification, for ``summary.json``."""
    samples, laws = scene.monte_carlo.samples, scene.report.laws
    taken = [result["seconds"] for result in full if "failure" not in result]
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
            "full_sample": float(np.mean(taken)) if taken else None,
        },
        "versions": versions(),
        "ranks": ranks,
    }


def _write_results(folder: Path, summary: dict, per_sample: pd.DataFrame, table: pd.DataFrame, budget, items) -> dict:
    """Write tables, ``summary.json`` and the page; returns the summary."""
    per_sample.to_csv(folder / "samples.csv", index=False)
    table.to_csv(folder / "estimates.csv", index=False)
    _write(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    page = _page(summary, per_sample, table, summary["truth"]["law"], budget, items)
    _write(folder / "report.html", page)
    return summary


def _sample_reduced(scene: Scene, asked: Scene, folder: Path, cache: Path, tell):
    """Monte Carlo of the reduced model, on increments and, where the scene follows its path, as the scene states it.

    Returns
    -------
    model, assembly
    production : Path
        Results folder of the scene as stated.
    seconds : (2,) tuple of float
        Wall time of the model, and of its samples on increments.
    """
    samples, seed, law = scene.monte_carlo.samples, scene.monte_carlo.seed, scene.report.laws[0]
    start = time.perf_counter()
    tell(f"{scene.name}: reduced model and {samples} samples under {', '.join(scene.report.laws)} …")
    model, assembly = reduced_and_assembly(scene, cache)
    prepared = time.perf_counter()
    sample_into(folder / "reduced", model, scene.report.laws, samples, seed)
    evaluated = time.perf_counter()
    production = folder / "reduced"
    if scene != asked:
        tell(f"{samples} samples as the scene has its path, under {law} …")
        production = folder / "production"
        sample_into(production, dataclasses.replace(model, scene=asked), [law], samples, seed)
    return model, assembly, production, (prepared - start, evaluated - prepared)


def _chosen(cheap, truth: str, scene: Scene, count: int) -> list[Choice]:
    """Samples to solve in full; raises SceneError if there is nothing to compare."""
    base = cheap.get(truth, next(iter(cheap.values())))
    if base.shape[1] == 0 or len(base) == 0:
        raise SceneError(
            f"scene {scene.name!r} has nothing to verify: it needs samples that do not fail, and measurements or "
            "contact zones with friction; add [[measurements]], or find out with mic run why samples fail"
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
) -> dict:
    """Verify the Monte Carlo of a scene by a few full solves; returns the content of ``summary.json``.

    Followed stages take one increment a step here, in the reduced model and in the full solves: every run reports its
    own path error, and followed full solves would take minutes a sample.

    Parameters
    ----------
    scene : mic.scene.schema.Scene
    folder : Path
    cache : Path
        Folder of meshes and influence coefficients.
    count : int
        Full solves.
    deviated : bool
        Use meshes that carry each sample's shape deviation, with its stiffness, normals and gaps.
    team : Team
    say : callable
        Receives lines of text on the first rank.
    sources : collection of str
        Sources of error to estimate, of :data:`verification.budget.EVERY`; without any there is no budget.

    Raises
    ------
    SceneError
        If no sample of the Monte Carlo is valid, or the scene has nothing to compare.
    """
    folder = Path(folder)
    tell = say if team.rank == 0 else lambda line: None
    law, asked = scene.report.laws[0], _with_truth(scene)
    scene = _on_increments(asked)
    truth = "coulomb" if any(zone.frictional for zone in scene.zones) else "frictionless"
    samples, seed = scene.monte_carlo.samples, scene.monte_carlo.seed
    with threadpool_limits(limits=1, user_api="blas"):
        model, assembly, production, seconds = _sample_reduced(scene, asked, folder, cache, tell)
        outcome = read_outcome(folder / "reduced")
        cheap = {law: _quantities(outcome, law) for law in outcome.laws}
        chosen = _chosen(cheap, truth, scene, count)
        tell(
            f"full finite elements, {'deviated' if deviated else 'nominal'} meshes: samples "
            + ", ".join(f"{choice.sample} ({choice.kind})" for choice in chosen)
        )
        key = hashlib.sha256(json.dumps([_model_key(model), deviated, truth, seed]).encode()).hexdigest()[:16]
        full = _full_solves(assembly, deviated, truth, chosen, folder / "full", key, team, say)
        items = []
        if sources:
            tell("error budget: " + ", ".join(sources) + " …")
            printing = outcome if production.name == "reduced" else read_outcome(production)
            figures = printed(printing, law)
            followed = (dataclasses.replace(one, scene=asked) for one in (assembly, model))
            case = Case(*followed, law, cache, figures["six_sigma"])
            items.append(_reduction(case, model, truth, deviated, list(zip(chosen, full)), team))
            model = dataclasses.replace(model)  # without what it has prepared, which takes room and is done with
            mark = f"{_model_key(case.model)} {seed} {samples} {versions()['mic-contact']}"
            items += estimate(case, folder / "budget", mark, team, sources, say)
    if team.rank > 0:
        return {}
    budget = None
    if sources:
        items = [_algebra(printing, law), *items, _sampling(figures)]
        budget = by_quantity(figures, items)
        budget.to_csv(folder / "budget.csv", index_label="quantity")
    solved = [(choice, result) for choice, result in zip(chosen, full) if "failure" not in result]
    per_sample = pd.DataFrame(
        [row for choice, result in solved for row in _sample_rows(outcome, model, choice, result)]
    )
    table = pd.DataFrame([row for law in outcome.laws for row in _statistics_rows(law, cheap[law], model, solved)])
    summary = _record(scene, chosen, full, seconds, team.size) | {
        "truth": {"law": truth, "deviated_meshes": deviated},
        "budget": None if budget is None else _budget_record(scene.name, budget, items),
        "per_sample": per_sample.to_dict("records"),
        "statistics": table.to_dict("records"),
    }
    return _write_results(folder, _finite(summary), per_sample, table, budget, items)


def _algebra(outcome, law) -> Item:
    """What the solver's residual leaves, as far as each quantity comes from zero."""
    residual, reach = outcome.worst_residual(law), _quantities(outcome, law).abs().max()
    how = f"bound: the largest certificate residual, {residual:.1g}, times the largest value; every run tells it"
    return Item("algebra", how, 0.0, bounded(residual * reach, residual * reach))


def _sampling(figures) -> Item:
    how = f"half the 95 % interval of {int(figures['samples'].max())} samples; every run tells it"
    return Item(SAMPLING, how, 0.0, bounded(figures["mean_half"], figures["six_sigma_half"]))


def _reduction(case, model, truth, deviated, solved, team) -> Item:
    """What the reduction leaves on the same meshes, as full solves see it."""
    solved = [(choice, result) for choice, result in solved if "failure" not in result]
    meshes = "meshes that carry each sample's shape" if deviated else "nominal meshes"
    how = f"bound: {len(solved)} picked samples by full finite elements on {meshes}, one increment a step"
    seconds = float(sum(result.get("cpu", result["seconds"]) for _, result in solved))
    if not solved:
        return Item("reduction", "not estimated: no full solve succeeded", seconds, None)

    def again(pair) -> pd.Series:
        sample = draw(model.scene, model.scene.monte_carlo.seed, pair[0].sample, 1)
        own = DeviatedStiffness(case.assembly, model).at(sample[0]) if deviated else model
        return values(own, own.process(truth).attempt(sample)).iloc[0]

    try:
        mine = team.map(again, solved)
    except SceneError as problem:
        return Item("reduction", f"not estimated: {problem}", seconds, None)
    full = pd.DataFrame([_of_full(model, result) for _, result in solved])
    return Item("reduction", how, seconds, largest_difference(pd.DataFrame(mine).reset_index(drop=True), full))


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
    """The scene with one increment a step where paths are followed."""
    steps = {"path": "increments", "increments": 1}
    stages = [
        stage.model_copy(update=steps)
        if stage.kind in FOLLOWING and stage.path in (None, "followed") and stage.increments is None
        else stage
        for stage in scene.stages
    ]
    return scene.model_copy(update={"stages": stages})


def _with_truth(scene):
    """The scene with Coulomb's law among its laws where it has friction, and without fields."""
    laws = list(scene.report.laws)
    if any(zone.frictional for zone in scene.zones) and "coulomb" not in laws:
        laws.insert(0, "coulomb")
    return scene.model_copy(update={"report": scene.report.model_copy(update={"laws": laws, "fields": False})})


def _model_key(model):
    digest = hashlib.sha256(model.scene.model_dump_json(exclude={"monte_carlo", "report", "description"}).encode())
    for array in (*model.compliance.H, *model.compliance.G, model.shape, model.contacts.gap, model.contacts.frame):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _full_solves(assembly, deviated, law, chosen, folder, key, team, say) -> list[dict]:
    """Of chosen samples; what they hold is free again once they are done."""
    full_model, scene = FullModel(assembly, deviated=deviated, comm=MPI.COMM_SELF), assembly.scene
    seed = scene.monte_carlo.seed
    return team.map(lambda choice: _full(full_model, scene, seed, law, choice.sample, folder, key, say), chosen)


def _full(full_model, scene, seed, law, sample, folder, key, say) -> dict:
    """The full solve of one sample, from the folder if it holds it."""
    path = folder / f"{sample:06d}-{key}.npz"
    if path.is_file():
        with np.load(path) as data:
            return dict(data)
    start, worked = time.perf_counter(), time.process_time()
    try:
        found = full_model.evaluate(draw(scene, seed, sample, 1)[0], law)
    except ContactFailure as problem:
        say(f"  sample {sample} failed: {problem}")
        return {"failure": str(problem)}
    result = {"measurements": found.measurements, "seconds": np.array(time.perf_counter() - start)}
    result["cpu"] = np.array(time.process_time() - worked)
    for stage, resolution in found.resolutions.items():
        result |= {
            f"force:{stage}": resolution.force,
            f"displacement:{stage}": resolution.displacement,
            f"state:{stage}": resolution.state,
        }
    folder.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}")
    np.savez(temporary, **result)
    temporary.replace(path)
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


def _of_full(model, result) -> dict[str, float]:
    """The same quantities of one full solve."""
    scene, found = model.scene, {}
    for name, moved in result.items():
        if name.startswith("displacement:") and model.contacts.dimension == 3:
            slip = zone_slip(moved, model.contacts, len(scene.zones))
            found |= {
                f"slip:{name.removeprefix('displacement:')}:{zone.name}": float(s) for zone, s in zip(scene.zones, slip)
            }
    return found | {
        f"measurement:{item.name}": float(value) for item, value in zip(scene.measurements, result["measurements"])
    }


def _sample_rows(outcome, model, choice, result) -> list[dict]:
    """How far one sample's reduced results are from the full ones, under each law."""
    stages = [name.removeprefix("force:") for name in result if name.startswith("force:")]
    axes = ("n", "t1", "t2")[: model.contacts.dimension]
    truth, rows = _of_full(model, result), []
    for law in outcome.laws:
        place = np.flatnonzero(outcome.sample_numbers(law) == choice.sample)
        if not len(place):
            continue
        force, states = [], 0
        for stage in stages:
            mine = np.stack([outcome.contact(law, stage, f"f_{axis}")[place[0]] for axis in axes], axis=-1)
            force.append(relative(mine, result[f"force:{stage}"]))
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
    """Mean and 6σ of every quantity: what the Monte Carlo says, and what the two levels together say."""
    dear = {choice.sample: _of_full(model, result) for choice, result in solved if choice.sample in cheap.index}
    place = [cheap.index.get_loc(sample) for sample in dear]
    rows = []
    for name in cheap.columns:
        y = cheap[name].to_numpy()
        row = {"law": law, "quantity": name}
        row |= _estimate("mean", estimates.mean(y)) | _estimate("6σ", estimates.six_sigma(y))
        if dear:
            found = two_level(y, place, [values[name] for values in dear.values()])
            row |= _estimate("corrected mean", found.mean) | _estimate("corrected 6σ", found.six_sigma)
            row |= {
                "slope": found.slope,
                "residual, mm": found.residual,
                "worth, full solves": found.worth,
                "error of the mean, σ": (row["mean"] - found.mean.value) / found.sigma.value
                if found.sigma.value > 0
                else 0.0,
                "error of 6σ": row["6σ"] / found.six_sigma.value - 1 if found.sigma.value > 0 else 0.0,
            }
        rows.append(row)
    return rows


def _estimate(name, estimate):
    return {name: estimate.value, f"{name} low": estimate.low, f"{name} high": estimate.high}


def _figure(table, truth):
    """Error bars on the Monte Carlo: the corrected mean and 6σ of every quantity with their intervals, seen from the
    reduced ones."""
    laws = list(dict.fromkeys(table["law"]))
    names = list(dict.fromkeys(table["quantity"]))
    figure, (left, right) = panels(2, 6.0, 1.4 + 0.26 * len(names))
    for k, law in enumerate(laws):
        own = table[table["law"] == law].set_index("quantity").loc[names]
        y = np.arange(len(names)) + 0.22 * (k - (len(laws) - 1) / 2)
        sigma = own["6σ"].to_numpy() / 6
        for axis, corrected, centre, scale in (
            (left, "corrected mean", own["mean"], sigma),
            (right, "corrected 6σ", own["6σ"], own["6σ"]),
        ):
            with np.errstate(divide="ignore", invalid="ignore"):
                value, low, high = ((own[f"{corrected}{end}"] - centre) / scale for end in ("", " low", " high"))
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
    if len(table) and "corrected mean" in table:
        image = base64.b64encode(svg(_figure(table, truth))).decode()
    drawn = {}
    if budget is not None:
        drawn["bars"] = base64.b64encode(svg(budget_figure([(summary["scene"], budget, items)]))).decode()
        drawn["sources"] = table_cells(budget_rows(items, budget))
        drawn["quantities"] = table_cells(quantity_rows(budget))
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
    """By law, the largest error of the mean and of 6σ over the leading quantities, as the two-level estimate sees
    it."""
    found = []
    kind = table["quantity"].str.split(":").str[0]
    leading = (
        table[table["6σ"] >= LEADING * table.groupby(["law", kind])["6σ"].transform("max")] if len(table) else table
    )
    for law, own in leading.groupby("law", sort=False):
        if "error of 6σ" in own:
            six, mean = own.loc[own["error of 6σ"].abs().idxmax()], own.loc[own["error of the mean, σ"].abs().idxmax()]
            found.append(
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
    return found


def _finite(value):
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _finite(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _write(path, text):
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(text)
    temporary.replace(path)
