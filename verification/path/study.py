"""Accuracy, error estimate and cost of the followed load path with friction."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from mpi4py import MPI

from fem_reference.full.model import FullModel
from mic.contact.path import Followed, Increments, Trace
from mic.model.assembly import assemble
from mic.process.process import Process
from mic.statistics.draw import draw
from verification.analytic.leaves import Leaves, deflections
from verification.comparison import relative
from verification.path.closed_forms import CASES, error
from verification.plots import panels
from verification.scenes import shipped, with_path
from verification.study import Acceptance, Finding, Study

SCENES = {"lap_joint": 2, "hat_on_plate": 4, "wheelhouse": 10}  # and largest cost of a path, in single increments
SLIP, KEY, LENGTH = 0.01, 0.005, 0.002  # allowed error of a mean or 6σ: relative, and mm
FORCE = 0.01  # allowed error of a mean sum of forces, relative to it or to the largest force
ROUNDING = 1e-6  # mm: smaller errors are neither estimated nor relevant
STEPS = (8, 16, 32, 64)
#: Path tolerances: a twenty-fifth of the default, smaller, and a tenth of that as the reference.
TIGHT, TIGHTER = 1e-5, 1e-6
#: Path tolerances of the full solve and of the reduced model, mm, ever finer. The limit is a hundred times the rounding
#: error of a position, 1e-16 of some 100 mm; below it, steps would shrink without end.
FULL, REDUCED = (1e-6, 1e-8, 1e-10), (1e-9, 1e-11, 1e-12)
QUICK_FULL, QUICK_REDUCED = (1e-4, 1e-5), (1e-8, 1e-10)
STATED = (("increments", 3), ("one-step", None))  # paths with the same increments in both methods
SEED = 303
FEW = 8  # samples solved with many increments


@dataclass(frozen=True)
class Ended:
    """End of a stage: the part of an evaluation that is sent between processes."""

    displacement: np.ndarray
    trace: Trace
    force: np.ndarray


@dataclass(frozen=True)
class Gone:
    """Evaluation of n samples: the part that is compared."""

    failed: np.ndarray
    measurements: np.ndarray
    resolutions: dict[str, Ended]

    @classmethod
    def of(cls, found) -> Gone:
        """The compared part of an evaluation."""
        ends = {stage: Ended(one.displacement, one.trace, one.force) for stage, one in found.resolutions.items()}
        return cls(found.failed, found.measurements, ends)


def evaluate(model, deviations, path=None):
    """Evaluation under Coulomb's law with one path in all stages, or the scene's of a given tolerance or its own."""
    process = Process(model, "coulomb", path_tolerance=path if isinstance(path, float) else None)
    for stage in process.stages if isinstance(path, Increments | Followed) else ():
        stage.path = path
    return process.evaluate(deviations)


def slips(model, evaluation):
    """RMS over the contacts of a zone for each sample, mm, by stage, zone and kind."""
    found = {}
    for stage, resolution in evaluation.resolutions.items():
        for kind, values in (("slip", resolution.trace.slip), ("displacement", resolution.displacement[:, :, 1:])):
            square = (values**2).sum(-1)
            for z, zone in enumerate(model.scene.zones):
                found[stage, zone.name, kind] = np.sqrt(square[:, model.contacts.zone == z].mean(1))
    return found


def quantities_of(model, evaluation):
    """Quantities with printed statistics, (n,) each, mm; key characteristics have no stage."""
    quantities = {" ".join(name): y for name, y in slips(model, evaluation).items()}
    return quantities | {item.name: y for item, y in zip(model.scene.measurements, evaluation.measurements.T)}


def extrapolated(coarser, finer, ratio):
    """Limit for many increments, extrapolated at first order from two numbers of increments with this ratio."""
    return {name: y + (y - coarser[name]) / (ratio - 1) for name, y in finer.items()}


def statistics_of(model, quantities):
    """Rows of (quantity, mean, 6σ), mm."""
    keys = {item.name for item in model.scene.measurements}
    return pd.DataFrame(
        [
            {"quantity": name, "key": name in keys, "mean": y.mean(), "6σ": 6 * y.std(ddof=1)}
            for name, y in quantities.items()
        ]
    )


def allowed(reference):
    """(rows, 2) allowed errors of mean and 6σ, mm: relative to each, for key characteristics both relative to 6σ."""
    values = reference[["mean", "6σ"]].abs().to_numpy()
    key = reference["key"].to_numpy()[:, None]
    return np.maximum(LENGTH, np.where(key, KEY * values[:, 1:], SLIP * values))


def off(found, reference):
    """(rows, 2) differences of mean and 6σ over the allowed errors."""
    return np.abs(found[["mean", "6σ"]].to_numpy() - reference[["mean", "6σ"]].to_numpy()) / allowed(reference)


def cost(evaluation):
    """Factorisations of all samples."""
    return int(sum(resolution.trace.factorisations.sum() for resolution in evaluation.resolutions.values()))


def errors(found, reference):
    """(stages, n) error of the contacts' positions at the end of each stage, root mean square over the contacts, and
    the estimate of it, mm."""
    true, estimate, position = [], [], 0.0
    for stage, exact in reference.resolutions.items():
        resolution = found.resolutions[stage]
        position = position + (resolution.displacement - exact.displacement[: len(found.failed)])[:, :, 1:]
        true.append(np.sqrt((position**2).sum(-1).mean(1)))
        estimate.append(resolution.trace.error)
    return np.array(true), np.array(estimate)


def force_errors(model, found, reference):
    """Errors of the contact forces at the end of each stage.

    Returns
    -------
    off : float
        Largest difference of a mean sum of normal or friction forces of a zone, over the larger of 1 % of it and of
        the mean of the largest force.
    true, estimate : (stages, n) array
        Root mean square over the contacts, N, and the estimate of it.
    """
    off, true, estimate = 0.0, [], []
    for stage, exact in reference.resolutions.items():
        resolution = found.resolutions[stage]
        pair = resolution.force, exact.force[: len(found.failed)]
        true.append(np.sqrt(((pair[0] - pair[1]) ** 2).sum(-1).mean(1)))
        estimate.append(resolution.trace.force_error)
        largest = np.abs(pair[1]).max(axis=(1, 2)).mean()
        for z in range(len(model.scene.zones)):
            own = model.contacts.zone == z
            sums = [(f[:, own, 0].sum(1).mean(), np.linalg.norm(f[:, own, 1:], axis=2).sum(1).mean()) for f in pair]
            for value, wanted in zip(*sums):
                off = max(off, abs(value - wanted) / (FORCE * max(wanted, largest, np.finfo(float).tiny)))
    return off, np.array(true), np.array(estimate)


def paths_of(counts):
    """Paths by label; the last one is the reference."""
    paths = {"followed": None, "25 times tighter": TIGHT}
    return paths | {f"{count} increments": Increments(count) for count in (1, *counts)} | {"tightest": TIGHTER}


def on_scene(name, model, evaluations, counts):
    """Compare the followed path, increments and their extrapolated limit with the tightest path of one scene.

    Returns the table, errors and error estimates of the followed samples, the distances from the tightest path, and
    errors and estimates of forces.
    """
    for label, evaluation in evaluations.items():
        if evaluation.failed.any():
            raise ArithmeticError(f"{name}, {label}: {evaluation.failed.sum()} samples failed")
    exact = evaluations["tightest"]
    found_by = {label: quantities_of(model, found) for label, found in evaluations.items()}
    judge = found_by.pop("tightest")
    coarser, finer = (f"{count} increments" for count in counts[-2:])
    found_by[f"limit of {coarser.split()[0]} and {finer}"] = extrapolated(
        found_by[coarser], found_by[finer], counts[-1] / counts[-2]
    )
    single = cost(evaluations["1 increments"]) / len(evaluations["1 increments"].failed)
    rows = []
    for label, quantities in found_by.items():
        samples = len(next(iter(quantities.values())))
        reference = statistics_of(model, {what: y[:samples] for what, y in judge.items()})
        key = reference["key"].to_numpy()
        share = off(statistics_of(model, quantities), reference).max(axis=1)
        spent = cost(evaluations[label]) / samples if label in evaluations else np.nan
        rows.append(
            {
                "scene": name,
                "path": label,
                "samples": samples,
                "slip / allowed": share[~key].max(),
                "worst slip": reference["quantity"][~key].iloc[int(share[~key].argmax())],
                "key characteristic / allowed": share[key].max(),
                "force / allowed": force_errors(model, evaluations[label], exact)[0]
                if label in evaluations
                else np.nan,
                "factorisations per sample": spent,
                "times one increment": spent / single,
            }
        )
    true, estimate = errors(evaluations["followed"], exact)
    nearing = pd.DataFrame(
        [
            {"scene": name, "path": label, "off the judge, median, mm": np.median(left), "largest, mm": left.max()}
            for label, evaluation in evaluations.items()
            if label != "tightest"
            for left in [errors(evaluation, exact)[0]]
        ]
    )
    _, *forces = force_errors(model, evaluations["followed"], exact)
    return pd.DataFrame(rows), true.ravel(), estimate.ravel(), nearing, *(each.ravel() for each in forces)


def fall(nearing, counts):
    """Factor by which the median distance from the reference falls for each doubling of the increments.

    The smallest over the scenes: 2 for a method of first order, 1 without convergence to the reference. Distances below
    :data:`ROUNDING` count as converged.
    """
    left = nearing.set_index(["path", "scene"])["off the judge, median, mm"]
    coarsest, finest = (left[f"{count} increments"] for count in (counts[0], counts[-1]))
    factors = (coarsest / finest) ** (1 / np.log2(counts[-1] / counts[0]))
    return float(factors.where(finest > ROUNDING, np.inf).min())


def closed_forms(context):
    """All closed forms with default settings and with equal steps."""
    return pd.DataFrame(
        [
            {"case": case.name, "piecewise linear": case.linear, "followed": error(case, Followed())}
            | {f"{steps} steps": error(case, Followed(steps=steps)) for steps in STEPS}
            | {"16 increments": error(case, Increments(16))}
            for case in CASES
        ]
    )


def reversal(context):
    """The layered cantilever, loaded to twice its slip load and unloaded: followed path, or directly to the end."""
    leaves = Leaves(size=5.0, columns=20)
    loads = np.array([2.0, 0.0]) * leaves.slip_load
    skipped = deflections(leaves, context, loads[1:] + 1e-9 * leaves.slip_load)
    plain = deflections(leaves, context, loads, increments=64)
    return leaves.exact(loads), plain, deflections(leaves, context, loads), skipped


@dataclass(frozen=True)
class Route:
    """One sample of the lap joint by one method: results by quantity and stage."""

    measurements: np.ndarray
    arrays: dict[str, np.ndarray]

    @classmethod
    def of(cls, measurements, resolutions) -> Route:
        """Forces, displacements, slip and work of every stage; the reduced model has them for each sample."""
        arrays = {}
        for stage, one in resolutions.items():
            arrays[f"force, {stage}"] = np.reshape(one.force, (-1, 3))
            arrays[f"displacement, {stage}"] = np.reshape(one.displacement, (-1, 3))
            arrays[f"slip, {stage}"] = np.reshape(one.trace.slip, (-1, 2))
            arrays[f"work, {stage}"] = np.ravel(one.trace.work)
        return cls(measurements, arrays)

    def off(self, truth: Route) -> dict[str, float]:
        """Relative differences from another."""
        differences = {name: relative(self.arrays[name], value) for name, value in truth.arrays.items()}
        return {"key characteristics": relative(self.measurements, truth.measurements)} | differences


def one_lap_joint(scene=None):
    """The lap joint for both methods, and its sample."""
    scene = shipped("lap_joint", "coarse") if scene is None else scene
    return scene, draw(scene, 5, 0, 1)


def in_full(context, tolerance=None, scene=None) -> Route:
    """Solve by full finite elements with an extrapolated path of a given tolerance; in the quick version its many steps
    go by the condensed route, at a quarter of the cost."""
    scene, deviations = one_lap_joint(scene)
    route = "condensed" if context.quick and tolerance is not None else "whole"
    options = {"route": route} if tolerance is None else {"route": route, "path_tolerance": tolerance}
    found = FullModel(assemble(scene, context.cache), comm=MPI.COMM_SELF, **options).evaluate(deviations[0])
    return Route.of(found.measurements, found.resolutions)


def reduced(context, path=None, scene=None) -> Route:
    """Solve by the reduced model."""
    scene, deviations = one_lap_joint(scene)
    found = evaluate(context.model(scene), deviations, path)
    return Route.of(found.measurements[0], found.resolutions)


def full_tasks(context, tolerances, floors):
    """Solves for :func:`against_full` by method and path, the longest first."""
    tasks = {
        ("full finite elements", f"extrapolated to {mm:.0e} mm"): partial(in_full, context, mm)
        for mm in reversed(tolerances)
    }
    for mm in reversed(floors):
        path = Followed(100 * mm, 0.01)
        tasks["reduced model", f"followed to {mm:.0e} mm"] = partial(reduced, context, path)
    tasks["reduced model", "followed"] = partial(reduced, context, Followed())
    for path, count in STATED:
        same = with_path(shipped("lap_joint", "coarse"), path, count)
        label = path if count is None else f"{count} {path}"
        tasks["in full", label] = partial(in_full, context, scene=same)
        tasks["reduced", label] = partial(reduced, context, scene=same)
    return tasks


def against_full(routes):
    """Compare both methods on the lap joint: ever finer paths against the finest full solve, and equal increments."""
    truth = routes[next(iter(routes))]
    rows = [
        {"route": route, "path": path} | routes[route, path].off(truth)
        for route, path in reversed(routes)
        if route in ("full finite elements", "reduced model")
    ]
    for path, count in STATED:
        label = path if count is None else f"{count} {path}"
        off = routes["reduced", label].off(routes["in full", label])
        kept = {name: value for name, value in off.items() if not name.startswith(("slip", "work"))}
        rows.append({"route": "one against the other", "path": label} | kept)
    return pd.DataFrame(rows)


def _on_scenes(table, nearing, counts, samples) -> list[Finding]:
    """Findings on the shipped scenes: errors of the followed path, of the reference path, and costs."""
    followed = table[table["path"] == "followed"].set_index("scene")
    worst = followed.loc[followed["slip / allowed"].idxmax()]
    doubt = table[table["path"] == "25 times tighter"].set_index("scene")
    doubt["either"] = doubt[["slip / allowed", "key characteristic / allowed"]].max(axis=1)
    return [
        Finding(
            "slip",
            float(followed["slip / allowed"].max()),
            f"Worst: {worst.name}, {worst['worst slip']}. {samples} samples of each scene, coarse, the same for all "
            "paths.",
            picture(table),
            table,
        ),
        Finding("key-characteristic", float(followed["key characteristic / allowed"].max())),
        Finding("force", float(followed["force / allowed"].max())),
        Finding(
            "judge",
            float(doubt["either"].max()),
            "The path 25 times tighter than production's, against the tightest: "
            + ", ".join(f"{name.replace('_', ' ')} {value:.2g}" for name, value in doubt["either"].items())
            + ".",
        ),
        Finding("nearing", fall(nearing, counts), table=nearing),
        *(Finding(f"cost-{name}", float(followed.loc[name, "times one increment"])) for name in SCENES),
    ]


def _coverage(true, estimate) -> Finding:
    """Finding on the share of samples whose estimate covers their error."""
    seen = true > ROUNDING
    over = estimate[seen] / true[seen]
    return Finding(
        "coverage",
        float((true <= estimate + ROUNDING).mean()),
        f"{len(true)} ends of stages; where the error exceeds {1e6 * ROUNDING:g} nm, the estimate is "
        f"{np.median(over):.3g} times as large in the median, {over.min():.2g} times at least."
        if len(over)
        else f"No error exceeds {1e6 * ROUNDING:g} nm.",
    )


def _in_closed_form(cases, exact, plain, found, skipped) -> list[Finding]:
    """Findings on paths with a closed form, and on the layered cantilever."""
    orders = np.array([cases[f"{n} steps"].iloc[0] for n in STEPS])
    return [
        Finding(
            "order",
            float((orders[:-1] / orders[1:]).min()),
            f"The tractrix by {STEPS[0]} to {STEPS[-1]} steps.",
            table=cases,
        ),
        Finding("linear", float(cases.loc[cases["piecewise linear"], "followed"].max())),
        Finding("curved", float(cases.loc[~cases["piecewise linear"], "followed"].max())),
        Finding("cantilever", float(np.abs(found - plain).max() / np.abs(exact).max())),
        Finding(
            "reversal",
            float(abs(skipped[-1] - exact[-1]) / abs(exact[-1])),
            f"Residual deflection {exact[-1]:.3g} mm; {skipped[-1]:.2g} mm if the load path has no reversal.",
        ),
    ]


def _of_both_routes(full, floor) -> list[Finding]:
    """Reduced model against full finite elements, each on a fine path of its own method, and on equal increments."""
    last_full = full[full["path"].str.startswith("extrapolated")]
    last_reduced = full[full["path"] == f"followed to {floor:.0e} mm"]
    compared = [name for name in full.columns if name not in ("route", "path") and not name.startswith("work")]
    same = full[full["route"] == "one against the other"].dropna(axis=1)
    return [
        Finding(
            "full",
            float(last_reduced[compared].max().max()),
            f"The last refinement of the full solve changes it by {last_full[compared].iloc[-2].max():.1e}.",
            table=full,
        ),
        Finding("same", float(same[[name for name in same.columns if name not in ("route", "path")]].max().max())),
    ]


def run(context):
    counts = (64, 256) if context.quick else (64, 128, 256, 512)
    samples = 12 if context.quick else 40
    models = {name: context.model(shipped(name, "coarse")) for name in SCENES}
    tolerances, floors = (QUICK_FULL, QUICK_REDUCED) if context.quick else (FULL, REDUCED)
    paths = paths_of(counts)

    def follow(name, label):
        """Many increments are compared with the reference on fewer samples."""
        model = models[name]
        number = FEW if isinstance(paths[label], Increments) and label != "1 increments" else samples
        return Gone.of(evaluate(model, draw(model.scene, SEED, 0, number), paths[label]))

    cells = [(name, label) for label in reversed(paths) for name in reversed(SCENES)]  # the longest first
    routes = full_tasks(context, tolerances, floors)
    tasks = [
        *routes.values(),
        *(partial(follow, *cell) for cell in cells),
        lambda: closed_forms(context),
        lambda: reversal(context),
    ]
    *gone, cases, (exact, plain, found, skipped) = context.team.map(lambda task: task(), tasks)
    full = against_full(dict(zip(routes, gone[: len(routes)], strict=True)))
    by_cell = dict(zip(cells, gone[len(routes) :], strict=True))
    scenes = [
        on_scene(name, model, {label: by_cell[name, label] for label in paths}, counts)
        for name, model in models.items()
    ]
    table, nearing = (pd.concat([part[i] for part in scenes], ignore_index=True) for i in (0, 3))
    true, estimate, force, bound = (np.concatenate([part[i] for part in scenes]) for i in (1, 2, 4, 5))
    return [
        *_on_scenes(table, nearing, counts, samples),
        _coverage(true, estimate),
        Finding("force-coverage", float((force <= bound + 1e-9 * force.max()).mean())),
        *_in_closed_form(cases, exact, plain, found, skipped),
        *_of_both_routes(full, floors[-1]),
    ]


def picture(table):
    """Figure of error against cost of increments and of the followed path."""
    figure, axes = panels(2, width=4.6)
    for axis, quantity in zip(axes, ("slip / allowed", "key characteristic / allowed")):
        for name, own in table.groupby("scene", sort=False):
            plain, followed = own[own["path"].str.match(r"\d+ increments")], own[own["path"] == "followed"]
            (line,) = axis.loglog(plain["times one increment"], plain[quantity], "o-", label=name.replace("_", " "))
            axis.loglog(followed["times one increment"], followed[quantity], "*", ms=14, color=line.get_color())
        axis.axhline(1, color="0.5", lw=1, ls=":")
        axis.set(xlabel="cost in single increments", title=quantity)
    axes[0].set_ylabel("largest difference of a mean or 6σ / allowed error")
    axes[0].legend(title="○ increments, ★ followed", fontsize=8)
    return figure


COST = {
    "lap_joint": "Set before the method was chosen; contacts close and stay.",
    "hat_on_plate": "The same; contacts close in groups.",
    "wheelhouse": "The same; contacts slide.",
}

STUDY = Study(
    order=30,
    title="Path",
    claim=(
        "The default path keeps means, 6σ and forces within measurement accuracy, estimates the error of each sample, "
        "and agrees with the path of the full finite elements, which use another method."
    ),
    reference=(
        "The same path ever tighter, approached by increments; closed forms of one and two contacts and of the "
        "layered cantilever; full finite elements with an extrapolated path."
    ),
    acceptance=(
        Acceptance(
            "slip",
            (
                "Mean and 6σ of zone slip and tangential displacement against a path 250 times tighter: largest "
                "difference over the larger of 1 % and 2 µm."
            ),
            1.0,
            reason=(
                "1 % is a sixth of the uncertainty of 500 samples; 2 µm is the resolution of a coordinate measuring "
                "machine."
            ),
        ),
        Acceptance(
            "key-characteristic",
            "Mean and 6σ of key characteristics: largest difference over the larger of 0.5 % of 6σ and 2 µm.",
            1.0,
            reason=(
                "0.5 % is a twelfth of the uncertainty of 500 samples; 2 µm is the resolution of a coordinate "
                "measuring machine."
            ),
        ),
        Acceptance(
            "force",
            (
                "Mean sums of normal and friction forces of the zones: largest difference over 1 % of the sum or, if "
                "that is larger, of the largest force."
            ),
            1.0,
            reason="Printed forces are as exact as printed slips: a sixth of the uncertainty of 500 samples.",
        ),
        Acceptance(
            "judge",
            "Error of the reference path: difference of the two tightest paths, the same ratio.",
            0.2,
            reason="A reference errs by at most a fifth of the limit.",
        ),
        Acceptance(
            "nearing",
            (
                "Factor by which the median distance of contact positions from the reference falls for each doubling "
                "of the increments."
            ),
            1.5,
            bound="at least",
            reason="Theory: 2; √2 would be another order.",
        ),
        *(
            Acceptance(
                f"cost-{name}",
                f"Factorisations of the followed path over those of one increment a step, {name.replace('_', ' ')}.",
                limit,
                reason=COST[name],
            )
            for name, limit in SCENES.items()
        ),
        Acceptance(
            "force-coverage",
            "Share of stage ends at which a sample's own estimate covers the error of its contact forces.",
            0.95,
            bound="at least",
            reason="The estimate is stated as a bound for 95 % of samples.",
        ),
        Acceptance(
            "coverage",
            "Share of stage ends at which a sample's own estimate covers the error of its contact positions.",
            0.95,
            bound="at least",
            reason="It is reported as a 95 % bound.",
        ),
        Acceptance(
            "order",
            "Around a corner: error before over error after each halving of the steps, from 8 on.",
            3.5,
            bound="at least",
            reason="Theory: 4; 3.5 is order 1.8.",
        ),
        Acceptance(
            "linear",
            (
                "Piecewise linear paths (closing while moving, load reversal, two contacts in series): error over "
                "the path length."
            ),
            1e-8,
            reason="Rounding: straight pieces have no other error.",
        ),
        Acceptance(
            "curved",
            "Around a corner and on an arc with default settings: error over the path length.",
            1e-3,
            reason="Four times the tolerance of a step, 2.5e-4.",
        ),
        Acceptance(
            "cantilever",
            (
                "Layered cantilever, loading and unloading, against 64 increments each way: difference over the "
                "largest deflection."
            ),
            1e-3,
            reason="A third of the mesh error allowed against the closed form, 0.003.",
        ),
        Acceptance(
            "reversal",
            "Share of the deflection retained by friction that a load without its reversal loses.",
            0.9,
            bound="at least",
            reason="Theory: all of it; a tenth is granted.",
        ),
        Acceptance(
            "full",
            (
                "Both routes with fine paths of their own methods on the lap joint: largest relative difference of "
                "forces, gaps, displacements, slips and key characteristics."
            ),
            1e-6,
            quick=1e-3,
            reason="Less than a hundredth of the step tolerance, 2.5e-4.",
        ),
        Acceptance(
            "same",
            "Both routes with the same increments, or in one step: the same difference.",
            1e-8,
            reason="Rounding of a solve, 1e-8.",
        ),
    ),
    seconds=(690, 45),
    run=run,
)
