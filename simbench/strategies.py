"""Hypothesis strategies for what a filter meets: rotations, poses, rigs, landmarks, whole scenes.

```python
from hypothesis import given
from simbench import strategies as st

@given(st.datasets())
def test_my_filter_keeps_its_covariance_symmetric(dataset): ...
```

All shrink towards the plain case: identity and zero, few frames and landmarks, round numbers, keys
of a scene that are left at their defaults. Awkward values (1e-9, pi) are drawn often. Noise is
never drawn from hypothesis, whose normal numbers are not normal: draw one of `seeds` and make a
generator from it; scenes carry their seed in themselves.

An argument that makes no sense raises `hypothesis.errors.InvalidArgument` where the strategy is
made, not where it is drawn from.
"""

from collections.abc import Collection
from typing import Any

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st
from hypothesis.errors import InvalidArgument
from hypothesis.strategies import DrawFn, SearchStrategy

from simbench import trajectory
from simbench.dataset import Dataset
from simbench.errors import InputError
from simbench.files import format_rows
from simbench.scenario import TRAJECTORIES, Scenario
from simbench.scenario.sensors import R_BODY_OPTICAL
from simbench.sensors import simulate
from simbench.sensors.camera import MIN_DISPARITY_PX
from vislam.arrays import Array, BoolArray
from vislam.camera import StereoRig
from vislam.lie import se3, so3
from vislam.types import Calibration, Twist

__all__ = [
    "calibrations",
    "datasets",
    "landmark_fields",
    "poses",
    "rigs",
    "rotation_vectors",
    "rotations",
    "scenarios",
    "schedules",
    "seeds",
    "twists",
]

#: Angles where formulas change their branch or lose digits.
AWKWARD_ANGLES = (1e-12, 1e-9, 1e-6, 1e-3, np.pi / 2, np.pi - 1e-9, np.pi)
AWKWARD_LENGTHS = (1e-9, 1e-3, 100.0)


def seeds() -> SearchStrategy[int]:
    """Whole numbers for ``np.random.default_rng`` or a scene's ``seed``; shrink to 0."""
    return st.integers(0, 2**32 - 1)


def rotation_vectors(max_angle: float = np.pi) -> SearchStrategy[Array]:
    """Rotation vectors phi of at most `max_angle` radians, shape (3,); shrink to zero."""
    _expect("max_angle", max_angle, 0 <= max_angle <= np.pi, "within 0 and pi radians")
    return st.builds(np.multiply, _magnitudes(max_angle, AWKWARD_ANGLES), _directions())


def rotations(max_angle: float = np.pi) -> SearchStrategy[Array]:
    """Rotation matrices, shape (3, 3); shrink to identity."""
    return rotation_vectors(max_angle).map(so3.exp)


def poses(max_distance_m: float = 100.0, max_angle: float = np.pi) -> SearchStrategy[Array]:
    """Rigid motions of at most such a translation and rotation, (4, 4); shrink to identity."""
    return st.builds(
        se3.from_rotation_translation,
        rotations(max_angle),
        _vectors(max_distance_m, "max_distance_m"),
    )


def twists(max_speed_mps: float = 10.0, max_rate_rps: float = np.pi) -> SearchStrategy[Twist]:
    """Body velocities at time 0; shrink to rest. ``.vector`` is the paper's u = [v; omega]."""
    return st.builds(
        Twist,
        time_s=st.just(0.0),
        linear=_vectors(max_speed_mps, "max_speed_mps"),
        angular=_vectors(max_rate_rps, "max_rate_rps"),
    )


def rigs() -> SearchStrategy[StereoRig]:
    """Stereo pairs from small and near to large and far; shrink to 500 px and 0.5 m."""
    focal = st.sampled_from([500.0, 552.554, 240.0, 1800.0])
    return st.builds(
        StereoRig,
        fx_px=focal,
        fy_px=focal,
        cx_px=st.sampled_from([640.0, 682.049]),
        cy_px=st.sampled_from([360.0, 238.77]),
        baseline_m=st.sampled_from([0.5, 0.1, 1.2]),
        image_px=st.sampled_from([(1280, 720), None]),
        min_disparity_px=st.just(MIN_DISPARITY_PX),
    )


def calibrations(max_lever_m: float = 2.0, max_angle: float = np.pi) -> SearchStrategy[Calibration]:
    """Rigs on an IMU; shrink to a camera at the IMU that looks along x.

    Args:
        max_lever_m: distance of the camera from the IMU.
        max_angle: by how much it is turned away from the optical axes, radians.
    """
    optical = se3.from_rotation_translation(R_BODY_OPTICAL, np.zeros(3))
    return st.builds(
        lambda rig, T: Calibration(rig=rig, T_imu_cam=T @ optical),
        rigs(),
        poses(max_lever_m, max_angle),
    )


