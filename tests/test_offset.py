"""Meshes drawn on a skin of the sheet, coincident sheets, and zones that state their gap."""

from pathlib import Path

import numpy as np
import pytest
from support.decks import write_deck
from support.panels import grid
from typer.testing import CliRunner

import mic
from mic.errors import SceneError
from mic.geometry.load import load_part
from mic.geometry.offset import moved
from mic.geometry.script import load_script
from mic.geometry.structured import extrude
from mic.geometry.surface import Surface
from mic.model.assembly import assemble
from mic.model.overlap import mean_gaps
from mic.options import app
from mic.scene.part import Part

MESHES = Path(__file__).resolve().parents[1] / "meshes"
STEEL = "*Material, name=S\n*Elastic\n205000., 0.28\n"


def deck(path, points, triangles, section=""):
    """An Abaqus deck of triangles."""
    write_deck(path, {"all": (points, triangles)}, first=1)
    path.write_text(path.read_text() + section)


def lap(folder, drawn=(0.5, 0.5), sections=("", ""), turned=(False, False), parts=({}, {}), **zone):
    """The lap joint of two decks, their surfaces drawn at these heights, or functions of the points; the sheets touch
    at z = 0.5."""
    scene = mic.load_scene(MESHES / "lap_joint")
    script = load_script(MESHES / "lap_joint" / "geometry.py")
    own = []
    for part, z, section, turn, keys in zip(scene.parts, drawn, sections, turned, parts):
        points, triangles, _ = script.build(part.name, 5.0)
        points[:, 2] = z(points) if callable(z) else z
        deck(folder / f"{part.name}.inp", points, triangles[:, ::-1] if turn else triangles, section)
        own.append(Part(name=part.name, mesh=f"{part.name}.inp", **({"thickness": 1.0} | keys)))
    zones = [one.model_copy(update={"pairs": 8} | zone) for one in scene.zones]
    return scene.model_copy(update={"parts": own, "zones": zones, "folder": folder})


@pytest.mark.parametrize("angle", [20, 60, 90, 110])
@pytest.mark.parametrize("h", [1.0, -1.0])
def test_flats_beside_a_fold_move_by_the_whole_offset(angle, h):
    """The mitre: every point of each flat is as far from the plane that it was drawn in."""
    a = np.radians(angle)
    points, triangles, _ = extrude([(-20, 0), (0, 0), (20 * np.cos(a), 20 * np.sin(a))], 0, 30, 4.0)
    surface = Surface(points, triangles)
    found = moved(surface, h)
    assert np.abs(found.normals - surface.normals).max() < 1e-9
    for normal in ((0, 0, 1), (0, -np.sin(a), np.cos(a))):
        flat = np.abs(points @ normal) < 1e-9
        assert flat.sum() > 40 and (found.points - points)[flat] @ normal == pytest.approx(h)
    fold = np.abs(points[:, 1]) + np.abs(points[:, 2]) < 1e-9
    assert np.linalg.norm((found.points - points)[fold], axis=1) == pytest.approx(1 / np.cos(a / 2))


def test_the_corner_of_a_box_moves_to_the_corner_of_the_offset_box():
    square = grid(4, 4, lambda X, Y: np.column_stack([X, Y, 0 * X]))
    faces = [square.points, square.points[:, [2, 0, 1]], square.points[:, [1, 2, 0]]]
    points, index = np.unique(np.concatenate(faces).round(12), axis=0, return_inverse=True)
    triangles = np.concatenate([square.triangles + i * len(square.points) for i in range(3)])
    surface = Surface(points, index.ravel()[triangles])
    found = moved(surface, -0.1)  # normals look into the positive octant
    assert found.points[(points == 0).all(axis=1)] == pytest.approx(np.full((1, 3), -0.1))
    assert found.points[:, 0][points[:, 0] == 0] == pytest.approx(-0.1)


def test_a_curved_sheet_moves_to_its_parallel_surface():
    radius, h = 20.0, 1.0
    arc = lambda X, Y: np.column_stack([30 * X, radius * np.sin(1.5 * Y), radius * np.cos(1.5 * Y)])
    surface = grid(12, 18, arc, jitter=0.2, pattern="cross")  # facets of 5°
    for distance in (h, -h):
        found = moved(surface, distance)
        inside = ~surface.border_vertices
        away = np.linalg.norm(found.points[:, 1:], axis=1) - radius
        # normals look along −r here or +r; either way by as much, facets lie inside their arc
        assert np.abs(np.abs(away[inside]) - h).max() < 0.01
        slip = np.linalg.norm(found.points - surface.points, axis=1)
        assert np.abs(slip[inside] - h).max() < 0.01


