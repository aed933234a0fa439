"""What the public functions return, as pictures: of each command the same ones that its page shows.

>>> found = mic.sensitivity(model)                                                    # doctest: +SKIP
>>> (picture,) = mic.report.pictures(found)                                           # doctest: +SKIP

A picture that a run's report shows as well is listed in :mod:`mic.report.picture_registry`, and drawn by the same function from
the tables that the command has left in the run's folder.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import matplotlib.style
import pandas as pd

from mic.report.assembly_pictures import foretold, moved
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

__all__ = ["SHOWN", "Shown", "pictures"]


@dataclass(frozen=True)
class Shown:
    """How what a command finds is shown.

    Attributes
    ----------
    command : str
        Of the same name as the public function.
    returns : type or Table
        What that returns: a class, or the table that a DataFrame is.
    words : str
        What its pictures show.
    draw : callable
        ``draw(found, scene)``: the pictures; None in the place of one that has nothing to show.
    """

    command: str
    returns: type | Table
    words: str
    draw: Callable[[Any, Scene | None], list[Picture | None]]

    def takes(self, found: Any) -> bool:
        """Whether that is what the command finds."""
        if isinstance(self.returns, type):
            return isinstance(found, self.returns)
        return isinstance(found, pd.DataFrame) and set(self.returns.names) <= set(found.columns)


#: Everything that is shown, by command.
SHOWN = (
    Shown("run", Outcome, "all those of its report", lambda found, scene: [*_of_run(found)]),
    Shown(
        "compare",
        Comparison,
        "changes with their intervals; distributions before and after",
        lambda found, scene: [*comparison_pictures(found)],
    ),
    Shown(
        "contributors",
        Contributors,
        "shares of the variance, alone and with others",
        lambda found, scene: [contributor_picture(scene, found.table, found.linearity)],
    ),
    Shown(
        "explain",
        Explanation,
        "sources before and after the measurement; what they give",
        lambda found, scene: [*explanation_pictures(found)],
    ),
    Shown(
        "explore",
        ExploredAssembly,
        "of an answer: contact states, key characteristics against their limits",
        lambda found, scene: [moved(found)],
    ),
    Shown(
        "friction",
        FRICTION_EFFECTS,
        "changes of mean and 6σ as all friction is multiplied",
        lambda found, scene: [friction_effect_picture(scene, found)],
    ),
    Shown(
        "optimise",
        Optimum,
        "changes with their intervals; the search",
        lambda found, scene: [change_picture(scene, found.table), search_trail(found.trail, found.objective)],
    ),
    Shown(
        "order",
        ORDERS,
        "by order, the largest changes of mean and 6σ",
        lambda found, scene: [order_picture(scene, found)],
    ),
    Shown(
        "predict",
        PREDICTIONS,
        "what is foretold of each assembly, by verdict",
        lambda found, scene: [foretold(found, scene)],
    ),
    Shown(
        "rare",
        RareFailures,
        "probabilities of a miss; the likeliest misses",
        lambda found, scene: [miss_picture(scene, found.table), likeliest_miss_picture(scene, found.points)],
    ),
    Shown(
        "remedy",
        Remedies,
        "mean and 6σ as it is and with each remedy",
        lambda found, scene: [remedy_picture(scene, found.effects)],
    ),
    Shown(
        "sensitivity",
        Effects,
        "what a step of each input changes",
        lambda found, scene: [sensitivity_picture(scene, found.table)],
    ),
)


def pictures(found: Any, scene: Scene | None = None) -> list[Picture]:
    """The pictures of what a public function returned; none where there is nothing to show.

    Parameters
    ----------
    found : object
        What a function of :data:`SHOWN` returned; of :func:`mic.explore`, an answer.
    scene : Scene, optional
        Whose limits are drawn into the pictures of :func:`mic.predict` and :func:`mic.remedy`, which return none.

    Raises
    ------
    TypeError
        If it is something else.
    """
    for one in SHOWN:
        if one.takes(found):
            with matplotlib.style.context(RC, after_reset=True):  # whatever the user's own settings
                return [picture for picture in one.draw(found, scene) if picture is not None]
    names = ", ".join(one.command for one in SHOWN)
    raise TypeError(
        f"{type(found).__name__} is not what a function returns that has pictures ({names}); of mic.explore, take an "
        "answer"
    )


def _of_run(outcome: Outcome) -> list[Picture]:
    return list(draw_all(outcome, read_context(outcome)).values())
