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
    """Every so many frames all tracks repeat their pixels, and slide by what they missed."""
    off = np.zeros((data.landmark_count, 4))
    held = {}

    def slid(frame, ids, pixels):
        out = pixels + off[ids]
        if frame and frame % every == 0:
            for k, i in enumerate(ids.tolist()):
                if i in held:
                    off[i] += held[i] - out[k]
                    out[k] = held[i]
        held.clear()
        held.update(zip(ids.tolist(), out, strict=True))
        return out

    return replace(data, sightings=with_pixels(data, slid))


def write_bare(path: Path, data: Dataset, dialect: str) -> Path:
    """A file of a dialect with the format's own keys alone."""
    write_npz(path, data, Dialect.named(dialect))
    own = {key for group in GROUPS for key in group}
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files if key not in own}
    np.savez_compressed(path, **arrays)
    return path
