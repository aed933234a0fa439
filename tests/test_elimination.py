"""Stage elimination against the saddle-point system that it condenses, solved whole and dense."""

import tracemalloc

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from mic.compliance.blocks import Blocks
from mic.compliance.elimination import eliminate
from mic.compliance.support import motion_size, statically_determinate
from mic.errors import FreeMotion

FREEDOMS, MODES = 30, 6


def free_part(rng):
    """A random free body: stiffness with six rigid motions, and readings of it on six pins."""
    R = rng.normal(size=(FREEDOMS, MODES))
    null = np.linalg.qr(R)[0]
    A = rng.normal(size=(FREEDOMS, FREEDOMS))
    elastic = np.eye(FREEDOMS) - null @ null.T
    K = elastic @ (A @ A.T + FREEDOMS * np.eye(FREEDOMS)) @ elastic
    L = rng.normal(size=(20, FREEDOMS))
    pinned = np.zeros((FREEDOMS, FREEDOMS))
    pinned[6:, 6:] = np.linalg.inv(K[6:, 6:])
    return K, R, L, L @ pinned @ L.T, L @ R


def blocks(H, G):
    """H and G of two parts of 20 functionals each."""
    return Blocks.single(H, G, [0, 20, 40])


@pytest.fixture
def two_parts():
    rng = np.random.default_rng(7)
    parts = [free_part(rng) for _ in range(2)]
    stack = [
        np.block([[p[i], np.zeros((p[i].shape[0], q[i].shape[1]))], [np.zeros((q[i].shape[0], p[i].shape[1])), q[i]]])
        for p, q in [parts]
        for i in range(5)
    ]
    return rng, *stack


def whole(K, L, bilateral, v, force_rows, force):
    """Freedoms and reactions of K u - Lᵀ Bᵀ λ = Lᵀ Fᵀ f, B L u = v."""
    B = bilateral @ L
    system = np.block([[K, -B.T], [B, np.zeros((len(B), len(B)))]])
    x = np.linalg.lstsq(system, np.r_[(force_rows @ L).T @ force, v], rcond=None)[0]
    assert np.allclose(system @ x, np.r_[(force_rows @ L).T @ force, v], atol=1e-8)
    return x[: K.shape[0]], x[K.shape[0] :]


@pytest.mark.parametrize("held", [12, 16])
def test_elimination_matches_the_whole_system(two_parts, held):
    rng, K, R, L, H, G = two_parts
    rows = {
        name: rng.normal(size=(count, 40))
        for name, count in (("bilateral", held), ("contact", 9), ("load", 2), ("output", 4))
    }
    stage = eliminate(blocks(H, G), *(csr_matrix(rows[name]) for name in rows))
    v, f, p = rng.normal(size=held), rng.normal(size=9), rng.normal(size=2)
    u, reaction = whole(K, L, rows["bilateral"], v, np.vstack([rows["contact"], rows["load"]]), np.r_[f, p])
    scale = np.abs(L @ u).max()
    np.testing.assert_allclose(stage.S @ f + stage.T @ v + stage.L @ p, rows["contact"] @ L @ u, atol=1e-8 * scale)
    np.testing.assert_allclose(
        stage.S_out @ f + stage.T_out @ v + stage.L_out @ p, rows["output"] @ L @ u, atol=1e-8 * scale
    )
    np.testing.assert_allclose(
        stage.reaction_S @ f + stage.reaction_T @ v + stage.reaction_L @ p, reaction, atol=1e-7 * np.abs(reaction).max()
    )
    assert np.linalg.eigvalsh(stage.S).min() > -1e-9 * np.abs(stage.S).max()


def test_redundant_rows_are_named_and_change_nothing(two_parts):
    rng, K, R, L, H, G = two_parts
    bilateral, contact = rng.normal(size=(14, 40)), csr_matrix(rng.normal(size=(6, 40)))
    none = csr_matrix((0, 40))
    once = eliminate(blocks(H, G), csr_matrix(bilateral), contact, none, none)
    doubled = np.vstack([bilateral, bilateral[3], 0.5 * (bilateral[1] - bilateral[13])])
    twice = eliminate(blocks(H, G), csr_matrix(doubled), contact, none, none)
    assert once.redundant == () and len(twice.redundant) == 2
    np.testing.assert_allclose(twice.S, once.S, rtol=0, atol=1e-8 * np.abs(once.S).max())


