"""The motion and the sensor model: what the paper's estimators share, in the right chart.

Each function is one formula; a filter variant takes another in its place
(`vislam.filters.parts.Parts`). A reading has c coordinates: four pixels of a stereo pair, or the
point itself of a point sensor.
"""

import math
from typing import Any

import numpy as np

from vislam import camera, point
from vislam.arrays import Array, BoolArray
from vislam.gaussian import gate_threshold, transposed
from vislam.lie import se3, so3
from vislam.point import PointSensor
from vislam.types import Calibration, Noise, Twist


def _of(calibration: Calibration) -> Any:
    """The module of the sensor's formulas: the two name them alike."""
    return point if isinstance(calibration.rig, PointSensor) else camera


def moved(T: Array, motion: Twist, dt: float) -> Array:
    """T_t+1 = T_t exp(tau u^), the paper's III.A.2; poses (..., 4, 4)."""
    return T @ se3.exp(dt * motion.vector)


def transition(T: Array, T_next: Array) -> Array:
    """F = Ad(T_t+1^-1 T_t) = exp(-tau u check), shape (..., 6, 6).

    Written by the poses between which the error moves, so that first estimates can take their
    place.
    """
    return se3.adjoint(se3.inverse(T_next) @ T)


def process_noise(noise: Noise, motion: Twist, dt: float) -> Array:
    """The covariance that one step adds to the pose, shape (..., 6, 6).

    `additive`: the paper's constant W. `twist`: tau^2 J_r(tau u) Sigma_u J_r^T, from
    exp(tau (u - n)^) = exp(tau u^) exp(-(tau J_r n)^) to first order; `twist-relative`: with the
    sample's own Sigma_u; `twist-density`: with Sigma_u = Sigma_c / tau.
    """
    if noise.process_model == "additive":
        return noise.process
    J = se3.right_jacobian(dt * motion.vector)
    scale = dt if noise.process_model == "twist-density" else dt * dt
    return scale * (J @ noise.twist_covariance(motion.vector) @ transposed(J))


def valid(calibration: Calibration, readings: Array) -> BoolArray:
    """Which readings can be used, in every run of a batch, shape (..., n, c) to (n,)."""
    return in_all_runs(_of(calibration).is_valid(calibration.rig, readings))


def unseen(there: BoolArray) -> BoolArray:
    """Which sightings are missing throughout: none at all, shape (..., n, c) to (n,)."""
    return in_all_runs(~np.asarray(there.any(axis=-1)))


def to_imu(T: Array, landmarks: Array) -> Array:
    """The points s = T^-1 m, landmarks of the world in the IMU frame, shape (..., m, 3)."""
    return (landmarks - T[..., None, :3, 3]) @ T[..., :3, :3]


def to_cam(calibration: Calibration, s: Array) -> Array:
    """The points q = cTi s, those of the IMU frame in the sensor's frame, shape (..., m, 3)."""
    return to_imu(calibration.T_imu_cam, s)


def predicted(calibration: Calibration, T: Array, landmarks: Array) -> Array:
    """The readings as predicted, K_s pi(cTi T^-1 m) of a stereo pair, shape (..., k, c).

    NaN where a landmark lies behind the camera: nothing can be said of it.
    """
    q = to_imu(T @ calibration.T_imu_cam, landmarks)
    seen: Array = _of(calibration).project_or_nan(calibration.rig, q)
    return seen


def observation_jacobians(
    calibration: Calibration, T: Array, landmarks: Array
) -> tuple[Array, Array]:
    """Derivatives of the readings by the pose's error and by the landmark.

    H_map = K_s dpi/dq cTi T^-1 P^T and H_pose = -K_s dpi/dq cTi (T^-1 m)^odot, the paper's III.C.5.

    Returns:
        H_pose of shape (..., m, c, 6) and H_map of shape (..., m, c, 3).
    """
    s = to_imu(T, landmarks)
    d_z_d_q: Array = _of(calibration).d_project_d_point(calibration.rig, to_cam(calibration, s))
    d_z_d_s = d_z_d_q @ so3.inverse(calibration.T_imu_cam[:3, :3])
    H_pose = np.concatenate([-d_z_d_s, d_z_d_s @ so3.hat(s)], axis=-1)
    H_map = d_z_d_s @ so3.inverse(T[..., None, :3, :3])
    return H_pose, H_map


