"""Infer the most probable sources of deviation from measurements of one assembly.

With the sources as functions x(z) of independent standard normal numbers z, key characteristics h, measured values y
and the gauge's standard deviations s, the posterior density of z is exp(−φ) up to a factor,

    φ(z) = ‖z‖²/2 + Σ_k (h_k(x(z)) − y_k)² / 2 (s_k² + e_k²).                                              (1)

h is evaluated at some assemblies only, drawn from the current posterior, and interpolated by a spline
(:mod:`mic.statistics.emulator`). e is the error of the spline at assemblies that were not used for it, together with
the error of a looser path tolerance; assemblies are added until e is small against s.

Modes of (1) are found by the Levenberg-Marquardt method from several starts, because φ has kinks where contacts change
their state and may have several modes. (:func:`scipy.optimize.least_squares` treats one start at a time; here all
starts share the evaluations of the spline.) About each mode the posterior is nearly normal with covariance
C = (1 + JᵀJ)⁻¹. The deviation from it is corrected by adaptive importance sampling [1]_: samples of a mixture q of such
normals have weights exp(−φ)/q, and the mixture is refitted until the effective number of samples is large enough.

References
----------
.. [1] J.-M. Cornuet, J.-M. Marin, A. Mira, C. P. Robert: Adaptive multiple importance sampling, Scand. J. Stat. 39
       (2012) 798-812.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from scipy.special import logsumexp
from scipy.stats import chi2

from mic.contact.path import Followed
from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.process.process import Process
from mic.results.schema import EXPLANATION, FURTHER
from mic.scene import Scene
from mic.scene.deviation import FrictionDeviation
from mic.statistics.emulator import Emulator
from mic.statistics.estimates import LEVEL
from mic.statistics.normal_space import from_normal
from mic.studies.samples import Progress, key_characteristics
from mic.system.arguments import checked

__all__ = ["Explanation", "Posterior", "explain", "posterior", "with_friction"]

STARTS = 32  # starts of the search for modes: the means, and random ones
MODES = 8  # largest number of modes in the mixture
STEPS = 40  # iterations of Levenberg-Marquardt
STEEP, FLAT = 10.0, 0.3  # factors of the damping λ after a failed and after a successful step
STILL = 1e-9  # decrease of φ at which the iteration stops
UNLIKELY = 10.0  # distance of φ from its minimum above which a mode is neglected
SAME_MODE = 0.1  # distance in standard deviations below which two modes are the same
ROUND = 1000  # samples per round of importance sampling
ROUNDS = 10
ENOUGH = 2000.0  # effective samples: shares of 0.95 then have a standard error of 0.005
WIDE = 2.0  # factor on the covariance for the share WIDE_SHARE of the samples, to cover the tails
WIDE_SHARE = 0.2
FIRST = 8  # first assemblies, in addition to 3/2 of each number
BATCH = 16  # assemblies per refinement of the spline
BATCHES = 8
#: largest e relative to the gauge's standard deviation. Results are stated to two digits at most, which rounds them by
#: up to 5 %; a standard deviation grows by as much if e is √(1.05² − 1) = 0.32 of the gauge's.
CLOSE = 0.3
LOOSE = (2e-2, 5e-3, 1e-3)  # path tolerances to try, the loosest first
LOOSENED = CLOSE / 2  # largest error of a looser path, relative to the gauge: a quarter of e²
PROBES = 4  # assemblies at which the error of a looser path is estimated
TOGETHER = 0.9  # correlation above which two sources cannot be told apart
KNOWN = 0.75  # reduction of variance above which a source counts as known
UNDETERMINED = 0.9  # ratio of posterior to prior standard deviation above which a source counts as undetermined


@dataclass(frozen=True)
class Posterior:
    """Samples of (1).

    Attributes
    ----------
    z : (n, p) array
    response : (n, k) array
        All key characteristics, mm.
    misfit : (n,) array
        φ.
    weight : (n,) array
        Their sum is 1.
    best : (p,) array
        The most probable z.
    least : float
        φ at `best`, from an evaluation of h.
    target : _Target
        φ with the spline for h.
    error : (k,) array
        e of (1) for all key characteristics, mm.
    evaluations : int
        Evaluations of an assembly.
    """

    z: np.ndarray
    response: np.ndarray
    misfit: np.ndarray
    weight: np.ndarray
    best: np.ndarray
    least: float
    target: _Target = field(repr=False)
    error: np.ndarray = field(default_factory=lambda: np.empty(0))
    evaluations: int = 0

    @property
    def count(self) -> float:
        """Effective number of independent samples."""
        return float(1 / np.sum(self.weight**2))

    def holds(self, z: np.ndarray) -> bool:
        """Whether the region of highest density with 95 % of the posterior contains z (p,)."""
        return bool(self.target.misfit(z[None])[0] <= _quantile(self.misfit, self.weight, LEVEL))


@dataclass(frozen=True)
class Explanation:
    """Sources of the measured deviations of one assembly.

    Attributes
    ----------
    law : str
    table : DataFrame
        By source, as :data:`mic.results.schema.EXPLANATION` declares it, the most unusual first.
    further : DataFrame
        Further measurements, as :data:`mic.results.schema.FURTHER` declares it, the most informative first.
    reached : DataFrame
        By key characteristic: ``measurement``, ``measured`` (NaN if it was not), ``gauge``, and the posterior ``mean``
        and ``sigma``, mm.
    likely : float
        Probability (p-value) that an assembly of this scene has a misfit at least as large: near 0 if the model does
        not explain the measurements.
    together : list of tuple of str
        Pairs of sources that cannot be told apart: only their sum or difference is determined.
    untold : list of str
        Sources that the measurements hardly determine.
    posterior : Posterior
    scene : Scene
        Scene whose deviations are the sources, including unknown friction.
    """

    law: str
    table: pd.DataFrame
    further: pd.DataFrame
    reached: pd.DataFrame
    likely: float
    together: list[tuple[str, str]]
    untold: list[str]
    posterior: Posterior
    scene: Scene


@checked
def explain(
    model: ReducedModel,
    measured: Mapping[str, float],
    gauge: float | Mapping[str, float],
    law: str | None = None,
    friction: float | None = None,
    seed: int = 0,
    threads: int = 1,
    progress: Progress = lambda count: None,
) -> Explanation:
    """Find the most probable sources of the measured deviations.

    Parameters
    ----------
    model : ReducedModel
    measured : mapping of str to float
        Key characteristics by name, mm from nominal.
    gauge : float, or mapping of str to float
        Standard deviation of the gauge, mm: one for all measurements, or by name.
    law : str, optional
        Contact law; default: the first of the scene's report.
    friction : float, optional
        Standard deviation of the zones' coefficients of friction, if they are unknown as well.
    seed, threads : int
    progress : callable or bool, optional
        Called with the number of evaluations after each batch; or whether a bar is shown.

    Raises
    ------
    SceneError
        If a measurement is not in the scene, a gauge is missing or not positive, or nothing varies.
    """
    if friction is not None:
        model = with_friction(model, friction)
    scene = model.scene
    names = [item.name for item in scene.measurements]
    gauges = dict.fromkeys(measured, gauge) if isinstance(gauge, int | float) else dict(gauge)
    _check_input(scene, measured, gauges, names)
    columns = [names.index(name) for name in measured]
    y, gauge_sigma = np.array([measured[n] for n in measured]), np.array([gauges[n] for n in measured])
    result = posterior(model, columns, y, gauge_sigma, law, seed, threads, progress)
    x, w = from_normal(scene, result.z), result.weight
    varied = [j for j, item in enumerate(scene.deviations) if item.sigma > 0]
    table = _source_table(scene, x, w, varied)
    h, spread = _moments(result.response, w)
    reached = pd.DataFrame(
        {
            "measurement": names,
            "measured": [measured.get(name, np.nan) for name in names],
            "gauge": [gauges.get(name, np.nan) for name in names],
            "mean": h,
            "sigma": spread,
        }
    )
    reduction = dict(zip(table["source"], table["told"]))
    return Explanation(
        law=law or scene.report.laws[0],
        table=table,
        further=_further_measurements(scene, names, measured, float(np.median(gauge_sigma)), result, x, varied),
        reached=reached,
        likely=float(chi2.sf(2 * result.least, len(columns))),
        together=_indistinguishable_pairs([scene.deviations[j].name for j in varied], x[:, varied], w, reduction),
        untold=[name for name, share in reduction.items() if share < 1 - UNDETERMINED**2],
        posterior=result,
        scene=scene,
    )


def _source_table(scene: Scene, x: np.ndarray, w: np.ndarray, varied: list[int]) -> pd.DataFrame:
    """Prior and posterior of each source that varies, the most unusual first."""
    mean, sigma = _moments(x, w)
    rows = [
        {
            "source": item.name,
            "prior_mean": item.mean,
            "prior_sigma": item.sigma,
            "mean": mean[j],
            "sigma": sigma[j],
            "low": _quantile(x[:, j], w, (1 - LEVEL) / 2),
            "high": _quantile(x[:, j], w, (1 + LEVEL) / 2),
            "off": (mean[j] - item.mean) / item.sigma,
            "told": max(0.0, 1 - (sigma[j] / item.sigma) ** 2),  # negative values are sampling noise
        }
        for j, item in ((j, scene.deviations[j]) for j in varied)
    ]
    table = pd.DataFrame(rows, columns=EXPLANATION.names)
    return table.sort_values("off", key=abs, ascending=False, kind="stable", ignore_index=True)


def _indistinguishable_pairs(
    names: list[str], x: np.ndarray, w: np.ndarray, reduction: Mapping[str, float]
) -> list[tuple[str, str]]:
    """Pairs of strongly correlated sources, neither of which is known by itself."""
    correlated = np.argwhere(np.triu(np.abs(_correlation(x, w)) > TOGETHER, 1))
    pairs = [(names[i], names[j]) for i, j in correlated]
    return [(a, b) for a, b in pairs if max(reduction[a], reduction[b]) < KNOWN]


def with_friction(model: ReducedModel, sigma: float) -> ReducedModel:
    """A model in which the friction of each zone varies independently, with a coefficient of at least 0."""
    scene = model.scene
    items = []
    for zone in scene.zones:
        if zone.frictional and zone.pressure_pieces() is None:
            name, range_ = f"friction of {zone.name}".replace(" ", "_"), (-float(zone.coefficient("default")), 10.0)
            items.append(FrictionDeviation(name=name, kind="friction", target=zone.name, sigma=sigma, truncated=range_))
    if not items:
        raise SceneError(f"scene {scene.name!r}: no zone has constant friction; omit --friction")
    taken = {item.name for item in scene.deviations} & {item.name for item in items}
    if taken:
        raise SceneError(f"deviations: the name {min(taken)!r} is needed by --friction; rename the deviation")
    return model.varied(scene.model_copy(update={"deviations": [*scene.deviations, *items]}))


def _check_input(scene: Scene, measured, gauges, names) -> None:
    if not measured:
        raise SceneError(f"scene {scene.name!r}: no measurement is given; give at least one key characteristic")
    for name in measured:
        if name not in names:
            raise SceneError(f"scene {scene.name!r} has no key characteristic {name!r}; it has: {', '.join(names)}")
        if not gauges.get(name, 0.0) > 0 or not np.isfinite(gauges[name]):
            raise SceneError(f"{name}: the gauge has no positive standard deviation; give one, mm")
    if not any(item.sigma > 0 for item in scene.deviations):
        raise SceneError(f"scene {scene.name!r}: no deviation varies, so there are no possible sources; add deviations")


# ----------------------------------------------------------------------------------------------------- the posterior


def posterior(
    model: ReducedModel,
    columns: list[int],
    y: np.ndarray,
    s: np.ndarray,
    law: str | None = None,
    seed: int = 0,
    threads: int = 1,
    progress: Progress = lambda count: None,
) -> Posterior:
    """Sample the posterior (1).

    Parameters
    ----------
    model : ReducedModel
    columns : list of int
        Numbers of the measured key characteristics.
    y, s : (k,) array
        Measured values and standard deviations of the gauge, mm.
    law, seed, threads, progress
        As in :func:`explain`.

    Raises
    ------
    SceneError
        If too few assemblies can be computed.
    """
    stream = np.random.Generator(np.random.Philox(key=np.array([seed, len(columns)], dtype=np.uint64)))
    evaluations = _ModelEvaluations(model, law, threads, progress)
    p = len(model.scene.deviations)
    z = stream.standard_normal((p + p // 2 + FIRST, p))
    z[0] = 0.0
    loosened = evaluations.loosen_path(z[:PROBES], columns, s)
    evaluations.add(z)
    fresh = stream.standard_normal((BATCH, p))  # the first batch comes from the prior
    for _ in range(BATCHES):
        error = np.hypot(evaluations.add(fresh), loosened)
        target = _Target(evaluations.emulator(), columns, y, np.hypot(s, error[columns]))
        found = _sampled(target, stream, p)
        if (error[columns] <= CLOSE * s).all():
            break
        known = np.count_nonzero(found.weight)
        fresh = found.z[stream.choice(len(found.z), min(BATCH, known), replace=False, p=found.weight)]
    exact = evaluations.evaluate(evaluations.exact, found.best[None])
    least = float(target.misfit(found.best[None], exact)[0]) if np.isfinite(exact).all() else found.least
    return replace(found, least=least, error=error, evaluations=evaluations.count)


def _sampled(target: _Target, stream: np.random.Generator, p: int) -> Posterior:
    """Sample (1) with the spline for h, by adaptive multiple importance sampling."""
    starts = stream.standard_normal((STARTS, p))
    starts[0] = 0.0
    modes = target.modes(starts)
    modes = [mode for mode in modes[:MODES] if mode[1] <= modes[0][1] + UNLIKELY]
    components = [(z, covariance, -misfit + 0.5 * np.linalg.slogdet(covariance)[1]) for z, misfit, covariance in modes]
    drawn: list[np.ndarray] = []
    responses: list[np.ndarray] = []
    mixtures: list[list] = []
    for _ in range(ROUNDS):
        mixtures.append(components)
        drawn.append(_draw(components, stream, ROUND))
        responses.append(target.emulator(drawn[-1]))
        z, response = np.concatenate(drawn), np.concatenate(responses)
        φ = target.misfit(z, response)
        # The weight of each sample refers to the mixture of the proposals of all rounds.
        q = logsumexp([_log_density(mixture, z) for mixture in mixtures], axis=0)
        weight = np.exp(-φ - q - logsumexp(-φ - q))
        best, least = (z[int(φ.argmin())], float(φ.min())) if φ.min() < modes[0][1] else modes[0][:2]
        result = Posterior(z, response, φ, weight, best, least, target)
        if result.count >= ENOUGH:
            break
        components = [*components[: len(modes)], _fitted(result, modes[0][2])]
    return result


class _ModelEvaluations:
    """Evaluated assemblies, and the spline through them."""

    def __init__(self, model, law, threads, progress):
        self._model, self._law, self._threads, self._progress = model, law, threads, progress
        self.exact = self._process = model.process(law, threads=threads)  # on the scene's own path tolerance
        self._z, self._h = np.empty((0, len(model.scene.deviations))), np.empty((0, len(model.scene.measurements)))
        self.count = 0

    def loosen_path(self, z: np.ndarray, columns: list[int], s: np.ndarray) -> np.ndarray:
        """Choose the loosest path tolerance whose error is small against the gauge; returns its error (k,), mm."""
        none = np.zeros(self._h.shape[1])
        if not any(isinstance(stage.path, Followed) for stage in self.exact.stages):
            return none
        exact = self.evaluate(self.exact, z)
        for tolerance in LOOSE:
            if tolerance <= self._model.scene.path.tolerance:
                break
            loose = Process(self._model, self.exact.law, threads=self._threads, path_tolerance=tolerance)
            error = np.sqrt(np.nanmean((self.evaluate(loose, z) - exact) ** 2, axis=0))
            if (error[columns] <= LOOSENED * s).all():
                self._process = loose
                return error
        return none

    def add(self, z: np.ndarray) -> np.ndarray:
        """Evaluate assemblies (n, p) and add them to the spline.

        Returns the root mean square error (k,) at them of the spline before, mm; infinite if there was none."""
        h = self.evaluate(self._process, z)
        known = np.isfinite(h).all(axis=1)
        error = np.full(h.shape[1], np.inf)
        if len(self._z) and known.any():
            error = np.sqrt(((self.emulator()(z[known]) - h[known]) ** 2).mean(axis=0))
        self._z, self._h = np.concatenate([self._z, z[known]]), np.concatenate([self._h, h[known]])
        return error

    def emulator(self) -> Emulator:
        """The spline through all evaluated assemblies."""
        n, p = self._z.shape
        if n < p + 2:
            raise SceneError(
                f"scene {self._model.scene.name!r}: only {n} assemblies can be computed, too few to infer sources; see "
                "the messages of `mic run` on the others"
            )
        return Emulator(self._z, self._h)

    def evaluate(self, process: Process, z: np.ndarray) -> np.ndarray:
        """Key characteristics (n, k); NaN for assemblies that cannot be computed."""
        self.count += len(z)
        return key_characteristics(process, from_normal(self._model.scene, z), self._progress)


class _Target:
    """φ of (1) and its modes."""

    def __init__(self, emulator: Emulator, columns: list[int], y: np.ndarray, spread: np.ndarray):
        self.emulator, self._columns, self._y, self._spread = emulator, columns, y, spread

    def misfit(self, z: np.ndarray, response: np.ndarray | None = None) -> np.ndarray:
        """φ (n,) of z (n, p); key characteristics (n, k) default to those of the spline."""
        response = self.emulator(z) if response is None else response
        return 0.5 * (z**2).sum(axis=1) + 0.5 * (self._residual(response) ** 2).sum(axis=1)

    def _residual(self, response: np.ndarray) -> np.ndarray:
        return (response[:, self._columns] - self._y) / self._spread

    def modes(self, z: np.ndarray) -> list[tuple[np.ndarray, float, np.ndarray]]:
        """Distinct modes found from the starts (n, p): position (p,), φ and covariance (p, p), the best first."""
        p = z.shape[1]
        φ, λ = self.misfit(z), np.full(len(z), 1e-2)
        J, r = self._slopes(z)
        active = np.ones(len(z), dtype=bool)
        for _ in range(STEPS):
            gradient = z + np.einsum("nkp,nk->np", J, r)
            curvature = np.eye(p) + np.einsum("nkp,nkq->npq", J, J)
            damped = curvature + λ[:, None, None] * np.eye(p)
            trial = z - np.linalg.solve(damped, gradient[..., None])[..., 0]
            new = np.full(len(z), np.inf)
            new[active] = self.misfit(trial[active])
            better = active & (new < φ)
            decrease = np.where(better, φ - np.where(better, new, 0.0), 0.0)
            λ = np.where(better, np.maximum(λ * FLAT, 1e-12), λ * STEEP)
            z, φ = np.where(better[:, None], trial, z), np.where(better, new, φ)
            active &= ~(better & (decrease < STILL)) & (λ < 1e8)
            if better.any():
                J[better], r[better] = self._slopes(z[better])
            if not active.any():
                break
        distinct: list[tuple[np.ndarray, float, np.ndarray]] = []
        for i in np.argsort(φ, kind="stable"):
            covariance = np.linalg.inv(np.eye(p) + J[i].T @ J[i])
            root = np.linalg.cholesky(covariance)
            if all(np.linalg.norm(np.linalg.solve(root, z[i] - other)) > SAME_MODE for other, _, _ in distinct):
                distinct.append((z[i], float(φ[i]), covariance))
        return distinct

    def _slopes(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Scaled derivatives J (n, k, p) and residuals r (n, k)."""
        return self.emulator.slopes(z)[:, self._columns] / self._spread[:, None], self._residual(self.emulator(z))


