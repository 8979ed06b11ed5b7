"""What passes between a filter and the world says what it means."""

from dataclasses import FrozenInstanceError, fields, is_dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import vislam.types
from vislam.lie import se3
from vislam.types import Belief, Innovation, Noise, State, Twist

TRUTH = State(
    T_world_imu=se3.random(np.random.default_rng(0)),
    ids=np.array([2, 3, 5, 11]),
    landmarks=np.arange(12.0).reshape(4, 3),
)


def belief(ids, **changes):
    """A belief whose landmark errors are (id, 0, 0)."""
    ids = np.array(ids, np.int64)
    true = TRUTH.landmarks[[list(TRUTH.ids).index(j) for j in ids]].reshape(-1, 3)
    estimate = Belief(
        T_world_imu=TRUTH.T_world_imu @ se3.exp(np.full(6, -0.1)),
        pose_covariance=np.eye(6),
        ids=ids,
        landmarks=true - np.outer(ids, [1, 0, 0]),
    )
    return replace(estimate, **changes)


@pytest.mark.parametrize("ids", [[], [2], [11], [3, 11], [11, 2, 5], [2, 3, 5, 11]])
def test_error_takes_the_landmarks_by_id_in_the_belief_s_order(ids):
    e = belief(ids).error(TRUTH)
    assert_allclose(e[:6], np.full(6, 0.1), rtol=1e-12)
    assert_allclose(e[6:].reshape(-1, 3), np.outer(ids, [1, 0, 0]).reshape(-1, 3), atol=1e-14)


@pytest.mark.parametrize("ids", [[4], [1, 2], [2, 99], [12], [0]])
def test_landmark_that_the_truth_lacks_is_named(ids):
    estimate = replace(belief([]), ids=np.array(ids), landmarks=np.zeros((len(ids), 3)))
    lacking = sorted(set(ids) - {2, 3, 5, 11})
    with pytest.raises(KeyError, match=rf"truth lacks landmarks \[{lacking[0]}\]"):
        estimate.error(TRUTH)


def test_truth_without_a_map_lacks_every_landmark():
    bare = replace(TRUTH, ids=np.empty(0, np.int64), landmarks=np.empty((0, 3)))
    with pytest.raises(KeyError, match=r"truth lacks landmarks \[2, 3\]"):
        belief([2, 3]).error(bare)
    assert belief([]).error(bare).shape == (6,)


def test_error_leaves_out_a_pose_that_is_not_estimated():
    e = belief([3, 5], pose_covariance=None).error(TRUTH)
    assert_allclose(e, [3, 0, 0, 5, 0, 0], atol=1e-14)


def test_error_is_measured_in_the_belief_s_own_chart():
    right, left = (belief([3], chart=chart) for chart in ("right", "left"))
    moved = se3.adjoint(right.T_world_imu) @ right.error(TRUTH)[:6]
    assert_allclose(left.error(TRUTH)[:6], moved, rtol=1e-12)
    assert_allclose(left.pose_error(TRUTH.T_world_imu), moved, rtol=1e-12)
    assert_allclose(left.error(TRUTH)[6:], right.error(TRUTH)[6:])

    def own(*state_and_truth):
        return np.arange(6.0 + state_and_truth[3].size)

    assert_array_equal(belief([3], chart=own).error(TRUTH), np.arange(9.0))
    assert_array_equal(belief([3], chart=own).pose_error(TRUTH.T_world_imu), np.arange(6.0))


def test_unknown_chart_is_an_error():
    with pytest.raises(KeyError, match="middle"):
        belief([3], chart="middle").error(TRUTH)


def test_pose_error_is_the_error_s_first_part_with_or_without_covariance():
    for covariance in (np.eye(6), None):
        estimate = belief([2, 5], pose_covariance=covariance)
        assert_allclose(estimate.pose_error(TRUTH.T_world_imu), np.full(6, 0.1), rtol=1e-12)


