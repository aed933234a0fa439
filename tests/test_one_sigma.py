"""The shape of one standard deviation of each source, reported and drawn by the check."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import mic
from fem_reference.full.model import FullModel
from mic.model.assembly import assemble
from mic.model.one_sigma import one_sigma
from mic.options import app
from mic.report.source_pictures import MOST, draw_shapes
from mic.scene.load import read_table

pytestmark = pytest.mark.fem
LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint"
OTHERS = [
    {"name": "warm", "kind": "temperature", "part": "upper", "sigma": 25.0},
    {"name": "bent", "kind": "shape", "part": "lower", "points": [[95, 12.5, 0]], "sigma": 0.3},
    {"name": "fixed", "kind": "force", "part": "upper", "point": [110, 10, 1], "mean": 4.0, "sigma": 0.0},
]


@pytest.fixture(scope="module")
def table():
    table = mic.load_scene(LAP).model_dump(mode="json", exclude={"folder"})
    table["parts"] = [part | {"expansion": 1.2e-5, "size": "coarse"} for part in table["parts"]]
    table["zones"][0]["pairs"] = 6
    table["report"] |= {"fields": False}
    return table | {"deviations": table["deviations"] + OTHERS}


@pytest.fixture(scope="module")
def found(table, cache):
    scene = read_table(table, LAP / "scene.toml")
    assembly = assemble(scene, cache)
    return assembly, one_sigma(assembly, mic.reduce(scene, cache))


def test_the_shapes_are_those_of_the_full_solve(found):
    """A source without spread gives its mean; locators and clamps give no shape."""
    assembly, shapes = found
    assert [shape.name for shape in shapes] == ["F1", "F2", "warm", "bent", "fixed"]
    full, names = FullModel(assembly, route="condensed"), [item.name for item in assembly.scene.deviations]
    for shape in shapes:
        item = assembly.scene.deviations[names.index(shape.name)]
        unit = np.zeros(len(names))
        unit[names.index(shape.name)] = item.sigma or item.mean
        expected = full.shape_fields(unit)
        for part, field in expected.items():
            own = shape.fields.get(part, np.zeros_like(field[:, :3]))
            np.testing.assert_allclose(own, field[:, :3], atol=1e-8 * np.abs(field[:, :3]).max() + 1e-12)
        part, vertex, length = shape.largest
        assert length == pytest.approx(np.linalg.norm(expected[part][:, :3], axis=1).max(), rel=1e-6) and length > 0.005
        assert np.linalg.norm(expected[part][vertex, :3]) == pytest.approx(length, rel=1e-6)
    bent = next(shape for shape in shapes if shape.name == "bent").fields["lower"]
    surface = next(part.surface for part in assembly.parts if part.name == "lower")
    nearest = int(np.argmin(np.linalg.norm(surface.points - [95, 12.5, 0], axis=1)))
    assert abs(bent[nearest, 2]) == pytest.approx(0.3, rel=0.1)  # given in mm at this point


def test_shapes_are_drawn_on_their_parts(found):
    assembly, shapes = found
    surfaces = {part.name: part.surface for part in assembly.parts}
    assert "Shown are" not in draw_shapes(surfaces, shapes[:1]).caption
    picture = draw_shapes(surfaces, 3 * shapes)
    assert f"Shown are the first {MOST} of 15" in picture.caption
    colours = Image.open(io.BytesIO(picture.data)).convert("RGB").getcolors(1 << 24) or []
    red = sum(count for count, (r, g, b) in colours if r > b + 60)
    blue = sum(count for count, (r, g, b) in colours if b > r + 60)
    assert red > 500 and blue > 500


@pytest.mark.usefixtures("lap_model")  # with the same coefficients
@pytest.mark.slow
def test_check_shows_shapes_once_coefficients_are_cached(cache, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (LAP / "scene.toml").read_text().replace("friction = 0.27", "friction = 0.27\npairs = 24")
    (tmp_path / "scene.toml").write_text(text)
    (tmp_path / "geometry.py").write_text((LAP / "geometry.py").read_text())

    def checked(folder):
        done = CliRunner().invoke(app, ["check", "."], env={"MIC_CACHE": str(folder), "COLUMNS": "200"})
        assert done.exit_code == 0, done.output
        return done.output, (tmp_path / "results" / "lap-joint" / "check.html").read_text()

    output, page = checked(tmp_path / "empty")
    assert "available once the influence coefficients are computed" in output and "Shapes of the sources" not in page
    output, page = checked(cache)
    row = re.search(r"F1 +│ force +│ N +│ -5 +│ 1.5 +│ ([\d.]+) mm, upper at", output)
    assert row and float(row[1]) > 0.01
    assert "Shapes of the sources" in page and "data:image/png;base64,iVBOR" in page and f"{float(row[1]):.3g}" in page
