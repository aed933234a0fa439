"""Content of decks beside the mesh: node numbers, sets, sections, instances, coordinate systems, ignored elements."""

import numpy as np
import pytest
from support.gmsh_files import gmsh_model, rectangles
from support.mesh_texts import AREA, POINTS, deck_text

from mic.errors import FormatError
from mic.geometry.readers import Sheet, read_mesh

# A quadrilateral 1 and a triangle 2 beside it; nodes 1, 2, 3, 4 and 10.
ABAQUS = deck_text("sections.inp")
NASTRAN = deck_text("sections.bdf")
LEFT = Sheet(1.5, -0.5, 210e3, 0.29, "dc04")
RIGHT = Sheet(0.8, 0.2, None, None, "other")


def written(tmp_path, text, name="deck.inp"):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "name, text, sheets",
    [
        ("deck.inp", ABAQUS, (LEFT, RIGHT)),
        ("deck.bdf", NASTRAN, (Sheet(1.5, -0.5, 210e3, 0.29, "7"), Sheet(0.8, 0.2, 210e3, 0.3125, "8"))),
    ],
)
def test_a_deck_gives_its_sets_and_the_sheet_of_each(tmp_path, name, text, sheets):
    surface, deck = read_mesh(written(tmp_path, text, name))
    assert deck.parts == ("left plate", "right")
    for part, sheet, area in zip(("left plate", "right"), sheets, (1.25, 0.625)):
        triangles = deck.element_sets[part]
        assert surface.areas[triangles].sum() == pytest.approx(area)
        (found,) = deck.distinct_sheets(triangles)
        assert (found.thickness, found.material) == (sheet.thickness, sheet.material)
        for key in ("offset", "young", "poisson"):
            assert getattr(found, key) == pytest.approx(getattr(sheet, key)) or getattr(sheet, key) is None
    assert len(deck.distinct_sheets()) == 2


def test_node_numbers_and_sets_are_those_of_the_deck(tmp_path):
    surface, deck = read_mesh(written(tmp_path, ABAQUS))
    for node, place in zip((1, 2, 3, 4, 10), POINTS):
        assert surface.points[deck.points_of(node)] == pytest.approx(place[None])
    assert len(deck.points_of(7)) == 0
    assert surface.points[deck.node_sets["row"]] == pytest.approx(POINTS[[0, 2]])
    assert len(deck.node_sets["all"]) == 5 and len(deck.element_sets["both"]) == 3
    _, deck = read_mesh(written(tmp_path, NASTRAN, "a.bdf"))
    assert len(deck.node_sets["row"]) == 4 and "row" not in deck.element_sets and len(deck.element_sets["PID 1"]) == 2


def test_a_part_is_selected_from_a_deck_by_its_set(tmp_path):
    for name, text, sets in (("a.inp", ABAQUS, ["RIGHT"]), ("a.bdf", NASTRAN, ["2"]), ("a.bdf", NASTRAN, ["right"])):
        surface, deck = read_mesh(written(tmp_path, text, name), sets)
        assert surface.areas.tolist() == pytest.approx([0.625]) and len(surface.points) == 3
        assert len(deck.points_of(1)) == 0 and len(deck.points_of(10)) == 1
        assert [sheet.thickness for sheet in deck.distinct_sheets()] == [0.8] and "left plate" not in deck.element_sets
    _, deck = read_mesh(tmp_path / "a.inp", ["left plate"])
    assert len(deck.element_sets["left plate"]) == len(deck.element_sets["both"]) == 2 and deck.parts == ("left plate",)
    with pytest.raises(FormatError, match="there is no element set 'middle'; the file holds 'left plate', 'right'"):
        read_mesh(tmp_path / "a.inp", ["middle"])


