"""Findings of the rules that need the parts' meshes, and of those that need the contact pairs, too.

Each function has the name of its rule in ``rules.toml``, and finds what is outside the range that is usual.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.pairing.standing_edges import STEEP
from mic.geometry.surface import Surface
from mic.model.overlap import mean_gaps
from mic.model.rigid_motion import amplification
from mic.plausibility.finding import Finding, Point, about, label
from mic.plausibility.scene_file import held_at, held_by_stage
from mic.scene.stages import placing_stages

EXTENT = (25.0, 5000.0)  # mm, diagonal of a part
SLENDER = 20.0  # extents of a part in thicknesses, at least
COARSE = 6.0  # elements along the extent, at least
OFF = 1.0  # mm between a point and the surface of its sheet
PAD = 0.15  # of the part's area, at most
INCLINED = 0.7  # cosine of 45°
AMPLIFIED = 12.0  # mm of motion of the part for 1 mm at one locator
GAP = 1.0  # mm under a weld
FAR = 100.0  # mm from a weld to the next contact pair
SHARED = 0.5  # of the smaller zone
BESIDE = 15.0  # mm between a clamp and the support that takes its force
SUNK = 0.1  # mm of deflection under a clamp
ROOM = 0.05  # mm of clearance of the sheets between two stops
BODY = 3.0  # mm, thickness of the thinnest pad
ENOUGH = 8  # samples from which a spread is estimated
NARROW = 0.02  # of sigma
CROSSED = 0.05  # mm of an edge on either side of a surface that it passes through
SMALL = 20.0  # mm²
CHORD = 0.1  # mm between a facet and the curved sheet

PADS = ("locators", "clamps", "welds", "deviations", "measurements")


def _on_parts(assembly) -> Iterator[tuple[str, Any, Any]]:
    """Table, item and part for every item at a point of a part, without those in holes."""
    parts = {part.name: part for part in assembly.parts}
    for table in PADS:
        for item in getattr(assembly.scene, table):
            if getattr(item, "hole", None) is not None or getattr(item, "point", None) is None:
                continue
            for name in item.parts if table == "welds" else [item.part]:
                yield table, item, parts[name]


def _zones(assembly) -> Iterator[tuple[Any, np.ndarray]]:
    """Each zone that has contact pairs, with their numbers."""
    for i, zone in enumerate(assembly.scene.zones):
        own = np.flatnonzero(assembly.contacts.zone == i)
        if len(own):
            yield zone, own


def extent(sheets) -> Iterator[Finding]:
    """Parts that are very small or very large."""
    for part, surface in sheets:
        if not EXTENT[0] <= surface.diameter <= EXTENT[1]:
            yield label("parts", part), f"measures {surface.diameter:.3g} mm across", None


def no_sheet(sheets) -> Iterator[Finding]:
    """Parts that are too thick for their size."""
    for part, surface in sheets:
        size = surface.diameter / part.thickness
        if size < SLENDER:
            yield label("parts", part), f"measures {size:.3g} thicknesses across", None


def coarse(sheets) -> Iterator[Finding]:
    """Parts of few elements."""
    for part, surface in sheets:
        count = surface.diameter / float(np.median(surface.edge_lengths))
        if count < COARSE:
            yield label("parts", part), f"has {count:.2g} elements along its diagonal", None


def off_the_sheet(assembly) -> Iterator[Finding]:
    """Points off their part; a weld may be anywhere in its two sheets, or in a third one beside them."""
    thickness = {part.name: part.thickness for part in assembly.parts}
    for table, item, part in _on_parts(assembly):
        foot = part.surface.project(item.point)
        within = sum(thickness[name] for name in item.parts) if table == "welds" else part.thickness / 2
        gap = float(foot.distance[0]) - within
        if gap > OFF:
            near = ", ".join(f"{x:.4g}" for x in foot.point[0])
            yield about(table, item, f"is {gap:.2g} mm away from part {part.name}, nearest point [{near}]")


def pad_large(assembly) -> Iterator[Finding]:
    """Discs that cover much of their part."""
    for table, item, part in _on_parts(assembly):
        share = np.pi * item.radius**2 / part.surface.areas.sum()
        if share > PAD:
            covered = 100 * min(share, 9.99)
            yield about(table, item, f"radius = {item.radius:g} mm covers {covered:.0f} % of part {part.name}")


def nugget_over_edge(assembly) -> Iterator[Finding]:
    """Nuggets that run over the edge of a sheet."""
    for table, item, part in _on_parts(assembly):
        if table == "welds" and item.radius > 0 and not _by_an_edge(assembly, item):
            apart = _to_border(part.surface, part.surface.project(item.point).point[0])
            if apart < item.radius:
                text = f"has radius {item.radius:g} mm and is {apart:.2g} mm from the edge of part {part.name}"
                yield about(table, item, text)


def _by_an_edge(assembly, weld) -> bool:
    """Whether a weld joins a sheet to another one on which it stands by its edge."""
    surfaces = [part.surface for part in assembly.parts if part.name in weld.parts]
    a, b = (surface.normals[surface.project(weld.point).triangle[0]] for surface in surfaces)
    return bool(abs(a @ b) < STEEP)


def welded_without_zone(assembly) -> Iterator[Finding]:
    """Welds between parts without a contact zone; a sheet that stands on the other by its edge cannot have one."""
    joined = {frozenset(zone.parts) for zone in assembly.scene.zones}
    for weld in assembly.scene.welds:
        if frozenset(weld.parts) not in joined and not _by_an_edge(assembly, weld):
            joined.add(frozenset(weld.parts))  # one warning for two parts
            yield about("welds", weld, f"joins parts {' and '.join(weld.parts)} without a zone")


def clamp_inclined(assembly) -> Iterator[Finding]:
    """Clamps that push along their sheet."""
    for table, item, part in _on_parts(assembly):
        if table == "clamps":
            foot = part.surface.project(item.point)
            cosine = abs(float(part.surface.normals[foot.triangle[0]] @ item.direction))
            if cosine < INCLINED:
                angle = np.degrees(np.arccos(min(1.0, cosine)))
                yield about(table, item, f"pushes at {angle:.0f}° to the normal of part {part.name}")


def _pressed(assembly, clamp) -> tuple[str, np.ndarray]:
    """The body opposite a clamp's part at the clamp, and the direction to it; ``""`` and zeros if there is none."""
    contacts, zones = assembly.contacts, assembly.scene.zones
    touches = np.isin(contacts.zone, [i for i, zone in enumerate(zones) if clamp.part in zone.parts])
    distance = np.where(touches, np.linalg.norm(contacts.point - clamp.point, axis=1), np.inf)
    near = np.argmin(distance) if len(distance) else 0
    if not touches.any() or distance[near] > clamp.radius + np.sqrt(contacts.area[near]):
        return "", np.zeros(3)
    first, second = zones[contacts.zone[near]].parts
    sign, other = (1.0, second) if first == clamp.part else (-1.0, first)
    return other, sign * contacts.frame[near, :, 0]


