"""What of the bench sees which bug: bug by check, measured.

A check catches a bug where it finds something that it does not find in the bug's own base: that the
standard filter leaks information along its null space is no merit of a bug.

A column is a name of `CHECKS`. Those here hold without chance, or with a false alarm so rare that
one run of the check tells; what needs many runs joins as columns of its own.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from joblib import Parallel, delayed

from simbench.bugs import BUGS
from simbench.checks.conformance import resolve as resolve_check
from simbench.checks.result import CheckResult
from simbench.filters import resolve

#: The checks of `simbench.checks.conformance` that make up a column.
COLUMNS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "audit": ("exact-audit",),
        "jacobian": ("jacobians",),
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """What a column says of a bug.

    Attributes:
        caught: whether it catches the bug.
        statistic: of the check that decided; None where it gives none.
        reason: in the check's words; empty where nothing was found.
    """

    caught: bool
    statistic: float | None = None
    reason: str = ""

    def as_json(self) -> dict[str, Any]:
        """JSON-safe: NaN and infinity are null."""
        value = self.statistic
        finite = value is not None and abs(value) < float("inf")
        return {
            "caught": self.caught,
            "statistic": value if finite else None,
            "reason": self.reason,
        }


#: By bug, by column.
Matrix = Mapping[str, Mapping[str, Cell]]


def matrix(names: Iterable[str] = BUGS, jobs: int = -1) -> Matrix:
    """Measure the columns for bugs of the catalogue.

    Args:
        names: of the bugs.
        jobs: processes in parallel; -1 for one a core.
    """
    names = tuple(names)
    bases = {BUGS[name].base for name in names}
    filters = [*sorted(bases), *(f"slam+{name}" for name in names)]
    results = dict(
        zip(filters, Parallel(n_jobs=jobs)(delayed(_results)(f) for f in filters), strict=True)
    )
    return {
        name: {
            column: _cell(results[f"slam+{name}"], results[BUGS[name].base], checks)
            for column, checks in COLUMNS.items()
        }
        for name in names
    }


def missed(name: str, cells: Mapping[str, Cell]) -> list[str]:
    """Measured columns that must catch a bug and do not; or that catch a control, which may not."""
    must = set(BUGS[name].checks)
    return [
        column
        for column, cell in cells.items()
        if (cell.caught if BUGS[name].control else column in must and not cell.caught)
    ]


def table(found: Matrix) -> str:
    """A line for each bug: x where a column catches it, ! where it must and does not."""
    width = max(map(len, found))
    lines = [f"{'':{width}}  {'  '.join(COLUMNS)}"]
    for name, cells in found.items():
        wrong = missed(name, cells)
        marks = ("!" if c in wrong else "x" if cells[c].caught else "." for c in COLUMNS)
        line = (f"{mark:^{len(c)}}" for mark, c in zip(marks, COLUMNS, strict=True))
        lines.append(f"{name:{width}}  {'  '.join(line)}".rstrip())
    return "\n".join(lines)


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
