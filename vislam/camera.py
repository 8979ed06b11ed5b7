"""The stereo rig: projection, triangulation, their Jacobians, and what is a valid feature.

Both cameras share fx, fy, cx, cy; the right one stands `baseline_m` along the left one's
x axis. Points are in the left optical frame (x right, y down, z forward).
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from vislam.arrays import Array, BoolArray, IntArray


class BehindCamera(ValueError):
    """Points that are not in front of the camera; `indices` says which, batch axes flattened."""

    def __init__(self, indices: IntArray, min_depth_m: float) -> None:
        """Keep the indices and say what was expected."""
        super().__init__(
            f"Expected every depth above {min_depth_m} m, but points {indices.tolist()} are not; "
            "leave them out before projecting."
        )
        self.indices = indices


class Validity(IntEnum):
    """What `validity` finds of a feature; anything but VALID is skipped by a filter."""

    VALID = 0
    UNSEEN = 1  #: all four coordinates are -1
    PARTIAL = 2  #: some coordinates are -1 or not finite
    BEHIND = 3  #: disparity zero or negative: no point in front of the rig
    FAR = 4  #: disparity below the rig's minimum
    OUTSIDE = 5  #: outside the image


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoRig:
    """A rectified stereo pair.

    Attributes:
        fx_px, fy_px, cx_px, cy_px: intrinsics of both cameras.
        baseline_m: distance of the right camera along the left one's x axis.
        image_px: width and height; None where it is unknown, then no feature is outside.
        min_disparity_px: a feature of less disparity is not used.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    baseline_m: float
    image_px: tuple[int, int] | None = None
    min_disparity_px: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what is no rig."""
        for name in ("fx_px", "fy_px", "baseline_m", "min_disparity_px"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"Expected `{name}` to be positive and finite, got {value}.")
        if not np.isfinite([self.cx_px, self.cy_px]).all():
            raise ValueError(f"Expected a finite centre, got ({self.cx_px}, {self.cy_px}).")

    @property
    def K(self) -> Array:
        """The intrinsic matrix, shape (3, 3)."""
        return np.array(
            [[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1]], dtype=float
        )

    @property
    def K_s(self) -> Array:
        """The paper's stereo matrix: z = K_s (q / q_3, 1), shape (4, 4)."""
        fx, fy, cx, cy = self.fx_px, self.fy_px, self.cx_px, self.cy_px
        return np.array(
            [
                [fx, 0, cx, 0],
                [0, fy, cy, 0],
                [fx, 0, cx, -fx * self.baseline_m],
                [0, fy, cy, 0],
            ]
        )


#: Nearer than this nothing is projected: the pinhole model has no meaning at the pinhole.
MIN_DEPTH_M = 1e-3


def in_front(p_cam: Array) -> BoolArray:
    """Whether points can be projected, shape (..., n, 3) to (..., n)."""
    return p_cam[..., 2] > MIN_DEPTH_M


def project(rig: StereoRig, p_cam: Array) -> Array:
    """Project points into both images, z = K_s pi(q).

    Args:
        rig: the stereo pair.
        p_cam: points in the left optical frame, metres, shape (..., n, 3).

    Returns:
        uL, vL, uR, vR in pixels, shape (..., n, 4); also beyond the image's border.

    Raises:
        BehindCamera: a depth is not above 1 mm.

    Source: the paper, III.B.3.
    """
    p_cam = np.asarray(p_cam, float)
    if not (front := in_front(p_cam)).all():
        raise BehindCamera(np.flatnonzero(~front), MIN_DEPTH_M)
    return _projected(rig, p_cam)


def project_or_nan(rig: StereoRig, p_cam: Array) -> Array:
    """As `project`, with pixels of NaN for what is not in front of the camera."""
    p_cam = np.asarray(p_cam, float)
    if not (front := in_front(p_cam)).all():
        p_cam = np.where(front[..., None], p_cam, np.nan)
    return _projected(rig, p_cam)


def _projected(rig: StereoRig, p_cam: Array) -> Array:
    x, y, z = _coordinates(p_cam)
    pixels = np.empty((*z.shape, 4))
    pixels[..., 0] = u = rig.fx_px * x / z + rig.cx_px
    pixels[..., 1] = pixels[..., 3] = rig.fy_px * y / z + rig.cy_px
    pixels[..., 2] = u - rig.fx_px * rig.baseline_m / z
    return pixels


