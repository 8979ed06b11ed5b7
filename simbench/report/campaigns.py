"""The section on a campaign."""

import csv
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from simbench import figures
from simbench.errors import InputError
from simbench.files import read_text
from simbench.metrics import chi_square_band
from simbench.report import meaning
from simbench.report.meaning import command, commands
from simbench.report.numbers import number
from simbench.report.page import Block, Cell, Finding, Picture, Section, Text, Tone, table
from simbench.report.saved import Finite
from vislam.arrays import Array

#: Cases with pictures of their own; the rest stand in the tables.
MOST_DRAWN = 6
#: Columns of `results.csv` that are drawn: the axis, and what a right filter has.
DRAWN: Mapping[str, tuple[str, float | None]] = {
    "ate_rmse_m": ("absolute error, RMS [m]", None),
    "pose_nees_mean": ("mean pose NEES [-]", 6.0),
}


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class Failure(_Part):
    """The first row of a group that failed or hung."""

    seed: int
    run: int
    status: str
    reason: str


class Share(_Part):
    """So many of so many."""

    count: int
    of: int
    share: Finite
    low: Finite
    high: Finite


class Band(_Part):
    """A statistic per degree of freedom, and whether it lies where a right filter's does."""

    value: Finite
    low: Finite
    high: Finite
    dof: int
    inside: bool

    def holds(self, bands: int, confidence: float) -> bool:
        """Whether it lies within its band when so many bands must hold at once (Bonferroni)."""
        low, high = chi_square_band(self.dof, 1 - (1 - confidence) / bands)
        return self.inside or bool(low <= self.value * self.dof <= high)


class Moments(_Part):
    """Of a number, over the runs."""

    n: int
    mean: Finite
    low: Finite | None
    high: Finite | None
    median: Finite


class Group(_Part):
    """The runs of a filter in a case."""

    scenario: str
    case: str
    overrides: dict[str, Any]
    filter: str
    runs: int
    done: int
    failed: int
    hung: int
    failure: Failure | None
    diverged: Share | None
    nees: Band | None
    nis: Band | None
    metrics: dict[str, Moments | None]


class Pair(_Part):
    """Two filters on the same data."""

    scenario: str
    case: str
    filter: str
    reference: str
    metric: str
    n: int
    mean: Finite | None
    low: Finite | None
    high: Finite | None
    better: Finite | None
    p_holm: Finite | None


class CheckOutcome(_Part):
    """A check of a filter."""

    filter: str
    name: str
    outcome: str
    reason: str
    failure: str | None = None


class Summary(_Part):
    """`summary.json` of a campaign."""

    filters: list[str]
    groups: list[Group]
    pairs: list[Pair]
    confidence: Finite
    checks: list[CheckOutcome] = []


def campaign(directory: Path) -> Section:
    """The section on the directory of a campaign.

    Raises:
        InputError: it holds no finished campaign.
    """
    summary = _summary(directory / "summary.json")
    findings = (*_of_groups(summary, directory), *_of_checks(summary))
    runs, done = (sum(getattr(g, name) for g in summary.groups) for name in ("runs", "done"))
    judged = summary.checks or any(g.nees or g.nis for g in summary.groups)
    cases = len({group.case for group in summary.groups})
    return Section(
        kind="campaign",
        title=", ".join(dict.fromkeys(group.scenario for group in summary.groups)),
        passed=not findings if judged or findings else None,
        verdict=f"{done} of {runs} runs done: {len(summary.filters)} filters, {cases} cases. "
        + (f"{len(findings)} findings." if findings else "Nothing stands out."),
        again=(command("campaign", str(directory / "study.yaml")),),
        facts={"filters": ", ".join(summary.filters), "confidence": number(summary.confidence)},
        findings=findings,
        blocks=tuple(_blocks(summary, directory)),
    )


def _summary(path: Path) -> Summary:
    if not path.exists():
        raise InputError(
            f"{path.parent}: expected the directory of a campaign, but there is no {path.name}. "
            "Where the campaign was interrupted, run it again: it goes on."
        )
    try:
        return Summary.model_validate_json(read_text(path))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(f"{path}: {place}: {first['msg']}.") from error


def _of_groups(summary: Summary, directory: Path) -> Iterator[Finding]:
    bands = _bands(summary)
    for group in summary.groups:
        where = _where(group.scenario, group.overrides)
        if group.failure is not None:
            yield Finding(
                names=(f"{group.filter} in {where}: {group.failed} failed, {group.hung} hung",),
                found=f"run {group.failure.run} {group.failure.status}: {group.failure.reason}",
                means="The filter raised, its process died, or it went beyond the time limit.",
                commands=(_row(directory, group, group.failure.seed, group.failure.run),),
            )
        for name, band in (("pose NEES at the end", group.nees), ("NIS", group.nis)):
            if band is not None and not band.holds(bands, summary.confidence):
                high = band.value > band.high
                yield Finding(
                    names=(f"{group.filter} in {where}: {name}",),
                    found=f"{number(band.value)} per degree of freedom, where a right filter has "
                    f"{number(band.low)} to {number(band.high)}",
                    means=_MEANS[name, high],
                    commands=commands(_worst(directory, group, name, high)),
                )


def _bands(summary: Summary) -> int:
    """How many statistics have a band."""
    return sum((g.nees is not None) + (g.nis is not None) for g in summary.groups)


