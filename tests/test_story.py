"""The story of one bad assembly is true: it runs from its first line to its last, and gives what it prints."""

import contextlib
import io
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "story.md").read_text(encoding="utf-8")


def alike(one, other):
    """Whether two words are the same, or numbers that differ by one in the last digit at most: libraries round."""
    try:
        a, b = float(one), float(other)
    except ValueError:
        return one == other
    digits = len(one.partition(".")[2])
    return len(other.partition(".")[2]) == digits and abs(a - b) < 1.5 * 10.0**-digits


@pytest.mark.slow
def test_the_page_runs_and_prints_the_shown_output(cache, monkeypatch):
    monkeypatch.setenv("MIC_CACHE", str(cache))
    blocks = re.findall(r"```python\n(.*?)```(?:\s*```text\n(.*?)```)?", PAGE, re.S)
    assert len(blocks) == 5 and all(printed for _, printed in blocks)
    names = {}
    for code, printed in blocks:
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            exec(code, names)
        words, expected = said.getvalue().split(), printed.split()
        assert len(words) == len(expected), said.getvalue()
        for word, other in zip(words, expected):
            assert alike(word, other), said.getvalue()


def test_every_number_in_the_text_is_printed_by_the_code():
    printed = " ".join(re.findall(r"```text\n(.*?)```", PAGE, re.S)).split()
    prose = re.sub(r"```.*?```", "", PAGE, flags=re.S)
    figures = re.findall(r"\*\*(.*?)\*\*", prose)
    assert len(figures) >= 7
    for figure in figures:
        assert figure in printed or f"{figure}," in printed, figure


def test_numbers_are_compared_as_they_are_printed():
    assert alike("0.76", "0.77") and not alike("0.76", "0.78") and alike("good", "good") and not alike("good", "bad")
