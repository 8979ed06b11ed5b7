"""Are the Jacobians that a filter shows those of their definitions?

A definition is a composition of maps, differentiated through the filter's own chart by finite
differences: a pose is moved by the twist, a point is projected, a first sighting is put where it
was seen. Data without noise keep every estimate where it is, so that it does not matter at which
of them a method linearises.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from simbench.checks.chart import derivative, state_of, varied
from simbench.checks.result import CheckResult, check, judged
from simbench.checks.short_drive import ShortDrive
from simbench.checks.structure import observation_matrix, through
from simbench.checks.trace import Call, Feed, white_box
from simbench.sensors.camera import camera_matrices, projected
from vislam.arrays import Array
from vislam.filters import Factory
from vislam.filters.records import Augment, Correct, Linear
from vislam.lie import se3
from vislam.types import Noise, State, StereoFrame, Task, Twist

#: Finite differences are good to about 1e-10.
ACCURACY = 1e-6


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A block of a Jacobian: its name, and its largest difference relative to its size."""

    name: str
    difference: float


def _blocks(
    task: Task, before: Call, after: Call, step: StereoFrame | tuple[Twist, float]
) -> Iterator[Block]:
    for record in after.records:
        match record:
            case Linear():
                what, motion = "A", np.eye(4)
                if not isinstance(step, StereoFrame):
                    what, motion = "F", se3.exp(step[1] * step[0].vector)
                size = 6 + 3 * len(before.belief.ids)
                yield from _compared(
                    f"{after.name}: {what}",
                    through(record, np.eye(size)),
                    _transition(before, after, motion),
                    {"pose": slice(0, 6), "landmark": slice(6, None)},
                )
            case Correct():
                rows = whitening(task.noise) @ _observation(task, before, record)
                yield from _compared(
                    f"{after.name}: H",
                    observation_matrix(record, rows.shape[-1]),
                    rows.reshape(-1, rows.shape[-1]),
                    {"": slice(None)},
                )
            case Augment():
                expected = _birth(after, len(record.G) // 3)
                got = np.pad(record.G, ((0, 0), (0, expected.shape[1] - 6)))
                yield from _compared(f"{after.name}: G", got, expected, {"": slice(None)})


def _compared(name: str, got: Array, expected: Array, rows: dict[str, slice]) -> Iterator[Block]:
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


def _transition(before: Call, after: Call, motion: Array) -> Array:
    """The derivative d e' / d e, for e' the error after the body's motion."""
    state, size = state_of(before.belief), 6 + 3 * len(before.belief.ids)
    kept = np.isin(after.belief.ids, before.belief.ids)

    def error(d: Array) -> Array:
        true = varied(state, d)
        true = replace(true, T_world_imu=true.T_world_imu @ motion)
        old = replace(
            after.belief, ids=after.belief.ids[kept], landmarks=after.belief.landmarks[kept]
        )
        return old.error(true)

    return _by_error(before, derivative(error, size))


def _observation(task: Task, before: Call, record: Correct) -> Array:
    """The derivative d pixels / d e of each observed landmark, shape (k, 4, 6 + 3m)."""
    state = state_of(before.belief)
    places = np.searchsorted(state.ids, before.belief.ids[record.slots])
    matrices = camera_matrices(task.calibration.rig, task.calibration.T_imu_cam)

    def pixels(d: Array) -> Array:
        true = varied(state, d)
        s = se3.apply(se3.inverse(true.T_world_imu), true.landmarks[:, places])
        return projected(matrices, s.reshape(-1, 3))[0].reshape(len(d), -1)

    size = 6 + 3 * len(state.ids)
    return _by_error(before, derivative(pixels, size)).reshape(-1, 4, size)


def _birth(after: Call, born: int) -> Array:
    """The derivative d e_new / d e, for landmarks that stand where the pose sighted them."""
    belief = after.belief
    state, size = state_of(belief), 6 + 3 * (len(belief.ids) - born)
    is_new = np.isin(state.ids, belief.ids[len(belief.ids) - born :])

    def error(d: Array) -> Array:
        old = State(
            T_world_imu=state.T_world_imu,
            ids=state.ids[~is_new],
            landmarks=state.landmarks[~is_new],
        )
        true = varied(old, d)
        moved = true.T_world_imu @ se3.inverse(state.T_world_imu)
        landmarks = np.empty((len(d), len(state.ids), 3))
        landmarks[:, ~is_new] = true.landmarks
        landmarks[:, is_new] = se3.apply(moved, state.landmarks[is_new])
        return belief.error(replace(state, T_world_imu=true.T_world_imu, landmarks=landmarks))

    J = derivative(error, size)
    return np.asarray(np.linalg.solve(J[:size].T, J[size:].T).T)


def _by_error(call: Call, by_state: Array) -> Array:
    """A derivative by the state's own numbers, made one by the error in the belief's chart."""
    state = state_of(call.belief)
    size = by_state.shape[1]
    by_d = derivative(lambda d: call.belief.error(varied(state, d)), size)
    return np.asarray(np.linalg.solve(by_d.T, by_state.T).T)


def whitening(noise: Noise) -> Array:
    """(uL, mean of vL and vR by inverse variance, uR), each over its sigma, shape (3, 4)."""
    uL, vL, uR, vR = noise.sigma_px
    information = 1 / vL**2 + 1 / vR**2
    mean = np.array([0, 1 / vL**2, 0, 1 / vR**2]) / np.sqrt(information)
    return np.stack([[1 / uL, 0, 0, 0], mean, [0, 0, 1 / uR, 0]])
