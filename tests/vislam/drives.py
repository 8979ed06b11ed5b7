"""Small drives for tests of the filters: truth, noisy readings, any schedule of sightings."""

from dataclasses import dataclass, replace
from unittest import mock

import numpy as np

from vislam.camera import StereoRig, project
from vislam.filters import observation
from vislam.filters.protocol import Factory, Filter
from vislam.lie import se3, so3
from vislam.types import Belief, Calibration, Innovation, Noise, StereoFrame, Task, Twist

RIG = StereoRig(fx_px=552, fy_px=540, cx_px=620, cy_px=188, baseline_m=0.6, image_px=(1242, 376))
T_IMU_CAM = se3.from_rotation_translation(
    np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]) @ so3.exp(np.array([0.1, -0.2, 0.05])),
    np.array([1.1, -0.3, 0.7]),
)
CALIBRATION = Calibration(rig=RIG, T_imu_cam=T_IMU_CAM)
SIGMAS = {"additive": (0.02, 0.003), "twist": (0.2, 0.03), "twist-density": (0.06, 0.01)}
PRIOR_SIGMA = np.repeat([0.1, 0.02], 3)


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A task and what comes in: frames, and the twist with its interval after each.

    `T_world_imu` are the true poses, (T, 4, 4), `landmarks` the true positions, (M, 3).
    """

    task: Task
    frames: list[StereoFrame]
    twists: list[tuple[Twist, float]]
    T_world_imu: np.ndarray
    landmarks: np.ndarray

    def feed(self, filter_: Filter) -> list[Innovation | None]:
        """Run a filter over the drive."""
        innovations = []
        for i, frame in enumerate(self.frames):
            if i:
                filter_.predict(*self.twists[i - 1])
            innovations.append(filter_.update(frame))
        return innovations


def drive(
    seen: np.ndarray,
    *,
    seed: int = 0,
    process_model: str = "twist",
    gate: float | None = None,
    partial: np.ndarray | None = None,
    noise_scale: float = 1.0,
    prior_sigma: np.ndarray = PRIOR_SIGMA,
) -> Drive:
    """Draw a drive in which frame i shows landmark j where `seen[i, j]` says so, shape (T, M).

    `partial`, of the same shape, takes one image of a sighting away. `noise_scale` scales what is
    realised of all noise, not what the filter is told.
    """
    rng = np.random.default_rng(seed)
    frames, landmarks = seen.shape
    sigma_px = np.array([0.7, 0.9, 1.2, 0.5])
    v, w = SIGMAS[process_model]
    noise = Noise(
        process_model=process_model,
        process=np.diag(np.repeat([v, w], 3) ** 2),
        sigma_px=sigma_px,
    )
    T = se3.random(rng, (), 20.0)
    prior_T = T @ se3.exp(noise_scale * prior_sigma * rng.standard_normal(6))
    prior = Belief(T_world_imu=prior_T, pose_covariance=np.diag(prior_sigma**2))
    p_cam = np.column_stack(
        [
            rng.uniform(-3, 3, landmarks),
            rng.uniform(-0.6, 0.6, landmarks),
            rng.uniform(8, 14, landmarks),
        ]
    )
    points = se3.apply(T @ T_IMU_CAM, p_cam)

    last_frame = np.where(seen.any(axis=0), frames - 1 - np.argmax(seen[::-1], axis=0), -1)
    poses, stereo, twists = [], [], []
    for i in range(frames):
        poses.append(T)
        ids = np.flatnonzero(seen[i])
        pixels = project(RIG, se3.apply(se3.inverse(T @ T_IMU_CAM), points[ids]))
        pixels += noise_scale * sigma_px * rng.standard_normal(pixels.shape)
        if partial is not None:
            pixels[partial[i, ids], 2:] = -1
        stereo.append(
            StereoFrame(time_s=float(i), ids=ids, pixels=pixels, last=last_frame[ids] == i)
        )
        dt = float(rng.uniform(0.05, 0.2))
        u = np.array([0.6, 0.2, -0.1, 0.1, -0.15, 0.3]) + 0.2 * rng.standard_normal(6)
        n = noise_scale * np.repeat([v, w], 3) * rng.standard_normal(6)
        twists.append((Twist(time_s=float(i), linear=(u + n)[:3], angular=(u + n)[3:]), dt))
        T = T @ se3.exp(dt * u)
    task = Task(
        calibration=CALIBRATION,
        noise=noise,
        prior=prior,
        gate=gate,
        trajectory=np.stack(poses),
    )
    return Drive(
        task=task, frames=stereo, twists=twists, T_world_imu=np.stack(poses), landmarks=points
    )


def feed_together(factory: Factory, runs: list[Drive]) -> Filter:
    """Run a filter over drives of one schedule at once, along a batch axis."""
    first = runs[0]
    prior = replace(
        first.task.prior, T_world_imu=np.stack([d.task.prior.T_world_imu for d in runs])
    )
    together = factory(replace(first.task, prior=prior))
    for i, frame in enumerate(first.frames):
        if i:
            twists = [d.twists[i - 1][0] for d in runs]
            together.predict(
                Twist(
                    time_s=0.0,
                    linear=np.stack([t.linear for t in twists]),
                    angular=np.stack([t.angular for t in twists]),
                ),
                first.twists[i - 1][1],
            )
        together.update(replace(frame, pixels=np.stack([d.frames[i].pixels for d in runs])))
    return together


def in_parts_of(sightings: int):
    """A context in which an update takes in so many sightings at once."""
    return mock.patch.object(observation, "PART", sightings)
