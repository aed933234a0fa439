"""The shells against CalculiX on a folded part: another code, another shell idea, the same compliance."""

import numpy as np
import pytest
from support.panels import grid
from support.shells import at, supported_solution

from fem_reference.peers import calculix
from fem_reference.shell.part import ShellPart

pytestmark = pytest.mark.fem

needs_ccx = pytest.mark.skipif(not calculix.available(), reason="ccx is not installed: apt-get install calculix-ccx")

E, NU, T = 210000.0, 0.3, 1.0
PLACES = np.array([[15.0, 40.0, 0.0], [30.0, 10.0, 0.0], [40.0, 25.0, 10.0], [40.0, 40.0, 15.0]])
DIRECTIONS = np.array([[0, 0, 1.0], [0, 0, 1], [1, 0, 0], [0, 1, 0]])
RADIUS = 6.0


def angle_section(n):
    """Plate 40 × 50 mm with a flange of 20 mm, clamped along y = 0."""
    return grid(
        6 * n,
        5 * n,
        lambda X, Y: np.column_stack([np.minimum(60 * X, 40), 50 * Y, np.maximum(60 * X - 40, 0)]),
        pattern="cross",
    )


def averages(surface):
    """Vertex weights (n, 3, r): the displacement along each direction averaged over the disc at each place."""
    weights = np.zeros((len(surface.points), 3, len(PLACES)))
    for case, (place, direction) in enumerate(zip(PLACES, DIRECTIONS)):
        patch = surface.patch(place, RADIUS)
        share = (patch.weight[:, None] * patch.barycentric)[:, :, None] * direction
        np.add.at(weights[:, :, case], surface.triangles[patch.triangle], share)
    return weights


@pytest.fixture(scope="module")
def peer():
    """Compliance (4, 4) by CalculiX."""
    surface = angle_section(4)
    weights = averages(surface)
    u = calculix.shell_displacements(surface, T, E, NU, surface.points[:, 1] < 1e-9, weights)
    return np.einsum("nir,nis->rs", weights, u)


@needs_ccx
@pytest.mark.parametrize(("element", "tolerance"), [("dkt-opt-curved", 0.02), ("dkt-opt", 0.02), ("p2-cr", 0.03)])
def test_compliance_of_a_folded_part(element, tolerance, peer):
    """Patch compliances against the largest of their row and column.

    Most agree to 0.5 %; the largest difference is the self-compliance of the place 10 mm from the clamp, the stiffest
    one.
    """
    surface = angle_section(4)
    part = ShellPart(surface, T, E, NU, element)
    weights = averages(surface)
    compliance = np.empty((4, 4))
    clamp = at(part, lambda x: x[:, 1] < 1e-9, range(6))
    for case in range(4):
        load = np.zeros(part.ndof)
        load[part.vertex_displacement_dofs] = weights[:, :, case]
        u = supported_solution(part, [clamp], load)
        compliance[:, case] = np.einsum("nir,ni->r", weights, u[part.vertex_displacement_dofs])
    scale = np.sqrt(np.outer(np.diag(peer), np.diag(peer)))
    print(element, np.round((compliance - peer) / scale, 4).tolist())
    assert abs(peer - peer.T).max() < 1e-4 * abs(peer).max()
    assert (abs(compliance - peer) < tolerance * scale).all(), (compliance - peer) / scale


@needs_ccx
def test_ccx_s_own_words_on_failure():
    with pytest.raises(calculix.CalculixError, match="ccx"):
        surface = angle_section(1)
        calculix.shell_displacements(surface, -1.0, 0.0, NU, surface.points[:, 1] < 1e-9, averages(surface))
