"""The laws hold for every filter that is right, and each is broken by a fault planted for it."""

from dataclasses import replace

import numpy as np
import pytest

from simbench.checks import gate, laws
from simbench.checks.scenes import SCENES, drive
from simbench.filters import resolve
from tests.simbench.checked import Wrapped, with_parts, without_covariance, wrapped
from vislam.filters import DeadReckoning, EkfSlam, Mapping
from vislam.gaussian import gate_threshold

LAWS = [
    laws.move_the_world,
    laws.rename_the_landmarks,
    laws.shift_the_clock,
    laws.reorder_the_features,
    laws.run_twice,
    laws.keep_what_was_handed_out,
    laws.divide_the_frame,
    laws.hide_a_landmark,
    laws.ignore_an_empty_frame,
    laws.ignore_a_half_missing_feature,
    laws.ignore_what_a_mask_hides,
    laws.state_covariances,
]
CONSISTENT = [
    "slam-fej",
    "slam-transport",
    "slam-invariant",
    "slam-iterated",
    "slam-inverse-depth",
]
RIGHT = ["dead-reckoning", "mapping", "mapping-truth", "slam", *CONSISTENT]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
@pytest.mark.parametrize("name", RIGHT)
def test_right_filter_obeys(law, name):
    result = law(resolve(name))
    assert result.passed, str(result)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
@pytest.mark.parametrize("scene", list(SCENES))
def test_slam_obeys_on_every_scene(law, scene):
    result = law(EkfSlam, drive(scene))
    assert result.passed, str(result)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_black_box_without_covariance_and_innovations_obeys_or_is_left_alone(law):
    mute = wrapped(EkfSlam, belief=without_covariance, innovations=False)
    result = law(mute)
    needs_covariance = law in (laws.divide_the_frame, laws.state_covariances)
    assert result.outcome == ("skipped" if needs_covariance else "passed"), str(result)


class WithRates(EkfSlam):
    """A feature that is further up in the frame is trusted more: the order matters."""

    def update(self, frame):
        weights = 1 + 0.01 * np.arange(len(frame.ids))[:, None]
        return super().update(replace(frame, pixels=frame.pixels * weights))


class ByName(EkfSlam):
    """A landmark's number gets into its sighting."""

    def update(self, frame):
        return super().update(replace(frame, pixels=frame.pixels + 1e-3 * (frame.ids % 5)[:, None]))


class ByClock(EkfSlam):
    def predict(self, motion, dt):
        super().predict(motion, dt * (1 + 1e-6 * motion.time_s))


class FromOrigin(EkfSlam):
    """Believes that it starts near the origin of the world."""

    def predict(self, motion, dt):
        super().predict(motion, dt)
        self.P[:3, :3] *= 1 + 1e-6 * np.linalg.norm(self.x.T[:3, 3])


class Chancy(EkfSlam):
    chance = np.random.default_rng(0)

    def predict(self, motion, dt):
        super().predict(motion, dt + 1e-9 * self.chance.random())


class HandsOutItsOwn(DeadReckoning):
    def predict(self, motion, dt):
        before = self.T
        super().predict(motion, dt)
        before[...] = self.T
        self.T = before

    def belief(self, joint=False):
        return replace(super().belief(joint), T_world_imu=self.T)


class CountsTheMissing(EkfSlam):
    """The covariance shrinks by a sighting, seen or not."""

    def update(self, frame):
        innovation = super().update(frame)
        self.P *= 1 - 1e-4 * len(frame.ids)
        return innovation


def any_for_all(_, pixels):
    """Takes a feature with any coordinate for a whole one."""
    return (pixels != -1).any(axis=-1)


class Asymmetric(EkfSlam):
    def update(self, frame):
        innovation = super().update(frame)
        self.P[0, 1] *= 1 + 1e-6
        return innovation


class Indefinite(EkfSlam):
    def belief(self, joint=False):
        belief = super().belief(joint)
        P = belief.pose_covariance - 0.1 * np.eye(6)
        return replace(belief, pose_covariance=P, joint_covariance=None)


