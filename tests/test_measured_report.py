"""Reports of measuring machines: the same deviations from every arrangement of rows and columns."""

import pytest

from mic.errors import SceneError
from mic.scene.measured_report import read_measured_report

NAMES = ["M1", "M2", "flush-1"]
BOTH = {"S1": {"M1": 0.12, "flush-1": -0.2}, "S2": {"M1": -0.05, "flush-1": 0.3}}
ONE = {"1": {"M1": 0.12, "flush-1": -0.2}}
UPRIGHT = {"M1": (0.0, 0.6, 0.8)}


def read(tmp_path, text, names=NAMES, directions=None):
    (tmp_path / "report.csv").write_text(text)
    return read_measured_report(tmp_path / "report.csv", names, "key characteristic", directions)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("measurement,value\nM1,0.12\nflush-1,-0.2\n", ONE),
        ("Feature;Nominal;Actual\nm 1;100,5;100,62\nFlush_1;0;-0,2\n", ONE),
        ("Feature,Deviation [inch]\nM1,0.00472440944881889\nflush-1,-0.0078740157480315\n", ONE),
        (
            "Inspection report\n\nID\tNominal\tTol-\tActual\tDev\nM1\t10\t-1\t10.12\t0.12\nflush-1\t0\t\t-0.2\t\n",
            ONE,
        ),
        ("What,Unit,Deviation\nM1,mm,0.12\nflush-1,µm,-200\n", ONE),
        (
            "Serial,Feature,Nominal,Actual\nS1,M1,10,10.12\nS1,flush-1,0,-0.2\nS2,M1,10,9.95\nS2,flush-1,0,0.3\n",
            BOTH,
        ),
        ("Feature,Nominal,S1,S2\nM1,100.5,100.62,100.45\nflush-1,0,-0.2,0.3\n", BOTH),
        ("Feature,Nominal,S1,S2\nM1,100.5,0.12,-0.05\nflush-1,7,-0.2,0.3\n", BOTH),
        ("Feature,S1,S2\nM1,0.12,-0.05\nM2,,\nflush-1,-0.2,0.3\n", BOTH),
        ("serial no;M1;flush 1;operator\nS1;0,12;-0,2;Ann\nS2;-0,05;0,3;Bob\n", BOTH),
    ],
)
def test_every_arrangement_gives_the_same_deviations(tmp_path, text, expected):
    report = read(tmp_path, text)
    assert list(report.values) == list(expected)
    for piece, values in expected.items():
        assert report.values[piece] == pytest.approx(values, abs=1e-12)


def test_pieces_without_serial_numbers_have_their_rows(tmp_path):
    report = read(tmp_path, "M1,M2\n0.1,\n\n,0.2\n")
    assert report.values == {"row 2": {"M1": 0.1}, "row 4": {"M2": 0.2}} and report.rows == [2, 4]


def test_deviations_along_the_axes_are_combined_along_the_direction(tmp_path):
    rows = "Feature,Axis,Nominal,Actual\nM1,X,1,1.5\n,Y,2,2.1\n,Z,3,3.2\n"
    assert read(tmp_path, rows, directions=UPRIGHT).values["1"]["M1"] == pytest.approx(0.6 * 0.1 + 0.8 * 0.2)
    assert read(tmp_path, rows + "M1,T,0,0.7\n", directions=UPRIGHT).values["1"]["M1"] == pytest.approx(0.7)
    with pytest.raises(SceneError, match="'M1' of piece 1: axis y is missing; add a row"):
        read(tmp_path, "Feature,Axis,Dev\nM1,X,1\nM1,Z,1\n", directions=UPRIGHT)
    assert read(tmp_path, rows, ["M1.X"]).values == {"1": {"M1.X": 0.5}}


