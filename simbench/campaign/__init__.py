"""Campaigns: scenarios x parameter values x runs x filters, on one machine or a cluster.

A study file (`simbench.campaign.study`) says what is run:

```yaml
name: gyro                          # default: the file's stem
about: How much a better gyroscope is worth.
scenarios: [figure8.yaml]           # files beside this one, or whole scenes
filters: [slam, slam-transport]     # as --filter takes them
runs: 50                            # of each scene and parameter value, numbered from 0
seed: 7                             # default: each scenario's own
sweep:                              # keys as --set takes them; a mapping is a grid: every
  imu.velocity.sigma: [0.2, 0.4]    # combination of its values. A list of mappings is one grid
  camera.sigma_px: 0.5              # after another, so single points too.
smooth: true                        # past poses given all data, too; default: false
checks: [exact-audit]               # of `simbench list checks`, once for each filter
outputs: [parquet, series]          # beside the CSV, which is always there
time_limit_s: 600.0                 # for one filter on one run
```

Every filter of a run gets the same data. What a campaign leaves in OUT:

`results.csv` (and `results.parquet`): a row for each run and filter, in the order of the study:
scenarios, sweep, runs, filters. An empty cell is a number that does not apply. Equal studies give
equal bytes but for the columns `wall_*`. The columns:

- `scenario`: the scenario's name.
- `overrides`: JSON object of what the sweep and `--set` changed: `{"imu.velocity.sigma": 0.2}`.
- `case`: twelve hex digits, the fingerprint of the scenario with its overrides; it lies in
  `OUT/scenes/CASE.yaml`, whole.
- `filter`, `seed`, `run`: with the case they make the row again:
  `simbench run OUT/scenes/CASE.yaml --filter FILTER --seed SEED --run RUN`, with `--smooth`
  where the columns `smoothed_*` are filled.
- `code`: twelve hex digits, the fingerprint of the sources of simbench, vislam and the filter.
- `status`: `done`, `failed` (the filter raised, or its process died) or `hung` (beyond the time
  limit); `reason`: why it failed or hung, else empty.
- `diverged`: 1 where NEES of the pose at the end is above what it is in one run of 10^6 of a right
  filter, or infinite, else 0; empty where NEES does not apply.
- `pose_nees_end`: NEES of the pose after the last frame, 6 degrees of freedom (at one instant, so
  that over the runs it has a band); empty where infinite.
- `nis`, `nis_dof`: the sum of NIS over the run, and its degrees of freedom.
- `frames` to `skipped_features`: all numbers of `simbench.metrics.metrics`, by their names;
  `smoothed_*` are of the past poses given all data, in a study with `smooth: true`.
- `wall_s`, `wall_realtime_factor`: of the filter's own calls; those two differ between machines.

`series.csv` (output `series`): `scenario`, `overrides`, `case`, `filter`, `seed` and `run` of a
row, and for each of its frames `frame`, `time_s`, `pose_nees`, `nis`, `nis_dof`,
`position_error_m`, `rotation_error_deg`.

`summary.json`, which `simbench compare OUT --json` prints too, but for the checks; null where a
number does not apply, intervals at `confidence`:

```
{"filters": [name...],
 "groups": [{"scenario", "case", "overrides": {}, "filter",
             "runs", "done", "failed", "hung",
             "failure": {"seed", "run", "status", "reason"} | null,       # the first one
             "diverged": {"count", "of", "share", "low", "high"} | null,  # Clopper-Pearson
             "nees": {"value", "low", "high", "dof", "inside"} | null,    # pose_nees_end / 6
             "nis": {"value", "low", "high", "dof", "inside"} | null,     # nis / nis_dof
             "metrics": {name: {"n", "mean", "low", "high", "std", "median"} | null}}],
 "pairs": [{"scenario", "case", "overrides", "filter", "reference", "metric", "n",
            "mean", "low", "high",   # of filter minus reference, on the same data
            "median", "better",      # better: the share of runs in which filter is smaller
            "p", "p_holm"}],         # Wilcoxon's signed-rank test; Holm's over all the pairs
 "confidence": 0.95, "most_ranked": 10000, "diverged_means": "...",
 "checks": [{"filter", "name", "outcome", "reason", "statistic", "limit", "failure"}]}
```

`study.yaml`: the study, whole with its scenes; `simbench campaign OUT/study.yaml` makes all again.

`journal.jsonl`: a line for each row as it was finished. An interrupted campaign goes on from it; a
row is run where no line has its case, filter, seed, run, smooth and code, or its scene could not
be simulated. Delete it to run all again. One campaign at a time writes to OUT.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simbench.campaign.engine import campaign
    from simbench.campaign.study import Case, Plan, Study, load

__all__ = ["Case", "Plan", "Study", "campaign", "load"]


def __getattr__(name: str) -> Any:
    """The engine when it is first asked for: the processes that filters run in do without."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from simbench.campaign import engine, study

    return getattr(engine if name == "campaign" else study, name)
