"""Which frames a foreign dataset means, found from its own data.

The format fixes the names of its keys but not what they hold. Three things differ between files
that exist:

* what the extrinsics are: `imu_T_cam` (left camera to IMU), `cam_T_imu` (its inverse), or `mixed`
  (the rotation of `cam_T_imu` beside the camera's position in the IMU frame);
* the IMU frame that they mean: `flu` (x forward, y left, z up), as the velocities, or `frd`
  (y right, z down), turned by diag(1, -1, -1) against the velocities;
* the axes of the camera: `optical` (x right, y down, z forward) or `regular` (x forward, y left,
  z up).

Each reading that a dialect leaves open predicts where the features of a frame are seen in the next
one: triangulated, moved with the measured twist, projected. The right one has the smallest error.
A sample may be a mean over the interval, as the format says, or instantaneous, as in real files;
then the mean of the samples at both frames is nearer. A reading is judged by the better of the two.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from simbench.dataset import Sightings
from simbench.noise import white_noise
from simbench.scenario.sensors import R_BODY_OPTICAL
from vislam.arrays import Array, BoolArray, IntArray
from vislam.camera import MIN_DEPTH_M, StereoRig, is_valid, triangulate
from vislam.lie import se3

ImuFrame: TypeAlias = Literal["flu", "frd"]
Extrinsics: TypeAlias = Literal["imu_T_cam", "cam_T_imu", "mixed"]
CameraAxes: TypeAlias = Literal["optical", "regular"]

FLU_FRD = np.diag([1.0, -1.0, -1.0, 1.0])
REGULAR_OPTICAL = se3.from_rotation_translation(R_BODY_OPTICAL, np.zeros(3))

OPTIONS = (
    "--extrinsics imu_T_cam|cam_T_imu|mixed, --imu-frame flu|frd and "
    "--camera-axes optical|regular settle it"
)

#: Frames that are compared, and those of them that are shown: the ones that turn fastest, where the
#: readings disagree most. In a file of 2019, whose two best readings differ by a lever arm alone,
#: the right one predicts 42 of the 50 fastest better, 67 of 100, 210 of 400: so such readings are
#: compared in the fastest alone.
MAX_FRAMES, FASTEST = 500, 50

#: A reading beats another where chance would do as well less often than this: a coin tossed for
#: each of the fastest frames (14 of 14, 39 of 50; that of 2019: 6e-7), or one for the sign of each
#: frame's difference, by rank, where the readings turn the camera otherwise. Frames are
#: compared in pairs, so noise that all readings share cancels. The ratio of the medians would not
#: do: it is 0.63 in that of 2019, and near 1 in a noisy scene that is clear all the same.
FALSE_ALARM = 1e-4
#: Errors above are all one: a point that passes the camera has any.
FAR_OFF_PX = 1e3

#: Where readings differ by a lever arm alone, a frame counts that turns by this times the noise of
#: the rates. In others a rate is off by as much as it is, and a camera on the wrong side of the IMU
#: then makes up for a part of that in every frame: the wrong reading would win.
CLEAR_TURN = 10.0


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a file's extrinsics hold.

    Attributes:
        extrinsics: what the matrix is.
        imu_frame: the IMU frame that it means.
        camera_axes: those of the camera that it means.
    """

    extrinsics: Extrinsics
    imu_frame: ImuFrame = "flu"
    camera_axes: CameraAxes = "optical"

    def __str__(self) -> str:
        """As options and `info` name it, such as ``imu_T_cam/frd`` or ``cam_T_imu/flu/regular``."""
        regular = "" if self.camera_axes == "optical" else "/regular"
        return f"{self.extrinsics}/{self.imu_frame}{regular}"

    @classmethod
    def named(cls, name: str) -> "Meaning":
        """The inverse of `str`; a frame or axes that are left out are FLU and optical.

        Raises:
            ValueError: there is none of this name.
        """
        words = dict(zip(map(_KIND_OF.get, name.split("/")), name.split("/"), strict=True))
        if "extrinsics" not in words or None in words or len(words) <= name.count("/"):
            raise ValueError(
                "expected imu_T_cam, cam_T_imu or mixed, then /flu or /frd, then /optical or "
                f"/regular, got {name!r}"
            )
        return cls(**words)  # type: ignore[arg-type]

    def T_imu_cam(self, given: Array) -> Array:
        """Left optical frame to FLU, of a file's matrix, both shape (4, 4)."""
        T = given.copy() if self.extrinsics == "imu_T_cam" else se3.inverse(given)
        if self.extrinsics == "mixed":
            T[:3, 3] = given[:3, 3]
        if self.camera_axes == "regular":
            T = T @ REGULAR_OPTICAL
        return T if self.imu_frame == "flu" else FLU_FRD @ T

    def given(self, T_imu_cam: Array) -> Array:
        """The file's matrix that means this one: the inverse of `T_imu_cam`."""
        T = T_imu_cam.copy() if self.imu_frame == "flu" else FLU_FRD @ T_imu_cam
        if self.camera_axes == "regular":
            T = T @ REGULAR_OPTICAL.T
        if self.extrinsics == "imu_T_cam":
            return T
        given = se3.inverse(T)
        if self.extrinsics == "mixed":
            given[:3, 3] = T[:3, 3]
        return given


