"""The processes in which filters run, seen from whoever started them.

A filter may hang, also in compiled code, or bring its process down. So it runs in a child process,
the same on a laptop and in a worker of a cluster; what is left of its work goes to another child.
"""

import atexit
import os
import pickle
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from simbench.campaign import code
from simbench.campaign.rows import Row, Work
from simbench.errors import InputError

#: Finds modules where this process does, so that the code is the same.
_SERVE = "import sys; sys.path[:] = {}; from simbench.campaign.child import main; main()"
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def _searched() -> list[str]:
    """Where this process finds modules; it passes over what is no text."""
    return [entry for entry in sys.path if isinstance(entry, str)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What became of work.

    Attributes:
        rows: one for each of its todo.
        wall_s: the time it took.
    """

    rows: tuple[Row, ...]
    wall_s: float


class Died(Exception):
    """A child ended within a row: how, and why."""

    def __init__(self, status: str, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


class Child:
    """A process that makes rows."""

    def __init__(self) -> None:
        self._directory = TemporaryDirectory(prefix="simbench-", ignore_cleanup_errors=True)
        self._log = Path(self._directory.name) / "log"
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _SERVE.format(_searched()), str(self._log)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | _ONE_THREAD,
        )
        if self._process.stdin is None or self._process.stdout is None:
            raise AssertionError("a process with pipes has them")
        self._work, self._answers = self._process.stdin, self._process.stdout

    def rows(self, work: Work) -> Iterator[Row]:
        """The rows of some work, one by one.

        Raises:
            Died: within the row that was due.
        """
        try:
            pickle.dump(work, self._work)
            self._work.flush()
            while (row := pickle.load(self._answers)) is not None:
                yield row
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            raise Died(*self._end(work.time_limit_s)) from error

    def _end(self, time_limit_s: float) -> tuple[str, str]:
        """How the process ended, as status and reason."""
        exit_code = self._process.wait()
        log = self._log.read_text(encoding="utf-8") if self._log.exists() else ""
        threads = re.split(r"^(?=Current thread|Thread )", log, flags=re.MULTILINE)
        current = [thread for thread in threads if thread.startswith("Current")]
        frame = re.search(r'File "(.*)", line (\d+) in (\S+)', (current or threads)[-1])
        where = f"; it was in {frame[3]}, {frame[1]}:{frame[2]}" if frame else ""
        if log.startswith("Timeout"):
            return "hung", f"no answer within {time_limit_s:g} s{where}"
        how = signal.Signals(-exit_code).name if exit_code < 0 else f"exit status {exit_code}"
        return "failed", f"its process ended with {how}{where}"

    def close(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        self._process.wait()
        self._answers.close()
        with suppress(BrokenPipeError):  # of work that it did not read
            self._work.close()
        self._directory.cleanup()


class Children:
    """Children that wait for work; for several threads at once."""

    def __init__(self) -> None:
        self._idle: list[Child] = []
        self._all: set[Child] = set()
        self.closed = False

    def take(self) -> Child:
        """One that is free, or a new one."""
        try:
            return self._idle.pop()
        except IndexError:
            child = Child()
            self._all.add(child)
            if self.closed:
                child.close()
            return child

    def give_back(self, child: Child) -> None:
        """Let it have other work."""
        self._idle.append(child)

    def drop(self, child: Child) -> None:
        """Give up one that died."""
        self._all.discard(child)
        child.close()

    def close(self) -> None:
        """End all; what they are at is lost."""
        self.closed = True
        for child in list(self._all):
            child.close()


@cache
def _of_this_process() -> Children:
    """Those of a worker of a cluster, which work comes to."""
    children = Children()
    atexit.register(children.close)
    return children


def perform(work: Work, children: Children | None = None) -> Answer:
    """Make the rows of some work, in child processes.

    The function that every back end runs; it and what it takes and gives can be pickled.

    Args:
        work: what to do.
        children: default: those of this process.

    Raises:
        InputError: the worker's simbench is another.
    """
    if code.packages() != work.code:
        raise InputError(
            f"Expected workers with the sources {work.code} of simbench, got {code.packages()}: "
            "install the same version there."
        )
    children = children or _of_this_process()
    begin, made, todo = perf_counter(), list[Row](), list(work.todo)
    while todo:
        child = children.take()
        try:
            for row in child.rows(replace(work, todo=tuple(todo))):
                made.append(row)
                del todo[0]
            children.give_back(child)
        except Died as death:
            if children.closed:
                raise
            children.drop(child)
            for item in todo[:1]:
                made.append(work.row(item, status=death.status, reason=death.reason))
            del todo[:1]
    return Answer(rows=tuple(made), wall_s=perf_counter() - begin)