@pytest.mark.parametrize("noise", [-1e-13, 0.0, 1e-13])
def test_a_single_redundant_row_is_found_whatever_the_rounding(two_parts, noise):
    """Twelve rows hold two parts; a thirteenth that repeats one leaves nothing but rounding to eliminate."""
    rng, K, R, L, H, G = two_parts
    bilateral, contact, none = rng.normal(size=(12, 40)), csr_matrix(rng.normal(size=(6, 40))), csr_matrix((0, 40))
    twin = bilateral[4] * (1 + noise)
    once = eliminate(blocks(H, G), csr_matrix(bilateral), contact, none, none)
    twice = eliminate(blocks(H, G), csr_matrix(np.vstack([bilateral, twin])), contact, none, none)
    assert len(twice.redundant) == 1
    np.testing.assert_allclose(twice.S, once.S, rtol=0, atol=1e-8 * np.abs(once.S).max())


def test_a_part_that_can_move_is_refused(two_parts):
    rng, K, R, L, H, G = two_parts
    rows = csr_matrix(np.hstack([rng.normal(size=(11, 20)), np.zeros((11, 20))]))  # nothing holds the second part
    parts = blocks(H, G)
    with pytest.raises(FreeMotion, match="6 rigid-body motions are free") as caught:
        statically_determinate(parts.rigid(rows), motion_size(parts.G))
    motions = caught.value.motions
    assert np.linalg.norm(motions[6:]) == pytest.approx(np.linalg.norm(motions), rel=1e-6)


def test_support_does_not_matter(two_parts):
    """The same stage on coefficients from other pins."""
    rng, K, R, L, H, G = two_parts
    other = np.zeros_like(K)
    for start in (0, FREEDOMS):
        free = np.r_[start : start + 10, start + 16 : start + FREEDOMS]
        other[np.ix_(free, free)] = np.linalg.inv(K[np.ix_(free, free)])
    rows = [csr_matrix(rng.normal(size=(count, 40))) for count in (15, 6, 0, 3)]
    first, second = eliminate(blocks(H, G), *rows), eliminate(blocks(L @ other @ L.T, G), *rows)
    np.testing.assert_allclose(second.S, first.S, rtol=0, atol=1e-7 * np.abs(first.S).max())
    np.testing.assert_allclose(second.T_out, first.T_out, rtol=0, atol=1e-7 * np.abs(first.T_out).max())


def test_nothing_is_made_dense_over_all_parts():
    """Sixteen parts: what a stage costs follows its rows, not the square of all functionals."""
    rng = np.random.default_rng(11)
    parts, own = 16, 120
    H = [np.cov(rng.normal(size=(own, 2 * own))) for _ in range(parts)]
    compliance = Blocks(tuple(H), tuple(rng.normal(size=(own, 6)) for _ in range(parts)))
    F = compliance.size

    def rows(*functionals):
        return csr_matrix(
            (np.ones(len(functionals)), (np.arange(len(functionals)), functionals)), (len(functionals), F)
        )

    held = rows(*(p * own + i for p in range(parts) for i in range(6)))
    pairs = rows(*(p * own + 7 for p in range(1, parts))) - rows(*(p * own + 8 for p in range(parts - 1)))
    tracemalloc.start()
    try:
        response = eliminate(compliance, held, pairs, csr_matrix((0, F)), rows(9, F - 1))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert response.S.shape == (parts - 1, parts - 1) and np.linalg.eigvalsh(response.S).min() > 0
    assert peak < 0.1 * 8 * F**2, (
        f"{peak / 1e6:.1f} MB where the dense compliance of all parts has {8e-6 * F**2:.1f} MB"
    )
