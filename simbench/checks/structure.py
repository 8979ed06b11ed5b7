"""Does a filter gain information that no measurement holds?

Moving the whole world, trajectory and map together, changes no measurement. Those six directions N
in a filter's error must stay unobservable: what it claims to know of them may not grow after the
start. A correct standard EKF-SLAM fails here, since it linearises each observation at another
estimate: that is a property of the method, and is reported as one.

White box: N is carried through the filter's own Jacobians. Rebuilt at the current estimate it would
tell nothing, for there H N = 0 holds for every filter; what has to hold is that the N of one step
becomes the N of the next. Black box: the information along N is read from the covariance.

Source: Huang, Mourikis, Roumeliotis, Observability-based rules for designing consistent EKF SLAM
estimators, IJRR 29(5), 2010.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag, eigh

from simbench.checks.chart import gauge
from simbench.checks.result import (
    MISTAKE,
    PROPERTY,
    CheckResult,
    FailureKind,
    NotApplicable,
    check,
    judged,
)
from simbench.checks.short_drive import ShortDrive
from simbench.checks.trace import Call, Feed, held, trace, white_box
from vislam.arrays import Array, IntArray
from vislam.filters import Factory
from vislam.filters.layout import POSE, rows_of
from vislam.filters.records import Augment, Correct, Drop, Linear
from vislam.gaussian import symmetrised
from vislam.types import Belief

#: A leak relative to the sizes of its factors. Right filters leave 1e-12, an adjoint without the
#: last term of its series 1e-6, which misleads nobody; real leaks start at 1e-4.
LEAK = 1e-5
#: Of the largest singular value: less is zero.
RANK = 1e-9
#: Growth of the information along N, in parts.
GAIN = 1e-6


@check
def null_space(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """White box: N, carried from the start through F, A and births, is in the null space of H."""
    calls = _white_box(factory, drive)
    carried, local = _leaks(calls)
    worst = max(carried, key=lambda leak: leak.size, default=Leak(where="", size=0.0))
    first = next((leak for leak in carried if leak.size > LEAK), worst)
    own = next((leak for leak in local if leak.size > LEAK), None)
    return judged(
        worst.size,
        LEAK,
        good=f"no information along the motions of the world in {len(carried)} steps",
        bad=f"{first.where} by {first.size:.2g}; "
        + (f"at the filter's own estimates {own.where}" if own else _METHOD),
        failure=lambda: _kind(own is not None),
    )


_METHOD = (
    "each Jacobian is right at the estimate of its moment, but updates move the estimate, and the "
    "covariance is not carried along"
)


@check
def nullity(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """White box: of all that was observed, exactly the six motions of the world stay open."""
    calls = _white_box(factory, drive)
    observed = _observability(calls)
    singular = np.linalg.svd(observed, compute_uv=False)
    rank = int(np.count_nonzero(singular > RANK * singular.max(initial=0.0)))
    open_ = observed.shape[1] - rank
    sixth = float(
        np.sort(np.append(singular, np.zeros(max(0, observed.shape[1] - len(observed)))))[5]
    )
    return judged(
        abs(open_ - 6),
        0,
        good="six directions stay unobservable, the motions of the world",
        bad=f"{open_} directions stay unobservable, expected the 6 motions of the world; the sixth "
        f"smallest singular value is {sixth / singular.max(initial=1e-300):.2g} of the largest",
        failure=lambda: _kind(any(leak.size > LEAK for leak in _leaks(calls)[1])),
    )


@check
def gauge_information(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """Black box: the information along the motions of the world never grows after the start.

    N is taken at the filter's estimates, or, as a filter may hold on to its first ones, at the
    pose as predicted and the landmarks as they entered; it has to do with one of the two.
    """
    gain, where = min(_gains(trace(factory, _feed(drive))))
    return judged(
        gain,
        GAIN,
        good="no call adds information along the motions of the world",
        bad=f"{where} adds information along a motion of the world, {100 * gain:.2g} % of what "
        "there is",
        failure=lambda: _kind(not _gain_without_noise(factory, drive) <= GAIN),
    )


def _feed(drive: ShortDrive | None, noise: float = 1.0) -> Feed:
    """Readings whose every sighting is taken in: a gate that refuses all would hide all."""
    feed = Feed.of(drive, noise).streamed()
    return replace(feed, task=replace(feed.task, gate=None))


def _white_box(factory: Factory, drive: ShortDrive | None) -> list[tuple[Call, Call]]:
    calls = white_box(factory, _feed(drive))
    records = [record for _, after in calls for record in after.records]
    if not any(len(record.observation.slots) for record in records if isinstance(record, Correct)):
        raise NotApplicable("the filter never took in a sighting of a landmark that it held")
    return calls


def _kind(mistake: bool) -> FailureKind:
    return MISTAKE if mistake else PROPERTY


def _gain_without_noise(factory: Factory, drive: ShortDrive | None) -> float:
    """Where all estimates are the truth, it does not matter at which a method linearises."""
    return min(_gains(trace(factory, _feed(drive, noise=0.0))))[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Leak:
    """How far a step is from keeping N.

    Attributes:
        where: the call, and which matrix, in words.
        size: relative to the sizes of the factors.
    """

    where: str
    size: float


_MOTION = "a motion of the world to something else"


def _leaks(calls: list[tuple[Call, Call]]) -> tuple[list[Leak], list[Leak]]:
    """The leaks of every record: of N carried, and of N rebuilt at the estimates of each moment."""
    centre = calls[0][0].belief.T_world_imu[:3, 3]
    N = gauge(calls[0][0].belief, centre)
    carried, local = [], []
    for before, after in calls:
        own, N_after = gauge(before.belief, centre), gauge(after.belief, centre)
        for record, ids in held(before, after):
            match record:
                case Correct():
                    carried.append(_seen(after, record, N))
                    local.append(_seen(after, record, own))
                case Augment():
                    newborn = N_after[6 + 3 * len(ids) :][: len(record.G)]
                    where = f"{after.name} lets a landmark in that does not move with the world"
                    carried.append(_difference(where, record.G @ N[:6], newborn))
                    local.append(_difference(where, record.G @ N_after[:6], newborn))
                    N, own = np.vstack([N, newborn]), np.vstack([own, newborn])
                case Drop():
                    N, own = _without(N, record.slots), _without(own, record.slots)
                case Linear():
                    N, own = record.carried(N), record.carried(own)
                    if after.name.startswith("predict"):
                        local.append(_difference(f"{after.name} moves {_MOTION}", own, N_after))
                    elif record.M is not None or record.D is not None:
                        # else it resets the pose alone, as some EKFs do
                        kept = N_after[: len(own)]
                        local.append(_difference(f"{after.name} transports {_MOTION}", own, kept))
    return carried, local


def _seen(call: Call, record: Correct, N: Array) -> Leak:
    """||H N|| / ||H||, with the columns of N of unit length."""
    H = observation_matrix(record, len(N))
    size = np.linalg.norm(H @ (N / np.linalg.norm(N, axis=0)))
    where = f"{call.name} takes a motion of the world for something it sees"
    return Leak(where=where, size=float(size / max(float(np.linalg.norm(H)), 1e-300)))


def _difference(where: str, got: Array, expected: Array) -> Leak:
    size = np.linalg.norm(got - expected) / max(float(np.linalg.norm(expected)), 1e-300)
    return Leak(where=where, size=float(size))


def observation_matrix(record: Correct, size: int) -> Array:
    """The whole H, shape (3k, size)."""
    seen, H = record.observation, np.zeros((len(record.observation.slots), 3, size))
    H[..., POSE] = seen.H_pose
    np.put_along_axis(H, rows_of(seen.slots)[:, None, :], seen.H_map, axis=-1)
    return H.reshape(-1, size)


def _without(rows: Array, slots: IntArray) -> Array:
    return np.delete(rows, rows_of(slots).ravel(), axis=0)


def _observability(calls: list[tuple[Call, Call]]) -> Array:
    """All that was observed, as functions of the pose at the start and of each landmark at birth.

    Rows H_k Phi(k, 0) of the updates, and of each birth its first sighting: 0 = m - G x.
    """
    Phi, rows = np.eye(6), [np.zeros((0, 6))]
    for _, after in calls:
        for record in after.records:
            match record:
                case Linear():
                    Phi = record.carried(Phi)
                case Correct():
                    rows.append(observation_matrix(record, len(Phi)) @ Phi)
                case Drop():
                    Phi = _without(Phi, record.slots)
                case Augment():
                    born = np.eye(len(record.G))
                    Phi = block_diag(Phi, born)
                    rows.append(np.hstack([-record.G @ Phi[:6, : -len(born) or None], born]))
    return np.vstack([np.pad(row, ((0, 0), (0, Phi.shape[1] - row.shape[1]))) for row in rows])


def _gains(calls: tuple[Call, ...]) -> tuple[tuple[float, str], tuple[float, str]]:
    """The largest growth of the information along N in a call, and which.

    With N at the filter's estimates, then at its first ones.
    """
    start = calls[0].belief
    if start.pose_covariance is None or start.joint_covariance is None:
        raise NotApplicable("the filter states no joint covariance of pose and landmarks")
    if np.linalg.matrix_rank(start.joint_covariance, hermitian=True) < len(start.joint_covariance):
        raise NotApplicable("the start is certain: the information is infinite as it is")
    centre = start.T_world_imu[:3, 3]
    at_estimates = [call.belief for call in calls]
    return (
        _gain(calls, [_information(belief, centre) for belief in at_estimates]),
        _gain(calls, [_information(belief, centre) for belief in _first_estimates(calls)]),
    )


def _first_estimates(calls: tuple[Call, ...]) -> Iterator[Belief]:
    """Each belief, with the pose as predicted and the landmarks as they entered."""
    T, landmarks = calls[0].belief.T_world_imu, dict[int, Array]()
    for call in calls:
        belief = call.belief
        if call.name.startswith("predict"):
            T = belief.T_world_imu
        for landmark, position in zip(belief.ids.tolist(), belief.landmarks, strict=True):
            landmarks.setdefault(landmark, position)
        first = np.reshape([landmarks[i] for i in belief.ids.tolist()], (-1, 3))
        yield replace(belief, T_world_imu=T, landmarks=first)


def _information(belief: Belief, centre: Array) -> Array | None:
    """N^T P^-1 N, shape (6, 6); None where P is singular or unknown."""
    N, P = gauge(belief, centre), belief.joint_covariance
    if P is None:
        return None
    try:
        return symmetrised(N.T @ np.linalg.solve(P, N))
    except np.linalg.LinAlgError:
        return None


def _gain(calls: tuple[Call, ...], information: list[Array | None]) -> tuple[float, str]:
    worst, where = 0.0, calls[0].name
    for call, (before, after) in zip(calls[1:], pairwise(information), strict=True):
        gain = np.inf
        if before is not None and after is not None and np.linalg.eigvalsh(before)[0] > 0:
            gain = float(eigh(after, before, eigvals_only=True)[-1]) - 1
        if not gain <= worst:
            worst, where = gain, call.name
    return worst, where
