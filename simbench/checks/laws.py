"""Laws that hold for every filter whatever its formulas, exact to rounding.

Each feeds a filter twice, the second time with something changed that must not matter, or must
matter in a known way: the world moved, the landmarks renamed, a sighting hidden. The filter is a
black box. What it does not state (a covariance, innovations) is left out of the comparison.
"""

from dataclasses import replace

import numpy as np

from simbench.checks.alike import alike, covariance_difference, in_sigmas, moved_along
from simbench.checks.result import MISTAKE, PROPERTY, CheckResult, NotApplicable, check, judged
from simbench.checks.short_drive import ShortDrive
from simbench.checks.trace import Call, Feed, covariances, trace
from vislam.arrays import BoolArray, IntArray
from vislam.filters import Factory
from vislam.gaussian import covariance_fault
from vislam.lie import se3
from vislam.types import Belief, Frame

#: The world is moved by this: translation and rotation vector.
MOTION = np.array([30.0, -40.0, 10.0, 1.1, -0.7, 1.9])
#: Of the noise in `divide_the_frame`: so little that no linearisation point moves.
LITTLE = 1e-6
#: What is left of second order there, in parts of the first.
SECOND_ORDER = 1e-3


@check
def move_the_world(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """Everything moved by one rigid motion: the estimates move along."""
    feed, g = Feed.of(drive), se3.exp(MOTION)
    task = feed.task
    prior = moved_along(task.prior, g)
    trajectory = None if task.trajectory is None else g @ task.trajectory
    there = replace(feed, task=replace(task, prior=prior, trajectory=trajectory))
    return alike(
        trace(factory, feed),
        trace(factory, there),
        lambda belief: moved_along(belief, g),
        "moved world",
    )


@check
def rename_the_landmarks(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """Other ids: the same map under other names."""
    feed = Feed.of(drive)

    def renamed(ids: IntArray) -> IntArray:
        return 10**6 - 7 * ids

    prior = feed.task.prior
    other = feed.each_frame(lambda _, frame: replace(frame, ids=renamed(frame.ids)))
    other = replace(other, task=replace(feed.task, prior=replace(prior, ids=renamed(prior.ids))))
    return alike(
        trace(factory, feed),
        trace(factory, other),
        lambda belief: replace(belief, ids=renamed(belief.ids)),
        "renamed landmarks",
        lambda innovation: replace(innovation, ids=renamed(innovation.ids)),
    )


@check
def shift_the_clock(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """All times later by 4096 s: nothing changes."""
    feed = Feed.of(drive)
    later = tuple(
        replace(step, time_s=step.time_s + 4096)
        if isinstance(step, Frame)
        else (replace(step[0], time_s=step[0].time_s + 4096), step[1])
        for step in feed.steps
    )
    return alike(
        trace(factory, feed), trace(factory, replace(feed, steps=later)), what="later clock"
    )


@check
def reorder_the_features(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """The features of each frame in reverse: nothing changes."""
    feed = Feed.of(drive)
    reverse = feed.each_frame(lambda _, frame: _rows(frame, np.arange(len(frame.ids))[::-1]))
    return alike(trace(factory, feed), trace(factory, reverse), what="reversed features")


@check
def run_twice(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """The same again: the same to the last bit."""
    feed = Feed.of(drive)
    return alike(trace(factory, feed), trace(factory, feed), what="second run", limit=0.0)


@check
def keep_what_was_handed_out(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """A belief is a snapshot: later calls leave it alone."""
    calls = trace(factory, Feed.of(drive))
    later = [replace(call, belief=call.handed) for call in calls]
    return alike(calls, later, what="belief looked at again at the end", limit=0.0)


@check
def divide_the_frame(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """The features of a frame in two calls: the same, to first order in the noise.

    A law for a filter that linearises at a point, while that point stays where it is: so the
    noise realised here is a millionth of what is told. A filter that averages over sigma points
    need not obey.
    """
    feed = Feed.of(drive, noise=LITTLE)
    whole = trace(factory, feed)
    steps, ends = [], [0]
    for step in feed.steps:
        parts = [step]
        if isinstance(step, Frame) and len(step.ids) > 1:
            half = len(step.ids) // 2
            parts = [_rows(step, np.arange(half)), _rows(step, np.arange(half, len(step.ids)))]
        steps += parts
        ends.append(len(steps))
    calls = trace(factory, replace(feed, steps=tuple(steps)))
    worst, where = 0.0, "start"
    for a, b in zip(whole, (calls[end] for end in ends), strict=True):
        if not covariances(a.belief):
            raise NotApplicable("the filter states no covariance to measure a difference by")
        found = covariance_difference(a.belief, b.belief)
        if np.isfinite(found):
            found = max(found, in_sigmas(a.belief, b.belief) / LITTLE)
        if not found <= worst:
            worst, where = found, a.name
    records = any(call.records for call in whole)
    return judged(
        worst,
        SECOND_ORDER,
        good="a frame in two calls does what it does in one",
        bad=f"{where}: a frame in two calls does something else than in one, by {worst:.2g} of a "
        "standard deviation" + ("" if records else "; sigma points may do that"),
        failure=lambda: MISTAKE if records else PROPERTY,
    )


@check
def hide_a_landmark(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """A landmark all of whose sightings are -1, against one that never existed."""
    feed = Feed.of(drive).streamed()
    seen = np.concatenate([s.ids for s in feed.steps if isinstance(s, Frame)])
    if not len(seen):
        raise NotApplicable("the drive has no sightings")
    hidden = int(np.bincount(seen).argmax())

    def mask(_: int, frame: Frame) -> Frame:
        return frame.without((frame.ids == hidden)[:, None])

    never = feed.each_frame(lambda _, frame: _rows(frame, np.flatnonzero(frame.ids != hidden)))
    return alike(
        trace(factory, never), trace(factory, feed.each_frame(mask)), what="hidden landmark"
    )


@check
def ignore_an_empty_frame(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """A frame whose features are all -1 changes nothing but the clock."""
    feed = Feed.of(drive).streamed()
    frames = [k for k, step in enumerate(feed.steps) if isinstance(step, Frame)]
    k = frames[len(frames) // 2]
    known = np.unique(np.concatenate([s.ids for s in feed.steps[:k] if isinstance(s, Frame)]))
    ids = np.append(known, known.max(initial=0) + 1)  # and one that was never seen

    def with_frame(ids: IntArray) -> tuple[Call, ...]:
        frame = feed.steps[k]
        assert isinstance(frame, Frame)
        nothing = np.zeros((len(ids), frame.readings.shape[-1]))
        empty = replace(frame, ids=ids, last=np.zeros(len(ids), bool)).with_readings(nothing)
        empty = empty.without(np.ones_like(nothing, bool))
        return trace(factory, replace(feed, steps=(*feed.steps[:k], empty, *feed.steps[k + 1 :])))

    calls = with_frame(ids)
    before = replace(calls[k + 1], belief=calls[k].belief)
    return alike(
        (before, *with_frame(ids[:0])), (calls[k + 1], *calls), what="frame of features all at -1"
    )


@check
def ignore_a_half_missing_feature(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """A feature with some coordinates at -1 is as good as none."""
    feed = Feed.of(drive).streamed()
    without = feed.each_frame(
        lambda i, frame: _rows(frame, np.flatnonzero(~_halved(i, frame).any(axis=1)))
    )
    halved = feed.each_frame(
        lambda i, frame: frame.without(_halved(i, frame)),
    )
    return alike(trace(factory, without), trace(factory, halved), what="half-missing feature")


@check
def ignore_what_a_mask_hides(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """The coordinates that a half-missing feature still has never reach the state."""
    feed = Feed.of(drive).streamed()

    def masked(shift_px: float) -> Feed:
        def change(i: int, frame: Frame) -> Frame:
            missing = _halved(i, frame)
            shifted = frame.readings + shift_px * missing.any(axis=1, keepdims=True)
            return frame.with_readings(shifted).without(missing)

        return feed.each_frame(change)

    return alike(
        trace(factory, masked(0.0)), trace(factory, masked(11.0)), what="value beside a mask"
    )


@check
def state_covariances(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """Every covariance is one: symmetric, no eigenvalue below zero, equal to its own blocks."""
    calls = trace(factory, Feed.of(drive))
    if not any(covariances(call.belief) for call in calls):
        raise NotApplicable("the filter states no covariance")
    faults = []
    for call in calls:
        for name, P in covariances(call.belief):
            if fault := covariance_fault(P):
                faults.append(f"{call.name}: the {name} covariance is {fault}")
        if (fault := _block_fault(call.belief)) is not None:
            faults.append(f"{call.name}: {fault}")
    return judged(
        len(faults),
        0,
        good="symmetric and positive semidefinite after each call",
        bad=f"{faults[0] if faults else ''}; {len(faults)} such in all",
    )


def _block_fault(belief: Belief) -> str | None:
    """Whether the covariances that are stated alone are the blocks of the joint one."""
    joint = belief.joint_covariance
    if joint is None:
        return None
    pose = 0
    if belief.pose_covariance is not None:
        pose = 6
        if not np.array_equal(belief.pose_covariance, joint[:6, :6]):
            return "the pose covariance is not the joint one's block"
    for k, P in enumerate(belief.landmark_covariances):
        rows = slice(pose + 3 * k, pose + 3 * k + 3)
        if not np.array_equal(P, joint[rows, rows]):
            return f"the covariance of landmark {belief.ids[k]} is not the joint one's block"
    return None


def _rows(frame: Frame, kept: IntArray) -> Frame:
    fewer = replace(frame, ids=frame.ids[kept], last=frame.last[kept])
    return fewer.with_readings(frame.readings[kept])


#: Which coordinates go missing: the right image, the left one, one number of either.
PATTERNS = np.array([[0, 0, 1, 1], [1, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]], bool)


def _halved(k: int, frame: Frame) -> BoolArray:
    """The coordinates to take from every other feature of a frame, shape (n, c)."""
    place = k // 2 + np.arange(len(frame.ids))
    every_other = (place % 2 == 0)[:, None]
    coordinates = frame.readings.shape[-1]
    return np.asarray(PATTERNS[place // 2 % 4, :coordinates] & every_other)
