"""Places by node, set and hole, directions in words, tongs and pads: how a scene is placed on its meshes."""

import re

import numpy as np
import pytest
from support.decks import annulus, extruded, grid, write_deck

import mic
from mic.geometry.holes import find_holes
from mic.geometry.readers import read_mesh
from mic.model.assembly import assemble
from mic.model.sources import sources
from mic.scene import Scene, load_scene

RING, RIM, PAD = (30.0, 30.0, 1.0), 8.0, [12.0, 30.0, 1.0]
TONG = {"name": "T", "parts": ["plate", "ring"], "point": PAD, "force": 50}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A plate, and above it a ring with a hole, 1 mm thick each, their mid-surfaces 1 mm apart."""
    folder = tmp_path_factory.mktemp("placing")
    write_deck(folder / "plate.inp", {"PLATE": grid(60, 60, 5)}, first=1)
    ring = annulus(RING, RIM, 28)
    write_deck(folder / "ring.inp", {"RING": ring}, {"LOC": [1001, 1002, 1003], "RIMS": [1001, 1013]}, first=1001)
    return folder


def located(part, z):
    rows = [([10, 20, z], [0, 0, 1]), ([50, 20, z], [0, 0, 1]), ([30, 50, z], [0, 0, 1])]
    rows += [([10, 20, z], [0, 1, 0]), ([50, 20, z], [0, 1, 0]), ([10, 20, z], [1, 0, 0])]
    return [{"name": f"{part}-{i}", "part": part, "point": p, "direction": d} for i, (p, d) in enumerate(rows)]


def table(**changes):
    parts = [{"name": n, "mesh": f"{n}.inp", "thickness": 1.0} for n in ("plate", "ring")]
    return {
        "name": "placing",
        "parts": parts,
        "locators": located("plate", 0) + located("ring", 1),
        "zones": [{"name": "ring", "parts": ["plate", "ring"], "friction": 0.2, "pairs": 6}],
        "stages": [{"kind": kind} for kind in ("locate", "clamp", "weld", "release", "measure")],
        "measurements": [
            {"name": "M", "part": "ring", "point": [30, 56, 1], "direction": [0, 0, 1], "lower": -1, "upper": 1}
        ],
    } | changes


def placed(folder, **changes):
    return assemble(Scene(**table(**changes), folder=folder), folder / "cache").scene


@pytest.fixture(scope="module")
def everything(folder):
    """The assembly of a scene with places and directions of every kind."""
    ring = {"part": "ring", "lower": -1, "upper": 1}
    measured = {
        "pin": {"hole": [31, 29, 3], "direction": [1, 0, 0]},
        "normal": {"point": PAD},
        "turned": {"point": PAD, "direction": "-normal"},
        "over hole": {"hole": RING},
        "node": {"node": 1001},
        "set": {"set": "LOC"},
    }
    plate, deck = read_mesh(folder / "plate.inp")
    node = deck.nodes[deck.node_points == np.argmin(np.linalg.norm(plate.points - [25, 20, 0], axis=1))]
    over_rim = {"part": "ring", "radius": RIM + 5, "normal": [0, 0, -1]}
    pads = {
        "below": {"point": [25, 20, 1.5], "normal": "-normal"},
        "up": {"point": [25, 20, 1.5], "normal": [0, 0, 1]},
        "normal": {"point": [25, 20, 0]},
        "node": {"node": int(node[0]), "normal": [0, 0, 1]},
        "set": over_rim | {"set": "LOC"},
        "hole": over_rim | {"hole": [31, 29, 3]},
    }
    pads = {f"pad-{name}": {"part": "plate", "radius": 6} | keys for name, keys in pads.items()}
    keep = [f"{part}-{i}" for part in ("plate", "ring") for i in range(6)]
    turned = {"name": "R", "point": [48, 30, 1], "parts": ["ring", "plate"], "direction": [0, 0.3, -1]}
    scene = table(
        measurements=[ring | {"name": name.replace(" ", "-")} | keys for name, keys in measured.items()],
        fixtures=[{"name": name} | keys for name, keys in pads.items()],
        zones=[{"name": f"on-{name}", "parts": [name, keys["part"]]} for name, keys in pads.items()],
        clamps=[TONG, TONG | turned],
        deviations=[{"name": "D", "kind": "clamp", "target": "T", "sigma": 5}],
    )
    scene["stages"][1] = {"kind": "clamp", "order": [["R"], ["T"]]}
    scene["stages"][3] = {"kind": "release", "keep": ["R", *keep]}
    return assemble(Scene(**scene, folder=folder), folder / "cache")


@pytest.fixture(scope="module")
def item(everything):
    """Finds a measurement or fixture of the placed scene by its name."""
    scene = everything.scene
    return {one.name: one for one in (*scene.measurements, *scene.fixtures)}.__getitem__


def test_a_hole_is_where_the_sheet_lies_around_a_rim(folder):
    """The ring has one, of its inner diameter; its own outline is none, and the plate has none."""
    (hole,) = find_holes(read_mesh(folder / "ring.inp")[0])
    assert hole.centre == pytest.approx(RING)
    assert hole.size == pytest.approx((2 * RIM, 2 * RIM)) and hole.round
    assert abs(hole.normal[2]) == pytest.approx(1)
    assert find_holes(read_mesh(folder / "plate.inp")[0]) == []


def test_an_oblong_hole_has_length_and_width(tmp_path):
    points, quads = annulus((0, 0, 0), 4, 20)
    points[:, 0] += np.sign(points[:, 0].round(9)) * 3
    (hole,) = find_holes(read_mesh(write_deck(tmp_path / "slot.inp", {"SLOT": (points, quads)}))[0])
    assert hole.size == pytest.approx((14, 8)) and not hole.round
    assert hole.centre == pytest.approx([0, 0, 0], abs=1e-12)


@pytest.mark.slow
def test_a_pin_reads_the_mean_of_the_rim(everything, item):
    """Under any rigid motion the mean of the rim is that of the hole's centre, where there is no sheet."""
    assert item("pin").point == pytest.approx(RING)
    part = everything.parts[1]
    functionals = part.functionals
    patch = functionals.patches[functionals.patch[functionals.label.index("measurement pin")]]
    turn = np.array([0.1, -0.2, 0.3])
    at = part.surface.at(patch.triangle, patch.barycentric)
    read = patch.weight @ np.cross(turn, at - np.array([5.0, 6.0, 7.0]))
    assert read == pytest.approx(np.cross(turn, np.array(RING) - [5.0, 6.0, 7.0]))
    assert np.linalg.norm(at - RING, axis=1).min() > 0.95 * RIM


