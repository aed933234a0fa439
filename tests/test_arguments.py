"""Arguments that a public function cannot use give one sentence that names them; natural ones give natural results."""

import copy
import inspect
import pickle

import numpy as np
import pandas as pd
import pytest
from support.springs import dragged

import mic
from mic.contact import ContactSolver
from mic.errors import ArgumentError
from mic.process.evaluation import Evaluation
from mic.system.arguments import checked

NAN, HUGE = float("nan"), 1e300
NO_NUMBER = [None, "x", NAN, float("inf"), HUGE, -HUGE, [1.0], {}, 1j, True]
#: Values that no function can use, by argument.
BAD = {
    "model": [None, 3, "model.npz", [1]],
    "a": [None, 3, "results"],
    "b": [None, 3, "results"],
    "scene": [None, 3, "scene.toml"],
    "law": ["viscous", "", 3, ["coulomb"], b"coulomb", NAN],
    "laws": [["viscous"], "coulomb", 3, [3], [None]],
    "names": [["Q"], "M", 3, [3], [None], {"M": 1}],
    "adjust": [["Q"], "T", 3, [3]],
    "samples": [0, -1, 1.5, "ten", True, 10**12, NAN, [3]],
    "fresh": [0, -1, 1.5, "ten", None, True, 10**12],
    "budget": [0, -1, 1.5, "ten", None, True, 10**12],
    "threads": [0, -1, 1.5, "two", None, True, 10**6],
    "seed": [-1, 1.5, "x", 2**70, NAN, [1], True],
    "shim": [0, -1, *NO_NUMBER],
    "factor": [0, -1, 1, *NO_NUMBER],
    "capability": [0, -1, *NO_NUMBER],
    "error": [-1, *NO_NUMBER],
    "friction": [0, -1, *NO_NUMBER[1:]],
    "measured": [{}, None, [], 5, {"Q": 1.0}, {3: 1.0}, *({"M": value} for value in (*NO_NUMBER, np.zeros(3)))],
    "gauge": [0, -1, {"M": -1.0}, {"Q": 1.0}, {"M": "x"}, *NO_NUMBER],
    "parts": [None, [], 3, "x", [3], [{"Q": 1}], {"P": 1}, pd.DataFrame(), pd.DataFrame({"Q": [1]}),
              pd.DataFrame({"P": ["a"]}), *([{"P": value}] for value in ("x", HUGE, [1, 2], None, True))],
    "exact": ["no", 3, None],
    "others": [3, "x", [3], [], ["x", "y"]],
    "folder": [None, 3, "", "a\0b"],
    "path": [None, 3, "", "a\0b"],
    "files": [None, 3, "part.stl", [3], [None]],
    "replace": [3, "no"],
    "progress": [3, "no", [True]],
}  # fmt: skip
#: Valid arguments of functions beside the model.
NEEDED = {
    "explain": {"measured": {"M": 0.1}, "gauge": 0.05},
    "predict": {"parts": [{"P": 0.8}], "exact": True},
    "run": {"folder": "results", "cache": "cache"},
    "init": {"files": []},
    "export": {"path": "unit.fmu"},
}
DEVIATIONS = [
    *(None, "x", [[]], [1], [1, None], [1, "x"], [[1, 2], [3]], [1, 2, 3], 5.0, {1: 2}, [np.datetime64("2020"), 1]),
    *(np.zeros((2, 3)), np.zeros((1, 1, 2)), np.array(["a", "b"]), np.array([1j, 0]), [True, False]),
    *([NAN, 1], [HUGE, 1]),
    *({"Q": 1}, {3: 1}, {"P": [1, 2], "D": [1, 2, 3]}, {"P": [[1, 2]]}, pd.DataFrame({"Q": [1.0]})),
    *(pd.DataFrame({"P": [1.0]}), pd.DataFrame({"P": [1.0], "D": [2.0], "Q": [1.0]})),
    *({"P": value} for value in ("x", None, NAN, HUGE, True, 1j, [1, "x"], [1, None], {})),
]  # fmt: skip
FUNCTIONS = [name for name in mic.__all__ if inspect.isfunction(getattr(mic, name))]


@pytest.fixture(scope="module")
def model():
    return dragged()


def sentence(error):
    """The message of an error, which must be one line with a remedy."""
    text = str(error.value)
    assert text and "\n" not in text and any(word in text for word in (";", "known", "has:", "one of")), text
    return text


