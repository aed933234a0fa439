"""Pictures of the contacts under each law: tangential displacement, forces, one sample, states."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mic.report.context import SHOWN, Context
from mic.report.picture import Picture, law_legend, panels, svg
from mic.report.style import LAWS, STATE_COLOURS, STATE_WORDS, number, percent, zone_colour
from mic.results.outcome import Outcome
from mic.statistics.estimates import density

__all__ = ["sample_picture", "slip_force_picture", "state_picture", "tangential_density_picture"]

ACTIVE = 1.0  # N: least mean friction force of an active contact (the paper's smallest)


def tangential_density_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Probability density of each zone's RMS tangential displacement, one panel per zone (Fig. 7 of the paper)."""
    stage = context.stage
    if not (outcome.has_slip and stage and context.laws):
        return None
    columns = min(3, len(outcome.zones))
    fig, axes = panels(len(outcome.zones), columns, (3.5, 2.5))
    for i, (ax, zone) in enumerate(zip(axes, outcome.zones)):
        moved = {law: outcome.tangential(law, stage, zone, outcome.sample_numbers(law)[:SHOWN]) for law in context.laws}
        everything = np.concatenate(list(moved.values()))
        margin = 0.15 * (np.ptp(everything) or abs(everything[0]) or 1.0)
        grid = np.linspace(everything.min() - margin, everything.max() + margin, 300)
        for law, x in moved.items():
            colour, curve = LAWS[law].colour, density(x, grid)
            if np.isfinite(curve).all():
                ax.fill_between(grid, curve, color=colour, alpha=0.18, lw=0)
                ax.plot(grid, curve, color=colour, lw=1.6)
            ax.axvline(x.mean(), color=colour, lw=1, ls="--")
        ax.set(xlim=(max(0.0, grid[0]), grid[-1]), ylim=(0, None), xlabel="RMS tangential displacement (mm)")
        ax.set_title(zone, color=zone_colour(i))
        if i % columns == 0:
            ax.set_ylabel("density (1/mm)")
    law_legend(fig, outcome.laws)
    count = outcome.record["samples"]
    text = (
        f"Kernel densities over {'the first ' * (count > SHOWN)}{min(count, SHOWN)} samples, including open contacts "
    )
    text += "as in the paper; dashed: means. " + _motion_sentence(outcome, context)
    return svg(fig, f"Probability density of the zones' RMS tangential displacement, stage {stage}", text)


