"""Files are written whole or not at all, and read only as what they are."""

import json
import multiprocessing
import os
import resource
import time
from pathlib import Path

import numpy as np
import pytest

from mic.errors import FormatError, StorageError
from mic.system import files

THING = files.Format("thing", 3, "make it again")
ARRAYS = {"H": np.arange(12.0).reshape(3, 4), "names": np.array(["a", "bb"]), "none": np.zeros((0, 2))}


@pytest.fixture
def path(tmp_path):
    files.save_arrays(tmp_path / "thing.npz", THING, {"part": "lower"}, ARRAYS)
    return tmp_path / "thing.npz"


def test_saved_arrays_are_loaded_unchanged(path):
    header, arrays = files.load_arrays(path, THING)
    assert header == {"part": "lower"} and set(arrays) == set(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], array)
    assert [entry.name for entry in path.parent.iterdir()] == ["thing.npz"]  # nothing partial is left


def test_a_truncated_file_is_refused_in_one_sentence(path):
    whole = path.read_bytes()
    for length in [0, 1, 30, *range(100, len(whole), 211), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(FormatError, match=r"this thing is cut short or damaged; make it again$"):
            files.load_arrays(path, THING)


def test_an_altered_byte_never_changes_loaded_numbers(path):
    whole = path.read_bytes()
    for position in range(0, len(whole), 37):
        altered = bytearray(whole)
        altered[position] ^= 0x55
        path.write_bytes(bytes(altered))
        try:
            header, arrays = files.load_arrays(path, THING)
        except FormatError:
            continue
        assert header == {"part": "lower"}  # the byte had no meaning
        for name, array in ARRAYS.items():
            np.testing.assert_array_equal(arrays[name], array)


def test_exchanged_content_fails_its_checksum(path):
    _, arrays = files.load_arrays(path, THING)
    with np.load(path) as data:
        header = data["header"]
    np.savez(path, header=header, **(arrays | {"H": 3 * arrays["H"]}))
    with pytest.raises(FormatError, match="cut short or damaged"):
        files.load_arrays(path, THING)


@pytest.mark.parametrize("version, word", [(2, "an older version"), (4, "a newer version")])
def test_a_file_of_another_version_is_refused(path, version, word):
    files.save_arrays(path, files.Format("thing", version, ""), {}, ARRAYS)
    with pytest.raises(
        FormatError, match=rf"written by {word} of the program \(format {version}, this version reads 3\)"
    ):
        files.load_arrays(path, THING)
    files.save_json(path.with_suffix(".json"), files.Format("thing", version, ""), {})
    with pytest.raises(FormatError, match=word):
        files.load_json(path.with_suffix(".json"), THING)


def test_a_file_of_another_kind_is_refused(path):
    files.save_arrays(path, files.Format("other", 3, ""), {}, ARRAYS)
    with pytest.raises(FormatError, match="this is no thing; make it again"):
        files.load_arrays(path, THING)
    path.with_suffix(".json").write_text('{"some": "thing"}')
    with pytest.raises(FormatError, match="this is no thing"):
        files.load_json(path.with_suffix(".json"), THING)
    with pytest.raises(FileNotFoundError):
        files.load_arrays(path.with_name("nowhere.npz"), THING)


def test_no_content_is_ever_executed(path, tmp_path):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    np.savez(path, header=np.array(json.dumps({"kind": "thing", "format": 3})), H=np.array([Trap()], dtype=object))
    with pytest.raises(FormatError):
        files.load_arrays(path, THING)
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(
    "error, raised, words",
    [
        (RuntimeError("power cut"), RuntimeError, "power cut"),
        (OSError(28, "No space left on device"), StorageError, "thing.npz: cannot be written .no space left"),
    ],
)
def test_an_error_while_writing_keeps_the_old_file(path, error, raised, words):
    before = path.read_bytes()
    with pytest.raises(raised, match=words), files.replacing(path) as temporary:
        temporary.write_bytes(b"half")
        raise error
    assert path.read_bytes() == before
    assert [entry.name for entry in path.parent.iterdir()] == ["thing.npz"]


def test_saved_json_is_loaded_unchanged_and_nan_is_refused(tmp_path):
    files.save_json(tmp_path / "run.json", THING, {"samples": 3, "laws": ["coulomb"]})
    assert files.load_json(tmp_path / "run.json", THING) == {"samples": 3, "laws": ["coulomb"]}
    with pytest.raises(ValueError):
        files.save_json(tmp_path / "run.json", THING, {"x": float("nan")})
    assert files.load_json(tmp_path / "run.json", THING)["samples"] == 3


@pytest.mark.parametrize("lasting", [True, False])
def test_content_is_synchronised_before_it_is_renamed(tmp_path, monkeypatch, lasting):
    events, path = [], tmp_path / "table.txt"
    sync = os.fsync

    def synced(descriptor):
        events.append((Path(os.readlink(f"/proc/self/fd/{descriptor}")) == tmp_path, path.exists()))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", synced)
    with files.replacing(path, lasting) as temporary:
        temporary.write_text("content", encoding="utf-8")
    assert events == [(False, False), (True, True)][: 1 + lasting]  # (of the folder, once the name stands)


def test_files_of_a_group_are_renamed_in_order_once_all_are_written(tmp_path, monkeypatch):
    events, sync, replace = [], os.fsync, Path.replace

    def synced(descriptor):
        events.append(("disk", Path(os.readlink(f"/proc/self/fd/{descriptor}")).name))
        sync(descriptor)

    def replaced(path, target):
        events.append(("name", Path(target).name))
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "replace", replaced)
    names = ["c.txt", "a.txt", "b.txt"]
    with files.together() as group:
        for name in names:
            with files.replacing(tmp_path / name, group=group) as temporary:
                temporary.write_text(name, encoding="utf-8")
        assert not events
    contents, order, folder = events[:3], events[3:6], events[6:]
    assert sorted(name[1] for _, name in contents) == ["a", "b", "c"] and {kind for kind, _ in contents} == {"disk"}
    assert order == [("name", name) for name in names] and folder == [("disk", tmp_path.name)]
    assert [path.read_text() for path in sorted(tmp_path.iterdir())] == sorted(names)


