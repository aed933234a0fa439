"""The commands that ask a model more than a run tells: see :mod:`mic.studies`."""

from __future__ import annotations

import json
import math

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from mic.commands.invocation import counting, keep_studies, law_of, on_one_process, seed_of, studied, threads
from mic.contact.laws import LAWS
from mic.errors import SceneError
from mic.results.schema import (
    CONTRIBUTORS,
    DESIGN_POINTS,
    FRICTION_EFFECTS,
    LINEARITY,
    ORDERS,
    RARE,
    REMEDIES,
    REMEDY_EFFECTS,
    SENSITIVITIES,
    SPREADS,
)
from mic.studies import contributors as driving
from mic.studies import friction as rubbing
from mic.studies import remedy as mending
from mic.studies import sensitivity as slopes
from mic.studies.adjustment import written
from mic.studies.input_screening import MANY
from mic.studies.order import PERMUTATIONS, STATED, compare, orders
from mic.studies.order import variants as read_variants
from mic.studies.rare import rare as rare_events
from mic.system.console import plain
from mic.system.files import write_text

__all__ = [
    "contributors",
    "friction",
    "order",
    "rare",
    "remedy",
    "sensitivity",
]

NOTHING = 1e-6  # mm: a step that changes no more changes nothing
LISTED = 6  # inputs that a characteristic shows
SIDED = 1e-3  # of the larger: effects to either side of a change that differ by less are one
FAR = 100.0  # steps: no contact that a step could change


@on_one_process
def order(source, samples, seed, law, permutations, variants, table):
    """``mic order``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    model, folder = studied(console, source)
    scene, asked = model.scene, law_of(model, law)
    random = PERMUTATIONS if permutations is None else permutations
    others = read_variants(scene, variants) if variants else orders(scene, random)
    if len(others) == 1:
        console.print("The process has one order only: nothing to compare.")
        return
    with Progress(console=console) as progress:
        bar = progress.add_task(f"{samples} samples under {asked}", total=len(others))
        found = compare(
            model,
            others,
            asked,
            samples,
            scene.monte_carlo.seed if seed is None else seed,
            threads(),
            lambda name: progress.advance(bar),
        )
    _print_orders(console, others, found)
    if table:
        found.to_csv(table, index=False)
        console.print(f"table: {plain(table)}")
    keep_studies(console, folder, {ORDERS: found.assign(law=asked)[ORDERS.names].astype({"samples": "int64"})})


def _print_orders(console, others, found):
    """By order, the quantity that changes most; by quantity, the order that changes it most."""

    def change(row, key):
        share = f" ({100 * abs(row[key]) / row['tolerance']:.1f} %)" if row["tolerance"] > 0 else ""
        return f"{1000 * row[key]:+.1f} ± {1000 * row[f'{key[:-6]}error']:.1f}{share}".replace("-", "−")

    def largest(rows, key):
        return rows.loc[rows[key].abs().idxmax()]

    keys = ("mean_change", "six_sigma_change")
    measured, slips = found[found["tolerance"] > 0], found[found["tolerance"].isna()]
    for rows, title in (
        (measured, "Key characteristics: largest change (of the tolerance)"),
        (slips, "Slip under load"),
    ):
        table = Table("order", "mean, µm", "of", "6σ, µm", "of", title=title)
        for name, own in rows[rows["order"] != STATED].groupby("order", sort=False):
            worst = [largest(own, key) for key in keys]
            cells = (cell for row, key in zip(worst, keys) for cell in (change(row, key), row["quantity"]))
            table.add_row(name, *cells)
        if table.row_count:
            console.print(table)
    table = Table("as stated", "mean, mm", "6σ, mm", "largest change of mean, µm", "of 6σ, µm", title="By quantity")
    rest = found[found["order"] != STATED]
    for _, stated in found[found["order"] == STATED].iterrows():
        own = rest[rest["quantity"] == stated["quantity"]]
        cells = [f"{change(row, key)}: {row['order']}" for key in keys for row in [largest(own, key)]]
        table.add_row(stated["quantity"], f"{stated['mean']:.4f}", f"{stated['six_sigma']:.4f}", *cells)
    console.print(table)
    for other in others:
        if other.name.startswith("random"):
            groups = [f"{stage.name}: order = {json.dumps(stage.order)}" for stage in other.scene.stages if stage.order]
            console.print(f"{other.name}: {plain('; '.join(groups))}", highlight=False, soft_wrap=True)


@on_one_process
def contributors(source, samples, seed, law):
    """``mic contributors``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    model, folder = studied(console, source)
    scene, asked = model.scene, law_of(model, law)
    if not scene.measurements or not scene.deviations:
        what = "deviations: nothing varies" if scene.measurements else "measurements: nothing is asked for"
        raise SceneError(f"scene {scene.name!r} has no {what}; give it some")
    if scene.monte_carlo.values is not None:
        raise SceneError(
            f"scene {scene.name!r}: it states its samples in a table, which does not say what each deviation does "
            "alone; take monte_carlo.table out, so that they are drawn"
        )
    found = len(driving.groups(scene))
    varying = sum(one.sigma > 0 for one in scene.deviations)
    count = samples * (found + 2) + 2 * varying if found <= MANY else None
    with counting(console, f"evaluations under {asked}", count) as advance:
        found = driving.contributors(model, asked, samples, seed_of(scene, seed), threads(), advance)
    _print_contributors(console, scene, found)
    keep_studies(console, folder, {CONTRIBUTORS: found.table, LINEARITY: found.linearity})


