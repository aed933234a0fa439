"""``mic check``."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Column, Table

from mic.commands.invocation import keep_studies, on_one_process, requested
from mic.compliance.cache import influence_coefficients, is_cached
from mic.compliance.provider import check_element
from mic.compliance.thickness import chebyshev
from mic.contact.laws import LAWS
from mic.errors import MissingProvider, SceneError, StorageError
from mic.geometry.mesh_summary import mesh_summary
from mic.geometry.normals import COARSE, Rule
from mic.model.assembly import assemble
from mic.model.mesh_accuracy import estimate_accuracy
from mic.model.one_sigma import one_sigma
from mic.model.overlap import frozen_gaps
from mic.model.reduction import Reduction
from mic.plausibility import find_warnings, find_warnings_unplaced, loadable_parts, raise_warnings, validity
from mic.process.description import opening, sentences
from mic.process.model import ReducedModel
from mic.process.plan import plan_assembly
from mic.process.stiffness import derivative_sets, list_sources, select_shapes
from mic.results.cost_estimate import forecast
from mic.results.run_folder import RunFolder
from mic.results.run_identity import identity
from mic.results.schema import DENSITY
from mic.scene import load_scene
from mic.studies import pair_convergence
from mic.studies.optimisation.description import asked as asked_of_optimise
from mic.studies.optimisation.design import Space
from mic.studies.optimisation.moved_items import on_their_parts
from mic.studies.order import doubts
from mic.studies.thickness import AWAY, interpolated
from mic.system.console import plain
from mic.system.disk_cache import cache_folder
from mic.system.files import replacing

__all__ = [
    "check",
]

ENOUGH = 0.01  # error of a mesh for which `mic check --accuracy` says what it would take


LOOKED_AT = 1000  # contact pairs; a check looks no closer at the process of a larger assembly: it would take minutes


LISTED = 40  # sources that a check tells one by one


@on_one_process
def check(scene, law, accuracy, converge, normals, overlap, strict, page):
    """``mic check``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    asked = requested(load_scene(scene), law)
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
        optimisation = _optimisation(assembly)
    except SceneError as error:
        parts = loadable_parts(asked, cache_folder())
        warnings, surfaces = find_warnings_unplaced(asked, parts), {one.part.name: one.surface for one in parts}
        _print_warnings(console, warnings)
        _draw_check(console, page, asked, surfaces, warnings, errors=str(error).splitlines())
        raise
    warnings = find_warnings(asked, assembly, cache_folder())
    console.print(f"[bold]{plain(asked.name)}[/] {plain(asked.description)}")
    _print_parts(console, assembly)
    _print_told(console, asked, assembly)
    _print_normals(console, assembly)
    for sentence in assembly.placed:
        console.print(plain(sentence), highlight=False, soft_wrap=True)
    _print_contacts(console, assembly)
    _print_process(console, assembly, plans)
    _print_optimisation(console, optimisation)
    model = _at_hand(assembly)
    _print_doubts(console, assembly, model)
    shapes = _print_sources(console, assembly, model)
    _print_thicknesses(console, assembly, model, say)
    _print_cost(console, assembly, plans)
    if accuracy:
        _print_accuracy(console, assembly, say)
    if converge:
        converged = pair_convergence.converge(assembly, cache_folder(), asked.report.laws[0], say)
        _print_convergence(console, assembly, converged)
        folder = Path("results") / asked.name
        if _holds(folder, assembly):
            keep_studies(console, folder, {DENSITY: _density_table(asked, converged)})
    surfaces = assembly.surfaces
    solved = {part.name: part.surface for part in assembly.parts}  # on which shapes are known
    _draw_check(console, page, assembly.scene, solved, warnings, assembly.contacts, plans, shapes=shapes)
    if normals is not None or overlap is not None:
        from mic.report.space_pictures import draw_normals, draw_overlap  # drawing libraries are slow to import

        if normals is not None:
            _keep_picture(console, "normals", draw_normals(surfaces), normals)
        if overlap is not None:
            _keep_picture(console, "overlap", draw_overlap(surfaces, assembly.contacts), overlap)
    if strict:
        raise_warnings(warnings)
    _print_warnings(console, warnings)
    console.print(f"[{'yellow' if warnings else 'green'}]{validity(warnings)}[/]")


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


