"""Does friction matter: what other coefficients change, which zone's decides, how well it must be known."""

from dataclasses import replace

import numpy as np
import pytest
from support.springs import at_face, six, spring_model
from typer.testing import CliRunner

import mic
from mic.contact.increments import Increments
from mic.options import app
from mic.process.process import Process
from mic.report.driver_sentences import friction_words
from mic.results.schema import FRICTION_EFFECTS
from mic.statistics.draw import draw
from mic.studies.friction import friction_effects, friction_needed, with_scaled_friction

MU, LIFT, PULL, SAMPLES = 0.3, 0.4, 2.0, 10


@pytest.fixture(scope="module")
def dragged():
    """m lies between t and b, and is lifted by h at its face: t moves along x and drags it by μ h/4; b never touches.

    Pressed by k h/2, dragged by μ k h/2, its spring yields by half of 1/k per N.
    """
    return spring_model(
        [0.0, 0.0],
        parts=[{"name": name, "mesh": f"{name}.stl", "thickness": 1.0} for name in "bmt"],
        locators=[*six("b"), *six("m"), *six("t")],
        clamps=[at_face("t", (1, 0, 0), name="T", stroke=0.0)],
        zones=[
            {"name": "below", "parts": ["b", "m"], "friction": MU, "pairs": 1},
            {"name": "above", "parts": ["m", "t"], "friction": MU, "pairs": 1},
        ],
        measurements=[at_face("m", (1, 0, 0), name="M", lower=-1, upper=1)],
        deviations=[
            {"name": "P", "kind": "locator", "target": "ml1", "mean": 2 * LIFT, "sigma": 0.05},
            {"name": "D", "kind": "clamp", "target": "T", "mean": PULL, "sigma": 0.0},
        ],
        stages=[{"kind": "locate"}, {"kind": "clamp"}, {"kind": "measure"}],
    )


@pytest.fixture(scope="module")
def effects(dragged):
    return friction_effects(dragged, "coulomb", SAMPLES, seed=2)


@pytest.mark.slow
def test_changes_agree_with_the_closed_form(dragged, effects):
    """The drag, and with it mean and 6σ, goes as μ of the zone above; the zone below never touches."""
    FRICTION_EFFECTS.check(effects, "memory", "mend it")
    lift = mic.statistics.draw.draw(dragged.scene, 2, 0, SAMPLES)[:, 0] / 2
    for row in effects.to_dict("records"):
        change = 0.0 if row["zone"] == "below" else row["factor"] - 1
        assert row["mean_change"] == pytest.approx(change * MU * lift.mean() / 4, abs=1e-9)
        assert row["six_sigma_change"] == pytest.approx(change * MU * 6 * lift.std(ddof=1) / 4, abs=1e-9)
        assert row["six_sigma"] == pytest.approx(MU * 6 * lift.std(ddof=1) / 4, abs=1e-9)
        if change:
            assert row["mean_change_low"] < row["mean_change"] < row["mean_change_high"]
            assert row["six_sigma_change_low"] < row["six_sigma_change"] < row["six_sigma_change_high"]
    assert effects[["zone", "factor"]].to_numpy().tolist() == [
        *(["", factor] for factor in (0.0, 0.5, 2.0)),
        *([zone, factor] for zone in ("below", "above") for factor in (0.5, 2.0)),
    ]


@pytest.mark.slow
def test_the_zone_that_decides_and_how_well_its_friction_must_be_known(effects):
    needed = friction_needed(effects).set_index("zone")
    six_sigma = effects["six_sigma"].iloc[0]
    most = effects[(effects["zone"] == "above") & (effects["factor"] == 2.0)]["mean_change"].item() / six_sigma
    assert needed.loc["above", "change"] == pytest.approx(most) and most > 0.1
    assert needed.loc["above", "high"] == pytest.approx(2 ** (0.1 / most))
    assert needed.loc["below", ["change", "low", "high"]].tolist() == pytest.approx([0.0, 0.5, 2.0], abs=1e-9)
    said = " ".join(friction_words(effects, friction_needed(effects)))
    assert "without friction the mean would be" in said and "above matters most" in said


