"""`mic init`: the proposed scene is complete and runs, whatever the meshes are."""

import re
import tomllib
from functools import cache

import numpy as np
import pytest
from support.decks import arc, drilled, extruded, grid, write_deck
from typer.testing import CliRunner

import mic
from mic.model.assembly import assemble
from mic.options import app
from mic.plausibility import find_warnings
from mic.scene import load_scene
from mic.scene.measurement import Measurement
from mic.scene.table_rows import read_rows
from mic.scene.weld import Weld
from mic.statistics.draw import draw
from mic.wizard import write_scene


def hat(z, width=90.0, foot=22.0, rise=20.0, x=0.0):
    """A hat profile along y, its feet at height z."""
    profile = [(0, 0), (foot, 0), (foot + 5, rise), (width - foot - 5, rise), (width - foot, 0), (width, 0)]
    return extruded([(x + a, z + b) for a, b in profile], 0, 60, 10)


def turned(sheet):
    """A sheet askew to all axes."""
    points, cells = sheet
    a, b = 0.5, 0.7
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_z = np.array([[np.cos(b), -np.sin(b), 0], [np.sin(b), np.cos(b), 0], [0, 0, 1]])
    return points @ (about_x @ about_z).T + [100, -50, 30], cells


def upside_down(sheet):
    """The same sheet, its normals the other way."""
    points, cells = sheet
    return points, cells[:, ::-1]


def triangles(sheet):
    """The same sheet in triangles."""
    points, cells = sheet
    return points, np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])


PLATE = grid(90, 60, 10)
STACK = {"BASE": grid(120, 60, 11), "HAT": hat(1.0, x=5), "CAP": grid(60, 60, 11, z=22.0, x=25)}

FLAT = {"a": {"A": grid(80, 50, 7)}, "b": {"B": grid(80, 50, 6, z=1, x=50)}}

#: Cases: {file: sheets}, number of zones, keys of the decks.
SHAPES = {
    "drawn on the faying surface": ({"plate": {"P": PLATE}, "hat": {"H": hat(0.0)}}, 1, {}),
    "drawn on it, normals opposed": ({"hat": {"H": hat(0.0)}, "plate": {"P": upside_down(PLATE)}}, 1, {}),
    "drawn into each other": ({"a": {"A": grid(80, 50, 7)}, "b": {"B": grid(80, 50, 6, z=0.6, x=50)}}, 1, {}),
    "askew, in triangles": (
        {
            "plate": {"P": turned(triangles(PLATE))},
            "angle": {"A": turned(extruded([(10, 1), (50, 1), (50, 40)], 0, 60, 11))},
        },
        1,
        {},
    ),
    "three in one deck": ({"three": STACK}, 2, {"sections": {"BASE": 0.8, "HAT": 1.2, "CAP": 1.0}}),
    "curved": (
        {"a": {"A": extruded(arc(100, 60, 120, 9), 0, 40, 9)}, "b": {"B": extruded(arc(101, 45, 85, 9), 0, 40, 10)}},
        1,
        {},
    ),
    "holes": ({"drilled": {"D": drilled(120, 60, 6)}, "plate": {"P": grid(60, 60, 6, z=1, x=90)}}, 1, {}),
    "in metres": (FLAT, 1, {"scale": 1e-3, "sections": {"A": 1.0, "B": 1.0}}),
    "one that touches nothing": (FLAT | {"far": {"F": grid(60, 40, 8, z=9, x=300)}}, 1, {}),
    "one part alone": ({"hat": {"H": hat(0.0)}}, 0, {}),
}


def propose(sheets, folder, *lists, **keys):
    """The scene's folder and the proposal for decks of these sheets, by file, or one sheet each."""
    sections, files = keys.pop("sections", {}), []
    folder.mkdir(exist_ok=True)
    for name, sheet in sheets.items():
        parts = sheet if isinstance(sheet, dict) else {"S": sheet}
        own = {part: t for part, t in sections.items() if part in parts}
        files.append(write_deck(folder / f"{name}.inp", parts, sections=own, first=101, **keys))
    return write_scene(files, folder / "scene", {None: 1.0}, *lists)


