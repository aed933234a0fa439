"""Runs that are killed at a given file operation, for `tests/test_robustness_kill.py`.

``python -m support.killed MODEL FOLDER [STRIDE]`` runs a saved model into new folders below FOLDER, killed at every
STRIDE-th file operation, and prints one JSON document: the number of operations tried, and for each the files in which
the resumed run differs from an uninterrupted one.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import sys
from pathlib import Path

import numpy as np

from mic.compliance import provider
from mic.errors import MissingProvider
from mic.process.model import ReducedModel
from mic.runs import conclude, sample_into
from mic.system.files import PARTIAL
from mic.system.lock import LOCK

LAWS, SAMPLES, SEED = ["coulomb"], 12, 4
EVENTS = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate"}
KILLED = -signal.SIGKILL


def no_fields(part):
    raise MissingProvider("none for this test")


def run(folder: Path, model: ReducedModel) -> None:
    sample_into(folder, model, LAWS, SAMPLES, SEED)
    conclude(folder)


def killing(folder: Path, at: int):
    """An audit hook that ends the process before the operation number `at` on a file in a folder."""
    count = 0

    def hook(event, arguments):
        nonlocal count
        if event in EVENTS and str(arguments[0]).startswith(str(folder)):
            if count == at:
                os.kill(os.getpid(), signal.SIGKILL)
            count += 1

    return hook


def in_child(action) -> int:
    """Exit status of an action done by a fork of this process."""
    child = multiprocessing.get_context("fork").Process(target=action)
    child.start()
    child.join()
    return child.exitcode


def content(folder: Path) -> dict[str, str]:
    """Hash of each file of a results folder; of archives the arrays, of records all but wall times and checksums."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            if path.suffix == ".npz":
                with np.load(path) as data:
                    body = b"".join(name.encode() + data[name].tobytes() for name in sorted(data.files))
            elif path.suffix == ".json":
                content = json.loads(path.read_text()) | {"wall_time": {}, "checksum": ""}
                body = json.dumps(content, sort_keys=True).encode()
            else:
                body = path.read_bytes()
            found[str(path.relative_to(folder))] = hashlib.sha256(body).hexdigest()
    return found


def main(model_file: str, where: str, stride: str = "1") -> None:
    provider.find = no_fields
    os.fsync = lambda file: None  # slow, and without effect here: the kernel keeps what a killed process wrote
    model, where = ReducedModel.load(model_file), Path(where)
    model.evaluate({})  # kernels are compiled once, not in each child
    whole, folder = where / "whole", where / "killed"
    assert in_child(lambda: run(whole, model)) == 0
    expected, wrong, at = content(whole), {}, 0
    # The operations of one table repeat those of another: a stride prime to their number meets all kinds.
    while True:

        def killed(at=at):
            sys.addaudithook(killing(folder, at))
            run(folder, model)

        status = in_child(killed)
        if status == 0:
            break
        if status != KILLED or in_child(lambda: run(folder, model)) != 0:
            wrong[at] = [f"ended with {status}, and no run can go on"]
        else:
            found = content(folder)
            wrong[at] = sorted(name for name in {*found, *expected} if found.get(name) != expected.get(name))
            wrong[at] += [str(path) for path in folder.rglob("*") if PARTIAL in path.name or path.name == LOCK]
        shutil.rmtree(folder)
        at += int(stride)
    print(json.dumps({"operations": at, "wrong": {at: names for at, names in wrong.items() if names}}))


if __name__ == "__main__":
    main(*sys.argv[1:])
