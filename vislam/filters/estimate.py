"""The mutable estimate of a filter with a map."""

from dataclasses import dataclass, replace

import numpy as np

from vislam.arrays import Array, BoolArray, IntArray


@dataclass(slots=True)
class Estimate:
    """Pose and living landmarks, and what was first thought of them.

    Attributes:
        T: pose, shape (..., 4, 4).
        T_first: the pose as predicted for the present frame.
        landmarks: shape (..., m, 3).
        landmarks_first: as they entered the state.
        Ts_world_cam: the camera as it stood when each entered, shape (..., m, 4, 4).
    """

    T: Array
    T_first: Array
    landmarks: Array
    landmarks_first: Array
    Ts_world_cam: Array

    @classmethod
    def of(cls, T: Array, landmarks: Array, T_world_cam: Array) -> "Estimate":
        """The estimate in which all landmarks, (..., m, 3), enter now."""
        Ts = np.repeat(T_world_cam[..., None, :, :], landmarks.shape[-2], axis=-3)
        return cls(T=T, T_first=T, landmarks=landmarks, landmarks_first=landmarks, Ts_world_cam=Ts)

    def of_landmarks(self, chosen: IntArray | BoolArray) -> "Estimate":
        """The same pose with some of the landmarks."""
        return replace(
            self,
            landmarks=self.landmarks[..., chosen, :],
            landmarks_first=self.landmarks_first[..., chosen, :],
            Ts_world_cam=self.Ts_world_cam[..., chosen, :, :],
        )

    def joined_by(self, new: "Estimate") -> "Estimate":
        """With the landmarks of another at the end."""
        return replace(
            self,
            landmarks=np.concatenate([self.landmarks, new.landmarks], axis=-2),
            landmarks_first=np.concatenate([self.landmarks_first, new.landmarks_first], axis=-2),
            Ts_world_cam=np.concatenate([self.Ts_world_cam, new.Ts_world_cam], axis=-3),
        )
