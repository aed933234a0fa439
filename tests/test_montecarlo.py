"""Samples depend only on seed and number, and each reaches the sink once."""

import os

import numpy as np
import pytest
from scipy import stats

from mic.execution import local
from mic.execution import monte_carlo as montecarlo
from mic.execution.local import Local
from mic.execution.monte_carlo import BLOCK, MAX_ENTRIES, MAX_FIRST_ENTRIES, SIZES, blocks, monte_carlo, pieces
from mic.scene import Scene
from mic.scene.samples import DESIGNS
from mic.statistics import estimates
from mic.statistics.draw import draw

LAWS = ["coulomb", "frictionless"]


def collected(model, laws, samples, seed, **options):
    """The blocks that a Monte Carlo passes to its sink, in order, and the number of reused samples."""
    found = []
    reused = monte_carlo(model, laws, samples, seed, lambda *block: found.append(block), **options)
    return found, reused


#: Name and parameters in a scene, and the distribution of SciPy that it is to be, but for mean and scale.
REFERENCES = {
    "normal": ({}, stats.norm()),
    "uniform": ({}, stats.uniform()),
    "gumbel_r": ({}, stats.gumbel_r()),
    "skewnorm": ({"a": 4.0}, stats.skewnorm(4.0)),
    "triang": ({"c": 0.25}, stats.triang(0.25)),
    "beta": ({"a": 2.0, "b": 5.0}, stats.beta(2.0, 5.0)),
}


def having(scene, correlations=(), design="independent", **keys):
    """The scene with keys of all its deviations, a design and correlations, read anew."""
    table = scene.model_dump(mode="json")
    table["deviations"] = [item | keys for item in table["deviations"]]
    table["monte_carlo"] |= {"design": design}
    return Scene(**table | {"correlations": list(correlations)})


BY_DESIGN = [*((name, "independent") for name in REFERENCES), *(("beta", name) for name in [*DESIGNS][1:])]


@pytest.mark.parametrize("distribution, design", BY_DESIGN)
def test_deviations_follow_the_stated_distribution(lap_scene, distribution, design):
    parameters, reference = REFERENCES[distribution]
    scene = having(lap_scene, design=design, distribution=distribution, parameters=parameters)
    values = draw(scene, 8, 0, 4000)
    for j, deviation in enumerate(scene.deviations):
        standard = (values[:, j] - deviation.mean) / deviation.sigma
        assert stats.kstest(reference.mean() + reference.std() * standard, reference.cdf).pvalue > 1e-3
        assert (standard.mean(), standard.std()) == pytest.approx((0.0, 1.0), abs=0.06)
    correlation = np.corrcoef(values.T) - np.eye(len(scene.deviations))
    assert np.abs(correlation).max() < 4 / np.sqrt(4000)


def test_a_truncated_deviation_is_the_same_one_cut_off(lap_scene):
    scene = having(lap_scene, mean=2.0, sigma=0.5, truncated=[1.6, 3.5])
    values = draw(scene, 8, 0, 4000)
    assert values.min() >= 1.6 and values.max() <= 3.5
    for column in values.T:
        assert stats.kstest(column, stats.truncnorm(-0.8, 3.0, 2.0, 0.5).cdf).pvalue > 1e-3


R = [[1.0, 0.7, -0.4], [0.7, 1.0, 0.1], [-0.4, 0.1, 1.0]]


@pytest.mark.parametrize("distribution, design", [("normal", "independent"), ("uniform", "latin-hypercube"),
                                                  ("expon", "antithetic"), ("expon", "sobol")])  # fmt: skip
