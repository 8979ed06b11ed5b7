"""Are the Jacobians that a filter shows those of their definitions, and does it use them?

A definition is a composition of maps, differentiated through the filter's own chart by finite
differences: a pose is moved by the twist, a point is projected, a first sighting is put where it
was seen. Data without noise keep every estimate where it is, so that it does not matter at which
of them a method linearises.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from simbench.checks.alike import ROUNDING, relative_difference
from simbench.checks.chart import derivative, moved, state_of, varied
from simbench.checks.result import CheckResult, NotApplicable, check, judged
from simbench.checks.short_drive import ShortDrive
from simbench.checks.structure import observation_matrix
from simbench.checks.trace import Call, Feed, held, white_box
from simbench.sensors import seen_from
from vislam.arrays import Array, IntArray
from vislam.filters import Factory
from vislam.filters.records import Augment, Correct, Linear
from vislam.lie import se3
from vislam.types import Belief, Frame, Noise, Task, Twist

#: Of the largest element. Finite differences are good to about 1e-10; an adjoint without the last
#: term of its series is off by 2e-4, which misleads nobody; mistakes start at a hundredth.
ACCURACY = 1e-3


@check
def jacobians(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """F, H and G, and A of a transport, against their definitions."""
    feed = Feed.of(drive, noise=0.0).streamed()
    calls = white_box(factory, feed)
    blocks = [
        block
        for (before, after), step in zip(calls, feed.steps, strict=True)
        for block in _blocks(feed.task, before, after, step)
    ]
    worst = max((block.difference for block in blocks), default=0.0)
    first = next((block for block in blocks if not block.difference <= ACCURACY), None)
    return judged(
        worst,
        ACCURACY,
        good=f"{len(blocks)} blocks are as defined",
        bad=""
        if first is None
        else f"{first.name} is not its definition's, by "
        f"{first.difference:.2g} of its largest element",
    )


@check
def follow_the_records(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """White box: the covariance after a call is what the records make of the one before.

    Where it is not, the records are right and what is done with them is wrong.
    """
    worst, where = 0.0, "start"
    for before, after in white_box(factory, Feed.of(drive)):
        P, expected = after.belief.joint_covariance, before.belief.joint_covariance
        if P is None or expected is None:
            raise NotApplicable("the filter states no joint covariance of pose and landmarks")
        for record in after.records:
            expected = record.forward(expected)
        found = relative_difference(expected, P)
        if not found <= worst:
            worst, where = found, after.name
    return judged(
        worst,
        ROUNDING,
        good="every covariance is what the records make of the one before",
        bad=f"{where}: the covariance is not what the records make of the one before, by "
        f"{worst:.2g} of two standard deviations",
    )


@check
def move_by_the_correction(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """White box: the error of the estimate after an update, about the one before, is K r.

    That is what a retraction is, and what a covariance says that is not carried along. A filter
    whose landmarks move in coordinates of their own carries it along by blocks D; a landmark then
    moves by (I + D) / 2 of its part, the mean of its step at both ends, to second order.
    """
    worst_m, where, updates = 0.0, "start", 0
    for before, after in white_box(factory, Feed.of(drive).streamed()):
        corrections = [r for r in after.records if isinstance(r, Correct)]
        slots = [slot for r in corrections for slot in r.observation.slots.tolist()]
        sizes = {len(r.delta) for r in corrections}
        whole = sizes == {6 + 3 * len(before.belief.ids)}  # of no landmark that has just entered
        if not (slots and whole and len(slots) == len(set(slots))):  # twice: several moves
            continue
        updates += 1
        found = _unexplained(before.belief, after, np.sum([r.delta for r in corrections], axis=0))
        if not found <= worst_m:
            worst_m, where = found, after.name
    if not updates:
        raise NotApplicable("no update corrected the state that it found")
    return judged(
        worst_m,
        ROUNDING,
        good=f"{updates} updates moved the estimate by their corrections",
        bad=f"{where} moves the estimate otherwise than its correction says, by {worst_m:.2g} "
        "metres or radians",
    )


def _unexplained(before: Belief, after: Call, delta: Array) -> float:
    """What is left of a move when the correction, and a D after it, are taken off."""
    moved_by = before.error(state_of(_with(before.ids, after, after)))
    left = moved_by - delta
    D = next((r.D for r in after.records if isinstance(r, Linear) and r.D is not None), None)
    if D is not None:
        change = D[: len(before.ids)] - np.eye(3)
        part = delta[6:].reshape(-1, 3)
        of_map = left[6:].reshape(-1, 3) - 0.5 * (change @ part[..., None])[..., 0]
        third_order = np.linalg.norm(change, axis=(-2, -1)) ** 2 * np.linalg.norm(part, axis=-1)
        beyond = np.linalg.norm(of_map, axis=-1) - third_order
        left = np.append(left[:6], beyond.clip(min=0))
    return float(np.nan_to_num(np.abs(left), nan=np.inf).max())


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A block of a Jacobian: its name, and its largest difference relative to its size."""

    name: str
    difference: float


ALL_ROWS = MappingProxyType({"": slice(None)})


