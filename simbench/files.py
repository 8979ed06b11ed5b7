"""Files: read with errors that name the line, written so that none is ever seen half-written."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from simbench.errors import DatasetError, OutputError
from vislam.arrays import Array

MAX_TEXT_BYTES = 16 * 2**20


def read_text(path: Path) -> str:
    """The text of a file.

    Raises:
        DatasetError: it is not there, no ordinary file, above 16 MiB, or not UTF-8; names the file.
    """
    try:
        if not path.exists():
            raise DatasetError(f"{path}: expected a file, but there is none of this name.")
        if not path.is_file():
            raise DatasetError(f"{path}: expected a file, got a directory or a device.")
        if (size := path.stat().st_size) > MAX_TEXT_BYTES:
            raise DatasetError(f"{path}: expected at most {MAX_TEXT_BYTES} bytes, got {size}.")
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DatasetError(
            f"{path}: expected text in UTF-8, got byte {error.start} of no character."
        ) from error
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}.") from error


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
        try:
            row = [float(word) for word in words]
        except ValueError as error:
            raise DatasetError(f"{where}:{number}: expected {columns} numbers: {error}.") from error
        if len(row) != columns:
            raise DatasetError(f"{where}:{number}: expected {columns} numbers, got {len(row)}.")
        if not np.isfinite(row).all():
            raise DatasetError(f"{where}:{number}: expected finite numbers, got {line.strip()!r}.")
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

    The temporary path is `path` with ``.partial`` behind it. Where the block fails it is removed
    and what stood at `path` before is untouched.

    Raises:
        OutputError: the operating system refused; says what and why.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        os.replace(partial, path)
    except OSError as error:
        raise OutputError(
            f"Cannot write {path}: {error.strerror or error}. Choose another directory or free "
            "space; earlier files are untouched."
        ) from error
    finally:
        with suppress(OSError):
            partial.unlink()
