"""The linear algebra of an update against scipy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import solve_triangular

from vislam.gaussian import cholesky, solve_lower, square_root, symmetrised


def definite(rng, size):
    """A covariance of a condition of about 1e4."""
    A = rng.standard_normal((size, size))
    return A @ A.T / size + 1e-3 * np.eye(size)


@pytest.mark.parametrize("columns", [0, 1, 7, 156])
@pytest.mark.parametrize("rows", [0, 1, 95, 96, 97, 150, 193, 450])
def test_a_triangular_solve_is_scipy_s_at_any_size(rows, columns):
    rng = np.random.default_rng(rows)
    L, X = cholesky(definite(rng, rows)), rng.standard_normal((rows, columns))
    expected = solve_triangular(L, X, lower=True) if rows else X
    scale = np.abs(expected).max(initial=0)
    assert_allclose(solve_lower(L, X.copy()), expected, rtol=0, atol=1e-11 * scale)
    several = solve_lower(np.stack([L, 2 * L]), np.stack([X, X]))
    assert_allclose(several, [expected, expected / 2], rtol=0, atol=1e-11 * scale)


def test_a_triangular_solve_takes_arrays_of_any_order():
    rng = np.random.default_rng(0)
    L, X = cholesky(definite(rng, 120)), rng.standard_normal((120, 40))
    expected = solve_triangular(L, X, lower=True)
    assert_allclose(solve_lower(L, np.asfortranarray(X)), expected, atol=1e-12)
    assert_allclose(solve_lower(L, np.repeat(X, 2, axis=1)[:, ::2]), expected, atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), rank=st.integers(0, 6))
def test_a_square_root_is_one_at_any_rank(seed, rank):
    A = np.random.default_rng(seed).standard_normal((2, 6, rank))
    Q = symmetrised(A @ np.swapaxes(A, -1, -2))
    R = square_root(Q)
    assert_allclose(R @ np.swapaxes(R, -1, -2), Q, rtol=0, atol=1e-13 * max(np.abs(Q).max(), 1))