def test_correlated_deviations_have_the_copulas_rank_correlation_and_their_own_distribution(
    lap_scene, distribution, design
):
    """Spearman's of a Gaussian copula is 6/π arcsin(ρ/2)."""
    names = [item.name for item in lap_scene.deviations]
    scene = having(lap_scene, [{"deviations": names[:3], "matrix": R}], design, distribution=distribution)
    values = draw(scene, 3, 0, 8000)[:, :3]
    expected = 6 / np.pi * np.arcsin(np.array(R) / 2)
    assert np.abs(stats.spearmanr(values).correlation - expected).max() < 0.03
    if distribution == "normal":
        assert np.abs(np.corrcoef(values.T) - R).max() < 0.03
    frozen = REFERENCES.get(distribution, ({}, stats.expon()))[1]
    for j, item in enumerate(scene.deviations[:3]):
        standard = (values[:, j] - item.mean) / item.sigma
        assert stats.kstest(frozen.mean() + frozen.std() * standard, frozen.cdf).pvalue > 1e-3


def test_a_design_without_points_is_an_error_and_no_other_design(lap_scene, monkeypatch):
    monkeypatch.setitem(DESIGNS, "halton", 4)
    carlo = lap_scene.monte_carlo.model_copy(update={"design": "halton"})
    with pytest.raises(NotImplementedError, match="sampling design 'halton'"):
        draw(lap_scene.model_copy(update={"monte_carlo": carlo}), 1, 0, 4)


@pytest.mark.parametrize("design", DESIGNS)
def test_samples_of_a_design_do_not_depend_on_how_they_are_batched(lap_scene, design):
    names = [item.name for item in lap_scene.deviations]
    together = [{"deviations": names[:3], "matrix": R}]
    scene = having(lap_scene, together, design, distribution="skewnorm", parameters={"a": 2.0})
    whole = draw(scene, 4, 0, 200)
    for first, count in ((17, 5), (63, 2), (49, 2), (0, 1), (130, 70)):
        np.testing.assert_array_equal(draw(scene, 4, first, count), whole[first : first + count])
    assert (draw(scene, 5, 0, 200) != whole).all() and len(np.unique(whole)) == whole.size


@pytest.mark.parametrize(
    "design, recorded",
    [
        ("latin-hypercube", [0.5997451313177711, 0.6357588924201009, 0.17342626493927704]),
        ("sobol", [0.7749083219096065, 0.637419207021594, 0.5574209671467543]),
    ],
)
def test_points_of_a_design_are_the_same_with_every_version_of_scipy(lap_scene, design, recorded):
    """The points of ``scipy.stats.qmc`` 1.10; later versions derive others from the same stream, or none."""
    scene = having(lap_scene, design=design, distribution="uniform", mean=0.0, sigma=1 / np.sqrt(3))
    point = draw(scene, 4, DESIGNS[design] + 5, 1)[0]  # of the second group
    assert (point + 1) / 2 == pytest.approx(recorded, abs=1e-14)


def test_opposite_samples_mirror_and_hypercubes_fill_every_layer_once(lap_scene):
    pairs = draw(having(lap_scene, design="antithetic"), 4, 0, 100)
    mean = np.array([item.mean for item in lap_scene.deviations])
    assert np.abs(pairs[::2] + pairs[1::2] - 2 * mean).max() < 1e-9
    cube = draw(having(lap_scene, design="latin-hypercube"), 4, 50, 50)
    sigma = np.array([item.sigma for item in lap_scene.deviations])
    layers = np.sort((50 * stats.norm.cdf((cube - mean) / sigma)).astype(int), axis=0)
    assert (layers == np.arange(50)[:, None]).all()


def output(values):
    """A key characteristic with a curved and a mixed part."""
    a, b, c = values.T
    return a + 0.5 * b - 0.3 * c + 0.2 * a**2 + 0.2 * b * c


