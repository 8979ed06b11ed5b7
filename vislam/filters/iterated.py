"""EKF-SLAM whose update is iterated: for large innovations, as where a loop closes.

The extended filter linearises once, at the prediction. The iterated one minimises

    |L_P^-1 delta|^2 + |z - h(x + delta)|^2

by Gauss-Newton steps, each linearised where the last one led. The Jacobians are carried back by the
transport, not by the exact derivative of the chart, so that no step sees what cannot be observed:
that ends within a tenth of a standard deviation of the minimum. Source: Bell, Cathey, The iterated
Kalman filter update as a Gauss-Newton method, IEEE Transactions on Automatic Control 38(2), 1993.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from vislam.arrays import Array
from vislam.filters.consistent import TRANSPORTED
from vislam.filters.observation import Observation
from vislam.filters.records import Correct
from vislam.filters.slam import EkfSlam

MOST_STEPS = 5
#: A step that changes no number of the state by more than this, in metres and radians, is the last.
SMALL_STEP = 1e-4


def gauss_newton(
    first: Correct,
    seen_from: Callable[[Array], Observation],
    correct: Callable[[Observation], Correct],
) -> Correct:
    """The correction linearised where it leads itself.

    Args:
        first: linearised at the prediction.
        seen_from: the accepted sightings, linearised where an error vector leads.
        correct: the update that an observation makes of the state as predicted.
    """
    last = first
    for _ in range(MOST_STEPS - 1):
        observation = seen_from(last.delta)
        if not np.isfinite(observation.r).all():  # a landmark has come behind the camera
            return last
        step = correct(observation)
        change = np.abs(step.delta - last.delta).max(initial=0.0)
        last = step
        if change <= SMALL_STEP:
            break
    return last


ITERATED = replace(TRANSPORTED, iterate=gauss_newton)
slam_iterated = partial(EkfSlam, parts=ITERATED)