def slip_force_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Mean and 6σ of the friction force at each contact, against a measured range where one is published (Fig. 4)."""
    laws = [law for law in outcome.laws if LAWS[law].frictional]
    if not (outcome.has_slip and context.stage and laws):
        return None
    table = outcome.contact_statistics
    table = table[table["stage"] == context.stage]
    fig, axes = panels(2, 1, (10.5, 2.3), sharex=True)
    measured = context.published.get("slip_force")
    if measured:
        low, high, mean = (measured[f"measured_{name}"] for name in ("low", "high", "mean"))
        label = f"measured range {number(low)}–{number(high)} N (paper)"
        axes[0].axhspan(low, high, color="#f2d95c", alpha=0.35, lw=0, zorder=0, label=label)
        axes[0].axhline(mean, color="#a8860a", lw=1, ls="--", label=f"measured mean {number(mean)} N (paper)")
    for law in laws:
        rows, look = table[table["law"] == law], LAWS[law]
        for ax, name in zip(axes, ("mean_slip_force", "six_sigma_slip_force")):
            ax.plot(rows["contact"], rows[name], look.mark, ms=3.6, mew=0, color=look.colour, alpha=0.85, label=law)
    axes[0].set(ylabel=r"mean $\Vert f_t\Vert$ (N)", ylim=(0, None))
    axes[1].set(ylabel=r"6σ of $\Vert f_t\Vert$ (N)", ylim=(0, None), xlabel="contact")
    _zone_strips(outcome, axes)
    axes[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1.16), borderaxespad=0)
    force = table[table["law"] == laws[0]]["mean_slip_force"].to_numpy()
    active = force[force >= ACTIVE]
    text = f"Under {laws[0]}, {len(active)} of {len(force)} contacts carry a mean friction force of {number(ACTIVE)} N "
    text += "or more"
    if len(active):
        text += f" ({number(active.min())} to {number(active.max())} N, mean {number(active.mean())} N)"
    if measured:
        inside = (active >= low) & (active <= high)
        text += f"; {inside.sum()} of them lie within the range that the paper measured on another geometry, "
        text += "which compares orders of magnitude only"
    return svg(fig, f"Friction force at each contact, stage {context.stage}", text + ".")


def sample_picture(outcome: Outcome, context: Context, quantity: Literal["f", "u"]) -> Picture | None:
    """Forces or displacements of one sample at each contact, with friction and without (Figs. 5 and 6).

    Parameters
    ----------
    quantity : {"f", "u"}
        Forces in N, or displacements in mm.
    """
    stage = context.stage
    laws = [law for law in (context.frictional, context.frictionless) if law]
    if not (len(outcome.model.contacts) and stage and laws):
        return None
    common = reduce(np.intersect1d, [outcome.with_pairs(law) for law in laws])
    if not len(common):
        return None
    axes_names = ("n", "t1", "t2") if outcome.has_slip else ("n",)
    title, unit = {"f": ("Forces", "N"), "u": ("Displacements", "mm")}[quantity]
    fig, axes = panels(len(axes_names), 1, (10.5, 1.75), sharex=True)
    values = {}
    for ax, axis in zip(axes, axes_names):
        for law in laws:
            values[law, axis] = outcome.contact(law, stage, f"{quantity}_{axis}", common[:1])[0]
            line, look = _by_zone(outcome, values[law, axis]), LAWS[law]
            ax.plot(*line, look.mark + "-", ms=3.4, mew=0, lw=0.6, color=look.colour, alpha=0.85)
        ax.set_ylabel(f"${quantity}_{{{axis}}}$ ({unit})")
    axes[-1].set_xlabel("contact")
    _zone_strips(outcome, axes)
    law_legend(fig, laws)
    sentences = []
    for law in laws:
        normal = values[law, "n"]
        if quantity == "f":
            text = f"total normal force {number(normal.sum())} N at {(normal > 0).sum()} closed contacts"
        else:
            text = f"largest gap {number(normal.max())} mm"
            if outcome.has_slip:
                farthest = np.hypot(values[law, "t1"], values[law, "t2"]).max()
                text += f", largest tangential displacement {number(farthest)} mm"
        sentences.append(f"{law}: {text}")
    text = f"Sample {common[0]}, stage {stage}. {'; '.join(sentences)}."
    return svg(fig, f"{title} of one sample at each contact", text)


def state_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Share of the samples in which each contact is open, sticking or slipping, one panel per stage and law."""
    shown = [(law, stage) for stage in outcome.stages for law in context.laws]
    if not (len(outcome.model.contacts) and shown):
        return None
    table, laws = outcome.contact_statistics, len(context.laws)
    fig, axes = panels(len(shown), laws, (10.5 / laws, 1.7), sharex=True, sharey=True)
    sentences = []
    for i, (ax, (law, stage)) in enumerate(zip(axes, shown)):
        rows = table[(table["law"] == law) & (table["stage"] == stage)]
        edges = np.arange(len(rows) + 1) - 0.5
        base = np.zeros(len(rows))
        for state, colour in STATE_COLOURS.items():
            top = base + rows[state].to_numpy()
            ax.stairs(top, edges, baseline=base, fill=True, color=colour, lw=0)
            base = top
        ax.set(xlim=(edges[0], edges[-1]), ylim=(0, 1))
        ax.set_title(f"{law}, {stage}", color=LAWS[law].colour, pad=8)
        ax.grid(False)
        if i % laws == 0:
            ax.set_ylabel("share of samples")
        if i >= len(shown) - laws:
            ax.set_xlabel("contact")
        if i < laws:
            shares = (f"{percent(rows[state].mean())} {word}" for state, word in STATE_WORDS.items())
            sentences.append(f"{law}: {', '.join(shares)}")
    _zone_strips(outcome, axes, names=False)
    square: dict[str, Any] = {"marker": "s", "ls": "", "ms": 8}
    handles = [Line2D([], [], color=colour, label=state, **square) for state, colour in STATE_COLOURS.items()]
    fig.legend(handles=handles, loc="outside upper left", ncols=3)
    text = f"Averaged over contacts and samples after stage {outcome.stages[0]}: {'; '.join(sentences)}. "
    text += "Without friction every closed contact slips."
    return svg(fig, "Open, sticking, slipping at the end of a stage", text)


def _motion_sentence(outcome, context):
    """Sentence on the change of the tangential displacement's mean and spread by friction, zone by zone."""
    frictional, frictionless = context.frictional, context.frictionless
    if frictional is None or frictionless is None:
        return ""
    table = outcome.zone_headlines
    table = table[table["stage"] == context.stage].set_index(["law", "zone"])
    parts = []
    for zone in outcome.zones:
        without, with_ = table.loc[(frictionless, zone)], table.loc[(frictional, zone)]
        change = [
            percent(with_[name] / without[name] - 1) if without[name] > 0 else "–"
            for name in ("mean_rms_tangential", "six_sigma_rms_tangential")
        ]
        parts.append(f"{zone} mean {change[0]}, 6σ {change[1]}")
    return f"Friction ({frictional} against {frictionless}) changes it by: {'; '.join(parts)}."


def _zone_strips(outcome: Outcome, axes: Sequence[Axes], names: bool = True) -> None:
    """Mark above the axes which contacts belong to which zone."""
    zone = outcome.model.contacts.zone
    for j, ax in enumerate(axes):
        ax.set_xlim(-0.5, len(zone) - 0.5)
        for i, name in enumerate(outcome.zones):
            members = np.flatnonzero(zone == i)
            if not len(members):
                continue
            colour = zone_colour(i)
            ax.axvspan(members[0] - 0.5, members[-1] + 0.5, 1.0, 1.035, color=colour, lw=0, clip_on=False)
            if j == 0 and names:
                style: dict[str, Any] = {"ha": "center", "va": "bottom", "color": colour, "fontweight": "bold"}
                ax.text(float(members.mean()), 1.05, name, transform=ax.get_xaxis_transform(), **style)


def _by_zone(outcome, values):
    """Contact numbers and values with a gap between zones, so that no line joins two zones."""
    ends = np.flatnonzero(np.diff(outcome.model.contacts.zone)) + 1
    numbers = np.arange(len(values), dtype=float)
    return np.insert(numbers, ends, np.nan), np.insert(np.asarray(values, dtype=float), ends, np.nan)
