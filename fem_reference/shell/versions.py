"""The supported dolfinx versions.

`fem_reference.shell.compat` holds the calls that differ between them. The tests of finite elements pass with the
versions in `TRIED`. Every other version is refused.

The module imports only the standard library, so that it can run before anything is installed:
``python3 -I fem_reference/shell/versions.py`` ends with exit code 0 if the interpreter's dolfinx is supported, and
otherwise says what to do.
"""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, packages_distributions, version

__all__ = ["TRIED", "UnsupportedVersion", "installed", "supported"]

TRIED = {
    (0, 5): "Debian 12",
    (0, 9): "Debian 13",
    (0, 10): "Ubuntu 26.04",
    (0, 11): "wheel dolfinx-solver-real, Debian unstable",
}
REMEDY = "apt-get install python3-dolfinx (Debian), or pip install dolfinx-solver-real (Linux, Python 3.12 or later)"


class UnsupportedVersion(ImportError):
    """dolfinx is missing or its version is not supported."""


def supported(text: str) -> tuple[int, int]:
    """Major and minor number of a version such as ``"0.11.0.post0"``.

    Raises
    ------
    UnsupportedVersion
        If it is not in `TRIED`.
    """
    major, minor = (int(part) for part in text.split(".")[:2])
    if (major, minor) in TRIED:
        return major, minor
    names = [f"{a}.{b} ({where})" for (a, b), where in TRIED.items()]
    raise UnsupportedVersion(f"dolfinx {text} is not supported; install one of {', '.join(names)}: {REMEDY}")


def installed() -> str | None:
    """Version of the installed dolfinx, found without importing it; None if there is none.

    A wheel may have any name (dolfinx-solver-real); the package of Debian has the usual one, and lists no files.
    """
    for name in ("fenics-dolfinx", *packages_distributions().get("dolfinx", ())):
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return None


def main() -> int:
    found = installed()
    try:
        if found is not None:
            supported(found)
            return 0
        print(f"dolfinx is not installed; {REMEDY}", file=sys.stderr)
    except UnsupportedVersion as problem:
        print(problem, file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
