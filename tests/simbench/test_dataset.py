"""What a dataset gives out of its sparse sightings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simbench.dataset import Dataset, Sightings
from vislam.camera import StereoRig
from vislam.types import Belief, Calibration, Noise


def sightings(*frames):
    """Frames as lists of ids; the pixels of id j in frame i are i, j, i, j."""
    return Sightings.from_frames(
        [
            (np.array(ids, np.int64), np.array([[i, j, i, j] for j in ids], float).reshape(-1, 4))
            for i, ids in enumerate(frames)
        ]
    )


def dataset(seen: Sightings | None, count: int, frames: int) -> Dataset:
    rig = StereoRig(fx_px=500, fy_px=500, cx_px=300, cy_px=200, baseline_m=0.5)
    return Dataset(
        name="d",
        times_s=np.arange(frames) / 10,
        linear_velocity=np.arange(3 * frames).reshape(frames, 3).astype(float),
        angular_velocity=-np.arange(3 * frames).reshape(frames, 3).astype(float),
        landmark_count=count,
        sightings=seen,
        calibration=Calibration(rig=rig, T_imu_cam=np.eye(4)),
        noise=Noise(process_model="twist", process=np.eye(6), sigma_px=np.ones(4)),
        prior=Belief(T_world_imu=np.eye(4)),
    )


frames_of_ids = st.lists(st.lists(st.integers(0, 9), unique=True).map(sorted), min_size=1)


@given(frames_of_ids)
def test_frames_come_back_as_they_went_in(frames):
    data = dataset(sightings(*frames), 10, len(frames))
    for i, ids in enumerate(frames):
        frame = data.frame(i)
        assert frame.ids.tolist() == ids
        assert frame.pixels.tolist() == [[i, j, i, j] for j in ids]
        assert frame.time_s == data.times_s[i]


@given(frames_of_ids)
def test_last_marks_each_landmark_once_in_the_last_frame_that_holds_it(frames):
    data = dataset(sightings(*frames), 10, len(frames))
    for i, ids in enumerate(frames):
        later = {j for frame in frames[i + 1 :] for j in frame}
        assert data.frame(i).last.tolist() == [j not in later for j in ids]


def places(frames):
    """(frame, id) of every sighting, in order."""
    return [(i, j) for i, ids in enumerate(frames) for j in ids]


@given(frames_of_ids, st.randoms(use_true_random=False))
def test_some_of_the_sightings_keep_their_frames(frames, random):
    seen, all_ = sightings(*frames), places(frames)
    assert seen.frames.tolist() == [i for i, _ in all_]
    kept = np.array([random.random() < 0.5 for _ in all_], bool)
    expected = [[j for j in ids if kept[all_.index((i, j))]] for i, ids in enumerate(frames)]
    some, alone = seen.only(kept), sightings(*expected)
    for name in ("start", "ids", "pixels", "last"):
        assert np.array_equal(getattr(some, name), getattr(alone, name)), name
    turned = seen.only(kept, 9 - seen.ids)
    assert turned.start.tolist() == alone.start.tolist()
    assert turned.ids.tolist() == [9 - j for ids in expected for j in reversed(ids)]


@given(frames_of_ids, st.randoms(use_true_random=False))
def test_since_is_what_comes_at_and_after_a_mark_on_its_track(frames, random):
    all_ = places(frames)
    marked = np.array([random.random() < 0.2 for _ in all_], bool)
    marks = {place for place, mark in zip(all_, marked, strict=True) if mark}
    expected = [any((k, j) in marks for k in range(i + 1)) for i, j in all_]
    assert sightings(*frames).since(marked).tolist() == expected


@given(frames_of_ids, st.integers(1, 3), st.randoms(use_true_random=False))
def test_pairs_are_two_usable_sightings_so_many_frames_apart(frames, lag, random):
    all_ = places(frames)
    usable = np.array([random.random() < 0.7 for _ in all_], bool)
    good = {place for place, ok in zip(all_, usable, strict=True) if ok}
    expected = [((i, j), (i + lag, j)) for i, j in all_ if {(i, j), (i + lag, j)} <= good]
    first, second = sightings(*frames).pairs(usable, lag)
    assert [(all_[a], all_[b]) for a, b in zip(first, second, strict=True)] == expected


def test_without_features_every_frame_is_empty():
    frame = dataset(None, 0, 3).frame(2)
    assert frame.ids.shape == (0,)
    assert frame.pixels.shape == (0, 4)
    assert frame.last.dtype == bool


def test_a_twist_sample_is_velocity_then_rate():
    assert dataset(None, 0, 3).twist(1).vector.tolist() == [3, 4, 5, -3, -4, -5]


@pytest.mark.parametrize("time_s", [0.1, 1_317_384_506.415_123_456])
def test_nanoseconds_are_the_nearest_whole_ones(time_s):
    data = dataset(None, 0, 1)
    object.__setattr__(data, "times_s", np.array([time_s]))
    assert data.times_ns.dtype == np.int64
    assert abs(int(data.times_ns[0]) - round(time_s * 1e9)) <= 128  # half a float64 step there
