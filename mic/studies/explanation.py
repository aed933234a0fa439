"""From what was measured on an assembly back to its most probable sources.

With the sources as functions x(z) of independent standard normal numbers z, key characteristics h, measured values y
and the gauge's standard deviations s, the posterior density of z is exp(−φ) up to a factor,

    φ(z) = ‖z‖²/2 + Σ_k (h_k(x(z)) − y_k)² / 2 (s_k² + e_k²).                                              (1)

h is asked for at some assemblies only, drawn from the posterior as it is known so far, and is a spline between them
(:mod:`mic.statistics.emulator`). e is what the spline errs by at assemblies that it had not seen, and what a looser path
errs by: both are found before they are trusted, and added until e is small against s.

Modes of (1) are found by Levenberg and Marquardt's method from several starts: where contacts change their state, φ has
kinks and may have several. About each mode the posterior is nearly normal with covariance C = (1 + JᵀJ)⁻¹; what kinks
make of it is told by importance sampling [1]_: samples of a mixture q of such normals weigh exp(−φ)/q, and the mixture
is fitted to them anew until enough of them count.

References
----------
.. [1] J.-M. Cornuet, J.-M. Marin, A. Mira, C. P. Robert: Adaptive multiple importance sampling, Scand. J. Stat. 39
       (2012) 798-812.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
from mic.statistics.emulator import Emulator
from mic.statistics.estimates import LEVEL
from mic.statistics.normal_space import from_normal

__all__ = ["Explanation", "Posterior", "explain", "posterior", "with_friction"]

STARTS = 32  # the means, and random ones
MODES = 8  # of those found, the most probable
STEPS = 40  # of Levenberg and Marquardt
STEEP, FLAT = 10.0, 0.3  # by which λ grows after a step that failed, and shrinks after one that did not
STILL = 1e-9  # of φ: a step that gains no more is the last
UNLIKELY = 10.0  # above the least φ: a mode there has no weight
APART = 0.1  # of its own standard deviations: modes that are no farther apart are one
ROUND = 1000  # samples of a round
ROUNDS = 10
ENOUGH = 2000.0  # samples that count: shares of 0.95 are known to 0.005 then
WIDE = 2.0  # of the covariance: a fifth of the samples are drawn so much wider, for tails
WIDE_SHARE = 0.2
FIRST = 8  # assemblies to begin with, beside 3/2 of each number
BATCH = 16  # assemblies between two looks
BATCHES = 8
#: of the gauge's standard deviation: what e may be. Uncertainties are told to two digits at most, which rounds them by
#: up to 5 %; so much wider e makes them where it is √(1.05² − 1) = 0.32 of the gauge's
CLOSE = 0.3
LOOSE = (2e-2, 5e-3, 1e-3)  # tolerances of the path, the loosest first
LOOSENED = CLOSE / 2  # the same of a looser path alone: a quarter of e², the spline has the other three
PROBES = 4  # assemblies at which that is looked at
TOGETHER = 0.9  # correlation of sources that the measurement cannot tell apart
KNOWN = 0.75  # of its variance taken away: half of the standard deviation is left, and a source counts as known
UNTOLD = 0.9  # of its standard deviation: what keeps more of it is not told


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
        φ there, evaluated.
    target : _Target
        φ itself, with what was learnt of h.
    error : (k,) array
        e of (1), of all key characteristics, mm.
    evaluations : int
        What it took.
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
        """Independent samples that would tell as much."""
        return float(1 / np.sum(self.weight**2))

    def level(self, share: float = LEVEL) -> float:
        """The φ below which the densest region lies that holds this share of the posterior."""
        return _quantile(self.misfit, self.weight, share)

    def holds(self, z: np.ndarray, share: float = LEVEL) -> bool:
        """Whether the densest region that holds this share of the posterior holds numbers z (p,)."""
        return bool(self.target.misfit(z[None])[0] <= self.level(share))


@dataclass(frozen=True)
class Explanation:
    """What was found of one assembly.

    Attributes
    ----------
    law : str
    table : DataFrame
        By source, as :data:`mic.results.schema.EXPLANATION` declares it, the most unusual first.
    further : DataFrame
        What else could be measured, as :data:`mic.results.schema.FURTHER` declares it, the most telling first.
    reached : DataFrame
        By key characteristic: ``measurement``, ``measured`` (NaN where it was not), ``gauge``, and ``mean`` and
        ``sigma`` of what the sources that were found give, mm.
    likely : float
        Probability that an assembly of this scene, measured so, is at least as far off as this one: near 0 where the
        model does not explain what was measured.
    together : list of tuple of str
        Pairs of sources that the measurement does not tell apart: only a sum or difference of them.
    untold : list of str
        Sources of which it tells hardly anything.
    posterior : Posterior
    scene : Scene
        Whose deviations are the sources, unknown friction among them.
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


