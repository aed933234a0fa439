"""``mic check``: validates a scene and prints what will be modelled, the process and the cost."""

from __future__ import annotations

import shlex
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from mic.commands.invocation import first_rank_only, store_study, with_options
from mic.commands.output import CommandConsole
from mic.compliance.cache import influence_coefficients, is_cached
from mic.compliance.provider import check_element
from mic.compliance.thickness import chebyshev
from mic.contact.laws import LAWS
from mic.errors import MissingProvider, SceneError, StorageError
from mic.geometry.mesh_summary import mesh_summary
from mic.geometry.normals import COARSE, Rule
from mic.model.assembly import assemble
from mic.model.mesh_accuracy import estimate_accuracy
from mic.model.one_sigma import displacements
from mic.model.overlap import frozen_gaps
from mic.model.reduction import Reduction
from mic.plausibility import (
    Results,
    find_warnings,
    find_warnings_of_results,
    find_warnings_of_sources,
    find_warnings_unplaced,
    loadable_parts,
    raise_warnings,
    validity,
)
from mic.process.description import opening, sentences
from mic.process.plan import plan_assembly
from mic.process.stiffness import derivative_sets, list_sources, select_shapes
from mic.process.stiffness_choice import choose_stiffness, stiffness_sentences
from mic.report.style import number, percent
from mic.results.cost_estimate import forecast
from mic.results.run_folder import RunFolder
from mic.results.run_identity import identity
from mic.results.schema import DENSITY
from mic.scene import load_scene
from mic.scene.deviation import deviation_unit
from mic.studies import pair_convergence
from mic.studies.check_results import MAX_PAIRS, PATIENCE, CheckResults
from mic.studies.thickness import DISTANCE, interpolation_errors
from mic.system.console import plain
from mic.system.cores import available_cores
from mic.system.disk_cache import cache_folder
from mic.system.files import replacing, write_text

__all__ = ["check"]

TARGET_ERROR = 0.01  # relative error of a mesh for which `mic check --accuracy` prints the required element size
MAX_SOURCES = 40  # sources that are listed


@first_rank_only
def check(scene, law, accuracy, converge, normals, overlap, strict, page):
    """``mic check``, with the values of its options (:mod:`mic.options`)."""
    console, order = CommandConsole(), f"mic order {shlex.quote(str(scene))}"
    scene = with_options(load_scene(scene), law)
    for script in dict.fromkeys(part.geometry for part in scene.parts if part.geometry is not None):
        console.say(f"This scene contains a program: {scene.folder / script} is executed to create its meshes.")
    console.say_each(scene.tables_read)
    console.say_step(f"{scene.name}: reading meshes and pairing")
    try:
        assembly = assemble(scene, cache_folder(), progress=console.say_step, check=plan_assembly)
        plans, optimisation = plan_assembly(assembly), _optimisation(assembly)
    except SceneError as error:
        parts = loadable_parts(scene, cache_folder())
        warnings = find_warnings_unplaced(scene, parts)
        _print_warnings(console, warnings)
        surfaces = {loaded.part.name: loaded.surface for loaded in parts}
        errors = str(error).splitlines()
        _write_page(console, page, scene, lambda: _page(scene, surfaces, warnings, errors=errors))
        raise
    warnings = find_warnings(scene, assembly, cache_folder())
    for warning in (warning for warning in warnings if warning.impossible):
        console.warn("implausible", warning, style="bold red")
    console.print(f"[bold]{plain(scene.name)}[/] {plain(scene.description)}")
    _print_parts(console, scene, assembly)
    _print_normals(console, assembly)
    console.say_each(assembly.placed)
    _print_contacts(console, assembly)
    _print_process(console, assembly, plans)
    if optimisation:
        console.print("[bold]Optimisation[/] (mic optimise)")
        console.say_each(f"• {sentence}" for sentence in optimisation)
    results = CheckResults(assembly, cache_folder())
    warnings += _few_samples(console, assembly, results, order)
    shapes, far = _print_sources(console, assembly, results)
    warnings += far
    _print_thicknesses(console, assembly, results)
    console.say_each(f"• {sentence}" for sentence in _cost(assembly, plans, results))
    if accuracy:
        _print_accuracy(console, assembly)
    if converge:
        _check_convergence(console, scene, assembly)
    surfaces = {part.name: part.surface for part in assembly.parts}
    shown = assembly.scene, surfaces, warnings, assembly.contacts, plans, (), shapes
    inputs = [[str(warning), warning.point] for warning in warnings], [shape.name for shape in shapes]
    _write_page(console, page, scene, lambda: results.page(inputs, lambda: _page(*shown)))
    _write_pictures(console, assembly, normals, overlap)
    if strict:
        raise_warnings(warnings)
    _print_warnings(console, warnings)
    console.print(f"[{'yellow' if warnings else 'green'}]{validity(warnings)}[/]")


