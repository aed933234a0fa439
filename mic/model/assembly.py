"""The assembly: a scene put on its meshes, as parts with retained functionals and rows over them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from mic.compliance.functional import Functionals
from mic.compliance.matrices import read_matrix
from mic.compliance.part import Part
from mic.compliance.superelement import ELEMENT, Superelement, superelement
from mic.contact.friction import Friction
from mic.contact.laws import LAWS
from mic.contact.laws.pressure_dependent import rescaled
from mic.errors import FormatError, Problems, SceneError
from mic.geometry.deck import UNITS, Deck
from mic.geometry.load import LoadedPart, fixture_surface, load_fixture, load_part
from mic.geometry.pairing import (
    ContactPair,
    Pressed,
    Side,
    candidate_spacing,
    find_between,
    find_pairs,
    node_pairs,
    pair_at,
)
from mic.geometry.surface import Patch, Surface
from mic.model import characteristics
from mic.model.coincident_sheets import refuse_untold
from mic.model.element_sizes import chosen_sizes
from mic.model.overlap import closed, joined_by
from mic.model.placement import place
from mic.model.position_rows import position_rows
from mic.model.refined_mesh import resolved
from mic.model.rows import AXES, NORMAL, Rows
from mic.model.shape_modes import write_modes
from mic.model.sources import ranges, sources
from mic.scene import Scene
from mic.scene.checks import entry
from mic.scene.samples import take_samples
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint
from mic.system.matrix_product import one_thread
from mic.system.memoise import kept

__all__ = ["Assembly", "Between", "Contacts", "assemble"]

SET_UP = Format("set of parts and contact pairs", 1, ABSENT)
BACKING = 0.5  # cosine of the angle between a clamp and a locator: beyond it they press on one line
MOST = 64  # of them that are kept: each is of one scene as it stood once


@dataclass(frozen=True)
class Contacts:
    """The contact pairs of all zones, in the scene's order.

    Attributes
    ----------
    zone : (m,) int array
        Index of the pair's zone in ``scene.zones``.
    stages : (k,) array of str
        Names of the stages in which a zone has friction of its own.
    friction : (k + 1, m) array
        Coefficients in these stages, and in all others.
    pressure : (m, q, 5) array
        μ as a function of the normal force, in pieces (`mic.contact.laws.pressure_dependent`); NaN where a zone leaves
        it constant.
    compliance : (m,) array
        ``1/(k_t A)``, mm/N: how far the contact yields before it slips; 0 where not at all.
    gap : (m,) array
        Nominal gap between the facing surfaces, mm, positive when apart; overlap that is closed
        (:mod:`mic.model.overlap`) is 0.
    overlap, overlapping : (m,) array
        Deepest overlap within the pair as the surfaces are drawn, mm, and the area in which they overlap, mm².
    area : (m,) array
        Share of the zone, mm².
    watched : (m,) bool array
        Whether the pair is a candidate: it carries force where it would penetrate, and takes no part elsewhere.
    layer : (m,) array
        ``(t_a + t_b)/2 / (E A)`` of a candidate, mm/N: how far the sheets yield through their thickness.
    nugget : (m,) int array
        The weld within whose nugget a candidate's centre lies, -1 for none: once made, it is all that joins there.
    bearing : (m,) array
        A: what pressure and stiffness per area refer to, mm²: the share of the zone, or the disc that ``patch`` gives.
    point : (m, 3) array
        mm.
    frame : (m, 3, 3) array
        ``frame[k] = [n, t1, t2]`` in columns, n from the first body to the second.
    dimension : int
        Rows per pair: 3 (n, t1, t2), or 1 where nothing tangential is asked for.
    """

    zone: np.ndarray
    stages: np.ndarray
    friction: np.ndarray
    pressure: np.ndarray
    compliance: np.ndarray
    gap: np.ndarray
    overlap: np.ndarray
    overlapping: np.ndarray
    area: np.ndarray
    watched: np.ndarray
    layer: np.ndarray
    nugget: np.ndarray
    bearing: np.ndarray
    point: np.ndarray
    frame: np.ndarray
    dimension: int

    def __len__(self):
        return len(self.zone)

    @property
    def frictional(self) -> bool:
        """Whether anything gives any pair friction."""
        return bool(self.friction.any() or self.pressure.shape[1])

    def out(self, welds: Sequence[int], away: Sequence[int] = ()) -> np.ndarray:
        """(m,) candidates that take no part once these welds are made, and pairs of zones that are not there."""
        return np.isin(self.nugget, welds) | np.isin(self.zone, away)

    def friction_in(self, stage: str) -> Friction:
        """What the laws know of the pairs' friction in a stage."""
        named, pressure = [*self.stages, stage], None
        coefficient = self.friction[named.index(stage)]
        if self.pressure.shape[1]:
            none = np.isnan(self.pressure[:, 0, 0])
            pressure = np.where(none[:, None, None], 0.0, self.pressure)
            pressure[none, 1:, 0] = np.inf
            pressure[none, 0, 1] = coefficient[none]
        return Friction(coefficient, pressure, self.compliance)


