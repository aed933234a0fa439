"""Mesh error of mean and 6σ of key characteristics and of the tangential displacement of the zones.

Contact pairs have the same positions on every mesh. For extrapolation they also average over the same discs, so that
only the elements change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mic.model.assembly import assemble
from mic.statistics.draw import draw
from verification.comparison import reduced_and_assembly, zone_slip
from verification.plots import panels
from verification.scenes import shipped
from verification.study import Acceptance, Finding, Study

#: mm; no element of either strip is larger than half a nugget's radius, to which it would be divided there (those of
#: the upper one are 1.15 times as large); the last judges the index of the three before
LAP = (1.0, 0.5556, 0.3125, 0.2)
#: mm: coarse, whose pairs all have, medium, fine, and what stands for the limit
WHEELHOUSE = (17.5, 8.0, 5.0, 2.83)
FORMAL = 2.0  # order of the elements' energy
NEAR, CAUTIOUS, SAFETY = 0.1, 3.0, 1.25


@dataclass(frozen=True)
class Convergence:
    """Convergence of one quantity over several meshes.

    Attributes
    ----------
    order : float
        Observed order; NaN if the values oscillate or two meshes agree to rounding.
    kind : {"monotone", "oscillating"}
    extrapolated : float
        The limit.
    index : float
        Grid convergence index of the finest mesh: half width of the band around its value, in the unit of the quantity.
    """

    order: float
    kind: str
    extrapolated: float
    index: float


def converge(size, value) -> Convergence:
    """Order, limit and index from three meshes.

    With h₁ < h₂ < h₃, r₂₁ = h₂/h₁, r₃₂ = h₃/h₂ and ε₂₁ = φ₂ − φ₁, ε₃₂ = φ₃ − φ₂ the order solves [1]_

        p = |ln|ε₃₂/ε₂₁| + ln((r₂₁ᵖ − 1)/(r₃₂ᵖ − 1))| / ln r₂₁

    The index is F |ε₂₁|/(r₂₁ᵖ − 1). Following Oberkampf and Roy [2]_, F = 1.25 with the formal order if p is within
    a tenth of it, and otherwise F = 3 with p limited to 0.5 … FORMAL. Oscillating values (ε₃₂/ε₂₁ < 0) are not
    extrapolated: a decaying oscillation has its limit between the last two values, and the index is 3 |ε₂₁|. Two
    differences cannot distinguish scatter from a low order; a much finer mesh can.

    Parameters
    ----------
    size, value : (3,) array
        h, coarse to fine, and φ.

    References
    ----------
    .. [1] Celik et al.: Procedure for estimation and reporting of uncertainty due to discretization in CFD
           applications, J. Fluids Eng. 130 (2008) 078001.
    .. [2] Oberkampf, Roy: Verification and Validation in Scientific Computing, 2010, section 8.7.
    """
    h3, h2, h1 = size
    f3, f2, f1 = value
    r21, r32, e21, e32 = h2 / h1, h3 / h2, f2 - f1, f3 - f2
    tiny = 1e-12 * np.abs(value).max()
    if abs(e21) <= tiny:
        return Convergence(np.nan, "monotone", float(f1), float(abs(e21)))
    if e32 / e21 < 0:
        return Convergence(np.nan, "oscillating", float(f1), float(CAUTIOUS * abs(e21)))
    p = FORMAL
    for _ in range(200):
        new = abs(np.log(max(abs(e32 / e21), 1e-12)) + np.log((r21**p - 1) / (r32**p - 1))) / np.log(r21)
        if abs(new - p) < 1e-10:
            break
        p = 0.5 * (p + new)
    used, safety = (FORMAL, SAFETY) if abs(p - FORMAL) <= NEAR * FORMAL else (min(max(0.5, p), FORMAL), CAUTIOUS)
    step = e21 / (r21**used - 1)
    return Convergence(float(p), "monotone", float(f1 - step), float(safety * abs(step)))


def same_points(scene, contacts):
    """The scene with its contact pairs at given points."""
    zones = [
        zone.model_copy(
            update={"points": [tuple(p) for p in contacts.point[contacts.zone == z]], "pairs": None, "spacing": None}
        )
        for z, zone in enumerate(scene.zones)
    ]
    return scene.model_copy(update={"zones": zones})


def same_discs(scene, contacts):
    """The scene with its contact pairs at given points, each averaging over a disc of the zone's mean area per pair.

    The default patches consist of pieces of elements, so that they differ from mesh to mesh at the same points.
    """
    zones = [
        zone.model_copy(update={"patch": float(np.sqrt(contacts.area[contacts.zone == z].mean() / np.pi))})
        for z, zone in enumerate(same_points(scene, contacts).zones)
    ]
    return scene.model_copy(update={"zones": zones})


def statistics_of(model, samples) -> dict[tuple[str, str], float]:
    """Mean and 6σ of measurements and of the zones' tangential displacement after clamping, mm, by (kind, name)."""
    scene = model.scene
    found = model.evaluate(draw(scene, scene.monte_carlo.seed, 0, samples), "coulomb")
    if found.failed.any():
        raise RuntimeError(f"{scene.name}: {found.failed.sum()} samples failed; the meshes cannot be compared")
    slip = zone_slip(found.resolutions["clamp"].displacement, model.contacts, len(scene.zones))
    series = [("measurement", item.name, found.measurements[:, j]) for j, item in enumerate(scene.measurements)]
    series += [("displacement", zone.name, slip[:, z]) for z, zone in enumerate(scene.zones)]
    return {
        (f"{statistic} {kind}", name): float(value(x))
        for kind, name, x in series
        for statistic, value in (("mean", np.mean), ("6σ", lambda x: 6 * np.std(x, ddof=1)))
    }


