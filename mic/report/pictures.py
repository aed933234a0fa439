"""Pictures of an outcome, each with a sentence that says in numbers what it shows.

Static pictures are drawn by matplotlib without pyplot, so that nothing global is touched. A law has the same colour in every
picture. A picture that the outcome cannot fill is not drawn: its function returns None.
"""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from functools import wraps

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.cm import ScalarMappable
from matplotlib.collections import TriMesh
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.tri import Triangulation

from mic.contact.comparison import summarise
from mic.contact.states import STATES
from mic.results.statistics import density

__all__ = [
    "LAW_COLOURS",
    "PART_COLOURS",
    "Picture",
    "assembly_picture",
    "field_picture",
    "friction_picture",
    "law_cost",
    "law_cost_picture",
    "measurement_picture",
    "number",
    "overview_picture",
    "percent",
    "sample_picture",
    "slip_density_picture",
    "slip_force_picture",
    "state_picture",
    "viewpoint",
    "zone_colour",
]

LAW_COLOURS = {"coulomb": "#0072b2", "associated": "#d55e00", "frictionless": "#5f6b76"}
LAW_MARKS = {"coulomb": "o", "associated": "s", "frictionless": "^"}
STATE_COLOURS = {"open": "#dfe4ea", "stick": "#56a37c", "slip": "#c8553d"}
PART_COLOURS = ("#a3c0dc", "#e3d1ab", "#b6cfae", "#cdb5cf", "#d8b0a4", "#a9cccb")
ZONE_COLOURS = ("#b3168a", "#0a8f5b", "#e08a00", "#3b4cc0", "#7a4a1e", "#008fb3", "#8a2be2", "#6f7f00")
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#58626e",
    "axes.grid": True,
    "grid.color": "#e8ebef",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "svg.hashsalt": "mic",
}
ACTIVE = 1.0  # N: from this mean friction force on, a contact counts as active (the paper's smallest)
MOST_PANELS = 24


@dataclass(frozen=True)
class Picture:
    """A drawn picture.

    Attributes
    ----------
    name : str
        Anchor in the report, and file name.
    title, caption : str
    data : bytes
    kind : {"svg", "png"}
    """

    name: str
    title: str
    caption: str
    data: bytes
    kind: str

    @property
    def uri(self) -> str:
        """The picture as a data URI, so that a page can hold it."""
        mime = {"svg": "image/svg+xml", "png": "image/png"}[self.kind]
        return f"data:{mime};base64,{base64.b64encode(self.data).decode()}"


def zone_colour(i: int) -> str:
    """Colour of the scene's i-th contact zone."""
    return ZONE_COLOURS[i % len(ZONE_COLOURS)]


def percent(value, digits: int = 0) -> str:
    """A share for people, in per cent; ``–`` for NaN."""
    return "–" if np.isnan(value) else f"{100 * value:.{digits}f} %".replace("-", "−")


def number(value, digits: int = 3) -> str:
    """A number for people: significant digits without exponents where they can be had; ``–`` for None and NaN."""
    if value is None or np.isnan(value):
        return "–"
    value = float(value)
    if np.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        exponent = int(f"{value:.{digits - 1}e}".split("e")[1])  # of the rounded value
        return f"{value:.{max(0, digits - 1 - exponent)}f}".replace("-", "−")
    return f"{value:.{digits - 1}e}".replace("-", "−")


def _styled(draw):
    """Draw under the pictures' own style, whatever the user's matplotlib settings."""

    @wraps(draw)
    def drawn(*args):
        with rc_context(STYLE):
            return draw(*args)

    return drawn


# ---------------------------------------------------------------------------------------------- statistics of the contacts


