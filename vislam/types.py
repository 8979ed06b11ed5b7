"""What passes between a filter and the world.

Frozen, keyword-only dataclasses on plain arrays. A leading ``...`` in a shape stands for an
optional batch axis: runs that share ids, times and visibility, and differ in their numbers.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Literal, Self, TypeAlias, get_args

import numpy as np

from vislam.arrays import Array, BoolArray, IntArray
from vislam.camera import StereoRig
from vislam.charts import CHARTS, ErrorFunction
from vislam.point import PointSensor

#: What a backward pass may hold in memory where nobody says.
MEMORY_BYTES = 2**30

ProcessModel: TypeAlias = Literal["additive", "twist", "twist-density", "twist-relative"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Twist:
    """Body velocities, held until the next sample.

    Attributes:
        time_s: time of the sample.
        linear: velocity of the IMU in its own frame, m/s, shape (..., 3).
        angular: rate of the IMU in its own frame, rad/s, shape (..., 3).
    """

    time_s: float
    linear: Array
    angular: Array

    @property
    def vector(self) -> Array:
        """The paper's u = [v; omega], shape (..., 6)."""
        return np.concatenate([self.linear, self.angular], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuSample:
    """Raw inertial readings, held until the next sample.

    Attributes:
        time_s: time of the sample.
        gyro: angular rate, rad/s, IMU frame, shape (..., 3).
        accel: specific force, m/s^2, IMU frame, shape (..., 3); at rest it points up, 9.80665.
    """

    time_s: float
    gyro: Array
    accel: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame(ABC):
    """The sightings of one frame, whatever the sensor. What is missing is marked, and still here.

    Attributes:
        time_s: time of the frame.
        ids: track of each sighting, each at most once, shape (n,).
        last: whether the data hold no later sighting of the track; all False where the source does
            not know. Shape (n,).
    """

    time_s: float
    ids: IntArray
    last: BoolArray

    @property
    @abstractmethod
    def readings(self) -> Array:
        """The numbers as the sensor gave them, shape (..., n, c)."""

    @property
    @abstractmethod
    def there(self) -> BoolArray:
        """Which of the numbers are not marked as missing, shape (..., n, c)."""

    @abstractmethod
    def with_readings(self, readings: Array) -> Self:
        """The same frame with other numbers, shape (..., n, c)."""

    @abstractmethod
    def without(self, where: BoolArray) -> Self:
        """The same frame with numbers marked as missing; `where` broadcasts to the readings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoFrame(Frame):
    """The features of one stereo frame, as the tracker delivered them.

    Attributes:
        pixels: uL, vL, uR, vR, shape (..., n, 4). What is missing is -1 and still here: to skip it
            is the filter's task.
    """

    pixels: Array

    @property
    def readings(self) -> Array:
        """The pixels."""
        return self.pixels

    @property
    def there(self) -> BoolArray:
        """Which are not -1."""
        return np.asarray(self.pixels != -1)

    def with_readings(self, readings: Array) -> Self:
        """With other pixels."""
        return replace(self, pixels=readings)

    def without(self, where: BoolArray) -> Self:
        """With pixels of -1."""
        return replace(self, pixels=np.where(where, -1.0, self.pixels))


@dataclass(frozen=True, slots=True, kw_only=True)
class PointFrame(Frame):
    """The landmarks that a point sensor read in one frame.

    Attributes:
        points: in the frame of the sensor, metres, shape (..., n, 3). What is missing is NaN.
    """

    points: Array

    @property
    def readings(self) -> Array:
        """The points."""
        return self.points

    @property
    def there(self) -> BoolArray:
        """Which coordinates are not NaN."""
        return ~np.isnan(self.points)

    def with_readings(self, readings: Array) -> Self:
        """With other points."""
        return replace(self, points=readings)

    def without(self, where: BoolArray) -> Self:
        """With coordinates of NaN."""
        return replace(self, points=np.where(where, np.nan, self.points))


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
class State:
    """A pose and a map: the truth, or an estimate without its uncertainty.

    Attributes:
        T_world_imu: shape (..., 4, 4).
        ids: landmark ids in ascending order, shape (m,).
        landmarks: positions in the world, metres, shape (..., m, 3).
    """

    T_world_imu: Array
    ids: IntArray
    landmarks: Array


def _no_ids() -> IntArray:
    return np.empty(0, np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Belief:
    """A snapshot of what a filter holds true, and how surely.

    Attributes:
        T_world_imu: estimated pose, shape (..., 4, 4).
        pose_covariance: of the pose's error, shape (..., 6, 6); None where the pose is not
            estimated.
        ids: landmarks in the order of the arrays below, shape (m,).
        landmarks: their positions in the world, metres, shape (..., m, 3).
        landmark_covariances: of each alone, shape (..., m, 3, 3).
        joint_covariance: of the whole error vector, pose first, shape (..., 6 + 3m, 6 + 3m), or
            (..., 3m, 3m) where the pose is not estimated. None where it was not asked for.
        chart: the chart of the error: a name in `vislam.charts.CHARTS`, or an error function.
    """

    T_world_imu: Array
    pose_covariance: Array | None = None
    ids: IntArray = field(default_factory=_no_ids)
    landmarks: Array = field(default_factory=lambda: np.empty((0, 3)))
    landmark_covariances: Array = field(default_factory=lambda: np.empty((0, 3, 3)))
    joint_covariance: Array | None = None
    chart: str | ErrorFunction = "right"

    @property
    def of_pose(self) -> "Belief":
        """What it holds of the pose alone."""
        return Belief(
            T_world_imu=self.T_world_imu, pose_covariance=self.pose_covariance, chart=self.chart
        )

    def error(self, truth: State) -> Array:
        """The error vector in this belief's chart, in the order of its joint covariance.

        Args:
            truth: the true state; it must know every landmark of `ids`.

        Returns:
            Shape (..., 6 + 3m), or (..., 3m) where the pose is not estimated.

        Raises:
            KeyError: the truth lacks a landmark of this belief.
        """
        if len(missing := np.setdiff1d(self.ids, truth.ids)):
            raise KeyError(f"The truth lacks landmarks {missing.tolist()}.")
        place = np.searchsorted(truth.ids, self.ids)
        e = self._error(self.landmarks, truth.T_world_imu, truth.landmarks[..., place, :])
        return e if self.pose_covariance is not None else e[..., 6:]

    def pose_error(self, T_world_imu: Array) -> Array:
        """The error of the pose alone in this belief's chart, shape (..., 6)."""
        batch = np.broadcast_shapes(self.T_world_imu.shape[:-2], T_world_imu.shape[:-2])
        none = np.empty((*batch, 0, 3))
        return self._error(none, T_world_imu, none)

    def _error(self, landmarks: Array, true_T: Array, true_landmarks: Array) -> Array:
        function = CHARTS[self.chart].error if isinstance(self.chart, str) else self.chart
        return function(self.T_world_imu, landmarks, true_T, true_landmarks)


@dataclass(frozen=True, slots=True, kw_only=True)
class Innovation:
    """What one frame's features had to say, before they changed the belief.

    The whitened residual of an accepted sighting has c numbers. Of a stereo pair four: three that
    the state explains, decorrelated over the frame, and (vL - vR) over its sigma. Of a point sensor
    the first three. With a right filter all are independent standard normal.

    Attributes:
        ids: known landmarks with a valid sighting, whose residual was tested, shape (k,).
        residual: measured minus predicted readings, shape (..., k, c).
        whitened: zero where not accepted, shape (..., k, c).
        accepted: what was used, shape (..., k). The rest is predicted behind the camera, or too
            vaguely to be linear, or was refused by the gate.
        born: ids that entered the map by this frame, shape (b,).
        skipped: ids of invalid features that were not all -1, shape (s,).
    """

    ids: IntArray
    residual: Array
    whitened: Array
    accepted: BoolArray
    born: IntArray = field(default_factory=_no_ids)
    skipped: IntArray = field(default_factory=_no_ids)

    @property
    def nis(self) -> Array:
        """Normalised innovation squared of the accepted sightings, shape (...)."""
        nis: Array = np.square(self.whitened).sum(axis=(-2, -1))
        return nis

    @property
    def dof(self) -> IntArray:
        """Its degrees of freedom, c for each accepted sighting, shape (...)."""
        dof: IntArray = self.whitened.shape[-1] * np.count_nonzero(self.accepted, axis=-1)
        return dof

    @property
    def rejected(self) -> IntArray:
        """How many the gate refused, shape (...)."""
        rejected: IntArray = np.count_nonzero(~self.accepted, axis=-1)
        return rejected


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothed:
    """What a filter knows at the end of the past.

    Attributes:
        final: the final belief over all landmarks.
        poses: the pose at each frame given all that came before and after it, frame by frame;
            empty where nobody asked for it.
    """

    final: Belief
    poses: tuple[Belief, ...] = ()


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
            consistent (`vislam.filters.inverse_depth`).
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
