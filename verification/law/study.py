"""Effect of the contact law on the results: the paper's programme (13), no friction, friction that depends on pressure
and contacts that yield, against Coulomb's law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from mpi4py import MPI

from fem_reference.full.model import FullModel
from mic.contact.states import SLIP
from mic.examples import folder
from mic.scene import Scene
from mic.statistics.draw import draw
from verification.comparison import difference, reduced_and_assembly, relative, routes, zone_slip
from verification.plots import panels
from verification.scenes import shipped, with_path
from verification.study import Acceptance, Finding, Study

CASES = (("lap_joint", "coarse", "coarse"), ("hat_on_plate", "coarse", 12.0), ("wheelhouse", "coarse", 30.0))
FRICTION = (0.05, 0.1, 0.2, 0.27, 0.4, 0.6, 0.8)
FULL = {
    "lap_joint": FRICTION,
    "hat_on_plate": (0.05, 0.27, 0.8),
    "wheelhouse": (0.27,),
}  # scenes with full finite elements as the reference
QUICK_FULL = {"lap_joint": (0.05, 0.8)}  # the hat's is among the quick solves of the study algebra
LAWS = ("associated", "frictionless")
INCREMENTS = 2  # increments of each step, for history-dependent sliders
#: Keys of the lap joint's zone, over the pressures that its clamps make; and tangential stiffnesses, N/mm³, from one
#: that changes what contacts do to one that hardly does.
FUNCTIONS = {
    "table": {"friction_table": [[0.0, 0.4], [0.05, 0.3], [0.3, 0.2]]},
    "falling power": {"friction_power": {"mu0": 0.27, "p0": 0.05, "n": 0.3, "mu_min": 0.1, "mu_max": 0.6}},
    "rising power": {"friction_power": {"mu0": 0.27, "p0": 0.05, "n": -0.3, "mu_min": 0.1, "mu_max": 0.6}},
}
STIFFNESSES = (1e3, 1e4, 1e5, 1e6)
QUICK_STIFFNESSES = (1e3, 1e5)
BY_STAGE = {"rising": {"clamp": 0.1, "default": 0.4}, "falling": {"clamp": 0.4, "default": 0.1}}
QUICK = 1  # of the functions, and of the values by stage: the first
LOADED = 1e-3  # share of the stage's largest normal force from which a contact counts as loaded
PUBLISHED = ("wheelhouse", 0.27)  # the paper's friction


def with_friction(built, mu):
    """Reduced model and assembly with one coefficient of friction everywhere."""
    model, assembly = built
    contacts = replace(assembly.contacts, friction=np.full_like(assembly.contacts.friction, mu))
    return replace(model, contacts=contacts), replace(assembly, contacts=contacts)


def variant(keys, cache):
    """Reduced model and assembly of the coarse lap joint with keys of its zone."""
    laws = ["coulomb", "pressure-dependent", "micro-slip"]
    table = with_path(shipped("lap_joint", "coarse"), "increments", INCREMENTS).model_dump(exclude_none=True)
    table["zones"] = [zone | keys for zone in table["zones"]]
    table["report"]["laws"] = laws[:1]
    scene = Scene(**table | {"folder": folder("lap_joint")})
    scene = scene.model_copy(update={"report": scene.report.model_copy(update={"laws": laws})})
    return reduced_and_assembly(scene, cache)


def solved_both_ways(built, law) -> dict:
    """The first sample under a law, reduced and by full finite elements, and how far it is from Coulomb's law."""
    model, assembly = built
    deviations = draw(model.scene, model.scene.monte_carlo.seed, 0, 1)
    full = FullModel(assembly, comm=MPI.COMM_SELF).evaluate(deviations[0], law)
    found, coulomb = model.evaluate(deviations, law), model.evaluate(deviations, "coulomb")
    off = difference(found, 0, full)
    moved = [
        relative(one.displacement[0, :, 1:], coulomb.resolutions[stage].displacement[0, :, 1:])
        for stage, one in found.resolutions.items()
    ]
    return {
        "law": law,
        "route": full.route,
        "force": off.force,
        "displacement": off.displacement,
        "measurement": off.measurement,
        "changed states": off.states,
        "slipping": sum(int((one.state[0] == SLIP).sum()) for one in found.resolutions.values()),
        "tangential motion off Coulomb's": max(moved),
        "measurements off Coulomb's": relative(found.measurements, coulomb.measurements),
    }