@_styled
def slip_density_picture(outcome, stage) -> Picture | None:
    """Probability density of each zone's RMS slip, one panel per zone (Fig. 7 of the paper)."""
    if not outcome.has_slip:
        return None
    zones = outcome.zones
    columns = min(3, len(zones))
    fig, axes = _panels(len(zones), columns, (3.5, 2.5))
    for i, (ax, zone) in enumerate(zip(axes, zones)):
        slips = {
            law: outcome.valid(law)[f"slip:{stage}:{zone}"].to_numpy()
            for law in outcome.laws
            if len(outcome.valid(law))
        }
        if not slips:
            return None
        everything = np.concatenate(list(slips.values()))
        margin = 0.15 * (np.ptp(everything) or abs(everything[0]) or 1.0)
        grid = np.linspace(everything.min() - margin, everything.max() + margin, 300)
        for law, slip in slips.items():
            curve = density(slip, grid)
            if np.isfinite(curve).all():
                ax.fill_between(grid, curve, color=LAW_COLOURS[law], alpha=0.18, lw=0)
                ax.plot(grid, curve, color=LAW_COLOURS[law], lw=1.6, label=law)
            ax.axvline(
                slip.mean(), color=LAW_COLOURS[law], lw=1, ls="--", label=None if np.isfinite(curve).all() else law
            )
        ax.set_xlim(max(0.0, grid[0]), grid[-1])
        ax.set_ylim(0)
        ax.set_title(zone, color=zone_colour(i))
        ax.set_xlabel("RMS slip (mm)")
        if i % columns == 0:
            ax.set_ylabel("density (1/mm)")
    _law_legend(fig, outcome.laws)
    return _svg(
        fig,
        "slip-density",
        f"Probability density of the zones' RMS slip, stage {stage}",
        f"Kernel densities of the RMS slip over {outcome.record['samples']} samples; dashed: means. "
        + _slip_sentence(outcome, stage),
    )


@_styled
def slip_force_picture(outcome, stage, published) -> Picture | None:
    """Mean and 6σ of the friction force at each contact, against a measured range where one is published (Fig. 4)."""
    laws = [law for law in outcome.laws if law != "frictionless"]
    if not (outcome.has_slip and laws):
        return None
    table = outcome.contact_statistics
    table = table[table["stage"] == stage]
    fig, axes = _panels(2, 1, (10.5, 2.3), sharex=True)
    measured = published.get("slip_force") if published else None
    if measured:
        axes[0].axhspan(
            measured["measured_low"],
            measured["measured_high"],
            color="#f2d95c",
            alpha=0.35,
            lw=0,
            zorder=0,
            label=f"measured range {number(measured['measured_low'])}–{number(measured['measured_high'])} N (paper)",
        )
        axes[0].axhline(
            measured["measured_mean"],
            color="#a8860a",
            lw=1,
            ls="--",
            label=f"measured mean {number(measured['measured_mean'])} N (paper)",
        )
    for law in laws:
        rows = table[table["law"] == law]
        for ax, name in zip(axes, ("mean_slip_force", "six_sigma_slip_force")):
            ax.plot(
                rows["contact"],
                rows[name],
                LAW_MARKS[law],
                ms=3.6,
                mew=0,
                color=LAW_COLOURS[law],
                alpha=0.85,
                label=law,
            )
    axes[0].set_ylabel(r"mean $\Vert f_t\Vert$ (N)")
    axes[1].set_ylabel(r"6σ of $\Vert f_t\Vert$ (N)")
    axes[1].set_xlabel("contact")
    axes[0].set_ylim(0)
    axes[1].set_ylim(0)
    _zone_strips(outcome, axes)
    axes[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1.16), borderaxespad=0)
    rows = table[table["law"] == laws[0]]
    force = rows["mean_slip_force"].to_numpy()
    active = force >= ACTIVE
    text = f"Under {laws[0]}, {active.sum()} of {len(force)} contacts carry a mean friction force of {number(ACTIVE)} N or more"
    if active.any():
        text += f" ({number(force[active].min())} to {number(force[active].max())} N, mean {number(force[active].mean())} N)"
    if measured:
        inside = (force[active] >= measured["measured_low"]) & (force[active] <= measured["measured_high"])
        text += (
            f"; {inside.sum()} of them lie within the range that the paper measured on another geometry: an order of magnitude, "
            "no validation"
        )
    return _svg(fig, "slip-force", f"Friction force at each contact, stage {stage}", text + ".")


