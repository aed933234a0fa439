"""What the commands of ``mic`` do; :mod:`mic.options` declares them."""

from __future__ import annotations

import json
import math
import os
import shlex
import sys
from contextlib import contextmanager
from functools import wraps
from pathlib import Path

import numpy as np
import pandas as pd
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from mic import cache_folder, density, examples
from mic import contributors as driving
from mic import friction as rubbing
from mic import sensitivity as slopes
from mic.compliance.cache import influence_coefficients, is_cached
from mic.compliance.provider import check_element
from mic.console import plain
from mic.contact.laws import LAWS
from mic.errors import MissingProvider, RunError, SceneError, Stopped, StorageError
from mic.geometry.normals import COARSE, Rule
from mic.geometry.told import told
from mic.judgement import judge, readable, refuse, suspect, verdict
from mic.model.accuracy import estimate_accuracy
from mic.model.assembly import assemble
from mic.model.one_sigma import one_sigma
from mic.model.overlap import frozen_gaps
from mic.orders import PERMUTATIONS, STATED, compare, doubts, orders
from mic.orders import variants as read_variants
from mic.process.model import ReducedModel
from mic.process.plan import plan_assembly
from mic.process.words import opening, sentences
from mic.proposal import write_scene
from mic.rare import rare as rare_events
from mic.results.excel import write_excel
from mic.results.folder import EXCEL, RunFolder
from mic.results.forecast import forecast
from mic.results.identity import identity
from mic.results.schema import CONTRIBUTORS, DENSITY, FRICTION_EFFECTS, LINEARITY, ORDERS, RARE, SENSITIVITIES
from mic.runs import Listener, conclude, finished, hold
from mic.runs import run as run_scene
from mic.sampling.ranks import communicator, on_first
from mic.scene import load_scene
from mic.store import replacing

__all__ = ["check", "contributors", "friction", "init", "order", "rare", "report", "run", "sensitivity"]

ENOUGH = 0.01  # error of a mesh for which `mic check --accuracy` says what it would take
NOTHING = 1e-6  # mm: a step that changes no more changes nothing
FAR = 100.0  # steps: no contact that a step could change
LOOKED_AT = 1000  # contact pairs; a check looks no closer at the process of a larger assembly: it would take minutes
LISTED = 40  # sources that a check tells one by one


def _on_first(command):
    """A command that takes one process; under ``mpirun`` the others leave it to the first."""

    @wraps(command)
    def alone(*args, **options):
        world = communicator()
        if world is None or world.rank == 0:
            command(*args, **options)

    return alone


def _requested(scene, laws, samples=None, seed=None, backend=None):
    """The scene with what the command line asks for instead."""
    changes = {}
    if laws:
        changes["report"] = scene.report.model_copy(update={"laws": list(dict.fromkeys(law.value for law in laws))})
    updates = {
        key: value for key, value in (("samples", samples), ("seed", seed), ("backend", backend)) if value is not None
    }
    if updates:
        changes["monte_carlo"] = scene.monte_carlo.model_copy(update=updates)
    return scene.model_copy(update=changes)


def run(scene, samples, seed, law, backend, out, replace, strict):
    """``mic run``, with the values of its options (:mod:`mic.options`)."""
    world = communicator()
    console = Console(quiet=world is not None and world.rank > 0)
    asked = on_first(world, lambda: _requested(load_scene(scene), law, samples, seed, backend and backend.value))
    if out is None and asked.name.strip(".") == "":
        raise RunError(f"scene name {asked.name!r}: cannot name a results folder; name the folder with --out")
    folder = out or Path("results") / asked.name
    try:
        with hold(folder, _Listener(console)):
            outcome = run_scene(asked, folder, cache_folder(), _Listener(console), replace, strict)
            if outcome is not None:
                _report(console, outcome)
    except (KeyboardInterrupt, Stopped) as stop:
        laws, samples = asked.report.laws, asked.monte_carlo.samples
        console.print(
            f"Interrupted: {finished(folder, laws, samples)} of {len(laws) * samples} samples are finished and kept in "
            f"{plain(folder)}; run the same command again to complete it: {plain(shlex.join(['mic', *sys.argv[1:]]))}",
            highlight=False,
            soft_wrap=True,
        )
        raise typer.Exit(_status(stop)) from None


