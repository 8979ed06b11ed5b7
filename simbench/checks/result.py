"""What a check says of a filter."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from typing import Literal, TypeAlias

from simbench.checks.short_drive import ShortDrive
from simbench.errors import FilterFailure
from vislam.filters import Factory

MISTAKE: Literal["mistake"] = "mistake"
PROPERTY: Literal["property of the method"] = "property of the method"
FailureKind: TypeAlias = Literal["mistake", "property of the method"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """The result of one check.

    Attributes:
        outcome: "skipped" where the check does not apply to the filter.
        statistic: what was measured; None where nothing was.
        limit: what it may be at the most, in size.
        reason: why, in words.
        failure: what a failure is, a mistake in the code or a property of a method that is coded
            rightly; None where it did not fail.
        name: of the check.
    """

    outcome: Literal["passed", "failed", "skipped"]
    reason: str
    statistic: float | None = None
    limit: float | None = None
    failure: FailureKind | None = None
    name: str = ""

    @property
    def passed(self) -> bool:
        """Whether the check ran and found nothing."""
        return self.outcome == "passed"

    @property
    def failed(self) -> bool:
        """Whether the check found something; a skipped one neither passed nor failed."""
        return self.outcome == "failed"

    def __str__(self) -> str:
        kind = f" ({self.failure})" if self.failure else ""
        return f"{self.name}: {self.outcome}{kind}: {self.reason}"


#: A check: of a filter's factory, on a short drive or the check's own scene.
Check: TypeAlias = Callable[[Factory, ShortDrive | None], CheckResult]


class NotApplicable(Exception):
    """Raised inside a check that has nothing to say of a filter; the message is the reason."""


def judged(
    statistic: float,
    limit: float,
    *,
    good: str,
    bad: str,
    failure: Callable[[], FailureKind] = lambda: MISTAKE,
) -> CheckResult:
    """Passed where the statistic is within the limit; failed beyond it, or where it is NaN.

    What a failure is may take another run of the filter, so it is asked for only then.
    """
    passed = statistic <= limit
    return CheckResult(
        outcome="passed" if passed else "failed",
        statistic=statistic,
        limit=limit,
        reason=good if passed else bad,
        failure=None if passed else failure(),
    )


def check(function: Check) -> Check:
    """Give a check its name, and a result where the filter raises or the check does not apply."""

    @wraps(function)
    def checked(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
        try:
            result = function(factory, drive)
        except NotApplicable as why:
            result = CheckResult(outcome="skipped", reason=str(why))
        except FilterFailure as failure:
            result = CheckResult(outcome="failed", reason=str(failure), failure=MISTAKE)
        return replace(result, name=function.__name__.replace("_", "-"))

    return checked
