"""Files that the program wrote and reads again are unaltered or count as damaged: never another number, no crash."""

import hashlib
import json
import logging
import os
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from support.attack_stored_files import READERS, SAMPLES, Stored, attack_files

from mic.errors import FormatError
from mic.results import schema
from mic.results.fields import read_fields
from mic.results.outcome import read_outcome
from mic.results.run_folder import RunFolder
from mic.studies.optimisation.evaluations import EvaluationLog
from mic.system import files

THING = files.Format("thing", 3, "make it again")
DAMAGED = "this thing is cut short or damaged; make it again"


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    return Stored(tmp_path_factory.mktemp("stored"))


@pytest.mark.slow
def test_each_kind_of_file_is_attacked(stored):
    assert set(stored.by_kind) == set(READERS) and len(stored.names) > 50
    assert all(stored.truth.values())


@pytest.mark.slow
def test_an_altered_file_gives_its_content_or_one_sentence(stored):
    assert attack_files(stored, range(50)) == []


@pytest.mark.slow
def test_the_attack_notices_a_reader_that_trusts_its_file(stored, monkeypatch):
    monkeypatch.setattr(hashlib, "sha256", lambda content=b"": SameDigest())
    assert attack_files(stored, range(40))


class SameDigest:
    def update(self, content):
        pass

    def digest(self):
        return bytes(32)

    def hexdigest(self):
        return "0" * 64


def test_every_altered_byte_of_a_record_is_noticed(tmp_path):
    path, content = tmp_path / "run.json", {"samples": 30, "laws": ["coulomb"], "wall_time": {"statistics": 0.1}}
    files.save_json(path, THING, content)
    whole, read = path.read_bytes(), 0
    for position in range(len(whole)):
        for bit in (1, 16):
            path.write_bytes(whole[:position] + bytes([whole[position] ^ bit]) + whole[position + 1 :])
            try:
                found = files.load_json(path, THING)
            except FormatError:
                continue
            assert found == content  # white space
            read += 1
    assert read < 0.1 * 2 * len(whole)


def test_a_line_of_a_log_is_used_only_if_it_is_unaltered(tmp_path, caplog):
    path = tmp_path / "evaluations.jsonl"
    log = EvaluationLog(path, "model law")
    for key in "pq":
        log.arrays(key, lambda: {"y": np.array([0.25, 0.5])})
    path.write_text(path.read_text().replace("0.25", "0.35", 1), encoding="utf-8")
    with open(path, "a", encoding="utf-8") as file:
        file.write('{"stamp": "model law", "key": "r", "arr')  # of a killed run
    with caplog.at_level(logging.WARNING):
        again = EvaluationLog(path, "model law")
    assert caplog.messages == [f"{path}: 1 records are cut short or damaged; they are evaluated again"]
    assert again.arrays("q", dict)["y"].tolist() == [0.25, 0.5]
    assert again.arrays("p", lambda: {"y": np.array([0.25, 0.5])})["y"].tolist() == [0.25, 0.5]
    caplog.clear()
    assert EvaluationLog(path, "model law").arrays("p", dict)["y"].tolist() == [0.25, 0.5]


def test_a_pipe_a_folder_or_a_device_is_not_waited_for(tmp_path):
    path = tmp_path / "thing.npz"
    for make in (lambda: os.mkfifo(path), path.mkdir, lambda: path.symlink_to("/dev/zero")):
        make()
        for read in (files.load_arrays, files.load_json):
            with pytest.raises(FormatError, match=DAMAGED):
                read(path, THING)
        assert files.arrays_header(path) == {} and files.json_header(path) is None
        path.rmdir() if path.is_dir() else path.unlink()


def test_any_error_of_reading_says_that_the_file_is_damaged(tmp_path):
    for error in (RecursionError, MemoryError, ZeroDivisionError, Exception, OSError, AssertionError, StopIteration):
        with pytest.raises(FormatError, match=DAMAGED) as caught:
            with files.reading(tmp_path / "x", THING):
                raise error
        assert isinstance(caught.value.__cause__, error)
    for error in (KeyboardInterrupt, FileNotFoundError):
        with pytest.raises(error):
            with files.reading(tmp_path / "x", THING):
                raise error


@pytest.fixture
def run(stored, tmp_path):
    return shutil.copytree(stored.pristine / "run", tmp_path / "run")


def test_a_table_with_another_digit_is_set_aside_and_counts_as_absent(run, caplog):
    path = run / schema.CONTRIBUTORS.place
    assert read_outcome(run).study(schema.CONTRIBUTORS) is not None
    text = path.read_text()
    digit = max(i for i, character in enumerate(text) if character.isdigit())
    path.write_text(f"{text[:digit]}{(int(text[digit]) + 1) % 10}{text[digit + 1 :]}")
    with pytest.raises(FormatError, match=r"contributors\.csv: this table is cut short or damaged"):
        schema.CONTRIBUTORS.read(run, "again")
    assert read_outcome(run).study(schema.CONTRIBUTORS) is None
    assert "set aside and counts as absent" in caplog.text and path.with_name(path.name + ".damaged").is_file()


def test_files_of_other_samples_of_the_same_run_are_not_used(run):
    first, second = sorted((run / "measurements" / "law=coulomb").glob("*.parquet"))
    shutil.copy(first, second)
    other_law = run / "samples" / "law=frictionless" / first.name
    shutil.copy(run / "samples" / "law=coulomb" / first.name, other_law)
    outcome = read_outcome(run)
    assert len(outcome.damaged) == 2 and all("holds other samples" in sentence for sentence in outcome.damaged)
    assert [len(outcome.sample_numbers(law)) for law in outcome.laws] == [SAMPLES // 2] * 2


def test_parts_and_fields_of_another_run_are_not_used(run):
    store = RunFolder(run)
    assert len(store.parts()) == 2 and len(read_fields(run)[0]) == 1
    inputs = store.record()["inputs"] | {"seed": 77}
    store.write_record(store.record() | {"inputs": inputs, "seed": 77, "identity": files.fingerprint(inputs)})
    for read in (store.parts, lambda: read_fields(run)):
        with pytest.raises(FormatError, match="belongs to another run"):
            read()


def test_a_summary_is_read_by_any_json_reader(run):
    content = json.loads((run / "summary.json").read_text())
    assert content["kind"] == "summary of a run" and len(content["checksum"]) == 64


def test_only_a_copy_of_stored_files_is_renewed(tmp_path):
    """What renews them removes a folder first: anything else with a root, such as a path, must keep it."""
    (tmp_path / "kept").touch()
    with pytest.raises(AttributeError, match="renew"):
        attack_files(SimpleNamespace(root=tmp_path), [1])
    assert (tmp_path / "kept").exists()
