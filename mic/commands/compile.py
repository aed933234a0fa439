"""Compile kernels in advance: ``python -m mic.commands.compile``, or only those of a run with ``--run``.

Numba caches the compiled code beside the program, or in ``NUMBA_CACHE_DIR``. The cores share the kernels: one is
compiled after those that it calls, which are then read from the cache. What ``--run`` leaves out, the derivatives of
paths, takes a quarter of the time.
"""

from __future__ import annotations

import logging
import sys
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from pkgutil import iter_modules

import numpy as np
from rich.progress import Progress
from scipy.sparse import csr_matrix

from mic.compliance.blocks import Blocks
from mic.contact import native
from mic.contact.laws import LAWS
from mic.contact.native.kernel import Kernel
from mic.contact.native.law_equation import compiled
from mic.system import compilation
from mic.system.cores import available_cores
from mic.system.matrix_product import product

#: What :mod:`mic.contact.tangent` alone needs.
DERIVATIVES = {"linear_problem", "linearised_law", "path_derivative", "touching"}


def kernels(derivatives: bool) -> list[Kernel]:
    """The kernels of :mod:`mic.contact.native`, with or without those of derivatives."""
    names = {module.name for module in iter_modules(native.__path__)} - (set() if derivatives else DERIVATIVES)
    modules = [import_module(f"{native.__name__}.{name}") for name in sorted(names)]
    return list({value: None for module in modules for value in vars(module).values() if isinstance(value, Kernel)})


def silence() -> None:
    """Do not say that something is compiled: the bar does."""
    logging.getLogger(compilation.__name__).setLevel(logging.ERROR)


def load_kernel(module: str, name: str) -> None:
    """Compile a kernel in a process of its own, or read it from the cache."""
    getattr(import_module(module), name).load()


def load_others() -> None:
    """Compile the functions outside of :mod:`mic.contact.native`, and the equations of the laws."""
    product(np.ones((1, 1)), np.ones((1, 1)))
    for law in LAWS.values():
        if law.equation is not None:
            compiled(law.equation)
    one = csr_matrix(np.ones((1, 1)))
    Blocks((np.ones((1, 1)),), (np.zeros((1, 6)),)).gather(one, one)


def load_all(chosen: list[Kernel], processes: int) -> None:
    """Compile kernels and all other functions; first the kernel with the longest chain of callers."""
    calls = {kernel: kernel.called for kernel in chosen}
    order = TopologicalSorter(calls)
    order.prepare()

    @cache
    def length(kernel: Kernel) -> int:
        callers = (length(caller) for caller, called in calls.items() if kernel in called)
        return len(kernel.__code__.co_code) + max(callers, default=0)

    with ProcessPoolExecutor(processes, initializer=silence) as pool, Progress(transient=True) as progress:
        bar = progress.add_task("compiling the contact solver", total=len(calls))
        ready: list[Kernel] = []
        running: dict[Future, Kernel | None] = {pool.submit(load_others): None}
        while running or order.is_active():
            ready = sorted([*ready, *order.get_ready()], key=length)
            while ready and len(running) < processes:
                kernel = ready.pop()
                running[pool.submit(load_kernel, kernel.__module__, kernel.__qualname__)] = kernel
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                done.result()
                compiled_one = running.pop(done)
                if compiled_one is not None:
                    order.done(compiled_one)
                    progress.advance(bar)


if __name__ == "__main__":
    load_all(kernels(derivatives="--run" not in sys.argv[1:]), available_cores())