def other_laws(context) -> pd.DataFrame:
    """Pressure-dependent, micro-slip and stage-dependent friction on the lap joint: reduced against full."""
    stiffnesses = QUICK_STIFFNESSES if context.quick else STIFFNESSES
    some = QUICK if context.quick else None
    cases = [("pressure-dependent", name, keys) for name, keys in list(FUNCTIONS.items())[:some]]
    cases += [("micro-slip", f"{k:g} N/mm³", {"tangential_stiffness": k}) for k in stiffnesses]
    cases += [("coulomb", f"by stage, {name}", {"friction": values}) for name, values in list(BY_STAGE.items())[:some]]
    built = [variant(keys, context.cache) for *_, keys in cases]
    rows = context.team.map(lambda i: solved_both_ways(built[i], cases[i][0]), range(len(cases)))
    return pd.DataFrame([{"friction": name} | row for (_, name, _), row in zip(cases, rows)])


def loaded_gap(resolution) -> np.ndarray:
    """(n, m) gap of the contacts that carry load, mm; 0 at the others."""
    force = resolution.force[..., 0]
    loaded = force > LOADED * force.max(axis=1, keepdims=True)
    return np.where(loaded, np.maximum(resolution.displacement[..., 0], 0), 0)


def compare(model, deviations, law) -> dict:
    """A law against Coulomb's, the largest over samples and stages unless stated otherwise."""
    truth, found = model.evaluate(deviations, "coulomb"), model.evaluate(deviations, law)
    ok = ~(truth.failed | found.failed)
    zones = len(model.scene.zones)
    gap, force, total, changed, closed, identity = [], [], [], 0, 0, 0.0
    for stage, exact in truth.resolutions.items():
        mine = found.resolutions[stage]
        f, g = exact.force[ok], mine.force[ok]
        scale = np.abs(f).max(axis=(1, 2))
        gap.append(loaded_gap(mine)[ok].max())
        force.append((np.abs(g - f).max(axis=(1, 2)) / scale).max())
        total.append(np.abs(g[..., 0].sum(1) / f[..., 0].sum(1) - 1).max())
        touching = (exact.state[ok] > 0) | (mine.state[ok] > 0)
        changed, closed = (
            changed + int((touching & (exact.state[ok] != mine.state[ok])).sum()),
            closed + int(touching.sum()),
        )
        if law == "associated":  # (13) implies u_n = μ‖u_t‖ for contacts under load
            u, loaded = mine.displacement[ok], g[..., 0] > LOADED * g[..., 0].max(axis=1, keepdims=True)
            excess = np.abs(u[..., 0] - model.contacts.friction_in(stage).coefficient * np.hypot(u[..., 1], u[..., 2]))
            sliding = loaded & (mine.state[ok] == 2)
            identity = max(identity, excess[sliding].max(initial=0.0) / max(u[..., 0][loaded].max(initial=0.0), 1e-300))
    slip = {
        name: zone_slip(e.resolutions["clamp"].displacement[ok], model.contacts, zones)
        for name, e in (("truth", truth), ("found", found))
    }
    mean = {name: values.mean(axis=0) for name, values in slip.items()}
    measured = np.abs(found.measurements[ok] - truth.measurements[ok]).max() / np.abs(truth.measurements[ok]).max()
    return {
        "gap at loaded contacts, mm": max(gap),
        "force": max(force),
        "force when clamped": force[0],
        "total normal force": max(total),
        "changed states": changed / max(closed, 1),
        "mean zone slip": float(
            ((mean["found"] - mean["truth"]) / mean["truth"])[np.argmax(np.abs(mean["found"] - mean["truth"]))]
        ),
        "measurement": measured,
        "identity": identity,
        "samples": int(ok.sum()),
        "gap under coulomb, mm": max(float(loaded_gap(r)[ok].max()) for r in truth.resolutions.values()),
    }


def against_full(built, mu) -> tuple[float, str]:
    """Reduced Coulomb against the full finite elements, first sample, and the route of the full solve."""
    model, assembly = with_friction(built, mu)
    deviations = draw(model.scene, model.scene.monte_carlo.seed, 0, 1)
    full = FullModel(assembly, comm=MPI.COMM_SELF).evaluate(deviations[0])
    return difference(model.evaluate(deviations, "coulomb"), 0, full).largest, full.route


