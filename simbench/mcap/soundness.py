"""What must hold of the dataset in a recording before anything is computed with it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simbench.dataset import Dataset
from simbench.errors import DatasetError
from simbench.limits import LARGEST, beyond, refuse_above_limit
from vislam.arrays import Array
from vislam.types import Calibration

RIGID_TOLERANCE = 1e-6
#: Of the largest eigenvalue: as far below zero rounding takes the smallest.
SEMIDEFINITE = 1e-9


def refuse_unsound(path: Path, dataset: Dataset) -> None:
    """Refuse a dataset of wrong shapes or of numbers that nothing can be computed with.

    Raises:
        DatasetError: says the first that is wrong.
    """
    what = f"{dataset.landmark_count} landmarks and {len(dataset)} frames, as a dense array,"
    refuse_above_limit(str(path), what, 4 * 8 * dataset.landmark_count * len(dataset))
    for wrong in _wrong(dataset):
        raise DatasetError(f"{path}: the recording is damaged: {wrong}.")


def _wrong(dataset: Dataset) -> Iterator[str]:
    """What is wrong; shapes first, for what follows needs them."""
    for name, shape, array in _arrays(dataset):
        if array.shape != shape:
            yield f"expected {name} of shape {shape}, got {array.shape}"
    if (field := beyond(dataset, "dataset")) is not None:
        yield f"expected finite numbers up to {LARGEST:g} in {field}"
    if (np.diff(dataset.times_ns) <= 0).any():
        yield "expected times that increase"
    if dataset.gate is not None and not 0 < dataset.gate < 1:
        yield f"expected a gate between 0 and 1, got {dataset.gate}"
    sightings = dataset.sightings
    if sightings is not None and len(sightings):
        if not 0 <= sightings.ids.min() <= sightings.ids.max() < dataset.landmark_count:
            yield f"expected landmarks 0 to {dataset.landmark_count - 1}"
        if (np.lexsort((sightings.ids, sightings.frames)) != np.arange(len(sightings))).any():
            yield "expected landmarks in ascending order within a frame"
    for name, Ts in _poses(dataset):
        R, last_row = Ts[..., :3, :3], Ts[..., 3, :]
        if (
            np.abs(R.swapaxes(-1, -2) @ R - np.eye(3)).max() > RIGID_TOLERANCE
            or np.linalg.det(R).min() < 0
            or (last_row != [0, 0, 0, 1]).any()
        ):
            yield f"expected rigid motions in {name}"
    for name, P in (("noise", dataset.noise.process), ("prior", dataset.prior.pose_covariance)):
        if P is not None and not _is_covariance(P):
            yield f"expected a symmetric positive semidefinite matrix of the {name}"


def _arrays(dataset: Dataset) -> Iterator[tuple[str, tuple[int, ...], NDArray[Any]]]:
    """Names, shapes to expect, and arrays."""
    T, M, noise, prior = len(dataset), dataset.landmark_count, dataset.noise, dataset.prior
    yield "linear velocities", (T, 3), dataset.linear_velocity
    yield "angular velocities", (T, 3), dataset.angular_velocity
    yield "noise.process", (6, 6), noise.process
    yield "noise.twist_share", (6,), noise.twist_share
    yield "noise.sigma_px", (4,) if len(noise.sigma_px) else (0,), noise.sigma_px
    yield "prior landmarks", (len(prior.ids), 3), prior.landmarks
    if prior.pose_covariance is not None:
        yield "prior.pose_covariance", (6, 6), prior.pose_covariance
    if dataset.sightings is not None:
        yield "last", dataset.sightings.ids.shape, dataset.sightings.last
    if (imu := dataset.imu) is not None:
        N = len(imu.times_s)
        readings = (imu.gyro, imu.accel, imu.truth_gyro_bias, imu.truth_accel_bias)
        yield from (("imu", (N, 3), array) for array in readings if array is not None)
    if (truth := dataset.truth) is not None:
        yield "true landmarks", (M, 3), truth.landmarks
        yield "true velocities", (T, 3), truth.linear_velocity
        yield "true velocities", (T, 3), truth.angular_velocity
    for name, Ts in _poses(dataset):
        yield name, (T, 4, 4) if name == "true poses" else (4, 4), Ts


def _poses(dataset: Dataset) -> Iterator[tuple[str, Array]]:
    calibrations: list[tuple[str, Calibration]] = [("T_imu_cam", dataset.calibration)]
    yield "prior.T_world_imu", dataset.prior.T_world_imu
    if dataset.truth is not None:
        yield "true poses", dataset.truth.T_world_imu
        calibrations.append(("true T_imu_cam", dataset.truth.calibration))
    yield from ((name, calibration.T_imu_cam) for name, calibration in calibrations)


def _is_covariance(P: Array) -> bool:
    least, *_, most = np.linalg.eigvalsh(P)
    return np.allclose(P, P.T, rtol=1e-9, atol=0) and bool(least >= -SEMIDEFINITE * abs(most))
