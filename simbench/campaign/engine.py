"""A campaign from a plan to its files.

What a million runs cost, by measurement of the parts (figure8, one filter, a core with other work
beside; a run takes 0.6 s of it, 0.1 s of that the simulation): 170 core hours. Beside that,

- a process costs 0.8 s once; a laptop's driver 0.3 % of the time of its one process;
- a task is 2.2 kB (the scene, not its data), a row that comes back 0.34 kB: 1.4 GB in all;
- a task of `TASK_S` costs a Dask scheduler 2.5 ms, a worker 2.4 ms and the driver 1.8 ms: 0.3 %;
- a row costs the driver 0.2 ms and 1.1 kB for the journal, 0.04 ms and 0.4 kB for the table and
  its summary, 8 bytes of memory, and 0.02 ms when an interrupted campaign goes on.

So the scheduler is the limit, at about 400 tasks a second: with tasks of 2 s it keeps 800 cores
busy. Beyond that `TASK_S` must grow; the driver's journal would follow at 5,000 rows a second.
"""

import json
from collections.abc import Callable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any

from simbench.campaign import code
from simbench.campaign.backends import Backend, opened, performed
from simbench.campaign.journal import NAME, Journal, in_order
from simbench.campaign.results import check_outputs, written
from simbench.campaign.rows import Checks, Row, Runs
from simbench.campaign.study import Plan
from simbench.campaign.summary import Summary, summarise
from simbench.files import replacing
from simbench.limits import limit_bytes

#: The time that a task should take: long against what it costs to send, short against the whole.
TASK_S = 2.0
#: Tasks that each worker should have at least, so that all end together.
TASKS_EACH = 4


def campaign(
    plan: Plan,
    out: Path,
    *,
    backend: Backend = "local",
    scheduler: str | None = None,
    jobs: int | None = None,
    on_progress: Callable[[int, int], None] = lambda _done, _of: None,
) -> Summary:
    """Run what is left of a campaign, and write its files.

    Args:
        plan: what to run.
        out: the directory; rows in its journal are taken over.
        backend: where; see `simbench.campaign.backends.opened`.
        scheduler: its address.
        jobs: processes of the local back end.
        on_progress: told how many rows there are, of how many.

    Returns:
        What `summary.json` holds.

    Raises:
        InputError: a back end or an output is not there.
        OutputError: a file cannot be written.
    """
    study = plan.study
    check_outputs(study.outputs)
    work = _Unfinished(plan)
    checked: list[Row] = []
    with Journal(out / NAME, work.heads, study.runs) as journal:
        _write(out / "study.yaml", plan.to_yaml())
        for case in plan.cases:
            _write(out / "scenes" / f"{case.fingerprint}.yaml", case.scenario.to_yaml())
        on_progress(len(journal) - journal.missing, len(journal))
        if journal.missing or study.checks:
            with opened(backend, scheduler, jobs) as workers:
                tasks: Iterator[Checks | Runs] = chain(
                    work.checks(), work.runs(journal, workers.count)
                )
                for task, answer in performed(tasks, workers):
                    if isinstance(task, Checks):
                        checked += answer.rows
                        continue
                    work.seconds[task.case] = answer.wall_s / len(answer.rows)
                    journal.append(work.whole(task.case, row) for row in answer.rows)
                    on_progress(len(journal) - journal.missing, len(journal))
        rows = in_order(journal, len(plan.cases), len(study.filters), study.runs)
        summary = summarise([("", written(rows, out, study.outputs))])
    summary["checks"] = [_check(row) for row in sorted(checked, key=work.place)]
    _write(out / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary


class _Unfinished:
    """What is left of a plan, divided into tasks.

    Attributes:
        heads: what tells the rows of a case and filter from others, by case, then filter.
        seconds: that a row of a case took, where it is known.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan, self._study = plan, plan.study
        codes = {name: code.of_filter(name) for name in self._study.filters}
        self.heads = [
            {
                "scenario": case.scenario.name,
                "overrides": json.dumps(dict(case.overrides)),
                "case": case.fingerprint,
                "filter": name,
                "seed": case.seed,
                "smooth": self._study.smooth,
                "code": codes[name],
            }
            for case in plan.cases
            for name in self._study.filters
        ]
        self.seconds: dict[int, float] = {}
        self._shared: dict[str, Any] = {
            "time_limit_s": plan.study.time_limit_s,
            "limit_bytes": limit_bytes(),
            "code": code.packages(),
        }

    def whole(self, case: int, row: Row) -> Row:
        """A row with its head."""
        filters = self._study.filters
        return self.heads[case * len(filters) + filters.index(row["filter"])] | row

    def place(self, checked: Row) -> tuple[int, int]:
        """Of a check's row in the order of the study."""
        study = self._study
        return study.filters.index(checked["filter"]), study.checks.index(checked["run"])

    def checks(self) -> Iterator[Checks]:
        """A task for each check of each filter."""
        for name in self._study.filters:
            for check in self._study.checks:
                yield Checks(todo=((check, name),), **self._shared)

    def runs(self, journal: Journal, workers: int) -> Iterator[Runs]:
        """Tasks of some `TASK_S` each: of one run, until it is known how long a row takes."""
        for i, case in enumerate(self._plan.cases):
            runs = self._runs(i, journal)
            while some := tuple(islice(runs, self._size(i, journal.missing, workers))):
                yield Runs(
                    case=i,
                    scenario=case.scenario,
                    seed=case.seed,
                    todo=tuple(item for items in some for item in items),
                    smooth=self._study.smooth,
                    series="series" in self._study.outputs,
                    **self._shared,
                )

    def _runs(self, case: int, journal: Journal) -> Iterator[list[tuple[int, str]]]:
        """The runs of a case that have rows to make, with those."""
        filters = self._study.filters
        for run in range(self._study.runs):
            items = [
                (run, name)
                for j, name in enumerate(filters)
                if (case * len(filters) + j, run) not in journal
            ]
            if items:
                yield items

    def _size(self, case: int, missing: int, workers: int) -> int:
        """How many runs make a task."""
        if case not in self.seconds:
            return 1
        rows = min(TASK_S / max(self.seconds[case], 1e-6), missing / (TASKS_EACH * workers))
        return max(1, int(rows / len(self._study.filters)))


def _check(row: Row) -> dict[str, Any]:
    """What is said of a check: a filter that hangs or ends its process failed it."""
    if row["status"] == "done":
        keys = ("filter", "name", "outcome", "reason", "statistic", "limit", "failure")
        return {key: row[key] for key in keys}
    return {
        "filter": row["filter"],
        "name": row["run"],
        "outcome": "failed",
        "reason": f"{row['status']}: {row['reason']}",
        "statistic": None,
        "limit": None,
        "failure": "mistake",
    }


def _write(path: Path, text: str) -> None:
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
