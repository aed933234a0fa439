"""Pictures of the results of public functions: the same ones that the page of each command shows.

>>> found = mic.sensitivity(model)                                                    # doctest: +SKIP
>>> (picture,) = mic.report.pictures(found)                                           # doctest: +SKIP

Pictures that a run's report shows as well are listed in :mod:`mic.report.picture_registry`.
"""

from __future__ import annotations

from collections.abc import Callable
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
    draw: Callable[[Any, Scene | None], list[Picture | None]]

    def takes(self, found: Any) -> bool:
        """Whether the object is a result of the command."""
        if isinstance(self.returns, type):
            return isinstance(found, self.returns)
        return isinstance(found, pd.DataFrame) and set(self.returns.names) <= set(found.columns)


#: Pictures by command.
STUDIES = (
    StudyPictures("run", Outcome, "all pictures of its report", lambda found, scene: [*_of_run(found)]),
    StudyPictures(
        "compare",
        Comparison,
        "changes with their intervals; distributions before and after",
        lambda found, scene: [*comparison_pictures(found)],
    ),
    StudyPictures(
        "contributors",
        Contributors,
        "shares of the variance, alone and with interactions",
        lambda found, scene: [contributor_picture(scene, found.table, found.linearity)],
    ),
    StudyPictures(
        "explain",
        Explanation,
        "sources before and after the measurement; predicted characteristics",
        lambda found, scene: [*explanation_pictures(found)],
    ),
    StudyPictures(
        "explore",
        ExploredAssembly,
        "contact states, key characteristics against their limits",
        lambda found, scene: [explored(found)],
    ),
    StudyPictures(
        "friction",
        FRICTION_EFFECTS,
        "changes of mean and 6σ with the friction",
        lambda found, scene: [friction_effect_picture(scene, found)],
    ),
    StudyPictures(
        "optimise",
        Optimum,
        "changes with their intervals; the search",
        lambda found, scene: [change_picture(scene, found.table), search_trail(found.trail, found.objective)],
    ),
    StudyPictures(
        "order",
        ORDERS,
        "largest changes of mean and 6σ by order",
        lambda found, scene: [order_picture(scene, found)],
    ),
    StudyPictures(
        "predict",
        PREDICTIONS,
        "predictions of each assembly, by verdict",
        lambda found, scene: [predicted(found, scene)],
    ),
    StudyPictures(
        "rare",
        RareFailures,
        "probabilities of a miss; the most likely misses",
        lambda found, scene: [miss_picture(scene, found.table), likeliest_miss_picture(scene, found.points)],
    ),
    StudyPictures(
        "remedy",
        Remedies,
        "mean and 6σ without and with each remedy",
        lambda found, scene: [remedy_picture(scene, found.effects)],
    ),
    StudyPictures(
        "sensitivity",
        Effects,
        "effect of a step of each input",
        lambda found, scene: [sensitivity_picture(scene, found.table)],
    ),
)


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


def _of_run(outcome: Outcome) -> list[Picture]:
    return list(draw_all(outcome, read_context(outcome)).values())