def test_an_error_in_a_group_keeps_all_old_files(tmp_path, monkeypatch):
    (tmp_path / "a.txt").write_text("old")

    def write(*names):
        with files.together() as group:
            for name in names:
                with files.replacing(tmp_path / name, group=group) as temporary:
                    if name == "full.txt":
                        raise OSError(28, "No space left on device")
                    temporary.write_text(name, encoding="utf-8")

    with pytest.raises(StorageError, match=r"full\.txt: cannot be written .no space left"):
        write("a.txt", "full.txt")
    sync = os.fsync

    def fails(descriptor):
        if Path(os.readlink(f"/proc/self/fd/{descriptor}")).name.startswith(".b."):
            raise OSError(5, "Input/output error")
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(StorageError, match=r"b\.txt: cannot be written .input/output error"):
        write("a.txt", "b.txt", "c.txt")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.txt", "old")]


def append_lines(path, letter):
    for _ in range(50):
        files.append_text(path, letter * 3000 + "\n")


def test_lines_that_several_processes_append_stay_whole_and_a_cut_one_ends(tmp_path):
    path = tmp_path / "log"
    path.write_text("cut")
    context = multiprocessing.get_context("fork")
    writers = [context.Process(target=append_lines, args=(path, letter)) for letter in "abc"]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    lines = path.read_text().splitlines()
    assert lines[0] == "cut" and sorted(lines[1:]) == sorted(letter * 3000 for letter in "abc" for _ in range(50))


def append_beyond(path):
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
    try:
        files.append_text(path, "b" * 9000 + "\n")
    except StorageError:
        os._exit(7)


def test_a_line_for_which_there_is_no_room_leaves_no_part(tmp_path):
    path = tmp_path / "log"
    files.append_text(path, "a" * 2000 + "\n")
    writer = multiprocessing.get_context("fork").Process(target=append_beyond, args=(path,))
    writer.start()
    writer.join()
    assert writer.exitcode == 7 and path.read_text() == "a" * 2000 + "\n"


def test_a_process_that_is_forked_while_a_line_is_appended_holds_nobody_up(tmp_path, monkeypatch):
    """It has the log open, too, until it ends."""
    path, context, forked = tmp_path / "log", multiprocessing.get_context("fork"), []

    def fork(descriptor):
        forked.append(context.Process(target=time.sleep, args=(20,)))
        forked[-1].start()

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fsync", fork)
        files.append_text(path, "a\n")
    writer = context.Process(target=files.append_text, args=(path, "b\n"))
    writer.start()
    writer.join(10)
    forked[0].kill()
    assert path.read_text() == "a\nb\n"
