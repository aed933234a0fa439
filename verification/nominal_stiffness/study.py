"""Error of the nominal stiffness, which the method of influence coefficients uses for all deviated parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from mpi4py import MPI

from fem_reference.full.model import ContactFailure, FullModel
from mic.process.model import ReducedModel
from mic.process.stiffness_choice import LIMIT, choose_stiffness
from mic.statistics.draw import draw
from verification.comparison import difference, reduced_and_assembly, reduced_model, relative, zone_slip
from verification.plots import panels
from verification.scenes import shipped, with_path
from verification.stiffness import DeviatedStiffness
from verification.study import Acceptance, Finding, Study

CASES = (("lap_joint", "coarse", "coarse"), ("hat_on_plate", 12.0, None), ("wheelhouse", "coarse", None))
DEVIATIONS = (0.1, 1.0, 10.0)  # mm, largest displacement of the shape, and that up to which `auto` is nominal
TYPICAL = 1.0  # mm, of a stamped part
SYSTEMATIC = ("lap_joint", "hat_on_plate")  # assemblies whose parts have a mean shape deviation
SHAPES = ((0.25, 0.0625), (1.0, 0.25), (0.0, 0.7))  # mm, largest displacement of the mean shape, and of the scatter
SAMPLES, QUICK_SAMPLES = 12, 4
TIGHT = 1e-12  # contact tolerance of the reduced model for the comparison of rounding
JUDGED = ("key characteristics", "normal force", "zone slip")


def scaled(assembly, full, size):
    """Shape deviations of the first sample, scaled to a largest displacement of `size` mm; no other deviations."""
    scene = assembly.scene
    shaped = np.array([deviation.kind == "force" for deviation in scene.deviations])
    deviations = np.where(shaped, draw(scene, scene.monte_carlo.seed, 0, 1)[0], 0.0)
    fields = full.shape_fields(deviations)
    return deviations * size / max(np.linalg.norm(field[:, :3], axis=1).max() for field in fields.values())


def stretching(assembly, full) -> float:
    """Bound on the effect of geometric nonlinearity: membrane energy omitted by linear kinematics over strain energy.

    In each flat triangle, with ∇w the gradient of the normal displacement without the rigid motion of the part, the von
    Kármán strain ½ ∇w ⊗ ∇w adds to the linear membrane strain. The energy of this part alone,

        U = Σ ½ A ε : D : ε,      ε = ½ ∇w ⊗ ∇w,      D = E t/(1 − ν²) [plane stress],

    is computed for the linear displacement. A plate that can move in its plane stores much less, so this is a bound.
    """
    stage = next(iter(full.resolutions))
    added, fields = 0.0, full.field(stage)
    for part in assembly.parts:
        x, triangles = part.surface.points, part.surface.triangles
        u = _without_rigid_motion(x, fields[part.name][:, :3])
        a, b = x[triangles[:, 1]] - x[triangles[:, 0]], x[triangles[:, 2]] - x[triangles[:, 0]]
        normal = np.cross(a, b)
        double_area = np.linalg.norm(normal, axis=1)
        normal /= double_area[:, None]
        w = np.einsum("tij,tj->ti", u[triangles], normal)
        gradient = (
            (w[:, 1] - w[:, 0])[:, None] * np.cross(b, normal) + (w[:, 2] - w[:, 0])[:, None] * np.cross(normal, a)
        ) / double_area[:, None]
        square = (gradient**2).sum(
            axis=1
        )  # ε has the single non-zero eigenvalue ½|∇w|², so ε : D : ε = E t/(1 − ν²) (½|∇w|²)²
        added += float(
            (0.5 * double_area / 2 * part.young * part.thickness / (1 - part.poisson**2) * (0.5 * square) ** 2).sum()
        )
    return added / full.strain_energy(stage)


def _without_rigid_motion(x, u):
    """(n, 3) displacements minus the best-fit rigid motion (translation and small rotation)."""
    r = x - x.mean(axis=0)
    skew = np.zeros((len(x), 3, 3))
    skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = r[:, 2], -r[:, 1], r[:, 0]
    skew -= skew.transpose(0, 2, 1)
    modes = np.concatenate([np.tile(np.eye(3), (len(x), 1, 1)), skew], axis=2).reshape(3 * len(x), 6)
    return (u.ravel() - modes @ np.linalg.lstsq(modes, u.ravel(), rcond=None)[0]).reshape(-1, 3)


def compare(built, nominal, size) -> dict:
    """The reduced model against full solves on deviated meshes and on the nominal one, one size of deviation."""
    model, assembly = built
    deviations = scaled(assembly, nominal, size)
    reduced = model.evaluate(deviations, "coulomb")
    row = {"deviation, mm": size}
    try:
        deviated = FullModel(assembly, deviated=True, comm=MPI.COMM_SELF).evaluate(deviations)
        flat = nominal.evaluate(deviations)
    except ContactFailure as problem:
        return row | {"failure": str(problem)}
    off = difference(reduced, 0, deviated)
    stage, zones = next(iter(deviated.resolutions)), len(assembly.scene.zones)
    mine, truth = (
        zone_slip(d, assembly.contacts, zones)
        for d in (reduced.resolutions[stage].displacement[0], deviated.resolutions[stage].displacement)
    )
    normal = max(
        relative(reduced.resolutions[name].force[0, :, 0], resolution.force[:, 0])
        for name, resolution in deviated.resolutions.items()
    )
    return row | {
        "measurement": off.measurement,
        "measurement, mm": float(np.abs(reduced.measurements[0] - deviated.measurements).max()),
        "force": off.force,
        "normal force": normal,
        "zone slip": float(np.abs(mine - truth).max() / truth.max()),
        "zone slip, mm": float(np.abs(mine - truth).max()),
        "changed states": off.states,
        "same mesh": difference(model.process("coulomb", tol=TIGHT).evaluate(deviations[None]), 0, flat).largest,
        "same mesh, as runs are": difference(reduced, 0, flat).largest,
        "stretching": stretching(assembly, flat),
        "route": deviated.route,
        "failure": "",
    }


def with_deviations(assembly, stiffness, mean, sigma):
    """The assembly with deviations of these means (p,) and standard deviations (p,) and this ``stiffness``."""
    items = [
        item.model_copy(update={"mean": float(m), "sigma": float(s)})
        for item, m, s in zip(assembly.scene.deviations, mean, sigma)
    ]
    return replace(assembly, scene=assembly.scene.model_copy(update={"deviations": items, "stiffness": stiffness}))


def followed(assembly, stiffness, mean, sigma, cache) -> ReducedModel:
    """The model of such an assembly."""
    return reduced_model(with_deviations(assembly, stiffness, mean, sigma), cache)


def largest_nominal(built, nominal) -> float:
    """Largest displacement of the first sample's shape, mm, up to which ``auto`` uses the nominal stiffness."""
    model, assembly = built
    shape = scaled(assembly, nominal, 1.0)
    return LIMIT / choose_stiffness(with_deviations(assembly, "auto", shape, 0 * shape), model).deviation