def test_normal_is_that_of_the_sheet_and_a_minus_turns_it(item):
    n, turned, at_hole = (np.array(item(name).direction) for name in ("normal", "turned", "over-hole"))
    assert n == pytest.approx([0, 0, n[2]]) and abs(n[2]) == pytest.approx(1)
    assert turned == pytest.approx(-n) and at_hole == pytest.approx(n)


def test_a_node_and_the_middle_of_a_set_are_where_the_deck_has_them(item):
    """1001 is the ring's first node: on the rim, along x."""
    assert item("node").point == pytest.approx((RING[0] + RIM, RING[1], RING[2]))
    assert np.linalg.norm(np.subtract(item("set").point, RING)) == pytest.approx(RIM, abs=0.2)


def test_an_axis_is_laid_into_a_sheet_that_stands_askew(tmp_path):
    """A sheet that rises by 3 in 4: x laid into it points up the slope, y lies in it, z points up the slope too."""
    sheet = extruded([(0, 0), (80, 60)], 0, 40, 5)
    write_deck(tmp_path / "slope.inp", {"S": sheet})
    rows = [([8, 5, 6], "normal"), ([72, 5, 54], "normal"), ([40, 35, 30], "-normal")]
    rows += [([8, 5, 6], "in-plane y"), ([72, 5, 54], "in-plane y"), ([40, 20, 30], "-in-plane x")]
    scene = Scene(
        name="slope",
        parts=[{"name": "slope", "mesh": "slope.inp", "thickness": 1}],
        locators=[{"name": f"L{i}", "part": "slope", "point": p, "direction": d} for i, (p, d) in enumerate(rows)],
        measurements=[
            {"name": "M", "part": "slope", "point": [40, 20, 30], "direction": "in-plane z", "lower": -1, "upper": 1}
        ],
        stages=[{"kind": "locate"}, {"kind": "measure"}],
        folder=tmp_path,
    )
    found = assemble(scene, tmp_path / "cache").scene
    a, b, c, d, e, f = (np.array(item.direction) for item in found.locators)
    assert abs(a @ [-0.6, 0, 0.8]) == pytest.approx(1) and a == pytest.approx(b) and c == pytest.approx(-a)
    assert d == pytest.approx([0, 1, 0]) and e == pytest.approx([0, 1, 0])
    assert f == pytest.approx([-0.8, 0, -0.6])
    assert found.measurements[0].direction == pytest.approx([0.8, 0, 0.6])