@_on_first
def report(folder, excel):
    """``mic report``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    try:
        _report(console, conclude(folder, listener=_Listener(console)))
        if excel:
            with hold(folder, _Listener(console)):
                book = write_excel(folder, folder / EXCEL)
            console.print(f"Excel: [bold]{plain(book)}[/]", soft_wrap=True)
    except (KeyboardInterrupt, Stopped) as stop:
        console.print(f"Interrupted: the samples in {plain(folder)} stand untouched; call mic report again.")
        raise typer.Exit(_status(stop)) from None


def _report(console, outcome):
    """The page, and on the console the least that a user wants to know."""
    from mic.report.answer import answer  # drawing libraries are slow to import, and most commands need none
    from mic.report.page import write_report

    page = write_report(outcome.folder, outcome)
    _print_zones(console, outcome)
    found = answer(outcome)
    for sentence in found.sentences if found else ():
        console.print(plain(sentence), highlight=False, soft_wrap=True)
    console.print(f"report: [bold]{plain(page)}[/]   tables: {plain(outcome.folder / 'summary.json')}")


class _Listener(Listener):
    """Shows a run on the console."""

    def __init__(self, console):
        self.console = console

    def say(self, sentence):
        self.console.print(plain(sentence), highlight=False, soft_wrap=True)

    @contextmanager
    def sampling(self, laws, samples):
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
        with Progress(*columns, TimeRemainingColumn(), console=self.console, disable=self.console.quiet) as progress:
            bars = {law: progress.add_task(f"{law} samples", total=samples) for law in laws}
            yield lambda law, count: progress.advance(bars[law], count)


def _print_zones(console, outcome):
    """The paper's Table 1, slip under load beside it, what the path left, and how many samples failed."""
    from mic.report.style import change, number

    laws = outcome.summary()["laws"]
    zones = list(dict.fromkeys(zone for law in laws.values() for zone in law["zones"]))
    for motion, title in (
        ("rms_tangential", "RMS tangential displacement, mm"),
        ("rms_slip", "RMS slip under load, mm"),
    ):
        shown = {
            name: law["zones"]
            for name, law in laws.items()
            if any(zone[f"mean_{motion}"] is not None for zone in law["zones"].values())
        }
        if not shown:
            continue
        table = Table(
            "zone", *(f"{law}: mean / 6σ" for law in shown), title=f"{title}; path: what a tighter one changes"
        )
        for zone in zones:
            cells = []
            for found in shown.values():
                names = [f"{figure}_{motion}" for figure in ("mean", "six_sigma")]
                cell = " / ".join(number(found[zone][name], 4) for name in names)
                if found[zone][f"{names[0]}_path"] is not None:
                    changes = (change(found[zone][f"{name}_path"], found[zone][f"{name}_path_share"]) for name in names)
                    cell += f"\npath {' / '.join(changes)}"
                cells.append(cell)
            table.add_row(zone, *cells)
        console.print(table)
    for name, law in laws.items():
        console.print(
            f"{name}: worst residual {number(law['worst_residual'], 2)}, failed samples {law['failed']}, "
            f"rescued by plain increments {law['rescued']}{_hanging(law)}",
            soft_wrap=True,
        )
        _print_limits(console, law)
        if law["unseen_penetration"]:
            console.print(_unseen_words(law["unseen_penetration"]), highlight=False, soft_wrap=True)


def _print_limits(console, law):
    """How many assemblies are not built, and which clamps and guns fall short of their position."""
    from mic.report.style import number

    if law["not_built"]:
        console.print(f"  not built: {law['not_built']} of {law['samples']} samples", style="yellow")
    for row in law["limits"]:
        if row["short"]:
            console.print(
                f"  {plain(row['name'])} falls short of its position in {row['short']} samples (stage "
                f"{plain(row['stage'])}): by up to {number(row['max_left'], 3)} mm; that would take up to "
                f"{number(row['max_needed'], 3)} N, and it has {number(row['limit'], 3)} N",
                soft_wrap=True,
            )


def _unseen_words(unseen) -> str:
    """How deep sheets pass through each other between the contact pairs, and where."""
    where = ", ".join(f"{x:.1f}" for x in unseen["point"])
    return (
        f"  deepest penetration between the contact pairs: {unseen['depth']:.2g} mm, zone {plain(unseen['zone'])}, at "
        f"({where}), stage {plain(unseen['stage'])}, sample {unseen['sample']}"
    )


