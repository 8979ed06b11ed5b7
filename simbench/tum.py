"""Trajectories as TUM files: `time x y z qx qy qz qw` a line, T_world_imu, seconds and metres.

Source: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats
"""

from pathlib import Path

import numpy as np

from simbench.errors import DatasetError
from simbench.files import format_rows, parse_rows, read_text, replacing
from vislam.arrays import Array
from vislam.lie import se3

COLUMNS = 8


def parse_tum(text: str, where: str = "text") -> Array:
    """Read the lines of a TUM file.

    Args:
        text: the lines; # starts a comment.
        where: the file's name, for errors.

    Returns:
        Rows (time, x, y, z, qx, qy, qz, qw) as they stand, shape (n, 8).

    Raises:
        DatasetError: a line is not eight finite numbers, times do not increase, or a quaternion is
            more than 1 % off unit length; names the line, or the pose.
    """
    rows = parse_rows(text, COLUMNS, where)
    late = np.flatnonzero(np.diff(rows[:, 0]) <= 0)
    if late.size:
        before, after = rows[late[0] : late[0] + 2, 0].tolist()
        raise DatasetError(
            f"{where}: expected increasing times, but pose {late[0] + 2} is at {after} s "
            f"after {before} s."
        )
    length = np.linalg.norm(rows[:, 4:], axis=1)
    off = np.flatnonzero(np.abs(length - 1) > 0.01)
    if off.size:
        raise DatasetError(
            f"{where}: expected quaternions (x, y, z, w) of length 1, but that of pose "
            f"{off[0] + 1} has length {length[off[0]]:.6g}."
        )
    return rows


def poses_of(rows: Array) -> tuple[Array, Array]:
    """Times, shape (n,), and poses, shape (n, 4, 4), of the rows that `parse_tum` gives."""
    from scipy.spatial.transform import Rotation

    R = Rotation.from_quat(rows[:, 4:]).as_matrix()
    return rows[:, 0], se3.from_rotation_translation(R, rows[:, 1:4])


def read_tum(path: Path) -> tuple[Array, Array]:
    """Read a TUM file.

    Returns:
        Times in seconds, shape (n,), and poses T_world_imu, shape (n, 4, 4).

    Raises:
        DatasetError: the file cannot be read or is no TUM file; names file and line.
    """
    return poses_of(parse_tum(read_text(path), str(path)))


def write_tum(path: Path, times_s: Array, Ts_world_imu: Array) -> None:
    """Write a TUM file, with the digits that keep every number exact.

    Args:
        path: where to.
        times_s: increasing, shape (n,).
        Ts_world_imu: poses, shape (n, 4, 4).

    Raises:
        OutputError: the operating system refused.
    """
    from scipy.spatial.transform import Rotation

    quaternions = Rotation.from_matrix(Ts_world_imu[:, :3, :3]).as_quat(canonical=True)
    rows = np.column_stack([times_s, Ts_world_imu[:, :3, 3], quaternions])
    with replacing(path) as partial:
        partial.write_text(format_rows(rows))
