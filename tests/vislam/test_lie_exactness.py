"""Every closed form against an exponential that knows nothing of it."""

from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from tests.vislam.lie_values import ANGLES, LENGTHS, assert_same
from vislam.lie import se3, so3
from vislam.lie.series import stumpff

each_angle = pytest.mark.parametrize("angle", ANGLES)


def grid(angle):
    """Tangents of one angle, at all lengths, in six pairs of directions."""
    rng = np.random.default_rng(12)
    for length, (r, a) in product(LENGTHS, rng.standard_normal((6, 2, 3))):
        yield np.concatenate([length * r / np.linalg.norm(r), angle * a / np.linalg.norm(a)])


def integral_of_exp(A):
    """The integral of expm(s A) over s from 0 to 1: a block of one larger exponential."""
    n = len(A)
    return expm(np.block([[A, np.eye(n)], [np.zeros((n, 2 * n))]]))[:n, n:]


def phi_hat(phi):
    return np.array([np.cross(phi, e) for e in np.eye(3)]).T


def xi_hat(xi):
    return np.vstack([np.column_stack([phi_hat(xi[3:]), xi[:3]]), np.zeros(4)])


def xi_check(xi):
    return np.block([[phi_hat(xi[3:]), phi_hat(xi[:3])], [np.zeros((3, 3)), phi_hat(xi[3:])]])


@each_angle
def test_exp_is_the_matrix_exponential(angle):
    for xi in grid(angle):
        assert_same(se3.exp(xi), expm(xi_hat(xi)), xi)
        assert_same(so3.exp(xi[3:]), expm(phi_hat(xi[3:])))


@each_angle
def test_adjoint_of_exp_is_the_matrix_exponential_of_ad(angle):
    for xi in grid(angle):
        assert_same(se3.adjoint(se3.exp(xi)), expm(xi_check(xi)), xi)
        assert_same(so3.adjoint(so3.exp(xi[3:])), expm(phi_hat(xi[3:])))


@each_angle
def test_left_jacobian_is_the_integral_of_the_exponential_of_ad(angle):
    for xi in grid(angle):
        assert_same(se3.left_jacobian(xi), integral_of_exp(xi_check(xi)), xi)
        assert_same(so3.left_jacobian(xi[3:]), integral_of_exp(phi_hat(xi[3:])))


@each_angle
def test_inverse_jacobian_is_the_inverse_matrix(angle):
    for xi in grid(angle):
        assert_same(se3.left_jacobian_inverse(xi), np.linalg.inv(se3.left_jacobian(xi)), xi)
        phi = xi[3:]
        assert_same(so3.left_jacobian_inverse(phi), np.linalg.inv(so3.left_jacobian(phi)))


@pytest.mark.parametrize("angle", [3.5, 5.0, 6.0])
def test_beyond_pi_the_closed_forms_still_hold(angle):
    for xi in grid(angle):
        assert_same(se3.exp(xi), expm(xi_hat(xi)), xi)
        assert_same(se3.left_jacobian(xi), integral_of_exp(xi_check(xi)), xi)
        product_ = se3.left_jacobian(xi) @ se3.left_jacobian_inverse(xi)
        assert_same(product_, np.eye(6), xi, se3.left_jacobian_inverse(xi))


@each_angle
def test_rotations_are_scipy_s(angle):
    for xi in grid(angle):
        R = Rotation.from_rotvec(xi[3:])
        assert_same(so3.exp(xi[3:]), R.as_matrix())
        assert_same(so3.log(R.as_matrix()) * np.sign(so3.log(R.as_matrix()) @ xi[3:] or 1), xi[3:])


def test_log_of_random_rotations_is_scipy_s():
    R = Rotation.random(500, np.random.default_rng(2))
    assert_same(so3.log(R.as_matrix()), R.as_rotvec())


@pytest.mark.parametrize("k", range(6))
def test_stumpff_functions_meet_at_the_threshold_and_hold_their_recursion(k):
    below, above = (stumpff(np.array(1 + step), 7)[k] for step in (-1e-15, 1e-15))
    assert_allclose(below, above, rtol=1e-13)
    for angle in np.array([0.0, 1e-7, 0.3, 0.999, 1.0, 2.0, np.pi, 6.0]):
        c = stumpff(angle, 7)
        factorial = np.prod(np.arange(1.0, k + 1))
        assert_allclose(c[k] + angle**2 * c[k + 2], 1 / factorial, rtol=1e-13)
