"""Tables as people have them: every dialect gives the same numbers, and an ambiguous table leads to a question."""

import csv
import re
import tomllib
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.workbooks import workbook

from mic.errors import SceneError
from mic.geometry.readers import READERS
from mic.scene.excel_file import read_workbook
from mic.scene.load import load_scene
from mic.scene.part import CAD
from mic.scene.part_names import PartNames, other_names
from mic.scene.schema import TABLES
from mic.scene.table_columns import Columns, squash
from mic.scene.table_file import TableSettings, open_table
from mic.scene.table_rows import read_rows
from mic.scene.tables import expand_tables
from mic.scene.weld import Weld

PARTS = PartNames({"rail": ["rail.inp", "rail", "PID 1"], "plate": ["plate.bdf", "plate", "PID 2"], "cap": ["cap.stl"]})


def rows_of(folder, content, kind, name="table.csv", **keys):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    rows, said = read_rows(path, kind, None, TableSettings(**keys), PARTS)
    return [row for _, row in rows], said


CASES = tomllib.loads((Path(__file__).parent / "data" / "tables.toml").read_text(encoding="utf-8"))


def content_of(case):
    """Bytes of a table of ``tables.toml``."""
    return case["table"].replace("\n", case.get("line_end", "\n")).encode(case.get("encoding", "utf-8"))


def first_item(case):
    """The first item of such a table."""
    return CASES["items"][case["kind"]] | case.get("first", {})


@pytest.mark.parametrize("name", CASES["read"])
def test_tables_as_people_have_them_are_read_unchanged(name, tmp_path):
    case = CASES["read"][name]
    rows, said = rows_of(tmp_path, content_of(case), TABLES[case["kind"]])
    assert rows[0] == first_item(case)
    assert said.startswith("columns read: ")


@pytest.mark.parametrize("name", CASES["read"])
def test_the_same_tables_in_a_workbook_give_the_same(name, tmp_path):
    """Numbers are cells of numbers; texts such as ±0.5 or (1, 2, 3) stay texts."""
    case = CASES["read"][name]
    kind, first = TABLES[case["kind"]], first_item(case)
    (tmp_path / "a.csv").write_bytes(content_of(case))
    keys = ["x", "y", "z", "force", "diameter", "lower", "upper", "plus_minus", "nominal", "i", "j", "k"]
    others = [*kind.model_fields, "part1", "part2", "coordinates", "tolerance"]
    table = open_table(tmp_path / "a.csv", Columns.of_file([*keys, *others]))
    cells = [list(row) for _, row in table.rows]
    for key in set(keys) & table.key_of.keys():
        for row, value in zip(cells, table.numbers(key)):
            row[table.key_of[key]] = float(value / table.factor(key))
    book = workbook({"Table": [["a title"], [], list(table.header.headers), *cells], "Notes": [["nothing"]]})
    units = {"unit": "in"} if name == "row of units" else {}
    found = rows_of(tmp_path, book, kind, "table.xlsx", **units)[0][0]
    assert found.keys() == first.keys()
    for key, value in first.items():
        if key in ("point", "force"):  # which may have gone through another unit and back
            np.testing.assert_allclose(found[key], value, rtol=1e-15)
        else:
            assert found[key] == value


@pytest.mark.parametrize("name", CASES["asked"])
def test_an_ambiguous_table_leads_to_a_question_that_one_line_answers(name, tmp_path):
    case = CASES["asked"][name]
    kind, content = TABLES[case["kind"]], content_of(case)
    with pytest.raises(SceneError, match=case["question"]) as asked:
        rows_of(tmp_path, content, kind)
    assert "\n" not in str(asked.value)
    row = rows_of(tmp_path, content, kind, **case["answer"])[0][0]
    assert {key: row[key] for key in case["first"]} == case["first"]


