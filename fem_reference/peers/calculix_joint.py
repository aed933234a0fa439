"""Two strips joined by spot welds, of solids by CalculiX: what the lap joint's scene means without shells, influence
coefficients, candidates or tied patches.

Each strip is a block of C3D8I, whose stiffness CalculiX gives. Their grids lie upon each other in the overlap, where
every node touches its twin without friction. Locators hold means over discs of the middle surface, clamps press on
discs of the outer faces. A *fused* nugget is one piece: all twins within its disc keep, from the weld on, how they
stand to each other when the clamps are closed. A deviation of shape opens and closes the gaps; a part of such a shape
is held on its locators while the force that makes it acts.

Without friction nothing else is remembered: a stage is one linear complementarity problem,

    K u = f + Bᵀ λ + Cᵀ p,      B u = v,      0 ≤ p ⊥ g + C u ≥ 0 .

With friction (:func:`process`) twins have three rows each, n, t1, t2, and the process is gone through in increments,
each of which obeys Coulomb's law from where the one before left the faces. Overlaps come to rest first, in a step of
their own; clamps close; nuggets freeze what they find, and no twin within them touches any more; clamps open, then the
upper strip's locators.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import nnls
from scipy.sparse import block_diag, csc_matrix, csr_matrix, vstack

from fem_reference.peers.calculix import CalculixError, stiffness
from fem_reference.shell.factorisation import Factorisation
from mic.scene import Scene

__all__ = ["Outcome", "Strip", "joint", "process"]

SQUARES = 8  # along and across a node's cell, by which its share of a disc is counted
BLOCK = 300  # columns that are solved together
FINE = 1.6  # radii of a nugget: so far about its middle elements are fine


class Strip:
    """A block of solids over a grid.

    Parameters
    ----------
    x, y, z : arrays
        Coordinates of its nodes along each axis, mm; the middle one of z is the middle surface.
    young, poisson : float
        MPa, 1.

    Attributes
    ----------
    K : (d, d) csc_matrix
        N/mm, of nodes and of elements' own freedoms.
    """

    def __init__(self, x: np.ndarray, y: np.ndarray, z: np.ndarray, young: float, poisson: float):
        self.x, self.y, self.z, self._material = x, y, z, (young, poisson)
        shape = len(x), len(y), len(z)
        self._number = np.arange(1, 1 + len(x) * len(y) * len(z)).reshape(shape)
        self._nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3)
        self.K, freedom = self._stiffness(self._nodes)
        self._column = np.full((len(self._nodes) + 1, 3), -1)
        at_node = freedom[:, 0] <= len(self._nodes)
        self._column[freedom[at_node, 0], freedom[at_node, 1]] = np.flatnonzero(at_node)
        if (self._column[1:] < 0).any():
            raise CalculixError("ccx gave no stiffness for some nodes")

    def _stiffness(self, nodes: np.ndarray) -> tuple[csc_matrix, np.ndarray]:
        """K and whose its freedoms are, with these nodes (n, 3)."""
        young, poisson = self._material
        lines = ["*NODE"]  # a number has 20 characters at most
        lines += [f"{n}, {a:.12g}, {b:.12g}, {c:.12g}" for n, (a, b, c) in enumerate(nodes.tolist(), start=1)]
        lines.append("*ELEMENT, TYPE=C3D8I, ELSET=SHEET")
        corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
        i, j, k = (count - 1 for count in self._number.shape)
        own = [self._number[a : a + i, b : b + j, c : c + k] for a, b, c in corners]
        elements = np.stack(own, -1).reshape(-1, 8)
        lines += [", ".join(map(str, [n, *element])) for n, element in enumerate(elements.tolist(), start=1)]
        lines += ["*MATERIAL, NAME=STEEL", f"*ELASTIC\n{young!r}, {poisson!r}", "*DENSITY\n1e-9"]
        lines.append("*SOLID SECTION, ELSET=SHEET, MATERIAL=STEEL")
        return stiffness("\n".join(lines) + "\n")

    def deviated(self, shape: np.ndarray) -> csc_matrix:
        """(d, d) K of the block whose nodes lie where a shape (d,) has moved them, mm; elements' freedoms as before."""
        return self._stiffness(self._nodes + shape[self._column[1:]])[0]

    @property
    def middle(self) -> int:
        """Layer of nodes of the middle surface."""
        return len(self.z) // 2

    def columns(self, layer: int, axis: int) -> np.ndarray:
        """(nx, ny) freedoms of a layer's nodes."""
        return self._column[self._number[:, :, layer], axis]

    def share(self, point, radius: float) -> np.ndarray:
        """(nx, ny) shares of a disc that lie in the cell about each node of the grid, mm²."""
        squares, cells = [], []
        for grid in (self.x, self.y):
            edge = np.concatenate([[grid[0]], (grid[1:] + grid[:-1]) / 2, [grid[-1]]])
            cells.append(np.diff(edge))
            squares.append(edge[:-1, None] + cells[-1][:, None] * (np.arange(SQUARES) + 0.5) / SQUARES)
        away = np.hypot(squares[0][:, :, None, None] - point[0], squares[1][None, None] - point[1])
        return (away <= radius).mean(axis=(1, 3)) * np.outer(*cells)

    def mean(self, point, radius: float, direction, layer: int) -> csr_matrix:
        """(1, d) mean over a disc of what a layer's nodes move along a direction."""
        share = self.share(point, radius)
        row = np.zeros(self.K.shape[0])
        for axis, part in enumerate(direction):
            row[self.columns(layer, axis)] += part * share / share.sum()
        return csr_matrix(row)


