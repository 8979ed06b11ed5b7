"""What a frame costs as the map grows: with landmarks retired, and without."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from simbench.run import run, task_of
from simbench.scenario import load
from simbench.sensors import simulate
from tests.benchmarks.dense import DenseEkf
from tests.benchmarks.turns import MARGIN, Turns
from vislam.filters import EkfSlam
from vislam.types import Belief

SCENES = Path(__file__).parents[2] / "scenarios"
BLOCK = 20


def street(frames, landmarks):
    """The beginning of the drive, with so many landmarks along it."""
    scene = SCENES / "drive.yaml"
    duration = f"duration_s={(frames - 1) / load(scene).rate_hz:.6f}"
    return simulate(load(scene, [duration, f"landmarks.count={landmarks}"]))


class Frames:
    """Hands the frames of a dataset to filters, and the motion behind each."""

    def __init__(self, dataset, first=0):
        self.dataset, self.place = dataset, first

    def to(self, filter_):
        def advance():
            data, i = self.dataset, self.place
            filter_.update(data.frame(i))
            filter_.predict(data.twist(i), float(data.times_s[i + 1] - data.times_s[i]))

        return advance


def test_the_plain_dense_filter_is_the_same_filter():
    dataset = street(40, 400)
    slam, dense = run(dataset, EkfSlam), run(dataset, DenseEkf)
    assert np.allclose(dense.T_world_imu, slam.T_world_imu, atol=1e-9)
    assert np.allclose(dense.pose_covariances, slam.pose_covariances, atol=1e-9)
    order = np.argsort(dense.final.ids)
    assert np.array_equal(dense.final.ids[order], slam.final.ids)
    assert np.allclose(dense.final.landmarks[order], slam.final.landmarks, atol=1e-7)


@pytest.mark.slow
def test_against_a_plain_dense_filter(benchmark, report):
    dataset = street(240, 1250)
    frames, slam, dense = Frames(dataset), EkfSlam(task_of(dataset)), DenseEkf(task_of(dataset))
    turns, known = Turns(slam=frames.to(slam), dense=frames.to(dense)), []

    def one_frame():
        turns()
        frames.place += 1
        known.append(len(dense.landmarks))

    with threadpool_limits(1, "blas"):
        benchmark.pedantic(one_frame, rounds=len(dataset) - 1)
        start = time.process_time()
        slam.finish()
        back_s = time.process_time() - start
    slam_s, dense_s = turns.all_seconds("slam"), turns.all_seconds("dense")
    slam_s *= 1 + back_s / slam_s.sum()  # a frame's share of the pass back
    whole = np.cumsum(dense_s) / np.cumsum(slam_s)
    rows = [
        (
            known[end - 1],
            *(1e3 * float(s[end - BLOCK : end].mean()) for s in (slam_s, dense_s)),
            whole[end - 1],
        )
        for end in range(BLOCK, len(known), BLOCK)
    ]
    heads = ("landmarks so far", "slam ms a frame", "dense ms a frame", "of the run so far, times")
    report("A plain dense filter against slam with its pass back", heads, rows)
    dearer = np.flatnonzero(whole > 1)
    if benchmark.enabled:
        report("They cross", ("at landmarks",), [(known[dearer[0]],)])
        assert whole[-1] > 5


@pytest.mark.slow
def test_a_frame_costs_as_much_after_twelve_thousand_retired_landmarks(benchmark, report):
    dataset = simulate(load(SCENES / "drive_large.yaml"))
    task, begin, warm = task_of(dataset), 2700, 2800
    aged, frames = EkfSlam(task), Frames(dataset)
    T = dataset.truth.T_world_imu[begin]
    fresh = EkfSlam(replace(task, prior=Belief(T_world_imu=T, pose_covariance=1e-4 * np.eye(6))))
    turns = Turns(aged=frames.to(aged), fresh=frames.to(fresh))

    def one_frame():
        turns()
        frames.place += 1

    with threadpool_limits(1, "blas"):
        while frames.place < warm:
            frames.to(aged)()
            if frames.place >= begin:
                frames.to(fresh)()
            frames.place += 1
        assert aged.ids.tolist() == fresh.ids.tolist()
        benchmark.pedantic(one_frame, rounds=len(dataset) - warm - 1)
    met = np.unique(dataset.sightings.ids[: dataset.sightings.start[warm]])
    retired, ratio = len(met) - len(aged.ids), turns.ratio("aged", "fresh")
    heads = ("landmarks retired", "ms a frame", "of a fresh filter", "times")
    row = retired, turns.median_ms("aged"), turns.median_ms("fresh"), ratio
    report("The same frames to an old filter and to a fresh one", heads, [row])
    assert retired > 12_000
    if benchmark.enabled:
        assert ratio < MARGIN
