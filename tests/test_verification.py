"""The verification package: its framework on cheap studies, its pages, and proof that its limits catch planted
errors."""

import json
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from support.processes import on_processes

from verification import run as runs
from verification.cost import Cost, Meter, together
from verification.pdf import NoBrowser
from verification.plots import panels
from verification.report import over_limit, write_report
from verification.study import FOLDER, Acceptance, CheckedFinding, Context, Finding, Study, Team, studies

pytestmark = pytest.mark.fem


# Three studies that cost next to nothing, one of them with finite elements; the same file is the program of the MPI
# tests.
CHEAP = """
import os
import sys
import time
from pathlib import Path

import numpy as np

from verification.analytic.sheet import Sheet, stop_force
from verification.run import run, team, write_summary
from verification.study import Acceptance, Finding, Study


def cell(i):
    return float(np.random.default_rng(i).standard_normal(1000).mean())


def long_first(i):
    time.sleep(0.5 * (i == 0))
    return os.getpid()


def means(context):
    values = context.team.map(cell, range(7))
    if context.team.size > 1:
        first, *others = context.team.map(long_first, range(7))
        assert first not in others, "who was busy with the first item was given another"
    return [Finding("mean", max(map(abs, values))), Finding("sum", abs(sum(values)), "a note")]


def strips(context):
    found = context.team.map(lambda gap: stop_force(Sheet(size=10.0), context, 10.0, gap)[0], (0.5, 1.0, 2.0))
    return [Finding("force", max(found))]


def broken(context):
    def item(i):
        if i == 3 and Path(sys.argv[-1], "break").exists():
            raise ArithmeticError("planted failure of item 3")
        return i
    return [Finding("total", sum(context.team.map(item, range(5))))]


def studies():
    common = dict(claim="c", reference="r", seconds=(1, 1))
    limits = Acceptance("mean", "Small.", 0.1), Acceptance("sum", "Small.", 0.01)
    ten, long = Acceptance("total", "Ten.", 10.0), common | {"seconds": (4, 4)}
    return [Study(1, "Means", acceptance=limits, run=means, name="means", **long),
            Study(2, "Strips", acceptance=(Acceptance("force", "Small.", 10.0),), run=strips, name="strips", **common),
            Study(3, "Broken", acceptance=(ten,), run=broken, name="broken", **common)]


if __name__ == "__main__":
    workers, sizes, folder = team(), [5.0, 4.0, 2.0, 9.0, 1.0, 2.0, 3.0], Path(sys.argv[1])
    for i in workers.taken(sizes, 8.0):
        begun = time.time()
        time.sleep(0.3)
        Path(folder.parent, f"{i}.txt").write_text(f"{workers.rank} {begun} {time.time()} {sizes[i]}")
    run(studies(), folder, False, workers)
    if workers.rank == 0:
        write_summary(folder)
"""


def cheap_studies(tmp_path):
    path = tmp_path / "cheap.py"
    path.write_text(CHEAP)
    namespace = {"__name__": "cheap"}
    exec(compile(CHEAP, str(path), "exec"), namespace)
    return namespace["studies"]()


@pytest.fixture(scope="module")
def launched(tmp_path_factory):
    """The folder and the output of two processes that run the cheap studies; one study fails."""
    folder = tmp_path_factory.mktemp("two")
    (folder / "out").mkdir()
    (folder / "out" / "break").touch()
    (folder / "cheap.py").write_text(CHEAP)
    done = on_processes(2, folder / "cheap.py", folder / "out")
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


def entries(folder):
    return [
        {key: value for key, value in entry.items() if key not in ("seconds", "cpu_seconds", "memory_gb", "began")}
        for entry in json.loads((folder / "summary.json").read_text())
    ]


@pytest.mark.parametrize(
    "bound, measured, passed",
    [
        ("at most", 1.0, True),
        ("at most", 1.1, False),
        ("at least", 0.9, False),
        ("at least", 1.0, True),
        ("at most", np.nan, False),
        ("at least", np.inf, False),
    ],
)
def test_a_number_is_judged(bound, measured, passed):
    assert CheckedFinding(Finding("x", measured), Acceptance("x", "c", 1.0, bound=bound), 1.0).passed is passed


def test_quick_runs_may_have_their_own_limit():
    assert Acceptance("x", "c", 1.0).at(True) == 1.0
    assert (
        Acceptance("x", "c", 1.0, quick=2.0).at(True) == 2.0 and Acceptance("x", "c", 1.0, quick=2.0).at(False) == 1.0
    )


@pytest.mark.parametrize("name", studies())
def test_every_limit_has_a_reason_other_than_its_measurement(name):
    for acceptance in studies()[name].acceptance:
        reason = acceptance.reason
        assert len(reason.split()) >= 3 and reason.endswith("."), (
            f"{name}/{acceptance.name} is declared without a reason"
        )
        assert not re.search(r"measured|first run|was found|turned out|so far", reason), (name, acceptance.name)