@dataclass(frozen=True)
class Between:
    """Points between the contact pairs, which carry no force: how far the sheets pass through each other unseen.

    Attributes
    ----------
    zone : (q,) int array
        Index of each point's zone in ``scene.zones``.
    gap : (q,) array
        Nominal gap, mm, as `Contacts` has it.
    nugget : (q,) int array
        The weld within whose nugget the point lies, -1 for none.
    point : (q, 3) array
        mm.
    """

    zone: np.ndarray
    gap: np.ndarray
    nugget: np.ndarray
    point: np.ndarray

    def __len__(self):
        return len(self.zone)


@dataclass(frozen=True)
class Assembly:
    """Parts with their retained functionals, and the rows that the process works with.

    Attributes
    ----------
    scene : Scene
        What its parts leave to their mesh files filled in, and placed on its meshes (:mod:`mic.model.placement`): points
        and directions are vectors, clamps single ones.
    parts : tuple of Part
        On the meshes that they are solved on (:mod:`mic.model.refined_mesh`).
    rows : dict of str to (r, F) csr_matrix
        Rows over the stacked functionals of all parts (F in all), by what they stand for (`mic.model.rows.KINDS`).
    labels : dict of str to list of str
        One name per row.
    contacts : Contacts
    between : Between
    weld_size : tuple of int
        Rows of each weld; the first is its mean normal to the sheets, towards the second part.
    weld_gap : (r,) array
        What each row of the welds reads of the nominal gap, mm, of rotations rad: its mean, and how it tilts; 0 of
        tangential rows, and where overlap is closed.
    inputs : dict of str to str
        Hashes of the files that the meshes of parts and fixtures were made from.
    sizes : dict of str to float
        Element sizes, mm, of the parts that state an accuracy.
    spacing : tuple of float or None
        Distance between the candidates of each zone, mm; None where a zone states its pairs.
    decks : dict of str to Deck
        What the mesh files of the parts tell beside the mesh.
    position_gap : (q,) array
        By how much the gap of the weld that a position row belongs to grows as it moves; 0 for others.
    placed : tuple of str
        What was found for each node, set, hole and tong that the scene names, and for each measured shape and field.
    surfaces : dict of str to Surface
        Of the parts as their meshes draw them, before elements are divided.
    identity : str
        Hash of all that it follows from, the program included.
    """

    scene: Scene
    parts: tuple[Part, ...]
    rows: dict[str, csr_matrix]
    labels: dict[str, list[str]]
    contacts: Contacts
    between: Between
    weld_size: tuple[int, ...]
    weld_gap: np.ndarray
    inputs: dict[str, str | None]
    sizes: Mapping[str, float] = field(default_factory=dict)
    spacing: tuple[float | None, ...] = ()
    decks: Mapping[str, Deck] = field(default_factory=dict)
    placed: tuple[str, ...] = ()
    position_gap: np.ndarray = field(default_factory=lambda: np.zeros(0))
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    identity: str = ""

    @property
    def centres(self) -> np.ndarray:
        """(P, 3) centres of the parts' surfaces, mm."""
        return np.array([part.surface.centroid for part in self.parts])

    @property
    def offsets(self) -> np.ndarray:
        """First stacked functional of each part, and the total at the end."""
        return np.concatenate([[0], np.cumsum([len(part.functionals) for part in self.parts])])


