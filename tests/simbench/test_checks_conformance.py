"""The suite as a whole: every name leads to its check, and all of them run on any filter."""

import pytest

from simbench.checks import exact, rest
from simbench.checks.conformance import CHECKS, resolve, run_all
from simbench.errors import InputError
from tests.simbench.checked import with_parts, without_covariance, wrapped
from vislam.filters import EkfSlam, model, slam_fej


@pytest.fixture(autouse=True)
def few_sightings(monkeypatch):
    monkeypatch.setattr(rest, "SIGHTINGS", 20)


@pytest.mark.parametrize("name", CHECKS)
def test_name_leads_to_its_check_and_is_in_its_result(name):
    class Broken:
        def __init__(self, _):
            raise OSError("no such camera")

    result = resolve(name)(Broken, None)
    assert result.name == name
    assert result.failed
    assert "start raised OSError: no such camera" in result.reason


def test_unknown_name_is_one_clear_error():
    with pytest.raises(InputError, match=r"got 'nullspace'\. Did you mean null-space\?"):
        resolve("nullspace")


def test_consistent_filter_passes_every_check():
    results = run_all(slam_fej)
    assert [result.name for result in results] == list(CHECKS)
    assert all(result.passed for result in results), "\n".join(map(str, results))


def test_black_box_that_states_poses_alone_is_judged_by_the_laws():
    results = run_all(wrapped(EkfSlam, belief=without_covariance, innovations=False))
    assert not any(result.failed for result in results), "\n".join(map(str, results))
    assert sum(result.passed for result in results) == 11


def test_audit_is_a_check_that_names_the_first_call():
    def unscaled(noise, motion, dt):
        return model.process_noise(noise, motion, 1.1 * dt)

    assert exact.exact_audit(EkfSlam).passed
    result = exact.exact_audit(with_parts(process_noise=unscaled))
    assert (result.failure, result.reason.split(",")[0]) == (
        "mistake",
        "predict 0: pose covariance",
    )


def test_result_reads_as_a_sentence():
    result = resolve("null-space")(EkfSlam, None)
    assert str(result).startswith("null-space: failed (property of the method): update 2 takes")
