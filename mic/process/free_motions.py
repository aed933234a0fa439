"""Motions that a step leaves free, from the scene alone: rigid parts on the points and directions of their supports.

A locator, or a clamp that holds a position, at x along d reads ``d · (q + φ × (x - c))`` of a part's rigid motion
(q, φ) about c. A weld reads both parts' motions at its point, second minus first: translations first, then rotations if
it carries moment. Motions of a part that `rests`, and of parts welded to it, that these rows leave free can be held by
contact alone, if a zone joins it to a body that does not move along.

The pairs show whether contact can hold the part, before anything is factorised. With N the motions that the rows leave
free,

- every motion of N must change the reading of some pair along its normal or, with friction, its tangents;
- forces of the pairs within their friction, together with those of the rows, balance the clamps' forces;
- some of them press on each part that rests, or on a part welded to it, at the end of a stage.

Friction cones are widened to pyramids here, so that no part is refused that contact may hold.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.sparse import csr_matrix, diags, hstack, identity, kron

from mic.compliance.support import completing_rows
from mic.contact.laws import LAWS
from mic.errors import FreeMotion, SceneError
from mic.model.rows import Joints
from mic.process.actions import Placement

__all__ = ["check_resting", "free_motion_error", "with_resting_parts", "describe_direction"]

SHARE = 1e-6  # of a motion: parts that take less part in it do not move
PRESSED = 1e-6  # of the largest force: smaller contact forces count as zero
INFEASIBLE = 2  # status of scipy.optimize.linprog
ROUGH = 10.0  # coefficient assumed where friction depends on pressure: larger than any real one
AXIS = 0.05  # of a direction: with a smaller component across an axis it counts as along it


def with_resting_parts(scene, joints: Joints, plan):
    """A stage's plan, with the parts that rest by contact alone in each of its steps.

    Parameters
    ----------
    scene : mic.scene.Scene
    joints : Joints
    plan : mic.process.plan.StagePlan

    Returns
    -------
    mic.process.plan.StagePlan

    Raises
    ------
    SceneError
        If neither rows nor zones hold a part: names the stage, what opens in it, the part and the remedy.
    """
    bodies, may_rest = _RigidParts(scene), [part.name for part in scene.parts if part.rests]
    steps = []
    for step in plan.steps:
        held = bodies.held(joints, step.bilateral)
        try:
            completing_rows(held, np.zeros((0, held.shape[1])), bodies.size)
            resting: tuple[int, ...] = ()
        except FreeMotion as error:
            resting = bodies.moving_parts(error.motions)
            # New parts do not touch anything yet, but will.
            placed = any(isinstance(action, Placement) for action in step.move)
            zones = [zone for i, zone in enumerate(scene.zones) if placed or i not in step.away]
            try:
                completing_rows(held, bodies.all_motions(may_rest), bodies.size)
                completing_rows(held, bodies.relative_motions(zones), bodies.size)
            except FreeMotion as unheld:
                free_parts = [p for p in bodies.moving_parts(unheld.motions) if p not in step.parked]
                if free_parts:
                    raise free_motion_error(scene, plan, step, unheld, bodies.most(unheld.motions)) from unheld
        steps.append(replace(step, resting=resting, parked=tuple(p for p in step.parked if p in resting)))
    return replace(plan, steps=tuple(steps))


def free_motion_error(scene, plan, step, error: FreeMotion, part: int) -> SceneError:
    """The error of a step that leaves a part free."""
    opened = [getattr(scene, f"{kind}s")[i].name for kind, i in step.released if kind != "weld"]
    cause = f" once {', '.join(opened[:4])}{' …' * (len(opened) > 4)} opened" if opened else ""
    contact = (
        "it rests, but no zones lead from it to a fixture, or to a part that locators hold: add one"
        if scene.parts[part].rests
        else "where contact is to hold it, give it rests = true and a zone"
    )
    return SceneError(
        f"stages ({plan.name}): {error}{cause}, mostly of part {scene.parts[part].name!r}; keep more locators in "
        f"this stage, or join the part by welds with moment; {contact}"
    )


def check_resting(assembly, plans: Sequence, laws: Iterable[str]) -> None:
    """Check that contact can hold the resting parts, under each of the laws.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly or mic.model.reduction.Reduction
    plans : sequence of mic.process.plan.StagePlan
    laws : iterable of str

    Raises
    ------
    SceneError
        Names the stage, the part, the direction and the remedy.
    """
    if not any(step.resting for plan in plans for step in plan.steps):
        return
    bodies, joints = _RigidParts(assembly.scene), assembly.joints
    for law in laws:
        for plan in plans:
            resolved = [step for step in plan.steps if step.resolves]
            for step in resolved:
                parts = [p for p in step.resting if p not in step.parked]
                if parts:
                    last = step is resolved[-1] and plan.kind != "locate"
                    _check_step(assembly, bodies, joints, plan, step, parts, LAWS[law], last)


def _check_step(assembly, bodies, joints, plan, step, parts, law, last) -> None:
    scene, contacts = assembly.scene, assembly.contacts
    normal, tangents, mu = bodies.contacts(contacts, plan.name, law)
    active = ~contacts.excluded(step.nuggets, step.away)
    normal, tangents, mu = normal[active], tangents[active], mu[active]
    held = bodies.held(joints, step.bilateral)
    without = f" without friction (law {law.name})" if not law.frictional else ""
    remedy = "give it locators, or a weld, there"
    if contacts.frictional:
        remedy += "" if law.frictional else f', or take "{law.name}" out of report.laws'
    else:
        remedy += ", or its zone friction"
    if last:
        rough = tangents[mu > 0].reshape(-1, held.shape[1])
        try:
            completing_rows(held, np.concatenate([normal, rough]), bodies.size)
        except FreeMotion as error:
            p = bodies.most(error.motions)
            raise SceneError(
                f"stages ({plan.name}): part {scene.parts[p].name!r} rests by contact alone{without}, and nothing "
                f"holds it {bodies.describe_motions(p, error.motions)}; {remedy}"
            ) from error
    bounds, pushing = _loads(assembly, bodies, joints, step)
    balanced = partial(_balanced, held, (normal, tangents[:, 0], tangents[:, 1]), mu, bounds, pushing, bodies.size)
    if balanced(np.zeros(len(normal))) is None:
        names = ", ".join(repr(scene.parts[p].name) for p in parts)
        raise SceneError(
            f"stages ({plan.name}): contact alone holds {names}{without}, and no forces of it balance the clamps; "
            f"press where the part lies on something, or {remedy}"
        )
    for p in parts if last else ():
        together = sum(normal[:, 6 * q : 6 * q + 6] for q in bodies.welded(p, step.welds))
        touching = np.abs(together).max(axis=1, initial=0.0) > 0  # contacts within the welded group cancel
        if not balanced(touching.astype(float)):
            raise SceneError(
                f"stages ({plan.name}): part {scene.parts[p].name!r} rests by contact alone{without}, and nothing "
                "presses it there: it lies loose; close a clamp that presses it on, or give it six locators"
            )


def _loads(assembly, bodies, joints: Joints, step):
    """Bounds (l, 2) of the forces of clamps, guns and weights, N, and the motions (l, 6P) along which they push.

    A limited clamp has any force up to its limit. Guns have no bounds, since a gun and the weld that it presses have
    the same rows.
    """
    scene = assembly.scene
    varied = {name for one in scene.deviations if one.kind == "clamp" for name in np.atleast_1d(one.target)}
    bounds: list[tuple[float, float]] = []
    motions: list[np.ndarray] = []
    for i in step.loads:
        if i >= len(scene.clamps):
            force, motion = _weight(assembly, bodies, i)
        else:
            force, motion = scene.clamps[i].force, bodies.held(joints, [("clamp", i)])[0]
        # zero on average, of either sign in a sample
        any_force = i < len(scene.clamps) and scene.clamps[i].name in varied and not force
        bounds.append((-np.inf, np.inf) if any_force else (force, force))
        motions.append(motion)
    for limit in step.stops:
        kind, row = limit.row
        rows = 3 if kind == "weld" else 1
        own = (-np.inf, np.inf) if kind == "weld" else (min(0.0, limit.load), max(0.0, limit.load))
        bounds += [own] * rows
        motions += [*bodies.held(joints, [(kind, row + axis) for axis in range(rows)])]
    return np.array(bounds).reshape(-1, 2), np.array(motions).reshape(-1, len(bodies.size))


def _weight(assembly, bodies, row: int) -> tuple[float, np.ndarray]:
    """A part's weight, N, and the motion (6P,) along which it pulls, from the clamp row of its gravity source."""
    scene, entry = assembly.scene, assembly.rows["clamp"][row].tocoo()
    sources = [one for one in scene.deviations if one.kind == "gravity"]
    number, part = divmod(row - len(scene.clamps), len(scene.parts))
    motion = bodies.centre_reading(assembly, scene.parts[part].name, sources[number].direction)
    return sources[number].mean * float(entry.data.sum()), motion


