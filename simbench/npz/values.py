"""Checks of values; each raises an error that names the file and the key."""

from pathlib import Path
from typing import Protocol, get_args

import numpy as np

from simbench.dataset import Sightings, nanoseconds, seconds
from simbench.errors import DatasetError
from simbench.limits import refuse_above_limit
from simbench.npz.archive import Sparse
from vislam.arrays import Array
from vislam.types import ProcessModel

RIGID_TOLERANCE = 1e-3  # real files carry about six digits
NOTED = 1e-6
EXACT = 1e-12  # as near as float64 comes to a rotation: left as it is, to the bit
#: What a frame takes beside its sightings, while they are parted.
BYTES_PER_FRAME = 1024
#: 2^63 ns in seconds: the year 2262.
MAX_TIME_S = 9.2e9


class Source(Protocol):
    """A file of named values: an archive, or a pickled dict."""

    path: Path

    @property
    def keys(self) -> set[str]:
        """What it holds."""

    def array(self, key: str) -> Array:
        """A whole array of finite numbers, as float64."""

    def integer(self, key: str) -> int:
        """A whole number."""

    def text(self, key: str) -> str:
        """A text."""

    def sparse(self, key: str) -> Sparse:
        """What is not -1 in an array."""

    def error(self, key: str, what: str) -> DatasetError:
        """An error that names the file and the key."""


class Sizes:
    """The lengths that letters in shapes stand for, as the first key with each has it."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._known: dict[str, tuple[int, str]] = {}

    def check(self, name: str, shape: str, got: tuple[int, ...]) -> None:
        """Hold the shape of an array against its declaration, such as ``3 T``."""
        letters = shape.split()
        wanted = f"({', '.join(letters)}{',' if len(letters) == 1 else ''})"
        if len(got) != len(letters):
            raise self._source.error(name, f"expected shape {wanted}, got {got}")
        for letter, length in zip(letters, got, strict=True):
            if letter.isdigit():
                known, source = int(letter), ""
            else:
                known, first = self._known.setdefault(letter, (length, name))
                if letter == "T":
                    where, claimed = f"{self._source.path}: {name}", BYTES_PER_FRAME * length
                    refuse_above_limit(where, f"a drive of {length} frames", claimed)
                source = f" with {letter} = {known} as in {first}"
            if length != known:
                raise self._source.error(name, f"expected shape {wanted}{source}, got {got}")
        if 0 in got and name != "features":
            raise self._source.error(name, f"expected at least one column, got shape {got}")


def times_of(source: Source, key: str, row: Array) -> Array:
    """Whole nanoseconds, increasing."""
    if np.abs(row).max() > MAX_TIME_S:
        raise source.error(key, f"expected seconds, got {np.abs(row).max():g}")
    ns = nanoseconds(row[0])
    if (standing := np.flatnonzero(np.diff(ns) <= 0)).size:
        i = int(standing[0]) + 1
        raise source.error(
            key,
            f"expected times that increase, but at index {i} stands {row[0, i]!r} s after "
            f"{row[0, i - 1]!r} s; remove or mend that sample",
        )
    return seconds(ns)


def sightings_of(dense: Sparse) -> Sightings:
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


def check_values(source: Source, arrays: dict[str, Array], texts: dict[str, str]) -> None:
    """Hold numbers against what they mean; extrinsics are left to `rigid`."""
    for key in ("K", "K_l", "K_r"):
        if key in arrays:
            _check_intrinsics(source, key, arrays[key])
    for key in ("b", "truth_b", "noise_pixel", "image_size"):
        if key in arrays and not (arrays[key] > 0).all():
            raise source.error(key, f"expected what is positive, got {arrays[key].tolist()}")
    if "gate" in arrays and not 0 <= arrays["gate"] < 1:
        raise source.error("gate", f"expected a probability below 1, got {arrays['gate']}")
    for key in ("prior_covariance", "noise_process"):
        if key in arrays:
            _check_covariance(source, key, arrays[key])
    model = texts.get("noise_process_model")
    if model is not None and model not in get_args(ProcessModel):
        raise source.error(
            "noise_process_model", f"expected one of {get_args(ProcessModel)}, got {model!r}"
        )
    for key, Ts in arrays.items():
        if key in ("prior_world_T_imu", "truth_world_T_imu", "truth_imu_T_cam"):
            check_rigid(source, key, Ts)


def _check_intrinsics(source: Source, key: str, K: Array) -> None:
    if K[0, 1] or K[1, 0] or not np.array_equal(K[2], [0, 0, 1]):
        raise source.error(key, f"expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {K.tolist()}")
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise source.error(key, f"expected positive focal lengths, got {K[0, 0]:g} and {K[1, 1]:g}")


def _check_covariance(source: Source, key: str, P: Array) -> None:
    eigenvalues = np.linalg.eigvalsh(P)
    if not np.array_equal(P, P.T) or eigenvalues[0] < -1e-12 * abs(eigenvalues[-1]):
        raise source.error(key, "expected a symmetric positive semidefinite matrix")


def check_rigid(source: Source, key: str, Ts: Array) -> float:
    """How far rotations are from orthonormal: the largest element of R^T R - I."""
    R, last_row = Ts[..., :3, :3], Ts[..., 3, :]
    defect = float(np.abs(R.swapaxes(-1, -2) @ R - np.eye(3)).max())
    if defect > RIGID_TOLERANCE or np.linalg.det(R).min() < 0 or (last_row != [0, 0, 0, 1]).any():
        raise source.error(
            key,
            "expected a rigid motion [R, p; 0, 0, 0, 1] with R^T R = I and det R = 1, got "
            f"R^T R off by {defect:.2g}, det R = {np.linalg.det(R).flat[0]:.4g} and the last row "
            f"{last_row.reshape(-1, 4)[0].tolist()}",
        )
    return defect


def rigid(source: Source, key: str, T: Array, notes: list[str]) -> Array:
    """The nearest exact rigid motion; adds a note where that is a change that shows."""
    if check_rigid(source, key, T) < EXACT:
        return T
    U, _, Vt = np.linalg.svd(T[:3, :3])
    mended = T.copy()
    mended[:3, :3] = U @ Vt
    change = float(np.abs(mended - T).max())
    if change >= NOTED:
        notes.append(f"The rotation of `{key}` was not quite one: mended by up to {change:.1g}.")
    return mended
