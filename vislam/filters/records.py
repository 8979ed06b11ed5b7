"""The four ways in which the covariance of an EKF's state changes, each as a record.

The state is x = (pose, landmarks). Every change of its covariance P is one of these, applied by
`forward`, or in the place of P by `onto`. What judges a filter from inside reads the same records
that moved it. So does the backward pass (`vislam.filters.backward`), but for updates: it takes all
that was observed in a frame as one.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from vislam.arrays import Array, IntArray
from vislam.filters.layout import MAP, POSE, diagonal_blocks, rows_of, times_blocks
from vislam.filters.observation import Observation
from vislam.gaussian import (
    add_product,
    cholesky,
    solve_lower,
    subtract_gram,
    symmetrised,
    transposed,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Linear:
    """x <- A x + N w, w ~ N(0, Q), with A = [F, 0; M, D]: a prediction, or a transport.

    Attributes:
        F: of the pose, shape (..., 6, 6).
        Q: covariance of the noise, shape (..., 6, 6); None without noise.
        N: what the noise does to the state, shape (..., 6 + 3m, 6); None where it is the pose's
            alone, as it comes.
        M: what the pose does to the landmarks, shape (..., 3m, 6); None for nothing.
        D: of each landmark, shape (..., m, 3, 3); None where they stay as they are.
    """

    F: Array
    Q: Array | None = None
    N: Array | None = None
    M: Array | None = None
    D: Array | None = None

    def forward(self, P: Array) -> Array:
        """A P A^T + N Q N^T; both cross blocks move with the pose (the paper, III.C.2)."""
        return self.onto(P.copy())

    def onto(self, P: Array) -> Array:
        """The same, in the place of P.

        With W = A - I in the pose's columns, A P A^T = P + W V + V^T W^T, where
        V = P_R + P_RR W^T / 2.
        """
        if self.D is not None:
            P[..., MAP, :] = times_blocks(self.D, P[..., MAP, :])
            P[..., MAP] = transposed(times_blocks(self.D, transposed(P[..., MAP])))
        if self.M is None:
            P[..., POSE, MAP] = self.F @ P[..., POSE, MAP]
            P[..., MAP, POSE] = transposed(P[..., POSE, MAP])
            P[..., POSE, POSE] = symmetrised(self.F @ P[..., POSE, POSE] @ transposed(self.F))
        else:
            W = np.concatenate([self.F - np.eye(6), self.M], axis=-2)
            V_T = P[..., POSE] + 0.5 * W @ P[..., POSE, POSE]
            left, right = np.concatenate([W, V_T], axis=-1), np.concatenate([V_T, W], axis=-1)
            add_product(P, left, right)
        if self.Q is not None:
            if self.N is None:
                P[..., POSE, POSE] += symmetrised(self.Q)
            else:
                add_product(P, self.N @ self.Q, self.N)
        return P

    def marginals(self, P: Array) -> tuple[Array, Array]:
        """Of the pose and of each landmark alone, what `forward` would give.

        Returns:
            Shapes (..., 6, 6) and (..., m, 3, 3).
        """
        pose, blocks = P[..., POSE, POSE], diagonal_blocks(P[..., MAP, MAP])
        if self.D is not None:
            blocks = self.D @ blocks @ transposed(self.D)
        if self.M is not None:
            m = blocks.shape[-3]
            M = self.M.reshape(*self.M.shape[:-2], m, 3, 6)
            cross = P[..., MAP, POSE].reshape(*P.shape[:-2], m, 3, 6)
            if self.D is not None:
                cross = self.D @ cross
            half = (cross + 0.5 * M @ pose[..., None, :, :]) @ transposed(M)
            blocks = blocks + half + transposed(half)
        return symmetrised(self.F @ pose @ transposed(self.F)), blocks

    def carried(self, x: Array) -> Array:
        """A x, for x of shape (..., 6 + 3m, c)."""
        landmarks = x[..., MAP, :] if self.D is None else times_blocks(self.D, x[..., MAP, :])
        if self.M is not None:
            landmarks = landmarks + self.M @ x[..., POSE, :]
        return np.concatenate([self.F @ x[..., POSE, :], landmarks], axis=-2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Correct:
    """An update by a whitened observation r = H x + v, v ~ N(0, I), of k landmarks.

    Attributes:
        observation: what was observed.
        L: lower factor of the innovation covariance S = H P H^T + I, shape (..., 3k, 3k).
        whitened: L^-1 r, shape (..., 3k).
        Y_T: L^-1 H P, shape (..., 3k, n); the gain is K = Y L^-1.
    """

    observation: Observation
    L: Array
    whitened: Array
    Y_T: Array

    @classmethod
    def of(cls, observation: Observation, P: Array) -> "Correct":
        """The update that it makes of a state of covariance P, shape (..., n, n)."""
        HP = observation.of_state(P)
        return cls.of_products(observation, HP, observation.innovation_covariance(HP))

    @classmethod
    def of_products(cls, observation: Observation, HP: Array, S: Array) -> "Correct":
        """The same from H P and S, which are given up."""
        r = observation.r.reshape(*HP.shape[:-1], 1)
        L = cholesky(S)
        return cls(
            observation=observation,
            L=L,
            whitened=solve_lower(L, r.copy())[..., 0],
            Y_T=solve_lower(L, HP),
        )

    def forward(self, P: Array) -> Array:
        """(I - K H) P = P - Y Y^T."""
        return self.onto(P.copy())

    def onto(self, P: Array) -> Array:
        """The same, in the place of P."""
        return subtract_gram(P, self.Y_T)

    @property
    def delta(self) -> Array:
        """K r, shape (..., n)."""
        return np.asarray((self.whitened[..., None, :] @ self.Y_T)[..., 0, :])


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
        return self.onto(P)

    def onto(self, P: Array) -> Array:
        """The same."""
        n, size = P.shape[-1], P.shape[-1] + self.G.shape[-2]
        cross = self.G @ P[..., POSE, :]
        grown = np.empty((*P.shape[:-2], size, size))
        grown[..., :n, :n] = P
        grown[..., n:, :n] = cross
        grown[..., :n, n:] = transposed(cross)
        grown[..., n:, n:] = symmetrised(cross[..., POSE] @ transposed(self.G))
        diagonal_blocks(grown[..., n:, n:])[...] += symmetrised(self.R)
        return grown


@dataclass(frozen=True, slots=True, kw_only=True)
class Drop:
    """Landmarks that leave the state: what stays keeps exactly its covariance.

    Attributes:
        slots: their places among the state's landmarks, shape (d,).
        stays: rows of the state that stay, shape (n - 3d,).
    """

    slots: IntArray
    stays: IntArray

    @classmethod
    def of(cls, n: int, slots: IntArray) -> "Drop":
        """Let landmarks go, at `slots` of a state of n rows."""
        stays = np.ones(n, bool)
        stays[rows_of(slots)] = False
        return cls(slots=slots, stays=np.flatnonzero(stays))

    def forward(self, P: Array) -> Array:
        """The covariance of what stays."""
        return self.onto(P)

    def onto(self, P: Array) -> Array:
        """The same."""
        return P.take(self.stays, axis=-2).take(self.stays, axis=-1)


Record: TypeAlias = Linear | Correct | Augment | Drop