@dataclass(frozen=True)
class SetUp:
    """What of an :class:`Assembly` takes a while to find; fields as there."""

    parts: tuple[Part, ...]
    rows: dict[str, csr_matrix]
    labels: dict[str, list[str]]
    contacts: Contacts
    between: Between
    weld_size: tuple[int, ...]
    weld_gap: np.ndarray
    spacing: tuple[float | None, ...]
    position_gap: np.ndarray


@one_thread
def assemble(
    scene: Scene,
    cache: Path,
    every_node: bool = False,
    progress: Callable[[str], None] | None = None,
    check: Callable[[Assembly], object] = lambda assembly: None,
) -> Assembly:
    """Mesh the parts, find the contact pairs and set up all rows.

    Parts that state an accuracy are solved meanwhile, on meshes that become finer until they reach it.

    Parameters
    ----------
    scene : Scene
    cache : Path
        Folder for generated meshes.
    every_node : bool
        Candidates at every mesh vertex in the zones (:func:`mic.geometry.pairing.node_pairs`), not the pairs that the
        zones ask for.
    progress : callable, optional
        Called with one line of text before each solve.
    check : callable, optional
        Called with the assembly on its first meshes before parts that state an accuracy are solved, so that what it
        raises comes first; not called where none does.

    Raises
    ------
    SceneError
        Naming the key: a missing mesh, a point off its part, an empty zone, an accuracy out of reach.
    MissingProvider
        If an accuracy is asked for and nothing that solves is installed.
    """
    sizes = chosen_sizes(scene, cache, partial(_assembled, scene, cache, False), check, progress)
    return _assembled(scene, cache, every_node, sizes)


def _assembled(scene: Scene, cache: Path, every_node: bool, sizes: Mapping[str, float]) -> Assembly:
    inputs: dict[str, str | None] = {}
    fixtures = {}
    problems, loaded = Problems(), []
    for part in scene.parts:
        with problems:
            loaded.append(load_part(part, scene.folder, cache, sizes.get(part.name)))
    for fixture in scene.fixtures:
        with problems:
            if fixture.mesh is not None:
                fixtures[fixture.name], read = load_fixture(fixture, scene.folder)
                inputs |= read
    problems.tell()
    read = {name: kept for one in loaded for name, kept in one.inputs.items()}
    surfaces, inputs = {one.part.name: one.surface for one in loaded}, read | inputs
    if any(one.part is not part for one, part in zip(loaded, scene.parts)):
        scene = scene.model_copy(update={"parts": [one.part for one in loaded]})
    decks = {one.part.name: one.deck for one in loaded}
    scene, placed = place(scene, surfaces, decks)
    written = write_modes(scene, surfaces, decks)
    scene, placed = written.scene, placed + written.sentences
    scene, given = take_samples(scene)
    inputs |= written.inputs | given | _matrix_files(scene)
    drawn = [
        None if array is None else fingerprint(array.tobytes())
        for one in (*surfaces.values(), *fixtures.values())
        for array in (one.points, one.triangles, one.given_normals)
    ]
    asked = scene.monte_carlo.model_copy(update={"samples": 1, "seed": 0})
    bare = scene.model_copy(update={"name": "", "description": "", "monte_carlo": asked})
    found, identity = kept(
        Cache(cache, "assemblies", SET_UP, MOST),
        [bare.model_dump_json(), every_node, inputs, drawn],
        surfaces,
        (SetUp, Part, Surface, Functionals, Patch, Superelement, Contacts, Between),
        lambda: _set_up(bare, loaded, surfaces, fixtures, every_node),
    )
    return Assembly(
        scene,
        found.parts,
        found.rows,
        found.labels,
        found.contacts,
        found.between,
        found.weld_size,
        found.weld_gap,
        inputs,
        sizes,
        found.spacing,
        {one.part.name: one.deck for one in loaded if one.deck is not None},
        placed,
        found.position_gap,
        surfaces,
        identity,
    )


