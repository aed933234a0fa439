"""The pages of the documentation that the code writes: API, command line, results, verification, development.

Nothing here is a list kept by hand: a module, option, table or study that is added has its page with the next build.
The scene reference is written too, but kept: ``python -m mic.scene.reference > docs/scene.md``.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import types
from importlib.util import find_spec
from pathlib import Path

from typer.testing import CliRunner

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "mic": "production: what a Monte Carlo needs",
    "fem_reference": "the truth: shells, influence coefficients, full frictional contact",
    "verification": "the judge",
}


def write(folder: Path) -> None:
    """Write all generated pages; a page that has not changed keeps its time, one that nobody writes any more goes."""
    pages = {**api(), **functions(), **command_line(), **results(), **verification(), **project()}
    for path in folder.glob("**/*.md"):
        if "gallery" not in path.parts and path.relative_to(folder).as_posix() not in pages:
            path.unlink()
    for name, text in pages.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def api() -> dict[str, str]:
    """One page per package and per module with a public name; a package's page leads to those of its modules."""
    pages = {}
    lines = [
        "# API",
        "",
        "Most programs need [mic](api/mic.md), which loads, reduces, evaluates and runs, or",
        "[mic.contact](api/mic.contact.md), the contact solver by itself. What each room is for stands in",
        "[how the program is built](../structure.md). Units are mm, N, MPa.",
        "",
    ]
    for package, job in PACKAGES.items():
        if package == "fem_reference" and find_spec("dolfinx") is None:
            continue  # its modules cannot be imported, nor described, without the finite elements
        tree = _tree(package)
        pages |= {f"api/{name}.md": _module_page(name, children) for name, children in tree.items()}
        lines += [f"## {package}", "", f"{job[0].upper()}{job[1:]}.", ""]
        lines += [*_table(tree[package], "api/"), *_toctree([package], "api/")]
    return pages | {"api.md": "\n".join(lines)}


def functions() -> dict[str, str]:
    """Each command, the function of the same name, what it returns, and what is drawn of that."""
    mic, shown = importlib.import_module("mic"), importlib.import_module("mic.report.study_pictures").SHOWN
    drawn = {one.command: one for one in shown}
    commands = importlib.import_module("mic.options").app.registered_commands
    lines = [
        "# Commands and functions",
        "",
        "Each command is a function of `mic`, and `mic.report.pictures(found)` draws what it returns: the pictures",
        "that a report shows, which notebooks show by themselves. The [gallery](gallery/index) has a page for each",
        "question.",
        "",
        "| command | function | returns | pictures |",
        "| --- | --- | --- | --- |",
    ]
    for name in sorted(command.name or command.callback.__name__ for command in commands):
        function, where = getattr(mic, name), f"mic.{name}"
        if isinstance(function, types.ModuleType):  # a room has the name
            function, where = function.write_report, f"mic.{name}.write_report"
        home = f"{function.__module__}.{function.__qualname__}"
        returned = inspect.signature(function).return_annotation.removeprefix("pd.").replace(" | ", " or ")
        one = drawn.get(name)
        if one is not None and not isinstance(one.returns, type):
            returned += f", as `mic.results.schema.{one.returns.name.upper()}`"
        words = one.words if one is not None else {"check": "those of its page", "report": "its own"}.get(name, "–")
        lines.append(f"| `mic {name}` | {{py:func}}`{where} <{home}>` | {returned} | {words} |")
    return {"functions.md": "\n".join([*lines, ""])}


def command_line() -> dict[str, str]:
    """What ``--help`` says of each command."""
    lines = [
        "# Command line",
        "",
        "`mic` simulates, `python -m verification` judges. Exit codes: 0, or 2 with one line",
    ]
    lines += ["that says what is wrong and what to do; a verification that misses its numbers ends with 1.", ""]
    for module, program in (("mic.options", "mic"), ("verification.__main__", "python -m verification")):
        if find_spec("dolfinx") is None and module.startswith("verification"):
            continue
        app = importlib.import_module(module).app
        commands = [command.name or command.callback.__name__ for command in app.registered_commands]
        for command in ("", *commands):
            asked = [*command.split(), "--help"]
            shown = CliRunner().invoke(app, asked, prog_name=program, env={"COLUMNS": "92", "NO_COLOR": "1"}).output
            text = "\n".join(line.rstrip() for line in shown.strip("\n ").splitlines())
            lines += [f"##{'#' if command else ''} {program} {command}".rstrip(), "", "```text", text, "```", ""]
    return {"command_line.md": "\n".join(lines)}


def results() -> dict[str, str]:
    """Every table and column of a results folder, from the declaration that writes and checks them."""
    return {"../results.md": importlib.import_module("mic.results.schema").reference()}


