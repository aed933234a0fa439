"""The Monte Carlo: samples through the process in blocks, each block on disk before the next begins.

A run folder holds, readable at any moment (an interrupted run included, which a second call completes):

- ``run.json``: scene, seed, samples, laws, versions, a fingerprint of the model;
- ``model.npz``: the reduced model;
- ``samples/law=…/`` and ``contacts/law=…/``: Parquet datasets, one file per block;
- ``forces/law=…/``: forces on the functionals in the last stage, kept only where fields are asked for.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from mic.process.process import STATES, Evaluation
from mic.sampling.draw import draw

__all__ = ["BLOCK", "communicator", "run", "tables", "versions"]

BLOCK = 50


def communicator():
    """The MPI world when started by ``mpirun``, else None (a single process needs no MPI)."""
    if int(os.environ.get("OMPI_COMM_WORLD_SIZE", os.environ.get("PMI_SIZE", "1"))) > 1:
        from mpi4py import MPI

        try:
            from petsc4py import PETSc  # noqa: F401  it starts up collectively: later, a process alone would wait for ever
        except ImportError:
            pass
        return MPI.COMM_WORLD
    return None


def run(model, folder: Path, laws, samples: int, seed: int, advance=None) -> dict[str, int]:
    """Evaluate all samples under all laws into a run folder, blocks shared out over MPI ranks.

    Parameters
    ----------
    model : mic.model.reduced.ReducedModel
    folder : Path
        Blocks of the same model, seed and law that it holds already are kept; those of another are removed.
    laws : sequence of str
    samples, seed : int
    advance : callable, optional
        Called with (law, number of samples) after each block.

    Returns
    -------
    dict of str to int
        Samples per law that were found finished from an earlier call.
    """
    world = communicator()
    rank, size = (world.rank, world.size) if world else (0, 1)
    if rank == 0:
        _prepare(model, folder, laws, samples, seed)
    if world:
        world.Barrier()
    reused = dict.fromkeys(laws, 0)
    tasks = [(law, first, min(BLOCK, samples - first)) for law in laws for first in range(0, samples, BLOCK)]
    threads = max(1, len(os.sched_getaffinity(0)) // size)
    # A fixed number of BLAS threads keeps results the same from run to run, and small products fast.
    with threadpool_limits(limits=1, user_api="blas"):
        processes = {law: model.process(law, backend=model.scene.monte_carlo.backend, threads=threads) for law in laws}
        for law, first, count in tasks[rank::size]:
            name = f"{first:06d}-{first + count - 1:06d}"
            if _path(folder, "samples", law, name).is_file():
                reused[law] += count
            else:
                evaluation = _evaluate(processes[law], draw(model.scene, seed, first, count))
                sample, contact = tables(model, evaluation, first)
                if model.scene.report.fields:
                    _write(
                        _path(folder, "forces", law, name, "npz"),
                        lambda path: np.savez(path, force=evaluation.functional_force, motion=evaluation.motion),
                    )
                _write(_path(folder, "contacts", law, name), lambda path: contact.to_parquet(path, index=False))
                _write(
                    _path(folder, "samples", law, name), lambda path: sample.to_parquet(path, index=False)
                )  # last: it marks the block done
            if advance:
                advance(law, count)
    if world:
        world.Barrier()
        reused = {law: world.allreduce(count) for law, count in reused.items()}
    return reused


def _evaluate(process, deviations) -> Evaluation:
    """A block; should it break, sample by sample, so that only the samples at fault are lost."""
    try:
        return process.evaluate(deviations)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        if len(deviations) == 1:
            return process.blank(deviations, str(error))
        return Evaluation.join([_evaluate(process, row[None]) for row in deviations])


def tables(model, evaluation: Evaluation, first: int = 0) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Tables of an evaluation.

    Parameters
    ----------
    model : mic.model.reduced.ReducedModel
    evaluation : Evaluation
    first : int
        Number of the first sample.

    Returns
    -------
    samples : DataFrame
        One row per sample: ``sample``, ``failed``, ``deviation:NAME``; per stage ``residual:STAGE``, ``status:STAGE``,
        ``iterations:STAGE``; ``slip:STAGE:ZONE`` (RMS over the zone's pairs, mm); ``measurement:NAME`` (mm).
    contacts : DataFrame
        One row per sample, stage and pair: ``sample, stage, zone, contact, f_n, f_t1, f_t2`` (N), ``u_n, u_t1, u_t2``
        (mm), ``state``. The tangential columns are absent where the model has none.
    """
    scene, contacts = model.scene, model.contacts
    n, m, d = len(evaluation.deviations), len(contacts), contacts.dimension
    number = first + np.arange(n)
    columns = {"sample": number, "failed": evaluation.failed}
    columns |= {f"deviation:{name}": evaluation.deviations[:, j] for j, name in enumerate(model.parameters)}
    blocks = []
    for stage, resolution in evaluation.resolutions.items():
        columns[f"residual:{stage}"] = resolution.residual
        columns[f"status:{stage}"] = [str(getattr(status, "value", status)) for status in resolution.status]
        columns[f"iterations:{stage}"] = resolution.iterations
        if d == 3:
            square = (resolution.displacement[:, :, 1:] ** 2).sum(axis=2)
            for z, zone in enumerate(scene.zones):
                columns[f"slip:{stage}:{zone.name}"] = np.sqrt(square[:, contacts.zone == z].mean(axis=1))
        axes = ("n", "t1", "t2")[:d]
        block = {
            "sample": np.repeat(number, m).astype(np.int32),
            "stage": pd.Categorical.from_codes(np.zeros(n * m, dtype=np.int8), [stage]),
            "zone": pd.Categorical.from_codes(np.tile(contacts.zone, n), [zone.name for zone in scene.zones]),
            "contact": np.tile(np.arange(m, dtype=np.int32), n),
        }
        block |= {f"f_{axis}": resolution.force[:, :, j].ravel() for j, axis in enumerate(axes)}
        block |= {f"u_{axis}": resolution.displacement[:, :, j].ravel() for j, axis in enumerate(axes)}
        block["state"] = pd.Categorical.from_codes(resolution.state.ravel(), list(STATES))
        blocks.append(pd.DataFrame(block))
    columns |= {
        f"measurement:{item.name}": evaluation.measurements[:, j]
        for j, item in enumerate(scene.measurements)
        if evaluation.measurements.shape[1]
    }
    stages = [block["stage"].cat.categories[0] for block in blocks]
    for block in blocks:
        block["stage"] = block["stage"].cat.set_categories(stages)
    return pd.DataFrame(columns), pd.concat(blocks, ignore_index=True) if blocks else pd.DataFrame({"sample": []})


