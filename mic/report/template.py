"""HTML pages from Jinja templates; an unknown name in a template is an error."""

from __future__ import annotations

import re
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from mic.report.style import change, number, percent

__all__ = ["backticks_to_code", "render"]


def backticks_to_code(text: str) -> Markup:
    """HTML of a sentence, with text between backticks set as code."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def render(template: str, **values: Any) -> str:
    """The text of a page.

    Parameters
    ----------
    template : str
        File name in this package. Filters are :func:`mic.report.style.number`, :func:`~mic.report.style.change`,
        ``percent`` with one decimal, and ``code``, :func:`backticks_to_code`.
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
    environment.filters |= {"number": number, "change": change, "percent": lambda value: percent(value, 1)}
    environment.filters["code"] = backticks_to_code
    return environment.get_template(template).render(**values)
