"""The estimates that a user reads first: with surrogates where these are better, else those of the samples alone."""

from __future__ import annotations

import pandas as pd

__all__ = ["headline"]

IMPROVED, ALONE = "improved_", "alone_"
ENDS = ("", "_low", "_high")


def headline(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the improved estimates, where there are any, in place of those of the samples alone.

    Parameters
    ----------
    table : DataFrame
        Statistics of key characteristics or of zones.

    Returns
    -------
    DataFrame
        Cp and σ follow from the improved 6σ. Columns ``alone_…`` hold the estimates that are replaced, else NaN.
    """
    shown = table.copy()
    for name in table.columns:
        own = name.removeprefix(IMPROVED)
        if name == own or f"{own}_low" not in table:
            continue
        better = table[name].notna()
        _replace(shown, table, own, [table[name + end] for end in ENDS], better)
        if own == "six_sigma":
            _replace(shown, table, "sigma", [shown[own + end] / 6 for end in ENDS], better)
            tolerance = table["cp"] * table[own]
            _replace(shown, table, "cp", [tolerance / shown[own + end] for end in ("", "_high", "_low")], better)
    return shown


def _replace(shown: pd.DataFrame, table: pd.DataFrame, name: str, values: list[pd.Series], better: pd.Series) -> None:
    for end, value in zip(ENDS, values):
        shown[name + end] = value.where(better, table[name + end])
        shown[ALONE + name + end] = table[name + end].where(better)