def explain(
    model: ReducedModel,
    measured: Mapping[str, float],
    gauge: float | Mapping[str, float],
    law: str | None = None,
    friction: float | None = None,
    seed: int = 0,
    threads: int = 1,
    progress: Callable[[int], None] = lambda count: None,
) -> Explanation:
    """Find the most probable sources of what was measured.

    Parameters
    ----------
    model : ReducedModel
    measured : mapping of str to float
        Key characteristics by name, mm from nominal.
    gauge : float, or mapping of str to float
        Standard deviation of the gauge, mm: of all, or by name.
    law : str, optional
        Contact law; default: the first of the scene's report.
    friction : float, optional
        Standard deviation of the coefficients of friction of the zones, should they be unknown as well.
    seed, threads : int
    progress : callable, optional
        Called with the number of evaluations that were done.

    Raises
    ------
    SceneError
        If something was measured that the scene does not have, a gauge is missing or not positive, or nothing varies.
    """
    if friction is not None:
        model = with_friction(model, friction)
    scene = model.scene
    names = [item.name for item in scene.measurements]
    gauges = dict.fromkeys(measured, gauge) if isinstance(gauge, int | float) else dict(gauge)
    _judge(scene, measured, gauges, names)
    own = [names.index(name) for name in measured]
    y, s = np.array([measured[n] for n in measured]), np.array([gauges[n] for n in measured])
    found = posterior(model, own, y, s, law, seed, threads, progress)
    x, w = from_normal(scene, found.z), found.weight
    mean, sigma = _moments(x, w)
    varied = [j for j, item in enumerate(scene.deviations) if item.sigma > 0]
    table = pd.DataFrame(
        [
            {
                "source": item.name,
                "prior_mean": item.mean,
                "prior_sigma": item.sigma,
                "mean": mean[j],
                "sigma": sigma[j],
                "low": _quantile(x[:, j], w, (1 - LEVEL) / 2),
                "high": _quantile(x[:, j], w, (1 + LEVEL) / 2),
                "off": (mean[j] - item.mean) / item.sigma,
                "told": max(0.0, 1 - (sigma[j] / item.sigma) ** 2),  # below 0 it is noise
            }
            for j in varied
            for item in [scene.deviations[j]]
        ],
        columns=EXPLANATION.names,
    )
    table = table.sort_values("off", key=abs, ascending=False, kind="stable", ignore_index=True)
    h, spread = _moments(found.response, w)
    reached = pd.DataFrame(
        {
            "measurement": names,
            "measured": [measured.get(name, np.nan) for name in names],
            "gauge": [gauges.get(name, np.nan) for name in names],
            "mean": h,
            "sigma": spread,
        }
    )
    correlation = _correlation(x[:, varied], w)
    told = {row["source"]: row["told"] for row in table.to_dict("records")}
    untold = [name for name, share in told.items() if share < 1 - UNTOLD**2]
    pairs = [
        (scene.deviations[varied[i]].name, scene.deviations[varied[j]].name)
        for i, j in np.argwhere(np.triu(np.abs(correlation) > TOGETHER, 1))
        if max(told[scene.deviations[varied[k]].name] for k in (i, j)) < KNOWN
    ]
    return Explanation(
        law or scene.report.laws[0],
        table,
        _further(scene, names, measured, float(np.median(s)), found, x, varied),
        reached,
        float(chi2.sf(2 * found.least, len(own))),
        pairs,
        untold,
        found,
        scene,
    )


