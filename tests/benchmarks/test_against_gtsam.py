"""The filters against what a user would pick instead: iSAM2, with the batch optimum beside both.

`SIMBENCH_SEEDS` says of how many drives, by default 10, which takes minutes.
"""

import os
import time
from pathlib import Path

import numpy as np
import pytest

from simbench.filters import resolve
from simbench.metrics import ate, rmse
from simbench.run import RunOptions, run
from simbench.scenario import load
from simbench.sensors import simulate
from tests.benchmarks.turns import MARGIN

pytest.importorskip("gtsam", reason="an extra: pip install -e '.[gtsam]'")
from tests.benchmarks.smoother import estimated

DRIVE = Path(__file__).parents[2] / "scenarios" / "drive.yaml"
#: The smoother by what it is asked for in every frame: its pose alone, or as a filter gives it, the
#: pose and its covariance. The second is what the cost is judged against.
SMOOTHER = ("iSAM2", "iSAM2 + covariance")
FILTERS = ("slam", "slam-transport", "slam-invariant", "slam-iterated", "slam-inverse-depth")
#: The one that is held to the smoother: made for depths beyond the rule, which this drive has.
BEST = "slam-inverse-depth"
SEEDS = range(int(os.environ.get("SIMBENCH_SEEDS", "10")))
#: Filters and smoother are told the same, so nothing may be in the data that only a gate handles.
#: The depth rule (17 m at 0.7 px) is kept in part. With depths to 40 m iSAM2 at its defaults gives
#: up on half of the seeds: a Gauss-Newton step puts a landmark behind its cameras.
SCENE = (
    "camera.outliers.share=0",
    "filter.gate=none",
    "landmarks.lateral_m=[1.5, 8.0]",
    "landmarks.height_m=[-1.5, 4.0]",
    "rig.depth_m=[3.0, 25.0]",
    "camera.tracks.median_frames=12",
    "prior.sigma_translation_m=0.01",
    "prior.sigma_rotation_deg=0.05",
)
#: What the long drive needs, for otherwise iSAM2 gives up on most seeds of it too.
QUIET = ("imu.velocity.sigma=0.2", "imu.angular_velocity.sigma=0.02", "camera.sigma_px=0.5")
BLOCKS = 5


def drive(frames, landmarks, *overrides):
    """A part of drive.yaml, with so many landmarks along it."""
    duration = f"duration_s={(frames - 1) / load(DRIVE).rate_hz:.6f}"
    return load(DRIVE, [*SCENE, duration, f"landmarks.count={landmarks}", *overrides])


def errors(Ts, dataset):
    """ATE and end error of poses, metres."""
    found = ate(Ts, dataset.truth.T_world_imu).translation_m
    return rmse(found), float(found[-1])


class Tally:
    """Errors and times of one estimator over seeds."""

    def __init__(self):
        self.ms, self.blocks, self.online, self.smoothed = [], [], [], []

    def add(self, ms, online, smoothed, blocks=()):
        self.ms.append(ms)
        self.blocks.append(blocks)
        self.online.append(online)
        self.smoothed.append(smoothed)

    @property
    def row(self):
        """Time, RMS over seeds of online ATE and end error, and of smoothed ATE."""
        return (np.mean(self.ms), *rms(self.online), *rms(self.smoothed)[:1])


def rms(values):
    return [float(v) for v in np.sqrt(np.mean(np.square(values), axis=0))]


def by_blocks(seconds):
    """Milliseconds a frame, early to late."""
    return [1e3 * float(np.mean(part)) for part in np.array_split(seconds, BLOCKS)]


def filtered(dataset, name, tally):
    """Run a filter twice: for its cost, whole map included, and for its smoothed poses."""
    marks = [time.process_time()]
    run(dataset, resolve(name), on_step=lambda _: marks.append(time.process_time()))
    ms = 1e3 * (time.process_time() - marks[0]) / len(dataset)
    record = run(dataset, resolve(name), options=RunOptions(smooth=True))
    tally.add(
        ms,
        errors(record.T_world_imu, dataset),
        errors(record.as_smoothed.T_world_imu, dataset),
        by_blocks(np.diff(marks)),
    )


def test_the_smoother_is_told_what_a_filter_is_told():
    """Where little is not linear, the filter and the smoother have one posterior."""
    quiet = "imu.velocity.sigma=0.1", "imu.angular_velocity.sigma=0.005", "camera.sigma_px=0.2"
    dataset = simulate(drive(40, 300, *quiet, "rig.depth_m=[3.0, 12.0]"))
    ours = run(dataset, resolve("slam-transport")).final
    theirs = estimated(dataset)
    sigma = np.sqrt(np.diag(ours.pose_covariance))
    assert np.sqrt(np.diag(theirs.pose_covariance)) == pytest.approx(sigma, rel=0.01)
    assert (np.abs(ours.pose_error(theirs.batch[-1])) < 0.3 * sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frames", "landmarks", "noise"), [(300, 2030, ()), (1000, 9900, QUIET)], ids=["300", "1000"]
)
def test_cost_and_error_against_isam2(benchmark, report, frames, landmarks, noise):
    tallies = {name: Tally() for name in (*SMOOTHER, "batch optimum", *FILTERS)}
    seeds, sightings, given_up = iter(SEEDS), [], []

    def one_seed():
        dataset = simulate(drive(frames, landmarks, *noise), seed=next(seeds))
        try:
            theirs = estimated(dataset)
        except RuntimeError as error:
            if "Indeterminate linear system" not in str(error):
                raise
            given_up.append(error)
            return
        sightings.append(len(dataset.sightings) / frames)
        smoothed = errors(theirs.smoothed, dataset)
        whole = theirs.seconds + theirs.covariance_s
        online = errors(theirs.online, dataset)
        for name, seconds in zip(SMOOTHER, (theirs.seconds, whole), strict=True):
            tallies[name].add(1e3 * seconds.mean(), online, smoothed, by_blocks(seconds))
        batch = errors(theirs.batch, dataset)
        tallies["batch optimum"].add(1e3 * theirs.batch_s / frames, batch, batch)
        for name in FILTERS:
            filtered(dataset, name, tallies[name])

    benchmark.pedantic(one_seed, rounds=len(SEEDS))
    if not sightings:
        pytest.skip("iSAM2 gave up on every seed")
    per_seed = {name: np.array(tally.ms) for name, tally in tallies.items()}
    cheaper = {
        name: [float(np.median(per_seed[theirs] / ms)) for theirs in SMOOTHER]
        for name, ms in per_seed.items()
    }
    title = (
        f"{frames} frames, {np.mean(sightings):.0f} sightings each, {len(sightings)} seeds; "
        f"iSAM2 gave up on {len(given_up)} more"
    )
    heads = (
        "",
        "ms a frame",
        "ATE m",
        "end m",
        "smoothed ATE m",
        *(f"cheaper than {name}" for name in SMOOTHER),
    )
    report(title, heads, [(n, *t.row, *cheaper[n]) for n, t in tallies.items()])
    over_time = [
        (name, *(float(v) for v in np.mean(tallies[name].blocks, axis=0)))
        for name in (*SMOOTHER, "slam", BEST)
    ]
    fifths = [f"{i + 1}. fifth" for i in range(BLOCKS)]
    report(f"Milliseconds a frame over {frames} frames", ("", *fifths), over_time)
    if benchmark.enabled:
        theirs, ours = (rms(tallies[name].smoothed)[0] for name in (SMOOTHER[0], BEST))
        assert ours < 1.1 * theirs
        if frames == 1000:
            assert cheaper[BEST][-1] > 5 / MARGIN