def _blocks(
    task: Task, before: Call, after: Call, step: Frame | tuple[Twist, float]
) -> Iterator[Block]:
    for record, ids in held(before, after):
        start = _with(ids, before, after)
        match record:
            case Linear():
                what, motion = "A", np.eye(4)
                if not isinstance(step, Frame):
                    what, motion = "F", se3.exp(step[1] * step[0].vector)
                got = record.carried(np.eye(6 + 3 * len(ids)))
                expected = _transition(start, _with(ids, after, before), motion)
                rows = {"pose": slice(0, 6), "landmarks": slice(6, None)}
                yield from _compared(f"{after.name}: {what}", got, expected, rows)
            case Correct():
                expected = _observation(task, start, record)
                got = observation_matrix(record, expected.shape[1])
                yield from _compared(f"{after.name}: H", got, expected)
            case Augment():
                new = after.belief.ids[~np.isin(after.belief.ids, ids)][: len(record.G) // 3]
                expected = _birth(_with(np.append(ids, new), after, before), len(new))
                got = np.pad(record.G, ((0, 0), (0, expected.shape[1] - 6)))
                yield from _compared(f"{after.name}: G", got, expected)


def _with(ids: IntArray, call: Call, other: Call) -> Belief:
    """The belief after a call, of these landmarks; those it lacks are from another call."""
    beliefs = (other.belief, call.belief)
    known = {i: m for b in beliefs for i, m in zip(b.ids.tolist(), b.landmarks, strict=True)}
    landmarks = np.reshape([known[i] for i in ids.tolist()], (-1, 3))
    return replace(call.belief, ids=ids, landmarks=landmarks)


def _compared(
    name: str, got: Array, expected: Array, rows: Mapping[str, slice] = ALL_ROWS
) -> Iterator[Block]:
    """By rows, and by the columns of translation, rotation and landmarks."""
    columns = {
        "translation": slice(0, 3),
        "rotation": slice(3, 6),
        "landmarks": slice(6, None),
    }
    scale = np.abs(expected).max(initial=0.0)
    for row, i in rows.items():
        for column, j in columns.items():
            difference = np.abs(got[i, j] - expected[i, j])
            if difference.size:
                of = f"{name} of the {row}" if row else name
                yield Block(
                    name=f"{of} by the {column}",
                    difference=float(np.nan_to_num(difference, nan=np.inf).max() / scale),
                )


def _transition(before: Belief, after: Belief, motion: Array) -> Array:
    """The derivative d e' / d e, for e' the error after the body's motion."""
    state = state_of(before)

    def error(d: Array) -> Array:
        true = varied(state, d)
        return after.error(replace(true, T_world_imu=true.T_world_imu @ motion))

    return _by_error(before, error)


def _observation(task: Task, belief: Belief, record: Correct) -> Array:
    """The derivative d z / d e of the whitened sightings, shape (3k, 6 + 3m)."""
    state = state_of(belief)
    places = np.searchsorted(state.ids, belief.ids[record.observation.slots])

    def sightings(d: Array) -> Array:
        true = varied(state, d)
        s = se3.apply(se3.inverse(true.T_world_imu), true.landmarks[:, places])
        seen = seen_from(task.calibration, s.reshape(-1, 3))
        return seen.reshape(len(d), len(places), seen.shape[-1])

    rows = whitening(task.noise, sightings(np.zeros((1, 6 + 3 * len(belief.ids))))[0])
    return _by_error(
        belief, lambda d: np.einsum("kij,dkj->dki", rows, sightings(d)).reshape(len(d), -1)
    )


def _birth(belief: Belief, born: int) -> Array:
    """The derivative d e_new / d e, for landmarks that stand where the pose sighted them."""
    kept = len(belief.ids) - born
    old = replace(belief, ids=belief.ids[:kept], landmarks=belief.landmarks[:kept])
    new = replace(belief, ids=belief.ids[kept:], landmarks=belief.landmarks[kept:])

    def error(d: Array) -> Array:
        T = varied(state_of(old), d).T_world_imu
        motion = T @ se3.inverse(belief.T_world_imu)
        return new.error(moved(state_of(new), motion))[..., 6:]

    return _by_error(old, error)


def _by_error(belief: Belief, function: Callable[[Array], Array]) -> Array:
    """The derivative by the error in a belief's chart of a function of the state's own numbers."""
    state, size = state_of(belief), 6 + 3 * len(belief.ids)
    by_state = derivative(function, size)
    error_by_state = derivative(lambda d: belief.error(varied(state, d)), size)
    return np.asarray(np.linalg.solve(error_by_state.T, by_state.T).T)


def whitening(noise: Noise, readings: Array) -> Array:
    """What an update takes from readings (k, c) that are expected, shape (k, 3, c).

    (uL, mean of vL and vR by inverse variance, uR), or a point; each over its sigma.
    """
    if not len(noise.sigma_px):
        return np.eye(3) / noise.sigma(readings)[:, None]
    uL, vL, uR, vR = noise.sigma_px
    information = 1 / vL**2 + 1 / vR**2
    mean = np.array([0, 1 / vL**2, 0, 1 / vR**2]) / np.sqrt(information)
    each = np.stack([[1 / uL, 0, 0, 0], mean, [0, 0, 1 / uR, 0]])
    return np.broadcast_to(each, (len(readings), 3, 4))