def test_the_report_shows_the_reason_of_each_limit(tmp_path):
    study = cheap_studies(tmp_path)[0]
    limits = tuple(replace(one, reason=f"Because of {one.name}.") for one in study.acceptance)
    found = [Finding("mean", 0.0), Finding("sum", 0.0)]
    runs.run([replace(study, acceptance=limits, run=lambda context: found)], tmp_path, False, Team(), lambda line: None)
    page = write_report(tmp_path).read_text()
    assert all(f"Reason for the limit: Because of {one.name}." in page for one in limits)


def test_each_acceptance_number_must_be_measured(tmp_path):
    study = replace(cheap_studies(tmp_path)[0], run=lambda context: [Finding("mean", 0.0)])
    with pytest.raises(ValueError, match="'sum'"):
        study.evaluate(Context(True, tmp_path, Team()))


def test_a_finished_study_is_reused_and_another_version_is_run(tmp_path):
    first, _, second = cheap_studies(tmp_path)
    lines = []
    runs.run([first], tmp_path / "out", False, Team(), lines.append)
    runs.run([first, second], tmp_path / "out", False, Team(), lines.append)
    assert "means: already finished" in lines and not any(line.startswith("broken: already finished") for line in lines)
    lines.clear()
    runs.run([first], tmp_path / "out", True, Team(), lines.append)
    assert not any("already finished" in line for line in lines)


