"""LS-DYNA, Ansys, universal and CAD files, and malformed decks of each format."""

import sys
import time

import numpy as np
import pytest
from pydantic import ValidationError
from support.gmsh_files import gmsh_model
from support.mesh_texts import AREA, deck_text

from mic.errors import FormatError
from mic.geometry.readers import READERS, gmsh_program, read_mesh
from mic.scene.part import Part
from mic.system import foreign_files

DYNA = deck_text("parts.k")
UNIVERSAL = deck_text("parts.unv")
ANSYS = deck_text("parts.cdb")
ABAQUS = deck_text("parts.inp")
NASTRAN = deck_text("parts.bdf")


def written(tmp_path, text, name):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_ls_dyna_decks_give_parts_sections_materials_and_sets(tmp_path):
    surface, deck = read_mesh(written(tmp_path, DYNA, "a.k"))
    assert deck.parts == ("pocket", "rib") and surface.areas[deck.element_sets["pocket"]].sum() == pytest.approx(1.25)
    (pocket,), (rib,) = (deck.distinct_sheets(deck.element_sets[name]) for name in deck.parts)
    assert (pocket.thickness, pocket.offset, pocket.young, pocket.poisson) == (1.5, -0.5, 210e3, 0.29)
    assert (rib.thickness, rib.offset, rib.young) == (0.8, pytest.approx(0.5), 210e3)
    assert len(deck.node_sets["row"]) == 2 and len(deck.points_of(10)) == 1
    assert deck.ignored_elements == {"MASS": 1, "CONSTRAINED_NODAL_RIGID_BODY": 1}
    wide = "*KEYWORD LONG=Y\n*NODE\n" + "".join(
        f"{n:20d}{x:20.1f}{y:20.1f}{0:20.1f}\n" for n, x, y in ((1, 0, 0), (2, 1, 0), (3, 1, 1))
    )
    wide += "*ELEMENT_SHELL\n" + "".join(f"{n:20d}" for n in (1, 1, 1, 2, 3, 3)) + "\n"
    assert read_mesh(written(tmp_path, wide, "wide.key"))[0].areas.sum() == pytest.approx(0.5)
    (tmp_path / "mesh.k").write_text(DYNA[: DYNA.index("*PART")] + "*END\n")
    main = "*KEYWORD\n*INCLUDE\nmesh.k\n" + DYNA[DYNA.index("*PART") :]
    assert read_mesh(written(tmp_path, main, "main.k"))[1].parts == ("pocket", "rib")


def test_ansys_decks_give_sections_materials_and_components(tmp_path):
    surface, deck = read_mesh(written(tmp_path, ANSYS, "a.cdb"))
    assert deck.parts == ("PID 3", "PID 4") and surface.areas[deck.element_sets["POCKET"]].sum() == pytest.approx(1.25)
    (thick,), (thin,) = (deck.distinct_sheets(deck.element_sets[name]) for name in deck.parts)
    assert (thick.thickness, thick.offset, thick.young, thick.poisson) == (1.5, -0.5, 210e3, 0.29)
    assert (thin.thickness, thin.offset, thin.material) == (0.8, None, "1")
    assert len(deck.node_sets["ROW"]) == 3 and len(deck.points_of(10)) == 1 and deck.ignored_elements == {"type 21": 1}
    assert read_mesh(tmp_path / "a.cdb", ["4"])[0].areas.sum() == pytest.approx(0.625)


def test_universal_files_give_groups(tmp_path):
    surface, deck = read_mesh(written(tmp_path, UNIVERSAL, "a.unv"), ["pocket"])
    assert surface.areas.sum() == pytest.approx(1.25) and len(deck.node_sets["pocket"]) == 2
    assert deck.ignored_elements == {"kind 11": 1}


