"""The service of assemblies: answers, refusals, its log and its workers; drift of what comes in."""

import asyncio
import http.client
import json
import multiprocessing
import os
import signal
import socket
import sys
import time
from contextlib import suppress
from functools import partial
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from support.requests_of_applications import request, running
from support.springs import PULL, at_face, dragged
from typer.testing import CliRunner

from mic.deployment import application as interface
from mic.deployment import assembly_log, server
from mic.deployment.application import LARGEST, application
from mic.deployment.assembly_log import AssemblyLog
from mic.deployment.server import read_token
from mic.deployment.service import ScanFolder, Service, predict_assembly
from mic.errors import ArgumentError, FormatError, SceneError, StorageError
from mic.execution.local import Local
from mic.options import app as commands
from mic.statistics.draw import draw
from mic.studies.adjustable import Adjustable
from mic.studies.adjustment import with_adjustments
from mic.studies.drift import drifts
from mic.studies.prediction import Predictor
from mic.studies.scan import ScannedAssembly
from mic.system.files import read_line
from mic.system.port import HOST, check_port

TOKEN = "a token of these tests".replace(" ", "-")
GOOD = {"id": "car-1", "deviations": {"P": 0.9}}


@pytest.fixture(scope="module")
def predictor():
    return Predictor(dragged(), exact=True)


@pytest.fixture
def make(predictor, tmp_path):
    """Makes applications on one log; `work` replaces the prediction, `workers`, `queue` and `seconds` as given."""

    def application_of(work=None, workers=1, queue=10, seconds=5.0, settings=()):
        log = partial(AssemblyLog, tmp_path / "log.jsonl")
        service = Service(predictor, log, Local(workers), dict(settings), queue, seconds, work)
        return application(service, TOKEN, seconds), service

    return application_of


def answer_of(content, verdict="accepted"):
    """An answer without a prediction."""
    certificate = {"method": "none"}
    empty = {"reason": "", "adjustments": [], "characteristics": [], "certificate": certificate, "distance": 0.0}
    return {"verdict": verdict, "deviations": content["deviations"], "seconds": 0.0, **empty}


def play(app, scenario):
    """Run a scenario with requests to an application."""

    async def run():
        async with running(app):
            return await scenario(partial(request, app, token=TOKEN))

    return asyncio.run(run())


def records(path):
    return [read_line(line) for line in path.read_bytes().splitlines()]


def test_an_answer_is_the_prediction_and_the_log_has_it_with_model_and_version(make, predictor, tmp_path):
    app, service = make()

    async def scenario(ask):
        first = await ask("POST", "/assemblies", GOOD)
        again = await ask("POST", "/assemblies", GOOD)
        other = await ask("POST", "/assemblies", GOOD | {"deviations": {"P": 0.8}})
        return first, again, other, await ask("GET", "/assemblies/car-1"), await ask("GET", "/assemblies/car-2")

    first, again, other, later, unknown = play(app, scenario)
    assert first[0] == 200 and again == first == later and (other[0], unknown[0]) == (409, 404)
    expected = predictor.predict(GOOD["deviations"])
    values = {row["name"]: row["value"] for row in first[1]["characteristics"]}
    assert values == dict(expected.iloc[:-1].set_index("measurement")["value"])
    assert first[1]["verdict"] == expected["verdict"].iloc[-1]
    assert first[1]["certificate"]["residual"] <= first[1]["certificate"]["tolerance"]
    logged = records(tmp_path / "log.jsonl")
    assert [(one["event"], one["id"]) for one in logged] == [("request", "car-1"), ("answer", "car-1")]
    assert logged[0]["content"] == {"deviations": {"P": 0.9}}
    assert logged[1]["answer"]["verdict"] == first[1]["verdict"]
    for record in (*(one["service"] for one in logged), first[1]):
        assert (record["model"], record["version"]) == (service.description["model"], service.description["version"])