def _shares(components) -> np.ndarray:
    logs = np.array([component[2] for component in components])
    return np.exp(logs - logsumexp(logs))


def _draw(components, stream, count: int) -> np.ndarray:
    """(n, p) samples of a mixture, a fifth of them with a wider covariance."""
    p = len(components[0][0])
    which = stream.choice(len(components), count, p=_shares(components))
    size = np.where(stream.random(count) < WIDE_SHARE, np.sqrt(WIDE), 1.0)
    ξ = stream.standard_normal((count, p)) * size[:, None]
    roots = [np.linalg.cholesky(covariance) for _, covariance, _ in components]
    return np.stack([components[k][0] + roots[k] @ point for k, point in zip(which, ξ)])


def _log_density(components, z: np.ndarray) -> np.ndarray:
    """(n,) logarithm of the density of the samples of :func:`_draw`."""
    terms, p = [], z.shape[1]
    for (centre, covariance, _), share in zip(components, _shares(components)):
        root = np.linalg.cholesky(covariance)
        square = (np.linalg.solve(root, (z - centre).T) ** 2).sum(axis=0)
        size = np.log(np.diag(root)).sum() + 0.5 * p * np.log(2 * np.pi)
        for part, factor in ((1 - WIDE_SHARE, 1.0), (WIDE_SHARE, WIDE)):
            log_part = np.log(max(share, 1e-300) * part)
            terms.append(log_part - 0.5 * square / factor - size - 0.5 * p * np.log(factor))
    return np.asarray(logsumexp(terms, axis=0))


