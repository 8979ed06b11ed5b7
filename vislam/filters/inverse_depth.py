"""EKF-SLAM whose landmarks move along their inverse depth: births that survive their depth.

A disparity's error is Gaussian, a depth's is not once it is more than a twentieth of the depth
itself. A landmark here moves in y = (x/z, y/z, 1/z) of the camera in which it was born, where it
is seen almost linearly for as long as it lives. The state and its covariance stay in metres: an
update moves a landmark by its step in y, and the covariance is carried from the tangent of y at the
old estimate to that at the new one, along with the rest (`vislam.filters.consistent.transport`).

Source: Civera, Davison, Montiel, Inverse depth parametrization for monocular SLAM, IEEE
Transactions on Robotics 24(5), 2008, with the camera at birth held fixed.
"""

from dataclasses import replace

import numpy as np

from vislam.arrays import Array
from vislam.charts import Chart
from vislam.filters import model
from vislam.filters.estimate import Estimate
from vislam.filters.parts import Parts, at_estimate
from vislam.filters.records import Linear
from vislam.gaussian import transposed
from vislam.lie import se3

#: No update moves a landmark from nearer to farther than this: beyond lies infinity, and a variance
#: in metres that no longer goes into one matrix with those of what is near.
FARTHEST_M = 1000.0


def retract(chart: Chart, x: Estimate, delta: Array) -> tuple[Array, Array]:
    """The pose as the chart has it, and each landmark by its step in y."""
    none = x.landmarks[..., :0, :]
    T, _ = chart.retract(x.T, none, delta[..., :6])
    Ts = x.Ts_world_cam
    q = _turned(x.landmarks - Ts[..., :3, 3], Ts)
    dq = _turned(delta[..., 6:].reshape(x.landmarks.shape), Ts)
    depth, share = q[..., 2:], dq[..., 2:] / q[..., 2:]
    growth = 1 / np.maximum(1 - share, np.minimum(depth / FARTHEST_M, 1.0))
    moved = np.concatenate([q[..., :2] + dq[..., :2] - q[..., :2] * share, depth], axis=-1)
    return T, se3.apply(Ts, (growth * moved)[..., None, :])[..., 0, :]


def transport(x: Estimate, T_next: Array, landmarks_next: Array) -> Linear:
    """Carry the covariance along, where a step in y moved the landmarks.

    D is d f'/d y at the new estimate times d y/d f at the old. With it, a rigid motion of the world
    keeps its direction, as in `vislam.filters.consistent.transport`, where
    M = ([I, -f'^] - D [I, -f^]) Ad(T).
    """
    Ts, R_world_cam = x.Ts_world_cam, x.Ts_world_cam[..., :3, :3]
    q = _turned(x.landmarks - Ts[..., :3, 3], Ts)
    q_next = _turned(landmarks_next - Ts[..., :3, 3], Ts)
    growth = q_next[..., 2] / q[..., 2]
    of_cam = np.zeros((*growth.shape, 3, 3))
    of_cam[..., 0, 0] = of_cam[..., 1, 1] = growth
    of_cam[..., 2, 2] = growth**2
    of_cam[..., :2, 2] = growth[..., None] * (q_next - q)[..., :2] / q[..., 2:]
    D = R_world_cam @ of_cam @ transposed(R_world_cam)
    M = (se3.odot(landmarks_next) - D @ se3.odot(x.landmarks)) @ se3.adjoint(x.T)[..., None, :, :]
    rows = (*landmarks_next.shape[:-2], 3 * landmarks_next.shape[-2], 6)
    return Linear(F=model.transition(x.T, T_next), M=M.reshape(rows), D=D)


def _turned(x: Array, Ts: Array) -> Array:
    """Each vector of the world in its camera's axes, shape (..., m, 3)."""
    return np.asarray((x[..., None, :] @ Ts[..., :3, :3])[..., 0, :])


def along_inverse_depth(parts: Parts) -> Parts:
    """The same filter with landmarks that move along their inverse depth.

    One whose landmarks move with the world's frame, or that linearises at first estimates, has a
    covariance that another step would not fit: it stays as it is.
    """
    if parts.from_right is not None or parts.linearise is not at_estimate:
        return parts
    return replace(parts, retract=retract, transport=transport)
