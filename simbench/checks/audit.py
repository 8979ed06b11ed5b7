"""Is the code right? The exact audit: a claimed covariance against the errors' second moment.

The errors of a filter after a call are a smooth function e(w) of the noise w, standardised. For
small noise e = J w, and the covariance that the filter claims must be J J^T. A design of vectors w
whose second moment is exactly the identity (the rows of a Hadamard matrix, with both signs) gives
J J^T from finitely many runs: there is no chance in it, and so no false alarm. Only the noise that
is realised is made small, by eps; the filter is told the real one, so its gates stay open and its
constants are judged as they are.

What remains of the difference between claim and second moment falls as eps^2 where it is
nonlinearity, and stays where it is a mistake. The first call after which something stays says where
the mistake is. The filter is a black box: nothing of it is differentiated by hand.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import hadamard
from threadpoolctl import threadpool_limits

from simbench.checks.findings import AuditResult, Deviations, Finding, SceneAudit
from simbench.checks.result import NotApplicable
from simbench.checks.scenes import SCENES, drive
from simbench.checks.short_drive import Readings, ShortDrive
from simbench.checks.trace import driven
from simbench.driving import error_of
from simbench.errors import FilterFailure, InputError
from vislam.arrays import Array, BoolArray
from vislam.filters import Factory
from vislam.filters.layout import diagonal_blocks
from vislam.types import Belief

EPS = (1e-2, 1e-3, 1e-4)
#: What may remain when eps goes to zero. Rounding leaves 1e-7. A covariance that is off by less
#: than a ten-thousandth misleads nobody: an adjoint without its series' last term is, by 2e-5.
TOLERANCE = 1e-4
#: Without noise a right filter stands on the truth to rounding, metres and radians.
STANDSTILL = 1e-8
#: A variance that errors of rounding alone have, once divided by eps^2: 1e-12 at eps = 1e-4.
ROUNDING = 1e-16
#: Runs of one batch: as many as keep the state of a small scene in the processor's cache.
BATCH = 256


def audit(factory: Factory, drives: Iterable[ShortDrive] | None = None) -> AuditResult:
    """Audit a filter on several scenes, by default on those of `simbench.checks.scenes`."""
    if drives is None:
        drives = map(drive, SCENES)
    return AuditResult(scenes=tuple(audit_drive(factory, each) for each in drives))


def audit_drive(factory: Factory, drive: ShortDrive, eps: tuple[float, ...] = EPS) -> SceneAudit:
    """Audit a filter on a short drive.

    Args:
        factory: makes the filter.
        drive: the scene.
        eps: scales of the realised noise, falling; the last two decide what vanishes.

    Raises:
        InputError: the filter asks for raw IMU samples.
    """

    def result(first: Finding | None, *deviations: Deviations) -> SceneAudit:
        return SceneAudit(
            scene=drive.dataset.name, first=first, deviations=deviations, scalars=drive.scalars
        )

    try:
        with threadpool_limits(limits=1, user_api="blas"):
            claims = tuple(_calls(factory, drive, drive.realise(np.zeros(drive.scalars))))
            for claim in claims:
                if (finding := _without_noise(claim, drive)) is not None:
                    return result(finding)
            if not any(_claimed(claim.belief)[1].any() for claim in claims):
                reason = "claims no covariance, all along: there is nothing to audit"
                return result(Finding(call="start", block="covariance", reason=reason))
            moments = [_Moments.of(factory, drive, claims, scale) for scale in eps]
    except NotApplicable as why:
        raise InputError(
            f"Expected a filter that takes twists, which is what an audit feeds; this one {why}."
        ) from why
    except FilterFailure as failure:
        return result(Finding(call=failure.call, block="exception", reason=failure.reason))
    return result(_first(claims, *moments[-2:]), *(_deviations(claims, each) for each in moments))


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """What a filter held after a call.

    Attributes:
        name: of the call.
        frame: the index of the true state that it is compared with.
        belief: after the call.
        whitened: of an update with an innovation, flat, shape (..., j).
    """

    name: str
    frame: int
    belief: Belief
    whitened: Array | None


def _calls(factory: Factory, drive: ShortDrive, readings: Readings) -> Iterator[Call]:
    """Run a filter, and give what it holds after each call."""
    filter_ = driven(factory, replace(drive.task, prior=readings.prior))
    batch = readings.prior.T_world_imu.shape[:-2]
    for done in filter_.feed(drive.inputs(readings)):
        belief, whitened = filter_.belief(done.name, joint=True), None
        if done.innovation is not None:
            each = done.innovation.whitened.shape[-2:]
            whitened = np.broadcast_to(done.innovation.whitened, (*batch, *each))
            whitened = whitened.reshape(*batch, each[0] * each[1])
        yield Call(name=done.name, frame=done.frame, belief=belief, whitened=whitened)
    if (end := filter_.finish()) is not None:
        yield Call(name="finish", frame=drive.frames - 1, belief=end.final, whitened=None)


def _without_noise(claim: Call, drive: ShortDrive) -> Finding | None:
    """A filter that is given no noise at all has no excuse for an error."""
    worst = np.abs(error_of(claim.name, claim.belief, drive.state(claim.frame))).max(initial=0.0)
    if worst < STANDSTILL:
        return None
    return Finding(
        call=claim.name,
        block="estimate",
        reason=f"is wrong even without noise: the error is {worst:.3g}",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Moments:
    """Second moments over the design, divided by eps^2.

    Attributes:
        eps: scale of the realised noise.
        errors: of the error vector after each call, shapes (d, d).
        whitened: of the whitened innovations of all updates in one vector, shape (j, j).
    """

    eps: float
    errors: tuple[Array, ...]
    whitened: Array

    @classmethod
    def of(
        cls, factory: Factory, drive: ShortDrive, claims: tuple[Call, ...], eps: float
    ) -> "_Moments":
        errors: list[Array] = []
        whitened: Array | float = 0.0
        design = _design(drive.scalars)
        for w in _batches(factory, drive, eps * design):
            runs = tuple(_calls(factory, drive, drive.realise(w)))
            sums = [
                _gram(_error(call, claim, drive)) for call, claim in zip(runs, claims, strict=True)
            ]
            errors = [a + b for a, b in zip(errors, sums, strict=True)] if errors else sums
            innovations = [call.whitened for call in runs if call.whitened is not None]
            whitened = whitened + _gram(
                np.concatenate([np.empty((*w.shape[:-1], 0)), *innovations], -1)
            )
        scale = eps**2 * len(design)
        return cls(
            eps=eps, errors=tuple(e / scale for e in errors), whitened=np.asarray(whitened / scale)
        )


def _design(scalars: int) -> Array:
    """Vectors whose second moment is the identity, of both signs: shape (2n, N)."""
    order = 1 << max(scalars - 1, 0).bit_length()
    rows = hadamard(order, dtype=float)[:, :scalars]
    return np.concatenate([rows, -rows])


def _batches(factory: Factory, drive: ShortDrive, w: Array) -> Iterator[Array]:
    """The runs as the filter takes them: many along a batch axis, or one by one."""
    if driven(factory, drive.task).batched:
        yield from np.array_split(w, -(-len(w) // BATCH))
    else:
        yield from w


def _error(call: Call, claim: Call, drive: ShortDrive) -> Array:
    if not np.array_equal(call.belief.ids, claim.belief.ids):
        raise FilterFailure(
            call.name,
            "holds other landmarks, or in another order, when the noise differs by a thousandth "
            f"of a sigma: {call.belief.ids.tolist()} instead of {claim.belief.ids.tolist()}",
        )
    return error_of(call.name, call.belief, drive.state(call.frame))


def _gram(vectors: Array) -> Array:
    """Sum of v v^T over the leading axis, if there is one."""
    rows = np.atleast_2d(vectors)
    return np.asarray(rows.T @ rows)


def _claimed(belief: Belief) -> tuple[Array, BoolArray]:
    """The covariance that a belief claims, and which elements it says."""
    if belief.joint_covariance is not None:
        return belief.joint_covariance, np.ones(belief.joint_covariance.shape, bool)
    pose = 0 if belief.pose_covariance is None else 6
    P = np.zeros((pose + 3 * len(belief.ids), pose + 3 * len(belief.ids)))
    said = np.zeros(P.shape, bool)
    if belief.pose_covariance is not None:
        P[:6, :6], said[:6, :6] = belief.pose_covariance, True
    if len(belief.landmark_covariances):
        diagonal_blocks(P[pose:, pose:])[...] = belief.landmark_covariances
        diagonal_blocks(said[pose:, pose:])[...] = True
    return P, said


def _relative(true: Array, claimed: Array, said: BoolArray) -> Array:
    """Difference over the two standard deviations, as claimed, or as true; 0 where not said."""
    variance = np.where(np.diag(claimed) > 0, np.diag(claimed), np.diag(true))
    sigma = np.sqrt(np.where(variance > ROUNDING, variance, 1.0))
    return np.where(said, (true - claimed) / np.outer(sigma, sigma), 0.0)


def _limit(large: Array, small: Array, eps: tuple[float, float]) -> Array:
    """What a + b eps^2 through two values is at eps = 0."""
    a, b = eps[0] ** 2, eps[1] ** 2
    return np.asarray((a * small - b * large) / (a - b))


def _first(claims: tuple[Call, ...], large: _Moments, small: _Moments) -> Finding | None:
    """The first call whose deviation does not vanish with eps."""
    eps = (large.eps, small.eps)
    whitened = _limit(large.whitened, small.whitened, eps)
    birth: dict[int, int] = {}
    seen = 0
    for k, claim in enumerate(claims):
        for landmark in claim.belief.ids.tolist():
            birth.setdefault(landmark, claim.frame)
        true = _limit(large.errors[k], small.errors[k], eps)
        finding = _worst(claim, true, birth)
        if finding is not None:
            return finding
        if claim.whitened is not None:
            rows = slice(seen, seen + claim.whitened.shape[-1])
            seen = rows.stop
            finding = _innovation(claim, whitened[rows, :seen])
            if finding is not None:
                return finding
    return None


def _worst(claim: Call, true: Array, birth: dict[int, int]) -> Finding | None:
    claimed, said = _claimed(claim.belief)
    deviation = _relative(true, claimed, said)
    if not deviation.size or np.abs(deviation).max() < TOLERANCE:
        return None
    i, j = sorted(map(int, np.unravel_index(np.abs(deviation).argmax(), deviation.shape)))
    return Finding(
        call=claim.name,
        block=_block(claim, i, j, birth),
        claimed=float(claimed[i, j]),
        true=float(true[i, j]),
        deviation=float(deviation[i, j]),
    )


def _block(claim: Call, i: int, j: int, birth: dict[int, int]) -> str:
    """The name of the block that element (i, j) lies in."""
    pose = 0 if claim.belief.pose_covariance is None else 6

    def age(element: int) -> int:
        return claim.frame - birth[int(claim.belief.ids[(element - pose) // 3])]

    if j < pose:
        return "pose covariance"
    if i < pose:
        return f"pose-landmark cross-covariance (landmark of age {age(j)})"
    if (i - pose) // 3 == (j - pose) // 3:
        return f"landmark covariance (age {age(i)})"
    return f"landmark-landmark cross-covariance (ages {age(i)} and {age(j)})"


def _innovation(claim: Call, moment: Array) -> Finding | None:
    """Rows of the whitened innovations' second moment, up to and with this update's own."""
    rows = len(moment)
    expected = np.eye(rows, moment.shape[1], k=moment.shape[1] - rows)
    difference = np.abs(moment - expected)
    if not difference.size or difference.max() < TOLERANCE:
        return None
    i, j = np.unravel_index(difference.argmax(), difference.shape)
    own = j >= moment.shape[1] - rows
    return Finding(
        call=claim.name,
        block="innovation covariance" if own else "innovation whiteness",
        claimed=float(expected[i, j]),
        true=float(moment[i, j]),
        deviation=float(moment[i, j] - expected[i, j]),
    )


def _deviations(claims: tuple[Call, ...], moments: _Moments) -> Deviations:
    """The worst of each figure over all calls."""
    block, pose, joint, nis = [0.0], [], [], []
    seen = 0
    whitened = moments.whitened - np.eye(len(moments.whitened))
    for claim, true in zip(claims, moments.errors, strict=True):
        claimed, said = _claimed(claim.belief)
        block.append(float(np.abs(_relative(true, claimed, said)).max(initial=0.0)))
        if claim.belief.pose_covariance is not None:
            pose.append(_excess(true[:6, :6], claimed[:6, :6]))
        if claim.belief.joint_covariance is not None:
            joint.append(_excess(true, claimed))
        if claim.whitened is not None and claim.whitened.size:
            rows = slice(seen, seen + claim.whitened.shape[-1])
            seen = rows.stop
            nis.append(float(np.trace(whitened[rows, rows])) / len(claim.whitened))
            whitened[rows, rows] = 0.0
    return Deviations(
        eps=moments.eps,
        block=max(block),
        pose_nees=max(pose, key=abs, default=None),
        joint_nees=max(joint, key=abs, default=None),
        nis=max(nis, key=abs, default=None),
        whiteness=float(np.abs(whitened).max()) if nis else None,
    )


def _excess(true: Array, claimed: Array) -> float:
    """Mean NEES minus its degrees of freedom, on what the claim knows to be uncertain."""
    return float(np.trace(np.linalg.pinv(claimed, hermitian=True) @ true)) - int(
        np.linalg.matrix_rank(claimed, hermitian=True)
    )
