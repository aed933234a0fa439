"""The whole process of a scene with sheets of solid elements: no shells, influence coefficients, patches or candidates.

CalculiX provides the stiffness of the sheets (:mod:`fem_reference.peers.calculix_sheets`). Every node of a face can
touch the facing sheet, or a fixture's pad, with friction. A locator holds the mean displacement over a disc of the
middle surface. A clamp pushes or holds a disc of the face that it presses on. A nugget is rigid: from its weld on, all
nodes within its disc keep their relative position to the other sheet, or close their gaps, and leave the contact
problem. A shape deviation changes the gaps; it is the shape that a force gives to a part on its first locators.

With the rows R of all displacements that are held, loaded, in contact or measured, and springs α on the rows D of the
first locators,

    F = R (K + α Dᵀ D)⁻¹ Rᵀ,        y = F λ,

where λ are the forces on the rows. The load λ = α y removes the spring of a row of D that is not held, so that K is
factorised once for all stages. Contacts obey Coulomb's law; each increment starts from the positions of the last one.

The process is implemented here a second time, from the scene's tables alone: parts are located; overlapping faces come
to rest; further locators close together, clamps one by one, two clamps that press sheets together at one place as one;
welds freeze or close their gaps; release opens in reverse order; key characteristics are measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, vstack

from fem_reference.peers.calculix_sheets import Sheet
from fem_reference.shell.factorisation import Factorisation
from mic.scene import Scene

__all__ = ["Outcome", "process"]

LARGEST_GAP = 0.5  # of the sheet thickness: nodes with a larger gap are no contacts
BOX_TOLERANCE = 1e-9  # mm: a point outside a box by less counts as inside
KINDS = ("locate", "clamp", "weld", "release", "measure")  # of stages, in the only order that is supported


@dataclass(frozen=True)
class Outcome:
    """Results of the process for n deviation vectors.

    Attributes
    ----------
    stages : list of str
        Names of the stages in which contacts move.
    measurements : (n, k) array
        mm.
    force : (n, stages, zones) array
        Sum of the normal forces of a zone at the end of a stage, outside the surroundings of the nuggets, N.
    slip : (n, stages, zones) array
        Root mean square of the tangential motion in the stage, over the same area, mm.
    contacts : int
        Number of contacts.
    """

    stages: list[str]
    measurements: np.ndarray
    force: np.ndarray
    slip: np.ndarray
    contacts: int


def process(
    scene: Scene,
    sheets: Sequence[Sheet],
    deviations: np.ndarray,
    solver: Callable,
    increments: int = 8,
    beyond: float = 3.0,
    deviated: bool = False,
) -> Outcome:
    """Simulate the process of a scene for deviations (n, p), in the order of the scene.

    Parameters
    ----------
    scene : Scene
        One station with locators, clamps without force limit, fused welds, pads, and deviations of kind force,
        locator or clamp.
    sheets : sequence of Sheet
        In the order of the parts of the scene.
    deviations : (n, p) array
    solver : callable
        ``solver(S, mu)`` prepares contact problems ``u = S f + b``, like :class:`mic.contact.ContactSolver`.
    increments : int
        Number of increments of each step.
    beyond : float
        Forces and slips are summed outside this many radii of each nugget, because nodal forces near a nugget do not
        converge with the mesh.
    deviated : bool
        Use the stiffness of the deviated shape of each sheet instead of the nominal one.

    Raises
    ------
    CalculixError
    ValueError
        If the scene has an unsupported feature, or a contact problem did not converge.
    """
    _check_supported(scene)
    deviations = np.atleast_2d(deviations)
    rows = _Rows(scene, sheets, beyond)
    F, factors = rows.flexibility([sheet.K for sheet in sheets])
    no_force = np.zeros(len(F))
    unit_forces = [rows.shape_forces(F, d.name) if d.kind == "force" else no_force for d in scene.deviations]
    shape_forces = deviations @ unit_forces
    shape = shape_forces @ F
    if not deviated:
        return _Process(rows, F, solver, increments).run(deviations, shape)
    outcomes = []
    for k, forces in enumerate(shape_forces):
        K = [
            sheet.deviated(factor.solve((part_rows.T @ forces)[:, None])[:, 0])
            for sheet, factor, part_rows in zip(sheets, factors, rows.parts)
        ]
        outcomes.append(_Process(rows, rows.flexibility(K)[0], solver, increments).run(deviations[[k]], shape[[k]]))
    arrays = (np.concatenate([getattr(o, key) for o in outcomes]) for key in ("measurements", "force", "slip"))
    return Outcome(outcomes[0].stages, *arrays, outcomes[0].contacts)


def _check_supported(scene: Scene) -> None:
    """Raise ValueError if the scene has a feature that this process does not support."""
    kinds = [stage.kind for stage in scene.stages]
    unsupported = [
        *(f"stage {s.name}: order or sequence" for s in scene.stages if s.order or s.sequence),
        *(f"locator {x.name}: a stiffness" for x in scene.locators if x.stiffness is not None),
        *(f"clamp {c.name}: a limit or two parts" for c in scene.clamps if c.limit is not None or c.parts),
        *(f"weld {w.name}: not fused, or a gun" for w in scene.welds if not w.fused or w.gun is not None),
        *(f"deviation {d.name}: {d.kind}" for d in scene.deviations if d.kind not in ("force", "locator", "clamp")),
        *(f"measurement {m.name}: {m.kind}" for m in scene.measurements if m.kind != "point"),
    ]
    if kinds != sorted(kinds, key=KINDS.index) or kinds.count("locate") != 1:
        unsupported.append("stages: another order than " + ", ".join(KINDS))
    if unsupported:
        raise ValueError("the process with solids does not support " + "; ".join(unsupported))


class _Rows:
    """Displacements of the sheets that are held, loaded, in contact or measured, as rows of a matrix.

    Attributes
    ----------
    parts : list of (r, d) csr_matrix
        Of each sheet: three rows of each contact (n, t1, t2; second body minus first), then the rows in `of`.
    of : dict of str to int
        Row of each locator, clamp, shape force and measurement, by name.
    datum : (6 p,) int array
        Rows of the first locators.
    zone, weld : (m,) int array
        Index of the zone and of the weld of each contact; -1 for no weld.
    gap, area : (m,) array
        Nominal gap, mm; area of the cell around the contact's node, mm².
    outside : (m,) bool array
        Whether the contact counts in sums of force and slip: it is far enough from every nugget.
    """

    def __init__(self, scene: Scene, sheets: Sequence[Sheet], beyond: float):
        self.scene, self._sheets, self._beyond = scene, {p.name: s for p, s in zip(scene.parts, sheets)}, beyond
        zones = [self._contacts(zone) for zone in scene.zones]
        self.zone = np.repeat(np.arange(len(zones)), [len(one["gap"]) for one in zones])
        self.gap, self.area, self.weld, self.outside = (
            np.concatenate([one[key] for one in zones]) for key in ("gap", "area", "weld", "outside")
        )
        forces = [one for one in scene.deviations if one.kind == "force"]
        discs = [*scene.locators, *scene.clamps, *forces, *scene.measurements]
        self.of = {one.name: 3 * len(self.zone) + i for i, one in enumerate(discs)}
        first_locators = {one.name for one in scene.locators if one.stage == scene.stages[0].name}
        self.datum = np.array([self.of[name] for name in self.of if name in first_locators])
        pressed = {one.name for one in scene.clamps}
        self.parts = []
        for name, sheet in self._sheets.items():
            none = csr_matrix((1, sheet.K.shape[0]))
            own = [self._disc(sheet, one, one.name in pressed) if one.part == name else none for one in discs]
            self.parts.append(csr_matrix(vstack([*(one[name] for one in zones), *own])))

    def flexibility(self, stiffness: Sequence) -> tuple[np.ndarray, list[Factorisation]]:
        """F (r, r), and the factorisation of K + α Dᵀ D of each sheet."""
        self.spring = float(np.mean([np.abs(K.diagonal()).mean() for K in stiffness]))
        F = np.zeros((self.parts[0].shape[0],) * 2)
        factors = []
        for K, rows in zip(stiffness, self.parts):
            D = rows[self.datum]
            read = np.flatnonzero(np.diff(rows.indptr))
            factors.append(Factorisation(csr_matrix(K + self.spring * (D.T @ D)), rows[read]))
            F[np.ix_(read, read)] += factors[-1].influence
        return F, factors

    def shape_forces(self, F: np.ndarray, name: str) -> np.ndarray:
        """(r,) forces on the rows: a unit shape force and the reactions of the part's first locators."""
        forces = np.zeros(len(F))
        forces[self.of[name]] = 1.0
        supports = _Supports(F, self.spring, self.datum, self.datum)
        forces[self.datum] += supports.reaction(forces[None], np.zeros((1, len(self.datum))))[0]
        return forces

    @staticmethod
    def _disc(sheet: Sheet, one, pressed: bool) -> csr_matrix:
        layer = sheet.face(one.point, -np.array(one.direction)) if pressed else sheet.middle
        return sheet.mean(layer, one.point, one.radius, one.direction)

    def _contacts(self, zone) -> dict:
        """Rows of each part, and gap, area, weld and outside of each contact of a zone."""
        pads = {one.name: one for one in self.scene.fixtures}
        pad = next((pads[name] for name in zone.parts if name in pads), None)
        hit, normals, gap, faces = self._facing_sheet(zone) if pad is None else self._facing_pad(zone, pad)
        if not len(hit):
            raise ValueError(f"zone {zone.name} has no contacts")
        found = {each: csr_matrix((3 * len(hit), one.K.shape[0])) for each, one in self._sheets.items()}
        for name, layer, weights in faces:
            found[name] = _along(self._sheets[name], layer, weights, normals)
        name, layer, _ = faces[-1]
        sheet = self._sheets[name]
        weld, outside = np.full(len(hit), -1), np.ones(len(hit), bool)
        for i, one in enumerate(self.scene.welds):
            if set(one.parts) == set(zone.parts):
                weld[sheet.within(layer, one.point, one.radius)[hit]] = i
                away = sheet.at(layer)[hit] - one.point
                sideways = away - np.einsum("rd,rd->r", away, normals)[:, None] * normals
                outside &= np.linalg.norm(sideways, axis=1) > self._beyond * one.radius
        return {**found, "gap": gap, "area": sheet.cells(layer)[hit], "weld": weld, "outside": outside}

    def _facing_pad(self, zone, pad) -> tuple:
        """Nodes of the sheet that face a pad, the pad's normals there, gaps, and the faces with their weights."""
        (name,) = set(zone.parts) - {pad.name}
        sheet, normal = self._sheets[name], np.array(pad.normal)
        layer = sheet.face(pad.point, -normal)
        hit = np.flatnonzero(sheet.within(layer, pad.point, pad.radius) & _inside(zone, sheet.at(layer)))
        gap = (sheet.at(layer)[hit] - pad.point) @ normal
        return hit, np.tile(normal, (len(hit), 1)), gap, [(name, layer, _picked(hit, len(sheet.points)))]

    def _facing_sheet(self, zone) -> tuple:
        """Nodes of the second sheet that face the first, its normals there, gaps, and both faces with their weights."""
        none = np.empty(0, int), np.empty((0, 3)), np.empty(0), []
        first, second = (self._sheets[name] for name in zone.parts)
        near, _, normals, height = first.project(first.middle, second.points)
        some = np.flatnonzero(
            (np.abs(height) < first.thickness + second.thickness) & _inside(zone, second.points[near])
        )
        if not len(some):
            return none
        place, side = second.points[near[some[0]]], np.sign(height[some[0]]) * normals[some[0]]
        above, below = second.face(place, -side), first.face(place, side)
        hit, weights, normals, gap = first.project(below, second.at(above))
        outwards = 1.0 if below else -1.0
        normals, gap = outwards * normals, outwards * gap
        keep = _inside(zone, second.at(above)[hit]) & (np.abs(gap) <= LARGEST_GAP * second.thickness)
        own = [(zone.parts[0], below, -weights[keep]), (zone.parts[1], above, _picked(hit[keep], len(second.points)))]
        return hit[keep], normals[keep], gap[keep], own


