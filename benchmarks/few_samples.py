"""Processor time of 6σ to ±1 %, by surrogates and samples in one step against plain sampling, on stored samples.

    python benchmarks/few_samples.py [SCENE ...] [--sets 100]

Runs on disjoint sets of the stored samples (``python -m verification.few_samples.capture``) look at 50, 100, 150 …
followed samples, each time with eight further ones in one step for each, until the 95 % interval of 6σ of a key
characteristic is within ±1 %. The time is that of the samples and of all estimates until then. Plain sampling takes as
many followed samples as the kurtosis of all stored ones demands. The truth is 6σ of all stored samples, corrected by a
surrogate; its standard error is printed. Runs that do not reach ±1 % with their samples count with the number that
their interval predicts.
"""

from __future__ import annotations

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from verification.few_samples.stops import FURTHER, LOOKS, SCENES, example_run, load

COLUMNS = ("", "runs", "samples", "reached", "hold the truth", "rms error", "CPU s", "plain", "plain / this")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--accuracy", type=float, default=0.01)
    options = parser.parse_args()
    console, ratios, held = Console(width=130), [], []
    for name in options.scenes:
        samples = load(name)
        sigma, error = samples.truth()
        most = next(count for count in reversed(LOOKS) if count <= min(400, len(samples.x) // 5))
        looks = [count for count in LOOKS if count <= most]
        sets = min(options.sets, len(samples.x) // most)
        with threadpool_limits(1):
            runs = [example_run(samples, number, looks, options.accuracy) for number in range(sets)]
        needed, low, high, value, seconds = (
            np.array([getattr(one, key) for one in runs]) for key in ("needed", "low", "high", "value", "seconds")
        )
        followed, one_step = samples.milliseconds / 1e3
        cost = (needed * (followed + (1 + FURTHER) * one_step) + seconds).mean(axis=0)
        plain = samples.plain(options.accuracy) * followed
        holds = (low <= 6 * sigma) & (6 * sigma <= high)
        table = Table(*COLUMNS, title=f"{name}: {len(samples.x)} samples, {1e3 * followed:.1f} and {1e3 * one_step:.2f}"
                      f" ms; standard error of the truth at most {error.max():.2%}")  # fmt: skip
        for k, characteristic in enumerate(samples.names):
            rms = np.sqrt(((value[:, k] / (6 * sigma[k]) - 1) ** 2).mean())
            table.add_row(
                characteristic, str(sets), f"{np.median(needed[:, k]):.0f} ({needed[:, k].max():.0f})",
                f"{(needed[:, k] <= most).mean():.0%}", f"{holds[:, k].mean():.3f}", f"{rms:.2%}", f"{cost[k]:.2f}",
                f"{plain[k]:.0f}", f"{plain[k] / cost[k]:.0f}",
            )  # fmt: skip
        console.print(table)
        ratios += list(plain / cost)
        held += list(holds.ravel())
    console.print(f"plain / this: median {np.median(ratios):.0f} (goal 15), worst {min(ratios):.1f} (goal 4); the "
                  f"interval holds the truth in {np.mean(held):.1%} of {len(held)} (goal 95 %)")  # fmt: skip


if __name__ == "__main__":
    main()
