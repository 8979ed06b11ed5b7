"""What a point sensor reads: where landmarks are in its frame, visibility by the truth.

It calls nothing of `vislam.point`, so that a fault there cannot cancel.
"""

import numpy as np

from simbench.dataset import PointSightings
from simbench.scenario import Scenario
from simbench.scenario.sensors import PointSensor
from simbench.sensors.camera import Chance, hidden, kept_by_tracker
from vislam.arrays import Array, BoolArray, IntArray


def relative(T_imu_cam: Array, p_imu: Array) -> Array:
    """Points of the IMU frame in the sensor's, shape (n, 3)."""
    return (p_imu - T_imu_cam[:3, 3]) @ T_imu_cam[:3, :3]


def sightings(
    scenario: Scenario,
    point: PointSensor,
    seed: int,
    run: int,
    Ts_world_imu: Array,
    landmarks: Array,
) -> PointSightings:
    """What the sensor reports at each frame.

    Visible is what in truth lies within its range and cone and behind no wall, wherever the noise
    puts the reading: a range that cut the noise off would bias what is left. The noise of a
    sighting depends on seed, run, landmark and frame alone, and its sigma on the true point.

    Args:
        scenario: the scene.
        point: its sensor.
        seed: its seed.
        run: the run number.
        Ts_world_imu: true poses at the frames, shape (T, 4, 4).
        landmarks: in the world, shape (M, 3).
    """
    columns = []
    for i, T in enumerate(Ts_world_imu):
        chance = Chance(seed, run, i)
        ids, true = visible(scenario, point, T, landmarks)
        sigma = np.maximum(point.share * np.abs(true), point.floor_m)
        points = true + sigma * chance.normal("point.noise", ids, 3)
        lost = chance.uniform("camera.dropout", ids, 1)[:, 0] < scenario.camera.dropout
        columns.append((ids, points, ~lost))
    frames = kept_by_tracker(scenario, seed, run, columns, len(landmarks))
    return PointSightings.from_frames(frames)


def visible(
    scenario: Scenario, point: PointSensor, T_world_imu: Array, landmarks: Array
) -> tuple[IntArray, Array]:
    """Which landmarks a true pose shows, ascending, and where they are, shape (n, 3)."""
    R, p = T_world_imu[:3, :3], T_world_imu[:3, 3]
    T_imu_cam = scenario.rig.T_imu_cam
    q = relative(T_imu_cam, (landmarks - p) @ R)
    ids = np.flatnonzero(_in_view(point, q))
    if scenario.camera.walls:
        eye = R @ T_imu_cam[:3, 3] + p
        ids = ids[~hidden(np.array(scenario.camera.walls), eye, landmarks[ids])]
    return ids, q[ids]


def _in_view(point: PointSensor, q: Array) -> BoolArray:
    """Whether points are within the range and the cone, shape (n,)."""
    distance = np.linalg.norm(q, axis=1)
    nearest, farthest = point.range_m
    cone = np.cos(np.deg2rad(point.view_deg / 2))
    return np.asarray((nearest <= distance) & (distance <= farthest) & (q[:, 2] >= cone * distance))
