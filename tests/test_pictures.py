"""Pictures of the results of public functions: each draws the numbers of its tables at the right places."""

from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from support.springs import dragged
from support.studies import filled, friction, optimum, order, rare, remedy, sensitivities

import mic
from mic.options import app
from mic.report import assembly_pictures, change_pictures, driver_pictures, miss_pictures, picture, pictures
from mic.report.picture import Picture, law_legend, panels, svg
from mic.report.study_pictures import STUDIES
from mic.report.style import INSIDE, LIMIT_COLOUR, OUTSIDE
from mic.results.schema import PREDICTIONS

NAMES, INPUTS = ["M1", "M2"], ["F1", "F2", "D"]


@pytest.fixture
def drawn(monkeypatch):
    """Figures as they are drawn, before they are pixels."""
    figures = []

    def kept(figure, title, caption):
        figures.append(figure)
        figure.canvas.draw()
        return Picture(title, caption, b"", "svg")

    for module in (change_pictures, driver_pictures, miss_pictures, assembly_pictures):
        monkeypatch.setattr(module, "svg", kept)
    return figures


def widths(ax):
    """Lengths of the bars, by the names beside them."""
    names = [label.get_text() for label in ax.get_yticklabels()]
    return dict(zip(names, [bar.get_width() for bar in ax.patches]))


def dots(ax, container=0):
    """Abscissas of dots with intervals, and of the intervals' ends."""
    line, _, (bars,) = [one for one in ax.containers if hasattr(one, "has_xerr")][container]
    return np.asarray(line.get_xdata(), dtype=float), np.array([segment[:, 0] for segment in bars.get_segments()])


def upright(ax, colour):
    return [line.get_xdata()[0] for line in ax.lines if to_hex(line.get_color()) == colour]


@pytest.mark.slow
def test_labels_that_are_measured_once_have_the_room_that_a_layout_gives_them(monkeypatch):
    """To less than the 3 points that a layout leaves free beside labels, so that none is cut; where ticks stay
    (in the first row) and where they change with the size of the axes."""

    def places():
        fig, axes = panels(6, 3, (3.0, 2.0))
        for k, ax in enumerate(axes):
            ax.plot([0, 10.0**k], [0, 1e5 * 10.0**k])
            if k < 3:
                ax.set_xticks([0, 10.0**k])
                ax.set_yticks([0, 1e5 * 10.0**k])
            ax.set_ylabel("what it shows" * (k % 2))
        law_legend(fig, ["coulomb"])
        svg(fig, "", "")
        return np.array([ax.get_position().extents for ax in axes]) * fig.get_size_inches()[[0, 1, 0, 1]] * 72

    found = places()
    monkeypatch.setattr(picture, "measured_once", lambda axes: nullcontext())
    np.testing.assert_allclose(found, places(), rtol=0, atol=3.0)


def test_steps_are_bars_in_micrometres_the_largest_first(drawn):
    (picture,) = pictures(sensitivities(NAMES, INPUTS))
    for k, ax in enumerate(drawn[0].axes):
        assert ax.get_title() == NAMES[k]
        found = widths(ax)
        assert list(found) == ["F1 (0.50)", "F2 (0.50)", "D (0.50)"]
        np.testing.assert_allclose([*found.values()], 10 * (k + 1) * np.array([1, -1 / 2, 1 / 3]))
        assert upright(ax, "#c8553d")[-1] == pytest.approx(2 * 10 * (k + 1) / 3)  # beyond the change
    assert "Largest effect: F1 on M2, 20.0 µm for 0.50." in picture.caption


def test_friction_is_drawn_in_shares_of_six_sigma(drawn):
    pictures(friction(NAMES))
    mean, spread = drawn[0].axes
    assert [label.get_text() for label in mean.get_yticklabels()] == ["M2", "M1"]  # the one that changes most first
    x, ends = dots(mean, 2)  # twice the friction
    np.testing.assert_allclose(x, [12, 0])
    np.testing.assert_allclose(ends, [[8, 16], [-4, 4]])
    np.testing.assert_allclose(dots(mean, 0)[0], [-12, 0])
    np.testing.assert_allclose(dots(spread, 2)[0], [-3, -3])
    assert pictures(friction(NAMES, zones=["lap"])) == []


def test_misses_are_drawn_of_a_million_and_the_likeliest_by_their_deviations(drawn):
    first, second = pictures(rare(NAMES, INPUTS))
    x, ends = dots(drawn[0].axes[0])
    np.testing.assert_allclose(x, [40, 40])
    np.testing.assert_allclose(ends[0], [10, 90])
    assert drawn[0].axes[0].get_xscale() == "log"
    assert "Share outside limits, any limit: 40 ppm (10 to 90)." in first.caption
    for k, ax in enumerate(drawn[1].axes):
        assert ax.get_title() == f"{NAMES[k]}, upper: β = {3 + k}.00"
        np.testing.assert_allclose([*widths(ax).values()], [3, -2, 1])


