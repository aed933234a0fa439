"""Changed inputs of every kind: results of other inputs are neither used nor lost."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from support.runs import RecordedProgress

import mic
from mic.errors import RunError
from mic.geometry.load import load_part
from mic.model.assembly import assemble
from mic.results.outcome import read_outcome
from mic.results.run_identity import identity, inputs
from mic.runs import conclude, read_run, sample_into
from mic.scene.part import Part
from mic.system.files import Format, save_json

pytestmark = pytest.mark.robustness

LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint"
LAWS = ["coulomb", "frictionless"]
SCRIPT = """
from pathlib import Path
import numpy as np
HERE = Path(__file__).parent
def build(part, size):
    length = {read}
    return np.array([[0, 0, 0], [length, 0, 0], [length, 1, 0], [0, 1, 0.0]]), [[0, 1, 2], [0, 2, 3]]
"""
#: Ways in which a script may read a file beside it, and what follows in the script.
READERS = {
    "pathlib": ("float((HERE / 'length.txt').read_text())", ""),
    "declared": ("float(np.fromfile(HERE / 'length.txt', sep=' ')[0])", "DEPENDS = ['length.txt']\n"),
}


def few_pairs(folder):
    """A copy of the lap joint in a folder, with few contact pairs."""
    copy = shutil.copytree(LAP, folder / "scene")
    toml = copy / "scene.toml"
    toml.write_text(toml.read_text().replace("friction = 0.27", "friction = 0.27\npairs = 6"))
    return copy


@pytest.fixture
def scene(tmp_path):
    """A copy of the lap joint, to be changed."""
    return few_pairs(tmp_path)


def write_script(folder, read, rest="", **files):
    """A geometry script that reads its length, and text files by their stem."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "geometry.py").write_text(SCRIPT.format(read=read) + rest)
    for name, text in files.items():
        (folder / f"{name}.txt").write_text(text)


def built(folder, cache):
    """Length of the sheet that the script of a folder builds, and the files that it read."""
    loaded = load_part(Part(name="sheet", thickness=1.0, size=2.0, geometry="geometry.py"), folder, cache)
    return loaded.surface.points[:, 0].max(), loaded.inputs


@pytest.mark.slow
@pytest.mark.parametrize("way", READERS)
def test_a_mesh_is_made_again_when_a_file_read_by_its_script_changes(tmp_path, way):
    write_script(tmp_path, *READERS[way], length="3")
    first, read = built(tmp_path, tmp_path / "cache")
    assert first == 3 and "length.txt" in read and built(tmp_path, tmp_path / "cache")[1] == read
    (tmp_path / "length.txt").write_text("5")
    second, changed = built(tmp_path, tmp_path / "cache")
    assert second == 5 and changed != read


@pytest.mark.slow
def test_a_file_that_a_script_looked_for_in_vain_counts_once_it_is_there(tmp_path):
    read = "3.0\n    try: length = float(open(HERE / 'better.txt').read())\n    except FileNotFoundError: pass"
    write_script(tmp_path, read)
    assert built(tmp_path, tmp_path / "cache")[0] == 3
    (tmp_path / "better.txt").write_text("7")
    assert built(tmp_path, tmp_path / "cache")[0] == 7


@pytest.mark.slow
@pytest.mark.parametrize("path", ["HERE.parent / 'length.txt'", "'length.txt'"], ids=["beside", "working folder"])
def test_copies_of_a_scene_beside_other_data_have_meshes_of_their_own(tmp_path, monkeypatch, path):
    for name, length in (("one", "3"), ("two", "5")):
        write_script(tmp_path / name / "scene", f"float(open({path}).read())")
        (tmp_path / name / "length.txt").write_text(length)
        monkeypatch.chdir(tmp_path / name)
        assert built(tmp_path / name / "scene", tmp_path / "cache")[0] == float(length)


@pytest.mark.slow
def test_a_copy_of_a_script_that_reads_the_data_of_the_first_follows_them(tmp_path):
    data = tmp_path / "one" / "length.txt"
    for name in ("one", "two"):
        write_script(tmp_path / name, f"float(open({str(data)!r}).read())", length="3")
    assert built(tmp_path / "one", tmp_path / "cache")[0] == 3
    data.write_text("5")
    assert built(tmp_path / "two", tmp_path / "cache")[0] == 5


def identity_of(folder, cache):
    return identity(assemble(mic.load_scene(folder), cache), 1)


@pytest.fixture(scope="module")
def unchanged(cache, tmp_path_factory):
    """Identity of the lap joint with few contact pairs."""
    return identity_of(few_pairs(tmp_path_factory.mktemp("unchanged")), cache)


