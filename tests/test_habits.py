"""Tests use public names only, and no test module imports another."""

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
MODULES = sorted(TESTS.rglob("*.py"))
PUBLIC = ("os._exit",)  # documented by the standard library in spite of its name


def private(name):
    return name.startswith("_") and not name.endswith("_")  # Python's and IPython's own: __len__, _repr_html_


def offences(source):
    """Private members and test modules that a source uses, with their lines."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute):
            own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
            wrong = private(node.attr) and not own and ast.unparse(node) not in PUBLIC
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] + [getattr(node, "module", None) or ""]
            words = [word for name in names for word in name.split(".")]
            wrong = any(private(word) or word.startswith("test_") or word == "conftest" for word in words)
        elif isinstance(node, ast.Call):  # getattr(x, "_name"), monkeypatch.setattr(x, "_name", …), "mic.a._name"
            reached = getattr(node.func, "id", getattr(node.func, "attr", "")) in ("getattr", "setattr", "delattr")
            texts = [one.value for one in node.args if isinstance(one, ast.Constant) and isinstance(one.value, str)]
            wrong = reached and any(private(word) for text in texts for word in text.split("."))
        else:
            continue
        if wrong:
            found.append((node.lineno, ast.unparse(node)))
    return [f"line {line}: {text}" for line, text in sorted(found)]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(TESTS)))
def test_no_test_reaches_into_private_members_or_imports_another_test(path):
    assert offences(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "source",
    [
        "model._processes",
        "from mic.report.page import _zones",
        "from test_mesh import grid",
        "import conftest",
        "getattr(model, '_processes')",
        "monkeypatch.setattr('mic.contact.backends._native', None)",
    ],
)
def test_each_offence_is_found(source):
    assert len(offences(source)) == 1


def test_members_of_a_module_itself_are_no_offence():
    assert offences("self._open.pop(); x.__dict__; _ = f(x); os._exit(9)\nfrom __future__ import annotations") == []
