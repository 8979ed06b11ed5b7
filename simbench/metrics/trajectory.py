"""How far an estimated trajectory is from the true one: ATE and RPE.

Source: Sturm, Engelhard, Endres, Burgard, Cremers, A Benchmark for the Evaluation of RGB-D SLAM
Systems (IROS 2012).
"""

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from simbench.errors import InputError
from vislam.arrays import Array
from vislam.lie import se3, so3

Alignment: TypeAlias = Literal["none", "yaw", "se3"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """Errors of poses, or of motions between poses: length and angle, shape (n,) each."""

    translation_m: Array
    rotation_rad: Array


def rmse(errors: Array) -> float:
    """The root of the mean square; NaN of no errors."""
    return float(np.sqrt(np.mean(np.square(errors)))) if np.size(errors) else float("nan")


def align(estimated: Array, true: Array, how: Alignment) -> Array:
    """The rigid motion that brings estimated positions nearest to the true ones, least squares.

    Args:
        estimated: positions, metres, shape (T, 3).
        true: positions, shape (T, 3).
        how: `none`; `yaw`, a translation and a turn about the world's z axis, which is what an
            estimator that senses gravity cannot observe; `se3`, any rigid motion. Where several are
            as near (positions on one line), one of them.

    Returns:
        T_true_estimated, shape (4, 4).

    Source: Umeyama, IEEE PAMI 13(4), 1991, without scale.
    """
    if how == "none":
        return np.eye(4)
    estimated_mean, true_mean = estimated.mean(axis=0), true.mean(axis=0)
    C = (true - true_mean).T @ (estimated - estimated_mean)
    if how == "yaw":
        yaw = np.arctan2(C[1, 0] - C[0, 1], C[0, 0] + C[1, 1])
        R = so3.exp(np.array([0, 0, yaw]))
    elif how == "se3":
        U, _, Vt = np.linalg.svd(C)
        R = U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    else:
        raise InputError(f"Expected an alignment of {get_args(Alignment)}, got {how!r}.")
    return se3.from_rotation_translation(R, true_mean - R @ estimated_mean)


def ate(estimated: Array, true: Array, how: Alignment = "none") -> PoseErrors:
    """Absolute trajectory errors, pose by pose, after an alignment of the positions.

    Args:
        estimated: shape (T, 4, 4).
        true: shape (T, 4, 4).
        how: see `align`.

    Returns:
        Shape (T,); the ATE is the `rmse` of them.
    """
    _check_poses(estimated, true)
    T_true_estimated = align(estimated[:, :3, 3], true[:, :3, 3], how)
    return _size(se3.inverse(true) @ T_true_estimated @ estimated)


def rpe(estimated: Array, true: Array, step: int = 1) -> PoseErrors:
    """Relative pose errors: of the motion from each pose to the one `step` frames later.

    Args:
        estimated: shape (T, 4, 4).
        true: shape (T, 4, 4).
        step: frames, at least 1.

    Returns:
        Shape (T - step,); the RPE is the `rmse` of them.
    """
    _check_poses(estimated, true)
    if step < 1:
        raise InputError(f"Expected a `step` of at least 1 frame, got {step}.")
    moved = [se3.inverse(T[:-step]) @ T[step:] for T in (true, estimated)]
    return _size(se3.inverse(moved[0]) @ moved[1])


def path_length(T_world_imu: Array) -> float:
    """The length of a path in metres, poses of shape (T, 4, 4)."""
    return float(np.linalg.norm(np.diff(T_world_imu[:, :3, 3], axis=0), axis=1).sum())


def _check_poses(estimated: Array, true: Array) -> None:
    if np.shape(estimated)[1:] != (4, 4) or np.shape(estimated) != np.shape(true):
        raise InputError(
            "Expected estimated and true poses at the same frames, of shape (T, 4, 4) both, "
            f"got {np.shape(estimated)} and {np.shape(true)}."
        )


def _size(T: Array) -> PoseErrors:
    """The length and the angle of motions."""
    return PoseErrors(
        translation_m=np.linalg.norm(T[:, :3, 3], axis=-1),
        rotation_rad=np.linalg.norm(so3.log(T[:, :3, :3]), axis=-1),
    )