@pytest.mark.slow
@pytest.mark.parametrize(
    "file, old, new", [("scene.toml", 'size = "medium"', "size = 2.4"), ("geometry.py", "", "#\n")]
)
def test_a_change_of_the_meshes_or_of_their_script_changes_the_identity(scene, unchanged, cache, file, old, new):
    text = (scene / file).read_text()
    assert old in text
    (scene / file).write_text(text.replace(old, new, 1))
    assert identity_of(scene, cache) != unchanged


@pytest.mark.slow
def test_texts_samples_and_laws_do_not_change_the_identity(scene, unchanged, cache):
    toml = scene / "scene.toml"
    text = toml.read_text().replace("samples = 200", "samples = 300").replace("Two flat strips", "Strips")
    toml.write_text(text.replace('laws = ["coulomb", "associated", "frictionless"]', 'laws = ["coulomb"]'))
    assert identity_of(scene.rename(scene.with_name("moved")), cache) == unchanged


@pytest.mark.slow
def test_the_mesh_of_a_fixture_belongs_to_the_identity(scene, cache):
    toml = scene / "scene.toml"
    toml.write_text(toml.read_text() + '\n[[fixtures]]\nname = "rest"\nmesh = "rest.stl"\n')
    corners = "vertex 0 0 {z}\nvertex 9 0 {z}\nvertex 0 9 {z}\n"
    stl = f"solid s\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid s\n"
    found = []
    for z in (-5, -5.3):
        (scene / "rest.stl").write_text(stl.format(z=z))
        found.append(inputs(assemble(mic.load_scene(scene), cache), 1))
    assert found[0]["files"]["rest.stl"] != found[1]["files"]["rest.stl"] and found[0]["scene"] == found[1]["scene"]


@pytest.fixture(scope="module")
def whole(lap_model, tmp_path_factory):
    """Results folder of 110 samples under two laws."""
    folder = tmp_path_factory.mktemp("whole")
    sample_into(folder, lap_model, LAWS, 110, 4)
    return folder


@pytest.mark.slow
def test_fewer_samples_and_laws_reuse_blocks_and_lose_none(lap_model, whole, tmp_path):
    run = shutil.copytree(whole, tmp_path / "run")
    expected = read_outcome(whole).measured("coulomb", "M1")
    files = {path: path.stat().st_mtime_ns for path in run.rglob("*.parquet")}
    assert sample_into(run, lap_model, ["coulomb"], 70, 4) == {"coulomb": 70}
    outcome = conclude(run)
    np.testing.assert_array_equal(outcome.measured("coulomb", "M1"), expected[:70])
    assert outcome.summary()["samples"] == 70 and outcome.missing == {"coulomb": 0} and outcome.laws == ["coulomb"]
    assert sample_into(run, lap_model, LAWS, 110, 4) == dict.fromkeys(LAWS, 110)
    assert files == {path: path.stat().st_mtime_ns for path in files}


@pytest.mark.slow
def test_an_extended_run_equals_a_run_of_all_samples(lap_model, sixty, whole, tmp_path):
    run = shutil.copytree(sixty, tmp_path / "run")
    assert sample_into(run, lap_model, ["coulomb"], 110, 4) == {"coulomb": 50}
    found, expected = read_outcome(run), read_outcome(whole)
    assert found.sample_numbers("coulomb").tolist() == list(range(110))
    stored = pd.read_parquet(run / "samples")["sample"]
    assert stored.tolist() == list(range(110))  # the last block of the shorter run was removed
    np.testing.assert_array_equal(found.measured("coulomb", "M1"), expected.measured("coulomb", "M1"))
    forces = [one.contact("coulomb", "clamp", "f_n") for one in (found, expected)]
    np.testing.assert_array_equal(*forces)


@pytest.mark.slow
def test_a_block_of_another_run_is_neither_used_nor_lost(lap_model, tmp_path):
    mine, other, law = tmp_path / "mine", tmp_path / "other", ["frictionless"]
    sample_into(mine, lap_model, law, 10, 4)
    sample_into(other, lap_model, law, 10, 5)
    expected = read_run(mine).measured(*law, "M1")
    for path in other.glob("*/law=*/*"):
        shutil.copy(path, mine / path.relative_to(other))
    outcome = read_run(mine)
    assert outcome.missing == {"frictionless": 10} and "another run" in outcome.damaged[0]
    progress = RecordedProgress()
    assert sample_into(mine, lap_model, law, 10, 4, progress) == {"frictionless": 0}
    assert "belongs to another run" in progress.sentences[0]
    np.testing.assert_array_equal(read_run(mine).measured(*law, "M1"), expected)
    (aside,), (block,) = mine.glob("samples/*/*.other-run"), other.glob("samples/*/*.parquet")
    assert aside.read_bytes() == block.read_bytes()