def _path(folder, table, law, name, suffix="parquet"):
    return Path(folder) / table / f"law={law}" / f"{name}.{suffix}"


def _write(path, write):
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}" if path.suffix != ".npz" else f".{path.stem}.npz")
    write(temporary)
    temporary.replace(path)


def _prepare(model, folder, laws, samples, seed):
    """Set up the run folder; what it holds of another model or seed goes, as do blocks beyond or cut otherwise."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    fingerprint = _fingerprint(model, seed)
    record = folder / "run.json"
    if record.is_file() and json.loads(record.read_text()).get("fingerprint") != fingerprint:
        for name in ("samples", "contacts", "forces", "fields"):
            shutil.rmtree(folder / name, ignore_errors=True)
    wanted = {f"{first:06d}-{min(first + BLOCK, samples) - 1:06d}" for first in range(0, samples, BLOCK)}
    for table in ("samples", "contacts", "forces"):
        for path in (folder / table).glob("law=*/*"):
            if path.stem not in wanted or path.parent.name.removeprefix("law=") not in laws:
                path.unlink()
    model.save(folder / "model.npz")
    content = {
        "scene": model.scene.name,
        "samples": samples,
        "seed": seed,
        "laws": list(laws),
        "fingerprint": fingerprint,
        "versions": versions(),
    }
    record.write_text(json.dumps(content, indent=2) + "\n")


def _fingerprint(model, seed) -> str:
    digest = hashlib.sha256(repr(seed).encode())
    digest.update(model.scene.model_dump_json(exclude={"monte_carlo", "report", "description"}).encode())
    digest.update(repr((model.scene.report.fields, model.contacts.dimension, model.scene.monte_carlo.backend)).encode())
    for array in (model.H, model.G, model.shape):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def versions() -> dict[str, str]:
    """Versions of what a number may depend on."""
    found = {"python": platform.python_version()}
    for name in ("mic-contact", "numpy", "scipy", "numba", "fenics-dolfinx", "petsc4py"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
