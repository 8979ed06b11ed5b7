"""The functions in which every closed form of SO(3) and SE(3) is written."""

import math

import numpy as np

from vislam.arrays import Array

_SERIES_BELOW = 1.0  # rad; the quotients have lost at most two digits there
_POWERS = np.arange(9)  # the first term left out is at most 1 / 18!, 2e-16
_HIGHEST = 7
#: Of angle^2i in c_k: (-1)^i / (2i + k)!, by i and k.
_COEFFICIENTS = np.array(
    [[(-1) ** i / math.factorial(2 * i + k) for k in range(_HIGHEST + 1)] for i in _POWERS.tolist()]
)


def stumpff(angle: Array, highest: int) -> list[Array]:
    """Stumpff functions c_0 to c_highest of an angle, c_k = sum_i (-1)^i angle^2i / (2i + k)!.

    c_0 = cos, c_1 = sin / angle, and c_k+2 = (1 / k! - c_k) / angle^2: so c_2 is
    (1 - cos) / angle^2, c_3 is (angle - sin) / angle^3, and so on. That recursion cancels near
    zero, where the series itself is summed; relative error below 1e-13 on both sides.

    Args:
        angle: radians, not negative, any shape.
        highest: largest k, from 1 to 7.
    """
    squared = angle * angle
    small = angle < _SERIES_BELOW
    if small.all():
        return _series(squared, highest)
    large = np.where(small, 1.0, angle)
    values = [np.cos(large), np.sin(large) / large]
    for k in range(highest - 1):
        values.append((1 / math.factorial(k) - values[k]) / (large * large))
    if small.any():
        near = np.where(small, squared, 0.0)
        both = zip(_series(near, highest), values, strict=True)
        values = [np.where(small, series, value) for series, value in both]
    return values


def _series(squared: Array, highest: int) -> list[Array]:
    """The series of c_0 to c_highest."""
    total = squared[..., None] ** _POWERS @ _COEFFICIENTS[:, : highest + 1]
    return [total[..., k] for k in range(highest + 1)]


def polynomial(X: Array, *coefficients: Array | float) -> Array:
    """a_0 I + a_1 X + a_2 X^2 + ..., by Horner's rule.

    Args:
        X: square matrices, shape (..., n, n).
        coefficients: a_0, a_1, ..., each a number or of shape (..., 1, 1).
    """
    *others, highest = coefficients
    one = np.eye(X.shape[-1])
    total = others.pop() * one + highest * X
    for coefficient in reversed(others):
        total = total @ X + coefficient * one
    return total