def _balanced(held, pairs, mu, bounds, pushing, size, pressed) -> bool | None:
    """Whether balanced forces can press on the `pressed` (m,) contacts; None if no forces balance the loads.

    Unknowns are the forces of the contacts, normals first, then both tangents, those of the rows held, and the loads.
    """
    from scipy.optimize import linprog  # slow to import, and only resting parts need it

    m, others = len(mu), len(held) + len(bounds)
    scale = np.abs(bounds[np.isfinite(bounds)]).max(initial=0.0) or 1.0
    balance = hstack([*(csr_matrix(rows).T for rows in (*pairs, held, pushing))], format="csr")
    balance = diags(1 / np.where(np.arange(len(size)) % 6 < 3, 1.0, size)) @ balance
    signs = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])  # of both tangents, for each side of a pyramid
    cone = kron(np.ones((4, 1)), -diags(mu))
    within = hstack([cone, kron(signs, identity(m)), csr_matrix((4 * m, others))], format="csr")
    limits = [(0.0, 1e3)] * m + [(None, None)] * (2 * m + len(held)) + [*map(tuple, bounds / scale)]
    aim = np.concatenate([-pressed, np.zeros(2 * m + others)])
    solved = linprog(
        aim, within, np.zeros(within.shape[0]), balance, np.zeros(balance.shape[0]), limits, method="highs"
    )
    if solved.status == INFEASIBLE:
        return None
    return solved.x is None or bool(pressed @ solved.x[:m] > PRESSED)


