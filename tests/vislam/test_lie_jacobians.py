"""Jacobians against the maps whose derivatives they are."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm, expm_frechet

from tests.vislam.lie_values import assert_same, dimension, each_group, elements, tangents
from vislam.lie import se3, so3


def central(function, size, step=1e-5):
    """The derivative at zero, by central differences extrapolated to fourth order."""
    coarse, fine = (
        (function(h * np.eye(size)) - function(-h * np.eye(size))) / (2 * h)
        for h in (2 * step, step)
    )
    return (4 * fine - coarse).T / 3


@each_group
@given(data=st.data())
def test_left_jacobian_is_the_derivative_of_exp_seen_from_the_left(group, data):
    """exp(xi + d) = exp(J_l d) exp(xi): the derivative of the matrix exponential, by Frechet."""
    xi = data.draw(tangents(group))
    A, inverse = group.hat(xi), group.inverse(group.exp(xi))
    for e, column in zip(np.eye(len(xi)), group.left_jacobian(xi).T, strict=True):
        derivative = expm_frechet(A, group.hat(e), compute_expm=False)
        assert_same(group.vee(derivative @ inverse), column, xi)


@each_group
@given(data=st.data())
def test_right_jacobian_is_the_derivative_of_exp_seen_from_the_right(group, data):
    xi = data.draw(tangents(group))
    A, inverse = group.hat(xi), group.inverse(group.exp(xi))
    for e, column in zip(np.eye(len(xi)), group.right_jacobian(xi).T, strict=True):
        derivative = expm_frechet(A, group.hat(e), compute_expm=False)
        assert_same(group.vee(inverse @ derivative), column, xi)


@each_group
@given(data=st.data())
def test_jacobians_are_those_of_log_of_products_by_differences(group, data):
    xi = data.draw(tangents(group))
    A, n = group.exp(xi), dimension[group]
    J_l, J_r = (
        central(lambda d: group.log(group.exp(xi + d) @ group.inverse(A)), n),
        central(lambda d: group.log(group.inverse(A) @ group.exp(xi + d)), n),
    )
    tolerance = 1e-8 * max(1, abs(xi).max())
    assert_allclose(group.left_jacobian(xi), J_l, rtol=0, atol=tolerance)
    assert_allclose(group.right_jacobian(xi), J_r, rtol=0, atol=tolerance)


@each_group
@given(data=st.data())
def test_inverse_jacobians_are_the_first_order_of_baker_campbell_hausdorff(group, data):
    """log(exp(d) exp(xi)) = xi + J_l^-1 d, log(exp(xi) exp(d)) = xi + J_r^-1 d."""
    xi = data.draw(tangents(group))
    angle = np.linalg.norm(xi[-3:])
    xi[-3:] *= min(1.0, 3.0 / angle) if angle else 1.0  # log jumps at pi
    A, n = group.exp(xi), dimension[group]
    tolerance = 1e-7 * max(1, abs(xi).max())
    left = central(lambda d: group.log(group.exp(d) @ A), n)
    right = central(lambda d: group.log(A @ group.exp(d)), n)
    assert_allclose(group.left_jacobian_inverse(xi), left, rtol=0, atol=tolerance)
    assert_allclose(group.right_jacobian_inverse(xi), right, rtol=0, atol=tolerance)


@each_group
@given(data=st.data())
def test_jacobian_times_its_inverse_is_one(group, data):
    xi = data.draw(tangents(group))
    one = np.eye(dimension[group])
    assert_same(group.left_jacobian(xi) @ group.left_jacobian_inverse(xi), one, xi)
    assert_same(group.right_jacobian_inverse(xi) @ group.right_jacobian(xi), one, xi)


@each_group
@given(data=st.data())
def test_right_jacobian_is_the_left_of_minus_and_they_differ_by_the_adjoint(group, data):
    xi = data.draw(tangents(group))
    J_l, J_r = group.left_jacobian(xi), group.right_jacobian(xi)
    assert_array_equal(J_r, group.left_jacobian(-xi))
    assert_array_equal(group.right_jacobian_inverse(xi), group.left_jacobian_inverse(-xi))
    assert_same(J_l, group.adjoint(group.exp(xi)) @ J_r, xi)


@given(xi=tangents())
def test_translation_of_exp_is_the_rotation_s_jacobian(xi):
    assert_same(se3.exp(xi)[:3, 3], so3.left_jacobian(xi[3:]) @ xi[:3], xi)


@given(T=elements(), p=st.tuples(*[st.floats(-20, 20)] * 3).map(np.array))
def test_odot_is_the_derivative_of_a_moved_point(T, p):
    """d exp(xi^) (T p) / d xi at zero is (T p)^odot."""
    moved = se3.apply(T, p[None])[0]
    derivative = central(lambda xi: (expm(se3.hat(xi)) @ np.append(moved, 1))[:, :3], 6)
    assert_allclose(se3.odot(moved), derivative, rtol=0, atol=1e-8 * max(1, abs(moved).max()))