def _print_contributors(console, scene, found):
    """By characteristic, what makes its variance; what hurts most overall; where a linear analysis misleads."""
    from mic.report.driver_sentences import linear_words, named  # drawing libraries are slow to import
    from mic.report.style import number, percent

    table = Table(
        "characteristic", "σ, µm", "driven by (share of the variance, with interactions)", "linear analysis", "R²",
        title="What drives the key characteristics",
    )  # fmt: skip
    for row in found.linearity.to_dict("records"):
        own = found.table[found.table["measurement"] == row["measurement"]].sort_values("total", ascending=False)
        linear = own.sort_values("regression", ascending=False)
        driven = "\n".join(
            f"{plain(each['contributor'])} {percent(each['total'])} "
            f"({percent(each['total_low'])} … {percent(each['total_high'])})"
            for each in own.head(3).to_dict("records")
        )
        said = "\n".join(
            f"{plain(each['contributor'])} {percent(each['regression'])}" for each in linear.head(3).to_dict("records")
        )
        table.add_row(plain(row["measurement"]), number(1e3 * row["sigma"]), driven, said, number(row["r_squared"]))
    console.print(table)
    ranked = driving.joint_ranking(found.table, found.linearity, scene)
    console.print(f"Over all key characteristics: {plain(named(ranked, 'total'))}")
    for sentence in linear_words(found.table, found.linearity):
        console.print(plain(sentence), highlight=False, soft_wrap=True)
    one = found.linearity.iloc[0]
    console.print(
        f"{one['evaluations']} evaluations, {one['failed']} of {one['samples'] + one['failed']} samples left out"
    )


@on_one_process
def friction(source, samples, seed, law):
    """``mic friction``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    model, folder = studied(console, source)
    scene, asked = model.scene, law_of(model, law)
    if not (
        scene.measurements and LAWS[asked].frictional and model.contacts.dimension == 3 and model.contacts.frictional
    ):
        why = "nothing is measured" if not scene.measurements else "nothing has friction, or the law has none"
        raise SceneError(f"scene {scene.name!r}: there is no friction to ask for: {why}")
    zones = sum(zone.frictional for zone in scene.zones)
    count = samples * (1 + len(rubbing.FACTORS) + (zones > 1) * 2 * zones)
    with counting(console, f"evaluations under {asked}", count) as advance:
        found = rubbing.friction_effects(model, asked, samples, seed_of(scene, seed), threads(), advance)
    _print_friction(console, found)
    keep_studies(console, folder, {FRICTION_EFFECTS: found})


def _print_friction(console, found):
    from mic.report.driver_sentences import friction_words  # drawing libraries are slow to import
    from mic.report.style import number

    factors = list(found.loc[found["zone"] == "", "factor"].unique())
    for figure, word in (("mean_change", "mean"), ("six_sigma_change", "6σ")):
        table = Table(
            "characteristic", "6σ, µm", *(f"µ × {factor:g}" for factor in factors), title=f"Change of {word}, µm"
        )
        for name, own in found[found["zone"] == ""].groupby("measurement", sort=False):
            cells = [
                f"{number(1e3 * row[figure], 2)} ({number(1e3 * row[f'{figure}_low'], 2)} … "
                f"{number(1e3 * row[f'{figure}_high'], 2)})"
                for row in own.to_dict("records")
            ]
            table.add_row(plain(name), number(1e3 * own["six_sigma"].iloc[0]), *cells)
        console.print(table)
    for sentence in friction_words(found, rubbing.friction_needed(found)):
        console.print(plain(sentence), highlight=False, soft_wrap=True)


@on_one_process
def sensitivity(source, samples, seed, law):
    """``mic sensitivity``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    model, folder = studied(console, source)
    scene, asked = model.scene, law_of(model, law)
    if not scene.measurements:
        raise SceneError(f"scene {scene.name!r} has no measurements: nothing is asked for; give it some")
    with counting(console, f"assemblies with derivatives under {asked}", 1 + samples) as advance:
        found = slopes.effects(model, asked, samples, seed_of(scene, seed), advance)
    _print_sensitivity(console, found)
    keep_studies(console, folder, {SENSITIVITIES: found.table, SPREADS: found.spread})


