"""Datasets into `.npz` files."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simbench.dataset import Dataset, Origin, RawImu, Sightings, Truth
from simbench.files import replacing
from simbench.npz.archive import Sparse, write_arrays, write_sparse
from simbench.npz.layout import process_scale
from simbench.sensors.inertial import never_zero
from vislam.arrays import Array


def write_npz(path: Path, dataset: Dataset) -> None:
    """Write a dataset in the format of the course; its `imu_T_cam` is what it says, in FLU.

    Equal datasets give equal bytes.

    Args:
        path: the file; replaced only when the new one is whole.
        dataset: the data. A known map in its prior is not part of the format and is left out.

    Raises:
        OutputError: the file cannot be written.
    """
    with (
        replacing(path) as partial,
        zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as zip_,
    ):
        write_arrays(zip_, _format(dataset) | _told(dataset))
        if dataset.truth is not None:
            write_arrays(zip_, _truth(dataset.truth))
        if dataset.imu is not None:
            write_arrays(zip_, _imu(dataset.imu))
        if dataset.origin is not None:
            write_arrays(zip_, _origin(dataset.origin))
        if dataset.sightings is not None:
            shape = (4, dataset.landmark_count, len(dataset))
            write_sparse(zip_, "features", _features(dataset.sightings, shape))


def _format(dataset: Dataset) -> dict[str, NDArray[Any]]:
    rig = dataset.calibration.rig
    return {
        "time_stamps": dataset.times_s[None],
        "linear_velocity": _rows(dataset.linear_velocity),
        "angular_velocity": _rows(never_zero(dataset.angular_velocity)),
        "K": rig.K,
        "b": np.array(rig.baseline_m, float),
        "imu_T_cam": np.ascontiguousarray(dataset.calibration.T_imu_cam),
    }


def _told(dataset: Dataset) -> dict[str, NDArray[Any]]:
    noise, rig = dataset.noise, dataset.calibration.rig
    sigma = np.sqrt(np.diag(noise.process)) / process_scale(noise.process_model, dataset.times_s)
    image = {} if rig.image_px is None else {"image_size": np.array(rig.image_px, float)}
    return image | {
        "prior_world_T_imu": dataset.prior.T_world_imu,
        "prior_covariance": (
            np.zeros((6, 6))
            if dataset.prior.pose_covariance is None
            else dataset.prior.pose_covariance
        ),
        "noise_pixel": np.asarray(noise.sigma_px, float),
        "noise_linear_velocity": sigma[:3],
        "noise_angular_velocity": sigma[3:],
        "noise_process": noise.process,
        "noise_process_model": np.array(noise.process_model),
        "gate": np.array(dataset.gate or 0.0),
    }


def _truth(truth: Truth) -> dict[str, NDArray[Any]]:
    return {
        "truth_world_T_imu": truth.T_world_imu,
        "truth_landmarks": _rows(truth.landmarks),
        "truth_linear_velocity": _rows(truth.linear_velocity),
        "truth_angular_velocity": _rows(truth.angular_velocity),
        "truth_imu_T_cam": truth.calibration.T_imu_cam,
        "truth_b": np.array(truth.calibration.rig.baseline_m, float),
    }


def _imu(imu: RawImu) -> dict[str, NDArray[Any]]:
    arrays = {
        "imu_time_stamps": imu.times_s[None],
        "imu_gyro": _rows(imu.gyro),
        "imu_accel": _rows(imu.accel),
    }
    if imu.truth_gyro_bias is not None and imu.truth_accel_bias is not None:
        arrays["truth_gyro_bias"] = _rows(imu.truth_gyro_bias)
        arrays["truth_accel_bias"] = _rows(imu.truth_accel_bias)
    return arrays


def _origin(origin: Origin) -> dict[str, NDArray[Any]]:
    return {
        "scenario_yaml": np.array(origin.scenario_yaml),
        "seed": np.array(origin.seed, np.int64),
        "run": np.array(origin.run, np.int64),
        "simbench_version": np.array(origin.version),
    }


def _features(sightings: Sightings, shape: tuple[int, int, int]) -> Sparse:
    """The sightings in the order of the dense array: coordinate, landmark, frame."""
    frames = np.repeat(np.arange(shape[2]), np.diff(sightings.start))
    order = np.argsort(sightings.ids, kind="stable")
    return Sparse(
        shape,
        (
            np.repeat(np.arange(4), len(order)),
            np.tile(sightings.ids[order], 4),
            np.tile(frames[order], 4),
        ),
        sightings.pixels[order].T.ravel(),
    )


def _rows(columns: Array) -> Array:
    """A row for each axis, as the format has it: (n, 3) to (3, n)."""
    return np.ascontiguousarray(columns.T)
