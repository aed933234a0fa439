"""Stage elimination against the dense saddle-point system that it condenses."""

import pickle
import tracemalloc

import numpy as np
import pytest
from scipy.linalg import block_diag
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
    own = slice(20), slice(20, 40)
    return Blocks(tuple(H[part, part] for part in own), (G[:20, :6], G[20:, 6:]))


@pytest.fixture
def two_parts():
    rng = np.random.default_rng(7)
    return rng, *map(block_diag, free_part(rng), free_part(rng))


def whole(K, L, bilateral, v, force_rows, force):
    """Freedoms and reactions of K u - Lᵀ Bᵀ λ = Lᵀ Fᵀ f, B L u = v."""
    B = bilateral @ L
    system = np.block([[K, -B.T], [B, np.zeros((len(B), len(B)))]])
    x = np.linalg.lstsq(system, np.r_[(force_rows @ L).T @ force, v], rcond=None)[0]
    assert np.allclose(system @ x, np.r_[(force_rows @ L).T @ force, v], atol=1e-8)
    return x[: K.shape[0]], x[K.shape[0] :]


@pytest.mark.parametrize("held", [12, 16])
def test_elimination_equals_the_saddle_point_system(two_parts, held):
    rng, K, R, L, H, G = two_parts
    counts = {"bilateral": held, "contact": 9, "load": 2, "output": 4}
    rows = {name: rng.normal(size=(count, 40)) for name, count in counts.items()}
    stage = eliminate(blocks(H, G), *map(csr_matrix, rows.values()))
    v, f, p = rng.normal(size=held), rng.normal(size=9), rng.normal(size=2)
    u, reaction = whole(K, L, rows["bilateral"], v, np.vstack([rows["contact"], rows["load"]]), np.r_[f, p])
    scale = np.abs(L @ u).max()
    moved = stage.S.whole() @ f + stage.T @ v + stage.L @ p
    read = stage.S_out.whole() @ f + stage.T_out @ v + stage.L_out @ p
    held_by = stage.reaction_S @ f + stage.reaction_T @ v + stage.reaction_L @ p
    np.testing.assert_allclose(moved, rows["contact"] @ L @ u, atol=1e-8 * scale)
    np.testing.assert_allclose(read, rows["output"] @ L @ u, atol=1e-8 * scale)
    np.testing.assert_allclose(held_by, reaction, atol=1e-7 * np.abs(reaction).max())
    assert np.linalg.eigvalsh(stage.S.whole()).min() > -1e-9 * np.abs(stage.diagonal).max()


def test_redundant_rows_are_named_and_change_nothing(two_parts):
    rng, K, R, L, H, G = two_parts
    bilateral, contact = rng.normal(size=(14, 40)), csr_matrix(rng.normal(size=(6, 40)))
    none = csr_matrix((0, 40))
    once = eliminate(blocks(H, G), csr_matrix(bilateral), contact, none, none)
    doubled = np.vstack([bilateral, bilateral[3], 0.5 * (bilateral[1] - bilateral[13])])
    twice = eliminate(blocks(H, G), csr_matrix(doubled), contact, none, none)
    assert once.redundant == () and len(twice.redundant) == 2
    np.testing.assert_allclose(twice.S.whole(), once.S.whole(), rtol=0, atol=1e-8 * np.abs(once.diagonal).max())


def test_a_single_redundant_row_is_found_despite_rounding(two_parts):
    """Twelve rows hold two parts; a thirteenth that repeats one leaves nothing but rounding to eliminate."""
    rng, K, R, L, H, G = two_parts
    bilateral, contact, none = rng.normal(size=(12, 40)), csr_matrix(rng.normal(size=(6, 40))), csr_matrix((0, 40))
    once = eliminate(blocks(H, G), csr_matrix(bilateral), contact, none, none)
    for noise in (-1e-13, 0.0, 1e-13):
        doubled = csr_matrix(np.vstack([bilateral, bilateral[4] * (1 + noise)]))
        twice = eliminate(blocks(H, G), doubled, contact, none, none)
        assert len(twice.redundant) == 1
        np.testing.assert_allclose(twice.S.whole(), once.S.whole(), rtol=0, atol=1e-8 * np.abs(once.diagonal).max())


def test_a_part_that_can_move_is_refused(two_parts):
    rng, K, R, L, H, G = two_parts
    rows = csr_matrix(np.hstack([rng.normal(size=(11, 20)), np.zeros((11, 20))]))  # nothing holds the second part
    parts = blocks(H, G)
    with pytest.raises(FreeMotion, match="6 rigid-body motions are free") as caught:
        statically_determinate(parts.rigid(rows), motion_size(parts.G))
    motions = caught.value.motions
    assert np.linalg.norm(motions[6:]) == pytest.approx(np.linalg.norm(motions), rel=1e-6)


def test_the_choice_of_six_locators_does_not_depend_on_rotation_or_units():
    """Eleven locators on a rectangle, of which several choices of six hold it as well."""
    x, y, long, wide = [1, 0, 0], [0, 1, 0], 40.0, 20.0
    rest = [(a * long, b * wide, 0.0) for a in (0, 0.5, 1) for b in (0, 0.5, 1) if (a, b) != (0.5, 0.5)]
    point = np.array([*rest, (0, 0, 0), (long, 0, 0), (0, wide / 2, 0)]) - [long / 2, wide / 2, 0]
    direction = np.array([[0, 0, 1]] * len(rest) + [y, y, x], dtype=float)
    chosen = set()
    for seed in range(20):
        turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
        for unit in (1.0, 25.4, 1000.0):
            p, d = point @ turn / unit, direction @ turn
            displacements = np.hstack([d, np.cross(p, d)])
            rotations = np.hstack([np.zeros((3, 3)), turn])
            size = motion_size((np.vstack([displacements, rotations]),))
            chosen.add(tuple(statically_determinate(displacements, size)))
    assert len(chosen) == 1


