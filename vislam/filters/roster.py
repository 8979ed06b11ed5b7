"""Which landmarks a filter's state holds, and which have left it."""

from dataclasses import replace

import numpy as np

from vislam.arrays import Array, IntArray
from vislam.types import Belief


def slots_of(state_ids: IntArray, ids: IntArray) -> IntArray:
    """The place of each landmark among those of the state, -1 for one that it does not hold."""
    if not len(state_ids):
        return np.full(len(ids), -1)
    order = np.argsort(state_ids)
    slots = order.take(np.searchsorted(state_ids, ids, sorter=order), mode="clip")
    return np.where(state_ids[slots] == ids, slots, -1)


class Retired:
    """Landmarks that have left the state."""

    def __init__(self) -> None:
        self._ids: list[IntArray] = []
        self._landmarks: list[Array] = []
        self._covariances: list[Array] = []

    def add(self, ids: IntArray, landmarks: Array, covariances: Array) -> None:
        """Keep landmarks, shapes (d,), (..., d, 3) and (..., d, 3, 3)."""
        self._ids.append(ids)
        self._landmarks.append(landmarks)
        self._covariances.append(covariances)

    def joined_to(self, living: Belief) -> Belief:
        """The belief over these and the living landmarks, by ascending id.

        Of a landmark that came back as a new one, the one added first.
        """
        ids = np.concatenate([living.ids, *self._ids])
        landmarks = np.concatenate([living.landmarks, *self._landmarks], axis=-2)
        covariances = np.concatenate([living.landmark_covariances, *self._covariances], axis=-3)
        _, order = np.unique(ids, return_index=True)
        return replace(
            living,
            ids=ids[order],
            landmarks=landmarks[..., order, :],
            landmark_covariances=covariances[..., order, :, :],
        )