def clamp_pulls(assembly) -> Iterator[Finding]:
    """Clamps that pull their part away from the body opposite."""
    for clamp in assembly.scene.clamps:
        other, towards = _pressed(assembly, clamp)
        along = float(np.dot(clamp.direction, towards))
        if along * np.sign(1.0 if clamp.force is None else clamp.force) < -0.5:
            yield about("clamps", clamp, f"pulls part {clamp.part} away from {other}, which is on its other side")


def presses_one_side(assembly) -> Iterator[Finding]:
    """Clamps with a force, far from all that supports the part opposite."""
    scene = assembly.scene
    fixtures = {fixture.name for fixture in scene.fixtures}
    for clamp in scene.clamps:
        pressed, _ = _pressed(assembly, clamp)
        if not clamp.force or not pressed or pressed in fixtures:
            continue
        direction, against = np.array(clamp.direction), []
        for item in (*scene.locators, *scene.clamps):
            along, rigid = float(item.direction @ direction), getattr(item, "force", None) is None
            if item.part == pressed and (along < -INCLINED or (rigid and along > INCLINED)):
                against.append(item.point)
        for zone, own in _zones(assembly):
            if pressed in zone.parts and fixtures & set(zone.parts):
                against += assembly.contacts.point[own].tolist()
        beside = _beside(np.array(against).reshape(-1, 3), np.array(clamp.point), direction)
        if beside > clamp.radius + BESIDE:
            where = f"{beside:.0f} mm from" if np.isfinite(beside) else "without"
            text = f"presses on part {pressed} {where} any support of that part: it presses one side only"
            yield about("clamps", clamp, text)


