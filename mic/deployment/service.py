"""The service behind ``mic serve``: a bounded queue of assemblies in front of worker processes; no network here.

Each worker takes one assembly at a time. A worker that takes too long is killed, and one that was killed is replaced;
its assembly is evaluated once more before its answer is "failed".
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mic import __version__
from mic.deployment.assembly_log import AssemblyLog, Content
from mic.errors import ArgumentError, MicError, SceneError, StorageError, WorkerLost
from mic.execution.engine import Engine, StandingWorker
from mic.process.process import TOLERANCE
from mic.results.run_identity import identity
from mic.studies.drift import drifts
from mic.studies.prediction import Predictor
from mic.studies.scan import ScannedAssembly, ScanReader, checksum, scan_files
from mic.system.arguments import did_you_mean, numbers_by_name

__all__ = ["Busy", "Conflict", "ScanFolder", "Service", "predict_assembly"]

ATTEMPTS = 2  # evaluations of an assembly whose workers are killed
TIMES = 1000  # latest answers whose times are summarised
RETRY_DELAY = 1.0  # s before an answer that could not be logged is logged again


class Busy(Exception):
    """The queue is full."""


class Conflict(Exception):
    """The identifier belongs to an assembly with other content."""


@dataclass(frozen=True)
class ScanFolder:
    """Scans of assemblies in a folder, into which a scanner writes.

    Attributes
    ----------
    reader : ScanReader
    folder : Path
    """

    reader: ScanReader
    folder: Path

    def content(self, serial: str) -> dict[str, Any]:
        """Log entry of the scans of a serial number: the number, and a checksum of the files.

        Raises
        ------
        ArgumentError
            If there are none.
        """
        return {"scan": serial, "checksum": checksum(self._files(serial))}

    def read(self, content: Content) -> ScannedAssembly:
        """The deviations from the scans of a request.

        Raises
        ------
        SceneError
            As :meth:`mic.studies.scan.ScanReader.read`, and if the files are not those of the request.
        """
        serial = content["scan"]
        files = self._files(serial)
        if checksum(files) != content["checksum"]:
            raise SceneError(f"scan: the files of {serial} have changed since the request; repeat it with another id")
        return self.reader.read(files, serial)

    def _files(self, serial: str) -> dict[str, Path]:
        found = scan_files(self.folder, self.reader.model.scene)[0].get(serial)
        if not found:
            raise ArgumentError(f"scan: the folder of the scans has none of {serial}; give its serial number")
        return found


def predict_assembly(predictor: Predictor, content: Content, scans: ScanFolder | None = None) -> dict[str, Any]:
    """The answer for one assembly, JSON-ready: verdict, characteristics, adjustments and certificate.

    Parameters
    ----------
    predictor : Predictor
    content : Content
    scans : ScanFolder, optional
        For contents with a scan. Stated deviations replace those of the scan.

    Raises
    ------
    SceneError
        If a scan cannot be used.
    """
    values, covariance, unexplained, messages = dict(content["deviations"]), None, 0.0, []
    if scans is not None and "scan" in content:
        scanned = scans.read(content)
        stated = [predictor.model.parameters.index(name) for name in values]
        values, covariance, unexplained = scanned.values | values, scanned.covariance.copy(), scanned.error
        covariance[stated], covariance[:, stated] = 0.0, 0.0
        messages = list(scanned.messages)
    found = predictor.predict(values, covariance, unexplained)
    *rows, whole = found.to_dict("records")
    limits = {item.name: (item.lower, item.upper) for item in predictor.model.scene.measurements}
    certificate: dict[str, Any] = {"method": rows[0]["way"] if rows else "none"}
    evaluation, emulator = predictor.evaluation, predictor.emulator
    if rows and evaluation is not None:
        residuals = [float(one.residual[0]) for one in evaluation.resolutions.values()]
        certificate |= {"residual": max(residuals, default=0.0), "tolerance": TOLERANCE}
    elif rows and emulator is not None:
        certificate |= {"error_bound": dict(zip(limits, emulator.error_bound.tolist()))}
    proposal, adjusted = predictor.proposal, {}
    if proposal is not None and (proposal.changes or proposal.order):
        certificate |= {"adjusted_residual": float(proposal.residual)}
        adjusted = dict(zip(limits, proposal.after.tolist()))
    return {
        "verdict": whole["verdict"],
        "reason": whole["said"],
        "adjustments": [
            {"name": item.name, "change": float(change), "unit": item.unit}
            for item, change in (proposal.changes.items() if proposal is not None else ())
        ],
        "characteristics": [
            {
                "name": row["measurement"],
                **{key: float(row[key]) for key in ("value", "low", "high")},
                **{key: _finite(bound) for key, bound in zip(("lower", "upper"), limits[row["measurement"]])},
                "adjusted": adjusted.get(row["measurement"]),
                "verdict": row["verdict"],
            }
            for row in rows
        ],
        "certificate": certificate,
        "distance": _finite(whole["far"]),
        "messages": messages,
        "deviations": values,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


class _Work:
    """:func:`predict_assembly` with its predictor, for worker processes; some systems receive it pickled."""

    def __init__(self, predictor: Predictor, scans: ScanFolder | None):
        self._predictor, self._scans = predictor, scans

    def __call__(self, content: Content) -> dict[str, Any]:
        return predict_assembly(self._predictor, content, self._scans)


class Service:
    """Answers assemblies.

    Parameters
    ----------
    predictor : Predictor
    log : callable
        Makes the :class:`AssemblyLog` of a service's description.
    engine : Engine
    settings : dict
        Options that the answers depend on, JSON-ready.
    queue : int
        Largest number of assemblies that wait for a worker.
    seconds : float
        Longest evaluation of an assembly, s.
    work : callable, optional
        Called with the content of an assembly in a worker process; returns the answer. Default:
        :func:`predict_assembly`.
    scans : ScanFolder, optional

    Attributes
    ----------
    description : dict
        Model, version and settings.
    log : AssemblyLog
    counts : Counter
        Number of answers by verdict, and of refused requests by status.
    times : deque of float
        Time from request to answer of the latest assemblies, s.
    drift : list of str
        Sentences of :func:`mic.studies.drift.drifts` after the latest answer.
    """

    def __init__(
        self,
        predictor: Predictor,
        log: Callable[[dict[str, Any]], AssemblyLog],
        engine: Engine,
        settings: dict[str, Any],
        queue: int,
        seconds: float,
        work: Callable[[Content], dict[str, Any]] | None = None,
        scans: ScanFolder | None = None,
    ):
        self.model, self.seconds, self.limit, self._scans = predictor.model, seconds, queue, scans
        fingerprint = identity(self.model, 0)[:12]
        self.description = {"model": fingerprint, "version": __version__, "law": predictor.law, **settings}
        self.log = log(self.description)
        self.counts: Counter[str] = Counter()
        self.times: deque[float] = deque(maxlen=TIMES)
        self.drift = drifts(self.model.scene, list(self.log.recent))
        self.storage_problem = ""
        if work is None:
            predict_assembly(predictor, {"deviations": {}})  # loads compiled code, which forked workers inherit
        self._workers = engine.standing(work or _Work(predictor, scans))
        self._queue: asyncio.Queue[tuple[str, float]] = asyncio.Queue()
        self._open: dict[str, tuple[Content, asyncio.Future[dict[str, Any]]]] = {}
        self._tasks: list[asyncio.Task[None]] = []
        self._logging = asyncio.Lock()

    @property
    def workers(self) -> int:
        """Number of worker processes."""
        return len(self._workers)

    @property
    def problem(self) -> str:
        """Why assemblies cannot be answered now; empty if they can."""
        broken = any(task.done() for task in self._tasks)
        return self.storage_problem or ("a worker has failed; start the service again" if broken else "")

    @property
    def answered(self) -> int:
        """Number of answers."""
        return sum(count for key, count in self.counts.items() if not key.startswith("status"))

    @property
    def waiting(self) -> int:
        """Number of assemblies without an answer."""
        return len(self._open)

    def start(self) -> None:
        """Begin with the assemblies whose requests were logged and not answered; needs a running event loop."""
        for name in self.log.pending:
            self._opened(name, self.log.known[name].content)
            self._queue.put_nowait((name, time.monotonic()))
        self._tasks = [asyncio.create_task(self._serve(worker)) for worker in self._workers]

    async def stop(self) -> None:
        """End the workers; requests without an answer stay in the log."""
        for task in self._tasks:
            task.cancel()
        for worker in self._workers:
            worker.stop()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def content(self, deviations: dict[str, float], scan: str | None) -> Content:
        """Content of a request, with a checksum of the scans of its serial number.

        Raises
        ------
        ArgumentError
            If there are no such scans.
        """
        if scan is None:
            return {"deviations": deviations}
        if self._scans is None:
            raise ArgumentError("scan: the service has no scans; start it with --scans FOLDER")
        return {"deviations": deviations, **await asyncio.to_thread(self._scans.content, scan)}

    async def ask(self, name: str, content: Content) -> dict[str, Any]:
        """The answer for an assembly; a repeated request gets the logged answer.

        Parameters
        ----------
        name : str
            Identifier of the assembly.
        content : Content

        Raises
        ------
        ArgumentError
            For unknown names of deviations.
        Busy, Conflict
        StorageError
            If the request cannot be logged.
        """
        for deviation in numbers_by_name("deviations", content["deviations"]):
            if deviation not in self.model.parameters:
                known = did_you_mean(deviation, self.model.parameters)
                raise ArgumentError(f"deviations: there is no {deviation[:50]!r}; {known}")
        logged = self.log.known.get(name)
        before = logged.content if logged is not None else self._open[name][0] if name in self._open else content
        if before != content:
            raise Conflict
        if logged is not None and logged.answer is not None:
            return logged.answer
        if name not in self._open:
            if self.waiting >= self.limit + self.workers:
                raise Busy
            answer = self._opened(name, content)
            try:
                async with self._logging:
                    await asyncio.to_thread(self.log.add_request, name, content)
            except StorageError as problem:
                self.storage_problem = str(problem)
                del self._open[name]
                answer.set_exception(problem)
            else:
                self.storage_problem = ""
                self._queue.put_nowait((name, time.monotonic()))
            return await asyncio.shield(answer)
        return await asyncio.shield(self._open[name][1])

    def _opened(self, name: str, content: Content) -> asyncio.Future[dict[str, Any]]:
        """The future answer of an assembly."""
        self._open[name] = content, asyncio.get_running_loop().create_future()
        return self._open[name][1]

    async def _serve(self, worker: StandingWorker[Content, dict[str, Any]]) -> None:
        """Answer assemblies with one worker, without end."""
        while True:
            name, since = await self._queue.get()
            content, future = self._open[name]
            answer = await self._evaluated(worker, content)
            answer |= {"seconds": round(time.monotonic() - since, 6)}
            await self._logged(name, answer)
            self.counts[answer["verdict"]] += 1
            self.times.append(answer["seconds"])
            self.drift = drifts(self.model.scene, list(self.log.recent))
            del self._open[name]
            if not future.done():
                future.set_result(answer)

    async def _logged(self, name: str, answer: dict[str, Any]) -> None:
        """Log an answer; on a full disk, wait until there is room: no answer is given that is not in the log."""
        while True:
            try:
                async with self._logging:
                    await asyncio.to_thread(self.log.add_answer, name, answer)
            except StorageError as problem:
                self.storage_problem = str(problem)
                await asyncio.sleep(RETRY_DELAY)
            else:
                self.storage_problem = ""
                return

    async def _evaluated(self, worker: StandingWorker[Content, dict[str, Any]], content: Content) -> dict[str, Any]:
        """The answer of a worker, or a failed one with the reason."""
        reason = ""
        for _ in range(ATTEMPTS):
            try:
                return await asyncio.to_thread(worker.do, content, self.seconds)
            except WorkerLost as problem:
                reason = str(problem)
            except (MicError, TimeoutError) as problem:
                reason = str(problem)
                break
            except Exception as problem:  # an error of the program; the service goes on
                reason = f"{type(problem).__name__}: {problem}"
                break
        return {
            "verdict": "failed",
            "reason": reason,
            "adjustments": [],
            "characteristics": [],
            "certificate": {"method": "none"},
            "distance": None,
            "messages": [],
            "deviations": dict(content["deviations"]),
        }
