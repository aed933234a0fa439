"""Attacks on every file that the program wrote and reads again: altered, truncated, exchanged and hostile files.

A folder with one file of each kind is made from a model on springs. Each attack alters one file and calls the readers
that the commands use. They may refuse the file in one sentence, or count it as absent and say so; they may not raise
anything else, wait, allocate, or return other content.
"""

from __future__ import annotations

import io
import json
import logging
import multiprocessing
import os
import pickle
import resource
import shutil
import socket
import traceback
import zipfile
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.sparse import csr_matrix

from mic.commands.predict import PredictionLog
from mic.compliance.functional import Functionals
from mic.compliance.part import Part
from mic.errors import MicError
from mic.explorer.shapes import PartShape, Shapes, shapes_path
from mic.geometry.surface import Patch, Surface
from mic.process.model import ReducedModel
from mic.results import schema
from mic.results.fields import PartField, read_fields, write_fields
from mic.results.outcome import read_outcome
from mic.results.run_folder import RunFolder
from mic.results.table_writer import SUMMARY, write_summary, write_tables
from mic.runs import sample_into
from mic.studies.contributors import contributors
from mic.studies.optimisation.evaluations import EvaluationLog
from mic.studies.prediction import Predictor
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import DAMAGED, Format, arrays_header, load_arrays, load_json, save_arrays, save_json
from mic.system.lock import LOCK, locked
from mic.system.memoise import memoise, pack
from support.contents import same
from support.springs import dragged

__all__ = ["Stored", "attack", "attack_files", "make"]

LAWS, SAMPLES, SEED = ["coulomb", "frictionless"], 100, 4
MEMORY = 1 << 30  # bytes that a reader may allocate
PATIENCE = 20.0  # s
THING, STAMP = Format("thing", 1, ABSENT), "model law"
ENTRIES = {"influence": "a" * 32, "meshes": "b" * 32}
STATEMENTS = (*schema.STATISTICS, *schema.STUDIES)


# ----------------------------------------------------------------------------------------------------- the stored files


def make(folder: Path) -> Path:
    """A folder with a file of each kind; returns it."""
    report = {"laws": LAWS, "contacts": 1, "fields": True}
    model, run = dragged(report=report), folder / "run"
    sample_into(run, model, LAWS, SAMPLES, SEED)
    store = RunFolder(run)
    write_fields(run)  # none: there are no parts yet
    store.store_inputs(SimpleNamespace(parts=_parts(model), scene=model.scene))
    outcome = read_outcome(run)
    write_tables(outcome)
    write_summary(outcome)
    found = contributors(model, samples=16, seed=SEED)
    schema.CONTRIBUTORS.write(run, found.table)
    schema.LINEARITY.write(run, found.linearity)
    _store_fields(run / "fields" / "fields.npz")
    (run / LOCK).write_text(json.dumps({"process": 1 << 22, "started": 1, "host": socket.gethostname(), "boot": "x"}))
    model.save(folder / "model.npz")
    basis, rigid = np.ones((1, 3, 3), "f4"), np.ones((3, 3, 6))
    shape = PartShape("b", np.eye(3), np.arange(3)[None], basis, rigid, np.zeros(1, int))
    Shapes((shape,), "").save(shapes_path(folder / "model.npz"), model)
    log = EvaluationLog(folder / "evaluations.jsonl", STAMP)
    for key in "pqrs":
        log.arrays(key, lambda: {"y": np.arange(6.0).reshape(3, 2) / 7, "unfit": np.zeros(3)})
    predictions = PredictionLog(folder / "predictions.csv", "model")
    predictor = Predictor(model)
    for row in range(3):
        values = {"P": 0.8 + 0.1 * row}
        predictions.add(predictor.predict(values), Path("parts.csv"), row, predictions.checksum(values))
    for section, identity in ENTRIES.items():
        Cache(folder / "cache", section, THING).store(identity, {"part": section}, {"H": np.arange(60.0)})
    _memoised(folder)
    return folder


def _parts(model) -> tuple[Part, ...]:
    """Parts of one triangle each, with two functionals."""
    surface = Surface(np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0]]), np.array([[0, 1, 2]]))
    patch = Patch(np.zeros(1, int), np.full((1, 3), 1 / 3), np.ones(1))
    own = Functionals((patch, patch), np.arange(2), np.eye(3)[:2], np.zeros(2, bool), np.zeros(2), ("x", "y"))
    return tuple(Part(part.name, surface, 1.0, 2e5, 0.3, "none", own) for part in model.scene.parts)


