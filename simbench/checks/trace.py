"""A filter run over a few readings, and what it held after each call."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from simbench.checks.result import NotApplicable
from simbench.checks.scenes import drive as scene
from simbench.checks.short_drive import ShortDrive
from simbench.driving import Driven
from simbench.rng import stream
from vislam.arrays import Array, IntArray
from vislam.filters import Factory
from vislam.filters.records import Augment, Drop, Record
from vislam.types import Belief, Frame, Innovation, Task, Twist

#: The scene of a check that is given none: births, gaps, halved sightings, four pixel sigmas.
SCENE = "births"


@dataclass(frozen=True, slots=True, kw_only=True)
class Feed:
    """All that goes into a filter.

    Attributes:
        task: what it is told.
        steps: what comes in, in order: frames, and twists with their interval, s.
    """

    task: Task
    steps: tuple[Frame | tuple[Twist, float], ...]

    @classmethod
    def of(cls, drive: ShortDrive | None, noise: float = 1.0, draw: int = 0) -> "Feed":
        """The readings of a drive, by default of `SCENE`.

        Args:
            drive: the scene.
            noise: of what is realised, as a multiple of what is told.
            draw: number of the draw.
        """
        drive = scene(SCENE) if drive is None else drive
        w = stream(0, draw, "checks").standard_normal(drive.scalars)
        readings = drive.realise(noise * w)
        return cls(
            task=replace(drive.task, prior=readings.prior), steps=tuple(drive.inputs(readings))
        )

    def each_frame(self, change: Callable[[int, Frame], Frame]) -> "Feed":
        """With changed frames, each given with its place among the steps."""
        steps = (
            change(k, step) if isinstance(step, Frame) else step
            for k, step in enumerate(self.steps)
        )
        return replace(self, steps=tuple(steps))

    def streamed(self) -> "Feed":
        """From a source that does not know which sighting of a landmark is the last.

        Where sightings are hidden or left out, that mark would come to mean something else.
        """
        return self.each_frame(lambda _, frame: replace(frame, last=np.zeros_like(frame.last)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """What a filter held after a call.

    Attributes:
        name: of the call, such as "predict 2", numbered by the frame it starts from or takes in.
        belief: after the call, with the joint covariance: a copy.
        handed: the same as the filter handed it out.
        innovation: of an update that has one.
        records: how the covariance was changed, where the filter shows it.
    """

    name: str
    belief: Belief
    handed: Belief
    innovation: Innovation | None
    records: tuple[Record, ...]


def driven(factory: Factory, task: Task) -> Driven:
    """A filter that takes twists.

    Raises:
        NotApplicable: it asks for raw IMU samples.
        FilterFailure: it raised, or is none.
    """
    filter_ = Driven(factory, task)
    if filter_.raw:
        raise NotApplicable("asks for raw IMU samples, which a short drive does not have")
    return filter_


def trace(factory: Factory, feed: Feed) -> tuple[Call, ...]:
    """Run a filter.

    Returns:
        The start first, then a call for each step.

    Raises:
        NotApplicable: the filter asks for raw IMU samples.
        FilterFailure: it raised, or what it holds is no belief.
    """
    # with a generator that nobody has drawn from
    filter_ = driven(factory, replace(feed.task, rng=stream(0, 0, "filter")))
    records: list[Record] = []
    if hasattr(filter_.filter, "records"):
        filter_.filter.records = records

    def call(name: str, innovation: Innovation | None = None) -> Call:
        belief, done = filter_.belief(name, joint=True), tuple(records)
        records.clear()
        return Call(
            name=name,
            belief=deepcopy(belief),
            handed=belief,
            innovation=innovation,
            records=done,
        )

    start = call("start")
    return (start, *(call(done.name, done.innovation) for done in filter_.feed(feed.steps)))


def white_box(factory: Factory, feed: Feed) -> list[tuple[Call, Call]]:
    """Run a filter that shows its records: each call, after the one before it.

    Raises:
        NotApplicable: it shows none, or not all, or starts with a map.
    """
    calls = trace(factory, feed)
    if not any(call.records for call in calls):
        raise NotApplicable("the filter does not show its records")
    if len(feed.task.prior.ids):
        raise NotApplicable("written for a start without a map")
    pairs = list(pairwise(calls))
    for before, after in pairs:
        held(before, after)
    return pairs


def held(before: Call, after: Call) -> list[tuple[Record, IntArray]]:
    """The records of a call, each with the landmarks in the order of the state that it changes.

    Raises:
        NotApplicable: the records are not of the landmarks that the beliefs hold.
    """
    ids = before.belief.ids
    new = after.belief.ids[~np.isin(after.belief.ids, ids)]
    found = []
    for record in after.records:
        found.append((record, ids))
        match record:
            case Augment():
                born = len(record.G) // 3
                ids, new = np.append(ids, new[:born]), new[born:]
            case Drop():
                ids = np.delete(ids, record.slots)
    if not np.array_equal(ids, after.belief.ids):
        raise NotApplicable(f"{after.name}: the records are not of the landmarks in the belief")
    return found


def covariances(belief: Belief) -> list[tuple[str, Array]]:
    """Every covariance that a belief states, by what it is of; there may be none."""
    found = [("joint", belief.joint_covariance), ("pose", belief.pose_covariance)]
    landmarks = zip(belief.ids.tolist(), belief.landmark_covariances, strict=False)
    found += [(f"landmark {i}", P) for i, P in landmarks]
    return [(name, P) for name, P in found if P is not None]
