"""What a run keeps for the way back, in the order of time, to be read from the end.

Up to half a budget is held in memory; what is older goes to a temporary file, which is read back in
pieces of the same size.
"""

import pickle
import weakref
from collections.abc import Iterator
from tempfile import TemporaryFile
from typing import IO

import numpy as np

from vislam.filters.backward import Kept, Past


class Tape:
    """Grows at one end, is read from there."""

    def __init__(self, budget_bytes: int) -> None:
        """Use at most about so much memory."""
        self._piece_bytes = budget_bytes // 2
        self._held: list[Past] = []
        self._held_bytes = 0
        self._file: IO[bytes] | None = None
        self._pieces: list[int] = []

    def append(self, record: Past) -> None:
        """Put it at the end; what comes before the first state that was kept leads nowhere."""
        if not (self._held or self._pieces or isinstance(record, Kept)):
            return
        self._held.append(record)
        self._held_bytes += _size_bytes(record)
        if self._held_bytes > self._piece_bytes:
            self._spool()

    def __reversed__(self) -> Iterator[Past]:
        """From the last record to the first."""
        yield from reversed(self._held)
        for start in reversed(self._pieces):
            assert self._file is not None
            self._file.seek(start)
            yield from reversed(pickle.load(self._file))

    def _spool(self) -> None:
        """Move what is held to the file."""
        if self._file is None:
            self._file = TemporaryFile()  # noqa: SIM115 - it lives as long as the tape
            weakref.finalize(self, self._file.close)
        self._pieces.append(self._file.tell())
        pickle.dump(self._held, self._file, protocol=5)
        self._held, self._held_bytes = [], 0


def _size_bytes(record: object) -> int:
    """Of the arrays in a record, and in the records in it."""
    if isinstance(record, np.ndarray):
        return record.nbytes
    return sum(_size_bytes(getattr(record, name)) for name in getattr(record, "__slots__", ()))