def _effects(rows: pd.DataFrame):
    """Figure of the errors of both laws against friction, a panel for each quantity."""
    figure, axes = panels(4, 3.7)
    quantities = ("gap at loaded contacts, mm", "force", "changed states", "mean zone slip")
    for axis, quantity in zip(axes, quantities):
        for (name, *_), colour in zip(CASES, ("tab:blue", "tab:green", "tab:red")):
            for law, style in zip(LAWS, ("o-", "s:")):
                own = rows[(rows["assembly"] == name) & (rows["law"] == law)]
                axis.plot(
                    own["μ"], own[quantity], style, color=colour, ms=3.5, lw=1, label=f"{name.replace('_', ' ')}, {law}"
                )
        axis.set(xlabel="μ", title=quantity)
    axes[-1].set_yscale("symlog", linthresh=0.1)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _in_words(law: str, row: pd.Series) -> str:
    """Sentence on the effect of a law on the published case."""
    return (
        f"{law}: largest differences of forces {row['force']:.0%} of the largest force "
        f"({row['force when clamped']:.0%} when clamped), of the total normal force {row['total normal force']:.0%}, "
        f"of measurements {row['measurement']:.1%} of the largest; mean zone slip {row['mean zone slip']:+.1%}; "
        f"{row['changed states']:.0%} of the touching contacts in another state; gaps at loaded contacts up to "
        f"{row['gap at loaded contacts, mm']:.3f} mm"
    )


def _of_other_laws(others: pd.DataFrame) -> list[Finding]:
    """Findings on pressure-dependent, micro-slip and stage-dependent friction."""
    yielding = others[others["law"] == "micro-slip"]["tangential motion off Coulomb's"].to_numpy()
    return [
        Finding(
            "other-laws",
            float(others[["force", "displacement", "measurement"]].to_numpy().max()),
            "The full solve has its own bound of friction and a finite tangential stiffness at each contact; the "
            f"reduced one puts that into its compliance. Contacts slip in all {len(others)} cases "
            f"({others['slipping'].min()} to {others['slipping'].max()} contacts, over the stages), and "
            f"{int(others['changed states'].sum())} are in another state.",
            table=others,
        ),
        Finding(
            "yielding",
            float(yielding[-1] / yielding[0]),
            f"From {yielding[0]:.1%} of the largest tangential motion to {yielding[-1]:.2%} as the stiffness grows "
            "from the softest to the stiffest.",
        ),
        Finding(
            "other-laws-matter",
            float(
                min(yielding[0], others[others["law"] == "pressure-dependent"]["tangential motion off Coulomb's"].min())
            ),
            "If one of the two methods ignored the law, they would differ by that much.",
        ),
    ]


def run(context):
    samples, where = (5, QUICK_FULL) if context.quick else (40, FULL)
    built = {
        name: reduced_and_assembly(
            with_path(shipped(name, quick if context.quick else size, ("coulomb", *LAWS)), "one-step"), context.cache
        )
        for name, size, quick in CASES
    }
    solves = [(name, mu) for name, frictions in where.items() for mu in frictions]
    others = other_laws(context)
    checks = context.team.map(lambda item: against_full(built[item[0]], item[1]), solves)

    def cell(item):
        name, mu, law = item
        model, _ = with_friction(built[name], mu)
        deviations = draw(model.scene, model.scene.monte_carlo.seed, 0, samples)
        return {"assembly": name, "μ": mu, "law": law} | compare(model, deviations, law)

    rows = pd.DataFrame(
        context.team.map(cell, [(name, mu, law) for name, *_ in CASES for mu in FRICTION for law in LAWS])
    )
    associated = rows[rows["law"] == "associated"]
    published = {
        law: rows[(rows["assembly"] == PUBLISHED[0]) & (rows["μ"] == PUBLISHED[1]) & (rows["law"] == law)].iloc[0]
        for law in LAWS
    }

    figure = _effects(rows)

    return [
        Finding(
            "truth",
            max(off for off, _ in checks),
            f"{routes([*(route for _, route in checks), *others['route']])} {len(checks)} under Coulomb's law, "
            f"including the lap joint at μ from {min(FRICTION)} to {max(FRICTION)}.",
        ),
        Finding(
            "coulomb-gap", rows["gap under coulomb, mm"].max(), "Over all assemblies, frictions, samples and stages."
        ),
        Finding(
            "identity",
            associated["identity"].max(),
            "The optimality conditions of (13) require u_n = μ‖u_t‖ at contacts that slide under load. They are met: "
            "the gaps are a property of (13) and no error of the solver.",
        ),
        Finding(
            "opening",
            published["associated"]["gap at loaded contacts, mm"],
            f"Wheelhouse, μ = {PUBLISHED[1]}, worst of {samples} samples. The difference of (13) from Coulomb's law "
            "increases with the slip of loaded contacts and with μ. "
            + "; ".join(_in_words(law, published[law]) for law in LAWS)
            + ".",
            figure,
            rows,
        ),
        Finding(
            "associated-force",
            published["associated"]["force"],
            f"On the same assembly; frictionless: {published['frictionless']['force']:.0%}. The frictionless law has "
            "no tangential forces at all, and so the error of μ at least.",
        ),
        Finding(
            "associated-slip",
            abs(published["associated"]["mean zone slip"]),
            "In fairness to (13): the mean zone slip, which the paper tabulates, suffers less than the forces do; "
            f"frictionless: {published['frictionless']['mean zone slip']:+.1%}.",
        ),
        *_of_other_laws(others),
    ]


