r"""Parts that rest by contact alone: their free motions stay among the unknowns of a step.

With the bilateral rows completed by as many rest rows (:class:`mic.model.rest_rows.RestRows`) as they leave motions free,
the parts are statically determinate, and a step's contacts read

    u = S f + b(s) + G q,        λ = e(s) − Gᵀ f,

q what the rest rows read, G the contacts' motion with them, and λ what the rest rows would have to push with: the
resultants of all loads, e, and of the contacts along the free motions. Nothing is there to push, so that q is to be
found with λ = 0.

That is the dual of a problem with a constraint, solved by the method of multipliers (Rockafellar 1976): the part lies
on springs of compliance c about a rest position q̄,

    q = q̄(s) − c λ        ⇔        u = (S + c G Gᵀ) f + b(s) + G (q̄(s) − c e(s)),

which is a contact problem as any other; then q̄ ← q, and again, until the springs carry nothing. What a soft spring
leaves of λ shrinks by c against the compliance with which the contacts hold the part, from one pass to the next. Along
the step q̄ goes straight from where the part was to where it comes to rest, so that on the way the springs carry what
that line leaves, over c.

A part that no force presses is pushed out of what overlaps, and lies where that leaves it: λ falls with the contact
forces, and the way c λ that is left tells. Where λ stays from pass to pass, the part slides on, by strides that double,
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
from mic.process.free_motions import towards
from mic.system.matrix_product import product

__all__ = ["Segment", "Rest"]

SOFT = 10.0  # c, of the largest compliance of a contact
FIRST = 0.01  # of a step whose path is followed: parts come to lie on something
SEGMENTS = 4  # of what is left of it
PASSES = 60
STAYS = 0.1  # of λ: what changes by less from one pass to the next stays
OFF = 10.0  # mm: a part that has gone so far and is still pushed is pushed off
BALANCED = 1e-10  # of the largest force: what the springs may carry
NOISE = 1e-5  # likewise on the way of a path that is followed: its steps err by more
PRESSED = 1e-3  # of the largest force: a part on springs that carry more than this is not pressed on anything
STILL = 1e-5  # mm: then it may be so far from where they carry nothing; the way shrinks by 1/SOFT with each pass
LOOSE = 1e-8  # of the best held motion: what is held by less is not held


@dataclass(frozen=True)
class Segment:
    """A part of a step, for n samples.

    Attributes
    ----------
    start, end : (n, d m + s) array
        b at its start and its end, the parts as they were drawn.
    pushed_start, pushed_end : (n, k) array
        e there.
    """

    start: np.ndarray
    end: np.ndarray
    pushed_start: np.ndarray
    pushed_end: np.ndarray


@dataclass(frozen=True)
class Rest:
    """The parts that rest in a step.

    Attributes
    ----------
    row : (k,) int array
        Numbers of the rest rows, which stand behind the bilateral ones in the step's response.
    soft : (k,) bool array
        Rows of parts that are there; the others hold their part where it is drawn.
    direction : (k, 3) array
        Along which each row pushes its part.
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
        """(n, k) e of the soft rows: what loads (n, l) leave to the rest rows; values of bilateral rows leave nothing,
        as these do no work on the motions that they leave free."""
        return product(p, response.reaction_L[self.columns(response)].T)

    def segments(self, path: Path, law: Law) -> list[tuple[float, Path]]:
        """Where the segments of a path end, and how each is followed: every increment is one of its own.

        A part that lay loose comes to lie on something as soon as anything presses it, and moves by a finite way under
        no load at all: no path to be followed. That takes the first segment, in one increment. What steps of a path that is
        followed leave differs from pass to pass by their error; so the last segment stands still.
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
        drawn: np.ndarray,
        place: np.ndarray,
        force: np.ndarray,
        anchor: np.ndarray,
        follow: Callable[..., tuple[PathSolution, np.ndarray]],
        path: Path,
    ) -> tuple[PathSolution, np.ndarray, np.ndarray]:
        """Go along a segment, and find where the parts come to rest at its end.

        Parameters
        ----------
        response : Response
            Of the step.
        segment : Segment
        drawn, place : (n, k) array
            What the rest rows read where the segment's b was taken, and where it begins.
        force : (n, d m + s) array
            Of contacts and stops, where it begins.
        anchor : (n, m, d - 1) array
        follow : function
            ``follow(b0, b1, force, anchor, path)`` takes samples along, and returns their paths and the forces at the
            end.
        path : Path

        Returns
        -------
        solution : PathSolution
            Samples that the springs still carry are not converged; their status says which part nothing holds, where.
            Of a path that is followed the springs may carry what its steps err by.
        force : (n, d m + s) array
        position : (n, k) array
            q at the end.
        """
        c, G = self.springs(response)

        def unloaded(b, e, target):
            return b + product(target - drawn - c * e, G.T)

        # Springs that carry at first what acts at first, so that the segment starts in equilibrium.
        start = unloaded(segment.start, segment.pushed_start, place + c * (segment.pushed_start - product(force, G)))
        target = place.copy()
        solution, found = follow(start, unloaded(segment.end, segment.pushed_end, target), force, anchor, path)
        exact = isinstance(path, Increments)
        before, stride, enough = np.full(place.shape, np.inf), np.ones(len(place)), BALANCED if exact else NOISE
        for _ in range(PASSES):
            λ = segment.pushed_end - product(found, G)
            scale = np.abs(np.column_stack([found, segment.pushed_end])).max(axis=1, initial=0.0)
            carried = np.abs(λ).max(axis=1, initial=0.0)
            position = target - c * λ
            free = (carried > PRESSED * scale) & (c * carried <= STILL)
            # Where λ stays, the part slides on: by as much again, until something stops it.
            stride = np.where(np.abs(λ - before).max(axis=1, initial=0.0) < STAYS * carried, 2 * stride, 1.0)
            before = λ
            off = np.abs(target - place).max(axis=1, initial=0.0) > OFF
            open_ = (carried > enough * scale) & ~free & solution.converged
            todo = np.flatnonzero(open_ & ~off)
            if not todo.size:
                break
            target[todo] -= c * stride[todo, None] * λ[todo]
            end = unloaded(segment.end, segment.pushed_end, target)
            again, pressed = follow(start[todo], end[todo], force[todo], anchor[todo], path)
            solution = solution.put(todo, again)
            found[todo] = pressed
        position = target - c * (segment.pushed_end - product(found, G))
        if not exact:  # the last segment judges
            return solution, found, position
        status, converged = solution.status.copy(), solution.converged & ~open_
        for sample in np.flatnonzero(open_):
            status[sample] = (
                self._unheld((target - place)[sample], "is pushed off") if off[sample] else Status.NOT_CONVERGED
            )
        return replace(solution, status=status, converged=converged), found, position

    def loose(
        self, response: Response, force: np.ndarray, state: np.ndarray, bound: np.ndarray, stopped: np.ndarray
    ) -> dict[int, str]:
        """Samples in which forces of contacts do not hold the parts where they are, and what to say of them.

        A contact holds along its normal while it presses; along both tangents where it sticks, and across its slip
        where it slips.

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
        whole = self.springs(response)[1]
        G, stops = whole[: m * d].reshape(m, d, -1), whole[m * d :]
        found = {}
        for sample, (f, now, most, carries) in enumerate(zip(force, state, bound, stopped > 0)):
            rows = [stops[carries], G[(now == STICK) | (now == SLIP)][:, 0]]
            if d == 3:
                rough = most > 0
                rows.append(G[(now == STICK) & rough][:, 1:].reshape(-1, G.shape[2]))
                slips = (now == SLIP) & rough
                across = np.column_stack([-f[slips, 2], f[slips, 1]]) / np.maximum(most[slips], 1e-300)[:, None]
                rows.append(np.einsum("ka,kaj->kj", across, G[slips][:, 1:]))
            held = np.concatenate(rows)
            share, motion = np.linalg.eigh(held.T @ held)
            if share[0] <= LOOSE * max(share[-1], 1e-300):
                found[sample] = self._unheld(motion[:, 0], "lies loose")
        return found

    def _unheld(self, share: np.ndarray, how: str) -> str:
        """Why a part is not held, from how much each rest row takes part, positive where it goes."""
        own = [name for name, soft in zip(self.name, self.soft) if soft]
        part = own[int(np.argmax(np.abs(share)))]
        of_part = np.array([name == part for name in own])
        along = (share[of_part, None] * self.direction[self.soft][of_part]).sum(axis=0)
        moved = np.linalg.norm(along) > 0.1 * np.abs(share[of_part]).sum()
        return f"not held: part {part} {how} {towards(along) if moved else 'and turns'}"


def _softened(S: Columns, c: float, G: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """(k, d m + s) columns of ``S + c G Gᵀ``."""
    return S.passed(numbers) + c * product(G[numbers], G.T)
