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
import time
from pathlib import Path

from threadpoolctl import threadpool_limits

from mic import examples
from mic.results.folder import versions
from mic.sampling.ranks import communicator
from verification.plots import svg
from verification.provenance import provenance
from verification.study import FOLDER, Context, Judged, Study, Team

__all__ = ["read_results", "run", "team", "write_summary"]

JUDGED = (FOLDER.parent / "mic", FOLDER.parent / "fem_reference", *map(examples.folder, examples.names()))
SOURCES = (".py", ".toml", ".html")


def team() -> Team:
    """The MPI world when started by ``mpirun``, else this process alone."""
    return Team(communicator())


def run(chosen: list[Study], folder: Path, quick: bool, team: Team, say=print) -> None:
    """Run studies, those already finished left out.

    Parameters
    ----------
    chosen : list of Study
    folder : Path
    quick : bool
    team : Team
    say : callable
        Called on the first rank with one line of text at a time.
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
    context = Context(quick, cache, team)
    for study in chosen:
        if study.missing():
            if first:
                say(f"{study.name}: left out, {study.missing()}")
            continue
        fingerprint = _fingerprint(base, study, quick)
        target = folder / "studies" / study.name
        done = _stored(target) == fingerprint
        team.wait()  # nobody writes before everybody has looked
        if done:
            if first:
                say(f"{study.name}: finished before")
            continue
        if first:
            say(f"{study.name}: about {study.seconds[quick]:.0f} s of one core …")
        start = time.perf_counter()
        # One BLAS thread: sums are then formed in the same order on every machine and for every number of ranks.
        with threadpool_limits(limits=1, user_api="blas"):
            judged = study.judge(context)
        seconds = time.perf_counter() - start
        if first:
            _store(
                target,
                study,
                judged,
                {"fingerprint": fingerprint, "quick": quick, "ranks": team.size, "seconds": round(seconds, 3)}
                | provenance(),
            )
            for item in judged:
                say(
                    f"  {'passed' if item.passed else 'FAILED'}  {item.finding.name}: {item.finding.measured:.3g} "
                    f"({item.acceptance.bound} "
                    f"{item.limit:.3g}{'' if item.acceptance.unit == '1' else ' ' + item.acceptance.unit})"
                )
    team.wait()


def read_results(folder: Path) -> list[dict]:
    """Stored results of a run folder, in the order of the report; each as ``result.json`` holds it, with its
    ``folder``."""
    found = []
    for path in sorted(Path(folder).glob("studies/*/result.json")):
        found.append(json.loads(path.read_text()) | {"folder": path.parent})
    return sorted(found, key=lambda result: (result["order"], result["study"]))


def write_summary(folder: Path) -> list[dict]:
    """Write ``summary.json``: one entry per acceptance number, ``seconds`` being those of its whole study."""
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
            "seconds": result["seconds"],
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
