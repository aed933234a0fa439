"""The verification package: its framework on cheap studies, its pages, and proof that its limits catch planted
errors."""

import ast
import importlib.util
import json
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from support import cheap_studies
from support.processes import on_processes
from typer.testing import CliRunner

from mic.model.assembly import assemble
from verification import __main__ as program
from verification import domain
from verification import run as runs
from verification.cost import Cost, together
from verification.pdf import NoBrowser
from verification.plots import panels
from verification.report import over_limit, write_report
from verification.study import FOLDER, Acceptance, CheckedFinding, Context, Finding, Study, Team, studies
from verification.validation import Uncertainty

pytestmark = pytest.mark.fem


@pytest.fixture(scope="module")
def launched(tmp_path_factory):
    """The folder and the output of two processes that run the cheap studies; one study fails."""
    folder = tmp_path_factory.mktemp("two")
    (folder / "out").mkdir()
    (folder / "out" / "break").touch()
    done = on_processes(2, cheap_studies.__file__, folder / "out")
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


def entries(folder):
    return [
        {key: value for key, value in entry.items() if key not in ("seconds", "cpu_seconds", "memory_gb", "began")}
        for entry in json.loads((folder / "summary.json").read_text())
    ]


def finished(of, folder, quick=False):
    """Lines that a run of studies prints."""
    lines = []
    runs.run(of, folder, quick, Team(), lines.append)
    return lines


@pytest.mark.parametrize(
    "bound, measured, passed",
    [("at most", 1.0, True), ("at most", 1.1, False), ("at least", 0.9, False), ("at least", 1.0, True),
     ("at most", np.nan, False), ("at least", np.inf, False)],
)  # fmt: skip
def test_a_number_is_judged(bound, measured, passed):
    assert CheckedFinding(Finding("x", measured), Acceptance("x", "c", 1.0, bound=bound), 1.0).passed is passed


def test_quick_runs_may_have_their_own_limit():
    own = Acceptance("x", "c", 1.0, quick=2.0)
    assert Acceptance("x", "c", 1.0).at(True) == own.at(False) == 1.0 and own.at(True) == 2.0


def test_quantities_of_full_runs_are_left_out_of_quick_ones(tmp_path):
    means, full = cheap_studies.studies()[0], Acceptance("sum", "Small.", 0.01, full_only=True)
    study = replace(means, acceptance=(means.acceptance[0], full), run=lambda context: [Finding("mean", 0.0)])
    assert [one.finding.name for one in study.evaluate(Context(True, tmp_path, Team()))] == ["mean"]
    assert [one.finding.name for one in study.unmeasured(True, "failed")] == ["mean"]
    with pytest.raises(ValueError, match="'sum'"):
        study.evaluate(Context(False, tmp_path, Team()))


def test_quick_studies_on_several_processes_give_the_results_of_one(tmp_path, monkeypatch):
    some = cheap_studies.studies()[:2]
    for cores in (1, 2):
        monkeypatch.setattr(runs, "available_cores", lambda cores=cores: cores)
        lines = finished(some, tmp_path / str(cores), True)
        assert ("2 studies on 2 processes …" in lines) == (cores == 2)
        runs.write_summary(tmp_path / str(cores))
    assert entries(tmp_path / "1") == entries(tmp_path / "2")


def test_the_validation_metric_is_the_error_over_its_uncertainty():
    unsure = Uncertainty(num=0.3, input=0.4, reference=1.2)
    assert unsure.total == pytest.approx(1.3) and unsure.metric(-2.6) == pytest.approx(2.0)
    assert unsure.record(-2.6)["model_error"] == pytest.approx(2.6 + 2 * 1.3)
    assert Uncertainty().metric(0.0) == 0.0 and Uncertainty().record(0.1)["metric"] is None


def test_the_domain_is_that_of_the_assemblies_that_were_built(lap_model, lap_scene, cache):
    domain.collected()
    assembly = assemble(lap_scene, cache)
    with domain.unrecorded():
        domain.record(assembly, lap_model)
    assert not domain.collected()
    domain.record(assembly, lap_model)
    found = domain.merged([domain.collected(), {"thickness": (0.5, 0.8)}])
    assert found["thickness"] == (0.5, 1.0) and found["friction"] == (0.27, 0.27) and "bend" not in found
    assert found["slenderness"] == found["size"] and found["size"][0] == pytest.approx(np.hypot(100, 25), rel=0.01)
    assert found["deviation"][1] == pytest.approx(3 * max(item.sigma for item in lap_scene.deviations[-1:]), rel=20)
    assert not domain.collected()