def test_a_tong_is_two_jaws_that_push_its_parts_together(everything):
    below, above, turned, _ = everything.scene.clamps
    assert (below.name, below.part, below.direction) == ("T-plate", "plate", pytest.approx((0, 0, 1)))
    assert (above.name, above.part, above.direction) == ("T-ring", "ring", pytest.approx((0, 0, -1)))
    assert turned.direction == pytest.approx(np.array([0, 0.3, -1]) / np.hypot(0.3, 1)) and turned.part == "ring"


def test_order_keep_and_deviations_may_name_a_tong(everything):
    scene = everything.scene
    assert scene.stages[1].order == [["R-ring", "R-plate"], ["T-plate", "T-ring"]]
    assert scene.stages[3].keep[:2] == ["R-ring", "R-plate"]
    assert scene.deviations[0].target == ["T-plate", "T-ring"]
    (source,) = sources(scene)
    assert source.push(everything.labels) == {("clamp", 0): 1.0, ("clamp", 1): 1.0}


@pytest.mark.slow
def test_the_dump_of_a_placed_scene_is_the_same_placed_scene(folder):
    measurement = {"name": "M", "part": "ring", "hole": list(RING), "lower": -1, "upper": 1}
    scene = placed(folder, clamps=[TONG], measurements=[measurement])
    again = Scene(**scene.model_dump(), folder=folder)
    assert again == scene
    assert assemble(again, folder / "cache").scene == again


#: Items that cannot be placed: table, keys, and words of the message.
WRONG = [
    ("measurements", {"hole": [50, 50, 1]}, [").hole", "near (50, 50, 1)", "16 mm across", "(30, 30, 1)"]),
    ("measurements", {"part": "plate", "hole": [30, 30, 0]}, ["'plate' has no hole"]),
    (
        "measurements",
        {"point": PAD, "direction": "in-plane z"},
        [").direction", "z stands across the sheet", '"in-plane x" or "in-plane y"'],
    ),
    ("measurements", {"node": 77}, [").node", "has no node 77 on its surface", "1001, at (38, 30, 1)"]),
    ("measurements", {"set": "LCO"}, [").set", "no set of nodes 'LCO'", "nearest name is 'LOC'"]),
    ("measurements", {"set": "RIMS"}, ["2 nodes of 'RIMS'", "7.93 mm away from part 'ring'", "(38, 30, 1)"]),
    ("clamps", TONG | {"point": [3, 3, 0.5]}, [").point", "away from part 'ring'", "nearest point on it is"]),
    (
        "clamps",
        TONG | {"direction": [0, 0, -1]},
        [").direction", "does not push 'plate' towards 'ring'", "(0, 0, 1)"],
    ),
]


def blank(kind):
    """An item without place."""
    return {"name": "X"} | ({"part": "ring", "lower": -1, "upper": 1} if kind == "measurements" else {})


def test_items_that_cannot_be_placed_are_reported_together_with_the_nearest_place(folder):
    """RIMS are two nodes across the rim, and their middle lies in the hole."""
    changes = {"measurements": [], "clamps": []}
    for i, (kind, keys, _) in enumerate(WRONG):
        changes[kind].append(blank(kind) | keys | {"name": f"X{i}"})
    with pytest.raises(mic.SceneError) as caught:
        placed(folder, **changes)
    lines = str(caught.value).splitlines()
    assert len(lines) == len(WRONG)
    for i, (kind, _, words) in enumerate(WRONG):
        (line,) = (line for line in lines if f"(X{i})" in line)
        assert line.startswith(kind) and all(word in line for word in words)


