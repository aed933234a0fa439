"""What is said on the console: a user's text as it stands, and an error in one line."""

from __future__ import annotations

import re

from rich.console import Console
from rich.markup import escape

__all__ = ["plain", "sentence"]


def plain(text):
    """Text of a user's as it stands: no markup, and none of the characters by which a terminal is controlled."""
    return escape(re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", "\N{REPLACEMENT CHARACTER}", str(text)))


def sentence(error):
    """An error as the console shows it."""
    console = Console(stderr=True)
    with console.capture() as capture:
        console.print(f"[bold red]error:[/] {plain(error)}", highlight=False, soft_wrap=True)
    return capture.get()