def describe_direction(direction: np.ndarray) -> str:
    """A direction in words: an axis, or a vector."""
    unit = direction / np.linalg.norm(direction)
    for axis, name in zip(np.eye(3), "xyz"):
        if np.linalg.norm(np.cross(unit, axis)) < AXIS:
            return f"along {name}"
    return f"along [{', '.join(f'{one:.2g}' for one in unit)}]"


class _RigidParts:
    """The rigid motions of a scene's parts, six each: three translations, three rotations about a common point."""

    def __init__(self, scene):
        points = [item.point for table in (scene.locators, scene.clamps, scene.welds) for item in table]
        points = np.array(points, dtype=float).reshape(-1, 3)
        self.scene = scene
        self.number = {part.name: i for i, part in enumerate(scene.parts)}
        self.centre = points.mean(axis=0) if len(points) else np.zeros(3)
        arm = max(1.0, float(np.ptp(points, axis=0).max()) / 2) if len(points) else 1.0
        self.size = np.tile([1.0, 1.0, 1.0, arm, arm, arm], len(self.number))

    def held(self, joints: Joints, rows) -> np.ndarray:
        """(b, 6P) readings of the rows."""
        reading, first = np.zeros((len(rows), len(self.size))), joints.first
        for line, (kind, row) in zip(reading, rows):
            if kind == "weld":
                number = int(np.searchsorted(first, row, side="right")) - 1
                weld, axis = self.scene.welds[number], row - int(first[number])
                unit = np.eye(3)[axis % 3]  # a translation at the weld, or a rotation
                read = self._reading(weld.point, unit) if axis < 3 else np.array([0.0, 0.0, 0.0, *unit])
                line[:] = self._relative(weld.parts, read)
            else:
                item = getattr(self.scene, f"{kind}s")[row]
                line[self._columns(item.part)] = self._reading(item.point, item.direction)
        return reading

    def centre_reading(self, assembly, part: str, direction) -> np.ndarray:
        """(6P,) reading of a part's centre along a direction, for an assembly or its reduction."""
        reading = np.zeros(len(self.size))
        reading[self._columns(part)] = self._reading(assembly.centres[self.number[part]], direction)
        return reading

    def all_motions(self, parts) -> np.ndarray:
        """(6 p, 6P) all motions of some parts."""
        unit = np.eye(len(self.size)).reshape(-1, 6, len(self.size))
        return unit[[self.number[part] for part in parts]].reshape(-1, len(self.size))

    def relative_motions(self, zones) -> np.ndarray:
        """(6 z, 6P) all relative motions of bodies that zones join; fixtures do not move."""
        lines = [self._relative(zone.parts, np.eye(6)) for zone in zones]
        return np.concatenate([np.zeros((0, len(self.size))), *lines])

    def contacts(self, contacts, stage: str, law) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(m, 6P) and (m, 2, 6P) readings of pairs along normals and tangents, and their friction (m,)."""
        reading, mu = np.zeros((len(contacts), 3, len(self.size))), np.zeros(len(contacts))
        for k, zone in enumerate(contacts.zone):
            along = self._reading(contacts.point[k], contacts.frame[k].T)
            reading[k] = self._relative(self.scene.zones[zone].parts, along)
        if law.frictional:
            friction = contacts.friction_in(stage)
            mu = friction.coefficient.copy()
            if friction.pressure is not None:
                mu[[self.scene.zones[zone].pressure_pieces() is not None for zone in contacts.zone]] = ROUGH
        return reading[:, 0], reading[:, 1:], mu

    def welded(self, part: int, welds: Iterable[int]) -> set[int]:
        """A part, and all parts that welds join to it."""
        pairs = [{self.number[name] for name in self.scene.welds[i].parts} for i in welds]
        found = {part}
        while any(pair & found and not pair <= found for pair in pairs):
            found = found.union(*(pair for pair in pairs if pair & found))
        return found

    def moving_parts(self, motions: np.ndarray) -> tuple[int, ...]:
        """Parts that take part in motions (6P, k)."""
        share = np.linalg.norm((motions * self.size[:, None]).reshape(len(self.number), -1), axis=1)
        return tuple(int(p) for p in np.flatnonzero(share > SHARE * share.max()))

    def most(self, motions: np.ndarray) -> int:
        """The part that moves most."""
        return int(np.argmax(np.linalg.norm(motions.reshape(len(self.number), -1), axis=1)))

    def describe_motions(self, part: int, motions: np.ndarray) -> str:
        """The free motions of a part in words: axes along and about which it moves, or the direction of one motion."""
        own = motions[6 * part : 6 * part + 6] * self.size[6 * part : 6 * part + 6, None]
        basis = np.linalg.svd(own, full_matrices=False)
        span = basis[0][:, basis[1] > SHARE * basis[1].max()]
        names = [f"{way} {axis}" for way in ("along", "about") for axis in "xyz"]
        whole = [name for name, share in zip(names, (span**2).sum(axis=1)) if share > 1 - SHARE]
        if whole:
            return ", ".join(whole)
        return describe_direction(span[:3, 0]) if np.linalg.norm(span[:3, 0]) > SHARE else "against turning"

    def _columns(self, name: str) -> slice:
        return slice(6 * self.number[name], 6 * self.number[name] + 6)

    def _reading(self, point, direction) -> np.ndarray:
        return np.concatenate([direction, np.cross(np.subtract(point, self.centre), direction)], axis=-1)

    def _relative(self, bodies, reading: np.ndarray) -> np.ndarray:
        """(..., 6P) a reading (..., 6) of the second body less that of the first; fixtures do not move."""
        line = np.zeros((*reading.shape[:-1], len(self.size)))
        for name, sign in zip(bodies, (-1.0, 1.0)):
            if name in self.number:
                line[..., self._columns(name)] = sign * reading
        return line
