"""Friction depends on the path: how many load increments does a stage need?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from mpi4py import MPI

from fem_reference.full.model import FullModel
from mic.model.assembly import assemble
from mic.process.process import Process
from mic.sampling.draw import draw
from verification.analytic.leaves import Leaves, deflections
from verification.plots import panels
from verification.scenes import shipped
from verification.study import Acceptance, Finding, Study

SCENES = ("lap_joint", "hat_on_plate", "wheelhouse")


def with_increments(scene, count):
    """The scene with its stages that resolve contact cut into `count` increments each."""
    return scene.model_copy(
        update={
            "stages": [
                stage.model_copy(update={"increments": count}) if stage.kind in ("clamp", "weld", "release") else stage
                for stage in scene.stages
            ]
        }
    )


def rms_slip(model, resolution):
    """(n, zones) RMS slip of each zone, mm."""
    square = (resolution.displacement[:, :, 1:] ** 2).sum(-1)
    return np.column_stack(
        [np.sqrt(square[:, model.contacts.zone == z].mean(1)) for z in range(len(model.scene.zones))]
    )


def differences(model, found, reference):
    """Differences of one evaluation from another, relative to the reference's scale, one row per stage."""
    spread = 6 * reference.measurements.std(axis=0, ddof=1)
    rows = []
    for stage, exact in reference.resolutions.items():
        resolution = found.resolutions[stage]
        slip, exact_slip = rms_slip(model, resolution), rms_slip(model, exact)
        rows.append(
            {
                "stage": stage,
                "force": np.linalg.norm(resolution.force - exact.force) / np.linalg.norm(exact.force),
                "zone slip": (np.abs(slip - exact_slip).mean(0) / exact_slip.mean(0).max()).max(),
                "changed states": (resolution.state != exact.state).mean(),
                "key characteristic / 6σ": (np.abs(found.measurements - reference.measurements).max(0) / spread).max(),
            }
        )
    return rows


def refine(context, name, counts, samples):
    """One scene under each number of increments, against the largest."""
    scene = shipped(name, "coarse")
    model = context.model(scene)
    deviations = draw(scene, 3, 0, samples)
    found = []
    for count in counts:
        evaluation = Process(replace(model, scene=with_increments(scene, count)), "coulomb").evaluate(deviations)
        if evaluation.failed.any():
            raise ArithmeticError(f"{name} with {count} increments: {evaluation.failed.sum()} samples failed")
        found.append(evaluation)
    return pd.DataFrame(
        [
            {"scene": name, "increments": count} | row
            for count, evaluation in zip(counts[:-1], found)
            for row in differences(model, evaluation, found[-1])
        ]
    )


def reversal(context):
    """The layered cantilever loaded to twice its slip load and unloaded, each way in one step or many, or straight to
    the end."""
    leaves = Leaves(size=5.0, columns=20)
    loads = np.array([2.0, 0.0]) * leaves.slip_load
    exact = leaves.exact(loads)
    found = {}
    for count in (1, 16):
        found[count] = deflections(leaves, context, loads, increments=count)
    skipped = deflections(leaves, context, loads[1:] + 1e-9 * leaves.slip_load)
    return exact, found, skipped


def against_full(context, counts):
    """Forces of the reduced model and of the full finite elements on the coarse lap joint, for each number of
    increments."""
    rows = []
    for count in counts:
        scene = with_increments(shipped("lap_joint", "coarse"), count)
        assembly = assemble(scene, context.cache)
        deviations = draw(scene, 3, 0, 1)
        full = FullModel(assembly, comm=MPI.COMM_SELF).evaluate(deviations[0])
        reduced = context.model(scene).evaluate(deviations)
        for stage, resolution in full.resolutions.items():
            own = reduced.resolutions[stage].force[0]
            rows.append(
                {
                    "increments": count,
                    "stage": stage,
                    "largest force, N": np.abs(resolution.force).max(),
                    "force: reduced - full, relative": np.linalg.norm(own - resolution.force)
                    / np.linalg.norm(resolution.force),
                }
            )
    return pd.DataFrame(rows)


