r"""Parts that rest by contact alone: their free motions stay among the unknowns of a step.

With the bilateral rows completed by as many rest rows (:class:`mic.model.resting.RestRows`) as they leave motions free,
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
forces, and the way c λ that is left tells. Where λ stays, nothing holds the part.

References
----------
Rockafellar (1976), Augmented Lagrangians and applications of the proximal point algorithm in convex programming, Math.
Oper. Res. 1, 97–116.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mic.compliance.elimination import Response
from mic.contact.path import PathSolution
from mic.contact.states import SLIP, STICK
from mic.process.freedom import towards
from mic.product import product

__all__ = ["Rest"]

SOFT = 1e5  # c, of the largest compliance of a contact
PASSES = 8
BALANCED = 1e-10  # of the largest force: what the springs may carry
STILL = 1e-5  # mm: or so far as the part may be from where they carry nothing; it shrinks by 1/SOFT with each pass
LOOSE = 1e-8  # of the best held motion: what is held by less is not held


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
        return SOFT * float(response.S.diagonal().max(initial=0.0)), response.T[:, self.columns(response)]

    def compliance(self, response: Response) -> np.ndarray:
        """(d m + s, d m + s) ``S + c G Gᵀ``."""
        c, G = self.springs(response)
        return response.S + c * (G @ G.T)

    def pushed(self, response: Response, v: np.ndarray, p: np.ndarray) -> np.ndarray:
        """(n, k) e of the soft rows: what loads and values leave to the rest rows."""
        own = self.columns(response)
        return product(v, response.reaction_T[own].T) + product(p, response.reaction_L[own].T)

    def settle(
        self,
        response: Response,
        follow: Callable[[np.ndarray, np.ndarray], tuple[PathSolution, np.ndarray]],
        start: np.ndarray,
        pushed: np.ndarray,
    ) -> tuple[PathSolution, np.ndarray, np.ndarray]:
        """Find where the parts come to rest.

        Parameters
        ----------
        response : Response
            Of the step.
        follow : function
            ``follow(own, q̄)`` takes the samples `own` along the step, to the rest positions (n, k), and returns their
            paths and the forces (n, d m + s) of contacts and stops.
        start : (n, k) array
            Rest positions to begin with.
        pushed : (n, k) array
            e at the step's end.

        Returns
        -------
        solution : PathSolution
            Samples that the springs still carry are not converged; their status says which part nothing holds, where.
        force : (n, d m + s) array
        position : (n, k) array
            q.
        """
        c, G = self.springs(response)
        target, todo = start.copy(), np.arange(len(start))
        solution, force = follow(todo, target)
        for _ in range(PASSES):
            λ = pushed - product(force, G)
            scale = np.abs(np.column_stack([force, pushed])).max(axis=1, initial=0.0)
            carried = np.abs(λ).max(axis=1, initial=0.0)
            position = target - c * λ
            open_ = (carried > BALANCED * scale) & (c * carried > STILL) & solution.converged
            todo = np.flatnonzero(open_)
            if not todo.size:
                return solution, force, position
            target[todo] = position[todo]
            again, pressed = follow(todo, target)
            solution = solution.put(todo, again)
            force[todo] = pressed
        status, converged = solution.status.copy(), solution.converged.copy()
        for sample in todo:
            status[sample] = self._unheld(λ[sample], "is pushed off")
        converged[todo] = False
        return replace(solution, status=status, converged=converged), force, position

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
        """Why a part is not held, from how much each rest row takes part."""
        own = [name for name, soft in zip(self.name, self.soft) if soft]
        part = own[int(np.argmax(np.abs(share)))]
        of_part = np.array([name == part for name in own])
        along = (share[of_part, None] * self.direction[self.soft][of_part]).sum(axis=0)
        moved = np.linalg.norm(along) > 0.1 * np.abs(share[of_part]).sum()
        return f"not held: part {part} {how} {towards(along) if moved else 'and turns'}"