def unbacked(assembly) -> Iterator[Finding]:
    """Clamps with a force on sheets that nothing supports beneath them.

    The deflection is that of a circular plate, simply supported at the distance d of the nearest support, with the
    force at its centre: w = F d² (3 + ν) / (16 π D (1 + ν)), D the sum of the sheets' bending stiffnesses.
    """
    sheet, fixtures = {part.name: part for part in assembly.parts}, {item.name for item in assembly.scene.fixtures}
    for clamp in assembly.scene.clamps:
        _, stack = _pressed_through(assembly, clamp)
        away = _support(assembly.scene, clamp, stack)
        if not clamp.force or len(stack) < 2 or fixtures & set(stack) or not np.isfinite(away):
            continue  # presses nothing, or over a pad, or without any support (presses-one-side warns of it)
        stiffness = sum(sheet[n].young * sheet[n].thickness ** 3 / 12 / (1 - sheet[n].poisson ** 2) for n in stack)
        ν = float(np.mean([sheet[name].poisson for name in stack]))
        sunk = abs(clamp.force) * away**2 * (3 + ν) / (16 * np.pi * stiffness * (1 + ν))
        if sunk > SUNK:
            text = f"presses with {abs(clamp.force):.3g} N on part {stack[-1]} {away:.0f} mm from the next support"
            yield about("clamps", clamp, f"{text}: the sheets deflect by about {sunk:.2g} mm")


def squeezed(assembly) -> Iterator[Finding]:
    """Clamps that hold a position over a rigid stop, with too little clearance for the sheets between them."""
    scene, reported = assembly.scene, set()
    fixtures = {item.name: item for item in scene.fixtures}
    for clamp in scene.clamps:
        if clamp.stroke is None or clamp.limit is not None:
            continue
        clearance = -held_at(scene, "clamps", clamp)
        gaps, stack = _pressed_through(assembly, clamp)
        for gap, body in zip(gaps, stack[1:]):
            clearance += gap
            stops = [("fixtures", fixtures[body], 0.0)] if body in fixtures else _stops(scene, clamp, body)
            for table, stop, moved in stops:
                remaining = clearance + moved
                if remaining < ROOM and frozenset({clamp.name, stop.name}) not in reported:
                    reported.add(frozenset({clamp.name, stop.name}))
                    text = f"holds its position over {label(table, stop)} with {remaining + 0.0:.2g} mm of clearance"
                    yield about("clamps", clamp, text)


def _stops(scene, clamp, body) -> list[tuple[str, Any, float]]:
    """The rigid locators and clamps that hold a part under a closed clamp, along its direction.

    Each with its table and its position along the clamp's direction, mm.
    """
    rows = [("locators", item) for item in scene.locators if item.stiffness is None]
    rows += [("clamps", item) for item in scene.clamps if item.stroke is not None and item.limit is None]
    found, push = [], np.array(clamp.direction)
    for table, item in rows:
        along, step = float(item.direction @ push), np.subtract(item.point, clamp.point)
        beside = np.linalg.norm(step - (step @ push) * push)
        if item.part == body and abs(along) > INCLINED and beside <= clamp.radius + item.radius:
            if any({clamp.name, item.name} <= held for _, held in held_by_stage(scene)):
                found.append((table, item, held_at(scene, table, item) * along))
    return found