def whitening(noise: Noise, predicted: Array) -> Array:
    """The matrices that make residuals' noise standard normal and gather it in three rows.

    Of a stereo pair vL and vR have one Jacobian, so all the information is in (uL, v, uR), v the
    mean of vL and vR by inverse variance, each over its sigma; the fourth row, (vL - vR) over its
    sigma, is pure noise. A point sensor's sigma is a share of the reading as predicted: as measured
    it would be small where the noise made the reading small, and draw the map towards the sensor.

    Args:
        noise: told noise.
        predicted: readings, shape (..., k, c).

    Returns:
        Shape (4, 4) of a stereo pair, (..., k, 3, 3) of a point sensor.
    """
    if not len(noise.sigma_px):
        weights: Array = np.eye(3) / noise.sigma(predicted)[..., None, :]
        return weights
    uL, vL, uR, vR = map(float, noise.sigma_px)
    both = math.hypot(vL, vR)
    return np.array(
        [
            [1 / uL, 0, 0, 0],
            [0, vR / (vL * both), 0, vL / (vR * both)],
            [0, 0, 1 / uR, 0],
            [0, 1 / both, 0, -1 / both],
        ]
    )


def whitened(W: Array, residual: Array) -> Array:
    """Residuals (..., k, c) times `whitening`, one matrix for all or one for each."""
    return np.asarray(np.einsum("...ij,...j->...i", W, residual))


def finite(residual: Array) -> BoolArray:
    """Which residuals there are, in every run of a batch, shape (..., k, c) to (k,)."""
    return in_all_runs(np.asarray(np.isfinite(residual).all(axis=-1)))


def predictable(calibration: Calibration, W: Array, variances: Array) -> BoolArray:
    """Which sightings are predicted better than by the width of the image, or the range.

    A landmark of wild depth that comes near the plane of the camera has pixels of any value and a
    Jacobian without bound: the update is no longer linear in anything, and a gate lets it pass.

    Args:
        calibration: told geometry.
        W: as of `whitening`.
        variances: innovation variances of each sighting's three whitened rows, shape (..., k, 3).

    Returns:
        Shape (..., k).
    """
    rig = calibration.rig
    if isinstance(rig, PointSensor):
        most = rig.range_m[1]
    else:
        most = 2 * rig.fx_px if rig.image_px is None else rig.image_px[0]
    weight = W[..., :3, :].sum(axis=-1)
    return np.asarray((variances < np.square(most * weight)).all(axis=-1))


def gate(distance_squared: Array, probability: float, dof: int) -> BoolArray:
    """Which sightings to accept, by squared Mahalanobis distance."""
    return distance_squared <= gate_threshold(probability, dof)


def triangulated(calibration: Calibration, readings: Array) -> Array:
    """The points of readings in the IMU frame, shape (..., n, c) to (..., n, 3)."""
    return se3.apply(calibration.T_imu_cam, _of(calibration).triangulate(calibration.rig, readings))


def inverse_observation(
    calibration: Calibration, noise: Noise, T: Array, T_linear: Array, readings: Array
) -> tuple[Array, Array, Array]:
    """New landmarks m = T s from their first sighting, which is spent by that.

    Args:
        calibration: told geometry.
        noise: told noise.
        T: pose, shape (..., 4, 4).
        T_linear: pose at which the Jacobian is taken, shape (..., 4, 4).
        readings: valid ones, shape (..., b, c).

    Returns:
        Positions (..., b, 3); G = R [I, -s^], s = T_linear^-1 m, their Jacobian by the pose's
        error, (..., b, 3, 6);
        and the covariance J_z R J_z^T that the readings' noise gives them, (..., b, 3, 3).
    """
    landmarks = se3.apply(T, triangulated(calibration, readings))
    G = T_linear[..., None, :3, :3] @ se3.odot(to_imu(T_linear, landmarks))
    R_world_cam = T[..., :3, :3] @ calibration.T_imu_cam[:3, :3]
    d_q_d_z: Array = _of(calibration).d_triangulate_d_reading(calibration.rig, readings)
    J_z = R_world_cam[..., None, :, :] @ d_q_d_z * noise.sigma(readings)[..., None, :]
    return landmarks, G, J_z @ transposed(J_z)


CONSTANT_PRIOR_SIGMA_M = 1.0


def constant_prior(
    calibration: Calibration, noise: Noise, T: Array, T_linear: Array, readings: Array
) -> tuple[Array, Array, Array]:
    """The paper's own start: the triangulated point with a constant covariance of 1 m^2.

    Inconsistent: it claims that the landmark's error has nothing to do with the pose's, nor with
    its depth. As `inverse_observation` otherwise.
    """
    landmarks, G, R = inverse_observation(calibration, noise, T, T_linear, readings)
    return (
        landmarks,
        np.zeros_like(G),
        np.broadcast_to(CONSTANT_PRIOR_SIGMA_M**2 * np.eye(3), R.shape),
    )


def in_all_runs(holds: BoolArray) -> BoolArray:
    """Whether it holds in every run of a batch, shape (..., n) to (n,)."""
    if holds.ndim == 1:
        return holds
    return np.asarray(holds.all(axis=tuple(range(holds.ndim - 1))))
