"""The judge is judged: by definitions, by filterpy and by the statistics it claims."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm
from scipy.stats import chi2

from tests.oracles import dense_ekf
from tests.oracles.dense_ekf import DenseEkf
from vislam.camera import StereoRig
from vislam.types import Belief, Calibration, Noise

FX, FY, CX, CY, BASELINE = 550.0, 530.0, 330.0, 230.0, 0.6
T_IMU_CAM = np.array([[0, 0, 1, 1.1], [-1, 0, 0, -0.3], [0, -1, 0, 0.7], [0, 0, 0, 1]]) @ expm(
    dense_ekf.hat4(np.array([0, 0, 0, 0.03, -0.05, 0.02]))
)
CALIBRATION = Calibration(
    rig=StereoRig(fx_px=FX, fy_px=FY, cx_px=CX, cy_px=CY, baseline_m=BASELINE, image_px=(640, 480)),
    T_imu_cam=T_IMU_CAM,
)
SIGMA_PX = np.array([0.7, 0.4, 1.1, 0.9])
T_START = expm(
    np.array([[0, -1.9, 0.4, 30.0], [1.9, 0, -0.2, -50.0], [-0.4, 0.2, 0, 4.0], [0, 0, 0, 0]])
)


def spread(rng, n, scale):
    """An anisotropic covariance."""
    A = rng.standard_normal((n, n))
    return scale**2 * (A @ A.T / n + np.diag(rng.uniform(0.3, 1.5, n)))


def pixels_of(T_world_imu, points):
    """Two 3x4 camera matrices, one row of pixels a point."""
    K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
    T_cam_world = np.linalg.inv(T_world_imu @ T_IMU_CAM)
    right = T_cam_world - np.outer([1, 0, 0, 0], [0, 0, 0, BASELINE])
    rows = []
    for camera in (K @ T_cam_world[:3], K @ right[:3]):
        uvw = np.column_stack([points, np.ones(len(points))]) @ camera.T
        rows.append(uvw[:, :2] / uvw[:, 2:])
    return np.hstack(rows)


def points_before(T_world_imu, rng, n):
    """Points in the view of both cameras."""
    depth = rng.uniform(3, 10, n)
    q = np.stack(
        [depth * rng.uniform(-0.3, 0.4, n), depth * rng.uniform(-0.3, 0.3, n), depth, np.ones(n)]
    )
    return (T_world_imu @ T_IMU_CAM @ q)[:3].T


def noise(model="twist", scale=1.0, sigma_px=SIGMA_PX):
    rng = np.random.default_rng(4)
    return Noise(process_model=model, process=spread(rng, 6, 0.03 * scale), sigma_px=sigma_px)


def mapped(rng, n=3, gate=None):
    """A filter with n landmarks, strange to nothing: full covariance with all cross terms."""
    points = points_before(T_START, rng, n)
    prior = Belief(
        T_world_imu=T_START,
        pose_covariance=np.eye(6),
        ids=np.arange(n) * 10,
        landmarks=points,
        joint_covariance=spread(rng, 6 + 3 * n, 0.02),
    )
    return DenseEkf(CALIBRATION, noise(), prior, gate), points


def first_order_log(T):
    """(rho, phi) of a motion near the identity, right up to even terms of second order."""
    return np.concatenate(
        [
            T[..., :3, 3],
            np.stack(
                [
                    T[..., 2, 1] - T[..., 1, 2],
                    T[..., 0, 2] - T[..., 2, 0],
                    T[..., 1, 0] - T[..., 0, 1],
                ],
                axis=-1,
            )
            / 2,
        ],
        axis=-1,
    )


@pytest.mark.parametrize("seed", range(5))
def test_jacobian_of_an_observation_is_its_derivative(seed):
    rng = np.random.default_rng(seed)
    ekf, points = mapped(rng)
    T, h = ekf.T, 1e-5
    for j, m in enumerate(points):
        H = np.zeros((4, 15))
        for i, step in enumerate(np.eye(9) * h):
            forward = pixels_of(T @ expm(dense_ekf.hat4(step[:6])), [m + step[6:]])
            back = pixels_of(T @ expm(-dense_ekf.hat4(step[:6])), [m - step[6:]])
            H[:, i if i < 6 else 3 * j + i] = (forward - back)[0] / (2 * h)
        assert_allclose(ekf.jacobian(10 * j), H, rtol=1e-7, atol=1e-7 * abs(H).max())
        assert_allclose(ekf.predicted_pixels(10 * j), pixels_of(T, [m])[0], rtol=1e-12)


def test_jacobians_of_a_birth_are_the_paper_s_closed_forms():
    rng = np.random.default_rng(0)
    ekf, _ = mapped(rng, n=0)
    m = points_before(T_START, rng, 1)[0]
    z = pixels_of(T_START, [m])[0] + [0, 2, 0, -2]  # the mean of vL and vR still points to m
    Sigma = ekf.Sigma.copy()
    ekf.update(np.array([7]), z[None])
    assert_allclose(ekf.landmarks[7], m, rtol=1e-12)
    s = np.linalg.inv(T_START)[:3] @ np.append(m, 1)
    G = T_START[:3, :3] @ np.hstack([np.eye(3), -dense_ekf.hat3(s)])
    assert_allclose(ekf.Sigma[6:, :6], G @ Sigma, rtol=0, atol=1e-15)
    h = 1e-5
    J_z = np.stack(
        [
            ekf.inverse_observation(z + h * e, np.zeros(6))
            - ekf.inverse_observation(z - h * e, np.zeros(6))
            for e in np.eye(4)
        ],
        axis=-1,
    ) / (2 * h)
    R = np.diag(SIGMA_PX**2)
    assert_allclose(ekf.Sigma[6:, 6:], J_z @ R @ J_z.T + G @ Sigma @ G.T, rtol=1e-7)


def test_right_jacobian_is_the_integral_of_its_definition():
    x = np.array([3.0, -2.0, 10.0, 0.9, -1.1, 0.4])
    nodes, weights = np.polynomial.legendre.leggauss(20)
    integral = sum(
        w / 2 * expm(-(s + 1) / 2 * dense_ekf.check(x)) for s, w in zip(nodes, weights, strict=True)
    )
    assert_allclose(dense_ekf.right_jacobian(x), integral, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_linear_algebra_of_an_update_is_filterpy_s(seed):
    rng = np.random.default_rng(seed)
    ekf, points = mapped(rng)
    T, Sigma = ekf.T, ekf.Sigma
    z = pixels_of(T, points) + SIGMA_PX * rng.standard_normal((3, 4))
    update = ekf.update(np.array([0, 10, 20]), z)

    witness = KalmanFilter(dim_x=15, dim_z=12)
    witness.x, witness.P = np.zeros(15), Sigma
    witness.update(update.residuals.ravel(), R=np.diag(np.tile(SIGMA_PX**2, 3)), H=update.H)
    delta = witness.x
    assert_allclose(ekf.T, T @ expm(dense_ekf.hat4(delta[:6])), rtol=1e-12)
    moved = np.array(list(ekf.landmarks.values())) - points
    assert_allclose(moved.ravel(), delta[6:], rtol=0, atol=1e-13)
    assert_allclose(ekf.Sigma, witness.P, rtol=0, atol=1e-14)
    assert_array_equal(ekf.Sigma, ekf.Sigma.T)
    assert_allclose(update.S, witness.S, rtol=1e-12)
    assert_allclose(update.nis, witness.mahalanobis**2, rtol=1e-10)


@pytest.mark.parametrize("model", ["additive", "twist", "twist-density"])
def test_predicted_covariance_is_that_of_a_sample(model):
    """4,000 draws; two-sided at 1e-3 for each of three statistics, so 1 % over all models."""
    n, dt, told = 4000, 0.4, noise(model, scale=0.01)
    rng = np.random.default_rng(20)
    u = np.array([4.0, -1.0, 0.5, 0.7, -1.2, 2.0])
    P0 = spread(rng, 6, 1e-3)
    ekf = DenseEkf(CALIBRATION, told, Belief(T_world_imu=T_START, pose_covariance=P0))
    ekf.predict(u, dt)

    def draws(covariance):
        return rng.multivariate_normal(np.zeros(6), covariance, n, method="cholesky")

    def exp(xi):
        generators = np.stack([dense_ekf.hat4(e) for e in np.eye(6)])
        return expm(np.tensordot(xi, generators, 1))

    truth = T_START @ exp(draws(P0))
    if model == "additive":
        truth = truth @ exp(dt * u) @ exp(draws(told.process))
    else:
        scale = 1 / dt if model == "twist-density" else 1
        truth = truth @ exp(dt * (u - draws(told.process * scale)))
    e = first_order_log(np.linalg.inv(ekf.T) @ truth)

    whitened = np.linalg.solve(np.linalg.cholesky(ekf.Sigma), e.T)
    total = np.sum(whitened**2)
    mean = n * np.sum(whitened.mean(axis=1) ** 2)
    deviation = whitened @ whitened.T / n - np.eye(6)
    shape = n * np.sum(np.triu(deviation, 1) ** 2 + np.diag(np.diag(deviation)) ** 2 / 2)
    for statistic, dof in ((total, 6 * n), (mean, 6), (shape, 21)):
        assert 5e-4 < chi2.cdf(statistic, dof) < 1 - 5e-4


class Run:
    """A short run whose every chance is an argument: births late and early, jitter, lever arm."""

    dts = (0.4, 0.15, 0.7)
    twists = np.array(
        [[1.0, 0.2, -0.1, 0.1, -0.2, 0.3], [0.5, -0.4, 0.3, -0.2, 0.1, -0.5], [1, 0, 0, 0.1, 0, 0]]
    )
    seen = ((0, 1), (0, 1, 2), (1, 2), (0, 1, 2))  # by frame

    def __init__(self):
        rng = np.random.default_rng(8)
        self.P0 = spread(rng, 6, 0.03)
        self.noise = noise("twist-density")
        self.Ts = [T_START]
        for u, dt in zip(self.twists, self.dts, strict=True):
            self.Ts.append(self.Ts[-1] @ expm(dt * dense_ekf.hat4(u)))
        self.points = points_before(self.Ts[1], rng, 3)
        self.size = 6 + 6 * len(self.dts) + 4 * sum(map(len, self.seen))

    def __call__(self, w):
        """Errors and covariances after every call, the noise being w standard deviations."""
        w = np.split(w, np.cumsum([6, *[6] * len(self.dts), *(4 * len(s) for s in self.seen)]))
        start = self.Ts[0] @ expm(-dense_ekf.hat4(np.linalg.cholesky(self.P0) @ w[0]))
        ekf = DenseEkf(
            CALIBRATION, self.noise, Belief(T_world_imu=start, pose_covariance=self.P0), 0.999
        )
        out = []
        for i, (T, ids) in enumerate(zip(self.Ts, map(np.array, self.seen), strict=True)):
            if i:
                dt = self.dts[i - 1]
                n = np.linalg.cholesky(self.noise.process / dt) @ w[i]
                ekf.predict(self.twists[i - 1] + n, dt)
                out.append(self.errors(ekf, i))
            z = pixels_of(T, self.points[ids]) + SIGMA_PX * w[1 + len(self.dts) + i].reshape(-1, 4)
            ekf.update(ids, z)
            ekf.clone()
            out.append(self.errors(ekf, i))
        return out

    def errors(self, ekf, i):
        e = np.zeros(len(ekf.Sigma))
        e[:6] = first_order_log(np.linalg.inv(ekf.T) @ self.Ts[i])
        for j, rows in ekf.rows.items():
            e[rows] = self.points[j] - ekf.landmarks[j]
        for T, (T_cloned, delta, rows) in zip(self.Ts, ekf._clones, strict=False):
            e[rows] = first_order_log(np.linalg.inv(T_cloned) @ T) - delta
        return e, ekf.Sigma


def test_every_covariance_is_exactly_that_of_the_errors_to_first_order():
    """The exact audit: with J the derivative of the error by all noise, Sigma is J J^T."""
    run, eps = Run(), 1e-4
    claimed = run(np.zeros(run.size))
    for e, _ in claimed:
        assert_allclose(e, 0, atol=1e-11)
    columns = [(run(eps * w), run(-eps * w)) for w in np.eye(run.size)]
    for call, (_, Sigma) in enumerate(claimed):
        J = np.column_stack([(a[call][0] - b[call][0]) / (2 * eps) for a, b in columns])
        sigma = np.sqrt(np.diag(Sigma))
        assert_allclose(J @ J.T / np.outer(sigma, sigma), Sigma / np.outer(sigma, sigma), atol=1e-7)


def test_prediction_carries_the_landmarks_cross_covariance():
    ekf, _ = mapped(np.random.default_rng(1))
    Sigma, u, dt = ekf.Sigma, np.array([2.0, 0, 1, 0.3, -0.5, 1]), 0.3
    ekf.predict(u, dt)
    F = expm(-dt * dense_ekf.check(u))
    assert_allclose(ekf.Sigma[:6, 6:], F @ Sigma[:6, 6:], rtol=1e-12)
    assert_array_equal(ekf.Sigma[6:, 6:], Sigma[6:, 6:])


def test_outlier_is_as_if_never_seen():
    (ekf, points), (spared, _) = (mapped(np.random.default_rng(2), gate=0.999) for _ in range(2))
    z = pixels_of(ekf.T, points)
    z[1] += [0, 8, 0, -8]
    update = ekf.update(np.array([0, 10, 20]), z)
    spared.update(np.array([0, 20]), z[[0, 2]])
    assert update.accepted.tolist() == [0, 20]
    assert update.distances[1] > chi2.ppf(0.999, 4) > update.distances[0]
    assert update.S.shape == (8, 8)
    assert_array_equal(ekf.T, spared.T)
    assert_array_equal(ekf.Sigma, spared.Sigma)


@pytest.mark.parametrize("offset", [-1e-6, 1e-6])
def test_gate_stands_at_the_quantile_of_four_degrees(offset):
    ekf, points = mapped(np.random.default_rng(3), n=1, gate=0.95)
    H = ekf.jacobian(0)
    S = H @ ekf.Sigma @ H.T + np.diag(SIGMA_PX**2)
    direction = np.linalg.cholesky(S) @ np.array([0.5, 0.5, -0.5, 0.5])
    z = pixels_of(ekf.T, points) + (np.sqrt(9.487729) + offset) * direction
    update = ekf.update(np.array([0]), z)
    assert_allclose(update.distances, 9.487729, rtol=1e-5)
    assert update.accepted.tolist() == ([0] if offset < 0 else [])


UNUSABLE = [
    [-1, -1, -1, -1],
    [300, 200, -1, 200],
    [300, np.nan, 290, 200],
    [300, 200, 300, 200],
    [300, 200, 299.5, 200],
    [300, 200, 320, 200],
]
OUTSIDE = [[639.5, 200, 600, 200], [300, 479.5, 290, 479.5], [3, 200, -2, 200]]


@pytest.mark.parametrize(
    ("z", "image_px"),
    [(z, None) for z in UNUSABLE] + [(z, (640, 480)) for z in UNUSABLE + OUTSIDE],
)
@pytest.mark.parametrize("track", [0, 99])
def test_invalid_feature_changes_nothing(z, image_px, track):
    ekf, _ = mapped(np.random.default_rng(5))
    ekf.rig = replace(ekf.rig, image_px=image_px)
    before = ekf.T, ekf.Sigma, dict(ekf.landmarks)
    update = ekf.update(np.array([track]), np.array([z], float))
    assert len(update.ids) == len(update.born) == update.nis == 0
    assert_array_equal(ekf.T, before[0])
    assert_allclose(ekf.Sigma, before[1], rtol=1e-15)
    assert ekf.landmarks.keys() == before[2].keys()


def test_known_map_without_joint_covariance_starts_uncorrelated():
    covariances = np.stack([np.eye(3), 2 * np.eye(3)])
    prior = Belief(
        T_world_imu=np.eye(4),
        pose_covariance=3 * np.eye(6),
        ids=np.array([4, 9]),
        landmarks=np.ones((2, 3)),
        landmark_covariances=covariances,
    )
    ekf = DenseEkf(CALIBRATION, noise(), prior)
    assert_array_equal(np.diag(ekf.Sigma), [3] * 6 + [1] * 3 + [2] * 3)
    assert_array_equal(np.diag(ekf.covariance([9, 4])), [3] * 6 + [2] * 3 + [1] * 3)


def test_landmark_behind_the_camera_is_no_prediction():
    ekf, points = mapped(np.random.default_rng(6))
    z = pixels_of(ekf.T, points)
    ekf.landmarks[10] = (ekf.T @ T_IMU_CAM @ [0, 0, -5, 1])[:3]
    with pytest.raises(ArithmeticError, match="Landmark 10 is predicted behind the camera"):
        ekf.update(np.array([0, 10, 20]), z)