STUDY = Study(
    order=20,
    title="Law",
    claim=(
        "Programme (13) is not Coulomb's law: it opens sliding contacts under load. The study measures the effect of "
        "that law and of neglecting friction. Reduced solutions with pressure-dependent, stage-dependent and "
        "micro-slip friction equal full finite elements."
    ),
    reference=(
        "Full frictional contact finite elements on all unknowns, and the reduced Coulomb solution where these confirm "
        "it; μ = 0.05 … 0.8."
    ),
    acceptance=(
        Acceptance(
            "truth",
            "Reduced Coulomb solution against full finite elements: largest relative difference.",
            2e-8,
            reason=(
                "Rounding: 2.2e-16 times the condition of a plate's stiffness, which grows as the square of its number "
                "of nodes, here up to 9300."
            ),
        ),
        Acceptance(
            "coulomb-gap",
            "Largest gap of a loaded contact under Coulomb's law.",
            1e-9,
            unit="mm",
            reason="Theory: zero. A millionth of a sheet's thickness is rounding.",
        ),
        Acceptance(
            "identity",
            (
                "Gap of (13) against μ times slip, as its optimality conditions require: largest difference over the "
                "largest gap."
            ),
            1e-6,
            reason="Theory: equal; a hundredth of the last digit of a report.",
        ),
        Acceptance(
            "opening",
            "Largest gap of a loaded contact of the wheelhouse under (13) at the paper's friction.",
            0.02,
            unit="mm",
            bound="at least",
            reason="Ten times the 2 µm that a coordinate measuring machine resolves.",
        ),
        Acceptance(
            "associated-force",
            "Effect of (13) on contact forces there: largest error over the largest force.",
            0.1,
            bound="at least",
            reason="A tenth, the repeatability of clamps and tongs.",
        ),
        Acceptance(
            "associated-slip",
            "Effect of (13) on the mean slip of a zone there, relative.",
            0.1,
            reason="The tenth that the error budget grants a slip.",
        ),
        Acceptance(
            "other-laws",
            (
                "Pressure-dependent, micro-slip and stage-dependent friction on the lap joint, reduced against full: "
                "largest relative difference."
            ),
            1e-8,
            reason="Rounding, as under Coulomb's law; the two routes share no code of a law.",
        ),
        Acceptance(
            "yielding",
            (
                "Micro-slip against Coulomb's law: change at the largest stiffness (1e6 N/mm³; quick: 1e5) over the "
                "change at the smallest (1e3)."
            ),
            0.01,
            quick=0.1,
            reason=(
                "Theory: first order in the compliance, a thousandth over three decades (quick: a hundredth over "
                "two); ten times that, since the softest contacts slip."
            ),
        ),
        Acceptance(
            "other-laws-matter",
            "Effect of these laws on tangential motion: least change against Coulomb's law.",
            1e-4,
            bound="at least",
            reason="1e4 times the limit of the agreement, so an ignored law would be found.",
        ),
    ),
    seconds=(60, 35),
    memory=1.6,
    run=run,
)
