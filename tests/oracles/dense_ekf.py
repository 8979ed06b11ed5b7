"""EKF-SLAM straight from the paper (III.C), dense and slow: the judge of the real filter.

The whole state, one pose and every landmark ever born, in one covariance; 4x4 matrices; every
exponential by `scipy.linalg.expm`; every feature with its four pixel rows; births by numerically
differentiated inverse observation. Nothing is ever dropped. Of `vislam` it knows only the
containers in which calibration, noise and prior arrive.

The error is e = (xi, f_1, f_2, ...): T_true = T exp(xi^), m_true = m + f.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, expm
from scipy.stats import chi2

from vislam.types import Belief, Calibration, Noise

P = np.eye(3, 4)  #: The paper's P: (m, 1) = P^T m + e_4.


def hat3(a):
    """a^ b = a cross b."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def hat4(xi):
    """xi^ = [phi^, rho; 0, 0]."""
    return np.block([[hat3(xi[3:]), xi[:3, None]], [np.zeros((1, 4))]])


def check(xi):
    """The paper's u check, [phi^, rho^; 0, phi^]."""
    return np.block([[hat3(xi[3:]), hat3(xi[:3])], [np.zeros((3, 3)), hat3(xi[3:])]])


def odot(s):
    """s^odot = [I, -s^; 0, 0] of a homogeneous point: xi^ s = s^odot xi."""
    return np.block([[np.eye(3), -hat3(s[:3])], [np.zeros((1, 6))]])


def homogeneous(m):
    """(m, 1)."""
    return np.append(m, 1.0)


def right_jacobian(x):
    """J_r(x), the integral of exp(-s x check) over s from 0 to 1, as a block of an exponential."""
    A = -check(x)
    return expm(np.block([[A, np.eye(6)], [np.zeros((6, 12))]]))[:6, 6:]


def complex_step(function: Callable, size: int):
    """The Jacobian of a real-analytic function at zero, exact to rounding."""
    step = 1e-30
    return np.column_stack([function(1j * step * e).imag / step for e in np.eye(size)])


@dataclass(frozen=True, kw_only=True)
class Update:
    """What one frame did.

    Attributes:
        ids: known landmarks with a valid feature, in the order of the features, (k,).
        residuals: measured minus predicted pixels, (k, 4).
        distances: squared Mahalanobis distance of each, 4 degrees of freedom, (k,).
        accepted: the ids that passed the gate, (a,).
        H: stacked Jacobian of the accepted, (4a, n).
        S: their innovation covariance, (4a, 4a).
        nis: r^T S^-1 r over the accepted, 4a degrees of freedom.
        born: ids that entered the state, (b,).
    """

    ids: np.ndarray
    residuals: np.ndarray
    distances: np.ndarray
    accepted: np.ndarray
    H: np.ndarray
    S: np.ndarray
    nis: float
    born: np.ndarray


