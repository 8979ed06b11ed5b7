"""What later data say of an earlier state: one pass against time over the records of a filter.

The update by a frame is the same to a landmark that has left the state as to one that is in it, but
for the arithmetic. So the full filter's estimate of any landmark, at the end, is what two sides
have to say of it: the filter at a moment when the landmark was in the state, and all measurements
after that moment, gathered as a quadratic form in the state's error then (the backward information
filter of a two-filter smoother: Fraser, Potter, The optimum linear smoother as a combination of two
optimum linear filters, IEEE Transactions on Automatic Control 14(4), 1969). H has a few blocks, a
prediction adds noise of rank 6 and a birth of rank 3, so a step back over a frame costs n^2, where
a step of the filter costs n^3.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from vislam.arrays import Array, IntArray
from vislam.filters.estimate import Estimate
from vislam.filters.records import (
    MAP,
    POSE,
    Augment,
    Correct,
    Drop,
    Linear,
    Record,
    times_blocks,
)
from vislam.gaussian import symmetrised, transposed


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """The state at a moment to which the backward pass shall come back.

    Attributes:
        ids: landmarks whose final estimate is due here, shape (d,).
        slots: their places among the state's, shape (d,).
        x: the estimate of the pose and of these landmarks.
        P: the covariance of the whole state, shape (..., n, n).
    """

    ids: IntArray
    slots: IntArray
    x: Estimate
    P: Array

    @property
    def rows(self) -> IntArray:
        """The pose's rows of the state, and those of the landmarks that are due."""
        due = 6 + 3 * self.slots[:, None] + np.arange(3)
        return np.concatenate([np.arange(6), due.ravel()])


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Of a `Correct`, what the way back needs: an eighth of its size.

    Attributes:
        slots, H_pose, H_map, r: as there.
        delta: by what it moved the state, K r, shape (..., n).
    """

    slots: IntArray
    H_pose: Array
    H_map: Array
    r: Array
    delta: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Later:
    """The log-likelihood y^T e - e^T Y e / 2 of all later data, by the error e of a state.

    Attributes:
        vector: y, shape (..., n).
        information: Y, shape (..., n, n).
    """

    vector: Array
    information: Array

    @classmethod
    def nothing(cls, P: Array) -> "Later":
        """No data are to come for a state of covariance P, shape (..., n, n)."""
        return cls(vector=np.zeros(P.shape[:-1]), information=np.zeros(P.shape))

    def smoothed(self, P: Array, rows: slice | IntArray) -> tuple[Array, Array]:
        """Both sides together: the change of some rows of the state, and their covariance.

        With P the covariance before: P (I + Y P)^-1 y, and P - P (I + Y P)^-1 Y P.

        Args:
            P: shape (..., n, n).
            rows: c of the n.

        Returns:
            Shapes (..., c) and (..., c, c).
        """
        Y_P = self.information @ P
        right = np.concatenate([self.vector[..., None], Y_P[..., rows]], axis=-1)
        np.einsum("...ii->...i", Y_P)[...] += 1
        said = P[..., rows, :] @ np.linalg.solve(Y_P, right)
        return said[..., 0], symmetrised(P[..., rows, :][..., rows] - said[..., 1:])

    def before(self, record: "Past") -> "Later":
        """The same data, by the error of the state before a record."""
        match record:
            case Linear():
                return self._before_linear(record)
            case Seen():
                return self._before_seen(record)
            case Augment():
                return self._before_augment(record)
            case Drop():
                return self._before_drop(record)
            case Kept():
                return self

    def _before_linear(self, record: Linear) -> "Later":
        """e+ = A e + N w: the noise is integrated out, A carries the rest."""
        later = self
        if record.Q is not None:
            later = later._without_noise(record.N, record.Q)
        columns = record.F if record.M is None else np.concatenate([record.F, record.M], axis=-2)
        part = slice(0, columns.shape[-2])  # the rows that A gathers into the pose's
        y, Y = later.vector.copy(), later.information.copy()
        y[..., POSE] = _times(transposed(columns), later.vector[..., part])
        Y[..., POSE, :] = transposed(columns) @ Y[..., part, :]
        Y[..., POSE] = Y[..., part] @ columns
        if record.D is not None:
            D_T = transposed(record.D)
            y[..., MAP] = times_blocks(D_T, y[..., MAP, None])[..., 0]
            Y[..., MAP, :] = times_blocks(D_T, Y[..., MAP, :])
            Y[..., MAP] = transposed(times_blocks(D_T, transposed(Y[..., MAP])))
        return Later(vector=y, information=Y)

    def _without_noise(self, N: Array | None, Q: Array) -> "Later":
        """Integrate out w ~ N(0, Q) of e + N w: rank 6."""
        if N is None:
            Y_N, y_N = self.information[..., POSE], self.vector[..., POSE]
            return self._less(Y_N, y_N, Y_N[..., POSE, :], Q)
        Y_N, N_T = self.information @ N, transposed(N)
        return self._less(Y_N, _times(N_T, self.vector), N_T @ Y_N, Q)

    def _less(self, Y_N: Array, y_N: Array, info: Array, Q: Array) -> "Later":
        """Take off Y_N (Q^-1 + info)^-1 y_N and Y_N (Q^-1 + info)^-1 Y_N^T, for a Q of any rank."""
        weight = np.asarray(np.linalg.solve(np.eye(Q.shape[-1]) + Q @ info, Q))
        lost = Y_N @ symmetrised(weight)
        return Later(
            vector=self.vector - _times(lost, y_N),
            information=symmetrised(self.information - lost @ transposed(Y_N)),
        )

    def _before_seen(self, record: Seen) -> "Later":
        """e+ = e - delta, and r = H e + v besides."""
        *batch, k, _, _ = record.H_map.shape
        n = self.vector.shape[-1]
        H_pose = record.H_pose.reshape(*batch, k, 3, 6)
        r = record.r.reshape(*batch, k, 3, 1)
        y = self.vector + _times(self.information, record.delta)
        y[..., POSE] += _times(transposed(record.H_pose), record.r)
        y_map = y[..., MAP].reshape(*batch, -1, 3)  # a view, as those below
        y_map[..., record.slots, :] += (transposed(record.H_map) @ r)[..., 0]

        Y = self.information.copy()
        Y[..., POSE, POSE] += transposed(record.H_pose) @ record.H_pose
        cross = transposed(record.H_map) @ H_pose
        by_map = np.zeros((*batch, (n - 6) // 3, 3, 6))
        by_map[..., record.slots, :, :] = cross
        by_map = by_map.reshape(*batch, n - 6, 6)
        Y[..., MAP, POSE] += by_map
        Y[..., POSE, MAP] += transposed(by_map)
        blocks = Y[..., MAP, MAP].reshape(*batch, (n - 6) // 3, 3, (n - 6) // 3, 3)
        blocks[..., record.slots, :, record.slots, :] += np.moveaxis(
            transposed(record.H_map) @ record.H_map, -3, 0
        )
        return Later(vector=y, information=Y)

    def _before_augment(self, record: Augment) -> "Later":
        """With m = G x_R + v: the landmarks' own v is integrated out, the pose takes the rest."""
        n = self.vector.shape[-1] - record.G.shape[-2]
        new = slice(n, None)
        *batch, b, _, _ = record.R.shape
        R = np.zeros((*batch, b, 3, b, 3))
        R[..., range(b), :, range(b), :] = np.moveaxis(record.R, -3, 0)
        R = R.reshape(*batch, 3 * b, 3 * b)
        Y_N = self.information[..., new]
        later = self._less(Y_N, self.vector[..., new], Y_N[..., new, :], R)
        y, Y = later.vector, later.information
        y[..., POSE] += _times(transposed(record.G), y[..., new])
        Y[..., POSE] += Y[..., new] @ record.G
        Y[..., POSE, :] += transposed(record.G) @ Y[..., new, :]
        return Later(vector=y[..., :n], information=Y[..., :n, :n])

    def _before_drop(self, record: Drop) -> "Later":
        """Nothing is said of what has left."""
        n = len(record.stays) + 3 * len(record.slots)
        y = np.zeros((*self.vector.shape[:-1], n))
        Y = np.zeros((*y.shape, n))
        y[..., record.stays] = self.vector
        Y[..., record.stays[:, None], record.stays] = self.information
        return Later(vector=y, information=Y)


#: What is kept of a run for the way back.
Past: TypeAlias = Linear | Seen | Augment | Drop | Kept


def past(record: Record) -> Past:
    """What to keep of a record."""
    if not isinstance(record, Correct):
        return record
    return Seen(
        slots=record.slots,
        H_pose=record.H_pose,
        H_map=record.H_map,
        r=record.r,
        delta=record.delta,
    )


def _times(A: Array, x: Array) -> Array:
    """A x for vectors x with any batch shape."""
    return np.asarray((A @ x[..., None])[..., 0])