def _pressed_through(assembly, clamp) -> tuple[list[float], list[str]]:
    """The bodies that a clamp presses together, in the order of its force, and the gaps between them, mm."""
    contacts, zones = assembly.contacts, assembly.scene.zones
    push = np.sign(clamp.force or 1.0) * np.array(clamp.direction)
    distance = np.linalg.norm(contacts.point - clamp.point, axis=1)
    near = np.flatnonzero(distance < clamp.radius + np.sqrt(contacts.area))
    near, stack, gaps = near[np.argsort(distance[near], kind="stable")], [clamp.part], []
    for pair in itertools.chain.from_iterable(itertools.repeat(near, len(zones))):  # a sheet per pass
        first, second = zones[contacts.zone[pair]].parts
        along = float(contacts.frame[pair, :, 0] @ push)  # from the first to the second
        upper, lower = (first, second) if along > 0 else (second, first)
        if abs(along) > INCLINED and upper == stack[-1] and lower not in stack:
            stack.append(lower)
            gaps.append(float(contacts.gap[pair]))
    return gaps, stack


def _support(scene, clamp, stack) -> float:
    """Distance from a clamp to the nearest support of its stack, mm; 0 within the pad."""
    push, order = np.sign(clamp.force or 1.0) * np.array(clamp.direction), [str(stage.name) for stage in scene.stages]
    closed = [item for item in scene.locators if order.index(item.stage) <= order.index(clamp.stage)]
    closed += [item for item in scene.clamps if item.force is None and item.stage == clamp.stage]
    jaws = [item for item in scene.clamps if item.force and item.stage == clamp.stage and item is not clamp]
    opposite = [item for item in jaws if np.sign(item.force) * (item.direction @ push) < -INCLINED]
    found = np.inf
    for item in closed + opposite:
        step = np.subtract(item.point, clamp.point)
        apart = float(np.linalg.norm(step - (step @ push) * push))
        if item.part not in stack or abs(item.direction @ push) < INCLINED:
            continue
        if apart <= clamp.radius + item.radius:
            return 0.0
        if item not in opposite:  # a jaw balances the jaw opposite and nothing else
            found = min(found, apart)
    return found


def _beside(points: np.ndarray, at: np.ndarray, direction: np.ndarray) -> float:
    """Distance of a point from the convex hull of others, projected along a direction, mm."""
    if not len(points):
        return np.inf
    from scipy.optimize import nnls  # slow to import, and warnings are cached

    flat = points - at
    flat = flat - np.outer(flat @ direction, direction)
    scale = max(1.0, float(np.abs(flat).max()))
    share = nnls(np.vstack([flat.T / scale, np.full(len(flat), 1e3)]), np.array([0.0, 0, 0, 1e3]))[0]
    return float(np.linalg.norm(share @ flat / share.sum()))


def locators_in_line(assembly) -> Iterator[Finding]:
    """Parts whose locators are nearly in line, or close together, so that a small error of one moves the part far."""
    scene, stations = assembly.scene, placing_stages(assembly.scene)
    for part in assembly.parts:
        own = [item for item in scene.locators if item.part == part.name and item.stage == stations[part.name]]
        if not own:
            continue  # rests on another part
        centre = np.mean([item.point for item in own], axis=0)
        rows = [[*item.direction, *np.cross(np.subtract(item.point, centre), item.direction)] for item in own]
        moved = amplification(np.array(rows), part.surface.points - centre)
        far = np.linalg.norm(moved, axis=2)
        vertex, worst = np.unravel_index(int(np.argmax(far)), far.shape)
        if far[vertex, worst] > AMPLIFIED:
            names, moved_by = ", ".join(item.name for item in own), far[vertex, worst]
            text = f"is placed on locators {names}; 1 mm at {own[worst].name} moves it by {moved_by:.3g} mm"
            yield label("parts", part), text, own[worst].point


def weld_over_gap(assembly) -> Iterator[Finding]:
    """Welds over wide gaps."""
    for weld, gap in zip(assembly.scene.welds, mean_gaps(assembly)):
        if abs(gap) > GAP:
            yield about("welds", weld, f"is over a gap of {gap:.2g} mm")


def weld_off_zone(assembly) -> Iterator[Finding]:
    """Welds far from every contact pair of the parts that they join."""
    for weld in assembly.scene.welds:
        joining = [own for zone, own in _zones(assembly) if set(zone.parts) == set(weld.parts)]
        points = assembly.contacts.point[np.concatenate(joining)] if joining else [weld.point]
        apart = float(np.linalg.norm(np.subtract(points, weld.point), axis=1).min())
        if apart > FAR:
            yield about("welds", weld, f"is {apart:.0f} mm from the nearest contact pair")


