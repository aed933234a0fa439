"""HTML pages from Jinja templates; an unknown name in a template is an error."""

from __future__ import annotations

import re
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from mic.report.style import LAWS, STATE_WORDS, change, micrometres, number, percent, signed_micrometres
from mic.statistics.estimates import LEVEL

__all__ = ["backticks_to_code", "render"]


def backticks_to_code(text: str) -> Markup:
    """HTML of a sentence, with text between backticks set as code."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def render(template: str, **values: Any) -> str:
    """The text of a page.

    Parameters
    ----------
    template : str
        File name in this package. Filters are those of :mod:`mic.report.style`, ``percent`` with one decimal;
        ``code``, :func:`backticks_to_code`; and ``records``, the rows of a table. Variables of all templates are
        ``level``, that of confidence intervals, ``looks`` of the laws by name, and ``state_words``.
    **values
        Variables of the template.
    """
    environment = Environment(
        loader=PackageLoader("mic.report", ""),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {"number": number, "change": change, "micrometres": micrometres, "code": backticks_to_code}
    environment.filters |= {"signed_micrometres": signed_micrometres}
    environment.globals |= {"level": f"{100 * LEVEL:.0f} %", "looks": LAWS, "state_words": STATE_WORDS}
    environment.filters |= {"percent": lambda x: percent(x, 1), "records": lambda table: table.to_dict("records")}
    return environment.get_template(template).render(**values)
