"""Where a state x = (pose, landmarks) holds what, and matrices made of its 3x3 blocks."""

import numpy as np

from vislam.arrays import Array, IntArray

POSE = slice(0, 6)
MAP = slice(6, None)


def rows_of(slots: IntArray) -> IntArray:
    """The rows of the state that landmarks take, by their places (k,) among them: (k, 3)."""
    return 6 + 3 * slots[:, None] + np.arange(3)


def diagonal_blocks(P: Array) -> Array:
    """The 3x3 blocks on the diagonal of (..., 3m, 3m): a view of shape (..., m, 3, 3)."""
    m = P.shape[-1] // 3
    blocks: Array = np.einsum("...iaib->...iab", P.reshape(*P.shape[:-2], m, 3, m, 3))
    return blocks


def block_diagonal(blocks: Array) -> Array:
    """The matrix (..., 3m, 3m) with blocks (..., m, 3, 3) on its diagonal, zeros elsewhere."""
    size = 3 * blocks.shape[-3]
    out = np.zeros((*blocks.shape[:-3], size, size))
    diagonal_blocks(out)[...] = blocks
    return out


def times_blocks(D: Array, X: Array) -> Array:
    """Each 3x3 block of D, shape (..., m, 3, 3), times its three rows of X, (..., 3m, c)."""
    return np.asarray((D @ X.reshape(*X.shape[:-2], -1, 3, X.shape[-1])).reshape(X.shape))
