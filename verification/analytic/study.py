"""Cases with a closed solution: neither production nor the finite-element reference is the judge here."""

from __future__ import annotations

import numpy as np
import pandas as pd

from verification.analytic import stacked
from verification.analytic.leaves import Leaves, deflections, slips
from verification.analytic.sheet import Sheet, dragged_ends, incline_reaction, stop_force
from verification.plots import panels
from verification.study import Acceptance, Finding, Study
from verification.validation import COVERAGE, Uncertainty


def layered_cantilever(context):
    """Deflection before, at and after the slip load, unloading, and the loop that friction opens."""
    coarse = Leaves(size=5.0, columns=20)
    leaves = coarse if context.quick else Leaves(size=2.5, columns=40)
    ratio = np.array([0.5, 0.9, 1.0, 1.1, 1.5, 2.0, 1.0, 0.0, -1.0, -2.0, -1.0, 0.0, 1.0, 2.0])
    peak = int(np.argmax(ratio))
    loads = ratio * leaves.slip_load
    found, exact = deflections(leaves, context, loads), leaves.exact(loads)
    error = np.abs(found - exact).max() / np.abs(exact).max()
    unsure = None if context.quick else mesh_uncertainty(found, deflections(coarse, context, loads), exact)
    P, d = 2 * loads[peak:], found[peak:]  # the whole beam carries 2 P
    area, expected = abs(np.sum(np.diff(d) * (P[1:] + P[:-1]) / 2)), leaves.loop_area(loads[peak])
    stuck = found[0] / loads[0] / leaves.stuck_compliance

    figure, (axis,) = panels(1)
    fine = np.concatenate([np.linspace(a, b, 30) for a, b in zip(np.r_[0, ratio], ratio)])
    axis.plot(leaves.exact(fine * leaves.slip_load), fine, "k-", lw=1, label="closed form")
    axis.plot(found, ratio, "o", color="tab:red", ms=5, label=f"reduced model, error {error:.2%}")
    reach = np.array([0, found[peak]])
    axis.plot(
        reach, reach / leaves.stuck_compliance / leaves.slip_load, ":", color="tab:blue", label="leaves act as one"
    )
    axis.plot(
        reach, reach / leaves.sliding_compliance / leaves.slip_load, ":", color="tab:green", label="leaves slide freely"
    )
    axis.set(xlabel="deflection, mm", ylabel="load over slip load", ylim=(-2.3, 2.9))
    axis.legend(loc="upper left")
    table = pd.DataFrame(
        {
            "load / slip load": ratio,
            "deflection, mm": found,
            "closed form, mm": exact,
            "difference / largest": (found - exact) / np.abs(exact).max(),
        }
    )
    return [
        Finding(
            "cantilever",
            error,
            f"Slip load {leaves.slip_load:.3g} N, {leaves.columns} pairs. Stuck, the beam yields by {stuck:.4f} of "
            "what one beam of double depth would; sliding freely it would yield by four times as much.",
            figure,
            table,
            unsure,
        ),
        Finding("hysteresis", abs(area / expected - 1), f"Loop of {area:.4g} N mm, closed form {expected:.4g} N mm."),
    ]


def mesh_uncertainty(fine, coarse, exact) -> Uncertainty:
    """Bound of the error of a simulation: its difference from `coarse`, with half the density of mesh and pairs."""
    return Uncertainty(num=float(np.abs(fine - coarse).max() / np.abs(exact).max()) / COVERAGE)


def welded_leaves(context):
    """Leaves without friction: how they slide on each other, and how welds tie them, between one beam and two."""
    leaves = Leaves(size=5.0 if context.quick else 2.5, columns=20, friction=0.0)
    rows = []
    for at in (40.0, 70.0, 90.0):
        found, exact = deflections(leaves, context, [10.0], weld_at=at)[0], leaves.welded_deflection(10.0, at)
        rows.append(
            {
                "welds at, mm": at,
                "deflection, mm": found,
                "closed form, mm": exact,
                "relative error": found / exact - 1,
                "without welds, mm": 10.0 * leaves.sliding_compliance,
            }
        )
    table = pd.DataFrame(rows)
    x, slip = slips(leaves, context, 10.0)
    exact_slip = leaves.exact_slips(10.0, x)
    error = np.abs(slip - exact_slip).max() / np.abs(exact_slip).max()
    figure, (axis,) = panels(1)
    axis.plot(x, exact_slip, "k-", lw=1, label="closed form")
    axis.plot(x, slip, "o", color="tab:red", ms=4, label=f"reduced model, error {error:.2%}")
    axis.set(xlabel="x, mm", ylabel="slip of the upper leaf along x, mm")
    axis.legend()
    return [
        Finding("slip", error, "The sign shows which faces of the sheets the pairs read.", figure),
        Finding("welded", float(table["relative error"].abs().max()), table=table),
    ]