def _store_fields(path: Path) -> None:
    """Put a field into the file of fields, which finite elements would compute."""
    kind = Format("set of displacement fields", arrays_header(path)["format"], "")
    header, _ = load_arrays(path, kind)
    values = np.linspace(0.0, 1.0, 9).reshape(3, 3)
    content, arrays = pack([PartField("coulomb", "b", values, values, values[0], 2, SAMPLES, 0.0, 1e-9)], {})
    save_arrays(path, kind, header | {"fields": content, "skipped": None}, arrays)


def _memoised(folder: Path) -> dict:
    content = {"matrix": csr_matrix(np.eye(3)), "values": np.arange(5.0), "name": "content"}
    return memoise(Cache(folder / "cache", "assemblies", THING), ["inputs"], {}, (), lambda: content)[0]


# -------------------------------------------------------------------------------------------------------- their readers


def _outcome(root: Path) -> dict:
    """Each readable block, and statistics if no block is missing."""
    outcome = read_outcome(root / "run")
    store, found = RunFolder(root / "run"), {"model": _content(outcome.model)}
    for law in LAWS:
        for block in outcome.blocks[law]:
            found[f"{law} {block.name}"] = store.read_block(block, outcome.record["identity"])
    if not any(outcome.missing.values()):
        found["statistics"] = [outcome.measurement_statistics, outcome.zone_statistics]
    elif not outcome.damaged and (root / "run").is_dir():
        found["silence"] = "blocks are missing and nothing is said"
    return found


def _forces(root: Path) -> dict:
    store, found = RunFolder(root / "run"), {}
    for law in LAWS:
        for block in store.blocks(law):
            for table in (schema.FORCES, schema.CONDENSED, schema.SUMS):
                stored = store.read_arrays(table, block, store.record()["identity"])
                if stored is not None:
                    found[f"{table.name} {law} {block.name}"] = stored
    return found


def _tables(root: Path) -> dict:
    return _present(STATEMENTS, lambda table: table.read(root / "run", "call `mic report` on the run folder"))


def _studies(root: Path) -> dict:
    return _present(schema.STUDIES, read_outcome(root / "run").study)


def _present(tables, read) -> dict:
    """The tables that can be read, by name."""
    return {table.name: frame for table in tables if (frame := read(table)) is not None}


def _parts_of_run(root: Path) -> dict:
    return {"parts": list(RunFolder(root / "run").parts())}


def _fields(root: Path) -> dict:
    return {"fields": list(read_fields(root / "run"))}


def _summary(root: Path) -> dict:
    return {"summary": load_json(root / "run" / "summary.json", SUMMARY)}


def _lock(root: Path) -> dict:
    with locked(root / "run"):
        return {}


def _model(root: Path) -> dict:
    model = ReducedModel.load(root / "model.npz")
    return {"model": _content(model), "shapes": Shapes.load(shapes_path(root / "model.npz"), model)}


def _evaluations(root: Path) -> dict:
    def absent():
        raise LookupError

    log, found = EvaluationLog(root / "evaluations.jsonl", STAMP), {}
    for key in "pqrs":
        with suppress(LookupError):
            found[key] = log.arrays(key, absent)
    return found


def _predictions(root: Path) -> dict:
    log = PredictionLog(root / "predictions.csv", "model")
    return {"predicted": 0 * log.count}  # an altered row is another row


def _cache(root: Path) -> dict:
    loaded = {name: Cache(root / "cache", name, THING).load(identity) for name, identity in ENTRIES.items()}
    found = {name: content for name, content in loaded.items() if content is not None}
    return found | {"memoised": _memoised(root)}


#: Readers by the beginning of a file's path.
READERS = {
    "run/run.json": [_outcome, _fields, _parts_of_run],
    "run/model.npz": [_outcome],
    "run/parts.npz": [_parts_of_run],
    "run/tables": [_tables, _studies],
    "run/fields": [_fields],
    "run/summary.json": [_summary],
    "run/.lock": [_lock],
    "run/forces": [_forces],
    "run/condensed": [_forces],
    "run/sums": [_forces, _outcome],
    "run/": [_outcome],
    "model": [_model],
    "evaluations": [_evaluations],
    "predictions": [_predictions],
    "cache": [_cache],
}


