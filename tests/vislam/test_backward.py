"""The backward pass: retired landmarks and past poses as the dense filter has them at the end."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.oracles.dense_ekf import DenseEkf
from tests.vislam.drives import drive, feed_together, in_parts_of
from vislam.filters import EkfSlam
from vislam.filters.backward import Kept, Seen
from vislam.filters.estimate import Estimate
from vislam.filters.observation import Observation
from vislam.filters.tape import Tape

schedules = st.tuples(st.integers(1, 8), st.integers(1, 6)).flatmap(
    lambda shape: arrays(bool, shape)
)


drives = given(
    seen=schedules,
    seed=st.integers(0, 99),
    process_model=st.sampled_from(["additive", "twist", "twist-density"]),
    gate=st.sampled_from([None, 0.5, 0.9]),
)


def judged(d, ids=lambda _, ids: ids):
    """The dense filter over a drive, with every pose cloned; `ids` may rename its sightings."""
    judge = DenseEkf(d.task.calibration, d.task.noise, d.task.prior, d.task.gate)
    for i, frame in enumerate(d.frames):
        if i:
            twist, dt = d.twists[i - 1]
            judge.predict(twist.vector, dt)
        judge.update(ids(i, frame.ids), frame.pixels)
        judge.clone()
    return judge


def assert_landmark_equal(final, landmark, judge, judges_name):
    k = final.ids.tolist().index(landmark)
    rows = judge.rows[judges_name]
    assert final.landmarks[k] == pytest.approx(judge.landmarks[judges_name], abs=1e-9)
    assert final.landmark_covariances[k] == pytest.approx(judge.Sigma[rows, rows], abs=1e-9)


@drives
@example(seen=np.tri(8, 6, dtype=bool).T[::-1].T, seed=0, process_model="twist", gate=None)
@example(seen=np.eye(6, dtype=bool), seed=0, process_model="additive", gate=None)
@settings(max_examples=60)
def test_the_final_map_is_the_dense_filters(seen, seed, process_model, gate):
    d = drive(seen, seed=seed, process_model=process_model, gate=gate)
    slam, judge = EkfSlam(d.task), judged(d)
    d.feed(slam)
    final = slam.finish().final
    assert final.ids.tolist() == sorted(judge.landmarks)
    for landmark in final.ids.tolist():
        assert_landmark_equal(final, landmark, judge, landmark)


@drives
@settings(max_examples=60)
def test_past_poses_are_those_that_the_dense_filter_cloned(seen, seed, process_model, gate):
    d = drive(seen, seed=seed, process_model=process_model, gate=gate)
    slam, judge = EkfSlam(replace(d.task, smooth=True)), judged(d)
    d.feed(slam)
    poses = slam.finish().poses
    assert len(poses) == len(d.frames)
    for pose, (T_expected, P_expected) in zip(poses, judge.smoothed, strict=True):
        assert pose.T_world_imu == pytest.approx(T_expected, abs=1e-9)
        assert pose.pose_covariance == pytest.approx(P_expected, abs=1e-9)


@drives
@settings(max_examples=60)
def test_on_a_stream_the_filter_is_the_dense_one_that_renames_what_comes_back(
    seen, seed, process_model, gate
):
    d = drive(seen, seed=seed, process_model=process_model, gate=gate)
    unknown = [replace(frame, last=np.zeros_like(frame.last)) for frame in d.frames]
    stream = replace(d, frames=unknown)
    slam = EkfSlam(replace(d.task, retire_after=2))
    stream.feed(slam)
    newest = {}

    def rename(i, ids):
        for j in ids.tolist():
            before = np.flatnonzero(seen[:i, j])
            if not len(before) or i - before[-1] > 2:
                newest[j] = 100 * i + j
        return np.array([newest[j] for j in ids.tolist()], int)

    judge = judged(stream, rename)
    final = slam.finish().final
    assert final.T_world_imu == pytest.approx(judge.T, abs=1e-9)
    assert final.ids.tolist() == sorted(newest)
    for landmark, judges_name in newest.items():
        assert_landmark_equal(final, landmark, judge, judges_name)


def test_a_stream_without_a_backward_pass_holds_what_lives_and_nothing_else():
    d = drive(np.random.default_rng(0).random((30, 6)) < 0.3)
    unknown = [replace(frame, last=np.zeros_like(frame.last)) for frame in d.frames]
    slam = EkfSlam(replace(d.task, retire_after=1, memory_bytes=0))
    replace(d, frames=unknown).feed(slam)
    living = d.frames[-1].ids.tolist()
    assert slam.finish().final.ids.tolist() == living
    assert slam.P.shape == (6 + 3 * len(living),) * 2


def test_records_that_went_to_a_file_give_the_same_map():
    frame, landmark = np.ogrid[:24, :10]  # each is seen in four frames, two before the next
    d = drive((frame >= 2 * landmark) & (frame < 2 * landmark + 4), gate=0.9)
    held, spooled = EkfSlam(d.task), EkfSlam(replace(d.task, memory_bytes=5_000))
    d.feed(held)
    d.feed(spooled)
    assert len(spooled._past._pieces) > 3
    a, b = held.finish().final, spooled.finish().final
    assert np.array_equal(a.landmarks, b.landmarks)
    assert np.array_equal(a.landmark_covariances, b.landmark_covariances)


def test_what_was_seen_counts_against_the_memory_too():
    """200 sightings in a state of 6 rows take 50 kB, the state's covariance 288 bytes."""
    k = 200
    seen = Observation(
        slots=np.arange(k),
        H_pose=np.zeros((k, 3, 6)),
        H_map=np.zeros((k, 3, 3)),
        r=np.zeros((k, 3)),
    )
    x = Estimate.of(np.eye(4), np.empty((0, 3)), np.eye(4))
    tape = Tape(60_000)
    tape.append(Kept(ids=np.arange(0), slots=np.arange(0), x=x, P=np.eye(6)))
    for _ in range(5):
        tape.append(Seen(observation=seen, delta=np.zeros(6)))
    assert len(tape._pieces) == 5
    assert [type(record) for record in reversed(tape)] == [*5 * [Seen], Kept]


@pytest.mark.parametrize("part", [2, 50])
def test_a_batch_of_runs_has_the_maps_of_the_runs_one_by_one(part):
    """Their updates part by part or at once."""
    seen = np.random.default_rng(1).random((7, 5)) < 0.6
    runs = [drive(seen, seed=7, noise_scale=scale, gate=0.9) for scale in (0.5, 1.5)]
    final = [EkfSlam(d.task) for d in runs]
    for d, slam in zip(runs, final, strict=True):
        d.feed(slam)
    with in_parts_of(part):
        together = feed_together(EkfSlam, runs).finish().final
    for k, slam in enumerate(final):
        alone = slam.finish().final
        assert np.allclose(together.landmarks[k], alone.landmarks, rtol=0, atol=1e-12)
        expected = alone.landmark_covariances
        assert np.allclose(together.landmark_covariances[k], expected, rtol=0, atol=1e-12)
