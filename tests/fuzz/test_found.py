"""What fuzzing found, each with the fault it was."""

import json
from dataclasses import replace

import numpy as np
import pytest

from simbench.errors import ScenarioError
from simbench.info import describe
from simbench.noise import by_this_and_next_sample
from simbench.scenario.loading import loads
from simbench.sensors import simulate
from tests.fuzz.harness import SCENE


def test_features_that_are_all_predicted_behind_the_camera_tell_nothing_of_timing():
    """They were told as a median of NaN, and a note was made of it."""
    dataset = simulate(loads(SCENE))
    too_fast = replace(dataset, linear_velocity=dataset.linear_velocity + np.array([1e6, 0, 0]))
    assert by_this_and_next_sample(dataset) is not None
    assert by_this_and_next_sample(too_fast) is None


def test_a_variance_that_rounding_took_below_zero_is_none():
    """The reader allows it; its root was NaN, which is no JSON."""
    dataset = simulate(loads(SCENE))
    process = dataset.noise.process.copy()
    process[0, 0] = -1e-16
    unsure = replace(dataset, noise=replace(dataset.noise, process=process))
    sigmas = describe(unsure)["told"]["process_sigmas"]
    assert sigmas[0] == 0
    json.dumps(sigmas, allow_nan=False)


@pytest.mark.parametrize(
    ("tracks", "message"),
    [
        ("median_frames: 1", "min_frames: expected at most median_frames, 1, got 3"),
        ("median_frames: 300", "max_frames: expected at least median_frames, 300, got 200"),
        (f"max_frames: {10**400}", "max_frames: expected a number of at most 1e"),
    ],
)
def test_lengths_of_tracks_are_held_against_the_defaults_too(tracks, message):
    """A median below the default of the least length gave tracks of negative length."""
    with pytest.raises(ScenarioError, match=message):
        loads(f"camera: {{tracks: {{{tracks}}}}}")