def _fitted(samples: Posterior, known: np.ndarray):
    """A component fitted to the samples so far, shrunk towards the covariance `known` if few samples are effective."""
    p = samples.z.shape[1]
    mean = samples.weight @ samples.z
    difference = samples.z - mean
    covariance = (difference * samples.weight[:, None]).T @ difference
    trust = samples.count / (samples.count + p + 1)
    return mean, trust * covariance + (1 - trust) * known, 0.0


# --------------------------------------------------------------------------------------------------------- tables


def _further_measurements(scene, names, measured, gauge: float, samples: Posterior, x, varied) -> pd.DataFrame:
    """Information that each unmeasured characteristic would give, by a gauge like those that were used."""
    w, rows = samples.weight, []
    _, spread = _moments(samples.response, w)
    for k, name in enumerate(names):
        if name not in measured:
            share = spread[k] ** 2 / (spread[k] ** 2 + gauge**2)
            columns = np.column_stack([x[:, varied], samples.response[:, k]])
            reduction = np.nan_to_num(_correlation(columns, w)[-1, :-1]) ** 2 * share
            source = int(reduction.argmax())
            bits = 0.5 * np.log2(1 + (spread[k] / gauge) ** 2)
            rows.append((name, spread[k], bits, scene.deviations[varied[source]].name, reduction[source]))
    table = pd.DataFrame(rows, columns=["measurement", "sigma", "bits", "source", "told"])[FURTHER.names]
    table = table if rows else FURTHER.empty()
    return table.sort_values("bits", ascending=False, kind="stable", ignore_index=True)


def _moments(x: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean = w @ x
    return mean, np.sqrt(np.maximum(w @ (x - mean) ** 2, 0.0))


def _correlation(x: np.ndarray, w: np.ndarray) -> np.ndarray:
    mean, sigma = _moments(x, w)
    standardised = (x - mean) / np.where(sigma > 0, sigma, np.inf)
    return (standardised * w[:, None]).T @ standardised


def _quantile(x: np.ndarray, w: np.ndarray, share: float) -> float:
    order = np.argsort(x, kind="stable")
    return float(np.interp(share, np.cumsum(w[order]) - 0.5 * w[order], x[order]))
