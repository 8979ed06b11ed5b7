"""A short drive with its noise laid open: what the exact audit runs a filter on.

Every scalar of noise in a drive (of the start, of each twist, of each pixel coordinate) is one
element of a standard normal vector w. A `ShortDrive` makes the data of any w, or of many at once
along a batch axis. With w = 0 there is no noise, and a right filter follows the truth.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from simbench.dataset import Dataset, Truth
from simbench.errors import InputError
from simbench.sensors import seen_from
from vislam.arrays import Array, BoolArray
from vislam.lie import se3
from vislam.types import Belief, Frame, State, Task, Twist


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """The data of one w, or of a batch of them.

    Attributes:
        prior: the start that the filter is told.
        twists: one from each frame to the next.
        frames: one more than twists.
    """

    prior: Belief
    twists: tuple[Twist, ...]
    frames: tuple[Frame, ...]


@dataclass(frozen=True, kw_only=True)
class ShortDrive:
    """The leading frames of a simulated dataset, with the noise that the filter is told.

    Attributes:
        dataset: gives the task, the times, the true motion and map, and who is seen when.
        frames: how many of its frames take part.
    """

    dataset: Dataset
    frames: int

    @classmethod
    def of(cls, dataset: Dataset, most_scalars: int) -> "ShortDrive":
        """As many leading frames as have at most so many scalars of noise.

        Raises:
            InputError: the truth is unknown, or two frames have more.
        """
        if dataset.truth is None or dataset.sightings is None:
            raise InputError(f"{dataset.name}: expected simulated data: an audit needs the truth.")
        drive = cls(dataset=dataset, frames=len(dataset))
        by_frame = [6 + int(np.count_nonzero(_noisy(frame))) for frame in drive.schedule]
        frames = int(np.searchsorted(np.cumsum(by_frame), most_scalars, side="right"))
        if frames < 2:
            raise InputError(
                f"{dataset.name}: expected at most {most_scalars} scalars of noise in the first "
                f"two frames, got {sum(by_frame[:2])}; take landmarks away."
            )
        return cls(dataset=dataset, frames=frames)

    @property
    def task(self) -> Task:
        """What the filter is told: the truth of the geometry, and the noise as it is."""
        return Task(
            calibration=self._truth.calibration,
            noise=self.dataset.noise,
            prior=self.dataset.prior,
            gate=self.dataset.gate,
            trajectory=self.T_world_imu,
        )

    @cached_property
    def schedule(self) -> tuple[Frame, ...]:
        """The frames as simulated; of their readings only what is missing matters."""
        return tuple(self.dataset.frame(i) for i in range(self.frames))

    @cached_property
    def intervals_s(self) -> Array:
        """Time from each frame to the next, shape (K - 1,)."""
        return np.diff(self.dataset.times_s[: self.frames])

    @cached_property
    def T_world_imu(self) -> Array:
        """True poses, which the true twists lead to exactly, shape (K, 4, 4)."""
        poses = [self._truth.T_world_imu[0]]
        for tau, u in zip(self.intervals_s, self._true_twists, strict=True):
            poses.append(poses[-1] @ se3.exp(tau * u))
        return np.stack(poses)

    @cached_property
    def scalars(self) -> int:
        """N, the length of w."""
        sightings = sum(int(np.count_nonzero(_noisy(frame))) for frame in self.schedule)
        roots = (self._prior_root, *self._process_roots)
        return int(sum(root.shape[1] for root in roots)) + sightings

    def state(self, frame: int) -> State:
        """The truth at a frame."""
        return replace(self._truth.state(frame), T_world_imu=self.T_world_imu[frame])

    def realise(self, w: Array) -> Readings:
        """The data of a noise vector, shape (..., N)."""
        batch, prior = w.shape[:-1], self.dataset.prior
        place = 0

        def take(root: Array) -> Array:
            """The next scalars, as correlated noise: root root^T is its covariance."""
            nonlocal place
            part = w[..., place : place + root.shape[1]]
            place += root.shape[1]
            return part @ root.T

        T_start = self.T_world_imu[0] @ se3.exp(-take(self._prior_root))
        twists = tuple(self._measured(i, take(root)) for i, root in enumerate(self._process_roots))
        frames = []
        for frame, true in zip(self.schedule, self._true_readings, strict=True):
            z = np.broadcast_to(true, (*batch, *true.shape)).copy()
            sigma = np.broadcast_to(self.dataset.noise.sigma(true), true.shape)
            for k in np.flatnonzero(_noisy(frame)[:, 0]):
                z[..., k, :] += take(np.diag(sigma[k]))
            frames.append(frame.with_readings(z))
        return Readings(
            prior=replace(prior, T_world_imu=T_start), twists=twists, frames=tuple(frames)
        )

    def inputs(self, readings: Readings) -> Iterator[Frame | tuple[Twist, float]]:
        """Readings in the order of time: frames, between two of them a twist and its seconds."""
        yield readings.frames[0]
        for twist, tau, frame in zip(
            readings.twists, self.intervals_s.tolist(), readings.frames[1:], strict=True
        ):
            yield twist, tau
            yield frame

    def _measured(self, i: int, n: Array) -> Twist:
        """The twist that is read when the true motion of an interval meets noise n."""
        u, tau = self._true_twists[i], float(self.intervals_s[i])
        match self.dataset.noise.process_model:
            case "additive":
                u = se3.log(se3.exp(tau * u) @ se3.exp(-n)) / tau
            case "twist" | "twist-relative":
                u = u + n
            case "twist-density":
                u = u + n / np.sqrt(tau)
        return Twist(time_s=float(self.dataset.times_s[i]), linear=u[..., :3], angular=u[..., 3:])

    @property
    def _truth(self) -> Truth:
        truth = self.dataset.truth
        assert truth is not None  # `of` has seen to it
        return truth

    @cached_property
    def _true_twists(self) -> Array:
        truth, last = self._truth, self.frames - 1
        return np.hstack([truth.linear_velocity[:last], truth.angular_velocity[:last]])

    @cached_property
    def _true_readings(self) -> list[Array]:
        """What each frame shows without noise; what is missing in the schedule is missing here."""
        found = []
        for T, frame in zip(self.T_world_imu, self.schedule, strict=True):
            p_imu = se3.apply(se3.inverse(T), self._truth.landmarks[frame.ids])
            shown = frame.with_readings(seen_from(self._truth.calibration, p_imu))
            found.append(shown.without(~frame.there).readings)
        return found

    @cached_property
    def _prior_root(self) -> Array:
        P = self.dataset.prior.pose_covariance
        return _root(np.zeros((6, 6)) if P is None else P)

    @cached_property
    def _process_roots(self) -> list[Array]:
        """Of the noise of each twist sample."""
        return [_root(self.dataset.noise.twist_covariance(u)) for u in self._true_twists]


def _noisy(frame: Frame) -> BoolArray:
    """Which numbers of a frame have noise: those of a sighting that is whole, shape (n, c)."""
    whole: BoolArray = np.all(frame.there, axis=-1, keepdims=True)
    return np.broadcast_to(whole, frame.there.shape)


def _root(P: Array) -> Array:
    """B with B B^T = P and as many columns as P has rank, shape (n, r)."""
    eigenvalues, vectors = np.linalg.eigh(P)
    kept = eigenvalues > 1e-14 * eigenvalues[-1]
    return np.asarray(vectors[:, kept] * np.sqrt(eigenvalues[kept]))
