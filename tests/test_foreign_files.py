"""Files of a user: readers open, run and raise nothing else than allowed, and neither does a stranger's scene."""

import importlib.util
import os
import py_compile
import re
import shutil
import sys
import typing
from pathlib import Path

import numpy as np
import pytest
from support.attack_foreign_files import NODES, READERS_OF, damaged, originals, trouble
from support.gmsh_files import gmsh_model
from support.mesh_texts import ABAQUS, FILES
from typer.testing import CliRunner

import mic
from mic import cli, wizard
from mic.compliance.matrices import read_matrix
from mic.errors import FormatError, RunError, SceneError
from mic.geometry.readers import READERS, read_mesh
from mic.geometry.script import named_sizes
from mic.model.assembly import assemble
from mic.options import app
from mic.scene.keys import Table
from mic.scene.schema import Scene
from mic.system import foreign_files
from mic.system.foreign_files import ALSO_READ, NO_SCRIPTS, SETTINGS, reading, refuse_library_settings

LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint"
SCENE = (LAP / "scene.toml").read_text()
COMMAND = "General.ExpertMode = 1; SystemCall 'touch %s';"


@pytest.fixture(autouse=True)
def no_permission(monkeypatch):
    monkeypatch.delenv(ALSO_READ, raising=False)
    monkeypatch.delenv(NO_SCRIPTS, raising=False)


# ------------------------------------------------------------------------------------------------ helper programs


@pytest.mark.slow
@pytest.mark.fem
def test_reading_a_cad_file_runs_nothing(tmp_path, monkeypatch):
    """gmsh executes options beside its input and in its home, and scripts whose suffix it does not know."""
    pytest.importorskip("gmsh")
    home = tmp_path / "home"
    home.mkdir()
    for name in ("HOME", "GMSH_HOME"):
        monkeypatch.setenv(name, str(home))
    monkeypatch.chdir(home)
    command = COMMAND % (tmp_path / "ran")
    with gmsh_model() as gmsh:
        gmsh.model.occ.addRectangle(0, 0, 0, 20, 10)
        gmsh.model.occ.synchronize()
        gmsh.write(str(tmp_path / "part.step"))
    beside = [tmp_path / name for name in ("part.step.opt", "part.opt", ".gmshrc", ".gmsh-options", "default.opt")]
    for options in (*beside, home / ".gmshrc", home / ".gmsh-options"):
        options.write_text(command)
    surface, _ = read_mesh(tmp_path / "part.step", size=5.0)
    assert surface.areas.sum() == pytest.approx(200) and not (tmp_path / "ran").exists()
    for name in ("script.Step", "script.MeD"):
        (tmp_path / name).write_text(command)
        with pytest.raises(FormatError, match=re.escape(name)):
            read_mesh(tmp_path / name, size=5.0)
        assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_of_libraries_in_the_working_folder_are_refused(tmp_path, monkeypatch, name):
    """Each of these files can make a library load code; a stranger's scene may bring it along."""
    (tmp_path / name).write_text("")
    with pytest.raises(RunError, match=f"{re.escape(name)}: .* would read its settings from this file"):
        refuse_library_settings(tmp_path)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    refuse_library_settings(tmp_path)


def test_the_command_starts_with_that_check(tmp_path, monkeypatch, capsys):
    (tmp_path / ".petscrc").write_text("-dll_prepend evil")
    monkeypatch.chdir(tmp_path)
    ended = []
    monkeypatch.setattr("mic.execution.ranks.exit_together", lambda world, *end: ended.append(end))
    monkeypatch.setattr("sys.argv", ["mic", "check", str(LAP)])
    cli.main()
    assert ended[0][0] == 2 and ".petscrc" in ended[0][1]


# ------------------------------------------------------------------------------------------ nothing beyond the scene


@pytest.fixture
def folders(tmp_path):
    """A scene's folder with a deck, and a file outside of it, to which a link leads."""
    scene = tmp_path / "scene"
    scene.mkdir()
    (tmp_path / "secret.inc").write_text("*Node\n 1, 0., 0., 0.\n")
    (scene / "link.inc").symlink_to(tmp_path / "secret.inc")
    return scene


#: A line of each kind of deck that includes a file.
INCLUDES = {
    "inp": "*INCLUDE, INPUT={}\n",
    "inp of nodes": "*NODE, INPUT={}\n",
    "bdf": "INCLUDE '{}'\n",
    "k": "*KEYWORD\n*INCLUDE\n{}\n",
}


