"""One verdict from all instruments: is the code right, and does the method hold in this scene?

Every statistic of the Monte Carlo has a known null distribution (`simbench.checks.nulls`) and is
judged from both sides, but for the Ljung-Box statistic, which only grows where innovations are not
white. P-values are corrected by Holm's method, so that a right filter fails anywhere in the table
with the stated probability at the most. The audit and the laws of
`simbench.checks.conformance` have no chance in them.

Source: Holm, A simple sequentially rejective multiple test procedure, Scand. J. Statist. 6, 1979.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from simbench.checks.audit import audit, audit_drive
from simbench.checks.conformance import CHECKS
from simbench.checks.conformance import resolve as resolve_check
from simbench.checks.defaults import FALSE_ALARM, RUNS
from simbench.checks.findings import AuditResult, SceneAudit
from simbench.checks.montecarlo import RunSummary, monte_carlo
from simbench.checks.nulls import Kind, Statistic, statistics
from simbench.checks.result import MISTAKE, CheckResult
from simbench.checks.short_drive import ShortDrive
from simbench.errors import InputError
from simbench.filters import resolve
from simbench.scenario import Scenario
from simbench.sensors import simulate
from vislam.arrays import Array
from vislam.filters import Factory

#: Of noise, in the leading frames of a scene that are audited.
MOST_SCALARS = 256
AUDIT, HERE = "exact-audit", "exact-audit of this scene"


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One line of a verdict.

    Attributes:
        name: what was checked.
        passed: whether it holds.
        statistic: None where it is infinite, or where there is none.
        low, high: where a right filter's statistic lies, in all checks at once but for the
            false-alarm rate; as Holm's correction has it.
        p: after the correction; None where no chance is involved.
        reason: what a failure of this kind usually means; of a check that passed, a property of the
            method that it found, or empty.
    """

    name: str
    passed: bool
    statistic: float | None = None
    low: float | None = None
    high: float | None = None
    p: float | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What is held of a filter in a scene.

    Attributes:
        checks: the lines.
        skipped: checks that could not be made, and why.
        figures: of accuracy, not judged: by name the median over the runs; `diverged` and `failed`
            are shares of them.
        runs: how many.
        false_alarm: the probability that a right filter fails.
        conclusion: what the checks mean together.
        look_at: the run that shows most: one that raised, else the one whose pose at the end is the
            furthest out of its covariance; None where no run tells.
    """

    checks: tuple[Check, ...]
    skipped: Mapping[str, str]
    figures: Mapping[str, float | None]
    runs: int
    false_alarm: float
    conclusion: str = ""
    look_at: int | None = None

    @property
    def passed(self) -> bool:
        """Whether every check did."""
        return all(check.passed for check in self.checks)

    def as_json(self) -> dict[str, Any]:
        """JSON-safe."""
        return {
            "passed": self.passed,
            "conclusion": self.conclusion,
            "checks": [asdict(check) for check in self.checks],
            "skipped": dict(self.skipped),
            "figures": dict(self.figures),
            "runs": self.runs,
            "false_alarm": self.false_alarm,
            "look_at": self.look_at,
        }

    def lines(self) -> Iterator[str]:
        """The verdict as a table, what failures mean, and the conclusion."""
        width = max(len(check.name) for check in self.checks)
        yield f"{'':4}  {'check':{width}}  {'statistic':>9}  {'low':>9}  {'high':>9}  {'p':>7}"
        for check in self.checks:
            numbers = (check.statistic, check.low, check.high)
            cells = "  ".join(f"{_cell(number):>9}" for number in numbers)
            mark = "FAIL" if not check.passed else "note" if check.reason else "ok"
            p = "-" if check.p is None else f"{check.p:.2g}"
            yield f"{mark:4}  {check.name:{width}}  {cells}  {p:>7}"
        for name, why in self.skipped.items():
            yield f"{'skip':4}  {name}: {why}"
        reasons: dict[str, list[str]] = {}
        for check in self.checks:
            if check.reason:
                reasons.setdefault(check.reason, []).append(check.name)
        for reason, names in reasons.items():
            yield f"{'; '.join(names)}: {reason}"
        yield "  ".join(f"{name} {_cell(value)}" for name, value in self.figures.items())
        yield (
            f"{self.runs} runs; a right filter fails in {100 * self.false_alarm:g} % of such "
            "verdicts at the most."
        )
        yield self.conclusion


def _cell(number: float | None) -> str:
    return "-" if number is None else f"{number:.4g}"


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
        statistic=_finite(max(deviations, default=np.inf)),
        reason="" if audits.first is None else f"first at {audits.first}",
    )


def _law(law: CheckResult) -> Check:
    """A property of a method that is coded rightly is told, and does not fail a filter."""
    return Check(
        name=law.name,
        passed=law.failure != MISTAKE,
        statistic=None if law.statistic is None else _finite(law.statistic),
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


def judge(
    summaries: Sequence[RunSummary],
    false_alarm: float = FALSE_ALARM,
    *,
    gate: float | None = None,
    outliers: bool = False,
) -> Verdict:
    """The verdict by chance alone.

    Args:
        summaries: of independent runs.
        false_alarm: the probability that a right filter fails.
        gate: the probability that the filter's gate was told.
        outliers: whether some sightings are wrong, so that nobody knows how many to reject.
    """
    if not 0 < false_alarm < 1:
        raise InputError(f"Expected a false-alarm rate between 0 and 1, got {false_alarm}.")
    if not summaries:
        raise InputError("Expected at least one run to judge, got none.")
    failures = [s for s in summaries if s.failure is not None]
    whole = [s for s in summaries if s.failure is None]
    tests, skipped = [], {}
    for name, found in statistics(whole, gate, outliers):
        if isinstance(found, str):
            skipped[name] = found
        else:
            tests.append(found)
    completed = Check(
        name="runs that raised",
        passed=not failures,
        statistic=float(len(failures)),
        low=0.0,
        high=0.0,
        reason=f"run {failures[0].run}: {failures[0].failure}" if failures else "",
    )
    return Verdict(
        checks=(completed, *_corrected(tests, false_alarm)),
        skipped=skipped,
        figures=_medians(whole) | {"failed": len(failures) / len(summaries)},
        runs=len(summaries),
        false_alarm=false_alarm,
        look_at=_look_at(summaries),
    )


def _look_at(summaries: Sequence[RunSummary]) -> int | None:
    """The run that shows most."""
    furthest = {
        s.run: np.inf if s.pose is None else float(s.pose.value[-1])
        for s in summaries
        if s.failure is not None or s.pose is not None
    }
    return max(furthest, key=furthest.__getitem__, default=None)


def _corrected(tests: Sequence[Statistic], false_alarm: float) -> list[Check]:
    """Holm's correction: the smallest p against rate / m, the next against rate / (m - 1), ..."""
    m = len(tests)
    order = sorted(range(m), key=lambda k: tests[k].p)
    factor = np.arange(m, 0, -1)
    ps = np.minimum(1, np.maximum.accumulate(factor * [tests[k].p for k in order]))
    corrected = dict(zip(order, ps.tolist(), strict=True))
    failed = int(np.count_nonzero(ps <= false_alarm))
    level = false_alarm / max(m - failed, 1)  # the band at which exactly these fail
    kinds = {tests[k].kind for k in order[:failed]}
    checks = []
    for k, test in enumerate(tests):
        low, high = test.band(level)
        passed = corrected[k] > false_alarm
        checks.append(
            Check(
                name=test.name,
                passed=passed,
                statistic=_finite(test.value),
                low=float(low),
                high=float(high),
                p=corrected[k],
                reason="" if passed else _reason(test.kind, test.value > low, kinds),
            )
        )
    return checks