def _print_sensitivity(console, found):
    """What steps of the inputs change in each characteristic, the largest first."""
    from mic.report.style import number  # drawing libraries are slow to import

    table = Table(
        "characteristic", "input", "step", "µm (over the samples)", "contact changes after",
        title="What a step changes",
    )  # fmt: skip
    most = found.table.groupby("input")["effect"].apply(lambda x: x.abs().max()).sort_values(ascending=False)
    for name, own in found.table.groupby("measurement", sort=False):
        own = own[own["effect"].abs() > NOTHING]
        order = own["effect"].abs().sort_values(ascending=False, kind="stable").index
        for i, row in enumerate(own.loc[order[:LISTED]].to_dict("records")):
            effect, low, high = (number(1e3 * row[key], 2) for key in ("effect", "effect_low", "effect_high"))
            if abs(row["effect_above"] - row["effect_below"]) > SIDED * max(
                abs(row["effect_below"]), abs(row["effect_above"])
            ):
                effect = f"{number(1e3 * row['effect_below'], 2)} below, {number(1e3 * row['effect_above'], 2)} above"
            reach = f"{number(row['reach'], 2)} steps" if row["reach"] < FAR else "–"
            first = "" if i else plain(str(name))
            table.add_row(first, plain(row["input"]), number(row["step"], 3), f"{effect} ({low} … {high})", reach)
        if len(own) > LISTED:
            table.add_row("", f"… {len(own) - LISTED} others", "", "less", "")
        table.add_section()
    console.print(table)
    if found.at_change:
        console.print(
            f"The mean assembly is at a change of a contact ({plain(found.at_change)}): effects differ below it, "
            "towards smaller values of the input, and above",
            highlight=False,
            soft_wrap=True,
        )
    elif math.isfinite(found.reach):
        console.print(
            f"The mean assembly is {number(found.reach, 2)} σ from the next change of a contact: {plain(found.where)}",
            highlight=False,
            soft_wrap=True,
        )
    if still := most.index[most <= NOTHING].tolist():
        console.print(f"Nothing is changed by {plain(', '.join(still))}", highlight=False, soft_wrap=True)
    if found.failed:
        console.print(f"{found.failed} samples failed and are left out")
    told = found.spread[found.spread["kind"] != "plain"]
    for row in told.to_dict("records"):
        by, alone = (
            f"{number(1e3 * row[name])} µm ({number(1e3 * row[f'{name}_low'])} … {number(1e3 * row[f'{name}_high'])})"
            for name in ("six_sigma", "plain_six_sigma")
        )
        console.print(
            f"6σ of {plain(row['measurement'])} by {row['samples']} samples and their derivatives: {by}; by the "
            f"samples alone: {alone}",
            highlight=False,
            soft_wrap=True,
        )


