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
from mic.contact.path import Increments
from mic.errors import MicError, SceneError
from mic.model.assembly import Assembly, assemble
from mic.model.mesh_accuracy import with_halved_elements
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.results.path_error import tighter
from mic.statistics.draw import draw
from mic.statistics.paired_differences import jackknife, mean_change, six_sigma_change
from mic.studies.order import orders
from mic.studies.pair_convergence import denser
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

SAMPLES = 30  # that each source is estimated on: the same for all
DEVIATED = 10  # of these, that are given the stiffness of their own shape: each takes influence coefficients of its own
ORDER, STIFFNESS, SAMPLING = "order of the process", "nominal stiffness", "sampling"
NODES = "every node"
FEW, MOST = 6, 1500  # samples that get contact at every node, and how many nodes may face each other
#: Of the distance between pairs: the first that elements bear; 0.7 was seen to tell too little on bends.
SHARES = (0.5, 0.6, 0.7)
UNSEEN = (
    3.0  # over n: what happens to a smaller share of all assemblies is likely to happen to none of n (rule of three)
)
FIGURES = ("mean", "six_sigma")
CODE = ("budget.py", "stiffness.py", "two_level.py")  # what is kept was made by these


@dataclass(frozen=True)
class Refined:
    """How a difference from better samples becomes an error.

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
    # Estimates of this kind were 0.8 to 1.4 times the true error of shells whose solution is known.
    "mesh": Refined(4 / 3, 4 / 3 * (1 - 1 / 1.4), "second order: times 4/3; the error is 0.7 to 1.25 times that"),
    "path": Refined(6 / 5, 1 / 5, "a tolerance of a sixteenth leaves about a sixth: times 6/5"),
    "increments": Refined(4 / 3, 1 / 3, "first order, four times the increments: times 4/3"),
    "law": Refined(1.0, 0.0, ""),
}


def nearer(share: float) -> Refined:
    """Of pairs at a share of their distance. Sums over patches are of second order; where pressure begins is known to
    the distance of the pairs, of first."""
    first, second = 1 / (1 - share), 1 / (1 - share**2)
    why = f"between first and second order: times {second:.3g} to {first:.3g}"
    return Refined((first + second) / 2, (first - second) / 2, why)


@dataclass(frozen=True)
class Item:
    """What one source leaves.

    Attributes
    ----------
    source : str
    how : str
        How it was estimated, or why nothing is known.
    seconds : float
        CPU time.
    table : DataFrame or None
        By quantity: ``mean, mean_half, six_sigma, six_sigma_half``, mm, errors and half their 95 % intervals; NaN where
        not known. None where nothing is.
    counts : bool
        Whether it is an error of what the program prints, so that the sum contains it.
    """

    source: str
    how: str
    seconds: float
    table: pd.DataFrame | None
    counts: bool = True


def values(model: ReducedModel, evaluation: Evaluation) -> pd.DataFrame:
    """Zones' slips and key characteristics of samples, one column each, mm; NaN in samples that failed."""
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
    """A scene, and the samples that every source is estimated on.

    Attributes
    ----------
    assembly : Assembly
    model : ReducedModel
        Both with the scene's own path, or what refines them would be charged with that of another.
    law : str
        What production prints.
    cache : Path
    six_sigma : Series or None
        6σ that production prints, by quantity, mm; None: that of these samples.
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
        """(n, p)"""
        return draw(self.model.scene, self.model.scene.monte_carlo.seed, 0, self.samples)

    @cached_property
    def production(self) -> pd.DataFrame:
        """What production makes of them."""
        return self.of(self.model)

    def beside(self, better: pd.DataFrame, refined: Refined) -> pd.DataFrame:
        """Errors of production, from its samples done better."""
        return paired(self.production, better, refined, self.six_sigma)

    def none(self) -> pd.DataFrame:
        """A source that is not there."""
        zero = pd.Series(0.0, self.production.columns)
        return bounded(zero, zero)

    def of(self, model: ReducedModel, law: str | None = None, path: Callable | None = None) -> pd.DataFrame:
        """What another model, law or path makes of them."""
        process = model.process(law or self.law)
        if path is not None:
            for stage in process.stages:
                stage.path = path(stage.path)
        return values(model, process.attempt(self.deviations))


def paired(
    production: pd.DataFrame, better: pd.DataFrame, refined: Refined, six_sigma: pd.Series | None = None
) -> pd.DataFrame:
    """Errors of production from the same samples done better, as :class:`Item` has them.

    Of 6σ it is the share by which the two differ that few samples tell well: that, of the 6σ of many. What it is unsure
    of is no less than the difference itself is, or samples that all differ by one share would leave no doubt.

    Parameters
    ----------
    production, better : (n, k) DataFrame
        With the same columns; samples with NaN in either are left out.
    refined : Refined
    six_sigma : Series, optional
        6σ of production by column, mm, from more samples; default: of these.
    """
    rows = {}
    for name in production.columns:
        both = np.column_stack([production[name], better[name]]).astype(float)
        own = both[np.isfinite(both).all(axis=1)]
        size = six_sigma[name] if six_sigma is not None else 6 * own[:, 0].std(ddof=1) if len(own) > 1 else np.nan
        row, share = {}, jackknife(both, _too_large, groups=len(both))
        mean, six = mean_change(both[:, 1], both[:, 0]), six_sigma_change(both[:, 1], both[:, 0])
        scaled = share.value * size, max((share.high - share.value) * size, six.high - six.value)
        g = refined.doubt + refined.factor * UNSEEN / max(len(own), 1)
        for figure, (d, half) in zip(FIGURES, ((mean.value, mean.high - mean.value), scaled)):
            row[figure] = refined.factor * d
            row[f"{figure}_half"] = (refined.factor + g) * half + g * abs(d)
        rows[name] = row
    return pd.DataFrame.from_dict(rows, orient="index")


def _too_large(samples: np.ndarray) -> float:
    """By which share of itself σ of the first column exceeds that of the second; 0 where neither varies."""
    first, second = samples.std(axis=0, ddof=1)
    return float(1 - second / first) if first > 0 else 0.0 if second == 0 else float("nan")


def two_levels(cheap: pd.DataFrame, dear: pd.DataFrame) -> pd.DataFrame:
    """Errors of production where only some of its samples were done better (:mod:`verification.two_level`).

    Parameters
    ----------
    cheap : (N, k) DataFrame
        By sample.
    dear : (n, k) DataFrame
        Some of these samples; those with NaN in either are left out.
    """
    rows = {}
    for name in cheap.columns:
        y = cheap[name].dropna()
        x = dear[name].dropna()
        x = x[x.index.isin(y.index)]
        if not len(x) or len(y) < 2:
            rows[name] = dict.fromkeys(("mean", "mean_half", "six_sigma", "six_sigma_half"), np.nan)
            continue
        found = two_level(y.to_numpy(), [y.index.get_loc(sample) for sample in x.index], x.to_numpy())
        rows[name] = {
            f"{figure}{end}": size
            for figure, off in zip(FIGURES, (found.mean_error, found.six_sigma_error))
            for end, size in (("", off.value), ("_half", off.high - off.value))
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def largest_difference(mine: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Errors of samples that differ from others by so much at most: δ of their mean is no more than that, of 6σ six
    times."""
    most = (mine - truth).abs().max()
    return bounded(most, 6 * most)


