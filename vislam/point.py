"""A sensor that reads where a landmark is, in its own frame: projection is the identity.

Functions are named as in `vislam.camera`, and take and give what those do, with three coordinates
in place of four. The frame of the sensor is that of the left camera: x right, y down, z forward.
"""

from dataclasses import dataclass

import numpy as np

from vislam.arrays import Array, BoolArray, IntArray
from vislam.camera import Validity


@dataclass(frozen=True, slots=True, kw_only=True)
class PointSensor:
    """A sensor of relative positions. Its noise may move a reading out of what it can see.

    Attributes:
        range_m: distances between which it sees.
        view_deg: opening of the cone about its z axis in which it sees; 360 is all around.
    """

    range_m: tuple[float, float]
    view_deg: float = 360.0

    def __post_init__(self) -> None:
        """Refuse what is no sensor."""
        nearest, farthest = self.range_m
        if not 0 <= nearest < farthest < np.inf:
            raise ValueError(f"Expected `range_m` as 0 <= nearest < farthest, got {self.range_m}.")
        if not 0 < self.view_deg <= 360:
            raise ValueError(f"Expected `view_deg` above 0, up to 360, got {self.view_deg}.")


def project(sensor: PointSensor, p_sensor: Array) -> Array:  # noqa: ARG001
    """The reading of a point is the point, shape (..., n, 3)."""
    return np.asarray(p_sensor, float)


#: Every point has a reading.
project_or_nan = project


def d_project_d_point(sensor: PointSensor, p_sensor: Array) -> Array:  # noqa: ARG001
    """The identity, shape (..., n, 3) to (..., n, 3, 3)."""
    return np.broadcast_to(np.eye(3), (*p_sensor.shape, 3))


def triangulate(sensor: PointSensor, points: Array) -> Array:  # noqa: ARG001
    """The point of a reading is the reading, shape (..., n, 3)."""
    return np.asarray(points, float)


def d_triangulate_d_reading(sensor: PointSensor, points: Array) -> Array:  # noqa: ARG001
    """The identity, shape (..., n, 3) to (..., n, 3, 3)."""
    return np.broadcast_to(np.eye(3), (*points.shape, 3))


def validity(sensor: PointSensor, points: Array) -> IntArray:  # noqa: ARG001
    """A `Validity` for each reading, shape (..., n, 3) to (..., n): the first that applies.

    A reading beyond the range is valid: to leave out what noise moved there would bias the rest.
    """
    missing = np.isnan(points)
    incomplete = ~np.isfinite(points)
    return np.select(
        [missing.all(axis=-1), incomplete.any(axis=-1)],
        [Validity.UNSEEN, Validity.PARTIAL],
        Validity.VALID,
    ).astype(np.int64)


def is_valid(sensor: PointSensor, points: Array) -> BoolArray:  # noqa: ARG001
    """Which readings are VALID, shape (..., n, 3) to (..., n)."""
    return np.asarray(np.isfinite(points).all(axis=-1))
