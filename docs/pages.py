"""The pages of the documentation that the code writes: API, command line, results, verification, development.

All pages follow from the code: a new module, option, table or study has its page with the next build. The scene
reference is generated separately and committed: ``python -m mic.scene.reference > docs/scene.md``.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import sys
import types
from importlib.util import find_spec
from pathlib import Path

from typer.testing import CliRunner

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests"))
from support import mutations as planted  # noqa: E402

PACKAGES = {
    "mic": "the program: variation simulation",
    "fem_reference": "the reference: shells, influence coefficients, full frictional contact by FEniCSx",
    "verification": "the studies that compare both with references",
}


def write(folder: Path) -> None:
    """Write all generated pages: unchanged ones keep their time, obsolete ones are deleted."""
    pages = {**api(), **functions(), **command_line(), **results(), **verification(), **project(), **dependencies()}
    for path in folder.glob("**/*.md"):
        if "gallery" not in path.parts and path.relative_to(folder).as_posix() not in pages:
            path.unlink()
    for name, text in pages.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def api() -> dict[str, str]:
    """One page per package and per module with a public name; packages link to their modules."""
    pages = {}
    lines = [
        "# API",
        "",
        "Most programs need [mic](api/mic.md), which loads, reduces, evaluates and runs, or",
        "[mic.contact](api/mic.contact.md), the contact solver by itself. The packages are described in",
        "[the structure of the program](../structure.md). Units are mm, N, MPa.",
        "",
    ]
    for package, job in PACKAGES.items():
        if package == "fem_reference" and find_spec("dolfinx") is None:
            continue  # its modules cannot be imported without dolfinx
        tree = _tree(package)
        pages |= {f"api/{name}.md": _module_page(name, children) for name, children in tree.items()}
        lines += [f"## {package}", "", f"{job[0].upper()}{job[1:]}.", ""]
        lines += [*_table(tree[package], "api/"), *_toctree([package], "api/")]
    return pages | {"api.md": "\n".join(lines)}


def functions() -> dict[str, str]:
    """Table of commands, with the function of the same name, its result and the pictures of the result."""
    mic, shown = importlib.import_module("mic"), importlib.import_module("mic.report.study_pictures").STUDIES
    drawn = {entry.command: entry for entry in shown}
    commands = importlib.import_module("mic.options").app.registered_commands
    lines = [
        "# Commands and functions",
        "",
        "Each command but `mic serve` is a function of `mic`. `mic.report.pictures(result)` draws its result as in a",
        "report; notebooks display these pictures. The [gallery](gallery/index) has an example of each command.",
        "",
        "| command | function | returns | pictures |",
        "| --- | --- | --- | --- |",
    ]
    for name in sorted({command.name or command.callback.__name__ for command in commands} - {"serve"}):
        function, where = getattr(mic, name), f"mic.{name}"
        if isinstance(function, types.ModuleType):  # a subpackage has the name
            function, where = function.write_report, f"mic.{name}.write_report"
        home = f"{function.__module__}.{function.__qualname__}"
        returned = inspect.signature(function).return_annotation.removeprefix("pd.").replace(" | ", " or ")
        entry = drawn.get(name)
        pictures = {"check": "those of its page", "report": "its own"}.get(name, "–")
        if entry is not None:
            pictures = entry.words
            if not isinstance(entry.returns, type):
                returned += f", as `mic.results.schema.{entry.returns.name.upper()}`"
        lines.append(f"| `mic {name}` | {{py:func}}`{where} <{home}>` | {returned} | {pictures} |")
    return {"functions.md": "\n".join([*lines, ""])}


def command_line() -> dict[str, str]:
    """The ``--help`` text of each command."""
    lines = [
        "# Command line",
        "",
        "`mic` simulates, `python -m verification` runs the verification studies. Exit codes: 0, or 2 with one line",
    ]
    lines += ["that states the error and its remedy; 1 if a verification study exceeds its limits.", ""]
    for module, program in (("mic.options", "mic"), ("verification.__main__", "python -m verification")):
        if find_spec("dolfinx") is None and module.startswith("verification"):
            continue
        app = importlib.import_module(module).app
        commands = [command.name or command.callback.__name__ for command in app.registered_commands]
        for command in ("", *commands):
            arguments = [*command.split(), "--help"]
            output = (
                CliRunner().invoke(app, arguments, prog_name=program, env={"COLUMNS": "92", "NO_COLOR": "1"}).output
            )
            text = "\n".join(line.rstrip() for line in output.strip("\n ").splitlines())
            lines += [f"##{'#' if command else ''} {program} {command}".rstrip(), "", "```text", text, "```", ""]
    return {"command_line.md": "\n".join(lines)}


def results() -> dict[str, str]:
    """Every table and column of a results folder, from the schema of the results."""
    return {"../results.md": importlib.import_module("mic.results.schema").reference()}


def verification() -> dict[str, str]:
    """A page for each verification study, and a page with the claims of all."""
    folder = ROOT / "verification"
    # The studies import dolfinx: without it their pages have no limits.
    found = {} if find_spec("dolfinx") is None else importlib.import_module("verification.study").studies()
    names = sorted(path.parent.name for path in folder.glob("*/README.md"))
    pages = {}
    lines = [
        "# Verification",
        "",
        "Each study states a claim, a reference and limits for its numbers; a test checks that it fails on a planted",
        "error. `script/verify` runs all studies (`script/verify --quick` small ones, in minutes) and writes a report:",
        "a first page to be signed, a page for each study, all numbers; `--pdf` prints it.",
        "",
        "| study | claim |",
        "| --- | --- |",
    ]
    for name in names:
        text = _linked(folder / name / "README.md")
        title, claim, reference = re.match(
            r"# (.*)\n\n\*\*Claim\.\*\* (.*)\n\n(\*\*Reference\.\*\* .*)\n", text
        ).groups()
        limits = found[name].limits() if found else ""
        pages[f"verification/{name}.md"] = text.replace(reference, f"{reference}\n\n{limits}".rstrip(), 1)
        lines.append(f"| [{title}](verification/{name}.md) | {claim} |")
    lines += ["", _linked(ROOT / "verification" / "README.md")]
    lines += ["", *_toctree(names, "verification/")]
    return pages | {"verification.md": "\n".join(lines)}


def project() -> dict[str, str]:
    """CONTRIBUTING and CHANGELOG from the root of the project, and the list of planted errors from the tests."""
    pages = {f"{name.lower()}.md": _linked(ROOT / f"{name}.md") for name in ("CONTRIBUTING", "CHANGELOG")}
    return pages | {"mutations.md": planted.page(planted.mutations())}


def dependencies() -> dict[str, str]:
    """Direct dependencies, also the optional ones: range and purpose, from pyproject.toml and its comments."""
    always, extras = (ROOT / "pyproject.toml").read_text(encoding="utf-8").split("[project.optional-dependencies]")
    lines = [
        "# Dependencies",
        "",
        "`pip` takes any version in these ranges; the scripts install those of `script/constraints.txt`. The report",
        "of a run ends with the versions that it used. The standard library could replace typer (by `argparse`) and",
        "rich (by `print`), at the cost of more code. plotly serves for one file of JavaScript, which no smaller",
        "package contains. matplotlib, plotly, jinja2 and meshlane are imported at their first use.",
    ]
    for title, text in (("Always", always.split("\ndependencies = ")[1]), ("Extras", extras.split("\ntest = ")[0])):
        lines += ["", f"## {title}", "", "| package | version | for |", "| --- | --- | --- |"]
        for line in text.splitlines():
            found = re.findall(r'"([\w-]+)([<>=][^";]*)', line)
            if found:
                packages, versions = (", ".join(words) for words in zip(*found))
                lines.append(f"| {packages} | {versions} | {line.partition(' # ')[2]} |")
    return {"dependencies.md": "\n".join([*lines, ""])}


def _linked(path: Path) -> str:
    """A page from outside the documentation; links to files outside become plain text."""

    def link(match):
        text, target = match[1], (path.parent / match[2].split("#")[0]).resolve()
        if target.suffix != ".md" or target.parent != ROOT / "docs":
            return text
        return f"[{text}]({'../' * (1 + (path.parent != ROOT))}{target.name})"

    return re.sub(r"(?<!!)\[([^\]]*)\]\((?!\w+:|#)([^)]*)\)", link, path.read_text(encoding="utf-8"))


def _tree(package: str) -> dict[str, list[str]]:
    """Each package with its modules that have public names, and its subpackages with such modules."""
    tree: dict[str, list[str]] = {package: []}
    for item in pkgutil.iter_modules(importlib.import_module(package).__path__, f"{package}."):
        below = _tree(item.name) if item.ispkg else {item.name: []}
        if item.name.endswith("__main__") or not (len(below) > 1 or _public(item.name)):
            continue
        tree[package].append(item.name)
        tree |= below
    return tree


def _public(name: str) -> list[str]:
    return getattr(importlib.import_module(name), "__all__", [])


def _table(names: list[str], folder: str = "") -> list[str]:
    """Table of modules with the first paragraph of their docstrings."""
    rows = [f"| [{name}]({folder}{name}.md) | {_summary(importlib.import_module(name))} |" for name in names]
    return ["| module | holds |", "| --- | --- |", *rows, ""] if rows else []


def _summary(thing) -> str:
    """The first paragraph of a docstring, in Markdown."""
    text = inspect.cleandoc(thing.__doc__ or "").split("\n\n")[0].replace("\n", " ")
    return re.sub(r":\w+:`~?\.?([^`]*)`", r"`\1`", text).replace("``", "`").replace("|", "\\|")


def _toctree(names: list[str], folder: str = "") -> list[str]:
    entries = [f"{name.split('.')[-1]} <{folder}{name}>" if "." in name else f"{folder}{name}" for name in names]
    return ["```{toctree}", ":hidden:", ":maxdepth: 1", "", *entries, "```", ""] if names else []


def _module_page(name: str, children: list[str]) -> str:
    """Page of a module: its own members in full, re-exported ones as links."""
    module = importlib.import_module(name)
    members, tables, imported, aliases = [], [], [], []
    for item in _public(name):
        thing = getattr(module, item)
        home = getattr(thing, "__module__", name)
        if isinstance(thing, (types.GenericAlias, types.UnionType)) or type(thing).__module__ == "typing":
            aliases.append(f"- `{item}` = `{thing}`")  # autodoc takes them for classes
        elif isinstance(thing, types.ModuleType):
            imported.append(f"- {{py:mod}}`{thing.__name__}`")
        elif home == name or not (inspect.isclass(thing) or inspect.isroutine(thing)):
            long = isinstance(thing, (dict, list, tuple)) and len(repr(thing)) > 80  # its value is not shown
            (tables if long else members).append(item)
        else:
            imported.append(f"- {{py:obj}}`{item} <{home}.{thing.__qualname__}>`: {_summary(thing)}")
    option = f"   :members: {', '.join(members)}" if members else "   :no-members:"
    values = [line for item in tables for line in ("", f".. autodata:: {name}.{item}", "   :no-value:")]
    lines = [f"# {name}", "", "```{eval-rst}", f".. automodule:: {name}", option, *values, "```", ""]
    for title, items in (("Type aliases", aliases), ("Imported members", imported)):
        if items:
            lines += [f"## {title}", "", *items, ""]
    if children:
        lines += ["## Modules", "", *_table(children), *_toctree(children)]
    return "\n".join(lines)
