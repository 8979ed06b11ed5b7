import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simbench import landmarks, trajectory
from simbench.scenario import LANDMARKS, TRAJECTORIES, loads

DRAWN = sorted(set(LANDMARKS) - {"file"})
MOTIONS = sorted(set(TRAJECTORIES) - {"file"})
TRACK = "trajectory: {kind: straight, speed_mps: 2}\nduration_s: 10\n"


def make(text, seed=0):
    scene = loads(text)
    return landmarks.make(scene, trajectory.make(scene, seed), seed)


@pytest.mark.parametrize("kind", DRAWN)
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_field_of_fewer_landmarks_is_the_beginning_of_one_of_more(kind, motion):
    text = f"trajectory: {{kind: {motion}}}\nlandmarks: {{kind: {kind}, count: %d}}"
    many = make(text % 97, seed=4)
    assert many.shape == (97, 3)
    assert np.isfinite(many).all()
    for count in (1, 2, 50, 96):
        np.testing.assert_array_equal(make(text % count, seed=4), many[:count])


@pytest.mark.parametrize("kind", DRAWN)
def test_equal_seeds_give_equal_fields_and_others_do_not(kind):
    text = f"landmarks: {{kind: {kind}}}"
    np.testing.assert_array_equal(make(text, seed=1), make(text, seed=1))
    assert (make(text, seed=1) != make(text, seed=2)).any(axis=1).all()


def fills(values, low, high):
    """Whether 4000 even values keep their bounds and come near both: misses once in e^40 seeds."""
    margin = 0.01 * (high - low)
    return low <= values.min() < low + margin and high - margin < values.max() <= high


def test_a_box_fills_its_sides():
    points = make("landmarks: {kind: box, count: 4000, size_m: [2, 4, 6], center_m: [1, 2, 3]}")
    for axis, (low, high) in enumerate([(0, 2), (0, 4), (0, 6)]):
        assert fills(points[:, axis], low, high)


def test_a_box_stands_by_default_about_the_middle_of_the_path():
    points = make(TRACK + "landmarks: {kind: box, count: 4000, size_m: [2, 2, 2]}")
    assert fills(points[:, 0], 9, 11)
    assert fills(points[:, 1], -1, 1)


def test_a_shell_is_even_in_volume_and_direction():
    points = make(
        "landmarks: {kind: shell, count: 4000, radius_m: [3, 6], center_m: [10, 0, 0]}"
    ) - [10, 0, 0]
    radius = np.linalg.norm(points, axis=1)
    assert fills(radius**3, 27, 216)
    for direction in (points / radius[:, None]).T:
        assert fills(direction, -1, 1)
        # The mean of 4000 values of variance 1/3; beyond 5 sigma once in 1.7 million.
        assert abs(direction.mean()) < 5 * np.sqrt(1 / 3 / 4000)


def test_the_ground_is_level_under_the_path_and_around_it():
    points = make(TRACK + "landmarks: {kind: ground, count: 4000, height_m: -2, margin_m: 5}")
    assert fills(points[:, 0], -5, 25)
    assert fills(points[:, 1], -5, 5)
    assert (points[:, 2] == -2).all()


def test_walls_stand_on_both_sides_of_a_straight_path_and_beyond_its_end():
    points = make(
        TRACK + "landmarks: {kind: walls, count: 4000, lateral_m: 3, height_m: [0, 2], ahead_m: 4}"
    )
    np.testing.assert_allclose(np.abs(points[:, 1]), 3)
    assert 1800 < np.count_nonzero(points[:, 1] > 0) < 2200  # 6 sigma of a fair coin
    assert fills(points[:, 0], 0, 24)
    assert fills(points[:, 2], 0, 2)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_landmarks_beside_a_circle_keep_their_distance_from_it(seed):
    points = make(
        "trajectory: {kind: circle, radius_m: 10}\n"
        "landmarks: {kind: path, count: 200, lateral_m: [2, 5], height_m: [-1, 1], ahead_m: 0}",
        seed,
    )
    distance = np.abs(np.linalg.norm(points[:, :2] - [0, 10], axis=1) - 10)
    assert distance.min() > 2 - 1e-4
    assert distance.max() < 5 + 1e-4
    assert np.abs(points[:, 2]).max() <= 1


def test_the_heights_follow_a_climbing_path():
    points = make(
        "trajectory: {kind: helix, climb_m: 50}\n"
        "landmarks: {kind: path, count: 4000, height_m: [0, 1], ahead_m: 0}"
    )
    assert fills(points[:, 2], 0, 51)


def test_a_path_of_no_length_has_landmarks_at_its_sides():
    points = make(
        "trajectory: {kind: hover, sway_m: [0, 0, 0], yaw_deg: 0}\n"
        "landmarks: {kind: path, count: 50, lateral_m: [2, 3], ahead_m: 0}"
    )
    assert (np.abs(points[:, 1]) >= 2 - 1e-6).all()


def test_landmarks_from_a_file_stand_where_it_says():
    points = make("landmarks: {kind: file, text: '1 2 3\n\n  4 5 6.5'}")
    np.testing.assert_array_equal(points, [[1, 2, 3], [4, 5, 6.5]])
