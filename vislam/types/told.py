"""What a filter is told before it starts."""

from dataclasses import dataclass, field
from typing import Literal, TypeAlias, get_args

import numpy as np

from vislam.arrays import Array
from vislam.camera import StereoRig
from vislam.point import PointSensor
from vislam.types.beliefs import Belief

#: What a backward pass may hold in memory where nobody says.
MEMORY_BYTES = 2**30

ProcessModel: TypeAlias = Literal["additive", "twist", "twist-density", "twist-relative"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """What a filter is told of its sensors' geometry.

    Attributes:
        rig: the stereo pair, or the point sensor in its place.
        T_imu_cam: left optical frame, or the point sensor's, to IMU frame, shape (4, 4).
    """

    rig: StereoRig | PointSensor
    T_imu_cam: Array

    @property
    def stereo(self) -> StereoRig:
        """The rig, for what is about pixels alone.

        Raises:
            ValueError: there is a point sensor.
        """
        if not isinstance(self.rig, StereoRig):
            raise ValueError("Expected a stereo rig, got a point sensor, which has no pixels.")
        return self.rig


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """What a filter is told of its sensors' noise.

    Attributes:
        process_model: what `process` is the covariance of.
            `twist`: of a twist sample's noise n, u = u_true + n, the same for any interval.
            `twist-density`: n ~ N(0, process / tau) over an interval tau.
            `twist-relative`: as `twist`, of the least noise of a sample; each component's sigma is
            its `twist_share` of the twist where that is more.
            `additive`: of the pose's error of one step, T+ = T exp(tau u^) exp(w^), the paper's W.
        process: covariance in (rho, phi) order, shape (6, 6).
        twist_share: of a `twist-relative` model, shape (6,).
        sigma_px: standard deviations of uL, vL, uR, vR, shape (4,); none of a point sensor.
        point_share: of a point sensor: a coordinate's standard deviation is this share of it,
        point_floor_m: or this, where that is more. 0 of a stereo pair.
    """

    process_model: ProcessModel
    process: Array
    twist_share: Array = field(default_factory=lambda: np.zeros(6))
    sigma_px: Array = field(default_factory=lambda: np.empty(0))
    point_share: float = 0.0
    point_floor_m: float = 0.0

    def twist_covariance(self, u: Array) -> Array:
        """Of a twist sample u = [v; omega], shape (..., 6) to (6, 6) or (..., 6, 6).

        The share is of the sample as measured, which is all that a filter has.
        """
        if self.process_model != "twist-relative":
            return self.process
        more = np.square(self.twist_share * u) - np.diagonal(self.process)
        return np.asarray(self.process + np.maximum(more, 0)[..., None, :] * np.eye(6))

    def sigma(self, readings: Array) -> Array:
        """Standard deviations of readings, shape (..., n, c) to (c,) or (..., n, c)."""
        if len(self.sigma_px):
            return self.sigma_px
        sigma: Array = np.maximum(self.point_share * np.abs(readings), self.point_floor_m)
        return sigma

    def __post_init__(self) -> None:
        """Refuse what is no noise."""
        if self.process_model not in get_args(ProcessModel):
            raise ValueError(
                f"Expected `process_model` to be one of {get_args(ProcessModel)}, "
                f"got {self.process_model!r}."
            )
        if np.shape(self.process) != (6, 6):
            raise ValueError(f"Expected `process` of shape (6, 6), got {np.shape(self.process)}.")
        if np.shape(self.twist_share) != (6,) or not np.all(np.asarray(self.twist_share) >= 0):
            raise ValueError(f"Expected six `twist_share` of at least 0, got {self.twist_share}.")
        if self.point_floor_m and not np.size(self.sigma_px):
            if not (self.point_floor_m > 0 and self.point_share >= 0):
                raise ValueError(
                    "Expected `point_floor_m` above 0 and `point_share` of at least 0, got "
                    f"{self.point_floor_m} and {self.point_share}."
                )
        elif np.shape(self.sigma_px) != (4,) or not np.all(np.asarray(self.sigma_px) > 0):
            raise ValueError(f"Expected four positive `sigma_px`, got {self.sigma_px}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """All that a filter is told before it starts; a factory takes one and returns a filter.

    Attributes:
        calibration: geometry of the sensors.
        noise: their noise.
        prior: the initial pose and its covariance, and a known map where there is one.
        gate: probability of the chi-square gate, or None for no gate.
        trajectory: the true poses at the frames, for a filter that takes the trajectory as given,
            shape (T, 4, 4); None where nobody knows them.
        memory_bytes: what a backward pass may hold in memory; the rest goes to a temporary file. 0
            for no backward pass: what has left a filter's state is forgotten then.
        retire_after: frames without a sighting after which a landmark leaves the state, on a stream
            that does not know the last ones; a later sighting starts a new landmark. None for
            never.
        inverse_depth: whether landmarks move along their inverse depth, which keeps far ones
            consistent (`vislam.filters.inverse_depth`), in a filter that can move them so.
        smooth: whether the past poses are wanted at the end, from a filter that can give them.
        rng: for a filter that needs chance.
    """

    calibration: Calibration
    noise: Noise
    prior: Belief
    gate: float | None = None
    trajectory: Array | None = None
    memory_bytes: int = MEMORY_BYTES
    retire_after: int | None = None
    inverse_depth: bool = False
    smooth: bool = False
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
