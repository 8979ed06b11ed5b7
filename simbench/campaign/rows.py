"""From work to rows: simulates where it runs, and gives every filter of a run the same data."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any, TypeAlias

import numpy as np
from scipy.special import chdtri

from simbench.dataset import Dataset
from simbench.errors import FilterFailure, InputError
from simbench.filters import resolve
from simbench.metrics import DIVERGED, POSE_ERRORS, ate, metrics, nees, nis, pose_nees
from simbench.run import RunOptions, RunRecord, run
from simbench.scenario import Scenario
from simbench.sensors import simulate

#: A row of the table, or what a worker knows of it.
Row: TypeAlias = dict[str, Any]

IDENTITY = ("scenario", "overrides", "case", "filter", "seed", "run", "code", "status", "reason")
CONSISTENCY = ("diverged", "pose_nees_end", "nis", "nis_dof")
_OF_POSES = (*POSE_ERRORS, "pose_nees_mean")
#: Of `simbench.metrics.metrics`, those that are equal on every machine.
METRICS = (
    "frames",
    "landmarks",
    "duration_s",
    "path_length_m",
    *_OF_POSES,
    *(f"smoothed_{name}" for name in _OF_POSES),
    "landmark_nees_mean",
    "landmark_rmse_m",
    "nis_mean_per_dof",
    "accepted",
    "rejected",
    "rejected_share",
    "skipped_features",
)
#: And those that differ, by their names there.
WALL = {"wall_s": "wall_s", "wall_realtime_factor": "realtime_factor"}
COLUMNS = (*IDENTITY, *CONSISTENCY, *METRICS, *WALL)
#: Of the time series, beside what tells the row.
SERIES = ("time_s", "pose_nees", "nis", "nis_dof", "position_error_m", "rotation_error_deg")


@dataclass(frozen=True, slots=True, kw_only=True)
class Work(ABC):
    """What goes to a worker; what goes wrong there is a row.

    Attributes:
        todo: what each row is of, and its filter.
        time_limit_s: for each row.
        limit_bytes: what a scene may claim of memory, as `simbench.limits` has it here.
        code: of simbench and vislam, as the worker's must be.
    """

    todo: tuple[tuple[Any, str], ...]
    time_limit_s: float
    limit_bytes: int
    code: str

    @abstractmethod
    def rows(self) -> Iterator[Row]:
        """A row for each of todo, one by one."""

    def row(self, item: tuple[Any, str], **values: Any) -> Row:
        """What is said of one of todo."""
        return {"run": item[0], "filter": item[1]} | values


@dataclass(frozen=True, slots=True, kw_only=True)
class Runs(Work):
    """Some runs of a case: todo holds their numbers, the filters of a run together.

    Attributes:
        case: its place in the plan.
        scenario: the scene.
        seed: of the runs.
        smooth: whether the past poses are wanted given all data.
        series: whether the rows carry time series.
    """

    case: int
    scenario: Scenario
    seed: int
    smooth: bool
    series: bool

    def rows(self) -> Iterator[Row]:
        """The data of a run are made once, here."""
        for number, items in groupby(self.todo, key=lambda item: item[0]):
            dataset = self._simulated(number)
            for item in items:
                yield self.row(item, **self._outcome(dataset, item[1]))

    def _simulated(self, number: int) -> Dataset | InputError:
        try:
            return simulate(self.scenario, self.seed, number)
        except InputError as error:
            return error

    def _outcome(self, dataset: Dataset | InputError, name: str) -> Row:
        if isinstance(dataset, InputError):
            return {"status": "failed", "reason": str(dataset), "simulated": False}
        try:
            record = run(dataset, resolve(name), name=name, options=RunOptions(smooth=self.smooth))
            known = metrics(record)
            found: Row = {"status": "done", "reason": ""} | _consistency(record)
            found |= {column: known[column] for column in METRICS}
            found |= {column: known[key] for column, key in WALL.items()}
            return found | ({"series": _series(record)} if self.series else {})
        except (FilterFailure, InputError) as failure:
            return {"status": "failed", "reason": str(failure)}
        except Exception as error:  # one row must not cost the others
            return {"status": "failed", "reason": f"{type(error).__name__}: {error}"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Checks(Work):
    """Checks of filters: todo holds their names."""

    def rows(self) -> Iterator[Row]:
        """What each says."""
        from simbench.checks.conformance import resolve as resolve_check

        for item in self.todo:
            result = asdict(resolve_check(item[0])(resolve(item[1]), None))
            for key in ("statistic", "limit"):
                result[key] = None if result[key] is None else _finite(float(result[key]))
            yield self.row(item, status="done", **result)


def _consistency(record: RunRecord) -> Row:
    truth, last = record.dataset.truth, record.steps[-1]
    value, dof = nis(record)
    found: Row = dict.fromkeys(CONSISTENCY)
    if dof.any():
        found |= {"nis": _finite(value.sum()), "nis_dof": int(dof.sum())}
    if truth is not None and last.belief.pose_covariance is not None:
        error = last.belief.pose_error(truth.T_world_imu[last.frame])
        at_end = float(nees(error, last.belief.pose_covariance))
        found |= {"pose_nees_end": _finite(at_end), "diverged": int(at_end > chdtri(6, DIVERGED))}
    return found


def _series(record: RunRecord) -> Mapping[str, list[Any]]:
    """By name a value for each frame; None where there is none."""
    value, dof = nis(record)
    truth, nothing = record.dataset.truth, np.full(len(record.steps), np.nan)
    position = rotation = nothing
    if truth is not None:
        errors = ate(record.T_world_imu, truth.T_world_imu)
        position, rotation = errors.translation_m, np.rad2deg(errors.rotation_rad)
    consistent = pose_nees(record)
    columns = (
        record.dataset.times_s,
        nothing if consistent is None else consistent,
        value,
        dof,
        position,
        rotation,
    )
    lists = ([_finite(x) for x in column.tolist()] for column in columns)
    return dict(zip(SERIES, lists, strict=True))


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
