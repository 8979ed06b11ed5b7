"""The noise of a drive, estimated from its own readings, for files that say nothing of it.

* Velocities: a vehicle moves smoothly from sample to sample, so what high differences leave is
  noise: an upper bound, and close where frames are many a second.
* Angular rates start from that bound. Far features show rotation well, so the cameras then say how
  far the rates are off over a few frames together, a slow bias included.
* Pixels: vL - vR shows the noise of one stereo pair, but not how a track slides along. So features
  are also predicted over a few frames, the motion freed of its own error. What they are off by more
  than a stereo pair lasts for a track, whose sightings err alike and so count as one.
"""

from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.special import chdtr, chdtri

from simbench.dataset import Dataset, Sightings
from simbench.repeats import without_repeats
from vislam.arrays import Array, IntArray
from vislam.camera import (
    d_project_d_point,
    d_triangulate_d_reading,
    in_front,
    is_valid,
    project,
    triangulate,
)
from vislam.lie import se3

#: What is told where the data hold too little to estimate anything.
SIGMA_PX, SIGMA_VELOCITY, SIGMA_ANGULAR = 2.0, 0.5, 0.05
#: Bounds on what is told: less than any calibration is good for, and more than is odometry.
PIXEL_BOUNDS, VELOCITY_BOUNDS, ANGULAR_BOUNDS = (0.05, 10.0), (0.02, 5.0), (5e-4, 0.5)
#: Extrinsics a quarter of a degree off turn this share of the speed across. A filter that is told
#: less makes a turn of it: a real drive climbed by 200 m at 0.2 %.
SHARE_OF_SPEED = 0.005

