"""The kinds of trajectories that a scene can name, and their keys."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from simbench.errors import DatasetError
from simbench.files import read_text
from simbench.poses import Format, Poses, format_poses, parse_poses
from simbench.scenario.named import Named
from simbench.scenario.values import (
    NonNegative,
    Number,
    Point,
    Positive,
    Range,
    Section,
    WordOr,
    fault,
)
from vislam.arrays import Array
from vislam.lie import se3, so3


class Start(Section):
    """A pose: a rotation vector, then a translation."""

    translation_m: Point = (0.0, 0.0, 0.0)
    rotvec_deg: Point = (0.0, 0.0, 0.0)

    @property
    def T_world_imu(self) -> Array:
        """As a matrix, shape (4, 4)."""
        R = so3.exp(np.deg2rad(self.rotvec_deg))
        return se3.from_rotation_translation(R, np.array(self.translation_m))


class Motion(Section):
    """What all trajectories have: a sway about the path, zero at t = 0, and a pose at t = 0."""

    kind: str
    roll_deg: Annotated[NonNegative, Field(le=90)] = 0.0
    pitch_deg: Annotated[NonNegative, Field(le=90)] = 0.0
    roll_period_s: Positive = 5.0
    pitch_period_s: Positive = 7.0
    start: WordOr[Literal["identity", "given"], Start] = "identity"
    """The pose at t = 0, to which the whole is moved; `given` leaves it where its keys put it."""

    def end_s(self, rate_hz: float) -> float | None:  # noqa: ARG002
        """Where a motion that does not go on for ever ends, in seconds, in a scene of this rate."""
        return None


class Hover(Motion):
    """Stays about a point: a slow sway of position and heading."""

    kind: Literal["hover"] = "hover"
    sway_m: tuple[NonNegative, NonNegative, NonNegative] = (0.3, 0.3, 0.2)
    yaw_deg: NonNegative = 5.0
    period_s: Positive = 8.0


class Straight(Motion):
    """Straight ahead at constant speed."""

    kind: Literal["straight"] = "straight"
    speed_mps: Positive = 1.0


class Circle(Motion):
    """A level circle, to the left, at constant speed."""

    kind: Literal["circle"] = "circle"
    radius_m: Positive = 10.0
    laps: Positive = 1.0


class Figure8(Motion):
    """A level figure of eight that crosses itself in its middle, where it starts."""

    kind: Literal["figure8"] = "figure8"
    size_m: tuple[Positive, Positive] = (20.0, 10.0)
    laps: Positive = 2.0


class Helix(Motion):
    """A circle that climbs evenly by climb_m over the whole."""

    kind: Literal["helix"] = "helix"
    radius_m: Positive = 8.0
    laps: Positive = 2.0
    climb_m: Number = 6.0


class Random(Motion):
    """Smooth and bounded: sums of sinusoids with seeded phases, in position and heading."""

    kind: Literal["random"] = "random"
    size_m: tuple[NonNegative, NonNegative, NonNegative] = (10.0, 10.0, 2.0)
    yaw_deg: NonNegative = 90.0
    period_s: Range = (8.0, 30.0)

    @field_validator("period_s")
    @classmethod
    def _positive(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] <= 0:
            raise fault("expected periods above 0, got {got}", got=value[0])
        return value


class Waypoints(Motion):
    """Through given points at given times, by a spline with continuous acceleration.

    Without `attitude_deg` (roll, pitch, yaw) or `quaternions` (x, y, z, w) it heads along the path;
    without `times_s` the time is shared out by distance.
    """

    kind: Literal["waypoints"] = "waypoints"
    points: Annotated[tuple[Point, ...], Field(min_length=2)] = ((0.0, 0.0, 0.0), (40.0, 0.0, 0.0))
    times_s: tuple[Number, ...] | None = None
    attitude_deg: tuple[Point, ...] | None = None
    quaternions: tuple[tuple[Number, Number, Number, Number], ...] | None = None
    start: WordOr[Literal["identity", "given"], Start] = "given"

    @field_validator("times_s", "attitude_deg", "quaternions")
    @classmethod
    def _one_for_each_point(cls, value: tuple[Any, ...] | None, info: ValidationInfo) -> Any:
        points = info.data.get("points")
        if value is not None and points is not None and len(value) != len(points):
            raise fault(
                "expected one for each of the {points} points, got {got}",
                points=len(points),
                got=len(value),
            )
        return value

    @field_validator("times_s")
    @classmethod
    def _increasing_from_zero(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value and value[0] != 0:
            raise fault("expected the first time to be 0, got {got}", got=value[0])
        for before, after in zip(value or (), (value or ())[1:], strict=False):
            if not before < after:
                raise fault(
                    "expected increasing times, got {after} after {before}",
                    after=after,
                    before=before,
                )
        return value

    @field_validator("quaternions")
    @classmethod
    def _unit(cls, value: Any, info: ValidationInfo) -> Any:
        for quaternion in value or ():
            if not abs(np.linalg.norm(quaternion) - 1) < 1e-3:
                raise fault("expected quaternions of length 1, got {got}", got=list(quaternion))
        if value is not None and info.data.get("attitude_deg") is not None:
            raise fault("expected attitude_deg or quaternions, got both")
        return value

    @model_validator(mode="after")
    def _apart(self) -> "Waypoints":
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        if self.times_s is None and not steps.all():
            raise fault(
                "expected points that differ from the one before, or times_s; point {got} repeats",
                key="points",
                got=int(np.argmin(steps)) + 1,
            )
        return self

    def end_s(self, rate_hz: float) -> float | None:  # noqa: ARG002
        """The last time."""
        return None if self.times_s is None else self.times_s[-1]


class TrajectoryFile(Named, Motion):
    """A recorded trajectory, a TUM, KITTI or EuRoC file, through the same spline as waypoints.

    The file's first time becomes 0. KITTI's files have no times: their poses are frames of the
    scene, one each 1 / rate_hz.
    """

    kind: Literal["file"] = "file"
    axes: Literal["flu", "optical"] = "flu"
    """Of the body and the world: x forward, y left, z up, or, as in KITTI's own files, optical."""
    start: WordOr[Literal["identity", "given"], Start] = "given"

    @classmethod
    def read(cls, path: Path) -> str:
        """As text without what the scene has no use for: when it began, and further columns."""
        poses = parse_poses(read_text(path), str(path))
        if poses.times is None:
            return format_poses(poses, Format.KITTI)
        elapsed = tuple(t - poses.times[0] for t in poses.times)
        return format_poses(replace(poses, times=elapsed), Format.TUM)

    @field_validator("text")
    @classmethod
    def _readable(cls, value: str) -> str:
        try:
            poses = len(parse_poses(value).Ts_world_imu)
        except DatasetError as error:
            raise fault("{error}", error=error) from error
        if poses < 2:
            raise fault("expected at least two poses, got one")
        return value

    def poses(self, rate_hz: float) -> Poses:
        """The poses with their times, in a scene of this rate."""
        poses = parse_poses(self.text)
        return poses if poses.times else poses.at_rate(rate_hz)

    def end_s(self, rate_hz: float) -> float | None:
        """The last time, counted from the first."""
        return float(self.poses(rate_hz).elapsed_s[-1])


TrajectoryKind: TypeAlias = Annotated[
    Hover | Straight | Circle | Figure8 | Helix | Waypoints | Random | TrajectoryFile,
    Field(discriminator="kind"),
]