def test_locators_placed_by_words_must_hold_their_part(folder):
    """Six rows all along the normal hold three motions, which is known once the mesh is read."""
    locators = located("plate", 0)
    for item in locators:
        item["direction"] = "normal"
    with pytest.raises(mic.SceneError, match="plate.*hold 3 of its 6"):
        placed(folder, locators=locators + located("ring", 1))


REFUSED = [
    ("measurements", {}, "give point = [x, y, z], or node or set or hole"),
    ("measurements", {"point": PAD, "node": 3}, "point and node both give its place"),
    ("measurements", {"point": PAD, "direction": "up"}, "'up' is no direction"),
    ("clamps", TONG | {"part": "ring"}, "give either part, which it pushes, or parts"),
    ("clamps", TONG | {"parts": ["ring", "ring"]}, "name two different parts"),
    ("clamps", TONG | {"direction": "-normal"}, "a tong presses its parts together"),
    ("fixtures", {"node": 3, "normal": [0, 0, 1]}, "node needs a part: add part"),
    ("fixtures", {"point": [0, 0, 0], "normal": "normal"}, "'normal' needs a part: add part"),
    ("fixtures", {"point": [0, 0, 0]}, "point, normal and radius of a flat pad"),
    ("fixtures", {"part": "plate", "node": 3, "set": "LOC"}, "node and set both give the place of the pad"),
    ("fixtures", {"part": "plate"}, "the place of the pad on its part is missing"),
    ("fixtures", {"part": "plate", "node": 3, "radius": None}, "a pad needs radius"),
    ("fixtures", {"part": "plate", "node": 3, "normal": "in-plane x"}, "the normal of a pad on a part"),
    ("fixtures", {"part": "plaet", "node": 3}, "fixtures[0].part (X): there is no part called 'plaet'; did you mean"),
]


@pytest.mark.parametrize("kind, keys, words", REFUSED)
def test_a_place_that_makes_no_sense_is_refused_before_any_mesh_is_read(folder, kind, keys, words):
    item = blank(kind) | ({"radius": 6} if kind == "fixtures" else {}) | keys | {"name": "X"}
    item = {key: value for key, value in item.items() if value is not None}
    with pytest.raises(ValueError, match=re.escape(words)):
        Scene(**table(**{kind: [item]}), folder=folder / "nowhere")


CSV = """name; x; y; z; parts; radius
W1; 12; 30; 0.5; plate ring; 3
W2; 48; 30; 0.5; plate ring;
"""


def test_rows_of_a_csv_are_items_and_columns_come_before_the_table(folder, tmp_path):
    (tmp_path / "welds.csv").write_text(CSV)
    scene = Scene(**table(welds=[{"file": "welds.csv", "radius": 2, "moment": False}]), folder=tmp_path)
    first, second = scene.welds
    assert (first.name, first.point, first.radius, first.moment) == ("W1", (12, 30, 0.5), 3, False)
    assert (second.name, second.parts, second.radius) == ("W2", ("plate", "ring"), 2)


def test_rows_without_a_name_are_numbered(tmp_path):
    (tmp_path / "kc.csv").write_text("part,x,y,z,direction\nring,12,30,1,normal\nring,12,30,1,0 0 -2\n")
    scene = Scene(**table(measurements=[{"file": "kc.csv", "lower": -1, "upper": 1}]), folder=tmp_path)
    assert [(item.name, item.direction) for item in scene.measurements] == [("kc-1", "normal"), ("kc-2", (0, 0, -1))]


@pytest.mark.parametrize(
    "given, words",
    [
        ({"points": []}, r"welds\[0\].points: the list is empty"),
        ({"points": [[12, 30, 0.5]], "point": [48, 30, 0.5]}, r"welds\[0\]: give either point, for one weld, or poi"),
    ],
)
def test_a_weld_of_points_has_some_and_no_other(given, words):
    with pytest.raises(ValueError, match=words):
        Scene(**table(welds=[{"name": "W", "parts": ["plate", "ring"], **given}]))