def test_parts_of_one_deck_that_touch_are_not_merged(tmp_path):
    """Two sheets drawn onto each other, on nodes of their own."""
    other = ABAQUS.replace("*Material", "*Node\n21, 0., 0., 0.\n22, 1., 0., 0.75\n23, 1., 1., 0.75\n24, 0., 1., 0.\n"
                           "*Element, type=S4R, elset=upper\n21, 21, 22, 23, 24\n*Material")  # fmt: skip
    path = written(tmp_path, other)
    assert read_mesh(path)[1].repair.triangles_repeated == 2
    for name in ("left plate", "upper"):
        surface, deck = read_mesh(path, [name])
        assert surface.areas.sum() == pytest.approx(1.25)
        assert not deck.repair.triangles_repeated and not deck.repair.points_merged


def test_a_deck_in_another_unit_is_converted_to_mm_and_mpa(tmp_path):
    surface, deck = read_mesh(written(tmp_path, ABAQUS.replace("210000.", "2.1e11")), ["left plate"], "m")
    (sheet,) = deck.distinct_sheets()
    assert surface.areas.sum() == pytest.approx(1.25e6) and sheet.thickness == pytest.approx(1500)
    assert sheet.young == pytest.approx(210e3) and sheet.offset == -0.5
    _, deck = read_mesh(written(tmp_path, ABAQUS.replace("210000.", "3.0e7")), ["left plate"], "in")
    (sheet,) = deck.distinct_sheets()
    assert sheet.young == pytest.approx(206843, rel=1e-5) and sheet.thickness == pytest.approx(38.1)


def test_reversing_a_triangle_reverses_its_offset(tmp_path):
    turned = ABAQUS.replace("2, 2, 10, 3", "2, 3, 10, 2")
    _, deck = read_mesh(written(tmp_path, turned))
    assert deck.repair.triangles_turned == 1
    assert [deck.distinct_sheets(deck.element_sets[name])[0].offset for name in ("left plate", "right")] == [-0.5, -0.2]


def test_instances_are_placed_and_have_their_own_sets(tmp_path):
    head, _, sections = ABAQUS.partition("*Material")
    parts = head.replace("*Heading\n", "*Part, name=P\n")
    parts += "*Shell Section, elset=both, material=DC04\n1.5\n*End Part\n"
    assembly = """*Assembly, name=A
*Instance, name=first, part=p
*End Instance
*Instance, name=second, part=P
 0., 0., 7.
 0., 0., 0., 0., 1., 0., 90.
*End Instance
*Nset, nset=pins, instance=second
 10
*Nset, nset=corner
 first.4, second.row
*End Assembly
"""
    surface, deck = read_mesh(written(tmp_path, parts + assembly + "*Material" + sections.split("*Shell")[0]))
    assert deck.parts == ("first", "second") and deck.repair.pieces == 2
    assert [sheet.young for sheet in deck.distinct_sheets()] == [210e3]
    # shifted along z, then turned about y: z goes to x, x to −z
    assert surface.points[deck.node_sets["pins"]] == pytest.approx(np.array([[8.5, 0, -2.0]]))
    assert len(deck.points_of(10)) == 2 and len(deck.node_sets["corner"]) == 3
    assert len(deck.element_sets["both"]) == 6 and len(deck.element_sets["second.both"]) == 3
    surface, _ = read_mesh(tmp_path / "deck.inp", ["second"])
    assert np.ptp(surface.points[:, 0]) == pytest.approx(1.5) and surface.areas.sum() == pytest.approx(AREA)


