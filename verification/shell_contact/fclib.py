"""Contact problems in FCLIB's HDF5 format, written and read in a separate process because the HDF5 libraries of h5py
and dolfinx conflict.

    find u, r:   u = W r + q,      K_μ ∋ r ⊥ u + μ ‖u_t‖ n ∈ K_μ*

with components in the order n, t1, t2; mm and N. A file contains the groups ``fclib_local`` (``spacedim``, ``W`` in
compressed rows, ``vectors/q``, ``vectors/mu``, ``info``) and ``solution`` (``u``, ``r``), as written by
``fclib_write_local`` and ``fclib_write_solution`` of the library.

    python fclib.py write PROBLEM.npz PROBLEM.hdf5
    python fclib.py read PROBLEM.hdf5 PROBLEM.npz

work with any Python that has numpy and h5py. Reference: V. Acary et al., FCLIB: a collection of discrete 3D frictional
contact problems, INRIA RT-0444, 2014.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

__all__ = ["available", "interpreter", "read", "write"]

CSR = -2  # FCLIB's name of compressed rows
KEYS = ("W", "q", "mu", "u", "r", "title", "description", "math_info")


def interpreter() -> str:
    """The Python with h5py that ``script/bootstrap test`` installs, or this one if it is missing."""
    installed = Path(sys.prefix) / "h5py" / "bin" / "python"
    return str(installed) if installed.is_file() else sys.executable


def available(python: str) -> bool:
    """Whether a Python interpreter has h5py."""
    return subprocess.run([python, "-P", "-c", "import h5py"], capture_output=True).returncode == 0


def write(path: Path, problem: dict, python: str) -> None:
    """Write a problem with its solution.

    Parameters
    ----------
    path : Path
    problem : dict
        ``W`` (3m, 3m), ``q`` (3m,), ``mu`` (m,), ``u`` and ``r`` (3m,); ``title``, ``description`` and ``math_info``.
    python : str
        Interpreter with numpy and h5py.

    Raises
    ------
    RuntimeError
        If the process fails; the message holds its last line.
    """
    with tempfile.TemporaryDirectory() as folder:
        between = Path(folder) / "problem.npz"
        np.savez(between, **{key: problem[key] for key in KEYS})
        _call(python, "write", between, path)


def read(path: Path, python: str) -> dict:
    """Read a problem in the form of :func:`write`; W is dense.

    Raises
    ------
    RuntimeError
        If the process fails; the message holds its last line.
    """
    with tempfile.TemporaryDirectory() as folder:
        between = Path(folder) / "problem.npz"
        _call(python, "read", path, between)
        with np.load(between) as found:
            return {key: found[key] if found[key].ndim else str(found[key]) for key in found}


def _call(python: str, verb: str, source: Path, target: Path) -> None:
    outcome = subprocess.run([python, "-P", __file__, verb, str(source), str(target)], capture_output=True, text=True)
    if outcome.returncode:
        raise RuntimeError(f"{target.name}: {(outcome.stderr.strip().splitlines() or ['no message'])[-1]}")


def _write(source: str, target: str) -> None:
    import h5py  # only in the separate process

    given = np.load(source)
    W = given["W"]
    size = len(W)
    packed = {"compression": "gzip", "shuffle": True}
    with h5py.File(target, "w", libver=("earliest", "v110")) as file:
        file["fclib_local/spacedim"] = np.array([3], dtype="i4")
        matrix = file.create_group("fclib_local/W")
        for key, value in {"nzmax": size * size, "m": size, "n": size, "nz": CSR}.items():
            matrix[key] = np.array([value], dtype="i4")
        matrix["p"] = np.arange(0, size * size + 1, size, dtype="i4")
        matrix.create_dataset("i", data=np.tile(np.arange(size, dtype="i4"), size), **packed)
        matrix.create_dataset("x", data=W.ravel(), **packed)
        for key in ("q", "mu"):
            file[f"fclib_local/vectors/{key}"] = given[key]
        for key in ("title", "description", "math_info"):
            file[f"fclib_local/info/{key}"] = np.bytes_(str(given[key]).encode())
        for key in ("u", "r"):
            file[f"solution/{key}"] = given[key]


def _read(source: str, target: str) -> None:
    import h5py  # only in the separate process

    with h5py.File(source) as file:
        local = file["fclib_local"]
        matrix = {key: value[()] for key, value in local["W"].items()}
        if int(matrix["nz"][0]) != CSR or int(local["spacedim"][0]) != 3:
            raise SystemExit("W is not in compressed rows, or the problem is not one of three dimensions")
        rows, columns = int(matrix["m"][0]), int(matrix["n"][0])
        W = np.zeros((rows, columns))
        W[np.repeat(np.arange(rows), np.diff(matrix["p"])), matrix["i"]] = matrix["x"]
        texts = {key: local["info"][key][()].decode() for key in ("title", "description", "math_info")}
        solution = {key: file["solution"][key][()] for key in ("u", "r")}
        vectors = {key: local["vectors"][key][()] for key in ("q", "mu")}
        np.savez(target, W=W, **vectors, **solution, **texts)


if __name__ == "__main__":
    {"write": _write, "read": _read}[sys.argv[1]](*sys.argv[2:])
