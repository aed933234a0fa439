"""The pictures of a report: which there are, in which order, and in which section of the page they stand.

A picture is a function of the outcome and its context that returns a :class:`~mic.report.picture.Picture`, or None
where the outcome cannot fill it. It reads what the run left behind and solves nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import matplotlib.style

from mic.execution.worker_process import run_on_two_cores
from mic.report.change_pictures import change_picture, order_picture, remedy_picture
from mic.report.contact_pictures import sample_picture, slip_force_picture, state_picture, tangential_density_picture
from mic.report.context import Context
from mic.report.driver_pictures import contributor_picture, friction_effect_picture, sensitivity_picture
from mic.report.law_pictures import friction_picture, law_cost_picture
from mic.report.measurement_pictures import measurement_picture
from mic.report.miss_pictures import likeliest_miss_picture, miss_picture
from mic.report.path_pictures import friction_work_picture, path_error_picture, path_state_picture
from mic.report.picture import Picture
from mic.report.space_pictures import assembly_picture, deviation_map_picture, field_picture, overview_picture
from mic.report.style import RC
from mic.results.outcome import Outcome
from mic.results.schema import (
    COMPARISON,
    CONTRIBUTORS,
    DESIGN_POINTS,
    FRICTION_EFFECTS,
    LINEARITY,
    ORDERS,
    RARE,
    REMEDY_EFFECTS,
    SENSITIVITIES,
    Table,
)

if TYPE_CHECKING:
    from mic.report.background_pictures import Ahead

__all__ = ["PICTURES", "SECTIONS", "Entry", "Kept", "draw", "draw_all"]

#: Sections of the page that show their pictures one below the other. ``still`` holds what stands in for the interactive
#: views where a browser cannot show them; the page names those pictures.
SECTIONS = (
    "drivers",
    "steps",
    "friction",
    "misses",
    "remedies",
    "orders",
    "optimum",
    "path",
    "motion",
    "slip",
    "contacts",
    "laws",
    "characteristics",
    "fields",
    "still",
)


@dataclass(frozen=True)
class Kept:
    """A picture of what a study found, drawn from the tables that its command has left in the run's folder.

    Attributes
    ----------
    func : callable
        ``func(scene, *tables) -> Picture or None``; :mod:`mic.report.study_pictures` calls it with what the study returns.
    tables : tuple of Table
        Without one of them there is no picture.
    """

    func: Callable[..., Picture | None]
    tables: tuple[Table, ...]

    def __call__(self, outcome: Outcome, context: Context) -> Picture | None:
        found = [outcome.study(table) for table in self.tables]
        return None if any(one is None for one in found) else self.func(outcome.model.scene, *found)


@dataclass(frozen=True)
class Entry:
    """One picture of the report.

    Attributes
    ----------
    name : str
        Its anchor in the page.
    section : str
        One of :data:`SECTIONS`.
    function : callable
        ``function(outcome, context) -> Picture or None``.
    """

    name: str
    section: str
    function: Callable[[Outcome, Context], Picture | None]

    def __post_init__(self) -> None:
        if self.section not in SECTIONS:
            raise ValueError(f"picture {self.name}: section must be one of {', '.join(SECTIONS)}, not {self.section}")


#: Every picture, in the order of the page.
PICTURES = (
    Entry("contributors", "drivers", Kept(contributor_picture, (CONTRIBUTORS, LINEARITY))),
    Entry("sensitivities", "steps", Kept(sensitivity_picture, (SENSITIVITIES,))),
    Entry("friction-effects", "friction", Kept(friction_effect_picture, (FRICTION_EFFECTS,))),
    Entry("rare-misses", "misses", Kept(miss_picture, (RARE,))),
    Entry("likeliest-misses", "misses", Kept(likeliest_miss_picture, (DESIGN_POINTS,))),
    Entry("remedy-effects", "remedies", Kept(remedy_picture, (REMEDY_EFFECTS,))),
    Entry("order-changes", "orders", Kept(order_picture, (ORDERS,))),
    Entry("optimum-changes", "optimum", Kept(change_picture, (COMPARISON,))),
    Entry("assembly", "still", assembly_picture),
    Entry("path-error", "path", path_error_picture),
    Entry("tangential-density", "motion", tangential_density_picture),
    Entry("path-states", "slip", path_state_picture),
    Entry("friction-work", "slip", friction_work_picture),
    Entry("slip-force", "contacts", slip_force_picture),
    Entry("one-sample-f", "contacts", partial(sample_picture, quantity="f")),
    Entry("one-sample-u", "contacts", partial(sample_picture, quantity="u")),
    Entry("states", "contacts", state_picture),
    Entry("law-cost", "laws", law_cost_picture),
    Entry("friction", "laws", friction_picture),
    Entry("measurements", "characteristics", measurement_picture),
    Entry("deviation-maps", "characteristics", deviation_map_picture),
    Entry("overview", "still", overview_picture),
    Entry("displacement-fields", "fields", field_picture),
)


def draw(name: str, outcome: Outcome, context: Context) -> Picture | None:
    """Draw one picture of :data:`PICTURES` under the report's own style; None where the outcome cannot fill it.

    Raises
    ------
    KeyError
        If there is no picture of this name.
    """
    function = {entry.name: entry.function for entry in PICTURES}[name]
    with matplotlib.style.context(RC, after_reset=True):  # whatever the user's own settings
        return function(outcome, context)


def draw_all(outcome: Outcome, context: Context, ahead: Ahead | None = None) -> dict[str, Picture]:
    """All pictures that the outcome can fill, by name, in the order of :data:`PICTURES`.

    Parameters
    ----------
    outcome : Outcome
    context : Context
    ahead : Ahead, optional
        Those of this outcome that were begun before.
    """
    names = [entry.name for entry in PICTURES if ahead is None or entry.name not in ahead.names]
    tasks = [partial(draw, name, outcome, context) for name in names]
    if ahead is None:
        drawn = dict(zip(names, run_on_two_cores(tasks)))
    else:
        drawn = {name: task() for name, task in zip(names, tasks)} | ahead.pictures()
    return {entry.name: picture for entry in PICTURES if (picture := drawn[entry.name]) is not None}
