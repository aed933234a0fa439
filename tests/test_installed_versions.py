"""Which dolfinx is found and accepted, and the versions that results record."""

import importlib.util
import json
import re
import sys
from importlib.metadata import requires
from pathlib import Path

import numpy as np
import pytest
from support.runs import changed

from mic.compliance.coefficients import InfluenceCoefficients, solver_versions
from mic.results.run_folder import versions
from mic.runs import run

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def supported_versions():
    """`fem_reference.shell.versions`, loaded as the scripts do: without the package, which needs an MPI."""
    spec = importlib.util.spec_from_file_location("versions", ROOT / "fem_reference" / "shell" / "versions.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["fenics-dolfinx", "dolfinx-solver-real", "another-wheel"])
def test_dolfinx_is_found_under_any_name_of_its_package(name, supported_versions, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert supported_versions.installed() is None
    assert supported_versions.main() == 1 and "dolfinx is not installed" in capsys.readouterr().err
    (tmp_path / "dolfinx").mkdir()
    (tmp_path / "dolfinx" / "__init__.py").touch()
    record = tmp_path / f"{name.replace('-', '_')}-0.11.3.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.11.3\n")
    if name != "fenics-dolfinx":  # Debian's lists no files
        (record / "RECORD").write_text(f"dolfinx/__init__.py,,\n{record.name}/METADATA,,\n")
    assert supported_versions.installed() == "0.11.3" and supported_versions.main() == 0


@pytest.mark.parametrize("text", ["0.4.1", "0.7.3", "0.12.0", "1.5.0"])
def test_another_dolfinx_is_refused_with_those_that_are_supported(text, supported_versions):
    with pytest.raises(supported_versions.UnsupportedVersion, match=rf"dolfinx {text} is not supported.*0\.11 \(.*pip"):
        supported_versions.supported(text)
    assert [supported_versions.supported(f"0.{minor}.2") for minor in (5, 9, 10, 11)] == [
        (0, 5),
        (0, 9),
        (0, 10),
        (0, 11),
    ]


def test_versions_of_all_direct_dependencies_are_recorded():
    names = {re.match(r"[\w.-]+", line).group() for line in requires("mic-contact") if "extra ==" not in line}
    found = versions()
    assert len(names) >= 10 and names <= set(found) and found["numpy"] == np.__version__
    assert "pytest" not in found and "not installed" not in found.values()


def test_versions_of_several_programs_that_computed_coefficients_are_all_named():
    def coefficients(**programs):
        provenance = {"versions": programs} if programs else {}
        return InfluenceCoefficients("p", np.eye(1), np.zeros((1, 6)), provenance)

    parts = [coefficients(MUMPS="5.8.2", dolfinx="0.11.0"), coefficients(MUMPS="5.5.1"), coefficients()]
    assert solver_versions(parts) == {"MUMPS": "5.5.1 and 5.8.2", "dolfinx": "0.11.0"}


@pytest.mark.fem
@pytest.mark.slow
def test_a_run_records_the_programs_that_computed_its_coefficients(lap_scene, cache, tmp_path):
    from fem_reference.shell import compat

    scene = changed(lap_scene, monte_carlo={"samples": 2}, report={"laws": ["coulomb"], "fields": False})
    outcome = run(scene, tmp_path, cache)
    solver = compat.versions()
    assert set(solver) == {"dolfinx", "PETSc", "MUMPS"} and all(re.match(r"\d+\.\d+\.\d+", v) for v in solver.values())
    for record in (
        outcome.record,
        *(json.loads((tmp_path / name).read_text()) for name in ("run.json", "summary.json")),
    ):
        assert solver.items() <= record["versions"].items()