def given(name, model):
    """Valid arguments of a function."""
    parameters = inspect.signature(getattr(mic, name)).parameters
    model_arguments = {key: model for key in ("model", "a", "b") if key in parameters}
    scene = {"scene": model.scene} if "scene" in parameters else {}
    return model_arguments | scene | NEEDED.get(name, {})


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name != "cache_folder"])
def test_each_bad_argument_is_one_sentence_that_names_it(name, model, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    function, tried = getattr(mic, name), 0
    for argument, parameter in inspect.signature(function).parameters.items():
        for bad in BAD.get(argument, []):
            if bad is None and parameter.default is None:
                continue
            with pytest.raises(mic.MicError) as error:
                function(**given(name, model) | {argument: bad})
            text, tried = sentence(error), tried + 1
            own = [argument, argument.rstrip("s"), "'Q'", *map(str, bad if isinstance(bad, dict) else [])]
            assert any(word in text for word in own) or "scene 'springs'" in text, (argument, bad, text)
    assert tried >= 3 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("bad", DEVIATIONS, ids=lambda bad: str(bad)[:30])
def test_deviations_that_are_none_are_refused(model, bad):
    for evaluate in (model.evaluate, model.sensitivities, lambda values: model.evaluate(values, "frictionless")):
        with pytest.raises(ArgumentError, match="deviations") as error:
            evaluate(bad)
        sentence(error)


def test_numbers_and_columns_by_name_are_batches(model):
    expected = model.evaluate([[0.7, 2.0], [0.9, 2.0]]).measurements
    for values in (
        {"P": [0.7, 0.9]},
        {"P": np.array([0.7, 0.9]), "D": 2.0},
        {"P": (0.7, 0.9), "D": [2, 2]},
        pd.DataFrame({"D": [2.0, 2.0], "P": [0.7, 0.9]}),
    ):
        np.testing.assert_array_equal(model.evaluate(values).measurements, expected)
    series = pd.Series({"D": 2.0, "P": 0.9})
    np.testing.assert_array_equal(model.evaluate(series).measurements, expected[1:])
    np.testing.assert_array_equal(model.evaluate({"P": np.float32(0.5)}).deviations, [[0.5, 2.0]])


@pytest.mark.parametrize("none", [[], np.zeros((0, 2)), {"P": []}, pd.DataFrame({"P": [], "D": []}, dtype=float)])
def test_no_assembly_gives_empty_results(model, none):
    one, found = model.evaluate({}), model.evaluate(none)
    assert isinstance(found, Evaluation) and found.measurements.shape == (0, 2) == found.deviations.shape
    for stage, resolution in one.resolutions.items():
        assert found.resolutions[stage].force.shape == (0, *resolution.force.shape[1:])
    assert found.motion.shape == (0, one.motion.shape[1]) and found.built.shape == found.failed.shape == (0,)
    with pytest.raises(ArgumentError, match="deviations: there is no sample"):
        model.sensitivities(none)


@pytest.mark.parametrize("bad", ["P", 3, [], ["Q"], [3], {"Q": 1.0}, {"P": "x"}, {"P": -1.0}, {"P": NAN}, {"P": [1]}])
def test_inputs_that_are_none_are_refused(model, bad):
    with pytest.raises(ArgumentError, match="inputs") as error:
        model.sensitivities({}, inputs=bad)
    sentence(error)


def test_a_value_out_of_proportion_is_named_and_a_usual_one_is_not(model, recwarn):
    model.evaluate([[0.8 + 90.0, 2.0], [0.2, -1.0]])
    assert not recwarn.list
    with pytest.warns(UserWarning, match="sample 1, 'P' is 1e.06, and its distribution has mean 0.8.*check its unit"):
        model.evaluate({"P": [0.8, 1e6]})


def test_the_page_of_an_exploration_refuses_bad_values(model):
    exploration = mic.explore(model)
    for values in ({"Q": 1.0}, *({"P": bad} for bad in ("x", None, NAN, HUGE, [1.0]))):
        with pytest.raises(ArgumentError) as error:
            exploration.answer(values)
        sentence(error)


def test_a_function_without_checked_arguments_is_not_decorated():
    with pytest.raises(AssertionError, match="no argument with a rule"):
        checked(lambda first, second: None)


@pytest.mark.parametrize("duplicate", [lambda one: pickle.loads(pickle.dumps(one)), copy.deepcopy, copy.copy])
def test_used_objects_are_copied_and_give_the_same_bits(duplicate):
    model = dragged()
    used = model.evaluate({}, "frictionless"), model.evaluate({"D": 2.1})
    for law in ("coulomb", "associated", "frictionless"):
        again, expected = duplicate(model).evaluate({"P": [0.7, 0.9]}, law), model.evaluate({"P": [0.7, 0.9]}, law)
        assert again.measurements.tobytes() == expected.measurements.tobytes()
        assert again.functional_force.tobytes() == expected.functional_force.tobytes()
    for evaluation in used:
        found = duplicate(evaluation)
        assert found.motion.tobytes() == evaluation.motion.tobytes()
        for stage, resolution in evaluation.resolutions.items():
            assert found.resolutions[stage].force.tobytes() == resolution.force.tobytes()
    exploration = mic.explore(model)
    answer = exploration.answer({"P": 0.9})
    assert duplicate(exploration).answer({"P": 0.9}).table.equals(answer.table)
    assert duplicate(answer).evaluation.motion.tobytes() == answer.evaluation.motion.tobytes()
    process = model.process("coulomb")
    assert duplicate(process).evaluate(model.deviations({})).motion.tobytes() == model.evaluate({}).motion.tobytes()
    assert duplicate(model.scene) == model.scene


@pytest.mark.parametrize("duplicate", [lambda one: pickle.loads(pickle.dumps(one)), copy.deepcopy])
def test_a_used_contact_solver_is_copied(duplicate):
    solver = ContactSolver(0.01 * np.eye(6), 0.3)
    expected = solver.solve(np.array([-1.0, 0.1, 0.0, 0.5, 0.0, 0.1]))
    again = duplicate(solver).solve(np.array([-1.0, 0.1, 0.0, 0.5, 0.0, 0.1]))
    assert again.force.tobytes() == expected.force.tobytes() and again.force.any()


@pytest.mark.slow
def test_a_used_model_of_sheets_is_copied(lap_model):
    expected = lap_model.evaluate({})
    for duplicate in (lambda one: pickle.loads(pickle.dumps(one)), copy.deepcopy):
        assert duplicate(lap_model).evaluate({}).motion.tobytes() == expected.motion.tobytes()
        assert duplicate(lap_model.process()).evaluate(lap_model.deviations({})).motion.tobytes() == (
            expected.motion.tobytes()
        )
