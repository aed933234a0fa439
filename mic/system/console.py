"""Text for the console: user text without markup, and errors on one line."""

from __future__ import annotations

import re

from rich.console import Console
from rich.markup import escape

__all__ = ["error_line", "plain"]


def plain(text):
    """Text of the user, its markup escaped and its terminal control characters replaced."""
    return escape(re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", "\N{REPLACEMENT CHARACTER}", str(text)))


def error_line(error):
    """An error as the console shows it."""
    console = Console(stderr=True, emoji=False)  # :-1: is a number
    with console.capture() as capture:
        console.print(f"[bold red]error:[/] {plain(error)}", highlight=False, soft_wrap=True)
    return capture.get()
