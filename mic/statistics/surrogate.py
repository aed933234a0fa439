"""Surrogates of a model from few evaluated samples, each with its leave-one-out errors.

A surrogate is chosen by output: the one with the least leave-one-out errors, of the mean, a linear and a quadratic
function (least squares), and a smoothing spline (:class:`mic.statistics.emulator.Emulator`). It is limited to three
times the range of the samples, since quadratic functions and splines of few samples go far astray in the tails.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mic.statistics.emulator import Emulator

__all__ = ["Surrogate", "best_surrogate"]

MARGIN = 5  # samples beyond the number of coefficients of a linear function or spline
SHARE = 1.5  # samples per coefficient of a quadratic function
SPLINE = 300  # samples of a spline, at most: the first ones


class Surrogate(NamedTuple):
    """A function that approximates k outputs.

    Attributes
    ----------
    kind : list of str
        By output: ``"plain"`` (the mean), ``"linear"``, ``"quadratic"`` or ``"spline"``.
    predict : callable
        Takes inputs (m, p), returns outputs (m, k).
    """

    kind: list[str]
    predict: Callable[[np.ndarray], np.ndarray]


def best_surrogate(x: np.ndarray, y: np.ndarray) -> Surrogate:
    """The surrogate of each output with the least leave-one-out errors.

    Parameters
    ----------
    x : (n, p) array
        Inputs, in standard deviations.
    y : (n, k) array
        Outputs.
    """
    n, p = x.shape
    candidates = {"plain": _least_squares(_constant, x, y)}
    if n > p + MARGIN:
        candidates["linear"] = _least_squares(linear_functions, x, y)
        candidates["spline"] = _spline(x[:SPLINE], y[:SPLINE])
    if n >= SHARE * (1 + p + p * (p + 1) // 2):
        candidates["quadratic"] = _least_squares(_quadratic, x, y)
    names = list(candidates)
    chosen = np.argmin([candidates[name][0] for name in names], axis=0).tolist()
    least, most = y.min(axis=0), y.max(axis=0)
    reach = most - least

    def predict(x: np.ndarray) -> np.ndarray:
        values = {i: candidates[names[i]][1](x) for i in set(chosen)}
        y = np.column_stack([values[i][:, k] for k, i in enumerate(chosen)])
        return np.clip(y, least - reach, most + reach)

    return Surrogate([names[i] for i in chosen], predict)


def linear_functions(x: np.ndarray) -> np.ndarray:
    """(n, 1 + p): 1 and the inputs (n, p)."""
    return np.column_stack([np.ones(len(x)), x])


def _constant(x: np.ndarray) -> np.ndarray:
    return np.ones((len(x), 1))


def _quadratic(x: np.ndarray) -> np.ndarray:
    i, j = np.triu_indices(x.shape[1])
    return np.column_stack([linear_functions(x), x[:, i] * x[:, j]])


def _least_squares(functions, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, Callable]:
    """Mean squares of the leave-one-out errors ``r_i / (1 - q_i q_i')`` with the rows q of Q, and the prediction."""
    Q, R = np.linalg.qr(functions(x))
    projected = Q.T @ y
    coefficients = np.linalg.lstsq(R, projected, rcond=None)[0]
    errors = (y - Q @ projected) / np.maximum(1 - (Q**2).sum(axis=1), 1e-3)[:, None]
    return (errors**2).mean(axis=0), lambda x: functions(x) @ coefficients


def _spline(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, Callable]:
    emulator = Emulator(x, y)
    return (emulator.leave_one_out()[0] ** 2).mean(axis=0), emulator
