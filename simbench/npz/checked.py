"""The contents of a dataset file, every key checked, its extrinsics not yet understood."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from simbench.conventions import FROM_2021, FROM_2025, UNTIL_2020, Meaning
from simbench.dataset import Sightings
from simbench.errors import DatasetError
from simbench.npz.archive import opened
from simbench.npz.layout import FEATURES, FORMAT, FORMAT_2025, FORMER_NAMES, GROUPS
from simbench.npz.pickled import Pickled, right_camera, stands_right, until_2024
from simbench.npz.values import Sizes, Source, check_values, rigid, sightings_of, times_of
from vislam.arrays import Array
from vislam.types import ProcessModel


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
        dialect: `simbench` (2022's with our keys beside it), `2025`, `2022`, `2021` (without
            features) or `2019`.
        extrinsics_key: what the file calls its extrinsics.
        meanings: what they may mean, what the file itself claims first, by the name of the key and
            by where the right camera stands.
        extrinsics: a rigid motion, shape (4, 4).
        right_extrinsics: those of the right camera, where the file has them.
    notes: what was mended, for the user.
    """

    arrays: dict[str, Array]
    texts: dict[str, str]
    integers: dict[str, int]
    times_s: Array
    imu_times_s: Array | None
    landmark_count: int
    sightings: Sightings | None
    dialect: str
    extrinsics_key: str
    meanings: tuple[Meaning, ...]
    extrinsics: Array
    right_extrinsics: Array | None
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
    with _opened(path) as source:
        sizes = Sizes(source)
        arrays: dict[str, Array] = {}
        texts: dict[str, str] = {}
        integers: dict[str, int] = {}
        for key, name, shape in _present(source):
            if shape == "text":
                texts[key] = source.text(name)
            elif shape == "integer":
                integers[key] = source.integer(name)
            else:
                arrays[key] = source.array(name)
                sizes.check(name, shape, arrays[key].shape)
        count, sightings = 0, None
        if "features" in source.keys:
            sparse = source.sparse("features")
            sizes.check("features", FEATURES, sparse.shape)
            count, sightings = sparse.shape[1], sightings_of(sparse)
        check_values(source, arrays, texts)
        notes: list[str] = []
        right, dialect = None, _dialect(source)
        if dialect == "2025":
            right = rigid(source, "extR_T_imu", arrays["extR_T_imu"], notes)
            arrays, sightings = until_2024(source, arrays, sightings, notes)
        extrinsics_key, meanings = _MEANINGS.get(dialect, ("imu_T_cam", FROM_2021))
        extrinsics = rigid(source, extrinsics_key, arrays["imu_T_cam"], notes)
        if right is not None:  # first those that the file does not contradict
            meanings = tuple(
                sorted(meanings, key=lambda m: not stands_right(right_camera(m, extrinsics, right)))
            )
        imu_times = arrays.get("imu_time_stamps")
        return Contents(
            arrays=arrays,
            texts=texts,
            integers=integers,
            times_s=times_of(source, _name_of_times(source), arrays["time_stamps"]),
            imu_times_s=(
                None if imu_times is None else times_of(source, "imu_time_stamps", imu_times)
            ),
            landmark_count=count,
            sightings=sightings,
            dialect=dialect,
            extrinsics_key=extrinsics_key,
            meanings=meanings,
            extrinsics=extrinsics,
            right_extrinsics=right,
            notes=tuple(notes),
        )


_MEANINGS = {"2019": ("cam_T_imu", UNTIL_2020), "2025": ("extL_T_imu", FROM_2025)}


def dialect_of(path: Path) -> str:
    """Which of the format's dialects a file is in.

    Returns:
        `simbench` (2022's with our keys beside it), `2025`, `2022`, `2021` (without features) or
        `2019`.

    Raises:
        DatasetError: the file is neither an `.npz` nor a pickled dict.
    """
    with _opened(path) as source:
        return _dialect(source)


def _dialect(source: Source) -> str:
    if isinstance(source, Pickled):
        return "2025"
    if "imu_T_cam" not in source.keys:
        return "2019"
    if "features" not in source.keys:
        return "2021"
    return "simbench" if "simbench_version" in source.keys else "2022"


@contextmanager
def _opened(path: Path) -> Iterator[Source]:
    """An archive or a pickled dict, by its first bytes."""
    try:
        with path.open("rb") as stream:
            pickled = stream.read(6) == b"\x93NUMPY"
    except OSError as error:
        raise DatasetError(f"{path}: cannot be opened: {error.strerror or error}.") from error
    if pickled:
        yield Pickled(path)
    else:
        with opened(path) as archive:
            yield archive


def _name_of_times(source: Source) -> str:
    return "timestamps" if isinstance(source, Pickled) else "time_stamps"


def _present(source: Source) -> Iterator[tuple[str, str, str]]:
    """Key of today, name in the file and shape of all that the file should hold."""
    held = f"{', '.join(sorted(source.keys)) or 'nothing':.500}"
    for key, shape in (FORMAT_2025 if isinstance(source, Pickled) else FORMAT).items():
        former = FORMER_NAMES.get(key, key)
        name = key if key in source.keys else former
        if name not in source.keys:
            names = key if former == key else f"{key} (or {former})"
            raise source.error(names, f"expected this key, the file holds {held}")
        yield key, name, shape
    for group in GROUPS:
        present = [key for key in group if key in source.keys]
        for key, shape in group.items() if present else ():
            if key not in source.keys:
                raise source.error(key, f"expected this key beside {present[0]}, got none")
            yield key, key, shape
