"""The loop that drives a filter: its order, its clock, and what it does with a bad filter."""

from dataclasses import replace
from itertools import cycle
from types import SimpleNamespace

import numpy as np
import pytest

from simbench.errors import FilterFailure
from simbench.metrics import metrics
from simbench.run import RunOptions, run
from simbench.sensors import simulate
from tests.simbench.scenes import RICH, scene
from vislam.charts import CHARTS
from vislam.filters import DeadReckoning, EkfSlam

DATASET = simulate(scene(RICH, duration_s=1.0))


class Spy(DeadReckoning):
    """Dead reckoning that notes its calls."""

    def __init__(self, task):
        super().__init__(task)
        self.calls = []

    def predict(self, motion, dt):
        self.calls.append(("predict", motion.time_s, dt))
        if self.motion == "twist":
            super().predict(motion, dt)

    def update(self, frame):
        self.calls.append(("update", frame.time_s))

    motion = "twist"


class RawSpy(Spy):
    motion = "imu"


def calls_of(kind):
    made = []
    run(DATASET, lambda task: made.append(kind(task)) or made[0])
    return made[0].calls


def test_calls_come_in_time_order_and_each_sample_moves_to_the_next_frame():
    calls, t = calls_of(Spy), DATASET.times_s
    assert [call[0] for call in calls] == ["update", "predict"] * (len(t) - 1) + ["update"]
    assert [call[1] for call in calls if call[0] == "update"] == t.tolist()
    assert [call[2] for call in calls if call[0] == "predict"] == np.diff(t).tolist()


def test_raw_samples_fill_each_interval_between_frames_without_gap():
    calls, t = calls_of(RawSpy), DATASET.times_s
    clock = t[0]
    for call in calls:
        assert call[1] == pytest.approx(clock, abs=1e-9)
        clock += call[2] if call[0] == "predict" else 0
    assert clock == pytest.approx(t[-1], abs=1e-9)
    assert len(calls) > 5 * len(t)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"update": lambda _: 3}, "update 0 returned int: expected an Innovation or None"),
        ({"belief": lambda: None}, "update 0 left NoneType"),
        ({"finish": lambda: None}, "finish left NoneType"),
        ({"predict": None}, "start gave what is no filter: SimpleNamespace has no method predict"),
    ],
)
def test_a_filter_that_returns_what_it_must_not_is_named_with_the_call(changes, message):
    def factory(task):
        good = DeadReckoning(task)
        methods = {"predict": good.predict, "update": good.update, "belief": good.belief}
        return SimpleNamespace(**(methods | changes))

    with pytest.raises(FilterFailure, match=message):
        run(DATASET, factory)


def test_a_pose_that_is_not_finite_is_named_with_the_call():
    class Lost(DeadReckoning):
        def predict(self, motion, dt):
            super().predict(motion, dt * np.nan)

    with pytest.raises(FilterFailure, match="update 1 left `T_world_imu` that is not finite"):
        run(DATASET, Lost)


LONGER = simulate(scene(duration_s=6.0))


def test_past_poses_are_known_better_in_the_end_and_the_metrics_say_so():
    record = run(LONGER, EkfSlam, options=RunOptions(smooth=True))
    values = metrics(record)
    assert len(record.smoothed) == len(record.steps)
    assert values["smoothed_rpe_trans_rmse_m"] < 0.95 * values["rpe_trans_rmse_m"]
    last = record.steps[-1].belief
    assert np.array_equal(record.smoothed[-1].T_world_imu, last.T_world_imu)
    for step, smoothed in zip(record.steps, record.smoothed, strict=True):
        gained = step.belief.pose_covariance - smoothed.pose_covariance
        assert np.linalg.eigvalsh(gained).min() > -1e-12


def one_at_a_time(*arrays):
    assert arrays[0].shape == (4, 4)
    return CHARTS["left"].error(*arrays)


@pytest.mark.parametrize("charts", [*([name] for name in CHARTS), [*CHARTS], [one_at_a_time]])
def test_pose_errors_are_those_of_each_belief_in_its_chart_to_the_last_bit(charts):
    record = run(DATASET, DeadReckoning)
    steps = tuple(
        replace(step, belief=replace(step.belief, chart=chart))
        for step, chart in zip(record.steps, cycle(charts), strict=False)
    )
    expected = [s.belief.pose_error(DATASET.truth.T_world_imu[s.frame]) for s in steps]
    assert np.array_equal(replace(record, steps=steps).pose_errors, expected)
    assert len({str(errors) for errors in expected}) > 1


def test_nobody_who_did_not_ask_gets_past_poses():
    record = run(LONGER, EkfSlam)
    assert record.smoothed is None
    assert record.as_smoothed is None
    assert metrics(record)["smoothed_ate_rmse_m"] is None


def test_data_fed_as_a_stream_know_no_last_sighting_and_the_map_is_as_large():
    told = []

    class Listening(EkfSlam):
        def update(self, frame):
            told.append(frame.last.any())
            return super().update(frame)

    record = run(LONGER, Listening, options=RunOptions(retire_after=3))
    assert not any(told)
    assert len(record.final.ids) == len(run(LONGER, EkfSlam).final.ids)
    assert len(record.steps[-1].belief.ids) < len(record.final.ids)
