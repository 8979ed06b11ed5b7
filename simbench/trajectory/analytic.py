"""Motions in closed form: sums of sinusoids and straight lines, headings that follow a path."""

import numpy as np

from simbench.scenario.trajectories import Circle, Figure8, Helix, Hover, Random, Straight
from simbench.trajectory.interface import Derivatives, Level, Trajectory
from vislam.arrays import Array

ORDERS = 4  #: derivatives 0 to 3 of a path: the heading's second one takes the third
TERMS = 4  #: sinusoids to a coordinate of a random motion
#: Periods of a hover's x, y, z and yaw, over the period: no two in step.
INCOMMENSURATE = 1.0, 0.71, 0.83, 1.27


def wave(amplitude: Array, omega: Array, phase: Array) -> Derivatives:
    """A sinusoid, amplitude sin(omega t + phase), and its derivatives; all of shape (...)."""

    def derivatives(times_s: Array) -> Array:
        angle = np.multiply.outer(times_s, omega) + phase
        return np.stack(
            [amplitude * omega**k * np.sin(angle + k * np.pi / 2) for k in range(ORDERS)]
        )

    return derivatives


def line(velocity: Array) -> Derivatives:
    """A straight line through the origin, and its derivatives; velocity of shape (3,)."""

    def derivatives(times_s: Array) -> Array:
        out = np.zeros((ORDERS, len(times_s), 3))
        out[0] = np.multiply.outer(times_s, velocity)
        out[1] = velocity
        return out

    return derivatives


def heading(path: Derivatives) -> Derivatives:
    """The angle of a path's velocity in the plane, and its first two derivatives."""

    def derivatives(times_s: Array) -> Array:
        (vx, vy), (ax, ay), (jx, jy) = np.moveaxis(path(times_s)[1:4, :, :2], -1, 1)
        squared = vx * vx + vy * vy
        rate = (vx * ay - vy * ax) / squared
        acceleration = (vx * jy - vy * jx) / squared - 2 * rate * (vx * ax + vy * ay) / squared
        return np.stack([np.arctan2(vy, vx), rate, acceleration])

    return derivatives


def straight(keys: Straight) -> Trajectory:
    """Ahead."""
    return Level(line(np.array([keys.speed_mps, 0, 0])), lambda t: np.zeros((3, len(t))))


def circle(keys: Circle, duration_s: float) -> Trajectory:
    """To the left, from the origin."""
    return _circle(keys.radius_m, keys.laps, 0.0, duration_s)


def helix(keys: Helix, duration_s: float) -> Trajectory:
    """A circle and a climb."""
    return _circle(keys.radius_m, keys.laps, keys.climb_m, duration_s)


def _circle(radius_m: float, laps: float, climb_m: float, duration_s: float) -> Trajectory:
    omega = 2 * np.pi * laps / duration_s
    around = wave(
        radius_m * np.array([1.0, 1.0, 0.0]), np.full(3, omega), np.array([0, -np.pi / 2, 0])
    )
    climb = line(np.array([0, 0, climb_m / duration_s]))
    path = _sum(around, climb)
    return Level(path, heading(path))


def figure8(keys: Figure8, duration_s: float) -> Trajectory:
    """Gerono's lemniscate: x = a sin s, y = b sin 2s."""
    omega = 2 * np.pi * keys.laps / duration_s
    half = 0.5 * np.array([*keys.size_m, 0.0])
    path = wave(half, omega * np.array([1.0, 2.0, 0.0]), np.zeros(3))
    return Level(path, heading(path))


def hover(keys: Hover) -> Trajectory:
    """Sinusoids about the origin."""
    omega = 2 * np.pi / (keys.period_s * np.array(INCOMMENSURATE))
    path = wave(np.array(keys.sway_m), omega[:3], np.zeros(3))
    return Level(path, wave(np.deg2rad(keys.yaw_deg), omega[3], np.zeros(())))


def random(keys: Random, rng: np.random.Generator) -> Trajectory:
    """Sums of sinusoids whose amplitudes add up to the bound; coordinates x, y, z and yaw."""
    share, period, phase = np.moveaxis(rng.random((4, TERMS, 3)), -1, 0)
    bound = np.array([*(0.5 * np.array(keys.size_m)), np.deg2rad(keys.yaw_deg)])
    amplitude = bound[:, None] * share / share.sum(axis=1, keepdims=True)
    shortest, longest = keys.period_s
    omega = 2 * np.pi / (shortest + (longest - shortest) * period)
    waves = wave(amplitude, omega, 2 * np.pi * phase)
    return Level(
        lambda t: waves(t).sum(axis=-1)[..., :3],
        lambda t: waves(t).sum(axis=-1)[..., 3],
    )


def _sum(a: Derivatives, b: Derivatives) -> Derivatives:
    return lambda times_s: a(times_s) + b(times_s)
