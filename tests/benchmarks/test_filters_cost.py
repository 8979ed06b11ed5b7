"""What every other filter costs, as a multiple of slam, whole map included."""

from pathlib import Path

import pytest

from simbench.filters import resolve
from simbench.run import run
from simbench.scenario import load
from simbench.sensors import simulate
from tests.benchmarks.turns import MARGIN, Turns

DRIVE = Path(__file__).parents[2] / "scenarios" / "drive.yaml"
FILTERS = (
    "slam",
    "slam-transport",
    "slam-fej",
    "slam-invariant",
    "slam-inverse-depth",
    "slam-iterated",
    "mapping",
    "dead-reckoning",
)
#: A consistent filter shall not cost much more than the inconsistent one.
LIMIT = 1.3
CONSISTENT = ("slam-transport", "slam-fej", "slam-invariant", "slam-inverse-depth")


def over(dataset, name):
    """A run, to be timed."""
    factory = resolve(name)
    return lambda: run(dataset, factory, name=name)


@pytest.mark.slow
def test_each_filter_against_slam(benchmark, report):
    dataset = simulate(load(DRIVE, ["duration_s=41.7", "landmarks.count=2000"]))
    turns = Turns(**{name: over(dataset, name) for name in FILTERS})
    benchmark.pedantic(turns, rounds=7)
    ratios = {name: turns.ratio(name, "slam") for name in FILTERS}
    rows = [(name, turns.median_ms(name) / len(dataset), ratios[name]) for name in FILTERS]
    report("Every filter on 400 frames of the drive", ("", "ms a frame", "times slam"), rows)
    if benchmark.enabled:
        assert {name: ratios[name] for name in CONSISTENT if ratios[name] > MARGIN * LIMIT} == {}
