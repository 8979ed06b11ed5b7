from collections import Counter

import numpy as np
import pytest
from hypothesis import HealthCheck, find, given, settings
from hypothesis.errors import InvalidArgument
from numpy.testing import assert_allclose, assert_array_equal

from simbench import strategies as st
from simbench.checks.audit import audit_drive
from simbench.checks.short_drive import ShortDrive
from simbench.errors import InputError
from simbench.scenario import TRAJECTORIES, loads
from simbench.sensors import simulate
from vislam.filters import EkfSlam
from vislam.lie import so3

#: Of hypothesis' own search for a smallest example.
SEARCH = settings(max_examples=200, database=None, derandomize=True)


def smallest(strategy, condition=lambda _: True, search=SEARCH):
    return find(strategy, condition, settings=search)


@given(st.rotations())
def test_rotations_are_rotations(R):
    assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert_allclose(np.linalg.det(R), 1, atol=1e-14)


@given(st.rotation_vectors(0.5), st.poses(3.0, 0.5), st.twists(2.0, 0.1))
def test_limits_are_kept(phi, T, twist):
    assert np.linalg.norm(phi) <= 0.5 + 1e-15
    assert np.linalg.norm(so3.log(T[:3, :3])) <= 0.5 + 1e-14
    assert np.linalg.norm(T[:3, 3]) <= 3.0 + 1e-14
    assert np.linalg.norm(twist.linear) <= 2.0 + 1e-14
    assert np.linalg.norm(twist.angular) <= 0.1 + 1e-15


@pytest.mark.parametrize("angle", [0.0, 1e-9, np.pi])
def test_awkward_angles_are_drawn(angle):
    # one draw in fifty or so: 200 of them would miss it now and then
    search = settings(SEARCH, max_examples=2000)
    phi = smallest(st.rotation_vectors(), lambda phi: np.linalg.norm(phi) == angle, search)
    assert_array_equal(np.sort(np.abs(phi)), [0, 0, angle])


def test_everything_shrinks_to_the_plain_case():
    assert_array_equal(smallest(st.rotations()), np.eye(3))
    assert_array_equal(smallest(st.poses()), np.eye(4))
    assert_array_equal(smallest(st.twists()).vector, np.zeros(6))
    assert_array_equal(smallest(st.calibrations()).T_imu_cam[:3, 3], np.zeros(3))
    assert smallest(st.rigs()).fx_px == 500
    assert_array_equal(smallest(st.landmark_fields()), [[8, 0, 0]])
    assert smallest(st.schedules(2, 3)).all()
    assert smallest(st.seeds()) == 0


def test_what_fails_shrinks_to_round_numbers():
    phi = smallest(st.rotation_vectors(), lambda phi: np.linalg.norm(phi) > 1.03)
    assert_array_equal(phi, [1.1, 0, 0])


def test_scene_shrinks_to_few_frames_and_landmarks_and_no_key_beside():
    def many(scenario):
        return scenario.landmarks.text.count("\n") >= 3

    scene = smallest(st.scenarios(), many)
    keys = scene.model_dump(exclude_unset=True)
    assert keys.keys() == {"seed", "duration_s", "rate_hz", "trajectory", "landmarks"}
    assert keys["trajectory"] == {"kind": "straight", "speed_mps": 1.0}
    assert (scene.seed, scene.duration_s, scene.rate_hz) == (0, 1.0, 1.0)
    assert scene.landmarks.text.count("\n") == 3


def test_one_awkward_key_is_all_that_is_left_of_a_scene_that_needs_it():
    scene = smallest(st.scenarios(), lambda scene: scene.camera.half_missing > 0)
    assert scene.model_dump(exclude_unset=True)["camera"] == {"half_missing": 0.3}
    assert "filter" not in scene.model_fields_set


def test_every_kind_of_trajectory_is_drawn_valid_and_whole_in_itself():
    kinds = Counter()

    @settings(max_examples=150)
    @given(st.scenarios(5, 4))
    def each(scene):
        kinds[scene.trajectory.kind] += 1
        assert loads(scene.to_yaml()) == scene
        assert scene.duration_s * scene.rate_hz <= 4 + 1e-9
        assert 1 <= scene.landmarks.text.count("\n") <= 4

    each()
    assert kinds.keys() == TRAJECTORIES.keys()


@settings(max_examples=100)
@given(st.scenarios(trajectories=["hover", "circle"]))
def test_only_the_kinds_that_were_asked_for_are_drawn(scene):
    assert scene.trajectory.kind in ("hover", "circle")


def test_in_four_scenes_of_five_something_is_seen():
    seen = Counter()

    @settings(max_examples=100)
    @given(st.scenarios())
    def each(scene):
        try:
            seen[len(simulate(scene).sightings) > 0] += 1
        except InputError:
            seen[False] += 1

    each()
    assert seen[True] > 80


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(st.datasets())
def test_right_filter_passes_the_audit_on_every_dataset(dataset):
    assert len(dataset.sightings) > 0
    assert audit_drive(EkfSlam, ShortDrive.of(dataset, 2000)).passed


def test_datasets_of_given_scenes_are_those_scenes():
    dataset = smallest(st.datasets(st.scenarios(max_frames=3, trajectories=["helix"])))
    assert dataset.origin.scenario_yaml.count("helix") == 1
    assert len(dataset) == 2


@given(st.landmark_fields(2, 5, T_world_imu=np.diag([-1.0, -1, 1, 1])))
def test_landmarks_stand_ahead_of_the_body_and_apart(points):
    assert 2 <= len(points) <= 5
    assert (points[:, 0] <= -8).all()
    assert len(np.unique(points, axis=0)) == len(points)


@given(st.schedules(4, 3))
def test_schedules_have_a_row_for_each_frame(seen):
    assert seen.shape == (4, 3)
    assert seen.dtype == bool


@pytest.mark.parametrize(
    ("strategy", "arguments", "message"),
    [
        (st.rotations, {"max_angle": 4.0}, "`max_angle` within 0 and pi radians, got 4.0"),
        (st.rotation_vectors, {"max_angle": -1}, "`max_angle` within 0 and pi radians, got -1"),
        (st.poses, {"max_distance_m": np.inf}, "`max_distance_m` of at least 0, and finite"),
        (st.twists, {"max_rate_rps": -0.1}, "`max_rate_rps` of at least 0, and finite, got -0.1"),
        (st.landmark_fields, {"min_count": -1}, "`min_count` of at least 0, got -1"),
        (st.landmark_fields, {"min_count": 7}, "`max_count` of at least 7, got 6"),
        (st.landmark_fields, {"T_world_imu": np.eye(3)}, r"`T_world_imu` of shape \(4, 4\)"),
        (st.schedules, {"frames": 0, "landmarks": 2}, "`frames` of at least 1, got 0"),
        (st.schedules, {"frames": 1, "landmarks": 0}, "`landmarks` of at least 1, got 0"),
        (st.scenarios, {"max_frames": 1}, "`max_frames` of at least 2, got 1"),
        (st.scenarios, {"max_landmarks": 0}, "`max_landmarks` of at least 1, got 0"),
        (st.scenarios, {"trajectories": ["loop"]}, r"`trajectories` among hover.*got \['loop'\]"),
        (st.scenarios, {"trajectories": []}, "`trajectories` among hover.*got none"),
    ],
)
def test_argument_that_makes_no_sense_is_refused_at_once(strategy, arguments, message):
    with pytest.raises(InvalidArgument, match=message):
        strategy(**arguments)