@_styled
def sample_picture(outcome, stage, quantity) -> Picture | None:
    """Forces (``"f"``) or displacements (``"u"``) of one sample at each contact, with friction and without (Figs. 5 and 6)."""
    frictional = next((law for law in outcome.laws if law != "frictionless"), None)
    laws = [law for law in (frictional, "frictionless") if law in outcome.laws]
    if not len(outcome.model.contacts) or not laws:
        return None
    common = sorted(set.intersection(*(set(outcome.valid(law)["sample"]) for law in laws)))
    if not common:
        return None
    axes_names = ("n", "t1", "t2") if outcome.has_slip else ("n",)
    title, unit = {"f": ("Forces", "N"), "u": ("Displacements", "mm")}[quantity]
    fig, axes = _panels(len(axes_names), 1, (10.5, 1.75), sharex=True)
    values = {}
    for law in laws:
        row = int(np.flatnonzero(outcome.valid(law)["sample"].to_numpy() == common[0])[0])
        for ax, axis in zip(axes, axes_names):
            values[law, axis] = outcome.contact(law, stage, f"{quantity}_{axis}")[row]
            ax.plot(
                *_by_zone(outcome, values[law, axis]),
                LAW_MARKS[law] + "-",
                ms=3.4,
                mew=0,
                lw=0.6,
                color=LAW_COLOURS[law],
                alpha=0.85,
            )
    for ax, axis in zip(axes, axes_names):
        ax.set_ylabel(f"${quantity}_{{{axis}}}$ ({unit})")
    axes[-1].set_xlabel("contact")
    _zone_strips(outcome, axes)
    _law_legend(fig, laws)
    text = f"Sample {common[0]}, stage {stage}. "
    if quantity == "f":
        text += "; ".join(
            f"{law}: total normal force {number(values[law, 'n'].sum())} N at {(values[law, 'n'] > 0).sum()} closed contacts"
            for law in laws
        )
    else:
        text += "; ".join(
            f"{law}: largest gap {number(values[law, 'n'].max())} mm"
            + (
                f", largest slip {number(np.hypot(values[law, 't1'], values[law, 't2']).max())} mm"
                if outcome.has_slip
                else ""
            )
            for law in laws
        )
    return _svg(fig, f"one-sample-{quantity}", f"{title} of one sample at each contact", text + ".")


@_styled
def state_picture(outcome) -> Picture | None:
    """Share of the samples in which each contact is open, sticking or slipping, one panel per stage and law."""
    if not len(outcome.model.contacts) or not outcome.stages:
        return None
    table = outcome.contact_statistics
    panels = [(law, stage) for stage in outcome.stages for law in outcome.laws if len(outcome.valid(law))]
    if not panels:
        return None
    laws = len(panels) // len(outcome.stages)
    fig, axes = _panels(len(panels), laws, (10.5 / laws, 1.7), sharex=True, sharey=True)
    sentences = []
    for i, (ax, (law, stage)) in enumerate(zip(axes, panels)):
        rows = table[(table["law"] == law) & (table["stage"] == stage)]
        edges = np.arange(len(rows) + 1) - 0.5
        base = np.zeros(len(rows))
        for state in STATES:
            top = base + rows[state].to_numpy()
            ax.stairs(top, edges, baseline=base, fill=True, color=STATE_COLOURS[state], lw=0)
            base = top
        ax.set(xlim=(edges[0], edges[-1]), ylim=(0, 1))
        ax.set_title(f"{law}, {stage}", color=LAW_COLOURS[law], pad=8)
        ax.grid(False)
        if i % laws == 0:
            ax.set_ylabel("share of samples")
        if i >= len(panels) - laws:
            ax.set_xlabel("contact")
        if i < laws:
            shares = (
                f"{percent(rows[state].mean())} {word}" for state, word in zip(STATES, ("open", "sticking", "slipping"))
            )
            sentences.append(f"{law}: {', '.join(shares)}")
    _zone_strips(outcome, axes, names=False)
    handles = [Line2D([], [], marker="s", ls="", ms=8, color=STATE_COLOURS[state], label=state) for state in STATES]
    fig.legend(handles=handles, loc="outside upper left", ncols=3)
    return _svg(
        fig,
        "states",
        "Open, sticking, slipping",
        f"Averaged over contacts and samples after stage {outcome.stages[0]}: "
        f"{'; '.join(sentences)}. Without friction every closed contact slips.",
    )