def _hanging(law):
    """What a tighter path changes of the key characteristics, at most."""
    from mic.report.style import change

    told = []
    for figure, word in (("mean", "means"), ("six_sigma", "6σ")):
        found = [item for item in law["measurements"].values() if item[f"{figure}_path"] is not None]
        if found:
            most = max(found, key=lambda item: abs(item[f"{figure}_path"]))
            told.append(f"{word} {change(most[f'{figure}_path'], most[f'{figure}_path_share'])}")
    if not told:
        return ""
    repeated = law["path"]["repeated"]
    return f"; {repeated} samples on a tighter path change key characteristics by at most: {', '.join(told)}"


@_on_first
def check(scene, law, accuracy, converge, normals, overlap, strict, page):
    """``mic check``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    asked = _requested(load_scene(scene), law)
    for script in dict.fromkeys(part.geometry for part in asked.parts if part.geometry is not None):
        console.print(
            f"This scene is a program: {plain(asked.folder / script)} is executed to make its meshes.",
            highlight=False,
            soft_wrap=True,
        )
    say = lambda line: console.print(plain(f"{line} …"), highlight=False, soft_wrap=True)
    try:
        assembly = assemble(asked, cache_folder(), progress=say, check=plan_assembly)
        plans = plan_assembly(assembly)
    except SceneError as error:
        parts = readable(asked, cache_folder())
        warnings, surfaces = suspect(asked, parts), {one.part.name: one.surface for one in parts}
        _print_warnings(console, warnings)
        _draw_check(console, page, asked, surfaces, warnings, errors=str(error).splitlines())
        raise
    warnings = judge(asked, assembly)
    console.print(f"[bold]{plain(asked.name)}[/] {plain(asked.description)}")
    _print_parts(console, assembly)
    _print_told(console, asked, assembly)
    _print_normals(console, assembly)
    for sentence in assembly.placed:
        console.print(plain(sentence), highlight=False, soft_wrap=True)
    _print_contacts(console, assembly)
    _print_process(console, assembly, plans)
    model = _at_hand(assembly)
    _print_doubts(console, assembly, model)
    shapes = _print_sources(console, assembly, model)
    _print_cost(console, assembly, plans)
    if accuracy:
        _print_accuracy(console, assembly, say)
    if converge:
        converged = density.converge(assembly, cache_folder(), asked.report.laws[0], say)
        _print_convergence(console, assembly, converged)
        folder = Path("results") / asked.name
        if _holds(folder, assembly):
            _keep_studies(console, folder, {DENSITY: _density_table(asked, converged)})
    surfaces = {part.name: part.surface for part in assembly.parts}
    _draw_check(console, page, assembly.scene, surfaces, warnings, assembly.contacts, plans, shapes=shapes)
    if normals is not None or overlap is not None:
        from mic.report.space_pictures import draw_normals, draw_overlap  # drawing libraries are slow to import

        if normals is not None:
            _keep_picture(console, "normals", draw_normals(surfaces), normals)
        if overlap is not None:
            _keep_picture(console, "overlap", draw_overlap(surfaces, assembly.contacts), overlap)
    if strict:
        refuse(warnings)
    _print_warnings(console, warnings)
    console.print(f"[{'yellow' if warnings else 'green'}]{verdict(warnings)}[/]")


def _print_warnings(console, warnings):
    for warned in warnings:
        console.print(f"[yellow]warning:[/] {plain(warned)}", highlight=False, soft_wrap=True)


def _draw_check(console, page, scene, surfaces, warnings, contacts=None, plans=(), errors=(), shapes=()):
    """The page of the check; where it cannot be written, that is all that is wrong."""
    from mic.report.check_page import write_check  # drawing libraries are slow to import

    page = page or Path("results") / (scene.name if scene.name.strip(".") else "scene") / "check.html"
    try:
        write_check(page, scene, surfaces, warnings, contacts, plans, errors, shapes)
    except (StorageError, OSError) as problem:
        console.print(f"[yellow]no page:[/] {plain(problem)}; name another file with --page", soft_wrap=True)
    else:
        console.print(f"page: [bold]{plain(page)}[/]", soft_wrap=True)


def _keep_picture(console, what, picture, file):
    with replacing(file) as temporary:
        temporary.write_bytes(picture.data)
    console.print(f"{what}: [bold]{plain(file)}[/]", soft_wrap=True)


def _print_process(console, assembly, plans):
    """Step by step, in words."""
    console.print("[bold]Process[/]")
    for plan in plans:
        name = plan.name if plan.name == plan.kind else f"{plan.name} ({plan.kind})"
        console.print(f"{plain(name)}: {opening(plan, len(assembly.contacts) > 0)}", highlight=False)
        for number, sentence in enumerate(sentences(assembly.scene, plan), 1):
            console.print(f"  {number}. {plain(sentence)}", highlight=False, soft_wrap=True)


def _at_hand(assembly):
    """The reduced model, where the influence coefficients are cached and it is not large; else None."""
    if all(is_cached(part, cache_folder()) for part in assembly.parts) and len(assembly.contacts) <= LOOKED_AT:
        return ReducedModel.build(assembly, influence_coefficients(assembly, cache_folder())[0])
    return None


def _print_sources(console, assembly, model):
    """What 1 σ of each source makes, as far as it is known without long work; returns the shapes."""
    items, shapes = assembly.scene.deviations, []
    if not items:
        return shapes
    if model is not None:
        try:
            shapes = one_sigma(assembly, model)
        except MissingProvider as problem:
            console.print(f"[yellow]no shapes:[/] {plain(problem)}", highlight=False, soft_wrap=True)
    largest = {shape.name: shape.largest for shape in shapes}
    table = Table("source", "kind", "mean", "σ", "1 σ is at most", title="Sources")
    for item in items[:LISTED]:
        table.add_row(item.name, item.kind, f"{item.mean:g}", f"{item.sigma:g}", _one_sigma(assembly, item, largest))
    console.print(table)
    if len(items) > LISTED:
        console.print(f"… and {len(items) - LISTED} more")
    if model is None:
        console.print("What 1 σ of a force makes is told once the influence coefficients are computed.")
    return shapes


def _one_sigma(assembly, item, largest) -> str:
    if item.name in largest:
        part, vertex, length = largest[item.name]
        surface = next(one.surface for one in assembly.parts if one.name == part)
        place = ", ".join(f"{x:.0f}" for x in surface.points[vertex])
        return f"{length:.3g} mm, {part} at ({place})"
    if item.kind == "shape":
        return f"{item.sigma * np.abs(item.known).max():.3g} mm at its points"
    return ""


def _print_doubts(console, assembly, model):
    """What the process leaves to doubt, if a look at it is cheap."""
    if not len(assembly.contacts) or not any(LAWS[law].frictional for law in assembly.scene.report.laws):
        return
    if model is None:
        at_hand = all(is_cached(part, cache_folder()) for part in assembly.parts)
        why = "" if at_hand else ", once the influence coefficients are computed"
        console.print(f"How much hangs on the order of the process, mic order tells{why}.", highlight=False)
        return
    for doubt in doubts(model):
        console.print(f"[yellow]note:[/] {plain(doubt)}; mic order tells more", highlight=False, soft_wrap=True)


def _print_parts(console, assembly):
    table = Table(
        "part", "nodes", "triangles", "t, mm", "E, MPa", "ν", "functionals", "influence coefficients", title="Parts"
    )
    for part in assembly.parts:
        table.add_row(
            part.name,
            str(len(part.surface.points)),
            str(len(part.surface.triangles)),
            f"{part.thickness:g}",
            f"{part.young:g}",
            f"{part.poisson:g}",
            str(len(part.functionals)),
            _coefficients(part),
        )
    console.print(table)


def _print_told(console, asked, assembly):
    """What the parts' mesh files were taken for."""
    for part, source, filled in zip(assembly.parts, asked.parts, assembly.scene.parts):
        deck = assembly.decks.get(part.name)
        for sentence in told(source, filled, deck, part.surface) if deck is not None else ():
            console.print(plain(sentence), highlight=False, soft_wrap=True)