def joint(
    scene: Scene, deviations: np.ndarray, fine: float, coarse: float, layers: int = 2, deviated: bool = False
) -> np.ndarray:
    """Measurements (n, k), mm, of the lap joint at deviations (n, p), without friction.

    Parameters
    ----------
    scene : Scene
        Of two strips as the shipped lap joint has them, along x; radii must not be 0.
    deviations : (n, p) array
        In the scene's order: amplitudes of forces that give shapes, positions of locators.
    fine, coarse : float
        Largest element, mm, about the welds and elsewhere.
    layers : int
        Elements through each thickness, an even number.
    deviated : bool
        Whether strips have the stiffness of their deviated shape in place of the nominal one.

    Raises
    ------
    CalculixError
    """
    lower, upper = strips = _strips(scene, fine, coarse, layers)
    of = dict(zip((part.name for part in scene.parts), strips))
    size = [strip.K.shape[0] for strip in strips]

    def row(one, layer=None) -> csr_matrix:
        strip = of[one.part]
        own = strip.mean(one.point, one.radius, one.direction, strip.middle if layer is None else layer)
        parts = [own if each is strip else csr_matrix((1, n)) for each, n in zip(strips, size)]
        return csr_matrix(np.hstack([each.toarray() for each in parts]))

    K = csc_matrix(block_diag([strip.K for strip in strips]))
    held = {one.name: row(one) for one in scene.locators}
    twins = [_twins(lower, upper, size[0], axis) for axis in range(3)]
    fused = _fused(scene, lower, upper)
    ties = vstack([each[fused] for each in twins])
    touch = twins[2]
    apart = np.setdiff1d(np.arange(touch.shape[0]), fused)
    press = sum(
        one.force * row(one, 0 if of[one.part] is lower else len(upper.z) - 1).toarray()[0] for one in scene.clamps
    )
    free = _Held(K, vstack(list(held.values())), csr_matrix((0, K.shape[0])))
    kept = next(stage.keep for stage in scene.stages if stage.kind == "release")

    def stages(K: csc_matrix) -> tuple[_Held, _Held]:
        """Clamped, and released once welded."""
        welded = vstack([*(held[name] for name in kept), ties])
        return _Held(K, vstack(list(held.values())), touch), _Held(K, welded, touch[apart])

    nominal = None if deviated else stages(K)
    read = vstack([row(one) for one in scene.measurements])
    none = np.zeros(len(held))
    unit = {i: row(one).toarray()[0] for i, one in enumerate(scene.deviations) if one.kind == "force"}
    unit = {i: free.solve(force, none, np.zeros(0)) for i, force in unit.items()}
    found = []
    for amplitudes in np.atleast_2d(deviations):
        shape = sum((amplitudes[i] * each for i, each in unit.items()), np.zeros(K.shape[0]))
        asked: Mapping[str, float] = {
            one.target: amplitude for amplitude, one in zip(amplitudes, scene.deviations) if one.kind == "locator"
        }
        gap = touch @ shape
        both = zip(strips, np.split(shape, [size[0]]))
        clamped, released = nominal or stages(csc_matrix(block_diag([strip.deviated(own) for strip, own in both])))
        closed = clamped.solve(press, np.array([asked.get(name, 0.0) for name in held]), gap)
        frozen = np.concatenate([[asked.get(name, 0.0) for name in kept], ties @ closed])
        found.append(read @ (shape + released.solve(np.zeros_like(shape), frozen, gap[apart])))
    return np.array(found)


