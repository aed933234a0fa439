"""Compliance by parts, and its providers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from mic.compliance import provider
from mic.compliance.blocks import Blocks
from mic.compliance.cache import influence_coefficients, is_cached
from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.functional import Functionals
from mic.compliance.part import Part
from mic.errors import MissingProvider, SceneError
from mic.geometry.surface import Surface

SIZES = (4, 7, 3)


@pytest.fixture
def blocks():
    rng = np.random.default_rng(3)
    H = [rng.normal(size=(n, n)) for n in SIZES]
    return Blocks(tuple(h + h.T for h in H), tuple(rng.normal(size=(n, 6)) for n in SIZES))


def test_block_products_equal_dense_products(blocks):
    rng = np.random.default_rng(4)
    H, G = blocks.dense()
    assert H.shape == (14, 14) and G.shape == (14, 18) and not H[:4, 4:].any()
    sparse = lambda rows: csr_matrix(rng.normal(size=(rows, 14)) * (rng.random((rows, 14)) < 0.3))
    left, right, forces, motions = sparse(5), sparse(8), rng.normal(size=(2, 14)), rng.normal(size=(2, 18))
    close = lambda found, wanted: np.testing.assert_allclose(found, wanted, atol=1e-12)
    close(blocks.gather(left, right), left @ H @ right.T.toarray())
    close(blocks.diagonal(left), np.diag(left @ H @ left.T.toarray()))
    close(blocks.rigid(left), left @ G)
    close(blocks.displace(forces), forces @ H)
    close(blocks.carry(motions), motions @ G.T)
    close(blocks.part(1).dense()[0], H[4:11, 4:11])


def test_motions_are_fitted_part_by_part(blocks):
    rigid = np.random.default_rng(5).normal(size=(3, 18))
    rigid[:, :6] = rigid[:, 12:] = 0.0  # parts of four and three functionals cannot tell six motions apart
    np.testing.assert_allclose(blocks.fit(blocks.carry(rigid)), rigid, atol=1e-10)


def part(element="springs"):
    surface = Surface(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    patch = surface.patch([0.2, 0.2, 0.0], 0.0)
    one = Functionals((patch,), np.zeros(1, int), np.array([[0.0, 0, 1]]), np.zeros(1, bool), np.zeros(1), ("M",))
    return Part("p", surface, 1.0, 210e3, 0.3, element, one)


def test_given_normals_enter_the_fingerprint():
    """Estimated ones are not: they follow from the mesh."""
    plain, surface = part(), part().surface
    given = np.full((1, 3, 3), np.nan)
    given[0, 0] = [0.1, 0, 1]
    with_normals = replace(plain, surface=Surface(surface.points, surface.triangles, given.copy()))
    given[0, 0, 0] = 0.2
    others = replace(plain, surface=Surface(surface.points, surface.triangles, given))
    assert len({one.fingerprint() for one in (plain, with_normals, others, part())}) == 3


class Springs:
    """A provider that is not a finite-element code."""

    elements = ("springs",)

    def __init__(self):
        self.calls = 0

    def accepts(self, part):
        return part.element == "springs"

    def coefficients(self, parts, comm=None):
        self.calls += 1
        return {p.name: InfluenceCoefficients(p.name, np.eye(1), np.ones((1, 6))) for p in parts}

    def field(self, part, forces):
        return np.zeros((3, 6, forces.shape[1])), np.zeros((3, 6, 6))


class Assembly:
    parts = (part(),)


class EntryPoint:
    """A package's registration of a provider."""

    name = "theirs"

    def __init__(self, load):
        self.load = load


@pytest.fixture
def register(monkeypatch):
    """Registers one provider alone, by what loads its class."""

    def registered(load):
        points = [EntryPoint(load)]
        monkeypatch.setattr(provider, "entry_points", lambda group: points if group == provider.GROUP else [])
        provider.installed.cache_clear()

    yield registered
    provider.installed.cache_clear()


@pytest.fixture
def springs(register):
    made = Springs()
    register(lambda: lambda: made)
    return made


def test_another_program_can_provide_coefficients(springs, tmp_path):
    assert isinstance(springs, provider.Provider)
    found, cached = influence_coefficients(Assembly, tmp_path)
    assert found["p"].H == [[1.0]] and cached == {"p": False} and is_cached(part(), tmp_path)
    found, cached = influence_coefficients(Assembly, tmp_path)
    assert cached == {"p": True} and springs.calls == 1


class Rank:
    """One of two processes, as far as they share what the cache has: what the first sends is what the second gets."""

    def __init__(self, rank, wire):
        self.rank, self.size, self.wire = rank, 2, wire

    def bcast(self, thing):
        return self.wire.pop(0) if self.rank else self.wire.append(thing) or thing


@pytest.mark.parametrize("full", ["first", "second"])
def test_processes_with_different_caches_agree(springs, tmp_path, full):
    influence_coefficients(Assembly, tmp_path / full)
    wire = []
    found, cached = influence_coefficients(Assembly, tmp_path / "first", comm=Rank(0, wire))
    assert cached == {"p": full == "first"}
    second, same = influence_coefficients(Assembly, tmp_path / "second", comm=Rank(1, wire))
    assert same == cached and not wire and found["p"].H == [[1.0]]
    assert set(second) == ({"p"} if full == "second" else set())  # the first process alone reads its cache
    assert springs.calls == (1 if full == "first" else 3)  # both compute together, or none does


def test_only_the_first_process_writes_the_cache(springs, tmp_path):
    influence_coefficients(Assembly, tmp_path, comm=Rank(1, [{"p": False}]))
    assert not list(tmp_path.rglob("*.npz"))


def test_a_part_without_provider_is_refused_with_the_remedy(springs):
    springs.elements = ("springs", "beams")
    words = r"part 'p': .*theirs does not accept it.*install finite elements"
    with pytest.raises(MissingProvider, match=words):
        provider.find(part(element="beams"))


def test_an_unknown_element_is_refused_with_a_list_of_elements(springs):
    for refused in (lambda: provider.find(part(element="beams")), lambda: provider.check_element("beams")):
        with pytest.raises(SceneError, match="element: there is none called 'beams'; known: springs"):
            refused()
    provider.check_element("springs")


def test_a_provider_that_cannot_be_loaded_gives_the_reason(register):
    def load():
        raise ImportError("No module named 'dolfinx'")

    register(load)
    with pytest.raises(MissingProvider, match="theirs: No module named 'dolfinx'"):
        provider.find(part())
    provider.check_element("whatever")  # the known elements are incomplete