def _set_up(scene: Scene, loaded, surfaces, fixtures, every_node: bool) -> SetUp:
    """What follows from the scene, the surfaces and the matrices of superelements, and from nothing else."""
    problems, fixtures = Problems(), dict(fixtures)
    thickness = {part.name: part.thickness for part in scene.parts}
    bodies = {name: Side(surface, thickness[name]) for name, surface in surfaces.items()}
    pads = [pad for pad in scene.fixtures if pad.mesh is None]  # some of which the parts' meshes have placed
    fixtures |= {pad.name: fixture_surface(pad, scene.folder) for pad in pads}
    discs = {pad.name: (pad.point, pad.radius) for pad in pads if pad.point and pad.radius}
    bodies |= {name: Side(surface, disc=discs.get(name)) for name, surface in fixtures.items()}
    rows = Rows(surfaces)
    for i, locator in enumerate(scene.locators):
        with problems:
            rows.point("locator", f"locators[{i}]", locator)
    for i, clamp in enumerate(scene.clamps):
        with problems:
            rows.point("clamp", f"clamps[{i}]", clamp)
    drawn = []
    for i, weld in enumerate(scene.welds):
        with problems:
            drawn.append(_weld_rows(f"welds[{i}]", weld, bodies, rows))
    pressed = [_pressed(scene, zone, bodies) for zone in scene.zones]
    pairs = _zone_pairs(scene, bodies, pressed, every_node, problems)
    if not problems:
        contacts = _contact_rows(scene, bodies, rows, pairs, every_node, problems)
    if not problems:
        between = _between_rows(scene, bodies, rows, pressed, [] if every_node else pairs)
        weld_gap = _weld_gaps(scene, contacts, drawn, problems)
    for source in sources(scene):
        with problems:
            source.retain(rows)
    characteristics.retain(rows, scene, problems)
    position_gap = np.array([]) if problems else _position_rows(scene, bodies, rows)
    bodies_elsewhere = {}
    for one in loaded:
        with problems:
            bodies_elsewhere[one.part.name] = _superelement(scene, one)
    problems.tell()
    varied = ranges(scene)
    parts = tuple(
        Part(
            part.name,
            surfaces[part.name],
            *part.sheet,
            scene.element if bodies_elsewhere[part.name] is None else ELEMENT,
            rows.functionals(part.name),
            bodies_elsewhere[part.name],
            varied.get(part.name),
        )
        for part in scene.parts
    )
    for body in parts:
        if body.superelement is not None:
            body.superelement.readings(body)  # what it cannot read is told before anything is computed
    weld_size = tuple(len(gap) for gap in drawn)
    spacing: list[float | None] = []
    for zone, places in zip(scene.zones, pressed):
        first, second = (bodies[name] for name in zone.parts)
        asked = pairs and zone.candidates
        spacing.append(candidate_spacing(zone, first, second, places) if asked else None)
    apart = np.array([pair.apart for own in pairs for pair in own])
    return SetUp(
        tuple(resolved(part, scene, contacts.zone, contacts.point, apart) for part in parts),
        rows.matrices(),
        rows.labels,
        contacts,
        between,
        weld_size,
        weld_gap,
        tuple(spacing),
        position_gap,
    )


def _matrix_files(scene: Scene) -> dict[str, str | None]:
    """Content of the files of superelements that there are, by their names."""
    found: dict[str, str | None] = {}
    for part in scene.parts:
        name = part.stiffness if part.stiffness is not None else part.compliance
        if name is not None:
            path = scene.folder / name
            for file in (path, path.with_suffix(".csv")):
                if file.is_file():
                    found[str(Path(name).with_name(file.name))] = fingerprint(file.read_bytes())
    return found


