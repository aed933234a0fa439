"""Running studies into a folder that is readable, and can be taken up again, at any moment.

A run folder holds ``studies/NAME/`` (``result.json``, figures as SVG, tables as CSV), written in one stroke when a
study has finished, ``cache/``, and ``summary.json`` and ``report.html`` at the end. A study is run again when its
result was made by another version of the code, or by the other of the full and the quick version.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import traceback
from pathlib import Path

from threadpoolctl import threadpool_limits

from mic import examples
from mic.execution.ranks import alone, communicator
from mic.results.run_folder import versions
from verification.cost import Cost, Meter, together
from verification.plots import svg
from verification.provenance import provenance
from verification.study import FOLDER, Context, ItemFailed, Judged, Study, Team

__all__ = ["apart", "read_results", "run", "team", "write_summary"]

JUDGED = (FOLDER.parent / "mic", FOLDER.parent / "fem_reference", *map(examples.folder, examples.names()))
SOURCES = (".py", ".toml", ".html")
ROOM = 8.0  # GB that all processes may hold at a time


def team() -> Team:
    """The MPI world when started by ``mpirun``, else this process alone."""
    return Team(communicator())


def run(chosen: list[Study], folder: Path, quick: bool, team: Team, say=print) -> None:
    """Run studies, those already finished left out.

    Each process takes whole studies, whoever is idle the longest of those for which there is room beside what the
    others hold; a study that is longer than a process's share of what is left is shared out over all of them before.
    One that fails is stored as not measured, is run again by the next call, and keeps none of the others from being
    run.

    Parameters
    ----------
    chosen : list of Study
    folder : Path
    quick : bool
    team : Team
    say : callable
        Called with some lines of text at a time, on the rank that has worked.

    Raises
    ------
    Exception
        What one of several ranks raises outside of :meth:`Team.map`, in a study that they share: the others do not
        know of it, and must be ended.
    """
    folder = Path(folder)
    first = team.rank == 0
    base = _digest(JUDGED)
    cache = folder / "cache" / base
    if first:
        for old in (folder / "cache").glob("*"):
            if old != cache:
                shutil.rmtree(old)
        cache.mkdir(parents=True, exist_ok=True)
    missing = {study.name: study.missing() for study in chosen}
    marks = {study.name: _fingerprint(base, study, quick) for study in chosen}
    done = {name for name, mark in marks.items() if _stored(folder / "studies" / name) == mark}
    team.wait()  # nobody writes before everybody has looked
    for study in chosen if first else ():
        if missing[study.name]:
            say(f"{study.name}: left out, {missing[study.name]}")
        elif study.name in done:
            say(f"{study.name}: finished before")
    shared, whole = apart([one for one in chosen if not missing[one.name] and one.name not in done], quick, team.size)
    meter, costs = Meter(team.rank), []

    def take(study: Study, workers: Team) -> None:
        if workers.rank == 0:
            say(f"{study.name}: begun, about {study.seconds[quick]:.0f} s of one core …")
        own = Meter(team.rank)
        judged, error = _judged(study, Context(quick, cache, workers))
        took = workers.of_each(own.read())
        costs.extend(took if workers.rank == 0 else ())
        if workers.rank == 0:
            record = {"fingerprint": "" if error else marks[study.name], "quick": quick, "error": error}
            _store(folder / "studies" / study.name, study, judged, record | _taken(took) | provenance())
            say("\n".join(_told(study, judged, took, error)))

    for study in shared:
        take(study, team)
    for i in team.taken([study.memory for study in whole], ROOM):
        with alone():
            take(whole[i], Team())
    every = [cost for own in team.of_each(costs) for cost in own]
    if first and every:
        wall, cpu = meter.read().wall, sum(cost.cpu for cost in every)
        say(
            f"{len(shared) + len(whole)} studies: {wall:.0f} s on {team.size} processes, {cpu:.0f} s of CPU, "
            f"{cpu / wall:.2f} at a time; at most {together(every):.1f} GB together"
        )


def apart(studies: list[Study], quick: bool, size: int) -> tuple[list[Study], list[Study]]:
    """Studies that several processes share, and those that each takes whole; the longest first.

    What is longer than a process's share of what is left would keep the others waiting. It is taken whole all the same
    where several processes at it might need more than :data:`ROOM`, unless there is nothing else to do.
    """
    queue = sorted(studies, key=lambda study: -study.seconds[quick])
    shared = []
    for study in list(queue):
        if study.memory * size > ROOM and len(queue) > 1:
            continue
        if study.seconds[quick] * size <= sum(one.seconds[quick] for one in queue) * (1 + 1e-9):
            break
        queue.remove(study)
        shared.append(study)
    return shared, queue


def _judged(study: Study, context: Context) -> tuple[list[Judged], str]:
    """What was measured, or that nothing was, and the traceback that says why."""
    try:
        # One BLAS thread: sums are then formed in the same order on every machine and for every number of ranks.
        with threadpool_limits(limits=1, user_api="blas"):
            return study.judge(context), ""
    except Exception as problem:
        if context.team.size > 1 and not isinstance(problem, ItemFailed):
            raise
        error = traceback.format_exc()
        return study.unmeasured(context.quick, f"Not measured: {error.strip().splitlines()[-1]}"), error


def _taken(costs: list[Cost]) -> dict:
    """What a study took, as its record has it: of the processes that worked on it."""
    return {
        "ranks": len(costs),
        "seconds": round(max(cost.wall for cost in costs), 3),
        "cpu_seconds": round(sum(cost.cpu for cost in costs), 3),
        "memory_gb": {cost.process: round(cost.memory, 3) for cost in costs},
        "began": round(min(cost.began for cost in costs), 3),
    }


def _told(study: Study, judged: list[Judged], costs: list[Cost], error: str) -> list[str]:
    """Lines that tell of a study once it has ended."""
    took = _taken(costs)
    where = ", ".join(f"{memory:.1f} GB in process {process}" for process, memory in took["memory_gb"].items())
    lines = [f"{study.name}: ended, {took['seconds']:.0f} s, {took['cpu_seconds']:.0f} s of CPU, {where}"]
    for item in judged:
        unit = "" if item.acceptance.unit == "1" else f" {item.acceptance.unit}"
        lines.append(
            f"  {'passed' if item.passed else 'FAILED'}  {item.finding.name}: {item.finding.measured:.3g} "
            f"({item.acceptance.bound} {item.limit:.3g}{unit})"
        )
    return [*lines, error] if error else lines


def read_results(folder: Path) -> list[dict]:
    """Stored results of a run folder, in the order of the report; each as ``result.json`` holds it, with its
    ``folder``."""
    found = []
    for path in sorted(Path(folder).glob("studies/*/result.json")):
        told = json.loads(path.read_text())
        before = {"cpu_seconds": told["seconds"], "memory_gb": {}}  # of a result that did not record them yet
        found.append(before | told | {"folder": path.parent})
    return sorted(found, key=lambda result: (result["order"], result["study"]))


def write_summary(folder: Path) -> list[dict]:
    """Write ``summary.json``: one entry per acceptance number; seconds and memory are those of its whole study.

    ``memory_gb`` is the most that each process held, by rank; ``began`` counts seconds since 1970.
    """
    entries = [
        {
            "study": result["study"],
            "name": finding["name"],
            "claim": finding["claim"],
            "reference": result["reference"],
            "measured": finding["measured"],
            "bound": finding["bound"],
            "limit": finding["limit"],
            "reason": finding.get("reason", ""),
            "unit": finding["unit"],
            "passed": finding["passed"],
            "error": (result.get("error") or "").strip().rpartition("\n")[2],
            **{key: result.get(key) for key in ("seconds", "cpu_seconds", "memory_gb", "began")},
            "quick": result["quick"],
            "versions": result["versions"],
        }
        for result in read_results(folder)
        for finding in result["findings"]
    ]
    _write(Path(folder) / "summary.json", json.dumps(entries, indent=2, allow_nan=False) + "\n")
    return entries


def _digest(folders) -> str:
    """Hash of all sources in folders and files."""
    digest = hashlib.sha256()
    for folder in folders:
        paths = sorted(folder.rglob("*")) if folder.is_dir() else [folder]
        for path in paths:
            if path.suffix in SOURCES and path.is_file():
                digest.update(path.relative_to(FOLDER.parent).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _fingerprint(base: str, study: Study, quick: bool) -> str:
    own = _digest([*sorted(FOLDER.glob("*.py")), FOLDER / study.name])
    return hashlib.sha256(json.dumps([base, own, quick, versions()]).encode()).hexdigest()[:16]


def _stored(target: Path) -> str | None:
    path = target / "result.json"
    return json.loads(path.read_text())["fingerprint"] if path.is_file() else None


def _store(target: Path, study: Study, judged: list[Judged], record: dict) -> None:
    """Write the folder of a study in one stroke."""
    partial = target.with_name(f".{target.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    findings = []
    for item in judged:
        finding, acceptance = item.finding, item.acceptance
        entry = {
            "name": finding.name,
            "claim": acceptance.claim,
            "measured": _number(finding.measured),
            "bound": acceptance.bound,
            "limit": item.limit,
            "reason": acceptance.reason,
            "unit": acceptance.unit,
            "passed": item.passed,
            "note": finding.note,
        }
        if finding.figure is not None:
            entry["figure"] = f"{finding.name}.svg"
            (partial / entry["figure"]).write_bytes(svg(finding.figure))
        if finding.table is not None:
            entry["table"] = f"{finding.name}.csv"
            finding.table.to_csv(partial / entry["table"], index=False)
        findings.append(entry)
    content = {
        "study": study.name,
        "order": study.order,
        "title": study.title,
        "claim": study.claim,
        "reference": study.reference,
        "findings": findings,
        "versions": versions(),
    } | record
    (partial / "result.json").write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")
    shutil.rmtree(target, ignore_errors=True)
    partial.replace(target)


def _number(value) -> float | None:
    return float(value) if math.isfinite(value) else None


def _write(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(text)
    temporary.replace(path)