def _inside(zone, places: np.ndarray) -> np.ndarray:
    """(m,) whether each point lies in the box of a zone; True without a box."""
    if zone.box is None:
        return np.ones(len(places), bool)
    low, high = np.array(zone.box)
    return ((places >= low - BOX_TOLERANCE) & (places <= high + BOX_TOLERANCE)).all(axis=1)


def _picked(nodes: np.ndarray, n: int) -> csr_matrix:
    return csr_matrix((np.ones(len(nodes)), (np.arange(len(nodes)), nodes)), (len(nodes), n))


def _along(sheet: Sheet, layer: int, weights: csr_matrix, normals: np.ndarray) -> csr_matrix:
    """(3 m, d) rows of displacements along the normals and two tangents."""
    axis = np.eye(3)[(np.abs(normals) > 0.9)[:, 0].astype(int)]  # x, or y where the normal is nearly x
    first = axis - np.einsum("rd,rd->r", axis, normals)[:, None] * normals
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    every = vstack([sheet.rows(layer, weights, each) for each in (normals, first, np.cross(normals, first))])
    return csr_matrix(every)[np.arange(3 * len(normals)).reshape(3, -1).T.ravel()]


class _Supports:
    """Displacements y = F λ of the rows while some rows are held and the others are free.

    Parameters
    ----------
    F : (r, r) array
    spring : float
    datum, held : int arrays
        Rows with springs, and rows that are held.
    """

    def __init__(self, F: np.ndarray, spring: float, datum: np.ndarray, held: np.ndarray):
        released = np.setdiff1d(datum, held)
        self._F, self._rows, self._held = F, np.concatenate([held, released]).astype(int), len(held)
        self._spring = np.where(np.isin(held, datum), spring, 0.0)
        block = F[np.ix_(self._rows, self._rows)].copy()
        last = np.arange(len(held), len(self._rows))
        block[last, last] -= 1 / spring
        self._response = np.linalg.solve(block, F[self._rows])
        self._values = np.linalg.inv(block)[:, : len(held)]

    def compliance(self, rows: np.ndarray) -> np.ndarray:
        """(t, t) compliance of t rows under these supports."""
        S = self._F[np.ix_(rows, rows)] - self._F[np.ix_(rows, self._rows)] @ self._response[:, rows]
        return 0.5 * (S + S.T)

    def _forces(self, load: np.ndarray, value: np.ndarray) -> np.ndarray:
        return value @ self._values.T - load @ self._response.T

    def displacements(self, load: np.ndarray, value: np.ndarray) -> np.ndarray:
        """(n, r) displacements of the rows under loads (n, r), with the held rows at values (n, h)."""
        forces = load.copy()
        forces[:, self._rows] += self._forces(load, value)
        return forces @ self._F

    def reaction(self, load: np.ndarray, value: np.ndarray) -> np.ndarray:
        """(n, h) forces on the held rows."""
        return self._forces(load, value)[:, : self._held] - self._spring * value


