"""The reading of a file's extrinsics that its own features support, and how clearly."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simbench.conventions.meaning import NOTHING, Meaning, Overruled
from simbench.conventions.motion import Motion
from simbench.conventions.reading import Reading
from vislam.arrays import Array

OPTIONS = (
    "--extrinsics imu_T_cam|cam_T_imu|mixed, --imu-frame flu|frd and "
    "--camera-axes optical|regular settle it"
)


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
    motion: Motion,
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
    chosen: Reading, readings: Sequence[Reading], rivals: Sequence[Reading], motion: Motion
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
