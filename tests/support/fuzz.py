"""Attack the program at random for some minutes: files, scenes, contact problems and the page of ``mic explore``.

``script/fuzz`` runs it. Each module ``attack_*`` has a function ``attack(rng, folder)``: a round of seconds, which
returns a line for each failure.
"""

from __future__ import annotations

import argparse
import sys
import time
from importlib import import_module
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console

ATTACKS = sorted(path.stem.removeprefix("attack_") for path in Path(__file__).parent.glob("attack_*.py"))


def fuzz(minutes: float, seed: int, attacks: list[str], console: Console) -> int:
    """Number of failures of rounds of the named attacks, in turn, until the time is over."""
    started, found = time.monotonic(), 0
    for number, name in enumerate(cycle(attacks)):
        elapsed = (time.monotonic() - started) / 60
        if number >= len(attacks) and elapsed > minutes:  # each attack at least once
            break
        attack, rng = import_module(f"support.attack_{name}").attack, np.random.default_rng([seed, number])
        with TemporaryDirectory(prefix="mic-fuzz-") as folder, console.status(f"{elapsed:.1f} min: {name}"):
            failures = attack(rng, Path(folder))
        for line in failures:
            console.print(f"{name}, seed {seed}, round {number}: {line}", markup=False, highlight=False)
        found += len(failures)
    console.print(f"{number} rounds with seed {seed}: {found} failures")
    return found


def _main() -> int:
    parser = argparse.ArgumentParser(prog="script/fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="time of the attacks (default: 10)")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="of the random numbers (default: the time)")
    parser.add_argument("attacks", nargs="*", metavar="ATTACK", help=f"some of {', '.join(ATTACKS)} (default: all)")
    given = parser.parse_args()
    if unknown := set(given.attacks) - set(ATTACKS):
        parser.error(f"there is no attack {', '.join(sorted(unknown))}; known: {', '.join(ATTACKS)}")
    return 1 if fuzz(given.minutes, given.seed, given.attacks or ATTACKS, Console()) else 0


if __name__ == "__main__":
    sys.exit(_main())
