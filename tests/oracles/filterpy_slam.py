"""What people would take instead: filterpy's EKF over pose and landmarks, in a plain loop.

Calls nothing of ours; takes the readings of a run as plain arrays. The state holds the error of the
pose, xi (T_true = T exp(xi^)), which is zero between the calls, and the landmarks in the world.
"""

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag, expm


@dataclass(frozen=True, kw_only=True)
class Readings:
    """A run: times (T,), twists (T, 6), and ids and pixels (uL, vL, uR, vR) by frame."""

    times_s: np.ndarray
    twists: np.ndarray
    frames: list
    T_world_imu: np.ndarray
    P: np.ndarray
    sigma_twist: np.ndarray
    sigma_px: np.ndarray
    T_imu_cam: np.ndarray
    K: tuple
    baseline_m: float


def hat(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def exp(xi):
    return expm(np.block([[hat(xi[3:]), xi[:3, None]], [np.zeros((1, 4))]]))


def adjoint(T):
    R, p = T[:3, :3], T[:3, 3]
    return np.block([[R, hat(p) @ R], [np.zeros((3, 3)), R]])


class FilterpySlam:
    def __init__(self, readings):
        self.told, self.T, self.ids = readings, readings.T_world_imu, []
        self.hold(np.zeros(6), readings.P)

    def hold(self, x, P):
        self.ekf = ExtendedKalmanFilter(dim_x=len(x), dim_z=4)
        self.ekf.x, self.ekf.P = x, P

    def predict(self, u, dt):
        step, n = exp(dt * u), len(self.ekf.x) - 6
        self.ekf.F = block_diag(adjoint(np.linalg.inv(step)), np.eye(n))
        self.ekf.Q = block_diag(np.diag((dt * self.told.sigma_twist) ** 2), np.zeros((n, n)))
        self.ekf.predict()
        self.T = self.T @ step

    def update(self, ids, pixels):
        seen = [(i, z) for i, z in zip(ids, pixels, strict=True) if (z > 0).all()]
        slots = {i: k for k, i in enumerate(self.ids)}
        known = [(slots[i], z) for i, z in seen if i in slots]
        if known:
            at = [k for k, _ in known]
            z = np.concatenate([z for _, z in known])
            R = np.diag(np.tile(self.told.sigma_px**2, len(at)))
            self.ekf.update(z, self.jacobian, self.predicted, R=R, args=at, hx_args=at)
            self.T = self.T @ exp(self.ekf.x[:6])
            self.ekf.x[:6] = 0
        for i, z in seen:
            if i not in slots:
                self.enter(i, z)

    def in_camera(self, m):
        T_cam_world = np.linalg.inv(self.T @ self.told.T_imu_cam)
        return T_cam_world[:3, :3] @ m + T_cam_world[:3, 3]

    def predicted(self, x, at):
        return np.concatenate([self.pixels(x[6 + 3 * k : 9 + 3 * k]) for k in at])

    def pixels(self, m):
        (fx, fy, cx, cy), (X, Y, Z) = self.told.K, self.in_camera(m)
        u, v = fx * X / Z + cx, fy * Y / Z + cy
        return np.array([u, v, u - fx * self.told.baseline_m / Z, v])

    def jacobian(self, x, at):
        H = np.zeros((4 * len(at), len(x)))
        for row, k in enumerate(at):
            columns = slice(6 + 3 * k, 9 + 3 * k)
            H_pose, H_m = self.blocks(x[columns])
            H[4 * row : 4 * row + 4, :6] = H_pose
            H[4 * row : 4 * row + 4, columns] = H_m
        return H

    def blocks(self, m):
        (fx, fy, _, _), (X, Y, Z) = self.told.K, self.in_camera(m)
        b, R = self.told.baseline_m, self.T[:3, :3]
        d_pixels = np.array(
            [
                [fx / Z, 0, -fx * X / Z**2],
                [0, fy / Z, -fy * Y / Z**2],
                [fx / Z, 0, -fx * (X - b) / Z**2],
                [0, fy / Z, -fy * Y / Z**2],
            ]
        )
        in_imu = R.T @ (m - self.T[:3, 3])
        d_imu = d_pixels @ self.told.T_imu_cam[:3, :3].T
        return d_imu @ np.hstack([-np.eye(3), hat(in_imu)]), d_imu @ R.T

    def enter(self, i, z):
        (fx, fy, cx, cy), b = self.told.K, self.told.baseline_m
        Z = fx * b / (z[0] - z[2])
        p_cam = np.array([(z[0] - cx) * Z / fx, ((z[1] + z[3]) / 2 - cy) * Z / fy, Z, 1])
        m = (self.T @ self.told.T_imu_cam @ p_cam)[:3]
        H_pose, H_m = self.blocks(m)
        R = np.diag(self.told.sigma_px**2)
        W = np.linalg.inv(R)
        back = np.linalg.inv(H_m.T @ W @ H_m) @ H_m.T @ W
        P, G = self.ekf.P, -back @ H_pose
        cross = G @ P[:6]
        own = G @ P[:6, :6] @ G.T + back @ R @ back.T
        self.ids.append(i)
        self.hold(np.append(self.ekf.x, m), np.block([[P, cross.T], [cross, own]]))


def estimated(readings):
    """The poses at the frames, shape (T, 4, 4)."""
    slam, poses = FilterpySlam(readings), []
    for i, (ids, pixels) in enumerate(readings.frames):
        if i:
            dt = readings.times_s[i] - readings.times_s[i - 1]
            slam.predict(readings.twists[i - 1], dt)
        slam.update(ids, pixels)
        poses.append(slam.T)
    return np.array(poses)
