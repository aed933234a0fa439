"""The processes that share a run: all that ``mpirun`` started, or this one alone."""

from __future__ import annotations

import os
from typing import Any

from mic.compliance import provider

__all__ = ["communicator"]


def communicator() -> Any:
    """The MPI world when started by ``mpirun``, else None (a single process needs no MPI)."""
    if int(os.environ.get("OMPI_COMM_WORLD_SIZE", os.environ.get("PMI_SIZE", "1"))) > 1:
        from mpi4py import MPI  # only here: importing it starts MPI

        provider.installed()  # their libraries start up collectively: later, a process alone would wait for ever
        return MPI.COMM_WORLD
    return None