def _superelement(scene: Scene, one: LoadedPart) -> Superelement | None:
    """The matrix that stands for a part, if the scene gives one."""
    part = one.part
    key = "stiffness" if part.stiffness is not None else "compliance"
    name = getattr(part, key)
    if name is None:
        return None
    if scene.report.fields or scene.report.accuracy:
        raise SceneError(
            f"part {part.name!r}: {key}: a superelement knows its own nodes alone; leave fields and accuracy out of "
            "[report]"
        )
    path = scene.folder / name
    try:
        given = read_matrix(path)
    except FormatError as problem:
        raise SceneError(f"part {part.name!r}: {key}: {problem}") from problem
    deck = one.deck
    numbered = {} if deck is None else dict(zip(deck.nodes.tolist(), one.drawn.points[deck.node_points]))
    return superelement(part.name, given, key == "stiffness", UNITS[part.unit], one.drawn, numbered)


def _weld_rows(key, weld, bodies, rows: Rows) -> np.ndarray:
    """Rows of one weld at the middle of the gap: its mean displacement along n, t1, t2, and what else it ties.

    A fused nugget is one piece: what it ties are all displacements over the disc up to the linear ones,

        ∫ φ (u_b − u_a) dA / A,        φ = 1, x, y,

    x and y from the middle, in radii. An averaged one ties the means of displacements and rotations.

    Both parts are read at the same material-free point, half of any nominal gap off their facing surfaces: otherwise
    turning the welded assembly as a whole would strain the weld. Returns what each row reads of the gap as drawn.
    """
    for name in weld.parts:
        rows.on_part(key, weld.name, weld.point, name)
    try:
        pair = pair_at(weld.point, weld.radius, *(bodies[name] for name in weld.parts))
    except ValueError as error:
        raise SceneError(f"{key}.point ({weld.name}): {error}; correct the coordinates") from None
    terms = _weld_terms(weld, pair, bodies, rows)
    for label, *row in terms:
        rows.add("weld", label, *row)
    return _drawn_gap(weld, pair, bodies)


def _weld_terms(weld, pair: ContactPair, bodies, rows: Rows) -> list[tuple]:
    """Retain what a weld reads over a pair; of each of its rows the label, and what it is of the two parts."""
    moments = _moments(pair, bodies[weld.parts[0]].surface, weld.radius) if weld.fused and weld.moment else {}
    functional: list[list[int]] = []
    for name, patch, side in zip(weld.parts, pair.patches, pair.sides):
        middle = side * (1 + pair.gap / bodies[name].thickness)
        mean = rows.patch(name, patch)
        asked = [("", mean, False)]
        asked += [(label, rows.patch(name, replace(patch, weight=w)), False) for label, w in moments.items()]
        asked += [("r", mean, True)] * (weld.moment and not moments)
        functional.append(
            [
                rows.functional(
                    name, at, pair.frame[:, j], f"weld {weld.name} {label}{axis}", rotates, 0.0 if rotates else middle
                )
                for label, at, rotates in asked
                for j, axis in enumerate(AXES)
            ]
        )
    first, second = weld.parts
    labels = [f"{weld.name} {label}{axis}" for label, _, _ in asked for axis in AXES]
    return [(label, (first, a, -1.0), (second, b, 1.0)) for label, a, b in zip(labels, *functional)]


def _drawn_gap(weld, pair: ContactPair, bodies) -> np.ndarray:
    """(r,) what a weld's rows read of the gap g as drawn over the disc; 0 of those that are tangential.

    The mean gap, mm; of a fused nugget the moments ∫ φ g dA / A, mm, φ = x, y in radii; of an averaged one the
    rotation of the second sheet against the first about t1, t2 that opens g = g₀ + α x + β y, (β, −α), rad.
    """
    rows = np.zeros(3 if not weld.moment else 9 if weld.fused else 6)
    rows[0] = pair.gap
    if len(rows) == 3:
        return rows
    first, second = (bodies[name].surface for name in weld.parts)
    a, b = pair.patches
    point = first.at(a.triangle, a.barycentric)
    apart = (second.at(b.triangle, b.barycentric) - point) @ pair.frame[:, 0]
    gap = apart - a.weight @ apart / a.weight.sum() + pair.gap
    φ = (point - pair.point) @ pair.frame[:, 1:] / weld.radius
    normal = list(NORMAL[len(rows)][1:])
    if weld.fused:
        rows[normal] = (a.weight * gap) @ φ
        return rows
    φ = np.column_stack([np.ones(len(φ)), φ])
    _, α, β = np.linalg.lstsq(φ.T @ (a.weight[:, None] * φ), φ.T @ (a.weight * gap), rcond=None)[0] / weld.radius
    rows[normal] = β, -α
    return rows


