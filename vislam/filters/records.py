"""The four ways in which the covariance of an EKF's state changes, each as a record.

The state is x = (pose, landmarks). Every change of its covariance P is one of these, applied by
`forward`. What judges a filter from inside reads the same records that moved it, and so does the
backward pass: `backward` carries a `Later` over a record against time.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from vislam.arrays import Array, IntArray
from vislam.gaussian import solve_lower_transposed, subtract_gram, symmetrised, transposed

POSE = slice(0, 6)
MAP = slice(6, None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Later:
    """What all updates after a moment say of the state then (modified Bryson-Frazier).

    Whatever has cross-covariance C with the state, shape (c, n), is moved by those updates by
    C mean, and loses C information C^T of its covariance.

    Attributes:
        mean: lambda, shape (..., n).
        information: Lambda, shape (..., n, n).
    """

    mean: Array
    information: Array

    @classmethod
    def nothing(cls, P: Array) -> "Later":
        """No update is to come for a state of covariance P, shape (..., n, n)."""
        return cls(mean=np.zeros(P.shape[:-1]), information=np.zeros(P.shape))


@dataclass(frozen=True, slots=True, kw_only=True)
class Linear:
    """x_R <- F x_R + w, w ~ N(0, Q), and m <- m + M x_R: a prediction, or a transport.

    Attributes:
        F: shape (..., 6, 6).
        Q: shape (..., 6, 6); None without noise.
        M: shape (..., 3m, 6); None where the landmarks stay as they are.
    """

    F: Array
    Q: Array | None = None
    M: Array | None = None

    def forward(self, P: Array) -> Array:
        """The covariance afterwards; both cross blocks move with the pose (the paper, III.C.2)."""
        P = P.copy()
        pose, cross = P[..., POSE, POSE].copy(), P[..., POSE, MAP]
        if self.M is not None:
            by_map = self.M @ cross
            P[..., MAP, MAP] += by_map + transposed(by_map)
            P[..., MAP, MAP] += symmetrised(self.M @ pose @ transposed(self.M))
            cross = cross + pose @ transposed(self.M)
        P[..., POSE, MAP] = self.F @ cross
        P[..., MAP, POSE] = transposed(P[..., POSE, MAP])
        pose = self.F @ pose @ transposed(self.F)
        P[..., POSE, POSE] = symmetrised(pose if self.Q is None else pose + self.Q)
        return P

    def backward(self, later: Later) -> Later:
        """A^T mean and A^T information A for A = [F, 0; M, I]."""
        columns = self.F if self.M is None else np.concatenate([self.F, self.M], axis=-2)
        part = slice(0, columns.shape[-2])  # the rows that A gathers into the pose's
        mean, information = later.mean.copy(), later.information.copy()
        mean[..., POSE] = _times(transposed(columns), later.mean[..., part])
        information[..., POSE, :] = transposed(columns) @ information[..., part, :]
        information[..., POSE] = information[..., part] @ columns
        return Later(mean=mean, information=information)


@dataclass(frozen=True, slots=True, kw_only=True)
class Correct:
    """An update by a whitened observation z = H x + v, v ~ N(0, I), of the pose and k landmarks.

    Attributes:
        slots: place of each observed landmark among the state's, shape (k,).
        H_pose: shape (..., 3k, 6).
        H_map: shape (..., k, 3, 3).
        L: lower factor of the innovation covariance S = H P H^T + I, shape (..., 3k, 3k).
        whitened: L^-1 r, shape (..., 3k).
        Y_T: L^-1 H P, shape (..., 3k, n); the gain is K = Y L^-1.
    """

    slots: IntArray
    H_pose: Array
    H_map: Array
    L: Array
    whitened: Array
    Y_T: Array

    def forward(self, P: Array) -> Array:
        """(I - K H) P = P - Y Y^T."""
        return subtract_gram(P, self.Y_T)

    @property
    def delta(self) -> Array:
        """K r, shape (..., n)."""
        return _times(transposed(self.Y_T), self.whitened)

    def backward(self, later: Later) -> Later:
        """(I - K H)^T mean + H^T S^-1 r, and (I - K H)^T information (I - K H) + H^T S^-1 H.

        With Y = P H^T L^-T and W = Y^T information, the second is information + Z + Z^T for
        Z = H^T (L^-T (W Y + I) L^-1 H / 2 - L^-T W).
        """
        said = self.whitened - _times(self.Y_T, later.mean)
        W = self.Y_T @ later.information
        inner = W @ transposed(self.Y_T) + np.eye(self.L.shape[-1])
        inner = solve_lower_transposed(self.L, inner)
        inner = symmetrised(solve_lower_transposed(self.L, transposed(inner)))
        half = 0.5 * transposed(self._H_T(inner)) - solve_lower_transposed(self.L, W)
        Z = self._H_T(half)
        by_mean = self._H_T(solve_lower_transposed(self.L, said[..., None]))
        return Later(
            mean=later.mean + by_mean[..., 0],
            information=later.information + Z + transposed(Z),
        )

    def _H_T(self, C: Array) -> Array:
        """H^T C from the blocks of H, shape (..., 3k, c) to (..., n, c)."""
        batch, k, c = C.shape[:-2], len(self.slots), C.shape[-1]
        n = self.Y_T.shape[-1]
        out = np.zeros((*batch, n, c))
        out[..., POSE, :] = transposed(self.H_pose) @ C
        landmarks = out[..., MAP, :].reshape(*batch, (n - 6) // 3, 3, c)  # a view
        landmarks[..., self.slots, :, :] = transposed(self.H_map) @ C.reshape(*batch, k, 3, c)
        return out


@dataclass(frozen=True, slots=True, kw_only=True)
class Augment:
    """New landmarks m = G x_R + v at the state's end.

    Attributes:
        G: shape (..., 3b, 6).
        R: covariance of each landmark's own v, shape (..., b, 3, 3).
    """

    G: Array
    R: Array

    def forward(self, P: Array) -> Array:
        """The larger covariance; landmarks born together correlate through the pose."""
        n, size = P.shape[-1], P.shape[-1] + self.G.shape[-2]
        cross = self.G @ P[..., POSE, :]
        grown = np.empty((*P.shape[:-2], size, size))
        grown[..., :n, :n] = P
        grown[..., n:, :n] = cross
        grown[..., :n, n:] = transposed(cross)
        grown[..., n:, n:] = symmetrised(cross[..., POSE] @ transposed(self.G))
        diagonal_blocks(grown[..., n:, n:])[...] += symmetrised(self.R)
        return grown

    def backward(self, later: Later) -> Later:
        """B^T mean and B^T information B for B = [I; G, 0]."""
        n = later.mean.shape[-1] - self.G.shape[-2]
        mean, information = later.mean[..., :n].copy(), later.information[..., :n].copy()
        mean[..., POSE] += _times(transposed(self.G), later.mean[..., n:])
        information[..., POSE] += later.information[..., n:] @ self.G
        pose_rows = transposed(self.G) @ information[..., n:, :]
        information = information[..., :n, :]
        information[..., POSE, :] += pose_rows
        return Later(mean=mean, information=information)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drop:
    """Landmarks that leave the state: what stays keeps exactly its covariance.

    Attributes:
        ids: shape (d,).
        slots: their places among the state's landmarks, shape (d,).
        stays: rows of the state that stay, shape (n - 3d,).
        landmarks: their estimates as they leave, shape (..., d, 3).
        covariances: of each, shape (..., d, 3, 3).
        cross: with what stays, shape (..., 3d, n - 3d).
    """

    ids: IntArray
    slots: IntArray
    stays: IntArray
    landmarks: Array
    covariances: Array
    cross: Array

    @classmethod
    def of(cls, P: Array, ids: IntArray, slots: IntArray, landmarks: Array) -> "Drop":
        """Let landmarks go, at `slots` of a state of covariance P, shape (..., n, n)."""
        stays = np.ones(P.shape[-1], bool)
        stays[MAP].reshape(-1, 3)[slots] = False
        leaves = (6 + 3 * slots[:, None] + np.arange(3)).reshape(-1)
        stay = np.flatnonzero(stays)
        return cls(
            ids=ids,
            slots=slots,
            stays=stay,
            landmarks=landmarks,
            covariances=diagonal_blocks(P[..., MAP, MAP])[..., slots, :, :],
            cross=P[..., leaves[:, None], stay],
        )

    def forward(self, P: Array) -> Array:
        """The covariance of what stays."""
        return P[..., self.stays[:, None], self.stays]

    def backward(self, later: Later) -> Later:
        """Nothing is said of what has left but through what stays."""
        n = len(self.stays) + 3 * len(self.ids)
        mean = np.zeros((*later.mean.shape[:-1], n))
        information = np.zeros((*mean.shape, n))
        mean[..., self.stays] = later.mean
        information[..., self.stays[:, None], self.stays] = later.information
        return Later(mean=mean, information=information)

    def smoothed(self, later: Later) -> tuple[Array, Array]:
        """Landmarks and covariances as the full filter would have them, after all that followed."""
        moved = _times(self.cross, later.mean)
        lost = diagonal_blocks(self.cross @ later.information @ transposed(self.cross))
        return self.landmarks + moved.reshape(self.landmarks.shape), self.covariances - lost


Record: TypeAlias = Linear | Correct | Augment | Drop


def diagonal_blocks(P: Array) -> Array:
    """The 3x3 blocks on the diagonal of (..., 3m, 3m): a view of shape (..., m, 3, 3)."""
    m = P.shape[-1] // 3
    blocks: Array = np.einsum("...iaib->...iab", P.reshape(*P.shape[:-2], m, 3, m, 3))
    return blocks


def _times(A: Array, x: Array) -> Array:
    """A x for vectors x with any batch shape."""
    return np.asarray((A @ x[..., None])[..., 0])
