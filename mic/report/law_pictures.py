"""Pictures that compare the contact laws: errors of the associated law, results over the friction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.contact.law_comparison import summarise
from mic.report.context import SHOWN, Context
from mic.report.picture import Picture, law_legend, panels, svg, wide
from mic.report.style import LAWS, STATE_COLOURS, number, percent
from mic.results.outcome import Outcome

__all__ = ["LawCost", "friction_picture", "law_cost", "law_cost_picture"]


#: Column, label and factor of each quantity of a friction study.
STUDIED = (
    ("slip", "RMS slip, all contacts (mm)", 1),
    ("normal_force", "total normal force (N)", 1),
    ("gap_at_load", "largest gap under load (µm)", 1e3),
)


@dataclass(frozen=True)
class LawCost:
    """Differences between the associated law (13) and Coulomb's, over n samples valid under both and m contacts.

    Attributes
    ----------
    gaps : (k,) array
        Gaps of the contacts that are loaded under the associated law, mm; Coulomb's law keeps them closed.
    coulomb, associated : (n, m) arrays
        Normal forces, N.
    states : (3, 3) array
        Share of contacts and samples by state under Coulomb's law (row) and under the associated one (column).
    """

    gaps: np.ndarray
    coulomb: np.ndarray
    associated: np.ndarray
    states: np.ndarray

    @property
    def sentence(self) -> str:
        """The cost in words; errors of forces are relative to their sum under Coulomb's law in the same sample."""
        n, total = len(self.coulomb), self.coulomb.sum(axis=1)
        loaded, error = total > 0, self.associated - self.coulomb
        text = f"Over the {'first ' * (n == SHOWN)}{n} samples valid under both laws: "
        if len(self.gaps):
            text += (
                f"under the associated law {percent(float(np.mean(self.gaps > 1e-3)))} of the loaded contacts have "
                f"gaps above 1 µm (all loaded contacts: median {number(np.median(self.gaps) * 1e3)} µm, "
                f"largest {number(self.gaps.max() * 1e3)} µm), which Coulomb's law keeps closed; "
            )
        if loaded.any():
            each = np.abs(error).sum(axis=1)[loaded] / total[loaded]
            whole = np.abs(error.sum(axis=1))[loaded] / total[loaded]
            text += f"normal forces are wrong by {percent(each.mean(), 1)} of their sum on average "
            text += f"({percent(each.max(), 1)} in the worst sample), the sum itself by {percent(whole.mean(), 1)}; "
        return text + f"{percent(1 - np.trace(self.states), 1)} of all contact states differ."


def law_cost(outcome: Outcome, stage: str) -> LawCost | None:
    """Numbers behind :func:`law_cost_picture`; None unless both laws were run, with slip, and share a valid sample."""
    if not outcome.has_slip or not {"coulomb", "associated"} <= set(outcome.laws):
        return None
    common = np.intersect1d(outcome.with_pairs("coulomb"), outcome.with_pairs("associated"))[:SHOWN]
    if not len(common):
        return None
    get = lambda law, column: outcome.contact(law, stage, column, common)
    f, a = get("coulomb", "f_n"), get("associated", "f_n")
    states = np.zeros((len(STATE_COLOURS), len(STATE_COLOURS)))
    np.add.at(states, (get("coulomb", "state").ravel(), get("associated", "state").ravel()), 1 / f.size)
    return LawCost(get("associated", "u_n")[get("associated", "state") > 0], f, a, states)


def law_cost_picture(outcome: Outcome, context: Context) -> Picture | None:
    """Errors of the associated law (13) against Coulomb's: gaps at loaded contacts, normal forces, states."""
    cost = law_cost(outcome, context.stage) if context.stage else None
    if cost is None:
        return None
    fig, (gap, force, state) = wide(3.1, 1, 3)
    gaps = np.maximum(cost.gaps, 0) * 1e3
    upper = max(np.quantile(gaps, 0.995), 1e-9) if len(gaps) else 1.0
    gap.hist(np.minimum(gaps, upper), bins=40, color=LAWS["associated"].colour, alpha=0.8)
    gap.axvline(0, color=LAWS["coulomb"].colour, lw=2.5, label="coulomb: closed")
    gap.set(xlabel="gap at loaded contacts under associated (µm)", ylabel="contacts × samples", title="Spurious gaps")
    gap.margins(y=0.25)
    gap.legend(loc="upper right")
    x, y = cost.coulomb.ravel(), cost.associated.ravel()
    top = max(x.max(initial=0), y.max(initial=0), 1e-9) * 1.04
    limits = (0, top)
    force.hexbin(x, y, gridsize=45, bins="log", mincnt=1, cmap="YlOrBr", extent=(0, top, 0, top), lw=0.1)
    force.plot(limits, limits, color="#333", lw=0.8)
    force.set(xlabel="$f_n$, coulomb (N)", ylabel="$f_n$, associated (N)", title="Normal forces")
    force.set(xlim=limits, ylim=limits)
    state.imshow(np.sqrt(cost.states), cmap="Oranges", vmin=0, vmax=1)
    for (i, j), value in np.ndenumerate(cost.states):
        colour = "white" if value > 0.5 else "black"
        state.text(j, i, percent(value, 1), ha="center", va="center", color=colour)
    ticks, names = range(len(STATE_COLOURS)), list(STATE_COLOURS)
    state.set(xticks=ticks, yticks=ticks, xticklabels=names, yticklabels=names)
    state.set(xlabel="associated", ylabel="coulomb", title="States, share of contacts × samples")
    state.grid(False)
    return svg(fig, f"Associated law (13) against Coulomb's law, stage {context.stage}", cost.sentence)


def friction_picture(outcome: Outcome, context: Context) -> Picture | None:
    """The laws on some samples against scaled friction, from the run's friction study."""
    study = outcome.friction_study
    if study is None or not outcome.stages:
        return None
    table, laws = summarise(study), [law for law in LAWS if law in set(study["law"])]
    here = outcome.model.contacts.friction_in(outcome.stages[0]).coefficient.mean()
    fig, axes = panels(3, 3, (3.5, 2.6))
    for ax, (column, label, factor) in zip(axes, STUDIED):
        for law in laws:
            rows, look = table.xs(law, level="law"), LAWS[law]
            ax.plot(rows.index, factor * rows[column], look.mark + "-", ms=4, lw=1.3, color=look.colour)
        ax.axvline(here, color="#8a949f", lw=0.9, ls="--")
        top = 1.08 * factor * table[column].max() or 1.0
        ax.set(xlabel="friction coefficient, mean over contacts", ylabel=label, xlim=(0, None), ylim=(0, top))
    law_legend(fig, laws)
    gaps = table.xs("associated", level="law")["gap_at_load"]
    ends = " and ".join(f"{number(1e3 * gaps.iloc[i])} µm at μ = {number(gaps.index[i], 2)}" for i in (0, -1))
    text = (
        f"{study['sample'].nunique()} samples, stage {context.stage}, solved with all friction coefficients scaled; "
        f"dashed: the scene's. The largest gap under load of the associated law averages {ends}; Coulomb's law has "
        "none."
    )
    left_out = int(table["left_out"].sum())
    if left_out:
        text += f" {left_out} of {len(study)} solutions did not converge and are excluded."
    return svg(fig, "Contact laws against friction", text)
