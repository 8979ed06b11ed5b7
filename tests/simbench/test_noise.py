"""The noise that a drive's own data show, against what it was made with."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simbench.noise import by_this_and_next_sample, estimate, white_noise
from tests.simbench.drives import drive, with_jumps


@pytest.mark.parametrize(
    ("sigma_v", "sigma_w", "sigma_px"), [(0.5, 0.05, 0.7), (0.2, 0.005, 0.3), (0.3, 0.02, 2.0)]
)
def test_sigmas_are_found_to_a_quarter_whatever_jumps(sigma_v, sigma_w, sigma_px):
    found = estimate(with_jumps(drive(sigma_v, sigma_w, sigma_px)))
    np.testing.assert_allclose(found.velocity, sigma_v, rtol=0.25)
    np.testing.assert_allclose(found.angular, sigma_w, rtol=0.25)
    assert found.sigma_px == pytest.approx(sigma_px, rel=0.25)


def test_perfect_velocities_are_told_as_nearly_so():
    data = drive(0.0, 0.0)
    found = estimate(data)
    speed = np.median(np.linalg.norm(data.linear_velocity, axis=1))
    np.testing.assert_allclose(found.velocity, 0.005 * speed, rtol=1e-6)
    assert found.angular.max() < 0.001


def test_a_bias_of_the_rates_is_told_as_more_noise():
    data = drive(0.1, 0.005)
    biased = replace(data, angular_velocity=data.angular_velocity + np.array([0, 0.02, 0]))
    found = estimate(biased).angular
    assert found[1] > 0.02
    np.testing.assert_allclose(found[[0, 2]], 0.005, rtol=0.3)


def test_a_track_that_slides_is_told_as_more_than_vl_minus_vr_shows():
    data = drive(0.1, 0.005, 0.3)
    rng = np.random.default_rng(0)
    ids, pixels = data.sightings.ids, data.sightings.pixels.copy()
    for track in np.unique(ids):
        rows = np.flatnonzero(ids == track)
        slid = np.cumsum(0.4 * rng.standard_normal((len(rows), 2)), axis=0)
        pixels[rows] += np.hstack([slid, slid])
    found = estimate(replace(data, sightings=replace(data.sightings, pixels=pixels)))
    assert found.epipolar_px == pytest.approx(0.3, rel=0.1)
    assert found.sigma_px > 2 * found.epipolar_px


@settings(max_examples=20, deadline=None)
@given(sigma=st.floats(1e-3, 1.0), jerk=st.floats(0.0, 5.0), seed=st.integers(0, 99))
def test_white_noise_is_told_from_motion_that_accelerates(sigma, jerk, seed):
    t = 0.1 * np.arange(1000)
    motion = jerk * np.sin(0.2 * t)[:, None] * np.ones(6)
    noise = sigma * np.random.default_rng(seed).standard_normal((1000, 6))
    # the median absolute deviation of 1,000 differences has a relative sigma of 5 %
    np.testing.assert_allclose(white_noise(motion + noise), sigma, rtol=0.3)


def test_velocities_that_come_a_frame_late_are_seen():
    data = drive(0.0, 0.0)
    here, after = by_this_and_next_sample(data)
    assert here < after
    late = replace(
        data,
        linear_velocity=np.roll(data.linear_velocity, 1, axis=0),
        angular_velocity=np.roll(data.angular_velocity, 1, axis=0),
    )
    here, after = by_this_and_next_sample(late)
    assert after < here


def test_without_features_velocities_alone_are_judged():
    found = estimate(replace(drive(), sightings=None))
    assert (found.epipolar_px, found.sigma_px) == (None, 2.0)
    np.testing.assert_allclose(found.angular, 0.05, rtol=0.25)
