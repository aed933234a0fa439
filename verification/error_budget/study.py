"""Error budget of the example scenes: errors of the printed results by source."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mic import examples
from mic.model.mesh_accuracy import with_halved_elements
from mic.scene import load_scene
from verification.budget import FIGURES, REFINED, SAMPLING, Case, paired
from verification.budget_page import budget_figure, budget_rows, by_quantity, items_of
from verification.comparison import reduced_and_assembly, reduced_model
from verification.own_scene import verify_scene
from verification.study import Acceptance, Finding, Study

FULL_SOLVES = 3
SCENES, QUICK = (("lap_joint", None), ("hat_on_plate", None)), (("lap_joint", "coarse"),)  # None: as shipped
QUICK_SAMPLES = 100


def _scene(name, size, quick):
    scene = load_scene(examples.folder(name))
    if size is not None:
        scene = scene.model_copy(update={"parts": [part.model_copy(update={"size": size}) for part in scene.parts]})
    if quick:
        few = scene.monte_carlo.model_copy(update={"samples": QUICK_SAMPLES})
        scene = scene.model_copy(update={"monte_carlo": few})
    return scene.model_copy(update={"report": scene.report.model_copy(update={"laws": ["coulomb"], "fields": False})})


def mesh_coverage(scene, cache) -> pd.DataFrame:
    """Estimated mesh errors and errors against meshes halved twice, whose own error is a sixteenth."""
    model, assembly = reduced_and_assembly(scene, cache)
    case = Case(assembly, model, "coulomb", cache)
    refined, finer = [], assembly
    for _ in range(2):
        finer = with_halved_elements(finer)
        refined.append(case.of(reduced_model(finer, cache)))
    estimate = paired(case.production, refined[0], REFINED["mesh"])
    true = paired(case.production, refined[1], REFINED["law"])
    rows = [
        {
            "quantity": f"{figure} {name}",
            "estimate, mm": estimate.at[name, figure],
            "±, mm": estimate.at[name, f"{figure}_half"],
            "true, mm": true.at[name, figure],
        }
        for figure in FIGURES
        for name in estimate.index
    ]
    table = pd.DataFrame(rows)
    return table.assign(held=(table["estimate, mm"] - table["true, mm"]).abs() <= table["±, mm"])


def run(context):
    cases = QUICK if context.quick else SCENES
    say = print if context.team.rank == 0 else lambda line: None
    summaries = []
    for name, size in cases:
        folder = context.cache / f"error_budget-{name}"
        scene = _scene(name, size, context.quick)
        found = verify_scene(scene, folder, context.cache, FULL_SOLVES, True, context.team, say)
        summaries.append(context.team.from_first(found))
    (coverage,) = context.team.map(lambda case: mesh_coverage(_scene(*case, context.quick), context.cache), cases[:1])
    return findings(summaries, coverage)


def findings(summaries, coverage) -> list[Finding]:
    """Findings from the error budgets of the scenes and from the coverage of the mesh error."""
    drawn, rows, worst = [], [], {"mean": 0.0, "six-sigma": 0.0, "slip": 0.0, "cpk": 0.0, "force": 0.0}
    sentences = {}
    for summary in summaries:
        budget = summary["budget"]
        items = items_of(budget["sources"])
        table = pd.DataFrame(budget["quantities"]).set_index("quantity")
        numbers = table.columns.difference(["figure", "dominating"])
        table[numbers] = table[numbers].astype(float)
        drawn.append((summary["scene"], table, items))
        rows.append(budget_rows(items, table).assign(scene=summary["scene"]))
        for key, value in method_errors(table, items).items():
            worst[key] = float(np.fmax(worst[key], value))
        forces = [row["force, relative"] for row in summary["per_sample"] if row["law"] == summary["truth"]["law"]]
        worst["force"] = float(np.max([worst["force"], *forces])) if forces else np.nan
        for key, sentence in budget["sentences"].items():
            sentences.setdefault(key, []).append(sentence)
    note = {key: " ".join(each) for key, each in sentences.items()}
    held = coverage["held"].mean()
    return [
        Finding("mean", worst["mean"], note.get("figures", ""), budget_figure(drawn), _first_columns(rows)),
        Finding(
            "six-sigma", worst["six-sigma"], " ".join(note[key] for key in ("dominating", "unknown") if key in note)
        ),
        Finding("cpk", worst["cpk"], note.get("cpk", "")),
        Finding("slip", worst["slip"], note.get("slips", "")),
        Finding(
            "force",
            worst["force"],
            f"Largest error of a contact force: {worst['force']:.1%} of the largest force, in {FULL_SOLVES} samples of "
            "each scene (typical, extreme and random).",
        ),
        Finding(
            "coverage",
            float(held),
            f"{coverage['held'].sum()} of {len(coverage)} means and 6σ, {summaries[0]['scene']}.",
            table=coverage,
        ),
    ]


def _first_columns(rows) -> pd.DataFrame:
    table = pd.concat(rows, ignore_index=True)
    columns = ["scene", "source", "largest, % of tolerance", "largest, % of slip 6σ", "CPU s", "method"]
    return table[columns]


def method_errors(table, items) -> dict[str, float]:
    """Largest possible errors of the sum without sampling error, which the user controls."""
    rest = [item for item in items if item.source != SAMPLING]
    printed = table[["mean", "mean_half", "six_sigma", "six_sigma_half", "lower", "upper", "samples"]]
    again = by_quantity(printed, rest)
    most = {
        figure: (again[f"error {figure}"].abs() + again[f"error {figure} ±"]) / again["scale"] for figure in FIGURES
    }
    own = again.index.str.startswith("measurement:")
    return {
        "mean": most["mean"][own].max(),
        "six-sigma": most["six_sigma"][own].max(),
        "slip": most["six_sigma"][~own].max(),
        "cpk": (again["cpk error"].abs() + again["cpk error ±"])[own].max(),
    }


STUDY = Study(
    order=5,
    title="Error budget",
    claim=(
        "Printed means, 6σ, Cpk, slips and contact forces are accurate enough to decide on tolerances, and the error "
        "budget states how accurate."
    ),
    reference=(
        "For each source of error, the same samples with that source reduced, extrapolated: Coulomb's law, a tighter "
        "path, other orders, half the pair distance, half the element size, the stiffness of each sample's own "
        "shape; full finite elements on selected samples. Sampling error is reported but not judged, since the user "
        "chooses the number of samples."
    ),
    acceptance=(
        Acceptance(
            "mean",
            "Error of a mean over the tolerance.",
            0.1,
            reason="AIAG's Measurement Systems Analysis accepts a gauge with an error of a tenth of the tolerance.",
        ),
        Acceptance(
            "six-sigma",
            "Error of a 6σ over the tolerance.",
            0.1,
            reason="The tenth of the tolerance that a gauge is allowed.",
        ),
        Acceptance(
            "cpk",
            "Error of a Cpk.",
            0.1,
            reason="Cpk is specified to a tenth: 1.33 is not 1.4.",
        ),
        Acceptance(
            "slip",
            "Error of the 6σ of a zone's slip, relative.",
            0.1,
            reason="A slip has no tolerance; a tenth of itself.",
        ),
        Acceptance(
            "force",
            "Error of a contact force over the largest.",
            0.1,
            reason="A tenth, the repeatability of clamps and tongs.",
        ),
        Acceptance(
            "coverage",
            "Share of 95 % intervals of the mesh error that contain the error against meshes halved twice.",
            0.75,
            bound="at least",
            reason="Of eight 95 % intervals, six or more hold in 169 of 170 cases (binomial).",
        ),
    ),
    seconds=(1200, 60),
    memory=6.0,
    run=run,
)
