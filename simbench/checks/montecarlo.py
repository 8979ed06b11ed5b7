"""Does the method hold in a scene? Many runs at its real noise, each boiled down to a summary.

What a summary keeps is what a null distribution is known for. Over independent runs of a right
filter, in the linear regime:

- the pose's NEES at one instant is chi-square with 6 degrees of freedom;
- the joint NEES of pose and living landmarks less the pose's is the NEES of the map given the pose,
  chi-square with 3 degrees for each landmark, and independent of the pose's;
- the NEES of one landmark of a run is chi-square with 3 (two of one run would be correlated);
- NIS is chi-square at every frame, and independent from frame to frame.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from joblib import Parallel, delayed
from scipy.special import chdtri
from threadpoolctl import threadpool_limits

from simbench.dataset import Dataset, Truth
from simbench.driving import Watch, checked, error_of
from simbench.errors import FilterFailure, InputError
from simbench.filters import resolve
from simbench.metrics import (
    DIVERGED,
    POSE_ERRORS,
    RANK_TOLERANCE,
    ate,
    metrics,
    nees,
    nis,
    rmse,
    whiteness,
)
from simbench.rng import stream
from simbench.run import RunRecord, Step, run
from simbench.scenario import Scenario
from simbench.sensors import simulate
from vislam.arrays import Array, IntArray
from vislam.filters import Factory, Filter
from vislam.types import Task

#: NEES is taken at so many instants, evenly over the frames.
INSTANTS = 5
#: Lags of the autocorrelation of innovations, frames.
LAGS = 5
#: Frames that a landmark has been in the state, from and to.
AGES: Mapping[str, tuple[int, float]] = {"newborn": (0, 0), "young": (1, 9), "old": (10, np.inf)}
#: A position within its own ellipsoid of this probability is no surprise.
SETTLED = 0.999


@dataclass(frozen=True, slots=True, kw_only=True)
class ChiSquare:
    """Values that are chi-square under a right filter, with their degrees; 0 of 0 for none."""

    value: Array
    dof: IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Innovations:
    """What the innovations of a run leave behind; all frames after the first.

    Attributes:
        dt_s: time since the frame before, shape (T - 1,).
        nis: of the accepted sightings, with its degrees of freedom, shape (T - 1,).
        tested, rejected: sightings that met the gate, and that it refused, shape (T - 1,).
        correlation, pairs: sum of products of whitened innovations at lag 1, 2, .., over their
            power, and of how many, shape (LAGS,).
    """

    dt_s: Array
    nis: ChiSquare
    tested: IntArray
    rejected: IntArray
    correlation: Array
    pairs: IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """What a verdict needs of one run.

    Attributes:
        run: its number.
        failure: the call that raised and what, None where the filter came to the end; then the rest
            is there.
        instants: frames at which NEES was taken, shape (k,).
        pose, map_given_pose: NEES there, shape (k,).
        landmark: NEES of one landmark of each age class, drawn from the run, shape (len(AGES),).
        innovations: None where the filter reports none.
        figures: of the run, by name; None where one does not apply.
    """

    run: int
    failure: str | None = None
    instants: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    pose: ChiSquare | None = None
    map_given_pose: ChiSquare | None = None
    landmark: ChiSquare | None = None
    innovations: Innovations | None = None
    figures: Mapping[str, float | None] = field(default_factory=dict)


def monte_carlo(
    scenario: Scenario,
    factory: Factory | str,
    runs: Iterable[int],
    *,
    seed: int | None = None,
    jobs: int = 1,
) -> tuple[RunSummary, ...]:
    """Run a filter over independent runs of a scene.

    A summary depends on the scene, the seed and the run's number alone: not on the other runs, nor
    on how many processes share the work.

    Args:
        scenario: the scene.
        factory: makes the filter, or the name of one that every process can resolve.
        runs: their numbers; each has noise, start and times of its own.
        seed: instead of the scene's own.
        jobs: processes, -1 for one a core; each uses one thread.
    """
    one = delayed(partial(_one_run, scenario, factory, seed))
    return tuple(Parallel(n_jobs=jobs)(map(one, runs)))


def _one_run(scenario: Scenario, factory: Factory | str, seed: int | None, run: int) -> RunSummary:
    made = resolve(factory) if isinstance(factory, str) else factory
    with threadpool_limits(limits=1):
        return summary(simulate(scenario, seed, run), made, run)


def summary(dataset: Dataset, factory: Factory, number: int = 0) -> RunSummary:
    """Run a filter over simulated data, and keep what a verdict needs.

    Args:
        dataset: with its truth.
        factory: makes the filter.
        number: of the run.
    """
    probe = _Probe(dataset, factory)
    try:
        record = run(dataset, probe.make, on_step=probe.on_step)
    except FilterFailure as failure:
        return RunSummary(run=number, failure=str(failure))
    return RunSummary(
        run=number,
        instants=instants(len(dataset)),
        pose=_chi_square(probe.pose),
        map_given_pose=_chi_square(probe.map_given_pose),
        landmark=_landmark_nees(record),
        innovations=_innovations(record),
        figures=_figures(record),
    )


class _Probe:
    """Takes NEES at the instants, and asks the filter for its joint covariance only there."""

    def __init__(self, dataset: Dataset, factory: Factory) -> None:
        self._dataset, self._factory = dataset, factory
        self._at = set(instants(len(dataset)).tolist())
        self._filter: Filter | None = None
        self.pose: list[tuple[float, int]] = []
        self.map_given_pose: list[tuple[float, int]] = []

    def make(self, task: Task) -> Filter:
        self._filter = self._factory(task)
        return self._filter

    def on_step(self, step: Step) -> None:
        if step.frame not in self._at or self._filter is None:
            return
        call = f"update {step.frame}"
        belief = checked(call, Watch()(call, self._filter.belief, joint=True))
        error = error_of(call, belief, _truth(self._dataset).state(step.frame))
        pose = joint = (0.0, 0)
        if belief.pose_covariance is not None:
            pose = _nees(error[:6], belief.pose_covariance)
        self.pose.append(pose)
        if belief.joint_covariance is not None and len(belief.ids):
            joint = _nees(error, belief.joint_covariance)
        self.map_given_pose.append(_rest(joint, pose))


def instants(frames: int) -> IntArray:
    """The frames at which NEES is taken; at the last one every landmark leaves the state."""
    return np.unique(np.linspace(0, max(frames - 2, 0), INSTANTS).round().astype(np.int64))


def _truth(dataset: Dataset) -> Truth:
    if dataset.truth is None:
        raise InputError(f"{dataset.name}: expected simulated data: a verdict needs the truth.")
    return dataset.truth


def _nees(error: Array, P: Array) -> tuple[float, int]:
    """NEES and its degrees of freedom, the rank of P."""
    sigma = np.sqrt(np.where(np.diag(P) > 0, np.diag(P), 1.0))
    value = float(nees(error, P))
    if np.isinf(value):
        return value, len(P)
    C = P / np.outer(sigma, sigma)
    return value, int(np.linalg.matrix_rank(C, rtol=RANK_TOLERANCE, hermitian=True))


def _rest(joint: tuple[float, int], pose: tuple[float, int]) -> tuple[float, int]:
    """What the joint NEES holds beside the pose's; 0 of 0 where the filter gives no joint one."""
    dof = joint[1] - pose[1]
    if dof <= 0:
        return 0.0, 0
    return (joint[0] if np.isinf(joint[0]) else joint[0] - pose[0]), dof


