"""Results are what their declaration says: names, types, units, formats."""

import hashlib
import io
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from mic.contact import ladder
from mic.contact.laws import COULOMB
from mic.errors import FormatError
from mic.results import schema
from mic.results.parquet import read_table, with_digest, write_table
from mic.results.sample_tables import tables
from mic.statistics.draw import draw


@pytest.fixture(scope="module")
def evaluation(lap_model):
    return lap_model.process("coulomb").evaluate(draw(lap_model.scene, 4, 0, 3))


@pytest.fixture(scope="module")
def found(lap_model, evaluation):
    return tables(lap_model, evaluation, first=5)


def test_an_evaluation_fills_the_tables_as_they_are_declared(found):
    assert set(found) == {table.name for table in schema.DATASETS}
    for table in schema.DATASETS:
        table.check(found[table.name], "memory", "mend it")
        none = schema.LIMITS, schema.PROFILES  # nothing in the scene has a limit, or is read at many points
        there = [] if table in none else [5, 6, 7]
        assert found[table.name]["sample"].unique().tolist() == there


def test_tangential_displacement_of_a_zone_is_the_rms_over_its_pairs(found):
    one = found["contacts"].query("sample == 7 and stage == 'clamp'")
    rms = np.sqrt((one["u_t1"] ** 2 + one["u_t2"] ** 2).mean())
    moved = found["slips"].query("sample == 7 and stage == 'clamp' and zone == 'lap'")["rms_tangential"].item()
    assert moved == pytest.approx(rms, rel=1e-12) and rms > 1e-5


def as_candidates(model):
    """The same pairs as candidates of different areas."""
    contacts, area = model.contacts, np.linspace(1.0, 5.0, len(model.contacts))
    return replace(model, contacts=replace(contacts, watched=np.ones(len(area), dtype=bool), area=area))


def test_candidates_count_by_their_area(lap_model, evaluation):
    slips = tables(as_candidates(lap_model), evaluation)["slips"].query("stage == 'clamp'")
    moved = (evaluation.resolutions["clamp"].displacement[:, :, 1:] ** 2).sum(axis=2)
    wanted = np.sqrt(np.average(moved, axis=1, weights=np.linspace(1.0, 5.0, len(lap_model.contacts))))
    np.testing.assert_allclose(slips["rms_tangential"], wanted, rtol=1e-12)


def test_slip_of_candidates_is_weighed_by_the_work_of_friction(lap_model, evaluation):
    """Independent of how many of them touch nothing; without work of friction there is no slip."""
    trace = evaluation.resolutions["clamp"].trace
    slips = tables(as_candidates(lap_model), evaluation)["slips"].query("stage == 'clamp'")
    for column, squares in (("rms_slip", (trace.slip**2).sum(axis=2)), ("slip_length", trace.length**2)):
        work = np.maximum(trace.work, 0.0)  # but for rounding
        wanted = np.sqrt((squares * work).sum(axis=1) / work.sum(axis=1))
        assert (wanted > 1.1 * np.sqrt(squares.mean(axis=1))).all()
        np.testing.assert_allclose(slips[column], wanted, rtol=1e-12)
    idle = replace(evaluation.resolutions["clamp"], trace=replace(trace, work=0 * trace.work, slip=0 * trace.slip))
    still = replace(evaluation, resolutions=dict(evaluation.resolutions) | {"clamp": idle})
    slips = tables(as_candidates(lap_model), still)["slips"].query("stage == 'clamp'")
    assert (slips["rms_slip"] == 0).all()


def test_rows_of_zones_and_stages_hold_the_resolution(found, evaluation):
    """Whatever slid, rubbed; open contacts show in the tangential displacement only."""
    for stage, resolution in evaluation.resolutions.items():
        trace = resolution.trace
        rows = found["slips"][found["slips"]["stage"] == stage]
        net, length = (trace.slip**2).sum(axis=2).mean(axis=1), (trace.length**2).mean(axis=1)
        np.testing.assert_allclose(rows["rms_slip"], np.sqrt(net), rtol=1e-12)
        np.testing.assert_allclose(rows["slip_length"], np.sqrt(length), rtol=1e-12)
        np.testing.assert_allclose(rows["friction_work"], trace.work.sum(axis=1), rtol=1e-12)
        np.testing.assert_allclose(rows[["open", "stick", "slip"]], trace.share.mean(axis=1))
        np.testing.assert_allclose(rows[["open", "stick", "slip"]].sum(axis=1), 1.0)
        assert (rows["slip_length"] >= rows["rms_slip"] * (1 - 1e-12)).all() and (rows["friction_work"] > 0).all()
        own = found["resolutions"][found["resolutions"]["stage"] == stage]
        np.testing.assert_array_equal(own["path_error"], trace.error)
        np.testing.assert_array_equal(own["steps"], trace.steps)
        np.testing.assert_array_equal(own["factorisations"], trace.factorisations)
        assert own["rung"].tolist() == resolution.rung.tolist() and (own["steps"] > 0).all()
        assert set(resolution.rung) <= {"followed", "increments", *ladder.rungs(COULOMB)}
    clamped = found["slips"].query("stage == 'clamp'")
    assert (clamped["rms_slip"] < clamped["rms_tangential"]).all()


