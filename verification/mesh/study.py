"""The element size: observed order, Richardson extrapolation and grid convergence index of 6σ, means and zone slips.

Contact pairs stand at the same points on every mesh, so that nothing but the elements changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mic.sampling.draw import draw
from verification.comparison import reduced_and_assembly, zone_slip
from verification.plots import panels
from verification.scenes import shipped
from verification.study import Acceptance, Finding, Study

LAP = (5.0, 2.5, 1.25, 0.625)  # mm; the last judges the index of the three before
WHEELHOUSE, QUICK_WHEELHOUSE = (17.5, 8.0, 5.0), (30.0, 21.0, 15.0)  # mm
FORMAL = 2.0  # order of the elements' energy
NEAR, CAUTIOUS, SAFETY = 0.1, 3.0, 1.25


@dataclass(frozen=True)
class Convergence:
    """Of one quantity on three meshes.

    Attributes
    ----------
    order : float
        Observed; NaN where the values do not tell (they oscillate, or two meshes agree to rounding).
    kind : {"monotone", "oscillating"}
    extrapolated : float
        Richardson's limit, with the order kept within 0.5 … FORMAL; the finest value where the values oscillate.
    index : float
        Grid convergence index of the finest mesh: half-width of the band about its value, in the quantity's unit.
    """

    order: float
    kind: str
    extrapolated: float
    index: float


def converge(size, value) -> Convergence:
    """Order, limit and index from three meshes.

    With h₁ < h₂ < h₃, r₂₁ = h₂/h₁, r₃₂ = h₃/h₂ and ε₂₁ = φ₂ − φ₁, ε₃₂ = φ₃ − φ₂ the order solves [1]_

        p = |ln|ε₃₂/ε₂₁| + ln((r₂₁ᵖ − 1)/(r₃₂ᵖ − 1))| / ln r₂₁

    The index is F |ε₂₁|/(r₂₁ᵖ − 1). As Oberkampf and Roy advise [2]_, F = 1.25 with the formal order where p is within
    a tenth of it, and elsewhere F = 3 with p kept within 0.5 … FORMAL. Where the values oscillate (ε₃₂/ε₂₁ < 0) nothing
    is extrapolated: if the oscillation dies down the limit lies between the last two values, and the index is 3 |ε₂₁|.

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


def statistics_of(model, samples) -> dict[tuple[str, str], float]:
    """Mean and 6σ of measurements and of zone slips after clamping, mm, by (kind, name)."""
    scene = model.scene
    found = model.evaluate(draw(scene, scene.monte_carlo.seed, 0, samples), "coulomb")
    if found.failed.any():
        raise RuntimeError(f"{scene.name}: {found.failed.sum()} samples failed; the meshes cannot be compared")
    slip = zone_slip(found.resolutions["clamp"].displacement, model.contacts, len(scene.zones))
    series = [("measurement", item.name, found.measurements[:, j]) for j, item in enumerate(scene.measurements)]
    series += [("slip", zone.name, slip[:, z]) for z, zone in enumerate(scene.zones)]
    return {
        (f"{statistic} {kind}", name): float(value(x))
        for kind, name, x in series
        for statistic, value in (("mean", np.mean), ("6σ", lambda x: 6 * np.std(x, ddof=1)))
    }


def refine(context, name, sizes, samples) -> pd.DataFrame:
    """One row per quantity: its value on each mesh, and what follows from the first three."""
    h, values, points = [], [], None
    for size in sizes:
        scene = shipped(name, size)
        model, assembly = reduced_and_assembly(scene if points is None else same_points(scene, points), context.cache)
        points = assembly.contacts if points is None else points
        area = sum(
            np.linalg.norm(np.cross(*np.diff(part.surface.corners, axis=1).transpose(1, 0, 2)), axis=1).sum() / 2
            for part in assembly.parts
        )
        h.append(np.sqrt(area / sum(len(part.surface.triangles) for part in assembly.parts)))
        values.append(statistics_of(model, samples))
    rows = []
    for key in values[0]:
        series = [value[key] for value in values]
        found = converge(h[:3], series[:3])
        scale = max(abs(value) for other, value in values[2].items() if other[0] == key[0])
        rows.append(
            {"assembly": name, "quantity": f"{key[0]} {key[1]}"}
            | {f"mesh {i}": v for i, v in enumerate(series, 1)}
            | {
                "order": found.order,
                "kind": found.kind,
                "extrapolated": found.extrapolated,
                "index": found.index / scale,
                "off on mesh 2": abs(series[1] - found.extrapolated) / scale,
                "scale": scale,
            }
        )
    table = pd.DataFrame(rows)
    table.attrs["h"] = h
    return table


