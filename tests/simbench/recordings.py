"""A small drive made by hand, a filter that knows the truth, and what rosbags reads of a file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

from simbench.dataset import Dataset, Origin, RawImu, Sightings, Truth
from simbench.mcap import record_to
from simbench.run import RunRecord, run
from vislam.camera import StereoRig
from vislam.lie import se3
from vislam.types import Belief, Calibration, Innovation, Noise, Smoothed

FRAMES, LANDMARKS = 35, 12
EPOCH_NS = 1_577_836_800_000_000_000
METRICS = {"frames": FRAMES, "ate_rmse_m": 0.125, "wall_s": 1.5, "realtime_factor": 2.5}


def drive(frames: int = FRAMES, start_ns: int = 0) -> Dataset:
    """Some seconds at 10 Hz, with jittered times, raw IMU, and features of every kind."""
    rng = np.random.default_rng(5)
    velocity = rng.normal([1, 0, 0], 0.1, (frames, 3))
    rate = rng.normal([0, 0, 0.2], 0.05, (frames, 3))
    Ts = [se3.exp(np.array([0.3, -0.2, 0.1, 0.5, -0.4, 1.0]))]
    for v, w in zip(velocity[:-1], rate[:-1], strict=True):
        Ts.append(Ts[-1] @ se3.exp(0.1 * np.concatenate([v, w])))
    times_ns = start_ns + 100_000_000 * np.arange(frames) + rng.integers(0, 30_000_000, frames)
    imu_ns = start_ns - 3_000_000 + 5_000_000 * np.arange(20 * frames + 10)
    rig = StereoRig(
        fx_px=552.554,
        fy_px=550.1,
        cx_px=682.049,
        cy_px=238.77,
        baseline_m=0.6,
        image_px=(1242, 376),
    )
    told = Calibration(rig=rig, T_imu_cam=se3.exp(np.array([1.1, -0.3, 0.7, 1.2, -1.1, 1.3])))
    true_rig = replace(rig, baseline_m=0.61)
    A = rng.normal(size=(6, 6))
    return Dataset(
        name="drive",
        times_s=np.array([int(t) / 10**9 for t in times_ns]),
        linear_velocity=velocity + rng.normal(0, 0.1, (frames, 3)),
        angular_velocity=rate + rng.normal(0, 0.01, (frames, 3)),
        landmark_count=LANDMARKS,
        sightings=Sightings.from_frames([_sighted(rng, i) for i in range(frames)]),
        calibration=told,
        noise=Noise(
            process_model="twist", process=A @ A.T, sigma_px=np.array([0.7, 0.1, 1 / 3, 0.9])
        ),
        prior=Belief(T_world_imu=Ts[0] @ se3.exp(np.full(6, 0.01)), pose_covariance=A.T @ A),
        gate=0.999,
        imu=RawImu(
            times_s=np.array([int(t) / 10**9 for t in imu_ns]),
            gyro=rng.normal(size=(len(imu_ns), 3)),
            accel=rng.normal(size=(len(imu_ns), 3)),
            truth_gyro_bias=rng.normal(size=(len(imu_ns), 3)),
            truth_accel_bias=rng.normal(size=(len(imu_ns), 3)),
        ),
        truth=Truth(
            T_world_imu=np.array(Ts),
            landmarks=rng.uniform(-20, 20, (LANDMARKS, 3)),
            linear_velocity=velocity,
            angular_velocity=rate,
            calibration=Calibration(rig=true_rig, T_imu_cam=told.T_imu_cam),
        ),
        origin=Origin(scenario_yaml="name: drive\nabout: ä\n", seed=7, run=3, version="0.0.9"),
        notes=("A note.",),
    )


def _sighted(rng: np.random.Generator, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Features of a frame: none in the third, and some of which one image is lost."""
    n = 0 if frame == 2 else 6
    ids = np.sort(rng.choice(LANDMARKS, n, replace=False))
    pixels = rng.uniform(0, 370, (n, 4))
    pixels[:1, 2:] = -1
    pixels[1:2, :2] = -1
    return ids, pixels


class Truthful:
    """Says the truth, a little beside it, with covariances that change from frame to frame."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset, self.frame = dataset, -1

    def predict(self, motion, dt):
        pass

    def update(self, frame):
        self.frame += 1
        rng = np.random.default_rng(self.frame)
        n = len(frame.ids)
        return Innovation(
            ids=frame.ids,
            residual=rng.normal(size=(n, 4)),
            whitened=rng.normal(size=(n, 4)),
            accepted=np.ones(n, bool),
        )

    def belief(self, joint=False):  # noqa: ARG002
        rng = np.random.default_rng(1000 + self.frame)
        A, B = rng.normal(size=(6, 6)), rng.normal(size=(LANDMARKS, 3, 3))
        living = np.arange(self.frame % 3, LANDMARKS, 3)
        return Belief(
            T_world_imu=self.dataset.truth.T_world_imu[self.frame] @ se3.exp(rng.normal(0, 0.1, 6)),
            pose_covariance=0.01 * A @ A.T,
            ids=living,
            landmarks=self.dataset.truth.landmarks[living] + rng.normal(0, 0.1, (len(living), 3)),
            landmark_covariances=(B @ B.swapaxes(1, 2))[living],
        )

    def finish(self):
        everything = np.arange(LANDMARKS)
        return replace(
            self.belief(),
            ids=everything,
            landmarks=self.dataset.truth.landmarks + 0.5,
            landmark_covariances=np.tile(np.diag([0.01, 0.04, 0.09]), (LANDMARKS, 1, 1)),
        )


class Smoothing(Truthful):
    """Says at the end where it was all along."""

    def finish(self):
        rng = np.random.default_rng(77)
        poses = tuple(
            Belief(T_world_imu=T @ se3.exp(rng.normal(0, 0.01, 6)), pose_covariance=A @ A.T)
            for T, A in zip(
                self.dataset.truth.T_world_imu[: self.frame + 1],
                rng.normal(size=(self.frame + 1, 6, 6)),
                strict=True,
            )
        )
        return Smoothed(final=super().finish(), poses=poses)


def record_drive(path: Path, dataset: Dataset, make=Smoothing) -> RunRecord:
    """Record a run of a filter."""
    with record_to(path, dataset, "truthful") as recorder:
        record = run(dataset, lambda _: make(dataset), name="truthful", on_step=recorder.step)
        recorder.finish(record, METRICS)
    return record


def messages(path: Path) -> dict[str, list[tuple[int, object]]]:
    """Log time and message of every message, by topic, as rosbags reads them."""
    found: dict[str, list[tuple[int, object]]] = {}
    with AnyReader([path]) as reader:
        for connection, log_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((log_ns, message))
    return found
