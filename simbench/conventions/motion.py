"""How a drive moves by its sensors, and how well extrinsics agree with that."""

from dataclasses import dataclass

import numpy as np

from simbench.dataset import Sightings
from simbench.noise import white_noise
from vislam.arrays import Array, BoolArray, IntArray
from vislam.camera import StereoRig, is_valid, project_or_nan, triangulate
from vislam.lie import se3

#: Frames that are compared, and those of them that are shown: the ones that turn fastest, where the
#: readings disagree most. In a file of 2019, whose two best readings differ by a lever arm alone,
#: the right one predicts 42 of the 50 fastest better, 67 of 100, 210 of 400: so such readings are
#: compared in the fastest alone.
MAX_FRAMES, FASTEST = 500, 50

#: Where readings differ by a lever arm alone, a frame counts that turns by this times the noise of
#: the rates. In others a rate is off by as much as it is, and a camera on the wrong side of the IMU
#: then makes up for a part of that in every frame: the wrong reading would win.
CLEAR_TURN = 10.0


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
        fastest: which frames turn fastest, shape (F,).
        turns: which frames turn by more than rates are off by (`CLEAR_TURN`), shape (F,).
    """

    rig: StereoRig
    steps: Array
    start: IntArray
    points: Array
    next_px: Array
    fastest: BoolArray
    turns: BoolArray

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
        frame = sightings.frames
        first, second = sightings.pairs(is_valid(rig, sightings.pixels))
        usable = np.unique(frame[first])
        means = 0.5 * (twists[usable] + twists[usable + 1])
        turning = np.linalg.norm(means[:, 3:], axis=1)
        by_turning = np.argsort(-turning, kind="stable")
        compared = np.sort(by_turning[:MAX_FRAMES])
        judged = usable[compared]
        tau = times_s[judged + 1] - times_s[judged]
        kept = np.isin(frame[first], judged)
        first, second = first[kept], second[kept]
        return cls(
            rig=rig,
            steps=se3.exp(-tau[:, None] * np.stack([twists[judged], means[compared]])),
            start=np.searchsorted(frame[first], np.append(judged, len(times_s))),
            points=triangulate(rig, sightings.pixels[first]),
            next_px=sightings.pixels[second, :2],
            fastest=np.isin(compared, by_turning[:FASTEST]),
            turns=turning[compared] > CLEAR_TURN * np.max(white_noise(twists)[3:]),
        )

    @property
    def largest_step(self) -> tuple[float, float]:
        """The longest way and the largest turn in one of the fastest frames, metres and degrees."""
        xi = se3.log(self.steps[1, self.fastest])
        lengths = np.linalg.norm(xi.reshape(-1, 2, 3), axis=-1).max(axis=0)
        return float(lengths[0]), float(np.rad2deg(lengths[1]))

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
        p = se3.apply(of_point, self.points[:, None])[:, 0]
        left_px = project_or_nan(self.rig, p)[:, :2]
        errors = np.linalg.norm(left_px - self.next_px, axis=1)
        errors[np.isnan(errors)] = np.inf
        parts = np.split(errors, self.start[1:-1])[: len(steps)]
        return np.array([np.median(part) for part in parts])
