"""A scene's whole process by sheets of solids: no shells, influence coefficients, patches or candidates.

CalculiX gives the stiffness of the sheets (:mod:`fem_reference.peers.calculix_sheets`). Every node of a face touches
what it lies before on the other sheet, or a fixture's pad, with friction. Locators hold means over discs of the
middle surface; clamps push or hold discs of the faces that they press on. A nugget is one piece: all nodes within its
disc keep, from the weld on, how they stand to the other sheet, or close their gaps, and none of them touches any
more. A deviation of shape opens and closes the gaps; a part of such a shape is held on the locators that it is set
down on while the force that makes it acts.

With the rows R of all that is held, pushed, touched or read, and springs α on the rows D that parts are set down on,

    F = R (K + α Dᵀ D)⁻¹ Rᵀ,        y = F λ,

λ the forces on the rows. A row of D that holds nothing has its spring taken away by λ = α y, so that K is factorised
once for all stages. What touches obeys Coulomb's law, in increments each of which goes on where the one before left the
faces.

The process is gone through here anew, from the scene's tables alone: the parts are set down; what overlaps comes to
rest; further locators close together, clamps one by one, two that press sheets together at one place as one; welds
freeze or close their gaps; what closed last opens first; key characteristics are read.
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

FAR = 0.5  # of a sheet: what lies farther before a face does not touch it
EDGE = 1e-9  # mm: what lies so far beside a box lies in it
KINDS = ("locate", "clamp", "weld", "release", "measure")  # of stages, in the order in which they are gone through


@dataclass(frozen=True)
class Outcome:
    """What the process gave at n deviations.

    Attributes
    ----------
    stages : list of str
        Those in which something moves that may touch.
    measurements : (n, k) array
        mm.
    force : (n, stages, zones) array
        Sum of a zone's normal forces at the end of a stage, beyond some radii of the nuggets, N.
    slip : (n, stages, zones) array
        Root mean square, over the same area, of what the faces moved along each other in the stage, mm.
    contacts : int
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
    """The whole process of a scene at deviations (n, p), in the scene's order.

    Parameters
    ----------
    scene : Scene
        Of locators, clamps without limits, fused welds, pads, and deviations of forces, locators and clamps, in one
        station.
    sheets : sequence of Sheet
        In the order of its parts.
    deviations : (n, p) array
    solver : callable
        ``solver(S, mu)`` prepares problems ``u = S f + b`` of a law of contact: :class:`mic.contact.ContactSolver`.
    increments : int
        Of each step.
    beyond : float
        Radii of a nugget nearer to which forces and slip are not read: sums of nodal forces do not settle there.
    deviated : bool
        Whether sheets have the stiffness of their deviated shape in place of the nominal one.

    Raises
    ------
    CalculixError
    ValueError
        If the scene has what is not gone through here, or the contact problem of an increment was not solved.
    """
    _plain(scene)
    deviations = np.atleast_2d(deviations)
    rows = _Rows(scene, sheets, beyond)
    F, factors = rows.flexibility([sheet.K for sheet in sheets])
    nothing = np.zeros(len(F))
    shaping = deviations @ [rows.shape(F, one.name) if one.kind == "force" else nothing for one in scene.deviations]
    shape = shaping @ F
    if not deviated:
        return _Process(rows, F, solver, increments).run(deviations, shape)
    found = []
    for k, forces in enumerate(shaping):
        K = [
            sheet.deviated(factor.solve((own.T @ forces)[:, None])[:, 0])
            for sheet, factor, own in zip(sheets, factors, rows.parts)
        ]
        one = _Process(rows, rows.flexibility(K)[0], solver, increments).run(deviations[[k]], shape[[k]])
        found.append(one)
    every = (np.concatenate([getattr(one, key) for one in found]) for key in ("measurements", "force", "slip"))
    return Outcome(found[0].stages, *every, found[0].contacts)


def _plain(scene: Scene) -> None:
    """Whether the scene is one that is gone through here."""
    kinds = [stage.kind for stage in scene.stages]
    extra = [
        *(f"stage {one.name}: order or sequence" for one in scene.stages if one.order or one.sequence),
        *(f"locator {one.name}: a stiffness" for one in scene.locators if one.stiffness is not None),
        *(f"clamp {one.name}: a limit or two parts" for one in scene.clamps if one.limit is not None or one.parts),
        *(f"weld {one.name}: not fused, or a gun" for one in scene.welds if not one.fused or one.gun is not None),
        *(
            f"deviation {one.name}: {one.kind}"
            for one in scene.deviations
            if one.kind not in ("force", "locator", "clamp")
        ),
        *(f"measurement {one.name}: {one.kind}" for one in scene.measurements if one.kind != "point"),
    ]
    if kinds != sorted(kinds, key=KINDS.index) or kinds.count("locate") != 1:
        extra.append("stages: another order than " + ", ".join(KINDS))
    if extra:
        raise ValueError("solids do not go through " + "; ".join(extra))