def test_elements_other_than_shells_are_ignored_and_counted(tmp_path):
    more = """*Element, type=M3D4R, elset=skin
5, 1, 2, 3, 4
*Element, type=MASS, elset=m
6, 1
7, 2
*Element, type=CONN3D2
8, 1, 3
*Element, type=R3D3, elset=rigid
9, 1, 2, 3
"""
    surface, deck = read_mesh(written(tmp_path, ABAQUS + more))
    assert deck.ignored_elements == {"M3D4R": 1, "MASS": 2, "CONN3D2": 1, "R3D3": 1}
    assert not deck.repair.triangles_repeated
    assert any("ignored elements other than shells: 1 CONN3D2" in note for note in deck.notes())
    with pytest.raises(FormatError, match="the set 'm' holds no triangles or quadrilaterals, only MASS"):
        read_mesh(tmp_path / "deck.inp", ["m"])
    more = "RBE2,90,1,123,2,3\nCONM2,91,1,,1.0\nCBUSH,92,1,1,2\nCELAS2,93,1.,1,1,2,1\nENDDATA"
    _, deck = read_mesh(written(tmp_path, NASTRAN.replace("ENDDATA", more), "a.bdf"))
    assert deck.ignored_elements == {"RBE2": 1, "CONM2": 1, "CBUSH": 1, "CELAS2": 1}


def test_repairs_are_reported_and_usual_steps_are_not(tmp_path):
    assert read_mesh(written(tmp_path, ABAQUS), ["right"])[1].notes() == []
    torn = ABAQUS.replace("2, 2, 10, 3", "2, 3, 10, 12").replace(
        " 10, 2., 0., 1.5", " 10, 2., 0., 1.5\n 12, 1., 0., 0.75"
    )
    notes = "; ".join(read_mesh(written(tmp_path, torn))[1].notes())
    assert notes == "1 points merged with coincident ones; 1 triangles reversed to agree with their neighbours"


def test_midside_nodes_are_dropped_and_counted(tmp_path):
    second = "*Node\n" + "".join(
        f"{n}, {x}, {y}, 0.\n" for n, (x, y) in zip((31, 32, 33, 34), ((0.5, 0), (1, 0.5), (0.5, 1), (0, 0.5)))
    )
    text = ABAQUS.replace("*Element, type=S4R", second + "*Element, type=S8R").replace(
        "1, 1, 2, 3, 4", "1, 1, 2, 3, 4,\n 31, 32, 33, 34"
    )
    surface, deck = read_mesh(written(tmp_path, text))
    assert deck.midside_nodes == 4 and "4 midside nodes dropped" in deck.notes() and len(surface.points) == 5


@pytest.mark.fem
@pytest.mark.parametrize("version, binary", [(2.2, 0), (2.2, 1), (4.0, 0), (4.1, 0), (4.1, 1)])
def test_physical_groups_of_gmsh_are_sets(tmp_path, version, binary):
    with gmsh_model() as gmsh:
        sheets = rectangles(gmsh, 3)  # the last one is in no group; gmsh omits it from older files with groups
        gmsh.model.addPhysicalGroup(2, sheets[:1], 5, name="left part")
        gmsh.model.addPhysicalGroup(2, sheets[1:2], 6)
        for option, value in (("SaveAll", version > 3), ("MshFileVersion", version), ("Binary", binary)):
            gmsh.option.setNumber(f"Mesh.{option}", value)
        gmsh.model.mesh.renumberNodes([1, 2, 3, 4], [1001, 1003, 1002, 1004])
        gmsh.write(str(tmp_path / "sheet.msh"))
        places = {node: gmsh.model.mesh.getNode(node)[0] for node in gmsh.model.mesh.getNodes()[0].tolist()}
    surface, deck = read_mesh(tmp_path / "sheet.msh")
    assert deck.parts == ("left part", "PID 6")
    if version > 3:  # into older files gmsh writes numbers of its own
        assert len(deck.nodes) == len(places) and set(places) == set(deck.nodes.tolist()) >= {1001, 1004}
    for node, place in places.items() if version > 3 else ():
        assert surface.points[deck.points_of(node)] == pytest.approx(place[None])
    assert surface.areas[deck.element_sets["left part"]].sum() == pytest.approx(6)
    assert surface.areas[deck.element_sets["PID 6"]].sum() == pytest.approx(6)
    assert surface.areas.sum() == pytest.approx(18 if version > 3 else 12)
    assert read_mesh(tmp_path / "sheet.msh", ["6"])[0].areas.sum() == pytest.approx(6)
    assert deck.repair.pieces == 1 and deck.repair.quadrilaterals_split


