"""Variants of EKF-SLAM that do not gain information where nothing can be observed.

No measurement tells where the world lies: a rigid motion of trajectory and map together changes
none. The paper's filter linearises each observation at another estimate, and so believes, a little
at every update, to have seen that motion. Each variant here replaces one or two parts of `EkfSlam`.
"""

from functools import partial

import numpy as np

from vislam.arrays import Array
from vislam.filters import model
from vislam.filters.estimate import Estimate
from vislam.filters.inverse_depth import along_inverse_depth
from vislam.filters.parts import PAPER, Parts
from vislam.filters.records import Linear
from vislam.filters.slam import EkfSlam
from vislam.lie import so3


def at_first_estimates(x: Estimate) -> tuple[Array, Array]:
    """Linearise at the pose as predicted and each landmark as it was born, in H, F and G alike.

    Source: Huang, Mourikis, Roumeliotis, Observability-based rules for designing consistent EKF
    SLAM estimators, IJRR 29(5), 2010.
    """
    return x.T_first, x.landmarks_first


def transport(x: Estimate, T_next: Array, landmarks_next: Array) -> Linear:
    """Carry the covariance from the estimate before an update to the one after.

    The covariance of the update belongs to errors about the estimate before. With R, p, f before
    and R+, p+, f+ after, a rigid motion of the world keeps its direction in error coordinates where

        theta' = R+^T R theta
        rho' = R+^T R rho + R+^T [p - p+]^ R theta
        f' = f + [f - f+]^ R theta

    The first two are Ad(T+^-1 T), as over a prediction.
    """
    M = np.zeros((*landmarks_next.shape, 6))
    M[..., 3:] = so3.hat(x.landmarks - landmarks_next) @ x.T[..., None, :3, :3]
    rows = (*landmarks_next.shape[:-2], 3 * landmarks_next.shape[-2], 6)
    return Linear(F=model.transition(x.T, T_next), M=M.reshape(rows))


FIRST_ESTIMATES = Parts(linearise=at_first_estimates)
TRANSPORTED = Parts(transport=transport)
INVERSE_DEPTH = along_inverse_depth(PAPER)

slam_fej = partial(EkfSlam, parts=FIRST_ESTIMATES)
slam_transport = partial(EkfSlam, parts=TRANSPORTED)
slam_inverse_depth = partial(EkfSlam, parts=INVERSE_DEPTH)