_MEANS = {
    ("pose NEES at the end", True): "Too sure: noise left out, a wrong Jacobian, a method that "
    "gains information where nothing can be observed, or noise beyond the linear regime.",
    ("pose NEES at the end", False): "Less sure than it should be: noise added twice, or a "
    "covariance not stored.",
    ("NIS", True): "Innovations are too large for their covariance: a wrong motion model, "
    "Jacobian or noise, or readings used at another time.",
    ("NIS", False): "Innovations are too small for their covariance: noise counted twice, sigma in "
    "place of its square, or a gate that lowers NIS by its own share.",
}


def _worst(directory: Path, group: Group, name: str, high: bool) -> str | None:
    """The command for the run that lies the furthest out."""
    column = "pose_nees_end" if name != "NIS" else "nis_mean_per_dof"
    worst: tuple[float, int, int] | None = None
    for row in _rows(directory, group.case, group.filter):
        if (value := _float(row.get(column))) is not None:
            this = (value if high else -value, int(row["seed"]), int(row["run"]))
            worst = this if worst is None else max(worst, this)
    return None if worst is None else _row(directory, group, *worst[1:])


def _row(directory: Path, group: Group, seed: int, run: int) -> str:
    scene = str(directory / "scenes" / f"{group.case}.yaml")
    return command("run", scene, "--filter", group.filter, "--seed", str(seed), "--run", str(run))


def _of_checks(summary: Summary) -> Iterator[Finding]:
    for check in summary.checks:
        if check.outcome == "failed" and check.failure != "property of the method":
            yield Finding(
                names=(f"{check.filter}: {check.name}",),
                found=check.reason,
                means=meaning.of_law(check.name),
                commands=(meaning.show_law(check.name, check.filter),),
            )


def _blocks(summary: Summary, directory: Path) -> Iterator[Block]:
    bands = _bands(summary)
    yield table(
        "Filters",
        (
            "scenario",
            "swept",
            "filter",
            "done",
            "diverged",
            "pose NEES / 6",
            "expected",
            "NIS / dof",
            "expected",
            "error [m]",
            "±",
        ),
        [
            (
                g.scenario,
                _swept(g.overrides),
                g.filter,
                g.done,
                None if g.diverged is None else g.diverged.share,
                *_band(g.nees, bands, summary.confidence),
                *_band(g.nis, bands, summary.confidence),
                *_mean(g.metrics.get("ate_rmse_m")),
            )
            for g in summary.groups
        ],
    )
    cases = list(dict.fromkeys((g.scenario, g.case) for g in summary.groups))
    for scenario, case in cases[:MOST_DRAWN]:
        yield from _drawn(summary, directory, scenario, case)
    if summary.pairs:
        yield table(
            "Filters compared on the same data, by their difference",
            (
                "scenario",
                "filter",
                "less",
                "metric",
                "runs",
                "difference",
                "from",
                "to",
                "smaller in",
                "p, corrected",
            ),
            [
                (
                    p.scenario,
                    p.filter,
                    p.reference,
                    p.metric,
                    p.n,
                    p.mean,
                    p.low,
                    p.high,
                    p.better,
                    p.p_holm,
                )
                for p in summary.pairs
            ],
            folded=len(summary.pairs) > 20,
        )
    study = directory / "study.yaml"
    if study.exists():
        yield Text(title="The study, whole", text=read_text(study))


def _drawn(summary: Summary, directory: Path, scenario: str, case: str) -> Iterator[Block]:
    overrides = next(g.overrides for g in summary.groups if g.case == case)
    for column, (label, expected) in DRAWN.items():
        values: dict[str, list[float]] = {name: [] for name in summary.filters}
        for row in _rows(directory, case):
            value = _float(row.get(column))
            if value is not None and row["filter"] in values:
                values[row["filter"]].append(value)
        arrays: dict[str, Array] = {name: np.array(of) for name, of in values.items() if of}
        if arrays:
            yield Picture(
                figure=figures.spread(arrays, label, expected),
                caption=f"{_where(scenario, overrides)}: a dot a run, quartiles and median"
                + ("." if expected is None else "; dotted what a right filter has."),
            )


def _rows(directory: Path, case: str, filter_: str | None = None) -> Iterator[dict[str, str]]:
    """The rows of a case in `results.csv`, one at a time."""
    path = directory / "results.csv"
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            for row in csv.DictReader(stream):
                if row.get("case") == case and filter_ in (None, row.get("filter")):
                    yield row
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}.") from error


def _float(text: str | None) -> float | None:
    """A number that is there and finite."""
    try:
        value = float(text or "nan")
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _swept(overrides: Mapping[str, Any]) -> str:
    return ", ".join(f"{key}={json.dumps(value)}" for key, value in overrides.items())


def _where(scenario: str, overrides: Mapping[str, Any]) -> str:
    return f"{scenario} ({_swept(overrides)})" if overrides else scenario


def _band(band: Band | None, bands: int, confidence: float) -> tuple[Cell | None, str]:
    """The statistic, and where it lies with `confidence` if there is no other."""
    if band is None:
        return None, ""
    tone: Tone = "" if band.holds(bands, confidence) else "bad"
    cell = Cell(text=f"{band.value:.2f}", key=band.value, tone=tone, number=True)
    return cell, f"{band.low:.2f}\N{EN DASH}{band.high:.2f}"


def _mean(of: Moments | None) -> tuple[float | None, float | None]:
    """The mean, and half the width of its interval."""
    if of is None:
        return None, None
    return of.mean, None if of.low is None or of.high is None else (of.high - of.low) / 2
