"""Effect of the closing order on friction: the wheelhouse in the orders of `orders.toml`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from mic.process.evaluation import Evaluation
from mic.process.process import Process
from mic.statistics.draw import draw
from mic.studies.order import STATED, Order, variants
from verification.comparison import zone_slip
from verification.path.study import TIGHT, TIGHTER
from verification.plots import panels
from verification.scenes import shipped
from verification.study import Acceptance, Finding, Study

ORDERS = Path(__file__).parent / "orders.toml"
LOCATED = "A4-A8, then clamps one by one"  # all locators close before the clamps press
MEANWHILE = "A4-A8, then clamps, settled meanwhile"  # the same, except for the placement of the parts
PRESSED = (STATED, "clamps together, then A4-A8")  # the sheets slide under clamps
RESAMPLED = 2000
SHARE, ABSOLUTE, MEASURED = 0.01, 2e-3, 0.005  # of a slip's mean or 6σ; mm; of a key characteristic's 6σ


def evaluate(model, order: Order, deviations, law="coulomb", tolerance: float | None = None) -> Evaluation:
    """Evaluation of the samples in one order; `tolerance` replaces that of followed paths."""
    return Process(replace(model, scene=order.scene), law, path_tolerance=tolerance).evaluate(deviations)


def increments(order: Order, count: int) -> Order:
    """The order with `count` increments per step, except for stages in one step."""
    stages = [
        stage if stage.path == "one-step" else stage.model_copy(update={"path": None, "increments": count})
        for stage in order.scene.stages
    ]
    return Order(order.name, order.scene.model_copy(update={"stages": stages}))


def spread(values):
    """Mean and 6σ over the samples, (2, …)."""
    return np.stack([values.mean(axis=0), 6 * values.std(axis=0, ddof=1)])


def ratios(model, rubbing: Evaluation, smooth: Evaluation):
    """Ratio with/without friction of the tangential displacement of the zones while clamping.

    Returns mean and 6σ (2, zones) and the ends of their 95 % bootstrap intervals (2, 2, zones); samples are resampled
    in pairs.
    """
    valid = ~(rubbing.failed | smooth.failed)
    a, b = (
        zone_slip(each.resolutions["clamp"].displacement[valid], model.contacts, len(model.scene.zones))
        for each in (rubbing, smooth)
    )
    chosen = np.random.default_rng(1).integers(0, len(a), (RESAMPLED, len(a)))
    again = np.stack([spread(a[rows]) / spread(b[rows]) for rows in chosen])
    return spread(a) / spread(b), np.quantile(again, (0.025, 0.975), axis=0)


def departure(found: Evaluation, exact: Evaluation, model) -> tuple[float, float]:
    """Largest difference of mean and 6σ of slips under load and of key characteristics, over the allowed error.

    The allowed error is the larger of a share of the exact mean or 6σ (for key characteristics of 6σ) and an absolute
    amount.
    """
    slip = []
    for stage in exact.resolutions:
        for zone in range(len(model.scene.zones)):
            own = model.contacts.zone == zone
            pair = [
                spread(np.sqrt((each.resolutions[stage].trace.slip[:, own] ** 2).sum(-1).mean(1)))
                for each in (found, exact)
            ]
            slip.append(np.abs(pair[0] - pair[1]) / np.maximum(SHARE * np.abs(pair[1]), ABSOLUTE))
    a, b = spread(found.measurements), spread(exact.measurements)
    return float(np.max(slip)), float((np.abs(a - b) / np.maximum(MEASURED * b[1], ABSOLUTE)).max())


def table_of(model, others, rubbing, smooth):
    """One row per order: ratios with intervals, and change of key characteristics from the stated order over 6σ."""
    rows = []
    base = spread(next(each for order, each in zip(others, rubbing) if order.name == STATED).measurements)
    for order, each in zip(others, rubbing):
        ratio, (low, high) = ratios(model, each, smooth)
        change = np.abs(spread(each.measurements) - base) / base[1]
        row = {"order": order.name}
        for kind, (r, l, h) in zip(("mean", "6σ"), zip(ratio, low, high)):
            for zone, *values in zip(model.scene.zones, r, l, h):
                row |= dict(zip((f"{zone.name} {kind}", f"{zone.name} {kind} from", f"{zone.name} {kind} to"), values))
        row |= {"key characteristics: mean": change[0].max(), "key characteristics: 6σ": change[1].max()}
        rows.append(row | {"failed samples": int(each.failed.sum())})
    return pd.DataFrame(rows).set_index("order")


def columns(table, kind="", end=""):
    """Columns of the ratios of a kind (mean, 6σ), or of one end of their intervals."""
    own = [name for name in table if name.startswith("CZ") and kind in name]
    return table[[name for name in own if name.endswith(end or ("mean", "6σ"))]]


def judge(table, settled) -> dict[str, float]:
    """Measured values for the limits, except those of the path error."""
    return {
        "located": float((columns(table).loc[LOCATED] - 1).abs().max()),
        "pressed": float(columns(table, "mean", "to").loc[list(PRESSED)].to_numpy().max()),
        "set-down": settled,
        "matters": float(table["key characteristics: mean"].loc[LOCATED]),
    }


def run(context):
    scene = shipped("wheelhouse", "coarse" if context.quick else "medium", ("coulomb", "frictionless"))
    others = variants(scene, ORDERS)
    samples, few = (24, 0) if context.quick else (100, 10)
    model = context.model(scene)
    deviations = draw(scene, 303, 0, samples)
    smooth = evaluate(model, others[0], deviations, "frictionless")
    rubbing = context.team.map(lambda order: evaluate(model, order, deviations), others)
    table = table_of(model, others, rubbing, smooth)
    by_name = {order.name: each for order, each in zip(others, rubbing)}
    settled = departure(by_name[MEANWHILE], by_name[LOCATED], model)[1]

    figure, _ = picture(table, [zone.name for zone in scene.zones])
    numbers = judge(table, settled)
    moved = table["key characteristics: mean"].drop(STATED)
    return [
        Finding(
            "located",
            numbers["located"],
            f"{samples} samples, the same for every order; intervals are 95 % of {RESAMPLED} bootstrap samples.",
            figure,
            table.reset_index(),
        ),
        Finding("pressed", numbers["pressed"]),
        Finding("set-down", numbers["set-down"]),
        Finding(
            "matters",
            numbers["matters"],
            f"Largest change of a mean: {moved.max():.2g} 6σ, in the order {moved.idxmax()}.",
        ),
        *([] if context.quick else path_findings(context, model, others, deviations[:few])),
    ]


def path_findings(context, model, orders, deviations) -> list[Finding]:
    """Errors of the followed path in every order that follows one."""

    def path_left(order):
        """Errors of the followed path and of one 25 times tighter against the tightest."""
        found, tight, exact = (
            evaluate(model, order, deviations, tolerance=tolerance) for tolerance in (None, TIGHT, TIGHTER)
        )
        return *departure(found, exact, model), max(departure(tight, exact, model))

    followed = [order for order in orders if order.scene.stages[1].path != "one-step"]
    left = context.team.map(path_left, followed)
    names = [order.name for order in followed]
    paths = pd.DataFrame(left, columns=["slip", "key characteristics", "judge"], index=names)
    return [
        Finding("path-slip", float(paths["slip"].max()), f"{len(deviations)} samples.", table=paths.reset_index()),
        Finding("path-measured", float(paths["key characteristics"].max())),
        Finding("path-judge", float(paths["judge"].max()), f"Worst: {paths['judge'].idxmax()}."),
    ]


def picture(table, zones):
    """Figure of the ratios of the zones with intervals, a line for each order; returns figure and axes (mean, 6σ)."""
    figure, axes = panels(2, width=6.0)
    for axis, kind in zip(axes, ("mean", "6σ")):
        for z, zone in enumerate(zones):
            y = np.arange(len(table)) + 0.2 * (z - 1)
            r, low, high = (table[f"{zone} {kind}{end}"] for end in ("", " from", " to"))
            axis.errorbar(r, y, xerr=[r - low, high - r], fmt="o", ms=4, capsize=2, color=f"C{z}", label=zone)
        axis.axvline(1.0, color="0.4", ls=":")
        axis.set(xlabel=f"{kind} of the zone's tangential displacement, friction / none", yticks=range(len(table)))
        axis.set_yticklabels(table.index if kind == "mean" else [])
        axis.invert_yaxis()
    axes[1].legend()
    return figure, axes


STUDY = Study(
    order=32,
    title="Order",
    claim=(
        "The closing order of clamps and further locators decides whether friction matters: little if locators close "
        "before the sheets are pressed, much if clamps come first."
    ),
    reference="The same samples without friction; the same orders on ever tighter paths.",
    acceptance=(
        Acceptance(
            "located",
            (
                "Further locators, then clamps: effect of friction on mean and 6σ of every zone's tangential "
                "displacement, largest relative change."
            ),
            0.05,
            reason="`mic check` notes that friction has little effect in a stage below 5 %.",
        ),
        Acceptance(
            "pressed",
            (
                "Clamps, then further locators: ratio of the means with and without friction, upper end of its "
                "interval, largest of the zones."
            ),
            0.9,
            reason="A reduction of less than a tenth would not be worth stating an order.",
        ),
        Acceptance(
            "set-down",
            (
                "Further locators, then clamps: effect of part placement on key characteristics, over the "
                "larger of 0.5 % of 6σ and 2 µm."
            ),
            1.0,
            reason="0.5 % and 2 µm are the accuracy of a followed path.",
        ),
        Acceptance(
            "matters",
            "Effect of the order on the mean of a key characteristic, largest change over 6σ.",
            0.05,
            bound="at least",
            reason="Ten times the 0.5 % of a followed path.",
        ),
        Acceptance(
            "path-slip",
            (
                "Path against one 250 times tighter in every order: mean or 6σ of a zone's slip, largest difference "
                "over the larger of 1 % and 2 µm."
            ),
            1.0,
            reason="A sixth of the uncertainty of 500 samples, and the resolution of a coordinate measuring machine.",
            full_only=True,
        ),
        Acceptance(
            "path-measured",
            "The same for key characteristics, over the larger of 0.5 % of 6σ and 2 µm.",
            1.0,
            reason="A twelfth of the uncertainty of 500 samples, and the resolution of a coordinate measuring machine.",
            full_only=True,
        ),
        Acceptance(
            "path-judge",
            "Error of that reference path: paths 25 and 250 times tighter, the same ratio.",
            0.2,
            reason="A reference errs by at most a fifth of the limit.",
            full_only=True,
        ),
    ),
    seconds=(63, 13),
    memory=1.0,
    run=run,
)
