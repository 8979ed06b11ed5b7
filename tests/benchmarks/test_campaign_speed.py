"""Runs per second of a campaign: against a plain loop, and against what people would take instead.

`SIMBENCH_RUNS` says of how many runs of figure8, by default 1000; 40 show the ratios too.
"""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from joblib import cpu_count

from simbench.campaign import campaign, load
from simbench.filters import resolve
from simbench.metrics import ate, metrics, rmse
from simbench.run import run
from simbench.sensors import simulate
from tests.oracles.filterpy_slam import Readings, estimated

FIGURE8 = Path(__file__).parents[2] / "scenarios" / "figure8.yaml"
RUNS = int(os.environ.get("SIMBENCH_RUNS", "1000"))


def seconds(function, *arguments):
    """The time that a call takes, that of the processors in it and its children, and its value."""
    begin, before = time.perf_counter(), sum(os.times()[:4])
    value = function(*arguments)
    return time.perf_counter() - begin, sum(os.times()[:4]) - before, value


def plain_loop(scenario, runs):
    return [
        metrics(run(simulate(scenario, run=number), resolve("slam")))["ate_rmse_m"]
        for number in range(runs)
    ]


def readings(dataset):
    """What a run of ours reads, as arrays."""
    rig = dataset.calibration.rig
    frames = [dataset.frame(i) for i in range(len(dataset))]
    noise = dataset.noise
    return Readings(
        times_s=dataset.times_s,
        twists=np.hstack([dataset.linear_velocity, dataset.angular_velocity]),
        frames=[(frame.ids.tolist(), frame.pixels) for frame in frames],
        T_world_imu=dataset.prior.T_world_imu,
        P=dataset.prior.pose_covariance,
        sigma_twist=np.sqrt(np.diag(noise.process)),
        sigma_px=noise.sigma_px,
        T_imu_cam=dataset.calibration.T_imu_cam,
        K=(rig.fx_px, rig.fy_px, rig.cx_px, rig.cy_px),
        baseline_m=rig.baseline_m,
    )


@pytest.mark.slow
@pytest.mark.skipif(cpu_count() < 2, reason="needs two cores")
def test_a_campaign_on_two_cores_against_a_plain_loop(benchmark, tmp_path):
    plan = load(FIGURE8, (), {"runs": RUNS})
    loop_s, loop_cpu_s, alone = seconds(plain_loop, plan.cases[0].scenario, RUNS)

    def conduct():
        return campaign(plan, tmp_path / "out", jobs=2)

    together_s, cpu_s, summary = seconds(lambda: benchmark.pedantic(conduct, rounds=1))
    assert summary["groups"][0]["metrics"]["ate_rmse_m"]["mean"] == pytest.approx(np.mean(alone))
    benchmark.extra_info["runs_per_second"] = RUNS / together_s
    benchmark.extra_info["times_faster_than_a_loop"] = loop_s / together_s
    benchmark.extra_info["processor_time_of_a_loop"] = cpu_s / loop_cpu_s
    if benchmark.stats is not None:
        assert loop_s / together_s > 1.8


@pytest.mark.slow
def test_a_run_against_filterpy_in_a_plain_loop(benchmark):
    scenario = load(FIGURE8).cases[0].scenario
    data = simulate(scenario)
    theirs_s, _, poses = seconds(estimated, readings(data))
    ours = metrics(run(data, resolve("slam")))["ate_rmse_m"]
    theirs = rmse(ate(poses, data.truth.T_world_imu).translation_m)
    assert theirs == pytest.approx(ours, rel=0.01)
    benchmark.pedantic(plain_loop, (scenario, 1), rounds=3, warmup_rounds=1)
    if benchmark.stats is not None:
        ratio = theirs_s / benchmark.stats.stats.median
        benchmark.extra_info["times_faster_than_filterpy"] = ratio
