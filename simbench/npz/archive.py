"""Members of an `.npz` archive, read with distrust: nothing is unpickled, no size is believed."""

import lzma
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simbench.errors import DatasetError
from simbench.files import size_of
from simbench.limits import refuse_above_limit, unsound
from vislam.arrays import Array, IntArray

#: What a coordinate that is not -1 takes, in `Sparse` and on the way to `Sightings`.
BYTES_PER_COORDINATE = 128
#: What an array that is read whole takes, in its own size: as bytes, and as float64.
COPIES = 3
BLOCK_BYTES = 16 << 20

_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


#: What zipfile, its decompressors and numpy's header reader raise on bytes that are not theirs.
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    NotImplementedError,
    OSError,
    SyntaxError,
    TokenError,
    ValueError,
)


class Header(NamedTuple):
    """What a member says of itself."""

    shape: tuple[int, ...]
    fortran_order: bool
    dtype: np.dtype[Any]

    @property
    def order(self) -> Literal["C", "F"]:
        """Which axis runs fastest: the last or the first."""
        return "F" if self.fortran_order else "C"


class Sparse(NamedTuple):
    """The elements of an array that are not -1, by their place in it."""

    shape: tuple[int, ...]
    places: tuple[IntArray, ...]
    values: Array


def refuse_crowded(where: str, count: int) -> None:
    """Hold the number of coordinates that are not -1 against the limit."""
    what = f"{count} coordinates or more other than -1, which says that nothing is seen,"
    refuse_above_limit(where, what, BYTES_PER_COORDINATE * count)


class Archive:
    """An open `.npz`; each reader raises `DatasetError` that names the file and the key."""

    def __init__(self, path: Path, zip_: zipfile.ZipFile) -> None:
        self.path = path
        self._zip = zip_
        self.keys = {name.removesuffix(".npy") for name in zip_.namelist() if name.endswith(".npy")}
        sizes = (zip_.getinfo(f"{key}.npy").file_size for key in self.keys)
        refuse_above_limit(str(path), "the archive, unpacked,", sum(sizes))

    def array(self, key: str) -> Array:
        """A whole array of finite numbers, as float64."""
        with self._member(key) as (header, stream):
            claimed = COPIES * 8 * prod(header.shape)
            refuse_above_limit(f"{self.path}: {key}", f"an array of {header.shape}", claimed)
            flat = np.frombuffer(stream.read(), header.dtype)
            array = np.array(flat.reshape(header.shape, order=header.order), float, order="C")
        return self._finite(key, array)

    def integer(self, key: str) -> int:
        """A whole number."""
        with self._member(key, kinds="iu") as (header, stream):
            if header.shape != ():
                raise self.error(key, f"expected one number, got shape {header.shape}")
            return int(np.frombuffer(stream.read(), header.dtype)[0])

    def text(self, key: str) -> str:
        """A text."""
        with self._member(key, kinds="U") as (header, stream):
            if header.shape != ():
                raise self.error(key, f"expected one text, got an array of shape {header.shape}")
            return str(np.frombuffer(stream.read(), header.dtype)[0])

    def sparse(self, key: str) -> Sparse:
        """What is not -1 in an array that may be too large to be held whole."""
        places, values, at, count = [], [], 0, 0
        with self._member(key) as (header, stream):
            while raw := stream.read(BLOCK_BYTES):
                block = np.frombuffer(raw, header.dtype)
                seen = np.flatnonzero(block != -1)
                places.append(at + seen)
                values.append(self._finite(key, block[seen].astype(float)))
                at += len(block)
                count += len(seen)
                refuse_crowded(f"{self.path}: {key}", count)
        flat = np.concatenate([np.empty(0, np.int64), *places])
        return Sparse(
            header.shape,
            np.unravel_index(flat, header.shape, order=header.order),
            np.concatenate([np.empty(0), *values]),
        )

    def error(self, key: str, what: str) -> DatasetError:
        """An error that names the file and the key."""
        return DatasetError(f"{self.path}: {key}: {what}.")

    def _finite(self, key: str, array: Array) -> Array:
        if (what := unsound(array)) is not None:
            raise self.error(key, what)
        return array

    @contextmanager
    def _member(self, key: str, kinds: str = "fiu") -> Iterator[tuple[Header, IO[bytes]]]:
        """The header of a member, checked against its size, and the stream behind it."""
        try:
            info = self._zip.getinfo(f"{key}.npy")
            if info.flag_bits & 1:
                raise self.error(key, "expected no encryption, but the member asks for a password")
            with self._zip.open(info) as stream:
                version = np.lib.format.read_magic(stream)
                if version not in _HEADER_READERS:
                    raise self.error(key, f"expected .npy version 1 or 2, got {version}")
                header = Header(*_HEADER_READERS[version](stream))
                if header.dtype.kind not in kinds:
                    wanted = {"U": "a text", "iu": "a whole number"}.get(kinds, "real numbers")
                    raise self.error(key, f"expected {wanted}, got dtype {header.dtype}")
                held = info.file_size - stream.tell()
                declared = prod(header.shape) * header.dtype.itemsize
                if held != declared:
                    raise self.error(
                        key,
                        f"expected {declared} bytes for shape {header.shape}, got {held}; "
                        "the file is damaged",
                    )
                yield header, stream
        except _DAMAGE as error:
            raise self.error(key, f"cannot be read, the file is damaged: {error}") from error


@contextmanager
def opened(path: Path) -> Iterator[Archive]:
    """Open an `.npz`.

    Raises:
        DatasetError: there is no such file, or it is no whole zip archive.
    """
    size_of(path)
    try:
        zip_ = zipfile.ZipFile(path)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be opened: {error.strerror or error}.") from error
    except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        raise DatasetError(
            f"{path}: expected an .npz archive, but the file is none or its end is missing "
            f"({error}). Copy or make it again."
        ) from error
    with zip_:
        yield Archive(path, zip_)


def write_arrays(zip_: zipfile.ZipFile, arrays: dict[str, NDArray[Any]]) -> None:
    """Add arrays to an archive, one member each."""
    for key, array in arrays.items():
        with _new_member(zip_, key) as member:
            np.lib.format.write_array(member, array, version=(1, 0), allow_pickle=False)


def write_sparse(zip_: zipfile.ZipFile, key: str, sparse: Sparse) -> None:
    """Add a three-axis array that is -1 except at some places, built a block of rows at a time.

    Args:
        zip_: the archive.
        key: the member.
        sparse: its places in ascending (C) order.
    """
    planes, rows, columns = sparse.shape
    header = {"descr": "<f8", "fortran_order": False, "shape": sparse.shape}
    per_block = max(BLOCK_BYTES // (8 * max(columns, 1)), 1)
    row = np.ravel_multi_index(sparse.places[:2], sparse.shape[:2]) if rows else np.empty(0, int)
    with _new_member(zip_, key) as member:
        np.lib.format.write_array_header_1_0(member, header)
        for first in range(0, planes * rows, per_block):
            last = min(first + per_block, planes * rows)
            inside = slice(*np.searchsorted(row, (first, last)))
            block = np.full((last - first, columns), -1.0)
            block[row[inside] - first, sparse.places[2][inside]] = sparse.values[inside]
            member.write(block.astype("<f8", copy=False).data)


def _new_member(zip_: zipfile.ZipFile, key: str) -> IO[bytes]:
    """By name alone: zipfile then stamps 1980 on it, so that equal arrays give equal bytes."""
    return zip_.open(f"{key}.npy", "w", force_zip64=True)