def _optimisation(assembly) -> list[str]:
    """What the scene asks of `mic optimise`, in words; nothing where it asks nothing."""
    if assembly.scene.optimise is None:
        return []
    on_their_parts(Space(assembly), assembly)
    return asked_of_optimise(assembly)


def _print_optimisation(console, sentences):
    if sentences:
        console.print("[bold]Optimisation[/] (mic optimise)")
    for sentence in sentences:
        console.print(f"• {plain(sentence)}", highlight=False, soft_wrap=True)


def _at_hand(assembly):
    """The reduced model, where the influence coefficients are cached, all of them nominal, and it is not large; else
    None."""
    if assembly.scene.stiffness != "nominal":
        return None
    if len(assembly.contacts) <= LOOKED_AT and all(is_cached(part, cache_folder()) for part in assembly.parts):
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


def _print_thicknesses(console, assembly, model, say):
    """What the interpolation in each thickness leaves of the key characteristics."""
    varied = [item.name for item in assembly.scene.deviations if item.kind == "thickness"]
    if not varied:
        return
    if model is None:
        console.print(
            f"How well {plain(', '.join(varied))} is interpolated is told once the influence coefficients are computed."
        )
        return
    try:
        found = interpolated(assembly, model, cache_folder(), say)
    except MissingProvider as problem:
        console.print(f"[yellow]thickness not checked:[/] {plain(problem)}", highlight=False, soft_wrap=True)
        return
    for one in found:
        if np.isnan(one.error).any():
            said = "the assembly of mean parts cannot be computed there"
        else:
            k = int(np.abs(one.error).max(axis=0).argmax())
            said = (
                f"key characteristics change by up to {1e3 * np.abs(one.change).max():.3g} µm; interpolating between "
                f"thicknesses errs by {1e3 * np.abs(one.error).max():.2g} µm at most "
                f"({assembly.scene.measurements[k].name})"
            )
        low, high = one.thickness
        console.print(
            f"{plain(one.name)}: {plain(one.part)} {low:.4g} to {high:.4g} mm thick, ±{AWAY:g} σ: {plain(said)}",
            highlight=False,
            soft_wrap=True,
        )


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
        for sentence in mesh_summary(source, filled, deck, assembly.surfaces[part.name]) if deck is not None else ():
            console.print(plain(sentence), highlight=False, soft_wrap=True)


def _print_normals(console, assembly):
    """What decided the normals of the curved sheets, and where the mesh tells too little."""
    table = Table("part", "given by", "given", "estimated", "flat", "refused", title="Normals at triangles' corners")
    for part, source in zip(assembly.parts, assembly.scene.parts):
        counts = np.bincount(assembly.surfaces[part.name].curvature.rule.ravel(), minlength=len(Rule))
        table.add_row(
            part.name,
            ("the geometry" if source.geometry is not None else "the deck") if counts[Rule.GIVEN] else "nobody",
            *(str(counts[rule]) for rule in Rule),
        )
    console.print(table)
    for part in assembly.parts:
        curvature = assembly.surfaces[part.name].curvature
        for places, words in (
            (curvature.coarse, f"turn by more than {COARSE:g}°, too far to follow a bend: mesh it finer"),
            (
                curvature.single,
                "lie between a bend and a single wide row of triangles, of which it cannot be told whether it is flat: "
                "give it two rows, or normals",
            ),
        ):
            if len(places):
                where = ", ".join(f"{x:.1f}" for x in places[0])
                console.print(f"[yellow]{plain(part.name)}: {len(places)} edges {words}; one is at ({where})[/]")


