"""The exact audit of one scene, as a check among the others."""

from simbench.checks.audit import TOLERANCE, audit_drive
from simbench.checks.result import MISTAKE, CheckResult, check
from simbench.checks.scenes import drive as scene
from simbench.checks.short_drive import ShortDrive
from simbench.checks.trace import SCENE
from vislam.filters import Factory


@check
def exact_audit(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """The claimed covariance against the second moment of the errors; see `simbench audit`."""
    audited = audit_drive(factory, scene(SCENE) if drive is None else drive)
    deviation = None if audited.first is None else audited.first.deviation
    return CheckResult(
        outcome="passed" if audited.passed else "failed",
        reason=str(audited),
        statistic=deviation,
        limit=TOLERANCE,
        failure=None if audited.passed else MISTAKE,
    )