def verification() -> dict[str, str]:
    """The page of each verification study, and of all of them their claims."""
    studies = sorted(path.parent for path in (ROOT / "verification").glob("*/README.md"))
    pages = {f"verification/{study.name}.md": _linked(study / "README.md") for study in studies}
    lines = [
        "# Verification",
        "",
        "Each study states a claim, a reference and the numbers that it must keep; on a planted error a test sees it",
        "miss them. `script/verify` runs them all, `script/verify --quick` on small meshes, and writes a method",
        "validation report: a first page to be signed, a page for each study, all numbers; `--pdf` prints it.",
        "",
        "| study | claim |",
        "| --- | --- |",
    ]
    for study in studies:
        text = (study / "README.md").read_text(encoding="utf-8")
        title = re.search(r"^# (.*)$", text, re.MULTILINE)[1]
        claim = re.search(r"\*\*Claim\.\*\*\s+(.*?)\n\n", text, re.DOTALL)[1].replace("\n", " ")
        lines.append(f"| [{title}](verification/{study.name}.md) | {claim} |")
    lines += ["", _linked(ROOT / "verification" / "README.md")]
    lines += ["", *_toctree([study.name for study in studies], "verification/")]
    return pages | {"verification.md": "\n".join(lines)}


def project() -> dict[str, str]:
    """CONTRIBUTING and CHANGELOG as they stand at the root of the project."""
    return {f"{name.lower()}.md": _linked(ROOT / f"{name}.md") for name in ("CONTRIBUTING", "CHANGELOG")}


def _linked(path: Path) -> str:
    """A page that stands outside the documentation; of its links to other files those into the documentation stay."""

    def link(found):
        text, target = found[1], (path.parent / found[2].split("#")[0]).resolve()
        if target.suffix != ".md" or target.parent != ROOT / "docs":
            return text
        return f"[{text}]({'../' * (1 + (path.parent != ROOT))}{target.name})"

    return re.sub(r"(?<!!)\[([^\]]*)\]\((?!\w+:|#)([^)]*)\)", link, path.read_text(encoding="utf-8"))


def _tree(package: str) -> dict[str, list[str]]:
    """Modules with a public name, and the packages that hold some; each package with what stands in it."""
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
    """Modules with the first sentence that each says of itself."""
    rows = [f"| [{name}]({folder}{name}.md) | {_said(importlib.import_module(name))} |" for name in names]
    return ["| module | holds |", "| --- | --- |", *rows, ""] if rows else []


def _said(thing) -> str:
    """The first paragraph that something says of itself, in Markdown."""
    text = inspect.cleandoc(thing.__doc__ or "").split("\n\n")[0].replace("\n", " ")
    return re.sub(r":\w+:`~?\.?([^`]*)`", r"`\1`", text).replace("``", "`").replace("|", "\\|")


def _toctree(names: list[str], folder: str = "") -> list[str]:
    entries = [f"{name.split('.')[-1]} <{folder}{name}>" if "." in name else f"{folder}{name}" for name in names]
    return ["```{toctree}", ":hidden:", ":maxdepth: 1", "", *entries, "```", ""] if names else []


def _module_page(name: str, children: list[str]) -> str:
    """What a module defines, in full; what it hands on from another module, as a link there."""
    module = importlib.import_module(name)
    own, long, elsewhere, aliases = [], [], [], []
    for item in _public(name):
        thing = getattr(module, item)
        home = getattr(thing, "__module__", name)
        if isinstance(thing, (types.GenericAlias, types.UnionType)) or type(thing).__module__ == "typing":
            aliases.append(f"- `{item}` = `{thing}`")  # autodoc takes them for classes
        elif isinstance(thing, types.ModuleType):
            elsewhere.append(f"- {{py:mod}}`{thing.__name__}`")
        elif home == name or not (inspect.isclass(thing) or inspect.isroutine(thing)):
            table = isinstance(thing, (dict, list, tuple)) and len(repr(thing)) > 80  # is read in the source, if at all
            (long if table else own).append(item)
        else:
            elsewhere.append(f"- {{py:obj}}`{item} <{home}.{thing.__qualname__}>`: {_said(thing)}")
    members = f"   :members: {', '.join(own)}" if own else "   :no-members:"
    values = [line for item in long for line in ("", f".. autodata:: {name}.{item}", "   :no-value:")]
    lines = [f"# {name}", "", "```{eval-rst}", f".. automodule:: {name}", members, *values, "```", ""]
    for title, items in (("Names for types", aliases), ("Also to be had here", elsewhere)):
        if items:
            lines += [f"## {title}", "", *items, ""]
    if children:
        lines += ["## Modules", "", *_table(children), *_toctree(children)]
    return "\n".join(lines)
