"""What a filter holds true, how surely, and what a frame had to say to it."""

from dataclasses import dataclass, field

import numpy as np

from vislam.arrays import Array, BoolArray, IntArray
from vislam.charts import CHARTS, ErrorFunction


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """A pose and a map: the truth, or an estimate without its uncertainty.

    Attributes:
        T_world_imu: shape (..., 4, 4).
        ids: landmark ids in ascending order, shape (m,).
        landmarks: positions in the world, metres, shape (..., m, 3).
    """

    T_world_imu: Array
    ids: IntArray
    landmarks: Array


def _no_ids() -> IntArray:
    return np.empty(0, np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Belief:
    """A snapshot of what a filter holds true, and how surely.

    Attributes:
        T_world_imu: estimated pose, shape (..., 4, 4).
        pose_covariance: of the pose's error, shape (..., 6, 6); None where the pose is not
            estimated.
        ids: landmarks in the order of the arrays below, shape (m,).
        landmarks: their positions in the world, metres, shape (..., m, 3).
        landmark_covariances: of each alone, shape (..., m, 3, 3).
        joint_covariance: of the whole error vector, pose first, shape (..., 6 + 3m, 6 + 3m), or
            (..., 3m, 3m) where the pose is not estimated. None where it was not asked for.
        chart: the chart of the error: a name in `vislam.charts.CHARTS`, or an error function.
    """

    T_world_imu: Array
    pose_covariance: Array | None = None
    ids: IntArray = field(default_factory=_no_ids)
    landmarks: Array = field(default_factory=lambda: np.empty((0, 3)))
    landmark_covariances: Array = field(default_factory=lambda: np.empty((0, 3, 3)))
    joint_covariance: Array | None = None
    chart: str | ErrorFunction = "right"

    @property
    def of_pose(self) -> "Belief":
        """What it holds of the pose alone."""
        return Belief(
            T_world_imu=self.T_world_imu, pose_covariance=self.pose_covariance, chart=self.chart
        )

    def error(self, truth: State) -> Array:
        """The error vector in this belief's chart, in the order of its joint covariance.

        Args:
            truth: the true state; it must know every landmark of `ids`.

        Returns:
            Shape (..., 6 + 3m), or (..., 3m) where the pose is not estimated.

        Raises:
            KeyError: the truth lacks a landmark of this belief.
        """
        if len(missing := np.setdiff1d(self.ids, truth.ids)):
            raise KeyError(f"The truth lacks landmarks {missing.tolist()}.")
        place = np.searchsorted(truth.ids, self.ids)
        e = self._error(self.landmarks, truth.T_world_imu, truth.landmarks[..., place, :])
        return e if self.pose_covariance is not None else e[..., 6:]

    def pose_error(self, T_world_imu: Array) -> Array:
        """The error of the pose alone in this belief's chart, shape (..., 6)."""
        batch = np.broadcast_shapes(self.T_world_imu.shape[:-2], T_world_imu.shape[:-2])
        none = np.empty((*batch, 0, 3))
        return self._error(none, T_world_imu, none)

    def _error(self, landmarks: Array, true_T: Array, true_landmarks: Array) -> Array:
        function = CHARTS[self.chart].error if isinstance(self.chart, str) else self.chart
        return function(self.T_world_imu, landmarks, true_T, true_landmarks)


@dataclass(frozen=True, slots=True, kw_only=True)
class Innovation:
    """What one frame's features had to say, before they changed the belief.

    The whitened residual of an accepted sighting has c numbers. Of a stereo pair four: three that
    the state explains, decorrelated over the frame, and (vL - vR) over its sigma. Of a point sensor
    the first three. With a right filter all are independent standard normal.

    Attributes:
        ids: known landmarks with a valid sighting, whose residual was tested, shape (k,).
        residual: measured minus predicted readings, shape (..., k, c).
        whitened: zero where not accepted, shape (..., k, c).
        accepted: what was used, shape (..., k). The rest is predicted behind the camera, or too
            vaguely to be linear, or was refused by the gate.
        born: ids that entered the map by this frame, shape (b,).
        skipped: ids of invalid features that were not all -1, shape (s,).
    """

    ids: IntArray
    residual: Array
    whitened: Array
    accepted: BoolArray
    born: IntArray = field(default_factory=_no_ids)
    skipped: IntArray = field(default_factory=_no_ids)

    @property
    def nis(self) -> Array:
        """Normalised innovation squared of the accepted sightings, shape (...)."""
        nis: Array = np.square(self.whitened).sum(axis=(-2, -1))
        return nis

    @property
    def dof(self) -> IntArray:
        """Its degrees of freedom, c for each accepted sighting, shape (...)."""
        dof: IntArray = self.whitened.shape[-1] * np.count_nonzero(self.accepted, axis=-1)
        return dof

    @property
    def rejected(self) -> IntArray:
        """How many the gate refused, shape (...)."""
        rejected: IntArray = np.count_nonzero(~self.accepted, axis=-1)
        return rejected


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothed:
    """What a filter knows at the end of the past.

    Attributes:
        final: the final belief over all landmarks.
        poses: the pose at each frame given all that came before and after it, frame by frame;
            empty where nobody asked for it.
    """

    final: Belief
    poses: tuple[Belief, ...] = ()
