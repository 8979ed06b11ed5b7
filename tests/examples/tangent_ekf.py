"""A filter of one's own: filterpy's EKF on the tangent space of pose and landmarks."""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag

from vislam import camera
from vislam.filters import model
from vislam.lie import se3
from vislam.types import Belief, Innovation


class TangentEkf:
    """State (xi, m_1 .. m_n): the true pose is T exp(xi^), and xi is zero between the calls."""

    def __init__(self, task):
        self.told, self.noise, self.T = task.calibration, task.noise, task.prior.T_world_imu
        self.ids = np.empty(0, int)
        self.hold(np.zeros(6), task.prior.pose_covariance)

    def hold(self, x, P):
        self.ekf = ExtendedKalmanFilter(dim_x=len(x), dim_z=4)
        self.ekf.x, self.ekf.P = x, P

    def predict(self, motion, dt):
        T_next, rest = self.T @ se3.exp(dt * motion.vector), len(self.ekf.x) - 6
        self.ekf.F = block_diag(se3.adjoint(se3.inverse(T_next) @ self.T), np.eye(rest))
        W = model.process_noise(self.noise, motion, dt)
        self.ekf.Q = block_diag(W, np.zeros((rest, rest)))
        self.ekf.predict()
        self.T = T_next

    def update(self, frame):
        valid, known = model.valid(self.told, frame.pixels), np.isin(frame.ids, self.ids)
        self.correct(ids := frame.ids[valid & known], frame.pixels[valid & known])
        y, S = self.ekf.y, self.ekf.S
        self.enter(frame.ids[valid & ~known], frame.pixels[valid & ~known])
        white = np.linalg.solve(np.linalg.cholesky(S), y).reshape(-1, 4)
        accepted = np.ones(len(ids), bool)
        return Innovation(ids=ids, residual=y.reshape(-1, 4), whitened=white, accepted=accepted)

    def correct(self, ids, pixels):
        place = [self.ids.tolist().index(i) for i in ids]
        R = np.diag(np.tile(self.noise.sigma_px**2, len(ids)))
        self.ekf.update(pixels.ravel(), self.jacobian, self.predicted, R, place, place)
        self.T, self.ekf.x[:6] = self.T @ se3.exp(self.ekf.x[:6]), 0

    def predicted(self, x, place):
        p_imu = model.to_imu(self.T, x[6:].reshape(-1, 3)[place])
        return camera.project(self.told.rig, model.to_cam(self.told, p_imu)).ravel()

    def jacobian(self, x, place):
        landmarks = x[6:].reshape(-1, 3)
        H_pose, H_map = model.observation_jacobians(self.told, self.T, landmarks[place])
        H_map = np.einsum("kij,km->kimj", H_map, np.eye(len(landmarks))[place])
        return np.hstack([H_pose.reshape(-1, 6), H_map.reshape(4 * len(place), landmarks.size)])

    def enter(self, ids, pixels):
        n, told = len(self.ekf.x), (self.told, self.noise)
        born, G, R = model.inverse_observation(*told, self.T, self.T, pixels)
        grow = np.vstack([np.eye(n), np.pad(G.reshape(-1, 6), ((0, 0), (0, n - 6)))])
        P = grow @ self.ekf.P @ grow.T + block_diag(np.zeros((n, n)), *R)
        self.hold(np.append(self.ekf.x, born), P)
        self.ids = np.append(self.ids, ids)

    def belief(self, joint=False):
        P, landmarks = self.ekf.P, self.ekf.x[6:].reshape(-1, 3)
        blocks = np.reshape([P[i : i + 3, i : i + 3] for i in range(6, len(P), 3)], (-1, 3, 3))
        return Belief(
            T_world_imu=self.T,
            pose_covariance=P[:6, :6],
            ids=self.ids,
            landmarks=landmarks,
            landmark_covariances=blocks,
            joint_covariance=P if joint else None,
        )