def _optimisation(assembly) -> list[str]:
    """Describe the changes that `mic optimise` may make; refuses places off the parts."""
    if assembly.scene.optimise is None:
        return []
    from mic.studies.optimisation.description import describe  # few scenes have a table `optimise`
    from mic.studies.optimisation.design import Space
    from mic.studies.optimisation.moved_items import check_places

    check_places(Space(assembly), assembly)
    return describe(assembly)


def _print_warnings(console, warnings):
    for warning in warnings:
        console.warn("warning", warning)


def _page(*shown, **more):
    """The text of the page, see :func:`mic.report.check_page.check_page`."""
    from mic.report.check_page import check_page  # drawing libraries are slow to import

    return check_page(*shown, **more)


def _write_page(console, page, scene, text):
    """Write the page of the check, whose text a function returns; print a warning if that fails."""
    page = page or Path("results") / (scene.name if scene.name.strip(".") else "scene") / "check.html"
    try:
        page.parent.mkdir(parents=True, exist_ok=True)
        write_text(page, text())
    except (StorageError, OSError) as problem:
        console.warn("no page", f"{problem}; name another file with --page")
    else:
        console.say_files(page=page)


def _write_pictures(console, assembly, normals, overlap):
    """Write the pictures of --normals and --overlap."""
    if normals is None and overlap is None:
        return
    from mic.report.space_pictures import draw_normals, draw_overlap  # drawing libraries are slow to import

    for name, file, draw, shown in (
        ("normals", normals, draw_normals, (assembly.surfaces,)),
        ("overlap", overlap, draw_overlap, (assembly.surfaces, assembly.contacts)),
    ):
        if file is not None:
            with replacing(file) as temporary:
                temporary.write_bytes(draw(*shown).data)
            console.say_files(**{name: file})


def _print_process(console, assembly, plans):
    """The steps of each stage."""
    console.print("[bold]Process[/]")
    for plan in plans:
        name = plan.name if plan.name == plan.kind else f"{plan.name} ({plan.kind})"
        console.say(f"{name}: {opening(plan, len(assembly.contacts) > 0)}")
        for number_, sentence in enumerate(sentences(assembly.scene, plan), 1):
            console.say(f"  {number_}. {sentence}")


def _print_sources(console, assembly, results):
    """Print what 1 σ of each source does to the free parts, the largest first; return the shapes and warnings."""
    items, shapes = assembly.scene.deviations, []
    if not items:
        return shapes, ()
    try:
        shapes = results.shapes()
    except MissingProvider as problem:
        console.warn("no shapes", problem)
    found = displacements(assembly, shapes)
    rows = [
        (
            one.name + f" ({len(one.items)} modes)" * (len(one.items) > 1),
            one.items[0].kind,
            deviation_unit(one.items[0], assembly.scene),
            f"{one.items[0].mean:g}",
            f"{one.items[0].sigma:g}",
            _one_sigma(one),
        )
        for one in found[:MAX_SOURCES]
    ]
    console.table("Sources", ("source", "kind", "unit", "mean", "σ", "largest displacement under 1 σ"), rows)
    if len(found) > MAX_SOURCES:
        console.print(f"… and {len(found) - MAX_SOURCES} more")
    if not results.solvable and any(one.rule in ("estimate", "stiffness") for one in found):
        console.say(
            "“About”: by a rough stiffness, within a factor of 3 for forces; the displacements by that of the finite "
            "elements are available once the influence coefficients are computed (`mic run`)."
        )
    return shapes, find_warnings_of_sources(found)


