"""The error budget of a scene: the error that each source causes in its figures.

A figure θ is a mean or 6σ of a key characteristic or zone slip. Its error δ is the printed value minus the value
without the source, so a positive δ is a figure that is printed too large. Where a source can be reduced, the same n
samples are solved again with less of it. With y in production and x better,

    d = θ(y) − θ(x),        δ = f d,        |δ − f d| ≤ (f + g) t s + g |d|

s is the jackknife's standard error of d (:mod:`mic.statistics.paired_differences`), t Student's. f extrapolates to the
limit: for an error of order p and a refinement by r, f = 1/(1 − r⁻ᵖ). g is the uncertainty of f (:data:`REFINED`),
and 3/n of f covers effects that n samples may miss. Systematic doubts add linearly to those of chance. A source that
cannot be reduced is bounded, ``|δ| ≤ U``: then δ = 0 with uncertainty U.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.contact.path import Followed, Increments
from mic.errors import MicError, SceneError
from mic.model.assembly import Assembly, assemble
from mic.model.mesh_accuracy import with_halved_elements
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.results.path_error import tighter
from mic.statistics.draw import draw
from mic.statistics.paired_differences import jackknife, mean_change, six_sigma_change
from mic.studies.order import orders
from mic.studies.pair_convergence import denser_scene
from mic.system.files import write_text
from verification.comparison import reduced_and_assembly, reduced_model, zone_slip
from verification.stiffness import DeviatedStiffness
from verification.study import Team
from verification.two_level import two_level

__all__ = [
    "EVERY",
    "FIGURES",
    "REFINED",
    "SAMPLES",
    "SAMPLING",
    "SHARES",
    "SOURCES",
    "STIFFNESS",
    "Case",
    "Item",
    "bounded",
    "estimate",
    "largest_difference",
    "nearer",
    "paired",
    "two_levels",
    "total",
    "values",
]

SAMPLES = 30  # common to all sources but denser pairs
DENSE = 15  # samples with denser pairs, which take many times as long each
DEVIATED = 10  # samples solved with the stiffness of their own shape, each with its own influence coefficients
ORDER, STIFFNESS, SAMPLING = "order of the process", "nominal stiffness", "sampling"
NODES = "every node"
FEW, MOST = 6, 1500  # number of samples with contact at every node, and largest number of contact nodes
#: Factors on the distance between pairs, tried in this order until the elements admit it and pairs are at most `MOST`.
SHARES = (0.5, 0.6, 0.7)
UNSEEN = 3.0  # rule of three: events with a probability below 3/n are likely to occur in none of n samples
FIGURES = ("mean", "six_sigma")
CODE = ("budget.py", "stiffness.py", "two_level.py")  # modules whose content is part of the cache key


@dataclass(frozen=True)
class Refined:
    """Conversion of a difference from refined samples to an error.

    Attributes
    ----------
    factor, doubt : float
        f and g.
    why : str
    """

    factor: float
    doubt: float
    why: str


REFINED = {
    # Such estimates are 0.8 to 1.4 times the true error for shells with a known solution.
    "mesh": Refined(4 / 3, 4 / 3 * (1 - 1 / 1.4), "second order: factor 4/3; the error is 0.7 to 1.25 times that"),
    "path": Refined(6 / 5, 1 / 5, "a tolerance of 1/16 reduces the error to about 1/6: factor 6/5"),
    "increments": Refined(4 / 3, 1 / 3, "first order, four times the increments: factor 4/3"),
    "law": Refined(1.0, 0.0, ""),
}


def nearer(share: float) -> Refined:
    """Conversion for pairs at a fraction of their distance.

    The order is between two (sums over patches) and one (edge of the pressed area).
    """
    first, second = 1 / (1 - share), 1 / (1 - share**2)
    why = f"between first and second order: factor {second:.3g} to {first:.3g}"
    return Refined((first + second) / 2, (first - second) / 2, why)


@dataclass(frozen=True)
class Item:
    """Estimated error of one source.

    Attributes
    ----------
    source : str
    how : str
        Method of the estimate, or the reason why there is none.
    seconds : float
        CPU time.
    table : DataFrame or None
        By quantity: ``mean, mean_half, six_sigma, six_sigma_half``, errors and half their 95 % intervals, mm; NaN if
        unknown. None if there is no estimate.
    counts : bool
        Whether the sum of the error budget contains it.
    """

    source: str
    how: str
    seconds: float
    table: pd.DataFrame | None
    counts: bool = True


def values(model: ReducedModel, evaluation: Evaluation) -> pd.DataFrame:
    """Zone slips and key characteristics of samples, one column each, mm; NaN in failed samples."""
    scene, columns = model.scene, {}
    for stage, resolution in evaluation.resolutions.items():
        if model.contacts.dimension == 3:
            slip = zone_slip(resolution.displacement, model.contacts, len(scene.zones))
            columns |= {f"slip:{stage}:{zone.name}": slip[:, z] for z, zone in enumerate(scene.zones)}
    if evaluation.measurements.size:
        columns |= {f"measurement:{item.name}": x for item, x in zip(scene.measurements, evaluation.measurements.T)}
    frame = pd.DataFrame(columns, index=range(len(evaluation.failed)))
    frame[evaluation.failed] = np.nan
    return frame


@dataclass(frozen=True)
class Case:
    """A scene and the samples on which every source is estimated.

    Attributes
    ----------
    assembly : Assembly
    model : ReducedModel
        Both with the path of the scene, so that refinements use the same path.
    law : str
        Law of the printed results.
    cache : Path
    six_sigma : Series or None
        Printed 6σ by quantity, mm; None for that of these samples.
    samples : int
    """

    assembly: Assembly
    model: ReducedModel
    law: str
    cache: Path
    six_sigma: pd.Series | None = None
    samples: int = SAMPLES

    @cached_property
    def deviations(self) -> np.ndarray:
        """(n, p) deviations of the samples."""
        return draw(self.model.scene, self.model.scene.monte_carlo.seed, 0, self.samples)

    @cached_property
    def production(self) -> pd.DataFrame:
        """Production results of the samples."""
        return self.of(self.model)

    def error(self, better: pd.DataFrame, refined: Refined) -> pd.DataFrame:
        """Errors of production against refined results of the same samples."""
        return paired(self.production, better, refined, self.six_sigma)

    def none(self) -> pd.DataFrame:
        """Zero errors of an absent source."""
        zero = pd.Series(0.0, self.production.columns)
        return bounded(zero, zero)

    def of(self, model: ReducedModel, law: str | None = None, path: Callable | None = None) -> pd.DataFrame:
        """Results of the samples with another model, law or path."""
        process = model.process(law or self.law)
        if path is not None:
            for stage in process.stages:
                stage.path = path(stage.path)
        return values(model, process.attempt(self.deviations))


def paired(
    production: pd.DataFrame, better: pd.DataFrame, refined: Refined, six_sigma: pd.Series | None = None
) -> pd.DataFrame:
    """Errors of production against refined results of the same samples, in the columns of :class:`Item`.

    The relative difference of 6σ is estimated from these samples and applied to the 6σ of the full Monte Carlo. Its
    uncertainty is at least that of the absolute difference.

    Parameters
    ----------
    production, better : (n, k) DataFrame
        With the same columns; samples with NaN in either are ignored.
    refined : Refined
    six_sigma : Series, optional
        6σ of production by column from more samples, mm; default: 6σ of these samples.
    """
    rows = {}
    for name in production.columns:
        both = np.column_stack([production[name], better[name]]).astype(float)
        valid = both[np.isfinite(both).all(axis=1)]
        size = six_sigma[name] if six_sigma is not None else 6 * valid[:, 0].std(ddof=1) if len(valid) > 1 else np.nan
        row, share = {}, jackknife(both, _too_large, groups=len(both))
        mean, six = mean_change(both[:, 1], both[:, 0]), six_sigma_change(both[:, 1], both[:, 0])
        scaled = share.value * size, max((share.high - share.value) * size, six.high - six.value)
        g = refined.doubt + refined.factor * UNSEEN / max(len(valid), 1)
        for figure, (d, half) in zip(FIGURES, ((mean.value, mean.high - mean.value), scaled)):
            row[figure] = refined.factor * d
            row[f"{figure}_half"] = (refined.factor + g) * half + g * abs(d)
        rows[name] = row
    return pd.DataFrame.from_dict(rows, orient="index")


def _too_large(samples: np.ndarray) -> float:
    """Relative excess of σ of the first column over that of the second; 0 if neither varies."""
    first, second = samples.std(axis=0, ddof=1)
    return float(1 - second / first) if first > 0 else 0.0 if second == 0 else float("nan")


def two_levels(production: pd.DataFrame, better: pd.DataFrame) -> pd.DataFrame:
    """Errors of production with refined results for some of its samples (:mod:`verification.two_level`).

    Parameters
    ----------
    production : (N, k) DataFrame
        By sample.
    better : (n, k) DataFrame
        Some of these samples; those with NaN in either are ignored.
    """
    rows = {}
    for name in production.columns:
        y = production[name].dropna()
        x = better[name].dropna()
        x = x[x.index.isin(y.index)]
        if not len(x) or len(y) < 2:
            rows[name] = dict.fromkeys(("mean", "mean_half", "six_sigma", "six_sigma_half"), np.nan)
            continue
        corrected = two_level(y.to_numpy(), [y.index.get_loc(sample) for sample in x.index], x.to_numpy())
        rows[name] = {
            f"{figure}{end}": size
            for figure, error in zip(FIGURES, (corrected.mean_error, corrected.six_sigma_error))
            for end, size in (("", error.value), ("_half", error.high - error.value))
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def largest_difference(reduced: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Bounds on the errors of mean and 6σ: the largest difference of a sample, and six times that."""
    most = (reduced - truth).abs().max()
    return bounded(most, 6 * most)