def test_adjustments_are_given_one_by_one_with_the_values_that_they_lead_to():
    limits = (("b", "M", 0.0, 0.036), ("t", "N", PULL - 9, PULL + 9))
    model = dragged(measurements=[at_face(part, (1, 0, 0), name=n, lower=a, upper=b) for part, n, a, b in limits])
    predictor = Predictor(model, None, Adjustable(["bl2", "tl1"], shim=0.4), exact=True)
    found = predict_assembly(predictor, {"deviations": {"P": 0.96 + 0.0451, "D": PULL}})
    assert found["verdict"] == "rejected" and found["adjustments"]
    assert {(one["name"], one["unit"]) for one in found["adjustments"]} <= {
        ("locators.bl2", "mm"),
        ("locators.tl1", "mm"),
    }
    first = found["characteristics"][0]
    assert first["value"] > 0.036 >= first["adjusted"]
    assert found["certificate"]["adjusted_residual"] <= found["certificate"]["tolerance"]
    changes = {one["name"]: one["change"] for one in found["adjustments"]}
    varied, names = with_adjustments(model, list(predictor.proposal.changes))
    x = {"P": 0.96 + 0.0451, "D": PULL} | dict(zip(names, changes.values()))
    assert varied.evaluate(x).measurements[0][0] == pytest.approx(first["adjusted"], abs=1e-9)
    rest = {"id": "1", "drift": [], "model": "", "version": "", "seconds": 0.0}
    assert interface.Answer.model_validate(found | rest).adjustments[0].change == found["adjustments"][0]["change"]


BAD = [
    (b"{", 400, "the body is no JSON"),
    (b"[" * 100_000, 400, "body"),
    (b'{"deviations": {"P": NaN}}', 422, "deviations.P: Input should be a finite number"),
    (b'{"deviations": {"P": 1e999}}', 422, "finite"),
    (b'{"deviations": {"P": %s}}' % (b"9" * 5000), 400, "body"),
    (b'{"deviations": {"P": "1"}}', 422, "valid number"),
    (b'{"deviations": {"P": true}}', 422, "valid number"),
    (b'{"deviations": {"P": 1, "P": 2}}', 400, "'P' occurs twice"),
    (b'{"deviations": {"p": 1}}', 422, "did you mean 'P'?"),
    (b'{"deviations": {"P": 1e300}}', 422, "at most"),
    (b'{"deviations": {}}', 422, "give deviations, or a scan"),
    (b'{"scan": "car-1"}', 422, "scan: the service has no scans; start it with --scans FOLDER"),
    (b'{"scan": "../car-1/.."}', 422, "scan"),
    (b'{"deviations": {}, "shim": 1}', 422, "shim: Extra inputs"),
    (b'{"id": "a b", "deviations": {}}', 422, "id: String should match"),
    (b'{"id": "\\ud800", "deviations": {}}', 422, "id: "),
    (b"\xff\xfe", 400, "body"),
    (b"null", 422, "body"),
    (b"", 422, "body"),
]


def test_malformed_requests_are_refused_in_one_sentence_and_leave_no_trace(make, tmp_path):
    app, _ = make(answer_of)

    async def scenario(ask):
        refused = [await ask("POST", "/assemblies", body) for body, *_ in BAD]
        refused.append(await ask("POST", "/assemblies", GOOD, content="text/plain"))
        return refused, await ask("GET", "/metrics"), await ask("POST", "/assemblies", GOOD)

    refused, metrics, good = play(app, scenario)
    for (body, status, words), found in zip([*BAD, (b"text", 415, "send JSON")], refused):
        assert found[0] == status and words in found[1]["detail"], (body[:50], found)
        assert len(found[1]["detail"]) < 400
    assert good[0] == 200 and 'mic_refused_requests_total{status="415"} 1' in metrics[1]
    assert len(records(tmp_path / "log.jsonl")) == 2


