"""The page of ``mic explore`` in a headless browser, who may see it, and what is drawn of an assembly."""

import http.client
import json
import shutil
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from support.attack_explorer import ATTACKS, Served, Socket, bombard
from support.springs import dragged
from typer.testing import CliRunner

import mic
from mic.compliance import provider
from mic.errors import FormatError
from mic.explorer.positions import AssemblyPositions
from mic.explorer.shapes import PartShape, Shapes, shapes_path
from mic.model.assembly import assemble
from mic.options import app
from mic.scene.measured_report import read_measured_report

CHROMIUM = ("chromium", "chromedriver")
ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --enable-unsafe-swiftshader --window-size=1280,800"
)


# ------------------------------------------------------------------------------------------------ what is drawn


@pytest.fixture(scope="module")
def exploration():
    return mic.explore(dragged())


def square(name, lift=0.0):
    """A plate that each force on it lifts as a whole, and that moves as a rigid body."""
    points = np.array([[0.0, 0, lift], [10, 0, lift], [10, 10, lift], [0, 10, lift]])
    rigid = np.zeros((4, 3, 6))
    rigid[:, :, :3] = np.eye(3)
    rigid[:, :, 3:] = [np.cross(np.eye(3), p).T for p in points]
    return points, np.array([[0, 1, 2], [0, 2, 3]]), rigid


def test_parts_are_drawn_where_forces_and_motions_take_them(exploration):
    """A millionth of a force lifts b; t goes along with its clamp by D."""
    model = exploration.model
    parts = []
    for name in "bt":
        points, triangles, rigid = square(name)
        basis = np.zeros((2, 4, 3), dtype=np.float32)
        basis[1, :, 2] = 0.5
        parts.append(PartShape(name, points, triangles, basis, rigid, np.array([2, 0])))
    positions, answer = AssemblyPositions(exploration, Shapes(tuple(parts), "")), exploration.answer({"D": 2.1})
    placed, nominal = positions.of(answer, 10.0), positions.of(answer, 0.0)
    force = answer.evaluation.functional_force[0]
    for p, rows in enumerate(model.compliance.functionals):
        q = answer.evaluation.motion[0][6 * p : 6 * p + 6]
        turned = np.array([q[:3] + np.cross(q[3:], x) for x in parts[p].points])
        turned[:, 2] += 0.5 * force[rows][0]
        np.testing.assert_allclose(placed.parts[p], parts[p].points + 10 * turned, atol=1e-5)
        np.testing.assert_array_equal(nominal.parts[p], parts[p].points)
    assert np.abs(placed.contacts - nominal.contacts).max() == pytest.approx(10 * 0.5 * (2.1 + 0.03), rel=1e-6)


def test_without_shapes_measured_points_move_by_their_values_with_a_note(exploration):
    positions, answer = AssemblyPositions(exploration, Shapes()), exploration.answer({"D": 2.1})
    moved = positions.of(answer, 4.0).measured - positions.of(answer, 0.0).measured
    np.testing.assert_allclose(moved, [[4 * 0.03, 0, 0], [4 * 2.1, 0, 0]], rtol=1e-6)
    assert "only contacts and measured points are displayed" in positions.shapes.note
    usual = positions.default_magnification(answer)
    assert float(f"{usual:.0e}") == usual and usual >= 1


def test_cached_shapes_belong_to_one_model(exploration, tmp_path):
    points, triangles, rigid = square("b")
    shapes = Shapes((PartShape("b", points, triangles, np.ones((2, 4, 3), np.float32), rigid, np.arange(2)),), "")
    path = shapes_path(tmp_path / "model.npz")
    shapes.save(path, exploration.scene_model)
    again = Shapes.load(path, exploration.scene_model)
    assert path.name == "model.shapes.npz" and again.note == "" and again.parts[0].name == "b"
    for key in ("points", "triangles", "basis", "rigid", "acting"):
        np.testing.assert_array_equal(getattr(again.parts[0], key), getattr(shapes.parts[0], key))
    with pytest.raises(FormatError, match="belong to another model; write it again"):
        Shapes.load(path, dragged(measurements=[]))
    exploration.scene_model.save(path)
    with pytest.raises(FormatError, match="no set of drawn shapes"):
        Shapes.load(path, exploration.scene_model)