def with_friction(model: ReducedModel, sigma: float) -> ReducedModel:
    """A model whose zones' coefficients of friction vary as well, each by itself, never below 0."""
    scene = model.scene
    items = [
        {
            "name": f"friction of {zone.name}".replace(" ", "_"),
            "kind": "friction",
            "target": zone.name,
            "sigma": sigma,
            "truncated": [-float(zone.coefficient("default")), 10.0],
        }
        for zone in scene.zones
        if zone.frictional and zone.pressure_pieces() is None
    ]
    if not items:
        raise SceneError(f"scene {scene.name!r}: no zone has a constant friction that could be unknown")
    deviations = [*scene.model_dump(mode="json")["deviations"], *items]
    grown = Scene(**scene.model_dump() | {"deviations": deviations, "folder": scene.folder})
    return model.varied(grown)


def _judge(scene: Scene, measured, gauges, names) -> None:
    if not measured:
        raise SceneError(f"scene {scene.name!r}: nothing was measured; give one key characteristic at least")
    for name, value in measured.items():
        if name not in names:
            raise SceneError(f"scene {scene.name!r} has no key characteristic {name!r}; it has: {', '.join(names)}")
        if not np.isfinite(value):
            raise SceneError(f"{name}: {value} was measured, which is no finite number; correct it, or take it out")
        if not gauges.get(name, 0.0) > 0 or not np.isfinite(gauges[name]):
            raise SceneError(f"{name}: its gauge has no standard deviation; give one above 0, mm")
    if not any(item.sigma > 0 for item in scene.deviations):
        raise SceneError(f"scene {scene.name!r}: nothing varies, so that nothing can be the cause; give it deviations")


# ----------------------------------------------------------------------------------------------------- the posterior


