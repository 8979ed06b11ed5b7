"""The structural checks pass what keeps the motions of the world, and say what loses them."""

from dataclasses import replace

import numpy as np
import pytest

from simbench.checks import jacobians, laws, rest, structure
from simbench.checks.chart import derivative, gauge
from simbench.checks.scenes import SCENES, drive
from simbench.checks.trace import Feed
from simbench.filters import resolve
from tests.simbench.checked import with_parts, without_covariance, wrapped
from vislam.filters import EkfSlam, model, slam_fej, slam_transport
from vislam.filters.consistent import FIRST_ESTIMATES, at_first_estimates, transport
from vislam.filters.records import Augment
from vislam.lie import se3, so3
from vislam.types import Belief

WHITE = [structure.null_space, structure.nullity]
KEPT = [
    *WHITE,
    structure.gauge_information,
    rest.rest_teaches_nothing,
    rest.a_step_teaches_nothing,
]


@pytest.fixture(autouse=True)
def few_sightings(monkeypatch):
    """Zhang's two hundred change nothing here but the time."""
    monkeypatch.setattr(rest, "SIGHTINGS", 20)


@pytest.mark.parametrize("check", KEPT, ids=lambda check: check.__name__)
@pytest.mark.parametrize(
    "name",
    ["slam-fej", "slam-transport", "slam-invariant", "slam-iterated", "slam-inverse-depth"],
)
def test_consistent_filter_passes(check, name):
    result = check(resolve(name))
    assert result.passed, str(result)


@pytest.mark.parametrize("check", [*KEPT[:3], jacobians.jacobians], ids=lambda c: c.__name__)
@pytest.mark.parametrize("scene", list(SCENES))
@pytest.mark.parametrize("factory", [slam_fej, slam_transport], ids=["fej", "transport"])
def test_consistent_filter_passes_on_every_scene(check, scene, factory):
    result = check(factory, drive(scene))
    assert result.passed, str(result)


@pytest.mark.parametrize("check", KEPT, ids=lambda check: check.__name__)
def test_the_paper_s_filter_fails_as_a_property_of_its_method(check):
    result = check(EkfSlam)
    assert result.failed, str(result)
    assert result.failure == "property of the method"


@pytest.mark.parametrize("scene", list(SCENES))
def test_the_paper_s_jacobians_are_right(scene):
    result = jacobians.jacobians(EkfSlam, drive(scene))
    assert result.passed, str(result)
    assert result.statistic < 1e-9