@pytest.fixture(scope="module")
def proposed(tmp_path_factory):
    """Proposes the scene of a case once: its folder, and the proposal."""

    @cache
    def made(case):
        sheets, _, keys = SHAPES[case]
        return propose(sheets, tmp_path_factory.mktemp("proposed"), **keys)

    return made


@pytest.fixture(scope="module")
def assembled(proposed):
    """Assembles the proposed scene of a case once."""

    @cache
    def made(case):
        folder = proposed(case)[0]
        return assemble(load_scene(folder), folder.parent / "cache")

    return made


@pytest.mark.parametrize(
    "case",
    [
        "drawn on it, normals opposed",
        "drawn into each other",
        "askew, in triangles",
        "curved",
        "holes",
        "one that touches nothing",
        "one part alone",
    ],
)
@pytest.mark.slow
def test_a_proposed_scene_locates_its_parts_well(proposed, assembled, case):
    """It loads, has all zones, and no motion of a part is nearly free."""
    proposal, assembly = proposed(case)[1], assembled(case)
    scene, zones = assembly.scene, SHAPES[case][1]
    assert [str(one) for one in find_warnings(scene, assembly) if "is in no zone and in no weld" not in str(one)] == []
    assert len(scene.zones) == zones
    for part in scene.parts:
        own = [one for one in scene.locators if one.part == part.name and one.stage == "locate"]
        x, d = np.array([one.point for one in own]), np.array([one.direction for one in own])
        arms = (x - x.mean(0)) / (np.linalg.norm(np.ptp(x, axis=0)) / 2)
        values = np.linalg.svd(np.column_stack([d, np.cross(arms, d)]), compute_uv=False)
        assert len(own) == 6 and values[5] / values[0] > 0.1
        assert proposal.conditioned[part.name] > 0.1
    for zone in scene.zones:
        joined = [weld for weld in scene.welds if set(weld.parts) == set(zone.parts)]
        assert len(joined) >= 2 and any(clamp.part in zone.parts for clamp in scene.clamps)
    assert (len(proposal.base) == 1) == (case != "one that touches nothing")  # else one that holds all
    assert len(scene.measurements) == 4 * len(scene.parts)
    if zones:
        gap = assembly.contacts.gap
        assert gap.min() >= 0 and np.median(gap) < 0.2


@pytest.mark.fem
@pytest.mark.slow
@pytest.mark.parametrize("case", ["holes", "one that touches nothing"])
def test_a_proposed_scene_runs_and_its_characteristics_vary(proposed, assembled, case):
    """No sample fails, and every key characteristic varies, by less than the part is large."""
    folder, _ = proposed(case)
    assembled(case)
    model = mic.reduce(load_scene(folder), folder.parent / "cache")
    found = model.evaluate(draw(model.scene, 1, 0, 2))
    for stage, resolution in found.resolutions.items():
        assert (resolution.residual < 1e-8).all(), f"{stage}: {resolution.residual}"
    assert np.isfinite(found.measurements).all()
    assert (found.measurements.std(axis=0) > 1e-5).all() and np.abs(found.measurements).max() < 10


@pytest.mark.parametrize("case", ["drawn on the faying surface", "drawn on it, normals opposed"])
@pytest.mark.slow
def test_sheets_drawn_upon_each_other_are_put_side_by_side(proposed, case):
    """The hat rises above the plate: its sheet lies above the drawn surface, the plate's below, in either order and for
    either sense of the normals."""
    _, proposal = proposed(case)
    assert "side by side" in proposal.sentences[0] and "guess" not in proposal.sentences[0]
    up = {body.name: body.surface.normals[0, 2] for body in proposal.bodies}
    assert {name: offset * up[name] for name, offset in proposal.offsets.items()} == {"plate": -0.5, "hat": 0.5}


def test_an_ambiguous_drawing_side_is_called_a_guess(tmp_path):
    _, proposal = propose({"a": grid(80, 50, 7), "b": grid(80, 50, 7, x=40)}, tmp_path)
    assert "guess" in proposal.sentences[0]


@pytest.mark.slow
def test_sheets_drawn_into_each_other_say_how_deep(proposed):
    folder = proposed("drawn into each other")[0]
    text = (folder / "scene.toml").read_text()
    assert "largest drawn overlap is 0.40 mm" in text
    assert load_scene(folder).zones[0].nominal_overlap == pytest.approx(0.45)