def test_errors_take_a_batch_on_either_side():
    estimate = belief([2, 5])
    poses = TRUTH.T_world_imu @ se3.exp(np.outer([0.0, 0.1, 0.2], np.ones(6)))
    expected = np.outer([0.1, 0.2, 0.3], np.ones(6))
    assert_allclose(estimate.pose_error(poses), expected, rtol=1e-12)
    batch = State(T_world_imu=poses, ids=TRUTH.ids, landmarks=np.stack([TRUTH.landmarks] * 3))
    assert_allclose(estimate.error(batch)[:, :6], expected, rtol=1e-12)
    assert estimate.error(batch).shape == (3, 12)

    many = replace(
        estimate,
        T_world_imu=np.stack([estimate.T_world_imu] * 2),
        landmarks=np.stack([estimate.landmarks] * 2),
    )
    assert_allclose(many.pose_error(TRUTH.T_world_imu), expected[[0, 0]], rtol=1e-12)
    assert_allclose(many.error(TRUTH), np.stack([estimate.error(TRUTH)] * 2))


def test_twist_stacks_linear_before_angular():
    twist = Twist(time_s=0.0, linear=np.array([[1, 2, 3.0]]), angular=np.array([[4, 5, 6.0]]))
    assert_array_equal(twist.vector, [[1, 2, 3, 4, 5, 6]])


def test_innovation_counts_only_what_was_accepted():
    accepted = np.array([[True, False, True], [False, False, False]])
    whitened = np.where(accepted[..., None], 2.0, 0.0) * np.ones(4)
    innovation = Innovation(
        ids=np.arange(3), residual=np.ones((2, 3, 4)), whitened=whitened, accepted=accepted
    )
    assert_array_equal(innovation.nis, [32, 0])
    assert_array_equal(innovation.dof, [8, 0])
    assert_array_equal(innovation.rejected, [1, 3])
    alone = replace(innovation, whitened=whitened[0], accepted=accepted[0])
    assert (alone.nis, alone.dof, alone.rejected) == (32, 8, 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"process_model": "twsit"}, "Expected `process_model` to be one of .*got 'twsit'"),
        ({"process": np.eye(3)}, r"Expected `process` of shape \(6, 6\), got \(3, 3\)"),
        ({"process": 1.0}, r"Expected `process` of shape \(6, 6\), got \(\)"),
        ({"sigma_px": np.ones(3)}, "Expected four positive `sigma_px`"),
        ({"sigma_px": 1.0}, "Expected four positive `sigma_px`, got 1.0"),
        ({"sigma_px": np.array([1, 1, 0, 1])}, "Expected four positive `sigma_px`"),
        ({"sigma_px": np.array([1, 1, -2, 1])}, "Expected four positive `sigma_px`"),
        ({"sigma_px": np.array([1, 1, np.nan, 1])}, "Expected four positive `sigma_px`"),
    ],
)
def test_what_is_no_noise_is_refused(changes, message):
    usable = {"process_model": "twist", "process": np.eye(6), "sigma_px": np.ones(4)}
    Noise(**usable)
    with pytest.raises(ValueError, match=message):
        Noise(**(usable | changes))


def test_types_are_frozen_and_take_keywords_only():
    with pytest.raises(FrozenInstanceError):
        TRUTH.ids = np.arange(4)
    with pytest.raises(TypeError):
        Twist(0.0, np.zeros(3), np.zeros(3))
    with pytest.raises((AttributeError, TypeError)):
        object.__setattr__(TRUTH, "more", 1)


def test_defaults_are_not_shared():
    first, second = Belief(T_world_imu=np.eye(4)), Belief(T_world_imu=np.eye(4))
    assert first.ids is not second.ids
    assert (first.ids.shape, first.landmarks.shape) == ((0,), (0, 3))
    assert first.landmark_covariances.shape == (0, 3, 3)


def test_every_field_is_described_in_the_docstring_of_its_class():
    kinds = [kind for kind in vars(vislam.types).values() if is_dataclass(kind)]
    assert len(kinds) > 10
    for kind in kinds:
        documented = "".join(each.__doc__ for each in kind.__mro__)
        for field in fields(kind):
            assert f"{field.name}:" in documented, f"{kind.__name__}.{field.name}"