def posterior(
    model: ReducedModel,
    own: list[int],
    y: np.ndarray,
    s: np.ndarray,
    law: str | None = None,
    seed: int = 0,
    threads: int = 1,
    progress: Callable[[int], None] = lambda count: None,
) -> Posterior:
    """Samples of (1).

    Parameters
    ----------
    model : ReducedModel
    own : list of int
        Numbers of the key characteristics that were measured.
    y, s : (k,) array
        Values and standard deviations of the gauge, mm.
    law, seed, threads, progress
        As in :func:`explain`.

    Raises
    ------
    SceneError
        If too few assemblies can be computed.
    """
    stream = np.random.Generator(np.random.Philox(key=np.array([seed, len(own)], dtype=np.uint64)))
    asked = _Asked(model, law, threads, progress)
    p = len(model.scene.deviations)
    z = stream.standard_normal((p + p // 2 + FIRST, p))
    z[0] = 0.0
    loosened = asked.loosen(z[:PROBES], own, s)
    asked.ask(z)
    fresh = stream.standard_normal((BATCH, p))  # nothing is known yet: of all assemblies
    for _ in range(BATCHES):
        error = np.hypot(asked.ask(fresh), loosened)
        target = _Target(asked.emulator(), own, y, np.hypot(s, error[own]))
        found = _sampled(target, stream, p)
        if (error[own] <= CLOSE * s).all():
            break
        known = np.count_nonzero(found.weight)
        fresh = found.z[stream.choice(len(found.z), min(BATCH, known), replace=False, p=found.weight)]
    exact = asked.exactly(found.best)
    least = float(target.misfit(found.best[None], exact)[0]) if np.isfinite(exact).all() else found.least
    return replace(found, least=least, error=error, evaluations=asked.count)


def _sampled(target: _Target, stream: np.random.Generator, p: int) -> Posterior:
    """Samples of (1) with the spline for h."""
    starts = stream.standard_normal((STARTS, p))
    starts[0] = 0.0
    modes = target.modes(starts)
    modes = [mode for mode in modes[:MODES] if mode[1] <= modes[0][1] + UNLIKELY]
    components = [(z, covariance, -misfit + 0.5 * np.linalg.slogdet(covariance)[1]) for z, misfit, covariance in modes]
    drawn: list[np.ndarray] = []
    responses: list[np.ndarray] = []
    mixtures: list[list] = []
    found = None
    for _ in range(ROUNDS):
        mixtures.append(components)
        drawn.append(_draw(components, stream, ROUND))
        responses.append(target.emulator(drawn[-1]))
        every, response = np.concatenate(drawn), np.concatenate(responses)
        φ = target.misfit(every, response)
        # Each sample weighs by the mixture of all rounds' proposals, whichever it came from.
        q = logsumexp([_log_density(mixture, every) for mixture in mixtures], axis=0)
        weight = np.exp(-φ - q - logsumexp(-φ - q))
        best, least = (every[int(φ.argmin())], float(φ.min())) if φ.min() < modes[0][1] else modes[0][:2]
        found = Posterior(every, response, φ, weight, best, least, target)
        if found.count >= ENOUGH:
            break
        components = [*components[: len(modes)], _fitted(found, modes[0][2])]
    assert found is not None
    return found


class _Asked:
    """Assemblies that the model was asked for, and what it answered."""

    def __init__(self, model, law, threads, progress):
        self._model, self._law, self._threads, self._progress = model, law, threads, progress
        self._exact = self._process = model.process(law, threads=threads)
        self._z, self._h = np.empty((0, len(model.scene.deviations))), np.empty((0, len(model.scene.measurements)))
        self.count = 0

    def loosen(self, z: np.ndarray, own: list[int], s: np.ndarray) -> np.ndarray:
        """Follow the loosest path that the gauge does not tell from the scene's; what it errs by (k,), mm."""
        none = np.zeros(self._h.shape[1])
        if not any(isinstance(stage.path, Followed) for stage in self._exact.stages):
            return none
        exact = self._answers(self._exact, z)
        for tolerance in LOOSE:
            if tolerance <= self._model.scene.path.tolerance:
                break
            loose = Process(self._model, self._exact.law, threads=self._threads, path_tolerance=tolerance)
            error = np.sqrt(np.nanmean((self._answers(loose, z) - exact) ** 2, axis=0))
            if (error[own] <= LOOSENED * s).all():
                self._process = loose
                return error
        return none

    def ask(self, z: np.ndarray) -> np.ndarray:
        """Evaluate assemblies (n, p); by how much (k,) the spline through those before missed them, root mean squares,
        mm; infinite where there were none."""
        h = self._answers(self._process, z)
        known = np.isfinite(h).all(axis=1)
        error = np.full(h.shape[1], np.inf)
        if len(self._z) and known.any():
            error = np.sqrt(((self.emulator()(z[known]) - h[known]) ** 2).mean(axis=0))
        self._z, self._h = np.concatenate([self._z, z[known]]), np.concatenate([self._h, h[known]])
        return error

    def exactly(self, z: np.ndarray) -> np.ndarray:
        """(1, k) of one assembly (p,), on the scene's own path."""
        return self._answers(self._exact, z[None])

    def emulator(self) -> Emulator:
        """Through all that was asked for."""
        n, p = self._z.shape
        if n < p + 2:
            raise SceneError(
                f"scene {self._model.scene.name!r}: only {n} of its assemblies can be computed, too few to find a "
                "cause; see what `mic run` says of the others"
            )
        return Emulator(self._z, self._h)

    def _answers(self, process: Process, z: np.ndarray) -> np.ndarray:
        """(n, k); NaN where an assembly cannot be computed."""
        found = process.attempt(from_normal(self._model.scene, z))
        self._progress(len(z))
        self.count += len(z)
        return np.where(found.failed[:, None], np.nan, found.measurements)


class _Target:
    """φ of (1), its modes and what they need."""

    def __init__(self, emulator: Emulator, own: list[int], y: np.ndarray, spread: np.ndarray):
        self.emulator, self._own, self._y, self._spread = emulator, own, y, spread

    def misfit(self, z: np.ndarray, response: np.ndarray | None = None) -> np.ndarray:
        """φ (n,) of numbers (n, p), whose key characteristics (n, k) are those of the spline."""
        response = self.emulator(z) if response is None else response
        return 0.5 * (z**2).sum(axis=1) + 0.5 * (self._missed(response) ** 2).sum(axis=1)

    def _missed(self, response: np.ndarray) -> np.ndarray:
        return (response[:, self._own] - self._y) / self._spread

    def modes(self, z: np.ndarray) -> list[tuple[np.ndarray, float, np.ndarray]]:
        """Most probable numbers (p,), their φ and covariance (p, p), from each of the starts; the best first."""
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
            gained = np.where(better, φ - np.where(better, new, 0.0), 0.0)
            λ = np.where(better, np.maximum(λ * FLAT, 1e-12), λ * STEEP)
            z, φ = np.where(better[:, None], trial, z), np.where(better, new, φ)
            active &= ~(better & (gained < STILL)) & (λ < 1e8)
            if better.any():
                J[better], r[better] = self._slopes(z[better])
            if not active.any():
                break
        found: list[tuple[np.ndarray, float, np.ndarray]] = []
        for i in np.argsort(φ, kind="stable"):
            covariance = np.linalg.inv(np.eye(p) + J[i].T @ J[i])
            root = np.linalg.cholesky(covariance)
            if all(np.linalg.norm(np.linalg.solve(root, z[i] - other)) > APART for other, _, _ in found):
                found.append((z[i], float(φ[i]), covariance))
        return found

    def _slopes(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """J (n, k, p) and r (n, k)."""
        return self.emulator.slopes(z)[:, self._own] / self._spread[:, None], self._missed(self.emulator(z))


def _shares(components) -> np.ndarray:
    logs = np.array([one[2] for one in components])
    return np.exp(logs - logsumexp(logs))


def _draw(components, stream, count: int) -> np.ndarray:
    """(n, p) samples of a mixture, a fifth of them wider."""
    p = len(components[0][0])
    which = stream.choice(len(components), count, p=_shares(components))
    size = np.where(stream.random(count) < WIDE_SHARE, np.sqrt(WIDE), 1.0)
    ξ = stream.standard_normal((count, p)) * size[:, None]
    roots = [np.linalg.cholesky(covariance) for _, covariance, _ in components]
    return np.stack([components[k][0] + roots[k] @ one for k, one in zip(which, ξ)])


def _log_density(components, z: np.ndarray) -> np.ndarray:
    """(n,) logarithm of the density of what :func:`_draw` draws."""
    found, p = [], z.shape[1]
    for (centre, covariance, _), share in zip(components, _shares(components)):
        root = np.linalg.cholesky(covariance)
        square = (np.linalg.solve(root, (z - centre).T) ** 2).sum(axis=0)
        size = np.log(np.diag(root)).sum() + 0.5 * p * np.log(2 * np.pi)
        for part, wide in ((1 - WIDE_SHARE, 1.0), (WIDE_SHARE, WIDE)):
            log_part = np.log(max(share, 1e-300) * part)
            found.append(log_part - 0.5 * square / wide - size - 0.5 * p * np.log(wide))
    return np.asarray(logsumexp(found, axis=0))


def _fitted(found: Posterior, known: np.ndarray):
    """A component fitted to the samples so far, the less the fewer of them count, and weighing as all others do."""
    p = found.z.shape[1]
    mean = found.weight @ found.z
    off = found.z - mean
    covariance = (off * found.weight[:, None]).T @ off
    trust = found.count / (found.count + p + 1)
    return mean, trust * covariance + (1 - trust) * known, 0.0


# -------------------------------------------------------------------------------------------------------- in words


def _further(scene, names, measured, gauge: float, found: Posterior, x, varied) -> pd.DataFrame:
    """What each characteristic that was not measured would tell, by a gauge like those that were used."""
    w, rows = found.weight, []
    _, spread = _moments(found.response, w)
    for k, name in enumerate(names):
        if name in measured:
            continue
        share = spread[k] ** 2 / (spread[k] ** 2 + gauge**2)
        columns = np.column_stack([x[:, varied], found.response[:, k]])
        told = np.nan_to_num(_correlation(columns, w)[-1, :-1]) ** 2 * share
        most = int(told.argmax())
        rows.append(
            {
                "measurement": name,
                "sigma": spread[k],
                "bits": 0.5 * np.log2(1 + (spread[k] / gauge) ** 2),
                "source": scene.deviations[varied[most]].name,
                "told": told[most],
            }
        )
    if not rows:
        return FURTHER.empty()
    table = pd.DataFrame(rows, columns=FURTHER.names)
    return table.sort_values("bits", ascending=False, kind="stable", ignore_index=True)


def _moments(x: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean = w @ x
    return mean, np.sqrt(np.maximum(w @ (x - mean) ** 2, 0.0))


def _correlation(x: np.ndarray, w: np.ndarray) -> np.ndarray:
    mean, sigma = _moments(x, w)
    off = (x - mean) / np.where(sigma > 0, sigma, np.inf)
    return (off * w[:, None]).T @ off


def _quantile(x: np.ndarray, w: np.ndarray, share: float) -> float:
    order = np.argsort(x, kind="stable")
    return float(np.interp(share, np.cumsum(w[order]) - 0.5 * w[order], x[order]))
