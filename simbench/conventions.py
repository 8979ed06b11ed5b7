"""Which frames a foreign dataset means, found from its own data.

The format fixes the names of its keys but not what they hold. Two things differ between files
that exist:

* what the extrinsics are: `imu_T_cam` (left camera to IMU), `cam_T_imu` (its inverse), or `mixed`
  (the rotation of `cam_T_imu` beside the camera's position in the IMU frame);
* the IMU frame that they mean: `flu` (x forward, y left, z up), as the velocities, or `frd`
  (y right, z down), turned by diag(1, -1, -1) against the velocities.

Each of the six readings predicts where the features of a frame are seen in the next one:
triangulated, moved with the measured twist, projected. The right reading has the smallest error.
A sample may be a mean over the interval, as the format says, or instantaneous, as in real files;
then the mean of the samples at both frames is nearer. A reading is judged by the better of the two.
"""

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from simbench.dataset import Sightings
from vislam.arrays import Array, IntArray
from vislam.camera import MIN_DEPTH_M, StereoRig, Validity, triangulate, validity
from vislam.lie import se3

ImuFrame: TypeAlias = Literal["flu", "frd"]
Extrinsics: TypeAlias = Literal["imu_T_cam", "cam_T_imu", "mixed"]

FLU_FRD = np.diag([1.0, -1.0, -1.0, 1.0])

#: Frames that are judged, those that turn fastest: there the readings disagree most. In a file of
#: 2019, whose two best readings differ by a lever arm alone, the right one predicts 42 of the 50
#: fastest better, 67 of 100, 210 of 400.
MAX_FRAMES = 50