def _content(model) -> list:
    others = [getattr(model, field.name) for field in fields(model) if field.name != "scene"]
    return [*others, model.scene.model_dump_json()]


# ---------------------------------------------------------------------------------------------------------- the attacks


def _flip(rng, content: bytes) -> bytes:
    altered = bytearray(content)
    for _ in range(int(rng.choice([1, 1, 1, 3]))):
        if altered:
            altered[_place(rng, len(altered))] ^= 1 << int(rng.integers(8))
    return bytes(altered)


def _place(rng, size: int) -> int:
    """A place in a file; headers and ends more often than their length."""
    zone = rng.integers(4)
    if zone == 0:
        return int(rng.integers(min(size, 400)))
    return int(size - 1 - rng.integers(min(size, 900))) if zone == 1 else int(rng.integers(size))


def _truncate(rng, content: bytes) -> bytes:
    return content[: _place(rng, len(content))] if content else b""


def _insert(rng, content: bytes) -> bytes:
    at = _place(rng, len(content)) if content else 0
    start = _place(rng, len(content)) if content else 0
    piece = rng.bytes(int(rng.integers(1, 50))) if rng.integers(2) else content[start : start + int(rng.integers(200))]
    return content[:at] + piece + content[at:]


def _zero(rng, content: bytes) -> bytes:
    at = _place(rng, len(content)) if content else 0
    size = int(rng.choice([1, 8, 64, 512]))
    return content[:at] + bytes(min(size, len(content) - at)) + content[at + size :]


ALTERATIONS = [_flip] * 8 + [_truncate, _insert, _zero]


def _array_bytes(descr: str, shape: str, data: bytes = b"") -> bytes:
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (-(11 + len(text)) % 64) + b"\n"
    version, size = (b"\x01\x00", 2) if len(text) < 65536 else (b"\x02\x00", 4)
    return b"\x93NUMPY" + version + len(text).to_bytes(size, "little") + text + data


