"""Pictures of the load path: contact states along it, work of friction, path error."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from mic.report.context import SHOWN, Context
from mic.report.picture import Picture, law_legend, panels, svg
from mic.report.style import LAWS, STATE_COLOURS, STATE_WORDS, number, percent, zone_colour
from mic.results.outcome import Outcome
from mic.results.schema import PATH_ERRORS

__all__ = ["friction_work_picture", "path_error_picture", "path_state_picture"]


def path_state_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Shares of each stage's path in which the pairs of a zone are open, sticking or slipping, a panel for each law."""
    laws = _laws(outcome, context)
    if not laws:
        return None
    zones, stages = outcome.zones, outcome.stages
    fig, axes = panels(len(laws), len(laws), (10.5 / len(laws), 0.9 + 0.26 * len(zones) * len(stages)), sharey=True)
    places = [s * (len(zones) + 0.6) + z for s in range(len(stages)) for z in range(len(zones))]
    labels = [f"{stage}  {zone}" if len(stages) > 1 else zone for stage in stages for zone in zones]
    sentences = []
    for ax, law in zip(axes, laws):
        rows, left = _rows(outcome, law), np.zeros(len(places))
        for state, colour in STATE_COLOURS.items():
            ax.barh(places, rows[state], 0.8, left=left, color=colour)
            left = left + rows[state].to_numpy()
        ax.set(xlim=(0, 1), xlabel="share of the path, mean over pairs and samples", yticks=places, yticklabels=labels)
        ax.set_title(law, color=LAWS[law].colour)
        ax.grid(False)
        mean = ", ".join(f"{percent(rows[state].mean())} {word}" for state, word in STATE_WORDS.items())
        stage, zone = rows.index[int(rows["slip"].to_numpy().argmax())]
        sentences.append(
            f"{law}: {mean} on average over zones and stages; the largest slipping share is in {zone}, stage {stage} "
            f"({percent(rows['slip'].max())})"
        )
    axes[0].invert_yaxis()  # shared by all panels
    for ax in axes:
        for i, label in enumerate(ax.get_yticklabels()):
            label.set_color(zone_colour(i % len(zones)))
    handles = [Patch(color=colour, label=STATE_WORDS[state]) for state, colour in STATE_COLOURS.items()]
    fig.legend(handles=handles, loc="outside upper left", ncols=3)
    return svg(fig, "Contact states along the path", f"{'; '.join(sentences)}.")


def friction_work_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Work of friction in each zone and stage, with its interval."""
    laws = _laws(outcome, context)
    if not laws:
        return None
    zones, stages, rows = outcome.zones, outcome.stages, {law: _rows(outcome, law) for law in laws}
    fig, axes = panels(len(stages), min(3, len(stages)), (10.5 / min(3, max(2, len(stages))), 2.5))
    width = 0.8 / len(laws)
    for ax, stage in zip(axes, stages):
        for i, law in enumerate(laws):
            own = rows[law].loc[stage]
            mean, low, high = (own[f"mean_friction_work{end}"].to_numpy() for end in ("", "_low", "_high"))
            place = np.arange(len(zones)) + (i - (len(laws) - 1) / 2) * width
            ax.bar(place, mean, 0.9 * width, color=LAWS[law].colour, alpha=0.85)
            ends = np.nan_to_num([mean - low, high - mean])
            ax.errorbar(place, mean, ends, fmt="none", ecolor="#1b1f24", elinewidth=1, capsize=2)
        ax.set_xticks(range(len(zones)), zones)
        for z, label in enumerate(ax.get_xticklabels()):
            label.set_color(zone_colour(z))
        ax.set(title=f"stage {stage}", xlim=(-0.9, len(zones) - 0.1), ylim=(0, None))
        ax.grid(axis="x", visible=False)
    axes[0].set_ylabel("work of friction (N mm)")
    law_legend(fig, laws)
    sentences = []
    for law in laws:
        work = rows[law]["mean_friction_work"].groupby(level="stage", sort=False).sum()
        sentences.append(f"{law}: " + ", ".join(f"{number(done)} N mm in {stage}" for stage, done in work.items()))
    text = f"Mean over the samples, with its 95 % interval. Over all zones, {'; '.join(sentences)}."
    return svg(fig, "Work of friction", text)


def path_error_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Distribution of the estimated path error, and comparison with the error measured on a tighter path."""
    shown = {
        (law, stage): 1e3 * outcome.path_error(law, stage, outcome.sample_numbers(law)[:SHOWN])
        for law in _laws(outcome, context)
        for stage in outcome.stages
    }
    shown = {key: error for key, error in shown.items() if np.isfinite(error).all() and error.max() > 0}
    if not shown:
        return None
    laws = list(dict.fromkeys(law for law, _ in shown))
    stages = [stage for stage in outcome.stages if any((law, stage) in shown for law in laws)]
    beside = {law: errors for law in laws if len(errors := _estimated(outcome, law))}
    count = len(stages) + bool(beside)
    fig, axes = panels(count, min(3, count), (10.5 / min(3, max(2, count)), 2.5))
    for ax, stage in zip(axes, stages):
        found = {law: shown[law, stage] for law in laws if (law, stage) in shown}
        everything = np.concatenate([error[error > 0] for error in found.values()])
        edges = np.geomspace(0.9 * everything.min(), 1.1 * everything.max(), 31)
        for law, error in found.items():
            clipped, colour = np.maximum(error, edges[0]), LAWS[law].colour
            ax.hist(clipped, bins=edges.tolist(), histtype="stepfilled", color=colour, alpha=0.2, lw=0)
            ax.hist(clipped, bins=edges.tolist(), histtype="step", color=colour, lw=1.2)
        ax.set(xscale="log", xlabel="estimated error (µm)", title=f"stage {stage}")
        _ticks(ax.xaxis, edges[0], edges[-1])
    axes[0].set_ylabel("samples")
    if beside:
        _draw_estimated(axes[-1], beside)
    law_legend(fig, laws)
    sentences = []
    for law in laws:
        by_stage = [
            f"median {number(np.median(error), 2)} µm and largest {number(error.max(), 2)} µm in {stage}"
            for (own, stage), error in shown.items()
            if own == law
        ]
        sentences.append(f"{law}: {', '.join(by_stage)}" + (_coverage(beside[law]) if law in beside else ""))
    text = "Error of the contacts' tangential positions, root mean square over the pairs. "
    return svg(fig, "Estimated error of the path", f"{text}{'; '.join(sentences)}.")


