"""Drives of real size: how many times faster than real time, and within which memory."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.turns import MARGIN
from vislam.types import MEMORY_BYTES

ROOT = Path(__file__).parents[2]
REAL = ROOT.parent / "shared/data/2022/03.npz"
SMALL_BYTES = 20_000_000
#: What the run keeps besides, of its results and of numpy's own.
BESIDES_BYTES = 10_000_000

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="no Linux"),
]


def took(source, name, memory_bytes):
    """What `tests.benchmarks.whole_drive` says."""
    command = [sys.executable, "-m", "tests.benchmarks.whole_drive"]
    command += [str(source), name, str(memory_bytes)]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return json.loads(said.stdout)


@pytest.mark.parametrize(
    ("source", "landmarks", "times_faster"),
    [
        pytest.param(
            REAL, 5000, 50, marks=pytest.mark.skipif(not REAL.is_file(), reason="it is not here")
        ),
        (ROOT / "scenarios/drive_large.yaml", 13_000, 20),
    ],
    ids=["03.npz", "drive_large"],
)
def test_a_whole_drive_is_many_times_faster_than_real_time(
    benchmark, report, source, landmarks, times_faster
):
    usual = benchmark.pedantic(took, (source, "slam", MEMORY_BYTES))
    small, none = took(source, "slam", SMALL_BYTES), took(source, "slam", 0)
    found = {
        "slam, memory 1 GB": usual,
        "slam, memory 20 MB": small,
        "slam, no pass back": none,
        "mapping": took(source, "mapping", MEMORY_BYTES),
        "dead-reckoning": took(source, "dead-reckoning", MEMORY_BYTES),
    }
    heads = (source.name, "forward", "backward", "total", "by the wall's clock", "grown MB")
    rows = [(named, *faster(each), each["grown_bytes"] / 1e6) for named, each in found.items()]
    report(f"{source.name}, times faster than real time, and memory", heads, rows)
    assert usual["landmarks"] == small["landmarks"] > landmarks > none["landmarks"]
    assert small["grown_bytes"] < none["grown_bytes"] + SMALL_BYTES + BESIDES_BYTES
    if benchmark.enabled:
        _, _, total, _ = faster(usual)
        assert total > times_faster / MARGIN


def faster(found):
    """Forward, backward, both, and both by the clock on the wall."""
    forward, backward = found["forward_s"], found["backward_s"]
    seconds = forward, backward, forward + backward, found["wall_s"]
    return tuple(found["drive_s"] / s if s > 1e-2 else float("inf") for s in seconds)