def _chi_square(pairs: Iterable[tuple[float, int]]) -> ChiSquare:
    value, dof = zip(*pairs, strict=True)
    return ChiSquare(value=np.array(value), dof=np.array(dof))


def _landmark_nees(record: RunRecord) -> ChiSquare:
    """NEES of one landmark of each age class: of one row of the run's beliefs, all alike likely."""
    frames = np.repeat(range(len(record.steps)), [len(s.belief.ids) for s in record.steps])
    ids = np.concatenate([step.belief.ids for step in record.steps])
    _, first, which = np.unique(ids, return_index=True, return_inverse=True)
    age = frames - frames[first][which]
    origin = record.dataset.origin
    seed, number = (0, 0) if origin is None else (origin.seed, origin.run)
    found = []
    for name, (youngest, oldest) in AGES.items():
        candidates = np.flatnonzero((youngest <= age) & (age <= oldest))
        if not len(candidates):
            found.append((0.0, 0))
            continue
        one = stream(seed, number, "check.landmark", name).choice(candidates)
        found.append(_nees_of_landmark(record, int(frames[one]), int(ids[one])))
    return _chi_square(found)


def _nees_of_landmark(record: RunRecord, frame: int, landmark: int) -> tuple[float, int]:
    belief = record.steps[frame].belief
    if len(belief.landmark_covariances) != len(belief.ids):
        return 0.0, 0
    slot = int(np.flatnonzero(belief.ids == landmark)[0])
    map_error = belief.error(_truth(record.dataset).state(frame))[-3 * len(belief.ids) :]
    return _nees(map_error.reshape(-1, 3)[slot], belief.landmark_covariances[slot])


def _innovations(record: RunRecord) -> Innovations | None:
    steps = [step.innovation for step in record.steps[1:]]
    if all(i is None for i in steps):
        return None
    value, dof = nis(record)
    white = whiteness(steps, LAGS)
    return Innovations(
        dt_s=np.diff(record.dataset.times_s),
        nis=ChiSquare(value=value[1:], dof=dof[1:]),
        tested=np.array([0 if i is None else len(i.ids) for i in steps]),
        rejected=np.array([0 if i is None else int(i.rejected) for i in steps]),
        correlation=np.nan_to_num(white.autocorrelation) * white.pairs,
        pairs=white.pairs,
    )


def _figures(record: RunRecord) -> dict[str, float | None]:
    """Of accuracy; there is no null for them, so they are reported and not judged."""
    known = metrics(record)
    figures = {name: known[name] for name in (*POSE_ERRORS, "landmark_rmse_m")}
    yaw = ate(record.T_world_imu, _truth(record.dataset).T_world_imu, "yaw")
    figures["ate_rmse_yaw_aligned_m"] = rmse(yaw.translation_m)
    errors, covariances = record.pose_errors, record.pose_covariances
    figures["settled_s"] = figures["diverged"] = None
    if errors is not None and covariances is not None:
        position = nees(errors[:, :3], covariances[:, :3, :3])
        outside = np.flatnonzero(position > chdtri(3, 1 - SETTLED))
        settled = int(outside[-1]) + 1 if len(outside) else 0
        times_s = record.dataset.times_s
        if settled < len(times_s):
            figures["settled_s"] = float(times_s[settled] - times_s[0])
        figures["diverged"] = float(nees(errors[-1], covariances[-1]) > chdtri(6, DIVERGED))
    return {k: None if v is None else float(v) for k, v in figures.items()}
