"""Results of `mic check`, computed from cached influence coefficients and cached too: a second check solves nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mic.compliance.cache import influence_coefficients, is_cached
from mic.contact.laws import LAWS
from mic.model.assembly_types import Assembly
from mic.model.one_sigma import SourceShape, one_sigma
from mic.process.model import ReducedModel
from mic.studies.order import doubts, few_samples
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format
from mic.system.memoise import memoise

__all__ = ["CheckResults", "RoughSamples"]

MAX_PAIRS = 1000  # contact pairs: with more, a check evaluates no samples, which would take minutes
PATIENCE = 10.0  # s: if a few samples take longer, no further ones are solved
FORMAT = Format("result of a check", 1, ABSENT)
MOST = 24  # cached results and pages

T = TypeVar("T")


@dataclass(frozen=True)
class RoughSamples:
    """A few samples with one increment for each step.

    Attributes
    ----------
    count, solved : int
        Number of samples, and of those with a solution.
    seconds : float
        Time that they took, s.
    doubts : tuple of str
        Sentences of :func:`mic.studies.order.doubts`; none if the samples took longer than :data:`PATIENCE`.
    mean, six_sigma : (k,) array
        Mean and 6σ of the key characteristics, mm.
    forces : dict of str to float
        Largest force or reaction by stage, N.
    """

    count: int
    solved: int
    seconds: float
    doubts: tuple[str, ...]
    mean: np.ndarray
    six_sigma: np.ndarray
    forces: dict[str, float]


class CheckResults:
    """Results of the checks of an assembly, from the disk cache if they are there.

    Parameters
    ----------
    assembly : Assembly
    cache : Path
        The cache folder.
    """

    def __init__(self, assembly: Assembly, cache: Path) -> None:
        self._assembly, self._cache = assembly, cache

    @cached_property
    def all_cached(self) -> bool:
        """Whether the nominal influence coefficients of all parts are cached."""
        return all(is_cached(part, self._cache) for part in self._assembly.parts)

    @cached_property
    def solvable(self) -> bool:
        """Whether a reduced model takes no long computation: nominal stiffness, few pairs, cached coefficients."""
        few = len(self._assembly.contacts) <= MAX_PAIRS
        return self._assembly.scene.stiffness == "nominal" and few and self.all_cached

    @cached_property
    def model(self) -> ReducedModel:
        """The reduced model of a :attr:`solvable` assembly."""
        return ReducedModel.build(self._assembly, influence_coefficients(self._assembly, self._cache)[0])

    def rough_samples(self) -> RoughSamples:
        """A few samples of a :attr:`solvable` assembly."""
        return self._cached("samples", [], (RoughSamples,), self._rough_samples)

    def shapes(self) -> list[SourceShape]:
        """The shapes of the sources; without a model those that need none.

        Raises
        ------
        MissingProvider
        """
        model = lambda: self.model if self.solvable else None
        return self._cached("shapes", [], (SourceShape,), lambda: one_sigma(self._assembly, model()))

    def page(self, inputs: Any, compute: Callable[[], str]) -> str:
        """The text of the page, which depends on these JSON-ready inputs besides the assembly and its shapes."""
        stored = self._cached("page", inputs, (), lambda: np.frombuffer(compute().encode(), np.uint8))
        return stored.tobytes().decode()

    def _cached(self, kind: str, inputs: Any, classes: Sequence[type], compute: Callable[[], T]) -> T:
        scene = self._assembly.scene.model_dump_json()
        key = [self._assembly.identity, scene, self.solvable, kind, inputs]
        return memoise(Cache(self._cache, "checks", FORMAT, MOST), key, {}, classes, compute)[0]

    def _rough_samples(self) -> RoughSamples:
        start = time.perf_counter()
        samples = few_samples(self.model)
        seconds, good = time.perf_counter() - start, ~samples.failed
        values = np.reshape(samples.measurements, (len(good), -1))[good]
        laws = self._assembly.scene.report.laws
        frictional = len(self._assembly.contacts) and any(LAWS[law].frictional for law in laws)
        forces = {
            stage: max(float(np.abs(array[good]).max(initial=0.0)) for array in (one.force, one.reaction))
            for stage, one in samples.resolutions.items()
        }
        return RoughSamples(
            count=len(good),
            solved=int(good.sum()),
            seconds=seconds,
            doubts=tuple(doubts(self.model, samples)) if frictional and good.any() and seconds <= PATIENCE else (),
            mean=values.mean(axis=0) if good.any() else np.zeros(0),
            six_sigma=6 * values.std(axis=0) if good.any() else np.zeros(0),
            forces=forces,
        )
