"""The element size: observed order, Richardson extrapolation and grid convergence index of 6σ, means and zone slips.

Contact pairs stand at the same points on every mesh, so that nothing but the elements changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from mic.sampling.draw import draw
from verification.comparison import reduced_and_assembly, zone_slip
from verification.plots import panels
from verification.scenes import shipped
from verification.study import Acceptance, Finding, Study

LAP = (2.5, 1.25, 0.625, 0.3125)  # mm, from a nugget's radius on; the last judges the index of the three before
WHEELHOUSE, QUICK_WHEELHOUSE = (17.5, 12.8, 8.0, 5.0), (30.0, 21.0, 15.0, 10.5)  # mm
FORMAL = 2.0  # order of the elements' energy
NEAR, CAUTIOUS, SAFETY = 0.1, 3.0, 1.25


@dataclass(frozen=True)
class Convergence:
    """Of one quantity on several meshes.

    Attributes
    ----------
    order : float
        Observed; NaN where the values do not tell (they oscillate, or two meshes agree to rounding).
    kind : {"monotone", "oscillating"}
    extrapolated : float
        The limit.
    index : float
        Of the finest mesh: half-width of the band about its value, in the quantity's unit.
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
    Two differences tell no scatter from a low order: values that scatter take :func:`fitted`.

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


def fitted(size, value) -> Convergence:
    """Order, limit and index from four meshes or more, on which the values scatter.

    With friction a sample sticks on one mesh what slips on the next, and 6σ of some hundred samples moves by as much as
    the elements move it. Eça and Hoekstra fit power series by least squares [1]_, each mesh alike and weighed by 1/h,

        φ = φ₀ + α hᵖ,    φ₀ + α h,    φ₀ + α h²,    φ₀ + α h + β h²

    and take the one of least standard deviation s: the first where its p lies within 0.5 … FORMAL, the second and third
    where it is higher, all but the first where it is lower. With the step ε = |φ_fit − φ₀| on the finest mesh, its
    residual r and the mean step of the data Δ = (max φ − min φ)/(n − 1) the index is

        F ε + s + |r| where s < Δ, F = 1.25 for p within 0.5 … 1.05 FORMAL, else 3;    3 s/Δ (ε + s + |r|) elsewhere.

    Parameters
    ----------
    size, value : (n,) array
        h, coarse to fine, and φ; n ≥ 4.

    References
    ----------
    .. [1] Eça, Hoekstra: A procedure for the estimation of the numerical uncertainty of CFD calculations based on grid
           refinement studies, J. Comput. Phys. 262 (2014) 104–130.
    """
    h, φ = np.asarray(size, dtype=float) / size[-1], np.asarray(value, dtype=float)
    Δ = float(np.ptp(φ)) / (len(h) - 1)
    steps = np.diff(φ)
    kind = "monotone" if (steps >= 0).all() or (steps <= 0).all() else "oscillating"
    if Δ <= 1e-12 * np.abs(φ).max():
        return Convergence(np.nan, "monotone", float(φ[-1]), Δ)
    weights = np.full(len(h), 1 / len(h)), 1 / h / (1 / h).sum()
    fits = [
        (p, _series(h, φ, weight, [p], sought=True)) for weight in weights for p in np.arange(0.05, 2 * FORMAL, 0.01)
    ]
    p, free = min(fits, key=lambda found: found[1].deviation)
    if 0.5 <= p <= FORMAL:
        best = free
    else:
        series = [[1.0], [FORMAL]] if p > FORMAL else [[1.0], [FORMAL], [1.0, FORMAL]]
        best = min(
            (_series(h, φ, weight, exponents) for weight in weights for exponents in series),
            key=lambda fit: fit.deviation,
        )
    ε, s = abs(best.step), best.deviation
    if s < Δ:
        factor = SAFETY if 0.5 <= p <= 1.05 * FORMAL else CAUTIOUS
        index = factor * ε + s + abs(best.residual)
    else:
        index = CAUTIOUS * s / Δ * (ε + s + abs(best.residual))
    return Convergence(float(p), kind, float(best.limit), float(index))


class _Fit(NamedTuple):
    limit: float  # φ₀
    step: float  # of the fit on the finest mesh, beyond φ₀
    residual: float  # there
    deviation: float  # s


def _series(h, φ, weight, exponents, sought=False) -> _Fit:
    """φ₀ + Σ α hᵖ by weighted least squares; exponents that were sought count as unknowns."""
    basis = np.column_stack([np.ones_like(h), *(h**p for p in exponents)])
    root = np.sqrt(weight)
    coefficients = np.linalg.lstsq(root[:, None] * basis, root * φ, rcond=None)[0]
    residual = φ - basis @ coefficients
    s = np.sqrt(len(h) * (weight * residual**2).sum() / (len(h) - basis.shape[1] - sought))
    return _Fit(coefficients[0], (basis[-1, 1:] * coefficients[1:]).sum(), residual[-1], float(s))


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


def refine(context, name, sizes, samples, estimate, judged) -> pd.DataFrame:
    """One row per quantity: its value on each mesh, and what an estimate makes of the first `judged` of them."""
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
        found = estimate(h[:judged], series[:judged])
        scale = max(abs(value) for other, value in values[judged - 1].items() if other[0] == key[0])
        rows.append(
            {"assembly": name, "quantity": f"{key[0]} {key[1]}"}
            | {f"mesh {i}": v for i, v in enumerate(series, 1)}
            | {
                "order": found.order,
                "kind": found.kind,
                "extrapolated": found.extrapolated,
                "index": found.index / scale,
                "off on the mesh before": abs(series[judged - 2] - found.extrapolated) / scale,
                "scale": scale,
            }
        )
    table = pd.DataFrame(rows)
    table.attrs["h"] = h[:judged]
    return table


def run(context):
    samples = 40 if context.quick else 200
    lap = refine(context, "lap_joint", LAP[:3] if context.quick else LAP, samples, converge, 3)
    sizes = QUICK_WHEELHOUSE if context.quick else WHEELHOUSE
    wheelhouse = refine(context, "wheelhouse", sizes, samples, fitted, len(sizes))
    findings = []
    figure, axes = panels(2, 5.4)
    for axis, table in zip(axes, (lap, wheelhouse)):
        h = table.attrs["h"]
        for _, row in table.iterrows():
            off = [abs(row[f"mesh {i + 1}"] - row["extrapolated"]) / row["scale"] for i in range(len(h))]
            # where nothing is extrapolated the finest value stands for the limit
            shown = len(h) if off[-1] > 0 else len(h) - 1
            axis.loglog(
                h[:shown],
                np.maximum(off[:shown], 1e-8),
                "o-" if row["kind"] == "monotone" else "o:",
                ms=3,
                lw=1,
                color="tab:red" if "slip" in row["quantity"] else "tab:blue",
                alpha=0.6,
            )
        axis.loglog(h, 0.01 * (np.array(h) / h[1]) ** 2, "k--", lw=1)
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
            sigmas["off on the mesh before"].max(),
            f"Median {sigmas['off on the mesh before'].median():.2%}; worst: "
            f"{sigmas.loc[sigmas['off on the mesh before'].idxmax(), 'quantity']}.",
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
        "Lap joint: Richardson extrapolation over three meshes, and a fourth that judges the index. Wheelhouse: least "
        "squares over four meshes. Contact pairs stand at the same points on all meshes."
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
    seconds=(190, 60),
    run=run,
)