def bounded(mean: pd.Series, six_sigma: pd.Series) -> pd.DataFrame:
    """Errors of which no more is known than that they are at most so large."""
    zero = 0.0 * mean
    return pd.DataFrame(
        {"mean": zero, "mean_half": mean.abs(), "six_sigma": 0.0 * six_sigma, "six_sigma_half": six_sigma.abs()}
    )


def total(items: list[Item]) -> pd.DataFrame:
    """The sum of all sources that count and of which something is known, as :class:`Item` has its table."""
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


# --- the sources that the reduced model alone can tell of
# ------------------------------------------------------------------------------------------------------


def _law(case: Case) -> tuple[str, pd.DataFrame]:
    if LAWS[case.law].reads:
        return "the scene gives what its law reads, and means it", case.none()
    if case.law == "coulomb" or not LAWS[case.law].frictional and not case.model.contacts.frictional:
        return "the scene asks for Coulomb's law", case.none()
    return (
        f"the same {case.samples} samples under Coulomb's law in place of {case.law}",
        case.beside(case.of(case.model, law="coulomb"), REFINED["law"]),
    )


def _path(case: Case) -> tuple[str, pd.DataFrame]:
    """Of Coulomb's law where another is printed in its place: how that goes along its path is a part of the other."""
    law = case.law if LAWS[case.law].reads else "coulomb"
    if not case.model.contacts.frictional:
        return "without friction nothing remembers the way", case.none()
    steps = [stage.path for stage in case.model.process(law).stages if stage.resolves]
    kind = "increments" if any(isinstance(path, Increments) for path in steps) else "path"
    given = case.production if law == case.law else case.of(case.model, law)
    better = case.of(case.model, law, tighter)
    how = f"the same {case.samples} samples{f' under the {law} law' * (law != case.law)} on a tighter path"
    return f"{how}; {REFINED[kind].why}", paired(given, better, REFINED[kind], case.six_sigma)


