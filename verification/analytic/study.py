"""Cases with a closed solution: neither production nor the finite-element reference is the judge here."""

from __future__ import annotations

import numpy as np
import pandas as pd

from verification.analytic.leaves import Leaves, deflections
from verification.plots import panels
from verification.study import Acceptance, Finding, Study


def layered_cantilever(context):
    """Deflection before, at and after the slip load, unloading, and the loop that friction opens."""
    leaves = Leaves(size=5.0, columns=20) if context.quick else Leaves(size=2.5, columns=40)
    ratio = np.array([0.5, 0.9, 1.0, 1.1, 1.5, 2.0, 1.0, 0.0, -1.0, -2.0, -1.0, 0.0, 1.0, 2.0])
    peak = int(np.argmax(ratio))
    loads = ratio * leaves.slip_load
    found, _ = deflections(leaves, context, loads)
    exact = leaves.exact(loads)
    error = np.abs(found - exact).max() / np.abs(exact).max()
    P, d = 2 * loads[peak:], found[peak:]  # the whole beam carries 2 P
    area = abs(np.sum(np.diff(d) * (P[1:] + P[:-1]) / 2))
    expected = leaves.loop_area(loads[peak])
    stuck = found[0] / loads[0]

    figure, (axis,) = panels(1)
    axis.plot(exact, ratio, "k-", lw=1, label="closed form")
    axis.plot(found, ratio, "o", color="tab:red", ms=5, label=f"reduced model, error {error:.2%}")
    for compliance, label in ((leaves.stuck_compliance, "leaves act as one"), (leaves.sliding_compliance, "leaves slide freely")):
        x = np.array([0, compliance * leaves.slip_load * min(1.0, exact.max() / (compliance * leaves.slip_load))])
        axis.plot(x, x / compliance / leaves.slip_load, ":", lw=1, label=label)
    axis.set(xlabel="deflection, mm", ylabel="load over slip load")
    axis.legend()
    table = pd.DataFrame({"load / slip load": ratio, "deflection, mm": found, "closed form, mm": exact, "difference / largest": (found - exact) / np.abs(exact).max()})
    return [
        Finding("cantilever", error, f"Slip load {leaves.slip_load:.3g} N, {leaves.columns} pairs. Stuck, the beam yields by {stuck / leaves.stuck_compliance:.4f} of "
                "what one beam of double depth would.", figure, table),
        Finding("hysteresis", abs(area / expected - 1), f"Loop of {area:.4g} N mm, closed form {expected:.4g} N mm."),
    ]


def run(context):
    return layered_cantilever(context)


STUDY = Study(
    order=80,
    title="Analytic truth",
    claim="Where friction has a closed solution, the reduced model finds it: sticking, sliding, turning round, with memory.",
    reference="Closed forms, computed; neither side of the code is the reference.",
    acceptance=(
        Acceptance("cantilever", "Layered cantilever with slip between the leaves, before, at and after the slip load, loading and unloading: largest error "
                   "of the deflection over the largest deflection.", 0.004, quick=0.015),
        Acceptance("hysteresis", "The energy that friction takes in a closed loop of the layered cantilever: relative error.", 0.004, quick=0.015),
    ),
    seconds=(20, 8),
    run=run,
)