@pytest.mark.slow
def test_friction_that_varies_is_scaled_with_its_mean(dragged):
    """μ of every sample goes by the factor, so the drag of every sample does."""
    rough = mic.scene.deviation.FrictionDeviation(name="R", kind="friction", target="above", sigma=0.05)
    varied = dragged.varied(dragged.scene.model_copy(update={"deviations": [*dragged.scene.deviations, rough]}))
    found = friction_effects(varied, "coulomb", 6, seed=2)
    mean = varied.evaluate(draw(varied.scene, 2, 0, 6), "coulomb").measurements.mean()
    own = found[found["zone"] == ""].set_index("factor")
    assert (own["samples"] == 6).all()  # none has less than no friction
    np.testing.assert_allclose(own["mean_change"], [-mean, -mean / 2, mean], rtol=1e-8)


def test_samples_of_their_own_friction_take_the_path_of_the_process(lap_model):
    rough = mic.scene.deviation.FrictionDeviation(name="R", kind="friction", target="lap", sigma=0.05)
    varied = lap_model.varied(lap_model.scene.model_copy(update={"deviations": [*lap_model.scene.deviations, rough]}))
    process, deviations = Process(varied, "coulomb"), draw(varied.scene, 2, 0, 2)
    for count in (2, 3):
        for stage in process.stages:
            stage.path = Increments(count)
        steps = process.evaluate(deviations).resolutions["clamp"].trace.steps
        assert (steps == 2 * count).all()  # of two moves


def test_friction_without_effect_is_reported_so(lap_model):
    found = friction_effects(lap_model, "coulomb", 6, seed=1)
    assert set(found["zone"]) == {""} and (found["six_sigma_change"] != 0).all()
    first, second = friction_words(found, friction_needed(found))
    assert first.startswith("Friction has little effect")
    assert second.startswith("Results change by less than a tenth of 6σ")


def test_friction_by_pressure_is_scaled_with_the_rest(lap_model):
    contacts = lap_model.contacts
    pieces = np.tile([[0.0, 0.2, 1e-3, 0.4, 0.5]], (len(contacts), 1, 1))
    model = replace(lap_model, contacts=replace(contacts, pressure=pieces))
    own = with_scaled_friction(model, np.array([0]), 2.0).contacts
    np.testing.assert_allclose(own.pressure[0, 0], [0.0, 0.4, 2e-3, 0.8, 0.5])
    np.testing.assert_allclose(own.friction, 2 * contacts.friction)
    assert (pieces[:, 0, 1] == 0.2).all()
    assert with_scaled_friction(model, np.array([]), 2.0).contacts.pressure[0, 0, 1] == 0.2


@pytest.mark.slow
def test_the_command_prints_effects_and_refuses_a_frictionless_law(dragged, effects, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr("mic.studies.friction.friction_effects", lambda *given: asked.append(given) or effects)
    dragged.save(tmp_path / "model.npz")
    arguments = ["friction", str(tmp_path / "model.npz"), "--samples", "10"]
    done = CliRunner().invoke(app, arguments, env={"COLUMNS": "160"})
    assert done.exit_code == 0, done.output
    assert asked[0][1:4] == ("coulomb", 10, dragged.scene.monte_carlo.seed)
    for sentence in friction_words(effects, friction_needed(effects)):
        assert sentence in " ".join(done.output.split())
    refused = CliRunner().invoke(app, [*arguments, "--law", "frictionless"])
    assert refused.exit_code != 0 and "the effect of friction cannot be computed" in str(refused.exception)


@pytest.mark.slow
def test_an_assembly_held_by_friction_alone_has_no_row_without_it(effects):
    held = effects[effects["factor"] > 0]
    said = friction_words(held, friction_needed(held))
    assert said[0] == "Without friction this assembly is not held."
