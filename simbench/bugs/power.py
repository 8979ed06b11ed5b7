"""How often a check that needs many runs catches a bug, and what the bug does to accuracy.

Many runs of one short scene in which the right filters are consistent. Their noise alone differs,
and is the same for every filter: what two filters do is paired. Disjoint groups of them are judged
by the statistics of `simbench check`, each of its checks at a false-alarm level of its own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.special import bdtrik, betaincinv

from simbench.checks.montecarlo import (
    AGES,
    LAGS,
    ChiSquare,
    Innovations,
    RunSummary,
    instants,
)
from simbench.checks.nulls import Kind, statistics
from simbench.checks.short_drive import ShortDrive
from simbench.driving import Watch
from simbench.errors import FilterFailure, InputError
from simbench.metrics import nees
from simbench.rng import stream
from simbench.scenario import loads
from simbench.sensors import simulate
from vislam.arrays import Array, IntArray
from vislam.filters import Factory
from vislam.types import Belief, Innovation

#: Runs that are judged together.
SIZES = (1, 5, 20)
#: Runs of a batch: a multiple of each of the sizes.
BATCH = 5 * SIZES[-1]
#: The probability that a check fails a right filter; its statistics share it.
FALSE_ALARM = 0.01
#: Of the intervals.
CONFIDENCE = 0.95
#: The statistics of `simbench.checks.nulls` that make up a check.
KINDS: Mapping[str, frozenset[Kind]] = MappingProxyType(
    {
        "nees": frozenset({"pose", "map"}),
        "landmark-nees": frozenset({"newborn", "landmark"}),
        "nis": frozenset({"nis"}),
        "whiteness": frozenset({"whiteness"}),
        "nis-vs-dt": frozenset({"dt"}),
    }
)

#: The checks that need many runs.
COLUMNS = (*KINDS, "raises")

#: Little noise, so that the right filters are in their linear regime; else as `checks.scenes`.
SCENE = loads(
    """
name: power
seed: 11
duration_s: 3.0
rate_hz: 10.0
time_jitter: 0.89
trajectory:
  kind: straight
  speed_mps: 1.5
  roll_deg: 10.0
  pitch_deg: 8.0
  roll_period_s: 2.0
  pitch_period_s: 1.5
  start: {translation_m: [12.0, -8.0, 1.5], rotvec_deg: [20.0, -30.0, 140.0]}
rig:
  cx_px: 620.0
  cy_px: 600.0
  image_px: [1242, 1200]
  depth_m: [1.0, 8.0]
  imu_cam: {translation_m: [1.1, -0.3, 0.7], rotvec_deg: [4.0, -6.0, 3.0]}
imu:
  velocity: {sigma: [0.03, 0.06, 0.09]}
  angular_velocity: {sigma: [0.002, 0.003, 0.005]}
