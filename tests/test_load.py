"""Surfaces of parts from files and scripts: cached meshes, and the messages of failed scripts."""

import os
import runpy
import signal
import sys
import time
from importlib import import_module

import numpy as np
import pytest
from support.mesh_texts import ABAQUS

from mic.errors import SceneError
from mic.geometry import script as geometry_script
from mic.geometry import script_dependencies
from mic.geometry.load import load_fixture, load_part
from mic.geometry.script import load_script, named_sizes
from mic.scene.fixture import Fixture
from mic.scene.part import Part

STRIP = """
import sys

import numpy as np
SIZES = {"coarse": 2.0}
def build(part, size):
    open(__file__ + ".calls", "a").write(f"{part} {size}\\n")
    return np.array([[0, 0, 0], [size, 0, 0], [size, 1, 0], [0, 1, 0.0]]), [[0, 1, 2], [0, 2, 3]]
"""


def part(**keys):
    return Part(name="sheet", thickness=1.0, young=210e3, poisson=0.3, **keys)


def script(tmp_path, text, size=2.0):
    (tmp_path / "geometry.py").write_text(text)
    return load_part(part(geometry="geometry.py", size=size), tmp_path, tmp_path / "cache").surface


@pytest.fixture
def forked(monkeypatch):
    """Scripts run in a fork of this process, which starts faster than another one."""

    def run(command, seconds, environment):
        child = os.fork()
        if not child:
            sys.argv = command[-2:]
            runpy.run_path(geometry_script.__file__, run_name="__main__")
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

    monkeypatch.setattr(geometry_script, "run_program", run)


def calls(tmp_path):
    return (tmp_path / "geometry.py.calls").read_text().splitlines()


@pytest.mark.usefixtures("forked")
def test_a_script_runs_once_and_its_mesh_is_cached_with_its_normals(tmp_path):
    leaning = STRIP.replace("[0, 2, 3]]", "[0, 2, 3]], np.full((2, 3, 3), [0.3, 0, 1.0])")
    for _ in range(2):
        surface = script(tmp_path, leaning)
        assert surface.given_normals == pytest.approx(np.full((2, 3, 3), [0.3, 0, 1.0]))
        assert surface.corner_normals == pytest.approx(surface.given_normals / np.sqrt(1.09))
    assert calls(tmp_path) == ["sheet 2.0"] and surface.areas.sum() == pytest.approx(2)
    (cached,) = (tmp_path / "cache" / "meshes").iterdir()
    cached.write_bytes(cached.read_bytes()[:100])
    for _ in range(2):
        assert np.array_equal(script(tmp_path, leaning).points, surface.points)
    assert len(calls(tmp_path)) == 2  # the damaged file was replaced
    script(tmp_path, STRIP, size="coarse")
    assert len(calls(tmp_path)) == 3  # another size and script: another mesh


