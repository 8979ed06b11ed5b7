"""Awkward elements and tangents of SO(3) and SE(3), for the laws of `vislam.lie`."""

import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vislam.lie import se3, so3

each_group = pytest.mark.parametrize("group", [so3, se3], ids=["so3", "se3"])
dimension = {so3: 3, se3: 6}

#: From zero over both sides of the series' threshold to pi.
ANGLES = [
    0,
    1e-12,
    1e-9,
    1e-6,
    1e-3,
    0.1,
    0.5,
    1 - 1e-9,
    1,
    1 + 1e-9,
    1.5,
    2,
    3,
    np.pi - 1e-9,
    np.pi,
]
LENGTHS = [0, 0.1, 1, 10, 100]

_angles = st.sampled_from([a for a in ANGLES if a < 3.1]) | st.floats(0, np.pi - 1e-7)
_lengths = st.sampled_from(LENGTHS) | st.floats(0, 100)


@st.composite
def directions(draw):
    """Unit vectors, the axes and nearly the axes among them."""
    number = st.sampled_from([0.0, 1.0, 1e-9]) | st.floats(-1, 1)
    a = np.array(draw(st.tuples(number, number, number)))
    norm = np.linalg.norm(a)
    return a / norm if norm > 1e-3 else np.array([0.0, 0.0, 1.0])


@st.composite
def tangents(draw, group=se3):
    """Tangents of a rotation angle below pi, where log undoes exp."""
    phi = draw(_angles) * draw(directions())
    return phi if group is so3 else np.concatenate([draw(_lengths) * draw(directions()), phi])


def elements(group=se3):
    return tangents(group).map(group.exp)


def assert_same(actual, desired, *involved):
    """Equal to 1e-12 of the largest number involved, or of one: translations are of any size."""
    scale = max([1.0, *(float(np.abs(a).max(initial=0)) for a in involved)])
    assert_allclose(actual, desired, rtol=0, atol=1e-12 * scale)
