"""One update, against the BLAS calls that no exact update can do without."""

import time

import numpy as np
import pytest
from scipy.linalg.blas import dsyrk, dtrsm
from threadpoolctl import threadpool_limits

from tests.benchmarks.scenes import STILL, frame, task
from tests.benchmarks.turns import MARGIN, Turns
from vislam.filters import EkfSlam

LIMITS = {50: 2.5, 100: 2.0, 150: 1.6}
SIZES = [25, *LIMITS, 300]


def sighted(landmarks):
    """An update of a filter whose state is the pose and the landmarks that it sees."""
    filter_ = EkfSlam(task())
    filter_.update(frame(landmarks))
    filter_.predict(STILL, 0.1)
    again = frame(landmarks, 0.1)

    def update():
        innovation = filter_.update(again)
        assert len(innovation.ids) == len(filter_.ids) == landmarks

    return update


def bare(landmarks):
    """The triangular solve and the symmetric product of that update, in place."""
    rows, n = 3 * landmarks, 6 + 3 * landmarks
    rng = np.random.default_rng(0)
    # near the identity: however often it is solved by, no number grows or vanishes
    L = np.asfortranarray(np.eye(rows) + np.tril(1e-6 * rng.random((rows, rows)), -1))
    HP = np.asfortranarray(rng.random((rows, n)))
    P = np.asfortranarray(np.eye(n))

    def calls():
        dtrsm(1.0, L, HP, lower=1, overwrite_b=1)
        dsyrk(-1.0, HP, beta=1.0, c=P, trans=1, overwrite_c=1)

    before = HP.copy(), P.copy()
    calls()
    assert not any(np.array_equal(a, b) for a, b in zip(before, (HP, P), strict=True))
    return calls


@pytest.mark.parametrize("landmarks", SIZES)
def test_an_update_against_the_bare_calls_it_needs(benchmark, report, landmarks):
    turns = Turns(update=sighted(landmarks), bare=bare(landmarks))
    with threadpool_limits(1, "blas"):
        benchmark.pedantic(turns, rounds=max(40, 15_000 // landmarks))
    ratio, ms = turns.ratio("update", "bare"), turns.median_ms("update")
    limit = LIMITS.get(landmarks)
    row = landmarks, 6 + 3 * landmarks, ms, 1e3 / ms, turns.median_ms("bare"), ratio, limit or "-"
    heads = ("sightings", "rows", "ms", "updates/s", "BLAS alone ms", "times", "at most")
    report("An update against the BLAS calls it needs, one thread", heads, [row])
    if benchmark.enabled and limit is not None:
        assert ratio < MARGIN * limit


@pytest.mark.slow
def test_threads_by_measurement(benchmark, report):
    """Why `run` limits BLAS to one thread: the time on the wall with one and with two."""
    rows = []
    turns = {
        landmarks: Turns(
            time.perf_counter,
            one=limited(1, sighted(landmarks)),
            two=limited(2, sighted(landmarks)),
        )
        for landmarks in (25, 50, 100, 200)
    }
    benchmark.pedantic(lambda: [each() for each in turns.values()], rounds=7)
    for landmarks, each in turns.items():
        one, two = each.median_ms("one"), each.median_ms("two")
        slowest = [1e3 * each.seconds(name).max() for name in ("one", "two")]
        rows.append((landmarks, one, two, each.ratio("one", "two"), *slowest))
    heads = ("sightings", "1 thread ms", "2 threads ms", "gain", "worst of 1", "worst of 2")
    report("An update with one and two BLAS threads, time on the wall", heads, rows)


def limited(threads, function):
    """The function with so many BLAS threads."""

    def call():
        with threadpool_limits(threads, "blas"):
            function()

    return call
