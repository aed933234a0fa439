"""The reduced model that users work with: a reduction that evaluates itself."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from mic.compliance.coefficients import InfluenceCoefficients
from mic.contact import laws
from mic.contact.path_forecast import PathForecast
from mic.errors import ArgumentError, SceneError
from mic.model.assembly import Assembly
from mic.model.reduction import Reduction
from mic.model.rest_rows import RestRows
from mic.process.evaluation import Evaluation, PathSteps, Sensitivities
from mic.process.plan import StagePlan, Step, plan_assembly, plan_stages
from mic.process.process import TOLERANCE, Process
from mic.process.stage import EliminatedStep, eliminate_steps
from mic.process.stiffness import used_stiffness, with_derivatives, with_shape
from mic.scene import Scene, notebook
from mic.scene.deviation import deviation_unit
from mic.scene.stages import unknown
from mic.scene.zone import MOST
from mic.statistics.draw import draw
from mic.system.arguments import checked, number
from mic.system.matrix_product import one_thread
from mic.system.progress_bar import ProgressBar

if TYPE_CHECKING:
    import pandas as pd

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
        stiffness = used_stiffness(assembly.scene, influence)
        if stiffness == "nominal":
            return nominal
        fields, own, slopes = {}, {}, {}
        follows = stiffness == "first-order"
        for part in assembly.parts:
            deviated, along = influence[part.name].deviated, influence[part.name].slopes
            if deviated is None or len(deviated[1].H) != len(part.functionals) or (follows and along is None):
                raise SceneError('stiffness: only "nominal" is available here; leave the key out')
            fields[part.name], own[part.name] = deviated
            slopes[part.name] = along or {}
        mean = nominal.deviations({})[0]
        model = with_shape(nominal, assembly, fields, own, mean)
        return with_derivatives(model, assembly, fields, slopes, mean) if follows else model

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
        """State for a copy or another process, which prepares the laws that it uses itself."""
        return {name: value for name, value in vars(self).items() if name != "_processes"}

    @checked
    def process(
        self, law: str | None = None, tol: float = TOLERANCE, backend: str = "native", threads: int = 1
    ) -> Process:
        """The prepared process under a contact law (default: the first that the scene's report names).

        The other arguments are those of :class:`mic.process.process.Process`.
        """
        law = self.scene.report.laws[0] if law is None else law
        laws.find(law)  # raises
        number("tol", tol, above=0.0)
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

    @cached_property
    def one_step(self) -> ReducedModel | None:
        """This model with all items of each stage closing or opening at once: a cheap approximation of friction.

        None if it is this model, if guns press before welds are made, or if it would leave a part free to move.
        """
        at_once = {"path": "one-step", "increments": None, "order": None, "sequence": False}
        stages = [stage.model_copy(update=at_once) for stage in self.scene.stages]
        followed = any(stage.path != "one-step" for stage in self.scene.stages)
        if not followed or any(weld.gun is not None for weld in self.scene.welds):
            return None
        model = replace(self, scene=self.scene.model_copy(update={"stages": stages}))
        try:
            plan_assembly(model)
        except SceneError:
            return None
        return model

    def __repr__(self) -> str:
        return "\n".join(self._lines)

    def _repr_html_(self) -> str:
        """HTML for notebooks, with a picture of what the model knows: it has no meshes."""
        zones, contacts = self.scene.zones, self.contacts
        pairs = {zone.name: contacts.point[contacts.zone == z] for z, zone in enumerate(zones)}
        return notebook.html(self.scene, self._lines, pairs)

    @property
    def _lines(self) -> list[str]:
        zones, pairs = notebook.named(self.scene.zones, "zone"), len(self.contacts)
        return notebook.lines(self.scene, "ReducedModel", f"{pairs} contact pair{'s' * (pairs != 1)} in {zones}")

    @checked
    def sample(self, samples: int, seed: int | None = None) -> pd.DataFrame:
        """Random deviations of assemblies, as a run draws them: its first samples.

        Parameters
        ----------
        samples : int
        seed : int, optional
            Default: the scene's, `monte_carlo.seed`.

        Returns
        -------
        DataFrame
            A row for each sample, a column for each deviation; ``attrs["units"]`` has their units, N or mm.

        Raises
        ------
        ArgumentError
            If the scene states its samples, and has fewer.
        """
        import pandas as pd  # not needed to evaluate a model

        scene = self.scene
        values = draw(scene, scene.monte_carlo.seed if seed is None else seed, 0, samples)
        if len(values) < samples:
            raise ArgumentError(f"samples is {samples}; the scene states {len(values)} samples: request fewer")
        frame = pd.DataFrame(values, pd.RangeIndex(samples, name="sample"), self.parameters)
        frame.attrs["units"] = {item.name: deviation_unit(item, scene) for item in scene.deviations}
        return frame

    def evaluate(
        self,
        deviations: Any,
        law: str | None = None,
        friction: float | Mapping[str, float] | None = None,
        progress: bool | None = None,
    ) -> Evaluation:
        """Take one assembly, or a batch, through all stages.

        Parameters
        ----------
        deviations : DataFrame, mapping of str to float or (n,) array, (p,) array, or (n, p) array
            A DataFrame with a column for each deviation, in any order, such as :meth:`sample` returns; its index names
            the samples. Or deviations by name, a number for all samples or one for each; missing ones take their means.
            Or an array of all deviations in the order of :attr:`parameters`. Units: N or mm, as in the scene.
        law : str, optional
            Contact law; default: the first of the scene's report.
        friction : float or mapping of str to float, optional
            Coefficients of friction, as :meth:`with_friction` takes them; default: those of the model.
        progress : bool, optional
            Whether a bar is shown; default: after a second, in a notebook or an interactive session.

        Returns
        -------
        Evaluation
            Arrays by sample; its ``to_frame()`` has the names.

        Raises
        ------
        ArgumentError
            For unknown or missing names, wrong shapes, and values that are no finite numbers.
        """
        process = (self if friction is None else self.with_friction(friction)).process(law)
        x = self.deviations(deviations)
        with ProgressBar(progress, len(x)) as bar:
            size = max(10, len(x) // 50) if bar.shown else len(x) or 1
            pieces = []
            for first in range(0, len(x) or 1, size):
                pieces.append(process.evaluate(x[first : first + size]))
                bar.advance(len(pieces[-1].failed))
        found = Evaluation.join(pieces)
        names = getattr(deviations, "index", None) if hasattr(deviations, "columns") else None
        return found if names is None else replace(found, names=replace(found.names, samples=names))

    def with_friction(self, friction: float | Mapping[str, float]) -> ReducedModel:
        """This model with other constant coefficients of friction, in all stages.

        Parameters
        ----------
        friction : float or mapping of str to float
            For all contact zones, or by zone; other zones keep theirs. It replaces friction by stage or pressure.
            Deviations of friction are added to it.

        Raises
        ------
        ArgumentError
            For unknown zones, values that are no coefficients of friction, and models without friction, whose contacts
            have no tangential rows.
        """
        names = [zone.name for zone in self.scene.zones]
        given = friction if hasattr(friction, "items") else dict.fromkeys(names, friction)
        value = {name: number(f"friction: {name!r}", mu, least=0.0) for name, mu in given.items()}
        for name, mu in value.items():
            if name not in names:
                raise ArgumentError("".join(unknown("friction", name, names, "contact zone")))
            if mu > MOST:
                raise ArgumentError(f"friction: {name!r} is {mu:g}; give a coefficient of friction of at most {MOST:g}")
        if self.contacts.dimension == 1 or not names:
            raise ArgumentError(
                f"friction: the model of scene {self.scene.name!r} has no friction, and no tangential contact rows; "
                "give a zone friction in the scene file, and reduce the scene again"
            )
        contacts = self.contacts
        coefficient, pressure = contacts.friction.copy(), contacts.pressure.copy()
        for name, mu in value.items():
            own = contacts.zone == names.index(name)
            coefficient[:, own], pressure[own] = mu, np.nan
        if np.isnan(pressure).all():
            pressure = pressure[:, :0]  # no friction depends on pressure
        zones = [
            zone.model_copy(update={"friction": value[zone.name], "friction_table": None, "friction_power": None})
            if zone.name in value
            else zone
            for zone in self.scene.zones
        ]
        scene = self.scene.model_copy(update={"zones": zones})
        found = replace(self, scene=scene, contacts=replace(contacts, friction=coefficient, pressure=pressure))
        vars(found).update({name: getattr(self, name) for name in ("eliminations", "plans", "rest")})
        return found

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
