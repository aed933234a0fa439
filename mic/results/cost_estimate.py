"""Lower bounds of time and disk space of a run, checked before it starts."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mic.contact.laws import LAWS
from mic.errors import RunError
from mic.process.plan import plan_stages

__all__ = ["Forecast", "duration", "forecast"]

# Lower bounds: dense assemblies and hard contact problems take several times as long.
SECONDS = 1e-5  # one contact pair in one increment of one sample, on one core
BYTES = 40  # one stored contact pair of one sample in one stage
PER_SAMPLE = 300  # bytes per sample of any scene
LONGEST = 365.25 * 86400  # s
LARGEST = 2**31 - 1  # the results number samples in 32 bits


@dataclass(frozen=True)
class Forecast:
    """Lower bounds of the time and disk space of a run.

    Attributes
    ----------
    samples : int
    seconds : float
        Wall time on all cores.
    size : float
        Bytes.
    """

    samples: int
    seconds: float
    size: float

    def __str__(self) -> str:
        return f"at least {duration(self.seconds)} and {_size(self.size)} on disk"

    def check(self, folder: Path) -> None:
        """Raise :class:`RunError` for a run longer than a year, or whose results do not fit on the disk."""
        folder = Path(folder).absolute()
        free = shutil.disk_usage(next(path for path in (folder, *folder.parents) if path.is_dir())).free
        takes = f"{self.samples} samples would take {self}"
        if self.samples > LARGEST:
            raise RunError(f"{takes}, and a run has at most {LARGEST} samples; request fewer samples")
        if self.size > free:
            raise RunError(f"{takes}, but {folder} has {_size(free)} free; request fewer samples or free disk space")
        if self.seconds > LONGEST:
            raise RunError(f"{takes}; request fewer samples or increments")


def forecast(assembly, laws: Sequence[str], samples: int, cores: int) -> Forecast:
    """Lower bounds for a Monte Carlo.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    laws : sequence of str
    samples : int
        Samples of each law.
    cores : int
    """
    contacts = assembly.contacts
    resolved = [plan for plan in plan_stages(assembly.scene, assembly.weld_size) if plan.resolves and len(contacts)]
    solves = [len(contacts) * sum(plan.solves(LAWS[law]) for plan in resolved) for law in laws]
    stored = BYTES * len(contacts) * len(resolved)
    if assembly.scene.report.fields:
        stored += 8 * (int(assembly.offsets[-1]) + 6 * len(assembly.parts))
    seconds = sum(1e-5 + SECONDS * pairs for pairs in solves)
    size = samples * PER_SAMPLE + min(samples, assembly.scene.report.contacts) * stored
    return Forecast(samples, samples * seconds / cores, float(len(laws) * size))


def duration(seconds: float) -> str:
    """A time, s, as text."""
    units = {"years": 365.25 * 86400, "days": 86400, "hours": 3600, "minutes": 60}
    return _in_units(seconds, units, 2) or f"{max(1, math.ceil(seconds))} s"


def _size(count: float) -> str:
    return _in_units(count, {"PB": 1e15, "TB": 1e12, "GB": 1e9, "MB": 1e6}, 1) or f"{math.ceil(count / 1e3)} kB"


def _in_units(value: float, units: dict[str, float], least: float) -> str:
    """The value in the largest unit of which it has at least so many; empty if there is none."""
    for name, unit in units.items():
        if value >= least * unit:
            return f"{value / unit:.2g} {name}" if value < 100 * unit else f"{value / unit:.0f} {name}"
    return ""
