"""The exact audit of one scene, as a check among the others."""

from simbench.checks.audit import TOLERANCE, audit_drive
from simbench.checks.result import MISTAKE, CheckResult, NotApplicable, check
from simbench.checks.scenes import drive as scene
from simbench.checks.short_drive import ShortDrive
from simbench.checks.trace import SCENE, Feed, covariances, trace
from vislam.filters import Factory


@check
def exact_audit(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """The claimed covariance against the second moment of the errors; see `simbench audit`."""
    drive = scene(SCENE) if drive is None else drive
    calls = trace(factory, Feed.of(drive, noise=0.0))
    if not any(covariances(call.belief) for call in calls):
        raise NotApplicable("the filter states no covariance")
    audited = audit_drive(factory, drive)
    return CheckResult(
        outcome="passed" if audited.passed else "failed",
        reason=str(audited),
        statistic=None if audited.first is None else audited.first.deviation,
        limit=TOLERANCE,
        failure=None if audited.passed else MISTAKE,
    )
