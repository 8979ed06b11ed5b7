"""Which sightings an update uses: those predicted well enough, and seen where they may be."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vislam.arrays import Array, BoolArray
from vislam.filters import model
from vislam.filters.observation import Observation
from vislam.types import Calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """The test of each sighting alone, before the update.

    Attributes:
        calibration: told geometry.
        probability: that a right sighting passes; None lets all pass.
        within: which squared distances pass, by the probability and the degrees of freedom; of two
            that differ the larger never passes alone.
    """

    calibration: Calibration
    probability: float | None
    within: Callable[[Array, float, int], BoolArray]

    def accepted(self, observation: Observation, P: Array, W: Array, white: Array) -> BoolArray:
        """Which sightings are to be used.

        What bounds let pass is not looked at again: variances are below those of
        `Observation.variance_bounds`, and as S >= I no distance is above the one by I.

        Args:
            observation: of k landmarks.
            P: covariance of the state, shape (..., n, n).
            W: as of `vislam.filters.model.whitening`.
            white: whitened residuals, shape (..., k, c).

        Returns:
            Shape (..., k).
        """
        squared = np.square(white)
        accepted = self._pass(W, observation.variance_bounds(P), squared.sum(axis=-1))
        doubtful = np.flatnonzero(~model.in_all_runs(accepted))
        if len(doubtful):
            some = observation.of_landmarks(doubtful)
            S_each = some.innovation_covariance_of_each(P)
            distances = some.distances(S_each) + squared[..., doubtful, 3:].sum(axis=-1)
            each = W if W.ndim == 2 else W[..., doubtful, :, :]  # one for all, or one for each
            variances = np.einsum("...ii->...i", S_each)
            accepted[..., doubtful] = self._pass(each, variances, distances)
        return accepted

    def _pass(self, W: Array, variances: Array, distances: Array) -> BoolArray:
        passed = model.predictable(self.calibration, W, variances)
        if self.probability is not None:
            passed &= self.within(distances, self.probability, W.shape[-1])
        return passed
