"""Which check catches which bug, measured.

A check catches a bug where it finds something that it does not find in the bug's own base: that the
standard filter leaks information along its null space is no merit of a bug.

A column is a name of `CHECKS`. Those of `COLUMNS` hold without chance, or with a false alarm so
rare that one run of the check tells. Those of `simbench.bugs.power` need many runs, and catch a bug
where so many fail it reliably; beside them is what the bug does to accuracy.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from simbench.bugs import BUGS, power
from simbench.bugs.power import Ratio, Share
from simbench.checks.conformance import resolve as resolve_check
from simbench.checks.montecarlo import RunSummary
from simbench.checks.result import CheckResult
from simbench.filters import resolve

#: The checks of `simbench.checks.conformance` that make up a column.
COLUMNS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "audit": ("exact-audit",),
        "jacobian": ("jacobians",),
        "retraction": ("keep-the-known-map", "move-by-the-correction"),
        "null-space": ("null-space",),
        "masking": (
            "ignore-an-empty-frame",
            "ignore-a-half-missing-feature",
            "ignore-what-a-mask-hides",
        ),
        "covariance-laws": ("state-covariances", "find-the-place"),
        "gate-rate": ("refuse-as-often-as-told",),
    }
)


#: Caught by chance means: at least this share of groups of 20 runs fail.
RELIABLE = 0.8
#: Runs of each filter, unless more are asked for.
RUNS = 400


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """What a column says of a bug.

    Attributes:
        caught: whether it catches the bug; never said by the ATE, which judges nothing.
        statistic: of the check that decided, the power at 20 runs, or the median ratio of the ATE
            to the base's; None where there is none.
        reason: in the check's words; empty where nothing was found.
        runs: of the bug's filter that this rests on; 0 where one run tells.
        powers: for each of `simbench.bugs.power.SIZES`; empty where one run tells.
        ratio: of the ATE, in its own column.
    """

    caught: bool
    statistic: float | None = None
    reason: str = ""
    runs: int = 0
    powers: tuple[Share, ...] = ()
    ratio: Ratio | None = None

    def as_json(self) -> dict[str, Any]:
        """JSON-safe: NaN and infinity are null."""
        value = self.statistic
        finite = value is not None and abs(value) < float("inf")
        values: dict[str, Any] = {
            "caught": self.caught,
            "statistic": value if finite else None,
            "reason": self.reason,
        }
        if self.runs:
            values["runs"] = self.runs
        if self.powers:
            values["powers"] = [share.as_json() for share in self.powers]
        if self.ratio is not None:
            values |= {"low": self.ratio.low, "high": self.ratio.high}
        return values


#: By bug, by column.
Matrix = Mapping[str, Mapping[str, Cell]]


def matrix(names: Iterable[str] = BUGS, jobs: int = -1, runs: int = 0) -> Matrix:
    """Measure the columns for bugs of the catalogue.

    Args:
        names: of the bugs.
        jobs: processes in parallel; -1 for one a core.
        runs: of each filter for the columns of chance, a multiple of `simbench.bugs.power.BATCH`;
            0 leaves them out.
    """
    names = tuple(names)
    bases = {BUGS[name].base for name in names}
    filters = [*sorted(bases), *(f"slam+{name}" for name in names)]
    parallel = Parallel(n_jobs=jobs)
    results = dict(zip(filters, parallel(delayed(_results)(f) for f in filters), strict=True))
    found = {
        name: {
            column: _cell(results[f"slam+{name}"], results[BUGS[name].base], checks)
            for column, checks in COLUMNS.items()
        }
        for name in names
    }
    if runs:
        by_chance = parallel(delayed(_by_chance)(f, runs) for f in filters)
        summaries, powers = (
            dict(zip(filters, c, strict=True)) for c in zip(*by_chance, strict=True)
        )
        for name, cells in found.items():
            bug, base = f"slam+{name}", BUGS[name].base
            cells |= _chance_cells(powers[bug], runs)
            cells["ate"] = _ate_cell(power.ate_ratio(summaries[bug], summaries[base]), runs)
    return found


def missed(name: str, cells: Mapping[str, Cell]) -> list[str]:
    """Measured columns that must catch a bug and do not; or that catch a control, which may not."""
    must = set(BUGS[name].checks)
    return [
        column
        for column, cell in cells.items()
        if (cell.caught if BUGS[name].control else column in must and not cell.caught)
    ]


def table(found: Matrix) -> str:
    """A line for each bug: x where a column catches it, ! where it must and does not.

    A column of chance says its power at 20 runs, where that is more than false alarms; the last one
    how many times its base's ATE a bug has.
    """
    width = max(map(len, found))
    columns = list(next(iter(found.values())))
    lines = [f"{'':{width}}  {'  '.join(columns)}"]
    for name, cells in found.items():
        wrong = missed(name, cells)
        marks = (_marked(cells[c], c in wrong) for c in columns)
        line = (f"{mark:^{len(c)}}" for mark, c in zip(marks, columns, strict=True))
        lines.append(f"{name:{width}}  {'  '.join(line)}".rstrip())
    return "\n".join(lines)


def _marked(cell: Cell, wrong: bool) -> str:
    sign = mark(cell)
    return sign.removesuffix("x").removesuffix(".") + "!" if wrong else sign


def mark(cell: Cell) -> str:
    """What stands for a cell in a table and in a picture."""
    if cell.ratio is not None:
        return f"{cell.ratio.median:.2f}"
    if cell.powers:
        seen = cell.powers[-1].interval[0] > power.FALSE_ALARM
        return f"{cell.powers[-1].value:.2f}" if seen else "."
    return "x" if cell.caught else "."


def _results(filter_: str) -> dict[str, CheckResult]:
    factory = resolve(filter_)
    return {
        check: resolve_check(check)(factory, None)
        for checks in COLUMNS.values()
        for check in checks
    }


def _cell(
    bug: Mapping[str, CheckResult], base: Mapping[str, CheckResult], checks: tuple[str, ...]
) -> Cell:
    for check in checks:
        found = bug[check]
        if found.failed and not base[check].failed:
            return Cell(caught=True, statistic=found.statistic, reason=found.reason)
    return Cell(caught=False, statistic=bug[checks[0]].statistic)


def _by_chance(
    filter_: str, runs: int
) -> tuple[tuple[RunSummary, ...], dict[str, tuple[Share, ...]]]:
    with threadpool_limits(limits=1):
        summaries = power.runs_of(resolve(filter_), runs)
    return summaries, power.powers(summaries)


def _chance_cells(powers: Mapping[str, tuple[Share, ...]], runs: int) -> dict[str, Cell]:
    return {
        column: Cell(
            caught=shares[-1].value >= RELIABLE,
            statistic=shares[-1].value,
            runs=runs,
            powers=shares,
        )
        for column, shares in powers.items()
    }


def _ate_cell(ratio: Ratio | None, runs: int) -> Cell:
    median = None if ratio is None else ratio.median
    return Cell(caught=False, statistic=median, runs=runs, ratio=ratio)
