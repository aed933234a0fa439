"""The gallery's pages on the commands run, and end in what they promise."""

import runpy
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest

from mic.report.picture import Picture

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "gallery"
#: By page: names of pictures of the report that it leaves, how many figures of its own, and words that it prints.
PAGES = {
    "compare": (("changes", "distributions"), 0, ("zones.lap.friction: 0.27 → 0.135",)),
    "contributors": ((), 1, ("opened all together",)),
    "explain": (("sources", "reached"), 0, ("F2  4.79",)),
    "predict": ((), 1, ("rejected", "within all limits", "still")),
    "remedy": ((), 1, ("locators.upper-", "True")),
}


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_page_runs_and_shows_what_it_promises(page, cache, monkeypatch, capsys):
    monkeypatch.setenv("MIC_CACHE", str(cache))
    monkeypatch.setattr(plt, "show", lambda: None)
    with matplotlib.rc_context({"backend": "agg"}):
        plt.close("all")
        try:
            left = runpy.run_path(str(FOLDER / f"{page}.py"))
            figures = [plt.figure(number) for number in plt.get_fignums()]
            assert all(axis.has_data() for figure in figures for axis in figure.axes)
        finally:
            plt.close("all")
    pictures, own, words = PAGES[page]
    assert len(figures) == own
    for name in pictures:
        assert isinstance(left[name], Picture) and left[name].uri.startswith("data:image/svg+xml")
    said = capsys.readouterr().out
    for word in words:
        assert word in said, said
