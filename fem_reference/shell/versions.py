"""The dolfinx versions that the finite-element reference takes: the one place that names them.

`fem_reference.shell.compat` holds the calls in which they differ. The tests pass with the versions in `TRIED`; those in
`READ` were only followed in dolfinx's documentation and have not been run. Every other version is refused.

The module needs nothing but the standard library, so that it can be asked before anything is installed:
``python3 -I fem_reference/shell/versions.py`` says whether the interpreter's dolfinx is among them (exit code 0), or
what to do.
"""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, version

__all__ = ["READ", "TRIED", "UnsupportedVersion", "supported"]

TRIED = {(0, 5): "Debian 12", (0, 9): "Debian 13", (0, 11): "Debian unstable"}
READ = ((0, 10),)


class UnsupportedVersion(ImportError):
    """dolfinx is missing, or of a version that the finite-element reference does not take."""


def supported(text: str) -> tuple[int, int]:
    """Major and minor number of a version such as ``"0.11.0.post0"``.

    Raises
    ------
    UnsupportedVersion
        If it is neither in `TRIED` nor in `READ`.
    """
    major, minor = (int(part) for part in text.split(".")[:2])
    if (major, minor) in TRIED or (major, minor) in READ:
        return major, minor
    known = sorted([*TRIED, *READ])
    names = [f"{a}.{b}" + (f" ({TRIED[a, b]})" if (a, b) in TRIED else "") for a, b in known]
    raise UnsupportedVersion(
        f"dolfinx {text} is not supported; install one of {', '.join(names)}, on Debian with: "
        "apt-get install python3-dolfinx"
    )


def main() -> int:
    try:
        supported(version("fenics-dolfinx"))
    except PackageNotFoundError:
        print("dolfinx is not installed; on Debian: apt-get install python3-dolfinx", file=sys.stderr)
    except UnsupportedVersion as problem:
        print(problem, file=sys.stderr)
    else:
        return 0
    return 1


if __name__ == "__main__":
    sys.exit(main())
