"""Effects of rows whose positions in their sheets are inputs, in one step.

With position rows a' (:class:`mic.process.inputs.Place`), a row ℓ that holds a value reads ``ℓ·y + δ a'·y`` when it has
moved by δ, and its reaction λ acts on ``ℓ + δ a'``. To first order it holds ``a'·y`` less than before, and λ also
pushes on a'. A row that is pushed by a load p also pushes on a' with p; a stop, a contact row ``-σ ℓ``, reads ``-σ
a'·y`` more, and its force f pushes on a' with ``-σ f``. All ``a'·y`` and λ depend linearly on contact forces, values
and loads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mic.contact.tangent import ComplianceDerivative
from mic.model.rows import Row
from mic.process.inputs import Place
from mic.process.stage import EliminatedStep
from mic.process.state import ProcessState

__all__ = ["MovingRows"]


@dataclass(frozen=True)
class MovingRows:
    """The positions in sheets that affect a step.

    Attributes
    ----------
    places : tuple of Place
    eliminated : EliminatedStep
    first : int
        The first position row among the output rows.
    """

    places: tuple[Place, ...]
    eliminated: EliminatedStep
    first: int

    @classmethod
    def of(cls, places: Sequence[Place], stage, eliminated) -> MovingRows:
        """The positions that affect a step of a :class:`mic.process.stage.PreparedStage`."""
        step = eliminated.step
        rows = {*step.bilateral, *step.load_rows, *(stop.row for stop in step.stops)}
        return cls(tuple(one for one in places if one.row in rows), eliminated, stage.output["position"].start)

    def __len__(self) -> int:
        return len(self.places)

    def load(self, b: np.ndarray, inputs: int, v: np.ndarray, p: np.ndarray) -> None:
        """Add the effect of values v (n, b) and loads p (n, l) to b (n inputs, d m + s), in place.

        The contact forces are left out.
        """
        step, response, maps = self.eliminated.step, self.eliminated.response, self.eliminated.position_maps
        for place in self.places:
            own, α, out = b[place.input :: inputs], maps["L"][:, place.number], self.first + place.number
            reads = v @ response.T_out[out] + p @ response.L_out[out]  # a'·y without the contact forces
            for column in _columns(step.bilateral, place):
                pushed = v @ response.reaction_T[column] + p @ response.reaction_L[column]
                own += pushed[:, None] * α - reads[:, None] * response.T[:, column]
            for column in _columns(step.load_rows, place):
                own += p[:, column, None] * α
            for row, sign in self._stops(place):
                own[:, row] -= sign * reads

    def compliance_slope(self) -> ComplianceDerivative | None:
        """The change of the compliance (d m + s, d m + s) of contacts and stops; None if there is none."""
        response, step = self.eliminated.response, self.eliminated.step
        left: list[np.ndarray] = []
        right: list[np.ndarray] = []
        inputs: list[int] = []
        for place in self.places:
            α = self.eliminated.position_maps["L"][:, place.number]
            for column in _columns(step.bilateral, place):
                left += [-response.T[:, column], -α]
                right += [α, response.T[:, column]]
            for row, sign in self._stops(place):
                unit = np.zeros(len(α))
                unit[row] = -sign
                left += [unit, α]
                right += [α, unit]
            inputs += [place.input] * (len(left) - len(inputs))
        if not inputs:
            return None
        return ComplianceDerivative(np.array(left), np.array(right), np.array(inputs))

    def read(self, stage, slope: ProcessState, state: ProcessState, inputs: int, v, p, solved: bool) -> None:
        """Add the effect on readings, reactions and, where parts were placed, contacts to the slope state, in place."""
        step, response, maps = self.eliminated.step, self.eliminated.response, self.eliminated.position_maps
        contacts = slope.left.shape[1] * slope.left.shape[2]
        for place in self.places:
            own, number = slice(place.input, None, inputs), place.number
            holds = state.reading["position"][:, number]
            terms = [(response.T_out[:, j], response.reaction_T[:, j], -holds) for j in _columns(step.bilateral, place)]
            acts = [state.reaction[place.row]] if terms else []
            acts += [p[:, j] for j in _columns(step.load_rows, place)]
            acts += [-sign * state.stop[place.row] for _, sign in self._stops(place)]
            terms += [(maps["L_out"][:, number], maps["reaction_L"][:, number], force) for force in acts]
            for out, reaction, share in terms:
                for kind, rows in stage.output.items():
                    slope.reading[kind][own] += share[:, None] * out[rows]
                slope.reaction.table[own] += share[:, None] * reaction
        if step.sets_down and not solved and contacts:
            moved = np.zeros((len(slope.left), len(response.T)))
            self.load(moved, inputs, v, p)
            moved = moved[:, :contacts].reshape(slope.left.shape)
            slope.left[:] += moved
            if not np.shares_memory(slope.anchor, slope.left):
                slope.anchor[:] += moved[:, :, 1:]

    def _stops(self, place: Place) -> list[tuple[int, int]]:
        """The contact rows of its stops, and the direction in which they push."""
        step, rows = self.eliminated.step, len(self.eliminated.response.T)
        first = rows - len(step.stops)
        return [(first + j, stop.sign) for j, stop in enumerate(step.stops) if stop.row == place.row]


def _columns(rows: Sequence[Row], place: Place) -> list[int]:
    """Position of the moving row among some rows."""
    return [j for j, row in enumerate(rows) if row == place.row]