def systematic(built, size, spread, samples, cache) -> list[dict]:
    """Errors of three stiffnesses against the stiffness of each sample's shape, for shapes with a mean deviation.

    The shapes of the scene's mean are scaled until the largest displacement is `size` mm. The samples' shapes scatter
    about it as in the scene, scaled to a root mean square of `spread` mm; other deviations are zero. The stiffnesses
    are those of scenes with these means and standard deviations; ``auto`` marks the one that such a scene uses.
    """
    model, assembly = built
    stiffness = DeviatedStiffness(assembly, model)
    shaping, scene = stiffness.shaping(), assembly.scene
    mean = np.where(shaping, model.deviations({})[0], 0.0)
    about = np.where(shaping, draw(scene, scene.monte_carlo.seed, 0, samples) - mean, 0.0)
    mean *= size / stiffness.largest(mean)
    about *= spread / np.sqrt(np.mean([stiffness.largest(one) ** 2 for one in about]))
    sigma = about.std(axis=0)
    chosen = choose_stiffness(with_deviations(assembly, "auto", mean, sigma), model).stiffness
    models = {"nominal": model} | {
        name: followed(assembly, name, mean, sigma, cache) for name in ("mean", "first-order")
    }
    found: dict[str, list] = {name: [] for name in ("own", *models)}
    for sample in mean + about:
        for name, one in zip(found, (stiffness.at(sample), *models.values())):
            found[name].append(_judged(one, assembly, sample))
    truth = {what: np.array([one[what] for one in found["own"]]) for what in JUDGED}
    rows = []
    for name in models:
        row = {"mean shape, mm": size, "scatter, mm": spread, "stiffness": name, "auto": name == chosen}
        for what in JUDGED:
            value, true = np.array([one[what] for one in found[name]]), truth[what]
            scale, deviation = np.abs(true).max(), true.std(axis=0, ddof=1)
            row |= {
                what: float(np.sqrt(np.mean((value - true) ** 2, axis=0)).max() / scale),
                f"mean of {what}": float(np.abs(value.mean(axis=0) - true.mean(axis=0)).max() / scale),
                f"6σ of {what}": float(np.abs(value.std(axis=0, ddof=1) - deviation).max() / deviation.max()),
                f"{what}, largest": float(scale),
            }
        rows.append(row)
    return rows


