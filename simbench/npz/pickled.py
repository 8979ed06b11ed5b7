"""The dialect of 2025 on: a pickled dict, with two cameras of their own and no baseline."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simbench.conventions import Meaning
from simbench.dataset import Sightings
from simbench.errors import DatasetError
from simbench.limits import refuse_above_limit, unsound
from simbench.npz.archive import BYTES_PER_COORDINATE, Sparse
from simbench.npz.pickles import Value, load_npy_dict
from simbench.npz.values import Source, rigid
from vislam.arrays import Array
from vislam.lie import se3, so3

#: Cameras that are turned more against each other are no pair whose rows match.
MAX_TURN_DEG = 3.0
NOTED_DEG = 0.05


class Pickled:
    """The dict of a `.npy` by its keys; a value of None is as good as none."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._values: dict[str, Value] = {
            key: value for key, value in load_npy_dict(path).items() if value is not None
        }
        self.keys = set(self._values)

    def array(self, key: str) -> Array:
        """A whole array of finite numbers, as float64."""
        array = np.array(self._numbers(key), float, order="C")
        if (what := unsound(array)) is not None:
            raise self.error(key, what)
        # of the times both (T,) and (T, 1) are said
        return array.ravel() if key == "timestamps" else array

    def integer(self, key: str) -> int:
        """A whole number."""
        value = self._numbers(key)
        if value.shape != () or value.dtype.kind not in "iu":
            raise self.error(key, f"expected a whole number, got {value.dtype} {value.shape}")
        return int(value)

    def text(self, key: str) -> str:
        """A text."""
        value = self._values[key]
        if not isinstance(value, str):
            raise self.error(key, f"expected a text, got {value!r:.60}")
        return value

    def sparse(self, key: str) -> Sparse:
        """What is not -1 in an array."""
        dense = self._numbers(key)
        if not dense.ndim:
            raise self.error(key, "expected an array, got one number")
        count = int(np.count_nonzero(dense != -1))
        what = f"{count} coordinates that are not -1, which says that nothing is seen,"
        refuse_above_limit(f"{self.path}: {key}", what, count * BYTES_PER_COORDINATE)
        places = np.nonzero(dense != -1)
        values = dense[places].astype(float)
        if (wrong := unsound(values)) is not None:
            raise self.error(key, wrong)
        return Sparse(dense.shape, places, values)

    def error(self, key: str, what: str) -> DatasetError:
        """An error that names the file and the key."""
        return DatasetError(f"{self.path}: {key}: {what}.")

    def _numbers(self, key: str) -> NDArray[np.generic]:
        value = self._values[key]
        if isinstance(value, str) or value is None or value.dtype.kind not in "fiu":
            raise self.error(key, f"expected real numbers, got {value!r:.60}")
        return value


def until_2024(
    source: Source, arrays: dict[str, Array], sightings: Sightings | None, notes: list[str]
) -> tuple[dict[str, Array], Sightings | None]:
    """The dict's own keys as those of an `.npz`: rows for axes, one K, a baseline.

    Pixels of a right camera with a K of its own become those that one with the left K would see.

    Raises:
        DatasetError: the cameras do not stand side by side.
    """
    left, right = (rigid(source, key, arrays[key], []) for key in ("extL_T_imu", "extR_T_imu"))
    # The distance is the same for either direction of the extrinsics.
    T = se3.inverse(left) @ right
    baseline_m = float(np.linalg.norm(T[:3, 3]))
    turn_deg = float(np.rad2deg(np.linalg.norm(so3.log(T[:3, :3]))))
    if not baseline_m > 0 or turn_deg > MAX_TURN_DEG:
        raise source.error(
            "extR_T_imu",
            f"expected a camera beside the left one, turned by at most {MAX_TURN_DEG:g} degrees, "
            f"got one {baseline_m:.3g} m away and turned by {turn_deg:.3g} degrees",
        )
    if turn_deg > NOTED_DEG:
        notes.append(
            f"The right camera is turned by {turn_deg:.2g} degrees against the left one: taken as "
            "parallel."
        )
    K_l, K_r = arrays["K_l"], arrays["K_r"]
    if sightings is not None and not np.array_equal(K_l, K_r):
        sightings = replace(sightings, pixels=_with_left_K(sightings.pixels, K_l, K_r))
        notes.append("Pixels of the right camera, whose K differs, are as the left K would have.")
    converted = {
        "time_stamps": arrays["timestamps"][None],
        "linear_velocity": np.ascontiguousarray(arrays["v_t"].T),
        "angular_velocity": np.ascontiguousarray(arrays["w_t"].T),
        "K": K_l,
        "b": np.array(baseline_m),
        "imu_T_cam": arrays["extL_T_imu"],
    }
    return arrays | converted, sightings


def right_camera(meaning: Meaning, left: Array, right: Array) -> Array:
    """Where the right camera stands in the left optical frame, metres, shape (3,).

    Args:
        meaning: how the extrinsics are read.
        left: those of the left camera as the file has them, shape (4, 4).
        right: those of the right one.
    """
    position: Array = (se3.inverse(meaning.T_imu_cam(left)) @ meaning.T_imu_cam(right))[:3, 3]
    return position


def stands_right(position: Array) -> bool:
    """Whether a camera stands to the right of the left one, along its x axis."""
    return bool(position[0] > 0.99 * np.linalg.norm(position))


def _with_left_K(pixels: Array, K_l: Array, K_r: Array) -> Array:
    """Exact for parallel cameras; what is missing stays -1."""
    f_l, c_l, f_r, c_r = (part for K in (K_l, K_r) for part in (np.diag(K)[:2], K[:2, 2]))
    moved = pixels.copy()
    right = moved[:, 2:]
    right[:] = np.where(right == -1, -1, (right - c_r) / f_r * f_l + c_l)
    return moved