def zones_alike(assembly) -> Iterator[Finding]:
    """Zones that count the same contact twice."""
    contacts = assembly.contacts
    for (first, a), (second, b) in itertools.combinations(_zones(assembly), 2):
        if set(first.parts) != set(second.parts):
            continue
        if contacts.area[a].sum() < contacts.area[b].sum():
            a, b = b, a
        distance, near = cKDTree(contacts.point[a]).query(contacts.point[b])
        inside = distance < 0.75 * np.sqrt(contacts.area[a[near]])
        share = float(contacts.area[b[inside]].sum() / contacts.area[b].sum())
        if share > SHARED:
            reversed_ = ", in the opposite direction," if first.parts != second.parts else ""
            text = f"covers{reversed_} {100 * share:.0f} % of the same area as zone {first.name}"
            yield label("zones", second), text, tuple(contacts.point[b[0]].tolist())


def zone_small(assembly) -> Iterator[Finding]:
    """Zones of very small area."""
    for zone, own in _zones(assembly):
        area = float(assembly.contacts.area[own].sum())
        if area < SMALL:
            yield label("zones", zone), f"touches over {area:.2g} mm²", tuple(assembly.contacts.point[own[0]].tolist())


def bend_coarse(assembly) -> Iterator[Finding]:
    """Zones on bends of few facets: a chord of length ℓ over a turn of θ is ℓ θ / 8 off the curved sheet."""
    for zone, own in _zones(assembly):
        points = assembly.contacts.point[own]
        for part in (part for part in assembly.parts if part.name in zone.parts):
            triangle = part.surface.project(points).triangle
            chord, turn = (
                np.roll(corners[triangle], -1, axis=1) - corners[triangle]
                for corners in (part.surface.corners, part.surface.corner_normals)
            )
            off = np.abs(np.einsum("kij,kij->ki", chord, turn)) / 8
            worst, edge = np.unravel_index(int(np.argmax(off)), off.shape)
            if off[worst, edge] > CHORD:
                length, share = np.linalg.norm(chord[worst, edge]), float((off.max(axis=1) > CHORD).mean())
                text = f"has {100 * share:.0f} % of its pairs on bends of part {part.name} with facets "
                text += f"{length:.2g} mm long, up to {off[worst, edge]:.2g} mm off the curved sheet"
                yield label("zones", zone), text, tuple(points[worst].tolist())


def samples_twice(assembly) -> Iterator[Finding]:
    """Repeated rows of a table of samples."""
    values = assembly.scene.monte_carlo.values or []
    seen: dict[tuple[float, ...], int] = {}
    twice = [(i, seen[row]) for i, row in enumerate(map(tuple, values)) if seen.setdefault(row, i) != i]
    if twice:
        i, first = twice[0]
        yield "monte_carlo", f"sample {i} repeats sample {first} ({len(twice)} of {len(values)} are repetitions)", None


def samples_narrow(assembly) -> Iterator[Finding]:
    """Columns of a table of samples whose spread is far below their sigma."""
    values = np.array(assembly.scene.monte_carlo.values or [])
    if len(values) < ENOUGH:
        return
    for item, column in zip(assembly.scene.deviations, values.T):
        spread = float(column.std())
        if 0.0 < spread < NARROW * item.sigma:
            text = f"has a standard deviation of {spread:.3g} in the samples, and sigma = {item.sigma:g}"
            yield label("deviations", item), text, None


def overlap_closed(assembly) -> Iterator[Finding]:
    """Overlaps that are closed by default and deeper than drawing explains."""
    return _overlaps(assembly, "close", 0.25, "closes")


def overlap_kept(assembly) -> Iterator[Finding]:
    """Overlaps that are kept and deeper than a preload."""
    return _overlaps(assembly, "keep", 0.5, "keeps")