def test_how_it_was_read_is_said(tmp_path):
    (said,) = read(tmp_path, "Feature,Nominal,Actual,Inspector\nM1,1,1.1,Ann\nP7,1,1,Ann\n").said
    assert "nominal from 'Nominal', value from 'Actual'; ignored: 'Inspector'" in said
    assert said.endswith("Ignored, since the scene has no such key characteristic: P7.")
    assert "actual values of 2 pieces" in read(tmp_path, "Feature,Nominal,A,B\nM1,9,9.1,9\n").said[0]


def test_other_features_with_other_numbers_are_not_misspelt(tmp_path):
    names = ["point-101", "point-102"]
    assert list(read(tmp_path, "Feature,Dev\npoint-101,1\npoint-103,2\n", names).values["1"]) == ["point-101"]
    with pytest.raises(SceneError, match="'pointt-102'; did you mean 'point-102'"):
        read(tmp_path, "Feature,Dev\npoint-101,1\npointt-102,2\n", names)


def test_names_that_differ_in_punctuation_only_are_told_apart(tmp_path):
    assert read(tmp_path, "Feature,Dev\nA1,1\nA-1,2\n", ["A-1", "A1"]).values == {"1": {"A1": 1.0, "A-1": 2.0}}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not a table"),
        ("M1,M1\n1,1\n", "column 'M1' is given twice"),
        ("Q,R\n1,2\n", "there is no key characteristic 'Q' in this scene; known: M1, M2, flush-1"),
        ("measurement,value\nM9,1\n", "there is no key characteristic 'M9' in this scene"),
        ("measurement,value\nM1,1\nM1,2\n", "row 3: 'M1' is given twice; delete one row, or add a column serial"),
        ("measurement,gauge\nM1,1\n", "column 'value' is missing"),
        ("Feature,Nominal,Actual\nM1,,10.1\n", "row 2: the nominal value of 'M1' is missing"),
        ("Feature,Nominal,Actual\nM1,10,x\n", "row 2, column Actual: 'x' is not a finite number"),
        ("measurement,value\n,1\n", "row 2, column measurement: is empty; name the feature"),
        ("M1\ninf\n", "row 2, column M1: 'inf' is not a finite number"),
        ("measurement,value\n", "no row below the header"),
    ],
)
def test_a_wrong_report_is_refused_in_one_sentence(tmp_path, text, said):
    with pytest.raises(SceneError) as refused:
        read(tmp_path, text)
    assert said in str(refused.value) and str(refused.value).startswith(str(tmp_path / "report.csv"))


UNITS = {"F1": "N", "D1": "mm", "T": "K", "S": ""}


@pytest.mark.parametrize(
    "text",
    [
        "id,F1 [kN],D1 [in],T [K],S\na,-0.005,0.01,2,1\n",
        "id;F1 kN;D1 (µm);T;S\na;-0,005;254;2;1\n",
        "name,deviation,unit\nF1,-0.005,kN\nD1,0.254,mm\nT,2,K\nS,1,\n",
    ],
)
def test_units_of_deviations_are_converted(tmp_path, text):
    (tmp_path / "parts.csv").write_text(text)
    found = read_measured_report(tmp_path / "parts.csv", list(UNITS), "deviation", units=UNITS)
    (values,) = found.values.values()
    assert values == pytest.approx({"F1": -5.0, "D1": 0.254, "T": 2.0, "S": 1.0})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("id,F1 [mm],D1\na,-5,0.01\n", "mm is no unit of F1; give it in N"),
        ("id,F1 mm,D1\na,-5,0.01\n", "mm is no unit of F1"),
        ("id,F1,D1 [xyz]\na,-5,0.01\n", "xyz is no unit of D1; give it in mm"),
        ("name,deviation,unit\nF1,-5,mm\n", "F1 is given in mm; convert it to N"),
    ],
)
def test_a_unit_of_another_quantity_is_refused(tmp_path, text, said):
    (tmp_path / "parts.csv").write_text(text)
    with pytest.raises(SceneError, match=said):
        read_measured_report(tmp_path / "parts.csv", list(UNITS), "deviation", units=UNITS)