def run(context):
    counts = (1, 2, 4, 8, 16, 32) if context.quick else (1, 2, 4, 8, 16, 32, 64)
    samples = 8 if context.quick else 20
    tasks = [lambda name=name: refine(context, name, counts, samples) for name in SCENES]
    tasks += [lambda: reversal(context), lambda: against_full(context, (1, 4) if context.quick else (1, 2, 4, 8, 16))]
    *tables, (exact, found, skipped), full = context.team.map(lambda task: task(), tasks)
    table = pd.concat(tables, ignore_index=True)

    figure, axes = panels(3, width=4.0)
    for axis, quantity in zip(axes, ("force", "zone slip", "key characteristic / 6σ")):
        for (name, stage), group in table.groupby(["scene", "stage"], sort=False):
            if quantity.startswith("key") and stage != "release":
                continue  # they are measured once, at the end
            axis.loglog(
                group["increments"],
                group[quantity].clip(lower=1e-12),
                "o-" if stage == "clamp" else "s--",
                label=f"{name}, {stage}",
            )
        axis.set(xlabel="increments per stage", title=quantity)
    axes[0].set_ylabel(f"difference from {counts[-1]} increments, relative")
    axes[0].legend(fontsize=7.5)
    one = table[table["increments"] == 1]
    last = table[table["increments"] == counts[-2]]
    worst = one.loc[one["zone slip"].idxmax()]
    rest = deflections_table(exact, found, skipped)
    return [
        Finding(
            "slip",
            float(one["zone slip"].max()),
            f"Worst: {worst['scene']}, stage {worst['stage']}. {samples} samples of each scene. {enough(table)}",
            figure,
            table,
        ),
        Finding(
            "key-characteristic",
            float(one["key characteristic / 6σ"].max()),
            (
                f"Contact forces differ by up to {one['force'].max():.2g} of their norm, "
                f"{one['changed states'].max():.2g} of the contacts change state."
            ),
        ),
        Finding(
            "converged",
            float(last[["force", "zone slip", "key characteristic / 6σ"]].max().max()),
            f"{counts[-2]} increments against {counts[-1]}.",
        ),
        Finding("one-way", float(np.abs(found[1] - found[16]).max() / np.abs(exact).max()), table=rest),
        Finding(
            "reversal",
            float(abs(skipped[-1] - exact[-1]) / abs(exact[-1])),
            (
                f"The leaves keep a deflection of {exact[-1]:.3g} mm; gone straight to the same load they keep "
                f"{skipped[-1]:.2g} mm."
            ),
        ),
        Finding("full", float(full["force: reduced - full, relative"].max()), table=full),
    ]


def enough(table):
    """How many increments keep the zone slip within some per cent, in words."""
    words = []
    for limit in (0.1, 0.05, 0.02):
        needed = []
        for name, group in table.groupby("scene", sort=False):
            worst = group.groupby("increments")["zone slip"].max()
            beyond = worst.index[worst > limit]
            later = worst.index[worst.index > beyond.max()] if len(beyond) else worst.index
            needed.append(f"{name} {later.min()}" if len(later) else f"{name} more than {worst.index.max()}")
        words.append(f"{limit:.0%}: {', '.join(needed)}")
    return "Increments that keep the zone slip within " + "; within ".join(words) + "."


def deflections_table(exact, found, skipped):
    rows = [
        {"path": f"up and back, {count} increments each way", "at the peak, mm": d[0], "after unloading, mm": d[1]}
        for count, d in found.items()
    ]
    rows.append({"path": "closed form", "at the peak, mm": exact[0], "after unloading, mm": exact[1]})
    rows.append({"path": "straight to the last load", "at the peak, mm": np.nan, "after unloading, mm": skipped[-1]})
    return pd.DataFrame(rows)


STUDY = Study(
    order=30,
    title="Path",
    claim=(
        "One step per stage changes slips and key characteristics by no more than the numbers below; a load that "
        "turns round needs a stage for each way."
    ),
    reference=(
        "The same stages cut into many increments; the layered cantilever's closed form; the full finite "
        "elements with the same increments."
    ),
    acceptance=(
        Acceptance(
            "slip",
            (
                "Zone slip by one step per stage against many: largest mean difference over the scene's largest mean "
                "zone slip."
            ),
            0.12,
        ),
        Acceptance(
            "key-characteristic",
            "Key characteristics by one step per stage against many: largest difference over 6σ.",
            0.15,
        ),
        Acceptance(
            "converged",
            (
                "The last halving of the increments changes forces, slips and key characteristics by little: largest "
                "relative change."
            ),
            0.04,
        ),
        Acceptance(
            "one-way",
            (
                "On the layered cantilever, up in one step and back in another agree with many increments: difference "
                "over the largest deflection."
            ),
            1e-3,
        ),
        Acceptance(
            "reversal",
            "A step that skips a reversal loses the deflection that friction keeps: lost share.",
            0.9,
            bound="at least",
        ),
        Acceptance(
            "full",
            (
                "With any number of increments the reduced model follows the full finite elements: largest relative "
                "difference of the forces."
            ),
            1e-6,
        ),
    ),
    seconds=(60, 35),
    run=run,
)