def _print_normals(console, assembly):
    """What decided the normals of the curved sheets, and where the mesh tells too little."""
    table = Table("part", "given by", "given", "estimated", "flat", "refused", title="Normals at triangles' corners")
    for part, source in zip(assembly.parts, assembly.scene.parts):
        counts = np.bincount(part.surface.curvature.rule.ravel(), minlength=len(Rule))
        table.add_row(
            part.name,
            ("the geometry" if source.geometry is not None else "the deck") if counts[Rule.GIVEN] else "nobody",
            *(str(counts[rule]) for rule in Rule),
        )
    console.print(table)
    for part in assembly.parts:
        for places, words in (
            (part.surface.curvature.coarse, f"turn by more than {COARSE:g}°, too far to follow a bend: mesh it finer"),
            (
                part.surface.curvature.single,
                "lie between a bend and a single wide row of triangles, of which it cannot be told whether it is flat: "
                "give it two rows, or normals",
            ),
        ):
            if len(places):
                where = ", ".join(f"{x:.1f}" for x in places[0])
                console.print(f"[yellow]{plain(part.name)}: {len(places)} edges {words}; one is at ({where})[/]")


def _coefficients(part):
    """Whether the part's influence coefficients are at hand; refuses an element that nobody could compute them by."""
    if is_cached(part, cache_folder()):
        return "cached"
    if part.superelement is None:
        check_element(part.element)
    return "to be computed" if part.superelement is None else "of a superelement"