DIFFERENCES = 3  # of second order still hold the acceleration of a car that brakes
LAG = 3  # frames of a prediction: few tracks live long, and slow errors need time to show
MIN_PAIRS = 100
LEAST_FREE = 0.7  # the share of residuals that motion leaves over: about seven features a frame
ROUNDS = 10
ROWS = 3  # uL, (vL + vR) / sqrt 2, uR: what a motion explains of a sighting
GATE, MEDIAN = float(chdtri(ROWS, 1e-3)), float(chdtri(ROWS, 0.5))
#: Mean of a chi-square variable of `ROWS` degrees that the gate has let pass.
GATED_MEAN = float(ROWS * chdtr(ROWS + 2, GATE) / chdtr(ROWS, GATE))
#: Predictions may be off by this times a stereo pair before that says something of tracks.
TOLERANCE = 1.1
#: A track that slides at random is at another place after this many sightings.
MOST_ALIKE = 10.0
GATHERED = np.array([[1, 0, 0, 0], [0, 0.5**0.5, 0, 0.5**0.5], [0, 0, 1, 0]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Standard deviations that the data show.

    Attributes:
        epipolar_px: of one coordinate by vL - vR; None without features.
        sigma_px: of one coordinate, to be told, never below `epipolar_px`.
        velocity: of a sample of linear velocity, m/s, shape (3,).
        angular: of a sample of angular velocity, rad/s, shape (3,).
    """

    epipolar_px: float | None
    sigma_px: float
    velocity: Array
    angular: Array


def estimate(dataset: Dataset) -> Estimate:
    """Estimate the noise of a drive whose convention is resolved; what it is told is not looked at.

    Repeated sightings (`simbench.repeats`) are left out.
    """
    dataset = without_repeats(dataset)
    sigma_u = white_noise(dataset.twists)
    epipolar_px, sigma_px = None, SIGMA_PX
    z = _valid(dataset)
    if len(z):
        epipolar_px = sigma_px = float(_spread(z[:, 1] - z[:, 3]) / np.sqrt(2))
        pairs = Pairs.of(dataset)
        predicted_px, sigma_u[3:] = _by_prediction(pairs, sigma_u)
        sigma_px = (
            max(epipolar_px, SIGMA_PX)
            if predicted_px is None
            else _lasting(epipolar_px, predicted_px, len(z) / dataset.landmark_count)
        )
    speed = float(np.median(np.linalg.norm(dataset.linear_velocity, axis=1)))
    return Estimate(
        epipolar_px=epipolar_px,
        sigma_px=float(np.clip(sigma_px, *PIXEL_BOUNDS)),
        velocity=np.clip(np.maximum(sigma_u[:3], SHARE_OF_SPEED * speed), *VELOCITY_BOUNDS),
        angular=np.clip(sigma_u[3:], *ANGULAR_BOUNDS),
    )


def by_this_and_next_sample(dataset: Dataset) -> tuple[float, float] | None:
    """How far features are seen from where velocity samples predict them one frame ahead.

    Returns:
        The median in pixels of the left image with the sample at the frame, as the format means it,
        and with the next one; None without pairs to judge by.
    """
    dataset = without_repeats(dataset)
    if not len(_valid(dataset)):
        return None
    first, second, frame = _seen_again(dataset, lag=1)
    if not len(frame):
        return None
    rig, T_imu_cam = dataset.calibration.stereo, dataset.calibration.T_imu_cam
    z, z_next = _pixels(dataset, first, second)
    twists = dataset.twists
    medians = []
    for samples in (twists, np.concatenate([twists[1:], twists[-1:]])):
        steps = _motions(dataset.times_s, samples, lag=1)
        steps = (se3.inverse(T_imu_cam) @ steps @ T_imu_cam)[frame]
        q = se3.apply(steps, triangulate(rig, z)[:, None])[:, 0]
        front = in_front(q)
        if not front.any():
            return None
        off = (project(rig, q[front]) - z_next[front])[:, :2]
        medians.append(float(np.median(np.linalg.norm(off, axis=1))))
    return medians[0], medians[1]


def _lasting(epipolar_px: float, predicted_px: float, track: float) -> float:
    """The noise to tell where tracks of a mean number of sightings slide.

    Errors that `track` sightings have in common say no more than one: `track` times the variance.
    """
    lasting = max(predicted_px**2 - (TOLERANCE * epipolar_px) ** 2, 0.0)
    return float(np.sqrt(epipolar_px**2 + min(track, MOST_ALIKE) * lasting))


def white_noise(twists: Array) -> Array:
    """Standard deviation of white noise on smooth motion, by differences; (T, 6) to (6,)."""
    if len(twists) < 4 * DIFFERENCES:
        return np.repeat([SIGMA_VELOCITY, SIGMA_ANGULAR], 3)
    left = np.diff(twists, n=DIFFERENCES, axis=0)
    return np.asarray(_spread(left) / np.sqrt(comb(2 * DIFFERENCES, DIFFERENCES)))


def _spread(values: Array) -> Array:
    """Standard deviation by the median absolute deviation, along the first axis."""
    return np.asarray(1.4826 * np.median(np.abs(values - np.median(values, axis=0)), axis=0))


def _valid(dataset: Dataset) -> Array:
    """The pixels of all valid sightings, shape (n, 4)."""
    if not isinstance(dataset.sightings, Sightings):
        return np.empty((0, 4))
    pixels = dataset.sightings.pixels
    usable: Array = pixels[is_valid(dataset.calibration.stereo, pixels)]
    return usable


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairs:
    """Features seen in two frames, the later sighting predicted from the earlier.

    Whitened for a pixel noise of one, and linear in what the motion between is off by.

    Attributes:
        frame: the earlier one of each pair of frames, shape (F,).
        start: of each pair of frames among the features, shape (F,).
        first, second: places of both sightings in the dataset's, shape (n,).
        residual: shape (n, 3).
        J: its derivative by the motion's error, in the IMU frame of the later, shape (n, 3, 6).
        interval_s: mean time between frames.
    """

    frame: IntArray
    start: IntArray
    first: IntArray
    second: IntArray
    residual: Array
    J: Array
    interval_s: float

    @property
    def of_feature(self) -> IntArray:
        """The pair of frames of each feature, shape (n,)."""
        return np.repeat(
            np.arange(len(self.start)), np.diff(np.append(self.start, len(self.residual)))
        )

    @classmethod
    def of(cls, dataset: Dataset, lag: int = LAG) -> "Pairs":
        """Those that lie `lag` frames apart, the motion between as measured."""
        rig, T_imu_cam = dataset.calibration.stereo, dataset.calibration.T_imu_cam
        first, second, frame = _seen_again(dataset, lag)
        z, z_next = _pixels(dataset, first, second)
        motion = _motions(dataset.times_s, dataset.twists, lag)[frame]
        s = se3.apply(motion, se3.apply(T_imu_cam, triangulate(rig, z))[:, None])[:, 0]
        q = se3.apply(se3.inverse(T_imu_cam), s)
        front = in_front(q)
        frame, first, second = frame[front], first[front], second[front]
        motion, z, z_next, s, q = motion[front], z[front], z_next[front], s[front], q[front]
        R_cam_imu = T_imu_cam[:3, :3].T
        d_pixels_d_s = d_project_d_point(rig, q) @ R_cam_imu
        through = d_pixels_d_s @ motion[:, :3, :3] @ T_imu_cam[:3, :3]
        A = GATHERED @ through @ d_triangulate_d_reading(rig, z)
        W = np.linalg.inv(np.linalg.cholesky(np.eye(ROWS) + A @ A.swapaxes(1, 2)))
        frames, start = np.unique(frame, return_index=True)
        return cls(
            frame=frames,
            start=start,
            first=first,
            second=second,
            residual=(W @ GATHERED @ (z_next - project(rig, q))[..., None])[..., 0],
            J=W @ GATHERED @ d_pixels_d_s @ se3.odot(s),
            interval_s=float(np.ptp(dataset.times_s)) / max(len(dataset) - 1, 1),
        )

    def left_by(self, x: Array) -> Array:
        """The square of what is left where the motions are off by x, shape (F, 6) to (n,)."""
        explained = np.einsum("nij,nj->ni", self.J, x[self.of_feature])
        left: Array = np.square(self.residual - explained).sum(axis=1)
        return left

    def motion_errors(self, weight: Array, information: Array) -> tuple[Array, Array]:
        """What the motions are off by, (F, 6), and its covariance, (F, 6, 6).

        Args:
            weight: of each feature, its inverse pixel variance or 0, shape (n,).
            information: inverse covariance of the motions' errors, shape (6, 6) or (F, 6, 6).
        """
        weighted = self.J.swapaxes(1, 2) * weight[:, None, None]
        H = np.add.reduceat(weighted @ self.J, self.start)
        g = np.add.reduceat((weighted @ self.residual[..., None])[..., 0], self.start)
        P = np.asarray(np.linalg.inv(H + information))
        return (P @ g[..., None])[..., 0], P


def _seen_again(dataset: Dataset, lag: int) -> tuple[IntArray, IntArray, IntArray]:
    """Valid sightings with another one `lag` frames later: places of both, and the first frame."""
    sightings = dataset.sightings
    if not isinstance(sightings, Sightings):
        raise TypeError("Expected the sightings of a stereo pair.")
    valid = is_valid(dataset.calibration.stereo, sightings.pixels)
    first, second = sightings.pairs(valid, lag)
    return first, second, sightings.frames[first]


def _pixels(dataset: Dataset, first: IntArray, second: IntArray) -> tuple[Array, Array]:
    """Those of both sightings of pairs, shapes (n, 4)."""
    assert isinstance(dataset.sightings, Sightings)
    return dataset.sightings.pixels[first], dataset.sightings.pixels[second]


def _motions(times_s: Array, twists: Array, lag: int) -> Array:
    """Points of the IMU frame at each frame in that `lag` frames later, shape (T - lag, 4, 4)."""
    steps = se3.exp(-np.diff(times_s)[:, None] * twists[:-1])
    motions = np.broadcast_to(np.eye(4), (max(len(steps) - lag + 1, 0), 4, 4))
    for k in range(lag):
        motions = steps[k : k + len(motions)] @ motions
    return motions


def _by_prediction(pairs: Pairs, sigma_u: Array) -> tuple[float | None, Array]:
    """Pixel sigma and those of the angular rates, (3,), that explain what predictions are off by.

    The former is None where the features are too few to say anything beside the motion.

    Each pair of frames has a motion error x ~ N(0, S), S diagonal. In turn x by the accepted
    features, the pixel noise by what x leaves, and S by x and its uncertainty
    (expectation-maximisation). Velocities have a part in x, but nothing is concluded of them: how
    fast it goes the cameras say by depth, which real stereo gets wrong by more than odometry does.
    """
    count = len(pairs.residual)
    if count < MIN_PAIRS:
        return None, sigma_u[3:]
    per_step = LAG * pairs.interval_s**2
    floor = np.repeat([VELOCITY_BOUNDS[0], ANGULAR_BOUNDS[0]], 3)
    variance = per_step * np.maximum(sigma_u, floor) ** 2
    x, explained = np.zeros((len(pairs.start), 6)), 0.0
    for _ in range(ROUNDS):
        left = pairs.left_by(x)
        # the share of a residual that x cannot take up
        free = max(1 - explained / pairs.residual.size, 0.1)
        accepted = left <= GATE / free * np.median(left) / MEDIAN
        px2 = max(left[accepted].mean() / (GATED_MEAN * free), PIXEL_BOUNDS[0] ** 2)
        x, P = pairs.motion_errors(accepted / px2, np.diag(1 / variance))
        own = np.einsum("nii->ni", P)
        explained = float(np.sum(1 - own / variance))
        variance = np.mean(np.minimum(x**2, 9 * variance) + own, axis=0)
    return (
        float(np.sqrt(px2)) if free > LEAST_FREE else None,
        np.sqrt(variance[3:] / per_step),
    )
