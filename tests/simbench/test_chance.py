"""The judge is judged: it cries wolf as often as it says, and no fault in it or its data hides."""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.special import chdtri

from simbench.checks.chance import judge
from simbench.checks.defaults import RUNS
from simbench.checks.montecarlo import ChiSquare, Innovations, RunSummary, monte_carlo, summary
from simbench.checks.verdict import Verdict
from simbench.dataset import Dataset
from simbench.errors import InputError
from simbench.scenario import loads
from simbench.sensors import simulate
from simbench.sensors.camera import camera_matrices, projected
from tests.simbench.test_montecarlo import SHORT, short
from vislam.filters import EkfSlam, slam_transport
from vislam.lie import se3

GATE = 0.99
FRAMES, SIGHTINGS = 40, 6


def ideal(rng: np.random.Generator, number: int, **changes) -> RunSummary:
    """A run of a right filter, drawn from the laws themselves; `changes` plant a fault."""
    told = {"pose": 1.0, "nis": 1.0, "by_dt": 0.0, "memory": 0.0, "gate": GATE, "dt": 0.5} | changes
    dt = 0.1 * (1 + told["dt"] * rng.uniform(-0.5, 0.5, FRAMES))
    w = rng.standard_normal((FRAMES, SIGHTINGS, 4))
    for t in range(1, FRAMES):
        w[t] += told["memory"] * w[t - 1]
    w *= np.sqrt(told["nis"] * (1 + told["by_dt"] * (dt / 0.1 - 1)))[:, None, None]
    accepted = np.square(w).sum(axis=-1) < chdtri(4, 1 - told["gate"])
    w *= accepted[..., None]
    products = [np.sum(w[:-lag] * w[lag:]) for lag in range(1, 6)]
    pairs = [4 * int(np.sum(accepted[:-lag] & accepted[lag:])) for lag in range(1, 6)]
    power = np.square(w).sum() / (4 * accepted.sum())
    return RunSummary(
        run=number,
        instants=np.arange(5),
        pose=ChiSquare(value=told["pose"] * rng.chisquare(6, 5), dof=np.full(5, 6)),
        map_given_pose=ChiSquare(value=rng.chisquare(12, 5), dof=np.full(5, 12)),
        landmark=ChiSquare(value=rng.chisquare(3, 3), dof=np.full(3, 3)),
        innovations=Innovations(
            dt_s=dt,
            nis=ChiSquare(value=np.square(w).sum(axis=(1, 2)), dof=4 * accepted.sum(axis=1)),
            tested=np.full(FRAMES, SIGHTINGS),
            rejected=SIGHTINGS - accepted.sum(axis=1),
            correlation=np.array(products) / power,
            pairs=np.array(pairs),
        ),
        figures={"ate_rmse_m": float(rng.uniform()), "diverged": 0.0},
    )


def ideals(seed: int = 0, **changes) -> list[RunSummary]:
    rng = np.random.default_rng(seed)
    return [ideal(rng, k, **changes) for k in range(RUNS)]


def failed(verdict: Verdict) -> set[str]:
    return {each.name for each in verdict.checks if not each.passed}


def in_band(count: int, trials: int, share: float) -> bool:
    """Whether a count is within the two-sided binomial band that is left once in 1000 times."""
    low, high = stats.binom(trials, share).interval(0.999)
    return bool(low <= count <= high)


# The false-alarm rate


def test_right_runs_fail_a_verdict_as_often_as_it_says():
    """300 verdicts; at each rate a right judge is refused once in 1000 times."""
    rng = np.random.default_rng(1)
    groups = [[ideal(rng, k) for k in range(RUNS)] for _ in range(300)]
    for rate in (0.05, 0.2):
        found = [judge(group, rate, gate=GATE) for group in groups]
        assert len(found[0].checks) == 1 + 5 + 5 + 3 + 4
        assert in_band(sum(not v.passed for v in found), 300, rate)


@pytest.mark.slow
def test_a_right_filter_fails_a_verdict_as_often_as_it_says():
    """300 verdicts, each of the default number of runs; no run is in two of them."""
    summaries = monte_carlo(loads(SHORT), "slam-transport", range(300 * RUNS), jobs=-1)
    for rate in (0.01, 0.05, 0.2):
        false = sum(
            not judge(summaries[first : first + RUNS], rate, gate=GATE).passed
            for first in range(0, len(summaries), RUNS)
        )
        print(f"stated {rate}, measured {false / 300:.4f}, {false} of 300")  # noqa: T201
        assert in_band(false, 300, rate)


# Faults of a judge: each is caught by a law that the judge itself satisfies

#: Draws NEES of one kind, (runs, steps), for the false-alarm law below.
WALK = 30


