"""What the cameras see: visibility by the truth, noise by landmark and frame.

The projection uses 3x4 camera matrices and nothing of `vislam.camera`, so that a fault there cannot
cancel.
"""

import numpy as np
from scipy.special import ndtri

from simbench.dataset import Sightings
from simbench.rng import stream
from simbench.scenario import Scenario
from simbench.scenario.sensors import Rig, Tracks
from vislam.arrays import Array, BoolArray, IntArray
from vislam.camera import StereoRig

#: What `StereoRig` of the filter uses: less is not reported.
MIN_DISPARITY_PX = 1.0
#: Share of a line of sight that a wall at its end does not cover: a landmark on a wall is seen.
ON_WALL = 1e-9
#: A log-normal of this many sigmas holds the longest of a few thousand tracks.
TRACK_SIGMAS = 3.5


def camera_matrices(rig: Rig | StereoRig, T_imu_cam: Array) -> tuple[Array, Array]:
    """P = K [R | t] of the left and the right camera, from the IMU frame, each (3, 4)."""
    K = np.array([[rig.fx_px, 0, rig.cx_px], [0, rig.fy_px, rig.cy_px], [0, 0, 1]])
    R, p = T_imu_cam[:3, :3].T, T_imu_cam[:3, 3]
    left = K @ np.column_stack([R, -R @ p])
    right = left - K @ np.column_stack([np.zeros((3, 3)), [rig.baseline_m, 0, 0]])
    return left, right


def projected(matrices: tuple[Array, Array], p_imu: Array) -> tuple[Array, Array]:
    """Pixels uL, vL, uR, vR, shape (n, 4), and depths, shape (n,), of points in the IMU frame."""
    homogeneous = np.column_stack([p_imu, np.ones(len(p_imu))])
    left, right = (homogeneous @ P.T for P in matrices)
    with np.errstate(divide="ignore", invalid="ignore"):  # a depth of 0 is never visible
        return np.column_stack([left[:, :2] / left[:, 2:], right[:, :2] / right[:, 2:]]), left[:, 2]


def hidden(walls: Array, eye: Array, points: Array) -> BoolArray:
    """Whether a wall stands between an eye and points.

    Args:
        walls: x0, y0, x1, y1, height of upright rectangles on z = 0, shape (w, 5).
        eye: shape (3,).
        points: shape (n, 3).

    Returns:
        Shape (n,).
    """
    foot, along = walls[:, :2], walls[:, 2:4] - walls[:, :2]
    sight = (points - eye)[:, None]  # (n, 1, 3)
    to_foot = foot - eye[:2]
    with np.errstate(divide="ignore", invalid="ignore"):  # a parallel wall hides nothing
        area = _cross(sight[..., :2], along)
        on_sight = _cross(to_foot, along) / area
        on_wall = _cross(to_foot, sight[..., :2]) / area
        height = eye[2] + on_sight * sight[..., 2]
        crossed = (on_sight > 0) & (on_sight < 1 - ON_WALL) & (on_wall >= 0) & (on_wall <= 1)
        hit = crossed & (height >= 0) & (height <= walls[:, 4])
    return np.asarray(hit.any(axis=1))


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def sightings(
    scenario: Scenario, seed: int, run: int, Ts_world_imu: Array, landmarks: Array
) -> Sightings:
    """What the stereo pair reports at each frame.

    Visible is what the truth has in both images, within the depth range and behind no wall. What
    noise moves out of an image, or below the least disparity, is lost, not clipped. The noise of a
    sighting depends on seed, run, landmark and frame alone.

    Args:
        scenario: the scene.
        seed: its seed.
        run: the run number.
        Ts_world_imu: true poses at the frames, shape (T, 4, 4).
        landmarks: in the world, shape (M, 3).
    """
    matrices = camera_matrices(scenario.rig, scenario.rig.T_imu_cam)
    columns = [
        _reported(scenario, Chance(seed, run, i), *visible(scenario, matrices, T, landmarks))
        for i, T in enumerate(Ts_world_imu)
    ]
    return Sightings.from_frames(kept_by_tracker(scenario, seed, run, columns, len(landmarks)))


def kept_by_tracker(
    scenario: Scenario,
    seed: int,
    run: int,
    columns: list[tuple[IntArray, Array, BoolArray]],
    landmarks: int,
) -> list[tuple[IntArray, Array]]:
    """The ids and readings of each frame, where the tracker has not lost them.

    Args:
        scenario: the scene.
        seed: its seed.
        run: the run number.
        columns: of each frame the ids, the readings, and which of them were not lost at once.
        landmarks: how many there are.
    """
    frames = np.repeat(np.arange(len(columns)), [len(ids) for ids, _, _ in columns])
    ids, readings, kept = (np.concatenate(column) for column in zip(*columns, strict=True))
    if scenario.camera.tracks is not None and len(ids):
        u = stream(seed, run, "camera.tracks").random((landmarks, 2))
        kept &= _tracked(scenario.camera.tracks, frames, ids, u)
        frames_of = np.bincount(ids[kept], minlength=landmarks)
        kept &= (frames_of >= scenario.camera.tracks.min_frames)[ids]
    parts = np.searchsorted(frames[kept], np.arange(1, len(columns)))
    return list(zip(np.split(ids[kept], parts), np.split(readings[kept], parts), strict=True))