@pytest.mark.slow
def test_a_flat_sheet_is_held_by_three_two_and_one(assembled):
    """Three across the sheet, two across its length, far apart, one along it."""
    own = [one for one in assembled("one that touches nothing").scene.locators if one.part == "a"]
    assert [one.name for one in own][:6] == [f"a-{label}" for label in ("A1", "A2", "A3", "B1", "B2", "C1")]
    assert np.abs([one.direction for one in own[:6]]) == pytest.approx(
        np.array([[0, 0, 1]] * 3 + [[0, 1, 0]] * 2 + [[1, 0, 0]])
    )
    assert abs(own[3].point[0] - own[4].point[0]) > 25
    assert all(one.stage == "clamp" and np.abs(one.direction) == pytest.approx([0, 0, 1]) for one in own[6:])


@pytest.mark.slow
def test_pins_go_through_holes(assembled):
    """One both ways, the other across the line between them; they read the rims."""
    pins = [one for one in assembled("holes").scene.locators if one.hole is not None]
    assert len(pins) == 3
    assert {one.part for one in pins} == {"drilled"}
    assert sorted({tuple(np.round(one.point, 3)) for one in pins}) == [(30, 30, 0), (90, 30, 0)]
    across = [one for one in pins if np.abs(one.direction) == pytest.approx([0, 1, 0])]
    assert len(across) == 2


@pytest.mark.slow
def test_sets_of_one_deck_are_parts_with_the_thickness_of_the_deck(proposed):
    folder = proposed("three in one deck")[0]
    written = tomllib.loads((folder / "scene.toml").read_text())["parts"]
    assert [(part["set"], part["thickness"]) for part in written] == [("BASE", 0.8), ("HAT", 1.2), ("CAP", 1.0)]


@pytest.mark.slow
def test_metres_are_detected_and_written_into_the_scene(proposed):
    folder, proposal = proposed("in metres")
    scene = load_scene(folder)
    assert "taken for metres" in proposal.sentences[0]
    assert [(part.unit, part.thickness, part.young) for part in scene.parts] == [("m", 1.0, 210e3)] * 2
    assert scene.measurements[0].point != (0, 0, 0) and np.abs(scene.measurements[0].point).max() > 10


@pytest.mark.slow
def test_a_part_that_touches_nothing_is_reported_and_stays_located(proposed):
    folder, proposal = proposed("one that touches nothing")
    assert [sentence for sentence in proposal.sentences if "far" in sentence] == [
        "far has no lap with another part; the nearest is b, 170 mm away"
    ]
    keep = next(stage.keep for stage in load_scene(folder).stages if stage.kind == "release")
    assert len([name for name in keep if name.startswith("far-")]) == 6 and len(keep) == 12


@pytest.mark.slow
@pytest.mark.parametrize("case", ["drawn on the faying surface", "three in one deck"])
def test_every_key_is_explained_where_it_first_stands(proposed, case):
    """A comment on its line or on the line above, by table and key."""
    folder = proposed(case)[0]
    seen, table, before, head = set(), "", "", False
    for line in (folder / "scene.toml").read_text().splitlines():
        if line.startswith("["):
            table = line.split("#")[0].strip()
            if table not in seen:
                assert "#" in line or before.startswith("#"), f"{table} begins unexplained"
            seen.add(table)
            head = "#" in line
        key = re.match(r"(\w+) = ", line)
        if key and (table, key[1]) not in seen:
            seen.add((table, key[1]))
            assert "#" in line or before.startswith("#") or head, f"{table}: {line}"
        before = line
    assert len(seen) > 40


def test_a_missing_thickness_is_refused_with_the_option_to_give(tmp_path):
    files = [write_deck(tmp_path / f"{n}.inp", {"S": grid(80, 50, 7, z=z)}) for n, z in (("a", 0), ("b", 1))]
    with pytest.raises(mic.SceneError, match=r"thickness of a, b: give it in mm, --thickness 1.5 for all, or .*a=1.5"):
        write_scene(files, tmp_path / "scene")
    with pytest.raises(mic.SceneError, match="thickness of b"):
        write_scene(files, tmp_path / "scene", {"a": 1.0})
    with pytest.raises(mic.SceneError, match="--thickness c=…: there is no part called 'c'; known: a, b"):
        write_scene(files, tmp_path / "scene", {"c": 1.0})
    assert not (tmp_path / "scene").exists()


