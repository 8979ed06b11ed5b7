"""Generated drives written as the files of the course are: bare, and with their faults."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from simbench.dataset import Dataset, Sightings
from simbench.npz import write_npz
from simbench.npz.dialects import Dialect
from simbench.npz.layout import GROUPS
from simbench.scenario import load
from simbench.sensors import simulate
from vislam.camera import project
from vislam.lie import se3

SCENE = Path(__file__).parents[2] / "scenarios/drive.yaml"


def drive(sigma_v=0.5, sigma_w=0.05, sigma_px=0.7, *, seconds=31.0, seed=None) -> Dataset:
    """The beginning of the shipped drive, with depth to 245 m."""
    told = [
        f"imu.velocity.sigma={sigma_v}",
        f"imu.angular_velocity.sigma={sigma_w}",
        f"camera.sigma_px={sigma_px}",
        "camera.outliers.share=0.0",
        "rig.depth_m=[4.0, 245.0]",
        f"duration_s={seconds}",
        f"landmarks.count={round(47 * seconds)}",  # of all 105.5 s there are 5,000
    ]
    return simulate(load(SCENE, told), seed=seed)


def with_pixels(data: Dataset, change) -> Sightings:
    """The sightings, each frame's pixels changed by (frame, ids, pixels)."""
    each = [data.frame(i) for i in range(len(data))]
    return Sightings.from_frames([(f.ids, change(i, f.ids, f.pixels)) for i, f in enumerate(each)])


def with_jumps(data: Dataset, share=0.02, seed=0) -> Dataset:
    """Disparities that jump by 5 to 15 px, and stay there until the end of the track."""
    rng = np.random.default_rng(seed)
    off = np.zeros(data.landmark_count)

    def jumped(_, ids, pixels):
        jumps = ids[rng.random(len(ids)) < share]
        off[jumps] += rng.choice([-1, 1], len(jumps)) * rng.uniform(5, 15, len(jumps))
        out = pixels.copy()
        out[:, 2] += off[ids]
        return out

    return replace(data, sightings=with_pixels(data, jumped))


def with_repeats(data: Dataset, every=7) -> Dataset:
    """Every so many frames all tracks repeat their pixels, and go on at the point seen there."""
    rig, T_imu_cam = data.calibration.rig, data.calibration.T_imu_cam
    T_world_cam = data.truth.T_world_imu @ T_imu_cam
    points = data.truth.landmarks.copy()
    held = {}

    def slid(frame, ids, pixels):
        to_cam = se3.inverse(T_world_cam[frame])
        there, was = (se3.apply(to_cam, p[ids]) for p in (points, data.truth.landmarks))
        seen = there[:, 2] > 1
        out = np.full(pixels.shape, -1.0)
        out[seen] = pixels[seen] + project(rig, there[seen]) - project(rig, was[seen])
        if frame and frame % every == 0:
            for k, i in enumerate(ids.tolist()):
                if i in held:
                    out[k] = held[i]
                    points[i] = se3.apply(T_world_cam[frame], se3.apply(before[0], points[i]))
        before[:] = [to_cam]
        held.clear()
        held.update(zip(ids[seen].tolist(), out[seen], strict=True))
        return out

    before = [np.eye(4)]
    return replace(data, sightings=with_pixels(data, slid))


def with_standing_pictures(data: Dataset, every=7, frames=2) -> Dataset:
    """Every so often the whole frame stays for some more, and the next one is right again."""
    each = [data.frame(i) for i in range(len(data))]
    each = [each[i - i % every if i % every <= frames else i] for i in range(len(data))]
    sightings = Sightings.from_frames([(f.ids, f.pixels) for f in each])
    return replace(data, sightings=sightings)


def write_bare(path: Path, data: Dataset, dialect: str) -> Path:
    """A file of a dialect with the format's own keys alone."""
    write_npz(path, data, Dialect.named(dialect))
    own = {key for group in GROUPS for key in group}
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files if key not in own}
    np.savez_compressed(path, **arrays)
    return path
