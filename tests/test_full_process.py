"""The full solve and the reduced one go through the same process: limited forces, three sheets, other stations."""

import numpy as np
import pytest

import mic
from fem_reference.full.model import FullModel
from mic.model.assembly import assemble
from mic.sampling.draw import draw

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


def changed(scene, increments, **tables):
    """The scene on a coarse mesh, with other tables, every stage in so many increments."""
    dumped = scene.model_dump() | tables
    dumped["parts"] = [part | {"size": "coarse"} for part in dumped["parts"]]
    following = ("clamp", "weld", "release")
    dumped["stages"] = [
        stage | ({"increments": increments, "path": None} if stage["kind"] in following else {})
        for stage in dumped["stages"]
    ]
    return mic.Scene(**dumped, folder=scene.folder)


def both(scene, cache, law="coulomb", seed=5):
    sample = draw(scene, seed, 0, 1)[0]
    return FullModel(assemble(scene, cache)).evaluate(sample, law), mic.reduce(scene, cache).evaluate(sample, law)


@pytest.mark.parametrize("law", ["coulomb", "frictionless"])
@pytest.mark.parametrize("increments", [1, 3])
def test_limited_clamps_and_guns_mean_the_same_to_both(lap_scene, cache, increments, law):
    """One clamp gives way and one holds; one gun leaves a gap and one closes its own."""
    upper, lower = lap_scene.model_dump()["clamps"]
    clamps = [
        lower,
        upper | {"force": None, "stroke": 0.4, "limit": 80.0},
        upper | {"name": "C2", "point": (90.0, 12.5, 1.0), "force": None, "stroke": 0.05, "limit": 5e3},
    ]
    first, second = lap_scene.model_dump()["welds"]
    welds = [first | {"gun": 1500.0}, second | {"gun": 3.0}]
    scene = changed(lap_scene, increments, clamps=clamps, welds=welds)
    full, reduced = both(scene, cache, law)
    assert difference(full, reduced) < 1e-7
    clamp, weld = reduced.resolutions["clamp"], reduced.resolutions["weld"]
    assert clamp.reached[0].tolist() == [False, True]
    assert weld.reached[0].tolist() == [True, False, False, True]
