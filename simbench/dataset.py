"""The data that a filter is run on, and the truth behind them where it is known.

Sightings are sparse: the dense (4, M, T) array of the file format exists only while a file is
read or written.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from vislam.arrays import Array, BoolArray, IntArray
from vislam.types import Belief, Calibration, Frame, Noise, PointFrame, State, StereoFrame, Twist


def nanoseconds(times_s: Array) -> IntArray:
    """Times as whole nanoseconds; a plain product with 1e9 would lose digits of Unix times."""
    whole = np.floor(times_s)
    return whole.astype(np.int64) * 10**9 + np.rint((times_s - whole) * 1e9).astype(np.int64)


def seconds(times_ns: IntArray) -> Array:
    """The inverse, to the last bit: Python divides whole numbers with one rounding."""
    return np.array([ns / 10**9 for ns in times_ns.tolist()])


@dataclass(frozen=True, slots=True, kw_only=True)
class Sightings:
    """The features of a stereo pair by frame.

    Attributes:
        start: the sightings of frame i stand at start[i] to start[i + 1], shape (T + 1,).
        ids: landmark index, 0 to M - 1, ascending within a frame, shape (S,).
        pixels: uL, vL, uR, vR, shape (S, 4). One with only some coordinates at -1 is held, one with
            all at -1 is not.
        last: no later frame holds this landmark, shape (S,).
    """

    start: IntArray
    ids: IntArray
    pixels: Array
    last: BoolArray

    @classmethod
    def from_frames(cls, frames: list[tuple[IntArray, Array]]) -> "Sightings":
        """From (ids, pixels) of each frame."""
        start, ids, pixels = _joined(frames, 4)
        return cls(start=start, ids=ids, pixels=pixels, last=_last_of_each(ids))

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def frames(self) -> IntArray:
        """The frame of each sighting, shape (S,)."""
        return _frames(self.start)

    def only(self, kept: BoolArray, ids: IntArray | None = None) -> "Sightings":
        """Some of the sightings, by a mask (S,), under other ids (S,) where there are some."""
        ids = self.ids if ids is None else ids
        places = np.flatnonzero(kept)
        places = places[np.lexsort((ids[places], self.frames[places]))]
        start = np.searchsorted(self.frames[places], np.arange(len(self.start)))
        ids = ids[places]
        return Sightings(start=start, ids=ids, pixels=self.pixels[places], last=_last_of_each(ids))

    def since(self, where: BoolArray) -> BoolArray:
        """Sightings of a landmark at and after one that is marked, both masks of shape (S,)."""
        by_track = np.argsort(self.ids, kind="stable")
        so_far = np.cumsum(where[by_track])
        first = np.diff(self.ids[by_track], prepend=-1) != 0
        before: IntArray = (so_far - where[by_track])[first]
        after = np.empty(len(self), bool)
        after[by_track] = so_far > before[np.cumsum(first) - 1]
        return after

    def pairs(self, usable: BoolArray, lag: int = 1) -> tuple[IntArray, IntArray]:
        """Places of two usable sightings of a landmark, `lag` frames apart, shapes (n,).

        Args:
            usable: a mask of shape (S,).
            lag: in frames.
        """
        place = np.flatnonzero(usable)
        # frames ascend, and ids within a frame, so a sighting's place in the file is its key's rank
        count = int(self.ids.max(initial=0)) + 1
        keys = self.frames[place] * count + self.ids[place]
        sought = keys + lag * count
        later = np.minimum(np.searchsorted(keys, sought), len(keys) - 1)
        paired = keys[later] == sought
        return place[paired], place[later[paired]]

    def frame(self, i: int, time_s: float) -> StereoFrame:
        """Frame i as a filter gets it."""
        k = slice(self.start[i], self.start[i + 1])
        return StereoFrame(time_s=time_s, ids=self.ids[k], pixels=self.pixels[k], last=self.last[k])


@dataclass(frozen=True, slots=True, kw_only=True)
class PointSightings:
    """The readings of a point sensor by frame.

    Attributes:
        start, ids, last: as of `Sightings`.
        points: in the frame of the sensor, metres, shape (S, 3).
    """

    start: IntArray
    ids: IntArray
    points: Array
    last: BoolArray

    @classmethod
    def from_frames(cls, frames: list[tuple[IntArray, Array]]) -> "PointSightings":
        """From (ids, points) of each frame."""
        start, ids, points = _joined(frames, 3)
        return cls(start=start, ids=ids, points=points, last=_last_of_each(ids))

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def frames(self) -> IntArray:
        """The frame of each sighting, shape (S,)."""
        return _frames(self.start)

    def frame(self, i: int, time_s: float) -> PointFrame:
        """Frame i as a filter gets it."""
        k = slice(self.start[i], self.start[i + 1])
        return PointFrame(time_s=time_s, ids=self.ids[k], points=self.points[k], last=self.last[k])


def _joined(frames: list[tuple[IntArray, Array]], columns: int) -> tuple[IntArray, IntArray, Array]:
    """Where each frame starts, and the ids and readings of all."""
    start = np.cumsum([0, *(len(ids) for ids, _ in frames)])
    ids = np.concatenate([np.empty(0, np.int64), *(ids for ids, _ in frames)])
    return start, ids, np.concatenate([np.empty((0, columns)), *(z for _, z in frames)])


def _frames(start: IntArray) -> IntArray:
    return np.repeat(np.arange(len(start) - 1), np.diff(start))


def _last_of_each(ids: IntArray) -> BoolArray:
    """True where an id occurs for the last time."""
    last = np.zeros(len(ids), bool)
    _, from_behind = np.unique(ids[::-1], return_index=True)
    last[len(ids) - 1 - from_behind] = True
    return last


@dataclass(frozen=True, slots=True, kw_only=True)
class RawImu:
    """Raw inertial readings at their own rate, in the IMU frame; biases where the truth is known.

    Attributes:
        times_s: shape (N,).
        gyro: rad/s, shape (N, 3).
        accel: specific force, m/s^2, shape (N, 3).
        truth_gyro_bias, truth_accel_bias: shape (N, 3), or None.
    """

    times_s: Array
    gyro: Array
    accel: Array
    truth_gyro_bias: Array | None = None
    truth_accel_bias: Array | None = None

    @property
    def times_ns(self) -> IntArray:
        """The times as whole nanoseconds."""
        return nanoseconds(self.times_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What the simulator knows.

    Attributes:
        T_world_imu: poses at the frames, shape (T, 4, 4).
        landmarks: positions in the world, metres, shape (M, 3).
        linear_velocity, angular_velocity: the twist of each sample without noise and bias, shape
            (T, 3).
        calibration: the true geometry of the sensors.
    """

    T_world_imu: Array
    landmarks: Array
    linear_velocity: Array
    angular_velocity: Array
    calibration: Calibration

    def state(self, frame: int) -> State:
        """The true state at a frame."""
        return State(
            T_world_imu=self.T_world_imu[frame],
            ids=np.arange(len(self.landmarks)),
            landmarks=self.landmarks,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Where simulated data come from: with these a dataset can be made again, to the byte.

    Attributes:
        scenario_yaml: the whole scenario, files that it names included.
        seed: its seed.
        run: the run number.
        version: of simbench.
    """

    scenario_yaml: str
    seed: int
    run: int
    version: str


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """One drive.

    Attributes:
        name: names the files made from it.
        times_s: frames and twist samples, increasing, whole nanoseconds, shape (T,).
        linear_velocity: measured, m/s, IMU frame, held over [t_i, t_i+1), shape (T, 3).
        angular_velocity: measured, rad/s, IMU frame, shape (T, 3).
        landmark_count: M; landmark ids are 0 to M - 1.
        sightings: features or points by frame, or None where the data have none.
        calibration: what the filter is told of the geometry.
        noise: what the filter is told of the noise.
        prior: what the filter is told of the start.
        gate: probability of the gate that the filter is told to use, or None.
        imu: raw inertial readings, where there are some.
        truth: where it is known.
        origin: of simulated data.
        notes: what the reader found or chose, in sentences for the user.
    """

    name: str
    times_s: Array
    linear_velocity: Array
    angular_velocity: Array
    landmark_count: int
    sightings: Sightings | PointSightings | None
    calibration: Calibration
    noise: Noise
    prior: Belief
    gate: float | None = None
    imu: RawImu | None = None
    truth: Truth | None = None
    origin: Origin | None = None
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        """The number of frames."""
        return len(self.times_s)

    @cached_property
    def times_ns(self) -> IntArray:
        """The times as whole nanoseconds."""
        return nanoseconds(self.times_s)

    @property
    def twists(self) -> Array:
        """The samples as the paper's u = [v; omega], shape (T, 6)."""
        return np.hstack([self.linear_velocity, self.angular_velocity])

    def frame(self, i: int) -> Frame:
        """Frame i as a filter gets it; without features, an empty one."""
        if self.sightings is None:
            none = np.empty(0, np.int64)
            return StereoFrame(
                time_s=float(self.times_s[i]),
                ids=none,
                pixels=np.empty((0, 4)),
                last=none.astype(bool),
            )
        return self.sightings.frame(i, float(self.times_s[i]))

    def twist(self, i: int) -> Twist:
        """The twist sample of [t_i, t_i+1)."""
        return Twist(
            time_s=float(self.times_s[i]),
            linear=self.linear_velocity[i],
            angular=self.angular_velocity[i],
        )
