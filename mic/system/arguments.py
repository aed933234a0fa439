"""Check the arguments of public functions: each problem is one sentence that names the argument.

Arguments of one name mean the same in all functions (`model`, `law`, `samples` …), so that the rules are stated once,
here; :func:`checked` applies them by name. What depends on the scene, such as the name of a key characteristic, is
checked by the function itself.
"""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, NoReturn, ParamSpec, TypeVar

import numpy as np

from mic.errors import ArgumentError
from mic.system.progress_bar import ProgressBar

__all__ = ["LARGEST", "checked", "did_you_mean", "number", "numbers_by_name", "real_array"]

P = ParamSpec("P")
T = TypeVar("T")

LARGEST = 1e15  # of a number, in any unit: no quantity of an assembly is larger, and squares of larger ones overflow


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """Decorator that checks the arguments of a public function by their names; None passes where it is the default.

    A function that reports its evaluations to a callable `progress` takes True or False instead, which shows or hides a
    bar; by default notebooks and interactive sessions show it after a second.

    The function raises :class:`mic.errors.ArgumentError` for an argument that it cannot use.
    """
    parameters = inspect.signature(function).parameters
    rules = {name: _RULES[name] for name in parameters if name in _RULES}
    assert rules, f"{function.__qualname__} has no argument with a rule"
    reports = "progress" in parameters and callable(parameters["progress"].default)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        given: dict[str, Any] = dict(zip(parameters, args)) | kwargs
        for name, value in given.items():
            if name in rules and not (value is None and parameters[name].default is None):
                rules[name](name, value)
        progress = given.get("progress")
        if not reports or callable(progress):
            return function(*args, **kwargs)
        with ProgressBar(progress) as bar:
            return function(**given | {"progress": bar.advance})  # type: ignore[call-arg]

    return call


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The known name that is most similar in any case, as a question; or all known names."""
    plain = {one.casefold(): one for one in known}
    near = difflib.get_close_matches(str(name).casefold(), plain, 1)
    return f"did you mean {plain[near[0]]!r}?" if near else f"known: {', '.join(plain.values()) or 'none'}"


def number(name: str, value: Any, above: float = -math.inf, least: float = -math.inf) -> float:
    """A finite number.

    Parameters
    ----------
    name : str
        Of the argument.
    value
    above, least : float
        Bounds: larger than `above`, and not less than `least`.

    Raises
    ------
    ArgumentError
    """
    bound = f" above {above:g}" if above > -math.inf else f" of at least {least:g}" if least > -math.inf else ""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        _refuse(name, value, f"a number{bound}")
    size: Any = abs(value)
    if LARGEST < size < math.inf:
        _refuse(name, value, f"a number of at most {LARGEST:g}")
    if not size <= LARGEST or float(value) <= above or float(value) < least:
        _refuse(name, value, f"a finite number{bound}")
    return float(value)


def numbers_by_name(name: str, value: Any, unknown: bool = False) -> dict[str, float]:
    """Numbers by name.

    Parameters
    ----------
    name : str
        Of the argument.
    value
    unknown : bool
        Whether NaN is allowed, for a number that is unknown.

    Raises
    ------
    ArgumentError
    """
    if not hasattr(value, "items"):
        _refuse(name, value, "numbers by name, such as {'F1': 0.5}")
    entries = dict(value.items())
    for key in entries:
        if not isinstance(key, str):
            _refuse(name, key, "names as text")
    missing = {key for key, own in entries.items() if unknown and isinstance(own, Real) and own != own}
    return {key: math.nan if key in missing else number(f"{name}: {key!r}", own) for key, own in entries.items()}


def real_array(name: str, value: Any) -> np.ndarray:
    """An array of real numbers of any shape, as floats; they may be infinite or NaN.

    Raises
    ------
    ArgumentError
        For text, complex numbers, truth values, dates, other objects, and rows of different lengths.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise ArgumentError(f"{name}: the rows differ in length; give an array of numbers") from None
    if array.dtype == object and all(isinstance(one, Real) and not isinstance(one, bool) for one in array.ravel()):
        array = array.astype(float)
    if array.dtype.kind not in "iuf":
        wrong = [one for one in array.ravel().tolist() if isinstance(one, bool) or not isinstance(one, Real)]
        if array.ndim and wrong:
            _refuse(f"{name}: one value", wrong[0], "numbers")
        _refuse(name, value, "numbers")
    return array.astype(float, copy=False)


