"""Trajectories as text: poses T_world_imu in the formats of TUM, KITTI and EuRoC.

| format | a line | keeps exactly |
|---|---|---|
| TUM | ``time x y z qx qy qz qw``, s and m | times, positions; rotations to 1e-15 |
| KITTI | 12 numbers, [R, p] row by row, m | whole poses; it has no times |
| EuRoC | ``ns,x,y,z,qw,qx,qy,qz`` and more columns, m | times in whole ns, positions; as TUM |

Every number is written with the digits that give the same float64 back. A rotation matrix and its
unit quaternion are each rounded, so 1e-15 is what a quaternion keeps of a matrix.

Sources: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats, the readme of KITTI's
odometry development kit, and state_groundtruth_estimate0/data.csv of the EuRoC MAV dataset.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from decimal import Context, Decimal, InvalidOperation
from enum import StrEnum
from itertools import pairwise
from pathlib import Path

import numpy as np

from simbench.errors import DatasetError
from simbench.files import format_rows, parse_rows, read_text, replacing
from vislam.arrays import Array
from vislam.lie import se3

NANOSECONDS = Decimal(10**9)
#: 2^63 ns in seconds: the year 2262.
MAX_TIME_S = 9_200_000_000
#: Digits of a time that are kept: those of any float64 above 1e-13 s, and of whole nanoseconds.
EXACT, FINEST = Context(prec=50), Decimal("1e-30")
EUROC_HEAD = (
    "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],"
    "q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n"
)


class Format(StrEnum):
    """What the lines of a file look like."""

    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"


@dataclass(frozen=True, slots=True, kw_only=True)
class Poses:
    """A trajectory.

    Attributes:
        times: seconds as the file's own digits have them, increasing; None where it has none.
        Ts_world_imu: poses, shape (n, 4, 4).
        quaternions: their rotations (x, y, z, w) as the file has them, shape (n, 4); None where it
            has matrices.
    """

    times: tuple[Decimal, ...] | None
    Ts_world_imu: Array
    quaternions: Array | None = None

    @property
    def times_s(self) -> Array:
        """The times, each rounded once, shape (n,); without times, the indices."""
        return np.array([float(t) for t in self.times or range(len(self.Ts_world_imu))])

    @property
    def elapsed_s(self) -> Array:
        """The times from the first one on, without the rounding of large times, shape (n,)."""
        times = self.times or [Decimal(i) for i in range(len(self.Ts_world_imu))]
        return np.array([float(t - times[0]) for t in times])

    def at_rate(self, rate_hz: float) -> "Poses":
        """With times at a rate, from 0 on."""
        times = tuple(Decimal(repr(i / rate_hz)) for i in range(len(self.Ts_world_imu)))
        return replace(self, times=times)


def format_of(text: str) -> Format:
    """EuRoC where commas stand between the numbers, KITTI where there are twelve, otherwise TUM."""
    line = next(_lines(text), "")
    if "," in line:
        return Format.EUROC
    return Format.KITTI if len(line.split()) == 12 else Format.TUM


def parse_poses(text: str, where: str = "text") -> Poses:
    """Read the lines of a file of any of the formats.

    Args:
        text: the lines; # starts a comment.
        where: the file's name, for errors.

    Raises:
        DatasetError: a line is no pose, times do not increase, a quaternion is more than 1 % off
            unit length or a matrix more than 1e-3 off a rotation; names the line, or the pose.
    """
    kind = format_of(text)
    if kind is Format.KITTI:
        rows = parse_rows(text, 12, where)
        return Poses(times=None, Ts_world_imu=_from_matrices(rows.reshape(-1, 3, 4), where))
    columns = 8 if kind is Format.TUM else max(8, next(_lines(text)).count(",") + 1)
    rows = parse_rows(text, columns, where)
    times = tuple(_time(line, kind, where) for line in _lines(text))
    for i, (before, after) in enumerate(pairwise(times), 2):
        if not before < after:
            raise DatasetError(
                f"{where}: expected increasing times, but pose {i} is at {float(after)} s "
                f"after {float(before)} s."
            )
    quaternions = rows[:, [5, 6, 7, 4]] if kind is Format.EUROC else rows[:, 4:]
    Ts_world_imu = _from_quaternions(rows[:, 1:4], quaternions, where)
    return Poses(times=times, Ts_world_imu=Ts_world_imu, quaternions=quaternions)


def read_poses(path: Path | str) -> Poses:
    """Read a file of any of the formats.

    Raises:
        DatasetError: the file cannot be read or is none of them; names file and line.
    """
    return parse_poses(read_text(Path(path)), str(path))


def format_poses(poses: Poses, kind: Format) -> str:
    """The text of a file.

    Raises:
        DatasetError: the format has times, and the poses have none.
    """
    from scipy.spatial.transform import Rotation

    Ts = poses.Ts_world_imu
    if kind is Format.KITTI:
        return format_rows(Ts[:, :3].reshape(-1, 12))
    if poses.times is None:
        raise DatasetError(f"Expected times for a file of {kind}, got poses without.")
    p, q = Ts[:, :3, 3], poses.quaternions
    if q is None:
        q = Rotation.from_matrix(Ts[:, :3, :3]).as_quat(canonical=True)
    if kind is Format.TUM:
        stamps = [_digits(t) for t in poses.times]
        rows, comma, head = np.hstack([p, q]), " ", ""
    else:
        stamps = [str(_whole_ns(t)) for t in poses.times]
        rows, comma, head = np.hstack([p, q[:, [3, 0, 1, 2]]]), ",", EUROC_HEAD
    lines = zip(stamps, rows.tolist(), strict=True)
    return head + "".join(comma.join([t, *map(repr, row)]) + "\n" for t, row in lines)


def write_poses(path: Path | str, poses: Poses, kind: Format) -> None:
    """Write a file, with the digits that keep every number exact.

    Raises:
        DatasetError: the format has times, and the poses have none.
        OutputError: the operating system refused.
    """
    text = format_poses(poses, kind)
    with replacing(Path(path)) as partial:
        partial.write_text(text)


def write_tum(path: Path | str, times_s: Array, Ts_world_imu: Array) -> None:
    """Write a TUM file.

    Args:
        path: where to.
        times_s: increasing, shape (n,).
        Ts_world_imu: poses, shape (n, 4, 4).

    Raises:
        OutputError: the operating system refused.
    """
    times = tuple(Decimal(repr(t)) for t in times_s.tolist())
    write_poses(path, Poses(times=times, Ts_world_imu=Ts_world_imu), Format.TUM)


def _time(line: str, kind: Format, where: str) -> Decimal:
    """The first word of a line as seconds, whatever a stranger wrote there."""
    word = line.replace(",", " ").split()[0]
    try:
        time = EXACT.divide(Decimal(word), NANOSECONDS if kind is Format.EUROC else Decimal(1))
        if abs(time) < MAX_TIME_S:
            return EXACT.normalize(EXACT.quantize(time, FINEST))
    except InvalidOperation:
        pass  # digits that no float64 has
    raise DatasetError(
        f"{where}: expected times in {'nanoseconds' if kind is Format.EUROC else 'seconds'}, got "
        f"{word:.40}."
    )


def _digits(time: Decimal) -> str:
    """Without an exponent, and with a point."""
    text = f"{time:f}"
    return text if "." in text else f"{text}.0"


def _whole_ns(time: Decimal) -> int:
    return int((time * NANOSECONDS).to_integral_value())


def _lines(text: str) -> Iterator[str]:
    """The lines that hold something beside a comment."""
    for line in text.splitlines():
        if content := line.partition("#")[0].strip():
            yield content


def _from_quaternions(p: Array, q: Array, where: str) -> Array:
    from scipy.spatial.transform import Rotation

    length = np.linalg.norm(q, axis=1)
    off = np.flatnonzero(np.abs(length - 1) > 0.01)
    if off.size:
        raise DatasetError(
            f"{where}: expected quaternions of length 1, but that of pose {off[0] + 1} has length "
            f"{length[off[0]]:.6g}."
        )
    return se3.from_rotation_translation(Rotation.from_quat(q).as_matrix(), p)


def _from_matrices(Rp: Array, where: str) -> Array:
    """Poses as they stand; a rotation of few digits is made exact."""
    R = Rp[:, :, :3]
    defect = np.abs(R.swapaxes(1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    off = np.flatnonzero((defect > 1e-3) | (np.linalg.det(R) < 0))
    if off.size:
        raise DatasetError(
            f"{where}: expected 12 numbers [R, p] with R^T R = I and det R = 1, but pose "
            f"{off[0] + 1} is off by {defect[off[0]]:.2g}."
        )
    U, _, Vt = np.linalg.svd(R)
    exact = np.where((defect < 1e-12)[:, None, None], R, U @ Vt)
    return se3.from_rotation_translation(exact, Rp[:, :, 3])