class _Rows:
    """What is held, pushed, touched or read of the sheets of a scene.

    Attributes
    ----------
    parts : list of (r, d) csr_matrix
        Of each sheet: three rows of each contact, n, t1, t2, second body less first; then those of the names in `of`.
    of : dict of str to int
        Rows of locators, clamps, forces that make shapes and measurements.
    datum : (6 p,) int array
        Rows that the parts are set down on.
    zone, weld : (m,) int array
        Of each contact; -1 for no weld.
    gap, area : (m,) array
        Between the faces as drawn, mm; of the cell about the node that touches, mm².
    outside : (m,) bool array
        Whether it lies beyond the radii of every nugget.
    """

    def __init__(self, scene: Scene, sheets: Sequence[Sheet], beyond: float):
        self.scene, self._sheets, self._beyond = scene, {p.name: s for p, s in zip(scene.parts, sheets)}, beyond
        zones = [self._touching(zone) for zone in scene.zones]
        self.zone = np.repeat(np.arange(len(zones)), [len(one["gap"]) for one in zones])
        self.gap, self.area, self.weld, self.outside = (
            np.concatenate([one[key] for one in zones]) for key in ("gap", "area", "weld", "outside")
        )
        forces = [one for one in scene.deviations if one.kind == "force"]
        discs = [*scene.locators, *scene.clamps, *forces, *scene.measurements]
        self.of = {one.name: 3 * len(self.zone) + i for i, one in enumerate(discs)}
        set_down = {one.name for one in scene.locators if one.stage == scene.stages[0].name}
        self.datum = np.array([self.of[name] for name in self.of if name in set_down])
        pressed = {one.name for one in scene.clamps}
        self.parts = []
        for name, sheet in self._sheets.items():
            none = csr_matrix((1, sheet.K.shape[0]))
            own = [self._disc(sheet, one, one.name in pressed) if one.part == name else none for one in discs]
            self.parts.append(csr_matrix(vstack([*(one[name] for one in zones), *own])))

    def flexibility(self, stiffness: Sequence) -> tuple[np.ndarray, list[Factorisation]]:
        """F (r, r), and the factors of each sheet's K + α Dᵀ D."""
        self.spring = float(np.mean([np.abs(K.diagonal()).mean() for K in stiffness]))
        F = np.zeros((self.parts[0].shape[0],) * 2)
        factors = []
        for K, rows in zip(stiffness, self.parts):
            D = rows[self.datum]
            read = np.flatnonzero(np.diff(rows.indptr))
            factors.append(Factorisation(csr_matrix(K + self.spring * (D.T @ D)), rows[read]))
            F[np.ix_(read, read)] += factors[-1].influence
        return F, factors

    def shape(self, F: np.ndarray, name: str) -> np.ndarray:
        """(r,) forces on the rows that make the shape of a unit force, its part held where it is set down."""
        forces = np.zeros(len(F))
        forces[self.of[name]] = 1.0
        held = _Held(F, self.spring, self.datum, self.datum)
        forces[self.datum] += held.reaction(forces[None], np.zeros((1, len(self.datum))))[0]
        return forces

    @staticmethod
    def _disc(sheet: Sheet, one, pressed: bool) -> csr_matrix:
        layer = sheet.face(one.point, -np.array(one.direction)) if pressed else sheet.middle
        return sheet.mean(layer, one.point, one.radius, one.direction)

    def _touching(self, zone) -> dict:
        """Rows of each part, and gap, area, weld and outside of each contact of a zone."""
        pads = {one.name: one for one in self.scene.fixtures}
        pad = next((pads[name] for name in zone.parts if name in pads), None)
        hit, normals, gap, faces = self._before_sheet(zone) if pad is None else self._before_pad(zone, pad)
        if not len(hit):
            raise ValueError(f"nothing touches in the zone {zone.name}")
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

    def _before_pad(self, zone, pad) -> tuple:
        """Nodes of the sheet that lie before a pad, its normals there, gaps, and what reads the sheet's face."""
        (name,) = set(zone.parts) - {pad.name}
        sheet, normal = self._sheets[name], np.array(pad.normal)
        layer = sheet.face(pad.point, -normal)
        hit = np.flatnonzero(sheet.within(layer, pad.point, pad.radius) & _inside(zone, sheet.at(layer)))
        gap = (sheet.at(layer)[hit] - pad.point) @ normal
        return hit, np.tile(normal, (len(hit), 1)), gap, [(name, layer, _picked(hit, len(sheet.points)))]

    def _before_sheet(self, zone) -> tuple:
        """Nodes of the second sheet that lie before the first, its normals there, gaps, and what reads either face."""
        none = np.empty(0, int), np.empty((0, 3)), np.empty(0), []
        first, second = (self._sheets[name] for name in zone.parts)
        near, _, normals, height = first.onto(first.middle, second.points)
        some = np.flatnonzero(
            (np.abs(height) < first.thickness + second.thickness) & _inside(zone, second.points[near])
        )
        if not len(some):
            return none
        place, side = second.points[near[some[0]]], np.sign(height[some[0]]) * normals[some[0]]
        above, below = second.face(place, -side), first.face(place, side)
        hit, weights, normals, gap = first.onto(below, second.at(above))
        outwards = 1.0 if below else -1.0
        normals, gap = outwards * normals, outwards * gap
        keep = _inside(zone, second.at(above)[hit]) & (np.abs(gap) <= FAR * second.thickness)
        own = [(zone.parts[0], below, -weights[keep]), (zone.parts[1], above, _picked(hit[keep], len(second.points)))]
        return hit[keep], normals[keep], gap[keep], own