def _reason(kind: Kind, high: bool, failed: set[Kind]) -> str:
    """What a failure usually means, in the light of the others."""
    states: set[Kind] = {"pose", "map", "newborn", "landmark"}
    match kind:
        case "dt":
            return "process noise that does not grow with the interval as the scene's does."
        case "whiteness":
            return (
                "innovations follow from earlier ones: a reading used at another time, a wrong dt, "
                "a measurement fused twice, or process noise scaled wrongly."
            )
        case "gate":
            word = "more" if high else "less"
            return f"the gate refuses {word} than it was told: wrong degrees of freedom or units."
        case "nis" if not states & failed:
            return (
                f"innovations are too {'large' if high else 'small'} for their covariance, the "
                "errors are not: the pixel noise is told or used wrongly (sigma for its square, "
                "added twice)."
            )
        case "nis":
            return (
                f"innovations are too {'large' if high else 'small'} for their covariance, and the "
                "errors do not fit theirs: a wrong motion model, Jacobian or noise, or readings "
                "used at another time."
            )
        case "newborn":
            return (
                "a landmark is born with a wrong covariance: without the pose's uncertainty, or "
                "its first sighting fused again."
                if high
                else "a landmark is born less sure than it is: a prior instead of its sighting."
            )
    if not high:
        return "less sure than it should be: noise added twice, or a covariance not stored."
    if "nis" in failed:
        return "too sure, and so are its predictions: noise left out, or a wrong Jacobian."
    return (
        "too sure, though its predictions fit: covariance lost at birth or in the cross terms, or "
        "a method that gains information where nothing can be observed."
    )


def _medians(runs: Sequence[RunSummary]) -> dict[str, float | None]:
    names = runs[0].figures if runs else ()
    found = {name: _known([run.figures[name] for run in runs]) for name in names}
    figures = {name: float(np.median(v)) if v.size else None for name, v in found.items()}
    diverged = found.get("diverged")
    if diverged is not None and diverged.size:
        figures["diverged"] = float(diverged.mean())
    return figures


def _known(values: Sequence[float | None]) -> Array:
    return np.array([value for value in values if value is not None])


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
