"""Console of the commands: sentences, tables, file names and progress bars.

Text from scenes and files is printed without markup, see :func:`mic.system.console.plain`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from mic.report.style import number
from mic.system.console import plain

__all__ = ["CommandConsole", "interval"]


class CommandConsole(Console):
    """A console with the forms of output that commands share."""

    def say(self, sentence: object, style: str | None = None) -> None:
        """Print one line of text."""
        self.print(plain(sentence), style=style, highlight=False, soft_wrap=True)

    def say_each(self, sentences: Iterable[object]) -> None:
        """Print lines of text."""
        for sentence in sentences:
            self.say(sentence)

    def say_step(self, step: str) -> None:
        """Print the name of a step that begins: ``influence coefficients of lower …``."""
        self.say(f"{step} …")

    def warn(self, label: str, sentence: object) -> None:
        """Print one line of text after a yellow label: ``warning: …``."""
        self.print(f"[yellow]{label}:[/] {plain(sentence)}", highlight=False, soft_wrap=True)

    def say_files(self, **files: Path | str) -> None:
        """Print which files were written: ``report: …   tables: …``."""
        text = "   ".join(f"{kind}: [bold]{plain(file)}[/]" for kind, file in files.items())
        self.print(text, highlight=False, soft_wrap=True)

    def table(self, title: str, columns: Sequence[str | Column], rows: Iterable[Sequence[object]]) -> None:
        """Print a table; an empty row is a separator line. Without rows nothing is printed."""
        table = Table(*columns, title=title)
        for row in rows:
            if row:
                table.add_row(*map(plain, row))
            else:
                table.add_section()
        if table.row_count:
            self.print(table)

    @contextmanager
    def progress_bar(self, description: str, total: int | None) -> Iterator[Callable[[int], None]]:
        """Show a progress bar; call the value of the context with the number of evaluations just done."""
        with Progress(console=self) as progress:
            task = progress.add_task(description, total=total)
            yield lambda count: progress.advance(task, count)


def interval(row: Mapping[Any, Any], name: str, scale: float = 1e3, digits: int = 2) -> str:
    """A value of a table with its interval: ``1.2 (0.9 … 1.5)``; mm in µm unless `scale` is given."""
    value, low, high = (number(scale * row[f"{name}{end}"], digits) for end in ("", "_low", "_high"))
    return f"{value} ({low} … {high})"