@_styled
def law_cost_picture(outcome, stage) -> Picture | None:
    """What the associated law (13) costs against Coulomb's: gaps at loaded contacts, normal forces, states."""
    cost = law_cost(outcome, stage)
    if cost is None:
        return None
    fig = Figure(figsize=(10.5, 3.1), layout="constrained")
    gap, force, state = fig.subplots(1, 3)
    gaps = np.maximum(cost["gaps"], 0) * 1e3
    upper = max(np.quantile(gaps, 0.995), 1e-9) if len(gaps) else 1.0
    gap.hist(np.minimum(gaps, upper), bins=40, color=LAW_COLOURS["associated"], alpha=0.8)
    gap.axvline(0, color=LAW_COLOURS["coulomb"], lw=2.5, label="coulomb: closed")
    gap.set(xlabel="gap at loaded contacts under associated (µm)", ylabel="contacts × samples", title="Spurious gaps")
    gap.margins(y=0.25)
    gap.legend(loc="upper right")
    x, y = cost["f_coulomb"], cost["f_associated"]
    top = max(x.max(initial=0), y.max(initial=0), 1e-9) * 1.04
    force.hexbin(x, y, gridsize=45, bins="log", mincnt=1, cmap="YlOrBr", extent=(0, top, 0, top), lw=0.1)
    force.plot([0, top], [0, top], color="#333", lw=0.8)
    force.set(
        xlabel="$f_n$, coulomb (N)", ylabel="$f_n$, associated (N)", title="Normal forces", xlim=(0, top), ylim=(0, top)
    )
    matrix = cost["states"]
    state.imshow(np.sqrt(matrix), cmap="Oranges", vmin=0, vmax=1)
    for i in range(3):
        for j in range(3):
            state.text(
                j,
                i,
                percent(matrix[i, j], 1),
                ha="center",
                va="center",
                color="white" if matrix[i, j] > 0.5 else "black",
            )
    state.set(
        xticks=range(3),
        yticks=range(3),
        xticklabels=STATES,
        yticklabels=STATES,
        xlabel="associated",
        ylabel="coulomb",
        title="States, share of contacts × samples",
    )
    state.grid(False)
    return _svg(fig, "law-cost", f"Associated law (13) against Coulomb's law, stage {stage}", cost["sentence"])


def law_cost(outcome, stage) -> dict | None:
    """Numbers behind :func:`law_cost_picture`, over the samples valid under both laws; None unless both were run with friction."""
    if not outcome.has_slip or not {"coulomb", "associated"} <= set(outcome.laws):
        return None
    samples = {law: outcome.valid(law)["sample"].to_numpy() for law in ("coulomb", "associated")}
    common = np.intersect1d(*samples.values())
    if not len(common):
        return None
    pick = {law: np.isin(samples[law], common) for law in samples}
    get = lambda law, column: outcome.contact(law, stage, column)[pick[law]]
    f, a = get("coulomb", "f_n"), get("associated", "f_n")
    loaded = get("associated", "state") > 0
    gaps = get("associated", "u_n")[loaded]
    states = np.zeros((3, 3))
    np.add.at(states, (get("coulomb", "state").ravel(), get("associated", "state").ravel()), 1 / f.size)
    total = f.sum(axis=1)
    ratio = np.divide(np.abs(a - f).sum(axis=1), total, out=np.full(len(total), np.nan), where=total > 0)
    balance = np.divide(a.sum(axis=1) - total, total, out=np.full(len(total), np.nan), where=total > 0)
    changed = 1 - np.trace(states)
    sentence = f"Over the {len(common)} samples valid under both laws: "
    if len(gaps):
        sentence += (
            f"under the associated law {percent(np.mean(gaps > 1e-3))} of the loaded contacts stand open by more than 1 µm while "
            f"they carry force (median {number(np.median(gaps) * 1e3)} µm, largest {number(gaps.max() * 1e3)} µm), where Coulomb's "
            "law keeps them closed; "
        )
    if np.isfinite(ratio).any():
        sentence += (
            f"normal forces are wrong by {percent(np.nanmean(ratio), 1)} of their sum on average "
            f"({percent(np.nanmax(ratio), 1)} in the worst sample), the sum itself by {percent(np.nanmean(np.abs(balance)), 1)}; "
        )
    sentence += f"{percent(changed, 1)} of all contact states differ."
    return {
        "samples": len(common),
        "gaps": gaps,
        "f_coulomb": f.ravel(),
        "f_associated": a.ravel(),
        "states": states,
        "changed": changed,
        "force_error": ratio,
        "total_error": balance,
        "sentence": sentence,
    }


