"""Two or more things timed by turns, so that what else a machine does befalls all of them alike."""

import time
from collections.abc import Callable

import numpy as np

from vislam.arrays import Array

#: By how much a measured ratio may pass its limit: a shared machine repeats one to some percent.
MARGIN = 1.1


class Turns:
    """Calls each candidate once a round, for pytest-benchmark to repeat.

    Measured is the processor's time in all threads of this process, which a busy machine changes
    less than that of the clock on the wall.
    """

    def __init__(
        self, clock: Callable[[], float] = time.process_time, **candidates: Callable[[], object]
    ) -> None:
        self._clock, self._candidates = clock, candidates
        self._seconds: dict[str, list[float]] = {name: [] for name in candidates}

    def __call__(self) -> None:
        """One round."""
        for name, candidate in self._candidates.items():
            start = self._clock()
            candidate()
            self._seconds[name].append(self._clock() - start)

    def all_seconds(self, name: str) -> Array:
        """The time of each round."""
        return np.array(self._seconds[name])

    def seconds(self, name: str) -> Array:
        """The time of each round but the first tenth, which warms up."""
        found = self.all_seconds(name)
        return found[len(found) // 10 :]

    def median_ms(self, name: str) -> float:
        """In the median, in milliseconds."""
        return 1e3 * float(np.median(self.seconds(name)))

    def ratio(self, name: str, other: str) -> float:
        """The median over rounds of the ratio of two times of one round."""
        return float(np.median(self.seconds(name) / self.seconds(other)))