def test_an_edited_record_relabels_nothing(lap_model, sixty, tmp_path):
    shutil.copytree(sixty, tmp_path, dirs_exist_ok=True)
    record = json.loads((tmp_path / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps(record | {"seed": 9}))
    with pytest.raises(mic.FormatError, match="run.json.*damaged"):
        conclude(tmp_path)
    with pytest.raises(RunError, match="another run"):
        sample_into(tmp_path, lap_model, ["coulomb"], 60, 9)
    assert sample_into(tmp_path, lap_model, ["coulomb"], 60, 4) == {"coulomb": 60}


@pytest.mark.slow
def test_a_model_of_another_run_is_not_used(lap_model, sixty, tmp_path):
    shutil.copytree(sixty, tmp_path, dirs_exist_ok=True)
    lap_model.with_friction(0.1).save(tmp_path / "model.npz")
    with pytest.raises(RunError, match="model.npz: belongs to another run"):
        read_run(tmp_path)


def test_results_of_another_version_of_the_program_are_refused(lap_model, sixty, tmp_path, monkeypatch):
    shutil.copytree(sixty, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr("mic.results.run_identity.program_version", lambda: "9.9")
    assert len(read_run(tmp_path).measured("coulomb", "M1")) == 60  # they may be read
    with pytest.raises(RunError, match="version of the program.*9.9 requested"):
        sample_into(tmp_path, lap_model, ["coulomb"], 10, 4)


@pytest.mark.parametrize("name", ["run.json", "summary.json", "model.npz", "report.html", "paper.toml"])
def test_a_foreign_file_under_a_name_of_the_run_stays(lap_model, tmp_path, name):
    (tmp_path / name).write_text('{"mine": 1}')
    for replace in (False, True):
        with pytest.raises(RunError, match=f"{name}.*--out"):
            sample_into(tmp_path, lap_model, ["coulomb"], 10, 4, replace=replace)
    assert [path.name for path in tmp_path.iterdir()] == [name] and (tmp_path / name).read_text() == '{"mine": 1}'


def test_replacing_removes_only_files_of_the_run(lap_model, tmp_path):
    sample_into(tmp_path, lap_model, LAWS, 10, 4)
    conclude(tmp_path)
    names = ("notes.md", "samples/precious/data.csv", "samples/law=coulomb/mine.parquet", "fields/a.vtu")
    foreign = [tmp_path / name for name in names]
    for path in foreign:
        path.parent.mkdir(exist_ok=True)
        path.write_text("mine")
    with pytest.raises(RunError, match=r"another run \(seed: 4 in the folder, 5 requested\).*--out.*--replace"):
        sample_into(tmp_path, lap_model, LAWS, 10, 5)
    assert read_run(tmp_path).record["seed"] == 4 and read_run(tmp_path).missing == dict.fromkeys(LAWS, 0)
    assert sample_into(tmp_path, lap_model, ["frictionless"], 10, 5, replace=True) == {"frictionless": 0}
    assert read_run(tmp_path).record["seed"] == 5 and all(path.read_text() == "mine" for path in foreign)
    assert len(pd.read_parquet(tmp_path / "samples" / "law=frictionless")) == 10
    assert not (tmp_path / "summary.json").exists() and not (tmp_path / "contacts" / "law=coulomb").exists()


@pytest.mark.parametrize("link", ["samples", "samples/law=coulomb", "tables", "run.json"])
def test_links_are_not_followed_out_of_the_folder(lap_model, sixty, tmp_path, link):
    target, run = shutil.copytree(sixty, tmp_path / "target"), tmp_path / "run"
    (target / "tables").mkdir(exist_ok=True)
    before = {path: path.stat().st_mtime_ns for path in target.rglob("*")}
    (run / link).parent.mkdir(parents=True)
    (run / link).symlink_to(target / link)
    for replace in (False, True):
        with pytest.raises(RunError, match="is a link.*remove the link"):
            sample_into(run, lap_model, ["coulomb"], 10, 5, replace=replace)
    assert before == {path: path.stat().st_mtime_ns for path in target.rglob("*")}


def test_a_record_of_an_older_format_is_refused_and_may_be_replaced(lap_model, tmp_path):
    save_json(tmp_path / "run.json", Format("record of a run", 1, ""), {"seed": 4})
    with pytest.raises(RunError, match="older version of the program.*--replace"):
        sample_into(tmp_path, lap_model, ["coulomb"], 10, 4)
    assert sample_into(tmp_path, lap_model, ["coulomb"], 10, 4, replace=True) == {"coulomb": 0}
