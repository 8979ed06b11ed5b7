"""Runs slam over a whole drive, in a process of its own for the sake of its peak memory.

python -m tests.benchmarks.whole_drive SOURCE MEMORY_BYTES prints what it took, as JSON.
"""

import json
import re
import sys
import time
from pathlib import Path

from simbench.run import RunOptions, run
from simbench.source import open_source
from vislam.filters import EkfSlam


class Timed(EkfSlam):
    """Notes when its pass back begins."""

    def finish(self):
        Timed.back_from_s = time.process_time()
        return super().finish()


def resident_bytes(key: str) -> int:
    """VmRSS, what this process has in memory, or VmHWM, the most since the mark was reset."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return 1024 * int(re.search(rf"^{key}:\s+(\d+) kB", status, re.MULTILINE)[1])


def took(source: str, memory_bytes: str) -> dict[str, float]:
    """Seconds of the processor, and how far the memory grew during the run."""
    dataset = open_source(Path(source))
    Path("/proc/self/clear_refs").write_text("5")  # the high-water mark falls to the present
    before, start = resident_bytes("VmRSS"), time.process_time()
    record = run(dataset, Timed, options=RunOptions(memory_bytes=int(memory_bytes)))
    end = time.process_time()
    return {
        "forward_s": Timed.back_from_s - start,
        "backward_s": end - Timed.back_from_s,
        "wall_s": record.wall_s,
        "drive_s": float(dataset.times_s[-1] - dataset.times_s[0]),
        "landmarks": len(record.final.ids),
        "grown_bytes": resident_bytes("VmHWM") - before,
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(took(*sys.argv[1:])))
