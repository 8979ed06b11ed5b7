import pytest

from simbench.checks import conformance
from simbench.checks.scenes import SCENES

pytest_plugins = ["pytester"]

for name in conformance.CHECKS:  # imported here: pytester forgets what its runs import
    conformance.resolve(name)

#: The suite: each check, and the audit once for each scene.
ITEMS = len(conformance.CHECKS) - 1 + len(SCENES)

OVERCONFIDENT = """
from vislam.filters import DeadReckoning

class Overconfident(DeadReckoning):
    def predict(self, motion, dt):
        P = self.P
        super().predict(motion, dt)
        self.P = P
"""


@pytest.fixture
def run(pytester):
    pytester.makepyfile(overconfident_filter=OVERCONFIDENT)

    def with_plugin(*arguments):
        plugins = ("-p", "simbench.pytest_plugin", "-p", "no:cacheprovider")
        return pytester.runpytest_inprocess(*plugins, *arguments)

    return with_plugin


def test_each_check_of_a_right_filter_is_a_test_and_the_summary_counts_them(run):
    result = run("--simbench-filter", "dead-reckoning", "-v")
    outcomes = result.parseoutcomes()
    assert outcomes["passed"] > 4
    assert sum(outcomes.values()) == ITEMS
    assert result.ret == pytest.ExitCode.OK
    result.stdout.fnmatch_lines(
        [
            "simbench::dead-reckoning::exact-audit?births? PASSED*",
            "simbench::dead-reckoning::run-twice PASSED*",
            f"dead-reckoning: * checks ran: {outcomes['passed']} passed, 0 failed, *do not apply",
        ]
    )


def test_failed_check_says_where_the_mistake_is(run):
    name = "overconfident_filter:Overconfident"
    result = run("--simbench-filter", name, "-k", "exact-audit")
    result.assert_outcomes(failed=len(SCENES), deselected=ITEMS - len(SCENES))
    assert result.ret == pytest.ExitCode.TESTS_FAILED
    result.stdout.fnmatch_lines(
        [
            f"*simbench::{name}::exact-audit?births?*",
            "predict 0: pose covariance, claimed *, true *",
            f"{name}: {len(SCENES)} checks ran: 0 passed, {len(SCENES)} failed, *",
        ]
    )


def test_property_of_the_method_is_an_expected_failure(run):
    result = run("--simbench-filter", "slam", "-k", "null-space")
    result.assert_outcomes(xfailed=1, deselected=ITEMS - 1)
    result.stdout.fnmatch_lines(["slam: 1 checks ran: 0 passed, 0 failed, 1 failed as a property*"])


def test_filters_can_be_named_in_the_ini_file_and_each_is_taken_once(run, pytester):
    pytester.makeini("[pytest]\nsimbench_filters =\n    slam\n    slam-fej\n")
    result = run("--simbench-filter", "slam", "-k", "run-twice")
    result.assert_outcomes(passed=2, deselected=2 * ITEMS - 2)


def test_suite_runs_beside_the_users_own_tests(run, pytester):
    pytester.makepyfile("def test_own(): pass")
    result = run("--simbench-filter", "slam", "-k", "test_own or run-twice")
    result.assert_outcomes(passed=2, deselected=ITEMS - 1)


def test_without_a_filter_nothing_changes(run, pytester):
    pytester.makepyfile("def test_own(): pass")
    result = run()
    result.assert_outcomes(passed=1)
    result.stdout.no_fnmatch_line("*checks ran*")


def test_unknown_filter_is_wrong_usage(run):
    result = run("--simbench-filter", "slamm")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*slamm: expected a filter's name*Did you mean slam?*"])