@pytest.mark.parametrize("kind", INCLUDES)
@pytest.mark.parametrize("name", ["../secret.inc", "{}/secret.inc", "link.inc", "x/../../secret.inc", "/etc/passwd"])
def test_a_deck_includes_nothing_from_outside(folders, monkeypatch, kind, name):
    deck = folders / f"deck.{kind.split()[0]}"
    deck.write_text(INCLUDES[kind].format(name.format(folders.parent)))
    with pytest.raises(
        FormatError, match=r"deck\..*line .*it includes .* lies outside of the scene's folder .*--also-read"
    ):
        read_mesh(deck)
    if name == "../secret.inc" and kind == "inp":
        monkeypatch.setenv(ALSO_READ, str(folders.parent))
        with pytest.raises(FormatError, match="no triangles or quadrilaterals"):
            read_mesh(deck)


def test_a_deck_includes_files_of_its_scene(folders):
    (folders / "decks").mkdir()
    (folders / "common.inp").write_text(ABAQUS)
    (folders / "decks" / "a.inp").write_text("*INCLUDE, INPUT=../common.inp\n")
    assert len(read_mesh(folders / "decks" / "a.inp", folder=folders)[0].triangles) == 3
    with pytest.raises(FormatError, match="lies outside"):
        read_mesh(folders / "decks" / "a.inp")


@pytest.mark.parametrize(
    "kind, text", [("HDF", "{}/secret.h5:/points"), ("Binary", "{}/secret.inc"), ("HDF", "../a.h5:/x")]
)
def test_xdmf_names_no_data_outside(folders, kind, text):
    item = f'<DataItem Format="{kind}" Dimensions="1 3">{text.format(folders.parent)}</DataItem>'
    grid = f'<Xdmf Version="3.0"><Domain><Grid><Geometry GeometryType="XYZ">{item}</Geometry></Grid></Domain></Xdmf>'
    (folders / "a.xdmf").write_text(grid)
    with pytest.raises(FormatError, match=r"a\.xdmf: it names .*lies outside of the scene's folder"):
        read_mesh(folders / "a.xdmf")


@pytest.mark.parametrize("opening", [open, np.fromfile, np.loadtxt, Path.read_bytes, os.open])
def test_no_reader_opens_a_file_outside(folders, monkeypatch, opening):
    """Also a reader that will be added some day."""

    def read(path):
        target = folders.parent / "secret.inc"
        opening(target, os.O_RDONLY) if opening is os.open else opening(target)

    monkeypatch.setitem(READERS, ".new", read)
    (folders / "a.new").write_text("")
    with pytest.raises(FormatError, match=r"a\.new: it names .*secret\.inc, which lies outside"):
        read_mesh(folders / "a.new")
    open(folders.parent / "secret.inc").close()  # allowed again


def keys_of_files(table, at=""):
    """Keys of a table of the scene, and of the tables in it, that name files."""
    for name, field in table.model_fields.items():
        for kind in [field.annotation, *typing.get_args(field.annotation)]:
            metadata = [*field.metadata, *getattr(kind, "__metadata__", ())]
            if any("_file_name" in repr(one) for one in metadata):
                yield f"{at}{name}"
            for inner in [
                kind,
                *typing.get_args(kind),
                *[x for y in typing.get_args(kind) for x in typing.get_args(y)],
            ]:
                if isinstance(inner, type) and issubclass(inner, Table):
                    yield from keys_of_files(inner, f"{at}{name}.")


def write_scene(folder, old, new):
    """Write the scene of the lap joint with another text in one place."""
    assert old in SCENE
    (folder / "scene.toml").write_text(SCENE.replace(old, new, 1))
    shutil.copy(LAP / "geometry.py", folder)


LOCATED = 'name = "x"\nkind = "measured"\npart = "lower"\nfiles = "{}"'
MATCHED = '[[optimise.matching]]\nname = "?"\nfile = "{0}"\n\n'
#: A scene's lines that name a file, by key.
NAMING = {
    "parts.mesh": ('geometry = "geometry.py"\nsize = "medium"', 'mesh = "{}"'),
    "parts.geometry": ('geometry = "geometry.py"', 'geometry = "{}"'),
    "parts.stiffness": ('geometry = "geometry.py"\nsize = "medium"', 'mesh = "a.inp"\nstiffness = "{}"'),
    "parts.compliance": ('geometry = "geometry.py"\nsize = "medium"', 'mesh = "a.inp"\ncompliance = "{}"'),
    "fixtures.mesh": ("[[stages]]", '[[fixtures]]\nname = "f"\nmesh = "{}"\n\n[[stages]]'),
    "deviations.files": ("[[stages]]", f"[[deviations]]\n{LOCATED}\n\n[[stages]]"),
    "monte_carlo.table": ("samples = 200\nseed = 1", 'table = "{}"'),
    "optimise.matching.file": ("[[stages]]", f"{MATCHED.replace('?', 'm')}{MATCHED.replace('?', 'n')}[[stages]]"),
    "locators.file": ("[[stages]]", '[[locators]]\nfile = "{}"\n\n[[stages]]'),
    "welds.file": ("[[stages]]", '[[welds]]\nfile = "{}"\n\n[[stages]]'),
}


