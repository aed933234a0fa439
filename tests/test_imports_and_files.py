"""A run loads and writes only what its scene needs: packages in memory and files in the folder, by kind of scene."""

import json
import os
import subprocess
import sys

import pytest
from support.springs import at_face, six, spring_model, stage_list, two_plates

#: Compilers, drawing libraries, finite elements, engines for several machines and optional solvers.
HEAVY = {"numba", "llvmlite", "matplotlib", "PIL", "plotly", "jinja2", "dolfinx", "petsc4py", "gmsh", "mpi4py"}
HEAVY |= {"joblib", "loky", "dask", "sklearn", "cvxpy", "trame", "xlsxwriter", "meshlane"}
RARE = {
    "scipy.optimize",
    "scipy.stats",
    "scipy.interpolate",
    "scipy.io",
    "mic.studies.optimisation",
    "mic.report.picture",
}

RUN = """
import json, sys
from pathlib import Path

import mic.commands.check, mic.commands.run, mic.report.verdict
from mic.process.model import ReducedModel
from mic.runs import conclude, sample_into

folder = Path(sys.argv[1])
model = ReducedModel.load(folder / "saved.npz")
sample_into(folder / "run", model, model.scene.report.laws, 3, 1)
outcome = conclude(folder / "run")
found = [sorted(sys.modules)]
if sys.argv[2:]:
    mic.report.write_report(folder / "run", outcome)
    found.append(sorted(sys.modules))
print(json.dumps(found))
"""


def run(folder, model, *report):
    """Modules in memory after a run, and after its report; its files, without the numbers of their samples."""
    model.save(folder / "saved.npz")
    command = [sys.executable, "-c", RUN, str(folder), *report]
    alone = {name: value for name, value in os.environ.items() if not name.startswith(("OMPI", "PMI"))}
    done = subprocess.run(command, env=alone, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    modules = [set(names) for names in json.loads(done.stdout)]
    files = {str(path.relative_to(folder / "run")) for path in (folder / "run").rglob("*") if path.is_file()}
    return modules, {file.split("/law=")[0] for file in files}


def loaded(modules):
    """Which of the heavy packages and rare modules are in memory."""
    return {name.partition(".")[0] for name in modules} & HEAVY | modules & RARE


@pytest.mark.slow
def test_one_part_without_contact_loads_no_kernel_and_writes_no_empty_table(tmp_path):
    model = spring_model(
        [],
        parts=[{"name": "a", "mesh": "a.stl", "thickness": 1.0}],
        locators=six("a"),
        measurements=[at_face("a", name="M", lower=-1, upper=1)],
        deviations=[{"name": "D", "kind": "locator", "target": "al0", "sigma": 0.1}],
        stages=stage_list("locate", "measure"),
        report={"laws": ["frictionless"]},
    )
    (modules, with_report), files = run(tmp_path, model, "report")
    assert loaded(modules) == set()
    assert len(modules) < 1450  # 300 of them are pandas
    tables = {"tables/measurements.csv", "tables/.measurements.csv.sha256"}
    single = {"run.json", "model.npz", "summary.json", "report.html"}
    assert files == {"samples", "deviations", "measurements"} | tables | single
    assert loaded(with_report) == {"matplotlib", "PIL", "jinja2", "mic.report.picture", "scipy.optimize"}
    assert sum(path.stat().st_size for path in (tmp_path / "run").rglob("*")) < 2e5


@pytest.mark.slow
def test_contact_loads_the_kernels_and_writes_its_tables(tmp_path):
    deviation = {"name": "D", "kind": "locator", "target": "bl0", "sigma": 0.1}
    (modules,), files = run(tmp_path, two_plates(-0.1, deviations=[deviation]))
    assert loaded(modules) == {"numba", "llvmlite", "scipy.optimize"}
    assert {"samples", "deviations", "measurements", "contacts", "slips", "resolutions"} <= files
    assert not {"limits", "profiles", "forces", "sums", "report.html"} & files