def test_a_part_in_pieces_that_nothing_names_is_refused(tmp_path):
    a, cells = grid(40, 30, 7)
    both = np.concatenate([a, a + [0, 0, 1]]), np.concatenate([cells, cells + len(a)])
    with pytest.raises(mic.SceneError, match="two.inp: part 'two' consists of 2 separate pieces"):
        propose({"two": both}, tmp_path)


def test_an_existing_scene_is_not_overwritten(tmp_path):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "scene.toml").write_text("mine")
    with pytest.raises(mic.RunError, match="contains a scene already"):
        propose({"a": grid(80, 50, 7)}, tmp_path)
    assert (tmp_path / "scene" / "scene.toml").read_text() == "mine"


def laid(tmp_path):
    return [write_deck(tmp_path / f"{name}.inp", sheets) for name, sheets in FLAT.items()]


@pytest.mark.slow
def test_listed_welds_and_points_are_taken_and_find_their_parts(tmp_path):
    (tmp_path / "w.csv").write_text("name;x;y;z\nS1;65;15;0.5\nS2;65;35;0.5\n")
    (tmp_path / "p.csv").write_text("x,y,z,direction,upper\n5,25,0,,\n125,25,1,0 0 1,0.8\n")
    folder, _ = propose(FLAT, tmp_path, tmp_path / "w.csv", tmp_path / "p.csv")
    scene = load_scene(folder)
    assert [(weld.name, set(weld.parts), weld.point) for weld in scene.welds] == [
        ("S1", {"a", "b"}, (65, 15, 0.5)),
        ("S2", {"a", "b"}, (65, 35, 0.5)),
    ]
    found = [(one.name, one.part, one.direction, one.upper) for one in scene.measurements]
    assert found == [("M1", "a", "normal", 0.5), ("M2", "b", (0, 0, 1), 0.8)]
    clamps = np.array([clamp.point for clamp in scene.clamps])
    assert np.linalg.norm(clamps - [65, 15, 0.5], axis=1).min() > 10


def test_a_list_may_have_decimal_commas_where_commas_do_not_separate_its_cells(tmp_path):
    """As a spreadsheet writes it where numbers have commas, with a byte-order mark; names keep theirs."""
    (tmp_path / "w.csv").write_bytes("\ufeffname;x;y;z\r\nS1;65,5;1,5e1;0,5\r\n".encode())
    (tmp_path / "p.csv").write_text("name\tx\ty\tz\tdirection\tpart\nM1\t5,0\t25\t0\t0,0 0,0 1,0\t1,2\n")
    (weld,) = (row for _, row in read_rows(tmp_path / "w.csv", Weld)[0])
    assert weld == {"name": "S1", "point": [65.5, 15.0, 0.5]}
    (point,) = (row for _, row in read_rows(tmp_path / "p.csv", Measurement)[0])
    assert point == {"name": "M1", "point": [5.0, 25, 0], "direction": [0.0, 0.0, 1.0], "part": "1,2"}
    (tmp_path / "q.csv").write_text('x,y,z\n"1,500",15,0.5\n')  # a thousand and a half, or one and a half
    with pytest.raises(mic.SceneError, match=r"'1,500' is 1.5 or 1500, .* say which by --table, decimal = \",\" or"):
        propose(FLAT, tmp_path, tmp_path / "q.csv")


def test_no_tong_presses_on_a_weld(tmp_path):
    """A lap with room for a weld alone gets the weld only; a pad would lie on the nugget."""
    sheets = {"a": grid(80, 50, 7), "b": grid(80, 12, 6, z=1.0, x=66, y=20)}
    scene = load_scene(propose(sheets, tmp_path)[0])
    assert len(scene.welds) == 1 and scene.clamps == []


