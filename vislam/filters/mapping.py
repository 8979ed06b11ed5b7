"""Landmark mapping by EKF update with the trajectory taken as known, the paper's III.B.

With the poses given, landmarks are independent of one another: the map's covariance is one 3x3
block for each, and an update works on the blocks in sight.
"""

from dataclasses import replace
from typing import Protocol

import numpy as np

from vislam.arrays import Array, IntArray
from vislam.filters import model
from vislam.filters.dead_reckoning import DeadReckoning
from vislam.filters.layout import block_diagonal
from vislam.filters.roster import Retired, slots_of
from vislam.gaussian import cholesky, solve_lower, subtract_gram, transposed
from vislam.types import Belief, Frame, Innovation, Smoothed, Task, Twist


class Poses(Protocol):
    """A source of poses that moves with the filter."""

    T: Array

    def predict(self, motion: Twist, dt: float) -> None:
        """Go on to the next frame."""


class GivenTrajectory:
    """The poses that the task hands out, frame by frame."""

    def __init__(self, task: Task) -> None:
        """Start at the first.

        Raises:
            ValueError: the task has no trajectory.
        """
        if task.trajectory is None:
            raise ValueError(
                "Expected a task with the true trajectory, but the data do not know it; "
                "map on the dead-reckoned one instead."
            )
        self._trajectory = iter(task.trajectory)
        self.T = next(self._trajectory)

    def predict(self, motion: Twist, dt: float) -> None:  # noqa: ARG002
        """Go on to the next frame, whatever the twist says."""
        self.T = next(self._trajectory)


class Mapping:
    """Maps landmarks on a trajectory that is taken for the truth, by default the dead-reckoned one.

    The belief says nothing of the pose's covariance: the pose is not estimated here.
    """

    batched = True

    def __init__(self, task: Task, poses: Poses | None = None) -> None:
        """Start with the known map of the prior, or an empty one."""
        self.calibration, self.noise, self.gate = task.calibration, task.noise, task.gate
        self.poses = DeadReckoning(task) if poses is None else poses
        self._retired = Retired()
        prior, batch = task.prior, task.prior.T_world_imu.shape[:-2]
        m = len(prior.ids)
        self.ids = prior.ids
        self.landmarks = np.broadcast_to(prior.landmarks, (*batch, m, 3)).copy()
        self.P = np.broadcast_to(prior.landmark_covariances, (*batch, m, 3, 3)).copy()

    @classmethod
    def on_truth(cls, task: Task) -> "Mapping":
        """Map on the true trajectory."""
        return cls(task, GivenTrajectory(task))

    def predict(self, motion: Twist, dt: float) -> None:
        """Move along the trajectory; landmarks stay where they are."""
        self.poses.predict(motion, dt)

    def update(self, frame: Frame) -> Innovation:
        """Update the known landmarks, enter new ones, let go of those seen for the last time."""
        usable = model.valid(self.calibration, frame.readings)
        slots = slots_of(self.ids, frame.ids)
        known, new = usable & (slots >= 0), usable & (slots < 0)
        innovation = self._correct(frame.ids[known], slots[known], frame.readings[..., known, :])
        self._give_birth(frame.ids[new], frame.readings[..., new, :])
        self._retire(frame.ids[frame.last])
        skipped = ~usable & ~model.unseen(frame.there)
        return replace(innovation, born=frame.ids[new], skipped=frame.ids[skipped])

    def belief(self, joint: bool = False) -> Belief:
        """The pose as it was given, and the living landmarks."""
        return Belief(
            T_world_imu=self.poses.T.copy(),
            ids=self.ids.copy(),
            landmarks=self.landmarks.copy(),
            landmark_covariances=self.P.copy(),
            joint_covariance=block_diagonal(self.P) if joint else None,
        )

    def finish(self) -> Smoothed:
        """Every landmark there was, by ascending id."""
        return Smoothed(final=self._retired.joined_to(self.belief()))

    def _correct(self, ids: IntArray, slots: IntArray, readings: Array) -> Innovation:
        """The paper's III.B.3 for each known landmark; ids (k,), readings (..., k, c)."""
        calibration, T = self.calibration, self.poses.T
        predicted = model.predicted(calibration, T, self.landmarks[..., slots, :])
        residual = readings - predicted
        front = np.flatnonzero(model.finite(residual))
        slots = slots[front]
        W = model.whitening(self.noise, predicted[..., front, :])
        white = model.whitened(W, residual[..., front, :])
        _, H = model.observation_jacobians(calibration, T, self.landmarks[..., slots, :])
        H = W[..., :3, :] @ H
        P = self.P[..., slots, :, :]
        S = H @ P @ transposed(H) + np.eye(3)
        L = cholesky(S)
        white[..., :3] = solve_lower(L, white[..., :3, None])[..., 0]
        passed = model.predictable(calibration, W, np.einsum("...ii->...i", S))
        if self.gate is not None:
            passed &= model.gate(np.square(white).sum(axis=-1), self.gate, white.shape[-1])
        white *= passed[..., None]
        Y_T = solve_lower(L, H @ P) * passed[..., None, None]
        self.landmarks[..., slots, :] += (transposed(Y_T) @ white[..., :3, None])[..., 0]
        self.P[..., slots, :, :] = subtract_gram(P, Y_T)

        whitened = np.zeros(readings.shape)
        whitened[..., front, :] = white
        accepted = np.zeros(readings.shape[:-1], bool)
        accepted[..., front] = passed
        return Innovation(ids=ids, residual=residual, whitened=whitened, accepted=accepted)

    def _give_birth(self, ids: IntArray, readings: Array) -> None:
        """Enter new landmarks by their first sighting, the paper's III.B.2."""
        T = self.poses.T
        landmarks, _, R = model.inverse_observation(self.calibration, self.noise, T, T, readings)
        self.ids = np.concatenate([self.ids, ids])
        self.landmarks = np.concatenate([self.landmarks, landmarks], axis=-2)
        self.P = np.concatenate([self.P, R], axis=-3)

    def _retire(self, ids: IntArray) -> None:
        """Put landmarks aside that will not be seen again."""
        slots = slots_of(self.ids, ids)
        slots = slots[slots >= 0]
        self._retired.add(self.ids[slots], self.landmarks[..., slots, :], self.P[..., slots, :, :])
        self.ids = np.delete(self.ids, slots)
        self.landmarks = np.delete(self.landmarks, slots, axis=-2)
        self.P = np.delete(self.P, slots, axis=-3)
