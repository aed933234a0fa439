"""The full solve and the reduced one go through the same process: limited forces, three sheets, other stations."""

import numpy as np
import pytest

import mic
from fem_reference.full.model import FullModel
from mic.model.assembly import assemble
from mic.statistics.draw import draw

pytestmark = [pytest.mark.fem, pytest.mark.slow]


def difference(full, reduced):
    """Largest relative difference of forces, displacements, measurements and limited forces over all stages."""
    assert set(full.resolutions) == set(reduced.resolutions)
    pairs = [(full.measurements, reduced.measurements[0])]
    for stage, resolution in reduced.resolutions.items():
        assert resolution.converged.all()
        for name in ("force", "displacement", "pushed", "left"):
            pairs.append((getattr(full.resolutions[stage], name), getattr(resolution, name)[0]))
    return max(np.abs(a - b).max() / np.abs(b).max() for a, b in pairs if b.size and np.abs(b).max() > 0)


def both(scene, cache):
    """The full solution of one sample, and the reduced one with its model."""
    sample, model = draw(scene, 5, 0, 1)[0], mic.reduce(scene, cache)
    return FullModel(assemble(scene, cache), route="condensed").evaluate(sample), model.evaluate(sample), model


def test_both_models_agree_on_limited_clamps_and_guns(lap_scene, cache):
    """One clamp gives way and one holds; one gun leaves a gap and one closes its own."""
    dumped = lap_scene.model_dump()
    (upper, lower), (first, second) = dumped["clamps"], dumped["welds"]
    dumped["clamps"] = [
        lower,
        upper | {"force": None, "stroke": 0.4, "limit": 80.0},
        upper | {"name": "C2", "point": (90.0, 12.5, 1.0), "force": None, "stroke": 0.05, "limit": 5e3},
    ]
    dumped["welds"] = [first | {"gun": 1500.0}, second | {"gun": 3.0}]
    dumped["parts"] = [part | {"size": "coarse"} for part in dumped["parts"]]
    for stage in dumped["stages"][1:4]:
        stage |= {"increments": 3, "path": None}
    full, reduced, _ = both(mic.Scene(**dumped, folder=lap_scene.folder), cache)
    assert difference(full, reduced) < 1e-7
    assert reduced.resolutions["clamp"].reached[0].tolist() == [False, True]
    assert reduced.resolutions["weld"].reached[0].tolist() == [True, False, False, True]


def test_both_models_agree_where_parts_touch_nowhere(lap_scene, cache):
    """Welds alone join them: no stage solves contact."""
    dumped = lap_scene.model_dump()
    dumped["zones"], dumped["parts"] = [], [part | {"size": "coarse"} for part in dumped["parts"]]
    full, reduced, _ = both(mic.Scene(**dumped, folder=lap_scene.folder), cache)
    assert difference(full, reduced) < 1e-7


GEOMETRY = """
from mic.geometry.structured import extrude

HEIGHT, SIZE = {"bottom": 0.0, "middle": 1.0, "top": 2.0}, {"bottom": 9.0, "middle": 10.0, "top": 11.0}


def build(part, size):
    return extrude([(0, HEIGHT[part]), (25, HEIGHT[part])], 0.0, 120.0, size * SIZE[part])
"""
Z = {"bottom": 0.0, "middle": 1.0, "top": 2.0}


def six(part, stage="locate", ends=(5, 115)):
    points = [(ends[0], 5), (ends[0], 20), (ends[1], 12.5), (ends[0], 12.5), (ends[1], 12.5), (ends[0], 12.5)]
    along = [(0, 0, 1)] * 3 + [(0, 1, 0)] * 2 + [(1, 0, 0)]
    return [
        {"name": f"{part}-{stage}-{i}", "part": part, "point": [*point, Z[part]], "direction": axis, "stage": stage}
        for i, (point, axis) in enumerate(zip(points, along))
    ]


def clamp(name, part, x, up, stage, **keys):
    return {"name": name, "part": part, "point": [x, 12.5, Z[part]], "direction": [0, 0, up], "stage": stage} | keys


def weld(name, parts, x, stage, **keys):
    point = [x, 12.5, (Z[parts[0]] + Z[parts[1]]) / 2]
    return {"name": name, "parts": parts, "point": point, "stage": stage} | keys


@pytest.fixture(scope="module")
def sheets(tmp_path_factory):
    """Three sheets on top of each other, of meshes that do not match."""
    folder = tmp_path_factory.mktemp("sheets")
    (folder / "geometry.py").write_text(GEOMETRY)
    low, high = ["bottom", "middle"], ["middle", "top"]

    def scene(locators, clamps, welds, stages):
        force = {"kind": "force", "direction": [0, 0, 1], "sigma": 2.0}
        return mic.Scene(
            name="sheets",
            parts=[{"name": name, "geometry": "geometry.py", "size": 1.0, "thickness": 1.0} for name in Z],
            locators=locators,
            clamps=clamps,
            welds=welds,
            zones=[
                {"name": name, "parts": parts, "friction": 0.2, "pairs": 8}
                for name, parts in (("low", low), ("high", high))
            ],
            stages=stages,
            deviations=[
                force | {"name": "M", "part": "middle", "point": [60, 12.5, 1], "mean": 5.0},
                force | {"name": "B", "part": "bottom", "point": [30, 5, 0], "mean": -4.0},
                force | {"name": "T", "part": "top", "point": [90, 20, 2], "mean": 4.0},
            ],
            measurements=[
                {"name": name, "part": name, "point": [118, 4, z], "direction": [0, 0, 1], "lower": -1, "upper": 1}
                for name, z in Z.items()
            ],
            folder=folder,
        )

    return scene