@_styled
def friction_picture(outcome, stage) -> Picture | None:
    """The three laws on some of the samples as friction is scaled down and up; drawn where the associated law was asked for."""
    study = outcome.friction_study
    if study is None:
        return None
    table = summarise(study)
    fig, axes = _panels(3, 3, (3.5, 2.6))
    for ax, (column, label, factor) in zip(
        axes,
        (
            ("slip", "RMS slip, all contacts (mm)", 1),
            ("normal_force", "total normal force (N)", 1),
            ("gap_at_load", "largest gap at a loaded contact (µm)", 1e3),
        ),
    ):
        for law in LAW_COLOURS:
            rows = table.xs(law, level="law")
            ax.plot(rows.index, factor * rows[column], LAW_MARKS[law] + "-", ms=4, lw=1.3, color=LAW_COLOURS[law])
        ax.axvline(outcome.model.contacts.friction.mean(), color="#8a949f", lw=0.9, ls="--")
        ax.set(xlabel="friction coefficient, mean over contacts", ylabel=label, xlim=(0, None), ylim=(0, None))
    _law_legend(fig, list(LAW_COLOURS))
    gaps = table.xs("associated", level="law")["gap_at_load"]
    ends = " and ".join(f"{number(1e3 * gaps.iloc[i])} µm at μ = {number(gaps.index[i], 2)}" for i in (0, -1))
    text = (
        f"{study['sample'].nunique()} samples, stage {stage}, solved anew with every friction coefficient scaled; dashed: the scene's. "
        f"The largest gap that the associated law opens under load averages {ends}; Coulomb's law has none."
    )
    left_out = int(table["left_out"].sum())
    if left_out:
        text += f" {left_out} of {len(study)} solutions did not converge and are left out."
    return _svg(fig, "friction", "The laws as friction grows", text)


@_styled
def measurement_picture(outcome) -> Picture | None:
    """Histogram of every key characteristic with its limits; of the least capable where there are many."""
    table = outcome.measurement_statistics
    if not len(table):
        return None
    order = list(table["measurement"].unique())
    shown = order
    if len(order) > MOST_PANELS:
        worst = table.groupby("measurement")["cpk"].min().sort_values(na_position="last").index[:MOST_PANELS]
        shown = [name for name in order if name in set(worst)]
    columns = min(4, len(shown))
    fig, axes = _panels(len(shown), columns, (10.5 / max(columns, 2), 1.9))
    for i, (ax, name) in enumerate(zip(axes, shown)):
        item = next(item for item in outcome.model.scene.measurements if item.name == name)
        values = {
            law: outcome.valid(law)[f"measurement:{name}"].to_numpy() for law in outcome.laws if len(outcome.valid(law))
        }
        everything = np.concatenate(list(values.values())) if values else np.zeros(1)
        low, high = everything.min(), everything.max()
        edges = np.linspace(low, high, 31) if high - low > 1e-12 else np.linspace(low - 1e-3, high + 1e-3, 31)
        for law, x in values.items():
            ax.hist(x, bins=edges, histtype="stepfilled", color=LAW_COLOURS[law], alpha=0.14, lw=0)
            ax.hist(x, bins=edges, histtype="step", color=LAW_COLOURS[law], lw=1.2)
        for limit in (item.lower, item.upper):
            ax.axvline(limit, color="#b00020", lw=1.3)
        width = item.upper - item.lower
        ax.set_xlim(min(low, item.lower) - 0.04 * width, max(high, item.upper) + 0.04 * width)
        ax.set_title(name)
        if i >= len(shown) - columns:
            ax.set_xlabel("deviation (mm)")
        if i % columns == 0:
            ax.set_ylabel("samples")
    handles = [Line2D([], [], color=LAW_COLOURS[law], lw=2, label=law) for law in outcome.laws]
    fig.legend(
        handles=[*handles, Line2D([], [], color="#b00020", lw=1.3, label="limits")], loc="outside upper left", ncols=4
    )
    law = outcome.laws[0]
    rows = table[table["law"] == law].reset_index(drop=True)
    text = (
        "" if len(shown) == len(order) else f"The {len(shown)} least capable of {len(order)} measurements are shown. "
    )
    if rows["cpk"].notna().any():
        worst = rows.loc[rows["cpk"].idxmin()]
        text += (
            f"Under {law} the least capable is {worst['measurement']}: Cpk {number(worst['cpk'])} (95 %: {number(worst['cpk_low'])} to "
            f"{number(worst['cpk_high'])}), {percent(worst['share_outside'], 1)} of the samples outside "
            f"(95 %: {percent(worst['share_outside_low'], 1)} to {percent(worst['share_outside_high'], 1)})."
        )
    return _svg(fig, "measurements", "Key characteristics against their limits", text)