def _inside(zone, places: np.ndarray) -> np.ndarray:
    """(m,) which places lie in a zone's box, if it has one."""
    if zone.box is None:
        return np.ones(len(places), bool)
    low, high = np.array(zone.box)
    return ((places >= low - EDGE) & (places <= high + EDGE)).all(axis=1)


def _picked(nodes: np.ndarray, n: int) -> csr_matrix:
    return csr_matrix((np.ones(len(nodes)), (np.arange(len(nodes)), nodes)), (len(nodes), n))


def _along(sheet: Sheet, layer: int, weights: csr_matrix, normals: np.ndarray) -> csr_matrix:
    """(3 m, d) rows of what is read along normals and two directions across them."""
    axis = np.eye(3)[(np.abs(normals) > 0.9)[:, 0].astype(int)]  # x, or y where the normal is nearly x
    first = axis - np.einsum("rd,rd->r", axis, normals)[:, None] * normals
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    every = vstack([sheet.rows(layer, weights, each) for each in (normals, first, np.cross(normals, first))])
    return csr_matrix(every)[np.arange(3 * len(normals)).reshape(3, -1).T.ravel()]


class _Held:
    """Displacements of the rows while some of them are held: y = F p, those of the others free.

    Parameters
    ----------
    F : (r, r) array
    spring : float
    datum, held : int arrays
        Rows that have springs, and that are held.
    """

    def __init__(self, F: np.ndarray, spring: float, datum: np.ndarray, held: np.ndarray):
        loose = np.setdiff1d(datum, held)
        self._F, self._rows, self._held = F, np.concatenate([held, loose]).astype(int), len(held)
        self._spring = np.where(np.isin(held, datum), spring, 0.0)
        among = F[np.ix_(self._rows, self._rows)].copy()
        last = np.arange(len(held), len(self._rows))
        among[last, last] -= 1 / spring
        self._reach = np.linalg.solve(among, F[self._rows])
        self._values = np.linalg.inv(among)[:, : len(held)]

    def compliance(self, touch: np.ndarray) -> np.ndarray:
        """(t, t) of rows."""
        S = self._F[np.ix_(touch, touch)] - self._F[np.ix_(touch, self._rows)] @ self._reach[:, touch]
        return 0.5 * (S + S.T)

    def _forces(self, load: np.ndarray, value: np.ndarray) -> np.ndarray:
        return value @ self._values.T - load @ self._reach.T

    def read(self, load: np.ndarray, value: np.ndarray) -> np.ndarray:
        """(n, r) of the rows under loads (n, r), the held ones at values (n, h)."""
        forces = load.copy()
        forces[:, self._rows] += self._forces(load, value)
        return forces @ self._F

    def reaction(self, load: np.ndarray, value: np.ndarray) -> np.ndarray:
        """(n, h) forces on the held rows."""
        return self._forces(load, value)[:, : self._held] - self._spring * value