#: Function that transfers the contact pairs of the first mesh of each scene to all meshes.
HELD = {"lap_joint": same_discs, "wheelhouse": same_points}


def on_mesh(context, name, size, samples, contacts):
    """h = √(area / triangles), mm, and :func:`statistics_of` a scene on a mesh with the given contact pairs.

    Raises
    ------
    RuntimeError
        If elements of meshes for extrapolation were divided at nuggets, so that they are not uniformly refined.
    """
    model, assembly = reduced_and_assembly(HELD[name](shipped(name, size), contacts), context.cache)
    drawn = assembly.surfaces
    if HELD[name] is same_discs and any(
        len(one.surface.points) > len(drawn[one.name].points) for one in assembly.parts
    ):
        raise RuntimeError(f"{name}: elements of {size} mm are divided at nuggets; begin with smaller ones")
    area = sum(
        np.linalg.norm(np.cross(*np.diff(part.surface.corners, axis=1).transpose(1, 0, 2)), axis=1).sum() / 2
        for part in assembly.parts
    )
    h = np.sqrt(area / sum(len(part.surface.triangles) for part in assembly.parts))
    return h, statistics_of(model, samples)


def on_meshes(context, sizes, samples):
    """h and :func:`statistics_of` the meshes of each scene, coarse to fine, with the pairs of the first mesh."""
    first = {name: assemble(shipped(name, own[0]), context.cache).contacts for name, own in sizes.items()}
    # The finest mesh of the last scene takes by far the longest.
    tasks = [(name, size) for name in reversed(sizes) for size in reversed(sizes[name])]
    made = dict(zip(tasks, context.team.map(lambda task: on_mesh(context, *task, samples, first[task[0]]), tasks)))
    return {name: tuple(zip(*(made[name, size] for size in own))) for name, own in sizes.items()}


def extrapolated(h, values) -> pd.DataFrame:
    """One row per quantity: its value on each mesh, and the limit extrapolated from the first three."""
    rows = []
    for key in values[0]:
        series = [value[key] for value in values]
        found = converge(h[:3], series[:3])
        scale = max(abs(value) for other, value in values[2].items() if other[0] == key[0])
        rows.append(
            {"quantity": f"{key[0]} {key[1]}"}
            | {f"mesh {i}": v for i, v in enumerate(series, 1)}
            | {
                "order": found.order,
                "kind": found.kind,
                "extrapolated": found.extrapolated,
                "index": found.index / scale,
                "scale": scale,
            }
        )
    return pd.DataFrame(rows)


def against_the_last(values) -> pd.DataFrame:
    """One row per quantity: its value on each mesh, and the errors of medium and fine against the last, over 6σ."""
    rows = []
    for kind, name in values[-1]:
        series = [value[kind, name] for value in values]
        own = values[-1][f"6σ {kind.split(' ', 1)[1]}", name]
        off = {f"{mesh} off": abs(series[i] - series[-1]) / own for i, mesh in ((1, "medium"), (2, "fine"))}
        rows.append({"quantity": f"{kind} {name}"} | {f"mesh {i}": v for i, v in enumerate(series, 1)} | off)
    return pd.DataFrame(rows)


def run(context):
    sizes = {"lap_joint": LAP[:3]} if context.quick else {"lap_joint": LAP, "wheelhouse": WHEELHOUSE}
    found = on_meshes(context, sizes, 20 if context.quick else 200)
    findings = lap_findings(*found["lap_joint"])
    return findings if context.quick else [*findings, *wheelhouse_findings(*found["wheelhouse"])]