def _one_sigma(one) -> str:
    """Describe the effect of one standard deviation of a source."""
    if one.rule in ("stiffness", "none"):
        return "needs the influence coefficients" if one.rule == "stiffness" else "moves no free part"
    if one.point is None:
        return f"{one.length:.3g} mm at the item; the part bends"
    about = "about " if one.rule == "estimate" else ""
    return f"{about}{one.length:.3g} mm, {one.part} at ({', '.join(f'{x:.0f}' for x in one.point)})"


def _print_thicknesses(console, assembly, results):
    """Print the error of interpolating between thicknesses."""
    varied = [item.name for item in assembly.scene.deviations if item.kind == "thickness"]
    if not varied:
        return
    if not results.solvable:
        console.say(
            f"Interpolation error of {', '.join(varied)}: available once the influence coefficients are computed."
        )
        return
    try:
        found = interpolation_errors(assembly, results.model, cache_folder(), console.say_step)
    except MissingProvider as problem:
        console.warn("thickness not checked", problem)
        return
    for result in found:
        if np.isnan(result.error).any():
            text = "the assembly of mean parts cannot be computed there"
        else:
            k = int(np.abs(result.error).max(axis=0).argmax())
            text = (
                f"key characteristics change by up to {1e3 * np.abs(result.change).max():.3g} µm; largest "
                f"interpolation error {1e3 * np.abs(result.error).max():.2g} µm ({assembly.scene.measurements[k].name})"
            )
        low, high = result.thickness
        console.say(
            f"{result.name}: thickness of {result.part} from {low:.4g} to {high:.4g} mm (±{DISTANCE:g} σ): {text}"
        )


def _few_samples(console, assembly, results, order):
    """Print whether friction and placing matter, if a few samples are cheap, else the command `order` that tells it;
    return warnings of their results."""
    frictional = len(assembly.contacts) and any(LAWS[law].frictional for law in assembly.scene.report.laws)
    unknown, advice = "Effect of the process order: not computed", f"Run `{order}`."
    if not results.solvable:
        if frictional:
            console.say(f"{unknown}. {advice}")
        return ()
    samples = results.rough_samples()
    if not samples.solved:
        console.warn(
            "note", f"none of {samples.count} samples, solved roughly, has a solution: `mic run` may fail, too"
        )
        return ()
    if frictional and samples.seconds > PATIENCE:
        console.say(f"{unknown}, since {samples.count} samples take {samples.seconds:.0f} s. {advice}")
    for doubt in samples.doubts:
        console.warn("note", f"{doubt}; run `{order}` for numbers")
    extent = {part.name: part.surface.diameter for part in assembly.parts}
    return find_warnings_of_results(Results(assembly.scene, extent, samples.mean, samples.six_sigma, samples.forces))


def _print_parts(console, scene, assembly):
    """Print the parts, and how their mesh files were read."""
    rows = []
    for part in assembly.parts:
        sheet = [f"{value:g}" for value in (part.thickness, part.young, part.poisson)]
        size = len(part.surface.points), len(part.surface.triangles)
        rows.append((part.name, *size, *sheet, len(part.functionals), _coefficients(part)))
    heads = ("part", "nodes", "triangles", "t, mm", "E, MPa", "ν", "functionals", "influence coefficients")
    console.table("Parts", heads, rows)
    for part, stated, completed in zip(assembly.parts, scene.parts, assembly.scene.parts):
        deck = assembly.decks.get(part.name)
        if deck is not None:
            console.say_each(mesh_summary(stated, completed, deck, assembly.surfaces[part.name]))


