"""Readers of the course's files as its students write them, from the format's description alone.

Each loads what its year gave out, integrates the body's velocities from where the drive starts, and
puts every feature of every frame into the world. They share no code with the project.
"""

import numpy as np
from scipy.linalg import expm


def load_2019(file_name):
    with np.load(file_name) as data:
        t = data["time_stamps"]
        features = data["features"]
        linear_velocity = data["linear_velocity"]
        rotational_velocity = data["rotational_velocity"]
        K = data["K"]
        b = data["b"]
        cam_T_imu = data["cam_T_imu"]
    return t, features, linear_velocity, rotational_velocity, K, b, cam_T_imu


def load_2021(file_name, load_features=True):
    with np.load(file_name) as data:
        t = data["time_stamps"]
        features = data["features"] if load_features else None
        linear_velocity = data["linear_velocity"]
        angular_velocity = data["angular_velocity"]
        K = data["K"]
        b = data["b"]
        imu_T_cam = data["imu_T_cam"]
    return t, features, linear_velocity, angular_velocity, K, b, imu_T_cam


def load_2025(file_name):
    data = np.load(file_name, allow_pickle=True).item()
    names = ("v_t", "w_t", "timestamps", "features", "K_l", "K_r", "extL_T_imu", "extR_T_imu")
    return tuple(data[name] for name in names)


def rodrigues(w, dt):
    """Divides by the norm of the rate, as many do."""
    angle = np.linalg.norm(w) * dt
    k = w / np.linalg.norm(w)
    S = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(angle) * S + (1 - np.cos(angle)) * S @ S


def dead_reckoning(t, v, w):
    """Poses (4, 4, T) from times (1, T) and velocities (3, T), with a matrix exponential."""
    poses = np.zeros((4, 4, t.shape[1]))
    poses[:, :, 0] = np.eye(4)
    for i in range(t.shape[1] - 1):
        dt = t[0, i + 1] - t[0, i]
        twist = np.zeros((4, 4))
        x, y, z = w[:, i]
        twist[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        twist[:3, 3] = v[:, i]
        step = expm(dt * twist)
        assert np.allclose(step[:3, :3], rodrigues(w[:, i], dt), atol=1e-9)
        poses[:, :, i + 1] = poses[:, :, i] @ step
    return poses


def landmarks_by_disparity(poses, features, K, b, imu_T_cam):
    """World points (3, n) and their landmarks (n,), every sighting of every frame."""
    points, ids = [], []
    for i in range(features.shape[2]):
        seen = np.flatnonzero(features[0, :, i] != -1)
        uL, vL, uR, _ = features[:, seen, i]
        with np.errstate(divide="raise"):
            z = K[0, 0] * float(b) / (uL - uR)
        x, y = (uL - K[0, 2]) * z / K[0, 0], (vL - K[1, 2]) * z / K[1, 1]
        world = poses[:, :, i] @ imu_T_cam @ np.vstack([x, y, z, np.ones(len(seen))])
        points.append(world[:3])
        ids.append(seen)
    return np.hstack(points), np.hstack(ids)


def landmarks_by_two_rays(poses, features, K_l, K_r, oL_T_imu, oR_T_imu):
    """The same by linear triangulation from two projection matrices; poses (T, 4, 4)."""
    points, ids = [], []
    for i in range(len(poses)):
        imu_T_world = np.linalg.inv(poses[i])
        P_l, P_r = K_l @ (oL_T_imu @ imu_T_world)[:3], K_r @ (oR_T_imu @ imu_T_world)[:3]
        for j in np.flatnonzero((features[:, :, i] != -1).all(axis=0)):
            uL, vL, uR, vR = features[:, j, i]
            rows = [uL * P_l[2] - P_l[0], vL * P_l[2] - P_l[1]]
            rows += [uR * P_r[2] - P_r[0], vR * P_r[2] - P_r[1]]
            m = np.linalg.svd(np.array(rows))[2][-1]
            points.append(m[:3] / m[3])
            ids.append(j)
    return np.array(points).T, np.array(ids)
