"""The same drive in GTSAM: its incremental smoother, and the batch optimum, told the same noise.

Factors: the prior's pose, the twist's motion between frames with the process noise of the filters,
and a stereo reading of each valid sighting. GTSAM's tangent order is rotation first, and its
stereo reading has one v, for which the mean of vL and vR stands.
"""

import time
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from simbench.dataset import Dataset
from vislam.arrays import Array
from vislam.camera import Validity, triangulate, validity
from vislam.filters import model
from vislam.lie import se3

ROTATION_FIRST = [3, 4, 5, 0, 1, 2]


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimated:
    """What GTSAM made of a drive.

    Attributes:
        online: the pose at each frame when it was the last one, shape (T, 4, 4).
        smoothed: given all data, shape (T, 4, 4).
        batch: the poses of the batch optimum, shape (T, 4, 4).
        pose_covariance: of the last pose by iSAM2, in (rho, phi) order, shape (6, 6).
        seconds: of the processor, that each frame's update and estimate took, shape (T,).
        covariance_s: idem, of the pose's covariance besides, which each frame of a filter has.
        batch_s: idem, of the optimum.
    """

    online: Array
    smoothed: Array
    batch: Array
    pose_covariance: Array
    seconds: Array
    covariance_s: Array
    batch_s: float


class Factors:
    """A drive as factors and initial values, frame by frame."""

    def __init__(self, dataset: Dataset) -> None:
        """Take what a filter is told."""
        rig, sigma = dataset.calibration.stereo, dataset.noise.sigma_px
        self._dataset = dataset
        self._K = gtsam.Cal3_S2Stereo(
            rig.fx_px, rig.fy_px, 0.0, rig.cx_px, rig.cy_px, rig.baseline_m
        )
        self._camera = gtsam.Pose3(dataset.calibration.T_imu_cam)
        self._stereo = gtsam.noiseModel.Diagonal.Sigmas(
            np.array([sigma[0], sigma[2], sigma[1] / np.sqrt(2)])
        )
        self._met: set[int] = set()

    def start(self) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """The prior pose."""
        prior = self._dataset.prior
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        T = gtsam.Pose3(prior.T_world_imu)
        graph.addPriorPose3(X(0), T, _gaussian(prior.pose_covariance))
        values.insert(X(0), T)
        return graph, values

    def move(self, i: int, graph: gtsam.NonlinearFactorGraph, T_last: Array) -> Array:
        """The motion to frame i, and the pose that it leads to."""
        times_s, twist = self._dataset.times_s, self._dataset.twist(i - 1)
        dt = float(times_s[i] - times_s[i - 1])
        step = se3.exp(dt * twist.vector)
        Q = model.process_noise(self._dataset.noise, twist, dt)
        graph.add(gtsam.BetweenFactorPose3(X(i - 1), X(i), gtsam.Pose3(step), _gaussian(Q)))
        return T_last @ step

    def see(
        self, i: int, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, T: Array
    ) -> None:
        """The valid sightings of frame i, and where new landmarks stand, seen from T."""
        frame, calibration = self._dataset.frame(i), self._dataset.calibration
        valid = validity(calibration.stereo, frame.readings) == Validity.VALID
        pixels = frame.readings[valid]
        points = se3.apply(T @ calibration.T_imu_cam, triangulate(calibration.stereo, pixels))
        rows = zip(frame.ids[valid].tolist(), pixels.tolist(), points, strict=True)
        for landmark, (uL, vL, uR, vR), point in rows:
            reading = gtsam.StereoPoint2(uL, uR, (vL + vR) / 2)
            graph.add(
                gtsam.GenericStereoFactor3D(
                    reading, self._stereo, X(i), L(landmark), self._K, self._camera
                )
            )
            if landmark not in self._met:
                self._met.add(landmark)
                values.insert(L(landmark), point)


def estimated(dataset: Dataset) -> Estimated:
    """Run iSAM2 at its default parameters, then Levenberg-Marquardt from where it ended."""
    isam, factors = gtsam.ISAM2(), Factors(dataset)
    everything, online, marks = gtsam.NonlinearFactorGraph(), [], []
    graph, values = factors.start()
    T = dataset.prior.T_world_imu
    for i in range(len(dataset)):
        if i:
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            T = factors.move(i, graph, T)
            values.insert(X(i), gtsam.Pose3(T))
        factors.see(i, graph, values, T)
        everything.push_back(graph)
        start = time.process_time()
        isam.update(graph, values)
        T = isam.calculateEstimatePose3(X(i)).matrix()
        estimated_s = time.process_time()
        P = isam.marginalCovariance(X(i))
        marks.append((start, estimated_s, time.process_time()))
        online.append(T)
    smoothed = isam.calculateEstimate()
    seconds, covariance_s = np.diff(marks).T
    start = time.process_time()
    optimum = gtsam.LevenbergMarquardtOptimizer(everything, smoothed).optimize()
    return Estimated(
        online=np.stack(online),
        smoothed=_poses(smoothed, len(dataset)),
        batch=_poses(optimum, len(dataset)),
        pose_covariance=P[np.ix_(ROTATION_FIRST, ROTATION_FIRST)],
        seconds=seconds,
        covariance_s=covariance_s,
        batch_s=time.process_time() - start,
    )


def _poses(values: gtsam.Values, count: int) -> Array:
    return np.stack([values.atPose3(X(i)).matrix() for i in range(count)])


def _gaussian(P: Array) -> gtsam.noiseModel.Gaussian:
    """Noise of a pose of this covariance, in (rho, phi) order, shape (6, 6)."""
    return gtsam.noiseModel.Gaussian.Covariance(P[np.ix_(ROTATION_FIRST, ROTATION_FIRST)])