landmarks: {kind: path, count: 14, lateral_m: [0.3, 2.0], height_m: [-0.5, 0.8], ahead_m: 16}
camera: {sigma_px: [0.3, 0.5, 0.4, 0.2], dropout: 0.25, half_missing: 0.25}
filter: {process_noise: twist, gate: 0.999}
prior: {sigma_translation_m: 0.01, sigma_rotation_deg: 0.1}
""",
    where="scene power",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """How many of independent groups of runs a check fails.

    Attributes:
        runs: of a group.
        failed, groups: so many of so many.
    """

    runs: int
    failed: int
    groups: int

    @property
    def value(self) -> float:
        """The estimate of the probability."""
        return self.failed / self.groups

    @property
    def interval(self) -> tuple[float, float]:
        """Of the probability, two-sided at `CONFIDENCE` (Clopper, Pearson, Biometrika 26, 1934)."""
        k, n, tail = self.failed, self.groups, (1 - CONFIDENCE) / 2
        low = betaincinv(k, n - k + 1, tail) if k else 0.0
        high = betaincinv(k + 1, n - k, 1 - tail) if k < n else 1.0
        return float(low), float(high)

    def as_json(self) -> dict[str, Any]:
        """JSON-safe."""
        low, high = self.interval
        return {
            "runs": self.runs,
            "groups": self.groups,
            "power": self.value,
            "low": low,
            "high": high,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratio:
    """The median over runs of a ratio, and its interval at `CONFIDENCE`."""

    median: float
    low: float
    high: float


def runs_of(factory: Factory, runs: int) -> tuple[RunSummary, ...]:
    """Run a filter that declares `batched` in the scene.

    Args:
        factory: makes the filter.
        runs: how many, a multiple of `BATCH`.
    """
    if runs % BATCH or runs <= 0:
        raise InputError(f"--runs: expected a multiple of {BATCH}, got {runs}.")
    return tuple(run for batch in range(runs // BATCH) for run in _batch(factory, batch))


def powers(runs: Sequence[RunSummary]) -> dict[str, tuple[Share, ...]]:
    """By check, for each of `SIZES`: how many disjoint groups of so many runs fail."""
    failed = {check: np.zeros(len(SIZES), np.int64) for check in COLUMNS}
    for s, size in enumerate(SIZES):
        for first in range(0, len(runs), size):
            for check, p in p_values(runs[first : first + size]).items():
                failed[check][s] += p <= FALSE_ALARM
    return {
        check: tuple(
            Share(runs=size, failed=int(k), groups=len(runs) // size)
            for size, k in zip(SIZES, counts, strict=True)
        )
        for check, counts in failed.items()
    }


def p_values(runs: Sequence[RunSummary]) -> dict[str, float]:
    """Of each check that applies: the least of its statistics', times their number.

    A filter that raises fails `raises`; the other checks are of the runs that came to the end.
    """
    whole = [run for run in runs if run.failure is None]
    found = statistics(whole, drive().dataset.gate, outliers=False)
    tests = [test for _, test in found if not isinstance(test, str)]
    by_check = {check: [t.p for t in tests if t.kind in kinds] for check, kinds in KINDS.items()}
    ps = {check: len(p) * min(p) for check, p in by_check.items() if p}
    return ps | {"raises": 0.0} if len(whole) < len(runs) else ps


def ate_ratio(runs: Sequence[RunSummary], base: Sequence[RunSummary]) -> Ratio | None:
    """The ATE of each run over that of another filter on the same data; None where none is whole.

    The interval of the median is that of the sign test: between two order statistics.
    """
    ates = (
        (a.figures.get("ate_rmse_m"), b.figures.get("ate_rmse_m"))
        for a, b in zip(runs, base, strict=True)
    )
    ratios = np.sort([a / b for a, b in ates if a is not None and b])
    if not len(ratios):
        return None
    k = int(max(np.nan_to_num(bdtrik((1 - CONFIDENCE) / 2, len(ratios), 0.5)), 0))
    low, high = ratios[k], ratios[-1 - k]
    return Ratio(median=float(np.median(ratios)), low=float(low), high=float(high))


@cache
def drive() -> ShortDrive:
    """The scene's times, motion and sightings: one, so that groups differ by chance alone."""
    dataset = simulate(SCENE)
    return ShortDrive(dataset=dataset, frames=len(dataset))


def _batch(factory: Factory, batch: int) -> list[RunSummary]:
    w = stream(SCENE.seed, batch, "bugs.power").standard_normal((BATCH, drive().scalars))
    return _runs(factory, w, batch * BATCH)


def _runs(factory: Factory, w: Array, first: int) -> list[RunSummary]:
    """Drive the filter through runs at once; where one raises, halve until it is alone."""
    try:
        return _whole_runs(factory, w, first)
    except FilterFailure as error:
        if len(w) == 1:
            return [RunSummary(run=first, failure=str(error))]
    half = len(w) // 2
    return _runs(factory, w[:half], first) + _runs(factory, w[half:], first + half)


def _whole_runs(factory: Factory, w: Array, first: int) -> list[RunSummary]:
    readings, rng = drive().realise(w), stream(SCENE.seed, first, "bugs.power.filter")
    watch = Watch()
    filter_ = watch("start", factory, replace(drive().task, prior=readings.prior, rng=rng))
    at = instants(drive().frames).tolist()
    beliefs, innovations = [], []
    update: Callable[[Any], Any] = filter_.update
    for i, frame in enumerate(readings.frames):
        if i:
            tau = float(drive().intervals_s[i - 1])
            watch(f"predict {i - 1}", filter_.predict, readings.twists[i - 1], tau)
        innovations.append(watch(f"update {i}", update, frame))
        beliefs.append(watch(f"update {i}", filter_.belief, joint=i in at))
    return summaries(drive(), beliefs, innovations, first)


def summaries(
    drive: ShortDrive,
    beliefs: Sequence[Belief],
    innovations: Sequence[Innovation | None],
    first: int = 0,
) -> list[RunSummary]:
    """What `simbench.checks.montecarlo.summary` keeps of a run, for each run of a batch.

    Args:
        drive: the true motion and map.
        beliefs: after each frame, with one batch axis; with a joint covariance at the instants.
        innovations: of each frame.
        first: number of the first run; those that follow count on.
    """
    at = instants(drive.frames)
    pose, given_pose = _state_nees(drive, [(i, beliefs[i]) for i in at.tolist()])
    picks = stream(SCENE.seed, first, "bugs.power.landmark")
    landmark = _landmark_nees(drive, beliefs, picks)
    seen = _innovations(drive, [i for i in innovations[1:] if i is not None])
    T = np.stack([belief.T_world_imu for belief in beliefs], axis=1)
    apart_m = np.linalg.norm(T[..., :3, 3] - drive.T_world_imu[:, :3, 3], axis=-1)
    ate_m = np.sqrt(np.mean(apart_m**2, axis=-1))
    return [
        RunSummary(
            run=first + b,
            instants=at,
            pose=pose[b],
            map_given_pose=given_pose[b],
            landmark=landmark[b],
            innovations=seen[b],
            figures={"ate_rmse_m": float(ate_m[b])},
        )
        for b in range(len(T))
    ]


