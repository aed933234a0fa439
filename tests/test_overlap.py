"""Nominal overlap is closed at pairs and welds, reported, and refused beyond a limit."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import mic
from mic.errors import SceneError
from mic.model.assembly import assemble
from mic.model.overlap import frozen_gaps, mean_gaps
from mic.options import app

MESHES = Path(__file__).resolve().parents[1] / "meshes"


def lap(thickness, **zone):
    """The lap joint, its sheets so thick (they are drawn 1 mm apart), a zone's keys changed."""
    scene = mic.load_scene(MESHES / "lap_joint")
    parts = [part.model_copy(update={"thickness": thickness, "size": "coarse"}) for part in scene.parts]
    zones = [one.model_copy(update={"pairs": 8} | zone) for one in scene.zones]
    return scene.model_copy(update={"parts": parts, "zones": zones})


@pytest.mark.slow
@pytest.mark.parametrize(
    "thickness, keys, gap, overlap",
    [(1.06, {}, 0.0, 0.06), (1.06, {"nominal_overlap": "keep"}, -0.06, 0.06), (0.9, {}, 0.1, 0.0)],
    ids=["closed", "kept", "open"],
)
def test_overlap_is_closed_at_pairs_and_welds_unless_intended_and_reported(thickness, keys, gap, overlap, cache):
    assembly = assemble(lap(thickness, **keys), cache)
    np.testing.assert_allclose(assembly.contacts.gap, gap, rtol=1e-9)
    np.testing.assert_allclose(mean_gaps(assembly), gap, rtol=1e-9)
    np.testing.assert_allclose(assembly.contacts.overlap, overlap, rtol=1e-9)
    np.testing.assert_allclose(assembly.contacts.overlapping, assembly.contacts.area * bool(overlap), rtol=1e-9)


@pytest.mark.slow
def test_overlap_beyond_the_limit_is_refused_with_the_remedy(cache):
    with pytest.raises(
        SceneError, match=r"zones\[0\] \(lap\).*0\.4 mm at \(.*at most 0\.35 mm.*half a thickness.*keep"
    ):
        assemble(lap(1.4, nominal_overlap=0.35), cache)
    assert (assemble(lap(1.4, nominal_overlap=0.41), cache).contacts.gap == 0).all()
    thicker = lap(1.0)
    for thickness, refused in ((2.0, False), (2.02, True)):  # of one sheet: overlap by 0.5 and 0.51 of the other
        thicker.parts[0] = thicker.parts[0].model_copy(update={"thickness": thickness})
        if refused:
            with pytest.raises(SceneError, match=r"zones\[0\] \(lap\).*0\.51 mm at \(.*at most 0\.5 mm"):
                assemble(thicker, cache)
        else:
            assert (assemble(thicker, cache).contacts.gap == 0).all()


def test_a_weld_where_no_pair_lies_has_the_same_limit(cache):
    scene = lap(1.0).model_copy(update={"zones": []})
    scene.parts[0] = scene.parts[0].model_copy(update={"thickness": 2.4})
    with pytest.raises(SceneError, match=r"welds\[0\] \(W1\).*0\.7 mm"):
        assemble(scene, cache)


@pytest.mark.slow
def test_check_reports_and_draws_the_overlap(tmp_path, cache, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("MIC_CACHE", str(cache))
    folder = tmp_path / "scene"
    mic.examples.copy("lap_joint", folder)
    text = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(text.replace("thickness = 1\n", "thickness = 1.06\n"))
    done = CliRunner().invoke(
        app, ["check", str(folder), "--overlap", str(tmp_path / "map.png"), "--page", str(tmp_path / "check.html")]
    )
    assert done.exit_code == 0, done.output
    assert "0.060 mm deep, over 1000 mm²: set to zero" in done.output
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("gap, welds", [(0.01, []), (0.1, ["W2"])])
def test_welds_that_freeze_a_gap_wider_than_chords_explain_are_reported(gap, welds, cache):
    scene = lap(1 - gap)
    scene.welds[0] = scene.welds[0].model_copy(update={"close": True})
    assert [sentence.split(" and")[0] for sentence in frozen_gaps(assemble(scene, cache))] == [
        f"weld {name} lies over a nominal gap of {gap:.3f} mm" for name in welds
    ]


@pytest.mark.fem
@pytest.mark.slow
def test_a_nominal_assembly_with_closed_overlap_does_not_move(cache):
    closed = mic.reduce(lap(1.06, pairs=62), cache)
    nothing = np.zeros(len(closed.parameters))
    evaluation = closed.evaluate(nothing)
    assert np.abs(evaluation.measurements).max() < 2e-3
    assert evaluation.resolutions["release"].force[0, :, 0].sum() < 0.05 * 120
    kept = mic.reduce(lap(1.06, pairs=62, nominal_overlap="keep"), cache).evaluate(nothing)
    assert np.abs(kept.measurements).max() > 2e-2
