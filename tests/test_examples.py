"""The example scenes: found by name, copied out whole, and carried by the wheel."""

import subprocess
import sys
from pathlib import Path

import pytest
from recorded.record import SCENES
from typer.testing import CliRunner

import mic
from mic import examples
from mic.errors import RunError, SceneError
from mic.model.assembly import assemble
from mic.options import app

ROOT = Path(__file__).resolve().parents[1]


def test_every_example_is_a_scene():
    assert {"bracket", "hat_on_plate", "lap_joint", "wheelhouse"} <= set(examples.names())
    for name in examples.names():
        assert mic.load_scene(examples.folder(name)).name.replace("-", "_") == name


def test_every_example_is_recorded_listed_and_shown_in_the_gallery():
    """The numbers of a scene that is not recorded may change unseen."""
    assert sorted(SCENES) == examples.names()
    page = (ROOT / "meshes" / "README.md").read_text(encoding="utf-8")
    assert all(f"| `{name}` |" in page for name in examples.names())
    assert set(examples.names()) <= {path.stem for path in (ROOT / "docs" / "gallery").glob("*.py")}


def test_a_copy_holds_all_files_and_gives_the_same_meshes(tmp_path, cache):
    out = examples.copy("lap_joint", tmp_path / "deep" / "mine")
    assert {path.name for path in out.iterdir()} == {"scene.toml", "geometry.py"}
    wheelhouse = examples.copy("wheelhouse", tmp_path / "wheelhouse")
    more = {"watched.toml", "table1.toml", "README.md", "paper.toml", "meshes.npz"}
    assert {path.name for path in wheelhouse.iterdir()} == {"scene.toml", "geometry.py"} | more
    copied, shipped = (assemble(mic.load_scene(path), cache) for path in (out, examples.folder("lap_joint")))
    for one, other in zip(copied.parts, shipped.parts):
        assert (one.surface.points == other.surface.points).all()


def test_the_large_scene_is_written_by_its_script():
    folder = ROOT / "meshes" / "body_side"
    written = subprocess.run([sys.executable, folder / "write.py"], capture_output=True, text=True, check=True).stdout
    assert (folder / "body_side.toml").read_text(encoding="utf-8") == written
    scene = mic.load_scene(folder / "body_side.toml")
    assert (len(scene.parts), len(scene.zones), len(scene.welds), len(scene.clamps)) == (12, 21, 66, 24)


def test_nothing_is_overwritten_and_names_are_checked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert examples.copy("lap_joint") == Path("lap_joint")
    (tmp_path / "lap_joint" / "scene.toml").write_text("mine")
    with pytest.raises(RunError, match="lap_joint: this already exists"):
        examples.copy("lap_joint")
    assert (tmp_path / "lap_joint" / "scene.toml").read_text() == "mine"
    with pytest.raises(SceneError, match=f"no example scene called 'lap'; .* {', '.join(examples.names())}"):
        examples.copy("lap", tmp_path / "lap")
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="cannot be written"):
        examples.copy("lap_joint", tmp_path / "file" / "below")


def test_init_names_the_copied_folder_and_the_next_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "mine"
    result = CliRunner().invoke(app, ["init", "--example", "hat_on_plate", "--out", str(out)])
    assert result.exit_code == 0 and f"mic check {out}" in result.stdout
    assert (out / "scene.toml").is_file()
