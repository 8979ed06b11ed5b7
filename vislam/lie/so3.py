"""Rotations. See `vislam.lie` for the table of operations."""

import numpy as np

from vislam.arrays import Array
from vislam.lie.series import polynomial, stumpff

IDENTITY: Array = np.eye(3)
#: hat(e_i) of the three axes.
GENERATORS: Array = np.array([np.cross(IDENTITY, axis) for axis in IDENTITY])


def hat(phi: Array) -> Array:
    """The matrix phi^ with phi^ x = phi cross x, shape (..., 3) to (..., 3, 3)."""
    return combined(phi, GENERATORS)


def combined(x: Array, matrices: Array) -> Array:
    """The sum of x_i M_i over k matrices, shapes (..., k) and (k, n, n) to (..., n, n)."""
    x, (k, *shape) = np.asarray(x, float), matrices.shape
    return (x @ matrices.reshape(k, -1)).reshape(*x.shape[:-1], *shape)


def vee(phi_hat: Array) -> Array:
    """The vector of a skew-symmetric matrix: ``vee(hat(phi)) == phi``."""
    return np.stack([phi_hat[..., 2, 1], phi_hat[..., 0, 2], phi_hat[..., 1, 0]], axis=-1)


ad = hat  #: The adjoint of the algebra: on so(3) it is `hat` itself.


def exp(phi: Array) -> Array:
    """The rotation of a rotation vector, I + c_1 phi^ + c_2 phi^ phi^ (Barfoot 7.14)."""
    _, c1, c2 = coefficients(phi, 2)
    return polynomial(hat(phi), 1, c1, c2)


def log(R: Array) -> Array:
    """The rotation vector of a rotation, of length at most pi; of the two at pi, one.

    The unit quaternion is read from the row of 4 q q^T with the largest diagonal element, so no
    digits are lost at zero nor at pi (Shepperd, J. Guidance and Control 1(3), 1978).
    """
    R = np.asarray(R, float)
    x, y, z = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    outer = np.empty((*R.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1 + x + y + z
    outer[..., 1, 1] = 1 + x - y - z
    outer[..., 2, 2] = 1 - x + y - z
    outer[..., 3, 3] = 1 - x - y + z
    for i, j in ((0, 1), (1, 2), (2, 0)):
        k = 3 - i - j
        outer[..., 0, k + 1] = outer[..., k + 1, 0] = R[..., j, i] - R[..., i, j]
        outer[..., i + 1, j + 1] = outer[..., j + 1, i + 1] = R[..., i, j] + R[..., j, i]
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    quaternion = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion = np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1)
    half_angle = np.arctan2(sine, quaternion[..., 0])
    ratio = np.divide(2 * half_angle, sine, out=np.full_like(sine, 2.0), where=sine > 0)
    phi: Array = ratio[..., None] * quaternion[..., 1:]
    return phi


def inverse(R: Array) -> Array:
    """The transpose."""
    return np.swapaxes(R, -1, -2)


def adjoint(R: Array) -> Array:
    """Ad_R = R: ``R @ exp(phi) @ R^T == exp(Ad_R phi)``."""
    return R


def apply(R: Array, points: Array) -> Array:
    """Rotate points of shape (..., n, 3)."""
    return points @ inverse(R)


def left_jacobian(phi: Array) -> Array:
    """J_l, with exp(phi + d) = exp(J_l d) exp(phi) to first order in d (Barfoot 7.77a)."""
    _, _, c2, c3 = coefficients(phi, 3)
    return polynomial(hat(phi), 1, c2, c3)


def left_jacobian_inverse(phi: Array) -> Array:
    """The inverse of J_l, for angles below 2 pi (Barfoot 7.76a, with the cotangent rewritten)."""
    _, _, c2, c3, c4 = coefficients(phi, 4)
    return polynomial(hat(phi), 1, -0.5, (c3 - 2 * c4) / (2 * c2))


def right_jacobian(phi: Array) -> Array:
    """J_r(phi) = J_l(-phi), with exp(phi + d) = exp(phi) exp(J_r d) to first order in d."""
    return left_jacobian(-np.asarray(phi))


def right_jacobian_inverse(phi: Array) -> Array:
    """The inverse of J_r, for angles below 2 pi."""
    return left_jacobian_inverse(-np.asarray(phi))


def random(rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
    """Rotations uniform on SO(3): the rotation part of a normal 4-vector as quaternion."""
    w, *v = np.moveaxis(rng.standard_normal((*shape, 4)), -1, 0)
    vector = np.stack(v, axis=-1)
    sine = np.linalg.norm(vector, axis=-1)
    return exp((2 * np.arctan2(sine, w) / sine)[..., None] * vector)


def coefficients(phi: Array, highest: int) -> list[Array]:
    """Stumpff functions c_0 to c_highest of the angle of phi, (..., 3), each (..., 1, 1)."""
    phi = np.asarray(phi, float)
    angle = np.sqrt(np.einsum("...i,...i->...", phi, phi))
    return stumpff(angle[..., None, None], highest)