class _Process:
    """The stages, one after the other, at n deviations together."""

    def __init__(self, rows: _Rows, F: np.ndarray, solver: Callable, increments: int):
        self._rows, self._scene, self._F = rows, rows.scene, F
        self._solver, self._increments = solver, increments
        self._mu = np.array([zone.friction for zone in self._scene.zones])[rows.zone]
        self._contact = np.arange(3 * len(rows.zone)).reshape(-1, 3)
        self._stroke = np.zeros(len(F))
        for one in self._scene.clamps:
            self._stroke[rows.of[one.name]] = one.stroke or 0.0

    def run(self, deviations: np.ndarray, shape: np.ndarray) -> Outcome:
        """All stages, with shapes as the rows read them (n, r)."""
        rows, scene = self._rows, self._scene
        self._set_down(deviations, shape)
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

    def _set_down(self, deviations: np.ndarray, shape: np.ndarray) -> None:
        """On the first locators; nothing touches yet."""
        rows, n = self._rows, len(deviations)
        self._shape, self._asked = shape, np.zeros((n, len(self._F)))
        for amplitude, one in zip(deviations.T, self._scene.deviations):
            if one.kind != "force":
                self._asked[:, rows.of[one.target]] += amplitude
        self._gap = rows.gap + shape[:, self._contact[:, 0]]
        self._load, self._force = np.zeros_like(shape), np.zeros((n, *self._contact.shape))
        self._apart, self._settled = np.ones(len(rows.zone), bool), False
        self._hold, self._value = rows.datum, self._target(rows.datum)
        self._closed = [list(rows.datum)]
        self._held, self._solving = self._elimination(), None
        self._y = self._held.read(self._load, self._value)
        self._place = self._faces(self._y)

    def _clamp(self, stage) -> None:
        """What overlaps comes to rest, once; further locators close together, clamps one by one."""
        scene, of = self._scene, self._rows.of
        if not self._settled:
            clear = self._place.copy()
            clear[:, :, 0] = np.maximum(clear[:, :, 0], 0.0)
            self._go(self._value, self._load, clear)
            self._settled = True
        locators = [of[one.name] for one in scene.locators if one.stage == stage.name]
        pushes = {of[one.name]: one.force for one in scene.clamps if one.force is not None}
        for group in [locators, *self._clamps(stage)]:
            if group:
                hold = [row for row in group if row not in pushes]
                load = self._load.copy()
                for row in set(group) & set(pushes):
                    load[:, row] = pushes[row] + self._asked[:, row]
                self._close(hold, self._y[:, hold], self._target(hold), load)
                self._closed.append(group)

    def _clamps(self, stage) -> list[list[int]]:
        """Rows of the clamps that close together."""
        groups: list[list] = []
        for one in self._scene.clamps:
            if one.stage == stage.name:
                if groups and _opposed(groups[-1][-1], one):
                    groups[-1].append(one)
                else:
                    groups.append([one])
        return [[self._rows.of[one.name] for one in group] for group in groups]

    def _weld(self, stage) -> None:
        """Nuggets keep what they find, or close their gaps; none of their nodes touches any more."""
        own = [i for i, one in enumerate(self._scene.welds) if one.stage == stage.name]
        fused = np.flatnonzero(np.isin(self._rows.weld, own))
        ties = self._contact[fused]
        found = self._y[:, ties]
        value = found.copy()
        closing = [i for i in own if self._scene.welds[i].close]
        for i in closing:
            at = self._rows.weld[fused] == i
            value[:, at, 0] -= found[:, at, 0] + self._gap[:, fused[at]]  # at every node: electrodes press flush
        self._apart[fused], self._force[:, fused] = False, 0.0
        start, end = (each.reshape(len(each), -1) for each in (found, value))
        if closing:
            self._close(ties.ravel(), start, end, self._load)
        else:
            self._hold_also(ties.ravel(), start)

    def _release(self, stage) -> None:
        """What closed last opens first, but what is kept: its forces fade."""
        kept = {self._rows.of[name] for name in stage.keep or ()}
        for group in reversed(self._closed):
            gone = [row for row in group if row not in kept]
            if not gone:
                continue
            stays = ~np.isin(self._hold, gone)
            reaction = self._held.reaction(self._pushed(self._load), self._value)
            after, self._load = self._load.copy(), self._load.copy()
            self._load[:, self._hold[~stays]] += reaction[:, ~stays]
            after[:, gone] = 0.0
            self._hold, self._value = self._hold[stays], self._value[:, stays]
            self._held, self._solving = self._elimination(), None
            self._go(self._value, after)

    def _measure(self, stage) -> None:
        """Key characteristics are read of what there is."""

    def _target(self, rows) -> np.ndarray:
        """(n, rows) displacements that bring rows to their positions."""
        return (self._stroke + self._asked - self._shape)[:, rows]

    def _hold_also(self, rows, value: np.ndarray) -> None:
        """Hold further rows where they are, at values (n, rows)."""
        self._hold = np.append(self._hold, np.asarray(rows, int))
        self._value = np.hstack([self._value, value])
        self._held, self._solving = self._elimination(), None

    def _close(self, rows, start: np.ndarray, end: np.ndarray, load: np.ndarray) -> None:
        """Hold further rows, which go from start to end (n, rows) while loads grow."""
        before = self._value
        if len(rows):
            self._hold_also(rows, start)
        self._go(np.hstack([before, end]), load)

    def _elimination(self) -> _Held:
        return _Held(self._F, self._rows.spring, self._rows.datum, self._hold)

    def _pushed(self, load: np.ndarray) -> np.ndarray:
        """Loads with what the faces press."""
        every = load.copy()
        every[:, self._contact.ravel()] += self._force.reshape(len(load), -1)
        return every

    def _faces(self, y: np.ndarray) -> np.ndarray:
        """(n, m, 3) where the second body's faces stand to the first's."""
        place = y[:, self._contact]
        place[:, :, 0] += self._gap
        return place

    def _by_zone(self, each: np.ndarray, weight) -> np.ndarray:
        """(n, zones) sums beyond the nuggets."""
        own = np.eye(len(self._scene.zones))[self._rows.zone]
        return each @ (own * (weight * self._rows.outside)[:, None])

    def _go(self, value: np.ndarray, load: np.ndarray, clear: np.ndarray | None = None) -> None:
        """To values of the held rows and to loads, by increments each of which obeys the law; from `clear` (n, m, 3) in
        place of where the faces would stand without contact."""
        b0 = self._faces(self._held.read(self._load, self._value)) if clear is None else clear
        b1 = self._faces(self._held.read(load, value))
        if self._solving is None:
            own = self._contact[self._apart].ravel()
            self._solving = _Touching(self._held.compliance(own), self._mu[self._apart], self._solver)
        own = self._apart
        force, place = self._force[:, own], self._place[:, own]
        for s in np.arange(1, self._increments + 1) / self._increments:
            b = (b0 + s * (b1 - b0))[:, own]
            b[:, :, 1:] -= place[:, :, 1:]
            force, moved = self._solving.solve(b, force)
            moved[:, :, 1:] += place[:, :, 1:]
            place = moved
        self._force[:, own] = force
        self._value, self._load, self._moved = value, load, True
        self._y = self._held.read(self._pushed(load), value)
        self._place = self._faces(self._y)