def _refuse(name: str, value: Any, expected: str) -> NoReturn:
    shown = repr(value) if isinstance(value, (str, bytes, Real, type(None))) else f"a {type(value).__name__}"
    raise ArgumentError(f"{name} is {shown if len(shown) <= 60 else shown[:60] + '…'}; give {expected}")


def _instance(expected: str, *names: str) -> Callable[[str, Any], None]:
    """Rule: an instance of a class of these names, which belong to higher layers."""

    def rule(name: str, value: Any) -> None:
        if not any(own.__name__ in names for own in type(value).__mro__):
            _refuse(name, value, expected)

    return rule


def _whole(least: int, most: int) -> Callable[[str, Any], None]:
    def rule(name: str, value: Any) -> None:
        if isinstance(value, (bool, np.bool_)) or not isinstance(value, Integral) or not least <= int(value) <= most:
            _refuse(name, value, f"a whole number from {least} to {most}")

    return rule


def _texts(name: str, value: Any) -> None:
    if isinstance(value, (str, bytes)) or not isinstance(value, (Sequence, set, frozenset, np.ndarray)):
        _refuse(name, value, "a list of names")
    for one in value:
        if not isinstance(one, str):
            _refuse(name, one, "a list of names")


def _law(name: str, value: Any) -> None:
    if not value or not (isinstance(value, str) or any(own.__name__ == "Law" for own in type(value).__mro__)):
        _refuse(name, value, "the name of a contact law, such as 'coulomb'")


def _flag(name: str, value: Any) -> None:
    if not isinstance(value, (bool, np.bool_)):
        _refuse(name, value, "True or False")


def _progress(name: str, value: Any) -> None:
    if not callable(value) and not hasattr(value, "sampling") and not isinstance(value, bool | None):
        _refuse(name, value, "True or False, or a function of the number of new evaluations")


def _path(name: str, value: Any) -> None:
    if not isinstance(value, (str, os.PathLike)) or "\0" in os.fspath(value) or not os.fspath(value):
        _refuse(name, value, "a path")


def _paths(name: str, value: Any) -> None:
    if not isinstance(value, (Sequence, set, frozenset)) or isinstance(value, (str, bytes)):
        _refuse(name, value, "a list of paths")
    for one in value:
        _path(name, one)


def _gauge(name: str, value: Any) -> None:
    if hasattr(value, "items"):
        numbers_by_name(name, value)
    else:
        number(name, value, above=0.0)


def _parts(name: str, value: Any) -> None:
    frame = hasattr(value, "to_dict") and hasattr(value, "columns")
    if isinstance(value, (str, bytes, Mapping)) or not (frame or isinstance(value, Sequence)):
        _refuse(name, value, "a table, or a list with numbers by name for each assembly")


def _orders(name: str, value: Any) -> None:
    if not isinstance(value, Sequence):
        _refuse(name, value, "a list of orders, as mic.studies.order.orders(scene) returns it")
    for one in value:
        _instance("orders, as mic.studies.order.orders(scene) returns them", "Order")(name, one)


def _above(bound: float) -> Callable[[str, Any], Any]:
    return lambda name, value: number(name, value, above=bound)


_MODEL = "a model, as mic.reduce(scene) or mic.ReducedModel.load(path) returns it"
_SIDE = _instance(f"{_MODEL}, or a run, as mic.read_run(folder) returns it", "ReducedModel", "RunSamples")
_RULES: dict[str, Callable[[str, Any], Any]] = {
    "model": _instance(_MODEL, "ReducedModel"),
    "a": _SIDE,
    "b": _SIDE,
    "scene": _instance("a scene, as mic.load_scene(path) returns it", "Scene"),
    "law": _law,
    "laws": _texts,
    "names": _texts,
    "adjust": _texts,
    **dict.fromkeys(("samples", "fresh", "budget"), _whole(1, 10**8)),
    "threads": _whole(1, 10**4),
    "seed": _whole(0, 2**63 - 1),
    "shim": _above(0.0),
    "factor": _above(1.0),
    "friction": _above(0.0),
    "capability": _above(0.0),
    "error": lambda name, value: number(name, value, least=0.0),
    "measured": numbers_by_name,
    "gauge": _gauge,
    "parts": _parts,
    "others": _orders,
    "progress": _progress,
    **dict.fromkeys(("exact", "replace", "strict"), _flag),
    **dict.fromkeys(("path", "folder", "out", "cache", "ledger", "welds", "points"), _path),
    "files": _paths,
}
