"""The sections on sensors and on what the filter is told."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from simbench.scenario.values import (
    Count,
    Integer,
    NonNegative,
    Number,
    OneOr,
    PerAxis,
    Point,
    Positive,
    Range,
    Section,
    Share,
    WordOr,
    fault,
)
from vislam.arrays import Array
from vislam.lie import se3, so3

#: Optical axes on a body that is x forward, y left, z up: the columns are the camera's x, y, z.
R_BODY_OPTICAL: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

Pixels = Annotated[Integer, Field(ge=1, le=100_000)]


class Extrinsics(Section):
    """Where the left camera stands on the IMU, and how it is turned."""

    translation_m: Point = (1.1, -0.3, 0.7)
    rotation: Literal["optical"] = "optical"
    rotvec_deg: Point = (0.0, 0.0, 0.0)
    """A further rotation of the camera, in the body frame."""


class Rig(Section):
    """The stereo pair: both cameras alike, the right one baseline_m along the left one's x axis."""

    fx_px: Positive = 552.554
    fy_px: Positive = 552.554
    cx_px: Number = 682.049
    cy_px: Number = 238.770
    baseline_m: Positive = 0.6
    image_px: tuple[Pixels, Pixels] = (1242, 376)
    imu_cam: Extrinsics = Extrinsics()
    depth_m: Range = (1.0, 12.0)
    """Nearer and farther than this nothing is seen."""

    @field_validator("depth_m")
    @classmethod
    def _in_front(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] <= 0:
            raise fault("expected depths above 0, got {got}", got=value[0])
        return value

    @property
    def T_imu_cam(self) -> Array:
        """Left optical frame to IMU frame, shape (4, 4)."""
        R = so3.exp(np.deg2rad(self.imu_cam.rotvec_deg)) @ R_BODY_OPTICAL
        return se3.from_rotation_translation(R, np.array(self.imu_cam.translation_m))


class TwistNoise(Section):
    """White noise of a sample, and a bias: its sigma at the start and its random walk."""

    sigma: PerAxis
    share: PerAxis = 0.0
    """With process_noise twist-relative: of the true value, where that is more than sigma."""
    bias_sigma: PerAxis = 0.0
    bias_walk: PerAxis = 0.0


class LinearNoise(TwistNoise):
    """Of the velocity: m/s a sample, m/s, m/s per sqrt(s)."""

    sigma: PerAxis = 0.2


class AngularNoise(TwistNoise):
    """Of the angular velocity: rad/s a sample, rad/s, rad/s per sqrt(s)."""

    sigma: PerAxis = 0.02


class RawImu(Section):
    """A gyroscope and an accelerometer at their own rate."""

    rate_hz: Annotated[Positive, Field(le=10_000)] = 200.0
    gyro_noise_density: PerAxis = 1.7e-4
    """rad/s per sqrt(Hz)"""
    accel_noise_density: PerAxis = 2.0e-3
    """m/s^2 per sqrt(Hz)"""
    gyro_bias_walk: PerAxis = 1.9e-5
    """rad/s per sqrt(s)"""
    accel_bias_walk: PerAxis = 3.0e-3
    """m/s^2 per sqrt(s)"""


class Imu(Section):
    """The velocities that the filter is fed, and raw readings where `raw` is there."""

    twist: Literal["mean", "instantaneous"] = "mean"
    """Over the interval (integrates exactly), or at its beginning."""
    velocity: LinearNoise = LinearNoise()
    angular_velocity: AngularNoise = AngularNoise()
    raw: RawImu | None = None


class Outliers(Section):
    """Sightings that are wrong: how many, and by how much."""

    share: Share = 0.0
    size_px: NonNegative = 30.0


class Tracks(Section):
    """How long a tracker holds a landmark, in frames; then it is lost for good."""

    median_frames: Count = 10
    min_frames: Annotated[Count, Field(validate_default=True)] = 3
    max_frames: Annotated[Count, Field(validate_default=True)] = 200

    @field_validator("min_frames")
    @classmethod
    def _not_above_median(cls, value: int, info: ValidationInfo) -> int:
        if value > (median := info.data.get("median_frames", value)):
            raise fault(
                "expected at most median_frames, {median}, got {got}", median=median, got=value
            )
        return value

    @field_validator("max_frames")
    @classmethod
    def _not_below_median(cls, value: int, info: ValidationInfo) -> int:
        if value < (median := info.data.get("median_frames", value)):
            raise fault(
                "expected at least median_frames, {median}, got {got}", median=median, got=value
            )
        return value


class Camera(Section):
    """What the camera makes of what it sees."""

    sigma_px: OneOr[Positive, tuple[Positive, Positive, Positive, Positive]] = 0.7
    """Of uL, vL, uR, vR."""
    dropout: Share = 0.0
    """Share of sightings lost."""
    half_missing: Share = 0.0
    """Share of sightings with one image lost."""
    outliers: Outliers = Outliers()
    walls: tuple[tuple[Number, Number, Number, Number, Positive], ...] = ()
    """x0, y0, x1, y1, height: what is behind is not seen."""
    tracks: Tracks | None = None
    """Left out, a landmark is seen whenever it is in view."""


class PointSensor(Section):
    """A sensor that reads where landmarks are in its own frame, in place of the stereo pair.

    It stands at rig.imu_cam; of camera, dropout, walls and tracks are its own too.
    """

    range_m: Range = (0.5, 20.0)
    """Nearer and farther than this nothing is seen."""
    view_deg: Annotated[Positive, Field(le=360)] = 120.0
    """Opening of the cone about its z axis in which it sees."""
    share: NonNegative = 0.01
    """Sigma of a coordinate as a share of its true value."""
    floor_m: Positive = 0.05
    """The least sigma of a coordinate."""

    @field_validator("range_m")
    @classmethod
    def _not_negative(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] < 0:
            raise fault("expected distances of at least 0, got {got}", got=value[0])
        return value


class Prior(Section):
    """The initial estimate is drawn from this, and the filter is told so."""

    sigma_translation_m: PerAxis = 0.05
    sigma_rotation_deg: PerAxis = 0.5


class Told(Section):
    """Where the filter is told something else than the truth."""

    rotation_error_deg: Point = (0.0, 0.0, 0.0)
    translation_error_m: Point = (0.0, 0.0, 0.0)
    baseline_scale: Positive = 1.0
    pixel_sigma_scale: Positive = 1.0
    """Of a sighting's noise, that of a point sensor too."""
    twist_sigma_scale: Positive = 1.0


class Filter(Section):
    """How the filter is set."""

    process_noise: Literal["twist", "twist-relative", "twist-density", "additive"] = "twist"
    """Noise of a twist sample: the same for any interval, or at least a share of the twist, or a
    density (sigma is that of an interval of 1 / rate_hz, and falls with the root of longer ones),
    or the paper's constant W."""
    gate: WordOr[Literal["none"], Annotated[Number, Field(gt=0, lt=1)]] = "none"
    """Probability of the chi-square gate, or none."""

    @property
    def gate_probability(self) -> float | None:
        """The gate as the filter takes it."""
        return None if self.gate == "none" else float(self.gate)
