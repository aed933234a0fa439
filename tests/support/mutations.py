"""Errors of physics, planted one at a time in a copy of the program: does a test catch each?

``script/mutate`` runs it. The list is tests/mutations.toml; the documentation has a page made from it.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

ROOT = Path(__file__).resolve().parents[2]
LIST = ROOT / "tests" / "mutations.toml"
PYTEST = ("-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider")
LONGEST = 600  # s: a test that hangs on an error has caught it
FAILED = 1  # how pytest ends when a test failed; what else it may say is no verdict
ALL_CAUGHT = "Each entry names the tests that must catch the error."
PAGE = """# Planted errors

`script/mutate` plants one error of physics at a time in a copy of the program, such as a wrong sign or a missing
quantity, and runs the tests that must fail. The entries are in `tests/mutations.toml`; add one for each new quantity.

{survivors}

| file | planted errors |
| --- | --- |
{rows}
"""


@dataclass(frozen=True)
class Mutation:
    """One planted error.

    Attributes
    ----------
    what : str
        Behaviour of the program with the error.
    file : str
        File with the error, relative to the project.
    right, wrong : str
        The text, which occurs once in the file, and its replacement.
    tests : list of str
        Files, cheapest first.
    survives : str
        Why no test catches it; empty where one must.
    """

    what: str
    file: str
    right: str
    wrong: str
    tests: list[str]
    survives: str = ""


@dataclass(frozen=True)
class Verdict:
    """The outcome of a mutation: caught (by which test) or another word, and its duration, s."""

    mutation: Mutation
    word: str
    by: str
    seconds: float

    @property
    def expected(self) -> bool:
        return self.word == ("survived" if self.mutation.survives else "caught")


def mutations() -> list[Mutation]:
    """The list."""
    return [Mutation(**one) for one in tomllib.loads(LIST.read_text(encoding="utf-8"))["mutation"]]


def copied(folder: Path) -> Path:
    """Copy the project with its compiled kernels into a folder; file times stay, so that the kernels are valid."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
        text=True,
    )
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).unlink(missing_ok=True)  # a link is not written over
            shutil.copy2(ROOT / name, folder / name, follow_symlinks=False)
    for path in (ROOT / "mic").rglob("__pycache__/*.nb[ic]"):
        (folder / path.relative_to(ROOT)).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, folder / path.relative_to(ROOT))
    return folder


def judged(mutation: Mutation, folder: Path) -> Verdict:
    """Plant an error in a copy, run its tests, and take it out again."""
    path, original = folder / mutation.file, ROOT / mutation.file
    text = original.read_text(encoding="utf-8")
    if text.count(mutation.right) != 1:
        return Verdict(mutation, "stale", f"{mutation.file} holds it {text.count(mutation.right)} times", 0.0)
    compiled = mutation.file.startswith(("mic/contact/native/", "mic/contact/laws/"))
    path.write_text(text.replace(mutation.right, mutation.wrong), encoding="utf-8")
    start = time.monotonic()
    try:
        word, by = run(folder, mutation.tests)
    finally:
        shutil.copy2(original, path)
        if compiled:  # its cache as well
            copied(folder)
    return Verdict(mutation, word, by, time.monotonic() - start)


def run(folder: Path, tests: Sequence[str], longest: float = LONGEST) -> tuple[str, str]:
    """``caught`` and by which test, ``survived``, or why the tests did not run; `longest`, s."""
    own = os.pathsep.join([str(folder), str(folder / "tests")])
    environment = os.environ | {"PYTHONPATH": own, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, *PYTEST, *tests],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=longest,
        )
    except subprocess.TimeoutExpired:
        return "caught", f"no end within {longest:g} s"
    if done.returncode == 0:
        return "survived", ""
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.M)
    if done.returncode != FAILED or found is None:
        return "broken", (done.stdout + done.stderr)[-300:]
    return "caught", found[1]


def page(entries: Sequence[Mutation]) -> str:
    """The page of the documentation."""
    survivors = [f"- {entry.what} (`{entry.file}`): {entry.survives}" for entry in entries if entry.survives]
    notes = "\n".join(["These survive, for the given reason:", "", *survivors]) if survivors else ALL_CAUGHT
    by_file: dict[str, list[str]] = {}
    for entry in entries:
        by_file.setdefault(entry.file, []).append(f"{entry.what}.")
    rows = "\n".join(f"| `{file}` | {' '.join(errors)} |" for file, errors in by_file.items())
    return PAGE.format(survivors=notes, rows=rows)


def verdicts(chosen: Sequence[Mutation], processes: int, scratch: Path) -> Iterator[Verdict]:
    """The verdicts of mutations, each as soon as it is known."""
    free: SimpleQueue[Path] = SimpleQueue()
    for i in range(processes):
        free.put(copied(scratch / str(i)))

    def one(mutation: Mutation) -> Verdict:
        folder = free.get()
        try:
            return judged(mutation, folder)
        finally:
            free.put(folder)

    with ThreadPoolExecutor(processes) as pool:
        yield from pool.map(one, chosen)


def main(arguments: Sequence[str] | None = None) -> int:
    asked = argparse.ArgumentParser(prog="script/mutate", description="Plant errors and see whether tests catch them.")
    asked.add_argument("words", nargs="*", help="only errors whose description or file holds one of these words")
    asked.add_argument("-n", "--processes", type=int, default=2, help="how many at a time (default 2)")
    options = asked.parse_args(arguments)
    every = mutations()
    chosen = [
        one for one in every if not options.words or any(word in f"{one.what} {one.file}" for word in options.words)
    ]
    if not chosen:
        print(f"script/mutate: nothing in {LIST.name} holds {' or '.join(options.words)}", file=sys.stderr)
        return 2
    console = Console()
    with tempfile.TemporaryDirectory(prefix="mutate-") as scratch:
        clean = copied(Path(scratch) / "clean")
        tests = sorted({test for one in chosen for test in one.tests})
        console.print(f"without an error: {len(tests)} files of tests …", highlight=False)
        every_core = ["-n", str(options.processes), "--dist", "loadfile"]
        word, by = run(clean, [*tests, *every_core], LONGEST * len(tests))
        if word != "survived":
            console.print(f"script/mutate: the tests fail as they stand ({by}); mend that first", highlight=False)
            return 1
        found: list[Verdict] = []
        with Progress(console=console) as progress:
            task = progress.add_task("errors", total=len(chosen))
            for verdict in verdicts(chosen, options.processes, Path(scratch)):
                found.append(verdict)
                progress.advance(task)
                progress.console.print(
                    f"{verdict.word:9}{verdict.seconds:5.0f} s  {verdict.mutation.what}", highlight=False
                )
    table = Table("error", "in", "verdict", "by", title="not as the list has it")
    wrong = [one for one in found if not one.expected]
    for one in wrong:
        table.add_row(one.mutation.what, one.mutation.file, one.word, one.by)
    if wrong:
        console.print(table)
    caught = sum(one.word == "caught" for one in found)
    console.print(f"{caught} of {len(found)} caught, {len(wrong)} not as the list has it", highlight=False)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