def d_project_d_point(rig: StereoRig, p_cam: Array) -> Array:
    """K_s dpi/dq without its zero column: shape (..., n, 3) to (..., n, 4, 3)."""
    x, y, z = _coordinates(p_cam)
    by_x, by_y = rig.fx_px / z, rig.fy_px / z
    J = np.zeros((*z.shape, 4, 3))
    J[..., 0, 0] = J[..., 2, 0] = by_x
    J[..., 1, 1] = J[..., 3, 1] = by_y
    J[..., 0, 2] = by_x * (-x / z)
    J[..., 2, 2] = by_x * ((rig.baseline_m - x) / z)
    J[..., 1, 2] = J[..., 3, 2] = by_y * (-y / z)
    return J


def triangulate(rig: StereoRig, pixels: Array) -> Array:
    """The point that a stereo feature shows, depth = fx b / (uL - uR), v averaged.

    Args:
        rig: the stereo pair.
        pixels: valid features, shape (..., n, 4).

    Returns:
        Points in the left optical frame, metres, shape (..., n, 3).

    Raises:
        BehindCamera: a disparity is not positive.

    Source: the paper, III.B.1, with its missing fx.
    """
    uL, vL, uR, vR = _coordinates(pixels)
    disparity = uL - uR
    if not (disparity > 0).all():
        raise BehindCamera(np.flatnonzero(~(disparity > 0)), 0.0)
    z = rig.fx_px * rig.baseline_m / disparity
    x = z * (uL - rig.cx_px) / rig.fx_px
    y = z * (0.5 * (vL + vR) - rig.cy_px) / rig.fy_px
    return np.stack([x, y, z], axis=-1)


def d_triangulate_d_reading(rig: StereoRig, pixels: Array) -> Array:
    """The Jacobian of `triangulate`, shape (..., n, 4) to (..., n, 3, 4)."""
    x, y, z = _coordinates(triangulate(rig, pixels))
    dz = -z * z / (rig.fx_px * rig.baseline_m)  # by uL; by uR the negative
    J = np.zeros((*z.shape, 3, 4))
    for axis, value in enumerate((x, y, z)):
        J[..., axis, 0] = value / z * dz
        J[..., axis, 2] = -value / z * dz
    J[..., 0, 0] += z / rig.fx_px
    J[..., 1, 1] = J[..., 1, 3] = 0.5 * z / rig.fy_px
    return J


def validity(rig: StereoRig, pixels: Array) -> IntArray:
    """A `Validity` for each feature, shape (..., n, 4) to (..., n): the first that applies.

    A pixel centre has whole coordinates, so the image spans 0 to width - 1 and 0 to height - 1.
    """
    pixels = np.asarray(pixels, float)
    missing = pixels == -1
    incomplete = (missing | ~np.isfinite(pixels)).any(axis=-1)
    disparity = _disparity(pixels, ~incomplete)
    found = np.full(incomplete.shape, Validity.VALID, np.int64)
    if rig.image_px is not None:
        beyond = (pixels < 0) | (pixels > np.array([*rig.image_px, *rig.image_px]) - 1)
        found[beyond.any(axis=-1)] = Validity.OUTSIDE
    found[disparity < rig.min_disparity_px] = Validity.FAR
    found[disparity <= 0] = Validity.BEHIND
    found[incomplete] = Validity.PARTIAL
    found[missing.all(axis=-1)] = Validity.UNSEEN
    return found


def is_valid(rig: StereoRig, pixels: Array) -> BoolArray:
    """Which features are VALID, shape (..., n, 4) to (..., n): what a filter asks every frame."""
    pixels = np.asarray(pixels, float)
    if rig.image_px is None:
        there = np.isfinite(pixels) & (pixels != -1)
    else:
        there = (pixels >= 0) & (pixels <= np.array([*rig.image_px, *rig.image_px]) - 1)
    whole = there.all(axis=-1)
    return _disparity(pixels, whole) >= rig.min_disparity_px


def _disparity(pixels: Array, where: BoolArray) -> Array:
    """The disparity uL - uR of some features, 0 of the others."""
    disparity: Array = np.zeros(where.shape)
    return np.subtract(pixels[..., 0], pixels[..., 2], out=disparity, where=where)


def _coordinates(points: Array) -> tuple[Array, ...]:
    """Each coordinate along the last axis."""
    points = np.asarray(points, float)
    return tuple(points[..., i] for i in range(points.shape[-1]))