def landmark_fields(
    min_count: int = 1, max_count: int = 6, T_world_imu: Array | None = None
) -> SearchStrategy[Array]:
    """Points 8 to 14 m ahead of a body, no two alike, shape (n, 3); shrink to few, straight ahead.

    Args:
        min_count: of landmarks, at the least.
        max_count: at the most.
        T_world_imu: the body's pose, (4, 4); default: identity.
    """
    _expect("min_count", min_count, min_count >= 0, "of at least 0")
    _expect("max_count", max_count, max_count >= min_count, f"of at least {min_count}")
    T = np.eye(4) if T_world_imu is None else np.asarray(T_world_imu, float)
    _expect("T_world_imu", T.shape, T.shape == (4, 4), "of shape (4, 4)")
    points = st.lists(_AHEAD, min_size=min_count, max_size=max_count, unique=True)
    return points.map(lambda rows: se3.apply(T, np.array(rows, float).reshape(-1, 3)))


def schedules(frames: int, landmarks: int) -> SearchStrategy[BoolArray]:
    """Which frame shows which landmark, shape (frames, landmarks); shrink to all of them."""
    _expect("frames", frames, frames >= 1, "of at least 1")
    _expect("landmarks", landmarks, landmarks >= 1, "of at least 1")
    count = frames * landmarks
    lost = st.lists(st.booleans(), min_size=count, max_size=count)
    return lost.map(lambda flags: ~np.array(flags).reshape(frames, landmarks))


def scenarios(
    max_frames: int = 6, max_landmarks: int = 6, trajectories: Collection[str] = tuple(TRAJECTORIES)
) -> SearchStrategy[Scenario]:
    """Small scenes, whole in themselves, of every kind of trajectory.

    The landmarks stand ahead of the body at one frame or another, on a grid of 0.1 m. Shrink to two
    frames straight ahead at 1 m/s with one landmark, and to few keys that are not at their default.

    Args:
        max_frames: how many there are at the most.
        max_landmarks: likewise.
        trajectories: the kinds to choose from, in any order.
    """
    _expect("max_frames", max_frames, max_frames >= 2, "of at least 2")
    _expect("max_landmarks", max_landmarks, max_landmarks >= 1, "of at least 1")
    unknown = sorted(set(trajectories) - set(TRAJECTORIES))
    _expect(
        "trajectories",
        unknown or "none",
        bool(trajectories) and not unknown,
        f"among {', '.join(TRAJECTORIES)}",
    )
    return _scenarios(max_frames, max_landmarks, sorted(trajectories, key=_PLAINEST.index))


def datasets(scenes: SearchStrategy[Scenario] | None = None) -> SearchStrategy[Dataset]:
    """Simulated drives, in which at least one landmark is seen.

    Args:
        scenes: to choose from; default: `scenarios()`.
    """
    return _datasets(scenarios() if scenes is None else scenes)


def _expect(name: str, got: object, holds: bool, expected: str) -> None:
    if not holds:
        raise InvalidArgument(f"Expected `{name}` {expected}, got {got}.")


def _tenths(low: float, high: float) -> SearchStrategy[float]:
    """Numbers with one digit behind the point; shrink to zero."""
    return st.integers(int(np.ceil(10 * low)), int(10 * high)).map(lambda n: n / 10)


def _magnitudes(most: float, awkward: tuple[float, ...]) -> SearchStrategy[float]:
    """Round numbers first, for what shrinks should be round where it can be."""
    special = [value for value in awkward if value <= most]
    numbers = _tenths(0, most) | st.floats(0, most)
    return numbers | st.sampled_from(special) if special else numbers


def _vectors(most: float, name: str) -> SearchStrategy[Array]:
    _expect(name, most, 0 <= most < np.inf, "of at least 0, and finite")
    return st.builds(np.multiply, _magnitudes(most, AWKWARD_LENGTHS), _directions())


def _directions() -> SearchStrategy[Array]:
    """Unit vectors: the axes, and others."""
    axes = [*np.eye(3), *-np.eye(3)]
    triples = st.tuples(*3 * [st.integers(-9, 9)]).filter(any)
    return st.sampled_from(axes) | triples.map(lambda v: np.array(v) / np.linalg.norm(v))


#: Ahead of a body, within the view of the scene's default rig: x, y, z in the body's frame.
_AHEAD = st.tuples(st.integers(8, 14), st.integers(-3, 3), st.integers(-1, 2))
#: Kinds of trajectories by how little there is to say about them.
_PLAINEST = ("straight", "hover", "circle", "helix", "figure8", "random", "waypoints", "file")

