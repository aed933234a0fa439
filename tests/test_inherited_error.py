"""Path errors add up from stage to stage: an estimate from the path of one stage alone is too small."""

import numpy as np
from support.springs import at_face, dragged

from mic.process.process import Process

SAMPLES = np.array([[0.8, 2.0], [0.8, 1.0], [0.5, 2.0]])


def cornered(**clamp):
    """t drags b along x and then along y, round a corner, and is held there by more force in a stage of its own."""
    return dragged(
        clamps=[
            at_face("t", (1, 0, 0), name="T", stroke=0.0),
            at_face("t", (0, 1, 0), name="U", stroke=0.06),
            at_face("t", (0, 0, 1), name="V", stroke=-0.1, stage="press"),
        ],
        stages=[
            {"kind": "locate"},
            {"kind": "clamp", "order": [["T"], ["U"]]} | clamp,
            {"kind": "clamp", "name": "press"},
            {"kind": "measure"},
        ],
    )


def test_a_stage_in_which_nothing_slides_has_the_error_of_those_before():
    found, exact = (
        Process(cornered(), "coulomb", path_tolerance=tolerance).evaluate(SAMPLES).resolutions
        for tolerance in (2.5e-4, 1e-9)
    )
    assert found["press"].trace.length.max() == 0.0  # a path of no error of its own
    off = sum(found[stage].displacement - exact[stage].displacement for stage in ("clamp", "press"))
    error = np.linalg.norm(off[:, 0, 1:], axis=1)
    assert (error > 1e-8).all() and (error <= found["press"].trace.error).all()
    np.testing.assert_array_equal(found["press"].trace.error, found["clamp"].trace.error)


def test_no_stage_has_an_error_after_a_stage_without_one():
    found = Process(cornered(path="increments", increments=4), "coulomb").evaluate(SAMPLES)
    assert not found.failed.any()
    assert np.isnan(found.resolutions["clamp"].trace.error).all()
    assert np.isnan(found.resolutions["press"].trace.error).all()
