"""Pages from their templates: what every page may call, and no name that is misspelt."""

from __future__ import annotations

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from mic.report.style import change, number, percent

__all__ = ["rendered"]


def rendered(template: str, **values: Any) -> str:
    """The text of a page.

    Parameters
    ----------
    template : str
        Its file in this package. Filters are :func:`mic.report.style.number`, :func:`~mic.report.style.change` and
        ``percent``, with one digit behind the point.
    **values
        What the template names; a name that is not among them is an error, not a gap in the page.
    """
    environment = Environment(
        loader=PackageLoader("mic.report", ""),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {"number": number, "change": change, "percent": lambda value: percent(value, 1)}
    return environment.get_template(template).render(**values)
