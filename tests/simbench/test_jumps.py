"""Disparities that jump: found whatever the motion's noise could explain, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from simbench.jumps import jumps, without_jumps
from simbench.npz.estimated import with_estimated_noise
from tests.simbench.drives import drive, with_jumps, with_pixels


def bare(data):
    """As a file of the course is read: no truth, noise estimated from the data."""
    return with_estimated_noise(replace(data, truth=None))


def jumped_once(data, share=0.02, seed=0):
    """The drive with disparities that jump for one frame, and which do."""
    rng = np.random.default_rng(seed)
    which = rng.random(len(data.sightings)) < share
    pixels = data.sightings.pixels.copy()
    size = rng.choice([-1, 1], which.sum()) * rng.uniform(5, 15, which.sum())
    pixels[which, 2] += size
    return replace(data, sightings=replace(data.sightings, pixels=pixels)), which


@pytest.mark.parametrize(("sigma_v", "sigma_w"), [(0.02, 0.002), (0.5, 0.05)])
def test_what_jumps_for_a_frame_is_left_out_and_its_track_stays(sigma_v, sigma_w):
    data, which = jumped_once(drive(sigma_v, sigma_w, 0.3, seconds=10.0, seed=1))
    clean = without_jumps(bare(data))
    frame = data.sightings.frames
    left = np.concatenate(
        [np.isin(data.frame(i).ids, clean.frame(i).ids) for i in range(len(data))]
    )
    pixels = data.sightings.pixels
    # what jumps to no point in front of the camera no filter takes; and of a track's first sighting
    # the jump is seen at the second, with which the track is lost
    found = [
        k
        for k in np.flatnonzero(which)
        if pixels[k, 0] - pixels[k, 2] > 1
        and frame[k]
        and data.sightings.ids[k] in data.frame(frame[k] - 1).ids
    ]
    assert np.mean(~left[found]) > 0.95
    assert np.mean(left[~which]) > 0.97
    assert "jump for one frame" in clean.notes[-1]


def test_what_follows_a_jump_for_good_is_left_out():
    data = bare(with_jumps(drive(0.5, 0.05, 0.3, seconds=10.0, seed=1)))
    _, for_good = jumps(data)
    clean = without_jumps(data)
    assert for_good.sum() > 0.01 * len(data.sightings)
    frame = data.sightings.frames
    for k in np.flatnonzero(for_good):
        later = range(frame[k], len(data))
        assert not any(data.sightings.ids[k] in clean.frame(i).ids for i in later)


@pytest.mark.parametrize(("sigma_v", "sigma_w"), [(0.02, 0.002), (0.5, 0.05)])
def test_where_nothing_jumps_next_to_nothing_is_found(sigma_v, sigma_w):
    """Of about 7,000 steps chance takes 0.7 for jumps; 10 it does once in 1e9 drives."""
    once, for_good = jumps(bare(drive(sigma_v, sigma_w, seconds=12.0, seed=2)))
    assert once.sum() + for_good.sum() < 10


def test_a_drive_with_the_truth_comes_back_itself():
    data = with_jumps(drive(0.1, 0.01, seconds=5.0))
    assert without_jumps(data) is data


def test_a_drive_with_hardly_a_feature_is_left_alone():
    data = drive(0.1, 0.01, seconds=5.0)
    few = with_pixels(data, lambda _, ids, z: np.where(ids[:, None] == ids[0], z, -1.0))
    data = bare(replace(data, sightings=few))
    assert len(without_jumps(data).sightings) > 0.9 * len(data.sightings)