@pytest.mark.fem
def test_a_cad_sheet_is_meshed_with_the_given_size_and_a_solid_refused(tmp_path):
    with gmsh_model() as gmsh:
        gmsh.model.occ.addRectangle(0, 0, 0, 30, 20)
        gmsh.model.occ.synchronize()
        for suffix in ("step", "igs", "brep"):
            gmsh.write(str(tmp_path / f"sheet.{suffix}"))
        gmsh.clear()
        gmsh.model.occ.addBox(0, 0, 0, 30, 20, 1)
        gmsh.model.occ.synchronize()
        gmsh.write(str(tmp_path / "solid.step"))
    counts = []
    for size in (5.0, 2.5):
        surface, _ = read_mesh(tmp_path / "sheet.step", size=size)
        assert surface.areas.sum() == pytest.approx(600) and surface.edge_lengths.max() < 1.5 * size
        counts.append(len(surface.triangles))
    assert counts[1] > counts[0]
    for suffix in ("igs", "brep"):
        assert read_mesh(tmp_path / f"sheet.{suffix}", size=5.0)[0].areas.sum() == pytest.approx(600)
    with pytest.raises(FormatError, match="it holds a solid, whose skin is no mid-surface"):
        read_mesh(tmp_path / "solid.step", size=5.0)
    with pytest.raises(FormatError, match="needs an element size"):
        read_mesh(tmp_path / "sheet.step")
    (tmp_path / "cut.step").write_bytes((tmp_path / "sheet.step").read_bytes()[:900])
    with pytest.raises(FormatError, match=r"gmsh cannot read this CAD file|no triangles"):
        read_mesh(tmp_path / "cut.step", size=5.0)


def test_a_part_from_cad_needs_a_size_in_mm():
    assert Part(name="a", mesh="a.STEP", size=2, thickness=1.0).size == 2.0
    for keys in ({}, {"size": "coarse"}, {"size": 2, "accuracy": 0.01}):
        with pytest.raises(ValidationError, match="a CAD file needs an element size|accuracy applies"):
            Part(name="a", mesh="a.step", thickness=1.0, **keys)
    with pytest.raises(ValidationError, match="size applies to geometry sources only"):
        Part(name="a", mesh="a.inp", size=2, thickness=1.0)


def test_a_cad_file_without_gmsh_is_refused_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda *args, **keys: None)
    with pytest.raises(FormatError, match=r"a\.step: gmsh, which reads CAD files, is missing; install it"):
        read_mesh(written(tmp_path, "ISO-10303-21;\n", "a.step"), size=1.0)


def test_decks_with_other_encodings_line_ends_and_cases_are_read(tmp_path):
    """Byte-order marks, the line ends of Windows, tabs, keywords in small letters, commas at the ends of lines."""
    small = (
        ABAQUS.lower().replace("\n1, 1, 2, 3, 4\n", "\n1,\n1, 2, 3, 4,\n").replace("1, 0., 0., 0.", "1, 0., 0., 0.,")
    )
    for name, text in (("a.inp", small), ("a.bdf", NASTRAN.lower()), ("a.k", DYNA), ("a.unv", UNIVERSAL)):
        for mark, end in ((b"\xef\xbb\xbf", "\n"), (b"", "\r\n"), (b"\xef\xbb\xbf", "\r\n")):
            (tmp_path / name).write_bytes(mark + text.replace("\n", end).encode())
            assert read_mesh(tmp_path / name)[0].areas.sum() == pytest.approx(AREA), name
    tabs = "GRID\t1\t\t0.\t0.\t0.\nGRID\t2\t\t1.+0\t0.\t0.\nGRID\t3\t\t1.0D+0\t1.\t0.\nCTRIA3\t1\t1\t1\t2\t3\n"
    assert read_mesh(written(tmp_path, tabs, "tabs.nas"))[0].areas.sum() == pytest.approx(0.5)


@pytest.mark.slow
def test_a_mesher_that_hangs_is_stopped(tmp_path, monkeypatch):
    hanging = tmp_path / "gmsh"
    hanging.write_text(f"#!{sys.executable}\n# python\nimport time\ntime.sleep(60)\n")
    hanging.chmod(0o755)
    monkeypatch.setattr("shutil.which", lambda *args, **keys: str(hanging))
    monkeypatch.setattr(gmsh_program, "LIMIT", 0.5)
    started = time.monotonic()
    with pytest.raises(FormatError, match=r"gmsh took more than 0\.5 s"):
        read_mesh(written(tmp_path, "ISO-10303-21;\n", "a.step"), size=1.0)
    assert time.monotonic() - started < 20


def test_a_reader_that_hangs_is_stopped(tmp_path, monkeypatch):
    def hang(path):
        while True:
            pass

    monkeypatch.setitem(READERS, ".new", hang)
    monkeypatch.setattr(foreign_files, "LIMIT", 0.1)
    with pytest.raises(FormatError, match=r"a\.new: this mesh file was not read in 0 s: it is damaged"):
        read_mesh(written(tmp_path, "", "a.new"))


