"""What verbs print with `--json`, as it is read back from files that anyone may have written."""

from collections.abc import Iterator
from typing import Annotated, Any, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from simbench.errors import InputError


def _positive(text: str) -> str:
    if not 0 < float(text) < float("inf"):
        raise ValueError("expected a positive number")
    return text


Finite: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]


#: A number as a key of JSON, which must be text.
Eps: TypeAlias = Annotated[str, AfterValidator(_positive)]


class _Saved(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", strict=True)


class HowMade(_Saved):
    """What a judging verb was told; None where an earlier version did not say.

    Attributes:
        scenario: the file of the scene.
        seed, run: of the scene.
        overrides: of the scene, as `--set` takes them.
    """

    filter: str = "?"
    scenario: str | None = None
    seed: int | None = None
    run: int | None = None
    overrides: list[str] = Field(default=[], alias="set")


class SavedFinding(_Saved):
    """`simbench.checks.findings.Finding`."""

    call: str
    block: str
    claimed: Finite | None = None
    true: Finite | None = None
    reason: str = ""


class SavedScene(_Saved):
    """`simbench.checks.findings.SceneAudit`."""

    name: str
    passed: bool
    first: SavedFinding | None
    scalars: int
    order: Finite | None
    noise_at_ten_percent: Finite | None


class SavedAudit(HowMade):
    """`simbench audit --json`; deviations by eps, by name."""

    passed: bool
    first: SavedFinding | None
    deviations: dict[Eps, dict[str, Finite | None]]
    scenes: list[SavedScene]
    most_scalars: int | None = None


class SavedCheck(_Saved):
    """`simbench.checks.verdict.Check`."""

    name: str
    passed: bool
    statistic: Finite | None = None
    low: Finite | None = None
    high: Finite | None = None
    p: Finite | None = None
    reason: str = ""


class SavedVerdict(HowMade):
    """`simbench check --json`."""

    passed: bool
    conclusion: str
    checks: list[SavedCheck]
    skipped: dict[str, str]
    figures: dict[str, Finite | None]
    runs: int
    false_alarm: Finite
    look_at: int | None = None


class SavedPower(_Saved):
    """`simbench.bugs.power.Share`."""

    runs: int
    groups: int
    power: Finite
    low: Finite
    high: Finite


class SavedCell(_Saved):
    """`simbench.bugs.matrix.Cell`."""

    caught: bool
    statistic: Finite | None
    reason: str
    runs: int = 0
    powers: list[SavedPower] = []
    low: Finite | None = None
    high: Finite | None = None


#: `simbench bugs --matrix --json`: by bug, by check.
SavedMatrix: TypeAlias = dict[str, dict[str, SavedCell]]


class SavedMetrics(_Saved):
    """`simbench run --json`, and the file beside a recording."""

    model_config = ConfigDict(frozen=True, extra="allow", strict=True)

    source: str
    filter: str
    frames: int

    def values(self) -> dict[str, Any]:
        """All of them, in their order."""
        return self.model_dump()


Saved: TypeAlias = SavedAudit | SavedVerdict | SavedMatrix | SavedMetrics

#: The keys by which a kind is known, and what reads it.
_KINDS: tuple[tuple[frozenset[str], TypeAdapter[Any]], ...] = (
    (frozenset({"deviations", "scenes"}), TypeAdapter(SavedAudit)),
    (frozenset({"conclusion", "checks"}), TypeAdapter(SavedVerdict)),
    (frozenset({"source", "filter", "frames"}), TypeAdapter(SavedMetrics)),
)
_MATRIX: TypeAdapter[Any] = TypeAdapter(SavedMatrix)


def parse(value: Any, where: str) -> Iterator[Saved]:
    """What a JSON value is: one thing, or several where several filters were named.

    Args:
        value: of the file.
        where: the file's name, for errors.

    Raises:
        InputError: it is nothing that a report shows, or not as a verb prints it.
    """
    for one in value if isinstance(value, list) else [value]:
        yield _parse(one, where)


def _parse(value: Any, where: str) -> Saved:
    try:
        if isinstance(value, dict):
            # pydantic gives Any, of what it has just made sure of
            for keys, kind in _KINDS:
                if keys <= value.keys():
                    return kind.validate_python(value)  # type: ignore[no-any-return]
            if value and all(map(_is_row, value.values())):
                return _MATRIX.validate_python(value)  # type: ignore[no-any-return]
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(
            f"{where}: {place}: expected what a verb prints with --json: {first['msg']}."
        ) from error
    raise InputError(
        f"{where}: expected what run, audit, check or bugs --matrix print with --json, a recording "
        "of a run, or the directory of a campaign; this is none of them."
    )


def _is_row(row: Any) -> bool:
    return isinstance(row, dict) and all(
        isinstance(cell, dict) and "caught" in cell for cell in row.values()
    )