@pytest.mark.slow
@pytest.mark.fem
def test_a_shape_is_the_field_of_the_finite_elements(lap_model, lap_scene, cache):
    parts = assemble(lap_scene, cache).parts
    shapes = Shapes.of(lap_model, parts, cache)
    again = Shapes.of(lap_model, parts, cache, lambda line: pytest.fail("it was kept"))
    found = lap_model.evaluate({})
    reads_only = set(lap_model.rows["measurement"].indices) - set(lap_model.rows["contact"].indices)
    starts = [rows.start for rows in lap_model.compliance.functionals]
    acting = np.concatenate([start + one.acting for start, one in zip(starts, again.parts)])
    assert not reads_only & set(acting.tolist()) and len(acting) < lap_model.compliance.size
    assert not np.delete(found.functional_force[0], acting).any()
    moved = again.displaced(lap_model, found.functional_force[0], found.motion[0])
    part, rows, modes = parts[1], lap_model.compliance.functionals[1], lap_model.compliance.motions[1]
    solved, rigid = provider.find(part).field(part, found.functional_force[0][rows, None])
    whole = solved[:, :3, 0] + rigid[:, :3] @ found.motion[0][modes]
    assert shapes.note == "" and len(shapes.parts[1].points) == len(whole)
    np.testing.assert_allclose(moved[1], whole, atol=2e-5 * np.abs(whole).max())


# ------------------------------------------------------------------------------------------------ the command


def test_a_library_that_is_missing_is_named_with_its_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trame_vtk.widgets", None)
    monkeypatch.setitem(sys.modules, "trame.app", None)
    monkeypatch.delitem(sys.modules, "mic.explorer.page", raising=False)
    done = CliRunner().invoke(app, ["explore", str(tmp_path)])
    assert done.exit_code != 0 and "pip install 'mic-contact[explore]'" in str(done.exception)


@pytest.fixture(scope="module")
def served(lap_model, tmp_path_factory):
    """The lap joint's page, where there are no finite elements; at the end the program was ended by Ctrl-C."""
    pytest.importorskip("trame_vtk")
    folder = tmp_path_factory.mktemp("explored")
    lap_model.save(folder / "model.npz")
    served = Served(folder / "model.npz", "--keep", "kept.npz")
    yield served
    code, said, wrong = served.stop()
    assert code == 0 and said == "Stopped.\n" and wrong == ""


def status(served, path=None, **headers):
    connection = http.client.HTTPConnection(served.host, timeout=30)
    connection.request("GET", path or served.path, headers=headers)
    answer = connection.getresponse()
    found = answer.status, answer.read().decode(errors="replace"), answer.headers
    connection.close()
    return found


