"""Mesh files of every format are read, and every invalid file is refused in one sentence."""

import re

import meshlane
import numpy as np
import pytest
from support.gmsh_files import gmsh_model, rectangles
from support.mesh_texts import ABAQUS, AREA, FILES, NASTRAN_FREE, OBJ, PLY, POINTS, VTK

from mic.errors import FormatError
from mic.geometry.normals import Rule
from mic.geometry.readers import READERS, read_mesh
from mic.geometry.readers.vtu import write_vtu

#: Formats that nobody writes by hand, and the package that they need, if any.
WRITTEN = {".cdb": None, ".meshb": None, ".vtu": None, ".xdmf": "h5py"}
BY_GMSH = {".msh", ".med"}


def test_a_file_of_every_format_is_tried():
    tried = {name[name.rindex(".") :].lower() for name in FILES} | {*WRITTEN} | BY_GMSH
    assert tried == set(READERS)


@pytest.mark.parametrize("suffix", WRITTEN)
def test_a_file_that_a_library_wrote_is_read(tmp_path, suffix):
    if WRITTEN[suffix]:
        pytest.importorskip(WRITTEN[suffix])
    sheet = meshlane.Mesh(POINTS, [("triangle", np.array([[0, 1, 2], [0, 2, 3], [1, 4, 2]]))])
    meshlane.write(tmp_path / f"sheet{suffix}", sheet)
    surface, _ = read_mesh(tmp_path / f"sheet{suffix}")
    assert surface.points == pytest.approx(POINTS) and surface.areas.sum() == pytest.approx(AREA)


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_each_format_is_read(tmp_path, name):
    (tmp_path / name).write_text(FILES[name])
    surface, deck = read_mesh(tmp_path / name)
    points = surface.points
    assert len(surface.triangles) == 3 and deck.repair.pieces == 1 and not deck.repair.triangles_turned
    assert surface.areas.sum() == pytest.approx(AREA) and surface.normals[:, 2] == pytest.approx(0.8)
    assert points[np.lexsort(points.T)] == pytest.approx(POINTS[np.lexsort(POINTS.T)])


@pytest.mark.parametrize(
    "kinds", [("S4", "S3R"), ("R3D4", "R3D3"), ("s4t", "dS3"), ("M3D4R", "M3D3"), ("CPS4I", "CPE3")]
)
def test_every_shell_element_of_a_deck_is_read(tmp_path, kinds):
    (tmp_path / "a.inp").write_text(ABAQUS.replace("S4R", kinds[0]).replace("S3", kinds[1]))
    assert len(read_mesh(tmp_path / "a.inp")[0].triangles) == 3


@pytest.mark.parametrize("name, text", [("a.bdf", NASTRAN_FREE), ("a.inp", ABAQUS)])
def test_points_keep_the_order_of_the_file_whatever_their_numbers(tmp_path, name, text):
    numbered = re.sub(r"(?<![\w.])3(?![\w.])", "30", text)  # the third of five, and the highest number
    assert numbered.count("30") == 3
    (tmp_path / name).write_text(numbered)
    surface, _ = read_mesh(tmp_path / name)
    assert surface.points == pytest.approx(POINTS) and surface.areas.sum() == pytest.approx(AREA)


@pytest.mark.slow
def test_a_file_of_salome_is_read_with_its_groups(tmp_path):
    with gmsh_model() as gmsh:
        for sheet, name in zip(rectangles(gmsh, 2, 7.0), ("left", "right")):
            gmsh.model.addPhysicalGroup(2, [sheet], name=name)
        gmsh.write(str(tmp_path / "sheet.med"))
    surface, deck = read_mesh(tmp_path / "sheet.med")
    assert surface.areas.sum() == pytest.approx(12) and surface.points[:, 2] == pytest.approx(7)
    assert deck.repair.quadrilaterals_split and deck.repair.pieces == 1
    left, _ = read_mesh(tmp_path / "sheet.med", sets=("left",))
    assert left.areas.sum() == pytest.approx(6) and left.points[:, 0].max() == pytest.approx(3)


def test_a_damaged_file_of_salome_ends_in_one_sentence(tmp_path):
    pytest.importorskip("gmsh")
    (tmp_path / "sheet.med").write_bytes(b"HDF no more")
    with pytest.raises(FormatError, match=r"sheet\.med: .*MED"):
        read_mesh(tmp_path / "sheet.med")


#: A part of the sheet's corners with normals: those of the element 2 at 10 and 3, or of the points 2 and 3.
NORMALS = {
    "snorm.bdf": (
        NASTRAN_FREE.replace("CTRIA3", "SNORM,2,,0.,.6,.8\nSNORM,3,0,0.,0.,-2.\nCTRIA3"),
        {1: (0, 0.6, 0.8), 2: (0, 0, 1)},
    ),
    "normal.inp": (
        ABAQUS.replace("*Elset", "*Normal\n** a comment\n2, 10, 0., .6, .8\n2, 3, 0., 0., -2.\n*Elset"),
        {4: (0, 0.6, 0.8), 2: (0, 0, 1)},
    ),
}


@pytest.mark.parametrize("name", NORMALS)
def test_a_deck_s_normals_are_those_of_the_corners(tmp_path, name):
    text, normals = NORMALS[name]
    (tmp_path / name).write_text(text)
    surface, _ = read_mesh(tmp_path / name)
    triangle = int(np.flatnonzero((surface.triangles == 4).any(axis=1))[0])
    given = surface.curvature.rule == Rule.GIVEN
    for corner, point in enumerate(surface.triangles[triangle]):
        assert given[triangle, corner] == (point in normals)
        if point in normals:
            assert surface.corner_normals[triangle, corner] == pytest.approx(normals[point])
    if name.endswith("inp"):  # one element's alone
        assert given.sum() == 2
    else:
        assert given[surface.triangles == 2].all() and given.sum() == given[np.isin(surface.triangles, (1, 2))].sum()


