"""From what was measured on an assembly back to its most probable sources.

With the sources as functions x(z) of independent standard normal numbers z, key characteristics h, measured values y
and the gauge's standard deviations s, the posterior density of z is exp(−φ) up to a factor,

    φ(z) = ‖z‖²/2 + ‖r(z)‖²/2,        r = (h(x(z)) − y)/s.                                              (1)

Its modes are found by Levenberg and Marquardt's method on exact sensitivities, from several starts: where contacts
change their state, φ has kinks and may have several. About each mode the posterior is nearly normal with covariance
C = (1 + JᵀJ)⁻¹, J = ∂r/∂z; what kinks make of it is told by importance sampling [1]_: samples of a mixture q of such
normals weigh exp(−φ)/q, and the mixture is fitted to them anew until enough of them count.

References
----------
.. [1] J.-M. Cornuet, J.-M. Marin, A. Mira, C. P. Robert: Adaptive multiple importance sampling, Scand. J. Stat. 39
       (2012) 798-812.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import logsumexp
from scipy.stats import chi2

from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.results.schema import EXPLANATION, FURTHER
from mic.results.statistics import LEVEL
from mic.sampling.normal import from_normal, normal_slopes
from mic.scene import Scene

__all__ = ["Explanation", "Posterior", "explain", "posterior", "with_friction"]

STARTS = 4  # the means, and random ones
STEPS = 40  # of Levenberg and Marquardt
STEEP, FLAT = 10.0, 0.3  # by which λ grows after a step that failed, and shrinks after one that did not
STILL = 1e-3  # of φ: a step that gains no more is the last; what a path leaves in φ is of that size
UNLIKELY = 10.0  # above the least φ: a mode there has no weight
APART = 0.1  # of its own standard deviations: modes that are no farther apart are one
ROUND = 250  # samples of a round
ROUNDS = 6
ENOUGH = 200.0  # samples that count: shares of 0.95 are known to 0.015 then
WIDE = 2.0  # of the covariance: a fifth of the samples are drawn so much wider, for tails
WIDE_SHARE = 0.2
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
        φ there.
    """

    z: np.ndarray
    response: np.ndarray
    misfit: np.ndarray
    weight: np.ndarray
    best: np.ndarray
    least: float

    @property
    def count(self) -> float:
        """Independent samples that would tell as much."""
        return float(1 / np.sum(self.weight**2))

    def level(self, share: float = LEVEL) -> float:
        """The φ below which the densest region lies that holds this share of the posterior."""
        return _quantile(self.misfit, self.weight, share)


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
    """
    target = _Target(model, own, y, s, law, threads, progress)
    stream = np.random.Generator(np.random.Philox(key=np.array([seed, len(own)], dtype=np.uint64)))
    starts = stream.standard_normal((STARTS, target.p))
    starts[0] = 0.0
    modes = target.modes(starts)
    modes = [mode for mode in modes if mode[1] <= modes[0][1] + UNLIKELY]
    components = [(z, covariance, -misfit + 0.5 * np.linalg.slogdet(covariance)[1]) for z, misfit, covariance in modes]
    drawn: list[np.ndarray] = []
    responses: list[np.ndarray] = []
    misfits: list[np.ndarray] = []
    mixtures: list[list] = []
    found = None
    for _ in range(ROUNDS):
        mixtures.append(components)
        z = _draw(components, stream, ROUND)
        response, misfit = target.evaluate(z)
        drawn, responses, misfits = [*drawn, z], [*responses, response], [*misfits, misfit]
        every, φ = np.concatenate(drawn), np.concatenate(misfits)
        # Each sample weighs by the mixture of all rounds' proposals, whichever it came from.
        q = logsumexp([_log_density(mixture, every) for mixture in mixtures], axis=0)
        log_weight = -φ - q
        weight = np.exp(log_weight - logsumexp(log_weight))
        best, least = (every[int(φ.argmin())], float(φ.min())) if φ.min() < modes[0][1] else modes[0][:2]
        known = np.isfinite(φ)
        found = Posterior(every[known], np.concatenate(responses)[known], φ[known], weight[known], best, least)
        if found.count >= ENOUGH:
            break
        components = [*components[: len(modes)], _fitted(found, modes[0][2])]
    assert found is not None
    return found


class _Target:
    """φ of (1), its modes and what they need."""

    def __init__(self, model, own, y, s, law, threads, progress):
        self.model, self.own, self.y, self.s, self.law, self.progress = model, own, y, s, law, progress
        self.process = model.process(law, threads=threads)
        self.p = len(model.scene.deviations)

    def evaluate(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All key characteristics (n, k) and φ (n,), infinite where an assembly cannot be computed."""
        found = self.process.attempt(from_normal(self.model.scene, z))
        self.progress(len(z))
        return found.measurements, np.where(found.failed, np.inf, self._misfit(z, found.measurements))

    def _misfit(self, z, measurements):
        r = (measurements[:, self.own] - self.y) / self.s
        return 0.5 * (z**2).sum(axis=1) + 0.5 * (r**2).sum(axis=1)

    def modes(self, z: np.ndarray) -> list[tuple[np.ndarray, float, np.ndarray]]:
        """Most probable numbers (p,), their φ and covariance (p, p), from each of the starts; the best first.

        Raises
        ------
        SceneError
            If no start can be computed.
        """
        response, φ = self.evaluate(z)
        going = np.isfinite(φ)
        if not going.any():
            raise SceneError(f"scene {self.model.scene.name!r}: neither its mean nor a few samples can be computed")
        z, φ, λ = z[going], φ[going], np.full(int(going.sum()), 1e-2)
        J, r, response = *self._slopes(z), response[going]
        active = np.ones(len(z), dtype=bool)
        for _ in range(STEPS):
            gradient = z + np.einsum("nkp,nk->np", J, r)
            curvature = np.eye(self.p) + np.einsum("nkp,nkq->npq", J, J)
            damped = curvature + λ[:, None, None] * np.eye(self.p)
            trial = z - np.linalg.solve(damped, gradient[..., None])[..., 0]
            new = np.full(len(z), np.inf)
            _, new[active] = self.evaluate(trial[active])
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
            covariance = np.linalg.inv(np.eye(self.p) + J[i].T @ J[i])
            root = np.linalg.cholesky(covariance)
            if all(np.linalg.norm(np.linalg.solve(root, z[i] - other)) > APART for other, _, _ in found):
                found.append((z[i], float(φ[i]), covariance))
        return found

    def _slopes(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """J (n, k, p) and r (n, k)."""
        scene = self.model.scene
        found = self.model.sensitivities(from_normal(scene, z), self.law)
        self.progress(len(z))
        J = np.matmul(found.jacobian[:, self.own], normal_slopes(scene, z)) / self.s[:, None]
        return np.nan_to_num(J), np.nan_to_num((found.measurements[:, self.own] - self.y) / self.s)


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
