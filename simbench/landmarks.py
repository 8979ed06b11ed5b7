"""True landmark fields, in the world.

Landmark i is made from the i-th row of random numbers, whatever their count: a field of fewer
landmarks is the beginning of one of more.
"""

import numpy as np

from simbench.files import parse_rows
from simbench.rng import stream
from simbench.scenario import Scenario
from simbench.scenario import landmarks as kinds
from simbench.trajectory import Trajectory
from vislam.arrays import Array

#: Instants at which the path is taken to find places beside it.
PATH_SAMPLES = 4001


def make(scenario: Scenario, trajectory: Trajectory, seed: int) -> Array:
    """The landmarks of a scene: the same for every run.

    Args:
        scenario: the scene.
        trajectory: its trajectory.
        seed: of the world.

    Returns:
        Positions in the world, metres, shape (M, 3).
    """
    keys = scenario.landmarks
    if isinstance(keys, kinds.LandmarkFile):
        return parse_rows(keys.text, 3, scenario.name)
    Ts = trajectory.T_world_imu(np.linspace(0, scenario.duration_s, PATH_SAMPLES))
    # As many columns for every kind, so that a row does not depend on how a kind uses it.
    uniform = stream(seed, 0, "landmarks").random((keys.count, 4))
    match keys:
        case kinds.Box():
            return _center(keys.center_m, Ts) + (uniform[:, :3] - 0.5) * keys.size_m
        case kinds.Shell():
            return _center(keys.center_m, Ts) + _shell(keys, uniform)
        case kinds.Ground():
            low, high = _bounds(Ts)
            low, high = low - keys.margin_m, high + keys.margin_m
            return np.column_stack(
                [(low + (high - low) * uniform[:, :3])[:, :2], np.full(keys.count, keys.height_m)]
            )
        case kinds.Walls():
            sides = keys.lateral_m, keys.lateral_m
            return _beside(Ts, keys.ahead_m, sides, keys.height_m, uniform)
    return _beside(Ts, keys.ahead_m, keys.lateral_m, keys.height_m, uniform)


def _bounds(Ts: Array) -> tuple[Array, Array]:
    """The corners of the box that holds a path."""
    p = Ts[:, :3, 3]
    return p.min(axis=0), p.max(axis=0)


def _center(center_m: str | tuple[float, float, float], Ts: Array) -> Array:
    """The centre of a field."""
    return np.mean(_bounds(Ts), axis=0) if isinstance(center_m, str) else np.array(center_m)


def _shell(keys: kinds.Shell, uniform: Array) -> Array:
    """Even in volume: height on the unit sphere, longitude and cubed radius are uniform."""
    inner, outer = keys.radius_m
    radius = np.cbrt(inner**3 + (outer**3 - inner**3) * uniform[:, 2])
    up = 2 * uniform[:, 0] - 1
    level = np.sqrt(1 - up * up)
    longitude = 2 * np.pi * uniform[:, 1]
    direction = np.stack([level * np.cos(longitude), level * np.sin(longitude), up], axis=-1)
    offset: Array = radius[:, None] * direction
    return offset


def _beside(
    Ts: Array,
    ahead_m: float,
    lateral_m: tuple[float, float],
    height_m: tuple[float, float],
    uniform: Array,
) -> Array:
    """Even along a path and beyond its end, at a distance to either side and above or below."""
    forward = Ts[:, :3, 0] * [1, 1, 0]
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
    p = np.vstack([Ts[:, :3, 3], Ts[-1, :3, 3] + ahead_m * forward[-1]])
    forward = np.vstack([forward, forward[-1]])
    # A path of no length is walked along in time: the small number keeps it increasing.
    steps = np.linalg.norm(np.diff(p, axis=0), axis=1) + 1e-9
    arc = np.concatenate([[0], np.cumsum(steps)])
    where = arc[-1] * uniform[:, 0]
    place, ahead = (
        np.stack([np.interp(where, arc, axis) for axis in values.T], axis=-1)
        for values in (p, forward)
    )
    left = np.stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(ahead))], axis=-1)
    side = np.where(uniform[:, 1] < 0.5, -1.0, 1.0)
    lateral = side * (lateral_m[0] + (lateral_m[1] - lateral_m[0]) * uniform[:, 2])
    place[:, 2] += height_m[0] + (height_m[1] - height_m[0]) * uniform[:, 3]
    points: Array = place + lateral[:, None] * left
    return points
