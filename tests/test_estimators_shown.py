"""Estimates of surrogates in report, verdict, summary and console."""

from dataclasses import replace

import numpy as np
import pytest
from support.runs import changed

from mic.report.estimator_sentences import estimator_sentences, sample_count
from mic.report.page import write_report
from mic.report.verdict import verdict
from mic.results.capability_verdict import COUNTED, SURROGATES, capability_verdict
from mic.results.outcome import read_outcome
from mic.runs import sample_into
from mic.scene.schema import Accuracy

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def outcome(lap_model, tmp_path_factory):
    """Fifty followed samples, and the samples in one step of a run with an accuracy."""
    folder = tmp_path_factory.mktemp("few")
    scene = changed(lap_model.scene, monte_carlo={"accuracy": Accuracy(six_sigma=0.5)})
    model = replace(lap_model, scene=scene)
    sample_into(folder, model, ["coulomb", "frictionless"], 500, 4)
    return read_outcome(folder)


def test_the_improved_estimates_are_the_headline_of_summary_and_verdict(outcome):
    table = outcome.measurement_statistics
    own = table[table["law"] == "coulomb"].set_index("measurement")
    assert (own["improved"] != "plain").all()
    for name, item in outcome.summary()["laws"]["coulomb"]["measurements"].items():
        assert item["six_sigma"] == own.at[name, "six_sigma"]
        for figure in ("mean", "six_sigma", "cpk", "share_outside"):
            assert item["headline"][figure] == own.at[name, f"improved_{figure}"] != item[figure]
            ends = [own.at[name, f"improved_{figure}{end}"] for end in ("_low", "_high")]
            assert item["headline"][f"{figure}_ci"] == ends
    judged = capability_verdict(outcome, "coulomb", outcome.measurement_headlines)
    assert judged.cpk.low == pytest.approx(own["improved_cpk_low"].to_numpy())
    shown = {row["measurement"]: row for row in verdict(outcome).rows}
    assert all(shown[name]["six_sigma"] == own.at[name, "improved_six_sigma"] for name in own.index)
    zones = outcome.summary()["laws"]["coulomb"]["zones"]["lap"]
    assert zones["headline"]["mean_rms_slip"] != zones["mean_rms_slip"]


def test_the_share_outside_any_limit_is_between_the_largest_and_the_sum_of_the_characteristics(outcome):
    judged = capability_verdict(outcome, "coulomb", outcome.measurement_headlines)
    own = outcome.measurement_statistics
    shares = own.loc[own["law"] == "coulomb", "improved_share_outside"]
    assert judged.estimator == SURROGATES != COUNTED
    assert shares.max() <= judged.outside.value <= shares.sum()
    assert judged.outside.low < judged.outside.value < judged.outside.high


def test_the_report_says_from_what_the_estimates_are_and_what_may_be_unseen(outcome, no_pictures):
    assert sample_count(outcome, "coulomb") == "50 followed samples and 450 in one step"
    assert sample_count(outcome, "frictionless") == "50 samples and 450 in one step"
    followed, frictionless, reached = estimator_sentences(outcome)
    assert reached.startswith("50 samples: ") and reached.endswith(".")
    assert followed.startswith("coulomb: 50 followed samples and 450 in one step. Mean, 6σ, Cp, Cpk and share outside")
    assert "by the samples in one step, corrected by a" in followed and "of the variance" in followed
    assert "fewer than 6.0 % of the assemblies may be unseen in 50 followed samples" in followed
    assert "those in one step show behaviour of 0.7 % or more, unless the load path causes it" in followed
    assert "may be unseen in 50 samples; those in one step" in frictionless
    page = write_report(outcome.folder, outcome).read_text(encoding="utf-8")
    assert followed in page and frictionless in page
    own = outcome.measurement_headlines.iloc[0]
    assert f"samples {own['alone_six_sigma']:.2f}<br>" in page
    assert "Estimated from 50 followed samples and 450 in one step, with surrogates of 2 of 2 key" in page


def test_a_characteristic_that_no_surrogate_explains_is_named(outcome):
    improved = outcome.improved("coulomb")
    improved.better[improved.keys.index(("measurement", "M2"))] = False
    try:
        followed, *_ = estimator_sentences(outcome)
        assert (
            "M2 by the samples alone, because no surrogate is better" in followed
            and "M1 by the samples in one step" in followed
        )
    finally:
        improved.better[improved.keys.index(("measurement", "M2"))] = True
    assert np.all(improved.better[:2])