# ---------------------------------------------------------------------------------------------- the assembly in space


def viewpoint(surfaces) -> np.ndarray:
    """(3,) unit vector towards the corner of space from which most of the surfaces is seen."""
    normal = np.concatenate([surface.normals * surface.areas[:, None] for surface in surfaces])
    corners = [
        np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
        for a in np.radians([-60, -30, 30, 60, 120, 150, 210, 240])
        for e in np.radians([20, 40])
    ]
    return max(corners, key=lambda d: float(np.abs(normal @ d).sum()))


class _View:
    """Orthographic view of the parts from their :func:`viewpoint`."""

    def __init__(self, surfaces):
        self.eye = viewpoint(surfaces)
        right = np.cross([0, 0, 1.0], self.eye)
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.eye, self.right)

    def flat(self, points):
        return np.column_stack([points @ self.right, points @ self.up])

    def draw(self, ax, surfaces, colours, shading):
        """Triangles of all surfaces, far ones first; colours: one rgb per surface, or one per vertex; the share `shading` of
        their brightness depends on the slope."""
        light = self.eye + 0.35 * self.up - 0.45 * self.right
        light /= np.linalg.norm(light)
        start = np.cumsum([0] + [len(surface.points) for surface in surfaces])
        points = np.concatenate([surface.points for surface in surfaces])
        triangles = np.concatenate([surface.triangles + first for surface, first in zip(surfaces, start)])
        bright = [1 - shading + shading * np.abs(surface.vertex_normals @ light) for surface in surfaces]
        rgb = np.concatenate([colour * share[:, None] for colour, share in zip(colours, bright)])
        order = np.argsort((points @ self.eye)[triangles].mean(axis=1))
        mesh = TriMesh(Triangulation(*self.flat(points).T, triangles[order]))
        mesh.set_facecolor(np.column_stack([rgb.clip(0, 1), np.ones(len(rgb))]))
        ax.add_collection(mesh)
        ax.autoscale_view()
        ax.set_aspect("equal")
        ax.set_axis_off()


@_styled
def assembly_picture(outcome, surfaces) -> Picture | None:
    """The parts with locators, clamps, welds, contact pairs and measurement points."""
    if not surfaces:
        return None
    scene, contacts = outcome.model.scene, outcome.model.contacts
    view = _View(list(surfaces.values()))
    fig = Figure(figsize=(10.5, 6.6), layout="constrained")
    ax = fig.subplots()
    colours = [np.array(to_rgb(PART_COLOURS[i % len(PART_COLOURS)])) for i in range(len(surfaces))]
    view.draw(ax, list(surfaces.values()), colours, 0.5)
    size = max(surface.diameter for surface in surfaces.values())
    handles = [
        Line2D([], [], marker="s", ls="", ms=9, color=colour, label=name) for name, colour in zip(surfaces, colours)
    ]
    for z, zone in enumerate(scene.zones):
        points = view.flat(contacts.point[contacts.zone == z])
        if len(points):
            ax.plot(*points.T, "o", ms=4, mew=0.3, mec="white", color=zone_colour(z))
            handles.append(
                Line2D([], [], marker="o", ls="", ms=6, color=zone_colour(z), label=f"{zone.name}: {len(points)} pairs")
            )
    for items, colour, label in ((scene.locators, "#1b1f24", "locator"), (scene.clamps, "#c1121f", "clamp")):
        for item in items:
            head = view.flat(np.array([item.point]))[0]
            tail = view.flat(np.array([item.point]) - 0.07 * size * np.array(item.direction))[0]
            if np.linalg.norm(head - tail) > 0.01 * size:
                ax.annotate(
                    "",
                    head,
                    tail,
                    arrowprops={
                        "arrowstyle": "-|>",
                        "color": colour,
                        "lw": 1.3,
                        "shrinkA": 0,
                        "shrinkB": 0,
                        "mutation_scale": 9,
                    },
                )
            else:
                ax.plot(*head, "x", color=colour, ms=5)
        if items:
            handles.append(Line2D([], [], marker=">", ls="-", ms=5, color=colour, label=f"{label} ({len(items)})"))
    if scene.welds:
        ax.plot(
            *view.flat(np.array([weld.point for weld in scene.welds])).T,
            "o",
            ms=9,
            color="#f4d35e",
            mec="#1b1f24",
            mew=1.2,
        )
        handles.append(
            Line2D([], [], marker="o", ls="", ms=8, color="#f4d35e", mec="#1b1f24", label=f"weld ({len(scene.welds)})")
        )
    if scene.measurements:
        flat = view.flat(np.array([item.point for item in scene.measurements]))
        ax.plot(*flat.T, "D", ms=5, color="white", mec="#1b1f24", mew=1)
        for item, position in zip(scene.measurements[:MOST_PANELS], flat):
            ax.annotate(item.name, position, xytext=(5, 4), textcoords="offset points", fontsize=8)
        handles.append(
            Line2D(
                [],
                [],
                marker="D",
                ls="",
                ms=5,
                color="white",
                mec="#1b1f24",
                label=f"measurement ({len(scene.measurements)})",
            )
        )
    fig.legend(handles=handles, loc="outside right upper", fontsize=9)
    kinds = {
        "locator": len(scene.locators),
        "clamp": len(scene.clamps),
        "weld": len(scene.welds),
        "contact pair": len(contacts),
        "measurement point": len(scene.measurements),
    }
    text = (
        f"{len(surfaces)} {'part' if len(surfaces) == 1 else 'parts'} with "
        + ", ".join(f"{count} {kind}{'' if count == 1 else 's'}" for kind, count in kinds.items() if count)
        + ". Arrows point the way a locator or clamp acts."
    )
    return _png(fig, "assembly", "The assembly", text, 110)