def stacked_beams(context):
    """Two beams under a load that presses them onto each other, while it grows and while it falls."""
    coarse = stacked.Stack(size=5.0, columns=20)
    stack = coarse if context.quick else stacked.Stack()
    shares = np.array([0.5, 1.0, 0.75, 0.5, 0.25])
    falling = np.array([False, False, True, True, True])
    found = stacked.deflections(stack, context, shares)
    free, held = stack.free(shares * stack.load), stack.held(shares * stack.load)
    exact = free + np.where(falling, held, -held)
    largest = exact.max()
    unsure = None if context.quick else mesh_uncertainty(found, stacked.deflections(coarse, context, shares), exact)
    figure, (axis,) = panels(1)
    axis.plot(np.r_[0, exact[:2], exact[2:], 0], np.r_[0, shares[:2], shares[2:], 0], "k-", lw=1, label="closed form")
    axis.plot(found, shares, "o", color="tab:red", ms=5, label="reduced model")
    axis.plot(free[:2], shares[:2], ":", color="tab:green", label="without friction")
    axis.set(xlabel="deflection, mm", ylabel="load over largest load")
    axis.legend(loc="upper left")
    return [
        Finding(
            "stacked",
            np.abs(found - exact).max() / largest,
            f"Friction takes {held[1] / free[1]:.1%} of the deflection while the load grows; the reduced model finds "
            f"{((free - found) / held)[1]:.3f} times that, and {((found - free) / held)[2]:.3f} times the part "
            "added while it falls. The closed form holds where slip has turned round, below "
            f"{1 - stack.turned:.2f} of the largest load.",
            figure,
            pd.DataFrame({"load / largest": shares, "deflection, mm": found, "closed form, mm": exact}),
            unsure,
        )
    ]


def incline(context):
    """A sheet on an incline: it stays below the angle of friction, above it the stop takes the rest."""
    sheet = Sheet(length=40.0, width=40.0, size=5.0, columns=8)
    angles = np.array([0.1, 0.25, 0.29, 0.3, 0.45, 0.8, 1.3])
    found, exact = np.array([incline_reaction(sheet, context, angle) for angle in angles]).T
    error = np.abs(found - exact).max()
    figure, (axis,) = panels(1)
    fine = np.linspace(0, 1.5, 200)
    axis.plot(
        np.degrees(fine),
        np.maximum(0, np.sin(fine) - sheet.friction * np.cos(fine)),
        "k-",
        lw=1,
        label="max(0, sin α − μ cos α)",
    )
    axis.plot(np.degrees(angles), found, "o", color="tab:red", label=f"reduced model, error {error:.1e}")
    axis.axvline(np.degrees(np.arctan(sheet.friction)), color="0.6", ls=":", label="angle of friction")
    axis.set(xlabel="slope, degrees", ylabel="force on the stop / weight")
    axis.legend()
    return [
        Finding(
            "incline",
            error,
            "The incline is turned about the vertical as well, so that none of its axes is one of the scene.",
            figure,
            pd.DataFrame(
                {"slope, degrees": np.degrees(angles), "force on the stop / weight": found, "closed form": exact}
            ),
        )
    ]


