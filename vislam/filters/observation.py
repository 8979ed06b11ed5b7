"""One frame's observation of the pose and of k landmarks, linearised.

H has two blocks in each landmark's three rows, for the pose and for that landmark, so what it makes
of a covariance is gathered from the blocks, and no row of zeros is ever multiplied.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from vislam.arrays import Array, BoolArray, IntArray
from vislam.filters.layout import MAP, POSE, rows_of
from vislam.gaussian import add_product, transposed

#: Sightings that are taken in at once, but for an iterated update. An update by m rows costs m^3
#: in its factor and m^2 n in the solve, by parts of them the less; what is left is the product,
#: m n^2 in any case. At 100 sightings that saves a quarter of the time, below 50 nothing.
PART = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """A whitened residual r = H x + v, v ~ N(0, I).

    Attributes:
        slots: place of each observed landmark among the state's, shape (k,).
        H_pose: shape (..., k, 3, 6).
        H_map: shape (..., k, 3, 3).
        r: shape (..., k, 3).
    """

    slots: IntArray
    H_pose: Array
    H_map: Array
    r: Array

    def of_state(self, P: Array) -> Array:
        """H P of a symmetric P, shape (..., n, n) to (..., 3k, n)."""
        *batch, k, _, _ = self.H_map.shape
        HP = self.H_map @ P.take(rows_of(self.slots), axis=-2)
        HP = HP.reshape(*batch, 3 * k, P.shape[-1])
        return add_product(HP, self._of_pose, P[..., POSE])

    def innovation_covariance(self, HP: Array) -> Array:
        """S = H P H^T + I, of H P, shape (..., 3k, 3k)."""
        S = (self.H_map @ transposed(HP)[..., rows_of(self.slots), :]).reshape(
            *HP.shape[:-1], HP.shape[-2]
        )
        add_product(S, self._of_pose, HP[..., POSE])
        np.einsum("...ii->...i", S)[...] += 1
        return S

    @property
    def _of_pose(self) -> Array:
        return self.H_pose.reshape(*self.H_pose.shape[:-3], -1, 6)

    def innovation_covariance_of_each(self, P: Array) -> Array:
        """S of each landmark's three rows alone, shape (..., k, 3, 3)."""
        rows = np.empty((len(self.slots), 9), int)
        rows[:, POSE], rows[:, MAP] = np.arange(6), rows_of(self.slots)
        H = np.concatenate([self.H_pose, self.H_map], axis=-1)
        S: Array = H @ P[..., rows[:, :, None], rows[:, None, :]] @ transposed(H) + np.eye(3)
        return S

    def variance_bounds(self, P: Array) -> Array:
        """What no diagonal element of S exceeds, shape (..., k, 3): of h x, h P h^T <= (|h| s)^2.

        s are the standard deviations of the state (Cauchy, Schwarz).
        """
        sigma = np.sqrt(np.maximum(np.einsum("...ii->...i", P), 0))
        sizes = replace(self, H_pose=np.abs(self.H_pose), H_map=np.abs(self.H_map))
        return np.square(sizes.times(sigma)) + 1

    def distances(self, S_each: Array) -> Array:
        """Squared Mahalanobis distance of each landmark's three rows alone, shape (..., k)."""
        solved = np.linalg.solve(S_each, self.r[..., None])[..., 0]
        distances: Array = np.sum(self.r * solved, axis=-1)
        return distances

    def of_landmarks(self, which: IntArray | slice) -> "Observation":
        """What some of the landmarks say."""
        return Observation(
            slots=self.slots[which],
            H_pose=self.H_pose[..., which, :, :],
            H_map=self.H_map[..., which, :, :],
            r=self.r[..., which, :],
        )

    def only(self, accepted: BoolArray) -> "Observation":
        """What the gate let pass, (..., k): the rest goes, or in a batch says nothing."""
        if accepted.all():
            return self
        if accepted.ndim == 1:
            return self.of_landmarks(np.flatnonzero(accepted))
        each = accepted[..., None, None]
        return replace(
            self, H_pose=self.H_pose * each, H_map=self.H_map * each, r=self.r * each[..., 0]
        )

    def parts(self) -> Iterator["Observation"]:
        """The same in parts of at most `PART` landmarks; of none, one."""
        k = len(self.slots)
        count = -(-k // PART)
        if count < 2:
            yield self
        else:
            for some in np.array_split(np.arange(k), count):
                yield self.of_landmarks(slice(some[0], some[-1] + 1))

    def times(self, delta: Array) -> Array:
        """H delta, shape (..., n) to (..., k, 3)."""
        f = delta[..., rows_of(self.slots), None]
        return np.asarray((self.H_pose @ delta[..., None, POSE, None] + self.H_map @ f)[..., 0])

    def less(self, delta: Array) -> "Observation":
        """What is left of the residual when the state has been moved by delta."""
        return replace(self, r=self.r - self.times(delta))
