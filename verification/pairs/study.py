"""Contact pairs of the example scenes against contact at every node of the facing zones, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mic.examples import folder
from mic.model.assembly import assemble
from mic.model.nuggets import nuggets
from mic.scene import Scene, load_scene
from mic.statistics.draw import draw
from mic.statistics.paired_differences import six_sigma_change
from verification.comparison import reduced_model
from verification.plots import panels
from verification.study import Acceptance, Finding, Study

LEAST = 2e-3  # mm: resolution of coordinate measuring machines on sheets
SHARE = 0.05  # of 6σ: less than the uncertainty by 500 samples, 6.2 %
BEYOND = 3.0  # radii of a nugget: within it, sums of nodal forces do not converge
SEED = 777  # seed, not that of the scenes


@dataclass(frozen=True)
class Outcome:
    """Results of samples with one set of pairs.

    Attributes
    ----------
    pairs : int
    nodes : int
        Number of nodes of all meshes.
    measurements : (n, k) array
        Key characteristics, mm; NaN in samples that failed.
    force : (n, s) array
        Sum of the normal forces beyond the nuggets in each stage that resolves contact, N.
    work : (n, z) array
        Work of friction in each zone over all stages, N mm.
    """

    pairs: int
    nodes: int
    measurements: np.ndarray
    force: np.ndarray
    work: np.ndarray


def outcome(scene: Scene, cache, samples: int, every_node: bool, alter=lambda model: model) -> Outcome:
    """Samples of a scene, with its own pairs or one at every node; `alter` may change the model first."""
    assembly = assemble(scene, cache, every_node=every_node)
    model = alter(reduced_model(assembly, cache))
    found = model.evaluate(draw(model.scene, SEED, 0, samples))
    contacts = model.contacts
    beyond = nuggets(scene, contacts.zone, contacts.point, contacts.frame[:, :, 0], BEYOND) < 0
    stages = list(found.resolutions.values())
    work = sum(one.trace.work for one in stages)
    values = found.measurements.astype(float).copy()
    values[found.failed] = np.nan
    return Outcome(
        len(contacts),
        sum(len(part.surface.points) for part in assembly.parts),
        values,
        np.column_stack([one.force[:, beyond, 0].sum(axis=1) for one in stages]),
        np.column_stack([work[:, contacts.zone == z].sum(axis=1) for z in range(len(scene.zones))]),
    )


def compared(name: str, own: Outcome, every: Outcome) -> dict:
    """Errors of a scene's own pairs: key characteristics over the allowed error, forces and work over the largest."""
    kept = np.isfinite(own.measurements).all(axis=1) & np.isfinite(every.measurements).all(axis=1)
    mine, truth = own.measurements[kept], every.measurements[kept]
    six = 6 * truth.std(axis=0, ddof=1)
    allowed = np.maximum(LEAST, SHARE * six)
    means = abs(mine.mean(axis=0) - truth.mean(axis=0))
    changes = [six_sigma_change(x, y) for x, y in zip(truth.T, mine.T)]
    spreads = np.array([abs(change.value) for change in changes])
    worst = int(np.argmax(means / allowed))
    return {
        "scene": name,
        "pairs": own.pairs,
        "every node": every.pairs,
        "nodes of the meshes": f"{own.nodes}, {every.nodes}",
        "samples": int(kept.sum()),
        "mean, µm": 1e3 * means[worst],
        "of 6σ, µm": 1e3 * six[worst],
        "mean": (means / allowed).max(),
        "6σ": (spreads / allowed).max(),
        "6σ, ±": max((change.high - change.value) / one for change, one in zip(changes, allowed)),
        "force": _largest(own.force[kept], every.force[kept]),
        "work": _largest(own.work[kept], every.work[kept]),
    }


def _largest(mine, truth) -> float:
    """Largest difference of means over the largest mean."""
    return float(abs(mine.mean(axis=0) - truth.mean(axis=0)).max() / abs(truth.mean(axis=0)).max())