#: What a scene is made of beside its motion and its map, by key; None is the default, left out.
_CHOICES: dict[str, tuple[Any, ...]] = {
    "rate_hz": (1.0, 4.0, 10.0),
    "time_jitter": (None, 0.6),
    "rig.imu_cam.rotvec_deg": (None, (4.0, -6.0, 3.0)),
    "imu.velocity.sigma": (None, (0.1, 0.2, 0.3)),
    "imu.angular_velocity.sigma": (None, (0.02, 0.03, 0.05)),
    "camera.sigma_px": (None, 2.0, (0.7, 1.3, 0.9, 0.5)),
    "camera.dropout": (None, 0.3, 0.5),
    "camera.half_missing": (None, 0.3),
    "prior.sigma_translation_m": (None, 0.2, 0.0),
    "prior.sigma_rotation_deg": (None, 2.0, 0.0),
    "filter.process_noise": (None, "additive", "twist-density"),
    "filter.gate": (None, 0.999),
}
_SWAY: dict[str, tuple[Any, ...]] = {
    "roll_deg": (None, 10.0),
    "pitch_deg": (None, 8.0),
    "start": (None, {"translation_m": (120.0, -80.0, 15.0), "rotvec_deg": (20.0, -30.0, 140.0)}),
}


@st.composite
def _scenarios(draw: DrawFn, max_frames: int, max_landmarks: int, kinds: list[str]) -> Scenario:
    intervals = draw(st.integers(1, max_frames - 1))
    keys: dict[str, Any] = {"seed": draw(st.integers(0, 999))}
    for path, choices in _CHOICES.items():
        _put(keys, path, draw(st.sampled_from(choices)))
    keys["duration_s"] = intervals / keys["rate_hz"]
    motion = draw(_trajectories(draw(st.sampled_from(kinds)), keys["duration_s"]))
    for name, choices in _SWAY.items():
        _put(motion, name, draw(st.sampled_from(choices)))
    keys["trajectory"] = motion
    path_alone = Scenario.model_validate(keys)
    times_s = np.arange(intervals + 1) / path_alone.rate_hz
    poses = trajectory.make(path_alone, path_alone.seed).T_world_imu(times_s)
    spots = st.lists(
        st.tuples(st.integers(0, intervals), _AHEAD),
        min_size=1,
        max_size=max_landmarks,
        unique=True,
    )
    points = [se3.apply(poses[frame], np.array([p], float))[0] for frame, p in draw(spots)]
    keys["landmarks"] = {"kind": "file", "text": format_rows(np.round(points, 1) + 0.0)}
    return Scenario.model_validate(keys)


def _put(keys: dict[str, Any], path: str, value: Any) -> None:
    """Set a value by its dotted path, unless it is left at its default."""
    if value is None:
        return
    *sections, last = path.split(".")
    for section in sections:
        keys = keys.setdefault(section, {})
    keys[last] = value


@st.composite
def _trajectories(draw: DrawFn, kind: str, duration_s: float) -> dict[str, Any]:
    """A motion of walking pace that stays within a few metres while a small scene lasts."""
    laps = st.sampled_from([0.1, 0.2])
    match kind:
        case "straight":
            return {"kind": kind, "speed_mps": draw(st.sampled_from([1.0, 0.2, 2.0]))}
        case "circle":
            return {"kind": kind, "radius_m": 2.0, "laps": draw(laps)}
        case "figure8":
            return {"kind": kind, "size_m": (4.0, 2.0), "laps": draw(laps)}
        case "helix":
            climb_m = draw(_tenths(-1, 1))
            return {"kind": kind, "radius_m": 2.0, "laps": draw(laps), "climb_m": climb_m}
        case "hover":
            return {"kind": kind, "period_s": draw(st.sampled_from([8.0, 2.0]))}
        case "random":
            return {
                "kind": kind,
                "size_m": (2.0, 2.0, 0.5),
                "yaw_deg": 20.0,
                "period_s": (4.0, 9.0),
            }
    times_s = [0.0, duration_s / 2, duration_s]
    bend = draw(st.tuples(*4 * [_tenths(-0.5, 0.5)]))
    points = [[0.0, 0.0, 0.0], [0.5, *bend[:2]], [1.0, *bend[2:]]]
    if kind == "waypoints":
        return {"kind": kind, "points": points, "times_s": times_s}
    upright = [0.0, 0.0, 0.0, 1.0]
    rows = [[t, *p, *upright] for t, p in zip(times_s, points, strict=True)]
    return {"kind": kind, "text": format_rows(np.array(rows))}


@st.composite
def _datasets(draw: DrawFn, scenes: SearchStrategy[Scenario]) -> Dataset:
    scenario = draw(scenes)
    try:
        return simulate(scenario)
    except InputError:
        assume(False)
        raise
