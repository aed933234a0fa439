"""The reduced model that users work with: a reduction that evaluates itself."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from mic.compliance.coefficients import InfluenceCoefficients
from mic.contact import laws
from mic.contact.working_set import PathForecast
from mic.errors import ArgumentError, SceneError
from mic.model.assembly import Assembly
from mic.model.reduction import Reduction
from mic.model.rest_rows import RestRows
from mic.process.actions import Joints
from mic.process.evaluation import Evaluation, PathSteps, Sensitivities
from mic.process.plan import StagePlan, Step, plan_stages
from mic.process.process import TOLERANCE, Process
from mic.process.stage import EliminatedStep, eliminate_steps
from mic.process.stiffness import with_derivatives, with_shape
from mic.scene import Scene
from mic.system.arguments import number
from mic.system.matrix_product import one_thread

__all__ = ["ReducedModel"]


class ReducedModel(Reduction):
    """The reduced model of an assembly; attributes as in :class:`mic.model.reduction.Reduction`.

    Everything prepared for a contact law is cached.
    """

    @classmethod
    def build(cls, assembly: Assembly, influence: dict[str, InfluenceCoefficients]) -> Self:
        """As :meth:`mic.model.reduction.Reduction.build`, with the stiffness that the scene requests.

        Raises
        ------
        ValueError
            As there.
        SceneError
            If the coefficients do not include that stiffness.
        """
        nominal = super().build(assembly, influence)
        if assembly.scene.stiffness == "nominal":
            return nominal
        fields, own, slopes = {}, {}, {}
        follows = assembly.scene.stiffness == "first-order"
        for part in assembly.parts:
            deviated, along = influence[part.name].deviated, influence[part.name].slopes
            if deviated is None or len(deviated[1].H) != len(part.functionals) or (follows and along is None):
                raise SceneError('stiffness: only "nominal" is available here; leave the key out')
            fields[part.name], own[part.name] = deviated
            slopes[part.name] = along or {}
        mean = nominal.deviations({})[0]
        model = with_shape(nominal, assembly, fields, own, mean)
        return with_derivatives(model, assembly, fields, slopes, mean) if follows else model

    @property
    def joints(self) -> Joints:
        """The rows of each weld."""
        return Joints(tuple(self.weld_size))

    @cached_property
    def plans(self) -> list[StagePlan]:
        """The stages of the scene; cached, since finding the resting parts takes time."""
        return plan_stages(self.scene, self.weld_size)

    @cached_property
    def rest(self) -> RestRows:
        """Rest rows of the parts that rest by contact alone in some step."""
        steps = [step for plan in self.plans for step in plan.steps]
        return RestRows.of(self, self.compliance, {part for step in steps for part in step.resting})

    @cached_property
    @one_thread
    def eliminations(self) -> dict[str, list[EliminatedStep]]:
        """The steps of every stage with their bilateral rows eliminated, once for all contact laws."""
        return eliminate_steps(self, self.plans)

    @cached_property
    @one_thread
    def forecast(self) -> dict[tuple[str, Step], PathForecast]:
        """Results of a few fixed samples, by stage and step, for all contact laws."""
        return Process.predict_working_sets(self)

    @cached_property
    def _processes(self) -> dict[tuple, Process]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """What a copy or another process needs; it prepares the laws that it uses itself."""
        return {name: value for name, value in vars(self).items() if name != "_processes"}

    def process(
        self, law: str | None = None, tol: float = TOLERANCE, backend: str = "native", threads: int = 1
    ) -> Process:
        """The prepared process under a contact law (default: the first that the scene's report names).

        The other arguments are those of :class:`mic.process.process.Process`.
        """
        law = self.scene.report.laws[0] if law is None else law
        laws.find(law)  # raises
        key = (law, tol, backend, threads)
        if key not in self._processes:
            self._processes[key] = Process(self, *key)
        return self._processes[key]

    def varied(self, scene: Scene) -> ReducedModel:
        """The model of a scene with further deviations that do not change any shape; the eliminations are shared.

        Parameters
        ----------
        scene : Scene
            Its first deviations are those of this model.
        """
        none = np.zeros((len(self.shape), len(scene.deviations) - len(self.scene.deviations)))
        shape, forces = (np.column_stack([known, none]) for known in (self.shape, self.shape_forces))
        found = replace(self, scene=scene, shape=shape, shape_forces=forces)
        vars(found).update({name: getattr(self, name) for name in ("eliminations", "forecast", "rest")})
        return found

    def evaluate(self, deviations: Any, law: str | None = None) -> Evaluation:
        """Take one assembly, or a batch, through all stages.

        Parameters
        ----------
        deviations
            As :meth:`mic.model.reduction.Reduction.deviations` takes them: numbers or arrays by name, or an array.
        law : str, optional
            Contact law; default: the first of the scene's report.

        Raises
        ------
        ArgumentError
            For unknown names, wrong shapes, and values that are no finite numbers.
        """
        return self.process(law).evaluate(self.deviations(deviations))

    def sensitivities(
        self,
        deviations: Any,
        law: str | None = None,
        inputs: Sequence[str] | Mapping[str, float] | None = None,
        steps: PathSteps | None = None,
    ) -> Sensitivities:
        """Exact derivatives of the results of :meth:`evaluate` (:mod:`mic.process.sensitivity`).

        Parameters
        ----------
        deviations, law
            As in :meth:`evaluate`.
        inputs : sequence of str, or mapping of str to float, optional
            Inputs of the derivatives: names of deviations, ``locators.NAME``, ``clamps.NAME``, ``zones.NAME.friction``
            and others (:mod:`mic.process.inputs`); with standard deviations of their own, or those of the scene.
            Default: all deviations.
        steps : mapping, optional
            Path steps to be retraced: :attr:`mic.process.evaluation.Sensitivities.steps` of samples nearby.

        Raises
        ------
        ArgumentError
            As :meth:`evaluate`; if an input is unknown, or there is no sample.
        SceneError
            If parts rest by contact alone, and positions in sheets are inputs.
        """
        from mic.process.sensitivity import sensitivities  # its compiled code is not needed by a run

        if isinstance(inputs, str) or not isinstance(inputs, Iterable | None):
            raise ArgumentError(f"inputs is {inputs!r}; give a list of names, or standard deviations by name")
        if isinstance(inputs, Mapping):
            inputs = {name: number(f"inputs: {name!r}", sigma, least=0.0) for name, sigma in inputs.items()}
        samples = self.deviations(deviations)
        if not len(samples):
            raise ArgumentError("deviations: there is no sample; give at least one")
        return sensitivities(self.process(law), samples, inputs, steps)

    @property
    def H(self) -> np.ndarray:
        """(F, F) compliance with all its zeros; deprecated, use :attr:`compliance`."""
        return self._dense("H", 0)

    @property
    def G(self) -> np.ndarray:
        """(F, 6P) rigid-body readings with all their zeros; deprecated, use :attr:`compliance`."""
        return self._dense("G", 1)

    @property
    def offsets(self) -> np.ndarray:
        """(P + 1,) first functional of each part, and F at the end; deprecated, use :attr:`compliance`."""
        warnings.warn("ReducedModel.offsets is now ReducedModel.compliance.offsets", DeprecationWarning, stacklevel=2)
        return self.compliance.offsets

    def _dense(self, name, index):
        warnings.warn(
            f"ReducedModel.{name} is stored by parts: use ReducedModel.compliance (its dense() has the whole)",
            DeprecationWarning,
            stacklevel=3,
        )
        return self.compliance.dense()[index]
