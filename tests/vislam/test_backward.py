"""The backward pass: retired landmarks as the dense filter has them at the end."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.oracles.dense_ekf import DenseEkf
from tests.vislam.drives import drive, feed_together
from vislam.filters import EkfSlam

schedules = st.tuples(st.integers(1, 8), st.integers(1, 6)).flatmap(
    lambda shape: arrays(bool, shape)
)


@given(
    seen=schedules,
    seed=st.integers(0, 99),
    process_model=st.sampled_from(["additive", "twist", "twist-density"]),
    gate=st.sampled_from([None, 0.5, 0.9]),
)
@example(seen=np.tri(8, 6, dtype=bool).T[::-1].T, seed=0, process_model="twist", gate=None)
@example(seen=np.eye(6, dtype=bool), seed=0, process_model="additive", gate=None)
@settings(max_examples=60)
def test_the_final_map_is_the_dense_filters(seen, seed, process_model, gate):
    d = drive(seen, seed=seed, process_model=process_model, gate=gate)
    slam, judge = EkfSlam(d.task), DenseEkf(d.task.calibration, d.task.noise, d.task.prior, gate)
    d.feed(slam)
    for i, frame in enumerate(d.frames):
        if i:
            twist, dt = d.twists[i - 1]
            judge.predict(twist.vector, dt)
        judge.update(frame.ids, frame.pixels)
    final = slam.finish()
    assert final.ids.tolist() == sorted(judge.landmarks)
    for k, landmark in enumerate(final.ids.tolist()):
        rows = judge.rows[landmark]
        expected = judge.Sigma[rows, rows]
        assert final.landmarks[k] == pytest.approx(judge.landmarks[landmark], abs=1e-9)
        assert final.landmark_covariances[k] == pytest.approx(expected, abs=1e-9)


def test_records_that_went_to_a_file_give_the_same_map():
    d = drive(np.random.default_rng(0).random((9, 6)) < 0.5, gate=0.9)
    held, spooled = EkfSlam(d.task), EkfSlam(replace(d.task, memory_bytes=5_000))
    d.feed(held)
    d.feed(spooled)
    assert len(spooled.records._pieces) > 3
    a, b = held.finish(), spooled.finish()
    assert np.array_equal(a.landmarks, b.landmarks)
    assert np.array_equal(a.landmark_covariances, b.landmark_covariances)


def test_a_batch_of_runs_has_the_maps_of_the_runs_one_by_one():
    seen = np.random.default_rng(1).random((7, 5)) < 0.6
    runs = [drive(seen, seed=7, noise_scale=scale, gate=0.9) for scale in (0.5, 1.5)]
    final = [EkfSlam(d.task) for d in runs]
    for d, slam in zip(runs, final, strict=True):
        d.feed(slam)
    together = feed_together(EkfSlam, runs).finish()
    for k, slam in enumerate(final):
        alone = slam.finish()
        assert np.allclose(together.landmarks[k], alone.landmarks, rtol=0, atol=1e-12)
        expected = alone.landmark_covariances
        assert np.allclose(together.landmark_covariances[k], expected, rtol=0, atol=1e-12)
