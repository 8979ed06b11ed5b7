"""The power of the checks that need many runs: measured rightly, and as the catalogue says.

N runs and false-alarm rates are those of the sentences; seeds are fixed, not chosen.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest, chi2

from simbench.bugs import BUGS, CHECKS, power
from simbench.bugs.matrix import RELIABLE, Cell, mark, matrix, missed, table
from simbench.bugs.power import FALSE_ALARM, SIZES, Share, ate_ratio, p_values, powers, runs_of
from simbench.checks.montecarlo import AGES, LAGS, ChiSquare, Innovations, RunSummary
from simbench.errors import InputError
from simbench.filters import resolve
from simbench.metrics import nees, whiteness


def synthetic(scale, count, seed=0):
    """Runs whose NIS is `scale` times chi-square with 4 degrees, and nothing else."""
    rng = np.random.default_rng(seed)
    nothing = ChiSquare(value=np.zeros(1), dof=np.zeros(1, np.int64))
    none = ChiSquare(value=np.zeros(len(AGES)), dof=np.zeros(len(AGES), np.int64))
    return [
        RunSummary(
            run=k,
            instants=np.zeros(1, np.int64),
            pose=nothing,
            map_given_pose=nothing,
            landmark=none,
            innovations=Innovations(
                dt_s=np.ones(1),
                nis=ChiSquare(value=scale * rng.chisquare(4, 1), dof=np.array([4])),
                tested=np.ones(1, np.int64),
                rejected=np.zeros(1, np.int64),
                correlation=np.zeros(LAGS),
                pairs=np.zeros(LAGS, np.int64),
            ),
        )
        for k in range(count)
    ]


@pytest.fixture
def ungated(monkeypatch):
    """The scene without a gate, so that the band of NIS is the plain one."""
    drive = power.drive()
    ungated = replace(drive, dataset=replace(drive.dataset, gate=None))
    monkeypatch.setattr(power, "drive", lambda: ungated)


def known_power(scale, runs):
    low, high = chi2(4 * runs).ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2])
    return chi2(4 * runs).cdf(low / scale) + chi2(4 * runs).sf(high / scale)


@pytest.mark.usefixtures("ungated")
@pytest.mark.parametrize("scale", [1.0, 1.5, 0.6])
def test_the_measured_power_of_a_synthetic_fault_is_the_known_one(scale):
    shares = powers(synthetic(scale, 1000))["nis"]
    assert [(s.runs, s.groups) for s in shares] == [(1, 1000), (5, 200), (20, 50)]
    for share in shares:  # 9 tests of 1e-3 each: one run in 100 would fail by chance
        known = known_power(scale, share.runs)
        assert binomtest(share.failed, share.groups, known).pvalue > 1e-3


@pytest.mark.parametrize(("failed", "groups"), [(0, 20), (1, 20), (7, 20), (20, 20), (3, 400)])
def test_an_interval_is_that_of_clopper_and_pearson(failed, groups):
    low, high = Share(runs=20, failed=failed, groups=groups).interval
    expected = binomtest(failed, groups).proportion_ci(power.CONFIDENCE, "exact")
    assert low == pytest.approx(expected.low, abs=1e-12)
    assert high == pytest.approx(expected.high, abs=1e-12)


@pytest.mark.parametrize("p", [0.01, 0.3, 0.85])
def test_an_interval_covers_at_least_as_often_as_it_says(p):
    from scipy.stats import binom

    k = np.arange(21)
    covers = [low <= p <= high for low, high in (_interval(int(i), 20) for i in k)]
    assert binom.pmf(k[covers], 20, p).sum() >= power.CONFIDENCE


def _interval(failed, groups):
    return Share(runs=20, failed=failed, groups=groups).interval


@pytest.fixture(scope="module")
def bases():
    return {base: runs_of(resolve(base), 200) for base in ("slam", "slam-fej")}


@pytest.mark.parametrize("base", ["slam", "slam-fej"])
def test_a_right_filter_fails_hardly_more_often_than_the_false_alarm_level(base, bases):
    for check, shares in powers(bases[base]).items():
        for share in shares:
            # 3 % is allowed, for what is not linear; 36 tests of 1e-4 each.
            assert binomtest(share.failed, share.groups, 0.03, "greater").pvalue > 1e-4, check


@pytest.mark.parametrize(
    ("check", "name"),
    [
        ("nees", "birth-without-cross-covariance"),
        ("landmark-nees", "birth-without-pose-uncertainty"),
        ("nis", "pixel-sigma-for-variance"),
        ("whiteness", "jacobian-without-division-by-depth"),
        ("nis-vs-dt", "process-noise-of-mean-interval"),
        ("raises", "unseen-landmarks-left"),
    ],
)
def test_each_check_catches_a_bug_that_is_named_for_it(check, name):
    assert check in BUGS[name].checks
    assert powers(runs_of(resolve(f"slam+{name}"), 100))[check][-1].value >= RELIABLE


def test_equal_inputs_give_equal_runs(bases):
    again = runs_of(resolve("slam"), 100)
    for a, b in zip(again, bases["slam"], strict=False):
        assert a.figures == b.figures
        assert np.array_equal(a.pose.value, b.pose.value)
        assert np.array_equal(a.landmark.value, b.landmark.value)


def test_a_run_of_a_batch_is_summarised_as_it_is_alone():
    drive, name = power.drive(), "slam"
    w = np.random.default_rng(1).standard_normal((3, drive.scalars))
    together = power._runs(resolve(name), w, 0)
    for k, found in enumerate(together):
        readings = drive.realise(w[k])
        filter_ = resolve(name)(replace(drive.task, prior=readings.prior))
        innovations, positions, pose = [], [], []
        for i, frame in enumerate(readings.frames):
            if i:
                filter_.predict(readings.twists[i - 1], float(drive.intervals_s[i - 1]))
            innovations.append(filter_.update(frame))
            belief = filter_.belief(joint=True)
            positions.append(belief.T_world_imu[:3, 3] - drive.T_world_imu[i, :3, 3])
            if i in found.instants:
                error = belief.error(drive.state(i))
                pose.append(float(nees(error[:6], belief.pose_covariance)))
                rest = float(nees(error, belief.joint_covariance)) - pose[-1]
                j = len(pose) - 1
                assert found.map_given_pose.dof[j] == len(error) - 6
                assert found.map_given_pose.value[j] == pytest.approx(rest, rel=1e-6, abs=1e-6)
        assert found.pose.value == pytest.approx(pose, rel=1e-6)
        ate_m = np.sqrt(np.mean(np.sum(np.square(positions), axis=1)))
        assert found.figures["ate_rmse_m"] == pytest.approx(ate_m, rel=1e-9)
        white = whiteness(innovations[1:], LAGS)
        assert found.innovations.pairs.tolist() == white.pairs.tolist()
        expected = white.autocorrelation * white.pairs
        assert found.innovations.correlation == pytest.approx(expected, rel=1e-6, abs=1e-6)
        assert found.innovations.nis.value == pytest.approx(
            [float(i.nis) for i in innovations[1:]], rel=1e-6
        )
        assert found.innovations.nis.dof.tolist() == [int(i.dof) for i in innovations[1:]]


def test_one_run_that_raises_leaves_the_others_whole():
    def factory(task):
        filter_ = resolve("slam")(task)
        T = task.prior.T_world_imu
        if T.ndim > 2 and len(T) > 1:  # raises until the runs are alone
            raise ValueError("a run of these is bad")
        if T[0, 0, 3] == worst:
            raise ValueError("this run is bad")
        return filter_

    drive = power.drive()
    w = np.random.default_rng(2).standard_normal((5, drive.scalars))
    worst = drive.realise(w).prior.T_world_imu[3, 0, 3]
    found = power._runs(factory, w, 10)
    assert [run.run for run in found] == [10, 11, 12, 13, 14]
    assert [run.failure is None for run in found] == [True, True, True, False, True]
    assert "this run is bad" in found[3].failure
    assert p_values(found)["raises"] == 0
    assert "raises" not in p_values(found[:3])


def test_the_ratio_of_the_ate_is_the_median_of_pairs_with_the_interval_of_the_sign_test():
    def run(k, ate_m):
        return RunSummary(run=k, figures={"ate_rmse_m": ate_m})

    base = [run(k, 1.0 + k) for k in range(101)]
    bug = [run(k, (1.0 + k) * (k + 1)) for k in range(101)]
    found = ate_ratio(bug, base)
    assert found.median == 51
    low, high = int(found.low), int(found.high)
    assert low + high == 102
    from scipy.stats import binom

    covers = 1 - 2 * binom.cdf(low - 1, 101, 0.5)
    assert covers >= power.CONFIDENCE > 1 - 2 * binom.cdf(low, 101, 0.5)
    assert ate_ratio([RunSummary(run=0, failure="raised")], base[:1]) is None


@pytest.mark.parametrize("runs", [0, 20, 150])
def test_a_number_of_runs_that_makes_no_batches_is_refused(runs):
    with pytest.raises(InputError, match="expected a multiple of 100"):
        runs_of(resolve("slam"), runs)


def test_columns_of_chance_are_checks_of_the_catalogue():
    assert set(power.COLUMNS) <= set(CHECKS)
    assert SIZES == (1, 5, 20)


def test_the_matrix_shows_power_and_ratio():
    found = matrix(["process-noise-of-mean-interval"], jobs=1, runs=100)
    cells = found["process-noise-of-mean-interval"]
    assert missed("process-noise-of-mean-interval", cells) == []
    assert list(cells)[-1] == "ate"
    header, line = (text.split() for text in table(found).splitlines())
    assert dict(zip(header, line[1:], strict=True))["nis-vs-dt"] == mark(cells["nis-vs-dt"])
    values = json.loads(json.dumps({c: cell.as_json() for c, cell in cells.items()}))
    assert [p["runs"] for p in values["nis-vs-dt"]["powers"]] == list(SIZES)
    by_chance = {column for column, value in values.items() if value.get("runs") == 100}
    assert by_chance == {*power.COLUMNS, "ate"}
    assert values["ate"]["low"] <= values["ate"]["statistic"] <= values["ate"]["high"]


def test_a_check_that_misses_what_it_must_catch_is_marked_with_its_power():
    weak = Cell(caught=False, powers=(Share(runs=20, failed=10, groups=20),))
    assert missed("fused-twice", {"nis": weak}) == ["nis"]
    assert table({"fused-twice": {"nis": weak}}).split()[-1] == "0.50!"
