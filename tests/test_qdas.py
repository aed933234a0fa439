"""Q-DAS files, written by hand from the published format: the same values in every layout."""

import numpy as np
import pytest

from mic.errors import SceneError
from mic.scene.measured_report import read_measured_report
from mic.scene.qdas import read_qdas

SI, DC4 = "\x0f", "\x14"
DESCRIPTION = """\
K0100 3
K1001/1 4711
K1002/1 Bracket
K2001/1 1
K2002/1 Hole X
K2101/1 12.000
K2110/1 11.980
K2111/1 12.020
K2142/1 mm
K2001/2 2
K2002/2 Flatness
K2111/2 50
K2142/2 µm
K2001/3 3
K2002/3 Length
K2101/3 50,0
K2112/3 -0,1
K2113/3 0,3
K2142/3 mm
K2022/0 3
"""
#: The fields of a characteristic after those of all others, in another order, without the index of the part.
BY_FIELD = """\
K0100 3
K2142/3 mm
K2142/2 µm
K2142/1 mm
K2113/3 0.3
K2112/3 -0.1
K2111/2 50
K2111/1 12.02
K2110/1 11.98
K2101/3 50
K2101/1 12
K2002/3 Length
K2002/2 Flatness
K2002/1 Hole X
K2001/3 3
K2001/2 2
K2001/1 1
K1001 4711
"""
VALUES = np.array([[12.004, 31.0, 50.05], [11.997, np.nan, 49.95]])
LAYOUTS = {
    "lines": f"""\
12.004{DC4}0{DC4}27.11.2026/10:15:00{DC4}{DC4}#7{SI}31{DC4}0{DC4}27.11.2026/10:15:00{SI}50.05{DC4}0
K0014/0 A17
11.997{DC4}0{SI}99{DC4}255{SI}49.95{DC4}0
K0014/0 A18
""",
    "values alone": f"""\
12,004{SI}31{SI}50,05
K0014/1 A17
11,997{SI}{SI}49,95{SI}
K0014/1 A18
""",
    "fields by piece": """\
K0001/1 12.004
K0002/1 0
K0004/1 27.11.2026/10:15:00
K0014/1 A17
K0001/2 31
K0014/2 A17
K0001/3 50.05
K0014/3 A17
K0001/1 11.997
K0014/1 A18
K0001/3 49.95
K0014/3 A18
""",
    "fields by characteristic": """\
K0001/1 12.004
K0014/1 A17
K0001/1 11.997
K0014/1 A18
K0001/2 31
K0014/2 A17
K0001/2 99
K0002/2 256
K0014/2 A18
K0001/3 50.05
K0014/3 A17
K0001/3 49.95
K0014/3 A18
""",
    "fields first": """\
K0014/0 A17
K0001/1 12.004
K0001/2 31
K0001/3 50.05
K0014/0 A18
K0002/2 255
K0001/1 11.997
K0001/2 99
K0001/3 49.95
""",
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("description", [DESCRIPTION, BY_FIELD])
@pytest.mark.parametrize("coding, ends", [("utf-8-sig", "\n"), ("latin-1", "\r\n"), ("utf-16", "\r")])
def test_every_layout_gives_the_same_values(tmp_path, layout, description, coding, ends):
    text = (description + LAYOUTS[layout]).replace("\n", ends)
    (tmp_path / "a.dfq").write_bytes(text.encode(coding))
    features, pieces, values = read_qdas(tmp_path / "a.dfq")
    assert pieces == ["A17", "A18"]
    np.testing.assert_array_equal(values, VALUES)
    assert [feature.names[0] for feature in features] == ["Hole X", "Flatness", "Length"]
    assert features[0].names == ("Hole X", "1") and features[0].unit == "mm" and features[1].unit == "µm"
    limits = [(one.nominal, one.lower, one.upper) for one in features]
    np.testing.assert_allclose(limits, [(12, 11.98, 12.02), (np.nan, np.nan, 50), (50, 49.9, 50.3)])


@pytest.mark.parametrize("given", ["a.dfd", "a.dfx"])
def test_description_and_values_may_be_two_files(tmp_path, given):
    (tmp_path / "a.dfd").write_text(DESCRIPTION)
    with pytest.raises(SceneError, match=r"a\.dfx is missing; put description"):
        read_qdas(tmp_path / "a.dfd")
    (tmp_path / "a.dfx").write_text(LAYOUTS["lines"])
    np.testing.assert_array_equal(read_qdas(tmp_path / given)[2], VALUES)


def test_pieces_without_identifiers_are_numbered_and_counted_characteristics_left_out(tmp_path):
    text = DESCRIPTION + f"K2004/2 1\n12.004{SI}100{DC4}3{SI}50.05\n11.997{SI}100{DC4}0{SI}49.95\n"
    (tmp_path / "a.dfq").write_text(text)
    features, pieces, values = read_qdas(tmp_path / "a.dfq")
    assert pieces == ["1", "2"] and [one.names[0] for one in features] == ["Hole X", "Length"]
    np.testing.assert_array_equal(values, VALUES[:, [0, 2]])


def test_a_piece_that_is_measured_again_is_another(tmp_path):
    text = "K2001/1 1\nK2101/1 0\n" + "".join(f"K0001/1 {value}\nK0014/1 A\n" for value in (0.1, 0.2))
    (tmp_path / "a.dfq").write_text(text)
    assert read_qdas(tmp_path / "a.dfq")[1] == ["A", "A (2)"]


def test_deviations_are_from_nominal_in_mm_and_features_are_found_by_any_name(tmp_path):
    (tmp_path / "a.dfq").write_text(DESCRIPTION + LAYOUTS["lines"])
    report = read_measured_report(tmp_path / "a.dfq", ["hole-x", "FLATNESS", "3"], "key characteristic")
    assert report.values == {
        "A17": {"hole-x": pytest.approx(0.004), "FLATNESS": pytest.approx(0.031), "3": pytest.approx(0.05)},
        "A18": {"hole-x": pytest.approx(-0.003), "3": pytest.approx(-0.05)},
    }


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "it has no characteristic"),
        ("hello\n", "'hello' is no measured value"),
        (DESCRIPTION, "it has no measured value; export"),
        (DESCRIPTION + "1_2\n", "a.dfq, line 21: '1_2' is no measured value"),
        (DESCRIPTION + f"1{SI}2{SI}3{SI}4\n", "is no measured value"),
        (DESCRIPTION + "K0001/1 1\nK0001/1 2\nK0001/2 1\n", "have 1 to 2 values, and not each has an identifier"),
        (
            "K2001/1 1\nK2002/1 Hole\nK2110/1 5\nK2111/1 7\nK0001/1 6\n",
            "'Hole' has no nominal value; export field K2101",
        ),
        ("K2001/1 1\nK2002/1 Hole\nK2101/1 x\nK0001/1 6\n", "could not convert string to float: 'x'"),
    ],
)
def test_a_wrong_file_is_refused_in_one_sentence(tmp_path, text, said):
    (tmp_path / "a.dfq").write_text(text)
    with pytest.raises(SceneError) as refused:
        read_measured_report(tmp_path / "a.dfq", ["Hole", "Length"], "key characteristic")
    message = str(refused.value)
    assert said in message and message.startswith(str(tmp_path / "a.dfq")) and len(message.splitlines()) == 1
