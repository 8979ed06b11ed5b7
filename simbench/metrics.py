"""How far an estimate is from the truth, and whether its covariance says so.

NEES and NIS come with degrees of freedom to be read against (`chi_square_band`), whiteness with its
p-value. Sources: for errors of poses Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM
Systems (IROS 2012); for NEES and NIS Bar-Shalom, Li, Kirubarajan, Estimation with Applications to
Tracking and Navigation (2001), 5.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, gammainccinv, gammaincinv

from simbench.errors import InputError
from simbench.run import RunRecord
from vislam.arrays import Array, IntArray
from vislam.lie import se3, so3
from vislam.types import Innovation

Alignment: TypeAlias = Literal["none", "yaw", "se3"]
Metrics: TypeAlias = dict[str, str | int | float | None]

#: An eigenvalue below this share of the largest is rounding: the direction has no variance.
RANK_TOLERANCE = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """Errors of poses, or of motions between poses: length and angle, shape (n,) each."""

    translation_m: Array
    rotation_rad: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class LandmarkErrors:
    """Errors of a map, the landmarks of which the truth is known.

    Attributes:
        ids: shape (m,).
        error_m: true minus estimated position in the world, shape (m, 3).
        nees: in the filter's own chart, 3 degrees of freedom, NaN for a landmark whose covariance
            is exactly zero, shape (m,); None where the filter gives no covariances.
    """

    ids: IntArray
    error_m: Array
    nees: Array | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Whiteness:
    """The autocorrelation of innovations, and the Ljung-Box test that there is none.

    Attributes:
        autocorrelation: at lag 1, 2, ..; NaN where no pair exists, shape (lags,).
        pairs: of numbers that each of them is the mean product of, shape (lags,).
        statistic: chi-square with `dof` degrees where the innovations are white.
        dof: the number of lags with pairs.
        p: the probability of a statistic at least as large.
    """

    autocorrelation: Array
    pairs: IntArray
    statistic: float
    dof: int
    p: float


def rmse(errors: Array) -> float:
    """The root of the mean square; NaN of no errors."""
    return float(np.sqrt(np.mean(np.square(errors)))) if np.size(errors) else float("nan")


def align(estimated: Array, true: Array, how: Alignment) -> Array:
    """The rigid motion that brings estimated positions nearest to the true ones, least squares.

    Args:
        estimated: positions, metres, shape (T, 3).
        true: positions, shape (T, 3).
        how: `none`; `yaw`, a translation and a turn about the world's z axis, which is what an
            estimator that senses gravity cannot observe; `se3`, any rigid motion. Where several are
            as near (positions on one line), one of them.

    Returns:
        T_true_estimated, shape (4, 4).

    Source: Umeyama, IEEE PAMI 13(4), 1991, without scale.
    """
    if how == "none":
        return np.eye(4)
    estimated_mean, true_mean = estimated.mean(axis=0), true.mean(axis=0)
    C = (true - true_mean).T @ (estimated - estimated_mean)
    if how == "yaw":
        yaw = np.arctan2(C[1, 0] - C[0, 1], C[0, 0] + C[1, 1])
        R = so3.exp(np.array([0, 0, yaw]))
    elif how == "se3":
        U, _, Vt = np.linalg.svd(C)
        R = U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    else:
        raise InputError(f"Expected an alignment of {get_args(Alignment)}, got {how!r}.")
    return se3.from_rotation_translation(R, true_mean - R @ estimated_mean)


def ate(estimated: Array, true: Array, how: Alignment = "none") -> PoseErrors:
    """Absolute trajectory errors, pose by pose, after an alignment of the positions.

    Args:
        estimated: shape (T, 4, 4).
        true: shape (T, 4, 4).
        how: see `align`.

    Returns:
        Shape (T,); the ATE is the `rmse` of them.
    """
    _check_poses(estimated, true)
    T_true_estimated = align(estimated[:, :3, 3], true[:, :3, 3], how)
    return _size(se3.inverse(true) @ T_true_estimated @ estimated)


def rpe(estimated: Array, true: Array, step: int = 1) -> PoseErrors:
    """Relative pose errors: of the motion from each pose to the one `step` frames later.

    Args:
        estimated: shape (T, 4, 4).
        true: shape (T, 4, 4).
        step: frames, at least 1.

    Returns:
        Shape (T - step,); the RPE is the `rmse` of them.
    """
    _check_poses(estimated, true)
    if step < 1:
        raise InputError(f"Expected a `step` of at least 1 frame, got {step}.")
    moved = [se3.inverse(T[:-step]) @ T[step:] for T in (true, estimated)]
    return _size(se3.inverse(moved[0]) @ moved[1])


def path_length(T_world_imu: Array) -> float:
    """The length of a path in metres, poses of shape (T, 4, 4)."""
    return float(np.linalg.norm(np.diff(T_world_imu[:, :3, 3], axis=0), axis=1).sum())


def nees(error: ArrayLike, covariance: ArrayLike) -> Array:
    """Normalised estimation error squared, e^T P^-1 e; chi-square with rank(P) degrees.

    A direction without variance (an exactly known start) claims an error of zero. Where the error
    keeps that claim, to 1e-6 of the standard deviations (of the unit, for a coordinate of variance
    zero), NEES is that of the other directions: P^-1 is the pseudo-inverse. Where it breaks the
    claim NEES is infinite; also where P is not positive semidefinite or anything is not finite. It
    is never NaN. P is scaled to a correlation matrix first, so that units do not matter.

    Args:
        error: shape (..., n).
        covariance: P, symmetric, shape (..., n, n).

    Returns:
        Shape (...).
    """
    e, P = np.asarray(error, float), np.asarray(covariance, float)
    n = e.shape[-1]
    if P.shape[-2:] != (n, n):
        raise InputError(
            f"Expected a `covariance` of shape (..., {n}, {n}) for an `error` of {e.shape}, "
            f"got {P.shape}."
        )
    finite = np.isfinite(P).all(axis=(-2, -1)) & np.isfinite(e).all(axis=-1)
    P, e = np.where(finite[..., None, None], P, np.eye(n)), np.where(finite[..., None], e, 0.0)
    variance = np.diagonal(P, axis1=-2, axis2=-1)
    sigma = np.sqrt(np.where(variance > 0, variance, 1.0))
    eigenvalues, V = np.linalg.eigh(P / (sigma[..., :, None] * sigma[..., None, :]))
    e = ((e / sigma)[..., None, :] @ V)[..., 0, :]
    rounding = RANK_TOLERANCE * np.abs(eigenvalues).max(axis=-1, keepdims=True)
    varies = eigenvalues > rounding
    value = np.sum(np.where(varies, e**2 / np.where(varies, eigenvalues, 1.0), 0.0), axis=-1)
    claim_broken = np.any(~varies & (e**2 > RANK_TOLERANCE), axis=-1)
    usable = finite & (eigenvalues >= -rounding).all(axis=-1)
    return np.where(usable & ~claim_broken, value, np.inf)


def chi_square_band(
    dof: ArrayLike, probability: float, count: ArrayLike = 1
) -> tuple[Array, Array]:
    """Where the mean of `count` independent chi-square variables lies with a given probability.

    Two-sided, with equal tails. Divide by `dof` for a band about one.

    Args:
        dof: of each variable, any shape.
        probability: of lying within, 0 to 1.
        count: how many are averaged: runs, at one instant. (Steps of one run are not independent.)

    Returns:
        Lower and upper bound.
    """
    if not 0 < probability < 1:
        raise InputError(f"Expected a `probability` between 0 and 1, got {probability}.")
    tail = (1 - probability) / 2
    half_dof = np.asarray(dof, float) * np.asarray(count) / 2
    scale = 2 / np.asarray(count)
    return scale * gammaincinv(half_dof, tail), scale * gammainccinv(half_dof, tail)


def whiteness(innovations: Sequence[Innovation | None], lags: int = 1) -> Whiteness:
    """Whether accepted innovations of one landmark are uncorrelated from frame to frame.

    The whitened residuals of a right filter are independent, with mean zero. Each of a landmark's
    four numbers is multiplied with the same one `lag` frames later, and the products are averaged
    over landmarks and frames; a landmark that is lost or refused in between leaves a gap.

    Args:
        innovations: frame by frame, of one run.
        lags: how many to look at, at least 1.

    Source: Ljung, Box, Biometrika 65(2), 1978, for series with gaps.
    """
    none = (np.empty(0, np.int64), np.empty((0, 4)))
    frames = [
        none if i is None else (i.ids[i.accepted], i.whitened[i.accepted]) for i in innovations
    ]
    n = sum(w.size for _, w in frames)
    power = sum(float(np.sum(w**2)) for _, w in frames) / max(n, 1)
    products, pairs = np.zeros(lags), np.zeros(lags, np.int64)
    for lag in range(1, lags + 1):
        for (ids, w), (later_ids, later_w) in zip(frames[:-lag], frames[lag:], strict=True):
            _, a, b = np.intersect1d(ids, later_ids, assume_unique=True, return_indices=True)
            products[lag - 1] += np.sum(w[a] * later_w[b])
            pairs[lag - 1] += 4 * len(a)
    seen = pairs > 0
    r = np.full(lags, np.nan)
    r[seen] = products[seen] / pairs[seen] / power
    statistic = float((n + 2) / max(n, 1) * np.sum(pairs[seen] * r[seen] ** 2))
    dof = int(np.count_nonzero(seen))
    p = float(chdtrc(dof, statistic)) if dof else float("nan")
    return Whiteness(autocorrelation=r, pairs=pairs, statistic=statistic, dof=dof, p=p)


def pose_nees(record: RunRecord) -> Array | None:
    """NEES of the pose at each frame, 6 degrees of freedom, in the filter's own chart.

    NaN at frames where the covariance is exactly zero: a start that is known says nothing.

    Returns:
        Shape (T,); None where the filter estimates no pose or the truth is unknown.
    """
    errors, covariances = record.pose_errors, record.pose_covariances
    if errors is None or covariances is None:
        return None
    return _nees_where_uncertain(errors, covariances)


def nis(record: RunRecord) -> tuple[Array, IntArray]:
    """NIS of the accepted sightings and its degrees of freedom at each frame, shape (T,) each.

    Zero of zero where the filter has no innovation.
    """
    innovations = [step.innovation for step in record.steps]
    return (
        np.array([0.0 if i is None else float(i.nis) for i in innovations]),
        np.array([0 if i is None else int(i.dof) for i in innovations]),
    )


def _nees_where_uncertain(error: Array, covariance: Array) -> Array:
    """NEES, but NaN for a covariance of exactly zero."""
    return np.where(covariance.any(axis=(-2, -1)), nees(error, covariance), np.nan)


def landmark_errors(record: RunRecord) -> LandmarkErrors | None:
    """Errors of the final map; landmarks unknown to the truth are left out.

    Returns:
        None where the truth is unknown.
    """
    truth, final = record.dataset.truth, record.final
    if truth is None:
        return None
    state = truth.state(record.steps[-1].frame)
    known = np.isin(final.ids, state.ids)
    has_covariances = len(final.landmark_covariances) == len(final.ids)
    covariances = final.landmark_covariances[known] if has_covariances else np.empty((0, 3, 3))
    final = replace(
        final,
        ids=final.ids[known],
        landmarks=final.landmarks[known],
        landmark_covariances=covariances,
        joint_covariance=None,
    )
    in_chart = final.error(state)
    in_chart = in_chart[len(in_chart) - 3 * len(final.ids) :].reshape(-1, 3)
    return LandmarkErrors(
        ids=final.ids,
        error_m=state.landmarks[final.ids] - final.landmarks,
        nees=_nees_where_uncertain(in_chart, covariances) if has_covariances else None,
    )


def metrics(record: RunRecord) -> Metrics:
    """All that `metrics.json` holds of a run.

    Every key is always there; None where it does not apply (no truth, no innovations, no
    covariance) or is not finite. Names and units are the command line's. `pose_nees_mean` is over
    frames and `landmark_nees_mean` over the landmarks at the end, both without what is known
    exactly (a covariance of zero). `skipped_features` counts the invalid sightings that the filter
    met. Where the truth is unknown, `path_length_m` is that of the estimate.
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
    }
    return {
        k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in values.items()
    }