class _Process:
    """The stages in order, for n deviation vectors at once."""

    def __init__(self, rows: _Rows, F: np.ndarray, solver: Callable, increments: int):
        self._rows, self._scene, self._F = rows, rows.scene, F
        self._solver, self._increments = solver, increments
        self._mu = np.array([zone.friction for zone in self._scene.zones])[rows.zone]
        self._contact = np.arange(3 * len(rows.zone)).reshape(-1, 3)
        self._stroke = np.zeros(len(F))
        for one in self._scene.clamps:
            self._stroke[rows.of[one.name]] = one.stroke or 0.0

    def run(self, deviations: np.ndarray, shape: np.ndarray) -> Outcome:
        """Run all stages with shape deviations given as readings of the rows (n, r)."""
        rows, scene = self._rows, self._scene
        self._locate(deviations, shape)
        stages, force, slip = [], [], []
        for stage in scene.stages[1:]:
            start, self._moved = self._place.copy(), False
            getattr(self, f"_{stage.kind}")(stage)
            if self._moved:
                stages.append(stage.name)
                force.append(self._by_zone(self._force[:, :, 0], 1.0))
                square = ((self._place - start)[:, :, 1:] ** 2).sum(axis=2)
                slip.append(np.sqrt(self._by_zone(square, rows.area) / self._by_zone(np.ones_like(square), rows.area)))
        read = [rows.of[one.name] for one in scene.measurements]
        measured = (shape + self._y)[:, read]
        return Outcome(stages, measured, np.stack(force, axis=1), np.stack(slip, axis=1), len(rows.zone))

    def _locate(self, deviations: np.ndarray, shape: np.ndarray) -> None:
        """Place the parts on the first locators, without contact."""
        rows, n = self._rows, len(deviations)
        self._shape, self._offset = shape, np.zeros((n, len(self._F)))
        for amplitude, one in zip(deviations.T, self._scene.deviations):
            if one.kind != "force":
                self._offset[:, rows.of[one.target]] += amplitude
        self._gap = rows.gap + shape[:, self._contact[:, 0]]
        self._load, self._force = np.zeros_like(shape), np.zeros((n, *self._contact.shape))
        self._active, self._at_rest = np.ones(len(rows.zone), bool), False
        self._hold, self._value = rows.datum, self._target(rows.datum)
        self._closed = [list(rows.datum)]
        self._supports, self._problem = self._eliminate(), None
        self._y = self._supports.displacements(self._load, self._value)
        self._place = self._faces(self._y)

    def _clamp(self, stage) -> None:
        """Bring overlapping faces to rest, once; then close further locators together and clamps one by one."""
        scene, of = self._scene, self._rows.of
        if not self._at_rest:
            clear = self._place.copy()
            clear[:, :, 0] = np.maximum(clear[:, :, 0], 0.0)
            self._advance(self._value, self._load, clear)
            self._at_rest = True
        locators = [of[one.name] for one in scene.locators if one.stage == stage.name]
        pushes = {of[one.name]: one.force for one in scene.clamps if one.force is not None}
        for group in [locators, *self._clamps(stage)]:
            if group:
                hold = [row for row in group if row not in pushes]
                load = self._load.copy()
                for row in set(group) & set(pushes):
                    load[:, row] = pushes[row] + self._offset[:, row]
                self._close(hold, self._y[:, hold], self._target(hold), load)
                self._closed.append(group)

    def _clamps(self, stage) -> list[list[int]]:
        """Rows of the clamps, grouped by what closes together."""
        groups: list[list] = []
        for one in self._scene.clamps:
            if one.stage == stage.name:
                if groups and _opposed(groups[-1][-1], one):
                    groups[-1].append(one)
                else:
                    groups.append([one])
        return [[self._rows.of[one.name] for one in group] for group in groups]

    def _weld(self, stage) -> None:
        """Freeze or close the gaps of the nuggets and remove their contacts."""
        own = [i for i, one in enumerate(self._scene.welds) if one.stage == stage.name]
        fused = np.flatnonzero(np.isin(self._rows.weld, own))
        ties = self._contact[fused]
        found = self._y[:, ties]
        value = found.copy()
        closing = [i for i in own if self._scene.welds[i].close]
        for i in closing:
            at = self._rows.weld[fused] == i
            value[:, at, 0] -= (
                found[:, at, 0] + self._gap[:, fused[at]]
            )  # at every node: the electrodes close the whole nugget
        self._active[fused], self._force[:, fused] = False, 0.0
        start, end = (each.reshape(len(each), -1) for each in (found, value))
        if closing:
            self._close(ties.ravel(), start, end, self._load)
        else:
            self._hold_also(ties.ravel(), start)

    def _release(self, stage) -> None:
        """Open in reverse order of closing, except the rows in `keep`, by reducing the forces to zero."""
        stay_closed = {self._rows.of[name] for name in stage.keep or ()}
        for group in reversed(self._closed):
            gone = [row for row in group if row not in stay_closed]
            if not gone:
                continue
            stays = ~np.isin(self._hold, gone)
            reaction = self._supports.reaction(self._with_contact_forces(self._load), self._value)
            after, self._load = self._load.copy(), self._load.copy()
            self._load[:, self._hold[~stays]] += reaction[:, ~stays]
            after[:, gone] = 0.0
            self._hold, self._value = self._hold[stays], self._value[:, stays]
            self._supports, self._problem = self._eliminate(), None
            self._advance(self._value, after)

    def _measure(self, stage) -> None:
        """Nothing moves: key characteristics are read at the end."""

    def _target(self, rows) -> np.ndarray:
        """(n, rows) displacements that bring the rows to their prescribed positions."""
        return (self._stroke + self._offset - self._shape)[:, rows]

    def _hold_also(self, rows, value: np.ndarray) -> None:
        """Hold further rows at values (n, rows)."""
        self._hold = np.append(self._hold, np.asarray(rows, int))
        self._value = np.hstack([self._value, value])
        self._supports, self._problem = self._eliminate(), None

    def _close(self, rows, start: np.ndarray, end: np.ndarray, load: np.ndarray) -> None:
        """Hold further rows and move them from start to end (n, rows) while the loads change."""
        before = self._value
        if len(rows):
            self._hold_also(rows, start)
        self._advance(np.hstack([before, end]), load)

    def _eliminate(self) -> _Supports:
        return _Supports(self._F, self._rows.spring, self._rows.datum, self._hold)

    def _with_contact_forces(self, load: np.ndarray) -> np.ndarray:
        """Loads plus contact forces, (n, r)."""
        total = load.copy()
        total[:, self._contact.ravel()] += self._force.reshape(len(load), -1)
        return total

    def _faces(self, y: np.ndarray) -> np.ndarray:
        """(n, m, 3) relative positions of the faces, second body minus first."""
        place = y[:, self._contact]
        place[:, :, 0] += self._gap
        return place

    def _by_zone(self, each: np.ndarray, weight) -> np.ndarray:
        """(n, zones) weighted sums over the contacts outside the surroundings of the nuggets."""
        own = np.eye(len(self._scene.zones))[self._rows.zone]
        return each @ (own * (weight * self._rows.outside)[:, None])

    def _advance(self, value: np.ndarray, load: np.ndarray, start: np.ndarray | None = None) -> None:
        """Move to new values of the held rows and new loads, and solve the contact problem in each increment.

        `start` (n, m, 3) replaces the present contact-free positions of the faces.
        """
        b0 = self._faces(self._supports.displacements(self._load, self._value)) if start is None else start
        b1 = self._faces(self._supports.displacements(load, value))
        if self._problem is None:
            own = self._contact[self._active].ravel()
            self._problem = _ContactProblem(self._supports.compliance(own), self._mu[self._active], self._solver)
        own = self._active
        force, place = self._force[:, own], self._place[:, own]
        for s in np.arange(1, self._increments + 1) / self._increments:
            b = (b0 + s * (b1 - b0))[:, own]
            b[:, :, 1:] -= place[:, :, 1:]
            force, moved = self._problem.solve(b, force)
            moved[:, :, 1:] += place[:, :, 1:]
            place = moved
        self._force[:, own] = force
        self._value, self._load, self._moved = value, load, True
        self._y = self._supports.displacements(self._with_contact_forces(load), value)
        self._place = self._faces(self._y)


