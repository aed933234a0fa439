"""Forms without a C compiler are those with one."""

import importlib.util
import sysconfig

import numpy as np
import pytest
from support.panels import NU, E, T, panel

from fem_reference.shell import compat
from fem_reference.shell.part import ELEMENTS, ShellPart

if importlib.util.find_spec("ffcx.codegeneration.numba") is None:
    pytest.skip("FFCx before 0.11 writes no kernels in Python", allow_module_level=True)
from fem_reference.shell import interpreted_forms

pytestmark = pytest.mark.fem


def stiffness(element, size=5):
    return ShellPart(panel(size), T, E, NU, element).stiffness_csr().toarray()


@pytest.fixture
def no_compiler(monkeypatch, tmp_path):
    """Neither a compiler nor forms that one has compiled."""
    monkeypatch.setattr("dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS", {"cache_dir": (tmp_path, "")})
    monkeypatch.setenv("CC", str(tmp_path / "missing"))


@pytest.mark.slow
@pytest.mark.parametrize("element", ELEMENTS)
def test_the_stiffness_is_the_same_without_a_compiler(element, request, monkeypatch):
    monkeypatch.setattr(interpreted_forms, "CELLS", 7)  # the last batch is smaller
    compiled = stiffness(element)
    request.getfixturevalue("no_compiler")
    interpreted = stiffness(element)
    assert abs(interpreted - compiled).max() < 1e-14 * abs(compiled).max() and (interpreted != compiled).any()


@pytest.mark.slow
def test_a_kernel_reads_the_present_constants_at_each_assembly(no_compiler):
    """And a second part of the same element has its own geometry."""
    one, two = (stiffness("p2-cr", size) for size in (4, 5))
    assert one.shape != two.shape
    np.testing.assert_array_equal(stiffness("p2-cr", 4), one)


@pytest.mark.parametrize("missing", ["compiler", "header"])
def test_a_missing_compiler_or_header_is_noticed(missing, monkeypatch, tmp_path):
    compiler = tmp_path / "cc"
    compiler.touch(mode=0o755)
    (tmp_path / "Python.h").touch()
    monkeypatch.setenv("CC", f"{compiler} -pthread")
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path))
    assert not interpreted_forms.no_compiler()
    (compiler if missing == "compiler" else tmp_path / "Python.h").unlink()
    assert interpreted_forms.no_compiler()


def test_other_integrals_are_refused(no_compiler):
    import ufl
    from dolfinx import fem

    mesh = compat.shell_mesh(compat.MPI.COMM_SELF, panel(2).points, panel(2).triangles)
    u, v = (kind(compat.lagrange_6(mesh)) for kind in (ufl.TrialFunction, ufl.TestFunction))
    assert isinstance(compat.compile_form(ufl.inner(u, v) * ufl.dx), fem.Form)
    with pytest.raises(NotImplementedError, match="a C compiler is needed"):
        compat.compile_form(ufl.inner(u, v) * ufl.ds)