@_styled
def overview_picture(outcome, surfaces, fields, law) -> Picture | None:
    """The assembly coloured by the 6σ of its displacement under one law, with contact pairs and welds."""
    fields = {field.part: field for field in fields if field.law == law}
    if set(fields) != set(surfaces) or not surfaces:
        return None
    spread = {part: np.nan_to_num(fields[part].six_sigma_magnitude) for part in surfaces}
    top = max(values.max() for values in spread.values())
    scale = Normalize(0.0, top or 1.0)
    fig = Figure(figsize=(9.5, 5.6), layout="constrained")
    ax = fig.subplots()
    view = _View(list(surfaces.values()))
    view.draw(
        ax, list(surfaces.values()), [colormaps["YlOrRd"](scale(values))[:, :3] for values in spread.values()], 0.35
    )
    handles = []
    welds = np.array([weld.point for weld in outcome.model.scene.welds]).reshape(-1, 3)
    for points, label, style in (
        (outcome.model.contacts.point, "contact pairs", {"ms": 3, "mew": 0.5, "color": "white"}),
        (welds, "welds", {"ms": 9, "mew": 1.2, "color": "#4cc9f0"}),
    ):
        if len(points):
            handles += ax.plot(*view.flat(points).T, "o", mec="#1b1f24", label=f"{len(points)} {label}", **style)
    fig.colorbar(ScalarMappable(scale, "YlOrRd"), ax=ax, label="6σ of the displacement (mm)", shrink=0.7)
    fig.legend(handles=handles, loc="outside lower left", ncols=2)
    return _png(
        fig,
        "overview",
        "Variation of the assembly",
        f"6σ displacement of the assembly under {law}: at most {number(top)} mm.",
        100,
    )


@_styled
def field_picture(surfaces, fields, law) -> Picture | None:
    """Mean and 6σ displacement magnitude of every part under one law."""
    fields = {field.part: field for field in fields if field.law == law}
    if not fields or not surfaces:
        return None
    fig = Figure(figsize=(10.5, 7.2), layout="constrained")
    axes = fig.subplots(2, len(fields), squeeze=False)
    texts = []
    means = {part: np.linalg.norm(field.mean, axis=1) for part, field in fields.items()}
    spreads = {part: field.six_sigma_magnitude for part, field in fields.items()}
    for row, values, label, cmap in ((axes[0], means, "mean", "viridis"), (axes[1], spreads, "6σ", "YlOrRd")):
        known = np.concatenate(list(values.values()))
        known = known[np.isfinite(known)]
        scale = Normalize(0.0, float(known.max(initial=0.0)) or 1.0)
        for ax, (part, value) in zip(row, values.items()):
            surface = surfaces[part]
            _View([surface]).draw(ax, [surface], [colormaps[cmap](scale(np.nan_to_num(value)))[:, :3]], 0.2)
            ax.set_title(part)
        fig.colorbar(ScalarMappable(scale, cmap), ax=list(row), label=f"{label} displacement (mm)", shrink=0.8)
        if len(known):
            part = max(values, key=lambda name: np.nan_to_num(values[name]).max())
            x, y, z = surfaces[part].points[int(np.argmax(np.nan_to_num(values[part])))]
            texts.append(f"the largest {label} is {number(known.max())} mm, on {part} at ({x:.0f}, {y:.0f}, {z:.0f})")
    rank, discarded, error = (
        max(getattr(field, name) for field in fields.values()) for name in ("rank", "discarded", "error")
    )
    caption = (
        f"Deviation from nominal after the last stage under {law}, the parts' own shape deviation included: {'; '.join(texts)}. "
        f"6σ rests on {rank + 1} solves at most per part; the truncation leaves out "
        f"{number(discarded, 2)} of the elastic energy and {number(error, 2)} mm at the retained points."
    )
    return _png(fig, f"fields-{law}", f"Mean and 6σ displacement fields, {law}", caption, 100)


