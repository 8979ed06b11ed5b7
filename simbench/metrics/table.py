"""All that `metrics.json` holds of a run."""

from typing import TypeAlias

import numpy as np

from simbench.metrics.consistency import landmark_errors, nis, pose_nees
from simbench.metrics.fit import noise_fit
from simbench.metrics.trajectory import ate, path_length, rmse, rpe
from simbench.run import RunRecord
from vislam.arrays import Array

Metrics: TypeAlias = dict[str, str | int | float | None]


#: How far the poses are from the truth: of these, smaller is better.
POSE_ERRORS = (
    "ate_rmse_m",
    "ate_rmse_aligned_m",
    "rpe_trans_rmse_m",
    "rpe_rot_rmse_deg",
    "final_position_error_m",
    "final_rotation_error_deg",
)


def metrics(record: RunRecord) -> Metrics:
    """All that `metrics.json` holds of a run.

    Every key is always there; None where it does not apply (no truth, no innovations, no
    covariance) or is not finite. Names and units are the command line's. `pose_nees_mean` is over
    frames and `landmark_nees_mean` over the landmarks at the end, both without what is known
    exactly (a covariance of zero). `skipped_features` counts the invalid sightings that the filter
    met, `rejected_share` is that of the rest which were not accepted, and `noise_fit` says in words
    whether both agree with the noise told. Where the truth is unknown, `path_length_m` is that of
    the estimate. `smoothed_` stands before what is of the past poses given all data.
    """
    dataset, true = record.dataset, record.dataset.truth
    duration_s = float(dataset.times_s[-1] - dataset.times_s[0])
    values: Metrics = {
        "source": dataset.name,
        "filter": record.filter,
        "frames": len(record.steps),
        "landmarks": len(record.final.ids),
        "duration_s": duration_s,
        "wall_s": record.wall_s,
        "realtime_factor": duration_s / record.wall_s if record.wall_s > 0 else None,
        "path_length_m": path_length(record.T_world_imu if true is None else true.T_world_imu),
        **_pose_metrics(record),
        **_map_metrics(record),
        **_innovation_metrics(record),
        **{f"smoothed_{name}": v for name, v in _pose_metrics(record.as_smoothed).items()},
    }
    return {
        k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in values.items()
    }


def _pose_metrics(record: RunRecord | None) -> Metrics:
    names = (*POSE_ERRORS, "pose_nees_mean")
    truth = None if record is None else record.dataset.truth
    if record is None or truth is None:
        return dict.fromkeys(names)
    estimated, true = record.T_world_imu, truth.T_world_imu
    absolute, relative = ate(estimated, true), rpe(estimated, true)
    values = (
        rmse(absolute.translation_m),
        rmse(ate(estimated, true, "se3").translation_m),
        rmse(relative.translation_m),
        rmse(np.rad2deg(relative.rotation_rad)),
        float(absolute.translation_m[-1]),
        float(np.rad2deg(absolute.rotation_rad[-1])),
        _mean(pose_nees(record)),
    )
    return dict(zip(names, values, strict=True))


def _map_metrics(record: RunRecord) -> Metrics:
    errors = landmark_errors(record)
    if errors is None:
        return {"landmark_nees_mean": None, "landmark_rmse_m": None}
    return {
        "landmark_nees_mean": _mean(errors.nees),
        "landmark_rmse_m": rmse(np.linalg.norm(errors.error_m, axis=-1)),
    }


def _innovation_metrics(record: RunRecord) -> Metrics:
    innovations = [step.innovation for step in record.steps if step.innovation is not None]
    if not innovations:
        names = ("nis_mean_per_dof", "accepted", "rejected", "skipped_features")
        return dict.fromkeys((*names, "rejected_share", "noise_fit"))
    value, dof = nis(record)
    nis_per_dof = float(value.sum() / dof.sum()) if dof.any() else None
    accepted = sum(int(np.count_nonzero(i.accepted)) for i in innovations)
    rejected = sum(int(i.rejected) for i in innovations)
    share = rejected / (accepted + rejected) if accepted + rejected else None
    return {
        "nis_mean_per_dof": nis_per_dof,
        "accepted": accepted,
        "rejected": rejected,
        "skipped_features": sum(len(i.skipped) for i in innovations),
        "rejected_share": share,
        "noise_fit": noise_fit(nis_per_dof, share, record.dataset.gate),
    }


def _mean(values: Array | None) -> float | None:
    """The mean of a NEES over where it is defined, that is not NaN."""
    return None if values is None or np.isnan(values).all() else float(np.nanmean(values))
