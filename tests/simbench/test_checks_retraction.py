"""A retraction that is wrong beyond first order, which an audit cannot see, is seen without chance.

Likewise the noise map N and the landmark blocks D of a `Linear`: who sees a fault in which.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from simbench.bugs import PARTS, mutant
from simbench.checks import jacobians, known, structure
from simbench.checks.audit import audit_drive
from simbench.checks.scenes import SCENES, drive
from simbench.filters import FILTERS, resolve
from simbench.metrics import nees
from simbench.run import RunOptions, run
from simbench.scenario import load
from simbench.sensors import simulate
from tests.simbench.checked import without_covariance, wrapped
from tests.vislam.drives import in_parts_of
from vislam.filters import EkfSlam, consistent, invariant, inverse_depth
from vislam.lie import se3

CHECKS = [known.keep_the_known_map, jacobians.move_by_the_correction]
each_check = pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
WRONG = mutant("slam+landmarks-moved-with-the-pose")


@each_check
@pytest.mark.parametrize("name", FILTERS)
def test_no_right_filter_fails_on_any_scene(check, name):
    for scene in SCENES:
        result = check(resolve(name), drive(scene))
        assert not result.failed, str(result)
        assert result.passed or name not in PARTS


@pytest.mark.parametrize("name", PARTS)
def test_right_filters_leave_a_known_map_alone_by_four_orders_of_magnitude(name):
    assert known.keep_the_known_map(resolve(name)).statistic < 1e-4 * known.LIMIT_M


@pytest.mark.parametrize("scene", SCENES)
@each_check
def test_landmarks_that_move_with_the_pose_are_seen_on_every_scene(check, scene):
    result = check(WRONG, drive(scene))
    assert result.failure == "mistake", str(result)
    assert result.statistic > 10 * result.limit


@pytest.mark.slow
def test_landmarks_that_move_with_the_pose_are_far_off_where_a_loop_closes():
    """Two laps, heading noise 0.5 degrees a step: the pose's NEES at the end of each of five runs.

    Over 6 it was 80 to 172 in each of 20 runs, so a single run sees it (power above 0.83 at 95 %);
    the right filter passes 5.5 with a probability of 1e-5 a run.
    """
    scenario = load(
        Path(__file__).parents[2] / "scenarios" / "two_laps.yaml",
        ("imu.angular_velocity.sigma=[0.002, 0.002, 0.0436]",),
    )
    limit = chi2(6).isf(1e-5)
    for number in range(5):
        dataset = simulate(scenario, run=number)
        for factory, wrong in ((WRONG, True), (resolve("slam-invariant"), False)):
            record = run(dataset, factory, options=RunOptions(memory_bytes=0))
            at_end = nees(record.pose_errors[-1:], record.pose_covariances[-1:])[0]
            assert (at_end > limit) == wrong


def test_a_known_map_that_moves_is_seen_from_outside():
    result = known.keep_the_known_map(wrapped(WRONG, belief=without_covariance))
    assert result.failed
    assert "that is known to a micrometre" in result.reason


def test_a_filter_that_takes_no_map_is_left_alone():
    def without_map(task):
        prior = task.prior
        none = {"ids": prior.ids[:0], "landmarks": prior.landmarks[:0]}
        none |= {"landmark_covariances": np.empty((0, 3, 3)), "joint_covariance": None}
        return EkfSlam(replace(task, prior=replace(prior, **none)))

    assert known.keep_the_known_map(without_map).outcome == "skipped"


def test_an_update_on_another_side_than_the_belief_says_is_seen():
    result = jacobians.move_by_the_correction(mutant("slam+left-retraction"))
    assert result.failure == "mistake"


def test_an_update_by_parts_is_one_move():
    at_once = jacobians.move_by_the_correction(resolve("slam"))
    with in_parts_of(1):
        by_parts = jacobians.move_by_the_correction(resolve("slam"))
        wrong = jacobians.move_by_the_correction(WRONG)
    assert at_once.passed
    assert by_parts.passed
    assert by_parts.reason == at_once.reason
    assert wrong.failure == "mistake"


@pytest.mark.parametrize("bug", ["fused-twice", "birth-fused-again"])
def test_updates_of_more_than_one_move_are_not_judged(bug):
    assert not jacobians.move_by_the_correction(mutant(f"slam+{bug}")).failed


def blocks(change):
    """D changed, and M with it so that the motions of the world still keep their directions."""

    def transport(x, T, landmarks):
        record = inverse_depth.transport(x, T, landmarks)
        D = change(record.D)
        M = (se3.odot(landmarks) - D @ se3.odot(x.landmarks)) @ se3.adjoint(x.T)[..., None, :, :]
        return replace(record, D=D, M=M.reshape(record.M.shape))

    return transport


D_FAULTS = {
    "the wrong way round": blocks(np.linalg.inv),
    "half of it": blocks(lambda D: (D + np.eye(3)) / 2),
    "none": consistent.transport,
}


@pytest.mark.parametrize("fault", D_FAULTS)
def test_blocks_that_are_not_the_retractions_are_seen_by_the_move_alone(fault):
    """To first order D is one, and it keeps the null space as long as M goes with it."""
    parts = replace(consistent.INVERSE_DEPTH, transport=D_FAULTS[fault])
    factory = partial(EkfSlam, parts=parts)
    assert audit_drive(factory, drive("births")).passed
    for check in (
        structure.null_space,
        structure.nullity,
        structure.gauge_information,
        jacobians.jacobians,
        jacobians.follow_the_records,
    ):
        assert check(factory).passed
    assert jacobians.move_by_the_correction(factory).failure == "mistake"


def without_M(x, T, landmarks):
    return replace(inverse_depth.transport(x, T, landmarks), M=None)


def of_another_D(x, T, landmarks):
    record = inverse_depth.transport(x, T, landmarks)
    return replace(record, D=np.linalg.inv(record.D))


@pytest.mark.parametrize("transport", [without_M, of_another_D])
def test_blocks_that_M_does_not_go_with_lose_the_null_space_at_the_filters_own_estimates(transport):
    parts = replace(consistent.INVERSE_DEPTH, transport=transport)
    result = structure.null_space(partial(EkfSlam, parts=parts))
    assert result.failure == "mistake"
    assert "transports a motion of the world" in result.reason


class NoiseOfThePoseAlone(EkfSlam):
    """N without the rows of the landmarks, whose errors turn with the pose's."""

    def __init__(self, task):
        super().__init__(task, invariant.RIGHT_INVARIANT)

    def predict(self, motion, dt):
        parts = self.parts

        def of_pose(T, landmarks):
            N = invariant.from_right(T, landmarks)
            N[..., 6:, :] = 0
            return N

        self.parts = replace(parts, from_right=of_pose)
        super().predict(motion, dt)
        self.parts = parts


def test_noise_that_does_not_reach_the_landmarks_is_seen_by_the_audit():
    """The structure has nothing to say of noise; a known map moves, for it is no longer known."""
    result = audit_drive(NoiseOfThePoseAlone, drive("births"))
    assert str(result.first).startswith("predict 0: landmark covariance (age 1)")
    for check in (structure.null_space, structure.nullity, jacobians.jacobians):
        assert check(NoiseOfThePoseAlone).passed
    assert known.keep_the_known_map(NoiseOfThePoseAlone).failed
