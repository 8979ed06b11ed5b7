"""One frame's observation of the pose and of k landmarks, before it changes the state.

H has two blocks in each landmark's three rows, for the pose and for that landmark, so H P and H P
H^T are gathered from the blocks and no row of zeros is ever multiplied.
"""

from dataclasses import dataclass

import numpy as np

from vislam.arrays import Array, BoolArray, IntArray
from vislam.filters.records import POSE, Correct, diagonal_blocks
from vislam.gaussian import add_product, cholesky, solve_lower, transposed


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """A whitened residual r = H x + v, v ~ N(0, I), with what the state says of it.

    Attributes:
        slots: place of each observed landmark among the state's, shape (k,).
        H_pose: shape (..., k, 3, 6).
        H_map: shape (..., k, 3, 3).
        r: shape (..., k, 3).
        HP: H P, shape (..., 3k, n).
        S: H P H^T + I, shape (..., 3k, 3k).
    """

    slots: IntArray
    H_pose: Array
    H_map: Array
    r: Array
    HP: Array
    S: Array

    @classmethod
    def of(
        cls, P: Array, *, slots: IntArray, H_pose: Array, H_map: Array, r: Array
    ) -> "Observation":
        """Work out H P and S for a state of covariance P, symmetric, shape (..., n, n)."""
        batch, n, k = P.shape[:-2], P.shape[-1], len(slots)
        rows = 6 + 3 * slots[:, None] + np.arange(3)
        pose = H_pose.reshape(*batch, 3 * k, 6)
        HP = (H_map @ P.take(rows, axis=-2)).reshape(*batch, 3 * k, n)
        add_product(HP, pose, P[..., POSE])
        S = (H_map @ transposed(HP)[..., rows, :]).reshape(*batch, 3 * k, 3 * k)
        add_product(S, pose, HP[..., POSE])
        np.einsum("...ii->...i", S)[...] += 1
        return cls(slots=slots, H_pose=H_pose, H_map=H_map, r=r, HP=HP, S=S)

    @property
    def S_each(self) -> Array:
        """The innovation covariance of each landmark's three rows alone, shape (..., k, 3, 3)."""
        return diagonal_blocks(self.S)

    def distances(self) -> Array:
        """Squared Mahalanobis distance of each landmark's three rows alone, shape (..., k)."""
        solved = np.linalg.solve(self.S_each, self.r[..., None])[..., 0]
        distances: Array = np.sum(self.r * solved, axis=-1)
        return distances

    def only(self, accepted: BoolArray) -> "Observation":
        """What the gate let pass, (..., k): the rest goes, or in a batch turns zero."""
        if accepted.all():
            return self
        each_row = np.repeat(accepted, 3, axis=-1)
        if accepted.ndim == 1:
            rows = np.flatnonzero(each_row)
            return Observation(
                slots=self.slots[accepted],
                H_pose=self.H_pose[accepted],
                H_map=self.H_map[accepted],
                r=self.r[accepted],
                HP=self.HP.take(rows, axis=0),
                S=self.S.take(rows, axis=0).take(rows, axis=1),
            )
        both = each_row[..., :, None] & each_row[..., None, :]
        each = accepted[..., None, None]
        return Observation(
            slots=self.slots,
            H_pose=self.H_pose * each,
            H_map=self.H_map * each,
            r=self.r * accepted[..., None],
            HP=self.HP * each_row[..., None],
            S=np.where(both, self.S, np.eye(self.S.shape[-1])),
        )

    def correction(self) -> Correct:
        """The update that it makes; HP and S are spent by that."""
        batch, rows = self.HP.shape[:-2], self.HP.shape[-2]
        L = cholesky(self.S)
        r = self.r.reshape(*batch, rows)
        return Correct(
            slots=self.slots,
            H_pose=self.H_pose.reshape(*batch, rows, 6),
            H_map=self.H_map,
            r=r,
            L=L,
            whitened=solve_lower(L, r[..., None].copy())[..., 0],
            Y_T=solve_lower(L, self.HP),
        )
