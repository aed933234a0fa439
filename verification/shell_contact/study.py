"""The published values of the twelve cases of shell contact, computed again, also on finer meshes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

from verification.plots import panels
from verification.shell_contact.case import FINEST, LEVELS, Case, Quantity, cases
from verification.shell_contact.converged import FINEST_TOLD, Converged, read
from verification.study import Acceptance, Finding, Study

SAME = 1e-4  # relative change of a value that rounding and path error control can cause
#: The cheapest cases: also solved on a finer mesh; the only ones of a quick run.
CHEAPEST = ("double_lap", "lap_bending", "lap_shear", "lap_welded", "leaves")


def held(name: str, shipped: Sequence[Converged], found: Sequence[Quantity], level: str) -> list[dict]:
    """A row for each published quantity: its present value on the mesh of a level, and the published one.

    Raises
    ------
    KeyError
        If a published quantity was not found.
    """
    values = {one.name: one.value for one in found}
    rows = []
    for one in shipped:
        was, now = one.levels[LEVELS.index(level)], values[one.name]
        scale = max(abs(was), FINEST_TOLD[one.unit] / SAME)
        rows.append(
            {
                "case": name,
                "quantity": one.name,
                "unit": one.unit,
                "mesh": level,
                "shipped": was,
                "now": now,
                "change": abs(now - was) / scale / SAME,
                "value": one.value,
                "uncertainty": one.uncertainty,
            }
        )
    return rows


def compared(case: Case, cache, levels: Sequence[str], alter: Callable = lambda model: model) -> list[dict]:
    """A case computed again on some of its meshes."""
    shipped = read(case)
    found = {level: case.quantities(level, cache, alter=alter) for level in levels}
    return [row for level in levels for row in held(case.name, shipped, found[level], level)]


def beyond(case: Case, cache, alter: Callable = lambda model: model) -> list[dict]:
    """Differences between values on a still finer mesh and published values, over the uncertainty."""
    values = {one.name: one.value for one in case.quantities(FINEST, cache, alter=alter)}
    return [
        {
            "case": case.name,
            "quantity": one.name,
            "value": one.value,
            "uncertainty": one.uncertainty,
            "finest": values[one.name],
            "off": abs(values[one.name] - one.value) / max(one.uncertainty, 1e-12),
        }
        for one in read(case)
    ]


def run(context):
    known, levels = cases(), LEVELS[:1] if context.quick else LEVELS
    some = [known[name] for name in CHEAPEST]
    shown = some if context.quick else known.values()
    finer = [] if context.quick else context.team.map(lambda case: beyond(case, context.cache), some)
    rows = context.team.map(lambda case: compared(case, context.cache, levels), shown)
    table = pd.DataFrame([row for one in rows for row in one])
    last = table[table["mesh"] == levels[-1]]
    figure, (axis,) = panels(1, width=7.0, height=3.4)
    share = last["uncertainty"] / np.maximum(abs(last["value"]), 1e-12)
    axis.plot(last["case"], 100 * share, "o", color="tab:blue", ms=4, alpha=0.6)
    axis.set(yscale="log", ylabel="uncertainty, % of the value")
    axis.tick_params(axis="x", rotation=40)
    worst = table.loc[table["change"].idxmax()]
    note = (
        f"{len(last)} quantities of {last['case'].nunique()} cases, half of them known within "
        f"{100 * share.median():.2g} %. Largest change: {worst['quantity']} of {worst['case']}, "
        f"{worst['shipped']:.6g} to {worst['now']:.6g} {worst['unit']}."
    )
    values = Finding("values", float(table["change"].max()), note, figure, table)
    return [values, finer_finding(finer)] if finer else [values]


def finer_finding(finer: list[list[dict]]) -> Finding:
    """The share of values that a finer mesh moves by more than their uncertainty."""
    differences = pd.DataFrame([row for case in finer for row in case])
    worst = differences.loc[differences["off"].idxmax()]
    note = (
        f"{len(differences)} quantities of {differences['case'].nunique()} cases; the largest difference is that of "
        f"{worst['quantity']} of {worst['case']}, {worst['off']:.2g} times its uncertainty."
    )
    return Finding("finer", float((differences["off"] > 1).mean()), note, table=differences)


STUDY = Study(
    order=84,
    title="Twelve cases of frictional contact of shells",
    claim="The program reproduces the published values of the twelve cases on every mesh.",
    reference=(
        "The shipped values of each case on meshes of three sizes. No other such cases are published; the "
        "uncertainty of the values comes from meshes, candidates and paths."
    ),
    acceptance=(
        Acceptance(
            "values",
            "Largest change of a value on a mesh, over the larger of 1e-4 of it and 0.01 µm, 0.01 N or 1e-4 N mm.",
            1.0,
            reason=(
                "A path with error control takes other steps if the last digit of its input changes, with an effect "
                "of up to 1e-4; the absolute limits are hundredths of the resolution of gauges and load cells."
            ),
        ),
        Acceptance(
            "finer",
            "Share of values that a mesh 1.5 times finer than the finest moves by more than their uncertainty.",
            0.05,
            reason="The uncertainties are 95 % intervals.",
            full_only=True,
        ),
    ),
    seconds=(277, 10),
    memory=2.7,
    run=run,
)
