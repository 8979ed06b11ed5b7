"""Bugs around a filter that is right itself: in what it is told, and in what it is fed, and when.

Each is a function or a class of (task, parts), as in `simbench.bugs.parts`.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from simbench.bugs.parts import Make
from vislam.arrays import Array, IntArray
from vislam.filters import model
from vislam.filters.parts import Parts
from vislam.filters.slam import EkfSlam
from vislam.lie import se3
from vislam.types import Frame, Innovation, Noise, Task, Twist


def telling(wrong: Callable[[Task], Task]) -> Make:
    """The filter that is told something wrong."""

    def make(task: Task, parts: Parts) -> EkfSlam:
        return EkfSlam(wrong(task), parts)

    return make


def telling_process(wrong: Callable[[Array], Array]) -> Make:
    """The filter that is told a wrong covariance of its process noise, shape (6, 6)."""

    def told(task: Task) -> Task:
        return replace(task, noise=replace(task.noise, process=wrong(task.noise.process)))

    return telling(told)


def _sigma_for_variance(task: Task) -> Task:
    return replace(task, noise=replace(task.noise, sigma_px=np.sqrt(task.noise.sigma_px)))


def _inverted_extrinsics(task: Task) -> Task:
    calibration = task.calibration
    inverted = replace(calibration, T_imu_cam=se3.inverse(calibration.T_imu_cam))
    return replace(task, calibration=inverted)


def _all_ones(W: Array) -> Array:
    """A scalar variance added to a matrix is w 1 1^T; with one for each axis, sigma sigma^T."""
    sigma = np.sqrt(np.diag(W))
    return np.outer(sigma, sigma)


pixel_sigma_for_variance = telling(_sigma_for_variance)
extrinsics_inverted = telling(_inverted_extrinsics)
process_blocks_swapped = telling_process(lambda W: np.roll(W, 3, axis=(0, 1)))
process_sigma_for_variance = telling_process(lambda W: np.diag(np.sqrt(np.diag(W))))
process_noise_of_ones = telling_process(_all_ones)


class RunningMean:
    """The mean of the numbers so far."""

    def __init__(self) -> None:
        self.count, self.mean = 0, 0.0

    def __call__(self, value: float) -> float:
        """Take one in."""
        self.count += 1
        self.mean += (value - self.mean) / self.count
        return self.mean


def process_noise_of_mean_interval(task: Task, parts: Parts) -> EkfSlam:
    """Q as if all intervals were alike."""
    mean = RunningMean()

    def process_noise(noise: Noise, motion: Twist, dt: float) -> Array:
        return parts.process_noise(noise, motion, mean(dt))

    return EkfSlam(task, replace(parts, process_noise=process_noise))


class MeanInterval(EkfSlam):
    """Motion and noise as if all intervals were alike."""

    def __init__(self, task: Task, parts: Parts) -> None:
        super().__init__(task, parts)
        self._mean = RunningMean()

    def predict(self, motion: Twist, dt: float) -> None:
        """Over the mean interval."""
        super().predict(motion, self._mean(dt))


class InputOfAnotherInterval(EkfSlam):
    """Each interval moves by the twist of the one before: off by one."""

    _before: Twist | None = None

    def predict(self, motion: Twist, dt: float) -> None:
        """By the twist before."""
        super().predict(self._before or motion, dt)
        self._before = motion


class FirstOrderPose(EkfSlam):
    """T (I + tau u^) for T exp(tau u^), which leaves SE(3)."""

    def predict(self, motion: Twist, dt: float) -> None:
        """The covariance as always, the pose to first order."""
        T = self.x.T @ (np.eye(4) + se3.hat(dt * motion.vector))
        super().predict(motion, dt)
        self.x.T = self.x.T_first = T


class TransitionFromPosterior(EkfSlam):
    """First estimates in H and G, but F from the pose that the last update left."""

    def predict(self, motion: Twist, dt: float) -> None:
        """Forget the first estimate of the pose before F is taken at it."""
        self.x.T_first = self.x.T
        super().predict(motion, dt)


class FeaturesOfAnotherFrame(EkfSlam):
    """Each pose meets the features of the frame before: off by one."""

    _before: Frame | None = None

    def update(self, frame: Frame) -> Innovation:
        """By the frame before; the first pose sees nothing."""
        late, self._before = self._before, frame
        return super().update(late or only(frame, frame.ids[:0]))


class PixelNoiseTwice(EkfSlam):
    """Adds to the pixels the noise that they have already."""

    def __init__(self, task: Task, parts: Parts) -> None:
        super().__init__(task, parts)
        self._rng = task.rng

    def update(self, frame: Frame) -> Innovation:
        """By noisier pixels."""
        z = frame.readings
        noise = self.noise.sigma(z) * self._rng.standard_normal(z.shape)
        return super().update(frame.with_readings(z + np.where(frame.there, noise, 0)))


class FusedTwice(EkfSlam):
    """Updates twice by the landmarks that were known."""

    def update(self, frame: Frame) -> Innovation:
        """Reports nothing of the second update."""
        innovation = super().update(replace(frame, last=np.zeros_like(frame.last)))
        super().update(only(frame, innovation.ids))
        return innovation


class BirthFusedAgain(EkfSlam):
    """Enters new landmarks, then updates by the pixels that made them."""

    def update(self, frame: Frame) -> Innovation:
        """Reports both updates as one."""
        known = super().update(replace(frame, last=np.zeros_like(frame.last)))
        born = super().update(only(frame, known.born))
        return replace(
            known,
            ids=np.concatenate([known.ids, born.ids]),
            residual=np.concatenate([known.residual, born.residual], axis=-2),
            whitened=np.concatenate([known.whitened, born.whitened], axis=-2),
            accepted=np.concatenate([known.accepted, born.accepted], axis=-1),
        )


class MaskOfResidualAlone(EkfSlam):
    """A landmark that is not seen has residual zero, and its H all the same."""

    def update(self, frame: Frame) -> Innovation:
        """As if each unseen landmark had been seen where it was expected."""
        x, seen = self.x, frame.ids[self.parts.valid(self.calibration, frame.readings)]
        slots = np.flatnonzero(~np.isin(self.ids, seen))
        expected = model.predicted(self.calibration, x.T, x.landmarks[..., slots, :])
        unseen, rest = self.ids[slots], ~np.isin(frame.ids, self.ids[slots])
        last = np.isin(unseen, frame.ids[frame.last])
        more = replace(
            frame,
            ids=np.concatenate([frame.ids[rest], unseen]),
            last=np.concatenate([frame.last[rest], last]),
        )
        z = np.concatenate([frame.readings[..., rest, :], expected], axis=-2)
        return super().update(more.with_readings(z))


def only(frame: Frame, ids: IntArray) -> Frame:
    """The frame in which nothing but these landmarks is seen."""
    return frame.without(~np.isin(frame.ids, ids)[:, None])
