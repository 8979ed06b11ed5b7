"""Runs a filter over a whole drive, in a process of its own for the sake of its peak memory.

python -m tests.benchmarks.whole_drive SOURCE FILTER MEMORY_BYTES prints what it took, as JSON.
"""

import json
import re
import sys
import time
from pathlib import Path

from simbench.filters import resolve
from simbench.run import RunOptions, run
from simbench.source import open_source


def resident_bytes(key: str) -> int:
    """VmRSS, what this process has in memory, or VmHWM, the most since the mark was reset."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return 1024 * int(re.search(rf"^{key}:\s+(\d+) kB", status, re.MULTILINE)[1])


def took(source: str, name: str, memory_bytes: str) -> dict[str, float]:
    """Seconds of the processor, and how far the memory grew during the run."""
    dataset, factory = open_source(Path(source)), resolve(name)
    options = RunOptions(memory_bytes=int(memory_bytes))
    Path("/proc/self/clear_refs").write_text("5")  # the high-water mark falls to the present
    before, marks = resident_bytes("VmRSS"), [time.process_time()]
    record = run(dataset, factory, options=options, on_step=lambda _: mark(marks))
    mark(marks)
    start, *_, last_frame, end = marks
    return {
        "forward_s": last_frame - start,
        "backward_s": end - last_frame,
        "wall_s": record.wall_s,
        "drive_s": float(dataset.times_s[-1] - dataset.times_s[0]),
        "landmarks": len(record.final.ids),
        "grown_bytes": resident_bytes("VmHWM") - before,
    }


def mark(marks: list[float]) -> None:
    """Note the time of the processor."""
    marks.append(time.process_time())


if __name__ == "__main__":
    sys.stdout.write(json.dumps(took(*sys.argv[1:])))
