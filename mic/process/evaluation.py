"""What the process hands out: contact solutions per stage, key characteristics, forces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from mic.contact.path import Trace
from mic.process.state import ProcessState

__all__ = ["REACHED", "Course", "Evaluation", "Resolution", "Resolutions"]

REACHED = 1e-3  # mm: a way that no gauge reads


@dataclass(frozen=True)
class Resolution:
    """Contact solution of one stage for n samples and m pairs of dimension d (3, or 1 where only normals are modelled).

    Attributes
    ----------
    stage : str
    force : (n, m, d) array
        N; normal compression positive.
    displacement : (n, m, d) array
        mm; the normal component is the gap, the tangential ones the tangential displacement since the stage before,
        that of open contacts included.
    state : (n, m) int8 array
        A :class:`mic.contact.states.ContactState` each.
    trace : mic.contact.path.Trace
        What the contacts went through on the way: slip under load, friction's work, shares of the path.  Its error is
        that of the contacts' positions at the end of the stage: what this path left and, at most, what all before did.
    residual : (n,) array
        The scale-free natural-map residual, the largest of the increments, or of the ends of the steps followed.
    converged : (n,) bool array
        True where all of these met the tolerance.
    iterations : (n,) int array
    status : (n,) object array
        Outcome of the last step.
    rung : (n,) object array
        ``"followed"``, or which rung of the ladder found the last force, see :class:`mic.contact.ContactSolution`.
    reaction : (n, b) array
        Forces of the bilateral rows on the parts, N or N mm.
    unseen : (n,) array
        Deepest penetration at the end at points between the pairs, where no pair sees it, mm; 0 where there is none.
    unseen_at : (n,) int array
        Which of the model's points between the pairs; -1 where there is none.
    pushed : (n, p) array
        What the clamps and guns of limited force push with where they are judged
        (:attr:`mic.process.plan.StagePlan.judged`), N.
    left : (n, p) array
        The way that each has left to its position, mm; 0 where it is reached.
    needed : (n, p) array
        Where a position is not reached, what each would push with if none of that sample had a limit, N; else NaN.
    """

    stage: str
    force: np.ndarray
    displacement: np.ndarray
    state: np.ndarray
    trace: Trace
    residual: np.ndarray
    converged: np.ndarray
    iterations: np.ndarray
    status: np.ndarray
    rung: np.ndarray
    reaction: np.ndarray
    unseen: np.ndarray
    unseen_at: np.ndarray
    pushed: np.ndarray
    left: np.ndarray
    needed: np.ndarray

    @property
    def reached(self) -> np.ndarray:
        """(n, p) whether each clamp and gun of limited force reached its position."""
        return ~(self.left > REACHED)

    @classmethod
    def join(cls, pieces: Sequence[Resolution]) -> Resolution:
        """Resolutions of one stage, put one after the other."""
        trace = Trace(**_stacked([piece.trace for piece in pieces], Trace))
        return cls(stage=pieces[0].stage, trace=trace, **_stacked(pieces, cls))


@dataclass(frozen=True)
class Course:
    """What n assemblies went through.

    Attributes
    ----------
    resolutions : dict of str to Resolution
        By stage, for the stages that resolve contact.
    readings : (n, r) array
        As :class:`Evaluation` has them.
    failed : (n,) bool array
        Likewise.
    state : mic.process.state.ProcessState
        At the end of the stage that is told.
    """

    resolutions: dict[str, Resolution]
    readings: np.ndarray
    failed: np.ndarray
    state: ProcessState


class Resolutions(Mapping[str, Resolution]):
    """By stage, in order; a course is gone through when one of them is first asked for.

    Parameters
    ----------
    stages : sequence of str
        Those that resolve contact.
    course : function
        Gives the :class:`Course`; called once.
    """

    def __init__(self, stages: Sequence[str], course: Callable[[], Course]):
        self._stages, self._course = stages, course

    @cached_property
    def course(self) -> Course:
        """What the assemblies went through."""
        course = self._course()
        del self._course  # with all that it was made from
        return course

    def __getitem__(self, stage: str) -> Resolution:
        if stage not in self._stages:
            raise KeyError(stage)
        return self.course.resolutions[stage]

    def __contains__(self, stage: object) -> bool:
        return stage in self._stages

    def __iter__(self) -> Iterator[str]:
        return iter(self._stages)

    def __len__(self) -> int:
        return len(self._stages)


@dataclass(frozen=True)
class Evaluation:
    """Outcome of n assemblies.

    Attributes
    ----------
    law : str
    deviations : (n, p) array
    resolutions : mapping of str to Resolution
        By stage, for the stages that resolve contact; made when they are first asked for.
    measurements : (n, k) array
        Key characteristics in the scene's order, mm from nominal; empty where nothing reads them.
    readings : (n, r) array
        The readings that they are made of (`mic.model.characteristics`), mm; empty likewise.
    failed : (n,) bool array
        Samples whose contact missed its tolerance in some stage.
    equilibrium : function
        Finds :attr:`functional_force` and :attr:`motion`, when either is first asked for.
    """

    law: str
    deviations: np.ndarray
    resolutions: Mapping[str, Resolution]
    measurements: np.ndarray
    readings: np.ndarray
    failed: np.ndarray
    equilibrium: Callable[[], tuple[np.ndarray, np.ndarray]]

    @property
    def functional_force(self) -> np.ndarray:
        """(n, F) all forces on the retained functionals in the last stage, those that made the parts' shapes
        included, N."""
        return self._equilibrium[0]

    @property
    def motion(self) -> np.ndarray:
        """(n, 6P) rigid-body motions of the parts in the last stage, shape deviation included, mm and rad."""
        return self._equilibrium[1]

    @cached_property
    def _equilibrium(self) -> tuple[np.ndarray, np.ndarray]:
        return self.equilibrium()

    @property
    def built(self) -> np.ndarray:
        """(n,) whether every clamp and gun of limited force reached its position; true where there is none."""
        every = [resolution.reached.all(axis=1) for resolution in self.resolutions.values()]
        return np.logical_and.reduce([np.ones(len(self.failed), dtype=bool), *every])

    @classmethod
    def join(cls, pieces: Sequence[Evaluation]) -> Evaluation:
        """Evaluations of one law, put one after the other."""
        if len(pieces) == 1:
            return pieces[0]
        stages = pieces[0].resolutions
        resolutions = {stage: Resolution.join([piece.resolutions[stage] for piece in pieces]) for stage in stages}

        def equilibrium():
            return tuple(np.concatenate(each) for each in zip(*(piece._equilibrium for piece in pieces)))

        return cls(law=pieces[0].law, resolutions=resolutions, equilibrium=equilibrium, **_stacked(pieces, cls))


def _stacked(pieces, cls) -> dict[str, np.ndarray]:
    """Every field that is an array with the sample as its first axis, put one after the other."""
    arrays = [field.name for field in fields(cls) if field.type == "np.ndarray"]
    return {name: np.concatenate([getattr(piece, name) for piece in pieces]) for name in arrays}