def _position_rows(scene, bodies, rows: Rows) -> np.ndarray:
    """What the scene's report asks to be moved, welds with what they read."""
    return position_rows(scene, bodies, rows, partial(_weld_terms, bodies=bodies), partial(_drawn_gap, bodies=bodies))


def _moments(pair: ContactPair, surface, radius) -> dict[str, np.ndarray]:
    """Weights (q,) of a nugget's points that read its first moments, along t1 and t2."""
    patch = pair.patches[0]
    step = surface.at(patch.triangle, patch.barycentric) - pair.point
    return {f"{axis}-moment ": patch.weight * (step @ pair.frame[:, j]) / radius for j, axis in ((1, "t1"), (2, "t2"))}


def _zone_pairs(scene, bodies, pressed, every_node, problems: Problems) -> list[list[ContactPair]]:
    """The pairs of each zone; none where no stage resolves contact."""
    resolved = any(stage.kind != "locate" for stage in scene.stages)
    landmarks = np.array([locator.point for locator in scene.locators]).reshape(-1, 3)
    found = []
    for i, zone in enumerate(scene.zones if resolved else ()):
        a, b = (bodies[name] for name in zone.parts)
        with problems:
            try:
                if every_node:
                    found.append(node_pairs(zone, a, b, pressed[i]))
                else:
                    found.append(find_pairs(zone, a, b, landmarks, pressed[i]))
            except ValueError as error:
                raise SceneError(f"{entry('zones', i, zone)}: {error}") from None
            refuse_untold(entry("zones", i, zone), zone.parts, found[-1], a, b)
    return found


def _pressed(scene, zone, bodies) -> list[Pressed]:
    """Where something presses the bodies of a zone together: clamps, welds and locators.

    A clamp, and a locator that backs one, presses through other sheets, too: it counts where it stands over the zone
    with nothing but sheets that touch between.
    """
    through = _stacked(scene, zone, bodies)
    clamps, places = [], []
    for item in scene.clamps:
        point = _level(item, zone, bodies, through)
        if point is not None:
            clamps.append(item)
            places.append(Pressed(point, item.radius))
    for i, weld in enumerate(scene.welds):
        if set(weld.parts) == set(zone.parts):
            places.append(Pressed(np.array(weld.point), weld.radius, i, _weld_normal(zone, weld, bodies)))
    for item in scene.locators:
        point = _level(item, zone, bodies, through)
        if point is not None:
            held = _held(item, point, clamps)
            if held.backs or item.part in zone.parts:
                places.append(held)
    return places


def _stacked(scene, zone, bodies) -> dict[str, tuple[str, float]]:
    """By the name of each other part that zones join with this one's: which of its bodies they lead to, and how far
    from that body's middle surface the part's may lie, mm."""
    found = {name: (name, 0.0) for name in zone.parts if not bodies[name].rigid}
    for _ in scene.parts:
        for one in scene.zones:
            if any(bodies[name].rigid for name in one.parts):
                continue  # what a fixture takes, it passes on to nothing
            far = one.max_gap + sum(bodies[name].half_thickness for name in one.parts)
            for near, next_ in (one.parts, one.parts[::-1]):
                if near in found and found[near][1] + far < found.get(next_, ("", np.inf))[1]:
                    found[next_] = (found[near][0], found[near][1] + far)
    return {name: there for name, there in found.items() if name not in zone.parts}