def _check_poses(estimated: Array, true: Array) -> None:
    if np.shape(estimated)[1:] != (4, 4) or np.shape(estimated) != np.shape(true):
        raise InputError(
            "Expected estimated and true poses at the same frames, of shape (T, 4, 4) both, "
            f"got {np.shape(estimated)} and {np.shape(true)}."
        )


def _size(T: Array) -> PoseErrors:
    """The length and the angle of motions."""
    return PoseErrors(
        translation_m=np.linalg.norm(T[:, :3, 3], axis=-1),
        rotation_rad=np.linalg.norm(so3.log(T[:, :3, :3]), axis=-1),
    )


def _pose_metrics(record: RunRecord) -> Metrics:
    names = (
        "ate_rmse_m",
        "ate_rmse_aligned_m",
        "rpe_trans_rmse_m",
        "rpe_rot_rmse_deg",
        "final_position_error_m",
        "final_rotation_error_deg",
        "pose_nees_mean",
    )
    truth = record.dataset.truth
    if truth is None:
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


def _mean(values: Array | None) -> float | None:
    """The mean of a NEES over where it is defined, that is not NaN."""
    return None if values is None or np.isnan(values).all() else float(np.nanmean(values))


def _innovation_metrics(record: RunRecord) -> Metrics:
    innovations = [step.innovation for step in record.steps if step.innovation is not None]
    if not innovations:
        names = ("nis_mean_per_dof", "accepted", "rejected", "skipped_features")
        return dict.fromkeys(names)
    value, dof = nis(record)
    return {
        "nis_mean_per_dof": float(value.sum() / dof.sum()) if dof.any() else None,
        "accepted": sum(int(np.count_nonzero(i.accepted)) for i in innovations),
        "rejected": sum(int(i.rejected) for i in innovations),
        "skipped_features": sum(len(i.skipped) for i in innovations),
    }