def readings(F, functionals):
    """Rows that read one functional each."""
    shape = len(functionals), F
    return csr_matrix((np.ones(len(functionals)), (np.arange(len(functionals)), functionals)), shape)


def test_no_dense_matrix_over_all_parts_is_formed():
    """Sixteen parts: what a stage costs follows its rows, not the square of all functionals."""
    rng = np.random.default_rng(11)
    parts, own = 16, 120
    H = [np.cov(rng.normal(size=(own, 2 * own))) for _ in range(parts)]
    compliance = Blocks(tuple(H), tuple(rng.normal(size=(own, 6)) for _ in range(parts)))
    F, first = compliance.size, own * np.arange(parts)
    held = readings(F, (first[:, None] + np.arange(6)).ravel())
    pairs = readings(F, first[1:] + 7) - readings(F, first[:-1] + 8)
    tracemalloc.start()
    try:
        response = eliminate(compliance, held, pairs, csr_matrix((0, F)), readings(F, [9, F - 1]))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert response.S.shape == (parts - 1, parts - 1) and np.linalg.eigvalsh(response.S.whole()).min() > 0
    assert peak < 0.1 * 8 * F**2, f"{peak / 1e6:.1f} MB; the compliance of all parts has {8e-6 * F**2:.1f} MB"


def pressed(rng, yields=None, series=None):
    """Two held parts with forty contact rows, and all rows by name; H without pins, so that little cancels."""
    parts = [free_part(rng) for _ in range(2)]
    free = tuple(L @ np.linalg.pinv(K, rcond=1e-10) @ L.T for K, _, L, _, _ in parts)
    compliance = Blocks(free, tuple(part[4] for part in parts))
    count = {"bilateral": 15, "contact": 40, "load": 1, "output": 5}
    rows = {name: csr_matrix(rng.normal(size=(number, 40))) for name, number in count.items()}
    return compliance, rows, eliminate(compliance, *rows.values(), yields, series)


@pytest.mark.parametrize("soft", [False, True])
def test_columns_on_demand_equal_the_dense_compliance(soft):
    """Against the rows eliminated from dense matrices, in one step: the inverse of the saddle-point system."""
    rng = np.random.default_rng(5)
    yields = rng.uniform(0.5, 1.0, 15) if soft else None
    series = rng.uniform(0.5, 1.0, 40) if soft else None
    compliance, rows, stage = pressed(rng, yields, series)
    H, G = compliance.dense()
    B, C, O = (rows[name].toarray() for name in ("bilateral", "contact", "output"))
    held = B @ H @ B.T + np.diag(np.zeros(15) if yields is None else yields)
    system = np.linalg.inv(np.block([[held, B @ G], [(B @ G).T, np.zeros((12, 12))]]))

    def dense(J):
        left, right = np.hstack([J @ H @ B.T, J @ G]), np.hstack([C @ H @ B.T, C @ G])
        return J @ H @ C.T - left @ system @ right.T

    S = dense(C) + np.diag(np.zeros(40) if series is None else series)
    own = rng.permutation(40)[:13]
    np.testing.assert_allclose(stage.S.take(own), S[own], rtol=0, atol=1e-12 * np.abs(S).max())
    np.testing.assert_allclose(stage.S_out.take(own), dense(O).T[own], rtol=0, atol=1e-12 * np.abs(dense(O)).max())
    assert stage.S.found == stage.S_out.found == 13
    np.testing.assert_allclose(stage.diagonal, np.diag(S), rtol=0, atol=1e-12 * np.abs(S).max())
    force = rng.normal(size=(3, 40)) * (rng.random(40) < 0.5)
    np.testing.assert_allclose(stage.S.under(force), force @ S, rtol=0, atol=1e-11 * np.abs(S).max())
    np.testing.assert_allclose(stage.S.block(own), S[np.ix_(own, own)], rtol=0, atol=1e-12 * np.abs(S).max())


def test_displacements_do_not_depend_on_earlier_requests():
    force = np.random.default_rng(8).normal(size=(6, 40)) * (np.random.default_rng(9).random((6, 40)) < 0.3)
    alone, together = (pressed(np.random.default_rng(5))[2].S for _ in range(2))
    together.take(np.array([39, 2, 17]))
    together = pickle.loads(pickle.dumps(together))  # as another process gets it
    assert together.found == 3
    every = together.under(force)
    for sample in (4, 1, 5, 0, 3, 2):
        assert (alone.under(force[[sample]])[0] == every[sample]).all()


def test_a_fixed_contact_has_no_negative_compliance():
    """Welded where it stands: but for rounding, which a solver would refuse."""
    for seed in range(8):
        compliance, rows, _ = pressed(np.random.default_rng(seed))
        contact = csr_matrix(np.vstack([rows["bilateral"].toarray(), rows["contact"].toarray()[:2]]))
        none = csr_matrix((0, 40))
        S = eliminate(compliance, rows["bilateral"], contact, none, none).S.whole()
        assert S.diagonal().min() >= 0 and S.diagonal()[:15].max() < 1e-10 * S.diagonal().max()
