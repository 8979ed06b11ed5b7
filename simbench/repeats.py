"""Sightings that a tracker repeated from the frame before instead of looking again.

Real files of the format hold them: where a tracker searches new features, about every seventh
frame, all tracks that go on have the pixels of the frame before, to the last bit, while the vehicle
moved. The track then goes on from those pixels in the new image, that is on another point of the
world. A filter that takes it for the same point sees the vehicle stand still once in seven frames.
"""

from dataclasses import replace

import numpy as np

from simbench.dataset import Dataset, Sightings
from vislam.arrays import Array, BoolArray, IntArray
from vislam.camera import Validity, in_front, project, triangulate, validity
from vislam.lie import se3
from vislam.types import Calibration

#: In a frame that repeats, the motion predicts that its features moved by more than this.
MOVED_PX = 0.5


def without_repeats(dataset: Dataset) -> Dataset:
    """The same drive without repeated sightings; a track goes on after one as a new landmark.

    A track up to its first repeat keeps its id; what follows gets ids from `landmark_count` on. The
    dataset itself comes back where nothing is repeated, and where the truth is known: there a
    landmark is what the truth calls so.
    """
    sightings = dataset.sightings
    if dataset.truth is not None or not isinstance(sightings, Sightings):
        return dataset
    twists = np.hstack([dataset.linear_velocity, dataset.angular_velocity])
    repeated = repeats(dataset.calibration, dataset.times_s, twists, sightings)
    if not repeated.any():
        return dataset
    kept = broken(sightings, repeated, dataset.landmark_count)
    frames = len(np.unique(_frames(sightings)[repeated]))
    note = (
        f"{np.count_nonzero(repeated)} sightings in {frames} of {len(dataset)} frames repeat those "
        "of the frame before to the last bit although the vehicle moved: they are left out, and "
        "their tracks go on as new landmarks."
    )
    return replace(
        dataset,
        sightings=kept,
        landmark_count=int(kept.ids.max(initial=dataset.landmark_count - 1)) + 1,
        notes=(*dataset.notes, note),
    )


def repeats(
    calibration: Calibration, times_s: Array, twists: Array, sightings: Sightings
) -> BoolArray:
    """Which sightings repeat that of the frame before, shape (S,).

    A frame repeats where all features that it shares with the one before are equal to the last bit,
    and the measured motion says that the median one of them moved.

    Args:
        calibration: of the rig, its convention resolved.
        times_s: frames, shape (T,).
        twists: measured, (v, omega), shape (T, 6).
        sightings: features by frame.
    """
    repeated = np.zeros(len(sightings), bool)
    T_imu_cam, rig, start = calibration.T_imu_cam, calibration.stereo, sightings.start
    for i, tau in enumerate(np.diff(times_s)):
        before, now = (slice(start[k], start[k + 1]) for k in (i, i + 1))
        _, a, b = np.intersect1d(
            sightings.ids[before], sightings.ids[now], assume_unique=True, return_indices=True
        )
        pixels = sightings.pixels[before][a]
        if not len(a) or not np.array_equal(pixels, sightings.pixels[now][b]):
            continue
        pixels = pixels[validity(rig, pixels) == Validity.VALID]
        step = se3.inverse(T_imu_cam) @ se3.exp(-tau * twists[i]) @ T_imu_cam
        points = triangulate(rig, pixels)
        q = se3.apply(step, points)
        front = in_front(q)
        shift = np.linalg.norm(
            (project(rig, q[front]) - project(rig, points[front]))[:, :2], axis=1
        )
        if len(shift) and np.median(shift) > MOVED_PX:
            repeated[start[i + 1] + b] = True
    return repeated


def broken(sightings: Sightings, repeated: BoolArray, landmark_count: int) -> Sightings:
    """Without the repeated sightings, and with a new id for what follows one on its track.

    Args:
        sightings: features by frame.
        repeated: which of them repeat, shape (S,).
        landmark_count: the first new id.
    """
    by_track = np.argsort(sightings.ids, kind="stable")
    ids = sightings.ids[by_track]
    first = np.diff(ids, prepend=-1) != 0
    so_far = np.cumsum(repeated[by_track])
    part = so_far - np.repeat(so_far[first], np.diff(np.append(np.flatnonzero(first), len(ids))))
    _, renamed = np.unique(np.stack([ids, part])[:, part > 0], axis=1, return_inverse=True)
    ids = ids.copy()
    ids[part > 0] = landmark_count + renamed
    new_ids = np.empty_like(ids)
    new_ids[by_track] = ids
    frame = _frames(sightings)
    kept = np.flatnonzero(~repeated)
    kept = kept[np.lexsort((new_ids[kept], frame[kept]))]
    parts = np.searchsorted(frame[kept], np.arange(1, len(sightings.start) - 1))
    by_frame = zip(
        np.split(new_ids[kept], parts), np.split(sightings.pixels[kept], parts), strict=True
    )
    return Sightings.from_frames(list(by_frame))


def _frames(sightings: Sightings) -> IntArray:
    """The frame of each sighting, shape (S,)."""
    return np.repeat(np.arange(len(sightings.start) - 1), np.diff(sightings.start))
