"""Parts that rest by contact alone: their free motions are unknowns of a step.

The bilateral rows are completed by one rest row (:class:`mic.model.rest_rows.RestRows`) for each motion that they leave
free. The parts are then statically determinate, and a step's contacts read

    u = S f + b(s) + G q,        λ = e(s) − Gᵀ f,

with q the readings of the rest rows, G the contacts' motion with them, and λ the forces of the rest rows: the
resultants of all loads, e, and of the contacts along the free motions. No support exists there, so q must be such that
λ = 0.

This is the dual of a constrained problem, solved by the method of multipliers (Rockafellar 1976): the part lies on
springs of compliance c about a rest position q̄,

    q = q̄(s) − c λ        ⇔        u = (S + c G Gᵀ) f + b(s) + G (q̄(s) − c e(s)),

which is an ordinary contact problem; then q̄ ← q, and again, until the springs carry no force. In each pass the ratio
of the compliance with which the contacts hold the part to c reduces λ. Along the step q̄ moves on a straight line from
the initial to the final position, so that on the way the springs carry the deviation from that line, divided by c.

A part that no force presses is pushed out of its overlaps and stays there: λ falls with the contact forces, and the
remaining distance c λ shows convergence. If λ does not change between passes, the part slides, by strides that double,
until something stops it; or it is pushed off.

References
----------
Rockafellar (1976), Augmented Lagrangians and applications of the proximal point algorithm in convex programming, Math.
Oper. Res. 1, 97–116.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mic.compliance.elimination import Response
from mic.contact.compliance_columns import Columns
from mic.contact.laws import Law
from mic.contact.path import Increments, Path, PathSolution
from mic.contact.solution import Status
from mic.contact.states import SLIP, STICK
from mic.process.free_motions import describe_direction
from mic.system.matrix_product import product

__all__ = ["Segment", "Rest"]

SOFT = 10.0  # c, relative to the largest compliance of a contact
FIRST = 0.01  # share of a followed step in which parts come into contact
SEGMENTS = 4  # in the remaining share
PASSES = 60
STAYS = 0.1  # relative change of λ between passes below which the part slides
OFF = 10.0  # mm: a part that has moved this far and is still pushed is pushed off
BALANCED = 1e-10  # of the largest force: largest spring force at convergence
NOISE = 1e-5  # the same along a followed path, whose steps have larger errors
PRESSED = 1e-3  # of the largest force: a part whose springs carry more is not pressed on anything
STILL = 1e-5  # mm: such a part has converged within this distance, which shrinks by 1/SOFT in each pass
LOOSE = 1e-8  # relative to the stiffest motion: softer motions are not held


@dataclass(frozen=True)
class Segment:
    """A part of a step, for n samples.

    Attributes
    ----------
    start, end : (n, d m + s) array
        b at its start and end, for parts in the position at the start of the step.
    pushed_start, pushed_end : (n, k) array
        e at its start and end.
    """

    start: np.ndarray
    end: np.ndarray
    pushed_start: np.ndarray
    pushed_end: np.ndarray


@dataclass(frozen=True)
class Rest:
    """The parts that rest by contact alone in a step.

    Attributes
    ----------
    row : (k,) int array
        Numbers of the rest rows, which follow the bilateral ones in the step's response.
    soft : (k,) bool array
        Rows of parts that are placed; the others hold their part in its nominal position.
    direction : (k, 3) array
        Direction in which each row pushes its part.
    name : tuple of str
        The part of each row.
    """

    row: np.ndarray
    soft: np.ndarray
    direction: np.ndarray
    name: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.row)

    def columns(self, response: Response) -> np.ndarray:
        """Numbers of the soft rows among the rows that the response holds."""
        return response.T.shape[1] - len(self) + np.flatnonzero(self.soft)

    def springs(self, response: Response) -> tuple[float, np.ndarray]:
        """c, mm/N, and G of the soft rows (d m + s, k)."""
        return SOFT * float(response.diagonal.max(initial=0.0)), response.T[:, self.columns(response)]

    def compliance(self, response: Response) -> tuple[Columns, np.ndarray]:
        """(d m + s, d m + s) ``S + c G Gᵀ``, and its diagonal."""
        c, G = self.springs(response)
        own = response.diagonal + c * np.einsum("ij,ij->i", G, G)
        return Columns(partial(_softened, response.S, c, G), response.S.shape), own

    def pushed(self, response: Response, p: np.ndarray) -> np.ndarray:
        """(n, k) e of the soft rows, from loads (n, l).

        Values of bilateral rows do not contribute: they do no work on the motions that these rows leave free.
        """
        return product(p, response.reaction_L[self.columns(response)].T)

    def segments(self, path: Path, law: Law) -> list[tuple[float, Path]]:
        """Ends of the segments of a path, and how each is followed: every increment is a segment of its own.

        As soon as anything presses a loose part, it moves by a finite distance without load until it touches something,
        which is no path to be followed: the first segment does this in one increment. The steps of a followed path err
        by different amounts from pass to pass, so nothing moves in the last segment.
        """
        if isinstance(path, Increments) or not law.frictional:
            ends = path.ends if law.frictional else [1.0]
            return [(float(end), Increments(1)) for end in ends]
        ends = np.linspace(FIRST, 1.0, SEGMENTS + 1)[1:]
        return [(FIRST, Increments(1)), *((float(end), path) for end in ends), (1.0, Increments(1))]

    def settle(
        self,
        response: Response,
        segment: Segment,
        nominal: np.ndarray,
        place: np.ndarray,
        force: np.ndarray,
        anchor: np.ndarray,
        follow: Callable[..., tuple[PathSolution, np.ndarray]],
        path: Path,
    ) -> tuple[PathSolution, np.ndarray, np.ndarray]:
        """Go along a segment, and find the equilibrium positions of the parts at its end.

        Parameters
        ----------
        response : Response
            Of the step.
        segment : Segment
        nominal, place : (n, k) array
            Readings of the rest rows at which the segment's b was computed, and at its start.
        force : (n, d m + s) array
            Of contacts and stops, at its start.
        anchor : (n, m, d - 1) array
        follow : function
            ``follow(b0, b1, force, anchor, path)`` takes samples along, and returns their paths and the forces at the
            end.
        path : Path

        Returns
        -------
        solution : PathSolution
            Samples whose springs still carry force are not converged; their status names the part that nothing holds,
            and its direction. Along a followed path the springs may carry the error of its steps.
        force : (n, d m + s) array
        position : (n, k) array
            q at the end.
        """
        c, G = self.springs(response)

        def unloaded(b, e, target):
            return b + product(target - nominal - c * e, G.T)

        # The springs balance the initial loads, so that the segment starts in equilibrium.
        start = unloaded(segment.start, segment.pushed_start, place + c * (segment.pushed_start - product(force, G)))
        target = place.copy()
        solution, found = follow(start, unloaded(segment.end, segment.pushed_end, target), force, anchor, path)
        exact = isinstance(path, Increments)
        before, stride, tolerance = np.full(place.shape, np.inf), np.ones(len(place)), BALANCED if exact else NOISE
        for _ in range(PASSES):
            λ = segment.pushed_end - product(found, G)
            scale = np.abs(np.column_stack([found, segment.pushed_end])).max(axis=1, initial=0.0)
            carried = np.abs(λ).max(axis=1, initial=0.0)
            free = (carried > PRESSED * scale) & (c * carried <= STILL)
            # If λ does not change, the part slides on, by doubled strides, until something stops it.
            stride = np.where(np.abs(λ - before).max(axis=1, initial=0.0) < STAYS * carried, 2 * stride, 1.0)
            before = λ
            off = np.abs(target - place).max(axis=1, initial=0.0) > OFF
            unbalanced = (carried > tolerance * scale) & ~free & solution.converged
            todo = np.flatnonzero(unbalanced & ~off)
            if not todo.size:
                break
            target[todo] -= c * stride[todo, None] * λ[todo]
            end = unloaded(segment.end, segment.pushed_end, target)
            again, pressed = follow(start[todo], end[todo], force[todo], anchor[todo], path)
            solution = solution.replaced(todo, again)
            found[todo] = pressed
        position = target - c * (segment.pushed_end - product(found, G))
        if not exact:  # the last segment decides convergence
            return solution, found, position
        status, converged = solution.status.copy(), solution.converged & ~unbalanced
        for sample in np.flatnonzero(unbalanced):
            motion = (target - place)[sample]
            status[sample] = self._not_held_message(motion, "is pushed off") if off[sample] else Status.NOT_CONVERGED
        return replace(solution, status=status, converged=converged), found, position

    def loose(
        self, response: Response, force: np.ndarray, state: np.ndarray, bound: np.ndarray, stopped: np.ndarray
    ) -> dict[int, str]:
        """Samples in which contact forces do not hold the parts in their position, with the message for each.

        A pressed contact holds its part along the normal; a sticking one along both tangents, a sliding one across its
        slip.

        Parameters
        ----------
        response : Response
        force : (n, m, d) array
        state : (n, m) array
            A :class:`mic.contact.states.ContactState` each.
        bound : (n, m) array
            Largest tangential forces.
        stopped : (n, s) array
            Forces of the stops, which hold while they carry any.
        """
        m, d = force.shape[1:]
        G_all = self.springs(response)[1]
        G, stops = G_all[: m * d].reshape(m, d, -1), G_all[m * d :]
        messages = {}
        for sample, (f, contact, limit, loaded) in enumerate(zip(force, state, bound, stopped > 0)):
            rows = [stops[loaded], G[(contact == STICK) | (contact == SLIP)][:, 0]]
            if d == 3:
                rough = limit > 0
                rows.append(G[(contact == STICK) & rough][:, 1:].reshape(-1, G.shape[2]))
                slips = (contact == SLIP) & rough
                across = np.column_stack([-f[slips, 2], f[slips, 1]]) / np.maximum(limit[slips], 1e-300)[:, None]
                rows.append(np.einsum("ka,kaj->kj", across, G[slips][:, 1:]))
            held = np.concatenate(rows)
            share, motion = np.linalg.eigh(held.T @ held)
            if share[0] <= LOOSE * max(share[-1], 1e-300):
                messages[sample] = self._not_held_message(motion[:, 0], "lies loose")
        return messages

    def _not_held_message(self, share: np.ndarray, how: str) -> str:
        """Why a part is not held, from the share of each rest row in its motion, positive in the row's direction."""
        own = [name for name, soft in zip(self.name, self.soft) if soft]
        part = own[int(np.argmax(np.abs(share)))]
        of_part = np.array([name == part for name in own])
        along = (share[of_part, None] * self.direction[self.soft][of_part]).sum(axis=0)
        moved = np.linalg.norm(along) > 0.1 * np.abs(share[of_part]).sum()
        return f"not held: part {part} {how} {describe_direction(along) if moved else 'and turns'}"


def _softened(S: Columns, c: float, G: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """(k, d m + s) columns of ``S + c G Gᵀ``."""
    return S.uncached(numbers) + c * product(G[numbers], G.T)