def test_every_key_that_names_a_file_is_tried():
    declared = {*keys_of_files(Scene)}
    assert declared == {key for key in NAMING if key not in ("locators.file", "welds.file")}


@pytest.mark.parametrize("key", NAMING)
@pytest.mark.parametrize("name", ["../secret.inc", "/etc/passwd", "link.inc"])
def test_no_key_of_a_scene_names_a_file_outside(folders, key, name):
    write_scene(folders, *(text.format(name) for text in NAMING[key]))
    with pytest.raises(SceneError, match="lies outside of the scene's folder .*--also-read") as caught:
        mic.load_scene(folders)
    assert key.split(".")[0] in str(caught.value)


@pytest.mark.slow
def test_measured_files_are_followed_to_where_they_lie(folders, cache):
    """A pattern does not show where its files lie."""
    write_scene(folders, "[[stages]]", f"[[deviations]]\n{LOCATED.format('*.inc')}\n\n[[stages]]")
    with pytest.raises(SceneError, match=r"link\.inc: it lies outside|measured points cannot be read from \.inc"):
        assemble(mic.load_scene(folders), cache)
    (folders / "link.inc").rename(folders / "link.csv")
    write_scene(folders, "[[stages]]", f"[[deviations]]\n{LOCATED.format('*.csv')}\n\n[[stages]]")
    with pytest.raises(SceneError, match=r"link\.csv: it lies outside"):
        assemble(mic.load_scene(folders), cache)


# --------------------------------------------------------------------------------------------------------- scripts


def test_scripts_are_refused_on_request(tmp_path, monkeypatch):
    for name in ("scene.toml", "geometry.py"):
        shutil.copy(LAP / name, tmp_path)
    (tmp_path / "geometry.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    monkeypatch.setenv(NO_SCRIPTS, "")
    done = CliRunner().invoke(app, ["check", str(tmp_path), "--no-scripts"])
    assert isinstance(done.exception, SceneError) and not (tmp_path / "ran").exists()
    assert str(done.exception).count("is a program, and --no-scripts refuses it; give the part a mesh file") == 2


def test_a_compiled_file_does_not_replace_a_script(tmp_path):
    """Python would run it without a look at the source."""
    (tmp_path / "other.py").write_text("raise SystemExit('another program')")
    py_compile.compile(
        str(tmp_path / "other.py"),
        importlib.util.cache_from_source(tmp_path / "geometry.py"),
        invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH,
    )
    (tmp_path / "geometry.py").write_text("SIZES = {'fine': 2.0}\ndef build(part, size): pass\n")
    assert named_sizes("a", tmp_path / "geometry.py") == {"fine": 2.0}


@pytest.mark.slow
def test_folders_named_by_the_user_are_added(folders, monkeypatch):
    monkeypatch.setenv(ALSO_READ, "")
    write_scene(folders, *(text.format("../secret.inc") for text in NAMING["fixtures.mesh"]))
    done = CliRunner().invoke(app, ["check", str(folders), "--also-read", str(folders.parent)])
    assert "there is no reader of .inc" in str(done.exception)
    done = CliRunner().invoke(app, ["check", str(folders), "--also-read", str(folders / "none")])
    assert "--also-read" in str(done.exception) and "there is no such folder" in str(done.exception)


# ------------------------------------------------------------------------------------------------------- the gate


@pytest.mark.slow
def test_links_that_lead_in_circles_are_not_followed(tmp_path, cache):
    (tmp_path / "scans").mkdir()
    for name in "abc":
        (tmp_path / "scans" / name).symlink_to(tmp_path / "scans")
    located = LOCATED.format("scans/**/none.csv")
    write_scene(tmp_path, "[[stages]]", f"[[deviations]]\n{located}\n\n[[stages]]")
    with pytest.raises(SceneError, match=r"there is no file 'scans/\*\*/none.csv'"):
        assemble(mic.load_scene(tmp_path), cache)


#: Small files that claim much.
CLAIMS = {
    "a.msh": "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n1 0 0 0\n2 1 0 0\n500000000 0 1 0\n$EndNodes\n"
    "$Elements\n1\n1 2 2 1 1 1 2 500000000\n$EndElements\n",
    "a.mtx": "%%MatrixMarket matrix array real general\n40000 40000\n1\n",
}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux bounds the memory of a reader")
@pytest.mark.parametrize("name", CLAIMS)
def test_small_files_do_not_take_gigabytes(tmp_path, monkeypatch, name):
    monkeypatch.setattr(foreign_files, "MEMORY", 300_000_000)
    (tmp_path / name).write_text(CLAIMS[name])
    (tmp_path / "a.csv").write_text(NODES)
    with pytest.raises(FormatError, match=r"needs more than 0\.3 GB of memory"):
        (read_matrix if name == "a.mtx" else read_mesh)(tmp_path / name)
    np.zeros(50_000_000)  # the bound is gone


@pytest.mark.parametrize("name", ["a\\u0000.inp", "\\u001b[2J", "x" * 300, ""])
def test_names_that_no_file_can_have_are_refused(tmp_path, name):
    write_scene(tmp_path, *(text.format(name) for text in NAMING["parts.mesh"]))
    with pytest.raises(SceneError, match=r"parts\[0\]\.mesh \(lower\): (a file name has|String should have)"):
        mic.load_scene(tmp_path)


def test_errors_without_end_are_counted(tmp_path):
    keys = "".join(f"k{i} = 1\n" for i in range(5000))
    (tmp_path / "scene.toml").write_text(keys + SCENE)
    with pytest.raises(SceneError, match="k0: unknown key") as caught:
        mic.load_scene(tmp_path)
    lines = str(caught.value).splitlines()
    assert len(lines) == 101 and lines[-1].endswith("4900 more errors; correct these first")


def test_nesting_by_names_is_bounded(tmp_path):
    (tmp_path / "scene.toml").write_text("a" + ".a" * 3000 + " = 1\n")
    with pytest.raises(SceneError, match=r"scene\.toml: tables or lists are nested too deeply"):
        mic.load_scene(tmp_path)


def test_a_pipe_and_a_folder_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "a.inp")
    (tmp_path / "b.inp").mkdir()
    for name in ("a.inp", "b.inp"):
        with pytest.raises(FormatError, match="is no file, but a folder, pipe or device"):
            read_mesh(tmp_path / name)


