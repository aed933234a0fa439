"""Scenes that vary everything at once, and the same scenes scaled, rotated, mirrored, renumbered, permuted."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from fem_reference.shell.factorisation import FactorisationError
from mic.contact import path
from mic.contact.laws import find
from mic.errors import MicError
from verification.plots import panels
from verification.study import Acceptance, Finding, Study
from verification.symmetry import design
from verification.symmetry.numbers import disagreement
from verification.symmetry.solution import has_several_solutions, solve
from verification.symmetry.transformation import Transformation, transformations

COUNT = (208, 8)  # points of the full and the quick version, which has few pairs
FEW = 20
LENGTHS, FORCES = (1e-3, 10.0, 1 / 25.4, 1e3), (1e6, 1.0, 1e-3, 37.0)
SCALED, SEVERAL = "scaled", "several solutions"
REFUSALS = (MicError, FactorisationError, ValueError, ArithmeticError)
PLAIN, SLIVERS = 1e-9, 1e-6  # limits
FOLLOWED = path.FORCES * path.Followed.tolerance  # of paths with error control, where a step is accepted or not
COLUMNS = ["point", "sliver", "followed", "transformation", "disagreement", "stage", "quantity", "name", "reason"]


def judged(number: int, point: dict) -> dict:
    """Disagreement of a point with itself: every second one scaled, the others by the other transformations in turn."""
    row = {"point": number, "sliver": point["sliver"] < 1, "followed": find(point["law"]).followed}
    row |= {"transformation": "", "reason": ""}
    try:
        placed, deviations = design.scene(point)
        given = solve(placed, deviations)
    except REFUSALS as refusal:
        return row | {"reason": reason_of(refusal)}
    law = placed.scene.report.laws[0]
    others = [other for other in transformations(placed) if other.length == other.force == 1.0]
    other = others[number // 2 % len(others)]
    change = replace(other, name="permuted") if other.permuted else other
    if number % 2 == 0:
        change = Transformation(SCALED, length=LENGTHS[number // 2 % 4], force=FORCES[number // 8 % 4])
    try:
        found = solve(placed, deviations, change, given.pairs).numbers[law]
    except REFUSALS as refusal:
        return row | {"transformation": change.name, "reason": reason_of(refusal)}
    failed = (given.numbers[law].isna().all() != found.isna().all()).any()
    table = disagreement(given.numbers[law], found)
    table = table[table.index.get_level_values("unit") != "1"]
    quantity, stage, item, _ = table["relative"].idxmax()
    where = {"transformation": change.name, "stage": stage, "quantity": quantity, "name": item}
    worst = float(table["relative"].max())
    if failed:
        row["reason"] = "converges in one of both only"
    elif row["followed"] and worst > FOLLOWED and has_several_solutions(placed, deviations):
        row["reason"] = SEVERAL
    return row | where | {"disagreement": worst}


def reason_of(refusal: Exception) -> str:
    """The first line of a refusal, with its kind."""
    return f"{type(refusal).__name__}: {str(refusal).splitlines()[0]}"


def distribution(table: pd.DataFrame):
    """Figure: share of the points up to a disagreement, by transformation, for plain meshes and slivers."""
    figure, axes = panels(2, width=10.0, height=3.6)
    for axis, sliver, limit, title in zip(axes, (False, True), (PLAIN, SLIVERS), ("plain meshes", "with slivers")):
        for name, group in table[table["sliver"] == sliver].groupby("transformation", sort=False):
            value = np.sort(group["disagreement"].clip(lower=1e-16))
            axis.step(value, (1 + np.arange(len(value))) / len(value), where="post", label=f"{name} ({len(value)})")
        axis.axvline(limit, color="k", ls=":", lw=1.0)
        axis.text(limit, 0.02, " limit", fontsize=8)
        axis.set(xscale="log", xlim=(1e-14, 10.0), ylim=(0, 1.02), title=title, xlabel="largest relative disagreement")
        axis.legend(loc="upper left", fontsize=7.5)
    axes[0].set_ylabel("share of the points")
    return figure


def run(context):
    points = design.points(COUNT[False])
    if context.quick:
        points = [point for point in points if point["pairs"] <= FEW][: COUNT[True]]
    largest = sorted(range(len(points)), key=lambda i: -points[i]["pairs"])  # the most expensive first
    found = context.team.map(lambda task: task(), [partial(judged, i, points[i]) for i in largest])
    table = pd.DataFrame(found, columns=COLUMNS).sort_values("point", kind="stable")
    refused = table[table["transformation"] == ""]
    compared = table[table["transformation"] != ""]
    several = compared["reason"] == SEVERAL
    lost = compared[(compared["disagreement"].isna() | (compared["reason"] != "")) & ~several]
    kinds = compared[compared["disagreement"].notna()]
    kinds = kinds.assign(within=kinds["disagreement"] <= np.where(kinds["sliver"], SLIVERS, PLAIN))
    figure = distribution(kinds)
    findings = []
    groups = {
        name: kinds[~kinds["followed"] & (kinds["sliver"] == (name == "slivers"))] for name in ("plain", "slivers")
    }
    for name, own in (groups | {"followed": kinds[kinds["followed"]]}).items():
        counts = own.groupby("transformation")["within"].agg(["sum", "size"])
        inside = ", ".join(f"{within} of {size} {kind}" for kind, within, size in counts.itertuples())
        worst = own[~own["within"]].sort_values("disagreement", ascending=False).drop(columns="within")
        one = own["reason"] != SEVERAL
        note = f"Within {PLAIN:g} on plain meshes and {SLIVERS:g} with slivers: {inside}."
        if not one.all():
            note += f" Not judged, as several solutions are proven: {(~one).sum()}."
        findings.append(
            Finding(name, float(own["disagreement"][one].max()), note, figure if name == "plain" else None, worst)
        )
        if name != "followed":
            findings.append(Finding(f"{name}-share", float(own["within"].mean()), ""))
    return [
        *findings,
        Finding("lost", len(lost), table=lost[["point", "transformation", "reason"]] if len(lost) else None),
        Finding("refused", len(refused) / len(points), table=refused[["point", "reason"]] if len(refused) else None),
    ]


STUDY = Study(
    order=95,
    title="Symmetry",
    claim=(
        "A scene that is scaled in length or in stiffness and force, rotated, mirrored, renumbered or permuted has the "
        "same key characteristics, forces and slips."
    ),
    reference="The homogeneity of physics and space: each scene is compared with itself.",
    acceptance=(
        Acceptance(
            "plain",
            "Scaled, rotated, mirrored, renumbered, permuted: largest disagreement without followed paths and slivers.",
            PLAIN,
            reason=(
                "Rounding of 1e-16 times the condition of bending, (80 mm / 5 mm)⁴, and 100 for that of many contacts."
            ),
        ),
        Acceptance(
            "plain-share",
            "Share of these comparisons within that limit.",
            1.0,
            bound="at least",
            reason="Whatever is beyond it has a cause that is not rounding.",
        ),
        Acceptance(
            "slivers",
            "The same with slivers, down to 1e-6 of an element.",
            SLIVERS,
            reason="Coordinates of 100 mm with 16 digits give the width of such a sliver, 5e-6 mm, to 3e-9; times 100.",
        ),
        Acceptance(
            "slivers-share",
            "Share of these comparisons within that limit.",
            1.0,
            bound="at least",
            reason="Whatever is beyond it has a cause that is not rounding.",
        ),
        Acceptance(
            "followed",
            "Followed paths, with and without slivers: largest disagreement where not several solutions are proven.",
            FOLLOWED,
            reason=(
                "Rounding may let a path take other steps: it may then change by what step control allows a force, "
                "64 × 2.5e-4 of the largest."
            ),
        ),
        Acceptance(
            "lost",
            "Transformed scenes that are refused, or converge where the scene as it stands does not, or conversely.",
            0,
            reason="Whether a scene can be solved depends on units or axes no more than its answer.",
        ),
        Acceptance(
            "refused",
            "Share of scenes that are refused as they stand.",
            0.03,
            reason="As in the study of extremes: more than one in thirty would not be an exception.",
        ),
    ),
    seconds=(310, 12),
    memory=1.0,
    run=run,
)
