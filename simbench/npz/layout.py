"""What a file of the format holds: every key with its shape.

A number is a fixed length; a letter is one that must agree over the file: T frames, M landmarks,
N raw inertial samples.
"""

import math

import numpy as np

from vislam.arrays import Array
from vislam.types import ProcessModel

#: The format's own keys.
FORMAT = {
    "time_stamps": "1 T",  # s
    "linear_velocity": "3 T",  # m/s, IMU frame
    "angular_velocity": "3 T",  # rad/s, IMU frame; `rotational_velocity` until 2020
    "K": "3 3",  # px
    "b": "",  # m
    "imu_T_cam": "4 4",  # m; `cam_T_imu` until 2020
}
#: uL, vL, uR, vR in pixels, all -1 where a landmark is not seen. Too large to be read whole.
FEATURES = "4 M T"

#: What other dialects call a key.
FORMER_NAMES = {"angular_velocity": "rotational_velocity", "imu_T_cam": "cam_T_imu"}

#: The keys of the pickled dict of 2025, beside `features`.
FORMAT_2025 = {
    "timestamps": "T",
    "v_t": "T 3",
    "w_t": "T 3",
    "K_l": "3 3",
    "K_r": "3 3",
    "extL_T_imu": "4 4",
    "extR_T_imu": "4 4",
}

#: Our own keys beside them: of each group a file holds all or none.
TOLD = {
    "prior_world_T_imu": "4 4",
    "prior_covariance": "6 6",
    "noise_pixel": "4",  # standard deviations, px
    "noise_linear_velocity": "3",  # of a sample, m/s
    "noise_angular_velocity": "3",  # of a sample, rad/s
    "noise_process": "6 6",  # `vislam.types.Noise.process`, with every digit
    "noise_process_model": "text",
    "gate": "",  # a probability; 0 for none
}
IMAGE = {"image_size": "2"}  # width, height, px
TRUTH = {
    "truth_world_T_imu": "T 4 4",
    "truth_landmarks": "3 M",
    "truth_linear_velocity": "3 T",
    "truth_angular_velocity": "3 T",
    "truth_imu_T_cam": "4 4",
    "truth_b": "",
}
IMU = {"imu_time_stamps": "1 N", "imu_gyro": "3 N", "imu_accel": "3 N"}
IMU_BIAS = {"truth_gyro_bias": "3 N", "truth_accel_bias": "3 N"}
ORIGIN = {"scenario_yaml": "text", "seed": "integer", "run": "integer", "simbench_version": "text"}

GROUPS = (TOLD, IMAGE, TRUTH, IMU, IMU_BIAS, ORIGIN)


def process_scale(model: ProcessModel, times_s: Array) -> float:
    """What turns the sigma of a twist sample into that of `Noise.process`, at the mean interval."""
    mean_interval = float(np.mean(np.diff(times_s))) if len(times_s) > 1 else 1.0
    scales = {"twist": 1.0, "additive": mean_interval, "twist-density": math.sqrt(mean_interval)}
    return scales[model]