def _coefficients(part):
    """Whether the part's influence coefficients are at hand; refuses an element that nobody could compute them by."""
    many = "" if part.thickness_range is None else f", at {len(chebyshev(*part.thickness_range))} thicknesses"
    if is_cached(part, cache_folder()):
        return "cached" + many
    if part.superelement is None:
        check_element(part.element)
    return "to be computed" + many if part.superelement is None else "of a superelement"


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
    if scene.stiffness != "nominal":
        console.print(f"• {plain(_stiffness_words(assembly))}", highlight=False, soft_wrap=True)
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
    if any(item.kind in ("friction", "thickness") and item.sigma for item in scene.deviations):
        console.print("• friction or thickness varies: each sample is set up by itself, which takes many times as long")
    console.print(f"• {forecast(assembly, laws, samples, len(os.sched_getaffinity(0)))}")
    fields = "mean and 6σ fields: a few further solves per part and law"
    console.print("• " + (fields if scene.report.fields else "no fields asked for: no field solves"))


def _stiffness_words(assembly) -> str:
    """What the stiffness of other shapes takes: where the nominal coefficients are at hand, that, else at most."""
    if assembly.scene.stiffness == "mean":
        return "stiffness of the mean shape: a second set of influence coefficients for each part"
    told = "stiffness to first order in {}: {}; each sample is set up by itself, which takes many times as long"
    if len(assembly.contacts) <= LOOKED_AT and all(is_cached(part, cache_folder()) for part in assembly.parts):
        try:
            nominal = Reduction.build(assembly, influence_coefficients(assembly, cache_folder())[0])
            shapes = select_shapes(assembly, nominal)
        except MissingProvider:
            pass
        else:
            further = {part.fingerprint(): part for part in shapes.additional_parts(assembly)}
            todo = sum(not is_cached(part, cache_folder()) for part in further.values())
            return told.format(shapes, f"{len(further)} further sets of influence coefficients, {todo} to be computed")
    names, sets = derivative_sets(assembly)
    return told.format(f"up to {list_sources(names)}", f"at most {sets} further sets of influence coefficients")


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
        for words, mesh in (("half the size", part.finer), (f"{percent(ENOUGH, 0)} at most", part.mesh_for(ENOUGH))):
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
    figures = ("nominal", "mean", "6σ")
    heads = [Column(head, overflow="fold", justify="right") for name in figures for head in (name, "change")]
    table = Table(Column("mm", overflow="fold"), *heads, title="Key characteristics and the pairs")
    for k, item in enumerate(assembly.scene.measurements):
        (nominal, mean, spread), (moves, more, wider) = [
            [values[row, k] for values in (found.nominal, found.mean, found.six_sigma)] for row in (0, 1)
        ]
        off = f"{1e3 * (more - mean):+.1f} ± {1e3 * found.mean_half[k]:.1f} µm"
        share = f"{100 * (wider / spread - 1):+.2f} ± {100 * found.six_sigma_half[k] / spread:.2f} %" if spread else ""
        cells = [f"{nominal:.4f}", f"{1e3 * (moves - nominal):+.1f} µm", f"{mean:.4f}", off, f"{spread:.4f}", share]
        table.add_row(item.name, *cells)
    console.print(table)
    lines = (
        f"{found.pairs[0]} and {found.pairs[1]} pairs; between them sheets pass through each other by up to "
        f"{found.unseen[0]:.2g} and {found.unseen[1]:.2g} mm; {found.failed} of {pair_convergence.SAMPLES} samples failed",
        f"A change is what pairs at {pair_convergence.DENSER:g} of their distance make of the same {pair_convergence.SAMPLES} samples, ± "
        "the 95 % interval that so few samples leave of it. It is no bound of what the pairs leave: still denser ones, "
        "and other samples, may move a characteristic that did not move here.",
    )
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True)


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
