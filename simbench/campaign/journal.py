"""The journal of a campaign: every row as it is finished, so that none is made twice.

A line is one row as JSON. Lines are appended and synced a task at a time; where the last is torn,
it is dropped. It is locked while it is open, so that one campaign alone writes to a directory. In
memory there are eight bytes a row: where its line begins.
"""

import json
import os
from array import array
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from simbench.campaign.rows import Row
from simbench.errors import InputError, OutputError
from simbench.files import lock

NAME = "journal.jsonl"


class Journal:
    """The rows of a campaign, by their places in its order.

    Args:
        path: the file; rows that it holds are taken over.
        groups: what the rows of a case and filter share, in order.
        runs: of each group.

    Attributes:
        missing: how many rows are not there.

    Raises:
        InputError: the file is no journal.
        OutputError: it cannot be written, or another campaign is writing it.
    """

    def __init__(self, path: Path, groups: Iterable[Mapping[str, Any]], runs: int) -> None:
        self._groups = {_key(group): i for i, group in enumerate(groups)}
        self._runs = runs
        self._starts = array("q", [-1]) * (len(self._groups) * runs)
        self.missing = len(self._starts)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a+b")
            lock(self._file)
        except BlockingIOError as error:
            self._file.close()
            raise OutputError(
                f"Cannot write {path}: another campaign is writing it. Wait for it, or choose "
                "another --out."
            ) from error
        except OSError as error:
            raise OutputError(f"Cannot write {path}: {error.strerror or error}.") from error
        self._path = path
        try:
            self._take_over()
        except InputError:
            self._file.close()
            raise

    def _take_over(self) -> None:
        """Find the rows that are there, and drop a torn last line."""
        self._file.seek(0)
        end = 0
        for number, line in enumerate(self._file, 1):
            if not line.endswith(b"\n"):
                break
            try:
                row = json.loads(line)
                if row.get("simulated", True):  # else it is cheap, and may go with another limit
                    self._note(row, end)
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                raise InputError(
                    f"{self._path}:{number}: expected a row of a campaign, got {line!r:.60}; "
                    "choose another --out, or delete the file to run all again."
                ) from error
            end += len(line)
        self._file.truncate(end)

    def _note(self, row: Row, start: int) -> None:
        group = self._groups.get(_key(row))
        if group is not None and 0 <= row["run"] < self._runs:
            place = group * self._runs + row["run"]
            self.missing -= self._starts[place] < 0
            self._starts[place] = start

    def __contains__(self, place: tuple[int, int]) -> bool:
        """Whether the row of a group and run is there."""
        group, run = place
        return self._starts[group * self._runs + run] >= 0

    def __len__(self) -> int:
        """How many rows the campaign has."""
        return len(self._starts)

    def append(self, rows: Iterable[Row]) -> None:
        """Add rows, and return when they are on the disk."""
        try:
            for row in rows:
                start = self._file.seek(0, os.SEEK_END)
                self._file.write(json.dumps(row, allow_nan=False).encode() + b"\n")
                self._note(row, start)
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise OutputError(
                f"Cannot write {self._path}: {error.strerror or error}. What is in it is whole; "
                "free space, and the same command goes on."
            ) from error

    def row(self, group: int, run: int) -> Row:
        """The row of a group and run."""
        self._file.seek(self._starts[group * self._runs + run])
        row: Row = json.loads(self._file.readline())
        return row

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _key(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """What a row's numbers depend on, beside the run."""
    return row["case"], row["filter"], row["seed"], row.get("smooth"), row["code"]


def in_order(journal: Journal, cases: int, filters: int, runs: int) -> Iterator[Row]:
    """All rows of a complete journal: by case, then run, then filter."""
    for case in range(cases):
        for run in range(runs):
            for each in range(filters):
                yield journal.row(case * filters + each, run)