def run(context):
    samples = 40 if context.quick else 200
    lap = refine(context, "lap_joint", LAP[:3] if context.quick else LAP, samples)
    wheelhouse = refine(context, "wheelhouse", QUICK_WHEELHOUSE if context.quick else WHEELHOUSE, samples)
    findings = []
    figure, axes = panels(2, 5.4)
    for axis, table in zip(axes, (lap, wheelhouse)):
        h = table.attrs["h"]
        for _, row in table.iterrows():
            off = [abs(row[f"mesh {i + 1}"] - row["extrapolated"]) / row["scale"] for i in range(3)]
            shown = (
                3 if row["kind"] == "monotone" else 2
            )  # where nothing is extrapolated the finest value stands for the limit
            axis.loglog(
                h[:shown],
                np.maximum(off[:shown], 1e-8),
                "o-" if row["kind"] == "monotone" else "o:",
                ms=3,
                lw=1,
                color="tab:red" if "slip" in row["quantity"] else "tab:blue",
                alpha=0.6,
            )
        axis.loglog(h[:3], 0.01 * (np.array(h[:3]) / h[1]) ** 2, "k--", lw=1)
        axis.text(h[0], 0.01 * (h[0] / h[1]) ** 2, " $h^2$")
        axis.set(
            title=table["assembly"][0].replace("_", " "),
            xlabel="h = √(area / triangles), mm",
            ylabel="off the extrapolated limit, relative",
        )
    axes[0].plot([], [], "o-", color="tab:blue", label="measurements")
    axes[0].plot([], [], "o-", color="tab:red", label="slips")
    axes[0].plot([], [], "k:", label="oscillating")
    axes[0].legend()
    order = float(lap["order"].median())
    findings.append(
        Finding(
            "lap-order",
            order,
            f"Median over {len(lap)} quantities; {(lap['kind'] == 'oscillating').sum()} of them oscillate.",
            figure,
            lap.drop(columns="scale"),
        )
    )
    finest = lap["index"].max()
    note = ""
    if "mesh 4" in lap:
        held = (np.abs(lap["mesh 4"] - lap["mesh 3"]) <= lap["index"] * lap["scale"]).mean()
        note = f"On a mesh of half the size {held:.0%} of the quantities moved by no more than their index said."
    findings.append(Finding("lap-index", finest, note))
    sides = ", ".join(f"{h:.2f}" for h in wheelhouse.attrs["h"])
    sigmas, slips = (
        wheelhouse[wheelhouse["quantity"].str.startswith(f"6σ {kind}")] for kind in ("measurement", "slip")
    )
    findings.append(
        Finding(
            "wheelhouse-index",
            sigmas["index"].max(),
            f"Meshes with h = {sides} mm. Median index {sigmas['index'].median():.2%}; "
            f"{(wheelhouse['kind'] == 'oscillating').sum()} of {len(wheelhouse)} quantities oscillate.",
            table=wheelhouse.drop(columns="scale"),
        )
    )
    findings.append(
        Finding(
            "wheelhouse-slip-index",
            slips["index"].max(),
            f"{(slips['kind'] == 'oscillating').sum()} of {len(slips)} oscillate: contact forces follow the facets of "
            "the mesh, and slips follow the forces.",
        )
    )
    findings.append(
        Finding(
            "wheelhouse-medium",
            sigmas["off on mesh 2"].max(),
            f"Median {sigmas['off on mesh 2'].median():.2%}; worst: "
            f"{sigmas.loc[sigmas['off on mesh 2'].idxmax(), 'quantity']}.",
        )
    )
    return findings


STUDY = Study(
    order=50,
    title="Mesh",
    claim=(
        "Key characteristics and zone slips converge as the elements become smaller, and the error that a mesh "
        "leaves is known."
    ),
    reference=(
        "Richardson extrapolation over three meshes; on the lap joint a fourth mesh judges the index. Contact "
        "pairs stand at the same points on all meshes."
    ),
    acceptance=(
        Acceptance("lap-order", "Median observed order of means and 6σ on the lap joint.", 1.5, bound="at least"),
        Acceptance(
            "lap-index",
            "Largest grid convergence index of the lap joint's third mesh, over the largest value of its kind.",
            0.01,
        ),
        Acceptance(
            "wheelhouse-index",
            (
                "Largest grid convergence index of the key characteristics' 6σ on the wheelhouse's fine mesh, over the "
                "largest 6σ."
            ),
            0.04,
            quick=0.4,
        ),
        Acceptance("wheelhouse-slip-index", "The same of the zone slips' 6σ.", 0.2, quick=0.6),
        Acceptance(
            "wheelhouse-medium",
            "How far the key characteristics' 6σ on the wheelhouse's medium mesh is from the extrapolated limit at "
            "most, over the largest 6σ.",
            0.04,
            quick=0.2,
        ),
    ),
    seconds=(150, 45),
    run=run,
)
