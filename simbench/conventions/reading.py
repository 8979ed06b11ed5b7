"""Ways to read a file's extrinsics, and which of two the data support."""

from dataclasses import dataclass

import numpy as np

from simbench.conventions.meaning import Meaning
from vislam.arrays import Array, BoolArray

#: A reading beats another where chance would do as well less often than this: a coin tossed for
#: each of the fastest frames (14 of 14, 39 of 50; that of 2019: 6e-7), or one for the sign of each
#: frame's difference, by rank, where the readings turn the camera otherwise. Frames are
#: compared in pairs, so noise that all readings share cancels. The ratio of the medians would not
#: do: it is 0.63 in that of 2019, and near 1 in a noisy scene that is clear all the same.
FALSE_ALARM = 1e-4
#: Errors above are all one: a point that passes the camera has any.
FAR_OFF_PX = 1e3
#: Up to so many frames the tail of the signed rank is counted out: the normal one is heavier there,
#: and would not let 14 of 14 frames be enough.
EXACT = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One way to read a file's extrinsics.

    Attributes:
        meaning: what they are taken to be.
        T_imu_cam: what follows, left optical frame to FLU, shape (4, 4).
        frame_errors_px: median distance between predicted and seen features in the left image, for
            each of the fastest frames, infinite where they would be behind the camera; shape (F,).
        all_errors_px: the same for all frames that are compared.
        turns: whether the frame turns by more than rates are off by (`Motion.turns`), shape (F,).
    """

    meaning: Meaning
    T_imu_cam: Array
    frame_errors_px: Array
    all_errors_px: Array
    turns: BoolArray

    @property
    def name(self) -> str:
        """That of its meaning."""
        return str(self.meaning)

    @property
    def error_px(self) -> float:
        """The median over the frames; NaN where no frame could be judged."""
        return float(np.median(self.frame_errors_px)) if len(self.frame_errors_px) else np.nan

    def better_frames(self, other: "Reading") -> int:
        """How many frames it predicts better."""
        return int(np.count_nonzero(self.frame_errors_px < other.frame_errors_px))

    def beats(self, other: "Reading") -> bool:
        """Whether it predicts frames better than chance would: one-sided tests.

        By the signed rank of the difference, so that each counts for what it shows,
        however noisy the rates; a sign test over the fastest where only a lever arm differs.
        """
        from scipy.special import bdtrc

        if not self.turned_as(other):
            return chance_of_less(self.all_errors_px, other.all_errors_px) < FALSE_ALARM
        difference = (other.frame_errors_px - self.frame_errors_px)[self.turns]
        better, worse = np.count_nonzero(difference > 0), np.count_nonzero(difference < 0)
        # bdtrc(k, n, p) is the probability of more than k successes
        return bool(better > worse and bdtrc(better - 1, better + worse, 0.5) < FALSE_ALARM)

    def turned_as(self, other: "Reading") -> bool:
        """Whether the two differ by where the camera stands at most."""
        return np.allclose(self.T_imu_cam[:3, :3], other.T_imu_cam[:3, :3], rtol=0, atol=1e-9)

    def same_as(self, other: "Reading") -> bool:
        """Whether both mean one matrix."""
        return np.allclose(self.T_imu_cam, other.T_imu_cam, rtol=0, atol=1e-9)


def chance_of_less(errors: Array, others: Array) -> float:
    """The chance that errors are so much less than others where both are alike, shapes (F,).

    Wilcoxon's signed rank (Individual comparisons by ranking methods, Biometrics Bulletin 1(6),
    1945): exactly up to `EXACT` frames, beyond that in its normal limit.
    """
    from scipy.special import ndtr

    difference = np.minimum(others, FAR_OFF_PX) - np.minimum(errors, FAR_OFF_PX)
    difference = difference[difference != 0]
    rank = 1 + np.argsort(np.argsort(np.abs(difference), kind="stable"))
    against = int(rank[difference < 0].sum())
    if len(rank) > EXACT:
        return float(ndtr((against - rank.sum() / 2) / (np.sqrt(np.sum(rank**2.0)) / 2)))
    share = np.ones(1)  # of the ways to draw signs, by the sum of the ranks against
    for each in range(1, len(rank) + 1):
        share = 0.5 * (np.pad(share, (0, each)) + np.pad(share, (each, 0)))
    return float(share[: against + 1].sum())