def _friction_words(zone) -> str:
    """What a zone says of its friction, in words."""
    if isinstance(zone.friction, dict):
        words = ", ".join(f"{stage} {value:g}" for stage, value in zone.friction.items())
    else:
        words = f"{zone.friction:g}"
    if zone.friction_table is not None:
        words += f"; by pressure, {len(zone.friction_table)} points"
    if zone.friction_power is not None:
        words += f"; by pressure, {zone.friction_power.mu0:g} (p/{zone.friction_power.p0:g})^{-zone.friction_power.n:g}"
    if zone.tangential_stiffness is not None:
        words += f"; yields, {zone.tangential_stiffness:g} N/mm³"
    return words


def _overlap_words(zone, depth, area) -> str:
    """How far the surfaces of a zone's pairs are drawn into each other, over which area, and what is done about it."""
    if not depth.any():
        return "none"
    done = "kept" if zone.nominal_overlap == "keep" else "closed"
    return f"{depth.max():.3f} mm deep, over {area.sum():.0f} mm²: {done}"


def _print_contacts(console, assembly):
    scene, contacts = assembly.scene, assembly.contacts
    if not len(contacts):
        console.print("No contact zones: nothing to resolve.")
        return
    table = Table(
        "zone", "between", "pairs", "friction", "area, mm²", "nominal gap, mm", "drawn overlap", title="Contact zones"
    )
    for i, zone in enumerate(scene.zones):
        own = contacts.zone == i
        table.add_row(
            zone.name,
            " – ".join(zone.parts),
            str(own.sum()),
            _friction_words(zone),
            f"{contacts.area[own].sum():.0f}",
            " … ".join(f"{round(gap, 3) + 0.0:.3f}" for gap in (contacts.gap[own].min(), contacts.gap[own].max())),
            _overlap_words(zone, contacts.overlap[own], contacts.overlapping[own]),
        )
    console.print(table)
    for sentence in frozen_gaps(assembly):
        console.print(f"[yellow]note:[/] {plain(sentence)}", highlight=False, soft_wrap=True)
    if contacts.dimension == 1:
        console.print(
            f"Nothing asks for friction or slip: only normals are modelled, {len(contacts)} rows instead of "
            f"{3 * len(contacts)}."
        )


def _print_cost(console, assembly, plans):
    scene, contacts = assembly.scene, assembly.contacts
    sizes = [len(part.functionals) for part in assembly.parts]
    nodes = ", ".join(f"{len(part.surface.points)} nodes" for part in assembly.parts)
    samples, laws = scene.monte_carlo.samples, scene.report.laws
    console.print(f"• one factorisation per part not cached: {nodes}")
    console.print(
        f"• reduced model: {sum(sizes)} functionals, {8 * sum(size**2 for size in sizes) / 1e6:.0f} MB of influence "
        "coefficients"
    )
    resolved = [plan for plan in plans if plan.resolves and len(contacts)]
    if resolved:
        solves = [sum(plan.solves(LAWS[law]) for plan in resolved) for law in laws]
        each = " + ".join(map(str, solves)) if len(set(solves)) > 1 else str(solves[0])
        followed = any(LAWS[law].followed for law in laws) and any(plan.path == "followed" for plan in resolved)
        console.print(
            f"• {samples} samples × {len(laws)} laws ({', '.join(laws)}) × {each} contact resolutions "
            f"= {samples * sum(solves)} contact solves of {contacts.dimension * len(contacts)} unknowns"
            + ", and more where a path is followed"
            * followed
        )
    else:
        console.print(f"• {samples} samples × {len(laws)} laws, no contact to resolve")
    console.print(f"• {forecast(assembly, laws, samples, len(os.sched_getaffinity(0)))}")
    fields = "mean and 6σ fields: a few further solves per part and law"
    console.print("• " + (fields if scene.report.fields else "no fields asked for: no field solves"))