@dataclass(frozen=True)
class Outcome:
    """What the process with friction gave at n deviations, in the stages ``clamp`` and ``release``.

    Attributes
    ----------
    measurements : (n, k) array
        mm.
    force : (n, 2) array
        Sum of the normal forces beyond some radii of the nuggets, N.
    slip : (n, 2) array
        Root mean square, over the same area, of what the faces moved along each other in the stage, mm.
    twins : int
    """

    measurements: np.ndarray
    force: np.ndarray
    slip: np.ndarray
    twins: int


def process(
    scene: Scene,
    deviations: np.ndarray,
    fine: float,
    coarse: float,
    solver: Callable,
    increments: int = 8,
    beyond: float = 3.0,
) -> Outcome:
    """The whole process of the lap joint with Coulomb friction.

    Parameters
    ----------
    scene, deviations, fine, coarse
        As :func:`joint` has them.
    solver : callable
        ``solver(S, mu)`` prepares problems ``u = S f + b`` of Coulomb's law: :class:`mic.contact.ContactSolver`.
    increments : int
        Of each step.
    beyond : float
        Radii of a nugget nearer to which forces and slip are not read: sums of nodal forces do not settle there.

    Raises
    ------
    CalculixError
    ValueError
        If the contact problem of an increment was not solved.
    """
    lower, upper = strips = _strips(scene, fine, coarse, 2)
    of = dict(zip((part.name for part in scene.parts), strips))
    size = [strip.K.shape[0] for strip in strips]

    def row(one, layer=None) -> np.ndarray:
        strip = of[one.part]
        own = strip.mean(one.point, one.radius, one.direction, strip.middle if layer is None else layer).toarray()[0]
        return np.concatenate([own if each is strip else np.zeros(n) for each, n in zip(strips, size)])

    K = csc_matrix(block_diag([strip.K for strip in strips]))
    locators = csr_matrix(np.array([row(one) for one in scene.locators]))
    kept = next(stage.keep for stage in scene.stages if stage.kind == "release")
    stays = np.array([one.name in kept for one in scene.locators])
    press = sum(one.force * row(one, 0 if of[one.part] is lower else len(upper.z) - 1) for one in scene.clamps)
    twins = [_twins(lower, upper, size[0], axis) for axis in (2, 0, 1)]
    m = twins[0].shape[0]
    fused = _fused(scene, lower, upper)
    apart = np.setdiff1d(np.arange(m), fused)
    touch = vstack(twins).tocsr()[np.arange(3 * m).reshape(3, m).T.ravel()]  # n, t1, t2 of each twin together
    still = touch[(3 * apart[:, None] + np.arange(3)).ravel()]
    ties = vstack([each[fused] for each in twins])
    read = np.array([row(one) for one in scene.measurements])
    clamped = _Held(K, locators, csr_matrix((0, K.shape[0])))
    welded = _Held(K, vstack([locators[stays], ties]), csr_matrix((0, K.shape[0])))
    mu = scene.zones[0].friction
    closing, opening = solver(clamped.compliance(touch), mu), solver(welded.compliance(still), mu)
    none, nothing = np.zeros(locators.shape[0]), np.zeros(0)
    unit = {i: row(one) for i, one in enumerate(scene.deviations) if one.kind == "force"}
    unit = {i: clamped.solve(force, none, nothing) for i, force in unit.items()}
    area, outside = _facing(scene, lower, upper, beyond)
    found = []
    for amplitudes in np.atleast_2d(deviations):
        shape = sum((amplitudes[i] * each for i, each in unit.items()), np.zeros(K.shape[0]))
        asked: Mapping[str, float] = {
            one.target: amplitude for amplitude, one in zip(amplitudes, scene.deviations) if one.kind == "locator"
        }
        value = np.array([asked.get(one.name, 0.0) for one in scene.locators])
        gap = np.zeros((m, 3))
        gap[:, 0] = twins[0] @ shape

        def faces(held: _Held, load, at, rows, drawn):
            return (rows @ held.solve(load, at, nothing)).reshape(-1, 3) + drawn

        start = faces(clamped, 0 * press, value, touch, gap)
        clear = start.copy()
        clear[:, 0] = np.maximum(clear[:, 0], 0.0)
        force, place = _gone(closing, np.zeros((m, 3)), start, (clear, start), increments)
        force, place = _gone(closing, force, place, (start, faces(clamped, press, value, touch, gap)), increments)
        pushing = press + touch.T @ force.ravel()
        closed = clamped.solve(pushing, value, nothing)
        loosened = locators[~stays].T @ clamped.reaction(closed, pushing)[~stays]
        frozen = np.concatenate([value[stays], ties @ closed])
        legs = [faces(welded, load, frozen, still, gap[apart]) for load in (press - loosened, -loosened, 0 * press)]
        last, end = force[apart], place[apart]
        for leg in zip(legs, legs[1:]):
            last, end = _gone(opening, last, end, leg, increments)
        free = welded.solve(still.T @ last.ravel(), frozen, nothing)
        found.append(
            (
                read @ (shape + free),
                [force[outside, 0].sum(), last[outside[apart], 0].sum()],
                [
                    _root_mean_square((place - start)[outside, 1:], area[outside]),
                    _root_mean_square((end - place[apart])[outside[apart], 1:], area[apart][outside[apart]]),
                ],
            )
        )
    return Outcome(*(np.array(each) for each in zip(*found)), m)