def test_a_file_beyond_all_bounds_is_not_read(tmp_path):
    with open(tmp_path / "a.stl", "wb") as file:
        file.truncate(foreign_files.LARGEST + 1)
    with pytest.raises(FormatError, match="has 4 GB, more than 4"):
        read_mesh(tmp_path / "a.stl")


@pytest.mark.parametrize("problem", [RecursionError("deep"), SystemExit(3), UnicodeError("é"), OSError(5, "x")])
def test_whatever_is_raised_becomes_one_sentence(tmp_path, problem, capsys):
    (tmp_path / "a.csv").write_text("")
    name = "exit" if isinstance(problem, SystemExit) else type(problem).__name__
    sentence = rf"a\.csv: this table cannot be read: it is cut short, damaged or not .* \({name}.*format$"
    with pytest.raises(SceneError, match=sentence):
        with reading(tmp_path / "a.csv", "table", error=SceneError):
            print("\x1b[2J")
            raise problem
    assert not any(capsys.readouterr())


@pytest.mark.parametrize("kind", ["mesh", "table", "cloud", "matrix", "samples", "scene"])
def test_damaged_files_of_every_format_are_read_or_refused(tmp_path, kind):
    contents = [(name, content) for name, content in originals().items() if name.startswith(kind)]
    (tmp_path / "matrix.csv").write_text(NODES)
    rng = np.random.default_rng(7)
    for i in range(60 if kind == "mesh" else 12):
        name, content = contents[i % len(contents)]
        (tmp_path / name).write_bytes(damaged(content, rng))
        assert trouble(tmp_path / name) is None, name


def test_the_originals_are_read(tmp_path):
    """Otherwise the tests with damaged files would prove nothing."""
    (tmp_path / "matrix.csv").write_text(NODES)
    for name, content in originals().items():
        (tmp_path / name).write_bytes(content)
        READERS_OF[name.partition("-")[0].partition(".")[0]](tmp_path / name)


# ---------------------------------------------------------------------------------------------------------- wizard


def test_a_proposed_scene_holds_its_files(tmp_path):
    """A scene reads its folder alone, so the wizard copies meshes and what they include."""
    decks = tmp_path / "decks"
    (decks / "common").mkdir(parents=True)
    scaled = "\n".join(
        ", ".join([first, *(f"{100 * float(x)}" for x in rest)]) if line.count(",") == 3 and "." in line else line
        for line in ABAQUS.splitlines()
        for first, *rest in [line.split(",")]
    )
    (decks / "common" / "a.inc").write_text(scaled)
    (decks / "a.inp").write_text("*INCLUDE, INPUT=common/a.inc\n")
    folder, _ = wizard.write_scene([decks / "a.inp"], tmp_path / "out", {None: 1.0})
    assert {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()} == {
        "scene.toml",
        "a.inp",
        "common/a.inc",
    }
    assert mic.load_scene(folder).parts[0].mesh == "a.inp"


def test_every_format_is_in_the_attack():
    suffixes = {Path(name).suffix for name in originals() if name.startswith("mesh")}
    assert set(READERS) - suffixes == {".med", ".xdmf"} and set(FILES) <= {name[5:] for name in originals()}
