"""What rows come to: statistics of each filter in each case, and of filters on the same data.

Rows stream through. Means and shares take all of them; medians and rank tests take the first
`MOST_RANKED` runs of a case, which are as good a sample as any, since runs are independent.

Source: Wilcoxon, Individual comparisons by ranking methods, Biometrics Bulletin 1, 1945; Holm, A
simple sequentially rejective multiple test procedure, Scand. J. Statist. 6, 1979; Welford,
Technometrics 4, 1962.
"""

import json
from array import array
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, TypeAlias

import numpy as np
from scipy.special import stdtrit

from simbench.bugs.power import CONFIDENCE, Share
from simbench.campaign.rows import Row
from simbench.metrics import POSE_ERRORS, chi_square_band
from vislam.arrays import Array

#: JSON-safe; `simbench.campaign` says what is in it.
Summary: TypeAlias = dict[str, Any]

#: Runs of a case and filter that are kept for what needs them all at once.
MOST_RANKED = 10_000
#: Errors, of which smaller is better: what filters are compared by.
ERRORS = (*POSE_ERRORS, "landmark_rmse_m", *(f"smoothed_{name}" for name in POSE_ERRORS))
#: What means are given of.
SUMMARISED = (
    *ERRORS,
    "pose_nees_mean",
    "smoothed_pose_nees_mean",
    "landmark_nees_mean",
    "nis_mean_per_dof",
    "wall_s",
)
DIVERGED_MEANS = (
    "NEES of the pose at the end is above what it is in one run of a million of a right filter, "
    "or infinite"
)


@dataclass(slots=True)
class _Moments:
    """Mean and spread of a stream of numbers, by Welford's recursion; the first ones are kept."""

    n: int = 0
    mean: float = 0.0
    squares: float = 0.0
    kept: "array[float]" = field(default_factory=lambda: array("d"))

    def add(self, value: float | None) -> None:
        if len(self.kept) < MOST_RANKED:
            self.kept.append(np.nan if value is None else value)
        if value is not None:
            self.n += 1
            step = value - self.mean
            self.mean += step / self.n
            self.squares += step * (value - self.mean)

    def as_json(self) -> Summary | None:
        if not self.n:
            return None
        std = float(np.sqrt(self.squares / (self.n - 1))) if self.n > 1 else None
        return {
            "n": self.n,
            **_interval(self.n, self.mean, std),
            "std": std,
            "median": float(np.nanmedian(self.kept)),
        }


def _interval(n: int, mean: float, std: float | None) -> Summary:
    """A mean with its interval, by Student's t."""
    low = high = None
    if std is not None:
        half = float(stdtrit(n - 1, (1 + CONFIDENCE) / 2)) * std / n**0.5
        low, high = mean - half, mean + half
    return {"mean": mean, "low": low, "high": high}


@dataclass(slots=True)
class _Group:
    """The rows of a case and filter."""

    head: Summary
    status: Counter[str] = field(default_factory=Counter)
    failure: Summary | None = None
    diverged: Counter[int] = field(default_factory=Counter)
    nees: _Moments = field(default_factory=_Moments)
    nis: float = 0.0
    nis_dof: int = 0
    moments: dict[str, _Moments] = field(
        default_factory=lambda: {name: _Moments() for name in SUMMARISED}
    )
    runs: list[tuple[int | None, int | None]] = field(default_factory=list)

    def add(self, row: Row) -> None:
        if len(self.runs) < MOST_RANKED:
            self.runs.append((row["seed"], row["run"]))
        self.status[row["status"]] += 1
        if row["status"] != "done" and self.failure is None:
            self.failure = {key: row[key] for key in ("seed", "run", "status", "reason")}
        if row.get("diverged") is not None:
            self.diverged[row["diverged"]] += 1
            infinite = row["pose_nees_end"] is None
            self.nees.add(np.inf if infinite else row["pose_nees_end"])
        if row.get("nis_dof"):
            self.nis += np.inf if row["nis"] is None else row["nis"]
            self.nis_dof += row["nis_dof"]
        for name, moments in self.moments.items():
            moments.add(row.get(name))

    def as_json(self) -> Summary:
        count, of = self.diverged[1], self.diverged.total()
        return self.head | {
            "runs": self.status.total(),
            **{status: self.status[status] for status in ("done", "failed", "hung")},
            "failure": self.failure,
            "diverged": _share(count, of) if of else None,
            "nees": _banded(self.nees.mean / 6, 6 * self.nees.n) if of else None,
            "nis": _banded(self.nis / self.nis_dof, self.nis_dof) if self.nis_dof else None,
            "metrics": {name: moments.as_json() for name, moments in self.moments.items()},
        }