def test_a_scan_becomes_deviations_and_stated_ones_replace_its_own(predictor, tmp_path):
    """The reader finds what its file says, with a variance of 1e-4."""

    def read(files, serial):
        value = float(files["b"].read_text())
        return ScannedAssembly({"P": value, "D": PULL}, 1e-4 * np.eye(2), 0.0, pd.DataFrame(), (f"seen: {serial}",))

    (tmp_path / "b-7.csv").write_text("0.9")
    scans = ScanFolder(SimpleNamespace(model=predictor.model, read=read), tmp_path)
    content = {"deviations": {}, **scans.content("7")}
    found = predict_assembly(predictor, content, scans)
    assert found["deviations"] == {"P": 0.9, "D": PULL} and found["messages"] == ["seen: 7"]
    width = [one["high"] - one["low"] for one in found["characteristics"]]
    stated = predict_assembly(predictor, content | {"deviations": {"D": PULL + 0.01}}, scans)
    assert stated["deviations"] == {"P": 0.9, "D": PULL + 0.01}
    assert width[1] > 0.03 and stated["characteristics"][1]["high"] == stated["characteristics"][1]["low"]
    (tmp_path / "b-7.csv").write_text("0.8")
    with pytest.raises(SceneError, match="the files of 7 have changed since the request"):
        predict_assembly(predictor, content, scans)
    with pytest.raises(ArgumentError, match="the folder of the scans has none of 8"):
        scans.content("8")


def test_every_path_but_the_health_needs_the_token(make):
    app, _ = make(answer_of)
    paths = [("POST", "/assemblies"), ("GET", "/assemblies/car-1"), ("GET", "/model"), ("GET", "/metrics")]

    async def scenario(ask):
        for token in ("", TOKEN[:-1], TOKEN + "x", "ä"):
            found = [await ask(method, path, GOOD, token=token) for method, path in paths]
            assert {status for status, _ in found} == {401}
        return await ask("GET", "/health", token=""), await ask("GET", "/model")

    health, model = play(app, scenario)
    assert health == (200, {"status": "ok", "workers": 1, "waiting": 0})
    assert [item["name"] for item in model[1]["deviations"]] == ["P", "D"]