SYSTEM = "    -1\n  2420\n1\nname\n1 1 8\ncs\n" + "0 0 1\n" * 4 + "    -1\n"
#: Malformed decks by suffix: a text of the deck, its replacement, and words of the message.
MALFORMED = {
    "inp": (
        ABAQUS,
        [
            ("2, 1., 0., 0.", "2, 1., zero, 0.", r"line 1: a field of this \*NODE is no number"),
            ("3, 1., 1., 0.", "2, 1., 1., 0.", r"line 1: node 2 is defined twice"),
            ("2, 2, 10, 3", "1, 2, 10, 3", "line 9: element 1 is defined twice"),
            ("1, 1, 2, 3, 4", "1, 1, 2, 3", "element 1: a S4R has 4 nodes, not 3"),
            ("type=S3", "type=S7", "S7 is no known shell"),
            ("type=S4R", "type=SC8R", r"solid elements \(SC8R\)"),
            ("*Node\n", "*Node, system=Q\n", "SYSTEM=Q is unknown; use R, C or S"),
            ("*Node\n", "*Include, input=none.inp\n*Node\n", "line 1: it includes none.inp, and there is no file"),
            ("*Node\n", "*Include, input=a.inp\n*Node\n", "includes a.inp, which includes it in turn"),
            ("*Element, type=S3", "*Ngen\n1, 10\n*Element, type=S3", r"\*NGEN generates the mesh by a rule"),
            ("*Element, type=S3", "*Nset, nset=a, generate\n3, 1\n*Element, type=S3", "generates no numbers"),
            ("*Element, type=S3", "*Nset\n3, 1\n*Element, type=S3", r"this \*NSET has no name"),
            ("*Node\n", "*Assembly\n*Instance, name=i, part=q\n*End Instance\n*Node\n", "instance 'i' is missing"),
            ("*Node\n", "*System\n0,0,0,1,0,0\n2,0,0\n*Node\n", "are collinear"),
            ("*Element, type=S3", "*Shell section, elset=rib, offset=field\n1.\n*Element, type=S3", "OFFSET = FIELD"),
            ("*Node\n", "1, 2, 3\n*Node\n", "data before the first keyword"),
        ],
    ),
    "bdf": (
        NASTRAN,
        [
            ("GRID,3,", "GRID,2,", "line 4: grid point 2 is defined twice"),
            ("CTRIA3,2,", "CTRIA3,1,", "line 8: element 1 is defined twice"),
            ("CTRIA3,2,8,2,10,3", "CTRIA3,2,8,2,10", "line 8: a field of this CTRIA3 is no number, or is missing"),
            ("CTRIA3,2,8", "CTRIB3,2,8", "line 8: CTRIB3 is no known shell"),
            ("BEGIN BULK", "INCLUDE 'none.bdf'\nBEGIN BULK", "line 1: it includes none.bdf, and there is no file"),
            ("BEGIN BULK", "INCLUDE 'a.bdf'\nBEGIN BULK", "includes a.bdf, which includes it in turn"),
            ("BEGIN BULK", "INCLUDE 'a", "line 1: the name of the included file has no closing quote|there is no file"),
            ("GRID,4,,", "GRID,4,basic,", "the coordinate system 'basic' must be a number"),
            ("GRID,4,,", "GRID,4,9,", "coordinate system 9, which does not exist"),
            ("GRID,4,,", "CORD2R,9,9,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\nGRID,4,9,", "system 9 is defined by itself"),
            ("GRID,4,,", "CORD2R,9,,0.,0.,0.,0.,0.,1.\n,0.,0.,2.\nGRID,4,9,", "system 9 are collinear"),
            ("GRID,4,,", "CORD1R,9,1,2,77\nGRID,4,9,", "refers to grid point 77, which does not exist"),
            ("CTRIA3,2,8,2,10,3", "CTRIA3,2,8,2,10,3,,0.5", "has an offset .ZOFFS. and no thickness"),
            ("GRID,4,,0.,1.,0.", "GRID,4,,0.,1.,0.,,,,,7", "a line of free fields has more than 10"),
            ("CTRIA3,2,8", "CHEXA,5,9,1,2,3,4,1,2\nCTRIA3,2,8", r"solid elements \(CHEXA\)"),
        ],
    ),
    "k": (
        DYNA,
        [
            ("1.0             1.0            0.75", "1.0            zero            0.75", "of this .NODE is no"),
            ("       3             1.0", "       2             1.0", "node 2 is defined twice"),
            ("       2       8", "       1       8", "element 1 is defined twice"),
            ("      10       3       3", "      11       3       3", "uses the node 11, which is not defined"),
            ("      10       3       3", "", "element 2 has fewer than three nodes"),
            ("*PART\n", "*INCLUDE_TRANSFORM\na.k\n*PART\n", r"\*INCLUDE_TRANSFORM generates or moves the mesh"),
            ("*KEYWORD\n", "*KEYWORD I10=Y\n", "fields of ten columns"),
            ("       0.8       0.8", "    &thick       0.8", "&thick is a parameter"),
            ("*ELEMENT_SHELL\n", "*ELEMENT_SHELL_COMPOSITE\n", "layers by element are not supported"),
            ("*ELEMENT_MASS", "*ELEMENT_SOLID", r"solid elements \(SOLID\)"),
        ],
    ),
    "cdb": (
        ANSYS,
        [
            ("ET,        1,181", "ET,        1,", "line 2: a field of this ET is no number"),
            ("ET,        1,181", "ET,        1,185", r"solid elements \(type 185\)"),
            ("ET,        1,181\n", "", "element 1 has the type 1, which no ET defines"),
            ("(3i9,6e21.13e3)", "3 and 6", "is not the format of a block"),
            ("(3i9,6e21.13e3)", "(3i9)", "has no coordinates"),
            ("        3        0        0 1.0", "        2        0        0 1.5", "node 2 is defined twice"),
            ("      2      2     10", "      1      2     10", "element 1 is defined twice"),
            ("      2     10      3", "      2     11      3", "uses the node 11, which is not defined"),
            ("EBLOCK,19,SOLID", "EBLOCK,19,", "in the format SOLID"),
            ("SECOFFSET,TOP", "SECOFFSET,USER,0.3", "SECOFFSET USER is not supported"),
            (ANSYS[ANSYS.index("       -1\nCMB") :], "", "this block has no end"),
            (ANSYS, "nothing\n", "there is no block of nodes"),
        ],
    ),
    "unv": (
        UNIVERSAL,
        [
            ("   1.0000000000000000D+00   0.", "   one   0.", r"line 2: a field of this dataset 2411 is no number"),
            ("         3         1         1        11", "         2         1         1        11",
             "node 2 is defined"),
            ("         2        91", "         1        91", "element 1 is defined twice"),
            ("         2        10", "         2        11", "uses the node 11, which is not defined"),
            ("         2        10         3\n", "", "element 2 has fewer than its 3 nodes"),
            ("94         7         1         7         4", "94         7         1         7         5", "5"),
            ("        94", "       115", r"solid elements \(kind 115\)"),
            ("         7         1         0         0\n    -1", "    -1", "fewer than its 3 members"),
            ("         7         1         0         0\n    -1", "", "this dataset has no end"),
            ("  2412", "   780", "elements of this former format are not supported"),
            ("    -1\n  2412", SYSTEM + "    -1\n  2412", "system 1, which is not the global"),
            (UNIVERSAL, "no file\n", "no dataset between lines of -1"),
        ],
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    "suffix, old, new, words", [(s, *case) for s, (_, cases) in MALFORMED.items() for case in cases]
)
def test_a_malformed_deck_is_refused_in_one_sentence(tmp_path, suffix, old, new, words):
    text = MALFORMED[suffix][0]
    assert text.count(old) >= 1
    path = written(tmp_path, text.replace(old, new, 1), f"a.{suffix}")
    with pytest.raises(FormatError, match=words) as caught:
        read_mesh(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and not any(word in message for word in ("\n", "cannot be read", "Error"))


@pytest.mark.parametrize("suffix", MALFORMED)
def test_a_deck_without_any_one_line_is_read_or_refused(tmp_path, suffix):
    """No hang, no exception of a library and no more area than in the deck."""
    lines = MALFORMED[suffix][0].splitlines(keepends=True)
    for lost in range(len(lines)):
        before, half = "".join(lines[:lost]), lines[lost][: len(lines[lost]) // 2]
        for text in (before + "".join(lines[lost + 1 :]), before + half):
            try:
                surface, _ = read_mesh(written(tmp_path, text, f"a.{suffix}"))
            except FormatError as problem:
                assert "\n" not in str(problem) and "cannot be read" not in str(problem)
            else:
                assert surface.areas.sum() < AREA + 1e-9 and np.ptp(surface.points, axis=0).max() <= 2