def _print_normals(console, assembly):
    """Print how the normals of the sheets were obtained, and edges at which the mesh is too coarse for that."""
    rows = []
    for part, scene_part in zip(assembly.parts, assembly.scene.parts):
        counts = np.bincount(assembly.surfaces[part.name].curvature.rule.ravel(), minlength=len(Rule))
        origin = "the geometry" if scene_part.geometry is not None else "the deck"
        rows.append((part.name, origin if counts[Rule.GIVEN] else "none", *(counts[rule] for rule in Rule)))
    heads = ("part", "given by", "given", "estimated", "flat", "implausible, replaced")
    console.table("Normals at the corners of triangles", heads, rows)
    coarse = f"with a bend of more than {COARSE:g}°, too coarse for its curvature: refine the mesh"
    single = (
        "between a bend and a single wide row of triangles, which may be flat or curved: mesh it with two rows, or "
        "give normals"
    )
    for part in assembly.parts:
        curvature = assembly.surfaces[part.name].curvature
        for points, text in ((curvature.coarse, coarse), (curvature.single, single)):
            if len(points):
                place = ", ".join(f"{x:.1f}" for x in points[0])
                console.say(f"{part.name}: {len(points)} edges {text}; one is at ({place})", style="yellow")


def _coefficients(part):
    """Origin of the part's influence coefficients.

    Raises
    ------
    SceneError
        If no installed provider can compute its element.
    """
    count = "" if part.thickness_range is None else f", at {len(chebyshev(*part.thickness_range))} thicknesses"
    if is_cached(part, cache_folder()):
        return "cached" + count
    if part.superelement is not None:
        return "of a superelement"
    check_element(part.element)
    return "to be computed" + count


def _friction(zone) -> str:
    """Friction of a zone: coefficient (by stage), dependence on pressure, tangential stiffness."""
    if isinstance(zone.friction, dict):
        text = ", ".join(f"{stage} {value:g}" for stage, value in zone.friction.items())
    else:
        text = f"{zone.friction:g}"
    if zone.friction_table is not None:
        text += f"; by pressure, {len(zone.friction_table)} points"
    if zone.friction_power is not None:
        text += f"; by pressure, {zone.friction_power.mu0:g} (p/{zone.friction_power.p0:g})^{-zone.friction_power.n:g}"
    if zone.tangential_stiffness is not None:
        text += f"; tangential stiffness {zone.tangential_stiffness:g} N/mm³"
    return text


def _overlap(zone, depth, area) -> str:
    """Depth and area of the nominal overlap in a zone, and whether it is kept or set to zero."""
    if not depth.any():
        return "none"
    treatment = "kept" if zone.nominal_overlap == "keep" else "set to zero"
    return f"{depth.max():.3f} mm deep, over {area.sum():.0f} mm²: {treatment}"


def _print_contacts(console, assembly):
    scene, contacts = assembly.scene, assembly.contacts
    if not len(contacts):
        console.print("No contact zones: nothing to resolve.")
        return
    rows = []
    for i, zone in enumerate(scene.zones):
        own = contacts.zone == i
        gaps = " … ".join(f"{round(gap, 3) + 0.0:.3f}" for gap in (contacts.gap[own].min(), contacts.gap[own].max()))
        overlap = _overlap(zone, contacts.overlap[own], contacts.overlapping[own])
        area = f"{contacts.area[own].sum():.0f}"
        rows.append((zone.name, " – ".join(zone.parts), own.sum(), _friction(zone), area, gaps, overlap))
    heads = ("zone", "between", "pairs", "friction", "area, mm²", "nominal gap, mm", "nominal overlap")
    console.table("Contact zones", heads, rows)
    for sentence in frozen_gaps(assembly):
        console.warn("note", sentence)
    if contacts.dimension == 1:
        console.print(
            f"Neither friction nor slip is requested: only normals are modelled, {len(contacts)} rows instead of "
            f"{3 * len(contacts)}."
        )


