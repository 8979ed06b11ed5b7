"""Streams by name: equal ones are equal, others are independent, and no order of calls matters."""

import numpy as np
import pytest

from simbench.rng import stream


def test_equal_names_give_equal_numbers_whatever_was_drawn_before():
    first = stream(7, 0, "camera.noise", 3).standard_normal(5)
    stream(7, 0, "camera.noise", 2).standard_normal(1000)
    np.testing.assert_array_equal(stream(7, 0, "camera.noise", 3).standard_normal(5), first)


def test_numbers_are_the_same_on_every_machine():
    drawn = stream(7, 0, "camera.noise", 3).integers(0, 2**32, 3).tolist()
    assert drawn == [2752541871, 4118594769, 1047519959]


@pytest.mark.parametrize(
    "other", [(8, 0, "a", 1), (7, 1, "a", 1), (7, 0, "b", 1), (7, 0, "a", 2), (7, 0, "a")]
)
def test_another_seed_run_name_or_number_is_another_stream(other):
    assert stream(7, 0, "a", 1).random() != stream(*other).random()


def test_numbers_in_names_do_not_run_together():
    assert stream(1, 11, "a").random() != stream(11, 1, "a").random()
    assert stream(1, 1, "a", 11).random() != stream(1, 1, "a1", 1).random()


def test_streams_are_uncorrelated():
    """4950 pairs of 100 streams, n = 1000 each: two-sided, 1 false alarm in 1000 by Bonferroni."""
    from scipy.stats import norm

    z = np.stack([stream(0, 0, "a", i).standard_normal(1000) for i in range(100)])
    r = np.corrcoef(z)[np.triu_indices(100, 1)]
    assert np.abs(np.arctanh(r)).max() * np.sqrt(997) < norm.isf(1e-3 / 2 / len(r))


def test_rows_are_a_prefix_of_longer_draws():
    """The simulator draws a row a landmark: the last one must be removable."""
    for method in ("standard_normal", "random"):
        few = getattr(stream(0, 0, "a"), method)((50, 4))
        many = getattr(stream(0, 0, "a"), method)((80, 4))
        np.testing.assert_array_equal(many[:50], few)
