"""What is held of a filter in a scene: lines of checks, figures, and a conclusion."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np


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


def finite(value: float) -> float | None:
    """The number as JSON can say it: None where it is infinite or NaN."""
    return float(value) if np.isfinite(value) else None