def bounded(mean: pd.Series, six_sigma: pd.Series) -> pd.DataFrame:
    """Zero errors with the given bounds as uncertainty."""
    zero = 0.0 * mean
    return pd.DataFrame(
        {"mean": zero, "mean_half": mean.abs(), "six_sigma": 0.0 * six_sigma, "six_sigma_half": six_sigma.abs()}
    )


def total(items: list[Item]) -> pd.DataFrame:
    """Sum of all estimated sources that count, in the columns of :class:`Item`."""
    known = [item.table for item in items if item.counts and item.table is not None]
    if not known:
        return pd.DataFrame(columns=[name for figure in FIGURES for name in (figure, f"{figure}_half")])
    names = list(dict.fromkeys(name for table in known for name in table.index))
    stacked = [table.reindex(names) for table in known]
    columns = {}
    for figure in FIGURES:
        columns[figure] = sum(table[figure].fillna(0.0) for table in stacked)
        columns[f"{figure}_half"] = np.sqrt(sum(table[f"{figure}_half"].fillna(0.0) ** 2 for table in stacked))
    return pd.DataFrame(columns)


# ------------------------------------------------------------------------- sources estimated by the reduced model


def _law(case: Case) -> tuple[str, pd.DataFrame]:
    if LAWS[case.law].reads:
        return "none: the scene provides the data of its law", case.none()
    if not case.model.contacts.frictional:
        return "none: without friction results do not depend on the law", case.none()
    if case.law == "coulomb":
        return "none: the scene uses Coulomb's law", case.none()
    return (
        f"the same {case.samples} samples under Coulomb's law instead of {case.law}",
        case.error(case.of(case.model, law="coulomb"), REFINED["law"]),
    )


