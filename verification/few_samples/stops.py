"""Stored samples of the example scenes: statistics of all, and the stop of many short runs on disjoint ones of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mic import examples
from mic.scene import load_scene
from mic.statistics import draw, estimates
from mic.statistics.control_variate import FOLDS, surrogate_estimates
from verification.few_samples.capture import FOLDER, SEED

__all__ = ["LOOKS", "SCENES", "Samples", "Stop", "further", "load", "stop"]

SCENES = ("lap_joint", "wheelhouse", "bracket", "hat_on_plate")
LOOKS = (50, 100, 150, 200, 300, 400, 550, 750, 1000)  # samples at which a run checks its accuracy
FURTHER = 8  # samples in one step for each followed one, besides its own
POINTS = 8192


@dataclass(frozen=True)
class Samples:
    """Samples of a scene.

    Attributes
    ----------
    names : list of str
    x : (N, p) array
    followed, one_step : (N, k) array
    milliseconds : (2,) array
        Processor time per followed sample and per sample in one step.
    population : (F, M, p) array
    """

    names: list[str]
    x: np.ndarray
    followed: np.ndarray
    one_step: np.ndarray
    milliseconds: np.ndarray
    population: np.ndarray

    def truth(self) -> tuple[np.ndarray, np.ndarray]:
        """(k,) σ from all samples and its relative standard error: surrogates, whose mean error all samples show."""
        found = surrogate_estimates(self.x, self.followed, self.population).sigma(0.68)
        return found.value, np.log(found.high / found.low) / 2

    def plain(self, accuracy: float) -> np.ndarray:
        """(k,) plain samples for an interval of 6σ of this relative half-width, by the kurtosis of all samples."""
        z = (self.followed - self.followed.mean(axis=0)) / self.followed.std(axis=0)
        return (1.96 / accuracy) ** 2 * ((z**4).mean(axis=0) - 1) / 4


def load(name: str) -> Samples:
    """The stored samples of a scene; those that failed are left out."""
    scene = load_scene(examples.folder(name))
    with np.load(FOLDER / f"{name}.npz") as file:
        followed, one_step, milliseconds = (file[key].astype(float) for key in ("followed", "one_step", "milliseconds"))
    x = draw.draw(scene, SEED, 0, len(followed))
    valid = np.isfinite(followed).all(axis=1) & np.isfinite(one_step).all(axis=1)
    names = [item.name for item in scene.measurements]
    population = draw.population(scene, SEED + 1, FOLDS, POINTS)
    return Samples(names, x[valid], followed[valid], one_step[valid], milliseconds, population)


@dataclass(frozen=True)
class Stop:
    """End of a run of one output.

    Attributes
    ----------
    samples : (k,) array
        Followed samples; NaN if the accuracy was not reached.
    needed : (k,) array
        As many, or an estimate from the width at the last look, which falls with the root of the samples.
    half : (k,) array
        Relative half-width there.
    value, low, high : (k,) array
        The estimate with its interval.
    seconds : (k,) array
        Processor time of the estimates until then.
    """

    samples: np.ndarray
    needed: np.ndarray
    half: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    seconds: np.ndarray


def stop(estimate: Callable[[int], estimates.Estimate], accuracy: float, looks=LOOKS) -> Stop:
    """Look at ever more samples until the relative half-width of each output is at most the accuracy.

    Parameters
    ----------
    estimate : callable
        Estimates of k positive quantities from so many samples.
    accuracy : float
    looks : sequence of int
    """
    found: Stop | None = None
    seconds = 0.0
    for count in looks:
        start = time.process_time()
        now = estimate(count)
        seconds += time.process_time() - start
        half = (now.high - now.low) / (2 * now.value)
        reached = half <= accuracy
        needed = count * np.maximum(1.0, half / accuracy) ** 2
        state = Stop(
            np.where(reached, count, np.nan), needed, half, now.value, now.low, now.high, np.full(len(half), seconds)
        )
        if found is None:
            found = state
        else:
            done = np.isfinite(found.samples)
            found = Stop(*(np.where(done, mine, its) for mine, its in zip(vars(found).values(), vars(state).values())))
        if np.isfinite(found.samples).all():
            break
    assert found is not None
    return found


def further(stream: np.random.Generator, own: np.ndarray, total: int) -> np.ndarray:
    """Indices of samples in one step for a run: its own ones, and :data:`FURTHER` others for each at random."""
    others = np.setdiff1d(np.arange(total), own)
    return np.concatenate([own, stream.permutation(others)[: FURTHER * len(own)]])


def example_run(samples: Samples, number: int, looks, accuracy: float = 0.01) -> Stop:
    """A run on disjoint samples of a scene that stops for each characteristic at this accuracy of 6σ."""
    own = np.arange(number * looks[-1], (number + 1) * looks[-1])
    every = further(np.random.default_rng([44, number]), own, len(samples.x))

    def estimate(count: int) -> estimates.Estimate:
        i, more = own[:count], every[len(own) :][: FURTHER * count]
        j = np.concatenate([i, more])
        cheap = samples.x[j], samples.one_step[j]
        found = surrogate_estimates(samples.x[i], samples.followed[i], samples.population, cheap)
        return found.six_sigma()

    return stop(estimate, accuracy, looks)
