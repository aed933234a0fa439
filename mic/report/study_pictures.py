"""Pictures of the results of public functions: the same ones that the page of each command shows.

>>> found = mic.sensitivity(model)                                                    # doctest: +SKIP
>>> (picture,) = mic.report.pictures(found)                                           # doctest: +SKIP

Pictures that a run's report shows as well are listed in :mod:`mic.report.picture_registry`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import matplotlib.style
import pandas as pd

from mic.report.assembly_pictures import explored, predicted
from mic.report.change_pictures import change_picture, order_picture, remedy_picture, search_trail
from mic.report.comparison_page import comparison_pictures
from mic.report.context import read_context
from mic.report.driver_pictures import contributor_picture, friction_effect_picture, sensitivity_picture
from mic.report.explanation_page import explanation_pictures
from mic.report.miss_pictures import likeliest_miss_picture, miss_picture
from mic.report.picture import Picture
from mic.report.picture_registry import draw_all
from mic.report.style import RC
from mic.results.outcome import Outcome
from mic.results.schema import FRICTION_EFFECTS, ORDERS, PREDICTIONS, Table
from mic.scene import Scene
from mic.studies.comparison import Comparison
from mic.studies.contributors import Contributors
from mic.studies.explanation import Explanation
from mic.studies.exploration import ExploredAssembly
from mic.studies.optimisation import Optimum
from mic.studies.rare import RareFailures
from mic.studies.remedy import Remedies
from mic.studies.sensitivity import Effects

__all__ = ["STUDIES", "StudyPictures", "pictures"]


@dataclass(frozen=True)
class StudyPictures:
    """The pictures of a command's result.

    Attributes
    ----------
    command : str
        Name of the command and of the public function.
    returns : type or Table
        What the function returns: a class, or the table of a DataFrame.
    words : str
        Content of the pictures.
    draw : callable
        ``draw(result, scene)`` → pictures; None for a picture without data.
    """

    command: str
    returns: type | Table
    words: str
    draw: Callable[[Any, Scene | None], Iterable[Picture | None]]

    def takes(self, found: Any) -> bool:
        """Whether the object is a result of the command."""
        if isinstance(self.returns, type):
            return isinstance(found, self.returns)
        return isinstance(found, pd.DataFrame) and set(self.returns.names) <= set(found.columns)


#: Pictures by command.
STUDIES: list[StudyPictures] = []


def _study(command: str, returns: type | Table, words: str) -> Callable[[Callable[..., Any]], None]:
    """Decorator that adds a function to :data:`STUDIES`."""
    return lambda draw: STUDIES.append(StudyPictures(command, returns, words, draw))


@_study("run", Outcome, "all pictures of its report")
def _(found, scene):
    return draw_all(found, read_context(found)).values()


@_study("compare", Comparison, "changes with their intervals; distributions before and after")
def _(found, scene):
    return comparison_pictures(found)


@_study("contributors", Contributors, "shares of the variance, alone and with interactions")
def _(found, scene):
    return [contributor_picture(found.table, found.linearity)]


@_study("explain", Explanation, "sources before and after the measurement; predicted characteristics")
def _(found, scene):
    return explanation_pictures(found)


@_study("explore", ExploredAssembly, "contact states, key characteristics against their limits")
def _(found, scene):
    return [explored(found)]


@_study("friction", FRICTION_EFFECTS, "changes of mean and 6σ with the friction")
def _(found, scene):
    return [friction_effect_picture(found)]


@_study("optimise", Optimum, "changes with their intervals; the search")
def _(found, scene):
    return [change_picture(found.table), search_trail(found.trail, found.objective)]


@_study("order", ORDERS, "largest changes of mean and 6σ by order")
def _(found, scene):
    return [order_picture(found)]


@_study("predict", PREDICTIONS, "predictions of each assembly, by verdict")
def _(found, scene):
    return [predicted(found, scene)]


@_study("rare", RareFailures, "probabilities of a miss; the most likely misses")
def _(found, scene):
    return [miss_picture(found.table), likeliest_miss_picture(found.points)]


@_study("remedy", Remedies, "mean and 6σ without and with each remedy")
def _(found, scene):
    return [remedy_picture(found.effects, scene)]


@_study("sensitivity", Effects, "effect of a step of each input")
def _(found, scene):
    return [sensitivity_picture(found.table)]


def pictures(found: Any, scene: Scene | None = None) -> list[Picture]:
    """The pictures of a public function's result; an empty list without data.

    Parameters
    ----------
    found : object
        Result of a function in :data:`STUDIES`; for :func:`mic.explore`, one of its answers.
    scene : Scene, optional
        Its limits are drawn for :func:`mic.predict` and :func:`mic.remedy`, whose results have none.

    Raises
    ------
    TypeError
        For any other object.
    """
    for one in STUDIES:
        if one.takes(found):
            with matplotlib.style.context(RC, after_reset=True):  # whatever the user's own settings
                return [picture for picture in one.draw(found, scene) if picture is not None]
    names = ", ".join(one.command for one in STUDIES)
    raise TypeError(
        f"no pictures for {type(found).__name__}: pass the result of {names}; for mic.explore, one of its answers"
    )
