"""The kernels against numpy's functions, for every batch shape; a matrix without a root affects no
other matrix.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from celnav.filters.adaptive import range_basis
from celnav.gaussian.linalg import (
    POSITIVE,
    SquareRoot,
    block,
    cholesky,
    downdate,
    matvec,
    semidefinite_root,
    solve_lower,
    solve_positive,
    solve_right,
    tria,
)

BATCHES = [(), (3,), (2, 3)]
shapes = st.tuples(
    st.sampled_from(BATCHES), st.integers(1, 6), st.integers(1, 9), st.integers(0, 2**32 - 1)
)


def columns(shape):
    batch, n, q, seed = shape
    return np.random.default_rng(seed).normal(size=(*batch, n, q))


def lower(rng, *shape):
    return np.tril(rng.normal(size=shape)) + 3.0 * np.eye(shape[-1])


@settings(max_examples=60, deadline=None)
@given(shapes)
def test_tria_is_a_lower_root_with_non_negative_diagonal(shape):
    A = columns(shape)
    L = tria(A)
    assert L.shape == (*A.shape[:-1], A.shape[-2])
    assert (np.triu(L, 1) == 0.0).all()
    assert (L.diagonal(0, -2, -1) >= 0.0).all()
    np.testing.assert_allclose(
        L @ L.mT, A @ A.mT, rtol=0.0, atol=1e-13 * max(1.0, np.abs(A @ A.mT).max())
    )


@settings(max_examples=30, deadline=None)
@given(shapes)
def test_tria_of_a_batch_is_tria_of_each(shape):
    A = columns(shape)
    each = np.array([tria(a) for a in A.reshape(-1, *A.shape[-2:])]).reshape(tria(A).shape)
    # With fewer columns than rows the last diagonal elements are round-off, and so are the
    # quotients with them.
    np.testing.assert_allclose(
        tria(A) @ tria(A).mT,
        each @ each.mT,
        rtol=0.0,
        atol=1e-12 * max(1.0, np.abs(A @ A.mT).max()),
    )
    if A.shape[-1] > A.shape[-2] + 2:
        np.testing.assert_allclose(tria(A), each, rtol=1e-9, atol=1e-12)


def test_tria_keeps_digits_that_the_product_loses():
    """Läuchli's matrix: the product loses the small number, the root does not."""
    e = 1e-9
    A = np.array([[1.0, e, 0.0], [1.0, 0.0, e]])
    L = tria(A)
    np.testing.assert_allclose(np.linalg.det(L), np.sqrt(2.0) * e, rtol=1e-6)
    assert np.isnan(cholesky(A @ A.T)).all()


@pytest.mark.parametrize("batch", BATCHES)
def test_substitution_solves(batch):
    rng = np.random.default_rng(4)
    L, B = lower(rng, *batch, 5, 5), rng.normal(size=(*batch, 5, 2))
    np.testing.assert_allclose(L @ solve_lower(L, B), B, atol=1e-13)
    np.testing.assert_allclose(solve_right(L, B.mT) @ L, B.mT, atol=1e-13)


def test_substitution_broadcasts_either_operand():
    rng = np.random.default_rng(5)
    L, B = lower(rng, 4, 3, 3), rng.normal(size=(3, 2))
    np.testing.assert_allclose(L @ solve_lower(L, B), np.broadcast_to(B, (4, 3, 2)), atol=1e-13)
    L, B = L[0], rng.normal(size=(4, 3, 2))
    np.testing.assert_allclose(L @ solve_lower(L, B), B, atol=1e-13)


def test_substitution_reads_the_lower_triangle_only():
    rng = np.random.default_rng(6)
    L, B = lower(rng, 4, 4), rng.normal(size=(4, 1))
    junk = L + np.triu(rng.normal(size=(4, 4)), 1)
    np.testing.assert_array_equal(solve_lower(junk, B), solve_lower(L, B))


@pytest.mark.parametrize("batch", [(), (2,)])
def test_substitution_by_a_zero_gives_nan_not_an_exception(batch):
    L, B = np.zeros((*batch, 2, 2)), np.ones((*batch, 2, 1))
    L[..., 0, 0] = 1.0
    assert np.isnan(solve_lower(L, B)[..., 1, 0]).all()