def _share(count: int, of: int) -> Summary:
    share = Share(runs=1, failed=count, groups=of)
    low, high = share.interval
    return {"count": count, "of": of, "share": share.value, "low": low, "high": high}


def _banded(value: float, dof: int) -> Summary:
    """The mean of chi-square over its degrees, and where it lies for a right filter."""
    low, high = (float(edge) / dof for edge in chi_square_band(dof, CONFIDENCE))
    return {
        "value": value if np.isfinite(value) else None,
        "low": low,
        "high": high,
        "dof": dof,
        "inside": bool(low <= value <= high),
    }


def summarise(sources: Iterable[tuple[str, Iterable[Row]]]) -> Summary:
    """The summary of tables.

    Args:
        sources: each with its name; a filter that is in several gets the name behind its own.
    """
    groups: dict[tuple[str, ...], _Group] = {}
    for source, rows in sources:
        for row in rows:
            key = (row["scenario"], row["case"], row["filter"], source)
            if key not in groups:
                head = {key: row[key] for key in ("scenario", "case", "overrides", "filter")}
                head["overrides"] = json.loads(row["overrides"])
                groups[key] = _Group(head)
            groups[key].add(row)
    _tell_apart(groups)
    cases: dict[tuple[str, ...], list[_Group]] = {}
    for (scenario, case, *_), group in groups.items():
        cases.setdefault((scenario, case), []).append(group)
    pairs = [pair for case_groups in cases.values() for pair in _pairs(case_groups)]
    for pair, p in zip(pairs, holm([pair["p"] for pair in pairs]), strict=True):
        pair["p_holm"] = p
    in_order = [group for case_groups in cases.values() for group in case_groups]
    return {
        "filters": list(dict.fromkeys(group.head["filter"] for group in in_order)),
        "groups": [group.as_json() for group in in_order],
        "pairs": pairs,
        "confidence": CONFIDENCE,
        "most_ranked": MOST_RANKED,
        "diverged_means": DIVERGED_MEANS,
    }


def _tell_apart(groups: dict[tuple[str, ...], _Group]) -> None:
    """Name the source behind a filter that is in several."""
    places = Counter(key[:3] for key in groups)
    ambiguous = {key[2] for key, count in places.items() if count > 1}
    for (_, _, name, source), group in groups.items():
        if name in ambiguous:
            group.head["filter"] = f"{name} ({source})"


def _pairs(groups: Sequence[_Group]) -> list[Summary]:
    """Each two filters of a case, by each error, on the runs that both have."""
    found = []
    for reference, group in combinations(groups, 2):
        at = {key: i for i, key in enumerate(reference.runs) if None not in key}
        common = [(i, at[key]) for i, key in enumerate(group.runs) if key in at]
        if not common:
            continue
        ours, theirs = np.array(common).T
        for name in ERRORS:
            mine = np.frombuffer(group.moments[name].kept)
            other = np.frombuffer(reference.moments[name].kept)
            difference = mine[ours] - other[theirs]
            difference = difference[~np.isnan(difference)]
            if len(difference):
                head = group.head | {"reference": reference.head["filter"], "metric": name}
                found.append(head | _paired(difference))
    return found


def _paired(difference: Array) -> Summary:
    n = len(difference)
    std = float(np.std(difference, ddof=1)) if n > 1 else None
    return {
        "n": n,
        **_interval(n, float(np.mean(difference)), std),
        "median": float(np.median(difference)),
        "better": float(np.mean(difference < 0)),
        "p": _wilcoxon(difference),
    }


def _wilcoxon(difference: Array) -> float:
    """The p-value of no difference; one where all are equal."""
    from scipy.stats import wilcoxon

    return float(wilcoxon(difference).pvalue) if difference.any() else 1.0


def holm(ps: Sequence[float]) -> list[float]:
    """P-values, corrected so that the chance of any wrong rejection is the level."""
    order = np.argsort(ps, kind="stable")
    corrected = np.empty(len(ps))
    factor = np.arange(len(ps), 0, -1)
    corrected[order] = np.minimum(1, np.maximum.accumulate(factor * np.asarray(ps)[order]))
    return corrected.tolist()
