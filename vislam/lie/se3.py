"""Rigid motions. See `vislam.lie` for the table of operations."""

import numpy as np

from vislam.arrays import Array
from vislam.lie import so3
from vislam.lie.series import stumpff


def from_rotation_translation(R: Array, p: Array) -> Array:
    """The motion x -> R x + p, as a 4x4 matrix."""
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = p
    T[..., 3, 3] = 1
    return T


def hat(xi: Array) -> Array:
    """The 4x4 matrix xi^ = [phi^, rho; 0, 0] of xi = (rho, phi)."""
    xi = np.asarray(xi, float)
    out = np.zeros((*xi.shape[:-1], 4, 4))
    out[..., :3, :3] = so3.hat(xi[..., 3:])
    out[..., :3, 3] = xi[..., :3]
    return out


def vee(xi_hat: Array) -> Array:
    """The vector of a matrix xi^: ``vee(hat(xi)) == xi``."""
    return np.concatenate([xi_hat[..., :3, 3], so3.vee(xi_hat[..., :3, :3])], axis=-1)


def ad(xi: Array) -> Array:
    """The paper's u check, [phi^, rho^; 0, phi^], shape (..., 6, 6); Ad of exp is expm of ad."""
    xi = np.asarray(xi, float)
    return _block_triangular(so3.hat(xi[..., 3:]), so3.hat(xi[..., :3]))


def exp(xi: Array) -> Array:
    """The motion of a tangent vector: R = exp phi^ and t = J_l rho (Barfoot 7.32)."""
    xi = np.asarray(xi, float)
    _, c1, c2, c3 = _coefficients(xi, 3)
    phi_hat = so3.hat(xi[..., 3:])
    squared = phi_hat @ phi_hat
    R = so3.IDENTITY + c1 * phi_hat + c2 * squared
    V = so3.IDENTITY + c2 * phi_hat + c3 * squared
    return from_rotation_translation(R, (V @ xi[..., :3, None])[..., 0])


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
    """J_l = [J, Q; 0, J], with exp(xi + d) = exp(J_l d) exp(xi) to first order (Barfoot 7.85b)."""
    xi = np.asarray(xi, float)
    return _block_triangular(so3.left_jacobian(xi[..., 3:]), _q(xi))


def left_jacobian_inverse(xi: Array) -> Array:
    """The inverse of J_l, for rotation angles below 2 pi (Barfoot 7.95b)."""
    xi = np.asarray(xi, float)
    J_inverse = so3.left_jacobian_inverse(xi[..., 3:])
    return _block_triangular(J_inverse, -J_inverse @ _q(xi) @ J_inverse)


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


def _q(xi: Array) -> Array:
    """The upper right block of J_l (Barfoot 7.86b)."""
    _, _, _, c3, c4, c5 = _coefficients(xi, 5)
    rho, phi = so3.hat(xi[..., :3]), so3.hat(xi[..., 3:])
    phi_rho, rho_phi = phi @ rho, rho @ phi
    phi_rho_phi = phi_rho @ phi
    return (
        0.5 * rho
        + c3 * (phi_rho + rho_phi + phi_rho_phi)
        + c4 * (phi @ phi_rho + rho_phi @ phi - 3 * phi_rho_phi)
        + (0.5 * c4 - 1.5 * c5) * (phi_rho_phi @ phi + phi @ phi_rho_phi)
    )


def _block_triangular(diagonal: Array, upper_right: Array) -> Array:
    """[diagonal, upper_right; 0, diagonal], shape (..., 6, 6)."""
    out = np.zeros((*diagonal.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = diagonal
    out[..., :3, 3:] = upper_right
    return out


def _coefficients(xi: Array, highest: int) -> list[Array]:
    """Stumpff functions of the rotation angle of xi, shaped to multiply (..., 3, 3) matrices."""
    angle = np.sqrt(np.sum(np.square(xi[..., 3:]), axis=-1))
    return [c[..., None, None] for c in stumpff(angle, highest)]
