"""Sightings that a tracker repeated from the frame before instead of looking again.

Real files of the format hold them: where a tracker searches new features, about every seventh
frame, all tracks that go on have the pixels of the frame before, to the last bit, while the vehicle
moved. A filter that takes such a sighting for one sees the vehicle stand still. What comes after is
one of two things, and the next sighting tells which:

* The tracker looks on from those pixels in the new image, that is at another point of the world: so
  do the real files, whose next sighting lies as near to the repeated one, moved on by a frame, as
  any sighting to the one before. The repeated sighting is then the first of a new landmark.
* The picture stood still, and the next one shows the same point where it went meanwhile.
"""

from dataclasses import replace

import numpy as np

from simbench.dataset import Dataset, Sightings
from vislam.arrays import Array, BoolArray
from vislam.camera import in_front, is_valid, project, triangulate
from vislam.lie import se3
from vislam.types import Calibration

#: In a frame that repeats, the motion predicts that its features moved by more than this.
MOVED_PX = 0.5


def without_repeats(dataset: Dataset) -> Dataset:
    """The same drive with no sighting of a landmark where it was in the frame before.

    A repeated sighting is left out; where tracks slid on to another point, the last one of a row
    stays, as the first of a new landmark. A track keeps its id up to there; what follows gets ids
    from `landmark_count` on. The dataset itself comes back where nothing is repeated, and where the
    truth is known: there a landmark is what the truth calls so.
    """
    sightings = dataset.sightings
    if dataset.truth is not None or not isinstance(sightings, Sightings):
        return dataset
    repeated = _repeated(dataset, sightings)
    if not repeated.any():
        return dataset
    slid = _slides(dataset, sightings, repeated)
    kept = _slid(sightings, repeated, dataset.landmark_count) if slid else sightings.only(~repeated)
    frames = len(np.unique(sightings.frames[repeated]))
    fate = "start new landmarks, at which the tracks go on" if slid else "are left out"
    note = (
        f"{np.count_nonzero(repeated)} sightings in {frames} of {len(dataset)} frames repeat those "
        f"of the frame before to the last bit although the vehicle moved: they {fate}."
    )
    return replace(
        dataset,
        sightings=kept,
        landmark_count=int(kept.ids.max(initial=dataset.landmark_count - 1)) + 1,
        notes=(*dataset.notes, note),
    )


def _repeated(dataset: Dataset, sightings: Sightings) -> BoolArray:
    """Which sightings repeat that of the frame before, shape (S,).

    A frame repeats where most features that it shares with the one before are equal to the last
    bit, and the measured motion says that the median one of them moved. The others of such a frame
    were seen anew.
    """
    repeated = np.zeros(len(sightings), bool)
    start, calibration = sightings.start, dataset.calibration
    steps = _in_camera(calibration, se3.inverse(_steps(dataset)))
    for i, step in enumerate(steps):
        before, now = (slice(start[k], start[k + 1]) for k in (i, i + 1))
        _, a, b = np.intersect1d(
            sightings.ids[before], sightings.ids[now], assume_unique=True, return_indices=True
        )
        pixels = sightings.pixels[before][a]
        equal = np.all(pixels == sightings.pixels[now][b], axis=-1)
        if 2 * np.count_nonzero(equal) <= len(equal):
            continue
        level = pixels[equal]
        level[:, 1::2] = level[:, 1::2].mean(axis=1, keepdims=True)  # as it is triangulated
        shift = np.linalg.norm(_off(calibration, step, level, level), axis=1)
        if not np.isnan(shift).all() and np.nanmedian(shift) > MOVED_PX:
            repeated[start[i + 1] + b[equal]] = True
    return repeated


def _slides(dataset: Dataset, sightings: Sightings, repeated: BoolArray) -> bool:
    """Whether tracks go on from where they were repeated, and not from where they were seen.

    It is the one from which the measured motion predicts the next sightings nearer, but for the
    shift that all features of a frame have in common: what a noisy rate of turn makes of it says
    nothing.
    """
    calibration = dataset.calibration
    order = np.argsort(sightings.ids, kind="stable")
    ids, pixels = sightings.ids[order], sightings.pixels[order]
    frame, again = sightings.frames[order], repeated[order]
    held = np.flatnonzero(again[:-1] & ~again[1:] & (ids[:-1] == ids[1:]))
    seen = np.flatnonzero(~again)
    before = seen[np.searchsorted(seen, held) - 1]  # a track never starts with a repeated sighting
    T = np.concatenate([np.eye(4)[None], _steps(dataset)])
    for i in range(1, len(T)):
        T[i] = T[i - 1] @ T[i]
    motions = (se3.inverse(T[frame[held + 1]]) @ T[frame[source]] for source in (before, held))
    off = np.stack(
        [
            _off(calibration, _in_camera(calibration, motion), pixels[held], pixels[held + 1])
            for motion in motions
        ]
    )
    known = np.isfinite(off).all(axis=(0, 2))
    off, next_frame = off[:, known], frame[held + 1][known]
    for i in np.unique(next_frame):
        off[:, next_frame == i] -= np.median(off[:, next_frame == i], axis=1, keepdims=True)
    from_before, from_held = np.linalg.norm(off, axis=-1).sum(axis=1)
    return bool(from_held <= from_before)


def _slid(sightings: Sightings, repeated: BoolArray, landmark_count: int) -> Sightings:
    """With a new landmark from the last repeated sighting of a row on, without those before it."""
    by_track = np.argsort(sightings.ids, kind="stable")
    ids, again = sightings.ids[by_track], repeated[by_track]
    goes_on = np.append((ids[1:] == ids[:-1]) & again[1:], False)  # the next one repeats this one
    starts, kept = np.empty(len(ids), bool), np.empty(len(ids), bool)
    starts[by_track], kept[by_track] = again & ~goes_on, ~(again & goes_on)
    landmark = np.empty(len(ids), np.int64)
    landmark[by_track] = landmark_count + np.cumsum(starts[by_track]) - 1
    return sightings.only(kept, np.where(sightings.since(starts), landmark, sightings.ids))


def _steps(dataset: Dataset) -> Array:
    """The measured motion of the IMU over each frame, T_i^-1 T_i+1, shape (T - 1, 4, 4)."""
    return se3.exp(np.diff(dataset.times_s)[:, None] * dataset.twists[:-1])


def _in_camera(calibration: Calibration, motions: Array) -> Array:
    """Motions of points in the IMU frame as motions in the camera's, shape (..., 4, 4)."""
    return se3.inverse(calibration.T_imu_cam) @ motions @ calibration.T_imu_cam


def _off(calibration: Calibration, motion: Array, pixels: Array, seen: Array) -> Array:
    """How far in the left image features are seen from where a motion takes them, shape (n, 2).

    NaN of one that is not valid, or that the motion takes behind the camera.

    Args:
        calibration: of the rig.
        motion: one or one for each, of points in the camera frame, shape (4, 4) or (n, 4, 4).
        pixels: before the motion, shape (n, 4).
        seen: after it, shape (n, 4).
    """
    rig, off = calibration.stereo, np.full((len(pixels), 2), np.nan)
    usable = np.flatnonzero(is_valid(rig, pixels) & is_valid(rig, seen))
    motion = np.broadcast_to(motion, (len(pixels), 4, 4))[usable]
    q = se3.apply(motion, triangulate(rig, pixels[usable])[:, None])[:, 0]
    usable, q = usable[in_front(q)], q[in_front(q)]
    off[usable] = (seen[usable] - project(rig, q))[:, :2]
    return off
