"""What a run leaves behind for a verdict: the right numbers, whatever process ran it."""

from dataclasses import replace

import numpy as np
import pytest

from simbench.checks.montecarlo import AGES, RunSummary, instants, monte_carlo, summary
from simbench.filters import resolve
from simbench.run import run
from simbench.scenario import loads
from simbench.sensors import simulate
from vislam.filters import EkfSlam, slam_transport

#: Short, in the linear regime, with births, retirements, a gate and jittered times.
SHORT = """
name: short
seed: 101
duration_s: 2.2
rate_hz: 5.0
time_jitter: 0.5
trajectory:
  kind: straight
  speed_mps: 1.0
  roll_deg: 5.0
  pitch_deg: 4.0
  roll_period_s: 2.0
  pitch_period_s: 1.5
landmarks: {kind: path, count: 6, lateral_m: [0.5, 2.0], height_m: [-0.5, 0.8], ahead_m: 7.0}
rig: {image_px: [1242, 800], cy_px: 400.0, depth_m: [1.0, 6.0]}
imu:
  velocity: {sigma: 0.05}
  angular_velocity: {sigma: 0.01}
camera: {sigma_px: 0.3}
prior: {sigma_translation_m: 0.02, sigma_rotation_deg: 0.1}
filter: {gate: 0.99}
"""


def short(*overrides: str):
    return loads(SHORT, overrides=overrides)


def numbers(s: RunSummary) -> list[bytes]:
    """Every number of a summary, to the bit."""
    i = s.innovations
    arrays = [s.instants, s.pose.value, s.pose.dof, s.map_given_pose.value, s.map_given_pose.dof]
    arrays += [s.landmark.value, s.landmark.dof, i.dt_s, i.nis.value, i.nis.dof, i.tested]
    arrays += [i.rejected, i.correlation, i.pairs]
    arrays.append(np.array([np.nan if v is None else v for v in s.figures.values()]))
    return [np.asarray(a).tobytes() for a in arrays]


class Raising(EkfSlam):
    """Raises in its third prediction."""

    count = 0

    def predict(self, motion, dt):
        self.count += 1
        if self.count == 3:
            raise RuntimeError("lost")
        super().predict(motion, dt)


def test_a_summary_depends_on_its_run_alone_not_on_jobs_or_order():
    alone = monte_carlo(short(), "slam", range(3))
    shared = monte_carlo(short(), "slam", reversed(range(4)), jobs=2)
    assert [s.run for s in shared] == [3, 2, 1, 0]
    for a, b in zip(alone, shared[:0:-1], strict=True):
        assert numbers(a) == numbers(b)
    assert numbers(alone[0]) != numbers(alone[1])


def test_another_seed_makes_other_runs():
    (a,) = monte_carlo(short(), "slam", [0])
    (b,) = monte_carlo(short(), "slam", [0], seed=5)
    assert numbers(a) != numbers(b)


def test_a_filter_that_raises_is_a_result_that_names_the_call():
    for jobs in (1, 2):
        (one, other) = monte_carlo(short(), Raising, [4, 6], jobs=jobs)
        assert one.failure == other.failure == "predict 2 raised RuntimeError: lost"
        assert (one.run, other.run) == (4, 6)
        assert one.pose is None


def test_nees_of_pose_and_of_the_map_given_the_pose_make_the_joint_nees():
    dataset = simulate(short())
    found = summary(dataset, slam_transport)
    filters = []

    def kept(task):
        filters.append(slam_transport(task))
        return filters[0]

    joint = {}

    def on_step(step):
        belief = filters[0].belief(joint=True)
        e, P = belief.error(dataset.truth.state(step.frame)), belief.joint_covariance
        joint[step.frame] = float(e @ np.linalg.solve(P, e)), len(e)

    run(dataset, kept, on_step=on_step)
    assert len(found.instants) == 5
    assert found.pose.dof.tolist() == [6] * 5
    for k, frame in enumerate(found.instants.tolist()):
        value, dof = joint[frame]
        total = found.pose.value[k] + found.map_given_pose.value[k]
        assert total == pytest.approx(value, rel=1e-8)
        assert 6 + found.map_given_pose.dof[k] == dof > 6


def test_a_start_that_is_known_exactly_is_left_out():
    known = short("prior.sigma_translation_m=0.0", "prior.sigma_rotation_deg=0.0")
    (s,) = monte_carlo(known, "slam", [0])
    assert s.pose.dof.tolist() == [0, 6, 6, 6, 6]
    assert s.pose.value[0] == 0
    assert s.map_given_pose.dof[0] > 0


def test_the_landmark_of_an_age_class_is_one_of_that_age_and_any_of_them():
    births: dict[int, int] = {}
    by_age: dict[str, list[float]] = {name: [] for name in AGES}
    dataset = simulate(short())
    record = run(dataset, resolve("slam"))
    for step in record.steps:
        belief, truth = step.belief, dataset.truth.landmarks
        for k, i in enumerate(belief.ids.tolist()):
            age = step.frame - births.setdefault(i, step.frame)
            name = next(n for n, (least, most) in AGES.items() if least <= age <= most)
            e = truth[i] - belief.landmarks[k]
            by_age[name].append(float(e @ np.linalg.solve(belief.landmark_covariances[k], e)))
    assert all(by_age.values())
    found = summary(dataset, resolve("slam"))
    for k, name in enumerate(AGES):
        assert found.landmark.dof[k] == 3
        assert np.isclose(by_age[name], found.landmark.value[k], rtol=1e-8).any()
    others = [
        summary(replace(dataset, origin=replace(dataset.origin, run=n)), resolve("slam"))
        for n in range(1, 5)
    ]
    assert len({other.landmark.value[1] for other in others}) > 1


def test_innovations_keep_every_frame_but_the_first():
    dataset = simulate(short())
    found, record = summary(dataset, resolve("slam")), run(dataset, resolve("slam"))
    said = [step.innovation for step in record.steps[1:]]
    i = found.innovations
    assert np.array_equal(i.dt_s, np.diff(dataset.times_s))
    assert i.nis.value.tolist() == [float(s.nis) for s in said]
    assert i.nis.dof.tolist() == [4 * int(s.accepted.sum()) for s in said]
    assert i.tested.tolist() == [len(s.ids) for s in said]
    assert i.rejected.tolist() == [int((~s.accepted).sum()) for s in said]


def test_a_filter_without_innovations_or_pose_covariance_leaves_them_out():
    (reckoned,) = monte_carlo(short(), "dead-reckoning", [0])
    assert reckoned.innovations is None
    assert not reckoned.landmark.dof.any()
    assert not reckoned.map_given_pose.dof.any()
    assert reckoned.pose.dof.all()
    (mapped,) = monte_carlo(short(), "mapping-truth", [0])
    assert not mapped.pose.dof.any()
    assert mapped.map_given_pose.dof.all()
    assert mapped.figures["diverged"] is None


@pytest.mark.parametrize("frames", [2, 3, 5, 100])
def test_instants_are_distinct_frames_before_the_last(frames):
    at = instants(frames).tolist()
    assert at == sorted(set(at))
    assert at[0] == 0
    assert at[-1] == frames - 2
    assert len(at) == min(5, frames - 1)
