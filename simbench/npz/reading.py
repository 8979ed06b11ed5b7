"""Files of the format into datasets, whatever their dialect."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from simbench.conventions import (
    NOTHING,
    CameraAxes,
    Convention,
    Extrinsics,
    ImuFrame,
    Motion,
    Overruled,
    resolve,
)
from simbench.dataset import Dataset, Origin, RawImu, Truth
from simbench.noise import SIGMA_ANGULAR, SIGMA_PX, SIGMA_VELOCITY
from simbench.npz.checked import Contents, check
from simbench.npz.estimated import GATE, with_estimated_noise
from simbench.npz.layout import process_scale
from simbench.npz.pickled import right_camera, stands_right
from vislam.arrays import Array
from vislam.camera import StereoRig
from vislam.types import Belief, Calibration, Noise


def read_npz(
    path: Path | str,
    *,
    imu_frame: ImuFrame | None = None,
    extrinsics: Extrinsics | None = None,
    camera_axes: CameraAxes | None = None,
    noise_pixel_px: float | None = None,
    noise_velocity: float | None = None,
    noise_angular: float | None = None,
) -> Dataset:
    """Read a dataset of any dialect, `.npz` or `.npy`.

    Args:
        path: the file; its stem names the dataset.
        imu_frame: overrules the IMU frame that the data show.
        extrinsics: overrules what the data show the extrinsics to be.
        camera_axes: overrules the axes of the camera that the data show.
        noise_pixel_px: standard deviation of every pixel coordinate that a filter is told.
        noise_velocity: of a sample of linear velocity, m/s.
        noise_angular: of a sample of angular velocity, rad/s.

    Raises:
        DatasetError: the file is no usable dataset; names the file and the key.
    """
    path = Path(path)
    contents = check(path)
    arrays = contents.arrays
    rig = _rig(contents, arrays["b"])
    convention = _convention(
        contents,
        Overruled(extrinsics=extrinsics, imu_frame=imu_frame, camera_axes=camera_axes),
    )
    notes = [*contents.notes]
    if contents.sightings is None:
        notes.append("There are no features: only dead reckoning has anything to work on.")
    notes.append(convention.note)
    notes += _right_camera_note(contents, convention)
    dataset = Dataset(
        name=path.stem,
        times_s=contents.times_s,
        linear_velocity=_columns(arrays["linear_velocity"]),
        angular_velocity=_columns(arrays["angular_velocity"]),
        landmark_count=contents.landmark_count,
        sightings=contents.sightings,
        calibration=Calibration(rig=rig, T_imu_cam=convention.chosen.T_imu_cam),
        noise=_noise_in_file(contents),
        prior=_prior(contents),
        gate=_gate(contents),
        imu=_imu(contents),
        truth=_truth(contents),
        origin=_origin(contents),
        notes=tuple(notes),
    )
    if not contents.told:
        dataset = with_estimated_noise(dataset)
    return replace(
        dataset,
        noise=_overruled(dataset, noise_pixel_px, noise_velocity, noise_angular),
    )


def read_convention(path: Path, overruled: Overruled = NOTHING) -> Convention:
    """Every reading of a file's extrinsics with its error, and the one that `read_npz` chooses.

    Args:
        path: the file.
        overruled: leaves only the readings that agree with it, as in `read_npz`.

    Raises:
        DatasetError: the file is no usable dataset.
    """
    return _convention(check(path), overruled)


def _convention(contents: Contents, overruled: Overruled) -> Convention:
    arrays = contents.arrays
    motion = Motion.of(
        _rig(contents, arrays["b"]),
        contents.times_s,
        _columns(np.concatenate([arrays["linear_velocity"], arrays["angular_velocity"]])),
        contents.sightings,
    )
    return resolve(
        contents.extrinsics, contents.extrinsics_key, contents.meanings, motion, overruled
    )


def _right_camera_note(contents: Contents, convention: Convention) -> list[str]:
    """A warning where the chosen reading puts the right camera elsewhere than to the right."""
    if contents.right_extrinsics is None:
        return []
    meaning = convention.chosen.meaning
    right = right_camera(meaning, contents.extrinsics, contents.right_extrinsics)
    if stands_right(right):
        return []
    return [
        f"Warning: read as {convention.chosen.name}, the right camera stands at "
        f"{np.round(right, 3).tolist()} m in the left one's optical frame, not along its x axis: "
        "the file contradicts this reading."
    ]


def _rig(contents: Contents, baseline_m: Array) -> StereoRig:
    K, size = contents.arrays["K"], contents.arrays.get("image_size")
    return StereoRig(
        fx_px=float(K[0, 0]),
        fy_px=float(K[1, 1]),
        cx_px=float(K[0, 2]),
        cy_px=float(K[1, 2]),
        baseline_m=float(baseline_m),
        image_px=None if size is None else (int(size[0]), int(size[1])),
    )


def _noise_in_file(contents: Contents) -> Noise:
    """What the file says of noise, or wide defaults."""
    if not contents.told:
        process = np.diag(np.repeat(np.square([SIGMA_VELOCITY, SIGMA_ANGULAR]), 3))
        return Noise(process_model="twist", process=process, sigma_px=np.full(4, SIGMA_PX))
    return Noise(
        process_model=contents.process_model,
        process=contents.arrays["noise_process"],
        sigma_px=contents.arrays["noise_pixel"],
    )


def _overruled(
    dataset: Dataset, pixel_px: float | None, velocity: float | None, angular: float | None
) -> Noise:
    """The noise that a dataset is told, and over it what the caller says."""
    process = dataset.noise.process.copy()
    scale = process_scale(dataset.noise.process_model, dataset.times_s)
    for sigma, part in ((velocity, slice(0, 3)), (angular, slice(3, 6))):
        if sigma is not None:
            process[part], process[:, part] = 0.0, 0.0
            process[part, part] = np.diag(np.full(3, (sigma * scale) ** 2))
    sigma_px = dataset.noise.sigma_px if pixel_px is None else np.full(4, float(pixel_px))
    return replace(dataset.noise, process=process, sigma_px=sigma_px)


def _prior(contents: Contents) -> Belief:
    if not contents.told:
        return Belief(T_world_imu=np.eye(4), pose_covariance=np.zeros((6, 6)))
    return Belief(
        T_world_imu=contents.arrays["prior_world_T_imu"],
        pose_covariance=contents.arrays["prior_covariance"],
    )


def _gate(contents: Contents) -> float | None:
    if not contents.told:
        return GATE
    gate = float(contents.arrays["gate"])
    return gate or None  # the file holds 0 for none


def _imu(contents: Contents) -> RawImu | None:
    arrays = contents.arrays
    if contents.imu_times_s is None:
        return None
    biases = "truth_gyro_bias" in arrays
    return RawImu(
        times_s=contents.imu_times_s,
        gyro=_columns(arrays["imu_gyro"]),
        accel=_columns(arrays["imu_accel"]),
        truth_gyro_bias=_columns(arrays["truth_gyro_bias"]) if biases else None,
        truth_accel_bias=_columns(arrays["truth_accel_bias"]) if biases else None,
    )


def _truth(contents: Contents) -> Truth | None:
    arrays = contents.arrays
    if "truth_b" not in arrays:
        return None
    return Truth(
        T_world_imu=arrays["truth_world_T_imu"],
        landmarks=_columns(arrays["truth_landmarks"]),
        linear_velocity=_columns(arrays["truth_linear_velocity"]),
        angular_velocity=_columns(arrays["truth_angular_velocity"]),
        calibration=Calibration(
            rig=_rig(contents, arrays["truth_b"]), T_imu_cam=arrays["truth_imu_T_cam"]
        ),
    )


def _origin(contents: Contents) -> Origin | None:
    if "scenario_yaml" not in contents.texts:
        return None
    return Origin(
        scenario_yaml=contents.texts["scenario_yaml"],
        seed=contents.integers["seed"],
        run=contents.integers["run"],
        version=contents.texts["simbench_version"],
    )


def _columns(rows: Array) -> Array:
    """From a row for each axis, (3, n), to (n, 3)."""
    return np.ascontiguousarray(rows.T)