def _gone(solver, force, place, leg, increments: int) -> tuple[np.ndarray, np.ndarray]:
    """Forces (m, 3) and where the faces stand (m, 3) once displacements without contact went along a leg, b0 to b1."""
    b0, b1 = leg
    for s in np.arange(1, increments + 1) / increments:
        b = b0 + s * (b1 - b0)
        b[:, 1:] -= place[:, 1:]
        solution = solver.solve(b.ravel(), force.ravel())
        if not solution.converged:
            raise ValueError("a contact problem of the solids was not solved")
        force = solution.force.reshape(-1, 3)
        moved = solution.displacement.reshape(-1, 3)
        place = moved + np.concatenate([np.zeros((len(place), 1)), place[:, 1:]], axis=1)
    return force, place


def _facing(scene: Scene, lower: Strip, upper: Strip, beyond: float) -> tuple[np.ndarray, np.ndarray]:
    """(m,) the twins' shares of the overlap, mm², and whether they lie beyond some radii of every nugget."""
    inside = lower.x >= upper.x[0] - 1e-9
    x, y = (grid.ravel() for grid in np.meshgrid(lower.x[inside], lower.y, indexing="ij"))
    along, across = (np.gradient(grid) for grid in (lower.x[inside], lower.y))
    for cell in (along, across):
        cell[[0, -1]] /= 2
    away = [np.hypot(x - weld.point[0], y - weld.point[1]) > beyond * weld.radius for weld in scene.welds]
    return np.outer(along, across).ravel(), np.all(away, axis=0)


def _root_mean_square(vectors: np.ndarray, weight: np.ndarray) -> float:
    return float(np.sqrt((weight * (vectors**2).sum(axis=1)).sum() / weight.sum()))


