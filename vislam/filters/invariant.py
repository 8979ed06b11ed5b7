"""EKF-SLAM with the right-invariant error: what cannot be observed stays unknown, exactly.

The error of pose and landmarks together is one motion of the world, T_true = exp(xi^) T and
f_true = exp(theta^) f + J_l(theta) xi_f with xi = (rho, theta). A rigid motion of trajectory and
map is then the same error whatever the estimate is, so no linearisation can see it.

Source: Barrau, Bonnabel, An EKF-SLAM algorithm with consistency properties, arXiv 1510.06263, 2015;
Zhang, Wu, Song, Huang, Dissanayake, Convergence and consistency analysis for a 3-D invariant-EKF
SLAM, IEEE Robotics and Automation Letters 2(2), 2017.

A prediction's noise moves every landmark's error xi_f, yet not a landmark: its additive error,
xi_f - f^ theta to first order, stays. So a landmark that has left keeps, to first order, what it
has; the full filter's own retraction of it is of second order in the later changes of the heading.
"""

from functools import partial

import numpy as np

from vislam.arrays import Array
from vislam.charts import INVARIANT
from vislam.filters import model
from vislam.filters.parts import Parts
from vislam.filters.slam import EkfSlam
from vislam.lie import se3, so3
from vislam.types import Calibration, Noise


def from_right(T: Array, landmarks: Array) -> Array:
    """Xi = Ad_T e for the pose's error e of the paper's chart, and xi_f = f^ theta beside it.

    Shape (..., 6 + 3m, 6).
    """
    Ad = se3.adjoint(T)
    of_map = so3.hat(landmarks) @ Ad[..., None, 3:, :]
    of_map = of_map.reshape(*landmarks.shape[:-2], 3 * landmarks.shape[-2], 6)
    return np.concatenate([Ad, of_map], axis=-2)


def transition(T: Array, T_next: Array) -> Array:  # noqa: ARG001
    """F = I: the error of the world's side does not move with the body."""
    return np.broadcast_to(np.eye(6), (*T.shape[:-2], 6, 6))


def observation_jacobians(
    calibration: Calibration, T: Array, landmarks: Array
) -> tuple[Array, Array]:
    """H = dh R^T [-I, 0, I] by (rho, theta, xi_f); shapes (..., m, 4, 6) and (..., m, 4, 3)."""
    _, H_map = model.observation_jacobians(calibration, T, landmarks)
    return np.concatenate([-H_map, np.zeros_like(H_map)], axis=-1), H_map


def inverse_observation(
    calibration: Calibration, noise: Noise, T: Array, T_linear: Array, readings: Array
) -> tuple[Array, Array, Array]:
    """As `vislam.filters.model.inverse_observation`, with xi_f = rho + R ds."""
    landmarks, G, R = model.inverse_observation(calibration, noise, T, T_linear, readings)
    G = np.zeros_like(G)
    G[..., :3] = np.eye(3)
    return landmarks, G, R


RIGHT_INVARIANT = Parts(
    chart=INVARIANT,
    from_right=from_right,
    transition=transition,
    observation_jacobians=observation_jacobians,
    birth=inverse_observation,
)
slam_invariant = partial(EkfSlam, parts=RIGHT_INVARIANT)
