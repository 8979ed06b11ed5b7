"""Drives a filter over a dataset, in time order, and records what it held true at every frame."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from simbench.dataset import Dataset
from simbench.errors import FilterFailure
from simbench.rng import stream
from vislam.arrays import Array
from vislam.filters.protocol import Factory, Filter, Finishing
from vislam.types import Belief, ImuSample, Innovation, Task, Twist

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One frame of a run.

    Attributes:
        frame: its index.
        belief: the belief after the frame's update, of pose and living landmarks.
        innovation: what the update said, or None.
    """

    frame: int
    belief: Belief
    innovation: Innovation | None


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRecord:
    """What a filter made of a dataset.

    Attributes:
        dataset: the data.
        filter: the filter's name.
        steps: one for each frame.
        final: the belief at the end, over all landmarks that were ever in the state.
        wall_s: time spent in the filter's own calls.
    """

    dataset: Dataset
    filter: str
    steps: tuple[Step, ...]
    final: Belief
    wall_s: float

    @property
    def T_world_imu(self) -> Array:
        """The estimated poses at the frames, shape (T, 4, 4)."""
        return np.stack([step.belief.T_world_imu for step in self.steps])

    @property
    def pose_covariances(self) -> Array | None:
        """Their covariances, shape (T, 6, 6); None where the filter does not estimate the pose."""
        covariances = [step.belief.pose_covariance for step in self.steps]
        known = [P for P in covariances if P is not None]
        return np.stack(known) if len(known) == len(covariances) else None

    @property
    def pose_errors(self) -> Array | None:
        """Their errors in the filter's own chart, shape (T, 6); None where the truth is unknown."""
        truth = self.dataset.truth
        if truth is None:
            return None
        return np.stack(
            [step.belief.pose_error(truth.T_world_imu[step.frame]) for step in self.steps]
        )


def task_of(dataset: Dataset) -> Task:
    """What a filter is told of a dataset."""
    origin = dataset.origin
    return Task(
        calibration=dataset.calibration,
        noise=dataset.noise,
        prior=dataset.prior,
        gate=dataset.gate,
        trajectory=None if dataset.truth is None else dataset.truth.T_world_imu,
        rng=stream(origin.seed if origin else 0, origin.run if origin else 0, "filter"),
    )


def run(
    dataset: Dataset,
    factory: Factory,
    *,
    name: str = "filter",
    on_step: Callable[[Step], None] = lambda _: None,
) -> RunRecord:
    """Run a filter over a dataset, with one BLAS thread.

    The matrices of a frame are small: a second thread gains nothing there, and where another
    process uses the cores it makes an update many times slower.

    Args:
        dataset: the data.
        factory: makes the filter.
        name: of the filter, for the record.
        on_step: called after each frame, outside the measured time: to show progress, or to write
            while the run goes on.

    Raises:
        FilterFailure: the filter raised, is none, or returned what it must not: a pose that is not
            finite or not of shape (4, 4), say.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        watch = Watch()
        filter_ = _started(watch, factory, dataset)
        predict: Callable[[Any, float], None] = filter_.predict
        raw = getattr(filter_, "motion", "twist") == "imu"
        steps = []
        for i in range(len(dataset)):
            call = f"update {i}"
            innovation = watch(call, filter_.update, dataset.frame(i))
            if not isinstance(innovation, Innovation | None):
                kind = type(innovation).__name__
                raise FilterFailure(call, f"returned {kind}: expected an Innovation or None")
            belief = _checked(call, watch(call, filter_.belief))
            step = Step(frame=i, belief=belief, innovation=innovation)
            steps.append(step)
            on_step(step)
            if i + 1 < len(dataset):
                for motion, dt in _motions(dataset, i, raw):
                    watch(f"predict {i}", predict, motion, dt)
        final = steps[-1].belief
        if isinstance(filter_, Finishing):
            final = _checked("finish", watch("finish", filter_.finish))
        return RunRecord(
            dataset=dataset, filter=name, steps=tuple(steps), final=final, wall_s=watch.total_s
        )


def _started(watch: "Watch", factory: Factory, dataset: Dataset) -> Filter:
    filter_ = watch("start", factory, task_of(dataset))
    calls = ("predict", "update", "belief")
    if lacking := [call for call in calls if not callable(getattr(filter_, call, None))]:
        kind, methods = type(filter_).__name__, ", ".join(lacking)
        raise FilterFailure("start", f"gave what is no filter: {kind} has no method {methods}")
    return filter_


class Watch:
    """Calls into the filter under test: adds up their time, and names the call that raises."""

    def __init__(self) -> None:
        self.total_s = 0.0

    def __call__(self, call: str, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Call the function, under the name `call`.

        Raises:
            FilterFailure: it raised.
        """
        start = time.perf_counter()
        try:
            return function(*args, **kwargs)
        except Exception as error:
            raise FilterFailure(call, f"raised {type(error).__name__}: {error}") from error
        finally:
            self.total_s += time.perf_counter() - start


def _checked(call: str, belief: Belief) -> Belief:
    if not isinstance(belief, Belief):
        raise FilterFailure(call, f"left {type(belief).__name__}: expected a vislam.types.Belief")
    shape = np.shape(belief.T_world_imu)
    if shape != (4, 4) or not np.isfinite(belief.T_world_imu).all():
        raise FilterFailure(
            call,
            "left a pose that is not usable: expected finite numbers of shape (4, 4), got shape "
            f"{shape}: {np.array2string(np.asarray(belief.T_world_imu), precision=3)}",
        )
    return belief


def _motions(dataset: Dataset, i: int, raw: bool) -> Iterator[tuple[Twist | ImuSample, float]]:
    """What a filter is fed from frame i to the next: the twist sample, or the raw ones."""
    if raw:
        yield from _imu_motions(dataset, i)
    else:
        yield dataset.twist(i), float(dataset.times_s[i + 1] - dataset.times_s[i])


def _imu_motions(dataset: Dataset, i: int) -> Iterator[tuple[ImuSample, float]]:
    """The raw samples from frame i to the next: each held until the next sample or frame."""
    imu = dataset.imu
    if imu is None:
        raise FilterFailure("start", "asks for raw IMU samples, and the data hold none.")
    begin, end = dataset.times_s[i], dataset.times_s[i + 1]
    first = max(int(np.searchsorted(imu.times_s, begin, side="right")) - 1, 0)
    behind = int(np.searchsorted(imu.times_s, end, side="left"))
    edges = np.concatenate([[begin], imu.times_s[first + 1 : behind], [end]])
    for k, dt in zip(range(first, behind), np.diff(edges), strict=True):
        sample = ImuSample(time_s=float(edges[k - first]), gyro=imu.gyro[k], accel=imu.accel[k])
        yield sample, float(dt)