def correlated(rng: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    """NEES along random walks with their exact covariance: steps of a run resemble each other."""
    e = np.cumsum(rng.standard_normal((RUNS, WALK, 6)), axis=1)
    return scale * np.square(e).sum(axis=-1) / np.arange(1, WALK + 1)


def as_judged(nees: np.ndarray) -> float:
    """The p-value of ours for the last instant alone."""
    part = [
        RunSummary(
            run=k,
            instants=np.array([WALK - 1]),
            pose=ChiSquare(value=row[-1:], dof=np.array([6])),
        )
        for k, row in enumerate(nees)
    ]
    return next(each.p for each in judge(part).checks if each.name.startswith("pose"))


def wrong_dof(nees: np.ndarray) -> float:
    law = stats.chi2(RUNS * 3)
    return 2 * min(law.cdf(nees[:, -1].sum()), law.sf(nees[:, -1].sum()))


def one_sided(nees: np.ndarray) -> float:
    return float(stats.chi2(RUNS * 6).sf(nees[:, -1].sum()))


def time_pooled(nees: np.ndarray) -> float:
    law = stats.chi2(nees.size * 6)
    return 2 * min(law.cdf(nees.sum()), law.sf(nees.sum()))


def alarms(judge_: Callable[[np.ndarray], float], scale: float = 1.0) -> int:
    rng = np.random.default_rng(2)
    return sum(judge_(correlated(rng, scale)) < 0.05 for _ in range(200))


def cries_wolf_as_stated(judge_: Callable[[np.ndarray], float]) -> bool:
    """In 200 campaigns at 5 %; a right judge is refused once in 1000 times."""
    return in_band(alarms(judge_), 200, 0.05)


def sees_both_sides(judge_: Callable[[np.ndarray], float]) -> bool:
    """A covariance twice as large, or half as large, as it should be."""
    return min(alarms(judge_, 0.5), alarms(judge_, 2.0)) > 190


def test_our_nees_test_cries_wolf_as_stated_and_sees_both_sides():
    assert cries_wolf_as_stated(as_judged)
    assert sees_both_sides(as_judged)


def test_a_nees_test_of_the_wrong_dof_is_caught():
    assert not cries_wolf_as_stated(wrong_dof)


def test_a_nees_test_on_pooled_steps_is_caught():
    assert not cries_wolf_as_stated(time_pooled)


def test_a_nees_test_of_one_side_is_caught():
    assert cries_wolf_as_stated(one_sided)
    assert not sees_both_sides(one_sided)


class Left(EkfSlam):
    """Claims its covariance to be of the left error."""

    def belief(self, joint=False):
        return replace(super().belief(joint), chart="left")


def test_an_error_in_another_frame_than_its_covariance_is_caught():
    far = short("trajectory.start={translation_m: [30, 10, 0], rotvec_deg: [0, 0, 50]}")
    assert judge(monte_carlo(far, EkfSlam, range(RUNS)), gate=GATE).passed
    found = failed(judge(monte_carlo(far, Left, range(RUNS)), gate=GATE))
    assert {name for name in found if name.startswith("pose NEES")}


# Faults of a simulator


def shared_seed(noise: np.ndarray) -> np.ndarray:
    return noise[:, [0, 1, 0, 1]]


def variance_for_sigma(noise: np.ndarray) -> np.ndarray:
    return 0.3 * noise


def clipped(noise: np.ndarray) -> np.ndarray:
    return np.clip(noise, -0.6, 0.6)


def with_noise(dataset: Dataset, change: Callable[[np.ndarray], np.ndarray]) -> Dataset:
    """The dataset with its pixels' noise changed."""
    truth, seen = dataset.truth, dataset.sightings
    matrices = camera_matrices(truth.calibration.rig, truth.calibration.T_imu_cam)
    frame = seen.frames
    T_imu_world = se3.inverse(truth.T_world_imu)[frame]
    points = np.concatenate(
        [se3.apply(T, p[None]) for T, p in zip(T_imu_world, truth.landmarks[seen.ids], strict=True)]
    )
    true, _ = projected(matrices, points)
    return replace(dataset, sightings=replace(seen, pixels=true + change(seen.pixels - true)))


@pytest.mark.parametrize(
    ("change", "caught"),
    [
        (lambda noise: noise, False),
        (shared_seed, True),
        (variance_for_sigma, True),
        (clipped, True),
    ],
    ids=["as it is", "shared seed", "variance for sigma", "clipped"],
)
def test_a_fault_in_the_simulated_noise_is_caught(change, caught):
    scene = short("landmarks.count=20", "filter.gate=none")
    datasets = [with_noise(simulate(scene, run=k), change) for k in range(RUNS)]
    verdict = judge([summary(d, slam_transport, k) for k, d in enumerate(datasets)])
    assert ("NIS" in failed(verdict)) == caught
    assert verdict.passed != caught


# Each statistic sees what it is for


@pytest.mark.parametrize(
    ("changes", "name", "word"),
    [
        ({"pose": 2.0}, "pose NEES, frame 3", "too sure, though its predictions fit"),
        ({"pose": 0.5}, "pose NEES, frame 3", "less sure than it should be"),
        ({"nis": 1.3}, "NIS", "too large for their covariance, the errors are not"),
        ({"nis": 0.8}, "NIS", "too small for their covariance"),
        ({"by_dt": 1.5}, "NIS against dt", "process noise that does not grow with the interval"),
        ({"memory": 0.2}, "innovation whiteness", "innovations follow from earlier ones"),
        ({"gate": 0.95}, "gate rejections", "refuses more than it was told"),
        ({"gate": 0.9999}, "gate rejections", "refuses less than it was told"),
    ],
)
def test_a_fault_is_seen_by_its_own_statistic_and_explained(changes, name, word):
    verdict = judge(ideals(**changes), gate=GATE)
    (line,) = [each for each in verdict.checks if each.name == name]
    assert not line.passed
    assert not line.low <= line.statistic <= line.high
    assert word in line.reason


def test_pose_and_nis_failing_together_point_at_the_model():
    verdict = judge(ideals(pose=2.0, nis=1.3), gate=GATE)
    reasons = {each.name: each.reason for each in verdict.checks}
    assert "so are its predictions" in reasons["pose NEES, frame 3"]
    assert "the errors do not fit theirs" in reasons["NIS"]


def test_what_cannot_be_tested_is_skipped_with_a_reason():
    verdict = judge(ideals(dt=0.0, gate=1.0))
    assert "constant" in verdict.skipped["NIS against dt"]
    assert "no gate" in verdict.skipped["gate rejections"]
    bare = [replace(s, innovations=None, map_given_pose=None) for s in ideals()]
    skipped = judge(bare).skipped
    assert "innovations" in skipped
    assert "map NEES given the pose, frame 0" in skipped
    outliers = judge(ideals(), gate=GATE, outliers=True).skipped
    assert "some sightings are wrong" in outliers["gate rejections"]


def test_a_covariance_that_breaks_its_claim_is_an_infinite_nees_and_still_json():
    runs = ideals()
    value = runs[3].pose.value.copy()
    value[2] = np.inf
    runs[3] = replace(runs[3], pose=replace(runs[3].pose, value=value))
    verdict = judge(runs, gate=GATE)
    assert failed(verdict) == {"pose NEES, frame 2"}
    json.dumps(verdict.as_json(), allow_nan=False)


# The correction


def test_p_values_are_corrected_by_holm():
    """By hand: 0.005 * 4, 0.01 * 3, 0.03 * 2, and the largest no smaller than the one before."""
    law = stats.chi2(6)
    ps = (0.01, 0.04, 0.03, 0.005)
    one = RunSummary(
        run=0,
        instants=np.arange(4),
        pose=ChiSquare(value=law.isf(np.array(ps) / 2), dof=np.full(4, 6)),
    )
    verdict = judge([one], 0.05)
    found = {each.name: each.p for each in verdict.checks}
    assert [found[f"pose NEES, frame {k}"] for k in range(4)] == pytest.approx(
        [0.03, 0.06, 0.06, 0.02], rel=1e-9
    )
    assert failed(verdict) == {"pose NEES, frame 0", "pose NEES, frame 3"}


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 3.0), st.floats(0.001, 0.5))
def test_a_check_fails_exactly_where_its_statistic_leaves_its_band(seed, scale, rate):
    verdict = judge(ideals(seed, pose=scale, nis=scale**0.1), rate, gate=GATE)
    for each in verdict.checks:
        assert each.passed == (each.low <= each.statistic <= each.high)
        assert each.p is None or each.passed == (each.p > rate)
        assert bool(each.reason) != each.passed


# What the verdict says of it


def test_a_filter_that_raises_at_real_noise_only_fails_with_the_call():
    runs = [replace(s, failure="update 7 raised X: y") if s.run == 3 else s for s in ideals()]
    verdict = judge(runs, gate=GATE)
    assert failed(verdict) == {"runs that raised"}
    (line,) = [each for each in verdict.checks if not each.passed]
    assert line.reason == "run 3: update 7 raised X: y"
    assert verdict.figures["failed"] == 1 / RUNS


def test_the_table_shows_every_check_and_the_rate():
    verdict = judge(ideals(pose=3.0), gate=GATE)
    text = "\n".join(verdict.lines())
    assert all(each.name in text for each in verdict.checks)
    assert text.count("too sure, though") == 1
    assert "1 %" in text


@pytest.mark.parametrize(("runs", "rate"), [(0, 0.01), (1, 0.0), (1, 1.0)])
def test_a_verdict_on_nothing_or_at_no_rate_is_refused(runs, rate):
    with pytest.raises(InputError, match="Expected"):
        judge(ideals()[:runs], rate)