def test_without_friction_nothing_slips_under_load(lap_model):
    found = tables(lap_model, lap_model.process("frictionless").evaluate(draw(lap_model.scene, 4, 0, 3)))
    assert (found["slips"]["rms_tangential"] > 0).all()
    assert found["slips"][["rms_slip", "slip_length", "friction_work", "open", "stick", "slip"]].isna().all(axis=None)
    assert found["contacts"][["path_stick", "path_slip"]].isna().all(axis=None)


def test_states_of_the_pairs_along_the_path_make_those_of_their_zone(found):
    zones = found["slips"].set_index(["stage", "sample"])
    for key, rows in found["contacts"].groupby(["stage", "sample"], observed=True):
        zone = zones.loc[[key]]
        for name in ("stick", "slip"):
            assert rows[f"path_{name}"].mean() == pytest.approx(zone[name].item(), rel=1e-6)
    assert found["contacts"]["path_slip"].between(0, 1).all() and found["contacts"]["path_slip"].nunique() > 2


def test_rescued_marks_samples_whose_path_was_not_followed(evaluation, lap_model):
    def rescued(model, law="coulomb", **changes):
        resolutions = {name: replace(r, **changes) for name, r in evaluation.resolutions.items()}
        frame = tables(model, replace(evaluation, law=law, resolutions=resolutions))["resolutions"]
        return frame[frame["stage"] == "clamp"]["rescued"].tolist()

    rung = np.array(["followed", "sweeps", "none"], dtype=object)
    states = {"rung": rung, "converged": np.array([True, True, False])}
    assert rescued(lap_model, **states) == [False, True, False]
    assert rescued(lap_model, "associated", **states) == [False] * 3  # it takes increments, and keeps to them
    stages = [stage.model_copy(update={"path": "increments", "increments": 2}) for stage in lap_model.scene.stages]
    plain = replace(lap_model, scene=lap_model.scene.model_copy(update={"stages": stages}))
    assert rescued(plain, **states) == [False] * 3


def test_every_row_of_the_contacts_names_its_sample_stage_and_pair(found, evaluation, lap_model):
    contacts = found["contacts"].set_index(["stage", "sample", "contact"])
    assert contacts.index.is_unique and (contacts["zone"] == "lap").all()
    axes = ("n", "t1", "t2")
    for stage, resolution in evaluation.resolutions.items():
        for sample in range(3):
            rows = contacts.loc[stage, 5 + sample].loc[np.arange(len(lap_model.contacts))]
            np.testing.assert_array_equal(rows[[f"f_{axis}" for axis in axes]], resolution.force[sample])
            np.testing.assert_array_equal(rows[[f"u_{axis}" for axis in axes]], resolution.displacement[sample])
            assert rows["state"].tolist() == [("open", "stick", "slip")[code] for code in resolution.state[sample]]


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda frame: frame.drop(columns="rms_slip"), "'rms_slip'"),
        (lambda frame: frame.astype({"rms_slip": "float32"}), "holds float32, expected float64"),
        (lambda frame: frame.astype({"zone": object}), "'zone' holds object"),
        (lambda frame: frame.assign(more=1.0), "'more' is not declared"),
        (lambda frame: frame[["stage", "sample", *frame.columns[2:]]], "'stage' is out of order"),
    ],
)
def test_a_frame_that_is_not_its_table_is_refused(found, change, words, tmp_path):
    path = tmp_path / "block.parquet"
    with pytest.raises(FormatError, match="slips") as caught:
        write_table(path, schema.SLIPS, change(found["slips"].copy()), "me")
    assert words in str(caught.value) and not path.exists()


def test_tangential_columns_may_be_absent_and_no_others(found):
    contacts = found["contacts"]
    tangential = ["f_t1", "f_t2", "u_t1", "u_t2", "path_stick", "path_slip"]
    schema.CONTACTS.check(contacts.drop(columns=tangential), "memory", "mend it")
    with pytest.raises(FormatError, match="'f_n'"):
        schema.CONTACTS.check(contacts.drop(columns="f_n"), "memory", "mend it")


@pytest.mark.parametrize("table", schema.DATASETS, ids=lambda table: table.name)
def test_blocks_keep_every_bit_and_carry_units_and_identity(found, table, tmp_path):
    for name, expected in (("law=coulomb/block", found[table.name]), ("empty", table.empty())):
        path = tmp_path / f"{name}.parquet"
        write_table(path, table, expected, "me")
        frame, identity = read_table(path, table)
        pd.testing.assert_frame_equal(frame, expected, check_exact=True)
        assert identity == "me"
        stored = pq.read_schema(path)
        units = {column.name: column.unit for column in table.columns if column.name in frame}
        assert {name: stored.field(name).metadata[b"unit"].decode() for name in units} == units


