"""What ROS means by the covariance of a pose, from what a filter means by it."""

import numpy as np

from vislam.arrays import Array
from vislam.lie import se3, so3
from vislam.types import Belief

#: Of central differences of a chart, in metres and radians.
STEP = 1e-5


def covariance_about_map_axes(belief: Belief) -> Array:
    """The pose covariance as ROS has it: of p_true - p and of a small turn about the map's axes.

    Zeros where the filter does not estimate the pose. The error in the belief's own chart is, to
    first order, J times the one about the map's axes.
    """
    if belief.pose_covariance is None:
        return np.zeros((6, 6))
    R, p = belief.T_world_imu[:3, :3], belief.T_world_imu[:3, 3]
    if belief.chart == "right":
        to_map = np.kron(np.eye(2), R)
    else:
        moves = STEP * np.concatenate([np.eye(6), -np.eye(6)])
        moved = se3.from_rotation_translation(so3.exp(moves[:, 3:]) @ R, p + moves[:, :3])
        ahead, behind = np.array([belief.pose_error(T) for T in moved]).reshape(2, 6, 6)
        to_map = np.linalg.inv((ahead - behind).T / (2 * STEP))
    return to_map @ belief.pose_covariance @ to_map.T
