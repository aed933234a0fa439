"""Compile all kernels in advance: ``python -m mic.commands.compile``.

Numba caches the compiled code beside the program, or in ``NUMBA_CACHE_DIR``. Two processes compile in parallel.
"""

from __future__ import annotations

import sys
from importlib import import_module
from multiprocessing import get_context
from pkgutil import iter_modules

import numpy as np
from scipy.sparse import csr_matrix

from mic.compliance.blocks import Blocks
from mic.contact import native
from mic.contact.laws import LAWS
from mic.contact.native.kernel import Kernel
from mic.contact.native.law_equation import compiled
from mic.system.matrix_product import product


def load_kernels(names: list[str]) -> None:
    """Compile the kernels of modules of :mod:`mic.contact.native`."""
    for name in names:
        for value in vars(import_module(f"{native.__name__}.{name}")).values():
            if isinstance(value, Kernel):
                value.load()


if __name__ == "__main__":
    names = [module.name for module in iter_modules(native.__path__)]
    # From both ends: what the other process has compiled by then is read from the cache.
    other = get_context("fork").Process(target=load_kernels, args=(names[::-1],))
    other.start()
    load_kernels(names)
    product(np.ones((1, 1)), np.ones((1, 1)))
    for law in LAWS.values():
        if law.equation is not None:
            compiled(law.equation)
    one = csr_matrix(np.ones((1, 1)))
    Blocks((np.ones((1, 1)),), (np.zeros((1, 6)),)).gather(one, one)
    other.join()
    sys.exit(other.exitcode)