def lap_findings(h, values) -> list[Finding]:
    """Order and index of convergence on the lap joint."""
    lap = extrapolated(h, values)

    figure, (axis,) = panels(1, 5.4)
    for _, row in lap.iterrows():
        off = [abs(row[f"mesh {i + 1}"] - row["extrapolated"]) / row["scale"] for i in range(3)]
        # without extrapolation the finest value replaces the limit
        shown = 3 if off[-1] > 0 else 2
        axis.loglog(h[:shown], np.maximum(off[:shown], 1e-8), **_line(row, row["kind"]))
    _label(axis, "lap joint", h[:3], "off the extrapolated limit, relative")
    axis.plot([], [], "o-", color="tab:blue", label="measurements")
    axis.plot([], [], "o-", color="tab:red", label="tangential displacements")
    axis.plot([], [], "k:", label="oscillating")
    axis.legend()
    note = ""
    if "mesh 4" in lap:
        held = (np.abs(lap["mesh 4"] - lap["mesh 3"]) <= lap["index"] * lap["scale"]).mean()
        note = f"On the fourth mesh {held:.0%} of the quantities moved by no more than their index said."
    return [
        Finding(
            "lap-order",
            float(lap["order"].median()),
            f"Median over {len(lap)} quantities; {(lap['kind'] == 'oscillating').sum()} of them oscillate.",
            figure,
            lap.drop(columns="scale"),
        ),
        Finding("lap-index", lap["index"].max(), note),
    ]


def wheelhouse_findings(sides, values) -> list[Finding]:
    """Errors of two meshes of the wheelhouse against the finest."""
    wheelhouse = against_the_last(values)
    figure, (axis,) = panels(1, 5.4)
    for _, row in wheelhouse[wheelhouse["quantity"].str.startswith("6σ")].iterrows():
        off = [abs(row[f"mesh {i + 1}"] / row["mesh 4"] - 1) for i in range(3)]
        axis.loglog(sides[:3], np.maximum(off, 1e-8), **_line(row, "monotone"))
    _label(axis, "wheelhouse, 6σ", sides[:3], "off the finest mesh, relative")
    findings, table = [], wheelhouse
    for mesh in ("medium", "fine"):
        for kind, name in (("measurement", f"wheelhouse-{mesh}"), ("displacement", f"wheelhouse-{mesh}-zones")):
            some = wheelhouse[wheelhouse["quantity"].str.startswith(f"6σ {kind}")]
            worst = some.loc[some[f"{mesh} off"].idxmax()]
            note = f"Worst: {worst['quantity']}; median {some[f'{mesh} off'].median():.2%}."
            if table is not None:
                note += f" Meshes with h = {', '.join(f'{side:.2f}' for side in sides)} mm."
            findings.append(Finding(name, worst[f"{mesh} off"], note, figure, table))
            figure = table = None
    return findings


def _label(axis, title, sides, words) -> None:
    """Titles, and a line of second order."""
    axis.loglog(sides, 0.01 * (np.array(sides) / sides[1]) ** 2, "k--", lw=1)
    axis.text(sides[0], 0.01 * (sides[0] / sides[1]) ** 2, " $h^2$")
    axis.set(title=title, xlabel="h = √(area / triangles), mm", ylabel=words)


def _line(row, kind):
    color = "tab:red" if "displacement" in row["quantity"] else "tab:blue"
    return {"ls": "-" if kind == "monotone" else ":", "marker": "o", "ms": 3, "lw": 1, "color": color, "alpha": 0.6}


STUDY = Study(
    order=50,
    title="Mesh",
    claim=(
        "Key characteristics and the zones' tangential displacement converge with the element size, and the error of "
        "a mesh is known."
    ),
    reference=(
        "Lap joint: Richardson extrapolation over three meshes, and a fourth that tests the index. Wheelhouse: a "
        "mesh with 6.6 times the nodes of medium. Contact pairs stand at the same points on all meshes, on the lap "
        "joint as the same discs."
    ),
    acceptance=(
        Acceptance(
            "lap-order",
            "Median observed order of means and 6σ on the lap joint.",
            1.5,
            bound="at least",
            reason="Theory: 2; 1.5 is nearer to it than to first order.",
        ),
        Acceptance(
            "lap-index",
            "Largest grid convergence index of the lap joint's third mesh, over the largest value of its kind.",
            0.01,
            reason="The 1 % of the setting reference.",
        ),
        Acceptance(
            "wheelhouse-medium",
            "6σ of key characteristics, medium against the finest mesh: largest relative difference.",
            0.02,
            reason="The 2 % of the setting standard.",
            full_only=True,
        ),
        Acceptance(
            "wheelhouse-medium-zones",
            "6σ of the zones' tangential displacement after clamping: the same.",
            0.02,
            reason="The 2 % of the setting standard.",
            full_only=True,
        ),
        Acceptance(
            "wheelhouse-fine",
            "6σ of key characteristics, fine against the finest mesh: largest relative difference.",
            0.01,
            reason="The 1 % of the setting reference.",
            full_only=True,
        ),
        Acceptance(
            "wheelhouse-fine-zones",
            "6σ of the zones' tangential displacement: the same.",
            0.01,
            reason="The 1 % of the setting reference.",
            full_only=True,
        ),
    ),
    seconds=(211, 20),
    memory=3.4,
    run=run,
)
