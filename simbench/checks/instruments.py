"""One verdict from all instruments: is the code right, and does the method hold in this scene?

The audit and the laws of `simbench.checks.conformance` have no chance in them; what the Monte Carlo
says is judged by `simbench.checks.chance`.
"""

from collections.abc import Sequence

import numpy as np

from simbench.checks.audit import audit, audit_drive
from simbench.checks.chance import judge
from simbench.checks.conformance import CHECKS
from simbench.checks.conformance import resolve as resolve_check
from simbench.checks.defaults import FALSE_ALARM, RUNS
from simbench.checks.findings import AuditResult, SceneAudit
from simbench.checks.montecarlo import monte_carlo
from simbench.checks.result import MISTAKE, CheckResult
from simbench.checks.short_drive import ShortDrive
from simbench.checks.verdict import Check, Verdict, finite
from simbench.errors import InputError
from simbench.filters import resolve
from simbench.scenario import Scenario
from simbench.sensors import simulate
from vislam.filters import Factory

#: Of noise, in the leading frames of a scene that are audited.
MOST_SCALARS = 256
AUDIT, HERE = "exact-audit", "exact-audit of this scene"


def check(
    scenario: Scenario,
    factory: Factory | str,
    *,
    runs: int = RUNS,
    false_alarm: float = FALSE_ALARM,
    seed: int | None = None,
    jobs: int = -1,
) -> Verdict:
    """Judge a filter in a scene by all instruments.

    Args:
        scenario: the scene.
        factory: makes the filter, or its name.
        runs: independent runs of the scene.
        false_alarm: of the whole verdict.
        seed: instead of the scene's own.
        jobs: processes; see `monte_carlo`.
    """
    made = resolve(factory) if isinstance(factory, str) else factory
    audits = audit(made)
    laws = [resolve_check(name)(made, None) for name in CHECKS if name != AUDIT]
    here = _audit_here(scenario, made, seed)
    summaries = monte_carlo(scenario, factory, range(runs), seed=seed, jobs=jobs)
    chance = judge(
        summaries,
        false_alarm,
        gate=scenario.filter.gate_probability,
        outliers=scenario.camera.outliers.share > 0,
    )
    skipped = {law.name: law.reason for law in laws if law.outcome == "skipped"}
    exact = [_audited(AUDIT, audits)]
    if isinstance(here, SceneAudit):
        exact.append(_audited(HERE, AuditResult(scenes=(here,))))
    else:
        skipped[HERE] = here
    exact += [_law(law) for law in laws if law.outcome != "skipped"]
    return Verdict(
        checks=(*exact, *chance.checks),
        skipped=skipped | dict(chance.skipped),
        figures=chance.figures,
        runs=runs,
        false_alarm=false_alarm,
        conclusion=_conclusion(exact, here, chance, untold(scenario)),
        look_at=chance.look_at,
    )


def _audit_here(scenario: Scenario, factory: Factory, seed: int | None) -> SceneAudit | str:
    """The audit of the scene's leading frames, or why there is none."""
    try:
        drive = ShortDrive.of(simulate(scenario, seed), MOST_SCALARS)
    except InputError as error:
        return str(error)
    return audit_drive(factory, drive)


def _audited(name: str, audits: AuditResult) -> Check:
    """The worst deviation, at the smaller eps, and the first that does not vanish."""
    deviations = [scene.deviations[-1].block for scene in audits.scenes if scene.deviations]
    return Check(
        name=name,
        passed=audits.passed,
        statistic=finite(max(deviations, default=np.inf)),
        reason="" if audits.first is None else f"first at {audits.first}",
    )


def _law(law: CheckResult) -> Check:
    """A property of a method that is coded rightly is told, and does not fail a filter."""
    return Check(
        name=law.name,
        passed=law.failure != MISTAKE,
        statistic=None if law.statistic is None else finite(law.statistic),
        high=law.limit,
        reason=f"{law.failure}: {law.reason}" if law.failed else "",
    )


def untold(scenario: Scenario) -> tuple[str, ...]:
    """The keys of a scene by which a filter is told something else than the truth."""
    found = [
        f"told.{name}"
        for name, field in type(scenario.told).model_fields.items()
        if getattr(scenario.told, name) != field.default
    ]
    for name in ("velocity", "angular_velocity"):
        section = getattr(scenario.imu, name)
        found += [
            f"imu.{name}.{key}"
            for key in ("bias_sigma", "bias_walk")
            if np.any(getattr(section, key))
        ]
    if scenario.imu.twist != "mean":
        found.append("imu.twist")
    if scenario.camera.outliers.share:
        found.append("camera.outliers")
    return tuple(found)


def _conclusion(
    exact: Sequence[Check], here: SceneAudit | str, chance: Verdict, lies: Sequence[str]
) -> str:
    """What the instruments say together."""
    mistakes = [f"{check.name}: {check.reason}" for check in exact if not check.passed]
    if mistakes:
        return f"A mistake in the code. {mistakes[0]}."
    if chance.figures["failed"]:
        return "The filter raises at this scene's noise; the audit's small noise does not reach it."
    properties = [f"{check.name}: {check.reason}" for check in exact if check.reason]
    if chance.passed:
        conclusion = "No mistake was found, and the covariance holds in this scene."
        if properties:
            conclusion += f" But {properties[0]}."
        return conclusion
    if lies:
        return (
            "Correct code in a scene that does not tell it the truth "
            f"({', '.join(lies)}): no filter is consistent there."
        )
    conclusion = (
        "Correct code, inconsistent method in this scene: what is linear in the noise is right, as "
        "the audit passed, but the covariance does not hold at the scene's noise."
    )
    if properties:
        conclusion += f" {properties[0]}."
    noise = here.noise_at_ten_percent if isinstance(here, SceneAudit) else None
    if noise is not None and noise < 1:
        conclusion += (
            " The scene lies outside the linear regime of this filter: in its leading frames "
            f"{noise:.2g} of its noise makes an element of the covariance wrong by 10 %."
        )
    return conclusion