class DenseEkf:
    """The filter.

    Attributes:
        T: the estimated pose T_world_imu, (4, 4).
        landmarks: the estimated positions by id, in the order of birth.
        Sigma: the covariance of the pose, then of whatever joined, in the order of joining.
        rows: the rows of a landmark in Sigma, by id.
        updates: one record for each frame.
    """

    def __init__(
        self, calibration: Calibration, noise: Noise, prior: Belief, gate: float | None = None
    ):
        """Start from the prior; `gate` is the probability that a right feature passes."""
        rig = calibration.rig
        fu, fv, cu, cv = rig.fx_px, rig.fy_px, rig.cx_px, rig.cy_px
        self.rig = rig
        self.K_s = np.array(
            [[fu, 0, cu, 0], [0, fv, cv, 0], [fu, 0, cu, -fu * rig.baseline_m], [0, fv, cv, 0]]
        )
        self.T_imu_cam = np.array(calibration.T_imu_cam)
        self.T_cam_imu = np.linalg.inv(self.T_imu_cam)
        self.noise = noise
        self.R = np.diag(np.square(noise.sigma_px))
        self.limit = np.inf if gate is None else chi2.ppf(gate, 4)

        self.T = np.array(prior.T_world_imu)
        self.landmarks = dict(zip(prior.ids.tolist(), np.array(prior.landmarks), strict=True))
        self.rows = {j: slice(6 + 3 * i, 9 + 3 * i) for i, j in enumerate(self.landmarks)}
        if prior.joint_covariance is not None:
            self.Sigma = np.array(prior.joint_covariance)
        else:
            self.Sigma = block_diag(prior.pose_covariance, *prior.landmark_covariances)
        self.updates: list[Update] = []
        self._clones: list[tuple[np.ndarray, np.ndarray, slice]] = []

    def predict(self, u, dt):
        """T <- T exp(tau u^), Sigma <- F Sigma F^T + W on the pose, F Sigma_RL beside it."""
        F = np.eye(len(self.Sigma))
        F[:6, :6] = expm(-dt * check(u))
        W = np.zeros_like(self.Sigma)
        W[:6, :6] = self.process_noise(u, dt)
        self.T = self.T @ expm(dt * hat4(u))
        self.Sigma = F @ self.Sigma @ F.T + W

    def process_noise(self, u, dt):
        """W: constant, or the twist's noise carried into the pose, tau^2 J_r Sigma_u J_r^T."""
        if self.noise.process_model == "additive":
            return self.noise.process
        density = self.noise.process_model == "twist-density"
        Sigma_u = self.noise.process / dt if density else self.noise.process
        J_r = right_jacobian(dt * u)
        return dt**2 * J_r @ Sigma_u @ J_r.T

    def update(self, ids, pixels) -> Update:
        """Gate and fuse the valid features of known landmarks, then give birth to the others."""
        valid = [(j, z) for j, z in zip(ids.tolist(), pixels, strict=True) if self.is_valid(z)]
        known = [(j, z) for j, z in valid if j in self.landmarks]
        unknown = [(j, z) for j, z in valid if j not in self.landmarks]

        residuals, distances, accepted = [], [], []
        H, r = [np.zeros((0, len(self.Sigma)))], [np.zeros(0)]
        for j, z in known:
            H_j = self.jacobian(j)
            r_j = z - self.predicted_pixels(j)
            d_j = r_j @ np.linalg.solve(H_j @ self.Sigma @ H_j.T + self.R, r_j)
            residuals.append(r_j)
            distances.append(d_j)
            if d_j <= self.limit:
                accepted.append(j)
                H.append(H_j)
                r.append(r_j)
        H, r = np.vstack(H), np.concatenate(r)

        S = H @ self.Sigma @ H.T + np.kron(np.eye(len(accepted)), self.R)
        K = np.linalg.solve(S, H @ self.Sigma).T
        self._correct(K @ r)
        self.Sigma = (np.eye(len(self.Sigma)) - K @ H) @ self.Sigma
        self.Sigma = (self.Sigma + self.Sigma.T) / 2

        for j, z in unknown:
            self._give_birth(j, z)
        self.updates.append(
            Update(
                ids=np.array([j for j, _ in known], int),
                residuals=np.array(residuals).reshape(-1, 4),
                distances=np.array(distances),
                accepted=np.array(accepted, int),
                H=H,
                S=S,
                nis=float(r @ np.linalg.solve(S, r)),
                born=np.array([j for j, _ in unknown], int),
            )
        )
        return self.updates[-1]

    def is_valid(self, z):
        """All four coordinates there, inside the image, with enough disparity."""
        if not np.isfinite(z).all() or (z == -1).any() or z[0] - z[2] < self.rig.min_disparity_px:
            return False
        if self.rig.image_px is None:
            return True
        width, height = self.rig.image_px
        return (z >= 0).all() and (z <= [width - 1, height - 1, width - 1, height - 1]).all()

    def _in_camera(self, j):
        """q = cTi T^-1 m, homogeneous."""
        q = self.T_cam_imu @ np.linalg.inv(self.T) @ homogeneous(self.landmarks[j])
        if q[2] <= 0:
            raise ArithmeticError(f"Landmark {j} is predicted behind the camera; no formula holds.")
        return q

    def predicted_pixels(self, j):
        """z = K_s pi(q)."""
        q = self._in_camera(j)
        return self.K_s @ (q / q[2])

    def jacobian(self, j):
        """H of one landmark, (4, n): H_pose and H_map of the paper in their columns."""
        q = self._in_camera(j)
        d_pi = np.array(
            [
                [1, 0, -q[0] / q[2], 0],
                [0, 1, -q[1] / q[2], 0],
                [0, 0, 0, 0],
                [0, 0, -q[3] / q[2], 1],
            ]
        )
        K_dpi_cTi = self.K_s @ (d_pi / q[2]) @ self.T_cam_imu
        T_inverse = np.linalg.inv(self.T)
        H = np.zeros((4, len(self.Sigma)))
        H[:, :6] = -K_dpi_cTi @ odot(T_inverse @ homogeneous(self.landmarks[j]))
        H[:, self.rows[j]] = K_dpi_cTi @ T_inverse @ P.T
        return H

    def _correct(self, delta):
        """T <- T exp(delta^) and m <- m + delta; a clone's chart stays where it was cloned."""
        self.T = self.T @ expm(hat4(delta[:6]))
        for j, rows in self.rows.items():
            self.landmarks[j] = self.landmarks[j] + delta[rows]
        self._clones = [(T, d + delta[rows], rows) for T, d, rows in self._clones]

    def inverse_observation(self, z, xi):
        """The landmark that the pose T exp(xi^) sees at pixels z: depth = fu b / (uL - uR)."""
        rig = self.rig
        depth = rig.fx_px * rig.baseline_m / (z[0] - z[2])
        x = depth * (z[0] - rig.cx_px) / rig.fx_px
        y = depth * ((z[1] + z[3]) / 2 - rig.cy_px) / rig.fy_px
        return (self.T @ expm(hat4(xi)) @ self.T_imu_cam @ np.array([x, y, depth, 1]))[:3]

    def _give_birth(self, j, z):
        """Sigma gains G Sigma_R. and, in its corner, G Sigma_RR G^T + J_z R J_z^T."""
        G = complex_step(lambda xi: self.inverse_observation(z, xi), 6)
        J_z = complex_step(lambda n: self.inverse_observation(z + n, np.zeros(6)), 4)
        self.landmarks[j] = self.inverse_observation(z, np.zeros(6))
        self.rows[j] = self._augment(G, J_z @ self.R @ J_z.T)

    def _augment(self, G, covariance):
        """Append to the state what hangs on the pose's error by G, with noise of its own."""
        n, k = len(self.Sigma), len(G)
        B = np.vstack([np.eye(n), np.hstack([G, np.zeros((k, n - 6))])])
        self.Sigma = B @ self.Sigma @ B.T
        self.Sigma[n:, n:] += covariance
        return slice(n, n + k)

    def clone(self):
        """Keep the present pose in the state, to be smoothed by what comes."""
        self._clones.append((self.T, np.zeros(6), self._augment(np.eye(6), np.zeros((6, 6)))))

    @property
    def smoothed(self):
        """Estimate and covariance of every cloned pose."""
        return [(T @ expm(hat4(d)), self.Sigma[rows, rows]) for T, d, rows in self._clones]

    def covariance(self, ids):
        """The joint covariance of the pose and the named landmarks, in the order of `ids`."""
        rows = np.r_[0:6, *(np.r_[self.rows[j]] for j in ids)].astype(int)
        return self.Sigma[np.ix_(rows, rows)]
