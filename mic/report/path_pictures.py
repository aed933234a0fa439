"""Pictures of the load path: contact states along it, work of friction, path error."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from mic.report.context import SHOWN, Context
from mic.report.picture import Picture, law_legend, panels, svg
from mic.report.style import LAWS, STATE_COLOURS, STATE_WORDS, number, percent, zone_colour
from mic.results.outcome import Outcome
from mic.results.schema import PATH_ERRORS

__all__ = ["friction_work_picture", "path_error_picture", "path_state_picture"]

SLIPPING = list(STATE_WORDS)[-1]


def path_state_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Shares of each stage's path in which the pairs of a zone are open, sticking or slipping, a panel for each law."""
    laws = _laws(outcome, context)
    if not laws:
        return None
    zones, stages = outcome.zones, outcome.stages
    fig, axes = panels(len(laws), len(laws), (10.5 / len(laws), 0.9 + 0.26 * len(zones) * len(stages)), sharey=True)
    sentences = []
    for ax, law in zip(axes, laws):
        rows = _rows(outcome, law)
        places, labels = [], []
        for s, stage in enumerate(stages):
            for z, zone in enumerate(zones):
                place, left = s * (len(zones) + 0.6) + z, 0.0
                for state, colour in STATE_COLOURS.items():
                    share = rows[stage, zone][state]
                    ax.barh(place, share, 0.8, left=left, color=colour)
                    left += share
                places.append(place)
                labels.append(f"{stage}  {zone}" if len(stages) > 1 else zone)
        ax.set(xlim=(0, 1), xlabel="share of the path, mean over pairs and samples", yticks=places, yticklabels=labels)
        ax.set_title(law, color=LAWS[law].colour)
        ax.grid(False)
        mean = {word: np.mean([row[state] for row in rows.values()]) for state, word in STATE_WORDS.items()}
        most = max(rows, key=lambda key: rows[key][SLIPPING])
        sentences.append(
            f"{law}: {', '.join(f'{percent(share)} {word}' for word, share in mean.items())} on average over zones and "
            f"stages; the largest slipping share is in {most[1]}, stage {most[0]} ({percent(rows[most][SLIPPING])})"
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
    zones, stages = outcome.zones, outcome.stages
    fig, axes = panels(len(stages), min(3, len(stages)), (10.5 / min(3, max(2, len(stages))), 2.5))
    width = 0.8 / len(laws)
    for ax, stage in zip(axes, stages):
        for i, law in enumerate(laws):
            rows = _rows(outcome, law)
            mean, low, high = (
                np.array([rows[stage, zone][f"mean_friction_work{end}"] for zone in zones])
                for end in ("", "_low", "_high")
            )
            place = np.arange(len(zones)) + (i - (len(laws) - 1) / 2) * width
            ax.bar(place, mean, 0.9 * width, color=LAWS[law].colour, alpha=0.85)
            ends = np.nan_to_num([mean - low, high - mean])
            ax.errorbar(place, mean, ends, fmt="none", ecolor="#1b1f24", elinewidth=1, capsize=2)
        ax.set_xticks(range(len(zones)), zones)
        for z, label in enumerate(ax.get_xticklabels()):
            label.set_color(zone_colour(z))
        ax.set_title(f"stage {stage}")
        ax.set(xlim=(-0.9, len(zones) - 0.1), ylim=(0, None))
        ax.grid(axis="x", visible=False)
    axes[0].set_ylabel("work of friction (N mm)")
    law_legend(fig, laws)
    sentences = []
    for law in laws:
        rows = _rows(outcome, law)
        work = {stage: sum(rows[stage, zone]["mean_friction_work"] for zone in zones) for stage in stages}
        sentences.append(f"{law}: " + ", ".join(f"{number(done)} N mm in {stage}" for stage, done in work.items()))
    return svg(
        fig,
        "Work of friction",
        f"Mean over the samples, with its 95 % interval. Over all zones, {'; '.join(sentences)}.",
    )


def path_error_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Distribution of the estimated path error, and comparison with the error measured on a tighter path."""
    shown = {
        (law, stage): outcome.path_error(law, stage, outcome.sample_numbers(law)[:SHOWN])
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
        found = {law: 1e3 * shown[law, stage] for law in laws if (law, stage) in shown}
        everything = np.concatenate([error[error > 0] for error in found.values()])
        edges = np.geomspace(0.9 * everything.min(), 1.1 * everything.max(), 31)
        for law, error in found.items():
            clipped = np.maximum(error, edges[0])
            ax.hist(clipped, bins=edges.tolist(), histtype="stepfilled", color=LAWS[law].colour, alpha=0.2, lw=0)
            ax.hist(clipped, bins=edges.tolist(), histtype="step", color=LAWS[law].colour, lw=1.2)
        ax.set(xscale="log", xlabel="estimated error (µm)", title=f"stage {stage}")
        _ticks(ax.xaxis, edges[0], edges[-1])
    axes[0].set_ylabel("samples")
    if beside:
        ends = [np.inf, 0.0]
        for law, errors in beside.items():
            x, y = (1e3 * errors[name].to_numpy() for name in ("estimate", "measured"))
            axes[-1].plot(x, y, LAWS[law].mark, ms=4, mew=0, color=LAWS[law].colour, alpha=0.85)
            known = np.concatenate([x, y])
            ends = [min(ends[0], known[known > 0].min(initial=np.inf)), max(ends[1], known.max())]
        axes[-1].plot(ends, ends, color="#333", lw=0.8)
        axes[-1].set(xscale="log", yscale="log", xlabel="estimated error (µm)", ylabel="measured (µm)")
        axes[-1].set_title("repeated samples, after each stage")
        _ticks(axes[-1].xaxis, *ends)
        _ticks(axes[-1].yaxis, *ends)
    law_legend(fig, laws)
    sentences = []
    for law in laws:
        by_stage = []
        for stage in stages:
            if (law, stage) in shown:
                middle, worst = (number(1e3 * float(f(shown[law, stage])), 2) for f in (np.median, np.max))
                by_stage.append(f"median {middle} µm and largest {worst} µm in {stage}")
        sentences.append(f"{law}: {', '.join(by_stage)}" + (_coverage(beside[law]) if law in beside else ""))
    return svg(
        fig,
        "Estimated error of the path",
        f"Error of the contacts' tangential positions, root mean square over the pairs. {'; '.join(sentences)}.",
    )


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
    return text


def _rows(outcome, law) -> dict[tuple[str, str], dict]:
    """Statistics by stage and zone."""
    table = outcome.zone_statistics
    return {(row["stage"], row["zone"]): row for row in table[table["law"] == law].to_dict("records")}


def _laws(outcome, context) -> list[str]:
    """Laws with friction."""
    if not (outcome.has_slip and outcome.stages):
        return []
    return [law for law in context.laws if LAWS[law].frictional]