def _judged(model, assembly, sample) -> dict[str, np.ndarray]:
    """Compared results of samples: key characteristics, mm; normal forces of all stages, N; slips of the zones, mm."""
    made = model.evaluate(sample, "coulomb")
    zones = len(assembly.scene.zones)
    return {
        "key characteristics": made.measurements[0],
        "normal force": np.concatenate([one.force[0, :, 0] for one in made.resolutions.values()]),
        "zone slip": np.concatenate(
            [zone_slip(one.displacement[0], assembly.contacts, zones) for one in made.resolutions.values()]
        ),
    }


def _differences(solved: pd.DataFrame):
    """Figure of the differences against the deviation, a panel for each quantity."""
    figure, axes = panels(4, 3.7)
    for axis, quantity in zip(axes, ("measurement", "force", "zone slip", "stretching")):
        for name, own in solved.groupby("assembly", sort=False):
            axis.loglog(own["deviation, mm"], own[quantity], "o-", ms=4, lw=1, label=name.replace("_", " "))
        axis.set(
            xlabel="largest shape deviation, mm",
            title="added membrane energy, relative" if quantity == "stretching" else f"{quantity}, relative difference",
        )
    axes[0].legend()
    return figure


def run(context):
    cases = [
        (name, quick if context.quick else size)
        for name, size, quick in CASES
        if not context.quick or quick is not None
    ]
    scenes = {name: with_path(shipped(name, size), "increments", 1) for name, size in cases}
    built = {name: reduced_and_assembly(scene, context.cache) for name, scene in scenes.items()}
    shapes = [
        (name, *shape)
        for name in (SYSTEMATIC[:1] if context.quick else SYSTEMATIC)
        for shape in (SHAPES[1:2] if context.quick else SHAPES)
    ]
    samples = QUICK_SAMPLES if context.quick else SAMPLES
    found = context.team.map(lambda item: systematic(built[item[0]], *item[1:], samples, context.cache), shapes)
    means = pd.DataFrame([{"assembly": name} | row for (name, *_), own in zip(shapes, found) for row in own])
    nominal = {name: FullModel(assembly, comm=MPI.COMM_SELF) for name, (_, assembly) in built.items()}
    kept = {name: largest_nominal(built[name], nominal[name]) for name, _ in cases}
    items = [(name, size) for name, _ in cases for size in sorted({kept[name], *DEVIATIONS})]
    rows = pd.DataFrame(
        [
            {"assembly": name} | row
            for (name, _), row in zip(
                items, context.team.map(lambda i: compare(built[i[0]], nominal[i[0]], i[1]), items)
            )
        ]
    )
    solved = rows[rows["failure"] == ""]
    least, typical, large = (
        solved[solved["deviation, mm"] == size] for size in (min(DEVIATIONS), TYPICAL, max(DEVIATIONS))
    )
    limit = solved[solved["deviation, mm"] == solved["assembly"].map(kept)]
    orders = {
        name: np.polyfit(np.log(own["deviation, mm"]), np.log(own["measurement, mm"]), 1)[0]
        for name, own in solved[solved["deviation, mm"] <= TYPICAL].groupby("assembly", sort=False)
        if len(own) > 1
    }

    def each(table, column, form):
        return ", ".join(f"{row['assembly'].replace('_', ' ')} {row[column]:{form}}" for _, row in table.iterrows())

    return [
        Finding(
            "measurement",
            limit["measurement"].max() if len(limit) == len(cases) else np.nan,
            f"At {each(limit, 'deviation, mm', '.2f')} mm: {each(limit, 'measurement', '.2%')}. At {TYPICAL} mm: "
            f"{each(typical, 'measurement', '.2%')}. At {max(DEVIATIONS)} mm: "
            f"{each(large, 'measurement', '.1%')}. Forces at {TYPICAL} mm: {each(typical, 'force', '.1%')}, their "
            f"normal parts: {each(typical, 'normal force', '.1%')}; zone slips: {each(typical, 'zone slip', '.1%')}. "
            f"{(rows['failure'] != '').sum()} of {len(rows)} pairs of full solves failed; routes: "
            f"{', '.join(sorted(set(solved['route'])))}.",
            _differences(solved),
            rows,
        ),
        Finding(
            "growth",
            min(orders.values()),
            "Observed: "
            + ", ".join(f"{n.replace('_', ' ')} {o:.2f}" for n, o in orders.items())
            + f". Differences at {TYPICAL} mm: {each(typical, 'measurement, mm', '.2g')} mm.",
        ),
        Finding(
            "same-mesh",
            solved["same mesh"].max(),
            (
                "What is left when the full solve keeps the nominal mesh: the differences above come from the geometry "
                f"alone. The reduced model's contacts are solved to {TIGHT:.0e} here; as runs solve them, "
                f"{solved['same mesh, as runs are'].max():.1e} is left."
            ),
        ),
        Finding(
            "stretching",
            least["stretching"].max(),
            f"At {min(DEVIATIONS)} mm. At {TYPICAL} mm: {each(typical, 'stretching', '.1%')}; at {max(DEVIATIONS)} mm: "
            f"{each(large, 'stretching', '.1%')}. The bound takes the linear displacement as it is and adds the "
            "membrane energy of the rotations' squares; a real sheet gives way in its plane, so the truth is less.",
        ),
        _auto(means),
        Finding("first-order", ratios(means, "first-order").max(axis=None), "In the same cases."),
    ]


