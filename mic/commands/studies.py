"""Commands that study a reduced model: order, contributors, friction, sensitivity, rare and remedy."""

from __future__ import annotations

import json
import math

from mic.commands.invocation import first_rank_only, open_model, store_study
from mic.commands.output import interval
from mic.contact.laws import LAWS
from mic.errors import SceneError
from mic.report.driver_sentences import design_words, friction_words, linear_words, named, remedy_words
from mic.report.style import number, percent, probability
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
from mic.studies import contributors as contributor_study
from mic.studies import friction as friction_study
from mic.studies.adjustment import adjustment_tables
from mic.studies.order import PERMUTATIONS, STATED, compare, orders
from mic.studies.order import variants as read_variants
from mic.studies.rare import rare as estimate_rare
from mic.studies.remedy import remedies
from mic.studies.sensitivity import effects
from mic.system.cores import available_cores
from mic.system.files import write_text

__all__ = ["contributors", "friction", "order", "rare", "remedy", "sensitivity"]

NO_EFFECT = 1e-6  # mm: smaller effects of a step count as none
MAX_INPUTS = 6  # inputs listed for a characteristic
ONE_SIDED = 1e-3  # relative difference of the effects below and above a contact change from which both are printed
FAR = 100.0  # steps: contact changes farther away are not printed


@first_rank_only
def order(source, samples, seed, law, permutations, variants, table):
    """``mic order``, with the values of its options (:mod:`mic.options`)."""
    console, model, folder, law, seed = open_model(source, law, seed)
    random = PERMUTATIONS if permutations is None else permutations
    others = read_variants(model.scene, variants) if variants else orders(model.scene, random)
    if len(others) == 1:
        console.print("The process has one order only: nothing to compare.")
        return
    with console.progress_bar(f"{samples} samples under {law}", len(others)) as advance:
        found = compare(model, others, law, samples, seed, available_cores(), lambda name: advance(1))
    _print_orders(console, others, found)
    if table:
        found.to_csv(table, index=False)
        console.say_files(table=table)
    store_study(console, folder, {ORDERS: found.assign(law=law)[ORDERS.names].astype({"samples": "int64"})})


def _print_orders(console, others, found):
    """For each order the quantity that changes most; for each quantity the order that changes it most."""

    def largest(rows, figure, of):
        """The largest change of a figure, and the quantity or the order with it."""
        row = rows.loc[rows[f"{figure}_change"].abs().idxmax()]
        value, error = row[f"{figure}_change"], row[f"{figure}_error"]
        share = f" ({100 * abs(value) / row['tolerance']:.1f} %)" if row["tolerance"] > 0 else ""
        return f"{1000 * value:+.1f} ± {1000 * error:.1f}{share}".replace("-", "−"), row[of]

    rest = found[found["order"] != STATED]
    for rows, title in (
        (rest[rest["tolerance"] > 0], "Key characteristics: largest change ± standard error (share of the tolerance)"),
        (rest[rest["tolerance"].isna()], "Slip under load: largest change ± standard error"),
    ):
        cells = [
            (name, *largest(own, "mean", "quantity"), *largest(own, "six_sigma", "quantity"))
            for name, own in rows.groupby("order", sort=False)
        ]
        console.table(title, ("order", "mean, µm", "quantity", "6σ, µm", "quantity"), cells)
    cells = []
    for stated in found[found["order"] == STATED].to_dict("records"):
        own = rest[rest["quantity"] == stated["quantity"]]
        changes = [": ".join(largest(own, figure, "order")) for figure in ("mean", "six_sigma")]
        mean = f"{stated['mean']:.4f}".replace("-", "−")
        cells.append((stated["quantity"], mean, f"{stated['six_sigma']:.4f}", *changes))
    heads = ("quantity", "mean, mm", "6σ, mm", "largest change of mean, µm", "largest change of 6σ, µm")
    console.table("Each quantity under the stated order, and the order that changes it most", heads, cells)
    for other in others:
        if other.name.startswith("random"):
            groups = [f"{stage.name}: order = {json.dumps(stage.order)}" for stage in other.scene.stages if stage.order]
            console.say(f"{other.name}: {'; '.join(groups)}")


