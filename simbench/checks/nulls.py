"""The statistics of a Monte Carlo, each with the law that it has under a right filter.

Each has two sides, but for the Ljung-Box statistic: it is large whatever the sign of a correlation.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.special import chdtrc, chdtri, gammainc, gammaincc, ndtr, ndtri, pdtrik

from simbench.checks.montecarlo import AGES, ChiSquare, Innovations, RunSummary
from simbench.metrics import chi_square_band

Kind: TypeAlias = Literal["pose", "map", "newborn", "landmark", "nis", "dt", "whiteness", "gate"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistic:
    """A statistic of all runs.

    Attributes:
        name: of the check.
        kind: what it is about.
        value: of the statistic.
        p: the probability of one as far out, not corrected.
        band: where it lies but for a probability, the level.
    """

    name: str
    kind: Kind
    value: float
    p: float
    band: Callable[[float], tuple[float, float]]


def statistics(
    runs: Sequence[RunSummary], gate: float | None, outliers: bool
) -> Iterator[tuple[str, Statistic | str]]:
    """Every statistic by the name of its check, or why there is none."""
    if not runs:
        return
    no_pose = "the filter does not say how sure it is of the pose, or knows it exactly"
    for i, frame in enumerate(runs[0].instants.tolist()):
        name = f"pose NEES, frame {frame}"
        yield name, _mean_square(name, "pose", [r.pose for r in runs], i) or no_pose
    for i, frame in enumerate(runs[0].instants.tolist()):
        name = f"map NEES given the pose, frame {frame}"
        parts = [r.map_given_pose for r in runs]
        yield name, _mean_square(name, "map", parts, i) or "no joint covariance of a map then"
    for i, age in enumerate(AGES):
        name = f"landmark NEES, {age}"
        kind: Kind = "newborn" if age == "newborn" else "landmark"
        parts = [r.landmark for r in runs]
        yield name, _mean_square(name, kind, parts, i) or "no landmark of this age"
    innovations = [r.innovations for r in runs if r.innovations is not None]
    if not sum(int(i.nis.dof.sum()) for i in innovations):
        yield "innovations", "the filter reports none, or accepts none"
        return
    yield "NIS", _nis(innovations, gate)
    yield "NIS against dt", _against_dt(innovations)
    yield "innovation whiteness", _whiteness(innovations)
    yield "gate rejections", _rejections(innovations, gate, outliers)


def _mean_square(
    name: str, kind: Kind, parts: Sequence[ChiSquare | None], i: int
) -> Statistic | None:
    """Mean over runs of what is chi-square in each, per degree of freedom."""
    value = sum(float(part.value[i]) for part in parts if part is not None)
    dof = sum(int(part.dof[i]) for part in parts if part is not None)
    return _chi_square(name, kind, value, dof) if dof else None


def _chi_square(name: str, kind: Kind, value: float, dof: int, least: float = 1.0) -> Statistic:
    """A sum that is chi-square, but for a factor between `least` and 1 that nobody knows."""

    def band(level: float) -> tuple[float, float]:
        low, high = chi_square_band(dof, 1 - level)
        return least * float(low) / dof, float(high) / dof

    p = 2 * min(gammainc(dof / 2, value / least / 2), gammaincc(dof / 2, value / 2))
    return Statistic(name=name, kind=kind, value=value / dof, p=min(1.0, float(p)), band=band)


def _nis(innovations: Sequence[Innovations], gate: float | None) -> Statistic:
    """NIS over its degrees of freedom.

    A gate cuts the tail off, and so takes a share of the mean: all of it where the sightings of a
    frame are independent, less where the pose's error is common to them.
    """
    value = sum(float(i.nis.value.sum()) for i in innovations)
    dof = sum(int(i.nis.dof.sum()) for i in innovations)
    least = 1.0
    if gate is not None:
        threshold = chdtri(4, 1 - gate)
        least = float((1 - chdtrc(6, threshold)) / gate)
    return _chi_square("NIS", "nis", value, dof, least)


def _against_dt(innovations: Sequence[Innovations]) -> Statistic | str:
    """The correlation of a frame's NIS with the interval before it, weighted by its degrees."""
    dt, nis, dof = (
        np.concatenate(column)
        for column in zip(*((i.dt_s, i.nis.value, i.nis.dof) for i in innovations), strict=True)
    )
    dt, nis, dof = dt[dof > 0], nis[dof > 0], dof[dof > 0]
    if np.ptp(dt) < 1e-6 * dt.mean():
        return "the interval between frames is constant; set time_jitter"
    a = dt - np.average(dt, weights=dof)
    b = nis - dof * nis.sum() / dof.sum()
    r = float(a @ b / np.sqrt((dof @ a**2) * np.sum(b**2 / dof)))
    root_n = float(np.sqrt(len(dt)))

    def band(level: float) -> tuple[float, float]:
        edge = float(-ndtri(level / 2)) / root_n
        return -edge, edge

    p = float(2 * ndtr(-abs(r) * root_n))
    return Statistic(name="NIS against dt", kind="dt", value=r, p=p, band=band)


def _whiteness(innovations: Sequence[Innovations]) -> Statistic | str:
    """Ljung-Box over the lags, of the autocorrelation over all runs; it has but one tail."""
    pairs = np.sum([i.pairs for i in innovations], axis=0)
    seen = pairs > 0
    dof = int(np.count_nonzero(seen))
    if not dof:
        return "no landmark is sighted in two frames near each other"
    correlation = np.sum([i.correlation for i in innovations], axis=0)
    Q = float(np.sum(correlation[seen] ** 2 / pairs[seen]))
    return Statistic(
        name="innovation whiteness",
        kind="whiteness",
        value=Q,
        p=float(chdtrc(dof, Q)),
        band=lambda level: (0.0, float(chdtri(dof, level))),
    )


def _rejections(
    innovations: Sequence[Innovations], gate: float | None, outliers: bool
) -> Statistic | str:
    """The share of refused sightings: Poisson, but that those of a frame may fall together."""
    if gate is None:
        return "no gate is on"
    if outliers:
        return "some sightings are wrong, so nobody knows how many should be refused"
    tested = np.concatenate([i.tested for i in innovations])
    rejected = np.concatenate([i.rejected for i in innovations])
    n, k = int(tested.sum()), int(rejected.sum())
    together = np.sum((rejected - k / n * tested) ** 2) / k if k else 1.0
    together = max(1.0, float(together))
    mean, count = (1 - gate) * n / together, k / together
    p = 2 * min(float(gammaincc(count + 1, mean)), float(gammainc(count, mean)) if k else 1.0)

    def band(level: float) -> tuple[float, float]:
        low, high = pdtrik(np.array([level / 2, 1 - level / 2]), mean)
        return float(np.nan_to_num(low)) * together / n, (float(high) + 1) * together / n

    return Statistic(name="gate rejections", kind="gate", value=k / n, p=min(1.0, p), band=band)