@pytest.mark.slow
def test_the_page_is_served_to_nobody_else(served):
    token = served.path.partition("token=")[2]
    whole, text, headers = status(served)
    assert whole == 200 and "trame" in text and served.host.startswith("127.0.0.1:")
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    cookie = headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie and token in cookie
    assert status(served, "/vue.global.js", Cookie=cookie.partition(";")[0])[0] == 200
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    upgrade |= {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    port = served.host.partition(":")[2]
    refused = [
        status(served, "/index.html"),
        status(served, "/vue.global.js"),
        status(served, f"/index.html?token={token[:-1]}"),
        status(served, "/ws", **upgrade),
        status(served, Host=f"assemblies.example:{port}"),
        status(served, Host="127.0.0.1"),
        status(served, Origin="http://assemblies.example"),
        status(served, f"/ws?token={token}", Origin="http://assemblies.example", **upgrade),
    ]
    assert [code for code, _, _ in refused] == [403] * len(refused)
    assert all(text.startswith("refused: ") and headers["Set-Cookie"] is None for _, text, headers in refused)
    code, text, headers = status(served, f"/ws?token={token}")
    assert code == 426 and headers["Upgrade"] == "websocket" and text == "refused: this address is a web socket\n"


@pytest.mark.slow
def test_no_client_disturbs_the_page(served):
    """Requests, sockets and messages that the page does not send: nothing is printed, changed or delayed."""
    assert bombard(np.random.default_rng(40), served, list(ATTACKS)) == []


@pytest.mark.slow
def test_a_value_out_of_range_is_refused_in_one_sentence_and_changes_nothing(served, lap_model):
    exploration = mic.explore(lap_model)
    control = exploration.controls[0]
    values = [one.now for one in exploration.controls]
    with Socket(served) as client:
        client.call("trame.trigger", "reset", [], {})
        for value, words in [
            (control.high + 1, f"{control.name}: {control.high + 1:g} is outside {control.low:g} … {control.high:g}"),
            (float("nan"), f"{control.name}: nan is outside"),
            (control.now, ""),
        ]:
            client.call("trame.state.update", [{"key": "entries", "value": [value, *values[1:]]}])
            state = client.state()
            assert state["entries"] == values and bool(state["refused"]) == bool(words)
            assert state["refused"].startswith(words)
        client.call("trame.state.update", [{"key": "magnification", "value": -1}])
        state = client.state()
        assert state["magnification"] >= 1 and state["refused"] == "The magnification -1 is outside 0 … 1e+09."
        slightly = control.high + 1e-4 * (control.high - control.low)  # as a slider rounds its end
        client.call("trame.state.update", [{"key": "entries", "value": [slightly, *values[1:]]}])
        assert client.state()["entries"] == [control.high, *values[1:]]
        client.call("trame.trigger", "reset", [], {})


@pytest.mark.slow
def test_cached_shapes_are_read_again_and_a_port_in_use_is_refused(served, lap_model):
    kept = mic.ReducedModel.load(served.folder / "kept.npz")
    assert kept.parameters == lap_model.parameters
    assert Shapes.load(shapes_path(served.folder / "kept.npz"), kept).parts == ()
    port = served.host.partition(":")[2]
    done = CliRunner().invoke(app, ["explore", str(served.folder / "model.npz"), "--port", port])
    assert done.exit_code != 0
    assert str(done.exception) == f"--port {port}: this port is in use; use another, or omit --port for a free one"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """Debian's chromium, closed off from the network by the page's own policy and its own switches."""
    selenium = pytest.importorskip("selenium.webdriver")
    chromium, driver = (shutil.which(name) for name in CHROMIUM)
    if not (chromium and driver):
        pytest.skip("needs chromium and chromium-driver")
    options = selenium.ChromeOptions()
    options.binary_location = chromium
    for argument in (*ARGUMENTS.split(), f"--user-data-dir={tmp_path_factory.mktemp('browser')}"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"performance": "ALL"})
    own = selenium.Chrome(options=options, service=selenium.ChromeService(driver))
    yield own
    own.quit()


class Seen:
    """The page as a user sees it."""

    def __init__(self, browser):
        self.browser = browser

    def __call__(self, name):
        return self.browser.find_element("id", name)

    def until(self, true, what):
        end = time.monotonic() + 60
        while time.monotonic() < end:
            if true():
                return
            time.sleep(0.05)
        raise AssertionError(f"{what} did not come")

    def final(self, act):
        """Do something that moves the assembly, and wait for what is not preliminary."""
        before = int(self("answered").get_attribute("textContent"))
        act()
        count = lambda: int(self("answered").get_attribute("textContent"))
        self.until(lambda: count() > before and "early" not in self("certificate").get_attribute("class"), "an answer")
        return float(self("value-of-M1").get_attribute("title").split()[0])

    def input(self, i):
        return float(self(f"value-{i}").get_property("value"))