@first_rank_only
def contributors(source, samples, seed, law):
    """``mic contributors``, with the values of its options (:mod:`mic.options`)."""
    console, model, folder, law, seed = open_model(source, law, seed)
    scene = model.scene
    if not scene.measurements or not scene.deviations:
        what = "deviations: nothing varies" if scene.measurements else "measurements"
        raise SceneError(f"scene {scene.name!r} has no {what}; add some")
    if scene.monte_carlo.values is not None:
        raise SceneError(
            f"scene {scene.name!r}: its samples are given in a table, from which the effect of a single deviation does "
            "not follow; remove monte_carlo.table, so that samples are drawn"
        )
    count = contributor_study.evaluation_count(scene, samples)
    with console.progress_bar(f"evaluations under {law}", count) as advance:
        found = contributor_study.contributors(model, law, samples, seed, available_cores(), advance)
    _print_contributors(console, scene, found)
    store_study(console, folder, {CONTRIBUTORS: found.table, LINEARITY: found.linearity})


def _print_contributors(console, scene, found):
    """The largest contributors of each characteristic and of all together; where a linear analysis misleads."""
    rows = []
    for row in found.linearity.to_dict("records"):
        own = found.table[found.table["measurement"] == row["measurement"]].sort_values("total", ascending=False)
        total = "\n".join(
            "{} {} ({} … {})".format(
                item["contributor"], *(percent(item[f"total{end}"]) for end in ("", "_low", "_high"))
            )
            for item in own.head(3).to_dict("records")
        )
        linear = "\n".join(
            f"{item['contributor']} {percent(item['regression'])}"
            for item in own.sort_values("regression", ascending=False).head(3).to_dict("records")
        )
        rows.append((row["measurement"], number(1e3 * row["sigma"]), total, linear, number(row["r_squared"])))
    heads = ("characteristic", "σ, µm", "share of the variance, with interactions (95 %)", "linear analysis", "R²")
    console.table("Contributors", heads, rows)
    ranked = contributor_study.joint_ranking(found.table, found.linearity, scene)
    console.say(f"All key characteristics together: {named(ranked, 'total')}")
    console.say_each(linear_words(found.table, found.linearity))
    counts = found.linearity.iloc[0]
    total = counts["samples"] + counts["failed"]
    console.say(f"{counts['evaluations']} evaluations; {counts['failed']} of {total} samples failed and are excluded")


@first_rank_only
def friction(source, samples, seed, law):
    """``mic friction``, with the values of its options (:mod:`mic.options`)."""
    console, model, folder, law, seed = open_model(source, law, seed)
    scene = model.scene
    frictional = LAWS[law].frictional and model.contacts.dimension == 3 and model.contacts.frictional
    if not (scene.measurements and frictional):
        why = "it has no measurements" if not scene.measurements else "its zones or its contact law have no friction"
        raise SceneError(f"scene {scene.name!r}: the effect of friction cannot be computed: {why}")
    zones = sum(zone.frictional for zone in scene.zones)
    count = samples * (1 + len(friction_study.FACTORS) + (zones > 1) * 2 * zones)
    with console.progress_bar(f"evaluations under {law}", count) as advance:
        found = friction_study.friction_effects(model, law, samples, seed, available_cores(), advance)
    _print_friction(console, found)
    store_study(console, folder, {FRICTION_EFFECTS: found})


def _print_friction(console, found):
    all_zones = found[found["zone"] == ""]
    heads = ("characteristic", "6σ, µm", *(f"µ × {factor:g}" for factor in all_zones["factor"].unique()))
    for figure, text in (("mean_change", "mean"), ("six_sigma_change", "6σ")):
        rows = []
        for name, own in all_zones.groupby("measurement", sort=False):
            cells = [interval(row, figure) for row in own.to_dict("records")]
            rows.append((name, number(1e3 * own["six_sigma"].iloc[0]), *cells))
        console.table(f"Change of {text} with the friction of all zones multiplied, µm", heads, rows)
    console.say_each(friction_words(found, friction_study.friction_needed(found)))


