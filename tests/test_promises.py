"""Promises of the documentation name existing tests."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_every_promise_names_existing_tests():
    promises = (ROOT / "docs" / "promises.md").read_text()
    defined = {
        name for path in (ROOT / "tests").glob("test_*.py") for name in re.findall(r"def (test_\w+)", path.read_text())
    }
    named = set(re.findall(r"`(test_\w+)`", promises))
    assert len(named) > 20 and named <= defined
    for item in re.split(r"^- ", promises, flags=re.M)[1:]:
        assert "`test_" in item, item