def _cost(assembly, plans, results) -> list[str]:
    """Factorisations, size of the reduced model, contact solutions, expected time and disk space."""
    scene, contacts = assembly.scene, assembly.contacts
    sizes = [len(part.functionals) for part in assembly.parts]
    nodes = ", ".join(f"{len(part.surface.points)} nodes" for part in assembly.parts)
    samples, laws = scene.monte_carlo.samples, scene.report.laws
    most = "at most " * (scene.monte_carlo.accuracy is not None)
    megabytes = 8 * sum(size**2 for size in sizes) / 1e6
    lines = [
        f"one factorisation per part, unless it is cached: {nodes}",
        f"reduced model: {sum(sizes)} functionals, {megabytes:.0f} MB of influence coefficients",
    ]
    lines += _stiffness(assembly, results)
    resolved = [plan for plan in plans if plan.resolves and len(contacts)]
    followed = any(LAWS[law].followed for law in laws) and any(plan.path == "followed" for plan in resolved)
    if resolved:
        solves = [sum(plan.solves(LAWS[law]) for plan in resolved) for law in laws]
        each = f"({' + '.join(map(str, solves))})" if len(solves) > 1 else str(solves[0])
        lines.append(
            f"{most}{samples} samples × {each} contact solves ({', '.join(laws)}) = {samples * sum(solves)} solves of "
            f"{contacts.dimension * len(contacts)} unknowns" + ", and more along followed load paths" * followed
        )
    else:
        lines.append(f"{most}{samples} samples × {len(laws)} laws, no contact to resolve")
    if any(item.kind in ("friction", "thickness") and item.sigma for item in scene.deviations):
        lines.append("friction or thickness varies: each sample needs its own model, which takes many times as long")
    expected = str(forecast(assembly, laws, samples, available_cores()))
    lines.append(expected + "; followed load paths take many times as long" * followed)
    fields = "mean and 6σ fields: a few more solves for each part and law"
    return [*lines, fields if scene.report.fields else "no fields are requested: no field solves"]


def _stiffness(assembly, results) -> list[str]:
    """Cost of the stiffness of deviated shapes: exact if the nominal coefficients are cached, else an upper bound."""
    stiffness, nominal, lines = assembly.scene.stiffness, None, []
    if stiffness == "mean":
        return ["stiffness of the mean shape: a second set of influence coefficients for each part"]
    if len(assembly.contacts) <= MAX_PAIRS and results.all_cached:
        with suppress(MissingProvider):
            nominal = Reduction.build(assembly, influence_coefficients(assembly, cache_folder())[0])
    if stiffness == "nominal":
        return stiffness_sentences(assembly, nominal) if nominal is not None else []
    if stiffness == "auto":
        if nominal is None:
            return ["stiffness: chosen by the run, by the deviation of the parts over their thickness"]
        choice = choose_stiffness(assembly, nominal)
        lines, stiffness = [str(choice)], choice.stiffness
        assembly = replace(assembly, scene=assembly.scene.model_copy(update={"stiffness": stiffness}))
        if stiffness != "first-order":
            return lines
    text = "stiffness to first order in {}: {}; each sample needs its own model, which takes many times as long"
    with suppress(MissingProvider):
        if nominal is not None:
            shapes = select_shapes(assembly, nominal)
            sets = {part.fingerprint(): part for part in shapes.additional_parts(assembly)}
            missing = sum(not is_cached(part, cache_folder()) for part in sets.values())
            found = f"{len(sets)} further sets of influence coefficients, {missing} to be computed"
            return [*lines, text.format(shapes, found)]
    names, count = derivative_sets(assembly)
    found = text.format(f"up to {list_sources(names)}", f"at most {count} further sets of influence coefficients")
    return [*lines, found]