def test_a_failed_study_has_no_result_and_the_others_are_run(tmp_path, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    (out / "break").touch()
    monkeypatch.setattr(sys, "argv", ["cheap", str(out)])
    means, strips, broken = cheap_studies(tmp_path)
    broken = replace(broken, seconds=(19, 19))  # the longest comes first
    lines = []
    runs.run([means, strips, broken], out, False, Team(), lines.append)
    assert [line.split(":")[0] for line in lines if "started" in line] == ["broken", "means", "strips"]
    assert any("Traceback" in line and "planted failure" in line for line in lines)
    page = write_report(out).read_text()
    assert "Not measured: ArithmeticError: planted failure of item 3" in page
    told = {entry["study"]: entry for entry in entries(out)}
    assert set(told) == {"means", "strips", "broken"}
    assert not told["broken"]["passed"] and told["broken"]["measured"] is None
    assert told["broken"]["error"] == "ArithmeticError: planted failure of item 3" and not told["means"]["error"]
    (out / "break").unlink()
    lines.clear()
    runs.run([means, strips, broken], out, False, Team(), lines.append)
    assert "means: already finished" in lines and any(line.startswith("broken: started") for line in lines)
    runs.write_summary(out)
    assert next(entry for entry in entries(out) if entry["study"] == "broken")["passed"]


def test_the_longest_studies_come_first_and_are_shared():
    common = {"order": 1, "title": "t", "claim": "c", "reference": "r", "acceptance": (), "run": None}
    made = [Study(seconds=(s, q), name=f"{s}", **common) for s, q in ((1, 10), (5, 1), (3, 1), (2, 1))]

    def names(*options, of=made):
        return tuple([study.name for study in some] for some in runs.shared_and_whole(of, *options))

    assert names(False, 1) == names(False, 2) == ([], ["5", "3", "2", "1"])
    assert names(False, 3) == (["5", "3", "2", "1"], [])  # each is more than a third of what is left
    assert names(True, 2) == names(True, 3) == (["1"], ["5", "3", "2"])
    assert names(False, 2, of=made[:1]) == (["1"], [])
    large = [replace(study, memory=4.5) if study.name == "1" else study for study in made]
    assert names(True, 2, of=large) == ([], ["1", "5", "3", "2"])  # twice 4.5 GB
    assert names(True, 2, of=large[:1]) == (["1"], [])  # or nobody would do it


def test_items_in_progress_fit_into_memory_together(launched):
    rows = [[float(word) for word in path.read_text().split()] for path in sorted(launched[0].glob("[0-9].txt"))]
    assert len(rows) == 7 and {row[0] for row in rows} == {0.0, 1.0}
    beside = [[one[3] for one in rows if one is not row and one[1] < row[2] and row[1] < one[2]] for row in rows]
    for row, others in zip(rows, beside):
        assert row[3] + max(others, default=0.0) <= 8.0 or not others
    assert not beside[3], "9 has room beside nothing"
    assert 2.0 in beside[0], "the first that fits beside 5 is taken, and not waited for 4"


def test_time_and_memory_of_a_study_are_recorded(tmp_path):
    """A hundred megabytes and a fifth of a second, which an earlier study's do not hide."""

    def spend(megabytes, seconds):
        def run(context):
            held = np.ones(megabytes << 17)
            end = time.process_time() + seconds
            while time.process_time() < end:
                held += 1
            return [Finding("total", 0.0)]

        return run

    broken = cheap_studies(tmp_path)[2]
    large = replace(broken, name="large", run=spend(400, 0.0), seconds=(9, 9))
    small = replace(broken, name="small", run=spend(100, 0.2))
    lines = []
    runs.run([small, large], tmp_path, False, Team(), lines.append)
    runs.write_summary(tmp_path)
    told = {entry["study"]: entry for entry in json.loads((tmp_path / "summary.json").read_text())}
    assert 0.2 <= told["small"]["cpu_seconds"] < 5 and told["small"]["seconds"] >= 0.2
    assert told["large"]["memory_gb"]["0"] - told["small"]["memory_gb"]["0"] == pytest.approx(300 * 1.048e-3, rel=0.2)
    assert told["large"]["began"] < told["small"]["began"] and lines[-1].startswith("2 studies: ")


def test_the_memory_of_a_child_process_does_not_include_its_parent():
    held = np.ones(30_000_000)
    meter = Meter(0)
    own = meter.read().memory
    subprocess.run([sys.executable, "-c", "pass"], check=True)
    assert held.nbytes * 1e-9 < own <= meter.read().memory < 1.1 * own
    larger = f"held = bytearray({int(1.5e9 * own)}); held[::4096] = held[::4096]"
    subprocess.run([sys.executable, "-c", larger], check=True)
    assert meter.read().memory > 2.4 * own


def test_total_memory_is_that_of_simultaneous_studies():
    def cost(process, began, ended, memory):
        return Cost(process, began, ended - began, 0.0, memory)

    first = [cost(0, 0, 10, 4.0), cost(0, 10, 20, 1.0)]
    assert together(first) == 4.0
    assert together([*first, cost(1, 11, 20, 5.0)]) == 6.0
    assert together([*first, cost(1, 9, 20, 5.0)]) == 9.0


def test_report_shows_every_number_offline(tmp_path):
    import pandas as pd

    figure, (axis,) = panels(1)
    axis.plot([0, 1], [0, 1])
    study = replace(
        cheap_studies(tmp_path)[0],
        run=lambda context: [
            Finding("mean", 0.0123, "note <b>", figure, pd.DataFrame({"a, mm": [1.5, np.nan]})),
            Finding("sum", np.nan),
        ],
    )
    runs.run([study], tmp_path / "out", False, Team(), lambda line: None)
    page = write_report(tmp_path / "out").read_text()
    assert "0.0123" in page and "note &lt;b&gt;" in page and "data:image/svg+xml" in page and "1 not met" in page
    assert "http" not in page.replace("http-equiv", "")
    summary = entries(tmp_path / "out")
    assert [entry["passed"] for entry in summary] == [True, False] and summary[1]["measured"] is None


def written(tmp_path, findings):
    """The page of one study with these findings."""
    study = replace(cheap_studies(tmp_path)[0], run=lambda context: findings)
    runs.run([study], tmp_path / "out", False, Team(), lambda line: None)
    return write_report(tmp_path / "out").read_text()


def first_page(page):
    return page[: page.index("</section>")]


def test_the_first_page_names_failures_and_limitations_and_has_a_signature(tmp_path):
    page = written(tmp_path, [Finding("mean", 0.5), Finding("sum", 0.001)])
    first = first_page(page)
    assert "failed</span>: 1 of 2 limits not met" in page[len(first) :]
    assert "1 of 2 acceptance limits are not met" in first and "Measured 0.5, limit at most 0.1" in first
    assert "0.001" not in first and "<table><thead>" not in first.replace("\n", "")
    readme = (FOLDER.parent / "README.md").read_text()
    points = re.findall(r"^- (\w+ \w+)", readme[readme.index("## Limitations") :], flags=re.MULTILINE)
    assert len(points) > 10 and all(f"<li>{point}" in first for point in points)
    assert all(word in first for word in ("commit", "machine", "date", "numpy", "Validated by", "signature"))
    assert "not computed" in first  # there is no error budget in this folder


def test_the_first_page_shows_the_error_budget(tmp_path):
    """As the study wrote it: its notes and its figure, which is the report's first."""
    figure, (axis,) = panels(1)
    axis.barh([0], [1])
    names = ("mean", "six-sigma", "cpk", "slip", "force", "coverage")
    notes = {name: f"told of {name}" for name in names} | {"cpk": "told of cpk, mended by `order` < all"}
    found = [Finding(name, 0.05, notes[name], figure if name == "mean" else None) for name in names]
    limits = tuple(Acceptance(name, "Small.", 0.1) for name in names)
    common = {"claim": "c", "reference": "r", "seconds": (1, 1)}
    budget = Study(5, "Error budget", acceptance=limits, run=lambda context: found, name="error_budget", **common)
    runs.run([cheap_studies(tmp_path)[0], budget], tmp_path / "out", False, Team(), lambda line: None)
    page = write_report(tmp_path / "out").read_text()
    first = first_page(page)
    written = notes | {"cpk": "told of cpk, mended by <code>order</code> &lt; all"}
    assert all(f"<li>{written[name]}</li>" in first for name in names[:-1]) and "told of coverage" not in first
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
    from typer.testing import CliRunner

    from verification import __main__ as program

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
    assert "planted failure of item 3" in launched[1]
    assert {entry["study"]: entry["measured"] is None for entry in entries(out)} == {
        "means": False,
        "strips": False,
        "broken": True,
    }
    shared = entries(out)
    (out / "break").unlink()
    monkeypatch.setattr(sys, "argv", ["cheap", str(out)])
    for folder in (out, tmp_path / "one"):
        runs.run(cheap_studies(tmp_path), folder, False, Team(), lambda line: None)
        runs.write_summary(folder)
    alone = entries(tmp_path / "one")
    assert all(entry["measured"] is not None for entry in alone) and entries(out) == alone
    assert [one for one in shared if one["study"] != "broken"] == [one for one in alone if one["study"] != "broken"]


def test_list_names_every_study():
    from typer.testing import CliRunner

    from verification.__main__ import app

    shown = CliRunner().invoke(app, ["list"]).output
    for study in studies().values():
        assert study.name in shown and all(acceptance.words() in shown for acceptance in study.acceptance)


def test_every_folder_with_a_page_is_a_study_with_a_place_of_its_own():
    found = studies()
    assert {path.parent.name for path in FOLDER.glob("*/README.md")} == set(found)
    assert all((FOLDER / name / "__init__.py").is_file() for name in found)
    assert len({study.order for study in found.values()}) == len(found)


@pytest.mark.parametrize("name", studies())
def test_page_opens_with_claim_reference_and_acceptance_numbers(name):
    study = studies()[name]
    page = (FOLDER / name / "README.md").read_text()
    assert page.startswith(study.opening()), f"verification/{name}/README.md must open with:\n\n{study.opening()}"


# --- planted errors
# ------------------------------------------------------------------------------------------------------


def within_limits(folder, names):
    """Whether these cases of the quick analytic study meet all their limits."""
    from verification.analytic import study

    context = Context(True, folder, Team())
    limits = {acceptance.name: acceptance for acceptance in study.STUDY.acceptance}
    for name in names:
        try:
            findings = getattr(study, name)(context)
        except (ArithmeticError, ValueError):
            return False
        checked = [CheckedFinding(finding, limits[finding.name], limits[finding.name].at(True)) for finding in findings]
        if not all(item.passed for item in checked):
            return False
    return True


def frame_sign(monkeypatch):
    from mic.model import zone_pairs

    find = zone_pairs.find_pairs

    def flipped(*arguments, **options):
        pairs = find(*arguments, **options)
        for pair in pairs:
            pair.frame[:, 0] *= -1
        return pairs

    monkeypatch.setattr(zone_pairs, "find_pairs", flipped)


def surface_side(monkeypatch):
    """Each pair reads the sheets' averted faces."""
    from mic.model import zone_pairs

    find = zone_pairs.find_pairs
    monkeypatch.setattr(
        zone_pairs,
        "find_pairs",
        lambda *a, **k: [replace(pair, sides=(-pair.sides[0], -pair.sides[1])) for pair in find(*a, **k)],
    )


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


def thickness_doubled(monkeypatch):
    from fem_reference.shell.part import ShellPart

    build = ShellPart.__init__
    monkeypatch.setattr(
        ShellPart,
        "__init__",
        lambda self, surface, thickness, *rest, **options: build(self, surface, 2 * thickness, *rest, **options),
    )


#: Planted errors and the case that detects each.
DETECTED = {
    frame_sign: "layered_cantilever",
    surface_side: "welded_leaves",
    friction_ignored: "partial_slip",
    welds_forgotten: "welded_leaves",
    thickness_doubled: "layered_cantilever",
}


@pytest.mark.slow
def test_all_limits_are_met_without_a_planted_error(tmp_path):
    assert within_limits(tmp_path, set(DETECTED.values()))


@pytest.mark.parametrize("plant", DETECTED, ids=lambda plant: plant.__name__)
@pytest.mark.slow
def test_a_planted_error_is_found(plant, monkeypatch, tmp_path):
    plant(monkeypatch)
    assert not within_limits(tmp_path, [DETECTED[plant]])