def test_large_and_slow_bodies_are_refused(make, monkeypatch):
    monkeypatch.setattr(interface, "BODY_SECONDS", 0.4)
    app, _ = make(answer_of)

    async def scenario(ask):
        large = await ask("POST", "/assemblies", b" " * (LARGEST + 1))
        streamed = await ask("POST", "/assemblies", pieces=[(b" " * (LARGEST // 4), 0.0)] * 5)
        return large, streamed, await ask("POST", "/assemblies", pieces=[(b"{", 0.3), (b" ", 0.3), (b"}", 0.3)])

    assert [status for status, _ in play(app, scenario)] == [413, 413, 408]


def slow(content):
    time.sleep(0.5)
    return answer_of(content)


def test_a_full_queue_refuses_and_a_late_answer_can_be_fetched(make):
    app, service = make(slow, queue=1, seconds=0.8)

    async def scenario(ask):
        ids = [f"car-{i}" for i in range(3)]
        found = await asyncio.gather(*(ask("POST", "/assemblies", GOOD | {"id": one}) for one in ids))
        by_status = {status: one for one, (status, _) in zip(ids, found)}
        waiting = await ask("GET", f"/assemblies/{by_status[504]}")
        while service.waiting:
            await asyncio.sleep(0.02)
        return by_status, waiting, [await ask("GET", f"/assemblies/{by_status[status]}") for status in (504, 503)]

    by_status, waiting, (late, refused) = play(app, scenario)
    assert sorted(by_status) == [200, 503, 504] and waiting[0] == 202
    assert late[0] == 200 and late[1]["verdict"] == "accepted" and refused[0] == 404


def test_workers_that_die_or_hang_are_replaced_and_cost_only_their_assembly(make, tmp_path):
    once = tmp_path / "once"

    def work(content):
        case = content["deviations"]["P"]
        if case == 1 and not once.exists():
            once.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if case == 2:
            os._exit(0)
        if case == 3:
            time.sleep(60)
        if case == 4:
            raise ZeroDivisionError("by zero")
        return answer_of(content)

    app, _ = make(work, workers=2, seconds=0.3)

    async def scenario(ask):
        bodies = [{"id": f"car-{p}", "deviations": {"P": p}} for p in range(5)]
        await asyncio.gather(*(ask("POST", "/assemblies", body) for body in bodies))
        await asyncio.sleep(0.5)
        return [(await ask("GET", f"/assemblies/car-{p}"))[1] for p in range(5)], await ask("GET", "/health")

    found, health = play(app, scenario)
    assert [one["verdict"] for one in found] == ["accepted", "accepted", "failed", "failed", "failed"]
    for one, words in zip(found[2:], ("the worker process was killed", "no result after 0.3 s", "by zero")):
        assert words in one["reason"]
    assert health[0] == 200


def test_requests_that_a_kill_interrupted_are_answered_at_the_next_start(make, predictor, tmp_path):
    path = tmp_path / "log.jsonl"
    _, killed = make(answer_of)
    for number in range(3):
        killed.log.add_request(f"car-{number}", {"deviations": {"P": 0.9 + 0.01 * number}})
    killed.log.add_answer("car-1", answer_of({"deviations": {"P": 0.91}}, "open"))
    asyncio.run(killed.stop())
    with path.open("ab") as file:
        file.write(b'{"event": "request", "id": "car-3"')  # killed while it wrote
    _, other = make(answer_of, settings={"error": 1.0})
    assert not other.log.known  # other settings give other answers
    asyncio.run(other.stop())
    app, service = make()
    assert service.log.pending == ["car-0", "car-2"] and service.log.damaged == 1

    async def scenario(ask):
        while service.waiting:
            await asyncio.sleep(0.01)
        fetched = [await ask("GET", f"/assemblies/car-{n}") for n in range(4)]
        return fetched, await ask("POST", "/assemblies", GOOD | {"id": "car-3"})

    fetched, after = play(app, scenario)
    assert [status for status, _ in fetched] == [200, 200, 200, 404] and after[0] == 200
    assert fetched[1][1]["verdict"] == "open"
    assert (
        fetched[2][1]["characteristics"] == predict_assembly(predictor, {"deviations": {"P": 0.92}})["characteristics"]
    )
    assert [record is None for record in records(path)].count(True) == 1 and records(path)[-1]["id"] == "car-3"


def test_nothing_is_answered_that_cannot_be_logged(make, monkeypatch, tmp_path):
    app, service = make(answer_of)
    append, full = assembly_log.append_text, {"request": False, "answer": False}

    def refuse(path, text):
        if full[json.loads(text)["event"]]:
            raise StorageError(f"{path}: cannot be written (no space left on device)")
        append(path, text)

    monkeypatch.setattr(assembly_log, "append_text", refuse)
    monkeypatch.setattr("mic.deployment.service.RETRY_DELAY", 0.02)

    async def scenario(ask):
        full["request"] = True
        refused = await ask("POST", "/assemblies", GOOD), await ask("GET", "/health")
        full.update(request=False, answer=True)
        asked = asyncio.create_task(ask("POST", "/assemblies", GOOD))
        await asyncio.sleep(0.15)
        held = asked.done(), await ask("GET", "/health")
        full["answer"] = False
        return refused, held, await asked, await ask("GET", "/health")

    refused, held, answered, health = play(app, scenario)
    assert refused[0][0] == 507 and "no space left" in refused[0][1]["detail"] and refused[1][0] == 503
    assert held[0] is False and held[1][0] == 503
    assert answered[0] == health[0] == 200
    assert [record["event"] for record in records(tmp_path / "log.jsonl")] == ["request", "answer"]


def test_clients_that_send_no_request_do_not_keep_others_out(predictor, tmp_path, monkeypatch):
    """Each of them sends a line of a header now and then."""
    monkeypatch.setattr(server, "IDLE", 0.4)
    monkeypatch.setattr(server, "CONNECTIONS", 4)
    port = check_port(0)

    def run():
        log = partial(AssemblyLog, tmp_path / "log.jsonl")
        server.serve(Service(predictor, log, Local(1), {}, 5, 5.0, answer_of), TOKEN, HOST, port, 5.0)

    def status():
        try:
            connection = http.client.HTTPConnection(HOST, port, timeout=10)
            connection.request("GET", "/health")
            return connection.getresponse().status
        except OSError:
            return 0
        finally:
            connection.close()

    process = multiprocessing.get_context("fork").Process(target=run)
    process.start()
    wait_for(lambda: status() == 200)
    idle = [socket.create_connection((HOST, port)) for _ in range(4)]
    for one in idle:
        one.sendall(b"POST /assemblies HTTP/1.1\r\n")
    wait_for(lambda: status() == 503)

    def patient():
        for one in idle:
            with suppress(OSError):
                one.sendall(b"a: b\r\n")
        return status() == 200

    wait_for(patient)
    process.terminate()
    process.join(20)
    assert process.exitcode is not None


def wait_for(condition, seconds=20.0):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "this has not come"
        time.sleep(0.02)


def test_the_command_does_not_touch_a_file_that_is_no_log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "model.npz"
    dragged().save(path)
    content = path.read_bytes()
    result = CliRunner().invoke(commands, ["serve", "model.npz", "--log", "model.npz", "--port", "0"])
    assert "this is no log of assemblies" in str(result.exception) and path.read_bytes() == content
    result = CliRunner().invoke(commands, ["serve", "model.npz", "--log", ".", "--port", "0"])
    assert "is a directory" in str(result.exception)


def test_the_token_is_made_once_and_a_short_one_is_refused(tmp_path):
    path = tmp_path / "token"
    token = read_token(path)
    assert read_token(path) == token and len(token) > 30 and path.stat().st_mode & 0o077 == 0
    for text in ("short", "two words of a text", "ä" * 20):
        path.write_text(text)
        with pytest.raises(FormatError, match="holds no token of at least 16 characters"):
            read_token(path)


@pytest.mark.parametrize("library, arguments", [("fastapi", ["serve"]), ("pythonfmu3", ["export", "--fmu", "a.fmu"])])
def test_a_missing_library_is_named_with_the_command_that_installs_it(library, arguments, monkeypatch, tmp_path):
    for name in ("application", "fmi_unit", "server"):
        monkeypatch.delitem(sys.modules, f"mic.deployment.{name}", raising=False)
    monkeypatch.setitem(sys.modules, library, None)
    dragged().save(tmp_path / "model.npz")
    monkeypatch.chdir(tmp_path)
    command, *options = arguments
    result = CliRunner().invoke(commands, [command, "model.npz", *options])
    extra = {"fastapi": "serve", "pythonfmu3": "fmu"}[library]
    assert f"pip install 'mic-contact[{extra}]'" in str(result.exception) and library in str(result.exception)


# -------------------------------------------------------------------------------------------------------- drift


def test_drift_of_mean_and_spread_is_reported_soon_and_without_false_alarms():
    scene = dragged().scene
    names = [item.name for item in scene.deviations]
    rows = [dict(zip(names, map(float, x))) for x in draw(scene, 3, 0, 600)]
    assert not any(drifts(scene, rows[max(0, n - 200) : n]) for n in range(0, 600, 7))
    item = scene.deviations[0]
    shifted = [row | {item.name: row[item.name] + 2 * item.sigma} for row in rows[:20]]
    (found,) = drifts(scene, rows[:180] + shifted)
    assert found.startswith(f"{item.name}: the mean of the last") and "from the scene's" in found
    spread = [row | {item.name: item.mean + 3 * (row[item.name] - item.mean)} for row in rows[:40]]
    (found,) = drifts(scene, spread)
    assert "the standard deviation of the last 40 assemblies is" in found and "times the scene's" in found
    assert drifts(scene, [{"D": PULL}] * 5) == []


def test_predictions_of_a_file_report_its_drift(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = dragged()
    model.save(tmp_path / "model.npz")
    item = model.scene.deviations[0]
    rows = [f"{item.mean + 2.5 * item.sigma + 0.01 * item.sigma * (n % 7 - 3)}" for n in range(20)]
    (tmp_path / "parts.csv").write_text("\n".join([item.name, *rows]) + "\n")
    result = CliRunner().invoke(commands, ["predict", "model.npz", "--parts", "parts.csv", "--exact"])
    assert result.exit_code == 0, result.exception
    assert f"drift: {item.name}: the mean of the last 20 assemblies is" in result.output


def test_the_service_reports_drift_after_a_restart(make, predictor):
    item = predictor.model.scene.deviations[0]
    far = {"deviations": {item.name: item.mean + 2.5 * item.sigma}}
    _, before = make(answer_of)
    for number in range(25):
        before.log.add_request(f"car-{number}", far)
        before.log.add_answer(f"car-{number}", answer_of(far))
    asyncio.run(before.stop())
    app, _ = make(answer_of)
    found = play(app, lambda ask: ask("POST", "/assemblies", far | {"id": "last"}))[1]
    assert [sentence.split(":")[0] for sentence in found["drift"]] == [item.name]
    assert np.isfinite(found["seconds"])
