"""Tables of the console and errors of the syntax can be read by somebody who did not write them."""

import re

import pytest
from rich.cells import cell_len

from mic.commands.output import CommandConsole
from mic.errors import SceneError
from mic.scene.load import read_toml

HEADS = ("part", "nodes", "t, mm", "E, MPa", "functionals", "influence coefficients", "nominal overlap", "rest")
ROWS = [("lower", 509, 1, 210000, 346, "to be computed", "", "a sentence of several words"), (*"abcdef", "", "x" * 70)]


@pytest.mark.parametrize("width", [200, 120, 80, 60, 30])
def test_no_heading_is_cut_and_no_column_is_empty(width):
    console = CommandConsole(width=width)
    with console.capture() as capture:
        console.table("Parts", HEADS, ROWS)
    printed = capture.get()
    for word in " ".join(head for head in HEADS if head != "nominal overlap").split():
        assert re.search(rf"(?<!\w){re.escape(word)}(?!\w)", printed), printed
    assert "…" not in printed and "nominal overlap" not in printed
    if "┃" in printed:
        assert all(cell_len(line) <= width for line in printed.splitlines()), printed
        folded = [[cell.strip() for cell in line.split("│")[1:-1]] for line in printed.splitlines() if "│" in line]
        assert "".join(row[-1] for row in folded if not row[-1].isspace()).count("x") == 70
    else:
        assert width <= 80 and "functionals: 346" in printed


def test_a_table_without_rows_is_not_printed():
    console = CommandConsole(width=80)
    with console.capture() as capture:
        console.table("Parts", HEADS, [])
        console.table("Parts", HEADS, [()])
    assert capture.get() == ""


@pytest.mark.parametrize(
    "text, words",
    [
        ("[[parts]]\nthickness = 1,2\n", ["line 2", "per line; decimals have a point", "thickness = 1,2"]),
        ("thickness 1.2\n", ["line 1", "expected key = value", "thickness 1.2"]),
        ("name = lower\n", ["line 1", '"text" in quotes', "name = lower"]),
        ('name = "lower\nmesh = 1\n', ["line 1", "closing quote"]),
        ('mesh = "C:\\parts\\lower.inp"\n', ["single quotes"]),
        ("point = [1, 2\nmesh = 1\n", ["closing ]"]),
        ("name = 1\nname = 2\n", ["line 2", "each key once"]),
        ("[parts]\n[parts]\n", ["line 2", "[[table]]"]),
        ("[[parts]\n", ["]] after [["]),
    ],
)
def test_a_syntax_error_says_what_is_expected(text, words, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(SceneError) as caught:
        read_toml(path, "scene")
    message = str(caught.value)
    assert "\n" not in message and message.startswith(f"{path}: not valid TOML")
    for word in words:
        assert word in message, message


def test_bytes_that_are_no_utf8_say_so(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_bytes('name = "Tür"'.encode("latin-1"))
    with pytest.raises(SceneError, match="save the file as UTF-8"):
        read_toml(path, "scene")