def test_all_invalid_rows_of_the_lists_are_reported_together(tmp_path):
    (tmp_path / "w.csv").write_text("x,y,z\n65,15,0.5\n5,15,0\nsixty,15,0\n")
    with pytest.raises(mic.SceneError) as caught:
        propose(FLAT, tmp_path, tmp_path / "w.csv")
    assert "w.csv: row 3: a weld joins two parts within 5 mm; the nearest are a (0 mm off) and b (45 mm off)" in str(
        caught.value
    )
    assert "w.csv: row 4: x, y and z must be numbers" in str(caught.value)
    (tmp_path / "p.csv").write_text("part,x,y,z\nc,5,25,0\na,5,25,90\n")
    with pytest.raises(mic.SceneError) as caught:
        propose(FLAT, tmp_path, None, tmp_path / "p.csv")
    assert "row 2, column part: there is no part called 'c'; known: a, b" in str(
        caught.value
    ) and "row 3: (5, 25, 90)" in str(caught.value)


@pytest.mark.slow
def test_tables_call_renamed_parts_by_the_names_of_their_decks(tmp_path):
    (tmp_path / "w.csv").write_text("Weld ID;X [mm];Y [mm];Z [mm];Part 1;Part 2\nS1;65,5;15;0,5;A.INP;B\n")
    (tmp_path / "p.csv").write_text("Point,Part,X,Y,Z,Tol ±\nM1,a,5,25,0,0.25\n")
    lists = tmp_path / "w.csv", tmp_path / "p.csv"
    folder, proposal = write_scene(laid(tmp_path), tmp_path / "scene", {None: 1.0, "A": 1.5}, *lists, {"a.inp": "rail"})
    scene = load_scene(folder)
    assert [(part.name, part.thickness) for part in scene.parts] == [("rail", 1.5), ("b", 1.0)]
    assert [(weld.name, weld.parts, weld.point) for weld in scene.welds] == [("S1", ("rail", "b"), (65.5, 15, 0.5))]
    (point,) = scene.measurements
    assert (point.name, point.part, point.lower, point.upper) == ("M1", "rail", -0.25, 0.25)
    assert proposal.sentences[0].startswith("w.csv: columns read: x from 'X [mm]'") and scene.tables_read == []
    with pytest.raises(mic.SceneError, match="--name c=…: there is no part called 'c'; known: a, b"):
        write_scene(laid(tmp_path), tmp_path / "other", {None: 1.0}, renamed={"c": "rail"})
    with pytest.raises(mic.SceneError, match="--name: the parts would be b, b; give each a name of its own"):
        write_scene(laid(tmp_path), tmp_path / "other", {None: 1.0}, renamed={"a": "b"})


@pytest.mark.slow
@pytest.mark.parametrize(
    "text, setting",
    [
        ("Weld;X;Y;Z\nS1;65,000;15,000;1,000\n", 'decimal = ","'),
        ("All dimensions in inch\nWeld;X;Y;Z\nS1;2.5591;0.5906;0.0394\n", 'unit = "in"'),
    ],
)
def test_the_reading_that_puts_the_welds_onto_the_parts_is_taken(text, setting, tmp_path):
    (tmp_path / "w.csv").write_text(text)
    folder, proposal = propose(FLAT, tmp_path, tmp_path / "w.csv")
    (weld,) = load_scene(folder).welds
    assert weld.point == pytest.approx((65, 15, 1), abs=0.01)
    assert f"{setting}, as all points then lie on parts" in proposal.sentences[0]
    (tmp_path / "w.csv").write_text(text + text.splitlines()[-1].replace("S1;", "S2;-9") + "\n")  # far from the parts
    with pytest.raises(mic.SceneError, match="say which by --table"):
        write_scene(laid(tmp_path), tmp_path / "other", {None: 1.0}, tmp_path / "w.csv")


def test_a_weld_of_three_sheets_is_two(tmp_path):
    (tmp_path / "w.csv").write_text("name,x,y,z\nW,40,25,1\n")
    folder, _ = propose({f"s{i}": grid(80, 50, 10, z=i) for i in range(3)}, tmp_path, tmp_path / "w.csv")
    welds = {weld.name: frozenset(weld.parts) for weld in load_scene(folder).welds}
    assert list(welds) == ["Wa", "Wb"] and {*welds.values()} == {frozenset(("s0", "s1")), frozenset(("s1", "s2"))}


@pytest.mark.slow
def test_sheets_with_another_between_them_have_no_zone(tmp_path):
    """However they are drawn: apart by their thicknesses, or all three upon each other."""
    for name, rise in (("apart", 1.0), ("upon", 0.0)):
        sheets = {f"s{i}": grid(80 - 10 * i, 50, 7, z=rise * i) for i in range(3)}
        folder, _ = propose(sheets, tmp_path / name)
        zones = [set(zone.parts) for zone in load_scene(folder).zones]
        assert len(zones) == 2 and (name == "upon" or {"s0", "s2"} not in zones)