LOW, HIGH = ("bottom", "middle"), ("middle", "top")


def test_three_sheets_clamps_and_locators_that_open_and_close_one_by_one(sheets, cache):
    """A clamp opens before the welds, a locator closes after them, and what closes next closes on the joined stack."""
    further = {"name": "support", "part": "middle", "point": [60, 5, 1], "direction": [0, 0, 1], "stage": "after"}
    names = [item["name"] for part in Z for item in six(part)]
    step = {"increments": 1}
    scene = sheets(
        [*six("bottom"), *six("middle"), *six("top"), further],
        [
            clamp("up", "bottom", 60, 1, "clamp", force=80),
            clamp("down", "top", 60, -1, "clamp", force=80),
            clamp("hold", "top", 90, -1, "clamp", stroke=0.1),
            clamp("late", "top", 100, -1, "after", force=10),
        ],
        [weld("L", LOW, 40, "weld"), weld("U", HIGH, 40, "weld"), weld("V", HIGH, 80, "weld", close=True)],
        [
            {"kind": "locate"},
            {"kind": "clamp", "order": [["up", "down"], ["hold"]]} | step,
            {"kind": "release", "name": "early", "keep": ["up", "down", *names]} | step,
            {"kind": "weld", "order": [["L", "U"], ["V"]]} | step,
            {"kind": "clamp", "name": "after", "order": [["support"], ["late"]]} | step,
            {"kind": "release", "keep": [item["name"] for item in six("bottom")]} | step,
            {"kind": "measure"},
        ],
    )
    full, reduced, _ = both(scene, cache)
    assert difference(full, reduced) < 1e-7
    assert all((resolution.force[0, :, 0] > 0).any() for resolution in reduced.resolutions.values())


def test_a_subassembly_goes_on_to_the_next_station_and_to_its_inspection(sheets, cache):
    """bottom and middle are joined and released, set down elsewhere with top, joined with it, and read on another six.

    In the second station top lies on supports of 2 N/mm.
    The inspection holds bottom at one end and top at the other.
    """
    step = {"increments": 1}
    inspection = [item | {"name": f"i{i}"} for i, item in enumerate(six("bottom", "measure", (20, 100)))]
    for i in (2, 4):
        inspection[i] |= {"part": "top", "point": [*inspection[i]["point"][:2], 2.0]}
    soft = [item | ({"stiffness": 2.0} if item["direction"] == (0, 0, 1) else {}) for item in six("top", "second")]
    scene = sheets(
        [*six("bottom"), *six("middle"), *six("middle", "second", (15, 105)), *soft, *inspection],
        [
            clamp("up", "bottom", 60, 1, "clamp", force=60),
            clamp("down", "middle", 60, -1, "clamp", force=60),
            clamp("press", "top", 70, -1, "again", stroke=0.3, limit=25.0),
        ],
        [
            weld("A", LOW, 40, "weld", gun=400.0),
            weld("B", LOW, 80, "weld"),
            weld("C", HIGH, 50, "join"),
            weld("D", HIGH, 90, "join", close=True),
        ],
        [
            {"kind": "locate"},
            {"kind": "clamp"} | step,
            {"kind": "weld"} | step,
            {"kind": "release", "keep": [item["name"] for item in six("bottom")]} | step,
            {"kind": "locate", "name": "second"} | step,
            {"kind": "clamp", "name": "again"} | step,
            {"kind": "weld", "name": "join"} | step,
            {"kind": "release", "name": "open"} | step,
            {"kind": "measure"} | step,
        ],
    )
    full, reduced, model = both(scene, cache)
    assert set(reduced.resolutions) == {"clamp", "weld", "release", "second", "again", "join", "open", "measure"}
    assert difference(full, reduced) < 1e-7
    again = reduced.resolutions["again"].reaction[0]
    np.testing.assert_allclose(full.resolutions["again"].reaction, again, atol=1e-6 * np.abs(again).max())
    zone = model.contacts.zone
    for stage, resolution in reduced.resolutions.items():
        if stage in ("clamp", "weld", "release", "second"):
            assert not resolution.force[0, zone == 1].any()
    assert (reduced.resolutions["again"].force[0, zone == 1, 0] > 0).any()
    # Read on bottom's process locators instead, the same assembly has other numbers: the inspection is what is read.
    dumped = scene.model_dump()
    dumped["stages"][-1], dumped["locators"] = {"kind": "measure"}, dumped["locators"][:-6]
    elsewhere = mic.Scene(**dumped, folder=scene.folder)
    again = mic.reduce(elsewhere, cache).evaluate(reduced.deviations)
    assert np.abs(again.measurements - reduced.measurements).max() > 0.01
