"""The stereo rig against camera matrices, derivatives against definitions, validity by table."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from vislam.camera import (
    BehindCamera,
    StereoRig,
    Validity,
    d_project_d_point,
    d_triangulate_d_reading,
    in_front,
    is_valid,
    project,
    project_or_nan,
    triangulate,
    validity,
)

RIG = StereoRig(
    fx_px=552.5, fy_px=540.1, cx_px=682.0, cy_px=238.8, baseline_m=0.6, image_px=(1242, 376)
)

rigs = st.builds(
    StereoRig,
    fx_px=st.floats(50, 3000),
    fy_px=st.floats(50, 3000),
    cx_px=st.floats(-100, 2000),
    cy_px=st.floats(-100, 2000),
    baseline_m=st.floats(0.01, 5),
)


@st.composite
def points(draw):
    """Four points in a wide cone before the camera, from 0.1 to 1000 m."""
    depth = draw(
        st.lists(st.sampled_from([0.1, 1.0, 1000.0]) | st.floats(0.1, 1000), min_size=4, max_size=4)
    )
    slopes = draw(st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=4, max_size=4))
    return np.array([[z * x, z * y, z] for z, (x, y) in zip(depth, slopes, strict=True)])


def complex_step(function, x):
    """d function / d x of a function of one row, exact to rounding."""
    return np.stack([function(x + 1e-30j * e).imag / 1e-30 for e in np.eye(len(x))], axis=-1)


def by_camera_matrices(rig, p):
    """The pixels of one point by P_L = K [I, 0] and P_R = K [I, -b e_x]."""
    K = np.array([[rig.fx_px, 0, rig.cx_px], [0, rig.fy_px, rig.cy_px], [0, 0, 1]])
    pixels = []
    for centre in ([0, 0, 0], [rig.baseline_m, 0, 0]):
        uvw = K @ np.column_stack([np.eye(3), -np.array(centre)]) @ np.append(p, 1)
        pixels += [uvw[0] / uvw[2], uvw[1] / uvw[2]]
    return np.array(pixels)


def by_similar_triangles(rig, z):
    """The point of one feature, from two rays: b apart, disparity over fx their difference."""
    ray = np.array([(z[0] - rig.cx_px) / rig.fx_px, ((z[1] + z[3]) / 2 - rig.cy_px) / rig.fy_px, 1])
    return ray * rig.baseline_m / ((z[0] - z[2]) / rig.fx_px)


@given(rig=rigs, p=points())
def test_projection_is_that_of_the_two_camera_matrices(rig, p):
    expected = np.array([by_camera_matrices(rig, one) for one in p])
    assert_allclose(project(rig, p), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@given(rig=rigs, p=points())
def test_projection_is_the_paper_s_stereo_matrix_times_pi(rig, p):
    q = np.column_stack([p, np.ones(4)])
    z = (q / q[:, 2:3]) @ rig.K_s.T
    assert_allclose(project(rig, p), z, rtol=1e-12, atol=1e-12 * np.abs(z).max())


def test_intrinsic_and_stereo_matrix_are_as_the_paper_writes_them():
    assert_array_equal(RIG.K, [[552.5, 0, 682.0], [0, 540.1, 238.8], [0, 0, 1]])
    assert_array_equal(
        RIG.K_s,
        [
            [552.5, 0, 682.0, 0],
            [0, 540.1, 238.8, 0],
            [552.5, 0, 682.0, -552.5 * 0.6],
            [0, 540.1, 238.8, 0],
        ],
    )


@given(rig=rigs, p=points())
def test_triangulation_undoes_projection(rig, p):
    pixels = project(rig, p)
    disparity = pixels[:, 0] - pixels[:, 2]
    focal = min(rig.fx_px, rig.fy_px)
    digits_lost = 1 + np.abs(pixels).max() * (1 / disparity.min() + 1 / focal)
    tolerance = 1e-14 * digits_lost * np.abs(p).max()
    assert_allclose(triangulate(rig, pixels), p, rtol=0, atol=tolerance)


def test_triangulation_averages_the_two_rows():
    pixels = project(RIG, np.array([[1.0, -0.4, 6.0]]))
    apart = pixels + np.array([0, 3, 0, -3])
    assert_allclose(triangulate(RIG, apart), triangulate(RIG, pixels), rtol=1e-13)


@given(rig=rigs, p=points())
def test_jacobian_of_projection_is_its_derivative(rig, p):
    J = d_project_d_point(rig, p)
    for one, derivative in zip(p, J, strict=True):
        expected = complex_step(lambda x: by_camera_matrices(rig, x), one)
        assert_allclose(derivative, expected, rtol=1e-11, atol=1e-11 * np.abs(expected).max())


@given(rig=rigs, p=points(), mismatch=st.floats(-5, 5))
def test_jacobian_of_triangulation_is_its_derivative(rig, p, mismatch):
    pixels = project(rig, p) + np.array([0, mismatch, 0, 0])
    J = d_triangulate_d_reading(rig, pixels)
    for z, derivative in zip(pixels, J, strict=True):
        expected = complex_step(lambda x: by_similar_triangles(rig, x), z)
        assert_allclose(derivative, expected, rtol=1e-11, atol=1e-11 * np.abs(expected).max())


@given(rig=rigs, p=points())
def test_jacobians_of_projection_and_triangulation_are_inverse(rig, p):
    pixels = project(rig, p)
    back = d_triangulate_d_reading(rig, pixels)
    there = d_project_d_point(rig, triangulate(rig, pixels))
    for one, A, B in zip(back @ there, np.abs(back), np.abs(there), strict=True):
        assert_allclose(one, np.eye(3), rtol=0, atol=1e-13 * (A @ B).max())


@pytest.mark.parametrize("shape", [(0,), (3,), (2, 3), (2, 0), (4, 2, 1)])
def test_a_batch_of_features_is_a_loop(shape):
    rng = np.random.default_rng(1)
    p = rng.uniform([-2, -2, 2], [2, 2, 20], (*shape, 3))
    pixels = project(RIG, p)
    pixels[rng.random(shape) < 0.3] = -1
    good = project(RIG, p)
    for function, batch in (
        (project, p),
        (d_project_d_point, p),
        (triangulate, good),
        (d_triangulate_d_reading, good),
        (validity, pixels),
    ):
        out = function(RIG, batch)
        for index in np.ndindex(shape):
            assert_array_equal(out[index], function(RIG, batch[index][None])[0])
        assert out.shape[: len(shape)] == shape
    assert validity(RIG, pixels).dtype == np.int64


def test_points_behind_the_camera_are_named():
    p = np.array([[[0, 0, 1.0], [0, 0, -1]], [[0, 0, np.nan], [0, 0, 1e-3]]])
    assert_array_equal(in_front(p), [[True, False], [False, False]])
    with pytest.raises(
        BehindCamera, match=r"every depth above 0.001 m, but points \[1, 2, 3\] are not"
    ) as caught:
        project(RIG, p)
    assert caught.value.indices.tolist() == [1, 2, 3]


@pytest.mark.parametrize("uR", [300.0, 301.0, np.nan])
def test_features_without_disparity_do_not_triangulate(uR):
    pixels = np.array([[310.0, 9, 300, 9], [300.0, 9, uR, 9]])
    for function in (triangulate, d_triangulate_d_reading):
        with pytest.raises(BehindCamera, match=r"points \[1\] are not"):
            function(RIG, pixels)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fx_px": 0.0}, "Expected `fx_px` to be positive and finite, got 0.0"),
        ({"fy_px": -1.0}, "Expected `fy_px` to be positive"),
        ({"fy_px": np.inf}, "Expected `fy_px` to be positive and finite, got inf"),
        ({"baseline_m": np.nan}, "Expected `baseline_m` to be positive and finite, got nan"),
        ({"baseline_m": 0.0}, "Expected `baseline_m` to be positive"),
        ({"min_disparity_px": 0.0}, "Expected `min_disparity_px` to be positive"),
        ({"cx_px": np.nan}, r"Expected a finite centre, got \(nan, 0.0\)"),
        ({"cy_px": np.inf}, r"Expected a finite centre, got \(0.0, inf\)"),
    ],
)
def test_what_is_no_rig_is_refused(changes, message):
    usable = {"fx_px": 500.0, "fy_px": 500.0, "cx_px": 0.0, "cy_px": 0.0, "baseline_m": 0.5}
    with pytest.raises(ValueError, match=message):
        StereoRig(**(usable | changes))


NAN, INF = np.nan, np.inf
FEATURES = [
    ("an ordinary one", [300, 200, 290, 200], Validity.VALID),
    ("disparity at the minimum", [300, 200, 299, 200], Validity.VALID),
    ("corner of the image", [1241, 375, 0, 375], Validity.VALID),
    ("corner of the image", [1, 0, 0, 0], Validity.VALID),
    ("rows that disagree are the gate's affair", [300, 100, 290, 300], Validity.VALID),
    ("all missing", [-1, -1, -1, -1], Validity.UNSEEN),
    ("right image missing", [300, 200, -1, -1], Validity.PARTIAL),
    ("left image missing", [-1, -1, 300, 200], Validity.PARTIAL),
    ("one coordinate missing", [300, -1, 290, 200], Validity.PARTIAL),
    ("not a number", [300, 200, 290, NAN], Validity.PARTIAL),
    ("no numbers", [NAN, NAN, NAN, NAN], Validity.PARTIAL),
    ("infinite", [INF, 200, INF, 200], Validity.PARTIAL),
    ("infinite", [INF, 200, 290, 200], Validity.PARTIAL),
    ("missing and not a number", [-1, -1, -1, NAN], Validity.PARTIAL),
    ("missing before negative disparity", [300, -1, 310, 200], Validity.PARTIAL),
    ("missing before outside", [5000, 200, -1, 200], Validity.PARTIAL),
    ("no disparity", [300, 200, 300, 200], Validity.BEHIND),
    ("negative disparity", [300, 200, 310, 200], Validity.BEHIND),
    ("behind before outside", [300, 5000, 310, 5000], Validity.BEHIND),
    ("little disparity", [300, 200, 299.001, 200], Validity.FAR),
    ("far before outside", [300, 5000, 299.5, 5000], Validity.FAR),
    ("beyond the right border", [1241.01, 200, 1200, 200], Validity.OUTSIDE),
    ("beyond the left border", [5, 200, -0.01, 200], Validity.OUTSIDE),
    ("beyond the upper border", [300, -0.01, 290, 200], Validity.OUTSIDE),
    ("beyond the lower border", [300, 200, 290, 375.01], Validity.OUTSIDE),
    ("on the borders", [1241, 0, 0, 375], Validity.VALID),
    ("nearly -1", [300, 200, 290, np.nextafter(-1, 0)], Validity.OUTSIDE),
]


@pytest.mark.parametrize(("about", "pixels", "expected"), FEATURES)
def test_validity_finds_the_first_fault_that_applies(about, pixels, expected):
    assert Validity(validity(RIG, np.array(pixels))) is expected, about


def test_validity_takes_whole_frames():
    pixels = np.array([pixels for _, pixels, _ in FEATURES])
    expected = [validity for _, _, validity in FEATURES]
    assert validity(RIG, pixels).tolist() == expected
    assert validity(RIG, np.stack([pixels, pixels[::-1]])).tolist() == [expected, expected[::-1]]


def test_without_an_image_size_nothing_is_outside():
    endless = StereoRig(fx_px=500.0, fy_px=500.0, cx_px=0.0, cy_px=0.0, baseline_m=0.5)
    for _, pixels, expected in FEATURES:
        valid = Validity.VALID if expected is Validity.OUTSIDE else expected
        assert validity(endless, np.array(pixels)) == valid


odd = st.sampled_from([-1.0, 0.0, 300.0, 299.0, 299.0000001, 1241.0, 5000.0, -1e300, NAN, INF])


@given(
    pixels=arrays(float, (6, 4), elements=odd | st.floats(-10, 1300)),
    image_px=st.sampled_from([RIG.image_px, None]),
)
def test_valid_is_what_validity_finds_valid(pixels, image_px):
    rig = replace(RIG, image_px=image_px)
    assert_array_equal(is_valid(rig, pixels), validity(rig, pixels) == Validity.VALID)


@pytest.mark.parametrize(("about", "pixels", "found"), FEATURES)
def test_a_feature_is_valid_where_validity_says_so(about, pixels, found):
    assert is_valid(RIG, np.array(pixels)) == (found is Validity.VALID), about


def test_what_is_not_before_the_camera_has_pixels_of_nan():
    p = np.array([[[1, 2, 5.0], [0, 0, -1]], [[0, 0, 1e-3], [NAN, 0, 4]]])
    seen = project_or_nan(RIG, p)
    assert_array_equal(seen[0, 0], project(RIG, p[0, :1])[0])
    assert np.isnan(seen[0, 1]).all()
    assert np.isnan(seen[1, 0]).all()
    assert np.isnan(seen[1, 1, 0])


def test_minimum_disparity_is_the_rig_s():
    rig = StereoRig(
        fx_px=500.0, fy_px=500.0, cx_px=0.0, cy_px=0.0, baseline_m=0.5, min_disparity_px=3.0
    )
    pixels = np.array([[13, 5, 10, 5], [12.9, 5, 10, 5]])
    assert validity(rig, pixels).tolist() == [Validity.VALID, Validity.FAR]