def test_nodes_of_an_old_gmsh_file_keep_their_numbers(tmp_path):
    numbers = dict(zip((7, 3, 12, 5), POINTS.tolist()))
    rows = "".join(f"{n} {x} {y} {z}\n" for n, (x, y, z) in numbers.items())
    head = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
    elements = "$Elements\n2\n1 2 2 0 1 7 3 12\n2 2 2 0 1 7 12 5\n$EndElements\n"
    surface, deck = read_mesh(written(tmp_path, f"{head}$Nodes\n4\n{rows}$EndNodes\n{elements}", "a.msh"))
    for node, place in numbers.items():
        assert surface.points[deck.points_of(node)] == pytest.approx(np.array([place]))


#: The point (1, 2, 3) in systems at (1, 1, 1) whose z axis is the basic x axis, and whose x axis is the basic y axis.
SYSTEMS = {
    "CORD2R": (1.0, 2.0, 0.0),
    "CORD2C": (5**0.5, np.degrees(np.arctan2(2, 1)), 0.0),
    "CORD2S": (5**0.5, 90.0, np.degrees(np.arctan2(2, 1))),
}


@pytest.mark.parametrize("kind", SYSTEMS)
@pytest.mark.parametrize("how", ["GRID", "GRDSET", "CORD1", "chain"])
def test_points_in_nastran_coordinate_systems_are_transformed(tmp_path, kind, how):
    a, b, c = SYSTEMS[kind]
    axes = ((1.0, 1.0, 1.0), (2.0, 1.0, 1.0), (1.0, 2.0, 1.0))  # origin, on z, in xz
    flat = ",".join(f"{value}" for value in np.ravel(axes)[:6])
    rest = ",".join(f"{value}" for value in np.ravel(axes)[6:])
    system = f"{kind},7,0,{flat}\n,{rest}\n"
    cp = "" if how == "GRDSET" else "7"
    if how == "GRDSET":
        system += "GRDSET,,7\n"
    elif how == "CORD1":
        system = "".join(f"GRID,{90 + i},0,{x},{y},{z}\n" for i, (x, y, z) in enumerate(axes))
        system += f"{kind.replace('2', '1')},7,90,91,92\n"
    elif how == "chain":  # the same system given in another one, which is shifted
        moved = np.ravel(axes) - 3.0
        system = f"{kind},7,8," + ",".join(map(str, moved[:6])) + "\n," + ",".join(map(str, moved[6:])) + "\n"
        system += "CORD2R,8,0,3.,3.,3.,3.,3.,4.\n,4.,3.,3.\n"
    grids = f"GRID,1,{cp},{a},{b},{c}\nGRID,2,0,0.,0.,0.\nGRID,3,0,1.,0.,0.\nCTRIA3,1,1,1,2,3\n"
    surface, deck = read_mesh(written(tmp_path, system + grids, "a.bdf"))
    assert surface.points[deck.points_of(1)] == pytest.approx(np.array([[1, 2, 3.0]]))


def test_included_files_are_read(tmp_path):
    (tmp_path / "sub").mkdir()
    nodes, _, rest = ABAQUS.partition("*Element, type=S4R")
    (tmp_path / "sub" / "nodes.inp").write_text(nodes)
    text = "*Include, input=sub/nodes.inp\n*Element, type=S4R" + rest
    assert read_mesh(written(tmp_path, text))[0].areas.sum() == pytest.approx(AREA)
    grids, _, rest = NASTRAN.partition("CQUAD4")
    (tmp_path / "sub" / "rest.bdf").write_text("CQUAD4" + rest.replace("ENDDATA\n", ""))
    path = written(tmp_path, grids + "INCLUDE 'sub/\nrest.bdf'\n", "a.bdf")  # and ENDDATA is missing
    assert read_mesh(path)[0].areas.sum() == pytest.approx(AREA)
