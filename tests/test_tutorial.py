"""The output that the tutorial quotes is what its commands print."""

import contextlib
import re
from pathlib import Path

import pytest
from support.runs import skip_pictures
from typer.testing import CliRunner

from mic.options import app

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "tutorial.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(sh|text)\n(.*?)^```", PAGE, re.M | re.S)


@pytest.mark.fem
@pytest.mark.slow
def test_quoted_output_is_printed(tmp_path, cache, monkeypatch):
    skip_pictures(monkeypatch.setattr)
    printed, quoted = "", 0
    for kind, block in BLOCKS:
        words = block.split()
        if kind == "text":
            assert set(block.splitlines()) <= set(printed.splitlines()), printed
            quoted += 1
        elif words[0].endswith("/mic"):
            with contextlib.chdir(tmp_path):
                done = CliRunner().invoke(app, words[1:], env={"MIC_CACHE": str(cache), "COLUMNS": "200"})
            assert done.exit_code == 0, done.output
            printed = done.output
    assert quoted