#: What each word of a name is.
_KIND_OF = {
    word: kind
    for kind, words in (
        ("extrinsics", Extrinsics),
        ("imu_frame", ImuFrame),
        ("camera_axes", CameraAxes),
    )
    for word in get_args(words)
}

#: What may be meant by the keys of the dialects; what the key's name claims stands first.
UNTIL_2020 = (
    *(Meaning(e, f) for e in ("cam_T_imu", "imu_T_cam", "mixed") for f in get_args(ImuFrame)),
)
FROM_2021 = (
    *(Meaning(e, f) for e in ("imu_T_cam", "cam_T_imu", "mixed") for f in get_args(ImuFrame)),
)
FROM_2025 = (
    *(Meaning(e, "flu", a) for e in ("cam_T_imu", "imu_T_cam") for a in get_args(CameraAxes)),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Overruled:
    """What a user says of a convention; None leaves it to the data."""

    extrinsics: Extrinsics | None = None
    imu_frame: ImuFrame | None = None
    camera_axes: CameraAxes | None = None

    def of(self, meanings: Sequence[Meaning]) -> tuple[Meaning, ...]:
        """The meanings that agree with it; one that is none of them is added as asked."""
        asked = [
            Meaning(
                self.extrinsics or meaning.extrinsics,
                self.imu_frame or meaning.imu_frame,
                self.camera_axes or meaning.camera_axes,
            )
            for meaning in meanings
        ]
        return tuple(dict.fromkeys(asked))


NOTHING = Overruled()


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One way to read a file's extrinsics.

    Attributes:
        meaning: what they are taken to be.
        T_imu_cam: what follows, left optical frame to FLU, shape (4, 4).
        frame_errors_px: median distance between predicted and seen features in the left image, for
            each of the fastest frames, infinite where they would be behind the camera; shape (F,).
        all_errors_px: the same for all frames that are compared.
        turns: whether the frame turns by more than rates are off by (`CLEAR_TURN`), shape (F,).
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
        from scipy.special import bdtrc, ndtr

        if self.turned_as(other):
            difference = (other.frame_errors_px - self.frame_errors_px)[self.turns]
            better, worse = np.count_nonzero(difference > 0), np.count_nonzero(difference < 0)
            # bdtrc(k, n, p) is the probability of more than k successes
            return bool(better > worse and bdtrc(better - 1, better + worse, 0.5) < FALSE_ALARM)
        return bool(ndtr(-signed_rank(self.all_errors_px, other.all_errors_px)) < FALSE_ALARM)

    def turned_as(self, other: "Reading") -> bool:
        """Whether the two differ by where the camera stands at most."""
        return np.allclose(self.T_imu_cam[:3, :3], other.T_imu_cam[:3, :3], rtol=0, atol=1e-9)

    def same_as(self, other: "Reading") -> bool:
        """Whether both mean one matrix."""
        return np.allclose(self.T_imu_cam, other.T_imu_cam, rtol=0, atol=1e-9)


def signed_rank(errors: Array, others: Array) -> float:
    """By how many standard deviations errors are smaller than others: Wilcoxon's signed rank."""
    difference = np.minimum(others, FAR_OFF_PX) - np.minimum(errors, FAR_OFF_PX)
    difference = difference[difference != 0]
    rank = 1 + np.argsort(np.argsort(np.abs(difference), kind="stable"))
    return float(np.sum(np.sign(difference) * rank) / max(np.sqrt(np.sum(rank**2.0)), 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Convention:
    """How a file was read.

    Attributes:
        chosen: the reading.
        readings: all that were compared, the one that the file claims first.
        clear: the data tell the chosen reading from every other.
        note: what was chosen and how clearly, a sentence for the user; where it is not clear, one
            that starts with "Warning" and says what the data cannot tell.
    """

    chosen: Reading
    readings: tuple[Reading, ...]
    clear: bool
    note: str


def resolve(
    given: Array,
    key: str,
    meanings: Sequence[Meaning],
    motion: "Motion",
    overruled: Overruled = NOTHING,
) -> Convention:
    """Find the reading of a file's extrinsics that its own features support.

    The reading with the smallest error is chosen where it beats the one that the file claims;
    otherwise that one stays, since a reading is never guessed.

    Args:
        given: the file's matrix, a rigid motion, shape (4, 4).
        key: the name under which it stood.
        meanings: what it may be, what the file claims first.
        motion: what the sensors say of the drive.
        overruled: what the user says.
    """
    readings = tuple(
        Reading(
            meaning=meaning,
            T_imu_cam=(T := meaning.T_imu_cam(given)),
            all_errors_px=(errors := motion.prediction_errors(T)),
            frame_errors_px=errors[motion.fastest],
            turns=motion.turns[motion.fastest],
        )
        for meaning in overruled.of(meanings)
    )
    claimed = readings[0]
    best = min(readings, key=lambda reading: np.nan_to_num(reading.error_px, nan=np.inf))
    chosen = best if best.beats(claimed) else claimed
    others = [reading for reading in readings if not reading.same_as(chosen)]
    rivals = [reading for reading in others if not chosen.beats(reading)]
    start = f"The extrinsics `{key}` are read as {chosen.name}"
    if len(readings) == 1:
        note = f"{start}, as asked."
    elif rivals:
        note = f"Warning: {start[0].lower()}{start[1:]}, but not clearly: " + _doubt(
            chosen, readings, rivals, motion
        )
    else:
        note = f"{start}, clearly: {_margin(chosen, others)}({_errors(readings)})."
    return Convention(chosen=chosen, readings=readings, clear=not rivals, note=note)


def _errors(readings: Sequence[Reading]) -> str:
    each = ", ".join(f"{reading.name} {reading.error_px:.2f} px" for reading in readings)
    frames = len(readings[0].frame_errors_px)
    return f"median error of the features predicted over {frames} frames: {each}"


def _margin(chosen: Reading, others: Sequence[Reading]) -> str:
    """By how much the chosen reading wins."""
    if not others:
        return ""
    second = min(others, key=lambda reading: reading.error_px)
    ratio = second.error_px / max(chosen.error_px, 1e-9)  # of data without noise it may be 0
    return (
        f"{ratio:.1f} times nearer than {second.name}, and nearer in "
        f"{chosen.better_frames(second)} of {len(chosen.frame_errors_px)} frames "
    )


def _doubt(
    chosen: Reading, readings: Sequence[Reading], rivals: Sequence[Reading], motion: "Motion"
) -> str:
    """What the data cannot tell, the candidates, and the options that settle it."""
    if not len(chosen.frame_errors_px):
        return f"no feature is seen in two frames, so nothing tells the readings apart; {OPTIONS}."
    turned = not all(rival.turned_as(chosen) for rival in rivals)
    moved_m, turned_deg = motion.largest_step
    return (
        f"its motion does not tell it from {', '.join(rival.name for rival in rivals)}, that is, "
        f"{'how the camera is turned' if turned else 'where the camera stands'} (the fastest "
        f"frames turn by up to {turned_deg:.2g} degrees and move by up to {moved_m:.2g} m; "
        f"{_errors(readings)}); {OPTIONS}."
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
        p = np.einsum("nij,nj->ni", of_point[:, :3, :3], self.points) + of_point[:, :3, 3]
        depth = np.maximum(p[:, 2:], MIN_DEPTH_M)
        focal, centre = np.diag(self.rig.K)[:2], self.rig.K[:2, 2]
        errors = np.linalg.norm(focal * p[:, :2] / depth + centre - self.next_px, axis=1)
        errors[p[:, 2] <= MIN_DEPTH_M] = np.inf
        parts = np.split(errors, self.start[1:-1])[: len(steps)]
        return np.array([np.median(part) for part in parts])
