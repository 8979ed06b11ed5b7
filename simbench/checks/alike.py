"""Whether two runs of a filter came out alike, in all that it states."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from simbench.checks.chart import derivative, moved, state_of, varied
from simbench.checks.result import CheckResult, judged
from simbench.checks.trace import Call, covariances
from vislam.arrays import Array, IntArray
from vislam.lie import se3
from vislam.types import Belief, Innovation

#: What rounding may do to numbers of the size of a scene's coordinates.
ROUNDING = 1e-8


def alike(
    expected: Iterable[Call],
    got: Iterable[Call],
    belief: Callable[[Belief], Belief] = lambda belief: belief,
    what: str = "",
    innovation: Callable[[Innovation], Innovation] = lambda innovation: innovation,
    limit: float = ROUNDING,
) -> CheckResult:
    """Whether two runs came out alike, the first one mapped as the law says."""
    worst, where = 0.0, ""
    for a, b in zip(expected, got, strict=True):
        found = _difference(belief(a.belief), b.belief)
        if a.innovation is not None and b.innovation is not None:
            found = max(found, _innovation_difference(innovation(a.innovation), b.innovation))
        if not found <= worst:
            worst, where = found, b.name
        if not np.isfinite(worst):
            break
    return judged(
        worst,
        limit,
        good=f"{what}: no difference",
        bad=f"{where}: {what}: a difference"
        + (f" of {worst:.2g}" if np.isfinite(worst) else " in which landmarks there are"),
    )


def _difference(a: Belief, b: Belief) -> float:
    """The largest difference of two beliefs: metres, or parts of two standard deviations."""
    if not np.array_equal(np.sort(a.ids), np.sort(b.ids)):
        return np.inf
    here, there = state_of(a), state_of(b)
    estimates = (
        _largest(here.T_world_imu - there.T_world_imu),
        _largest(here.landmarks - there.landmarks),
    )
    return max(*estimates, covariance_difference(a, b))


def covariance_difference(a: Belief, b: Belief) -> float:
    """The same of all covariances of two beliefs, by landmark; infinite where one states others."""
    stated = [name for name, _ in covariances(a)]
    if sorted(stated) != sorted(name for name, _ in covariances(b)):
        return np.inf
    order = np.argsort(np.argsort(a.ids))
    b = _in_order(b, np.argsort(b.ids)[order])
    return max(
        (
            relative_difference(P, Q)
            for (_, P), (_, Q) in zip(covariances(a), covariances(b), strict=True)
        ),
        default=0.0,
    )


def _in_order(belief: Belief, order: IntArray) -> Belief:
    """A belief with its landmarks in another order."""
    P = belief.joint_covariance
    if P is not None:
        pose = len(P) - 3 * len(order)
        rows = np.append(np.arange(pose), (pose + 3 * order[:, None] + np.arange(3)).ravel())
        P = P[np.ix_(rows, rows)]
    each = belief.landmark_covariances
    return replace(
        belief,
        ids=belief.ids[order],
        landmarks=belief.landmarks[order],
        landmark_covariances=each[order] if len(each) else each,
        joint_covariance=P,
    )


def _innovation_difference(a: Innovation, b: Innovation) -> float:
    """NIS, and by landmark the residual in pixels and the gate's answer."""
    if not np.array_equal(np.sort(a.ids), np.sort(b.ids)):
        return np.inf
    i, j = np.argsort(a.ids), np.argsort(b.ids)
    if not np.array_equal(a.accepted[i], b.accepted[j]):
        return np.inf
    nis = abs(float(a.nis - b.nis)) / max(float(a.nis), 1.0)
    residual = np.nan_to_num(a.residual[i]) - np.nan_to_num(b.residual[j])
    return max(nis, _largest(residual))


def in_sigmas(a: Belief, b: Belief) -> float:
    """How far apart two estimates are, in standard deviations."""
    error = a.error(state_of(b))
    variances = np.concatenate(
        [np.diag(P) for name, P in covariances(a) if name != "joint"] or [np.ones(0)]
    )
    scale = np.sqrt(np.where(variances > 0, variances, 1.0))
    return _largest(error / scale)


def relative_difference(P: Array, Q: Array) -> float:
    """The largest difference of two covariances, in parts of two standard deviations."""
    sigma = np.sqrt(np.maximum(np.diag(P), np.diag(Q)))
    sigma = np.where(sigma > 0, sigma, 1.0)
    return _largest((P - Q) / np.outer(sigma, sigma))


def _largest(values: Array) -> float:
    """Of the magnitudes; infinite where one is NaN."""
    return float(np.nan_to_num(np.abs(values), nan=np.inf).max(initial=0.0))


def moved_along(belief: Belief, g: Array) -> Belief:
    """A belief after a rigid motion of the world, its covariances carried by its own chart."""
    state = state_of(belief)
    there = replace(
        belief,
        T_world_imu=g @ belief.T_world_imu,
        landmarks=se3.apply(g, belief.landmarks),
    )
    if not covariances(belief):
        return there
    size = 6 + 3 * len(belief.ids)
    here = derivative(lambda d: belief.error(varied(state, d)), size)
    B = derivative(lambda d: there.error(moved(varied(state, d), g)), size) @ np.linalg.pinv(here)
    P, P_pose, P_each = (
        belief.joint_covariance,
        belief.pose_covariance,
        belief.landmark_covariances,
    )
    pose = len(B) - 3 * len(belief.ids)
    each = [slice(k, k + 3) for k in range(pose, len(B), 3)][: len(P_each)]
    whole = block_diag(np.zeros((pose, pose)), *P_each) if P is None else P
    if P is None and P_pose is not None:
        whole[:6, :6] = P_pose
    whole = B @ whole @ B.T
    return replace(
        there,
        pose_covariance=None if P_pose is None else whole[:6, :6],
        landmark_covariances=np.reshape([whole[rows, rows] for rows in each], (-1, 3, 3)),
        joint_covariance=None if P is None else whole,
    )
