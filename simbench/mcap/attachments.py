"""What a filter is told and what is true, as attachments with every digit."""

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from simbench.dataset import Dataset, Truth
from simbench.npz.archive import Archive
from vislam.arrays import Array
from vislam.camera import StereoRig
from vislam.point import PointSensor
from vislam.types import Belief, Calibration, Noise

#: Wall-clock figures: they differ from run to run, and equal runs give equal bytes.
_WALL_CLOCK = {"wall_s", "realtime_factor"}

#: What ``truth.npz`` holds: fields of `Truth`, and of `RawImu` where it has them.
TRUTH = ("T_world_imu", "landmarks", "linear_velocity", "angular_velocity")
TRUTH_OF_IMU = ("truth_gyro_bias", "truth_accel_bias")


def dump_told(dataset: Dataset) -> bytes:
    """``calibration.json``: calibration, noise, prior, gate and landmark count."""
    truth = dataset.truth
    told = {
        "calibration": asdict(dataset.calibration),
        "noise": asdict(dataset.noise),
        "prior": asdict(dataset.prior),
        "gate": dataset.gate,
        "landmark_count": dataset.landmark_count,
        "true_calibration": asdict(truth.calibration) if truth else None,
        "notes": dataset.notes,
    }
    return json.dumps(told, indent=1, default=lambda array: array.tolist()).encode()


def load_told(data: bytes) -> dict[str, Any]:
    """The fields of a dataset in ``calibration.json``, and ``true_calibration``."""
    told = json.loads(data)
    true_calibration = told["true_calibration"]
    return {
        "calibration": _calibration(told["calibration"]),
        "noise": _noise(told["noise"]),
        "prior": _belief(told["prior"]),
        "gate": told["gate"],
        "landmark_count": told["landmark_count"],
        "true_calibration": true_calibration and _calibration(true_calibration),
        "notes": tuple(told["notes"]),
    }


def _calibration(told: dict[str, Any]) -> Calibration:
    rig = {k: tuple(v) if isinstance(v, list) else v for k, v in told["rig"].items()}
    sensor: Any = PointSensor if "range_m" in rig else StereoRig
    return Calibration(rig=sensor(**rig), T_imu_cam=np.array(told["T_imu_cam"]))


def _noise(told: dict[str, Any]) -> Noise:
    fields: dict[str, Any] = {
        name: np.array(value, float) if isinstance(value, list) else value
        for name, value in told.items()
    }
    return Noise(**fields)


def _belief(told: dict[str, Any]) -> Belief:
    def array_or_none(value: Any) -> Array | None:
        return None if value is None else np.array(value, float)

    return Belief(
        T_world_imu=np.array(told["T_world_imu"], float),
        pose_covariance=array_or_none(told["pose_covariance"]),
        ids=np.array(told["ids"], np.int64),
        landmarks=np.array(told["landmarks"], float).reshape(-1, 3),
        landmark_covariances=np.array(told["landmark_covariances"], float).reshape(-1, 3, 3),
        joint_covariance=array_or_none(told["joint_covariance"]),
        chart=told["chart"],
    )


def dump_truth(dataset: Dataset, truth: Truth) -> bytes:
    """``truth.npz``: poses, landmarks, velocities, and the biases of the raw IMU."""
    arrays = {name: getattr(truth, name) for name in TRUTH}
    if dataset.imu is not None:
        biases = {name: getattr(dataset.imu, name) for name in TRUTH_OF_IMU}
        arrays |= {name: bias for name, bias in biases.items() if bias is not None}
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def load_truth(path: Path, data: bytes) -> dict[str, Array]:
    """The arrays of ``truth.npz`` in a recording, whose path is for errors."""
    with zipfile.ZipFile(io.BytesIO(data)) as zip_:
        archive = Archive(path, zip_)
        return {key: archive.array(key) for key in sorted(archive.keys)}


def dump_metrics(metrics: Mapping[str, Any]) -> bytes:
    """``metrics.json``, without wall-clock figures."""
    kept = {k: v for k, v in metrics.items() if k not in _WALL_CLOCK}
    return json.dumps(kept, indent=1).encode()
