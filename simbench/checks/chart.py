"""Derivatives through a belief's own chart, for any chart, by its error function alone."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vislam.arrays import Array
from vislam.lie import se3
from vislam.types import Belief, State

#: Of a five-point stencil: truncation is of fourth order, rounding about 1e-16 over it.
STEP = 1e-3


def derivative(function: Callable[[Array], Array], size: int) -> Array:
    """The Jacobian of a function at zero, by five-point stencils.

    Args:
        function: takes many arguments at once, (k, size), and returns as many values, (k, n).
        size: of its argument.

    Returns:
        Shape (n, size).
    """
    steps = STEP * np.concatenate([k * np.eye(size) for k in (1, -1, 2, -2)])
    near, back, far, far_back = np.split(function(steps), 4)
    return np.asarray((8 * (near - back) - (far - far_back)).T / (12 * STEP))


def state_of(belief: Belief) -> State:
    """A belief's estimate, as a state by ascending id."""
    order = np.argsort(belief.ids, kind="stable")
    return State(
        T_world_imu=belief.T_world_imu, ids=belief.ids[order], landmarks=belief.landmarks[order]
    )


def moved(state: State, g: Array) -> State:
    """A state after a rigid motion of the world."""
    return replace(
        state, T_world_imu=g @ state.T_world_imu, landmarks=se3.apply(g, state.landmarks)
    )


def varied(state: State, d: Array) -> State:
    """States beside another: d has six numbers for the pose, then three for each landmark."""
    T = state.T_world_imu @ se3.exp(d[..., :6])
    steps = d[..., 6:].reshape(*d.shape[:-1], len(state.ids), 3)
    return replace(state, T_world_imu=T, landmarks=state.landmarks + steps)


def gauge(belief: Belief, centre: Array) -> Array:
    """How a rigid motion of the whole world shows in a belief's error, shape (6 + 3m, 6).

    No measurement tells these directions from zero.

    Args:
        belief: gives the chart and the order of the landmarks.
        centre: point about which the world turns, metres, shape (3,).
    """
    state = state_of(belief)
    to_centre = se3.from_rotation_translation(np.eye(3), centre)

    def error(xi: Array) -> Array:
        g = to_centre @ se3.exp(xi) @ se3.inverse(to_centre)
        return belief.error(moved(state, g))

    return derivative(error, 6)
