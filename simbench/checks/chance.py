"""What independent runs say of a filter, where right ones differ by chance alone.

Every statistic of the Monte Carlo has a known null distribution (`simbench.checks.nulls`) and is
judged from both sides, but for the Ljung-Box statistic, which only grows where innovations are not
white. P-values are corrected by Holm's method, so that a right filter fails anywhere in the table
with the stated probability at the most.

Source: Holm, A simple sequentially rejective multiple test procedure, Scand. J. Statist. 6, 1979.
"""

from collections.abc import Sequence

import numpy as np

from simbench.checks.defaults import FALSE_ALARM
from simbench.checks.montecarlo import RunSummary
from simbench.checks.nulls import Kind, Statistic, statistics
from simbench.checks.verdict import Check, Verdict, finite
from simbench.errors import InputError
from vislam.arrays import Array


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
                statistic=finite(test.value),
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