def _path(case: Case) -> tuple[str, pd.DataFrame]:
    """Path error, under Coulomb's law if the printed law replaces it; its deviation is then part of the law error."""
    law = case.law if LAWS[case.law].reads else "coulomb"
    if not case.model.contacts.frictional:
        return "none: without friction results do not depend on the path", case.none()
    steps = [stage.path for stage in case.model.process(law).stages if stage.resolves]
    kind = "increments" if any(isinstance(path, Increments) for path in steps) else "path"
    given = case.production if law == case.law else case.of(case.model, law)
    better = case.of(case.model, law, tighter)
    how = f"the same {case.samples} samples{f' under the {law} law' * (law != case.law)} on a tighter path"
    return f"{how}; {REFINED[kind].why}", paired(given, better, REFINED[kind], case.six_sigma)


def _pairs(case: Case) -> tuple[str, pd.DataFrame]:
    if not len(case.assembly.contacts):
        return "none: the scene has no contact pairs", case.none()
    pairs = len(case.assembly.contacts)
    for share in SHARES:
        if pairs / share**2 > MOST and share != SHARES[-1]:
            continue
        try:
            model, assembly = reduced_and_assembly(denser_scene(case.assembly, share), case.cache)
            break
        except SceneError:
            if share == SHARES[-1]:
                raise
    refined, few = nearer(share), replace(case, samples=min(DENSE, case.samples))
    return (
        f"{few.samples} samples with {len(assembly.contacts)} pairs instead of {pairs}, at {share:g} of the distance; "
        f"{refined.why}",
        paired(case.production[: few.samples], few.of(model), refined, case.six_sigma),
    )