# ---------------------------------------------------------------------------------------------- shared


def _slip_sentence(outcome, stage):
    """How friction changes mean and spread of slip, zone by zone."""
    frictional = next((law for law in outcome.laws if law != "frictionless"), None)
    if frictional is None or "frictionless" not in outcome.laws:
        return ""
    table = outcome.zone_statistics
    table = table[table["stage"] == stage].set_index(["law", "zone"])
    parts = []
    for zone in outcome.zones:
        without, with_ = table.loc[("frictionless", zone)], table.loc[(frictional, zone)]
        change = [
            percent(with_[name] / without[name] - 1) if without[name] > 0 else "–"
            for name in ("mean_rms_slip", "six_sigma_rms_slip")
        ]
        parts.append(f"{zone} mean {change[0]}, 6σ {change[1]}")
    return f"Friction ({frictional} against frictionless) changes the slip by: {'; '.join(parts)}."


def _panels(count, columns, size, **kwargs):
    """A figure with `count` axes of the given size in inches, row by row."""
    rows = -(-count // columns)
    fig = Figure(figsize=(max(columns * size[0], 5.0), rows * size[1] + 0.35), layout="constrained")
    axes = fig.subplots(rows, columns, squeeze=False, **kwargs).ravel()
    for ax in axes[count:]:
        ax.set_axis_off()
    return fig, list(axes[:count])


def _zone_strips(outcome, axes, names=True):
    """Mark above the axes which contacts belong to which zone."""
    zone = outcome.model.contacts.zone
    for j, ax in enumerate(axes):
        ax.set_xlim(-0.5, len(zone) - 0.5)
        for i, name in enumerate(outcome.zones):
            members = np.flatnonzero(zone == i)
            if len(members):
                ax.axvspan(members[0] - 0.5, members[-1] + 0.5, 1.0, 1.035, color=zone_colour(i), lw=0, clip_on=False)
                if j == 0 and names:
                    ax.text(
                        members.mean(),
                        1.05,
                        name,
                        transform=ax.get_xaxis_transform(),
                        ha="center",
                        va="bottom",
                        color=zone_colour(i),
                        fontweight="bold",
                    )


def _by_zone(outcome, values):
    """Contact numbers and values with a gap between zones, so that no line joins two zones."""
    ends = np.flatnonzero(np.diff(outcome.model.contacts.zone)) + 1
    return np.insert(np.arange(len(values), dtype=float), ends, np.nan), np.insert(
        np.asarray(values, dtype=float), ends, np.nan
    )


def _law_legend(fig, laws):
    fig.legend(
        handles=[
            Line2D([], [], color=LAW_COLOURS[law], marker=LAW_MARKS[law], ms=5, lw=1.5, label=law) for law in laws
        ],
        loc="outside upper left",
        ncols=3,
    )


def _svg(fig, name, title, caption):
    return _save(fig, name, title, caption, "svg", 72)


def _png(fig, name, title, caption, dpi):
    return _save(fig, name, title, caption, "png", dpi)


def _save(fig, name, title, caption, kind, dpi):
    buffer = io.BytesIO()
    fig.savefig(buffer, format=kind, dpi=dpi, metadata={"Date": None} if kind == "svg" else None)
    return Picture(name, title, caption, buffer.getvalue(), kind)
