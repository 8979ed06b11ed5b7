"""Datasets into files of the format."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simbench.dataset import Dataset, Origin, RawImu, Sightings, Truth
from simbench.errors import DatasetError
from simbench.files import replacing
from simbench.npz.archive import Sparse, write_arrays, write_sparse
from simbench.npz.dialects import DEFAULT, Dialect
from simbench.npz.layout import FORMER_NAMES, process_scale
from simbench.sensors.inertial import never_zero
from vislam.arrays import Array
from vislam.point import PointSensor


def write_npz(path: Path | str, dataset: Dataset, dialect: Dialect = DEFAULT) -> None:
    """Write a dataset in the format of the course, with our own keys beside the format's.

    Equal datasets give equal bytes. No angular rate is exactly zero and no disparity: readers
    divide by both.

    Args:
        path: the file; replaced only when the new one is whole.
        dataset: the data. A known map in its prior is not part of the format and is left out.
        dialect: whose keys and extrinsics are written; 2025's is an `.npy` that numpy 1.26 and
            later read.

    Raises:
        DatasetError: the data are of a point sensor.
        OutputError: the file cannot be written.
    """
    if isinstance(dataset.calibration.rig, PointSensor):
        raise DatasetError(
            f"{path}: expected the features of a stereo pair, which are all that the format of the "
            f"course holds, got the readings of a point sensor; record {dataset.name} as an MCAP."
        )
    arrays = _told(dataset)
    if dataset.truth is not None:
        arrays |= _truth(dataset.truth)
    if dataset.imu is not None:
        arrays |= _imu(dataset.imu)
    if dataset.origin is not None:
        arrays |= _origin(dataset.origin)
    features = None
    if isinstance(dataset.sightings, Sightings) and dialect.year != "2021":
        features = _features(dataset.sightings, (4, dataset.landmark_count, len(dataset)))
    with replacing(Path(path)) as partial:
        if dialect.year == "2025":
            _write_dict(partial, _format_2025(dataset, dialect) | arrays, features)
            return
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as zip_:
            in_order = _format(dataset, dialect) | arrays
            write_arrays(zip_, {key: np.array(a, order="C") for key, a in in_order.items()})
            if features is not None:
                write_sparse(zip_, "features", features)


def _format(dataset: Dataset, dialect: Dialect) -> dict[str, NDArray[Any]]:
    rig = dataset.calibration.stereo
    arrays = {
        "time_stamps": dataset.times_s[None],
        "linear_velocity": dataset.linear_velocity.T,
        "angular_velocity": never_zero(dataset.angular_velocity).T,
        "K": rig.K,
        "b": np.array(rig.baseline_m, float),
        "imu_T_cam": dialect.meaning.given(dataset.calibration.T_imu_cam),
    }
    if dialect.year == "2019":
        return {FORMER_NAMES.get(key, key): array for key, array in arrays.items()}
    return arrays


def _format_2025(dataset: Dataset, dialect: Dialect) -> dict[str, NDArray[Any]]:
    rig, T_imu_left = dataset.calibration.stereo, dataset.calibration.T_imu_cam
    T_left_right = np.eye(4)
    T_left_right[0, 3] = rig.baseline_m
    return {
        "v_t": dataset.linear_velocity,
        "w_t": never_zero(dataset.angular_velocity),
        "timestamps": dataset.times_s,
        "K_l": rig.K,
        "K_r": rig.K,
        "extL_T_imu": dialect.meaning.given(T_imu_left),
        "extR_T_imu": dialect.meaning.given(T_imu_left @ T_left_right),
    }


def _write_dict(path: Path, arrays: dict[str, NDArray[Any]], features: Sparse | None) -> None:
    """As ``np.save(path, {...})`` does."""
    content: dict[str, Any] = {
        key: array.item() if array.dtype.kind == "U" else np.array(array, order="C")
        for key, array in arrays.items()
    }
    if features is not None:
        content["features"] = np.full(features.shape, -1.0)
        content["features"][features.places] = features.values
    with path.open("wb") as stream:
        # the dialect is a pickled dict; it is read without running any of it (`pickles`)
        np.save(stream, np.array(content, object), allow_pickle=True)


def _told(dataset: Dataset) -> dict[str, NDArray[Any]]:
    noise, rig = dataset.noise, dataset.calibration.stereo
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
        "truth_landmarks": truth.landmarks.T,
        "truth_linear_velocity": truth.linear_velocity.T,
        "truth_angular_velocity": truth.angular_velocity.T,
        "truth_imu_T_cam": truth.calibration.T_imu_cam,
        "truth_b": np.array(truth.calibration.stereo.baseline_m, float),
    }


def _imu(imu: RawImu) -> dict[str, NDArray[Any]]:
    arrays = {
        "imu_time_stamps": imu.times_s[None],
        "imu_gyro": imu.gyro.T,
        "imu_accel": imu.accel.T,
    }
    if imu.truth_gyro_bias is not None and imu.truth_accel_bias is not None:
        arrays["truth_gyro_bias"] = imu.truth_gyro_bias.T
        arrays["truth_accel_bias"] = imu.truth_accel_bias.T
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
    order = np.argsort(sightings.ids, kind="stable")
    return Sparse(
        shape,
        (
            np.repeat(np.arange(4), len(order)),
            np.tile(sightings.ids[order], 4),
            np.tile(sightings.frames[order], 4),
        ),
        _with_disparity(sightings.pixels[order]).T.ravel(),
    )


def _with_disparity(pixels: Array) -> Array:
    """Where uL == uR of what both images show, uR is the next number below."""
    level = (pixels[:, 0] == pixels[:, 2]) & (pixels != -1).all(axis=1)
    uR = np.where(level, np.nextafter(pixels[:, 2], -np.inf), pixels[:, 2])
    return np.column_stack([pixels[:, :2], uR, pixels[:, 3]])