def _level(item, zone, bodies, through) -> np.ndarray | None:
    """A clamp's or locator's point, moved along its direction to the body of a zone that it presses; None if none."""
    point = np.array(item.point)
    if item.part in zone.parts:
        return point
    name, far = through.get(item.part, ("", 0.0))
    if not name or not item.radius:
        return None
    along = np.array(item.direction) / np.linalg.norm(item.direction)
    steps = [bodies[one].surface.project(point).point[0] - point for one in (name, *zone.parts)]
    ahead = [step @ along for step in steps]
    beside = [np.linalg.norm(step - way * along) for step, way in zip(steps, ahead)]
    return point + ahead[0] * along if max(beside) < item.radius and abs(ahead[0]) <= far else None


def _held(locator, point, clamps) -> Pressed:
    """Where a locator holds; with the radius of its pad where it backs a clamp: it holds along the line on which that
    presses, and their pads overlap."""
    backs = 0.0
    for clamp in clamps:
        along = np.array(clamp.direction) / np.linalg.norm(clamp.direction)
        step = np.array(locator.point) - np.array(clamp.point)
        beside = np.linalg.norm(step - (step @ along) * along)
        opposed = abs(along @ locator.direction) > BACKING * np.linalg.norm(locator.direction)
        if locator.radius and opposed and beside < clamp.radius + locator.radius:
            backs = max(backs, clamp.radius)
    return Pressed(point, locator.radius if backs else 0.0, backs=backs)


def _weld_normal(zone, weld, bodies) -> np.ndarray | None:
    """From the zone's first body to its second where a weld joins them; None where it finds them nowhere."""
    try:
        pair = pair_at(weld.point, weld.radius, *(bodies[name] for name in weld.parts))
    except ValueError:
        return None  # said where its rows are drawn
    return pair.frame[:, 0] if weld.parts[0] == zone.parts[0] else -pair.frame[:, 0]


def _between_rows(scene, bodies, rows: Rows, pressed, pairs) -> Between:
    """Rows of the points between the pairs: their normal reading alone."""
    landmarks = np.array([locator.point for locator in scene.locators]).reshape(-1, 3)
    points: list[ContactPair] = []
    zones: list[int] = []
    for i, (zone, own) in enumerate(zip(scene.zones, pairs)):
        a, b = (bodies[name] for name in zone.parts)
        found = find_between(zone, a, b, own, landmarks, pressed[i])
        for one in found:
            _joint_rows(rows, "between", f"{zone.name} between {len(points)}", zone, bodies, one, 1)
            points.append(one)
        zones += [i] * len(found)
    at = np.array([one.point for one in points]).reshape(-1, 3)
    zone_of, gap = np.array(zones, dtype=np.int64), np.array([one.gap for one in points])
    for i, zone in enumerate(scene.zones):
        if zone.gap is not None:
            gap[zone_of == i] = zone.gap
        elif zone.nominal_overlap != "keep":
            gap[zone_of == i] = np.maximum(gap[zone_of == i], 0.0)
    return Between(zone_of, gap, np.array([one.nugget for one in points], dtype=np.int64), at)


def _joint_rows(rows: Rows, kind, label, zone, bodies, pair: ContactPair, dimension) -> None:
    """The rows of a pair, n, t1, t2: what its second body moves less its first."""
    terms: list[list[tuple[str, int, float]]] = [[] for _ in range(dimension)]
    for name, patch, side, sign in zip(zone.parts, pair.patches, pair.sides, (-1.0, 1.0)):
        if bodies[name].rigid:
            continue  # a rigid fixture does not move
        index = rows.patch(name, patch)
        for j in range(dimension):
            reading = rows.functional(
                name, index, pair.frame[:, j], f"{label} {AXES[j]}", side=0 if zone.mid_surface else side
            )
            terms[j].append((name, reading, sign))
    for j in range(dimension):
        rows.add(kind, f"{label} {AXES[j]}", *terms[j])