def _header(path, **changes):
    content = pq.read_table(path)
    header = {**content.schema.metadata, **{key.encode(): value.encode() for key, value in changes.items()}}
    altered = io.BytesIO()
    pq.write_table(content.replace_schema_metadata(header), altered)
    path.write_bytes(with_digest(altered.getvalue()))


def _flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    "spoil, words",
    [
        (_flip, "cut short or damaged"),
        (lambda path: path.write_bytes(path.read_bytes()[:200]), "cut short or damaged"),
        (lambda path: path.write_bytes(b""), "cut short or damaged"),
        (lambda path: _header(path, format="0"), "an older version"),
        (lambda path: _header(path, format="99"), "a newer version"),
        (lambda path: _header(path, format="new"), "is no block of slips"),
        (lambda path: _header(path, kind="block of measurements"), "is no block of slips"),
        (lambda path: pd.DataFrame({"x": [1.0]}).to_parquet(path), "cut short or damaged"),  # without our checksum
    ],
)
def test_a_block_that_cannot_be_read_is_one_sentence(found, spoil, words, tmp_path):
    path = tmp_path / "block.parquet"
    write_table(path, schema.SLIPS, found["slips"], "me")
    spoil(path)
    with pytest.raises(FormatError) as caught:
        read_table(path, schema.SLIPS)
    assert words in str(caught.value) and str(path) in str(caught.value) and "run the scene again" in str(caught.value)


#: Version of each dataset, then of each CSV table, and a digest of its columns.
DECLARED = {
    "deviations": (1, "2113a270"),
    "resolutions": (6, "a10c5e83"),
    "slips": (3, "802d26ed"),
    "measurements": (1, "00559d48"),
    "profiles": (1, "48ef7f01"),
    "contacts": (2, "f209fc4c"),
    "limits": (1, "3fa64707"),
    "samples": (2, "30ee361a"),
    "tables/zones.csv": (5, "360a86db"),
    "tables/contacts.csv": (2, "c56ff2f1"),
    "tables/measurements.csv": (5, "65f64062"),
    "tables/profiles.csv": (1, "75edc606"),
    "tables/limits.csv": (1, "03503102"),
    "tables/path.csv": (1, "9d91b434"),
    "tables/path_errors.csv": (1, "974e5a04"),
    "tables/friction.csv": (1, "c0c8ddac"),
    "tables/accuracy.csv": (1, "759ba61f"),
    "tables/mesh_changes.csv": (1, "001b5b1d"),
    "tables/contributors.csv": (1, "cf1f0752"),
    "tables/linearity.csv": (1, "fb69b931"),
    "tables/sensitivities.csv": (2, "43704474"),
    "tables/spreads.csv": (1, "49a610db"),
    "tables/friction_effects.csv": (1, "129890a1"),
    "tables/rare.csv": (1, "82a15a4d"),
    "tables/design_points.csv": (1, "53582d1a"),
    "tables/remedies.csv": (1, "748f151e"),
    "tables/remedy_effects.csv": (1, "9c6ed8aa"),
    "tables/orders.csv": (1, "36406f3e"),
    "tables/optima.csv": (1, "1d00a37d"),
    "tables/optimum_changes.csv": (1, "37370d93"),
    "tables/optimum_matches.csv": (1, "9a7cdcf8"),
    "tables/density.csv": (1, "54bfbd8d"),
}


def test_a_table_whose_columns_change_has_another_version():
    """An older folder would otherwise be read as if its columns had their present meaning."""
    found = {
        (table.name if table in schema.DATASETS else table.place): (
            table.version,
            hashlib.sha256(repr(columns).encode()).hexdigest()[:8],
        )
        for table in (*schema.DATASETS, *schema.STATISTICS, *schema.STUDIES)
        if (columns := [(column.name, column.dtype, column.unit, column.optional) for column in table.columns])
    }
    assert found == DECLARED, "raise the version of the table in mic/results/schema.toml, then write its new digest"


def test_the_reference_names_every_table_and_column():
    text = schema.reference()
    every = (*schema.DATASETS, *schema.STATISTICS, schema.FORCES, schema.FIELDS)
    assert len({table.name for table in schema.DATASETS}) == len(schema.DATASETS)
    for table in every:
        assert len(set(table.names)) == len(table.names) and all(column.meaning for column in table.columns)
        sections = text.split(f"### {table.name}\n")[1:]
        needed = [table.place, *(f"| `{column.name}` |" for column in table.columns)]
        assert any(all(words in section for words in needed) for section in sections)