@pytest.mark.slow
@pytest.mark.parametrize("design", DESIGNS)
def test_intervals_of_a_design_have_their_coverage_and_designs_reduce_the_error(lap_scene, design):
    """Mean and σ over 100 repetitions; designs with large groups have a dozen groups, the others a hundred."""
    scene = having(lap_scene, design=design, mean=0.0, sigma=1.0)
    n = {"latin-hypercube": 600, "sobol": 640}.get(design, 200)
    group = np.arange(n) // DESIGNS[design] % 100
    found = []
    for seed in range(100):
        y = output(draw(scene, seed, 0, n))
        mean = estimates.grouped_jackknife(y, group, np.mean, added=0)
        sigma = estimates.grouped_jackknife(y, group, lambda x: np.std(x, ddof=1), positive=True)
        found.append((mean.value, sigma.value, mean.low, mean.high, sigma.low, sigma.high))
    truth = 0.2, np.sqrt(1 + 0.25 + 0.09 + 2 * 0.04 + 0.04)
    value = np.array(found)
    for low, high, true in zip(value[:, 2::2].T, value[:, 3::2].T, truth):
        assert 0.91 <= np.mean((low <= true) & (true <= high)) <= 0.985
    most = {"independent": 1.2, "antithetic": 0.5, "latin-hypercube": 0.3, "sobol": 0.2}[design]
    assert value[:, 0].std() < most * truth[1] / np.sqrt(n)


def test_every_sample_reaches_the_sink_once(lap_model):
    found, reused = collected(lap_model, LAWS, BLOCK + 10, 4)
    ranges = [(law, first, count) for law in LAWS for first, count in ((0, BLOCK), (BLOCK, 10))]
    assert [(law, first, len(evaluation.deviations)) for law, first, evaluation in found] == ranges
    for _, first, evaluation in found:
        expected = draw(lap_model.scene, 4, first, len(evaluation.deviations))
        np.testing.assert_array_equal(evaluation.deviations, expected)
    assert reused == {"coulomb": 0, "frictionless": 0}


def _process_and_values(law, first, evaluation):
    return os.getpid(), evaluation.measurements, evaluation.functional_force


@pytest.mark.slow
def test_any_number_of_workers_gives_the_bits_of_one(lap_model, monkeypatch):
    """Ten blocks, of which nine workers evaluate pieces; all samples are reported, and each block is taken here."""
    monkeypatch.setattr(local, "WORTHWHILE", 1e-9)
    monkeypatch.setattr("mic.execution.monte_carlo.REPORT_INTERVAL", 1e9)  # no pieces because the machine is busy

    def found(engine):
        taken, heard = {}, []
        advance = lambda law, count: heard.append(count)
        take = lambda law, first, count, result: taken.setdefault((law, first, count), result)
        monte_carlo(lap_model, LAWS, 5 * BLOCK, 4, _process_and_values, advance=advance, take=take, engine=engine)
        assert sum(heard) == 2 * 5 * BLOCK
        assert sorted(taken) == [(law, first, BLOCK) for law in LAWS for first in range(0, 5 * BLOCK, BLOCK)]
        return taken

    one = found(None)
    assert {process for process, *_ in one.values()} == {os.getpid()}
    for workers in (2, 9):  # two write whole blocks; with nine, this process joins pieces, and writes their block
        several = found(Local(workers))
        others = {process for process, *_ in several.values()} - {os.getpid()}
        assert bool(others) == (workers == 2)
        for block, (_, *values) in one.items():
            for value, other in zip(values, several[block][1:]):
                np.testing.assert_array_equal(value, other)


@pytest.mark.parametrize(
    "workers, seconds, most", [(1, 0.01, BLOCK), (2, 0.01, BLOCK), (40, 0.01, 10), (2, 4.0, 2), (2, 60.0, 1)]
)
def test_blocks_are_divided_for_many_workers_and_slow_samples(workers, seconds, most):
    every = blocks(LAWS, 3 * BLOCK + 10, 24)
    found = pieces(every, workers, seconds)
    assert max(piece.count for piece in found) == most
    assert all(piece.whole == (piece.count == piece.block[2]) for piece in found)
    samples = lambda items: [(law, number) for law, first, count in items for number in range(first, first + count)]
    assert samples((piece.law, piece.first, piece.count) for piece in found) == samples(every)
    large = blocks(LAWS, 100_000, 24)
    assert all(piece.whole for piece in pieces(large, 1024, 0.01) if piece.block[2] > 100)


