"""What the sensors read: twists, raw inertial samples, and the sightings of a frame."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from vislam.arrays import Array, BoolArray, IntArray


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
