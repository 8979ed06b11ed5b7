"""The true motion of the body: pose, body twist and acceleration at any time, exact.

`make` gives the `Trajectory` that a scene names.
"""

import numpy as np

from simbench.rng import stream
from simbench.scenario import Scenario
from simbench.scenario import trajectories as kinds
from simbench.trajectory import analytic
from simbench.trajectory.interface import Motion, Placed, Trajectory
from vislam.lie import se3

__all__ = ["Motion", "Trajectory", "make"]


def make(scenario: Scenario, seed: int) -> Trajectory:
    """The trajectory of a scene: the same for every run.

    Args:
        scenario: the scene.
        seed: of the world, for a motion that has chance in it.
    """
    keys = scenario.trajectory
    given = _given(scenario, seed)
    sway = [
        analytic.wave(np.deg2rad(amplitude_deg), np.array(2 * np.pi / period_s), np.zeros(()))
        for amplitude_deg, period_s in (
            (keys.roll_deg, keys.roll_period_s),
            (keys.pitch_deg, keys.pitch_period_s),
        )
    ]
    T_world_given = np.eye(4)
    if keys.start != "given":
        T_world_imu = np.eye(4) if keys.start == "identity" else keys.start.T_world_imu
        T_world_given = T_world_imu @ se3.inverse(given.T_world_imu(np.zeros(1))[0])
    return Placed(T_world_given, given, *sway)


def _given(scenario: Scenario, seed: int) -> Trajectory:
    """The trajectory as its own keys put it, without sway."""
    keys, duration_s = scenario.trajectory, scenario.duration_s
    match keys:
        case kinds.Hover():
            return analytic.hover(keys)
        case kinds.Straight():
            return analytic.straight(keys)
        case kinds.Circle():
            return analytic.circle(keys, duration_s)
        case kinds.Figure8():
            return analytic.figure8(keys, duration_s)
        case kinds.Helix():
            return analytic.helix(keys, duration_s)
        case kinds.Random():
            return analytic.random(keys, stream(seed, 0, "trajectory"))
    from simbench.trajectory import splines  # the only ones that take scipy

    if isinstance(keys, kinds.Waypoints):
        return splines.waypoints(keys, duration_s)
    return splines.recorded(keys, scenario.rate_hz)
