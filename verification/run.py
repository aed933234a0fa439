"""Run studies into a folder from which an interrupted run resumes.

A run folder contains ``studies/NAME/`` (``result.json``, figures as SVG, tables as CSV), written atomically when a
study has finished, ``cache/``, ``summary.json`` and ``report.html``. A study is run again if its stored result is from
another version of the code, or from the full version instead of the quick one or the reverse.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import subprocess
import sys
import traceback
from contextlib import closing
from functools import partial
from pathlib import Path

from threadpoolctl import threadpool_limits

from mic import examples
from mic.execution.local import Local
from mic.execution.ranks import alone, communicator
from mic.results.run_folder import versions
from mic.system.cores import available_cores
from mic.system.files import write_text
from verification import domain
from verification.cost import Cost, Meter, together
from verification.plots import svg
from verification.provenance import provenance
from verification.study import FOLDER, CheckedFinding, Context, ItemFailed, Study, Team

__all__ = ["compile_kernels", "read_results", "run", "shared_and_whole", "team", "write_summary"]

VERIFIED_CODE = (FOLDER.parent / "mic", FOLDER.parent / "fem_reference", *map(examples.folder, examples.names()))
SOURCES = (".py", ".toml", ".html")
MEMORY = 8.0  # GB of all processes together
QUICK_MEMORY = 2.0  # GB: no quick study takes more


def team() -> Team:
    """The processes of ``mpirun``, or this process alone."""
    return Team(communicator())


def run(chosen: list[Study], folder: Path, quick: bool, team: Team, say=print) -> None:
    """Run the studies that are not finished.

    Studies longer than a process's share of the total time are divided over all processes first. Each process then
    takes whole studies, the longest first that fits into the remaining memory. Without ``mpirun``, quick studies, which
    need little memory, are shared by forks of this process on all cores. A study that raises an error is stored as not
    measured, and is run again by the next call; the others still run.

    Parameters
    ----------
    chosen : list of Study
    folder : Path
    quick : bool
    team : Team
    say : callable
        Called with lines of text on the rank that did the work.

    Raises
    ------
    Exception
        An error of one rank outside of :meth:`Team.map` in a shared study; the caller must then end all ranks.
    """
    folder = Path(folder)
    first = team.rank == 0
    base = _digest(VERIFIED_CODE)
    cache = folder / "cache" / base
    if first:
        for old in (folder / "cache").glob("*"):
            if old != cache:
                shutil.rmtree(old)
        cache.mkdir(parents=True, exist_ok=True)
    missing = {study.name: study.missing() for study in chosen}
    marks = {study.name: _fingerprint(base, study, quick) for study in chosen}
    done = {name for name, mark in marks.items() if _stored(folder / "studies" / name) == mark}
    team.wait()  # all ranks have read the stored results before one writes
    for study in chosen if first else ():
        if missing[study.name]:
            say(f"{study.name}: skipped, {missing[study.name]}")
        elif study.name in done:
            say(f"{study.name}: already finished")
    pending = [study for study in chosen if not missing[study.name] and study.name not in done]
    shared, whole = shared_and_whole(pending, quick, team.size)
    forks = Local(min(available_cores(), int(MEMORY / QUICK_MEMORY)) if quick and team.size == 1 else 1)
    meter, costs = Meter(team.rank), []
    perform = partial(_perform, folder / "studies", marks, quick, cache, team.rank if forks.workers == 1 else None)

    def begin(study: Study) -> None:
        say(f"{study.name}: started, about {study.seconds[quick]:.0f} s on one core …")

    def end(lines: list[str], of_processes: list[Cost]) -> None:
        costs.extend(of_processes)
        if lines:
            say("\n".join(lines))

    for study in shared:
        if first:
            begin(study)
        end(*perform(study, team))
    if forks.workers > 1 and whole:
        say(f"{len(whole)} studies on {forks.workers} processes …")
        with closing(forks.completed(perform, whole)) as completed:
            for _, found in completed:
                end(*found)
    else:
        for i in team.taken([_memory(study, quick) for study in whole], MEMORY):
            with alone():
                begin(whole[i])
                end(*perform(whole[i]))
    every = [cost for of_rank in team.of_each(costs) for cost in of_rank]
    if first and every:
        wall, cpu = meter.read().wall, sum(cost.cpu for cost in every)
        say(
            f"{len(shared) + len(whole)} studies: {wall:.0f} s on {max(team.size, forks.workers)} processes, "
            f"{cpu:.0f} s of CPU, {cpu / wall:.2f} cores used; peak memory {together(every):.1f} GB"
        )


def compile_kernels(team: Team) -> None:
    """Compile the contact solver if that has not been done: once, on two cores, and not on every rank.

    Raises
    ------
    subprocess.CalledProcessError
        On the first rank.
    """
    if team.rank == 0:
        subprocess.run([sys.executable, "-m", "mic.commands.compile"], check=True)
    team.wait()


def _perform(
    target: Path,
    marks: dict[str, str],
    quick: bool,
    cache: Path,
    process: int | None,
    study: Study,
    workers: Team | None = None,
) -> tuple[list[str], list[Cost]]:
    """Run and store a study; its console lines and the costs of its processes, on the first of them.

    Parameters
    ----------
    target : Path
        Folder of the studies.
    marks : dict
        Fingerprint of each study.
    quick : bool
    cache : Path
    process : int or None
        Number of this process; None: that of the system.
    study : Study
    workers : Team, optional
        Default: this process alone.
    """
    workers = workers or Team()
    meter = Meter(os.getpid() if process is None else process)
    domain.collected()  # forget what other studies have recorded
    checked, error = _evaluated(study, Context(quick, cache, workers))
    covered = domain.merged(workers.of_each(domain.collected())) if study.judges_accuracy else {}
    costs = workers.of_each(meter.read())
    if workers.rank > 0:
        return [], []
    record = {"fingerprint": "" if error else marks[study.name], "quick": quick, "error": error}
    record |= {"domain": covered, "measured_assembly": study.measured_assembly} | _cost_record(costs) | provenance()
    _store(target / study.name, study, checked, record)
    return _result_lines(study, checked, costs, error), costs


def _memory(study: Study, quick: bool) -> float:
    """Peak memory of one process, GB."""
    return min(study.memory, QUICK_MEMORY) if quick else study.memory


def shared_and_whole(studies: list[Study], quick: bool, size: int) -> tuple[list[Study], list[Study]]:
    """Studies that all processes share, and studies that one process runs; the longest first.

    A study is shared if it is longer than a process's part of the remaining time, unless all processes together would
    exceed :data:`MEMORY` and there are other studies to run.
    """
    queue = sorted(studies, key=lambda study: -study.seconds[quick])
    shared = []
    for study in list(queue):
        if _memory(study, quick) * size > MEMORY and len(queue) > 1:
            continue
        if study.seconds[quick] * size <= sum(other.seconds[quick] for other in queue) * (1 + 1e-9):
            break
        queue.remove(study)
        shared.append(study)
    return shared, queue


def _evaluated(study: Study, context: Context) -> tuple[list[CheckedFinding], str]:
    """Findings of a study and an empty string, or unmeasured findings and the traceback."""
    try:
        # One BLAS thread: the order of summation does not depend on the machine or the number of ranks.
        with threadpool_limits(limits=1, user_api="blas"):
            return study.evaluate(context), ""
    except Exception as problem:
        if context.team.size > 1 and not isinstance(problem, ItemFailed):
            raise
        error = traceback.format_exc()
        return study.unmeasured(context.quick, f"Not measured: {error.strip().splitlines()[-1]}"), error


def _cost_record(costs: list[Cost]) -> dict:
    """Time and memory of a study, over its processes, for its record."""
    return {
        "ranks": len(costs),
        "seconds": round(max(cost.wall for cost in costs), 3),
        "cpu_seconds": round(sum(cost.cpu for cost in costs), 3),
        "memory_gb": {cost.process: round(cost.memory, 3) for cost in costs},
        "began": round(min(cost.began for cost in costs), 3),
    }


def _result_lines(study: Study, checked: list[CheckedFinding], costs: list[Cost], error: str) -> list[str]:
    """Console lines on a finished study."""
    cost = _cost_record(costs)
    memory = ", ".join(f"{gigabytes:.1f} GB in process {process}" for process, gigabytes in cost["memory_gb"].items())
    lines = [f"{study.name}: finished, {cost['seconds']:.0f} s, {cost['cpu_seconds']:.0f} s of CPU, {memory}"]
    for item in checked:
        unit = "" if item.acceptance.unit == "1" else f" {item.acceptance.unit}"
        lines.append(
            f"  {'passed' if item.passed else 'FAILED'}  {item.finding.name}: {item.finding.measured:.3g} "
            f"({item.acceptance.bound} {item.limit:.3g}{unit})"
        )
    return [*lines, error] if error else lines


def read_results(folder: Path) -> list[dict]:
    """Stored results of a run folder in the order of the report: the content of ``result.json`` and its ``folder``."""
    results = [
        json.loads(path.read_text()) | {"folder": path.parent} for path in Path(folder).glob("studies/*/result.json")
    ]
    return sorted(results, key=lambda result: (result["order"], result["study"]))


def write_summary(folder: Path) -> list[dict]:
    """Write ``summary.json``: one entry per acceptance limit, with time and memory of the whole study.

    ``memory_gb`` is the peak memory of each process by rank; ``began`` is in seconds since 1970.
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
            "uncertainty": finding.get("uncertainty"),
            "error": (result.get("error") or "").strip().rpartition("\n")[2],
            **{key: result.get(key) for key in ("seconds", "cpu_seconds", "memory_gb", "began")},
            "quick": result["quick"],
            "versions": result["versions"],
        }
        for result in read_results(folder)
        for finding in result["findings"]
    ]
    write_text(Path(folder) / "summary.json", json.dumps(entries, indent=2, allow_nan=False) + "\n")
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
    code = _digest([*sorted(FOLDER.glob("*.py")), FOLDER / study.name])
    return hashlib.sha256(json.dumps([base, code, quick, versions()]).encode()).hexdigest()[:16]


def _stored(target: Path) -> str | None:
    path = target / "result.json"
    return json.loads(path.read_text())["fingerprint"] if path.is_file() else None


def _store(target: Path, study: Study, checked: list[CheckedFinding], record: dict) -> None:
    """Write the folder of a study atomically."""
    partial = target.with_name(f".{target.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    findings = []
    for item in checked:
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
            "uncertainty": finding.uncertainty and finding.uncertainty.record(finding.measured),
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
