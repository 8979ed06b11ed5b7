"""A run made by hand from numbers that the tests know, without simulator and filter."""

from dataclasses import dataclass, replace

import numpy as np

from simbench.dataset import Dataset, Sightings, Truth
from simbench.run import RunRecord, Step
from vislam.camera import StereoRig
from vislam.lie import se3
from vislam.types import Belief, Calibration, Innovation, Noise

CALIBRATION = Calibration(
    rig=StereoRig(fx_px=552.554, fy_px=552.554, cx_px=682.049, cy_px=238.770, baseline_m=0.6),
    T_imu_cam=np.eye(4),
)
NOISE = Noise(process_model="twist", process=np.eye(6), sigma_px=np.ones(4))


@dataclass(frozen=True)
class Planted:
    """A record and the numbers that were put into it."""

    record: RunRecord
    pose_error: np.ndarray  # (T, 6)
    pose_covariance: np.ndarray  # (T, 6, 6)
    landmark_error: np.ndarray  # (m, 3)
    landmark_covariance: np.ndarray  # (m, 3, 3)
    mapped: np.ndarray  # (m,) ids


def circle(frames: int = 60, landmarks: int = 40, *, name: str = "slam", seed: int = 0) -> Planted:
    """A lap on a circle of 10 m radius, from an exactly known start, with errors drawn from the
    covariances; every second landmark is mapped."""
    rng = np.random.default_rng(seed)
    times = np.linspace(100.0, 100.0 + 0.1 * (frames - 1), frames)
    truth = Truth(
        T_world_imu=_lap(frames),
        landmarks=rng.uniform([-15, -15, -2], [15, 15, 4], (landmarks, 3)),
        linear_velocity=np.zeros((frames, 3)),
        angular_velocity=np.zeros((frames, 3)),
        calibration=CALIBRATION,
    )
    dataset = Dataset(
        name="circle",
        times_s=times,
        linear_velocity=np.zeros((frames, 3)),
        angular_velocity=np.zeros((frames, 3)),
        landmark_count=landmarks,
        sightings=Sightings.from_frames([]),
        calibration=CALIBRATION,
        noise=NOISE,
        prior=Belief(T_world_imu=np.eye(4), pose_covariance=np.zeros((6, 6))),
        truth=truth,
    )
    growth = np.linspace(0, 1, frames)
    sigma = np.array([0.3, 0.2, 0.1, 0.005, 0.01, 0.02])
    pose_covariance = growth[:, None, None] * spread(rng, 6, (frames,)) * np.outer(sigma, sigma)
    pose_error = draw(rng, pose_covariance)
    mapped = np.arange(0, landmarks, 2)
    landmark_covariance = 0.2**2 * spread(rng, 3, (len(mapped),))
    landmark_error = draw(rng, landmark_covariance)
    belief = Belief(
        T_world_imu=np.eye(4),
        ids=mapped,
        landmarks=truth.landmarks[mapped] - landmark_error,
        landmark_covariances=landmark_covariance,
    )
    beliefs = [
        replace(belief, T_world_imu=T @ se3.exp(-xi), pose_covariance=P)
        for T, xi, P in zip(truth.T_world_imu, pose_error, pose_covariance, strict=True)
    ]
    steps = tuple(
        Step(frame=i, belief=b, innovation=white_innovation(rng, mapped) if i else None)
        for i, b in enumerate(beliefs)
    )
    record = RunRecord(dataset=dataset, filter=name, steps=steps, final=beliefs[-1], wall_s=0.5)
    return Planted(record, pose_error, pose_covariance, landmark_error, landmark_covariance, mapped)


def white_innovation(rng: np.random.Generator, ids: np.ndarray) -> Innovation:
    """Standard normal, a few refused, and one sighting skipped."""
    accepted = rng.random(len(ids)) < 0.9
    whitened = np.where(accepted[:, None], rng.standard_normal((len(ids), 4)), 0)
    return Innovation(
        ids=ids, residual=whitened, whitened=whitened, accepted=accepted, skipped=np.array([1])
    )


def spread(rng: np.random.Generator, n: int, shape: tuple[int, ...]) -> np.ndarray:
    """Random correlation-like matrices, well conditioned, shape (*shape, n, n)."""
    A = rng.standard_normal((*shape, n, n)) / np.sqrt(n)
    return 0.5 * np.eye(n) + 0.5 * A @ np.swapaxes(A, -1, -2)


def draw(rng: np.random.Generator, covariance: np.ndarray) -> np.ndarray:
    """An error from each covariance; exactly zero where that is zero."""
    lively = covariance.any(axis=(-2, -1))
    L = np.zeros_like(covariance)
    L[lively] = np.linalg.cholesky(covariance[lively])
    return (L @ rng.standard_normal((*covariance.shape[:-1], 1)))[..., 0]


def without(
    planted: Planted, *, truth: bool = False, covariance: bool = False, innovations: bool = False
) -> RunRecord:
    """The record less what is named."""
    record = planted.record

    def bare(belief: Belief) -> Belief:
        return replace(
            belief,
            pose_covariance=None,
            landmark_covariances=np.empty((0, 3, 3)),
        )

    if truth:
        record = replace(record, dataset=replace(record.dataset, truth=None))
    if covariance:
        steps = tuple(replace(s, belief=bare(s.belief)) for s in record.steps)
        record = replace(record, steps=steps, final=bare(record.final))
    if innovations:
        record = replace(record, steps=tuple(replace(s, innovation=None) for s in record.steps))
    return record


def _lap(frames: int) -> np.ndarray:
    """Poses on the circle, looking along it, swaying up and down."""
    angle = np.linspace(0, 1.9 * np.pi, frames)
    c, s = np.cos(angle), np.sin(angle)
    T = np.broadcast_to(np.eye(4), (frames, 4, 4)).copy()
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = c, -s, s, c
    T[:, :3, 3] = np.stack([10 * s, 10 * (1 - c), 0.5 * np.sin(3 * angle)], axis=-1)
    return T
