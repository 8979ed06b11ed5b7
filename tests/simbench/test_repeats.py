"""Sightings that a tracker repeated: found, left out, and nothing else touched."""

from dataclasses import replace

import numpy as np

from simbench.repeats import without_repeats
from tests.simbench.drives import drive, with_repeats


def test_repeats_are_left_out_and_tracks_go_on_as_new_landmarks():
    data = drive(0.1, 0.01, seconds=10.0)
    repeated = with_repeats(data)
    clean = without_repeats(bare(repeated))
    frames = range(7, len(data), 7)
    for i in frames:
        before, now = repeated.frame(i - 1), repeated.frame(i)
        again = np.isin(now.ids, before.ids)
        assert clean.frame(i).ids.tolist() == now.ids[~again].tolist()
        after, left = repeated.frame(i + 1) if i + 1 < len(data) else now, clean.frame(i + 1)
        assert len(left.ids) == len(after.ids)
        assert set(now.ids[again]).isdisjoint(left.ids)
    np.testing.assert_array_equal(clean.frame(3).pixels, repeated.frame(3).pixels)
    assert clean.sightings.ids.max() == clean.landmark_count - 1
    assert "repeat those of the frame before" in clean.notes[-1]


def test_a_drive_without_repeats_comes_back_itself():
    data = bare(drive(0.1, 0.01, seconds=5.0))
    assert without_repeats(data) is data


def test_a_vehicle_that_stands_may_see_the_same_again():
    data = bare(with_repeats(drive(0.1, 0.01, seconds=5.0)))
    still = replace(
        data,
        linear_velocity=np.zeros_like(data.linear_velocity),
        angular_velocity=np.zeros_like(data.angular_velocity),
    )
    assert without_repeats(still) is still


def bare(data):
    """Without the truth, as a file of the course."""
    return replace(data, truth=None)
