"""Group axioms, exp against log, adjoints, actions, batches and chance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from tests.vislam.lie_values import (
    assert_same,
    dimension,
    directions,
    each_group,
    elements,
    tangents,
)
from vislam.lie import se3, so3

POINTS = np.array([[0.3, -2, 7], [0, 0, 0], [-40, 5, 0.1], [1e-9, 3, -2]])


@each_group
@given(data=st.data())
def test_identity_inverse_and_product_make_a_group(group, data):
    A, B, C = (data.draw(elements(group)) for _ in range(3))
    one = group.exp(np.zeros(dimension[group]))
    assert_array_equal(one, np.eye(len(A)))
    assert_same((A @ B) @ C, A @ (B @ C), A, B, C)
    assert_same(group.inverse(A) @ A, one, A)
    assert_same(A @ group.inverse(A), one, A)
    assert_same(group.inverse(A @ B), group.inverse(B) @ group.inverse(A), A, B)


@each_group
@given(data=st.data())
def test_exp_is_a_rigid_motion(group, data):
    A = data.draw(elements(group))
    assert_same(A[:3, :3] @ A[:3, :3].T, np.eye(3))
    assert np.linalg.det(A[:3, :3]) > 0
    if group is se3:
        assert_array_equal(A[3], [0, 0, 0, 1])


@each_group
@given(data=st.data(), s=st.floats(-1, 1), t=st.floats(-1, 1))
def test_multiples_of_one_tangent_add_up(group, data, s, t):
    xi = data.draw(tangents(group))
    assert_same(group.exp(s * xi) @ group.exp(t * xi), group.exp((s + t) * xi), xi)


@each_group
@given(data=st.data())
def test_log_undoes_exp_below_pi(group, data):
    xi = data.draw(tangents(group))
    assert_same(group.log(group.exp(xi)), xi, xi)


@each_group
@given(data=st.data(), scale=st.sampled_from([1e-3, 1e-8, 1e-12, 1e-100]))
def test_small_tangents_keep_their_digits_through_exp_and_log(group, data, scale):
    xi = scale * data.draw(tangents(group))
    assert_allclose(group.log(group.exp(xi)), xi, rtol=0, atol=1e-13 * abs(xi).max())


@given(
    axis=directions(), below=st.sampled_from([0, 1e-15, 1e-12, 1e-9, 1e-7, 1e-4]), rho=directions()
)
def test_log_is_stable_at_pi(axis, below, rho):
    """At pi itself the axis is known but for its sign: either is right, if exp leads back."""
    T = se3.exp(np.concatenate([100 * rho, (np.pi - below) * axis]))
    back = se3.log(T)
    assert np.linalg.norm(back[3:]) <= np.pi + 1e-15
    assert_same(abs(back[3:] @ axis), np.pi - below)
    assert_same(se3.exp(back), T, T)
    if below > 1e-14:
        assert_same(back[3:], (np.pi - below) * axis)
        assert_same(back[:3], 100 * rho, T, back)


@pytest.mark.parametrize("R", [np.diag([1, -1, -1]), np.diag([-1, 1, -1]), np.diag([-1, -1, 1])])
def test_half_turns_about_the_axes_have_the_log_they_should(R):
    assert_array_equal(np.abs(so3.log(R)), np.pi * (np.diag(R) > 0))


@each_group
@given(data=st.data())
def test_vee_undoes_hat(group, data):
    xi = data.draw(tangents(group))
    assert_array_equal(group.vee(group.hat(xi)), xi)


@given(a=tangents(so3), b=directions())
def test_hat_is_the_cross_product(a, b):
    assert_same(so3.hat(a) @ b, np.cross(a, b))


@each_group
@given(data=st.data())
def test_ad_is_the_bracket(group, data):
    x, y = data.draw(tangents(group)), data.draw(tangents(group))
    bracket = group.hat(x) @ group.hat(y) - group.hat(y) @ group.hat(x)
    assert_same(group.hat(group.ad(x) @ y), bracket, np.outer(x, y))


@each_group
@given(data=st.data())
def test_adjoint_moves_a_tangent_through_an_element(group, data):
    A, xi = data.draw(elements(group)), data.draw(tangents(group))
    moved = group.adjoint(A) @ xi
    assert_same(A @ group.hat(xi), group.hat(moved) @ A, moved, A)
    assert_same(A @ group.exp(xi), group.exp(moved) @ A, moved, A)


@each_group
@given(data=st.data())
def test_adjoint_is_a_homomorphism(group, data):
    A, B = data.draw(elements(group)), data.draw(elements(group))
    Ad_A, Ad_B = group.adjoint(A), group.adjoint(B)
    assert_same(group.adjoint(A @ B), Ad_A @ Ad_B, Ad_A, Ad_B)
    assert_same(group.adjoint(group.inverse(A)), np.linalg.inv(Ad_A), Ad_A)


@given(A=elements())
def test_apply_maps_points_as_the_matrix_does(A):
    homogeneous = np.column_stack([POINTS, np.ones(4)])
    assert_same(se3.apply(A, POINTS), (A @ homogeneous.T)[:3].T, A, POINTS)
    assert_same(so3.apply(A[:3, :3], POINTS), (A[:3, :3] @ POINTS.T).T, POINTS)


@given(xi=tangents(), direction=directions())
def test_odot_swaps_a_tangent_and_a_point(xi, direction):
    s = 20 * direction
    assert_same(se3.odot(s) @ xi, (se3.hat(xi) @ np.append(s, 1))[:3], 20 * xi)


def calls(group, xi):
    """Every function with an argument of the batch shape of xi."""
    A = group.exp(xi)
    taking_tangents = ["exp", "hat", "ad", "left_jacobian", "right_jacobian"]
    taking_tangents += ["left_jacobian_inverse", "right_jacobian_inverse"]
    yield from ((getattr(group, name), xi) for name in taking_tangents)
    yield from ((getattr(group, name), A) for name in ("log", "inverse", "adjoint"))
    yield group.vee, group.hat(xi)
    yield (lambda A: group.apply(A, POINTS)), A
    if group is se3:
        yield se3.odot, xi[..., :3]
        yield (lambda A: se3.from_rotation_translation(A[..., :3, :3], A[..., :3, 3])), A


@each_group
@pytest.mark.parametrize("shape", [(), (5,), (2, 3), (0,), (2, 0)])
def test_a_batch_is_a_loop(group, shape):
    rng = np.random.default_rng(3)
    size = rng.choice([1e-9, 0.3, 1.3], (*shape, 1))
    xi = size * rng.standard_normal((*shape, dimension[group]))
    single = calls(group, np.ones(dimension[group]))
    for (function, batch), (_, one) in zip(calls(group, xi), single, strict=True):
        out = function(batch)
        assert out.shape == shape + function(one).shape
        for index in np.ndindex(shape):
            assert_allclose(out[index], function(batch[index]), rtol=1e-14, atol=1e-15)


@each_group
def test_random_elements_repeat_and_have_the_shape_asked_for(group):
    first, again = (group.random(np.random.default_rng(5), (2, 3)) for _ in range(2))
    assert_array_equal(first, again)
    assert first.shape == (2, 3, *group.random(np.random.default_rng(5)).shape)
    assert len(np.unique(first[..., 0, 0])) == 6


def two_sided(statistic, dof, false_alarm):
    return false_alarm / 2 < chi2.cdf(statistic, dof) < 1 - false_alarm / 2


def test_random_rotations_are_uniform():
    """N = 20,000, six tests at 1e-3 each, two-sided.

    Under the Haar measure a rotated axis is uniform on the sphere, so each of its coordinates is
    uniform on (-1, 1); the angle has the density (1 - cos) / pi on (0, pi).
    """
    R = so3.random(np.random.default_rng(0), (20_000,))
    angle = np.linalg.norm(so3.log(R), axis=-1)
    uniform = [(1 + R[:, i, j]) / 2 for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (2, 0))]
    for u in [*uniform, (angle - np.sin(angle)) / np.pi]:
        counts = np.histogram(u, 50, (0, 1))[0]
        assert two_sided(np.sum((counts - 400) ** 2) / 400, 49, 1e-3)


def test_random_translations_are_normal_with_the_sigma_asked_for():
    """N = 20,000 in three coordinates, two-sided at 1e-3."""
    p = se3.random(np.random.default_rng(1), (20_000,), sigma_translation=7.0)[:, :3, 3]
    assert two_sided(np.sum(np.square(p / 7)), 60_000, 1e-3)
    assert two_sided(np.sum(np.square(p.mean(axis=0) / 7)) * 20_000, 3, 1e-3)
