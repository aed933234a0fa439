"""Compile all kernels now, so that no first evaluation waits for it: ``python -m mic.commands.compile``.

Whatever is compiled is kept beside the program, or where ``NUMBA_CACHE_DIR`` says, and read again in a third of a
second until the program or Numba change. Where there are two cores, both compile.
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
from mic.contact.native.kernels import compiled  # compiles when it is imported, and so what both need is there
from mic.system.matrix_product import product

if __name__ == "__main__":
    beside = get_context("fork").Process(target=import_module, args=("mic.contact.native.tangent",))
    beside.start()
    follower()
    product(np.ones((1, 1)), np.ones((1, 1)))
    for law in LAWS.values():
        if law.equation is not None:
            compiled(law.equation)
    one = csr_matrix(np.ones((1, 1)))
    blocks = Blocks.single(np.ones((1, 1)), np.zeros((1, 6)))
    blocks.gather(one, one)
    blocks.diagonal(one)
    beside.join()
    sys.exit(beside.exitcode)
