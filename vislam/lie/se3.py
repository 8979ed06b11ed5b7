"""Rigid motions. See `vislam.lie` for the table of operations."""

import numpy as np

from vislam.arrays import Array
from vislam.lie import so3
from vislam.lie.series import polynomial

#: xi^ and ad(xi) of the six axes of xi = (rho, phi).
_HATS, _ADS = np.zeros((6, 4, 4)), np.zeros((6, 6, 6))
_HATS[range(3), range(3), 3] = 1
_HATS[3:, :3, :3] = _ADS[:3, :3, 3:] = _ADS[3:, :3, :3] = _ADS[3:, 3:, 3:] = so3.GENERATORS


def from_rotation_translation(R: Array, p: Array) -> Array:
    """The motion x -> R x + p, as a 4x4 matrix."""
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = p
    T[..., 3, 3] = 1
    return T


def hat(xi: Array) -> Array:
    """The 4x4 matrix xi^ = [phi^, rho; 0, 0] of xi = (rho, phi)."""
    return so3.combined(xi, _HATS)


def vee(xi_hat: Array) -> Array:
    """The vector of a matrix xi^: ``vee(hat(xi)) == xi``."""
    return np.concatenate([xi_hat[..., :3, 3], so3.vee(xi_hat[..., :3, :3])], axis=-1)


def ad(xi: Array) -> Array:
    """The paper's u check, [phi^, rho^; 0, phi^], shape (..., 6, 6); Ad of exp is expm of ad."""
    return so3.combined(xi, _ADS)


def exp(xi: Array) -> Array:
    """The motion of a tangent vector, I + xi^ + c_2 xi^^2 + c_3 xi^^3 (Barfoot 7.32).

    To rounding within a turn; powers lose digits with the angle, 1e-14 at 30 rad.
    """
    xi = np.asarray(xi, float)
    _, _, c2, c3 = so3.coefficients(xi[..., 3:], 3)
    return polynomial(hat(xi), 1, 1, c2, c3)


def log(T: Array) -> Array:
    """The tangent vector of a motion, rotation angle at most pi."""
    phi = so3.log(T[..., :3, :3])
    rho = (so3.left_jacobian_inverse(phi) @ T[..., :3, 3, None])[..., 0]
    return np.concatenate([rho, phi], axis=-1)


def inverse(T: Array) -> Array:
    """The inverse motion, by transposing the rotation."""
    R_inverse = so3.inverse(T[..., :3, :3])
    return from_rotation_translation(R_inverse, -(R_inverse @ T[..., :3, 3, None])[..., 0])


def adjoint(T: Array) -> Array:
    """Ad_T = [R, p^ R; 0, R], with T exp(xi) T^-1 = exp(Ad_T xi) (Barfoot 7.45)."""
    R = T[..., :3, :3]
    return _block_triangular(R, so3.hat(T[..., :3, 3]) @ R)


def apply(T: Array, points: Array) -> Array:
    """Map points of shape (..., n, 3)."""
    return points @ so3.inverse(T[..., :3, :3]) + T[..., None, :3, 3]


def left_jacobian(xi: Array) -> Array:
    """J_l = [J, Q; 0, J], with exp(xi + d) = exp(J_l d) exp(xi) to first order.

    The sum of X^k / (k + 1)!, X = ad(xi), of which (X^2 + angle^2)^2 X = 0 leaves five terms
    (Barfoot 7.86, with the Stumpff functions for the quotients).
    """
    xi = np.asarray(xi, float)
    _, c1, c2, c3, c4, c5 = so3.coefficients(xi[..., 3:], 5)
    return polynomial(
        ad(xi), 1, 2 * c2 - 0.5 * c1, 2.5 * c3 - 0.5 * c2, 0.5 * c3 - c4, 0.5 * c4 - 1.5 * c5
    )


def left_jacobian_inverse(xi: Array) -> Array:
    """The inverse of J_l, for rotation angles below 2 pi (Barfoot 7.95b)."""
    xi = np.asarray(xi, float)
    J_inverse = so3.left_jacobian_inverse(xi[..., 3:])
    Q = left_jacobian(xi)[..., :3, 3:]
    return _block_triangular(J_inverse, -J_inverse @ Q @ J_inverse)


def right_jacobian(xi: Array) -> Array:
    """J_r(xi) = J_l(-xi), with exp(xi + d) = exp(xi) exp(J_r d) to first order."""
    return left_jacobian(-np.asarray(xi))


def right_jacobian_inverse(xi: Array) -> Array:
    """The inverse of J_r, for rotation angles below 2 pi."""
    return left_jacobian_inverse(-np.asarray(xi))


def random(
    rng: np.random.Generator, shape: tuple[int, ...] = (), sigma_translation: float = 1.0
) -> Array:
    """Motions with a uniform rotation and a normal translation."""
    R = so3.random(rng, shape)
    return from_rotation_translation(R, sigma_translation * rng.standard_normal((*shape, 3)))


def odot(points: Array) -> Array:
    """The 3x6 matrix [I, -s^] of each point s, with xi^ (s, 1) = (s^odot xi, 0)."""
    out = np.empty((*points.shape, 6))
    out[..., :3] = so3.IDENTITY
    out[..., 3:] = -so3.hat(points)
    return out


def _block_triangular(diagonal: Array, upper_right: Array) -> Array:
    """[diagonal, upper_right; 0, diagonal], shape (..., 6, 6)."""
    out = np.zeros((*diagonal.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = diagonal
    out[..., :3, 3:] = upper_right
    return out
