"""Consistent filters keep their NEES in its band where the paper's does not."""

import pytest

from tests.tables.consistency import CASES, band, measured

#: Filters that carry no information along the motions of the world.
CONSISTENT = ["slam-transport", "slam-invariant"]


@pytest.mark.slow
@pytest.mark.parametrize("key", ["laps1", "laps5"])
def test_over_two_laps_the_papers_filter_is_off_and_consistent_ones_are_not(key):
    """50 runs; two-sided, at most 1e-3 of false alarm for each filter."""
    case = CASES[key]
    low, high = band(case.runs)
    found = {name: measured(case, name, case.runs) for name in ["slam", *CONSISTENT]}
    for name in CONSISTENT:
        assert low < found[name].nees < high
        assert found[name].position_m < found["slam"].position_m
    assert found["slam"].nees > 2


@pytest.mark.slow
@pytest.mark.parametrize("key", ["zhang1", "zhang5"])
def test_in_zhangs_table_consistent_filters_lie_in_the_band(key):
    """100 runs; two-sided, at most 1e-3 of false alarm for each filter."""
    case = CASES[key]
    low, high = band(case.runs)
    for name in CONSISTENT:
        assert low < measured(case, name, case.runs).nees < high


def test_a_run_of_two_laps_is_measured():
    row = measured(CASES["laps1"], "slam-transport", runs=1, jobs=1)
    assert 0.1 < row.nees < 4
    assert 0.9 < row.nis < 1.1
    assert row.position_m < 1