def test_finished_blocks_are_skipped_and_counted(lap_model):
    heard = []
    done = lambda law, first, count: law == "coulomb" and first == 0
    advance = lambda law, count: heard.append((law, count))
    found, reused = collected(lap_model, LAWS, BLOCK + 10, 4, done=done, advance=advance)
    assert ("coulomb", 0) not in [block[:2] for block in found] and len(found) == 3
    assert reused == {"coulomb": BLOCK, "frictionless": 0}
    assert {law: sum(count for name, count in heard if name == law) for law in LAWS} == dict.fromkeys(LAWS, BLOCK + 10)


def test_a_sample_that_breaks_is_counted_and_the_rest_survives(lap_model, monkeypatch):
    process = lap_model.process("coulomb")
    target = draw(lap_model.scene, 4, 7, 1)
    evaluate = process.evaluate

    def breaks(deviations, *at):
        if (deviations == target).all(axis=1).any():
            raise np.linalg.LinAlgError("planted")
        return evaluate(deviations, *at)

    monkeypatch.setattr(process, "evaluate", breaks)
    ((_, _, found),), _ = collected(lap_model, ["coulomb"], 20, 4)
    assert np.flatnonzero(found.failed).tolist() == [7]
    assert found.resolutions["clamp"].status[7] == "planted" and np.isnan(found.measurements[7]).all()
    assert np.isfinite(np.delete(found.measurements, 7, axis=0)).all()


@pytest.mark.parametrize("pairs", [0, 500, 100_000])
def test_blocks_begin_where_they_do_however_many_samples_there_are(pairs):
    whole = [first for _, first, _ in blocks(["coulomb"], 200_000, pairs)]
    for samples in (1, BLOCK, 1030, 1050, 123_456):
        found = blocks(LAWS, samples, pairs)
        for law in LAWS:
            firsts, counts = zip(*[(first, count) for name, first, count in found if name == law])
            assert list(firsts) == whole[: len(firsts)]
            assert list(np.cumsum(counts)) == [*firsts[1:], samples]  # without gaps, up to the last sample


def test_blocks_grow_with_their_place_as_far_as_memory_allows():
    small, large = blocks(["coulomb"], 1_000_000, 24), blocks(["coulomb"], 1_000_000, 500)
    assert all(count == BLOCK for _, first, count in small if first < 1000)
    assert all(count <= max(BLOCK, first / 20) for _, first, count in small)
    assert len(small) < 2100 and max(count for *_, count in small) == SIZES[-1]
    assert max(count for *_, count in large) * 500 <= MAX_ENTRIES
    assert [block[2] for block in blocks(["coulomb"], 12, MAX_FIRST_ENTRIES // 5)] == [5, 5, 2]


def test_slow_samples_are_reported_one_by_one_with_the_same_results(lap_model, monkeypatch):
    one = lap_model.process("coulomb").evaluate(draw(lap_model.scene, 4, 0, 6))
    monkeypatch.setattr(montecarlo, "REPORT_INTERVAL", 0.0)  # any sample takes long
    told, expected = [], []
    advance = lambda law, count: told.append((law, count))
    pieces, _ = collected(lap_model, ["coulomb"], 6, 4, advance=advance, expect=expected.append)
    assert told == [("coulomb", 2)] + [("coulomb", 1)] * 4 and len(expected) == 1 and 0 < expected[0] < 60
    ((_, _, other),) = pieces
    for name in ("measurements", "deviations", "functional_force", "motion"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for stage, resolution in one.resolutions.items():
        np.testing.assert_array_equal(resolution.force, other.resolutions[stage].force)


def test_the_expected_duration_excludes_the_setup_in_the_first_sample(lap_model, monkeypatch):
    ticks = iter([0.0, 1000.0, 1006.0])
    monkeypatch.setattr(montecarlo.time, "perf_counter", lambda: next(ticks))
    expected = []
    collected(lap_model, ["frictionless"], 4, 4, expect=expected.append)
    assert expected == [12.0]  # two more of 6 s each