def _state_nees(
    drive: ShortDrive, beliefs: Sequence[tuple[int, Belief]]
) -> tuple[list[ChiSquare], list[ChiSquare]]:
    """NEES of the pose and of the map given the pose, each of shape (instants,), run by run."""
    pose, given_pose, map_dof = [], [], []
    for i, belief in beliefs:
        assert belief.pose_covariance is not None
        assert belief.joint_covariance is not None
        error = belief.error(drive.state(i))
        of_pose = nees(error[..., :6], belief.pose_covariance)
        joint = nees(error, belief.joint_covariance)
        lost = np.isinf(joint) | np.isinf(of_pose)
        pose.append(of_pose)
        given_pose.append(np.where(lost, joint, joint - np.where(lost, 0, of_pose)))
        map_dof.append(3 * len(belief.ids))
    pose_dof = np.full(len(pose), 6)
    return (
        _by_run(np.stack(pose, axis=-1), pose_dof),
        _by_run(np.stack(given_pose, axis=-1) * (np.array(map_dof) > 0), np.array(map_dof)),
    )


def _landmark_nees(
    drive: ShortDrive, beliefs: Sequence[Belief], picks: np.random.Generator
) -> list[ChiSquare]:
    """NEES of one landmark of each age class, shape (len(AGES),), run by run."""
    frames = np.repeat(range(len(beliefs)), [len(belief.ids) for belief in beliefs])
    slots = np.concatenate([np.arange(len(belief.ids)) for belief in beliefs])
    ids = np.concatenate([belief.ids for belief in beliefs])
    _, first, which = np.unique(ids, return_index=True, return_inverse=True)
    age = frames - frames[first][which]
    errors = [belief.error(drive.state(i)) for i, belief in enumerate(beliefs)]
    batch = len(errors[0])
    value, dof = np.zeros((batch, len(AGES))), np.zeros(len(AGES), np.int64)
    for k, (youngest, oldest) in enumerate(AGES.values()):
        candidates = np.flatnonzero((youngest <= age) & (age <= oldest))
        if not len(candidates):
            continue
        e, P = np.empty((batch, 3)), np.empty((batch, 3, 3))
        for b, one in enumerate(picks.choice(candidates, batch).tolist()):
            frame, slot = frames[one], slots[one]
            e[b] = errors[frame][b, 6 + 3 * slot : 9 + 3 * slot]
            P[b] = beliefs[frame].landmark_covariances[b, slot]
        value[:, k], dof[k] = nees(e, P), 3
    return _by_run(value, dof)


def _by_run(value: Array, dof: IntArray) -> list[ChiSquare]:
    return [ChiSquare(value=one, dof=dof) for one in value]


def _innovations(drive: ShortDrive, innovations: Sequence[Innovation]) -> list[Innovations]:
    """What the innovations after the first frame leave behind, run by run."""
    value = np.stack([i.nis for i in innovations], axis=-1)
    dof = np.stack([i.dof for i in innovations], axis=-1)
    rejected = np.stack([i.rejected for i in innovations], axis=-1)
    tested = np.array([len(i.ids) for i in innovations])
    correlation, pairs = _correlation(innovations)
    return [
        Innovations(
            dt_s=drive.intervals_s,
            nis=ChiSquare(value=value[b], dof=dof[b]),
            tested=tested,
            rejected=rejected[b],
            correlation=correlation[b],
            pairs=pairs[b],
        )
        for b in range(len(value))
    ]


def _correlation(innovations: Sequence[Innovation]) -> tuple[Array, IntArray]:
    """The products of `simbench.metrics.whiteness` over their power, and pairs: shape (B, LAGS)."""
    batch = len(innovations[0].whitened)
    products, pairs = np.zeros((batch, LAGS)), np.zeros((batch, LAGS), np.int64)
    for lag in range(1, LAGS + 1):
        for now, later in zip(innovations[:-lag], innovations[lag:], strict=True):
            _, a, b = np.intersect1d(now.ids, later.ids, assume_unique=True, return_indices=True)
            product = now.whitened[..., a, :] * later.whitened[..., b, :]
            products[:, lag - 1] += product.sum(axis=(-2, -1))
            both = now.accepted[..., a] & later.accepted[..., b]
            pairs[:, lag - 1] += 4 * np.count_nonzero(both, axis=-1)
    squares = sum(i.nis for i in innovations)
    numbers = sum(i.dof for i in innovations)
    power = np.asarray(squares / np.maximum(numbers, 1))
    return products / np.where(power > 0, power, 1)[:, None], pairs
