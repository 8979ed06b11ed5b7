"""Says what a file is: sizes, rates, statistics, the convention found, what is wrong with it."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from simbench.dataset import Dataset, PointSightings, Sightings
from simbench.metrics import path_length
from simbench.source import NOTHING, Kind, Told, kind_of, open_source, refuse_misplaced
from vislam.arrays import Array
from vislam.camera import StereoRig, Validity, is_valid, triangulate, validity
from vislam.filters.model import moved
from vislam.point import PointSensor


def info(path: Path, told: Told = NOTHING) -> dict[str, Any]:
    """Describe a scene, a dataset, a recording or a trajectory.

    Returns:
        JSON-safe values; `kind`, `conventions`, `clear`, `notes` and `problems` are always there.
        `clear` is whether the data tell the chosen convention from every other, None where there is
        none to choose.

    Raises:
        InputError: the file is not usable, or what is told does not go with its kind.
    """
    kind = kind_of(path)
    if kind is Kind.TRAJECTORY:
        from simbench.files import read_text
        from simbench.poses import format_of, read_poses

        refuse_misplaced(path, kind, told)
        poses = read_poses(path)
        times_s = poses.times_s
        return {
            "kind": kind.value,
            "format": format_of(read_text(path)).value,
            "poses": len(times_s),
            **(_times(times_s) if poses.times else {"duration_s": None, "rate_hz": None}),
            "path_length_m": path_length(poses.Ts_world_imu),
            "conventions": [],
            "clear": None,
            "notes": [],
            "problems": [],
        }
    described: dict[str, Any] = {"kind": kind.value}
    if kind is Kind.DATASET:
        from simbench.npz import dialect_of

        described["dialect"] = dialect_of(path)
    if kind is Kind.RECORDING:
        from simbench.mcap import summary

        described["recording"] = asdict(summary(path))
    dataset = open_source(path, told)
    described |= describe(dataset)
    if kind is Kind.DATASET:
        described |= _convention(path, told)
        if not described["clear"]:
            described["problems"].append("the convention is not clear: see the notes")
    return described


def describe(dataset: Dataset) -> dict[str, Any]:
    """Sizes, rates and statistics of a dataset, JSON-safe."""
    return {
        "name": dataset.name,
        "frames": len(dataset),
        "landmarks": dataset.landmark_count,
        "sightings": 0 if dataset.sightings is None else len(dataset.sightings),
        **_times(dataset.times_s),
        "path_length_m": path_length(_poses(dataset)),
        "raw_imu_samples": 0 if dataset.imu is None else len(dataset.imu.times_s),
        "truth": dataset.truth is not None,
        "told": _told(dataset),
        "statistics": _statistics(dataset),
        "conventions": [],
        "clear": None,
        "notes": list(dataset.notes),
        "problems": _problems(dataset),
    }


def _times(times_s: Array) -> dict[str, float | None]:
    duration_s = float(times_s[-1] - times_s[0])
    rate_hz = (len(times_s) - 1) / duration_s if duration_s else None
    return {"duration_s": duration_s, "rate_hz": rate_hz}


def _poses(dataset: Dataset) -> Array:
    """The true poses, or where nobody knows them those that the twists alone give."""
    if dataset.truth is not None:
        return dataset.truth.T_world_imu
    poses = [np.eye(4)]
    for i, dt in enumerate(np.diff(dataset.times_s)):
        poses.append(moved(poses[-1], dataset.twist(i), float(dt)))
    return np.stack(poses)


def _told(dataset: Dataset) -> dict[str, Any]:
    rig, noise = dataset.calibration.rig, dataset.noise
    sensor: dict[str, Any]
    if isinstance(rig, PointSensor):
        sensor = {
            "range_m": list(rig.range_m),
            "view_deg": rig.view_deg,
            "point_share": noise.point_share,
            "point_floor_m": noise.point_floor_m,
        }
    else:
        sensor = {
            "fx_px": rig.fx_px,
            "baseline_m": rig.baseline_m,
            "sigma_px": noise.sigma_px.tolist(),
        }
    shares = {"twist_share": noise.twist_share.tolist()} if noise.twist_share.any() else {}
    return {
        **sensor,
        "process_model": noise.process_model,
        "process_sigmas": np.sqrt(np.maximum(np.diag(noise.process), 0)).tolist(),
        **shares,
        "gate": dataset.gate,
    }


def _statistics(dataset: Dataset) -> dict[str, Any]:
    sightings = dataset.sightings
    values: dict[str, Any] = {
        "speed_mps": _spread(np.linalg.norm(dataset.linear_velocity, axis=1)),
        "angular_rate_radps": _spread(np.linalg.norm(dataset.angular_velocity, axis=1)),
    }
    if sightings is None or not len(sightings):
        return values
    _, frames_of_each = np.unique(sightings.ids, return_counts=True)
    values |= {
        "sightings_per_frame": _spread(np.diff(sightings.start)),
        "track_frames": _spread(frames_of_each),
    }
    if isinstance(sightings, PointSightings):
        return values | {"distance_m": _spread(np.linalg.norm(sightings.points, axis=1))}
    rig = dataset.calibration.stereo
    usable = sightings.pixels[is_valid(rig, sightings.pixels)]
    if len(usable):
        off = usable[:, 1] - usable[:, 3]
        values |= {
            "depth_m": _spread(triangulate(rig, usable)[:, 2]),
            # 1.4826 times the median absolute deviation is sigma for normal noise
            "vL_minus_vR_sigma_px": 1.4826 * float(np.median(np.abs(off - np.median(off)))),
        }
    return values


def _spread(values: Array | np.ndarray[Any, Any]) -> dict[str, float]:
    low, middle, high = np.percentile(values, [5, 50, 95])
    return {"p5": float(low), "median": float(middle), "p95": float(high)}


def _problems(dataset: Dataset) -> list[str]:
    """What a user should know before trusting the data."""
    sightings = dataset.sightings
    if sightings is None:
        return ["there are no features: only dead reckoning has anything to work on"]
    problems = []
    if isinstance(sightings, Sightings):
        problems = _unusable(dataset.calibration.stereo, sightings)
    empty = int(np.count_nonzero(np.diff(sightings.start) == 0))
    if empty:
        problems.append(f"{empty} of {len(dataset)} frames see no landmark")
    return problems


def _unusable(rig: StereoRig, sightings: Sightings) -> list[str]:
    """Sightings that no filter can use, by what is wrong with them."""
    kinds = validity(rig, sightings.pixels)
    counts = {
        "half of it is missing": Validity.PARTIAL,
        "the disparity is not positive": Validity.BEHIND,
        f"the disparity is below {rig.min_disparity_px:g} px": Validity.FAR,
        "it lies outside the image": Validity.OUTSIDE,
    }
    found = {why: int(np.count_nonzero(kinds == kind)) for why, kind in counts.items()}
    return [
        f"{count} of {len(kinds)} sightings cannot be used: {why}"
        for why, count in found.items()
        if count
    ]


def _convention(path: Path, told: Told) -> dict[str, Any]:
    """Each candidate reading of the extrinsics with its median pixel error, and how clear it is."""
    from simbench.npz import read_convention

    convention = read_convention(path, told.convention)
    chosen = convention.chosen
    conventions = [
        {
            "name": reading.name,
            "median_px": reading.error_px if np.isfinite(reading.error_px) else None,
            "chosen": reading is chosen,
            "frames": len(reading.frame_errors_px),
            "chosen_better_in": chosen.better_frames(reading),
        }
        for reading in convention.readings
    ]
    return {"conventions": conventions, "clear": convention.clear}