def partial_slip(context):
    """A pressed sheet dragged at one end: slip reaches as far as friction needs, and turns round from the end."""
    sheet = Sheet(size=2.5)
    ratio = np.array([0.1, 0.3, 0.5, 0.7, 0.4, 0.1, -0.3, -0.6])
    forces = ratio * sheet.drag_limit
    found, exact = dragged_ends(sheet, context, forces), sheet.dragged(forces)
    error = np.abs(found - exact).max() / np.abs(exact).max()
    figure, (axis,) = panels(1)
    fine = np.concatenate([np.linspace(0, ratio.max(), 60), np.linspace(ratio.max(), ratio.min(), 60)])
    axis.plot(sheet.dragged(fine * sheet.drag_limit), fine, "k-", lw=1, label="closed form")
    axis.plot(found, ratio, "o", color="tab:red", label=f"reduced model, error {error:.2%}")
    axis.set(xlabel="displacement of the pulled end, mm", ylabel="pull / largest friction")
    axis.legend(loc="upper left")
    return [
        Finding(
            "partial-slip",
            error,
            f"{sheet.columns} pairs on a sheet of {sheet.length:g} mm.",
            figure,
            pd.DataFrame({"pull / largest friction": ratio, "displacement, mm": found, "closed form, mm": exact}),
        )
    ]


def stop(context):
    """A strip on two supports, bent down onto a stop."""
    sheet = Sheet(size=5.0)
    rows = []
    for load, gap in ((0.1, 0.5), (4.0, 0.5), (10.0, 0.5), (10.0, 2.0)):
        found, exact = stop_force(sheet, context, load, gap)
        rows.append(
            {
                "load, N": load,
                "gap, mm": gap,
                "force on the stop, N": found,
                "beam theory, N": exact,
                "difference / load": (found - exact) / load,
            }
        )
    table = pd.DataFrame(rows)
    return [Finding("stop", float(table["difference / load"].abs().max()), table=table)]


CASES = (layered_cantilever, welded_leaves, incline, partial_slip, stop, stacked_beams)


def run(context):
    return [finding for findings in context.team.map(lambda case: case(context), CASES) for finding in findings]


STUDY = Study(
    order=80,
    title="Analytic truth",
    claim="The reduced model reproduces closed solutions with contact and friction: stick, slip, reversal and memory.",
    reference="Closed forms, evaluated in the study, independent of production and of the finite-element reference.",
    acceptance=(
        Acceptance(
            "cantilever",
            (
                "Layered cantilever with slip between the leaves (Goodman and Klumpp), loading and unloading: error "
                "of the deflection over the largest deflection."
            ),
            0.003,
            quick=0.008,
            reason="A third of the 1 % error of the setting reference, which leaves room for other sources.",
        ),
        Acceptance(
            "hysteresis",
            "Energy dissipated in a closed loop of the layered cantilever: relative error.",
            0.003,
            quick=0.008,
            reason="As for the deflection, whose loop area it is.",
        ),
        Acceptance(
            "stacked",
            (
                "Two stacked beams under a uniform load that presses them together (Springfield and Joshi), growing "
                "and falling: error of the deflection over the largest deflection."
            ),
            0.003,
            quick=0.008,
            reason="As for the cantilever.",
        ),
        Acceptance(
            "slip",
            "Slip of frictionless leaves, depth times slope: error over the largest slip.",
            0.003,
            quick=0.006,
            reason="As for the deflection, whose slope it is.",
        ),
        Acceptance(
            "welded",
            "Frictionless leaves tied by welds: relative error of the deflection.",
            0.002,
            quick=0.006,
            reason="A fifth of the 1 % error of the setting reference, since contact plays no part.",
        ),
        Acceptance(
            "incline",
            (
                "Sheet on an incline: sticks below the angle of friction and presses its stop with W (sin α - μ cos "
                "α) above it: error over the weight."
            ),
            1e-8,
            reason="Statics: the solver's tolerance is 1e-10 of the largest force; a hundred times that.",
        ),
        Acceptance(
            "partial-slip",
            (
                "Pressed sheet dragged at its end (shear lag; Cattaneo and Mindlin's law on the way back): error of "
                "the end's displacement over the largest displacement."
            ),
            0.003,
            reason="A third of the 1 % error of the setting reference, which leaves room for other sources.",
        ),
        Acceptance(
            "stop",
            "Strip bent onto a stop: error of the force on the stop over the load.",
            0.003,
            reason="A third of the 1 % error of the setting reference, which leaves room for other sources.",
        ),
    ),
    seconds=(6, 8),
    run=run,
)
