"""Displacement fields of unit forces: solved, cached, and read without finite elements."""

import numpy as np
import pytest

from mic.compliance import fields, provider
from mic.compliance.fields import displacement_field
from mic.errors import MissingProvider
from mic.model.assembly import assemble

pytestmark = pytest.mark.fem


@pytest.fixture(scope="module")
def part(lap_scene, cache):
    return assemble(lap_scene, cache).parts[0]


@pytest.fixture
def loads(part):
    """Two self-balanced sets of forces on nine of the functionals, N."""
    from fem_reference.provider import shell_part

    shell = shell_part(part)
    G = (shell.functional_matrix(part.functionals) @ shell.rigid_modes)[::7][:12]
    balanced = np.linalg.svd(G.T)[2][6:8].T
    forces = np.zeros((len(part.functionals), 2))
    forces[::7][:12] = 50 * balanced
    return forces


def refuse(part):
    raise MissingProvider("none is at hand")


def test_cached_fields_equal_solved_fields_and_further_functionals_are_added(part, loads, tmp_path, monkeypatch):
    direct, modes = provider.find(part).field(part, loads)
    few = loads.copy()
    few[np.flatnonzero(loads.any(axis=1))[:5]] = 0.0
    displacement_field(part, few, tmp_path)
    with monkeypatch.context() as absent, pytest.raises(MissingProvider):
        absent.setattr(provider, "find", refuse)
        displacement_field(part, loads, tmp_path)
    made = displacement_field(part, loads, tmp_path)
    monkeypatch.setattr(provider, "find", refuse)
    cached = displacement_field(part, -3 * loads[:, ::-1], tmp_path)
    scale = np.abs(direct[:, :3]).max()
    np.testing.assert_allclose(made[0], direct[:, :3], atol=1e-9 * scale)
    np.testing.assert_allclose(cached[0], -3 * direct[:, :3, ::-1], atol=3e-9 * scale)
    np.testing.assert_array_equal(cached[1], modes[:, :3])
    np.testing.assert_array_equal(displacement_field(part, loads, tmp_path)[0], made[0])  # to the bit
    displacement_field(part, few, tmp_path)


def test_the_cache_is_limited_in_size(part, loads, tmp_path, monkeypatch):
    size = 8 * part.surface.points.size
    monkeypatch.setattr(fields, "LARGEST", 7 * size)  # bytes of seven fields
    direct = provider.find(part).field(part, loads)[0][:, :3]
    np.testing.assert_allclose(displacement_field(part, loads, tmp_path)[0], direct, rtol=0, atol=0)
    assert not (tmp_path / "fields").exists()
    loaded = np.flatnonzero(loads.any(axis=1))
    for own in (loaded[:6], loaded[6:]):
        displacement_field(part, np.eye(len(loads))[:, own], tmp_path)
    _, arrays = fields.Cache(tmp_path, "fields", fields.FORMAT).load(part.fingerprint())
    assert set(arrays["functional"]) == set(loaded[6:])
