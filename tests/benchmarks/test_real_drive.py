"""How long the real drive takes; run with --benchmark-enable."""

from pathlib import Path

import pytest

from simbench.filters import resolve
from simbench.npz import read_npz
from simbench.run import run

DRIVE = Path(__file__).parents[3] / "shared/data/2022/03.npz"


@pytest.mark.skipif(not DRIVE.is_file(), reason="the real drive is not here")
def test_slam_takes_less_than_a_fifth_of_the_real_drive(benchmark):
    dataset = read_npz(DRIVE)
    record = benchmark.pedantic(run, args=(dataset, resolve("slam")), rounds=3)
    assert len(record.final.ids) > 5000
    if benchmark.enabled:
        assert benchmark.stats["median"] < (dataset.times_s[-1] - dataset.times_s[0]) / 5