class _ContactProblem:
    """Contact problems ``u = S f + b``, solved for a working set of contacts.

    The working set holds the contacts that would penetrate without force.

    Parameters
    ----------
    S : (3 m, 3 m) array
    mu : (m,) array
    solver : callable
        As in :func:`process`.
    """

    def __init__(self, S: np.ndarray, mu: np.ndarray, solver: Callable):
        self._S, self._mu, self._new = S, mu, solver
        self._working = np.zeros(len(mu), bool)

    def solve(self, b: np.ndarray, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces and displacements (n, m, 3).

        Raises
        ------
        ValueError
            If a problem did not converge.
        """
        n, force, moved = len(b), np.zeros_like(b), b.copy()
        missed = ((guess[:, :, 0] > 0).any(axis=0) if guess.any() else (b[:, :, 0] < 0).any(axis=0)) & ~self._working
        while missed.any() or self._working.any():
            if missed.any():
                self._working |= missed
                rows = np.repeat(self._working, 3)
                self._solver = self._new(self._S[np.ix_(rows, rows)], self._mu[self._working])
                self._coupling = self._S[np.ix_(rows, ~rows)]
            own = self._working
            solution = self._solver.solve(b[:, own].reshape(n, -1), guess[:, own].reshape(n, -1))
            if not solution.converged.all():
                raise ValueError("a contact problem of the solids did not converge")
            force[:, own] = solution.force.reshape(n, -1, 3)
            moved[:, own] = solution.displacement.reshape(n, -1, 3)
            moved[:, ~own] = b[:, ~own] + (solution.force @ self._coupling).reshape(n, -1, 3)
            missed = (moved[:, :, 0] < 0).any(axis=0) & ~own
            if not missed.any():
                break
        return force, moved


def _opposed(one, other) -> bool:
    """Whether two clamps press two parts together at one place."""
    push, place = np.array(one.direction), np.array(other.point) - one.point
    sideways = np.linalg.norm(place - (place @ push) * push)
    pushes = one.force is not None and other.force is not None
    return pushes and one.part != other.part and push @ other.direction < 0 and sideways < max(one.radius, other.radius)
