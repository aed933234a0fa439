"""Mean and 6σ fields against one finite-element solve per sample and the reduced model's measurements."""

import meshlane
import numpy as np
import pytest

from mic.compliance import provider
from mic.errors import FormatError, MissingProvider
from mic.model.assembly import assemble
from mic.results.fields import compute_fields, low_rank, read_fields, write_fields
from mic.results.low_rank_forces import CompressedForces, ForceAccumulator
from mic.results.outcome import read_outcome
from mic.results.run_folder import RunFolder
from mic.runs import sample_into
from mic.statistics.draw import draw

SAMPLES, SEED = 25, 3
LAWS = ["coulomb", "frictionless"]


@pytest.fixture(scope="module")
def folder(lap_model, lap_scene, cache, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    sample_into(folder, lap_model, LAWS, SAMPLES, SEED)
    RunFolder(folder).store_inputs(assemble(lap_scene, cache))
    return folder


@pytest.fixture(scope="module")
def evaluation(lap_model):
    return lap_model.process("coulomb").evaluate(draw(lap_model.scene, SEED, 0, SAMPLES))


@pytest.mark.fem
@pytest.mark.slow
def test_fields_agree_with_one_solve_per_sample(folder, lap_model, lap_scene, cache, evaluation):
    from fem_reference.shell.part import ShellPart

    found = {field.part: field for field in compute_fields(read_outcome(folder)) if field.law == "coulomb"}
    for p, part in enumerate(assemble(lap_scene, cache).parts):
        shell = ShellPart(part.surface, part.thickness, part.young, part.poisson, part.element)
        rows = lap_model.compliance.functionals[p]
        direct = shell.field(part.functionals, evaluation.functional_force[:, rows].T)[:, :3]
        direct = direct + shell.rigid_field()[:, :3] @ evaluation.motion[:, 6 * p : 6 * p + 6].T  # (v, 3, samples)
        field, size = found[part.name], np.abs(direct).max()
        spread = 6 * direct.std(axis=2, ddof=1)
        np.testing.assert_allclose(field.mean, direct.mean(axis=2), atol=1e-8 * size)
        np.testing.assert_allclose(field.six_sigma, spread, atol=1e-4 * spread.max())
        along = np.einsum("vi,vis->vs", part.surface.vertex_normals, direct)
        np.testing.assert_allclose(field.six_sigma_normal, 6 * along.std(axis=1, ddof=1), atol=1e-4 * spread.max())
        np.testing.assert_allclose(
            field.six_sigma_magnitude, np.sqrt((spread**2).sum(axis=1)), atol=1e-4 * spread.max()
        )
        assert field.rank < SAMPLES // 2, "the factor saves nothing"


def condensed(force, motion, pieces=1, **options):
    """The samples as the fields take them in, in several pieces."""
    condenser = ForceAccumulator(**options)
    for part, other in zip(np.array_split(force, pieces), np.array_split(motion, pieces)):
        condenser.add(part, other)
    return condenser.centred()


def test_condensed_blocks_of_samples_have_the_factor_of_all():
    """Whether a block has more samples than columns, fewer, or none."""
    rng = np.random.default_rng(5)
    force, motion = 3 + rng.normal(size=(60, 7)), rng.normal(size=(60, 6))
    condenser = ForceAccumulator()
    for first, last in ((0, 40), (40, 40), (40, 45), (45, 60)):
        condenser.join(CompressedForces.of(force[first:last], motion[first:last]))
    whole, few = condensed(force, motion), condenser.centred()
    assert few.samples == 60 and len(CompressedForces.of(force[:40], motion[:40]).rows) == 14
    idle = np.hstack([force, np.zeros((60, 5))])  # functionals that no sample loads; motions that follow from forces
    some = CompressedForces.of(idle, idle[:, :6] * 1e-6)
    assert some.rows.shape == (8, 14) and some.dense.shape == (8, 19)
    np.testing.assert_allclose(few.mean, whole.mean, atol=1e-12)
    np.testing.assert_allclose(few.rows.T @ few.rows, whole.rows.T @ whole.rows, atol=1e-10)


def test_the_factor_has_the_promised_energy():
    rng = np.random.default_rng(0)
    C = rng.normal(size=(12, 12))
    H = C @ C.T
    force, motion = rng.normal(size=(40, 12)) * 10.0 ** -np.arange(12), rng.normal(size=(40, 6))
    ranks = []
    for share in (0.3, 1e-2, 1e-6, 0.0):
        factor = low_rank(condensed(force, motion), H, share)
        centred = force - force.mean(axis=0)
        assert factor.discarded <= max(share, 1e-20)
        assert ranks == [] or factor.rank > ranks[-1]
        ranks.append(factor.rank)
        covariance = factor.force @ factor.gram[: factor.rank, : factor.rank] @ factor.force.T
        exact = centred.T @ centred / 39
        assert abs(np.trace(H @ (exact - covariance)) / np.trace(H @ exact) - factor.discarded) < 1e-10
    assert ranks[-1] == 12


def test_condensing_does_not_change_the_factor():
    rng = np.random.default_rng(3)
    C = rng.normal(size=(9, 9))
    force = (5 + rng.normal(size=(700, 9))) * 10.0 ** -np.arange(9)
    force[:, 4] = 0.0  # loaded by no sample
    force[:, 5] = 2.0  # by all alike
    motion = force @ rng.normal(size=(9, 6)) + rng.normal(size=(700, 6))
    whole, few = condensed(force, motion), condensed(force, motion, pieces=40, buffer=0)
    assert len(whole.rows) == 700 and len(few.rows) == 15
    one, other = low_rank(whole, C @ C.T), low_rank(few, C @ C.T)
    assert one.rank == other.rank > 2 and other.samples == 700
    np.testing.assert_allclose(other.mean_force, one.mean_force, rtol=1e-12)
    np.testing.assert_allclose(other.mean_motion, one.mean_motion, rtol=1e-12, atol=1e-12)

    def covariance(factor):
        """Covariance of forces and motions, which does not depend on the sign of the columns."""
        basis = np.zeros((15, factor.rank + 6))
        basis[:9, : factor.rank], basis[9:, factor.rank :] = factor.force, np.eye(6)
        return basis @ factor.gram @ basis.T

    exact = covariance(one)
    size = np.sqrt(np.outer(exact.diagonal(), exact.diagonal()))
    assert (np.abs(covariance(other) - exact) <= 1e-12 * size).all()
    assert not other.force[4].any() and not other.force[5].any()


def test_one_sample_has_a_mean_and_no_spread(lap_model):
    factor = low_rank(condensed(np.ones((1, 4)), np.ones((1, 6))), np.eye(4))
    assert factor.rank == 0 and (factor.mean_force == 1).all() and factor.samples == 1


@pytest.mark.fem
def test_written_fields_are_read_unchanged(folder):
    written = write_fields(folder)
    read, skipped = read_fields(folder)
    assert skipped is None and len(read) == 4 and {(f.law, f.part) for f in read} == {(f.law, f.part) for f in written}
    for one, other in zip(written, read):
        np.testing.assert_array_equal(one.mean, other.mean)
        np.testing.assert_array_equal(one.six_sigma_normal, other.six_sigma_normal)
        mesh = meshlane.read(folder / "fields" / f"{one.law}-{one.part}.vtu")
        assert mesh.point_data["six_sigma"].shape == (len(mesh.points), 3)
        np.testing.assert_allclose(mesh.point_data["six_sigma_magnitude"], np.linalg.norm(one.six_sigma, axis=1))
        assert one.error < 1e-3 * one.six_sigma.max()
    assert (folder / "fields" / "lower.vtu").is_file()


@pytest.mark.fem
def test_matching_fields_are_reused_and_others_computed_again(folder):
    write_fields(folder)
    path = folder / "fields" / "coulomb-lower.vtu"
    note = folder / "fields" / "notes.vtu"
    note.write_text("mine")
    before = path.stat().st_mtime_ns
    write_fields(folder)
    assert path.stat().st_mtime_ns == before
    for samples in folder.glob("samples/law=frictionless/*.parquet"):
        samples.rename(samples.with_name(".aside"))
    write_fields(folder)
    assert path.stat().st_mtime_ns > before and not (folder / "fields" / "frictionless-lower.vtu").exists()
    assert note.read_text() == "mine"  # of no run
    for aside in folder.glob("samples/law=frictionless/.aside"):
        aside.rename(aside.with_name(f"{0:06d}-{SAMPLES - 1:06d}.parquet"))


@pytest.mark.fem
def test_missing_or_truncated_fields_are_reported_and_computed_again(folder, monkeypatch):
    (folder / "fields" / "fields.npz").unlink(missing_ok=True)

    def none(part):
        raise MissingProvider("none is at hand")

    monkeypatch.setattr(provider, "find", none)
    assert write_fields(folder) == []
    fields, skipped = read_fields(folder)
    assert fields == [] and "not installed" in skipped and "none is at hand" in skipped
    monkeypatch.undo()
    assert len(write_fields(folder)) == 4  # tried again once they are there
    path = folder / "fields" / "fields.npz"
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(FormatError, match="fields.npz.*damaged"):
        read_fields(folder)
    assert len(write_fields(folder)) == 4 and len(read_fields(folder)[0]) == 4
