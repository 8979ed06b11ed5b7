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
