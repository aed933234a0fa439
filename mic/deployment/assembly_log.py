"""Log of a service: which assemblies came in, and what was answered by which model; several processes append to it.

Each line is a JSON record with its checksum (:func:`mic.system.files.to_line`). A ``request`` is on disk before its
assembly is evaluated, an ``answer`` before the client gets it. So no answer is missing after a kill, and requests
without an answer are evaluated at the next start.
"""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mic.errors import FormatError
from mic.studies.drift import WINDOWS
from mic.system.files import Format, append_text, read_line, reading, to_line
from mic.system.regular_files import open_regular

__all__ = ["AssemblyLog", "Content", "LoggedAssembly"]

FORMAT = Format("log of assemblies", 1, "give another file with --log, or move this one away")
TAIL = 100_000_000  # bytes at the end of a log that are read at the start
REMEMBERED = 20_000  # assemblies whose answers are repeated

#: What a client states of an assembly: ``deviations``, a mapping by name, and ``scan``, a serial number or None.
Content = Mapping[str, Any]


@dataclass
class LoggedAssembly:
    """An assembly of the log.

    Attributes
    ----------
    content : Content
    answer : dict or None
        JSON-ready; None before it is known.
    """

    content: Content
    answer: dict[str, Any] | None = None


@dataclass
class AssemblyLog:
    """Log of the assemblies of one service.

    Parameters
    ----------
    path : Path
    service : dict
        Model, version and settings, JSON-ready; written into every record. Records of other services are ignored.

    Attributes
    ----------
    known : OrderedDict of str to LoggedAssembly
        The latest assemblies by identifier, with and without answers.
    recent : deque of dict
        Deviations of the latest answered assemblies, for :func:`mic.studies.drift.drifts`.
    damaged : int
        Lines that are cut short or altered.

    Raises
    ------
    FormatError
        If the file is no such log.
    StorageError
        If it cannot be read.
    """

    path: Path
    service: dict[str, Any]
    known: OrderedDict[str, LoggedAssembly] = field(default_factory=OrderedDict)
    recent: deque[dict[str, float]] = field(default_factory=lambda: deque(maxlen=max(WINDOWS)))
    damaged: int = 0

    def __post_init__(self) -> None:
        if self.path.is_file():
            self._read()

    @property
    def pending(self) -> list[str]:
        """Identifiers of requests without an answer, the oldest first."""
        return [name for name, logged in self.known.items() if logged.answer is None]

    def add_request(self, name: str, content: Content) -> None:
        """Append a request; it is on disk on return.

        Raises
        ------
        StorageError
            If it cannot be written.
        """
        self._append("request", name, content=dict(content))
        self._take_request(name, content)

    def add_answer(self, name: str, answer: dict[str, Any]) -> None:
        """Append the answer to a request; it is on disk on return. Raises as :meth:`add_request`."""
        self._append("answer", name, answer=answer)
        self._take_answer(name, answer)

    def _append(self, event: str, name: str, **content: Any) -> None:
        record = {"event": event, "id": name, "time": round(time.time(), 3), "service": self.service, **content}
        append_text(self.path, to_line(record))

    def _take_request(self, name: str, content: Content) -> None:
        self.known[name] = LoggedAssembly(content)
        if len(self.known) > REMEMBERED:
            oldest = next((key for key, logged in self.known.items() if logged.answer is not None), None)
            if oldest is not None:
                del self.known[oldest]

    def _take_answer(self, name: str, answer: dict[str, Any]) -> None:
        if name in self.known and self.known[name].answer is None:
            self.known[name].answer = answer
            self.recent.append(answer["deviations"])

    def _read(self) -> None:
        with reading(self.path, FORMAT), open_regular(self.path) as file:
            whole = file.seek(0, 2) <= TAIL
            file.seek(0 if whole else -TAIL, 0 if whole else 2)
            if not whole:
                file.readline()
            lines = 0
            for line in file:
                record, lines = read_line(line), lines + bool(line.strip())
                if record is None:
                    self.damaged += bool(line.strip())
                elif record["service"] == self.service:
                    if record["event"] == "request":
                        self._take_request(record["id"], record["content"])
                    else:
                        self._take_answer(record["id"], record["answer"])
        if lines and lines == self.damaged:
            raise FormatError(f"{self.path}: this is no {FORMAT.kind}; {FORMAT.remedy}")
