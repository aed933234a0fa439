"""Samples that a scene gives in a file: used unchanged, refused if invalid, warned of if implausible."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import mic
from mic.model.assembly import assemble
from mic.plausibility import find_warnings
from mic.report.page import write_report
from mic.results.run_identity import identity
from mic.runs import run
from mic.scene.deviation import ShapeDeviation
from mic.scene.samples import take_samples
from mic.statistics import estimates
from mic.statistics.draw import draw
from mic.system.foreign_files import ALSO_READ

LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint"


@pytest.fixture
def table(lap_scene):
    """Twelve assemblies, of the spread that the scene states."""
    rng = np.random.default_rng(7)
    return pd.DataFrame({item.name: rng.normal(item.mean, item.sigma, 12) for item in lap_scene.deviations})


@pytest.fixture(autouse=True)
def tables_beside_the_scene(tmp_path, monkeypatch):
    monkeypatch.setenv(ALSO_READ, str(tmp_path))


def of(scene, folder, text="samples.csv", **keys):
    asked = mic.scene.schema.MonteCarlo(table=str(folder / text), **keys)
    report = scene.report.model_copy(update={"laws": ["coulomb"], "fields": False})
    return scene.model_copy(update={"monte_carlo": asked, "report": report})


@pytest.mark.parametrize("kind", ["comma", "semicolon", "parquet", "reordered"])
def test_the_samples_are_the_rows_of_the_file(kind, lap_scene, table, tmp_path):
    expected, name = table.to_numpy(), "samples.parquet" if kind == "parquet" else "samples.csv"
    if kind == "parquet":
        table.to_parquet(tmp_path / name)
    elif kind == "reordered":
        table[table.columns[::-1]].to_csv(tmp_path / name, index=False)
    else:
        decimal, separator = (",", ";") if kind == "semicolon" else (".", ",")
        table.to_csv(tmp_path / name, index=False, sep=separator, decimal=decimal)
    scene, inputs = take_samples(of(lap_scene, tmp_path, name))
    assert scene.monte_carlo.samples == 12 and list(inputs) == [str(tmp_path / name)]
    np.testing.assert_array_equal(draw(scene, 1, 0, 12), expected)
    np.testing.assert_array_equal(draw(scene, 9, 5, 3), expected[5:8])
    fewer, _ = take_samples(of(lap_scene, tmp_path, name, samples=5))
    assert fewer.monte_carlo.samples == 5


SCORES = {"u1": (0.5, -1.0), "u2": (-1.25, 0.25), "u3": (0.75, 0.75)}


@pytest.fixture
def measured(lap_scene):
    """Beside its own deviations a mean shape and two modes of three measured pieces."""
    common = {"kind": "shape", "part": "upper", "points": [[110, 5, 1], [120, 20, 1]], "batch": "up"}
    modes = [
        ShapeDeviation(
            name=f"up.{k + 1}", sigma=2.0, scores=[own[k] for own in SCORES.values()], pieces=[*SCORES], **common
        )
        for k in range(2)
    ]
    mean = ShapeDeviation(name="up.mean", mean=1.0, sigma=0.0, **common)
    return lap_scene.model_copy(update={"deviations": [*lap_scene.deviations, mean, *modes]})


@pytest.mark.parametrize("kind", ["decimal commas", "parquet", "numbers"])
def test_a_queue_names_the_measured_pieces(kind, measured, table, tmp_path):
    name = "samples.parquet" if kind == "parquet" else "samples.csv"
    given = table.assign(up=([2, 3, 1] if kind == "numbers" else ["u2", " u3", "u1"]) * 4)
    if kind == "numbers":
        changes = [{"pieces": None} if one.kind == "shape" else {} for one in measured.deviations]
        unnamed = [one.model_copy(update=change) for one, change in zip(measured.deviations, changes)]
        measured = measured.model_copy(update={"deviations": unnamed})
    if kind == "parquet":
        given.to_parquet(tmp_path / name)
    else:
        given.to_csv(tmp_path / name, index=False, sep=";", decimal=",")
    scene, _ = take_samples(of(measured, tmp_path, name))
    found = draw(scene, 1, 0, 12)
    np.testing.assert_array_equal(found[:, : len(table.columns)], table.to_numpy())
    expected = [[1.0, 2 * a, 2 * b] for a, b in (SCORES["u2"], SCORES["u3"], SCORES["u1"])]
    np.testing.assert_array_equal(found[:, len(table.columns) :], expected * 4)


@pytest.mark.parametrize(
    "change, said",
    [
        ({"up": "u9"}, "row 2, column up: there is no measured piece 'u9'; known: u1, u2, u3"),
        ({"up": ""}, "row 2, column up.mean: '' is not a finite number"),
        ({"up": "u1", "up.1": 0.0}, "row 1: there are columns 'up' and 'up.1'; give the piece, or its scores"),
        ({"upp": "u1"}, "there is no deviation called 'upp'"),
        ({}, "row 1: there are no columns 'up.mean', 'up.1', 'up.2'; add them, with a value in each row"),
    ],
)
def test_a_table_with_unknown_pieces_is_refused(change, said, measured, table, tmp_path):
    table.assign(**change).to_csv(tmp_path / "samples.csv", index=False)
    with pytest.raises(mic.SceneError, match=said):
        take_samples(of(measured, tmp_path))


@pytest.mark.parametrize("pieces", [["u1", "u2"], ["u1", "u1", "u2"]])
def test_pieces_have_a_name_each(pieces, measured):
    keys = measured.deviations[-1].model_dump() | {"pieces": pieces}
    with pytest.raises(ValueError, match="there are 3 scores and . names: give one per score"):
        ShapeDeviation(**keys)


@pytest.mark.slow
def test_a_run_of_a_table_gives_the_results_of_each_assembly(lap_scene, lap_model, table, cache, tmp_path, no_pictures):
    table.to_csv(tmp_path / "samples.csv", index=False)
    outcome = run(of(lap_scene, tmp_path), tmp_path / "out", cache)
    law, own = outcome.laws[0], lap_scene.measurements[0].name
    alone = lap_model.evaluate(table.to_numpy(), law).measurements[:, 0]
    np.testing.assert_allclose(outcome.measured(law, own), alone, atol=1e-9)
    assert outcome.record["samples"] == 12
    with_others = identity(outcome.model, 1)
    table.iloc[3, 0] += 0.1
    table.to_csv(tmp_path / "samples.csv", index=False)
    with pytest.raises(mic.RunError, match="design of the samples, or the samples themselves"):
        run(of(lap_scene, tmp_path), tmp_path / "out", cache)
    assert with_others == identity(outcome.model, 1)


def changed(row, cell):
    """The lines of the table with another first cell in a row."""

    return lambda lines: [*lines[:row], f"{cell},{lines[row].partition(',')[2]}", *lines[row + 1 :]]


BAD = {
    "no such file": (None, "samples.csv: this table does not exist"),
    "no row": (lambda lines: lines[:1], "there is no row below the header"),
    "a missing column": (lambda lines: [line.rpartition(",")[0] for line in lines], "there is no column '"),
    "a misspelt column": (
        lambda lines: [lines[0].replace("F1", "F11"), *lines[1:]],
        "row 1: there is no deviation called 'F11'; did you mean 'F1'",
    ),
    "a column twice": (
        lambda lines: [f"{line},{line.partition(',')[0]}" for line in lines],
        "column .* is given twice",
    ),
    "a text": (changed(3, "much"), "row 4, column .*: 'much"),
    "not a number": (changed(3, "nan"), "row 4, column .*: 'nan' is not a finite number"),
    "an empty cell": (changed(12, ""), "row 13, .* is not a finite"),
    "too many cells": (lambda lines: [*lines, lines[1] + ",5"], "not a table"),
    "another unit": (
        lambda lines: [
            lines[0],
            *(f"{1e3 * float(a)},{rest}" for a, _, rest in (line.partition(",") for line in lines[1:])),
        ],
        r"its values are .* give deviations\[0\] .* in the same unit",
    ),
    "no text": (b"\xff\xfe\x00\x01\x00", "cannot be read as text"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_malformed_table_is_refused_with_the_remedy(case, lap_scene, table, tmp_path):
    change, said = BAD[case]
    if isinstance(change, bytes):
        (tmp_path / "samples.csv").write_bytes(change)
    elif change is not None:
        (tmp_path / "samples.csv").write_text("\n".join(change(table.to_csv(index=False).splitlines())))
    with pytest.raises(mic.SceneError, match=said) as problem:
        take_samples(of(lap_scene, tmp_path))
    assert str(problem.value).startswith("monte_carlo.table: ")


def test_more_samples_than_rows_and_broken_parquet_are_refused(lap_scene, table, tmp_path):
    table.to_csv(tmp_path / "samples.csv", index=False)
    with pytest.raises(mic.SceneError, match="13 are requested, and .* has 12 rows"):
        take_samples(of(lap_scene, tmp_path, samples=13))
    (tmp_path / "samples.parquet").write_text("none")
    with pytest.raises(mic.SceneError, match="this table of samples cannot be read"):
        take_samples(of(lap_scene, tmp_path, "samples.parquet"))
    with pytest.raises(ValueError, match="design and table exclude each other"):
        of(lap_scene, tmp_path, design="sobol")


@pytest.mark.parametrize(
    "design, samples, instead", [("sobol", 500, 512), ("latin-hypercube", 20, 50), ("antithetic", 7, 8)]
)
def test_a_design_takes_whole_groups_of_samples(lap_scene, design, samples, instead):
    asked = mic.scene.schema.MonteCarlo(design=design, samples=samples)
    with pytest.raises(mic.SceneError, match=f"{samples} is not a multiple of .* give {instead}"):
        take_samples(lap_scene.model_copy(update={"monte_carlo": asked}))


def test_rows_that_stand_there_twice_and_columns_that_hardly_vary_are_warned_of(lap_scene, table, cache, tmp_path):
    twice, narrow, mean = table.copy(), table.copy(), lap_scene.deviations[1].mean
    twice.iloc[7] = twice.iloc[2]
    narrow.iloc[:, 1] = mean + 1e-3 * (narrow.iloc[:, 1] - mean)
    assembly, said = assemble(lap_scene, cache), []
    for given in (table, twice, narrow):
        given.to_csv(tmp_path / "samples.csv", index=False)
        carlo = take_samples(of(lap_scene, tmp_path))[0].monte_carlo
        scene = assembly.scene.model_copy(update={"monte_carlo": carlo})
        said.append(" ".join(map(str, find_warnings(scene, replace(assembly, scene=scene)))))
    assert said[0] == "" and "sample 7 repeats sample 2" in said[1] and "has a standard deviation of" in said[2]


BAD_KEYS = {
    "no such distribution": ({"distribution": "nromal"}, "no continuous distribution 'nromal'; did you mean 'normal'"),
    "a discrete one": ({"distribution": "poisson"}, "no continuous distribution 'poisson'"),
    "without parameters": ({"distribution": "beta", "parameters": {"a": 1}}, "has the parameters a, b, given are a"),
    "one too many": ({"distribution": "norm", "parameters": {"a": 1}}, "'norm' has no parameters, given are a"),
    "scale": ({"distribution": "lognorm", "parameters": {"s": 1, "scale": 2}}, "loc and scale follow from mean"),
    "impossible": ({"distribution": "lognorm", "parameters": {"s": -1}}, "there is no 'lognorm' with s = -1"),
    "of infinite variance": ({"distribution": "t", "parameters": {"df": 1.5}}, "'t' has no standard deviation"),
    "a parameter that is text": ({"distribution": "t", "parameters": {"df": "5"}}, "parameters.df"),
    "limits turned round": ({"truncated": [1, -1]}, "the smallest value 1 must lie below the largest -1"),
    "limits far away": ({"mean": 0, "sigma": 1, "truncated": [50, 60]}, "less than 1e-06 of the distribution"),
    "limits of nothing": ({"sigma": 0, "truncated": [-1, 1]}, "sigma is 0, so it has no effect"),
    "one limit": ({"truncated": [1]}, "truncated"),
}


@pytest.mark.parametrize("case", BAD_KEYS)
def test_distributions_that_do_not_exist_are_refused_by_name(case, tmp_path):
    keys, said = BAD_KEYS[case]
    refused(lambda scene: scene["deviations"][0].update(keys), said)


def refused(change, said):
    scene = mic.load_scene(LAP).model_dump(mode="json", exclude={"folder"})
    change(scene)
    with pytest.raises(mic.SceneError, match=said) as problem:
        mic.scene.load.read_table(scene, LAP / "scene.toml")
    assert len(str(problem.value).splitlines()) == 1


A, B, C = (item.name for item in mic.load_scene(LAP).deviations[:3])
BAD_CORRELATIONS = {
    "not positive": (
        [{"deviations": [A, B, C], "matrix": [[1, 0.9, 0.9], [0.9, 1, -0.9], [0.9, -0.9, 1]]}],
        r"correlations\[0\]: matrix: .* smallest eigenvalue is -0.8 and must not be negative",
    ),
    "not symmetric": ([{"deviations": [A, B], "matrix": [[1, 0.5], [0.4, 1]]}], "0.5 above the diagonal and 0.4 below"),
    "a covariance": ([{"deviations": [A, B], "matrix": [[4, 1], [1, 4]]}], "1 all along its diagonal"),
    "more than one": ([{"deviations": [A, B], "matrix": [[1, 1.5], [1.5, 1]]}], "between -1 and 1; got 1.5"),
    "too small": ([{"deviations": [A, B, C], "matrix": [[1, 0.5], [0.5, 1]]}], "3 deviations need 3 rows of 3 numbers"),
    "ragged": ([{"deviations": [A, B], "matrix": [[1, 0.5], [0.5]]}], "2 deviations need 2 rows of 2 numbers"),
    "of nobody": ([{"deviations": [A, "X"], "matrix": [[1, 0.5], [0.5, 1]]}], "no deviation called 'X'"),
    "with itself": ([{"deviations": [A, A], "matrix": [[1, 0.5], [0.5, 1]]}], "is given twice"),
    "alone": ([{"deviations": [A], "matrix": [[1]]}], "at least 2 items"),
    "in two tables": (
        [{"deviations": [A, B], "matrix": [[1, 0.5], [0.5, 1]]}, {"deviations": [B, C], "matrix": [[1, 0], [0, 1]]}],
        r"correlations\[1\].deviations: .* is given twice",
    ),
    "not a number": ([{"deviations": [A, B], "matrix": [[1, float("nan")], [0.5, 1]]}], "finite number"),
}


@pytest.mark.parametrize("case", BAD_CORRELATIONS)
def test_correlations_that_cannot_be_are_refused_with_the_remedy(case):
    tables, said = BAD_CORRELATIONS[case]
    refused(lambda scene: scene.update(correlations=tables), said)


def test_a_singular_correlation_is_one():
    table = mic.load_scene(LAP).model_dump()
    table["correlations"] = [{"deviations": [A, B], "matrix": [[1, 1], [1, 1]]}]
    values = draw(mic.Scene(**table), 3, 0, 20)
    mean, sigma = np.array([[item["mean"], item["sigma"]] for item in table["deviations"]]).T
    standard = (values - mean) / sigma
    np.testing.assert_allclose(standard[:, 0], standard[:, 1], atol=1e-12)


@pytest.mark.slow
def test_a_run_of_a_design_gives_intervals_from_its_groups(lap_scene, cache, tmp_path, no_pictures):
    """Intervals of key characteristics come from the groups; others, which need independent samples, are omitted."""
    asked = lap_scene.monte_carlo.model_copy(update={"design": "antithetic", "samples": 24})
    laws = lap_scene.report.model_copy(update={"laws": ["coulomb"], "fields": False})
    outcome = run(lap_scene.model_copy(update={"monte_carlo": asked, "report": laws}), tmp_path / "out", cache)
    own = outcome.measurement_statistics.iloc[0]
    x = outcome.measured("coulomb", own["measurement"])
    expected = estimates.grouped_jackknife(x, np.arange(24) // 2, np.mean, added=0)
    assert own["mean_low"] == pytest.approx(expected.low) and own["mean_high"] == pytest.approx(expected.high)
    assert own["mean_high"] - own["mean_low"] < 0.5 * np.subtract(*_ends(estimates.mean(x)))
    assert own["sigma_low"] < own["sigma"] < own["sigma_high"] and own["cp_low"] < own["cp"] < own["cp_high"]
    for table in (outcome.zone_statistics, outcome.contact_statistics):
        bounds = [name for name in table.columns if name.endswith(("_low", "_high"))]
        assert bounds and table[bounds].isna().all(axis=None)
        assert table[[name.removesuffix("_low") for name in bounds if name.endswith("_low")]].notna().any(axis=None)
    page = write_report(tmp_path / "out").read_text(encoding="utf-8")
    assert "Groups of 2 samples are drawn together" in page and "grouped jackknife" in page
    assert "Clopper–Pearson" not in page and "(Wilks)" not in page


def _ends(estimate):
    return estimate.high, estimate.low
