"""Print an HTML report as PDF with a headless browser."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

__all__ = ["NoBrowser", "browser", "write_pdf"]

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
LONGEST = 180.0  # s, time limit of printing


class NoBrowser(FileNotFoundError):
    """No browser is installed, or it does not print."""


def browser() -> str:
    """Path of an installed browser.

    Raises
    ------
    NoBrowser
    """
    for name in BROWSERS:
        found = shutil.which(name)
        if found:
            return found
    raise NoBrowser(
        "--pdf: no chromium or chrome is installed; install one (Debian: apt install chromium), or omit --pdf and "
        "print report.html from any browser"
    )


def write_pdf(page: Path) -> Path:
    """Print an HTML page into a PDF file beside it.

    Raises
    ------
    NoBrowser
        If no browser is installed, or it does not print.
    """
    page = Path(page).resolve()
    target = page.with_suffix(".pdf")
    temporary = target.with_name(f".{target.name}")
    temporary.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as profile:
        command = [browser(), "--headless", "--disable-gpu", "--no-pdf-header-footer", f"--user-data-dir={profile}"]
        if os.geteuid() == 0:
            command.append("--no-sandbox")  # required as root; the page has no scripts
        command += [f"--print-to-pdf={temporary}", page.as_uri()]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST)
            said = done.stderr.strip().splitlines()[-1:] or ["no message"]
        except subprocess.TimeoutExpired:
            said = [f"no result after {LONGEST:g} s"]
    if not temporary.is_file():
        raise NoBrowser(f"--pdf: {command[0]} did not print {page.name}: {said[0]}; print it from any browser")
    temporary.replace(target)
    return target