def test_normals_follow_instances_and_repair(tmp_path):
    """Two placed instances of a part with a quadrilateral and a triangle that runs the other way round."""
    part = ABAQUS.replace("2, 2, 10, 3", "2, 3, 10, 2").replace(
        "*Elset", "*Normal\n2, 10, 0., .6, .8\n1, 4, 0., -.6, .8\n*Elset"
    )
    instances = "".join(f"*Instance, name=P-{z}, part=P\n 0., 0., {z}.\n*End Instance\n" for z in (0, 7))
    (tmp_path / "a.inp").write_text(f"{part}*Assembly, name=A\n{instances}*End Assembly\n")
    surface, deck = read_mesh(tmp_path / "a.inp")
    assert deck.repair.pieces == 2 and deck.repair.triangles_turned == 2
    given = surface.curvature.rule == Rule.GIVEN
    x = surface.points[surface.triangles]
    assert given.sum() == np.sum((x[given][:, 0] == 2) | (x[given][:, 0] == 0))
    for place, z, normal in (((2, 0), 1.5, (0, 0.6, 0.8)), ((0, 1), 0, (0, -0.6, 0.8))):
        here = given & (x[..., :2] == place).all(axis=2)
        assert np.unique(x[here][:, 2]).tolist() == [z, z + 7] and surface.corner_normals[here] == pytest.approx(
            np.tile(normal, (here.sum(), 1))
        )


BAD = {
    "a bulk without sheets.bdf": ("BEGIN BULK\nGRID,1,,0.,0.,0.\nCBAR,1,1,1,1\nENDDATA\n", "only CBAR"),
    "another default system.bdf": ("BEGIN BULK\nGRDSET,,7\n" + NASTRAN_FREE[11:], "coordinate system 7"),
    "a point that is not there.bdf": (NASTRAN_FREE.replace("2,10,3", "2,11,3"), "point 11, which is not defined"),
    "normals in a system.bdf": (NASTRAN_FREE.replace("CTRIA3", "SNORM,2,7,0.,.6,.8\nCTRIA3"), "system 7, which does"),
    "a table of another kind.vtk": (VTK.replace("UNSTRUCTURED_GRID", "POLYDATA"), "POLYDATA"),
    "no mesh.vtk": ("this is no mesh", "cannot be read"),
    "a header alone.off": ("OFF\n# of nothing\n\n", "it ends with its header"),
    "a header without end.ply": (PLY[:40], "header has no end"),
    "a pentagon.obj": (OBJ.replace("f 2//1 5//1 3//1", "f 1 2 5 3 4"), "polygons of more than four corners"),
    "a tetrahedron.vtk": (
        "# vtk DataFile Version 3.0\na\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n0 0 0 1 0 0 0 1 0 0 0 1\n"
        "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n",
        r"solid elements \(tetra\)",
    ),
    "not finite.obj": (OBJ.replace("v 2 0 1.5", "v nan 0 1.5"), "not finite"),
    "of no format.docx": ("", "there is no reader of .docx; .* .bdf, "),
    "of no suffix": ("", "files without a suffix"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_ends_in_one_sentence_that_names_it(tmp_path, name):
    text, words = BAD[name]
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(FormatError, match=words) as caught:
        read_mesh(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_a_package_that_a_format_needs_is_named(tmp_path, monkeypatch):
    def fail(path):
        raise ModuleNotFoundError("No module named 'h5py'", name="h5py")

    monkeypatch.setitem(READERS, ".new", fail)
    (tmp_path / "a.new").write_text("")
    with pytest.raises(FormatError, match="needs the package h5py; install it"):
        read_mesh(tmp_path / "a.new")


@pytest.mark.parametrize("suffix", [suffix for suffix in READERS if suffix != ".med"])  # gmsh starts for each file
def test_rubbish_of_any_suffix_ends_in_one_sentence(tmp_path, suffix):
    path = tmp_path / f"rubbish{suffix}"
    rng = np.random.default_rng(5)
    for content in (b"", b"garbage\n" * 5, b"1\n", rng.integers(0, 256, 300, dtype=np.uint8).tobytes()):
        path.write_bytes(content)
        with pytest.raises(FormatError) as caught:
            read_mesh(path)
        words = re.sub(r"^.*?: ", "", str(caught.value), count=1)
        assert len(words.split()) > 5 and "\n" not in words


def test_fields_in_a_vtu_file_are_unchanged_and_a_damaged_file_is_refused(tmp_path):
    rng = np.random.default_rng(2)
    points, triangles = rng.normal(size=(4, 3)), np.array([[0, 1, 2], [0, 2, 3]])
    data = {"mean": rng.normal(size=(4, 3)), "six_sigma_normal": rng.normal(size=4)}
    path = tmp_path / "fields" / "coulomb-lower.vtu"
    write_vtu(path, points, triangles, data)
    found = meshlane.vtu.read(path).point_data
    assert set(found) == set(data)
    assert all(np.array_equal(found[name], data[name]) for name in data)
    assert [file.name for file in path.parent.iterdir()] == [path.name]  # no temporary file remains
    again, _ = read_mesh(path)
    assert np.array_equal(again.points, points) and np.array_equal(again.triangles, triangles)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(FormatError, match="cut short, damaged"):
        read_mesh(path)