def scene_of(name: str, size: str | None = None, watched: bool = False) -> Scene:
    """A shipped scene, optionally with another mesh size or with candidates instead of its stated pairs."""
    scene = load_scene(folder(name))
    report = scene.report.model_copy(update={"laws": ["coulomb"], "fields": False})
    change = {"report": report}
    if size:
        change["parts"] = [part.model_copy(update={"size": size}) for part in scene.parts]
    if watched:
        change["zones"] = [zone.model_copy(update={"pairs": None, "points": None}) for zone in scene.zones]
    return scene.model_copy(update=change)


#: Name in the table, the folder, its size, whether candidates replace stated pairs, samples; the last has no limit.
SCENES = (
    ("lap joint", "lap_joint", None, False, 40),
    ("bracket", "bracket", None, False, 40),
    ("hat on plate, coarse", "hat_on_plate", "coarse", False, 20),
    ("wheelhouse, candidates, coarse", "wheelhouse", "coarse", True, 10),
    ("wheelhouse, the paper's 34 pairs a zone, coarse", "wheelhouse", "coarse", False, 10),
)
QUICK = (("lap joint", "lap_joint", None, False, 20),)


def case_row(context, task) -> dict:
    """The row of one scene."""
    name, where, size, watched, samples = task
    scene = scene_of(where, size, watched)
    return compared(name, *(outcome(scene, context.cache, samples, every) for every in (False, True)))


def run(context):
    tasks = QUICK if context.quick else SCENES
    table = pd.DataFrame(context.team.map(lambda task: case_row(context, task), tasks))
    limited = table if context.quick else table.iloc[:-1]
    figure, (axis,) = panels(1, width=7.0, height=0.5 * len(table) + 1.0)
    for shift, (column, limit) in zip((-0.3, -0.1, 0.1, 0.3), LIMITS.items()):
        axis.barh(np.arange(len(table)) + shift, table[column] / limit, height=0.18, label=column)
    axis.axvline(1.0, color="k", lw=1)
    axis.set(xlabel="error over its limit", xscale="log", yticks=np.arange(len(table)))
    axis.set_yticklabels(table["scene"])
    axis.invert_yaxis()
    axis.legend(loc="upper left", bbox_to_anchor=(1, 1))
    other = (
        ""
        if context.quick
        else (
            f" Without limit, the wheelhouse's stated pairs: mean {table['mean'].iloc[-1]:.3g} times the limit, "
            f"{table['mean, µm'].iloc[-1]:.3g} µm."
        )
    )
    return [
        Finding("mean", float(limited["mean"].max()), "Over the larger of 2 µm and 5 % of 6σ." + other, figure, table),
        *(
            Finding(name, float(limited[column].max()))
            for name, column in (("spread", "6σ"), ("force", "force"), ("work", "work"))
        ),
    ]


LIMITS = {"mean": 1.0, "6σ": 1.0, "force": 0.02, "work": 0.07}

STUDY = Study(
    order=42,
    title="Pairs against every node",
    claim="The contact pairs of the shipped scenes represent contact at every node of the facing zones.",
    reference="The same samples of the same scene with a pair at every node of both sheets in its zones.",
    acceptance=(
        Acceptance(
            "mean",
            "Means of key characteristics: largest difference over the larger of 2 µm and 5 % of 6σ.",
            LIMITS["mean"],
            reason=(
                "2 µm is the resolution of coordinate measuring machines on sheets; 5 % is less than the uncertainty "
                "of 500 samples, 6.2 %."
            ),
        ),
        Acceptance("spread", "6σ of key characteristics: the same.", LIMITS["6σ"], reason="As for the means."),
        Acceptance(
            "force",
            "Sum of normal forces beyond the nuggets: difference over the largest.",
            LIMITS["force"],
            reason="The 2 % of the setting standard.",
        ),
        Acceptance(
            "work",
            "Work of friction in a zone: difference over the largest.",
            LIMITS["work"],
            reason="2 % of the force and 5 % of the slip, whose product it is.",
        ),
    ),
    seconds=(124, 3),
    memory=1.8,
    run=run,
)