def test_a_mesh_finer_than_its_offset_does_not_fold_up():
    """Two points of a crease a hundredth of the offset apart, as real decks have them."""
    points = np.array([[0, 0, 0], [0, 10, 0], [5, 5, 0], [5, 5.01, 0], [10, 0, 4], [10, 10, 4]], dtype=float)
    triangles = np.array([[0, 2, 1], [1, 2, 3], [0, 4, 2], [1, 3, 5], [2, 4, 5], [2, 5, 3]])
    surface = Surface(points, triangles)
    for h in (1.0, -1.0):
        found = moved(surface, h)
        assert (np.einsum("ij,ij->i", found.normals, surface.normals) > 0.5).all()


def test_the_offset_of_a_junction_is_refused():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]], dtype=float)
    with pytest.raises(ValueError, match=r"three or more of its triangles share the edge at \(0\.5, 0\.0, 0\.0\)"):
        moved(Surface(points, [[0, 1, 2], [1, 0, 3], [0, 1, 4]]), 0.1)


@pytest.mark.slow
def test_offsets_move_parts_from_the_faying_surface_to_their_middle(tmp_path, cache):
    middle = assemble(lap(tmp_path, (0.0, 1.0)), cache)
    offset_section = STEEL + "*Shell Section, elset=all, material=S, offset=SPOS\n1.,\n"
    for keys, turned, sections in (
        (({"offset": -0.5}, {"offset": -0.5}), (False, True), ("", "")),
        (({"thickness": None}, {}), (False, False), (offset_section, "*Shell Section, elset=all, offset=-0.5\n1.,\n")),
    ):
        found = assemble(lap(tmp_path, (0.5, 0.5), sections, turned, keys), cache)
        for a, b in zip(middle.parts, found.parts):
            assert b.surface.points == pytest.approx(a.surface.points) and b.thickness == 1.0
        assert found.contacts.gap == pytest.approx(0.0, abs=1e-9)
        assert found.contacts.frame[:, :, 0] == pytest.approx(middle.contacts.frame[:, :, 0])
        assert found.contacts.point == pytest.approx(middle.contacts.point)


@pytest.mark.parametrize("noise", [0.0, -1e-9, 0.1])
def test_coincident_sheets_are_refused_despite_rounding(tmp_path, cache, noise):
    with pytest.raises(SceneError, match=r"zones\[0\] \(lap\): lower and upper coincide .* offset = "):
        assemble(lap(tmp_path, (0.5, 0.5 + noise)), cache)


@pytest.mark.slow
def test_the_proposed_offsets_separate_coincident_sheets(tmp_path, cache):
    """A hat on a plate: the side on which the hat lies follows from where it rises off the plate."""
    plate = extrude([(-60, 0), (60, 0)], 0, 80, 5.0)
    hat = extrude([(-40, 0), (-20, 0), (-15, 20), (15, 20), (20, 0), (40, 0)], 0, 80, 5.0)
    scene = lap(tmp_path)
    for turned in ((False, False), (True, False)):
        for name, mesh, turn in zip(("lower", "upper"), (plate, hat), turned):
            deck(tmp_path / f"{name}.inp", mesh[0], mesh[1][:, ::-1] if turn else mesh[1])
        wanted = {"lower": 0.5 if turned[0] else -0.5, "upper": -0.5 if turned[1] else 0.5}
        zone = scene.zones[0].model_copy(update={"box": None, "path": None, "within": None})
        none = {key: [] for key in ("locators", "clamps", "welds", "measurements", "deviations")}
        bare = scene.model_copy(update=none | {"zones": [zone]})
        words = " and ".join(f"offset = {value:+g} for {name}" for name, value in wanted.items())
        with pytest.raises(SceneError, match=words.replace("+", r"\+") + ", which follows from the rest of the sheets"):
            assemble(bare, cache)
        parts = [part.model_copy(update={"offset": wanted[part.name]}) for part in bare.parts]
        found = assemble(bare.model_copy(update={"parts": parts}), cache)
        assert np.abs(found.contacts.gap).max() < 1e-9 and found.contacts.frame[:, 2, 0] == pytest.approx(1)


def test_a_zone_can_state_its_gap(tmp_path, cache):
    found = assemble(lap(tmp_path, (0.0, 0.8), gap=0.05), cache)  # drawn with overlap
    assert (found.contacts.gap == 0.05).all() and (mean_gaps(found) == 0.05).all()
    assert not found.contacts.overlap.any() and not found.contacts.overlapping.any()


@pytest.mark.slow
def test_the_scene_overrides_the_deck_and_missing_values_are_refused(tmp_path, cache):
    section = STEEL + "*Shell Section, elset=all, material=S\n0.7,\n"
    keys = {"thickness": None}, {"young": 70e3, "poisson": 0.33}
    scene = lap(tmp_path, (0.0, 0.85), (section, section), parts=keys)
    lower, upper = assemble(scene, cache).parts
    assert (lower.thickness, lower.young, lower.poisson) == (0.7, 205e3, 0.28)
    assert (upper.thickness, upper.young, upper.poisson) == (1.0, 70e3, 0.33)
    with pytest.raises(SceneError, match=r"part 'lower': thickness: neither the scene nor lower.inp gives it; add"):
        assemble(lap(tmp_path, parts=({"thickness": None}, {})), cache)