def _print_accuracy(console, assembly, say):
    from mic.report.style import number, percent  # drawing libraries are slow to import

    found = estimate_accuracy(assembly, cache_folder(), say)
    table = Table(
        "part", "influence coefficients", "set down on six", "on all locators", title="Estimated errors of the meshes"
    )
    for part in found:
        for one in part.estimates:
            name = "H, across the sheet" if one is part.estimates[0] else one.quantity
            table.add_row(part.part, name, percent(one.set_down, 1), percent(one.located, 1))
    console.print(table)
    for part in found:
        for words, mesh in (("half the size", part.finer), (f"{percent(ENOUGH, 0)} at most", part.reach(ENOUGH))):
            memory = f" and {mesh.memory:.0f} MB" if mesh.memory else ""
            if mesh is part.finer or part.worst > ENOUGH:
                console.print(
                    f"• {plain(part.part)}, {words}: {mesh.nodes} nodes, {number(mesh.seconds, 2)} s{memory} beside "
                    f"{part.mesh.nodes} nodes, {number(part.mesh.seconds, 2)} s",
                    highlight=False,
                    soft_wrap=True,
                )
    console.print("Time and memory as measured here, at the functionals that were compared, and as they grew.")


def _print_convergence(console, assembly, found):
    """Key characteristics with denser pairs beside those with the pairs as they are."""
    table = Table(
        "mm", "nominal", "denser", "mean", "denser", "6σ", "denser", "of 6σ", title="Key characteristics and the pairs"
    )
    for k, item in enumerate(assembly.scene.measurements):
        cells = [f"{value:.4f}" for one in (found.nominal, found.mean, found.six_sigma) for value in one[:, k]]
        before, after = found.six_sigma[:, k]
        table.add_row(item.name, *cells, f"{100 * (after / before - 1):+.1f} %" if before > 0 else "")
    console.print(table)
    console.print(
        f"{found.pairs[0]} and {found.pairs[1]} pairs; between them sheets pass through each other by up to "
        f"{found.unseen[0]:.2g} and {found.unseen[1]:.2g} mm; {found.failed} of {density.SAMPLES} samples failed",
        highlight=False,
        soft_wrap=True,
    )


@_on_first
def order(source, samples, seed, law, permutations, variants, table):
    """``mic order``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    model, folder = _studied(console, source)
    scene, asked = model.scene, _law_of(model, law)
    random = PERMUTATIONS if permutations is None else permutations
    others = read_variants(scene, variants) if variants else orders(scene, random)
    if len(others) == 1:
        console.print("The process has one order only: nothing to compare.")
        return
    threads = len(os.sched_getaffinity(0))
    with Progress(console=console) as progress:
        bar = progress.add_task(f"{samples} samples under {asked}", total=len(others))
        found = compare(
            model,
            others,
            asked,
            samples,
            scene.monte_carlo.seed if seed is None else seed,
            threads,
            lambda name: progress.advance(bar),
        )
    _print_orders(console, others, found)
    if table:
        found.to_csv(table, index=False)
        console.print(f"table: {plain(table)}")
    _keep_studies(console, folder, {ORDERS: found.assign(law=asked)[ORDERS.names].astype({"samples": "int64"})})


def _model(console, source):
    """The reduced model of a scene, or one that was saved."""
    if source.is_file() and source.suffix == ".npz":
        return ReducedModel.load(source)
    scene = load_scene(source)
    say = lambda line: console.print(f"{plain(line)} …", highlight=False)
    assembly = assemble(scene, cache_folder(), progress=say, check=plan_assembly)
    plan_assembly(assembly)
    coefficients, _ = influence_coefficients(assembly, cache_folder(), say)
    return ReducedModel.build(assembly, coefficients)


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


@_on_first
def contributors(source, samples, seed, law):
    """``mic contributors``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    model, folder = _studied(console, source)
    scene, asked = model.scene, _law_of(model, law)
    if not scene.measurements or not scene.deviations:
        what = "deviations: nothing varies" if scene.measurements else "measurements: nothing is asked for"
        raise SceneError(f"scene {scene.name!r} has no {what}; give it some")
    if scene.monte_carlo.values is not None:
        raise SceneError(
            f"scene {scene.name!r}: it states its samples in a table, which does not say what each deviation does "
            "alone; take monte_carlo.table out, so that they are drawn"
        )
    count = samples * (len(driving.groups(scene)) + 2) + 2 * len(scene.deviations)
    with _counting(console, f"evaluations under {asked}", count) as advance:
        found = driving.contributors(model, asked, samples, _seed_of(scene, seed), _threads(), advance)
    _print_contributors(console, scene, found)
    _keep_studies(console, folder, {CONTRIBUTORS: found.table, LINEARITY: found.linearity})


