"""From files of scans to deviations and verdicts: mic predict --scan."""

import shutil
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from support.scans import scanned, write_ply
from typer.testing import CliRunner

import mic
from fem_reference.full.model import FullModel
from mic.errors import FormatError, SceneError
from mic.model.assembly import assemble
from mic.options import app
from mic.results.schema import PREDICTIONS, SCANS
from mic.scene.load import read_table
from mic.studies.prediction import Predictor
from mic.studies.scan import ScanReader, scan_files

pytestmark = [pytest.mark.fem, pytest.mark.slow]
LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint"
FORCES = {"F1": -6.5, "F2": 3.1}
THIN, DENSITY = 0.25, 7850.0


def lap(**changes):
    """The lap joint on coarse meshes."""
    table = tomllib.loads((LAP / "scene.toml").read_text()) | changes
    for part in table["parts"]:
        part["size"] = "coarse"
    table["report"] = {"laws": ["coulomb"]}
    return read_table(table, LAP / "scene.toml")


@pytest.fixture(scope="module")
def true(cache):
    """By part, its surface and its shape under FORCES in the full model; and the measurements of the assembly."""
    assembly, model = assemble(lap(), cache), mic.reduce(lap(), cache)
    values = np.array([FORCES.get(name, 0.0) for name in model.parameters])
    shapes = FullModel(assembly).shape_fields(values)
    parts = {part.name: (part.surface, shapes[part.name][:, :3]) for part in assembly.parts}
    return parts, model.evaluate(values).measurements[0]


@pytest.fixture(scope="module")
def reader(cache):
    return ScanReader(lap(), cache)


@pytest.fixture
def files(true, tmp_path):
    return {
        part: write_ply(tmp_path / f"{part}-7.ply", scanned(surface, shape, 3000, 1)[0])
        for part, (surface, shape) in true[0].items()
    }


def test_deviations_of_the_scene_are_found_with_their_uncertainty(reader, files, true):
    found = reader.read(files, "7")
    sigma = dict(zip(reader.model.parameters, np.sqrt(found.covariance.diagonal())))
    assert reader.free == [] and found.values.keys() == FORCES.keys() and sigma["D1"] == 0.0
    for name, force in FORCES.items():
        assert 0.0 < sigma[name] < 0.15 and abs(found.values[name] - force) < 4 * sigma[name]
    SCANS.check(found.registrations, "memory", "mend it")
    assert found.error < 0.02 and (found.registrations["noise"] - 0.05).abs().max() < 0.005
    prediction = Predictor(reader.model, exact=True)
    values = found.values | {"D1": 0.0}
    certain, uncertain = prediction.predict(values), prediction.predict(values, found.covariance, found.error)
    np.testing.assert_allclose(uncertain["value"][:2], true[1], atol=0.02)
    slope = reader.model.sensitivities({}).jacobian[0]
    half = 1.959964 * np.sqrt(found.error**2 + ((slope @ found.covariance) * slope).sum(axis=1))
    assert certain["high"][0] == pytest.approx(certain["value"][0])
    np.testing.assert_allclose((uncertain["high"] - uncertain["value"])[:2], half, rtol=1e-5)


def test_a_part_without_a_source_is_taken_as_scanned(files, true, cache):
    others = [item.model_dump() for item in lap().deviations if item.kind != "force"]
    reader = ScanReader(lap(deviations=others), cache)
    found = reader.read(files, "7")
    assert reader.free == ["lower", "upper"]
    y = reader.model.evaluate(found.values | {"D1": 0.0}).measurements[0]
    np.testing.assert_allclose(y, true[1], atol=0.02)
    whole = Predictor(reader.model, exact=True).predict(found.values, found.covariance, found.error).iloc[-1]
    assert whole["verdict"] == "accepted" and whole["far"] < 6


def test_precise_scans_of_nominal_parts_give_no_deviations(reader, true, tmp_path):
    noise = 0.002
    files = {
        part: write_ply(tmp_path / f"{part}.ply", scanned(surface, 0 * shape, 1500, 4, noise, 0, 0, 1e-9, 0)[0])
        for part, (surface, shape) in true[0].items()
    }
    found = reader.read(files)
    sigma = dict(zip(reader.model.parameters, np.sqrt(found.covariance.diagonal())))
    for name in FORCES:
        assert abs(found.values[name]) < 4 * sigma[name] < 0.4
    assert found.error < 0.2 * noise + 0.0005 and found.registrations["deviation"].max() < 0.1 * noise + 0.0005