def test_remedies_stand_between_the_limits_of_the_scene(drawn):
    scene = dragged().scene
    names = [one.name for one in scene.measurements]
    (picture,) = pictures(remedy(names, "locators.A"), scene)
    for k, (ax, item) in enumerate(zip(drawn[0].axes, scene.measurements)):
        done, before = dots(ax, 0), dots(ax, 1)
        np.testing.assert_allclose([done[0][0], before[0][0]], [100 + 1000 * k, 400 + 1000 * k])
        np.testing.assert_allclose(done[1][0], [1000 * k - 50, 1000 * k + 250])  # ± 3σ
        assert upright(ax, LIMIT_COLOUR) == [1e3 * one for one in item.bounds if np.isfinite(one)]
    assert "Share outside of the worst characteristic: 12.5 % in the scene, locators.A 25.0 %." in picture.caption


def test_the_characteristic_that_changes_most_in_each_order_is_drawn(drawn):
    pictures(order(NAMES))
    mean, spread = drawn[0].axes
    assert [label.get_text() for label in mean.get_yticklabels()] == ["reverse"]
    x, ends = dots(mean)
    assert x[0] == pytest.approx(-4) and mean.texts[0].get_text() == "M2"
    np.testing.assert_allclose(ends[0], [-4 - 0.98, -4 + 0.98], atol=1e-3)
    assert dots(spread)[0][0] == pytest.approx(1)
    assert pictures(order([])) == []


def test_changes_are_drawn_in_shares_of_the_tolerance(drawn):
    _, search = pictures(optimum(NAMES)[0])
    mean, spread = drawn[0].axes
    x, ends = dots(mean)
    by_name = dict(zip((label.get_text() for label in mean.get_yticklabels()), x))
    assert by_name == pytest.approx({"M1": 1, "M2": 2})
    np.testing.assert_allclose(np.ptp(ends, axis=1), 1)
    np.testing.assert_allclose(dots(spread)[0], -2)
    np.testing.assert_allclose(drawn[1].axes[0].lines[0].get_xydata(), [[20, 1], [60, 1.25], [400, 1.625]])
    assert "from 1.00 to 1.62" in search.caption


def test_predictions_are_drawn_at_their_values_and_coloured_by_verdict(drawn):
    table = filled(PREDICTIONS, 4 * [{}])
    table["measurement"], table["row"] = ["M1", "", "M1", ""], [0, 0, 1, 1]
    table["verdict"] = ["accepted", "accepted", "rejected", "open"]
    table["value"] = [0.1, np.nan, 0.7, np.nan]
    table["low"], table["high"] = table["value"] - 0.2, table["value"] + 0.3
    (picture,) = pictures(table)
    (ax,) = drawn[0].axes
    lines = {to_hex(line.get_color()): (*line.get_xdata(), *line.get_ydata()) for line in ax.lines}
    assert lines[INSIDE] == (0.1, 0) and lines[OUTSIDE] == (0.7, 1)
    ends = [segment[:, 0].tolist() for lines in ax.collections for segment in lines.get_segments()]
    np.testing.assert_allclose(sorted(ends), [[-0.1, 0.4], [0.5, 1.0]])
    assert "2 assemblies: 1 accepted, 1 open." in picture.caption


def test_an_assembly_that_is_moved_shows_its_contacts_and_characteristics(drawn):
    exploration = mic.explore(dragged())
    answer = exploration.answer({"D": 2.1})
    (picture,) = pictures(answer)
    space, scale = drawn[0].axes
    told = {text.get_text() for text in space.get_legend().get_texts()}
    words = {"open": "open", "stick": "sticking", "slip": "slipping"}
    assert told == {f"{words[label]}: {count}" for label, count in answer.shares.items()}
    half = (answer.table["upper"] - answer.table["lower"]) / 2
    middle = (answer.table["upper"] + answer.table["lower"]) / 2
    np.testing.assert_allclose(scale.collections[0].get_offsets()[:, 0], (answer.table["value"] - middle) / half)
    assert answer.said in picture.caption and "Preliminary" not in picture.caption
    assert "Preliminary" in pictures(exploration.answer({"D": 2.1}, coarse=True))[0].caption


def test_pictures_exist_for_results_of_public_functions():
    commands = {one.name or one.callback.__name__ for one in app.registered_commands}
    assert {one.command for one in STUDIES} <= commands
    without_results = {"check", "init", "report", "serve", "export"}
    assert commands - {one.command for one in STUDIES} == without_results
    for found in (remedy(NAMES, "A"), rare(NAMES, INPUTS), order(NAMES), friction(NAMES), sensitivities(NAMES, INPUTS)):
        assert sum(one.takes(found) for one in STUDIES) == 1
    for strange in (mic.explore, pd.DataFrame({"order": [1]}), None):
        with pytest.raises(TypeError, match=r"no pictures for .*: pass the result of run, compare, "):
            pictures(strange)