@first_rank_only
def sensitivity(source, samples, seed, law):
    """``mic sensitivity``, with the values of its options (:mod:`mic.options`)."""
    console, model, folder, law, seed = open_model(source, law, seed)
    scene = model.scene
    if not scene.measurements:
        raise SceneError(f"scene {scene.name!r} has no measurements; add some")
    with console.progress_bar(f"assemblies with derivatives under {law}", 1 + samples) as advance:
        found = effects(model, law, samples, seed, advance)
    _print_effects(console, found)
    _print_sensitivity(console, found)
    store_study(console, folder, {SENSITIVITIES: found.table, SPREADS: found.spread})


def _print_effects(console, found):
    """Effects of a step of each input on each characteristic, the largest first."""
    rows = []
    for name, own in found.table.groupby("measurement", sort=False):
        own = own[own["effect"].abs() > NO_EFFECT]
        largest = own["effect"].abs().sort_values(ascending=False, kind="stable").index
        for i, row in enumerate(own.loc[largest[:MAX_INPUTS]].to_dict("records")):
            effect, low, high = (number(1e3 * row[f"effect{end}"], 2) for end in ("", "_low", "_high"))
            below, above = row["effect_below"], row["effect_above"]
            if abs(above - below) > ONE_SIDED * max(abs(below), abs(above)):
                effect = f"{number(1e3 * below, 2)} below, {number(1e3 * above, 2)} above"
            reach = f"{number(row['reach'], 2)} steps" if row["reach"] < FAR else "–"
            rows.append(("" if i else name, row["input"], number(row["step"], 3), f"{effect} ({low} … {high})", reach))
        if len(own) > MAX_INPUTS:
            rows.append(("", f"… {len(own) - MAX_INPUTS} others", "", "smaller", ""))
        rows.append(())
    effect = "effect, µm (range over the samples)"
    heads = ("characteristic", "input", "step (unit of the input)", effect, "contact change after")
    console.table("Effect of a step of each input", heads, rows)


def _print_sensitivity(console, found):
    """Distance to the next contact change, inputs without effect, failed samples, and 6σ from derivatives."""
    if found.at_change:
        console.say(
            f"In the mean assembly a contact is about to change its state ({found.at_change}): effects differ below "
            "(towards smaller values of the input) and above."
        )
    elif math.isfinite(found.reach):
        distance = f"{number(found.reach, 2)} σ from the mean assembly (stage {found.where})"
        console.say(f"The nearest contact change lies {distance}.")
    largest = found.table.groupby("input")["effect"].apply(lambda x: x.abs().max()).sort_values(ascending=False)
    if inputs := largest.index[largest <= NO_EFFECT].tolist():
        console.say(f"Inputs without effect: {', '.join(inputs)}.")
    if found.failed:
        console.say(f"{found.failed} samples failed and are excluded.")
    for row in found.spread[found.spread["kind"] != "plain"].to_dict("records"):
        with_derivatives, plain = (interval(row, name, digits=3) for name in ("six_sigma", "plain_six_sigma"))
        console.say(
            f"6σ of {row['measurement']}, µm: {with_derivatives} from {row['samples']} samples with derivatives; "
            f"{plain} from the same samples without derivatives."
        )


