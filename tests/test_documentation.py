"""The pages name what is there: modules, names in them, files."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*(ROOT / "docs").glob("*.md"), *ROOT.glob("verification/*/README.md"), ROOT / "README.md"])
PAGES = [page for page in [*PAGES, ROOT / "CONTRIBUTING.md"] if page.name != "results.md"]  # which is not kept
FOLDERS = ("benchmarks", "docs", "fem_reference", "meshes", "mic", "script", "tests", "verification")


def module(words):
    """File of a module or package, and the words that name something in it."""
    for end in range(len(words), 0, -1):
        path = ROOT.joinpath(*words[:end])
        for file in (path.with_suffix(".py"), path / "__init__.py"):
            if file.is_file():
                return file, words[end:]
    return None, words


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_module_that_a_page_names_exists(page):
    text = page.read_text(encoding="utf-8")
    imported = re.findall(r"^from ((?:mic|fem_reference|verification)[\w.]*) import (.+)$", text, re.M)
    dotted = {f"{found}.{name}" for found, names in imported for name in re.split(r",\s*", names)}
    dotted |= set(re.findall(r"(?<![\w./])((?:mic|fem_reference|verification)(?:\.\w+)+)", text))
    for name in sorted(dotted - {"mic.compliance"}):  # that is an entry point's group, too
        file, rest = module(name.split("."))
        assert file is not None, f"{page.name} names {name}"
        if rest and file.name == "__init__.py":
            assert re.search(rf"\b{rest[0]}\b", file.read_text()), f"{page.name}: {file} has no {rest[0]}"
        elif rest:
            assert re.search(rf"^(?:def|class) {rest[0]}\b|^{rest[0]}\b.*=", file.read_text(), re.M), (
                f"{page.name}: {name}"
            )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_file_that_a_page_names_or_links_to_exists(page):
    text = page.read_text(encoding="utf-8")
    for path in sorted(set(re.findall(rf"(?<![\w./])((?:{'|'.join(FOLDERS)})/[\w./*-]+\w)", text))):
        if not re.search("[A-Z]{4,}", path.replace("README", "")):  # NAME stands for any
            assert list(ROOT.glob(path)), f"{page.name} names {path}"
    for target in re.findall(r"\]\((?!\w+:|#)([^)#]+)[^)]*\)", text):
        if not target.startswith("_generated") and Path(target).name != "results.md":
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
