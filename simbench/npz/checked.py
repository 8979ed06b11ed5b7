"""The contents of an `.npz` file, every key checked, its extrinsics not yet understood."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias, cast, get_args

import numpy as np

from simbench.dataset import Sightings
from simbench.npz.archive import Archive, Sparse, opened
from simbench.npz.layout import FEATURES, FORMAT, FORMER_NAMES, GROUPS
from vislam.arrays import Array
from vislam.types import ProcessModel

ExtrinsicsKey: TypeAlias = Literal["imu_T_cam", "cam_T_imu"]

RIGID_TOLERANCE = 1e-3  # real files carry about six digits
NOTED = 1e-6
EXACT = 1e-12  # as near as float64 comes to a rotation: left as it is, to the bit
#: 2^63 ns in seconds: the year 2262.
MAX_TIME_S = 9.2e9


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """What a file holds.

    Attributes:
        arrays: by today's names, in the file's shapes.
        texts, integers: the same for the others.
        times_s: shape (T,), whole nanoseconds.
        imu_times_s: shape (N,), or None.
        landmark_count: M.
        sightings: features by frame, or None.
        extrinsics_key: what the file calls its extrinsics.
        extrinsics: a rigid motion, shape (4, 4).
        notes: what was mended, for the user.
    """

    arrays: dict[str, Array]
    texts: dict[str, str]
    integers: dict[str, int]
    times_s: Array
    imu_times_s: Array | None
    landmark_count: int
    sightings: Sightings | None
    extrinsics_key: ExtrinsicsKey
    extrinsics: Array
    notes: tuple[str, ...]

    @property
    def told(self) -> bool:
        """Whether the file says what a filter is told of noise and start."""
        return "noise_process_model" in self.texts

    @property
    def process_model(self) -> ProcessModel:
        """Where it does, of what its noise is the covariance."""
        return cast(ProcessModel, self.texts["noise_process_model"])


def check(path: Path) -> Contents:
    """Read and check a file.

    Raises:
        DatasetError: the file is no usable dataset; names the file and the key.
    """
    with opened(path) as archive:
        sizes = _Sizes(archive)
        arrays: dict[str, Array] = {}
        texts: dict[str, str] = {}
        integers: dict[str, int] = {}
        for key, name, shape in _present(archive):
            if shape == "text":
                texts[key] = archive.text(name)
            elif shape == "integer":
                integers[key] = archive.integer(name)
            else:
                arrays[key] = archive.array(name)
                sizes.check(name, shape, arrays[key].shape)
        count, sightings = 0, None
        if "features" in archive.keys:
            sparse = archive.sparse("features")
            sizes.check("features", FEATURES, sparse.shape)
            count, sightings = sparse.shape[1], _sightings(sparse)
        _check_values(archive, arrays, texts)
        extrinsics_key: ExtrinsicsKey = "imu_T_cam" if "imu_T_cam" in archive.keys else "cam_T_imu"
        extrinsics, notes = _rigid(archive, extrinsics_key, arrays["imu_T_cam"])
        imu_times = arrays.get("imu_time_stamps")
        return Contents(
            arrays=arrays,
            texts=texts,
            integers=integers,
            times_s=_times(archive, "time_stamps", arrays["time_stamps"]),
            imu_times_s=(
                None if imu_times is None else _times(archive, "imu_time_stamps", imu_times)
            ),
            landmark_count=count,
            sightings=sightings,
            extrinsics_key=extrinsics_key,
            extrinsics=extrinsics,
            notes=notes,
        )


def dialect_of(path: Path) -> str:
    """Which of the format's dialects a file is in.

    Returns:
        `simbench` (2022's with our keys beside it), `2022`, `2021` (without features) or `2019`.

    Raises:
        DatasetError: the file is no `.npz`.
    """
    with opened(path) as archive:
        if "simbench_version" in archive.keys:
            return "simbench"
        if "imu_T_cam" not in archive.keys:
            return "2019"
        return "2022" if "features" in archive.keys else "2021"


def _present(archive: Archive) -> Iterator[tuple[str, str, str]]:
    """Key of today, name in the file and shape of all that the file should hold."""
    held = ", ".join(sorted(archive.keys)) or "nothing"
    for key, shape in FORMAT.items():
        former = FORMER_NAMES.get(key, key)
        name = key if key in archive.keys else former
        if name not in archive.keys:
            names = key if former == key else f"{key} (or {former})"
            raise archive.error(names, f"expected this key, the file holds {held}")
        yield key, name, shape
    for group in GROUPS:
        present = [key for key in group if key in archive.keys]
        for key, shape in group.items() if present else ():
            if key not in archive.keys:
                raise archive.error(key, f"expected this key beside {present[0]}, got none")
            yield key, key, shape


class _Sizes:
    """The lengths that letters in shapes stand for, as the first key with each has it."""

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        self._known: dict[str, tuple[int, str]] = {}

    def check(self, name: str, shape: str, got: tuple[int, ...]) -> None:
        """Hold the shape of an array against its declaration, such as ``3 T``."""
        letters = shape.split()
        wanted = f"({', '.join(letters)}{',' if len(letters) == 1 else ''})"
        if len(got) != len(letters):
            raise self._archive.error(name, f"expected shape {wanted}, got {got}")
        for letter, length in zip(letters, got, strict=True):
            if letter.isdigit():
                known, source = int(letter), ""
            else:
                known, first = self._known.setdefault(letter, (length, name))
                source = f" with {letter} = {known} as in {first}"
            if length != known:
                raise self._archive.error(name, f"expected shape {wanted}{source}, got {got}")
        if 0 in got and name != "features":
            raise self._archive.error(name, f"expected at least one column, got shape {got}")


def _times(archive: Archive, key: str, row: Array) -> Array:
    """Whole nanoseconds, increasing."""
    if np.abs(row).max() > MAX_TIME_S:
        raise archive.error(key, f"expected seconds, got {np.abs(row).max():g}")
    ns = np.rint(row[0] * 1e9)
    if (standing := np.flatnonzero(np.diff(ns) <= 0)).size:
        i = int(standing[0]) + 1
        raise archive.error(
            key,
            f"expected times that increase, but at index {i} stands {row[0, i]!r} s after "
            f"{row[0, i - 1]!r} s; remove or mend that sample",
        )
    return np.asarray(ns / 1e9)


def _sightings(dense: Sparse) -> Sightings:
    """By frame, and by landmark within a frame."""
    _, landmarks, frames = dense.shape
    coordinate, landmark, frame = dense.places
    keys, row = np.unique(frame * landmarks + landmark, return_inverse=True)
    pixels = np.full((len(keys), 4), -1.0)
    pixels[row, coordinate] = dense.values
    frame, landmark = np.divmod(keys, max(landmarks, 1))
    parts = np.searchsorted(frame, np.arange(1, frames))
    return Sightings.from_frames(
        list(zip(np.split(landmark, parts), np.split(pixels, parts), strict=True))
    )


def _check_values(archive: Archive, arrays: dict[str, Array], texts: dict[str, str]) -> None:
    K = arrays["K"]
    if K[0, 1] or K[1, 0] or not np.array_equal(K[2], [0, 0, 1]):
        raise archive.error(
            "K", f"expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {K.tolist()}"
        )
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise archive.error(
            "K", f"expected positive focal lengths, got {K[0, 0]:g} and {K[1, 1]:g}"
        )
    for key in ("b", "truth_b", "noise_pixel", "image_size"):
        if key in arrays and not (arrays[key] > 0).all():
            raise archive.error(key, f"expected what is positive, got {arrays[key].tolist()}")
    if "gate" in arrays and not 0 <= arrays["gate"] < 1:
        raise archive.error("gate", f"expected a probability below 1, got {arrays['gate']}")
    for key in ("prior_covariance", "noise_process"):
        if key in arrays:
            _check_covariance(archive, key, arrays[key])
    model = texts.get("noise_process_model")
    if model is not None and model not in get_args(ProcessModel):
        raise archive.error(
            "noise_process_model", f"expected one of {get_args(ProcessModel)}, got {model!r}"
        )
    for key, Ts in arrays.items():
        if key in ("prior_world_T_imu", "truth_world_T_imu", "truth_imu_T_cam"):
            _check_rigid(archive, key, Ts)


def _check_covariance(archive: Archive, key: str, P: Array) -> None:
    eigenvalues = np.linalg.eigvalsh(P)
    if not np.array_equal(P, P.T) or eigenvalues[0] < -1e-12 * abs(eigenvalues[-1]):
        raise archive.error(key, "expected a symmetric positive semidefinite matrix")


def _check_rigid(archive: Archive, key: str, Ts: Array) -> float:
    """How far rotations are from orthonormal: the largest element of R^T R - I."""
    R, last_row = Ts[..., :3, :3], Ts[..., 3, :]
    defect = float(np.abs(R.swapaxes(-1, -2) @ R - np.eye(3)).max())
    if defect > RIGID_TOLERANCE or np.linalg.det(R).min() < 0 or (last_row != [0, 0, 0, 1]).any():
        raise archive.error(
            key,
            "expected a rigid motion [R, p; 0, 0, 0, 1] with R^T R = I and det R = 1, got "
            f"R^T R off by {defect:.2g}, det R = {np.linalg.det(R).flat[0]:.4g} and the last row "
            f"{last_row.reshape(-1, 4)[0].tolist()}",
        )
    return defect


def _rigid(archive: Archive, key: str, T: Array) -> tuple[Array, tuple[str, ...]]:
    """The nearest exact rigid motion, and a note where that is a change that shows."""
    if _check_rigid(archive, key, T) < EXACT:
        return T, ()
    U, _, Vt = np.linalg.svd(T[:3, :3])
    mended = T.copy()
    mended[:3, :3] = U @ Vt
    change = float(np.abs(mended - T).max())
    if change < NOTED:
        return mended, ()
    return mended, (f"The rotation of `{key}` was not quite one: mended by up to {change:.1g}.",)