def _auto(means) -> Finding:
    """Errors of key characteristics and of their 6σ with the stiffness that ``auto`` uses."""
    chosen = means[means["auto"]]
    worst = chosen[["key characteristics", "6σ of key characteristics"]].max(axis=None)
    columns = chosen[["assembly", "mean shape, mm", "scatter, mm", "stiffness"]].itertuples(index=False)
    used = "; ".join(f"{name.replace('_', ' ')}, {m:g} ± {s:g} mm: {stiffness}" for name, m, s, stiffness in columns)
    return Finding("auto", float(worst), f"Used: {used}. {_told(means)}", None, means)


def ratios(means, name) -> pd.DataFrame:
    """Errors of a stiffness over those of the nominal one, a row for each assembly and mean shape but zero."""
    table = means[means["mean shape, mm"] > 0].set_index(["assembly", "mean shape, mm"])
    own, nominal = (table[table["stiffness"] == one][list(JUDGED)] for one in (name, "nominal"))
    return own / nominal


def _told(means) -> str:
    """Sentences: errors at the largest mean shape, and the ratio to the nominal stiffness's error over all cases."""
    last = means[means["mean shape, mm"] == means["mean shape, mm"].max()]
    sentences = [
        f"{row['assembly'].replace('_', ' ')}, {row['stiffness']}: "
        + ", ".join(f"{what} {row[what]:.2%} (6σ {row[f'6σ of {what}']:.2%})" for what in JUDGED)
        for _, row in last.iterrows()
    ]
    left = {name: ratios(means, name) for name in ("mean", "first-order")}
    return (
        f"At {last['mean shape, mm'].iloc[0]} mm, of the largest value: {'; '.join(sentences)}. Left of the nominal "
        "stiffness's error over all cases: "
        + "; ".join(
            f"{name}: " + ", ".join(f"{what} {one[what].min():.2f} to {one[what].max():.2f}" for what in JUDGED)
            for name, one in left.items()
        )
        + "."
    )


STUDY = Study(
    order=60,
    title="Nominal stiffness",
    claim=(
        "One stiffness, that of the nominal mesh, serves parts that deviate by up to a quarter of their thickness; "
        "beyond, stiffness = auto uses another one."
    ),
    reference=(
        "Full frictional contact finite elements on meshes that carry the deviated shape, with its stiffness, "
        "normals and gaps; deviations of 0.1 … 10 mm."
    ),
    acceptance=(
        Acceptance(
            "measurement",
            "Key characteristics at the largest deviation with which `auto` uses the nominal stiffness: largest "
            "relative difference.",
            0.1,
            reason="The tenth that the error budget allows in total.",
        ),
        Acceptance(
            "growth",
            "Lowest observed order of the differences of key characteristics (mm) in the deviation.",
            0.8,
            bound="at least",
            reason="Theory: 1; 0.8 is nearer to it than to one half.",
        ),
        Acceptance(
            "same-mesh",
            (
                "Full solve against the reduced model on the nominal mesh, contacts solved to 1e-12: largest "
                "relative difference."
            ),
            1e-7,
            reason="Ten times the rounding of the two routes, 1e-8.",
        ),
        Acceptance(
            "stretching",
            (
                "Geometric nonlinearity at 0.1 mm: bound on the membrane energy that linear kinematics omits, over "
                "the strain energy."
            ),
            0.1,
            reason="The tenth that the error budget allows in total.",
        ),
        Acceptance(
            "auto",
            "Key characteristics and their 6σ with the stiffness that `auto` uses, for shapes with mean and scatter "
            "or with scatter only: largest error relative to the largest value.",
            0.1,
            reason="The tenth that the error budget allows in total.",
        ),
        Acceptance(
            "first-order",
            "Stiffness of the mean shape with first derivatives along the sources: largest error of key "
            "characteristics, forces and slips over that of the nominal stiffness, for shapes with a mean.",
            1 / 3,
            reason="A method that leaves more than a third of the error is not worth its cost.",
        ),
    ),
    seconds=(920, 15),
    memory=3.2,
    run=run,
)