def test_a_weld_with_points_is_a_weld_at_each():
    weld = {"name": "W", "parts": ["plate", "ring"], "points": [[12, 30, 0.5], [48, 30, 0.5]], "radius": 3}
    scene = Scene(**table(welds=[weld]))
    assert [(item.name, item.point, item.radius) for item in scene.welds] == [
        ("W-1", (12, 30, 0.5), 3),
        ("W-2", (48, 30, 0.5), 3),
    ]


def test_every_invalid_cell_is_reported_with_file_row_and_column(folder, tmp_path):
    rows = ["name,x,y,z,parts,radius,moment", "W1,12,30,0.5,plate ring,3,true", "W 2,12,thirty,0.5,plate ring,-3,true"]
    rows += ["", "W4,12,30,,plate rng,3,perhaps"]
    (tmp_path / "welds.csv").write_text("\n".join(rows))
    with pytest.raises(ValueError) as caught:
        Scene(**table(welds=[{"file": "welds.csv"}]), folder=tmp_path)
    where = f"{tmp_path / 'welds.csv'}: row "
    for place in ("3, column y", "3, column radius", "5, column z", "5, column moment"):
        assert f"{where}{place}: " in str(caught.value)
    assert f"{where}5, column parts: there is no part called 'rng'; did you mean 'ring' (from " in str(caught.value)
    assert str(caught.value).count(where) == 5


BAD_FILES = {
    "missing": (None, "this table does not exist"),
    "column": ("name,x,y,z,raduis\nW,1,2,3,4\n", "there is no column 'raduis'; did you mean 'radius'"),
    "two coordinates": ("name,x,y\nW,1,2\n", "there is only x and y"),
    "ragged": ("name,x,y,z\nW,1,2,3,4,5\n", "not a table"),
    "empty": ("", "not a table"),
    "header only": ("name,x,y,z\n", "no row below the header"),
    "binary": (b"\xff\xfe\x00\x01\x00", "cannot be read as text"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_file_that_is_no_table_ends_in_one_sentence(tmp_path, case):
    content, words = BAD_FILES[case]
    if content is not None:
        (tmp_path / "welds.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=words):
        Scene(**table(welds=[{"file": "welds.csv", "parts": ["plate", "ring"]}]), folder=tmp_path)


def test_the_scene_file_is_named_in_every_line(tmp_path):
    (tmp_path / "welds.csv").write_text("name,x,y,z\nW,a,b,3\n")
    (tmp_path / "scene.toml").write_text('name = "x"\n[[welds]]\nfile = "welds.csv"\n')
    with pytest.raises(mic.SceneError) as caught:
        load_scene(tmp_path)
    lines = str(caught.value).splitlines()
    assert len(lines) >= 2 and all(line.startswith(str(tmp_path / "scene.toml")) for line in lines)


def test_a_pad_is_set_against_the_skin_that_it_looks_at(everything, item):
    """The plate's mid-surface lies at z = 0 and its skins at ±0.5; the ring's upper skin lies at 1.5."""
    n = everything.parts[0].surface.normals[0] @ [0, 0, 1]
    assert abs(n) == 1
    for name, sense in (("below", -n), ("up", 1.0), ("normal", n), ("node", 1.0)):
        pad = item(f"pad-{name}")
        assert pad.point == pytest.approx((25, 20, -0.5 * sense)) and pad.normal == pytest.approx((0, 0, sense))
        assert pad.part is None and pad.node is None  # once placed, a pad is given by coordinates
    assert item("pad-set").point[2] == item("pad-hole").point[2] == pytest.approx(1.5)
    assert item("pad-hole").point[:2] == pytest.approx(RING[:2])
    zone, point = everything.contacts.zone, everything.contacts.point
    assert np.unique(zone).tolist() == list(range(6)) and everything.contacts.gap == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(point[zone == 5, :2] - RING[:2], axis=1).min() > 0.9 * RIM
    assert any(line.startswith("fixtures[0] (pad-below)") for line in everything.placed)