def test_a_zero_in_one_run_leaves_the_others_alone():
    rng = np.random.default_rng(7)
    L, B = lower(rng, 3, 4, 4), rng.normal(size=(3, 4, 1))
    alone = solve_lower(L, B)
    L[1, 2, 2] = 0.0
    together = solve_lower(L, B)
    np.testing.assert_array_equal(together[[0, 2]], alone[[0, 2]])
    assert np.isnan(together[1]).any()


@pytest.mark.parametrize("batch", BATCHES)
def test_cholesky_is_numpys(batch):
    rng = np.random.default_rng(8)
    A = rng.normal(size=(*batch, 4, 7))
    np.testing.assert_allclose(
        cholesky(A @ A.mT), np.linalg.cholesky(A @ A.mT), rtol=1e-12, atol=1e-13
    )


@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["positive", "indefinite"])
def test_a_symmetric_system_is_solved(batch, sign):
    rng = np.random.default_rng(9)
    A, x = rng.normal(size=(*batch, 4, 7)), rng.normal(size=(*batch, 4))
    S = A @ (A * np.array([sign] * 2 + [1.0] * 5)).mT
    np.testing.assert_allclose(matvec(S, solve_positive(S, x)), x, rtol=1e-9, atol=1e-11)


def test_cholesky_takes_units_as_they_come():
    """Kilometers and radians in one matrix: the smaller unit is not round-off of the larger."""
    scale = np.array([1e6, 1e-9, 1.0])
    C = np.array([[1.0, 0.5, 0.2], [0.5, 1.0, 0.1], [0.2, 0.1, 1.0]])
    L = cholesky(scale[:, None] * C * scale)
    np.testing.assert_allclose(L / scale[:, None], np.linalg.cholesky(C), rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("root", [cholesky, semidefinite_root])
@pytest.mark.parametrize(
    "culprit", [np.diag([1.0, -1.0, 1.0]), np.full((3, 3), np.nan), -np.eye(3)]
)
def test_an_indefinite_matrix_becomes_nan_and_its_neighbors_do_not_notice(root, culprit):
    rng = np.random.default_rng(9)
    A = rng.normal(size=(4, 3, 5))
    P = A @ A.mT
    alone = root(P)
    P[2] = culprit
    together = root(P)
    assert np.isnan(together[2].diagonal()).all()
    np.testing.assert_array_equal(together[[0, 1, 3]], alone[[0, 1, 3]])


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
def test_semidefinite_root_of_any_rank(rank):
    A = np.random.default_rng(rank).normal(size=(2, 3, rank)) * np.array([1e3, 1.0, 1e-6])[:, None]
    L = semidefinite_root(A @ A.mT)
    scale = np.sqrt(np.maximum((A @ A.mT).diagonal(0, -2, -1), 1e-300))
    error = (L @ L.mT - A @ A.mT) / (scale[..., None] * scale[..., None, :])
    assert np.abs(error).max() < 1e-13
    assert (np.triu(L, 1) == 0.0).all()


def test_semidefinite_root_refuses_what_is_indefinite_beyond_round_off():
    P = np.array([[1.0, 1.0], [1.0, 1.0]])
    root = semidefinite_root(P)
    np.testing.assert_allclose(root @ root.T, P, rtol=1e-13)
    assert np.isnan(semidefinite_root(P + np.diag([0.0, -1e-9]))).all()


@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("k", [1, 3])
def test_downdate_takes_columns_away(batch, k):
    rng = np.random.default_rng(10)
    L, V = lower(rng, *batch, 4, 4), rng.normal(size=(*batch, 4, k))
    D = downdate(tria(np.concatenate([L, V], -1)), V)
    np.testing.assert_allclose(D @ D.mT, L @ L.mT, atol=1e-11)
    assert (np.triu(D, 1) == 0.0).all()


def test_downdate_fails_exactly_where_the_difference_is_indefinite():
    L = np.broadcast_to(np.eye(3), (4, 3, 3))
    size = np.array([0.5, 1.0 + 1e-9, 1.0 - 1e-9, 2.0])
    V = np.zeros((4, 3, 1))
    V[:, 1, 0] = size
    lost = np.isnan(downdate(L, V)).all((-2, -1))
    np.testing.assert_array_equal(lost, size > 1.0)
    assert not np.isnan(downdate(L, V)[~lost]).any()


@pytest.mark.parametrize(("noise_first", "rtol"), [(False, 1e-12), (True, 1e-6)])
def test_an_update_keeps_what_a_downdate_loses(noise_first, rtol):
    """A variance of 1, measured with standard deviation 1e-9: the remaining variance is below the
    rounding of 1.
    """
    noise = 1e-9
    exact, parts = (
        noise / np.hypot(1.0, noise),
        [np.array([[1.0], [1.0]]), np.array([[noise], [0.0]])],
    )
    S, U, left = SquareRoot.condition(
        np.concatenate(parts[::-1] if noise_first else parts, -1), POSITIVE, 1
    )
    np.testing.assert_allclose((S, U, left), [[[1.0]], [[1.0]], [[exact]]], rtol=rtol)
    assert np.isnan(downdate(np.eye(1), U)).all()
    assert 1.0 - 1.0 / (1.0 + noise**2) == 0.0


def test_downdate_of_a_singular_root():
    """Also in a batch with regular matrices; the columns to subtract must lie in the range."""
    rng = np.random.default_rng(12)
    columns = rng.normal(size=(3, 4, 2))
    taken = columns @ np.array([[0.6], [0.3]])
    L = tria(columns)
    L[2] = lower(rng, 4, 4)
    D = downdate(L, taken)
    np.testing.assert_allclose(D @ D.mT, L @ L.mT - taken @ taken.mT, atol=1e-13)
    assert (np.triu(D, 1) == 0.0).all()
    taken[0] += 1e-9 * rng.normal(size=(4, 1))
    taken[1] *= 2.0
    np.testing.assert_array_equal(np.isnan(downdate(L, taken)).all((-2, -1)), [True, True, False])


def test_matvec_broadcasts():
    rng = np.random.default_rng(11)
    A, x = rng.normal(size=(3, 2)), rng.normal(size=(5, 4, 2))
    np.testing.assert_allclose(matvec(A, x), x @ A.T, atol=1e-15)
    A = rng.normal(size=(4, 3, 2))
    np.testing.assert_allclose(matvec(A, x), np.einsum("bij,abj->abi", A, x), atol=1e-14)


def test_block_sizes_zeros_by_their_neighbors_and_broadcasts():
    A, B, C = np.ones((2, 1, 2)), np.full((1, 3), 2.0), np.full((2, 3), 3.0)
    M = block([[A, B], [0, C]])
    expected = np.array([[1, 1, 2, 2, 2], [0, 0, 3, 3, 3], [0, 0, 3, 3, 3]])
    np.testing.assert_array_equal(M, np.broadcast_to(expected, (2, 3, 5)))


@pytest.mark.parametrize("n", [2, 5, 8])
def test_the_root_of_a_singular_covariance_leaves_out_what_it_does_not_have(n):
    """In any position of the null space, whether or not Cholesky notices."""
    rng = np.random.default_rng(n)
    for _ in range(50):
        turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
        values = np.append(rng.uniform(0.1, 10.0, n - 1), 0.0)
        P = (turn * values) @ turn.T
        root = semidefinite_root(0.5 * (P + P.T))
        assert np.abs(turn[:, -1] @ root).max() < 1e-11
        np.testing.assert_allclose(root @ root.T, P, atol=1e-13)


@pytest.mark.parametrize("zero", [[], [0], [1, 3]])
def test_a_basis_of_a_range_projects_on_it(zero):
    rng = np.random.default_rng(0)
    A = rng.normal(size=(5, 7, 4))
    A[..., zero] = 0.0
    A[3, :, 2] = (
        A[3, :, 1] + 1e-9 * A[3, :, 2]
    )  # one matrix of the batch has a dependent column as well
    Q = range_basis(A, 1e-6)
    for one, basis in zip(A, Q, strict=True):
        U, s, _ = np.linalg.svd(one)
        rank = (s > 1e-6).sum()
        np.testing.assert_allclose(basis @ basis.T, U[:, :rank] @ U[:, :rank].T, atol=1e-12)
        np.testing.assert_allclose(range_basis(one[None], 1e-6)[0], basis, atol=1e-12)