def _overlaps(assembly, rule, share, does) -> Iterator[Finding]:
    """Zones with this `nominal_overlap` whose overlap exceeds this share of the thinner sheet."""
    contacts = assembly.contacts
    for zone, own in _zones(assembly):
        thinner = min(part.thickness for part in assembly.parts if part.name in zone.parts)
        worst = own[np.argmax(contacts.overlap[own])]
        if zone.nominal_overlap == rule and contacts.overlap[worst] > share * thinner:
            text = f"{does} an overlap of {contacts.overlap[worst]:.2g} mm"
            yield label("zones", zone), text, tuple(contacts.point[worst].tolist())


def fixture_turned(assembly) -> Iterator[Finding]:
    """Pads whose normal points away from the part in their zone."""
    for fixture, part, touches in _pads(assembly):
        height = float((part.surface.project(fixture.point).point[0] - fixture.point) @ fixture.normal)
        if touches and height < 0:
            text = f"faces away from part {part.name}, whose mid-surface is {-height:.2g} mm behind it"
            yield about("fixtures", fixture, text)


def fixture_inside(assembly) -> Iterator[Finding]:
    """Pads that contain another part behind their faces."""
    for fixture, part, touches in _pads(assembly):
        step = part.surface.project(fixture.point).point[0] - fixture.point
        behind = -float(step @ fixture.normal)
        aside = float(np.linalg.norm(step + behind * np.array(fixture.normal)))
        if not touches and 0 < behind < BODY and aside < fixture.radius:
            text = f"contains part {part.name}, whose mid-surface is {behind:.2g} mm behind its face"
            yield about("fixtures", fixture, text)


def _pads(assembly) -> Iterator[tuple[Any, Any, bool]]:
    """Each pair of a pad and a part, and whether a zone joins them."""
    joined = [set(zone.parts) for zone in assembly.scene.zones]
    for fixture, part in itertools.product(assembly.scene.fixtures, assembly.parts):
        if fixture.point is not None:
            yield fixture, part, {fixture.name, part.name} in joined


def parts_cross(sheets) -> Iterator[Finding]:
    """Parts whose mid-surfaces pass through each other."""
    for (part, surface), (other, other_surface) in itertools.permutations(sheets, 2):
        at = _crossing(surface, other_surface)
        if at is not None:
            yield label("parts", part), f"passes through part {other.name}", at


def _crossing(surface: Surface, other: Surface) -> Point | None:
    """The point where edges of one surface pass deepest through another; None if they do not."""
    reach = float(np.median(surface.edge_lengths))
    low, high = other.points.min(axis=0) - reach, other.points.max(axis=0) + reach
    near = np.flatnonzero(((surface.points >= low) & (surface.points <= high)).all(axis=1))
    near = near[cKDTree(other.points).query(surface.points[near], distance_upper_bound=3 * reach)[0] < np.inf]
    foot = other.project(surface.points[near], reach=3 * reach)
    found = (foot.triangle >= 0) & ~foot.at_border & (foot.distance < 2 * reach)
    height = np.full(len(surface.points), np.nan)
    step = surface.points[near[found]] - foot.point[found]
    height[near[found]] = np.einsum("ij,ij->i", step, other.normals[foot.triangle[found]])
    ends = surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    with np.errstate(invalid="ignore"):
        depth = np.where((height[ends].prod(axis=1) < 0), np.abs(height[ends]).min(axis=1), 0.0)
    deepest = int(np.argmax(depth))
    return tuple(surface.points[ends[deepest]].mean(axis=0).tolist()) if depth[deepest] > CROSSED else None


def _to_border(surface: Surface, at: np.ndarray) -> float:
    """Distance from a point to the nearest border edge, mm."""
    triangle, corner = np.nonzero(surface.border)
    if not len(triangle):
        return np.inf
    a = surface.points[surface.triangles[triangle, (corner + 1) % 3]]
    b = surface.points[surface.triangles[triangle, (corner + 2) % 3]]
    share = np.einsum("ij,ij->i", at - a, b - a) / np.einsum("ij,ij->i", b - a, b - a)
    foot = a + np.clip(share, 0, 1)[:, None] * (b - a)
    return float(np.linalg.norm(foot - at, axis=1).min())