REFUSED = {
    "commas separate and mark decimals": ("name,x,y,z\nW1,1,5,2,5,3\n", "row 2 has 6 cells .* semicolons"),
    "commas may do both": ("name,x,y,z,radius\nW1,1,5,2\n", "row 2 has 4 cells .* semicolons"),
    "a cell missing among blanks": ("name x y z radius\nW1 1 2 3\n", "row 2 has 4 cells separated by blanks"),
    "two sheets": (
        workbook({n: [["x", "y", "z"], [1, 2, 3]] for n in "ab"}),
        "'a', 'b' may all be meant.*sheet = \"a\"",
    ),
    "an old workbook": (b"\xd0\xcf\x11\xe0 and more", "Excel before 2007; save it as .xlsx"),
    "no workbook": (b"PK\x03\x04 and more", "no Excel workbook, or a damaged one"),
    "control characters": ("name;x\x00;y;z\n", "cannot be read as text"),
    "coordinates of two axes": ("name;X Coord;Y\nW;1;2\n", "only x and y; rename the others, or name them by a line"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_unreadable_table_is_refused_in_one_sentence(case, tmp_path):
    content, words = REFUSED[case]
    with pytest.raises(SceneError, match=words) as refused:
        rows_of(tmp_path, content, Weld)
    assert "\n" not in str(refused.value)


def test_standard_headers_are_read_without_a_word(tmp_path):
    assert rows_of(tmp_path, "name,x,y,z,parts\nW,1,2,3,rail plate\n", Weld)[1] == ""
    said = rows_of(tmp_path, "Id;x;y;Z [in];colour\nW;1;2;3;red\n", Weld, unit="mm")[1]
    assert said == "columns read: z from 'Z [in]', name from 'Id', z × 25.4, x, y as named; ignored: 'colour'"


finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
bounded = st.floats(-1e300, 1e300)


def european(value: float) -> str:
    """A number with thousands grouped by points and a decimal comma, as German Excel shows it."""
    return american(value).translate(str.maketrans(",.", ".,"))


def american(value: float) -> str:
    text = repr(value)
    whole, _, fraction = text.partition(".")
    return text if "e" in text or whole == "-0" else f"{int(whole):,}.{fraction}"


def with_comma(value: float) -> str:
    return repr(value).replace(".", ",")


#: Separator, number and quoting of each dialect.
DIALECTS = {
    "commas": (",", repr, csv.QUOTE_MINIMAL),
    "quoted": (",", with_comma, csv.QUOTE_ALL),
    "semicolons": (";", repr, csv.QUOTE_MINIMAL),
    "decimal commas": (";", with_comma, csv.QUOTE_MINIMAL),
    "tabs": ("\t", with_comma, csv.QUOTE_MINIMAL),
    "european": (";", european, csv.QUOTE_MINIMAL),
    "american": ("\t", american, csv.QUOTE_MINIMAL),
    "bars": ("|", repr, csv.QUOTE_MINIMAL),
    "blanks": (" ", with_comma, csv.QUOTE_MINIMAL),
}


def written(rows, dialect):
    """A table of numbers in a dialect."""
    separator, number, quoting = DIALECTS[dialect]
    text = StringIO()
    writer = csv.writer(text, delimiter=separator, quoting=quoting, lineterminator="\r\n")
    writer.writerow(["x", "y", "z"])
    writer.writerows([[number(value) for value in row] for row in rows])
    return text.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("dialect", DIALECTS)
@settings(max_examples=25, deadline=None)
@given(rows=st.lists(st.tuples(finite, finite, finite), min_size=1, max_size=6))
@example(rows=[(1.25, 1.125, 1000.5)])
@example(rows=[(1.125, 2.25, 0.0)])
@example(rows=[(1.125, 2.125, 3.125)])
@example(rows=[(-1234567.125, 1e300, -0.0)])
def test_every_dialect_gives_the_same_bits_or_asks(dialect, rows, tmp_path_factory):
    """A number is never another one; the question is allowed only if no number of the table decides."""
    path = tmp_path_factory.mktemp("table") / "a.csv"
    text = written(rows, dialect)
    path.write_text(text, newline="")
    try:
        table = open_table(path, Columns.of_file("xyz"))
        found = np.array([table.numbers(axis) for axis in "xyz"]).T
    except SceneError as question:
        assert "decimal = " in str(question) and dialect not in ("commas", "bars")
        decimal = "." if dialect in ("american", "semicolons") else ","
        table = open_table(path, Columns.of_file("xyz"), settings=TableSettings(decimal=decimal))
        found = np.array([table.numbers(axis) for axis in "xyz"]).T
    assert found.tobytes() == np.array(rows).tobytes()


def readings(cell):
    """The numbers that a cell may mean."""
    values = {float(cell.replace(",", "."))}
    if re.fullmatch(r"\d[.,]\d{3}", cell):
        values.add(float(re.sub("[.,]", "", cell)))
    return values


CELLS = ["1", "12", "1,5", "0,25", "1,250", "-3,5", "1.250", "7.5"]


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    rows=st.lists(st.tuples(*3 * [st.sampled_from(CELLS)]), min_size=1, max_size=4),
    separator=st.sampled_from([",", ";", "\t", " "]),
)
def test_a_comma_is_never_taken_for_a_separator_nor_the_reverse(rows, separator, tmp_path_factory):
    """Cells of three columns, unquoted: each number is one of its own readings, or the table is refused."""
    path = tmp_path_factory.mktemp("table") / "a.csv"
    path.write_text("\n".join([separator.join("xyz"), *(separator.join(row) for row in rows)]) + "\n")
    try:
        table = open_table(path, Columns.of_file("xyz"))
        found = list(zip(*map(table.numbers, "xyz")))
    except SceneError:
        return
    assert len(found) == len(rows)
    for own, row in zip(found, rows):
        assert all(value in readings(cell) for value, cell in zip(own, row))


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(rows=st.lists(st.tuples(bounded, bounded, bounded), min_size=1, max_size=6))
def test_a_workbook_gives_the_bits_that_it_stores(rows, tmp_path_factory):
    path = tmp_path_factory.mktemp("table") / "a.xlsx"
    path.write_bytes(workbook({"Points": [["x", "y", "z"], *rows]}))
    stored = [cells for _, cells in read_workbook(path)["Points"]][1:]
    table = open_table(path, Columns.of_file("xyz"))
    found = np.array([table.numbers(axis) for axis in "xyz"]).T
    assert found.tobytes() == np.array([[float(cell) for cell in row] for row in stored]).tobytes()
    np.testing.assert_allclose(found, rows, rtol=1e-15)  # Excel's writer keeps 16 digits


def test_parts_are_found_by_name_file_property_and_set_in_any_case():
    for text in ("rail", "RAIL", "Rail.INP", "PID 1", "pid_1", "1", "PID1", "01"):
        assert PARTS.find(text) == "rail"
    assert PARTS.find("rial") is None and PARTS.find("3") is None
    for text in ("RAIL/Plate", "1, 2", "rail plate", "rail + plate"):
        assert PARTS.split(text) == ["rail", "plate"]
    assert PARTS.unknown("rial") == "there is no part called 'rial'; did you mean 'rail' (from rail.inp)?"
    same = PartNames({"a": ["both.inp"], "b": ["both.inp"]})
    assert same.find("both.inp") is None
    assert same.unknown("BOTH.inp") == "'BOTH.inp' may be 'a' or 'b'; name one of them"


@pytest.mark.parametrize("suffix", [*READERS, *CAD])
def test_a_part_has_the_name_of_its_file_whatever_the_format(suffix):
    parts = PartNames({"rail": other_names({"mesh": f"sub/Hat{suffix}"}), "hat-2": other_names({"mesh": "Plate.inp"})})
    assert parts.find("HAT") == parts.find(f"hat{suffix.upper()}") == "rail" and parts.find("hat_2") == "hat-2"


def scene_table(folder, **changes):
    parts = [{"name": "rail", "mesh": "rail.inp"}, {"name": "plate", "mesh": "deck.k", "set": "PID 7"}]
    return {"parts": parts, "folder": folder} | changes


def test_a_scene_calls_its_parts_by_any_of_their_names(tmp_path):
    (tmp_path / "w.csv").write_text("Weld;X;Y;Z;Part 1;Part 2\nW 1;1;2;3;RAIL.inp;7\n")
    zones = [{"name": "Z", "parts": ["Rail", "pid_7"]}]
    found = expand_tables(scene_table(tmp_path, welds=[{"file": "w.csv", "radius": 3}], zones=zones), TABLES)
    assert found["welds"] == [{"name": "W_1", "radius": 3, "parts": ["rail", "plate"], "point": [1.0, 2.0, 3.0]}]
    assert found["zones"][0]["parts"] == ["rail", "plate"]
    assert found["tables_read"] == [
        "w.csv: columns read: x from 'X', y from 'Y', z from 'Z', name from 'Weld', part1 from 'Part 1', "
        "part2 from 'Part 2'"
    ]


def test_equal_errors_of_rows_are_one_with_their_count(tmp_path):
    rows = "".join(f"W{i};{i};2;3;rial plate\n" for i in range(9))
    (tmp_path / "w.csv").write_text("name;x;y;z;parts\n" + rows + "V;1;2;three;rail plate\n")
    with pytest.raises(SceneError) as told:
        expand_tables(scene_table(tmp_path, welds=[{"file": "w.csv"}]), TABLES)
    same, other = str(told.value).splitlines()
    assert same.endswith(
        "row 2, column parts: there is no part called 'rial'; did you mean 'rail' (from rail.inp)? "
        "(and in 8 more: 3, 4, 5, 6, 7, …)"
    )
    assert "row 11, column z" in other


def test_an_unknown_part_is_one_error_whatever_its_name(tmp_path):
    (tmp_path / "w.csv").write_text("id;x;y;z;part 1;part 2\nW;1;2;3;Rail (new);plate\n")
    with pytest.raises(SceneError, match=r"no part called 'Rail \(new\)'; did you mean 'rail'") as told:
        expand_tables(scene_table(tmp_path, welds=[{"file": "w.csv"}]), TABLES)
    assert "\n" not in str(told.value)


def test_equal_errors_of_items_are_one_with_their_count(tmp_path):
    weld = '[[welds]]\nname = "W{}"\npoint = [{}, 0, 0]\nparts = ["RAIL", "{}"]\n'
    welds = "".join(weld.format(i, i, "rial" if i < 8 else "pan") for i in range(9))
    parts = '[[parts]]\nname = "rail"\nmesh = "rail.inp"\n[[parts]]\nname = "plate"\nmesh = "plate.inp"\n'
    (tmp_path / "scene.toml").write_text('name = "s"\n' + parts + welds + '[[stages]]\nkind = "locate"\n')
    with pytest.raises(SceneError) as told:
        load_scene(tmp_path)
    lines = [line for line in str(told.value).splitlines() if "no part called" in line]
    assert len(lines) == 2 and "'rial'; did you mean 'rail'? (and in 7 more)" in lines[0] and "'pan'" in lines[1]
    assert "welds[0].parts (W0)" in lines[0]


def test_a_weld_of_three_parts_is_two_of_neighbours(tmp_path):
    (tmp_path / "w.csv").write_text("id,x,y,z,part 1,part 2,part 3\nW,1,2,3,rail,plate,cap\nV,1,2,3,rail,plate,\n")
    table = scene_table(tmp_path, welds=[{"file": "w.csv"}])
    table["parts"].append({"name": "cap", "mesh": "cap.stl"})
    found = expand_tables(table, TABLES)["welds"]
    welds = {one["name"]: one["parts"] for one in found}
    assert welds == {"Wa": ["rail", "plate"], "Wb": ["plate", "cap"], "V": ["rail", "plate"]}


def test_a_locator_of_several_axes_is_one_for_each(tmp_path):
    table = "RPS;Part;X;Y;Z;Direction\nR1;rail;1;2;3;HxyFz\nR2;rail;4;2;3;XZ\nR3;rail;4;5;3;-Z\n"
    (tmp_path / "l.csv").write_text(table)
    found = expand_tables(scene_table(tmp_path, locators=[{"file": "l.csv"}]), TABLES)["locators"]
    assert [(one["name"], one["direction"]) for one in found] == [
        ("R1-x", [1.0, 0.0, 0.0]),
        ("R1-y", [0.0, 1.0, 0.0]),
        ("R1-z", [0.0, 0.0, 1.0]),
        ("R2-x", [1.0, 0.0, 0.0]),
        ("R2-z", [0.0, 0.0, 1.0]),
        ("R3", [0.0, 0.0, -1.0]),
    ]


def test_keys_of_a_table_are_checked(tmp_path):
    (tmp_path / "w.csv").write_text("name;x;y;z;parts\nW;1;2;3;rail plate\n")
    with pytest.raises(SceneError, match=r"welds\[0\].decimal: Input should be '\.' or ','; got ';'"):
        expand_tables(scene_table(tmp_path, welds=[{"file": "w.csv", "decimal": ";"}]), TABLES)
    with pytest.raises(SceneError, match="columns: 'U' is none of name, x, y, z, parts"):
        expand_tables(scene_table(tmp_path, welds=[{"file": "w.csv", "columns": {"x": "U"}}]), TABLES)


def test_headers_differ_by_more_than_case_blanks_and_punctuation():
    assert squash("Tol (+)") == squash("tol+") == "tol+" and squash("Tol-") == squash("Tol. −") == "tol-"
    assert squash("Tol +/-") == squash("±Tol") == "tol±" and squash("Weld_ID") == squash("weld id") == "weldid"
    aliases = Columns.of_file(["x", "lower", "upper", "plus_minus"])
    heads = ("Nom. X (mm)", "X, mm", "Tol-", "TOL [+]", "Tol. ±")
    assert [aliases.key(head)[0] for head in heads] == ["x", "x", "lower", "upper", "plus_minus"]
    assert aliases.key("X [in]")[2] == 25.4 and aliases.key("colour") is None


def test_no_header_names_two_keys():
    """In each kind of table, so that the order of the file of aliases decides nothing."""
    for kind in TABLES.values():
        keys = [*"xyz", *(name for name in kind.model_fields if name != "point")]
        columns = Columns.of_file(keys)
        for key in keys:
            wrong = [alias for alias in columns.aliases[key] if columns.key(alias)[0] != key]
            assert wrong == []