class _Held:
    """Both strips, with rows B held and rows C that may not fall below the gaps.

    ``K u + Bᵀ λ = f``, ``B u = v`` has the same u with ``K + α Bᵀ B`` in place of K, whatever α is; that is positive
    definite, though strips that nothing holds are free to move.
    """

    def __init__(self, K: csc_matrix, B: csr_matrix, C: csr_matrix):
        alpha = float(np.abs(K.diagonal()).mean())
        self._K, self._B, self._C = K, B, C
        self._factor = Factorisation(csr_matrix(K + alpha * (B.T @ B)))
        self._reach = self._factor.solve(B.T.toarray())
        self._hold = cho_factor(B @ self._reach)
        self._open = self._solve(C.T.toarray(), np.zeros((B.shape[0], C.shape[0])))
        S = C @ self._open
        self._root = cholesky(0.5 * (S + S.T)) if len(S) else S

    def _solve(self, force, value):
        free = self._factor.solve(force.reshape(len(force), -1)).reshape(force.shape)
        return free - self._reach @ cho_solve(self._hold, self._B @ free - value)

    def compliance(self, rows: csr_matrix) -> np.ndarray:
        """(m, m) what rows (m, d) read of forces along them."""
        none = np.zeros((self._B.shape[0], BLOCK))
        blocks = [rows[k : k + BLOCK] for k in range(0, rows.shape[0], BLOCK)]
        S = np.hstack([rows @ self._solve(own.T.toarray(), none[:, : own.shape[0]]) for own in blocks])
        return 0.5 * (S + S.T)

    def reaction(self, u: np.ndarray, force: np.ndarray) -> np.ndarray:
        """(b,) λ of displacements (d,) under forces (d,)."""
        return np.linalg.solve((self._B @ self._B.T).toarray(), self._B @ (force - self._K @ u))

    def solve(self, force: np.ndarray, value: np.ndarray, gap: np.ndarray) -> np.ndarray:
        """(d,) displacements under forces (d,), the rows held at values and the gaps (m,) not passed."""
        u = self._solve(force, value)
        if not len(gap):
            return u
        # With S = Rᵀ R the pressures are those p ≥ 0 for which R p comes nearest to -R⁻ᵀ b.
        pressure, _ = nnls(self._root, -solve_triangular(self._root, gap + self._C @ u, trans="T"))
        return u + self._open @ pressure


def _strips(scene: Scene, fine: float, coarse: float, layers: int) -> Sequence[Strip]:
    """Grids that match in the overlap: fine about the welds, coarse elsewhere."""
    welds = np.array([weld.point for weld in scene.welds])
    reach = FINE * max(weld.radius for weld in scene.welds)
    along = _graded([0.0, 60.0, 100.0, 160.0], welds[:, 0], reach, fine, coarse)
    across = _graded([0.0, 25.0], welds[:, 1], reach, fine, coarse)
    strips = []
    for part, start, level in zip(scene.parts, (0.0, 60.0), (0.0, 1.0)):
        x = along[(along >= start - 1e-9) & (along <= start + 100.0 + 1e-9)]
        z = level + np.linspace(-part.thickness / 2, part.thickness / 2, layers + 1)
        strips.append(Strip(x, across, z, part.young, part.poisson))
    return strips


def _graded(ends, centres, reach, fine, coarse) -> np.ndarray:
    """Lines of a grid from end to end, fine within `reach` of the centres."""
    stretches = [(centre - reach, centre + reach) for centre in centres]
    knots = np.unique(np.round([*ends, *np.ravel(stretches)], 9))
    lines = []
    for a, b in zip(knots, knots[1:]):
        near = any(low < (a + b) / 2 < high for low, high in stretches)
        lines.append(np.linspace(a, b, int(np.ceil((b - a) / (fine if near else coarse) - 1e-9)) + 1))
    return np.unique(np.round(np.concatenate(lines), 9))


def _twins(lower: Strip, upper: Strip, columns: int, axis: int) -> csr_matrix:
    """(m, d) what the upper strip's nodes of the overlap move along an axis, less their twins."""
    inside = lower.x >= upper.x[0] - 1e-9
    below = lower.columns(len(lower.z) - 1, axis)[inside].ravel()
    above = columns + upper.columns(0, axis)[: inside.sum()].ravel()
    rows = np.arange(len(below))
    entries = np.concatenate([np.ones(len(rows)), -np.ones(len(rows))])
    shape = len(rows), columns + upper.K.shape[0]
    return csr_matrix((entries, (np.tile(rows, 2), np.concatenate([above, below]))), shape=shape)


def _fused(scene: Scene, lower: Strip, upper: Strip) -> np.ndarray:
    """Numbers of the twins within a nugget: those of whose cells more than half is."""
    share = np.sum([lower.share(weld.point, weld.radius) for weld in scene.welds], axis=0)
    inside = lower.x >= upper.x[0] - 1e-9
    return np.flatnonzero((share > 0.5 * lower.share((0.0, 0.0), np.inf))[inside])