@pytest.mark.slow
def test_numbers_on_the_page_are_those_of_the_model(served, browser, lap_model):
    """A slider is moved, a sample is picked, friction is typed and the assembly saved: each time the page tells what
    the model evaluates. Nothing is asked of another host, and nothing breaks in the browser."""
    from selenium.webdriver.common.keys import Keys

    page, exploration = Seen(browser), mic.explore(lap_model)
    browser.get(served.address)
    page.until(lambda: browser.find_elements("id", "value-of-M1"), "the page")
    m1 = lap_model.evaluate({}).measurements[0][0]
    assert float(page("value-of-M1").get_attribute("title").split()[0]) == pytest.approx(m1, abs=1e-12)
    assert "are displayed" in page("note").text and "Solved in all stages" in page("certificate").text

    names = [one.name for one in exploration.controls]
    i = names.index("F1")
    thumb = browser.find_element("css selector", f"#control-{i} [role=slider]")
    stated = page.input(i)
    told = page.final(lambda: thumb.send_keys(Keys.ARROW_RIGHT))
    assert page.input(i) > stated
    assert told == pytest.approx(lap_model.evaluate({"F1": page.input(i)}).measurements[0][0], abs=1e-12)
    assert abs(told - m1) > 1e-4

    page.until(lambda: page("counted").text.strip() == "100 samples", "the samples")
    bar = max(range(25), key=lambda j: browser.find_element("id", f"bar-{j}").get_attribute("style"))
    told = page.final(page(f"bar-{bar}").click)
    page.until(lambda: page("picked").text.startswith("Sample "), "the sample")
    number = int(page("picked").text.split()[1].rstrip(":"))
    figure = lambda text: float(text.replace("−", "-").split()[-2])
    low, high = (figure(one.text) for one in browser.find_elements("css selector", ".ends span"))
    middle = figure(page(f"bar-{bar}").get_attribute("title"))
    assert abs(told - middle) < 0.52 * (high - low) / 25 + 5e-3 * abs(middle)  # as it is told, to three digits
    (drawn,), (measured,) = exploration.draw_samples(1, first=number)
    assert told == pytest.approx(measured[0], abs=1e-9)
    assert page.input(i) == pytest.approx(drawn[lap_model.parameters.index("F1")], abs=1e-12)

    friction = names.index("zones.lap.friction")
    box = page(f"value-{friction}")
    box.send_keys(Keys.CONTROL, "a")
    told = page.final(lambda: box.send_keys("0.1", Keys.TAB))
    moved = exploration.sample(drawn) | {"zones.lap.friction": 0.1}
    assert told == pytest.approx(exploration.answer(moved).table["value"][0], abs=1e-9)

    box.send_keys(Keys.CONTROL, "a")
    box.send_keys("99", Keys.TAB)
    page.until(lambda: page("refused").text.startswith("zones.lap.friction: 99 is outside 0 … "), "the refusal")
    assert page.input(friction) == 0.1 and exploration.answer(moved).table["value"][0] == pytest.approx(told, abs=1e-9)

    page("save-sample").click()
    page.until(lambda: page("saved").text.startswith("Saved: "), "the file")
    saved = Path(page("saved").text.removeprefix("Saved: "))
    (values,) = read_measured_report(saved, [*lap_model.parameters, "friction-1"], "deviation").values.values()
    assert saved.parent == served.folder and values == pytest.approx(
        dict(zip(lap_model.parameters, drawn)) | {"friction-1": 0.1 - lap_model.scene.zones[0].friction}
    )
    page("save-scene").click()
    page.until(lambda: "explored-scene-1.toml" in page("saved").text, "the scene")
    assert 'kind = "friction"' in (served.folder / "explored-scene-1.toml").read_text()

    assert page.final(page("reset").click) == pytest.approx(m1, abs=1e-9)
    sent = [json.loads(line["message"])["message"] for line in browser.get_log("performance")]
    asked = [one["params"]["request"]["url"] for one in sent if one["method"] == "Network.requestWillBeSent"]
    asked += [one["params"]["url"] for one in sent if one["method"] == "Network.webSocketCreated"]
    own = (f"http://{served.host}/", f"ws://{served.host}/", "data:", "blob:", "chrome:", "chrome-untrusted:")
    assert [url for url in asked if not url.startswith(own)] == [] and any(url.startswith("ws:") for url in asked)
    wrong = [line["message"] for line in browser.get_log("browser") if line["level"] == "SEVERE"]
    assert [line for line in wrong if "/paraview/" not in line] == []  # where trame looks for a launcher
    browser.save_screenshot(str(served.folder / "page.png"))