def _archive(members, packing=zipfile.ZIP_STORED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", packing) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return buffer.getvalue()


class _Trap:
    """Executed if it is unpickled."""

    def __reduce__(self):
        return os._exit, (77,)


def _hostile_archive(rng, path: Path) -> bytes:
    """An ``.npz`` file that no honest program writes."""
    header = np.array(json.dumps(arrays_header(path)))
    honest = io.BytesIO()
    np.save(honest, header)
    own = ("header.npy", honest.getvalue())
    text = lambda content: ("header.npy", _array_bytes(f"'<U{len(content)}'", "()", content.encode("utf-32-le")))
    array = lambda *header: ("a.npy", _array_bytes(*header))
    number = int(rng.choice([10**9, 5 * 10**11, 2**63, 10**30]))
    members = [
        [own, array("'<f8'", f"({number},)")],
        [own, array("'<U0'", f"({number},)")],
        [own, array("'<f8'", f"(0, {number})")],
        [own, array("[" * 30000 + "]" * 30000, "()")],
        [own, array("'<f8'", "(" * 50000 + ")" * 50000)],
        [own, array("[('x', '<f8')]", "(1,)", bytes(8))],
        [own, array("'|O'", "(1,)", pickle.dumps([_Trap()]))],
        [own, array("'<f8'", "-1,", bytes(8))],
        [text("[" * 100_000)],
        [text('{"kind": ' * 20_000)],
        [text('{"kind": 1' + "0" * 10_000 + "}")],
        [text("[" + "[]," * 1_000_000 + "1]")],
        [("header.npy", _array_bytes("'<f8'", "(3,)", bytes(24)))],
        [("a.npy", own[1])],
        [own, own],
        [own, ("../a.npy", own[1]), ("a.txt", b"")],
        [],
    ]
    chosen = int(rng.integers(len(members) + 2))
    if chosen == len(members):
        return _overlapping(own[1])
    if chosen > len(members):
        return _archive([own, array("'<f8'", f"({10**7},)", bytes(8 * 10**7))], zipfile.ZIP_DEFLATED)
    return _archive(members[chosen])


def _overlapping(member: bytes) -> bytes:
    """An archive whose directory lists one large member a thousand times."""
    content = bytearray(_archive([("header.npy", member + bytes(100_000))]))
    end = content.rindex(b"PK\x05\x06")
    start = int.from_bytes(content[end + 16 : end + 20], "little")
    entry = bytes(content[start:end])
    entries = b"".join(entry.replace(b"header.npy", f"a{i:05d}.npy".encode()) for i in range(1000))
    tail = bytearray(content[end:])
    tail[8:12], tail[12:16] = (1000).to_bytes(2, "little") * 2, len(entries).to_bytes(4, "little")
    return bytes(content[:start]) + entries + bytes(tail)


def _hostile_text(rng, path: Path) -> bytes:
    """A text file that no honest program writes."""
    made = [
        *(b"[" * 200_000, b'{"a":' * 100_000, b'{"kind": 1' + b"0" * 10_000 + b"}", b"[" + b"[]," * 1_000_000 + b"1]"),
        *(b"\xff\xfe" * 100, b"\x00" * 1000, b'"' * 1001, b"\n" * 100_000, b'a,b\n"' + b"x" * 300_000),
        *(b"NaN", b"null", b"{}", b'{"kind": NaN}', b'{"stamp": 1, "checksum": 2}\n', b",".join([b"1"] * 100_000)),
    ]
    return made[int(rng.integers(len(made)))]


def _forge(rng, path: Path) -> None:
    """Alter one value in a header, with the right checksum."""
    values = [None, True, -1, 2**70, 1e308, "x" * 10, [], {}, [[]], {"array": ["<f8", -5, [3]]}, {"dict": 3}]

    def altered(node):
        if isinstance(node, (dict, list)) and node and rng.random() < 0.85:
            keys = list(node) if isinstance(node, dict) else range(len(node))
            key = list(keys)[int(rng.integers(len(node)))]
            changed = node.copy()
            if isinstance(node, dict) and rng.random() < 0.1:
                del changed[key]
            else:
                changed[key] = altered(node[key])
            return changed
        return values[int(rng.integers(len(values)))]

    if path.suffix == ".npz":
        header = arrays_header(path)
        kind = Format(header.pop("kind"), header.pop("format"), "")
        header.pop("checksum")
        _, arrays = load_arrays(path, kind)
        if rng.random() < 0.2 and arrays:
            arrays.pop(list(arrays)[int(rng.integers(len(arrays)))])
        found = altered(header)
        save_arrays(path, kind, found if isinstance(found, dict) else {}, arrays)
    else:
        document = json.loads(path.read_text())
        kind = Format(document.pop("kind"), document.pop("format"), "")
        document.pop("checksum")
        found = altered(document)
        save_json(path, kind, found if isinstance(found, dict) else {})


def _special(rng, path: Path) -> str:
    """Something that is no regular file under the name of a file."""
    path.unlink()
    kind = str(rng.choice(["pipe", "folder", "device", "loop", "socket"]))
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "loop":
        path.symlink_to(path.name)
    else:
        here = os.getcwd()
        os.chdir(path.parent)  # the path of a socket must be short
        try:
            with socket.socket(socket.AF_UNIX) as made:
                made.bind(path.name)
        finally:
            os.chdir(here)
    return kind


def _alter(rng, root: Path, path: Path, files: list[Path]) -> tuple[str, bool]:
    """Alter a file; returns what was done, and whether other content was put in with a right checksum."""
    choice = rng.random()
    content = path.read_bytes()
    if choice < 0.78:
        alteration = ALTERATIONS[int(rng.integers(len(ALTERATIONS)))]
        path.write_bytes(alteration(rng, content))
        return alteration.__name__.strip("_"), False
    if choice < 0.84:
        alike = [other for other in files if other.suffix == path.suffix and other != path]
        if alike:
            other = alike[int(rng.integers(len(alike)))]
            path.write_bytes(other.read_bytes())
            return f"exchanged with {other}", False
    if choice < 0.92:
        hostile = _hostile_archive if path.suffix == ".npz" else _hostile_text
        path.write_bytes(hostile(rng, path))
        return hostile.__name__.strip("_"), False
    if choice < 0.97 and path.suffix in (".npz", ".json"):
        _forge(rng, path)
        return "forged", True
    return _special(rng, path), False


# --------------------------------------------------------------------------------------------------------------- rounds


class _Said(logging.Handler):
    """Counts warnings."""

    count = 0

    def emit(self, record):
        self.count += 1


def _files(root: Path) -> list[Path]:
    return sorted(path for path in root.rglob("*") if path.is_file() and not path.is_symlink())


def _kind(relative: str) -> str:
    return next(name for name in READERS if relative.startswith(name))


def _restore(root: Path, pristine: Path, relative: str, names: list[str]) -> None:
    """Undo what an attack and the readers did."""
    path = root / relative
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif os.path.lexists(path):
        path.unlink()
    for aside in root.rglob(f"*{DAMAGED}*"):
        aside.unlink() if not aside.is_dir() else shutil.rmtree(aside)
    for name in names:
        if not (root / name).exists():
            shutil.copy2(pristine / name, root / name)


class Stored:
    """A folder of stored files with their true content, and a copy that is attacked."""

    def __init__(self, folder: Path):
        self.pristine, self.root = make(folder / "pristine"), folder / "attacked"
        shutil.copytree(self.pristine, self.root)
        other = folder / "other"
        sample_into(other, dragged(report={"laws": LAWS, "contacts": 1, "fields": True}), LAWS, SAMPLES, SEED + 1)
        self.names = [str(path.relative_to(self.pristine)) for path in _files(self.pristine)]
        self.alike = _files(self.pristine) + _files(other)
        readers = {reader for readers in READERS.values() for reader in readers} - {_lock}
        self.truth = {reader: reader(self.pristine) for reader in readers}
        self.by_kind: dict[str, list[str]] = {}
        for name in self.names:
            self.by_kind.setdefault(_kind(name), []).append(name)

    def renew(self) -> None:
        """Undo all attacks."""
        shutil.rmtree(self.root)
        shutil.copytree(self.pristine, self.root)

    def attack(self, rng: np.random.Generator) -> str | None:
        """One attack on a file of a random kind; returns what failed."""
        kinds = list(self.by_kind)
        kind = kinds[int(rng.integers(len(kinds)))]
        relative = self.by_kind[kind][int(rng.integers(len(self.by_kind[kind])))]
        what, forged = _alter(rng, self.root, self.root / relative, self.alike)
        try:
            for reader in READERS[kind]:
                problem = self._read(reader, forged)
                if problem:
                    return f"{relative} {what}: {reader.__name__} {problem}"
            return None
        finally:
            _restore(self.root, self.pristine, relative, self.names)

    def _read(self, reader, forged: bool) -> str | None:
        said = _Said()
        logging.getLogger("mic").addHandler(said)
        try:
            found = reader(self.root)
        except MicError as problem:
            return None if str(problem) and "\n" not in str(problem) else f"says {str(problem)!r}"
        except FileNotFoundError as problem:
            return None if reader in (_model, _summary) else f"raises {problem!r}"
        except Exception:
            return f"raises {traceback.format_exc(limit=-4)}"
        finally:
            logging.getLogger("mic").removeHandler(said)
        if forged or reader is _lock:
            return None
        truth = self.truth[reader]
        for name, content in found.items():
            if name not in truth or not same(content, truth[name]):
                return f"returns other content of {name}"
        if set(truth) - set(found) and not said.count and reader in (_cache, _studies):
            return f"does not say that {sorted(set(truth) - set(found))} count as absent"
        return None


def attack_files(stored: Stored, seeds) -> list[str]:
    """One attack for each seed, in a child process with bounded memory; returns the failures."""
    context = multiprocessing.get_context("fork")
    seeds, failures = list(seeds), []
    while seeds:
        receiving, sending = context.Pipe(duplex=False)
        child = context.Process(target=_serve, args=(stored, seeds, sending))
        child.start()
        sending.close()
        try:
            while seeds:
                if not receiving.poll(PATIENCE):
                    failures.append(f"seed {seeds.pop(0)}: no answer after {PATIENCE:g} s")
                    break
                problem = receiving.recv()
                seed = seeds.pop(0)
                if problem:
                    failures.append(f"seed {seed}: {problem}")
        except EOFError:
            child.join()
            failures.append(f"seed {seeds.pop(0)}: the process ended with {child.exitcode}")
        finally:
            child.kill()
            child.join()
            stored.renew()
    return failures


def _serve(stored: Stored, seeds, sending) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    logging.disable(logging.NOTSET)
    logging.getLogger("mic").propagate = False
    for seed in seeds:
        sending.send(stored.attack(np.random.default_rng(seed)))


def attack(rng: np.random.Generator, folder: Path) -> list[str]:
    """A round of attacks."""
    stored = Stored(folder)
    return attack_files(stored, rng.integers(2**40, size=400).tolist())