def _print_contributors(console, scene, found):
    """By characteristic, what makes its variance; what hurts most overall; where a linear analysis misleads."""
    from mic.report.drivers import linear_words, named  # drawing libraries are slow to import
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


@_on_first
def friction(source, samples, seed, law):
    """``mic friction``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    model, folder = _studied(console, source)
    scene, asked = model.scene, _law_of(model, law)
    if not (
        scene.measurements and LAWS[asked].frictional and model.contacts.dimension == 3 and model.contacts.frictional
    ):
        why = "nothing is measured" if not scene.measurements else "nothing has friction, or the law has none"
        raise SceneError(f"scene {scene.name!r}: there is no friction to ask for: {why}")
    zones = sum(zone.frictional for zone in scene.zones)
    count = samples * (1 + len(rubbing.FACTORS) + (zones > 1) * 2 * zones)
    with _counting(console, f"evaluations under {asked}", count) as advance:
        found = rubbing.friction_effects(model, asked, samples, _seed_of(scene, seed), _threads(), advance)
    _print_friction(console, found)
    _keep_studies(console, folder, {FRICTION_EFFECTS: found})


def _print_friction(console, found):
    from mic.report.drivers import friction_words  # drawing libraries are slow to import
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


@_on_first
def sensitivity(source, samples, seed, law):
    """``mic sensitivity``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    model, folder = _studied(console, source)
    scene, asked = model.scene, _law_of(model, law)
    if not scene.measurements:
        raise SceneError(f"scene {scene.name!r} has no measurements: nothing is asked for; give it some")
    with _counting(console, f"assemblies with derivatives under {asked}", 1 + samples) as advance:
        found = slopes.effects(model, asked, samples, _seed_of(scene, seed), advance)
    _print_sensitivity(console, found)
    _keep_studies(console, folder, {SENSITIVITIES: found.table})


def _print_sensitivity(console, found):
    """What steps of the inputs change, one line each, the largest first."""
    from mic.report.style import number  # drawing libraries are slow to import

    names = found.table["measurement"].unique()
    table = Table(
        "input", "step", *map(plain, names), "contact changes after",
        title="What a step changes, µm (over the samples)",
    )  # fmt: skip
    most = found.table.groupby("input")["effect"].apply(lambda x: x.abs().max()).sort_values(ascending=False)
    for name in most.index[most > NOTHING]:
        own = found.table[found.table["input"] == name].to_dict("records")
        cells = [
            f"{number(1e3 * row['effect'], 2)} ({number(1e3 * row['effect_low'], 2)} … "
            f"{number(1e3 * row['effect_high'], 2)})"
            for row in own
        ]
        reach = own[0]["reach"]
        table.add_row(plain(name), number(own[0]["step"]), *cells, f"{number(reach, 2)} steps" if reach < FAR else "–")
    console.print(table)
    if math.isfinite(found.reach):
        console.print(
            f"The mean assembly is {number(found.reach, 2)} σ from the next change of a contact: {plain(found.where)}",
            highlight=False,
            soft_wrap=True,
        )
    if still := most.index[most <= NOTHING].tolist():
        console.print(f"Nothing is changed by {plain(', '.join(still))}", highlight=False, soft_wrap=True)
    if found.failed:
        console.print(f"{found.failed} samples failed and are left out")


@_on_first
def rare(source, measurement, samples, seed, law):
    """``mic rare``, with the values of its options (:mod:`mic.options`)."""
    from mic.report.style import number  # drawing libraries are slow to import

    console = Console()
    model, folder = _studied(console, source)
    scene, asked, names = model.scene, _law_of(model, law), measurement or []
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
    with _counting(console, f"evaluations under {asked}", None) as advance:
        found = rare_events(model, asked, names, samples - samples % 10, _seed_of(scene, seed), _threads(), advance)
    for row in found.to_dict("records"):
        what = f"{row['measurement']} misses its limits" if row["measurement"] else "The assembly misses a limit"
        share, low, high = (number(1e6 * row[name], 2) for name in ("outside", "outside_low", "outside_high"))
        how = "a plain Monte Carlo" if row["levels"] == 1 else f"{row['levels']} levels"
        console.print(
            f"{plain(what)} in {share} of a million ({low} to {high}): {how}, {row['evaluations']} evaluations"
            + f", {row['failed']} of which failed and do not count" * bool(row["failed"]),
            highlight=False,
            soft_wrap=True,
        )
    _keep_studies(console, folder, {RARE: found})


