"""Zhang's two theorems: what a robot at rest learns of its own pose, which is nothing.

Landmarks that it finds itself tell a robot where they are, and never where it is. So while it
stands, its pose and the covariance of its pose may not change, however often it looks; and after a
step the covariance's determinant may not have fallen below what it was at the start. Both hold
exactly, at any noise, for a filter that keeps the unobservable directions; so they are tests
without chance. The source has sightings of relative positions, here they are stereo sightings.

Source: Zhang, Wu, Song, Huang, Dissanayake, Convergence and consistency analysis for a 3-D
invariant-EKF SLAM, IEEE RA-L 2(2), 2017, theorems 1 and 2.
"""

import numpy as np

from simbench.checks.result import (
    MISTAKE,
    PROPERTY,
    CheckResult,
    FailureKind,
    NotApplicable,
    check,
    judged,
)
from simbench.checks.short_drive import ShortDrive
from simbench.checks.trace import Call, Feed, trace
from simbench.rng import stream
from simbench.sensors.camera import camera_matrices, projected
from vislam.arrays import Array
from vislam.camera import StereoRig
from vislam.filters import Factory
from vislam.lie import se3
from vislam.types import Belief, Calibration, Noise, StereoFrame, Task, Twist

#: The covariance of the rotation is half the identity: the robot hardly knows where it looks.
P_START = np.diag([0.01, 0.01, 0.01, 0.5, 0.5, 0.5])
#: What rounding may do in so many sightings, metres, radians, and of the log of a determinant.
ROUNDING = 1e-6
#: Far from the origin, at a large angle.
START = np.array([120.0, -80.0, 15.0, 0.4, -0.5, 2.4])
SIGHTINGS = 200
#: About 5 % of the depth at 8 m.
SIGMA_PX = 2.0
#: Forward and to the left, by half a metre and 6 degrees.
STEP = np.array([0.5, 0.1, 0.0, 0.0, 0.02, 0.1])
CALIBRATION = Calibration(
    rig=StereoRig(fx_px=552, fy_px=552, cx_px=620, cy_px=600, baseline_m=0.6),
    T_imu_cam=se3.from_rotation_translation(
        np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([1.1, -0.3, 0.7])
    ),
)


@check
def rest_teaches_nothing(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:  # noqa: ARG001
    """At rest, one new landmark, many sightings: pose and covariance of the pose stay."""
    learned = _learned(trace(factory, _feed(1, steps=0)))[:3]
    went_m, turned_rad, gained = learned
    return judged(
        float(learned.max()),
        ROUNDING,
        good=f"pose and covariance of the pose are as they were after {SIGHTINGS} sightings",
        bad=f"{SIGHTINGS} sightings of one landmark at rest moved the pose by up to {went_m:.2g} m "
        f"and {np.degrees(turned_rad):.2g} degrees, and "
        + (
            "left its covariance indefinite"
            if np.isnan(gained)
            else f"changed the log of the determinant of its covariance by {gained:.2g}"
        ),
        failure=lambda: _kind(_learned(trace(factory, _feed(1, steps=0, noise=0.0)))[:3].max()),
    )


@check
def a_step_teaches_nothing(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:  # noqa: ARG001
    """Ten landmarks, 200 sightings, a step, 200 more: the pose is not surer than at the start."""
    lost = float(_learned(trace(factory, _feed(10, steps=1)))[-1])
    return judged(
        lost,
        ROUNDING,
        good="the determinant of the pose's covariance does not fall below its start",
        bad="the pose's covariance is indefinite at the end"
        if np.isnan(lost)
        else f"the log of the determinant of the pose's covariance fell {lost:.3g} below its start",
        failure=lambda: _kind(_learned(trace(factory, _feed(10, steps=1, noise=0.0)))[-1]),
    )


def _kind(without_noise: float) -> FailureKind:
    """Where all estimates are the truth, it does not matter at which a method linearises."""
    return PROPERTY if without_noise <= ROUNDING else MISTAKE


def _feed(landmarks: int, *, steps: int, noise: float = 1.0) -> Feed:
    """Sightings at rest, then after each step again; without a step, without process noise."""
    rng = stream(0, 0, "checks.rest", landmarks)
    T = se3.exp(START)
    poses = [T]
    p_cam = np.stack(
        [rng.uniform(a, b, landmarks) for a, b in ((-2, 2), (-1.5, 1.5), (5, 8))], axis=-1
    )
    points = se3.apply(T @ CALIBRATION.T_imu_cam, p_cam)
    matrices = camera_matrices(CALIBRATION.stereo, CALIBRATION.T_imu_cam)
    ids = np.arange(landmarks)
    sequence: list[StereoFrame | tuple[Twist, float]] = []
    for k in range(SIGHTINGS * (steps + 1)):
        time_s = 0.1 * k
        if k:
            u = STEP / 0.1 if k % SIGHTINGS == 0 else np.zeros(6)
            T = T @ se3.exp(0.1 * u)
            poses.append(T)
            sequence.append((Twist(time_s=time_s - 0.1, linear=u[:3], angular=u[3:]), 0.1))
        exact, _ = projected(matrices, se3.apply(se3.inverse(T), points))
        pixels = exact + noise * SIGMA_PX * rng.standard_normal(exact.shape)
        last = np.zeros(landmarks, bool)
        sequence.append(StereoFrame(time_s=time_s, ids=ids, pixels=pixels, last=last))
    process = np.diag(np.repeat([0.05, 0.02], 3) ** 2) if steps else np.zeros((6, 6))
    task = Task(
        calibration=CALIBRATION,
        noise=Noise(process_model="twist", process=process, sigma_px=np.full(4, SIGMA_PX)),
        prior=Belief(
            T_world_imu=poses[0],
            pose_covariance=P_START,
        ),
        trajectory=np.stack(poses),
    )
    return Feed(task=task, steps=tuple(sequence))


def _learned(calls: tuple[Call, ...]) -> Array:
    """How far the pose went, m, and turned, rad; how far its log-determinant went, and fell.

    Of the pose's covariance, that is. NaN, which `max` of an array keeps, where that is none.
    """
    start = calls[0].belief
    if start.pose_covariance is None:
        raise NotApplicable("the filter does not estimate the pose")
    moved = np.abs([call.belief.pose_error(start.T_world_imu) for call in calls])
    dets = np.array([_log_det(call.belief.pose_covariance) for call in calls])
    changed = np.abs(dets - dets[0])
    return np.array([moved[:, :3].max(), moved[:, 3:].max(), changed.max(), dets[0] - dets[-1]])


def _log_det(P: Array | None) -> float:
    """NaN, which no check lets pass, where P is no covariance."""
    if P is None or np.linalg.eigvalsh(P)[0] <= 0:
        return float("nan")
    return float(np.linalg.slogdet(P)[1])
