"""What a trajectory is, and how it is put together from simple motions.

A motion T(t) has the body twist u = (T^-1 T')v and the acceleration u'. The product of two motions
has both in closed form, so a trajectory is written as a product of translations and rotations
about fixed axes, and its derivatives are exact.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from vislam.arrays import Array
from vislam.lie import se3, so3

#: Derivatives 0 to k of something at n instants, from the times: shape (n,) to (k + 1, n, ...).
Derivatives: TypeAlias = Callable[[Array], Array]

X, Y, Z = np.eye(3)


@dataclass(frozen=True, slots=True)
class Motion:
    """A motion at n instants.

    Attributes:
        T: the pose, shape (n, 4, 4).
        twist: body velocity (v, omega), m/s and rad/s, shape (n, 6).
        acceleration: its time derivative, shape (n, 6).
    """

    T: Array
    twist: Array
    acceleration: Array

    def __matmul__(self, other: "Motion") -> "Motion":
        """The product A B: u = Ad(B^-1) u_A + u_B, and d/dt Ad(B^-1) = -ad(u_B) Ad(B^-1)."""
        Ad = se3.adjoint(se3.inverse(other.T))
        u = _apply(Ad, self.twist)
        return Motion(
            self.T @ other.T,
            u + other.twist,
            _apply(Ad, self.acceleration) - _apply(se3.ad(other.twist), u) + other.acceleration,
        )


def translation(p: Array, velocity: Array, acceleration: Array) -> Motion:
    """Along a path, without turning; all shapes (n, 3)."""
    still = np.zeros_like(p)
    return Motion(
        se3.from_rotation_translation(np.broadcast_to(so3.IDENTITY, (len(p), 3, 3)), p),
        np.hstack([velocity, still]),
        np.hstack([acceleration, still]),
    )


def rotation(R: Array, rate: Array, acceleration: Array) -> Motion:
    """About the origin: R (n, 3, 3), its body rate and the derivative of that, (n, 3)."""
    still = np.zeros_like(rate)
    return Motion(
        se3.from_rotation_translation(R, still),
        np.hstack([still, rate]),
        np.hstack([still, acceleration]),
    )


def turn(axis: Array, angle: Array, rate: Array, acceleration: Array) -> Motion:
    """About a fixed axis; angle, rate and acceleration have shape (n,)."""
    along = np.stack([angle, rate, acceleration])[..., None] * axis
    return rotation(so3.exp(along[0]), along[1], along[2])


class Trajectory(ABC):
    """Where the body is at any time and how it moves, exact, also before 0 and after the end."""

    @abstractmethod
    def at(self, times_s: Array) -> Motion:
        """Pose, twist and acceleration at instants, shape (n,), seconds from the start."""

    def T_world_imu(self, times_s: Array) -> Array:
        """Poses, shape (n, 4, 4)."""
        return self.at(times_s).T

    def twist(self, times_s: Array) -> Array:
        """Body twists (v, omega) at the instants, m/s and rad/s, shape (n, 6)."""
        return self.at(times_s).twist

    def acceleration(self, times_s: Array) -> Array:
        """Time derivatives of the twist, m/s^2 and rad/s^2, shape (n, 6).

        Of the velocity's coordinates in the body: the acceleration of the body's origin, in the
        body, is dv/dt + omega x v.
        """
        return self.at(times_s).acceleration


@dataclass(frozen=True, slots=True)
class Level(Trajectory):
    """Along a path, upright, with a heading.

    Attributes:
        path: position and its derivatives, at least the second, shape (3 or more, n, 3).
        yaw: heading and its first two derivatives, radians, shape (3, n).
    """

    path: Derivatives
    yaw: Derivatives

    def at(self, times_s: Array) -> Motion:
        """See `Trajectory`."""
        return translation(*self.path(times_s)[:3]) @ turn(Z, *self.yaw(times_s)[:3])


@dataclass(frozen=True, slots=True)
class Placed(Trajectory):
    """Another trajectory, with a sway in the body, and moved as a whole.

    Attributes:
        T_world_given: from the frame of the other trajectory to the world, shape (4, 4).
        given: the other trajectory.
        roll, pitch: angles and their first two derivatives, radians, shape (3, n).
    """

    T_world_given: Array
    given: Trajectory
    roll: Derivatives
    pitch: Derivatives

    def at(self, times_s: Array) -> Motion:
        """See `Trajectory`."""
        motion = self.given.at(times_s)
        motion = motion @ turn(Y, *self.pitch(times_s)[:3]) @ turn(X, *self.roll(times_s)[:3])
        return Motion(self.T_world_given @ motion.T, motion.twist, motion.acceleration)


def _apply(matrices: Array, vectors: Array) -> Array:
    return (matrices @ vectors[..., None])[..., 0]
