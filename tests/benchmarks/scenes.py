"""What the benchmarks of one frame look at."""

import numpy as np

from simbench.sensors import seen_from
from vislam.camera import StereoRig
from vislam.lie import se3
from vislam.types import Belief, Calibration, Noise, StereoFrame, Task, Twist

RIG = StereoRig(
    fx_px=552.554,
    fy_px=552.554,
    cx_px=682.049,
    cy_px=238.77,
    baseline_m=0.6,
    image_px=(1242, 376),
)
R_IMU_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
CALIBRATION = Calibration(
    rig=RIG, T_imu_cam=se3.from_rotation_translation(R_IMU_CAM, np.array([1.1, -0.3, 0.7]))
)
NOISE = Noise(
    process_model="twist",
    process=np.diag(np.square([0.2] * 3 + [0.02] * 3)),
    sigma_px=np.full(4, 0.7),
)
STILL = Twist(time_s=0.0, linear=np.zeros(3), angular=np.zeros(3))


def task(**told) -> Task:
    """A filter at the origin, with the gate that real drives need."""
    prior = Belief(T_world_imu=np.eye(4), pose_covariance=1e-4 * np.eye(6))
    return Task(calibration=CALIBRATION, noise=NOISE, prior=prior, gate=0.999, **told)


def frame(landmarks: int, time_s: float = 0.0) -> StereoFrame:
    """Landmarks before the camera of a filter at the origin, each to be seen again."""
    rng = np.random.default_rng(landmarks)
    depth = rng.uniform(5, 20, landmarks)
    across = rng.uniform(-0.2, 0.3, (landmarks, 2)) * depth[:, None]
    p_imu = np.column_stack([depth, across]) + CALIBRATION.T_imu_cam[:3, 3]
    noise = np.random.default_rng(round(1e3 * time_s) + 1).standard_normal((landmarks, 4))
    return StereoFrame(
        time_s=time_s,
        ids=np.arange(landmarks),
        pixels=seen_from(CALIBRATION, p_imu) + 0.7 * noise,
        last=np.zeros(landmarks, bool),
    )
