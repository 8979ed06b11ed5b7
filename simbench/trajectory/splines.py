"""Motions through given poses: cubic splines of position and angles, and of rotations.

A cubic spline with natural ends has a continuous acceleration, also where it goes on straight
beyond its ends.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from simbench.scenario.sensors import R_BODY_OPTICAL
from simbench.scenario.trajectories import TrajectoryFile, Waypoints
from simbench.trajectory.interface import (
    Derivatives,
    Level,
    Motion,
    Trajectory,
    X,
    Y,
    Z,
    rotation,
    translation,
    turn,
)
from vislam.arrays import Array
from vislam.lie import se3, so3

#: Between two waypoints a heading along the path is taken at this many instants.
HEADINGS = 8


def natural(times_s: Array, values: Array) -> Derivatives:
    """The natural cubic spline through values of shape (n, ...), straight on beyond its ends."""
    spline = CubicSpline(times_s, values, bc_type="natural")

    def derivatives(t: Array) -> Array:
        inside = np.clip(t, times_s[0], times_s[-1])
        out = np.stack([spline(inside, k) for k in range(4)])
        beyond = (t - inside).reshape(-1, *(1,) * (values.ndim - 1))
        out[0] += out[1] * beyond
        out[2:] *= beyond == 0
        return out

    return derivatives


def waypoints(keys: Waypoints, duration_s: float) -> Trajectory:
    """Through the points, in time; heading along the path where no attitude is given."""
    points = np.array(keys.points)
    times_s = _times(points, duration_s) if keys.times_s is None else np.array(keys.times_s)
    path = natural(times_s, points)
    if keys.quaternions is not None:
        return Recorded(path, times_s, Rotation.from_quat(keys.quaternions))
    if keys.attitude_deg is not None:
        attitude = np.unwrap(np.deg2rad(keys.attitude_deg), axis=0)
        return Attitude(path, natural(times_s, attitude))
    return Level(path, _along(path, times_s))


def recorded(keys: TrajectoryFile, rate_hz: float) -> Trajectory:
    """Through the poses of a file, in a scene of this rate."""
    poses = keys.poses(rate_hz)
    times_s, Ts = poses.elapsed_s, poses.Ts_world_imu
    if keys.axes == "optical":
        T_flu_optical = se3.from_rotation_translation(R_BODY_OPTICAL, np.zeros(3))
        Ts = T_flu_optical @ Ts @ T_flu_optical.T
    return Recorded(natural(times_s, Ts[:, :3, 3]), times_s, Rotation.from_matrix(Ts[:, :3, :3]))


@dataclass(frozen=True, slots=True)
class Attitude(Trajectory):
    """Along a path, with roll, pitch and yaw of their own, turned about z, then y, then x.

    Attributes:
        path: position and its derivatives, shape (3 or more, n, 3).
        angles: roll, pitch, yaw and their derivatives, radians, idem.
    """

    path: Derivatives
    angles: Derivatives

    def at(self, times_s: Array) -> Motion:
        """See `Trajectory`."""
        roll, pitch, yaw = np.moveaxis(self.angles(times_s)[:3], -1, 0)
        turned = turn(Z, *yaw) @ turn(Y, *pitch) @ turn(X, *roll)
        return translation(*self.path(times_s)[:3]) @ turned


class Recorded(Trajectory):
    """Along a path, through given rotations; beyond the ends it turns on at the last rate."""

    def __init__(self, path: Derivatives, times_s: Array, rotations: Rotation) -> None:
        """Fit the rotations, as many as times."""
        self._path = path
        self._ends = times_s[0], times_s[-1]
        self._spline = RotationSpline(times_s, rotations)

    def at(self, times_s: Array) -> Motion:
        """See `Trajectory`."""
        inside = np.clip(times_s, *self._ends)
        beyond = (times_s - inside)[:, None]
        rate = self._spline(inside, 1)
        R = self._spline(inside).as_matrix() @ so3.exp(rate * beyond)
        turned = rotation(R, rate, self._spline(inside, 2) * (beyond == 0))
        return translation(*self._path(times_s)[:3]) @ turned


def _times(points: Array, duration_s: float) -> Array:
    """Times that share a duration out by the distance between points."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    distance: Array = np.concatenate([[0], np.cumsum(steps)])
    return distance * (duration_s / float(distance[-1]))


def _along(path: Derivatives, times_s: Array) -> Derivatives:
    """A spline through headings along a path.

    The path's third derivative jumps at the waypoints, and with it the second one of its exact
    heading; the spline does not. Where the path stands still, the heading is between those around.
    """
    knots = np.arange(len(times_s))
    instants = np.interp(np.linspace(0, knots[-1], HEADINGS * knots[-1] + 1), knots, times_s)
    velocity = path(instants)[1, :, :2]
    speed = np.linalg.norm(velocity, axis=1)
    moving = speed > 1e-6 * speed.max()
    if not moving.any():
        return lambda t: np.zeros((4, len(t)))
    yaw = np.unwrap(np.arctan2(velocity[moving, 1], velocity[moving, 0]))
    return natural(instants, np.interp(instants, instants[moving], yaw))