class _Touching:
    """Contact problems ``u = S f + b``, of which those contacts are solved for that would penetrate without force.

    Parameters
    ----------
    S : (3 m, 3 m) array
    mu : (m,) array
    solver : callable
        As :func:`process` has it.
    """

    def __init__(self, S: np.ndarray, mu: np.ndarray, solver: Callable):
        self._S, self._mu, self._new = S, mu, solver
        self._among = np.zeros(len(mu), bool)

    def solve(self, b: np.ndarray, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces and displacements (n, m, 3).

        Raises
        ------
        ValueError
            If one was not solved.
        """
        n, force, moved = len(b), np.zeros_like(b), b.copy()
        missed = ((guess[:, :, 0] > 0).any(axis=0) if guess.any() else (b[:, :, 0] < 0).any(axis=0)) & ~self._among
        while missed.any() or self._among.any():
            if missed.any():
                self._among |= missed
                rows = np.repeat(self._among, 3)
                self._solver = self._new(self._S[np.ix_(rows, rows)], self._mu[self._among])
                self._beside = self._S[np.ix_(rows, ~rows)]
            own = self._among
            solution = self._solver.solve(b[:, own].reshape(n, -1), guess[:, own].reshape(n, -1))
            if not solution.converged.all():
                raise ValueError("a contact problem of the solids was not solved")
            force[:, own] = solution.force.reshape(n, -1, 3)
            moved[:, own] = solution.displacement.reshape(n, -1, 3)
            moved[:, ~own] = b[:, ~own] + (solution.force @ self._beside).reshape(n, -1, 3)
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