def _print_accuracy(console, assembly):
    """Print the estimated errors of the meshes, and the cost of finer ones."""
    found = estimate_accuracy(assembly, cache_folder(), console.say_step)
    rows = [
        (
            part.part,
            "H, across the sheet" if i == 0 else estimate.quantity,
            percent(estimate.set_down, 1),
            percent(estimate.located, 1),
        )
        for part in found
        for i, estimate in enumerate(part.estimates)
    ]
    heads = ("part", "influence coefficients", "error on six locators", "error on all locators")
    console.table("Estimated errors of the meshes", heads, rows)
    for part in found:
        meshes = [("half the element size", part.finer)]
        if part.worst > TARGET_ERROR:
            meshes.append((f"for an error of {percent(TARGET_ERROR, 0)}", part.mesh_for(TARGET_ERROR)))
        for text, mesh in meshes:
            memory = f" and {mesh.memory:.0f} MB" if mesh.memory else ""
            console.say(
                f"• {part.part}, {text}: {mesh.nodes} nodes, {number(mesh.seconds, 2)} s{memory}; now "
                f"{part.mesh.nodes} nodes, {number(part.mesh.seconds, 2)} s"
            )
    console.print("Time and memory: measured on this machine for the compared functionals, and extrapolated from them.")


def _check_convergence(console, scene, assembly):
    """Print key characteristics with denser contact pairs; store them in the results folder of this scene."""
    found = pair_convergence.converge(assembly, cache_folder(), scene.report.laws[0], console.say_step)
    _print_convergence(console, assembly, found)
    folder = Path("results") / scene.name
    if _belongs(folder, assembly):
        store_study(console, folder, {DENSITY: _density_table(scene, found)})


def _print_convergence(console, assembly, found):
    """Key characteristics with denser pairs beside those with the pairs of the scene."""
    figures = [head for name in ("nominal", "mean", "6σ") for head in (name, "change")]
    heads = ["mm", *figures]
    rows = []
    for k, item in enumerate(assembly.scene.measurements):
        (nominal, mean, spread), (denser_nominal, denser_mean, denser_spread) = [
            [values[row, k] for values in (found.nominal, found.mean, found.six_sigma)] for row in (0, 1)
        ]
        mean_change = f"{1e3 * (denser_mean - mean):+.1f} ± {1e3 * found.mean_half[k]:.1f} µm"
        spread_change = ""
        if spread:
            half = 100 * found.six_sigma_half[k] / spread
            spread_change = f"{100 * (denser_spread / spread - 1):+.2f} ± {half:.2f} %"
        nominal_change = f"{1e3 * (denser_nominal - nominal):+.1f} µm"
        cells = (f"{nominal:.4f}", nominal_change, f"{mean:.4f}", mean_change, f"{spread:.4f}", spread_change)
        rows.append((item.name, *cells))
    console.table("Key characteristics and the density of contact pairs", heads, rows)
    samples = pair_convergence.SAMPLES
    console.say(
        f"{found.pairs[0]} and {found.pairs[1]} pairs; largest penetration between the pairs {found.unseen[0]:.2g} and "
        f"{found.unseen[1]:.2g} mm; {found.failed} of {samples} samples failed"
    )
    console.say(
        f"Each change compares the same {samples} samples with pairs at {pair_convergence.DENSER:g} of their distance, "
        "± the 95 % confidence interval of so few samples. It is an estimate, not a bound: still denser pairs or other "
        "samples may change a characteristic that did not change here."
    )


def _belongs(folder, assembly) -> bool:
    """Whether a results folder is that of an assembly."""
    if not (folder / "run.json").is_file():
        return False
    record = RunFolder(folder).record()
    return identity(assembly, record["seed"]) == record["identity"]


def _density_table(scene, found) -> pd.DataFrame:
    """Changes with denser pairs, as :data:`mic.results.schema.DENSITY` declares them."""
    columns = {"law": scene.report.laws[0], "measurement": [item.name for item in scene.measurements]}
    columns |= {"pairs": int(found.pairs[0]), "denser": int(found.pairs[1])}
    for name in ("nominal", "mean", "six_sigma"):
        values = getattr(found, name)
        columns[f"{name}_change"] = values[1] - values[0]
    return pd.DataFrame(columns | {"failed": found.failed})
