"""Files: read with errors that name the line, written so that none is ever seen half-written."""

import math
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

import numpy as np

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

from simbench.errors import DatasetError, OutputError
from simbench.limits import refuse_above_limit
from vislam.arrays import Array

#: What a byte of text may take while it is read: numbers of one digit, as Python's own.
BYTES_PER_LETTER = 64


def size_of(path: Path) -> int:
    """The size of a file in bytes, before it is opened: to open a pipe can take for ever.

    Raises:
        DatasetError: there is none of this name, or it is no ordinary file.
    """
    try:
        found = path.stat()
    except (OSError, ValueError) as error:
        raise _unreadable(path, reason(error)) from error
    if stat.S_ISDIR(found.st_mode):
        raise _unreadable(path, "Is a directory")
    if not stat.S_ISREG(found.st_mode):
        raise _unreadable(path, "it is a device or a pipe")
    return found.st_size


def read_bytes(path: Path) -> bytes:
    """The content of a file.

    Raises:
        DatasetError: it cannot be read, or is above the limit; names the file.
    """
    size = size_of(path)
    refuse_above_limit(str(path), "the file", size)
    try:
        with path.open("rb") as stream:
            return stream.read(size)  # no more, should it grow
    except OSError as error:
        raise _unreadable(path, reason(error)) from error


def read_text(path: Path) -> str:
    """The text of a file.

    Raises:
        DatasetError: it cannot be read, is above the limit, or not UTF-8; names the file.
    """
    refuse_above_limit(str(path), "a text of this length", BYTES_PER_LETTER * size_of(path))
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DatasetError(
            f"{path}: expected text in UTF-8, got byte {error.start} of no character."
        ) from error


def _unreadable(path: Path, why: str) -> DatasetError:
    return DatasetError(f"{path}: expected a file that can be read: {why}.")


def reason(error: Exception) -> str:
    """What the operating system says."""
    return str(getattr(error, "strerror", None) or error)


def parse_rows(text: str, columns: int, where: str) -> Array:
    """Read a table of numbers, a row a line, with blanks or commas between; # starts a comment.

    Args:
        text: the lines.
        columns: how many numbers a row has.
        where: the file's name, for errors.

    Returns:
        Shape (n, columns), n at least 1.

    Raises:
        DatasetError: a line is no such row, a number is not finite, or there is none; names the
            line.
    """
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        if len(words) != columns:
            raise DatasetError(f"{where}:{number}: expected {columns} numbers, got {len(words)}.")
        try:
            row = [float(word) for word in words]
        except ValueError as error:
            raise DatasetError(
                f"{where}:{number}: expected {columns} numbers: {error!s:.80}."
            ) from error
        if not all(map(math.isfinite, row)):
            raise DatasetError(
                f"{where}:{number}: expected finite numbers, got {line.strip()!r:.200}."
            )
        rows.append(row)
    if not rows:
        raise DatasetError(f"{where}: expected rows of {columns} numbers, got none.")
    return np.array(rows)


def format_rows(rows: Array) -> str:
    """A table of numbers as text that `parse_rows` reads back exactly."""
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())


def file_safe(name: str) -> str:
    """A name as a part of a file's name: runs of other characters become an underscore."""
    return re.sub(r"[^\w.+-]+", "_", name)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, and put it in place of `path` once the block succeeded.

    The temporary path is `path` with ``.partial`` behind it, locked against other processes. Where
    the block fails it is removed and what stood at `path` before is untouched. What a killed
    process left there is replaced: a run that writes the same file makes it anew from the start.

    Raises:
        OutputError: the operating system refused, or another process is writing the same file.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _locked(partial):
            try:
                yield partial
                os.replace(partial, path)
            except BaseException:
                with suppress(OSError):
                    partial.unlink()
                raise
    except BlockingIOError as error:
        raise OutputError(
            f"Cannot write {path}: another process is writing it. Wait for it, or choose another "
            "directory."
        ) from error
    except OSError as error:
        raise OutputError(
            f"Cannot write {path}: {reason(error)}. Choose another directory or free space; "
            "earlier files are untouched."
        ) from error


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock on a file, new or left behind; the kernel lifts it when a process ends."""
    if fcntl is None:  # Windows, where an open file could not get its final name either
        yield
        return
    while True:
        with path.open("ab") as file:
            lock(file)
            if _is_at(path, file):
                yield
                return


def lock(file: IO[bytes]) -> None:
    """Lock an open file against other processes, until it is closed.

    Nothing happens where the file system or the operating system has no locks.

    Raises:
        BlockingIOError: another process holds the lock.
    """
    if fcntl is None:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        pass  # a file system without locks


def _is_at(path: Path, file: IO[bytes]) -> bool:
    """Whether an open file is the one of this name: it may have got its final name meanwhile."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False
