"""Whether a filter's errors and innovations are of the size that it claims.

NEES and NIS come with degrees of freedom to be read against (`chi_square_band`), whiteness with its
p-value.

Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
5.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, gammainccinv, gammaincinv

from simbench.errors import InputError
from simbench.run import RunRecord
from vislam.arrays import Array, IntArray
from vislam.types import Innovation

#: An eigenvalue below this share of the largest is rounding: the direction has no variance.
RANK_TOLERANCE = 1e-12
#: A pose has diverged where fewer right runs than this share have such a NEES.
DIVERGED = 1e-6


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
    numbers is multiplied with the same one `lag` frames later, and the products are averaged
    over landmarks and frames; a landmark that is lost or refused in between leaves a gap.

    Args:
        innovations: frame by frame, of one run.
        lags: how many to look at, at least 1.

    Source: Ljung, Box, Biometrika 65(2), 1978, for series with gaps.
    """
    none = (np.empty(0, np.int64), np.empty((0, 1)))
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
            pairs[lag - 1] += later_w[b].size
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
