"""What fuzzing found, each with the fault it was."""

from dataclasses import replace

from simbench.noise import by_this_and_next_sample
from simbench.scenario.loading import loads
from simbench.sensors import simulate
from tests.fuzz.harness import SCENE


def test_features_that_are_all_predicted_behind_the_camera_tell_nothing_of_timing():
    """They were told as a median of NaN, and a note was made of it."""
    dataset = simulate(loads(SCENE))
    too_fast = replace(dataset, linear_velocity=dataset.linear_velocity + [1e6, 0, 0])
    assert by_this_and_next_sample(dataset) is not None
    assert by_this_and_next_sample(too_fast) is None
