"""Each command is a function of the same name."""

import inspect

import pytest

import mic
from mic.options import app

#: The function of a command whose name is that of a package.
ELSEWHERE = {"report": "write_report"}
SERVICES = {"serve"}  # run until they are stopped


def commands():
    return {one.name or one.callback.__name__ for one in app.registered_commands} - SERVICES


def test_commands_and_public_functions_correspond():
    for name in commands():
        found = getattr(mic, name)
        found = getattr(found, ELSEWHERE[name]) if name in ELSEWHERE else found
        assert inspect.isfunction(found), name
        assert inspect.getdoc(found), name
        assert name in mic.__all__ or name in ELSEWHERE, name
    functions = {name for name in mic.__all__ if inspect.isfunction(getattr(mic, name))}
    assert functions - {"cache_folder", "load_scene", "read_run", "reduce"} == commands() - {*ELSEWHERE}


@pytest.mark.parametrize(
    "name", ["contributors", "explain", "explore", "friction", "order", "predict", "rare", "remedy", "sensitivity"]
)
def test_studies_take_the_model_first_and_the_law_by_name(name):
    parameters = list(inspect.signature(getattr(mic, name)).parameters.values())
    assert parameters[0].name == "model"
    law = next(one for one in parameters if one.name == "law")
    assert law.default is None, "a law that is not named is the scene's"