def _draw_estimated(ax: Axes, beside: Mapping[str, pd.DataFrame]) -> None:
    """Measured against estimated error of the repeated samples, by law."""
    known = 1e3 * pd.concat(beside.values())[["estimate", "measured"]].to_numpy()
    ends = known[known > 0].min(initial=np.inf), known.max()
    for law, errors in beside.items():
        x, y = 1e3 * errors["estimate"], 1e3 * errors["measured"]
        ax.plot(x, y, LAWS[law].mark, ms=4, mew=0, color=LAWS[law].colour, alpha=0.85)
    ax.plot(ends, ends, color="#333", lw=0.8)
    ax.set(xscale="log", yscale="log", xlabel="estimated error (µm)", ylabel="measured (µm)")
    ax.set_title("repeated samples, after each stage")
    _ticks(ax.xaxis, *ends)
    _ticks(ax.yaxis, *ends)


def _ticks(axis, low: float, high: float) -> None:
    """Plain numbers on a logarithmic axis, few on a long one."""
    axis.set_major_locator(LogLocator(subs=(1.0,) if high > 30 * low else (1.0, 2.0, 3.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _estimated(outcome, law) -> pd.DataFrame:
    """Rows of the path study with both an estimate and a measured error."""
    if outcome.path_study is None:
        return PATH_ERRORS.empty()
    errors = outcome.path_study.errors
    return errors[(errors["law"] == law) & errors["converged"] & errors["estimate"].notna()]


def _coverage(errors) -> str:
    """Share of repetitions whose estimate covers the measured error, in words."""
    covered = errors["estimate"] >= errors["measured"]
    text = f"; the estimate is at least the change on a tighter path in {covered.sum()} of {len(errors)} cases"
    positive = errors["measured"] > 0
    if positive.any():
        ratio = (errors["estimate"] / errors["measured"])[positive].median()
        text += f" (median of estimate over change: {number(ratio, 2)})"
    known = errors[errors["force_estimate"].notna()]
    if not len(known):
        return text
    forces = np.hypot(known["normal_measured"], known["friction_measured"])
    covered = known["force_estimate"] >= forces
    return f"{text}; that of forces in {covered.sum()} of {len(known)} (change: {number(forces.max(), 2)} N at most)"


def _rows(outcome, law) -> pd.DataFrame:
    """Statistics by stage and zone, in the order of the scene."""
    table = outcome.zone_statistics
    own = table[table["law"] == law].set_index(["stage", "zone"])
    return own.loc[pd.MultiIndex.from_product([outcome.stages, outcome.zones], names=["stage", "zone"])]


def _laws(outcome, context) -> list[str]:
    """Laws with friction."""
    if not (outcome.has_slip and outcome.stages):
        return []
    return [law for law in context.laws if LAWS[law].frictional]