@pytest.mark.parametrize(
    "section, words",
    [
        (STEEL.replace("205000", "205"), "young: lower.inp gives 205 if its unit is 'mm'"),
        (STEEL.replace("205000.", "2.05e11"), r"young: lower.inp gives 2\.05e\+11 if its unit is 'mm'"),
        ("*Elset, elset=half, generate\n1, 100, 1\n*Shell Section, elset=half\n0.7\n", "thickness: .* gives several"),
    ],
)
def test_implausible_values_of_a_deck_are_refused(tmp_path, cache, section, words):
    section = section if "Section" in section else section + "*Shell Section, elset=all, material=S\n0.7,\n"
    with pytest.raises(SceneError, match=words):
        load_part(lap(tmp_path, sections=(section, ""), parts=({"thickness": None}, {})).parts[0], tmp_path, cache)


def test_a_part_in_two_pieces_is_refused(tmp_path, cache):
    points, triangles, _ = extrude([(0, 0), (20, 0)], 0, 30, 5.0)
    twice = np.concatenate([points, points + [0, 0, 40]]), np.concatenate([triangles, triangles[:6] + len(points)])
    deck(tmp_path / "a.inp", *twice)
    part = Part(name="a", mesh="a.inp", thickness=1.0)
    with pytest.raises(SceneError, match=r"part 'a': mesh: .* of 2 pieces .*48 triangles about .*; 6 triangles"):
        load_part(part, tmp_path, cache)


@pytest.mark.slow
def test_check_reports_the_source_of_values_and_repairs(tmp_path, cache, monkeypatch):
    monkeypatch.setenv("MIC_CACHE", str(cache))
    section = STEEL + "*Shell Section, elset=all, material=S, offset=-0.5\n0.7,\n"
    section += "*Element, type=MASS, elset=m\n9999, 1\n"
    lap(tmp_path, (0.5, 0.5), (section.replace("-0.5", "0.5"), section))
    text = (MESHES / "lap_joint" / "scene.toml").read_text()
    for name, keys in (("lower", ""), ("upper", "thickness = 1\n")):
        start = text.index("[[parts]]", text.index("[[parts]]") + (0 if name == "lower" else 1))
        end = text.index("[[", start + 9)
        text = f'{text[:start]}[[parts]]\nname = "{name}"\nmesh = "{name}.inp"\n{keys}\n{text[end:]}'
    (tmp_path / "scene.toml").write_text(text)
    command = ["check", str(tmp_path), "--page", str(tmp_path / "check.html")]
    output = CliRunner().invoke(app, command, env={"COLUMNS": "200"}).output
    assert "lower: t = 0.7 mm (lower.inp), offset = -0.5 t (lower.inp), E = 205000 MPa (lower.inp)" in output
    assert "upper: t = 1 mm (scene; upper.inp gives 0.7), offset = 0.5 t (upper.inp)" in output
    assert "lower: moved 0.35 mm from the mesh, mostly in the direction (" in output
    assert "upper: upper.inp: ignored elements other than shells: 1 MASS" in output and "valid" in output


@pytest.mark.slow
@pytest.mark.parametrize("fused", [True, False])
def test_a_weld_over_a_wedge_measures_the_tilt_of_its_gap(tmp_path, cache, fused):
    """g = 0.3 + α x + β y over a disc of radius R: moments α R / 4, β R / 4; rotations (β, −α)."""
    α, β = 2e-3, -3e-3

    def wedge(points):
        return 1.3 + α * (points[:, 0] - 88) + β * (points[:, 1] - 6)

    scene = lap(tmp_path, (0.0, wedge))
    welds = [scene.welds[0].model_copy(update={"fused": fused, "close": True}), *scene.welds[1:]]
    scene = scene.model_copy(update={"welds": welds})
    found, R = assemble(scene, cache), welds[0].radius
    one, other = found.weld_gap[: found.weld_size[0]], mean_gaps(found)[1]
    assert one[0] == pytest.approx(0.3, abs=1e-4) and other == pytest.approx(0.3 + 13 * β, abs=1e-4)
    rows, tilt = ([3, 6], [α * R / 4, β * R / 4]) if fused else ([4, 5], [β, -α])
    assert one[rows] == pytest.approx(tilt, rel=0.02)
    assert not np.delete(one, [0, *rows]).any()
    stated = scene.model_copy(update={"zones": [one.model_copy(update={"gap": 0.3}) for one in scene.zones]})
    assert np.flatnonzero(assemble(stated, cache).weld_gap).tolist() == [0, found.weld_size[0]]