#: A reading beats another where a coin tossed for each frame would do as well less often than this:
#: 14 of 14 frames, 39 of 50. (That of 2019: 6e-7; one of 2022, turned by the frame: 2e-11.) Frames
#: are compared in pairs, so noise that all readings share cancels. The ratio of the medians would
#: not do: it is 0.63 and 0.04 in those two, and near 1 in a noisy scene that is clear all the same.
FALSE_ALARM = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One way to read a file's extrinsics.

    Attributes:
        extrinsics: what the matrix is.
        imu_frame: the IMU frame that it means.
        T_imu_cam: what follows, left optical frame to FLU, shape (4, 4).
        frame_errors_px: median distance between predicted and seen features in the left image, for
            each frame judged, infinite where they would be behind the camera; shape (F,).
    """

    extrinsics: Extrinsics
    imu_frame: ImuFrame
    T_imu_cam: Array
    frame_errors_px: Array

    @property
    def name(self) -> str:
        """As the options name it, such as ``imu_T_cam/frd``."""
        return f"{self.extrinsics}/{self.imu_frame}"

    @property
    def error_px(self) -> float:
        """The median over the frames; NaN where no frame could be judged."""
        return float(np.median(self.frame_errors_px)) if len(self.frame_errors_px) else np.nan

    def beats(self, other: "Reading") -> bool:
        """Whether it predicts more frames better than chance would: a one-sided sign test."""
        from scipy.special import bdtrc

        better = np.count_nonzero(self.frame_errors_px < other.frame_errors_px)
        worse = np.count_nonzero(self.frame_errors_px > other.frame_errors_px)
        # bdtrc(k, n, p) is the probability of more than k successes
        return bool(better > worse and bdtrc(better - 1, better + worse, 0.5) < FALSE_ALARM)


@dataclass(frozen=True, slots=True, kw_only=True)
class Convention:
    """How a file was read.

    Attributes:
        chosen: the reading.
        readings: all that were compared, the one that the key's name claims first.
        clear: the data tell the chosen reading from every other.
        note: what was chosen and how clearly, a sentence for the user.
    """

    chosen: Reading
    readings: tuple[Reading, ...]
    clear: bool
    note: str


def resolve(
    given: Array,
    key: Literal["imu_T_cam", "cam_T_imu"],
    motion: "Motion",
    *,
    imu_frame: ImuFrame | None = None,
    extrinsics: Extrinsics | None = None,
) -> Convention:
    """Find the reading of a file's extrinsics that its own features support.

    The reading with the smallest error is chosen where it beats the one that the key's name claims;
    otherwise that one stays, since a reading is never guessed.

    Args:
        given: the file's matrix, a rigid motion, shape (4, 4).
        key: the name under which it stood.
        motion: what the sensors say of the drive.
        imu_frame: holds this fixed.
        extrinsics: holds this fixed.
    """
    candidates = [
        (name, frame)
        for name in sorted(get_args(Extrinsics), key=lambda name: name != key)
        for frame in get_args(ImuFrame)
        if extrinsics in (None, name) and imu_frame in (None, frame)
    ]
    readings = tuple(
        Reading(
            extrinsics=name,
            imu_frame=frame,
            T_imu_cam=(T := _read_as(given, name, frame)),
            frame_errors_px=motion.prediction_errors(T),
        )
        for name, frame in candidates
    )
    claimed = readings[0]
    best = min(readings, key=lambda reading: np.nan_to_num(reading.error_px, nan=np.inf))
    chosen = best if best.beats(claimed) else claimed
    rivals = [
        reading
        for reading in readings
        if not np.allclose(reading.T_imu_cam, chosen.T_imu_cam, rtol=0, atol=1e-9)
        and not chosen.beats(reading)
    ]
    return Convention(
        chosen=chosen,
        readings=readings,
        clear=not rivals,
        note=_note(key, chosen, readings, rivals),
    )


def _read_as(given: Array, extrinsics: Extrinsics, imu_frame: ImuFrame) -> Array:
    T = given if extrinsics == "imu_T_cam" else se3.inverse(given)
    if extrinsics == "mixed":
        T[:3, 3] = given[:3, 3]
    return T if imu_frame == "flu" else FLU_FRD @ T


def _note(key: str, chosen: Reading, readings: tuple[Reading, ...], rivals: list[Reading]) -> str:
    """The choice in a sentence."""
    start = f"The extrinsics `{key}` are read as {chosen.name}"
    if len(readings) == 1:
        return f"{start}, as asked."
    errors = ", ".join(f"{reading.name} {reading.error_px:.2f} px" for reading in readings)
    frames = len(chosen.frame_errors_px)
    if not frames:
        return (
            f"{start}: no feature is seen in two frames, so nothing tells the readings apart; "
            "--imu-frame flu|frd and --extrinsics imu_T_cam|cam_T_imu|mixed overrule it."
        )
    if rivals:
        return (
            f"{start}, but not clearly: its motion does not tell it from "
            f"{', '.join(rival.name for rival in rivals)} (median error of the features predicted "
            f"over {frames} frames: {errors}); --imu-frame flu|frd and "
            "--extrinsics imu_T_cam|cam_T_imu|mixed overrule it."
        )
    return (
        f"{start}, clearly (median error of the features predicted over {frames} frames: {errors})."
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Features seen in two consecutive frames, and the measured motion between.

    Attributes:
        rig: the stereo pair.
        steps: the motion of the IMU over each frame judged, exp(-tau u^): by the sample at the
            frame, and by its mean with the next one; shape (2, F, 4, 4).
        start: the features of frame f stand at start[f] to start[f + 1], shape (F + 1,).
        points: as triangulated in the first frame, left optical frame, shape (n, 3).
        next_px: where the left image shows them in the second, shape (n, 2).
    """

    rig: StereoRig
    steps: Array
    start: IntArray
    points: Array
    next_px: Array

    @classmethod
    def of(
        cls, rig: StereoRig, times_s: Array, twists: Array, sightings: Sightings | None
    ) -> "Motion":
        """Pair the valid features of the frames that turn fastest with those of their next frame.

        Args:
            rig: the stereo pair.
            times_s: frames, shape (T,).
            twists: measured, (v, omega), shape (T, 6).
            sightings: features by frame; None leaves nothing to judge by.
        """
        sightings = sightings or Sightings.from_frames(
            [(np.empty(0, np.int64), np.empty((0, 4)))] * len(times_s)
        )
        frame = np.repeat(np.arange(len(times_s)), np.diff(sightings.start))
        valid = np.flatnonzero(validity(rig, sightings.pixels) == Validity.VALID)
        # frames ascend, and ids within a frame, so a sighting's place in the file is its key's rank
        count = int(sightings.ids.max(initial=0)) + 1
        keys = frame[valid] * count + sightings.ids[valid]
        later = np.minimum(np.searchsorted(keys, keys + count), max(len(keys) - 1, 0))
        paired = np.flatnonzero(keys[later] == keys + count)
        first, second = valid[paired], valid[later[paired]]

        usable = np.unique(frame[first])
        means = 0.5 * (twists[usable] + twists[usable + 1])
        turning = np.linalg.norm(means[:, 3:], axis=1)
        fastest = np.sort(np.argsort(-turning, kind="stable")[:MAX_FRAMES])
        judged = usable[fastest]
        tau = times_s[judged + 1] - times_s[judged]
        kept = np.isin(frame[first], judged)
        first, second = first[kept], second[kept]
        return cls(
            rig=rig,
            steps=se3.exp(-tau[:, None] * np.stack([twists[judged], means[fastest]])),
            start=np.searchsorted(frame[first], np.append(judged, len(times_s))),
            points=triangulate(rig, sightings.pixels[first]),
            next_px=sightings.pixels[second, :2],
        )

    def prediction_errors(self, T_imu_cam: Array) -> Array:
        """The median error of each frame in pixels, with these extrinsics, shape (F,)."""
        by_sample, by_mean = (
            self._errors(se3.inverse(T_imu_cam) @ steps @ T_imu_cam) for steps in self.steps
        )
        if not len(by_mean) or np.median(by_mean) <= np.median(by_sample):
            return by_mean
        return by_sample

    def _errors(self, steps: Array) -> Array:
        """The same for given motions of the camera, shape (F, 4, 4)."""
        of_point = np.repeat(steps, np.diff(self.start), axis=0)
        p = np.einsum("nij,nj->ni", of_point[:, :3, :3], self.points) + of_point[:, :3, 3]
        depth = np.maximum(p[:, 2:], MIN_DEPTH_M)
        focal, centre = np.diag(self.rig.K)[:2], self.rig.K[:2, 2]
        errors = np.linalg.norm(focal * p[:, :2] / depth + centre - self.next_px, axis=1)
        errors[p[:, 2] <= MIN_DEPTH_M] = np.inf
        parts = np.split(errors, self.start[1:-1])[: len(steps)]
        return np.array([np.median(part) for part in parts])