@pytest.mark.parametrize("check", [*KEPT, jacobians.jacobians], ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", ["dead-reckoning", "mapping", "mapping-truth"])
def test_filter_without_a_map_or_a_pose_is_passed_or_left_alone(check, name):
    assert not check(resolve(name)).failed


@pytest.mark.parametrize("check", KEPT, ids=lambda check: check.__name__)
def test_black_box_without_covariance_is_left_alone(check):
    assert check(wrapped(slam_fej, belief=without_covariance)).outcome == "skipped"


@pytest.mark.parametrize("check", KEPT[2:], ids=lambda check: check.__name__)
def test_black_box_is_judged_by_what_it_states(check):
    assert check(wrapped(slam_fej)).passed
    assert check(wrapped(slam_transport)).passed
    assert check(wrapped(EkfSlam)).failure == "property of the method"


class FirstEstimatesInHAlone(EkfSlam):
    """H and G at first estimates, F from the posterior pose."""

    def __init__(self, task):
        super().__init__(task, FIRST_ESTIMATES)

    def predict(self, motion, dt):
        self.x.T_first = self.x.T
        super().predict(motion, dt)


def born_at_two_poses(calibration, noise, T, T_linear, pixels):
    """G at the predicted pose, of a point as seen from the updated one."""
    landmarks, _, R = model.inverse_observation(calibration, noise, T, T_linear, pixels)
    G = T_linear[..., None, :3, :3] @ se3.odot(model.triangulated(calibration, pixels))
    return landmarks, G, R


def wrong_sign(T, T_next):
    return np.linalg.inv(model.transition(T, T_next))


def without_lever_arm(calibration, T, landmarks):
    _, H_map = model.observation_jacobians(calibration, T, landmarks)
    s = model.to_imu(T, landmarks) - calibration.T_imu_cam[:3, 3]
    return -(H_map @ T[..., None, :3, :3]) @ se3.odot(s), H_map


def map_left_behind(*estimates):
    return replace(record := transport(*estimates), M=np.zeros_like(record.M))


FAULTS = {
    "first estimates in H alone": FirstEstimatesInHAlone,
    "first estimates in F alone": with_parts(
        linearise=lambda x: (x.T_first, x.landmarks),
    ),
    "born at two poses": with_parts(linearise=at_first_estimates, birth=born_at_two_poses),
    "F of the wrong sign": with_parts(linearise=at_first_estimates, transition=wrong_sign),
    "no lever arm": with_parts(transport=transport, observation_jacobians=without_lever_arm),
    "map left behind": with_parts(transport=map_left_behind),
}


@pytest.mark.parametrize("check", WHITE, ids=lambda check: check.__name__)
@pytest.mark.parametrize("fault", FAULTS)
def test_planted_fault_is_a_mistake(check, fault):
    result = check(FAULTS[fault])
    assert result.failed, str(result)
    assert result.failure == "mistake", str(result)


@pytest.mark.parametrize("fault", FAULTS)
def test_planted_fault_is_seen_from_outside_too(fault):
    assert structure.gauge_information(wrapped(FAULTS[fault])).failed


def test_lost_cross_covariance_is_a_mistake_even_from_outside():
    class Uncorrelated(EkfSlam):
        def predict(self, motion, dt):
            super().predict(motion, dt)
            self.P[:6, 6:] = self.P[6:, :6] = 0

    result = structure.gauge_information(wrapped(Uncorrelated))
    assert result.failure == "mistake"


def without_division_by_depth(calibration, T, landmarks):
    depth = model.to_cam(calibration, model.to_imu(T, landmarks))[..., 2, None, None]
    H_pose, H_map = model.observation_jacobians(calibration, T, landmarks)
    return H_pose, H_map * depth


def born_in_the_imu_frame(calibration, noise, T, T_linear, pixels):
    landmarks, G, R = model.inverse_observation(calibration, noise, T, T_linear, pixels)
    return landmarks, so3.inverse(T_linear[..., None, :3, :3]) @ G, R


@pytest.mark.parametrize(
    ("parts", "block"),
    [
        ({"transition": wrong_sign}, "predict 0: F of the pose by the translation"),
        ({"observation_jacobians": without_lever_arm}, "update 1: H by the rotation"),
        ({"observation_jacobians": without_division_by_depth}, "update 1: H by the landmarks"),
        ({"birth": born_in_the_imu_frame}, "update 0: G by the translation"),
    ],
)
def test_wrong_block_is_named(parts, block):
    result = jacobians.jacobians(with_parts(**parts))
    assert result.failed
    assert result.reason.startswith(block)


@pytest.mark.parametrize("scene", list(SCENES))
@pytest.mark.parametrize("name", ["slam", "slam-constant-prior", "slam-fej", "slam-transport"])
def test_covariance_follows_the_records(name, scene):
    result = jacobians.follow_the_records(resolve(name), drive(scene))
    assert result.passed, str(result)


def test_covariance_that_does_not_follow_the_records_is_found():
    class Uncorrelated(EkfSlam):
        def update(self, frame):
            innovation = super().update(frame)
            self.P[:6, 6:] = self.P[6:, :6] = 0
            return innovation

    result = jacobians.follow_the_records(Uncorrelated)
    assert result.failed
    assert result.reason.startswith("update 0")
    assert jacobians.follow_the_records(wrapped(EkfSlam)).outcome == "skipped"


def test_gauge_is_the_known_basis_of_the_paper_s_chart():
    """N = [R^T, -R^T p^; 0, R^T; I, -f^] in (rho, phi, f), for motions about the origin."""
    T, f = se3.exp(np.array([3.0, -2.0, 1.0, 0.4, -0.9, 1.2])), np.array([[4.0, 5.0, -6.0]])
    R, p = T[:3, :3], T[:3, 3]
    belief = Belief(T_world_imu=T, pose_covariance=np.eye(6), ids=np.array([7]), landmarks=f)
    expected = np.block(
        [
            [R.T, -R.T @ so3.hat(p)],
            [np.zeros((3, 3)), R.T],
            [np.eye(3), -so3.hat(f[0])],
        ]
    )
    np.testing.assert_allclose(gauge(belief, np.zeros(3)), expected, atol=1e-10)


def test_derivative_is_of_fourth_order():
    point = np.array([0.3, -0.2])

    def function(d):
        x, y = np.moveaxis(point + d, -1, 0)
        return np.stack([np.sin(x) * y, np.exp(x + 2 * y), x * y**2], axis=-1)

    (x, y), e = point, np.exp(point @ [1, 2])
    expected = [[np.cos(x) * y, np.sin(x)], [e, 2 * e], [y**2, 2 * x * y]]
    np.testing.assert_allclose(derivative(function, 2), expected, atol=1e-11)


class SeesEachLandmarkOnce(EkfSlam):
    def update(self, frame):
        new = ~np.isin(frame.ids, self.ids)
        return super().update(
            replace(frame, ids=frame.ids[new], pixels=frame.pixels[new], last=frame.last[new])
        )


@pytest.mark.parametrize("check", WHITE, ids=lambda check: check.__name__)
def test_filter_that_never_updates_is_not_praised_for_what_it_does_not_learn(check):
    assert check(SeesEachLandmarkOnce).outcome == "skipped"


class HidesBirths(EkfSlam):
    def update(self, frame):
        innovation = super().update(frame)
        self.records[:] = [r for r in self.records or [] if not isinstance(r, Augment)]
        return innovation


@pytest.mark.parametrize("check", [*WHITE, jacobians.jacobians], ids=lambda check: check.__name__)
def test_records_that_do_not_fit_the_belief_are_not_judged(check):
    result = check(HidesBirths)
    assert result.outcome == "skipped"
    assert "not of the landmarks" in result.reason


def in_left_chart(belief):
    """The same belief, its pose error on the other side: xi_left = Ad_T xi_right."""
    B = np.eye(6 + 3 * len(belief.ids))
    B[:6, :6] = se3.adjoint(belief.T_world_imu)
    P = belief.joint_covariance
    return replace(
        belief,
        chart="left",
        pose_covariance=B[:6, :6] @ belief.pose_covariance @ B[:6, :6].T,
        joint_covariance=None if P is None else B @ P @ B.T,
    )


@pytest.mark.parametrize(
    "check", [*KEPT[2:], laws.move_the_world, laws.divide_the_frame], ids=lambda c: c.__name__
)
def test_chart_of_the_belief_does_not_matter(check):
    """Of a filter whose linearisation point is its estimate, where the charts meet."""
    assert check(wrapped(slam_transport, belief=in_left_chart)).passed


def test_covariance_in_another_chart_than_stated_is_found():
    wrong = wrapped(
        slam_transport, belief=lambda belief: replace(in_left_chart(belief), chart="right")
    )
    assert structure.gauge_information(wrong).failed
    assert laws.move_the_world(wrong).failed


def test_two_draws_of_a_feed_differ_and_one_is_the_same_again():
    first, again, other = Feed.of(None), Feed.of(None), Feed.of(None, draw=1)
    assert np.array_equal(first.steps[0].pixels, again.steps[0].pixels)
    assert not np.array_equal(first.steps[0].pixels, other.steps[0].pixels)


def indefinite(negative):
    """A filter at rest that learns nothing, and whose covariance loses its sign in a call."""

    def change(belief):
        if not len(belief.ids):
            return belief
        P = belief.pose_covariance * np.where(np.arange(6) < negative, -1.0, 1.0)
        P = np.diag(np.diag(P))
        return replace(belief, pose_covariance=P, joint_covariance=None)

    return wrapped(slam_fej, belief=change)


@pytest.mark.parametrize("negative", [1, 2])
def test_covariance_that_is_indefinite_does_not_pass_at_rest(negative):
    result = rest.rest_teaches_nothing(indefinite(negative))
    assert result.failed
    assert "left its covariance indefinite" in result.reason
    result = rest.a_step_teaches_nothing(indefinite(negative))
    assert result.failed
    assert "covariance is indefinite at the end" in result.reason


def test_a_pose_that_moves_at_rest_is_told_in_metres_and_degrees():
    def pushed(belief):
        if not len(belief.ids):
            return belief
        T = belief.T_world_imu @ se3.exp(np.array([0.25, 0, 0, 0, 0, 0]))
        return replace(belief, T_world_imu=T)

    reason = rest.rest_teaches_nothing(wrapped(slam_fej, belief=pushed)).reason
    metres, degrees = reason.split("moved the pose by up to ")[1].split(" m and ")
    assert float(metres) == 0.25
    assert float(degrees.split(" degrees")[0]) < 1e-6