@pytest.mark.slow
def test_a_stack_of_three_sheets_is_joined_through_and_the_rest_touches_where_nothing_lies_between(tmp_path):
    """The plate steps under a doubler below one foot of the hat, and touches the hat's other foot itself."""
    plate = extruded([(0, 0), (30, 0), (40, 1), (90, 1)], 0, 60, 9)
    scene = load_scene(propose({"plate": plate, "doubler": grid(26, 60, 8, z=1), "hat": hat(2.0)}, tmp_path)[0])
    assert {frozenset(zone.parts) for zone in scene.zones} == {
        frozenset(pair) for pair in (("plate", "doubler"), ("doubler", "hat"), ("plate", "hat"))
    }
    joined = lambda *parts: {weld.point for weld in scene.welds if set(weld.parts) == set(parts)}
    assert joined("plate", "doubler") == joined("doubler", "hat") and min(x for x, _, _ in joined("plate", "hat")) > 50
    assert {frozenset(clamp.parts) for clamp in scene.clamps} == {frozenset(("plate", "hat"))}
    assert {clamp.point[0] < 22 for clamp in scene.clamps} == {True, False}
    assembly = assemble(scene, tmp_path / "cache")
    touching = next(i for i, zone in enumerate(scene.zones) if set(zone.parts) == {"plate", "hat"})
    assert assembly.contacts.point[assembly.contacts.zone == touching, 0].min() > 40
    assert find_warnings(scene, assembly) == ()


def test_a_large_lap_begins_with_fewer_pairs(tmp_path, proposed, monkeypatch):
    """A candidate for each element would be more; a small lap has no stated spacing."""
    assert load_scene(proposed("in metres")[0]).zones[0].spacing is None
    monkeypatch.setattr("mic.wizard.proposal.PAIRS", 20)  # of an overlap of 30 × 50 mm with elements of 7
    assert load_scene(propose(FLAT, tmp_path)[0]).zones[0].spacing == np.ceil(np.sqrt(30 * 50 / 20))


def test_a_part_without_a_3_2_1_scheme_gets_six_other_locators(tmp_path):
    """A narrow half pipe: what looks one way is a strip, too narrow for three locators."""
    folder, proposal = propose({"pipe": extruded(arc(9, 0, 180, 3), 0, 160, 5)}, tmp_path)
    scene = assemble(load_scene(folder), tmp_path / "cache").scene
    assert [one.name for one in scene.locators[:6]] == [f"pipe-L{i}" for i in range(1, 7)]
    assert proposal.conditioned["pipe"] > 0.05


def test_the_command_prints_its_proposal_and_the_next_command(tmp_path):
    """A folder with blanks is quoted."""
    files = laid(tmp_path)
    out = tmp_path / "my scene"
    result = CliRunner().invoke(
        app, ["init", *map(str, files), "--thickness", "1", "--thickness", "b=2", "--out", str(out)]
    )
    assert result.exit_code == 0, result.output
    assert "2 parts" in result.output and f"mic check '{out}'" in result.output
    assert [part.thickness for part in load_scene(out).parts] == [1, 2]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "give mesh files, or an example"),
        (["a.inp", "--example", "lap_joint"], "a.inp is a mesh file beside --example lap_joint"),
        (["--example", "lap_joint", "--thickness", "1"], "go with mesh files"),
        (["a.inp", "--thickness", "thick"], "--thickness thick: give mm"),
        (["a.inp", "--thickness", "-1"], "--thickness -1: give mm"),
        (["a.inp", "--name", "rail"], "--name rail: give --name OLD=NEW"),
        (["a.inp", "--table", "decimal = 3"], "--table decimal = 3: Input should be '.' or ','"),
        (["a.inp", "--thickness", "1"], "a.inp: this mesh file does not exist"),
    ],
)
def test_the_command_refuses_invalid_arguments(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    error = CliRunner().invoke(app, ["init", *arguments]).exception
    assert isinstance(error, mic.errors.MicError) and words in str(error)
