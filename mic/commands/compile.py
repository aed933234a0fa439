"""Compile all kernels in advance: ``python -m mic.commands.compile``.

Numba caches the compiled code beside the program, or in ``NUMBA_CACHE_DIR``; loading it takes a third of a second. Two
processes compile in parallel.
"""

from __future__ import annotations

import sys
from importlib import import_module
from multiprocessing import get_context

import numpy as np
from scipy.sparse import csr_matrix

from mic.compliance.blocks import Blocks
from mic.contact.laws import LAWS
from mic.contact.native.follower import follower
from mic.contact.native.kernels import compiled  # the import compiles what both processes need
from mic.system.matrix_product import product

if __name__ == "__main__":
    tangent_process = get_context("fork").Process(target=import_module, args=("mic.contact.native.tangent",))
    tangent_process.start()
    follower()
    product(np.ones((1, 1)), np.ones((1, 1)))
    for law in LAWS.values():
        if law.equation is not None:
            compiled(law.equation)
    one = csr_matrix(np.ones((1, 1)))
    Blocks((np.ones((1, 1)),), (np.zeros((1, 6)),)).gather(one, one)
    tangent_process.join()
    sys.exit(tangent_process.exitcode)