@on_one_process
def rare(source, measurement, samples, seed, law):
    """``mic rare``, with the values of its options (:mod:`mic.options`)."""
    from mic.report.style import number  # drawing libraries are slow to import

    console = Console()
    model, folder = studied(console, source)
    scene, asked, names = model.scene, law_of(model, law), measurement or []
    known = [item.name for item in scene.measurements]
    unknown = [name for name in names if name not in known]
    if unknown or not known:
        what = (
            f"no measurement {unknown[0]!r}; it has: {', '.join(known)}" if known else "no measurements; give it some"
        )
        raise SceneError(f"scene {scene.name!r} has {what}")
    if not scene.deviations or scene.monte_carlo.values is not None:
        why = "its samples stand in a table; take monte_carlo.table out" if scene.deviations else "nothing varies"
        raise SceneError(f"scene {scene.name!r}: there are no rare samples to look for: {why}")
    with counting(console, f"evaluations under {asked}", None) as advance:
        found = rare_events(model, asked, names, samples - samples % 10, seed_of(scene, seed), threads(), advance)
    from mic.report.driver_sentences import design_words

    for row in found.table.to_dict("records"):
        what = f"{row['measurement']} misses its limits" if row["measurement"] else "The assembly misses a limit"
        share, low, high = (number(1e6 * row[name], 2) for name in ("outside", "outside_low", "outside_high"))
        how = "a plain Monte Carlo" if row["levels"] == 1 else f"{row['levels']} levels"
        console.print(
            f"{plain(what)} in {share} of a million ({low} to {high}): {how}, {row['evaluations']} evaluations"
            + f", {row['failed']} of which failed and do not count" * bool(row["failed"])
            + f"; to first order {number(1e6 * row['first_order'], 2)}" * math.isfinite(row["first_order"]),
            highlight=False,
            soft_wrap=True,
        )
    for sentence in design_words(found.table, found.points):
        console.print(plain(sentence), highlight=False, soft_wrap=True)
    if found.why_not:
        console.print(f"No likeliest miss is told: {plain(found.why_not)}", highlight=False, soft_wrap=True)
    keep_studies(console, folder, {RARE: found.table, DESIGN_POINTS: found.points})


@on_one_process
def remedy(source, adjust, shim, force, capability, samples, seed, law, save):
    """``mic remedy``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    if save is not None and (not source.is_file() or source.suffix != ".toml"):
        raise SceneError(f"{source}: --save writes a changed copy of a scene file; name one, or leave --save out")
    model, folder = studied(console, source)
    asked = law_of(model, law)
    try:
        with counting(console, f"assemblies under {asked}", None) as advance:
            found = mending.remedies(
                model, asked, samples, seed_of(model.scene, seed), shim, force, adjust, capability, threads(), advance
            )
    except ValueError as problem:
        raise SceneError(str(problem)) from problem
    _print_remedies(console, model.scene, found)
    serving = [one for one in found.found if one.reached]
    if save is not None and serving:
        text = source.read_text(encoding="utf-8").rstrip("\n")
        write_text(save, f"{text}\n\n# {serving[-1].name}\n{written(model.scene, serving[-1].changes)}")
        console.print(f"scene: {plain(save)}")
    elif save is not None:
        console.print(f"No remedy serves, so that {plain(save)} is not written.", highlight=False, soft_wrap=True)
    keep_studies(console, folder, {REMEDIES: found.table, REMEDY_EFFECTS: found.effects})


def _print_remedies(console, scene, found):
    """By remedy: what to set, and what that does to each characteristic, of fresh samples."""
    from mic.report.driver_sentences import remedy_words  # drawing libraries are slow to import
    from mic.report.style import number, percent

    if found.found:
        table = Table(
            "remedy", "characteristic", "mean, µm", "6σ, µm", "Cpk", "outside", "gain of margin, µm",
            title="What would mend it",
        )  # fmt: skip
        for one in found.found:
            own = found.effects[found.effects["remedy"] == one.name]
            own = own[own["fresh"] == own["fresh"].max()]
            moves = "\n".join(f"{plain(a.name)} {a.now:g} → {a.now + x:g} {a.unit}" for a, x in one.changes.items())
            for i, row in enumerate(own.to_dict("records")):
                pairs = (
                    f"{number(scale * row[f'{name}_before'], 3)} → {number(scale * row[name], 3)}"
                    for name, scale in (("mean", 1e3), ("six_sigma", 1e3), ("cpk", 1.0))
                )
                share = f"{percent(row['outside_before'], 1)} → {percent(row['outside'], 1)}"
                ends = (number(1e3 * row[f"gain{end}"], 2) for end in ("", "_low", "_high"))
                gain = "{} ({} … {})".format(*ends)
                table.add_row("" if i else moves, plain(row["measurement"]), *pairs, share, gain)
            table.add_section()
        console.print(table)
    for sentence in remedy_words(found.table, found.effects, scene):
        console.print(plain(sentence), highlight=False, soft_wrap=True)
    serving = [one for one in found.found if one.reached]
    if serving:
        console.print("In the scene file, at its end, the last of these that serves:")
        console.print(plain(written(scene, serving[-1].changes)), highlight=False, soft_wrap=True)