def visible(
    scenario: Scenario, matrices: tuple[Array, Array], T_world_imu: Array, landmarks: Array
) -> tuple[IntArray, Array]:
    """Which landmarks a true pose shows, ascending, and their exact pixels, shape (n, 4)."""
    R, p = T_world_imu[:3, :3], T_world_imu[:3, 3]
    nearest, farthest = scenario.rig.depth_m
    depth = (landmarks - p) @ (R @ matrices[0][2, :3]) + matrices[0][2, 3]
    ids = np.flatnonzero((nearest <= depth) & (depth <= farthest))
    pixels, _ = projected(matrices, (landmarks[ids] - p) @ R)
    inside = _inside(scenario, pixels)
    ids, pixels = ids[inside], pixels[inside]
    if scenario.camera.walls:
        walls, T_imu_cam = np.array(scenario.camera.walls), scenario.rig.T_imu_cam
        for x in (0.0, scenario.rig.baseline_m):
            eye = R @ (T_imu_cam[:3, :3] @ [x, 0, 0] + T_imu_cam[:3, 3]) + p
            in_sight = ~hidden(walls, eye, landmarks[ids])
            ids, pixels = ids[in_sight], pixels[in_sight]
    return ids, pixels


def _inside(scenario: Scenario, pixels: Array) -> BoolArray:
    """Whether both pixels are in their images."""
    width, height = scenario.rig.image_px
    last = (width - 1, height - 1, width - 1, height - 1)
    return np.asarray(((pixels >= 0) & (pixels <= last)).all(axis=1))


class Chance:
    """The random rows of one frame: one stream a purpose, one row a landmark.

    A row is drawn for every landmark up to the last visible one, so no row depends on which others
    are seen or exist.
    """

    def __init__(self, seed: int, run: int, frame: int) -> None:
        self._seed, self._run, self._frame = seed, run, frame

    def uniform(self, purpose: str, ids: IntArray, columns: int) -> Array:
        """Between 0 and 1, shape (n, columns)."""
        return self._rng(purpose).random((ids.max(initial=-1) + 1, columns))[ids]

    def normal(self, purpose: str, ids: IntArray, columns: int) -> Array:
        """Standard normal, shape (n, columns)."""
        return self._rng(purpose).standard_normal((ids.max(initial=-1) + 1, columns))[ids]

    def _rng(self, purpose: str) -> np.random.Generator:
        return stream(self._seed, self._run, purpose, self._frame)


def _reported(
    scenario: Scenario, chance: Chance, ids: IntArray, true_pixels: Array
) -> tuple[IntArray, Array, BoolArray]:
    """What a tracker could follow: ids, pixels, and whether it is reported in this frame.

    The tracker follows by the noise alone; outliers and drop-outs befall what it follows.
    """
    camera = scenario.camera

    def usable(pixels: Array) -> BoolArray:
        return _inside(scenario, pixels) & (pixels[:, 0] - pixels[:, 2] >= MIN_DISPARITY_PX)

    pixels = true_pixels + camera.sigma_px * chance.normal("camera.noise", ids, 4)
    followed = usable(pixels)
    ids, pixels = ids[followed], pixels[followed]
    kept = np.ones(len(ids), bool)
    if camera.outliers.share:
        wrong = chance.uniform("camera.outlier", ids, 1)[:, 0] < camera.outliers.share
        way = chance.normal("camera.outlier.direction", ids[wrong], 4)
        pixels[wrong] += camera.outliers.size_px * way / np.linalg.norm(way, axis=1, keepdims=True)
        kept = usable(pixels)
    if camera.half_missing:
        u, which = chance.uniform("camera.half", ids, 2).T
        missing = u < camera.half_missing
        pixels[missing & (which < 0.5), :2] = -1.0
        pixels[missing & (which >= 0.5), 2:] = -1.0
    if camera.dropout:
        kept &= chance.uniform("camera.dropout", ids, 1)[:, 0] >= camera.dropout
    return ids, pixels, kept


def _tracked(tracks: Tracks, frames: IntArray, ids: IntArray, u: Array) -> BoolArray:
    """Which sightings belong to their landmark's one track.

    A track is a piece of the longest run of consecutive frames that hold the landmark, as long as a
    log-normal law about the wanted median says or the run allows, anywhere in it.

    Args:
        tracks: the lengths that are wanted, in frames.
        frames: of each sighting, shape (S,).
        ids: of each sighting, shape (S,).
        u: two uniform numbers for each landmark: the length and the place of its track.
    """
    order = np.lexsort((frames, ids))
    starts = np.flatnonzero(
        np.diff(ids[order], prepend=-1).astype(bool) | (np.diff(frames[order], prepend=-2) != 1)
    )
    runs = np.diff(starts, append=len(order))
    owner = ids[order][starts]
    longest = np.lexsort((-starts, runs, owner))[np.append(np.diff(np.sort(owner)) > 0, True)]
    starts, runs, owner = starts[longest], runs[longest], owner[longest]

    shortest, spread = tracks.min_frames, tracks.median_frames - tracks.min_frames
    lengths = np.full(len(owner), float(shortest))
    if spread:
        growth = np.log((tracks.max_frames - shortest) / spread) / TRACK_SIGMAS
        lengths += spread * np.exp(growth * ndtri(u[owner, 0]))
    lengths = np.minimum(np.minimum(np.rint(lengths), tracks.max_frames), runs).astype(int)
    first = starts + np.floor(u[owner, 1] * (runs - lengths + 1)).astype(int)

    kept = np.zeros(len(ids), bool)
    within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    kept[order[np.repeat(first, lengths) + within]] = True
    return kept