def _every_node(case: Case) -> tuple[str, pd.DataFrame]:
    """Pair error of key characteristics without extrapolation; slips at other points are not comparable."""
    if not len(case.assembly.contacts):
        return "none: the scene has no contact pairs", case.none()
    assembly = assemble(case.assembly.scene, case.cache, every_node=True)
    pairs = len(assembly.contacts)
    if pairs > MOST:
        raise SceneError(f"{pairs} nodes of the zones face the other sheet, more than {MOST}")
    model = reduced_model(assembly, case.cache)
    first = case.deviations[:FEW]
    better = values(model, model.process(case.law).attempt(first)).filter(like="measurement:")
    return (
        f"{len(first)} samples with contact at each of {pairs} nodes, combined with {case.samples} with "
        f"{len(case.assembly.contacts)} pairs (two-level estimate)",
        two_levels(case.production.filter(like="measurement:"), better),
    )


def _mesh(case: Case) -> tuple[str, pd.DataFrame]:
    finer = with_halved_elements(case.assembly)
    if all(part.superelement is not None for part in finer.parts):
        return "none: superelements have no mesh", case.none()
    model = reduced_model(finer, case.cache)
    before, after = (sum(len(part.surface.points) for part in of.parts) for of in (case.assembly, finer))
    return (
        f"the same {case.samples} samples on meshes of half the size, {after} nodes instead of {before}, pairs at the "
        f"same points; {REFINED['mesh'].why}. Errors of the element theory are not included",
        case.error(case.of(model), REFINED["mesh"]),
    )


def _one_increment(path: Followed | Increments) -> Increments:
    """A followed path in one increment, by which the effect of an order is off by some per cent."""
    return path if isinstance(path, Increments) else Increments(1)


def _order(case: Case) -> tuple[str, pd.DataFrame]:
    others = orders(case.model.scene)
    if len(others) == 1:
        return "none: there is only one order", case.none()
    # Both sides with the mean stiffness: one of its own for each sample would cost hundreds of times as much.
    model, most = replace(case.model, slopes=None), None
    given = case.of(model, path=_one_increment)
    for other in others[1:]:
        results = case.of(replace(model, scene=other.scene), path=_one_increment)
        change = paired(given, results, REFINED["law"], case.six_sigma)[list(FIGURES)].abs()
        most = change if most is None else most.combine(change, np.fmax)
    counted = f"{len(others) - 1} other order{'s' * (len(others) > 2)}"
    return (
        f"bound: largest change by {counted} on the same {case.samples} samples, with one increment per step"
        + (" and the mean stiffness" if case.model.slopes is not None else ""),
        bounded(most["mean"], most["six_sigma"]),
    )


#: Function for each source that returns the method and the errors by quantity.
SOURCES: dict[str, Callable[[Case], tuple[str, pd.DataFrame]]] = {
    "law": _law,
    "path": _path,
    ORDER: _order,
    "pairs": _pairs,
    NODES: _every_node,
    "mesh and element": _mesh,
}


#: Reason why the sum does not contain a source.
OUTSIDE = {
    ORDER: "not in the sum, because the scene states its order",
    NODES: "not in the sum, which contains the pair error from denser pairs",
}

