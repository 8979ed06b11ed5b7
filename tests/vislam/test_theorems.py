"""What a consistent filter cannot learn, however often it looks: no chance, for any noise.

Source: Zhang, Wu, Song, Huang, Dissanayake, Convergence and consistency analysis for a 3-D
invariant-EKF SLAM, RA-L 2(2), 2017, theorems 2 to 4.
"""

import numpy as np
import pytest

from simbench.filters import resolve
from simbench.rng import stream
from vislam.lie import se3, so3
from vislam.point import PointSensor
from vislam.types import Belief, Calibration, Noise, PointFrame, Task, Twist

#: Filters of which the theorems hold.
CONSISTENT = [
    "slam-fej",
    "slam-inverse-depth",
    "slam-invariant",
    "slam-iterated",
    "slam-transport",
]
START = se3.exp(np.array([3.0, -2.0, 1.0, 0.4, -0.3, 2.0]))
PRIOR = np.diag([0.01, 0.01, 0.01, 0.5, 0.5, 0.5])
CALIBRATION = Calibration(rig=PointSensor(range_m=(0.0, 50.0)), T_imu_cam=np.eye(4))
SHARE, FLOOR_M = 0.05, 0.01


def started(name):
    noise = Noise(
        process_model="twist",
        process=1e-4 * np.eye(6),
        point_share=SHARE,
        point_floor_m=FLOOR_M,
    )
    prior = Belief(T_world_imu=START, pose_covariance=PRIOR)
    return resolve(name)(Task(calibration=CALIBRATION, noise=noise, prior=prior))


def look(filter_, points, times, rng):
    """Feed noisy readings of points in the sensor's frame."""
    for _ in range(times):
        sigma = np.maximum(SHARE * np.abs(points), FLOOR_M)
        seen = points + sigma * rng.standard_normal(points.shape)
        none = np.zeros(len(points), bool)
        filter_.update(PointFrame(time_s=0.0, ids=np.arange(len(points)), points=seen, last=none))


def rest(name):
    """Look 100 times at one new landmark without moving."""
    filter_ = started(name)
    look(filter_, np.array([[4.0, 3.0, 2.0]]), 100, stream(0, 0, "rest"))
    return filter_.belief()


def one_step(name):
    """Log det of the pose covariance: 200 looks at ten landmarks, a step, and 200 more."""
    filter_, rng = started(name), stream(0, 0, "step")
    points = np.column_stack([rng.uniform(2, 8, 10), rng.uniform(-5, 5, (10, 2))])
    u = np.array([1.0, 0.2, 0.0, 0.0, 0.05, 0.3])
    look(filter_, points, 200, rng)
    filter_.predict(Twist(time_s=0.0, linear=u[:3], angular=u[3:]), 1.0)
    look(filter_, se3.apply(se3.exp(-u), points), 200, rng)
    return np.linalg.slogdet(filter_.belief().pose_covariance)[1]


@pytest.mark.parametrize("name", CONSISTENT)
def test_at_rest_a_new_landmark_tells_nothing_of_the_pose(name):
    belief = rest(name)
    assert np.abs(belief.T_world_imu - START).max() < 1e-9
    assert np.linalg.det(belief.pose_covariance[3:, 3:]) == pytest.approx(0.125, rel=1e-9)


@pytest.mark.parametrize("name", ["slam"])
def test_at_rest_other_filters_turn_and_grow_sure_of_it(name):
    belief = rest(name)
    turned = so3.log(START[:3, :3].T @ belief.T_world_imu[:3, :3])
    assert np.rad2deg(np.linalg.norm(turned)) > 1
    assert np.linalg.det(belief.pose_covariance[3:, 3:]) < 0.125 / 5


@pytest.mark.parametrize("name", CONSISTENT)
def test_ten_new_landmarks_and_a_step_tell_nothing_of_where_the_world_lies(name):
    assert one_step(name) >= np.linalg.slogdet(PRIOR)[1]


@pytest.mark.parametrize("name", ["slam"])
def test_other_filters_find_out_where_the_world_lies(name):
    assert one_step(name) < np.linalg.slogdet(PRIOR)[1] - 10
