"""What every chart must satisfy, and how the two relate."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from tests.vislam.lie_values import assert_same, elements, tangents
from vislam.charts import CHARTS, INVARIANT, LEFT, RIGHT
from vislam.lie import se3

each_chart = pytest.mark.parametrize("chart", CHARTS.values(), ids=CHARTS.keys())

maps = (
    st.integers(0, 3)
    .flatmap(lambda m: st.lists(st.tuples(*[st.floats(-50, 50)] * 3), min_size=m, max_size=m))
    .map(lambda points: np.array(points).reshape(-1, 3))
)


@st.composite
def errors(draw, m):
    f = draw(st.lists(st.floats(-5, 5), min_size=3 * m, max_size=3 * m))
    return np.concatenate([draw(tangents()), f])


@each_chart
@given(T=elements(), m=maps, data=st.data())
def test_error_undoes_retraction(chart, T, m, data):
    e = data.draw(errors(len(m)))
    assert_same(chart.error(T, m, *chart.retract(T, m, e)), e, T, m, e)


@each_chart
@given(T_hat=elements(), T=elements(), m=maps)
def test_retraction_undoes_error(chart, T_hat, T, m):
    e = chart.error(T_hat, m, T, m[::-1])
    T_back, m_back = chart.retract(T_hat, m, e)
    assert e.shape == (6 + 3 * len(m),)
    assert_same(T_back, T, T_hat, T, e)
    assert_same(m_back, m[::-1], m)


@each_chart
@given(T=elements(), m=maps)
def test_error_of_a_state_against_itself_is_zero(chart, T, m):
    assert_same(chart.error(T, m, T, m), np.zeros(6 + 3 * len(m)), T)
    T_same, m_same = chart.retract(T, m, np.zeros(6 + 3 * len(m)))
    assert_array_equal(T_same, T)
    assert_array_equal(m_same, m)


@given(T=elements(), e=tangents())
def test_right_and_left_errors_differ_by_the_adjoint_of_the_estimate(T, e):
    """T exp(xi) = exp(Ad_T xi) T; the landmarks' errors are the same."""
    m, e = np.ones((1, 3)), np.concatenate([e, [1, 2, 3]])
    left = np.concatenate([se3.adjoint(T) @ e[:6], e[6:]])
    by_right, by_left = RIGHT.retract(T, m, e), LEFT.retract(T, m, left)
    assert_same(by_right[0], by_left[0], T, left)
    assert_array_equal(by_right[1], by_left[1])
    back = LEFT.error(T, m, *by_right)
    assert_same(back[:3], left[:3], T, left, e)
    assert_same(back[3:], left[3:])


@given(T=elements(), xi=tangents())
def test_each_chart_perturbs_on_its_own_side(T, xi):
    none = np.empty((0, 3))
    assert_same(RIGHT.retract(T, none, xi)[0], T @ expm(se3.hat(xi)), T, xi)
    assert_same(LEFT.retract(T, none, xi)[0], expm(se3.hat(xi)) @ T, T, xi)


def test_landmark_errors_keep_their_order_and_sign():
    m_hat = np.zeros((2, 3))
    m = np.arange(6.0).reshape(2, 3)
    for chart in CHARTS.values():
        assert_array_equal(chart.error(np.eye(4), m_hat, np.eye(4), m)[6:], [0, 1, 2, 3, 4, 5])


@each_chart
@pytest.mark.parametrize("shape", [(4,), (2, 3), (0,)])
@pytest.mark.parametrize("m", [0, 2])
def test_a_batch_is_a_loop(chart, shape, m):
    rng = np.random.default_rng(6)
    T_hat, T = se3.random(rng, shape), se3.random(rng, shape)
    m_hat, points = rng.standard_normal((2, *shape, m, 3))
    e = chart.error(T_hat, m_hat, T, points)
    back = chart.retract(T_hat, m_hat, e)
    assert e.shape == (*shape, 6 + 3 * m)
    assert (back[0].shape, back[1].shape) == (T.shape, points.shape)
    for i in np.ndindex(shape):
        assert_allclose(e[i], chart.error(T_hat[i], m_hat[i], T[i], points[i]), rtol=1e-13)
        one = chart.retract(T_hat[i], m_hat[i], e[i])
        assert_allclose(back[0][i], one[0], rtol=0, atol=1e-14)
        assert_array_equal(back[1][i], one[1])


def test_charts_are_listed_by_their_names():
    assert CHARTS == {"right": RIGHT, "left": LEFT, "invariant": INVARIANT}
    assert all(chart.name == name for name, chart in CHARTS.items())


@given(T=elements(), m=maps, theta=st.tuples(*[st.floats(-1.7, 1.7)] * 3))
def test_a_turn_whose_landmark_error_undoes_it_moves_no_landmark_in_the_invariant_chart(
    T, m, theta
):
    """Exp(theta) f + J_l(theta) (f^ theta) = f: the retraction that is right to all orders."""
    theta = np.array(theta)
    e = np.concatenate([np.zeros(3), theta, np.cross(m, theta).ravel()])
    _, moved = INVARIANT.retract(T, m, e)
    assert_allclose(moved, m, rtol=0, atol=1e-12 * (1 + np.abs(m).max(initial=0)))
