"""IMU localisation by EKF prediction, the paper's III.A."""

import numpy as np

from vislam.filters import model
from vislam.gaussian import symmetrised, transposed
from vislam.types import Belief, Frame, Task, Twist


class DeadReckoning:
    """Integrates the twist, and the covariance that it gathers; frames are of no use to it."""

    batched = True

    def __init__(self, task: Task) -> None:
        """Start at the prior pose."""
        prior = task.prior
        self.noise = task.noise
        self.T = prior.T_world_imu
        P = np.zeros((6, 6)) if prior.pose_covariance is None else prior.pose_covariance
        self.P = np.broadcast_to(P, (*self.T.shape[:-2], 6, 6))

    def predict(self, motion: Twist, dt: float) -> None:
        """The paper's III.A.2."""
        T_next = model.moved(self.T, motion, dt)
        F = model.transition(self.T, T_next)
        Q = model.process_noise(self.noise, motion, dt)
        self.P = symmetrised(F @ self.P @ transposed(F) + Q)
        self.T = T_next

    def update(self, frame: Frame) -> None:
        """Nothing: the paper's first estimator sees no landmark."""

    def belief(self, joint: bool = False) -> Belief:
        """The pose alone."""
        return Belief(
            T_world_imu=self.T.copy(),
            pose_covariance=self.P.copy(),
            joint_covariance=self.P.copy() if joint else None,
        )
