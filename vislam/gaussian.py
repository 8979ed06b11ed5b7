"""The linear algebra of a Kalman update, on plain arrays.

The measurement noise is whitened beforehand, so R = I everywhere. One state (n, n) goes straight to
LAPACK and BLAS; states with batch axes (..., n, n) through numpy's stacked routines.
"""

from functools import cache

import numpy as np
from scipy.linalg.blas import dgemm, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf
from scipy.special import chdtri

from vislam.arrays import Array


class NotPositiveDefinite(ValueError):
    """A matrix I + H P H^T has lost its definiteness: P is no covariance."""


def cholesky(S: Array) -> Array:
    """The lower L with S = L L^T, shape (..., k, k); S is given up.

    Raises:
        NotPositiveDefinite: S is not positive definite, or not finite.
    """
    try:
        return _cholesky_one(S) if S.ndim == 2 else np.asarray(np.linalg.cholesky(S))
    except np.linalg.LinAlgError as error:
        raise NotPositiveDefinite(
            "Expected a positive definite matrix I + H P H^T. The state's covariance is not "
            "positive semidefinite, or not finite: check the prior and the noise that were told."
        ) from error


def _cholesky_one(S: Array) -> Array:
    # S is symmetric, so its transpose is the same matrix in the order that LAPACK works in
    L, info = dpotrf(S.T, lower=1, clean=1, overwrite_a=1)
    if info or not np.isfinite(L[-1:, -1:]).all():
        raise np.linalg.LinAlgError
    return np.asarray(L)


def solve_lower(L: Array, X: Array) -> Array:
    """L^-1 X for a lower triangular L, shapes (..., k, k) and (..., k, n); X is given up."""
    if L.ndim > 2:
        return np.asarray(np.linalg.solve(L, X))
    if X.shape[-1] == 1 and X.size:
        return np.asarray(dtrsv(L, X[:, 0], lower=1))[:, None]
    X = np.ascontiguousarray(X, float)
    if X.size:
        _solve_in_place(L, X)
    return X


#: Up to so many rows a triangular solve is left to BLAS, whose own is slower than its product: by
#: halves it takes a tenth less time at 150 rows, a quarter at 300 and more.
_ROWS = 96


def _solve_in_place(L: Array, X: Array) -> None:
    rows = len(L)
    if rows <= _ROWS:
        # X^T L^-T: X^T of an X by rows is in the order that BLAS works in
        dtrsm(1.0, L, X.T, side=1, lower=1, trans_a=1, overwrite_b=1)
    else:
        first, rest = slice(rows // 2), slice(rows // 2, None)
        _solve_in_place(L[first, first], X[first])
        dgemm(-1.0, X[first].T, L[rest, first], 1.0, X[rest].T, trans_b=1, overwrite_c=1)
        _solve_in_place(L[rest, rest], X[rest])


def subtract_gram(P: Array, Y_T: Array) -> Array:
    """P - Y Y^T for Y_T = Y^T of shape (..., k, n), in the place of P.

    The product of a matrix with its own transpose is one symmetric rank-k update in BLAS, so the
    result is exactly as symmetric as P.
    """
    P -= transposed(Y_T) @ Y_T
    return P


def add_product(C: Array, A: Array, B: Array) -> Array:
    """C + A B^T in the place of a C of float64, shapes (..., m, n), (..., m, k) and (..., n, k)."""
    if C.ndim > 2 or not (C.size and C.flags.c_contiguous):
        C += A @ transposed(B)
    else:
        # C^T is C in the order that BLAS works in; so are A^T and B^T, and C^T grows by B A^T
        dgemm(1.0, B.T, A.T, 1.0, C.T, trans_a=1, overwrite_c=1)
    return C


def reuse_freed_memory() -> None:
    """Let glibc's malloc keep the memory of large arrays for the next ones.

    Above a threshold it maps each array anew, and the kernel pays for every page of it. The
    threshold rises to the largest block that was freed, 32 MB at most; nothing is touched here.
    With 60 sightings a frame that takes a fifth of the time away; with other allocators it does
    nothing.
    """
    np.empty(31 * 2**17)


def square_root(Q: Array) -> Array:
    """An A with Q = A A^T, for covariances of any rank, shape (..., c, c)."""
    values, vectors = np.linalg.eigh(Q)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0))[..., None, :])


def transposed(A: Array) -> Array:
    """The last two axes swapped."""
    return np.swapaxes(A, -1, -2)


def symmetrised(P: Array) -> Array:
    """(P + P^T) / 2."""
    return 0.5 * (P + transposed(P))


@cache
def gate_threshold(probability: float, dof: int) -> float:
    """The squared Mahalanobis distance that a right innovation stays below with `probability`."""
    return float(chdtri(dof, 1 - probability))


def covariance_fault(P: Array) -> str | None:
    """What keeps P, shape (n, n), from being a covariance; None where it is one.

    Symmetric to 1e-12 of its largest element, and no eigenvalue below -1e-12 of the largest.
    """
    if not np.isfinite(P).all():
        return "an element is not finite"
    scale = float(np.abs(P).max(initial=0.0))
    if scale == 0:
        return None
    asymmetry = float(np.abs(P - P.T).max())
    if asymmetry > 1e-12 * scale:
        return f"asymmetric by {asymmetry / scale:.1e} of its largest element"
    eigenvalues = np.linalg.eigvalsh(P)
    if eigenvalues[0] < -1e-12 * eigenvalues[-1]:
        return f"smallest eigenvalue {eigenvalues[0]:.1e}, largest {eigenvalues[-1]:.1e}"
    return None