def test_packages_installed_beside_a_scene_are_no_inputs(tmp_path, monkeypatch):
    """As in a virtual environment in the same folder."""
    for name in ("packages", "scene"):
        (tmp_path / name).mkdir()
    (tmp_path / "packages" / "beside.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path / "packages")
    import_module("beside")
    folders = (*script_dependencies.library_folders(), f"{tmp_path / 'packages'}{os.sep}")
    monkeypatch.setattr(script_dependencies, "library_folders", lambda: folders)
    (tmp_path / "scene" / "part.inp").write_text(ABAQUS)
    loaded = load_part(part(mesh="part.inp"), tmp_path / "scene", tmp_path / "cache")
    assert list(loaded.inputs) == ["part.inp"]


BUILD = "def build(part, size):\n    return "
POINTS = "[[0, 0, 0], [1, 0, 0], [1, 1, 0]]"
BAD = {
    "gmsh is missing": ("import gmsh_", "needs the package gmsh_; install it: pip install gmsh_"),
    "a file beside it": ("import helper", "imports helper, a file in its folder"),
    "a name is missing": ("from math import sine", "cannot import name 'sine'"),
    "it raises": ("x = {}[17]", r"KeyError: 17 \(line 1 of the script\)"),
    "it does not want the part": ("def build(part, size):\n    raise ValueError('no such part')", "no such part"),
    "it exits": ("import sys\nsys.exit(1)", "exits instead of returning a mesh"),
    "it is no Python": ("def build(:", "SyntaxError"),
    "its build is no function": ("build = 3", "must define build"),
    "nothing returned": (BUILD + "None", "must return two arrays, points and triangles, or three.* not NoneType"),
    "normals of vertices": (BUILD + POINTS + ", [[0, 1, 2]], " + POINTS, "one at each corner of each triangle"),
    "ragged": (BUILD + "[[0, 0, 0], [1, 0]], [[0, 1, 2]]", "differ in length"),
    "plane points": (BUILD + "[[0, 0], [1, 0], [1, 1]], [[0, 1, 2]]", r"shape \(n, 3\), not \(3, 2\)"),
    "quadrilaterals": (BUILD + POINTS + ", [[0, 1, 2, 0]]", r"shape \(k, 3\)"),
    "NaN": (BUILD + POINTS.replace("[1, 1, 0]", "[1, float('nan'), 0]") + ", [[0, 1, 2]]", "not finite"),
    "half a number": (BUILD + POINTS + ", [[0, 1, 1.5]]", "not integers"),
    "out of range": (BUILD + POINTS + ", [[0, 1, 3]]", "outside 0..2"),
    "SIZES is a list": ("SIZES = [1]\n" + BUILD + "1", "SIZES must be a dict"),
}


@pytest.mark.usefixtures("forked")
@pytest.mark.parametrize("case", BAD)
def test_a_script_that_fails_ends_in_one_sentence(tmp_path, case):
    text, words = BAD[case]
    (tmp_path / "helper.py").write_text("")
    with pytest.raises(SceneError, match=words) as caught:
        script(tmp_path, text, size="coarse" if "SIZES" in text else 2.0)
    message = str(caught.value)
    assert message.startswith(f"part 'sheet': geometry: {tmp_path / 'geometry.py'}: ") and "\n" not in message
    assert not (tmp_path / "cache").exists()


@pytest.mark.usefixtures("forked")
def test_without_gmsh_the_message_names_the_extra(tmp_path):
    with pytest.raises(SceneError, match=r"needs the package gmsh; install it: pip install 'mic-contact\[mesh\]'"):
        script(tmp_path, "import sys\nsys.modules['gmsh'] = None\ndef build(part, size):\n    import gmsh")


HOSTILE = {
    "it ends the program": ("import os\nos._exit(0)", r"ends the program \(exit status 0\).*remove the exit"),
    "its mesh finds no room": (  # as on a full disk, nothing more can be written
        "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n" + BUILD + POINTS + ", [[0, 1, 2]]",
        "cannot be written into .*: free space on that disk, or set TMPDIR to",
    ),
    "it crashes": (
        f"import os\n{BUILD}os.kill(os.getpid(), {int(signal.SIGSEGV)})",
        r"crashes \(signal 11\).*run it on its own",
    ),
    "it raises many lines": ("raise RuntimeError('one\\ntwo\\n\\nthree')", "RuntimeError: one two three"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_script_that_does_harm_ends_in_one_sentence_too(tmp_path, case):
    text, words = HOSTILE[case]
    with pytest.raises(SceneError, match=words) as caught:
        script(tmp_path, text)
    assert str(caught.value).startswith(f"part 'sheet': geometry: {tmp_path / 'geometry.py'}: ")
    assert "\n" not in str(caught.value) and not (tmp_path / "cache").exists()


HANGS = {
    "a loop": "while True: pass",
    "deaf": "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\ntime.sleep(3600)",
    "waiting for input": "import sys, time\nsys.stdin.read()\ntime.sleep(3600)",
}


@pytest.mark.parametrize("case", HANGS)
@pytest.mark.slow
def test_a_script_that_never_ends_is_not_waited_for(tmp_path, case, monkeypatch):
    monkeypatch.setenv("MIC_SCRIPT_LIMIT", "0.8")
    begin = time.monotonic()
    with pytest.raises(SceneError, match=r"does not end within 0.8 s; correct its loop, .*MIC_SCRIPT_LIMIT"):
        script(tmp_path, HANGS[case])
    assert time.monotonic() - begin < 20


def gone(process):
    """Whether a process has ended or is a zombie."""
    try:
        os.kill(process, 0)
        with open(f"/proc/{process}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] == "Z"
    except (ProcessLookupError, FileNotFoundError):
        return True


@pytest.mark.slow
def test_processes_started_by_a_script_end_with_it(tmp_path, monkeypatch):
    monkeypatch.setenv("MIC_SCRIPT_LIMIT", "5")
    text = (
        "import pathlib, subprocess, sys, time\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(3600)'])\n"
        "pathlib.Path(__file__ + '.pid').write_text(str(child.pid))\n"
        "time.sleep(3600)"
    )
    with pytest.raises(SceneError, match="does not end"):
        script(tmp_path, text)
    child = int((tmp_path / "geometry.py.pid").read_text())
    until = time.monotonic() + 10
    while not gone(child):
        assert time.monotonic() < until, "it is still there"
        time.sleep(0.05)


RUBBISH = """
from __future__ import annotations
import sys, os, threading, time
from dataclasses import dataclass
@dataclass
class A:
    x: int
print("\\x00" * 100_000)
sys.stderr.write("warning! " * 10_000)
sys.stdout.close()
threading.Thread(target=time.sleep, args=(3600,)).start()
os.environ["HOME"] = "nowhere"
"""


def test_output_and_threads_of_a_script_do_no_harm(tmp_path, capfd):
    home = os.environ.get("HOME")
    assert script(tmp_path, RUBBISH + STRIP).areas.sum() == pytest.approx(2)
    assert capfd.readouterr() == ("", "") and os.environ.get("HOME") == home


@pytest.mark.usefixtures("forked")
def test_named_sizes_are_read_and_an_unknown_size_is_refused(tmp_path):
    with pytest.raises(SceneError, match="no size called 'huge'; known: coarse"):
        script(tmp_path, STRIP, size="huge")
    (tmp_path / "geometry.py").write_text("print('hello')\nSIZES = {'a': 2, 'b': 3.5}\ndef build(part, size): pass")
    assert named_sizes("sheet", tmp_path / "geometry.py") == {"a": 2.0, "b": 3.5}
    (tmp_path / "geometry.py").write_text("SIZES = {'a': 'large'}\ndef build(part, size): pass")
    with pytest.raises(SceneError, match=r"part 'sheet': geometry: .*geometry.py: .*'large'"):
        named_sizes("sheet", tmp_path / "geometry.py")


def test_a_script_must_be_a_python_file(tmp_path):
    (tmp_path / "geometry.txt").write_text(STRIP)
    with pytest.raises(ValueError, match="must be a Python file"):
        load_script(tmp_path / "geometry.txt")


def test_files_that_are_missing_or_bad_name_part_and_file(tmp_path):
    for keys in ({"mesh": "none.bdf"}, {"geometry": "none.py", "size": 2.0}):
        with pytest.raises(SceneError, match="part 'sheet': .*there is no file .*none"):
            load_part(part(**keys), tmp_path, tmp_path)
    (tmp_path / "bad.vtk").write_text("this is no mesh")
    with pytest.raises(SceneError, match="part 'sheet': mesh: .*bad.vtk: .*cannot be read"):
        load_part(part(mesh="bad.vtk"), tmp_path, tmp_path)
    with pytest.raises(SceneError, match="fixture 'pad': mesh: .*bad.vtk: .*cannot be read"):
        load_fixture(Fixture(name="pad", mesh="bad.vtk"), tmp_path)


def test_a_pad_is_a_disc_with_its_normal_outwards(tmp_path):
    pad, _ = load_fixture(Fixture(name="pad", point=(1, 2, 3), normal=(0, 0, -1), radius=4.0), tmp_path)
    assert pad.normals[:, 2] == pytest.approx(-1) and pad.points.mean(0) == pytest.approx([1, 2, 3])
    assert pad.areas.sum() == pytest.approx(np.pi * 16, rel=0.01)