def _holds(folder, assembly) -> bool:
    """Whether a folder holds the results of an assembly."""
    if not (folder / "run.json").is_file():
        return False
    record = RunFolder(folder).record()
    return identity(assembly, record["seed"]) == record["identity"]


def _density_table(scene, found) -> pd.DataFrame:
    """As :data:`mic.results.schema.DENSITY` declares it."""
    change = lambda values: values[1] - values[0]
    columns = {"law": scene.report.laws[0], "measurement": [item.name for item in scene.measurements]}
    columns |= {"pairs": int(found.pairs[0]), "denser": int(found.pairs[1])}
    columns |= {f"{name}_change": change(getattr(found, name)) for name in ("nominal", "mean", "six_sigma")}
    return pd.DataFrame(columns | {"failed": found.failed})


def _studied(console, source):
    """The reduced model to study, and the results folder that it comes from; None where it comes from none."""
    if not (source / "run.json").is_file():
        return _model(console, source), None
    record, path = RunFolder(source).record(), source / "model.npz"
    if not path.is_file():
        raise RunError(f"{path}: is missing; run the scene again into this folder")
    model = ReducedModel.load(path)
    if identity(model, record["seed"]) != record["identity"]:
        raise RunError(f"{path}: belongs to another run; run the scene again into this folder")
    return model, source


def _law_of(model, law):
    """The law asked for; else the scene's first with friction, else its first."""
    laws = model.scene.report.laws
    return law.value if law else next((name for name in laws if LAWS[name].frictional), laws[0])


def _seed_of(scene, seed):
    return scene.monte_carlo.seed if seed is None else seed


def _threads():
    return len(os.sched_getaffinity(0))


@contextmanager
def _counting(console, what, count):
    """A bar; what it gives is called with the number of evaluations done."""
    with Progress(console=console) as progress:
        bar = progress.add_task(what, total=count)
        yield lambda done: progress.advance(bar, done)


def _keep_studies(console, folder, tables):
    """Tables into the results folder that they belong to, and its page drawn anew."""
    if folder is None:
        return
    from mic.report.page import write_report  # drawing libraries are slow to import

    with hold(folder, _Listener(console)):
        for table, frame in tables.items():
            table.write(folder, frame)
        page = write_report(folder)
    where = ", ".join(str(folder / table.place) for table in tables)
    console.print(f"report: [bold]{plain(page)}[/]   tables: {plain(where)}", soft_wrap=True)


@_on_first
def init(meshes, example, out, thickness, welds, points):
    """``mic init``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    if (example is None) == (not meshes):
        raise SceneError("mic init: name mesh files, or one example with --example NAME")
    if example is not None:
        if thickness or welds or points:
            raise SceneError("mic init: --thickness, --welds and --points go with mesh files, not with --example")
        folder = examples.copy(example, out)
        names = ", ".join(sorted(path.name for path in folder.iterdir()))
        print(f"{folder}: {names}\nNext:  mic check {shlex.quote(str(folder))}")
        return
    folder, proposal = write_scene(meshes or [], out, _thicknesses(thickness or []), welds, points)
    for sentence in proposal.sentences:
        console.print(f"[yellow]note:[/] {plain(sentence)}", highlight=False, soft_wrap=True)
    quoted = plain(shlex.quote(str(folder)))
    console.print(
        f"{plain(folder / 'scene.toml')}: {plain(proposal.words())}\nNext:  mic check {quoted}  and  mic run {quoted}",
        highlight=False,
        soft_wrap=True,
    )


def _thicknesses(given: list[str]) -> dict[str | None, float]:
    """Thickness, mm, by part; under None, of the others."""
    found: dict[str | None, float] = {}
    for text in given:
        part, equals, value = text.rpartition("=")
        try:
            thickness = float(value)
        except ValueError:
            thickness = np.nan
        if not 0 < thickness < np.inf or (equals and not part):
            raise SceneError(f"--thickness {text}: give mm, as --thickness 1.5, or --thickness PART=1.5")
        found[part or None] = thickness
    return found


def _status(stop):
    """Exit status of a program that was interrupted."""
    return stop.status if isinstance(stop, Stopped) else 130
