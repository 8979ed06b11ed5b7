"""Sightings that a tracker repeated: found, taken for what they are, and nothing else touched."""

from dataclasses import replace

import numpy as np
import pytest

from simbench.repeats import without_repeats
from tests.simbench.drives import drive, with_pixels, with_repeats, with_standing_pictures


def test_tracks_that_slid_go_on_as_new_landmarks_from_the_repeated_sighting_on():
    data = drive(0.1, 0.01, seconds=10.0)
    repeated = with_repeats(data)
    clean = without_repeats(bare(repeated))
    for i in range(7, len(data), 7):
        before, now, left = repeated.frame(i - 1), repeated.frame(i), clean.frame(i)
        again = np.isin(now.ids, before.ids[(before.pixels != -1).all(axis=1)])
        assert set(left.ids[left.ids < data.landmark_count]) == set(now.ids[~again])
        assert sorted(left.pixels.tolist()) == sorted(now.pixels.tolist())
        new = left.ids[left.ids >= data.landmark_count]
        assert set(new).isdisjoint(clean.frame(i - 1).ids)
        if i + 1 < len(data):
            after = repeated.frame(i + 1).ids
            assert (
                len(np.intersect1d(new, clean.frame(i + 1).ids))
                == np.isin(now.ids[again], after).sum()
            )
    np.testing.assert_array_equal(clean.frame(3).pixels, repeated.frame(3).pixels)
    assert clean.sightings.ids.max() == clean.landmark_count - 1
    assert "repeat those of the frame before" in clean.notes[-1]
    assert "start new landmarks" in clean.notes[-1]


@pytest.mark.parametrize("sigma_w", [0.01, 0.1])
def test_where_the_picture_stood_still_tracks_stay_what_they_are(sigma_w):
    """At 0.1 rad/s the rates put features by 5 px where they are not, whichever is right."""
    data = with_standing_pictures(drive(0.3, sigma_w, seconds=10.0, seed=1))
    clean = without_repeats(bare(data))
    for i in range(len(data)):
        seen = [] if i % 7 in (1, 2) else data.frame(i).ids
        np.testing.assert_array_equal(clean.frame(i).ids, seen)
    assert clean.landmark_count == data.landmark_count
    assert "left out" in clean.notes[-1]


def test_a_frame_repeats_where_a_few_of_its_features_do_not():
    data = with_standing_pictures(drive(0.1, 0.01, seconds=5.0))
    moved = set()

    def but_two(frame, ids, pixels):
        out = pixels.copy()
        if frame == 8:
            out[:2, 2] += 9.0
            moved.update(ids[:2].tolist())
        return out

    clean = without_repeats(bare(replace(data, sightings=with_pixels(data, but_two))))
    assert set(clean.frame(8).ids) == moved


def test_a_drive_without_repeats_comes_back_itself():
    data = bare(drive(0.1, 0.01, seconds=5.0))
    assert without_repeats(data) is data


def test_a_vehicle_that_stands_may_see_the_same_again():
    data = bare(with_repeats(drive(0.1, 0.01, sigma_px=2.0, seconds=5.0)))
    still = replace(
        data,
        linear_velocity=np.zeros_like(data.linear_velocity),
        angular_velocity=np.zeros_like(data.angular_velocity),
    )
    assert without_repeats(still) is still


def bare(data):
    """Without the truth, as a file of the course."""
    return replace(data, truth=None)
