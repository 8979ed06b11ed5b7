"""An audit's many small runs: along a batch axis, against the same filter in a plain loop."""

import time
from dataclasses import astuple

import pytest

from simbench.checks.audit import audit_drive
from simbench.checks.scenes import drive
from vislam.filters import EkfSlam


class OneByOne(EkfSlam):
    """The same filter, which does not say that it takes a batch."""

    batched = False


def test_audit_of_one_filter_on_one_scene(benchmark):
    scene = drive("births")
    start = time.process_time()
    loop = audit_drive(OneByOne, scene)
    loop_s = time.process_time() - start
    together = benchmark.pedantic(audit_drive, (EkfSlam, scene), rounds=5, warmup_rounds=1)
    assert str(together) == str(loop)
    for a, b in zip(together.deviations, loop.deviations, strict=True):
        assert astuple(a) == pytest.approx(astuple(b), abs=1e-8)
    if benchmark.stats is not None:
        benchmark.extra_info["times_faster_than_the_loop"] = loop_s / benchmark.stats.stats.median
