"""The pictures of a report: their order, their section of the page, and the functions that draw them.

Each function takes an outcome and its context and returns a :class:`~mic.report.picture.Picture`, or None if the
outcome lacks the data. It only reads results and solves nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import matplotlib.style

from mic.execution.engine import forked_workers
from mic.execution.local import Local
from mic.report.change_pictures import change_picture, order_picture, remedy_picture
from mic.report.contact_pictures import sample_picture, slip_force_picture, state_picture, tangential_density_picture
from mic.report.context import Context, study_tables
from mic.report.driver_pictures import contributor_picture, friction_effect_picture, sensitivity_picture
from mic.report.law_pictures import friction_picture, law_cost_picture
from mic.report.measurement_pictures import measurement_picture
from mic.report.miss_pictures import likeliest_miss_picture, miss_picture
from mic.report.path_pictures import friction_work_picture, path_error_picture, path_state_picture
from mic.report.picture import Picture
from mic.report.space_pictures import assembly_picture, deviation_map_picture, field_picture, overview_picture
from mic.report.style import RC
from mic.results import schema
from mic.results.outcome import Outcome
from mic.results.schema import Table

if TYPE_CHECKING:
    from mic.report.background_pictures import BackgroundPictures

__all__ = ["PICTURES", "Entry", "StudyPicture", "draw", "draw_all"]


@dataclass(frozen=True)
class StudyPicture:
    """A picture of a study, drawn from the tables that its command has stored in the results folder.

    Attributes
    ----------
    func : callable
        ``func(*tables) -> Picture or None``; :mod:`mic.report.study_pictures` calls it with the result of the study.
    tables : tuple of Table
        All of them are required.
    limits : bool
        Whether it takes the scene, too, for the limits of its key characteristics.
    """

    func: Callable[..., Picture | None]
    tables: tuple[Table, ...]
    limits: bool = False

    def __call__(self, outcome: Outcome, context: Context) -> Picture | None:
        found, scene = study_tables(outcome, *self.tables), [outcome.model.scene] if self.limits else []
        return None if found is None else self.func(*found, *scene)


@dataclass(frozen=True)
class Entry:
    """One picture of the report.

    Attributes
    ----------
    name : str
        Its anchor in the page.
    section : str
        Section of the page, which shows its pictures by ``gallery("section")``. ``still`` has those that replace the
        interactive views in browsers without WebGL; the page refers to them by name.
    function : callable
        ``function(outcome, context) -> Picture or None``.
    """

    name: str
    section: str
    function: Callable[[Outcome, Context], Picture | None]


#: Every picture, in the order of the page.
PICTURES = (
    Entry("contributors", "drivers", StudyPicture(contributor_picture, (schema.CONTRIBUTORS, schema.LINEARITY))),
    Entry("sensitivities", "steps", StudyPicture(sensitivity_picture, (schema.SENSITIVITIES,))),
    Entry("friction-effects", "friction", StudyPicture(friction_effect_picture, (schema.FRICTION_EFFECTS,))),
    Entry("rare-misses", "misses", StudyPicture(miss_picture, (schema.RARE,))),
    Entry("likeliest-misses", "misses", StudyPicture(likeliest_miss_picture, (schema.DESIGN_POINTS,))),
    Entry("remedy-effects", "remedies", StudyPicture(remedy_picture, (schema.REMEDY_EFFECTS,), limits=True)),
    Entry("order-changes", "orders", StudyPicture(order_picture, (schema.ORDERS,))),
    Entry("optimum-changes", "optimum", StudyPicture(change_picture, (schema.COMPARISON,))),
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
    """Draw one picture of :data:`PICTURES` in the style of the report; None if the outcome lacks the data.

    Raises
    ------
    KeyError
        If there is no picture of this name.
    """
    function = {picture.name: picture.function for picture in PICTURES}[name]
    with matplotlib.style.context(RC, after_reset=True):  # independent of the user's settings
        return function(outcome, context)


def draw_all(outcome: Outcome, context: Context, background: BackgroundPictures | None = None) -> dict[str, Picture]:
    """All pictures for which the outcome has data, by name, in the order of :data:`PICTURES`.

    Parameters
    ----------
    outcome : Outcome
    context : Context
    background : BackgroundPictures, optional
        Pictures of this outcome that are drawn already.
    """
    ready = () if background is None else background.names
    names = [entry.name for entry in PICTURES if entry.name not in ready]
    engine = Local(forked_workers() if background is None else 1)
    drawn = {names[i]: picture for i, picture in engine.completed(lambda name: draw(name, outcome, context), names)}
    if background is not None:
        drawn |= background.pictures()
    return {entry.name: picture for entry in PICTURES if (picture := drawn[entry.name]) is not None}
