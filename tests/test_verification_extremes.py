"""Cells drawn over all axes at once: what the design holds, and that a cell that is silently wrong is found."""

import numpy as np
import pytest
from scipy.sparse import eye

from fem_reference.shell import part
from fem_reference.shell.factorisation import Factorisation, FactorisationError
from verification.extremes import design, study
from verification.study import Context, Team

pytestmark = pytest.mark.fem


def test_the_design_fills_every_axis():
    cells = design.cells(quick=False)
    assert len(cells) >= 400
    for name, family in design.FAMILIES.items():
        own = [cell.values for cell in cells if cell.family == name]
        assert len(own) == family.cells
        for axis, read in family.axes.items():
            ends = {read(0.0), read(1 - 1e-9)}
            values = [values[axis] for values in own]
            if isinstance(read, design.Choice):
                assert set(values) == set(read.values) or len(read.values) > len(own), axis
            else:
                least, most = np.quantile(values, [0.02, 0.98])
                assert least <= min(ends) * 10 or read.else_ in values, axis
                assert most >= max(ends) / 10, axis


@pytest.fixture(scope="module")
def context(tmp_path_factory):
    return Context(True, tmp_path_factory.mktemp("extremes"), Team())


def cell(family, **change):
    """A mild cell of a family."""
    mild = {name: read(0.6) for name, read in design.FAMILIES[family].axes.items()}
    return design.Cell(family, 0, mild | change)


STRIP = {"t/L": 0.005, "E": 210e3, "friction": 0.3, "gap / L": 5e-4, "load / closing load": 2.0, "stages": 2}
STRIP |= {"element size / width": 0.5, "sliver": 1.0, "pairs apart": -1.0, "unit of length": 1e2, "law": "coulomb"}


def test_cells_are_right_and_refusals_remedied(context, monkeypatch):
    right = study.try_drawn(context, cell("strip on a stop", **STRIP))
    assert right["outcome"] == "right" and "with its remedy" not in right
    twins = study.try_drawn(context, cell("strip on a stop", **STRIP | {"pairs apart": 1e-9}))
    assert twins["outcome"] == "right"
    narrow = STRIP | {"sliver": 2.5e-5, "t/L": 1e-4, "element size / width": 1.0}
    assert study.try_drawn(context, cell("strip on a stop", **narrow))["outcome"] == "right"
    monkeypatch.setattr(part, "local_freedoms", lambda surface, thickness: None)
    refused = study.try_drawn(context, cell("strip on a stop", **narrow | {"sliver": 2e-5}))
    assert refused["outcome"] == "refused" and refused["with its remedy"] == "right", refused


def test_a_refusal_keeps_all_words_of_its_message(context):
    refused = study.try_drawn(context, cell("sheet on an incline", friction=20.0))
    assert refused["outcome"] == "refused" and "20 is no coefficient of friction" in refused["reason"]


def test_both_refusals_of_a_mesh_name_its_narrow_elements():
    """The other one is met above, where a sheet without local freedoms is refused and remedied."""
    with pytest.raises(FactorisationError) as refusal:
        Factorisation(-eye(3, format="csr"))
    meshed = design.remedied(cell("strip on a stop", sliver=1e-3), str(refusal.value))
    assert meshed is not None and meshed.values["sliver"] == 1.0


def test_the_quick_version_may_refuse_as_many_cells_as_the_full_one():
    """Its cells are some of the full version's, so that it cannot refuse more of them."""
    full, quick = (
        [(name, value) for name, _, values, _ in study.sweeps(quick) for value in values] for quick in (False, True)
    )
    assert set(quick) <= set(full)
    limit = next(one for one in study.STUDY.acceptance if one.name == "refused")
    assert int(limit.quick * len(quick)) == int(limit.limit * len(full)) == 2


@pytest.mark.parametrize("law", ["coulomb", "associated", "micro-slip"])
def test_a_force_that_breaks_the_law_is_wrong(law, context, monkeypatch):
    values = {"contacts": 5.0, "friction": 0.3, "law": law, "compliance": 1e-3, "load": 1e3, "condition": 1e3}
    assert study.try_drawn(context, cell("contact problem", **values))["outcome"] == "right"
    solve = design.ContactSolver.solve

    def off(self, b):
        solution = solve(self, b)
        solution.force[:, 1::3] *= -1  # friction drives the slip
        return solution

    monkeypatch.setattr(design.ContactSolver, "solve", off)
    assert study.try_drawn(context, cell("contact problem", **values))["outcome"] == "wrong"


def test_a_stop_that_is_off_is_wrong(context, monkeypatch):
    force = design.stop_force
    monkeypatch.setattr(design, "stop_force", lambda *given: (1.02 * force(*given)[0], force(*given)[1]))
    assert study.try_drawn(context, cell("strip on a stop", **STRIP))["outcome"] == "wrong"