@first_rank_only
def rare(source, measurement, samples, seed, law):
    """``mic rare``, with the values of its options (:mod:`mic.options`)."""
    console, model, folder, law, seed = open_model(source, law, seed)
    scene, names = model.scene, measurement or []
    known = [item.name for item in scene.measurements]
    unknown = [name for name in names if name not in known]
    if unknown or not known:
        what = f"no measurement {unknown[0]!r}; it has: {', '.join(known)}" if known else "no measurements; add some"
        raise SceneError(f"scene {scene.name!r} has {what}")
    if not scene.deviations or scene.monte_carlo.values is not None:
        why = "its samples are given in a table; remove monte_carlo.table" if scene.deviations else "nothing varies"
        raise SceneError(f"scene {scene.name!r}: rare samples cannot be drawn: {why}")
    with console.progress_bar(f"evaluations under {law}", None) as advance:
        found = estimate_rare(model, law, names, samples - samples % 10, seed, available_cores(), advance)
    for row in found.table.to_dict("records"):
        share = probability(row["outside"], row["outside_low"], row["outside_high"])
        method = "plain Monte Carlo" if row["levels"] == 1 else f"{row['levels']} levels"
        console.say(
            f"{row['measurement'] or 'Assemblies'} outside limits: {share}; {method}, "
            f"{row['evaluations']} evaluations"
            + f", {row['failed']} of which failed and are excluded" * bool(row["failed"])
            + f"; first-order estimate {probability(row['first_order'])}" * math.isfinite(row["first_order"])
        )
    console.say_each(design_words(found.table, found.points))
    if found.why_not:
        console.say(f"Most likely miss: not computed; {found.why_not}.")
    store_study(console, folder, {RARE: found.table, DESIGN_POINTS: found.points})


@first_rank_only
def remedy(source, adjust, shim, force, capability, samples, seed, law, save):
    """``mic remedy``, with the values of its options (:mod:`mic.options`)."""
    if save is not None and (not source.is_file() or source.suffix != ".toml"):
        raise SceneError(f"{source}: --save writes a changed copy of a scene file; give a scene file, or omit --save")
    console, model, folder, law, seed = open_model(source, law, seed)
    try:
        with console.progress_bar(f"assemblies under {law}", None) as advance:
            found = remedies(
                model, law, samples, seed, shim, force, adjust or [], capability, available_cores(), advance
            )  # fmt: skip
    except ValueError as problem:
        raise SceneError(str(problem)) from problem
    _print_remedies(console, found, capability)
    console.say_each(remedy_words(found.table, found.effects, model.scene))
    successful = [own for own in found.found if own.reached]
    if successful:
        tables = adjustment_tables(model.scene, successful[-1].changes)
        console.say("To apply the last successful remedy, append to the scene file:")
        console.say(tables)
        if save is not None:
            text = source.read_text(encoding="utf-8").rstrip("\n")
            write_text(save, f"{text}\n\n# {successful[-1].name}\n{tables}")
            console.say_files(scene=save)
    elif save is not None:
        console.say(f"No remedy succeeds: {save} is not written.")
    store_study(console, folder, {REMEDIES: found.table, REMEDY_EFFECTS: found.effects})


def _print_remedies(console, found, capability):
    """The adjustments of each remedy, and their effect on each characteristic on the fresh samples."""
    rows = []
    for own in found.found:
        effects_ = found.effects[found.effects["remedy"] == own.name]
        effects_ = effects_[effects_["fresh"] == effects_["fresh"].max()]
        moves = "\n".join(f"{item.name} {item.now:g} → {item.now + x:g} {item.unit}" for item, x in own.changes.items())
        for i, row in enumerate(effects_.to_dict("records")):
            pairs = [
                f"{number(scale * row[f'{name}_before'], 3)} → {number(scale * row[name], 3)}"
                for name, scale in (("mean", 1e3), ("six_sigma", 1e3), ("cpk", 1.0))
            ]
            share = f"{percent(row['outside_before'], 1)} → {percent(row['outside'], 1)}"
            rows.append(("" if i else moves, row["measurement"], *pairs, share, interval(row, "gain")))
        rows.append(())
    heads = ("remedy", "characteristic", "mean, µm", "6σ, µm", "Cpk", "outside limits", "gain of margin, µm")
    margin = f"mean ± {3 * capability:g}σ to the nearer limit, negative outside"
    console.table(f"Remedies, on fresh samples; margin: distance of {margin}", heads, rows)
