"""The planted errors fit the present program, and the script that plants them gives the right verdicts."""

import subprocess
from pathlib import Path

import pytest
from support import mutations
from support.mutations import Mutation, judged

ROOT = Path(__file__).resolve().parents[1]
EVERY = mutations.mutations()


def test_each_planted_line_occurs_once_in_its_file():
    for mutation in EVERY:
        assert (ROOT / mutation.file).read_text(encoding="utf-8").count(mutation.right) == 1, mutation.what
        assert mutation.wrong != mutation.right
        assert mutation.tests and all((ROOT / test).is_file() for test in mutation.tests), mutation.what
    assert len({(one.file, one.right, one.wrong) for one in EVERY}) == len(EVERY) >= 60
    assert len({one.what for one in EVERY}) == len(EVERY)


def test_the_page_names_every_error():
    page = mutations.page(EVERY)
    assert all(f"{mutation.what}." in page and f"| `{mutation.file}` |" in page for mutation in EVERY)


@pytest.mark.slow
@pytest.mark.parametrize(
    "right, wrong, word",
    [
        ("return a + b", "return a - b", "caught"),
        ("return a + b", "return b + a", "survived"),
        ("return a + b", "return a +", "broken"),
        ("return a * b", "return a / b", "stale"),
    ],
)
def test_an_error_is_caught_survives_or_is_none(right, wrong, word, tmp_path, monkeypatch):
    for folder in (tmp_path / "own", tmp_path / "copy"):
        folder.mkdir()
        (folder / "sums.py").write_text("def total(a, b):\n    return a + b\n")
        (folder / "test_sums.py").write_text(
            "from sums import total\n\n\ndef test_total():\n    assert total(2, 1) == 3\n"
        )
    monkeypatch.setattr(mutations, "ROOT", tmp_path / "own")
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # faster
    found = judged(Mutation("it subtracts", "sums.py", right, wrong, ["test_sums.py"]), tmp_path / "copy")
    assert found.word == word, found.by
    assert (tmp_path / "copy" / "sums.py").read_text() == (tmp_path / "own" / "sums.py").read_text()


def test_a_copy_is_made_over_an_older_one(tmp_path, monkeypatch):
    own, copy = tmp_path / "own", tmp_path / "copy"
    (own / "mic").mkdir(parents=True)
    (own / "scenes").mkdir()
    (own / "mic" / "sums.py").write_text("right")
    (own / "mic" / "scenes").symlink_to("../scenes")
    subprocess.run(["git", "init", "-q", str(own)], check=True)
    monkeypatch.setattr(mutations, "ROOT", own)
    for _ in range(2):
        mutations.copied(copy)
        assert (copy / "mic" / "sums.py").read_text() == "right" and (copy / "mic" / "scenes").is_symlink()
        (copy / "mic" / "sums.py").write_text("wrong")