#: All sources of :func:`estimate`.
EVERY = (*SOURCES, STIFFNESS)


def stated_order(scene) -> bool:
    """Whether the scene states the order in which clamps and welds close or open."""
    return any(stage.order is not None or stage.sequence for stage in scene.stages)


def estimate(case: Case, folder: Path, key: str, team: Team, sources, say=print) -> list[Item]:
    """Estimate the error of each source, distributed over the ranks; stored estimates are read from the folder.

    Parameters
    ----------
    case : Case
    folder : Path
        Receives one file for each source.
    key : str
        Cache key of the scene, its meshes and its samples.
    team : Team
    sources : collection of str
        Keys of :data:`SOURCES`, and :data:`STIFFNESS`.
    say : callable
        Called with one line of text for each estimated source.
    """
    case.production  # noqa: B018  compiles code before time is measured; all ranks need it
    of_source = partial(_item, case, folder=folder, key=key, say=say)
    items = team.map(of_source, [source for source in sources if source in SOURCES])
    return items + ([_stiffness(case, folder, key, team, say)] if STIFFNESS in sources else [])


def _stiffness(case: Case, folder: Path, key: str, team: Team, say) -> Item:
    """Error of the nominal stiffness, from the first samples with the stiffness of their own shapes."""
    try:
        stiffness = DeviatedStiffness(case.assembly, case.model)
    except MicError as problem:
        return Item(STIFFNESS, f"not estimated: {problem}", 0.0, None)

    def solve(sample: int) -> dict:
        model, deviations = stiffness.at(case.deviations[sample]), case.deviations[[sample]]
        return values(model, model.process(case.law).attempt(deviations)).iloc[0].to_dict()

    def stored(sample: int) -> dict:
        path = folder / f"{_mark(case, f'{STIFFNESS} {sample}', key)}.json"
        return _stored(path, lambda: _timed(lambda: {"values": solve(sample)}))

    solved = team.map(stored, range(min(DEVIATED, case.samples)))
    seconds = sum(item["seconds"] for item in solved)
    if team.rank == 0:
        say(f"  {STIFFNESS}: {seconds:.1f} s")
    how = (
        f"{len(solved)} samples, each with the stiffness of its deviated shape, combined with {case.samples} with "
        "that of the scene (two-level estimate)"
    )
    better = pd.DataFrame([item["values"] for item in solved], dtype=float)
    return Item(STIFFNESS, how, seconds, two_levels(case.production, better))


def _mark(case: Case, what: str, key: str) -> str:
    code = b"".join(Path(__file__).with_name(name).read_bytes() for name in CODE)
    digest = hashlib.sha256(f"{key} {case.law} {case.samples} {what}".encode() + code).hexdigest()[:16]
    return f"{what.replace(' ', '-')}-{digest}"


def _timed(work: Callable[[], dict]) -> dict:
    start = time.process_time()
    return work() | {"seconds": time.process_time() - start}


def _stored(path: Path, work: Callable[[], dict]) -> dict:
    """Content of the file, or the result of `work`, which is then stored."""
    if path.is_file():
        return json.loads(path.read_text())
    result = work()
    write_text(path, json.dumps(result, indent=1))
    return result


def _item(case: Case, source: str, folder: Path, key: str, say) -> Item:
    counts = source != NODES and (source != ORDER or not stated_order(case.model.scene))
    path = folder / f"{_mark(case, source, key)}.json"

    def solve() -> dict:
        how, table = SOURCES[source](case)
        return {"how": how, "table": json.loads(table.to_json(orient="split", double_precision=15))}

    known = path.is_file()
    try:
        result = _stored(path, lambda: _timed(solve))
    except (MicError, MemoryError) as problem:
        say(f"  {source}: not estimated: {problem}")
        return Item(source, f"not estimated: {problem}", 0.0, None, counts)
    if not known:
        say(f"  {source}: {result['seconds']:.1f} s")
    how = result["how"]
    if not counts:
        how += f"; {OUTSIDE[source]}"
    return Item(source, how, result["seconds"], pd.DataFrame(**result["table"]).astype(float), counts)
