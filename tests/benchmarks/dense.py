"""EKF-SLAM as one writes it first: one covariance over the pose and every landmark ever seen.

The same model and the same numbers as `vislam.filters.EkfSlam`, with none of its means: nothing
retires, nothing is recorded, and an update changes all of the covariance. What can be had for
little is had: H is never written out with its zeros, and P - Y Y^T is one product.
"""

import numpy as np
from scipy.linalg import solve_triangular

from vislam.charts import RIGHT
from vislam.filters import model
from vislam.gaussian import gate_threshold
from vislam.types import Belief, StereoFrame, Task, Twist


class DenseEkf:
    """A filter whose frame costs the square of the map."""

    def __init__(self, task: Task) -> None:
        """Start at the prior pose."""
        self.calibration, self.noise, self.gate = task.calibration, task.noise, task.gate
        self.T, self.P = task.prior.T_world_imu, task.prior.pose_covariance.copy()
        self.landmarks, self.slots = np.empty((0, 3)), {}

    def predict(self, motion: Twist, dt: float) -> None:
        """The pose's rows and columns move."""
        T_next, P = model.moved(self.T, motion, dt), self.P
        F = model.transition(self.T, T_next)
        P[:6] = F @ P[:6]
        P[:, :6] = P[:, :6] @ F.T
        P[:6, :6] += model.process_noise(self.noise, motion, dt)
        self.T = T_next

    def update(self, frame: StereoFrame) -> None:
        """Correct by the known landmarks, enter the new ones."""
        usable = model.valid(self.calibration, frame.pixels)
        ids, pixels = frame.ids[usable], frame.pixels[usable]
        slots = np.array([self.slots.get(i, -1) for i in ids.tolist()], int)
        self._correct(slots[slots >= 0], pixels[slots >= 0])
        self._give_birth(ids[slots < 0], pixels[slots < 0])

    def belief(self, joint: bool = False) -> Belief:
        """Pose and map."""
        m = len(self.landmarks)
        blocks = self.P[6:, 6:].reshape(m, 3, m, 3)[range(m), :, range(m)]
        return Belief(
            T_world_imu=self.T.copy(),
            pose_covariance=self.P[:6, :6].copy(),
            ids=np.array(list(self.slots), np.int64),
            landmarks=self.landmarks.copy(),
            landmark_covariances=blocks,
            joint_covariance=self.P.copy() if joint else None,
        )

    def _correct(self, slots, pixels):
        z = model.predicted(self.calibration, self.T, self.landmarks[slots])
        front = np.isfinite(z).all(axis=1)
        slots, z, pixels = slots[front], z[front], pixels[front]
        W = model.whitening(self.noise, z)
        r = (pixels - z) @ W.T
        jacobians = model.observation_jacobians(self.calibration, self.T, self.landmarks[slots])
        H_pose, H_map = (W[:3] @ H for H in jacobians)
        columns = 6 + 3 * slots[:, None] + np.arange(3)
        HP = H_pose @ self.P[:6] + H_map @ self.P[columns]
        S_each = HP[..., :6] @ H_pose.mT + HP[np.arange(len(slots))[:, None], :, columns].mT @ (
            H_map.mT
        )
        S_each += np.eye(3)
        keep = model.predictable(self.calibration, W, np.einsum("kii->ki", S_each))
        if self.gate is not None:
            solved = np.linalg.solve(S_each, r[:, :3, None])[..., 0]
            distance = np.sum(r[:, :3] * solved, axis=1) + r[:, 3] ** 2
            keep &= distance <= gate_threshold(self.gate, 4)
        HP, H_pose, H_map, columns, r = (a[keep] for a in (HP, H_pose, H_map, columns, r))
        k, n = len(HP), len(self.P)
        S = (HP[..., :6].reshape(3 * k, 6) @ H_pose.reshape(3 * k, 6).T).reshape(k, 3, k, 3)
        S += np.einsum("iajb,jcb->iajc", HP[:, :, columns], H_map)
        S = S.reshape(3 * k, 3 * k) + np.eye(3 * k)
        L = np.linalg.cholesky(S)
        right = np.column_stack([HP.reshape(3 * k, n), r[:, :3].ravel()])
        Y = solve_triangular(L, right, lower=True, check_finite=False)
        self.P -= Y[:, :n].T @ Y[:, :n]
        delta = Y[:, :n].T @ Y[:, n]
        self.T, self.landmarks = RIGHT.retract(self.T, self.landmarks, delta)

    def _give_birth(self, ids, pixels):
        points, G, R = model.inverse_observation(
            self.calibration, self.noise, self.T, self.T, pixels
        )
        self.slots |= {i: len(self.slots) + k for k, i in enumerate(ids.tolist())}
        self.landmarks = np.vstack([self.landmarks, points])
        n, size = len(self.P), len(self.P) + 3 * len(ids)
        grown = np.empty((size, size))
        grown[:n, :n] = self.P
        grown[n:, :n] = G.reshape(-1, 6) @ self.P[:6]
        grown[:n, n:] = grown[n:, :n].T
        grown[n:, n:] = grown[n:, :6] @ G.reshape(-1, 6).T
        for k, own in enumerate(R):
            at = slice(n + 3 * k, n + 3 * k + 3)
            grown[at, at] += own
        self.P = grown
