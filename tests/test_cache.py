"""A cache entry counts as absent unless it is whole, of the same inputs and the user's own."""

import logging
import os
import stat

import numpy as np
import pytest

from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, save_arrays

THING = Format("thing", 1, ABSENT)
H = np.arange(6.0).reshape(2, 3)


@pytest.fixture
def cache(tmp_path):
    made = Cache(tmp_path / "cache", "influence", THING)
    made.store("abc", {"part": "lower"}, {"H": H})
    return made


def refused(cache, caplog, words, identity="abc"):
    """Whether an entry counts as absent with one warning of these words, and a new entry is loaded without one."""
    caplog.clear()
    assert cache.load(identity) is None
    (line,) = caplog.messages
    assert words in line and str(cache.folder) in line and "\n" not in line
    cache.store(identity, {}, {"H": H})
    caplog.clear()
    return cache.load(identity) is not None and not caplog.messages


def test_a_truncated_file_counts_as_absent(cache, caplog):
    whole = cache.path("abc").read_bytes()
    for length in (0, 20, 200, len(whole) - 1):
        cache.path("abc").write_bytes(whole[:length])
        assert refused(cache, caplog, "cut short or damaged")


def test_a_file_of_other_inputs_counts_as_absent(cache, caplog):
    cache.path("other").write_bytes(cache.path("abc").read_bytes())
    assert refused(cache, caplog, "computed from other inputs", "other")
    save_arrays(cache.path("abc"), THING, {}, {"H": H})  # whole, and says nothing of what it was computed from
    assert refused(cache, caplog, "computed from other inputs")


def test_a_file_that_others_can_write_counts_as_absent(cache, caplog):
    cache.path("abc").chmod(0o620)
    assert refused(cache, caplog, "can be written by other users")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give a file away")
def test_a_file_of_another_user_counts_as_absent(cache, caplog):
    os.chown(cache.path("abc"), 65534, -1)
    assert refused(cache, caplog, "belongs to another user")


def test_the_folder_of_another_user_is_neither_read_nor_written(cache, caplog, monkeypatch):
    before = sorted(cache.folder.rglob("*"))
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert cache.load("abc") is None and "belongs to another user" in caplog.text
    caplog.clear()
    cache.store("abd", {}, {"H": H})
    (line,) = caplog.messages
    assert "cannot be cached (its folder belongs to another user)" in line and "MIC_CACHE" in line
    assert sorted(cache.folder.rglob("*")) == before


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_the_cache_is_private_whatever_the_umask(tmp_path):
    folder = tmp_path / "open"
    (folder / "influence").mkdir(parents=True)
    for place in (folder, folder / "influence"):
        place.chmod(0o777)
    mask = os.umask(0)
    try:
        cache = Cache(folder, "influence", THING)
        cache.store("abc", {}, {"H": H})
    finally:
        os.umask(mask)
    assert mode(folder) == mode(folder / "influence") == 0o700 and mode(cache.path("abc")) == 0o600
    assert cache.load("abc") is not None


def test_a_folder_with_other_content_keeps_its_permissions(tmp_path):
    folder = tmp_path / "home"
    folder.mkdir(mode=0o755)
    (folder / "letter.txt").write_text("mine")
    Cache(folder, "influence", THING).store("abc", {}, {"H": H})
    assert mode(folder) == 0o755 and mode(folder / "influence") == 0o700


def test_a_cache_that_cannot_be_written_gives_one_warning(tmp_path, caplog):
    (tmp_path / "file").write_text("")
    with caplog.at_level(logging.WARNING):
        Cache(tmp_path / "file", "influence", THING).store("abc", {}, {"H": H})
    (line,) = caplog.messages
    assert "this thing cannot be cached" in line and "set MIC_CACHE to a folder of your own" in line
    assert (tmp_path / "file").read_text() == ""