def test_wrong_scans_are_refused_in_one_sentence(reader, files, true, tmp_path):
    points = scanned(*true[0]["upper"], 2000, 3)[0]
    for name, cloud, message in (
        ("inches", scanned(*true[0]["upper"], 2000, 3, outliers=0)[0] / 25.4, 'unit = "in"'),
        ("few", points[:10], "10 points are too few"),
        ("corner", points[points[:, 0] < 75], "cover"),
        ("nan", np.where(np.arange(2000)[:, None] == 5, np.nan, points), "point 6: x is nan"),
    ):
        path = write_ply(tmp_path / f"{name}.ply", cloud)
        with pytest.raises(FormatError, match=message) as problem:
            reader.read({"upper": path})
        assert str(path) in str(problem.value) and "\n" not in str(problem.value)


def strip(tmp_path, **changes):
    """A thin strip, flat, and nothing else."""
    shutil.copy(LAP / "geometry.py", tmp_path)
    table = tomllib.loads((LAP / "scene.toml").read_text())
    part = {"name": "upper", "geometry": "geometry.py", "size": "coarse", "thickness": THIN, "density": DENSITY}
    table = {
        "name": "strip",
        "parts": [part],
        "locators": [one for one in table["locators"] if one["part"] == "upper"],
        "stages": [{"kind": "locate"}, {"kind": "measure"}],
        "measurements": table["measurements"],
    }
    return read_table(table | changes, tmp_path / "scene.toml")


def test_the_sag_on_supports_is_removed(tmp_path, cache):
    """A flat strip on supports at its ends sags as a beam: w = q s (L³ − 2 L s² + s³) / 24 E I."""
    at = [[60, 0, 1], [60, 12.5, 1], [60, 25, 1], [160, 0, 1], [160, 25, 1]]
    reader = ScanReader(strip(tmp_path, scans=[{"part": "upper", "supports": at}]), cache)
    surface = reader.assembly.parts[0].surface
    s, L, stiffness = surface.points[:, 0] - 60, 100.0, 210e3 * 25 * THIN**3 / 12
    q = DENSITY * 1e-12 * 9806.65 * 25 * THIN
    sag = np.outer(q * s * (L**3 - 2 * L * s**2 + s**3) / (24 * stiffness), [0, 0, -1])
    path = write_ply(tmp_path / "1.ply", scanned(surface, sag, 3000, 2, noise=0.01)[0])
    sag_size = np.sqrt(np.mean(sag[:, 2] ** 2))
    assert sag_size > 0.05 and reader.read({"upper": path}).registrations["deviation"][0] < 0.2 * sag_size

    falls = strip(tmp_path, scans=[{"part": "upper", "supports": [[60, 0, 1], [60, 25, 1], [80, 12, 1]]}])
    with pytest.raises(SceneError, match="fall off"):
        ScanReader(falls, cache)
    parts = [part.model_copy(update={"density": None}) for part in falls.parts]
    with pytest.raises(SceneError, match="density"):
        ScanReader(falls.model_copy(update={"parts": parts}), cache)


def test_the_command_predicts_scans_once_and_names_what_is_wrong(files, tmp_path):
    def run(*more):
        return CliRunner().invoke(app, ["predict", str(tmp_path / "scene"), "--log", str(log), *map(str, more)])

    scene, scans, log = tmp_path / "scene", tmp_path / "scans", tmp_path / "log.csv"
    scene.mkdir(), scans.mkdir()
    shutil.copy(LAP / "geometry.py", scene)
    text = (LAP / "scene.toml").read_text().replace('size = "medium"', 'size = "coarse"')
    (scene / "scene.toml").write_text(text)
    missing = run("--scan", scans)
    assert missing.exit_code and "there are no scans" in str(missing.exception)
    for path in files.values():
        shutil.copy(path, scans)
    (scans / "lower-8.csv").write_text("")
    done = run("--scan", scans, "--exact")
    assert "1 of 2 assemblies could not be predicted" in str(done.exception) and "lower-8.csv" in done.output
    rows = pd.read_csv(log, keep_default_na=False)
    assert list(rows) == PREDICTIONS.names and len(rows) == 3
    placed = pd.read_csv(log.with_name("log-scans.csv"))
    assert list(placed) == SCANS.names and sorted(placed["part"]) == ["lower", "upper"]
    (scans / "lower-8.csv").unlink()
    again = run("--scan", scans, "--exact")
    assert again.exit_code == 0 and len(pd.read_csv(log)) == 3


def test_files_are_named_by_part_and_serial_number(tmp_path):
    (tmp_path / "lower").mkdir()
    for name in ("upper-1.stl", "2_Upper.ply", "lower/1.csv", "lower/2.csv", "other.stl", "notes.pdf"):
        (tmp_path / name).write_text("")
    found, others = scan_files(tmp_path, lap())
    assert {serial: sorted(parts) for serial, parts in found.items()} == {
        "1": ["lower", "upper"],
        "2": ["lower", "upper"],
    }
    assert others == ["other.stl"]
    (tmp_path / "upper-2.stl").write_text("")
    with pytest.raises(SceneError, match="same part and serial number"):
        scan_files(tmp_path, lap())
