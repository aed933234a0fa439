"""Text for the console: user text without markup, errors on one line, lengths in µm."""

from __future__ import annotations

import re
from decimal import Decimal

from rich.console import Console
from rich.markup import escape

__all__ = ["error_line", "micrometres", "plain"]


def plain(text):
    """Text of the user, its markup escaped and its terminal control characters replaced."""
    return escape(re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", "\N{REPLACEMENT CHARACTER}", str(text)))


def error_line(error):
    """An error as the console shows it."""
    console = Console(stderr=True, emoji=False)  # :-1: is a number
    with console.capture() as capture:
        console.print(f"[bold red]error:[/] {plain(error)}", highlight=False, soft_wrap=True)
    return capture.get()


def micrometres(length: float, digits: int = 3) -> str:
    """A length, mm, as text in µm, rounded to so many digits, without an exponent."""
    return f"{Decimal(f'{1e3 * length:.{digits - 1}e}').normalize():f} µm"