def _pairs(case: Case) -> tuple[str, pd.DataFrame]:
    if not len(case.assembly.contacts):
        return "the scene has no contact pairs", case.none()
    for share in SHARES:
        try:
            model, assembly = reduced_and_assembly(denser(case.assembly, share), case.cache)
            break
        except SceneError:
            if share == SHARES[-1]:
                raise
    refined = nearer(share)
    return (
        f"the same {case.samples} samples with {len(assembly.contacts)} pairs in place of "
        f"{len(case.assembly.contacts)}, at {share:g} of the distance; {refined.why}",
        case.beside(case.of(model), refined),
    )


def _every_node(case: Case) -> tuple[str, pd.DataFrame]:
    """The pairs once more, not extrapolated; of key characteristics, since slips of other points are other figures."""
    if not len(case.assembly.contacts):
        return "the scene has no contact pairs", case.none()
    assembly = assemble(case.assembly.scene, case.cache, every_node=True)
    pairs = len(assembly.contacts)
    if pairs > MOST:
        raise SceneError(f"{pairs} nodes of the zones face the other sheet, of which {MOST} are solved at most")
    model = reduced_model(assembly, case.cache)
    few = case.deviations[:FEW]
    dear = values(model, model.process(case.law).attempt(few)).filter(like="measurement:")
    return (
        f"{len(few)} samples again with contact at each of {pairs} nodes, beside {case.samples} with "
        f"{len(case.assembly.contacts)} pairs (two levels)",
        two_levels(case.production.filter(like="measurement:"), dear),
    )


def _mesh(case: Case) -> tuple[str, pd.DataFrame]:
    finer = with_halved_elements(case.assembly)
    if all(part.superelement is not None for part in finer.parts):
        return "superelements have no mesh", case.none()
    model = reduced_model(finer, case.cache)
    before, after = (sum(len(p.surface.points) for p in one.parts) for one in (case.assembly, finer))
    return (
        f"the same {case.samples} samples on meshes of half the size, {after} nodes in place of {before}, pairs at the "
        f"same points; {REFINED['mesh'].why}. What the element's own theory leaves out is not seen",
        case.beside(case.of(model), REFINED["mesh"]),
    )


def _order(case: Case) -> tuple[str, pd.DataFrame]:
    others = orders(case.model.scene)
    if len(others) == 1:
        return "there is one order only", case.none()
    most = None
    for other in others[1:]:
        again = case.of(replace(case.model, scene=other.scene))
        change = case.beside(again, REFINED["law"])[list(FIGURES)].abs()
        most = change if most is None else most.combine(change, np.fmax)
    return (
        f"the most that {len(others) - 1} other orders change on the same {case.samples} samples",
        bounded(most["mean"], most["six_sigma"]),
    )


#: How each source is estimated: what was done, and errors by quantity.
SOURCES: dict[str, Callable[[Case], tuple[str, pd.DataFrame]]] = {
    "law": _law,
    "path": _path,
    ORDER: _order,
    "pairs": _pairs,
    NODES: _every_node,
    "mesh and element": _mesh,
}


#: Why the sum does not contain a source.
OUTSIDE = {
    ORDER: "the scene states its own order, so that this is no error of it, and the sum does not contain it",
    NODES: "the sum contains what the pairs at a share of the distance say of the same error",
}

