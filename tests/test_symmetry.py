"""Scenes that are scaled, rotated, mirrored, renumbered, permuted: what is transformed, and how they are compared."""

import types
from dataclasses import replace
from typing import get_args

import numpy as np
import pandas as pd
import pytest
from pydantic import BaseModel
from scipy.sparse import csr_matrix
from support.random_scenes import random_case

from fem_reference.full.model import ContactFailure, FullModel
from mic.compliance.superelement import Superelement
from mic.errors import Problems
from mic.geometry.load import LoadedPart
from mic.model.assembly import assemble_placed, load_placed
from mic.scene import Scene
from verification.comparison import reduced_and_assembly
from verification.study import Team
from verification.symmetry import design, study, transformation, uncertainty
from verification.symmetry.numbers import disagreement
from verification.symmetry.solution import matched, solve
from verification.symmetry.transformation import DIRECTIONS, NO_UNIT, POINTS, POWERS, Transformation, transformations


def tables_of(annotation, known):
    """All tables of a scene among the members of a type, with those of their keys."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel) and annotation not in known:
        known.add(annotation)
        for field in annotation.model_fields.values():
            tables_of(field.annotation, known)
    for inner in get_args(annotation):
        tables_of(inner, known)
    return known


def has_numbers(annotation):
    return annotation is float or any(has_numbers(inner) for inner in get_args(annotation))


def test_every_number_of_a_placed_scene_is_transformed_or_has_no_unit():
    """A new key of a scene that holds numbers must be listed. Measured shapes, fields and optimisations are gone."""
    gone = {"Optimisation", "Scan", "MeasuredDeviation", "FieldDeviation"}
    keys = {
        key
        for table in tables_of(Scene, set())
        if table.__name__ not in gone and not table.__module__.endswith("optimisation")
        for key, field in table.model_fields.items()
        if has_numbers(field.annotation)
    }
    listed = POINTS | DIRECTIONS | POWERS.keys() | NO_UNIT | {"friction_table"}
    assert len(keys) > 30 and keys <= listed, keys - listed


def one_point(**change):
    """A quick point of the design."""
    mild = {name: read(0.5) for name, read in design.AXES.items()}
    return mild | {"pairs": 4, "law": "associated", "path": "one-step", "sliver": 1.0, "gap": 0.1} | change


@pytest.mark.fem
@pytest.mark.slow
def test_a_transformed_scene_has_the_same_numbers_and_a_forgotten_unit_shows(monkeypatch):
    """A frictional scene with a weld, a shape, temperature, gravity; with a sliver, too."""
    placed, samples = design.scene(one_point(sliver=1e-4))
    given = solve(placed, samples)
    table = given.numbers["associated"]
    assert {"key characteristic", "normal force", "friction force", "slip"} <= set(
        table.index.get_level_values("quantity")
    )
    for change in (
        Transformation("in inches", length=1 / 25.4, force=3.0, renumbered=True),
        next(each for each in transformations(placed) if each.name == "mirrored"),
        Transformation("another order", permuted=True),
    ):
        found = solve(placed, samples, change, given.pairs).numbers["associated"]
        assert disagreement(table, found)["relative"].max() < 1e-6, change.name
    monkeypatch.setitem(transformation.POWERS, "density", (-2, 1))
    found = solve(placed, samples, Transformation("wrong", length=2.0), given.pairs).numbers["associated"]
    assert disagreement(table, found)["relative"].max() > 1e-6


@pytest.mark.slow
def test_the_order_of_locators_and_clamps_does_not_move_candidates(tmp_path):
    """Distances from the locators break ties, and candidates stand under clamps."""
    placed, _ = design.scene(one_point(pairs=0))
    other = Transformation("another order", permuted=True).apply(placed)
    given, found = (assemble_placed(each, tmp_path).contacts for each in (placed, other))
    np.testing.assert_array_equal(found.point, given.point)


def test_a_superelement_is_transformed_with_its_part():
    """Readings of its matrix change by their unit: lengths by λ, angles by 1, under forces φ and moments λφ."""
    rng = np.random.default_rng(3)
    points, root = rng.normal(size=(2, 3)), rng.normal(size=(12, 12))
    K, freedom = root @ root.T, np.arange(12).reshape(2, 6)
    placed, _ = design.scene(one_point())
    axes = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]) @ np.diag([1.0, -1.0, 1.0])
    change = Transformation("all", axes, np.ones(3), length=5.0, force=7.0)
    vertices = np.full(len(placed.loaded[0].surface.points), -1)
    turn = np.kron(
        np.eye(2), np.block([[5.0 * axes, np.zeros((3, 3))], [np.zeros((3, 3)), np.linalg.det(axes) * axes]])
    )
    v = rng.normal(size=12)
    for stiffness in (True, False):
        body = Superelement(points, np.arange(2), freedom, csr_matrix(K), stiffness, vertices)
        part = replace(placed.loaded[0], superelement=body)
        found = change.apply(replace(placed, loaded=(part, placed.loaded[1]))).loaded[0].superelement
        np.testing.assert_allclose(found.points, change.points(points))
        matrix, moved = found.matrix.toarray()[found.freedom.ravel()][:, found.freedom.ravel()], turn @ v
        if not stiffness:  # forces that do the same work with the motions times λφ
            moved = np.linalg.inv(turn).T @ v * 35.0
        assert moved @ matrix @ moved == pytest.approx(35.0 * (v @ K @ v), rel=1e-12)


def test_superelements_are_transformed_though_the_scene_reads_them_from_files(monkeypatch, tmp_path):
    placed, samples = design.scene(one_point())
    body, seen = object(), []
    parts = [types.SimpleNamespace(name=one.part.name, superelement=body) for one in placed.loaded]
    model = types.SimpleNamespace(
        slopes=object(),
        compliance=types.SimpleNamespace(H=[]),
        contacts=types.SimpleNamespace(gap=0.0, point=np.zeros(3), zone=0.0),
    )
    assembly = types.SimpleNamespace(parts=parts, sizes={})

    def solve(placed, *given, **more):
        seen.append([one.superelement for one in placed.loaded])
        raise ArithmeticError("not needed")

    monkeypatch.setattr(uncertainty, "load_placed", lambda *given: placed)
    monkeypatch.setattr(uncertainty, "solve", solve)
    monkeypatch.setattr(uncertainty, "pairs_of", lambda model: None)
    case = uncertainty.Solved(placed.scene, placed.scene, assembly, model, samples, "coulomb", tmp_path)
    monkeypatch.setattr(uncertainty, "REFUSALS", Exception)
    _, refused = uncertainty.numerical_uncertainty(case, tmp_path, Team(), print)
    assert len(seen) == 8 and all(one is body for given in seen for one in given)
    assert "rotated by right angles: not needed" in refused
    assert any(one.startswith("by whole finite elements: they have the nominal stiffness") for one in refused)


def test_pairs_at_one_point_are_told_apart_by_their_zones():
    """Two zones of a stack of three sheets have pairs at the same points."""
    pairs = np.array([[1.0, 2, 3, 0], [4, 5, 6, 0], [1, 2, 3, 1], [4, 5, 6, 1]])
    order = np.array([2, 1, 3, 0])
    np.testing.assert_array_equal(pairs[order][matched(pairs, pairs[order])], pairs)


def numbers_of(**rows):
    keys = {name: (name.replace("_", " "), "clamp", "lap", unit) for name, (unit, _) in rows.items()}
    index = pd.MultiIndex.from_tuples([keys[name] for name in rows], names=["quantity", "stage", "name", "unit"])
    return pd.DataFrame([values for _, values in rows.values()], index=index)


def test_disagreements_are_relative_to_the_largest_of_their_kind():
    given = numbers_of(
        key_characteristic=("mm", [1.0, -2.0]),
        gap_of_a_pair=("mm", [100.0, 0.0]),
        normal_force=("N", [5.0, 10.0]),
        friction_force=("N", [0.0, 0.1]),
        friction_work=("N mm", [0.0, 1.0]),
        slip=("mm", [np.nan, 0.0]),
    )
    other = given + 0.01
    table = disagreement(given, other).droplevel(["stage", "name", "unit"])
    assert table["difference"].to_numpy() == pytest.approx(0.01)
    assert table["relative"].to_dict() == pytest.approx(
        {"key characteristic": 5e-3, "gap of a pair": 1e-4, "normal force": 1e-3, "friction force": 1e-3}
        | {"friction work": 1e-5, "slip": 1e-4}
    )
    still = given.mul(given.index.get_level_values("quantity") != "key characteristic", axis=0)
    assert disagreement(still, still + 0.01)["relative"].max() == pytest.approx(1e-3)
    silent = disagreement(0 * given, other)["relative"]
    assert np.isinf(silent).all()


@pytest.mark.fem
@pytest.mark.slow
def test_samples_of_a_scene_of_files_are_solved_again_in_every_way_once(tmp_path, monkeypatch):
    """Deck files, a box and candidates; a way that fails is named, and the others stay."""
    case = random_case(2)
    scene = case.scene(tmp_path / "scene")
    scene = scene.model_copy(update={"report": scene.report.model_copy(update={"laws": ["coulomb"]})})
    one_step = [
        stage.model_copy(update={"path": "one-step"}) if stage.kind in ("clamp", "weld", "release") else stage
        for stage in scene.stages
    ]
    scene = scene.model_copy(update={"stages": one_step})
    model, assembly = reduced_and_assembly(scene, tmp_path / "cache")
    solved = uncertainty.Solved(scene, scene, assembly, model, case.deviations[:2], "coulomb", tmp_path / "cache")
    lines = []
    table, refused = uncertainty.numerical_uncertainty(solved, tmp_path / "again", Team(), lines.append)
    names = [change.name for change in transformations(load_placed(scene, tmp_path / "cache", {}, Problems()))]
    assert "rotated by right angles" in names and not refused
    assert len(lines) == 3 + len(names) and set(names) <= set(table.columns)
    shown = uncertainty.lines(table)
    assert {"key characteristic M0", "normal force Z", "friction force Z", "friction force of a pair Z"} <= set(
        shown["number"]
    )
    assert (shown["by"] != "")[shown["value"] > 0].any() and shown["relative"].max() < 1
    assert table["by whole finite elements"].max() < 1e-5
    ways = table.drop(columns=uncertainty.FIGURES)
    assert (table["uncertainty"] == ways.max(axis=1).fillna(0.0)).all()
    apart = ways.drop(columns=["by whole finite elements", "on a tighter path"]).max(axis=1)
    assert (table["by symmetry"] == apart.fillna(0.0)).all()
    monkeypatch.setattr(uncertainty, "solve", None)  # read from its files
    again, _ = uncertainty.numerical_uncertainty(solved, tmp_path / "again", Team(), lines.append)
    pd.testing.assert_frame_equal(again, table)
    assert uncertainty.sentences(table, refused, 2)[0].startswith("Numerical uncertainty: largest disagreement of 2")

    def fails(self, *given):
        raise ContactFailure("planted failure")

    monkeypatch.setattr(FullModel, "evaluate", fails)
    for path in (tmp_path / "again").glob("by-whole*"):
        path.unlink()
    rest, refused = uncertainty.numerical_uncertainty(solved, tmp_path / "again", Team(), lines.append)
    assert refused == ["by whole finite elements: planted failure"]
    assert uncertainty.WHOLE not in rest.columns and len(rest) == len(table)


def test_the_study_counts_what_is_lost_refused_and_beyond_its_limits(monkeypatch):
    rows = [
        {"sliver": False, "transformation": "scaled", "reason": "", "disagreement": 1e-3},
        {"sliver": False, "transformation": "rotated", "reason": "", "disagreement": 1e-12},
        {"sliver": True, "transformation": "scaled", "reason": "SceneError: too far"},
        {"sliver": True, "transformation": "permuted", "reason": "", "disagreement": 2e-7},
        {"sliver": True, "transformation": "mirrored", "reason": "", "disagreement": 1e-7},
        {"sliver": True, "transformation": "", "reason": "SceneError: refused"},
        {
            "sliver": True,
            "transformation": "renumbered",
            "reason": "converges in one of both only",
            "disagreement": 0.0,
        },
        {"sliver": True, "transformation": "scaled", "reason": "", "disagreement": 1e-4, "followed": True},
        {"transformation": "scaled", "reason": study.SEVERAL, "disagreement": 1.0, "followed": True, "sliver": False},
    ]
    monkeypatch.setattr(study, "COUNT", (208, len(rows)))
    monkeypatch.setattr(study, "judged", lambda number, point: {"point": number, "followed": False} | rows[number])
    found = {one.name: one.measured for one in study.run(types.SimpleNamespace(quick=True, team=Team()))}
    assert found == pytest.approx(
        {"plain": 1e-3, "plain-share": 0.5, "slivers": 2e-7, "slivers-share": 1.0}
        | {"followed": 1e-4, "lost": 2, "refused": 1 / len(rows)}
    )
    assert {one.name for one in study.STUDY.acceptance} == set(found)


def test_the_design_reaches_its_extremes():
    points = design.points(study.COUNT[False])
    assert len(points) >= 200
    for name, low, high in (("thickness", 0.06, 18.0), ("E", 2.0, 5e5), ("gap", 2e-9, 60.0), ("pairs", 0, 300)):
        values = [point[name] for point in points]
        assert min(values) <= low and max(values) >= high, name
    assert max(point["friction"] for point in points) > 600
    assert min(point["sliver"] for point in points) < 3e-6
    for name in ("law", "path", "weld"):
        assert {point[name] for point in points} == set(design.AXES[name].values)
    placed, samples = design.scene(points[0])
    assert all(isinstance(one, LoadedPart) for one in placed.loaded)
    assert samples.shape == (1, len(placed.scene.deviations))
