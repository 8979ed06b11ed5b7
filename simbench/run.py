"""Drives a filter over a dataset, in time order, and records what it held true at every frame."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from simbench.dataset import Dataset
from simbench.driving import Driven, Input
from simbench.errors import FilterFailure
from simbench.jumps import without_jumps
from simbench.repeats import without_repeats
from simbench.rng import stream
from vislam.arrays import Array
from vislam.filters.protocol import Factory
from vislam.types import MEMORY_BYTES, Belief, ImuSample, Innovation, Task, Twist


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
class RunOptions:
    """What is asked of a run beside what its data say.

    Attributes:
        smooth: whether the past poses are wanted given all data.
        memory_bytes: what a filter's backward pass may hold in memory (`Task.memory_bytes`).
        retire_after: feeds the data as a stream, which does not know its last sightings: a landmark
            leaves the filter after so many frames without one. None to say what is known.
        inverse_depth: whether landmarks move along their inverse depth (`Task.inverse_depth`).
    """

    smooth: bool = False
    memory_bytes: int = MEMORY_BYTES
    retire_after: int | None = None
    inverse_depth: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRecord:
    """What a filter made of a dataset.

    Attributes:
        dataset: the data.
        filter: the filter's name.
        steps: one for each frame.
        final: the belief at the end, over all landmarks that were ever in the state.
        wall_s: time spent in the filter's own calls.
        smoothed: the pose at each frame given all data; None where it was not asked for, or the
            filter does not give it.
    """

    dataset: Dataset
    filter: str
    steps: tuple[Step, ...]
    final: Belief
    wall_s: float
    smoothed: tuple[Belief, ...] | None = None

    @property
    def T_world_imu(self) -> Array:
        """The estimated poses at the frames, shape (T, 4, 4)."""
        return np.stack([step.belief.T_world_imu for step in self.steps])

    @property
    def as_smoothed(self) -> "RunRecord | None":
        """The same run with its poses as all data have them; None where they are not known."""
        if self.smoothed is None:
            return None
        steps = tuple(
            Step(frame=step.frame, belief=belief, innovation=None)
            for step, belief in zip(self.steps, self.smoothed, strict=True)
        )
        return replace(self, steps=steps, smoothed=None)

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
        true = truth.T_world_imu[[step.frame for step in self.steps]]
        charts = [step.belief.chart for step in self.steps]
        if isinstance(charts[0], str) and charts.count(charts[0]) == len(charts):
            return Belief(T_world_imu=self.T_world_imu, chart=charts[0]).pose_error(true)
        return np.stack([s.belief.pose_error(T) for s, T in zip(self.steps, true, strict=True)])


def prepared(dataset: Dataset) -> tuple[Dataset, RunOptions]:
    """What a filter is best fed of a dataset, and asked, where nobody says otherwise.

    A scene stays as it is. Of a real drive, whose truth is unknown, repeated sightings are taken
    for what they are (`simbench.repeats`), those that jump are left out (`simbench.jumps`), and
    landmarks move along their inverse depth: most are far, and no scene was drawn to suit them.
    Noise and gate are told already (`read_npz`). The verb `run` does no more than

        dataset, options = prepared(read_npz(path))
        record = run(dataset, EkfSlam, options=options)
    """
    return without_jumps(without_repeats(dataset)), RunOptions(inverse_depth=dataset.truth is None)


def task_of(dataset: Dataset, options: RunOptions = RunOptions()) -> Task:
    """What a filter is told of a dataset."""
    origin = dataset.origin
    return Task(
        calibration=dataset.calibration,
        noise=dataset.noise,
        prior=dataset.prior,
        gate=dataset.gate,
        trajectory=None if dataset.truth is None else dataset.truth.T_world_imu,
        memory_bytes=options.memory_bytes,
        retire_after=options.retire_after,
        inverse_depth=options.inverse_depth,
        smooth=options.smooth,
        rng=stream(origin.seed if origin else 0, origin.run if origin else 0, "filter"),
    )


def run(
    dataset: Dataset,
    factory: Factory,
    *,
    name: str = "filter",
    options: RunOptions = RunOptions(),
    on_step: Callable[[Step], None] = lambda _: None,
) -> RunRecord:
    """Run a filter over a dataset, with one BLAS thread.

    The matrices of a frame are small: a second thread gains nothing there, and where another
    process uses the cores it makes an update many times slower.

    Args:
        dataset: the data.
        factory: makes the filter.
        name: of the filter, for the record.
        options: what is asked besides.
        on_step: called after each frame, outside the measured time: to show progress, or to write
            while the run goes on.

    Raises:
        FilterFailure: the filter raised, is none, or returned what it must not: a pose that is not
            finite, say, or fewer landmarks than ids.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        filter_ = Driven(factory, task_of(dataset, options))
        steps = []
        for done in filter_.feed(_inputs(dataset, filter_.raw, options)):
            if done.taken:
                belief = filter_.belief(done.name)
                steps.append(Step(frame=done.frame, belief=belief, innovation=done.innovation))
                on_step(steps[-1])
        end = filter_.finish()
        return RunRecord(
            dataset=dataset,
            filter=name,
            steps=tuple(steps),
            final=steps[-1].belief if end is None else end.final,
            wall_s=filter_.watch.total_s,
            smoothed=(end.poses or None) if end is not None else None,
        )


def _inputs(dataset: Dataset, raw: bool, options: RunOptions) -> Iterator[Input]:
    for i in range(len(dataset)):
        frame = dataset.frame(i)
        stream = options.retire_after is not None
        yield replace(frame, last=np.zeros_like(frame.last)) if stream else frame
        if i + 1 < len(dataset):
            yield from _motions(dataset, i, raw)


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
