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
from vislam.filters.layout import (
    MAP,
    POSE,
    diagonal_blocks,
    rows_of,
    times_blocks,
)
from vislam.filters.observation import Observation
from vislam.filters.records import Augment, Drop, Linear
from vislam.gaussian import (
    add_product,
    cholesky,
    solve_lower,
    square_root,
    symmetrised,
    transposed,
)


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
        return np.concatenate([np.arange(6), rows_of(self.slots).ravel()])


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Of a frame's update, what the way back needs: an eighth of what its corrections hold.

    Attributes:
        observation: what was used of the frame.
        delta: by what it moved the state, K r, shape (..., n).
    """

    observation: Observation
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

        With P the covariance before, that of both is (I + P Y)^-1 P, and it times y the change.

        Args:
            P: shape (..., n, n).
            rows: c of the n.

        Returns:
            Shapes (..., c) and (..., c, c).
        """
        weight = P @ self.information
        np.einsum("...ii->...i", weight)[...] += 1
        both = np.asarray(np.linalg.solve(weight, P[..., rows]))
        return _times(transposed(both), self.vector), symmetrised(both[..., rows, :])

    def before(self, record: "Past") -> "Later":
        """The same data, by the error of the state before a record; this one is given up.

        Raises:
            NotPositiveDefinite: a record is not finite.
        """
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
        if record.Q is not None:
            self._integrate_out(record.N, square_root(record.Q))
        y, Y = self.vector, self.information
        columns = record.F if record.M is None else np.concatenate([record.F, record.M], axis=-2)
        part = slice(0, columns.shape[-2])  # the rows that A gathers into the pose's
        y[..., POSE] = _times(transposed(columns), y[..., part])
        cross = Y[..., part] @ columns
        Y[..., POSE] = cross
        Y[..., POSE, :] = transposed(cross)
        Y[..., POSE, POSE] = symmetrised(transposed(columns) @ cross[..., part, :])
        if record.D is not None:
            D_T = transposed(record.D)
            y[..., MAP] = times_blocks(D_T, y[..., MAP, None])[..., 0]
            Y[..., MAP, :] = times_blocks(D_T, Y[..., MAP, :])
            Y[..., MAP] = transposed(times_blocks(D_T, transposed(Y[..., MAP])))
        return self

    def _integrate_out(self, N: Array | None, root: Array) -> None:
        """Integrate out v ~ N(0, I) of e + N root v, N the pose's columns by default: rank 6."""
        y, Y = self.vector, self.information
        if N is None:
            M_T = transposed(root)
            y_M, Y_M = _times(M_T, y[..., POSE]), M_T @ Y[..., POSE, :]
            self._less(y_M, Y_M, Y_M[..., POSE] @ root)
        else:
            M = N @ root
            Y_M = transposed(M) @ Y
            self._less(_times(transposed(M), y), Y_M, Y_M @ M)

    def _less(self, y_M: Array, Y_M: Array, square: Array) -> None:
        """Take off what v hides in e + M v, given M^T y, M^T Y and M^T Y M, which is given up.

        With L L^T = I + M^T Y M and Z = L^-1 M^T Y: Z^T Z.
        """
        np.einsum("...ii->...i", square)[...] += 1
        rows = np.concatenate([Y_M, y_M[..., None]], axis=-1)
        Z = solve_lower(cholesky(square), rows)
        self.vector[...] -= _times(transposed(Z[..., :-1]), Z[..., -1])
        add_product(self.information, -transposed(Z[..., :-1]), transposed(Z[..., :-1]))

    def _before_seen(self, record: Seen) -> "Later":
        """e+ = e - delta, and r = H e + v besides."""
        y, Y, seen = self.vector, self.information, record.observation
        batch, m, slots = y.shape[:-1], (y.shape[-1] - 6) // 3, seen.slots
        H_map_T = transposed(seen.H_map)
        of_pose = seen.H_pose.reshape(*batch, -1, 6)
        y += _times(Y, record.delta)
        y[..., POSE] += _times(transposed(of_pose), seen.r.reshape(*batch, -1))
        y_map = y[..., MAP].reshape(*batch, m, 3)  # a view, as those below
        y_map[..., slots, :] += _times(H_map_T, seen.r)

        Y[..., POSE, POSE] += transposed(of_pose) @ of_pose
        Y[..., MAP, POSE].reshape(*batch, m, 3, 6)[..., slots, :, :] += H_map_T @ seen.H_pose
        Y[..., POSE, MAP] = transposed(Y[..., MAP, POSE])
        diagonal_blocks(Y[..., MAP, MAP])[..., slots, :, :] += H_map_T @ seen.H_map
        return self

    def _before_augment(self, record: Augment) -> "Later":
        """With m = G x_R + v: the landmarks' own v is integrated out, the pose takes the rest."""
        y, Y, G = self.vector, self.information, record.G
        old = slice(0, y.shape[-1] - G.shape[-2])
        new = slice(old.stop, None)
        root_T = transposed(square_root(record.R))
        y_M, Y_M = times_blocks(root_T, y[..., new, None]), times_blocks(root_T, Y[..., new, :])
        square = transposed(times_blocks(root_T, transposed(Y_M[..., new])))
        self._less(y_M[..., 0], Y_M, square)
        y[..., POSE] += _times(transposed(G), y[..., new])
        Y[..., POSE] += Y[..., new] @ G
        Y[..., POSE, :] += transposed(G) @ Y[..., new, :]
        return Later(vector=y[..., old], information=Y[..., old, old].copy())

    def _before_drop(self, record: Drop) -> "Later":
        """Nothing is said of what has left."""
        batch, stays = self.vector.shape[:-1], record.stays
        n = len(stays) + 3 * len(record.slots)
        y, wide, Y = (np.zeros((*batch, *shape)) for shape in ((n,), (len(stays), n), (n, n)))
        y[..., stays] = self.vector
        wide[..., stays] = self.information
        Y[..., stays, :] = wide
        return Later(vector=y, information=Y)


#: What is kept of a run for the way back.
Past: TypeAlias = Linear | Seen | Augment | Drop | Kept


def _times(A: Array, x: Array) -> Array:
    """A x for vectors x with any batch shape."""
    return np.asarray((A @ x[..., None])[..., 0])