#: All that :func:`estimate` knows.
EVERY = (*SOURCES, STIFFNESS)


def stated_order(scene) -> bool:
    """Whether the scene itself says in which order things close or open."""
    return any(stage.order is not None or stage.sequence for stage in scene.stages)


def estimate(case: Case, folder: Path, key: str, team: Team, sources, say=print) -> list[Item]:
    """What each of the sources leaves, shared out over the ranks; what the folder holds already is read.

    Parameters
    ----------
    case : Case
    folder : Path
        Gets one file for each source.
    key : str
        Names the scene, its meshes and its samples.
    team : Team
    sources : collection of str
        Of :data:`SOURCES`, and :data:`STIFFNESS`.
    say : callable
        Called with one line of text for each source that was estimated.
    """
    case.production  # noqa: B018  code is compiled before clocks start, and all ranks need it
    keep = partial(_kept, case, folder=folder, key=key, say=say)
    found = team.map(keep, [source for source in sources if source in SOURCES])
    return found + ([_stiffness(case, folder, key, team, say)] if STIFFNESS in sources else [])


def _stiffness(case: Case, folder: Path, key: str, team: Team, say) -> Item:
    """What the stiffness of the nominal shape leaves: the first samples with those of their own shapes."""
    try:
        stiffness = DeviatedStiffness(case.assembly, case.model)
    except MicError as problem:
        return Item(STIFFNESS, f"not estimated: {problem}", 0.0, None)

    def solve(sample: int) -> dict:
        model, deviations = stiffness.at(case.deviations[sample]), case.deviations[[sample]]
        return values(model, model.process(case.law).attempt(deviations)).iloc[0].to_dict()

    def once(sample: int) -> dict:
        path = folder / f"{_mark(case, f'{STIFFNESS} {sample}', key)}.json"
        return _stored(path, lambda: _timed(lambda: {"values": solve(sample)}))

    found = team.map(once, range(min(DEVIATED, case.samples)))
    seconds = sum(one["seconds"] for one in found)
    if team.rank == 0:
        say(f"  {STIFFNESS}: {seconds:.1f} s")
    how = (
        f"{len(found)} samples again, each with the stiffness of its own deviated shape, beside {case.samples} with "
        "that of the nominal one (two levels)"
    )
    dear = pd.DataFrame([one["values"] for one in found], dtype=float)
    return Item(STIFFNESS, how, seconds, two_levels(case.production, dear))


def _mark(case: Case, what: str, key: str) -> str:
    code = b"".join(Path(__file__).with_name(name).read_bytes() for name in CODE)
    digest = hashlib.sha256(f"{key} {case.law} {case.samples} {what}".encode() + code).hexdigest()[:16]
    return f"{what.replace(' ', '-')}-{digest}"


def _timed(work: Callable[[], dict]) -> dict:
    start = time.process_time()
    return work() | {"seconds": time.process_time() - start}


def _stored(path: Path, work: Callable[[], dict]) -> dict:
    """What the file holds, or what `work` finds, which it then holds."""
    if path.is_file():
        return json.loads(path.read_text())
    found = work()
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(json.dumps(found, indent=1))
    temporary.replace(path)
    return found


def _kept(case: Case, source: str, folder: Path, key: str, say) -> Item:
    counts = source != NODES and (source != ORDER or not stated_order(case.model.scene))
    path = folder / f"{_mark(case, source, key)}.json"

    def solve() -> dict:
        how, table = SOURCES[source](case)
        return {"how": how, "table": json.loads(table.to_json(orient="split", double_precision=15))}

    known = path.is_file()
    try:
        found = _stored(path, lambda: _timed(solve))
    except (MicError, MemoryError) as problem:
        say(f"  {source}: not estimated: {problem}")
        return Item(source, f"not estimated: {problem}", 0.0, None, counts)
    if not known:
        say(f"  {source}: {found['seconds']:.1f} s")
    how = found["how"]
    if not counts:
        how += f"; {OUTSIDE[source]}"
    return Item(source, how, found["seconds"], pd.DataFrame(**found["table"]).astype(float), counts)
