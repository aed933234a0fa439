"""The service as a process that is killed under load, and the FMI unit as a library loads it."""

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from support.springs import dragged
from typer.testing import CliRunner

from mic.options import app
from mic.studies.adjustment import adjustments, with_adjustments
from mic.system.files import read_line

CARS, CLIENTS = 60, 12


class ServiceProcess:
    """``mic serve`` in a folder with model.npz."""

    def __init__(self, folder):
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        command = [sys.executable, "-m", "mic", "serve", "model.npz", "--exact", "--port", str(self.port)]
        self.folder = folder
        self.process = subprocess.Popen(
            [*command, "--engine", "local:2"], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        until = time.monotonic() + 120
        while time.monotonic() < until and self.process.poll() is None:
            try:
                self.ask("GET", "/health")
                return
            except OSError:
                time.sleep(0.05)
        raise RuntimeError(self.process.communicate()[0])

    def ask(self, method, path, body=None):
        """Status and content of the answer."""
        token = (self.folder / "serve.token").read_text().strip()
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
        connection.request(method, path, json.dumps(body), headers)
        response = connection.getresponse()
        found = response.status, json.loads(response.read())
        connection.close()
        return found


@pytest.mark.slow(8)
@pytest.mark.robustness
def test_a_service_killed_under_load_loses_no_assembly_and_repeats_its_answers(tmp_path):
    dragged().save(tmp_path / "model.npz")
    service, answers = ServiceProcess(tmp_path), {}

    def client(first):
        for car in range(first, CARS, CLIENTS):
            body = {"id": f"car-{car}", "deviations": {"P": 0.8 + 0.001 * car}}
            try:
                answers[car] = service.ask("POST", "/assemblies", body)
            except (OSError, http.client.HTTPException):
                return

    clients = [threading.Thread(target=client, args=(first,)) for first in range(CLIENTS)]
    for one in clients:
        one.start()
    while len(answers) < CARS // 4:
        time.sleep(0.002)
    service.process.kill()
    for one in clients:
        one.join()
    assert CARS // 4 <= len(answers) < CARS and {status for status, _ in answers.values()} == {200}
    logged = [read_line(line) for line in (tmp_path / "assemblies.jsonl").read_bytes().splitlines()]
    requested = {record["id"] for record in logged if record["event"] == "request"}
    answered = {record["id"] for record in logged if record["event"] == "answer"}
    assert {f"car-{car}" for car in answers} <= answered <= requested
    service = ServiceProcess(tmp_path)
    until = time.monotonic() + 60
    while service.ask("GET", "/health")[1]["waiting"] and time.monotonic() < until:
        time.sleep(0.02)
    found = {name: service.ask("GET", f"/assemblies/{name}") for name in requested}
    assert {status for status, _ in found.values()} == {200}
    for car, (_, answer) in answers.items():
        assert found[f"car-{car}"][1] | {"drift": answer["drift"]} == answer
    held = socket.create_connection(("127.0.0.1", service.port))
    service.process.send_signal(signal.SIGTERM)
    output = service.process.communicate(timeout=60)[0]
    held.close()
    assert service.process.returncode == 0 and f"Stopped: {len(requested - answered)} assemblies" in output, output


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    """The unit of a model, unpacked, and its description."""
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    pytest.importorskip("pythonfmu3", reason="PythonFMU3 is not installed")
    folder = tmp_path_factory.mktemp("unit")
    dragged().save(folder / "model.npz")
    path = folder / "two sheets.fmu"
    result = CliRunner().invoke(app, ["export", str(folder / "model.npz"), "--fmu", str(path)])
    assert result.exit_code == 0 and "outputs" in result.output, result.exception
    (folder / "model.npz").unlink()  # the unit contains it
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(path)) == []
    return fmpy.read_model_description(str(path)), fmpy.extract(str(path))


@pytest.fixture
def instance(unit):
    from fmpy.fmi3 import FMU3Slave

    description, folder = unit
    identifier = description.coSimulation.modelIdentifier
    token = getattr(description, "instantiationToken", None) or description.guid  # by the version of FMPy
    found = FMU3Slave(guid=token, unzipDirectory=folder, modelIdentifier=identifier, instanceName="unit")
    found.instantiate()
    found.enterInitializationMode()
    found.exitInitializationMode()
    yield found
    found.terminate()
    found.freeInstance()


@pytest.mark.slow(2)
def test_a_unit_gives_the_digits_of_its_model_with_and_without_adjustments(unit, instance):
    model = dragged()
    available = adjustments(model)
    varied, names = with_adjustments(model, available)
    reference = {variable.name: variable.valueReference for variable in unit[0].modelVariables}
    outputs = [reference[item.name] for item in model.scene.measurements]
    assert instance.getFloat64(outputs) == model.evaluate({}).measurements[0].tolist()
    for step, (x, change) in enumerate(((0.9, 0.0), (1.1, 0.0), (1.1, 0.2))):
        instance.setFloat64([reference["P"], reference[available[0].name]], [x, change])
        instance.doStep(float(step), 1.0)
        expected = varied.evaluate({"P": x, names[0]: change}).measurements[0].tolist()
        assert instance.getFloat64(outputs) == expected


@pytest.mark.slow(2)
def test_inputs_have_units_and_bounds_beyond_which_a_step_is_discarded(unit, instance):
    model, (description, _) = dragged(), unit
    variables = {variable.name: variable for variable in description.modelVariables}
    for item in model.scene.deviations:
        variable = variables[item.name]
        assert variable.causality == "input" and float(variable.start) == item.mean and variable.unit == "mm"
        bounds = float(variable.min), float(variable.max)
        assert bounds == pytest.approx((item.mean - 6 * item.sigma, item.mean + 6 * item.sigma), rel=1e-15)
    available = adjustments(model)
    assert [(float(variables[item.name].min), variables[item.name].unit) for item in available] == [
        (item.low, item.unit) for item in available
    ]
    item, outputs = model.scene.deviations[0], [variables[one.name].valueReference for one in model.scene.measurements]
    for bad in (item.mean + 6.1 * item.sigma, float("nan")):
        instance.setFloat64([variables[item.name].valueReference], [bad])
        with pytest.raises(Exception, match="discard"):
            instance.doStep(0.0, 1.0)
        assert np.isnan(instance.getFloat64(outputs)).all()
    instance.setFloat64([variables[item.name].valueReference], [item.mean])
    instance.doStep(0.0, 1.0)
    assert instance.getFloat64(outputs) == model.evaluate({}).measurements[0].tolist()


def test_the_name_of_a_unit_is_checked_before_it_is_written(tmp_path):
    dragged().save(tmp_path / "model.npz")
    result = CliRunner().invoke(app, ["export", str(tmp_path / "model.npz"), "--fmu", str(tmp_path / "unit.zip")])
    assert "the name of a unit ends with .fmu" in str(result.exception) and os.listdir(tmp_path) == ["model.npz"]
