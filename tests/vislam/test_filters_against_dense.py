"""The filters against the dense EKF of `tests.oracles`, which shares no code with them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.oracles.dense_ekf import DenseEkf
from tests.vislam.drives import Drive, drive, in_parts_of
from vislam.filters import DeadReckoning, EkfSlam, Mapping
from vislam.filters.observation import PART
from vislam.filters.records import Correct
from vislam.types import Belief, Noise

TOLERANCE = 1e-9

schedules = st.tuples(st.integers(1, 7), st.integers(1, 6)).flatmap(
    lambda shape: arrays(bool, shape)
)
process_models = st.sampled_from(["additive", "twist", "twist-density"])
gates = st.sampled_from([None, 0.5, 0.9])


def dense(d: Drive, prior: Belief | None = None) -> DenseEkf:
    task = d.task
    return DenseEkf(task.calibration, task.noise, prior or task.prior, task.gate)


def assert_equal_all_along(d: Drive, prior: Belief | None = None) -> None:
    judge = dense(d, prior)
    slam = EkfSlam(d.task if prior is None else replace(d.task, prior=prior))
    for i, frame in enumerate(d.frames):
        if i:
            twist, dt = d.twists[i - 1]
            slam.predict(twist, dt)
            judge.predict(twist.vector, dt)
        innovation, expected = slam.update(frame), judge.update(frame.ids, frame.pixels)
        belief = slam.belief(joint=True)
        assert np.allclose(belief.T_world_imu, judge.T, rtol=0, atol=TOLERANCE)
        covariance = judge.covariance(belief.ids.tolist())
        assert np.allclose(belief.joint_covariance, covariance, rtol=0, atol=TOLERANCE)
        estimates = np.array([judge.landmarks[j] for j in belief.ids.tolist()]).reshape(-1, 3)
        assert np.allclose(belief.landmarks, estimates, rtol=0, atol=TOLERANCE)
        assert innovation.ids.tolist() == expected.ids.tolist()
        assert innovation.ids[innovation.accepted].tolist() == expected.accepted.tolist()
        assert innovation.born.tolist() == expected.born.tolist()
        assert innovation.nis == pytest.approx(expected.nis, abs=TOLERANCE, rel=TOLERANCE)
        assert innovation.dof == 4 * len(expected.accepted)


@given(seen=schedules, seed=st.integers(0, 99), process_model=process_models, gate=gates)
@example(seen=np.ones((6, 6), bool), seed=0, process_model="twist", gate=None)
@example(seen=np.eye(6, dtype=bool), seed=0, process_model="additive", gate=None)
@example(seen=np.zeros((5, 3), bool), seed=0, process_model="twist-density", gate=0.9)
@settings(deadline=None, max_examples=60)
def test_slam_is_the_dense_filter_over_any_schedule(seen, seed, process_model, gate):
    assert_equal_all_along(drive(seen, seed=seed, process_model=process_model, gate=gate))


@given(seen=schedules, seed=st.integers(0, 99), gate=gates, part=st.integers(1, 4))
@settings(deadline=None, max_examples=40)
def test_part_by_part_slam_is_the_dense_filter_too(seen, seed, gate, part):
    with in_parts_of(part):
        assert_equal_all_along(drive(seen, seed=seed, gate=gate))


def test_part_by_part_each_sighting_has_the_same_whitened_residual():
    d = drive(np.ones((4, 6), bool), seed=1, gate=0.9)
    at_once = d.feed(EkfSlam(d.task))
    with in_parts_of(2):
        by_parts = d.feed(EkfSlam(d.task))
    for one, other in zip(at_once, by_parts, strict=True):
        assert np.allclose(one.whitened, other.whitened, rtol=0, atol=TOLERANCE)


def test_more_sightings_than_are_taken_in_at_once():
    d = drive(np.ones((3, PART + 7), bool))
    slam = EkfSlam(d.task)
    slam.records = []
    d.feed(slam)
    sizes = [len(r.observation.slots) for r in slam.records if isinstance(r, Correct)]
    assert sizes == [0, *2 * [(PART + 8) // 2, (PART + 7) // 2]]
    assert_equal_all_along(d)


@given(data=st.data(), seen=schedules, seed=st.integers(0, 99))
@settings(deadline=None, max_examples=30)
def test_half_missing_features_are_skipped_as_in_the_dense_filter(data, seen, seed):
    partial = data.draw(arrays(bool, seen.shape))
    assert_equal_all_along(drive(seen, seed=seed, partial=partial))


def test_a_gate_at_work_rejects_the_same_features():
    d = drive(np.ones((8, 6), bool), seed=3, gate=0.5)
    rejected = sum(innovation.rejected for innovation in d.feed(EkfSlam(d.task)))
    assert 5 < rejected < 30  # 42 tested, half expected
    assert_equal_all_along(d)


@pytest.mark.parametrize("joint", [False, True])
def test_a_known_map_localises_as_in_the_dense_filter(joint):
    seen = np.random.default_rng(1).random((8, 6)) < 0.6
    d = drive(seen, seed=5)
    blocks = np.stack([np.diag([0.01, 0.02, 0.03])] * 3)
    known = np.array([0, 2, 5])
    pose = d.task.prior.pose_covariance
    whole = np.zeros((15, 15))
    whole[:6, :6] = pose
    for k, block in enumerate(blocks):
        whole[6 + 3 * k : 9 + 3 * k, 6 + 3 * k : 9 + 3 * k] = block
    prior = replace(
        d.task.prior,
        ids=known,
        landmarks=d.landmarks[known] + 0.1,
        landmark_covariances=blocks,
        joint_covariance=whole if joint else None,
    )
    assert_equal_all_along(d, prior)


def test_an_exactly_known_map_is_localisation_without_mapping():
    d = drive(np.ones((10, 6), bool), seed=2)
    prior = replace(
        d.task.prior,
        ids=np.arange(6),
        landmarks=d.landmarks,
        landmark_covariances=np.zeros((6, 3, 3)),
    )
    slam = EkfSlam(replace(d.task, prior=prior))
    d.feed(slam)
    final = slam.finish().final
    assert np.array_equal(final.landmarks, d.landmarks)
    assert not final.landmark_covariances.any()
    assert_equal_all_along(d, prior)


@given(seed=st.integers(0, 99), process_model=process_models)
@settings(deadline=None, max_examples=20)
def test_dead_reckoning_is_the_dense_filter_without_features(seed, process_model):
    d = drive(np.zeros((6, 1), bool), seed=seed, process_model=process_model)
    judge, filter_ = dense(d), DeadReckoning(d.task)
    for twist, dt in d.twists:
        judge.predict(twist.vector, dt)
        filter_.predict(twist, dt)
    belief = filter_.belief()
    assert np.allclose(belief.T_world_imu, judge.T, rtol=0, atol=TOLERANCE)
    assert np.allclose(belief.pose_covariance, judge.Sigma, rtol=0, atol=TOLERANCE)


@given(seen=schedules, seed=st.integers(0, 99), gate=gates)
@settings(deadline=None, max_examples=30)
def test_mapping_on_the_truth_is_the_dense_filter_with_a_pose_beyond_doubt(seen, seed, gate):
    d = drive(seen, seed=seed, gate=gate)
    mapping = Mapping.on_truth(d.task)
    d.feed(mapping)
    final = mapping.finish().final

    sure = Noise(process_model="additive", process=np.zeros((6, 6)), sigma_px=d.task.noise.sigma_px)
    certain = Belief(T_world_imu=d.T_world_imu[0], pose_covariance=np.zeros((6, 6)))
    judge = DenseEkf(d.task.calibration, sure, certain, gate)
    for T, frame in zip(d.T_world_imu, d.frames, strict=True):
        judge.T = T
        judge.update(frame.ids, frame.pixels)
    assert final.ids.tolist() == sorted(judge.landmarks)
    for k, j in enumerate(final.ids.tolist()):
        rows = judge.rows[j]
        assert np.allclose(final.landmarks[k], judge.landmarks[j], rtol=0, atol=TOLERANCE)
        expected = judge.Sigma[rows, rows]
        assert np.allclose(final.landmark_covariances[k], expected, rtol=0, atol=TOLERANCE)


def test_mapping_moves_along_the_dead_reckoned_trajectory():
    d = drive(np.ones((6, 4), bool), seed=1)
    mapping, reckoning = Mapping(d.task), DeadReckoning(d.task)
    d.feed(mapping)
    d.feed(reckoning)
    assert np.array_equal(mapping.belief().T_world_imu, reckoning.belief().T_world_imu)
    assert mapping.belief().pose_covariance is None
