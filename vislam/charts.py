"""Charts: how an estimate and an error vector make a state, and back.

A covariance means nothing without the chart of its error. The error vector of a
pose and m landmarks is e = (xi, f_1 .. f_m), shape (..., 6 + 3m), xi = (rho, phi),
and a chart satisfies ``retract(s, error(s, t)) == t`` and ``error(s, s) == 0``.

| name | pose | landmark |
|---|---|---|
| `right`, the paper's | T_true = T exp(xi^) | m_true = m + f |
| `left` | T_true = exp(xi^) T | m_true = m + f |
| `invariant` | T_true = exp(xi^) T | m_true = exp(phi^) m + J_l(phi) f |
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from vislam.arrays import Array
from vislam.lie import se3, so3

#: (T_hat, m_hat, T_true, m_true) -> e; poses (..., 4, 4), landmarks (..., m, 3).
ErrorFunction: TypeAlias = Callable[[Array, Array, Array, Array], Array]
#: (T_hat, m_hat, e) -> (T, m).
Retraction: TypeAlias = Callable[[Array, Array, Array], tuple[Array, Array]]


@dataclass(frozen=True, slots=True)
class Chart:
    """A name, the error function and its inverse, the retraction."""

    name: str
    error: ErrorFunction
    retract: Retraction


def _right_error(T_hat: Array, m_hat: Array, T: Array, m: Array) -> Array:
    return _stack(se3.log(se3.inverse(T_hat) @ T), m - m_hat)


def _right_retract(T_hat: Array, m_hat: Array, e: Array) -> tuple[Array, Array]:
    return T_hat @ se3.exp(e[..., :6]), m_hat + _landmark_part(e)


def _left_error(T_hat: Array, m_hat: Array, T: Array, m: Array) -> Array:
    return _stack(se3.log(T @ se3.inverse(T_hat)), m - m_hat)


def _left_retract(T_hat: Array, m_hat: Array, e: Array) -> tuple[Array, Array]:
    return se3.exp(e[..., :6]) @ T_hat, m_hat + _landmark_part(e)


def _invariant_error(T_hat: Array, m_hat: Array, T: Array, m: Array) -> Array:
    xi = se3.log(T @ se3.inverse(T_hat))
    theta = xi[..., 3:]
    turned = m_hat @ so3.inverse(so3.exp(theta))
    return _stack(xi, (m - turned) @ so3.inverse(so3.left_jacobian_inverse(theta)))


def _invariant_retract(T_hat: Array, m_hat: Array, e: Array) -> tuple[Array, Array]:
    theta = e[..., 3:6]
    turned = m_hat @ so3.inverse(so3.exp(theta))
    moved = _landmark_part(e) @ so3.inverse(so3.left_jacobian(theta))
    return se3.exp(e[..., :6]) @ T_hat, turned + moved


def _stack(xi: Array, f: Array) -> Array:
    f = f.reshape(*f.shape[:-2], 3 * f.shape[-2])
    batch = np.broadcast_shapes(xi.shape[:-1], f.shape[:-1])
    parts = [np.broadcast_to(part, (*batch, part.shape[-1])) for part in (xi, f)]
    return np.concatenate(parts, axis=-1)


def _landmark_part(e: Array) -> Array:
    return e[..., 6:].reshape(*e.shape[:-1], e.shape[-1] // 3 - 2, 3)


RIGHT = Chart("right", _right_error, _right_retract)
LEFT = Chart("left", _left_error, _left_retract)
INVARIANT = Chart("invariant", _invariant_error, _invariant_retract)
CHARTS = {chart.name: chart for chart in (RIGHT, LEFT, INVARIANT)}
