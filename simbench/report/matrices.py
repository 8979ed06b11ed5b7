"""The section on a matrix of bugs."""

from collections.abc import Iterator

from simbench.bugs import BUGS
from simbench.report.meaning import command
from simbench.report.page import Block, Cell, Finding, Section, table
from simbench.report.saved import SavedCell, SavedMatrix


def matrix(saved: SavedMatrix) -> Section:
    """The section on a matrix of bugs."""
    wrong = {bug: _wrong(bug, row) for bug, row in saved.items()}
    findings = tuple(
        Finding(
            names=(bug,),
            found=_wrong_text(bug, columns),
            means="The check, or the scene that it runs on, is too weak for this mistake."
            if BUGS[bug].checks
            else "The check fails filters that are right, or the control is none.",
            commands=(command("audit", "--filter", f"slam+{bug}"),),
        )
        for bug, columns in wrong.items()
        if columns
    )
    runs = max((cell.runs for row in saved.values() for cell in row.values()), default=0)
    mistakes = [bug for bug in saved if bug not in BUGS or not BUGS[bug].control]
    caught = sum(any(cell.caught for cell in saved[bug].values()) for bug in mistakes)
    rest = (
        "every check that must catch one does."
        if not findings
        else f"{len(findings)} rows are not as they must be."
    )
    return Section(
        kind="bug matrix",
        title="which check catches which mistake",
        passed=not findings,
        verdict=f"{caught} of {len(mistakes)} mistakes are caught; {rest}",
        again=(command("bugs", "--matrix", *(("--runs", str(runs)) if runs else ("--fast",))),),
        facts={
            "mistakes": str(len(mistakes)),
            "controls": str(len(saved) - len(mistakes)),
            "checks": str(len(_columns(saved))),
            **({"runs": str(runs)} if runs else {}),
        },
        findings=findings,
        blocks=tuple(_matrix_blocks(saved)),
    )


def _columns(saved: SavedMatrix) -> list[str]:
    return list(dict.fromkeys(column for row in saved.values() for column in row))


def _wrong(bug: str, row: dict[str, SavedCell]) -> list[str]:
    """As `simbench.bugs.matrix.missed`; nothing is known of a bug that is not in the catalogue."""
    if bug not in BUGS:
        return []
    must, control = BUGS[bug].checks, BUGS[bug].control
    return [
        column
        for column, cell in row.items()
        if (cell.caught if control else column in must and not cell.caught)
    ]


def _wrong_text(bug: str, columns: list[str]) -> str:
    names = ", ".join(columns)
    return f"a control, but caught by {names}" if BUGS[bug].control else f"not caught by {names}"


def _matrix_blocks(saved: SavedMatrix) -> Iterator[Block]:
    columns = _columns(saved)
    rows = [
        (bug, *(_cell(bug, column, row.get(column)) for column in columns))
        for bug, row in saved.items()
    ]
    yield table(
        "Caught, or with what power by 20 runs; framed where it must", ("bug", *columns), rows
    )
    said = [
        (bug, column, cell.reason)
        for bug, row in saved.items()
        for column, cell in row.items()
        if cell.reason
    ]
    yield table("What each check said", ("bug", "check", "reason"), said, folded=True)


def _cell(bug: str, column: str, cell: SavedCell | None) -> Cell:
    if cell is None:
        return Cell(text="", key=None)
    must = bug in BUGS and column in BUGS[bug].checks
    if cell.low is not None and cell.high is not None and cell.statistic is not None:
        return Cell(text=f"{cell.statistic:.2f}", key=cell.statistic)
    if cell.powers:
        power = cell.powers[-1].power
        return Cell(text=f"{power:.2f}", key=power, shade=power, framed=must)
    mark = "✓" if cell.caught else "·"
    return Cell(text=mark, key=float(cell.caught), shade=float(cell.caught), framed=must)