def _contact_rows(scene, bodies, rows: Rows, found, every_node, problems: Problems) -> Contacts:
    """Rows of all contact pairs, and what is known of the pairs."""
    friction = any(LAWS[law].frictional for law in scene.report.laws) and any(zone.frictional for zone in scene.zones)
    dimension = 3 if friction or scene.report.slip else 1
    pairs: list[ContactPair] = []
    zones: list[int] = []
    for i, (zone, own) in enumerate(zip(scene.zones, found)):
        for pair in own:
            _joint_rows(rows, "contact", f"{zone.name} {len(pairs)}", zone, bodies, pair, dimension)
            pairs.append(pair)
            zones.append(i)
    zone_of = np.array(zones, dtype=np.int64)
    area = np.array([pair.area for pair in pairs])
    gap = np.array([pair.gap for pair in pairs])
    drawn = np.array([[pair.overlap, pair.overlapping * pair.area] for pair in pairs]).reshape(-1, 2)
    point = np.array([pair.point for pair in pairs]).reshape(-1, 3)
    for i, zone in enumerate(scene.zones):
        own = zone_of == i
        if zone.gap is not None:
            gap[own], drawn[own] = zone.gap, 0.0
            continue
        key = f"zones[{i}] ({zone.name}): nominal_overlap"
        with problems:
            gap[own] = closed(key, zone.nominal_overlap, gap[own], _thinner(scene, zone), point[own])
    by_stage = [zone.friction for zone in scene.zones if isinstance(zone.friction, dict)]
    stages = sorted({stage for one in by_stage for stage in one} - {"default"})
    discs = [None if every_node or zone.patch == "tributary" else np.pi * zone.patch**2 for zone in scene.zones]
    bearing = np.array([area[k] if discs[i] is None else discs[i] for k, i in enumerate(zone_of)])
    stiffness = [scene.zones[i].tangential_stiffness for i in zone_of]
    watched = np.array([every_node or scene.zones[i].candidates for i in zone_of], dtype=bool)
    through = [
        sum(part.thickness / (2 * part.young) for part in scene.parts if part.name in zone.parts)
        for zone in scene.zones
    ]
    return Contacts(
        zone_of,
        np.array(stages, dtype=str),
        np.array([[scene.zones[i].coefficient(stage) for i in zone_of] for stage in [*stages, "default"]]),
        _pressure_pieces(scene, zone_of, bearing),
        np.array([0.0 if k is None else 1.0 / (k * A) for k, A in zip(stiffness, bearing)]),
        gap,
        drawn[:, 0],
        drawn[:, 1],
        area,
        watched,
        np.where(watched, np.array([through[i] for i in zone_of]) / area, 0.0),
        np.array([pair.nugget for pair in pairs], dtype=np.int64),
        bearing,
        point,
        np.array([p.frame for p in pairs]).reshape(-1, 3, 3),
        dimension,
    )


def _weld_gaps(scene, contacts: Contacts, drawn: Sequence[np.ndarray], problems: Problems) -> np.ndarray:
    """(r,) what the welds' rows read of their gaps, overlap closed as at the pairs about them."""
    for i, (weld, rows) in enumerate(zip(scene.welds, drawn)):
        zone = joined_by(scene.zones, contacts.zone, contacts.point, weld)
        if zone is not None and zone.gap is not None:
            rows[:] = 0.0
            rows[0] = zone.gap
            continue
        rule, at = "close" if zone is None else zone.nominal_overlap, np.array([weld.point])
        with problems:
            gap = closed(entry("welds", i, weld), rule, rows[:1], _thinner(scene, weld), at)[0]
            if gap != rows[0]:
                rows[:] = 0.0  # what is closed does not tilt
                rows[0] = gap
    return np.concatenate([np.zeros(0), *drawn])


def _thinner(scene, joint) -> float:
    """Thickness of the thinner of the sheets that a zone or a weld joins, mm."""
    return min(part.thickness for part in scene.parts if part.name in joint.parts)


def _pressure_pieces(scene, zone_of, bearing) -> np.ndarray:
    """(m, q, 5) μ of each pair as a function of its normal force, as `Contacts` holds it."""
    own = [zone.pressure_pieces() for zone in scene.zones]
    pieces = np.full((len(zone_of), max((len(one) for one in own if one is not None), default=0), 5), np.nan)
    for k, i in enumerate(zone_of):
        if own[i] is not None:
            pieces[k] = [np.inf, 0.0, 0.0, 0.0, 0.0]
            pieces[k, : len(own[i])] = rescaled(own[i], 1.0 / bearing[k])
    return pieces