@pytest.mark.parametrize(
    ("law", "faulty"),
    [
        (laws.move_the_world, FromOrigin),
        (laws.rename_the_landmarks, ByName),
        (laws.shift_the_clock, ByClock),
        (laws.reorder_the_features, WithRates),
        (laws.run_twice, Chancy),
        (laws.keep_what_was_handed_out, HandsOutItsOwn),
        (laws.divide_the_frame, WithRates),
        (laws.hide_a_landmark, CountsTheMissing),
        (laws.ignore_an_empty_frame, CountsTheMissing),
        (laws.ignore_a_half_missing_feature, with_parts(valid=any_for_all)),
        (laws.ignore_what_a_mask_hides, with_parts(valid=any_for_all)),
        (laws.state_covariances, Asymmetric),
        (laws.state_covariances, Indefinite),
    ],
    ids=lambda value: getattr(value, "__name__", "parts"),
)
def test_planted_fault_breaks_the_law(law, faulty):
    result = law(faulty)
    assert result.failed, str(result)
    assert result.failure == "mistake"
    assert result.reason


def test_covariance_stated_alone_must_be_the_joint_one_s_block():
    def other(belief):
        return replace(belief, pose_covariance=belief.pose_covariance * (1 + 1e-6))

    result = laws.state_covariances(wrapped(EkfSlam, belief=other))
    assert result.failed
    assert "start: the pose covariance is not the joint one's block" in result.reason


class Raises(EkfSlam):
    def update(self, frame):
        if len(self.ids):
            raise RuntimeError("out of film")
        return super().update(frame)


@pytest.mark.parametrize("law", [*LAWS, gate.refuse_as_often_as_told], ids=lambda law: law.__name__)
def test_exception_in_the_filter_is_a_failed_result(law):
    result = law(Raises)
    assert result.failed
    assert result.failure == "mistake"
    assert "raised RuntimeError: out of film" in result.reason


def test_belief_that_is_none_is_a_failed_result():
    result = laws.run_twice(
        wrapped(EkfSlam, belief=lambda b: replace(b, T_world_imu=b.T_world_imu[:3]))
    )
    assert result.failed
    assert "left `T_world_imu` of shape (3, 4), expected (4, 4)" in result.reason


def test_filter_of_raw_imu_samples_is_left_alone():
    class Raw(EkfSlam):
        motion = "imu"

    assert laws.run_twice(Raw).outcome == "skipped"


@pytest.mark.parametrize("name", ["slam", *CONSISTENT, "mapping-truth"])
@pytest.mark.parametrize("scene", list(SCENES))
def test_right_gate_refuses_as_often_as_told(name, scene):
    """False alarm 1e-4 for each of 16, over the choice of the stream."""
    result = gate.refuse_as_often_as_told(resolve(name), drive(scene))
    assert result.passed, str(result)


def test_gate_is_judged_without_a_batch_axis_as_with_one():
    one_by_one = gate.refuse_as_often_as_told(lambda task: Wrapped(EkfSlam(task)))
    assert one_by_one.reason == gate.refuse_as_often_as_told(EkfSlam).reason


@pytest.mark.parametrize("dof", [2, 3, 8])
def test_gate_of_wrong_degrees_of_freedom_is_found(dof):
    faulty = with_parts(gate=lambda d, p, _: d <= gate_threshold(p, dof))
    assert gate.refuse_as_often_as_told(faulty).failed


def test_gate_of_the_root_against_the_square_is_found():
    result = gate.refuse_as_often_as_told(
        with_parts(gate=lambda d, p, _: np.sqrt(d) <= gate_threshold(p, 4))
    )
    assert result.failed
    assert "no gate, or too wide a one" in result.reason


def test_gate_of_a_filter_that_takes_a_wrong_pose_for_true_is_not_judged():
    assert gate.refuse_as_often_as_told(Mapping).outcome == "skipped"
