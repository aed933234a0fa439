"""Console of the commands: sentences, tables, file names and progress bars.

Text from scenes and files is printed without markup, see :func:`mic.system.console.plain`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from mic.report.style import number
from mic.system.console import plain

__all__ = ["CommandConsole", "interval"]

LONG_WORD = 24  # characters: longer words of cells may be broken
SHORT_HEAD = 8  # characters: such a heading stays on one line if there is room


class CommandConsole(Console):
    """A console with the forms of output that commands share."""

    def __init__(self, **options: Any) -> None:
        super().__init__(emoji=False, **options)

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

    def warn(self, label: str, sentence: object, style: str = "yellow") -> None:
        """Print one line of text after a coloured label: ``warning: …``."""
        self.print(f"[{style}]{label}:[/] {plain(sentence)}", highlight=False, soft_wrap=True)

    def say_files(self, **files: Path | str) -> None:
        """Print which files were written: ``report: …   tables: …``."""
        text = "   ".join(f"{kind}: [bold]{plain(file)}[/]" for kind, file in files.items())
        self.print(text, highlight=False, soft_wrap=True)

    def table(self, title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Print a table; an empty row is a separator line. Without rows nothing is printed, nor are empty columns.

        No heading is cut: texts fold between words, and a table that is wider than the console is printed as a list.
        """
        cells = [[str(cell) for cell in row] for row in rows]
        shown = [j for j in range(len(columns)) if any(row[j] for row in cells if row)]
        if not shown:
            return
        heads, cells = [columns[j] for j in shown], [[row[j] for j in shown] if row else [] for row in cells]
        widths = _column_widths(heads, [row for row in cells if row], self.width - 3 * len(heads) - 1)
        if widths is None:
            self.print(plain(title), style="bold", highlight=False)
            for row in filter(None, cells):
                self.say("; ".join(f"{head}: {cell}" for head, cell in zip(heads, row) if cell).replace("\n", ", "))
            return
        table = Table(*(Column(plain(head), width=w, overflow="fold") for head, w in zip(heads, widths)), title=title)
        for row in cells:
            if row:
                table.add_row(*map(plain, row))
            else:
                table.add_section()
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


def _column_widths(heads: Sequence[str], rows: Sequence[Sequence[str]], room: int) -> list[int] | None:
    """Widths of columns that together fit into a room and cut no word of a heading; None if there are none."""
    columns = list(zip(heads, *rows))
    natural = [max(cell_len(line) for cell in column for line in cell.split("\n")) for column in columns]
    for whole in (SHORT_HEAD, 0):  # characters: shorter headings stay on one line
        least = []
        for head, *cells in columns:
            words = [head] if len(head) <= whole else head.split()
            longest = max((cell_len(word) for cell in cells for word in cell.split()), default=0)
            least.append(max(min(longest, LONG_WORD), *map(cell_len, words), 1))
        left, wanted = room - sum(least), [most - few for most, few in zip(natural, least)]
        if left >= 0:
            return [few + min(more, left * more // max(sum(wanted), 1)) for few, more in zip(least, wanted)]
    return None