def test_every_limit_has_a_reason_other_than_its_measurement():
    for name, study in studies().items():
        for acceptance in study.acceptance:
            reason = acceptance.reason
            assert len(reason.split()) >= 3 and reason.endswith("."), (name, acceptance.name)
            assert not re.search(r"measured|first run|was found|turned out|so far", reason), (name, acceptance.name)


def test_a_failed_study_is_run_again_and_a_finished_one_is_reused(tmp_path, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    (out / "break").touch()
    monkeypatch.setattr(sys, "argv", ["cheap", str(out)])
    means, squares, broken = cheap_studies.studies()
    broken = replace(broken, seconds=(19, 19))  # the longest comes first
    lines = finished([means, squares, broken], out)
    assert [line.split(":")[0] for line in lines if "started" in line] == ["broken", "means", "squares"]
    assert any("Traceback" in line and "planted failure" in line for line in lines)
    page = write_report(out).read_text()
    assert "Not measured: ArithmeticError: planted failure of item 3" in page
    found = {entry["study"]: entry for entry in entries(out)}
    assert set(found) == {"means", "squares", "broken"}
    assert not found["broken"]["passed"] and found["broken"]["measured"] is None
    assert found["broken"]["error"] == "ArithmeticError: planted failure of item 3" and not found["means"]["error"]
    (out / "break").unlink()
    lines = finished([means, squares, broken], out)
    assert "means: already finished" in lines and any(line.startswith("broken: started") for line in lines)
    runs.write_summary(out)
    assert next(entry for entry in entries(out) if entry["study"] == "broken")["passed"]
    assert not any("already finished" in line for line in finished([means], out, quick=True))


def test_the_longest_studies_come_first_and_are_shared():
    common = {"order": 1, "title": "t", "claim": "c", "reference": "r", "acceptance": (), "run": None}
    made = [Study(seconds=(s, q), name=f"{s}", **common) for s, q in ((1, 10), (5, 1), (3, 1), (2, 1))]

    def names(*options, of=made):
        return tuple([study.name for study in some] for some in runs.shared_and_whole(of, *options))

    assert names(False, 1) == names(False, 2) == ([], ["5", "3", "2", "1"])
    assert names(False, 3) == (["5", "3", "2", "1"], [])  # each is more than a third of what is left
    assert names(True, 2) == names(True, 3) == (["1"], ["5", "3", "2"])
    assert names(False, 2, of=made[:1]) == (["1"], [])
    large = [replace(study, memory=4.5) for study in made]
    assert names(False, 3, of=large) == ([], ["5", "3", "2", "1"])  # three times 4.5 GB
    assert names(False, 3, of=large[:1]) == (["1"], [])  # or nobody would do it
    assert names(True, 2, of=large) == (["1"], ["5", "3", "2"])  # a quick version needs less


def test_items_in_progress_fit_into_memory_together(launched):
    rows = [[float(word) for word in path.read_text().split()] for path in sorted(launched[0].glob("[0-9].txt"))]
    assert len(rows) == 7 and {row[0] for row in rows} == {0.0, 1.0}
    beside = [[one[3] for one in rows if one is not row and one[1] < row[2] and row[1] < one[2]] for row in rows]
    for row, others in zip(rows, beside):
        assert row[3] + max(others, default=0.0) <= 8.0 or not others
    assert not beside[3], "9 fits beside nothing"
    assert 2.0 in beside[0], "the first that fits beside 5 is taken, instead of waiting for 4"


def test_time_and_memory_of_a_study_are_recorded(tmp_path):
    """They are those of each study alone."""

    def spend(megabytes, seconds):
        def run(context):
            held = np.ones(megabytes << 17)
            end = time.process_time() + seconds
            while time.process_time() < end:
                held[:1000] += 1
            return [Finding("total", 0.0)]

        return run

    broken = cheap_studies.studies()[2]
    large = replace(broken, name="large", run=spend(400, 0.0), seconds=(9, 9))
    small = replace(broken, name="small", run=spend(100, 0.2))
    lines = finished([small, large], tmp_path)
    runs.write_summary(tmp_path)
    large, small = json.loads((tmp_path / "summary.json").read_text())
    assert (large["study"], small["study"]) == ("large", "small") and large["began"] < small["began"]
    assert 0.2 <= small["cpu_seconds"] < 5 and small["seconds"] >= 0.2 and lines[-1].startswith("2 studies: ")
    assert large["memory_gb"]["0"] - small["memory_gb"]["0"] == pytest.approx(300 * 1.048e-3, rel=0.2)


CHILDREN = """
import subprocess, sys
import numpy as np
from verification.cost import Meter
held = np.ones(20_000_000)
meter = Meter(0)
own = meter.read().memory
subprocess.run([sys.executable, "-c", "pass"], check=True)
assert held.nbytes * 1e-9 < own <= meter.read().memory < 1.1 * own
larger = f"held = bytearray({int(1.5e9 * own)}); held[::4096] = held[::4096]"
subprocess.run([sys.executable, "-c", larger], check=True)
assert meter.read().memory > 2.4 * own
"""


def test_the_memory_of_a_child_process_does_not_include_its_parent():
    subprocess.run([sys.executable, "-c", CHILDREN], check=True)


def test_total_memory_is_that_of_simultaneous_studies():
    def cost(process, began, ended, memory):
        return Cost(process, began, ended - began, 0.0, memory)

    first = [cost(0, 0, 10, 4.0), cost(0, 10, 20, 1.0)]
    assert together(first) == 4.0
    assert together([*first, cost(1, 11, 20, 5.0)]) == 6.0
    assert together([*first, cost(1, 9, 20, 5.0)]) == 9.0


def test_report_shows_every_number_offline(tmp_path):
    figure, (axis,) = panels(1)
    axis.plot([0, 1], [0, 1])
    table = pd.DataFrame({"a, mm": [1.5, np.nan]})
    page = written(tmp_path, [Finding("mean", 0.0123, "note <b>", figure, table), Finding("sum", np.nan)])
    assert "0.0123" in page and "note &lt;b&gt;" in page and "data:image/svg+xml" in page and "1 not met" in page
    assert "://" not in page
    summary = entries(tmp_path / "out")
    assert [entry["passed"] for entry in summary] == [True, False] and summary[1]["measured"] is None


def written(tmp_path, findings, *others):
    """The page of the first cheap study with these findings, and of other studies."""
    study = cheap_studies.studies()[0]
    limits = tuple(replace(one, reason=f"Because of {one.name}.") for one in study.acceptance)
    study = replace(study, run=lambda context: findings, acceptance=limits)
    finished([study, *others], tmp_path / "out")
    return write_report(tmp_path / "out").read_text()


def first_page(page):
    return page[: page.index("</section>")]


def test_the_first_page_names_failures_and_limitations_and_has_a_signature(tmp_path):
    page = written(tmp_path, [Finding("mean", 0.5), Finding("sum", 0.001)])
    first = first_page(page)
    assert "failed</span>: 1 of 2 limits not met" in page[len(first) :]
    assert "1 of 2 acceptance limits are not met" in first and "Measured 0.5, limit at most 0.1" in first
    assert all(f"Reason for the limit: Because of {name}." in page for name in ("mean", "sum"))
    assert "0.001" not in first and "<table><thead>" not in first.replace("\n", "")
    readme = (FOLDER.parent / "README.md").read_text()
    points = re.findall(r"^- (\w+ \w+)", readme[readme.index("## Limitations") :], flags=re.MULTILINE)
    assert len(points) > 10 and all(f"<li>{point}" in first for point in points)
    words = ("commit", "machine", "date", "numpy", "Verified by", "signature", "not computed")  # the error budget
    assert all(word in first for word in words)


def test_the_first_page_states_domain_and_comparisons_and_is_no_validation(tmp_path, lap_model, lap_scene, cache):
    found = [Finding("mean", 0.05, uncertainty=Uncertainty(num=0.03, reference=0.04)), Finding("sum", 0.001)]

    assembly = assemble(lap_scene, cache)

    def measured(context):
        domain.record(assembly, lap_model)
        return found

    study = replace(cheap_studies.studies()[0], run=measured)
    finished([study], tmp_path / "out")
    first = first_page(write_report(tmp_path / "out").read_text())
    assert "<h1>Method verification report</h1>" in first and "No measured assembly is among the data" in first
    assert "thickness: 1 to 1 mm" in first and "studies that meet their limits (means)" in first
    assert (
        "".join(f'<td class="n">{text}</td>' for text in ("0.03", "0", "0.04", "0.05", "1", "≤ 0.15", "0.1")) in first
    )
    finished([replace(study, measured_assembly=True, name="validation")], tmp_path / "own")
    first = first_page(write_report(tmp_path / "own").read_text())
    assert "<h1>Method validation report</h1>" in first and "No measured assembly" not in first
    found[0] = Finding("mean", 0.5)
    finished([study], tmp_path / "bad")
    assert "Domain of applicability" not in write_report(tmp_path / "bad").read_text()  # of what failed


def test_the_first_page_shows_the_error_budget(tmp_path):
    """Its notes as the study wrote them, and its figure, which is the report's first."""
    figure, (axis,) = panels(1)
    axis.barh([0], [1])
    names = ("mean", "six-sigma", "cpk", "slip", "force", "coverage")
    notes = {name: f"note on {name}" for name in names} | {"cpk": "note on cpk, see `order` < all"}
    found = [Finding(name, 0.05, notes[name], figure if name == "mean" else None) for name in names]
    limits = tuple(Acceptance(name, "Small.", 0.1) for name in names)
    common = {"claim": "c", "reference": "r", "seconds": (1, 1)}
    budget = Study(5, "Error budget", acceptance=limits, run=lambda context: found, name="error_budget", **common)
    page = written(tmp_path, [Finding("mean", 0.5), Finding("sum", 0.001)], budget)
    first = first_page(page)
    notes["cpk"] = "note on cpk, see <code>order</code> &lt; all"
    assert all(f"<li>{notes[name]}</li>" in first for name in names[:-1]) and "note on coverage" not in first
    assert first.count("<img") == 1 and "Figure 1." in first and "Figure 1." not in page[len(first) :]
    numbers = [int(number) for number in re.findall(r"Figure (\d+)\.", page)]
    assert sorted(numbers) == list(range(1, len(numbers) + 1))


@pytest.mark.parametrize(
    "bound, measured, limit, used",
    [("at most", 0.05, 0.1, 0.5), ("at least", 4.0, 2.0, 0.5), ("at most", 0.3, 0.1, 3.0), ("at most", 0.0, 0.1, 1e-4),
     ("at least", 0.0, 2.0, 1e4), ("at least", -1.0, 2.0, 1e4), ("at most", None, 1.0, np.nan)],
)  # fmt: skip
def test_a_bar_beyond_the_line_is_an_exceeded_limit(bound, measured, limit, used):
    passed = measured is not None and (measured <= limit if bound == "at most" else measured >= limit)
    finding = {"bound": bound, "measured": measured, "limit": limit, "passed": passed}
    assert over_limit(finding) == pytest.approx(used, nan_ok=True)
    assert passed == (used <= 1)


def test_a_report_is_printed_and_a_missing_browser_is_reported_at_once(tmp_path, monkeypatch):
    if shutil.which("chromium") is not None:
        written(tmp_path, [Finding("mean", 0.01), Finding("sum", 0.001)])
        printed = write_report(tmp_path / "out", pdf=True)
        assert printed.name == "report.pdf" and printed.read_bytes().startswith(b"%PDF")
        assert len(re.findall(rb"/Type\s*/Page\b", printed.read_bytes())) >= 4  # first, study, limitations, numbers
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    monkeypatch.setattr(program, "run_studies", None)  # calling it would break
    for words in (["run", "sampling", "--pdf"], ["report", str(tmp_path / "out"), "--pdf"]):
        found = CliRunner().invoke(program.app, words)
        assert isinstance(found.exception, NoBrowser) and "apt install chromium" in str(found.exception)


@pytest.mark.slow
def test_a_failure_on_one_process_ends_no_other_and_results_are_those_of_one_process(tmp_path, launched, monkeypatch):
    """They share the longest study and take one each of the others."""
    out = launched[0] / "out"
    shared = entries(out)
    assert "planted failure of item 3" in launched[1]
    assert [entry["study"] for entry in shared if entry["measured"] is None] == ["broken"]
    (out / "break").unlink()
    monkeypatch.setattr(sys, "argv", ["cheap", str(out)])
    for folder in (out, tmp_path / "one"):
        finished(cheap_studies.studies(), folder)
        runs.write_summary(folder)
    alone = entries(tmp_path / "one")
    assert all(entry["measured"] is not None for entry in alone) and entries(out) == alone
    assert [one for one in shared if one["study"] != "broken"] == [one for one in alone if one["study"] != "broken"]


def test_list_names_every_study():
    shown = CliRunner().invoke(program.app, ["list"]).output
    for study in studies().values():
        assert study.name in shown and all(acceptance.words() in shown for acceptance in study.acceptance)


def test_every_folder_with_a_page_is_a_study_with_a_place_of_its_own():
    found = studies()
    assert {path.parent.name for path in FOLDER.glob("*/README.md")} == set(found)
    assert all((FOLDER / name / "__init__.py").is_file() for name in found)
    assert len({study.order for study in found.values()}) == len(found)


def test_names_that_benchmarks_import_exist():
    for path in (FOLDER.parent / "benchmarks").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module.startswith(("mic", "verification", "fem_reference")):
                module = importlib.import_module(node.module)
                for name in (one.name for one in node.names if not hasattr(module, one.name)):
                    assert importlib.util.find_spec(f"{node.module}.{name}"), f"{path.name}: {node.module}.{name}"


def test_pages_open_with_claim_and_reference():
    for name, study in studies().items():
        page = (FOLDER / name / "README.md").read_text()
        assert page.startswith(study.opening()), f"verification/{name}/README.md must open with:\n\n{study.opening()}"


# --- planted errors
# ------------------------------------------------------------------------------------------------------


def within_limits(folder, names):
    """Whether these cases of the quick analytic study meet all their limits."""
    from verification.analytic import study

    context = Context(True, folder, Team())
    limits = {acceptance.name: acceptance for acceptance in study.STUDY.acceptance}
    try:
        findings = [finding for name in names for finding in getattr(study, name)(context)]
    except (ArithmeticError, ValueError):
        return False
    return all(CheckedFinding(one, limits[one.name], limits[one.name].at(True)).passed for one in findings)


def surface_side(monkeypatch):
    """Each pair reads the sheets' averted faces."""
    from mic.model import zone_pairs

    find = zone_pairs.find_pairs
    averted = lambda pair: replace(pair, sides=(-pair.sides[0], -pair.sides[1]))
    monkeypatch.setattr(zone_pairs, "find_pairs", lambda *given, **options: list(map(averted, find(*given, **options))))


def friction_ignored(monkeypatch):
    from mic.process import process

    solver = process.ContactSolver
    monkeypatch.setattr(process, "ContactSolver", lambda S, mu, **options: solver(S, 0.0, **options))


def welds_forgotten(monkeypatch):
    from mic.process import model, plan, process

    planned = plan.plan_stages

    def unwelded(step):
        return replace(step, bilateral=tuple(row for row in step.bilateral if row[0] != "weld"))

    def without(*arguments):
        return [replace(item, steps=tuple(map(unwelded, item.steps))) for item in planned(*arguments)]

    for module in (process, model):
        monkeypatch.setattr(module, "plan_stages", without)


#: Planted errors and the case that detects each; `algebra` plants a wrong frame, thickness and gap.
DETECTED = {surface_side: "welded_leaves", friction_ignored: "partial_slip", welds_forgotten: "welded_leaves"}


@pytest.fixture(scope="module")
def compliances(tmp_path_factory):
    """Cache folder of the planted errors that change neither pairs nor influence coefficients."""
    return tmp_path_factory.mktemp("compliances")


@pytest.mark.slow
def test_all_limits_are_met_without_a_planted_error(compliances):
    assert within_limits(compliances, set(DETECTED.values()))


@pytest.mark.parametrize("plant", DETECTED, ids=lambda plant: plant.__name__)
@pytest.mark.slow
def test_a_planted_error_is_found(plant, monkeypatch, compliances, tmp_path):
    plant(monkeypatch)
    folder = compliances if plant in (friction_ignored, welds_forgotten) else tmp_path
    assert not within_limits(folder, [DETECTED[plant]])
